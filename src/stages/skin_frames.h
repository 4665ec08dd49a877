// A weight problem in the layout of the kernels, with its frames in blocks. For skin*.c.
#ifndef PCI_SKIN_FRAMES_H
#define PCI_SKIN_FRAMES_H

#include "stages/skin_internal.h"

enum { PCI_SKIN_PIECE = 64, PCI_SKIN_SLOTS_MAX = 64 }; // vertices per piece of a parallel loop

typedef struct pci_skin_frames {
    pc_context *context;
    const pci_skin_problem *problem;
    const pci_skin_kernel *kernel;
    pci_skin_data data;
    size_t block_count;
    const uint32_t *frames; // #blocks by PCI_BLOCK, PC_INVALID_INDEX where a block is not full
    char *drivers;          // #blocks, see pci_skin_data
    char *quaternions;
    size_t driver_size, quaternion_size; // bytes per block
    double unit;                         // lengths are multiplied by this
} pci_skin_frames;

// `frames`: #blocks by PCI_BLOCK, the frames of each block, PC_INVALID_INDEX where it is not full.
// `kept_blocks`: 1 to hold one block at a time, block_count to hold all.
bool pci_skin_frames_build(pci_scratch *scratch, const pci_skin_problem *problem,
                           const pci_skin_kernel *kernel, size_t block_count,
                           const uint32_t *frames, size_t kept_blocks, pci_skin_frames *w);

// Blocks in which each lane walks through consecutive frames, so the rotations of a frame are a
// good guess for the next.
bool pci_skin_frames_build_sequential(pci_scratch *scratch, const pci_skin_problem *problem,
                                      const pci_skin_kernel *kernel, bool keep_all,
                                      pci_skin_frames *w);

void pci_skin_frames_use(pci_skin_frames *w, size_t block, size_t kept);
void pci_skin_frames_set_weights(pci_skin_frames *w, const double *weights);

// One step of the kernels over all vertices for the block in use; `sums` per piece, or NULL.
void pci_skin_frames_displace(pci_skin_frames *w);
void pci_skin_frames_fit(pci_skin_frames *w, pci_skin_sums *sums);
void pci_skin_frames_gradient(pci_skin_frames *w);

// Adds the sums of a block, `pieces` of them, to `measures`; `per_frame` (#frames by 3) may be
// NULL.
void pci_skin_frames_add(const pci_skin_frames *w, size_t block, size_t pieces,
                         const pci_skin_sums *sums, pci_skin_measures *measures, double *per_frame);

// Elements of arrays of the kernel's real type.
void *pci_skin_reals(pci_scratch *scratch, const pci_skin_kernel *kernel, size_t count);
void pci_skin_put(const pci_skin_kernel *kernel, void *array, size_t index, double value);
double pci_skin_get(const pci_skin_kernel *kernel, const void *array, size_t index);

#endif
