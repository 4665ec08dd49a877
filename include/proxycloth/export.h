/// Export: a finished asset -> files that engines and people open.
///
/// Every file is written to a temporary name beside its target and renamed when it is complete.
#ifndef PROXYCLOTH_EXPORT_H
#define PROXYCLOTH_EXPORT_H

#include "proxycloth/evaluate.h"
#include "proxycloth/pipeline.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Writes binary glTF 2.0: the visual mesh with its texture coordinates, normals and materials,
/// skinned to one joint per proxy vertex (joint order = proxy vertex order, flat under one root,
/// inverse bind matrices that are translations), the motion as translation animation, and the proxy
/// as a second mesh. `extras` of the proxy node hold its triangles, pins, springs and joint order.
PC_NODISCARD pc_status pc_export_glb(pc_context *context, const pc_asset *asset, const char *path);

/// Writes a mesh as Wavefront OBJ, with as many digits as doubles need.
PC_NODISCARD pc_status pc_export_obj(pc_context *context, const pc_mesh *mesh, const char *path);

/// Writes the report as JSON: versions, options, counts, warnings, measures, losses, and, in an
/// object of its own, the seconds of each stage.
/// @param[in] timings  NULL: no seconds.
PC_NODISCARD pc_status pc_export_report(pc_context *context, const pc_asset *asset,
                                        const pc_measures *measures, const pc_timings *timings,
                                        const char *path);

typedef struct pc_contact_sheet_options {
    uint32_t tile_size;      ///< pixels of one view's side
    uint32_t skinned_frames; ///< how many frames of the motion are shown
} pc_contact_sheet_options;

extern const pc_record pc_contact_sheet_options_record;

/// Renders the stages side by side into a PNG: visual, iso-surface, projected, single layer, proxy,
/// skinned frames. Front sides are grey, back sides blue; edges of the proxy are drawn.
PC_NODISCARD pc_status pc_export_contact_sheet(pc_context *context, const pc_asset *asset,
                                               const pc_contact_sheet_options *options,
                                               const char *path);

#ifdef __cplusplus
}
#endif
#endif
