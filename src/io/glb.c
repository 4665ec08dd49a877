// Binary glTF 2.0. The encoding is the one that all importers we know read correctly: one joint per
// proxy vertex, flat under one root, inverse bind matrices and animation that only translate, the
// skinned meshes at the root of the scene. With weights that sum to 1 this is equation (6); with
// rotation channels on the same joints it is linear blend skinning as in pc_skin_deform.
#include <stdio.h>

#include "geometry/rotation.h"
#include "geometry/topology.h"
#include "io/asset_table.h"
#include "io/atomic_file.h"
#include "io/glb_writer.h"
#include "io/json.h"
#include "proxycloth/export.h"
#include "proxycloth/version.h"

#define STAGE "export"

#define LARGEST_JOINT_COUNT 65536

static bool turns(const pci_glb *glb) { return glb->asset->skin.skinning == PC_SKINNING_ROTATION; }

// ---- joints, motion -----------------------------------------------------------------------------

static void add_joint_name(pci_glb *glb, cJSON *parent, const char *key, size_t joint) {
    char name[80];
    snprintf(name, sizeof(name), "%s_joint_%04zu", glb->name, joint);
    pci_json_string(&glb->json, parent, key, name);
}

// Springs of the simulation: two vertices each, and their rest lengths.
static void add_springs(pci_glb *glb, cJSON *extras, const char *name, const uint32_t *pairs,
                        size_t count, double stiffness) {
    const double *positions = glb->asset->proxy.positions;
    cJSON *springs = pci_json_object(&glb->json, extras, name);
    pci_json_number(&glb->json, springs, "stiffness", stiffness);
    cJSON *vertices = pci_json_array(&glb->json, springs, "vertices");
    cJSON *lengths = pci_json_array(&glb->json, springs, "rest_lengths");
    for (size_t i = 0; i < count; ++i) {
        const uint32_t a = pairs[2 * i], b = pairs[2 * i + 1];
        pci_json_count(&glb->json, vertices, NULL, a);
        pci_json_count(&glb->json, vertices, NULL, b);
        pci_json_number(
            &glb->json, lengths, NULL,
            sqrt(pci_squared_distance(&positions[3 * (size_t)a], &positions[3 * (size_t)b])));
    }
}

// Pairs of vertices across each inner edge.
static uint32_t *bend_pairs(pci_glb *glb, const pci_topology *topology, size_t *count) {
    const pc_mesh *proxy = &glb->asset->proxy;
    uint32_t *pairs = PCI_SCRATCH(&glb->scratch, uint32_t, 2 * topology->edge_count);
    *count = 0;
    for (size_t e = 0; e < topology->edge_count && pairs != NULL; ++e) {
        if (pci_side_count(topology, e) != 2) {
            continue;
        }
        uint32_t pair[2] = {0};
        for (size_t side = 0; side < 2; ++side) {
            const uint32_t *corner = &proxy->triangles[3 * (size_t)pci_sides(topology, e)[side]];
            const uint32_t *edge = &topology->edges[2 * e];
            for (size_t k = 0; k < 3; ++k) {
                if (corner[k] != edge[0] && corner[k] != edge[1]) {
                    pair[side] = corner[k];
                }
            }
        }
        if (pair[0] != pair[1]) {
            memcpy(&pairs[2 * (*count)++], pair, sizeof(pair));
        }
    }
    return pairs;
}

// What a cloth solver of an engine needs to drive the joints itself.
static void add_proxy_extras(pci_glb *glb, cJSON *node) {
    const pc_asset *asset = glb->asset;
    const pc_mesh *proxy = &asset->proxy;
    const pc_simulate_options *options = &asset->options.simulate;
    pci_topology topology = {0};
    if (!pci_topology_build(&glb->scratch, proxy, &topology)) {
        return;
    }
    cJSON *extras =
        pci_json_object(&glb->json, pci_json_object(&glb->json, node, "extras"), "proxycloth");
    pci_json_count(&glb->json, extras, "version", 1);
    cJSON *joints = pci_json_array(&glb->json, extras, "joints");
    for (size_t v = 0; v < proxy->vertex_count; ++v) {
        add_joint_name(glb, joints, NULL, v);
    }
    cJSON *triangles = pci_json_array(&glb->json, extras, "triangles");
    for (size_t i = 0; i < 3 * proxy->triangle_count; ++i) {
        pci_json_count(&glb->json, triangles, NULL, proxy->triangles[i]);
    }
    if (turns(glb)) {
        pci_json_string(&glb->json, extras, "skinning", "rotation");
    }
    cJSON *pinned = pci_json_array(&glb->json, extras, "pinned");
    for (size_t v = 0; v < proxy->vertex_count; ++v) {
        if (asset->motion.pinned[v] != 0) {
            pci_json_count(&glb->json, pinned, NULL, v);
        }
    }
    add_springs(glb, extras, "stretch_springs", topology.edges, topology.edge_count,
                options->stretch_stiffness);
    size_t bend_count = 0;
    const uint32_t *bends = bend_pairs(glb, &topology, &bend_count);
    add_springs(glb, extras, "bend_springs", bends, bend_count, options->bend_stiffness);
    pci_json_record(&glb->json, extras, "simulation", &pc_simulate_options_record, options);
}

// Nodes: joint i is node i, then the root of the joints, the garment, the proxy, the skeleton.
static void add_nodes(pci_glb *glb) {
    const pc_mesh *proxy = &glb->asset->proxy;
    const size_t count = proxy->vertex_count;
    cJSON *nodes = pci_json_array(&glb->json, glb->json.root, "nodes");
    for (size_t v = 0; v < count; ++v) {
        cJSON *node = pci_json_object(&glb->json, nodes, NULL);
        add_joint_name(glb, node, "name", v);
        cJSON *translation = pci_json_array(&glb->json, node, "translation");
        for (size_t k = 0; k < 3; ++k) {
            pci_json_number(&glb->json, translation, NULL,
                            (double)(float)proxy->positions[3 * v + k]);
        }
    }
    char name[64];
    cJSON *root = pci_json_object(&glb->json, nodes, NULL);
    snprintf(name, sizeof(name), "%s_joints", glb->name);
    pci_json_string(&glb->json, root, "name", name);
    cJSON *children = pci_json_array(&glb->json, root, "children");
    for (size_t v = 0; v < count; ++v) {
        pci_json_count(&glb->json, children, NULL, v);
    }
    pci_glb_add_body_roots(glb, children, count + 3);
    for (uint32_t mesh = 0; mesh < 2; ++mesh) {
        cJSON *node = pci_json_object(&glb->json, nodes, NULL);
        snprintf(name, sizeof(name), "%s%s", glb->name, mesh == 0 ? "" : "_proxy");
        pci_json_string(&glb->json, node, "name", name);
        pci_json_count(&glb->json, node, "mesh", mesh);
        pci_json_count(&glb->json, node, "skin", 0);
        if (mesh == 1) {
            add_proxy_extras(glb, node);
        }
    }
    pci_glb_add_body_nodes(glb, nodes, count + 3);
    cJSON *scenes = pci_json_array(&glb->json, glb->json.root, "scenes");
    cJSON *scene_nodes =
        pci_json_array(&glb->json, pci_json_object(&glb->json, scenes, NULL), "nodes");
    for (size_t i = 0; i < 3; ++i) {
        pci_json_count(&glb->json, scene_nodes, NULL, count + i);
    }
    pci_json_count(&glb->json, glb->json.root, "scene", 0);
}

static void add_skin(pci_glb *glb) {
    const pc_mesh *proxy = &glb->asset->proxy;
    const size_t count = proxy->vertex_count, joint_count = pci_glb_joint_count(glb);
    cJSON *accessor = NULL;
    float *matrices = pci_glb_add_floats(glb, joint_count, 16, 0, &accessor);
    if (matrices == NULL) {
        return;
    }
    for (size_t v = 0; v < joint_count; ++v) {
        const double *rest = v < count ? &proxy->positions[3 * v]
                                       : &glb->asset->character.joint_centers[3 * (v - count)];
        float *matrix = &matrices[16 * v];
        memset(matrix, 0, 16 * sizeof(float));
        matrix[0] = matrix[5] = matrix[10] = matrix[15] = 1.0f;
        for (size_t k = 0; k < 3; ++k) {
            matrix[12 + k] = -(float)rest[k];
        }
    }
    cJSON *skins = pci_json_array(&glb->json, glb->json.root, "skins");
    cJSON *skin = pci_json_object(&glb->json, skins, NULL);
    pci_json_count(&glb->json, skin, "inverseBindMatrices", glb->accessor_count - 1);
    pci_json_count(&glb->json, skin, "skeleton", count);
    cJSON *joints = pci_json_array(&glb->json, skin, "joints");
    for (size_t v = 0; v < joint_count; ++v) {
        pci_json_count(&glb->json, joints, NULL, v < count ? v : v + 3);
    }
}

// One channel per joint from values by joint and frame, `tuple` floats each.
static void add_joint_channels(pci_glb *glb, uint32_t input, cJSON *channels, cJSON *samplers,
                               size_t first_sampler, const char *path, size_t tuple,
                               const double *values) {
    const size_t frames = glb->asset->motion.frame_count;
    const size_t joints = glb->asset->motion.vertex_count;
    float *floats = pci_glb_add_view(glb, joints * frames * tuple * sizeof(float), 0);
    if (floats == NULL) {
        return;
    }
    for (size_t j = 0; j < joints; ++j) {
        for (size_t i = 0; i < frames * tuple; ++i) {
            const size_t frame = i / tuple;
            floats[j * frames * tuple + i] =
                (float)values[(frame * joints + j) * tuple + i % tuple];
        }
        pci_glb_add_accessor(glb, j * frames * tuple * sizeof(float), GL_FLOAT, frames,
                             tuple == 3 ? "VEC3" : "VEC4");
        cJSON *sampler = pci_json_object(&glb->json, samplers, NULL);
        pci_json_count(&glb->json, sampler, "input", input);
        pci_json_count(&glb->json, sampler, "output", glb->accessor_count - 1);
        pci_json_string(&glb->json, sampler, "interpolation", "LINEAR");
        cJSON *channel = pci_json_object(&glb->json, channels, NULL);
        pci_json_count(&glb->json, channel, "sampler", first_sampler + j);
        cJSON *target = pci_json_object(&glb->json, channel, "target");
        pci_json_count(&glb->json, target, "node", j);
        pci_json_string(&glb->json, target, "path", path);
    }
}

static void add_animation(pci_glb *glb) {
    const pc_motion *motion = &glb->asset->motion;
    const size_t frames = motion->frame_count, joints = motion->vertex_count;
    if (frames == 0) {
        return;
    }
    double *rotations = NULL;
    if (pci_rotations_of_motion(&glb->scratch, STAGE, &glb->asset->proxy, motion, turns(glb),
                                &rotations) != PC_OK) {
        glb->scratch.failed = true; // the proxy was checked
        return;
    }
    cJSON *accessor = NULL;
    float *times = pci_glb_add_floats(glb, frames, 1, 0, &accessor);
    if (times == NULL) {
        return;
    }
    for (size_t f = 0; f < frames; ++f) {
        times[f] = (float)((double)f * motion->frame_time);
    }
    pci_glb_add_limits(glb, accessor, times, frames, 1);
    const uint32_t input = glb->accessor_count - 1;
    cJSON *animations = pci_json_array(&glb->json, glb->json.root, "animations");
    cJSON *animation = pci_json_object(&glb->json, animations, NULL);
    pci_json_string(&glb->json, animation, "name", "simulation");
    cJSON *channels = pci_json_array(&glb->json, animation, "channels");
    cJSON *samplers = pci_json_array(&glb->json, animation, "samplers");
    add_joint_channels(glb, input, channels, samplers, 0, "translation", 3, motion->positions);
    size_t sampler = joints;
    if (rotations != NULL) {
        add_joint_channels(glb, input, channels, samplers, sampler, "rotation", 4, rotations);
        sampler += joints;
    }
    pci_glb_add_body_channels(glb, input, channels, samplers, sampler, joints + 3);
}

// ---- file -------------------------------------------------------------------------------------

// Node names are paths and identifiers in engines: letters, digits, '-', '_' and what is not ASCII.
static void choose_name(const char *asset_name, char name[PCI_GLB_NAME_LIMIT + 1]) {
    size_t length = strlen(asset_name);
    // Never in the middle of a UTF-8 sequence.
    for (length = length < PCI_GLB_NAME_LIMIT ? length : PCI_GLB_NAME_LIMIT;
         length > 0 && ((unsigned char)asset_name[length] & 0xc0) == 0x80; --length) {
    }
    memcpy(name, asset_name, length);
    name[length] = '\0';
    for (char *at = name; *at != '\0'; ++at) {
        const bool kept = ((unsigned char)*at & 0x80) != 0 || (*at >= 'a' && *at <= 'z') ||
                          (*at >= 'A' && *at <= 'Z') || (*at >= '0' && *at <= '9') || *at == '-';
        *at = kept ? *at : '_';
    }
    if (length == 0) {
        memcpy(name, "garment", sizeof("garment"));
    }
}

static void build(pci_glb *glb) {
    cJSON *root = glb->json.root;
    cJSON *asset = pci_json_object(&glb->json, root, "asset");
    pci_json_string(&glb->json, asset, "version", "2.0");
    pci_json_string(&glb->json, asset, "generator", "proxycloth " PC_VERSION_STRING);
    glb->meshes = pci_json_array(&glb->json, root, "meshes");
    glb->materials = pci_json_array(&glb->json, root, "materials");
    glb->accessors = pci_json_array(&glb->json, root, "accessors");
    glb->views = pci_json_array(&glb->json, root, "bufferViews");
    pci_glb_add_visual_mesh(glb);
    pci_glb_add_proxy_mesh(glb);
    add_skin(glb);
    add_animation(glb);
    add_nodes(glb);
    cJSON *buffers = pci_json_array(&glb->json, root, "buffers");
    pci_json_count(&glb->json, pci_json_object(&glb->json, buffers, NULL), "byteLength", glb->size);
}

static void write_u32(FILE *stream, size_t value) {
    unsigned char bytes[4];
    for (size_t i = 0; i < 4; ++i) {
        bytes[i] = (unsigned char)(value >> (8 * i));
    }
    fwrite(bytes, 1, sizeof(bytes), stream);
}

static void write_chunk(FILE *stream, size_t type, const void *bytes, size_t size, int filler) {
    const size_t padding = (4 - size % 4) % 4;
    write_u32(stream, size + padding);
    write_u32(stream, type);
    fwrite(bytes, 1, size, stream);
    for (size_t i = 0; i < padding; ++i) {
        fputc(filler, stream);
    }
}

static pc_status write_glb(pci_glb *glb, const char *path) {
    if (pci_glb_failed(glb)) {
        return pci_fail_memory(glb->context, STAGE);
    }
    char *text = pci_json_print(&glb->json, false);
    if (text == NULL) {
        return pci_fail_memory(glb->context, STAGE);
    }
    const size_t json_size = strlen(text);
    const size_t total = 12 + 8 + (json_size + 3) / 4 * 4 + 8 + (glb->size + 3) / 4 * 4;
    pci_atomic_file file = {0};
    pc_status status;
    if (total > UINT32_MAX) {
        status = pci_fail(glb->context, PC_ERROR_TOO_LARGE, STAGE,
                          STAGE ": %zu bytes do not fit into a GLB file", total);
    } else {
        status = pci_atomic_begin(glb->context, STAGE, path, &file);
    }
    if (status == PC_OK) {
        write_u32(file.stream, 0x46546C67); // "glTF"
        write_u32(file.stream, 2);
        write_u32(file.stream, total);
        write_chunk(file.stream, 0x4E4F534A, text, json_size, ' ');        // "JSON"
        write_chunk(file.stream, 0x004E4942, glb->bytes, glb->size, '\0'); // "BIN"
        status = pci_atomic_end(&file, PC_OK);
    }
    cJSON_free(text);
    return status;
}

static pc_status check_joint_count(const pci_glb *glb) {
    const size_t count = pci_glb_joint_count(glb), proxy = glb->asset->proxy.vertex_count;
    const uint32_t allowed = glb->asset->options.skin.max_bones;
    if (count > LARGEST_JOINT_COUNT) {
        return pci_fail(glb->context, PC_ERROR_TOO_LARGE, STAGE,
                        STAGE ": the proxy has %zu vertices, glTF allows %d joints", proxy,
                        LARGEST_JOINT_COUNT);
    }
    if (allowed != 0 && count > allowed && count > proxy) {
        return pci_fail(glb->context, PC_ERROR_TOO_LARGE, STAGE,
                        STAGE ": %zu proxy vertices and %zu joints of the skeleton are more than "
                              "max_bones = %u",
                        proxy, count - proxy, allowed);
    }
    return PC_OK;
}

pc_status pc_export_glb(pc_context *context, const pc_asset *asset, const char *path) {
    if (context == NULL) {
        return PC_ERROR_INVALID_ARGUMENT;
    }
    if (asset == NULL || path == NULL || asset->stage_count < PC_STAGE_COUNT) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, STAGE,
                        STAGE ": a GLB needs an asset with all stages done and a path");
    }
    char problem[256];
    if (!pci_asset_check(asset, problem, sizeof(problem))) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, STAGE, STAGE ": %s", problem);
    }
    pci_glb glb = {.context = context, .asset = asset, .scratch = pci_scratch_begin(context)};
    pc_status status =
        pc_body_skin_create(context, &asset->visual, &asset->character, &asset->proxy,
                            &asset->motion, &asset->options.skin, &glb.body, NULL);
    if (status == PC_OK) {
        status = check_joint_count(&glb);
    }
    if (status == PC_OK) {
        choose_name(asset->name, glb.name);
        pci_json_begin(&glb.json);
        build(&glb);
        status = write_glb(&glb, path);
        pci_json_end(&glb.json);
    }
    pc_body_skin_free(context, &glb.body);
    pci_scratch_end(&glb.scratch);
    return status;
}
