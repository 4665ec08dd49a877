// The only file that knows assimp: scene file -> flat buffer. Runs in the import child, so it frees
// nothing and may be killed at any time.
#define _POSIX_C_SOURCE 200809L
#include "scene.h"

#include <errno.h>
#include <math.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <assimp/cimport.h>
#include <assimp/config.h>
#include <assimp/material.h>
#include <assimp/postprocess.h>
#include <assimp/scene.h>
#include <cjson/cJSON.h>

// An affine map, three rows of four.
typedef struct affine {
    double m[12];
} affine;

typedef struct node_entry {
    const struct aiNode *node;
    affine world;
    size_t order;
    size_t parent; // in the order of the tree; SIZE_MAX: none
} node_entry;

// All corner attributes, compared as bytes; no padding.
typedef struct corner_data {
    double position[3];
    float normal[3], texcoord[2], color[4];
    uint32_t zero;
} corner_data;

typedef struct scene_reader {
    int descriptor;
    const struct aiScene *source;
    node_entry *nodes; // in the order of the tree, then sorted by name
    size_t node_capacity;
    affine map;          // of the file's axes and unit
    uint32_t *joint_of;  // per node in the order of the tree, UINT32_MAX: no joint
    size_t *joint_nodes; // node of each joint
    scene_data scene;    // arrays that grow
    size_t part_capacity, vertex_capacity, triangle_capacity;
} scene_reader;

// ---- errors and memory --------------------------------------------------------------------------

static void write_all(int descriptor, const void *bytes, size_t size) {
    const char *at = bytes;
    while (size != 0) {
        const ssize_t count = write(descriptor, at, size);
        if (count < 0 && errno != EINTR) {
            _exit(CLI_INTERNAL); // the parent is gone
        }
        at += count > 0 ? count : 0;
        size -= count > 0 ? (size_t)count : 0;
    }
}

__attribute__((format(printf, 2, 3))) _Noreturn static void fail(scene_reader *reader,
                                                                 const char *format, ...) {
    scene_failure failure = {.magic = SCENE_FAILURE_MAGIC};
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(failure.message, sizeof(failure.message), format, arguments);
    va_end(arguments);
    failure.out_of_memory = strstr(failure.message, "bad_alloc") != NULL ||
                            strstr(failure.message, "length_error") != NULL;
    write_all(reader->descriptor, &failure, sizeof(failure));
    _exit(CLI_INPUT);
}

// Grows an array to hold `needed` elements; new elements are zero.
static void *grow(scene_reader *reader, void *array, size_t *capacity, size_t needed, size_t size) {
    if (needed <= *capacity) {
        return array;
    }
    size_t grown = 2 * *capacity < needed ? needed : 2 * *capacity;
    char *memory = grown < SIZE_MAX / 2 / size ? realloc(array, grown * size) : NULL;
    if (memory == NULL) {
        fail(reader, "bad_alloc");
    }
    memset(memory + *capacity * size, 0, (grown - *capacity) * size);
    *capacity = grown;
    return memory;
}

static void *allocate(scene_reader *reader, size_t count, size_t size) {
    size_t capacity = 0;
    return grow(reader, NULL, &capacity, count + 1, size);
}

// ---- affine maps --------------------------------------------------------------------------------

static affine from_assimp(const struct aiMatrix4x4 *a) {
    const affine result = {{(double)a->a1, (double)a->a2, (double)a->a3, (double)a->a4,
                            (double)a->b1, (double)a->b2, (double)a->b3, (double)a->b4,
                            (double)a->c1, (double)a->c2, (double)a->c3, (double)a->c4}};
    return result;
}

static affine multiply(const affine *a, const affine *b) {
    affine result;
    for (size_t row = 0; row < 3; ++row) {
        const double *r = &a->m[4 * row];
        for (size_t column = 0; column < 4; ++column) {
            result.m[4 * row + column] = r[0] * b->m[column] + r[1] * b->m[4 + column] +
                                         r[2] * b->m[8 + column] + (column == 3 ? r[3] : 0.0);
        }
    }
    return result;
}

// Cofactors of the linear part: determinant times inverse transpose, row by row. Returns the
// determinant.
static double cofactors(const affine *a, double c[9]) {
    const double *m = a->m;
    c[0] = m[5] * m[10] - m[6] * m[9];
    c[1] = m[6] * m[8] - m[4] * m[10];
    c[2] = m[4] * m[9] - m[5] * m[8];
    c[3] = m[2] * m[9] - m[1] * m[10];
    c[4] = m[0] * m[10] - m[2] * m[8];
    c[5] = m[1] * m[8] - m[0] * m[9];
    c[6] = m[1] * m[6] - m[2] * m[5];
    c[7] = m[2] * m[4] - m[0] * m[6];
    c[8] = m[0] * m[5] - m[1] * m[4];
    return m[0] * c[0] + m[1] * c[1] + m[2] * c[2];
}

static const affine identity = {{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}};

static bool is_identity(const affine *a) { return memcmp(a, &identity, sizeof(*a)) == 0; }

static void transform_point(const affine *a, const struct aiVector3D *v, double out[3]) {
    if (is_identity(a)) { // a NaN stays in its coordinate
        out[0] = (double)v->x, out[1] = (double)v->y, out[2] = (double)v->z;
        return;
    }
    for (size_t k = 0; k < 3; ++k) {
        const double *row = &a->m[4 * k];
        out[k] = row[0] * (double)v->x + row[1] * (double)v->y + row[2] * (double)v->z + row[3];
    }
}

// Normals turn with the inverse transpose; its length does not matter.
static void transform_normal(const affine *a, const struct aiVector3D *v, float out[3]) {
    double c[9], normal[3];
    const double sign = cofactors(a, c) < 0.0 ? -1.0 : 1.0;
    double length = 0.0;
    for (size_t k = 0; k < 3; ++k) {
        normal[k] = sign * (c[3 * k] * (double)v->x + c[3 * k + 1] * (double)v->y +
                            c[3 * k + 2] * (double)v->z);
        length += normal[k] * normal[k];
    }
    length = sqrt(length);
    for (size_t k = 0; k < 3; ++k) {
        out[k] = (float)(length > 0.0 ? normal[k] / length : 0.0);
    }
}

// ---- nodes --------------------------------------------------------------------------------------

static void collect_nodes(scene_reader *reader, const struct aiNode *node, size_t parent) {
    const affine local = from_assimp(&node->mTransformation);
    const affine world =
        multiply(parent != SIZE_MAX ? &reader->nodes[parent].world : &reader->map, &local);
    const size_t index = reader->scene.header.node_count++;
    reader->nodes =
        grow(reader, reader->nodes, &reader->node_capacity, index + 1, sizeof(*reader->nodes));
    reader->nodes[index] =
        (node_entry){.node = node, .world = world, .order = index, .parent = parent};
    for (unsigned i = 0; i < node->mNumChildren; ++i) {
        collect_nodes(reader, node->mChildren[i], index);
    }
}

static int compare_nodes(const void *left, const void *right) {
    const node_entry *a = left, *b = right;
    const int names = strcmp(a->node->mName.data, b->node->mName.data);
    return names != 0 ? names : (a->order > b->order) - (a->order < b->order);
}

static const node_entry *find_node(scene_reader *reader, const node_entry *by_name,
                                   const char *name) {
    const size_t count = reader->scene.header.node_count;
    size_t low = 0, high = count;
    while (low < high) {
        const size_t middle = (low + high) / 2;
        if (strcmp(by_name[middle].node->mName.data, name) < 0) {
            low = middle + 1;
        } else {
            high = middle;
        }
    }
    if (low == count || strcmp(by_name[low].node->mName.data, name) != 0) {
        fail(reader, "the skin uses a node \"%.64s\" that does not exist; export it again", name);
    }
    if (low + 1 < count && strcmp(by_name[low + 1].node->mName.data, name) == 0) {
        fail(reader,
             "several nodes are called \"%.64s\", which makes the skin ambiguous; rename "
             "them",
             name);
    }
    return &by_name[low];
}

// The map of each vertex in the rest pose: sum of weight * joint * inverse bind. The transform of
// the mesh's own node does not count for a skinned mesh, unless a vertex has no weight.
static affine *skin_maps(scene_reader *reader, const struct aiMesh *mesh, const affine *node,
                         const node_entry *by_name) {
    affine *maps = allocate(reader, mesh->mNumVertices, sizeof(*maps));
    double *sums = allocate(reader, mesh->mNumVertices, sizeof(*sums));
    for (unsigned b = 0; b < mesh->mNumBones; ++b) {
        const struct aiBone *bone = mesh->mBones[b];
        if (bone->mNumWeights == 0) {
            continue;
        }
        const affine bind = from_assimp(&bone->mOffsetMatrix);
        const affine map = multiply(&find_node(reader, by_name, bone->mName.data)->world, &bind);
        for (unsigned w = 0; w < bone->mNumWeights; ++w) {
            const unsigned vertex = bone->mWeights[w].mVertexId;
            const double weight = (double)bone->mWeights[w].mWeight;
            if (vertex >= mesh->mNumVertices) {
                fail(reader, "the skin refers to a vertex that does not exist; export it again");
            }
            sums[vertex] += weight;
            for (size_t k = 0; k < 12; ++k) {
                maps[vertex].m[k] += weight * map.m[k];
            }
        }
    }
    for (size_t v = 0; v < mesh->mNumVertices; ++v) {
        for (size_t k = 0; k < 12; ++k) {
            maps[v].m[k] = sums[v] > 0.0 ? maps[v].m[k] / sums[v] : node->m[k];
        }
    }
    free(sums);
    return maps;
}

// ---- joints and poses ---------------------------------------------------------------------------

// Numbers the nodes that vertices follow, in the order of the tree: bones, and nodes of rigid
// meshes where anything is animated.
static void collect_joints(scene_reader *reader, const node_entry *by_name) {
    scene_data *s = &reader->scene;
    const size_t count = s->header.node_count;
    bool skinned = false;
    reader->joint_of = allocate(reader, count, sizeof(*reader->joint_of));
    reader->joint_nodes = allocate(reader, count, sizeof(*reader->joint_nodes));
    for (unsigned i = 0; i < reader->source->mNumMeshes; ++i) {
        const struct aiMesh *mesh = reader->source->mMeshes[i];
        for (unsigned b = 0; b < mesh->mNumBones; ++b) {
            if (mesh->mBones[b]->mNumWeights != 0) {
                reader->joint_of[find_node(reader, by_name, mesh->mBones[b]->mName.data)->order] =
                    1;
                skinned = true;
            }
        }
    }
    for (size_t n = 0; n < count; ++n) {
        const struct aiNode *node = reader->nodes[n].node;
        for (unsigned i = 0; i < node->mNumMeshes; ++i) {
            const bool rigid = node->mMeshes[i] < reader->source->mNumMeshes &&
                               reader->source->mMeshes[node->mMeshes[i]]->mNumBones == 0;
            if (rigid && (skinned || reader->source->mNumAnimations != 0)) {
                reader->joint_of[n] = 1;
            }
        }
    }
    s->joints = allocate(reader, count, sizeof(*s->joints));
    for (size_t n = 0; n < count; ++n) {
        if (reader->joint_of[n] == 0) {
            reader->joint_of[n] = UINT32_MAX;
            continue;
        }
        scene_joint *joint = &s->joints[s->header.joint_count];
        cli_clean_text(joint->name, sizeof(joint->name), reader->nodes[n].node->mName.data);
        for (size_t k = 0; k < 3; ++k) {
            joint->center[k] = reader->nodes[n].world.m[4 * k + 3];
        }
        joint->parent = PC_INVALID_INDEX;
        for (size_t up = reader->nodes[n].parent; up != SIZE_MAX; up = reader->nodes[up].parent) {
            if (reader->joint_of[up] != UINT32_MAX) {
                joint->parent = reader->joint_of[up];
                break;
            }
        }
        reader->joint_nodes[s->header.joint_count] = n;
        reader->joint_of[n] = (uint32_t)s->header.joint_count++;
    }
}

// The four largest weights of each vertex of a mesh; `joints` and `weights` are #vertices by 4.
static void read_weights(scene_reader *reader, const struct aiMesh *mesh, const node_entry *entry,
                         const node_entry *by_name, uint32_t *joints, float *weights) {
    for (unsigned b = 0; b < mesh->mNumBones; ++b) {
        const struct aiBone *bone = mesh->mBones[b];
        const uint32_t joint =
            bone->mNumWeights != 0
                ? reader->joint_of[find_node(reader, by_name, bone->mName.data)->order]
                : 0;
        for (unsigned w = 0; w < bone->mNumWeights; ++w) {
            const size_t first = 4 * (size_t)bone->mWeights[w].mVertexId;
            const float weight = bone->mWeights[w].mWeight;
            size_t least = first;
            for (size_t k = first; k < first + 4; ++k) {
                least = weights[k] < weights[least] ? k : least;
            }
            if (weight > weights[least]) {
                joints[least] = joint;
                weights[least] = weight;
            }
        }
    }
    // What has no weight hangs on its node.
    const uint32_t own = reader->joint_of[entry->order];
    for (size_t v = 0; v < mesh->mNumVertices && own != UINT32_MAX; ++v) {
        if (!(weights[4 * v] + weights[4 * v + 1] + weights[4 * v + 2] + weights[4 * v + 3] >
              0.0F)) {
            joints[4 * v] = own;
            weights[4 * v] = 1.0F;
        }
    }
}

static void key_vector(const struct aiVectorKey *keys, unsigned count, double time, double out[3]) {
    unsigned next = 0;
    while (next < count && keys[next].mTime <= time) {
        ++next;
    }
    const struct aiVectorKey *a = &keys[next > 0 ? next - 1 : 0];
    const struct aiVectorKey *b = &keys[next < count ? next : count - 1];
    const double share = b->mTime > a->mTime ? (time - a->mTime) / (b->mTime - a->mTime) : 0.0;
    const double from[3] = {(double)a->mValue.x, (double)a->mValue.y, (double)a->mValue.z};
    const double to[3] = {(double)b->mValue.x, (double)b->mValue.y, (double)b->mValue.z};
    for (size_t k = 0; k < 3; ++k) {
        out[k] = from[k] + share * (to[k] - from[k]);
    }
}

// A unit quaternion x, y, z, w: linear between the keys, on the shorter way, then normalised; keys
// are dense enough for that.
static void key_rotation(const struct aiQuatKey *keys, unsigned count, double time, double q[4]) {
    unsigned next = 0;
    while (next < count && keys[next].mTime <= time) {
        ++next;
    }
    const struct aiQuatKey *a = &keys[next > 0 ? next - 1 : 0];
    const struct aiQuatKey *b = &keys[next < count ? next : count - 1];
    double share = b->mTime > a->mTime ? (time - a->mTime) / (b->mTime - a->mTime) : 0.0;
    const double from[4] = {(double)a->mValue.x, (double)a->mValue.y, (double)a->mValue.z,
                            (double)a->mValue.w};
    const double to[4] = {(double)b->mValue.x, (double)b->mValue.y, (double)b->mValue.z,
                          (double)b->mValue.w};
    double cosine = 0.0, length = 0.0;
    for (size_t k = 0; k < 4; ++k) {
        cosine += from[k] * to[k];
    }
    for (size_t k = 0; k < 4; ++k) {
        q[k] = (1.0 - share) * from[k] + (cosine < 0.0 ? -share : share) * to[k];
        length += q[k] * q[k];
    }
    length = sqrt(length);
    for (size_t k = 0; k < 4; ++k) {
        q[k] = length > 0.0 ? q[k] / length : (k == 3 ? 1.0 : 0.0);
    }
}

// Translation, rotation and scale of a node at a time in ticks.
static affine channel_at(const struct aiNodeAnim *channel, double time) {
    double t[3] = {0.0, 0.0, 0.0}, q[4] = {0.0, 0.0, 0.0, 1.0}, s[3] = {1.0, 1.0, 1.0};
    if (channel->mNumPositionKeys != 0) {
        key_vector(channel->mPositionKeys, channel->mNumPositionKeys, time, t);
    }
    if (channel->mNumRotationKeys != 0) {
        key_rotation(channel->mRotationKeys, channel->mNumRotationKeys, time, q);
    }
    if (channel->mNumScalingKeys != 0) {
        key_vector(channel->mScalingKeys, channel->mNumScalingKeys, time, s);
    }
    const double x = q[0], y = q[1], z = q[2], w = q[3];
    const affine result = {{s[0] * (1 - 2 * (y * y + z * z)), s[1] * 2 * (x * y - z * w),
                            s[2] * 2 * (x * z + y * w), t[0], s[0] * 2 * (x * y + z * w),
                            s[1] * (1 - 2 * (x * x + z * z)), s[2] * 2 * (y * z - x * w), t[1],
                            s[0] * 2 * (x * z - y * w), s[1] * 2 * (y * z + x * w),
                            s[2] * (1 - 2 * (x * x + y * y)), t[2]}};
    return result;
}

// Inverse of an affine map; false where it has none.
static bool invert(const affine *a, affine *out) {
    double c[9];
    const double determinant = cofactors(a, c);
    if (!(fabs(determinant) > 1e-30)) {
        return false;
    }
    for (size_t row = 0; row < 3; ++row) {
        out->m[4 * row + 3] = 0.0;
        for (size_t k = 0; k < 3; ++k) {
            out->m[4 * row + k] = c[3 * k + row] / determinant;
            out->m[4 * row + 3] -= out->m[4 * row + k] * a->m[4 * k + 3];
        }
    }
    return true;
}

// The maps of all joints at a time: from where they are in the rest pose to where they are now.
static void read_pose(scene_reader *reader, const struct aiNodeAnim *const *channels, double ticks,
                      affine *worlds, const affine *inverses, float *pose) {
    for (size_t n = 0; n < reader->scene.header.node_count; ++n) {
        const node_entry *entry = &reader->nodes[n];
        const affine local = channels[n] != NULL ? channel_at(channels[n], ticks)
                                                 : from_assimp(&entry->node->mTransformation);
        worlds[n] =
            multiply(entry->parent != SIZE_MAX ? &worlds[entry->parent] : &reader->map, &local);
    }
    for (size_t j = 0; j < reader->scene.header.joint_count; ++j) {
        const affine map = multiply(&worlds[reader->joint_nodes[j]], &inverses[j]);
        for (size_t k = 0; k < 12; ++k) {
            pose[12 * j + k] = (float)map.m[k];
        }
    }
}

// Samples every animation 60 times a second, the last pose exactly at its end; fewer times where
// that would be more than fits.
static void read_poses(scene_reader *reader) {
    static const size_t most_maps = (size_t)1 << 21;
    scene_data *s = &reader->scene;
    const size_t nodes = s->header.node_count, joints = s->header.joint_count;
    if (joints == 0 || s->header.animation_count == 0) {
        return;
    }
    double rate = 60.0, total = 0.0;
    for (size_t a = 0; a < s->header.animation_count; ++a) {
        total += s->animations[a].seconds;
    }
    while (rate > 1.0 && total * rate * (double)joints > (double)most_maps) {
        rate *= 0.5;
    }
    affine *worlds = allocate(reader, nodes, sizeof(*worlds));
    affine *inverses = allocate(reader, joints, sizeof(*inverses));
    const struct aiNodeAnim **channels = allocate(reader, nodes, sizeof(*channels));
    for (size_t j = 0; j < joints; ++j) {
        if (!invert(&reader->nodes[reader->joint_nodes[j]].world, &inverses[j])) {
            inverses[j] = identity; // a joint without extent moves nothing
        }
    }
    size_t capacity = 0;
    for (size_t a = 0; a < s->header.animation_count; ++a) {
        const struct aiAnimation *in = reader->source->mAnimations[a];
        scene_animation *out = &s->animations[a];
        if (!(out->seconds >= 0.0 && out->seconds * rate < (double)most_maps)) {
            continue; // no usable length
        }
        const double steps = floor(out->seconds * rate + 0.5);
        out->first_pose = s->header.pose_count;
        out->pose_count = (uint64_t)steps + 1;
        out->rate = steps > 0.0 ? steps / out->seconds : rate;
        s->poses = grow(reader, s->poses, &capacity,
                        (s->header.pose_count + out->pose_count) * joints, 12 * sizeof(float));
        for (size_t n = 0; n < nodes; ++n) {
            channels[n] = NULL;
            for (unsigned c = 0; c < in->mNumChannels && channels[n] == NULL; ++c) {
                if (strcmp(in->mChannels[c]->mNodeName.data, reader->nodes[n].node->mName.data) ==
                    0) {
                    channels[n] = in->mChannels[c];
                }
            }
        }
        for (size_t p = 0; p < out->pose_count; ++p) {
            const double share = steps > 0.0 ? (double)p / steps : 0.0;
            read_pose(reader, channels, share * in->mDuration, worlds, inverses,
                      &s->poses[12 * joints * s->header.pose_count++]);
        }
    }
    free(worlds);
    free(inverses);
    free(channels);
}

// ---- units and axes -----------------------------------------------------------------------------

static bool metadata_number(const struct aiMetadata *data, const char *key, double *number) {
    for (unsigned i = 0; data != NULL && i < data->mNumProperties; ++i) {
        const struct aiMetadataEntry *entry = &data->mValues[i];
        if (strcmp(data->mKeys[i].data, key) != 0) {
            continue;
        }
        switch (entry->mType) {
        case AI_INT32:
            *number = *(const int32_t *)entry->mData;
            return true;
        case AI_FLOAT:
            *number = (double)*(const float *)entry->mData;
            return true;
        case AI_DOUBLE:
            *number = *(const double *)entry->mData;
            return true;
        default:
            return false;
        }
    }
    return false;
}

// The map from the file's axes and unit to metres with y up. COLLADA files come converted, glTF
// needs nothing, and the other formats know no units.
static affine scene_map(const struct aiScene *source, scene_format format) {
    static const char *const names[3][2] = {
        {"CoordAxis", "CoordAxisSign"}, {"UpAxis", "UpAxisSign"}, {"FrontAxis", "FrontAxisSign"}};
    affine map = identity;
    if (format != SCENE_FBX) {
        return map;
    }
    // FBX counts in centimetres, times a factor. assimp 5.2 leaves factor and axes to the caller;
    // later versions put them into the root's transform.
    map.m[0] = map.m[5] = map.m[10] = 0.01;
    const affine root = from_assimp(&source->mRootNode->mTransformation);
    if (!is_identity(&root)) {
        return map;
    }
    double factor = 1.0, unused[9];
    if (!metadata_number(source->mMetaData, "UnitScaleFactor", &factor) ||
        !(factor > 1e-12 && factor < 1e12)) {
        factor = 1.0;
    }
    affine axes = {{0}};
    for (size_t row = 0; row < 3; ++row) {
        double axis = -1.0, sign = 0.0;
        (void)metadata_number(source->mMetaData, names[row][0], &axis);
        (void)metadata_number(source->mMetaData, names[row][1], &sign);
        for (size_t k = 0; k < 3; ++k) {
            axes.m[4 * row + k] = axis == (double)k ? sign * 0.01 * factor : 0.0;
        }
    }
    // Anything but a rotation means that the file does not say.
    map.m[0] = map.m[5] = map.m[10] = 0.01 * factor;
    return cofactors(&axes, unused) > 0.0 ? axes : map;
}

// ---- parts --------------------------------------------------------------------------------------

static uint64_t hash_corner(const corner_data *c) {
    const unsigned char *bytes = (const unsigned char *)c;
    uint64_t hash = 14695981039346656037u;
    for (size_t i = 0; i < sizeof(*c); ++i) {
        hash = (hash ^ bytes[i]) * 1099511628211u;
    }
    return hash ^ hash >> 32;
}

// Numbers distinct corners in the order of their first appearance: importers repeat a vertex for
// every face that uses it.
static size_t join_corners(scene_reader *reader, const corner_data *corners, size_t count,
                           uint32_t *numbers, uint32_t *firsts) {
    size_t slots = 16;
    while (slots < 2 * count) {
        slots *= 2;
    }
    uint32_t *table = allocate(reader, slots, sizeof(*table)); // number + 1
    size_t distinct = 0;
    for (size_t v = 0; v < count; ++v) {
        size_t slot = (size_t)hash_corner(&corners[v]) & (slots - 1);
        while (table[slot] != 0 &&
               memcmp(&corners[firsts[table[slot] - 1]], &corners[v], sizeof(*corners)) != 0) {
            slot = (slot + 1) & (slots - 1);
        }
        if (table[slot] == 0) {
            firsts[distinct] = (uint32_t)v;
            table[slot] = (uint32_t)++distinct;
        }
        numbers[v] = table[slot] - 1;
    }
    free(table);
    return distinct;
}

static void read_corner(const struct aiMesh *mesh, size_t v, const affine *map, corner_data *out) {
    transform_point(map, &mesh->mVertices[v], out->position);
    if (mesh->mNormals != NULL) {
        transform_normal(map, &mesh->mNormals[v], out->normal);
    }
    if (mesh->mTextureCoords[0] != NULL) {
        // assimp's origin is bottom left, ours top left.
        out->texcoord[0] = mesh->mTextureCoords[0][v].x;
        out->texcoord[1] = 1.0F - mesh->mTextureCoords[0][v].y;
    }
    const struct aiColor4D *color = mesh->mColors[0] != NULL ? &mesh->mColors[0][v] : NULL;
    const float rgba[4] = {color != NULL ? color->r : 1.0F, color != NULL ? color->g : 1.0F,
                           color != NULL ? color->b : 1.0F, color != NULL ? color->a : 1.0F};
    memcpy(out->color, rgba, sizeof(rgba));
}

static void reserve(scene_reader *reader, size_t vertices, size_t triangles) {
    scene_data *s = &reader->scene;
    size_t capacity = reader->vertex_capacity;
    s->positions = grow(reader, s->positions, &capacity, vertices, 3 * sizeof(double));
    capacity = reader->vertex_capacity;
    s->normals = grow(reader, s->normals, &capacity, vertices, 3 * sizeof(float));
    capacity = reader->vertex_capacity;
    s->vertex_joints = grow(reader, s->vertex_joints, &capacity, vertices, 4 * sizeof(uint32_t));
    capacity = reader->vertex_capacity;
    s->vertex_weights = grow(reader, s->vertex_weights, &capacity, vertices, 4 * sizeof(float));
    capacity = reader->vertex_capacity;
    s->texcoords = grow(reader, s->texcoords, &capacity, vertices, 2 * sizeof(float));
    s->colors = grow(reader, s->colors, &reader->vertex_capacity, vertices, 4 * sizeof(float));
    s->triangles =
        grow(reader, s->triangles, &reader->triangle_capacity, triangles, 3 * sizeof(uint32_t));
}

static void store_vertices(scene_data *s, const corner_data *corners, const uint32_t *joints,
                           const float *weights, const uint32_t *firsts, size_t count) {
    for (size_t i = 0, v = s->header.vertex_count; i < count; ++i, ++v) {
        const corner_data *c = &corners[firsts[i]];
        memcpy(&s->positions[3 * v], c->position, sizeof(c->position));
        memcpy(&s->normals[3 * v], c->normal, sizeof(c->normal));
        memcpy(&s->texcoords[2 * v], c->texcoord, sizeof(c->texcoord));
        memcpy(&s->colors[4 * v], c->color, sizeof(c->color));
        memcpy(&s->vertex_joints[4 * v], &joints[4 * firsts[i]], 4 * sizeof(*joints));
        memcpy(&s->vertex_weights[4 * v], &weights[4 * firsts[i]], 4 * sizeof(*weights));
    }
}

static void store_triangles(scene_reader *reader, const struct aiMesh *mesh,
                            const uint32_t *numbers, bool mirrored) {
    scene_data *s = &reader->scene;
    for (unsigned f = 0; f < mesh->mNumFaces; ++f) {
        const struct aiFace *face = &mesh->mFaces[f];
        if (face->mNumIndices != 3) {
            continue; // points and lines
        }
        uint32_t *triangle = &s->triangles[3 * s->header.triangle_count++];
        for (size_t k = 0; k < 3; ++k) {
            const unsigned v = face->mIndices[mirrored && k != 0 ? 3 - k : k];
            if (v >= mesh->mNumVertices) {
                fail(reader, "a face refers to vertex %u of %u; export it again", v,
                     mesh->mNumVertices);
            }
            triangle[k] = (uint32_t)(s->header.vertex_count + numbers[v]);
        }
    }
}

static void add_part(scene_reader *reader, const node_entry *entry, const struct aiMesh *mesh,
                     const node_entry *by_name) {
    scene_data *s = &reader->scene;
    const size_t count = mesh->mNumVertices;
    if (s->header.vertex_count + count >= UINT32_MAX / 2 ||
        s->header.triangle_count + mesh->mNumFaces >= UINT32_MAX / 6) {
        fail(reader, "more than 2^31 elements");
    }
    corner_data *corners = allocate(reader, count, sizeof(*corners));
    uint32_t *numbers = allocate(reader, count, sizeof(*numbers));
    uint32_t *firsts = allocate(reader, count, sizeof(*firsts));
    uint32_t *joints = allocate(reader, count, 4 * sizeof(*joints));
    float *weights = allocate(reader, count, 4 * sizeof(*weights));
    affine *maps = mesh->mNumBones != 0 ? skin_maps(reader, mesh, &entry->world, by_name) : NULL;
    read_weights(reader, mesh, entry, by_name, joints, weights);
    for (size_t v = 0; v < count; ++v) {
        read_corner(mesh, v, maps != NULL ? &maps[v] : &entry->world, &corners[v]);
    }
    const size_t distinct = join_corners(reader, corners, count, numbers, firsts);
    reserve(reader, s->header.vertex_count + distinct, s->header.triangle_count + mesh->mNumFaces);
    s->parts =
        grow(reader, s->parts, &reader->part_capacity, s->header.part_count + 1, sizeof(*s->parts));
    scene_part *part = &s->parts[s->header.part_count++];
    cli_clean_text(part->node, sizeof(part->node), entry->node->mName.data);
    cli_clean_text(part->mesh, sizeof(part->mesh), mesh->mName.data);
    part->first_vertex = s->header.vertex_count;
    part->vertex_count = distinct;
    part->first_triangle = s->header.triangle_count;
    part->material =
        mesh->mMaterialIndex < reader->source->mNumMaterials ? mesh->mMaterialIndex : 0;
    part->bone_count = mesh->mNumBones;
    part->has_normals = mesh->mNormals != NULL;
    part->has_texcoords = mesh->mTextureCoords[0] != NULL;
    part->has_colors = mesh->mColors[0] != NULL;
    // A mirrored part is turned inside out again. One vertex stands for a skinned part.
    double unused[9];
    const affine *sample = maps != NULL && count != 0 ? &maps[0] : &entry->world;
    store_triangles(reader, mesh, numbers, cofactors(sample, unused) < 0.0);
    store_vertices(s, corners, joints, weights, firsts, distinct);
    s->header.vertex_count += distinct;
    part->triangle_count = s->header.triangle_count - part->first_triangle;
    free(corners);
    free(joints);
    free(weights);
    free(numbers);
    free(firsts);
    free(maps);
}

// ---- materials and animations -------------------------------------------------------------------

static float material_number(const struct aiMaterial *material, const char *key, unsigned type,
                             unsigned index, float fallback) {
    ai_real value = fallback;
    unsigned count = 1;
    return aiGetMaterialFloatArray(material, key, type, index, &value, &count) == aiReturn_SUCCESS
               ? value
               : fallback;
}

static void read_materials(scene_reader *reader) {
    scene_data *s = &reader->scene;
    const size_t count = reader->source->mNumMaterials;
    s->header.material_count = count != 0 ? count : 1;
    s->materials = allocate(reader, s->header.material_count, sizeof(*s->materials));
    for (size_t m = 0; m < s->header.material_count; ++m) {
        pc_material *out = &s->materials[m];
        const pc_material white = {.base_color = {1.0F, 1.0F, 1.0F, 1.0F}, .roughness = 1.0F};
        *out = white;
        if (count == 0) {
            continue;
        }
        const struct aiMaterial *in = reader->source->mMaterials[m];
        struct aiString name = {0};
        if (aiGetMaterialString(in, AI_MATKEY_NAME, &name) == aiReturn_SUCCESS) {
            cli_clean_text(out->name, sizeof(out->name), name.data);
        }
        struct aiColor4D color;
        const bool base = aiGetMaterialColor(in, AI_MATKEY_BASE_COLOR, &color) == aiReturn_SUCCESS;
        if (base || aiGetMaterialColor(in, AI_MATKEY_COLOR_DIFFUSE, &color) == aiReturn_SUCCESS) {
            const float opacity = base ? 1.0F : material_number(in, AI_MATKEY_OPACITY, 1.0F);
            const float rgba[4] = {color.r, color.g, color.b, color.a * opacity};
            memcpy(out->base_color, rgba, sizeof(rgba));
        }
        out->metallic = material_number(in, AI_MATKEY_METALLIC_FACTOR, 0.0F);
        out->roughness = material_number(in, AI_MATKEY_ROUGHNESS_FACTOR, 1.0F);
        int two_sided = 0;
        unsigned one = 1;
        out->double_sided = aiGetMaterialIntegerArray(in, AI_MATKEY_TWOSIDED, &two_sided, &one) ==
                                aiReturn_SUCCESS &&
                            two_sided != 0;
    }
}

static void read_animations(scene_reader *reader) {
    scene_data *s = &reader->scene;
    s->header.animation_count = reader->source->mNumAnimations;
    s->animations = allocate(reader, s->header.animation_count, sizeof(*s->animations));
    for (size_t a = 0; a < s->header.animation_count; ++a) {
        const struct aiAnimation *in = reader->source->mAnimations[a];
        cli_clean_text(s->animations[a].name, sizeof(s->animations[a].name), in->mName.data);
        s->animations[a].seconds =
            in->mTicksPerSecond > 0.0 ? in->mDuration / in->mTicksPerSecond : in->mDuration;
        s->animations[a].channels = in->mNumChannels;
    }
}

// ---- files --------------------------------------------------------------------------------------

static char *read_file(scene_reader *reader, const char *path, size_t *size) {
    FILE *file = fopen(path, "rb");
    if (file == NULL) {
        fail(reader, "%s", strerror(errno));
    }
    char *bytes = NULL;
    size_t capacity = 0, count = 1;
    for (*size = 0; count != 0; *size += count) {
        bytes = grow(reader, bytes, &capacity, *size + 65536, 1);
        count = fread(bytes + *size, 1, capacity - *size, file);
    }
    if (ferror(file)) {
        fail(reader, "%s", strerror(errno));
    }
    fclose(file);
    return bytes;
}

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

// assimp 5.2 takes the integers of texture coordinates and weights for floats.
static void check_attributes(scene_reader *reader, const cJSON *root) {
    static const char *const names[] = {"POSITION", "NORMAL", "TEXCOORD_0", "WEIGHTS_0",
                                        "WEIGHTS_1"};
    const cJSON *accessors = cJSON_GetObjectItemCaseSensitive(root, "accessors");
    const cJSON *mesh = NULL, *primitive = NULL;
    cJSON_ArrayForEach(mesh, cJSON_GetObjectItemCaseSensitive(root, "meshes")) {
        cJSON_ArrayForEach(primitive, cJSON_GetObjectItemCaseSensitive(mesh, "primitives")) {
            const cJSON *attributes = cJSON_GetObjectItemCaseSensitive(primitive, "attributes");
            for (size_t i = 0; i < sizeof(names) / sizeof(names[0]); ++i) {
                const cJSON *index = cJSON_GetObjectItemCaseSensitive(attributes, names[i]);
                const cJSON *type = cJSON_GetObjectItemCaseSensitive(
                    cJSON_IsNumber(index) ? cJSON_GetArrayItem(accessors, index->valueint) : NULL,
                    "componentType");
                if (cJSON_IsNumber(type) && type->valueint != 5126) {
                    fail(reader,
                         "%s is stored as integers, which is not supported; export it with "
                         "32-bit floats",
                         names[i]);
                }
            }
        }
    }
}

// assimp reads garbage where a glTF file needs an extension it does not know.
static void check_json(scene_reader *reader, const char *bytes, size_t size, scene_format format) {
    if (format == SCENE_GLB) {
        uint32_t length = 0;
        if (size < 20) {
            fail(reader, "the file is truncated; export it again");
        }
        memcpy(&length, bytes + 12, sizeof(length));
        if (length > size - 20) {
            fail(reader, "the file is truncated; export it again");
        }
        bytes += 20;
        size = length;
    }
    cJSON *root = cJSON_ParseWithLength(bytes, size);
    if (root == NULL) {
        fail(reader, "its JSON part is damaged; export it again");
    }
    const cJSON *required = cJSON_GetObjectItemCaseSensitive(root, "extensionsRequired");
    for (int i = 0; i < cJSON_GetArraySize(required); ++i) {
        const char *name = cJSON_GetStringValue(cJSON_GetArrayItem(required, i));
        if (name != NULL && !harmless_extension(name)) {
            fail(reader, "the glTF extension %.64s is not supported; export without it", name);
        }
    }
    check_attributes(reader, root);
    cJSON_Delete(root);
}

static const struct aiScene *import(scene_reader *reader, const char *path, scene_format format) {
    const unsigned flags = aiProcess_Triangulate;
    struct aiPropertyStore *store = aiCreatePropertyStore();
    aiSetImportPropertyInteger(store, AI_CONFIG_IMPORT_NO_SKELETON_MESHES, 1);
    aiSetImportPropertyInteger(store, AI_CONFIG_IMPORT_COLLADA_USE_COLLADA_NAMES, 1);
    aiSetImportPropertyInteger(store, AI_CONFIG_IMPORT_FBX_PRESERVE_PIVOTS, 0);
    size_t size = 0;
    char *bytes = read_file(reader, path, &size);
    if (format == SCENE_GLB || format == SCENE_GLTF) {
        check_json(reader, bytes, size, format);
    }
    if (format == SCENE_GLB) {
        bytes = scene_unpack_glb(bytes, &size);
    }
    // Files that refer to others are read through their path; the others from memory, where the
    // hint decides about the importer.
    const struct aiScene *source =
        format == SCENE_OBJ || format == SCENE_GLTF
            ? aiImportFileExWithProperties(path, flags, NULL, store)
        : size > UINT32_MAX
            ? NULL
            : aiImportFileFromMemoryWithProperties(bytes, (unsigned)size, flags,
                                                   scene_format_extension(format), store);
    free(bytes);
    if (source == NULL || source->mRootNode == NULL) {
        const char *reason = aiGetErrorString();
        fail(reader, "%s", reason != NULL && reason[0] != '\0' ? reason : "the file is damaged");
    }
    return source;
}

static void send(scene_reader *reader) {
    scene_data *s = &reader->scene;
    uint64_t at[SCENE_ARRAYS + 1];
    memcpy(s->header.magic, SCENE_MAGIC, sizeof(s->header.magic));
    if (!scene_layout(&s->header, at)) {
        fail(reader, "more than 2^31 elements");
    }
    s->header.size = at[SCENE_ARRAYS];
    const scene_header *h = &s->header;
    const struct {
        const void *array;
        size_t size;
    } arrays[SCENE_ARRAYS] = {{s->parts, h->part_count * sizeof(scene_part)},
                              {s->materials, h->material_count * sizeof(pc_material)},
                              {s->animations, h->animation_count * sizeof(scene_animation)},
                              {s->positions, h->vertex_count * 3 * sizeof(double)},
                              {s->normals, h->vertex_count * 3 * sizeof(float)},
                              {s->texcoords, h->vertex_count * 2 * sizeof(float)},
                              {s->colors, h->vertex_count * 4 * sizeof(float)},
                              {s->triangles, h->triangle_count * 3 * sizeof(uint32_t)},
                              {s->joints, h->joint_count * sizeof(scene_joint)},
                              {s->poses, h->pose_count * h->joint_count * 12 * sizeof(float)},
                              {s->vertex_joints, h->vertex_count * 4 * sizeof(uint32_t)},
                              {s->vertex_weights, h->vertex_count * 4 * sizeof(float)}};
    const char zeros[8] = {0};
    write_all(reader->descriptor, &s->header, sizeof(s->header));
    for (size_t i = 0; i < SCENE_ARRAYS; ++i) {
        write_all(reader->descriptor, arrays[i].array, arrays[i].size);
        write_all(reader->descriptor, zeros, (size_t)(at[i + 1] - at[i]) - arrays[i].size);
    }
}

int scene_read(const char *path, scene_format format, int descriptor) {
    scene_reader reader = {.descriptor = descriptor};
    reader.source = import(&reader, path, format);
    scene_data *s = &reader.scene;
    strncpy(s->header.format, scene_format_name(format), sizeof(s->header.format) - 1);
    reader.map = scene_map(reader.source, format);
    collect_nodes(&reader, reader.source->mRootNode, SIZE_MAX);
    node_entry *by_name = allocate(&reader, s->header.node_count, sizeof(*by_name));
    memcpy(by_name, reader.nodes, s->header.node_count * sizeof(*by_name));
    qsort(by_name, s->header.node_count, sizeof(*by_name), compare_nodes);
    read_materials(&reader);
    collect_joints(&reader, by_name);
    read_animations(&reader);
    read_poses(&reader);
    for (size_t n = 0; n < s->header.node_count; ++n) {
        const struct aiNode *node = reader.nodes[n].node;
        for (unsigned i = 0; i < node->mNumMeshes; ++i) {
            if (node->mMeshes[i] < reader.source->mNumMeshes) {
                add_part(&reader, &reader.nodes[n], reader.source->mMeshes[node->mMeshes[i]],
                         by_name);
            }
        }
    }
    send(&reader);
    return CLI_OK;
}
