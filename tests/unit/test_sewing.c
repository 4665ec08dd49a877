// Garments that are worn over each other: what is cut away and what is sewn together.
#include "support/test.h"

#include "geometry/manifold.h"
#include "proxycloth/carve.h"
#include "stages/carve/sewing.h"
#include "support/manifold.h"
#include "support/memory.h"
#include "support/surfaces.h"

static const double nowhere[3] = {0.0, 0.0, 0.0};

// Trousers of one leg, 1 high, and a shirt around them, `gap` wider, from 0.85 to 2. `open`: the
// shirt is buttoned up in front, where its edges meet nearly.
static pc_mesh outfit(pc_context *context, double gap, bool open) {
    pc_mesh leg = test_tube(context, 40, 12, 0.5, 1.0);
    pc_mesh shirt = test_grid(context, 36, 14, !open, false);
    for (size_t v = 0; v < shirt.vertex_count; ++v) {
        double *p = &shirt.positions[3 * v];
        const double angle = 2.0 * acos(-1.0) * (open ? 0.001 + 0.998 * p[0] : p[0]);
        p[0] = (0.5 + gap) * cos(angle), p[1] = 0.85 + 1.15 * p[1];
        p[2] = -(0.5 + gap) * sin(angle);
    }
    pc_mesh both = test_union(context, &leg, &shirt, nowhere);
    pc_mesh_free(context, &leg);
    pc_mesh_free(context, &shirt);
    return both;
}

static bool sew(pc_context *context, pc_mesh *mesh, double reach, size_t *components,
                size_t *loop_count) {
    pci_scratch scratch = pci_scratch_begin(context);
    pci_topology topology;
    bool sewn = false;
    size_t *offsets = NULL;
    uint32_t *loops = NULL;
    assert_ok(context, pci_sew_parts(&scratch, "test", reach, mesh, &sewn));
    assert_true(pci_topology_build(&scratch, mesh, &topology));
    assert_manifold(mesh, &topology);
    uint32_t *component = PCI_SCRATCH(&scratch, uint32_t, mesh->triangle_count);
    assert_non_null(component);
    *components = pci_triangle_components(&scratch, mesh, &topology, component);
    assert_true(pci_boundary_loops(&scratch, mesh, &topology, loop_count, &offsets, &loops));
    pci_scratch_end(&scratch);
    return sewn;
}

static void sews_a_shirt_to_trousers(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    static const double gaps[] = {0.01, 0.05, 0.15};
    const double turn = 2.0 * acos(-1.0);
    for (int i = 0; i < 6; ++i) {
        const double gap = gaps[i / 2];
        pc_mesh mesh = outfit(context, gap, i % 2 == 1);
        size_t components = 0, loops = 0;
        assert_true(sew(context, &mesh, 0.2, &components, &loops));
        assert_int_equal(components, 1);
        assert_int_equal(loops, 2);
        // The leg up to the hem or a row of triangles less, the shirt, and the seam.
        const double least = turn * (0.5 * 0.75 + (0.5 + gap) * 1.15);
        const double most = turn * (0.5 * 0.95 + (0.5 + gap) * 1.15 + 0.5 * (gap + 0.1));
        const double area = pc_mesh_area(&mesh);
        assert_true(area > 0.98 * least && area < 1.02 * most);
        for (size_t v = 0; v < mesh.vertex_count; ++v) {
            const double *p = &mesh.positions[3 * v];
            assert_true(p[1] < 0.95 || hypot(p[0], p[2]) > 0.505);
        }
        pc_mesh_free(context, &mesh);
    }
    pc_context_destroy(context);
}

// A waistband is sewn to the skirt at its lower border, whichever comes first: the upper one runs
// the other way.
static void sews_a_skirt_to_its_waistband(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    for (int turned = 0; turned < 2; ++turned) {
        pc_mesh skirt = test_tube(context, 40, 20, 0.5, 1.0);
        pc_mesh band = test_tube(context, 36, 2, 0.52, 0.15);
        const double place[3] = {0.0, 0.9, 0.0};
        for (size_t v = 0; turned == 1 && v < band.vertex_count; ++v) { // upside down
            band.positions[3 * v + 1] = 0.15 - band.positions[3 * v + 1];
            band.positions[3 * v + 2] *= -1.0;
        }
        pc_mesh mesh = test_union(context, &skirt, &band, place);
        size_t components = 0, loops = 0;
        assert_true(sew(context, &mesh, 0.2, &components, &loops));
        assert_int_equal(components, 1);
        assert_int_equal(loops, 2);
        assert_close(pc_mesh_area(&mesh), 2.0 * acos(-1.0) * (0.5 * 0.9 + 0.52 * 0.15), 0.2);
        pc_mesh_free(context, &mesh);
        pc_mesh_free(context, &band);
        pc_mesh_free(context, &skirt);
    }
    pc_context_destroy(context);
}

// Trousers and a shirt that is buttoned up become one tube where the labels bridge a gap, and the
// front is closed.
static void closes_the_front_of_a_shirt(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pci_scratch scratch = pci_scratch_begin(context);
    pc_mesh visual = outfit(context, 0.05, true), layer = {0};
    pc_mesh skin = test_tube(context, 48, 40, 0.55, 2.0);
    pc_labels labels = {skin.vertex_count, PCI_ALLOCATE(context, uint8_t, skin.vertex_count)};
    assert_non_null(labels.labels);
    memset(labels.labels, 1, skin.vertex_count);
    for (size_t v = 0; v < skin.vertex_count; ++v) {
        double *p = &skin.positions[3 * v];
        const double share = p[1] > 0.2 && p[1] < 0.8 && p[0] > 0.3 ? 1.5 : 1.0;
        p[0] *= share, p[2] *= share;
    }
    pc_carve_report report = {0};
    assert_ok(context, pc_carve(context, &visual, &skin, &labels, 0.1, NULL, &layer, &report));
    assert_int_equal(report.source, PC_LAYER_VISUAL);
    assert_int_equal(report.components, 1);
    assert_int_equal(report.boundary_loops, 2);
    assert_close(boundary_length(context, &layer), 2.0 * acos(-1.0) * 1.05, 0.1);
    pc_mesh_free(context, &layer);
    pc_labels_free(context, &labels);
    pc_mesh_free(context, &skin);
    pc_mesh_free(context, &visual);
    pci_scratch_end(&scratch);
    pc_context_destroy(context);
}

static void leaves_other_things_alone(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    const double beside[3] = {1.05, 0.0, 0.0};
    pc_mesh leg = test_tube(context, 40, 12, 0.5, 1.0);
    // A shirt that hangs too far away, two legs, a shirt whose back is outside.
    pc_mesh meshes[] = {outfit(context, 0.3, false), test_union(context, &leg, &leg, beside),
                        outfit(context, 0.05, false)};
    for (size_t t = leg.triangle_count; t < meshes[2].triangle_count; ++t) {
        const uint32_t second = meshes[2].triangles[3 * t + 1];
        meshes[2].triangles[3 * t + 1] = meshes[2].triangles[3 * t + 2];
        meshes[2].triangles[3 * t + 2] = second;
    }
    for (size_t i = 0; i < 3; ++i) {
        const size_t triangles = meshes[i].triangle_count;
        size_t components = 0, loops = 0;
        assert_false(sew(context, &meshes[i], 0.2, &components, &loops));
        assert_int_equal(meshes[i].triangle_count, triangles);
        pc_mesh_free(context, &meshes[i]);
    }
    pc_mesh_free(context, &leg);
    pc_context_destroy(context);
}

static void survives_a_lack_of_memory(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        counter.fail_at = 0;
        pc_mesh mesh = outfit(context, 0.05, true);
        bool sewn = false;
        pci_scratch scratch = pci_scratch_begin(context);
        fail_allocation(&counter, s.number);
        s.status = pci_sew_parts(&scratch, "test", 0.2, &mesh, &sewn);
        assert_true(sewn == (s.status == PC_OK));
        pci_scratch_end(&scratch);
        pc_mesh_free(context, &mesh);
    }
    assert_true(s.failures > 15);
    pc_context_destroy(context);
    assert_int_equal(counter.live, 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(sews_a_shirt_to_trousers),
        cmocka_unit_test(sews_a_skirt_to_its_waistband),
        cmocka_unit_test(closes_the_front_of_a_shirt),
        cmocka_unit_test(leaves_other_things_alone),
        cmocka_unit_test(survives_a_lack_of_memory),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
