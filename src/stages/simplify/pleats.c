#include "stages/simplify/pleats.h"

#include "geometry/topology.h"
#include "solvers/conjugate_gradients.h"

enum { most_iterations = 1000 };
static const double rough = 1e-2, fine = 1e-4; // tolerances
// Mean cosine between normals and what is their mean around them. A surface of more stands in no
// pleats worth a change of shape; parts of it between the other two are flattened less.
static const double pleated_cosine = 0.7, flat_cosine = 0.9, lost_cosine = 0.75;
// Normals cancel out around a sleeve: their mean is 1 / (1 + (2 pi / n)^2) long where that is n
// coming edges around, here a little more than three, and three and a half. Thinner ones stay.
static const double sleeve_length = 0.2, wide_length = 0.25;
// Waves shorter than about four times this many edges go.
static const double width_share = 0.5;

// One coordinate at a time. K is the graph Laplacian over 1.5 e^2, which is the negative Laplacian
// on an even mesh of edge length e.
typedef struct smoothing {
    const pci_topology *topology;
    size_t count;
    double scale;            // 1 / (1.5 e^2)
    double square;           // of the length over which normals are averaged
    const double *strengths; // #V, fourth powers of the widths
    double *once;            // W^4 K x
} smoothing;

static void apply_laplacian(const smoothing *s, const double *x, double *out) {
    for (size_t v = 0; v < s->count; ++v) {
        double sum = 0.0;
        for (size_t i = s->topology->ring_offsets[v]; i < s->topology->ring_offsets[v + 1]; ++i) {
            sum += x[v] - x[s->topology->ring[i]];
        }
        out[v] = s->scale * sum;
    }
}

// I + square K
static void average(void *user, const double *x, double *out) {
    const smoothing *s = user;
    apply_laplacian(s, x, out);
    for (size_t v = 0; v < s->count; ++v) {
        out[v] = x[v] + s->square * out[v];
    }
}

// I + K W^4 K
static void flatten(void *user, const double *x, double *out) {
    const smoothing *s = user;
    apply_laplacian(s, x, s->once);
    for (size_t v = 0; v < s->count; ++v) {
        s->once[v] *= s->strengths[v];
    }
    apply_laplacian(s, s->once, out);
    for (size_t v = 0; v < s->count; ++v) {
        out[v] += x[v];
    }
}

// Solves A y = x for every `stride`-th number from x on; `work` is #V by 4. False: cancelled.
static bool solve(pc_context *context, smoothing *s, pci_linear_map map, double tolerance,
                  double *x, size_t stride, double *work) {
    const pci_conjugate_gradients system = {s->count, map, s, tolerance, most_iterations};
    double *y = work, *residual = work + s->count;
    for (size_t v = 0; v < s->count; ++v) {
        y[v] = x[stride * v];
    }
    map(s, y, residual);
    for (size_t v = 0; v < s->count; ++v) {
        residual[v] = y[v] - residual[v];
    }
    if (!pci_conjugate_gradients_run(context, &system, residual, work + 2 * s->count, y)) {
        return false;
    }
    for (size_t v = 0; v < s->count; ++v) {
        x[stride * v] = y[v];
    }
    return true;
}

static bool solve_vectors(pc_context *context, smoothing *s, pci_linear_map map, double tolerance,
                          double *x, double *work) {
    return solve(context, s, map, tolerance, &x[0], 3, work) &&
           solve(context, s, map, tolerance, &x[1], 3, work) &&
           solve(context, s, map, tolerance, &x[2], 3, work);
}

static double mean_squared_length(const pc_mesh *mesh, const pci_topology *topology) {
    double sum = 0.0;
    for (size_t e = 0; e < topology->edge_count; ++e) {
        sum += pci_squared_distance(&mesh->positions[3 * (size_t)topology->edges[2 * e]],
                                    &mesh->positions[3 * (size_t)topology->edges[2 * e + 1]]);
    }
    return topology->edge_count > 0 ? sum / (double)topology->edge_count : 0.0;
}

// How well the normals agree with their mean around them, again as a mean: `cosines`, #V, and how
// long that mean is: `lengths`, #V.
static bool find_cosines(pci_scratch *scratch, smoothing *s, const double *normals, double *cosines,
                         double *lengths, double *work) {
    double *means = PCI_SCRATCH(scratch, double, 3 * s->count);
    if (means == NULL) {
        return false;
    }
    memcpy(means, normals, 3 * s->count * sizeof(*means));
    if (!solve_vectors(scratch->context, s, average, rough, means, work)) {
        return false;
    }
    for (size_t v = 0; v < s->count; ++v) {
        lengths[v] = pci_norm(&means[3 * v]);
        cosines[v] = pci_normalize(&means[3 * v]) ? pci_dot(&means[3 * v], &normals[3 * v]) : 1.0;
    }
    return solve(scratch->context, s, average, rough, cosines, 1, work);
}

// 0 up to `none`, 1 from `all` on.
static double ramp(double x, double none, double all) {
    return fmin(fmax((x - none) / (all - none), 0.0), 1.0);
}

static bool run(pci_scratch *scratch, double spacing, pc_mesh *mesh, double *normals) {
    pci_topology topology;
    const size_t n = mesh->vertex_count;
    double *work = PCI_SCRATCH(scratch, double, 4 * n),
           *strengths = PCI_SCRATCH(scratch, double, n), *lengths = PCI_SCRATCH(scratch, double, n);
    smoothing s = {.topology = &topology, .count = n, .square = spacing * spacing};
    s.once = PCI_SCRATCH(scratch, double, n);
    if (scratch->failed || !pci_topology_build(scratch, mesh, &topology)) {
        return false;
    }
    const double square = mean_squared_length(mesh, &topology);
    if (!(square > 0.0)) {
        return true;
    }
    s.scale = 1.0 / (1.5 * square);
    s.strengths = strengths;
    if (!find_cosines(scratch, &s, normals, strengths, lengths, work)) {
        return false;
    }
    double sum = 0.0;
    for (size_t v = 0; v < n; ++v) {
        sum += strengths[v]; // still the cosines
        const double share = ramp(strengths[v], flat_cosine, lost_cosine) *
                             ramp(lengths[v], sleeve_length, wide_length);
        strengths[v] = pow(width_share * spacing * share, 4.0);
    }
    if (sum > pleated_cosine * (double)n) {
        return true;
    }
    if (!solve_vectors(scratch->context, &s, flatten, fine, mesh->positions, work)) {
        return false;
    }
    pci_vertex_normals(mesh, normals);
    return true;
}

bool pci_flatten_pleats(pci_scratch *scratch, double spacing, pc_mesh *mesh, double *normals) {
    pci_scratch inner = pci_scratch_begin(scratch->context);
    const bool done = run(&inner, spacing, mesh, normals);
    pci_scratch_end(&inner);
    return done;
}
