// The buffers of a glTF or GLB file, read into one.
#define _POSIX_C_SOURCE 200809L
#include "import_gltf.h"

#include <ctype.h>
#include <errno.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "scene.h"

bool gltf_append(gltf_file *g, size_t size) {
    const size_t begin = (g->size + 3) / 4 * 4;
    if (size == 0) {
        return true;
    }
    if (size > UINT32_MAX - begin) {
        return gltf_fail(g, "its buffers are larger than 4 GiB");
    }
    if (begin + size > g->capacity) {
        const size_t grown = 2 * g->capacity > begin + size ? 2 * g->capacity : begin + size;
        unsigned char *binary = realloc(g->binary, grown);
        if (binary == NULL) {
            return gltf_fail_memory(g);
        }
        g->binary = binary;
        g->capacity = grown;
    }
    memset(g->binary + g->size, 0, begin + size - g->size);
    g->size = begin + size;
    return true;
}

// ---- what URIs refer to -------------------------------------------------------------------------

static char hex_digit(char digit) {
    return (char)(isdigit((unsigned char)digit) ? digit - '0' : (digit | 32) - 'a' + 10);
}

// The path of a file that a glTF file refers to: beside it, and under a name whose characters may
// be written as %20.
static char *resolve(const char *path, const char *uri) {
    const char *slash = strrchr(path, '/');
    const int folder = slash != NULL ? (int)(slash + 1 - path) : 0;
    const size_t size = (size_t)folder + strlen(uri) + 1;
    char *file = malloc(size);
    if (file == NULL) {
        return NULL;
    }
    snprintf(file, size, "%.*s%s", folder, path, uri);
    if (access(file, R_OK) == 0) {
        return file;
    }
    char *out = file + folder;
    for (const char *at = uri; *at != '\0'; ++at) {
        if (at[0] == '%' && isxdigit((unsigned char)at[1]) && isxdigit((unsigned char)at[2])) {
            *out++ = (char)(hex_digit(at[1]) * 16 + hex_digit(at[2]));
            at += 2;
        } else {
            *out++ = *at;
        }
    }
    *out = '\0';
    return file;
}

static bool read_beside(gltf_file *g, const char *uri, char **bytes, size_t *size) {
    char *file = resolve(g->path, uri);
    const int error = file != NULL ? cli_read_file(file, bytes, size) : ENOMEM;
    free(file);
    if (error == ENOMEM) {
        return gltf_fail_memory(g);
    }
    return error == 0 ||
           gltf_fail(g, "its buffer \"%.64s\" cannot be read: %s; put it beside the file", uri,
                     strerror(error));
}

static int base64_digit(char c) {
    static const char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    const char *at = c != '\0' ? strchr(digits, c) : NULL;
    return at != NULL ? (int)(at - digits) : -1;
}

static bool read_base64(gltf_file *g, const char *uri, char **bytes, size_t *size) {
    const char *text = strstr(uri, ";base64,");
    if (text == NULL) {
        return gltf_fail(g, "a buffer in it is not written in base64; export it again");
    }
    text += strlen(";base64,");
    *size = 0;
    *bytes = malloc(strlen(text) / 4 * 3 + 4);
    if (*bytes == NULL) {
        return gltf_fail_memory(g);
    }
    uint32_t bits = 0;
    for (size_t count = 1; base64_digit(*text) >= 0; ++text, ++count) {
        bits = bits << 6 | (uint32_t)base64_digit(*text);
        if (count % 4 != 1) { // the second to fourth digit complete a byte each
            (*bytes)[(*size)++] = (char)(bits >> (6 - 2 * ((count - 1) % 4)));
        }
    }
    return true;
}

// ---- one buffer ---------------------------------------------------------------------------------

static bool append_buffer(gltf_file *g, const cJSON *buffer, size_t index,
                          const unsigned char *chunk, size_t chunk_size) {
    const char *uri = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(buffer, "uri"));
    const size_t length = gltf_whole(buffer, "byteLength", 0);
    char *bytes = NULL;
    size_t size = 0;
    bool read = true;
    if (uri != NULL) {
        read = strncmp(uri, "data:", 5) == 0 ? read_base64(g, uri, &bytes, &size)
                                             : read_beside(g, uri, &bytes, &size);
    } else if (index == 0) {
        size = chunk_size;
    }
    if (read && size < length) {
        read = gltf_fail(g, "its buffer %zu has %zu bytes instead of %zu; export it again", index,
                         size, length);
    }
    read = read && gltf_append(g, length);
    if (read && length != 0) {
        memcpy(g->binary + g->size - length, bytes != NULL ? (const void *)bytes : chunk, length);
    }
    free(bytes);
    return read;
}

// Lets a view refer to the one buffer, in which the buffers begin at `begins`.
static bool move_view(gltf_file *g, cJSON *view, const size_t *begins, size_t count) {
    const size_t buffer = gltf_whole(view, "buffer", SIZE_MAX);
    const size_t offset = gltf_whole(view, "byteOffset", 0);
    const size_t length = gltf_whole(view, "byteLength", 0);
    if (buffer >= count || offset > begins[buffer + 1] - begins[buffer] ||
        length > begins[buffer + 1] - begins[buffer] - offset) {
        return gltf_fail(g, "a view reaches beyond its buffer; export it again");
    }
    return gltf_set(g, view, "buffer", 0.0) &&
           gltf_set(g, view, "byteOffset", (double)(begins[buffer] + offset));
}

bool gltf_gather(gltf_file *g, const unsigned char *chunk, size_t chunk_size) {
    const cJSON *buffers = cJSON_GetObjectItemCaseSensitive(g->root, "buffers"), *buffer = NULL;
    size_t count = 0;
    size_t *begins = calloc((size_t)cJSON_GetArraySize(buffers) + 1, sizeof(*begins));
    if (begins == NULL) {
        return gltf_fail_memory(g);
    }
    bool fits = true;
    cJSON_ArrayForEach(buffer, buffers) {
        fits = fits && append_buffer(g, buffer, count, chunk, chunk_size);
        if (fits) {
            begins[count] = g->size - gltf_whole(buffer, "byteLength", 0);
            begins[++count] = g->size;
        }
    }
    for (size_t i = 0; i < g->views.count && fits; ++i) {
        fits = move_view(g, g->views.items[i], begins, count);
    }
    free(begins);
    g->given = g->size;
    return fits;
}
