// Corners of the border of a mesh: where an apron's hem meets its side.
#ifndef PCI_CORNERS_H
#define PCI_CORNERS_H

#include "geometry/halfedge.h"

// Lists the border vertices, sharpest turn first, where the border turns sharply on the scale of
// `reach`: seen over that length to both sides, by 60 degrees more than a circle as long as the
// loop would turn, and by more than anywhere else within reach. False: out of memory.
bool pci_find_corners(pci_scratch *scratch, const pci_halfedge *mesh, double reach,
                      uint32_t **corners, size_t *count);

#endif
