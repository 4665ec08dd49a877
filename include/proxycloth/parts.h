/// Parts: a file that holds several garments (a top and a skirt) -> one visual mesh per garment.
///
/// The pipeline makes one proxy of whatever is in the visual mesh, with a component for every piece
/// that the grid can tell from the others. Where each garment should get an asset of its own, split
/// the visual mesh first, share the vertices, and run the pipeline on each part.
///
/// What a part is: pieces of the surface share no position, and less than a quarter of the border
/// of each runs within 0.01 of the diagonal along the border of another one: what does is sewn
/// together (the panels of a pattern, a sleeve at its armhole). They are taken by area, largest
/// first. A piece joins an earlier part
/// - when at least half of its area is nearer to that part than 0.01 of the diagonal of the mesh
///   (linings, pockets, patches), the part that covers most of it;
/// - when its area is below 0.02 of the whole (buttons, studs, links of a chain), the nearest part;
/// and is a part of its own otherwise. So a part is as much of a garment as moves together, and
/// every triangle belongs to exactly one part. There are at most 50.
#ifndef PROXYCLOTH_PARTS_H
#define PROXYCLOTH_PARTS_H

#include "proxycloth/mesh.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct pc_parts {
    size_t part_count;
    pc_visual *visuals;        ///< #parts, by area of the first piece, largest first
    pc_visual_report *reports; ///< #parts
} pc_parts;

/// Releases the arrays and zeroes the struct. NULL is accepted.
void pc_parts_free(pc_context *context, pc_parts *parts);

/// Splits a visual mesh. Triangles and split vertices keep their order; materials that a part does
/// not use are left out. One part is a copy.
/// @param[out] parts  zeroed on entry.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT (NULL, no triangle, output not empty);
///         PC_ERROR_INVALID_MESH (a part that pc_visual_create refuses); PC_ERROR_TOO_LARGE;
///         PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY (Embree); PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pc_split_visual(pc_context *context, const pc_visual *visual,
                                       pc_parts *parts);

/// Shares a number of proxy vertices between parts by area: every part gets at least 4, and the
/// shares add up to `vertices` where that is at least 4 per part. Ties go to the earlier part.
/// @param[in]  areas   #parts, at least 0, for example of the single layers.
/// @param[out] shares  #parts.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT (NULL, no part, an area that is negative or not
/// finite).
PC_NODISCARD pc_status pc_share_vertices(pc_context *context, size_t part_count,
                                         const double *areas, uint32_t vertices, uint32_t *shares);

#ifdef __cplusplus
}
#endif
#endif
