/// Stage 6 of 9, carve: projected mesh and labels -> single-layer mesh, carved on request.
///
/// Keeps a triangle when at least two of its corners have label 1, then removes what is left of
/// non-manifold edges, splits non-manifold vertices, drops small parts and fills short loops.
/// A small part stays if it is more than 2 voxels away from the large ones and lies on a component
/// of the visual mesh that they do not cover, but small parts do, for a quarter: a stud, a loose
/// strap.
/// Shallow strips of the outside that the labels leave out (nowhere farther than 3 voxels from
/// their border, a tenth of which is farther than 1.5 voxels from all rims of the garment, and of
/// less than a tenth of the kept area), as beneath the hem of a layer that hangs over another or on
/// top of a leaf, are kept as well; not so the other side of a strap, which has what is kept across
/// and along its border no more than another narrow strip.
/// A strap about as thick as wide is a rod in the graph, of which the labels may leave out all:
/// what lies farther than 2 voxels from what they keep, with more of the same across the solid, is
/// kept all around. Where the labels keep both sides of a sheet (a tenth of the area or more lies
/// back to back within half a voxel), the smaller side is cut off along the hem. A loop is a hole
/// only if its part has twice the area of a disc of that circumference, so that the outer rim of a
/// small part is never closed, and if the projected mesh goes on across it (no farther from its
/// middle than half its mean radius), so that the space beside a strap stays open.
///
/// DEVIATION: cloth that is modelled with its thickness, a closed shell of two skins up to four
/// voxels apart with a rim between them, counts as its outer skin (the larger one). Components that
/// lie within a voxel of larger ones everywhere (linings, pockets, buttons, the second side of a
/// cape) do not count. Where a part is finer than its neighbour, so that vertices of one border lie
/// on the edges of another (within .005 voxels), the two are stitched.
///
/// DEVIATION: a garment that is one clean sheet already (many simulation garments are) needs no
/// labels: the projected mesh can only be farther from it, and closes gaps below two voxels. With
/// `layer_source` auto what counts of the visual mesh is taken itself, repaired to a manifold and
/// with holes of less than 3 voxels around and missing faces (up to six edges around, flat, a
/// hundredth of the part at most) filled, when each of its parts has a border, no two parts come
/// within a voxel of each other, every visual vertex is within a voxel (and the thickness of a
/// shell) of it, other cloth goes on before at most .7 of its border (it is not wound around
/// something), and
/// - at most 2 % of its area sees another sheet within a voxel, or only a second ply does (a hem
///   that is turned in, a lining), which is cut off along its fold, and 99 % of the visual vertices
///   are within two voxels of the rest; or
/// - at most 15 % sees a back behind it, no ply can be cut off with half of the layers, so that the
///   sheet is folded, and the labels give another number of components or loops, or leave 1 % of
///   its vertices more than 2 voxels away. Simplify flattens pleats that are too narrow for the
///   proxy.
///
/// DEVIATION: where the labelled layer bridges gaps (half a percent of its area is more than half a
/// voxel away from the cloth, as between two legs), or has more components than the cloth, the
/// cloth made one sheet is taken instead, if it has as many components and loops, or fewer
/// components, and 99 % of the visual vertices are near it. What has another part before it within
/// four voxels (trousers beneath a shirt) is cut away, the rest sewn to the hem above it, and
/// fronts are closed whose sides are within a voxel, as the labels close them; second plies of a
/// part (hems that are turned in, collars, the inside of a hat) are cut off along their fold. The
/// sheet must then be plain, or folded where parts were sewn.
///
/// DEVIATION: the voxels fill the gaps between the layers of a skirt, and the labels keep one side
/// of the solid or tear it. The part of the cloth that is a clean or folded sheet by itself and
/// that the garment strays from least, as a rule a layer in the middle, is taken instead, if the
/// garment strays less from it than from the layer and more than two voxels from that; or if their
/// components, loops or handles differ, another part has half of its area, and the garment strays
/// at most twice as much from it (or four voxels, and never ten).
///
/// The border of the layer follows the voxels; with `snap_border` it is moved onto the garment's
/// hems within 1.5 voxels (edges of one triangle with no other cloth in front), and the surface
/// behind it follows. Straps of few voxels stay as they are.
///
/// Openings narrower than two voxels (cuffs, a neckline, the foot of a leg) are closed in the
/// iso-surface. Always on: a part of the layer that leaves the visual mesh sideways by more than
/// `carve_distance`, around which the visual mesh ends (rims along .9 of its border and on at
/// least 9 of 12 sides, with the cloth not amid them), and behind which there is no other cloth
/// within 1.5 voxels, nor within 3 cloth that the layer leaves out, as at the bottom of a pouch or
/// a rivet, is such a membrane and is cut out along the isoline of half that distance, so that
/// slits get nearly as deep as they are; with `snap_border` the cut then moves onto the hems. What
/// bridges two surfaces, as between the legs or from a pocket to the coat, has no such rim around
/// it and stays, as does what holds the layer together.
///
/// DEVIATION: such webs, more than half a voxel away from the cloth, are replaced by the walls of
/// the gap that they bridge, where the cloth, or else the other side of the projected mesh, shows
/// these as one piece whose border runs along the web's: legs part at the crotch and sleeves at the
/// armpit again. Cracks in the cloth of up to .02 voxels are closed for that; cloth in looser
/// triangles has no such pieces, and the inside of legs that the voxels fill does not show them:
/// there a finer grid helps.
///
/// With `carve` on, everything farther than `carve_distance` beside the visual mesh is cut away
/// (section 5.1), so that separate parts can move freely.
///
/// DEVIATION: the distance is not geodesic; it is the share along the surface of the straight
/// distance to the nearest point of the visual mesh. The two agree up to gaps of a few voxels, and
/// wider gaps never close.
///
/// Postconditions: manifold with boundary, consistently oriented, no unused vertex.
#ifndef PROXYCLOTH_CARVE_H
#define PROXYCLOTH_CARVE_H

#include "proxycloth/label.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Where the single layer comes from.
typedef enum pc_layer_source {
    PC_LAYER_AUTO = 0,   ///< the visual mesh where it is a single layer already, else the labels
    PC_LAYER_LABELS = 1, ///< always the labelled side of the projected mesh, as in the paper
    PC_LAYER_VISUAL = 2  ///< always the visual mesh, repaired
} pc_layer_source;

typedef struct pc_carve_options {
    uint32_t layer_source; ///< pc_layer_source
    bool carve;            ///< also cut what bridges two surfaces (section 5.1)
    double carve_distance; ///< epsilon_carved, in voxels; regions that reach 1.2 times as far count
    double smallest_part; ///< of the largest part's area; smaller ones near larger ones are dropped
    uint32_t fill_loops;  ///< boundary loops of at most this many edges are filled
    bool snap_border;     ///< move the border onto the garment's hems
} pc_carve_options;

typedef struct pc_carve_report {
    uint32_t source; ///< pc_layer_source, labels or visual
    uint64_t vertices;
    uint64_t triangles;
    uint64_t components;
    uint64_t boundary_loops;
    uint64_t dropped_parts;
    uint64_t filled_loops;
    uint64_t carved_regions;
    uint64_t carved_triangles;
    double coverage; ///< share of the visual mesh's vertices within 2 voxels of the layer
} pc_carve_report;

extern const pc_record pc_carve_options_record;
extern const pc_record pc_carve_report_record;

/// @param[in]  surface       the visual mesh.
/// @param[in]  projected     closed manifold mesh, one label per vertex.
/// @param[in]  cell_size     of the grid it came from; > 0, both meshes at most 65536 of it wide.
/// @param[out] single_layer  zeroed on entry.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT; PC_ERROR_INVALID_OPTIONS; PC_ERROR_NO_PROXY (no
///         triangle is left); PC_ERROR_TOO_LARGE; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY;
///         PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pc_carve(pc_context *context, const pc_mesh *surface,
                                const pc_mesh *projected, const pc_labels *labels, double cell_size,
                                const pc_carve_options *options, pc_mesh *single_layer,
                                pc_carve_report *report);

#ifdef __cplusplus
}
#endif
#endif
