// Loose parts upon each other: what ties them, and that they keep their gap.
#include "geometry/bvh.h"
#include "stages/skin/skin_layers.h"
#include "support/skin_fixture.h"
#include "support/tube.h"

static const double tube_length = 4.0;

// One mesh of two tubes, the outer one with other vertices.
static pc_mesh make_layers(pc_context *context, double inner, double outer) {
    pc_mesh tubes[2] = {make_tube(context, 32, 40, inner, tube_length),
                        make_tube(context, 36, 44, outer, tube_length)};
    const size_t nv = tubes[0].vertex_count, nf = tubes[0].triangle_count;
    pc_mesh both = {.vertex_count = nv + tubes[1].vertex_count,
                    .triangle_count = nf + tubes[1].triangle_count};
    both.positions = PCI_ALLOCATE(context, double, 3 * both.vertex_count);
    both.triangles = PCI_ALLOCATE(context, uint32_t, 3 * both.triangle_count);
    for (size_t i = 0; i < 3 * both.vertex_count; ++i) {
        both.positions[i] = i < 3 * nv ? tubes[0].positions[i] : tubes[1].positions[i - 3 * nv];
    }
    for (size_t i = 0; i < 3 * both.triangle_count; ++i) {
        both.triangles[i] =
            i < 3 * nf ? tubes[0].triangles[i] : (uint32_t)nv + tubes[1].triangles[i - 3 * nf];
    }
    pc_mesh_free(context, &tubes[0]);
    pc_mesh_free(context, &tubes[1]);
    return both;
}

enum { INNER = 32 * 41, LAYERED = INNER + 36 * 45 }; // vertices of the inner tube, of both

// The closest point of the other tube: its triangle, and the squared distance.
static double closest_of_other(const pc_mesh *both, size_t v, size_t *triangle,
                               double barycentric[3]) {
    double least = INFINITY;
    for (size_t t = 0; t < both->triangle_count; ++t) {
        const uint32_t *corner = &both->triangles[3 * t];
        double b[3];
        if ((corner[0] < INNER) == (v < INNER)) {
            continue;
        }
        const double squared = pci_triangle_squared_distance(
            &both->positions[3 * v], &both->positions[3 * (size_t)corner[0]],
            &both->positions[3 * (size_t)corner[1]], &both->positions[3 * (size_t)corner[2]], b);
        if (squared < least) {
            least = squared;
            *triangle = t;
            memcpy(barycentric, b, sizeof(b));
        }
    }
    return least;
}

// The mean length of the edges of the triangles at a vertex.
static double length_at(const pc_mesh *mesh, size_t v) {
    double sum = 0.0;
    size_t count = 0;
    for (size_t k = 0; k < 3 * mesh->triangle_count; ++k) {
        const size_t i = mesh->triangles[k];
        const size_t j = mesh->triangles[k % 3 == 2 ? k - 2 : k + 1];
        if (i == v || j == v) {
            sum += sqrt(pci_squared_distance(&mesh->positions[3 * i], &mesh->positions[3 * j]));
            ++count;
        }
    }
    return sum / (double)count;
}

static double volume(const double *a, const double *b, const double *c, const double *d) {
    double ab[3], ac[3], ad[3], normal[3];
    pci_sub(b, a, ab);
    pci_sub(c, a, ac);
    pci_sub(d, a, ad);
    pci_cross(ab, ac, normal);
    return pci_dot(normal, ad);
}

// Where an edge passes through a triangle: the shares of the ends and the corners.
static bool passes_through(const double *from, const double *to, const double *corner[3],
                           double ends[2], double barycentric[3]) {
    const double above = volume(corner[0], corner[1], corner[2], from);
    const double below = volume(corner[0], corner[1], corner[2], to);
    double sum = 0.0;
    for (size_t c = 0; c < 3; ++c) {
        barycentric[c] = volume(from, to, corner[(c + 1) % 3], corner[(c + 2) % 3]);
        sum += barycentric[c];
    }
    bool inside = above * below < 0.0;
    for (size_t c = 0; c < 3; ++c) {
        barycentric[c] /= sum;
        inside = inside && barycentric[c] > 0.0;
    }
    ends[0] = below / (below - above);
    ends[1] = 1.0 - ends[0];
    return inside;
}

// The sum over edges of triangles that pass through the other tube: how far apart the points that
// meet there move, u (#V by `columns`), squared, weighed by the squares of the edges' lengths or
// equally.
static double change_of_crossings(const pc_mesh *both, const double *u, size_t columns,
                                  const double *lengths, double typical, size_t *count) {
    double total = 0.0;
    *count = 0;
    for (size_t k = 0; k < 3 * both->triangle_count; ++k) {
        const size_t i = both->triangles[k];
        const size_t j = both->triangles[k % 3 == 2 ? k - 2 : k + 1];
        const double *from = &both->positions[3 * i], *to = &both->positions[3 * j];
        for (size_t t = 0; t < both->triangle_count; ++t) {
            const uint32_t *vertices = &both->triangles[3 * t];
            const double *corner[3];
            double ends[2], barycentric[3], squared = 0.0;
            for (size_t c = 0; c < 3; ++c) {
                corner[c] = &both->positions[3 * (size_t)vertices[c]];
            }
            if ((vertices[0] < INNER) == (i < INNER) ||
                pci_squared_distance(from, corner[0]) > 1.0 ||
                !passes_through(from, to, corner, ends, barycentric)) {
                continue;
            }
            for (size_t x = 0; x < columns; ++x) {
                double change = ends[0] * u[i * columns + x] + ends[1] * u[j * columns + x];
                for (size_t c = 0; c < 3; ++c) {
                    change -= barycentric[c] * u[vertices[c] * columns + x];
                }
                squared += change * change;
            }
            const double length = lengths != NULL ? fmin(lengths[i], lengths[j]) : typical;
            total += squared * pow(fmin(typical, length), 2.0);
            ++*count;
        }
    }
    return total;
}

static pci_place *find_closest(pc_context *context, const pc_mesh *surface, const pc_mesh *proxy) {
    pci_place *closest = calloc(surface->vertex_count, sizeof(*closest));
    assert_ok(context, pci_closest_points(context, "skin", surface, proxy, closest));
    return closest;
}

// <u, T u> for random u, against the closest points and the crossings by trying all triangles.
static void check_ties(double outer, bool crossing) {
    pc_context *context = test_context(3);
    pc_mesh both = make_layers(context, 1.0, outer);
    pc_mesh proxy = make_tube(context, 3, 1, 3.0, tube_length); // all triangles touch
    for (size_t i = 0; i < 3 * both.vertex_count; ++i) {
        both.positions[i] += 1e-3 * pci_random(2, 0, i); // no edge meets an edge
    }
    pci_place *closest = find_closest(context, &both, &proxy);
    pci_scratch scratch = pci_scratch_begin(context);
    pci_skin_layers layers;
    const double typical = 0.25;
    assert_ok(context,
              pci_skin_find_layers(&scratch, &both, &proxy, closest, typical, 2.0, &layers));
    assert_non_null(layers.offsets);
    assert_close(layers.lambda, 2.0, 0.0);
    const size_t nv = both.vertex_count;
    double *u = calloc(nv, sizeof(double)), form = 0.0, direct = 0.0;
    double *lengths = calloc(nv, sizeof(double));
    for (size_t v = 0; v < nv; ++v) {
        u[v] = pci_random(1, 0, v) - 0.5;
        lengths[v] = length_at(&both, v);
    }
    for (size_t v = 0; v < nv; ++v) {
        double row = 0.0, barycentric[3] = {0}, change = u[v];
        for (size_t e = layers.offsets[v]; e < layers.offsets[v + 1]; ++e) {
            form += u[v] * layers.values[e] * u[layers.columns[e]];
            row += layers.values[e];
        }
        assert_close(row, 0.0, 1e-10);
        size_t t = 0;
        const double squared = closest_of_other(&both, v, &t, barycentric);
        assert_true(squared < 0.25 * typical * typical);
        for (size_t c = 0; c < 3; ++c) {
            change -= barycentric[c] * u[both.triangles[3 * t + c]];
        }
        direct += pow(fmin(typical, lengths[v]), 2.0) / (squared + 0.01 * typical * typical) *
                  change * change;
    }
    size_t count;
    direct +=
        change_of_crossings(&both, u, 1, lengths, typical, &count) / (0.01 * typical * typical);
    assert_true(crossing ? count > 100 : count == 0);
    assert_close(form, direct, 1e-9 * direct);
    free(lengths);
    free(u);
    free(closest);
    pci_scratch_end(&scratch);
    pc_mesh_free(context, &proxy);
    pc_mesh_free(context, &both);
    pc_context_destroy(context);
}

static void ties_are_those_of_the_closest_points(void **state) {
    (void)state;
    check_ties(1.04, false);
}

static void crossing_parts_are_tied_where_they_cross(void **state) {
    (void)state;
    check_ties(0.998, true);
}

// Parts too far from each other, a single part, and parts over different pieces of the proxy.
static void other_parts_are_not_tied(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh meshes[3] = {make_layers(context, 1.0, 1.3), // more than half of .25
                         make_tube(context, 32, 40, 1.0, tube_length),
                         make_layers(context, 1.0, 1.04)};
    pc_mesh proxies[3] = {make_tube(context, 3, 1, 3.0, tube_length),
                          make_tube(context, 3, 1, 3.0, tube_length),
                          make_layers(context, 1.0, 1.04)};
    for (size_t i = 0; i < 3; ++i) {
        pci_place *closest = find_closest(context, &meshes[i], &proxies[i]);
        pci_scratch scratch = pci_scratch_begin(context);
        pci_skin_layers layers;
        assert_ok(context, pci_skin_find_layers(&scratch, &meshes[i], &proxies[i], closest, 0.25,
                                                1.0, &layers));
        assert_null(layers.offsets);
        free(closest);
        pci_scratch_end(&scratch);
        pc_mesh_free(context, &meshes[i]);
        pc_mesh_free(context, &proxies[i]);
    }
    pc_context_destroy(context);
}

// How far the gaps between the tubes change on average, where a coarse proxy shakes them.
static double change_of_gaps(double lambda_layers, uint32_t threads, double **weights) {
    enum { FRAMES = 32 };
    pc_context *context = test_context(threads);
    pc_mesh both = make_layers(context, 1.0, 1.04);
    pc_mesh proxy = make_tube(context, 8, 8, 1.02, tube_length);
    const size_t np = proxy.vertex_count, nv = both.vertex_count;
    pc_motion motion = {.frame_count = FRAMES,
                        .vertex_count = np,
                        .positions = PCI_ALLOCATE(context, double, 3 * np * FRAMES),
                        .frame_time = 0.02,
                        .pinned = PCI_ALLOCATE(context, uint8_t, np)};
    memset(motion.pinned, 0, np);
    for (size_t i = 0; i < 3 * np * FRAMES; ++i) {
        motion.positions[i] = proxy.positions[i % (3 * np)] + 0.2 * (pci_random(7, 1, i) - 0.5);
    }
    pc_skin_options options;
    pc_record_set_defaults(&pc_skin_options_record, &options);
    options.lambda_layers = lambda_layers;
    pc_skin skin = {0};
    assert_ok(context, pc_skin_optimize(context, &both, &proxy, &motion, &options, &skin, NULL));
    if (weights != NULL) {
        *weights = malloc(nv * skin.influences * sizeof(double));
        memcpy(*weights, skin.weights, nv * skin.influences * sizeof(double));
    }
    double *posed = calloc(3 * nv, sizeof(double)), sum = 0.0;
    pc_skin_deform(&skin, both.positions, proxy.positions, motion.positions, NULL, posed);
    for (size_t v = 0; v < nv; ++v) {
        size_t t = 0;
        double barycentric[3] = {0}, change[3];
        (void)closest_of_other(&both, v, &t, barycentric);
        for (size_t x = 0; x < 3; ++x) {
            change[x] = posed[3 * v + x] - both.positions[3 * v + x];
            for (size_t c = 0; c < 3; ++c) {
                const size_t at = 3 * (size_t)both.triangles[3 * t + c] + x;
                change[x] -= barycentric[c] * (posed[at] - both.positions[at]);
            }
        }
        sum += pci_norm(change) / (double)nv;
    }
    free(posed);
    pc_skin_free(context, &skin);
    pc_motion_free(context, &motion);
    pc_mesh_free(context, &both);
    pc_mesh_free(context, &proxy);
    pc_context_destroy(context);
    return sum;
}

static void tied_parts_keep_their_gap(void **state) {
    (void)state;
    const double without = change_of_gaps(0.0, 1, NULL);
    const double with = change_of_gaps(0.6, 1, NULL), much = change_of_gaps(20.0, 1, NULL);
    assert_true(with < 0.95 * without);
    assert_true(much < 0.8 * with);
}

static void tied_parts_have_the_same_bytes_at_any_thread_count(void **state) {
    (void)state;
    double *weights[2];
    (void)change_of_gaps(0.6, 1, &weights[0]);
    (void)change_of_gaps(0.6, 3, &weights[1]);
    assert_memory_equal(weights[0], weights[1], sizeof(double) * LAYERED * 4);
    free(weights[0]);
    free(weights[1]);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(ties_are_those_of_the_closest_points),
        cmocka_unit_test(crossing_parts_are_tied_where_they_cross),
        cmocka_unit_test(other_parts_are_not_tied),
        cmocka_unit_test(tied_parts_keep_their_gap),
        cmocka_unit_test(tied_parts_have_the_same_bytes_at_any_thread_count),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
