// The skeleton of the character in the file: its joints behind those of the proxy, with the names
// and the tree of the input. In the rest pose all of them only translate, so the inverse bind
// matrices do too.
#include "geometry/pose.h"
#include "geometry/rotation.h"
#include "io/glb_writer.h"

#define STAGE "export"

static const pc_character *skeleton(const pci_glb *glb) { return &glb->asset->character; }

static bool has_body(const pci_glb *glb) { return glb->body.vertex_count != 0; }

static uint32_t parent_of(const pci_glb *glb, size_t joint) {
    const uint32_t *parents = skeleton(glb)->joint_parents;
    return parents != NULL ? parents[joint] : PC_INVALID_INDEX;
}

size_t pci_glb_joint_count(const pci_glb *glb) {
    return glb->asset->proxy.vertex_count + (has_body(glb) ? skeleton(glb)->joint_count : 0);
}

void pci_glb_add_body_roots(pci_glb *glb, cJSON *children, size_t first) {
    for (size_t j = 0; has_body(glb) && j < skeleton(glb)->joint_count; ++j) {
        if (parent_of(glb, j) == PC_INVALID_INDEX) {
            pci_json_count(&glb->json, children, NULL, first + j);
        }
    }
}

void pci_glb_add_body_nodes(pci_glb *glb, cJSON *nodes, size_t first) {
    const pc_character *c = skeleton(glb);
    for (size_t j = 0; has_body(glb) && j < c->joint_count; ++j) {
        cJSON *node = pci_json_object(&glb->json, nodes, NULL);
        pci_json_string(&glb->json, node, "name", &c->joint_names[PC_NAME_SIZE * j]);
        const uint32_t parent = parent_of(glb, j);
        cJSON *translation = pci_json_array(&glb->json, node, "translation");
        for (size_t k = 0; k < 3; ++k) {
            const double from =
                parent != PC_INVALID_INDEX ? c->joint_centers[3 * (size_t)parent + k] : 0.0;
            pci_json_number(&glb->json, translation, NULL,
                            (double)(float)(c->joint_centers[3 * j + k] - from));
        }
        cJSON *children = NULL;
        for (size_t i = j + 1; i < c->joint_count; ++i) {
            if (parent_of(glb, i) == j) {
                children =
                    children != NULL ? children : pci_json_array(&glb->json, node, "children");
                pci_json_count(&glb->json, children, NULL, first + i);
            }
        }
    }
}

// ---- motion -------------------------------------------------------------------------------------

// Where a joint is at a time: its linear map and its place.
typedef struct joint_place {
    pci_map map;
    double at[3];
} joint_place;

static void place_joint(const pc_character *c, const pci_map *maps, size_t joint,
                        joint_place *place) {
    place->map = maps[joint];
    place->map.m[3] = place->map.m[7] = place->map.m[11] = 0.0;
    pci_map_apply(&maps[joint], &c->joint_centers[3 * joint], place->at);
}

// Rotation (x, y, z, w) and scale of a linear map whose columns are orthogonal.
static void decompose(const pci_map *map, double rotation[4], double scale[3]) {
    double r[3][3]; // columns
    for (size_t c = 0; c < 3; ++c) {
        for (size_t k = 0; k < 3; ++k) {
            r[c][k] = map->m[4 * k + c];
        }
        scale[c] = pci_norm(r[c]);
        (void)pci_normalize(r[c]);
    }
    double third[3];
    pci_cross(r[0], r[1], third);
    if (pci_dot(third, r[2]) < 0.0) { // a mirror: along the last axis
        scale[2] = -scale[2];
    }
    memcpy(r[2], third, sizeof(third));
    const double rows[9] = {r[0][0], r[1][0], r[2][0], r[0][1], r[1][1],
                            r[2][1], r[0][2], r[1][2], r[2][2]};
    pci_quaternion_of_matrix(rows, rotation);
}

// Translation, rotation and scale of all joints against their parents at one time; #J by 10.
static void local_places(const pci_glb *glb, const pci_map *maps, float *places) {
    const pc_character *c = skeleton(glb);
    for (size_t j = 0; j < c->joint_count; ++j) {
        joint_place own, above;
        place_joint(c, maps, j, &own);
        const uint32_t parent = parent_of(glb, j);
        pci_map local = own.map, inverse;
        double offset[3] = {own.at[0], own.at[1], own.at[2]}, turned[3], rotation[4], scale[3];
        if (parent != PC_INVALID_INDEX) {
            place_joint(c, maps, parent, &above);
            if (!pci_map_invert(&above.map, &inverse)) {
                inverse = (pci_map){{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}};
            }
            pci_sub(own.at, above.at, turned);
            pci_map_apply(&inverse, turned, offset);
            for (size_t i = 0; i < 9; ++i) {
                const size_t row = i / 3, column = i % 3;
                local.m[4 * row + column] = inverse.m[4 * row] * own.map.m[column] +
                                            inverse.m[4 * row + 1] * own.map.m[4 + column] +
                                            inverse.m[4 * row + 2] * own.map.m[8 + column];
            }
        }
        decompose(&local, rotation, scale);
        for (size_t k = 0; k < 3; ++k) {
            places[10 * j + k] = (float)offset[k];
            places[10 * j + 7 + k] = (float)scale[k];
        }
        for (size_t k = 0; k < 4; ++k) {
            places[10 * j + 3 + k] = (float)rotation[k];
        }
    }
}

// Consecutive rotations take the shorter way.
static void align_rotations(float *rotations, size_t frames) {
    for (size_t f = 1; f < frames; ++f) {
        const float *before = &rotations[4 * (f - 1)];
        float *now = &rotations[4 * f], cosine = 0.0F;
        for (size_t k = 0; k < 4; ++k) {
            cosine += now[k] * before[k];
        }
        for (size_t k = 0; k < 4; ++k) {
            now[k] = cosine < 0.0F ? -now[k] : now[k];
        }
    }
}

void pci_glb_add_body_channels(pci_glb *glb, uint32_t input, cJSON *channels, cJSON *samplers,
                               size_t sampler, size_t first) {
    static const struct {
        const char *path, *type;
        size_t from, tuple;
    } kinds[] = {
        {"translation", "VEC3", 0, 3}, {"rotation", "VEC4", 3, 4}, {"scale", "VEC3", 7, 3}};
    const pc_attachment *attachment = &glb->asset->scenario.attachment;
    const pc_motion *motion = &glb->asset->motion;
    const size_t frames = motion->frame_count, joints = skeleton(glb)->joint_count;
    if (!has_body(glb) || attachment->kind != PC_ATTACHMENT_CLIP) {
        return;
    }
    pci_poses poses;
    float *places = PCI_SCRATCH(&glb->scratch, float, frames *joints * 10);
    if (places == NULL ||
        pci_poses_begin(&glb->scratch, STAGE, skeleton(glb), attachment, 1.0, &poses) != PC_OK) {
        glb->scratch.failed = true; // the clip was there when the motion was made
        return;
    }
    for (size_t f = 0; f < frames; ++f) {
        pci_poses_set(&poses, (double)(f + 1) * motion->frame_time); // as the simulation does
        local_places(glb, poses.maps, &places[10 * joints * f]);
    }
    for (size_t kind = 0; kind < 3; ++kind) {
        const size_t tuple = kinds[kind].tuple;
        float *values = pci_glb_add_view(glb, joints * frames * tuple * sizeof(float), 0);
        for (size_t j = 0; j < joints && values != NULL; ++j) {
            float *own = &values[j * frames * tuple];
            for (size_t i = 0; i < frames * tuple; ++i) {
                own[i] = places[10 * (joints * (i / tuple) + j) + kinds[kind].from + i % tuple];
            }
            if (tuple == 4) {
                align_rotations(own, frames);
            }
            pci_glb_add_accessor(glb, j * frames * tuple * sizeof(float), GL_FLOAT, frames,
                                 kinds[kind].type);
            cJSON *row = pci_json_object(&glb->json, samplers, NULL);
            pci_json_count(&glb->json, row, "input", input);
            pci_json_count(&glb->json, row, "output", glb->accessor_count - 1);
            pci_json_string(&glb->json, row, "interpolation", "LINEAR");
            cJSON *channel = pci_json_object(&glb->json, channels, NULL);
            pci_json_count(&glb->json, channel, "sampler", sampler++);
            cJSON *target = pci_json_object(&glb->json, channel, "target");
            pci_json_count(&glb->json, target, "node", first + j);
            pci_json_string(&glb->json, target, "path", kinds[kind].path);
        }
    }
}
