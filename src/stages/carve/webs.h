// Webs: where the voxels bridge a gap between two sides of a sheet, as between two legs below the
// crotch, or between a sleeve and the body.
#ifndef PCI_WEBS_H
#define PCI_WEBS_H

#include "geometry/bvh.h"
#include "geometry/topology.h"

// How far the middle of a triangle lies from the cloth: webs lie away from it, and bridge a gap in
// parts.
enum { PCI_NEAR, PCI_AWAY, PCI_BRIDGE };

// A layer that may have webs.
typedef struct pci_webbed {
    const pci_bvh *cloth; // that the layer lies on but for its webs
    double cell_size;
    pc_mesh *layer;   // manifold and consistently oriented, and stays so
    pci_shape *shape; // of the layer; pci_mend_webs needs it and keeps it up
    uint8_t *away;    // #F of the layer, from scratch
} pci_webbed;

// Finds `away`. False: out of memory, or cancelled.
bool pci_find_away(pci_scratch *scratch, pci_webbed *webbed);

// Takes the walls of the gap in the place of a web, where these are one piece of another mesh that
// ends along the web's border, and bridge less than half as much; of several plies the nearest. All
// of this is done or nothing: the layer's components and loops stay.
// @param other       manifold and consistently oriented; faces the other way than the layer: the
//                    other side of the projected mesh, or the cloth turned over
// @param kept        #F of `other`, what the layer was made of; NULL: nothing
// @param most_rings  1: walls begin at the border of a web. More: if there are none, also so many
//                    rings of vertices before it
// @param webbed      `away` is known, and found again where the layer has changed
// @return PC_OK; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY; PC_ERROR_TOO_LARGE;
//         PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pci_mend_webs(pci_scratch *scratch, const char *stage, const pc_mesh *other,
                                     const uint8_t *kept, uint8_t most_rings, pci_webbed *webbed);

#endif
