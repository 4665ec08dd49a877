// The paper's comparison: edge collapses with skinning weights in the loop.
#include "support/test.h"

#include "geometry/quadric.h"
#include "support/proxy_shape.h"
#include "support/surfaces.h"

static void random_point(uint64_t seed, uint64_t index, double point[3]) {
    for (size_t k = 0; k < 3; ++k) {
        point[k] = 2.0 * pci_random(seed, index, k) - 1.0;
    }
}

// Sums of planes are sums of squared distances, also where the point moves with another one.
static void quadrics_measure_distances(void **state) {
    (void)state;
    for (uint64_t seed = 1; seed <= 20; ++seed) {
        pci_quadric sum = {{0.0}, {0.0}, 0.0};
        double x[3], offset[3], moved[3], expected = 0.0, expected_moved = 0.0;
        const double share = pci_random(seed, 100, 0);
        random_point(seed, 101, x);
        random_point(seed, 102, offset);
        for (size_t k = 0; k < 3; ++k) {
            moved[k] = offset[k] + share * x[k];
        }
        for (uint64_t plane = 0; plane < 5; ++plane) {
            double normal[3], point[3], to[3];
            const double weight = 0.1 + pci_random(seed, 200, plane);
            random_point(seed, 2 * plane, normal);
            random_point(seed, 2 * plane + 1, point);
            assert_true(pci_normalize(normal));
            const pci_quadric q = pci_quadric_of_plane(normal, point, weight);
            pci_quadric_add(&sum, &q);
            pci_sub(x, point, to);
            expected += weight * pci_dot(to, normal) * pci_dot(to, normal);
            pci_sub(moved, point, to);
            expected_moved += weight * pci_dot(to, normal) * pci_dot(to, normal);
        }
        const pci_quadric back = pci_quadric_pulled_back(&sum, share, offset);
        assert_close(pci_quadric_value(&sum, x), expected, 1e-12);
        assert_close(pci_quadric_value(&sum, moved), expected_moved, 1e-12);
        assert_close(pci_quadric_value(&back, x), expected_moved, 1e-12);
    }
}

// The proxy of a mesh that is its own visual mesh.
static pc_mesh decimated(pc_context *context, const pc_mesh *mesh, uint32_t vertices) {
    pc_visual visual = {0};
    pc_mesh proxy = {0};
    pc_simplify_options options;
    pc_simplify_report report;
    pc_record_set_defaults(&pc_simplify_options_record, &options);
    options.vertices = vertices;
    options.method = PC_SIMPLIFY_JOINT;
    const pc_visual_arrays arrays = {.vertex_count = mesh->vertex_count,
                                     .positions = mesh->positions,
                                     .triangle_count = mesh->triangle_count,
                                     .triangles = mesh->triangles};
    assert_ok(context, pc_visual_create(context, &arrays, &visual, NULL));
    assert_ok(context, pc_simplify(context, &visual, mesh, &options, &proxy, &report));
    assert_int_equal(report.vertices, vertices);
    assert_int_equal(report.shortfall, PC_SHORTFALL_NONE);
    pc_visual_free(context, &visual);
    return proxy;
}

// Exact count, nothing non-manifold, components, loops and Euler number of the input; the same
// bytes with one thread and three.
static void keeps_the_contract(void **state) {
    (void)state;
    pc_context *context = test_context(1), *threaded = test_context(3);
    pc_mesh sheet = test_sheet(context, 12, 12, 1.0, 1.0);
    pc_mesh tube = test_tube(context, 16, 20, 0.2, 1.0);
    const double offset[3] = {2.0, 0.0, 0.0};
    pc_mesh both = test_union(context, &sheet, &tube, offset);
    const uint32_t counts[] = {24, 48};
    for (size_t i = 0; i < 2; ++i) {
        pc_mesh proxy = decimated(context, &both, counts[i]);
        pc_mesh again = decimated(threaded, &both, counts[i]);
        const shape found = check_manifold(context, &proxy);
        assert_int_equal(proxy.vertex_count, counts[i]);
        assert_int_equal(found.components, 2);
        assert_int_equal(found.loops, 3);
        assert_int_equal(found.euler, 1);
        assert_int_equal(again.triangle_count, proxy.triangle_count);
        assert_memory_equal(again.positions, proxy.positions, 3 * counts[i] * sizeof(double));
        assert_memory_equal(again.triangles, proxy.triangles,
                            3 * proxy.triangle_count * sizeof(uint32_t));
        pc_mesh_free(context, &proxy);
        pc_mesh_free(threaded, &again);
    }
    pc_mesh_free(context, &both);
    pc_mesh_free(context, &sheet);
    pc_mesh_free(context, &tube);
    pc_context_destroy(threaded);
    pc_context_destroy(context);
}

// Roofs: collapses across the ridge cost, those along it do not, so the ridge and the eaves stay.
// What is left of one roof hangs on little things, the mean over several does not.
static void keeps_creases_and_hems(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    double mean = 0.0;
    for (uint32_t cells = 12; cells <= 20; cells += 2) {
        pc_mesh roof = test_sheet(context, cells, cells, 2.0, 1.0);
        for (size_t v = 0; v < roof.vertex_count; ++v) {
            double *p = &roof.positions[3 * v];
            p[2] = -fabs(p[0] - 1.0);
        }
        pc_mesh proxy = decimated(context, &roof, 40);
        pc_measures measures;
        assert_ok(context, pc_evaluate(context, &roof, &proxy, &measures));
        mean += 0.2 * measures.hausdorff * sqrt(4.0 + 1.0 + 1.0);
        pc_mesh_free(context, &proxy);
        pc_mesh_free(context, &roof);
    }
    // Even edges would be 0.28 long, and a chord across the ridge would cut off half of that.
    assert_true(mean < 0.11);
    pc_context_destroy(context);
}

static void needs_the_visual_mesh(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh sheet = test_sheet(context, 4, 4, 1.0, 1.0), proxy = {0};
    pc_simplify_options options;
    pc_record_set_defaults(&pc_simplify_options_record, &options);
    options.method = PC_SIMPLIFY_JOINT;
    assert_int_equal(pc_simplify(context, NULL, &sheet, &options, &proxy, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_null(proxy.positions);
    pc_mesh_free(context, &sheet);
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(quadrics_measure_distances),
        cmocka_unit_test(keeps_the_contract),
        cmocka_unit_test(keeps_creases_and_hems),
        cmocka_unit_test(needs_the_visual_mesh),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
