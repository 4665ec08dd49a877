// Separation for the cycle program: negative cycles whose edges are violated too little. Cycles
// through the ground are left to the potentials.
#ifndef PCI_CYCLE_SEARCH_H
#define PCI_CYCLE_SEARCH_H

#include "solvers/cycle_program.h"

typedef struct pci_cycle_search {
    pci_cycle_program *program;
    pci_signed_rows rows;
    uint32_t *others; // beside `rows.edges`: their other ends
    // Clusters of vertices, each with a tree.
    uint32_t cluster_count;
    uint32_t *clusters; // all by vertex
    uint32_t *parents;  // edge to the parent in the tree
    uint32_t *depths;
    uint8_t *parities; // of the opposite edges on the way to the root
    uint32_t *queue;
    size_t *offsets; // by cluster, into `arcs`
    struct pci_cluster_arc *arcs;
    // One search from each root.
    size_t root_count;
    uint32_t *roots; // clusters
    uint8_t *is_root;
    size_t max_settled;
    struct pci_cluster_searcher *searchers; // one per thread
    struct pci_found_cycle *found;
    uint32_t *cycles; // edges, a fixed number for each root
    size_t cycle_capacity;
    uint32_t *used; // new cycles through an edge
    // Paths that close edges.
    float *lengths; // of the edges
    uint32_t *violated;
    const uint32_t *batch;
} pci_cycle_search;

// Everything comes from `scratch`. False: out of memory.
bool pci_cycle_search_create(pci_scratch *scratch, pci_cycle_program *program,
                             pci_cycle_search *search);

// Adds violated cycles to the program. `labels` are some good labels: each negative cycle has an
// edge whose wish they do not grant, so the searches start there. `round` varies the trees. Adds
// the number of visited arcs to `work`. False: out of memory or cancelled.
bool pci_cycle_search_run(pci_cycle_search *search, const uint8_t *labels, uint32_t round,
                          size_t *added, uint64_t *work);

// Packs cycles that still fit into the capacities, of one edge each that the labels violate, and
// subtracts them. Returns the sum of their amounts.
int64_t pci_cycle_search_fill(pci_cycle_search *search, const uint8_t *labels, int64_t *capacities,
                              uint64_t *work);

#endif
