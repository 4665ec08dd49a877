/// Measures of a proxy mesh against its visual mesh; independent of how the proxy was made.
///
/// Any two meshes can be compared: closed, open, non-manifold, with degenerate or duplicate
/// triangles. Positions may be in any unit; only ratios and angles are reported.
/// - Topology. Triangles with a repeated vertex are no part of the surface. Vertices are equal when
///   their indices are; the winding does not matter. Parts and loops that meet at a vertex only are
///   counted separately (and the vertex as non-manifold): neither a cloth solver nor cloth connects
///   them.
/// - Doubled area. 4096 area-uniform samples; one is doubled when the line through it along the
///   normal hits, within D / 16 on either side (two voxels at the paper's resolution; D = longest
///   side of the visual mesh's box), a triangle that shares no vertex with the sampled one and is
///   parallel to it within 37 degrees. A closed shell around thin cloth gives 1, a single layer 0,
///   and so do hems and close folds whose walls are neighbours; garments that really lie in two
///   layers this close, for example a folded shirt, count too, and so do the sides of a thin
///   sleeve. Standard error at most .008.
/// - Doubled layers. The part of it in which the proxy has more layers than the garment: the sheets
///   of the visual mesh that are closest to the sample and to another such layer are less than
///   D / 32 apart along the same line. So linings and the sides of thick cloth are one sheet; a
///   sleeve narrower than that cannot be told from them and counts. Where two layers show each
///   other their outsides, as two legs or the walls of a fold do, what is between them is no cloth:
///   there they are over one sheet only if the line meets no second one either, between them or up
///   to D / 64 behind them. Outside is the side that looks away from the proxy's middle, on the whole.
///   The sides of a wider sleeve give 0, two layers over a single one 1, a proxy of one layer
///   always 0.
/// - Self-intersections. Pairs that share an edge never count; pairs that share a vertex do when
///   they cross beyond it. Touching and coplanar overlap are no crossing.
/// - Distances. Hausdorff distances between the surfaces, not only their vertices, by branch and
///   bound: attained, and below the true value by at most 1e-4 of the diagonal and 1e-4 of the
///   distance. The paper's unit is taken to be `hausdorff_unit_cube`.
/// - Boundary. The garment's openings are the edges of its visual mesh that belong to one triangle
///   (copies count once) and have no other cloth in front of them: the point that is D / 32 (one
///   voxel at the paper's resolution) in front of the hem is at least half of that away from all
///   cloth. Seams of panels that are not joined and pockets are no openings, and a garment of
///   closed shells has none. Distances between these hems and the proxy's boundary edges, both
///   ways, over the diagonal, at points at most 1/500 of the diagonal apart; 1 when only one of the
///   two meshes has a boundary, 0 when neither has.
/// - Shape. Mean, standard deviation over the triangles, and the worst one; 0 for a triangle
///   without area, 1 (60 degrees) for an equilateral one.
#ifndef PROXYCLOTH_EVALUATE_H
#define PROXYCLOTH_EVALUATE_H

#include "proxycloth/mesh.h"
#include "proxycloth/options.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct pc_measures {
    uint64_t vertices;             ///< that a triangle uses
    uint64_t triangles;            ///< all
    uint64_t components;           ///< connected by shared edges
    uint64_t boundary_loops;       ///< of edges with one triangle
    double euler_number;           ///< V - E + F, may be negative
    uint64_t nonmanifold_edges;    ///< of more than two triangles
    uint64_t nonmanifold_vertices; ///< whose triangles form more than one fan
    double doubled_area;           ///< share of the area with a second layer close by, 0..1
    double doubled_layers;         ///< the part of it over one sheet of the visual mesh, 0..1
    uint64_t self_intersections;   ///< pairs of triangles that cross
    double hausdorff;              ///< two-sided, over the visual mesh's bounding-box diagonal
    double hausdorff_visual_to_proxy;
    double hausdorff_proxy_to_visual;
    double hausdorff_unit_cube; ///< two-sided, visual mesh scaled into [-1, 1]^3
    double opening_length;      ///< of the garment's hems
    double boundary_length;     ///< of the proxy's boundary
    double boundary_to_opening_mean, boundary_to_opening_max;      ///< proxy's boundary to the hems
    double opening_to_boundary_mean, opening_to_boundary_max;      ///< hems to the proxy's boundary
    double min_angle_mean, min_angle_sd, min_angle_worst;          ///< degrees
    double edge_ratio_mean, edge_ratio_sd, edge_ratio_worst;       ///< shortest / longest edge
    double aspect_ratio_mean, aspect_ratio_sd, aspect_ratio_worst; ///< h_min / l_max
    double radius_ratio_mean, radius_ratio_sd, radius_ratio_worst; ///< 2 r_in / r_circum
} pc_measures;

extern const pc_record pc_measures_record;

/// Measures `proxy` against `visual`.
/// @param[out] measures  overwritten; all zero on failure.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT (NULL); PC_ERROR_INVALID_MESH (no triangle, index out
///         of range, coordinate not finite or beyond 1e33, all positions of `visual` equal);
///         PC_ERROR_TOO_LARGE; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY (Embree failed).
PC_NODISCARD pc_status pc_evaluate(pc_context *context, const pc_mesh *visual, const pc_mesh *proxy,
                                   pc_measures *measures);

/// Measures of a triangle's shape, as in figure 10.
typedef enum pc_shape {
    PC_SHAPE_MIN_ANGLE = 0, ///< degrees, 0..60
    PC_SHAPE_EDGE_RATIO,    ///< 0..1
    PC_SHAPE_ASPECT_RATIO,  ///< 0...866
    PC_SHAPE_RADIUS_RATIO,  ///< 0..1
    PC_SHAPE_COUNT
} pc_shape;

#define PC_HISTOGRAM_BINS 20

/// Number of triangles per bin; bins share 0..maximum evenly, the last one includes its upper end.
typedef struct pc_histogram {
    const char *name; ///< as in pc_measures, without _mean
    double maximum;   ///< 60 for the angle, 1 for the ratios
    uint64_t counts[PC_HISTOGRAM_BINS];
} pc_histogram;

/// Counts the triangles of a mesh by their shape.
/// @param[out] histograms  overwritten; all zero on failure.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT (NULL); PC_ERROR_INVALID_MESH and PC_ERROR_TOO_LARGE as
///         pc_evaluate.
PC_NODISCARD pc_status pc_evaluate_shape(pc_context *context, const pc_mesh *mesh,
                                         pc_histogram histograms[PC_SHAPE_COUNT]);

#ifdef __cplusplus
}
#endif
#endif
