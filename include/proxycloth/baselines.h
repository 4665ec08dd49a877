/// Skinning weights without optimisation, to compare with.
///
/// They depend on the two rest poses only.
#ifndef PROXYCLOTH_BASELINES_H
#define PROXYCLOTH_BASELINES_H

#include "proxycloth/skin.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Each visual vertex follows its `influences` nearest proxy vertices by inverse distance,
/// w_ij ~ 1 / (d_ij + 1e-6 D), D the diagonal of the proxy.
/// @param[in]  influences  1..32; less where the proxy has fewer vertices.
/// @param[out] skin        zeroed on entry; K = influences, rows by falling weight, sum 1.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT; PC_ERROR_TOO_LARGE; PC_ERROR_OUT_OF_MEMORY.
PC_NODISCARD pc_status pc_skin_inverse_distance(pc_context *context, const pc_mesh *surface,
                                                const pc_mesh *proxy, uint32_t influences,
                                                pc_skin *skin);

/// Each vertex follows the closest point of the proxy by its barycentric coordinates: what
/// surface-deform tools of modelling programs do.
/// @param[out] skin  zeroed on entry; K = 3, rows by falling weight, sum 1.
/// @return as pc_skin_inverse_distance; PC_ERROR_NUMERICAL; PC_ERROR_DEPENDENCY (Embree).
PC_NODISCARD pc_status pc_skin_closest_triangle(pc_context *context, const pc_mesh *surface,
                                                const pc_mesh *proxy, pc_skin *skin);

/// Closest-triangle weights W, smoothed over the visual mesh by an implicit step of heat flow:
/// (M + t L) X = M W, with the cotangent Laplacian L of the visual mesh (cotangents below 0 count
/// as 0, so that weights stay between 0 and 1), its area matrix M, and t = (h / 4)^2, h the mean
/// length of the proxy's edges: the kinks at the proxy's edges go, the shape of the weights stays.
/// The `influences` largest weights of each row are kept and scaled to the sum 1.
/// @return as pc_skin_inverse_distance; PC_ERROR_NUMERICAL; PC_ERROR_DEPENDENCY (Embree);
///         PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pc_skin_heat_smoothed(pc_context *context, const pc_mesh *surface,
                                             const pc_mesh *proxy, uint32_t influences,
                                             pc_skin *skin);

#ifdef __cplusplus
}
#endif
#endif
