#include "proxycloth/deform.h"

#include "core/core.h"
#include "deform_kernel.h"
#include "geometry/rotation.h"
#include "geometry/topology.h"
#include "geometry/transfer.h"

static const char stage[] = "deform";

#define LARGEST_JOINT_COUNT 65536
#define LARGEST_INFLUENCES  32
#define MAP                 16  // floats of a map
#define PIECE               256 // vertices whose weights stay in the first cache for the normals

struct pc_deformer {
    size_t vertex_count, joint_count, bone_count;
    const pci_deform_kernel *kernel;
    pci_deform_rows rows; // inside of `memory`
    char *memory;
    float *joint_positions;           // #J by 3
    pc_rotation_estimator *estimator; // where normals or joints turn
    bool turning;                     // joints turn vertices, not normals only
};

// Where the parts of a pose are; pose memory may have any alignment. A map is 4 columns by 4.
typedef struct pose_parts {
    float *turns;         // #J + #B maps, of normals; NULL: nothing turns
    float *maps;          // #J + #B, of positions, `turns` where joints turn; NULL: they move only
    float *displacements; // #J by 4, where there are no maps
} pose_parts;

// Sets the parts from `start` on; returns the floats that they take.
static size_t lay_out(const pc_deformer *deformer, float *start, pose_parts *parts) {
    const size_t table = MAP * (deformer->joint_count + deformer->bone_count);
    const size_t turns = deformer->estimator != NULL ? table : 0;
    *parts = (pose_parts){.turns = turns > 0 ? start : NULL};
    if (deformer->turning) {
        parts->maps = start;
        return turns;
    }
    if (deformer->bone_count > 0) {
        parts->maps = start + turns;
        return turns + table;
    }
    parts->displacements = start + turns;
    return turns + 4 * deformer->joint_count;
}

static pose_parts parts_of(const pc_deformer *deformer, const void *pose) {
    const size_t spare = 64 - (uintptr_t)pose % 64;
    pose_parts parts;
    (void)lay_out(deformer, (float *)(void *)((char *)(uintptr_t)pose + spare), &parts);
    return parts;
}

size_t pc_deform_pose_size(const pc_deformer *deformer) {
    float origin = 0.0F;
    pose_parts parts;
    return 64 + sizeof(float) * lay_out(deformer, &origin, &parts);
}

size_t pc_deform_vertex_count(const pc_deformer *deformer) { return deformer->vertex_count; }

// ---- preparation --------------------------------------------------------------------------------

static bool all_finite(const float *values, size_t count) {
    for (size_t i = 0; i < count; ++i) {
        if (!isfinite(values[i])) {
            return false;
        }
    }
    return true;
}

static pc_status check_arrays(pc_context *context, const pc_deform_arrays *a) {
    if (a == NULL || a->vertex_count == 0 || a->joint_count == 0 || a->influences == 0 ||
        a->positions == NULL || a->joints == NULL || a->weights == NULL ||
        a->joint_positions == NULL || (a->triangle_count > 0 && a->triangles == NULL)) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "%s: an array is NULL or there is no vertex, joint or influence", stage);
    }
    if (a->skinning > PC_SKINNING_ROTATION) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage, "%s: there is no skinning %u",
                        stage, a->skinning);
    }
    if (a->joint_count > LARGEST_JOINT_COUNT ||
        a->bone_count > LARGEST_JOINT_COUNT - a->joint_count ||
        a->influences > LARGEST_INFLUENCES || a->vertex_count > INT32_MAX ||
        a->triangle_count > INT32_MAX / 3) {
        return pci_fail(context, PC_ERROR_TOO_LARGE, stage,
                        "%s: %zu vertices, %zu joints, %zu bones, %u influences; the limits are "
                        "2^31, %d together, %d",
                        stage, a->vertex_count, a->joint_count, a->bone_count, a->influences,
                        LARGEST_JOINT_COUNT, LARGEST_INFLUENCES);
    }
    if (!all_finite(a->positions, 3 * a->vertex_count) ||
        (a->normals != NULL && !all_finite(a->normals, 3 * a->vertex_count)) ||
        !all_finite(a->joint_positions, 3 * a->joint_count)) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "%s: a position or normal is not finite", stage);
    }
    for (size_t i = 0; i < 3 * a->triangle_count; ++i) {
        if (a->triangles[i] >= a->joint_count) {
            return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                            "%s: triangle %zu uses joint %u of %zu", stage, i / 3, a->triangles[i],
                            a->joint_count);
        }
    }
    return PC_OK;
}

// Fills the blocks: positions, weights scaled to the sum 1; spare slots repeat the first joint.
static pc_status pack_blocks(pc_context *context, const pc_deform_arrays *a,
                             const pci_deform_rows *rows, char *start) {
    const size_t joint_count = a->joint_count + a->bone_count;
    for (size_t v = 0; v < a->vertex_count; ++v) {
        const float *weights = &a->weights[v * a->influences];
        const uint32_t *joints = &a->joints[v * a->influences];
        double sum = 0.0;
        for (uint32_t k = 0; k < a->influences; ++k) {
            if (!(weights[k] >= 0.0F) || joints[k] >= joint_count) {
                return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                                "%s: vertex %zu has weight %g for joint %u of %zu", stage, v,
                                (double)weights[k], joints[k], joint_count);
            }
            sum += (double)weights[k];
        }
        if (!(sum > 0.0) || !isfinite(sum)) {
            return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                            "%s: the weights of vertex %zu have the sum %g", stage, v, sum);
        }
        char *block = start + v / PCI_DEFORM_BLOCK * pci_deform_block_bytes(rows);
        const size_t slot = v % PCI_DEFORM_BLOCK * PCI_DEFORM_SET;
        memcpy(block + 12 * (v % PCI_DEFORM_BLOCK), &a->positions[3 * v], 12);
        for (size_t k = 0; k < PCI_DEFORM_SET * rows->set_count; ++k) {
            char *set = block + PCI_DEFORM_REST + k / PCI_DEFORM_SET * PCI_DEFORM_SET_BYTES;
            const bool used = k < a->influences && weights[k] > 0.0F;
            const size_t at = slot + k % PCI_DEFORM_SET;
            ((float *)(void *)set)[at] = used ? (float)((double)weights[k] / sum) : 0.0F;
            ((uint16_t *)(void *)(set + PCI_DEFORM_WEIGHTS))[at] = (uint16_t)joints[used ? k : 0];
        }
    }
    return PC_OK;
}

// What the rotations of the joints are found with.
static pc_status build_estimator(pc_context *context, const pc_deform_arrays *a,
                                 pc_rotation_estimator **estimator) {
    pci_scratch scratch = pci_scratch_begin(context);
    pc_mesh proxy = {.vertex_count = a->joint_count, .triangle_count = a->triangle_count};
    proxy.positions = PCI_SCRATCH(&scratch, double, 3 * a->joint_count);
    proxy.triangles = PCI_SCRATCH(&scratch, uint32_t, 3 * a->triangle_count);
    pc_status status = scratch.failed ? pci_fail_memory(context, stage) : PC_OK;
    if (status == PC_OK) {
        for (size_t i = 0; i < 3 * a->joint_count; ++i) {
            proxy.positions[i] = (double)a->joint_positions[i];
        }
        if (a->triangle_count > 0) {
            memcpy(proxy.triangles, a->triangles, 3 * a->triangle_count * sizeof(uint32_t));
        }
        status = pci_rotation_prepare(context, stage, &proxy, a->pinned, estimator);
    }
    pci_scratch_end(&scratch);
    return status;
}

// The kernel of the best instruction set of this processor.
static const pci_deform_kernel *best_kernel(void) {
#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx512f")) {
        return &pci_deform_avx512;
    }
    if (__builtin_cpu_supports("avx2")) {
        return &pci_deform_avx2;
    }
#endif
    return &pci_deform_generic;
}

static pc_status fill(pc_context *context, const pc_deform_arrays *a, pc_deformer *deformer) {
    const size_t blocks = (a->vertex_count + PCI_DEFORM_BLOCK - 1) / PCI_DEFORM_BLOCK;
    const bool normals = a->normals != NULL;
    deformer->turning = a->skinning == PC_SKINNING_ROTATION;
    deformer->vertex_count = a->vertex_count;
    deformer->joint_count = a->joint_count;
    deformer->bone_count = a->bone_count;
    deformer->kernel = best_kernel();
    deformer->rows.set_count = (a->influences + PCI_DEFORM_SET - 1) / PCI_DEFORM_SET;
    const size_t bytes = blocks * pci_deform_block_bytes(&deformer->rows);
    deformer->memory =
        PCI_ALLOCATE(context, char, 64 + bytes + (normals ? blocks * PCI_DEFORM_REST : 0));
    deformer->joint_positions = PCI_ALLOCATE(context, float, 3 * a->joint_count);
    if (deformer->memory == NULL || deformer->joint_positions == NULL) {
        return pci_fail_memory(context, stage);
    }
    char *start = deformer->memory + (64 - (uintptr_t)deformer->memory % 64);
    deformer->rows.blocks = start;
    memcpy(deformer->joint_positions, a->joint_positions, 3 * a->joint_count * sizeof(float));
    const pc_status status = pack_blocks(context, a, &deformer->rows, start);
    if (status == PC_OK && normals) {
        deformer->rows.normals = start + bytes;
        memcpy(start + bytes, a->normals, 3 * a->vertex_count * sizeof(float));
    }
    return status == PC_OK && (normals || deformer->turning)
               ? build_estimator(context, a, &deformer->estimator)
               : status;
}

pc_status pc_deform_prepare(pc_context *context, const pc_deform_arrays *arrays,
                            pc_deformer **deformer) {
    if (deformer == NULL) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage, "%s: the output is NULL", stage);
    }
    *deformer = NULL;
    pc_status status = check_arrays(context, arrays);
    if (status != PC_OK) {
        return status;
    }
    pc_deformer *made = PCI_ALLOCATE(context, pc_deformer, 1);
    if (made == NULL) {
        return pci_fail_memory(context, stage);
    }
    status = fill(context, arrays, made);
    if (status != PC_OK) {
        pc_deform_destroy(context, made);
        return status;
    }
    *deformer = made;
    return PC_OK;
}

void pc_deform_destroy(pc_context *context, pc_deformer *deformer) {
    if (deformer == NULL) {
        return;
    }
    pc_release(context, deformer->memory);
    pc_release(context, deformer->joint_positions);
    pc_rotation_estimator_destroy(context, deformer->estimator);
    pc_release(context, deformer);
}

// The arrays of an asset whose visual mesh has the weights `skin`.
static pc_status prepare_asset(pc_context *context, const pc_asset *asset, const pc_skin *skin,
                               size_t bone_count, pci_scratch *scratch, pc_deformer **deformer) {
    const pc_visual *visual = &asset->visual;
    const size_t count = visual->corner_count, joint_count = asset->proxy.vertex_count;
    const uint32_t influences = skin->influences;
    float *positions = PCI_SCRATCH(scratch, float, 3 * count);
    float *normals = PCI_SCRATCH(scratch, float, 3 * count);
    uint32_t *joints = PCI_SCRATCH(scratch, uint32_t, count * influences);
    float *weights = PCI_SCRATCH(scratch, float, count *influences);
    float *joint_positions = PCI_SCRATCH(scratch, float, 3 * joint_count);
    double *smooth = PCI_SCRATCH(scratch, double, 3 * visual->surface.vertex_count);
    if (scratch->failed) {
        return pci_fail_memory(context, stage);
    }
    pci_vertex_normals(&visual->surface, smooth);
    for (size_t c = 0; c < count; ++c) {
        const size_t v = visual->corner_vertices[c];
        const float *given = visual->normals != NULL ? &visual->normals[3 * c] : NULL;
        for (size_t k = 0; k < 3; ++k) {
            positions[3 * c + k] = (float)visual->surface.positions[3 * v + k];
            normals[3 * c + k] = given != NULL ? given[k] : (float)smooth[3 * v + k];
        }
        for (uint32_t k = 0; k < influences; ++k) {
            joints[c * influences + k] = skin->bones[v * influences + k];
            weights[c * influences + k] = (float)skin->weights[v * influences + k];
        }
    }
    for (size_t i = 0; i < 3 * joint_count; ++i) {
        joint_positions[i] = (float)asset->proxy.positions[i];
    }
    const pc_deform_arrays arrays = {
        .vertex_count = count,
        .positions = positions,
        .normals = normals,
        .influences = influences,
        .joints = joints,
        .weights = weights,
        .joint_count = joint_count,
        .bone_count = bone_count,
        .joint_positions = joint_positions,
        .triangle_count = asset->proxy.triangle_count,
        .triangles = asset->proxy.triangles,
        .skinning = skin->skinning,
        .pinned = skin->skinning == PC_SKINNING_ROTATION ? asset->motion.pinned : NULL};
    return pc_deform_prepare(context, &arrays, deformer);
}

pc_status pc_deform_prepare_asset(pc_context *context, const pc_asset *asset,
                                  pc_deformer **deformer) {
    if (asset == NULL || deformer == NULL || asset->stage_count < PC_STAGE_COUNT ||
        asset->skin.vertex_count != asset->visual.surface.vertex_count) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "%s: an asset with all stages done is needed", stage);
    }
    *deformer = NULL;
    pc_body_skin body = {0};
    pc_status status =
        pc_body_skin_create(context, &asset->visual, &asset->character, &asset->proxy,
                            &asset->motion, &asset->options.skin, &body, NULL);
    if (status == PC_OK) {
        pci_scratch scratch = pci_scratch_begin(context);
        pc_skin skin = asset->skin;
        const size_t bones = body.vertex_count > 0 ? asset->character.joint_count : 0;
        status = pci_mix_weights(&scratch, &body, asset->proxy.vertex_count, &skin)
                     ? prepare_asset(context, asset, &skin, bones, &scratch, deformer)
                     : pci_fail_memory(context, stage);
        pci_scratch_end(&scratch);
    }
    pc_body_skin_free(context, &body);
    return status;
}

// ---- every frame --------------------------------------------------------------------------------

static inline const float *joint_at(const float *joints, size_t stride, size_t joint) {
    return (const float *)(const void *)((const char *)joints + joint * stride);
}

// Columns of the rotation, then zeros.
static void put_columns(void *result, const double rotation[9]) {
    float *columns = result;
    for (size_t k = 0; k < 3; ++k) {
        columns[4 * k] = (float)rotation[k];
        columns[4 * k + 1] = (float)rotation[3 + k];
        columns[4 * k + 2] = (float)rotation[6 + k];
        columns[4 * k + 3] = 0.0F;
    }
    columns[12] = columns[13] = columns[14] = columns[15] = 0.0F;
}

static void put_turned(void *result, const double quaternion[4]) {
    double rotation[9];
    pci_matrix_of_quaternion(quaternion, rotation);
    put_columns(result, rotation);
}

static void put_displacements(const pc_deformer *deformer, const float *joints, size_t stride,
                              float *displacements) {
    for (size_t j = 0; j < deformer->joint_count; ++j) {
        const float *joint = joint_at(joints, stride, j);
        for (size_t k = 0; k < 3; ++k) {
            displacements[4 * j + k] = joint[k] - deformer->joint_positions[3 * j + k];
        }
        displacements[4 * j + 3] = 0.0F;
    }
}

// The linear parts of the joints' maps: as given, or as the 1-rings turn.
static void put_rotations(const pc_deformer *deformer, const pc_deform_input *input,
                          const pci_points *points, float *turns) {
    const size_t size = MAP * sizeof(float);
    if (input->rotations == NULL && deformer->turning) {
        pci_rotation_estimate(deformer->estimator, points, put_turned, turns, size);
    } else if (input->rotations == NULL) {
        pci_rotation_of_rings(deformer->estimator, points, put_columns, turns, size);
    }
    const size_t stride = input->rotation_stride != 0 ? input->rotation_stride : 4 * sizeof(float);
    for (size_t j = 0; j < deformer->joint_count && input->rotations != NULL; ++j) {
        const float *given = joint_at(input->rotations, stride, j);
        const double q[4] = {(double)given[0], (double)given[1], (double)given[2],
                             (double)given[3]};
        put_turned(&turns[MAP * j], q);
    }
}

// The last column of each joint's map: where it takes the origin.
static void put_origins(const pc_deformer *deformer, const float *joints, size_t stride,
                        float *maps) {
    for (size_t j = 0; j < deformer->joint_count; ++j) {
        const float *rest = &deformer->joint_positions[3 * j], *now = joint_at(joints, stride, j);
        float *columns = &maps[MAP * j];
        for (size_t k = 0; k < 3; ++k) {
            double at = (double)now[k];
            for (size_t c = 0; c < 3; ++c) {
                at -= (double)columns[4 * c + k] * (double)rest[c];
            }
            columns[12 + k] = (float)at;
        }
    }
}

// The maps of the bones, behind those of the joints.
static void put_bones(const pc_deformer *deformer, const pc_deform_input *input, float *maps) {
    static const float at_rest[12] = {1.0F, 0.0F, 0.0F, 0.0F, 0.0F, 1.0F,
                                      0.0F, 0.0F, 0.0F, 0.0F, 1.0F, 0.0F};
    const size_t stride = input->bone_stride != 0 ? input->bone_stride : sizeof(at_rest);
    for (size_t b = 0; b < deformer->bone_count; ++b) {
        const float *rows = input->bones != NULL ? joint_at(input->bones, stride, b) : at_rest;
        float *columns = &maps[MAP * (deformer->joint_count + b)];
        for (size_t i = 0; i < MAP; ++i) {
            columns[i] = i % 4 < 3 ? rows[4 * (i % 4) + i / 4] : 0.0F;
        }
    }
}

void pc_deform_pose(const pc_deformer *deformer, const pc_deform_input *input, void *pose) {
    static const double straight[9] = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0};
    const pose_parts parts = parts_of(deformer, pose);
    const size_t stride = input->joint_stride != 0 ? input->joint_stride : 3 * sizeof(float);
    if (parts.displacements != NULL) {
        put_displacements(deformer, input->joints, stride, parts.displacements);
    }
    if (parts.turns != NULL) {
        const pci_points points = {input->joints, stride, true};
        put_rotations(deformer, input, &points, parts.turns);
        put_bones(deformer, input, parts.turns);
    }
    if (parts.maps != NULL && parts.maps != parts.turns) {
        for (size_t j = 0; j < deformer->joint_count; ++j) {
            put_columns(&parts.maps[MAP * j], straight);
        }
        put_bones(deformer, input, parts.maps);
    }
    if (parts.maps != NULL) {
        put_origins(deformer, input->joints, stride, parts.maps);
    }
}

static void put_positions(const pc_deformer *deformer, const pose_parts *parts, size_t begin,
                          size_t end, const pc_deform_output *output, size_t stride) {
    if (parts->maps != NULL) {
        deformer->kernel->affine(&deformer->rows, parts->maps, begin, end,
                                 (char *)output->positions, stride);
    } else {
        deformer->kernel->positions(&deformer->rows, parts->displacements, begin, end,
                                    (char *)output->positions, stride);
    }
}

void pc_deform(const pc_deformer *deformer, const void *pose, size_t begin, size_t end,
               const pc_deform_output *output) {
    const pose_parts parts = parts_of(deformer, pose);
    const size_t tight = 3 * sizeof(float);
    const size_t position_stride = output->position_stride != 0 ? output->position_stride : tight;
    const size_t normal_stride = output->normal_stride != 0 ? output->normal_stride : tight;
    const pci_deform_rows *rows = &deformer->rows;
    if (output->normals == NULL) {
        put_positions(deformer, &parts, begin, end, output, position_stride);
        return;
    }
    for (size_t first = begin; first < end;) {
        const size_t next = (first / PIECE + 1) * PIECE, last = end < next ? end : next;
        put_positions(deformer, &parts, first, last, output, position_stride);
        deformer->kernel->normals(rows, parts.turns, first, last, (char *)output->normals,
                                  normal_stride);
        first = last;
    }
}
