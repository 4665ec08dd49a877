// The linear program behind the cycle bound, over a growing set of negative cycles C:
//   min c y,  sum of y over each C >= 1,  0 <= y <= 1      (which wishes to violate)
//   max sum f,  load of each edge <= c,   f >= 0           (packing of the cycles into the costs)
// Solved by the primal-dual hybrid gradient method; needs no factorisation and restarts warm.
#ifndef PCI_CYCLE_PROGRAM_H
#define PCI_CYCLE_PROGRAM_H

#include "core/signed_graph.h"

typedef struct pci_cycle {
    size_t end; // of its edges in `entries`; they begin where those of the cycle before end
    double f, f_sum, f_start;
    uint64_t hash; // of the set of edges, never 0
} pci_cycle;

typedef struct pci_cycle_program {
    pci_scratch *scratch;
    const pci_signed_graph *graph;
    double scale;  // cost = integer cost * scale, 1 on average
    double *costs; // all by edge
    double *y, *y_bar, *y_sum, *y_start;
    double *load;
    uint32_t *degrees; // cycles through the edge
    size_t cycle_count, cycle_capacity;
    pci_cycle *cycles;
    size_t entry_count, entry_capacity;
    uint32_t *entries;
    size_t set_size;
    uint64_t *set;  // hashes of the cycles, open addressing, 0 where empty
    double weight;  // of the primal against the dual side
    double average; // steps in the sums
} pci_cycle_program;

// Everything comes from `scratch`. False: out of memory.
bool pci_cycle_program_create(pci_scratch *scratch, const pci_signed_graph *graph,
                              pci_cycle_program *program);

// Adds a cycle unless it is there already. False: out of memory.
bool pci_cycle_program_add(pci_cycle_program *program, const uint32_t *edges, size_t count,
                           bool *added);

// Improves y and f; returns the relative error of the optimality conditions.
double pci_cycle_program_iterate(pci_cycle_program *program, uint32_t iterations);

// Forgets cycles that carry no flow and are satisfied with a margin.
void pci_cycle_program_purge(pci_cycle_program *program);

// Rounds f to integers that fit into the costs of the graph. residuals[e]: what is left of the
// cost of edge e. Returns the sum packed, a proven bound on the cost without the constant.
int64_t pci_cycle_program_pack(pci_cycle_program *program, int64_t *residuals);

#endif
