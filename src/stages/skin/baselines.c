#include "proxycloth/baselines.h"

#include "geometry/knn.h"
#include "geometry/topology.h"
#include "solvers/sparse.h"
#include "stages/skin/weight_rows.h"

static const char stage[] = "baselines";

enum { LARGEST_INFLUENCES = 32, MOST_PIECES = 4, COLUMNS = PCI_CHOLESKY_TOGETHER };

static pc_status check(pc_context *context, const pc_mesh *surface, const pc_mesh *proxy,
                       uint32_t influences, const pc_skin *skin) {
    pc_status status = pci_check_mesh(context, stage, surface, "visual mesh");
    if (status == PC_OK) {
        status = pci_check_mesh(context, stage, proxy, "proxy mesh");
    }
    if (status == PC_OK && (influences == 0 || influences > LARGEST_INFLUENCES || skin == NULL ||
                            skin->bones != NULL || skin->weights != NULL)) {
        status = pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                          "%s: %u influences are not within 1..%d, or the output is not empty",
                          stage, influences, LARGEST_INFLUENCES);
    }
    return status;
}

// Puts a weight into a row of the largest ones, which falls; ties stay in order of insertion.
static void insert(uint32_t *bones, double *weights, uint32_t slots, uint32_t bone, double weight) {
    uint32_t at = slots;
    while (at > 0 && weights[at - 1] < weight) {
        --at;
    }
    for (uint32_t k = slots; k-- > at + 1;) {
        bones[k] = bones[k - 1];
        weights[k] = weights[k - 1];
    }
    if (at < slots) {
        bones[at] = bone;
        weights[at] = weight;
    }
}

static pc_status finish(pc_context *context, pc_status status, pc_skin *skin) {
    if (status == PC_OK && !pci_skin_scale_rows(skin)) {
        status =
            pci_fail(context, PC_ERROR_NUMERICAL, stage, "%s: weights that are not finite", stage);
    }
    if (status != PC_OK) {
        pc_skin_free(context, skin);
    }
    return status;
}

pc_status pci_skin_follow_points(pc_context *context, const pc_mesh *proxy, size_t count,
                                 const pci_place *closest, pc_skin *skin) {
    if (!pci_skin_allocate(context, count, 3, skin)) {
        return finish(context, pci_fail_memory(context, stage), skin);
    }
    for (size_t v = 0; v < count; ++v) {
        uint32_t *bones = &skin->bones[3 * v];
        double *weights = &skin->weights[3 * v];
        for (size_t c = 0; c < 3; ++c) {
            bones[c] = proxy->triangles[3 * (size_t)closest[v].triangle + c];
            weights[c] = closest[v].barycentric[c] > 0.0 ? closest[v].barycentric[c] : 0.0;
        }
        pci_skin_sort_row(bones, weights, 3);
    }
    return finish(context, PC_OK, skin);
}

pc_status pc_skin_closest_triangle(pc_context *context, const pc_mesh *surface,
                                   const pc_mesh *proxy, pc_skin *skin) {
    pc_status status = check(context, surface, proxy, 3, skin);
    if (status != PC_OK) {
        return status;
    }
    pci_place *closest = PCI_ALLOCATE(context, pci_place, surface->vertex_count);
    status = closest != NULL ? pci_closest_points(context, stage, surface, proxy, closest)
                             : pci_fail_memory(context, stage);
    if (status == PC_OK) {
        status = pci_skin_follow_points(context, proxy, surface->vertex_count, closest, skin);
    }
    pc_release(context, closest);
    return status;
}

pc_status pc_skin_inverse_distance(pc_context *context, const pc_mesh *surface,
                                   const pc_mesh *proxy, uint32_t influences, pc_skin *skin) {
    pc_status status = check(context, surface, proxy, influences, skin);
    if (status != PC_OK) {
        return status;
    }
    const uint32_t slots =
        influences < proxy->vertex_count ? influences : (uint32_t)proxy->vertex_count;
    const double spare = 1e-6 * pci_diagonal(proxy);
    pci_scratch scratch = pci_scratch_begin(context);
    pci_knn knn;
    if (!pci_skin_allocate(context, surface->vertex_count, slots, skin) ||
        !pci_knn_build(&scratch, proxy->vertex_count, proxy->positions, &knn)) {
        status = pci_fail_memory(context, stage);
    }
    for (size_t v = 0; status == PC_OK && v < skin->vertex_count; ++v) {
        double *weights = &skin->weights[v * slots];
        pci_knn_query(&knn, &surface->positions[3 * v], slots, PC_INVALID_INDEX,
                      &skin->bones[v * slots], weights);
        for (uint32_t k = 0; k < slots; ++k) {
            weights[k] = 1.0 / (sqrt(weights[k]) + spare + 1e-300); // all may be 0
        }
    }
    pci_scratch_end(&scratch);
    return finish(context, status, skin);
}

// ---- heat ---------------------------------------------------------------------------------------

// M + t L by columns, and M.
typedef struct heat {
    size_t *offsets; // #V + 1
    uint32_t *rows;
    double *values;
    double *masses; // #V
} heat;

// Cotangent of the angle at corner c, at least 0; 0 in triangles without area.
static double cotangent(const pc_mesh *mesh, size_t triangle, size_t c) {
    const uint32_t *corner = &mesh->triangles[3 * triangle];
    double a[3], b[3], cross[3];
    pci_sub(&mesh->positions[3 * (size_t)corner[(c + 1) % 3]],
            &mesh->positions[3 * (size_t)corner[c]], a);
    pci_sub(&mesh->positions[3 * (size_t)corner[(c + 2) % 3]],
            &mesh->positions[3 * (size_t)corner[c]], b);
    pci_cross(a, b, cross);
    const double sine = pci_norm(cross), cosine = pci_dot(a, b);
    return sine > 1e-6 * sqrt(pci_dot(a, a) * pci_dot(b, b)) && cosine > 0.0 ? cosine / sine : 0.0;
}

static void add_entry(const heat *h, uint32_t column, uint32_t row, double value) {
    size_t at = h->offsets[column];
    while (h->rows[at] != row) {
        ++at;
    }
    h->values[at] += value;
}

// The places of the entries: the diagonal, and the neighbours.
static bool place_entries(pci_scratch *scratch, const pc_mesh *surface, heat *h) {
    const size_t nv = surface->vertex_count;
    pci_topology topology;
    pci_scratch local = pci_scratch_begin(scratch->context);
    bool good = pci_topology_build(&local, surface, &topology);
    if (good) {
        h->offsets = PCI_SCRATCH(scratch, size_t, nv + 1);
        h->rows = PCI_SCRATCH(scratch, uint32_t, nv + topology.ring_offsets[nv]);
        good = !scratch->failed;
    }
    size_t next = 0;
    for (size_t v = 0; v < nv && good; ++v) {
        bool placed = false;
        for (size_t e = topology.ring_offsets[v]; e < topology.ring_offsets[v + 1]; ++e) {
            if (!placed && topology.ring[e] > v) {
                h->rows[next++] = (uint32_t)v;
                placed = true;
            }
            h->rows[next++] = topology.ring[e];
        }
        if (!placed) {
            h->rows[next++] = (uint32_t)v;
        }
        h->offsets[v + 1] = next;
    }
    pci_scratch_end(&local);
    return good;
}

static bool build_heat(pci_scratch *scratch, const pc_mesh *surface, double time, heat *h) {
    const size_t nv = surface->vertex_count;
    if (!place_entries(scratch, surface, h)) {
        return false;
    }
    h->values = PCI_SCRATCH(scratch, double, h->offsets[nv]);
    if (scratch->failed) {
        return false;
    }
    double total = 0.0;
    for (size_t t = 0; t < surface->triangle_count; ++t) {
        const uint32_t *corner = &surface->triangles[3 * t];
        const double area = pci_triangle_area(surface, t);
        total += area;
        for (size_t c = 0; c < 3; ++c) {
            h->masses[corner[c]] += area / 3.0;
            const uint32_t a = corner[(c + 1) % 3], b = corner[(c + 2) % 3];
            const double value = 0.5 * time * cotangent(surface, t, c);
            if (a != b && value > 0.0) {
                add_entry(h, a, b, -value);
                add_entry(h, b, a, -value);
                add_entry(h, a, a, value);
                add_entry(h, b, b, value);
            }
        }
    }
    // Vertices without area keep their weights.
    for (size_t v = 0; v < nv; ++v) {
        h->masses[v] += 1e-12 * total / (double)nv;
        add_entry(h, (uint32_t)v, (uint32_t)v, h->masses[v]);
    }
    return true;
}

// How far heat flows: the time that belongs to the proxy's edges.
static bool find_time(pc_context *context, const pc_mesh *proxy, double *time) {
    pci_scratch scratch = pci_scratch_begin(context);
    pci_topology topology;
    const bool good = pci_topology_build(&scratch, proxy, &topology);
    if (good) {
        const double reach = 0.25 * pci_mean_edge_length(proxy, &topology);
        *time = reach * reach;
    }
    pci_scratch_end(&scratch);
    return good;
}

// M + t L, factorised, and M.
static pc_status factorise_heat(pc_context *context, const pc_mesh *surface, double time,
                                double *masses, pci_cholesky **cholesky) {
    pci_scratch scratch = pci_scratch_begin(context);
    heat h = {.masses = masses};
    const pc_status status = build_heat(&scratch, surface, time, &h)
                                 ? pci_cholesky_create(context, stage, surface->vertex_count,
                                                       h.offsets, h.rows, h.values, cholesky)
                                 : pci_fail_memory(context, stage);
    pci_scratch_end(&scratch);
    pci_give_back(context);
    return status;
}

// Some proxy vertices whose heat flows, COLUMNS at a time by each of some threads.
typedef struct flow_job {
    const pci_cholesky *cholesky;
    const pc_skin *closest;
    const double *masses;
    size_t first; // of the proxy vertices
    size_t pieces;
    double *columns; // of each piece #V by COLUMNS, in the order of the factor
    pc_skin *skin;
} flow_job;

static double *piece_columns(const flow_job *job, size_t piece) {
    return &job->columns[piece * job->skin->vertex_count * COLUMNS];
}

static void flow_pieces(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const flow_job *job = user;
    const size_t nv = job->skin->vertex_count;
    const uint32_t *order = pci_cholesky_order(job->cholesky);
    for (size_t piece = begin; piece < end; ++piece) {
        const size_t first = job->first + piece * COLUMNS;
        double *x = piece_columns(job, piece);
        memset(x, 0, nv * COLUMNS * sizeof(*x));
        for (size_t i = 0; i < 3 * nv; ++i) {
            const size_t v = order[i / 3], at = 3 * v + i % 3;
            const size_t column = job->closest->bones[at] - first; // large where it is below
            if (column < COLUMNS) {
                x[i / 3 * COLUMNS + column] += job->masses[v] * job->closest->weights[at];
            }
        }
        pci_cholesky_solve_ordered(job->cholesky, x);
    }
}

static void keep_largest(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const flow_job *job = user;
    const uint32_t slots = job->skin->influences;
    const uint32_t *order = pci_cholesky_order(job->cholesky);
    for (size_t i = begin; i < end; ++i) {
        const size_t row = (size_t)order[i] * slots;
        for (size_t c = 0; c < job->pieces * COLUMNS; ++c) {
            const double weight = piece_columns(job, c / COLUMNS)[i * COLUMNS + c % COLUMNS];
            if (weight > 0.0) {
                insert(&job->skin->bones[row], &job->skin->weights[row], slots,
                       (uint32_t)(job->first + c), weight);
            }
        }
    }
}

// Lets the weights of some proxy vertices flow at a time and keeps the largest of each row.
static pc_status flow(pc_context *context, const pci_cholesky *cholesky, const double *masses,
                      const pc_skin *closest, size_t proxy_count, pc_skin *skin) {
    const size_t nv = skin->vertex_count;
    const uint32_t threads = pc_context_threads(context);
    const size_t pieces = threads < MOST_PIECES ? threads : MOST_PIECES, step = pieces * COLUMNS;
    flow_job job = {.cholesky = cholesky,
                    .closest = closest,
                    .masses = masses,
                    .pieces = pieces,
                    .columns = PCI_ALLOCATE(context, double, nv *step),
                    .skin = skin};
    pc_status status = job.columns == NULL ? pci_fail_memory(context, stage) : PC_OK;
    for (; job.first < proxy_count && status == PC_OK; job.first += step) {
        pci_parallel_for(context, pieces, 1, flow_pieces, &job);
        pci_parallel_for(context, nv, 256, keep_largest, &job);
        if (!pci_progress(context, stage, (double)job.first / (double)proxy_count)) {
            status = pci_fail_cancelled(context, stage);
        }
    }
    pc_release(context, job.columns);
    return status;
}

pc_status pci_skin_smooth(pc_context *context, const pc_mesh *surface, const pc_mesh *proxy,
                          const pc_skin *closest, uint32_t influences, pc_skin *skin) {
    double time = 0.0;
    double *masses = PCI_ALLOCATE(context, double, surface->vertex_count);
    pci_cholesky *cholesky = NULL;
    pc_status status = masses != NULL && find_time(context, proxy, &time)
                           ? factorise_heat(context, surface, time, masses, &cholesky)
                           : pci_fail_memory(context, stage);
    if (status == PC_OK) {
        status = pci_skin_allocate(context, surface->vertex_count, influences, skin)
                     ? flow(context, cholesky, masses, closest, proxy->vertex_count, skin)
                     : pci_fail_memory(context, stage);
    }
    pci_cholesky_destroy(context, cholesky);
    pc_release(context, masses);
    return finish(context, status, skin);
}

pc_status pc_skin_heat_smoothed(pc_context *context, const pc_mesh *surface, const pc_mesh *proxy,
                                uint32_t influences, pc_skin *skin) {
    pc_status status = check(context, surface, proxy, influences, skin);
    pc_skin closest = {0};
    if (status == PC_OK) {
        status = pc_skin_closest_triangle(context, surface, proxy, &closest);
    }
    if (status == PC_OK) {
        status = pci_skin_smooth(context, surface, proxy, &closest, influences, skin);
    }
    pc_skin_free(context, &closest);
    return status;
}
