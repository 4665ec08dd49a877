/// The asset file: HDF5 with the result, the options and the report of every stage that ran.
///
/// Layout, format version 1. Scalars are attributes, arrays are datasets; groups of stages that did
/// not run are absent. The same asset always gives the same bytes (no times, no paths).
///   /                 attributes: format "proxycloth asset", format_version, library_version,
///                     name, stage_count
///   /visual           positions, triangles, corner_vertices, corner_triangles, normals, texcoords,
///                     colors, triangle_materials, materials; attributes: the report
///   /voxelize         samples, values; attributes: origin, cell_size, size, band
///   /isosurface       positions, triangles
///   /project          positions, triangles
///   /graph            curvatures, outer_distances, edges, edge_weights, opposites, opposite_signs
///   /label            labels
///   /carve            positions, triangles
///   /simplify         positions, triangles
///   /simulate         positions (#frames by #V by 3), pinned; attribute: frame_time
///   /skin             bones, weights
/// and in each stage's group the groups `options` and `report`, one attribute per field.
#ifndef PROXYCLOTH_ASSET_FILE_H
#define PROXYCLOTH_ASSET_FILE_H

#include "proxycloth/pipeline.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Written to `format_version`; readers accept this and older ones, and refuse newer ones.
#define PC_ASSET_FORMAT_VERSION 1

/// Writes the asset to a temporary file beside `path`, then renames it.
/// @return PC_OK; PC_ERROR_IO (with the path and the cause); PC_ERROR_OUT_OF_MEMORY.
PC_NODISCARD pc_status pc_asset_save(pc_context *context, const pc_asset *asset, const char *path);

/// Reads an asset and checks every count and index in it.
/// @param[out] asset  zeroed on entry; empty on failure.
/// @return PC_OK; PC_ERROR_IO; PC_ERROR_FORMAT (not HDF5, another kind, newer, damaged);
///         PC_ERROR_OUT_OF_MEMORY.
PC_NODISCARD pc_status pc_asset_load(pc_context *context, const char *path, pc_asset *asset);

#ifdef __cplusplus
}
#endif
#endif
