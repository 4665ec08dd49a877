// Small quadratic programs over the unit simplex. For skin*.c.
#ifndef PCI_SKIN_SIMPLEX_H
#define PCI_SKIN_SIMPLEX_H

#include "core/core.h"

// Minimises 1/2 (x - w)^T A (x - w) + g^T (x - w) over x >= 0, sum x = 1, exactly up to rounding,
// by the primal active-set method. A is positive semidefinite; `ridge` > 0, added to its diagonal,
// bounds the rounding errors in its null space.
// @param[in,out] w  in: any point of the simplex; out: the minimum.
// @param[in,out] g  in: the gradient at w; out: at the minimum (without the ridge).
void pci_simplex_minimize(uint32_t count, const double *a, double ridge, double *w, double *g);

// The slot that costs least to fix at 0 while the others adapt with their sum kept and signs
// ignored: the least w_k^2 / (2 C_kk), C the inverse of A on changes of sum 0. Ties to the index.
uint32_t pci_simplex_least(uint32_t count, const double *a, double ridge, const double *w);

#endif
