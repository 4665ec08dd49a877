#include "stages/carve/seams.h"

// Seams of more rungs in their table are given up: no garment has such loops.
static const size_t most_rungs = (size_t)1 << 24;

bool pci_loop_begin(pci_scratch *scratch, const pc_mesh *mesh, size_t count,
                    const uint32_t *vertices, pci_loop *loop) {
    *loop = (pci_loop){.count = count, .vertices = vertices};
    loop->points = PCI_SCRATCH(scratch, double, 3 * count);
    for (size_t k = 0; k < count && loop->points != NULL; ++k) {
        const double *from = &mesh->positions[3 * (size_t)vertices[k]];
        const double *to = &mesh->positions[3 * (size_t)vertices[(k + 1) % count]];
        memcpy(&loop->points[3 * k], from, 3 * sizeof(*from));
        loop->longest = fmax(loop->longest, sqrt(pci_squared_distance(from, to)));
    }
    return loop->points != NULL && pci_knn_build(scratch, count, loop->points, &loop->nearest);
}

// The largest distance between a vertex of one loop and the nearest vertex of the other.
static double distance_from(const pci_loop *a, const pci_loop *b) {
    double largest = 0.0;
    for (size_t i = 0; i < a->count; ++i) {
        uint32_t nearest = 0;
        double squared = 0.0;
        pci_knn_query(&b->nearest, &a->points[3 * i], 1, PC_INVALID_INDEX, &nearest, &squared);
        largest = fmax(largest, sqrt(squared));
    }
    return largest;
}

static size_t along(const pci_seam *s, size_t i) { return (s->first_a + i) % s->a->count; }
static size_t against(const pci_seam *s, size_t j) {
    return (s->first_b + s->b->count - j % s->b->count) % s->b->count;
}

static double rung(const pci_seam *s, size_t i, size_t j) {
    return sqrt(
        pci_squared_distance(&s->a->points[3 * along(s, i)], &s->b->points[3 * against(s, j)]));
}

// The longest run of vertices of `b` within `limit` of `a`, if it nearly closes: the seam runs back
// along it, from the vertex of `a` between its ends.
static bool find_run(pci_seam *s, double limit, double widest_gap) {
    const pci_loop *a = s->a, *b = s->b;
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

static void edge_from(const pci_loop *loop, size_t i, double edge[3]) {
    pci_sub(&loop->points[3 * ((i + 1) % loop->count)], &loop->points[3 * i], edge);
    pci_normalize(edge);
}

// Whether loops near each other run the same way, as the upper borders of a waistband and of what
// hangs below it do: no seam lies between them.
static bool run_alike(const pci_loop *a, const pci_loop *b) {
    double sum = 0.0;
    for (size_t i = 0; i < a->count; ++i) {
        uint32_t nearest = 0;
        double squared = 0.0, ours[3], theirs[3];
        pci_knn_query(&b->nearest, &a->points[3 * i], 1, PC_INVALID_INDEX, &nearest, &squared);
        edge_from(a, i, ours);
        edge_from(b, nearest, theirs);
        sum += pci_dot(ours, theirs);
    }
    return sum > 0.0;
}

bool pci_find_seam(const pci_loop *a, const pci_loop *b, double reach, pci_seam *s) {
    *s = (pci_seam){.a = a, .b = b, .steps = b->count};
    if (a->count + 1 > most_rungs / (b->count + 1)) {
        return false;
    }
    const double apart = distance_from(a, b);
    if (apart > reach + b->longest || run_alike(a, b)) {
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

bool pci_close_seam(pci_scratch *scratch, const pci_seam *s, uint32_t *triangles, size_t *count) {
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
