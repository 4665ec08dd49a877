#include "proxycloth/deform.h"

#include "core/core.h"
#include "core/topology.h"
#include "deform_kernel.h"

static const char stage[] = "deform";

#define LARGEST_JOINT_COUNT 65536
#define LARGEST_INFLUENCES  32
#define PIECE               256 // vertices whose weights stay in the first cache for the normals

// An edge of a proxy vertex: where it points at rest, by coordinates in the tangent plane.
typedef struct spoke {
    uint32_t joint;
    float along, across; // over the squared length of the edge
} spoke;

struct pc_deformer {
    size_t vertex_count, joint_count, triangle_count;
    const pci_deform_kernel *kernel;
    pci_deform_rows rows; // inside of `memory`
    char *memory;
    float *joint_positions;  // #J by 3
    uint32_t *triangles;     // #triangles by 3
    uint32_t *spoke_offsets; // #J + 1
    spoke *spokes;
    float *frames; // #J by 9: tangent, second tangent, normal at rest; zero: the joint never turns
};

// Where the parts of a pose are; pose memory may have any alignment.
typedef struct pose_parts {
    float *displacements; // #J by 4
    float *rotations;     // #J by 16, only with normals
} pose_parts;

static pose_parts parts_of(const pc_deformer *deformer, const void *pose) {
    const size_t spare = 64 - (uintptr_t)pose % 64;
    float *start = (float *)(void *)((char *)(uintptr_t)pose + spare);
    const pose_parts parts = {start + 16 * deformer->joint_count, start};
    return deformer->rows.normals != NULL ? parts : (pose_parts){start, NULL};
}

size_t pc_deform_pose_size(const pc_deformer *deformer) {
    const size_t floats = deformer->rows.normals != NULL ? 20 : 4;
    return 64 + floats * sizeof(float) * deformer->joint_count;
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
    if (a->joint_count > LARGEST_JOINT_COUNT || a->influences > LARGEST_INFLUENCES ||
        a->vertex_count > INT32_MAX || a->triangle_count > INT32_MAX / 3) {
        return pci_fail(context, PC_ERROR_TOO_LARGE, stage,
                        "%s: %zu vertices, %zu joints, %u influences; the limits are 2^31, %d, %d",
                        stage, a->vertex_count, a->joint_count, a->influences, LARGEST_JOINT_COUNT,
                        LARGEST_INFLUENCES);
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
    for (size_t v = 0; v < a->vertex_count; ++v) {
        const float *weights = &a->weights[v * a->influences];
        const uint32_t *joints = &a->joints[v * a->influences];
        double sum = 0.0;
        for (uint32_t k = 0; k < a->influences; ++k) {
            if (!(weights[k] >= 0.0F) || joints[k] >= a->joint_count) {
                return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                                "%s: vertex %zu has weight %g for joint %u of %zu", stage, v,
                                (double)weights[k], joints[k], a->joint_count);
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

static void get3(const float *from, double to[3]) {
    for (size_t k = 0; k < 3; ++k) {
        to[k] = (double)from[k];
    }
}

// Tangents and normal of each proxy vertex at rest, and its edges in the tangent plane.
static pc_status build_frames(pc_context *context, const pc_deform_arrays *a,
                              pc_deformer *deformer) {
    pci_scratch scratch = pci_scratch_begin(context);
    pc_status status = PC_OK;
    pci_topology topology;
    pc_mesh proxy = {.vertex_count = a->joint_count, .triangle_count = a->triangle_count};
    proxy.positions = PCI_SCRATCH(&scratch, double, 3 * a->joint_count);
    proxy.triangles = PCI_SCRATCH(&scratch, uint32_t, 3 * a->triangle_count);
    double *normals = PCI_SCRATCH(&scratch, double, 3 * a->joint_count);
    if (scratch.failed) {
        status = pci_fail_memory(context, stage);
        goto cleanup;
    }
    for (size_t i = 0; i < 3 * a->joint_count; ++i) {
        proxy.positions[i] = (double)a->joint_positions[i];
    }
    memcpy(proxy.triangles, deformer->triangles, 3 * a->triangle_count * sizeof(uint32_t));
    if (!pci_topology_build(&scratch, &proxy, &topology)) {
        status = pci_fail_memory(context, stage);
        goto cleanup;
    }
    deformer->spoke_offsets = PCI_ALLOCATE(context, uint32_t, a->joint_count + 1);
    deformer->spokes = PCI_ALLOCATE(context, spoke, 2 * topology.edge_count);
    deformer->frames = PCI_ALLOCATE(context, float, 9 * a->joint_count);
    if (deformer->spoke_offsets == NULL || deformer->spokes == NULL || deformer->frames == NULL) {
        status = pci_fail_memory(context, stage);
        goto cleanup;
    }
    pci_vertex_normals(&proxy, normals);
    for (size_t j = 0; j < a->joint_count; ++j) {
        const double *normal = &normals[3 * j], *here = &proxy.positions[3 * j];
        const double helper[3] = {fabs(normal[0]) < 0.7 ? 1.0 : 0.0,
                                  fabs(normal[0]) < 0.7 ? 0.0 : 1.0, 0.0};
        double along[3], across[3];
        pci_cross(helper, normal, along);
        const bool good = pci_normalize(along); // false where the normal is 0
        pci_cross(normal, along, across);
        deformer->spoke_offsets[j] = (uint32_t)topology.ring_offsets[j];
        for (size_t e = topology.ring_offsets[j]; e < topology.ring_offsets[j + 1]; ++e) {
            double edge[3];
            pci_sub(&proxy.positions[3 * (size_t)topology.ring[e]], here, edge);
            const double square = pci_dot(edge, edge);
            deformer->spokes[e].joint = topology.ring[e];
            if (square > 0.0) {
                deformer->spokes[e].along = (float)(pci_dot(edge, along) / square);
                deformer->spokes[e].across = (float)(pci_dot(edge, across) / square);
            }
        }
        for (size_t k = 0; k < 3 && good; ++k) {
            deformer->frames[9 * j + k] = (float)along[k];
            deformer->frames[9 * j + 3 + k] = (float)across[k];
            deformer->frames[9 * j + 6 + k] = (float)normal[k];
        }
    }
    deformer->spoke_offsets[a->joint_count] = (uint32_t)topology.ring_offsets[a->joint_count];

cleanup:
    pci_scratch_end(&scratch);
    return status;
}

static pc_status fill(pc_context *context, const pc_deform_arrays *a, pc_deformer *deformer) {
    const size_t blocks = (a->vertex_count + PCI_DEFORM_BLOCK - 1) / PCI_DEFORM_BLOCK;
    const bool turns = a->normals != NULL;
    deformer->vertex_count = a->vertex_count;
    deformer->joint_count = a->joint_count;
    deformer->triangle_count = turns ? a->triangle_count : 0;
    deformer->kernel = pci_deform_kernel_best();
    deformer->rows.set_count = (a->influences + PCI_DEFORM_SET - 1) / PCI_DEFORM_SET;
    const size_t bytes = blocks * pci_deform_block_bytes(&deformer->rows);
    deformer->memory =
        PCI_ALLOCATE(context, char, 64 + bytes + (turns ? blocks * PCI_DEFORM_REST : 0));
    deformer->joint_positions = PCI_ALLOCATE(context, float, 3 * a->joint_count);
    deformer->triangles = PCI_ALLOCATE(context, uint32_t, 3 * deformer->triangle_count);
    if (deformer->memory == NULL || deformer->joint_positions == NULL ||
        deformer->triangles == NULL) {
        return pci_fail_memory(context, stage);
    }
    char *start = deformer->memory + (64 - (uintptr_t)deformer->memory % 64);
    deformer->rows.blocks = start;
    memcpy(deformer->joint_positions, a->joint_positions, 3 * a->joint_count * sizeof(float));
    const pc_status status = pack_blocks(context, a, &deformer->rows, start);
    if (status != PC_OK || !turns) {
        return status;
    }
    deformer->rows.normals = start + bytes;
    memcpy(start + bytes, a->normals, 3 * a->vertex_count * sizeof(float));
    if (a->triangle_count > 0) {
        memcpy(deformer->triangles, a->triangles, 3 * a->triangle_count * sizeof(uint32_t));
    }
    return build_frames(context, a, deformer);
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
    pc_release(context, deformer->triangles);
    pc_release(context, deformer->spoke_offsets);
    pc_release(context, deformer->spokes);
    pc_release(context, deformer->frames);
    pc_release(context, deformer);
}

pc_status pc_deform_prepare_asset(pc_context *context, const pc_asset *asset,
                                  pc_deformer **deformer) {
    if (asset == NULL || deformer == NULL || asset->stage_count < PC_STAGE_COUNT ||
        asset->skin.vertex_count != asset->visual.surface.vertex_count) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "%s: an asset with all stages done is needed", stage);
    }
    const pc_visual *visual = &asset->visual;
    const pc_skin *skin = &asset->skin;
    const size_t count = visual->corner_count, joint_count = asset->proxy.vertex_count;
    const uint32_t influences = skin->influences;
    pci_scratch scratch = pci_scratch_begin(context);
    float *positions = PCI_SCRATCH(&scratch, float, 3 * count);
    float *normals = PCI_SCRATCH(&scratch, float, 3 * count);
    uint32_t *joints = PCI_SCRATCH(&scratch, uint32_t, count * influences);
    float *weights = PCI_SCRATCH(&scratch, float, count *influences);
    float *joint_positions = PCI_SCRATCH(&scratch, float, 3 * joint_count);
    double *smooth = PCI_SCRATCH(&scratch, double, 3 * visual->surface.vertex_count);
    if (scratch.failed) {
        pci_scratch_end(&scratch);
        *deformer = NULL;
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
    const pc_deform_arrays arrays = {.vertex_count = count,
                                     .positions = positions,
                                     .normals = normals,
                                     .influences = influences,
                                     .joints = joints,
                                     .weights = weights,
                                     .joint_count = joint_count,
                                     .joint_positions = joint_positions,
                                     .triangle_count = asset->proxy.triangle_count,
                                     .triangles = asset->proxy.triangles};
    const pc_status status = pc_deform_prepare(context, &arrays, deformer);
    pci_scratch_end(&scratch);
    return status;
}

// ---- every frame --------------------------------------------------------------------------------

const pci_deform_kernel *pci_deform_kernel_best(void) {
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

static inline const float *joint_at(const float *joints, size_t stride, size_t joint) {
    return (const float *)(const void *)((const char *)joints + joint * stride);
}

// Area vectors of the triangles, summed up in the first column of each joint's rotation.
static void sum_areas(const pc_deformer *deformer, const float *joints, size_t stride,
                      float *rotations) {
    for (size_t t = 0; t < deformer->triangle_count; ++t) {
        const uint32_t *corner = &deformer->triangles[3 * t];
        const float *a = joint_at(joints, stride, corner[0]);
        const float *b = joint_at(joints, stride, corner[1]);
        const float *c = joint_at(joints, stride, corner[2]);
        const float p[3] = {b[0] - a[0], b[1] - a[1], b[2] - a[2]};
        const float q[3] = {c[0] - a[0], c[1] - a[1], c[2] - a[2]};
        const float area[3] = {p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2],
                               p[0] * q[1] - p[1] * q[0]};
        for (size_t i = 0; i < 3; ++i) {
            float *sum = &rotations[16 * (size_t)corner[i]];
            sum[0] += area[0], sum[1] += area[1], sum[2] += area[2];
        }
    }
}

// The rotation of one joint, by columns; its area vector comes in the first column.
static void turn_joint(const pc_deformer *deformer, const float *joints, size_t stride,
                       size_t joint, float *columns) {
    const float *here = joint_at(joints, stride, joint), *rest = &deformer->frames[9 * joint];
    double normal[3], along[3] = {0.0}, across[3] = {0.0}, tangent[3], second[3];
    get3(columns, normal);
    memset(columns, 0, 16 * sizeof(*columns));
    const bool flat = !pci_normalize(normal);
    for (size_t e = deformer->spoke_offsets[joint]; e < deformer->spoke_offsets[joint + 1]; ++e) {
        const spoke *s = &deformer->spokes[e];
        const float *there = joint_at(joints, stride, s->joint);
        for (size_t k = 0; k < 3; ++k) {
            const double edge = (double)(there[k] - here[k]);
            along[k] += (double)s->along * edge;
            across[k] += (double)s->across * edge;
        }
    }
    // Within the plane the rotation that turns both least-squares sums best: a tangent of
    // along + across x normal.
    pci_cross(across, normal, tangent);
    const double height = pci_dot(along, normal);
    for (size_t k = 0; k < 3; ++k) {
        tangent[k] += along[k] - height * normal[k];
    }
    const bool still = rest[0] == 0.0F && rest[1] == 0.0F && rest[2] == 0.0F;
    if (flat || still || !pci_normalize(tangent)) {
        columns[0] = columns[5] = columns[10] = 1.0F;
        return;
    }
    pci_cross(normal, tangent, second);
    for (size_t k = 0; k < 3; ++k) {
        for (size_t i = 0; i < 3; ++i) {
            columns[4 * k + i] =
                (float)(tangent[i] * (double)rest[k] + second[i] * (double)rest[3 + k] +
                        normal[i] * (double)rest[6 + k]);
        }
    }
}

void pc_deform_pose(const pc_deformer *deformer, const float *joints, size_t stride, void *pose) {
    const pose_parts parts = parts_of(deformer, pose);
    stride = stride != 0 ? stride : 3 * sizeof(float);
    for (size_t j = 0; j < deformer->joint_count; ++j) {
        const float *joint = joint_at(joints, stride, j);
        float *displacement = &parts.displacements[4 * j];
        for (size_t k = 0; k < 3; ++k) {
            displacement[k] = joint[k] - deformer->joint_positions[3 * j + k];
        }
        displacement[3] = 0.0F;
    }
    if (deformer->rows.normals == NULL) {
        return;
    }
    memset(parts.rotations, 0, 16 * sizeof(float) * deformer->joint_count);
    sum_areas(deformer, joints, stride, parts.rotations);
    for (size_t j = 0; j < deformer->joint_count; ++j) {
        turn_joint(deformer, joints, stride, j, &parts.rotations[16 * j]);
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
        deformer->kernel->positions(rows, parts.displacements, begin, end,
                                    (char *)output->positions, position_stride);
        return;
    }
    for (size_t first = begin; first < end;) {
        const size_t next = (first / PIECE + 1) * PIECE, last = end < next ? end : next;
        deformer->kernel->positions(rows, parts.displacements, first, last,
                                    (char *)output->positions, position_stride);
        deformer->kernel->normals(rows, parts.rotations, first, last, (char *)output->normals,
                                  normal_stride);
        first = last;
    }
}
