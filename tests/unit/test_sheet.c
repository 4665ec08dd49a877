// The one of several layers that a garment strays from least.
#include "support/test.h"

#include "proxycloth/carve.h"
#include "stages/carve/visual_layer.h"
#include "support/memory.h"
#include "support/sewing.h"

static const double cell_size = 0.1;

// Layers of a skirt from the innermost one, each so much wider at the hem.
static pc_mesh skirt(pc_context *context, int layers, double gap) {
    pc_mesh mesh = {0};
    for (int i = 0; i < layers; ++i) {
        pc_mesh tube = test_tube(context, 40, 12, 1.0, 2.0);
        for (size_t v = 0; v < tube.vertex_count; ++v) {
            double *p = &tube.positions[3 * v];
            const double radius = 1.0 + i * (0.02 + gap * (1.0 - 0.5 * p[1]));
            p[0] *= radius, p[2] *= radius;
        }
        sew_add(context, &mesh, tube);
    }
    return mesh;
}

static pc_status find_sheet(pc_context *context, const pc_mesh *mesh, double alone, double among,
                            double *distance, pc_mesh *layer) {
    pci_scratch scratch = pci_scratch_begin(context);
    pci_cloth cloth = {.scratch = &scratch,
                       .stage = "test",
                       .surface = mesh,
                       .cell_size = cell_size,
                       .mesh = *mesh};
    uint64_t filled = 0;
    const pci_shape shape = {0}; // of no sheet
    const pc_status status =
        pci_topology_build_edges(&scratch, mesh, &cloth.edges)
            ? pci_nearest_sheet(&cloth, &shape, alone, among, distance, layer, &filled)
            : pci_fail_memory(context, "test");
    pci_scratch_end(&scratch);
    return status;
}

// Largest distance from the axis.
static double width(const pc_mesh *mesh) {
    double widest = 0.0;
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        widest = fmax(widest, hypot(mesh->positions[3 * v], mesh->positions[3 * v + 2]));
    }
    return widest;
}

static void finds_the_layer_in_the_middle(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    for (int layers = 3; layers <= 5; layers += 2) {
        pc_mesh mesh = skirt(context, layers, 0.25), layer = {0};
        const double inside = layers / 2, wanted = inside * 0.27 * 2.0 / hypot(2.0, 0.25 * inside);
        double distance = 0.0, other = 0.0;
        assert_ok(context, find_sheet(context, &mesh, 0.0, INFINITY, &distance, &layer));
        assert_close(width(&layer), 1.0 + 0.27 * inside, 1e-9);
        assert_true(distance > wanted && distance <= 0.27 * inside + 0.01);
        pc_mesh_free(context, &layer);
        // Nothing that is nearer.
        assert_ok(context, find_sheet(context, &mesh, distance, distance, &other, &layer));
        assert_int_equal(layer.triangle_count, 0);
        pc_mesh_free(context, &mesh);
    }
    pc_context_destroy(context);
}

// A ball has no border, and the second ply of a hem is cut off. A sheet is alone, and one with
// something small beside it.
static void needs_a_sheet(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_mesh ball = test_sphere(context, 8), tube = test_hemmed_tube(context, 0.05), layer = {0};
    double distance = 0.0;
    assert_ok(context, find_sheet(context, &ball, INFINITY, INFINITY, &distance, &layer));
    assert_int_equal(layer.triangle_count, 0);
    assert_ok(context, find_sheet(context, &tube, INFINITY, 0.0, &distance, &layer));
    assert_true(layer.triangle_count > 0 && layer.triangle_count < tube.triangle_count);
    pc_mesh_free(context, &layer);
    for (int i = 0; i < 2; ++i) {
        assert_ok(context, find_sheet(context, &tube, 0.0, 0.5, &distance, &layer));
        assert_int_equal(layer.triangle_count, 0);
        pc_mesh patch = test_tube(context, 8, 2, 0.2, 0.4);
        sew_add(context, &tube, patch);
    }
    pc_mesh_free(context, &tube);
    pc_mesh_free(context, &ball);
    pc_context_destroy(context);
}

// The labels keep the outermost layer. It stays while all others are near.
static void is_the_layer_where_the_labels_leave_out_much(void **state) {
    (void)state;
    static const struct {
        double gap;
        uint32_t source;
        double width;
    } cases[] = {{0.15, PC_LAYER_VISUAL, 1.34}, {0.02, PC_LAYER_LABELS, 1.16}};
    pc_context *context = test_context(2);
    for (size_t i = 0; i < 2; ++i) {
        pc_mesh visual = skirt(context, 5, cases[i].gap), layer = {0};
        pc_mesh skin = skirt(context, 5, cases[i].gap);
        const size_t vertices = skin.vertex_count / 5, triangles = skin.triangle_count / 5;
        pc_labels labels = {vertices, PCI_ALLOCATE(context, uint8_t, vertices)};
        pc_carve_report report = {0};
        assert_non_null(labels.labels);
        memset(labels.labels, 1, vertices);
        for (size_t k = 0; k < 3 * triangles; ++k) { // the outermost layer alone
            skin.triangles[k] = skin.triangles[12 * triangles + k] - (uint32_t)(4 * vertices);
        }
        memmove(skin.positions, &skin.positions[12 * vertices], 3 * vertices * sizeof(double));
        const pc_mesh outermost = {vertices, skin.positions, triangles, skin.triangles};
        assert_ok(context, pc_carve(context, &visual, &outermost, &labels, cell_size, NULL, &layer,
                                    &report));
        assert_int_equal(report.source, cases[i].source);
        assert_int_equal(report.components, 1);
        assert_int_equal(report.boundary_loops, 2);
        assert_close(width(&layer), cases[i].width, 0.02);
        pc_mesh_free(context, &layer);
        pc_labels_free(context, &labels);
        pc_mesh_free(context, &skin);
        pc_mesh_free(context, &visual);
    }
    pc_context_destroy(context);
}

static void survives_lack_of_memory(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    pc_mesh mesh = skirt(context, 3, 0.25), layer = {0};
    double distance = 0.0;
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        s.status = find_sheet(context, &mesh, 0.0, INFINITY, &distance, &layer);
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
        cmocka_unit_test(finds_the_layer_in_the_middle),
        cmocka_unit_test(needs_a_sheet),
        cmocka_unit_test(is_the_layer_where_the_labels_leave_out_much),
        cmocka_unit_test(survives_lack_of_memory),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
