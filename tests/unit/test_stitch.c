// Borders whose vertices lie on each other's edges.
#include "support/test.h"

#include "geometry/manifold.h"
#include "geometry/stitch.h"
#include "support/manifold.h"
#include "support/memory.h"
#include "support/sewing.h"

// Stitches and repairs a mesh; returns whether there was anything to stitch.
static bool stitch(pc_context *context, const pc_mesh *mesh, pc_mesh *whole, pci_shape *shape) {
    pci_scratch scratch = pci_scratch_begin(context);
    pci_repair_counts counts;
    pci_topology edges;
    pc_mesh stitched = {0};
    bool some = false;
    assert_true(pci_topology_build_edges(&scratch, mesh, &edges));
    assert_ok(context, pci_stitch_borders(&scratch, "test", mesh, &edges, 1e-3, &stitched, &some));
    if (some) {
        assert_true(pci_mesh_repair(&scratch, &stitched, NULL, whole, &counts));
        assert_int_equal(counts.removed_triangles, 0);
        assert_true(pci_topology_build(&scratch, whole, &edges));
        assert_manifold(whole, &edges);
        assert_true(pci_find_shape(&scratch, whole, shape));
    } else {
        assert_null(stitched.triangles);
    }
    pc_mesh_free(context, &stitched);
    pci_scratch_end(&scratch);
    return some;
}

// Two tubes on top of each other, one with 12 and one with `finer` times as many vertices on the
// seam, which is straight between those of the first.
static pc_mesh two_tubes(pc_context *context, uint32_t finer) {
    pc_mesh tube = test_tube(context, 12, 3, 0.5, 1.0);
    pc_mesh upper = test_grid(context, 12 * finer, 2, true, false);
    for (uint32_t v = 0; v < upper.vertex_count; ++v) {
        double *p = &upper.positions[3 * (size_t)v];
        const uint32_t at = v % (12 * finer), side = at / finer; // the lowest row has 12
        const double *a = &tube.positions[3 * (size_t)side];
        const double *b = &tube.positions[3 * (size_t)((side + 1) % 12)];
        const double t = (double)(at % finer) / finer;
        p[0] = a[0] + t * (b[0] - a[0]);
        p[1] += 1.0;
        p[2] = a[2] + t * (b[2] - a[2]);
    }
    sew_add(context, &tube, upper);
    sew_weld(context, &tube);
    return tube;
}

static void joins_panels(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_mesh tubes = two_tubes(context, 3), whole = {0};
    pci_shape shape;
    assert_true(stitch(context, &tubes, &whole, &shape));
    assert_int_equal(shape.components, 1);
    assert_int_equal(shape.boundary_loops, 2);
    assert_int_equal(whole.triangle_count, tubes.triangle_count + 24); // two on each of 12 edges
    assert_close(pc_mesh_area(&whole), pc_mesh_area(&tubes), 1e-9);
    pc_mesh_free(context, &whole);
    pc_mesh_free(context, &tubes);
    pc_context_destroy(context);
}

// Both sides of the seam have vertices that the other has not.
static void joins_sides_that_alternate(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh sheet = test_sheet(context, 3, 2, 1.0, 1.0), whole = {0};
    pc_mesh other = test_sheet(context, 5, 2, 1.0, 1.0);
    sew_move(&other, 0.0, 1.0, 0.0);
    sew_add(context, &sheet, other);
    pci_shape shape;
    assert_true(stitch(context, &sheet, &whole, &shape));
    assert_int_equal(shape.components, 1);
    assert_int_equal(shape.boundary_loops, 1);
    assert_int_equal(whole.triangle_count, sheet.triangle_count + 2 + 4);
    assert_close(pc_mesh_area(&whole), 2.0, 1e-9);
    pc_mesh_free(context, &whole);
    pc_mesh_free(context, &sheet);
    pc_context_destroy(context);
}

// Every choice of edges of one triangle that its neighbours cut in two or three.
static void cuts_any_edges(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    for (uint32_t choice = 1; choice < 27; ++choice) {
        static const double corners[6][2] = {{0.0, 0.0}, {1.0, 0.0},  {0.0, 1.0},
                                             {1.0, 1.0}, {-1.0, 1.0}, {1.0, -1.0}};
        static const uint32_t apex[3] = {5, 3, 4}; // beyond the edges 0-1, 1-2 and 2-0
        pc_mesh mesh = {0}, whole = {0};
        mesh.positions = PCI_ALLOCATE(context, double, 36);
        mesh.triangles = PCI_ALLOCATE(context, uint32_t, 30);
        for (size_t v = 0; v < 6; ++v) {
            memcpy(&mesh.positions[3 * v], corners[v], sizeof(corners[v]));
        }
        mesh.vertex_count = 6;
        const uint32_t middle[3] = {0, 1, 2};
        memcpy(mesh.triangles, middle, sizeof(middle));
        mesh.triangle_count = 1;
        for (uint32_t e = 0, rest = choice; e < 3; ++e, rest /= 3) {
            const uint32_t from = e, to = (e + 1) % 3, cuts = rest % 3;
            uint32_t last = to;
            for (uint32_t i = 0; i <= cuts; ++i) {
                const uint32_t next = i == cuts ? from : (uint32_t)mesh.vertex_count++;
                const double t = (double)(i + 1) / (double)(cuts + 1);
                for (size_t k = 0; k < 3; ++k) {
                    mesh.positions[3 * (size_t)next + k] =
                        mesh.positions[3 * (size_t)to + k] +
                        t * (mesh.positions[3 * (size_t)from + k] -
                             mesh.positions[3 * (size_t)to + k]);
                }
                const uint32_t piece[3] = {last, next, apex[e]};
                memcpy(&mesh.triangles[3 * mesh.triangle_count++], piece, sizeof(piece));
                last = next;
            }
        }
        const size_t extra = mesh.vertex_count - 6;
        pci_shape shape;
        assert_true(stitch(context, &mesh, &whole, &shape));
        assert_int_equal(shape.components, 1);
        assert_int_equal(shape.boundary_loops, 1);
        assert_int_equal(whole.triangle_count, mesh.triangle_count + extra);
        assert_close(pc_mesh_area(&whole), pc_mesh_area(&mesh), 1e-12);
        pc_mesh_free(context, &whole);
        pc_mesh_free(context, &mesh);
    }
    pc_context_destroy(context);
}

// Hems beside each other, and vertices at the ends of edges, are no seams.
static void leaves_the_rest(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh sheet = test_sheet(context, 3, 2, 1.0, 1.0), whole = {0};
    pc_mesh other = test_sheet(context, 5, 2, 1.0, 1.0);
    sew_move(&other, 0.0, 1.002, 0.0);
    sew_add(context, &sheet, other);
    pci_shape shape;
    assert_false(stitch(context, &sheet, &whole, &shape));
    sew_crack(context, &sheet, 1e-4);
    assert_false(stitch(context, &sheet, &whole, &shape));
    pc_mesh_free(context, &sheet);

    // Borders that cross.
    sheet = test_sheet(context, 3, 2, 1.0, 1.0);
    other = test_sheet(context, 5, 2, 1.0, 1.0);
    sew_turn(&other, 2, 0.05);
    sew_move(&other, 0.4, 1.0, 0.0);
    sew_add(context, &sheet, other);
    assert_false(stitch(context, &sheet, &whole, &shape));
    pc_mesh_free(context, &sheet);

    // A cord on an edge.
    sheet = test_sheet(context, 3, 2, 1.0, 1.0);
    other = test_sheet(context, 1, 5, 0.1, 1.0);
    sew_move(&other, 0.4, 1.0, 0.0);
    sew_add(context, &sheet, other);
    assert_false(stitch(context, &sheet, &whole, &shape));
    pc_mesh_free(context, &sheet);
    pc_context_destroy(context);
}

static void does_without_memory(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    pc_mesh tubes = two_tubes(context, 3);
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        pci_scratch scratch = pci_scratch_begin(context);
        pci_topology edges;
        pc_mesh stitched = {0};
        bool some = false;
        s.status =
            pci_topology_build_edges(&scratch, &tubes, &edges)
                ? pci_stitch_borders(&scratch, "test", &tubes, &edges, 1e-3, &stitched, &some)
                : PC_ERROR_OUT_OF_MEMORY;
        assert_true(s.status == PC_OK ? some : stitched.triangles == NULL && !some);
        pc_mesh_free(context, &stitched);
        pci_scratch_end(&scratch);
    }
    assert_true(s.failures > 5);
    pc_mesh_free(context, &tubes);
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(joins_panels),        cmocka_unit_test(joins_sides_that_alternate),
        cmocka_unit_test(cuts_any_edges),      cmocka_unit_test(leaves_the_rest),
        cmocka_unit_test(does_without_memory),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
