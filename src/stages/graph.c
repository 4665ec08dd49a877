#include "proxycloth/graph.h"

#include "core/core.h"

static const pc_field option_fields[] = {
    PCI_FIELD_OPTION(pc_graph_options, opposite_reach, DOUBLE, 2.0, 0.1, 10.0, "voxels",
                     "Largest distance of opposite vertices"),
    PCI_FIELD_OPTION(pc_graph_options, opposite_epsilon, DOUBLE, 0.1, 0.0, 1.0, "",
                     "epsilon_o: opposite normals have a dot product below -1 + epsilon_o"),
    PCI_FIELD_OPTION(pc_graph_options, inward_offset, DOUBLE, 0.25, 0.0, 2.0, "voxels",
                     "Start of the inward ray outside the vertex"),
    PCI_FIELD_OPTION(pc_graph_options, outward_offset, DOUBLE, 0.5, 0.0, 2.0, "voxels",
                     "Start of the outward ray outside the vertex"),
};
const pc_record pc_graph_options_record = PCI_RECORD(option_fields, pc_graph_options);

static const pc_field report_fields[] = {
    PCI_FIELD_REPORT(pc_graph_report, edges, COUNT, "", ""),
    PCI_FIELD_REPORT(pc_graph_report, opposite_edges, COUNT, "", ""),
    PCI_FIELD_REPORT(pc_graph_report, biased_edges, COUNT, "", ""),
    PCI_FIELD_REPORT(pc_graph_report, opposite_fraction, DOUBLE, "", ""),
    PCI_FIELD_REPORT(pc_graph_report, max_curvature, DOUBLE, "", ""),
};
const pc_record pc_graph_report_record = PCI_RECORD(report_fields, pc_graph_report);

pc_status pc_build_graph(pc_context *context, const pc_mesh *projected, double cell_size,
                         const pc_graph_options *options, pc_graph *graph,
                         pc_graph_report *report) {
    (void)projected;
    (void)cell_size;
    (void)options;
    (void)graph;
    (void)report;
    return pci_fail(context, PC_ERROR_UNSUPPORTED, "graph", "graph: not written yet");
}
