// Straps that the labels leave out, and what else they leave out.
#include "support/test.h"

#include "stages/carve/straps.h"
#include "support/shapes.h"

// A box of voxels of size 1, with the label 1 where `kept` says.
typedef bool (*choice)(const double position[3]);

static pc_mesh make_box(pc_context *context, size_t x, size_t y, size_t z, choice kept,
                        uint8_t **labels) {
    pc_mesh box = shape_box(context, x, y, z);
    *labels = PCI_ALLOCATE(context, uint8_t, box.vertex_count);
    for (size_t v = 0; v < box.vertex_count; ++v) {
        (*labels)[v] = kept(&box.positions[3 * v]);
    }
    return box;
}

static size_t count_kept(const pc_mesh *mesh, const uint8_t *labels) {
    size_t count = 0;
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        count += labels[v];
    }
    return count;
}

static bool at_the_ends(const double p[3]) { return p[1] < 4.0 || p[1] > 26.0; }
static bool on_top(const double p[3]) { return p[1] > 0.0; }
static bool at_the_bottom(const double p[3]) { return p[1] < 0.5; }

static void keep_straps(pci_scratch *scratch, const pc_mesh *mesh, uint8_t *labels) {
    pci_bvh *tree = NULL;
    assert_ok(scratch->context, pci_keep_straps(scratch, "test", mesh, 1.0, labels, &tree));
    pci_bvh_destroy(scratch->context, tree);
}

// The middle of a rod comes back, all around, whether thin or thick.
static void straps_are_kept(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pci_scratch scratch = pci_scratch_begin(context);
    for (size_t width = 1; width <= 6; width += 5) {
        uint8_t *labels = NULL;
        pc_mesh rod = make_box(context, width, 30, width, at_the_ends, &labels);
        assert_true(count_kept(&rod, labels) < rod.vertex_count / 2);
        keep_straps(&scratch, &rod, labels);
        assert_int_equal(count_kept(&rod, labels), rod.vertex_count);
        pc_release(context, labels);
        pc_mesh_free(context, &rod);
    }
    pci_scratch_end(&scratch);
    pc_context_destroy(context);
}

// The other side of a sheet is near what is kept. The floor of a thick solid is not, but what lies
// across is kept. Nothing is asked where nothing is kept.
static void other_sides_are_left_out(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pci_scratch scratch = pci_scratch_begin(context);
    const struct {
        size_t size[3];
        choice kept;
    } cases[] = {{{12, 1, 12}, on_top}, {{12, 2, 12}, on_top}, {{24, 8, 24}, at_the_bottom}};
    for (size_t i = 0; i < 3; ++i) {
        uint8_t *labels = NULL;
        const size_t *n = cases[i].size;
        pc_mesh box = make_box(context, n[0], n[1], n[2], cases[i].kept, &labels);
        const size_t before = count_kept(&box, labels);
        keep_straps(&scratch, &box, labels);
        assert_int_equal(count_kept(&box, labels), before);
        memset(labels, 0, box.vertex_count);
        keep_straps(&scratch, &box, labels);
        assert_int_equal(count_kept(&box, labels), 0);
        pc_release(context, labels);
        pc_mesh_free(context, &box);
    }
    pci_scratch_end(&scratch);
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(straps_are_kept),
        cmocka_unit_test(other_sides_are_left_out),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
