// Crossing test after Moeller, "A fast triangle-triangle intersection test" (1997), in double and
// relative to the pair's own origin; pairs come from sweeps along the longest axis, one in each
// strip of the mesh.
#include "geometry/crossing.h"

#include <stdlib.h>

#define RELATIVE_ZERO 1e-12
#define PAD           1.2e-7 // 1 and less in float, rounded

// Whether all points that are not shared are clearly on the same side of a plane: most pairs need
// no more. The normal has any length.
static bool on_one_side(const double origin[3], const double points[9], unsigned shared,
                        double zero, const double normal[3]) {
    const double limit = 4.0 * zero * zero * pci_dot(normal, normal);
    double least = INFINITY, largest = -INFINITY;
    for (size_t i = 0; i < 3; ++i) {
        if ((shared >> i & 1U) == 0) {
            double offset[3];
            pci_sub(&points[3 * i], origin, offset);
            const double distance = pci_dot(normal, offset);
            least = pci_smaller(least, distance);
            largest = pci_larger(largest, distance);
        }
    }
    return (least > 0.0 && least * least > limit) || (largest < 0.0 && largest * largest > limit);
}

// Signed distances of three points from the plane of a triangle. False: the triangle has no plane,
// or the points are on one side.
static bool plane_distances(const double triangle[9], const double points[9], unsigned shared,
                            double zero, double normal[3], double distance[3]) {
    double ab[3], ac[3];
    pci_sub(&triangle[3], triangle, ab);
    pci_sub(&triangle[6], triangle, ac);
    pci_cross(ab, ac, normal);
    if (on_one_side(triangle, points, shared, zero, normal)) {
        return false;
    }
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
    return pci_smaller(pci_smaller(distance[0], distance[1]), distance[2]) < 0.0 &&
           pci_larger(pci_larger(distance[0], distance[1]), distance[2]) > 0.0;
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
            extent = pci_larger(extent, pci_larger(fabs(p[3 * i + k]), fabs(q[3 * i + k])));
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

// In the frame of the sweep, rounded outwards.
typedef struct box {
    float minimum[3], maximum[3];
    uint32_t triangle;
    uint32_t strip; // one of those that the triangle touches: slices across the second axis
} box;

// Takes the mesh to lengths between 0 and 1, its longest side along the first axis.
typedef struct sweep_frame {
    size_t axes[3];
    double origin[3], scale;
} sweep_frame;

typedef struct sweep {
    const pc_mesh *mesh;
    const box *boxes; // a triangle once per strip; ascending by strip, then along the first axis
    size_t box_count;
    double width;     // of a strip
    uint64_t *counts; // per piece, then those before it; one more than there are pieces
    size_t grain;
    uint32_t *pairs; // 2 per crossing, piece after piece; NULL: only count
} sweep;

double pci_pair_crossing_length(const pc_mesh *mesh, uint32_t first, uint32_t second) {
    const uint32_t *corner = &mesh->triangles[3 * (size_t)first];
    const uint32_t *other = &mesh->triangles[3 * (size_t)second];
    double a[9], b[9];
    unsigned shared_a = 0, shared_b = 0, shared = 0;
    for (unsigned k = 0; k < 9; ++k) {
        if (corner[k / 3] == other[k % 3]) {
            shared_a |= 1U << k / 3;
            shared_b |= 1U << k % 3;
            ++shared;
        }
    }
    if (shared >= 2) {
        return 0.0;
    }
    for (size_t i = 0; i < 3; ++i) {
        memcpy(&a[3 * i], &mesh->positions[3 * (size_t)corner[i]], 3 * sizeof(*a));
        memcpy(&b[3 * i], &mesh->positions[3 * (size_t)other[i]], 3 * sizeof(*b));
    }
    return crossing_length(a, shared_a, b, shared_b);
}

bool pci_pair_crosses(const pc_mesh *mesh, uint32_t first, uint32_t second) {
    return pci_pair_crossing_length(mesh, first, second) > 0.0;
}

static uint32_t strip_at(const sweep *s, float position) {
    return (uint32_t)((double)position / s->width);
}

// Whether two boxes of one strip, which overlap along the first axis, meet and no earlier strip has
// both.
static bool boxes_meet(const sweep *s, const box *a, const box *b) {
    return a->minimum[1] <= b->maximum[1] && b->minimum[1] <= a->maximum[1] &&
           a->minimum[2] <= b->maximum[2] && b->minimum[2] <= a->maximum[2] &&
           strip_at(s, a->minimum[1] > b->minimum[1] ? a->minimum[1] : b->minimum[1]) == a->strip;
}

static void sweep_boxes(void *user, size_t begin, size_t end, uint32_t worker) {
    sweep *s = user;
    (void)worker;
    const uint64_t *before = &s->counts[begin / s->grain];
    uint64_t count = 0;
    if (s->pairs != NULL && before[1] == before[0]) {
        return;
    }
    uint32_t *pair = s->pairs != NULL ? &s->pairs[2 * before[0]] : NULL;
    for (size_t i = begin; i < end; ++i) {
        const box *a = &s->boxes[i];
        for (size_t j = i + 1; j < s->box_count && s->boxes[j].strip == a->strip &&
                               s->boxes[j].minimum[0] <= a->maximum[0];
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

static int compare_boxes(const void *a, const void *b) {
    const box *p = a, *q = b;
    if (p->strip != q->strip) {
        return p->strip < q->strip ? -1 : 1;
    }
    const float x = p->minimum[0], y = q->minimum[0];
    return x < y || (x == y && p->triangle < q->triangle) ? -1 : 1;
}

static box triangle_box(const pc_mesh *mesh, const sweep_frame *frame, size_t t) {
    box result = {.triangle = (uint32_t)t};
    for (size_t k = 0; k < 3; ++k) {
        const double *along = &mesh->positions[frame->axes[k]];
        const double a = along[3 * (size_t)mesh->triangles[3 * t]];
        const double b = along[3 * (size_t)mesh->triangles[3 * t + 1]];
        const double c = along[3 * (size_t)mesh->triangles[3 * t + 2]];
        const double least = pci_smaller(pci_smaller(a, b), c),
                     largest = pci_larger(pci_larger(a, b), c);
        result.minimum[k] = (float)pci_larger(frame->scale * (least - frame->origin[k]) - PAD, 0.0);
        result.maximum[k] = (float)(frame->scale * (largest - frame->origin[k]) + PAD);
    }
    return result;
}

static sweep_frame find_frame(const pc_mesh *mesh) {
    sweep_frame frame = {.axes = {0, 1, 2}};
    double minimum[3], size[3];
    for (size_t k = 0; k < 3; ++k) {
        double maximum = -INFINITY;
        minimum[k] = INFINITY;
        for (size_t i = 0; i < 3 * mesh->triangle_count; ++i) {
            const double at = mesh->positions[3 * (size_t)mesh->triangles[i] + k];
            minimum[k] = pci_smaller(minimum[k], at);
            maximum = pci_larger(maximum, at);
        }
        size[k] = maximum - minimum[k];
    }
    for (size_t i = 0; i < 3; ++i) { // the longest first
        const size_t low = i == 1 ? 1 : 0, high = low + 1;
        if (size[frame.axes[high]] > size[frame.axes[low]]) {
            const size_t swapped = frame.axes[low];
            frame.axes[low] = frame.axes[high];
            frame.axes[high] = swapped;
        }
    }
    for (size_t k = 0; k < 3; ++k) {
        frame.origin[k] = minimum[frame.axes[k]];
    }
    const double longest = size[frame.axes[0]];
    frame.scale = longest > 0.0 && isfinite(1.0 / longest) ? 1.0 / longest : 0.0;
    return frame;
}

// Sorts the triangles into strips twice as wide as a box is on average, so that they are about
// twice as many at most.
static bool sort_boxes(pci_scratch *scratch, sweep *s) {
    const pc_mesh *mesh = s->mesh;
    const sweep_frame frame = find_frame(mesh);
    double wide = 0.0;
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        const box b = triangle_box(mesh, &frame, t);
        wide += (double)(b.maximum[1] - b.minimum[1]);
    }
    s->width = fmax(2.0 * wide / (double)mesh->triangle_count, 1.0 / (1 << 20));
    s->box_count = 0;
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        const box b = triangle_box(mesh, &frame, t);
        s->box_count += 1 + strip_at(s, b.maximum[1]) - strip_at(s, b.minimum[1]);
    }
    box *boxes = PCI_SCRATCH(scratch, box, s->box_count);
    if (boxes == NULL) {
        return false;
    }
    size_t count = 0;
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        box b = triangle_box(mesh, &frame, t);
        const uint32_t last = strip_at(s, b.maximum[1]);
        for (b.strip = strip_at(s, b.minimum[1]); b.strip <= last; ++b.strip) {
            boxes[count++] = b;
        }
    }
    qsort(boxes, count, sizeof(*boxes), compare_boxes);
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
    s.counts = PCI_SCRATCH(scratch, uint64_t, pieces + 1);
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
    s.counts[pieces] = total;
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
