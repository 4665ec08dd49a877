// Cloth modelled with its thickness: what is peeled, and what is a solid.
#include "support/test.h"

#include "geometry/manifold.h"
#include "stages/carve/shells.h"
#include "support/manifold.h"
#include "support/memory.h"
#include "support/sewing.h"

// Peels a repaired copy; returns the thickness.
static double peel(pc_context *context, const pc_mesh *mesh, double thickest, pc_mesh *peeled) {
    pci_scratch scratch = pci_scratch_begin(context);
    pci_repair_counts counts;
    pci_topology topology;
    double thickness = -1.0;
    assert_true(pci_mesh_repair(&scratch, mesh, NULL, peeled, &counts));
    assert_true(pci_topology_build_edges(&scratch, peeled, &topology));
    assert_ok(context, pci_peel_shells(&scratch, "test", thickest, &topology, peeled, &thickness));
    assert_true(pci_topology_build(&scratch, peeled, &topology));
    assert_manifold(peeled, &topology);
    pci_scratch_end(&scratch);
    return thickness;
}

static size_t count_loops(pc_context *context, const pc_mesh *mesh) {
    pci_scratch scratch = pci_scratch_begin(context);
    pci_topology topology;
    size_t count = 0, *offsets = NULL;
    uint32_t *loops = NULL;
    assert_true(pci_topology_build(&scratch, mesh, &topology));
    assert_true(pci_boundary_loops(&scratch, mesh, &topology, &count, &offsets, &loops));
    pci_scratch_end(&scratch);
    return count;
}

// The outer skin of a thick tube, whatever the winding of its triangles.
static void peels_the_outer_skin(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    for (int mess = 0; mess < 3; ++mess) {
        pc_mesh tube = test_tube(context, 48, 16, 0.5, 1.5), peeled = {0};
        const double area = pc_mesh_area(&tube);
        const size_t triangles = tube.triangle_count;
        sew_thicken(context, &tube, 0.05); // inwards
        if (mess == 1) {
            sew_flip_patches(&tube, 37);
        }
        for (size_t i = 0; mess == 2 && i < tube.triangle_count; ++i) { // inside out
            const uint32_t second = tube.triangles[3 * i + 1];
            tube.triangles[3 * i + 1] = tube.triangles[3 * i + 2];
            tube.triangles[3 * i + 2] = second;
        }
        const double thickness = peel(context, &tube, 0.1, &peeled);
        assert_true(thickness >= 0.05 && thickness <= 0.1);
        assert_int_equal(peeled.triangle_count, triangles);
        assert_close(pc_mesh_area(&peeled), area, 1e-9);
        assert_int_equal(count_loops(context, &peeled), 2);
        pc_mesh_free(context, &peeled);
        pc_mesh_free(context, &tube);
    }
    pc_context_destroy(context);
}

// A dent in the skin is no part of the rim.
static void keeps_dents(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh sheet = test_sheet(context, 20, 20, 1.0, 1.0), peeled = {0};
    sew_thicken(context, &sheet, 0.05);
    for (size_t v = 0; v < sheet.vertex_count; ++v) { // one vertex of the larger side
        double *p = &sheet.positions[3 * v];
        p[2] += p[2] > -0.01 && fabs(p[0] - 0.5) + fabs(p[1] - 0.5) < 1e-6 ? 0.1 : 0.0;
    }
    assert_true(peel(context, &sheet, 0.1, &peeled) > 0.0);
    assert_int_equal(peeled.triangle_count, 800);
    assert_int_equal(count_loops(context, &peeled), 1);
    pc_mesh_free(context, &peeled);
    pc_mesh_free(context, &sheet);
    pc_context_destroy(context);
}

static void leaves_other_things_alone(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh ball = test_sphere(context, 8), thick = test_tube(context, 48, 16, 0.5, 1.5);
    pc_mesh sheet = test_sheet(context, 8, 8, 1.0, 1.0), torus = test_torus(context, 40, 12, 1, .1);
    sew_thicken(context, &thick, 0.2);
    // A ball, a shell that is too thick, an open sheet, and a rod without skins.
    const struct {
        const pc_mesh *mesh;
        double thickest;
    } cases[] = {{&ball, 3.0}, {&thick, 0.1}, {&sheet, 1.0}, {&torus, 0.5}};
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); ++i) {
        pc_mesh peeled = {0};
        assert_close(peel(context, cases[i].mesh, cases[i].thickest, &peeled), 0.0, 0.0);
        assert_int_equal(peeled.triangle_count, cases[i].mesh->triangle_count);
        pc_mesh_free(context, &peeled);
    }
    pc_mesh_free(context, &ball);
    pc_mesh_free(context, &thick);
    pc_mesh_free(context, &sheet);
    pc_mesh_free(context, &torus);
    pc_context_destroy(context);
}

static void survives_a_lack_of_memory(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    pc_mesh shell = test_sheet(context, 6, 6, 1.0, 1.0);
    sew_thicken(context, &shell, 0.05);
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        counter.fail_at = 0;
        pc_mesh copy = sew_offset(context, &shell, 0.0, false);
        double thickness = 0.0;
        pci_scratch scratch = pci_scratch_begin(context);
        pci_topology topology;
        fail_allocation(&counter, s.number);
        s.status = pci_topology_build_edges(&scratch, &copy, &topology)
                       ? pci_peel_shells(&scratch, "test", 0.1, &topology, &copy, &thickness)
                       : PC_ERROR_OUT_OF_MEMORY;
        pci_scratch_end(&scratch);
        pc_mesh_free(context, &copy);
    }
    assert_true(s.failures > 15);
    pc_mesh_free(context, &shell);
    pc_context_destroy(context);
    assert_int_equal(counter.live, 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(peels_the_outer_skin),
        cmocka_unit_test(keeps_dents),
        cmocka_unit_test(leaves_other_things_alone),
        cmocka_unit_test(survives_a_lack_of_memory),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
