#include "geometry/hems.h"

// All edges of a soup are free: then pieces are longer, as far as there are not more edges.
enum { most_pieces = 1 << 17 };

typedef struct side {
    uint32_t a, b, c; // edge a < b, opposite corner
} side;

// Whether an edge has one triangle, or copies of one.
static bool is_free(const pc_mesh *mesh, const pci_topology *topology, size_t edge, side *s) {
    const uint32_t a = topology->edges[2 * edge], b = topology->edges[2 * edge + 1];
    *s = (side){a, b, PC_INVALID_INDEX};
    for (size_t i = topology->edge_triangle_offsets[edge];
         i < topology->edge_triangle_offsets[edge + 1]; ++i) {
        const uint32_t *corner = &mesh->triangles[3 * (size_t)topology->edge_triangles[i]];
        if (corner[0] == corner[1] || corner[1] == corner[2] || corner[2] == corner[0]) {
            continue;
        }
        size_t c = 0;
        while (corner[c] == a || corner[c] == b) {
            ++c;
        }
        if (s->c != PC_INVALID_INDEX && s->c != corner[c]) {
            return false;
        }
        s->c = corner[c];
    }
    return s->c != PC_INVALID_INDEX;
}

// In the plane of the triangle, at a right angle to the edge, towards the opposite corner.
static bool inward_of(const pc_mesh *mesh, const side *s, double inward[3]) {
    double along[3];
    const double *a = &mesh->positions[3 * (size_t)s->a];
    pci_sub(&mesh->positions[3 * (size_t)s->b], a, along);
    pci_sub(&mesh->positions[3 * (size_t)s->c], a, inward);
    if (!pci_normalize(along)) {
        return false;
    }
    const double share = pci_dot(inward, along);
    for (size_t k = 0; k < 3; ++k) {
        inward[k] -= share * along[k];
    }
    return pci_normalize(inward);
}

// The pieces of a side are about as long as `piece`.
static size_t piece_count(const pc_mesh *mesh, const side *s, double piece) {
    const double length = sqrt(pci_squared_distance(&mesh->positions[3 * (size_t)s->a],
                                                    &mesh->positions[3 * (size_t)s->b]));
    return length > piece ? (size_t)fmin(ceil(length / piece), 1e4) : 1;
}

static size_t count_pieces(const pc_mesh *mesh, const side *sides, size_t count, double piece,
                           size_t *offsets) {
    for (size_t i = 0; i < count; ++i) {
        offsets[i + 1] = offsets[i] + piece_count(mesh, &sides[i], piece);
    }
    return offsets[count];
}

typedef struct probing {
    const pc_mesh *mesh;
    const pci_bvh *bvh;
    double reach;
    const side *sides;
    const size_t *offsets; // of the pieces of each side
    pci_hems *all;
    uint8_t *open;
} probing;

static void probe_sides(void *user, size_t begin, size_t end, uint32_t worker) {
    probing *p = user;
    uint32_t last = PC_INVALID_INDEX;
    (void)worker;
    for (size_t i = begin; i < end; ++i) {
        const size_t first = p->offsets[i], count = p->offsets[i + 1] - first;
        const double *a = &p->mesh->positions[3 * (size_t)p->sides[i].a];
        const double *b = &p->mesh->positions[3 * (size_t)p->sides[i].b];
        double inward[3];
        if (!inward_of(p->mesh, &p->sides[i], inward)) {
            continue;
        }
        for (size_t j = 0; j < count; ++j) {
            double *ends = &p->all->points[6 * (first + j)], probe[3];
            for (size_t k = 0; k < 3; ++k) {
                ends[k] = a[k] + (b[k] - a[k]) * ((double)j / (double)count);
                ends[3 + k] = a[k] + (b[k] - a[k]) * ((double)(j + 1) / (double)count);
                probe[k] = 0.5 * (ends[k] + ends[3 + k]) - p->reach * inward[k];
            }
            memcpy(&p->all->inwards[3 * (first + j)], inward, sizeof(inward));
            p->open[first + j] = !pci_bvh_within_near(p->bvh, probe, 0.5 * p->reach, &last);
        }
    }
}

bool pci_find_hems(pci_scratch *scratch, const pc_mesh *mesh, const pci_topology *topology,
                   const pci_bvh *bvh, double reach, pci_hems *hems) {
    memset(hems, 0, sizeof(*hems));
    side any;
    size_t free_count = 0;
    for (size_t e = 0; e < topology->edge_count; ++e) {
        free_count += is_free(mesh, topology, e, &any);
    }
    side *sides = PCI_SCRATCH(scratch, side, free_count);
    for (size_t e = 0, i = 0; sides != NULL && i < free_count; ++e) {
        i += is_free(mesh, topology, e, &sides[i]);
    }
    size_t *offsets = PCI_SCRATCH(scratch, size_t, free_count + 1);
    if (scratch->failed) {
        return false;
    }
    size_t pieces = count_pieces(mesh, sides, free_count, 0.5 * reach, offsets);
    if (pieces > most_pieces) {
        const double longer = (double)pieces / most_pieces;
        pieces = count_pieces(mesh, sides, free_count, 0.5 * reach * longer, offsets);
    }
    uint8_t *open = PCI_SCRATCH(scratch, uint8_t, pieces);
    hems->points = PCI_SCRATCH(scratch, double, 6 * pieces);
    hems->inwards = PCI_SCRATCH(scratch, double, 3 * pieces);
    if (scratch->failed) {
        return false;
    }
    probing p = {mesh, bvh, reach, sides, offsets, hems, open};
    if (!pci_parallel_while_wanted(scratch->context, free_count, 64, probe_sides, &p)) {
        return false;
    }
    for (size_t i = 0; i < pieces; ++i) {
        if (open[i]) {
            memmove(&hems->points[6 * hems->count], &hems->points[6 * i], 6 * sizeof(double));
            memmove(&hems->inwards[3 * hems->count++], &hems->inwards[3 * i], 3 * sizeof(double));
        }
    }
    return true;
}
