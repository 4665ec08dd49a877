#define _POSIX_C_SOURCE 200809L
#include "geometry/crossing.h"
#include "geometry/topology.h"
#include "support/glb.h"
#include "support/memory.h"

static char folder[64], path[64], other_path[64];

// ---- small scenes -------------------------------------------------------------------------------

// A visual mesh that is its own proxy, with weights one to one, and a motion of `frames` frames.
typedef struct scene {
    pc_context *context;
    pc_mesh mesh;
    pc_motion motion;
    pc_skin skin;
} scene;

static scene make_scene(size_t nx, size_t ny, size_t frames, uint32_t threads) {
    scene s = {.context = test_context(threads)};
    s.mesh.vertex_count = nx * ny;
    s.mesh.triangle_count = 2 * (nx - 1) * (ny - 1);
    s.mesh.positions = PCI_ALLOCATE(s.context, double, 3 * nx * ny);
    s.mesh.triangles = PCI_ALLOCATE(s.context, uint32_t, 3 * s.mesh.triangle_count);
    uint32_t *corner = s.mesh.triangles;
    for (uint32_t v = 0; v < nx * ny; ++v) {
        const uint32_t row = (uint32_t)nx;
        s.mesh.positions[3 * v] = (double)(v % nx);
        s.mesh.positions[3 * v + 1] = (double)(v / nx);
        if (v % nx + 1 < nx && v / nx + 1 < ny) {
            const uint32_t quad[6] = {v, v + 1, v + row + 1, v, v + row + 1, v + row};
            memcpy(corner, quad, sizeof(quad));
            corner += 6;
        }
    }
    s.motion.frame_count = frames;
    s.motion.vertex_count = nx * ny;
    s.motion.frame_time = 0.1;
    s.motion.positions = PCI_ALLOCATE(s.context, double, 3 * nx * ny * frames);
    s.motion.pinned = PCI_ALLOCATE(s.context, uint8_t, nx * ny);
    s.skin.vertex_count = nx * ny;
    s.skin.influences = 1;
    s.skin.bones = PCI_ALLOCATE(s.context, uint32_t, nx * ny);
    s.skin.weights = PCI_ALLOCATE(s.context, double, nx *ny);
    for (size_t v = 0; v < nx * ny; ++v) {
        s.skin.bones[v] = (uint32_t)v;
        s.skin.weights[v] = 1.0;
    }
    for (size_t f = 0; f < frames; ++f) {
        memcpy(&s.motion.positions[3 * nx * ny * f], s.mesh.positions,
               3 * nx * ny * sizeof(double));
    }
    return s;
}

static void free_scene(scene *s) {
    pc_mesh_free(s->context, &s->mesh);
    pc_motion_free(s->context, &s->motion);
    pc_skin_free(s->context, &s->skin);
    pc_context_destroy(s->context);
}

static double *moved(scene *s, size_t frame, size_t vertex) {
    return &s->motion.positions[3 * (frame * s->motion.vertex_count + vertex)];
}

static pc_motion_measures measure(scene *s) {
    pc_motion_measures m = {0};
    assert_ok(s->context,
              pc_evaluate_motion(s->context, &s->mesh, &s->mesh, &s->motion, &s->skin, NULL, &m));
    return m;
}

// ---- measures -----------------------------------------------------------------------------------

static void a_rigid_motion_is_faultless(void **state) {
    (void)state;
    scene s = make_scene(5, 4, 3, 1);
    for (size_t f = 0; f < 3; ++f) {
        for (size_t v = 0; v < 20; ++v) {
            const double *p = &s.mesh.positions[3 * v], angle = 0.7 * (double)(f + 1);
            double *q = moved(&s, f, v);
            q[0] = p[0] * cos(angle) - p[1] * sin(angle) + 3.0;
            q[1] = p[0] * sin(angle) + p[1] * cos(angle);
            q[2] = 2.0;
        }
    }
    const pc_motion_measures m = measure(&s);
    assert_close(m.rigid, 0.0, 1e-12);
    assert_close(m.collision, 0.0, 1e-12);
    assert_close(m.strain_mean, 0.0, 1e-6);
    assert_close(m.strain_p95, 0.0, 1e-6);
    assert_true(m.folded_triangles == 0.0 && m.new_intersections == 0.0);
    assert_true(m.pinned_drift == 0.0 && m.pinned_drift_worst == 0.0);
    assert_close(m.motion_ratio, 1.0, 1e-12);
    free_scene(&s);
}

// Stretched by a third along x: edges along x have strain 1/3, along y 0, diagonals between.
static void strain_is_relative_change_of_length(void **state) {
    (void)state;
    scene s = make_scene(9, 2, 1, 1);
    for (size_t v = 0; v < 18; ++v) {
        moved(&s, 0, v)[0] *= 4.0 / 3.0;
    }
    const pc_motion_measures m = measure(&s);
    // 16 edges along x, 9 along y, 8 diagonals.
    const double diagonal = sqrt((16.0 / 9.0 + 1.0) / 2.0) - 1.0;
    assert_close(m.strain_mean, (16.0 / 3.0 + 8.0 * diagonal) / 33.0, 1e-6);
    assert_close(m.strain_p95, 1.0 / 3.0, 1.0 / 3.0 * 5e-4);
    free_scene(&s);
}

static int compare_doubles(const void *a, const void *b) {
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

// Against sorting all strains, on random motions.
static void the_percentile_is_that_of_all_strains(void **state) {
    (void)state;
    enum { NX = 7, NY = 6, FRAMES = 9 };
    scene s = make_scene(NX, NY, FRAMES, 2);
    for (size_t i = 0; i < 3 * NX * NY * FRAMES; ++i) {
        s.motion.positions[i] += 0.3 * (pci_random(5, 0, i) - 0.5);
    }
    pci_scratch scratch = pci_scratch_begin(s.context);
    pci_topology topology;
    assert_true(pci_topology_build(&scratch, &s.mesh, &topology));
    const size_t total = topology.edge_count * FRAMES;
    double *strains = malloc(total * sizeof(double)), sum = 0.0;
    for (size_t i = 0; i < total; ++i) {
        const uint32_t *edge = &topology.edges[2 * (i % topology.edge_count)];
        const size_t frame = i / topology.edge_count;
        const double rest = sqrt(pci_squared_distance(&s.mesh.positions[3 * (size_t)edge[0]],
                                                      &s.mesh.positions[3 * (size_t)edge[1]]));
        const double length =
            sqrt(pci_squared_distance(moved(&s, frame, edge[0]), moved(&s, frame, edge[1])));
        strains[i] = fabs(length / rest - 1.0);
        sum += strains[i];
    }
    qsort(strains, total, sizeof(double), compare_doubles);
    const pc_motion_measures m = measure(&s);
    const double expected = strains[(size_t)ceil(0.95 * (double)total) - 1];
    assert_close(m.strain_p95, expected, 5e-4 * expected);
    assert_close(m.strain_mean, sum / (double)total, 1e-6);
    free(strains);
    pci_scratch_end(&scratch);
    free_scene(&s);
}

// A strip bent along its middle line by an angle; folded beyond 90 degrees, whatever the winding.
static void folds_are_counted(void **state) {
    (void)state;
    for (size_t winding = 0; winding < 2; ++winding) {
        for (size_t i = 0; i < 3; ++i) {
            const double angle = (const double[]){1.5, 1.6, 3.1}[i];
            scene s = make_scene(3, 2, 2, 1);
            if (winding == 1) {
                const uint32_t swap = s.mesh.triangles[1];
                s.mesh.triangles[1] = s.mesh.triangles[2];
                s.mesh.triangles[2] = swap;
            }
            for (size_t v = 2; v < 6; v += 3) { // the right column, about x = 1, in frame 0 only
                moved(&s, 0, v)[0] = 1.0 + cos(angle);
                moved(&s, 0, v)[2] = sin(angle);
            }
            const pc_motion_measures m = measure(&s);
            // One triangle on each side of the line, of four, in one frame of two.
            assert_close(m.folded_triangles, i == 0 ? 0.0 : 0.25, 1e-12);
            free_scene(&s);
        }
    }
}

// What is folded at rest is no new fold; neither are triangles without area.
static void folds_at_rest_do_not_count(void **state) {
    (void)state;
    scene s = make_scene(3, 2, 1, 1);
    for (size_t v = 2; v < 6; v += 3) {
        s.mesh.positions[3 * v] = 0.1;
        s.mesh.positions[3 * v + 2] = 0.2;
        memcpy(moved(&s, 0, v), &s.mesh.positions[3 * v], 3 * sizeof(double));
        moved(&s, 0, v)[2] = 0.1;
    }
    assert_true(measure(&s).folded_triangles == 0.0);
    for (size_t v = 0; v < 6; ++v) {
        memset(moved(&s, 0, v), 0, 3 * sizeof(double));
    }
    assert_true(measure(&s).folded_triangles == 0.0);
    free_scene(&s);
}

// Weights that follow a neighbour one step away, in a motion that grows with x.
static void drift_and_ratio_compare_with_the_closest_point(void **state) {
    (void)state;
    scene s = make_scene(5, 2, 2, 1);
    for (size_t f = 0; f < 2; ++f) {
        for (size_t v = 0; v < 10; ++v) {
            const double x = (double)(v % 5);
            moved(&s, f, v)[2] = x > 1.0 ? (double)(f + 1) * (x - 1.0) : 0.0;
        }
    }
    for (size_t v = 0; v < 10; ++v) {
        s.motion.pinned[v] = v % 5 < 2;
    }
    const double diagonal = sqrt(17.0);
    pc_motion_measures m = measure(&s);
    assert_true(m.pinned_drift == 0.0 && m.pinned_drift_worst == 0.0);
    assert_close(m.motion_ratio, 1.0, 1e-12);
    // Column 1 now follows column 2, which moves by 1 and 2; column 4 stays behind like column 3.
    s.skin.bones[1] = 2, s.skin.bones[6] = 7;
    s.skin.bones[4] = 3, s.skin.bones[9] = 8;
    m = measure(&s);
    assert_close(m.pinned_drift, (1.0 + 2.0) / 2.0 / 2.0 / diagonal, 1e-12);
    assert_close(m.pinned_drift_worst, 2.0 / diagonal, 1e-12);
    assert_close(m.motion_ratio, (1.0 + 1.0 + 2.0 + 2.0) / (1.0 + 2.0 + 3.0), 1e-12);
    free_scene(&s);
}

// Of two crossing sheets, the pairs of the rest pose are no new ones.
static void only_new_crossings_count(void **state) {
    (void)state;
    scene s = make_scene(4, 2, 4, 1);
    // The last column of triangles moves through the first: a long flap, in frames 2 and 3.
    for (size_t f = 2; f < 4; ++f) {
        for (size_t row = 0; row < 2; ++row) {
            double *p = moved(&s, f, 4 * row + 3);
            p[0] = 0.5, p[1] = 0.5 + 0.2 * (double)row, p[2] = -1.0;
            p = moved(&s, f, 4 * row + 2);
            p[0] = 0.5, p[1] = 0.5 + 0.2 * (double)row, p[2] = 1.0;
        }
    }
    pc_mesh posed = s.mesh;
    posed.positions = moved(&s, 2, 0);
    uint64_t pairs = 0;
    assert_ok(s.context, pci_count_self_intersections(s.context, "test", &posed, &pairs));
    assert_true(pairs > 0);
    pc_evaluate_motion_options options = {.crossing_frames = 4};
    pc_motion_measures m;
    assert_ok(s.context,
              pc_evaluate_motion(s.context, &s.mesh, &s.mesh, &s.motion, &s.skin, &options, &m));
    assert_close(m.new_intersections, 0.5 * (double)pairs, 1e-12);
    assert_close(m.proxy_intersections, 0.5 * (double)pairs, 1e-12); // the same mesh
    options.crossing_frames = 2;                                     // frames 1 and 3
    assert_ok(s.context,
              pc_evaluate_motion(s.context, &s.mesh, &s.mesh, &s.motion, &s.skin, &options, &m));
    assert_close(m.new_intersections, 0.5 * (double)pairs, 1e-12);
    options.crossing_frames = 0;
    assert_ok(s.context,
              pc_evaluate_motion(s.context, &s.mesh, &s.mesh, &s.motion, &s.skin, &options, &m));
    assert_true(m.new_intersections == 0.0);
    options.crossing_frames = 4;
    memset(s.skin.bones, 0, 8 * sizeof(*s.skin.bones)); // the sheet follows a vertex at rest
    assert_ok(s.context,
              pc_evaluate_motion(s.context, &s.mesh, &s.mesh, &s.motion, &s.skin, &options, &m));
    assert_true(m.new_intersections == 0.0);
    assert_close(m.proxy_intersections, 0.5 * (double)pairs, 1e-12);
    // The crossing pose as the rest pose.
    memcpy(s.mesh.positions, moved(&s, 2, 0), 24 * sizeof(double));
    assert_true(measure(&s).new_intersections == 0.0);
    free_scene(&s);
}

static void threads_do_not_matter(void **state) {
    (void)state;
    static const uint32_t threads[] = {1, 2, 3, 8};
    pc_motion_measures first = {0};
    for (size_t i = 0; i < 4; ++i) {
        pc_context *context = test_context(threads[i]);
        pc_asset asset;
        fixture_asset(context, 4, &asset);
        pc_motion_measures m = {0};
        assert_ok(context, pc_evaluate_motion(context, &asset.visual.surface, &asset.proxy,
                                              &asset.motion, &asset.skin, NULL, &m));
        assert_true(m.rigid > 0.0 && m.strain_mean > 0.0 && m.motion_ratio > 0.5);
        if (i == 0) {
            first = m;
        }
        assert_memory_equal(&first, &m, sizeof(m));
        pc_asset_free(context, &asset);
        pc_context_destroy(context);
    }
}

static void refuses_what_does_not_belong_together(void **state) {
    (void)state;
    scene s = make_scene(3, 3, 2, 1);
    pc_motion_measures m;
    const pc_evaluate_motion_options bad = {.crossing_frames = 100001};
    assert_int_equal(pc_evaluate_motion(s.context, &s.mesh, &s.mesh, NULL, &s.skin, NULL, &m),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(
        pc_evaluate_motion(s.context, &s.mesh, &s.mesh, &s.motion, &s.skin, NULL, NULL),
        PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_evaluate_motion(s.context, &s.mesh, &s.mesh, &s.motion, &s.skin, &bad, &m),
                     PC_ERROR_INVALID_OPTIONS);
    s.skin.bones[4] = 9;
    assert_int_equal(pc_evaluate_motion(s.context, &s.mesh, &s.mesh, &s.motion, &s.skin, NULL, &m),
                     PC_ERROR_INVALID_ARGUMENT);
    s.skin.bones[4] = 4;
    s.motion.positions[7] = NAN;
    assert_int_equal(pc_evaluate_motion(s.context, &s.mesh, &s.mesh, &s.motion, &s.skin, NULL, &m),
                     PC_ERROR_NUMERICAL);
    assert_true(m.motion_ratio == 0.0);
    free_scene(&s);
}

static void survives_lack_of_memory(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    assert_ok(context, pc_export_glb(context, &asset, path));
    for (size_t call = 0; call < 4; ++call) {
        starvation s = {.counter = &counter};
        while (starves(&s)) {
            const pc_mesh *surface = &asset.visual.surface;
            pc_motion_measures m;
            pc_skin skin = {0};
            s.status = call == 0 ? pc_evaluate_motion(context, surface, &asset.proxy, &asset.motion,
                                                      &asset.skin, NULL, &m)
                       : call == 1 ? pc_skin_read_glb(context, path, surface, &asset.proxy, &skin)
                       : call == 2
                           ? pc_skin_inverse_distance(context, surface, &asset.proxy, 4, &skin)
                           : pc_skin_heat_smoothed(context, surface, &asset.proxy, 4, &skin);
            assert_true(s.status == PC_OK || skin.bones == NULL);
            pc_skin_free(context, &skin);
        }
        assert_true(s.failures > 2);
    }
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

// ---- baselines ----------------------------------------------------------------------------------

static void assert_rows_are_sound(const pc_skin *skin, size_t bones) {
    for (size_t v = 0; v < skin->vertex_count; ++v) {
        double sum = 0.0;
        for (size_t k = 0; k < skin->influences; ++k) {
            const double weight = skin->weights[v * skin->influences + k];
            assert_true(weight >= 0.0);
            assert_true(k == 0 || weight <= skin->weights[v * skin->influences + k - 1]);
            assert_true(skin->bones[v * skin->influences + k] < bones);
            sum += weight;
        }
        assert_close(sum, 1.0, 1e-12);
    }
}

static void inverse_distance_is_that_of_all_pairs(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    pc_skin skin = {0};
    const pc_mesh *surface = &asset.visual.surface, *proxy = &asset.proxy;
    assert_ok(context, pc_skin_inverse_distance(context, surface, proxy, 8, &skin));
    assert_int_equal(skin.influences, 8);
    assert_rows_are_sound(&skin, proxy->vertex_count);
    for (size_t v = 0; v < skin.vertex_count; ++v) {
        double distances[24], sum = 0.0;
        for (size_t p = 0; p < proxy->vertex_count; ++p) {
            distances[p] =
                sqrt(pci_squared_distance(&surface->positions[3 * v], &proxy->positions[3 * p]));
        }
        qsort(distances, proxy->vertex_count, sizeof(double), compare_doubles);
        for (size_t k = 0; k < 8; ++k) {
            sum += 1.0 / (distances[k] + 1e-6 * pci_diagonal(proxy));
        }
        for (size_t k = 0; k < 8; ++k) {
            assert_close(skin.weights[8 * v + k],
                         1.0 / (distances[k] + 1e-6 * pci_diagonal(proxy)) / sum, 1e-9);
        }
    }
    pc_skin_free(context, &skin);
    assert_ok(context, pc_skin_inverse_distance(context, surface, proxy, 32, &skin));
    assert_int_equal(skin.influences, proxy->vertex_count);
    assert_int_equal(pc_skin_inverse_distance(context, surface, proxy, 8, &skin),
                     PC_ERROR_INVALID_ARGUMENT);
    pc_skin_free(context, &skin);
    assert_int_equal(pc_skin_inverse_distance(context, surface, proxy, 0, &skin),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_skin_heat_smoothed(context, surface, proxy, 33, &skin),
                     PC_ERROR_INVALID_ARGUMENT);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

// Gaussian elimination of a symmetric positive definite matrix, in place.
static void solve_dense(double *matrix, double *right, size_t n, size_t columns) {
    for (size_t k = 0; k < n; ++k) {
        for (size_t i = k + 1; i < n; ++i) {
            const double factor = matrix[i * n + k] / matrix[k * n + k];
            for (size_t j = k; j < n; ++j) {
                matrix[i * n + j] -= factor * matrix[k * n + j];
            }
            for (size_t j = 0; j < columns; ++j) {
                right[i * columns + j] -= factor * right[k * columns + j];
            }
        }
    }
    for (size_t k = n; k-- > 0;) {
        for (size_t j = 0; j < columns; ++j) {
            for (size_t i = k + 1; i < n; ++i) {
                right[k * columns + j] -= matrix[k * n + i] * right[i * columns + j];
            }
            right[k * columns + j] /= matrix[k * n + k];
        }
    }
}

// (M + t L) X = M W with dense matrices, from the definition.
static void heat_solves_its_equation(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    const pc_mesh *surface = &asset.visual.surface, *proxy = &asset.proxy;
    const size_t nv = surface->vertex_count, np = proxy->vertex_count;
    pc_skin closest = {0}, smoothed = {0};
    assert_ok(context, pc_skin_closest_triangle(context, surface, proxy, &closest));
    assert_ok(context, pc_skin_heat_smoothed(context, surface, proxy, 32, &smoothed));
    assert_rows_are_sound(&smoothed, np);
    pci_scratch scratch = pci_scratch_begin(context);
    pci_topology topology;
    assert_true(pci_topology_build(&scratch, proxy, &topology));
    double h = 0.0;
    for (size_t e = 0; e < topology.edge_count; ++e) {
        h += sqrt(pci_squared_distance(&proxy->positions[3 * topology.edges[2 * e]],
                                       &proxy->positions[3 * topology.edges[2 * e + 1]])) /
             (double)topology.edge_count;
    }
    double *matrix = calloc(nv * nv, sizeof(double)), *right = calloc(nv * np, sizeof(double));
    double *masses = calloc(nv, sizeof(double));
    for (size_t t = 0; t < surface->triangle_count; ++t) {
        const uint32_t *c = &surface->triangles[3 * t];
        const double area = pci_triangle_area(surface, t);
        for (size_t k = 0; k < 3 && area > 0.0; ++k) {
            const size_t a = c[(k + 1) % 3], b = c[(k + 2) % 3];
            double u[3], w[3];
            pci_sub(&surface->positions[3 * a], &surface->positions[3 * c[k]], u);
            pci_sub(&surface->positions[3 * b], &surface->positions[3 * c[k]], w);
            const double weight = h * h / 16.0 * 0.5 * fmax(pci_dot(u, w) / (2.0 * area), 0.0);
            matrix[a * nv + b] -= weight, matrix[b * nv + a] -= weight;
            matrix[a * nv + a] += weight, matrix[b * nv + b] += weight;
            masses[c[k]] += area / 3.0;
        }
    }
    for (size_t v = 0; v < nv; ++v) {
        matrix[v * nv + v] += masses[v];
        for (size_t k = 0; k < 3; ++k) {
            right[v * np + closest.bones[3 * v + k]] += masses[v] * closest.weights[3 * v + k];
        }
    }
    solve_dense(matrix, right, nv, np);
    for (size_t v = 0; v < nv; ++v) {
        double difference = 0.0;
        for (size_t k = 0; k < 32; ++k) {
            const double weight = smoothed.weights[32 * v + k];
            const double expected = right[v * np + smoothed.bones[32 * v + k]];
            difference += weight > 0.0 ? fabs(weight - expected) : 0.0;
        }
        assert_close(difference, 0.0, 1e-6);
    }
    free(matrix);
    free(right);
    free(masses);
    pci_scratch_end(&scratch);
    pc_skin_free(context, &closest);
    pc_skin_free(context, &smoothed);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

// ---- weights out of a GLB -----------------------------------------------------------------------

// Weight of a bone in a row, whatever the slots.
static double weight_of(const pc_skin *skin, size_t v, uint32_t bone) {
    double sum = 0.0;
    for (size_t k = v * skin->influences; k < (v + 1) * skin->influences; ++k) {
        sum += skin->bones[k] == bone ? skin->weights[k] : 0.0;
    }
    return sum;
}

static void assert_same_weights(const pc_skin *a, const pc_skin *b, size_t bones,
                                double tolerance) {
    assert_int_equal(a->vertex_count, b->vertex_count);
    for (size_t v = 0; v < a->vertex_count; ++v) {
        for (uint32_t bone = 0; bone < bones; ++bone) {
            assert_close(weight_of(a, v, bone), weight_of(b, v, bone), tolerance);
        }
    }
}

static void reads_what_export_writes(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    for (uint32_t influences = 1; influences <= 12; influences += 1) {
        pc_asset asset;
        fixture_asset(context, influences, &asset);
        asset.options.skin.weight_storage = PC_SKIN_WEIGHTS_FLOAT;
        assert_ok(context, pc_export_glb(context, &asset, path));
        pc_skin skin = {0};
        assert_ok(context,
                  pc_skin_read_glb(context, path, &asset.visual.surface, &asset.proxy, &skin));
        assert_rows_are_sound(&skin, asset.proxy.vertex_count);
        assert_same_weights(&skin, &asset.skin, asset.proxy.vertex_count, 1e-6);
        pc_skin_free(context, &skin);
        pc_asset_free(context, &asset);
    }
    pc_context_destroy(context);
}

// What a studio's exporter may write: one interleaved view, weights as bytes, joints in another
// order with rotated bind poses, more joints than the proxy has.
static void write_studio_glb(const char *name, const pc_asset *asset) {
    const size_t nv = asset->visual.surface.vertex_count, np = asset->proxy.vertex_count;
    const uint32_t influences = asset->skin.influences;
    const size_t joints = np + 3, vertex_bytes = 24 * nv, total = vertex_bytes + 64 * joints;
    unsigned char *bin = calloc(total, 1);
    for (size_t v = 0; v < nv; ++v) { // position, 4 joints of 16 bits, 4 weights of 8 bits
        unsigned char *at = bin + 24 * v;
        for (size_t k = 0; k < 3; ++k) {
            const float x = (float)asset->visual.surface.positions[3 * v + k];
            memcpy(at + 4 * k, &x, 4);
        }
        int left = 255;
        for (size_t k = influences; k-- > 0;) {
            const uint32_t bone = asset->skin.bones[v * influences + k];
            const int weight =
                k > 0 ? (int)(255.0 * asset->skin.weights[v * influences + k] + 0.5) : left;
            at[12 + 2 * k] = (unsigned char)(joints - 1 - bone);
            at[20 + k] = (unsigned char)weight;
            left -= weight;
        }
    }
    for (size_t j = 0; j < joints; ++j) {
        // Rotated by 90 degrees about z, scaled by 2: the inverse of what places the joint.
        const size_t vertex = joints - 1 - j;
        float m[16] = {0.0f, -0.5f, 0.0f, 0.0f, 0.5f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.5f, 0.0f};
        m[15] = 1.0f;
        const double *p =
            vertex < np ? &asset->proxy.positions[3 * vertex] : (const double[]){1e3, 0.0, 0.0};
        m[12] = (float)(-0.5 * p[1]), m[13] = (float)(0.5 * p[0]), m[14] = (float)(-0.5 * p[2]);
        memcpy(bin + vertex_bytes + 64 * j, m, 64);
    }
    char json[4096];
    int used = snprintf(
        json, sizeof(json),
        "{\"asset\":{\"version\":\"2.0\"},\"buffers\":[{\"byteLength\":%zu}],\"bufferViews\":["
        "{\"buffer\":0,\"byteLength\":%zu,\"byteStride\":24},"
        "{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":%zu}],\"accessors\":["
        "{\"bufferView\":0,\"componentType\":5126,\"count\":%zu,\"type\":\"VEC3\"},"
        "{\"bufferView\":0,\"byteOffset\":12,\"componentType\":5123,\"count\":%zu,\"type\":"
        "\"VEC4\"},"
        "{\"bufferView\":0,\"byteOffset\":20,\"componentType\":5121,\"normalized\":true,"
        "\"count\":%zu,\"type\":\"VEC4\"},"
        "{\"bufferView\":1,\"componentType\":5126,\"count\":%zu,\"type\":\"MAT4\"}],"
        "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0,\"JOINTS_0\":1,"
        "\"WEIGHTS_0\":2}}]}],\"nodes\":[{\"mesh\":0,\"skin\":0}],"
        "\"skins\":[{\"inverseBindMatrices\":3,\"joints\":[",
        total, vertex_bytes, vertex_bytes, 64 * joints, nv, nv, nv, joints);
    for (size_t j = 0; j < joints; ++j) {
        used += snprintf(json + used, sizeof(json) - (size_t)used, "%s%zu", j > 0 ? "," : "", j);
    }
    used += snprintf(json + used, sizeof(json) - (size_t)used, "]}]}");
    while (used % 4 != 0) {
        json[used++] = ' ';
    }
    const uint32_t header[5] = {0x46546C67, 2, (uint32_t)(28 + (size_t)used + total),
                                (uint32_t)used, 0x4E4F534A};
    const uint32_t chunk[2] = {(uint32_t)total, 0x004E4942};
    FILE *file = fopen(name, "wb");
    assert_non_null(file);
    fwrite(header, 1, sizeof(header), file);
    fwrite(json, 1, (size_t)used, file);
    fwrite(chunk, 1, sizeof(chunk), file);
    fwrite(bin, 1, total, file);
    assert_int_equal(fclose(file), 0);
    free(bin);
}

static void reads_what_a_studio_writes(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    write_studio_glb(path, &asset);
    pc_skin skin = {0};
    assert_ok(context, pc_skin_read_glb(context, path, &asset.visual.surface, &asset.proxy, &skin));
    assert_rows_are_sound(&skin, asset.proxy.vertex_count);
    assert_same_weights(&skin, &asset.skin, asset.proxy.vertex_count, 2.0 / 255.0);
    pc_skin_free(context, &skin);

    // Another garment, another proxy.
    asset.visual.surface.positions[30] += 0.01;
    assert_int_equal(pc_skin_read_glb(context, path, &asset.visual.surface, &asset.proxy, &skin),
                     PC_ERROR_FORMAT);
    assert_non_null(strstr(pc_context_error(context)->message, "vertex 10 "));
    asset.visual.surface.positions[30] -= 0.01;
    asset.proxy.positions[4] += 0.1;
    assert_int_equal(pc_skin_read_glb(context, path, &asset.visual.surface, &asset.proxy, &skin),
                     PC_ERROR_FORMAT);
    assert_non_null(strstr(pc_context_error(context)->message, "joint 25 "));
    asset.proxy.positions[4] -= 0.1;
    assert_int_equal(
        pc_skin_read_glb(context, "/tmp/no/such.glb", &asset.visual.surface, &asset.proxy, &skin),
        PC_ERROR_IO);
    assert_int_equal(pc_skin_read_glb(context, NULL, &asset.visual.surface, &asset.proxy, &skin),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_null(skin.bones);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

// Truncated at any length, and with bytes changed at random: refused or read, never a crash.
static void damaged_files_are_refused(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    write_studio_glb(path, &asset);
    const bytes good = read_bytes(path);
    unsigned char *changed = malloc(good.size);
    for (size_t i = 0; i < 900; ++i) {
        size_t size = good.size;
        memcpy(changed, good.data, good.size);
        if (i < 300) {
            size = i * good.size / 300;
        } else {
            // Mostly in the JSON, sometimes in numbers.
            for (size_t k = 0; k < 1 + i % 4; ++k) {
                const size_t range = i % 3 == 0 ? good.size : 1500;
                const size_t at = pci_random_bits(3, k, i) % range;
                changed[at] = (unsigned char)(i % 2 == 0 ? '0' + pci_random_bits(4, k, i) % 10
                                                         : pci_random_bits(4, k, i) % 256);
            }
        }
        write_bytes(other_path, changed, size);
        pc_skin skin = {0};
        const pc_status status =
            pc_skin_read_glb(context, other_path, &asset.visual.surface, &asset.proxy, &skin);
        assert_true(status == PC_ERROR_FORMAT || (status == PC_OK && i >= 300));
        assert_true((status == PC_OK) == (skin.bones != NULL));
        if (status == PC_OK) {
            assert_rows_are_sound(&skin, asset.proxy.vertex_count);
        }
        pc_skin_free(context, &skin);
    }
    free(changed);
    free(good.data);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

static int make_folder(void **state) {
    (void)state;
    return test_make_folder(folder, path, "weights.glb", other_path, "other.glb");
}

static int remove_folder(void **state) {
    (void)state;
    return test_remove_folder(folder, path, other_path);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_rigid_motion_is_faultless),
        cmocka_unit_test(strain_is_relative_change_of_length),
        cmocka_unit_test(the_percentile_is_that_of_all_strains),
        cmocka_unit_test(folds_are_counted),
        cmocka_unit_test(folds_at_rest_do_not_count),
        cmocka_unit_test(drift_and_ratio_compare_with_the_closest_point),
        cmocka_unit_test(only_new_crossings_count),
        cmocka_unit_test(threads_do_not_matter),
        cmocka_unit_test(refuses_what_does_not_belong_together),
        cmocka_unit_test(survives_lack_of_memory),
        cmocka_unit_test(inverse_distance_is_that_of_all_pairs),
        cmocka_unit_test(heat_solves_its_equation),
        cmocka_unit_test(reads_what_export_writes),
        cmocka_unit_test(reads_what_a_studio_writes),
        cmocka_unit_test(damaged_files_are_refused),
    };
    return cmocka_run_group_tests(tests, make_folder, remove_folder);
}
