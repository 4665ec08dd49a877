// Seams between the borders of two sheets.
#ifndef PCI_SEAMS_H
#define PCI_SEAMS_H

#include "core/core.h"
#include "geometry/knn.h"
#include "proxycloth/mesh.h"

// A closed border; arrays live in scratch memory.
typedef struct pci_loop {
    size_t count;
    const uint32_t *vertices; // in the direction of their triangles
    double *points;           // #vertices by 3
    double longest;           // edge
    pci_knn nearest;
} pci_loop;

// False: out of memory.
bool pci_loop_begin(pci_scratch *scratch, const pc_mesh *mesh, size_t count,
                    const uint32_t *vertices, pci_loop *loop);

// Rungs between two loops: around `a` once, and along `steps` edges of `b`, against the direction
// of its triangles.
typedef struct pci_seam {
    const pci_loop *a, *b;
    size_t first_a, first_b, steps;
} pci_seam;

// Finds where two loops run along each other: all the way around both, or around `a` along a part
// of `b` that nearly closes, as the hem of a shirt that is buttoned up. False: they do not, or both
// run the same way around.
bool pci_find_seam(const pci_loop *a, const pci_loop *b, double reach, pci_seam *seam);

// Appends the triangles between the shortest rungs, a->count + b->count + 1 at most, which lie
// between those of the two loops. False: out of memory.
bool pci_close_seam(pci_scratch *scratch, const pci_seam *seam, uint32_t *triangles, size_t *count);

#endif
