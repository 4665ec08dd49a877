// The conformal map of a tube, an annulus of triangles, to a cylinder. For rings.c.
#ifndef PCI_TUBE_MAP_H
#define PCI_TUBE_MAP_H

#include "geometry/halfedge.h"

typedef struct pci_tube {
    const pci_halfedge *mesh;
    uint32_t *near; // triangles, those of the tube among them
    size_t near_count;
    uint8_t *inside;   // #F, whether it belongs to the tube; zero beyond `near`
    uint32_t *members; // the tube's vertices
    size_t member_count;
    uint32_t *local;        // #V, index among the members
    double *along, *around; // per member: 0 at the opening, 1 at the other end; radians
    double flux;            // circumference over length of the cylinder of the same shape
    uint32_t *queue;        // #F, work space
    double *angles;         // #F, work space
} pci_tube;

// Half-edge i of 3 * near_count.
static inline uint32_t pci_near_halfedge(const pci_tube *tube, size_t i) {
    return 3 * tube->near[i / 3] + (uint32_t)(i % 3);
}

// Whether nothing of the tube is beyond one of its half-edges.
static inline bool pci_is_tube_rim(const pci_tube *tube, uint32_t h) {
    const uint32_t twin = tube->mesh->twins[h];
    return twin == PC_INVALID_INDEX || !tube->inside[twin / 3];
}

// Fills along, around (from scratch) and flux. `loop_of` (#V): the opening that a vertex lies on;
// that of the tube is `loop`. A flux of 0: there is no such map. False: out of memory or cancelled.
bool pci_map_to_cylinder(pci_scratch *scratch, pci_tube *tube, const uint32_t *loop_of,
                         uint32_t loop);

#endif
