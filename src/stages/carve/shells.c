#include "stages/carve/shells.h"

#include <stdlib.h>

#include "core/union_find.h"
#include "geometry/bvh.h"
#include "geometry/manifold.h"
#include "geometry/topology.h"

enum { grain = 256 };

// A skin has the other one behind it: cosine between their normals at most, and the distance over
// the usual one of the shell.
static const double most_facing = -0.8, most_uneven = 1.75;
// The two skins make up so much of a shell; the rest is its rim.
static const double least_skin_share = 0.6;
// What faces one skin is mostly the other.
static const double least_facing_share = 0.75;

typedef struct peeling {
    pci_scratch *scratch;
    const pc_mesh *mesh;
    const pci_topology *topology;
    const pci_bvh *bvh;
    double thickest;
    size_t component_count;
    uint32_t *component;  // #F
    uint8_t *open;        // per component
    const double *volume; // per component, signed
    double *thickness;    // #F, to the triangle behind; HUGE_VAL: none
    uint32_t *behind;     // #F, the triangle behind
    uint32_t *skin;       // #F, first triangle of the skin, or of the part of the rim
} peeling;

// ---- what lies behind each triangle -------------------------------------------------------------

typedef struct behind_filter {
    const peeling *p;
    size_t triangle;
} behind_filter;

static bool same_shell(void *user, const pci_hit *hit) {
    const behind_filter *f = user;
    return hit->triangle != f->triangle &&
           f->p->component[hit->triangle] == f->p->component[f->triangle];
}

static void look_behind(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    peeling *p = user;
    for (size_t t = begin; t < end; ++t) {
        double middle[3], normal[3], other[3], direction[3];
        p->thickness[t] = HUGE_VAL;
        pci_triangle_vector(p->mesh, t, normal);
        if (p->open[p->component[t]] || !pci_normalize(normal)) {
            continue;
        }
        pci_triangle_middle(p->mesh, t, middle);
        for (size_t k = 0; k < 3; ++k) {
            direction[k] = p->volume[p->component[t]] > 0.0 ? -normal[k] : normal[k];
        }
        behind_filter filter = {p, t};
        const pci_hit hit = pci_bvh_cast(p->bvh, middle, direction, 1e-6 * p->thickest,
                                         most_uneven * p->thickest, same_shell, &filter);
        if (hit.triangle != PC_INVALID_INDEX) {
            pci_triangle_vector(p->mesh, hit.triangle, other);
            if (pci_normalize(other) && pci_dot(normal, other) < most_facing) {
                p->thickness[t] = hit.distance;
                p->behind[t] = hit.triangle;
            }
        }
    }
}

static bool measure_components(peeling *p) {
    const pc_mesh *mesh = p->mesh;
    p->component = PCI_SCRATCH(p->scratch, uint32_t, mesh->triangle_count);
    if (p->component == NULL) {
        return false;
    }
    p->component_count = pci_triangle_components(p->scratch, mesh, p->topology, p->component);
    p->open = PCI_SCRATCH(p->scratch, uint8_t, p->component_count);
    p->volume = pci_component_volumes(p->scratch, p->mesh, p->component, p->component_count);
    p->thickness = PCI_SCRATCH(p->scratch, double, mesh->triangle_count);
    p->behind = PCI_SCRATCH(p->scratch, uint32_t, mesh->triangle_count);
    p->skin = PCI_SCRATCH(p->scratch, uint32_t, mesh->triangle_count);
    if (p->scratch->failed) {
        return false;
    }
    pci_mark_open(p->topology, p->component, p->open);
    return true;
}

// ---- skins --------------------------------------------------------------------------------------

typedef struct measured {
    uint32_t component;
    double thickness, area;
} measured;

static int compare_measured(const void *left, const void *right) {
    const measured *a = left, *b = right;
    if (a->component != b->component) {
        return a->component < b->component ? -1 : 1;
    }
    if (a->thickness != b->thickness) {
        return a->thickness < b->thickness ? -1 : 1;
    }
    return (a->area > b->area) - (a->area < b->area);
}

// The usual thickness of a component, by area; HUGE_VAL where it is no shell. The list rises.
static double usual_thickness(const peeling *p, const measured *list, size_t count) {
    double area = 0.0, skin = 0.0, below = 0.0;
    for (size_t i = 0; i < count; ++i) {
        area += list[i].area;
        skin += list[i].thickness < HUGE_VAL ? list[i].area : 0.0;
    }
    if (!(skin > least_skin_share * area)) {
        return HUGE_VAL;
    }
    size_t middle = 0;
    while ((below += list[middle].area) < 0.5 * skin) {
        ++middle;
    }
    return list[middle].thickness <= p->thickest ? list[middle].thickness : HUGE_VAL;
}

// Likewise of all components.
static bool find_usual(const peeling *p, double *usual) {
    const size_t count = p->mesh->triangle_count;
    measured *list = PCI_SCRATCH(p->scratch, measured, count);
    if (list == NULL) {
        return false;
    }
    for (size_t t = 0; t < count; ++t) {
        list[t] = (measured){p->component[t], p->thickness[t], pci_triangle_area(p->mesh, t)};
    }
    qsort(list, count, sizeof(*list), compare_measured);
    for (size_t first = 0, next; first < count; first = next) {
        const uint32_t component = list[first].component;
        for (next = first + 1; next < count && list[next].component == component; ++next) {
        }
        usual[component] = usual_thickness(p, &list[first], next - first);
    }
    return true;
}

// Joins neighbours that both belong to a skin, or both to the rim. `in_skin` is #F.
static void join_skins(peeling *p, const uint8_t *in_skin) {
    pci_join_alike(p->topology, p->mesh->triangle_count, in_skin, p->skin);
    for (uint32_t t = 0; t < p->mesh->triangle_count; ++t) {
        p->skin[t] = pci_find_root(p->skin, t);
    }
}

// The two largest skins of each component, larger first; PC_INVALID_INDEX: it has not two that face
// each other. `areas` is #F, by skin.
static void pair_skins(const peeling *p, const uint8_t *in_skin, const double *areas,
                       uint32_t *pairs, double *facing) {
    for (size_t i = 0; i < 2 * p->component_count; ++i) {
        pairs[i] = PC_INVALID_INDEX;
    }
    for (uint32_t t = 0; t < p->mesh->triangle_count; ++t) {
        uint32_t *pair = &pairs[2 * (size_t)p->component[t]];
        if (!in_skin[t] || p->skin[t] != t) {
            continue;
        }
        if (pair[0] == PC_INVALID_INDEX || areas[t] > areas[pair[0]]) {
            pair[1] = pair[0];
            pair[0] = t;
        } else if (pair[1] == PC_INVALID_INDEX || areas[t] > areas[pair[1]]) {
            pair[1] = t;
        }
    }
    for (uint32_t t = 0; t < p->mesh->triangle_count; ++t) {
        const uint32_t *pair = &pairs[2 * (size_t)p->component[t]];
        const uint32_t other = p->skin[t] == pair[0] ? pair[1] : pair[0];
        if ((p->skin[t] == pair[0] || p->skin[t] == pair[1]) && p->skin[p->behind[t]] == other) {
            facing[p->skin[t]] += pci_triangle_area(p->mesh, t);
        }
    }
    for (size_t i = 0; i < p->component_count; ++i) {
        uint32_t *pair = &pairs[2 * i];
        if (pair[1] == PC_INVALID_INDEX || facing[pair[0]] < least_facing_share * areas[pair[0]] ||
            facing[pair[1]] < least_facing_share * areas[pair[1]]) {
            pair[0] = pair[1] = PC_INVALID_INDEX;
        }
    }
}

// Spreads the two skins of each shell over the parts beside them that touch only one of the two:
// dents and creases. What touches both is the rim. `side` is #F, by skin: bit 0, the larger.
static void find_sides(const peeling *p, const uint32_t *pairs, uint8_t *side) {
    for (size_t i = 0; i < 2 * p->component_count; ++i) {
        if (pairs[i] != PC_INVALID_INDEX) {
            side[pairs[i]] = (uint8_t)(1 << i % 2);
        }
    }
    for (bool changed = true; changed;) {
        changed = false;
        for (size_t e = 0; e < p->topology->edge_count; ++e) {
            const uint32_t *sides = pci_sides(p->topology, e);
            for (size_t k = 0; k < 2 && pci_side_count(p->topology, e) == 2; ++k) {
                const uint32_t a = p->skin[sides[k]];
                const uint32_t b = p->skin[sides[1 - k]];
                const uint32_t *pair = &pairs[2 * (size_t)p->component[a]];
                if (b != pair[0] && b != pair[1] && (side[a] & ~side[b]) != 0) {
                    side[b] |= side[a];
                    changed = true;
                }
            }
        }
    }
}

// Marks the triangles that stay.
static bool choose_triangles(peeling *p, uint8_t *keep, double *thickness) {
    const size_t triangles = p->mesh->triangle_count;
    uint8_t *in_skin = PCI_SCRATCH(p->scratch, uint8_t, triangles);
    uint8_t *side = PCI_SCRATCH(p->scratch, uint8_t, triangles);
    double *areas = PCI_SCRATCH(p->scratch, double, triangles);
    double *facing = PCI_SCRATCH(p->scratch, double, triangles);
    double *usual = PCI_SCRATCH(p->scratch, double, p->component_count);
    uint32_t *pairs = PCI_SCRATCH(p->scratch, uint32_t, 2 * p->component_count);
    if (p->scratch->failed || !find_usual(p, usual)) {
        return false;
    }
    for (size_t t = 0; t < triangles; ++t) {
        const double u = usual[p->component[t]];
        in_skin[t] = isfinite(u) && p->thickness[t] <= most_uneven * u;
    }
    join_skins(p, in_skin);
    for (size_t t = 0; t < triangles; ++t) {
        areas[p->skin[t]] += pci_triangle_area(p->mesh, t);
    }
    pair_skins(p, in_skin, areas, pairs, facing);
    find_sides(p, pairs, side);
    for (size_t t = 0; t < triangles; ++t) {
        const uint32_t component = p->component[t];
        const bool peeled = pairs[2 * (size_t)component] != PC_INVALID_INDEX;
        keep[t] = !peeled || side[p->skin[t]] == 1;
        *thickness = peeled ? fmax(*thickness, most_uneven * usual[component]) : *thickness;
    }
    return true;
}

pc_status pci_peel_shells(pci_scratch *scratch, const char *stage, double thickest,
                          const pci_topology *topology, pc_mesh *mesh, double *thickness) {
    peeling p = {.scratch = scratch, .mesh = mesh, .topology = topology, .thickest = thickest};
    *thickness = 0.0;
    if (!measure_components(&p)) {
        return pci_fail_memory(scratch->context, stage);
    }
    if (memchr(p.open, 0, p.component_count) == NULL) {
        return PC_OK;
    }
    pci_bvh *bvh = NULL;
    const pc_status status = pci_bvh_create(scratch->context, stage, mesh, &bvh);
    if (status != PC_OK) {
        return status;
    }
    p.bvh = bvh;
    const bool done =
        pci_parallel_while_wanted(scratch->context, mesh->triangle_count, grain, look_behind, &p);
    pci_bvh_destroy(scratch->context, bvh);
    uint8_t *keep = PCI_SCRATCH(scratch, uint8_t, mesh->triangle_count);
    pci_repair_counts counts;
    pc_mesh kept = {0};
    if (!done || keep == NULL || !choose_triangles(&p, keep, thickness) ||
        (*thickness > 0.0 && !pci_mesh_repair(scratch, mesh, keep, &kept, &counts))) {
        return pci_fail_memory(scratch->context, stage);
    }
    if (*thickness > 0.0) {
        pc_mesh_free(scratch->context, mesh);
        *mesh = kept;
    }
    return PC_OK;
}
