#include "proxycloth/isosurface.h"

#include "core/core.h"

static const pc_field option_fields[] = {
    PCI_FIELD_OPTION(pc_isosurface_options, iso_voxels, DOUBLE, 1.0, 0.5, 1.0, "voxels",
                     "Distance of the closed surface from the garment"),
};
const pc_record pc_isosurface_options_record = PCI_RECORD(option_fields, pc_isosurface_options);

static const pc_field report_fields[] = {
    PCI_FIELD_REPORT(pc_isosurface_report, vertices, COUNT, "", ""),
    PCI_FIELD_REPORT(pc_isosurface_report, triangles, COUNT, "", ""),
    PCI_FIELD_REPORT(pc_isosurface_report, components, COUNT, "", ""),
};
const pc_record pc_isosurface_report_record = PCI_RECORD(report_fields, pc_isosurface_report);

pc_status pc_isosurface(pc_context *context, const pc_grid *grid,
                        const pc_isosurface_options *options, pc_mesh *isosurface,
                        pc_isosurface_report *report) {
    (void)grid;
    (void)options;
    (void)isosurface;
    (void)report;
    return pci_fail(context, PC_ERROR_UNSUPPORTED, "isosurface", "isosurface: not written yet");
}
