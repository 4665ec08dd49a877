#include "geometry/knn.h"
#include "geometry/locality.h"
#include "geometry/topology.h"
#include "stages/skin/skin_internal.h"

// Edges shorter than a tenth of the typical one get no stiffer: they would freeze what they join.
static const double stiffness_floor = 0.01;

typedef struct near_job {
    const pci_knn *knn;
    const pci_skin_problem *problem;
    uint32_t *near;
    double *sums;
} near_job;

static double distance(const pci_skin_problem *p, size_t i, size_t j) {
    return sqrt(pci_squared_distance(&p->rest[3 * i], &p->rest[3 * j]));
}

static void find_near(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const near_job *job = user;
    const pci_skin_problem *p = job->problem;
    const size_t k = p->near_count;
    double squared[PCI_SKIN_NEIGHBOURS_MAX];
    for (size_t v = begin; v < end; ++v) {
        pci_knn_query(job->knn, &p->rest[3 * v], k, (uint32_t)v, &job->near[k * v], squared);
        for (size_t e = 0; e < k; ++e) {
            job->sums[v] += 1.0 / (sqrt(squared[e]) + p->near_epsilon);
        }
    }
}

// Of the topology only the rings are kept.
static bool find_rings(pci_scratch *scratch, const pc_mesh *surface, pci_skin_problem *problem) {
    const size_t nv = surface->vertex_count;
    pci_scratch local = pci_scratch_begin(scratch->context);
    pci_topology topology;
    bool good = pci_topology_build(&local, surface, &topology);
    if (good) {
        size_t *offsets = PCI_SCRATCH(scratch, size_t, nv + 1);
        uint32_t *ring = PCI_SCRATCH(scratch, uint32_t, topology.ring_offsets[nv]);
        good = !scratch->failed;
        if (good) {
            memcpy(offsets, topology.ring_offsets, (nv + 1) * sizeof(*offsets));
            memcpy(ring, topology.ring, topology.ring_offsets[nv] * sizeof(*ring));
        }
        problem->ring_offsets = offsets;
        problem->ring = ring;
    }
    pci_scratch_end(&local);
    return good;
}

bool pci_skin_problem_finish(pci_scratch *scratch, uint32_t neighbours, pci_skin_problem *problem) {
    const size_t nv = problem->vertex_count;
    const pc_mesh points = {.vertex_count = nv, .positions = (double *)problem->rest};
    memset(problem->norms, 0, sizeof(problem->norms));
    problem->near_count = nv - 1 < neighbours ? (uint32_t)(nv - 1) : neighbours;
    problem->near_epsilon = pci_diagonal(&points) * (1e-3 / 1.5); // 1 mm on a garment of 1.5 m
    const size_t k = problem->near_count;
    uint32_t *order = NULL, *near = PCI_SCRATCH(scratch, uint32_t, k * nv);
    double *sums = PCI_SCRATCH(scratch, double, nv);
    if (scratch->failed || !pci_sort_points(scratch, nv, problem->rest, &order)) {
        return false;
    }
    pci_scratch local = pci_scratch_begin(scratch->context);
    pci_knn knn;
    const bool built = pci_knn_build(&local, nv, problem->rest, &knn);
    knn.ranks = problem->ranks;
    if (built) {
        near_job job = {.knn = &knn, .problem = problem, .near = near, .sums = sums};
        pci_parallel_for(scratch->context, nv, 256, find_near, &job);
    }
    pci_scratch_end(&local);
    if (!built) {
        return false;
    }
    problem->order = order;
    problem->near = near;
    problem->near_sums = sums;

    for (size_t v = 0; v < nv; ++v) {
        double mean = 0.0;
        for (size_t e = k * v; e < k * v + k; ++e) {
            const double length = distance(problem, v, near[e]);
            mean += length / (double)k;
            problem->norms[1] += length * length;
        }
        problem->norms[2] += mean * mean;
        for (size_t e = problem->ring_offsets[v]; e < problem->ring_offsets[v + 1]; ++e) {
            problem->norms[0] += pci_squared_distance(&problem->rest[3 * v],
                                                      &problem->rest[3 * (size_t)problem->ring[e]]);
        }
    }
    return true;
}

double pci_skin_near_weight(const pci_skin_problem *p, size_t i, size_t e) {
    return 1.0 / (distance(p, i, p->near[e]) + p->near_epsilon) / p->near_sums[i];
}

bool pci_skin_problem_build(pci_scratch *scratch, const pc_mesh *surface, const uint32_t *ranks,
                            uint32_t neighbours, pci_skin_problem *problem) {
    memset(problem, 0, sizeof(*problem));
    problem->ranks = ranks;
    problem->vertex_count = surface->vertex_count;
    problem->rest = surface->positions;
    return find_rings(scratch, surface, problem) &&
           pci_skin_problem_finish(scratch, neighbours, problem);
}

double pci_skin_stiffness(const pci_skin_problem *problem, size_t i, size_t j) {
    if (problem->typical == 0.0) {
        return 1.0;
    }
    const double squared = pci_squared_distance(&problem->rest[3 * i], &problem->rest[3 * j]);
    return problem->typical / (squared + stiffness_floor * problem->typical);
}

// Squared length of an edge times its stiffness.
static double stiff_square(const pci_skin_problem *problem, size_t i, size_t j) {
    return pci_skin_stiffness(problem, i, j) *
           pci_squared_distance(&problem->rest[3 * i], &problem->rest[3 * j]);
}

void pci_skin_problem_equalize(pci_skin_problem *problem) {
    const size_t nv = problem->vertex_count, k = problem->near_count;
    const size_t edges = problem->ring_offsets[nv];
    problem->typical = edges > 0 ? problem->norms[0] / (double)edges : 0.0;
    problem->norms[0] = problem->norms[1] = 0.0;
    for (size_t v = 0; v < nv; ++v) {
        for (size_t e = problem->ring_offsets[v]; e < problem->ring_offsets[v + 1]; ++e) {
            problem->norms[0] += stiff_square(problem, v, problem->ring[e]);
        }
        for (size_t e = k * v; e < k * v + k; ++e) {
            problem->norms[1] += stiff_square(problem, v, problem->near[e]);
        }
    }
}
