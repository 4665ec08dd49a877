// Exact k nearest neighbours among points, by a balanced kd-tree. Ties go to the smaller index, or
// to the smaller rank.
#ifndef PCI_KNN_H
#define PCI_KNN_H

#include "core/core.h"

typedef struct pci_knn {
    size_t point_count;
    const double *points;  // #P by 3, the caller's
    uint32_t *order;       // the middle of each long range is its root, the smaller side is first
    uint8_t *axes;         // splitting axis of the root at this place
    const uint32_t *ranks; // #P, the caller's, or NULL
} pci_knn;

// The points must be finite and stay alive and unchanged. False: out of memory.
bool pci_knn_build(pci_scratch *scratch, size_t point_count, const double *points, pci_knn *knn);

// The `wanted` points nearest to `query` by rising distance, without point `excluded`
// (PC_INVALID_INDEX: none). Both outputs have room for `wanted`. Returns how many there are.
size_t pci_knn_query(const pci_knn *knn, const double query[3], size_t wanted, uint32_t excluded,
                     uint32_t *indices, double *squared_distances);

// Finds the point nearest to `query` within `radius`; far quicker than a query without a limit
// where there is none. `nearest` NULL: any will do. False: no point is so near.
bool pci_knn_within(const pci_knn *knn, const double query[3], double radius, uint32_t *nearest);

// Whether a point is within `radius`; `hint`, a point or PC_INVALID_INDEX, is asked before any
// other, and becomes the one that was found: among neighbours it mostly settles the matter.
bool pci_knn_within_near(const pci_knn *knn, const double query[3], double radius, uint32_t *hint);

#endif
