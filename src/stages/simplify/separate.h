// Searches a coarse mesh free of crossings and slivers, one triangle after the other.
#ifndef PCI_SEPARATE_H
#define PCI_SEPARATE_H

#include "stages/simplify/relax.h"

// The least angle that every triangle should have, in degrees.
#define PCI_LEAST_ANGLE 20.0

// What is wrong with a mesh.
typedef struct pci_flaws {
    size_t crossings; // pairs of triangles
    size_t slivers;   // triangles with an angle below PCI_LEAST_ANGLE
} pci_flaws;

// For every triangle that crosses another one or is a sliver: flips its edges, and moves its
// vertices alone, in pairs or all three, wherever that lowers the length of what crosses and the
// lack of angle. A lower sum is taken even when the vertex leaves the surface, by at most `spacing`
// a step, the nearer the better. Nothing moves in a mesh without flaws.
// @param spacing  edge length that is expected
// @param flaws    receives what is left
// False: out of memory or cancelled.
bool pci_separate(pci_scratch *scratch, pci_relaxation *relaxation, double spacing,
                  pci_flaws *flaws);

#endif
