#include "geometry/halfedge.h"

#include "geometry/topology.h"

bool pci_halfedge_reserve(pci_halfedge *mesh, size_t vertices, size_t triangles) {
    pci_scratch *scratch = mesh->scratch;
    void *positions = mesh->positions, *outgoing = mesh->outgoing, *marks = mesh->marks;
    void *corners = mesh->corners, *twins = mesh->twins;
    const bool done =
        pci_scratch_reserve(scratch, &positions, &mesh->vertex_capacity, vertices,
                            3 * sizeof(double)) &&
        pci_scratch_reserve(scratch, &outgoing, &mesh->outgoing_capacity, vertices,
                            sizeof(uint32_t)) &&
        pci_scratch_reserve(scratch, &marks, &mesh->mark_capacity, vertices, sizeof(uint32_t)) &&
        pci_scratch_reserve(scratch, &corners, &mesh->corner_capacity, triangles,
                            3 * sizeof(uint32_t)) &&
        pci_scratch_reserve(scratch, &twins, &mesh->twin_capacity, triangles, 3 * sizeof(uint32_t));
    if (done) {
        mesh->positions = positions;
        mesh->outgoing = outgoing;
        mesh->marks = marks;
        mesh->corners = corners;
        mesh->twins = twins;
    }
    return done;
}

static void join(pci_halfedge *mesh, uint32_t h, uint32_t twin) {
    if (h != PC_INVALID_INDEX) {
        mesh->twins[h] = twin;
    }
    if (twin != PC_INVALID_INDEX) {
        mesh->twins[twin] = h;
    }
}

// Makes h, or the border half-edge of the same fan, the first one of its origin.
static void set_outgoing(pci_halfedge *mesh, uint32_t h) {
    uint32_t first = h;
    while (mesh->twins[first] != PC_INVALID_INDEX) {
        first = pci_next(mesh->twins[first]); // clockwise
        if (first == h) {
            break;
        }
    }
    mesh->outgoing[mesh->corners[h]] = first;
}

// The same after an operation that leaves the vertex on the border, or inside, as it was; `border`
// tells which.
static void keep_outgoing(pci_halfedge *mesh, uint32_t h, bool border) {
    if (border) {
        set_outgoing(mesh, h);
    } else {
        mesh->outgoing[mesh->corners[h]] = h;
    }
}

bool pci_halfedge_build(pci_scratch *scratch, const pc_mesh *mesh, pci_halfedge *result) {
    memset(result, 0, sizeof(*result));
    result->scratch = scratch;
    if (!pci_halfedge_reserve(result, mesh->vertex_count, mesh->triangle_count)) {
        return false;
    }
    const struct pci_scratch_block *mark = scratch->blocks;
    pci_topology topology;
    if (!pci_topology_build_edges(scratch, mesh, &topology)) {
        return false;
    }
    result->vertex_count = mesh->vertex_count;
    result->triangle_count = mesh->triangle_count;
    memcpy(result->positions, mesh->positions, 3 * mesh->vertex_count * sizeof(double));
    memcpy(result->corners, mesh->triangles, 3 * mesh->triangle_count * sizeof(uint32_t));
    memset(result->twins, 0xff, 3 * mesh->triangle_count * sizeof(uint32_t));
    memset(result->outgoing, 0xff, mesh->vertex_count * sizeof(uint32_t));
    uint32_t *first = PCI_SCRATCH(scratch, uint32_t, topology.edge_count);
    if (first == NULL) {
        return false;
    }
    memset(first, 0xff, topology.edge_count * sizeof(*first));
    for (uint32_t h = 0; h < 3 * mesh->triangle_count; ++h) {
        uint32_t *other = &first[topology.triangle_edges[h]];
        if (*other == PC_INVALID_INDEX) {
            *other = h;
        } else {
            join(result, h, *other);
        }
    }
    pci_scratch_rewind(scratch, mark);
    for (uint32_t h = 0; h < 3 * mesh->triangle_count; ++h) {
        if (result->outgoing[result->corners[h]] == PC_INVALID_INDEX) {
            set_outgoing(result, h);
            ++result->live_vertices;
        }
    }
    return true;
}

bool pci_fans_build(pci_scratch *scratch, const pci_halfedge *mesh, pci_fans *fans) {
    // Each triangle adds one end to the fan of each corner, an open fan has one more.
    const size_t room = 3 * mesh->triangle_count + mesh->vertex_count;
    size_t count = 0;
    fans->offsets = PCI_SCRATCH(scratch, size_t, mesh->vertex_count + 1);
    fans->ends = PCI_SCRATCH(scratch, uint32_t, room);
    fans->lengths = PCI_SCRATCH(scratch, double, room);
    if (scratch->failed) {
        return false;
    }
    for (uint32_t v = 0; v < mesh->vertex_count; ++v) {
        PCI_FOR_OUTGOING(mesh, v, h) {
            fans->ends[count++] = pci_target(mesh, h);
            if (mesh->twins[pci_previous(h)] == PC_INVALID_INDEX) {
                fans->ends[count++] = mesh->corners[pci_previous(h)];
            }
        }
        fans->offsets[v + 1] = count;
        for (size_t k = fans->offsets[v]; k < count; ++k) {
            fans->lengths[k] = sqrt(pci_squared_distance(
                &mesh->positions[3 * (size_t)v], &mesh->positions[3 * (size_t)fans->ends[k]]));
        }
    }
    return true;
}

bool pci_halfedge_copy(pci_scratch *scratch, const pci_halfedge *from, pci_halfedge *result) {
    memset(result, 0, sizeof(*result));
    result->scratch = scratch;
    if (!pci_halfedge_reserve(result, from->vertex_count, from->triangle_count)) {
        return false;
    }
    result->vertex_count = from->vertex_count;
    result->live_vertices = from->live_vertices;
    result->triangle_count = from->triangle_count;
    memcpy(result->positions, from->positions, 3 * from->vertex_count * sizeof(double));
    memcpy(result->corners, from->corners, 3 * from->triangle_count * sizeof(uint32_t));
    memcpy(result->twins, from->twins, 3 * from->triangle_count * sizeof(uint32_t));
    memcpy(result->outgoing, from->outgoing, from->vertex_count * sizeof(uint32_t));
    return true;
}

bool pci_halfedge_export(const pci_halfedge *mesh, pc_mesh *result, uint32_t **kept) {
    uint8_t *keep = PCI_SCRATCH(mesh->scratch, uint8_t, mesh->triangle_count);
    uint32_t *corners = PCI_SCRATCH(mesh->scratch, uint32_t, 3 * mesh->triangle_count);
    if (mesh->scratch->failed) {
        return false;
    }
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        keep[t] = mesh->corners[3 * t] != PC_INVALID_INDEX;
        for (size_t c = 0; c < 3; ++c) {
            corners[3 * t + c] = keep[t] ? mesh->corners[3 * t + c] : 0;
        }
    }
    const pc_mesh all = {mesh->vertex_count, mesh->positions, mesh->triangle_count, corners};
    return pci_mesh_compact(mesh->scratch, &all, keep, result, kept);
}

uint32_t pci_border_incoming(const pci_halfedge *mesh, uint32_t v) {
    uint32_t last = PC_INVALID_INDEX;
    PCI_FOR_OUTGOING(mesh, v, h) { last = h; }
    return pci_previous(last);
}

// Writes a triangle whose first half-edge runs from a to b.
static void set_triangle(pci_halfedge *mesh, uint32_t first, uint32_t a, uint32_t b, uint32_t c,
                         uint32_t twin_ab, uint32_t twin_bc, uint32_t twin_ca) {
    mesh->corners[first] = a, mesh->corners[first + 1] = b, mesh->corners[first + 2] = c;
    join(mesh, first, twin_ab);
    join(mesh, first + 1, twin_bc);
    join(mesh, first + 2, twin_ca);
}

uint32_t pci_split_edge(pci_halfedge *mesh, uint32_t h, const double position[3]) {
    const uint32_t g = mesh->twins[h];
    const bool inner = g != PC_INVALID_INDEX;
    if (!pci_halfedge_reserve(mesh, mesh->vertex_count + 1,
                              mesh->triangle_count + (inner ? 2 : 1))) {
        return PC_INVALID_INDEX;
    }
    const uint32_t m = (uint32_t)mesh->vertex_count++;
    ++mesh->live_vertices;
    memcpy(&mesh->positions[3 * (size_t)m], position, 3 * sizeof(double));
    mesh->marks[m] = 0;
    const uint32_t a = pci_origin(mesh, h), b = pci_target(mesh, h);
    const uint32_t c = mesh->corners[pci_previous(h)];
    const uint32_t bc = mesh->twins[pci_next(h)], ca = mesh->twins[pci_previous(h)];
    const uint32_t t0 = h - h % 3, t1 = 3 * (uint32_t)mesh->triangle_count++;
    const bool border_a = pci_is_border_vertex(mesh, a), border_b = pci_is_border_vertex(mesh, b);
    const bool border_c = pci_is_border_vertex(mesh, c);
    const bool border_d = inner && pci_is_border_vertex(mesh, mesh->corners[pci_previous(g)]);
    // (a, b, c) becomes (a, m, c) and (m, b, c).
    set_triangle(mesh, t0, a, m, c, PC_INVALID_INDEX, PC_INVALID_INDEX, ca);
    set_triangle(mesh, t1, m, b, c, PC_INVALID_INDEX, bc, t0 + 1);
    if (inner) {
        // (b, a, d) becomes (b, m, d) and (m, a, d).
        const uint32_t d = mesh->corners[pci_previous(g)];
        const uint32_t ad = mesh->twins[pci_next(g)], db = mesh->twins[pci_previous(g)];
        const uint32_t t2 = g - g % 3, t3 = 3 * (uint32_t)mesh->triangle_count++;
        set_triangle(mesh, t2, b, m, d, t1, PC_INVALID_INDEX, db);
        set_triangle(mesh, t3, m, a, d, t0, ad, t2 + 1);
        keep_outgoing(mesh, t3 + 2, border_d);
    }
    keep_outgoing(mesh, t0, border_a);
    keep_outgoing(mesh, t0 + 1, !inner);
    keep_outgoing(mesh, t0 + 2, border_c);
    keep_outgoing(mesh, t1 + 1, border_b);
    return m;
}

bool pci_can_collapse(pci_halfedge *mesh, uint32_t h) {
    const uint32_t g = mesh->twins[h];
    const uint32_t a = pci_origin(mesh, h), b = pci_target(mesh, h);
    const bool inner = g != PC_INVALID_INDEX;
    // An inner edge between two border vertices would pinch the surface.
    if (inner && pci_is_border_vertex(mesh, a) && pci_is_border_vertex(mesh, b)) {
        return false;
    }
    // A triangle on its own has nothing to collapse to.
    if (!inner && mesh->twins[pci_next(h)] == PC_INVALID_INDEX &&
        mesh->twins[pci_previous(h)] == PC_INVALID_INDEX) {
        return false;
    }
    // The common neighbours must be the opposite corners, nothing else.
    const uint32_t mark = ++mesh->mark;
    size_t degree_a = 0, degree_b = 0, common = 0;
    PCI_FOR_OUTGOING(mesh, a, i) {
        mesh->marks[pci_target(mesh, i)] = mark;
        mesh->marks[mesh->corners[pci_previous(i)]] = mark;
        ++degree_a;
    }
    PCI_FOR_OUTGOING(mesh, b, i) {
        common += mesh->marks[pci_target(mesh, i)] == mark;
        // At the end of an open fan one more neighbour follows.
        const uint32_t last = mesh->corners[pci_previous(i)];
        common += mesh->twins[pci_previous(i)] == PC_INVALID_INDEX && mesh->marks[last] == mark;
        ++degree_b;
    }
    // Two inner vertices with three triangles each: a tetrahedron.
    return common == (inner ? 2u : 1u) &&
           !(inner && degree_a == 3 && degree_b == 3 && !pci_is_border_vertex(mesh, a) &&
             !pci_is_border_vertex(mesh, b));
}

void pci_collapse(pci_halfedge *mesh, uint32_t h) {
    const uint32_t a = pci_origin(mesh, h), b = pci_target(mesh, h);
    const uint32_t sides[2] = {h, mesh->twins[h]};
    for (uint32_t i = mesh->outgoing[a]; i != PC_INVALID_INDEX;) {
        const uint32_t turned = mesh->twins[pci_previous(i)];
        mesh->corners[i] = b;
        i = turned == mesh->outgoing[a] ? PC_INVALID_INDEX : turned;
    }
    uint32_t start = PC_INVALID_INDEX; // some half-edge that leaves the merged vertex
    uint32_t apex[2] = {PC_INVALID_INDEX, PC_INVALID_INDEX};
    for (size_t s = 0; s < 2; ++s) {
        if (sides[s] == PC_INVALID_INDEX) {
            continue;
        }
        // The two other edges of the triangle become one, from the merged vertex to the apex or
        // back.
        const uint32_t x = mesh->twins[pci_next(sides[s])];
        const uint32_t y = mesh->twins[pci_previous(sides[s])];
        const uint32_t kept = x != PC_INVALID_INDEX ? x : y;
        join(mesh, x, y);
        start = mesh->corners[kept] == b ? kept : pci_next(kept);
        apex[s] = mesh->corners[kept] == b ? pci_next(kept) : kept;
        const uint32_t first = sides[s] - sides[s] % 3;
        for (uint32_t c = 0; c < 3; ++c) {
            mesh->corners[first + c] = PC_INVALID_INDEX;
            mesh->twins[first + c] = PC_INVALID_INDEX;
        }
    }
    mesh->outgoing[a] = PC_INVALID_INDEX;
    --mesh->live_vertices;
    set_outgoing(mesh, start);
    for (size_t s = 0; s < 2; ++s) {
        if (apex[s] != PC_INVALID_INDEX) {
            set_outgoing(mesh, apex[s]);
        }
    }
}

bool pci_can_flip(const pci_halfedge *mesh, uint32_t h) {
    const uint32_t g = mesh->twins[h];
    if (g == PC_INVALID_INDEX) {
        return false;
    }
    const uint32_t c = mesh->corners[pci_previous(h)], d = mesh->corners[pci_previous(g)];
    if (c == d) {
        return false;
    }
    PCI_FOR_OUTGOING(mesh, c, i) {
        if (pci_target(mesh, i) == d || mesh->corners[pci_previous(i)] == d) {
            return false;
        }
    }
    return true;
}

void pci_flip(pci_halfedge *mesh, uint32_t h) {
    const uint32_t g = mesh->twins[h];
    const uint32_t a = pci_origin(mesh, h), b = pci_target(mesh, h);
    const uint32_t c = mesh->corners[pci_previous(h)], d = mesh->corners[pci_previous(g)];
    const uint32_t bc = mesh->twins[pci_next(h)], ca = mesh->twins[pci_previous(h)];
    const uint32_t ad = mesh->twins[pci_next(g)], db = mesh->twins[pci_previous(g)];
    const uint32_t t0 = h - h % 3, t1 = g - g % 3;
    const bool border_a = pci_is_border_vertex(mesh, a), border_b = pci_is_border_vertex(mesh, b);
    const bool border_c = pci_is_border_vertex(mesh, c), border_d = pci_is_border_vertex(mesh, d);
    set_triangle(mesh, t0, a, d, c, ad, PC_INVALID_INDEX, ca);
    set_triangle(mesh, t1, d, b, c, db, bc, t0 + 1);
    keep_outgoing(mesh, t0, border_a);
    keep_outgoing(mesh, t0 + 1, border_d);
    keep_outgoing(mesh, t0 + 2, border_c);
    keep_outgoing(mesh, t1 + 1, border_b);
}
