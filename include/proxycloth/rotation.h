/// How the vertices of the proxy turn: rotations from positions alone.
///
/// Linear blend skinning blends the translation and the rotation of each bone, but cloth solvers
/// move points. Here the rotation of a vertex is what its 1-ring does from rest to a pose: normal
/// to normal (the sum of the triangles' area vectors), and within the tangent plane by least
/// squares over the edges; then half of that and half of the mean over its neighbours, which is
/// steadier. So it is a proper rotation, also on borders and where the ring is flat, and exact to
/// single precision where the proxy moves rigidly. A ring without area turns as its neighbours do,
/// and not at all where they have none either.
///
/// Pinned vertices that edges join turn together, as the rigid body that fits them best; the free
/// cloth around would turn them otherwise, and what is pinned with them. Where a few pins do not
/// tell a rotation, all pins together do.
///
///     pc_rotation_estimator *estimator = NULL;
///     if (pc_rotation_estimator_create(context, &proxy, motion.pinned, &estimator) != PC_OK) ...
///     pc_rotation_estimate(estimator, positions, rotations);             // every frame
///     pc_skin_deform(&skin, rest, proxy.positions, positions, rotations, vertices);
#ifndef PROXYCLOTH_ROTATION_H
#define PROXYCLOTH_ROTATION_H

#include "proxycloth/mesh.h"

#ifdef __cplusplus
extern "C" {
#endif

/// What a proxy is at rest; never changes once it is made.
typedef struct pc_rotation_estimator pc_rotation_estimator;

/// @param[in]  proxy      at rest.
/// @param[in]  pinned     #V, not 0 where a vertex is pinned; NULL: none is.
/// @param[out] estimator  NULL on failure.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT; PC_ERROR_INVALID_MESH; PC_ERROR_OUT_OF_MEMORY.
PC_NODISCARD pc_status pc_rotation_estimator_create(pc_context *context, const pc_mesh *proxy,
                                                    const uint8_t *pinned,
                                                    pc_rotation_estimator **estimator);

/// NULL is accepted.
void pc_rotation_estimator_destroy(pc_context *context, pc_rotation_estimator *estimator);

/// Allocates nothing, keeps no state and cannot fail; any number of threads may share an estimator.
/// @param[in]  positions  #V by 3, a pose of the proxy; finite.
/// @param[out] rotations  #V by 4, unit quaternions (x, y, z, w) with w >= 0.
void pc_rotation_estimate(const pc_rotation_estimator *estimator, const double *positions,
                          double *rotations);

/// The rotations of all frames; of the two quaternions of a rotation the one nearer to that of the
/// frame before, so that they may be interpolated.
/// @param[in]  motion     its frames and pinned vertices.
/// @param[out] rotations  #frames by #V by 4.
/// @return as pc_rotation_estimator_create; PC_ERROR_INVALID_ARGUMENT also when the motion is not
///         of this proxy.
PC_NODISCARD pc_status pc_rotation_estimate_motion(pc_context *context, const pc_mesh *proxy,
                                                   const pc_motion *motion, double *rotations);

#ifdef __cplusplus
}
#endif
#endif
