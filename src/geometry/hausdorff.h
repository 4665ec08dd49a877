// How far one surface strays from another, with an error bound.
#ifndef PCI_HAUSDORFF_H
#define PCI_HAUSDORFF_H

#include "geometry/bvh.h"

// Directed Hausdorff distance max over p in `from` of the distance to `to`. The result is attained
// by a point of `from` and below the true maximum by at most `tolerance` plus 1e-4 of
// itself. Only vertices that a triangle uses count.
// @return PC_OK; PC_ERROR_OUT_OF_MEMORY.
PC_NODISCARD pc_status pci_directed_hausdorff(pc_context *context, const char *stage,
                                              const pc_mesh *from, const pc_mesh *to,
                                              const pci_bvh *to_bvh, double tolerance,
                                              double *distance);

#endif
