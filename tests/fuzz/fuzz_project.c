// Stage 3 on a garment and a mesh around it that need not fit each other.
#include "soup.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    pc_context *context = fuzz_context();
    soup_bytes bytes = {data, size};
    pc_project_options options = pc_default_options().project;
    options.projection_solver = soup_byte(&bytes) % 3;
    options.projection_iterations = 1 + soup_byte(&bytes) % 2;
    const double cell_size = 0.25 * soup_number(&bytes);
    pc_mesh surface = soup_any(&bytes), closed = soup_any(&bytes), projected = {0};
    if (soup_succeeds(
            pc_project(context, &surface, &closed, cell_size, &options, &projected, NULL))) {
        soup_check_mesh(&projected);
        fuzz_assert(projected.vertex_count == closed.vertex_count);
    }
    pc_mesh_free(context, &projected);
    soup_free(&surface);
    soup_free(&closed);
    return 0;
}
