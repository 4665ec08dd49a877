// The part of the cloth that others are put onto.
#include "support/test.h"

#include "stages/carve/visual_layer.h"
#include "support/memory.h"
#include "support/sewing.h"

static const double cell_size = 0.1;

// A tube with a collar around it, that stands off so far, and with a closed pouch.
static pc_mesh belt(pc_context *context, double collar, double pouch) {
    pc_mesh mesh = test_tube(context, 32, 16, 1.0, 4.0);
    pc_mesh ring = test_tube(context, 32, 4, 1.0 + collar, 0.4);
    sew_move(&ring, 0.0, 1.0, 0.0);
    sew_add(context, &mesh, ring);
    pc_mesh ball = test_sphere(context, 4);
    for (size_t i = 0; i < 3 * ball.vertex_count; ++i) {
        ball.positions[i] *= 0.5 * pouch;
    }
    sew_move(&ball, 1.0 + 0.5 * pouch, 0.5, 0.0);
    sew_add(context, &mesh, ball);
    return mesh;
}

static pc_status bare(pc_context *context, const pc_mesh *mesh, double thickness, pc_mesh *layer,
                      bool *covers) {
    pci_scratch scratch = pci_scratch_begin(context);
    pci_cloth cloth = {.scratch = &scratch,
                       .stage = "test",
                       .surface = mesh,
                       .cell_size = cell_size,
                       .mesh = *mesh,
                       .thickness = thickness};
    uint64_t filled = 0;
    const pc_status status = pci_topology_build_edges(&scratch, mesh, &cloth.edges)
                                 ? pci_bare_layer(&cloth, layer, &filled, covers)
                                 : pci_fail_memory(context, "test");
    pci_scratch_end(&scratch);
    return status;
}

static void takes_off_what_is_put_on(void **state) {
    (void)state;
    const struct {
        double collar, pouch; // how far they stand out, in voxels
        size_t triangles;     // of what is left
        bool covers;
    } cases[] = {{2.5, 2.5, 1024, true}, {4.0, 2.5, 0, false}, {2.5, 4.0, 1024, false}};
    pc_context *context = test_context(2);
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); ++i) {
        pc_mesh mesh = belt(context, cases[i].collar * cell_size, cases[i].pouch * cell_size);
        pc_mesh layer = {0};
        bool covers = false;
        assert_ok(context, bare(context, &mesh, 0.0, &layer, &covers));
        assert_int_equal(layer.triangle_count, cases[i].triangles);
        assert_int_equal(covers, cases[i].covers);
        pc_mesh_free(context, &layer);
        pc_mesh_free(context, &mesh);
    }
    pc_context_destroy(context);
}

// What stands off as far as shells are thick is put on; a sleeve, whose far end is an opening of
// its own, goes on from the part that it begins at, however much of it is near.
static void tells_pouches_from_sleeves(void **state) {
    (void)state;
    const struct {
        double from, to, radius, thickness; // of a tube that stands off
        size_t triangles;
    } cases[] = {{1.4, 1.5, 0.2, 0.0, 0},
                 {1.4, 1.5, 0.2, 0.15, 0},
                 {1.4, 1.5, 0.2, 0.25, 1024},
                 {1.0, 1.25, 0.2, 0.0, 1024},
                 {1.0, 1.5, 0.2, 0.0, 0}};
    pc_context *context = test_context(2);
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); ++i) {
        pc_mesh mesh = test_tube(context, 32, 16, 1.0, 4.0), layer = {0};
        const double length = cases[i].to - cases[i].from;
        pc_mesh sleeve = test_tube(context, 16, 10, cases[i].radius, length);
        sew_turn(&sleeve, 2, 0.25);
        double low = INFINITY;
        for (size_t v = 0; v < sleeve.vertex_count; ++v) {
            low = fmin(low, sleeve.positions[3 * v]);
        }
        sew_move(&sleeve, cases[i].from - low, 2.0, 0.0);
        sew_add(context, &mesh, sleeve);
        bool covers = false;
        assert_ok(context, bare(context, &mesh, cases[i].thickness, &layer, &covers));
        assert_int_equal(layer.triangle_count, cases[i].triangles);
        pc_mesh_free(context, &layer);
        pc_mesh_free(context, &mesh);
    }
    pc_context_destroy(context);
}

// Nothing is put onto a single tube, a tube that has a ply is not plain, and a ball has no border.
static void needs_a_plain_part(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_mesh meshes[3] = {test_tube(context, 32, 16, 1.0, 2.0), test_hemmed_tube(context, 0.05),
                         test_sphere(context, 4)};
    for (size_t i = 0; i < 3; ++i) {
        pc_mesh layer = {0};
        bool covers = true;
        if (i > 0) {
            pc_mesh ball = test_sphere(context, 2);
            sew_move(&ball, 9.0, 0.0, 0.0);
            sew_add(context, &meshes[i], ball);
        }
        assert_ok(context, bare(context, &meshes[i], 0.0, &layer, &covers));
        assert_int_equal(layer.triangle_count, 0);
        assert_false(covers);
        pc_mesh_free(context, &meshes[i]);
    }
    pc_context_destroy(context);
}

static void survives_lack_of_memory(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    pc_mesh mesh = belt(context, 0.25, 0.25), layer = {0};
    bool covers = false;
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        s.status = bare(context, &mesh, 0.0, &layer, &covers);
        assert_true(s.status == PC_OK || layer.positions == NULL);
        pc_mesh_free(context, &layer);
    }
    assert_true(s.failures > 10);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
    assert_int_equal(counter.live, 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(takes_off_what_is_put_on),
        cmocka_unit_test(tells_pouches_from_sleeves),
        cmocka_unit_test(needs_a_plain_part),
        cmocka_unit_test(survives_lack_of_memory),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
