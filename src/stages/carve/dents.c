#include "stages/carve/dents.h"

#include "core/union_find.h"
#include "geometry/bvh.h"
#include "geometry/knn.h"
#include "geometry/topology.h"

// No point of a dent is farther than so many voxels from its border, so much of the border at most
// is within so many voxels of a rim, as all of it is around an opening, and a dent has at most so
// much of the area of what is kept.
static const double half_width = 3.0, most_rim = 0.9, rim_voxels = 1.5, most_share = 0.1;
// The other side of a strap is no dent: the border is longer than so many voxels, so much of it has
// what is kept across the solid, no more than so many voxels away, and what is kept along the
// border is a narrow strip, too. Rays start so much outside.
static const double least_border = 12.0, least_across = 0.8, thickest = 2.5, outside = 0.25;

// A connected piece of what the labels leave out.
typedef struct piece {
    double area, border, rim; // rim: length of the border near a rim
    double across;            // area with what is kept on the other side of the solid
    double around;            // area of what is kept along the border
    bool wide;
} piece;

typedef struct pieces {
    const pc_mesh *mesh;
    double cell_size;
    const uint8_t *keep; // #F
    uint32_t *of;        // #F, by union
    piece *list;         // at the roots
    double kept;         // area
    double *points;      // on the borders
    uint32_t *whose;     // per point, a triangle of the piece
    size_t count;
    pci_knn borders; // of the points
} pieces;

static piece *piece_of(const pieces *p, uint32_t t) { return &p->list[pci_find_root(p->of, t)]; }

static void measure_borders(const pci_topology *topology, const pci_knn *rims, pieces *all) {
    for (size_t e = 0; e < topology->edge_count; ++e) {
        const uint32_t *sides = pci_sides(topology, e);
        if (pci_side_count(topology, e) != 2 || all->keep[sides[0]] == all->keep[sides[1]]) {
            continue;
        }
        const double *from = &all->mesh->positions[3 * (size_t)topology->edges[2 * e]];
        const double *to = &all->mesh->positions[3 * (size_t)topology->edges[2 * e + 1]];
        const double length = sqrt(pci_squared_distance(from, to));
        double *middle = &all->points[3 * all->count];
        for (size_t k = 0; k < 3; ++k) {
            middle[k] = 0.5 * (from[k] + to[k]);
        }
        all->whose[all->count] = sides[all->keep[sides[0]] ? 1 : 0];
        piece *p = piece_of(all, all->whose[all->count++]);
        p->border += length;
        p->rim += pci_knn_within(rims, middle, rim_voxels * all->cell_size, NULL) ? length : 0.0;
    }
}

static bool may_be_dent(const pieces *all, const piece *p) {
    return p->rim < most_rim * p->border && p->area < most_share * all->kept && !p->wide;
}

static bool may_be_strap(const pieces *all, const piece *p) {
    return may_be_dent(all, p) && p->border > least_border * all->cell_size;
}

static bool is_strap(const pieces *all, const piece *p) {
    return may_be_strap(all, p) && p->across > least_across * p->area &&
           p->around < half_width * all->cell_size * p->border;
}

// Whether what is kept lies on the other side of the solid.
static bool is_kept_across(const pieces *all, const pci_bvh *bvh, uint32_t t) {
    double from[3], inwards[3];
    pci_triangle_middle(all->mesh, t, from);
    pci_triangle_vector(all->mesh, t, inwards);
    if (!pci_normalize(inwards)) {
        return false;
    }
    for (size_t k = 0; k < 3; ++k) {
        from[k] += outside * all->cell_size * inwards[k];
        inwards[k] = -inwards[k];
    }
    const pci_hit hit = pci_bvh_cast(bvh, from, inwards, 1.1 * outside * all->cell_size,
                                     thickest * all->cell_size, NULL, NULL);
    return hit.triangle != PC_INVALID_INDEX && hit.back_face && all->keep[hit.triangle];
}

static void measure_around(const pieces *all) {
    const double reach = half_width * all->cell_size;
    for (uint32_t t = 0; t < all->mesh->triangle_count; ++t) {
        double middle[3], squared = 0.0;
        uint32_t near = 0;
        pci_triangle_middle(all->mesh, t, middle);
        if (all->keep[t] &&
            pci_knn_query(&all->borders, middle, 1, PC_INVALID_INDEX, &near, &squared) == 1 &&
            squared < reach * reach) {
            piece_of(all, all->whose[near])->around += pci_triangle_area(all->mesh, t);
        }
    }
}

// @param tree  of the mesh, built here if it is needed and was not before
static pc_status measure_straps(pci_scratch *scratch, const char *stage, const pieces *all,
                                pci_bvh **tree) {
    bool some = false;
    for (uint32_t t = 0; t < all->mesh->triangle_count; ++t) {
        if (all->keep[t] || !may_be_strap(all, piece_of(all, t))) {
            continue;
        }
        if (*tree == NULL) {
            const pc_status status = pci_bvh_create(scratch->context, stage, all->mesh, tree);
            if (status != PC_OK) {
                return status;
            }
        }
        some = true;
        if (is_kept_across(all, *tree, t)) {
            piece_of(all, t)->across += pci_triangle_area(all->mesh, t);
        }
    }
    if (some) {
        measure_around(all);
    }
    return PC_OK;
}

pc_status pci_keep_dents(pci_scratch *scratch, const char *stage, const pc_mesh *projected,
                         const pci_knn *rims, double cell_size, pci_bvh **tree, uint8_t *keep) {
    const size_t triangles = projected->triangle_count;
    pci_topology topology;
    pieces all = {.mesh = projected,
                  .cell_size = cell_size,
                  .keep = keep,
                  .of = PCI_SCRATCH(scratch, uint32_t, triangles),
                  .list = PCI_SCRATCH(scratch, piece, triangles)};
    if (scratch->failed || !pci_topology_build_edges(scratch, projected, &topology)) {
        return pci_fail_memory(scratch->context, stage);
    }
    all.points = PCI_SCRATCH(scratch, double, 3 * topology.edge_count);
    all.whose = PCI_SCRATCH(scratch, uint32_t, topology.edge_count);
    if (scratch->failed) {
        return pci_fail_memory(scratch->context, stage);
    }
    pci_join_alike(&topology, triangles, keep, all.of);
    measure_borders(&topology, rims, &all);
    if (!pci_knn_build(scratch, all.count, all.points, &all.borders)) {
        return pci_fail_memory(scratch->context, stage);
    }
    for (uint32_t t = 0; t < triangles; ++t) {
        double *area = keep[t] ? &all.kept : &piece_of(&all, t)->area;
        *area += pci_triangle_area(projected, t);
    }
    for (uint32_t t = 0; t < triangles; ++t) {
        piece *p = piece_of(&all, t);
        double middle[3];
        if (!keep[t] && may_be_dent(&all, p)) {
            pci_triangle_middle(projected, t, middle);
            p->wide = !pci_knn_within(&all.borders, middle, half_width * cell_size, NULL);
        }
    }
    const pc_status status = measure_straps(scratch, stage, &all, tree);
    for (uint32_t t = 0; t < triangles && status == PC_OK; ++t) {
        const piece *p = piece_of(&all, t);
        keep[t] = keep[t] || (may_be_dent(&all, p) && !is_strap(&all, p));
    }
    return status;
}
