#include "stages/simplify/improve.h"

#include "core/heap.h"

// Triangles with smaller angles are looked at, in degrees.
static const double bad_angle = 36.0;
// What an operation must gain, in degrees.
static const double least_gain = 1.0;
// Cosine between a new triangle and the fine surface at its corners.
static const double least_facing = 0.3;
// How far the middle of a new edge may be from the fine surface, in expected edge lengths.
static const double farthest = 0.25;
static const size_t rounds = PCI_EFFORT(6, 2);

static const double *point_of(const pci_relaxation *r, uint32_t v) {
    return &r->coarse->positions[3 * (size_t)v];
}

// Cosine between a triangle and the fine surface at its corners.
static double facing_cosine(const pci_relaxation *r, uint32_t a, uint32_t b, uint32_t c) {
    double normal[3], facing[3];
    pci_normal_of(point_of(r, a), point_of(r, b), point_of(r, c), normal);
    pci_relax_facing(r, a, b, c, facing);
    return pci_dot(normal, facing) / fmax(pci_norm(normal) * pci_norm(facing), 1e-300);
}

static double triangle_angle(const pci_relaxation *r, uint32_t t) {
    const uint32_t *corner = &r->coarse->corners[3 * (size_t)t];
    return pci_least_angle(point_of(r, corner[0]), point_of(r, corner[1]), point_of(r, corner[2]));
}

pci_fan_shape pci_shape_of_triangle(const pci_relaxation *r, uint32_t t) {
    const uint32_t *corner = &r->coarse->corners[3 * (size_t)t];
    return (pci_fan_shape){triangle_angle(r, t),
                           facing_cosine(r, corner[0], corner[1], corner[2]) < 0.0};
}

pci_fan_shape pci_shape_of_fan(const pci_relaxation *r, uint32_t v) {
    pci_fan_shape shape = {INFINITY, 0};
    PCI_FOR_OUTGOING(r->coarse, v, h) {
        const pci_fan_shape one = pci_shape_of_triangle(r, h / 3);
        shape.angle = fmin(shape.angle, one.angle);
        shape.turned += one.turned;
    }
    return shape;
}

typedef struct improvement {
    pci_relaxation *r;
    double spacing;
    size_t wanted;    // vertices
    size_t capacity;  // of feet, pinned and parent
    uint32_t *parent; // per coarse vertex, what it was merged into; itself when alive
    uint8_t *rests;   // per coarse vertex: found no better place, and nothing changed around it
} improvement;

// Something about v has changed.
static void wake(const improvement *m, uint32_t v) {
    m->rests[v] = 0;
    PCI_FOR_OUTGOING(m->r->coarse, v, h) {
        m->rests[pci_target(m->r->coarse, h)] = 0;
        m->rests[m->r->coarse->corners[pci_previous(h)]] = 0;
    }
}

// ---- places -----------------------------------------------------------------------------------

typedef struct place {
    double point[3];
    uint32_t foot;
} place;

static place place_of(const pci_relaxation *r, uint32_t v) {
    place p = {.foot = r->feet[v]};
    memcpy(p.point, point_of(r, v), sizeof(p.point));
    return p;
}

static void put(pci_relaxation *r, uint32_t v, const place *p) {
    r->feet[v] = p->foot;
    memcpy(&r->coarse->positions[3 * (size_t)v], p->point, sizeof(p->point));
}

// The largest of the edges around v, or `least`.
static double straying(const pci_relaxation *r, uint32_t v, double least) {
    const pci_halfedge *coarse = r->coarse;
    double most = least;
    PCI_FOR_OUTGOING(coarse, v, h) {
        const uint32_t b = pci_target(coarse, h), c = coarse->corners[pci_previous(h)];
        most = fmax(most, pci_relax_straying(r, v, b, coarse->twins[h] == PC_INVALID_INDEX, most));
        if (coarse->twins[pci_previous(h)] == PC_INVALID_INDEX) {
            most = fmax(most, pci_relax_straying(r, v, c, true, most));
        }
    }
    return most;
}

// Whether the middle of an edge is farther than `limit`.
static bool edge_strays(const pci_relaxation *r, uint32_t a, uint32_t b, bool border,
                        double limit) {
    double middle[3];
    for (size_t k = 0; k < 3; ++k) {
        middle[k] = 0.5 * (point_of(r, a)[k] + point_of(r, b)[k]);
    }
    return pci_relax_distance(r, a, middle, border) > limit &&
           pci_relax_distance(r, b, middle, border) > limit;
}

// Whether straying(), without the edge to `other`, is more than `limit`.
static bool strays(const pci_relaxation *r, uint32_t v, uint32_t other, double limit) {
    const pci_halfedge *coarse = r->coarse;
    PCI_FOR_OUTGOING(coarse, v, h) {
        const uint32_t b = pci_target(coarse, h), c = coarse->corners[pci_previous(h)];
        if ((b != other && edge_strays(r, v, b, coarse->twins[h] == PC_INVALID_INDEX, limit)) ||
            (coarse->twins[pci_previous(h)] == PC_INVALID_INDEX && c != other &&
             edge_strays(r, v, c, true, limit))) {
            return true;
        }
    }
    return false;
}

static double mean_edge(const pci_relaxation *r, uint32_t v) {
    double sum = 0.0, count = 0.0;
    PCI_FOR_OUTGOING(r->coarse, v, h) {
        sum += sqrt(pci_squared_distance(point_of(r, v), point_of(r, pci_target(r->coarse, h))));
        ++count;
    }
    return sum / count;
}

// Whether the least angle around v is larger, and no more triangles are turned over.
static bool has_better_shape(const pci_relaxation *r, uint32_t v, pci_fan_shape *best) {
    pci_fan_shape shape = {INFINITY, 0};
    PCI_FOR_OUTGOING(r->coarse, v, h) {
        const pci_fan_shape one = pci_shape_of_triangle(r, h / 3);
        shape.angle = fmin(shape.angle, one.angle);
        shape.turned += one.turned;
        if (!(shape.angle > best->angle) || shape.turned > best->turned) {
            return false;
        }
    }
    *best = shape;
    return true;
}

// Searches along the edges of the vertex, forth and back, for a place on the surface where its
// least angle is larger.
static void reposition(const improvement *m, uint32_t v) {
    pci_relaxation *r = m->r;
    const pci_halfedge *coarse = r->coarse;
    if (m->rests[v] || r->pinned[v]) {
        return;
    }
    pci_fan_shape best = pci_shape_of_fan(r, v);
    double step = 0.3 * mean_edge(r, v);
    if (best.angle >= bad_angle) {
        return;
    }
    bool moved = false;
    const double allowed = straying(r, v, farthest * m->spacing);
    for (size_t level = 0; level < PCI_EFFORT(4, 1); ++level, step *= 0.5) {
        const place start = place_of(r, v);
        place better = start;
        PCI_FOR_OUTGOING(coarse, v, h) {
            double direction[3];
            put(r, v, &start);
            pci_sub(point_of(r, pci_target(coarse, h)), start.point, direction);
            if (!pci_normalize(direction)) {
                continue;
            }
            for (int sign = -1; sign <= 1; sign += 2) {
                double target[3];
                for (size_t k = 0; k < 3; ++k) {
                    target[k] = start.point[k] + sign * step * direction[k];
                }
                put(r, v, &start);
                pci_relax_move(r, v, target);
                pci_fan_shape shape = best;
                if (has_better_shape(r, v, &shape) && !strays(r, v, PC_INVALID_INDEX, allowed)) {
                    best = shape;
                    better = place_of(r, v);
                    moved = true;
                }
            }
        }
        put(r, v, &better);
    }
    if (moved) {
        wake(m, v);
    }
    m->rests[v] = !moved;
}

// ---- collapses --------------------------------------------------------------------------------

static bool holds(const pci_halfedge *coarse, uint32_t triangle, uint32_t v) {
    const uint32_t *corner = &coarse->corners[3 * (size_t)triangle];
    return corner[0] == v || corner[1] == v || corner[2] == v;
}

// Least angle around v without the triangles that hold `other`; negative as soon as one of them
// leaves the fine surface.
static double open_angle(const pci_relaxation *r, uint32_t v, uint32_t other) {
    const pci_halfedge *coarse = r->coarse;
    double least = 180.0;
    PCI_FOR_OUTGOING(coarse, v, h) {
        if (holds(coarse, h / 3, other)) {
            continue;
        }
        const uint32_t b = pci_target(coarse, h), c = coarse->corners[pci_previous(h)];
        if (facing_cosine(r, v, b, c) < least_facing) {
            return -1.0;
        }
        least = fmin(least, pci_least_angle(point_of(r, v), point_of(r, b), point_of(r, c)));
    }
    return least;
}

// Where the two ends of edge h should merge; returns the least angle afterwards, negative: nowhere.
static double best_merge(improvement *m, uint32_t h, place *where) {
    pci_relaxation *r = m->r;
    pci_halfedge *coarse = r->coarse;
    const uint32_t ends[2] = {pci_origin(coarse, h), pci_target(coarse, h)};
    if ((r->pinned[ends[0]] && r->pinned[ends[1]]) || pci_is_seam_edge(r->mirror, coarse, h) ||
        !pci_can_collapse(coarse, h)) {
        return -1.0;
    }
    const bool border[2] = {pci_is_border_vertex(coarse, ends[0]),
                            pci_is_border_vertex(coarse, ends[1])};
    const place old[2] = {place_of(r, ends[0]), place_of(r, ends[1])};
    double best = -1.0;
    for (size_t candidate = 0; candidate < 3; ++candidate) {
        if (candidate == 2) {
            double middle[3];
            for (size_t k = 0; k < 3; ++k) {
                middle[k] = 0.5 * (old[0].point[k] + old[1].point[k]);
            }
            if (border[0] != border[1] || r->pinned[ends[0]] || r->pinned[ends[1]]) {
                break;
            }
            put(r, ends[1], &old[1]);
            pci_relax_move(r, ends[1], middle);
        } else if ((border[1 - candidate] && !border[candidate]) ||
                   r->pinned[ends[1 - candidate]]) {
            continue; // the other one is bound to its place
        } else {
            put(r, ends[1], &old[candidate]);
        }
        const place tried = place_of(r, ends[1]);
        put(r, ends[0], &tried);
        const double angle = fmin(open_angle(r, ends[0], ends[1]), open_angle(r, ends[1], ends[0]));
        if (angle > best && !strays(r, ends[0], ends[1], farthest * m->spacing) &&
            !strays(r, ends[1], ends[0], farthest * m->spacing)) {
            best = angle;
            *where = tried;
        }
    }
    put(r, ends[0], &old[0]);
    put(r, ends[1], &old[1]);
    return best;
}

static uint32_t merge_edge(improvement *m, uint32_t h, const place *where) {
    const uint32_t a = pci_origin(m->r->coarse, h), b = pci_target(m->r->coarse, h);
    pci_collapse(m->r->coarse, h);
    m->parent[a] = b;
    m->r->pinned[b] |= m->r->pinned[a];
    put(m->r, b, where);
    wake(m, b);
    return b;
}

// ---- splits -----------------------------------------------------------------------------------

// Edges of rings and of the seam stay whole.
static bool may_split(const pci_relaxation *r, uint32_t h) {
    return !pci_is_seam_edge(r->mirror, r->coarse, h) &&
           (r->pinned[pci_origin(r->coarse, h)] != PCI_RINGED ||
            r->pinned[pci_target(r->coarse, h)] != PCI_RINGED);
}

// Splits edge h in the middle; PC_INVALID_INDEX: out of memory or of room.
static uint32_t split(improvement *m, uint32_t h) {
    pci_relaxation *r = m->r;
    const uint32_t a = pci_origin(r->coarse, h), b = pci_target(r->coarse, h);
    if (r->coarse->vertex_count == m->capacity) {
        return PC_INVALID_INDEX;
    }
    double middle[3];
    for (size_t k = 0; k < 3; ++k) {
        middle[k] = 0.5 * (point_of(r, a)[k] + point_of(r, b)[k]);
    }
    const uint32_t v = pci_split_edge(r->coarse, h, middle);
    if (v != PC_INVALID_INDEX) {
        r->feet[v] = r->feet[a];
        r->pinned[v] = 0;
        m->parent[v] = v;
        pci_relax_move(r, v, middle);
        wake(m, v);
    }
    return v;
}

// ---- the search -------------------------------------------------------------------------------

static void settle(improvement *m, uint32_t v) {
    reposition(m, v);
    PCI_FOR_OUTGOING(m->r->coarse, v, h) { reposition(m, pci_target(m->r->coarse, h)); }
}

// Does to a bad triangle what helps most.
static void treat(improvement *m, uint32_t t) {
    pci_relaxation *r = m->r;
    pci_halfedge *coarse = r->coarse;
    for (size_t c = 0; c < 3; ++c) {
        reposition(m, coarse->corners[3 * (size_t)t + c]);
    }
    if (triangle_angle(r, t) >= bad_angle) {
        return;
    }
    double best = least_gain;
    place where = {{0.0}, 0};
    uint32_t edge = PC_INVALID_INDEX;
    for (uint32_t h = 3 * t; h < 3 * t + 3; ++h) {
        const double around = fmin(pci_shape_of_fan(r, pci_origin(coarse, h)).angle,
                                   pci_shape_of_fan(r, pci_target(coarse, h)).angle);
        place tried = {{0.0}, 0};
        const double gain = best_merge(m, h, &tried) - around;
        if (gain > best) {
            best = gain;
            where = tried;
            edge = h;
        }
    }
    if (edge != PC_INVALID_INDEX) {
        settle(m, merge_edge(m, edge, &where));
    }
}

// Worst triangles first. False: out of memory. `count` receives how many are bad.
static bool treat_all(pci_scratch *scratch, improvement *m, size_t *count) {
    pci_heap worst = {0};
    *count = 0;
    for (uint32_t t = 0; t < m->r->coarse->triangle_count; ++t) {
        if (m->r->coarse->corners[3 * (size_t)t] == PC_INVALID_INDEX) {
            continue;
        }
        const double angle = triangle_angle(m->r, t);
        if (angle < bad_angle) {
            ++*count;
            if (!pci_heap_push(scratch, &worst, angle, t)) {
                return false;
            }
        }
    }
    pci_heap_entry entry;
    while (pci_heap_pop(&worst, &entry)) {
        if (m->r->coarse->corners[3 * (size_t)entry.item] != PC_INVALID_INDEX &&
            triangle_angle(m->r, entry.item) < bad_angle) {
            treat(m, entry.item);
        }
    }
    return true;
}

// Splits the longest edges until the number of vertices is what it was. False: out of memory.
static bool balance(pci_scratch *scratch, improvement *m) {
    pci_relaxation *r = m->r;
    pci_halfedge *coarse = r->coarse;
    pci_heap longest = {0};
    for (uint32_t h = 0; h < 3 * coarse->triangle_count; ++h) {
        if (pci_is_edge(coarse, h)) {
            const double scale = 0.5 * (r->scales[r->feet[pci_origin(coarse, h)]] +
                                        r->scales[r->feet[pci_target(coarse, h)]]);
            if (!pci_heap_push(scratch, &longest, -pci_edge_length(coarse, h) * scale, h)) {
                return false;
            }
        }
    }
    pci_heap_entry entry;
    while (coarse->live_vertices < m->wanted && pci_heap_pop(&longest, &entry)) {
        if (pci_is_edge(coarse, entry.item) && may_split(r, entry.item)) {
            const uint32_t v = split(m, entry.item);
            if (v == PC_INVALID_INDEX) {
                return !scratch->failed;
            }
            settle(m, v);
        }
    }
    return true;
}

// Numbers what is alive without gaps.
static bool renumber(pci_scratch *scratch, improvement *m, uint32_t *nearby) {
    pci_relaxation *r = m->r;
    pc_mesh mesh = {0};
    uint32_t *kept = NULL;
    uint32_t *number = PCI_SCRATCH(scratch, uint32_t, r->coarse->vertex_count);
    if (number == NULL || !pci_halfedge_export(r->coarse, &mesh, &kept)) {
        return false;
    }
    for (uint32_t v = 0; v < mesh.vertex_count; ++v) {
        number[kept[v]] = v;
        r->feet[v] = r->feet[kept[v]]; // kept ascends
        r->pinned[v] = r->pinned[kept[v]];
    }
    for (size_t v = 0; v < r->fine->vertex_count; ++v) {
        uint32_t at = nearby[v];
        while (m->parent[at] != at) {
            at = m->parent[at];
        }
        nearby[v] = number[at];
    }
    const bool built = pci_halfedge_build(scratch, &mesh, r->coarse);
    pc_mesh_free(scratch->context, &mesh);
    return built;
}

bool pci_improve(pci_scratch *scratch, pci_relaxation *r, double spacing, uint32_t *nearby) {
    const size_t vertices = r->coarse->vertex_count;
    improvement m = {.r = r,
                     .spacing = spacing,
                     .wanted = r->coarse->live_vertices,
                     .capacity = vertices + vertices / 2 + 16};
    uint32_t *feet = PCI_SCRATCH(scratch, uint32_t, m.capacity);
    uint8_t *pinned = PCI_SCRATCH(scratch, uint8_t, m.capacity);
    m.parent = PCI_SCRATCH(scratch, uint32_t, m.capacity);
    m.rests = PCI_SCRATCH(scratch, uint8_t, m.capacity);
    if (scratch->failed) {
        return false;
    }
    memcpy(feet, r->feet, vertices * sizeof(*feet));
    memcpy(pinned, r->pinned, vertices * sizeof(*pinned));
    for (uint32_t v = 0; v < vertices; ++v) {
        m.parent[v] = v;
    }
    r->feet = feet;
    r->pinned = pinned;
    for (size_t round = 0; round < rounds; ++round) {
        size_t bad = 0;
        if (!treat_all(scratch, &m, &bad) || !balance(scratch, &m)) {
            return false;
        }
        if (bad == 0) {
            break;
        }
        if (pci_relax_flip(r) > 0) {
            memset(m.rests, 0, m.capacity);
        }
    }
    return renumber(scratch, &m, nearby);
}

// ---- off the surface --------------------------------------------------------------------------

// Tries steps in all directions of a cube's corners, faces' and edges' middles.
static bool widen(pci_relaxation *r, uint32_t v, const double origin[3], double reach) {
    double *at = &r->coarse->positions[3 * (size_t)v];
    const pci_fan_shape before = pci_shape_of_fan(r, v);
    pci_fan_shape best = before;
    double step = 0.5 * reach;
    for (size_t level = 0; level < 3; ++level, step *= 0.5) {
        const double start[3] = {at[0], at[1], at[2]};
        double better[3] = {at[0], at[1], at[2]};
        for (int direction = 0; direction < 27; ++direction) {
            const double way[3] = {direction % 3 - 1, direction / 3 % 3 - 1, direction / 9 - 1};
            const double length = pci_norm(way);
            if (!(length > 0.0)) {
                continue;
            }
            for (size_t k = 0; k < 3; ++k) {
                at[k] = start[k] + step / length * way[k];
            }
            if (pci_squared_distance(at, origin) <= reach * reach) {
                if (has_better_shape(r, v, &best)) {
                    memcpy(better, at, sizeof(better));
                }
            }
        }
        memcpy(at, better, sizeof(better));
    }
    return best.angle > before.angle;
}

bool pci_widen_slivers(pci_scratch *scratch, pci_relaxation *r, double reach) {
    static const size_t passes = PCI_EFFORT(8, 1);
    static const double wide_angle = 24.0;
    const size_t vertices = r->coarse->vertex_count;
    double *origins = PCI_SCRATCH(scratch, double, 3 * vertices);
    if (origins == NULL) {
        return false;
    }
    memcpy(origins, r->coarse->positions, 3 * vertices * sizeof(*origins));
    bool moved = true;
    for (size_t pass = 0; pass < passes && moved; ++pass) {
        moved = false;
        for (uint32_t v = 0; v < vertices; ++v) {
            if (pci_shape_of_fan(r, v).angle < wide_angle) {
                moved |= widen(r, v, &origins[3 * (size_t)v], reach);
            }
        }
    }
    return true;
}
