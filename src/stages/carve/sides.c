#include "stages/carve/sides.h"

#include "core/union_find.h"
#include "geometry/bvh.h"
#include "geometry/topology.h"
#include "solvers/signed_solve.h"

enum { grain = 256 };

// A border between the sides costs as much as a strip along it that is so wide on the wrong side,
// in voxels.
static const double border_width = 0.5;
// Cost of all vertices on the wrong side.
static const double unit = 0x1p40;

typedef struct voting {
    const pc_mesh *projected, *cloth;
    const pci_bvh *bvh;
    const double *normals; // #V by 3
    double *votes;         // #V; on entry areas
} voting;

static void vote(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const voting *v = user;
    uint32_t near = PC_INVALID_INDEX;
    for (size_t i = begin; i < end; ++i) {
        double facing[3];
        near = pci_bvh_closest_near(v->bvh, &v->projected->positions[3 * i], near).triangle;
        pci_triangle_vector(v->cloth, near, facing);
        v->votes[i] *= pci_normalize(facing) ? pci_dot(facing, &v->normals[3 * i]) : 0.0;
    }
}

// Asks all vertices, weighted by a third of the area around each. `sum` receives the whole area.
static pc_status ask(pci_scratch *scratch, const char *stage, const pc_mesh *projected,
                     const pc_mesh *cloth, double *votes, double *sum) {
    pci_bvh *bvh = NULL;
    double *normals = PCI_SCRATCH(scratch, double, 3 * projected->vertex_count);
    if (normals == NULL) {
        return pci_fail_memory(scratch->context, stage);
    }
    pci_vertex_normals(projected, normals);
    *sum = 0.0;
    for (size_t i = 0; i < 3 * projected->triangle_count; ++i) {
        const double area = pci_triangle_area(projected, i / 3) / 3.0;
        votes[projected->triangles[i]] += area;
        *sum += area;
    }
    const pc_status status = pci_bvh_create(scratch->context, stage, cloth, &bvh);
    if (status != PC_OK) {
        return status;
    }
    voting v = {projected, cloth, bvh, normals, votes};
    const bool done =
        pci_parallel_while_wanted(scratch->context, projected->vertex_count, grain, vote, &v);
    pci_bvh_destroy(scratch->context, bvh);
    return done ? PC_OK : pci_fail_memory(scratch->context, stage);
}

// Marks the vertices of the component that encloses most. False: out of memory.
static bool find_largest(pci_scratch *scratch, const pc_mesh *projected, uint8_t *marks) {
    uint32_t *component = PCI_SCRATCH(scratch, uint32_t, projected->triangle_count);
    if (component == NULL) {
        return false;
    }
    const size_t count = pci_manifold_components(scratch, projected, component);
    const double *volumes = pci_component_volumes(scratch, projected, component, count);
    size_t largest = 0;
    for (size_t i = 1; volumes != NULL && i < count; ++i) {
        largest = volumes[i] > volumes[largest] ? i : largest;
    }
    for (size_t i = 0; i < 3 * projected->triangle_count; ++i) {
        marks[projected->triangles[i]] = component[i / 3] == largest;
    }
    return volumes != NULL;
}

// Of each label only the largest piece of the largest component keeps it, by its number of
// vertices; the other components, as cavities, get 0. False: out of memory.
static bool join_sides(pci_scratch *scratch, const pc_mesh *projected, const pci_topology *topology,
                       uint8_t *labels) {
    const size_t count = projected->vertex_count;
    uint8_t *marks = PCI_SCRATCH(scratch, uint8_t, count);
    uint32_t *piece = PCI_SCRATCH(scratch, uint32_t, count), largest[2] = {0, 0};
    size_t *sizes = PCI_SCRATCH(scratch, size_t, count), most[2] = {0, 0};
    if (scratch->failed || !find_largest(scratch, projected, marks)) {
        return false;
    }
    pci_singletons(piece, count);
    for (size_t e = 0; e < topology->edge_count; ++e) {
        const uint32_t a = topology->edges[2 * e], b = topology->edges[2 * e + 1];
        if (labels[a] == labels[b]) {
            pci_unite(piece, a, b);
        }
    }
    for (uint32_t v = 0; v < count; ++v) {
        piece[v] = pci_find_root(piece, v);
        if (marks[v] && ++sizes[piece[v]] > most[labels[v]]) {
            most[labels[v]] = sizes[piece[v]];
            largest[labels[v]] = piece[v];
        }
    }
    for (size_t v = 0; v < count; ++v) {
        labels[v] = marks[v] && (piece[v] == largest[labels[v]]) == (labels[v] != 0);
    }
    return true;
}

// Wishes of vertices and of edges. `votes` are reversed where most labels are.
static void make_graph(const pc_mesh *projected, const pci_topology *topology, const double *votes,
                       double area, double cell_size, const uint8_t *labels, pci_signed_edge *edges,
                       pci_signed_graph *graph) {
    const size_t count = projected->vertex_count;
    double agreeing = 0.0;
    for (size_t v = 0; v < count; ++v) {
        agreeing += labels[v] ? votes[v] : -votes[v];
    }
    const double scale = unit / area, turn = agreeing < 0.0 ? -scale : scale;
    for (uint32_t v = 0; v < count; ++v) {
        const double wish = turn * votes[v];
        edges[v] = (pci_signed_edge){PCI_GROUND, v + 1, wish < 0.0, (int64_t)fabs(wish)};
    }
    for (size_t e = 0; e < topology->edge_count; ++e) {
        const uint32_t a = topology->edges[2 * e], b = topology->edges[2 * e + 1];
        const double length = sqrt(pci_squared_distance(&projected->positions[3 * (size_t)a],
                                                        &projected->positions[3 * (size_t)b]));
        edges[count + e] = (pci_signed_edge){a + 1, b + 1, false,
                                             (int64_t)(scale * border_width * cell_size * length)};
    }
    pci_signed_graph_create(count + 1, edges, count + topology->edge_count, graph);
}

pc_status pci_label_sides(pci_scratch *scratch, const char *stage, const pc_mesh *projected,
                          const pc_mesh *cloth, double cell_size, uint8_t *labels) {
    const size_t count = projected->vertex_count;
    double area = 0.0;
    pci_topology topology;
    double *votes = PCI_SCRATCH(scratch, double, count);
    uint8_t *chosen = PCI_SCRATCH(scratch, uint8_t, count + 1);
    if (scratch->failed || !pci_topology_build_edges(scratch, projected, &topology)) {
        return pci_fail_memory(scratch->context, stage);
    }
    pci_signed_edge *edges = PCI_SCRATCH(scratch, pci_signed_edge, count + topology.edge_count);
    if (edges == NULL) {
        return pci_fail_memory(scratch->context, stage);
    }
    pc_status status = ask(scratch, stage, projected, cloth, votes, &area);
    if (status != PC_OK || !(area > 0.0)) {
        return status;
    }
    pci_signed_graph graph;
    make_graph(projected, &topology, votes, area, cell_size, labels, edges, &graph);
    // Only wishes of single vertices are contrary: a cut is the minimum.
    pci_signed_solution solution = {.labels = chosen};
    status = pci_signed_solve(scratch->context, stage, &graph, (pci_budget){0}, &solution);
    if (status != PC_OK) {
        return status;
    }
    memcpy(labels, chosen + 1, count);
    return join_sides(scratch, projected, &topology, labels)
               ? PC_OK
               : pci_fail_memory(scratch->context, stage);
}
