// The matrix M of skin_quadratic.h: which vertices stand together in groups, and the rows of these.
// For skin*.c.
#ifndef PCI_SKIN_MATRIX_H
#define PCI_SKIN_MATRIX_H

#include "stages/skin/skin_quadratic.h"

// Factor of the Laplacian over the rings that stands for L_r and L_s. L_s resists along an edge,
// one direction of three: as much in all of them would bound the energy, but make the steps short.
// With half of the bound or more, sweeps still converge.
double pci_skin_ring_scale(const double scale[4]);

// Groups, their colours and the rows of M, into a quadratic that knows the number of vertices.
// False: out of memory.
bool pci_skin_matrix_build(pci_scratch *scratch, const pci_skin_problem *problem,
                           const double scale[4], double diagonal, pci_skin_quadratic *quadratic);

// The values of the rows once more. False: out of memory.
bool pci_skin_matrix_fill(pci_scratch *scratch, const pci_skin_problem *problem,
                          const double scale[4], double diagonal, pci_skin_quadratic *quadratic);

#endif
