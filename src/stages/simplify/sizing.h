// Where a surface needs smaller clusters: around sleeves and straps that are narrow for uniform
// ones.
#ifndef PCI_SIZING_H
#define PCI_SIZING_H

#include "geometry/halfedge.h"

// How many times shorter than elsewhere the edges of the proxy should be, per vertex, 1..limit.
// Judged from a uniform clustering: by the spread of the normals inside a cluster, which measures
// its width against the radius of curvature, and by the length of border it holds, which measures
// the width of a strap.
// @param normals, areas, arcs  per vertex: unit normal, share of the surface and of the border
// @param spacing               edge length of uniform clusters
// @param scales                #V, receives the result
// False: out of memory.
bool pci_size_clusters(pci_scratch *scratch, const pci_halfedge *mesh, const double *normals,
                       const double *areas, const double *arcs, const uint32_t *cluster,
                       size_t cluster_count, double spacing, double limit, double *scales);

#endif
