// Which loops of a border are holes to be filled, and which are openings.
#include "support/test.h"

#include "geometry/topology.h"
#include "stages/carve/loops.h"
#include "support/surfaces.h"

static size_t count_loops(pc_context *context, const pc_mesh *mesh) {
    pci_scratch scratch = pci_scratch_begin(context);
    pci_shape shape;
    assert_true(pci_find_shape(&scratch, mesh, &shape));
    pci_scratch_end(&scratch);
    return shape.boundary_loops;
}

static size_t fill(pc_context *context, pc_mesh *mesh, const pci_hole_limits *limits) {
    pci_scratch scratch = pci_scratch_begin(context);
    uint64_t filled = 0;
    pci_topology edges;
    assert_true(pci_topology_build_edges(&scratch, mesh, &edges));
    assert_ok(context, pci_fill_loops(&scratch, "test", &edges, limits, mesh, &filled));
    pci_scratch_end(&scratch);
    return filled;
}

// Takes the triangles of a quad out of a grid of `columns`: both, or only the second one.
static void remove_quad(pc_mesh *grid, size_t columns, size_t column, size_t row, bool both) {
    const size_t first = 2 * (row * columns + column) + (both ? 0 : 1), count = both ? 2 : 1;
    memmove(&grid->triangles[3 * first], &grid->triangles[3 * (first + count)],
            3 * (grid->triangle_count - first - count) * sizeof(uint32_t));
    grid->triangle_count -= count;
}

// Triangles that a game mesh has lost are put back, whatever the voxels; wide openings stay.
static void missing_faces_are_filled(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    for (size_t missing = 0; missing < 2; ++missing) {
        const pci_hole_limits limits = {.most_edges = SIZE_MAX, .missing_faces = missing == 1};
        pc_mesh sheet = test_sheet(context, 20, 20, 1.0, 1.0);
        const size_t triangles = sheet.triangle_count;
        remove_quad(&sheet, 20, 12, 15, true);
        remove_quad(&sheet, 20, 5, 9, false);
        assert_int_equal(count_loops(context, &sheet), 3);
        assert_int_equal(fill(context, &sheet, &limits), 2 * missing);
        assert_int_equal(count_loops(context, &sheet), 3 - 2 * missing);
        assert_int_equal(sheet.triangle_count, triangles - 3 + 5 * missing); // a fan of four
        pc_mesh_free(context, &sheet);
    }
    pc_context_destroy(context);
}

// The ends of a sleeve of few edges, the neck of a coarse poncho and a wider hole stay.
static void openings_are_no_missing_faces(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    const pci_hole_limits limits = {.most_edges = SIZE_MAX, .missing_faces = true};
    for (uint32_t around = 3; around <= 6; ++around) {
        pc_mesh sleeve = test_tube(context, around, 40, 0.05, 4.0);
        assert_int_equal(fill(context, &sleeve, &limits), 0);
        pc_mesh_free(context, &sleeve);
    }
    pc_mesh poncho = test_sheet(context, 5, 5, 1.0, 1.0);
    remove_quad(&poncho, 5, 2, 2, true);
    assert_int_equal(fill(context, &poncho, &limits), 0);
    pc_mesh_free(context, &poncho);
    pc_mesh sheet = test_sheet(context, 40, 40, 1.0, 1.0);
    remove_quad(&sheet, 40, 21, 20, true);
    remove_quad(&sheet, 40, 20, 20, true);
    remove_quad(&sheet, 40, 19, 20, true);
    assert_int_equal(count_loops(context, &sheet), 2);
    assert_int_equal(fill(context, &sheet, &limits), 0);
    pc_mesh_free(context, &sheet);
    pc_context_destroy(context);
}

// What a layer was cut from goes on across a hole; it goes around an opening, as beside a strap.
static void the_whole_tells_holes_from_openings(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    for (size_t opening = 0; opening < 2; ++opening) {
        pc_mesh layer = test_sheet(context, 20, 20, 1.0, 1.0);
        pc_mesh whole = test_sheet(context, 20, 20, 1.0, 1.0);
        for (size_t column = 12; column-- > 10;) {
            remove_quad(&layer, 20, column, 10, true);
            if (opening == 1) {
                remove_quad(&whole, 20, column, 10, true);
            }
        }
        pci_bvh *tree = NULL;
        const pci_hole_limits limits = {
            .most_edges = 12, .longest = INFINITY, .whole = &whole, .tree = &tree};
        assert_int_equal(fill(context, &layer, &limits), 1 - opening);
        assert_int_equal(count_loops(context, &layer), 1 + opening);
        pci_bvh_destroy(context, tree);
        pc_mesh_free(context, &whole);
        pc_mesh_free(context, &layer);
    }
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(missing_faces_are_filled),
        cmocka_unit_test(openings_are_no_missing_faces),
        cmocka_unit_test(the_whole_tells_holes_from_openings),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
