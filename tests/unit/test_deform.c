#define _POSIX_C_SOURCE 200809L
#include "deform_kernel.h"
#include "geometry/rotation.h"
#include "geometry/topology.h"
#include "support/character_fixture.h"
#include "support/glb.h"
#include "support/memory.h"

static char folder[64], path[64], other_path[64];

// ---- made-up garments ---------------------------------------------------------------------------

enum { JOINTS = 37, VERTICES_MAX = 700, INFLUENCES_MAX = 32 };

typedef struct sample {
    float positions[3 * VERTICES_MAX], normals[3 * VERTICES_MAX];
    uint32_t joints[INFLUENCES_MAX * VERTICES_MAX];
    float weights[INFLUENCES_MAX * VERTICES_MAX];
    float rest[3 * JOINTS], moved[3 * JOINTS];
    uint32_t triangles[3 * (JOINTS - 2)];
    pc_deform_arrays arrays;
} sample;

static float between(uint64_t stream, size_t i, double low, double high) {
    return (float)(low + (high - low) * pci_random(7, stream, i));
}

// Random numbers everywhere; some weights are 0, a row in five has a single one.
static sample *make_sample(size_t vertex_count, uint32_t influences) {
    sample *s = calloc(1, sizeof(*s));
    assert_non_null(s);
    for (size_t i = 0; i < 3 * vertex_count; ++i) {
        s->positions[i] = between(1, i, -1.0, 1.0);
        s->normals[i] = between(2, i, -1.0, 1.0);
    }
    for (size_t i = 0; i < influences * vertex_count; ++i) {
        const bool lonely = i / influences % 5 == 3 && i % influences > 0;
        s->joints[i] = (uint32_t)(pci_random_bits(7, 3, i) % JOINTS);
        s->weights[i] = lonely ? 0.0F : between(4, i, 0.0, 1.0) + (i % influences == 0 ? 0.1F : 0);
    }
    for (size_t i = 0; i < 3 * JOINTS; ++i) {
        s->rest[i] = between(5, i, -1.0, 1.0);
        s->moved[i] = s->rest[i] + between(6, i, -0.5, 0.5);
    }
    for (uint32_t t = 0; t + 2 < JOINTS; ++t) {
        s->triangles[3 * t] = t, s->triangles[3 * t + 1] = t + 1, s->triangles[3 * t + 2] = t + 2;
    }
    const pc_deform_arrays arrays = {.vertex_count = vertex_count,
                                     .positions = s->positions,
                                     .normals = s->normals,
                                     .influences = influences,
                                     .joints = s->joints,
                                     .weights = s->weights,
                                     .joint_count = JOINTS,
                                     .joint_positions = s->rest,
                                     .triangle_count = JOINTS - 2,
                                     .triangles = s->triangles};
    s->arrays = arrays;
    return s;
}

// Equation (6) in double.
static void expected_position(const sample *s, size_t v, double out[3]) {
    double sum = 0.0, moved[3] = {0.0};
    for (uint32_t k = 0; k < s->arrays.influences; ++k) {
        const size_t slot = v * s->arrays.influences + k, joint = s->joints[slot];
        const double w = (double)s->weights[slot];
        sum += w;
        for (size_t c = 0; c < 3; ++c) {
            moved[c] += w * ((double)s->moved[3 * joint + c] - (double)s->rest[3 * joint + c]);
        }
    }
    for (size_t c = 0; c < 3; ++c) {
        out[c] = (double)s->positions[3 * v + c] + moved[c] / sum;
    }
}

static void *make_pose(const pc_deformer *deformer, const float *joints, size_t misplaced) {
    char *memory = malloc(pc_deform_pose_size(deformer) + misplaced);
    assert_non_null(memory);
    pc_deform_pose(deformer, &(pc_deform_input){.joints = joints}, memory + misplaced);
    return memory;
}

// ---- positions ----------------------------------------------------------------------------------

// All numbers of influences, vertex counts around the width of the registers, any alignment of the
// pose, tight and interleaved output whose other bytes stay.
static void positions_are_equation_6(void **state) {
    (void)state;
    static const uint32_t influences[] = {1, 2, 3, 4, 5, 8, 12, 32};
    static const size_t counts[] = {1, 2, 3, 4, 5, 7, 8, 37, 700};
    pc_context *context = test_context(1);
    for (size_t i = 0; i < 8 * 9; ++i) {
        const size_t count = counts[i / 8];
        sample *s = make_sample(count, influences[i % 8]);
        pc_deformer *deformer = NULL;
        assert_ok(context, pc_deform_prepare(context, &s->arrays, &deformer));
        assert_int_equal(pc_deform_vertex_count(deformer), count);
        void *pose = make_pose(deformer, s->moved, 4 * (i % 16));
        float tight[3 * VERTICES_MAX], wide[8 * VERTICES_MAX];
        for (size_t k = 0; k < 8 * VERTICES_MAX; ++k) {
            wide[k] = 77.0F;
        }
        const void *at = (const char *)pose + 4 * (i % 16);
        pc_deform(deformer, at, 0, count, &(pc_deform_output){.positions = tight});
        pc_deform(deformer, at, 0, count,
                  &(pc_deform_output){.positions = wide + 1, .position_stride = 32});
        for (size_t v = 0; v < count; ++v) {
            double expected[3];
            expected_position(s, v, expected);
            for (size_t c = 0; c < 3; ++c) {
                assert_close((double)tight[3 * v + c], expected[c], 1e-6);
                assert_true(tight[3 * v + c] == wide[8 * v + 1 + c]);
            }
        }
        for (size_t k = 0; k < 8 * VERTICES_MAX; ++k) {
            const bool written = k / 8 < count && k % 8 >= 1 && k % 8 < 4;
            assert_true(written || wide[k] == 77.0F);
        }
        free(pose);
        pc_deform_destroy(context, deformer);
        free(s);
    }
    pc_context_destroy(context);
}

typedef struct range_job {
    const pc_deformer *deformer;
    const void *pose;
    pc_deform_output output;
} range_job;

static void deform_range(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const range_job *job = user;
    pc_deform(job->deformer, job->pose, begin, end, &job->output);
}

// One deformer, one pose, many threads with odd ranges: the bytes of a single call.
static void ranges_and_threads_give_the_same_bytes(void **state) {
    (void)state;
    static const uint32_t threads[] = {1, 2, 3, 8};
    static float whole[6 * VERTICES_MAX], parts[6 * VERTICES_MAX];
    sample *s = make_sample(VERTICES_MAX, 8);
    for (size_t i = 0; i < 4; ++i) {
        pc_context *context = test_context(threads[i]);
        pc_deformer *deformer = NULL;
        assert_ok(context, pc_deform_prepare(context, &s->arrays, &deformer));
        void *pose = make_pose(deformer, s->moved, 0);
        range_job job = {deformer, pose, {whole, 24, whole + 3, 24}};
        deform_range(&job, 0, VERTICES_MAX, 0);
        job.output.positions = parts;
        job.output.normals = parts + 3;
        for (size_t grain = 1; grain < 40; grain += 6) {
            memset(parts, 0, sizeof(parts));
            pci_parallel_for(context, VERTICES_MAX, grain, deform_range, &job);
            assert_memory_equal(whole, parts, sizeof(whole));
        }
        free(pose);
        pc_deform_destroy(context, deformer);
        pc_context_destroy(context);
    }
    free(s);
}

// Every kernel that this processor can run gives the bits of the plain one.
static void kernels_agree_bit_by_bit(void **state) {
    (void)state;
    const pci_deform_kernel *kernels[3] = {&pci_deform_generic};
    size_t kernel_count = 1;
#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx2")) {
        kernels[kernel_count++] = &pci_deform_avx2;
    }
    if (__builtin_cpu_supports("avx512f")) {
        kernels[kernel_count++] = &pci_deform_avx512;
    }
#endif
    enum { COUNT = 103, BLOCKS = 7, SETS = 3 };
    const size_t room = BLOCKS * (PCI_DEFORM_REST + SETS * PCI_DEFORM_SET_BYTES);
    char *blocks = aligned_alloc(64, room), *rest = aligned_alloc(64, BLOCKS * PCI_DEFORM_REST);
    float *table = aligned_alloc(64, 16 * JOINTS * sizeof(float));
    for (size_t i = 0; i < 16 * JOINTS; ++i) {
        table[i] = between(4, i, -1.0, 1.0);
    }
    for (size_t i = 0; i < 3 * COUNT; ++i) {
        ((float *)(void *)rest)[i] = between(3, i, -1.0, 1.0);
    }
    for (size_t sets = 1; sets <= SETS; ++sets) {
        const pci_deform_rows rows = {blocks, sets, rest};
        const size_t size = pci_deform_block_bytes(&rows);
        for (size_t b = 0; b < BLOCKS; ++b) {
            for (size_t i = 0; i < size / 4; ++i) {
                const size_t at = 4 * i % PCI_DEFORM_SET_BYTES;
                const bool joints =
                    4 * i >= PCI_DEFORM_REST &&
                    (4 * i - PCI_DEFORM_REST) % PCI_DEFORM_SET_BYTES >= PCI_DEFORM_WEIGHTS;
                const uint16_t pair[2] = {(uint16_t)((at + b) % JOINTS),
                                          (uint16_t)((7 * at + 3 * b) % JOINTS)};
                const float weight = between(b, i, 0.0, 0.3);
                memcpy(blocks + b * size + 4 * i, joints ? (const void *)pair : &weight, 4);
            }
        }
        for (size_t end = COUNT - 18; end <= COUNT; ++end) {
            for (size_t stride = 12; stride <= 32; stride += 20) {
                static float expected[3][8 * COUNT], found[3][8 * COUNT];
                for (size_t k = 0; k < kernel_count; ++k) {
                    memset(found, 0, sizeof(found));
                    kernels[k]->positions(&rows, table, 5, end, (char *)found[0], stride);
                    kernels[k]->normals(&rows, table, 5, end, (char *)found[1], stride);
                    kernels[k]->affine(&rows, table, 5, end, (char *)found[2], stride);
                    if (k == 0) {
                        memcpy(expected, found, sizeof(found));
                    }
                    assert_memory_equal(expected, found, sizeof(found));
                }
            }
        }
    }
    free(table);
    free(blocks);
    free(rest);
}

// ---- normals ------------------------------------------------------------------------------------

static void rotate(const double axis[3], double angle, const double in[3], double out[3]) {
    double cross[3];
    pci_cross(axis, in, cross);
    for (size_t k = 0; k < 3; ++k) {
        out[k] = in[k] * cos(angle) + cross[k] * sin(angle) +
                 axis[k] * pci_dot(axis, in) * (1.0 - cos(angle));
    }
}

// A rigid motion turns every normal exactly, whatever the weights and the shape of the proxy.
static void rigid_motion_turns_normals(void **state) {
    (void)state;
    const double axis[3] = {2.0 / 3.0, -1.0 / 3.0, 2.0 / 3.0};
    pc_context *context = test_context(1);
    sample *s = make_sample(200, 5);
    pc_deformer *deformer = NULL;
    assert_ok(context, pc_deform_prepare(context, &s->arrays, &deformer));
    for (double angle = 0.0; angle < 6.4; angle += 0.7853981633974483) {
        float joints[4 * JOINTS], positions[600], normals[600];
        for (size_t j = 0; j < JOINTS; ++j) {
            const double p[3] = {(double)s->rest[3 * j], (double)s->rest[3 * j + 1],
                                 (double)s->rest[3 * j + 2]};
            double turned[3];
            rotate(axis, angle, p, turned);
            for (size_t k = 0; k < 3; ++k) {
                joints[4 * j + k] = (float)turned[k] + 3.0F;
            }
        }
        void *pose = malloc(pc_deform_pose_size(deformer));
        pc_deform_pose(deformer, &(pc_deform_input){.joints = joints, .joint_stride = 16}, pose);
        pc_deform(deformer, pose, 0, 200,
                  &(pc_deform_output){.positions = positions, .normals = normals});
        for (size_t v = 0; v < 200; ++v) {
            double n[3] = {(double)s->normals[3 * v], (double)s->normals[3 * v + 1],
                           (double)s->normals[3 * v + 2]};
            double expected[3];
            pci_normalize(n);
            rotate(axis, angle, n, expected);
            for (size_t k = 0; k < 3; ++k) {
                assert_close((double)normals[3 * v + k], expected[k], 2e-5);
            }
        }
        free(pose);
    }
    pc_deform_destroy(context, deformer);
    pc_context_destroy(context);
    free(s);
}

// A flat sheet rolled into most of a cylinder, driven bilinearly by a grid of 17 by 5 vertices: the
// normals are those of the cylinder within the angle of half a cell.
static void bending_turns_normals(void **state) {
    (void)state;
    enum { NX = 17, NY = 5, FINE = 10, COUNT = (NX - 1) * FINE };
    static float rest[3 * NX * NY], rolled[3 * NX * NY];
    static uint32_t triangles[6 * (NX - 1) * (NY - 1)];
    static float positions[3 * COUNT], normals[3 * COUNT], weights[2 * COUNT];
    static uint32_t joints[2 * COUNT];
    const double turn = 5.0; // radians along the sheet of length 1
    uint32_t *corner = triangles;
    for (uint32_t j = 0; j < NX * NY; ++j) {
        const double x = (double)(j % NX) / (NX - 1), y = (double)(j / NX) / (NX - 1);
        rest[3 * j] = (float)x, rest[3 * j + 1] = (float)y;
        rolled[3 * j] = (float)(sin(turn * x) / turn);
        rolled[3 * j + 1] = (float)y;
        rolled[3 * j + 2] = (float)((1.0 - cos(turn * x)) / turn);
        if (j % NX + 1 < NX && j / NX + 1 < NY) {
            const uint32_t quad[6] = {j, j + 1, j + NX + 1, j, j + NX + 1, j + NX};
            memcpy(corner, quad, sizeof(quad));
            corner += 6;
        }
    }
    for (size_t v = 0; v < COUNT; ++v) {
        const uint32_t cell = (uint32_t)(v / FINE), row = 2 * NX;
        const float t = ((float)(v % FINE) + 0.5F) / FINE;
        positions[3 * v] = ((float)cell + t) / (NX - 1);
        positions[3 * v + 1] = 2.0F / (NX - 1);
        normals[3 * v + 2] = 1.0F;
        joints[2 * v] = row + cell, joints[2 * v + 1] = row + cell + 1;
        weights[2 * v] = 1.0F - t, weights[2 * v + 1] = t;
    }
    const pc_deform_arrays arrays = {.vertex_count = COUNT,
                                     .positions = positions,
                                     .normals = normals,
                                     .influences = 2,
                                     .joints = joints,
                                     .weights = weights,
                                     .joint_count = NX * NY,
                                     .joint_positions = rest,
                                     .triangle_count = sizeof(triangles) / 12,
                                     .triangles = triangles};
    pc_context *context = test_context(1);
    pc_deformer *deformer = NULL;
    assert_ok(context, pc_deform_prepare(context, &arrays, &deformer));
    void *pose = make_pose(deformer, rolled, 0);
    static float out[3 * COUNT], turned[3 * COUNT];
    pc_deform(deformer, pose, 0, COUNT, &(pc_deform_output){.positions = out, .normals = turned});
    double worst = 0.0;
    for (size_t v = 0; v < COUNT; ++v) {
        const double angle = turn * (double)positions[3 * v];
        const double cosine =
            -sin(angle) * (double)turned[3 * v] + cos(angle) * (double)turned[3 * v + 2];
        worst = fmax(worst, acos(fmin(cosine, 1.0)));
    }
    assert_true(worst < 0.5 * turn / (NX - 1));
    free(pose);
    pc_deform_destroy(context, deformer);
    pc_context_destroy(context);
}

// Linear blend skinning in double, with rotations that the caller gives or that the estimator
// finds; normals by the same rotations. Vertices of one joint turn rigidly.
static void joints_turn_positions(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    for (size_t i = 0; i < 12; ++i) {
        sample *s = make_sample(53, i % 3 == 0 ? 1 : (uint32_t)(3 * (i % 3)));
        s->arrays.skinning = PC_SKINNING_ROTATION;
        s->arrays.normals = i % 2 == 0 ? s->normals : NULL;
        double rest[3 * JOINTS], moved[3 * JOINTS], found[4 * JOINTS];
        float rotations[8 * JOINTS] = {0.0F};
        for (size_t k = 0; k < 3 * JOINTS; ++k) {
            rest[k] = (double)s->rest[k], moved[k] = (double)s->moved[k];
        }
        const pc_mesh proxy = {JOINTS, rest, JOINTS - 2, s->triangles};
        pc_rotation_estimator *estimator = NULL;
        assert_ok(context, pc_rotation_estimator_create(context, &proxy, NULL, &estimator));
        pc_rotation_estimate(estimator, moved, found);
        for (size_t k = 0; k < 4 * JOINTS && i >= 6; ++k) {
            found[k] = (double)between(i, k, -1.0, 1.0);
        }
        for (size_t j = 0; j < JOINTS; ++j) {
            double *q = &found[4 * j];
            const double length = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
            for (size_t k = 0; k < 4; ++k) {
                q[k] /= length;
                rotations[8 * j + k] = (float)q[k];
            }
        }
        pc_deformer *deformer = NULL;
        assert_ok(context, pc_deform_prepare(context, &s->arrays, &deformer));
        void *pose = make_pose(deformer, s->moved, 0);
        if (i >= 6) {
            const pc_deform_input given = {
                .joints = s->moved, .rotations = rotations, .rotation_stride = 32};
            pc_deform_pose(deformer, &given, pose);
        }
        float out[3 * 53], normals[3 * 53];
        pc_deform(deformer, pose, 0, 53,
                  &(pc_deform_output){.positions = out, .normals = i % 2 == 0 ? normals : NULL});
        for (size_t v = 0; v < 53; ++v) {
            double sum = 0.0, expected[3] = {0.0}, normal[3] = {0.0}, r[9];
            for (size_t k = v * s->arrays.influences; k < (v + 1) * s->arrays.influences; ++k) {
                const size_t joint = s->joints[k];
                pci_matrix_of_quaternion(&found[4 * joint], r);
                for (size_t c = 0; c < 9; ++c) {
                    const double w = (double)s->weights[k];
                    expected[c / 3] +=
                        w * r[c] * ((double)s->positions[3 * v + c % 3] - rest[3 * joint + c % 3]);
                    expected[c / 3] += c % 3 == 0 ? w * moved[3 * joint + c / 3] : 0.0;
                    normal[c / 3] += w * r[c] * (double)s->normals[3 * v + c % 3];
                }
                sum += (double)s->weights[k];
            }
            const double length = pci_norm(normal);
            for (size_t c = 0; c < 3; ++c) {
                assert_close((double)out[3 * v + c], expected[c] / sum, 3e-6);
                if (i % 2 == 0) {
                    assert_close((double)normals[3 * v + c], normal[c] / length, 1e-4);
                }
            }
        }
        free(pose);
        pc_deform_destroy(context, deformer);
        pc_rotation_estimator_destroy(context, estimator);
        free(s);
    }
    pc_context_destroy(context);
}

// v = sum over joints w (p + R (v(0) - p(0))) + sum over bones w A v(0) in double, R the identity
// where joints only move; normals by the linear parts.
static void bones_carry_vertices(void **state) {
    (void)state;
    enum { COUNT = 61, BONES = 5, PROXY = JOINTS - BONES };
    pc_context *context = test_context(1);
    for (size_t i = 0; i < 8; ++i) {
        sample *s = make_sample(COUNT, i % 2 == 0 ? 4 : 7);
        const bool turning = i >= 4, normals = i % 4 < 2, resting = i == 3;
        float rotations[4 * PROXY], bones[13 * BONES], out[3 * COUNT], turned[3 * COUNT];
        double maps[12 * JOINTS];
        for (size_t j = 0; j < JOINTS; ++j) {
            double q[4], r[9], *map = &maps[12 * j];
            for (size_t k = 0; k < 4; ++k) {
                q[k] = (double)between(20 + i, 4 * j + k, -1.0, 1.0);
            }
            const double length = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
            for (size_t k = 0; k < 4; ++k) {
                q[k] /= length;
                if (j < PROXY) {
                    rotations[4 * j + k] = (float)q[k];
                }
            }
            pci_matrix_of_quaternion(q, r);
            for (size_t k = 0; k < 12; ++k) {
                const size_t row = k / 4, column = k % 4;
                map[k] = column == 3     ? (double)s->moved[3 * j + row]
                         : !resting      ? r[3 * row + column]
                         : row == column ? 1.0
                                         : 0.0;
                map[k] = column == 3 && resting ? 0.0 : map[k];
                if (j >= PROXY) {
                    bones[13 * (j - PROXY) + k] = (float)map[k];
                }
            }
        }
        s->arrays.joint_count = PROXY;
        s->arrays.bone_count = BONES;
        s->arrays.triangle_count = PROXY - 2;
        s->arrays.skinning = turning ? PC_SKINNING_ROTATION : PC_SKINNING_TRANSLATION;
        s->arrays.normals = normals ? s->normals : NULL;
        pc_deformer *deformer = NULL;
        assert_ok(context, pc_deform_prepare(context, &s->arrays, &deformer));
        char *pose = malloc(pc_deform_pose_size(deformer) + 4);
        const pc_deform_input input = {.joints = s->moved,
                                       .rotations = rotations,
                                       .bones = resting ? NULL : bones,
                                       .bone_stride = 13 * sizeof(float)};
        pc_deform_pose(deformer, &input, pose + 4);
        pc_deform(deformer, pose + 4, 0, COUNT,
                  &(pc_deform_output){.positions = out, .normals = normals ? turned : NULL});
        for (size_t v = 0; v < COUNT; ++v) {
            double sum = 0.0, expected[3] = {0.0}, normal[3] = {0.0};
            for (size_t k = v * s->arrays.influences; k < (v + 1) * s->arrays.influences; ++k) {
                const size_t joint = s->joints[k];
                const double w = (double)s->weights[k], *map = &maps[12 * joint];
                const bool bone = joint >= PROXY;
                for (size_t c = 0; c < 9; ++c) {
                    const size_t row = c / 3, column = c % 3;
                    const double origin = bone ? 0.0 : (double)s->rest[3 * joint + column];
                    const double straight = row == column ? 1.0 : 0.0;
                    expected[row] += w * (bone || turning ? map[4 * row + column] : straight) *
                                     ((double)s->positions[3 * v + column] - origin);
                    normal[row] += w * map[4 * row + column] * (double)s->normals[3 * v + column];
                }
                for (size_t c = 0; c < 3; ++c) {
                    expected[c] += w * (bone ? map[4 * c + 3] : (double)s->moved[3 * joint + c]);
                }
                sum += w;
            }
            const double length = pci_norm(normal);
            for (size_t c = 0; c < 3; ++c) {
                assert_close((double)out[3 * v + c], expected[c] / sum, 3e-6);
                if (normals) {
                    assert_close((double)turned[3 * v + c], normal[c] / length, 1e-4);
                }
            }
        }
        free(pose);
        pc_deform_destroy(context, deformer);
        free(s);
    }
    pc_context_destroy(context);
}

// Joints without triangles, collapsed rings: normals stay finite, as at rest where nothing turns.
static void rings_without_area_do_not_turn(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    sample *s = make_sample(50, 4);
    for (size_t pass = 0; pass < 2; ++pass) {
        pc_deformer *deformer = NULL;
        s->arrays.triangle_count = pass == 0 ? 0 : JOINTS - 2;
        s->arrays.triangles = pass == 0 ? NULL : s->triangles;
        assert_ok(context, pc_deform_prepare(context, &s->arrays, &deformer));
        float collapsed[3 * JOINTS] = {0.0F}, positions[150], normals[150];
        void *pose = make_pose(deformer, pass == 0 ? s->moved : collapsed, 0);
        pc_deform(deformer, pose, 0, 50,
                  &(pc_deform_output){.positions = positions, .normals = normals});
        for (size_t v = 0; v < 50; ++v) {
            double n[3] = {(double)s->normals[3 * v], (double)s->normals[3 * v + 1],
                           (double)s->normals[3 * v + 2]};
            pci_normalize(n);
            for (size_t k = 0; k < 3; ++k) {
                assert_close((double)normals[3 * v + k], n[k], 1e-6);
            }
        }
        free(pose);
        pc_deform_destroy(context, deformer);
    }
    free(s);
    pc_context_destroy(context);
}

// ---- the GLB ------------------------------------------------------------------------------------

// The numbers of a list in the extras of the proxy.
static uint32_t *read_extras(const cJSON *extras, const char *name, size_t *count) {
    const cJSON *list = child(extras, name), *item;
    *count = (size_t)cJSON_GetArraySize(list);
    uint32_t *numbers = calloc(*count + 1, sizeof(uint32_t));
    size_t next = 0;
    cJSON_ArrayForEach(item, list) { numbers[next++] = (uint32_t)item->valuedouble; }
    return numbers;
}

static const cJSON *proxy_extras(const glb *g) {
    const cJSON *node, *extras = NULL;
    cJSON_ArrayForEach(node, child(g->json, "nodes")) {
        extras = cJSON_HasObjectItem(node, "extras") ? child(child(node, "extras"), "proxycloth")
                                                     : extras;
    }
    assert_non_null(extras);
    return extras;
}

// What an engine has after loading a primitive: arrays of a GLB, nothing of this library.
static pc_deformer *prepare_from_glb(pc_context *context, const glb *g, const cJSON *primitive,
                                     size_t bone_count, size_t *count) {
    double *positions = read_attribute(g, primitive, "POSITION", count);
    uint32_t sets = 0;
    double *bones[8], *weights[8];
    size_t rows = 0;
    for (char name[16]; sets < 8; ++sets) {
        snprintf(name, sizeof(name), "JOINTS_%u", sets);
        if (!has_attribute(primitive, name)) {
            break;
        }
        bones[sets] = read_attribute(g, primitive, name, &rows);
        snprintf(name, sizeof(name), "WEIGHTS_%u", sets);
        weights[sets] = read_attribute(g, primitive, name, &rows);
    }
    size_t joint_count = 0;
    double *matrices =
        read_accessor(g, number(element(g, "skins", 0), "inverseBindMatrices"), &joint_count);
    joint_count -= bone_count;
    float *floats = calloc(3 * *count + 4 * sets * *count + 3 * joint_count, sizeof(float));
    float *packed = floats + 3 * *count, *rest = packed + 4 * sets * *count;
    uint32_t *packed_joints = calloc(4 * sets * *count, sizeof(uint32_t));
    for (size_t i = 0; i < 3 * *count; ++i) {
        floats[i] = (float)positions[i];
    }
    for (size_t v = 0; v < *count; ++v) {
        for (size_t k = 0; k < 4 * sets; ++k) {
            packed[v * 4 * sets + k] = (float)weights[k / 4][4 * v + k % 4];
            packed_joints[v * 4 * sets + k] = (uint32_t)bones[k / 4][4 * v + k % 4];
        }
    }
    for (size_t j = 0; j < 3 * joint_count; ++j) {
        rest[j] = -(float)matrices[16 * (j / 3) + 12 + j % 3];
    }
    const cJSON *extras = proxy_extras(g), *skinning = cJSON_GetObjectItem(extras, "skinning");
    size_t corner_count = 0, pinned_count = 0;
    uint32_t *triangles = read_extras(extras, "triangles", &corner_count);
    uint32_t *pins = read_extras(extras, "pinned", &pinned_count);
    uint8_t *pinned = calloc(joint_count, 1);
    for (size_t i = 0; i < pinned_count; ++i) {
        pinned[pins[i]] = 1;
    }
    const bool turns = skinning != NULL && strcmp(skinning->valuestring, "rotation") == 0;
    const pc_deform_arrays arrays = {.vertex_count = *count,
                                     .positions = floats,
                                     .triangle_count = corner_count / 3,
                                     .triangles = triangles,
                                     .skinning =
                                         turns ? PC_SKINNING_ROTATION : PC_SKINNING_TRANSLATION,
                                     .pinned = pinned,
                                     .influences = 4 * sets,
                                     .joints = packed_joints,
                                     .weights = packed,
                                     .joint_count = joint_count,
                                     .bone_count = bone_count,
                                     .joint_positions = rest};
    pc_deformer *deformer = NULL;
    assert_ok(context, pc_deform_prepare(context, &arrays, &deformer));
    for (uint32_t set = 0; set < sets; ++set) {
        free(bones[set]);
        free(weights[set]);
    }
    free(positions);
    free(matrices);
    free(floats);
    free(packed_joints);
    free(triangles);
    free(pins);
    free(pinned);
    return deformer;
}

static float *joints_at(const pc_asset *asset, size_t frame) {
    float *joints = calloc(3 * asset->proxy.vertex_count, sizeof(float));
    assert_non_null(joints);
    for (size_t i = 0; i < 3 * asset->proxy.vertex_count; ++i) {
        joints[i] = (float)asset->motion.positions[3 * frame * asset->proxy.vertex_count + i];
    }
    return joints;
}

static float *deform_at(const pc_deformer *deformer, const float *joints, const float *bones) {
    void *pose = malloc(pc_deform_pose_size(deformer));
    assert_non_null(pose);
    pc_deform_pose(deformer, &(pc_deform_input){.joints = joints, .bones = bones}, pose);
    float *out = calloc(3 * pc_deform_vertex_count(deformer), sizeof(float));
    assert_non_null(out);
    pc_deform(deformer, pose, 0, pc_deform_vertex_count(deformer),
              &(pc_deform_output){.positions = out});
    free(pose);
    return out;
}

// A character whose arm the garment follows near its pins; its clip has a pose per frame.
static void attach_body(pc_context *context, pc_asset *asset) {
    fixture_character(context, (const double[3]){0.0, 1.2, 0.0}, 0.3, 1, &asset->character);
    asset->options.skin.body_blend = 0.5;
    asset->options.skin.weight_storage = PC_SKIN_WEIGHTS_FLOAT;
    asset->scenario.attachment.kind = PC_ATTACHMENT_CLIP;
    memcpy(asset->scenario.attachment.clip, "turn", sizeof("turn"));
    asset->motion.frame_time = 0.1; // three poses of the clip
}

// The GLB's bytes, posed by a reader of its own, and pc_deform on the GLB's arrays and on the
// asset: the same within 1e-5 of the diagonal. Joints move, turn, move beside a body, turn beside
// one.
static void deform_is_the_posed_glb(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    for (uint32_t round = 0; round < 12; ++round) {
        pc_asset asset;
        fixture_asset(context, 4 + round % 3 * 4, &asset);
        asset.skin.skinning = round / 3 % 2 == 0 ? PC_SKINNING_TRANSLATION : PC_SKINNING_ROTATION;
        if (round >= 6) {
            attach_body(context, &asset);
        }
        const size_t bone_count = asset.character.joint_count;
        assert_ok(context, pc_export_glb(context, &asset, path));
        glb g = read_glb(path);
        const double tolerance = 1e-5 * pci_diagonal(&asset.visual.surface);
        pc_deformer *whole = NULL;
        assert_ok(context, pc_deform_prepare_asset(context, &asset, &whole));
        const uint32_t materials[] = {0, 2};
        size_t at = 0, compared = 0;
        const cJSON *primitive;
        cJSON_ArrayForEach(primitive, child(element(&g, "meshes", 0), "primitives")) {
            size_t count = 0, index_count = 0;
            pc_deformer *part = prepare_from_glb(context, &g, primitive, bone_count, &count);
            double *indices = read_accessor(&g, number(primitive, "indices"), &index_count);
            for (size_t frame = 0; frame < FIXTURE_FRAMES; ++frame) {
                float *joints = joints_at(&asset, frame);
                const float *bones = round >= 6 ? &asset.character.poses[72 * (frame + 1)] : NULL;
                float *by_part = deform_at(part, joints, bones);
                float *by_whole = deform_at(whole, joints, bones);
                double *posed = pose_primitive(&g, primitive, frame, &count);
                for (size_t i = 0; i < 3 * count; ++i) {
                    assert_close((double)by_part[i], posed[i], tolerance);
                }
                size_t next = 0;
                for (size_t i = 0; i < 3 * asset.visual.surface.triangle_count; ++i) {
                    if (asset.visual.triangle_materials[i / 3] == materials[at]) {
                        const size_t v = (size_t)indices[next++];
                        const size_t corner = asset.visual.corner_triangles[i];
                        for (size_t k = 0; k < 3; ++k) {
                            assert_close((double)by_whole[3 * corner + k], posed[3 * v + k],
                                         tolerance);
                        }
                        ++compared;
                    }
                }
                free(joints);
                free(by_part);
                free(by_whole);
                free(posed);
            }
            free(indices);
            pc_deform_destroy(context, part);
            ++at;
        }
        assert_int_equal(compared, FIXTURE_FRAMES * 3 * asset.visual.surface.triangle_count);
        pc_deform_destroy(context, whole);
        free_glb(&g);
        pc_asset_free(context, &asset);
    }
    pc_context_destroy(context);
}

// ---- bad input ----------------------------------------------------------------------------------

static void expect_refusal(pc_context *context, const sample *s, pc_status expected) {
    pc_deformer *deformer = (pc_deformer *)(uintptr_t)s;
    assert_int_equal(pc_deform_prepare(context, &s->arrays, &deformer), expected);
    assert_null(deformer);
}

static void refuses_bad_input(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    sample *s = make_sample(9, 4);
    const pc_deform_arrays good = s->arrays;
    pc_deformer *deformer = NULL;
    assert_int_equal(pc_deform_prepare(context, NULL, &deformer), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_deform_prepare(context, &good, NULL), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_deform_prepare_asset(context, NULL, &deformer), PC_ERROR_INVALID_ARGUMENT);
    const pc_asset unfinished = {.stage_count = PC_STAGE_SKIN};
    assert_int_equal(pc_deform_prepare_asset(context, &unfinished, &deformer),
                     PC_ERROR_INVALID_ARGUMENT);
    for (size_t i = 0; i < 9; ++i) {
        s->arrays = good;
        switch (i) {
        case 8:
            s->arrays.skinning = 2;
            break;
        case 0:
            s->arrays.vertex_count = 0;
            break;
        case 1:
            s->arrays.positions = NULL;
            break;
        case 2:
            s->arrays.joints = NULL;
            break;
        case 3:
            s->arrays.weights = NULL;
            break;
        case 4:
            s->arrays.joint_positions = NULL;
            break;
        case 5:
            s->arrays.triangles = NULL;
            break;
        case 6:
            s->arrays.influences = 0;
            break;
        default:
            s->arrays.joint_count = 0;
            break;
        }
        expect_refusal(context, s, PC_ERROR_INVALID_ARGUMENT);
    }
    s->arrays = good;
    s->arrays.joint_count = 65537;
    expect_refusal(context, s, PC_ERROR_TOO_LARGE);
    s->arrays = good;
    s->arrays.bone_count = 65537 - JOINTS;
    expect_refusal(context, s, PC_ERROR_TOO_LARGE);
    s->arrays = good;
    s->arrays.influences = 33;
    expect_refusal(context, s, PC_ERROR_TOO_LARGE);
    s->arrays = good;
    float *numbers[] = {&s->weights[17], &s->positions[26], &s->normals[0], &s->rest[4]};
    for (size_t i = 0; i < 4; ++i) {
        const float before = *numbers[i];
        *numbers[i] = NAN;
        expect_refusal(context, s, PC_ERROR_INVALID_ARGUMENT);
        *numbers[i] = before;
    }
    s->weights[16] = -0.1F;
    expect_refusal(context, s, PC_ERROR_INVALID_ARGUMENT);
    assert_non_null(strstr(pc_context_error(context)->message, "vertex 4"));
    s->weights[16] = s->weights[17] = s->weights[18] = s->weights[19] = 0.0F;
    expect_refusal(context, s, PC_ERROR_INVALID_ARGUMENT);
    s->weights[16] = 1.0F;
    s->joints[16] = JOINTS;
    expect_refusal(context, s, PC_ERROR_INVALID_ARGUMENT);
    s->joints[16] = 0;
    s->triangles[5] = JOINTS;
    expect_refusal(context, s, PC_ERROR_INVALID_ARGUMENT);
    pc_deform_destroy(context, NULL);
    free(s);
    pc_context_destroy(context);
}

static void survives_lack_of_memory(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    pc_asset asset;
    fixture_asset(context, 8, &asset);
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        pc_deformer *deformer = NULL;
        s.status = pc_deform_prepare_asset(context, &asset, &deformer);
        assert_int_equal(deformer != NULL, s.status == PC_OK);
        pc_deform_destroy(context, deformer);
    }
    assert_true(s.failures > 14);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

static int make_folder(void **state) {
    (void)state;
    return test_make_folder(folder, path, "tube.glb", other_path, "other.glb");
}

static int remove_folder(void **state) {
    (void)state;
    return test_remove_folder(folder, path, other_path);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(positions_are_equation_6),
        cmocka_unit_test(ranges_and_threads_give_the_same_bytes),
        cmocka_unit_test(kernels_agree_bit_by_bit),
        cmocka_unit_test(rigid_motion_turns_normals),
        cmocka_unit_test(bending_turns_normals),
        cmocka_unit_test(joints_turn_positions),
        cmocka_unit_test(bones_carry_vertices),
        cmocka_unit_test(rings_without_area_do_not_turn),
        cmocka_unit_test(deform_is_the_posed_glb),
        cmocka_unit_test(refuses_bad_input),
        cmocka_unit_test(survives_lack_of_memory),
    };
    return cmocka_run_group_tests(tests, make_folder, remove_folder);
}
