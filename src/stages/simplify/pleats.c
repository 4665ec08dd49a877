#include "stages/simplify/pleats.h"

#include "geometry/topology.h"
#include "solvers/conjugate_gradients.h"

enum { most_iterations = 1000, grain = 512 };
static const double rough = 1e-2, fine = 1e-4; // tolerances
// Mean cosine between normals and what is their mean around them. A surface of more stands in no
// pleats worth a change of shape; parts of it between the other two are flattened less.
static const double pleated_cosine = 0.7, flat_cosine = 0.9, lost_cosine = 0.75;
// Pleats bend to both sides by turns, so that their curvature cancels out; that of sleeves and
// shoulders, of which more than this share is left, does not.
static const double waved_share = 0.5, round_share = 0.75;
// Waves shorter than about four times this many edges go.
static const double width_share = 0.5;

// K is the graph Laplacian over 1.5 e^2, which is the negative Laplacian on an even mesh of edge
// length e.
typedef struct smoothing {
    pc_context *context;
    const pci_topology *topology;
    size_t count, columns;   // vertices; numbers of each
    double scale;            // 1 / (1.5 e^2)
    double square;           // of the length over which normals are averaged
    const double *strengths; // #V, fourth powers of the widths
    const double *x;         // #V by #columns, what is mapped
    double *once, *out;      // W^4 K x, and the result
} smoothing;

// K x at vertex v
static inline void laplacian(const smoothing *s, size_t columns, const double *x, size_t v,
                             double *out) {
    double sum[3] = {0.0};
    for (size_t i = s->topology->ring_offsets[v]; i < s->topology->ring_offsets[v + 1]; ++i) {
        for (size_t c = 0; c < columns; ++c) {
            sum[c] += x[columns * v + c] - x[columns * s->topology->ring[i] + c];
        }
    }
    for (size_t c = 0; c < columns; ++c) {
        out[c] = s->scale * sum[c];
    }
}

static inline void average_pieces(const smoothing *s, size_t columns, size_t begin, size_t end) {
    for (size_t v = begin; v < end; ++v) {
        double *out = &s->out[columns * v];
        laplacian(s, columns, s->x, v, out);
        for (size_t c = 0; c < columns; ++c) {
            out[c] = s->x[columns * v + c] + s->square * out[c];
        }
    }
}

static void average_piece(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const smoothing *s = user;
    if (s->columns == 1) {
        average_pieces(s, 1, begin, end);
    } else {
        average_pieces(s, 3, begin, end);
    }
}

// I + square K
static void average(void *user, const double *x, double *out) {
    smoothing *s = user;
    s->x = x, s->out = out;
    pci_parallel_for(s->context, s->count, grain, average_piece, s);
}

static void bend_piece(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const smoothing *s = user;
    for (size_t v = begin; v < end; ++v) {
        laplacian(s, 3, s->x, v, &s->once[3 * v]);
        for (size_t c = 0; c < 3; ++c) {
            s->once[3 * v + c] *= s->strengths[v];
        }
    }
}

static void flatten_piece(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const smoothing *s = user;
    for (size_t v = begin; v < end; ++v) {
        laplacian(s, 3, s->once, v, &s->out[3 * v]);
        for (size_t c = 0; c < 3; ++c) {
            s->out[3 * v + c] += s->x[3 * v + c];
        }
    }
}

// I + K W^4 K, of three columns
static void flatten(void *user, const double *x, double *out) {
    smoothing *s = user;
    s->x = x, s->out = out;
    pci_parallel_for(s->context, s->count, grain, bend_piece, s);
    pci_parallel_for(s->context, s->count, grain, flatten_piece, s);
}

// Solves A y = x for every column; `work` is three times as large as x, which becomes y. False:
// cancelled.
static bool solve(smoothing *s, size_t columns, pci_linear_map map, double tolerance, double *x,
                  double *work) {
    const size_t size = columns * s->count;
    const pci_conjugate_gradients system = {s->count, columns, map, s, tolerance, most_iterations};
    double *residual = work;
    s->columns = columns;
    map(s, x, residual);
    for (size_t i = 0; i < size; ++i) {
        residual[i] = x[i] - residual[i];
    }
    return pci_conjugate_gradients_run(s->context, &system, residual, work + size, x);
}

static double mean_squared_length(const pc_mesh *mesh, const pci_topology *topology) {
    double sum = 0.0;
    for (size_t e = 0; e < topology->edge_count; ++e) {
        sum += pci_squared_distance(&mesh->positions[3 * (size_t)topology->edges[2 * e]],
                                    &mesh->positions[3 * (size_t)topology->edges[2 * e + 1]]);
    }
    return topology->edge_count > 0 ? sum / (double)topology->edge_count : 0.0;
}

// How well the normals agree with their mean around them: `cosines`, #V.
static bool find_cosines(pci_scratch *scratch, smoothing *s, const double *normals, double *cosines,
                         double *work) {
    double *means = PCI_SCRATCH(scratch, double, 3 * s->count);
    if (means == NULL) {
        return false;
    }
    memcpy(means, normals, 3 * s->count * sizeof(*means));
    if (!solve(s, 3, average, rough, means, work)) {
        return false;
    }
    for (size_t v = 0; v < s->count; ++v) {
        cosines[v] = pci_normalize(&means[3 * v]) ? pci_dot(&means[3 * v], &normals[3 * v]) : 1.0;
    }
    return true;
}

// How much of the curvature around each vertex is to one side: `shares`, #V, 0 in waves and 1 where
// the surface is round.
static bool find_round(pci_scratch *scratch, smoothing *s, const pc_mesh *mesh,
                       const double *normals, double *shares, double *work) {
    double *bends = PCI_SCRATCH(scratch, double, s->count);
    if (bends == NULL) {
        return false;
    }
    for (size_t v = 0; v < s->count; ++v) {
        double out[3];
        laplacian(s, 3, mesh->positions, v, out);
        shares[v] = pci_dot(out, &normals[3 * v]);
        bends[v] = fabs(shares[v]);
    }
    for (size_t i = 0; i < 2; ++i) {
        if (!solve(s, 1, average, rough, shares, work) ||
            !solve(s, 1, average, rough, bends, work)) {
            return false;
        }
    }
    for (size_t v = 0; v < s->count; ++v) {
        shares[v] = bends[v] > 0.0 ? fabs(shares[v]) / bends[v] : 1.0;
    }
    return true;
}

// 0 up to `none`, 1 from `all` on.
static double ramp(double x, double none, double all) {
    return fmin(fmax((x - none) / (all - none), 0.0), 1.0);
}

static double mean(const double *values, size_t count) {
    double sum = 0.0;
    for (size_t i = 0; i < count; ++i) {
        sum += values[i];
    }
    return sum / (double)count;
}

static bool run(pci_scratch *scratch, double spacing, pc_mesh *mesh, double *normals, bool *some) {
    pci_topology topology;
    const size_t n = mesh->vertex_count;
    double *work = PCI_SCRATCH(scratch, double, 9 * n);
    double *strengths = PCI_SCRATCH(scratch, double, n);
    double *rounds = PCI_SCRATCH(scratch, double, n);
    smoothing s = {.context = scratch->context,
                   .topology = &topology,
                   .count = n,
                   .square = spacing * spacing,
                   .strengths = strengths};
    s.once = PCI_SCRATCH(scratch, double, 3 * n);
    if (scratch->failed || !pci_topology_build(scratch, mesh, &topology)) {
        return false;
    }
    const double square = mean_squared_length(mesh, &topology);
    if (!(square > 0.0)) {
        return true;
    }
    s.scale = 1.0 / (1.5 * square);
    // Deep folds still stand in pleats when they have been flattened once.
    for (size_t pass = 0; pass < 2; ++pass) {
        if (!find_cosines(scratch, &s, normals, strengths, work)) {
            return false;
        }
        if (pass == 0 && mean(strengths, n) > pleated_cosine) {
            return true;
        }
        if ((pass == 0 && !find_round(scratch, &s, mesh, normals, rounds, work)) ||
            !solve(&s, 1, average, rough, strengths, work)) {
            return false;
        }
        for (size_t v = 0; v < n; ++v) {
            const double share = ramp(strengths[v], flat_cosine, lost_cosine) *
                                 ramp(rounds[v], round_share, waved_share);
            strengths[v] = pow(width_share * spacing * share, 4.0);
            *some = *some || strengths[v] > 0.0;
        }
        if (!solve(&s, 3, flatten, fine, mesh->positions, work)) {
            return false;
        }
        pci_vertex_normals(mesh, normals);
    }
    return true;
}

bool pci_flatten_pleats(pci_scratch *scratch, double spacing, pc_mesh *mesh, double *normals,
                        bool *some) {
    pci_scratch inner = pci_scratch_begin(scratch->context);
    *some = false;
    const bool done = run(&inner, spacing, mesh, normals, some);
    pci_scratch_end(&inner);
    return done;
}
