#include "core/topology.h"

#include <stdlib.h>

static int compare_u64(const void *a, const void *b) {
    const uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return (x > y) - (x < y);
}

// Turns counts stored at [i + 1] into offsets.
static void accumulate(size_t *offsets, size_t count) {
    for (size_t i = 0; i < count; ++i) {
        offsets[i + 1] += offsets[i];
    }
}

// Fills a CSR table from (row, value) pairs in order of increasing pair index.
static bool fill_rows(pci_scratch *scratch, size_t row_count, const size_t *offsets,
                      const uint32_t *rows, const uint32_t *values, size_t pair_count,
                      uint32_t *table) {
    size_t *next = PCI_SCRATCH(scratch, size_t, row_count + 1);
    if (next == NULL) {
        return false;
    }
    memcpy(next, offsets, (row_count + 1) * sizeof(*next));
    for (size_t i = 0; i < pair_count; ++i) {
        if (rows[i] != PC_INVALID_INDEX) {
            table[next[rows[i]]++] = values[i];
        }
    }
    return true;
}

static size_t find_edge(const uint32_t *edges, size_t count, uint32_t a, uint32_t b) {
    size_t low = 0, high = count;
    while (low < high) {
        const size_t middle = (low + high) / 2;
        if (edges[2 * middle] < a || (edges[2 * middle] == a && edges[2 * middle + 1] < b)) {
            low = middle + 1;
        } else {
            high = middle;
        }
    }
    return low;
}

bool pci_topology_build(pci_scratch *scratch, const pc_mesh *mesh, pci_topology *topology) {
    memset(topology, 0, sizeof(*topology));
    const size_t nf = mesh->triangle_count, nv = mesh->vertex_count;
    uint64_t *keys = PCI_SCRATCH(scratch, uint64_t, 3 * nf);
    uint32_t *corner_triangle = PCI_SCRATCH(scratch, uint32_t, 3 * nf);
    topology->triangle_edges = PCI_SCRATCH(scratch, uint32_t, 3 * nf);
    topology->vertex_triangle_offsets = PCI_SCRATCH(scratch, size_t, nv + 1);
    topology->vertex_triangles = PCI_SCRATCH(scratch, uint32_t, 3 * nf);
    topology->ring_offsets = PCI_SCRATCH(scratch, size_t, nv + 1);
    if (scratch->failed) {
        return false;
    }

    // Unique edges by sorting (first, second) keys.
    size_t key_count = 0;
    for (size_t c = 0; c < 3 * nf; ++c) {
        const size_t t = c / 3;
        const uint32_t a = mesh->triangles[c], b = mesh->triangles[3 * t + (c + 1) % 3];
        corner_triangle[c] = (uint32_t)t;
        if (a != b) {
            keys[key_count++] = a < b ? (uint64_t)a << 32 | b : (uint64_t)b << 32 | a;
        }
    }
    qsort(keys, key_count, sizeof(*keys), compare_u64);
    size_t edge_count = 0;
    for (size_t i = 0; i < key_count; ++i) {
        if (i == 0 || keys[i] != keys[i - 1]) {
            keys[edge_count++] = keys[i];
        }
    }
    topology->edge_count = edge_count;
    topology->edges = PCI_SCRATCH(scratch, uint32_t, 2 * edge_count);
    topology->edge_triangle_offsets = PCI_SCRATCH(scratch, size_t, edge_count + 1);
    topology->edge_triangles = PCI_SCRATCH(scratch, uint32_t, 3 * nf);
    topology->ring = PCI_SCRATCH(scratch, uint32_t, 2 * edge_count);
    if (scratch->failed) {
        return false;
    }
    for (size_t e = 0; e < edge_count; ++e) {
        topology->edges[2 * e] = (uint32_t)(keys[e] >> 32);
        topology->edges[2 * e + 1] = (uint32_t)keys[e];
    }

    // Edges of triangles and triangles of edges.
    for (size_t c = 0; c < 3 * nf; ++c) {
        const uint32_t a = mesh->triangles[c], b = mesh->triangles[3 * (c / 3) + (c + 1) % 3];
        if (a == b) {
            topology->triangle_edges[c] = PC_INVALID_INDEX;
            continue;
        }
        const size_t e = find_edge(topology->edges, edge_count, a < b ? a : b, a < b ? b : a);
        topology->triangle_edges[c] = (uint32_t)e;
        ++topology->edge_triangle_offsets[e + 1];
    }
    accumulate(topology->edge_triangle_offsets, edge_count);
    if (!fill_rows(scratch, edge_count, topology->edge_triangle_offsets, topology->triangle_edges,
                   corner_triangle, 3 * nf, topology->edge_triangles)) {
        return false;
    }

    // Triangles of vertices.
    for (size_t c = 0; c < 3 * nf; ++c) {
        ++topology->vertex_triangle_offsets[mesh->triangles[c] + 1];
    }
    accumulate(topology->vertex_triangle_offsets, nv);
    if (!fill_rows(scratch, nv, topology->vertex_triangle_offsets, mesh->triangles, corner_triangle,
                   3 * nf, topology->vertex_triangles)) {
        return false;
    }

    // Rings: edges ascend, so first the smaller and then the larger neighbours arrive in order.
    for (size_t i = 0; i < 2 * edge_count; ++i) {
        ++topology->ring_offsets[topology->edges[i] + 1];
    }
    accumulate(topology->ring_offsets, nv);
    size_t *next = PCI_SCRATCH(scratch, size_t, nv + 1);
    if (next == NULL) {
        return false;
    }
    memcpy(next, topology->ring_offsets, (nv + 1) * sizeof(*next));
    for (size_t e = 0; e < edge_count; ++e) {
        topology->ring[next[topology->edges[2 * e + 1]]++] = topology->edges[2 * e];
    }
    for (size_t e = 0; e < edge_count; ++e) {
        topology->ring[next[topology->edges[2 * e]]++] = topology->edges[2 * e + 1];
    }
    return true;
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
                for (size_t k = topology->edge_triangle_offsets[e];
                     k < topology->edge_triangle_offsets[e + 1]; ++k) {
                    const uint32_t other = topology->edge_triangles[k];
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

static size_t edge_triangle_count(const pci_topology *topology, size_t e) {
    return topology->edge_triangle_offsets[e + 1] - topology->edge_triangle_offsets[e];
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

bool pci_boundary_loops(pci_scratch *scratch, const pc_mesh *mesh, const pci_topology *topology,
                        size_t *loop_count, size_t **loop_offsets, uint32_t **loop_vertices) {
    const size_t nf = mesh->triangle_count;
    size_t border = 0;
    for (size_t e = 0; e < topology->edge_count; ++e) {
        border += edge_triangle_count(topology, e) == 1;
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
        const uint32_t e0 = topology->triangle_edges[half];
        if (visited[half] || e0 == PC_INVALID_INDEX || edge_triangle_count(topology, e0) != 1) {
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
                if (e == PC_INVALID_INDEX || edge_triangle_count(topology, e) != 2) {
                    break;
                }
                const uint32_t *pair =
                    &topology->edge_triangles[topology->edge_triangle_offsets[e]];
                t = pair[0] == t ? pair[1] : pair[0];
            }
            const uint32_t e = topology->triangle_edges[half];
            if (e == PC_INVALID_INDEX || edge_triangle_count(topology, e) != 1) {
                break; // ran into a non-manifold edge: the chain ends open
            }
        }
        (*loop_offsets)[++*loop_count] = written;
    }
    return true;
}

size_t pci_nonmanifold_edge_count(const pci_topology *topology) {
    size_t count = 0;
    for (size_t e = 0; e < topology->edge_count; ++e) {
        count += edge_triangle_count(topology, e) > 2;
    }
    return count;
}

size_t pci_nonmanifold_vertex_count(pci_scratch *scratch, const pc_mesh *mesh,
                                    const pci_topology *topology) {
    // Join the triangles of a vertex across the edges at that vertex; more than one group is bad.
    size_t largest = 0, count = 0;
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        const size_t degree =
            topology->vertex_triangle_offsets[v + 1] - topology->vertex_triangle_offsets[v];
        largest = degree > largest ? degree : largest;
    }
    uint32_t *group = PCI_SCRATCH(scratch, uint32_t, largest);
    if (group == NULL) {
        return 0;
    }
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        const uint32_t *fan = &topology->vertex_triangles[topology->vertex_triangle_offsets[v]];
        const size_t degree =
            topology->vertex_triangle_offsets[v + 1] - topology->vertex_triangle_offsets[v];
        for (size_t i = 0; i < degree; ++i) {
            group[i] = (uint32_t)i;
        }
        size_t groups = degree;
        for (size_t i = 0; i < degree; ++i) {
            for (size_t j = i + 1; j < degree; ++j) {
                bool joined = false;
                for (size_t a = 0; a < 3 && !joined; ++a) {
                    const uint32_t e = topology->triangle_edges[3 * (size_t)fan[i] + a];
                    if (e == PC_INVALID_INDEX ||
                        (topology->edges[2 * e] != v && topology->edges[2 * e + 1] != v)) {
                        continue;
                    }
                    for (size_t b = 0; b < 3 && !joined; ++b) {
                        joined = topology->triangle_edges[3 * (size_t)fan[j] + b] == e;
                    }
                }
                if (joined && group[i] != group[j]) {
                    const uint32_t from = group[j], to = group[i];
                    for (size_t k = 0; k < degree; ++k) {
                        group[k] = group[k] == from ? to : group[k];
                    }
                    --groups;
                }
            }
        }
        count += groups > 1;
    }
    return count;
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

// Twice the triangle's area times its unit normal.
static void area_vector(const pc_mesh *mesh, size_t triangle, double out[3]) {
    const uint32_t *corner = &mesh->triangles[3 * triangle];
    double ab[3], ac[3];
    pci_sub(&mesh->positions[3 * (size_t)corner[1]], &mesh->positions[3 * (size_t)corner[0]], ab);
    pci_sub(&mesh->positions[3 * (size_t)corner[2]], &mesh->positions[3 * (size_t)corner[0]], ac);
    pci_cross(ab, ac, out);
}

void pci_vertex_normals(const pc_mesh *mesh, double *normals) {
    memset(normals, 0, 3 * mesh->vertex_count * sizeof(*normals));
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        double normal[3];
        area_vector(mesh, t, normal);
        for (size_t c = 0; c < 3; ++c) {
            double *at = &normals[3 * (size_t)mesh->triangles[3 * t + c]];
            at[0] += normal[0], at[1] += normal[1], at[2] += normal[2];
        }
    }
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        pci_normalize(&normals[3 * v]);
    }
}

double pci_triangle_area(const pc_mesh *mesh, size_t triangle) {
    double normal[3];
    area_vector(mesh, triangle, normal);
    return 0.5 * pci_norm(normal);
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
