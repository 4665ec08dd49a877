// Removes slivers that sliding and flipping cannot: searches better places for their vertices,
// collapses edges, and splits others instead.
#ifndef PCI_IMPROVE_H
#define PCI_IMPROVE_H

#include "stages/simplify/relax.h"

// The triangles at a vertex: their least angle in degrees, and how many of them look away from the
// fine surface at their corners.
typedef struct pci_fan_shape {
    double angle;
    size_t turned;
} pci_fan_shape;
pci_fan_shape pci_shape_of_fan(const pci_relaxation *relaxation, uint32_t vertex);
// The same of one triangle.
pci_fan_shape pci_shape_of_triangle(const pci_relaxation *relaxation, uint32_t triangle);

// Collapses edges of triangles with an angle below 36 degrees where that raises the least angle,
// then splits the longest ones until the number of vertices is what it was. Vertices and triangles
// are numbered anew without gaps.
// @param nearby        per fine vertex, a coarse vertex near it; follows the changes
// @param nearby_count  fine vertices
// feet and pinned are replaced by new arrays. False: out of memory or cancelled.
bool pci_improve(pci_scratch *scratch, pci_relaxation *relaxation, double spacing,
                 uint32_t *nearby);

// Moves vertices of triangles with an angle below 24 degrees off the surface, by no more than
// `reach` each, where that raises the least angle. False: out of memory.
bool pci_widen_slivers(pci_scratch *scratch, pci_relaxation *relaxation, double reach);

#endif
