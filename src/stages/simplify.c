#include "proxycloth/simplify.h"

#include "core/core.h"

static const char *const shortfall_choices[] = {"none", "topology", "budget", NULL};
static const pc_field option_fields[] = {
    PCI_FIELD_OPTION(pc_simplify_options, vertices, UINT, 128, 4, 65536, "",
                     "N_p: vertices of the proxy mesh"),
    PCI_FIELD_OPTION(pc_simplify_options, clustering_iterations, UINT, 100, 1, 10000, "",
                     "Passes of boundary exchanges between clusters"),
    PCI_FIELD_OPTION(pc_simplify_options, seed, UINT, 1, 0, 4294967295, "",
                     "Seed of the random numbers"),
};
const pc_record pc_simplify_options_record = PCI_RECORD(option_fields, pc_simplify_options);

static const pc_field report_fields[] = {
    PCI_FIELD_REPORT(pc_simplify_report, vertices, COUNT, "", ""),
    PCI_FIELD_REPORT(pc_simplify_report, triangles, COUNT, "", ""),
    PCI_FIELD_REPORT(pc_simplify_report, components, COUNT, "", ""),
    PCI_FIELD_REPORT(pc_simplify_report, boundary_loops, COUNT, "", ""),
    PCI_FIELD_REPORT(pc_simplify_report, removed_triangles, COUNT, "", ""),
    PCI_FIELD_REPORT(pc_simplify_report, split_vertices, COUNT, "", ""),
    PCI_FIELD_REPORT(pc_simplify_report, iterations, COUNT, "", ""),
    {.name = "shortfall",
     .type = PC_FIELD_CHOICE,
     .offset = offsetof(pc_simplify_report, shortfall),
     .unit = "",
     .help = "",
     .choices = shortfall_choices},
};
const pc_record pc_simplify_report_record = PCI_RECORD(report_fields, pc_simplify_report);

pc_status pc_simplify(pc_context *context, const pc_mesh *surface, const pc_mesh *single_layer,
                      const pc_simplify_options *options, pc_mesh *proxy,
                      pc_simplify_report *report) {
    (void)surface;
    (void)single_layer;
    (void)options;
    (void)proxy;
    (void)report;
    return pci_fail(context, PC_ERROR_UNSUPPORTED, "simplify", "simplify: not written yet");
}
