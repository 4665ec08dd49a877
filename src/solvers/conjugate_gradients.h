// Conjugate gradients for symmetric positive definite maps that are given by what they do.
#ifndef PCI_CONJUGATE_GRADIENTS_H
#define PCI_CONJUGATE_GRADIENTS_H

#include "core/core.h"

typedef void (*pci_linear_map)(void *user, const double *x, double *out);

typedef struct pci_conjugate_gradients {
    size_t size;
    pci_linear_map map; // A
    void *user;
    double tolerance; // of |b - A x|, over what it is at first
    size_t most_steps;
} pci_conjugate_gradients;

// Steps from x towards the solution of A x = b. `residual`, #size, holds b - A x; `work` is #size
// by 2. Stops early where A does not look positive any more. False: cancelled.
bool pci_conjugate_gradients_run(pc_context *context, const pci_conjugate_gradients *system,
                                 double *residual, double *work, double *x);

#endif
