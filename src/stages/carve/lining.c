#include "stages/carve/lining.h"

#include <stdlib.h>

#include "core/union_find.h"
#include "geometry/bvh.h"
#include "geometry/halfedge.h"
#include "geometry/manifold.h"
#include "geometry/topology.h"
#include "solvers/signed_solve.h"

enum { grain = 256 };

// One in so many triangles tells whether it is worth while to ask all.
enum { few = 8 };

// Pieces that are tried one by one where they cannot go together.
enum { most_pieces = 16 };

// Cosine between the normals of two plies, at most.
static const double most_facing = -0.5;
// A cut through flat cloth costs as much as a strip that is so wide on the wrong side, in reaches;
// one along a sharp fold costs this share of it.
static const double cut_width = 0.5, fold_share = 0.05;
// So much of a cut may run where the cosine between its sides is larger.
static const double most_through = 0.1, most_flat = 0.5;
// No cut runs where that cosine is larger: so little is bent by drapery.
static const double least_fold = 0.9;
// Cost of the whole area on the wrong side, and the most that a single wish costs.
static const double unit = 0x1p36;

typedef struct lining {
    pci_scratch *scratch;
    const pc_mesh *mesh;
    pci_topology topology;
    double reach;
    const uint32_t *seen; // #F by 2, or NULL: then `bvh` tells
    const pci_bvh *bvh;
    size_t stride; // one in so many triangles is asked for its mates
    size_t component_count;
    uint32_t *component; // #F
    double *normals;     // #F by 3, unit or zero
    size_t patch_count;
    uint32_t *patches; // #F, of cloth that is too flat to be cut through
    uint32_t *mates;   // #F by 2, plies behind and before; PC_INVALID_INDEX: none
} lining;

static bool is_other(void *user, const pci_hit *hit) { return hit->triangle != *(size_t *)user; }

// The nearest triangle behind triangle t (side 0) or before it (1), if it shows its back or front.
static uint32_t look(const lining *l, size_t t, size_t side) {
    if (l->seen != NULL) {
        return l->seen[2 * t + side];
    }
    const double *normal = &l->normals[3 * t], sign = side == 0 ? -1.0 : 1.0;
    const double direction[3] = {sign * normal[0], sign * normal[1], sign * normal[2]};
    double middle[3];
    pci_triangle_middle(l->mesh, t, middle);
    const pci_hit hit =
        pci_bvh_cast(l->bvh, middle, direction, 1e-4 * l->reach, l->reach, is_other, &t);
    return hit.back_face == (side == 0) ? hit.triangle : PC_INVALID_INDEX;
}

// That, if it belongs to the same component and faces the other way.
static uint32_t find_mate(const lining *l, size_t t, size_t side) {
    const uint32_t seen = look(l, t, side);
    if (seen == PC_INVALID_INDEX || l->component[seen] != l->component[t]) {
        return PC_INVALID_INDEX;
    }
    double other[3];
    pci_triangle_vector(l->mesh, seen, other);
    return pci_normalize(other) && pci_dot(&l->normals[3 * t], other) <= most_facing
               ? seen
               : PC_INVALID_INDEX;
}

static void find_mates(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    lining *l = user;
    for (size_t i = begin; i < end; ++i) {
        const size_t t = l->stride * i;
        double *normal = &l->normals[3 * t];
        l->mates[2 * t] = l->mates[2 * t + 1] = PC_INVALID_INDEX;
        pci_triangle_vector(l->mesh, t, normal);
        if (pci_normalize(normal)) {
            l->mates[2 * t] = find_mate(l, t, 0);
            l->mates[2 * t + 1] = find_mate(l, t, 1);
        } else {
            memset(normal, 0, 3 * sizeof(*normal));
        }
    }
}

// Vertex i + 1 of the graph is patch i.
typedef struct wishes {
    pci_signed_edge *edges;
    size_t count;
} wishes;

// Of two triangles.
static void add_wish(const lining *l, uint32_t s, uint32_t t, bool opposite, double share,
                     wishes *w) {
    const uint32_t a = l->patches[s], b = l->patches[t];
    if (a != b) {
        w->edges[w->count++] = (pci_signed_edge){.a = (a < b ? a : b) + 1,
                                                 .b = (a < b ? b : a) + 1,
                                                 .opposite = opposite,
                                                 .cost = (int64_t)(unit * fmin(share, 1.0))};
    }
}

static double edge_length(const lining *l, size_t e) {
    const uint32_t *ends = &l->topology.edges[2 * e];
    return sqrt(pci_squared_distance(&l->mesh->positions[3 * (size_t)ends[0]],
                                     &l->mesh->positions[3 * (size_t)ends[1]]));
}

// Cosine between the two triangles at an edge.
static double facing_at(const lining *l, size_t e) {
    const uint32_t *sides = pci_sides(&l->topology, e);
    return pci_dot(&l->normals[3 * (size_t)sides[0]], &l->normals[3 * (size_t)sides[1]]);
}

// Joins what would be cut through flat cloth if it came apart.
static bool join_patches(lining *l) {
    const size_t triangles = l->mesh->triangle_count;
    uint32_t *parents = PCI_SCRATCH(l->scratch, uint32_t, triangles);
    l->patches = PCI_SCRATCH(l->scratch, uint32_t, triangles);
    if (l->scratch->failed) {
        return false;
    }
    pci_singletons(parents, triangles);
    for (size_t e = 0; e < l->topology.edge_count; ++e) {
        const uint32_t *sides = pci_sides(&l->topology, e);
        if (pci_side_count(&l->topology, e) == 2 && facing_at(l, e) > least_fold) {
            pci_unite(parents, sides[0], sides[1]);
        }
    }
    // Roots come first: they are the first triangles of their sets.
    for (uint32_t t = 0; t < triangles; ++t) {
        const uint32_t root = pci_find_root(parents, t);
        l->patches[t] = root == t ? (uint32_t)l->patch_count++ : l->patches[root];
    }
    return true;
}

// Mates wish to be on different sides, neighbours on the same one unless the cloth folds there.
static bool make_graph(const lining *l, pci_signed_graph *graph) {
    const pc_mesh *mesh = l->mesh;
    const size_t triangles = mesh->triangle_count;
    wishes w = {.edges = PCI_SCRATCH(l->scratch, pci_signed_edge,
                                     2 * triangles + l->topology.edge_count + l->component_count)};
    uint8_t *pinned = PCI_SCRATCH(l->scratch, uint8_t, l->component_count);
    double total = 0.0;
    if (l->scratch->failed) {
        return false;
    }
    for (size_t t = 0; t < triangles; ++t) {
        total += pci_triangle_area(mesh, t);
    }
    for (uint32_t t = 0; t < triangles; ++t) {
        for (size_t i = 2 * (size_t)t; i < 2 * (size_t)t + 2; ++i) {
            if (l->mates[i] != PC_INVALID_INDEX) {
                add_wish(l, t, l->mates[i], true, pci_triangle_area(mesh, t) / total, &w);
            }
        }
        // Which side is called which does not matter.
        if (!pinned[l->component[t]]) {
            pinned[l->component[t]] = 1;
            w.edges[w.count++] =
                (pci_signed_edge){.a = PCI_GROUND, .b = l->patches[t] + 1, .cost = 1};
        }
    }
    for (size_t e = 0; e < l->topology.edge_count; ++e) {
        if (pci_side_count(&l->topology, e) != 2) {
            continue;
        }
        const uint32_t *sides = pci_sides(&l->topology, e);
        const double width = l->reach * cut_width * (fold_share + 0.5 * (1.0 + facing_at(l, e)));
        add_wish(l, sides[0], sides[1], false, width * edge_length(l, e) / total, &w);
    }
    pci_signed_graph_create(l->patch_count + 1, w.edges, w.count, graph);
    return true;
}

// Keeps the larger side of each component. Returns whether anything goes.
// @param sides  of the patches
static bool choose_side(const lining *l, const uint8_t *sides, uint8_t *keep) {
    double *balance = PCI_SCRATCH(l->scratch, double, l->component_count);
    bool some = false;
    for (size_t t = 0; t < l->mesh->triangle_count && balance != NULL; ++t) {
        balance[l->component[t]] +=
            (sides[l->patches[t]] ? 1.0 : -1.0) * pci_triangle_area(l->mesh, t);
    }
    for (size_t t = 0; t < l->mesh->triangle_count && balance != NULL; ++t) {
        keep[t] = (sides[l->patches[t]] != 0) == (balance[l->component[t]] >= 0.0);
        some = some || !keep[t];
    }
    return some;
}

// A connected piece of what is to go.
typedef struct piece {
    uint32_t root; // its first triangle
    double area;
    double cut, through; // length of its cut, and of what of that runs through flat cloth
} piece;

static int compare_pieces(const void *left, const void *right) { // largest first
    const piece *a = left, *b = right;
    if (a->area != b->area) {
        return a->area > b->area ? -1 : 1;
    }
    return (a->root > b->root) - (a->root < b->root);
}

// Finds the pieces by their first triangles; `of` tells that of each triangle's piece.
static void join_pieces(const lining *l, const uint8_t *keep, uint32_t *of) {
    pci_join_alike(&l->topology, l->mesh->triangle_count, keep, of);
    for (uint32_t t = 0; t < l->mesh->triangle_count; ++t) {
        of[t] = pci_find_root(of, t);
    }
}

// Lists the pieces, largest first. A hem is cut off along its fold. What would be cut through flat
// cloth, as one side of the flat end of a sleeve, is no piece, and is kept from now on.
static bool list_pieces(const lining *l, uint8_t *keep, uint32_t *of, piece **pieces,
                        size_t *count) {
    const size_t triangles = l->mesh->triangle_count;
    piece *all = PCI_SCRATCH(l->scratch, piece, triangles);
    if (all == NULL) {
        return false;
    }
    join_pieces(l, keep, of);
    for (uint32_t t = 0; t < triangles; ++t) {
        all[of[t]].root = of[t];
        all[of[t]].area += pci_triangle_area(l->mesh, t);
    }
    for (size_t e = 0; e < l->topology.edge_count; ++e) {
        const uint32_t *sides = pci_sides(&l->topology, e);
        if (pci_side_count(&l->topology, e) == 2 && keep[sides[0]] != keep[sides[1]]) {
            piece *p = &all[of[sides[keep[sides[0]] ? 1 : 0]]];
            p->cut += edge_length(l, e);
            p->through += facing_at(l, e) > most_flat ? edge_length(l, e) : 0.0;
        }
    }
    *pieces = all;
    *count = 0;
    for (uint32_t t = 0; t < triangles; ++t) {
        keep[t] = keep[t] || all[of[t]].through > most_through * all[of[t]].cut;
    }
    for (uint32_t t = 0; t < triangles; ++t) {
        if (!keep[t] && of[t] == t) {
            all[(*count)++] = all[t];
        }
    }
    qsort(all, *count, sizeof(*all), compare_pieces);
    return true;
}

// Takes the mesh without what goes, if that has the same shape. False: out of memory, or cancelled.
static bool take(const lining *l, const uint8_t *keep, const pci_shape *wanted, pc_mesh *kept) {
    pci_scratch scratch = pci_scratch_begin(l->scratch->context);
    pci_repair_counts counts;
    pci_shape found = {0};
    const bool done = pci_mesh_repair(&scratch, l->mesh, keep, kept, &counts) &&
                      pci_find_shape(&scratch, kept, &found);
    pci_scratch_end(&scratch);
    if (!done || !pci_same_topology(&found, wanted)) {
        pc_mesh_free(l->scratch->context, kept);
    }
    return done;
}

// What counting works with: the set of each triangle, whether a vertex is counted, whether a
// half-edge is on a loop that is.
typedef struct tally {
    uint32_t *parents; // #F
    uint8_t *marks;    // #V
    uint8_t *walked;   // 3 #F
} tally;

// The half-edge along the same edge in another triangle that is kept; PC_INVALID_INDEX: none.
static uint32_t half_across(const lining *l, const uint8_t *keep, uint32_t half) {
    const uint32_t e = l->topology.triangle_edges[half];
    if (e == PC_INVALID_INDEX || pci_side_count(&l->topology, e) != 2) {
        return PC_INVALID_INDEX;
    }
    const uint32_t *sides = pci_sides(&l->topology, e);
    const uint32_t other = sides[sides[0] == half / 3 ? 1 : 0];
    return keep[other] ? pci_half_along(&l->topology, other, e) : PC_INVALID_INDEX;
}

// The boundary loops of what is kept.
static size_t count_loops(const lining *l, const uint8_t *keep, uint8_t *walked) {
    const uint32_t halves = (uint32_t)(3 * l->mesh->triangle_count);
    size_t count = 0;
    memset(walked, 0, halves);
    for (uint32_t start = 0; start < halves; ++start) {
        if (!keep[start / 3] || walked[start] || half_across(l, keep, start) != PC_INVALID_INDEX) {
            continue;
        }
        ++count;
        for (uint32_t half = start; !walked[half];) {
            walked[half] = 1;
            // Turns around the end of the half-edge until the next one on the border.
            uint32_t across = half;
            for (size_t turns = 0; across != PC_INVALID_INDEX && turns < halves; ++turns) {
                half = pci_next(across);
                across = half_across(l, keep, half);
            }
        }
    }
    return count;
}

// Whether the mesh, a manifold, has the same shape without what goes: as take() finds it, which is
// much slower.
static bool fits(const lining *l, const uint8_t *keep, const pci_shape *wanted, const tally *c) {
    enum { used = 1, on_border = 2 };
    const pc_mesh *mesh = l->mesh;
    size_t components = 0, vertices = 0, edges = 0, triangles = 0;
    pci_singletons(c->parents, mesh->triangle_count);
    memset(c->marks, 0, mesh->vertex_count);
    for (size_t e = 0; e < l->topology.edge_count; ++e) {
        const uint32_t *sides = pci_sides(&l->topology, e);
        const bool inner = pci_side_count(&l->topology, e) == 2;
        const bool first = keep[sides[0]], second = inner && keep[sides[1]];
        edges += first || second;
        if (first && second) {
            pci_unite(c->parents, sides[0], sides[1]);
        } else if (first || second) {
            ++vertices; // two edges of the border end at a vertex
            c->marks[l->topology.edges[2 * e]] = on_border;
            c->marks[l->topology.edges[2 * e + 1]] = on_border;
        }
    }
    for (uint32_t t = 0; t < mesh->triangle_count; ++t) {
        triangles += keep[t];
        components += keep[t] && pci_find_root(c->parents, t) == t;
        for (size_t i = 3 * (size_t)t; i < 3 * (size_t)t + 3 && keep[t]; ++i) {
            vertices += c->marks[mesh->triangles[i]] == 0;
            c->marks[mesh->triangles[i]] |= used;
        }
    }
    return components == wanted->components && vertices + triangles - edges == wanted->euler &&
           count_loops(l, keep, c->walked) == wanted->boundary_loops;
}

// `kept` receives the mesh without its linings, if there are some. Where not all pieces can go, as
// many go as may.
static bool cut(const lining *l, uint8_t *keep, pc_mesh *kept) {
    const size_t triangles = l->mesh->triangle_count;
    uint8_t *tried = PCI_SCRATCH(l->scratch, uint8_t, triangles);
    uint32_t *of = PCI_SCRATCH(l->scratch, uint32_t, triangles);
    const tally c = {PCI_SCRATCH(l->scratch, uint32_t, triangles),
                     PCI_SCRATCH(l->scratch, uint8_t, l->mesh->vertex_count),
                     PCI_SCRATCH(l->scratch, uint8_t, 3 * triangles)};
    piece *pieces = NULL;
    size_t count = 0;
    pci_shape wanted = {0};
    if (l->scratch->failed || !list_pieces(l, keep, of, &pieces, &count) ||
        (count > 0 && !pci_find_shape(l->scratch, l->mesh, &wanted))) {
        return false;
    }
    if (count == 0 || fits(l, keep, &wanted, &c)) {
        return count == 0 || take(l, keep, &wanted, kept);
    }
    memset(tried, 1, triangles);
    bool some = false;
    for (size_t i = 0; i < count && i < most_pieces; ++i) {
        for (size_t t = 0; t < triangles; ++t) {
            tried[t] = tried[t] && (keep[t] || of[t] != pieces[i].root);
        }
        const bool goes = fits(l, tried, &wanted, &c);
        some = some || goes;
        for (size_t t = 0; t < triangles && !goes; ++t) {
            tried[t] = tried[t] || (!keep[t] && of[t] == pieces[i].root);
        }
    }
    return !some || take(l, tried, &wanted, kept);
}

// Asks one in `stride` triangles. False: out of memory, or cancelled.
static bool find_all_mates(lining *l, size_t stride) {
    l->stride = stride;
    return pci_parallel_while_wanted(
        l->scratch->context, (l->mesh->triangle_count + stride - 1) / stride, grain, find_mates, l);
}

// The share of the area that has a ply behind or before it, of the triangles that were asked.
static double doubled_share(const lining *l) {
    double total = 0.0, doubled = 0.0;
    for (size_t t = 0; t < l->mesh->triangle_count; t += l->stride) {
        const double area = pci_triangle_area(l->mesh, t);
        const bool alone =
            l->mates[2 * t] == PC_INVALID_INDEX && l->mates[2 * t + 1] == PC_INVALID_INDEX;
        total += area;
        doubled += alone ? 0.0 : area;
    }
    return total > 0.0 ? doubled / total : 0.0;
}

// Chooses what goes, and cuts it off.
static pc_status peel(lining *l, const char *stage, pc_mesh *kept) {
    pc_context *context = l->scratch->context;
    const size_t triangles = l->mesh->triangle_count;
    uint8_t *side = PCI_SCRATCH(l->scratch, uint8_t, triangles + 1);
    uint8_t *keep = PCI_SCRATCH(l->scratch, uint8_t, triangles);
    pci_signed_graph graph;
    if (l->scratch->failed || !join_patches(l) || !make_graph(l, &graph)) {
        return pci_fail_memory(context, stage);
    }
    // Folds are short against what they divide: no search is needed to find them.
    pci_signed_solution solution = {.labels = side};
    const pc_status status = pci_signed_solve(context, stage, &graph, (pci_budget){0}, &solution);
    if (status != PC_OK) {
        return status;
    }
    const bool some = choose_side(l, side + 1, keep);
    return !l->scratch->failed && (!some || cut(l, keep, kept)) ? PC_OK
                                                                : pci_fail_memory(context, stage);
}

pc_status pci_peel_linings(pci_scratch *scratch, const char *stage, const uint32_t *seen,
                           double reach, double least_share, pc_mesh *mesh, bool *peeled) {
    pc_context *context = scratch->context;
    lining l = {.scratch = scratch, .mesh = mesh, .seen = seen, .reach = reach};
    pci_bvh *bvh = NULL;
    pc_mesh kept = {0};
    pc_status status = PC_OK;
    *peeled = false;
    l.component = PCI_SCRATCH(scratch, uint32_t, mesh->triangle_count);
    l.normals = PCI_SCRATCH(scratch, double, 3 * mesh->triangle_count);
    l.mates = PCI_SCRATCH(scratch, uint32_t, 2 * mesh->triangle_count);
    if (scratch->failed || !pci_topology_build_edges(scratch, mesh, &l.topology)) {
        return pci_fail_memory(context, stage);
    }
    l.component_count = pci_triangle_components(scratch, mesh, &l.topology, l.component);
    if (seen == NULL) {
        status = pci_bvh_create(context, stage, mesh, &bvh);
    }
    if (status != PC_OK) {
        return status;
    }
    l.bvh = bvh;
    bool done = true, doubled = true;
    if (least_share > 0.0 &&
        mesh->triangle_count >= few * grain) { // of small ones chance would tell
        done = find_all_mates(&l, few);
        doubled = done && doubled_share(&l) >= 0.5 * least_share;
    }
    if (doubled) {
        done = find_all_mates(&l, 1);
        doubled = done && doubled_share(&l) >= least_share;
    }
    pci_bvh_destroy(context, bvh);
    if (!done || !doubled) {
        return done ? PC_OK : pci_fail_memory(context, stage);
    }
    status = peel(&l, stage, &kept);
    *peeled = status == PC_OK && kept.triangle_count > 0;
    if (*peeled) {
        pc_mesh_free(context, mesh);
        *mesh = kept;
    } else {
        pc_mesh_free(context, &kept);
    }
    return status;
}
