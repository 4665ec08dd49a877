/// Stage 9 of 9, skin: visual mesh, proxy mesh and its motion -> skinning weights.
///
/// Each visual vertex follows its nearest proxy vertices by translation-only linear blend skinning,
///   v_i(t) = v_i(0) + sum_j w_ij (p_j(t) - p_j(0)),                                  equation (6)
/// with w >= 0 and sum_j w_ij = 1. The weights minimise lambda_r L_r + lambda_c L_c + lambda_a L_a
/// (equations (7) to (10)) over the frames: as-rigid-as-possible over the 1-ring, the same over
/// spatial neighbours against collisions, and attachment of neighbouring parts. The surrogate
/// w = |s| / sum |s| is optimised with AdamW.
///
/// The paper names no lambdas. Here each loss is divided by the number of frames and by its norm
/// (L_r, L_c: sum of the squared rest lengths of its directed edges; L_a: sum over the vertices of
/// the squared mean distance to the neighbours), so neither the unit nor the resolution matters;
/// epsilon_z is 1/1500 of the bounding-box diagonal.
///
/// DEVIATION: the candidates of a vertex are the corners of the closest proxy triangle and then the
/// nearest proxy vertices, and the first guess is mostly the closest point's barycentric
/// coordinates: the nearest vertices alone may all lie on another layer.
/// DEVIATION: 100 epochs of batches at learning rate 0.005 that falls at the end, instead of 200 at
/// 0.001: the same loss or less in half the time.
/// DEVIATION: the weights are cut from k_B candidates to K influences in two steps and optimised
/// again after each; engines take 4 influences, and cutting alone multiplies L_r by about five.
///
/// DEVIATION: where the proxy moves layers through each other no weights can satisfy L_c and L_a,
/// so they must not cost L_r: both lambdas are multiplied by L_r / L_c of the first guess if that
/// is below 1, and divided by 4 when L_r is still above 70 % of the first guess after 40 % and 60 %
/// of the epochs.
///
/// The objective is 0 for equal weights everywhere, so it also rewards less motion: on unseen winds
/// the result moves a few percent less than the proxy, and parts that hang on held vertices drift.
///
/// Time: about 30 ns per vertex, frame and epoch on one core, in float. Memory: 2 kB per vertex,
/// and 32 B per vertex and frame (batches below 16 frames: as if each had 16).
///
/// Postconditions: weights >= 0, each row sums to 1 within 1e-12, rows sorted by falling weight.
#ifndef PROXYCLOTH_SKIN_H
#define PROXYCLOTH_SKIN_H

#include "proxycloth/mesh.h"
#include "proxycloth/options.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Skinning weights.
typedef struct pc_skin {
    size_t vertex_count; ///< visual vertices
    uint32_t influences; ///< K, slots per vertex
    uint32_t *bones;     ///< #V by K, proxy vertices; unused slots repeat the first bone
    double *weights;     ///< #V by K, unused slots are 0
} pc_skin;

void pc_skin_free(pc_context *context, pc_skin *skin);

typedef struct pc_skin_options {
    uint32_t influences;      ///< K of the result
    uint32_t candidates;      ///< k_B, proxy vertices considered per visual vertex
    uint32_t neighbours;      ///< k_K, spatial neighbours of L_c and L_a
    double lambda_rigid;      ///< lambda_r
    double lambda_collision;  ///< lambda_c
    double lambda_attachment; ///< lambda_a
    uint32_t epochs;          ///< passes over all frames
    uint32_t batch;           ///< frames per step
    double learning_rate;
    double weight_decay;
    uint32_t seed;
} pc_skin_options;

typedef struct pc_skin_report {
    double loss_before; ///< lambda-weighted, normalised per frame and scale
    double loss_after;
    double rigid_before, rigid_after;           ///< L_r, normalised
    double collision_before, collision_after;   ///< L_c, normalised
    double attachment_before, attachment_after; ///< L_a, normalised
    double full_loss;     ///< loss_after with all candidates, before the cut to K
    double spatial_share; ///< of lambda_c and lambda_a in the last epochs, 0..1
    uint64_t reflections; ///< vertex-frames with det(S) < 0 at the end
    uint64_t bones_used;  ///< proxy vertices with any weight
} pc_skin_report;

extern const pc_record pc_skin_options_record;
extern const pc_record pc_skin_report_record;

/// @param[in]  surface  the visual mesh.
/// @param[in]  proxy    rest pose of the driving mesh.
/// @param[in]  motion   its frames.
/// @param[out] skin     zeroed on entry.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT; PC_ERROR_INVALID_OPTIONS; PC_ERROR_TOO_LARGE;
///         PC_ERROR_NUMERICAL; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY (Embree);
///         PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pc_skin_optimize(pc_context *context, const pc_mesh *surface,
                                        const pc_mesh *proxy, const pc_motion *motion,
                                        const pc_skin_options *options, pc_skin *skin,
                                        pc_skin_report *report);

/// Baseline: each vertex follows the closest point of the proxy by its barycentric coordinates.
/// @param[out] skin  zeroed on entry; K = 3.
/// @return as pc_skin_optimize.
PC_NODISCARD pc_status pc_skin_closest_triangle(pc_context *context, const pc_mesh *surface,
                                                const pc_mesh *proxy, pc_skin *skin);

/// Losses of equation (7) for given weights, sums over frames and vertices without normalisation.
typedef struct pc_skin_losses {
    double rigid, collision, attachment;                ///< L_r, L_c, L_a
    double rigid_norm, collision_norm, attachment_norm; ///< divide by these and by the frame count
} pc_skin_losses;

/// Evaluates any weights on any motion, in double.
/// @param[in]  options  of these only `neighbours` counts; NULL for the defaults.
/// @param[out] losses   overwritten.
/// @return as pc_skin_optimize.
PC_NODISCARD pc_status pc_skin_evaluate(pc_context *context, const pc_mesh *surface,
                                        const pc_mesh *proxy, const pc_motion *motion,
                                        const pc_skin *skin, const pc_skin_options *options,
                                        pc_skin_losses *losses);

/// Equation (6) for one frame: a frame of the driving mesh in, the detailed mesh out.
/// @param[in]  rest   #V by 3, visual vertices at rest.
/// @param[in]  proxy_rest, proxy_frame  #P by 3.
/// @param[out] output #V by 3; may be `rest`.
void pc_skin_deform(const pc_skin *skin, const double *rest, const double *proxy_rest,
                    const double *proxy_frame, double *output);

#ifdef __cplusplus
}
#endif
#endif
