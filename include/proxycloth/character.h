/// The rest of a garment's file: the skeleton with its animation clips, and the body. A scenario
/// (proxycloth/scenario.h) attaches the proxy to the one and lets it collide with both.
///
/// Everything is in the coordinates of the visual mesh. A *pose* holds one affine map per joint, 3
/// rows of 4, that takes a point from the rest pose (in which the visual mesh is given) to where
/// the joint carries it; in the rest pose all maps are the identity. So no bind matrices are
/// needed.
#ifndef PROXYCLOTH_CHARACTER_H
#define PROXYCLOTH_CHARACTER_H

#include "proxycloth/mesh.h"

#ifdef __cplusplus
extern "C" {
#endif

/// All arrays may be NULL with count 0. Names are 64 bytes each, zero-terminated and zero-filled.
typedef struct pc_character {
    size_t joint_count;
    char *joint_names;     ///< #J by 64
    double *joint_centers; ///< #J by 3, where the joint is in the rest pose
    /// #J, the joint that this one hangs on, below its own index; PC_INVALID_INDEX: none. NULL:
    /// none hangs on another.
    uint32_t *joint_parents;
    size_t clip_count;
    char *clip_names;     ///< #clips by 64
    uint32_t *clip_poses; ///< #clips by 2, first pose and number of poses (at least 1)
    double *clip_rates;   ///< #clips, poses per second, > 0
    size_t pose_count;
    float *poses; ///< #poses by #J by 12
    pc_mesh body; ///< the parts of the file that are no garment, in the rest pose
    size_t body_part_count;
    char *body_part_names;         ///< #body parts by 64, of the mesh
    uint32_t *body_triangle_parts; ///< #F of body, each < body_part_count
    uint32_t *body_joints;         ///< #V of body by 4, each < joint_count, or NULL
    float *body_weights;           ///< #V of body by 4, sum 1, or all 0: does not move; or NULL
} pc_character;

/// Copies and checks a caller's arrays; nothing of `arrays` is kept. Weights are scaled to sum 1.
/// Parts of the body without triangles or with positions that are not finite do not count.
/// @param[out] character  zeroed on entry; empty on failure.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT (a count without its array, an index, pose or rate out
///         of range); PC_ERROR_TOO_LARGE; PC_ERROR_OUT_OF_MEMORY.
PC_NODISCARD pc_status pc_character_create(pc_context *context, const pc_character *arrays,
                                           pc_character *character);

/// Releases the arrays and zeroes the struct. NULL is accepted.
void pc_character_free(pc_context *context, pc_character *character);

#ifdef __cplusplus
}
#endif
#endif
