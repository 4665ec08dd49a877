// Pleats that the triangles of a proxy cannot follow.
#include "support/test.h"

#include "geometry/topology.h"
#include "geometry/triangle_distance.h"
#include "stages/simplify/pleats.h"
#include "support/memory.h"
#include "support/proxy_shape.h"
#include "support/surfaces.h"

// The farthest vertex of the proxy from a mesh.
static double farthest_vertex(const pc_mesh *proxy, const pc_mesh *mesh) {
    double farthest = 0.0;
    for (size_t v = 0; v < proxy->vertex_count; ++v) {
        double squared = INFINITY;
        for (size_t t = 0; t < mesh->triangle_count; ++t) {
            const uint32_t *corner = &mesh->triangles[3 * t];
            double bary[3];
            squared =
                fmin(squared, pci_triangle_squared_distance(
                                  &proxy->positions[3 * v], &mesh->positions[3 * (size_t)corner[0]],
                                  &mesh->positions[3 * (size_t)corner[1]],
                                  &mesh->positions[3 * (size_t)corner[2]], bary));
        }
        farthest = fmax(farthest, squared);
    }
    return sqrt(farthest);
}

// Twelve waves around a tube of radius .5.
static pc_mesh pleated_skirt(pc_context *context, double depth) {
    pc_mesh skirt = test_tube(context, 96, 40, 0.5, 1.5);
    for (size_t v = 0; v < skirt.vertex_count; ++v) {
        double *p = &skirt.positions[3 * v];
        const double way = depth * cos(12.0 * atan2(p[2], p[0]));
        p[0] += 2.0 * way * p[0], p[2] += 2.0 * way * p[2];
    }
    return skirt;
}

// On narrow pleats, which the triangles cannot follow, vertices are pulled out to all sides; none
// becomes a spike.
static void leaves_no_spikes(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    static const double depths[] = {0.05, 0.07, 0.08};
    for (size_t i = 0; i < sizeof(depths) / sizeof(depths[0]); ++i) {
        pc_mesh skirt = pleated_skirt(context, depths[i]), again = {0};
        pci_scratch scratch = pci_scratch_begin(context);
        assert_true(pci_mesh_compact(&scratch, &skirt, NULL, &again, NULL));
        double area = 0.0;
        for (size_t t = 0; t < skirt.triangle_count; ++t) {
            area += pci_triangle_area(&skirt, t);
        }
        pc_mesh proxy = simplified(context, &skirt, 128, NULL);
        const double edge = sqrt(2.0 / sqrt(3.0) * area / 128.0);
        assert_true(farthest_vertex(&proxy, &again) < 0.16 * edge);
        pc_mesh_free(context, &proxy);
        pc_mesh_free(context, &again);
        pci_scratch_end(&scratch);
    }
    pc_context_destroy(context);
}

// The least and largest distance from the axis of a tube.
static void find_radii(const pc_mesh *mesh, double radii[2]) {
    radii[0] = INFINITY, radii[1] = 0.0;
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        const double radius = hypot(mesh->positions[3 * v], mesh->positions[3 * v + 2]);
        radii[0] = fmin(radii[0], radius);
        radii[1] = fmax(radii[1], radius);
    }
}

// Deep pleats half an edge apart leave a plain skirt; enough vertices follow them.
static void narrow_pleats_are_flattened(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    static const uint32_t vertices[] = {128, 2048};
    for (size_t i = 0; i < 2; ++i) {
        pc_mesh skirt = pleated_skirt(context, 0.15);
        pc_mesh proxy = simplified(context, &skirt, vertices[i], NULL);
        double radii[2];
        find_radii(&proxy, radii);
        if (i == 0) {
            assert_true(radii[0] > 0.45 && radii[1] < 0.55);
        } else {
            assert_true(radii[0] < 0.38 && radii[1] > 0.62);
        }
        pc_mesh_free(context, &proxy);
    }
    pc_context_destroy(context);
}

// A tube one edge around is no pleat, and neither are wide waves.
static void tubes_and_waves_are_no_pleats(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh meshes[2] = {test_tube(context, 24, 60, 0.5, 8.0),
                         test_sheet(context, 64, 64, 16.0, 16.0)};
    static const double spacings[2] = {3.14, 0.5};
    for (size_t v = 0; v < meshes[1].vertex_count; ++v) {
        double *p = &meshes[1].positions[3 * v];
        p[2] = 3.0 * sin(6.283185307179586 / 8.0 * p[0]);
    }
    for (size_t i = 0; i < 2; ++i) {
        const size_t bytes = 3 * meshes[i].vertex_count * sizeof(double);
        pci_scratch scratch = pci_scratch_begin(context);
        double *normals = PCI_SCRATCH(&scratch, double, 3 * meshes[i].vertex_count);
        double *before = PCI_SCRATCH(&scratch, double, 3 * meshes[i].vertex_count);
        assert_false(scratch.failed);
        memcpy(before, meshes[i].positions, bytes);
        pci_vertex_normals(&meshes[i], normals);
        bool some = true;
        assert_true(pci_flatten_pleats(&scratch, spacings[i], &meshes[i], normals, &some));
        assert_false(some);
        assert_memory_equal(meshes[i].positions, before, bytes);
        // Much longer edges cannot follow the waves.
        assert_true(i == 0 || pci_flatten_pleats(&scratch, 6.0, &meshes[i], normals, &some));
        assert_int_equal(some, i != 0);
        assert_true(i == 0 || memcmp(meshes[i].positions, before, bytes) != 0);
        pci_scratch_end(&scratch);
        pc_mesh_free(context, &meshes[i]);
    }
    pc_context_destroy(context);
}

// `mesh` with the vertices and triangles of `part` behind its own.
static void append(pc_context *context, pc_mesh *mesh, const pc_mesh *part) {
    const size_t v = mesh->vertex_count, t = mesh->triangle_count;
    pc_mesh both = {.vertex_count = v + part->vertex_count,
                    .triangle_count = t + part->triangle_count};
    both.positions = PCI_ALLOCATE(context, double, 3 * both.vertex_count);
    both.triangles = PCI_ALLOCATE(context, uint32_t, 3 * both.triangle_count);
    assert_true(both.positions != NULL && both.triangles != NULL);
    memcpy(both.positions, mesh->positions, 3 * v * sizeof(double));
    memcpy(&both.positions[3 * v], part->positions, 3 * part->vertex_count * sizeof(double));
    memcpy(both.triangles, mesh->triangles, 3 * t * sizeof(uint32_t));
    for (size_t i = 0; i < 3 * part->triangle_count; ++i) {
        both.triangles[3 * t + i] = (uint32_t)v + part->triangles[i];
    }
    pc_mesh_free(context, mesh);
    *mesh = both;
}

// Flattens a pleated skirt with another part, which is freed: the skirt's radii then, and the share
// that is left of the part's area.
static double flatten(pc_context *context, double depth, double spacing, pc_mesh *part,
                      double radii[2]) {
    pc_mesh dress = pleated_skirt(context, depth);
    const size_t first = dress.vertex_count, first_triangle = dress.triangle_count;
    append(context, &dress, part);
    pci_scratch scratch = pci_scratch_begin(context);
    double *normals = PCI_SCRATCH(&scratch, double, 3 * dress.vertex_count);
    assert_false(scratch.failed);
    pci_vertex_normals(&dress, normals);
    bool some = false;
    assert_true(pci_flatten_pleats(&scratch, spacing, &dress, normals, &some));
    assert_true(some);
    double before = 0.0, after = 0.0;
    for (size_t t = 0; t < part->triangle_count; ++t) {
        before += pci_triangle_area(part, t);
        after += pci_triangle_area(&dress, first_triangle + t);
    }
    const pc_mesh skirt = {first, dress.positions, 0, NULL};
    find_radii(&skirt, radii);
    pci_scratch_end(&scratch);
    pc_mesh_free(context, &dress);
    pc_mesh_free(context, part);
    return after / before;
}

// A flared sleeve beside the pleats, not two edges around, stays as wide as it is; so does a
// shoulder, a sphere without its ends.
static void sleeves_and_shoulders_of_pleated_dresses_stay(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh sleeve = test_tube(context, 8, 16, 0.07, 0.3);
    for (size_t v = 0; v < sleeve.vertex_count; ++v) {
        double *p = &sleeve.positions[3 * v];
        p[0] *= 1.0 + 2.0 * p[1], p[2] *= 1.0 + 2.0 * p[1];
    }
    double radii[2];
    assert_true(flatten(context, 0.15, 0.3, &sleeve, radii) > 0.95);
    assert_true(radii[0] > 0.4 && radii[1] < 0.6);
    pc_mesh shoulder = test_tube(context, 24, 14, 1.0, 1.0);
    for (size_t v = 0; v < shoulder.vertex_count; ++v) {
        double *p = &shoulder.positions[3 * v];
        const double angle = 0.15 + 1.4 * p[1];
        p[0] *= 0.3 * sin(angle), p[2] *= 0.3 * sin(angle), p[1] = 0.3 * cos(angle);
    }
    assert_true(flatten(context, 0.1, 0.35, &shoulder, radii) > 0.97);
    assert_true(radii[0] > 0.48 && radii[1] < 0.52);
    pc_context_destroy(context);
}

// Pleats as deep as the skirt is wide leave little of their depth.
static void deep_pleats_are_flattened(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh sleeve = test_tube(context, 8, 16, 0.07, 0.3);
    double radii[2];
    flatten(context, 0.25, 0.3, &sleeve, radii);
    assert_true(radii[0] > 0.42 && radii[1] < 0.58);
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(leaves_no_spikes),
        cmocka_unit_test(narrow_pleats_are_flattened),
        cmocka_unit_test(tubes_and_waves_are_no_pleats),
        cmocka_unit_test(sleeves_and_shoulders_of_pleated_dresses_stay),
        cmocka_unit_test(deep_pleats_are_flattened),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
