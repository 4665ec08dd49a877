// Moves the vertices of a coarse mesh so that its triangles, not only its vertices, approximate the
// fine surface, with weight on the largest deviations.
#ifndef PCI_FIT_H
#define PCI_FIT_H

#include "stages/simplify/relax.h"

// @param nearby   per fine vertex, a coarse vertex near it
// @param areas    per fine vertex, its share of the surface
// @param arcs     per fine vertex, its share of the border, 0 inside
// @param spacing  edge length that is expected; bounds the steps
// False: out of memory or cancelled.
bool pci_fit(pci_scratch *scratch, pci_relaxation *relaxation, const uint32_t *nearby,
             const double *areas, const double *arcs, double spacing, size_t passes);

#endif
