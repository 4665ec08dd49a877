#include "support/test.h"

#include "geometry/topology.h"
#include "stages/simplify/density.h"
#include "support/memory.h"
#include "support/proxy_shape.h"
#include "support/surfaces.h"

static void keeps_the_topology(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    const struct {
        pc_mesh mesh;
        size_t loops;
        long euler;
    } cases[] = {
        {test_sphere(context, 12), 0, 2},
        {test_tube(context, 40, 30, 1.0, 3.0), 2, 0},
        {test_sheet(context, 30, 30, 1.0, 1.0), 1, 1},
        {test_torus(context, 60, 30, 1.0, 0.4), 0, 0},
    };
    for (size_t i = 0; i < 4; ++i) {
        pc_mesh mesh = cases[i].mesh;
        pc_simplify_report report = {0};
        pc_mesh proxy = simplified(context, &mesh, 100, &report);
        const shape found = check_manifold(context, &proxy);
        assert_int_equal(proxy.vertex_count, 100);
        assert_int_equal(found.components, 1);
        assert_int_equal(found.loops, cases[i].loops);
        assert_int_equal(found.euler, cases[i].euler);
        assert_int_equal(report.vertices, 100);
        assert_int_equal(report.triangles, proxy.triangle_count);
        assert_int_equal(report.components, 1);
        assert_int_equal(report.boundary_loops, cases[i].loops);
        assert_int_equal(report.shortfall, PC_SHORTFALL_NONE);
        assert_int_equal(report.self_intersections, 0);
        assert_true(found.angle_mean > 47.0 && found.angle_worst > 20.0);
        pc_mesh_free(context, &proxy);
    }
    pc_context_destroy(context);
}

static void reaches_any_vertex_count(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    static const uint32_t counts[] = {4, 5, 6, 7, 9, 13, 32, 77, 128, 500, 3000};
    for (size_t i = 0; i < sizeof(counts) / sizeof(counts[0]); ++i) {
        pc_mesh sheet = test_sheet(context, 20, 20, 1.0, 1.0), ball = test_sphere(context, 8);
        pc_mesh proxy = simplified(context, &sheet, counts[i], NULL);
        assert_int_equal(proxy.vertex_count, counts[i]);
        assert_int_equal(check_manifold(context, &proxy).euler, 1);
        pc_mesh_free(context, &proxy);
        proxy = simplified(context, &ball, counts[i], NULL);
        assert_int_equal(proxy.vertex_count, counts[i]);
        assert_int_equal(check_manifold(context, &proxy).euler, 2);
        pc_mesh_free(context, &proxy);
    }
    pc_context_destroy(context);
}

// Large counts: exact, of the same topology, and even; far more clusters than the input has
// vertices.
static void reaches_large_counts(void **state) {
    (void)state;
    pc_context *context = test_context(0);
    pc_mesh torus = test_torus(context, 40, 20, 1.0, 0.4);
    pc_mesh tube = test_tube(context, 30, 30, 1.0, 3.0);
    const double offset[3] = {4.0, 0.0, 0.0};
    pc_mesh both = test_union(context, &torus, &tube, offset);
    pc_simplify_report report = {0};
    pc_mesh proxy = simplified(context, &both, 6000, &report);
    const shape found = check_manifold(context, &proxy);
    assert_int_equal(proxy.vertex_count, 6000);
    assert_int_equal(found.components, 2);
    assert_int_equal(found.loops, 2);
    assert_int_equal(found.euler, 0);
    assert_true(found.angle_mean > 48.0);
    assert_int_equal(report.shortfall, PC_SHORTFALL_NONE);
    pc_mesh_free(context, &proxy);
    pc_mesh_free(context, &torus);
    pc_mesh_free(context, &tube);
    pc_context_destroy(context);
}

// Bristles: length without area. Seeds that are packed by area alone would run out on them.
static void shares_clusters_with_thin_strips(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh mesh = test_sheet(context, 10, 10, 1.0, 1.0);
    for (size_t i = 0; i < 6; ++i) {
        pc_mesh strip = test_sheet(context, 400, 1, 40.0, 0.001);
        const double offset[3] = {2.0, 0.1 * (double)i, 0.0};
        pc_mesh both = test_union(context, &mesh, &strip, offset);
        pc_mesh_free(context, &mesh);
        pc_mesh_free(context, &strip);
        mesh = both;
    }
    pc_mesh proxy = simplified(context, &mesh, 40, NULL);
    assert_int_equal(proxy.vertex_count, 40);
    assert_int_equal(check_manifold(context, &proxy).components, 7);
    pc_mesh_free(context, &proxy);
    pc_context_destroy(context);
}

// A tube needs six vertices; fewer cannot carry it and the report says so.
static void says_why_it_falls_short(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_simplify_report report = {0};
    pc_mesh tube = test_tube(context, 20, 20, 1.0, 1.0);
    pc_mesh proxy = simplified(context, &tube, 4, &report);
    assert_int_equal(proxy.vertex_count, 6);
    assert_int_equal(report.shortfall, PC_SHORTFALL_TOPOLOGY);
    assert_int_equal(check_manifold(context, &proxy).loops, 2);
    pc_mesh_free(context, &proxy);

    // Of two parts the small one would get less than one vertex, and three are too many for it.
    pc_mesh big = test_sheet(context, 20, 20, 1.0, 1.0),
            small = test_sheet(context, 4, 4, 0.1, 0.1);
    const double offset[3] = {2.0, 0.0, 0.0};
    pc_mesh both = test_union(context, &big, &small, offset);
    proxy = simplified(context, &both, 20, &report);
    assert_int_equal(proxy.vertex_count, 20);
    assert_int_equal(report.shortfall, PC_SHORTFALL_BUDGET);
    assert_int_equal(report.dropped_parts, 1);
    assert_int_equal(check_manifold(context, &proxy).components, 1);
    pc_mesh_free(context, &proxy);
    both = test_union(context, &big, &small, offset);
    proxy = simplified(context, &both, 32, &report); // here they are a tenth of the budget
    assert_int_equal(proxy.vertex_count, 32);
    assert_int_equal(report.dropped_parts, 0);
    assert_int_equal(check_manifold(context, &proxy).components, 2);
    pc_mesh_free(context, &proxy);
    pc_mesh_free(context, &big);
    pc_mesh_free(context, &small);
    pc_context_destroy(context);
}

static void shares_the_budget_between_parts(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh big = test_sheet(context, 30, 30, 1.0, 1.0),
            half = test_sheet(context, 20, 20, 0.5, 1.0);
    const double offset[3] = {3.0, 0.0, 0.0};
    pc_mesh both = test_union(context, &big, &half, offset);
    pc_mesh proxy = simplified(context, &both, 120, NULL);
    const shape found = check_manifold(context, &proxy);
    assert_int_equal(found.components, 2);
    assert_int_equal(found.loops, 2);
    size_t right = 0;
    for (size_t v = 0; v < proxy.vertex_count; ++v) {
        right += proxy.positions[3 * v] > 2.0;
    }
    assert_in_range(right, 34, 48); // a third of the area
    pc_mesh_free(context, &proxy);
    pc_mesh_free(context, &big);
    pc_mesh_free(context, &half);
    pc_context_destroy(context);
}

// A strap far narrower than a cluster between two sheets stays a strip of triangles.
static void keeps_a_narrow_strap(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh mesh = test_sheet(context, 120, 40, 3.0, 1.0);
    uint8_t *keep = PCI_ALLOCATE(context, uint8_t, mesh.triangle_count);
    for (size_t t = 0; t < mesh.triangle_count; ++t) {
        const double *p = &mesh.positions[3 * (size_t)mesh.triangles[3 * t]];
        keep[t] = p[0] < 0.999 || p[0] > 1.999 || (p[1] > 0.449 && p[1] < 0.499);
    }
    pci_scratch scratch = pci_scratch_begin(context);
    pc_mesh strapped = {0};
    assert_true(pci_mesh_compact(&scratch, &mesh, keep, &strapped, NULL));
    pci_scratch_end(&scratch);
    pc_mesh proxy = simplified(context, &strapped, 40, NULL);
    const shape found = check_manifold(context, &proxy);
    assert_int_equal(proxy.vertex_count, 40);
    assert_int_equal(found.components, 1);
    assert_int_equal(found.loops, 1);
    assert_int_equal(found.euler, 1);
    assert_true(found.angle_worst > 20.0);
    pc_mesh_free(context, &proxy);
    pc_mesh_free(context, &mesh);
    pc_release(context, keep);
    pc_context_destroy(context);
}

// Ribbons much narrower than the clusters of the sheet that they hang on become clean strips that
// keep their length.
static void ribbons_are_strips_of_good_triangles(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    static const double widths[] = {0.07, 0.1, 0.15, 0.2, 0.3};
    for (size_t i = 0; i < sizeof(widths) / sizeof(widths[0]); ++i) {
        pc_mesh sheet = test_sheet(context, 20, 20, 1.0, 1.0);
        pc_mesh ribbon = test_sheet(context, 80, 2, 4.0, widths[i]);
        for (size_t v = 0; v < ribbon.vertex_count; ++v) { // narrower at the start
            ribbon.positions[3 * v + 1] *= 0.7 + 0.3 * ribbon.positions[3 * v] / 4.0;
        }
        const double offset[3] = {1.5, 0.0, 0.0};
        pc_mesh both = test_union(context, &sheet, &ribbon, offset);
        pc_mesh proxy = simplified(context, &both, 96, NULL);
        const shape found = check_manifold(context, &proxy);
        double least = INFINITY, most = 0.0;
        for (size_t v = 0; v < proxy.vertex_count; ++v) {
            if (proxy.positions[3 * v] > 1.2) {
                least = fmin(least, proxy.positions[3 * v]);
                most = fmax(most, proxy.positions[3 * v]);
            }
        }
        assert_int_equal(found.components, 2);
        assert_int_equal(found.loops, 2);
        assert_int_equal(proxy.vertex_count, 96);
        assert_true(found.angle_worst > 20.0);
        assert_true(least < 1.5 + 0.1 && most > 5.5 - 0.1);
        pc_mesh_free(context, &proxy);
        pc_mesh_free(context, &both);
        pc_mesh_free(context, &sheet);
        pc_mesh_free(context, &ribbon);
    }
    pc_context_destroy(context);
}

// A sleeve whose circumference is about two clusters stays a tube with at least three edges around.
// Belts of one to three rows of triangles: clusters at the border must be half as deep as others.
static void belts_are_rows_of_good_triangles(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    static const double heights[] = {0.12, 0.16, 0.2, 0.24, 0.28, 0.32, 0.36, 0.4};
    const size_t count = sizeof(heights) / sizeof(heights[0]);
    double sum = 0.0;
    for (size_t i = 0; i < count; ++i) {
        pc_mesh belt = test_tube(context, 128, 4, 1.0, heights[i]);
        pc_mesh proxy = simplified(context, &belt, 128, NULL);
        const shape found = check_manifold(context, &proxy);
        assert_int_equal(found.loops, 2);
        sum += found.angle_mean;
        pc_mesh_free(context, &proxy);
    }
    assert_true(sum > 45.5 * (double)count);
    pc_context_destroy(context);
}

static void thin_tubes_stay_tubes(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    static const double radii[] = {0.03, 0.05, 0.1, 0.2};
    for (size_t i = 0; i < sizeof(radii) / sizeof(radii[0]); ++i) {
        pc_mesh sheet = test_sheet(context, 20, 20, 2.0, 2.0);
        pc_mesh tube = test_tube(context, 12, 60, radii[i], 2.0);
        const double offset[3] = {4.0, 0.0, 0.0};
        pc_mesh both = test_union(context, &sheet, &tube, offset);
        pc_mesh proxy = simplified(context, &both, 96, NULL);
        const shape found = check_manifold(context, &proxy);
        assert_int_equal(found.components, 2);
        assert_int_equal(found.loops, 3);
        assert_int_equal(found.euler, 1);
        assert_true(found.angle_worst > 20.0);
        pc_mesh_free(context, &proxy);
        pc_mesh_free(context, &both);
        pc_mesh_free(context, &sheet);
        pc_mesh_free(context, &tube);
    }
    pc_context_destroy(context);
}

// A rope without width has no area and a border without length.
static void a_rope_without_width_is_no_trouble(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh sheet = test_sheet(context, 20, 20, 2.0, 2.0);
    pc_mesh rope = test_tube(context, 12, 60, 0.0, 2.0);
    const double offset[3] = {4.0, 0.0, 0.0};
    pc_mesh both = test_union(context, &sheet, &rope, offset);
    pc_mesh proxy = simplified(context, &both, 96, NULL);
    for (size_t i = 0; i < 3 * proxy.vertex_count; ++i) {
        assert_true(isfinite(proxy.positions[i]));
    }
    assert_int_equal(proxy.vertex_count, 96);
    pc_mesh_free(context, &proxy);
    pc_mesh_free(context, &both);
    pc_mesh_free(context, &sheet);
    pc_mesh_free(context, &rope);
    pc_context_destroy(context);
}

// The proxy of a flat square lies in its plane, keeps its corners and is not turned over.
static void hems_do_not_shrink(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh sheet = test_sheet(context, 40, 40, 1.0, 1.0);
    pc_mesh proxy = simplified(context, &sheet, 64, NULL);
    double area = 0.0;
    for (size_t t = 0; t < proxy.triangle_count; ++t) {
        double ab[3], ac[3], normal[3];
        const uint32_t *corner = &proxy.triangles[3 * t];
        pci_sub(&proxy.positions[3 * (size_t)corner[1]], &proxy.positions[3 * (size_t)corner[0]],
                ab);
        pci_sub(&proxy.positions[3 * (size_t)corner[2]], &proxy.positions[3 * (size_t)corner[0]],
                ac);
        pci_cross(ab, ac, normal);
        assert_true(normal[2] > 0.0);
        area += 0.5 * normal[2];
    }
    for (size_t v = 0; v < proxy.vertex_count; ++v) {
        assert_close(proxy.positions[3 * v + 2], 0.0, 1e-12);
    }
    assert_true(area > 0.97 && area < 1.0 + 1e-12);
    pc_mesh_free(context, &proxy);
    pc_context_destroy(context);
}

// Flipped faces, a third triangle on an edge and a bow tie are repaired first.
static void repairs_its_input(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    for (uint64_t seed = 0; seed < 20; ++seed) {
        pc_mesh mesh = test_tube(context, 12, 10, 1.0, 2.0);
        for (uint64_t i = 0; i < 40; ++i) {
            const size_t t = (size_t)(pci_random(seed, 1, i) * (double)mesh.triangle_count);
            uint32_t *corner = &mesh.triangles[3 * t];
            if (i % 2 == 0) { // turn over
                const uint32_t swapped = corner[0];
                corner[0] = corner[1];
                corner[1] = swapped;
            } else { // tie to an arbitrary vertex
                corner[i % 3] = (uint32_t)(pci_random(seed, 2, i) * (double)mesh.vertex_count);
            }
        }
        pc_mesh proxy = simplified(context, &mesh, 60, NULL);
        check_manifold(context, &proxy);
        pc_mesh_free(context, &proxy);
    }
    pc_context_destroy(context);
}

static void is_deterministic(void **state) {
    (void)state;
    static const uint32_t threads[] = {1, 2, 3, 8};
    pc_mesh first = {0};
    pc_context *owner = test_context(1);
    for (size_t i = 0; i < 4; ++i) {
        pc_context *context = test_context(threads[i]);
        pc_mesh torus = test_torus(context, 40, 30, 1.0, 0.4);
        pc_mesh proxy = simplified(context, &torus, 200, NULL);
        if (i == 0) {
            torus = test_torus(owner, 40, 30, 1.0, 0.4);
            first = simplified(owner, &torus, 200, NULL);
        }
        assert_int_equal(proxy.triangle_count, first.triangle_count);
        assert_memory_equal(proxy.positions, first.positions, 3 * 200 * sizeof(double));
        assert_memory_equal(proxy.triangles, first.triangles,
                            3 * first.triangle_count * sizeof(uint32_t));
        pc_mesh_free(context, &proxy);
        pc_context_destroy(context);
    }
    pc_mesh_free(owner, &first);
    pc_context_destroy(owner);
}

// A thin tube that widens to a drum: with refinement its edges get shorter than the drum's.
static void refines_narrow_parts(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    double length[2][2] = {{0.0}}; // mean edge of the thin and the wide half, uniform and refined
    for (size_t refined = 0; refined < 2; ++refined) {
        pc_mesh tube = test_tube(context, 40, 80, 1.0, 8.0);
        for (size_t v = 0; v < tube.vertex_count; ++v) {
            double *p = &tube.positions[3 * v];
            const double radius = p[1] < 4.0 ? 0.3 : 1.5;
            p[0] *= radius, p[2] *= radius;
        }
        pc_simplify_options options = simplify_options(100);
        options.narrow_refinement = refined ? 2.0 : 1.0;
        pc_mesh proxy = {0};
        assert_ok(context, pc_simplify(context, NULL, &tube, &options, &proxy, NULL));
        check_manifold(context, &proxy);
        size_t count[2] = {0};
        for (size_t h = 0; h < 3 * proxy.triangle_count; ++h) {
            const double *a = &proxy.positions[3 * (size_t)proxy.triangles[h]];
            const double *b =
                &proxy.positions[3 * (size_t)proxy.triangles[h - h % 3 + (h + 1) % 3]];
            if (fmax(a[1], b[1]) < 3.5 || fmin(a[1], b[1]) > 4.5) {
                const size_t wide = a[1] > 4.0;
                length[refined][wide] += sqrt(pci_squared_distance(a, b));
                ++count[wide];
            }
        }
        length[refined][0] /= (double)count[0];
        length[refined][1] /= (double)count[1];
        pc_mesh_free(context, &proxy);
        pc_mesh_free(context, &tube);
    }
    assert_true(length[1][0] < 0.8 * length[0][0]);
    assert_true(length[1][0] < 0.7 * length[1][1]);
    assert_true(length[1][1] > length[0][1]);
    pc_context_destroy(context);
}

// The neighbour of v with a height between `low` and `high` above it that is least far around the y
// axis; receives how far, in radians.
static double least_turn(const pc_mesh *mesh, uint32_t v, double low, double high) {
    const double *a = &mesh->positions[3 * (size_t)v];
    double least = INFINITY;
    for (size_t h = 0; h < 3 * mesh->triangle_count; ++h) {
        const uint32_t ends[2] = {mesh->triangles[h], mesh->triangles[h - h % 3 + (h + 1) % 3]};
        for (size_t i = 0; i < 2; ++i) {
            const double *b = &mesh->positions[3 * (size_t)ends[1 - i]];
            if (ends[i] == v && b[1] - a[1] >= low && b[1] - a[1] <= high) {
                least =
                    fmin(least, fabs(atan2(a[0] * b[2] - a[2] * b[0], a[0] * b[0] + a[2] * b[2])));
            }
        }
    }
    return least;
}

// A neck gets rings of four vertices, one behind the other.
static void thin_tubes_get_rings(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh bottle = test_tube(context, 40, 80, 1.0, 8.0);
    for (size_t v = 0; v < bottle.vertex_count; ++v) {
        double *p = &bottle.positions[3 * v];
        const double radius = p[1] < 4.0 ? 0.4 : 1.5;
        p[0] *= radius, p[2] *= radius;
    }
    pc_simplify_options options;
    pc_record_set_defaults(&pc_simplify_options_record, &options);
    options.vertices = 100;
    pc_mesh proxy = {0};
    assert_ok(context, pc_simplify(context, NULL, &bottle, &options, &proxy, NULL));
    pc_mesh_free(context, &bottle);
    check_manifold(context, &proxy);
    size_t count = 0, bottom = 0;
    double turns = 0.0;
    for (uint32_t v = 0; v < proxy.vertex_count; ++v) {
        const double height = proxy.positions[3 * (size_t)v + 1];
        if (height < 2.1) {
            ++count;
            bottom += height < 0.02;
            turns += least_turn(&proxy, v, 0.25, 1.0);
            assert_true(fabs(least_turn(&proxy, v, -0.25, 0.25) - 1.57) < 0.25);
        }
    }
    assert_true(turns < 0.25 * (double)count); // 0.79: half a cluster, a zigzag
    assert_int_equal(bottom, 4);
    assert_true(count >= 16 && count % 4 == 0);
    pc_mesh_free(context, &proxy);
    pc_context_destroy(context);
}

// Closed caps are the extremes of a shape; the proxy reaches them although no cluster's centroid
// does, and its faces stay as near as its vertices.
static void fits_faces_not_vertices(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh ball = test_sphere(context, 16);
    pc_mesh proxy = simplified(context, &ball, 60, NULL);
    double least = INFINITY, most = 0.0;
    for (size_t t = 0; t < proxy.triangle_count; ++t) {
        const uint32_t *corner = &proxy.triangles[3 * t];
        double middle[3] = {0.0};
        for (size_t c = 0; c < 3; ++c) {
            const double *p = &proxy.positions[3 * (size_t)corner[c]];
            most = fmax(most, pci_norm(p));
            for (size_t k = 0; k < 3; ++k) {
                middle[k] += p[k] / 3.0;
            }
        }
        least = fmin(least, pci_norm(middle));
    }
    // Inscribed, the faces would be about 0.1 below the sphere.
    assert_true(most > 1.02 && most < 1.09);
    assert_true(least > 0.92 && least < 1.0);
    pc_mesh_free(context, &proxy);
    pc_context_destroy(context);
}

// ---- density map --------------------------------------------------------------------------------

// A visual mesh with the same triangles as `mesh` and a color per vertex: the red channel is 1 in
// the right half, the others are 0.
static pc_visual painted_visual(pc_context *context, const pc_mesh *mesh, double middle) {
    float *colors = PCI_ALLOCATE(context, float, 4 * mesh->vertex_count);
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        colors[4 * v] = mesh->positions[3 * v] > middle ? 1.0F : 0.0F;
        colors[4 * v + 3] = 1.0F;
    }
    const pc_visual_arrays arrays = {.vertex_count = mesh->vertex_count,
                                     .positions = mesh->positions,
                                     .triangle_count = mesh->triangle_count,
                                     .triangles = mesh->triangles,
                                     .colors = colors};
    pc_visual visual = {0};
    assert_ok(context, pc_visual_create(context, &arrays, &visual, NULL));
    pc_release(context, colors);
    return visual;
}

// Mean edge length left and right of the two limits.
static void mean_edges(const pc_mesh *mesh, double left_of, double right_of, double means[2]) {
    double count[2] = {0.0};
    means[0] = means[1] = 0.0;
    for (size_t h = 0; h < 3 * mesh->triangle_count; ++h) {
        const double *a = &mesh->positions[3 * (size_t)mesh->triangles[h]];
        const double *b = &mesh->positions[3 * (size_t)mesh->triangles[h - h % 3 + (h + 1) % 3]];
        if (fmax(a[0], b[0]) < left_of || fmin(a[0], b[0]) > right_of) {
            const size_t side = fmin(a[0], b[0]) > right_of;
            means[side] += sqrt(pci_squared_distance(a, b));
            ++count[side];
        }
    }
    means[0] /= count[0], means[1] /= count[1];
}

static void edges_follow_the_density_map(void **state) {
    (void)state;
    pc_context *context = test_context(0);
    pc_mesh sheet = test_sheet(context, 40, 20, 2.0, 1.0);
    pc_visual visual = painted_visual(context, &sheet, 1.5);
    pc_simplify_options options;
    pc_record_set_defaults(&pc_simplify_options_record, &options);
    options.vertices = 300;
    const double ranges[] = {1.0, 2.0, 4.0};
    for (size_t i = 0; i < 3; ++i) {
        options.density_channel = PC_DENSITY_RED;
        options.density_range = ranges[i];
        pc_simplify_report report;
        pc_mesh proxy = {0};
        assert_ok(context, pc_simplify(context, &visual, &sheet, &options, &proxy, &report));
        assert_int_equal(proxy.vertex_count, 300);
        assert_false(report.density_ignored);
        const shape found = check_manifold(context, &proxy);
        assert_int_equal(found.euler, 1);
        assert_true(found.angle_mean > 44.0 && found.angle_worst > 18.0);
        double means[2];
        mean_edges(&proxy, 0.8, 1.6, means);
        assert_true(means[0] / means[1] > 0.85 * ranges[i]);
        assert_true(means[0] / means[1] < 1.15 * ranges[i]);
        pc_mesh_free(context, &proxy);
        // Green is 0 everywhere: even.
        options.density_channel = PC_DENSITY_GREEN;
        assert_ok(context, pc_simplify(context, &visual, &sheet, &options, &proxy, &report));
        mean_edges(&proxy, 0.8, 1.6, means);
        assert_true(means[0] / means[1] > 0.9 && means[0] / means[1] < 1.1);
        pc_mesh_free(context, &proxy);
    }
    pc_visual_free(context, &visual);
    pc_mesh_free(context, &sheet);
    pc_context_destroy(context);
}

// A small painted spot on a layer far coarser than the edges wanted there.
static void a_small_spot_gets_enough_samples(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh sheet = test_sheet(context, 20, 20, 1.0, 1.0);
    pc_visual visual = painted_visual(context, &sheet, 0.9);
    pc_simplify_options options;
    pc_record_set_defaults(&pc_simplify_options_record, &options);
    options.vertices = 200;
    options.density_channel = PC_DENSITY_RED;
    options.density_range = 16.0;
    pc_mesh proxy = {0};
    assert_ok(context, pc_simplify(context, &visual, &sheet, &options, &proxy, NULL));
    const shape found = check_manifold(context, &proxy);
    assert_int_equal(proxy.vertex_count, 200);
    assert_int_equal(found.euler, 1);
    assert_true(found.angle_mean > 40.0);
    double means[2];
    mean_edges(&proxy, 0.5, 0.94, means);
    assert_true(means[0] / means[1] > 5.0);
    pc_mesh_free(context, &proxy);
    pc_visual_free(context, &visual);
    pc_mesh_free(context, &sheet);
    pc_context_destroy(context);
}

static void a_missing_density_map_is_reported(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh sheet = test_sheet(context, 10, 10, 1.0, 1.0);
    pc_visual visual = painted_visual(context, &sheet, 0.5);
    pc_release(context, visual.colors);
    visual.colors = NULL;
    pc_simplify_options options;
    pc_record_set_defaults(&pc_simplify_options_record, &options);
    options.vertices = 30;
    pc_mesh plain = {0};
    pc_simplify_report report;
    assert_ok(context, pc_simplify(context, &visual, &sheet, &options, &plain, &report));
    assert_false(report.density_ignored);
    options.density_channel = PC_DENSITY_ALPHA;
    const pc_visual *const without[] = {&visual, NULL};
    for (size_t i = 0; i < 2; ++i) {
        pc_mesh proxy = {0};
        assert_ok(context, pc_simplify(context, without[i], &sheet, &options, &proxy, &report));
        assert_true(report.density_ignored);
        assert_memory_equal(proxy.positions, plain.positions, 90 * sizeof(double));
        pc_mesh_free(context, &proxy);
    }
    pc_mesh_free(context, &plain);
    pc_visual_free(context, &visual);
    pc_mesh_free(context, &sheet);
    pc_context_destroy(context);
}

// Certificate: nothing shrinks, no edge is too steep, and whatever was raised hangs on a neighbour.
static void gradation_is_limited_tightly(void **state) {
    (void)state;
    static const double growth = 0.3, spacing = 0.2;
    pc_context *context = test_context(1);
    pc_mesh sheet = test_sheet(context, 30, 30, 1.0, 1.0);
    pci_scratch scratch = pci_scratch_begin(context);
    pci_halfedge mesh;
    assert_true(pci_halfedge_build(&scratch, &sheet, &mesh));
    double *before = PCI_SCRATCH(&scratch, double, mesh.vertex_count);
    double *scales = PCI_SCRATCH(&scratch, double, mesh.vertex_count);
    size_t raised = 0;
    for (uint32_t v = 0; v < mesh.vertex_count; ++v) {
        before[v] = scales[v] = pci_random(3, 0, v) < 0.02 ? 16.0 : 1.0;
    }
    assert_true(pci_limit_gradation(&scratch, &mesh, spacing, scales));
    for (uint32_t v = 0; v < mesh.vertex_count; ++v) {
        double allowed = INFINITY; // the least that a neighbour asks for
        PCI_FOR_OUTGOING(&mesh, v, h) {
            const uint32_t ends[2] = {pci_target(&mesh, h), mesh.corners[pci_previous(h)]};
            for (size_t i = 0; i < 2; ++i) {
                const double way = sqrt(pci_squared_distance(&mesh.positions[3 * (size_t)v],
                                                             &mesh.positions[3 * (size_t)ends[i]]));
                allowed = fmin(allowed, spacing / scales[ends[i]] + growth * way);
            }
        }
        assert_true(scales[v] >= before[v]);
        assert_true(spacing / scales[v] <= allowed + 1e-12);
        if (scales[v] > before[v]) {
            assert_close(spacing / scales[v], allowed, 1e-12);
            ++raised;
        }
    }
    assert_true(raised > 100);
    pci_scratch_end(&scratch);
    pc_mesh_free(context, &sheet);
    pc_context_destroy(context);
}

static void survives_lack_of_memory(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    pc_mesh sheet = test_sheet(context, 4, 4, 1.0, 1.0);
    pc_simplify_options options;
    pc_record_set_defaults(&pc_simplify_options_record, &options);
    options.vertices = 12;
    options.density_channel = PC_DENSITY_RED;
    pc_visual visual = painted_visual(context, &sheet, 0.5);
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        pc_mesh proxy = {0};
        s.status = pc_simplify(context, &visual, &sheet, &options, &proxy, NULL);
        assert_int_equal(proxy.positions != NULL, s.status == PC_OK);
        pc_mesh_free(context, &proxy);
    }
    assert_true(s.failures > 50);
    pc_visual_free(context, &visual);
    pc_mesh_free(context, &sheet);
    pc_context_destroy(context);
    assert_int_equal(counter.live, 0);
}

static void can_be_cancelled(void **state) {
    (void)state;
    pc_context *context = test_cancelling_context();
    pc_mesh sheet = test_sheet(context, 4, 4, 1.0, 1.0), result = {0};
    assert_int_equal(pc_simplify(context, NULL, &sheet, NULL, &result, NULL), PC_ERROR_CANCELLED);
    assert_null(result.positions);
    pc_mesh_free(context, &sheet);
    pc_context_destroy(context);
}

static void rejects_bad_arguments(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh sheet = test_sheet(context, 2, 2, 1.0, 1.0), proxy = {0};
    pc_simplify_options options;
    pc_record_set_defaults(&pc_simplify_options_record, &options);
    assert_int_equal(pc_simplify(context, NULL, NULL, NULL, &proxy, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_simplify(context, NULL, &sheet, NULL, &sheet, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    options.vertices = 3;
    assert_int_equal(pc_simplify(context, NULL, &sheet, &options, &proxy, NULL),
                     PC_ERROR_INVALID_OPTIONS);
    options.vertices = 8;
    sheet.triangles[4] = 9;
    assert_int_equal(pc_simplify(context, NULL, &sheet, &options, &proxy, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    sheet.triangles[4] = 0;
    sheet.positions[5] = NAN;
    assert_int_equal(pc_simplify(context, NULL, &sheet, &options, &proxy, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    memset(sheet.positions, 0, 3 * sheet.vertex_count * sizeof(double));
    assert_int_equal(pc_simplify(context, NULL, &sheet, &options, &proxy, NULL), PC_ERROR_NO_PROXY);
    const pc_mesh empty = {0};
    assert_int_equal(pc_simplify(context, NULL, &empty, &options, &proxy, NULL), PC_ERROR_NO_PROXY);
    assert_null(proxy.positions);
    assert_null(proxy.triangles);
    pc_mesh_free(context, &sheet);
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(keeps_the_topology),
        cmocka_unit_test(reaches_any_vertex_count),
        cmocka_unit_test(reaches_large_counts),
        cmocka_unit_test(shares_clusters_with_thin_strips),
        cmocka_unit_test(says_why_it_falls_short),
        cmocka_unit_test(shares_the_budget_between_parts),
        cmocka_unit_test(keeps_a_narrow_strap),
        cmocka_unit_test(ribbons_are_strips_of_good_triangles),
        cmocka_unit_test(belts_are_rows_of_good_triangles),
        cmocka_unit_test(thin_tubes_stay_tubes),
        cmocka_unit_test(a_rope_without_width_is_no_trouble),
        cmocka_unit_test(hems_do_not_shrink),
        cmocka_unit_test(repairs_its_input),
        cmocka_unit_test(is_deterministic),
        cmocka_unit_test(refines_narrow_parts),
        cmocka_unit_test(thin_tubes_get_rings),
        cmocka_unit_test(fits_faces_not_vertices),
        cmocka_unit_test(edges_follow_the_density_map),
        cmocka_unit_test(a_small_spot_gets_enough_samples),
        cmocka_unit_test(a_missing_density_map_is_reported),
        cmocka_unit_test(gradation_is_limited_tightly),
        cmocka_unit_test(survives_lack_of_memory),
        cmocka_unit_test(can_be_cancelled),
        cmocka_unit_test(rejects_bad_arguments),
    };
    return cmocka_run_group_tests_name("simplify", tests, NULL, NULL);
}
