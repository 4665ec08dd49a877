// Flattening pleats that the edges of a proxy cannot follow.
#ifndef PCI_PLEATS_H
#define PCI_PLEATS_H

#include "core/core.h"
#include "proxycloth/mesh.h"

// Where most of a surface stands in pleats narrower than edges of length `spacing` can follow, it
// becomes the sheet amid them; else nothing changes. Pleats are told by their normals, which lean
// away from the mean around them, and by bends to both sides; a sleeve or a shoulder bends to one.
// Twice, with strengths of its own each time, minimises
// |x - x0|^2 + |width^2 Laplacian x|^2 with free borders, `width` half of `spacing` in pleats and 0
// elsewhere. The edges should be roughly even.
// @param mesh     positions change
// @param normals  #V by 3, unit; they follow
// @param some     receives whether there were any
// False: out of memory, or cancelled; pci_fail_memory tells.
bool pci_flatten_pleats(pci_scratch *scratch, double spacing, pc_mesh *mesh, double *normals,
                        bool *some);

#endif
