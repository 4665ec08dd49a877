#include "support/test.h"

#include "geometry/topology.h"
#include "stages/simplify/mirror.h"
#include "support/proxy_shape.h"
#include "support/surfaces.h"

// The proxy with the option `mirror`. Frees the mesh.
static pc_mesh mirrored(pc_context *context, pc_mesh *mesh, uint32_t vertices,
                        pc_simplify_report *report) {
    pc_simplify_options options = simplify_options(vertices);
    options.mirror = true;
    return simplified_with(context, mesh, &options, report);
}

// A skirt that is the same on both sides of x = 0 only: it leans forward and is wider in front.
static pc_mesh skirt(pc_context *context) {
    pc_mesh mesh = test_tube(context, 60, 40, 1.0, 3.0);
    for (size_t v = 0; v < mesh.vertex_count; ++v) {
        double *at = &mesh.positions[3 * v];
        at[2] += 0.2 * at[1] + 0.3 * at[2] * fabs(at[2]);
    }
    return mesh;
}

// Raises a bump on one side, as high as said.
static void raise_bump(pc_mesh *mesh, double height) {
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        double *at = &mesh->positions[3 * v];
        const double away[3] = {at[0] - 1.0, at[1] - 1.5, at[2] - 0.3};
        at[0] += height * exp(-8.0 * pci_dot(away, away));
    }
}

static double offset_of(const pc_mesh *mesh, size_t axis) {
    double low[3], high[3];
    pci_bounding_box(mesh, low, high);
    return 0.5 * (low[axis] + high[axis]);
}

// The vertex at the mirror image of v; PC_INVALID_INDEX: there is none.
static uint32_t image_of(const pc_mesh *mesh, size_t v, size_t axis, double offset) {
    double point[3];
    memcpy(point, &mesh->positions[3 * v], sizeof(point));
    point[axis] = 2.0 * offset - point[axis];
    for (uint32_t i = 0; i < mesh->vertex_count; ++i) {
        if (pci_squared_distance(point, &mesh->positions[3 * (size_t)i]) < 1e-24) {
            return i;
        }
    }
    return PC_INVALID_INDEX;
}

static bool has_triangle(const pc_mesh *mesh, uint32_t a, uint32_t b, uint32_t c) {
    for (size_t h = 0; h < 3 * mesh->triangle_count; ++h) {
        const uint32_t *corner = &mesh->triangles[h - h % 3];
        if (corner[h % 3] == a && corner[(h + 1) % 3] == b && corner[(h + 2) % 3] == c) {
            return true;
        }
    }
    return false;
}

// Whether all vertices and triangles have mirror images.
static bool is_symmetric(const pc_mesh *mesh, size_t axis) {
    const double offset = offset_of(mesh, axis);
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        uint32_t image[3];
        for (size_t c = 0; c < 3; ++c) {
            image[c] = image_of(mesh, mesh->triangles[3 * t + c], axis, offset);
        }
        if (!has_triangle(mesh, image[0], image[2], image[1])) {
            return false;
        }
    }
    return true;
}

static void halves_make_the_whole(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pci_scratch scratch = pci_scratch_begin(context);
    pc_mesh mesh = skirt(context), half = {0}, whole = {0};
    pci_mirror mirror = {0};
    assert_ok(context, pci_halve(context, "test", &mesh, 0.4, &mirror, &half));
    assert_int_equal(mirror.axis, 0);
    assert_true(fabs(mirror.offset) < 1e-9);
    const shape cut = check_manifold(context, &half);
    assert_int_equal(cut.components, 1);
    assert_int_equal(cut.loops, 1);
    assert_int_equal(cut.euler, 1);
    assert_true(fabs(pc_mesh_area(&half) / pc_mesh_area(&mesh) - 0.5) < 1e-3);
    for (size_t v = 0; v < half.vertex_count; ++v) {
        assert_true(half.positions[3 * v] >= mirror.offset);
    }
    assert_true(pci_unfold(&scratch, &mirror, &half, &whole));
    const shape joined = check_manifold(context, &whole);
    assert_int_equal(joined.components, 1);
    assert_int_equal(joined.loops, 2);
    assert_int_equal(joined.euler, 0);
    assert_true(fabs(pc_mesh_area(&whole) / pc_mesh_area(&mesh) - 1.0) < 1e-3);
    pc_mesh_free(context, &mesh);
    pc_mesh_free(context, &half);
    pc_mesh_free(context, &whole);
    pci_scratch_end(&scratch);
    pc_context_destroy(context);
}

static void symmetric_garments_get_symmetric_proxies(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    static const uint32_t counts[] = {60, 77, 128, 500};
    for (size_t i = 0; i < sizeof(counts) / sizeof(counts[0]); ++i) {
        pc_mesh mesh = skirt(context);
        pc_simplify_report report = {0};
        pc_mesh proxy = mirrored(context, &mesh, counts[i], &report);
        assert_true(report.mirrored);
        assert_int_equal(proxy.vertex_count, counts[i]);
        assert_true(is_symmetric(&proxy, 0));
        const shape found = check_manifold(context, &proxy);
        assert_int_equal(found.loops, 2);
        assert_int_equal(found.euler, 0);
        assert_true(found.angle_mean > 46.0 && found.angle_worst > 20.0);
        pc_mesh_free(context, &proxy);
    }
    pc_context_destroy(context);
}

// Two shoes need no seam, and a sheet lies in a plane that is none of its mirrors.
static void pairs_and_flat_sheets_too(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    const double apart[3] = {4.0, 0.0, 0.0};
    pc_mesh one = skirt(context), pair = test_union(context, &one, &one, apart);
    pc_simplify_report report = {0};
    pc_mesh proxy = mirrored(context, &pair, 128, &report);
    assert_true(report.mirrored && is_symmetric(&proxy, 0));
    assert_int_equal(proxy.vertex_count, 128);
    assert_int_equal(check_manifold(context, &proxy).components, 2);
    pc_mesh_free(context, &proxy);
    pc_mesh_free(context, &one);
    pc_mesh sheet = test_sheet(context, 30, 20, 1.5, 1.0);
    proxy = mirrored(context, &sheet, 100, &report);
    assert_true(report.mirrored && is_symmetric(&proxy, 0)); // the shorter cut
    assert_int_equal(check_manifold(context, &proxy).euler, 1);
    pc_mesh_free(context, &proxy);
    pc_context_destroy(context);
}

static void others_are_taken_whole(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    static const double heights[] = {0.02, 0.4};
    for (size_t i = 0; i < 2; ++i) {
        pc_mesh mesh = skirt(context);
        raise_bump(&mesh, heights[i]);
        pc_simplify_report report = {0};
        pc_mesh proxy = mirrored(context, &mesh, 128, &report);
        assert_int_equal(report.mirrored, i == 0);
        assert_int_equal(is_symmetric(&proxy, 0), i == 0);
        pc_mesh_free(context, &proxy);
    }
    // The same surface, but cut open on one side.
    pc_mesh mesh = skirt(context), open = {0};
    pci_scratch scratch = pci_scratch_begin(context);
    uint8_t *keep = PCI_SCRATCH(&scratch, uint8_t, mesh.triangle_count);
    assert_non_null(keep);
    for (size_t t = 0; t < mesh.triangle_count; ++t) {
        double middle[3];
        pci_triangle_middle(&mesh, t, middle);
        keep[t] = !(middle[0] > 0.0 && fabs(middle[2]) < 0.4 && middle[1] < 1.0);
    }
    assert_true(pci_mesh_compact(&scratch, &mesh, keep, &open, NULL));
    pci_scratch_end(&scratch);
    pc_simplify_report report = {0};
    pc_mesh proxy = mirrored(context, &open, 128, &report);
    assert_false(report.mirrored);
    pc_mesh_free(context, &proxy);
    // Not wanted.
    assert_ok(context, pc_simplify(context, NULL, &mesh, NULL, &proxy, &report));
    assert_false(report.mirrored || is_symmetric(&proxy, 0));
    pc_mesh_free(context, &proxy);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(halves_make_the_whole),
        cmocka_unit_test(symmetric_garments_get_symmetric_proxies),
        cmocka_unit_test(pairs_and_flat_sheets_too),
        cmocka_unit_test(others_are_taken_whole),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
