// Stage 1 on any garment, as a visual mesh made of it or as arrays of a caller's own.
#include "soup.h"

static void sample(pc_context *context, const pc_mesh *surface, uint32_t voxels) {
    pc_grid grid = {0};
    const pc_voxelize_options options = {.voxels = voxels};
    if (soup_succeeds(pc_voxelize(context, surface, &options, &grid, NULL))) {
        for (size_t i = 0; i < grid.sample_count; ++i) {
            fuzz_assert(grid.values[i] >= 0.0F && (double)grid.values[i] <= 1.001 * grid.band);
            fuzz_assert(i == 0 || grid.samples[i] > grid.samples[i - 1]);
        }
    }
    pc_grid_free(context, &grid);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    pc_context *context = fuzz_context();
    soup_bytes bytes = {data, size};
    const uint8_t kind = soup_byte(&bytes);
    const uint32_t voxels = 4 + (uint32_t)soup_size(soup_byte(&bytes), 2, 6);
    pc_mesh soup = soup_any(&bytes);
    pc_visual visual = {0};
    const pc_mesh *surface = soup_surface(context, &soup, kind % 2 == 0, &visual);
    if (surface != NULL) {
        sample(context, surface, voxels);
    }
    pc_visual_free(context, &visual);
    soup_free(&soup);
    return 0;
}
