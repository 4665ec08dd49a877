// Plain arrays -> character: checks and copies.
#include "proxycloth/character.h"

#include "core/core.h"
#include "proxycloth/scenario.h"

static const char module[] = "character";

static pc_status invalid(pc_context *context, const char *what, size_t index) {
    return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, module, "character: %s %zu is out of range",
                    what, index);
}

static pc_status check_skeleton(pc_context *context, const pc_character *c) {
    if ((c->joint_count != 0 && (c->joint_names == NULL || c->joint_centers == NULL)) ||
        (c->clip_count != 0 &&
         (c->clip_names == NULL || c->clip_poses == NULL || c->clip_rates == NULL)) ||
        (c->pose_count != 0 && c->joint_count != 0 && c->poses == NULL)) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, module,
                        "character: a count is given without its array");
    }
    for (size_t j = 0; j < 3 * c->joint_count; ++j) {
        if (!isfinite(c->joint_centers[j])) {
            return invalid(context, "joint", j / 3);
        }
    }
    for (size_t j = 0; c->joint_parents != NULL && j < c->joint_count; ++j) {
        if (c->joint_parents[j] >= j && c->joint_parents[j] != PC_INVALID_INDEX) {
            return invalid(context, "the parent of joint", j);
        }
    }
    for (size_t i = 0; i < c->clip_count; ++i) {
        const uint32_t *range = &c->clip_poses[2 * i];
        if (range[1] == 0 || range[0] > c->pose_count || range[1] > c->pose_count - range[0] ||
            !(c->clip_rates[i] > 0.0) || !isfinite(c->clip_rates[i])) {
            return invalid(context, "clip", i);
        }
    }
    for (size_t i = 0; i < 12 * c->pose_count * c->joint_count; ++i) {
        if (!isfinite(c->poses[i])) {
            return invalid(context, "pose", i / 12 / c->joint_count);
        }
    }
    return PC_OK;
}

static pc_status check_body(pc_context *context, const pc_character *c) {
    const pc_mesh *body = &c->body;
    if ((body->vertex_count != 0 && body->positions == NULL) ||
        (body->triangle_count != 0 && (body->triangles == NULL || c->body_triangle_parts == NULL ||
                                       c->body_part_names == NULL)) ||
        (c->body_joints == NULL) != (c->body_weights == NULL)) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, module,
                        "character: a count is given without its array");
    }
    for (size_t i = 0; i < 3 * body->triangle_count; ++i) {
        if (body->triangles[i] >= body->vertex_count ||
            c->body_triangle_parts[i / 3] >= c->body_part_count) {
            return invalid(context, "triangle", i / 3);
        }
    }
    for (size_t i = 0; c->body_joints != NULL && i < 4 * body->vertex_count; ++i) {
        if (c->body_joints[i] >= c->joint_count) {
            return invalid(context, "the joint of vertex", i / 4);
        }
    }
    return PC_OK;
}

// A copy of an array; NULL for an empty one and, with *failed, when memory ran out.
static void *copy(pc_context *context, const void *source, size_t count, size_t size,
                  bool *failed) {
    if (source == NULL || count == 0) {
        return NULL;
    }
    void *made = pci_allocate(context, count, size);
    if (made == NULL) {
        *failed = true;
    } else {
        memcpy(made, source, count * size);
    }
    return made;
}

// Names with zeros behind their end, so that equal characters are equal bytes.
static char *copy_names(pc_context *context, const char *source, size_t count, bool *failed) {
    char *names = copy(context, source, count, PC_NAME_SIZE, failed);
    for (size_t i = 0; i < count && names != NULL; ++i) {
        char *name = &names[PC_NAME_SIZE * i];
        size_t length = 0;
        while (length + 1 < PC_NAME_SIZE && name[length] != '\0') {
            ++length;
        }
        memset(name + length, 0, PC_NAME_SIZE - length);
    }
    return names;
}

static void normalize_weights(float *weights, size_t count) {
    for (size_t v = 0; v < count && weights != NULL; ++v) {
        double shares[4], sum = 0.0;
        for (size_t k = 0; k < 4; ++k) {
            const double weight = (double)weights[4 * v + k];
            shares[k] = weight > 0.0 && isfinite(weight) ? weight : 0.0;
            sum += shares[k];
        }
        for (size_t k = 0; k < 4; ++k) {
            weights[4 * v + k] = sum > 0.0 ? (float)(shares[k] / sum) : 0.0F;
        }
    }
}

// Drops triangles with a corner that is not finite, and moves such corners to the origin.
static void clean_body(pc_character *character) {
    pc_mesh *body = &character->body;
    size_t kept = 0;
    for (size_t t = 0; t < body->triangle_count; ++t) {
        bool good = true;
        for (size_t k = 0; k < 9; ++k) {
            const size_t vertex = body->triangles[3 * t + k / 3];
            good = good && fabs(body->positions[3 * vertex + k % 3]) <= 1e30;
        }
        if (good) {
            memmove(&body->triangles[3 * kept], &body->triangles[3 * t], 3 * sizeof(uint32_t));
            character->body_triangle_parts[kept++] = character->body_triangle_parts[t];
        }
    }
    body->triangle_count = kept;
    for (size_t k = 0; k < 3 * body->vertex_count; ++k) {
        body->positions[k] = fabs(body->positions[k]) <= 1e30 ? body->positions[k] : 0.0;
    }
}

pc_status pc_character_create(pc_context *context, const pc_character *arrays,
                              pc_character *character) {
    static const pc_character empty;
    if (arrays == NULL || character == NULL || memcmp(character, &empty, sizeof(empty)) != 0) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, module,
                        "character: arrays and an empty output are needed");
    }
    const size_t limit = (size_t)1 << 31;
    const pc_mesh *body = &arrays->body;
    if (arrays->joint_count >= limit || arrays->clip_count >= limit ||
        arrays->pose_count >= limit || body->vertex_count >= limit ||
        body->triangle_count >= limit / 3 || arrays->body_part_count >= limit) {
        return pci_fail(context, PC_ERROR_TOO_LARGE, module, "character: more than 2^31 elements");
    }
    pc_status status = check_skeleton(context, arrays);
    if (status == PC_OK) {
        status = check_body(context, arrays);
    }
    if (status != PC_OK) {
        return status;
    }
    const size_t poses = arrays->joint_count != 0 ? arrays->pose_count : 0;
    bool failed = false;
    *character = *arrays;
    character->pose_count = poses;
    character->joint_names = copy_names(context, arrays->joint_names, arrays->joint_count, &failed);
    character->joint_centers =
        copy(context, arrays->joint_centers, arrays->joint_count, 3 * sizeof(double), &failed);
    character->joint_parents =
        copy(context, arrays->joint_parents, arrays->joint_count, sizeof(uint32_t), &failed);
    character->clip_count = poses != 0 ? arrays->clip_count : 0;
    character->clip_names = copy_names(context, arrays->clip_names, character->clip_count, &failed);
    character->clip_poses =
        copy(context, arrays->clip_poses, character->clip_count, 2 * sizeof(uint32_t), &failed);
    character->clip_rates =
        copy(context, arrays->clip_rates, character->clip_count, sizeof(double), &failed);
    character->poses =
        copy(context, arrays->poses, poses * arrays->joint_count, 12 * sizeof(float), &failed);
    character->body.positions =
        copy(context, body->positions, body->vertex_count, 3 * sizeof(double), &failed);
    character->body.triangles =
        copy(context, body->triangles, body->triangle_count, 3 * sizeof(uint32_t), &failed);
    character->body_part_names =
        copy_names(context, arrays->body_part_names, arrays->body_part_count, &failed);
    character->body_triangle_parts =
        copy(context, arrays->body_triangle_parts, body->triangle_count, sizeof(uint32_t), &failed);
    character->body_joints =
        copy(context, arrays->body_joints, body->vertex_count, 4 * sizeof(uint32_t), &failed);
    character->body_weights =
        copy(context, arrays->body_weights, body->vertex_count, 4 * sizeof(float), &failed);
    if (failed) {
        pc_character_free(context, character);
        return pci_fail_memory(context, module);
    }
    clean_body(character);
    normalize_weights(character->body_weights, body->vertex_count);
    return PC_OK;
}
