// Stage 6 on a garment, a mesh on it and labels that need not fit each other.
#include "soup.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    pc_context *context = fuzz_context();
    soup_bytes bytes = {data, size};
    pc_carve_options options = pc_default_options().carve;
    const uint8_t choices = soup_byte(&bytes);
    options.layer_source = choices % 3;
    options.carve = choices / 3 % 2 != 0;
    options.snap_border = choices / 6 % 2 != 0;
    double cell_size = 0.25 * soup_number(&bytes);
    if (cell_size > 0.1 && cell_size < 2.0) {
        cell_size += 2.0; // edges are split to about that length
    }
    pc_mesh surface = soup_any(&bytes), projected = soup_any(&bytes), layer = {0};
    pc_labels labels = {.vertex_count = projected.vertex_count,
                        .labels = soup_allocate(projected.vertex_count)};
    // One bit per vertex; a last byte of 255 makes a label that is none.
    uint8_t byte = 0;
    for (size_t v = 0; v < labels.vertex_count; ++v) {
        byte = v % 8 == 0 ? soup_byte(&bytes) : byte;
        labels.labels[v] = byte >> v % 8 & 1;
    }
    labels.labels[0] = soup_byte(&bytes) == 255 ? 2 : labels.labels[0];
    if (soup_succeeds(
            pc_carve(context, &surface, &projected, &labels, cell_size, &options, &layer, NULL))) {
        soup_check_mesh(&layer);
    }
    pc_mesh_free(context, &layer);
    soup_free(&surface);
    soup_free(&projected);
    free(labels.labels);
    return 0;
}
