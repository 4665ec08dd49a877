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

// Writes the unit quaternion of a vertex, w >= 0, to its result.
typedef void pci_put_rotation(void *result, const double quaternion[4]);

PC_NODISCARD pc_status pci_rotation_prepare(pc_context *context, const char *stage,
                                            const pc_mesh *mesh, const uint8_t *pinned,
                                            pc_rotation_estimator **estimator);
// `results`: at least 32 bytes per vertex, `stride` bytes from one to the next; the only memory
// that is used.
void pci_rotation_estimate(const pc_rotation_estimator *estimator, const pci_points *pose,
                           pci_put_rotation *put, void *results, size_t stride);

// Receives a rotation, row-major.
typedef void pci_put_matrix(void *result, const double rotation[9]);
// The rotations of the 1-rings as they are, which is all that normals need: no mean, no pins.
void pci_rotation_of_rings(const pc_rotation_estimator *estimator, const pci_points *pose,
                           pci_put_matrix *put, void *results, size_t stride);

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
