// Webs: where the voxels bridge a gap between two sides of a sheet, as between two legs below the
// crotch, or between a sleeve and the body.
#ifndef PCI_WEBS_H
#define PCI_WEBS_H

#include "geometry/bvh.h"

// How far the middle of a triangle lies from the cloth: webs lie away from it, and bridge a gap in
// parts.
enum { PCI_NEAR, PCI_AWAY, PCI_BRIDGE };

// Tells so of each triangle of `layer` in `away`. False: out of memory, or cancelled.
bool pci_find_away(pc_context *context, const pci_bvh *cloth, const pc_mesh *layer,
                   double cell_size, uint8_t *away);

// Takes the walls of the gap in the place of a web, where these are one piece of the other side of
// the projected mesh that ends along the web's border. All of this is done or nothing: the layer's
// components and loops stay.
// @param projected  closed
// @param kept       #F of `projected`, what the layer was made of
// @param away       #F of `layer`
// @param strictly   walls begin at the border if there are such; else, or where there are none, a
//                   triangle before it: those of narrow legs have few triangles, which cut corners
// @param layer      manifold and consistently oriented, like `projected`; it stays so
// @param mended     whether it has changed
// @return PC_OK; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY; PC_ERROR_TOO_LARGE;
//         PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pci_mend_webs(pci_scratch *scratch, const char *stage,
                                     const pc_mesh *projected, const uint8_t *kept,
                                     const uint8_t *away, double cell_size, bool strictly,
                                     pc_mesh *layer, bool *mended);

#endif
