#include "stages/simplify/separate.h"

#include "geometry/crossing.h"
#include "stages/simplify/improve.h"

static const size_t passes = PCI_EFFORT(24, 2);
// Flawed triangles beyond which a search would take too long. Boxes compared in all, at least and
// for each triangle: what can be separated takes a tenth of that.
static const size_t most_flawed = 512;
static const size_t least_work = PCI_EFFORT(4000000, 100), work = PCI_EFFORT(8000, 10);
// A little more than is asked for, so that rounding does not matter.
static const double wanted_angle = PCI_LEAST_ANGLE + 0.1;
// Cost of a pair that crosses, beside the length in expected edges; of a step of one edge length.
static const double crossing_cost = 0.3;
static const double step_cost = 0.03;
static const double least_gain = 1e-6;

typedef struct box {
    double low[3], high[3];
} box;

typedef struct separation {
    pci_relaxation *relaxation;
    pc_mesh mesh; // the same positions and triangles
    double spacing;
    uint32_t *fan;    // triangles that the vertices of the move belong to
    uint32_t *nearby; // others in their reach
    size_t fan_count, nearby_count;
    box *fan_boxes, *nearby_boxes; // around each
    uint8_t *in_fan;               // per triangle
    uint8_t *flawed;               // per triangle
    size_t work_left;              // boxes
} separation;

// ---- cost of some triangles ---------------------------------------------------------------------

static const box nothing = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};

static void grow(box *b, const double point[3]) {
    for (size_t k = 0; k < 3; ++k) {
        b->low[k] = point[k] < b->low[k] ? point[k] : b->low[k];
        b->high[k] = point[k] > b->high[k] ? point[k] : b->high[k];
    }
}

static box triangle_box(const separation *s, uint32_t t) {
    box b = nothing;
    for (size_t c = 0; c < 3; ++c) {
        grow(&b, &s->mesh.positions[3 * (size_t)s->mesh.triangles[3 * (size_t)t + c]]);
    }
    return b;
}

static bool boxes_meet(const box *a, const box *b, double margin) {
    for (size_t k = 0; k < 3; ++k) {
        if (a->low[k] > b->high[k] + margin || b->low[k] > a->high[k] + margin) {
            return false;
        }
    }
    return true;
}

static void spend(separation *s, size_t boxes) {
    s->work_left -= boxes < s->work_left ? boxes : s->work_left;
}

// Of a triangle of the fan with some others.
static double pairs_cost(separation *s, size_t in_fan, size_t count, const uint32_t *others,
                         const box *boxes) {
    double cost = 0.0;
    spend(s, count);
    for (size_t i = 0; i < count; ++i) {
        if (boxes_meet(&s->fan_boxes[in_fan], &boxes[i], 0.0)) {
            const double length = pci_pair_crossing_length(&s->mesh, s->fan[in_fan], others[i]);
            cost += length > 0.0 ? crossing_cost + length / s->spacing : 0.0;
        }
    }
    return cost;
}

// What is wrong with the triangles of the fan; some number not below `enough` when it is that much.
// `turned` receives how many look away from the fine surface.
static double fan_cost(separation *s, double enough, size_t *turned) {
    double cost = 0.0;
    *turned = 0;
    for (size_t i = 0; i < s->fan_count; ++i) {
        const pci_fan_shape shape = pci_shape_of_triangle(s->relaxation, s->fan[i]);
        cost += fmax(1.0 - shape.angle / wanted_angle, 0.0);
        *turned += shape.turned;
        s->fan_boxes[i] = triangle_box(s, s->fan[i]);
    }
    for (size_t i = 0; i < s->fan_count && cost < enough; ++i) {
        cost += pairs_cost(s, i, s->fan_count - i - 1, &s->fan[i + 1], &s->fan_boxes[i + 1]);
        cost += pairs_cost(s, i, s->nearby_count, s->nearby, s->nearby_boxes);
    }
    return cost;
}

// Lists the triangles within `margin` of the fan that do not belong to it.
static void find_nearby(separation *s, double margin) {
    box around = nothing;
    for (size_t i = 0; i < s->fan_count; ++i) {
        const box b = triangle_box(s, s->fan[i]);
        grow(&around, b.low);
        grow(&around, b.high);
        s->in_fan[s->fan[i]] = 1;
    }
    s->nearby_count = 0;
    for (uint32_t t = 0; t < s->mesh.triangle_count; ++t) {
        const box b = triangle_box(s, t);
        if (!s->in_fan[t] && boxes_meet(&around, &b, margin)) {
            s->nearby_boxes[s->nearby_count] = b;
            s->nearby[s->nearby_count++] = t;
        }
    }
    for (size_t i = 0; i < s->fan_count; ++i) {
        s->in_fan[s->fan[i]] = 0;
    }
    spend(s, s->mesh.triangle_count);
}

static void find_fan(separation *s, const uint32_t *vertices, size_t count) {
    s->fan_count = 0;
    for (size_t i = 0; i < count; ++i) {
        PCI_FOR_OUTGOING(s->relaxation->coarse, vertices[i], h) {
            if (!s->in_fan[h / 3]) {
                s->in_fan[h / 3] = 1;
                s->fan[s->fan_count++] = h / 3;
            }
        }
    }
}

// ---- moves --------------------------------------------------------------------------------------

// Moves some vertices together to where that costs least. True: they moved.
static bool move_together(separation *s, const uint32_t *vertices, size_t count) {
    enum { directions = 27 };
    static const double reaches[] = {0.03, 0.06, 0.12, 0.2, 0.3, 0.45, 0.7, 1.0};
    static const size_t reach_count = sizeof(reaches) / sizeof(reaches[0]);
    find_fan(s, vertices, count);
    find_nearby(s, s->spacing);
    size_t turned = 0, most_turned = 0;
    const double before = fan_cost(s, INFINITY, &most_turned);
    double start[3][3], better[3] = {0.0}, best = before - least_gain;
    for (size_t i = 0; i < count; ++i) {
        memcpy(start[i], &s->mesh.positions[3 * (size_t)vertices[i]], sizeof(start[i]));
    }
    for (size_t i = 0; i < reach_count * directions; ++i) {
        const int direction = (int)(i % directions);
        const double way[3] = {direction % 3 - 1, direction / 3 % 3 - 1, direction / 9 - 1};
        const double length = pci_norm(way), reach = reaches[i / directions];
        if (!(length > 0.0) || step_cost * reach >= best) {
            continue;
        }
        for (size_t k = 0; k < 3 * count; ++k) {
            s->mesh.positions[3 * (size_t)vertices[k / 3] + k % 3] =
                start[k / 3][k % 3] + reach * s->spacing / length * way[k % 3];
        }
        const double cost = step_cost * reach + fan_cost(s, best - step_cost * reach, &turned);
        if (cost < best && turned <= most_turned) {
            best = cost;
            for (size_t k = 0; k < 3; ++k) {
                better[k] = reach * s->spacing / length * way[k];
            }
        }
    }
    for (size_t k = 0; k < 3 * count; ++k) {
        s->mesh.positions[3 * (size_t)vertices[k / 3] + k % 3] =
            start[k / 3][k % 3] + better[k % 3];
    }
    return best < before - least_gain;
}

// Flips the edge if that costs less.
static bool flip(separation *s, uint32_t h) {
    pci_halfedge *coarse = s->relaxation->coarse;
    if (!pci_can_flip(coarse, h)) {
        return false;
    }
    const uint32_t g = coarse->twins[h];
    uint32_t *first = &coarse->corners[h - h % 3], *second = &coarse->corners[g - g % 3];
    const uint32_t a = pci_origin(coarse, h), b = pci_target(coarse, h);
    const uint32_t c = coarse->corners[pci_previous(h)], d = coarse->corners[pci_previous(g)];
    const uint32_t old[2][3] = {{first[0], first[1], first[2]}, {second[0], second[1], second[2]}};
    const uint32_t flipped[2][3] = {{a, d, c}, {d, b, c}};
    s->fan[0] = h / 3, s->fan[1] = g / 3;
    s->fan_count = 2;
    find_nearby(s, 0.0);
    size_t turned = 0, most_turned = 0;
    const double before = fan_cost(s, INFINITY, &most_turned);
    memcpy(first, flipped[0], sizeof(flipped[0]));
    memcpy(second, flipped[1], sizeof(flipped[1]));
    const double after = fan_cost(s, before, &turned);
    memcpy(first, old[0], sizeof(old[0]));
    memcpy(second, old[1], sizeof(old[1]));
    if (!(after < before - least_gain) || turned > most_turned) {
        return false;
    }
    pci_flip(coarse, h);
    return true;
}

// Tries everything at a triangle until it is without flaw. True: something changed.
static bool treat(separation *s, uint32_t t) {
    const uint32_t *corner = &s->mesh.triangles[3 * (size_t)t];
    bool changed = false;
    for (size_t move = 0; move < 10; ++move) {
        size_t turned = 0;
        s->fan[0] = t;
        s->fan_count = 1;
        find_nearby(s, 0.0);
        if (fan_cost(s, INFINITY, &turned) == 0.0 || s->work_left == 0) {
            break;
        }
        const uint32_t c = (uint32_t)(move % 3);
        const uint32_t vertices[3] = {corner[c], corner[(c + 1) % 3], corner[(c + 2) % 3]};
        changed |= move < 3 ? flip(s, 3 * t + c)
                            : move_together(s, vertices,
                                            move < 6   ? 1
                                            : move < 9 ? 2
                                                       : 3);
    }
    return changed;
}

// ---- the whole ----------------------------------------------------------------------------------

// Marks the triangles with flaws and counts the flaws. False: out of memory or cancelled.
static bool find_flaws(pc_context *context, separation *s, pci_flaws *flaws) {
    pci_scratch lists = pci_scratch_begin(context);
    uint32_t *pairs = NULL;
    const bool done = pci_list_self_intersections(&lists, &s->mesh, &pairs, &flaws->crossings) &&
                      pci_keep_going(context);
    flaws->slivers = 0;
    for (uint32_t t = 0; t < s->mesh.triangle_count && done; ++t) {
        const double angle = pci_shape_of_triangle(s->relaxation, t).angle;
        flaws->slivers += angle < PCI_LEAST_ANGLE;
        s->flawed[t] = angle < PCI_LEAST_ANGLE;
    }
    for (size_t i = 0; done && i < 2 * flaws->crossings; ++i) {
        s->flawed[pairs[i]] = 1;
    }
    pci_scratch_end(&lists);
    return done;
}

bool pci_separate(pci_scratch *scratch, pci_relaxation *relaxation, double spacing,
                  pci_flaws *flaws) {
    pci_halfedge *coarse = relaxation->coarse;
    const size_t nt = coarse->triangle_count;
    separation s = {.relaxation = relaxation,
                    .mesh = {coarse->vertex_count, coarse->positions, nt, coarse->corners},
                    .spacing = spacing,
                    .fan = PCI_SCRATCH(scratch, uint32_t, nt),
                    .nearby = PCI_SCRATCH(scratch, uint32_t, nt),
                    .fan_boxes = PCI_SCRATCH(scratch, box, nt),
                    .nearby_boxes = PCI_SCRATCH(scratch, box, nt),
                    .in_fan = PCI_SCRATCH(scratch, uint8_t, nt),
                    .flawed = PCI_SCRATCH(scratch, uint8_t, nt),
                    .work_left = least_work + work * nt};
    bool changed = true;
    for (size_t pass = 0; pass < passes && changed && !scratch->failed; ++pass) {
        if (!find_flaws(scratch->context, &s, flaws)) {
            return false;
        }
        changed = false;
        for (uint32_t t = 0; t < nt && flaws->crossings + flaws->slivers <= most_flawed; ++t) {
            changed |= s.flawed[t] && treat(&s, t);
        }
    }
    return !scratch->failed && find_flaws(scratch->context, &s, flaws);
}
