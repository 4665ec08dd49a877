// Minimisation over signed graphs: every edge wants its two labels equal or opposite and costs
// `cost` when it does not get its wish. Any pairwise binary energy takes this form (vertex 0, the
// ground, has label 1; an edge to it is a preference of one vertex). Costs are integers, so that
// flows, bounds and comparisons are exact.
#ifndef PCI_SIGNED_GRAPH_H
#define PCI_SIGNED_GRAPH_H

#include "core/core.h"

typedef struct pci_signed_edge {
    uint32_t a, b; // a < b
    bool opposite; // the wish: different labels
    int64_t cost;  // > 0
} pci_signed_edge;

typedef struct pci_signed_graph {
    size_t vertex_count; // with the ground
    size_t edge_count;
    pci_signed_edge *edges; // ascending (a, b), at most one per pair
    int64_t constant;       // what parallel edges of opposite wishes cost in any case
} pci_signed_graph;

#define PCI_GROUND   0u
#define PCI_NO_LABEL 2u

// Takes over `edges` (any order, a != b, costs >= 0, parallel edges allowed; the sum of all costs
// stays below 2^62) and merges parallel edges in place.
void pci_signed_graph_create(size_t vertex_count, pci_signed_edge *edges, size_t edge_count,
                             pci_signed_graph *graph);

// Cost of a labelling, with the constant.
int64_t pci_signed_graph_cost(const pci_signed_graph *graph, const uint8_t *labels);

// Compressed rows: the edges of vertex v are edges[offsets[v] .. offsets[v + 1]), ascending.
typedef struct pci_signed_rows {
    size_t *offsets;
    uint32_t *edges;
} pci_signed_rows;
bool pci_signed_graph_rows(pci_scratch *scratch, const pci_signed_graph *graph,
                           pci_signed_rows *rows);

// Grants the wishes of all edges e with granted[e] != 0 by merging their ends. Vertex v becomes
// vertex classes[v] of `reduced`, with the same label where flips[v] is 0 and the other label where
// it is 1; the ground stays. Costs that this implies go to the constant.
typedef struct pci_contraction {
    pci_signed_graph graph;
    uint32_t *classes;
    uint8_t *flips;
} pci_contraction;
bool pci_signed_graph_contract(pci_scratch *scratch, const pci_signed_graph *graph,
                               const uint8_t *granted, pci_contraction *reduced);

static inline uint32_t pci_signed_other(const pci_signed_edge *edge, uint32_t vertex) {
    return edge->a == vertex ? edge->b : edge->a;
}

#endif
