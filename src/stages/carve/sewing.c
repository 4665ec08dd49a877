#include "stages/carve/sewing.h"

#include "core/union_find.h"
#include "geometry/bvh.h"
#include "geometry/manifold.h"
#include "geometry/topology.h"
#include "stages/carve/seams.h"

enum { grain = 256 };

// Smaller pieces of a component than this share of it change sides.
static const double small_share = 0.05;

typedef struct covering {
    const pc_mesh *mesh;
    const pci_bvh *bvh;
    const uint32_t *component; // #F
    double reach;
    uint8_t *covered; // #F
} covering;

typedef struct cover_filter {
    const covering *c;
    size_t triangle;
} cover_filter;

static bool is_other_part(void *user, const pci_hit *hit) {
    const cover_filter *f = user;
    return f->c->component[hit->triangle] != f->c->component[f->triangle];
}

static void find_covered(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    covering *c = user;
    for (size_t t = begin; t < end; ++t) {
        double normal[3], middle[3];
        pci_triangle_vector(c->mesh, t, normal);
        if (!pci_normalize(normal)) {
            continue;
        }
        pci_triangle_middle(c->mesh, t, middle);
        cover_filter filter = {c, t};
        const pci_hit hit =
            pci_bvh_cast(c->bvh, middle, normal, 1e-4 * c->reach, c->reach, is_other_part, &filter);
        c->covered[t] = hit.triangle != PC_INVALID_INDEX && hit.back_face;
    }
}

// Turns connected pieces over that are `covered` as asked and small in their component.
static bool turn_small_pieces(pci_scratch *scratch, const covering *c, const pci_topology *topology,
                              const double *areas, bool covered) {
    const size_t triangles = c->mesh->triangle_count;
    uint32_t *piece = PCI_SCRATCH(scratch, uint32_t, triangles);
    double *sums = PCI_SCRATCH(scratch, double, triangles);
    if (scratch->failed) {
        return false;
    }
    pci_join_alike(topology, triangles, c->covered, piece);
    for (uint32_t t = 0; t < triangles; ++t) {
        sums[pci_find_root(piece, t)] += pci_triangle_area(c->mesh, t);
    }
    for (uint32_t t = 0; t < triangles; ++t) {
        if (c->covered[t] == covered &&
            sums[pci_find_root(piece, t)] < small_share * areas[c->component[t]]) {
            c->covered[t] = !covered;
        }
    }
    return true;
}

// Marks what no other part covers. False: out of memory.
static bool mark_uncovered(pci_scratch *scratch, const covering *c, const pci_topology *topology,
                           size_t component_count, uint8_t *keep) {
    const size_t triangles = c->mesh->triangle_count;
    double *areas = PCI_SCRATCH(scratch, double, component_count);
    for (size_t t = 0; t < triangles && areas != NULL; ++t) {
        areas[c->component[t]] += pci_triangle_area(c->mesh, t);
    }
    if (areas == NULL || !turn_small_pieces(scratch, c, topology, areas, true) ||
        !turn_small_pieces(scratch, c, topology, areas, false)) {
        return false;
    }
    for (size_t t = 0; t < triangles; ++t) {
        keep[t] = !c->covered[t];
    }
    return true;
}

// ---- seams --------------------------------------------------------------------------------------

// The boundary loops of a mesh that can be sewn, with the component of each.
static bool list_loops(pci_scratch *scratch, const pc_mesh *mesh, pci_loop **loops, size_t *count,
                       uint32_t **components) {
    pci_topology topology;
    size_t *offsets = NULL;
    uint32_t *vertices = NULL;
    uint32_t *component = PCI_SCRATCH(scratch, uint32_t, mesh->triangle_count);
    if (component == NULL || !pci_topology_build_watched(scratch, mesh, &topology) ||
        !pci_boundary_loops(scratch, mesh, &topology, count, &offsets, &vertices)) {
        return false;
    }
    (void)pci_triangle_components(scratch, mesh, &topology, component);
    *loops = PCI_SCRATCH(scratch, pci_loop, *count);
    *components = PCI_SCRATCH(scratch, uint32_t, *count);
    for (size_t i = 0; i < *count && !scratch->failed; ++i) {
        const uint32_t *first = &vertices[offsets[i]];
        (*components)[i] =
            component[topology.vertex_triangles[topology.vertex_triangle_offsets[*first]]];
        if (!pci_loop_begin(scratch, mesh, offsets[i + 1] - offsets[i], first, &(*loops)[i])) {
            return false;
        }
    }
    return !scratch->failed;
}

// Sews loops of different components that follow each other. `mesh` gets their triangles.
static bool sew_loops(pci_scratch *scratch, double reach, pc_mesh *mesh, bool *sewn) {
    pci_loop *loops = NULL;
    uint32_t *components = NULL;
    size_t count = 0, most = mesh->triangle_count, triangles = mesh->triangle_count;
    if (!list_loops(scratch, mesh, &loops, &count, &components)) {
        return false;
    }
    for (size_t i = 0; i < count; ++i) {
        most += loops[i].count + 1;
    }
    uint32_t *corners = PCI_SCRATCH(scratch, uint32_t, 3 * most);
    uint8_t *done = PCI_SCRATCH(scratch, uint8_t, count);
    if (scratch->failed) {
        return false;
    }
    memcpy(corners, mesh->triangles, 3 * triangles * sizeof(*corners));
    for (size_t i = 0; i < count; ++i) {
        for (size_t j = 0; j < count && !done[i]; ++j) {
            pci_seam s;
            if (done[j] || components[i] == components[j] ||
                !pci_find_seam(&loops[i], &loops[j], reach, &s)) {
                continue;
            }
            if (!pci_keep_going(scratch->context) ||
                !pci_close_seam(scratch, &s, corners, &triangles)) {
                return false;
            }
            done[i] = done[j] = 1;
        }
    }
    *sewn = triangles > mesh->triangle_count;
    const pc_mesh sum = {mesh->vertex_count, mesh->positions, triangles, corners};
    pci_repair_counts counts;
    pc_mesh result = {0};
    if (*sewn && !pci_mesh_repair(scratch, &sum, NULL, &result, &counts)) {
        return false;
    }
    if (*sewn) {
        pc_mesh_free(scratch->context, mesh);
        *mesh = result;
    }
    return true;
}

pc_status pci_sew_parts(pci_scratch *scratch, const char *stage, double reach, pc_mesh *mesh,
                        bool *sewn) {
    pc_context *context = scratch->context;
    pci_topology topology;
    pci_bvh *bvh = NULL;
    *sewn = false;
    uint32_t *component = PCI_SCRATCH(scratch, uint32_t, mesh->triangle_count);
    uint8_t *covered = PCI_SCRATCH(scratch, uint8_t, mesh->triangle_count);
    if (scratch->failed || !pci_topology_build_edges(scratch, mesh, &topology)) {
        return pci_fail_memory(context, stage);
    }
    const size_t parts = pci_triangle_components(scratch, mesh, &topology, component);
    if (parts < 2) {
        return scratch->failed ? pci_fail_memory(context, stage) : PC_OK;
    }
    pc_status status = pci_bvh_create(context, stage, mesh, &bvh);
    if (status != PC_OK) {
        return status;
    }
    covering c = {mesh, bvh, component, reach, covered};
    const bool done =
        pci_parallel_while_wanted(context, mesh->triangle_count, grain, find_covered, &c);
    pci_bvh_destroy(context, bvh);
    uint8_t *keep = PCI_SCRATCH(scratch, uint8_t, mesh->triangle_count);
    if (!done || keep == NULL || !mark_uncovered(scratch, &c, &topology, parts, keep)) {
        return pci_fail_memory(context, stage);
    }
    if (memchr(keep, 0, mesh->triangle_count) == NULL ||
        memchr(keep, 1, mesh->triangle_count) == NULL) {
        return PC_OK;
    }
    pci_repair_counts counts;
    pc_mesh kept = {0};
    if (!pci_mesh_repair(scratch, mesh, keep, &kept, &counts) ||
        !sew_loops(scratch, reach, &kept, sewn)) {
        status = pci_fail_memory(context, stage);
    }
    *sewn = *sewn && status == PC_OK;
    if (*sewn) {
        pc_mesh_free(context, mesh);
        *mesh = kept;
    } else {
        pc_mesh_free(context, &kept);
    }
    return status;
}
