// What moves the visual vertices. For skin*.c.
//
// With weights w vertex i, at rest at x_i, moves by
//   u_i = sum_b w_ib A_b x^_i,  x^_i = (1) or (1, x_i - o),
// where A_b has 3 rows and one column, the displacement of proxy vertex b, or four: the
// displacement that b gives to the origin o, and the columns of R_b - I. So everything that
// translation-only skinning needs of a frame carries over with vectors of `columns` numbers in
// place of one.
#ifndef PCI_SKIN_DRIVER_H
#define PCI_SKIN_DRIVER_H

#include "stages/skin/skin_internal.h"

enum { PCI_SKIN_COLUMNS_MAX = 4 };

// 1 for translation-only skinning, 4 where the proxy's vertices turn.
static inline uint32_t pci_skin_columns(const pci_skin_problem *problem) {
    return problem->rotations == NULL ? 1 : PCI_SKIN_COLUMNS_MAX;
}

// o: the middle of the proxy's bounding box, so that float keeps most digits. Returns the box's
// diagonal.
double pci_skin_extent(const pci_skin_problem *problem, double origin[3]);

// x^ of a vertex in a unit of length; `columns` numbers.
void pci_skin_point(const pci_skin_problem *problem, const double origin[3], double unit,
                    size_t vertex, double *point);

// Adds to a displacement what the turn of the bone makes of it, and the columns of R - I.
void pci_skin_turn_map(const pci_skin_problem *problem, const double origin[3], size_t frame,
                       size_t bone, double *map);

// A of a bone in a frame, column by column; 3 by `columns`.
static inline void pci_skin_bone_map(const pci_skin_problem *problem, const double origin[3],
                                     size_t frame, size_t bone, double *map) {
    const double *position = &problem->frames[3 * (frame * problem->proxy_count + bone)];
    __builtin_prefetch(position + 48); // callers go from bone to bone
    pci_sub(position, &problem->proxy_rest[3 * bone], map);
    if (problem->rotations != NULL) {
        pci_skin_turn_map(problem, origin, frame, bone, map);
    }
}

// x^T G[b, c] y of a Gram matrix of all bones, #P columns by #P columns.
static inline double pci_skin_gram_product(const double *gram, size_t proxy_count, size_t columns,
                                           size_t b, size_t c, const double *x, const double *y) {
    double sum = 0.0;
    for (size_t k = 0; k < columns; ++k) {
        const double *row = &gram[(b * columns + k) * (proxy_count * columns) + c * columns];
        double product = row[0] * y[0];
        for (size_t l = 1; l < columns; ++l) {
            product += row[l] * y[l];
        }
        sum = k == 0 ? x[0] * product : sum + x[k] * product;
    }
    return sum;
}

#endif
