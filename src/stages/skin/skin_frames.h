// A weight problem in the layout of the kernels: vertices in patches, frames in blocks. For
// skin*.c.
#ifndef PCI_SKIN_FRAMES_H
#define PCI_SKIN_FRAMES_H

#include "stages/skin/skin_driver.h"

enum { PCI_SKIN_SLOTS_MAX = 64, PCI_SKIN_LOADED = 2 };
// Vertices; what a patch needs of one block stays in the second-level cache.
enum { PCI_SKIN_PATCH = 256 };

typedef struct pci_skin_frames {
    pc_context *context;
    const pci_skin_problem *problem;
    const pci_skin_kernel *kernel;
    pci_skin_data data;
    double unit;      // lengths are multiplied by this
    double origin[3]; // of the points
    double *points;   // x^ of skin_driver.h in that unit, see pci_skin_point_at
    double *means;    // #frames by 3, displacements that the kernel does not see

    size_t patch_count;
    pci_skin_patch *patches;
    pci_skin_buffers *buffers; // #threads
    // What the patches know of dE/dW, and where the rows of each vertex are in it.
    void *partial;           // real, #rows by slots, or NULL
    size_t *patch_rows;      // #patches + 1, first row of each patch
    uint32_t *share_offsets; // #V + 1
    uint32_t *shares;        // #rows, ascending for each vertex

    size_t block_count;
    const uint32_t *frames; // #blocks by PCI_BLOCK, PC_INVALID_INDEX where a block is not full
    // What the proxy does in the blocks in hand, see pci_skin_kernel.
    char *drivers;      // PCI_SKIN_LOADED
    size_t driver_size; // bytes per block
    size_t loaded_first, loaded_stride, loaded_count;
} pci_skin_frames;

// What follows from the driver alone: origin, unit, columns.
void pci_skin_frames_begin(pc_context *context, const pci_skin_problem *problem,
                           const pci_skin_kernel *kernel, pci_skin_frames *w);

// `frames`: #blocks by PCI_BLOCK, the frames of each block, PC_INVALID_INDEX where it is not full.
bool pci_skin_frames_build(pci_scratch *scratch, const pci_skin_problem *problem,
                           const pci_skin_kernel *kernel, size_t block_count,
                           const uint32_t *frames, pci_skin_frames *w);

// Blocks of all frames, each with some from the whole motion. NULL: out of memory.
uint32_t *pci_skin_frames_in_sequence(pci_scratch *scratch, const pci_skin_problem *problem,
                                      size_t *block_count);
bool pci_skin_frames_build_sequential(pci_scratch *scratch, const pci_skin_problem *problem,
                                      const pci_skin_kernel *kernel, pci_skin_frames *w);

// Room for gradients, before any is asked for. False: out of memory.
bool pci_skin_frames_make_room(pci_scratch *scratch, pci_skin_frames *w);

// Takes the stiffness of edges from another problem that is the same but for it.
void pci_skin_frames_use(pci_skin_frames *w, const pci_skin_problem *problem);

// Evaluates the blocks begin, begin + stride, ... below `end` for weights of #V by slots.
// `of_patches` (#patches, in the kernel's unit) may be NULL. False: cancelled.
bool pci_skin_frames_evaluate(pci_skin_frames *w, const double *weights, size_t begin, size_t end,
                              size_t stride, bool gradient, pci_skin_measures *of_patches);

// The row of dE/dW of one vertex, of the blocks evaluated last.
void pci_skin_frames_row(const pci_skin_frames *w, size_t vertex, double *row);

// Where the patch that owns a vertex keeps its row; those of the other vertices of the patch follow
// in the order of the problem. Of kernels in float.
float *pci_skin_frames_own_row(const pci_skin_frames *w, size_t place);

// Adds up what the patches tell.
void pci_skin_frames_add(const pci_skin_frames *w, const pci_skin_measures *of_patches,
                         pci_skin_measures *measures);

// Elements of arrays of the kernel's real type.
void *pci_skin_reals(pci_scratch *scratch, const pci_skin_kernel *kernel, size_t count);
void pci_skin_put(const pci_skin_kernel *kernel, void *array, size_t index, double value);
double pci_skin_get(const pci_skin_kernel *kernel, const void *array, size_t index);

#endif
