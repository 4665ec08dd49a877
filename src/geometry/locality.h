// Memory order that follows space: neighbours in a mesh become neighbours in memory.
#ifndef PCI_LOCALITY_H
#define PCI_LOCALITY_H

#include "core/core.h"
#include "proxycloth/mesh.h"

// Sorts points along a Morton curve through their bounding cube: order[new] = old, from scratch,
// ties by index. False: out of memory.
bool pci_sort_points(pci_scratch *scratch, size_t count, const double *positions, uint32_t **order);

// Renumbers the vertices along a Morton curve through their bounding box, and the triangles by
// their first vertex. Result and input may not share arrays; `result` has arrays from scratch.
// `order` (#V, from scratch) receives the old index of each new vertex. False: out of memory.
bool pci_sort_mesh(pci_scratch *scratch, const pc_mesh *mesh, pc_mesh *result, uint32_t **order);

#endif
