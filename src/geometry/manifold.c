#include "geometry/manifold.h"

#include "core/sorting.h"
#include "core/union_find.h"
#include "geometry/topology.h"

typedef struct repair {
    pci_scratch *scratch;
    const pc_mesh *mesh;
    pci_topology topology;
    uint8_t *alive;      // #F
    uint32_t *glued;     // 3 #F, the half-edge on the other side, or none
    uint8_t *flipped;    // #F, orientation is reversed
    uint32_t *parent;    // 3 #F, union-find over corners: the fans
    uint32_t *triangles; // 3 #F, current corners: root corner of the fan
} repair;

typedef struct sorted_triangle {
    uint32_t corners[3]; // ascending
    uint32_t index;
} sorted_triangle;

static int compare_triangles(const void *a, const void *b) {
    const sorted_triangle *x = a, *y = b;
    for (size_t c = 0; c < 3; ++c) {
        if (x->corners[c] != y->corners[c]) {
            return x->corners[c] < y->corners[c] ? -1 : 1;
        }
    }
    return (x->index > y->index) - (x->index < y->index);
}

// Marks the proper triangles that occur for the first time.
static bool drop_degenerate(repair *r) {
    const pc_mesh *mesh = r->mesh;
    sorted_triangle *sorted = PCI_SCRATCH(r->scratch, sorted_triangle, mesh->triangle_count);
    if (sorted == NULL) {
        return false;
    }
    size_t count = 0;
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        uint32_t c[3];
        memcpy(c, &mesh->triangles[3 * t], sizeof(c));
        if (c[0] == c[1] || c[1] == c[2] || c[2] == c[0]) {
            continue;
        }
        for (size_t i = 0; i < 3; ++i) { // three compare-and-swaps sort three numbers
            const size_t low = i == 1 ? 1 : 0, high = low + 1;
            if (c[low] > c[high]) {
                const uint32_t swapped = c[low];
                c[low] = c[high];
                c[high] = swapped;
            }
        }
        memcpy(sorted[count].corners, c, sizeof(c));
        sorted[count++].index = (uint32_t)t;
    }
    if (!pci_sort_by_number(r->scratch->context, sorted, count, sizeof(*sorted), mesh->vertex_count,
                            compare_triangles)) {
        return false;
    }
    for (size_t i = 0; i < count; ++i) {
        r->alive[sorted[i].index] =
            i == 0 || memcmp(sorted[i].corners, sorted[i - 1].corners, sizeof(uint32_t[3])) != 0;
    }
    return true;
}

// Direction from the edge of half-edge h to the opposite corner, at a right angle to the edge.
static void wing_direction(const pc_mesh *mesh, uint32_t h, double wing[3]) {
    const size_t t = h / 3, c = h % 3;
    const double *a = &mesh->positions[3 * (size_t)mesh->triangles[3 * t + c]];
    const double *b = &mesh->positions[3 * (size_t)mesh->triangles[3 * t + (c + 1) % 3]];
    const double *o = &mesh->positions[3 * (size_t)mesh->triangles[3 * t + (c + 2) % 3]];
    double along[3];
    pci_sub(b, a, along);
    pci_normalize(along);
    pci_sub(o, a, wing);
    const double share = pci_dot(wing, along);
    for (size_t k = 0; k < 3; ++k) {
        wing[k] -= share * along[k];
    }
    pci_normalize(wing);
}

// The half-edges of the first living triangles at an edge. More than `most_wings` are no cloth.
enum { most_wings = 64 };
static size_t list_living(const repair *r, size_t e, uint32_t half[most_wings]) {
    const pci_topology *topology = &r->topology;
    const size_t end = topology->edge_triangle_offsets[e + 1];
    size_t count = 0;
    for (size_t i = topology->edge_triangle_offsets[e]; i < end && count < most_wings; ++i) {
        const uint32_t t = topology->edge_triangles[i];
        if (r->alive[t]) {
            half[count++] = pci_half_along(topology, t, e);
        }
    }
    return count;
}

// Puts the two that continue each other best in front. False: even these are folded back.
static bool find_flattest(const repair *r, uint32_t half[most_wings], size_t count) {
    double wing[most_wings][3], flattest = INFINITY;
    size_t best[2] = {0, 1};
    for (size_t i = 0; i < count; ++i) {
        wing_direction(r->mesh, half[i], wing[i]);
    }
    for (size_t i = 0; i < count; ++i) {
        for (size_t j = i + 1; j < count; ++j) {
            const double bend = pci_dot(wing[i], wing[j]); // -1 is flat
            if (bend < flattest) {
                flattest = bend;
                best[0] = i, best[1] = j;
            }
        }
    }
    const uint32_t pair[2] = {half[best[0]], half[best[1]]};
    memcpy(half, pair, sizeof(pair));
    return flattest < 0.0;
}

// Joins at every edge the two living triangles that continue each other best.
static void glue_edges(repair *r) {
    memset(r->glued, 0xff, 3 * r->mesh->triangle_count * sizeof(*r->glued));
    for (size_t e = 0; e < r->topology.edge_count; ++e) {
        uint32_t half[most_wings];
        const size_t count = list_living(r, e, half);
        if (count == 2 || (count > 2 && find_flattest(r, half, count))) {
            r->glued[half[0]] = half[1];
            r->glued[half[1]] = half[0];
        }
    }
}

// Whether two glued half-edges run the same way, with the flips decided so far.
static bool same_direction(const repair *r, uint32_t h, uint32_t g) {
    const bool same = r->mesh->triangles[h] == r->mesh->triangles[g];
    return same != (r->flipped[h / 3] != r->flipped[g / 3]);
}

// Orients each patch of glued triangles; edges that cannot be satisfied are cut.
static bool orient(repair *r) {
    const size_t nf = r->mesh->triangle_count;
    uint8_t *visited = PCI_SCRATCH(r->scratch, uint8_t, nf);
    uint32_t *stack = PCI_SCRATCH(r->scratch, uint32_t, nf);
    if (r->scratch->failed) {
        return false;
    }
    memset(r->flipped, 0, nf);
    for (size_t start = 0; start < nf; ++start) {
        if (!r->alive[start] || visited[start]) {
            continue;
        }
        size_t count = 0;
        double flipped_area = 0.0, area = 0.0;
        stack[count++] = (uint32_t)start;
        visited[start] = 1;
        for (size_t next = 0; next < count; ++next) { // the stack keeps the whole patch
            const uint32_t t = stack[next];
            const double size = pci_triangle_area(r->mesh, t);
            area += size;
            flipped_area += r->flipped[t] ? size : 0.0;
            for (uint32_t h = 3 * t; h < 3 * t + 3; ++h) {
                const uint32_t g = r->glued[h];
                if (g == PC_INVALID_INDEX) {
                    continue;
                }
                if (!visited[g / 3]) {
                    r->flipped[g / 3] = same_direction(r, h, g);
                    visited[g / 3] = 1;
                    stack[count++] = g / 3;
                } else if (same_direction(r, h, g)) {
                    r->glued[h] = PC_INVALID_INDEX;
                    r->glued[g] = PC_INVALID_INDEX;
                }
            }
        }
        if (flipped_area > 0.5 * area) {
            for (size_t i = 0; i < count; ++i) {
                r->flipped[stack[i]] ^= 1;
            }
        }
    }
    return true;
}

// Corners of one vertex that are connected by glued edges become one vertex.
static void find_fans(repair *r) {
    const uint32_t corner_count = (uint32_t)(3 * r->mesh->triangle_count);
    pci_singletons(r->parent, corner_count);
    for (uint32_t h = 0; h < corner_count; ++h) {
        const uint32_t g = r->glued[h];
        if (g == PC_INVALID_INDEX || g < h) {
            continue;
        }
        const uint32_t h1 = h - h % 3 + (h + 1) % 3, g1 = g - g % 3 + (g + 1) % 3;
        const bool same = r->mesh->triangles[h] == r->mesh->triangles[g];
        pci_unite(r->parent, h, same ? g : g1);
        pci_unite(r->parent, h1, same ? g1 : g);
    }
    for (uint32_t h = 0; h < corner_count; ++h) {
        r->triangles[h] = pci_find_root(r->parent, h);
    }
}

typedef struct fan_edge {
    uint32_t ends[2]; // root corners of the fans, ascending
    uint32_t half;
} fan_edge;

static int compare_fan_edges(const void *a, const void *b) {
    const fan_edge *x = a, *y = b;
    for (size_t i = 0; i < 2; ++i) {
        if (x->ends[i] != y->ends[i]) {
            return x->ends[i] < y->ends[i] ? -1 : 1;
        }
    }
    return (x->half > y->half) - (x->half < y->half);
}

// Whether at some edge living triangles meet that are not joined.
static bool is_crowded(const repair *r) {
    const pci_topology *topology = &r->topology;
    for (size_t e = 0; e < topology->edge_count; ++e) {
        size_t living = 0;
        bool apart = false;
        for (size_t i = topology->edge_triangle_offsets[e];
             i < topology->edge_triangle_offsets[e + 1]; ++i) {
            const uint32_t t = topology->edge_triangles[i];
            if (r->alive[t]) {
                ++living;
                apart = apart || r->glued[pci_half_along(topology, t, e)] == PC_INVALID_INDEX;
            }
        }
        if (living > 1 && apart) {
            return true;
        }
    }
    return false;
}

// Removes triangles that meet others in an edge without being joined to them. False: out of memory.
static bool remove_crowded(repair *r, fan_edge *edges, size_t *removed) {
    size_t count = 0;
    *removed = 0;
    if (!is_crowded(r)) {
        return true;
    }
    for (uint32_t h = 0; h < 3 * r->mesh->triangle_count; ++h) {
        if (r->alive[h / 3]) {
            const uint32_t a = r->triangles[h], b = r->triangles[h - h % 3 + (h + 1) % 3];
            edges[count++] = (fan_edge){{a < b ? a : b, a < b ? b : a}, h};
        }
    }
    if (!pci_sort_by_number(r->scratch->context, edges, count, sizeof(*edges),
                            3 * r->mesh->triangle_count, compare_fan_edges)) {
        return false;
    }
    for (size_t i = 0; i < count;) {
        size_t end = i + 1;
        while (end < count && edges[end].ends[0] == edges[i].ends[0] &&
               edges[end].ends[1] == edges[i].ends[1]) {
            ++end;
        }
        const uint32_t first = edges[i].half;
        for (size_t j = i + 1; j < end; ++j) {
            if (r->glued[first] != edges[j].half && r->alive[edges[j].half / 3]) {
                r->alive[edges[j].half / 3] = 0;
                ++*removed;
            }
        }
        i = end;
    }
    return true;
}

// Writes the living triangles with a vertex per fan, in the order of the vertices' old indices.
static bool write_result(repair *r, pc_mesh *result, pci_repair_counts *counts) {
    const pc_mesh *mesh = r->mesh;
    const size_t corner_count = 3 * mesh->triangle_count;
    pc_context *context = r->scratch->context;
    uint32_t *number = PCI_SCRATCH(r->scratch, uint32_t, corner_count);
    uint8_t *used = PCI_SCRATCH(r->scratch, uint8_t, mesh->vertex_count);
    size_t *offsets = PCI_SCRATCH(r->scratch, size_t, mesh->vertex_count + 1);
    if (r->scratch->failed) {
        return false;
    }
    pc_mesh out = {0};
    uint64_t used_count = 0;
    for (size_t h = 0; h < corner_count; ++h) {
        if (r->alive[h / 3]) {
            out.triangle_count += h % 3 == 0;
            if (r->triangles[h] == h) {
                ++offsets[mesh->triangles[h] + 1];
            }
            used_count += !used[mesh->triangles[h]];
            used[mesh->triangles[h]] = 1;
        }
    }
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        offsets[v + 1] += offsets[v];
    }
    out.vertex_count = offsets[mesh->vertex_count];
    out.positions = PCI_ALLOCATE(context, double, 3 * out.vertex_count);
    out.triangles = PCI_ALLOCATE(context, uint32_t, 3 * out.triangle_count);
    if (out.positions == NULL || out.triangles == NULL) {
        pc_mesh_free(context, &out);
        return false;
    }
    for (size_t h = 0; h < corner_count; ++h) {
        if (r->alive[h / 3] && r->triangles[h] == h) {
            number[h] = (uint32_t)offsets[mesh->triangles[h]]++;
            memcpy(&out.positions[3 * (size_t)number[h]],
                   &mesh->positions[3 * (size_t)mesh->triangles[h]], 3 * sizeof(double));
        }
    }
    uint32_t *write = out.triangles;
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        if (r->alive[t]) {
            const size_t flip = r->flipped[t];
            *write++ = number[r->triangles[3 * t]];
            *write++ = number[r->triangles[3 * t + 1 + flip]];
            *write++ = number[r->triangles[3 * t + 2 - flip]];
            counts->flipped_triangles += flip;
        }
    }
    counts->split_vertices = out.vertex_count - used_count;
    *result = out;
    return true;
}

// ---- meshes that are in order -------------------------------------------------------------------

// Whether every edge has one triangle, or two that run along it in opposite directions. `twins`
// (3 #F) receives the half-edges on the other side.
static bool find_twins(const repair *r, uint32_t *twins) {
    const pci_topology *topology = &r->topology;
    memset(twins, 0xff, 3 * r->mesh->triangle_count * sizeof(*twins));
    for (size_t e = 0; e < topology->edge_count; ++e) {
        const uint32_t *sides = pci_sides(topology, e);
        const size_t count = pci_side_count(topology, e);
        if (count > 2) {
            return false;
        }
        if (count == 2) {
            const uint32_t h = pci_half_along(topology, sides[0], e);
            const uint32_t g = pci_half_along(topology, sides[1], e);
            if (r->mesh->triangles[h] == r->mesh->triangles[g]) {
                return false;
            }
            twins[h] = g;
            twins[g] = h;
        }
    }
    return true;
}

// Whether some triangle has a repeated vertex, or its copy on the other side of all three edges.
static bool has_improper(const repair *r, const uint32_t *twins) {
    bool improper = false;
    for (size_t h = 0; h < 3 * r->mesh->triangle_count && !improper; h += 3) {
        const uint32_t *edges = &r->topology.triangle_edges[h];
        improper = edges[0] == PC_INVALID_INDEX || edges[1] == PC_INVALID_INDEX ||
                   edges[2] == PC_INVALID_INDEX ||
                   (twins[h] != PC_INVALID_INDEX && twins[h] / 3 == twins[h + 1] / 3 &&
                    twins[h] / 3 == twins[h + 2] / 3);
    }
    return improper;
}

// Counts the fans of all vertices, those that end at borders first. `visited` (3 #F) is zeroed.
static size_t count_fans(const repair *r, const uint32_t *twins, uint8_t *visited) {
    const uint32_t corners = (uint32_t)(3 * r->mesh->triangle_count);
    size_t count = 0;
    for (int pass = 0; pass < 2; ++pass) {
        for (uint32_t start = 0; start < corners; ++start) {
            if (visited[start] || (pass == 0 && twins[start] != PC_INVALID_INDEX)) {
                continue;
            }
            ++count;
            for (uint32_t h = start; h != PC_INVALID_INDEX && !visited[h];) {
                visited[h] = 1;
                h = twins[h % 3 == 0 ? h + 2 : h - 1];
            }
        }
    }
    return count;
}

// Whether nothing is to be repaired: most meshes here were repaired before.
static bool is_in_order(const repair *r) {
    const pc_mesh *mesh = r->mesh;
    uint32_t *twins = PCI_SCRATCH(r->scratch, uint32_t, 3 * mesh->triangle_count);
    uint8_t *visited = PCI_SCRATCH(r->scratch, uint8_t, 3 * mesh->triangle_count);
    uint8_t *used = PCI_SCRATCH(r->scratch, uint8_t, mesh->vertex_count);
    if (r->scratch->failed || !find_twins(r, twins) || has_improper(r, twins)) {
        return false;
    }
    size_t vertices = 0;
    for (size_t c = 0; c < 3 * mesh->triangle_count; ++c) {
        vertices += !used[mesh->triangles[c]];
        used[mesh->triangles[c]] = 1;
    }
    return count_fans(r, twins, visited) == vertices;
}

// ---- entry --------------------------------------------------------------------------------------

static bool repair_all(repair *r, pc_mesh *result, pci_repair_counts *counts) {
    pci_scratch *scratch = r->scratch;
    const size_t nf = r->mesh->triangle_count;
    r->alive = PCI_SCRATCH(scratch, uint8_t, nf);
    r->glued = PCI_SCRATCH(scratch, uint32_t, 3 * nf);
    r->flipped = PCI_SCRATCH(scratch, uint8_t, nf);
    r->parent = PCI_SCRATCH(scratch, uint32_t, 3 * nf);
    r->triangles = PCI_SCRATCH(scratch, uint32_t, 3 * nf);
    fan_edge *edges = PCI_SCRATCH(scratch, fan_edge, 3 * nf);
    if (scratch->failed || !drop_degenerate(r)) {
        return false;
    }
    // A removal can free a better pairing, so everything else is decided anew.
    size_t removed = 0;
    do {
        glue_edges(r);
        if (!pci_keep_going(scratch->context) || !orient(r) || !pci_keep_going(scratch->context)) {
            return false;
        }
        find_fans(r);
        if (!pci_keep_going(scratch->context) || !remove_crowded(r, edges, &removed)) {
            return false;
        }
    } while (removed > 0);
    for (size_t t = 0; t < nf; ++t) {
        counts->removed_triangles += !r->alive[t];
    }
    return pci_keep_going(scratch->context) && write_result(r, result, counts);
}

bool pci_mesh_repair(pci_scratch *scratch, const pc_mesh *mesh, const uint8_t *keep,
                     pc_mesh *result, pci_repair_counts *counts) {
    const struct pci_scratch_block *mark = scratch->blocks;
    pc_mesh kept = {0};
    repair r = {.scratch = scratch, .mesh = keep == NULL ? mesh : &kept};
    memset(counts, 0, sizeof(*counts));
    bool done = (keep == NULL || pci_mesh_compact(scratch, mesh, keep, &kept, NULL)) &&
                pci_topology_build_edges(scratch, r.mesh, &r.topology);
    if (done && !is_in_order(&r)) {
        done = !scratch->failed && repair_all(&r, result, counts);
    } else if (done && keep == NULL) {
        done = pci_mesh_compact(scratch, mesh, NULL, result, NULL);
    } else if (done) {
        *result = kept;
        kept = (pc_mesh){0};
    }
    pc_mesh_free(scratch->context, &kept);
    pci_scratch_rewind(scratch, mark);
    return done;
}
