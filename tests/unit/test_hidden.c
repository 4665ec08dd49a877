// Parts of a garment that lie on larger ones.
#include "support/test.h"

#include "stages/carve/hidden.h"
#include "support/memory.h"
#include "support/sewing.h"

static pc_mesh outfit(pc_context *context) {
    pc_mesh mesh = test_tube(context, 32, 16, 0.5, 2.0);            // the coat
    sew_add(context, &mesh, test_tube(context, 32, 16, 0.48, 1.9)); // its lining
    sew_add(context, &mesh, test_tube(context, 32, 8, 0.49, 3.0));  // what shows below
    pc_mesh button = sew_button(context, 0.02, 0.01);
    sew_move(&button, 0.5, 1.0, 0.0);
    sew_add(context, &mesh, button);
    pc_mesh ball = test_sphere(context, 3); // far away
    sew_move(&ball, 5.0, 0.0, 0.0);
    sew_add(context, &mesh, ball);
    return mesh;
}

static void drops_linings_and_buttons(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_mesh mesh = outfit(context);
    pci_scratch scratch = pci_scratch_begin(context);
    assert_ok(context, pci_drop_hidden(&scratch, "test", 0.05, &mesh));
    // The longer tube is the largest part, and the coat lies on it.
    assert_int_equal(mesh.triangle_count, 2 * 32 * 8 + 12 * 9);
    pc_mesh_free(context, &mesh);

    // Out of reach, everything stays.
    mesh = outfit(context);
    const size_t triangles = mesh.triangle_count;
    assert_ok(context, pci_drop_hidden(&scratch, "test", 0.001, &mesh));
    assert_int_equal(mesh.triangle_count, triangles);
    pc_mesh_free(context, &mesh);
    pci_scratch_end(&scratch);
    pc_context_destroy(context);
}

// A lining hides nothing when it is hidden itself; of two equal sheets one stays.
static void something_always_stays(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pci_scratch scratch = pci_scratch_begin(context);
    const double above[3] = {0.0, 0.0, 0.01};
    pc_mesh sheet = test_sheet(context, 8, 8, 1.0, 1.0);
    pc_mesh both = test_union(context, &sheet, &sheet, above);
    assert_ok(context, pci_drop_hidden(&scratch, "test", 0.05, &both));
    assert_int_equal(both.triangle_count, sheet.triangle_count);
    assert_close(both.positions[2], 0.0, 0.0);

    // Triangles that are not welded do not hide each other.
    sew_crack(context, &sheet, 1e-4);
    assert_ok(context, pci_drop_hidden(&scratch, "test", 0.5, &sheet));
    assert_int_equal(sheet.triangle_count, 128);
    pc_mesh_free(context, &sheet);
    pc_mesh_free(context, &both);
    pci_scratch_end(&scratch);
    pc_context_destroy(context);
}

static void survives_a_lack_of_memory(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    pc_mesh mesh = outfit(context);
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        counter.fail_at = 0;
        pc_mesh copy = sew_offset(context, &mesh, 0.0, false);
        pci_scratch scratch = pci_scratch_begin(context);
        fail_allocation(&counter, s.number);
        s.status = pci_drop_hidden(&scratch, "test", 0.05, &copy);
        pci_scratch_end(&scratch);
        pc_mesh_free(context, &copy);
    }
    assert_true(s.failures > 15);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
    assert_int_equal(counter.live, 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(drops_linings_and_buttons),
        cmocka_unit_test(something_always_stays),
        cmocka_unit_test(survives_a_lack_of_memory),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
