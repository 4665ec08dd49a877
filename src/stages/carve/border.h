// Puts the border of a surface made of voxels onto the hems of the garment.
#ifndef PCI_BORDER_H
#define PCI_BORDER_H

#include "geometry/bvh.h"
#include "geometry/topology.h"

// Moves the border vertices of `layer` that are within 1.5 voxels of a free hem (geometry/hems.h)
// of the same cloth onto it, evens them out along the hem, and lets the four rings of vertices
// behind them follow on `surface`. Other borders stay. The triangles stay as they are.
// @param edges  of `surface`
// @param cut    0, or how far beside the cloth the layer has been cut: then only what is beside it
//               moves, and hems of gaps wider than this are free, not only those wider than a voxel
// @param layer  manifold and consistently oriented; lies near `surface`
// @return PC_OK; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY (Embree failed).
PC_NODISCARD pc_status pci_snap_border(pc_context *context, const char *stage,
                                       const pc_mesh *surface, const pci_topology *edges,
                                       const pci_bvh *surface_bvh, double cut, double cell_size,
                                       pc_mesh *layer);

#endif
