// assimp 5.2 takes the integers of attributes and animation keys for floats, knows neither skins
// without bind matrices nor weights of morph targets at nodes, keeps one skin per mesh, and tells
// joints by their names. This rewrites a glTF or GLB file in memory as a GLB file that assimp reads
// right, and refuses what it would misread.
#define _POSIX_C_SOURCE 200809L
#include "import_gltf.h"

#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "scene.h"

enum {
    COMPONENT_BYTE = 5120, // then the unsigned one, and both of 16 bits
    COMPONENT_UINT = 5125,
    COMPONENT_FLOAT = 5126
};

bool gltf_fail(gltf_file *g, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(g->message, g->message_size, format, arguments);
    va_end(arguments);
    return false;
}

bool gltf_fail_memory(gltf_file *g) { return gltf_fail(g, "bad_alloc"); }

size_t gltf_whole(const cJSON *object, const char *key, size_t fallback) {
    const cJSON *item = cJSON_GetObjectItemCaseSensitive(object, key);
    return cJSON_IsNumber(item) && item->valuedouble >= 0.0 && item->valuedouble < 4e9
               ? (size_t)item->valuedouble
               : fallback;
}

cJSON *gltf_item(const gltf_list *list, const cJSON *object, const char *key) {
    const size_t index = gltf_whole(object, key, SIZE_MAX);
    return index < list->count ? list->items[index] : NULL;
}

// A list under its key; one that is missing is made.
static bool open_list(gltf_file *g, const char *key, gltf_list *list) {
    cJSON *item = NULL;
    list->array = cJSON_GetObjectItemCaseSensitive(g->root, key);
    if (list->array == NULL) {
        list->array = cJSON_AddArrayToObject(g->root, key);
    }
    if (list->array != NULL && !cJSON_IsArray(list->array)) {
        return gltf_fail(g, "its JSON part is damaged; export it again");
    }
    list->items = malloc(((size_t)cJSON_GetArraySize(list->array) + 1) * sizeof(cJSON *));
    if (list->array == NULL || list->items == NULL) {
        return gltf_fail_memory(g);
    }
    cJSON_ArrayForEach(item, list->array) { list->items[list->count++] = item; }
    return true;
}

// Adds an object to a list.
static bool add_item(gltf_file *g, gltf_list *list, cJSON *item) {
    return (item != NULL && cJSON_AddItemToArray(list->array, item)) || gltf_fail_memory(g);
}

static bool has(const cJSON *object, const char *key) {
    return cJSON_GetObjectItemCaseSensitive(object, key) != NULL;
}

// Removes a member, also where it is written several times.
static void drop(cJSON *object, const char *key) {
    while (has(object, key)) {
        cJSON_DeleteItemFromObjectCaseSensitive(object, key);
    }
}

bool gltf_set(gltf_file *g, cJSON *object, const char *key, double number) {
    drop(object, key);
    return cJSON_AddNumberToObject(object, key, number) != NULL || gltf_fail_memory(g);
}

// Whether a member that names an item, if it is there, names one of the file.
static bool refers(gltf_file *g, const gltf_list *list, const cJSON *object, const char *key) {
    return !has(object, key) || gltf_item(list, object, key) != NULL ||
           gltf_fail(g, "\"%.32s\" refers to what does not exist; export it again", key);
}

// ---- extensions and version ---------------------------------------------------------------------

// Extensions that a file may require although assimp ignores them: they change the look only, or
// are known to assimp or to us.
static bool harmless_extension(const char *name) {
    static const char *const known[] = {"KHR_draco_mesh_compression", "KHR_lights_punctual",
                                        "KHR_texture_transform",      "KHR_texture_basisu",
                                        "EXT_texture_webp",           "KHR_mesh_quantization"};
    for (size_t i = 0; i < sizeof(known) / sizeof(known[0]); ++i) {
        if (strcmp(name, known[i]) == 0) {
            return true;
        }
    }
    return strncmp(name, "KHR_materials_", 14) == 0;
}

static bool check(gltf_file *g) {
    const cJSON *asset = cJSON_GetObjectItemCaseSensitive(g->root, "asset");
    const char *version = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(asset, "version"));
    if (version == NULL || strncmp(version, "2.", 2) != 0) {
        return gltf_fail(g, "only version 2 of glTF is read; export it again");
    }
    const cJSON *required = cJSON_GetObjectItemCaseSensitive(g->root, "extensionsRequired");
    const cJSON *name = NULL;
    cJSON_ArrayForEach(name, required) {
        if (cJSON_IsString(name) && !harmless_extension(name->valuestring)) {
            return gltf_fail(g, "the glTF extension %.64s is not supported; export without it",
                             name->valuestring);
        }
    }
    return true;
}

// ---- numbers of accessors -----------------------------------------------------------------------

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

// Bytes of a number, 0 where there is no such type.
static size_t component_size(size_t type) {
    return type == COMPONENT_BYTE || type == COMPONENT_BYTE + 1       ? 1
           : type == COMPONENT_BYTE + 2 || type == COMPONENT_BYTE + 3 ? 2
           : type == COMPONENT_UINT || type == COMPONENT_FLOAT        ? 4
                                                                      : 0;
}

static double read_component(const unsigned char *at, size_t type) {
    int16_t wide;
    uint16_t word;
    uint32_t number;
    float real;
    switch (type) {
    case COMPONENT_BYTE:
        return (int8_t)at[0];
    case COMPONENT_BYTE + 1:
        return at[0];
    case COMPONENT_BYTE + 2:
        memcpy(&wide, at, sizeof(wide));
        return wide;
    case COMPONENT_BYTE + 3:
        memcpy(&word, at, sizeof(word));
        return word;
    case COMPONENT_UINT:
        memcpy(&number, at, sizeof(number));
        return number;
    default:
        memcpy(&real, at, sizeof(real));
        return (double)real;
    }
}

// What a normalised integer stands for.
static double normalize(double number, size_t type) {
    switch (type) {
    case COMPONENT_BYTE:
        return fmax(number / 127.0, -1.0);
    case COMPONENT_BYTE + 1:
        return number / 255.0;
    case COMPONENT_BYTE + 2:
        return fmax(number / 32767.0, -1.0);
    case COMPONENT_BYTE + 3:
        return number / 65535.0;
    default:
        return number;
    }
}

// Writes one element as floats.
static void convert(gltf_file *g, size_t from, size_t type, bool normalized, size_t parts,
                    size_t to) {
    for (size_t k = 0; k < parts; ++k) {
        const double number = read_component(g->binary + from + k * component_size(type), type);
        const float value = (float)(normalized ? normalize(number, type) : number);
        memcpy(g->binary + to + k * sizeof(value), &value, sizeof(value));
    }
}

// Where the elements of a view lie that an object refers to.
typedef struct elements {
    size_t begin, stride;
} elements;

static bool find_elements(gltf_file *g, const cJSON *object, size_t size, size_t count,
                          elements *out) {
    const cJSON *view = gltf_item(&g->views, object, "bufferView");
    const size_t begin = gltf_whole(object, "byteOffset", 0);
    const size_t end = gltf_whole(view, "byteLength", 0);
    out->stride = gltf_whole(view, "byteStride", size);
    out->begin = gltf_whole(view, "byteOffset", 0) + begin;
    return (view != NULL && out->stride >= size && size != 0 && begin <= end && count != 0 &&
            size <= end - begin && count - 1 <= (end - begin - size) / out->stride) ||
           gltf_fail(g, "numbers reach beyond their buffer; export it again");
}

// Writes the numbers of an accessor as floats behind the buffers: those of its view, else zeros,
// then those that a sparse accessor replaces.
static bool write_floats(gltf_file *g, const cJSON *accessor, bool normalized, size_t count,
                         size_t parts) {
    const cJSON *sparse = cJSON_GetObjectItemCaseSensitive(accessor, "sparse");
    const cJSON *where = cJSON_GetObjectItemCaseSensitive(sparse, "indices");
    const size_t type = gltf_whole(accessor, "componentType", 0),
                 size = parts * component_size(type);
    const size_t index_type = gltf_whole(where, "componentType", 0);
    const size_t changed = gltf_whole(sparse, "count", 0), out = (g->size + 3) / 4 * 4;
    const bool dense = has(accessor, "bufferView");
    elements base = {0}, indices = {0}, values = {0};
    if ((dense && !find_elements(g, accessor, size, count, &base)) ||
        (changed != 0 && (!find_elements(g, where, component_size(index_type), changed, &indices) ||
                          !find_elements(g, cJSON_GetObjectItemCaseSensitive(sparse, "values"),
                                         size, changed, &values))) ||
        !gltf_append(g, count * parts * sizeof(float))) {
        return false;
    }
    for (size_t i = 0; i < count && dense; ++i) {
        convert(g, base.begin + i * base.stride, type, normalized, parts, out + 4 * parts * i);
    }
    for (size_t i = 0; i < changed; ++i) {
        const double element =
            read_component(g->binary + indices.begin + i * indices.stride, index_type);
        if (!(element >= 0.0 && element < (double)count)) {
            return gltf_fail(g, "a sparse accessor refers to what does not exist; export it again");
        }
        convert(g, values.begin + i * values.stride, type, normalized, parts,
                out + 4 * parts * (size_t)element);
    }
    return true;
}

// Lets an accessor refer to what was written last, `size` bytes.
static bool refer(gltf_file *g, cJSON *accessor, size_t size) {
    cJSON *view = cJSON_CreateObject();
    static const char *const stale[] = {"normalized", "min", "max", "byteOffset", "sparse"};
    for (size_t i = 0; i < sizeof(stale) / sizeof(stale[0]); ++i) {
        drop(accessor, stale[i]);
    }
    const int index = cJSON_GetArraySize(g->views.array);
    return add_item(g, &g->views, view) && gltf_set(g, view, "buffer", 0.0) &&
           gltf_set(g, view, "byteOffset", (double)(g->size - size)) &&
           gltf_set(g, view, "byteLength", (double)size) &&
           gltf_set(g, accessor, "componentType", COMPONENT_FLOAT) &&
           gltf_set(g, accessor, "bufferView", index);
}

// Integers and sparse numbers become floats, and so do those whose last element is shorter than
// their stride; those without a view are compressed and stay.
// `normalized`: integers stand for numbers up to 1 also where the file forgets to say so.
static bool plain_accessor(gltf_file *g, cJSON *accessor, bool normalized) {
    const size_t type = gltf_whole(accessor, "componentType", 0);
    const size_t parts = component_count(accessor), count = gltf_whole(accessor, "count", 0);
    const cJSON *view = gltf_item(&g->views, accessor, "bufferView");
    const bool sparse = has(accessor, "sparse");
    const bool plain =
        view == NULL || (type == COMPONENT_FLOAT && count * gltf_whole(view, "byteStride", 0) <=
                                                        gltf_whole(view, "byteLength", 0));
    if (accessor == NULL || (plain && !sparse)) {
        return true;
    }
    if (component_size(type) == 0 || parts == 0) {
        return gltf_fail(g, "numbers of an unknown type; export it again");
    }
    if (count == 0 || count > g->given) {
        return gltf_fail(g, "numbers reach beyond their buffer; export it again");
    }
    const cJSON *flag = cJSON_GetObjectItemCaseSensitive(accessor, "normalized");
    return write_floats(g, accessor, normalized || cJSON_IsTrue(flag), count, parts) &&
           refer(g, accessor, count * parts * sizeof(float));
}

static bool check_views(gltf_file *g) {
    bool known = true;
    for (size_t i = 0; i < g->accessors.count && known; ++i) {
        known = refers(g, &g->views, g->accessors.items[i], "bufferView");
    }
    return known;
}

// ---- attributes and animations ------------------------------------------------------------------

static bool plain_attributes(gltf_file *g, const cJSON *attributes) {
    static const struct {
        const char *name, *type; // the name's beginning
    } known[] = {{"POSITION", "VEC3"},  {"NORMAL", "VEC3"},   {"TANGENT", NULL},  {"COLOR_", NULL},
                 {"TEXCOORD_", "VEC2"}, {"WEIGHTS_", "VEC4"}, {"JOINTS_", "VEC4"}};
    enum { joints = sizeof(known) / sizeof(known[0]) - 1, weights = joints - 1 };
    const cJSON *attribute = NULL;
    cJSON_ArrayForEach(attribute, attributes) {
        const char *name = attribute->string != NULL ? attribute->string : "";
        cJSON *accessor = gltf_item(&g->accessors, attributes, name);
        const char *type = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(accessor, "type"));
        size_t kind = 0;
        while (kind <= joints && strncmp(name, known[kind].name, strlen(known[kind].name)) != 0) {
            ++kind;
        }
        if (kind > joints) {
            continue;
        }
        if (accessor == NULL) {
            return refers(g, &g->accessors, attributes, name);
        }
        if (known[kind].type != NULL && type != NULL && strcmp(type, known[kind].type) != 0) {
            return gltf_fail(g, "%.32s is of type %.16s instead of %s; export it again", name, type,
                             known[kind].type);
        }
        if (kind != joints && !plain_accessor(g, accessor, kind == weights)) {
            return false;
        }
        const size_t component = gltf_whole(accessor, "componentType", 0);
        if (kind == joints
                ? component != COMPONENT_BYTE + 1 && component != COMPONENT_BYTE + 3
                : component != COMPONENT_FLOAT && strcmp(known[kind].name, "COLOR_") != 0) {
            return gltf_fail(g, "%.32s is stored as numbers that are not read; export it %s", name,
                             kind == joints ? "as integers of 8 or 16 bits" : "uncompressed");
        }
    }
    return true;
}

static bool plain_meshes(gltf_file *g) {
    const cJSON *primitive = NULL, *target = NULL;
    for (size_t m = 0; m < g->meshes.count; ++m) {
        cJSON_ArrayForEach(primitive,
                           cJSON_GetObjectItemCaseSensitive(g->meshes.items[m], "primitives")) {
            if (!refers(g, &g->accessors, primitive, "indices") ||
                !plain_attributes(g, cJSON_GetObjectItemCaseSensitive(primitive, "attributes"))) {
                return false;
            }
            cJSON_ArrayForEach(target, cJSON_GetObjectItemCaseSensitive(primitive, "targets")) {
                if (!plain_attributes(g, target)) {
                    return false;
                }
            }
        }
    }
    return true;
}

static bool plain_animations(gltf_file *g) {
    const cJSON *animation = NULL, *sampler = NULL;
    cJSON_ArrayForEach(animation, cJSON_GetObjectItemCaseSensitive(g->root, "animations")) {
        cJSON_ArrayForEach(sampler, cJSON_GetObjectItemCaseSensitive(animation, "samplers")) {
            if (!refers(g, &g->accessors, sampler, "input") ||
                !refers(g, &g->accessors, sampler, "output") ||
                !plain_accessor(g, gltf_item(&g->accessors, sampler, "output"), true)) {
                return false;
            }
        }
    }
    return true;
}

// ---- skins and nodes ----------------------------------------------------------------------------

// Bind matrices that are missing are the identity.
static bool complete_skins(gltf_file *g) {
    cJSON *skin = NULL;
    cJSON_ArrayForEach(skin, cJSON_GetObjectItemCaseSensitive(g->root, "skins")) {
        const size_t count =
            (size_t)cJSON_GetArraySize(cJSON_GetObjectItemCaseSensitive(skin, "joints"));
        if (!refers(g, &g->accessors, skin, "inverseBindMatrices")) {
            return false;
        }
        if (count == 0 || has(skin, "inverseBindMatrices")) {
            continue;
        }
        const size_t size = 16 * count * sizeof(float);
        const float one = 1.0F;
        if (!gltf_append(g, size)) {
            return false;
        }
        for (size_t i = 0; i < 4 * count; ++i) {
            memcpy(g->binary + g->size - size + (16 * (i / 4) + 5 * (i % 4)) * sizeof(one), &one,
                   sizeof(one));
        }
        cJSON *accessor = cJSON_CreateObject();
        const int index = cJSON_GetArraySize(g->accessors.array);
        if (!add_item(g, &g->accessors, accessor) || !refer(g, accessor, size) ||
            !gltf_set(g, accessor, "count", (double)count) ||
            !gltf_set(g, skin, "inverseBindMatrices", index) ||
            cJSON_AddStringToObject(accessor, "type", "MAT4") == NULL) {
            return gltf_fail_memory(g);
        }
    }
    return true;
}

// A mesh that several nodes use, one of them with a skin or weights of its own, becomes a mesh for
// each; the weights at a node become those of its mesh.
static bool separate_meshes(gltf_file *g) {
    size_t *users = calloc(g->meshes.count + 1, sizeof(*users));
    bool *special = calloc(g->meshes.count + 1, sizeof(*special));
    bool fits = true;
    if (users == NULL || special == NULL) {
        free(users);
        free(special);
        return gltf_fail_memory(g);
    }
    for (size_t n = 0; n < g->nodes.count && fits; ++n) {
        const cJSON *node = g->nodes.items[n];
        const size_t m = gltf_whole(node, "mesh", SIZE_MAX);
        fits = refers(g, &g->meshes, node, "mesh");
        if (m < g->meshes.count) {
            ++users[m];
            special[m] |= has(node, "weights") || has(node, "skin");
        }
    }
    for (size_t n = 0; n < g->nodes.count && fits; ++n) {
        cJSON *node = g->nodes.items[n];
        const size_t m = gltf_whole(node, "mesh", SIZE_MAX);
        const cJSON *weights = cJSON_GetObjectItemCaseSensitive(node, "weights");
        if (m >= g->meshes.count) {
            continue;
        }
        cJSON *mesh = g->meshes.items[m];
        if (special[m] && users[m] > 1) {
            const int index = cJSON_GetArraySize(g->meshes.array);
            mesh = cJSON_Duplicate(mesh, true);
            fits = add_item(g, &g->meshes, mesh) && gltf_set(g, node, "mesh", index);
        }
        if (fits && weights != NULL) {
            drop(mesh, "weights");
            fits = cJSON_AddItemToObject(mesh, "weights", cJSON_Duplicate(weights, true)) ||
                   gltf_fail_memory(g);
        }
    }
    free(users);
    free(special);
    return fits;
}

typedef struct named_node {
    const char *name;
    size_t index;
} named_node;

static int compare_names(const void *left, const void *right) {
    const named_node *a = left, *b = right;
    const int names = strcmp(a->name, b->name);
    return names != 0 ? names : (a->index > b->index) - (a->index < b->index);
}

// Joints without a name, or with one that other nodes bear, are called by their number too.
static bool name_joints(gltf_file *g) {
    named_node *named = calloc(g->nodes.count + 1, sizeof(*named));
    bool *joint = calloc(g->nodes.count + 1, sizeof(*joint));
    bool fits = true;
    if (named == NULL || joint == NULL) {
        free(named);
        free(joint);
        return gltf_fail_memory(g);
    }
    const cJSON *skin = NULL, *index = NULL;
    cJSON_ArrayForEach(skin, cJSON_GetObjectItemCaseSensitive(g->root, "skins")) {
        cJSON_ArrayForEach(index, cJSON_GetObjectItemCaseSensitive(skin, "joints")) {
            if (cJSON_IsNumber(index) && index->valueint >= 0 &&
                (size_t)index->valueint < g->nodes.count) {
                joint[index->valueint] = true;
            }
        }
    }
    for (size_t n = 0; n < g->nodes.count; ++n) {
        const char *name =
            cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(g->nodes.items[n], "name"));
        named[n] = (named_node){name != NULL ? name : "", n};
    }
    qsort(named, g->nodes.count, sizeof(*named), compare_names);
    for (size_t i = 0; i < g->nodes.count && fits;) {
        size_t end = i + 1;
        while (end < g->nodes.count && strcmp(named[end].name, named[i].name) == 0) {
            ++end;
        }
        const bool empty = named[i].name[0] == '\0';
        for (const bool shared = end - i > 1 || empty; i < end && fits; ++i) {
            char name[256];
            if (!shared || !joint[named[i].index]) {
                continue;
            }
            snprintf(name, sizeof(name), "%.200s_%zu", empty ? "joint" : named[i].name,
                     named[i].index);
            cJSON *text = cJSON_CreateString(name), *node = g->nodes.items[named[i].index];
            drop(node, "name");
            fits = cJSON_AddItemToObject(node, "name", text) || gltf_fail_memory(g);
        }
        i = end;
    }
    free(named);
    free(joint);
    return fits;
}

// ---- the file -----------------------------------------------------------------------------------

static uint32_t read_word(const char *at) {
    uint32_t word;
    memcpy(&word, at, sizeof(word));
    return word;
}

// Parses the JSON part and gathers the buffers.
static bool open_file(gltf_file *g, const char *bytes, size_t size, scene_format format) {
    const char *text = bytes, *chunk = NULL;
    size_t length = size, chunk_size = 0;
    if (format == SCENE_GLB) {
        length = size >= 20 ? read_word(bytes + 12) : 0;
        if (size < 20 || length > size - 20) {
            return gltf_fail(g, "the file is truncated; export it again");
        }
        text = bytes + 20;
        const size_t rest = size - 20 - length;
        if (rest >= 8 && memcmp(text + length + 4, "BIN\0", 4) == 0) {
            chunk = text + length + 8;
            chunk_size = read_word(text + length);
            if (chunk_size > rest - 8) {
                return gltf_fail(g, "the file is truncated; export it again");
            }
        }
    }
    g->root = cJSON_ParseWithLength(text, length);
    if (!cJSON_IsObject(g->root)) {
        return gltf_fail(g, "its JSON part is damaged; export it again");
    }
    return check(g) && open_list(g, "accessors", &g->accessors) &&
           open_list(g, "bufferViews", &g->views) && open_list(g, "meshes", &g->meshes) &&
           open_list(g, "nodes", &g->nodes) &&
           gltf_gather(g, (const unsigned char *)chunk, chunk_size);
}

static char *put_chunk(char *at, const char *type, const void *bytes, size_t size, char padding) {
    const uint32_t padded = (uint32_t)((size + 3) / 4 * 4);
    memcpy(at, &padded, sizeof(padded));
    memcpy(at + 4, type, 4);
    if (size != 0) {
        memcpy(at + 8, bytes, size);
    }
    memset(at + 8 + size, padding, padded - size);
    return at + 8 + padded;
}

// The file as GLB, of one buffer.
static char *pack(gltf_file *g, size_t *size) {
    drop(g->root, "buffers");
    cJSON *buffers = cJSON_AddArrayToObject(g->root, "buffers"), *buffer = cJSON_CreateObject();
    gltf_list list = {.array = buffers};
    if (buffers == NULL || !add_item(g, &list, buffer) ||
        !gltf_set(g, buffer, "byteLength", (double)g->size)) {
        (void)gltf_fail_memory(g);
        return NULL;
    }
    char *text = cJSON_PrintUnformatted(g->root), *bytes = NULL;
    const size_t length = text != NULL ? strlen(text) : 0;
    const size_t total = 12 + 8 + (length + 3) / 4 * 4 + 8 + (g->size + 3) / 4 * 4;
    if (text == NULL || (bytes = malloc(total)) == NULL) {
        (void)gltf_fail_memory(g);
    } else if (total > UINT32_MAX) {
        (void)gltf_fail(g, "the file is larger than 4 GiB");
        free(bytes);
        bytes = NULL;
    } else {
        const uint32_t header[3] = {0x46546c67, 2, (uint32_t)total};
        memcpy(bytes, header, sizeof(header));
        put_chunk(put_chunk(bytes + 12, "JSON", text, length, ' '), "BIN\0", g->binary, g->size,
                  '\0');
        *size = total;
    }
    cJSON_free(text);
    return bytes;
}

char *scene_plain_gltf(const char *path, const char *bytes, size_t *size, scene_format format,
                       char *message, size_t message_size) {
    gltf_file g = {.path = path, .message = message, .message_size = message_size};
    message[0] = '\0';
    // The second walk finds joints whose numbers something else turned into floats.
    char *plain = open_file(&g, bytes, *size, format) && check_views(&g) && plain_meshes(&g) &&
                          plain_animations(&g) && plain_meshes(&g) && complete_skins(&g) &&
                          separate_meshes(&g) && name_joints(&g)
                      ? pack(&g, size)
                      : NULL;
    cJSON_Delete(g.root);
    free(g.accessors.items);
    free(g.views.items);
    free(g.meshes.items);
    free(g.nodes.items);
    free(g.binary);
    return plain;
}
