// A layer refined along the line where the visual mesh is just so far beside it.
#ifndef PCI_ISOLINE_H
#define PCI_ISOLINE_H

#include "geometry/bvh.h"
#include "geometry/halfedge.h"
#include "geometry/knn.h"

typedef struct pci_isoline {
    const pci_bvh *visual;
    const pci_knn *focus; // distances are measured within `reach` of these points; NULL: everywhere
    double reach;
    // Whether the distances of points within the threshold of the visual mesh do not matter, which
    // is so while edges are longer than two thresholds: most of them are never measured. The focus
    // is half as wide for them.
    bool coarse;
    pci_halfedge mesh;
    double *normals; // #V by 3
    double threshold;
    double *distances; // #V, beside the visual mesh, along the surface
    uint32_t *nearest; // #V, triangle of the visual mesh, or PC_INVALID_INDEX
    uint32_t *ends;    // #V by 2, of the edge that was split; of new vertices only
    size_t normal_capacity, distance_capacity, nearest_capacity, end_capacity;
} pci_isoline;

// Refines a copy of the layer where the distance may pass through `threshold`, to edges no longer
// than `shortest`, and splits the edges that cross the isoline on it. `visual`, `focus`,
// `reach` and `coarse` are set already. False: out of memory, or cancelled.
bool pci_isoline_refine(pci_scratch *scratch, const pc_mesh *layer, double threshold,
                        double shortest, pci_isoline *line);

// Takes back the splits that made the vertices from `first` on wherever all triangles around are
// kept (`keep`, #F). Triangles that are gone have the corners PC_INVALID_INDEX.
void pci_isoline_undo(pci_isoline *line, size_t first, const uint8_t *keep);

#endif
