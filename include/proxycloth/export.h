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

/// Writes binary glTF 2.0: the visual mesh skinned to one joint per proxy vertex, the motion as
/// animation, and the proxy as a second mesh.
///
/// - One primitive per material with triangles; vertices are the split vertices in use, with
///   POSITION, NORMAL (smooth ones where the asset has none), TEXCOORD_0 and COLOR_0 where the
///   asset has them, and as many sets JOINTS_n, WEIGHTS_n as the weights need (4 influences each);
///   weights as floats or as integers with exact sums (largest remainder), `skin.weight_storage`.
/// - Joint i is proxy vertex i: flat under one root, node names NAME_joint_0000 and so on, inverse
///   bind matrices that only translate. Skinned meshes have no transform of their own.
/// - Animation "simulation": one LINEAR translation channel per joint, frame f at f * frame_time;
///   for weights of PC_SKINNING_ROTATION also one rotation channel per joint, whose quaternions
///   keep to one hemisphere from frame to frame.
/// - Node NAME_proxy: the proxy mesh, vertex i follows joint i. Its extras hold under "proxycloth"
///   what a cloth solver of an engine needs:
///     version          1
///     joints           names of the joints, in the order of the proxy's vertices
///     triangles        of the proxy, three vertices each
///     skinning         "rotation" where the joints turn: the engine's cloth solver then sets their
///                      rotations too, as proxycloth/rotation.h finds them; absent: they do not
///     pinned           vertices that are held
///     stretch_springs  along the edges, and
///     bend_springs     between the two vertices across an inner edge:
///       vertices       two per spring
///       rest_lengths   one per spring, in the unit of the file
///       stiffness      share of the difference that a whole step takes away, 0..1
///     simulation       pc_simulate_options by name; garment_size: the diagonal in metres to which
///                      the proxy is scaled while it is simulated, 0 where it is not
/// - With `skin.body_blend` or `skin.body_channel` (body.h): the character's joints too, behind the
///   proxy's in the skin, with their names and their tree under the same root. Weights are the
///   mixture of both, the K largest of a vertex; the scenario's clip becomes channels of the same
///   animation. Joints whose maps shear are written as rotation and scale nearest to that.
/// Lengths are written as they are; glTF takes them for metres and y for up.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT (a stage is missing, or the asset is inconsistent);
///         PC_ERROR_TOO_LARGE (above 65536 joints, `skin.max_bones` or 4 GiB); PC_ERROR_IO;
///         PC_ERROR_OUT_OF_MEMORY; with a body also what pc_body_skin_create returns.
PC_NODISCARD pc_status pc_export_glb(pc_context *context, const pc_asset *asset, const char *path);

/// Writes a mesh as Wavefront OBJ; positions read back as the same doubles.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT (NULL, a position that is not finite); PC_ERROR_IO;
///         PC_ERROR_OUT_OF_MEMORY.
PC_NODISCARD pc_status pc_export_obj(pc_context *context, const pc_mesh *mesh, const char *path);

/// Writes the report of the stages done as JSON. Keys: schema (1), versions, name, stage_count,
/// visual.report, stages.STAGE.options and .report, warnings (stage, field, count, message), label
/// (outcome, objective, bound, gap), measures, histograms.SHAPE (maximum, counts; the triangles of
/// the proxy, see pc_evaluate_shape), losses.before and .after (total, rigid, collision,
/// attachment), timings (seconds per stage and total). Only `timings` differs between two runs on
/// the same input. Numbers that are not finite are null.
/// @param[in] measures  NULL: no measures.
/// @param[in] timings   NULL: no seconds.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT; PC_ERROR_IO; PC_ERROR_OUT_OF_MEMORY.
PC_NODISCARD pc_status pc_export_report(pc_context *context, const pc_asset *asset,
                                        const pc_measures *measures, const pc_timings *timings,
                                        const char *path);

typedef struct pc_contact_sheet_options {
    uint32_t tile_size;      ///< pixels of one picture's side, 96..2048
    uint32_t skinned_frames; ///< frames of the motion shown, 0..64, spread evenly up to the last
} pc_contact_sheet_options;

extern const pc_record pc_contact_sheet_options_record;

/// Renders the stages side by side into a PNG, for people who judge cloth by eye.
///
/// Row 1: visual mesh, iso-surface, projected mesh, single layer, proxy, and the visual mesh in the
/// colours of its bones (figure 14: lighter where several bones share the impact) from the front;
/// row 2: the same from the back; then the visual mesh skinned to frames of the motion, with the
/// proxy's edges over it; then the same frames in the colours of their stretch: the largest
/// principal stretch or squeeze of the triangles, 0 grey, 10 % yellow, 20 % red, from 30 % violet.
/// Stages that did not run are left out. All pictures of the first two rows have one scale, all
/// frames one camera: a three-quarter view from slightly above, up is `simulate.up_axis`, the front
/// is +z (y up), -y (z up) or +z (x up). Front sides are grey, back sides blue; the proxy's border
/// edges are drawn bolder. Where two sheets lie on each other the front side is shown. Equal assets
/// give equal bytes.
/// @param[in] options  NULL for the defaults.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT (NULL, no visual mesh, weights or motion of other
///         meshes); PC_ERROR_INVALID_OPTIONS; PC_ERROR_IO; PC_ERROR_OUT_OF_MEMORY;
///         PC_ERROR_CANCELLED; PC_ERROR_DEPENDENCY (libpng failed).
PC_NODISCARD pc_status pc_export_contact_sheet(pc_context *context, const pc_asset *asset,
                                               const pc_contact_sheet_options *options,
                                               const char *path);

typedef struct pc_strip_options {
    uint32_t strip_tile;   ///< pixels of one picture's side, 96..2048
    uint32_t strip_frames; ///< pictures in a row, 2..64
} pc_strip_options;

extern const pc_record pc_strip_options_record;

/// Renders an animation strip into a PNG, four rows of `strip_frames` pictures: a turntable of the
/// visual mesh, the same in the colours of its bones, the skinned visual mesh at frames spread
/// evenly over the motion, and these in the colours of their stretch; see pc_export_contact_sheet.
/// Equal assets give equal bytes.
/// @param[in] options  NULL for the defaults.
/// @return as pc_export_contact_sheet; PC_ERROR_INVALID_ARGUMENT also when a stage is missing.
PC_NODISCARD pc_status pc_export_strip(pc_context *context, const pc_asset *asset,
                                       const pc_strip_options *options, const char *path);

#ifdef __cplusplus
}
#endif
#endif
