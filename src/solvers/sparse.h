// Sparse symmetric positive definite systems: the only place that knows SuiteSparse.
#ifndef PCI_SPARSE_H
#define PCI_SPARSE_H

#include "core/core.h"

typedef struct pci_cholesky pci_cholesky;

// Factorises a symmetric positive definite matrix, given by its columns (both triangles, row
// indices ascending per column). AMD ordering; the same bits on every run.
// @return PC_OK; PC_ERROR_TOO_LARGE; PC_ERROR_NUMERICAL (not positive definite);
//         PC_ERROR_OUT_OF_MEMORY.
PC_NODISCARD pc_status pci_cholesky_create(pc_context *context, const char *stage, size_t size,
                                           const size_t *column_offsets, const uint32_t *rows,
                                           const double *values, pci_cholesky **cholesky);
// Solves A x = b for `columns` right-hand sides; b and x are row-major #size by columns, may be
// equal.
PC_NODISCARD pc_status pci_cholesky_solve(pc_context *context, const pci_cholesky *cholesky,
                                          size_t columns, const double *b, double *x);

enum { PCI_CHOLESKY_TOGETHER = 8 }; // right-hand sides that share a pass over the factor
// The unknown that stands at each place where pci_cholesky_solve_ordered has it.
const uint32_t *pci_cholesky_order(const pci_cholesky *cholesky);
// Solves for PCI_CHOLESKY_TOGETHER right-hand sides in place, on the calling thread and without
// memory; x is row-major, #size by these.
void pci_cholesky_solve_ordered(const pci_cholesky *cholesky, double *x);

void pci_cholesky_destroy(pc_context *context, pci_cholesky *cholesky); // NULL is accepted

#endif
