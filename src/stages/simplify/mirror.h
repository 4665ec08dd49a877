// Garments that are the same on both sides of a plane: their proxies are made of one half and its
// mirror image.
#ifndef PCI_MIRROR_H
#define PCI_MIRROR_H

#include "geometry/halfedge.h"

// The plane where one coordinate is the offset. What is meant to lie on it does so exactly.
typedef struct pci_mirror {
    size_t axis;
    double offset;
} pci_mirror;

// NULL: there is no plane.
static inline bool pci_on_mirror(const pci_mirror *mirror, const double *point) {
    return mirror != NULL && point[mirror->axis] == mirror->offset;
}
// Whether a border vertex is on the plane: the border there is the seam of the two halves.
static inline bool pci_is_seam_vertex(const pci_mirror *mirror, const pci_halfedge *mesh,
                                      uint32_t v) {
    return pci_on_mirror(mirror, &mesh->positions[3 * (size_t)v]) && pci_is_border_vertex(mesh, v);
}
// Whether the garment ends at a vertex; the seam goes on in the mirror image.
static inline bool pci_is_hem_vertex(const pci_mirror *mirror, const pci_halfedge *mesh,
                                     uint32_t v) {
    return pci_is_border_vertex(mesh, v) && !pci_on_mirror(mirror, &mesh->positions[3 * (size_t)v]);
}
// Whether a half-edge is part of the seam.
static inline bool pci_is_seam_edge(const pci_mirror *mirror, const pci_halfedge *mesh,
                                    uint32_t h) {
    return mirror != NULL && mesh->twins[h] == PC_INVALID_INDEX &&
           pci_is_seam_vertex(mirror, mesh, pci_origin(mesh, h)) &&
           pci_is_seam_vertex(mirror, mesh, pci_target(mesh, h));
}

// Searches a plane across an axis whose reflection leaves every vertex of a manifold and of its
// border near the mesh and its border, and cuts the mesh along it.
// @param spacing  edge length of the proxy
// @param half     what is on one side of the plane, a manifold that the caller frees; empty:
//                 there is no such plane
// PC_OK; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY; PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pci_halve(pc_context *context, const char *stage, const pc_mesh *mesh,
                                 double spacing, pci_mirror *mirror, pc_mesh *half);

// Joins a half to its mirror image along the seam. `whole` belongs to the caller. False: out of
// memory.
bool pci_unfold(pci_scratch *scratch, const pci_mirror *mirror, const pc_mesh *half,
                pc_mesh *whole);

#endif
