#include "stages/carve/coverage.h"

#include "geometry/bvh.h"
#include "geometry/knn.h"

// What the visual mesh covers is within this many voxels of the layer.
static const double covered_voxels = 2.0;
// Pieces of parallel loops.
enum { grain = 256 };

// Whether the layer is within reach of a vertex. Where one of its vertices is, nobody needs a tree
// of its triangles, nor where none is within so much more that no point between them can be.
enum { UNSURE, COVERED, MISSED };
typedef struct coverage_job {
    const pci_knn *points; // of the layer
    const pci_bvh *layer;  // for those that are unsure
    const pc_mesh *surface;
    double reach, between; // from any point of the layer to the nearest vertex
    uint8_t *covered;      // #V
} coverage_job;

static void compare_points(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const coverage_job *job = user;
    uint32_t last = PC_INVALID_INDEX, far = PC_INVALID_INDEX;
    for (size_t v = begin; v < end; ++v) {
        const double *point = &job->surface->positions[3 * v];
        job->covered[v] = pci_knn_within_near(job->points, point, job->reach, &last) ? COVERED
                          : pci_knn_within_near(job->points, point, job->reach + job->between, &far)
                              ? UNSURE
                              : MISSED;
    }
}

static void compare_triangles(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const coverage_job *job = user;
    uint32_t last = PC_INVALID_INDEX;
    for (size_t v = begin; v < end; ++v) {
        if (job->covered[v] == UNSURE) {
            const double *point = &job->surface->positions[3 * v];
            job->covered[v] =
                pci_bvh_within_near(job->layer, point, job->reach, &last) ? COVERED : MISSED;
        }
    }
}

// No point of a triangle is farther than this from its nearest corner, of all triangles.
static double farthest_from_corners(const pc_mesh *mesh) {
    double square = 0.0;
    for (size_t i = 0; i < 3 * mesh->triangle_count; ++i) {
        const size_t next = i % 3 == 2 ? i - 2 : i + 1;
        square =
            fmax(square, pci_squared_distance(&mesh->positions[3 * (size_t)mesh->triangles[i]],
                                              &mesh->positions[3 * (size_t)mesh->triangles[next]]));
    }
    return (1.0 + 1e-9) * sqrt(square / 3.0); // of an equilateral one
}

pc_status pci_measure_coverage(pci_scratch *scratch, const char *stage, const pc_mesh *surface,
                               const pc_mesh *mesh, double cell_size, double *coverage) {
    pc_context *context = scratch->context;
    pci_knn points;
    pci_bvh *layer = NULL;
    pc_status status = PC_OK;
    coverage_job job = {.points = &points,
                        .surface = surface,
                        .reach = covered_voxels * cell_size,
                        .between = farthest_from_corners(mesh),
                        .covered = PCI_SCRATCH(scratch, uint8_t, surface->vertex_count)};
    if (scratch->failed || !pci_knn_build(scratch, mesh->vertex_count, mesh->positions, &points)) {
        return pci_fail_memory(context, stage);
    }
    pci_parallel_for(context, surface->vertex_count, grain, compare_points, &job);
    if (memchr(job.covered, UNSURE, surface->vertex_count) != NULL) {
        status = pci_bvh_create(context, stage, mesh, &layer);
        job.layer = layer;
    }
    if (status == PC_OK && layer != NULL) {
        pci_parallel_for(context, surface->vertex_count, grain, compare_triangles, &job);
    }
    pci_bvh_destroy(context, layer);
    size_t sum = 0;
    for (size_t v = 0; v < surface->vertex_count; ++v) {
        sum += job.covered[v] == COVERED;
    }
    *coverage = (double)sum / (double)surface->vertex_count;
    return status;
}
