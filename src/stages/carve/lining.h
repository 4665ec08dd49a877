// Second plies that hang together with the cloth: hems that are turned in, collars, hats and
// waistbands with a lining.
#ifndef PCI_LINING_H
#define PCI_LINING_H

#include "core/core.h"
#include "proxycloth/mesh.h"

// Cuts off what lies back to back or front to front with the rest of its component within `reach`,
// along the fold between them; the larger side stays. The mesh is manifold and stays so. `peeled`
// tells whether it changed. Where a cut would give other components, boundary loops or Euler
// numbers, or run through flat cloth, two sides of the garment lie there (a flat sleeve), and stay.
// Nothing goes where less than `least_share` of the area lies so. `seen`: what each triangle sees
// behind and before it within `reach` (#F by 2; PC_INVALID_INDEX: nothing that shows the side that
// a ply would show), or NULL.
// PC_OK; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY; PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pci_peel_linings(pci_scratch *scratch, const char *stage,
                                        const uint32_t *seen, double reach, double least_share,
                                        pc_mesh *mesh, bool *peeled);

#endif
