/// All stages in order, the asset that holds their results, and the table that describes them.
#ifndef PROXYCLOTH_PIPELINE_H
#define PROXYCLOTH_PIPELINE_H

#include "proxycloth/carve.h"
#include "proxycloth/graph.h"
#include "proxycloth/isosurface.h"
#include "proxycloth/label.h"
#include "proxycloth/project.h"
#include "proxycloth/simplify.h"
#include "proxycloth/simulate.h"
#include "proxycloth/skin.h"
#include "proxycloth/voxelize.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Stages in the order in which data flows.
typedef enum pc_stage {
    PC_STAGE_VOXELIZE = 0,
    PC_STAGE_ISOSURFACE,
    PC_STAGE_PROJECT,
    PC_STAGE_GRAPH,
    PC_STAGE_LABEL,
    PC_STAGE_CARVE,
    PC_STAGE_SIMPLIFY,
    PC_STAGE_SIMULATE,
    PC_STAGE_SKIN,
    PC_STAGE_COUNT
} pc_stage;

/// Options of every stage.
typedef struct pc_options {
    pc_voxelize_options voxelize;
    pc_isosurface_options isosurface;
    pc_project_options project;
    pc_graph_options graph;
    pc_label_options label;
    pc_carve_options carve;
    pc_simplify_options simplify;
    pc_simulate_options simulate;
    pc_skin_options skin;
} pc_options;

/// Reports of the input and every stage.
typedef struct pc_reports {
    pc_visual_report visual;
    pc_voxelize_report voxelize;
    pc_isosurface_report isosurface;
    pc_project_report project;
    pc_graph_report graph;
    pc_label_report label;
    pc_carve_report carve;
    pc_simplify_report simplify;
    pc_simulate_report simulate;
    pc_skin_report skin;
} pc_reports;

/// A garment on its way through the pipeline: input, results, options and reports of each stage.
typedef struct pc_asset {
    char name[128];       ///< of the garment, for file names; UTF-8
    uint32_t stage_count; ///< stages done; results of later ones are empty
    pc_options options;   ///< of the stages done, as they were used
    pc_reports reports;
    pc_visual visual;
    pc_character character; ///< the rest of the input: skeleton, clips, body; may be empty
    pc_scenario scenario;   ///< what the proxy goes through; zero: the paper's
    pc_grid grid;
    pc_mesh isosurface;
    pc_mesh projected;
    pc_graph graph;
    pc_labels labels;
    pc_mesh single_layer;
    pc_mesh proxy;
    pc_motion motion;
    pc_skin skin;
} pc_asset;

/// Releases the arrays and zeroes the struct. NULL is accepted.
void pc_asset_free(pc_context *context, pc_asset *asset);

/// One stage as data: its name, its options and report, and where they are in the structs above.
typedef struct pc_stage_info {
    const char *name;
    const char *summary;
    const pc_record *options;
    size_t options_offset; ///< in pc_options
    const pc_record *report;
    size_t report_offset; ///< in pc_reports
} pc_stage_info;

/// Description of a stage; NULL for PC_STAGE_COUNT and above.
const pc_stage_info *pc_stage_describe(pc_stage stage);

/// Description of the counts in pc_visual_report.
extern const pc_record pc_visual_report_record;

/// Defaults of every option.
pc_options pc_default_options(void);

/// Seconds of each stage in the last pc_build or pc_run_stage call.
typedef struct pc_timings {
    double seconds[PC_STAGE_COUNT];
} pc_timings;

/// Runs one stage on the results of the one before, with options->STAGE; drops the results of later
/// stages.
/// @param[in,out] asset    with at least `stage` stages done.
/// @param[out]    timings  may be NULL.
/// @return what the stage returns; PC_ERROR_INVALID_ARGUMENT when an earlier stage is missing.
PC_NODISCARD pc_status pc_run_stage(pc_context *context, pc_stage stage, const pc_options *options,
                                    pc_asset *asset, pc_timings *timings);

/// Runs `first` and all later stages on the results of the ones before.
///
/// Proxies of several sizes (levels of detail) share what does not depend on the size: build once,
/// then for every further level set options->simplify.vertices, call this with PC_STAGE_SIMPLIFY,
/// and export. Every level is an asset of its own, with its own motion and weights, so that each
/// can be simulated alone.
/// @param[in,out] asset    with at least `first` stages done. On failure the results up to the
///                         failing stage remain.
/// @param[in,out] timings  may be NULL; the seconds of earlier stages stay.
PC_NODISCARD pc_status pc_build_from(pc_context *context, pc_stage first, const pc_options *options,
                                     pc_asset *asset, pc_timings *timings);

/// Runs all stages on a visual mesh: pc_build_from with PC_STAGE_VOXELIZE.
/// @param[in,out] asset    `visual`, `name` and `reports.visual` are set, `character` and
///                         `scenario` may be, the rest is zero.
PC_NODISCARD pc_status pc_build(pc_context *context, const pc_options *options, pc_asset *asset,
                                pc_timings *timings);

#ifdef __cplusplus
}
#endif
#endif
