// Crossing test after Moeller, "A fast triangle-triangle intersection test" (1997), in double and
// relative to the pair's own origin; pairs come from sweeps along the longest axis, one in each
// strip of the mesh.
#include "geometry/crossing.h"

#include <stdlib.h>

#define RELATIVE_ZERO 1e-12

// Signed distances of three points from the plane of a triangle. False: the triangle has no plane.
static bool plane_distances(const double triangle[9], const double points[9], unsigned shared,
                            double zero, double normal[3], double distance[3]) {
    double ab[3], ac[3];
    pci_sub(&triangle[3], triangle, ab);
    pci_sub(&triangle[6], triangle, ac);
    pci_cross(ab, ac, normal);
    // An area below that of a needle of width `zero` has no direction.
    if (pci_norm(normal) <= zero * sqrt(fmax(pci_dot(ab, ab), pci_dot(ac, ac))) ||
        !pci_normalize(normal)) {
        return false;
    }
    for (size_t i = 0; i < 3; ++i) {
        double offset[3];
        pci_sub(&points[3 * i], triangle, offset);
        distance[i] = pci_dot(normal, offset);
        if (shared >> i & 1U || fabs(distance[i]) <= zero) {
            distance[i] = 0.0;
        }
    }
    return true;
}

static bool on_both_sides(const double distance[3]) {
    return fmin(fmin(distance[0], distance[1]), distance[2]) < 0.0 &&
           fmax(fmax(distance[0], distance[1]), distance[2]) > 0.0;
}

// The stretch of the line `direction` that lies in a triangle with corners on both sides.
static void stretch(const double triangle[9], const double distance[3], const double direction[3],
                    double interval[2]) {
    interval[0] = INFINITY, interval[1] = -INFINITY;
    for (size_t i = 0; i < 3; ++i) {
        const size_t j = (i + 1) % 3;
        const double at_i = pci_dot(direction, &triangle[3 * i]);
        const double at_j = pci_dot(direction, &triangle[3 * j]);
        double at = at_i;
        if (distance[i] * distance[j] < 0.0) {
            at += (at_j - at_i) * (distance[i] / (distance[i] - distance[j]));
        } else if (distance[i] != 0.0) {
            continue;
        }
        interval[0] = fmin(interval[0], at);
        interval[1] = fmax(interval[1], at);
    }
}

// Bit i of `shared_a` marks corner i of `a` as a corner of `b` too, and the same for `shared_b`:
// such a corner is exactly on the other plane.
static double crossing_length(const double a[9], unsigned shared_a, const double b[9],
                              unsigned shared_b) {
    // Coordinates relative to a corner, so that the position in space costs no digits.
    double p[9], q[9], extent = 0.0;
    for (size_t i = 0; i < 3; ++i) {
        pci_sub(&a[3 * i], a, &p[3 * i]);
        pci_sub(&b[3 * i], a, &q[3 * i]);
        for (size_t k = 0; k < 3; ++k) {
            extent = fmax(extent, fmax(fabs(p[3 * i + k]), fabs(q[3 * i + k])));
        }
    }
    const double zero = RELATIVE_ZERO * extent;
    double normal_p[3], normal_q[3], distance_p[3], distance_q[3];
    if (!plane_distances(q, p, shared_a, zero, normal_q, distance_p) ||
        !on_both_sides(distance_p) ||
        !plane_distances(p, q, shared_b, zero, normal_p, distance_q) ||
        !on_both_sides(distance_q)) {
        return 0.0;
    }
    double direction[3], interval_p[2], interval_q[2];
    pci_cross(normal_p, normal_q, direction);
    if (!pci_normalize(direction)) {
        return 0.0;
    }
    stretch(p, distance_p, direction, interval_p);
    stretch(q, distance_q, direction, interval_q);
    const double length = fmin(interval_p[1], interval_q[1]) - fmax(interval_p[0], interval_q[0]);
    return length > zero ? length : 0.0;
}

typedef struct box {
    double minimum[3], maximum[3];
    uint32_t triangle;
    uint32_t strip; // one of those that the triangle touches
} box;

// Slices of equal width across the second axis.
typedef struct strips {
    size_t axis;
    double origin, width;
} strips;

typedef struct sweep {
    const pc_mesh *mesh;
    const box *boxes; // a triangle once per strip; ascending by strip, then along `axis`
    size_t box_count;
    size_t axis;
    strips strips;
    uint64_t *counts; // per piece
    size_t grain;
    uint32_t *pairs; // 2 per crossing, piece after piece; NULL: only count
} sweep;

double pci_pair_crossing_length(const pc_mesh *mesh, uint32_t first, uint32_t second) {
    double a[9], b[9];
    unsigned shared_a = 0, shared_b = 0, shared = 0;
    for (size_t i = 0; i < 3; ++i) {
        const uint32_t u = mesh->triangles[3 * (size_t)first + i];
        const uint32_t v = mesh->triangles[3 * (size_t)second + i];
        memcpy(&a[3 * i], &mesh->positions[3 * (size_t)u], 3 * sizeof(*a));
        memcpy(&b[3 * i], &mesh->positions[3 * (size_t)v], 3 * sizeof(*b));
        for (size_t j = 0; j < 3; ++j) {
            if (mesh->triangles[3 * (size_t)second + j] == u) {
                shared_a |= 1U << i;
                shared_b |= 1U << j;
                ++shared;
            }
        }
    }
    return shared < 2 ? crossing_length(a, shared_a, b, shared_b) : 0.0;
}

bool pci_pair_crosses(const pc_mesh *mesh, uint32_t first, uint32_t second) {
    return pci_pair_crossing_length(mesh, first, second) > 0.0;
}

static uint32_t strip_at(const strips *s, double position) {
    return (uint32_t)((position - s->origin) / s->width);
}

// Whether two boxes of one strip overlap, and no earlier strip has both.
static bool boxes_meet(const sweep *s, const box *a, const box *b) {
    const size_t y = s->strips.axis, z = 3 - s->axis - y;
    return a->minimum[y] <= b->maximum[y] && b->minimum[y] <= a->maximum[y] &&
           a->minimum[z] <= b->maximum[z] && b->minimum[z] <= a->maximum[z] &&
           strip_at(&s->strips, fmax(a->minimum[y], b->minimum[y])) == a->strip;
}

static void sweep_boxes(void *user, size_t begin, size_t end, uint32_t worker) {
    sweep *s = user;
    (void)worker;
    const size_t x = s->axis;
    uint64_t count = 0;
    // With pairs to write, counts hold where the piece begins.
    uint32_t *pair = s->pairs != NULL ? &s->pairs[2 * s->counts[begin / s->grain]] : NULL;
    for (size_t i = begin; i < end; ++i) {
        const box *a = &s->boxes[i];
        for (size_t j = i + 1; j < s->box_count && s->boxes[j].strip == a->strip &&
                               s->boxes[j].minimum[x] <= a->maximum[x];
             ++j) {
            const box *b = &s->boxes[j];
            if (boxes_meet(s, a, b) && pci_pair_crosses(s->mesh, a->triangle, b->triangle)) {
                ++count;
                if (pair != NULL) {
                    *pair++ = a->triangle;
                    *pair++ = b->triangle;
                }
            }
        }
    }
    if (pair == NULL) {
        s->counts[begin / s->grain] = count;
    }
}

#define COMPARE_BOXES(name, axis)                                                                  \
    static int name(const void *a, const void *b) {                                                \
        const box *p = a, *q = b;                                                                  \
        const double x = p->minimum[axis], y = q->minimum[axis];                                   \
        if (p->strip != q->strip) {                                                                \
            return p->strip < q->strip ? -1 : 1;                                                   \
        }                                                                                          \
        return x < y || (x == y && p->triangle < q->triangle) ? -1 : 1;                            \
    }
COMPARE_BOXES(compare_x, 0)
COMPARE_BOXES(compare_y, 1)
COMPARE_BOXES(compare_z, 2)

static box triangle_box(const pc_mesh *mesh, size_t t) {
    box result = {.triangle = (uint32_t)t};
    for (size_t k = 0; k < 3; ++k) {
        const double x = mesh->positions[3 * (size_t)mesh->triangles[3 * t] + k];
        const double y = mesh->positions[3 * (size_t)mesh->triangles[3 * t + 1] + k];
        const double z = mesh->positions[3 * (size_t)mesh->triangles[3 * t + 2] + k];
        result.minimum[k] = fmin(fmin(x, y), z);
        result.maximum[k] = fmax(fmax(x, y), z);
    }
    return result;
}

// Sorts the triangles into strips twice as wide as a box is on average, so that they are about
// twice as many at most.
static bool sort_boxes(pci_scratch *scratch, sweep *s) {
    static int (*const compare[3])(const void *, const void *) = {compare_x, compare_y, compare_z};
    const pc_mesh *mesh = s->mesh;
    double minimum[3], maximum[3], mean[3] = {0.0};
    for (size_t k = 0; k < 3; ++k) {
        minimum[k] = INFINITY, maximum[k] = -INFINITY;
    }
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        const box b = triangle_box(mesh, t);
        for (size_t k = 0; k < 3; ++k) {
            minimum[k] = fmin(minimum[k], b.minimum[k]);
            maximum[k] = fmax(maximum[k], b.maximum[k]);
            mean[k] += (b.maximum[k] - b.minimum[k]) / (double)mesh->triangle_count;
        }
    }
    size_t axes[3] = {0, 1, 2}; // longest first
    for (size_t i = 0; i < 3; ++i) {
        const size_t low = i == 1 ? 1 : 0, high = low + 1;
        if (maximum[axes[high]] - minimum[axes[high]] > maximum[axes[low]] - minimum[axes[low]]) {
            const size_t swapped = axes[low];
            axes[low] = axes[high];
            axes[high] = swapped;
        }
    }
    const size_t y = axes[1];
    const double width = fmax(2.0 * mean[y], (maximum[y] - minimum[y]) / (1 << 20));
    s->axis = axes[0];
    s->strips = (strips){y, minimum[y], width > 0.0 ? width : 1.0};
    s->box_count = 0;
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        const box b = triangle_box(mesh, t);
        s->box_count += 1 + strip_at(&s->strips, b.maximum[y]) - strip_at(&s->strips, b.minimum[y]);
    }
    box *boxes = PCI_SCRATCH(scratch, box, s->box_count);
    if (boxes == NULL) {
        return false;
    }
    size_t count = 0;
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        box b = triangle_box(mesh, t);
        const uint32_t last = strip_at(&s->strips, b.maximum[y]);
        for (b.strip = strip_at(&s->strips, b.minimum[y]); b.strip <= last; ++b.strip) {
            boxes[count++] = b;
        }
    }
    qsort(boxes, count, sizeof(*boxes), compare[s->axis]);
    s->boxes = boxes;
    return true;
}

bool pci_list_self_intersections(pci_scratch *scratch, const pc_mesh *mesh, uint32_t **pairs,
                                 size_t *count) {
    sweep s = {.mesh = mesh, .grain = 128};
    *count = 0;
    if (mesh->triangle_count == 0) {
        return true;
    }
    if (!sort_boxes(scratch, &s)) {
        return false;
    }
    const size_t pieces = (s.box_count + s.grain - 1) / s.grain;
    s.counts = PCI_SCRATCH(scratch, uint64_t, pieces);
    if (s.counts == NULL) {
        return false;
    }
    pci_parallel_for(scratch->context, s.box_count, s.grain, sweep_boxes, &s);
    uint64_t total = 0;
    for (size_t i = 0; i < pieces; ++i) {
        const uint64_t before = total;
        total += s.counts[i];
        s.counts[i] = before;
    }
    *count = (size_t)total;
    if (pairs != NULL) {
        *pairs = s.pairs = PCI_SCRATCH(scratch, uint32_t, 2 * total);
        if (s.pairs == NULL) {
            return false;
        }
        pci_parallel_for(scratch->context, total > 0 ? s.box_count : 0, s.grain, sweep_boxes, &s);
    }
    return true;
}

pc_status pci_count_self_intersections(pc_context *context, const char *stage, const pc_mesh *mesh,
                                       uint64_t *count) {
    pci_scratch scratch = pci_scratch_begin(context);
    size_t found = 0;
    const bool done = pci_list_self_intersections(&scratch, mesh, NULL, &found);
    pci_scratch_end(&scratch);
    *count = found;
    return done ? PC_OK : pci_fail_memory(context, stage);
}
