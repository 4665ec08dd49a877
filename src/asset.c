// The asset and the table of its stages.
#include "asset.h"

#include "core/core.h"

#define STAGE(stage, text)                                                                         \
    {                                                                                              \
        .name = #stage, .summary = (text), .options = &pc_##stage##_options_record,                \
        .options_offset = offsetof(pc_options, stage), .report = &pc_##stage##_report_record,      \
        .report_offset = offsetof(pc_reports, stage)                                               \
    }

static const pc_stage_info stages[PC_STAGE_COUNT] = {
    STAGE(voxelize, "visual mesh -> samples of its unsigned distance field"),
    STAGE(isosurface, "distance samples -> closed mesh around the garment"),
    STAGE(project, "closed mesh -> the same mesh pulled onto the garment"),
    STAGE(graph, "projected mesh -> guide graph"),
    STAGE(label, "guide graph -> labels with certificate"),
    STAGE(carve, "labels -> single-layer mesh, carved on request"),
    STAGE(simplify, "single-layer mesh -> proxy mesh"),
    STAGE(simulate, "proxy mesh -> simulated frames"),
    STAGE(skin, "simulated frames -> skinning weights"),
};

const pc_stage_info *pc_stage_describe(pc_stage stage) {
    return (unsigned)stage < PC_STAGE_COUNT ? &stages[stage] : NULL;
}

pc_options pc_default_options(void) {
    pc_options options;
    memset(&options, 0, sizeof(options));
    for (size_t i = 0; i < PC_STAGE_COUNT; ++i) {
        pc_record_set_defaults(stages[i].options, (char *)&options + stages[i].options_offset);
    }
    return options;
}

static void free_result(pc_context *context, pc_asset *asset, pc_stage stage) {
    switch (stage) {
    case PC_STAGE_VOXELIZE:
        pc_grid_free(context, &asset->grid);
        return;
    case PC_STAGE_ISOSURFACE:
        pc_mesh_free(context, &asset->isosurface);
        return;
    case PC_STAGE_PROJECT:
        pc_mesh_free(context, &asset->projected);
        return;
    case PC_STAGE_GRAPH:
        pc_graph_free(context, &asset->graph);
        return;
    case PC_STAGE_LABEL:
        pc_labels_free(context, &asset->labels);
        return;
    case PC_STAGE_CARVE:
        pc_mesh_free(context, &asset->single_layer);
        return;
    case PC_STAGE_SIMPLIFY:
        pc_mesh_free(context, &asset->proxy);
        return;
    case PC_STAGE_SIMULATE:
        pc_motion_free(context, &asset->motion);
        return;
    case PC_STAGE_SKIN:
        pc_skin_free(context, &asset->skin);
        return;
    case PC_STAGE_COUNT:
        return;
    }
}

void pci_asset_truncate(pc_context *context, pc_asset *asset, pc_stage stage) {
    for (pc_stage later = stage; later < PC_STAGE_COUNT; ++later) {
        const pc_stage_info *info = &stages[later];
        free_result(context, asset, later);
        memset((char *)&asset->options + info->options_offset, 0, info->options->size);
        memset((char *)&asset->reports + info->report_offset, 0, info->report->size);
    }
    if (asset->stage_count > (uint32_t)stage) {
        asset->stage_count = (uint32_t)stage;
    }
}

void pc_asset_free(pc_context *context, pc_asset *asset) {
    if (asset == NULL) {
        return;
    }
    pci_asset_truncate(context, asset, PC_STAGE_VOXELIZE);
    pc_visual_free(context, &asset->visual);
    pc_character_free(context, &asset->character);
    pc_scenario_free(context, &asset->scenario);
    memset(asset, 0, sizeof(*asset));
}
