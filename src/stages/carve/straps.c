#include "stages/carve/straps.h"

#include "core/union_find.h"
#include "geometry/bvh.h"
#include "geometry/knn.h"
#include "geometry/topology.h"

// How far, in voxels, a strap is from what is kept, and the other side of it; how far its ends go
// on.
static const double far_away = 2.0, far_across = 1.5, end_voxels = 3.5;
// Rays start so much outside.
static const double outside = 0.1;
// So much of a piece has another left out side across: of the walls of a cavity little has.
static const double least_across = 0.75;

typedef struct straps {
    const pc_mesh *mesh;
    double cell_size;
    pci_topology topology;
    pci_knn kept; // vertices that are labelled 1
    uint8_t *far; // #V
    size_t far_count;
    uint32_t *piece; // #V, by union
} straps;

static bool index_kept(pci_scratch *scratch, const uint8_t *labels, straps *s) {
    double *points = PCI_SCRATCH(scratch, double, 3 * s->mesh->vertex_count);
    size_t count = 0;
    for (size_t v = 0; points != NULL && v < s->mesh->vertex_count; ++v) {
        if (labels[v]) {
            memcpy(&points[3 * count++], &s->mesh->positions[3 * v], 3 * sizeof(double));
        }
    }
    return points != NULL && pci_knn_build(scratch, count, points, &s->kept);
}

static bool find_far(pci_scratch *scratch, const uint8_t *labels, straps *s) {
    uint32_t hint = PC_INVALID_INDEX;
    s->far = PCI_SCRATCH(scratch, uint8_t, s->mesh->vertex_count);
    for (size_t v = 0; s->far != NULL && v < s->mesh->vertex_count; ++v) {
        s->far[v] = !labels[v] && !pci_knn_within_near(&s->kept, &s->mesh->positions[3 * v],
                                                       far_away * s->cell_size, &hint);
        s->far_count += s->far[v];
    }
    return s->far != NULL;
}

static void join_far(straps *s) {
    pci_singletons(s->piece, s->mesh->vertex_count);
    for (size_t e = 0; e < s->topology.edge_count; ++e) {
        const uint32_t *ends = &s->topology.edges[2 * e];
        if (s->far[ends[0]] && s->far[ends[1]]) {
            pci_unite(s->piece, ends[0], ends[1]);
        }
    }
}

// Whether the other side of the solid at a vertex is left out, too.
static bool is_left_out_across(const straps *s, const pci_bvh *bvh, const double point[3],
                               const double normal[3]) {
    double from[3], direction[3], met[3];
    for (size_t k = 0; k < 3; ++k) {
        direction[k] = -normal[k];
        from[k] = point[k] + outside * s->cell_size * normal[k];
    }
    const pci_hit hit =
        pci_bvh_cast(bvh, from, direction, 1.5 * outside * s->cell_size, INFINITY, NULL, NULL);
    for (size_t k = 0; k < 3; ++k) {
        met[k] = from[k] + hit.distance * direction[k];
    }
    return hit.triangle != PC_INVALID_INDEX &&
           !pci_knn_within(&s->kept, met, far_across * s->cell_size, NULL);
}

// Leaves in `far` only what belongs to straps.
static pc_status choose_straps(pci_scratch *scratch, const char *stage, straps *s, pci_bvh **tree) {
    const size_t count = s->mesh->vertex_count;
    double *normals = PCI_SCRATCH(scratch, double, 3 * count);
    size_t *sizes = PCI_SCRATCH(scratch, size_t, count),
           *across = PCI_SCRATCH(scratch, size_t, count);
    if (scratch->failed) {
        return pci_fail_memory(scratch->context, stage);
    }
    const pc_status status = pci_bvh_create(scratch->context, stage, s->mesh, tree);
    if (status != PC_OK) {
        return status;
    }
    pci_vertex_normals(s->mesh, normals);
    for (uint32_t v = 0; v < count; ++v) {
        if (s->far[v]) {
            const uint32_t root = pci_find_root(s->piece, v);
            ++sizes[root];
            across[root] += is_left_out_across(s, *tree, &s->mesh->positions[3 * (size_t)v],
                                               &normals[3 * (size_t)v]);
        }
    }
    for (uint32_t v = 0; v < count; ++v) {
        const uint32_t root = pci_find_root(s->piece, v);
        s->far[v] = s->far[v] && (double)across[root] >= least_across * (double)sizes[root];
    }
    return PC_OK;
}

// Labels the straps and the way along the surface from them to what is kept.
static bool label_straps(pci_scratch *scratch, const straps *s, uint8_t *labels) {
    const size_t count = s->mesh->vertex_count;
    double *way = PCI_SCRATCH(scratch, double, count);
    if (way == NULL) {
        return false;
    }
    for (size_t v = 0; v < count; ++v) {
        way[v] = s->far[v] ? 0.0 : HUGE_VAL;
    }
    for (bool changed = true; changed;) {
        changed = false;
        for (size_t i = 0; i < 2 * s->topology.edge_count; ++i) {
            const uint32_t from = s->topology.edges[i], to = s->topology.edges[i ^ 1];
            const double length = sqrt(pci_squared_distance(&s->mesh->positions[3 * (size_t)from],
                                                            &s->mesh->positions[3 * (size_t)to]));
            if (!labels[to] && way[from] + length < way[to] &&
                way[from] + length <= end_voxels * s->cell_size) {
                way[to] = way[from] + length;
                changed = true;
            }
        }
    }
    for (size_t v = 0; v < count; ++v) {
        labels[v] |= way[v] < HUGE_VAL;
    }
    return true;
}

pc_status pci_keep_straps(pci_scratch *scratch, const char *stage, const pc_mesh *projected,
                          double cell_size, uint8_t *labels, pci_bvh **tree) {
    straps s = {.mesh = projected, .cell_size = cell_size};
    if (!index_kept(scratch, labels, &s) || !find_far(scratch, labels, &s)) {
        return pci_fail_memory(scratch->context, stage);
    }
    if (s.far_count == 0 || s.kept.point_count == 0) {
        return PC_OK;
    }
    s.piece = PCI_SCRATCH(scratch, uint32_t, projected->vertex_count);
    if (s.piece == NULL || !pci_topology_build_edges(scratch, projected, &s.topology)) {
        return pci_fail_memory(scratch->context, stage);
    }
    join_far(&s);
    const pc_status status = choose_straps(scratch, stage, &s, tree);
    if (status != PC_OK) {
        return status;
    }
    return label_straps(scratch, &s, labels) ? PC_OK : pci_fail_memory(scratch->context, stage);
}
