/// The asset file: HDF5 with the result, the options and the report of every stage that ran.
///
/// Layout, format version 1. Scalars are attributes, arrays are datasets; groups of stages that did
/// not run are absent. The same asset always gives the same bytes (no times, no paths), and saving
/// what was loaded gives the file that was loaded.
///   /                 attributes: format "proxycloth asset", format_version, library_version,
///                     name, stage_count
///   /visual           positions, triangles, corner_vertices, corner_triangles, normals, texcoords,
///                     colors, triangle_materials, materials (a table: name, base_color, metallic,
///                     roughness, double_sided), part_names, triangle_parts, joints,
///                     joint_weights; of pc_character: joint_names, joint_centers,
///                     joint_parents, clip_names,
///                     clip_poses, clip_rates, poses, body_positions, body_triangles,
///                     body_part_names, body_triangle_parts, body_joints, body_weights
///   /voxelize         samples, values; attributes: origin, cell_size, size, band
///   /isosurface       positions, triangles
///   /project          positions, triangles
///   /graph            curvatures, outer_distances, edges, edge_weights, opposites, opposite_signs
///   /label            labels
///   /carve            positions, triangles
///   /simplify         positions, triangles
///   /simulate         positions (#frames by #V by 3), pinned, scenario (its JSON text as bytes,
///                     without the options); attribute: frame_time
///   /skin             bones, weights; attribute: skinning (pc_skinning; absent: 0)
/// and in each group the groups `options` (not in /visual) and `report`, one attribute per field.
/// normals, texcoords, colors, curvatures, outer_distances, everything of parts, joints and
/// pc_character, and an empty scenario are absent where they are NULL.
/// Numbers are little-endian with the size that they have in memory, bool is a byte, a choice is
/// stored as its name. Fields that a file lacks take their default (options) or 0 (reports), fields
/// that the library does not know are ignored: a new field alone needs no new format version.
///
/// After the part that belongs to HDF5 follow 16 bytes that HDF5 programs ignore: "pc-asset" and
/// the 64-bit FNV-1a hash of all bytes before, little-endian. A file without them, or with another
/// hash, is refused; so a program that changes an asset file makes it unreadable here.
///
/// HDF5 keeps its state per process: where it was built without thread safety (Debian's is safe),
/// one thread at a time may save or load.
#ifndef PROXYCLOTH_ASSET_FILE_H
#define PROXYCLOTH_ASSET_FILE_H

#include "proxycloth/pipeline.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Written to `format_version`; readers accept this and older ones, and refuse newer ones.
#define PC_ASSET_FORMAT_VERSION 1

/// Writes the asset to a temporary file beside `path`, then renames it. What was at `path` stays
/// when anything fails; only a regular file is replaced.
/// @param[in] asset  with a visual mesh; results beyond `stage_count` are not written.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT (no visual mesh, or counts, indices or values that
///         break what the structs promise); PC_ERROR_IO (with the path and the cause);
///         PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY (HDF5).
PC_NODISCARD pc_status pc_asset_save(pc_context *context, const pc_asset *asset, const char *path);

/// Reads an asset and checks its hash and every count, index and value in it. Needs no more memory
/// than a small multiple of the file's size.
/// @param[out] asset  zeroed on entry; empty on failure.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT; PC_ERROR_IO (with the path and the cause);
///         PC_ERROR_FORMAT (not HDF5, another kind, newer, damaged; with the path and the place);
///         PC_ERROR_OUT_OF_MEMORY.
PC_NODISCARD pc_status pc_asset_load(pc_context *context, const char *path, pc_asset *asset);

#ifdef __cplusplus
}
#endif
#endif
