// Signed distance to a triangle mesh on a regular grid; negative inside. Inside is where the
// winding number exceeds one half, so the mesh may have holes, overlap itself and consist of parts.
#ifndef PCI_DISTANCE_FIELD_H
#define PCI_DISTANCE_FIELD_H

#include "core/core.h"
#include "proxycloth/mesh.h"

typedef struct pci_distance_field {
    double origin[3]; // of the first point
    double cell;
    uint32_t size[3];    // points along each axis, at least 2
    float *values;       // [x + size0 (y + size1 z)]
    uint32_t *triangles; // closest to each point
} pci_distance_field;

// A grid of this spacing that covers the mesh and `margin` around it; arrays live in scratch
// memory. Farther outside than `margin` values are lower bounds, and triangles only near ones.
// PC_OK; PC_ERROR_TOO_LARGE; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pci_distance_field_build(pci_scratch *scratch, const char *stage,
                                                const pc_mesh *mesh, double cell, double margin,
                                                pci_distance_field *field);

// The trilinear value and its gradient at a point; false outside of the grid. `nearest` is the grid
// point next to it.
bool pci_distance_field_sample(const pci_distance_field *field, const double point[3],
                               double *distance, double gradient[3], size_t *nearest);

// Sum of the solid angles of all triangles over 4 pi, exact. For tests.
double pci_winding_number(const pc_mesh *mesh, const double point[3]);

#endif
