#include "thumbnail.h"

#include <png.h>
#include <stdlib.h>

enum {
    CHANNELS = 3,
    MOST_PIXELS = 1 << 26,
    STEP = 16 // of the colours; shades that differ less look the same and compress worse
};

// Mean of the source pixels under each target pixel.
static void shrink(const uint8_t *source, size_t source_width, size_t source_height,
                   uint8_t *target, size_t width, size_t height) {
    for (size_t y = 0; y < height; ++y) {
        const size_t top = y * source_height / height, bottom = (y + 1) * source_height / height;
        for (size_t x = 0; x < width; ++x) {
            const size_t left = x * source_width / width, right = (x + 1) * source_width / width;
            const size_t count = (bottom - top) * (right - left);
            size_t sum[CHANNELS] = {0};
            for (size_t v = top; v < bottom; ++v) {
                const uint8_t *pixel = &source[CHANNELS * (v * source_width + left)];
                for (size_t u = left; u < right; ++u, pixel += CHANNELS) {
                    for (size_t c = 0; c < CHANNELS; ++c) {
                        sum[c] += pixel[c];
                    }
                }
            }
            for (size_t c = 0; c < CHANNELS; ++c) {
                const size_t mean = sum[c] / (count > 0 ? count : 1);
                const size_t level = (mean + STEP / 2) / STEP * STEP;
                target[CHANNELS * (y * width + x) + c] = (uint8_t)(level < 255 ? level : 255);
            }
        }
    }
}

static bool encode(png_image *image, const uint8_t *pixels, uint8_t **bytes, size_t *size) {
    png_alloc_size_t needed = 0;
    if (!png_image_write_to_memory(image, NULL, &needed, 0, pixels, 0, NULL)) {
        return false;
    }
    *bytes = malloc(needed);
    *size = needed;
    if (*bytes != NULL && !png_image_write_to_memory(image, *bytes, &needed, 0, pixels, 0, NULL)) {
        free(*bytes);
        *bytes = NULL;
    }
    return *bytes != NULL;
}

bool thumbnail_png(const uint8_t *file, size_t file_size, uint32_t width, uint8_t **bytes,
                   size_t *size) {
    png_image image = {.version = PNG_IMAGE_VERSION};
    *bytes = NULL;
    if (!png_image_begin_read_from_memory(&image, file, file_size)) {
        return false;
    }
    image.format = PNG_FORMAT_RGB;
    const png_color white = {255, 255, 255};
    const size_t source_width = image.width, source_height = image.height;
    if (source_width * source_height > MOST_PIXELS) {
        png_image_free(&image);
        return false;
    }
    uint8_t *source = malloc(PNG_IMAGE_SIZE(image));
    const bool read = source != NULL && png_image_finish_read(&image, &white, source, 0, NULL) != 0;
    png_image_free(&image);
    if (source_width < width) {
        width = (uint32_t)source_width;
    }
    size_t height = source_height * width / source_width;
    height = height > 0 ? height : 1;
    uint8_t *target = read ? malloc(CHANNELS * width * height) : NULL;
    if (target != NULL) {
        shrink(source, source_width, source_height, target, width, height);
        png_image smaller = {.version = PNG_IMAGE_VERSION,
                             .width = width,
                             .height = (png_uint_32)height,
                             .format = PNG_FORMAT_RGB};
        (void)encode(&smaller, target, bytes, size);
    }
    free(source);
    free(target);
    return *bytes != NULL;
}
