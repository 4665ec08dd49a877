// Centroidal Voronoi clustering of mesh vertices (Valette and Chassery, Approximated centroidal
// Voronoi diagrams for uniform polygonal mesh coarsening, 2004).
#ifndef PCI_CLUSTERING_H
#define PCI_CLUSTERING_H

#include "stages/simplify/rings.h"

// Edge length of even triangles around so many clusters of an area.
static inline double pci_even_spacing(double area, size_t clusters) {
    return sqrt(2.0 / sqrt(3.0) * area / (double)clusters);
}

// What the clusters are: those of the rings, those around corners of the border, and others.
typedef struct pci_clustering {
    pci_rings rings;   // their clusters stay as they are, and have the last numbers; count 0: none
    uint32_t *anchors; // vertices, not in rings, no two of which share a cluster; at most half as
                       // many as there are clusters but for the rings
    size_t anchor_count;
    uint32_t *cluster; // #V
} pci_clustering;

// Partitions the vertices that are not in rings into connected clusters, none empty, that minimise
// sum_i w_i |x_i - centroid of its cluster|^2 over exchanges along edges.
// @param sampling    its `mesh`, `fans`, `weights`, which are positive, and `scales`: lengths count
//                    so many times for the seeds
// @param count       clusters, with the rings
// @param first       vertex of the first seed
// @param wanted      its `cluster` receives values below `count`
// @param iterations  receives the passes done
// Every component of the mesh gets a cluster if there are at least as many clusters as components.
// False: out of memory or cancelled.
bool pci_cluster_vertices(pc_context *context, const pci_sampling *sampling, size_t count,
                          uint32_t first, uint32_t passes, const pci_clustering *wanted,
                          uint64_t *iterations);

#endif
