// How much of a surface lies in two layers, and in more layers than another surface has.
#ifndef PCI_DOUBLING_H
#define PCI_DOUBLING_H

#include "geometry/bvh.h"

typedef struct pci_doubling {
    double close; // share of the area with a second, nearly parallel layer within two voxels
    // Share of the area where such layers lie over the same sheet of the garment. Sheets less than a
    // voxel apart are one, but not where the layers show each other their outsides.
    double surplus;
} pci_doubling;

// The trees are of `mesh` and of the garment. PC_OK; PC_ERROR_OUT_OF_MEMORY.
PC_NODISCARD pc_status pci_measure_doubling(pc_context *context, const char *stage,
                                            const pc_mesh *mesh, const pci_bvh *bvh,
                                            const pci_bvh *garment, double voxel,
                                            pci_doubling *result);

#endif
