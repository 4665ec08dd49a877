// Small quadratic programs over the unit simplex. For skin*.c.
#ifndef PCI_SKIN_SIMPLEX_H
#define PCI_SKIN_SIMPLEX_H

#include "core/core.h"

// Minimises 1/2 (x - w)^T A (x - w) + g^T (x - w) over x >= 0, sum x = 1, exactly up to rounding,
// by the primal active-set method. A is positive semidefinite; `ridge`, added to its diagonal,
// bounds the rounding errors in its null space: at least 1e-8 of the trace.
// @param[in,out] w  in: any point of the simplex; out: the minimum.
// @param[in,out] g  in: the gradient at w; out: at the minimum (without the ridge).
void pci_simplex_minimize(uint32_t count, const double *a, double ridge, double *w, double *g);

// Whether a slot at 0 with this slope lowers the objective, where those in use have another.
bool pci_simplex_enters(double slope, double multiplier);

// Gives what a sum lacks to 1 by rounding to the largest weight.
void pci_simplex_round(uint32_t count, double *w);

// C = N^T F^T F N, the inverse of A + ridge I on changes of sum 0, where N takes the first number
// from each of the others: C turns a gradient into minus the step to the minimum that ignores
// signs. Where A is nearly singular, numbers of C rounded to float would step far off; F may be
// rounded, as what it gives is still an inverse of something close.
// @param[out] factor  F, lower triangular, by rows of 1 to n - 1.
void pci_simplex_factor(uint32_t n, double ridge, const double *a, double *factor);

// Minimises likewise; then takes slots away until `kept` are left: the one that costs least to fix
// at 0 while the others adapt with their sum kept and signs ignored, w_k^2 / (2 C_kk) with C as
// above; then minimises over those that are left. Returns the slots that are, as bits.
uint64_t pci_simplex_prune(uint32_t count, const double *a, double ridge, uint32_t kept, double *w,
                           double *g);

#endif
