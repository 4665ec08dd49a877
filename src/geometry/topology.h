// Connectivity of a triangle mesh; arrays live in the scratch memory that was passed in.
#ifndef PCI_TOPOLOGY_H
#define PCI_TOPOLOGY_H

#include "core/core.h"
#include "proxycloth/mesh.h"

typedef struct pci_topology {
    size_t edge_count;
    uint32_t *edges;                 // #E by 2, first < second, ascending
    uint32_t *triangle_edges;        // #F by 3, edge from corner c to c + 1; invalid: no length
    size_t *edge_triangle_offsets;   // #E + 1
    uint32_t *edge_triangles;        // triangles of edge e, ascending
    size_t *vertex_triangle_offsets; // #V + 1
    uint32_t *vertex_triangles;      // triangles of vertex v, ascending
    size_t *ring_offsets;            // #V + 1
    uint32_t *ring;                  // vertices joined to v by an edge, ascending
} pci_topology;

// Triangles with a repeated vertex contribute their proper edges only, each once. Linear in the
// size of the mesh. False: out of memory.
bool pci_topology_build(pci_scratch *scratch, const pc_mesh *mesh, pci_topology *topology);
// For large meshes inside a stage: the same, but asks pci_keep_going. False: out of memory, or
// cancelled; pci_fail_memory tells.
bool pci_topology_build_watched(pci_scratch *scratch, const pc_mesh *mesh, pci_topology *topology);
// The same without what belongs to vertices (`vertex_triangles`, `ring` and their offsets), which
// is more than half of the work.
bool pci_topology_build_edges(pci_scratch *scratch, const pc_mesh *mesh, pci_topology *topology);

// The triangles of edge e, ascending, and their number.
static inline const uint32_t *pci_sides(const pci_topology *topology, size_t e) {
    return &topology->edge_triangles[topology->edge_triangle_offsets[e]];
}
static inline size_t pci_side_count(const pci_topology *topology, size_t e) {
    return topology->edge_triangle_offsets[e + 1] - topology->edge_triangle_offsets[e];
}

// The half-edge (3 t + corner) of triangle t that runs along edge e, one of its three.
static inline uint32_t pci_half_along(const pci_topology *topology, uint32_t t, size_t e) {
    uint32_t half = 3 * t;
    while (topology->triangle_edges[half] != e) {
        ++half;
    }
    return half;
}

// Mean length of the edges; 0 without edges.
double pci_mean_edge_length(const pc_mesh *mesh, const pci_topology *topology);

// Length of all edges of one triangle.
double pci_boundary_length(const pc_mesh *mesh, const pci_topology *topology);

// Labels the connected components (shared edges) of triangles: component per triangle, #F. Returns
// their number. Components are numbered by their first triangle.
size_t pci_triangle_components(pci_scratch *scratch, const pc_mesh *mesh,
                               const pci_topology *topology, uint32_t *component);

// The same of a mesh whose parts share no vertex, as manifolds do not: needs no topology, and is
// quicker. 0: out of memory.
size_t pci_manifold_components(pci_scratch *scratch, const pc_mesh *mesh, uint32_t *component);

// The volume that each component encloses, below zero where its triangles face inwards; of an open
// one, as if each boundary loop were closed by a fan around the component's first vertex. Returns
// scratch memory, #components; NULL: out of memory.
double *pci_component_volumes(pci_scratch *scratch, const pc_mesh *mesh, const uint32_t *component,
                              size_t count);

// Joins triangles across edges of two where both are marked, with any mark, or neither is.
// `parents` (#F, core/union_find.h) receives the sets.
void pci_join_alike(const pci_topology *topology, size_t triangle_count, const uint8_t *marked,
                    uint32_t *parents);

// Marks the vertices on edges of one triangle in `border` (#V, zeroed).
void pci_mark_border(const pci_topology *topology, uint8_t *border);

// Marks the components, as pci_triangle_components numbers them, with an edge of one triangle in
// `open` (zeroed).
void pci_mark_open(const pci_topology *topology, const uint32_t *component, uint8_t *open);

// Joins the vertices of each triangle in `parents` (#V, core/union_find.h). Returns the number of
// sets; a vertex without triangles is one of its own.
size_t pci_vertex_components(const pc_mesh *mesh, uint32_t *parents);

// Boundary loops: chains of edges with one triangle, followed along the triangle fans, as if each
// fan of a vertex had a vertex of its own. Fills `loop_offsets` (#loops + 1) and `loop_vertices`
// with memory from scratch; the loops run in the direction of their triangles. Needs consistent
// orientation and manifold edges; edges with more than two triangles and triangles with a repeated
// vertex are skipped.
bool pci_boundary_loops(pci_scratch *scratch, const pc_mesh *mesh, const pci_topology *topology,
                        size_t *loop_count, size_t **loop_offsets, uint32_t **loop_vertices);

// The topology of a surface.
typedef struct pci_shape {
    size_t components, boundary_loops;
    size_t euler; // vertices + triangles - edges, wraps below zero
} pci_shape;

// Needs what pci_boundary_loops needs. False: out of memory.
bool pci_find_shape(pci_scratch *scratch, const pc_mesh *mesh, pci_shape *shape);
// Whether their numbers of components and loops and their Euler numbers are the same.
bool pci_same_topology(const pci_shape *a, const pci_shape *b);

size_t pci_nonmanifold_edge_count(const pci_topology *topology);

// Copies a mesh, keeping only marked triangles (NULL: all) and the vertices they use, in order.
// `kept_vertices` (may be NULL) receives the old index of each new vertex, from scratch. The result
// belongs to the caller (pc_mesh_free).
bool pci_mesh_compact(pci_scratch *scratch, const pc_mesh *mesh, const uint8_t *keep,
                      pc_mesh *result, uint32_t **kept_vertices);

// Area-weighted vertex normals, #V by 3, unit (or zero where undefined).
void pci_vertex_normals(const pc_mesh *mesh, double *normals);

// Coordinates beyond are refused: products of eight of them are still finite. Visual meshes may
// have 1e30, and the grid around them reaches farther.
#define PCI_FARTHEST 1e33

// Whether a mesh has vertices and triangles, finite positions and indices in range; NULL has not.
// `name` is what the message calls it. PC_OK; PC_ERROR_INVALID_ARGUMENT; PC_ERROR_TOO_LARGE.
PC_NODISCARD pc_status pci_check_mesh(pc_context *context, const char *stage, const pc_mesh *mesh,
                                      const char *name);

// The same, and whether the cells that the mesh came from have a size that goes with it: work and
// memory grow with its width in cells, which is N_v and a few more.
#define PCI_WIDEST_CELLS 65536.0
PC_NODISCARD pc_status pci_check_mesh_of_cells(pc_context *context, const char *stage,
                                               const pc_mesh *mesh, const char *name,
                                               double cell_size);

// Twice the triangle's area times its unit normal.
void pci_triangle_vector(const pc_mesh *mesh, size_t triangle, double out[3]);
void pci_triangle_middle(const pc_mesh *mesh, size_t triangle, double out[3]);
double pci_triangle_area(const pc_mesh *mesh, size_t triangle);
void pci_bounding_box(const pc_mesh *mesh, double minimum[3], double maximum[3]);
double pci_diagonal(const pc_mesh *mesh);

// Marks the triangles with the same three vertices as an earlier one in `duplicate` (#F, zeroed).
// False: out of memory.
bool pci_mark_duplicates(pci_scratch *scratch, const pc_mesh *mesh, uint8_t *duplicate);

#endif
