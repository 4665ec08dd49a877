#include "stages/skin/skin_layers.h"

#include "core/union_find.h"
#include "geometry/bvh.h"
#include "geometry/crossing.h"
#include "geometry/topology.h"

static const char stage[] = "skin";

enum { NEAR = 64, CORNERS = 5 }; // triangles looked at; a triangle, and a vertex or an edge
enum { TIES_OF_PAIR = 6 };       // edges of two triangles

static const double reach_share = 0.5;      // of the typical edge length
static const double stiffness_floor = 0.01; // gaps below a tenth of it get no stiffer
static const double on_triangle = 1e-6;     // of the typical edge length
static const double most_crossings = 4.0;   // per vertex; more are no sheets that pass each other

// Two points of the surface that are to move alike.
typedef struct tie {
    uint32_t count;             // of corners; 0: there is none
    uint32_t vertices[CORNERS]; // the triangle, then the vertex, or the ends of the edge
    double shares[CORNERS];     // minus the barycentric coordinates, then those along the edge
    double stiffness;
} tie;

typedef struct tie_job {
    const pc_mesh *surface;
    const pci_bvh *bvh;
    const pc_mesh *proxy;
    const pci_place *closest; // #V
    const uint32_t *parts;    // #V
    const double *lengths;    // #V: of the edges around, mean
    double typical;           // length of an edge
    tie *ties;                // #V, then those of the crossings
} tie_job;

// Whether a vertex and a corner of a triangle have closest points on proxy triangles that touch.
static bool over_same_place(const tie_job *job, size_t v, const uint32_t corner[3]) {
    const uint32_t *here = &job->proxy->triangles[3 * (size_t)job->closest[v].triangle];
    for (size_t c = 0; c < 27; ++c) {
        const size_t there = job->closest[corner[c / 9]].triangle;
        if (here[c % 3] == job->proxy->triangles[3 * there + c / 3 % 3]) {
            return true;
        }
    }
    return false;
}

static void hold_triangle(tie *t, const uint32_t corner[3], const double barycentric[3]) {
    t->count = 3;
    for (size_t c = 0; c < 3; ++c) {
        t->vertices[c] = corner[c];
        t->shares[c] = -barycentric[c];
    }
}

static void hold_point(tie *t, size_t vertex, double share) {
    t->vertices[t->count] = (uint32_t)vertex;
    t->shares[t->count++] = share;
}

static double tie_stiffness(const tie_job *job, double squared_gap, double length) {
    const double floor = stiffness_floor * job->typical * job->typical;
    const double width = fmin(job->typical, length);
    return width * width / (squared_gap + floor);
}

static void find_ties(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const tie_job *job = user;
    const pc_mesh *surface = job->surface;
    for (size_t v = begin; v < end; ++v) {
        const double *point = &surface->positions[3 * v];
        uint32_t triangles[NEAR], nearest = PC_INVALID_INDEX;
        double squared = INFINITY;
        tie *t = &job->ties[v];
        double reach = reach_share * job->typical;
        const size_t count = pci_bvh_collect_fitting(job->bvh, point, &reach, NEAR, triangles);
        for (size_t i = 0; i < count; ++i) {
            const uint32_t *corner = &surface->triangles[3 * (size_t)triangles[i]];
            double barycentric[3];
            if (job->parts[corner[0]] == job->parts[v] || !over_same_place(job, v, corner)) {
                continue;
            }
            const double distance = pci_triangle_squared_distance(
                point, &surface->positions[3 * (size_t)corner[0]],
                &surface->positions[3 * (size_t)corner[1]],
                &surface->positions[3 * (size_t)corner[2]], barycentric);
            if (distance < squared || (distance == squared && triangles[i] < nearest)) {
                squared = distance;
                nearest = triangles[i];
                hold_triangle(t, corner, barycentric);
                hold_point(t, v, 1.0);
                t->stiffness = tie_stiffness(job, squared, job->lengths[v]);
            }
        }
    }
}

// Ties the edges of a triangle to another one where they pass through it. Returns their number.
static size_t tie_edges(const tie_job *job, const uint32_t *edges, const uint32_t *corner,
                        tie *ties) {
    const double *a = &job->surface->positions[3 * (size_t)corner[0]];
    const double *b = &job->surface->positions[3 * (size_t)corner[1]];
    const double *c = &job->surface->positions[3 * (size_t)corner[2]];
    double ab[3], ac[3], normal[3], heights[3];
    size_t count = 0;
    pci_sub(b, a, ab);
    pci_sub(c, a, ac);
    pci_cross(ab, ac, normal);
    for (size_t i = 0; i < 3; ++i) {
        double offset[3];
        pci_sub(&job->surface->positions[3 * (size_t)edges[i]], a, offset);
        heights[i] = pci_dot(normal, offset);
    }
    for (size_t i = 0; i < 3; ++i) {
        const size_t j = (i + 1) % 3, from = edges[i], to = edges[j];
        double point[3], barycentric[3];
        if (!(heights[i] * heights[j] < 0.0)) {
            continue;
        }
        const double share = heights[i] / (heights[i] - heights[j]);
        for (size_t x = 0; x < 3; ++x) {
            point[x] = (1.0 - share) * job->surface->positions[3 * from + x] +
                       share * job->surface->positions[3 * to + x];
        }
        const double squared = pci_triangle_squared_distance(point, a, b, c, barycentric);
        if (squared <= on_triangle * on_triangle * job->typical * job->typical) {
            tie *t = &ties[count++];
            hold_triangle(t, corner, barycentric);
            hold_point(t, from, 1.0 - share);
            hold_point(t, to, share);
            t->stiffness = tie_stiffness(job, 0.0, fmin(job->lengths[from], job->lengths[to]));
        }
    }
    return count;
}

// Ties what crosses where it does, from ties[count] on. Returns how many ties there are then.
static size_t tie_crossings(const tie_job *job, const uint32_t *pairs, size_t pair_count,
                            size_t count) {
    const pc_mesh *surface = job->surface;
    for (size_t i = 0; i < 2 * pair_count; ++i) {
        const uint32_t *edges = &surface->triangles[3 * (size_t)pairs[i]];
        const uint32_t *corner = &surface->triangles[3 * (size_t)pairs[i ^ 1]];
        count += tie_edges(job, edges, corner, &job->ties[count]);
    }
    return count;
}

// Adds up the entries of each row that name one column. `places` (#V): 0.
static void merge_columns(size_t vertex_count, size_t *places, pci_skin_layers *layers) {
    size_t count = 0, begin = 0;
    for (size_t v = 0; v < vertex_count; ++v) {
        const size_t first = count, end = layers->offsets[v + 1];
        for (size_t e = begin; e < end; ++e) {
            const uint32_t column = layers->columns[e];
            const double value = layers->values[e];
            if (places[column] > first) {
                layers->values[places[column] - 1] += value;
            } else {
                layers->columns[count] = column;
                layers->values[count] = value;
                places[column] = ++count;
            }
        }
        layers->offsets[v] = first;
        begin = end;
    }
    layers->offsets[vertex_count] = count;
}

// T from the ties, of which it is the sum.
static bool sum_ties(pci_scratch *scratch, size_t vertex_count, size_t tie_count, const tie *ties,
                     pci_skin_layers *layers) {
    size_t entries = 0;
    for (size_t i = 0; i < tie_count; ++i) {
        entries += (size_t)ties[i].count * ties[i].count;
    }
    if (entries == 0) {
        return true;
    }
    layers->offsets = PCI_SCRATCH(scratch, size_t, vertex_count + 2);
    layers->columns = PCI_SCRATCH(scratch, uint32_t, entries);
    layers->values = PCI_SCRATCH(scratch, double, entries);
    size_t *places = PCI_SCRATCH(scratch, size_t, vertex_count);
    if (scratch->failed) {
        return false;
    }
    for (size_t i = 0; i < CORNERS * tie_count; ++i) {
        const tie *t = &ties[i / CORNERS];
        if (i % CORNERS < t->count) {
            layers->offsets[t->vertices[i % CORNERS] + 2] += t->count;
        }
    }
    for (size_t v = 0; v < vertex_count; ++v) {
        layers->offsets[v + 2] += layers->offsets[v + 1];
    }
    for (size_t i = 0; i < CORNERS * CORNERS * tie_count; ++i) {
        const tie *t = &ties[i / (CORNERS * CORNERS)];
        const size_t a = i / CORNERS % CORNERS, b = i % CORNERS;
        if (a < t->count && b < t->count) {
            const size_t at = layers->offsets[t->vertices[a] + 1]++;
            layers->columns[at] = t->vertices[b];
            layers->values[at] = t->stiffness * t->shares[a] * t->shares[b];
        }
    }
    merge_columns(vertex_count, places, layers);
    return true;
}

// Mean length of the edges around each vertex, those of each triangle counted. `counts` (#V): 0.
static void find_lengths(const pc_mesh *surface, uint32_t *counts, double *lengths) {
    for (size_t k = 0; k < 3 * surface->triangle_count; ++k) {
        const size_t i = surface->triangles[k];
        const size_t j = surface->triangles[k % 3 == 2 ? k - 2 : k + 1];
        const double length =
            sqrt(pci_squared_distance(&surface->positions[3 * i], &surface->positions[3 * j]));
        lengths[i] += length;
        lengths[j] += length;
        ++counts[i];
        ++counts[j];
    }
    for (size_t v = 0; v < surface->vertex_count; ++v) {
        lengths[v] /= counts[v] > 0 ? counts[v] : 1;
    }
}

// All ties of a surface of several parts, and their sum. `local`: scratch that ends after it.
static pc_status tie_parts(pci_scratch *scratch, pci_scratch *local, tie_job *job,
                           pci_skin_layers *layers) {
    pc_context *context = scratch->context;
    const pc_mesh *surface = job->surface;
    const size_t nv = surface->vertex_count;
    uint32_t *pairs;
    size_t pair_count;
    if (!pci_list_self_intersections(local, surface, &pairs, &pair_count)) {
        return pci_fail_memory(context, stage);
    }
    if ((double)pair_count > most_crossings * (double)nv) {
        pair_count = 0;
    }
    job->ties = PCI_SCRATCH(local, tie, nv + TIES_OF_PAIR * pair_count);
    if (job->ties == NULL) {
        return pci_fail_memory(context, stage);
    }
    pci_parallel_for(context, nv, 256, find_ties, job);
    const size_t count = tie_crossings(job, pairs, pair_count, nv);
    return sum_ties(scratch, nv, count, job->ties, layers) ? PC_OK
                                                           : pci_fail_memory(context, stage);
}

pc_status pci_skin_find_layers(pci_scratch *scratch, const pc_mesh *surface, const pc_mesh *proxy,
                               const pci_place *closest, double typical, double lambda,
                               pci_skin_layers *layers) {
    pc_context *context = scratch->context;
    const size_t nv = surface->vertex_count;
    memset(layers, 0, sizeof(*layers));
    layers->lambda = lambda;
    pci_scratch local = pci_scratch_begin(context);
    uint32_t *parts = PCI_SCRATCH(&local, uint32_t, nv);
    uint32_t *counts = PCI_SCRATCH(&local, uint32_t, nv);
    double *lengths = PCI_SCRATCH(&local, double, nv);
    pc_status status = local.failed ? pci_fail_memory(context, stage) : PC_OK;
    if (status == PC_OK && pci_vertex_components(surface, parts) > 1) {
        pci_bvh *bvh = NULL;
        for (uint32_t v = 0; v < nv; ++v) {
            parts[v] = pci_find_root(parts, v);
        }
        find_lengths(surface, counts, lengths);
        status = pci_bvh_create(context, stage, surface, &bvh);
        if (status == PC_OK) {
            tie_job job = {surface, bvh, proxy, closest, parts, lengths, typical, NULL};
            status = tie_parts(scratch, &local, &job, layers);
        }
        pci_bvh_destroy(context, bvh);
    }
    pci_scratch_end(&local);
    return status;
}
