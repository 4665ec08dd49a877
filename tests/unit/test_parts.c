#include "proxycloth/parts.h"

#include "support/test.h"

#include <stdio.h>

#include "support/memory.h"
#include "support/surfaces.h"

// Appends a surface, moved by `offset`; frees both inputs.
static void append(pc_context *context, pc_mesh *all, pc_mesh surface, double x, double y,
                   double z) {
    const double offset[3] = {x, y, z};
    if (all->triangle_count == 0) {
        for (size_t i = 0; i < 3 * surface.vertex_count; ++i) {
            surface.positions[i] += offset[i % 3];
        }
        *all = surface;
        return;
    }
    pc_mesh both = test_union(context, all, &surface, offset);
    pc_mesh_free(context, all);
    pc_mesh_free(context, &surface);
    *all = both;
}

// Visual mesh whose red channel numbers the pieces in the order of the triangles given per piece,
// and whose material is the piece's number.
static pc_visual numbered_visual(pc_context *context, const pc_mesh *mesh, const size_t *ends,
                                 size_t pieces) {
    float *colors = PCI_ALLOCATE(context, float, 4 * mesh->vertex_count);
    uint32_t *materials = PCI_ALLOCATE(context, uint32_t, mesh->triangle_count);
    pc_material names[16];
    memset(names, 0, sizeof(names));
    for (size_t i = 0; i < pieces; ++i) {
        snprintf(names[i].name, sizeof(names[i].name), "piece %zu", i);
    }
    size_t piece = 0;
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        piece += t == ends[piece];
        materials[t] = (uint32_t)piece;
        for (size_t c = 0; c < 3; ++c) {
            colors[4 * (size_t)mesh->triangles[3 * t + c]] = (float)piece / 16.0F;
        }
    }
    const pc_visual_arrays arrays = {.vertex_count = mesh->vertex_count,
                                     .positions = mesh->positions,
                                     .triangle_count = mesh->triangle_count,
                                     .triangles = mesh->triangles,
                                     .colors = colors,
                                     .triangle_materials = materials,
                                     .material_count = pieces,
                                     .materials = names};
    pc_visual visual = {0};
    assert_ok(context, pc_visual_create(context, &arrays, &visual, NULL));
    pc_release(context, colors);
    pc_release(context, materials);
    return visual;
}

// A top and a skirt with air between them, a lining in the skirt, a pocket on the top, a button
// that floats far from both but nearer to the skirt, and one near the top.
enum { TOP, SKIRT, LINING, POCKET, SKIRT_BUTTON, TOP_BUTTON, PIECES };

static pc_visual outfit(pc_context *context) {
    pc_mesh all = {0};
    size_t ends[PIECES];
    append(context, &all, test_tube(context, 24, 10, 0.3, 0.6), 0.0, 1.0, 0.0);
    ends[TOP] = all.triangle_count;
    append(context, &all, test_tube(context, 32, 12, 0.4, 0.8), 0.0, 0.0, 0.0);
    ends[SKIRT] = all.triangle_count;
    append(context, &all, test_tube(context, 32, 12, 0.395, 0.8), 0.0, 0.0, 0.0);
    ends[LINING] = all.triangle_count;
    append(context, &all, test_sheet(context, 4, 4, 0.12, 0.2), -0.06, 1.2, 0.302);
    ends[POCKET] = all.triangle_count;
    append(context, &all, test_sheet(context, 2, 2, 0.02, 0.02), 0.0, 0.3, 0.7);
    ends[SKIRT_BUTTON] = all.triangle_count;
    append(context, &all, test_sheet(context, 2, 2, 0.02, 0.02), 0.0, 1.5, 0.35);
    ends[TOP_BUTTON] = all.triangle_count;
    const pc_visual visual = numbered_visual(context, &all, ends, PIECES);
    pc_mesh_free(context, &all);
    return visual;
}

// Bits of the pieces that a part holds, by the colors of its corners and by its materials.
static unsigned pieces_of(const pc_visual *part) {
    unsigned by_color = 0, by_material = 0;
    for (size_t c = 0; c < part->corner_count; ++c) {
        by_color |= 1u << (unsigned)lrint(16.0 * (double)part->colors[4 * c]);
    }
    for (size_t m = 0; m < part->material_count; ++m) {
        by_material |= 1u << (unsigned)(part->materials[m].name[6] - '0');
    }
    assert_int_equal(by_color, by_material);
    return by_color;
}

static void an_outfit_splits_into_garments(void **state) {
    (void)state;
    static const uint32_t threads[] = {1, 2, 3, 8};
    for (size_t i = 0; i < 4; ++i) {
        pc_context *context = test_context(threads[i]);
        pc_visual visual = outfit(context);
        pc_parts parts = {0};
        assert_ok(context, pc_split_visual(context, &visual, &parts));
        assert_int_equal(parts.part_count, 2);
        assert_int_equal(pieces_of(&parts.visuals[0]),
                         1u << SKIRT | 1u << LINING | 1u << SKIRT_BUTTON);
        assert_int_equal(pieces_of(&parts.visuals[1]), 1u << TOP | 1u << POCKET | 1u << TOP_BUTTON);
        size_t triangles = 0, corners = 0;
        for (size_t p = 0; p < 2; ++p) {
            triangles += parts.visuals[p].surface.triangle_count;
            corners += parts.visuals[p].corner_count;
            assert_int_equal(parts.reports[p].triangles, parts.visuals[p].surface.triangle_count);
            assert_int_equal(parts.reports[p].components, 3);
        }
        assert_int_equal(triangles, visual.surface.triangle_count);
        assert_int_equal(corners, visual.corner_count);
        pc_parts_free(context, &parts);
        assert_null(parts.visuals);
        pc_parts_free(context, &parts);
        pc_visual_free(context, &visual);
        pc_context_destroy(context);
    }
}

// Every triangle of the input is in exactly one part, with its positions and its color.
// Two panels with vertices of their own are one garment where their borders meet, a hem and a
// waist a hand apart are not.
static void panels_are_sewn_together(void **state) {
    (void)state;
    static const double gaps[] = {0.0, 0.01, 0.1};
    for (size_t i = 0; i < 3; ++i) {
        pc_context *context = test_context(2);
        pc_mesh all = {0};
        size_t ends[2];
        append(context, &all, test_sheet(context, 10, 20, 1.0, 2.0), 0.0, 0.0, 0.0);
        ends[0] = all.triangle_count;
        append(context, &all, test_sheet(context, 7, 13, 1.0, 2.0), 1.0 + gaps[i], 0.0, 0.0);
        ends[1] = all.triangle_count;
        pc_visual visual = numbered_visual(context, &all, ends, 2);
        pc_parts parts = {0};
        assert_ok(context, pc_split_visual(context, &visual, &parts));
        assert_int_equal(parts.part_count, i < 2 ? 1 : 2);
        pc_parts_free(context, &parts);
        pc_visual_free(context, &visual);
        pc_mesh_free(context, &all);
        pc_context_destroy(context);
    }
}

static void parts_hold_every_triangle_once(void **state) {
    (void)state;
    pc_context *context = test_context(0);
    pc_visual visual = outfit(context);
    pc_parts parts = {0};
    assert_ok(context, pc_split_visual(context, &visual, &parts));
    size_t next[2] = {0, 0};
    for (size_t t = 0; t < visual.surface.triangle_count; ++t) {
        size_t found = 0;
        for (size_t p = 0; p < 2; ++p) { // parts keep the order
            const pc_visual *part = &parts.visuals[p];
            if (next[p] == part->surface.triangle_count) {
                continue;
            }
            bool same = true;
            for (size_t c = 0; c < 3; ++c) {
                const size_t a = visual.corner_triangles[3 * t + c];
                const size_t b = part->corner_triangles[3 * next[p] + c];
                same = same &&
                       memcmp(&visual.surface.positions[3 * (size_t)visual.corner_vertices[a]],
                              &part->surface.positions[3 * (size_t)part->corner_vertices[b]],
                              3 * sizeof(double)) == 0 &&
                       memcmp(&visual.colors[4 * a], &part->colors[4 * b], 4 * sizeof(float)) == 0;
            }
            next[p] += same;
            found += same;
        }
        assert_int_equal(found, 1);
    }
    pc_parts_free(context, &parts);
    pc_visual_free(context, &visual);
    pc_context_destroy(context);
}

static void one_garment_is_copied(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh tube = test_tube(context, 20, 10, 1.0, 2.0);
    const size_t end = tube.triangle_count;
    pc_visual visual = numbered_visual(context, &tube, &end, 1);
    pc_parts parts = {0};
    assert_ok(context, pc_split_visual(context, &visual, &parts));
    assert_int_equal(parts.part_count, 1);
    const pc_visual *copy = &parts.visuals[0];
    assert_int_equal(copy->corner_count, visual.corner_count);
    assert_memory_equal(copy->surface.positions, visual.surface.positions,
                        3 * visual.surface.vertex_count * sizeof(double));
    assert_memory_equal(copy->surface.triangles, visual.surface.triangles,
                        3 * visual.surface.triangle_count * sizeof(uint32_t));
    assert_memory_equal(copy->colors, visual.colors, 4 * visual.corner_count * sizeof(float));
    pc_parts_free(context, &parts);
    pc_visual_free(context, &visual);
    pc_mesh_free(context, &tube);
    pc_context_destroy(context);
}

// A mail of 400 equal plates: each is decoration, so they stay together.
static void a_swarm_of_plates_is_one_part(void **state) {
    (void)state;
    pc_context *context = test_context(0);
    pc_mesh all = {0};
    for (size_t i = 0; i < 400; ++i) {
        append(context, &all, test_sheet(context, 1, 1, 0.03, 0.03), 0.05 * (double)(i % 20),
               0.05 * (double)(i / 20), 0.0);
    }
    const size_t end = all.triangle_count;
    pc_visual visual = numbered_visual(context, &all, &end, 1);
    pc_parts parts = {0};
    assert_ok(context, pc_split_visual(context, &visual, &parts));
    assert_int_equal(parts.part_count, 1);
    assert_int_equal(parts.visuals[0].surface.triangle_count, 800);
    pc_parts_free(context, &parts);
    pc_visual_free(context, &visual);
    pc_mesh_free(context, &all);
    pc_context_destroy(context);
}

static void vertices_are_shared_by_area(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    uint32_t shares[5];
    const double areas[5] = {6.0, 3.0, 1.0, 0.0, 2.0};
    assert_ok(context, pc_share_vertices(context, 5, areas, 1204, shares));
    uint32_t sum = 0;
    for (size_t i = 0; i < 5; ++i) {
        sum += shares[i];
        assert_true(fabs((double)shares[i] - 100.0 * areas[i]) <= 4.0);
    }
    assert_int_equal(sum, 1204);
    assert_int_equal(shares[3], 4);
    // Small parts keep their minimum, large ones share the rest.
    assert_ok(context, pc_share_vertices(context, 5, areas, 24, shares));
    const uint32_t expected[5] = {8, 4, 4, 4, 4};
    assert_memory_equal(shares, expected, sizeof(expected));
    assert_ok(context, pc_share_vertices(context, 5, areas, 7, shares));
    for (size_t i = 0; i < 5; ++i) {
        assert_int_equal(shares[i], 4);
    }
    assert_ok(context, pc_share_vertices(context, 1, areas, 65536, shares));
    assert_int_equal(shares[0], 65536);
    const double bad[2] = {1.0, -1.0}, worse[2] = {NAN, 1.0};
    assert_int_equal(pc_share_vertices(context, 2, bad, 100, shares), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_share_vertices(context, 2, worse, 100, shares), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_share_vertices(context, 0, areas, 100, shares), PC_ERROR_INVALID_ARGUMENT);
    pc_context_destroy(context);
}

static void survives_lack_of_memory(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    pc_visual visual = outfit(context);
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        pc_parts parts = {0};
        s.status = pc_split_visual(context, &visual, &parts);
        assert_int_equal(parts.visuals != NULL, s.status == PC_OK);
        pc_parts_free(context, &parts);
    }
    assert_true(s.failures > 30);
    pc_visual_free(context, &visual);
    pc_context_destroy(context);
    assert_int_equal(counter.live, 0);
}

static void rejects_bad_arguments(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_visual empty = {0};
    pc_parts parts = {0};
    assert_int_equal(pc_split_visual(context, NULL, &parts), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_split_visual(context, &empty, &parts), PC_ERROR_INVALID_ARGUMENT);
    pc_visual visual = outfit(context);
    assert_int_equal(pc_split_visual(context, &visual, NULL), PC_ERROR_INVALID_ARGUMENT);
    assert_ok(context, pc_split_visual(context, &visual, &parts));
    assert_int_equal(pc_split_visual(context, &visual, &parts), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(parts.part_count, 2);
    pc_parts_free(context, &parts);
    pc_visual_free(context, &visual);
    pc_context_destroy(context);
}

static void can_be_cancelled(void **state) {
    (void)state;
    pc_context *owner = test_context(1), *context = test_cancelling_context();
    pc_visual visual = outfit(owner);
    pc_parts parts = {0};
    const pc_status status = pc_split_visual(context, &visual, &parts);
    assert_true(status == PC_ERROR_CANCELLED);
    assert_null(parts.visuals);
    pc_visual_free(owner, &visual);
    pc_context_destroy(context);
    pc_context_destroy(owner);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(an_outfit_splits_into_garments),
        cmocka_unit_test(panels_are_sewn_together),
        cmocka_unit_test(parts_hold_every_triangle_once),
        cmocka_unit_test(one_garment_is_copied),
        cmocka_unit_test(a_swarm_of_plates_is_one_part),
        cmocka_unit_test(vertices_are_shared_by_area),
        cmocka_unit_test(survives_lack_of_memory),
        cmocka_unit_test(rejects_bad_arguments),
        cmocka_unit_test(can_be_cancelled),
    };
    return cmocka_run_group_tests_name("parts", tests, NULL, NULL);
}
