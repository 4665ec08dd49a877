// The fine mesh whose vertices are clustered: the single layer, refined until every cluster gets
// enough of them, with what belongs to its vertices.
#ifndef PCI_SAMPLING_H
#define PCI_SAMPLING_H

#include "stages/simplify/density.h"
#include "stages/simplify/mirror.h"

typedef struct pci_sampling {
    pci_halfedge mesh;
    pci_fans fans;     // of its vertices
    double *normals;   // #V by 3, unit
    double *areas;     // #V, shares of the surface
    double *arcs;      // #V, shares of the border but for the seam
    double *densities; // #V, how many times shorter edges should be by the density map; NULL: none
    double *scales;    // #V, how many times shorter edges should be in all; starts with 1
    double *weights;   // #V, areas times density; on narrow layers those at the border count more
    double total;      // area
    double spacing;    // edge length of uniform clusters
    uint32_t *corners; // vertices at corners of the border, sharpest first
    size_t corner_count;
    bool pleated;             // pleats were flattened, which no half should be: its seam would stay
    const pci_mirror *mirror; // the mesh is half of the garment; NULL: it is all of it
    size_t vertices;          // of the proxy for the area of the mesh
    size_t clusters;          // the same, and what the seam shares with the other half
} pci_sampling;

// Samples for `vertices` vertices of a proxy of a layer that is manifold (pci_mesh_repair).
// @param density  NULL: uniform
// @param mirror   of which the layer is one half; the ends of its seam are the first corners. NULL:
//                 there is none
// False: out of memory or cancelled.
bool pci_sampling_begin(pci_scratch *scratch, const pc_mesh *layer, size_t vertices,
                        const pci_density *density, const pci_mirror *mirror,
                        pci_sampling *sampling);

// Raises the scales to the density map, then sets the weights that belong to the scales.
void pci_sampling_weigh(pci_sampling *sampling);

#endif
