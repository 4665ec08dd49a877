#include "stages/simplify/density.h"

#include "core/heap.h"

enum { grain = 256 };

// Growth of the wanted edge length per distance; neighbouring edges differ by about as much.
static const double gradation = 0.3;

pc_status pci_density_begin(pc_context *context, const char *stage, const pc_visual *visual,
                            size_t channel, double range, pci_density *density) {
    *density =
        (pci_density){.context = context, .visual = visual, .channel = channel, .range = range};
    return pci_bvh_create(context, stage, &visual->surface, &density->bvh);
}

void pci_density_end(pci_density *density) {
    if (density->context != NULL) {
        pci_bvh_destroy(density->context, density->bvh);
    }
    memset(density, 0, sizeof(*density));
}

typedef struct sampler {
    const pci_density *density;
    const double *points;
    double *scales;
} sampler;

static void sample_points(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const sampler *s = user;
    const pc_visual *visual = s->density->visual;
    for (size_t i = begin; i < end; ++i) {
        const pci_closest closest = pci_bvh_closest(s->density->bvh, &s->points[3 * i], INFINITY);
        double value = 0.0;
        for (size_t c = 0; closest.triangle != PC_INVALID_INDEX && c < 3; ++c) {
            const size_t corner = visual->corner_triangles[3 * (size_t)closest.triangle + c];
            value +=
                closest.barycentric[c] * (double)visual->colors[4 * corner + s->density->channel];
        }
        s->scales[i] = pow(s->density->range, fmin(fmax(value, 0.0), 1.0));
    }
}

bool pci_density_sample(const pci_density *density, size_t count, const double *points,
                        double *scales) {
    sampler s = {density, points, scales};
    return pci_parallel_while_wanted(density->context, count, grain, sample_points, &s);
}

bool pci_limit_gradation(pci_scratch *scratch, const pci_halfedge *mesh, double spacing,
                         double *scales) {
    pci_heap front = {0}; // by wanted length, the shortest first: each vertex is settled once
    for (uint32_t v = 0; v < mesh->vertex_count; ++v) {
        if (!pci_heap_push(scratch, &front, spacing / scales[v], v)) {
            return false;
        }
    }
    pci_heap_entry entry;
    while (pci_heap_pop(&front, &entry)) {
        const uint32_t v = entry.item;
        if (entry.key > spacing / scales[v]) {
            continue;
        }
        PCI_FOR_OUTGOING(mesh, v, h) {
            const uint32_t ends[2] = {pci_target(mesh, h), mesh->corners[pci_previous(h)]};
            for (size_t i = 0; i < 2; ++i) {
                const double way = sqrt(pci_squared_distance(
                    &mesh->positions[3 * (size_t)v], &mesh->positions[3 * (size_t)ends[i]]));
                const double scale = spacing / (entry.key + gradation * way);
                if (scale > scales[ends[i]]) {
                    scales[ends[i]] = scale;
                    if (!pci_heap_push(scratch, &front, spacing / scale, ends[i])) {
                        return false;
                    }
                }
            }
        }
    }
    return true;
}
