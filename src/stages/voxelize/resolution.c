// The choice of N_v; the rule and its reasons are in voxelize.h.
#include "geometry/topology.h"
#include "stages/marching_cubes.h"
#include "stages/voxelize/voxelize_internal.h"

static const char stage[] = "voxelize";

// Three levels per doubling, and how many of them must agree.
static const uint32_t levels[] = {20, 25, PC_VOXELS_FLOOR, 40, 51, 64, 81, 102, PC_VOXELS_CEILING};
enum { LEVEL_COUNT = sizeof(levels) / sizeof(levels[0]), FLOOR_LEVEL = 2, RUN = 3 };

// Iso-surface that may come in, relative to the coarser levels, before layers of cloth count as
// separated. Openings do not add any: a tube of diameter d has the area pi d + 2 pi h when it is
// closed, which is 2 pi d, that of its two sides, when it opens at h = d / 2.
#define LAYER_GROWTH 1.1

// The iso-surface reaches one voxel. With samples up to this distance its area is right within 5 %,
// in less than half of the time of the whole band.
#define BAND_VOXELS 1.25

typedef struct level_result {
    double cell_size;
    uint64_t tunnels; // sum of the genus of the iso-surfaces
    double area;      // of the iso-surfaces
} level_result;

static pc_status measure_level(pc_context *context, const pc_mesh *surface, const pci_bvh *bvh,
                               const pci_narrow_band *band, level_result *result,
                               uint64_t *queries) {
    pc_grid grid = {0};
    pc_mesh mesh = {0};
    pci_scratch scratch = pci_scratch_begin(context);
    pc_status status = pci_sample_narrow_band(context, surface, bvh, band, &grid, queries);
    if (status == PC_OK) {
        status = pci_marching_cubes(context, &grid, 1.0, &mesh);
    }
    uint32_t *parents = PCI_SCRATCH(&scratch, uint32_t, mesh.vertex_count);
    if (status == PC_OK && parents == NULL) {
        status = pci_fail_memory(context, stage);
    }
    if (status == PC_OK) {
        // Closed surfaces: E = 3 F / 2, and V - E + F = 2 (components - genus).
        const size_t components = pci_vertex_components(&mesh, parents);
        result->tunnels = (2 * components + mesh.triangle_count / 2 - mesh.vertex_count) / 2;
        result->cell_size = grid.cell_size;
        result->area = 0.0;
        for (size_t t = 0; t < mesh.triangle_count; ++t) {
            result->area += pci_triangle_area(&mesh, t);
        }
    }
    pc_mesh_free(context, &mesh);
    pc_grid_free(context, &grid);
    pci_scratch_end(&scratch);
    return status;
}

static uint64_t median(uint64_t a, uint64_t b, uint64_t c) {
    const uint64_t low = a < b ? a : b, high = a < b ? b : a;
    return c < low ? low : c > high ? high : c;
}

// The number of tunnels at a level, without what the place of the lattice does: at one single level
// it may close an opening of up to 2 + sqrt(2) voxels, or open a pinhole.
static uint64_t settled_tunnels(const level_result *results, size_t count, size_t level) {
    const uint64_t own = results[level].tunnels;
    return level == 0 || level + 1 == count
               ? own
               : median(results[level - 1].tunnels, own, results[level + 1].tunnels);
}

pc_status pci_choose_voxels(pc_context *context, const pc_mesh *surface, const pci_bvh *bvh,
                            pc_voxelize_report *report) {
    level_result results[LEVEL_COUNT] = {0};
    size_t count = 0;
    double least = INFINITY, second_least = INFINITY; // the least one may be an accident as well

    // Up to the ceiling, or to where layers come apart.
    for (size_t level = 0; level < LEVEL_COUNT; ++level) {
        const double share = (double)levels[level] / PC_VOXELS_CEILING;
        const pci_narrow_band band = {.voxels = levels[level],
                                      .width = BAND_VOXELS,
                                      .from = 0.33 * share * share,
                                      .to = 0.5 * share * share};
        const pc_status status =
            measure_level(context, surface, bvh, &band, &results[level], &report->queries);
        if (status != PC_OK) {
            return status;
        }
        const double area = results[level].area;
        if (area > LAYER_GROWTH * second_least) {
            report->layer_gap = 2.0 * results[level].cell_size;
            break;
        }
        second_least = fmin(second_least, fmax(area, least));
        least = fmin(least, area);
        count = level + 1;
    }

    // The openings of the finest run of levels, and the coarsest run that has as many.
    size_t first = 0, opening = LEVEL_COUNT, chosen = FLOOR_LEVEL;
    uint64_t tunnels = 0;
    for (size_t level = 0; level < count; ++level) {
        const uint64_t settled = settled_tunnels(results, count, level);
        if (level == 0 || settled != settled_tunnels(results, count, level - 1)) {
            first = level;
        }
        if (level + 1 >= first + RUN && results[level].tunnels == settled &&
            (opening == LEVEL_COUNT || settled != tunnels)) {
            tunnels = settled;
            opening = first;
            chosen = level;
        }
    }
    report->voxels = levels[chosen];
    report->tunnels = results[chosen].tunnels;
    report->narrowest_opening = opening < LEVEL_COUNT ? 2.0 * results[opening].cell_size : 0.0;
    return PC_OK;
}
