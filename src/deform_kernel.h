// Innermost loops of pc_deform; one implementation per instruction set, all with the same result.
#ifndef PCI_DEFORM_KERNEL_H
#define PCI_DEFORM_KERNEL_H

#include <stddef.h>
#include <stdint.h>

enum {
    PCI_DEFORM_BLOCK = 16,     // vertices whose numbers lie together
    PCI_DEFORM_SET = 4,        // influences that lie together, as in JOINTS_n and WEIGHTS_n
    PCI_DEFORM_REST = 192,     // bytes of a block's positions or normals, 16 by 3 floats
    PCI_DEFORM_WEIGHTS = 256,  // bytes of a block's weights in a set, 16 by 4 floats
    PCI_DEFORM_SET_BYTES = 384 // and 16 by 4 joints of 16 bits
};

// One stream that is read from its beginning to its end: for each block of 16 vertices the
// positions, then for each set the weights and the joints. Aligned to 64 bytes, and full blocks.
typedef struct pci_deform_rows {
    const char *blocks;
    size_t set_count;
    const char *normals; // #blocks by 192 bytes; may be NULL
} pci_deform_rows;

// Bytes from one block to the next.
static inline size_t pci_deform_block_bytes(const pci_deform_rows *rows) {
    return PCI_DEFORM_REST + rows->set_count * PCI_DEFORM_SET_BYTES;
}

typedef struct pci_deform_kernel {
    // out = rest + sum w d; `displacements` #J by 4.
    void (*positions)(const pci_deform_rows *rows, const float *displacements, size_t begin,
                      size_t end, char *output, size_t stride);
    // out = sum w (R rest + t); `maps` #J by 4 columns by 4, aligned to 64 bytes, the last is t.
    void (*affine)(const pci_deform_rows *rows, const float *maps, size_t begin, size_t end,
                   char *output, size_t stride);
    // out = unit(sum w R rest); `rotations` likewise, the last column does not matter.
    void (*normals)(const pci_deform_rows *rows, const float *rotations, size_t begin, size_t end,
                    char *output, size_t stride);
} pci_deform_kernel;

extern const pci_deform_kernel pci_deform_generic;
#if defined(__x86_64__)
extern const pci_deform_kernel pci_deform_avx2, pci_deform_avx512;
#endif

// The whole blocks of a range of vertices; what is before and behind them goes to the plain kernel.
typedef struct pci_deform_span {
    size_t first, last; // blocks
    size_t head, tail;  // vertices: begin..head and tail..end are left over
} pci_deform_span;

static inline pci_deform_span pci_deform_whole_blocks(size_t begin, size_t end) {
    const size_t first = (begin + PCI_DEFORM_BLOCK - 1) / PCI_DEFORM_BLOCK;
    const size_t last = end / PCI_DEFORM_BLOCK;
    if (first >= last) {
        return (pci_deform_span){0, 0, end, end};
    }
    return (pci_deform_span){first, last, PCI_DEFORM_BLOCK * first, PCI_DEFORM_BLOCK * last};
}

#endif
