// Based on: Bornemann, Deuflhard, "The cascadic multigrid method for elliptic problems", 1996.
#include "stages/skin/skin_coarse.h"

#include <float.h>

#include "geometry/topology.h"
#include "stages/skin/skin_simplex.h"

enum { CLUSTERS_MAX = 64, WISH_MAX = 256 }; // that count for one vertex; more are left out

static const double ridge_share = 1e-3; // of the trace of a block

// Takes vertices, along the curve through space, whose neighbours are not taken.
static size_t take_vertices(const pci_skin_problem *fine, pci_skin_coarse *coarse) {
    size_t count = 0;
    memset(coarse->clusters, 0xff, fine->vertex_count * sizeof(*coarse->clusters));
    for (size_t i = 0; i < fine->vertex_count; ++i) {
        const uint32_t v = fine->order[i];
        bool free = true;
        for (size_t e = fine->ring_offsets[v]; e < fine->ring_offsets[v + 1] && free; ++e) {
            free = coarse->clusters[fine->ring[e]] == PC_INVALID_INDEX;
        }
        if (free) {
            coarse->clusters[v] = (uint32_t)count;
            coarse->vertices[count++] = v;
        }
    }
    return count;
}

// Gives the others to the nearest of their neighbours that were taken.
static void join_clusters(const pci_skin_problem *fine, size_t coarse_count,
                          pci_skin_coarse *coarse) {
    for (size_t v = 0; v < fine->vertex_count; ++v) {
        double nearest = INFINITY;
        if (coarse->clusters[v] != PC_INVALID_INDEX) {
            continue;
        }
        uint32_t cluster = PC_INVALID_INDEX;
        for (size_t e = fine->ring_offsets[v]; e < fine->ring_offsets[v + 1]; ++e) {
            const uint32_t j = fine->ring[e], other = coarse->clusters[j];
            const double squared =
                pci_squared_distance(&fine->rest[3 * v], &fine->rest[3 * (size_t)j]);
            if (other < coarse_count && coarse->vertices[other] == j && squared < nearest) {
                nearest = squared;
                cluster = other;
            }
        }
        coarse->clusters[v] = cluster;
    }
}

// The vertices of each cluster.
static bool list_members(pci_scratch *scratch, const pci_skin_problem *fine, size_t coarse_count,
                         const uint32_t *clusters, uint32_t **offsets, uint32_t **members) {
    *offsets = PCI_SCRATCH(scratch, uint32_t, coarse_count + 2);
    *members = PCI_SCRATCH(scratch, uint32_t, fine->vertex_count);
    if (scratch->failed) {
        return false;
    }
    for (size_t v = 0; v < fine->vertex_count; ++v) {
        ++(*offsets)[clusters[v] + 2];
    }
    for (size_t c = 0; c < coarse_count; ++c) {
        (*offsets)[c + 2] += (*offsets)[c + 1];
    }
    for (size_t v = 0; v < fine->vertex_count; ++v) {
        (*members)[(*offsets)[clusters[v] + 1]++] = (uint32_t)v;
    }
    return true;
}

static bool find_rings(pci_scratch *scratch, const pci_skin_problem *fine, size_t coarse_count,
                       const uint32_t *clusters, pci_skin_problem *problem) {
    pci_scratch local = pci_scratch_begin(scratch->context);
    uint32_t *member_offsets, *members, *ring = NULL;
    uint32_t *marks = PCI_SCRATCH(&local, uint32_t, coarse_count);
    size_t *offsets = PCI_SCRATCH(scratch, size_t, coarse_count + 1), capacity = 0, count = 0;
    bool good = !scratch->failed && !local.failed &&
                list_members(&local, fine, coarse_count, clusters, &member_offsets, &members);
    for (uint32_t c = 0; c < coarse_count && good; ++c) {
        for (size_t m = member_offsets[c]; m < member_offsets[c + 1] && good; ++m) {
            const size_t begin = fine->ring_offsets[members[m]];
            const size_t end = fine->ring_offsets[members[m] + 1];
            good = pci_scratch_reserve(&local, (void **)&ring, &capacity, count + (end - begin),
                                       sizeof(*ring));
            for (size_t e = begin; e < end && good; ++e) {
                const uint32_t other = clusters[fine->ring[e]];
                if (other != c && marks[other] != c + 1) {
                    marks[other] = c + 1;
                    ring[count++] = other;
                }
            }
        }
        offsets[c + 1] = count;
    }
    uint32_t *kept = good ? PCI_SCRATCH(scratch, uint32_t, count + 1) : NULL;
    if (kept != NULL && count > 0) {
        memcpy(kept, ring, count * sizeof(*kept));
    }
    problem->ring_offsets = offsets;
    problem->ring = kept;
    pci_scratch_end(&local);
    return kept != NULL;
}

bool pci_skin_coarsen(pci_scratch *scratch, const pci_skin_problem *fine, pci_skin_coarse *coarse) {
    pci_skin_problem *p = &coarse->problem;
    memset(coarse, 0, sizeof(*coarse));
    coarse->vertices = PCI_SCRATCH(scratch, uint32_t, fine->vertex_count);
    coarse->clusters = PCI_SCRATCH(scratch, uint32_t, fine->vertex_count);
    if (scratch->failed) {
        return false;
    }
    const size_t nv = take_vertices(fine, coarse);
    join_clusters(fine, nv, coarse);
    double *rest = PCI_SCRATCH(scratch, double, 3 * nv);
    uint32_t *bones = PCI_SCRATCH(scratch, uint32_t, nv * fine->slots);
    if (scratch->failed) {
        return false;
    }
    for (size_t c = 0; c < nv; ++c) {
        const size_t v = coarse->vertices[c];
        memcpy(&rest[3 * c], &fine->rest[3 * v], 3 * sizeof(*rest));
        memcpy(&bones[fine->slots * c], &fine->bones[fine->slots * v],
               fine->slots * sizeof(*bones));
    }
    *p = *fine;
    p->coarse = true;
    p->ranks = NULL;
    p->layers = NULL; // what lies between parts is too near for few vertices
    p->vertex_count = nv;
    p->rest = rest;
    p->bones = bones;
    if (!find_rings(scratch, fine, nv, coarse->clusters, p) ||
        !pci_skin_problem_finish(scratch, fine->near_count, p)) {
        return false;
    }
    if (fine->typical != 0.0) {
        pci_skin_problem_equalize(p);
    }
    return true;
}

typedef struct prolong_job {
    const pci_skin_gram *gram;
    const pci_skin_problem *fine;
    const pci_skin_coarse *coarse;
    const double *change;
    double *weights;
    struct tallies *tallies; // #threads
} prolong_job;

// Amounts by key, in the order in which the keys came: a row that is to move as bones with these
// weights, the first ones its own; or clusters near a vertex and what their changes count.
typedef struct tally {
    uint32_t count;
    uint32_t *places; // by key: 1 + place, or 0
    uint32_t keys[WISH_MAX];
    double amounts[WISH_MAX];
} tally;

typedef struct tallies {
    tally near, wish;
} tallies;

// False: left out, there are `most` other keys.
static bool add_to(tally *t, uint32_t most, uint32_t key, double amount) {
    if (t->places[key] == 0) {
        if (t->count == most) {
            return false;
        }
        t->keys[t->count] = key;
        t->amounts[t->count] = 0.0;
        t->places[key] = ++t->count;
    }
    t->amounts[t->places[key] - 1] += amount;
    return true;
}

static void clear_tally(tally *t) {
    for (uint32_t i = 0; i < t->count; ++i) {
        t->places[t->keys[i]] = 0;
    }
    t->count = 0;
}

// Means over the rings of means over the rings, each with the vertex itself: smooth enough for the
// stiff edges of the fine problem. Returns their sum.
static double find_shares(const pci_skin_problem *fine, const uint32_t *clusters, uint32_t v,
                          tally *near) {
    double sum = 0.0;
    for (size_t e = fine->ring_offsets[v]; e <= fine->ring_offsets[v + 1]; ++e) {
        const uint32_t j = e < fine->ring_offsets[v + 1] ? fine->ring[e] : v;
        const size_t begin = fine->ring_offsets[j], end = fine->ring_offsets[j + 1];
        const double share = 1.0 / (double)(end - begin + 1);
        for (size_t f = begin; f <= end; ++f) {
            const uint32_t cluster = clusters[f < end ? fine->ring[f] : j];
            sum += add_to(near, CLUSTERS_MAX, cluster, share) ? share : 0.0;
        }
    }
    return sum;
}

// What a row has, and the change of the coarse vertices near it.
static void make_wish(const prolong_job *job, size_t v, tally *near, tally *w) {
    const pci_skin_problem *fine = job->fine, *coarse = &job->coarse->problem;
    const size_t slots = fine->slots;
    const double sum = find_shares(fine, job->coarse->clusters, (uint32_t)v, near);
    for (size_t k = v * slots; k < (v + 1) * slots; ++k) {
        (void)add_to(w, WISH_MAX, fine->bones[k], job->weights[k]);
    }
    for (size_t i = 0; i < near->count; ++i) {
        const size_t first = near->keys[i] * slots;
        for (size_t k = first; k < first + slots; ++k) {
            if (job->change[k] != 0.0) {
                const double share = near->amounts[i] / sum;
                (void)add_to(w, WISH_MAX, coarse->bones[k], share * job->change[k]);
            }
        }
    }
}

// The row takes what it can from the wish as it is, the rest as close as G says. `columns` are
// those of the driver, known where this is compiled.
static inline __attribute__((always_inline)) void
fulfil(const prolong_job *job, const size_t columns, size_t v, const tally *w, double *weights) {
    const pci_skin_problem *p = job->fine;
    const uint32_t slots = p->slots, *bones = &p->bones[v * slots];
    double a[PCI_SKIN_SLOTS_MAX * PCI_SKIN_SLOTS_MAX], gradient[PCI_SKIN_SLOTS_MAX];
    double point[PCI_SKIN_COLUMNS_MAX], left[WISH_MAX] = {0}, sum = 0.0, trace = 0.0;
    pci_skin_point(p, job->gram->driver.origin, job->gram->driver.unit, v, point);
    for (size_t k = 0; k < slots; ++k) {
        sum += w->amounts[k] > 0.0 ? w->amounts[k] : 0.0;
    }
    if (!(sum > 0.0)) {
        return;
    }
    for (size_t k = 0; k < w->count; ++k) {
        left[k] = -w->amounts[k];
        if (k < slots) {
            weights[k] = w->amounts[k] > 0.0 ? w->amounts[k] / sum : 0.0;
            left[k] += weights[k];
        }
    }
    for (size_t k = 0; k < slots; ++k) {
        gradient[k] = 0.0;
        for (size_t l = 0; l < w->count; ++l) {
            const double product =
                pci_skin_gram_sample(job->gram, columns, bones[k], w->keys[l], point, point);
            gradient[k] += left[l] * product;
            if (l < slots) {
                a[k * slots + l] = product;
                trace += k == l ? product : 0.0;
            }
        }
    }
    pci_simplex_minimize(slots, a, ridge_share * trace + (double)FLT_MIN, weights, gradient);
}

static void prolong_rows(void *user, size_t begin, size_t end, uint32_t worker) {
    const prolong_job *job = user;
    tally *near = &job->tallies[worker].near, *w = &job->tallies[worker].wish;
    for (size_t v = begin; v < end; ++v) {
        double *weights = &job->weights[v * job->fine->slots];
        make_wish(job, v, near, w);
        if (job->gram->driver.data.columns == 1) {
            fulfil(job, 1, v, w, weights);
        } else {
            fulfil(job, PCI_SKIN_COLUMNS_MAX, v, w, weights);
        }
        clear_tally(near);
        clear_tally(w);
    }
}

bool pci_skin_prolong(pci_scratch *scratch, const pci_skin_gram *gram, const pci_skin_problem *fine,
                      const pci_skin_coarse *coarse, const double *change, double *weights) {
    const uint32_t threads = pc_context_threads(scratch->context);
    prolong_job job = {.gram = gram,
                       .fine = fine,
                       .coarse = coarse,
                       .change = change,
                       .weights = weights,
                       .tallies = PCI_SCRATCH(scratch, tallies, threads)};
    for (uint32_t i = 0; i < threads && !scratch->failed; ++i) {
        job.tallies[i].near.places = PCI_SCRATCH(scratch, uint32_t, coarse->problem.vertex_count);
        job.tallies[i].wish.places = PCI_SCRATCH(scratch, uint32_t, fine->proxy_count);
    }
    if (!scratch->failed) {
        pci_parallel_for(scratch->context, fine->vertex_count, 256, prolong_rows, &job);
    }
    return !scratch->failed;
}
