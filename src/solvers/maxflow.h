// Maximum flow with integer capacities, by Boykov and Kolmogorov's two search trees
// ("An experimental comparison of min-cut/max-flow algorithms", 2004).
#ifndef PCI_MAXFLOW_H
#define PCI_MAXFLOW_H

#include "core/core.h"

// Arc k and arc k ^ 1 connect the same two nodes in the two directions. `terminals[v]` > 0 is the
// capacity from the source to v, < 0 minus the capacity from v to the sink. The capacities are
// replaced by the residual ones.
typedef struct pci_flow_network {
    size_t node_count;
    size_t arc_count;
    const uint32_t *heads; // #arcs; the tail of arc k is heads[k ^ 1]
    const size_t *offsets; // #nodes + 1, into `arcs`
    const uint32_t *arcs;  // arcs that leave a node
    int64_t *capacities;   // #arcs, >= 0
    int64_t *terminals;    // #nodes
} pci_flow_network;

// The flow's value goes to `flow`; reachable[v] = 1 where v can be reached from the source in the
// residual network (the smallest source side of a minimum cut). False: out of memory
// or cancelled.
bool pci_maxflow(pc_context *context, const pci_flow_network *network, int64_t *flow,
                 uint8_t *reachable);

#endif
