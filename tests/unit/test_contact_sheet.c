#define _POSIX_C_SOURCE 200809L
#include <png.h>

#include "geometry/render.h"
#include "io/lettering.h"
#include "io/png_image.h"
#include "support/asset_fixture.h"
#include "support/files.h"
#include "support/memory.h"
#include "support/shapes.h"
#include "support/test.h"

static char folder[64], sheet_path[64], other_path[64];

static int make_folder(void **state) {
    (void)state;
    return test_make_folder(folder, sheet_path, "sheet.png", other_path, "other.png");
}

static int remove_folder(void **state) {
    (void)state;
    return test_remove_folder(folder, sheet_path, other_path);
}

// ---- images -----------------------------------------------------------------------------------

static pci_image new_image(size_t width, size_t height) {
    pci_image image = {width, height, malloc(3 * width * height)};
    assert_non_null(image.pixels);
    memset(image.pixels, 0xff, 3 * width * height);
    return image;
}

static const uint8_t *pixel_at(const pci_image *image, size_t x, size_t y) {
    assert_true(x < image->width && y < image->height);
    return &image->pixels[3 * (y * image->width + x)];
}

static pci_image read_png(const char *path) {
    png_image reader = {.version = PNG_IMAGE_VERSION};
    assert_true(png_image_begin_read_from_file(&reader, path));
    reader.format = PNG_FORMAT_RGB;
    pci_image image = new_image(reader.width, reader.height);
    assert_true(png_image_finish_read(&reader, NULL, image.pixels, 0, NULL));
    return image;
}

static bool is_white(const uint8_t *p) { return p[0] == 255 && p[1] == 255 && p[2] == 255; }
static bool is_grey(const uint8_t *p) {
    return p[0] > 60 && p[0] < 230 && abs(p[0] - p[1]) <= 4 && abs(p[0] - p[2]) <= 4;
}
static bool is_blue(const uint8_t *p) { return p[2] > p[0] + 40 && p[2] > p[1] + 20; }
static bool is_dark(const uint8_t *p) { return p[0] < 70 && p[1] < 70 && p[2] < 70; }

// Looks along -z.
static pci_camera front_camera(double scale) {
    const pci_camera camera = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {0, 0}, scale};
    return camera;
}

static void draw(pc_context *context, const pc_mesh *mesh, pci_look look, pci_style style,
                 const pci_camera *camera, pci_image *image) {
    pci_scratch scratch = pci_scratch_begin(context);
    pci_renderer renderer;
    pci_model model;
    const pci_picture picture = {{0, 0, image->width}, NULL};
    assert_true(pci_renderer_begin(&renderer, context, &scratch, image, image->width));
    assert_true(pci_model_build(&renderer, &scratch, mesh, look, NULL, &model));
    assert_true(pci_draw(&renderer, &model, camera, style, &picture, 1));
    pci_scratch_end(&scratch);
}

// ---- renderer ---------------------------------------------------------------------------------

// A square of side 2 at height z, cut along the diagonal from (-1, -1) to (1, 1).
static void set_square(double z, double positions[12]) {
    const double corners[12] = {-1, -1, z, 1, -1, z, 1, 1, z, -1, 1, z};
    memcpy(positions, corners, sizeof(corners));
}
static uint32_t square_triangles[6] = {0, 1, 2, 0, 2, 3};

static void covers_what_a_square_covers(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    double positions[12];
    set_square(0.0, positions);
    const pc_mesh square = {4, positions, 2, square_triangles};
    pci_image image = new_image(100, 100);
    const pci_camera camera = front_camera(30.0); // pixels 20 to 80
    draw(context, &square, PCI_LOOK_SMOOTH, PCI_STYLE_SURFACE, &camera, &image);
    for (size_t y = 0; y < 100; ++y) {
        for (size_t x = 0; x < 100; ++x) {
            const bool inside = x >= 20 && x < 80 && y >= 20 && y < 80;
            assert_true(inside ? is_grey(pixel_at(&image, x, y))
                               : is_white(pixel_at(&image, x, y)));
        }
    }
    // An edge in the middle third of a pixel gives one third of the coverage more or less.
    const pci_camera shifted = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {-1.0 / 60.0, 0}, 30.0};
    pci_image partial = new_image(100, 100);
    draw(context, &square, PCI_LOOK_SMOOTH, PCI_STYLE_SURFACE, &shifted, &partial);
    const uint8_t edge = *pixel_at(&partial, 20, 50), inner = *pixel_at(&partial, 50, 50);
    assert_true(edge > inner + 10 && edge < 245);
    free(image.pixels);
    free(partial.pixels);
    pc_context_destroy(context);
}

static void shows_front_and_back(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    double positions[12];
    set_square(0.0, positions);
    uint32_t turned[6] = {0, 2, 1, 0, 3, 2};
    const pc_mesh front = {4, positions, 2, square_triangles}, back = {4, positions, 2, turned};
    const pci_camera camera = front_camera(30.0);
    pci_image image = new_image(100, 100);
    draw(context, &front, PCI_LOOK_FLAT, PCI_STYLE_SURFACE, &camera, &image);
    assert_true(is_grey(pixel_at(&image, 50, 50)));
    draw(context, &back, PCI_LOOK_FLAT, PCI_STYLE_SURFACE, &camera, &image);
    assert_true(is_blue(pixel_at(&image, 50, 50)));
    // Where both lie on each other the front is drawn, whatever the order.
    for (size_t i = 0; i < 2; ++i) {
        uint32_t both[12];
        memcpy(i == 0 ? both : both + 6, square_triangles, sizeof(square_triangles));
        memcpy(i == 0 ? both + 6 : both, turned, sizeof(turned));
        const pc_mesh doubled = {4, positions, 4, both};
        draw(context, &doubled, PCI_LOOK_FLAT, PCI_STYLE_SURFACE, &camera, &image);
        for (size_t y = 21; y < 79; ++y) {
            for (size_t x = 21; x < 79; ++x) {
                assert_true(is_grey(pixel_at(&image, x, y)));
            }
        }
    }
    free(image.pixels);
    pc_context_destroy(context);
}

static void draws_edges_and_hides_what_is_behind(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    // In front a square with its diagonal, behind it a smaller square, turned by a quarter.
    double positions[24];
    set_square(0.0, positions);
    set_square(-1.0, positions + 12);
    for (size_t i = 12; i < 24; ++i) {
        positions[i] *= i % 3 == 2 ? 1.0 : 0.5;
    }
    uint32_t triangles[12] = {0, 1, 2, 0, 2, 3, 5, 6, 7, 5, 7, 4};
    const pc_mesh mesh = {8, positions, 4, triangles};
    const pci_camera camera = front_camera(30.0);
    pci_image image = new_image(100, 100);
    draw(context, &mesh, PCI_LOOK_FLAT, PCI_STYLE_SURFACE_AND_EDGES, &camera, &image);
    for (size_t i = 24; i < 76; ++i) {
        assert_true(is_dark(pixel_at(&image, i, 99 - i))); // the diagonal, y points down
        if (abs((int)i - 50) > 3) {
            assert_true(is_grey(pixel_at(&image, i, i)));                 // the hidden diagonal
            assert_true(is_grey(pixel_at(&image, 35, i)) || i + 35 > 96); // the hidden border
        }
    }
    // Border edges are drawn inside the square and are bolder.
    for (size_t i = 25; i < 75; ++i) {
        assert_true(is_dark(pixel_at(&image, 20, i)));
        assert_true(is_dark(pixel_at(&image, i, 79)));
    }
    // Seen from behind, the other one hides its part of the diagonal.
    const pci_camera behind = {{-1, 0, 0}, {0, 1, 0}, {0, 0, -1}, {0, 0}, 30.0};
    draw(context, &mesh, PCI_LOOK_FLAT, PCI_STYLE_SURFACE_AND_EDGES, &behind, &image);
    assert_true(is_dark(pixel_at(&image, 28, 28)));
    assert_true(is_blue(pixel_at(&image, 45, 45)));
    assert_true(is_dark(pixel_at(&image, 45, 54)));
    free(image.pixels);
    pc_context_destroy(context);
}

static void lays_edges_over_a_picture(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    double positions[12];
    set_square(0.0, positions);
    const pc_mesh square = {4, positions, 2, square_triangles};
    const pci_camera camera = front_camera(30.0);
    pci_image image = new_image(100, 100);
    draw(context, &square, PCI_LOOK_UNLIT, PCI_STYLE_EDGES_ON_TOP, &camera, &image);
    assert_true(is_white(pixel_at(&image, 60, 60)));
    const uint8_t *line = pixel_at(&image, 60, 39);
    assert_true(!is_white(line) && !is_dark(line));
    free(image.pixels);
    pc_context_destroy(context);
}

static void leaves_no_cracks(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    // A jittered grid over the square: every pixel inside is covered, whatever edges pass by.
    enum { SIDE = 40 };
    static double positions[3 * SIDE * SIDE];
    static uint32_t triangles[6 * (SIDE - 1) * (SIDE - 1)];
    size_t count = 0;
    for (uint32_t i = 0; i < SIDE * SIDE; ++i) {
        const uint32_t x = i % SIDE, y = i / SIDE;
        const bool border = x == 0 || y == 0 || x == SIDE - 1 || y == SIDE - 1;
        const double jitter = border ? 0.0 : 0.3;
        positions[3 * i] = 2.0 * (x + jitter * pci_random(1, 0, i)) / (SIDE - 1) - 1.0;
        positions[3 * i + 1] = 2.0 * (y + jitter * pci_random(1, 1, i)) / (SIDE - 1) - 1.0;
        positions[3 * i + 2] = 1e6; // far away in depth
        if (x + 1 < SIDE && y + 1 < SIDE) {
            const uint32_t cell[6] = {i, i + 1, i + SIDE + 1, i, i + SIDE + 1, i + SIDE};
            memcpy(&triangles[count], cell, sizeof(cell));
            count += 6;
        }
    }
    const pc_mesh mesh = {SIDE * SIDE, positions, count / 3, triangles};
    const pci_camera camera = front_camera(30.0);
    pci_image image = new_image(100, 100);
    draw(context, &mesh, PCI_LOOK_SMOOTH, PCI_STYLE_SURFACE, &camera, &image);
    const uint8_t middle = *pixel_at(&image, 50, 50);
    for (size_t y = 20; y < 80; ++y) {
        for (size_t x = 20; x < 80; ++x) {
            assert_true(abs(*pixel_at(&image, x, y) - middle) <= 3);
        }
    }
    free(image.pixels);
    pc_context_destroy(context);
}

static void darkens_what_is_enclosed(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    // The floor of a box without lid is darker than an open square.
    double box[] = {-1, -1, 0, 1, -1, 0, 1, 1, 0, -1, 1, 0, -1, -1, 2, 1, -1, 2, 1, 1, 2, -1, 1, 2};
    uint32_t faces[] = {0, 1, 2, 0, 2, 3, 0, 4, 5, 0, 5, 1, 1, 5, 6,
                        1, 6, 2, 2, 6, 7, 2, 7, 3, 3, 7, 4, 3, 4, 0};
    const pc_mesh open = {8, box, 2, faces}, enclosed = {8, box, 10, faces};
    const pci_camera camera = front_camera(30.0);
    pci_image image = new_image(100, 100);
    draw(context, &open, PCI_LOOK_FLAT, PCI_STYLE_SURFACE, &camera, &image);
    const uint8_t bright = *pixel_at(&image, 50, 50);
    draw(context, &enclosed, PCI_LOOK_FLAT, PCI_STYLE_SURFACE, &camera, &image);
    assert_true(*pixel_at(&image, 50, 50) + 30 < bright);
    free(image.pixels);
    pc_context_destroy(context);
}

static void survives_useless_triangles(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    // A needle, a point, a repeated vertex, corners far outside the tile.
    double positions[] = {0,    0,     0, 1,     1,    0, 0.5, 0.5,  0,
                          1e25, -1e25, 3, -1e25, 1e25, 0, 2,   1e25, 0};
    uint32_t triangles[] = {0, 1, 2, 0, 0, 0, 1, 1, 2, 3, 4, 5};
    const pc_mesh mesh = {6, positions, 4, triangles};
    const pci_camera camera = front_camera(30.0);
    pci_image image = new_image(50, 50);
    draw(context, &mesh, PCI_LOOK_SMOOTH, PCI_STYLE_SURFACE_AND_EDGES, &camera, &image);
    const pc_mesh small = {6, positions, 3, triangles};
    pci_image untouched = new_image(50, 50);
    draw(context, &small, PCI_LOOK_SMOOTH, PCI_STYLE_SURFACE_AND_EDGES, &camera, &untouched);
    for (size_t i = 0; i < 3 * 50 * 50; ++i) {
        assert_int_equal(untouched.pixels[i], 255);
    }
    free(image.pixels);
    free(untouched.pixels);
    pc_context_destroy(context);
}

static void draws_the_same_with_every_kernel(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    // A sphere in a box without lid: triangles of many sizes, shadows, and both sides.
    pc_mesh mesh = shape_sphere(context, 40, 0.8), box = shape_box(context, 1, 1, 1);
    box.triangle_count -= 2;
    shape_append(context, &mesh, &box, true);
    const pci_camera camera = front_camera(40.0);
    pci_image images[2];
    for (size_t i = 0; i < 2; ++i) {
        pci_scratch scratch = pci_scratch_begin(context);
        pci_renderer renderer;
        pci_model model;
        images[i] = new_image(100, 100);
        const pci_picture picture = {{0, 0, 100}, NULL};
        assert_true(pci_renderer_begin(&renderer, context, &scratch, &images[i], 100));
        if (i == 1) {
            renderer.dome.kernel = &pci_dome_generic;
        }
        assert_true(pci_model_build(&renderer, &scratch, &mesh, PCI_LOOK_SMOOTH, NULL, &model));
        assert_true(pci_draw(&renderer, &model, &camera, PCI_STYLE_SURFACE_AND_EDGES, &picture, 1));
        pci_scratch_end(&scratch);
    }
    assert_memory_equal(images[0].pixels, images[1].pixels, 3 * 100 * 100);
    free(images[0].pixels);
    free(images[1].pixels);
    pc_mesh_free(context, &mesh);
    pc_mesh_free(context, &box);
    pc_context_destroy(context);
}

// ---- files ------------------------------------------------------------------------------------

static void writes_images_of_any_size(void **state) {
    (void)state;
    pc_context *contexts[2] = {test_context(1), test_context(3)};
    // One pixel; a few pieces; more than one round of them; rows longer than a piece.
    static const size_t sizes[4][2] = {{1, 1}, {333, 1000}, {3000, 2000}, {90000, 3}};
    for (size_t i = 0; i < 4; ++i) {
        pci_image image = new_image(sizes[i][0], sizes[i][1]);
        for (size_t k = 0; k < 3 * image.width * image.height; ++k) {
            image.pixels[k] = (uint8_t)(k % 7 == 0 ? k / 7 : k / 1000);
        }
        const char *paths[2] = {sheet_path, other_path};
        for (size_t c = 0; c < 2; ++c) {
            assert_ok(contexts[c], pci_write_png(contexts[c], "export", &image, paths[c]));
        }
        pci_image read = read_png(sheet_path);
        assert_int_equal(read.width, image.width);
        assert_int_equal(read.height, image.height);
        assert_memory_equal(read.pixels, image.pixels, 3 * image.width * image.height);
        bytes one = read_bytes(sheet_path), three = read_bytes(other_path);
        assert_int_equal(one.size, three.size);
        assert_memory_equal(one.data, three.data, one.size);
        free(one.data);
        free(three.data);
        free(read.pixels);
        free(image.pixels);
    }
    pc_context_destroy(contexts[0]);
    pc_context_destroy(contexts[1]);
}

// ---- lettering --------------------------------------------------------------------------------

static void writes_text(void **state) {
    (void)state;
    static const uint8_t black[3] = {0, 0, 0};
    pci_image image = new_image(300, 40);
    const char *text = "Proxy 128 v  230 f";
    const double end = pci_draw_text(&image, 10.0, 30.0, 12.0, black, text);
    assert_close(end - 10.0, pci_text_width(text, 12.0), 1e-9);
    assert_close(pci_text_width(text, 24.0), 2.0 * pci_text_width(text, 12.0), 1e-9);
    size_t dark = 0;
    for (size_t y = 0; y < 40; ++y) {
        for (size_t x = 0; x < 300; ++x) {
            const bool inside = x >= 8 && (double)x <= end && y >= 16 && y <= 35;
            dark += *pixel_at(&image, x, y) < 128;
            assert_true(inside || is_white(pixel_at(&image, x, y)));
        }
    }
    assert_true(dark > 100);
    // One box for each character that is not ASCII; writing beyond the image is cut.
    assert_close(pci_text_width("\xc3\xbc", 6.0), pci_text_width("\xe2\x82\xac", 6.0), 0.0);
    assert_close(pci_text_width("\xc3\xbc\xc3\xbc", 6.0), 2.0 * pci_text_width("\xc3\xbc", 6.0),
                 1e-12);
    assert_true(pci_text_width("\x01", 6.0) > 0.0);
    pci_draw_text(&image, -20.0, 2.0, 30.0, black, text);
    pci_draw_text(&image, 290.0, 60.0, 30.0, black, text);
    free(image.pixels);
}

static void gives_every_character_another_shape(void **state) {
    (void)state;
    static const uint8_t black[3] = {0, 0, 0};
    static uint8_t shapes[95][40 * 40 * 3];
    for (size_t i = 0; i < 95; ++i) {
        pci_image image = new_image(40, 40);
        const char text[2] = {(char)(' ' + i), '\0'};
        pci_draw_text(&image, 10.0, 28.0, 18.0, black, text);
        memcpy(shapes[i], image.pixels, sizeof(shapes[i]));
        free(image.pixels);
        for (size_t j = 0; j < i; ++j) {
            assert_memory_not_equal(shapes[i], shapes[j], sizeof(shapes[i]));
        }
    }
}

// ---- sheet ------------------------------------------------------------------------------------

static const pc_contact_sheet_options small_sheet = {.tile_size = 120, .skinned_frames = 3};
enum { TILE = 120, MARGIN = 4, CAPTION = 10, TITLE = 13 };

static void write_sheet(pc_context *context, const pc_asset *asset,
                        const pc_contact_sheet_options *options, pci_image *image) {
    assert_ok(context, pc_export_contact_sheet(context, asset, options, sheet_path));
    *image = read_png(sheet_path);
}

static const uint8_t *tile_pixel(const pci_image *image, size_t row, size_t column, double x,
                                 double y) {
    return pixel_at(image, MARGIN + column * (TILE + MARGIN) + (size_t)(x * TILE),
                    MARGIN + TITLE + row * (TILE + CAPTION + MARGIN) + (size_t)(y * TILE));
}

static void lays_out_the_stages(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    asset.options.simulate.up_axis = 1;
    pci_image image;
    write_sheet(context, &asset, &small_sheet, &image);
    assert_int_equal(image.width, MARGIN + 6 * (TILE + MARGIN));
    assert_int_equal(image.height, MARGIN + TITLE + 4 * (TILE + CAPTION + MARGIN));
    free(image.pixels);
    for (size_t i = 0; i < image.width; i += image.width - 1) {
        for (size_t j = 0; j < image.height; j += image.height - 1) {
            image = read_png(sheet_path);
            assert_true(is_white(pixel_at(&image, i, j)));
            free(image.pixels);
        }
    }
    // A PNG without time stamp.
    bytes file = read_bytes(sheet_path);
    static const unsigned char signature[8] = {0x89, 'P', 'N', 'G', '\r', '\n', 0x1a, '\n'};
    assert_memory_equal(file.data, signature, sizeof(signature));
    for (size_t i = 0; i + 4 <= file.size; ++i) {
        assert_memory_not_equal(&file.data[i], "tIME", 4);
    }
    free(file.data);
    // Frames are optional, and as many rows are added as they need.
    const pc_contact_sheet_options none = {.tile_size = TILE, .skinned_frames = 0};
    write_sheet(context, &asset, &none, &image);
    assert_int_equal(image.height, MARGIN + TITLE + 2 * (TILE + CAPTION + MARGIN));
    free(image.pixels);
    const pc_contact_sheet_options all = {.tile_size = TILE, .skinned_frames = 60};
    write_sheet(context, &asset, &all, &image); // there are only 5
    assert_int_equal(image.height, MARGIN + TITLE + 4 * (TILE + CAPTION + MARGIN));
    free(image.pixels);
    // Stages that did not run are left out.
    asset.stage_count = PC_STAGE_CARVE;
    write_sheet(context, &asset, &small_sheet, &image);
    assert_int_equal(image.width, MARGIN + 3 * (TILE + MARGIN));
    assert_int_equal(image.height, MARGIN + TITLE + 2 * (TILE + CAPTION + MARGIN));
    free(image.pixels);
    asset.stage_count = PC_STAGE_COUNT;
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

// A square whose front is +z (up is y) or -y (up is z), alone in an asset.
static pc_asset square_asset(pc_context *context, uint32_t up_axis) {
    pc_asset asset = {.stage_count = PC_STAGE_SIMULATE + 1};
    asset.options.simulate.up_axis = up_axis;
    pc_mesh *mesh = &asset.visual.surface;
    mesh->vertex_count = 4;
    mesh->triangle_count = 2;
    mesh->positions = PCI_ALLOCATE(context, double, 12);
    mesh->triangles = fixture_copy(context, square_triangles, sizeof(square_triangles));
    set_square(0.0, mesh->positions);
    for (size_t v = 0; v < 4 && up_axis == 2; ++v) {
        mesh->positions[3 * v + 2] = mesh->positions[3 * v + 1];
        mesh->positions[3 * v + 1] = 0.0;
    }
    return asset;
}

static void looks_at_front_and_back(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    for (uint32_t up_axis = 1; up_axis < 3; ++up_axis) {
        pc_asset asset = square_asset(context, up_axis);
        pci_image image;
        write_sheet(context, &asset, &small_sheet, &image);
        assert_true(is_grey(tile_pixel(&image, 0, 0, 0.5, 0.5)));
        assert_true(is_blue(tile_pixel(&image, 1, 0, 0.5, 0.5)));
        // Slightly from above, from the viewer's right: the right side is nearer, so the upper
        // border falls towards it; the corners of the tile stay empty.
        assert_true(is_white(tile_pixel(&image, 0, 0, 0.01, 0.01)));
        assert_true(is_white(tile_pixel(&image, 0, 0, 0.99, 0.01)));
        free(image.pixels);
        pc_asset_free(context, &asset);
    }
    pc_context_destroy(context);
}

// Mean position of what is not white in a tile.
static void centroid(const pci_image *image, size_t row, size_t column, double out[2]) {
    double count = 0.0;
    out[0] = out[1] = 0.0;
    for (size_t y = 0; y < TILE; ++y) {
        for (size_t x = 0; x < TILE; ++x) {
            if (!is_white(tile_pixel(image, row, column, ((double)x + 0.5) / TILE,
                                     ((double)y + 0.5) / TILE))) {
                out[0] += (double)x, out[1] += (double)y, count += 1.0;
            }
        }
    }
    assert_true(count > 100.0);
    out[0] /= count, out[1] /= count;
}

static void shows_the_motion_with_one_camera(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    asset.options.simulate.up_axis = 1;
    // The proxy rises without turning, so the garment does.
    for (size_t f = 0; f < FIXTURE_FRAMES; ++f) {
        for (size_t v = 0; v < asset.motion.vertex_count; ++v) {
            double *p = &asset.motion.positions[3 * (f * asset.motion.vertex_count + v)];
            memcpy(p, &asset.proxy.positions[3 * v], 3 * sizeof(double));
            p[1] += 0.2 * (double)f;
        }
    }
    pci_image image;
    const pc_contact_sheet_options five = {.tile_size = TILE, .skinned_frames = 5};
    write_sheet(context, &asset, &five, &image);
    double first[2], before[2], after[2];
    centroid(&image, 2, 0, first);
    memcpy(before, first, sizeof(before));
    for (size_t i = 1; i < 5; ++i) {
        centroid(&image, 2, i, after);
        assert_close(after[0], first[0], 0.7);
        assert_true(after[1] < before[1] - 4.0);
        memcpy(before, after, sizeof(before));
    }
    // Equal steps.
    centroid(&image, 2, 2, after);
    assert_close(first[1] - after[1], 0.5 * (first[1] - before[1]), 0.8);
    free(image.pixels);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

static void writes_equal_bytes_at_any_thread_count(void **state) {
    (void)state;
    for (uint32_t i = 0; i < 4; ++i) {
        const uint32_t threads[4] = {1, 2, 3, 8};
        pc_context *context = test_context(threads[i]);
        pc_asset asset;
        fixture_asset(context, 4, &asset);
        assert_ok(context, pc_export_contact_sheet(context, &asset, &small_sheet,
                                                   i == 0 ? other_path : sheet_path));
        if (i > 0) {
            assert_same_file(sheet_path, other_path);
        }
        pc_asset_free(context, &asset);
        pc_context_destroy(context);
    }
}

// ---- contract ---------------------------------------------------------------------------------

static void refuses_what_it_cannot_do(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    unlink(sheet_path);
    assert_int_equal(pc_export_contact_sheet(NULL, &asset, NULL, sheet_path),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_export_contact_sheet(context, NULL, NULL, sheet_path),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_export_contact_sheet(context, &asset, NULL, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    const pc_asset empty = {0};
    assert_int_equal(pc_export_contact_sheet(context, &empty, NULL, sheet_path),
                     PC_ERROR_INVALID_ARGUMENT);
    const pc_contact_sheet_options bad[] = {{95, 5}, {2049, 5}, {360, 65}};
    for (size_t i = 0; i < 3; ++i) {
        assert_int_equal(pc_export_contact_sheet(context, &asset, &bad[i], sheet_path),
                         PC_ERROR_INVALID_OPTIONS);
    }
    --asset.motion.vertex_count;
    assert_int_equal(pc_export_contact_sheet(context, &asset, &small_sheet, sheet_path),
                     PC_ERROR_INVALID_ARGUMENT);
    ++asset.motion.vertex_count;
    const pc_contact_sheet_options quick = {.tile_size = 96, .skinned_frames = 0};
    assert_int_equal(
        pc_export_contact_sheet(context, &asset, &quick, "/tmp/proxycloth-missing/a/b.png"),
        PC_ERROR_IO);
    assert_int_equal(access(sheet_path, F_OK), -1);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);

    context = test_cancelling_context();
    fixture_asset(context, 4, &asset);
    assert_int_equal(pc_export_contact_sheet(context, &asset, &quick, sheet_path),
                     PC_ERROR_CANCELLED);
    assert_int_equal(access(sheet_path, F_OK), -1);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

static void survives_a_lack_of_memory(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    asset.stage_count = PC_STAGE_ISOSURFACE + 1; // two meshes show every allocation
    const pc_contact_sheet_options quick = {.tile_size = 96, .skinned_frames = 0};
    unlink(sheet_path);
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        s.status = pc_export_contact_sheet(context, &asset, &quick, sheet_path);
        assert_int_equal(access(sheet_path, F_OK), s.status == PC_OK ? 0 : -1);
    }
    assert_true(s.failures > 10);
    asset.stage_count = PC_STAGE_COUNT;
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
    assert_int_equal(counter.live, 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(covers_what_a_square_covers),
        cmocka_unit_test(shows_front_and_back),
        cmocka_unit_test(draws_edges_and_hides_what_is_behind),
        cmocka_unit_test(lays_edges_over_a_picture),
        cmocka_unit_test(leaves_no_cracks),
        cmocka_unit_test(darkens_what_is_enclosed),
        cmocka_unit_test(survives_useless_triangles),
        cmocka_unit_test(draws_the_same_with_every_kernel),
        cmocka_unit_test(writes_images_of_any_size),
        cmocka_unit_test(writes_text),
        cmocka_unit_test(gives_every_character_another_shape),
        cmocka_unit_test(lays_out_the_stages),
        cmocka_unit_test(looks_at_front_and_back),
        cmocka_unit_test(shows_the_motion_with_one_camera),
        cmocka_unit_test(writes_equal_bytes_at_any_thread_count),
        cmocka_unit_test(refuses_what_it_cannot_do),
        cmocka_unit_test(survives_a_lack_of_memory),
    };
    return cmocka_run_group_tests_name("contact_sheet", tests, make_folder, remove_folder);
}
