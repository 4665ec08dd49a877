// What assimp 5.2 takes for something else in glTF files.
#define _POSIX_C_SOURCE 200809L
#include "import_reader.h"

#include <ctype.h>
#include <stdlib.h>
#include <unistd.h>

#include <cjson/cJSON.h>

// Extensions that a file may require although assimp ignores them: they change the look only, or
// assimp does know them.
static bool harmless_extension(const char *name) {
    static const char *const known[] = {"KHR_draco_mesh_compression", "KHR_lights_punctual",
                                        "KHR_texture_transform", "KHR_texture_basisu",
                                        "EXT_texture_webp"};
    for (size_t i = 0; i < sizeof(known) / sizeof(known[0]); ++i) {
        if (strcmp(name, known[i]) == 0) {
            return true;
        }
    }
    return strncmp(name, "KHR_materials_", 14) == 0;
}

// Integers of texture coordinates and weights would be taken for floats.
static void check_attributes(scene_reader *reader, const cJSON *root) {
    static const char *const names[] = {"POSITION", "NORMAL", "TEXCOORD_0", "WEIGHTS_0",
                                        "WEIGHTS_1"};
    static const char *const types[] = {"VEC3", "VEC3", "VEC2", "VEC4", "VEC4"};
    const cJSON *accessors = cJSON_GetObjectItemCaseSensitive(root, "accessors");
    const cJSON *mesh = NULL, *primitive = NULL;
    cJSON_ArrayForEach(mesh, cJSON_GetObjectItemCaseSensitive(root, "meshes")) {
        cJSON_ArrayForEach(primitive, cJSON_GetObjectItemCaseSensitive(mesh, "primitives")) {
            const cJSON *attributes = cJSON_GetObjectItemCaseSensitive(primitive, "attributes");
            for (size_t i = 0; i < sizeof(names) / sizeof(names[0]); ++i) {
                const cJSON *index = cJSON_GetObjectItemCaseSensitive(attributes, names[i]);
                const cJSON *accessor =
                    cJSON_IsNumber(index) ? cJSON_GetArrayItem(accessors, index->valueint) : NULL;
                const cJSON *number = cJSON_GetObjectItemCaseSensitive(accessor, "componentType");
                const char *type =
                    cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(accessor, "type"));
                if (cJSON_IsNumber(number) && number->valueint != 5126) {
                    import_fail(reader,
                                "%s is stored as integers, which are read from GLB files where "
                                "they are normalized; export it with 32-bit floats",
                                names[i]);
                }
                if (type != NULL && strcmp(type, types[i]) != 0) {
                    import_fail(reader, "%s is of type %.16s instead of %s; export it again",
                                names[i], type, types[i]);
                }
            }
        }
    }
}

static void check(scene_reader *reader, const cJSON *root) {
    const cJSON *asset = cJSON_GetObjectItemCaseSensitive(root, "asset"), *skin = NULL;
    const char *version = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(asset, "version"));
    if (version == NULL || strncmp(version, "2.", 2) != 0) {
        import_fail(reader, "only version 2 of glTF is read; export it again");
    }
    const cJSON *required = cJSON_GetObjectItemCaseSensitive(root, "extensionsRequired");
    for (int i = 0; i < cJSON_GetArraySize(required); ++i) {
        const char *name = cJSON_GetStringValue(cJSON_GetArrayItem(required, i));
        if (name != NULL && !harmless_extension(name)) {
            import_fail(reader, "the glTF extension %.64s is not supported; export without it",
                        name);
        }
    }
    cJSON_ArrayForEach(skin, cJSON_GetObjectItemCaseSensitive(root, "skins")) {
        if (cJSON_GetObjectItemCaseSensitive(skin, "inverseBindMatrices") == NULL) {
            import_fail(reader, "a skin without inverse bind matrices is not supported; export it "
                                "with them");
        }
    }
    check_attributes(reader, root);
}

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

// The text with the paths of all buffers in full, since it is read from memory.
static char *with_paths(const cJSON *root, const char *path) {
    cJSON *buffer = NULL;
    cJSON_ArrayForEach(buffer, cJSON_GetObjectItemCaseSensitive(root, "buffers")) {
        const cJSON *uri = cJSON_GetObjectItemCaseSensitive(buffer, "uri");
        if (cJSON_IsString(uri) && strncmp(uri->valuestring, "data:", 5) != 0) {
            char *file = resolve(path, uri->valuestring);
            cJSON *full = file != NULL ? cJSON_CreateString(file) : NULL;
            free(file);
            if (full == NULL || !cJSON_ReplaceItemInObjectCaseSensitive(buffer, "uri", full)) {
                return NULL;
            }
        }
    }
    return cJSON_PrintUnformatted(root);
}

char *import_plain_gltf(scene_reader *reader, const char *path, char *bytes, size_t *size,
                        scene_format format) {
    const char *text = bytes;
    size_t length = *size;
    if (format == SCENE_GLB) {
        uint32_t chunk = 0;
        if (*size >= 20) {
            memcpy(&chunk, bytes + 12, sizeof(chunk));
        }
        if (*size < 20 || chunk > *size - 20) {
            import_fail(reader, "the file is truncated; export it again");
        }
        bytes = scene_unpack_glb(bytes, size);
        memcpy(&chunk, bytes + 12, sizeof(chunk));
        text = bytes + 20;
        length = chunk;
    }
    cJSON *root = cJSON_ParseWithLength(text, length);
    if (root == NULL) {
        import_fail(reader, "its JSON part is damaged; export it again");
    }
    check(reader, root);
    if (format == SCENE_GLTF) {
        free(bytes);
        bytes = with_paths(root, path);
        if (bytes != NULL) {
            *size = strlen(bytes);
        } else {
            import_fail(reader, "bad_alloc");
        }
    }
    cJSON_Delete(root);
    return bytes;
}
