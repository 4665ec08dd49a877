// Turns any set of triangles into a manifold with boundary that is consistently oriented.
#ifndef PCI_MANIFOLD_H
#define PCI_MANIFOLD_H

#include "core/core.h"
#include "proxycloth/mesh.h"

typedef struct pci_repair_counts {
    uint64_t removed_triangles; // degenerate, duplicate, or crowded around one edge
    uint64_t flipped_triangles;
    uint64_t split_vertices; // vertices added
} pci_repair_counts;

// Keeps the marked triangles (NULL: all) except degenerate and duplicate ones. At an edge of more
// than two triangles only the flattest pair (of the first 64) stays joined, unless it is folded
// back at less than a right angle, as where several layers hang from one border; patches are
// oriented by the majority of their area, a one-sided surface is cut open; each fan of a vertex
// becomes a vertex of its own. What is still crowded around one edge then is removed. No vertex is
// left unused; the result may have no triangle. It belongs to the caller (pc_mesh_free). False: out
// of memory, or cancelled.
bool pci_mesh_repair(pci_scratch *scratch, const pc_mesh *mesh, const uint8_t *keep,
                     pc_mesh *result, pci_repair_counts *counts);

#endif
