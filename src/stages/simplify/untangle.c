#include "stages/simplify/untangle.h"

#include "geometry/crossing.h"
#include "stages/simplify/improve.h"
#include "stages/simplify/separate.h"

static const size_t steps = PCI_EFFORT(30, 3);
// Triangles looked at in all steps together, so that large meshes end; five steps at least.
static const size_t work = 1000000;
// Gap that is aimed for and longest way of a vertex in one step, in expected edge lengths.
static const double gap = 0.02;
static const double longest_step = 0.08;
// Angles that moves may leave, in degrees.
static const double kept_angle = PCI_LEAST_ANGLE;

typedef struct untangling {
    pci_relaxation *relaxation;
    double spacing;
    double *moves;   // per vertex, 3: sum
    double *weights; // per vertex
    double *best;    // per vertex, 3: the positions with the fewest crossings
} untangling;

static double *position(const untangling *u, uint32_t v) {
    return &u->relaxation->coarse->positions[3 * (size_t)v];
}

static void push(untangling *u, uint32_t v, double share, double way, const double normal[3]) {
    // Weighted by the share, so that a vertex obeys those pushes that it can answer.
    const double weight = fabs(share);
    u->weights[v] += weight;
    for (size_t k = 0; k < 3; ++k) {
        u->moves[3 * (size_t)v + k] += weight * share * way * normal[k];
    }
}

// Where the edge from a to b pierces the triangle, asks for moves that free it.
static void push_edge(untangling *u, uint32_t a, uint32_t b, const uint32_t *triangle) {
    const double *p[2] = {position(u, a), position(u, b)};
    const double *q[3] = {position(u, triangle[0]), position(u, triangle[1]),
                          position(u, triangle[2])};
    double e1[3], e2[3], normal[3], d[2], offset[3];
    pci_sub(q[1], q[0], e1);
    pci_sub(q[2], q[0], e2);
    pci_cross(e1, e2, normal);
    const double doubled = pci_norm(normal);
    if (!pci_normalize(normal)) {
        return;
    }
    for (size_t i = 0; i < 2; ++i) {
        pci_sub(p[i], q[0], offset);
        d[i] = pci_dot(offset, normal);
    }
    if (!(d[0] * d[1] < 0.0)) {
        return;
    }
    double point[3], bary[3], squares = 0.0;
    for (size_t k = 0; k < 3; ++k) {
        point[k] = p[0][k] + (p[1][k] - p[0][k]) * (d[0] / (d[0] - d[1]));
    }
    for (size_t c = 0; c < 3; ++c) {
        double side[3], to[3], turn[3];
        pci_sub(q[(c + 2) % 3], q[(c + 1) % 3], side);
        pci_sub(point, q[(c + 1) % 3], to);
        pci_cross(side, to, turn);
        bary[c] = pci_dot(turn, normal) / doubled;
        squares += bary[c] * bary[c];
        if (!(bary[c] >= 0.0)) {
            return;
        }
    }
    const size_t end = fabs(d[0]) < fabs(d[1]) ? 0 : 1; // the shorter way out
    const double way = d[end] > 0.0 ? -d[end] - gap * u->spacing : -d[end] + gap * u->spacing;
    push(u, end == 0 ? a : b, 1.0, 0.6 * way, normal);
    for (size_t c = 0; c < 3; ++c) {
        push(u, triangle[c], -bary[c] / squares, 0.6 * way, normal);
    }
}

static void push_pair(untangling *u, const uint32_t *first, const uint32_t *second) {
    const uint32_t *sides[2] = {first, second};
    for (size_t s = 0; s < 2; ++s) {
        for (size_t c = 0; c < 3; ++c) {
            const uint32_t a = sides[s][c], b = sides[s][(c + 1) % 3], *t = sides[1 - s];
            if (a != t[0] && a != t[1] && a != t[2] && b != t[0] && b != t[1] && b != t[2]) {
                push_edge(u, a, b, t);
            }
        }
    }
}

// Moves every vertex that was pushed, unless that spoils its triangles.
static void apply(untangling *u) {
    for (uint32_t v = 0; v < u->relaxation->coarse->vertex_count; ++v) {
        if (!(u->weights[v] > 0.0)) {
            continue;
        }
        double *at = position(u, v), *move = &u->moves[3 * (size_t)v];
        const double start[3] = {at[0], at[1], at[2]};
        const double length = pci_norm(move) / u->weights[v];
        const double limit = longest_step * u->spacing;
        double share = (length > limit ? limit / length : 1.0) / u->weights[v];
        const pci_fan_shape before = pci_shape_of_fan(u->relaxation, v);
        for (size_t attempt = 0; attempt < 3; ++attempt, share *= 0.5) {
            for (size_t k = 0; k < 3; ++k) {
                at[k] = start[k] + share * move[k];
            }
            const pci_fan_shape after = pci_shape_of_fan(u->relaxation, v);
            if (after.angle >= fmin(before.angle, kept_angle) && after.turned <= before.turned) {
                break;
            }
            memcpy(at, start, sizeof(start));
        }
    }
}

// ---- the whole ----------------------------------------------------------------------------------

bool pci_untangle(pci_scratch *scratch, pci_relaxation *relaxation, double spacing, size_t *left) {
    pci_halfedge *coarse = relaxation->coarse;
    const pc_mesh mesh = pci_halfedge_view(coarse);
    untangling u = {.relaxation = relaxation, .spacing = spacing};
    u.moves = PCI_SCRATCH(scratch, double, 3 * mesh.vertex_count);
    u.weights = PCI_SCRATCH(scratch, double, mesh.vertex_count);
    u.best = PCI_SCRATCH(scratch, double, 3 * mesh.vertex_count);
    if (scratch->failed) {
        return false;
    }
    *left = SIZE_MAX;
    const size_t affordable = 5 + work / (mesh.triangle_count + 1);
    const size_t last = affordable < steps ? affordable : steps;
    for (size_t step = 0; step <= last && *left > 0; ++step) {
        size_t count = 0;
        uint32_t *pairs = NULL;
        pci_scratch lists = pci_scratch_begin(scratch->context);
        if (!pci_list_self_intersections(&lists, &mesh, &pairs, &count) ||
            !pci_keep_going(scratch->context)) {
            pci_scratch_end(&lists);
            return false;
        }
        if (count < *left) {
            *left = count;
            memcpy(u.best, mesh.positions, 3 * mesh.vertex_count * sizeof(*u.best));
        }
        memset(u.moves, 0, 3 * mesh.vertex_count * sizeof(*u.moves));
        memset(u.weights, 0, mesh.vertex_count * sizeof(*u.weights));
        for (size_t i = 0; i < count; ++i) {
            push_pair(&u, &mesh.triangles[3 * (size_t)pairs[2 * i]],
                      &mesh.triangles[3 * (size_t)pairs[2 * i + 1]]);
        }
        pci_scratch_end(&lists);
        apply(&u);
    }
    memcpy(mesh.positions, u.best, 3 * mesh.vertex_count * sizeof(*u.best));
    return true;
}
