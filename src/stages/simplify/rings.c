#include "stages/simplify/rings.h"

#include <stdlib.h>

#include "core/heap.h"
#include "stages/simplify/tube_map.h"

// Clusters around a tube. Wider ones are no tubes for the number of vertices, narrower ones get
// what the topology needs.
static const double narrowest = 1.9, widest = 5.5;
static const size_t least_around = 3;
// The longest and shortest cell along a tube, in its width.
static const double longest_cell = 1.15, shortest_cell = 0.9;
// A tube ends where its circumference grows faster than this per length; a round cone of this slope
// opens by 20 degrees.
static const double steepest = 1.1;
// Levels of the distance to the opening per cluster, and the levels over which growth is judged.
static const double levels_per_edge = 4.0;
static const size_t growth_levels = 3;
// A tube is at least this many levels long.
static const size_t least_levels = 4;
// Clusters between a tube and another opening or tube.
static const double margin = 1.0;
// Tubes are given up until the rest has so much of the vertices that the scales give it.
static const double least_rest = 0.8;
// Counts of clusters that differ by less become equal from one tube to the next.
static const double nearly_alike = 0.75;
enum { phases = 8 };

typedef struct layout {
    size_t around, rows; // clusters around; rings but the one at the opening
    double phase;        // of a cluster, where the first one begins
} layout;

typedef struct search {
    pci_scratch *scratch; // of this loop
    const pci_sampling *s;
    size_t vertices;
    double spacing; // edge length where the scale is 1
    double density; // vertices per area where the scale is 1
    uint32_t *loop_of;
    const uint32_t *claimed; // clusters of the tubes found so far
    double *distances;       // #V, to the opening
    uint32_t *reached;       // vertices with a distance
    size_t reached_count;
    double reach;  // distances are complete up to here
    pci_tube tube; // the one that is looked at
    layout last;   // of the tube found last: the other sleeve, often
} search;

static double length_between(const pci_halfedge *mesh, size_t a, size_t b) {
    return sqrt(pci_squared_distance(&mesh->positions[3 * a], &mesh->positions[3 * b]));
}

// ---- the reach of a tube ------------------------------------------------------------------------

static bool reach_vertex(search *t, pci_heap *front, uint32_t v, double distance) {
    if (t->distances[v] == HUGE_VAL) {
        t->reached[t->reached_count++] = v;
    }
    t->distances[v] = distance;
    return pci_heap_push(t->scratch, front, distance, v);
}

// Distances along edges from the opening at `start`, up to another opening or tube, or to where the
// front is too long. False: out of memory.
static bool measure_distances(search *t, uint32_t start, double edge) {
    const pci_halfedge *mesh = &t->s->mesh;
    const uint32_t loop = t->loop_of[start];
    const double step = edge / levels_per_edge;
    pci_heap front = {0};
    for (; t->reached_count > 0; --t->reached_count) { // of the opening before
        t->distances[t->reached[t->reached_count - 1]] = HUGE_VAL;
    }
    for (uint32_t v = start; t->distances[v] == HUGE_VAL; v = pci_target(mesh, mesh->outgoing[v])) {
        if (!reach_vertex(t, &front, v, 0.0)) {
            return false;
        }
    }
    double band = 0.0, level = step; // area between two levels
    pci_heap_entry entry;
    t->reach = 0.0;
    while (pci_heap_pop(&front, &entry)) {
        const uint32_t v = entry.item;
        if (entry.key > t->distances[v]) {
            continue;
        }
        const bool foreign = t->claimed[v] != PC_INVALID_INDEX ||
                             (t->loop_of[v] != PC_INVALID_INDEX && t->loop_of[v] != loop);
        if (foreign) {
            t->reach = fmax(0.0, entry.key - margin * edge);
            return true;
        }
        if (entry.key > level) {
            if (band > 2.0 * widest * edge * step && level > edge) {
                break;
            }
            band = 0.0;
            level = fmax(level + step, entry.key);
        }
        t->reach = entry.key;
        band += t->s->areas[v];
        PCI_FOR_OUTGOING(mesh, v, h) {
            const uint32_t ends[2] = {pci_target(mesh, h), mesh->corners[pci_previous(h)]};
            for (size_t i = 0; i < 2; ++i) {
                const double distance = entry.key + length_between(mesh, v, ends[i]);
                if (distance < t->distances[ends[i]] &&
                    !reach_vertex(t, &front, ends[i], distance)) {
                    return false;
                }
            }
        }
    }
    return true;
}

static bool spread(search *t, uint32_t start, double edge) {
    const pci_halfedge *mesh = &t->s->mesh;
    for (; t->tube.near_count > 0; --t->tube.near_count) { // of the opening before
        t->tube.inside[t->tube.near[t->tube.near_count - 1]] = 0;
    }
    if (!measure_distances(t, start, edge)) {
        return false;
    }
    for (size_t i = 0; i < t->reached_count; ++i) {
        const uint32_t v = t->reached[i];
        PCI_FOR_OUTGOING(mesh, v, h) {
            const uint32_t b = pci_target(mesh, h), c = mesh->corners[pci_previous(h)];
            if (v < b && v < c && t->distances[b] < HUGE_VAL && t->distances[c] < HUGE_VAL) {
                t->tube.near[t->tube.near_count++] = h / 3;
            }
        }
    }
    return true;
}

// Where the line of equal values passes through an edge.
static void cross_edge(const pci_halfedge *mesh, const double *values, uint32_t a, uint32_t b,
                       double value, double point[3]) {
    const double share = (value - values[a]) / (values[b] - values[a]);
    for (size_t k = 0; k < 3; ++k) {
        point[k] =
            mesh->positions[3 * (size_t)a + k] +
            share * (mesh->positions[3 * (size_t)b + k] - mesh->positions[3 * (size_t)a + k]);
    }
}

// Adds the triangle's part of each line of equal distance to the lengths of the lines.
static void add_lines(const search *t, const uint32_t *corner, double step, size_t levels,
                      double *lengths) {
    const double *d = t->distances;
    const double low = fmin(fmin(d[corner[0]], d[corner[1]]), d[corner[2]]);
    const double high = fmax(fmax(d[corner[0]], d[corner[1]]), d[corner[2]]);
    const double first = ceil(low / step);
    if (!(high <= t->reach && first < (double)levels)) {
        return;
    }
    for (size_t k = (size_t)first; k < levels && (double)k * step < high; ++k) {
        const double value = (double)k * step;
        double ends[2][3];
        size_t found = 0;
        for (size_t c = 0; c < 3 && found < 2; ++c) {
            const uint32_t a = corner[c], b = corner[(c + 1) % 3];
            if ((d[a] > value) != (d[b] > value)) {
                cross_edge(&t->s->mesh, d, a, b, value, ends[found++]);
            }
        }
        if (found == 2) {
            lengths[k] += sqrt(pci_squared_distance(ends[0], ends[1]));
        }
    }
}

// The number of levels up to which the circumference grows slowly. False: out of memory.
static bool count_levels(search *t, double step, double widest_length, size_t *count) {
    const pci_halfedge *mesh = &t->s->mesh;
    // No more than the vertices suffice for, even where edges are expected to be next to nothing.
    const double most = 2.0 * levels_per_edge * (double)t->vertices;
    const size_t levels = (size_t)fmin(t->reach / step, most) + 1;
    double *lengths = PCI_SCRATCH(t->scratch, double, levels);
    if (lengths == NULL) {
        return false;
    }
    for (size_t i = 0; i < t->tube.near_count; ++i) {
        add_lines(t, &mesh->corners[3 * (size_t)t->tube.near[i]], step, levels, lengths);
    }
    size_t k = 1;
    for (; k < levels; ++k) {
        const double growth = steepest * step * (double)growth_levels;
        if (!(lengths[k] > 0.0) || lengths[k] > widest_length ||
            (k > growth_levels && lengths[k] - lengths[k - growth_levels] > growth)) {
            break;
        }
    }
    *count = k > growth_levels ? k - 1 - growth_levels : 0;
    return true;
}

// ---- the shape of a tube ------------------------------------------------------------------------

enum { OUTSIDE, INSIDE, HOLE };

static bool reaches_out(const search *t, uint32_t f) {
    for (uint32_t c = 0; c < 3; ++c) {
        if (t->distances[t->s->mesh.corners[3 * f + c]] >= t->reach) {
            return true;
        }
    }
    return false;
}

// Takes the triangles nearer than `limit`, and what they enclose.
static void take_triangles(search *t, double limit) {
    const pci_halfedge *mesh = &t->s->mesh;
    size_t count = 0;
    for (size_t i = 0; i < t->tube.near_count; ++i) {
        const uint32_t f = t->tube.near[i], *corner = &mesh->corners[3 * (size_t)f];
        const bool nearer = t->distances[corner[0]] < limit && t->distances[corner[1]] < limit &&
                            t->distances[corner[2]] < limit;
        t->tube.inside[f] = nearer ? INSIDE : reaches_out(t, f) ? OUTSIDE : HOLE;
        if (t->tube.inside[f] == OUTSIDE) {
            t->tube.queue[count++] = f;
        }
    }
    for (size_t next = 0; next < count; ++next) {
        for (uint32_t c = 0; c < 3; ++c) {
            const uint32_t twin = mesh->twins[3 * t->tube.queue[next] + c];
            if (twin != PC_INVALID_INDEX && t->tube.inside[twin / 3] == HOLE) {
                t->tube.inside[twin / 3] = OUTSIDE;
                t->tube.queue[count++] = twin / 3;
            }
        }
    }
}

// Takes the triangles nearer than `limit` and lists their vertices.
static void take_inside(search *t, double limit) {
    const pci_halfedge *mesh = &t->s->mesh;
    take_triangles(t, limit);
    for (size_t i = 0; i < 3 * t->tube.near_count; ++i) {
        t->tube.local[mesh->corners[pci_near_halfedge(&t->tube, i)]] = PC_INVALID_INDEX;
    }
    t->tube.member_count = 0;
    for (size_t i = 0; i < 3 * t->tube.near_count; ++i) {
        const uint32_t v = mesh->corners[pci_near_halfedge(&t->tube, i)];
        if (t->tube.inside[t->tube.near[i / 3]] && t->tube.local[v] == PC_INVALID_INDEX) {
            t->tube.local[v] = (uint32_t)t->tube.member_count;
            t->tube.members[t->tube.member_count++] = v;
        }
    }
}

// Whether the triangles inside are an annulus between the opening and the rest.
static bool is_annulus(const search *t, uint32_t loop) {
    const pci_halfedge *mesh = &t->s->mesh;
    size_t faces = 0, rim = 0, far_rim = 0;
    for (size_t i = 0; i < 3 * t->tube.near_count; ++i) {
        const uint32_t h = pci_near_halfedge(&t->tube, i);
        if (!t->tube.inside[h / 3]) {
            continue;
        }
        const uint32_t v = mesh->corners[h];
        if (t->claimed[v] != PC_INVALID_INDEX ||
            (t->loop_of[v] != PC_INVALID_INDEX && t->loop_of[v] != loop)) {
            return false;
        }
        faces += h % 3 == 0;
        if (pci_is_tube_rim(&t->tube, h)) {
            const bool opening = mesh->twins[h] == PC_INVALID_INDEX;
            ++rim;
            far_rim += !opening;
            if (!opening && (t->loop_of[v] == loop || t->loop_of[pci_target(mesh, h)] == loop)) {
                return false;
            }
        }
    }
    return far_rim > 0 && 2 * t->tube.member_count + 2 * faces == 3 * faces + rim;
}

// ---- rings --------------------------------------------------------------------------------------

// The nearest number, or the one that the other sleeve or leg got if it is near.
static size_t round_alike(double value, size_t other) {
    return fabs(value - (double)other) < nearly_alike ? other : (size_t)(value + 0.5);
}

// How many clusters the tube gets around and along; none around: it is no tube for so many.
static layout choose_layout(const search *t) {
    double share = 0.0; // vertices that the scales give
    for (size_t i = 0; i < t->tube.member_count; ++i) {
        const size_t v = t->tube.members[i];
        share += t->density * t->s->areas[v] * t->s->scales[v] * t->s->scales[v];
    }
    layout l = {0};
    // Equilateral triangles of that many vertices have edges of this part of the circumference.
    const double even = sqrt(0.5 * sqrt(3.0) * share * t->tube.flux);
    if (!(even > narrowest && even < widest)) {
        return l;
    }
    const size_t rounded = round_alike(even, t->last.around);
    const double around = (double)(rounded > least_around ? rounded : least_around);
    const double squares = around / t->tube.flux; // along the tube
    const double rows = fmin(fmax(share / around - 0.5, squares / longest_cell - 0.5),
                             squares / shortest_cell - 0.5);
    if (rows >= 0.75) {
        l.around = (size_t)around;
        l.rows = round_alike(rows, l.around == t->last.around ? t->last.rows : 0);
    }
    return l;
}

static size_t cell_of(const search *t, const layout *l, size_t i) {
    const double ring = floor(t->tube.along[i] * ((double)l->rows + 0.5) + 0.5);
    const double turn = t->tube.around[i] / (2.0 * PCI_PI) * (double)l->around + l->phase;
    const size_t sector = (size_t)((long)floor(turn + 0.5) + 2 * (long)l->around) % l->around;
    const size_t row = (size_t)fmin(fmax(ring, 0.0), (double)l->rows);
    return row * l->around + sector;
}

// Sum of the squared distances of the cells' centroids from those of their rings: corners belong
// where the tube is widest. Negative: a cell is empty. False: out of memory.
static bool judge_layout(search *t, const layout *l, double *spread_out) {
    const size_t cells = l->around * (l->rows + 1);
    double *sums = PCI_SCRATCH(t->scratch, double, 4 * cells);
    if (sums == NULL) {
        return false;
    }
    for (size_t i = 0; i < t->tube.member_count; ++i) {
        double *sum = &sums[4 * cell_of(t, l, i)];
        const size_t v = t->tube.members[i];
        sum[3] += t->s->areas[v];
        for (size_t k = 0; k < 3; ++k) {
            sum[k] += t->s->areas[v] * t->s->mesh.positions[3 * v + k];
        }
    }
    *spread_out = 0.0;
    for (size_t ring = 0; ring <= l->rows; ++ring) {
        double centre[3] = {0.0, 0.0, 0.0};
        for (size_t j = 0; j < l->around; ++j) {
            double *sum = &sums[4 * (ring * l->around + j)];
            if (!(sum[3] > 0.0)) {
                *spread_out = -1.0;
                return true;
            }
            for (size_t k = 0; k < 3; ++k) {
                sum[k] /= sum[3];
                centre[k] += sum[k] / (double)l->around;
            }
        }
        for (size_t j = 0; j < l->around; ++j) {
            *spread_out += pci_squared_distance(&sums[4 * (ring * l->around + j)], centre);
        }
    }
    return true;
}

// Turns the rings to where they fit best. `spread_out` is negative when a cell is empty.
static bool choose_phase(search *t, layout *l, size_t turn, double *spread_out) {
    size_t best = 0;
    *spread_out = -1.0;
    for (size_t i = 0; i < phases; ++i) {
        double found = 0.0;
        l->phase = (double)i / (double)phases;
        if (!judge_layout(t, l, &found)) {
            return false;
        }
        if (found > *spread_out) {
            *spread_out = found;
            best = i;
        }
    }
    l->phase = (double)((best + turn) % phases) / (double)phases;
    return turn == 0 || judge_layout(t, l, spread_out);
}

static void add_rings(const search *t, const layout *l, pci_rings *rings) {
    const uint32_t first = (uint32_t)rings->count, around = (uint32_t)l->around;
    for (size_t i = 0; i < t->tube.member_count; ++i) {
        rings->cluster[t->tube.members[i]] = first + (uint32_t)cell_of(t, l, i);
    }
    for (uint32_t ring = 0; ring <= l->rows; ++ring) {
        for (uint32_t j = 0; j < around; ++j) {
            const uint32_t cell = first + ring * around + j;
            rings->aside[cell] = first + ring * around + (j + 1) % around;
            rings->ahead[cell] = ring < l->rows ? cell + around : PC_INVALID_INDEX;
        }
    }
    rings->count += l->around * (l->rows + 1);
}

// ---- the search ---------------------------------------------------------------------------------

// Adds the tube behind an opening, if there is one. False: out of memory or cancelled.
static bool try_loop(search *t, uint32_t start, double edge, size_t turn, pci_rings *rings) {
    const double step = edge / levels_per_edge;
    const uint32_t loop = t->loop_of[start];
    size_t level = 0;
    if (!spread(t, start, edge) || !count_levels(t, step, (widest + 1.5) * edge, &level)) {
        return false;
    }
    if (level < least_levels) {
        return true;
    }
    take_inside(t, (double)level * step);
    if (!is_annulus(t, loop)) {
        return true;
    }
    if (!pci_map_to_cylinder(t->scratch, &t->tube, t->loop_of, loop)) {
        return false;
    }
    layout l = t->tube.flux > 0.0 ? choose_layout(t) : (layout){0};
    double spread_out = 0.0;
    if (l.around == 0 || rings->count + l.around * (l.rows + 1) > t->vertices) {
        return true;
    }
    if (!choose_phase(t, &l, turn, &spread_out)) {
        return false;
    }
    if (spread_out >= 0.0) {
        add_rings(t, &l, rings);
        t->last = l;
    }
    return true;
}

typedef struct opening {
    double length, scale;
    uint32_t start; // vertex
} opening;

static int compare_openings(const void *a, const void *b) { // shortest first
    const opening *x = a, *y = b;
    if (x->length != y->length) {
        return x->length < y->length ? -1 : 1;
    }
    return (x->start > y->start) - (x->start < y->start);
}

// Numbers the openings in loop_of and measures them; `openings` has room for all border vertices.
static size_t list_openings(search *t, opening *openings) {
    const pci_halfedge *mesh = &t->s->mesh;
    size_t count = 0;
    memset(t->loop_of, 0xff, mesh->vertex_count * sizeof(*t->loop_of));
    for (uint32_t start = 0; start < mesh->vertex_count; ++start) {
        if (mesh->outgoing[start] == PC_INVALID_INDEX || !pci_is_border_vertex(mesh, start) ||
            t->loop_of[start] != PC_INVALID_INDEX) {
            continue;
        }
        opening *o = &openings[count];
        *o = (opening){.start = start};
        size_t vertices = 0;
        for (uint32_t v = start; t->loop_of[v] == PC_INVALID_INDEX; ++vertices) {
            const uint32_t next = pci_target(mesh, mesh->outgoing[v]);
            t->loop_of[v] = (uint32_t)count;
            o->length += length_between(mesh, v, next);
            o->scale += t->s->scales[v];
            v = next;
        }
        o->scale /= (double)vertices;
        ++count;
    }
    return count;
}

// Gives up the tubes found last until the rest keeps enough vertices.
static void leave_rest(const search *t, const size_t *ends, size_t tubes, pci_rings *rings) {
    for (;; --tubes) {
        double share = 0.0;
        for (size_t v = 0; v < t->s->mesh.vertex_count; ++v) {
            const double scale = t->s->scales[v];
            share += rings->cluster[v] == PC_INVALID_INDEX
                         ? t->density * t->s->areas[v] * scale * scale
                         : 0.0;
        }
        const double rest = (double)t->vertices - (double)rings->count;
        if (tubes == 0 || rest >= fmax(least_rest * share, 4.0)) {
            return;
        }
        rings->count = tubes > 1 ? ends[tubes - 2] : 0;
        for (size_t v = 0; v < t->s->mesh.vertex_count; ++v) {
            if (rings->cluster[v] != PC_INVALID_INDEX && rings->cluster[v] >= rings->count) {
                rings->cluster[v] = PC_INVALID_INDEX;
            }
        }
    }
}

static bool prepare(pci_scratch *scratch, search *t, pci_rings *rings) {
    const size_t nv = t->s->mesh.vertex_count, nf = t->s->mesh.triangle_count;
    *rings = (pci_rings){0};
    rings->cluster = PCI_SCRATCH(scratch, uint32_t, nv);
    rings->aside = PCI_SCRATCH(scratch, uint32_t, t->vertices);
    rings->ahead = PCI_SCRATCH(scratch, uint32_t, t->vertices);
    t->loop_of = PCI_SCRATCH(scratch, uint32_t, nv);
    t->distances = PCI_SCRATCH(scratch, double, nv);
    t->reached = PCI_SCRATCH(scratch, uint32_t, nv);
    t->tube.near = PCI_SCRATCH(scratch, uint32_t, nf);
    t->tube.inside = PCI_SCRATCH(scratch, uint8_t, nf);
    t->tube.queue = PCI_SCRATCH(scratch, uint32_t, nf);
    t->tube.angles = PCI_SCRATCH(scratch, double, nf);
    t->tube.local = PCI_SCRATCH(scratch, uint32_t, nv);
    t->tube.members = PCI_SCRATCH(scratch, uint32_t, nv);
    if (scratch->failed) {
        return false;
    }
    memset(rings->cluster, 0xff, nv * sizeof(*rings->cluster));
    t->claimed = rings->cluster;
    double scaled_area = 0.0;
    for (size_t v = 0; v < nv; ++v) {
        t->distances[v] = HUGE_VAL;
        scaled_area += t->s->areas[v] * t->s->scales[v] * t->s->scales[v];
    }
    t->density = (double)t->vertices / scaled_area;
    t->spacing = sqrt(2.0 / sqrt(3.0) / t->density);
    return true;
}

bool pci_find_rings(pci_scratch *scratch, const pci_sampling *sampling, size_t vertices,
                    size_t turn, pci_rings *rings) {
    search t = {.s = sampling, .vertices = vertices, .tube = {.mesh = &sampling->mesh}};
    opening *openings = PCI_SCRATCH(scratch, opening, sampling->mesh.vertex_count);
    size_t *ends = PCI_SCRATCH(scratch, size_t, sampling->mesh.vertex_count);
    if (scratch->failed || !prepare(scratch, &t, rings)) {
        return false;
    }
    const size_t count = list_openings(&t, openings);
    size_t tubes = 0;
    qsort(openings, count, sizeof(*openings), compare_openings);
    for (size_t i = 0; i < count; ++i) {
        const double edge = t.spacing / openings[i].scale;
        const size_t before = rings->count;
        if (openings[i].length > (widest + 1.5) * edge) {
            continue;
        }
        pci_scratch inner = pci_scratch_begin(scratch->context);
        t.scratch = &inner;
        const bool done = try_loop(&t, openings[i].start, edge, turn, rings);
        pci_scratch_end(&inner);
        if (!done) {
            return false;
        }
        if (rings->count > before) {
            ends[tubes++] = rings->count;
        }
    }
    leave_rest(&t, ends, tubes, rings);
    return true;
}

// ---- laces --------------------------------------------------------------------------------------

// Turns the diagonal of the quad around a, b, c, d so that it joins a and c.
static void join_corners(pci_halfedge *coarse, uint32_t a, uint32_t b, uint32_t c, uint32_t d) {
    uint32_t wrong = PC_INVALID_INDEX;
    PCI_FOR_OUTGOING(coarse, b, h) { wrong = pci_target(coarse, h) == d ? h : wrong; }
    if (wrong == PC_INVALID_INDEX || coarse->twins[wrong] == PC_INVALID_INDEX) {
        return;
    }
    const uint32_t tips[2] = {coarse->corners[pci_previous(wrong)],
                              coarse->corners[pci_previous(coarse->twins[wrong])]};
    const bool between = (tips[0] == a && tips[1] == c) || (tips[0] == c && tips[1] == a);
    if (between && pci_can_flip(coarse, wrong)) {
        pci_flip(coarse, wrong);
    }
}

bool pci_lace_rings(pci_scratch *scratch, const pci_rings *rings, const uint32_t *nearby,
                    pci_relaxation *relaxation) {
    uint32_t *vertex = PCI_SCRATCH(scratch, uint32_t, rings->count);
    uint8_t *torn = PCI_SCRATCH(scratch, uint8_t, rings->count);
    if (scratch->failed || rings->count == 0) {
        return !scratch->failed;
    }
    memset(vertex, 0xff, rings->count * sizeof(*vertex));
    for (size_t v = 0; v < relaxation->fine->vertex_count; ++v) {
        const uint32_t cell = rings->cluster[v];
        if (cell != PC_INVALID_INDEX) {
            torn[cell] |= vertex[cell] != PC_INVALID_INDEX && vertex[cell] != nearby[v];
            vertex[cell] = nearby[v];
        }
    }
    for (size_t cell = 0; cell < rings->count; ++cell) {
        if (!torn[cell]) {
            relaxation->pinned[vertex[cell]] = PCI_RINGED;
        }
    }
    for (size_t cell = 0; cell < rings->count; ++cell) {
        const size_t aside = rings->aside[cell];
        if (rings->ahead[cell] == PC_INVALID_INDEX) {
            continue;
        }
        const size_t ahead = rings->ahead[cell], across = rings->ahead[aside];
        if (torn[cell] || torn[aside] || torn[ahead] || torn[across]) {
            continue;
        }
        const uint32_t quad[4] = {vertex[cell], vertex[aside], vertex[across], vertex[ahead]};
        const bool shorter = length_between(relaxation->coarse, quad[0], quad[2]) <
                             length_between(relaxation->coarse, quad[1], quad[3]);
        const size_t from = shorter ? 0 : 1;
        join_corners(relaxation->coarse, quad[from], quad[from + 1], quad[from + 2],
                     quad[(from + 3) % 4]);
    }
    return true;
}
