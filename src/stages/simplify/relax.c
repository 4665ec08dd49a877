#include "stages/simplify/relax.h"

#include "geometry/triangle_distance.h"

// Quality 2 sqrt(3) |area vector| / sum of squared edge lengths: 1 for an equilateral triangle, 0
// for a degenerate one, negative where the triangle turns its back to the fine surface.
static double triangle_quality(const double *a, const double *b, const double *c,
                               const double facing[3]) {
    double ab[3], ac[3], bc[3], normal[3];
    pci_sub(b, a, ab);
    pci_sub(c, a, ac);
    pci_sub(c, b, bc);
    pci_cross(ab, ac, normal);
    const double squares = pci_dot(ab, ab) + pci_dot(ac, ac) + pci_dot(bc, bc);
    if (!(squares > 0.0)) {
        return 0.0;
    }
    const double quality = 2.0 * sqrt(3.0) * pci_norm(normal) / squares;
    return pci_dot(normal, facing) < 0.0 ? -quality : quality;
}

static const double *coarse_point(const pci_relaxation *r, uint32_t v) {
    return &r->coarse->positions[3 * (size_t)v];
}

void pci_relax_facing(const pci_relaxation *r, uint32_t a, uint32_t b, uint32_t c,
                      double facing[3]) {
    for (size_t k = 0; k < 3; ++k) {
        facing[k] = r->fine_normals[3 * (size_t)r->feet[a] + k] +
                    r->fine_normals[3 * (size_t)r->feet[b] + k] +
                    r->fine_normals[3 * (size_t)r->feet[c] + k];
    }
}

// Quality of the triangle of three coarse vertices, judged by the fine normals at their feet.
static double corner_quality(const pci_relaxation *r, uint32_t a, uint32_t b, uint32_t c) {
    double facing[3];
    pci_relax_facing(r, a, b, c, facing);
    return triangle_quality(coarse_point(r, a), coarse_point(r, b), coarse_point(r, c), facing);
}

double pci_relax_quality(const pci_relaxation *r, uint32_t v) {
    double worst = INFINITY;
    PCI_FOR_OUTGOING(r->coarse, v, h) {
        worst = fmin(worst, corner_quality(r, v, pci_target(r->coarse, h),
                                           r->coarse->corners[pci_previous(h)]));
    }
    return worst;
}

double pci_least_angle(const double *a, const double *b, const double *c) {
    const double squares[3] = {pci_squared_distance(b, c), pci_squared_distance(c, a),
                               pci_squared_distance(a, b)};
    double normal[3];
    pci_normal_of(a, b, c, normal);
    const double doubled = pci_norm(normal);
    const double shortest = fmin(fmin(squares[0], squares[1]), squares[2]);
    if (!(doubled > 0.0)) {
        return 0.0;
    }
    return atan2(2.0 * doubled, squares[0] + squares[1] + squares[2] - 2.0 * shortest) *
           57.295779513082320877;
}

// ---- walking on the fine mesh -----------------------------------------------------------------

// Nearest point of the segment from fine vertex a to b.
static double segment_point(const pci_halfedge *fine, uint32_t a, uint32_t b,
                            const double target[3], double point[3]) {
    const double *pa = &fine->positions[3 * (size_t)a], *pb = &fine->positions[3 * (size_t)b];
    double ab[3], ap[3];
    pci_sub(pb, pa, ab);
    pci_sub(target, pa, ap);
    const double squared = pci_dot(ab, ab);
    const double share = squared > 0.0 ? fmin(fmax(pci_dot(ap, ab) / squared, 0.0), 1.0) : 0.0;
    for (size_t k = 0; k < 3; ++k) {
        point[k] = pa[k] + share * ab[k];
    }
    return pci_squared_distance(point, target);
}

// Walks to a vertex none of whose neighbours is nearer to the target.
static uint32_t walk(const pci_relaxation *r, uint32_t from, const double target[3], bool border) {
    const double *positions = r->fine->positions;
    double best = pci_squared_distance(&positions[3 * (size_t)from], target);
    for (bool moved = true; moved;) {
        moved = false;
        const size_t begin = r->fans->offsets[from], end = r->fans->offsets[from + 1];
        // Along the border only the first and the last neighbour count.
        const size_t step = border ? end - begin - 1 : 1;
        for (size_t k = begin; k < end; k += step) {
            const uint32_t to = r->fans->ends[k];
            const double distance = pci_squared_distance(&positions[3 * (size_t)to], target);
            if (distance < best) {
                best = distance;
                from = to;
                moved = true;
            }
        }
    }
    return from;
}

// The point around fine vertex `foot` nearest to the target.
static void nearest_around(const pci_relaxation *r, uint32_t foot, const double target[3],
                           bool border, double point[3]) {
    const pci_halfedge *fine = r->fine;
    const uint32_t *fan = &r->fans->ends[r->fans->offsets[foot]];
    const size_t count = r->fans->offsets[foot + 1] - r->fans->offsets[foot];
    double best = INFINITY, candidate[3], bary[3];
    if (border) {
        const uint32_t ends[2] = {fan[0], fan[count - 1]};
        for (size_t i = 0; i < 2; ++i) {
            const double distance = segment_point(fine, foot, ends[i], target, candidate);
            if (distance < best) {
                best = distance;
                memcpy(point, candidate, sizeof(candidate));
            }
        }
        return;
    }
    const size_t triangles = pci_is_border_vertex(fine, foot) ? count - 1 : count;
    for (size_t i = 0; i < triangles; ++i) {
        const double *a = &fine->positions[3 * (size_t)foot];
        const double *b = &fine->positions[3 * (size_t)fan[i]];
        const double *c = &fine->positions[3 * (size_t)fan[i + 1 < count ? i + 1 : 0]];
        const double distance = pci_triangle_squared_distance(target, a, b, c, bary);
        if (distance < best) {
            best = distance;
            for (size_t k = 0; k < 3; ++k) {
                point[k] = bary[0] * a[k] + bary[1] * b[k] + bary[2] * c[k];
            }
        }
    }
}

void pci_relax_move(pci_relaxation *r, uint32_t v, const double target[3]) {
    const bool border = pci_is_border_vertex(r->coarse, v);
    double point[3] = {target[0], target[1], target[2]};
    const uint32_t foot = walk(r, r->feet[v], target, border);
    nearest_around(r, foot, target, border, point);
    if (border && pci_on_mirror(r->mirror, point) != pci_on_mirror(r->mirror, coarse_point(r, v))) {
        return; // around the end of the seam
    }
    r->feet[v] = foot;
    memcpy(&r->coarse->positions[3 * (size_t)v], point, sizeof(point));
}

void pci_relax_nearest_of(const pci_relaxation *r, const uint32_t *vertices, size_t count,
                          const double target[3], double point[3], double *squared) {
    uint32_t asked = PC_INVALID_INDEX;
    *squared = INFINITY;
    for (size_t i = 0; i < count; ++i) {
        const uint32_t foot = walk(r, r->feet[vertices[i]], target, false);
        if (foot == asked) {
            continue; // most walks end where the one before did
        }
        double candidate[3] = {target[0], target[1], target[2]};
        nearest_around(r, foot, target, false, candidate);
        const double distance = pci_squared_distance(candidate, target);
        if (distance < *squared) {
            *squared = distance;
            memcpy(point, candidate, sizeof(candidate));
        }
        asked = foot;
    }
}

void pci_relax_nearest(const pci_relaxation *r, uint32_t v, const double target[3], bool border,
                       double point[3]) {
    memcpy(point, target, 3 * sizeof(*point));
    nearest_around(r, walk(r, r->feet[v], target, border), target, border, point);
}

double pci_relax_distance(const pci_relaxation *r, uint32_t v, const double point[3], bool border) {
    double nearest[3];
    pci_relax_nearest(r, v, point, border, nearest);
    return sqrt(pci_squared_distance(nearest, point));
}

double pci_relax_straying(const pci_relaxation *r, uint32_t a, uint32_t b, bool border,
                          double enough) {
    double middle[3];
    for (size_t k = 0; k < 3; ++k) {
        middle[k] = 0.5 * (coarse_point(r, a)[k] + coarse_point(r, b)[k]);
    }
    const double distance = pci_relax_distance(r, a, middle, border);
    return distance < enough ? distance : fmin(distance, pci_relax_distance(r, b, middle, border));
}

void pci_relax_place(pci_relaxation *r) {
    for (uint32_t v = 0; v < r->coarse->vertex_count; ++v) {
        double target[3];
        memcpy(target, coarse_point(r, v), sizeof(target));
        pci_relax_move(r, v, target);
    }
}

// ---- sliding ----------------------------------------------------------------------------------

// Where a vertex should be for even triangles: amid its border neighbours, or at the centroid of
// its triangles weighted by area (a step of Lloyd's method). False: its triangles have no area.
static bool even_place(const pci_relaxation *r, uint32_t v, double target[3]) {
    const pci_halfedge *coarse = r->coarse;
    if (pci_is_hem_vertex(r->mirror, coarse, v)) {
        const double *next = coarse_point(r, pci_target(coarse, coarse->outgoing[v]));
        const double *previous =
            coarse_point(r, pci_origin(coarse, pci_border_incoming(coarse, v)));
        for (size_t k = 0; k < 3; ++k) {
            target[k] = 0.5 * (next[k] + previous[k]);
        }
        return true;
    }
    double sum = 0.0;
    memset(target, 0, 3 * sizeof(*target));
    PCI_FOR_OUTGOING(coarse, v, h) {
        const double *a = coarse_point(r, v), *b = coarse_point(r, pci_target(coarse, h));
        const double *c = coarse_point(r, coarse->corners[pci_previous(h)]);
        double normal[3];
        pci_normal_of(a, b, c, normal);
        // The density of a centroidal Voronoi diagram is the fourth power of the inverse size.
        const double size = (r->scales[r->feet[v]] + r->scales[r->feet[pci_target(coarse, h)]] +
                             r->scales[r->feet[coarse->corners[pci_previous(h)]]]) /
                            3.0;
        const double area = pci_norm(normal) * size * size * size * size;
        for (size_t k = 0; k < 3; ++k) {
            target[k] += area * (a[k] + b[k] + c[k]) / 3.0;
        }
        sum += area;
    }
    for (size_t k = 0; k < 3; ++k) {
        target[k] /= sum;
    }
    return sum > 0.0;
}

// Moves the vertex if its worst triangle gets better, or stays good. From turned over to flat is
// not better: loops of three vertices would shrink to points.
static bool slide(pci_relaxation *r, uint32_t v) {
    static const double good = 0.8;
    double start[3], target[3];
    memcpy(start, coarse_point(r, v), sizeof(start));
    if (!even_place(r, v, target)) {
        return false;
    }
    const uint32_t foot = r->feet[v];
    const double before = pci_relax_quality(r, v);
    for (size_t attempt = 0; attempt < 3; ++attempt) {
        pci_relax_move(r, v, target);
        const double after = pci_relax_quality(r, v);
        if (after > fmax(before, 0.0) || after >= good) {
            return true;
        }
        r->feet[v] = foot;
        memcpy(&r->coarse->positions[3 * (size_t)v], start, sizeof(start));
        for (size_t k = 0; k < 3; ++k) {
            target[k] = 0.5 * (target[k] + start[k]);
        }
    }
    return false;
}

// ---- flipping ---------------------------------------------------------------------------------

static void unit_normal(const double *a, const double *b, const double *c, double normal[3]) {
    pci_normal_of(a, b, c, normal);
    pci_normalize(normal);
}

bool pci_relax_may_flip(const pci_relaxation *r, uint32_t h) {
    const uint32_t g = r->coarse->twins[h];
    if (g == PC_INVALID_INDEX) {
        return false;
    }
    return r->pinned[pci_origin(r->coarse, h)] != PCI_RINGED ||
           r->pinned[pci_target(r->coarse, h)] != PCI_RINGED ||
           r->pinned[r->coarse->corners[pci_previous(h)]] != PCI_RINGED ||
           r->pinned[r->coarse->corners[pci_previous(g)]] != PCI_RINGED;
}

// Flips the edge where that raises the worse quality of its two triangles and keeps the shape: both
// pairs of triangles must be nearly flat, unless one of the old ones is turned over.
static bool improve_edge(pci_relaxation *r, uint32_t h) {
    static const double flat = 0.5, gain = 1.02;
    pci_halfedge *coarse = r->coarse;
    if (!pci_relax_may_flip(r, h)) {
        return false;
    }
    const uint32_t a = pci_origin(coarse, h), b = pci_target(coarse, h);
    const uint32_t c = coarse->corners[pci_previous(h)];
    const uint32_t d = coarse->corners[pci_previous(coarse->twins[h])];
    const double before = fmin(corner_quality(r, a, b, c), corner_quality(r, b, a, d));
    const double after = fmin(corner_quality(r, a, d, c), corner_quality(r, d, b, c));
    if (!(after > 0.0) || !(after > gain * before)) {
        return false;
    }
    double n[4][3];
    unit_normal(coarse_point(r, a), coarse_point(r, b), coarse_point(r, c), n[0]);
    unit_normal(coarse_point(r, b), coarse_point(r, a), coarse_point(r, d), n[1]);
    unit_normal(coarse_point(r, a), coarse_point(r, d), coarse_point(r, c), n[2]);
    unit_normal(coarse_point(r, d), coarse_point(r, b), coarse_point(r, c), n[3]);
    const bool keeps_shape = pci_dot(n[0], n[1]) > flat && pci_dot(n[2], n[3]) > flat;
    if (!(keeps_shape || before <= 0.0) || !pci_can_flip(coarse, h)) {
        return false;
    }
    pci_flip(coarse, h);
    return true;
}

size_t pci_relax_flip(pci_relaxation *r) {
    size_t changes = 0;
    for (uint32_t h = 0; h < 3 * r->coarse->triangle_count; ++h) {
        if (pci_is_edge(r->coarse, h)) {
            changes += improve_edge(r, h);
        }
    }
    return changes;
}

size_t pci_relax_pass(pci_relaxation *r) {
    size_t changes = pci_relax_flip(r);
    for (uint32_t v = 0; v < r->coarse->vertex_count; ++v) {
        changes += !r->pinned[v] && slide(r, v);
    }
    return changes;
}
