// The cloth without what is put onto it.
#include "support/test.h"

#include "stages/carve/visual_layer.h"
#include "support/memory.h"
#include "support/sewing.h"

static const double cell_size = 0.1;

// A tube with a collar around it, that stands off so far, and with a closed pouch.
static pc_mesh belt(pc_context *context, double collar, double pouch) {
    pc_mesh mesh = test_tube(context, 32, 16, 1.0, 2.0);
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

static pc_status bare(pc_context *context, const pc_mesh *mesh, pc_mesh *layer) {
    pci_scratch scratch = pci_scratch_begin(context);
    uint64_t filled = 0;
    const pc_status status =
        pci_bare_layer(&scratch, "test", mesh, mesh, 0.0, cell_size, layer, &filled);
    pci_scratch_end(&scratch);
    return status;
}

static void takes_off_what_is_near(void **state) {
    (void)state;
    const struct {
        double collar, pouch; // how far they stand out, in voxels
        size_t triangles;     // of what is left
    } cases[] = {{2.5, 2.5, 1024}, {4.0, 2.5, 1280}, {2.5, 4.0, 0}};
    pc_context *context = test_context(2);
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); ++i) {
        pc_mesh mesh = belt(context, cases[i].collar * cell_size, cases[i].pouch * cell_size);
        pc_mesh layer = {0};
        assert_ok(context, bare(context, &mesh, &layer));
        assert_int_equal(layer.triangle_count, cases[i].triangles);
        pc_mesh_free(context, &layer);
        pc_mesh_free(context, &mesh);
    }
    // With nothing on it, it is not asked for.
    pc_mesh tube = test_tube(context, 32, 16, 1.0, 2.0), layer = {0};
    assert_ok(context, bare(context, &tube, &layer));
    assert_int_equal(layer.triangle_count, 0);
    pc_mesh_free(context, &tube);
    pc_context_destroy(context);
}

static void survives_lack_of_memory(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    pc_mesh mesh = belt(context, 0.25, 0.25), layer = {0};
    const size_t live = counter.live;
    size_t failures = 0;
    for (;; ++failures) {
        fail_allocation(&counter, failures + 1);
        const pc_status status = bare(context, &mesh, &layer);
        if (status == PC_OK) {
            break;
        }
        assert_int_equal(status, PC_ERROR_OUT_OF_MEMORY);
        assert_int_equal(counter.live, live);
        assert_null(layer.positions);
    }
    counter.fail_at = 0;
    assert_true(failures > 10);
    pc_mesh_free(context, &layer);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
    assert_int_equal(counter.live, 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(takes_off_what_is_near),
        cmocka_unit_test(survives_lack_of_memory),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
