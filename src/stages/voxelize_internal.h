// What the parts of stage 1 share, and marching cubes for the choice of its resolution.
#ifndef PCI_VOXELIZE_INTERNAL_H
#define PCI_VOXELIZE_INTERNAL_H

#include "core/bvh.h"
#include "core/core.h"
#include "proxycloth/isosurface.h"
#include "proxycloth/voxelize.h"

typedef struct pci_sampling {
    uint32_t voxels;    // N_v
    double band_voxels; // of the samples that are kept
    double from, to;    // progress before and after
} pci_sampling;

// Samples the distance to a surface that has an extent. Adds to *queries.
PC_NODISCARD pc_status pci_sample_distance(pc_context *context, const pc_mesh *surface,
                                           const pci_bvh *bvh, const pci_sampling *sampling,
                                           pc_grid *grid, uint64_t *queries);

// Chooses N_v by the rule in voxelize.h; fills in `voxels` and what was measured.
PC_NODISCARD pc_status pci_choose_voxels(pc_context *context, const pc_mesh *surface,
                                         const pci_bvh *bvh, pc_voxelize_report *report);

// The mesh of stage 2, from a grid that keeps its promises.
PC_NODISCARD pc_status pci_marching_cubes(pc_context *context, const pc_grid *grid,
                                          double iso_voxels, pc_mesh *mesh);

#endif
