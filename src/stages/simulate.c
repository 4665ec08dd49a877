#include "proxycloth/simulate.h"

#include "core/core.h"

static const char *const up_axis_choices[] = {"x", "y", "z", NULL};
static const pc_field option_fields[] = {
    PCI_FIELD_OPTION(pc_simulate_options, frames, UINT, 200, 1, 100000, "", "Frames that are kept"),
    PCI_FIELD_OPTION(pc_simulate_options, frame_steps, UINT, 3, 1, 1000, "",
                     "Steps per kept frame"),
    PCI_FIELD_OPTION(pc_simulate_options, time_step, DOUBLE, 1.0 / 60.0, 0.0001, 0.1, "s",
                     "Length of a step"),
    PCI_FIELD_OPTION(pc_simulate_options, solver_iterations, UINT, 10, 1, 1000, "",
                     "Sweeps over the springs per step"),
    PCI_FIELD_OPTION(pc_simulate_options, stretch_stiffness, DOUBLE, 1.0, 0.0, 1.0, "",
                     "k_s of the springs along edges"),
    PCI_FIELD_OPTION(pc_simulate_options, bend_stiffness, DOUBLE, 0.2, 0.0, 1.0, "",
                     "k_b of the springs across edges"),
    PCI_FIELD_OPTION(pc_simulate_options, damping, DOUBLE, 0.02, 0.0, 1.0, "",
                     "Share of the velocity lost per step"),
    PCI_FIELD_OPTION(pc_simulate_options, gravity, DOUBLE, 9.81, -100.0, 100.0, "m/s^2",
                     "Acceleration downwards"),
    PCI_FIELD_OPTION(pc_simulate_options, area_density, DOUBLE, 0.2, 0.001, 100.0, "kg/m^2",
                     "Mass of the cloth per area"),
    PCI_FIELD_OPTION(pc_simulate_options, air_density, DOUBLE, 1.2, 0.0, 100.0, "kg/m^3",
                     "Strength of the wind force on a facet"),
    PCI_FIELD_OPTION(pc_simulate_options, wind_speed, DOUBLE, 6.0, 0.0, 100.0, "m/s",
                     "Strongest wind"),
    PCI_FIELD_OPTION(pc_simulate_options, pinned_fraction, DOUBLE, 0.05, 0.0, 1.0, "",
                     "Share of the vertices that is held, the highest ones"),
    PCI_FIELD_OPTION(pc_simulate_options, garment_size, DOUBLE, 1.5, 0.0, 1000.0, "m",
                     "Diagonal at which the garment is simulated, 0 for the file's own size"),
    PCI_FIELD_CHOICE(pc_simulate_options, up_axis, 1, 2, up_axis_choices, "Axis that points up"),
    PCI_FIELD_OPTION(pc_simulate_options, seed, UINT, 1, 0, 4294967295, "",
                     "Seed of the random numbers"),
};
const pc_record pc_simulate_options_record = PCI_RECORD(option_fields, pc_simulate_options);

static const pc_field report_fields[] = {
    PCI_FIELD_REPORT(pc_simulate_report, stretch_springs, COUNT, "", ""),
    PCI_FIELD_REPORT(pc_simulate_report, bend_springs, COUNT, "", ""),
    PCI_FIELD_REPORT(pc_simulate_report, pinned, COUNT, "", ""),
    PCI_FIELD_REPORT(pc_simulate_report, mean_strain, DOUBLE, "", ""),
    PCI_FIELD_REPORT(pc_simulate_report, p95_strain, DOUBLE, "", ""),
    PCI_FIELD_REPORT(pc_simulate_report, max_strain, DOUBLE, "", ""),
    PCI_FIELD_REPORT(pc_simulate_report, max_speed, DOUBLE, "", ""),
    PCI_FIELD_REPORT(pc_simulate_report, motion_range, DOUBLE, "", ""),
};
const pc_record pc_simulate_report_record = PCI_RECORD(report_fields, pc_simulate_report);

pc_status pc_simulate(pc_context *context, const pc_mesh *proxy, const pc_simulate_options *options,
                      pc_motion *motion, pc_simulate_report *report) {
    (void)proxy;
    (void)options;
    (void)motion;
    (void)report;
    return pci_fail(context, PC_ERROR_UNSUPPORTED, "simulate", "simulate: not written yet");
}
