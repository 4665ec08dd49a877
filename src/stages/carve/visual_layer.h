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

// A visual mesh, what of it is cloth, and what work on it needs.
typedef struct pci_cloth {
    pci_scratch *scratch;
    const char *stage;      // that works on it, for failures
    const pc_mesh *surface; // the visual mesh
    double cell_size;
    pc_mesh mesh;       // what of it is cloth, a manifold
    pci_topology edges; // of that, from scratch
    double thickness;   // of the thickest shell that was peeled; 0: none
} pci_cloth;

// Finds `mesh`, which belongs to the caller, `edges` and `thickness` from the other fields: the
// visual mesh is repaired to a manifold, thick shells are peeled (stages/carve/shells.h), and parts
// that lie within a voxel of larger ones are left out (stages/carve/hidden.h). PC_OK;
// PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY; PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pci_visual_cloth(pci_cloth *cloth);

// Fills holes of the cloth smaller than a voxel and finds out whether it is a single layer; `layer`
// stays empty when it is layered, and belongs to the caller otherwise. With `always` it is not
// asked. PC_OK; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY; PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pci_visual_layer(const pci_cloth *cloth, bool always, pc_mesh *layer,
                                        pci_layering *layering, uint64_t *filled_loops);

// The cloth made one sheet: parts that are worn over each other are sewn together
// (stages/carve/sewing.h), hems and collars that are turned over are cut off
// (stages/carve/lining.h), fronts are closed (geometry/notches.h). `side` tells what is outside.
// `layer` stays empty where nothing is sewn, or the result is layered or not near 99 % of the
// visual mesh. PC_OK; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY; PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pci_tailored_layer(const pci_cloth *cloth, const pc_mesh *side,
                                          pc_mesh *layer, uint64_t *filled_loops);

// Turns the components of `layer` over that face the other way than `reference`, by the area of
// some of their triangles; or that face the same way, with `against`.
// PC_OK; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY.
PC_NODISCARD pc_status pci_face_like(pci_scratch *scratch, const char *stage,
                                     const pc_mesh *reference, bool against, pc_mesh *layer);

// Of several parts the one that reaches farthest of those that have a border, if others are put
// onto it, as pouches on a belt or a collar on a coat: at least half of each is within three voxels
// (and the thickness of shells) of it, and all of those that have several borders, as sleeves have.
// `covers` tells whether all of the visual mesh is within three voxels. `layer` stays empty where
// there is no such part, or it is not plain. PC_OK; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY;
// PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pci_bare_layer(const pci_cloth *cloth, pc_mesh *layer,
                                      uint64_t *filled_loops, bool *covers);

// How far the visual mesh strays from a layer. PC_OK; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY.
PC_NODISCARD pc_status pci_farthest(const pci_cloth *cloth, const pc_mesh *layer, double *distance);

// Of the parts of the cloth that are one sheet each, as the layers of a skirt, the one that the
// visual mesh strays from least, which `distance` receives. `layer` stays empty where it strays
// from all at least as far as `alone`, or `among`, if that is more, from parts that are not alone:
// another one with a border has half of their area; and where `alone` is 0 and the parts have the
// topology `shape` already. PC_OK; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY; PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pci_nearest_sheet(const pci_cloth *cloth, const pci_shape *shape,
                                         double alone, double among, double *distance,
                                         pc_mesh *layer, uint64_t *filled_loops);

#endif
