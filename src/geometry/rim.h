// Where a surface ends: borders, hems, cuffs, folded edges, whatever the mesh looks like there.
#ifndef PCI_RIM_H
#define PCI_RIM_H

#include "geometry/bvh.h"
#include "geometry/knn.h"

// How far the centre of the surface inside a small ball lies beside the ball's centre, in radii:
// 0 inside a surface, 0.3 on a square edge, 4 / (3 pi) = 0.42 where one or more sheets end. `point`
// lies on the mesh. Where too many triangles are inside, the ball is halved. `inward`: the way to
// the surface's centre, unit or zero.
double pci_one_sided(const pci_bvh *bvh, const pc_mesh *mesh, const double point[3], double radius,
                     double inward[3]);

// Above this a point lies on a rim; between a square edge and the end of a sheet.
#define PCI_RIM_ONE_SIDED 0.34

// Points on rims; arrays live in scratch memory.
typedef struct pci_rims {
    pci_knn points;
    double *inwards; // #P by 3, unit: from the rim into the surface
} pci_rims;

// Finds points on the rims, one for each `spacing` of edges where the surface ends. Triangles must
// not repeat vertices. PC_OK; PC_ERROR_OUT_OF_MEMORY.
PC_NODISCARD pc_status pci_find_rims(pci_scratch *scratch, const char *stage, const pci_bvh *bvh,
                                     const pc_mesh *mesh, double radius, double spacing,
                                     pci_rims *rims);

#endif
