#include "geometry/rim.h"

#include <stdlib.h>

#include "geometry/topology.h"

enum { most_triangles = 2048, most_candidates = 1 << 15, edge_grain = 64 };

// Sums of whole numbers do not depend on the order of the triangles, which the tree decides.
typedef struct ball {
    double centre[3], radius;
    int64_t area, moment[3]; // of the surface inside, about the centre, in UNITs of radius^2, ^3
} ball;
#define UNIT 0x1p-48

// A plane figure: its area and first moment about the origin.
typedef struct figure {
    double area, moment[2];
} figure;

// Above this a point lies on a rim; between a square edge and the end of a sheet.
static const double least_one_sided = 0.34;

static inline double clamp(double x, double low, double high) {
    return x > low ? x < high ? x : high : low;
}

// Adds the triangle between the origin and the side a b; negative when it runs clockwise.
static void add_wedge(figure *f, const double a[2], const double b[2]) {
    const double area = 0.5 * (a[0] * b[1] - a[1] * b[0]);
    f->area += area;
    for (size_t k = 0; k < 2; ++k) {
        f->moment[k] += area * (a[k] + b[k]) / 3.0;
    }
}

// Along the circle the figure is made of sectors: a product of the turns between their ends, as
// complex numbers, is one of the whole angle while they are acute.
typedef struct arc {
    double radius, turn[2], angle;
} arc;

static void end_turn(arc *c) {
    c->angle += atan2(c->turn[1], c->turn[0]);
    c->turn[0] = 1.0, c->turn[1] = 0.0;
}

// From the direction of a to that of b.
static void add_turn(arc *c, const double a[2], const double b[2]) {
    const double along = a[0] * b[0] + a[1] * b[1], across = a[0] * b[1] - a[1] * b[0];
    if (!(c->turn[0] > 0.0 && along > 0.0)) {
        end_turn(c);
    }
    const double x = c->turn[0] * along - c->turn[1] * across;
    c->turn[1] = c->turn[0] * across + c->turn[1] * along;
    c->turn[0] = x;
}

// The moment of sectors depends on where they begin (sign -1) and end (1), on the circle.
static void add_end(figure *f, double radius, double sign, const double at[2]) {
    const double third = sign * radius * radius / 3.0;
    f->moment[0] += third * at[1];
    f->moment[1] -= third * at[0];
}

// Adds what lies between the origin and the directed side a b, inside the circle; sectors to `c`.
static void add_side(figure *f, arc *c, const double a[2], const double b[2]) {
    const double d[2] = {b[0] - a[0], b[1] - a[1]}, radius = c->radius;
    const double length2 = d[0] * d[0] + d[1] * d[1];
    if (!(length2 > 0.0)) {
        return;
    }
    // Most sides are inside as a whole: with some room, so that rounding leaves no doubt.
    const double inside = (1.0 - 1e-9) * radius * radius;
    if (a[0] * a[0] + a[1] * a[1] < inside && b[0] * b[0] + b[1] * b[1] < inside) {
        const double end[2] = {a[0] + d[0], a[1] + d[1]};
        add_wedge(f, a, end);
        return;
    }
    // The side is inside for parameters from `enter` to `leave`.
    const double cross = a[0] * d[1] - a[1] * d[0];
    const double reach2 = radius * radius * length2 - cross * cross;
    if (!(reach2 > 0.0)) {
        add_turn(c, a, b);
        return;
    }
    const double inverse = 1.0 / length2, half = sqrt(reach2) * inverse;
    const double middle = -(a[0] * d[0] + a[1] * d[1]) * inverse;
    const double enter = clamp(middle - half, 0.0, 1.0), leave = clamp(middle + half, 0.0, 1.0);
    if (!(enter < leave)) {
        add_turn(c, a, b);
        return;
    }
    const double p[2] = {a[0] + enter * d[0], a[1] + enter * d[1]};
    const double q[2] = {a[0] + leave * d[0], a[1] + leave * d[1]};
    add_wedge(f, p, q);
    if (enter > 0.0) {
        add_turn(c, a, p);
        add_end(f, radius, 1.0, p);
    }
    if (leave < 1.0) {
        add_end(f, radius, -1.0, q);
        add_turn(c, q, b);
    }
}

// No figure inside the ball has more than pi, but for rounding in triangles that are far larger.
static int64_t whole_units(double share) { return (int64_t)(clamp(share, -4.0, 4.0) / UNIT); }

static void add_part(ball *b, double area, const double moment[3]) {
    const double square = b->radius * b->radius;
    b->area += whole_units(area / square);
    for (size_t k = 0; k < 3; ++k) {
        b->moment[k] += whole_units(moment[k] / (square * b->radius));
    }
}

// Adds a triangle that is inside as a whole.
static void add_whole(ball *b, const double corners[3][3], const double normal[3]) {
    const double area = 0.5 * pci_norm(normal);
    double moment[3];
    for (size_t k = 0; k < 3; ++k) {
        moment[k] = area * ((corners[0][k] + corners[1][k] + corners[2][k]) / 3.0 - b->centre[k]);
    }
    add_part(b, area, moment);
}

// Adds the part of a triangle inside the ball: in its plane, that inside a circle.
static void add_triangle(ball *b, const double corners[3][3]) {
    double u[3], v[3], normal[3], from[3], farthest = 0.0;
    pci_sub(corners[1], corners[0], u);
    pci_sub(corners[2], corners[0], v);
    pci_cross(u, v, normal);
    for (size_t k = 0; k < 3; ++k) {
        const double square = pci_squared_distance(corners[k], b->centre);
        farthest = square > farthest ? square : farthest;
    }
    if (farthest <= b->radius * b->radius) { // as most triangles of a dense mesh are
        add_whole(b, corners, normal);
        return;
    }
    if (!pci_normalize(normal) || !pci_normalize(u)) {
        return;
    }
    pci_cross(normal, u, v);
    pci_sub(corners[0], b->centre, from);
    const double height = pci_dot(from, normal);
    const double square = b->radius * b->radius - height * height;
    if (!(square > 0.0)) {
        return;
    }
    double flat[3][2];
    for (size_t k = 0; k < 3; ++k) {
        pci_sub(corners[k], b->centre, from);
        flat[k][0] = pci_dot(from, u), flat[k][1] = pci_dot(from, v);
    }
    figure f = {0};
    arc c = {.radius = sqrt(square), .turn = {1.0, 0.0}};
    for (size_t k = 0; k < 3; ++k) {
        add_side(&f, &c, flat[k], flat[(k + 1) % 3]);
    }
    end_turn(&c);
    f.area += 0.5 * square * c.angle;
    double moment[3];
    for (size_t k = 0; k < 3; ++k) {
        moment[k] = f.moment[0] * u[k] + f.moment[1] * v[k] + f.area * height * normal[k];
    }
    add_part(b, f.area, moment);
}

// How far the centre of the surface inside a small ball lies beside the ball's centre, in radii:
// 0 inside a surface, 0.3 on a square edge, 4 / (3 pi) = 0.42 where one or more sheets end. `point`
// lies on the mesh. Where too many triangles are inside, the ball is halved. `inward`: the way to
// the surface's centre, unit or zero.
static double one_sided(const pci_bvh *bvh, const pc_mesh *mesh, const double point[3],
                        double radius, double inward[3]) {
    uint32_t triangles[most_triangles];
    const size_t count = pci_bvh_collect_fitting(bvh, point, &radius, most_triangles, triangles);
    ball b = {.centre = {point[0], point[1], point[2]}, .radius = radius};
    for (size_t i = 0; i < count; ++i) {
        double corners[3][3];
        for (size_t k = 0; k < 3; ++k) {
            memcpy(corners[k], &mesh->positions[3 * (size_t)mesh->triangles[3 * triangles[i] + k]],
                   sizeof(corners[k]));
        }
        add_triangle(&b, (const double(*)[3])corners);
    }
    const double moment[3] = {(double)b.moment[0], (double)b.moment[1], (double)b.moment[2]};
    memcpy(inward, moment, sizeof(moment));
    if (!pci_normalize(inward)) {
        memset(inward, 0, sizeof(moment));
    }
    return b.area > 0 ? pci_norm(moment) / (double)b.area : 0.0;
}

// ---- rim points ---------------------------------------------------------------------------------

// An edge may be a rim when it has one triangle, more than two, or bends by more than 60 degrees.
static bool may_be_rim(const pc_mesh *mesh, const pci_topology *topology, size_t edge) {
    if (pci_side_count(topology, edge) != 2) {
        return true;
    }
    double normals[2][3], along[3];
    const uint32_t *ends = &topology->edges[2 * edge];
    pci_sub(&mesh->positions[3 * (size_t)ends[1]], &mesh->positions[3 * (size_t)ends[0]], along);
    double wings[2][3]; // from the edge into each triangle, square to the edge
    for (size_t side = 0; side < 2; ++side) {
        const uint32_t *corner = &mesh->triangles[3 * (size_t)pci_sides(topology, edge)[side]];
        uint32_t apex = corner[0];
        for (size_t k = 0; k < 3; ++k) {
            apex = corner[k] != ends[0] && corner[k] != ends[1] ? corner[k] : apex;
        }
        pci_sub(&mesh->positions[3 * (size_t)apex], &mesh->positions[3 * (size_t)ends[0]],
                wings[side]);
        pci_cross(along, wings[side], normals[side]);
        if (!pci_normalize(normals[side])) {
            return true;
        }
    }
    return pci_dot(normals[0], normals[1]) > -0.5; // -1 where flat
}

typedef struct cell_point {
    uint64_t cell, index;
} cell_point;

static int compare_cells(const void *left, const void *right) {
    const cell_point *a = left, *b = right;
    return a->cell != b->cell ? (a->cell > b->cell) - (a->cell < b->cell)
                              : (a->index > b->index) - (a->index < b->index);
}

// Keeps the first point in each cube of side `spacing`, so that the edges of a soup, which fill
// space, cost no more than space holds. False: out of memory.
static bool thin_out(pci_scratch *scratch, double *points, size_t *count, double spacing) {
    double least[3] = {INFINITY, INFINITY, INFINITY};
    cell_point *cells = PCI_SCRATCH(scratch, cell_point, *count);
    uint8_t *kept = PCI_SCRATCH(scratch, uint8_t, *count);
    if (scratch->failed) {
        return false;
    }
    for (size_t i = 0; i < 3 * *count; ++i) {
        least[i % 3] = fmin(least[i % 3], points[i]);
    }
    for (size_t i = 0; i < *count; ++i) {
        uint64_t cell = 0;
        for (size_t k = 0; k < 3; ++k) {
            const double steps = (points[3 * i + k] - least[k]) / spacing;
            cell = cell << 21 | (uint64_t)fmin(steps, (double)((1 << 21) - 1));
        }
        cells[i] = (cell_point){cell, i};
    }
    qsort(cells, *count, sizeof(*cells), compare_cells);
    for (size_t i = 0; i < *count; ++i) {
        kept[cells[i].index] = i == 0 || cells[i].cell != cells[i - 1].cell;
    }
    size_t left = 0;
    for (size_t i = 0; i < *count; ++i) {
        if (kept[i]) {
            memmove(&points[3 * left++], &points[3 * i], 3 * sizeof(double));
        }
    }
    *count = left;
    return true;
}

typedef struct rim_job {
    const pci_bvh *bvh;
    const pc_mesh *mesh;
    double radius;
    const double *candidates;
    double *inwards;
    uint8_t *on_rim;
} rim_job;

static void test_candidates(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const rim_job *job = user;
    for (size_t i = begin; i < end; ++i) {
        job->on_rim[i] = one_sided(job->bvh, job->mesh, &job->candidates[3 * i], job->radius,
                                   &job->inwards[3 * i]) > least_one_sided;
    }
}

pc_status pci_find_rims(pci_scratch *scratch, const char *stage, const pci_bvh *bvh,
                        const pc_mesh *mesh, const pci_topology *topology, double radius,
                        double spacing, pci_rims *rims) {
    void *candidates = NULL;
    size_t candidate_count = 0, capacity = 0;
    for (size_t e = 0; e < topology->edge_count; ++e) {
        if (!may_be_rim(mesh, topology, e)) {
            continue;
        }
        const double *a = &mesh->positions[3 * (size_t)topology->edges[2 * e]];
        const double *b = &mesh->positions[3 * (size_t)topology->edges[2 * e + 1]];
        const size_t pieces = 1 + (size_t)(sqrt(pci_squared_distance(a, b)) / spacing);
        if (!pci_scratch_reserve(scratch, &candidates, &capacity, candidate_count + pieces,
                                 3 * sizeof(double))) {
            return pci_fail_memory(scratch->context, stage);
        }
        for (size_t i = 0; i < pieces; ++i) {
            const double share = ((double)i + 0.5) / (double)pieces;
            for (size_t k = 0; k < 3; ++k) {
                ((double *)candidates)[3 * candidate_count + k] = a[k] + share * (b[k] - a[k]);
            }
            ++candidate_count;
        }
    }
    // Edges of a dense mesh are shorter than points of a rim need to be apart.
    if (candidate_count > 1 && !thin_out(scratch, candidates, &candidate_count, 0.5 * spacing)) {
        return pci_fail_memory(scratch->context, stage);
    }
    for (double side = spacing; candidate_count > most_candidates; side *= 2.0) {
        if (!thin_out(scratch, candidates, &candidate_count, side)) {
            return pci_fail_memory(scratch->context, stage);
        }
    }
    double *points = candidates, *inwards = PCI_SCRATCH(scratch, double, 3 * candidate_count);
    uint8_t *on_rim = PCI_SCRATCH(scratch, uint8_t, candidate_count);
    if (scratch->failed) {
        return pci_fail_memory(scratch->context, stage);
    }
    rim_job job = {bvh, mesh, radius, points, inwards, on_rim};
    if (!pci_parallel_while_wanted(scratch->context, candidate_count, edge_grain, test_candidates,
                                   &job)) {
        return pci_fail_memory(scratch->context, stage);
    }
    size_t count = 0;
    for (size_t i = 0; i < candidate_count; ++i) {
        if (on_rim[i]) {
            memmove(&points[3 * count], &points[3 * i], 3 * sizeof(double));
            memmove(&inwards[3 * count], &inwards[3 * i], 3 * sizeof(double));
            ++count;
        }
    }
    rims->inwards = inwards;
    return pci_knn_build(scratch, count, points, &rims->points)
               ? PC_OK
               : pci_fail_memory(scratch->context, stage);
}
