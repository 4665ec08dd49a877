// The linear program behind the cycle bound, over a growing set of negative cycles C:
//   min c y                          which wishes to violate, 0 <= y <= 1
//   y_ab >= |u_a - s_ab u_b|         -1/2 <= u <= 1/2 and 1/2 at the ground, s = -1 for opposite
//   sum of y over each C >= 1
// The potentials u stand for all cycles through the ground (the relaxation behind roof duality);
// their duals are a flow z. The dual program packs the flow and the cycles, f, into the costs.
// Solved by the primal-dual hybrid gradient method; needs no factorisation and restarts warm.
#ifndef PCI_CYCLE_PROGRAM_H
#define PCI_CYCLE_PROGRAM_H

#include "solvers/signed_graph.h"

typedef struct pci_cycle {
    size_t end; // of its edges in `entries`; they begin where those of the cycle before end
    float f, f_sum, f_start;
    uint64_t hash; // of the set of edges, never 0
} pci_cycle;

typedef struct pci_flow {
    float forward, backward; // from a to b and back
} pci_flow;

// Single precision: only the certificate has to be exact.
typedef struct pci_cycle_program {
    pci_scratch *scratch;
    const pci_signed_graph *graph;
    double scale;         // cost = integer cost * scale, 1 on average
    float *costs, *signs; // all by edge; -1: the wish is different labels
    uint32_t *heads;      // the later vertex
    float *y, *y_bar, *y_sum, *y_start;
    pci_flow *z, *z_sum, *z_start;
    float *load, *y_rates;              // step lengths
    uint32_t *degrees;                  // cycles through the edge
    bool has_flow;                      // at least two edges at the ground
    float *u, *u_bar, *u_sum, *u_start; // all by vertex
    float *excess, *u_rates;            // what the flow takes out of a vertex; step lengths
    uint32_t *valences, *later;         // edges at a vertex, and to later ones
    size_t cycle_count, cycle_capacity;
    pci_cycle *cycles;
    size_t entry_count, entry_capacity;
    uint32_t *entries;
    size_t set_size;
    uint64_t *set;    // hashes of the cycles, open addressing, 0 where empty
    float weight;     // of the primal against the dual side
    uint32_t average; // steps in the sums
    double value;     // c y after the last iterations
} pci_cycle_program;

// Everything comes from `scratch`. False: out of memory.
bool pci_cycle_program_create(pci_scratch *scratch, const pci_signed_graph *graph,
                              pci_cycle_program *program);

// Adds a cycle unless it is there already. False: out of memory.
bool pci_cycle_program_add(pci_cycle_program *program, const uint32_t *edges, size_t count,
                           bool *added);

// A fixed number of steps that improve y and f, PCI_PROGRAM_STEPS; returns the relative error of
// the optimality conditions.
#define PCI_PROGRAM_STEPS 40
double pci_cycle_program_iterate(pci_cycle_program *program);

// Forgets cycles that carry no flow and are satisfied with a margin.
void pci_cycle_program_purge(pci_cycle_program *program);

// Packs integer amounts close to f into `capacities`, or all that fits when `fill` is set, and
// subtracts them. Returns their sum: what the labels that violate nothing else cost at least.
int64_t pci_cycle_program_pack(pci_cycle_program *program, bool fill, int64_t *capacities);

#endif
