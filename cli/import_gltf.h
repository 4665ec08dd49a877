// A glTF or GLB file that is rewritten in memory: what import_gltf.c and import_buffers.c share.
#ifndef CLI_IMPORT_GLTF_H
#define CLI_IMPORT_GLTF_H

#include <stdbool.h>
#include <stddef.h>

#include <cjson/cJSON.h>

// A list of the file with its items, which cJSON would search from its beginning.
typedef struct gltf_list {
    cJSON *array; // NULL: the file has none
    cJSON **items;
    size_t count; // of the items; what is added later is not among them
} gltf_list;

typedef struct gltf_file {
    const char *path;
    cJSON *root;
    gltf_list accessors, views, meshes, nodes;
    unsigned char *binary; // all buffers, then what was added
    size_t size, capacity;
    size_t given;  // bytes of the file's own buffers
    char *message; // of `message_size`, empty: nothing is wrong
    size_t message_size;
} gltf_file;

// Says what is wrong; false.
__attribute__((format(printf, 2, 3))) bool gltf_fail(gltf_file *g, const char *format, ...);
bool gltf_fail_memory(gltf_file *g);

// A member that is a whole number from 0 to 4e9; else the fallback.
size_t gltf_whole(const cJSON *object, const char *key, size_t fallback);
// The item of the index that a member names; NULL: there is none.
cJSON *gltf_item(const gltf_list *list, const cJSON *object, const char *key);

// Sets a member to a number.
bool gltf_set(gltf_file *g, cJSON *object, const char *key, double number);

// Adds zeros to the binary part, from a multiple of four bytes on; their offset is the size before.
bool gltf_append(gltf_file *g, size_t size);
// Reads all buffers into one: files beside the glTF file, base64 text, and the binary chunk of a
// GLB file; the views then refer to that one.
bool gltf_gather(gltf_file *g, const unsigned char *chunk, size_t chunk_size);

#endif
