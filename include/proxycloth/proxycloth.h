/// proxycloth: from a game's garment mesh to a simulated low-poly proxy and skinning weights.
///
/// Based on: Zheng, Wang, Feng, Pan, Gao, Wu, "Proxy Asset Generation for Cloth Simulation in
/// Games", ACM Transactions on Graphics 43(4), 2024. Equation and section numbers refer to it.
///
/// Conventions: right-handed, y up, counter-clockwise front faces, row-major arrays. Lengths are in
/// the unit of the input unless a comment says voxels or metres. Indices are uint32_t, counts
/// size_t. Functions return a pc_status; outputs are zeroed structs on entry and empty again on
/// failure.
///
///     pc_context *context;
///     pc_asset asset = {0};
///     const pc_options options = pc_default_options();
///     if (pc_context_create(NULL, &context) != PC_OK) return 1;
///     const pc_visual_arrays arrays = {.vertex_count = nv, .positions = xyz,
///                                      .triangle_count = nf, .triangles = abc};
///     if (pc_visual_create(context, &arrays, &asset.visual, &asset.reports.visual) == PC_OK &&
///         pc_build(context, &options, &asset, NULL) == PC_OK)
///         use(&asset.proxy, &asset.motion, &asset.skin);
///     else
///         complain(pc_context_error(context)->message);
///     pc_asset_free(context, &asset);
///     pc_context_destroy(context);
#ifndef PROXYCLOTH_PROXYCLOTH_H
#define PROXYCLOTH_PROXYCLOTH_H

#include "proxycloth/base.h"
#include "proxycloth/character.h"
#include "proxycloth/mesh.h"
#include "proxycloth/options.h"
#include "proxycloth/parts.h"
#include "proxycloth/rotation.h"
#include "proxycloth/scenario.h"

#include "proxycloth/carve.h"
#include "proxycloth/graph.h"
#include "proxycloth/isosurface.h"
#include "proxycloth/label.h"
#include "proxycloth/project.h"
#include "proxycloth/simplify.h"
#include "proxycloth/simulate.h"
#include "proxycloth/skin.h"
#include "proxycloth/voxelize.h"

#include "proxycloth/options_file.h"
#include "proxycloth/pipeline.h"

#include "proxycloth/asset_file.h"
#include "proxycloth/baselines.h"
#include "proxycloth/body.h"
#include "proxycloth/deform.h"
#include "proxycloth/evaluate.h"
#include "proxycloth/evaluate_motion.h"
#include "proxycloth/export.h"

#endif
