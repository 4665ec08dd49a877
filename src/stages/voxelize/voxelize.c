#include "geometry/topology.h"
#include "stages/voxelize/voxelize_internal.h"

static const char stage[] = "voxelize";

static const pc_field option_fields[] = {
    PCI_FIELD_OPTION_OR(pc_voxelize_options, voxels, UINT, 32, 4, 1024, "", "auto",
                        "N_v: voxels along the longest side of the bounding box"),
};
const pc_record pc_voxelize_options_record = PCI_RECORD(option_fields, pc_voxelize_options);

static const pc_field report_fields[] = {
    PCI_FIELD_REPORT(pc_voxelize_report, voxels, UINT, "", "N_v of the grid"),
    PCI_FIELD_REPORT(pc_voxelize_report, cell_size, DOUBLE, "input units",
                     "Side of a voxel, D / N_v"),
    PCI_FIELD_REPORT(pc_voxelize_report, samples, COUNT, "", "Lattice points in the narrow band"),
    PCI_FIELD_REPORT(pc_voxelize_report, queries, COUNT, "",
                     "Exact distances computed, including those that only pruned space"),
    PCI_FIELD_REPORT(pc_voxelize_report, tunnels, COUNT, "",
                     "auto: tunnels through the closed surface; one less than the openings of a "
                     "garment of one layer"),
    PCI_FIELD_REPORT(
        pc_voxelize_report, narrowest_opening, DOUBLE, "input units",
        "auto: the openings are about this wide or wider; 0: the number of tunnels never settled"),
    PCI_FIELD_REPORT(pc_voxelize_report, layer_gap, DOUBLE, "input units",
                     "auto: layers of cloth lie about this far apart; 0: found none"),
};
const pc_record pc_voxelize_report_record = PCI_RECORD(report_fields, pc_voxelize_report);

// A cell with a corner closer than one voxel has all its corners closer than 1 + sqrt(3) = 2.733
// voxels; the rest is slack for rounding and for the iso-value's own slack.
#define BAND_VOXELS 2.75

static bool is_empty(const pc_grid *grid) {
    return grid->samples == NULL && grid->values == NULL && grid->sample_count == 0;
}

pc_status pc_voxelize(pc_context *context, const pc_mesh *surface,
                      const pc_voxelize_options *options, pc_grid *grid,
                      pc_voxelize_report *report) {
    if (grid == NULL || !is_empty(grid)) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage, "%s: grid is NULL or not empty",
                        stage);
    }
    pc_voxelize_options chosen = {0};
    pc_voxelize_report result = {0};
    pci_bvh *bvh = NULL;
    pc_status status = pci_check_mesh(context, stage, surface, "visual mesh");
    if (status == PC_OK) {
        status = pci_begin_stage(context, stage, &pc_voxelize_options_record, options, &chosen);
    }
    if (status == PC_OK) {
        pc_grid lattice; // a bad surface shows before any work
        status = pci_place_lattice(context, surface, PC_VOXELS_FLOOR, BAND_VOXELS, &lattice);
    }
    if (status == PC_OK) {
        status = pci_bvh_create(context, stage, surface, &bvh);
    }
    result.voxels = chosen.voxels;
    if (status == PC_OK && chosen.voxels == PC_VOXELS_AUTO) {
        status = pci_choose_voxels(context, surface, bvh, &result);
    }
    if (status == PC_OK) {
        const pci_narrow_band band = {.voxels = result.voxels,
                                      .width = BAND_VOXELS,
                                      .from = chosen.voxels == PC_VOXELS_AUTO ? 0.5 : 0.0,
                                      .to = 1.0};
        status = pci_sample_narrow_band(context, surface, bvh, &band, grid, &result.queries);
    }
    pci_bvh_destroy(context, bvh);
    if (status == PC_OK && report != NULL) {
        result.cell_size = grid->cell_size;
        result.samples = grid->sample_count;
        *report = result;
    }
    return status;
}
