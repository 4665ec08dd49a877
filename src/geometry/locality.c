#include "geometry/locality.h"

#include "core/sorting.h"
#include "geometry/topology.h"

enum { axis_bits = 10, index_bits = 32 };

// Spreads the bits of a number below 1024 to every third place.
static uint64_t spread_bits(uint64_t x) {
    x = (x | x << 16) & 0x30000ffu;
    x = (x | x << 8) & 0x300f00fu;
    x = (x | x << 4) & 0x30c30c3u;
    return (x | x << 2) & 0x9249249u;
}

bool pci_sort_points(pci_scratch *scratch, size_t count, const double *positions,
                     uint32_t **order) {
    pci_scratch local = pci_scratch_begin(scratch->context);
    uint64_t *keys = PCI_SCRATCH(&local, uint64_t, count);
    *order = PCI_SCRATCH(scratch, uint32_t, count);
    if (scratch->failed || local.failed) {
        pci_scratch_end(&local);
        return false;
    }
    const pc_mesh points = {.vertex_count = count, .positions = (double *)(uintptr_t)positions};
    double low[3], high[3], extent = 0.0;
    pci_bounding_box(&points, low, high);
    for (size_t k = 0; k < 3; ++k) {
        extent = fmax(extent, high[k] - low[k]);
    }
    const double cells = (double)((1u << axis_bits) - 1u);
    for (size_t v = 0; v < count; ++v) {
        uint64_t code = 0;
        for (size_t k = 0; k < 3; ++k) {
            const double share = extent > 0.0 ? (positions[3 * v + k] - low[k]) / extent : 0.0;
            code |= spread_bits((uint64_t)(share * cells)) << k;
        }
        keys[v] = code << index_bits | v;
    }
    const bool done = pci_sort_keys(scratch->context, count, keys, NULL);
    for (size_t i = 0; i < count; ++i) {
        (*order)[i] = (uint32_t)keys[i];
    }
    pci_scratch_end(&local);
    return done;
}

bool pci_sort_mesh(pci_scratch *scratch, const pc_mesh *mesh, pc_mesh *result, uint32_t **order) {
    const size_t nv = mesh->vertex_count, nf = mesh->triangle_count;
    pci_scratch local = pci_scratch_begin(scratch->context);
    uint64_t *keys = PCI_SCRATCH(&local, uint64_t, nf);
    uint32_t *number = PCI_SCRATCH(&local, uint32_t, nv);
    result->vertex_count = nv;
    result->triangle_count = nf;
    result->positions = PCI_SCRATCH(scratch, double, 3 * nv);
    result->triangles = PCI_SCRATCH(scratch, uint32_t, 3 * nf);
    if (scratch->failed || local.failed || !pci_sort_points(scratch, nv, mesh->positions, order)) {
        pci_scratch_end(&local);
        return false;
    }
    for (size_t i = 0; i < nv; ++i) {
        const uint32_t v = (*order)[i];
        number[v] = (uint32_t)i;
        memcpy(&result->positions[3 * i], &mesh->positions[3 * (size_t)v],
               3 * sizeof(*result->positions));
    }
    for (size_t t = 0; t < nf; ++t) {
        keys[t] = (uint64_t)number[mesh->triangles[3 * t]] << index_bits | t;
    }
    const bool done = pci_sort_keys(scratch->context, nf, keys, NULL);
    for (size_t i = 0; i < nf; ++i) {
        const size_t t = (uint32_t)keys[i];
        for (size_t c = 0; c < 3; ++c) {
            result->triangles[3 * i + c] = number[mesh->triangles[3 * t + c]];
        }
    }
    pci_scratch_end(&local);
    return done;
}
