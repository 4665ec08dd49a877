// The surface that the weights are found on: vertices that are joined by an edge of hardly any
// length move as one, and neighbours stand close together in memory. For skin*.c.
#ifndef PCI_SKIN_JOIN_H
#define PCI_SKIN_JOIN_H

#include "core/core.h"
#include "proxycloth/mesh.h"

// The first vertex, in order, that no other has taken takes all that edges shorter than a share of
// the mean edge length lead to, no farther from it than that length; they become one vertex, where
// the first was. Triangles stay, some with a repeated vertex.
// @param[out] joined  the smaller mesh, whose arrays may be those of `surface`.
// @param[out] rows    #V: vertex of `joined`; NULL where nothing was joined.
// False: out of memory.
bool pci_skin_join(pci_scratch *scratch, const pc_mesh *surface, pc_mesh *joined,
                   const uint32_t **rows);

// Joins, and numbers what is left along a curve through space.
// @param[out] sorted  the mesh, with arrays of its own.
// @param[out] rows    #V: vertex of `sorted`.
// @param[out] ranks   #vertices of `sorted`: they are as small as the vertices of `surface` were.
// False: out of memory.
bool pci_skin_sort(pci_scratch *scratch, const pc_mesh *surface, pc_mesh *sorted,
                   const uint32_t **rows, const uint32_t **ranks);

#endif
