#include "geometry/notches.h"

#include <stdlib.h>

#include "geometry/halfedge.h"
#include "geometry/triangle_distance.h"

// Mouth and depth of notches that are filled, in expected edge lengths.
static const double widest = 0.5, deepest = 0.55;
// What a shorter border must save, likewise.
static const double least_gain = 0.25;
// A slit gets wider by less than this share of its border: beyond, its sides part.
static const double parting = 0.25;
// A slit turns at its tip by half a turn in all; half of that is enough.
static const double least_turning = 0.5 * PCI_PI;
// Edges that stay of a loop.
enum { least_opening = 3 };
// Share of the filling that may be turned over: edges of layers are frayed.
static const double most_turned = 0.1;

// A border loop, walked with the cloth at the left.
typedef struct loop {
    const pci_halfedge *mesh;
    size_t count;
    const uint32_t *vertices;
    uint8_t *uses; // per vertex of the mesh
} loop;

// Of what has been filled.
enum { UNUSED, END, INSIDE };

// A stretch of a loop: `length` edges from vertex `first`.
typedef struct notch {
    size_t first, length;
    double gain; // how much longer the stretch is than its chord, about
} notch;

static int compare_notches(const void *a, const void *b) { // largest gain first
    const notch *x = a, *y = b;
    if (x->gain != y->gain) {
        return x->gain > y->gain ? -1 : 1;
    }
    return (x->first > y->first) - (x->first < y->first);
}

static uint32_t vertex_at(const loop *l, size_t i) { return l->vertices[i % l->count]; }

static const double *point_at(const loop *l, size_t i) {
    return &l->mesh->positions[3 * (size_t)vertex_at(l, i)];
}

static double distance_between(const loop *l, size_t i, size_t j) {
    return sqrt(pci_squared_distance(point_at(l, i), point_at(l, j)));
}

// ---- the search ---------------------------------------------------------------------------------

static double depth_of(const loop *l, const notch *n) {
    const double *a = point_at(l, n->first), *b = point_at(l, n->first + n->length);
    double deepest_point = 0.0, bary[3];
    for (size_t i = 1; i < n->length; ++i) {
        deepest_point = fmax(
            deepest_point, pci_triangle_squared_distance(point_at(l, n->first + i), a, b, b, bary));
    }
    return sqrt(deepest_point);
}

// A stretch that grows along both sides away from a tip, abreast.
typedef struct walk {
    size_t first, last; // the former may be larger by the loop's count
    double way, chord;
} walk;

static walk begin_walk(const loop *l, size_t tip) {
    return (walk){.first = tip + l->count, .last = tip + l->count};
}

static void go_on(const loop *l, walk *w) {
    const double back = distance_between(l, w->first - 1, w->last);
    const double ahead = distance_between(l, w->first, w->last + 1);
    w->chord = fmin(back, ahead);
    w->way += back <= ahead ? distance_between(l, w->first - 1, w->first)
                            : distance_between(l, w->last, w->last + 1);
    w->first -= back <= ahead;
    w->last += back > ahead;
}

static size_t length_of(const walk *w) { return w->last - w->first; }

// Looks for the mouth of the notch at a tip: there the border is longest for its chord, and beyond
// it gains nothing. False: the sides go on, or part.
static bool find_mouth(const loop *l, size_t tip, double spacing, notch *found) {
    static const double beyond = 1.5; // mouths that are looked at
    static const double keen = 0.9;   // less than 1, so that the nearest of equal ones counts
    walk w = begin_walk(l, tip);
    double best = 0.0, mouth = 0.0;
    *found = (notch){0};
    while (2 * length_of(&w) < l->count && w.chord <= beyond * widest * spacing &&
           w.way <= (4.0 * deepest + 2.0 * widest) * spacing) {
        go_on(l, &w);
        if (keen * w.way - w.chord > best) {
            best = keen * w.way - w.chord;
            mouth = w.chord;
            *found = (notch){w.first % l->count, length_of(&w), best};
        }
    }
    return found->length > 1 && found->gain >= least_gain * spacing && mouth <= widest * spacing &&
           found->length < length_of(&w) && depth_of(l, found) <= deepest * spacing;
}

// Between an end of the stretch and the last edge of the other side: where edges are long, ends are
// seldom abreast.
static double gap_at(const loop *l, const walk *w) {
    const double *first = point_at(l, w->first), *last = point_at(l, w->last);
    double bary[3];
    return sqrt(
        fmin(pci_triangle_squared_distance(first, last, point_at(l, w->last - 1), last, bary),
             pci_triangle_squared_distance(last, first, point_at(l, w->first + 1), first, bary)));
}

// By how much the border turns along a stretch, in the cloth: half a turn around the tip of a slit,
// half a turn back around that of a tongue, also where the sides lie over each other.
static double turning_of(const loop *l, const notch *n) {
    double sum = 0.0;
    for (size_t i = 1; i < n->length; ++i) {
        const uint32_t v = vertex_at(l, n->first + i);
        double around = 0.0;
        PCI_FOR_OUTGOING(l->mesh, v, h) {
            double to[3], from[3];
            const double *p = &l->mesh->positions[3 * (size_t)v];
            pci_sub(&l->mesh->positions[3 * (size_t)pci_target(l->mesh, h)], p, to);
            pci_sub(&l->mesh->positions[3 * (size_t)l->mesh->corners[pci_previous(h)]], p, from);
            if (pci_normalize(to) && pci_normalize(from)) {
                around += acos(fmax(-1.0, fmin(1.0, pci_dot(to, from))));
            }
        }
        sum += around - PCI_PI;
    }
    return sum;
}

// Looks for the end of the slit at a tip: there its sides part, or are no longer close.
static bool find_end(const loop *l, size_t tip, double reach, notch *found) {
    walk w = begin_walk(l, tip);
    *found = (notch){0};
    while (length_of(&w) + least_opening < l->count) {
        go_on(l, &w);
        if (gap_at(l, &w) > reach) {
            break;
        }
        const double gain = parting * w.way - w.chord;
        if (gain > found->gain) {
            *found = (notch){w.first % l->count, length_of(&w), gain};
        }
    }
    return found->length > 1 && turning_of(l, found) > least_turning;
}

// Area vector of a triangle.
static void add_area(const double *a, const double *b, const double *c, double sum[3]) {
    double normal[3];
    pci_normal_of(a, b, c, normal);
    for (size_t k = 0; k < 3; ++k) {
        sum[k] += 0.5 * normal[k];
    }
}

// Normal of the cloth along the stretch.
static void find_normal(const loop *l, const notch *n, double normal[3]) {
    memset(normal, 0, 3 * sizeof(*normal));
    for (size_t i = 0; i < n->length; ++i) {
        const uint32_t *corner =
            &l->mesh->corners[l->mesh->outgoing[vertex_at(l, n->first + i)] / 3 * 3];
        add_area(&l->mesh->positions[3 * (size_t)corner[0]],
                 &l->mesh->positions[3 * (size_t)corner[1]],
                 &l->mesh->positions[3 * (size_t)corner[2]], normal);
    }
    pci_normalize(normal);
}

static bool are_joined(const pci_halfedge *mesh, uint32_t a, uint32_t b) {
    PCI_FOR_OUTGOING(mesh, a, h) {
        if (pci_target(mesh, h) == b || mesh->corners[pci_previous(h)] == b) {
            return true;
        }
    }
    return false;
}

// Triangles between both sides, from the mouth to the tip, over the shorter one of two diagonals
// each time. False: an edge is there already, or they would cover cloth, as those of slits may.
static bool zip(const loop *l, const notch *n, bool slits, uint32_t *triangles) {
    double normal[3], right = 0.0, turned = 0.0;
    size_t a = n->first, b = n->first + n->length;
    find_normal(l, n, normal);
    for (size_t t = 0; t + 1 < n->length; ++t) {
        const bool at_end = a + 2 == b;
        const bool first = at_end || distance_between(l, a + 1, b) <= distance_between(l, a, b - 1);
        const size_t apex = first ? a + 1 : b - 1;
        double area[3] = {0.0, 0.0, 0.0};
        if (are_joined(l->mesh, vertex_at(l, a), vertex_at(l, b))) {
            return false;
        }
        triangles[3 * t] = vertex_at(l, a);
        triangles[3 * t + 1] = vertex_at(l, b);
        triangles[3 * t + 2] = vertex_at(l, apex);
        add_area(point_at(l, a), point_at(l, b), point_at(l, apex), area);
        *(pci_dot(area, normal) < 0.0 ? &turned : &right) += pci_norm(area);
        a += first;
        b -= !first;
    }
    return slits || turned <= most_turned * right;
}

// ---- the whole ----------------------------------------------------------------------------------

static bool is_free(const loop *l, const notch *n) {
    bool unused = l->uses[vertex_at(l, n->first)] != INSIDE &&
                  l->uses[vertex_at(l, n->first + n->length)] != INSIDE;
    for (size_t i = 1; unused && i < n->length; ++i) {
        unused = l->uses[vertex_at(l, n->first + i)] == UNUSED;
    }
    return unused;
}

// Fills the notches of a loop, those that gain most first; returns the number of triangles then.
static size_t fill_loop(const loop *l, bool slits, double size, notch *notches, uint32_t *triangles,
                        size_t count) {
    size_t found = 0;
    for (size_t i = 0; i < l->count; ++i) {
        found += (slits ? find_end : find_mouth)(l, i, size, &notches[found]);
    }
    qsort(notches, found, sizeof(*notches), compare_notches);
    for (size_t i = 0; i < found; ++i) {
        const notch *n = &notches[i];
        if (is_free(l, n) && zip(l, n, slits, &triangles[3 * count])) {
            count += n->length - 1;
            for (size_t k = 0; k <= n->length; ++k) {
                l->uses[vertex_at(l, n->first + k)] = k % n->length == 0 ? END : INSIDE;
            }
        }
    }
    return count;
}

static bool append(pci_scratch *scratch, const uint32_t *triangles, size_t count, pc_mesh *mesh) {
    uint32_t *all = PCI_ALLOCATE(scratch->context, uint32_t, 3 * (mesh->triangle_count + count));
    if (all == NULL) {
        return false;
    }
    memcpy(all, mesh->triangles, 3 * mesh->triangle_count * sizeof(*all));
    memcpy(&all[3 * mesh->triangle_count], triangles, 3 * count * sizeof(*all));
    pc_release(scratch->context, mesh->triangles);
    mesh->triangles = all;
    mesh->triangle_count += count;
    return true;
}

static bool fill(pci_scratch *scratch, bool slits, double size, pc_mesh *mesh) {
    pci_scratch inner = pci_scratch_begin(scratch->context);
    pci_halfedge halves;
    uint32_t *vertices = PCI_SCRATCH(&inner, uint32_t, mesh->vertex_count);
    uint32_t *triangles = PCI_SCRATCH(&inner, uint32_t, 3 * mesh->vertex_count);
    uint8_t *uses = PCI_SCRATCH(&inner, uint8_t, mesh->vertex_count);
    uint8_t *visited = PCI_SCRATCH(&inner, uint8_t, mesh->vertex_count);
    notch *notches = PCI_SCRATCH(&inner, notch, mesh->vertex_count);
    bool done = !inner.failed && pci_halfedge_build(&inner, mesh, &halves);
    size_t count = 0;
    for (uint32_t start = 0; done && start < mesh->vertex_count; ++start) {
        if (halves.outgoing[start] == PC_INVALID_INDEX || visited[start] ||
            !pci_is_border_vertex(&halves, start)) {
            continue;
        }
        loop l = {&halves, 0, vertices, uses};
        for (uint32_t v = start; !visited[v]; v = pci_target(&halves, halves.outgoing[v])) {
            visited[v] = 1;
            vertices[l.count++] = v;
        }
        count = fill_loop(&l, slits, size, notches, triangles, count);
    }
    done = done && (count == 0 || append(scratch, triangles, count, mesh));
    pci_scratch_end(&inner);
    return done;
}

bool pci_fill_notches(pci_scratch *scratch, double spacing, pc_mesh *mesh) {
    return fill(scratch, false, spacing, mesh);
}

bool pci_close_slits(pci_scratch *scratch, double reach, pc_mesh *mesh) {
    return fill(scratch, true, reach, mesh);
}
