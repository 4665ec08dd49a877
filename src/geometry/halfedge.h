// A manifold triangle mesh with boundary under edge splits, collapses and flips.
//
// Half-edge h = 3 t + c runs from corner c to corner c + 1 of triangle t. `twins[h]` is the
// opposite half-edge or PC_INVALID_INDEX on the border. `outgoing[v]` is a half-edge that starts at
// v; at a border vertex it is the one on the border, so turning from it visits the whole fan.
// Removed vertices and triangles keep their index and hold PC_INVALID_INDEX.
//
// Every operation keeps the mesh a manifold of the same topological type. Memory is scratch.
#ifndef PCI_HALFEDGE_H
#define PCI_HALFEDGE_H

#include "core/core.h"
#include "proxycloth/mesh.h"

typedef struct pci_halfedge {
    pci_scratch *scratch;
    size_t vertex_count;   // with removed ones
    size_t live_vertices;  // without
    size_t triangle_count; // with removed ones
    size_t vertex_capacity, outgoing_capacity, mark_capacity, corner_capacity, twin_capacity;
    double *positions;
    uint32_t *corners;
    uint32_t *twins;
    uint32_t *outgoing;
    uint32_t *marks; // #V, scratch of the link test
    uint32_t mark;
} pci_halfedge;

// The mesh must be manifold and consistently oriented (pci_mesh_repair). False: out of memory.
bool pci_halfedge_build(pci_scratch *scratch, const pc_mesh *mesh, pci_halfedge *result);
bool pci_halfedge_copy(pci_scratch *scratch, const pci_halfedge *from, pci_halfedge *result);
// The live part as a mesh that the caller frees; `kept` (may be NULL) receives the old indices.
bool pci_halfedge_export(const pci_halfedge *mesh, pc_mesh *result, uint32_t **kept);

// All of it as a mesh that shares its arrays, removed triangles with it.
static inline pc_mesh pci_halfedge_view(const pci_halfedge *mesh) {
    return (pc_mesh){mesh->vertex_count, mesh->positions, mesh->triangle_count, mesh->corners};
}

static inline uint32_t pci_next(uint32_t h) { return h % 3 == 2 ? h - 2 : h + 1; }
static inline uint32_t pci_previous(uint32_t h) { return h % 3 == 0 ? h + 2 : h - 1; }
static inline uint32_t pci_origin(const pci_halfedge *mesh, uint32_t h) { return mesh->corners[h]; }
static inline uint32_t pci_target(const pci_halfedge *mesh, uint32_t h) {
    return mesh->corners[pci_next(h)];
}
static inline double pci_edge_length(const pci_halfedge *mesh, uint32_t h) {
    return sqrt(pci_squared_distance(&mesh->positions[3 * (size_t)pci_origin(mesh, h)],
                                     &mesh->positions[3 * (size_t)pci_target(mesh, h)]));
}
static inline bool pci_is_border_vertex(const pci_halfedge *mesh, uint32_t v) {
    return mesh->twins[mesh->outgoing[v]] == PC_INVALID_INDEX;
}
// Next outgoing half-edge of the same vertex, counter-clockwise; PC_INVALID_INDEX after the last.
static inline uint32_t pci_turn(const pci_halfedge *mesh, uint32_t h) {
    const uint32_t turned = mesh->twins[pci_previous(h)];
    return turned == mesh->outgoing[mesh->corners[h]] ? PC_INVALID_INDEX : turned;
}
#define PCI_FOR_OUTGOING(mesh, v, h)                                                               \
    for (uint32_t h = (mesh)->outgoing[v]; h != PC_INVALID_INDEX; h = pci_turn((mesh), h))

// The neighbours of all vertices, each in the order of its fan: on the border the first and the
// last one are those along it.
typedef struct pci_fans {
    size_t *offsets; // #V + 1
    uint32_t *ends;
    double *lengths; // of the edges to the ends
} pci_fans;
// False: out of memory.
bool pci_fans_build(pci_scratch *scratch, const pci_halfedge *mesh, pci_fans *fans);

// The half-edge that enters v along the border; v must be a border vertex.
uint32_t pci_border_incoming(const pci_halfedge *mesh, uint32_t v);
// Whether each undirected edge is represented by h (the border one or the smaller of two).
static inline bool pci_is_edge(const pci_halfedge *mesh, uint32_t h) {
    return mesh->corners[h] != PC_INVALID_INDEX && h < mesh->twins[h];
}

// Makes room for elements that pci_split_edge adds. False: out of memory.
bool pci_halfedge_reserve(pci_halfedge *mesh, size_t vertices, size_t triangles);
// Inserts a vertex at `position` on the edge and returns it; PC_INVALID_INDEX: out of memory.
uint32_t pci_split_edge(pci_halfedge *mesh, uint32_t h, const double position[3]);

// Link condition: the collapse leaves a manifold of the same topological type.
bool pci_can_collapse(pci_halfedge *mesh, uint32_t h);
// Merges the origin of h into its target. Requires pci_can_collapse.
void pci_collapse(pci_halfedge *mesh, uint32_t h);

// Inner edge whose opposite corners are not joined yet.
bool pci_can_flip(const pci_halfedge *mesh, uint32_t h);
void pci_flip(pci_halfedge *mesh, uint32_t h);

#endif
