// The entries of a Gram matrix that a problem asks for, where the proxy is too large for all. For
// skin*.c.
#ifndef PCI_SKIN_PAIRS_H
#define PCI_SKIN_PAIRS_H

#include "proxycloth/skin.h"
#include "stages/skin/skin_driver.h"

struct pci_skin_quadratic;

typedef struct pci_skin_pairs {
    size_t *offsets;  // #P + 1
    uint32_t *others; // rows of bones, ascending
    double *values;   // width by width of each: G[bone of the row, other]
} pci_skin_pairs;

// Pairs of bones of rows that M joins, and of each row with what it follows; values 0. False: out
// of memory.
bool pci_skin_pairs_build(pci_scratch *scratch, const struct pci_skin_quadratic *quadratic,
                          const pc_skin *followed, pci_skin_pairs *pairs);

// x^T G[b, c] y; 0 of pairs that are not there.
double pci_skin_pairs_product(const pci_skin_pairs *pairs, size_t columns, uint32_t b, uint32_t c,
                              const double *x, const double *y);

#endif
