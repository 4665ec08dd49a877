// Closing slits and notches of a border that the edges of a proxy cannot follow.
#ifndef PCI_NOTCHES_H
#define PCI_NOTCHES_H

#include "core/core.h"
#include "proxycloth/mesh.h"

// Fills notches whose mouth is narrower than half of `spacing`, the expected edge length, and which
// are less deep than .55 of it: the border runs straight across. A vertex at the tip alone would
// open them to twice an edge. Deeper ones stay (pci_find_corners), and so do the tips of those that
// only begin narrow. Adds triangles, no vertices; components, loops and Euler number stay.
// @param mesh  manifold and consistently oriented (pci_mesh_repair)
// False: out of memory.
bool pci_fill_notches(pci_scratch *scratch, double spacing, pc_mesh *mesh);

#endif
