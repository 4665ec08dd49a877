// The artist's density map: a vertex color channel of the visual mesh that says where the proxy
// needs shorter edges.
#ifndef PCI_DENSITY_H
#define PCI_DENSITY_H

#include "geometry/bvh.h"
#include "geometry/halfedge.h"

typedef struct pci_density {
    pc_context *context;
    const pc_visual *visual;
    pci_bvh *bvh;
    size_t channel; // of visual->colors
    double range;   // how many times shorter edges are where the channel is 1 than where it is 0
} pci_density;

// The visual mesh must have colors and outlive the map.
PC_NODISCARD pc_status pci_density_begin(pc_context *context, const char *stage,
                                         const pc_visual *visual, size_t channel, double range,
                                         pci_density *density);
void pci_density_end(pci_density *density); // a zeroed one is accepted

// How many times shorter edges should be, range^value at the nearest point of the visual mesh: 1 to
// range. False: cancelled.
bool pci_density_sample(const pci_density *density, size_t count, const double *points,
                        double *scales);

// Raises scales so that wanted edge lengths (spacing over scale) grow by no more than a fixed part
// of the way between two vertices: neighbouring triangles can differ little in size.
// False: out of memory.
bool pci_limit_gradation(pci_scratch *scratch, const pci_halfedge *mesh, double spacing,
                         double *scales);

#endif
