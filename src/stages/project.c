#include "proxycloth/project.h"

#include "core/core.h"

static const char *const projection_solver_choices[] = {"vector_adam", "cholesky", NULL};
static const pc_field option_fields[] = {
    PCI_FIELD_CHOICE(pc_project_options, projection_solver, 0, 1, projection_solver_choices,
                     "Solver of equation (1)"),
    PCI_FIELD_OPTION(pc_project_options, projection_iterations, UINT, 100, 1, 10000, "",
                     "Iterations, each with new nearest points"),
    PCI_FIELD_OPTION(pc_project_options, lambda_laplacian, DOUBLE, 1.0, 0.0, 1000.0, "",
                     "Weight of the Laplacian term of equation (1)"),
    PCI_FIELD_OPTION(pc_project_options, projection_step, DOUBLE, 0.05, 0.0001, 1.0, "voxels",
                     "Learning rate of VectorAdam"),
};
const pc_record pc_project_options_record = PCI_RECORD(option_fields, pc_project_options);

static const pc_field report_fields[] = {
    PCI_FIELD_REPORT(pc_project_report, energy_before, DOUBLE, "", ""),
    PCI_FIELD_REPORT(pc_project_report, energy_after, DOUBLE, "", ""),
    PCI_FIELD_REPORT(pc_project_report, mean_distance, DOUBLE, "", ""),
    PCI_FIELD_REPORT(pc_project_report, max_distance, DOUBLE, "", ""),
    PCI_FIELD_REPORT(pc_project_report, iterations, COUNT, "", ""),
};
const pc_record pc_project_report_record = PCI_RECORD(report_fields, pc_project_report);

pc_status pc_project(pc_context *context, const pc_mesh *surface, const pc_mesh *isosurface,
                     double cell_size, const pc_project_options *options, pc_mesh *projected,
                     pc_project_report *report) {
    (void)surface;
    (void)isosurface;
    (void)cell_size;
    (void)options;
    (void)projected;
    (void)report;
    return pci_fail(context, PC_ERROR_UNSUPPORTED, "project", "project: not written yet");
}
