/// Run time: positions of the proxy in, positions and normals of the detailed mesh out, every
/// frame.
///
/// For engines that simulate the proxy themselves. Nothing here needs the rest of the library once
/// the weights are prepared, and the GLB holds all inputs: POSITION, NORMAL, JOINTS_n, WEIGHTS_n of
/// the garment; one joint per proxy vertex, resting where its inverse bind matrix puts it; the
/// triangles in the extras of the proxy node.
///
///     pc_deformer *deformer = NULL;                          // when the garment is loaded
///     if (pc_deform_prepare(context, &arrays, &deformer) != PC_OK) return;
///     void *pose = malloc(pc_deform_pose_size(deformer));    // one per instance of the garment
///
///     const pc_deform_input in = {.joints = joints};         // every frame, 9 to 18 us
///     pc_deform_pose(deformer, &in, pose);
///     const pc_deform_output out = {.positions = vertex_buffer, .position_stride = 32,
///                                   .normals = vertex_buffer + 3, .normal_stride = 32};
///     pc_deform(deformer, pose, 0, vertex_count, &out);      // or in ranges, one per job
///
///     free(pose);
///     pc_deform_destroy(context, deformer);
///
/// Positions follow equation (6), v_i = v_i(0) + sum_j w_ij (p_j - p_j(0)), or, with weights for
/// PC_SKINNING_ROTATION, v_i = sum_j w_ij (p_j + R_j (v_i(0) - p_j(0))). R_j turns the 1-ring of
/// proxy vertex j from rest to its pose as proxycloth/rotation.h says, or is what the engine's
/// solver gives. Normals take these rotations too, those of the 1-rings alone where positions take
/// none: n_i = sum_j w_ij R_j n_i(0), scaled to length 1. A rigid motion of the proxy turns normals
/// exactly. Where a 1-ring has no area R_j is the identity.
///
/// A garment that keeps its place on a body (proxycloth/body.h) also follows bones of the
/// character: joints behind those of the proxy that take a point x to A_b x, A_b affine, from the
/// rest pose of the garment to now; normals take the linear part.
///
/// pc_deform_pose and pc_deform allocate nothing, lock nothing, keep no state and cannot fail; a
/// deformer may be used by any number of threads at once. They compute in float with the widest of
/// AVX-512, AVX2 and plain code that the processor has; the results are the same bit by bit.
/// Memory traffic per vertex: 24 bytes read for every 4 influences, 24 read and written for the
/// position, 24 for the normal. Results go fastest into tightly packed memory (stride 12).
#ifndef PROXYCLOTH_DEFORM_H
#define PROXYCLOTH_DEFORM_H

#include "proxycloth/base.h"
#include "proxycloth/pipeline.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Weights in the order in which they are read every frame; never changes once it is made.
typedef struct pc_deformer pc_deformer;

/// What a deformer is made of; read and never kept.
typedef struct pc_deform_arrays {
    size_t vertex_count;    ///< #V, split vertices: every vertex of the vertex buffer
    const float *positions; ///< #V by 3, at rest
    const float *normals;   ///< #V by 3, at rest; NULL: positions only
    uint32_t influences;    ///< K, 1..32
    const uint32_t *joints; ///< #V by K, below #J + #B
    const float *weights;   ///< #V by K, not negative; each row is scaled to the sum 1
    size_t joint_count;     ///< #J, vertices of the proxy
    size_t bone_count;      ///< #B, of the character; joint #J + b is bone b. #J + #B <= 65536
    const float *joint_positions; ///< #J by 3, at rest
    size_t triangle_count;        ///< of the proxy; only rotations need them
    const uint32_t *triangles;    ///< #triangles by 3
    uint32_t skinning;            ///< pc_skinning, what the weights are for
    const uint8_t *pinned;        ///< #J, not 0: turns with the pins it is joined to; NULL: none.
                                  ///< For positions only
} pc_deform_arrays;

/// Prepares a garment for pc_deform.
/// @param[out] deformer  NULL on failure.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT (NULL, no vertex, an index out of range, a number that
///         is not finite, a weight below 0, a row without weight); PC_ERROR_TOO_LARGE (more than
///         65536 joints and bones, 32 influences or 2^31 vertices); PC_ERROR_OUT_OF_MEMORY.
PC_NODISCARD pc_status pc_deform_prepare(pc_context *context, const pc_deform_arrays *arrays,
                                         pc_deformer **deformer);

/// Prepares a finished asset: vertex i is split vertex i of asset->visual, joint j is proxy vertex
/// j; normals are those of the visual mesh, smooth ones where it has none; skinning is that of the
/// weights. Where the options blend in the body, bones are the joints of asset->character and the
/// weights are those of the exported GLB before they are rounded.
/// @return as pc_deform_prepare and pc_body_skin_create; PC_ERROR_INVALID_ARGUMENT also when a
///         stage is missing.
PC_NODISCARD pc_status pc_deform_prepare_asset(pc_context *context, const pc_asset *asset,
                                               pc_deformer **deformer);

/// NULL is accepted.
void pc_deform_destroy(pc_context *context, pc_deformer *deformer);

/// Number of vertices, #V.
size_t pc_deform_vertex_count(const pc_deformer *deformer);

/// Bytes of memory that pc_deform_pose fills, of any alignment; about 80 per joint, 128 with bones.
size_t pc_deform_pose_size(const pc_deformer *deformer);

/// A pose, as the engine has it.
typedef struct pc_deform_input {
    const float *joints;    ///< #J by 3, positions of the proxy's vertices
    size_t joint_stride;    ///< bytes from one to the next; 0: 12
    const float *rotations; ///< #J by 4, unit quaternions (x, y, z, w) from rest to the pose, for
                            ///< engines whose solver knows them; NULL: what the 1-rings tell
    size_t rotation_stride; ///< bytes; 0: 16
    const float *bones; ///< #B by 12, A_b, 3 rows of 4, rotation and uniform scale; NULL: at rest
    size_t bone_stride; ///< bytes; 0: 48
} pc_deform_input;

/// What pc_deform needs to know of a pose.
/// @param[out] pose    pc_deform_pose_size bytes; may be moved afterwards only by calling this
///                     function again. Read by any number of pc_deform calls until then.
void pc_deform_pose(const pc_deformer *deformer, const pc_deform_input *input, void *pose);

/// Where results go. Only the 12 bytes of each position and normal are written, in rising order.
typedef struct pc_deform_output {
    float *positions;       ///< of vertex 0
    size_t position_stride; ///< bytes; 0: 12
    float *normals;         ///< of vertex 0; NULL: none. Unset where a normal has no direction.
    size_t normal_stride;   ///< bytes; 0: 12
} pc_deform_output;

/// Poses the vertices begin to end - 1. Ranges may be computed in any order and at the same time.
/// `output->normals` must be NULL when the deformer was made without normals.
void pc_deform(const pc_deformer *deformer, const void *pose, size_t begin, size_t end,
               const pc_deform_output *output);

#ifdef __cplusplus
}
#endif
#endif
