// Stages 3 to 6 on a garment and a mesh around it that need not fit each other, and labels of any
// kind.
#include "soup.h"

static void carve(pc_context *context, const pc_mesh *surface, const pc_mesh *projected,
                  double cell_size, soup_bytes *bytes) {
    pc_options options = pc_default_options();
    pc_graph graph = {0};
    pc_labels labels = {0};
    pc_mesh layer = {0};
    const bool given = soup_byte(bytes) % 2 != 0;
    options.carve.layer_source = soup_byte(bytes) % 3;
    options.carve.carve = soup_byte(bytes) % 2 != 0;
    if (soup_succeeds(
            pc_build_graph(context, projected, cell_size, &options.graph, &graph, NULL)) &&
        soup_succeeds(pc_label(context, &graph, &options.label, &labels, NULL))) {
        for (size_t v = 0; given && v < labels.vertex_count; ++v) {
            labels.labels[v] = soup_byte(bytes) % 2;
        }
        if (soup_succeeds(pc_carve(context, surface, projected, &labels, cell_size, &options.carve,
                                   &layer, NULL))) {
            soup_check_mesh(&layer);
        }
    }
    pc_graph_free(context, &graph);
    pc_labels_free(context, &labels);
    pc_mesh_free(context, &layer);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    pc_context *context = fuzz_context();
    soup_bytes bytes = {data, size};
    double cell_size = 0.25 * soup_number(&bytes);
    if (cell_size > 0.1 && cell_size < 1.0) {
        cell_size += 1.0; // hardly any voxels
    }
    pc_mesh surface = soup_any(&bytes), closed = soup_any(&bytes), projected = {0};
    pc_project_options options = pc_default_options().project;
    options.projection_solver = soup_byte(&bytes) % 3;
    options.projection_iterations = 2;
    if (soup_succeeds(
            pc_project(context, &surface, &closed, cell_size, &options, &projected, NULL))) {
        soup_check_mesh(&projected);
        carve(context, &surface, &projected, cell_size, &bytes);
    }
    pc_mesh_free(context, &projected);
    soup_free(&surface);
    soup_free(&closed);
    return 0;
}
