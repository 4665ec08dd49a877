// Centroidal Voronoi clustering of mesh vertices (Valette and Chassery, Approximated centroidal
// Voronoi diagrams for uniform polygonal mesh coarsening, 2004).
#ifndef PCI_CLUSTERING_H
#define PCI_CLUSTERING_H

#include "geometry/halfedge.h"

// Edge length of even triangles around so many clusters of an area.
static inline double pci_even_spacing(double area, size_t clusters) {
    return sqrt(2.0 / sqrt(3.0) * area / (double)clusters);
}

// Partitions the vertices that are not given clusters already into `cluster_count` connected
// clusters, none empty, that minimise sum_i w_i |x_i - centroid of its cluster|^2 over exchanges
// along edges.
// @param fans        of the mesh
// @param weights     #V, positive
// @param scales      #V, lengths count that many times for the seeds; uniform: 1
// @param fixed       #V, vertices with other values than PC_INVALID_INDEX belong to cluster
//                    cluster_count + fixed[v] and stay there; below fixed_count. NULL: none
// @param anchors     vertices, not fixed ones, no two of which share a cluster; at most half as
//                    many as clusters
// @param first       vertex of the first seed
// @param cluster     #V, receives values below cluster_count + fixed_count
// @param iterations  receives the passes done
// Every component of the mesh gets a cluster if there are at least as many clusters as components.
// False: out of memory or cancelled.
bool pci_cluster_vertices(pc_context *context, const pci_halfedge *mesh, const pci_fans *fans,
                          const double *weights, const double *scales, size_t cluster_count,
                          const uint32_t *fixed, size_t fixed_count, const uint32_t *anchors,
                          size_t anchor_count, uint32_t first, uint32_t passes, uint32_t *cluster,
                          uint64_t *iterations);

#endif
