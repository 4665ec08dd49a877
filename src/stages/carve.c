#include "proxycloth/carve.h"

#include "core/core.h"

static const pc_field option_fields[] = {
    PCI_FIELD_OPTION(pc_carve_options, carve, BOOL, 0, 0, 1, "",
                     "Cut the surface along the outline of the visual mesh (section 5.1)"),
    PCI_FIELD_OPTION(pc_carve_options, carve_distance, DOUBLE, 1.0, 0.05, 10.0, "voxels",
                     "epsilon_carved: farther than this from the visual mesh is cut away"),
    PCI_FIELD_OPTION(pc_carve_options, smallest_part, DOUBLE, 0.05, 0.0, 1.0, "",
                     "Parts below this share of the largest part are dropped"),
    PCI_FIELD_OPTION(pc_carve_options, fill_loops, UINT, 12, 0, 1000, "edges",
                     "Boundary loops up to this length are filled"),
};
const pc_record pc_carve_options_record = PCI_RECORD(option_fields, pc_carve_options);

static const pc_field report_fields[] = {
    PCI_FIELD_REPORT(pc_carve_report, vertices, COUNT, "", ""),
    PCI_FIELD_REPORT(pc_carve_report, triangles, COUNT, "", ""),
    PCI_FIELD_REPORT(pc_carve_report, components, COUNT, "", ""),
    PCI_FIELD_REPORT(pc_carve_report, boundary_loops, COUNT, "", ""),
    PCI_FIELD_REPORT(pc_carve_report, dropped_parts, COUNT, "", ""),
    PCI_FIELD_REPORT(pc_carve_report, filled_loops, COUNT, "", ""),
    PCI_FIELD_REPORT(pc_carve_report, carved_triangles, COUNT, "", ""),
    PCI_FIELD_REPORT(pc_carve_report, coverage, DOUBLE, "", ""),
};
const pc_record pc_carve_report_record = PCI_RECORD(report_fields, pc_carve_report);

pc_status pc_carve(pc_context *context, const pc_mesh *surface, const pc_mesh *projected,
                   const pc_labels *labels, double cell_size, const pc_carve_options *options,
                   pc_mesh *single_layer, pc_carve_report *report) {
    (void)surface;
    (void)projected;
    (void)labels;
    (void)cell_size;
    (void)options;
    (void)single_layer;
    (void)report;
    return pci_fail(context, PC_ERROR_UNSUPPORTED, "carve", "carve: not written yet");
}
