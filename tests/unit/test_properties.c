// What must not matter does not: where a garment stands, its size, the order of its vertices and
// triangles, its mirror image, triangles without area and copies. The grid of voxels has
// directions, so shapes agree within its resolution, and counts exactly.
#include <stdlib.h>

#include "support/surfaces.h"
#include "support/test.h"

// A skirt, conical and wavy, with two openings.
static pc_mesh make_skirt(pc_context *context) {
    pc_mesh mesh = test_tube(context, 36, 16, 1.0, 1.0);
    for (size_t v = 0; v < mesh.vertex_count; ++v) {
        double *p = &mesh.positions[3 * v];
        const double angle = atan2(p[2], p[0]);
        const double radius = 0.2 + 0.3 * (1.0 - p[1]) + 0.02 * (1.0 - p[1]) * sin(5.0 * angle);
        p[0] *= radius, p[2] *= radius;
    }
    return mesh;
}

typedef struct outcome {
    pc_measures measures;
    double area; // of the proxy, over that of the garment
} outcome;

static outcome convert(pc_context *context, const pc_mesh *mesh) {
    pc_asset asset = {0};
    const pc_visual_arrays arrays = {.vertex_count = mesh->vertex_count,
                                     .positions = mesh->positions,
                                     .triangle_count = mesh->triangle_count,
                                     .triangles = mesh->triangles};
    assert_ok(context, pc_visual_create(context, &arrays, &asset.visual, &asset.reports.visual));
    pc_options options = pc_default_options();
    options.voxelize.voxels = 20;
    options.simplify.vertices = 64;
    for (pc_stage stage = 0; stage <= PC_STAGE_SIMPLIFY; ++stage) {
        assert_ok(context, pc_run_stage(context, stage, &options, &asset, NULL));
    }
    outcome result;
    assert_ok(context, pc_evaluate(context, &asset.visual.surface, &asset.proxy, &result.measures));
    result.area = pc_mesh_area(&asset.proxy) / pc_mesh_area(&asset.visual.surface);
    pc_asset_free(context, &asset);
    return result;
}

// Counts are equal; Hausdorff distances (over the diagonal) and areas differ by at most
// `tolerance`.
static void assert_alike(const char *what, const outcome *a, const outcome *b, double tolerance) {
    const pc_measures *m = &a->measures, *n = &b->measures;
    if (m->vertices != n->vertices || m->components != n->components ||
        m->boundary_loops != n->boundary_loops || m->euler_number != n->euler_number ||
        n->nonmanifold_edges != 0 || n->nonmanifold_vertices != 0 || n->self_intersections != 0) {
        fail_msg("%s: other counts", what);
    }
    if (!(fabs(m->hausdorff - n->hausdorff) <= tolerance && fabs(a->area - b->area) <= tolerance)) {
        fail_msg("%s: Hausdorff distance %g and %g, area %g and %g", what, m->hausdorff,
                 n->hausdorff, a->area, b->area);
    }
}

typedef struct fixture {
    pc_context *context;
    pc_mesh skirt, changed;
    outcome plain;
} fixture;

static fixture begin(void) {
    fixture f = {.context = test_context(0)};
    f.skirt = make_skirt(f.context);
    f.changed = make_skirt(f.context);
    f.plain = convert(f.context, &f.skirt);
    assert_int_equal(f.plain.measures.boundary_loops, 2);
    return f;
}

static void compare(fixture *f, const char *what, double tolerance) {
    const outcome other = convert(f->context, &f->changed);
    assert_alike(what, &f->plain, &other, tolerance);
}

static void end(fixture *f) {
    pc_mesh_free(f->context, &f->skirt);
    pc_mesh_free(f->context, &f->changed);
    pc_context_destroy(f->context);
}

// x -> scale * (rotation by `angle` about (1, 2, 3)) x + shift.
static void place(const fixture *f, double angle, double scale, double shift) {
    const double axis[3] = {1.0 / sqrt(14.0), 2.0 / sqrt(14.0), 3.0 / sqrt(14.0)};
    for (size_t v = 0; v < f->skirt.vertex_count; ++v) {
        const double *p = &f->skirt.positions[3 * v];
        double turned[3];
        pci_cross(axis, p, turned);
        for (size_t k = 0; k < 3; ++k) {
            const double along = pci_dot(axis, p) * axis[k];
            f->changed.positions[3 * v + k] =
                scale * (along + cos(angle) * (p[k] - along) + sin(angle) * turned[k]) + shift;
        }
    }
}

static void size_does_not_matter(void **state) {
    (void)state;
    fixture f = begin();
    static const double scales[] = {1e-3, 0.37, 100.0, 1e4};
    for (size_t i = 0; i < sizeof(scales) / sizeof(scales[0]); ++i) {
        place(&f, 0.0, scales[i], 0.0);
        compare(&f, "scale", 2e-3);
    }
    end(&f);
}

static void place_and_direction_do_not_matter(void **state) {
    (void)state;
    fixture f = begin();
    place(&f, 0.0, 1.0, 1000.0);
    compare(&f, "far away", 2e-3);
    static const double angles[] = {0.7, 2.0, 3.9};
    for (size_t i = 0; i < sizeof(angles) / sizeof(angles[0]); ++i) {
        place(&f, angles[i], 1.0, -3.0);
        compare(&f, "turned", 2e-2);
    }
    end(&f);
}

static void a_mirror_image_is_alike(void **state) {
    (void)state;
    fixture f = begin();
    for (size_t v = 0; v < f.changed.vertex_count; ++v) {
        f.changed.positions[3 * v] *= -1.0;
    }
    compare(&f, "mirrored, inside out", 1e-2);
    for (size_t t = 0; t < f.changed.triangle_count; ++t) {
        uint32_t *corner = &f.changed.triangles[3 * t], swap = corner[1];
        corner[1] = corner[2], corner[2] = swap;
    }
    compare(&f, "mirrored", 1e-2);
    end(&f);
}

// Fisher-Yates; order[i] is where element i goes.
static uint32_t *shuffle(size_t count, uint64_t seed) {
    uint32_t *order = malloc(count * sizeof(*order));
    assert_non_null(order);
    for (size_t i = 0; i < count; ++i) {
        const size_t j = (size_t)(pci_random_bits(seed, 0, i) % (i + 1));
        order[i] = order[j];
        order[j] = (uint32_t)i;
    }
    return order;
}

static void the_order_of_the_file_does_not_matter(void **state) {
    (void)state;
    fixture f = begin();
    uint32_t *vertices = shuffle(f.skirt.vertex_count, 1);
    uint32_t *triangles = shuffle(f.skirt.triangle_count, 2);
    for (size_t v = 0; v < f.skirt.vertex_count; ++v) {
        memcpy(&f.changed.positions[3 * (size_t)vertices[v]], &f.skirt.positions[3 * v],
               3 * sizeof(double));
    }
    for (size_t t = 0; t < f.skirt.triangle_count; ++t) {
        for (size_t k = 0; k < 3; ++k) {
            f.changed.triangles[3 * (size_t)triangles[t] + (k + t) % 3] =
                vertices[f.skirt.triangles[3 * t + k]];
        }
    }
    compare(&f, "shuffled", 1e-2);
    free(vertices);
    free(triangles);
    end(&f);
}

// Every triangle ten times, and triangles without area on top.
static void copies_and_degenerate_triangles_do_not_matter(void **state) {
    (void)state;
    fixture f = begin();
    enum { COPIES = 10 };
    const size_t count = f.skirt.triangle_count;
    pc_release(f.context, f.changed.triangles);
    f.changed.triangles = PCI_ALLOCATE(f.context, uint32_t, 3 * count * (COPIES + 1));
    assert_non_null(f.changed.triangles);
    for (size_t t = 0; t < count; ++t) {
        const uint32_t *corner = &f.skirt.triangles[3 * t];
        for (size_t i = 0; i <= COPIES; ++i) {
            const bool flat = i == COPIES;
            const uint32_t copy[3] = {corner[i % 3], corner[(i + 1) % 3],
                                      flat ? corner[i % 3] : corner[(i + 2) % 3]};
            memcpy(&f.changed.triangles[3 * (i * count + t)], copy, sizeof(copy));
        }
    }
    f.changed.triangle_count = count * (COPIES + 1);
    const outcome other = convert(f.context, &f.changed);
    f.plain.area /= COPIES; // the garment's area counts its copies
    assert_alike("copies", &f.plain, &other, 1e-2);
    end(&f);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(size_does_not_matter),
        cmocka_unit_test(place_and_direction_do_not_matter),
        cmocka_unit_test(a_mirror_image_is_alike),
        cmocka_unit_test(the_order_of_the_file_does_not_matter),
        cmocka_unit_test(copies_and_degenerate_triangles_do_not_matter),
    };
    return cmocka_run_group_tests_name("properties", tests, NULL, NULL);
}
