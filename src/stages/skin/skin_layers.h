// Loose parts that lie upon each other, as pockets, belts and soles do. For skin*.c.
//
// Where another part is near, a vertex is to move as the closest point p(i) of that part does:
//   L_l = sum_t sum_i s_i |u_i(t) - u_p(i)(t)|^2 = <W, T W> in the metric of G,
// with u_p(i) interpolated between the corners of its triangle. s_i counts the change of the gap by
// the gap itself, as the stiffness of skin_internal.h does for edges, and by the area around the
// vertex where edges are short: buttons and buckles have many vertices on little cloth, which would
// bend them with it.
// At rest, parts may be sunk into each other: where an edge passes through a triangle, the two
// points that meet there are tied likewise, with no gap. Else they would cross elsewhere.
#ifndef PCI_SKIN_LAYERS_H
#define PCI_SKIN_LAYERS_H

#include "geometry/bvh.h"
#include "stages/skin/skin_internal.h"

typedef struct pci_skin_layers {
    double lambda;   // of L_l divided by the norm of L_r and the frame count
    double factor;   // of T where the problem is weighed (skin_alternate.h)
    size_t *offsets; // #V + 1: rows of T, which is symmetric
    uint32_t *columns;
    double *values;
} pci_skin_layers;

// Parts that do not cross count where they lie over the same place of the proxy: what follows
// another place of it may well move away. `closest` (#V): points on the proxy; `typical`: root mean
// square length of the edges. `layers` stays zeroed where no two parts are near.
PC_NODISCARD pc_status pci_skin_find_layers(pci_scratch *scratch, const pc_mesh *surface,
                                            const pc_mesh *proxy, const pci_place *closest,
                                            double typical, double lambda, pci_skin_layers *layers);

#endif
