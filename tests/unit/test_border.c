#include "support/test.h"

#include "geometry/bvh.h"
#include "geometry/hems.h"
#include "stages/carve/border.h"
#include "support/memory.h"
#include "support/surfaces.h"

// ---- hems -------------------------------------------------------------------------------------

static double hem_length(pc_context *context, const pc_mesh *mesh, double reach) {
    pci_scratch scratch = pci_scratch_begin(context);
    pci_bvh *bvh = NULL;
    pci_topology topology;
    pci_hems hems;
    assert_ok(context, pci_bvh_create(context, "test", mesh, &bvh));
    assert_true(pci_topology_build_edges(&scratch, mesh, &topology));
    assert_true(pci_find_hems(&scratch, mesh, &topology, bvh, reach, &hems));
    double length = 0.0;
    for (size_t i = 0; i < hems.count; ++i) {
        const double *a = &hems.points[6 * i];
        const double piece = sqrt(pci_squared_distance(a, a + 3));
        assert_true(piece <= 0.5 * reach + 1e-12);
        assert_close(pci_norm(&hems.inwards[3 * i]), 1.0, 1e-12);
        length += piece;
    }
    pci_bvh_destroy(context, bvh);
    pci_scratch_end(&scratch);
    return length;
}

static void hems_are_where_cloth_ends(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    static const double beside[3] = {1.0, 0.0, 0.0}, above[3] = {0.4, 0.4, 0.01},
                        far_above[3] = {0.4, 0.4, 0.5}, same[3] = {0.0};
    pc_mesh sheet = test_sheet(context, 10, 10, 1.0, 1.0),
            patch = test_sheet(context, 3, 3, 0.2, 0.2), tube = test_tube(context, 64, 4, 1.0, 2.0),
            ball = test_sphere(context, 8);
    assert_close(hem_length(context, &sheet, 0.05), 4.0, 1e-9);
    assert_close(hem_length(context, &tube, 0.05), 2.0 * 128.0 * sin(3.14159265358979 / 64.0),
                 1e-6);
    assert_close(hem_length(context, &ball, 0.05), 0.0, 0.0);

    // The seam of two panels with vertices of their own, a pocket, and every triangle twice.
    pc_mesh panels = test_union(context, &sheet, &sheet, beside);
    assert_close(hem_length(context, &panels, 0.05), 6.0, 1e-9);
    pc_mesh pocket = test_union(context, &sheet, &patch, above);
    assert_close(hem_length(context, &pocket, 0.05), 4.0, 1e-9);
    pc_mesh apart = test_union(context, &sheet, &patch, far_above);
    assert_close(hem_length(context, &apart, 0.05), 4.8, 1e-9);
    pc_mesh twice = test_union(context, &sheet, &sheet, same);
    for (size_t i = 0; i < 3 * twice.triangle_count; ++i) {
        twice.triangles[i] %= (uint32_t)sheet.vertex_count;
    }
    assert_close(hem_length(context, &twice, 0.05), 4.0, 1e-9);

    // A slit is an opening when it is wider than the reach.
    const double slit[3] = {1.03, 0.0, 0.0};
    pc_mesh torn = test_union(context, &sheet, &sheet, slit);
    assert_close(hem_length(context, &torn, 0.1), 6.0, 1e-9);
    assert_close(hem_length(context, &torn, 0.018), 8.0, 1e-9);

    pc_mesh *all[] = {&sheet, &patch, &tube, &ball, &panels, &pocket, &apart, &twice, &torn};
    for (size_t i = 0; i < sizeof(all) / sizeof(all[0]); ++i) {
        pc_mesh_free(context, all[i]);
    }
    pc_context_destroy(context);
}

// ---- measures ---------------------------------------------------------------------------------

static void measures_boundaries(void **state) {
    (void)state;
    pc_measures first = {0};
    static const uint32_t threads[] = {1, 2, 3, 8};
    for (size_t i = 0; i < 4; ++i) {
        pc_context *context = test_context(threads[i]);
        pc_measures m;
        // Shorter by 0.1 at the bottom and 0.2 at the top.
        pc_mesh garment = test_tube(context, 48, 20, 0.5, 2.0);
        pc_mesh proxy = test_tube(context, 48, 20, 0.5, 1.7);
        for (size_t v = 0; v < proxy.vertex_count; ++v) {
            proxy.positions[3 * v + 1] += 0.1;
        }
        const double diagonal = sqrt(1.0 + 1.0 + 4.0);
        const double around = 48.0 * 2.0 * 0.5 * sin(3.14159265358979 / 48.0);
        assert_ok(context, pc_evaluate(context, &garment, &proxy, &m));
        assert_close(m.opening_length, 2.0 * around / diagonal, 1e-6);
        assert_close(m.boundary_length, 2.0 * around / diagonal, 1e-6);
        assert_close(m.boundary_to_opening_mean, 0.15 / diagonal, 1e-9);
        assert_close(m.boundary_to_opening_max, 0.2 / diagonal, 1e-9);
        assert_close(m.opening_to_boundary_mean, 0.15 / diagonal, 1e-9);
        assert_close(m.opening_to_boundary_max, 0.2 / diagonal, 1e-9);
        if (i == 0) {
            first = m;
        }
        assert_memory_equal(&m, &first, sizeof(m));

        // Without a boundary on one or both sides.
        pc_mesh ball = test_sphere(context, 8);
        assert_ok(context, pc_evaluate(context, &garment, &ball, &m));
        assert_close(m.boundary_to_opening_max + m.opening_to_boundary_mean, 2.0, 0.0);
        assert_ok(context, pc_evaluate(context, &ball, &garment, &m));
        assert_close(m.boundary_to_opening_mean + m.opening_to_boundary_max, 2.0, 0.0);
        assert_ok(context, pc_evaluate(context, &ball, &ball, &m));
        assert_close(m.boundary_to_opening_max + m.opening_to_boundary_max, 0.0, 0.0);
        assert_close(m.opening_length + m.boundary_length, 0.0, 0.0);
        pc_mesh_free(context, &ball);
        pc_mesh_free(context, &garment);
        pc_mesh_free(context, &proxy);
        pc_context_destroy(context);
    }
}

// ---- snapping ---------------------------------------------------------------------------------

static pc_status snap(pc_context *context, const pc_mesh *garment, double cut, double cell,
                      pc_mesh *layer) {
    pci_scratch scratch = pci_scratch_begin(context);
    pci_topology topology;
    pci_bvh *bvh = NULL;
    pc_status status = pci_topology_build_edges(&scratch, garment, &topology)
                           ? pci_bvh_create(context, "test", garment, &bvh)
                           : PC_ERROR_OUT_OF_MEMORY;
    if (status == PC_OK) {
        status = pci_snap_border(context, "test", garment, &topology, bvh, cut, cell, layer);
    }
    pci_bvh_destroy(context, bvh);
    pci_scratch_end(&scratch);
    return status;
}

// A sheet like one made of voxels of `cell`: its border is short of the garment's by up to one.
static pc_mesh ragged_sheet(pc_context *context, double cell, double margin, uint64_t seed) {
    pc_mesh mesh = test_sheet(context, 24, 24, 1.0 - 2.0 * margin, 1.0 - 2.0 * margin);
    for (size_t v = 0; v < mesh.vertex_count; ++v) {
        const bool border = v / 25 == 0 || v / 25 == 24 || v % 25 == 0 || v % 25 == 24;
        for (size_t k = 0; k < 2; ++k) {
            mesh.positions[3 * v + k] +=
                margin + (border ? 0.6 * cell * (pci_random(seed, k, v) - 0.5) : 0.0);
        }
    }
    return mesh;
}

// Distance to the rim of the unit square.
static double rim_distance(const double *p) {
    double nearest = INFINITY;
    for (size_t k = 0; k < 2; ++k) {
        for (double end = 0.0; end <= 1.0; end += 1.0) {
            const double beyond = fmax(fmax(-p[1 - k], p[1 - k] - 1.0), 0.0);
            nearest = fmin(nearest, sqrt((p[k] - end) * (p[k] - end) + beyond * beyond));
        }
    }
    return nearest;
}

static void borders_snap_to_hems(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    const double cell = 1.0 / 24.0;
    pc_mesh garment = test_sheet(context, 50, 50, 1.0, 1.0);
    for (uint64_t seed = 0; seed < 4; ++seed) {
        pc_mesh layer = ragged_sheet(context, cell, 0.9 * cell, seed);
        const size_t triangles = layer.triangle_count;
        assert_ok(context, snap(context, &garment, 0.0, cell, &layer));
        size_t on_rim = 0;
        double area = 0.0;
        for (size_t v = 0; v < layer.vertex_count; ++v) {
            const bool border = v / 25 == 0 || v / 25 == 24 || v % 25 == 0 || v % 25 == 24;
            assert_close(layer.positions[3 * v + 2], 0.0, 1e-12);
            on_rim += border && rim_distance(&layer.positions[3 * v]) < 1e-9;
        }
        for (size_t t = 0; t < triangles; ++t) {
            double ab[3], ac[3], normal[3];
            const uint32_t *corner = &layer.triangles[3 * t];
            const double *a = &layer.positions[3 * (size_t)corner[0]];
            pci_sub(&layer.positions[3 * (size_t)corner[1]], a, ab);
            pci_sub(&layer.positions[3 * (size_t)corner[2]], a, ac);
            pci_cross(ab, ac, normal);
            assert_true(normal[2] > 0.0);
            area += 0.5 * normal[2];
        }
        assert_true(on_rim >= 92); // of 96
        assert_true(area > 0.985 && area < 1.0 + 1e-9);
        pc_mesh_free(context, &layer);
    }
    pc_mesh_free(context, &garment);
    pc_context_destroy(context);
}

// Borders that are no hem, and straps of one voxel, stay as they are.
static void other_borders_stay(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    const double cell = 1.0 / 24.0;
    pc_mesh garment = test_sheet(context, 50, 50, 1.0, 1.0);
    pc_mesh inner = ragged_sheet(context, cell, 4.0 * cell, 1);
    pc_mesh strap = test_sheet(context, 40, 1, 1.0, 0.7 * cell);
    pc_mesh ribbon = test_sheet(context, 40, 2, 1.0, cell), ball = test_sphere(context, 12);
    struct {
        const pc_mesh *garment;
        pc_mesh *layer;
    } cases[] = {{&garment, &inner}, {&ribbon, &strap}, {&ball, &garment}};
    for (size_t i = 0; i < 3; ++i) {
        pci_scratch scratch = pci_scratch_begin(context);
        const size_t count = 3 * cases[i].layer->vertex_count;
        double *before = PCI_SCRATCH(&scratch, double, count);
        memcpy(before, cases[i].layer->positions, count * sizeof(*before));
        assert_ok(context, snap(context, cases[i].garment, 0.0, cell, cases[i].layer));
        double moved = 0.0;
        for (size_t k = 0; k < count; ++k) {
            moved = fmax(moved, fabs(cases[i].layer->positions[k] - before[k]));
        }
        // The ends of the strap are hems, its sides are not.
        assert_true(moved <= (i == 1 ? 1e-9 : 0.0));
        pci_scratch_end(&scratch);
    }
    pc_mesh_free(context, &garment);
    pc_mesh_free(context, &inner);
    pc_mesh_free(context, &strap);
    pc_mesh_free(context, &ribbon);
    pc_mesh_free(context, &ball);
    pc_context_destroy(context);
}

// Where a cut beside the cloth is meant only, borders on the cloth stay.
static void only_what_is_beside_snaps(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    const double cell = 1.0 / 24.0, moved_left = 0.7 * cell;
    pc_mesh garment = test_sheet(context, 50, 50, 1.0, 1.0);
    pc_mesh layer = test_sheet(context, 24, 24, 1.0, 1.0);
    for (size_t v = 0; v < layer.vertex_count; ++v) {
        layer.positions[3 * v] -= moved_left;
    }
    assert_ok(context, snap(context, &garment, 0.25 * cell, cell, &layer));
    for (size_t row = 1; row < 24; ++row) {
        assert_close(layer.positions[3 * (25 * row)], 0.0, 1e-9);
        assert_close(layer.positions[3 * (25 * row + 24)], 1.0 - moved_left, 1e-9);
    }
    pc_mesh_free(context, &garment);
    pc_mesh_free(context, &layer);
    pc_context_destroy(context);
}

static void survives_a_lack_of_memory(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    pc_mesh garment = test_sheet(context, 6, 6, 1.0, 1.0),
            layer = test_sheet(context, 4, 4, 0.9, 1.0);
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        s.status = snap(context, &garment, 0.0, 0.2, &layer);
    }
    assert_true(s.failures > 20);
    pc_mesh_free(context, &garment);
    pc_mesh_free(context, &layer);
    pc_context_destroy(context);
    assert_int_equal(counter.live, 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(hems_are_where_cloth_ends), cmocka_unit_test(measures_boundaries),
        cmocka_unit_test(borders_snap_to_hems),      cmocka_unit_test(other_borders_stay),
        cmocka_unit_test(only_what_is_beside_snaps), cmocka_unit_test(survives_a_lack_of_memory),
    };
    return cmocka_run_group_tests_name("border", tests, NULL, NULL);
}
