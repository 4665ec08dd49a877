// Smaller copies of PNG files.
#ifndef THUMBNAIL_H
#define THUMBNAIL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

// Encodes the picture of a PNG file again, `width` pixels wide or as wide as it is when that is
// less, in a few thousand colours. The caller frees `bytes`. false: no picture, or no memory.
bool thumbnail_png(const uint8_t *file, size_t file_size, uint32_t width, uint8_t **bytes,
                   size_t *size);

#endif
