// pc_visual_create against hand-made meshes; welding against an O(n^2) oracle.
#include <float.h>

#include "support/memory.h"

static pc_visual_arrays plain(const double *positions, size_t vertices, const uint32_t *triangles,
                              size_t count) {
    return (pc_visual_arrays){.vertex_count = vertices,
                              .positions = positions,
                              .triangle_count = count,
                              .triangles = triangles};
}

// A unit square in two triangles with split vertices along the diagonal, written with both zeros.
static const double square[] = {0, 0, 0, 1, 0, 0, 1, 1, 0, -0.0, 0, -0.0, 1, 1, 0, 0, 1, 0};
static const uint32_t square_triangles[] = {0, 1, 2, 3, 4, 5};

static void welds_positions_and_keeps_corners(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_visual visual = {0};
    pc_visual_report report = {0};
    const pc_visual_arrays arrays = plain(square, 6, square_triangles, 2);
    assert_ok(context, pc_visual_create(context, &arrays, &visual, &report));
    assert_int_equal(visual.surface.vertex_count, 4);
    assert_int_equal(visual.surface.triangle_count, 2);
    assert_int_equal(visual.corner_count, 6);
    const uint32_t expected[] = {0, 1, 2, 0, 2, 3};
    assert_memory_equal(visual.corner_vertices, expected, sizeof(expected));
    assert_memory_equal(visual.surface.triangles, expected, sizeof(expected));
    assert_memory_equal(visual.corner_triangles, square_triangles, sizeof(square_triangles));
    for (size_t i = 0; i < 12; ++i) {
        assert_false(signbit(visual.surface.positions[i]));
    }
    assert_null(visual.normals);
    assert_null(visual.texcoords);
    assert_null(visual.colors);
    assert_int_equal(visual.material_count, 1);
    assert_string_equal(visual.materials[0].name, "default");
    assert_int_equal(visual.triangle_materials[1], 0);
    assert_int_equal(report.vertices, 4);
    assert_int_equal(report.triangles, 2);
    assert_int_equal(report.components, 1);
    assert_close(report.diagonal, sqrt(2.0), 1e-15);
    assert_int_equal(report.degenerate_triangles + report.duplicate_triangles +
                         report.stray_vertices + report.nonmanifold_edges +
                         report.winding_conflicts + report.replaced_attributes,
                     0);
    pc_visual_free(context, &visual);
    pc_context_destroy(context);
}

// Positions one unit in the last place apart stay apart.
static void welds_equal_bits_only(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    double positions[18];
    memcpy(positions, square, sizeof(positions));
    positions[12] = 1.0 + DBL_EPSILON;
    pc_visual visual = {0};
    const pc_visual_arrays arrays = plain(positions, 6, square_triangles, 2);
    assert_ok(context, pc_visual_create(context, &arrays, &visual, NULL));
    assert_int_equal(visual.surface.vertex_count, 5);
    pc_visual_free(context, &visual);
    pc_context_destroy(context);
}

// Random lattice soup: equality of welded indices against comparing every pair of vertices.
static void welding_agrees_with_all_pairs(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    for (uint64_t seed = 0; seed < 20; ++seed) {
        enum { vertices = 120, triangles = 90 };
        double positions[3 * vertices];
        uint32_t indices[3 * triangles];
        bool used[vertices] = {false};
        for (size_t i = 0; i < 3 * vertices; ++i) {
            positions[i] = floor(pci_random(seed, 0, i) * 4.0) - 1.0;
            positions[i] = positions[i] == 0.0 && i % 2 == 0 ? -0.0 : positions[i];
        }
        for (size_t i = 0; i < 3 * triangles; ++i) {
            indices[i] = (uint32_t)(pci_random(seed, 1, i) * vertices);
            used[indices[i]] = true;
        }
        pc_visual visual = {0};
        pc_visual_report report;
        const pc_visual_arrays arrays = plain(positions, vertices, indices, triangles);
        assert_ok(context, pc_visual_create(context, &arrays, &visual, &report));
        size_t distinct = 0, strays = 0;
        for (size_t v = 0; v < vertices; ++v) {
            bool first = used[v];
            for (size_t w = 0; w < v && first; ++w) {
                first = !(used[w] && positions[3 * v] == positions[3 * w] &&
                          positions[3 * v + 1] == positions[3 * w + 1] &&
                          positions[3 * v + 2] == positions[3 * w + 2]);
            }
            distinct += first;
            strays += !used[v];
        }
        assert_int_equal(visual.surface.vertex_count, distinct);
        assert_int_equal(report.stray_vertices, strays);
        assert_int_equal(visual.corner_count, vertices - strays);
        for (size_t i = 0; i < 3 * triangles; ++i) {
            const uint32_t v = visual.surface.triangles[i];
            assert_int_equal(v, visual.corner_vertices[visual.corner_triangles[i]]);
            for (size_t k = 0; k < 3; ++k) {
                assert_true(visual.surface.positions[3 * v + k] == positions[3 * indices[i] + k]);
            }
        }
        pc_visual_free(context, &visual);
    }
    pc_context_destroy(context);
}

static void drops_stray_vertices_with_their_attributes(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    // Vertex 0 is stray; vertex 2 is stray although its position is in use.
    const double positions[] = {9, 9, 9, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 1, 0};
    const uint32_t triangles[] = {1, 3, 4};
    const float normals[] = {0, 0, 1, 0, 0, 2, 0, 0, 1, 0, 3, 4, 1, 0, 0};
    const float texcoords[] = {9, 9, 0.5F, 0.25F, 9, 9, 1, 2, 3, 4};
    const float colors[] = {9, 9, 9, 9, 1, 2, 0, -1, 9, 9, 9, 9, 0, 0, 0, 1, 0.5F, 0.5F, 0.5F, 1};
    pc_visual_arrays arrays = plain(positions, 5, triangles, 1);
    arrays.normals = normals;
    arrays.texcoords = texcoords;
    arrays.colors = colors;
    pc_visual visual = {0};
    pc_visual_report report;
    assert_ok(context, pc_visual_create(context, &arrays, &visual, &report));
    assert_int_equal(report.stray_vertices, 2);
    assert_int_equal(report.vertices, 3);
    assert_int_equal(visual.corner_count, 3);
    const float expected_normals[] = {0, 0, 1, 0, 0.6F, 0.8F, 1, 0, 0};
    const float expected_texcoords[] = {0.5F, 0.25F, 1, 2, 3, 4};
    const float expected_colors[] = {1, 1, 0, 0, 0, 0, 0, 1, 0.5F, 0.5F, 0.5F, 1};
    assert_memory_equal(visual.normals, expected_normals, sizeof(expected_normals));
    assert_memory_equal(visual.texcoords, expected_texcoords, sizeof(expected_texcoords));
    assert_memory_equal(visual.colors, expected_colors, sizeof(expected_colors));
    assert_close(report.diagonal, sqrt(2.0), 1e-15);
    pc_visual_free(context, &visual);
    pc_context_destroy(context);
}

static void replaces_unusable_attributes(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    const double positions[] = {0, 0, 0, 0, 0, 1, 1, 0, 0};
    const uint32_t triangles[] = {0, 1, 2};
    const float normals[] = {0, 0, 0, NAN, 0, 0, 0, -1, 0};
    const float texcoords[] = {0, 0, INFINITY, 1, 0, 0};
    const float colors[] = {1, 1, 1, 1, 0, 0, 0, 0, NAN, 0, 0, 0};
    pc_visual_arrays arrays = plain(positions, 3, triangles, 1);
    arrays.normals = normals;
    arrays.texcoords = texcoords;
    arrays.colors = colors;
    pc_visual visual = {0};
    pc_visual_report report;
    assert_ok(context, pc_visual_create(context, &arrays, &visual, &report));
    assert_int_equal(report.replaced_attributes, 3);
    const float expected_normals[] = {0, 1, 0, 0, 1, 0, 0, -1, 0};
    assert_memory_equal(visual.normals, expected_normals, sizeof(expected_normals));
    assert_true(visual.texcoords[2] == 0.0F && visual.texcoords[3] == 1.0F);
    assert_true(visual.colors[8] == 1.0F && visual.colors[9] == 0.0F);
    pc_visual_free(context, &visual);
    pc_context_destroy(context);
}

static void copies_materials(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_material materials[2];
    memset(materials, 0x7f, sizeof(materials)); // an unterminated name
    for (size_t m = 0; m < 2; ++m) {
        const float color[] = {0.25F, 2.0F, -1.0F, NAN};
        memcpy(materials[m].base_color, color, sizeof(color));
        materials[m].metallic = 0.5F;
        materials[m].roughness = 0.75F;
        materials[m].double_sided = m == 1;
    }
    memcpy(materials[1].name, "cape", 5);
    const uint32_t triangle_materials[] = {1, 0};
    pc_visual_arrays arrays = plain(square, 6, square_triangles, 2);
    arrays.triangle_materials = triangle_materials;
    arrays.material_count = 2;
    arrays.materials = materials;
    pc_visual visual = {0};
    assert_ok(context, pc_visual_create(context, &arrays, &visual, NULL));
    assert_int_equal(visual.material_count, 2);
    assert_memory_equal(visual.triangle_materials, triangle_materials, sizeof(triangle_materials));
    assert_int_equal(strlen(visual.materials[0].name), 63);
    assert_string_equal(visual.materials[1].name, "cape");
    const float expected[] = {0.25F, 1.0F, 0.0F, 1.0F};
    assert_memory_equal(visual.materials[1].base_color, expected, sizeof(expected));
    assert_true(visual.materials[1].metallic == 0.5F && visual.materials[1].roughness == 0.75F);
    assert_true(visual.materials[1].double_sided && !visual.materials[0].double_sided);
    for (size_t i = 4; i < sizeof(visual.materials[1].name); ++i) {
        assert_int_equal(visual.materials[1].name[i], 0);
    }
    pc_visual_free(context, &visual);
    pc_context_destroy(context);
}

static pc_visual_report report_of(const double *positions, size_t vertices,
                                  const uint32_t *triangles, size_t count) {
    pc_context *context = test_context(1);
    pc_visual visual = {0};
    pc_visual_report report = {0};
    const pc_visual_arrays arrays = plain(positions, vertices, triangles, count);
    assert_ok(context, pc_visual_create(context, &arrays, &visual, &report));
    assert_int_equal(visual.surface.triangle_count, count);
    assert_int_equal(report.triangles, count);
    pc_visual_free(context, &visual);
    pc_context_destroy(context);
    return report;
}

// Corners of a unit cube, and a point on an edge.
static const double cube[] = {0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1,   0, 0, 0,
                              1, 1, 0, 1, 1, 1, 1, 0, 1, 1, 0.5, 0, 0};

static void counts_defects(void **state) {
    (void)state;
    // A square, one triangle with a repeated vertex, one on a line.
    const uint32_t degenerate[] = {0, 1, 2, 0, 2, 3, 1, 1, 2, 0, 8, 1};
    pc_visual_report report = report_of(cube, 9, degenerate, 4);
    assert_int_equal(report.degenerate_triangles, 2);
    assert_int_equal(report.duplicate_triangles, 0);
    assert_int_equal(report.nonmanifold_edges, 0);
    assert_int_equal(report.stray_vertices, 4);
    assert_int_equal(report.vertices, 5);

    // The same triangle three times in different order and winding: two duplicates, no other
    // defect.
    const uint32_t duplicate[] = {0, 1, 2, 2, 0, 1, 2, 1, 0, 0, 2, 3};
    report = report_of(cube, 9, duplicate, 4);
    assert_int_equal(report.duplicate_triangles, 2);
    assert_int_equal(report.nonmanifold_edges, 0);
    assert_int_equal(report.winding_conflicts, 0);
    assert_int_equal(report.degenerate_triangles, 0);

    // Three sheets at one edge.
    const uint32_t sheets[] = {0, 1, 2, 0, 1, 6, 1, 0, 4};
    report = report_of(cube, 9, sheets, 3);
    assert_int_equal(report.nonmanifold_edges, 1);
    assert_int_equal(report.winding_conflicts, 0);

    // A square whose second triangle is turned over.
    const uint32_t turned[] = {0, 1, 2, 0, 3, 2};
    report = report_of(cube, 9, turned, 2);
    assert_int_equal(report.winding_conflicts, 1);

    // Two triangles apart, and a third that touches the first at a vertex only.
    const uint32_t parts[] = {0, 1, 3, 5, 6, 7, 0, 4, 8};
    report = report_of(cube, 9, parts, 3);
    assert_int_equal(report.components, 2);
    assert_close(report.diagonal, sqrt(3.0), 1e-15);
}

static void rejects(pc_status expected, const pc_visual_arrays *arrays, const char *message) {
    pc_context *context = test_context(1);
    static const pc_visual empty;
    pc_visual visual = {0};
    pc_visual_report report;
    memset(&report, 0xff, sizeof(report));
    assert_int_equal(pc_visual_create(context, arrays, &visual, &report), expected);
    assert_string_equal(pc_context_error(context)->message, message);
    assert_memory_equal(&visual, &empty, sizeof(empty));
    assert_int_equal(report.vertices, 0);
    pc_context_destroy(context);
}

static void rejects_damaged_arrays(void **state) {
    (void)state;
    pc_visual_arrays arrays = plain(square, 6, square_triangles, 0);
    rejects(PC_ERROR_INVALID_MESH, &arrays, "visual: the mesh has no triangle");
    arrays = plain(NULL, 6, square_triangles, 2);
    rejects(PC_ERROR_INVALID_ARGUMENT, &arrays, "visual: a count is given without its array");
    arrays = plain(square, (size_t)1 << 31, square_triangles, 2);
    rejects(PC_ERROR_TOO_LARGE, &arrays,
            "visual: 2147483648 vertices and 2 triangles exceed the limit of 2^31 elements");
    arrays = plain(square, 5, square_triangles, 2);
    rejects(PC_ERROR_INVALID_MESH, &arrays, "visual: triangle 1 refers to vertex 5 of 5");
    const uint32_t triangle_materials[] = {0, 1};
    arrays = plain(square, 6, square_triangles, 2);
    arrays.triangle_materials = triangle_materials;
    rejects(PC_ERROR_INVALID_MESH, &arrays, "visual: triangle 1 refers to material 1 of 1");

    double positions[18];
    memcpy(positions, square, sizeof(positions));
    arrays = plain(positions, 6, square_triangles, 2);
    positions[13] = (double)NAN;
    rejects(PC_ERROR_INVALID_MESH, &arrays,
            "visual: vertex 4 has y = nan; coordinates must be finite and at most 1e+30 in size");
    positions[13] = -(double)INFINITY;
    rejects(PC_ERROR_INVALID_MESH, &arrays,
            "visual: vertex 4 has y = -inf; coordinates must be finite and at most 1e+30 in size");
    positions[13] = 1.5e30;
    rejects(PC_ERROR_INVALID_MESH, &arrays,
            "visual: vertex 4 has y = 1.5e+30; coordinates must be finite and at most 1e+30 in "
            "size");
}

static void rejects_surfaces_without_extent(void **state) {
    (void)state;
    double positions[18];
    const pc_visual_arrays arrays = plain(positions, 6, square_triangles, 2);
    for (size_t i = 0; i < 18; ++i) {
        positions[i] = 0.1;
    }
    rejects(PC_ERROR_INVALID_MESH, &arrays, "visual: all positions are equal");
    // A slanted line, rounded to single precision, away from the origin.
    for (size_t v = 0; v < 6; ++v) {
        const double t = (double)((v * 5) % 6) / 7.0;
        positions[3 * v] = (double)(float)(1.0 + t);
        positions[3 * v + 1] = (double)(float)(2.0 - t / 3.0);
        positions[3 * v + 2] = (double)(float)(t * 1.1);
    }
    rejects(PC_ERROR_INVALID_MESH, &arrays, "visual: all positions lie on one line");
    // Wide, but every triangle is a segment.
    const double segments[] = {0, 0, 0, 1, 0, 0, 2, 0, 0, 0, 1, 0, 1, 1, 0, 2, 1, 0};
    const pc_visual_arrays flat = plain(segments, 6, square_triangles, 2);
    rejects(PC_ERROR_INVALID_MESH, &flat, "visual: no triangle has an area");
}

// Small and large units are accepted: a garment of 1e-20 and one of 1e20 across.
static void accepts_any_unit(void **state) {
    (void)state;
    for (int exponent = -20; exponent <= 20; exponent += 20) {
        double positions[18];
        for (size_t i = 0; i < 18; ++i) {
            positions[i] = square[i] * pow(10.0, exponent);
        }
        const pc_visual_report report = report_of(positions, 6, square_triangles, 2);
        assert_int_equal(report.degenerate_triangles, 0);
        assert_int_equal(report.vertices, 4);
    }
}

static void rejects_caller_errors(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    const pc_visual_arrays arrays = plain(square, 6, square_triangles, 2);
    pc_visual visual = {0};
    assert_int_equal(pc_visual_create(context, NULL, &visual, NULL), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_visual_create(context, &arrays, NULL, NULL), PC_ERROR_INVALID_ARGUMENT);
    visual.corner_count = 1;
    assert_int_equal(pc_visual_create(context, &arrays, &visual, NULL), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(visual.corner_count, 1);
    pc_context_destroy(context);
}

// Every allocation fails once.
static void survives_lack_of_memory(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    float attributes[24] = {0};
    pc_visual_arrays arrays = plain(square, 6, square_triangles, 2);
    arrays.normals = arrays.texcoords = arrays.colors = attributes;
    static const pc_visual empty;
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        pc_visual visual = {0};
        s.status = pc_visual_create(context, &arrays, &visual, NULL);
        if (s.status != PC_OK) {
            assert_memory_equal(&visual, &empty, sizeof(empty));
        }
        pc_visual_free(context, &visual);
    }
    assert_true(s.failures > 14);
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(welds_positions_and_keeps_corners),
        cmocka_unit_test(welds_equal_bits_only),
        cmocka_unit_test(welding_agrees_with_all_pairs),
        cmocka_unit_test(drops_stray_vertices_with_their_attributes),
        cmocka_unit_test(replaces_unusable_attributes),
        cmocka_unit_test(copies_materials),
        cmocka_unit_test(counts_defects),
        cmocka_unit_test(rejects_damaged_arrays),
        cmocka_unit_test(rejects_surfaces_without_extent),
        cmocka_unit_test(accepts_any_unit),
        cmocka_unit_test(rejects_caller_errors),
        cmocka_unit_test(survives_lack_of_memory),
    };
    return cmocka_run_group_tests_name("visual", tests, NULL, NULL);
}
