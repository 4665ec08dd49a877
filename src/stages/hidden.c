#include "stages/hidden.h"

#include <stdlib.h>

#include "core/bvh.h"
#include "core/topology.h"

enum { grain = 256, most_large = 20 };
static const double large_share = 1.0 / most_large;

typedef struct part {
    double area;
    uint32_t component;
} part;

typedef struct hiding {
    pci_scratch *scratch;
    const pc_mesh *mesh;
    double reach;
    size_t count;        // of components
    uint32_t *component; // #F
    part *parts;         // components, largest first
    size_t large_count;
    pc_mesh large[most_large]; // their triangles
    pci_bvh *bvh[most_large];
    uint32_t *vertex_component; // #V
    uint32_t *near;             // #V, bit i: the i-th large component is within reach
} hiding;

static int compare_parts(const void *left, const void *right) {
    const part *a = left, *b = right;
    if (a->area != b->area) {
        return a->area > b->area ? -1 : 1;
    }
    return (a->component > b->component) - (a->component < b->component);
}

static bool list_parts(hiding *h) {
    pci_topology topology;
    double total = 0.0;
    h->component = PCI_SCRATCH(h->scratch, uint32_t, h->mesh->triangle_count);
    h->vertex_component = PCI_SCRATCH(h->scratch, uint32_t, h->mesh->vertex_count);
    h->near = PCI_SCRATCH(h->scratch, uint32_t, h->mesh->vertex_count);
    if (h->scratch->failed || !pci_topology_build(h->scratch, h->mesh, &topology)) {
        return false;
    }
    h->count = pci_triangle_components(h->scratch, h->mesh, &topology, h->component);
    h->parts = PCI_SCRATCH(h->scratch, part, h->count);
    if (h->parts == NULL) {
        return false;
    }
    for (uint32_t i = 0; i < h->count; ++i) {
        h->parts[i].component = i;
    }
    for (size_t t = 0; t < h->mesh->triangle_count; ++t) {
        const double area = pci_triangle_area(h->mesh, t);
        h->parts[h->component[t]].area += area;
        total += area;
        for (size_t c = 0; c < 3; ++c) {
            h->vertex_component[h->mesh->triangles[3 * t + c]] = h->component[t];
        }
    }
    qsort(h->parts, h->count, sizeof(*h->parts), compare_parts);
    while (h->large_count < h->count && h->large_count < most_large &&
           h->parts[h->large_count].area >= large_share * total) {
        ++h->large_count;
    }
    return true;
}

static pc_status build_large(hiding *h, const char *stage) {
    pc_context *context = h->scratch->context;
    uint8_t *keep = PCI_SCRATCH(h->scratch, uint8_t, h->mesh->triangle_count);
    pc_status status = keep != NULL ? PC_OK : pci_fail_memory(context, stage);
    for (size_t i = 0; i < h->large_count && status == PC_OK; ++i) {
        for (size_t t = 0; t < h->mesh->triangle_count; ++t) {
            keep[t] = h->component[t] == h->parts[i].component;
        }
        status = pci_mesh_compact(h->scratch, h->mesh, keep, &h->large[i], NULL)
                     ? pci_bvh_create(context, stage, &h->large[i], &h->bvh[i])
                     : pci_fail_memory(context, stage);
    }
    return status;
}

// `last` is, for each large component, what was near the last point.
static uint32_t find_near(const hiding *h, uint32_t component, const double point[3],
                          uint32_t last[most_large]) {
    uint32_t near = 0;
    for (size_t i = 0; i < h->large_count; ++i) {
        if (h->parts[i].component == component) {
            break; // the others are not larger
        }
        if (pci_bvh_within_near(h->bvh[i], point, h->reach, &last[i])) {
            near |= UINT32_C(1) << i;
        }
    }
    return near;
}

static void look_around(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    hiding *h = user;
    uint32_t last[most_large];
    memset(last, 0xff, sizeof(last));
    for (size_t v = begin; v < end; ++v) {
        h->near[v] = find_near(h, h->vertex_component[v], &h->mesh->positions[3 * v], last);
    }
}

// Large components that a whole triangle is near to; its middle is asked where it is wide.
static uint32_t triangle_near(const hiding *h, size_t t, uint32_t last[most_large]) {
    const uint32_t *corner = &h->mesh->triangles[3 * t];
    double square = 0.0;
    for (size_t k = 0; k < 3; ++k) {
        const double *p = &h->mesh->positions[3 * (size_t)corner[k]];
        square = fmax(
            square, pci_squared_distance(p, &h->mesh->positions[3 * (size_t)corner[(k + 1) % 3]]));
    }
    const uint32_t near = h->near[corner[0]] & h->near[corner[1]] & h->near[corner[2]];
    if (near == 0 || square <= h->reach * h->reach) {
        return near;
    }
    double middle[3];
    pci_triangle_middle(h->mesh, t, middle);
    return near & find_near(h, h->component[t], middle, last);
}

// Marks the triangles that stay. Returns whether any goes; with `failed` in scratch, nothing
// counts.
static bool choose_parts(const hiding *h, uint8_t *keep) {
    uint32_t *rank = PCI_SCRATCH(h->scratch, uint32_t, h->count);
    uint8_t *seen = PCI_SCRATCH(h->scratch, uint8_t, h->count); // by rank
    uint32_t *near = PCI_SCRATCH(h->scratch, uint32_t, h->mesh->triangle_count);
    uint32_t last[most_large];
    memset(last, 0xff, sizeof(last));
    if (h->scratch->failed) {
        return false;
    }
    for (uint32_t i = 0; i < h->count; ++i) {
        rank[h->parts[i].component] = i;
    }
    for (size_t t = 0; t < h->mesh->triangle_count; ++t) {
        near[t] = triangle_near(h, t, last);
        seen[rank[h->component[t]]] |= near[t] == 0;
    }
    // The large ones in turn: what hides a part must stay itself. Then the small ones at once.
    uint32_t stays = 0;
    for (size_t i = 0; i < h->large_count; ++i) {
        for (size_t t = 0; t < h->mesh->triangle_count && !seen[i]; ++t) {
            seen[i] |= rank[h->component[t]] == i && (near[t] & stays) == 0;
        }
        stays |= seen[i] ? UINT32_C(1) << i : 0;
    }
    for (size_t t = 0; t < h->mesh->triangle_count; ++t) {
        const uint32_t r = rank[h->component[t]];
        seen[r] |= r >= h->large_count && (near[t] & stays) == 0;
    }
    bool some = false;
    for (size_t t = 0; t < h->mesh->triangle_count; ++t) {
        keep[t] = seen[rank[h->component[t]]];
        some = some || !keep[t];
    }
    return some;
}

pc_status pci_drop_hidden(pci_scratch *scratch, const char *stage, double reach, pc_mesh *mesh) {
    pc_context *context = scratch->context;
    hiding h = {.scratch = scratch, .mesh = mesh, .reach = reach};
    uint8_t *keep = PCI_SCRATCH(scratch, uint8_t, mesh->triangle_count);
    if (keep == NULL || !list_parts(&h)) {
        return pci_fail_memory(context, stage);
    }
    if (h.count < 2 || h.large_count == 0) {
        return PC_OK;
    }
    pc_mesh kept = {0};
    pc_status status = build_large(&h, stage);
    if (status == PC_OK) {
        const bool some =
            pci_parallel_while_wanted(context, mesh->vertex_count, grain, look_around, &h) &&
            choose_parts(&h, keep);
        if ((some && !pci_mesh_compact(scratch, mesh, keep, &kept, NULL)) || scratch->failed) {
            status = pci_fail_memory(context, stage);
        }
    }
    for (size_t i = 0; i < h.large_count; ++i) {
        pci_bvh_destroy(context, h.bvh[i]);
        pc_mesh_free(context, &h.large[i]);
    }
    if (kept.triangle_count > 0) {
        pc_mesh_free(context, mesh);
        *mesh = kept;
    }
    return status;
}
