#include "stages/carve/crumbs.h"

#include "geometry/topology.h"

enum { grain = 256 };

// Covering less of a component of the visual mesh is touching it by accident. Where all small parts
// together cover less of it than this, they are what the labels left of a layer, and no loose
// parts.
static const double covered_share = 0.05, least_share = 0.25;

typedef struct sorting {
    pci_scratch *scratch;
    const char *stage;
    const pc_mesh *layer;
    uint32_t *part; // #F of the layer
    size_t part_count;
    double *areas;  // per part
    uint8_t *small; // per part
    uint32_t *home; // #F of the layer, component of the visual mesh
    uint32_t *visual_component;
    double *visual_areas; // per component
    const pci_bvh *visual;
} sorting;

static bool find_components(pci_scratch *scratch, const pc_mesh *mesh, uint32_t **component,
                            double **areas, size_t *count) {
    *component = PCI_SCRATCH(scratch, uint32_t, mesh->triangle_count);
    if (scratch->failed) {
        return false;
    }
    *count = pci_manifold_components(scratch, mesh, *component);
    *areas = PCI_SCRATCH(scratch, double, *count);
    for (size_t t = 0; !scratch->failed && t < mesh->triangle_count; ++t) {
        (*areas)[(*component)[t]] += pci_triangle_area(mesh, t);
    }
    return !scratch->failed;
}

typedef struct home_job {
    const sorting *s;
    bool small; // which triangles
} home_job;

static void find_homes(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const home_job *job = user;
    const sorting *s = job->s;
    uint32_t last = PC_INVALID_INDEX;
    for (size_t t = begin; t < end; ++t) {
        if ((s->small[s->part[t]] != 0) == job->small) {
            double middle[3];
            pci_triangle_middle(s->layer, t, middle);
            last = pci_bvh_closest_near(s->visual, middle, last).triangle;
            s->home[t] = s->visual_component[last];
        }
    }
}

// Adds up the areas of the triangles of small parts, or of the others, by their homes. Where there
// is one component only all are at home in it.
static void cover(const sorting *s, size_t visual_count, bool small, double *covered) {
    home_job job = {s, small};
    if (visual_count > 1) {
        pci_parallel_for(s->scratch->context, s->layer->triangle_count, grain, find_homes, &job);
    }
    for (size_t t = 0; t < s->layer->triangle_count; ++t) {
        if ((s->small[s->part[t]] != 0) == small) {
            covered[s->home[t]] += pci_triangle_area(s->layer, t);
        }
    }
}

// Marks the small parts that are mostly on components of the visual mesh which no large part
// covers, but small parts do.
static bool find_strangers(const sorting *s, size_t visual_count, uint8_t *stranger) {
    double *by_small = PCI_SCRATCH(s->scratch, double, visual_count);
    double *by_large = PCI_SCRATCH(s->scratch, double, visual_count);
    double *strange = PCI_SCRATCH(s->scratch, double, s->part_count);
    bool some = false;
    if (s->scratch->failed) {
        return false;
    }
    cover(s, visual_count, true, by_small);
    for (size_t i = 0; i < visual_count; ++i) {
        some = some || by_small[i] >= (least_share - covered_share) * s->visual_areas[i];
    }
    if (!some) { // whatever the large parts cover
        return true;
    }
    cover(s, visual_count, false, by_large);
    for (size_t t = 0; t < s->layer->triangle_count; ++t) {
        const uint32_t home = s->home[t];
        const double whole = s->visual_areas[home];
        if (by_large[home] < covered_share * whole &&
            by_small[home] + by_large[home] >= least_share * whole) {
            strange[s->part[t]] += pci_triangle_area(s->layer, t);
        }
    }
    for (size_t i = 0; i < s->part_count; ++i) {
        stranger[i] = s->small[i] && strange[i] > 0.5 * s->areas[i];
    }
    return true;
}

// Whether a point is farther than `reach` from the large parts.
static bool is_distant(const sorting *s, const double point[3], double reach) {
    for (size_t t = 0; t < s->layer->triangle_count; ++t) {
        if (!s->small[s->part[t]] && pci_triangle_within(s->layer, t, point, reach)) {
            return false;
        }
    }
    return true;
}

// Marks strangers by the first vertex of each, for a few of them. Returns whether others are left.
static bool leaves_strangers(const sorting *s, double reach, const uint8_t *stranger,
                             uint8_t *distant) {
    enum { few = 32 };
    size_t asked = 0, left = 0, part = 0; // parts are numbered by their first triangles
    for (size_t t = 0; t < s->layer->triangle_count && part < s->part_count; ++t) {
        if (s->part[t] != part) {
            continue;
        }
        if (stranger[part]) {
            const uint32_t first = s->layer->triangles[3 * t];
            distant[part] =
                asked++ < few && is_distant(s, &s->layer->positions[3 * (size_t)first], reach);
            left += !distant[part];
        }
        ++part;
    }
    return left > 0;
}

// Marks the strangers with a vertex farther than `reach` from the large parts.
static pc_status find_distant(const sorting *s, double reach, const uint8_t *stranger,
                              uint8_t *distant) {
    pci_scratch *scratch = s->scratch;
    uint8_t *keep = PCI_SCRATCH(scratch, uint8_t, s->layer->triangle_count);
    pc_mesh large = {0};
    pci_bvh *bvh = NULL;
    if (keep == NULL) {
        return pci_fail_memory(scratch->context, s->stage);
    }
    for (size_t t = 0; t < s->layer->triangle_count; ++t) {
        keep[t] = !s->small[s->part[t]];
    }
    if (!pci_mesh_compact(scratch, s->layer, keep, &large, NULL)) {
        return pci_fail_memory(scratch->context, s->stage);
    }
    const pc_status status = pci_bvh_create(scratch->context, s->stage, &large, &bvh);
    for (size_t i = 0; status == PC_OK && i < 3 * s->layer->triangle_count; ++i) {
        const uint32_t part = s->part[i / 3];
        if (stranger[part] && !distant[part]) {
            const double *point = &s->layer->positions[3 * (size_t)s->layer->triangles[i]];
            distant[part] = !pci_bvh_within(bvh, point, reach);
        }
    }
    pci_bvh_destroy(scratch->context, bvh);
    pc_mesh_free(scratch->context, &large);
    return status;
}

static pc_status drop(const sorting *s, const uint8_t *stays, pc_mesh *layer, uint64_t *dropped) {
    pci_scratch *scratch = s->scratch;
    uint8_t *keep = PCI_SCRATCH(scratch, uint8_t, layer->triangle_count);
    pc_mesh kept = {0};
    if (keep == NULL) {
        return pci_fail_memory(scratch->context, s->stage);
    }
    for (size_t t = 0; t < layer->triangle_count; ++t) {
        keep[t] = stays[s->part[t]];
    }
    if (!pci_mesh_compact(scratch, layer, keep, &kept, NULL)) {
        return pci_fail_memory(scratch->context, s->stage);
    }
    for (size_t i = 0; i < s->part_count; ++i) {
        *dropped += !stays[i];
    }
    pc_mesh_free(scratch->context, layer);
    *layer = kept;
    return PC_OK;
}

pc_status pci_drop_crumbs(pci_scratch *scratch, const char *stage, const pc_mesh *surface,
                          const pci_bvh *visual, double fraction, double reach, pc_mesh *layer,
                          uint64_t *dropped) {
    pc_context *context = scratch->context;
    sorting s = {.scratch = scratch, .stage = stage, .layer = layer, .visual = visual};
    size_t visual_count = 0, smalls = 0;
    if (!find_components(scratch, layer, &s.part, &s.areas, &s.part_count)) {
        return pci_fail_memory(context, stage);
    }
    s.small = PCI_SCRATCH(scratch, uint8_t, s.part_count);
    uint8_t *stranger = PCI_SCRATCH(scratch, uint8_t, s.part_count);
    uint8_t *distant = PCI_SCRATCH(scratch, uint8_t, s.part_count);
    s.home = PCI_SCRATCH(scratch, uint32_t, layer->triangle_count);
    if (scratch->failed) {
        return pci_fail_memory(context, stage);
    }
    double largest = 0.0;
    for (size_t i = 0; i < s.part_count; ++i) {
        largest = fmax(largest, s.areas[i]);
    }
    for (size_t i = 0; i < s.part_count; ++i) {
        s.small[i] = s.areas[i] < fraction * largest;
        smalls += s.small[i];
    }
    if (smalls == 0) {
        return PC_OK;
    }
    if (!find_components(scratch, surface, &s.visual_component, &s.visual_areas, &visual_count)) {
        return pci_fail_memory(context, stage);
    }
    if (!find_strangers(&s, visual_count, stranger)) {
        return pci_fail_memory(context, stage);
    }
    if (leaves_strangers(&s, reach, stranger, distant)) {
        const pc_status status = find_distant(&s, reach, stranger, distant);
        if (status != PC_OK) {
            return status;
        }
    }
    for (size_t i = 0; i < s.part_count; ++i) {
        stranger[i] = !s.small[i] || (stranger[i] && distant[i]);
    }
    return drop(&s, stranger, layer, dropped);
}
