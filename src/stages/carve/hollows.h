// What the labels keep of the walls of hollows.
#ifndef PCI_HOLLOWS_H
#define PCI_HOLLOWS_H

#include "core/core.h"
#include "proxycloth/mesh.h"

// The closed mesh around an outfit of closed bodies has a hollow in each of them. Where the walls
// of two hollows touch, as where an arm sits in a body, the labels keep one of them: a scrap of
// cloth that nobody sees. Clears `keep` (#F of `projected`) for the pieces of what it marks that
// lie in hollows, everywhere within `reach` of what it marks elsewhere. PC_OK;
// PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY; PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pci_leave_hollows(pci_scratch *scratch, const char *stage,
                                         const pc_mesh *projected, double reach, uint8_t *keep);

#endif
