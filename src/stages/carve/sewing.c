#include "stages/carve/sewing.h"

#include "core/union_find.h"
#include "geometry/bvh.h"
#include "geometry/knn.h"
#include "geometry/manifold.h"
#include "geometry/topology.h"

enum { grain = 256 };

// Smaller pieces of a component than this share of it change sides.
static const double small_share = 0.05;
// Seams of more rungs in their table are given up: no garment has such loops.
static const size_t most_rungs = (size_t)1 << 24;

typedef struct covering {
    const pc_mesh *mesh;
    const pci_bvh *bvh;
    const uint32_t *component; // #F
    double reach;
    uint8_t *covered; // #F
} covering;

typedef struct cover_filter {
    const covering *c;
    size_t triangle;
} cover_filter;

static bool is_other_part(void *user, const pci_hit *hit) {
    const cover_filter *f = user;
    return f->c->component[hit->triangle] != f->c->component[f->triangle];
}

static void find_covered(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    covering *c = user;
    for (size_t t = begin; t < end; ++t) {
        double normal[3], middle[3];
        pci_triangle_vector(c->mesh, t, normal);
        if (!pci_normalize(normal)) {
            continue;
        }
        pci_triangle_middle(c->mesh, t, middle);
        cover_filter filter = {c, t};
        const pci_hit hit =
            pci_bvh_cast(c->bvh, middle, normal, 1e-4 * c->reach, c->reach, is_other_part, &filter);
        c->covered[t] = hit.triangle != PC_INVALID_INDEX && hit.back_face;
    }
}

// Turns connected pieces over that are `covered` as asked and small in their component.
static bool turn_small_pieces(pci_scratch *scratch, const covering *c, const pci_topology *topology,
                              const double *areas, bool covered) {
    const size_t triangles = c->mesh->triangle_count;
    uint32_t *piece = PCI_SCRATCH(scratch, uint32_t, triangles);
    double *sums = PCI_SCRATCH(scratch, double, triangles);
    if (scratch->failed) {
        return false;
    }
    pci_singletons(piece, triangles);
    for (size_t e = 0; e < topology->edge_count; ++e) {
        const size_t first = topology->edge_triangle_offsets[e];
        const uint32_t *sides = &topology->edge_triangles[first];
        if (topology->edge_triangle_offsets[e + 1] - first == 2 &&
            c->covered[sides[0]] == c->covered[sides[1]]) {
            pci_unite(piece, sides[0], sides[1]);
        }
    }
    for (uint32_t t = 0; t < triangles; ++t) {
        sums[pci_find_root(piece, t)] += pci_triangle_area(c->mesh, t);
    }
    for (uint32_t t = 0; t < triangles; ++t) {
        if (c->covered[t] == covered &&
            sums[pci_find_root(piece, t)] < small_share * areas[c->component[t]]) {
            c->covered[t] = !covered;
        }
    }
    return true;
}

// Marks what no other part covers. False: out of memory.
static bool mark_uncovered(pci_scratch *scratch, const covering *c, const pci_topology *topology,
                           size_t component_count, uint8_t *keep) {
    const size_t triangles = c->mesh->triangle_count;
    double *areas = PCI_SCRATCH(scratch, double, component_count);
    for (size_t t = 0; t < triangles && areas != NULL; ++t) {
        areas[c->component[t]] += pci_triangle_area(c->mesh, t);
    }
    if (areas == NULL || !turn_small_pieces(scratch, c, topology, areas, true) ||
        !turn_small_pieces(scratch, c, topology, areas, false)) {
        return false;
    }
    for (size_t t = 0; t < triangles; ++t) {
        keep[t] = !c->covered[t];
    }
    return true;
}

// ---- seams --------------------------------------------------------------------------------------

typedef struct loop {
    uint32_t component;
    size_t count;
    const uint32_t *vertices; // in the direction of their triangles
    double *points;           // #vertices by 3
    double longest;           // edge
    pci_knn nearest;
    bool sewn;
} loop;

static bool list_loops(pci_scratch *scratch, const pc_mesh *mesh, loop **loops, size_t *count) {
    pci_topology topology;
    size_t *offsets = NULL;
    uint32_t *vertices = NULL;
    uint32_t *component = PCI_SCRATCH(scratch, uint32_t, mesh->triangle_count);
    if (component == NULL || !pci_topology_build_watched(scratch, mesh, &topology) ||
        !pci_boundary_loops(scratch, mesh, &topology, count, &offsets, &vertices)) {
        return false;
    }
    (void)pci_triangle_components(scratch, mesh, &topology, component);
    *loops = PCI_SCRATCH(scratch, loop, *count);
    for (size_t i = 0; i < *count && !scratch->failed; ++i) {
        loop *l = &(*loops)[i];
        l->vertices = &vertices[offsets[i]];
        l->count = offsets[i + 1] - offsets[i];
        l->component =
            component[topology.vertex_triangles[topology.vertex_triangle_offsets[l->vertices[0]]]];
        l->points = PCI_SCRATCH(scratch, double, 3 * l->count);
        for (size_t k = 0; k < l->count && l->points != NULL; ++k) {
            const double *from = &mesh->positions[3 * (size_t)l->vertices[k]];
            const double *to = &mesh->positions[3 * (size_t)l->vertices[(k + 1) % l->count]];
            memcpy(&l->points[3 * k], from, 3 * sizeof(*from));
            l->longest = fmax(l->longest, sqrt(pci_squared_distance(from, to)));
        }
        if (l->points == NULL || !pci_knn_build(scratch, l->count, l->points, &l->nearest)) {
            return false;
        }
    }
    return !scratch->failed;
}

// The largest distance between a vertex of one loop and the nearest vertex of the other.
static double distance_from(const loop *a, const loop *b) {
    double largest = 0.0;
    for (size_t i = 0; i < a->count; ++i) {
        uint32_t nearest = 0;
        double squared = 0.0;
        pci_knn_query(&b->nearest, &a->points[3 * i], 1, PC_INVALID_INDEX, &nearest, &squared);
        largest = fmax(largest, sqrt(squared));
    }
    return largest;
}

// Rungs between two loops: around `a` once, and along `steps` edges of `b`, against the direction
// of its triangles.
typedef struct seam {
    const loop *a, *b;
    size_t first_a, first_b, steps;
} seam;

static size_t along(const seam *s, size_t i) { return (s->first_a + i) % s->a->count; }
static size_t against(const seam *s, size_t j) {
    return (s->first_b + s->b->count - j % s->b->count) % s->b->count;
}

static double rung(const seam *s, size_t i, size_t j) {
    return sqrt(
        pci_squared_distance(&s->a->points[3 * along(s, i)], &s->b->points[3 * against(s, j)]));
}

// The longest run of vertices of `b` within `limit` of `a`, if it nearly closes: the seam runs back
// along it, from the vertex of `a` between its ends.
static bool find_run(seam *s, double limit, double widest_gap) {
    const loop *a = s->a, *b = s->b;
    size_t run = 0, best = 0, start = 0;
    for (size_t k = 0; k < 2 * b->count && run < b->count; ++k) {
        const double *point = &b->points[3 * (k % b->count)];
        run = pci_knn_within(&a->nearest, point, limit, NULL) ? run + 1 : 0;
        if (run > best) {
            best = run;
            s->first_b = k % b->count;
        }
    }
    if (best < 3 || best >= b->count) {
        return false;
    }
    s->steps = best - 1;
    double nearest = HUGE_VAL;
    for (size_t i = 0; i < a->count; ++i) {
        s->first_a = i;
        const double sum = rung(s, 0, 0) + rung(s, 0, s->steps);
        if (sum < nearest) {
            nearest = sum;
            start = i;
        }
    }
    s->first_a = start;
    return sqrt(pci_squared_distance(&b->points[3 * against(s, 0)],
                                     &b->points[3 * against(s, s->steps)])) <= widest_gap;
}

// Finds where two loops run along each other: all the way around both, or around `a` along a part
// of `b` that nearly closes, as the hem of a shirt that is buttoned up. False: they do not.
static bool find_seam(const loop *a, const loop *b, double reach, seam *s) {
    *s = (seam){.a = a, .b = b, .steps = b->count};
    const double apart = distance_from(a, b);
    if (apart > reach + b->longest) {
        return false;
    }
    if (distance_from(b, a) > reach + a->longest) {
        return find_run(s, apart + 0.5 * a->longest, 0.5 * reach);
    }
    uint32_t nearest = 0;
    double squared = 0.0;
    pci_knn_query(&b->nearest, a->points, 1, PC_INVALID_INDEX, &nearest, &squared);
    s->first_b = nearest;
    return true;
}

// Appends the triangles between the shortest rungs. False: out of memory.
static bool close_seam(pci_scratch *scratch, const seam *s, uint32_t *triangles, size_t *count) {
    const size_t n = s->a->count, m = s->steps;
    uint8_t *turns = PCI_SCRATCH(scratch, uint8_t, (n + 1) * (m + 1)); // 1: the last step was on a
    double *costs = PCI_SCRATCH(scratch, double, m + 1);               // to rung (i, j)
    if (scratch->failed) {
        return false;
    }
    for (size_t i = 0; i <= n; ++i) {
        for (size_t j = 0; j <= m; ++j) {
            const double from_a = i > 0 ? costs[j] : HUGE_VAL;
            const double from_b = j > 0 ? costs[j - 1] : HUGE_VAL;
            turns[i * (m + 1) + j] = i > 0 && from_a <= from_b;
            costs[j] = (i + j > 0 ? fmin(from_a, from_b) : 0.0) + rung(s, i, j);
        }
    }
    for (size_t i = n, j = m; i + j > 0;) {
        uint32_t *corner = &triangles[3 * (*count)++];
        const uint32_t a = s->a->vertices[along(s, i)], b = s->b->vertices[against(s, j)];
        if (turns[i * (m + 1) + j]) {
            corner[0] = a, corner[1] = s->a->vertices[along(s, --i)], corner[2] = b;
        } else {
            corner[0] = s->b->vertices[against(s, --j)], corner[1] = b, corner[2] = a;
        }
    }
    if (m < s->b->count) {
        uint32_t *corner = &triangles[3 * (*count)++];
        corner[0] = s->a->vertices[along(s, 0)];
        corner[1] = s->b->vertices[against(s, m)], corner[2] = s->b->vertices[against(s, 0)];
    }
    return true;
}

// Sews loops of different components that follow each other. `mesh` gets their triangles.
static bool sew_loops(pci_scratch *scratch, double reach, pc_mesh *mesh, bool *sewn) {
    loop *loops = NULL;
    size_t count = 0, most = mesh->triangle_count, triangles = mesh->triangle_count;
    if (!list_loops(scratch, mesh, &loops, &count)) {
        return false;
    }
    for (size_t i = 0; i < count; ++i) {
        most += loops[i].count + 1;
    }
    uint32_t *corners = PCI_SCRATCH(scratch, uint32_t, 3 * most);
    if (corners == NULL) {
        return false;
    }
    memcpy(corners, mesh->triangles, 3 * triangles * sizeof(*corners));
    for (size_t i = 0; i < count; ++i) {
        for (size_t j = 0; j < count && !loops[i].sewn; ++j) {
            seam s;
            if (loops[j].sewn || loops[i].component == loops[j].component ||
                (loops[i].count + 1) * (loops[j].count + 1) > most_rungs ||
                !find_seam(&loops[i], &loops[j], reach, &s)) {
                continue;
            }
            if (!pci_keep_going(scratch->context) ||
                !close_seam(scratch, &s, corners, &triangles)) {
                return false;
            }
            loops[i].sewn = loops[j].sewn = true;
        }
    }
    *sewn = triangles > mesh->triangle_count;
    const pc_mesh sum = {mesh->vertex_count, mesh->positions, triangles, corners};
    pci_repair_counts counts;
    pc_mesh result = {0};
    if (*sewn && !pci_mesh_repair(scratch, &sum, NULL, &result, &counts)) {
        return false;
    }
    if (*sewn) {
        pc_mesh_free(scratch->context, mesh);
        *mesh = result;
    }
    return true;
}

pc_status pci_sew_parts(pci_scratch *scratch, const char *stage, double reach, pc_mesh *mesh,
                        bool *sewn) {
    pc_context *context = scratch->context;
    pci_topology topology;
    pci_bvh *bvh = NULL;
    *sewn = false;
    uint32_t *component = PCI_SCRATCH(scratch, uint32_t, mesh->triangle_count);
    uint8_t *covered = PCI_SCRATCH(scratch, uint8_t, mesh->triangle_count);
    if (scratch->failed || !pci_topology_build_edges(scratch, mesh, &topology)) {
        return pci_fail_memory(context, stage);
    }
    const size_t parts = pci_triangle_components(scratch, mesh, &topology, component);
    if (parts < 2) {
        return scratch->failed ? pci_fail_memory(context, stage) : PC_OK;
    }
    pc_status status = pci_bvh_create(context, stage, mesh, &bvh);
    if (status != PC_OK) {
        return status;
    }
    covering c = {mesh, bvh, component, reach, covered};
    const bool done =
        pci_parallel_while_wanted(context, mesh->triangle_count, grain, find_covered, &c);
    pci_bvh_destroy(context, bvh);
    uint8_t *keep = PCI_SCRATCH(scratch, uint8_t, mesh->triangle_count);
    if (!done || keep == NULL || !mark_uncovered(scratch, &c, &topology, parts, keep)) {
        return pci_fail_memory(context, stage);
    }
    if (memchr(keep, 0, mesh->triangle_count) == NULL ||
        memchr(keep, 1, mesh->triangle_count) == NULL) {
        return PC_OK;
    }
    pci_repair_counts counts;
    pc_mesh kept = {0};
    if (!pci_mesh_repair(scratch, mesh, keep, &kept, &counts) ||
        !sew_loops(scratch, reach, &kept, sewn)) {
        status = pci_fail_memory(context, stage);
    }
    *sewn = *sewn && status == PC_OK;
    if (*sewn) {
        pc_mesh_free(context, mesh);
        *mesh = kept;
    } else {
        pc_mesh_free(context, &kept);
    }
    return status;
}
