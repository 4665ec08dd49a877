// Exact minimum of a signed graph by variable elimination; cheap where the treewidth is small.
#ifndef PCI_ELIMINATION_H
#define PCI_ELIMINATION_H

#include "solvers/signed_graph.h"

#define PCI_ELIMINATION_MAX_WIDTH 24u

// Fills `labels` with a minimum when the elimination order that was found is no wider than
// `max_width` (the most vertices, without the ground, that an eliminated one depends on) and its
// tables have at most `max_entries` entries in total; otherwise `solved` is false and `labels` is
// untouched. Returns false when memory ran out.
bool pci_eliminate(pc_context *context, const pci_signed_graph *graph, uint32_t max_width,
                   uint64_t max_entries, uint8_t *labels, bool *solved);

#endif
