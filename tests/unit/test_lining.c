// Linings that hang together with the cloth: what is peeled, and what are two sides of a garment.
#include "support/test.h"

#include "stages/carve/lining.h"
#include "support/manifold.h"
#include "support/memory.h"
#include "support/surfaces.h"

static bool peel(pc_context *context, pc_mesh *mesh, double reach) {
    pci_scratch scratch = pci_scratch_begin(context);
    pci_topology topology;
    bool peeled = false;
    assert_ok(context, pci_peel_linings(&scratch, "test", NULL, reach, 0.0, mesh, &peeled));
    assert_true(pci_topology_build(&scratch, mesh, &topology));
    assert_manifold(mesh, &topology);
    pci_scratch_end(&scratch);
    return peeled;
}

// Turned in or, as a collar, to the outside, and whatever the size.
static void peels_a_turned_hem(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    static const double scales[] = {1.0, 1e-6, 1e6}, gaps[] = {0.03, 0.03, -0.03};
    for (int i = 0; i < 3; ++i) {
        pc_mesh tube = test_hemmed_tube(context, gaps[i]);
        for (size_t k = 0; k < 3 * tube.vertex_count; ++k) {
            tube.positions[k] *= scales[i];
        }
        assert_true(peel(context, &tube, 0.05 * scales[i]));
        // The tube, which is 1 high, with the turn of the cloth or without.
        const double side = 2.0 * acos(-1.0) * 0.5 * scales[i] * scales[i];
        assert_close(pc_mesh_area(&tube), side, 0.06 * side);
        double low[3], high[3];
        pci_bounding_box(&tube, low, high);
        assert_close(high[1], scales[i], 1e-9 * scales[i]);
        for (size_t v = 0; v < tube.vertex_count; ++v) {
            const double *p = &tube.positions[3 * v];
            assert_true(p[1] < 0.11 * scales[i] ||
                        fabs(hypot(p[0], p[2]) - 0.5 * scales[i]) < 0.01 * scales[i]);
        }
        pc_mesh_free(context, &tube);
    }
    pc_context_destroy(context);
}

// A hem is peeled beside a flat end, whose sides stay: without one of them it would be no tube.
static void peels_what_it_may(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_mesh tube = test_hemmed_tube(context, 0.03);
    const size_t triangles = tube.triangle_count;
    for (size_t v = 0; v < tube.vertex_count; ++v) {
        const double above = tube.positions[3 * v + 1] - 0.4;
        tube.positions[3 * v + 2] *= fmin(1.0, fmax(0.02, 1.0 - above / 0.4));
    }
    assert_true(peel(context, &tube, 0.05));
    assert_true(tube.triangle_count > triangles / 2 && tube.triangle_count < triangles);
    double side[2] = {0.0};
    for (size_t t = 0; t < tube.triangle_count; ++t) {
        double normal[3], middle[3];
        pci_triangle_vector(&tube, t, normal);
        pci_triangle_middle(&tube, t, middle);
        assert_true(middle[1] < 0.11 || middle[1] > 0.39 || hypot(middle[0], middle[2]) > 0.485);
        side[normal[2] > 0.0] += middle[1] > 0.51 ? fabs(normal[2]) : 0.0;
    }
    assert_close(side[0], side[1], 1e-6);
    assert_true(side[0] > 0.0);
    pc_mesh_free(context, &tube);
    pc_context_destroy(context);
}

static void leaves_other_things_alone(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    // A flat sleeve, a flat sheet.
    pc_mesh meshes[] = {test_tube(context, 48, 15, 0.5, 1.5), test_sheet(context, 9, 9, 1.0, 1.0)};
    for (size_t v = 0; v < meshes[0].vertex_count; ++v) {
        meshes[0].positions[3 * v + 2] *= 0.02;
    }
    for (size_t i = 0; i < 2; ++i) {
        const size_t triangles = meshes[i].triangle_count;
        assert_false(peel(context, &meshes[i], 0.05));
        assert_int_equal(meshes[i].triangle_count, triangles);
        pc_mesh_free(context, &meshes[i]);
    }
    pc_context_destroy(context);
}

static void survives_a_lack_of_memory(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        counter.fail_at = 0;
        pc_mesh tube = test_hemmed_tube(context, 0.03);
        bool peeled = false;
        pci_scratch scratch = pci_scratch_begin(context);
        fail_allocation(&counter, s.number);
        s.status = pci_peel_linings(&scratch, "test", NULL, 0.05, 0.0, &tube, &peeled);
        assert_true(peeled == (s.status == PC_OK));
        pci_scratch_end(&scratch);
        pc_mesh_free(context, &tube);
    }
    assert_true(s.failures > 15);
    pc_context_destroy(context);
    assert_int_equal(counter.live, 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(peels_a_turned_hem),
        cmocka_unit_test(peels_what_it_may),
        cmocka_unit_test(leaves_other_things_alone),
        cmocka_unit_test(survives_a_lack_of_memory),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
