#include "geometry/triangle_distance.h"

// The point of a triangle that is closest to the origin.
typedef struct closest_spot {
    double distance2;
    double barycentric[3];
} closest_spot;

// Takes the closest point of the edge from the corner `first` at `from` to the next one at `to`
// where that is closer. Corners are as far away whatever edge they are seen from.
static inline void compare_edge(const double from[3], const double to[3], const double edge[3],
                                size_t first, closest_spot *best) {
    const double along = -pci_dot(from, edge), length2 = pci_dot(edge, edge);
    double fraction = 0.0, distance2 = 0.0;
    if (!(along > 0.0)) {
        distance2 = pci_dot(from, from);
    } else if (!(along < length2)) {
        fraction = 1.0;
        distance2 = pci_dot(to, to);
    } else {
        fraction = along / length2;
        const double r[3] = {from[0] + fraction * edge[0], from[1] + fraction * edge[1],
                             from[2] + fraction * edge[2]};
        distance2 = pci_dot(r, r);
    }
    if (distance2 < best->distance2) {
        best->distance2 = distance2;
        best->barycentric[first] = 1.0 - fraction;
        best->barycentric[(first + 1) % 3] = fraction;
        best->barycentric[(first + 2) % 3] = 0.0;
    }
}

double pci_triangle_squared_distance_generic(const double point[3], const double a[3],
                                             const double b[3], const double c[3],
                                             double barycentric[3]) {
    double pa[3], pb[3], pc[3], ab[3], bc[3], ca[3], normal[3], t[3], w[3];
    pci_sub(a, point, pa);
    pci_sub(b, point, pb);
    pci_sub(c, point, pc);
    pci_sub(b, a, ab);
    pci_sub(c, b, bc);
    pci_sub(a, c, ca);
    pci_cross(ab, bc, normal);
    pci_cross(pb, bc, t);
    w[0] = pci_dot(t, normal);
    pci_cross(pc, ca, t);
    w[1] = pci_dot(t, normal);
    pci_cross(pa, ab, t);
    w[2] = pci_dot(t, normal);

    // The foot of the perpendicular, when it lies inside. Whatever the rounding, the weights are
    // those of a point of the triangle, and the distance is measured to that point.
    const bool sliver = !(pci_dot(normal, normal) > 1e-6 * pci_dot(ab, ab) * pci_dot(ca, ca));
    closest_spot best = {.distance2 = INFINITY};
    if (w[0] > 0.0 && w[1] > 0.0 && w[2] > 0.0) {
        const double sum = w[0] + w[1] + w[2];
        for (size_t k = 0; k < 3; ++k) {
            best.barycentric[k] = w[k] / sum;
        }
        const double u = best.barycentric[1], v = best.barycentric[2];
        const double r[3] = {pa[0] + u * ab[0] - v * ca[0], pa[1] + u * ab[1] - v * ca[1],
                             pa[2] + u * ab[2] - v * ca[2]};
        best.distance2 = pci_dot(r, r);
    }
    // Otherwise it is on an edge with the foot on its outer side; slivers, where neither the foot
    // nor its side is to be trusted, compare all edges.
    if (sliver || !(w[2] > 0.0)) {
        compare_edge(pa, pb, ab, 0, &best);
    }
    if (sliver || !(w[0] > 0.0)) {
        compare_edge(pb, pc, bc, 1, &best);
    }
    if (sliver || !(w[1] > 0.0)) {
        compare_edge(pc, pa, ca, 2, &best);
    }
    memcpy(barycentric, best.barycentric, sizeof(best.barycentric));
    return best.distance2;
}

double pci_triangle_squared_distance(const double point[3], const double a[3], const double b[3],
                                     const double c[3], double barycentric[3]) {
#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx2")) {
        return pci_triangle_squared_distance_avx2(point, a, b, c, barycentric);
    }
#endif
    return pci_triangle_squared_distance_generic(point, a, b, c, barycentric);
}
