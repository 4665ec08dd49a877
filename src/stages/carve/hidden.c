#include "stages/carve/hidden.h"

#include <stdlib.h>

#include "geometry/bvh.h"
#include "geometry/topology.h"

// Of each part, a few vertices are asked first, without a tree: most parts show at once that they
// are not hidden.
enum { grain = 256, most_large = 20, probes = 8 };
static const double large_share = 1.0 / most_large;

typedef struct part {
    double area;
    uint32_t component;
} part;

typedef struct hiding {
    pci_scratch *scratch;
    const pc_mesh *mesh;
    double reach;
    size_t count;    // of components
    part *parts;     // components, largest first
    uint32_t *ranks; // #F, of the triangle's component in `parts`
    uint32_t *order; // #F, triangles by rank
    size_t *offsets; // #components + 1, into `order`
    size_t large_count;
    pc_mesh large[most_large]; // their triangles, where somebody asked
    pci_bvh *bvh[most_large];
    uint32_t stays; // bit i: the i-th large component stays, as far as that is known
    uint32_t *near; // #V, bit i: the i-th large component that stays is within reach
} hiding;

static int compare_parts(const void *left, const void *right) {
    const part *a = left, *b = right;
    if (a->area != b->area) {
        return a->area > b->area ? -1 : 1;
    }
    return (a->component > b->component) - (a->component < b->component);
}

static bool list_parts(hiding *h) {
    const size_t triangles = h->mesh->triangle_count;
    double total = 0.0;
    h->ranks = PCI_SCRATCH(h->scratch, uint32_t, triangles);
    h->order = PCI_SCRATCH(h->scratch, uint32_t, triangles);
    h->near = PCI_SCRATCH(h->scratch, uint32_t, h->mesh->vertex_count);
    if (h->scratch->failed) {
        return false;
    }
    h->count = pci_manifold_components(h->scratch, h->mesh, h->ranks);
    h->parts = PCI_SCRATCH(h->scratch, part, h->count);
    h->offsets = PCI_SCRATCH(h->scratch, size_t, h->count + 2);
    uint32_t *rank_of = PCI_SCRATCH(h->scratch, uint32_t, h->count);
    if (h->scratch->failed) {
        return false;
    }
    for (uint32_t i = 0; i < h->count; ++i) {
        h->parts[i].component = i;
    }
    for (size_t t = 0; t < triangles; ++t) {
        const double area = pci_triangle_area(h->mesh, t);
        h->parts[h->ranks[t]].area += area;
        total += area;
    }
    qsort(h->parts, h->count, sizeof(*h->parts), compare_parts);
    while (h->large_count < h->count && h->large_count < most_large &&
           h->parts[h->large_count].area >= large_share * total) {
        ++h->large_count;
    }
    for (uint32_t i = 0; i < h->count; ++i) {
        rank_of[h->parts[i].component] = i;
    }
    for (size_t t = 0; t < triangles; ++t) {
        h->ranks[t] = rank_of[h->ranks[t]];
        ++h->offsets[h->ranks[t] + 2];
    }
    for (size_t i = 2; i <= h->count; ++i) {
        h->offsets[i + 1] += h->offsets[i];
    }
    for (size_t t = 0; t < triangles; ++t) {
        h->order[h->offsets[h->ranks[t] + 1]++] = (uint32_t)t;
    }
    return true;
}

// ---- a few vertices -----------------------------------------------------------------------------

// Whether one of a few vertices of a component is within reach of none of those that stay.
static bool shows_at_once(const hiding *h, uint32_t rank) {
    const size_t first = h->offsets[rank], count = h->offsets[rank + 1] - first;
    for (size_t i = 0; i < probes; ++i) {
        const uint32_t t = h->order[first + i * count / probes];
        const double *point = &h->mesh->positions[3 * (size_t)h->mesh->triangles[3 * (size_t)t]];
        bool near = false;
        for (uint32_t other = 0; other < h->large_count && !near; ++other) {
            const size_t end = (h->stays >> other & 1) != 0 ? h->offsets[other + 1] : 0;
            for (size_t k = h->offsets[other]; k < end && !near; ++k) {
                near = pci_triangle_within(h->mesh, h->order[k], point, h->reach);
            }
        }
        if (!near) {
            return true;
        }
    }
    return false;
}

// ---- all vertices -------------------------------------------------------------------------------

// Makes trees of all that stay.
static pc_status build_large(hiding *h, const char *stage) {
    pc_context *context = h->scratch->context;
    pc_status status = PC_OK;
    for (size_t i = 0; i < h->large_count && status == PC_OK; ++i) {
        if ((h->stays >> i & 1) == 0 || h->bvh[i] != NULL) {
            continue;
        }
        pci_scratch scratch = pci_scratch_begin(context);
        uint8_t *keep = PCI_SCRATCH(&scratch, uint8_t, h->mesh->triangle_count);
        for (size_t k = h->offsets[i]; k < h->offsets[i + 1] && keep != NULL; ++k) {
            keep[h->order[k]] = 1;
        }
        status = keep != NULL && pci_mesh_compact(&scratch, h->mesh, keep, &h->large[i], NULL)
                     ? pci_bvh_create(context, stage, &h->large[i], &h->bvh[i])
                     : pci_fail_memory(context, stage);
        pci_scratch_end(&scratch);
    }
    return status;
}

// Which of the large components in `candidates` are within reach.
static uint32_t find_near(const hiding *h, uint32_t candidates, const double point[3]) {
    uint32_t near = 0;
    for (size_t i = 0; i < h->large_count; ++i) {
        if ((candidates >> i & 1) != 0 && pci_bvh_within(h->bvh[i], point, h->reach)) {
            near |= UINT32_C(1) << i;
        }
    }
    return near;
}

static void look_around(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    hiding *h = user;
    for (size_t v = begin; v < end; ++v) {
        h->near[v] = find_near(h, h->near[v], &h->mesh->positions[3 * v]);
    }
}

// Large components that a whole triangle is near to; its middle is asked where it is wide.
static uint32_t triangle_near(const hiding *h, size_t t) {
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
    return find_near(h, near, middle);
}

// Whether each of the components from `first` to `last` has a triangle that is near none of those
// that stay.
static pc_status look_closely(hiding *h, const char *stage, uint32_t first, uint32_t last,
                              uint8_t *seen) {
    pc_context *context = h->scratch->context;
    const pc_status status = build_large(h, stage);
    if (status != PC_OK) {
        return status;
    }
    memset(h->near, 0, h->mesh->vertex_count * sizeof(*h->near));
    for (size_t k = 3 * h->offsets[first]; k < 3 * h->offsets[last + 1]; ++k) {
        h->near[h->mesh->triangles[3 * (size_t)h->order[k / 3] + k % 3]] = h->stays;
    }
    if (!pci_parallel_while_wanted(context, h->mesh->vertex_count, grain, look_around, h)) {
        return pci_fail_memory(context, stage);
    }
    for (size_t k = h->offsets[first]; k < h->offsets[last + 1]; ++k) {
        const uint32_t t = h->order[k];
        seen[h->ranks[t]] |= triangle_near(h, t) == 0;
    }
    return PC_OK;
}

// Marks the components that stay, by rank: the large ones in turn, since what hides a part must
// stay itself; then the small ones at once.
static pc_status choose_parts(hiding *h, const char *stage, uint8_t *seen) {
    pc_status status = PC_OK;
    for (uint32_t i = 0; i < h->large_count && status == PC_OK; ++i) {
        seen[i] = shows_at_once(h, i);
        status = seen[i] ? PC_OK : look_closely(h, stage, i, i, seen);
        h->stays |= seen[i] ? UINT32_C(1) << i : 0;
    }
    if (status == PC_OK && h->large_count < h->count) {
        status = look_closely(h, stage, (uint32_t)h->large_count, (uint32_t)h->count - 1, seen);
    }
    return status;
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
    uint8_t *seen = PCI_SCRATCH(scratch, uint8_t, h.count);
    pc_mesh kept = {0};
    pc_status status =
        seen != NULL ? choose_parts(&h, stage, seen) : pci_fail_memory(context, stage);
    if (status == PC_OK && memchr(seen, 0, h.count) != NULL) {
        for (size_t t = 0; t < mesh->triangle_count; ++t) {
            keep[t] = seen[h.ranks[t]];
        }
        if (!pci_mesh_compact(scratch, mesh, keep, &kept, NULL)) {
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
