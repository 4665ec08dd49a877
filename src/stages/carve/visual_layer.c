#include "stages/carve/visual_layer.h"

#include <stdatomic.h>

#include "core/core.h"
#include "geometry/hausdorff.h"
#include "geometry/hems.h"
#include "geometry/manifold.h"
#include "geometry/notches.h"
#include "geometry/stitch.h"
#include "geometry/topology.h"
#include "stages/carve/hidden.h"
#include "stages/carve/lining.h"
#include "stages/carve/loops.h"
#include "stages/carve/sewing.h"
#include "stages/carve/shells.h"

enum { grain = 256, most_near = 512 };

// Sheets within a voxel of each other are close.
// Below this share of the area that sees another sheet close by, a sheet is plain.
static const double plain_share = 0.02;
// What lies in layers for the most part is wanted as one layer, however it was folded.
static const double most_folded_share = 0.15;
// Nor may other cloth go on before more of the border: a strip that is wound around something is
// wanted as one sheet, too.
static const double most_wound_share = 0.7;
// Linings are what takes more than this share of the layers along.
static const double least_lined = 0.5;
// What is worn over something else hangs at most so many voxels away from it; so much of the
// garment must be near what is sewn together.
static const double sewing_voxels = 4.0, least_covered = 0.99;
// Linings hang lower than the cloth here and there, in voxels.
static const double lining_voxels = 2.0;
// The first triangles of a part and one in so many of the others tell which way it faces.
enum { facing_first = 64, facing_stride = 8 };
// Holes of a shorter way around are no openings, in voxels.
static const double smallest_opening = 3.0;
// Vertices so near to the edge of another triangle lie on it, in voxels.
static const double stitch_voxels = 0.005;
// What is put onto a garment stands out so many voxels at most.
static const double attached_voxels = 3.0;
// Fronts whose sides are so near to each other are closed, in voxels.
static const double front_voxels = 1.0;
// How exactly it is known how far the visual mesh strays from sheets, in voxels.
static const double sheet_tolerance = 0.1;
// One of several sheets: another part with a border has so much of its area.
static const double least_other = 0.5;
// Thicker shells are solids, in voxels.
static const double thickest_shell = 4.0;

typedef struct probe {
    const pci_bvh *bvh;
    const pc_mesh *mesh;
    const uint32_t *component; // #F
    size_t component_count;
    double reach, touch_reach;
    uint32_t *seen;      // #F by 2: what shows its back close behind it, its front close before it
    atomic_bool touches; // two components are within touch_reach: nothing else matters
} probe;

static bool is_other(void *user, const pci_hit *hit) {
    const uint32_t *own = user;
    return hit->triangle != *own;
}

// The triangle nearest to t's middle, if it shows the side that a ply would, which may lie on t.
// PC_INVALID_INDEX: none.
static uint32_t look(const probe *p, uint32_t t, const double middle[3], const double normal[3],
                     double side) {
    const double slack = 1e-4 * p->reach;
    double direction[3], origin[3];
    for (size_t k = 0; k < 3; ++k) {
        direction[k] = side * normal[k];
        origin[k] = middle[k] - slack * direction[k];
    }
    const pci_hit hit =
        pci_bvh_cast(p->bvh, origin, direction, 0.0, p->reach + slack, is_other, &t);
    return hit.back_face == (side < 0.0) ? hit.triangle : PC_INVALID_INDEX;
}

static void look_around(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    probe *p = user;
    for (size_t t = begin; t < end && !atomic_load(&p->touches); ++t) {
        double normal[3], middle[3];
        pci_triangle_vector(p->mesh, t, normal);
        pci_triangle_middle(p->mesh, t, middle);
        uint32_t near[most_near];
        const size_t count = p->component_count > 1
                                 ? pci_bvh_collect(p->bvh, middle, p->touch_reach, most_near, near)
                                 : 0;
        for (size_t i = 0; i < count && i < most_near; ++i) {
            if (p->component[near[i]] != p->component[t]) {
                atomic_store(&p->touches, true);
            }
        }
        const bool proper = pci_normalize(normal);
        p->seen[2 * t] = proper ? look(p, (uint32_t)t, middle, normal, -1.0) : PC_INVALID_INDEX;
        p->seen[2 * t + 1] = proper ? look(p, (uint32_t)t, middle, normal, 1.0) : PC_INVALID_INDEX;
    }
}

// What was found of a layer.
typedef struct closeness {
    pci_layering layering;
    double doubled; // share of the area that sees another sheet within a voxel
    uint32_t *seen; // #F by 2: what each triangle sees behind and before it within a voxel; NULL:
                    // parts touch, or one is closed
} closeness;

// Whether every vertex of the visual mesh lies near the layer.
typedef struct cover_job {
    const pci_bvh *layer;
    const pc_mesh *surface;
    double reach;
    uint8_t *missed; // #V
} cover_job;

static void find_missed(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const cover_job *job = user;
    uint32_t last = PC_INVALID_INDEX;
    for (size_t v = begin; v < end; ++v) {
        job->missed[v] =
            !pci_bvh_within_near(job->layer, &job->surface->positions[3 * v], job->reach, &last);
    }
}

// Marks the components that have a border; NULL: out of memory.
static uint8_t *find_open(pci_scratch *scratch, const pci_topology *topology,
                          const uint32_t *component, size_t count) {
    uint8_t *open = PCI_SCRATCH(scratch, uint8_t, count);
    for (size_t e = 0; e < topology->edge_count && open != NULL; ++e) {
        open[component[pci_sides(topology, e)[0]]] |= pci_side_count(topology, e) == 1;
    }
    return open;
}

// @param doubled  receives the share of the area that sees another sheet, if nothing touches
static pci_layering classify(probe *p, double *doubled) {
    double area = 0.0, back = 0.0, front = 0.0;
    for (size_t t = 0; t < p->mesh->triangle_count; ++t) {
        const double a = pci_triangle_area(p->mesh, t);
        area += a;
        back += p->seen[2 * t] != PC_INVALID_INDEX ? a : 0.0;
        front += p->seen[2 * t + 1] != PC_INVALID_INDEX ? a : 0.0;
    }
    if (atomic_load(&p->touches)) {
        return PCI_LAYERED;
    }
    *doubled = area > 0.0 ? (back + front) / area : 0.0;
    if (*doubled <= plain_share) {
        return PCI_PLAIN;
    }
    return back <= most_folded_share * area ? PCI_FOLDED : PCI_LAYERED;
}

// Whether cloth goes on before most of the border of a layer. False: out of memory, or cancelled.
static bool is_wound(pci_scratch *scratch, const pc_mesh *layer, const pci_topology *edges,
                     const pci_bvh *bvh, double reach, bool *wound) {
    pci_hems hems;
    double open = 0.0;
    if (!pci_find_hems(scratch, layer, edges, bvh, reach, &hems)) {
        return false;
    }
    for (size_t i = 0; i < hems.count; ++i) {
        open += sqrt(pci_squared_distance(&hems.points[6 * i], &hems.points[6 * i + 3]));
    }
    *wound = open < (1.0 - most_wound_share) * pci_boundary_length(layer, edges);
    return true;
}

// @param edges  of `layer`, or NULL
// @param reach  at least this `share` of the vertices of the visual mesh must be so near to `layer`
// @param found  as it is where parts are closed
static pc_status measure(const pci_cloth *cloth, const pc_mesh *layer, const pci_topology *edges,
                         double reach, double share, closeness *found) {
    pci_scratch *scratch = cloth->scratch;
    pc_context *context = scratch->context;
    const char *stage = cloth->stage;
    const pc_mesh *surface = cloth->surface;
    pci_topology built;
    uint32_t *component = PCI_SCRATCH(scratch, uint32_t, layer->triangle_count);
    probe p = {.mesh = layer, .component = component, .reach = cloth->cell_size};
    p.touch_reach = cloth->cell_size + cloth->thickness;
    p.seen = PCI_SCRATCH(scratch, uint32_t, 2 * layer->triangle_count);
    uint8_t *missed = PCI_SCRATCH(scratch, uint8_t, surface->vertex_count);
    if (scratch->failed || (edges == NULL && !pci_topology_build_edges(scratch, layer, &built))) {
        return pci_fail_memory(context, stage);
    }
    edges = edges == NULL ? &built : edges;
    p.component_count = pci_triangle_components(scratch, layer, edges, component);
    const uint8_t *open = find_open(scratch, edges, component, p.component_count);
    if (open == NULL || memchr(open, 0, p.component_count) != NULL) { // doubled sheets or solids
        return open == NULL ? pci_fail_memory(context, stage) : PC_OK;
    }
    pci_bvh *bvh = NULL;
    const pc_status status = pci_bvh_create(context, stage, layer, &bvh);
    if (status != PC_OK) {
        return status;
    }
    p.bvh = bvh;
    cover_job cover = {bvh, surface, reach + cloth->thickness, missed};
    bool wound = false;
    const bool done =
        pci_parallel_while_wanted(context, layer->triangle_count, grain, look_around, &p) &&
        (atomic_load(&p.touches) ||
         (pci_parallel_while_wanted(context, surface->vertex_count, grain, find_missed, &cover) &&
          is_wound(scratch, layer, edges, bvh, cloth->cell_size, &wound)));
    pci_bvh_destroy(context, bvh);
    if (!done) {
        return pci_fail_memory(context, stage);
    }
    if (!atomic_load(&p.touches)) {
        found->seen = p.seen;
    }
    size_t missed_count = 0;
    for (size_t v = 0; v < surface->vertex_count; ++v) {
        missed_count += missed[v];
    }
    found->layering = classify(&p, &found->doubled);
    if (wound || (double)missed_count > (1.0 - share) * (double)surface->vertex_count) {
        found->layering = PCI_LAYERED;
    }
    return PC_OK;
}

static pc_status find_edges(pci_cloth *cloth) {
    return pci_topology_build_edges(cloth->scratch, &cloth->mesh, &cloth->edges)
               ? PC_OK
               : pci_fail_memory(cloth->scratch->context, cloth->stage);
}

// Joins what ends in the middle of edges of its neighbours, as after a part was made finer.
static pc_status stitch(pci_cloth *cloth) {
    pci_scratch *scratch = cloth->scratch;
    const struct pci_scratch_block *before = scratch->blocks;
    pc_mesh stitched = {0};
    pci_repair_counts counts;
    bool some = false;
    pc_status status = pci_stitch_borders(scratch, cloth->stage, &cloth->mesh, &cloth->edges,
                                          stitch_voxels * cloth->cell_size, &stitched, &some);
    pci_scratch_rewind(scratch, before);
    if (status == PC_OK && some) {
        pc_mesh_free(scratch->context, &cloth->mesh);
        status = pci_mesh_repair(scratch, &stitched, NULL, &cloth->mesh, &counts)
                     ? find_edges(cloth)
                     : pci_fail_memory(scratch->context, cloth->stage);
        pc_mesh_free(scratch->context, &stitched);
    }
    return status;
}

pc_status pci_visual_cloth(pci_cloth *cloth) {
    pci_repair_counts counts;
    pci_scratch *scratch = cloth->scratch;
    const char *stage = cloth->stage;
    const struct pci_scratch_block *before = scratch->blocks;
    pc_status status = pci_mesh_repair(scratch, cloth->surface, NULL, &cloth->mesh, &counts)
                           ? find_edges(cloth)
                           : pci_fail_memory(scratch->context, stage);
    if (status == PC_OK) {
        status = stitch(cloth);
    }
    if (status != PC_OK) {
        return status;
    }
    const size_t whole = cloth->mesh.triangle_count;
    const struct pci_scratch_block *after = scratch->blocks;
    status = pci_peel_shells(scratch, stage, thickest_shell * cloth->cell_size, &cloth->edges,
                             &cloth->mesh, &cloth->thickness);
    pci_scratch_rewind(scratch, after);
    if (status == PC_OK) {
        status = pci_drop_hidden(scratch, stage, cloth->cell_size, &cloth->mesh);
        pci_scratch_rewind(scratch, after);
    }
    if (status == PC_OK && cloth->mesh.triangle_count < whole) {
        pci_scratch_rewind(scratch, before);
        status = find_edges(cloth);
    }
    return status;
}

// The cloth with small holes filled.
static pc_status begin_layer(const pci_cloth *cloth, pc_mesh *layer, uint64_t *filled_loops) {
    pci_scratch *scratch = cloth->scratch;
    const struct pci_scratch_block *mark = scratch->blocks;
    const pci_hole_limits holes = {.most_edges = SIZE_MAX,
                                   .longest = smallest_opening * cloth->cell_size,
                                   .missing_faces = true};
    const pc_status status =
        pci_mesh_compact(scratch, &cloth->mesh, NULL, layer, NULL)
            ? pci_fill_loops(scratch, cloth->stage, &cloth->edges, &holes, layer, filled_loops)
            : pci_fail_memory(scratch->context, cloth->stage);
    pci_scratch_rewind(scratch, mark);
    if (status != PC_OK) {
        pc_mesh_free(scratch->context, layer);
    }
    return status;
}

// Hems and collars that are turned over make a second ply: without them the layer may be plain.
// Where layers go with them and others stay, it is layered. Where nothing can be cut off, or next
// to nothing of the layers goes with it, two sides of the cloth lie close, and a folded sheet stays
// one.
// @param found  of the layer; `layering` may change
static pc_status try_peeling(const pci_cloth *cloth, double reach, pc_mesh *layer,
                             closeness *found) {
    pci_scratch *scratch = cloth->scratch;
    bool peeled = false;
    pc_mesh rest = {0};
    closeness without = {.layering = PCI_LAYERED};
    pc_status status = pci_mesh_compact(scratch, layer, NULL, &rest, NULL)
                           ? pci_peel_linings(scratch, cloth->stage, found->seen, cloth->cell_size,
                                              0.0, &rest, &peeled)
                           : pci_fail_memory(scratch->context, cloth->stage);
    if (status == PC_OK && peeled) {
        status = measure(cloth, &rest, NULL, reach, least_covered, &without);
    }
    if (status == PC_OK && without.layering == PCI_PLAIN) {
        const pc_mesh swapped = *layer;
        *layer = rest;
        rest = swapped;
        found->layering = PCI_PLAIN;
    } else if (peeled && found->doubled - without.doubled > least_lined * found->doubled) {
        found->layering = PCI_LAYERED;
    }
    pc_mesh_free(scratch->context, &rest);
    return status;
}

pc_status pci_visual_layer(const pci_cloth *cloth, bool always, pc_mesh *layer,
                           pci_layering *layering, uint64_t *filled_loops) {
    pci_scratch *scratch = cloth->scratch;
    const struct pci_scratch_block *mark = scratch->blocks;
    closeness found = {.layering = PCI_LAYERED};
    pc_status status = begin_layer(cloth, layer, filled_loops);
    if (status == PC_OK && layer->triangle_count > 0 && !always) {
        const bool same = layer->triangle_count == cloth->mesh.triangle_count;
        status = measure(cloth, layer, same ? &cloth->edges : NULL, cloth->cell_size, 1.0, &found);
        if (status == PC_OK && found.layering != PCI_PLAIN && found.seen != NULL) {
            status = try_peeling(cloth, lining_voxels * cloth->cell_size, layer, &found);
        }
        pci_scratch_rewind(scratch, mark);
    }
    *layering = found.layering;
    if (status != PC_OK || (*layering == PCI_LAYERED && !always)) {
        pc_mesh_free(scratch->context, layer);
    }
    return status;
}

// Finds the bounding boxes of components: high, and low reversed. NULL: out of memory.
static double *find_boxes(pci_scratch *scratch, const pc_mesh *mesh, const uint32_t *component,
                          size_t count) {
    double *boxes = PCI_SCRATCH(scratch, double, 6 * count);
    for (size_t i = 0; boxes != NULL && i < 6 * count; ++i) {
        boxes[i] = -HUGE_VAL;
    }
    for (size_t i = 0; boxes != NULL && i < 9 * mesh->triangle_count; ++i) {
        const double x = mesh->positions[3 * (size_t)mesh->triangles[i / 3] + i % 3];
        double *box = &boxes[6 * (size_t)component[i / 9] + i % 3];
        box[0] = fmax(box[0], x);
        box[3] = fmax(box[3], -x);
    }
    return boxes;
}

// Finds the open component whose bounding box has the longest diagonal; `count`: all are closed.
static bool find_longest(pci_scratch *scratch, const pc_mesh *mesh, const pci_topology *edges,
                         const uint32_t *component, size_t count, size_t *longest) {
    const uint8_t *open = find_open(scratch, edges, component, count);
    const double *boxes = find_boxes(scratch, mesh, component, count);
    double most = 0.0;
    if (scratch->failed) {
        return false;
    }
    *longest = count;
    for (size_t i = 0; i < count; ++i) {
        const double *box = &boxes[6 * i];
        const double size[3] = {box[0] + box[3], box[1] + box[4], box[2] + box[5]};
        if (open[i] && pci_norm(size) > most) {
            most = pci_norm(size);
            *longest = i;
        }
    }
    return true;
}

// Borders of each component of the cloth. NULL: out of memory.
static size_t *count_borders(const pci_cloth *cloth, const uint32_t *component, size_t count) {
    pci_scratch *scratch = cloth->scratch;
    const pc_mesh *mesh = &cloth->mesh;
    size_t loops = 0, *offsets = NULL;
    uint32_t *vertices = NULL, *of = PCI_SCRATCH(scratch, uint32_t, mesh->vertex_count);
    size_t *borders = PCI_SCRATCH(scratch, size_t, count);
    if (scratch->failed ||
        !pci_boundary_loops(scratch, mesh, &cloth->edges, &loops, &offsets, &vertices)) {
        return NULL;
    }
    for (size_t i = 0; i < 3 * mesh->triangle_count; ++i) {
        of[mesh->triangles[i]] = component[i / 3];
    }
    for (size_t i = 0; i < loops; ++i) {
        ++borders[of[vertices[offsets[i]]]];
    }
    return borders;
}

// Whether all components of the cloth are put onto a part of it: at least half of each is near, and
// all of what has several borders, unlike a sleeve that goes on from it. The outsides of pouches
// are as far away as these are thick.
static pc_status find_worn(const pci_cloth *cloth, const uint32_t *component, size_t count,
                           const pc_mesh *part, bool *worn) {
    pci_scratch *scratch = cloth->scratch;
    const pc_mesh *mesh = &cloth->mesh;
    pci_bvh *bvh = NULL;
    uint8_t *missed = PCI_SCRATCH(scratch, uint8_t, mesh->vertex_count);
    size_t *near = PCI_SCRATCH(scratch, size_t, 2 * count);
    const size_t *borders = count_borders(cloth, component, count);
    if (scratch->failed || borders == NULL) {
        return pci_fail_memory(scratch->context, cloth->stage);
    }
    const pc_status status = pci_bvh_create(scratch->context, cloth->stage, part, &bvh);
    if (status != PC_OK) {
        return status;
    }
    cover_job cover = {bvh, mesh, attached_voxels * cloth->cell_size + cloth->thickness, missed};
    const bool done =
        pci_parallel_while_wanted(scratch->context, mesh->vertex_count, grain, find_missed, &cover);
    pci_bvh_destroy(scratch->context, bvh);
    for (size_t i = 0; i < 3 * mesh->triangle_count; ++i) {
        ++near[2 * (size_t)component[i / 3] + missed[mesh->triangles[i]]];
    }
    *worn = true;
    for (size_t i = 0; i < count; ++i) {
        const size_t away = near[2 * i + 1];
        *worn = *worn && (borders[i] > 1 ? away == 0 : near[2 * i] >= away);
    }
    return done ? PC_OK : pci_fail_memory(scratch->context, cloth->stage);
}

// The longest open part of several, if the others are put onto it.
// @param bare  receives its mesh and edges; else they stay empty
static pc_status find_bare(const pci_cloth *cloth, pci_cloth *bare) {
    pci_scratch *scratch = cloth->scratch;
    const pc_mesh *mesh = &cloth->mesh;
    size_t longest = 0;
    bool worn = false;
    uint32_t *component = PCI_SCRATCH(scratch, uint32_t, mesh->triangle_count);
    uint8_t *keep = PCI_SCRATCH(scratch, uint8_t, mesh->triangle_count);
    if (scratch->failed) {
        return pci_fail_memory(scratch->context, cloth->stage);
    }
    const size_t count = pci_triangle_components(scratch, mesh, &cloth->edges, component);
    if (!find_longest(scratch, mesh, &cloth->edges, component, count, &longest)) {
        return pci_fail_memory(scratch->context, cloth->stage);
    }
    if (count < 2 || longest == count) {
        return PC_OK;
    }
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        keep[t] = component[t] == longest;
    }
    pc_status status = pci_mesh_compact(scratch, mesh, keep, &bare->mesh, NULL)
                           ? find_worn(cloth, component, count, &bare->mesh, &worn)
                           : pci_fail_memory(scratch->context, cloth->stage);
    if (status == PC_OK && worn) {
        status = find_edges(bare);
    } else {
        pc_mesh_free(scratch->context, &bare->mesh);
    }
    return status;
}

pc_status pci_bare_layer(const pci_cloth *cloth, pc_mesh *layer, uint64_t *filled_loops,
                         bool *covers) {
    pci_scratch *scratch = cloth->scratch;
    const struct pci_scratch_block *mark = scratch->blocks;
    const double reach = attached_voxels * cloth->cell_size;
    closeness found = {.layering = PCI_LAYERED};
    // Of its own: how thick shells elsewhere are does not matter.
    pci_cloth bare = {.scratch = scratch,
                      .stage = cloth->stage,
                      .surface = cloth->surface,
                      .cell_size = cloth->cell_size};
    pc_status status = find_bare(cloth, &bare);
    if (status == PC_OK && bare.mesh.triangle_count > 0) {
        status = begin_layer(&bare, layer, filled_loops);
    }
    pc_mesh_free(scratch->context, &bare.mesh);
    *covers = false;
    if (status == PC_OK && layer->triangle_count > 0) {
        status = measure(&bare, layer, NULL, reach, 1.0, &found);
        *covers = found.layering == PCI_PLAIN;
    }
    if (status == PC_OK && layer->triangle_count > 0 && !*covers) {
        status = measure(&bare, layer, NULL, reach, 0.0, &found);
    }
    pci_scratch_rewind(scratch, mark);
    if (status != PC_OK || found.layering != PCI_PLAIN) {
        pc_mesh_free(scratch->context, layer);
    }
    return status;
}

// ---- one sheet of several -----------------------------------------------------------------------

// Whether the box of a part comes within `reach` of all sides of the whole.
static bool spans(const double *part, const double whole[6], double reach) {
    bool near = true;
    for (size_t i = 0; i < 6; ++i) {
        near = near && part[i] >= whole[i] - reach;
    }
    return near;
}

// A part of the cloth as a garment of its own: `sheet` stays empty where that is layered.
// @param keep  #F of the cloth
static pc_status make_sheet(const pci_cloth *cloth, const uint8_t *keep, pc_mesh *sheet,
                            uint64_t *filled_loops) {
    pci_cloth part = {
        .scratch = cloth->scratch, .stage = cloth->stage, .cell_size = cloth->cell_size};
    pci_layering layering = PCI_LAYERED;
    pc_status status = pci_mesh_compact(cloth->scratch, &cloth->mesh, keep, &part.mesh, NULL)
                           ? find_edges(&part)
                           : pci_fail_memory(cloth->scratch->context, cloth->stage);
    if (status == PC_OK) {
        part.surface = &part.mesh;
        status = pci_visual_layer(&part, false, sheet, &layering, filled_loops);
    }
    pc_mesh_free(cloth->scratch->context, &part.mesh);
    return status;
}

pc_status pci_farthest(const pci_cloth *cloth, const pc_mesh *layer, double *distance) {
    pc_context *context = cloth->scratch->context;
    pci_bvh *bvh = NULL;
    pc_status status = pci_bvh_create(context, cloth->stage, layer, &bvh);
    if (status == PC_OK) {
        status = pci_directed_hausdorff(context, cloth->stage, cloth->surface, layer, bvh,
                                        sheet_tolerance * cloth->cell_size, distance);
    }
    pci_bvh_destroy(context, bvh);
    return status;
}

// Marks the open parts beside which there is another one with half of their area. NULL: out of
// memory.
static uint8_t *find_accompanied(pci_scratch *scratch, const pc_mesh *mesh,
                                 const uint32_t *component, size_t count, const uint8_t *open) {
    double *areas = PCI_SCRATCH(scratch, double, count);
    uint8_t *accompanied = PCI_SCRATCH(scratch, uint8_t, count);
    size_t first = count, second = count;
    if (scratch->failed) {
        return NULL;
    }
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        areas[component[t]] += pci_triangle_area(mesh, t);
    }
    for (size_t i = 0; i < count; ++i) {
        if (open[i] && (first == count || areas[i] > areas[first])) {
            second = first;
            first = i;
        } else if (open[i] && (second == count || areas[i] > areas[second])) {
            second = i;
        }
    }
    for (size_t i = 0; i < count && second < count; ++i) {
        const size_t other = i == first ? second : first;
        accompanied[i] = open[i] && areas[other] >= least_other * areas[i];
    }
    return accompanied;
}

// The topology of each part of the cloth. NULL: out of memory.
static pci_shape *find_shapes(const pci_cloth *cloth, const uint32_t *component, size_t count) {
    const pc_mesh *mesh = &cloth->mesh;
    const size_t *borders = count_borders(cloth, component, count);
    pci_shape *shapes = PCI_SCRATCH(cloth->scratch, pci_shape, count);
    uint8_t *seen = PCI_SCRATCH(cloth->scratch, uint8_t, mesh->vertex_count);
    if (cloth->scratch->failed || borders == NULL) {
        return NULL;
    }
    for (size_t i = 0; i < count; ++i) {
        shapes[i] = (pci_shape){.components = 1, .boundary_loops = borders[i]};
    }
    for (size_t k = 0; k < 3 * mesh->triangle_count; ++k) {
        shapes[component[k / 3]].euler += (size_t)(k % 3 == 0) + (seen[mesh->triangles[k]] == 0);
        seen[mesh->triangles[k]] = 1;
    }
    for (size_t e = 0; e < cloth->edges.edge_count; ++e) {
        --shapes[component[pci_sides(&cloth->edges, e)[0]]].euler;
    }
    return shapes;
}

pc_status pci_nearest_sheet(const pci_cloth *cloth, const pci_shape *shape, double alone,
                            double among, double *distance, pc_mesh *layer,
                            uint64_t *filled_loops) {
    pci_scratch *scratch = cloth->scratch;
    const pc_mesh *mesh = &cloth->mesh;
    uint32_t *component = PCI_SCRATCH(scratch, uint32_t, mesh->triangle_count);
    uint32_t *whole = PCI_SCRATCH(scratch, uint32_t, cloth->surface->triangle_count);
    uint8_t *keep = PCI_SCRATCH(scratch, uint8_t, mesh->triangle_count);
    if (scratch->failed) {
        return pci_fail_memory(scratch->context, cloth->stage);
    }
    const size_t count = pci_triangle_components(scratch, mesh, &cloth->edges, component);
    const uint8_t *open = find_open(scratch, &cloth->edges, component, count);
    const double *boxes = find_boxes(scratch, mesh, component, count);
    const double *box = find_boxes(scratch, cloth->surface, whole, 1);
    if (scratch->failed) {
        return pci_fail_memory(scratch->context, cloth->stage);
    }
    const uint8_t *accompanied = find_accompanied(scratch, mesh, component, count, open);
    const pci_shape *shapes = find_shapes(cloth, component, count);
    double *limits = PCI_SCRATCH(scratch, double, count);
    if (scratch->failed || accompanied == NULL || shapes == NULL) {
        return pci_fail_memory(scratch->context, cloth->stage);
    }
    bool wanted = alone > 0.0;
    for (size_t i = 0; i < count; ++i) {
        limits[i] = accompanied[i] ? fmax(alone, among) : alone;
        limits[i] = open[i] && spans(&boxes[6 * i], box, limits[i]) ? limits[i] : 0.0;
        wanted = wanted || (limits[i] > 0.0 && !pci_same_topology(&shapes[i], shape));
    }
    const struct pci_scratch_block *mark = scratch->blocks;
    pc_status status = PC_OK;
    *distance = INFINITY;
    for (size_t i = 0; i < count && status == PC_OK && wanted; ++i) {
        const double limit = fmin(*distance, limits[i]);
        if (limit <= 0.0 || !spans(&boxes[6 * i], box, limit)) {
            continue;
        }
        pc_mesh sheet = {0};
        uint64_t filled = 0;
        double far = INFINITY;
        for (size_t t = 0; t < mesh->triangle_count; ++t) {
            keep[t] = component[t] == i;
        }
        status = make_sheet(cloth, keep, &sheet, &filled);
        if (status == PC_OK && sheet.triangle_count > 0) {
            status = pci_farthest(cloth, &sheet, &far);
        }
        pci_scratch_rewind(scratch, mark);
        if (status == PC_OK && far < limit) {
            const pc_mesh swapped = *layer;
            *layer = sheet;
            sheet = swapped;
            *distance = far;
            *filled_loops = filled;
        }
        pc_mesh_free(scratch->context, &sheet);
    }
    if (status != PC_OK) {
        pc_mesh_free(scratch->context, layer);
    }
    return status;
}

pc_status pci_tailored_layer(const pci_cloth *cloth, const pc_mesh *side, pc_mesh *layer,
                             uint64_t *filled_loops) {
    pci_scratch *scratch = cloth->scratch;
    const char *stage = cloth->stage;
    const double reach = sewing_voxels * cloth->cell_size;
    bool sewn = false;
    closeness found = {.layering = PCI_LAYERED};
    const struct pci_scratch_block *mark = scratch->blocks;
    pc_status status = begin_layer(cloth, layer, filled_loops);
    if (status == PC_OK && layer->triangle_count > 0) {
        status = pci_face_like(scratch, stage, side, false, layer);
    }
    if (status == PC_OK && layer->triangle_count > 0) {
        status = pci_sew_parts(scratch, stage, reach, layer, &sewn);
    }
    if (status == PC_OK && sewn) {
        status = measure(cloth, layer, NULL, reach, least_covered, &found);
    }
    // Closed parts, and parts that touch each other, are so without their linings, too.
    if (status == PC_OK && found.layering != PCI_PLAIN && found.seen != NULL) {
        status = try_peeling(cloth, reach, layer, &found);
    }
    if (status == PC_OK && found.layering != PCI_LAYERED &&
        !pci_close_slits(scratch, front_voxels * cloth->cell_size, layer)) {
        status = pci_fail_memory(scratch->context, stage);
    }
    pci_scratch_rewind(scratch, mark);
    if (status != PC_OK || found.layering == PCI_LAYERED) {
        pc_mesh_free(scratch->context, layer);
    }
    return status;
}

// ---- orientation --------------------------------------------------------------------------------

typedef struct facing {
    const pci_bvh *bvh;
    const pc_mesh *reference, *layer;
    const uint32_t *asked; // triangles of the layer
    double *votes;         // of those
} facing;

static void compare_facing(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const facing *f = user;
    uint32_t nearest = PC_INVALID_INDEX;
    for (size_t i = begin; i < end; ++i) {
        double middle[3], ours[3], theirs[3];
        pci_triangle_middle(f->layer, f->asked[i], middle);
        pci_triangle_vector(f->layer, f->asked[i], ours);
        nearest = pci_bvh_closest_near(f->bvh, middle, nearest).triangle;
        pci_triangle_vector(f->reference, nearest, theirs);
        f->votes[i] = pci_normalize(theirs) ? pci_dot(ours, theirs) : 0.0;
    }
}

pc_status pci_face_like(pci_scratch *scratch, const char *stage, const pc_mesh *reference,
                        bool against, pc_mesh *layer) {
    pci_bvh *bvh = NULL;
    double *votes = PCI_SCRATCH(scratch, double, layer->triangle_count);
    uint32_t *component = PCI_SCRATCH(scratch, uint32_t, layer->triangle_count);
    uint32_t *asked = PCI_SCRATCH(scratch, uint32_t, layer->triangle_count);
    if (scratch->failed) {
        return pci_fail_memory(scratch->context, stage);
    }
    const size_t count = pci_manifold_components(scratch, layer, component);
    double *sums = PCI_SCRATCH(scratch, double, count);
    size_t *met = PCI_SCRATCH(scratch, size_t, count), asked_count = 0;
    if (scratch->failed) {
        return pci_fail_memory(scratch->context, stage);
    }
    const pc_status status = pci_bvh_create(scratch->context, stage, reference, &bvh);
    if (status != PC_OK) {
        return status;
    }
    for (uint32_t t = 0; t < layer->triangle_count; ++t) {
        const size_t rank = met[component[t]]++;
        if (rank < facing_first || rank % facing_stride == 0) {
            asked[asked_count++] = t;
        }
    }
    facing job = {bvh, reference, layer, asked, votes};
    pci_parallel_for(scratch->context, asked_count, grain, compare_facing, &job);
    pci_bvh_destroy(scratch->context, bvh);
    for (size_t i = 0; i < asked_count; ++i) {
        sums[component[asked[i]]] += votes[i];
    }
    for (size_t t = 0; t < layer->triangle_count; ++t) {
        if ((against ? -sums[component[t]] : sums[component[t]]) < 0.0) {
            uint32_t *corner = &layer->triangles[3 * t];
            const uint32_t second = corner[1];
            corner[1] = corner[2];
            corner[2] = second;
        }
    }
    return PC_OK;
}
