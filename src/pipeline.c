// The pipeline: what runs after what. Start reading here.
#include "proxycloth/pipeline.h"

#include "asset.h"
#include "core/clock.h"
#include "core/core.h"
#include "geometry/bvh.h"

static pc_status run_step(pc_context *context, pc_stage stage, pc_asset *a) {
    const pc_options *o = &a->options;
    pc_reports *r = &a->reports;
    const pc_mesh *surface = &a->visual.surface;
    const pc_simulate_inputs inputs = {&a->proxy, &a->scenario, &a->visual, &a->character};
    switch (stage) {
    case PC_STAGE_VOXELIZE: // visual mesh -> UDF grid
        return pc_voxelize(context, surface, &o->voxelize, &a->grid, &r->voxelize);
    case PC_STAGE_ISOSURFACE: // UDF grid -> closed iso-surface
        return pc_isosurface(context, &a->grid, &o->isosurface, &a->isosurface, &r->isosurface);
    case PC_STAGE_PROJECT: // closed iso-surface -> projected mesh
        return pc_project(context, surface, &a->isosurface, a->grid.cell_size, &o->project,
                          &a->projected, &r->project);
    case PC_STAGE_GRAPH: // projected mesh -> guide graph
        return pc_build_graph(context, &a->projected, a->grid.cell_size, &o->graph, &a->graph,
                              &r->graph);
    case PC_STAGE_LABEL: // guide graph -> labels with certificate
        return pc_label(context, &a->graph, &o->label, &a->labels, &r->label);
    case PC_STAGE_CARVE: // labels -> single layer, carved on request
        return pc_carve(context, surface, &a->projected, &a->labels, a->grid.cell_size, &o->carve,
                        &a->single_layer, &r->carve);
    case PC_STAGE_SIMPLIFY: // single layer -> proxy mesh
        return pc_simplify(context, &a->visual, &a->single_layer, &o->simplify, &a->proxy,
                           &r->simplify);
    case PC_STAGE_SIMULATE: // proxy mesh -> simulated frames
        return pc_simulate_scenario(context, &inputs, &o->simulate, &a->motion, &r->simulate);
    case PC_STAGE_SKIN: // simulated frames -> skinning weights
        return pc_skin_optimize(context, surface, &a->proxy, &a->motion, &o->skin, &a->skin,
                                &r->skin);
    case PC_STAGE_COUNT:
        break;
    }
    return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, "pipeline", "pipeline: no stage %d",
                    (int)stage);
}

pc_status pc_build(pc_context *context, const pc_options *options, pc_asset *asset,
                   pc_timings *timings) {
    return pc_build_from(context, PC_STAGE_VOXELIZE, options, asset, timings);
}

pc_status pc_build_from(pc_context *context, pc_stage first, const pc_options *options,
                        pc_asset *asset, pc_timings *timings) {
    pc_status status = PC_OK;
    pc_stage stage = first;
    // Until the single layer is there, nearly every stage asks for points of the visual mesh.
    pci_bvh_share(context, asset != NULL ? &asset->visual.surface : NULL);
    do {
        status = pc_run_stage(context, stage, options, asset, timings);
        if (stage == PC_STAGE_CARVE) {
            pci_bvh_share(context, NULL);
        }
        ++stage;
    } while (stage < PC_STAGE_COUNT && status == PC_OK);
    pci_bvh_share(context, NULL);
    return status;
}

pc_status pc_run_stage(pc_context *context, pc_stage stage, const pc_options *options,
                       pc_asset *asset, pc_timings *timings) {
    const pc_stage_info *info = pc_stage_describe(stage);
    if (info == NULL || asset == NULL || asset->visual.surface.triangle_count == 0 ||
        asset->stage_count < (uint32_t)stage) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, "pipeline",
                        "pipeline: stage %s needs the results of the stages before it",
                        info != NULL ? info->name : "?");
    }
    const pc_options defaults = pc_default_options();
    pci_asset_truncate(context, asset, stage);
    memcpy((char *)&asset->options + info->options_offset,
           (const char *)(options != NULL ? options : &defaults) + info->options_offset,
           info->options->size);
    const double start = pci_clock_seconds();
    const bool alone = !pci_bvh_shares(context);
    if (alone) {
        pci_bvh_share(context, &asset->visual.surface);
    }
    const pc_status status = pci_progress(context, info->name, 0.0)
                                 ? run_step(context, stage, asset)
                                 : pci_fail_cancelled(context, info->name);
    if (alone) {
        pci_bvh_share(context, NULL);
    }
    pci_give_back(context);
    if (timings != NULL) {
        timings->seconds[stage] = pci_clock_seconds() - start;
    }
    if (status == PC_OK) {
        asset->stage_count = (uint32_t)stage + 1;
    } else {
        pci_asset_truncate(context, asset, stage);
    }
    return status;
}
