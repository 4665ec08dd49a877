#include "geometry/stitch.h"

#include <stdlib.h>

#include "core/sorting.h"
#include "geometry/bvh.h"

// Where more edges meet, or a vertex lies on more, nothing is stitched.
enum { most_near = 64, most_notches = 4, grain = 256 };

// What lies farther from an edge than this share of its length does not lie on it.
static const double most_aside = 0.05;
// The least share of a cut edge that has another edge beside it.
static const double least_seam = 0.5;

typedef struct place {
    const double *position;
    uint32_t vertex;
} place;

// Where a half-edge is cut.
typedef struct notch {
    uint32_t half, vertex;
    double share; // of its length
} notch;

typedef struct stitching {
    const pc_mesh *mesh;
    double reach;
    uint32_t *first;    // #V: of the vertices at one place the first
    uint32_t *halves;   // half-edges on the border
    uint32_t *vertices; // on the border, one of each place
    size_t half_count, vertex_count;
    const pci_bvh *bvh; // of the half-edges
    notch *notches;     // #vertices by most_notches
    uint8_t *counts;    // #vertices
} stitching;

static uint32_t corner_after(const pc_mesh *mesh, uint32_t half) {
    return mesh->triangles[half % 3 == 2 ? half - 2 : half + 1];
}

static int compare_places(const void *left, const void *right) {
    const place *a = left, *b = right;
    for (size_t k = 0; k < 3; ++k) {
        if (a->position[k] != b->position[k]) {
            return a->position[k] < b->position[k] ? -1 : 1;
        }
    }
    return (a->vertex > b->vertex) - (a->vertex < b->vertex);
}

static int compare_notches(const void *left, const void *right) {
    const notch *a = left, *b = right;
    if (a->half != b->half) {
        return a->half < b->half ? -1 : 1;
    }
    return a->share != b->share ? (a->share < b->share ? -1 : 1)
                                : (a->vertex > b->vertex) - (a->vertex < b->vertex);
}

// Finds the half-edges and the places on the border.
static bool find_border(pci_scratch *scratch, const pci_topology *edges, stitching *s) {
    const pc_mesh *mesh = s->mesh;
    for (size_t e = 0; e < edges->edge_count; ++e) {
        s->half_count += pci_side_count(edges, e) == 1;
    }
    s->halves = PCI_SCRATCH(scratch, uint32_t, s->half_count);
    s->vertices = PCI_SCRATCH(scratch, uint32_t, 2 * s->half_count);
    s->first = PCI_SCRATCH(scratch, uint32_t, mesh->vertex_count);
    place *places = PCI_SCRATCH(scratch, place, 2 * s->half_count);
    if (scratch->failed) {
        return false;
    }
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        s->first[v] = (uint32_t)v;
    }
    size_t count = 0;
    for (size_t e = 0; e < edges->edge_count; ++e) {
        if (pci_side_count(edges, e) == 1) {
            s->halves[count / 2] = pci_half_along(edges, *pci_sides(edges, e), e);
            for (size_t k = 0; k < 2; ++k) {
                const uint32_t v = edges->edges[2 * e + k];
                places[count++] = (place){&mesh->positions[3 * (size_t)v], v};
            }
        }
    }
    qsort(places, count, sizeof(*places), compare_places);
    for (size_t i = 0, run = 0; i < count; ++i) {
        const bool same =
            i > 0 && memcmp(places[i].position, places[run].position, 3 * sizeof(double)) == 0;
        run = same ? run : i;
        s->first[places[i].vertex] = places[run].vertex;
        if (!same) {
            s->vertices[s->vertex_count++] = places[i].vertex;
        }
    }
    return true;
}

static void find_notches(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const stitching *s = user;
    for (size_t i = begin; i < end; ++i) {
        const uint32_t v = s->vertices[i];
        const double *p = &s->mesh->positions[3 * (size_t)v];
        uint32_t near[most_near];
        const size_t count = pci_bvh_collect(s->bvh, p, s->reach, most_near, near);
        size_t found = 0;
        for (size_t k = 0; k < count && count <= most_near; ++k) {
            const uint32_t half = s->halves[near[k]];
            const uint32_t *corner = &s->mesh->triangles[half - half % 3];
            const double *a = &s->mesh->positions[3 * (size_t)s->mesh->triangles[half]];
            const double *b = &s->mesh->positions[3 * (size_t)corner_after(s->mesh, half)];
            double edge[3], to[3];
            pci_sub(b, a, edge);
            pci_sub(p, a, to);
            const double length = pci_norm(edge), along = pci_dot(edge, to) / length;
            const double slack = fmin(s->reach, most_aside * length);
            const bool own =
                s->first[corner[0]] == v || s->first[corner[1]] == v || s->first[corner[2]] == v;
            const bool on = along > slack && along < length - slack &&
                            pci_dot(to, to) - along * along <= slack * slack;
            if (!own && on && found++ < most_notches) {
                s->notches[i * most_notches + found - 1] = (notch){half, v, along / length};
            }
        }
        s->counts[i] = (uint8_t)(found <= most_notches ? found : 0);
    }
}

// The vertices at both ends of a piece, the smaller first.
static uint64_t piece_key(uint32_t a, uint32_t b) {
    return a < b ? (uint64_t)a << 32 | b : (uint64_t)b << 32 | a;
}

static bool is_shared(const uint64_t *keys, size_t count, uint64_t key) {
    size_t low = 0, high = count;
    while (low < high) {
        const size_t middle = low + (high - low) / 2;
        if (keys[middle] < key) {
            low = middle + 1;
        } else {
            high = middle;
        }
    }
    return low + 1 < count && keys[low + 1] == key;
}

// Keeps the notches of edges whose pieces other edges of the border have, too: where borders only
// meet, and where something narrow ends on an edge, there is no seam. False: out of memory.
static bool keep_seams(pci_scratch *scratch, const stitching *s, notch *notches, size_t *count) {
    const uint32_t *corner = s->mesh->triangles;
    uint64_t *keys = PCI_SCRATCH(scratch, uint64_t, s->half_count + *count);
    uint64_t *sorted = PCI_SCRATCH(scratch, uint64_t, s->half_count + *count);
    uint8_t *border = PCI_SCRATCH(scratch, uint8_t, 3 * s->mesh->triangle_count);
    if (scratch->failed) {
        return false;
    }
    for (size_t i = 0; i < s->half_count; ++i) {
        border[s->halves[i]] = 1;
    }
    size_t pieces = 0, kept = 0;
    for (uint32_t h = 0, n = 0; h < 3 * s->mesh->triangle_count; ++h) {
        if (border[h]) {
            uint32_t from = s->first[corner[h]];
            for (; n < *count && notches[n].half == h; ++n) {
                keys[pieces++] = piece_key(from, notches[n].vertex);
                from = notches[n].vertex;
            }
            keys[pieces++] = piece_key(from, s->first[corner_after(s->mesh, h)]);
        }
    }
    memcpy(sorted, keys, pieces * sizeof(*keys));
    if (!pci_sort_keys(scratch->context, pieces, sorted, NULL)) {
        return false;
    }
    for (size_t n = 0, next = 0, piece = 0, at = 0; n < *count; n = next) {
        for (; at < notches[n].half; ++at) {
            piece += border[at];
        }
        double seam = 0.0, from = 0.0;
        while (next < *count && notches[next].half == at) {
            ++next;
        }
        for (size_t i = n; i <= next; ++i, ++piece) {
            const double to = i < next ? notches[i].share : 1.0;
            seam += is_shared(sorted, pieces, keys[piece]) ? to - from : 0.0;
            from = to;
        }
        for (size_t i = n; i < next && seam >= least_seam; ++i) {
            notches[kept++] = notches[i];
        }
        ++at;
    }
    *count = kept;
    return true;
}

// Cuts the edge from corner `at` of a triangle to the next, and appends the pieces behind the
// first. Returns the last piece.
static uint32_t *cut_edge(const notch *notches, size_t begin, size_t end, size_t at,
                          uint32_t *piece, uint32_t *triangles, size_t *count) {
    for (size_t n = begin; n < end; ++n) {
        uint32_t *rest = &triangles[3 * (*count)++];
        memcpy(rest, piece, 3 * sizeof(*rest));
        piece[(at + 1) % 3] = rest[at] = notches[n].vertex;
        piece = rest;
    }
    return piece;
}

// Appends a triangle that is cut at its edges; those of edge k are from `offsets[k]`.
static void append(const notch *notches, const size_t offsets[4], const uint32_t corner[3],
                   uint32_t *triangles, size_t *count) {
    uint32_t *first = &triangles[3 * (*count)++];
    memcpy(first, corner, 3 * sizeof(*corner));
    uint32_t *last = cut_edge(notches, offsets[0], offsets[1], 0, first, triangles, count);
    last = cut_edge(notches, offsets[1], offsets[2], 1, last, triangles, count);
    // The third edge is that of the first piece, unless that was whole until the second was cut.
    (void)cut_edge(notches, offsets[2], offsets[3], 2, offsets[0] < offsets[1] ? first : last,
                   triangles, count);
}

static bool cut_edges(pci_scratch *scratch, const stitching *s, const notch *notches, size_t count,
                      pc_mesh *result) {
    const pc_mesh *mesh = s->mesh;
    pc_mesh cut = *mesh;
    cut.triangles = PCI_SCRATCH(scratch, uint32_t, 3 * (mesh->triangle_count + count));
    if (scratch->failed) {
        return false;
    }
    cut.triangle_count = 0;
    for (size_t t = 0, n = 0; t < mesh->triangle_count; ++t) {
        size_t offsets[4] = {n};
        uint32_t corner[3];
        for (size_t k = 0; k < 3; ++k) {
            corner[k] = s->first[mesh->triangles[3 * t + k]];
            while (n < count && notches[n].half == 3 * t + k) {
                ++n;
            }
            offsets[k + 1] = n;
        }
        append(notches, offsets, corner, cut.triangles, &cut.triangle_count);
    }
    return pci_mesh_compact(scratch, &cut, NULL, result, NULL);
}

pc_status pci_stitch_borders(pci_scratch *scratch, const char *stage, const pc_mesh *mesh,
                             const pci_topology *edges, double reach, pc_mesh *result, bool *some) {
    pc_context *context = scratch->context;
    stitching s = {.mesh = mesh, .reach = reach};
    *some = false;
    if (!find_border(scratch, edges, &s)) {
        return pci_fail_memory(context, stage);
    }
    // The half-edges as triangles without area.
    const pc_mesh sides = {mesh->vertex_count, mesh->positions, s.half_count,
                           PCI_SCRATCH(scratch, uint32_t, 3 * s.half_count)};
    s.notches = PCI_SCRATCH(scratch, notch, most_notches * s.vertex_count);
    s.counts = PCI_SCRATCH(scratch, uint8_t, s.vertex_count);
    if (scratch->failed) {
        return pci_fail_memory(context, stage);
    }
    if (s.half_count == 0) {
        return PC_OK;
    }
    for (size_t i = 0; i < s.half_count; ++i) {
        const uint32_t a = mesh->triangles[s.halves[i]], b = corner_after(mesh, s.halves[i]);
        const uint32_t side[3] = {a, b, b};
        memcpy(&sides.triangles[3 * i], side, sizeof(side));
    }
    pci_bvh *bvh = NULL;
    const pc_status status = pci_bvh_create(context, stage, &sides, &bvh);
    if (status != PC_OK) {
        return status;
    }
    s.bvh = bvh;
    const bool done = pci_parallel_while_wanted(context, s.vertex_count, grain, find_notches, &s);
    pci_bvh_destroy(context, bvh);
    size_t count = 0;
    for (size_t i = 0; i < s.vertex_count; ++i) {
        for (size_t k = 0; k < s.counts[i]; ++k) {
            s.notches[count++] = s.notches[i * most_notches + k];
        }
    }
    qsort(s.notches, count, sizeof(*s.notches), compare_notches);
    if (!done || (count > 0 && !keep_seams(scratch, &s, s.notches, &count)) ||
        (count > 0 && !cut_edges(scratch, &s, s.notches, count, result))) {
        return pci_fail_memory(context, stage);
    }
    *some = count > 0;
    return PC_OK;
}
