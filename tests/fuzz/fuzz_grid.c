// Stage 2 on grids that no voxelizer made: any samples, in any order.
#include "soup.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    pc_context *context = fuzz_context();
    soup_bytes bytes = {data, size};
    pc_grid grid = {.cell_size = soup_number(&bytes), .band = 2.0 * soup_number(&bytes)};
    pc_isosurface_options options = pc_default_options().isosurface;
    options.iso_voxels = 0.5 + 0.1 * (soup_byte(&bytes) % 6);
    for (size_t k = 0; k < 3; ++k) {
        const uint8_t byte = soup_byte(&bytes);
        grid.size[k] = byte == 255 ? UINT32_MAX : byte % 8;
        grid.origin[k] = soup_number(&bytes);
    }
    // Gaps between the samples, and their distances, in halves of the cell size.
    grid.sample_count = bytes.size / 2;
    grid.samples = soup_allocate(grid.sample_count * sizeof(uint64_t));
    grid.values = soup_allocate(grid.sample_count * sizeof(float));
    uint64_t last = 0;
    for (size_t i = 0; i < grid.sample_count; ++i) {
        const uint8_t gap = soup_byte(&bytes);
        last += gap == 255 ? UINT64_MAX / 2 : gap % 32 == 31 ? 0U : 1U + gap % 32U;
        grid.samples[i] = last;
        grid.values[i] = (float)(0.5 * soup_number(&bytes) * grid.cell_size);
    }
    pc_mesh closed = {0};
    if (soup_succeeds(pc_isosurface(context, &grid, &options, &closed, NULL))) {
        soup_check_mesh(&closed);
    }
    pc_mesh_free(context, &closed);
    free(grid.samples);
    free(grid.values);
    return 0;
}
