#include "core/core.h"
#include "proxycloth/pipeline.h"

static const pc_field report_fields[] = {
    PCI_FIELD_REPORT(pc_visual_report, vertices, COUNT, "", "Distinct positions in use"),
    PCI_FIELD_REPORT(pc_visual_report, triangles, COUNT, "", "Triangles"),
    PCI_FIELD_WARNING(pc_visual_report, degenerate_triangles, COUNT, "Triangles without area",
                      "degenerate triangles were accepted"),
    PCI_FIELD_WARNING(pc_visual_report, duplicate_triangles, COUNT, "Repeated triangles",
                      "duplicate triangles were accepted"),
    PCI_FIELD_WARNING(pc_visual_report, stray_vertices, COUNT, "Vertices without triangle",
                      "stray vertices were ignored"),
    PCI_FIELD_WARNING(pc_visual_report, nonmanifold_edges, COUNT,
                      "Edges of more than two triangles", "non-manifold edges were accepted"),
    PCI_FIELD_WARNING(pc_visual_report, winding_conflicts, COUNT,
                      "Edges run twice in one direction", "edges have inconsistent winding"),
    PCI_FIELD_REPORT(pc_visual_report, components, COUNT, "", "Parts joined by positions"),
    PCI_FIELD_REPORT(pc_visual_report, diagonal, DOUBLE, "", "Bounding-box diagonal"),
};
const pc_record pc_visual_report_record = PCI_RECORD(report_fields, pc_visual_report);

pc_status pc_visual_create(pc_context *context, const pc_visual_arrays *arrays, pc_visual *visual,
                           pc_visual_report *report) {
    (void)arrays;
    (void)visual;
    (void)report;
    return pci_fail(context, PC_ERROR_UNSUPPORTED, "visual", "visual: not written yet");
}
