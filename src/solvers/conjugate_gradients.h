// Conjugate gradients for symmetric positive definite maps that are given by what they do.
#ifndef PCI_CONJUGATE_GRADIENTS_H
#define PCI_CONJUGATE_GRADIENTS_H

#include "core/core.h"

typedef void (*pci_linear_map)(void *user, const double *x, double *out);

typedef struct pci_conjugate_gradients {
    size_t size;
    size_t columns;     // of x and b, which are solved side by side: 1 or 3
    pci_linear_map map; // A, of each column
    void *user;
    double tolerance; // of |b - A x|, over what it is at first
    size_t most_steps;
} pci_conjugate_gradients;

// Steps from x towards the solution of A x = b, both #size by #columns. `residual`, likewise, holds
// b - A x; `work` is as large as two of them. Each column ends by itself, also where A does not
// look positive any more. False: cancelled.
bool pci_conjugate_gradients_run(pc_context *context, const pci_conjugate_gradients *system,
                                 double *residual, double *work, double *x);

#endif
