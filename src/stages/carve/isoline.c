#include "stages/carve/isoline.h"

#include "core/core.h"
#include "geometry/topology.h"

// Pieces of parallel loops.
enum { grain = 256 };

// The distance where nobody asks: no triangle is refined for it.
static const double out_of_focus = -1e30;

// The distance that is not measured, since it is within the threshold and there is no need to know;
// and where no triangle is refined for it either, far from the focus: what hides amid corners on
// the visual mesh is narrower than an edge.
static const double unmeasured = 0.0, out_of_the_way = -1.0;

// How far the nearest point of the visual mesh lies beside vertex v: the distance without its share
// along the normal.
static void measure_distance(pci_isoline *line, size_t v) {
    const double *point = &line->mesh.positions[3 * v];
    const pci_closest closest = pci_bvh_closest_near(line->visual, point, line->nearest[v]);
    line->nearest[v] = closest.triangle;
    double away[3];
    pci_sub(closest.point, point, away);
    const double height = pci_dot(away, &line->normals[3 * v]);
    line->distances[v] = sqrt(fmax(0.0, pci_dot(away, away) - height * height));
}

// No point lies farther beside the visual mesh than it is away from it.
static double within_threshold(const pci_isoline *line) { return (1.0 - 1e-9) * line->threshold; }

// The same where somebody asks. `focus`: a point of the focus that may be near; becomes one that
// is.
static void find_distance(pci_isoline *line, size_t v, uint32_t *focus) {
    const double *point = &line->mesh.positions[3 * v];
    if (line->focus != NULL && !pci_knn_within_near(line->focus, point, line->reach, focus)) {
        line->distances[v] = out_of_focus;
    } else if (line->coarse && pci_bvh_within_near(line->visual, point, within_threshold(line),
                                                   &line->nearest[v])) {
        line->distances[v] =
            line->focus == NULL || pci_knn_within_near(line->focus, point, 0.5 * line->reach, focus)
                ? unmeasured
                : out_of_the_way;
    } else {
        measure_distance(line, v);
    }
}

static void measure_first(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    pci_isoline *line = user;
    uint32_t last = PC_INVALID_INDEX, focus = PC_INVALID_INDEX;
    for (size_t v = begin; v < end; ++v) {
        line->nearest[v] = last;
        find_distance(line, v, &focus);
        last = line->nearest[v];
    }
}

// Splits an edge; the distance of the new vertex is not known yet. PC_INVALID_INDEX: out of memory.
static uint32_t split_edge(pci_isoline *line, uint32_t h, double share) {
    const size_t a = pci_origin(&line->mesh, h), b = pci_target(&line->mesh, h);
    double position[3], normal[3];
    for (size_t k = 0; k < 3; ++k) {
        position[k] = line->mesh.positions[3 * a + k] +
                      share * (line->mesh.positions[3 * b + k] - line->mesh.positions[3 * a + k]);
        normal[k] = line->normals[3 * a + k] + line->normals[3 * b + k];
    }
    pci_normalize(normal);
    const uint32_t v = pci_split_edge(&line->mesh, h, position);
    void *normals = line->normals, *distances = line->distances, *nearest = line->nearest,
         *ends = line->ends;
    pci_scratch *scratch = line->mesh.scratch;
    if (v == PC_INVALID_INDEX ||
        !pci_scratch_reserve(scratch, &normals, &line->normal_capacity, (size_t)v + 1,
                             3 * sizeof(double)) ||
        !pci_scratch_reserve(scratch, &distances, &line->distance_capacity, (size_t)v + 1,
                             sizeof(double)) ||
        !pci_scratch_reserve(scratch, &nearest, &line->nearest_capacity, (size_t)v + 1,
                             sizeof(uint32_t)) ||
        !pci_scratch_reserve(scratch, &ends, &line->end_capacity, (size_t)v + 1,
                             2 * sizeof(uint32_t))) {
        return PC_INVALID_INDEX;
    }
    line->normals = normals;
    line->distances = distances;
    line->nearest = nearest;
    line->ends = ends;
    memcpy(&line->normals[3 * (size_t)v], normal, sizeof(normal));
    line->nearest[v] = line->nearest[a];
    line->ends[2 * (size_t)v] = (uint32_t)a;
    line->ends[2 * (size_t)v + 1] = (uint32_t)b;
    return v;
}

static double squared_length(const pci_halfedge *mesh, uint32_t h) {
    return pci_squared_distance(&mesh->positions[3 * (size_t)pci_origin(mesh, h)],
                                &mesh->positions[3 * (size_t)pci_target(mesh, h)]);
}

// The longest edge of a triangle; ties go to the smaller half-edge of the pair.
static uint32_t longest_edge(const pci_halfedge *mesh, uint32_t t) {
    uint32_t best = 3 * t;
    double length = -1.0;
    for (uint32_t h = 3 * t; h < 3 * t + 3; ++h) {
        const double candidate = squared_length(mesh, h);
        const uint32_t id = h < mesh->twins[h] ? h : mesh->twins[h];
        const uint32_t best_id = best < mesh->twins[best] ? best : mesh->twins[best];
        if (candidate > length || (candidate == length && id < best_id)) {
            best = h;
            length = candidate;
        }
    }
    return best;
}

// Follows longest edges from that of a triangle to one that is the longest of both its triangles
// (Rivara). Every edge that its split makes is shorter by a fixed factor, also among triangles
// without area.
static uint32_t terminal_edge(const pci_halfedge *mesh, uint32_t h) {
    while (mesh->twins[h] != PC_INVALID_INDEX) {
        const uint32_t next = longest_edge(mesh, mesh->twins[h] / 3);
        if (next == mesh->twins[h]) {
            break;
        }
        h = next;
    }
    return h;
}

// Whether points along the edges of a triangle, no farther apart than `shortest`, are within the
// threshold: then splits would find nothing. Few points are asked.
static bool is_plain(const pci_isoline *line, uint32_t t, double shortest) {
    static const double most_pieces = 4.0;
    for (uint32_t h = 3 * t; h < 3 * t + 3; ++h) {
        const double *a = &line->mesh.positions[3 * (size_t)pci_origin(&line->mesh, h)];
        const double *b = &line->mesh.positions[3 * (size_t)pci_target(&line->mesh, h)];
        const double pieces = ceil(sqrt(squared_length(&line->mesh, h)) / shortest);
        uint32_t nearest = line->nearest[pci_origin(&line->mesh, h)];
        if (!(pieces <= most_pieces)) {
            return false;
        }
        for (int i = 1; i < (int)pieces; ++i) {
            double point[3];
            for (size_t k = 0; k < 3; ++k) {
                point[k] = a[k] + (double)i / pieces * (b[k] - a[k]);
            }
            if (!pci_bvh_within_near(line->visual, point, within_threshold(line), &nearest)) {
                return false;
            }
        }
    }
    return true;
}

// The edge to split where a triangle may touch the isoline; PC_INVALID_INDEX: none.
static uint32_t edge_to_split(const pci_isoline *line, uint32_t t, double shortest) {
    const double threshold = line->threshold;
    double nearest = INFINITY, farthest = -INFINITY;
    for (uint32_t h = 3 * t; h < 3 * t + 3; ++h) {
        const double distance = line->distances[pci_origin(&line->mesh, h)];
        nearest = distance < nearest ? distance : nearest;
        farthest = distance > farthest ? distance : farthest;
    }
    if (!(nearest < threshold && farthest > out_of_the_way)) {
        return PC_INVALID_INDEX;
    }
    const uint32_t edge = longest_edge(&line->mesh, t);
    const double longest = sqrt(squared_length(&line->mesh, edge));
    const bool wanted = farthest + 0.5 * longest > threshold && longest > shortest;
    const bool plain =
        wanted && line->coarse && farthest == unmeasured && is_plain(line, t, shortest);
    return wanted && !plain ? terminal_edge(&line->mesh, edge) : PC_INVALID_INDEX;
}

// What a round of refinement works with. A triangle is asked again when it was split.
enum { ASKED, SETTLED, SPLIT };
typedef struct refinement {
    pci_isoline *line;
    double shortest;
    uint32_t first;  // vertex of this round
    uint8_t *states; // #F
    uint32_t *edges; // #F, to be split, or PC_INVALID_INDEX
    size_t state_capacity, edge_capacity;
} refinement;

static void choose_edges(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const refinement *r = user;
    for (size_t t = begin; t < end; ++t) {
        r->edges[t] = r->states[t] == SETTLED ? PC_INVALID_INDEX
                                              : edge_to_split(r->line, (uint32_t)t, r->shortest);
        r->states[t] = r->edges[t] == PC_INVALID_INDEX ? SETTLED : ASKED;
    }
}

// Where several triangles chose the same edge the first one splits it.
static bool split_chosen(refinement *r) {
    pci_isoline *line = r->line;
    const pci_halfedge *mesh = &line->mesh;
    const size_t count = mesh->triangle_count;
    for (size_t t = 0; t < count; ++t) {
        const uint32_t h = r->edges[t];
        if (h == PC_INVALID_INDEX || r->states[h / 3] == SPLIT) {
            continue;
        }
        const uint32_t twin = mesh->twins[h];
        void *states = r->states;
        if (split_edge(line, h, 0.5) == PC_INVALID_INDEX ||
            !pci_scratch_reserve(mesh->scratch, &states, &r->state_capacity, mesh->triangle_count,
                                 1)) {
            return false;
        }
        r->states = states;
        r->states[h / 3] = SPLIT;
        if (twin != PC_INVALID_INDEX) {
            r->states[twin / 3] = SPLIT;
        }
    }
    return true;
}

static void measure_new(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const refinement *r = user;
    pci_isoline *line = r->line;
    uint32_t focus = PC_INVALID_INDEX;
    for (size_t v = r->first + begin; v < r->first + end; ++v) {
        find_distance(line, v, &focus);
    }
}

// Halves the longest edge of each triangle that may touch the isoline until it is shorter than
// `shortest`. False: no memory, or cancelled.
static bool refine(pci_isoline *line, double shortest) {
    const pci_halfedge *mesh = &line->mesh;
    pc_context *context = mesh->scratch->context;
    refinement r = {.line = line, .shortest = shortest};
    do {
        void *states = r.states, *edges = r.edges;
        if (!pci_scratch_reserve(mesh->scratch, &states, &r.state_capacity, mesh->triangle_count,
                                 1) ||
            !pci_scratch_reserve(mesh->scratch, &edges, &r.edge_capacity, mesh->triangle_count,
                                 sizeof(*r.edges))) {
            return false;
        }
        r.states = states;
        r.edges = edges;
        r.first = (uint32_t)mesh->vertex_count;
        if (!pci_parallel_while_wanted(context, mesh->triangle_count, 8 * grain, choose_edges,
                                       &r) ||
            !split_chosen(&r) ||
            !pci_parallel_while_wanted(context, mesh->vertex_count - r.first, grain, measure_new,
                                       &r)) {
            return false;
        }
    } while (mesh->vertex_count > r.first);
    return true;
}

typedef struct measuring {
    pci_isoline *line;
    const uint32_t *vertices;
} measuring;

static void measure_listed(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const measuring *m = user;
    for (size_t i = begin; i < end; ++i) {
        measure_distance(m->line, m->vertices[i]);
    }
}

// Measures what was not, at edges that cross the isoline. False: out of memory, or cancelled.
static bool measure_crossing(pci_isoline *line) {
    const pci_halfedge *mesh = &line->mesh;
    uint32_t *vertices = PCI_SCRATCH(mesh->scratch, uint32_t, mesh->vertex_count);
    uint8_t *listed = PCI_SCRATCH(mesh->scratch, uint8_t, mesh->vertex_count);
    size_t count = 0;
    if (mesh->scratch->failed) {
        return false;
    }
    for (uint32_t h = 0; h < 3 * mesh->triangle_count; ++h) {
        const uint32_t ends[2] = {pci_origin(mesh, h), pci_target(mesh, h)};
        for (size_t i = 0; i < 2; ++i) {
            const double distance = line->distances[ends[i]];
            if ((distance == unmeasured || distance == out_of_the_way) && !listed[ends[i]] &&
                line->distances[ends[1 - i]] > line->threshold) {
                listed[ends[i]] = 1;
                vertices[count++] = ends[i];
            }
        }
    }
    measuring job = {line, vertices};
    return pci_parallel_while_wanted(mesh->scratch->context, count, grain, measure_listed, &job);
}

// Splits the edges that cross the isoline there. New edges end on the isoline and never cross it,
// so one pass finds all crossings.
static bool split_isoline(pci_isoline *line) {
    const double threshold = line->threshold;
    if (line->coarse && !measure_crossing(line)) {
        return false;
    }
    for (uint32_t h = 0; h < 3 * line->mesh.triangle_count; ++h) {
        if (!pci_is_edge(&line->mesh, h)) {
            continue;
        }
        const double a = line->distances[pci_origin(&line->mesh, h)] - threshold;
        const double b = line->distances[pci_target(&line->mesh, h)] - threshold;
        if ((a < 0.0 && b > 0.0) || (a > 0.0 && b < 0.0)) {
            const double share = fmin(fmax(a / (a - b), 0.05), 0.95);
            const uint32_t v = split_edge(line, h, share);
            if (v == PC_INVALID_INDEX) {
                return false;
            }
            line->distances[v] = threshold;
        }
    }
    return true;
}

bool pci_isoline_refine(pci_scratch *scratch, const pc_mesh *layer, double threshold,
                        double shortest, pci_isoline *line) {
    line->threshold = threshold;
    line->normals = PCI_SCRATCH(scratch, double, 3 * layer->vertex_count);
    line->distances = PCI_SCRATCH(scratch, double, layer->vertex_count);
    line->nearest = PCI_SCRATCH(scratch, uint32_t, layer->vertex_count);
    line->ends = PCI_SCRATCH(scratch, uint32_t, 2 * layer->vertex_count);
    if (scratch->failed || !pci_halfedge_build(scratch, layer, &line->mesh)) {
        return false;
    }
    line->normal_capacity = line->distance_capacity = layer->vertex_count;
    line->nearest_capacity = line->end_capacity = layer->vertex_count;
    pci_vertex_normals(layer, line->normals);
    return pci_parallel_while_wanted(scratch->context, layer->vertex_count, grain, measure_first,
                                     line) &&
           refine(line, shortest) && split_isoline(line);
}

// The half-edge whose collapse undoes the split that made vertex v. PC_INVALID_INDEX: something has
// changed around it since, or is cut away.
static uint32_t undoing_edge(const pci_isoline *line, uint32_t v, const uint8_t *keep) {
    const pci_halfedge *mesh = &line->mesh;
    const uint32_t a = line->ends[2 * (size_t)v], b = line->ends[2 * (size_t)v + 1];
    uint32_t spokes[4];
    size_t count = 0;
    PCI_FOR_OUTGOING(mesh, v, h) {
        if (count == 4 || !keep[h / 3]) {
            return PC_INVALID_INDEX;
        }
        spokes[count++] = h;
    }
    if (pci_is_border_vertex(mesh, v)) {
        return count == 2 && pci_target(mesh, spokes[0]) == b &&
                       mesh->corners[pci_previous(spokes[1])] == a
                   ? spokes[0]
                   : PC_INVALID_INDEX;
    }
    for (size_t i = 0; i < 4 && count == 4; ++i) {
        if (pci_target(mesh, spokes[i]) == b && pci_target(mesh, spokes[(i + 2) % 4]) == a) {
            return spokes[i];
        }
    }
    return PC_INVALID_INDEX;
}

void pci_isoline_undo(pci_isoline *line, size_t first, const uint8_t *keep) {
    for (uint32_t v = (uint32_t)line->mesh.vertex_count; v-- > first;) {
        const uint32_t h = undoing_edge(line, v, keep);
        if (h != PC_INVALID_INDEX && pci_can_collapse(&line->mesh, h)) {
            pci_collapse(&line->mesh, h);
        }
    }
}
