#include "proxycloth/voxelize.h"

#include "core/core.h"

static const pc_field option_fields[] = {
    PCI_FIELD_OPTION(pc_voxelize_options, voxels, UINT, 32, 4, 1024, "",
                     "N_v: voxels along the longest side of the bounding box"),
};
const pc_record pc_voxelize_options_record = PCI_RECORD(option_fields, pc_voxelize_options);

static const pc_field report_fields[] = {
    PCI_FIELD_REPORT(pc_voxelize_report, cell_size, DOUBLE, "", ""),
    PCI_FIELD_REPORT(pc_voxelize_report, samples, COUNT, "", ""),
    PCI_FIELD_REPORT(pc_voxelize_report, queries, COUNT, "", ""),
};
const pc_record pc_voxelize_report_record = PCI_RECORD(report_fields, pc_voxelize_report);

pc_status pc_voxelize(pc_context *context, const pc_mesh *surface,
                      const pc_voxelize_options *options, pc_grid *grid,
                      pc_voxelize_report *report) {
    (void)surface;
    (void)options;
    (void)grid;
    (void)report;
    return pci_fail(context, PC_ERROR_UNSUPPORTED, "voxelize", "voxelize: not written yet");
}
