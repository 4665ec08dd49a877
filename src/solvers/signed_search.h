// Good labellings of a signed graph by local search; no proof.
#ifndef PCI_SIGNED_SEARCH_H
#define PCI_SIGNED_SEARCH_H

#include "solvers/signed_graph.h"

// Replaces `labels` when it finds a labelling of lower cost. Starts with the labels that fulfil all
// wishes along a spanning tree of edges with small keys (NULL: high costs first), descends, then
// anneals, which asks each vertex some hundred times, but at most `steps` in all. The ground keeps
// label 1. False: out of memory or cancelled.
bool pci_signed_search(pc_context *context, const pci_signed_graph *graph, const float *keys,
                       size_t steps, uint8_t *labels);

#endif
