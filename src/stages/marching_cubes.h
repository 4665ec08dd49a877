// Marching cubes, for stage 2 and for the choice of stage 1's resolution.
#ifndef PCI_MARCHING_CUBES_H
#define PCI_MARCHING_CUBES_H

#include "core/core.h"
#include "proxycloth/isosurface.h"

// The mesh of stage 2, from a grid that keeps its promises.
PC_NODISCARD pc_status pci_marching_cubes(pc_context *context, const pc_grid *grid,
                                          double iso_voxels, pc_mesh *mesh);

#endif
