// Branch and bound over pieces of triangles. On a piece with corners v_i and nearest triangles f_i
//   d(x) <= distance(x, f_i)                 convex in x, so its maximum is at a corner,
//   d(x) <= max_i d(v_i) + l_max / sqrt(3)   d is 1-Lipschitz,
// and the smaller bound decides whether the piece can hold the maximum. Pieces that can are cut in
// four. All pieces of one generation are treated together, so the result does not depend on the
// number of threads.
#include "geometry/hausdorff.h"

#include "geometry/topology.h"

#define RELATIVE_TOLERANCE 1e-4

typedef struct probe {
    double point[3];
    double distance;
    uint32_t nearest; // triangle of the other mesh
} probe;

typedef struct piece {
    probe corner[3];
    double bound; // no point of the piece is farther away
} piece;

typedef struct search {
    const pc_mesh *from, *to;
    const pci_bvh *bvh;
    const uint8_t *used;
    uint8_t *duplicate; // #F of `from`
    probe *vertices;    // #V of `from`
    piece *roots;       // #F of `from`
    const piece *parents;
    piece *children; // 4 per parent
} search;

static probe probe_at(const search *s, const double point[3]) {
    const pci_closest closest = pci_bvh_closest(s->bvh, point, INFINITY);
    probe result = {.distance = closest.distance, .nearest = closest.triangle};
    memcpy(result.point, point, sizeof(result.point));
    return result;
}

static double distance_to_triangle(const pc_mesh *mesh, uint32_t triangle, const double point[3]) {
    const uint32_t *corner = &mesh->triangles[3 * (size_t)triangle];
    double barycentric[3];
    return sqrt(pci_triangle_squared_distance(
        point, &mesh->positions[3 * (size_t)corner[0]], &mesh->positions[3 * (size_t)corner[1]],
        &mesh->positions[3 * (size_t)corner[2]], barycentric));
}

static double upper_bound(const search *s, const piece *p) {
    double longest = 0.0, farthest = 0.0;
    for (size_t i = 0; i < 3; ++i) {
        const double edge = pci_squared_distance(p->corner[i].point, p->corner[(i + 1) % 3].point);
        longest = fmax(longest, edge);
        farthest = fmax(farthest, p->corner[i].distance);
    }
    double bound = farthest + sqrt(longest / 3.0);
    for (size_t i = 0; i < 3; ++i) {
        const uint32_t nearest = p->corner[i].nearest;
        if (i > 0 && (nearest == p->corner[0].nearest || nearest == p->corner[i - 1].nearest)) {
            continue;
        }
        double at_corners = p->corner[i].distance;
        for (size_t j = 1; j < 3 && at_corners < bound; ++j) {
            at_corners = fmax(at_corners,
                              distance_to_triangle(s->to, nearest, p->corner[(i + j) % 3].point));
        }
        bound = fmin(bound, at_corners);
    }
    return bound;
}

static void probe_vertices(void *user, size_t begin, size_t end, uint32_t worker) {
    search *s = user;
    (void)worker;
    for (size_t v = begin; v < end; ++v) {
        if (s->used[v]) {
            s->vertices[v] = probe_at(s, &s->from->positions[3 * v]);
        }
    }
}

static void bound_roots(void *user, size_t begin, size_t end, uint32_t worker) {
    search *s = user;
    (void)worker;
    for (size_t t = begin; t < end; ++t) {
        for (size_t c = 0; c < 3; ++c) {
            s->roots[t].corner[c] = s->vertices[s->from->triangles[3 * t + c]];
        }
        s->roots[t].bound = s->duplicate[t] ? 0.0 : upper_bound(s, &s->roots[t]);
    }
}

// Cuts each parent at the midpoints of its sides.
static void split_pieces(void *user, size_t begin, size_t end, uint32_t worker) {
    search *s = user;
    (void)worker;
    for (size_t i = begin; i < end; ++i) {
        const probe *corner = s->parents[i].corner;
        probe middle[3]; // of the side opposite to the corner
        for (size_t c = 0; c < 3; ++c) {
            const double *a = corner[(c + 1) % 3].point, *b = corner[(c + 2) % 3].point;
            const double point[3] = {0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2])};
            middle[c] = probe_at(s, point);
        }
        const piece cut[4] = {{{corner[0], middle[2], middle[1]}, 0.0},
                              {{middle[2], corner[1], middle[0]}, 0.0},
                              {{middle[1], middle[0], corner[2]}, 0.0},
                              {{middle[0], middle[1], middle[2]}, 0.0}};
        for (size_t k = 0; k < 4; ++k) {
            s->children[4 * i + k] = cut[k];
            s->children[4 * i + k].bound = upper_bound(s, &cut[k]);
        }
    }
}

// Moves the pieces that may hold a point beyond `limit` to the front, in order.
static size_t keep_beyond(piece *pieces, size_t count, double limit) {
    size_t kept = 0;
    for (size_t i = 0; i < count; ++i) {
        if (pieces[i].bound > limit) {
            pieces[kept++] = pieces[i];
        }
    }
    return kept;
}

pc_status pci_directed_hausdorff(pc_context *context, const char *stage, const pc_mesh *from,
                                 const pc_mesh *to, const pci_bvh *to_bvh, double tolerance,
                                 double *distance) {
    pci_scratch scratch = pci_scratch_begin(context);
    const size_t vertex_count = from->vertex_count, triangle_count = from->triangle_count;
    pc_status status = PC_OK;
    uint8_t *used = PCI_SCRATCH(&scratch, uint8_t, vertex_count);
    search s = {.from = from, .to = to, .bvh = to_bvh, .used = used};
    s.vertices = PCI_SCRATCH(&scratch, probe, vertex_count);
    s.roots = PCI_SCRATCH(&scratch, piece, triangle_count);
    s.duplicate = PCI_SCRATCH(&scratch, uint8_t, triangle_count);
    if (scratch.failed || !pci_mark_duplicates(&scratch, from, s.duplicate)) {
        status = pci_fail_memory(context, stage);
        goto cleanup;
    }
    for (size_t i = 0; i < 3 * triangle_count; ++i) {
        used[from->triangles[i]] = 1;
    }

    // The vertices give the first lower bound, whole triangles the first upper bounds.
    pci_parallel_for(context, vertex_count, 256, probe_vertices, &s);
    double lower = 0.0;
    for (size_t v = 0; v < vertex_count; ++v) {
        lower = fmax(lower, s.vertices[v].distance);
    }
    pci_parallel_for(context, triangle_count, 256, bound_roots, &s);
    piece *parents = s.roots, *spare = NULL;
    size_t parent_capacity = triangle_count, spare_capacity = 0;
    size_t count =
        keep_beyond(parents, triangle_count, lower * (1.0 + RELATIVE_TOLERANCE) + tolerance);

    while (count > 0) {
        if (!pci_scratch_reserve(&scratch, (void **)&spare, &spare_capacity, 4 * count,
                                 sizeof(piece))) {
            status = pci_fail_memory(context, stage);
            goto cleanup;
        }
        s.parents = parents;
        s.children = spare;
        pci_parallel_for(context, count, 16, split_pieces, &s);
        for (size_t i = 0; i < 4 * count; ++i) {
            for (size_t c = 0; c < 3; ++c) {
                lower = fmax(lower, spare[i].corner[c].distance);
            }
        }
        count = keep_beyond(spare, 4 * count, lower * (1.0 + RELATIVE_TOLERANCE) + tolerance);
        piece *swap = parents;
        const size_t swap_capacity = parent_capacity;
        parents = spare, parent_capacity = spare_capacity;
        spare = swap, spare_capacity = swap_capacity;
    }
    *distance = lower;

cleanup:
    pci_scratch_end(&scratch);
    return status;
}
