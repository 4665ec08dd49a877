// Stages 1 to 3: any soup as a garment, its distance field, the mesh around it, the mesh on it.
#include "soup.h"

static void wrap(pc_context *context, const pc_mesh *surface, soup_bytes *bytes) {
    pc_options options = pc_default_options();
    options.voxelize.voxels = 4 + soup_byte(bytes) % 3;
    options.isosurface.iso_voxels = 0.5 + 0.1 * (soup_byte(bytes) % 6);
    options.project.projection_solver = soup_byte(bytes) % 3;
    options.project.projection_iterations = 2;
    pc_grid grid = {0};
    pc_mesh closed = {0}, projected = {0};
    if (soup_succeeds(pc_voxelize(context, surface, &options.voxelize, &grid, NULL)) &&
        soup_succeeds(pc_isosurface(context, &grid, &options.isosurface, &closed, NULL))) {
        soup_check_mesh(&closed);
        if (soup_succeeds(pc_project(context, surface, &closed, grid.cell_size, &options.project,
                                     &projected, NULL))) {
            soup_check_mesh(&projected);
        }
    }
    pc_grid_free(context, &grid);
    pc_mesh_free(context, &closed);
    pc_mesh_free(context, &projected);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    pc_context *context = fuzz_context();
    soup_bytes bytes = {data, size};
    pc_mesh soup = soup_any(&bytes);
    pc_visual visual = {0};
    const pc_mesh *surface = soup_surface(context, &soup, soup_byte(&bytes) % 4 == 0, &visual);
    if (surface != NULL) {
        wrap(context, surface, &bytes);
    }
    pc_visual_free(context, &visual);
    soup_free(&soup);
    return 0;
}
