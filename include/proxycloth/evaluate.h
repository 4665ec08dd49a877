/// Measures of a proxy mesh against its visual mesh; independent of how the proxy was made.
#ifndef PROXYCLOTH_EVALUATE_H
#define PROXYCLOTH_EVALUATE_H

#include "proxycloth/mesh.h"
#include "proxycloth/options.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct pc_measures {
    uint64_t vertices;
    uint64_t triangles;
    uint64_t components;
    uint64_t boundary_loops;
    double euler_number; ///< V - E + F, may be negative
    uint64_t nonmanifold_edges;
    uint64_t nonmanifold_vertices;
    double doubled_area; ///< share of the area with a second, nearly parallel layer right behind it
    uint64_t self_intersections; ///< pairs of triangles that cross and share no vertex
    double hausdorff;            ///< two-sided, over the visual mesh's bounding-box diagonal
    double hausdorff_visual_to_proxy;
    double hausdorff_proxy_to_visual;
    double hausdorff_unit_cube; ///< two-sided, visual mesh scaled into [-1, 1]^3
    double min_angle_mean, min_angle_sd, min_angle_worst;          ///< degrees
    double edge_ratio_mean, edge_ratio_sd, edge_ratio_worst;       ///< shortest / longest edge
    double aspect_ratio_mean, aspect_ratio_sd, aspect_ratio_worst; ///< 2/sqrt(3) h_min / l_max
    double radius_ratio_mean, radius_ratio_sd, radius_ratio_worst; ///< 2 r_in / r_circum
} pc_measures;

extern const pc_record pc_measures_record;

/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT; PC_ERROR_INVALID_MESH; PC_ERROR_OUT_OF_MEMORY;
///         PC_ERROR_DEPENDENCY.
PC_NODISCARD pc_status pc_evaluate(pc_context *context, const pc_mesh *visual, const pc_mesh *proxy,
                                   pc_measures *measures);

#ifdef __cplusplus
}
#endif
#endif
