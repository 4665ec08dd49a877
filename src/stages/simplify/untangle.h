// Takes a coarse mesh apart where it crosses itself.
#ifndef PCI_UNTANGLE_H
#define PCI_UNTANGLE_H

#include "stages/simplify/relax.h"

// Pushes the end of each edge that pierces a triangle back to the near side, and the triangle the
// other way, until nothing crosses or the steps are used up; the state with the fewest crossings is
// kept. Least angles never get worse than 20 degrees or than they were.
// @param spacing  edge length that is expected; bounds the steps
// @param left     receives the number of pairs of triangles that still cross
// False: out of memory or cancelled.
bool pci_untangle(pci_scratch *scratch, pci_relaxation *relaxation, double spacing, size_t *left);

#endif
