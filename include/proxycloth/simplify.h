/// Stage 7 of 9, simplify: single-layer mesh -> proxy mesh with exactly N_p vertices.
///
/// Clusters the vertices into a centroidal Voronoi diagram (section 3.4, Valette and Chassery
/// 2004); meshes that are too coarse are subdivided first. One proxy vertex per cluster, one
/// triangle where three clusters meet. Cost: O(n log n) in the larger of the single layer's
/// vertices and 16 N_p.
///
/// DEVIATION from the paper, because clusters wider than a sleeve or a strap leave flaps and holes:
/// - The dual mesh is made by contracting each cluster with edge collapses that keep the topology
///   (link condition), instead of removing non-manifold triangles afterwards. The proxy has the
///   components, boundary loops and Euler number of the single layer by construction.
/// - Pleats that are narrower than the edges can follow would crumple and double the proxy: where
///   most of the surface stands in such pleats (its normals agree with their mean within an edge
///   length by a mean cosine of .7 at most), the proxy is made of the sheet amid them. The more
///   vertices, the more pleats stay. Thin tubes do not count.
/// - Clusters get smaller around narrow parts (`narrow_refinement`).
/// - Corners of the border (of hems and collars, tips of slits and necklines) get a cluster and a
///   vertex each, however close together they are: both sides of a slit keep theirs. At most a
///   quarter of the clusters, the sharpest corners first. Slits and notches that are less deep than
///   .55 expected edge lengths, and narrower than half of one, are closed instead: the hem runs
///   straight across.
/// - A tube behind an opening, such as a sleeve or a leg, that is three to five clusters around is
///   mapped conformally to a cylinder and gets rings of equally many clusters, one straight behind
///   the other, instead of clusters that wind around it in zigzag: a prism with the opening as its
///   first ring. It ends where its circumference begins to grow fast, as at an armpit or a crotch.
/// - Vertices leave the centroids: they slide and edges flip towards even triangles, border
///   vertices stay on the border and its corners, then the faces are fitted to the single layer
///   and it to them, with weight on the largest distances; no vertex goes farther than .15 wanted
///   edge lengths from it, which is what a tube of three edges around needs. Edges that bridge a
///   fold flip into it, and vertices around what is farthest from the faces at last, by more than
///   .2 expected edge lengths (.14 at borders), slide along the surface or the border to bring it
///   nearer, onto ridges and into bends of hems, unless that leaves angles below 34 degrees.
/// - Triangles with an angle below 36 degrees are treated one by one: their vertices search better
///   places, edges collapse, and the longest ones elsewhere are split instead. So sleeves stay
///   tubes of at least three edges around, and straps become strips one triangle wide. What is
///   narrower still is widened, by at most .7 edge lengths.
/// - Where the proxy crosses itself it is pushed apart; then vertices move alone and together, and
///   edges flip, to the nearest state without crossings and angles below 20 degrees. Where that
///   fails, or a vertex of the single layer is left half a wanted edge length away, as where two
///   sides of a leg have fallen together, other clusters are tried, up to eight times (`attempts`),
///   and the best proxy is kept. What is left is in `self_intersections`.
///
/// Symmetry (`mirror`): a single layer that a reflection across the x, y or z axis leaves within
/// .25 expected edge lengths of itself, its border too, is cut along that plane. The proxy is that
/// of one half, with vertices on the plane that both share, and its exact mirror image. Of several
/// planes the one that cuts the least is taken, of two proxies the one with the larger angles.
/// Where three attempts give none without flaw, with pleats that are flattened, and with a density
/// map, the garment is taken whole. Off by default: where the plane meets a hem, angles are at most
/// 45 degrees, thin tubes that it cuts lengthwise have no rings, and parts that it cuts share the
/// vertices less evenly.
///
/// Density map: an artist may paint where the proxy needs more vertices into a channel of the
/// visual mesh's vertex colors. Value c at the nearest point of the visual mesh makes wanted edges
/// density_range^c times shorter than where it is 0; only differences count, because the number of
/// vertices stays. Wanted lengths grow by at most 0.3 per unit of way, so that sizes pass smoothly
/// into each other, and what narrow parts need is a lower limit. Alpha suits well: engines ignore
/// it on opaque materials.
///
/// Method `joint` is the paper's comparison in section 5.2 (figure 16, top) and there to repeat it
/// on any garment, not to make proxies: quadric edge collapses (Garland and Heckbert 1997) whose
/// energy counts the visual vertices that follow the proxy in poses of the paper's wind, with
/// weights of equation (7) in the loop. It gives uneven triangles, as the paper says. Of the other
/// options only `vertices` and `seed` count for it. The postconditions hold.
///
/// Input that is not manifold is repaired first. Postconditions: manifold with boundary,
/// consistently oriented, three different vertices per triangle, no unused vertex. `shortfall` says
/// why the count is not N_p where topology does not allow it.
#ifndef PROXYCLOTH_SIMPLIFY_H
#define PROXYCLOTH_SIMPLIFY_H

#include "proxycloth/mesh.h"
#include "proxycloth/options.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Why the proxy has another number of vertices than asked for.
typedef enum pc_simplify_shortfall {
    PC_SHORTFALL_NONE = 0,
    PC_SHORTFALL_TOPOLOGY = 1, ///< the surface cannot be made of so few vertices
    PC_SHORTFALL_BUDGET = 2    ///< parts were dropped that N_p vertices cannot represent
} pc_simplify_shortfall;

/// Where the density map is read from.
typedef enum pc_density_channel {
    PC_DENSITY_NONE = 0,
    PC_DENSITY_RED,
    PC_DENSITY_GREEN,
    PC_DENSITY_BLUE,
    PC_DENSITY_ALPHA
} pc_density_channel;

typedef enum pc_simplify_method {
    PC_SIMPLIFY_CLUSTERS = 0, ///< centroidal Voronoi diagram, then contraction and fit
    PC_SIMPLIFY_JOINT = 1     ///< edge collapses with weights in the loop, for comparison
} pc_simplify_method;

typedef struct pc_simplify_options {
    uint32_t vertices;              ///< N_p
    uint32_t method;                ///< pc_simplify_method
    double narrow_refinement;       ///< longest over shortest edges; 1 is the paper's uniform mesh
    uint32_t density_channel;       ///< pc_density_channel
    double density_range;           ///< longest over shortest edges by the density map
    uint32_t clustering_iterations; ///< passes of boundary exchanges
    uint32_t seed;                  ///< picks the vertex of the first cluster
    bool mirror;                    ///< symmetric garments get symmetric proxies
} pc_simplify_options;

typedef struct pc_simplify_report {
    uint64_t vertices;
    uint64_t triangles;
    uint64_t components;
    uint64_t boundary_loops;
    uint64_t removed_triangles; ///< by the manifold repair
    uint64_t split_vertices;
    uint64_t dropped_parts;      ///< parts too small for N_p
    uint64_t surplus_vertices;   ///< that narrow parts needed on top of one per cluster
    bool density_ignored;        ///< the visual mesh has no vertex colors
    uint64_t self_intersections; ///< pairs of triangles that still cross
    uint64_t attempts;           ///< proxies that were made, the last or the best of them kept
    uint64_t iterations;
    uint32_t shortfall; ///< pc_simplify_shortfall
    bool mirrored;      ///< one half of the proxy is the exact mirror image of the other
} pc_simplify_report;

extern const pc_record pc_simplify_options_record;
extern const pc_record pc_simplify_report_record;

/// @param[in]  visual        its vertex colors may hold a density map; NULL: none (not for
/// `joint`).
/// @param[in]  single_layer  any triangle mesh, as a rule manifold with boundary.
/// @param[out] proxy         zeroed on entry.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT; PC_ERROR_INVALID_OPTIONS; PC_ERROR_TOO_LARGE;
///         PC_ERROR_NO_PROXY (no triangle, or no area); PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY
///         (Embree); PC_ERROR_CANCELLED; by `joint` also those of pc_simulate and pc_skin_optimize.
PC_NODISCARD pc_status pc_simplify(pc_context *context, const pc_visual *visual,
                                   const pc_mesh *single_layer, const pc_simplify_options *options,
                                   pc_mesh *proxy, pc_simplify_report *report);

#ifdef __cplusplus
}
#endif
#endif
