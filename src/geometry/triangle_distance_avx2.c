// The arithmetic of triangle_distance.c with one corner, and the edge from it to the next corner,
// per lane; the fourth lane repeats the first one. Where that takes one way or another, both are
// gone here, which is cheaper than guessing wrong.
#include "geometry/triangle_distance.h"

typedef double lanes __attribute__((vector_size(32)));
typedef int64_t mask __attribute__((vector_size(32)));

#if defined(__clang__)
#define SHUFFLE(v, i, j, k, l) __builtin_shufflevector((v), (v), i, j, k, l)
#else
#define SHUFFLE(v, i, j, k, l) __builtin_shuffle((v), (mask){i, j, k, l})
#endif
#define NEXT(v)  SHUFFLE((v), 1, 2, 0, 1)
#define FIRST(v) SHUFFLE((v), 0, 0, 0, 0)

static inline lanes choose(mask condition, lanes yes, lanes no) {
    return (lanes)((condition & (mask)yes) | (~condition & (mask)no));
}

double pci_triangle_squared_distance_avx2(const double point[3], const double a[3],
                                          const double b[3], const double c[3],
                                          double barycentric[3]) {
    const lanes zero = {0}, one = zero + 1.0;
    const lanes x = {a[0], b[0], c[0], a[0]}, y = {a[1], b[1], c[1], a[1]};
    const lanes z = {a[2], b[2], c[2], a[2]};
    const lanes px = x - point[0], py = y - point[1], pz = z - point[2];
    const lanes ex = NEXT(x) - x, ey = NEXT(y) - y, ez = NEXT(z) - z;
    const lanes fx = NEXT(ex), fy = NEXT(ey), fz = NEXT(ez);
    const lanes nx = FIRST(ey * fz - ez * fy), ny = FIRST(ez * fx - ex * fz);
    const lanes nz = FIRST(ex * fy - ey * fx);
    // Weights of the corners opposite to the edges: of c, a, b.
    const lanes w = (py * ez - pz * ey) * nx + (pz * ex - px * ez) * ny + (px * ey - py * ex) * nz;
    const lanes length2 = ex * ex + ey * ey + ez * ez;
    const lanes normal2 = nx * nx + ny * ny + nz * nz;
    const bool sliver = !(normal2[0] > 1e-6 * length2[0] * length2[2]);

    double best = INFINITY;
    const mask inside = w > zero;
    if ((inside[0] & inside[1] & inside[2]) != 0) {
        const double sum = w[1] + w[2] + w[0];
        const double u = w[2] / sum, v = w[0] / sum;
        const double r[3] = {px[0] + u * ex[0] - v * ex[2], py[0] + u * ey[0] - v * ey[2],
                             pz[0] + u * ez[0] - v * ez[2]};
        best = pci_dot(r, r);
        barycentric[0] = w[1] / sum, barycentric[1] = u, barycentric[2] = v;
        if (!sliver) {
            return best;
        }
    }
    const lanes along = -(px * ex + py * ey + pz * ez), part = along / length2;
    const lanes rx = px + part * ex, ry = py + part * ey, rz = pz + part * ez;
    const lanes corner2 = px * px + py * py + pz * pz, foot2 = rx * rx + ry * ry + rz * rz;
    const mask after_start = along > zero, before_end = along < length2;
    const lanes fractions = choose(after_start, choose(before_end, part, one), zero);
    const lanes distances = choose(after_start, choose(before_end, foot2, NEXT(corner2)), corner2);
    const mask all = {-(int64_t)sliver, -(int64_t)sliver, -(int64_t)sliver, 0};
    const lanes compared = choose(all | ~inside, distances, zero + (double)INFINITY);
    size_t edge = 3;
    for (size_t i = 0; i < 3; ++i) {
        if (compared[i] < best) {
            best = compared[i];
            edge = i;
        }
    }
    if (edge < 3) {
        const double fraction = fractions[edge];
        barycentric[edge] = 1.0 - fraction;
        barycentric[(edge + 1) % 3] = fraction;
        barycentric[(edge + 2) % 3] = 0.0;
    }
    return best;
}
