// The paper's comparison of section 5.2: edge decimation of the single layer with skinning weights
// in the loop, instead of clusters first and weights afterwards (figure 16, top).
#ifndef PCI_JOINT_H
#define PCI_JOINT_H

#include "geometry/halfedge.h"

// Poses come from the paper's wind on the mesh itself. Then, until `vertices` are left, weights of
// equation (7) are optimised, and edges collapse to their middles, in every pose, those first that
// raise least the squared distances, summed over the poses, of the moved ends to the planes of the
// proxy and of the visual vertices that follow them to the planes of the posed visual mesh.
//
// DEVIATION: weights are optimised anew each time that half of the vertices are gone, not after
// every collapse; in between quadrics add up as Garland and Heckbert's do. While there are more
// than 2048 vertices they are those of the closest triangle. Planes across borders keep the hems.
//
// The mesh keeps its topology (link condition); positions are those of the rest pose. Collapses
// that turn a triangle over wait until no other is possible.
PC_NODISCARD pc_status pci_joint_decimate(pc_context *context, const char *stage,
                                          const pc_mesh *visual, size_t vertices, uint32_t seed,
                                          pci_halfedge *mesh);

#endif
