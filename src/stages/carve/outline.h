// Cuts a layer along the outline of the visual mesh, where the layer leaves it sideways.
#ifndef PCI_OUTLINE_H
#define PCI_OUTLINE_H

#include "geometry/bvh.h"
#include "geometry/rim.h"

typedef enum pci_outline_mode {
    // Only membranes: regions that hang on the rims of the visual mesh, as over a cuff or a
    // neckline narrower than two voxels. What bridges two surfaces stays.
    PCI_OUTLINE_MEMBRANES,
    PCI_OUTLINE_ALL // also what bridges two surfaces (section 5.1)
} pci_outline_mode;

// `rims` are those of the visual mesh. Removes the regions of `layer` farther than `threshold`
// beside the visual mesh, membranes up to half of that; `removed_regions` and `removed_triangles`
// are added to. The layer must be manifold and stays so; it may end without triangles. PC_OK;
// PC_ERROR_OUT_OF_MEMORY; PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pci_cut_outline(pci_scratch *scratch, const char *stage,
                                       const pci_bvh *visual, const pci_rims *rims,
                                       pci_outline_mode mode, double threshold, double cell_size,
                                       pc_mesh *layer, uint64_t *removed_regions,
                                       uint64_t *removed_triangles);

#endif
