// Clusters become vertices: every cluster is contracted by edge collapses that keep the topology.
#ifndef PCI_CONTRACTION_H
#define PCI_CONTRACTION_H

#include "stages/simplify/mirror.h"

// What has been merged into each vertex of the coarse mesh.
typedef struct pci_contraction {
    pci_scratch *scratch;
    const pci_halfedge *fine;
    pci_halfedge coarse;      // starts as a copy of the fine mesh, same vertex indices
    double spacing;           // expected edge length of the result
    uint32_t *parent;         // union-find: the coarse vertex of a fine one
    double *mass, *arc;       // per coarse vertex, sums of the weights and of the border lengths
    double *center;           // per coarse vertex, 3: sum of positions times weights
    double *curve;            // per coarse vertex, 3: sum of border positions times border lengths
    const pci_mirror *mirror; // NULL: the mesh is not half of one
    uint8_t *seam;            // per coarse vertex, whether something on the seam was merged into it
    size_t seam_vertices;     // that are left
} pci_contraction;

// @param weights  per fine vertex, positive
// @param arcs     per fine vertex, its share of the border, 0 inside
// @param mirror   of which the mesh is one half; NULL: there is none
// False: out of memory.
bool pci_contraction_begin(pci_scratch *scratch, const pci_halfedge *fine, const double *weights,
                           const double *arcs, double spacing, const pci_mirror *mirror,
                           pci_contraction *contraction);

// Vertices of the coarse mesh, and of its mirror image.
static inline size_t pci_contraction_vertices(const pci_contraction *contraction) {
    const size_t live = contraction->coarse.live_vertices;
    return contraction->mirror != NULL ? 2 * live - contraction->seam_vertices : live;
}

// Contracts every cluster as far as the topology allows. A cluster that is a disc and touches the
// border at most once ends as one vertex, and a triangle is left where three clusters meet: the
// dual of the clustering. Other clusters (rings around a sleeve, pieces of a strap) keep the
// vertices that the surface needs there.
void pci_contract_clusters(pci_contraction *contraction, const uint32_t *cluster);

// Merges the vertices whose union costs the least clustering energy until `vertices` are left, with
// the mirror image, or nothing more can collapse. False: out of memory or cancelled.
// @param bound  per fine vertex, whether it is only merged when nothing else can be
bool pci_contract_to(pci_contraction *contraction, size_t vertices, const uint8_t *bound);

// The coarse mesh on its own. Positions: the centroid of what was merged; on the border that of the
// border's part, so that hems do not shrink.
// @param proxy   mesh that the caller frees
// @param feet    #V of the proxy, from scratch: a fine vertex next to each proxy vertex
// @param nearby  #V of the fine mesh, from scratch: the proxy vertex it was merged into
// False: out of memory.
bool pci_contraction_result(pci_contraction *contraction, pc_mesh *proxy, uint32_t **feet,
                            uint32_t **nearby);

#endif
