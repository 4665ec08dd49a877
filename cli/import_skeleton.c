// Nodes, joints, weights and animations of a scene.
#include "import_reader.h"

#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

void import_nodes(scene_reader *reader, const struct aiNode *node, size_t parent) {
    const affine local = affine_from_assimp(&node->mTransformation);
    const affine world =
        affine_multiply(parent != SIZE_MAX ? &reader->nodes[parent].world : &reader->map, &local);
    const size_t index = reader->scene.header.node_count++;
    reader->nodes = import_grow(reader, reader->nodes, &reader->node_capacity, index + 1,
                                sizeof(*reader->nodes));
    reader->nodes[index] =
        (node_entry){.node = node, .world = world, .order = index, .parent = parent};
    for (unsigned i = 0; i < node->mNumChildren; ++i) {
        import_nodes(reader, node->mChildren[i], index);
    }
}

static int compare_nodes(const void *left, const void *right) {
    const node_entry *a = left, *b = right;
    const int names = strcmp(a->node->mName.data, b->node->mName.data);
    return names != 0 ? names : (a->order > b->order) - (a->order < b->order);
}

node_entry *import_sort_nodes(scene_reader *reader) {
    const size_t count = reader->scene.header.node_count;
    node_entry *by_name = import_allocate(reader, count, sizeof(*by_name));
    memcpy(by_name, reader->nodes, count * sizeof(*by_name));
    qsort(by_name, count, sizeof(*by_name), compare_nodes);
    return by_name;
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
        import_fail(reader, "the skin uses a node \"%.64s\" that does not exist; export it again",
                    name);
    }
    if (low + 1 < count && strcmp(by_name[low + 1].node->mName.data, name) == 0) {
        import_fail(reader,
                    "several nodes are called \"%.64s\", which makes the skin ambiguous; rename "
                    "them, or export as glTF",
                    name);
    }
    return &by_name[low];
}

affine *import_skin_maps(scene_reader *reader, const struct aiMesh *mesh, const affine *node,
                         const node_entry *by_name) {
    affine *maps = import_allocate(reader, mesh->mNumVertices, sizeof(*maps));
    double *sums = import_allocate(reader, mesh->mNumVertices, sizeof(*sums));
    for (unsigned b = 0; b < mesh->mNumBones; ++b) {
        const struct aiBone *bone = mesh->mBones[b];
        if (bone->mNumWeights == 0) {
            continue;
        }
        const affine bind = affine_from_assimp(&bone->mOffsetMatrix);
        const affine map =
            affine_multiply(&find_node(reader, by_name, bone->mName.data)->world, &bind);
        for (unsigned w = 0; w < bone->mNumWeights; ++w) {
            const unsigned vertex = bone->mWeights[w].mVertexId;
            const double weight = (double)bone->mWeights[w].mWeight;
            if (vertex >= mesh->mNumVertices) {
                import_fail(reader,
                            "the skin refers to a vertex that does not exist; export it again");
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

void import_joints(scene_reader *reader, const node_entry *by_name) {
    scene_data *s = &reader->scene;
    const size_t count = s->header.node_count;
    bool skinned = false;
    reader->joint_of = import_allocate(reader, count, sizeof(*reader->joint_of));
    reader->joint_nodes = import_allocate(reader, count, sizeof(*reader->joint_nodes));
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
    s->joints = import_allocate(reader, count, sizeof(*s->joints));
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

void import_weights(scene_reader *reader, const struct aiMesh *mesh, const node_entry *entry,
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

// The keys before and after a time, `from` and `to`, and how far it is between them, 0..1. A key of
// either type, `size` bytes, begins with its time; their times rise.
_Static_assert(offsetof(struct aiVectorKey, mTime) == 0 && offsetof(struct aiQuatKey, mTime) == 0,
               "keys begin with their time");
static double find_keys(const void *keys, size_t size, unsigned count, double time, unsigned *from,
                        unsigned *to) {
    unsigned low = 0, high = count; // the first key after the time is within
    double times[2];
    while (low < high) {
        const unsigned middle = low + (high - low) / 2;
        memcpy(&times[0], (const char *)keys + middle * size, sizeof(times[0]));
        if (times[0] <= time) {
            low = middle + 1;
        } else {
            high = middle;
        }
    }
    *from = low > 0 ? low - 1 : 0;
    *to = low < count ? low : count - 1;
    memcpy(&times[0], (const char *)keys + *from * size, sizeof(times[0]));
    memcpy(&times[1], (const char *)keys + *to * size, sizeof(times[1]));
    return times[1] > times[0] ? (time - times[0]) / (times[1] - times[0]) : 0.0;
}

static void key_vector(const struct aiVectorKey *keys, unsigned count, double time, double out[3]) {
    unsigned before, after;
    const double share = find_keys(keys, sizeof(*keys), count, time, &before, &after);
    const struct aiVectorKey *a = &keys[before], *b = &keys[after];
    const double from[3] = {(double)a->mValue.x, (double)a->mValue.y, (double)a->mValue.z};
    const double to[3] = {(double)b->mValue.x, (double)b->mValue.y, (double)b->mValue.z};
    for (size_t k = 0; k < 3; ++k) {
        out[k] = from[k] + share * (to[k] - from[k]);
    }
}

// A unit quaternion x, y, z, w: linear between the keys, on the shorter way, then normalised; keys
// are dense enough for that.
static void key_rotation(const struct aiQuatKey *keys, unsigned count, double time, double q[4]) {
    unsigned before, after;
    const double share = find_keys(keys, sizeof(*keys), count, time, &before, &after);
    const struct aiQuatKey *a = &keys[before], *b = &keys[after];
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
    const double determinant = affine_cofactors(a, c);
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
        const affine local = channels[n] != NULL
                                 ? channel_at(channels[n], ticks)
                                 : affine_from_assimp(&entry->node->mTransformation);
        worlds[n] = affine_multiply(
            entry->parent != SIZE_MAX ? &worlds[entry->parent] : &reader->map, &local);
    }
    for (size_t j = 0; j < reader->scene.header.joint_count; ++j) {
        const affine map = affine_multiply(&worlds[reader->joint_nodes[j]], &inverses[j]);
        for (size_t k = 0; k < 12; ++k) {
            pose[12 * j + k] = (float)map.m[k];
        }
    }
}

void import_poses(scene_reader *reader) {
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
    affine *worlds = import_allocate(reader, nodes, sizeof(*worlds));
    affine *inverses = import_allocate(reader, joints, sizeof(*inverses));
    const struct aiNodeAnim **channels = import_allocate(reader, nodes, sizeof(*channels));
    for (size_t j = 0; j < joints; ++j) {
        if (!invert(&reader->nodes[reader->joint_nodes[j]].world, &inverses[j])) {
            inverses[j] = affine_identity; // a joint without extent moves nothing
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
        s->poses =
            import_grow(reader, s->poses, &capacity,
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
