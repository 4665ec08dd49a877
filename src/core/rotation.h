// Rotations of the vertices of a mesh: proxycloth/rotation.h for other types of numbers.
#ifndef PCI_ROTATION_H
#define PCI_ROTATION_H

#include "core/core.h"
#include "proxycloth/rotation.h"

// Points by 3 numbers, double or float, `stride` bytes apart.
typedef struct pci_points {
    const void *start;
    size_t stride;
    bool single;
} pci_points;

// Receives the rotation matrix of a vertex, row-major.
typedef void pci_put_rotation(void *user, size_t vertex, const double rotation[9]);

PC_NODISCARD pc_status pci_rotation_prepare(pc_context *context, const char *stage,
                                            const pc_mesh *mesh, const uint8_t *pinned,
                                            pc_rotation_estimator **estimator);
// `areas`: room for 3 numbers per vertex, `stride` from one to the next; that of a vertex may be
// where `put` writes its rotation.
void pci_rotation_estimate(const pc_rotation_estimator *estimator, const pci_points *pose,
                           double *areas, size_t stride, pci_put_rotation *put, void *user);

// pc_rotation_estimate_motion into scratch memory where `wanted`; else NULL.
PC_NODISCARD pc_status pci_rotations_of_motion(pci_scratch *scratch, const char *stage,
                                               const pc_mesh *mesh, const pc_motion *motion,
                                               bool wanted, double **rotations);
// Those of one frame, or NULL.
static inline const double *pci_rotations_at(const double *rotations, const pc_motion *motion,
                                             size_t frame) {
    return rotations == NULL ? NULL : &rotations[4 * motion->vertex_count * frame];
}

// Quaternions are (x, y, z, w).
void pci_quaternion_of_matrix(const double rotation[9], double quaternion[4]);
void pci_matrix_of_quaternion(const double quaternion[4], double rotation[9]);

// The rotation R that maximises tr(R^T S), as unit quaternion (w, x, y, z): the largest
// eigenvector of a symmetric 4 by 4 matrix, by Jacobi rotations. S row-major; S = 0 gives the
// identity.
void pci_rotation_by_jacobi(const double s[9], double quaternion[4]);

#endif
