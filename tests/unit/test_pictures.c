#define _POSIX_C_SOURCE 200809L
#include <png.h>

#include "geometry/topology.h"
#include "io/pictures.h"
#include "support/asset_fixture.h"
#include "support/files.h"
#include "support/memory.h"

static char folder[64], strip_path[64], other_path[64];

static pci_image read_png(const char *name) {
    png_image reader = {.version = PNG_IMAGE_VERSION};
    assert_true(png_image_begin_read_from_file(&reader, name));
    reader.format = PNG_FORMAT_RGB;
    pci_image image = {reader.width, reader.height, malloc(3 * reader.width * reader.height)};
    assert_non_null(image.pixels);
    assert_true(png_image_finish_read(&reader, NULL, image.pixels, 0, NULL));
    return image;
}

// Pixels of a square part that are not grey, white or the blue of back sides.
static size_t count_colorful(const pci_image *image, size_t x, size_t y, size_t size) {
    size_t count = 0;
    for (size_t i = 0; i < size * size; ++i) {
        const uint8_t *p = &image->pixels[3 * ((y + i / size) * image->width + x + i % size)];
        const bool grey = abs(p[0] - p[1]) <= 6 && abs(p[1] - p[2]) <= 6;
        const bool blue = p[2] > p[1] && p[1] >= p[0];
        count += !grey && !blue;
    }
    return count;
}

// ---- colours ------------------------------------------------------------------------------------

// Stretched by factors along two directions that are not the axes: the larger change counts.
static void stretch_is_the_largest_principal_change(void **state) {
    (void)state;
    static const double factors[][3] = {{1.2, 1.0, 0.2}, {1.2, 0.7, 0.3},   {1.0, 1.0, 0.0},
                                        {0.5, 0.9, 0.5}, {1.1, 1.15, 0.15}, {0.0, 1.0, 1.0}};
    pc_context *context = test_context(1);
    for (size_t i = 0; i < 6; ++i) {
        double rest[12] = {0.1, 0.2, 0.0, 1.3, 0.1, 0.0, 1.0, 1.4, 0.0, -0.2, 0.9, 0.0};
        uint32_t triangles[9] = {0, 1, 2, 0, 2, 3, 1, 1, 2}; // the last one has no area
        double posed[12], values[4];
        const double c = cos(0.6), s = sin(0.6);
        for (size_t v = 0; v < 4; ++v) {
            const double *p = &rest[3 * v];
            const double u = factors[i][0] * (c * p[0] + s * p[1]);
            const double w = factors[i][1] * (-s * p[0] + c * p[1]);
            // And turned out of the plane.
            posed[3 * v] = 3.0 + u, posed[3 * v + 1] = 0.8 * w, posed[3 * v + 2] = 0.6 * w;
        }
        const pc_mesh mesh = {4, rest, 3, triangles};
        pci_scratch scratch = pci_scratch_begin(context);
        float colors[12], expected[3];
        assert_true(pci_stretch_colors(&scratch, &mesh, posed, values, colors));
        pci_stretch_color(factors[i][2], expected);
        for (size_t v = 0; v < 4; ++v) {
            assert_close(values[v], factors[i][2], 1e-7);
            for (size_t k = 0; k < 3; ++k) {
                assert_close((double)colors[3 * v + k], (double)expected[k], 1e-5);
            }
        }
        pci_scratch_end(&scratch);
    }
    pc_context_destroy(context);
}

// From grey to violet without a jump, the same beyond the end.
static void stretch_colors_are_continuous(void **state) {
    (void)state;
    float before[3], color[3];
    pci_stretch_color(0.0, before);
    assert_true(fabsf(before[0] - before[2]) < 0.05F);
    for (double stretch = 0.0; stretch < 0.4; stretch += 0.001) {
        pci_stretch_color(stretch, color);
        for (size_t k = 0; k < 3; ++k) {
            assert_true(fabsf(color[k] - before[k]) < 0.02F && color[k] >= 0.0F &&
                        color[k] <= 1.0F);
        }
        memcpy(before, color, sizeof(before));
    }
    pci_stretch_color(9.0, color);
    assert_memory_equal(color, before, sizeof(color));
}

// Proxy vertices joined by an edge, or by two, look different.
static void neighbours_have_different_colors(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    pci_scratch scratch = pci_scratch_begin(context);
    pci_topology topology;
    const pc_mesh *proxy = &asset.single_layer; // 48 vertices
    assert_true(pci_topology_build(&scratch, proxy, &topology));
    const float *colors = pci_bone_colors(&scratch, proxy);
    assert_non_null(colors);
    for (size_t v = 0; v < proxy->vertex_count; ++v) {
        for (size_t e = topology.ring_offsets[v]; e < topology.ring_offsets[v + 1]; ++e) {
            const float *near = &colors[3 * (size_t)topology.ring[e]];
            double difference = 0.0;
            for (size_t k = 0; k < 3; ++k) {
                difference = fmax(difference, fabs((double)(near[k] - colors[3 * v + k])));
            }
            assert_true(difference > 0.1);
        }
    }
    pci_scratch_end(&scratch);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

// One bone shows its colour; the more bones share a vertex, the lighter it is.
static void shared_vertices_are_lighter(void **state) {
    (void)state;
    const float bones[6] = {0.8F, 0.04F, 0.04F, 0.04F, 0.04F, 0.8F};
    uint32_t indices[6] = {0, 1, 0, 1, 0, 1};
    double weights[6] = {1.0, 0.0, 0.7, 0.3, 0.5, 0.5};
    const pc_skin skin = {3, 2, indices, weights, PC_SKINNING_TRANSLATION};
    float colors[9];
    pci_weight_colors(&skin, bones, colors);
    for (size_t k = 0; k < 3; ++k) {
        assert_close((double)colors[k], (double)bones[k], 1e-6);
    }
    assert_true(colors[3 + 1] > colors[1] && colors[6 + 1] > colors[3 + 1]);
    assert_close((double)colors[6], (double)colors[8], 1e-6);
}

// ---- strip --------------------------------------------------------------------------------------

enum { TILE = 96, TITLE = TILE / 8, GAP = TILE / 24 };
static const pc_strip_options small_strip = {.strip_tile = TILE, .strip_frames = 3};

// Rows of the strip: only the weights, and stretch where there is some, have colours.
static void a_strip_has_four_rows(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    asset.options.simulate.up_axis = 1;
    for (size_t pass = 0; pass < 2; ++pass) {
        // The second time the proxy only rises.
        for (size_t i = 0; i < 3 * FIXTURE_FRAMES * asset.proxy.vertex_count && pass == 1; ++i) {
            asset.motion.positions[i] = asset.proxy.positions[i % (3 * asset.proxy.vertex_count)] +
                                        (i % 3 == 1 ? 0.3 : 0.0);
        }
        assert_ok(context, pc_export_strip(context, &asset, &small_strip, strip_path));
        pci_image image = read_png(strip_path);
        assert_int_equal(image.width, 2 * GAP + 3 * TILE);
        assert_int_equal(image.height, GAP + 4 * (TILE + TITLE));
        for (size_t row = 0; row < 4; ++row) {
            for (size_t column = 0; column < 3; ++column) {
                const size_t colorful =
                    count_colorful(&image, GAP + column * TILE, TITLE + row * (TILE + TITLE), TILE);
                if (row == 1 || (row == 3 && pass == 0)) {
                    assert_true(colorful > 300);
                } else {
                    assert_int_equal(colorful, 0);
                }
            }
        }
        free(image.pixels);
    }
    // More pictures than frames.
    const pc_strip_options many = {.strip_tile = TILE, .strip_frames = 7};
    assert_ok(context, pc_export_strip(context, &asset, &many, strip_path));
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

static void equal_bytes_at_any_thread_count(void **state) {
    (void)state;
    static const uint32_t threads[] = {1, 2, 3, 8};
    for (size_t i = 0; i < 4; ++i) {
        pc_context *context = test_context(threads[i]);
        pc_asset asset;
        fixture_asset(context, 4, &asset);
        assert_ok(context,
                  pc_export_strip(context, &asset, &small_strip, i == 0 ? other_path : strip_path));
        if (i > 0) {
            assert_same_file(strip_path, other_path);
        }
        pc_asset_free(context, &asset);
        pc_context_destroy(context);
    }
}

static void refuses_what_it_cannot_do(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    unlink(strip_path);
    assert_int_equal(pc_export_strip(NULL, &asset, NULL, strip_path), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_export_strip(context, NULL, NULL, strip_path), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_export_strip(context, &asset, NULL, NULL), PC_ERROR_INVALID_ARGUMENT);
    const pc_strip_options bad[] = {{95, 5}, {2049, 5}, {96, 1}, {96, 65}};
    for (size_t i = 0; i < 4; ++i) {
        assert_int_equal(pc_export_strip(context, &asset, &bad[i], strip_path),
                         PC_ERROR_INVALID_OPTIONS);
    }
    --asset.stage_count;
    assert_int_equal(pc_export_strip(context, &asset, NULL, strip_path), PC_ERROR_INVALID_ARGUMENT);
    ++asset.stage_count;
    assert_int_equal(
        pc_export_strip(context, &asset, &small_strip, "/tmp/proxycloth-missing/a/b.png"),
        PC_ERROR_IO);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
    context = test_cancelling_context();
    fixture_asset(context, 4, &asset);
    assert_int_equal(pc_export_strip(context, &asset, &small_strip, strip_path),
                     PC_ERROR_CANCELLED);
    assert_int_equal(access(strip_path, F_OK), -1);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

static void survives_a_lack_of_memory(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    const pc_strip_options quick = {.strip_tile = 96, .strip_frames = 2};
    unlink(strip_path);
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        s.status = pc_export_strip(context, &asset, &quick, strip_path);
        assert_int_equal(access(strip_path, F_OK), s.status == PC_OK ? 0 : -1);
    }
    assert_true(s.failures > 19);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

static int make_folder(void **state) {
    (void)state;
    return test_make_folder(folder, strip_path, "strip.png", other_path, "other.png");
}

static int remove_folder(void **state) {
    (void)state;
    return test_remove_folder(folder, strip_path, other_path);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(stretch_is_the_largest_principal_change),
        cmocka_unit_test(stretch_colors_are_continuous),
        cmocka_unit_test(neighbours_have_different_colors),
        cmocka_unit_test(shared_vertices_are_lighter),
        cmocka_unit_test(a_strip_has_four_rows),
        cmocka_unit_test(equal_bytes_at_any_thread_count),
        cmocka_unit_test(refuses_what_it_cannot_do),
        cmocka_unit_test(survives_a_lack_of_memory),
    };
    return cmocka_run_group_tests(tests, make_folder, remove_folder);
}
