#include "stages/carve/folds.h"

#include "geometry/topology.h"
#include "solvers/conjugate_gradients.h"

enum { most_iterations = 1000 };
static const double tolerance = 1e-6;

// One coordinate at a time: (I + width^4 K^2) x = x0, K the graph Laplacian over 1.5 e^2, which is
// the negative Laplacian on an even mesh of edge length e.
typedef struct smoothing {
    const pci_topology *topology;
    size_t count;
    double factor; // width^2 / (1.5 e^2)
    double *once;  // K x
} smoothing;

static void apply_laplacian(const smoothing *s, const double *x, double *out) {
    for (size_t v = 0; v < s->count; ++v) {
        double sum = 0.0;
        for (size_t i = s->topology->ring_offsets[v]; i < s->topology->ring_offsets[v + 1]; ++i) {
            sum += x[v] - x[s->topology->ring[i]];
        }
        out[v] = s->factor * sum;
    }
}

static void apply(void *user, const double *x, double *out) {
    const smoothing *s = user;
    apply_laplacian(s, x, s->once);
    apply_laplacian(s, s->once, out);
    for (size_t v = 0; v < s->count; ++v) {
        out[v] += x[v];
    }
}

// From x = x0; `work` is #V by 3. False: cancelled.
static bool solve(pc_context *context, smoothing *s, double *x, double *work) {
    const pci_conjugate_gradients system = {s->count, apply, s, tolerance, most_iterations};
    double *residual = work;
    apply(s, x, residual);
    for (size_t i = 0; i < s->count; ++i) {
        residual[i] = x[i] - residual[i];
    }
    return pci_conjugate_gradients_run(context, &system, residual, work + s->count, x);
}

bool pci_flatten_folds(pci_scratch *scratch, double width, pc_mesh *mesh) {
    pci_topology topology;
    const size_t n = mesh->vertex_count;
    double *x = PCI_SCRATCH(scratch, double, n), *work = PCI_SCRATCH(scratch, double, 3 * n);
    smoothing s = {.topology = &topology, .count = n, .once = PCI_SCRATCH(scratch, double, n)};
    if (scratch->failed || !pci_topology_build(scratch, mesh, &topology)) {
        return false;
    }
    double square = 0.0;
    for (size_t e = 0; e < topology.edge_count; ++e) {
        square += pci_squared_distance(&mesh->positions[3 * (size_t)topology.edges[2 * e]],
                                       &mesh->positions[3 * (size_t)topology.edges[2 * e + 1]]) /
                  (double)topology.edge_count;
    }
    if (!(square > 0.0)) {
        return true;
    }
    s.factor = width * width / (1.5 * square);
    for (size_t k = 0; k < 3; ++k) {
        for (size_t v = 0; v < n; ++v) {
            x[v] = mesh->positions[3 * v + k];
        }
        if (!solve(scratch->context, &s, x, work)) {
            return false;
        }
        for (size_t v = 0; v < n; ++v) {
            mesh->positions[3 * v + k] = x[v];
        }
    }
    return true;
}
