#include "proxycloth/carve.h"

#include "core/core.h"
#include "core/union_find.h"
#include "geometry/bvh.h"
#include "geometry/manifold.h"
#include "geometry/rim.h"
#include "geometry/topology.h"
#include "stages/carve/border.h"
#include "stages/carve/coverage.h"
#include "stages/carve/crumbs.h"
#include "stages/carve/dents.h"
#include "stages/carve/hollows.h"
#include "stages/carve/lining.h"
#include "stages/carve/loops.h"
#include "stages/carve/outline.h"
#include "stages/carve/sides.h"
#include "stages/carve/straps.h"
#include "stages/carve/visual_layer.h"
#include "stages/carve/webs.h"

static const char stage[] = "carve";

static const char *const source_choices[] = {"auto", "labels", "visual", NULL};
static const pc_field option_fields[] = {
    PCI_FIELD_CHOICE(pc_carve_options, layer_source, PC_LAYER_AUTO, PC_LAYER_VISUAL, source_choices,
                     "Single layer from the labels or from the visual mesh; auto: from the visual "
                     "mesh where it is one clean sheet"),
    PCI_FIELD_OPTION(pc_carve_options, carve, BOOL, 0, 0, 1, "",
                     "Also cut what bridges two surfaces of the visual mesh (section 5.1)"),
    PCI_FIELD_OPTION(
        pc_carve_options, carve_distance, DOUBLE, 0.25, 0.05, 10.0, "voxels",
        "epsilon_carved: surface farther than this beside the visual mesh is cut away"),
    PCI_FIELD_OPTION(
        pc_carve_options, smallest_part, DOUBLE, 0.02, 0.0, 1.0, "",
        "Parts below this share of the largest part's area are dropped, unless they are "
        "loose parts of the garment"),
    PCI_FIELD_OPTION(pc_carve_options, fill_loops, UINT, 12, 0, 1000, "edges",
                     "Boundary loops up to this length are filled"),
    PCI_FIELD_OPTION(pc_carve_options, snap_border, BOOL, 1, 0, 1, "",
                     "Move the border onto the garment's hems within 1.5 voxels"),
};
const pc_record pc_carve_options_record = PCI_RECORD(option_fields, pc_carve_options);

static const pc_field report_fields[] = {
    {.name = "source",
     .type = PC_FIELD_CHOICE,
     .offset = offsetof(pc_carve_report, source),
     .unit = "",
     .help = "Where the single layer comes from",
     .choices = source_choices},
    PCI_FIELD_REPORT(pc_carve_report, vertices, COUNT, "", "Vertices of the single layer"),
    PCI_FIELD_REPORT(pc_carve_report, triangles, COUNT, "", "Triangles of the single layer"),
    PCI_FIELD_REPORT(pc_carve_report, components, COUNT, "", "Connected parts"),
    PCI_FIELD_REPORT(pc_carve_report, boundary_loops, COUNT, "", "Closed boundary curves"),
    PCI_FIELD_REPORT(pc_carve_report, dropped_parts, COUNT, "", "Parts that were too small"),
    PCI_FIELD_REPORT(pc_carve_report, filled_loops, COUNT, "", "Boundary loops that were filled"),
    PCI_FIELD_REPORT(pc_carve_report, carved_regions, COUNT, "",
                     "Membranes over openings, and with carve also gaps, that were cut away"),
    PCI_FIELD_REPORT(pc_carve_report, carved_triangles, COUNT, "", "Their triangles"),
    PCI_FIELD_REPORT(pc_carve_report, coverage, DOUBLE, "",
                     "Share of the visual mesh's vertices within 2 voxels of the layer"),
};
const pc_record pc_carve_report_record = PCI_RECORD(report_fields, pc_carve_report);

// The labels of a folded sheet may miss so much of it.
static const double least_coverage = 0.99;
// So much of a layer's area may bridge gaps.
static const double most_bridges = 0.005;
// An outfit has a few parts that are worn over each other; patterns have more panels.
static const size_t most_parts = 6;
// Small parts farther than this from the others are loose parts of the garment, not crumbs.
static const double loose_voxels = 2.0;
// Pieces inside closed bodies are left out within so many voxels of what is seen of them.
static const double hollow_voxels = 4.5;
// What goes around a belt with its pouches is near to as much of it as that, of what the labels are
// near to: it leaves out what is behind pouches.
static const double least_seen = 0.9;
// Radius of the ball that tells rims from surfaces, in voxels: narrower than openings of note.
static const double rim_radius = 0.5;
static const double rim_spacing = 0.25; // in voxels
// What a layer strays less from, in voxels, it does not leave out. One of several sheets may leave
// out so many times as much, if its shape is another one, but strays so many voxels at most.
static const double left_out_voxels = 2.0, most_left_out = 2.0, most_stray_voxels = 10.0;
// Labels that change sides along a sheet, as where another layer hides half of it, keep both sides
// of the rest, within so many voxels of each other; less than this share of the area is noise at
// hems.
static const double both_sides_reach = 0.5, least_both_sides = 0.1;
// Borders of the cloth so near to each other are one seam, in voxels; at a vertex that so many
// triangles share.
static const double crack_voxels = 0.02;
enum { most_joined = 12 };
// Where the walls of gaps may begin (stages/carve/webs.h): those of narrow legs have few triangles,
// which cut corners.
enum { cloth_rings = 4, projected_rings = 2 };

// What a single layer is made of.
typedef struct carve_job {
    const pci_cloth *cloth;   // of the visual mesh
    const pci_rims *rims;     // of the visual mesh, once they are known
    const pc_mesh *projected; // mesh
    const uint8_t *labels;    // #V of `projected`
    const pc_carve_options *options;
} carve_job;

static pc_status find_shape(pci_scratch *scratch, const pc_mesh *mesh, pci_shape *shape) {
    return pci_find_shape(scratch, mesh, shape) ? PC_OK : pci_fail_memory(scratch->context, stage);
}

static bool same_openings(const pci_shape *a, const pci_shape *b) {
    return a->components == b->components && a->boundary_loops == b->boundary_loops;
}

// What is reported of the layer.
static pc_status measure(const carve_job *job, const pc_mesh *mesh, const pci_shape *shape,
                         pc_carve_report *report) {
    report->vertices = mesh->vertex_count;
    report->triangles = mesh->triangle_count;
    report->boundary_loops = shape->boundary_loops;
    report->components = shape->components;
    return pci_measure_coverage(job->cloth->scratch, stage, job->cloth->surface, mesh,
                                job->cloth->cell_size, &report->coverage);
}

// ---- entry ------------------------------------------------------------------------------------

static pc_status check_arguments(pc_context *context, const pc_mesh *surface,
                                 const pc_mesh *projected, const pc_labels *labels,
                                 double cell_size, const pc_mesh *single_layer) {
    pc_status status = pci_check_mesh_of_cells(context, stage, surface, "visual mesh", cell_size);
    if (status == PC_OK) {
        status = pci_check_mesh_of_cells(context, stage, projected, "projected mesh", cell_size);
    }
    if (status != PC_OK) {
        return status;
    }
    if (labels == NULL || single_layer == NULL || single_layer->positions != NULL ||
        single_layer->triangles != NULL) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "carve: the labels are missing or the output is not empty");
    }
    if (labels->vertex_count != projected->vertex_count) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "carve: %zu labels for %zu vertices", labels->vertex_count,
                        projected->vertex_count);
    }
    return PC_OK;
}

static pc_status no_proxy(pc_context *context, const char *reason) {
    return pci_fail(context, PC_ERROR_NO_PROXY, stage, "carve: no triangle is left, %s", reason);
}

// Marks the triangles with two labels of 1; NULL: out of memory.
static uint8_t *kept_triangles(const carve_job *job) {
    const pc_mesh *projected = job->projected;
    const uint8_t *labels = job->labels;
    uint8_t *keep = PCI_SCRATCH(job->cloth->scratch, uint8_t, projected->triangle_count);
    for (size_t t = 0; keep != NULL && t < projected->triangle_count; ++t) {
        const uint32_t *corner = &projected->triangles[3 * t];
        keep[t] =
            (labels[corner[0]] != 0) + (labels[corner[1]] != 0) + (labels[corner[2]] != 0) >= 2;
    }
    return keep;
}

// The triangles whose labels say so, as a manifold without short holes.
// @param projected  tree of that mesh, built here if it is needed and was not before
static pc_status extract(const carve_job *job, pci_bvh **projected, pc_mesh *layer,
                         pc_carve_report *report) {
    pci_scratch *scratch = job->cloth->scratch;
    pc_context *context = scratch->context;
    uint8_t *keep = kept_triangles(job);
    if (keep == NULL) {
        return pci_fail_memory(context, stage);
    }
    pc_status status = pci_keep_dents(scratch, stage, job->projected, &job->rims->points,
                                      job->cloth->cell_size, projected, keep);
    if (status == PC_OK) {
        status = pci_leave_hollows(scratch, stage, job->projected,
                                   hollow_voxels * job->cloth->cell_size, keep);
    }
    pci_repair_counts counts;
    if (status == PC_OK && !pci_mesh_repair(scratch, job->projected, keep, layer, &counts)) {
        status = pci_fail_memory(context, stage);
    }
    if (status != PC_OK) {
        return status;
    }
    if (layer->triangle_count == 0) {
        return no_proxy(context, "the labels keep none");
    }
    if (!pci_progress(context, stage, 0.3)) {
        return pci_fail_cancelled(context, stage);
    }
    const pci_hole_limits holes = {.most_edges = job->options->fill_loops,
                                   .longest = INFINITY,
                                   .whole = job->projected,
                                   .tree = projected};
    pci_topology edges;
    return pci_topology_build_edges(scratch, layer, &edges)
               ? pci_fill_loops(scratch, stage, &edges, &holes, layer, &report->filled_loops)
               : pci_fail_memory(context, stage);
}

static pc_status cut(const carve_job *job, const pci_bvh *visual, const pci_rims *rims,
                     pc_mesh *layer, pc_carve_report *report) {
    pci_scratch *scratch = job->cloth->scratch;
    const pc_carve_options *options = job->options;
    const struct pci_scratch_block *mark = scratch->blocks;
    pc_status status = pci_cut_outline(
        scratch, stage, visual, rims, options->carve ? PCI_OUTLINE_ALL : PCI_OUTLINE_MEMBRANES,
        options->carve_distance * job->cloth->cell_size, job->cloth->cell_size, layer,
        &report->carved_regions, &report->carved_triangles);
    pci_scratch_rewind(scratch, mark);
    if (status != PC_OK) {
        return status;
    }
    status = pci_drop_crumbs(scratch, stage, &job->cloth->mesh, visual, options->smallest_part,
                             loose_voxels * job->cloth->cell_size, layer, &report->dropped_parts);
    pci_scratch_rewind(scratch, mark);
    if (status != PC_OK) {
        return status;
    }
    if (layer->triangle_count == 0) {
        return no_proxy(scratch->context, "carve_distance is too small");
    }
    return pci_progress(scratch->context, stage, 0.8) ? PC_OK
                                                      : pci_fail_cancelled(scratch->context, stage);
}

// The projected mesh lies on the cloth but where the voxels bridge a gap. `share` receives such
// triangles' share of the layer's area.
static bool find_bridges(pci_scratch *scratch, pci_webbed *webbed, double *share) {
    if (!pci_find_away(scratch, webbed)) {
        return false;
    }
    const pc_mesh *layer = webbed->layer;
    double total = 0.0, sum = 0.0;
    for (size_t t = 0; t < layer->triangle_count; ++t) {
        const double area = pci_triangle_area(layer, t);
        total += area;
        sum += webbed->away[t] == PCI_BRIDGE ? area : 0.0;
    }
    *share = total > 0.0 ? sum / total : 0.0;
    return true;
}

// Unites the vertices on borders that all but meet, where seams are cracked or triangles loose.
static bool unite_cracks(pci_scratch *scratch, const pc_mesh *mesh, const pci_topology *edges,
                         double reach, uint32_t *parents, bool *some) {
    pci_knn knn;
    uint8_t *border = PCI_SCRATCH(scratch, uint8_t, mesh->vertex_count);
    uint32_t *vertices = PCI_SCRATCH(scratch, uint32_t, mesh->vertex_count);
    double *points = PCI_SCRATCH(scratch, double, 3 * mesh->vertex_count);
    size_t count = 0;
    if (scratch->failed) {
        return false;
    }
    pci_mark_border(edges, border);
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        if (border[v]) {
            memcpy(&points[3 * count], &mesh->positions[3 * v], 3 * sizeof(*points));
            vertices[count++] = (uint32_t)v;
        }
    }
    if (!pci_knn_build(scratch, count, points, &knn)) {
        return false;
    }
    for (size_t i = 0; i < count; ++i) {
        uint32_t near[most_joined];
        double squared[most_joined];
        const size_t found =
            pci_knn_query(&knn, &points[3 * i], most_joined, (uint32_t)i, near, squared);
        for (size_t k = 0; k < found && squared[k] <= reach * reach; ++k) {
            *some = pci_unite(parents, vertices[i], vertices[near[k]]) || *some;
        }
    }
    return true;
}

// The cloth with its cracks closed.
static bool close_cracks(pci_scratch *scratch, const pc_mesh *cloth, const pci_topology *edges,
                         double reach, pc_mesh *closed) {
    bool some = false;
    uint32_t *parents = PCI_SCRATCH(scratch, uint32_t, cloth->vertex_count);
    pc_mesh joined = *cloth;
    joined.triangles = PCI_SCRATCH(scratch, uint32_t, 3 * cloth->triangle_count);
    if (scratch->failed) {
        return false;
    }
    pci_singletons(parents, cloth->vertex_count);
    if (!unite_cracks(scratch, cloth, edges, reach, parents, &some)) {
        return false;
    }
    if (!some) {
        return pci_mesh_compact(scratch, cloth, NULL, closed, NULL);
    }
    for (size_t i = 0; i < 3 * cloth->triangle_count; ++i) {
        joined.triangles[i] = pci_find_root(parents, cloth->triangles[i]);
    }
    pci_repair_counts counts;
    return pci_mesh_repair(scratch, &joined, NULL, closed, &counts);
}

// Mends what webs it can, from the cloth or else the other side of the projected mesh: the layer
// keeps its shape.
static pc_status mend_bridges(const carve_job *job, pci_webbed *webbed) {
    pci_scratch *scratch = job->cloth->scratch;
    pc_mesh turned = {0};
    const uint8_t *kept = kept_triangles(job);
    const struct pci_scratch_block *mark = scratch->blocks;
    if (kept == NULL || !close_cracks(scratch, &job->cloth->mesh, &job->cloth->edges,
                                      crack_voxels * job->cloth->cell_size, &turned)) {
        return pci_fail_memory(scratch->context, stage);
    }
    pci_scratch_rewind(scratch, mark);
    pc_status status = pci_face_like(scratch, stage, webbed->layer, true, &turned);
    pci_scratch_rewind(scratch, mark);
    if (status == PC_OK) {
        status = pci_mend_webs(scratch, stage, &turned, NULL, cloth_rings, webbed);
    }
    pc_mesh_free(scratch->context, &turned);
    return status == PC_OK
               ? pci_mend_webs(scratch, stage, job->projected, kept, projected_rings, webbed)
               : status;
}

// @param cut  how far from the cloth; 0: nothing was cut
static pc_status snap(const carve_job *job, const pci_bvh *visual, double cut, pc_mesh *layer) {
    return job->options->snap_border
               ? pci_snap_border(job->cloth->scratch->context, stage, &job->cloth->mesh,
                                 &job->cloth->edges, visual, cut, job->cloth->cell_size, layer)
               : PC_OK;
}

// The labelled side of the projected mesh, cut along the outline. `labels` are those of the job,
// and then those of straps with them; NULL: straps are not looked for.
static pc_status labelled_layer(const carve_job *job, const pci_bvh *visual, uint8_t *labels,
                                pc_mesh *layer, pc_carve_report *report) {
    pci_scratch *scratch = job->cloth->scratch;
    pci_bvh *projected = NULL;
    report->source = PC_LAYER_LABELS;
    const struct pci_scratch_block *before = scratch->blocks;
    pc_status status = labels == NULL ? PC_OK
                                      : pci_keep_straps(scratch, stage, job->projected,
                                                        job->cloth->cell_size, labels, &projected);
    pci_scratch_rewind(scratch, before);
    const struct pci_scratch_block *mark = scratch->blocks;
    if (status == PC_OK) {
        status = extract(job, &projected, layer, report);
        pci_scratch_rewind(scratch, mark);
    }
    pci_bvh_destroy(scratch->context, projected);
    if (status == PC_OK) {
        bool peeled = false;
        status = pci_peel_linings(scratch, stage, NULL, both_sides_reach * job->cloth->cell_size,
                                  least_both_sides, layer, &peeled);
        pci_scratch_rewind(scratch, mark);
    }
    if (status == PC_OK) {
        status = snap(job, visual, 0.0, layer);
    }
    return status == PC_OK ? cut(job, visual, job->rims, layer, report) : status;
}

// The labelled triangles of the projected mesh; may be none.
static pc_status labelled_side(const carve_job *job, pc_mesh *side) {
    const uint8_t *keep = kept_triangles(job);
    return keep != NULL && pci_mesh_compact(job->cloth->scratch, job->projected, keep, side, NULL)
               ? PC_OK
               : pci_fail_memory(job->cloth->scratch->context, stage);
}

// Takes the visual mesh, emptied by this, as the layer, with the labelled side outside.
static pc_status take_visual(const carve_job *job, uint64_t filled, pc_mesh *visual, pc_mesh *layer,
                             pc_carve_report *report) {
    pc_context *context = job->cloth->scratch->context;
    pc_mesh side = {0};
    pc_mesh_free(context, layer);
    *layer = *visual;
    *visual = (pc_mesh){0};
    *report = (pc_carve_report){.source = PC_LAYER_VISUAL, .filled_loops = filled};
    if (layer->triangle_count == 0) {
        return no_proxy(context, "the visual mesh has none of use");
    }
    pc_status status = labelled_side(job, &side);
    if (status == PC_OK && side.triangle_count > 0) {
        status = pci_face_like(job->cloth->scratch, stage, &side, false, layer);
    }
    pc_mesh_free(context, &side);
    pci_shape shape;
    if (status == PC_OK) {
        status = find_shape(job->cloth->scratch, layer, &shape);
    }
    return status == PC_OK ? measure(job, layer, &shape, report) : status;
}

// Where the labelled layer bridges gaps, as between two legs, or is torn, the cloth made one sheet
// is taken if that has the shape that the labels say, or fewer parts.
static pc_status try_tailoring(const carve_job *job, const pci_shape *shape, pc_mesh *layer,
                               pc_carve_report *report, bool *taken) {
    pci_scratch *scratch = job->cloth->scratch;
    pc_mesh side = {0}, sewn = {0};
    pci_shape tailored = {0};
    pc_carve_report other = {.source = PC_LAYER_VISUAL};
    pc_status status = labelled_side(job, &side);
    if (status == PC_OK && side.triangle_count > 0) {
        status = pci_tailored_layer(job->cloth, &side, &sewn, &other.filled_loops);
    }
    pc_mesh_free(scratch->context, &side);
    if (status == PC_OK && sewn.triangle_count > 0) {
        status = find_shape(scratch, &sewn, &tailored);
    }
    const bool alike = same_openings(&tailored, shape);
    *taken = status == PC_OK && sewn.triangle_count > 0 &&
             (alike || tailored.components < shape->components);
    if (*taken) {
        status = measure(job, &sewn, &tailored, &other);
    }
    if (*taken && status == PC_OK) {
        pc_mesh_free(scratch->context, layer);
        *layer = sewn;
        *report = other;
    } else {
        pc_mesh_free(scratch->context, &sewn);
    }
    return status;
}

// Whether the cloth shall be made one sheet: the layer bridges gaps, or has more parts than the
// cloth, and that has so few that they may be worn over each other.
static bool shall_be_tailored(const carve_job *job, double share, size_t components) {
    const pc_mesh *cloth = &job->cloth->mesh;
    uint32_t *parents = PCI_SCRATCH(job->cloth->scratch, uint32_t, cloth->vertex_count);
    if (parents == NULL || job->options->layer_source != PC_LAYER_AUTO) {
        return false;
    }
    const size_t parts = pci_vertex_components(cloth, parents);
    return parts <= most_parts && (share > most_bridges || components > parts);
}

// Takes the side of the projected mesh that a part of the cloth tells, if that has its shape.
static pc_status try_sides(const carve_job *job, const pci_bvh *visual, const pc_mesh *bare,
                           const pci_shape *wanted, pc_mesh *layer, pc_carve_report *report) {
    pci_scratch *scratch = job->cloth->scratch;
    pc_mesh sided = {0};
    pci_shape shape = {0};
    pc_carve_report other = {0};
    carve_job amended = *job;
    uint8_t *labels = PCI_SCRATCH(scratch, uint8_t, job->projected->vertex_count);
    if (labels == NULL) {
        return pci_fail_memory(scratch->context, stage);
    }
    memcpy(labels, job->labels, job->projected->vertex_count);
    amended.labels = labels;
    pc_status status =
        pci_label_sides(scratch, stage, job->projected, bare, job->cloth->cell_size, labels);
    if (status == PC_OK) {
        status = labelled_layer(&amended, visual, NULL, &sided, &other);
    }
    if (status == PC_OK && other.carved_regions > 0) {
        status =
            snap(&amended, visual, job->options->carve_distance * job->cloth->cell_size, &sided);
    }
    if (status == PC_OK) {
        status = find_shape(scratch, &sided, &shape);
    }
    const bool alike = status == PC_OK && same_openings(&shape, wanted);
    if (alike) {
        status = measure(&amended, &sided, &shape, &other);
    }
    if (alike && status == PC_OK && other.coverage >= least_seen * report->coverage) {
        pc_mesh_free(scratch->context, layer);
        *layer = sided;
        *report = other;
    } else {
        pc_mesh_free(scratch->context, &sided);
    }
    return status == PC_ERROR_NO_PROXY ? PC_OK : status; // then the layer stays as it is
}

// Where the labels tear or close what the cloth, without what is put onto it, is not torn or closed
// at, the layer is that cloth, or the side that it tells.
static pc_status try_bare(const carve_job *job, const pci_bvh *visual, const pci_shape *shape,
                          pc_mesh *layer, pc_carve_report *report) {
    pc_mesh bare = {0};
    pci_shape other = {0};
    uint64_t filled = 0;
    bool covers = false;
    pc_status status = pci_bare_layer(job->cloth, &bare, &filled, &covers);
    if (status == PC_OK && bare.triangle_count > 0) {
        status = find_shape(job->cloth->scratch, &bare, &other);
    }
    if (status == PC_OK && bare.triangle_count > 0 && !same_openings(&other, shape)) {
        status = covers ? take_visual(job, filled, &bare, layer, report)
                        : try_sides(job, visual, &bare, &other, layer, report);
    }
    pc_mesh_free(job->cloth->scratch->context, &bare);
    return status;
}

// Where the layer leaves out much, as the labels do of what hangs below a skirt's outermost layer,
// the sheet of the cloth that leaves out less is the layer; or one of several of another shape, if
// that leaves out little more.
static pc_status try_sheet(const carve_job *job, pc_mesh *layer, pc_carve_report *report) {
    pci_scratch *scratch = job->cloth->scratch;
    const double cell_size = job->cloth->cell_size;
    pc_mesh sheet = {0};
    pci_shape shape = {0}, other = {0};
    uint64_t filled = 0;
    double alone = 0.0, distance = 0.0;
    pc_status status = PC_OK;
    if (job->options->layer_source != PC_LAYER_AUTO) {
        return status;
    }
    if (report->coverage < 1.0) {
        status = pci_farthest(job->cloth, layer, &alone);
    }
    const double among = fmin(most_left_out * fmax(alone, left_out_voxels * cell_size),
                              most_stray_voxels * cell_size);
    if (status == PC_OK) {
        status = find_shape(scratch, layer, &shape);
    }
    if (status == PC_OK) {
        status = pci_nearest_sheet(job->cloth, &shape, alone, among, &distance, &sheet, &filled);
    }
    if (status == PC_OK && sheet.triangle_count > 0) {
        status = find_shape(scratch, &sheet, &other);
    }
    if (status == PC_OK && sheet.triangle_count > 0 &&
        (distance < alone || !pci_same_topology(&other, &shape))) {
        status = take_visual(job, filled, &sheet, layer, report);
    }
    pc_mesh_free(scratch->context, &sheet);
    return status;
}

// What stands in for the labelled layer where it bridges gaps: the cloth made one sheet, or itself
// with the gaps' walls. @param shape  of the layer
static pc_status bridge_gaps(const carve_job *job, const pci_bvh *visual, pci_shape *shape,
                             pc_mesh *layer, pc_carve_report *report) {
    pci_scratch *scratch = job->cloth->scratch;
    pci_webbed webbed = {
        .cloth = visual, .cell_size = job->cloth->cell_size, .layer = layer, .shape = shape};
    double share = 0.0;
    bool taken = false;
    pc_status status =
        find_bridges(scratch, &webbed, &share) ? PC_OK : pci_fail_memory(scratch->context, stage);
    if (status == PC_OK && shall_be_tailored(job, share, shape->components)) {
        status = try_tailoring(job, shape, layer, report, &taken);
    }
    if (status == PC_OK && !taken && share > 0.0) {
        status = mend_bridges(job, &webbed);
    }
    if (status == PC_OK && !taken) {
        status = measure(job, layer, shape, report);
    }
    if (status == PC_OK && !taken && job->options->layer_source == PC_LAYER_AUTO) {
        status = try_bare(job, visual, shape, layer, report);
    }
    return status == PC_OK ? try_sheet(job, layer, report) : status;
}

// The labelled layer, unless another one is better. Shapes are compared before anything is done
// that keeps them. @param folded  the cloth as it is, if it is a folded sheet; may become the layer
static pc_status labelled_or_other(const carve_job *job, uint64_t filled, pc_mesh *folded,
                                   pc_mesh *layer, pc_carve_report *report) {
    pci_scratch *scratch = job->cloth->scratch;
    pci_bvh *visual = NULL;
    pci_shape shape = {0}, other = {0};
    bool better = false;
    const size_t count = job->projected->vertex_count;
    uint8_t *labels = PCI_SCRATCH(scratch, uint8_t, count);
    if (labels == NULL) {
        return pci_fail_memory(scratch->context, stage);
    }
    memcpy(labels, job->labels, count);
    carve_job amended = *job;
    pci_rims rims = {0};
    amended.labels = labels;
    amended.rims = &rims;
    pc_status status = pci_bvh_create(scratch->context, stage, &job->cloth->mesh, &visual);
    if (status == PC_OK) {
        status = pci_find_rims(scratch, stage, visual, &job->cloth->mesh, &job->cloth->edges,
                               rim_radius * job->cloth->cell_size,
                               rim_spacing * job->cloth->cell_size, &rims);
    }
    if (status == PC_OK) {
        status = labelled_layer(&amended, visual, labels, layer, report);
    }
    if (status == PC_OK && folded->triangle_count > 0) {
        status = find_shape(scratch, layer, &shape);
        status = status == PC_OK ? find_shape(scratch, folded, &other) : status;
        better = status == PC_OK && !same_openings(&other, &shape);
    }
    if (status == PC_OK && !better && report->carved_regions > 0) {
        // The cut was made beside the hems.
        status = snap(&amended, visual, amended.options->carve_distance * amended.cloth->cell_size,
                      layer);
    }
    if (status == PC_OK && !better) {
        status = find_shape(scratch, layer, &shape);
    }
    if (status == PC_OK && !better) {
        status = bridge_gaps(&amended, visual, &shape, layer, report);
        better = status == PC_OK && folded->triangle_count > 0 &&
                 report->source == PC_LAYER_LABELS && report->coverage < least_coverage;
    }
    pci_bvh_destroy(scratch->context, visual);
    return status == PC_OK && better ? take_visual(&amended, filled, folded, layer, report)
                                     : status;
}

static pc_status choose_layer(const carve_job *job, pc_mesh *layer, pc_carve_report *report) {
    pci_scratch *scratch = job->cloth->scratch;
    const uint32_t source = job->options->layer_source;
    const bool always = source == PC_LAYER_VISUAL;
    pci_layering layering = PCI_LAYERED;
    uint64_t filled = 0;
    pc_mesh visual = {0};
    pc_status status = PC_OK;
    if (source != PC_LAYER_LABELS) {
        status = pci_visual_layer(job->cloth, always, &visual, &layering, &filled);
    }
    if (status == PC_OK && !pci_progress(scratch->context, stage, 0.2)) {
        status = pci_fail_cancelled(scratch->context, stage);
    }
    if (status == PC_OK) {
        status = always || layering == PCI_PLAIN
                     ? take_visual(job, filled, &visual, layer, report)
                     : labelled_or_other(job, filled, &visual, layer, report);
    }
    pc_mesh_free(scratch->context, &visual);
    return status;
}

pc_status pc_carve(pc_context *context, const pc_mesh *surface, const pc_mesh *projected,
                   const pc_labels *labels, double cell_size, const pc_carve_options *options,
                   pc_mesh *single_layer, pc_carve_report *report) {
    pc_status status =
        check_arguments(context, surface, projected, labels, cell_size, single_layer);
    if (status != PC_OK) {
        return status;
    }
    pc_carve_options chosen;
    status = pci_begin_stage(context, stage, &pc_carve_options_record, options, &chosen);
    if (status != PC_OK) {
        return status;
    }
    pci_scratch scratch = pci_scratch_begin(context);
    pc_carve_report counts = {0};
    pc_mesh layer = {0};
    pci_cloth cloth = {
        .scratch = &scratch, .stage = stage, .surface = surface, .cell_size = cell_size};
    const carve_job job = {
        .cloth = &cloth, .projected = projected, .labels = labels->labels, .options = &chosen};
    status = pci_visual_cloth(&cloth);
    if (status == PC_OK && cloth.mesh.triangle_count == 0) {
        status = no_proxy(context, "the visual mesh has none of use");
    }
    if (status == PC_OK) {
        status = choose_layer(&job, &layer, &counts);
    }
    pc_mesh_free(context, &cloth.mesh);
    pci_scratch_end(&scratch);
    if (status != PC_OK) {
        pc_mesh_free(context, &layer);
        return status;
    }
    *single_layer = layer;
    if (report != NULL) {
        *report = counts;
    }
    return PC_OK;
}
