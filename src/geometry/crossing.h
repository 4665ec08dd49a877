// Self-intersections of a triangle mesh.
#ifndef PCI_CROSSING_H
#define PCI_CROSSING_H

#include "core/core.h"
#include "proxycloth/mesh.h"

// The length of the piece that two triangles share of the line between their planes, where they
// cross: each has corners strictly on both sides of the other's plane; otherwise 0. Lengths below
// 1e-12 of the pair's extent count as zero, so touching, coplanar overlap and degenerate triangles
// are no crossing. A crossing goes on beyond a vertex that they share; 0 when they share two or
// three.
double pci_pair_crossing_length(const pc_mesh *mesh, uint32_t first, uint32_t second);
// Whether they cross.
bool pci_pair_crosses(const pc_mesh *mesh, uint32_t first, uint32_t second);

// Pairs of triangles that cross, in an order that does not depend on the number of threads; pairs
// that share two or three vertices are not looked at. `pairs` (2 by count, from scratch) may be
// NULL. False: out of memory.
bool pci_list_self_intersections(pci_scratch *scratch, const pc_mesh *mesh, uint32_t **pairs,
                                 size_t *count);
// Their number.
PC_NODISCARD pc_status pci_count_self_intersections(pc_context *context, const char *stage,
                                                    const pc_mesh *mesh, uint64_t *count);

#endif
