// assimp 5.2 takes the integers of animation keys, texture coordinates and weights for floats. This
// rewrites a GLB file in memory so that they are floats.
#include "scene.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include <cjson/cJSON.h>

enum { COMPONENT_BYTE = 5120, COMPONENT_FLOAT = 5126 };

typedef struct glb_file {
    const unsigned char *binary; // BIN chunk
    size_t binary_size;
    float *added; // floats that follow the BIN chunk
    size_t added_count;
} glb_file;

static size_t whole(const cJSON *object, const char *key, size_t fallback) {
    const cJSON *item = cJSON_GetObjectItemCaseSensitive(object, key);
    return cJSON_IsNumber(item) && item->valuedouble >= 0.0 && item->valuedouble < 4e9
               ? (size_t)item->valuedouble
               : fallback;
}

static size_t component_count(const cJSON *accessor) {
    static const struct {
        const char *name;
        size_t count;
    } types[] = {{"SCALAR", 1}, {"VEC2", 2}, {"VEC3", 3}, {"VEC4", 4}};
    const char *name = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(accessor, "type"));
    for (size_t i = 0; i < sizeof(types) / sizeof(types[0]); ++i) {
        if (name != NULL && strcmp(name, types[i].name) == 0) {
            return types[i].count;
        }
    }
    return 0;
}

// A number of a signed or unsigned, 8 or 16 bit normalised integer type.
static float normalized(const unsigned char *at, size_t type) {
    int16_t wide;
    uint16_t word;
    switch (type) {
    case COMPONENT_BYTE:
        return fmaxf((float)(int8_t)at[0] / 127.0F, -1.0F);
    case COMPONENT_BYTE + 1:
        return (float)at[0] / 255.0F;
    case COMPONENT_BYTE + 2:
        memcpy(&wide, at, sizeof(wide));
        return fmaxf((float)wide / 32767.0F, -1.0F);
    default:
        memcpy(&word, at, sizeof(word));
        return (float)word / 65535.0F;
    }
}

// Appends an accessor's numbers as floats and lets it refer to them; false: nothing to do, or the
// accessor is damaged, which assimp finds.
static bool unpack_accessor(cJSON *root, cJSON *accessor, glb_file *file) {
    const size_t type = whole(accessor, "componentType", 0), parts = component_count(accessor);
    const size_t count = whole(accessor, "count", 0) * parts;
    cJSON *views = cJSON_GetObjectItemCaseSensitive(root, "bufferViews");
    const cJSON *view = cJSON_GetArrayItem(views, (int)whole(accessor, "bufferView", INT32_MAX));
    if (type < COMPONENT_BYTE || type > COMPONENT_BYTE + 3 || view == NULL ||
        whole(view, "buffer", 1) != 0 || cJSON_HasObjectItem(accessor, "sparse")) {
        return false;
    }
    const size_t size = type < COMPONENT_BYTE + 2 ? 1 : 2;
    const size_t stride = whole(view, "byteStride", size * parts);
    const size_t begin = whole(view, "byteOffset", 0) + whole(accessor, "byteOffset", 0);
    if (parts == 0 || count == 0 || stride < size * parts || begin > file->binary_size ||
        (count / parts - 1) > (file->binary_size - begin) / stride ||
        (count / parts - 1) * stride + size * parts > file->binary_size - begin) {
        return false;
    }
    float *grown = realloc(file->added, (file->added_count + count) * sizeof(float));
    cJSON *added = cJSON_CreateObject();
    file->added = grown != NULL ? grown : file->added;
    if (grown == NULL || added == NULL) {
        cJSON_Delete(added);
        return false;
    }
    for (size_t i = 0; i < count; ++i) {
        file->added[file->added_count + i] =
            normalized(file->binary + begin + i / parts * stride + i % parts * size, type);
    }
    cJSON_AddNumberToObject(added, "buffer", 0);
    cJSON_AddNumberToObject(
        added, "byteOffset",
        (double)((file->binary_size + 3) / 4 * 4 + file->added_count * sizeof(float)));
    cJSON_AddNumberToObject(added, "byteLength", (double)(count * sizeof(float)));
    file->added_count += count;
    static const char *const stale[] = {"normalized", "min",           "max",
                                        "byteOffset", "componentType", "bufferView"};
    for (size_t i = 0; i < sizeof(stale) / sizeof(stale[0]); ++i) {
        cJSON_DeleteItemFromObjectCaseSensitive(accessor, stale[i]);
    }
    cJSON_AddNumberToObject(accessor, "componentType", COMPONENT_FLOAT);
    cJSON_AddNumberToObject(accessor, "bufferView", cJSON_GetArraySize(views));
    cJSON_AddItemToArray(views, added);
    return true;
}

static bool unpack_animations(cJSON *root, glb_file *file) {
    cJSON *accessors = cJSON_GetObjectItemCaseSensitive(root, "accessors");
    const cJSON *animation = NULL, *sampler = NULL;
    bool changed = false;
    cJSON_ArrayForEach(animation, cJSON_GetObjectItemCaseSensitive(root, "animations")) {
        cJSON_ArrayForEach(sampler, cJSON_GetObjectItemCaseSensitive(animation, "samplers")) {
            cJSON *accessor =
                cJSON_GetArrayItem(accessors, (int)whole(sampler, "output", INT32_MAX));
            changed |= accessor != NULL && unpack_accessor(root, accessor, file);
        }
    }
    return changed;
}

static bool unpack_attributes(cJSON *root, glb_file *file) {
    cJSON *accessors = cJSON_GetObjectItemCaseSensitive(root, "accessors");
    const cJSON *mesh = NULL, *primitive = NULL, *attribute = NULL;
    bool changed = false;
    cJSON_ArrayForEach(mesh, cJSON_GetObjectItemCaseSensitive(root, "meshes")) {
        cJSON_ArrayForEach(primitive, cJSON_GetObjectItemCaseSensitive(mesh, "primitives")) {
            cJSON_ArrayForEach(attribute,
                               cJSON_GetObjectItemCaseSensitive(primitive, "attributes")) {
                const char *name = attribute->string;
                cJSON *accessor = cJSON_IsNumber(attribute)
                                      ? cJSON_GetArrayItem(accessors, attribute->valueint)
                                      : NULL;
                changed |=
                    name != NULL && accessor != NULL &&
                    (strncmp(name, "TEXCOORD_", 9) == 0 || strncmp(name, "WEIGHTS_", 8) == 0) &&
                    cJSON_IsTrue(cJSON_GetObjectItemCaseSensitive(accessor, "normalized")) &&
                    unpack_accessor(root, accessor, file);
            }
        }
    }
    return changed;
}

static unsigned char *put_chunk(unsigned char *at, const char *type, const void *bytes, size_t size,
                                size_t padded, char padding) {
    const uint32_t length = (uint32_t)padded;
    memcpy(at, &length, sizeof(length));
    memcpy(at + 4, type, 4);
    memcpy(at + 8, bytes, size);
    memset(at + 8 + size, padding, padded - size);
    return at + 8 + padded;
}

// The file again from its two chunks; NULL: out of memory, or larger than a GLB file can be.
static char *pack(const char *text, const glb_file *file, size_t *size) {
    const size_t text_size = strlen(text), text_padded = (text_size + 3) / 4 * 4;
    const size_t old_padded = (file->binary_size + 3) / 4 * 4;
    const size_t binary_size = old_padded + file->added_count * sizeof(float);
    const size_t total = 12 + 8 + text_padded + 8 + binary_size;
    unsigned char *bytes = total < UINT32_MAX ? calloc(total, 1) : NULL;
    unsigned char *binary = calloc(binary_size, 1);
    if (bytes == NULL || binary == NULL) {
        free(bytes);
        free(binary);
        return NULL;
    }
    memcpy(binary, file->binary, file->binary_size);
    memcpy(binary + old_padded, file->added, file->added_count * sizeof(float));
    const uint32_t header[3] = {0x46546c67, 2, (uint32_t)total};
    memcpy(bytes, header, sizeof(header));
    unsigned char *next = put_chunk(bytes + 12, "JSON", text, text_size, text_padded, ' ');
    put_chunk(next, "BIN\0", binary, binary_size, binary_size, '\0');
    free(binary);
    *size = total;
    return (char *)bytes;
}

char *scene_unpack_glb(char *bytes, size_t *size) {
    uint32_t json_size = 0, binary_size = 0;
    if (*size < 28) {
        return bytes;
    }
    memcpy(&json_size, bytes + 12, sizeof(json_size));
    if (json_size > *size - 28) {
        return bytes;
    }
    memcpy(&binary_size, bytes + 20 + json_size, sizeof(binary_size));
    if (binary_size > *size - 28 - json_size || memcmp(bytes + 24 + json_size, "BIN\0", 4) != 0) {
        return bytes;
    }
    glb_file file = {.binary = (const unsigned char *)bytes + 28 + json_size,
                     .binary_size = binary_size};
    char *packed = NULL;
    cJSON *root = cJSON_ParseWithLength(bytes + 20, json_size);
    cJSON *buffer = cJSON_GetArrayItem(cJSON_GetObjectItemCaseSensitive(root, "buffers"), 0);
    cJSON *length = cJSON_GetObjectItemCaseSensitive(buffer, "byteLength");
    const bool keys = length != NULL && unpack_animations(root, &file);
    if (length != NULL && (unpack_attributes(root, &file) || keys)) {
        cJSON_SetNumberValue(
            length, (double)((file.binary_size + 3) / 4 * 4 + file.added_count * sizeof(float)));
        char *text = cJSON_PrintUnformatted(root);
        packed = text != NULL ? pack(text, &file, size) : NULL;
        cJSON_free(text);
    }
    cJSON_Delete(root);
    free(file.added);
    return packed != NULL ? packed : bytes;
}
