/// Stage 1 of 9, voxelize: visual mesh -> samples of its unsigned distance field (UDF).
///
/// The field is sampled on a lattice with spacing D/N_v (section 3.1), D being the longest side of
/// the bounding box. Only samples near the surface are kept, so memory and time grow with its area
/// (about N_v^2), not with N_v^3. Distances are exact: candidates come from a tree of boxes,
/// the point-triangle distance is computed in double, then stored in float.
///
/// The lattice is centred on the bounding box. It reaches at least 3.5 cells beyond, with an offset
/// of half a cell, so that flat parts of a garment lie between lattice planes. The band is 2.75
/// cells: all corners of a cell that holds an iso-surface of up to one cell.
///
/// auto chooses N_v from the garment. An opening (neck, cuff, slit, the inside of a narrow sleeve,
/// the space between sleeve and body) stays open where it is wider than the two voxels that the
/// iso-surface takes from it, and each tunnel through the iso-surface, counted by its genus, is one
/// that stayed open. auto counts at N_v = 20, 25, 32, 40, 51, ..., 128, three levels per doubling.
/// Three levels in a row that agree make sure of the openings, a single level that differs between
/// two that agree being an accident of the lattice. auto takes the finest three that agree, or the
/// coarsest three with as many tunnels, and of these the third: the openings are then about three
/// voxels wide or more.
///
/// - The floor is 32, also where no three levels agree (crumpled cloth); the ceiling is 128.
/// - Layers of cloth (linings, folds, the sides of thick fabric) stay together: a proxy has one
///   layer. Where they come apart the iso-surface gains area, which it does not where a tube opens.
///   auto goes no further than to 10 % more than the coarser levels have.
/// - Parts thinner than a voxel need no finer ones: the iso-surface encloses sheets, ribbons, wires
///   and points of any thickness. A thin sleeve or leg is an opening by its inside.
///
/// Postconditions: `samples` ascend strictly; every lattice point closer than `band` is present;
/// the outermost lattice layer is farther than `band` from the surface.
#ifndef PROXYCLOTH_VOXELIZE_H
#define PROXYCLOTH_VOXELIZE_H

#include "proxycloth/mesh.h"
#include "proxycloth/options.h"

#ifdef __cplusplus
extern "C" {
#endif

/// A scalar field on the lattice points near a surface.
typedef struct pc_grid {
    double origin[3]; ///< position of lattice point (0, 0, 0)
    double cell_size; ///< D/N_v
    uint32_t size[3]; ///< lattice points along each axis
    double band;      ///< every lattice point closer than this is a sample
    size_t sample_count;
    uint64_t *samples; ///< x + size[0] * (y + size[1] * z), strictly ascending
    float *values;     ///< distance to the surface at each sample
} pc_grid;

/// Releases the arrays and zeroes the struct. NULL is accepted.
void pc_grid_free(pc_context *context, pc_grid *grid);

/// Value of `voxels` that stands for auto, and what auto takes at least and at most.
#define PC_VOXELS_AUTO    0
#define PC_VOXELS_FLOOR   32
#define PC_VOXELS_CEILING 128

typedef struct pc_voxelize_options {
    uint32_t voxels; ///< N_v, cells along the longest side of the bounding box; or auto
} pc_voxelize_options;

typedef struct pc_voxelize_report {
    uint32_t voxels; ///< N_v of the grid
    double cell_size;
    uint64_t samples;
    uint64_t queries; ///< exact distances computed, including those that only pruned space
    // 0 unless auto chose N_v. Widths are two voxels, in input units, of the coarsest level where
    // these tunnels show, and where layers of cloth come apart (0: nowhere up to the ceiling).
    uint64_t tunnels; ///< through the iso-surface; one less than the openings of a tunic
    double narrowest_opening;
    double layer_gap;
} pc_voxelize_report;

extern const pc_record pc_voxelize_options_record;
extern const pc_record pc_voxelize_report_record;

/// @param[in]  surface  triangles of the visual mesh; degenerate ones count as segments or points.
/// @param[in]  options  NULL for the defaults.
/// @param[out] grid     zeroed on entry.
/// @param[out] report   may be NULL.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT; PC_ERROR_INVALID_OPTIONS; PC_ERROR_TOO_LARGE;
///         PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY (Embree); PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pc_voxelize(pc_context *context, const pc_mesh *surface,
                                   const pc_voxelize_options *options, pc_grid *grid,
                                   pc_voxelize_report *report);

#ifdef __cplusplus
}
#endif
#endif
