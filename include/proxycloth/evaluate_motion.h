/// Measures of skinning weights on a motion of the proxy; independent of how the weights were made.
///
/// Weights should be judged on a motion that they have not seen: pc_simulate with another seed.
/// Lengths in the measures are relative to rest lengths or to the diagonal D of the visual mesh's
/// bounding box; so nothing depends on the unit or on the number of frames.
/// - L_r, L_c: equations (8) and (9) as pc_skin_evaluate gives them, divided by the number of
///   frames and by the sum of the squared rest lengths of their edges. 0: every 1-ring
///   (neighbourhood) moves rigidly.
/// - Strain: | length / rest length - 1 | over all edges of the visual mesh and all frames; the
///   mean, and the 95th percentile (exact within 0.05 %). Edges of no length are left out. The
///   proxy itself stretches, so 0 is out of reach.
/// - Folded triangles: those with a neighbour across an edge whose normal differs by more than 90
///   degrees, where it did not at rest; share of all triangles, mean over the frames. Edges of
///   other than two triangles and triangles without area are left out; the winding does not matter.
/// - New self-intersections: pairs of triangles that cross and do not cross at rest, mean over
///   `crossing_frames` frames, evenly spread up to the last. Pairs that share an edge do not count.
///   The same is counted of the proxy: where it passes through itself no weights can hold the cloth
///   apart, but the simulation may (`self_contact`).
/// - Pinned drift: of the vertices whose closest point of the proxy lies in a triangle (edge,
///   vertex) with pinned vertices only, the distance from where that point's motion takes them,
///   over D; mean over these vertices and the frames, and the largest.
/// - Motion ratio: sum of the distances from rest over all vertices and frames, over the same sum
///   if each vertex moved as its closest point of the proxy does. Below 1: the weights damp the
///   motion.
#ifndef PROXYCLOTH_EVALUATE_MOTION_H
#define PROXYCLOTH_EVALUATE_MOTION_H

#include "proxycloth/skin.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct pc_evaluate_motion_options {
    uint32_t wind_seed;       ///< seed of the motion; for programs that simulate one
    uint32_t crossing_frames; ///< frames in which self-intersections are counted, 0: none
} pc_evaluate_motion_options;

typedef struct pc_motion_measures {
    double rigid;               ///< L_r
    double collision;           ///< L_c
    double strain_mean;         ///< of the edges
    double strain_p95;          ///< 95th percentile
    double folded_triangles;    ///< share, 0..1
    double new_intersections;   ///< pairs per frame
    double proxy_intersections; ///< pairs per frame of the proxy's triangles
    double pinned_drift;        ///< mean, over D
    double pinned_drift_worst;  ///< largest, over D
    double motion_ratio;        ///< 1: as much motion as the proxy; 0 where the proxy rests
} pc_motion_measures;

extern const pc_record pc_evaluate_motion_options_record;
extern const pc_record pc_motion_measures_record;

/// Measures `skin` while `motion` drives it.
/// @param[in]  surface  the visual mesh.
/// @param[in]  proxy    rest pose of the driving mesh.
/// @param[in]  motion   its frames and pinned vertices.
/// @param[in]  options  NULL for the defaults.
/// @param[out] measures overwritten; all zero on failure.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT (NULL, meshes, motion and weights do not belong to each
///         other); PC_ERROR_INVALID_OPTIONS; PC_ERROR_NUMERICAL; PC_ERROR_OUT_OF_MEMORY;
///         PC_ERROR_DEPENDENCY (Embree); PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pc_evaluate_motion(pc_context *context, const pc_mesh *surface,
                                          const pc_mesh *proxy, const pc_motion *motion,
                                          const pc_skin *skin,
                                          const pc_evaluate_motion_options *options,
                                          pc_motion_measures *measures);

/// Reads the weights of a skinned mesh from a binary glTF file (GLB): of this library, or of a
/// studio's own rig over the same garment and the same proxy.
///
/// All skinned primitives of the file are taken, with every set JOINTS_n, WEIGHTS_n. Each vertex of
/// `surface` takes the weights of the nearest vertex of the file, which must be within 1e-4 of the
/// diagonal. Each joint with weight must rest (by its inverse bind matrix) within 1e-3 of the
/// diagonal of a proxy vertex, which it stands for; so the order of the joints does not matter.
/// Positions count as they are in the file, in the unit of `surface`.
/// Read are accessors without sparse values or compression in the file's own binary chunk.
/// @param[out] skin  zeroed on entry; rows by falling weight, sum 1.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT; PC_ERROR_IO; PC_ERROR_FORMAT (no GLB, damaged, nothing
///         skinned, or of another garment or proxy; the message says which vertex or joint);
///         PC_ERROR_OUT_OF_MEMORY.
PC_NODISCARD pc_status pc_skin_read_glb(pc_context *context, const char *path,
                                        const pc_mesh *surface, const pc_mesh *proxy,
                                        pc_skin *skin);

#ifdef __cplusplus
}
#endif
#endif
