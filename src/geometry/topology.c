#include "geometry/topology.h"

#include <stdlib.h>

#include "core/union_find.h"

// Turns counts stored at [i + 1] into offsets.
static void accumulate(size_t *offsets, size_t count) {
    for (size_t i = 0; i < count; ++i) {
        offsets[i + 1] += offsets[i];
    }
}

// Ends of the half-edge from corner c to the next one, smaller vertex first.
static void half_edge_ends(const uint32_t corners[3], size_t c, uint32_t ends[2]) {
    const uint32_t a = corners[c], b = corners[c == 2 ? 0 : c + 1];
    ends[0] = a < b ? a : b;
    ends[1] = a < b ? b : a;
}

// A half-edge in the row of its smaller vertex: the larger vertex above, the half-edge below.
static uint64_t make_entry(uint32_t second, size_t half) { return (uint64_t)second << 32 | half; }
static uint32_t entry_second(uint64_t entry) { return (uint32_t)(entry >> 32); }
static uint32_t entry_half(uint64_t entry) { return (uint32_t)entry; }

static void sort_row(uint64_t *row, size_t count) {
    enum { most_inserted = 16 };
    if (count > most_inserted) {
        qsort(row, count, sizeof(*row), pci_compare_u64);
    }
    for (size_t i = 1; i < count && count <= most_inserted; ++i) {
        uint64_t entry = row[i];
        for (size_t at = i; at > 0; --at) { // to the end: branches would be guessed wrong
            const uint64_t before = row[at - 1];
            row[at] = before > entry ? before : entry;
            entry = before > entry ? entry : before;
        }
        row[0] = entry;
    }
}

// The rows of so many vertices are sorted at a time.
enum { vertex_grain = 2048 };

// Edges that begin at some vertices, and the entries in their lists of triangles.
typedef struct edge_block {
    size_t edges, triangles;
} edge_block;

// The half-edges with length in rows by their smaller vertex, ordered: row v is entries[offsets[v]
// .. offsets[v + 1]).
typedef struct edge_rows {
    const pc_mesh *mesh;
    uint64_t *entries;
    size_t *offsets; // #V + 2
    edge_block *blocks;
    pci_topology *topology;
} edge_rows;

// Whether an entry begins an edge, and whether it adds a triangle to it: a triangle with a repeated
// vertex runs along its edge twice.
static bool is_first(const edge_rows *r, size_t begin, size_t i) {
    return i == begin || entry_second(r->entries[i]) != entry_second(r->entries[i - 1]);
}
static bool is_another(const edge_rows *r, size_t i) {
    return entry_half(r->entries[i]) / 3 != entry_half(r->entries[i - 1]) / 3;
}

static void sort_rows(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    edge_rows *r = user;
    edge_block count = {0, 0};
    for (size_t v = begin; v < end; ++v) {
        const size_t first = r->offsets[v], last = r->offsets[v + 1];
        sort_row(&r->entries[first], last - first);
        for (size_t i = first; i < last; ++i) {
            const bool begins = is_first(r, first, i);
            count.edges += begins;
            count.triangles += begins || is_another(r, i);
        }
    }
    r->blocks[begin / vertex_grain] = count;
}

static void list_half_edges(edge_rows *r) {
    const pc_mesh *mesh = r->mesh;
    size_t *next = r->offsets + 1;
    uint32_t ends[2];
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        for (size_t c = 0; c < 3; ++c) {
            half_edge_ends(&mesh->triangles[3 * t], c, ends);
            next[ends[0] + 1] += ends[0] != ends[1];
        }
    }
    accumulate(next, mesh->vertex_count);
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        for (size_t c = 0; c < 3; ++c) {
            half_edge_ends(&mesh->triangles[3 * t], c, ends);
            if (ends[0] != ends[1]) {
                r->entries[next[ends[0]]++] = make_entry(ends[1], 3 * t + c);
            }
        }
    }
}

// Edges, edges of triangles and triangles of edges from the ordered half-edges.
static void write_edges(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const edge_rows *r = user;
    pci_topology *topology = r->topology;
    size_t edge = r->blocks[begin / vertex_grain].edges;
    size_t written = r->blocks[begin / vertex_grain].triangles;
    for (size_t v = begin; v < end; ++v) {
        for (size_t i = r->offsets[v]; i < r->offsets[v + 1]; ++i) {
            const uint32_t half = entry_half(r->entries[i]);
            const bool first = is_first(r, r->offsets[v], i);
            if (first) {
                topology->edges[2 * edge] = (uint32_t)v;
                topology->edges[2 * edge++ + 1] = entry_second(r->entries[i]);
            }
            topology->triangle_edges[half] = (uint32_t)(edge - 1);
            if (first || is_another(r, i)) {
                topology->edge_triangles[written++] = half / 3;
            }
            topology->edge_triangle_offsets[edge] = written;
        }
    }
}

// Turns the numbers of blocks into what lies before them; returns the number of edges.
static size_t add_up(edge_block *blocks, size_t count) {
    edge_block before = {0, 0};
    for (size_t i = 0; i < count; ++i) {
        const edge_block own = blocks[i];
        blocks[i] = before;
        before.edges += own.edges;
        before.triangles += own.triangles;
    }
    return before.edges;
}

static bool allocate_edges(pci_scratch *scratch, const pc_mesh *mesh, pci_topology *topology) {
    const size_t half_count = 3 * mesh->triangle_count;
    topology->triangle_edges = PCI_SCRATCH(scratch, uint32_t, half_count);
    topology->edge_triangles = PCI_SCRATCH(scratch, uint32_t, half_count);
    topology->edges = PCI_SCRATCH(scratch, uint32_t, 2 * topology->edge_count);
    topology->edge_triangle_offsets = PCI_SCRATCH(scratch, size_t, topology->edge_count + 1);
    if (scratch->failed) {
        return false;
    }
    memset(topology->triangle_edges, 0xff, half_count * sizeof(uint32_t));
    return true;
}

// Whether an earlier corner of the triangle has the same vertex.
static bool is_repeated(const pc_mesh *mesh, size_t corner) {
    const uint32_t *of = &mesh->triangles[corner - corner % 3];
    return (corner % 3 > 0 && of[0] == of[corner % 3]) || (corner % 3 > 1 && of[1] == of[2]);
}

static bool build_vertex_triangles(pci_scratch *scratch, const pc_mesh *mesh,
                                   pci_topology *topology) {
    const size_t half_count = 3 * mesh->triangle_count, nv = mesh->vertex_count;
    topology->vertex_triangle_offsets = PCI_SCRATCH(scratch, size_t, nv + 1);
    topology->vertex_triangles = PCI_SCRATCH(scratch, uint32_t, half_count);
    size_t *next = PCI_SCRATCH(scratch, size_t, nv + 1);
    if (scratch->failed) {
        return false;
    }
    for (size_t c = 0; c < half_count; ++c) {
        topology->vertex_triangle_offsets[mesh->triangles[c] + 1] += !is_repeated(mesh, c);
    }
    accumulate(topology->vertex_triangle_offsets, nv);
    memcpy(next, topology->vertex_triangle_offsets, (nv + 1) * sizeof(*next));
    for (size_t c = 0; c < half_count; ++c) {
        if (!is_repeated(mesh, c)) {
            topology->vertex_triangles[next[mesh->triangles[c]]++] = (uint32_t)(c / 3);
        }
    }
    return true;
}

static bool build_rings(pci_scratch *scratch, size_t vertex_count, pci_topology *topology) {
    topology->ring_offsets = PCI_SCRATCH(scratch, size_t, vertex_count + 1);
    topology->ring = PCI_SCRATCH(scratch, uint32_t, 2 * topology->edge_count);
    size_t *next = PCI_SCRATCH(scratch, size_t, vertex_count + 1);
    if (scratch->failed) {
        return false;
    }
    for (size_t i = 0; i < 2 * topology->edge_count; ++i) {
        ++topology->ring_offsets[topology->edges[i] + 1];
    }
    accumulate(topology->ring_offsets, vertex_count);
    memcpy(next, topology->ring_offsets, (vertex_count + 1) * sizeof(*next));
    // Edges ascend, so first the smaller and then the larger neighbours arrive in order.
    for (size_t e = 0; e < topology->edge_count; ++e) {
        topology->ring[next[topology->edges[2 * e + 1]]++] = topology->edges[2 * e];
    }
    for (size_t e = 0; e < topology->edge_count; ++e) {
        topology->ring[next[topology->edges[2 * e]]++] = topology->edges[2 * e + 1];
    }
    return true;
}

// `watched`: asks between the steps whether to go on.
static bool build(pci_scratch *scratch, const pc_mesh *mesh, bool watched, pci_topology *topology) {
    pc_context *context = scratch->context;
    pci_scratch temporary = pci_scratch_begin(context);
    const size_t blocks = (mesh->vertex_count + vertex_grain - 1) / vertex_grain;
    edge_rows rows = {.mesh = mesh, .topology = topology};
    memset(topology, 0, sizeof(*topology));
    rows.entries = PCI_SCRATCH(&temporary, uint64_t, 3 * mesh->triangle_count);
    rows.offsets = PCI_SCRATCH(&temporary, size_t, mesh->vertex_count + 2);
    rows.blocks = PCI_SCRATCH(&temporary, edge_block, blocks);
    bool good = !temporary.failed;
    if (good) {
        list_half_edges(&rows);
        good = !watched || pci_keep_going(context);
    }
    if (good) {
        pci_parallel_for(context, mesh->vertex_count, vertex_grain, sort_rows, &rows);
        topology->edge_count = add_up(rows.blocks, blocks);
        good = allocate_edges(scratch, mesh, topology) && (!watched || pci_keep_going(context));
    }
    if (good) {
        pci_parallel_for(context, mesh->vertex_count, vertex_grain, write_edges, &rows);
        good = !watched || pci_keep_going(context);
    }
    scratch->failed |= temporary.failed;
    pci_scratch_end(&temporary);
    return good;
}

static bool build_all(pci_scratch *scratch, const pc_mesh *mesh, bool watched,
                      pci_topology *topology) {
    pc_context *context = scratch->context;
    return build(scratch, mesh, watched, topology) &&
           build_vertex_triangles(scratch, mesh, topology) &&
           (!watched || pci_keep_going(context)) &&
           build_rings(scratch, mesh->vertex_count, topology) &&
           (!watched || pci_keep_going(context));
}

bool pci_topology_build(pci_scratch *scratch, const pc_mesh *mesh, pci_topology *topology) {
    return build_all(scratch, mesh, false, topology);
}

bool pci_topology_build_watched(pci_scratch *scratch, const pc_mesh *mesh, pci_topology *topology) {
    return build_all(scratch, mesh, true, topology);
}

bool pci_topology_build_edges(pci_scratch *scratch, const pc_mesh *mesh, pci_topology *topology) {
    return build(scratch, mesh, true, topology);
}

double pci_mean_edge_length(const pc_mesh *mesh, const pci_topology *topology) {
    double sum = 0.0;
    for (size_t e = 0; e < topology->edge_count; ++e) {
        sum += sqrt(pci_squared_distance(&mesh->positions[3 * (size_t)topology->edges[2 * e]],
                                         &mesh->positions[3 * (size_t)topology->edges[2 * e + 1]]));
    }
    return topology->edge_count > 0 ? sum / (double)topology->edge_count : 0.0;
}

size_t pci_triangle_components(pci_scratch *scratch, const pc_mesh *mesh,
                               const pci_topology *topology, uint32_t *component) {
    const size_t nf = mesh->triangle_count;
    uint32_t *stack = PCI_SCRATCH(scratch, uint32_t, nf);
    if (stack == NULL) {
        return 0;
    }
    memset(component, 0xff, nf * sizeof(*component));
    size_t count = 0;
    for (size_t start = 0; start < nf; ++start) {
        if (component[start] != PC_INVALID_INDEX) {
            continue;
        }
        size_t depth = 0;
        stack[depth++] = (uint32_t)start;
        component[start] = (uint32_t)count;
        while (depth > 0) {
            const size_t t = stack[--depth];
            for (size_t c = 0; c < 3; ++c) {
                const uint32_t e = topology->triangle_edges[3 * t + c];
                if (e == PC_INVALID_INDEX) {
                    continue;
                }
                for (size_t k = 0; k < pci_side_count(topology, e); ++k) {
                    const uint32_t other = pci_sides(topology, e)[k];
                    if (component[other] == PC_INVALID_INDEX) {
                        component[other] = (uint32_t)count;
                        stack[depth++] = other;
                    }
                }
            }
        }
        ++count;
    }
    return count;
}

void pci_join_alike(const pci_topology *topology, size_t triangle_count, const uint8_t *marked,
                    uint32_t *parents) {
    pci_singletons(parents, triangle_count);
    for (size_t e = 0; e < topology->edge_count; ++e) {
        const uint32_t *sides = pci_sides(topology, e);
        if (pci_side_count(topology, e) == 2 && !marked[sides[0]] == !marked[sides[1]]) {
            pci_unite(parents, sides[0], sides[1]);
        }
    }
}

void pci_mark_border(const pci_topology *topology, uint8_t *border) {
    for (size_t e = 0; e < topology->edge_count; ++e) {
        if (pci_side_count(topology, e) == 1) {
            border[topology->edges[2 * e]] = border[topology->edges[2 * e + 1]] = 1;
        }
    }
}

void pci_mark_open(const pci_topology *topology, const uint32_t *component, uint8_t *open) {
    for (size_t e = 0; e < topology->edge_count; ++e) {
        if (pci_side_count(topology, e) == 1) {
            open[component[*pci_sides(topology, e)]] = 1;
        }
    }
}

double pci_boundary_length(const pc_mesh *mesh, const pci_topology *topology) {
    double length = 0.0;
    for (size_t e = 0; e < topology->edge_count; ++e) {
        if (pci_side_count(topology, e) == 1) {
            const uint32_t *ends = &topology->edges[2 * e];
            length += sqrt(pci_squared_distance(&mesh->positions[3 * (size_t)ends[0]],
                                                &mesh->positions[3 * (size_t)ends[1]]));
        }
    }
    return length;
}

// Corner of triangle t at vertex v.
static size_t corner_of(const pc_mesh *mesh, size_t t, uint32_t v) {
    for (size_t c = 0; c < 2; ++c) {
        if (mesh->triangles[3 * t + c] == v) {
            return c;
        }
    }
    return 2;
}

// Whether a half-edge belongs to one triangle only, and that has three distinct vertices.
static bool is_border(const pc_mesh *mesh, const pci_topology *topology, size_t half) {
    const uint32_t e = topology->triangle_edges[half];
    const size_t last = half - half % 3 + 2;
    return e != PC_INVALID_INDEX && pci_side_count(topology, e) == 1 &&
           !is_repeated(mesh, last - 1) && !is_repeated(mesh, last);
}

bool pci_boundary_loops(pci_scratch *scratch, const pc_mesh *mesh, const pci_topology *topology,
                        size_t *loop_count, size_t **loop_offsets, uint32_t **loop_vertices) {
    const size_t nf = mesh->triangle_count;
    size_t border = 0;
    for (size_t h = 0; h < 3 * nf; ++h) {
        border += is_border(mesh, topology, h);
    }
    uint8_t *visited = PCI_SCRATCH(scratch, uint8_t, 3 * nf);
    *loop_offsets = PCI_SCRATCH(scratch, size_t, border + 1);
    *loop_vertices = PCI_SCRATCH(scratch, uint32_t, border);
    *loop_count = 0;
    if (scratch->failed) {
        return false;
    }
    size_t written = 0;
    for (size_t start = 0; start < 3 * nf; ++start) {
        // `half` is the half-edge from corner c to c + 1 of a triangle, on the border.
        size_t half = start;
        if (visited[half] || !is_border(mesh, topology, half)) {
            continue;
        }
        while (!visited[half]) {
            visited[half] = 1;
            (*loop_vertices)[written++] = mesh->triangles[half];
            // Turn around the half-edge's end through its fan until the next border half-edge.
            const uint32_t pivot = mesh->triangles[3 * (half / 3) + (half + 1) % 3];
            size_t t = half / 3;
            for (size_t guard = 0; guard <= nf; ++guard) {
                const size_t c = corner_of(mesh, t, pivot);
                const uint32_t e = topology->triangle_edges[3 * t + c];
                half = 3 * t + c;
                if (e == PC_INVALID_INDEX || pci_side_count(topology, e) != 2) {
                    break;
                }
                const uint32_t *pair = pci_sides(topology, e);
                t = pair[0] == t ? pair[1] : pair[0];
            }
            if (!is_border(mesh, topology, half)) {
                break; // ran into a non-manifold edge: the chain ends open
            }
        }
        (*loop_offsets)[++*loop_count] = written;
    }
    return true;
}

bool pci_find_shape(pci_scratch *scratch, const pc_mesh *mesh, pci_shape *shape) {
    pci_topology topology;
    size_t *offsets = NULL;
    uint32_t *loops = NULL;
    const struct pci_scratch_block *mark = scratch->blocks;
    uint32_t *component = PCI_SCRATCH(scratch, uint32_t, mesh->triangle_count);
    if (component == NULL || !pci_topology_build_edges(scratch, mesh, &topology) ||
        !pci_boundary_loops(scratch, mesh, &topology, &shape->boundary_loops, &offsets, &loops)) {
        pci_scratch_rewind(scratch, mark);
        return false;
    }
    shape->components = pci_triangle_components(scratch, mesh, &topology, component);
    shape->euler = mesh->vertex_count + mesh->triangle_count - topology.edge_count;
    pci_scratch_rewind(scratch, mark);
    return !scratch->failed;
}

bool pci_same_topology(const pci_shape *a, const pci_shape *b) {
    return a->components == b->components && a->boundary_loops == b->boundary_loops &&
           a->euler == b->euler;
}

size_t pci_nonmanifold_edge_count(const pci_topology *topology) {
    size_t count = 0;
    for (size_t e = 0; e < topology->edge_count; ++e) {
        count += pci_side_count(topology, e) > 2;
    }
    return count;
}

size_t pci_vertex_components(const pc_mesh *mesh, uint32_t *parents) {
    pci_singletons(parents, mesh->vertex_count);
    size_t count = mesh->vertex_count;
    for (size_t c = 0; c < 3 * mesh->triangle_count; ++c) {
        count -= pci_unite(parents, mesh->triangles[c - c % 3], mesh->triangles[c]);
    }
    return count;
}

size_t pci_manifold_components(pci_scratch *scratch, const pc_mesh *mesh, uint32_t *component) {
    uint32_t *parents = PCI_SCRATCH(scratch, uint32_t, mesh->vertex_count);
    uint32_t *numbers = PCI_SCRATCH(scratch, uint32_t, mesh->vertex_count);
    size_t count = 0;
    if (scratch->failed) {
        return 0;
    }
    (void)pci_vertex_components(mesh, parents);
    memset(numbers, 0xff, mesh->vertex_count * sizeof(*numbers));
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        uint32_t *number = &numbers[pci_find_root(parents, mesh->triangles[3 * t])];
        if (*number == PC_INVALID_INDEX) {
            *number = (uint32_t)count++;
        }
        component[t] = *number;
    }
    return count;
}

double *pci_component_volumes(pci_scratch *scratch, const pc_mesh *mesh, const uint32_t *component,
                              size_t count) {
    double *volumes = PCI_SCRATCH(scratch, double, count);
    uint32_t *first = PCI_SCRATCH(scratch, uint32_t, count);
    if (scratch->failed) {
        return NULL;
    }
    for (size_t t = mesh->triangle_count; t-- > 0;) {
        first[component[t]] = mesh->triangles[3 * t];
    }
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        double corner[3], vector[3];
        pci_sub(&mesh->positions[3 * (size_t)mesh->triangles[3 * t]],
                &mesh->positions[3 * (size_t)first[component[t]]], corner);
        pci_triangle_vector(mesh, t, vector);
        volumes[component[t]] += pci_dot(corner, vector) / 6.0;
    }
    return volumes;
}

bool pci_mesh_compact(pci_scratch *scratch, const pc_mesh *mesh, const uint8_t *keep,
                      pc_mesh *result, uint32_t **kept_vertices) {
    pc_context *context = scratch->context;
    uint32_t *renumbered = PCI_SCRATCH(scratch, uint32_t, mesh->vertex_count);
    uint32_t *kept = PCI_SCRATCH(scratch, uint32_t, mesh->vertex_count);
    if (scratch->failed) {
        return false;
    }
    size_t triangle_count = 0, vertex_count = 0;
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        if (keep == NULL || keep[t]) {
            for (size_t c = 0; c < 3; ++c) {
                renumbered[mesh->triangles[3 * t + c]] = 1;
            }
            ++triangle_count;
        }
    }
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        if (renumbered[v]) {
            kept[vertex_count] = (uint32_t)v;
            renumbered[v] = (uint32_t)vertex_count++;
        }
    }
    pc_mesh compact = {.vertex_count = vertex_count, .triangle_count = triangle_count};
    compact.positions = PCI_ALLOCATE(context, double, 3 * vertex_count);
    compact.triangles = PCI_ALLOCATE(context, uint32_t, 3 * triangle_count);
    if (compact.positions == NULL || compact.triangles == NULL) {
        pc_mesh_free(context, &compact);
        return false;
    }
    for (size_t v = 0; v < vertex_count; ++v) {
        memcpy(&compact.positions[3 * v], &mesh->positions[3 * (size_t)kept[v]],
               3 * sizeof(double));
    }
    size_t written = 0;
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        if (keep == NULL || keep[t]) {
            for (size_t c = 0; c < 3; ++c) {
                compact.triangles[written++] = renumbered[mesh->triangles[3 * t + c]];
            }
        }
    }
    if (kept_vertices != NULL) {
        *kept_vertices = kept;
    }
    *result = compact;
    return true;
}

void pci_triangle_vector(const pc_mesh *mesh, size_t triangle, double out[3]) {
    const uint32_t *corner = &mesh->triangles[3 * triangle];
    pci_normal_of(&mesh->positions[3 * (size_t)corner[0]], &mesh->positions[3 * (size_t)corner[1]],
                  &mesh->positions[3 * (size_t)corner[2]], out);
}

void pci_triangle_middle(const pc_mesh *mesh, size_t triangle, double out[3]) {
    const uint32_t *corner = &mesh->triangles[3 * triangle];
    const double *a = &mesh->positions[3 * (size_t)corner[0]];
    const double *b = &mesh->positions[3 * (size_t)corner[1]];
    const double *c = &mesh->positions[3 * (size_t)corner[2]];
    for (size_t k = 0; k < 3; ++k) {
        out[k] = (a[k] + b[k] + c[k]) / 3.0;
    }
}

void pci_vertex_normals(const pc_mesh *mesh, double *normals) {
    memset(normals, 0, 3 * mesh->vertex_count * sizeof(*normals));
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        double normal[3];
        pci_triangle_vector(mesh, t, normal);
        for (size_t c = 0; c < 3; ++c) {
            double *at = &normals[3 * (size_t)mesh->triangles[3 * t + c]];
            at[0] += normal[0], at[1] += normal[1], at[2] += normal[2];
        }
    }
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        pci_normalize(&normals[3 * v]);
    }
}

pc_status pci_check_mesh(pc_context *context, const char *stage, const pc_mesh *mesh,
                         const char *name) {
    if (mesh == NULL || mesh->vertex_count == 0 || mesh->triangle_count == 0 ||
        mesh->positions == NULL || mesh->triangles == NULL) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage, "%s: the %s is empty", stage,
                        name);
    }
    // Corners and half-edges have 32-bit indices.
    if (mesh->vertex_count >= PC_INVALID_INDEX || mesh->triangle_count >= PC_INVALID_INDEX / 3) {
        return pci_fail(context, PC_ERROR_TOO_LARGE, stage,
                        "%s: %zu vertices and %zu triangles of the %s are too many", stage,
                        mesh->vertex_count, mesh->triangle_count, name);
    }
    for (size_t k = 0; k < 3 * mesh->vertex_count; ++k) {
        if (!(fabs(mesh->positions[k]) <= PCI_FARTHEST)) {
            return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                            "%s: vertex %zu of the %s is not finite or beyond %g", stage, k / 3,
                            name, PCI_FARTHEST);
        }
    }
    for (size_t c = 0; c < 3 * mesh->triangle_count; ++c) {
        if (mesh->triangles[c] >= mesh->vertex_count) {
            return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                            "%s: triangle %zu of the %s uses vertex %u of %zu", stage, c / 3, name,
                            mesh->triangles[c], mesh->vertex_count);
        }
    }
    return PC_OK;
}

pc_status pci_check_mesh_of_cells(pc_context *context, const char *stage, const pc_mesh *mesh,
                                  const char *name, double cell_size) {
    const pc_status status = pci_check_mesh(context, stage, mesh, name);
    if (status != PC_OK) {
        return status;
    }
    if (!(cell_size > 0.0) || !isfinite(cell_size)) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "%s: cell_size = %g, it must be positive", stage, cell_size);
    }
    double low[3], high[3];
    pci_bounding_box(mesh, low, high);
    for (size_t k = 0; k < 3; ++k) {
        if (!((high[k] - low[k]) / cell_size <= PCI_WIDEST_CELLS)) {
            return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                            "%s: cell_size = %g, the %s is %g wide", stage, cell_size, name,
                            high[k] - low[k]);
        }
    }
    return PC_OK;
}

double pci_triangle_area(const pc_mesh *mesh, size_t triangle) {
    double normal[3];
    pci_triangle_vector(mesh, triangle, normal);
    return 0.5 * pci_norm(normal);
}

double pc_mesh_area(const pc_mesh *mesh) {
    double sum = 0.0;
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        sum += pci_triangle_area(mesh, t);
    }
    return sum;
}

void pci_bounding_box(const pc_mesh *mesh, double minimum[3], double maximum[3]) {
    for (size_t k = 0; k < 3; ++k) {
        minimum[k] = mesh->vertex_count > 0 ? mesh->positions[k] : 0.0;
        maximum[k] = minimum[k];
        for (size_t v = 1; v < mesh->vertex_count; ++v) {
            const double x = mesh->positions[3 * v + k];
            minimum[k] = x < minimum[k] ? x : minimum[k];
            maximum[k] = x > maximum[k] ? x : maximum[k];
        }
    }
}

double pci_diagonal(const pc_mesh *mesh) {
    double minimum[3], maximum[3];
    pci_bounding_box(mesh, minimum, maximum);
    return sqrt(pci_squared_distance(minimum, maximum));
}

// The larger two vertices of a triangle, in the row of its smallest one.
typedef struct pair {
    uint64_t vertices;
    size_t triangle;
} pair;

static int compare_pairs(const void *left, const void *right) {
    const pair *a = left, *b = right;
    return a->vertices != b->vertices ? (a->vertices > b->vertices) - (a->vertices < b->vertices)
                                      : (a->triangle > b->triangle) - (a->triangle < b->triangle);
}

// Triangles come in order. Most rows have two.
static void mark_row(pair *row, size_t count, uint8_t *duplicate) {
    enum { most_compared = 8 };
    if (count > most_compared) {
        qsort(row, count, sizeof(*row), compare_pairs);
    }
    for (size_t i = 1; i < count; ++i) {
        for (size_t j = count > most_compared ? i - 1 : 0; j < i; ++j) {
            duplicate[row[i].triangle] |= row[j].vertices == row[i].vertices;
        }
    }
}

static uint32_t smallest_vertex(const uint32_t *v) {
    const uint32_t low = v[0] < v[1] ? v[0] : v[1];
    return v[2] < low ? v[2] : low;
}

bool pci_mark_duplicates(pci_scratch *scratch, const pc_mesh *mesh, uint8_t *duplicate) {
    const size_t nv = mesh->vertex_count, nf = mesh->triangle_count;
    pci_scratch local = pci_scratch_begin(scratch->context);
    size_t *offsets = PCI_SCRATCH(&local, size_t, nv + 2);
    pair *pairs = PCI_SCRATCH(&local, pair, nf);
    const bool done = !local.failed;
    size_t *next = done ? offsets + 1 : NULL;
    for (size_t t = 0; t < nf && done; ++t) {
        ++next[smallest_vertex(&mesh->triangles[3 * t]) + 1];
    }
    for (size_t v = 0; v < nv && done; ++v) {
        next[v + 1] += next[v];
    }
    for (size_t t = 0; t < nf && done; ++t) {
        const uint32_t *v = &mesh->triangles[3 * t];
        const uint32_t high = v[0] < v[1] ? v[1] : v[0], highest = high > v[2] ? high : v[2];
        const uint32_t low = smallest_vertex(v), middle = v[0] ^ v[1] ^ v[2] ^ low ^ highest;
        pairs[next[low]++] = (pair){(uint64_t)middle << 32 | highest, t};
    }
    for (size_t v = 0; v < nv && done; ++v) {
        mark_row(&pairs[offsets[v]], offsets[v + 1] - offsets[v], duplicate);
    }
    scratch->failed = scratch->failed || !done;
    pci_scratch_end(&local);
    return done;
}
