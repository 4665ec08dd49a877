// Seams whose two sides have vertices in different places.
#ifndef PCI_STITCH_H
#define PCI_STITCH_H

#include "core/core.h"
#include "geometry/topology.h"

// Splits every edge of the border at the vertices of the border that lie on it, nearer than
// `reach`, so that both sides of a seam have the same vertices; those at one place become one.
// Edges of which less than half lies on others are left alone. `some` tells whether there were any.
// Only then `result` receives the mesh, which belongs to the caller (pc_mesh_free) and need not be
// a manifold. PC_OK; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY; PC_ERROR_TOO_LARGE;
// PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pci_stitch_borders(pci_scratch *scratch, const char *stage,
                                          const pc_mesh *mesh, const pci_topology *edges,
                                          double reach, pc_mesh *result, bool *some);

#endif
