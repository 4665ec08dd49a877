// Closing slits and notches of a border.
#ifndef PCI_NOTCHES_H
#define PCI_NOTCHES_H

#include "core/core.h"
#include "proxycloth/mesh.h"

// Fills notches that the edges of a proxy cannot follow: their mouth is narrower than half of
// `spacing`, the expected edge length, and they are less deep than .55 of it: the border runs
// straight across. A vertex at the tip alone would open them to twice an edge. Deeper ones stay
// (pci_find_corners), and so do the tips of those that only begin narrow. Adds triangles, no
// vertices; components, loops and Euler number stay.
// @param mesh  manifold and consistently oriented (pci_mesh_repair)
// False: out of memory.
bool pci_fill_notches(pci_scratch *scratch, double spacing, pc_mesh *mesh);

// Closes slits of any depth likewise, as the front of a shirt that is buttoned up: from the tip on
// to where the sides part or are farther than `reach` from each other. They may lie over each
// other.
bool pci_close_slits(pci_scratch *scratch, double reach, pc_mesh *mesh);

#endif
