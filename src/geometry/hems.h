// The free hems of a garment: where its cloth ends and no other cloth goes on.
#ifndef PCI_HEMS_H
#define PCI_HEMS_H

#include "geometry/bvh.h"
#include "geometry/topology.h"

typedef struct pci_hems {
    size_t count;
    double *points;  // #count by 2 by 3: pieces of edges, each shorter than half the reach
    double *inwards; // #count by 3: unit vector along the cloth, away from the hem
} pci_hems;

// Edges of one triangle (equal triangles and those with a repeated vertex count once or not at
// all), in pieces. `topology`: the edges of `mesh`. A piece does not count where the cloth of
// another triangle lies within half of `reach` of the point that is `reach` in front of it: seams
// of panels that are not joined, pockets and slits narrower than `reach` are no openings. Arrays
// come from scratch. False: out of memory, or cancelled.
bool pci_find_hems(pci_scratch *scratch, const pc_mesh *mesh, const pci_topology *topology,
                   const pci_bvh *bvh, double reach, pci_hems *hems);

#endif
