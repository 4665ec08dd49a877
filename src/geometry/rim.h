// Where a surface ends: borders, hems, cuffs, folded edges, whatever the mesh looks like there.
#ifndef PCI_RIM_H
#define PCI_RIM_H

#include "geometry/bvh.h"
#include "geometry/knn.h"
#include "geometry/topology.h"

// Points on rims; arrays live in scratch memory.
typedef struct pci_rims {
    pci_knn points;
    double *inwards; // #P by 3, unit: from the rim into the surface
} pci_rims;

// Finds points on the rims, one for each `spacing` of edges where the surface ends. `topology`: the
// edges of `mesh`, whose triangles must not repeat vertices. PC_OK; PC_ERROR_OUT_OF_MEMORY.
PC_NODISCARD pc_status pci_find_rims(pci_scratch *scratch, const char *stage, const pci_bvh *bvh,
                                     const pc_mesh *mesh, const pci_topology *topology,
                                     double radius, double spacing, pci_rims *rims);

#endif
