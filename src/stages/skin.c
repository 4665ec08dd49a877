#include "proxycloth/skin.h"

#include "core/core.h"

static const pc_field option_fields[] = {
    PCI_FIELD_OPTION(pc_skin_options, influences, UINT, 4, 1, 32, "",
                     "K: influences per visual vertex"),
    PCI_FIELD_OPTION(pc_skin_options, candidates, UINT, 8, 1, 32, "",
                     "k_B: nearest proxy vertices that are considered per visual vertex"),
    PCI_FIELD_OPTION(pc_skin_options, neighbours, UINT, 8, 1, 32, "",
                     "k_K: spatial neighbours of L_c and L_a"),
    PCI_FIELD_OPTION(pc_skin_options, lambda_rigid, DOUBLE, 1.0, 0.0, 1000000.0, "",
                     "Weight of L_r"),
    PCI_FIELD_OPTION(pc_skin_options, lambda_collision, DOUBLE, 1.0, 0.0, 1000000.0, "",
                     "Weight of L_c"),
    PCI_FIELD_OPTION(pc_skin_options, lambda_attachment, DOUBLE, 0.1, 0.0, 1000000.0, "",
                     "Weight of L_a"),
    PCI_FIELD_OPTION(pc_skin_options, epochs, UINT, 200, 0, 100000, "", "Passes over all frames"),
    PCI_FIELD_OPTION(pc_skin_options, batch, UINT, 16, 1, 100000, "frames", "Frames per step"),
    PCI_FIELD_OPTION(pc_skin_options, learning_rate, DOUBLE, 0.001, 1e-08, 10.0, "",
                     "Step of AdamW"),
    PCI_FIELD_OPTION(pc_skin_options, weight_decay, DOUBLE, 0.01, 0.0, 1.0, "",
                     "Decoupled weight decay of AdamW"),
    PCI_FIELD_OPTION(pc_skin_options, seed, UINT, 1, 0, 4294967295, "",
                     "Seed of the random numbers"),
};
const pc_record pc_skin_options_record = PCI_RECORD(option_fields, pc_skin_options);

static const pc_field report_fields[] = {
    PCI_FIELD_REPORT(pc_skin_report, loss_before, DOUBLE, "", ""),
    PCI_FIELD_REPORT(pc_skin_report, loss_after, DOUBLE, "", ""),
    PCI_FIELD_REPORT(pc_skin_report, rigid_before, DOUBLE, "", ""),
    PCI_FIELD_REPORT(pc_skin_report, rigid_after, DOUBLE, "", ""),
    PCI_FIELD_REPORT(pc_skin_report, collision_before, DOUBLE, "", ""),
    PCI_FIELD_REPORT(pc_skin_report, collision_after, DOUBLE, "", ""),
    PCI_FIELD_REPORT(pc_skin_report, attachment_before, DOUBLE, "", ""),
    PCI_FIELD_REPORT(pc_skin_report, attachment_after, DOUBLE, "", ""),
    PCI_FIELD_REPORT(pc_skin_report, full_loss, DOUBLE, "", ""),
    PCI_FIELD_REPORT(pc_skin_report, reflections, COUNT, "", ""),
    PCI_FIELD_REPORT(pc_skin_report, bones_used, COUNT, "", ""),
};
const pc_record pc_skin_report_record = PCI_RECORD(report_fields, pc_skin_report);

pc_status pc_skin_optimize(pc_context *context, const pc_mesh *surface, const pc_mesh *proxy,
                           const pc_motion *motion, const pc_skin_options *options, pc_skin *skin,
                           pc_skin_report *report) {
    (void)surface;
    (void)proxy;
    (void)motion;
    (void)options;
    (void)skin;
    (void)report;
    return pci_fail(context, PC_ERROR_UNSUPPORTED, "skin", "skin: not written yet");
}

pc_status pc_skin_closest_triangle(pc_context *context, const pc_mesh *surface,
                                   const pc_mesh *proxy, pc_skin *skin) {
    (void)surface;
    (void)proxy;
    (void)skin;
    return pci_fail(context, PC_ERROR_UNSUPPORTED, "skin", "skin: not written yet");
}

pc_status pc_skin_evaluate(pc_context *context, const pc_mesh *surface, const pc_mesh *proxy,
                           const pc_motion *motion, const pc_skin *skin,
                           const pc_skin_options *options, pc_skin_losses *losses) {
    (void)surface;
    (void)proxy;
    (void)motion;
    (void)skin;
    (void)options;
    (void)losses;
    return pci_fail(context, PC_ERROR_UNSUPPORTED, "skin", "skin: not written yet");
}

void pc_skin_deform(const pc_skin *skin, const double *rest, const double *proxy_rest,
                    const double *proxy_frame, double *output) {
    (void)skin;
    (void)rest;
    (void)proxy_rest;
    (void)proxy_frame;
    (void)output;
}
