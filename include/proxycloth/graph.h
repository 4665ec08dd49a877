/// Stage 4 of 9, graph: projected mesh -> guide graph of section 3.3.
///
/// Mesh edges carry the smoothness weight w_s of equation (3), from mean curvature by a quadric fit
/// to the 2-ring. Opposite edges connect vertices on the two sides of a thin sheet, found by a ray
/// along the negative normal, and know which side is the outer one (distance d to the first hit
/// along the positive normal; infinite where there is none).
///
/// DEVIATION from the paper, because the two sheets interpenetrate after projection: the inward ray
/// starts `inward_offset` outside the vertex and accepts back faces only; the outward ray starts at
/// `outward_offset`.
///
/// DEVIATION: a sleeve or leg narrower than two voxels is a solid rod in the iso-surface, and the
/// paper's rule would take its two halves for the two sides of a sheet and cut it open lengthwise.
/// Where the solid is a rod (`tube_aspect`), vertices have no opposite.
#ifndef PROXYCLOTH_GRAPH_H
#define PROXYCLOTH_GRAPH_H

#include "proxycloth/mesh.h"
#include "proxycloth/options.h"

#ifdef __cplusplus
extern "C" {
#endif

/// The guide graph; an instance of the labelling problem.
typedef struct pc_graph {
    size_t vertex_count;
    double *curvatures;      ///< #V, absolute mean curvature, 1 / unit of the input; may be NULL
    double *outer_distances; ///< #V, d of section 3.3, INFINITY allowed; may be NULL
    size_t edge_count;
    uint32_t *edges;      ///< #E by 2, mesh edges, first < second, ascending
    double *edge_weights; ///< #E, w_s in [0, 1]
    size_t opposite_count;
    uint32_t *opposites;    ///< #O by 2, first < second, ascending, without duplicates
    int8_t *opposite_signs; ///< #O, sign(d_first - d_second): -1, 0 (no bias term) or 1
} pc_graph;

/// Releases the arrays and zeroes the struct. NULL is accepted.
void pc_graph_free(pc_context *context, pc_graph *graph);

typedef struct pc_graph_options {
    double opposite_reach; ///< in voxels; 2 D / N_o of the paper
    /// epsilon_o: n_i . n_j < -1 + epsilon_o. Small values leave the sides of wrinkled or tight
    /// sheets without mates, which closes openings and keeps doubled layers.
    double opposite_epsilon;
    double inward_offset;  ///< in voxels
    double outward_offset; ///< in voxels
    /// A solid at least a voxel thick is a rod where it is less than so many times as wide as
    /// thick; 0: everything is a sheet, as in the paper.
    double tube_aspect;
} pc_graph_options;

typedef struct pc_graph_report {
    uint64_t edges;
    uint64_t opposite_edges;
    uint64_t biased_edges;    ///< opposite edges with sign != 0
    double opposite_fraction; ///< vertices with at least one opposite vertex
    double max_curvature;     ///< kappa, 1 / voxel
} pc_graph_report;

extern const pc_record pc_graph_options_record;
extern const pc_record pc_graph_report_record;

/// @param[in]  projected  closed manifold mesh.
/// @param[in]  cell_size  of the grid the mesh came from; > 0, the mesh at most 65536 of it wide.
/// @param[out] graph      zeroed on entry.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT; PC_ERROR_INVALID_OPTIONS; PC_ERROR_TOO_LARGE;
///         PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY; PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pc_build_graph(pc_context *context, const pc_mesh *projected,
                                      double cell_size, const pc_graph_options *options,
                                      pc_graph *graph, pc_graph_report *report);

#ifdef __cplusplus
}
#endif
#endif
