/// Stage 9 of 9, skin: visual mesh, proxy mesh and its motion -> skinning weights.
///
/// Each visual vertex follows its nearest proxy vertices by translation-only linear blend skinning,
///   v_i(t) = v_i(0) + sum_j w_ij (p_j(t) - p_j(0)),                                  equation (6)
/// with w >= 0 and sum_j w_ij = 1; or, with `skinning` = rotation, by linear blend skinning with a
/// rotation R_j(t) of each proxy vertex that its 1-ring tells (proxycloth/rotation.h),
///   v_i(t) = sum_j w_ij (p_j(t) + R_j(t) (v_i(0) - p_j(0))),
/// the extension that section 4 names. The weights minimise
/// lambda_r L_r + lambda_c L_c + lambda_a L_a + lambda_f L_f + lambda_s L_s + lambda_l L_l over the
/// frames: as-rigid-as-possible over the 1-ring (7), the same over spatial neighbours against
/// collisions (8), attachment of neighbouring parts (9, 10), following the proxy, keeping lengths
/// and the gaps between loose parts (below).
///
/// The default solver alternates. For given weights the best rotations are found for all vertices
/// and frames, certified as global optima. For given rotations the energy is quadratic in the
/// weights, and all frames enter through the Gram matrix of the proxy's displacements (of 3 by 4
/// matrices where it turns): Gauss-Seidel sweeps solve each vertex exactly on the simplex, and each
/// round first goes on along the step of the last one. The paper's AdamW over the surrogate
/// w = |s| / sum |s| needs ten to forty times as long for the same loss.
///
/// The paper names no lambdas. Here each loss is divided by the number of frames and by its norm
/// (L_r, L_c, L_s, L_l: sum of the squared rest lengths of its directed edges; L_a: sum over the
/// vertices of the squared mean distance to the neighbours; L_f: vertices times the mean square
/// length of the proxy's edges), so neither the unit nor the resolution matters; epsilon_z is
/// 1/1500 of the bounding-box diagonal.
///
/// DEVIATIONS of the default solver:
/// - The paper's losses are 0 for equal weights everywhere, so they reward less motion.
///   L_f = sum |u_i(t) - u*_i(t)|^2 mends that, u* the displacement that heat-smoothed weights
///   and closest-triangle weights (proxycloth/baselines.h) give on average. Whenever slots are
///   taken away, lambda_f becomes as large, up to 16 times, as the garment needs to move
///   `least_motion` of what the proxy's closest points do: what is missing of their motion falls
///   about with the root of lambda_f. A vertex whose closest point is held follows that point
///   exactly.
/// - lambda_s in the same way becomes as large as the edges need to stretch, on average, no more
///   than `most_strain` of what closest-triangle weights do to them, which hardly stretch one flat
///   sheet: strain falls about with the sixth root of lambda_s.
/// - Loose parts that lie upon each other, as pockets, belts and soles do, pass through each other
///   when each finds weights of its own. L_l = sum s_i |u_i(t) - u_p(i)(t)|^2 keeps them apart. It
///   counts the vertices that have another part, over the same proxy triangles or their neighbours,
///   nearer than half of l, the root mean square length of the edges; p(i) is its closest point and
///   s_i = min(l, l_i)^2 / (d^2 + l^2 / 100), with the distance d at rest and the mean length l_i
///   of the edges at i. Parts may be sunk into each other at rest: where an edge passes through a
///   triangle, the points that meet there count in the same way, with d = 0 and the lesser l_i of
///   the edge's ends. Closest-triangle weights keep parts apart by themselves, being the same for
///   all layers.
/// - Edges count alike whatever their length (`equal_edges`): L_r, L_c and L_s give each edge the
///   stiffness l^2 / |e|^2, l^2 the mean square. As printed, small triangles cost nothing and
///   fold, and buttons stretch. The report gives the losses as printed.
/// - What the frames do not show costs nothing, and weights that suit these frames alone fold and
///   cross in others. So each proxy vertex also moves by noise of its own, of variance
///   `motion_noise` times the mean square of how far the displacements of neighbours are apart (a
///   proxy that moves as one needs none): G + s I in place of their Gram matrix G, as a covariance
///   is shrunk (Ledoit, Wolf, "A well-conditioned estimator for large-dimensional covariance
///   matrices", 2004). The rotations do not see it, and it takes no pass over the frames. It acts
///   on the weights less half of those that L_f follows, lest they become too smooth, and not in
///   L_s: it would have weights resist stretching that cloth does not do.
/// - The weights start from those that L_f follows.
/// - Vertices that an edge shorter than a hundredth of the mean joins have one row of weights: what
///   lies between them would be stretched to a multiple by the least difference. The losses of the
///   report are those with such vertices as one.
/// DEVIATION: the candidates of a vertex are the corners of the closest proxy triangle, with the
/// default solver what its heat-smoothed weights follow, and then the nearest proxy vertices: the
/// nearest alone may all lie on another layer.
/// DEVIATION: the weights are cut from k_B candidates to K influences in two steps and optimised
/// again after each; cutting alone multiplies L_r by about five. The default solver takes away
/// those that cost least by the second derivatives of the energy, and chooses again, twice, once
/// the neighbours have chosen.
/// DEVIATION: AdamW takes 100 epochs of batches at learning rate 0.005 that falls at the end,
/// instead of 200 at 0.001: the same loss or less in half the time.
///
/// DEVIATION: where the proxy moves layers through each other no weights can satisfy L_c and L_a,
/// so they must not cost L_r: both lambdas are multiplied by L_r / L_c of the first guess if that
/// is below 1, and divided by 4 when L_r is still above 70 % of the first guess before the first
/// slots are taken away or the last ones (AdamW: after each of its three phases but the last).
///
/// The default solver finds what varies slowly on about a fifth of the vertices, which stand for
/// all (and so on, down to some hundred); then few rounds do on all. Most rounds see a sample of
/// the frames, about 32 of them evenly spread, the last ones all.
///
/// Time: about 20 ns per vertex, frame seen and round or epoch on one core, in float, and 2.5 us
/// per vertex and round. Memory: about 1.1 kB per vertex with 4 influences and 1.4 kB with 8, 0.2
/// MB per thread, 0.8 kB per proxy vertex and 8 B per pair of those, with rotations 4 and 16 times
/// as much.
///
/// Postconditions: weights >= 0, each row sums to 1 within 1e-12, rows sorted by falling weight.
#ifndef PROXYCLOTH_SKIN_H
#define PROXYCLOTH_SKIN_H

#include "proxycloth/mesh.h"
#include "proxycloth/options.h"

#ifdef __cplusplus
extern "C" {
#endif

/// What of a proxy vertex moves the visual vertices.
typedef enum pc_skinning {
    PC_SKINNING_TRANSLATION, ///< its displacement, equation (6)
    PC_SKINNING_ROTATION,    ///< its displacement and rotation: linear blend skinning
} pc_skinning;

/// Skinning weights.
typedef struct pc_skin {
    size_t vertex_count; ///< visual vertices
    uint32_t influences; ///< K, slots per vertex
    uint32_t *bones;     ///< #V by K, proxy vertices; unused slots repeat the first bone
    double *weights;     ///< #V by K, unused slots are 0
    uint32_t skinning;   ///< pc_skinning, what the weights are for
} pc_skin;

/// Releases the arrays and zeroes the struct. NULL is accepted.
void pc_skin_free(pc_context *context, pc_skin *skin);

typedef enum pc_skin_solver {
    PC_SKIN_ALTERNATE, ///< all rotations, then Gauss-Seidel sweeps over the vertices, in turn
    PC_SKIN_ADAMW,     ///< the paper's
} pc_skin_solver;

typedef enum pc_skin_weight_storage {
    PC_SKIN_WEIGHTS_FLOAT, ///< 32-bit floats
    PC_SKIN_WEIGHTS_U16,   ///< 16-bit integers, each row sums to exactly 65535
    PC_SKIN_WEIGHTS_U8,    ///< 8-bit integers, each row sums to exactly 255
} pc_skin_weight_storage;

/// Which channel of the vertex colors holds a vertex's share of the proxy (body.h).
typedef enum pc_body_channel {
    PC_BODY_CHANNEL_NONE,
    PC_BODY_CHANNEL_RED,
    PC_BODY_CHANNEL_GREEN,
    PC_BODY_CHANNEL_BLUE,
    PC_BODY_CHANNEL_ALPHA
} pc_body_channel;

typedef struct pc_skin_options {
    uint32_t skinning;        ///< pc_skinning
    uint32_t solver;          ///< pc_skin_solver
    uint32_t influences;      ///< K of the result
    uint32_t candidates;      ///< k_B, proxy vertices considered per visual vertex; 0: 2 K
    uint32_t neighbours;      ///< k_K, spatial neighbours of L_c and L_a
    double lambda_rigid;      ///< lambda_r
    double lambda_collision;  ///< lambda_c
    double lambda_attachment; ///< lambda_a
    double lambda_follow;     ///< lambda_f, PC_SKIN_ALTERNATE
    double lambda_stretch;    ///< lambda_s, PC_SKIN_ALTERNATE
    double lambda_layers;     ///< lambda_l, PC_SKIN_ALTERNATE
    double least_motion;      ///< share of the proxy's motion, PC_SKIN_ALTERNATE
    double most_strain;       ///< share of that of closest triangles, PC_SKIN_ALTERNATE
    double motion_noise;      ///< variance over that between neighbours, PC_SKIN_ALTERNATE
    bool equal_edges;         ///< edges count alike whatever their length, PC_SKIN_ALTERNATE
    uint32_t rounds;          ///< passes over frames at most, PC_SKIN_ALTERNATE
    double round_gain;        ///< a round gains at least this share, PC_SKIN_ALTERNATE
    uint32_t epochs;          ///< passes over all frames
    uint32_t batch;           ///< frames per step
    double learning_rate;
    double weight_decay;
    uint32_t seed;
    uint32_t max_bones;      ///< of the engine, for the proxy and the reserve; 0: no limit
    uint32_t reserve_bones;  ///< that the engine uses for something else
    uint32_t weight_storage; ///< pc_skin_weight_storage, in exported files
    double body_blend;       ///< way from the pins to the free cloth, in exported files (body.h)
    uint32_t body_channel;   ///< pc_body_channel, instead of body_blend
} pc_skin_options;

/// Losses in single precision, to about 1e-6 of themselves.
typedef struct pc_skin_report {
    double loss_before; ///< lambda-weighted, normalised per frame and scale
    double loss_after;
    double rigid_before, rigid_after;           ///< L_r, normalised
    double collision_before, collision_after;   ///< L_c, normalised
    double attachment_before, attachment_after; ///< L_a, normalised
    double full_loss;     ///< loss_after with all candidates, before the cut to K
    double spatial_share; ///< of lambda_c and lambda_a in the last epochs, 0..1
    uint64_t rounds;      ///< passes over frames, PC_SKIN_ALTERNATE
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
///         PC_ERROR_CANCELLED. TOO_LARGE also when more proxy vertices than bones are free.
PC_NODISCARD pc_status pc_skin_optimize(pc_context *context, const pc_mesh *surface,
                                        const pc_mesh *proxy, const pc_motion *motion,
                                        const pc_skin_options *options, pc_skin *skin,
                                        pc_skin_report *report);

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

/// Poses the detailed mesh for one frame of the driving mesh.
/// @param[in]  rest      #V by 3, visual vertices at rest.
/// @param[in]  proxy_rest, proxy_frame  #P by 3.
/// @param[in]  rotations #P by 4, unit quaternions (x, y, z, w): linear blend skinning,
///                       v_i = sum_j w_ij (p_j + R_j (v_i(0) - p_j(0))), as weights for
///                       PC_SKINNING_ROTATION ask for. NULL: equation (6).
/// @param[out] output    #V by 3; may be `rest`.
void pc_skin_deform(const pc_skin *skin, const double *rest, const double *proxy_rest,
                    const double *proxy_frame, const double *rotations, double *output);

#ifdef __cplusplus
}
#endif
#endif
