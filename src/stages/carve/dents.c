#include "stages/carve/dents.h"

#include "core/union_find.h"
#include "geometry/topology.h"

// No point of a dent is farther than so many voxels from its border, so much of the border at most
// is within so many voxels of a rim, as all of it is around an opening, and a dent has at most so
// much of the area of what is kept.
static const double half_width = 3.0, most_rim = 0.9, rim_voxels = 1.5, most_share = 0.1;

// A connected piece of what the labels leave out.
typedef struct piece {
    double area, border, rim; // rim: length of the border near a rim
    bool wide;
} piece;

// Measures the borders; `points` (room for #edges by 3) receives their middles.
static size_t measure_borders(const pc_mesh *mesh, const pci_topology *topology,
                              const pci_knn *rims, double reach, const uint8_t *keep, uint32_t *of,
                              piece *pieces, double *points) {
    size_t count = 0;
    for (size_t e = 0; e < topology->edge_count; ++e) {
        const uint32_t *sides = pci_sides(topology, e);
        if (pci_side_count(topology, e) != 2 || keep[sides[0]] == keep[sides[1]]) {
            continue;
        }
        const double *from = &mesh->positions[3 * (size_t)topology->edges[2 * e]];
        const double *to = &mesh->positions[3 * (size_t)topology->edges[2 * e + 1]];
        const double length = sqrt(pci_squared_distance(from, to));
        double *middle = &points[3 * count++];
        for (size_t k = 0; k < 3; ++k) {
            middle[k] = 0.5 * (from[k] + to[k]);
        }
        piece *p = &pieces[pci_find_root(of, sides[keep[sides[0]] ? 1 : 0])];
        p->border += length;
        p->rim += pci_knn_within(rims, middle, reach, NULL) ? length : 0.0;
    }
    return count;
}

static bool may_be_dent(const piece *p, double kept) {
    return p->rim < most_rim * p->border && p->area < most_share * kept && !p->wide;
}

bool pci_keep_dents(pci_scratch *scratch, const pc_mesh *projected, const pci_knn *rims,
                    double cell_size, uint8_t *keep) {
    const size_t triangles = projected->triangle_count;
    pci_topology topology;
    pci_knn borders;
    uint32_t *of = PCI_SCRATCH(scratch, uint32_t, triangles);
    piece *pieces = PCI_SCRATCH(scratch, piece, triangles);
    if (scratch->failed || !pci_topology_build_edges(scratch, projected, &topology)) {
        return false;
    }
    double *points = PCI_SCRATCH(scratch, double, 3 * topology.edge_count);
    if (points == NULL) {
        return false;
    }
    pci_join_alike(&topology, triangles, keep, of);
    const size_t count = measure_borders(projected, &topology, rims, rim_voxels * cell_size, keep,
                                         of, pieces, points);
    if (!pci_knn_build(scratch, count, points, &borders)) {
        return false;
    }
    double kept = 0.0;
    for (uint32_t t = 0; t < triangles; ++t) {
        double *area = keep[t] ? &kept : &pieces[pci_find_root(of, t)].area;
        *area += pci_triangle_area(projected, t);
    }
    for (uint32_t t = 0; t < triangles; ++t) {
        piece *p = &pieces[pci_find_root(of, t)];
        double middle[3];
        if (!keep[t] && may_be_dent(p, kept)) {
            pci_triangle_middle(projected, t, middle);
            p->wide = !pci_knn_within(&borders, middle, half_width * cell_size, NULL);
        }
    }
    for (uint32_t t = 0; t < triangles; ++t) {
        keep[t] = keep[t] || may_be_dent(&pieces[pci_find_root(of, t)], kept);
    }
    return true;
}
