#include "stages/simplify/sizing.h"

// Edges of this many radii are fine: a tube of five edges around.
static const double edge_per_radius = 1.2;
// Passes that even out the sizes of neighbouring clusters.
static const size_t blur_passes = 2;

// Averages the sizes with those of the neighbours, weighted by the common boundary.
static void blur(const pci_halfedge *mesh, const uint32_t *cluster, size_t cluster_count,
                 double *sizes, double *sums, double *counts) {
    memset(sums, 0, cluster_count * sizeof(*sums));
    memset(counts, 0, cluster_count * sizeof(*counts));
    for (uint32_t h = 0; h < 3 * mesh->triangle_count; ++h) {
        const uint32_t a = cluster[pci_origin(mesh, h)], b = cluster[pci_target(mesh, h)];
        if (a != b) {
            sums[a] += sizes[b], ++counts[a];
            sums[b] += sizes[a], ++counts[b];
        }
    }
    for (size_t i = 0; i < cluster_count; ++i) {
        if (counts[i] > 0.0) {
            sizes[i] = 0.5 * sizes[i] + 0.5 * sums[i] / counts[i];
        }
    }
}

bool pci_size_clusters(pci_scratch *scratch, const uint32_t *cluster, size_t cluster_count,
                       double limit, pci_sampling *sampling) {
    const pci_halfedge *mesh = &sampling->mesh;
    const double *areas = sampling->areas;
    double *normal = PCI_SCRATCH(scratch, double, 3 * cluster_count);
    double *area = PCI_SCRATCH(scratch, double, cluster_count);
    double *arc = PCI_SCRATCH(scratch, double, cluster_count);
    double *sizes = PCI_SCRATCH(scratch, double, cluster_count);
    if (scratch->failed) {
        return false;
    }
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        const size_t i = cluster[v];
        area[i] += areas[v];
        arc[i] += sampling->arcs[v];
        for (size_t k = 0; k < 3; ++k) {
            normal[3 * i + k] += areas[v] * sampling->normals[3 * v + k];
        }
    }
    for (size_t i = 0; i < cluster_count; ++i) {
        // On a cylinder of radius r the mean normal of a cluster of width h has the length
        // sin(h / 2r) / (h / 2r), about 1 - (h / r)^2 / 24.
        const double spread = fmax(0.0, 1.0 - pci_norm(&normal[3 * i]) / area[i]);
        const double bent = sqrt(24.0 * spread) / edge_per_radius;
        // A piece of a strap has the area of its width times half its border.
        const double narrow = sampling->spacing * arc[i] / (2.0 * area[i]);
        sizes[i] = fmin(fmax(1.0, fmax(bent, narrow)), limit);
    }
    for (size_t pass = 0; pass < blur_passes; ++pass) {
        blur(mesh, cluster, cluster_count, sizes, normal, arc);
    }
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        sampling->scales[v] = sizes[cluster[v]];
    }
    return true;
}
