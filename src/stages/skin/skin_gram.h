// Which frames the solver looks at, and the Gram matrix of the proxy over them. For skin*.c.
#ifndef PCI_SKIN_GRAM_H
#define PCI_SKIN_GRAM_H

#include "stages/skin/skin_frames.h"
#include "stages/skin/skin_pairs.h"

// Frames that a round looks at: every block, or some as a sample for most of the way.
typedef enum pci_skin_level { PCI_SKIN_ALL, PCI_SKIN_SAMPLE, PCI_SKIN_LEVELS } pci_skin_level;

typedef struct pci_skin_frame_level {
    size_t stride; // of the blocks
    double factor; // all frames over those of the level
} pci_skin_frame_level;

// Of one proxy and its motion, for all problems that they drive. There is room for the matrix of
// one level: few runs change it more than once.
typedef struct pci_skin_gram {
    pci_skin_frames driver; // no more than pci_skin_frames_begin gives, and the blocks
    pci_skin_frame_level levels[PCI_SKIN_LEVELS];
    pci_skin_level level; // whose matrix is there
    double *matrix;       // times the factor, with the noise; see pci_skin_quadratic. Or NULL:
    double *table;        // rows of A of the sample, by bone and column
    const pc_mesh *proxy; // the caller's
    double noise_share;   // variance over the mean square of how far its neighbours move apart
    double noise;         // in the matrix, on the diagonal
    double *rows;         // of some frames, 3 by #P columns each
} pci_skin_gram;

// A matrix of larger sides is not made; problems hold the entries that they need.
enum { PCI_SKIN_DENSE_MOST = 4096 };

// The matrix is that of the sample, where there is one. False: out of memory.
bool pci_skin_gram_build(pci_scratch *scratch, const pci_skin_problem *problem,
                         const pci_skin_kernel *kernel, const pc_mesh *proxy, double noise,
                         size_t dense_most, pci_skin_gram *gram);

// Makes the matrix, or the values of `pairs`, those of a level. `pairs`: NULL where there is a
// matrix.
void pci_skin_gram_use(pci_skin_gram *gram, pci_skin_level level, pci_skin_pairs *pairs);

// x^T G[b, c] y of the sample, of any two bones; `columns` are those of the driver.
double pci_skin_gram_sample(const pci_skin_gram *gram, size_t columns, size_t b, size_t c,
                            const double *x, const double *y);

#endif
