// A reader of GLB files for tests, independent of the library: container, accessors, posing.
#ifndef TEST_SUPPORT_GLB_H
#define TEST_SUPPORT_GLB_H

#include <cjson/cJSON.h>

#include "support/asset_fixture.h"
#include "support/files.h"

typedef struct glb {
    bytes file;
    cJSON *json;
    const unsigned char *bin;
    size_t bin_size;
} glb;

static inline size_t u32_at(const unsigned char *at) {
    return at[0] | (size_t)at[1] << 8 | (size_t)at[2] << 16 | (size_t)at[3] << 24;
}

// Reads and checks the container: magic, version, lengths, padding.
static inline glb read_glb(const char *name) {
    glb g = {.file = read_bytes(name)};
    const unsigned char *data = g.file.data;
    assert_true(g.file.size >= 28);
    assert_memory_equal(data, "glTF", 4);
    assert_int_equal(u32_at(data + 4), 2);
    assert_int_equal(u32_at(data + 8), g.file.size);
    const size_t json_size = u32_at(data + 12);
    assert_memory_equal(data + 16, "JSON", 4);
    assert_int_equal(json_size % 4, 0);
    const unsigned char *bin = data + 20 + json_size;
    g.bin_size = u32_at(bin);
    assert_memory_equal(bin + 4, "BIN", 4);
    assert_int_equal(g.bin_size % 4, 0);
    assert_int_equal(20 + json_size + 8 + g.bin_size, g.file.size);
    g.bin = bin + 8;
    const char *end = NULL;
    g.json = cJSON_ParseWithLengthOpts((const char *)data + 20, json_size, &end, 0);
    assert_non_null(g.json);
    for (; end < (const char *)data + 20 + json_size; ++end) {
        assert_int_equal(*end, ' ');
    }
    return g;
}

static inline void free_glb(glb *g) {
    cJSON_Delete(g->json);
    free(g->file.data);
}

static inline cJSON *child(const cJSON *object, const char *name) {
    cJSON *item = cJSON_GetObjectItemCaseSensitive(object, name);
    if (item == NULL) {
        fail_msg("no \"%s\"", name);
    }
    return item;
}

static inline size_t number(const cJSON *object, const char *name) {
    const cJSON *item = child(object, name);
    assert_true(cJSON_IsNumber(item));
    return (size_t)item->valuedouble;
}

static inline cJSON *element(const glb *g, const char *list, size_t index) {
    cJSON *item = cJSON_GetArrayItem(child(g->json, list), (int)index);
    assert_non_null(item);
    return item;
}

static inline size_t component_size(size_t type) { return type == 5121 ? 1 : type == 5123 ? 2 : 4; }

static inline size_t tuple_size(const cJSON *accessor) {
    static const char *const types[] = {"SCALAR", "VEC2", "VEC3", "VEC4", "MAT4"};
    static const size_t sizes[] = {1, 2, 3, 4, 16};
    for (size_t i = 0; i < 5; ++i) {
        if (strcmp(child(accessor, "type")->valuestring, types[i]) == 0) {
            return sizes[i];
        }
    }
    fail_msg("unknown type");
    return 0;
}

// All numbers of an accessor; free the result.
static inline double *read_accessor(const glb *g, size_t index, size_t *count) {
    const cJSON *accessor = element(g, "accessors", index);
    const cJSON *view = element(g, "bufferViews", number(accessor, "bufferView"));
    const cJSON *offset = cJSON_GetObjectItem(accessor, "byteOffset");
    const size_t type = number(accessor, "componentType"), size = component_size(type);
    const size_t begin =
        number(view, "byteOffset") + (offset != NULL ? number(accessor, "byteOffset") : 0);
    *count = number(accessor, "count");
    const size_t total = *count * tuple_size(accessor);
    double *values = malloc(total * sizeof(double));
    assert_non_null(values);
    for (size_t i = 0; i < total; ++i) {
        const unsigned char *at = g->bin + begin + i * size;
        float real = 0.0f;
        memcpy(&real, at, size == 4 ? 4 : 0);
        values[i] = type == 5126   ? (double)real
                    : type == 5125 ? (double)u32_at(at)
                    : type == 5123 ? (double)(at[0] | at[1] << 8)
                                   : (double)at[0];
        if (cJSON_IsTrue(cJSON_GetObjectItem(accessor, "normalized"))) {
            values[i] /= type == 5123 ? 65535.0 : 255.0;
        }
    }
    return values;
}

static inline bool has_attribute(const cJSON *primitive, const char *name) {
    return cJSON_HasObjectItem(child(primitive, "attributes"), name);
}

static inline double *read_attribute(const glb *g, const cJSON *primitive, const char *name,
                                     size_t *count) {
    return read_accessor(g, number(child(primitive, "attributes"), name), count);
}

// Numbers of a property of a node at a frame: animated, else as given, else `missing`.
static inline void node_property(const glb *g, size_t node, const char *path, size_t frame,
                                 size_t width, const double *missing, double *values) {
    const cJSON *given = cJSON_GetObjectItem(element(g, "nodes", node), path);
    for (size_t k = 0; k < width; ++k) {
        values[k] = given != NULL ? cJSON_GetArrayItem(given, (int)k)->valuedouble : missing[k];
    }
    const cJSON *animation = element(g, "animations", 0), *channel;
    cJSON_ArrayForEach(channel, child(animation, "channels")) {
        const cJSON *target = child(channel, "target");
        if (number(target, "node") != node ||
            strcmp(child(target, "path")->valuestring, path) != 0) {
            continue;
        }
        const cJSON *sampler =
            cJSON_GetArrayItem(child(animation, "samplers"), (int)number(channel, "sampler"));
        size_t frames = 0;
        double *all = read_accessor(g, number(sampler, "output"), &frames);
        assert_int_equal(frames, FIXTURE_FRAMES);
        memcpy(values, &all[width * frame], width * sizeof(double));
        free(all);
    }
}

// out = a b, affine, 3 rows of 4.
static inline void multiply_affine(const double a[12], const double b[12], double out[12]) {
    for (size_t i = 0; i < 12; ++i) {
        const size_t row = i / 4, column = i % 4;
        out[i] = column == 3 ? a[4 * row + 3] : 0.0;
        for (size_t k = 0; k < 3; ++k) {
            out[i] += a[4 * row + k] * b[4 * k + column];
        }
    }
}

// The transform of a node to the scene at a frame.
static inline void node_to_scene(const glb *g, size_t node, size_t frame, double out[12]) {
    static const double zero[3] = {0}, one[3] = {1, 1, 1}, still[4] = {0, 0, 0, 1};
    double t[3], q[4], s[3];
    node_property(g, node, "translation", frame, 3, zero, t);
    node_property(g, node, "rotation", frame, 4, still, q);
    node_property(g, node, "scale", frame, 3, one, s);
    const double x = q[0], y = q[1], z = q[2], w = q[3];
    assert_close(x * x + y * y + z * z + w * w, 1.0, 1e-5);
    const double local[12] = {s[0] * (1 - 2 * (y * y + z * z)), s[1] * 2 * (x * y - z * w),
                              s[2] * 2 * (x * z + y * w),       t[0],
                              s[0] * 2 * (x * y + z * w),       s[1] * (1 - 2 * (x * x + z * z)),
                              s[2] * 2 * (y * z - x * w),       t[1],
                              s[0] * 2 * (x * z - y * w),       s[1] * 2 * (y * z + x * w),
                              s[2] * (1 - 2 * (x * x + y * y)), t[2]};
    memcpy(out, local, sizeof(local));
    const cJSON *parent;
    size_t index = 0;
    cJSON_ArrayForEach(parent, child(g->json, "nodes")) {
        const cJSON *children = cJSON_GetObjectItem(parent, "children"), *one_child;
        cJSON_ArrayForEach(one_child, children) {
            if ((size_t)one_child->valueint == node) {
                double above[12];
                node_to_scene(g, index, frame, above);
                multiply_affine(above, local, out);
            }
        }
        ++index;
    }
}

// Poses a primitive of a skinned mesh at a frame as an engine would: joint matrices from the
// animated nodes and the inverse bind matrices, all influences.
static inline double *pose_primitive(const glb *g, const cJSON *primitive, size_t frame,
                                     size_t *count) {
    const cJSON *skin = element(g, "skins", 0), *joints = child(skin, "joints");
    const size_t joint_count = (size_t)cJSON_GetArraySize(joints);
    size_t matrix_count = 0;
    double *inverse = read_accessor(g, number(skin, "inverseBindMatrices"), &matrix_count);
    assert_int_equal(matrix_count, joint_count);
    double *maps = calloc(12 * joint_count, sizeof(double));
    assert_non_null(maps);
    for (size_t j = 0; j < joint_count; ++j) {
        double node[12], bind[12];
        for (size_t i = 0; i < 12; ++i) {
            bind[i] = inverse[16 * j + 4 * (i % 4) + i / 4];
        }
        node_to_scene(g, (size_t)cJSON_GetArrayItem(joints, (int)j)->valueint, frame, node);
        multiply_affine(node, bind, &maps[12 * j]);
    }

    double *posed = read_attribute(g, primitive, "POSITION", count);
    double *sums = calloc(*count, sizeof(double));
    double *rest = malloc(3 * *count * sizeof(double));
    memcpy(rest, posed, 3 * *count * sizeof(double));
    memset(posed, 0, 3 * *count * sizeof(double));
    for (unsigned set = 0; set < 8; ++set) {
        char joints_name[16], weights_name[16];
        snprintf(joints_name, sizeof(joints_name), "JOINTS_%u", set);
        snprintf(weights_name, sizeof(weights_name), "WEIGHTS_%u", set);
        if (!has_attribute(primitive, joints_name)) {
            break;
        }
        size_t rows = 0;
        double *bones = read_attribute(g, primitive, joints_name, &rows);
        assert_int_equal(rows, *count);
        double *weights = read_attribute(g, primitive, weights_name, &rows);
        assert_int_equal(rows, *count);
        for (size_t i = 0; i < 4 * *count; ++i) {
            const size_t v = i / 4, joint = (size_t)bones[i];
            assert_true(joint < joint_count && (weights[i] > 0.0 || joint == 0));
            for (size_t k = 0; k < 3; ++k) {
                const double *row = &maps[12 * joint + 4 * k], *at = &rest[3 * v];
                posed[3 * v + k] +=
                    weights[i] * (row[0] * at[0] + row[1] * at[1] + row[2] * at[2] + row[3]);
            }
            sums[v] += weights[i];
        }
        free(bones);
        free(weights);
    }
    for (size_t v = 0; v < *count; ++v) {
        assert_close(sums[v], 1.0, 1e-7);
    }
    free(sums);
    free(rest);
    free(maps);
    free(inverse);
    return posed;
}

#endif
