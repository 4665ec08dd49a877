// The motion of a garment against that of its closest points on the proxy. For skin*.c.
#ifndef PCI_SKIN_COMPARE_H
#define PCI_SKIN_COMPARE_H

#include "stages/skin/skin_fit.h"

// Of the garment over those of its closest points.
typedef struct pci_skin_ratios {
    double motion; // mean distance from rest
    double strain; // mean relative change of the edges' lengths
} pci_skin_ratios;

// The motion of the closest points, which the fit may forget then. False: out of memory.
bool pci_skin_measure_closest(pci_skin_fit *fit);

// From some of the frames, once that is measured, for the weights of the fit, rows that sum to 1.
// False: out of memory.
bool pci_skin_compare(const pci_skin_fit *fit, pci_skin_ratios *ratios);

#endif
