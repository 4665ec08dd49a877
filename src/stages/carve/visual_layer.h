// The visual mesh as its own single layer, where it is one already.
#ifndef PCI_VISUAL_LAYER_H
#define PCI_VISUAL_LAYER_H

#include "geometry/bvh.h"
#include "geometry/topology.h"

typedef enum pci_layering {
    PCI_LAYERED, // linings, doubled sheets, parts on top of each other, closed parts
    PCI_FOLDED,  // one sheet that lies close to itself here and there
    PCI_PLAIN    // one sheet, nowhere close to itself
} pci_layering;

// The cloth of a visual mesh: repaired to a manifold, thick shells peeled (stages/carve/shells.h),
// without parts that lie within a voxel of larger ones (stages/carve/hidden.h). `thickness` is that
// of the thickest shell, `edges` of the cloth, from scratch. PC_OK; PC_ERROR_OUT_OF_MEMORY;
// PC_ERROR_DEPENDENCY; PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pci_visual_cloth(pci_scratch *scratch, const char *stage,
                                        const pc_mesh *surface, double cell_size, pc_mesh *cloth,
                                        pci_topology *edges, double *thickness);

// Fills holes of the cloth smaller than a voxel and finds out whether it is a single layer; `layer`
// stays empty when it is layered, and belongs to the caller otherwise. With `always` it is not
// asked. PC_OK; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY; PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pci_visual_layer(pci_scratch *scratch, const char *stage,
                                        const pc_mesh *surface, const pc_mesh *cloth,
                                        const pci_topology *edges, double thickness,
                                        double cell_size, bool always, pc_mesh *layer,
                                        pci_layering *layering, uint64_t *filled_loops);

// The cloth made one sheet: parts that are worn over each other are sewn together
// (stages/carve/sewing.h), hems and collars that are turned over are cut off
// (stages/carve/lining.h), fronts are closed (geometry/notches.h). `side` tells what is outside.
// `layer` stays empty where nothing is sewn, or the result is layered or not near 99 % of the
// visual mesh. PC_OK; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY; PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pci_tailored_layer(pci_scratch *scratch, const char *stage,
                                          const pc_mesh *surface, const pc_mesh *cloth,
                                          const pci_topology *edges, const pc_mesh *side,
                                          double thickness, double cell_size, pc_mesh *layer,
                                          uint64_t *filled_loops);

// Turns the components of `layer` over that face the other way than `reference`, by the area of
// some of their triangles; or that face the same way, with `against`.
// PC_OK; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY.
PC_NODISCARD pc_status pci_face_like(pci_scratch *scratch, const char *stage,
                                     const pc_mesh *reference, bool against, pc_mesh *layer);

// Of several parts the one that reaches farthest of those that have a border, if others are put
// onto it, as pouches on a belt or a collar on a coat: at least half of each is within three voxels
// of it. `covers` tells whether all of `surface` is. `layer` stays empty where there is no such
// part, or it is not plain. PC_OK; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY; PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pci_bare_layer(pci_scratch *scratch, const char *stage,
                                      const pc_mesh *surface, const pc_mesh *cloth,
                                      const pci_topology *edges, double cell_size, pc_mesh *layer,
                                      uint64_t *filled_loops, bool *covers);

#endif
