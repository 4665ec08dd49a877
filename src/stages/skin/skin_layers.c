#include "stages/skin/skin_layers.h"

#include "core/union_find.h"
#include "geometry/bvh.h"
#include "geometry/topology.h"

static const char stage[] = "skin";

enum { NEAR = 64, CORNERS = 4 }; // triangles looked at; the vertex and the triangle

static const double reach_share = 0.5;      // of the typical edge length
static const double stiffness_floor = 0.01; // gaps below a tenth of it get no stiffer

typedef struct tie {
    uint32_t vertices[CORNERS]; // the vertex, and the triangle on another part
    double shares[CORNERS];     // 1, and minus the barycentric coordinates
    double stiffness;           // 0: none is near
} tie;

typedef struct tie_job {
    const pc_mesh *surface;
    const pci_bvh *bvh;
    const pc_mesh *proxy;
    const pci_place *closest; // #V
    const uint32_t *parts;    // #V
    const double *lengths;    // #V: of the edges around, mean
    double typical;           // length of an edge
    tie *ties;                // #V
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
                t->vertices[0] = (uint32_t)v;
                t->shares[0] = 1.0;
                for (size_t c = 0; c < 3; ++c) {
                    t->vertices[1 + c] = corner[c];
                    t->shares[1 + c] = -barycentric[c];
                }
            }
        }
        const double floor = stiffness_floor * job->typical * job->typical;
        t->stiffness = nearest != PC_INVALID_INDEX
                           ? job->typical * fmin(job->typical, job->lengths[v]) / (squared + floor)
                           : 0.0;
    }
}

// T from the ties, of which it is the sum.
static bool sum_ties(pci_scratch *scratch, size_t vertex_count, const tie *ties,
                     pci_skin_layers *layers) {
    size_t count = 0;
    for (size_t v = 0; v < vertex_count; ++v) {
        count += ties[v].stiffness > 0.0;
    }
    if (count == 0) {
        return true;
    }
    layers->offsets = PCI_SCRATCH(scratch, size_t, vertex_count + 2);
    layers->columns = PCI_SCRATCH(scratch, uint32_t, CORNERS * CORNERS * count);
    layers->values = PCI_SCRATCH(scratch, double, CORNERS *CORNERS *count);
    if (scratch->failed) {
        return false;
    }
    for (size_t i = 0; i < CORNERS * vertex_count; ++i) {
        if (ties[i / CORNERS].stiffness > 0.0) {
            layers->offsets[ties[i / CORNERS].vertices[i % CORNERS] + 2] += CORNERS;
        }
    }
    for (size_t v = 0; v < vertex_count; ++v) {
        layers->offsets[v + 2] += layers->offsets[v + 1];
    }
    for (size_t i = 0; i < CORNERS * CORNERS * vertex_count; ++i) {
        const tie *t = &ties[i / (CORNERS * CORNERS)];
        const size_t a = i / CORNERS % CORNERS, b = i % CORNERS;
        if (t->stiffness > 0.0) {
            const size_t at = layers->offsets[t->vertices[a] + 1]++;
            layers->columns[at] = t->vertices[b];
            layers->values[at] = t->stiffness * t->shares[a] * t->shares[b];
        }
    }
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
    tie *ties = PCI_SCRATCH(&local, tie, nv);
    pc_status status = local.failed ? pci_fail_memory(context, stage) : PC_OK;
    if (status == PC_OK && pci_vertex_components(surface, parts) > 1) {
        pci_bvh *bvh = NULL;
        for (uint32_t v = 0; v < nv; ++v) {
            parts[v] = pci_find_root(parts, v);
        }
        find_lengths(surface, counts, lengths);
        status = pci_bvh_create(context, stage, surface, &bvh);
        if (status == PC_OK) {
            tie_job job = {surface, bvh, proxy, closest, parts, lengths, typical, ties};
            pci_parallel_for(context, nv, 256, find_ties, &job);
            status = sum_ties(scratch, nv, ties, layers) ? PC_OK : pci_fail_memory(context, stage);
        }
        pci_bvh_destroy(context, bvh);
    }
    pci_scratch_end(&local);
    return status;
}
