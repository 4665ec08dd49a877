// Joint weights of a body carried over to a garment that has none.
#ifndef PCI_TRANSFER_H
#define PCI_TRANSFER_H

#include "core/core.h"
#include "proxycloth/body.h"

typedef struct pci_transfer_counts {
    uint64_t matched, filled, rigid; // vertices, see pc_body_weights
} pci_transfer_counts;

// A body that has weights at all.
bool pci_body_is_skinned(const pc_character *character);

// Of the `count` joints in `found` with weights `sums` (spoilt), the four with the largest weights,
// falling, sum 1; all 0 where there is no weight. `found` has at least one joint.
void pci_largest_weights(const uint32_t *found, double *sums, size_t count, uint32_t joints[4],
                         double weights[4]);

// `joints` and `weights` are #V by 4 of `mesh`. The body must be skinned. PC_OK;
// PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY; PC_ERROR_NUMERICAL; PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pci_transfer_weights(pc_context *context, const char *stage,
                                            const pc_mesh *mesh, const pc_character *character,
                                            uint32_t *joints, double *weights,
                                            pci_transfer_counts *counts);

// Replaces the weights by their mixture with those of the body, in memory of the scratch: joint b
// of the character is bone `first` + b, and of the K + 4 that meet at a vertex the largest K stay.
// Leaves them where `body` is empty. False when memory ran out.
bool pci_mix_weights(pci_scratch *scratch, const pc_body_skin *body, size_t first, pc_skin *skin);

#endif
