// The same problem on some of the vertices, which stand for all: what varies slowly over the
// garment is found there at little cost. For skin*.c.
#ifndef PCI_SKIN_COARSE_H
#define PCI_SKIN_COARSE_H

#include "stages/skin/skin_gram.h"

typedef struct pci_skin_coarse {
    pci_skin_problem problem;
    uint32_t *vertices; // #coarse: which they are of the fine problem
    uint32_t *clusters; // #fine: the coarse vertex that stands for each, itself or a neighbour
} pci_skin_coarse;

// No two coarse vertices are neighbours; they have an edge where vertices that they stand for have
// one. Candidates stay. False: out of memory.
bool pci_skin_coarsen(pci_scratch *scratch, const pci_skin_problem *fine, pci_skin_coarse *coarse);

// Moves all vertices as the coarse ones near them have moved since the weights were theirs: finds
// the weights that come closest, by G, to adding the change of the coarse ones (#coarse by slots).
// Weights (in and out) #fine by slots. False: out of memory.
bool pci_skin_prolong(pci_scratch *scratch, const pci_skin_gram *gram, const pci_skin_problem *fine,
                      const pci_skin_coarse *coarse, const double *change, double *weights);

#endif
