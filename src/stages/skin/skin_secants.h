// What the last rounds tell of the energy: their steps, and how the gradient changed over each.
// The rotations follow there, which the quadratic energy of fixed ones does not know. For skin*.c.
#ifndef PCI_SKIN_SECANTS_H
#define PCI_SKIN_SECANTS_H

#include "stages/skin/skin_quadratic.h"

enum { PCI_SKIN_SECANTS = 2 };

typedef struct pci_skin_secants {
    const pci_skin_quadratic *quadratic;
    // Rows by slots, by member. While a step has begun its change is the gradient at its start.
    float *steps[PCI_SKIN_SECANTS], *changes[PCI_SKIN_SECANTS];
    uint32_t room;                     // steps that are kept
    uint32_t first;                    // the latest; older ones follow, round and round
    uint32_t count;                    // of steps with their changes
    bool begun;                        // the latest is another, not complete yet
    struct pci_skin_secant_sums *sums; // #groups
} pci_skin_secants;

// Of problems with the slots that the quadratic has now. `room`: steps that are kept, 1 at least.
// False: out of memory.
bool pci_skin_secants_build(pci_scratch *scratch, const pci_skin_quadratic *quadratic,
                            uint32_t room, pci_skin_secants *secants);

// The gradient is of other frames from now on: the step that has begun tells nothing.
void pci_skin_secants_interrupt(pci_skin_secants *secants);

// Completes the step that has begun, which went `moved` further than it was to, and begins another:
// to where the gradient would have no part along the known steps, were it to change along each as
// it has. The weights go there, but no further than the simplex. Returns what the energy falls by.
// @param[in,out] gradient  #groups, of the members, by slots: at the weights; out: at the end of
//                          the step.
// @param[in,out] moved     #V by slots; out: from the end of the step to the weights.
// @param[in,out] weights   #V by slots.
double pci_skin_secants_step(pci_skin_secants *secants, float *const *gradient, float *moved,
                             double *weights);

#endif
