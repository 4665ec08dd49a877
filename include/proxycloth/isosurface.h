/// Stage 2 of 9, isosurface: UDF samples -> closed mesh around the garment (marching cubes).
///
/// The iso-value is one voxel (section 3.1). Cases come from one rule: on a face with two inside
/// corners across a diagonal, the inside corners are always separated, so neighbouring cells agree,
/// and no triangle edge that crosses a cell's interior lies in one of its faces. Missing samples
/// count as outside, at the distance of the band.
///
/// DEVIATION: a vertex stays at least .1 voxels away from the ends of its lattice edge. Where the
/// surface passes a lattice point closer than that, plain interpolation makes slivers that upset
/// curvatures and normals later on; the vertices are projected onto the garment anyway.
///
/// Postconditions for every input: closed, every edge has exactly two triangles that run it in
/// opposite directions, every vertex has one fan, no triangles cross, no edge is shorter than .1
/// voxels; normals point away from the garment. From an iso-value of sqrt(3)/2 = .87 voxels up
/// every point of the garment is enclosed, and what is connected stays so, however thin it is;
/// below that wires and the edges of sheets may break up.
#ifndef PROXYCLOTH_ISOSURFACE_H
#define PROXYCLOTH_ISOSURFACE_H

#include "proxycloth/voxelize.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct pc_isosurface_options {
    double iso_voxels; ///< iso-value in voxels
} pc_isosurface_options;

typedef struct pc_isosurface_report {
    uint64_t vertices;
    uint64_t triangles;
    uint64_t components; ///< closed surfaces; a hollow inside adds one
} pc_isosurface_report;

extern const pc_record pc_isosurface_options_record;
extern const pc_record pc_isosurface_report_record;

/// @param[out] isosurface  zeroed on entry.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT (a grid that breaks its postconditions);
///         PC_ERROR_INVALID_OPTIONS; PC_ERROR_TOO_LARGE; PC_ERROR_OUT_OF_MEMORY;
///         PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pc_isosurface(pc_context *context, const pc_grid *grid,
                                     const pc_isosurface_options *options, pc_mesh *isosurface,
                                     pc_isosurface_report *report);

#ifdef __cplusplus
}
#endif
#endif
