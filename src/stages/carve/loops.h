// Filling the holes of a layer.
#ifndef PCI_LOOPS_H
#define PCI_LOOPS_H

#include "geometry/bvh.h"
#include "geometry/topology.h"

// Which loops are holes.
typedef struct pci_hole_limits {
    size_t most_edges; // of a loop
    double longest;    // way around it
    // What a layer was cut from goes on across a hole, not across an opening; NULL: not asked.
    const pc_mesh *whole;
    pci_bvh **tree; // of that; built here when it is needed and was not before
    // Also longer loops where a few faces are missing: up to six edges, flat, small beside the
    // part.
    bool missing_faces;
} pci_hole_limits;

// Closes boundary loops that are holes, with a fan around their mean or with one triangle. A loop
// that bounds its part from outside stays: the part needs twice the area of a disc of that
// circumference. `filled` is added to. The mesh must be manifold; `topology`: its edges.
// Returns PC_OK, PC_ERROR_OUT_OF_MEMORY or PC_ERROR_DEPENDENCY.
pc_status pci_fill_loops(pci_scratch *scratch, const char *stage, const pci_topology *topology,
                         const pci_hole_limits *limits, pc_mesh *mesh, uint64_t *filled);

#endif
