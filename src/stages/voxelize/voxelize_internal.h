// What the parts of stage 1 share.
#ifndef PCI_VOXELIZE_INTERNAL_H
#define PCI_VOXELIZE_INTERNAL_H

#include "core/core.h"
#include "geometry/bvh.h"
#include "proxycloth/voxelize.h"

// Lattice points that are kept.
typedef struct pci_narrow_band {
    uint32_t voxels; // N_v
    double width;    // voxels
    double from, to; // progress before and after
} pci_narrow_band;

// Sets origin, size, cell size and band of the grid. PC_ERROR_INVALID_ARGUMENT: no extent.
PC_NODISCARD pc_status pci_place_lattice(pc_context *context, const pc_mesh *surface,
                                         uint32_t voxels, double band_voxels, pc_grid *grid);

// Samples the distance to a surface. Adds to *queries.
PC_NODISCARD pc_status pci_sample_narrow_band(pc_context *context, const pc_mesh *surface,
                                              const pci_bvh *bvh, const pci_narrow_band *band,
                                              pc_grid *grid, uint64_t *queries);

// Chooses N_v by the rule in voxelize.h; fills in `voxels` and what was measured.
PC_NODISCARD pc_status pci_choose_voxels(pc_context *context, const pc_mesh *surface,
                                         const pci_bvh *bvh, pc_voxelize_report *report);

#endif
