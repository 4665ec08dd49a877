// The only place that knows libpng.
#include "io/png_image.h"

#include <png.h>
#include <setjmp.h>
#include <zlib.h>

#include "io/atomic_file.h"

static void fail_silently(png_structp png, png_const_charp message) {
    (void)message;
    png_longjmp(png, 1);
}

static void ignore_warning(png_structp png, png_const_charp message) {
    (void)png;
    (void)message;
}

// A failed write is noticed when the file ends.
static void write_bytes(png_structp png, png_bytep bytes, png_size_t size) {
    (void)!fwrite(bytes, 1, size, png_get_io_ptr(png));
}

static void flush_nothing(png_structp png) { (void)png; }

static bool encode(png_structp png, png_infop info, const pci_image *image) {
    if (setjmp(png_jmpbuf(png))) {
        return false;
    }
    png_set_IHDR(png, info, (png_uint_32)image->width, (png_uint_32)image->height, 8,
                 PNG_COLOR_TYPE_RGB, PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT,
                 PNG_FILTER_TYPE_DEFAULT);
    png_set_sRGB(png, info, PNG_sRGB_INTENT_PERCEPTUAL);
    // For pictures like ours smaller than what the other strategies reach, and the fastest.
    png_set_filter(png, PNG_FILTER_TYPE_BASE, PNG_FILTER_UP);
    png_set_compression_strategy(png, Z_RLE);
    png_write_info(png, info);
    for (size_t row = 0; row < image->height; ++row) {
        png_write_row(png, &image->pixels[3 * row * image->width]);
    }
    png_write_end(png, NULL);
    return true;
}

pc_status pci_write_png(pc_context *context, const char *stage, const pci_image *image,
                        const char *path) {
    pci_atomic_file file = {0};
    pc_status status = pci_atomic_begin(context, stage, path, &file);
    if (status != PC_OK) {
        return status;
    }
    png_structp png =
        png_create_write_struct(PNG_LIBPNG_VER_STRING, NULL, fail_silently, ignore_warning);
    png_infop info = png != NULL ? png_create_info_struct(png) : NULL;
    if (info == NULL) {
        status = pci_fail_memory(context, stage);
    } else {
        png_set_write_fn(png, file.stream, write_bytes, flush_nothing);
        if (!encode(png, info, image)) {
            status = pci_fail(context, PC_ERROR_DEPENDENCY, stage,
                              "%s: libpng cannot encode %zu x %zu pixels", stage, image->width,
                              image->height);
        }
    }
    png_destroy_write_struct(&png, &info);
    return pci_atomic_end(&file, status);
}
