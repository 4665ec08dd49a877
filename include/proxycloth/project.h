/// Stage 3 of 9, project: closed mesh -> the same mesh pulled onto the garment.
///
/// Minimises equation (1): sum_i |v_i - p_i|^2 + lambda_L sum_i |v_i - mean of its 1-ring|^2, where
/// p_i is the point of the visual mesh nearest to v_i. Two solvers, both with new nearest points in
/// every iteration: VectorAdam as in the paper, and the exact minimum for fixed p_i from one sparse
/// Cholesky factor of I + lambda_L L^T L. The latter never raises the energy and stops when an
/// iteration lowers it by less than half a percent.
///
/// DEVIATION from the paper, which uses VectorAdam: the Cholesky solver is the default; it reaches
/// lower energies in less than half the time and turns fewer triangles over.
///
/// Postconditions: same triangles as the input, finite positions.
#ifndef PROXYCLOTH_PROJECT_H
#define PROXYCLOTH_PROJECT_H

#include "proxycloth/mesh.h"
#include "proxycloth/options.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum pc_project_solver {
    PC_PROJECT_VECTOR_ADAM = 0,
    PC_PROJECT_CHOLESKY = 1
} pc_project_solver;

typedef struct pc_project_options {
    uint32_t projection_solver;     ///< pc_project_solver
    uint32_t projection_iterations; ///< at most; 0: 100 for VectorAdam, 20 for Cholesky
    double lambda_laplacian;        ///< lambda_L of equation (1)
    double projection_step;         ///< VectorAdam learning rate, in voxels
} pc_project_options;

typedef struct pc_project_report {
    double energy_before; ///< equation (1) over squared voxels and vertices
    double energy_after;
    double mean_distance; ///< of the vertices to the garment, in voxels
    double max_distance;
    uint64_t iterations;
} pc_project_report;

extern const pc_record pc_project_options_record;
extern const pc_record pc_project_report_record;

/// @param[in]  surface    the visual mesh.
/// @param[in]  isosurface closed manifold mesh around it.
/// @param[in]  cell_size  of the grid the mesh came from; > 0.
/// @param[out] projected  zeroed on entry.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT; PC_ERROR_INVALID_OPTIONS; PC_ERROR_OUT_OF_MEMORY;
///         PC_ERROR_DEPENDENCY; PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pc_project(pc_context *context, const pc_mesh *surface,
                                  const pc_mesh *isosurface, double cell_size,
                                  const pc_project_options *options, pc_mesh *projected,
                                  pc_project_report *report);

#ifdef __cplusplus
}
#endif
#endif
