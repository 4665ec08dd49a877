#include "proxycloth/label.h"

#include "core/core.h"

static const char *const outcome_choices[] = {"optimal", "feasible", NULL};
static const pc_field option_fields[] = {
    PCI_FIELD_OPTION(pc_label_options, lambda_smooth, DOUBLE, 3.0, 0.0, 1000000.0, "",
                     "lambda_s: cost of a label change along a mesh edge"),
    PCI_FIELD_OPTION(pc_label_options, lambda_opposite, DOUBLE, 1.0, 0.0, 1000000.0, "",
                     "lambda_o: cost of equal labels on opposite vertices"),
    PCI_FIELD_OPTION(pc_label_options, lambda_bias, DOUBLE, 1.0, 0.0, 1000000.0, "",
                     "Cost of keeping the inner side, in units of lambda_o"),
    PCI_FIELD_OPTION(pc_label_options, label_effort, UINT, 100, 0, 1000000, "",
                     "Work budget on top of roof duality"),
};
const pc_record pc_label_options_record = PCI_RECORD(option_fields, pc_label_options);

static const pc_field report_fields[] = {
    {.name = "outcome",
     .type = PC_FIELD_CHOICE,
     .offset = offsetof(pc_label_report, outcome),
     .unit = "",
     .help = "",
     .choices = outcome_choices},
    PCI_FIELD_REPORT(pc_label_report, objective, DOUBLE, "", ""),
    PCI_FIELD_REPORT(pc_label_report, bound, DOUBLE, "", ""),
    PCI_FIELD_REPORT(pc_label_report, gap, DOUBLE, "", ""),
    PCI_FIELD_REPORT(pc_label_report, roof_bound, DOUBLE, "", ""),
    PCI_FIELD_REPORT(pc_label_report, fixed, COUNT, "", ""),
    PCI_FIELD_REPORT(pc_label_report, residual, COUNT, "", ""),
    PCI_FIELD_REPORT(pc_label_report, residual_components, COUNT, "", ""),
    PCI_FIELD_REPORT(pc_label_report, unproven_components, COUNT, "", ""),
};
const pc_record pc_label_report_record = PCI_RECORD(report_fields, pc_label_report);

pc_status pc_label(pc_context *context, const pc_graph *graph, const pc_label_options *options,
                   pc_labels *labels, pc_label_report *report) {
    (void)graph;
    (void)options;
    (void)labels;
    (void)report;
    return pci_fail(context, PC_ERROR_UNSUPPORTED, "label", "label: not written yet");
}

double pc_label_objective(const pc_graph *graph, const pc_label_options *options,
                          const uint8_t *labels) {
    (void)graph;
    (void)options;
    (void)labels;
    return 0.0;
}
