#include "proxycloth/carve.h"

#include "core/core.h"
#include "geometry/bvh.h"
#include "geometry/manifold.h"
#include "geometry/rim.h"
#include "geometry/topology.h"
#include "stages/carve/border.h"
#include "stages/carve/crumbs.h"
#include "stages/carve/dents.h"
#include "stages/carve/lining.h"
#include "stages/carve/loops.h"
#include "stages/carve/outline.h"
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
// What the visual mesh covers is within this many voxels of the layer.
static const double covered_voxels = 2.0;
// So much of a layer's area may bridge gaps.
static const double most_bridges = 0.005;
// What is taken instead may have so many times the boundary: a front that opens has more.
static const double most_boundary = 1.5;
// An outfit has a few parts that are worn over each other; patterns have more panels.
static const size_t most_parts = 6;
// Small parts farther than this from the others are loose parts of the garment, not crumbs.
static const double loose_voxels = 2.0;
// Radius of the ball that tells rims from surfaces, in voxels: narrower than openings of note.
static const double rim_radius = 0.5;
static const double rim_spacing = 0.25; // in voxels
// Labels that change sides along a sheet, as where another layer hides half of it, keep both sides
// of the rest, within so many voxels of each other; less than this share of the area is noise at
// hems.
static const double both_sides_reach = 0.5, least_both_sides = 0.1;
// Pieces of parallel loops.
enum { grain = 256 };

// ---- report -----------------------------------------------------------------------------------

// Whether the layer is within reach of a vertex. Where one of its vertices is, nobody needs a tree
// of its triangles, nor where none is within so much more that no point between them can be.
enum { UNSURE, COVERED, MISSED };
typedef struct coverage_job {
    const pci_knn *points; // of the layer
    const pci_bvh *layer;  // for those that are unsure
    const pc_mesh *surface;
    double reach, between; // from any point of the layer to the nearest vertex
    uint8_t *covered;      // #V
} coverage_job;

static void compare_points(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const coverage_job *job = user;
    uint32_t last = PC_INVALID_INDEX, far = PC_INVALID_INDEX;
    for (size_t v = begin; v < end; ++v) {
        const double *point = &job->surface->positions[3 * v];
        job->covered[v] = pci_knn_within_near(job->points, point, job->reach, &last) ? COVERED
                          : pci_knn_within_near(job->points, point, job->reach + job->between, &far)
                              ? UNSURE
                              : MISSED;
    }
}

static void compare_triangles(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const coverage_job *job = user;
    uint32_t last = PC_INVALID_INDEX;
    for (size_t v = begin; v < end; ++v) {
        if (job->covered[v] == UNSURE) {
            const double *point = &job->surface->positions[3 * v];
            job->covered[v] =
                pci_bvh_within_near(job->layer, point, job->reach, &last) ? COVERED : MISSED;
        }
    }
}

// No point of a triangle is farther than this from its nearest corner, of all triangles.
static double farthest_from_corners(const pc_mesh *mesh) {
    double square = 0.0;
    for (size_t i = 0; i < 3 * mesh->triangle_count; ++i) {
        const size_t next = i % 3 == 2 ? i - 2 : i + 1;
        square =
            fmax(square, pci_squared_distance(&mesh->positions[3 * (size_t)mesh->triangles[i]],
                                              &mesh->positions[3 * (size_t)mesh->triangles[next]]));
    }
    return (1.0 + 1e-9) * sqrt(square / 3.0); // of an equilateral one
}

// Counts, and the length of the boundary.
static pc_status measure_shape(pci_scratch *scratch, const pc_mesh *mesh, pc_carve_report *report,
                               double *boundary) {
    pci_shape shape;
    if (!pci_find_shape(scratch, mesh, &shape)) {
        return pci_fail_memory(scratch->context, stage);
    }
    report->vertices = mesh->vertex_count;
    report->triangles = mesh->triangle_count;
    report->boundary_loops = shape.boundary_loops;
    report->components = shape.components;
    *boundary = shape.boundary_length;
    return PC_OK;
}

static pc_status measure_coverage(pci_scratch *scratch, const pc_mesh *surface, const pc_mesh *mesh,
                                  double cell_size, double *coverage) {
    pc_context *context = scratch->context;
    pci_knn points;
    pci_bvh *layer = NULL;
    pc_status status = PC_OK;
    coverage_job job = {.points = &points,
                        .surface = surface,
                        .reach = covered_voxels * cell_size,
                        .between = farthest_from_corners(mesh),
                        .covered = PCI_SCRATCH(scratch, uint8_t, surface->vertex_count)};
    if (scratch->failed || !pci_knn_build(scratch, mesh->vertex_count, mesh->positions, &points)) {
        return pci_fail_memory(context, stage);
    }
    pci_parallel_for(context, surface->vertex_count, grain, compare_points, &job);
    if (memchr(job.covered, UNSURE, surface->vertex_count) != NULL) {
        status = pci_bvh_create(context, stage, mesh, &layer);
        job.layer = layer;
    }
    if (status == PC_OK && layer != NULL) {
        pci_parallel_for(context, surface->vertex_count, grain, compare_triangles, &job);
    }
    pci_bvh_destroy(context, layer);
    size_t sum = 0;
    for (size_t v = 0; v < surface->vertex_count; ++v) {
        sum += job.covered[v] == COVERED;
    }
    *coverage = (double)sum / (double)surface->vertex_count;
    return status;
}

static pc_status measure(pci_scratch *scratch, const pc_mesh *surface, const pc_mesh *mesh,
                         double cell_size, pc_carve_report *report, double *boundary) {
    const pc_status status = measure_shape(scratch, mesh, report, boundary);
    return status == PC_OK ? measure_coverage(scratch, surface, mesh, cell_size, &report->coverage)
                           : status;
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
static uint8_t *kept_triangles(pci_scratch *scratch, const pc_mesh *projected,
                               const uint8_t *labels) {
    uint8_t *keep = PCI_SCRATCH(scratch, uint8_t, projected->triangle_count);
    for (size_t t = 0; keep != NULL && t < projected->triangle_count; ++t) {
        const uint32_t *corner = &projected->triangles[3 * t];
        keep[t] =
            (labels[corner[0]] != 0) + (labels[corner[1]] != 0) + (labels[corner[2]] != 0) >= 2;
    }
    return keep;
}

// The triangles whose labels say so, as a manifold without small parts and short holes.
static pc_status extract(pci_scratch *scratch, const pc_mesh *cloth, const pci_bvh *visual,
                         const pci_knn *rims, const pc_mesh *projected, const uint8_t *labels,
                         double cell_size, const pc_carve_options *options, pc_mesh *layer,
                         pc_carve_report *report) {
    pc_context *context = scratch->context;
    uint8_t *keep = kept_triangles(scratch, projected, labels);
    if (keep == NULL || !pci_keep_dents(scratch, projected, rims, cell_size, keep)) {
        return pci_fail_memory(context, stage);
    }
    pci_repair_counts counts;
    if (!pci_mesh_repair(scratch, projected, keep, layer, &counts)) {
        return pci_fail_memory(context, stage);
    }
    const pc_status status =
        pci_drop_crumbs(scratch, stage, cloth, visual, options->smallest_part,
                        loose_voxels * cell_size, layer, &report->dropped_parts);
    if (status != PC_OK) {
        return status;
    }
    if (layer->triangle_count == 0) {
        return no_proxy(context, "the labels keep none");
    }
    if (!pci_progress(context, stage, 0.3)) {
        return pci_fail_cancelled(context, stage);
    }
    return pci_fill_loops(scratch, layer, options->fill_loops, INFINITY, &report->filled_loops)
               ? PC_OK
               : pci_fail_memory(context, stage);
}

static pc_status find_rims(pci_scratch *scratch, const pc_mesh *cloth, const pci_bvh *visual,
                           double cell_size, pci_knn *rims) {
    size_t count = 0;
    double *points = NULL;
    const pc_status status = pci_rim_points(scratch, stage, visual, cloth, rim_radius * cell_size,
                                            rim_spacing * cell_size, &count, &points);
    if (status != PC_OK) {
        return status;
    }
    return pci_knn_build(scratch, count, points, rims) ? PC_OK
                                                       : pci_fail_memory(scratch->context, stage);
}

static pc_status cut(pci_scratch *scratch, const pc_mesh *cloth, const pci_bvh *visual,
                     const pci_knn *rims, double cell_size, const pc_carve_options *options,
                     pc_mesh *layer, pc_carve_report *report) {
    pc_status status = pci_cut_outline(scratch, stage, visual, rims,
                                       options->carve ? PCI_OUTLINE_ALL : PCI_OUTLINE_MEMBRANES,
                                       options->carve_distance * cell_size, cell_size, layer,
                                       &report->carved_regions, &report->carved_triangles);
    if (status != PC_OK) {
        return status;
    }
    status = pci_drop_crumbs(scratch, stage, cloth, visual, options->smallest_part,
                             loose_voxels * cell_size, layer, &report->dropped_parts);
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
static bool find_bridges(pci_scratch *scratch, const pci_bvh *cloth, const pc_mesh *layer,
                         double cell_size, uint8_t **away, double *share) {
    *away = PCI_SCRATCH(scratch, uint8_t, layer->triangle_count);
    if (*away == NULL || !pci_find_away(scratch->context, cloth, layer, cell_size, *away)) {
        return false;
    }
    double total = 0.0, sum = 0.0;
    for (size_t t = 0; t < layer->triangle_count; ++t) {
        const double area = pci_triangle_area(layer, t);
        total += area;
        sum += (*away)[t] == PCI_BRIDGE ? area : 0.0;
    }
    *share = total > 0.0 ? sum / total : 0.0;
    return true;
}

// Mends what webs it can: the layer keeps its shape.
static pc_status mend_bridges(pci_scratch *scratch, const pci_bvh *cloth, const pc_mesh *projected,
                              const uint8_t *labels, double cell_size, uint8_t *away,
                              pc_mesh *layer) {
    const uint8_t *kept = kept_triangles(scratch, projected, labels);
    if (kept == NULL) {
        return pci_fail_memory(scratch->context, stage);
    }
    bool mended = false;
    double left = 0.0;
    pc_status status =
        pci_mend_webs(scratch, stage, projected, kept, away, cell_size, true, layer, &mended);
    if (status == PC_OK && mended) {
        status = find_bridges(scratch, cloth, layer, cell_size, &away, &left)
                     ? PC_OK
                     : pci_fail_memory(scratch->context, stage);
    }
    if (status == PC_OK && left > 0.0) {
        status =
            pci_mend_webs(scratch, stage, projected, kept, away, cell_size, false, layer, &mended);
    }
    return status;
}

// The labelled side of the projected mesh, cut along the outline. @param visual  tree of `cloth`
static pc_status labelled_layer(pci_scratch *scratch, const pc_mesh *cloth, const pci_bvh *visual,
                                const pc_mesh *projected, const uint8_t *labels, double cell_size,
                                const pc_carve_options *options, pc_mesh *layer,
                                pc_carve_report *report) {
    pci_knn rims = {0};
    report->source = PC_LAYER_LABELS;
    pc_status status = find_rims(scratch, cloth, visual, cell_size, &rims);
    if (status == PC_OK) {
        status = extract(scratch, cloth, visual, &rims, projected, labels, cell_size, options,
                         layer, report);
    }
    if (status == PC_OK) {
        bool peeled = false;
        status = pci_peel_linings(scratch, stage, NULL, both_sides_reach * cell_size,
                                  least_both_sides, layer, &peeled);
    }
    if (status == PC_OK && options->snap_border) {
        status = pci_snap_border(scratch->context, stage, cloth, visual, cell_size, layer);
    }
    return status == PC_OK ? cut(scratch, cloth, visual, &rims, cell_size, options, layer, report)
                           : status;
}

// The labelled triangles of the projected mesh; may be none.
static pc_status labelled_side(pci_scratch *scratch, const pc_mesh *projected,
                               const uint8_t *labels, pc_mesh *side) {
    const uint8_t *keep = kept_triangles(scratch, projected, labels);
    return keep != NULL && pci_mesh_compact(scratch, projected, keep, side, NULL)
               ? PC_OK
               : pci_fail_memory(scratch->context, stage);
}

// Takes the visual mesh as the layer, with the labelled side outside.
static pc_status take_visual(pci_scratch *scratch, const pc_mesh *surface, const pc_mesh *projected,
                             const uint8_t *labels, double cell_size, uint64_t filled,
                             pc_mesh *visual, pc_mesh *layer, pc_carve_report *report) {
    pc_context *context = scratch->context;
    pc_mesh side = {0};
    double boundary = 0.0;
    pc_mesh_free(context, layer);
    *layer = *visual;
    *visual = (pc_mesh){0};
    *report = (pc_carve_report){.source = PC_LAYER_VISUAL, .filled_loops = filled};
    if (layer->triangle_count == 0) {
        return no_proxy(context, "the visual mesh has none of use");
    }
    pc_status status = labelled_side(scratch, projected, labels, &side);
    if (status == PC_OK && side.triangle_count > 0) {
        status = pci_face_like(scratch, stage, &side, layer);
    }
    pc_mesh_free(context, &side);
    return status == PC_OK ? measure(scratch, surface, layer, cell_size, report, &boundary)
                           : status;
}

// Where the labelled layer bridges gaps, as between two legs, the cloth made one sheet is taken if
// that has the shape that the labels say, and no front is open that they closed.
static pc_status try_tailoring(pci_scratch *scratch, const pc_mesh *surface, const pc_mesh *cloth,
                               double thickness, const pc_mesh *projected, const uint8_t *labels,
                               double cell_size, double boundary, pc_mesh *layer,
                               pc_carve_report *report, bool *taken) {
    pc_mesh side = {0}, sewn = {0};
    pc_carve_report other = {.source = PC_LAYER_VISUAL};
    pc_status status = labelled_side(scratch, projected, labels, &side);
    if (status == PC_OK && side.triangle_count > 0) {
        status = pci_tailored_layer(scratch, stage, surface, cloth, &side, thickness, cell_size,
                                    &sewn, &other.filled_loops);
    }
    pc_mesh_free(scratch->context, &side);
    double length = 0.0;
    if (status == PC_OK && sewn.triangle_count > 0) {
        status = measure_shape(scratch, &sewn, &other, &length);
    }
    *taken = status == PC_OK && other.components == report->components &&
             other.boundary_loops == report->boundary_loops && length <= most_boundary * boundary;
    if (*taken) {
        status = measure_coverage(scratch, surface, &sewn, cell_size, &other.coverage);
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

// Whether there are so few parts that they may be one sheet, worn over each other.
static bool may_be_tailored(pci_scratch *scratch, const pc_mesh *cloth,
                            const pc_carve_options *options) {
    uint32_t *parents = PCI_SCRATCH(scratch, uint32_t, cloth->vertex_count);
    if (parents == NULL || options->layer_source != PC_LAYER_AUTO) {
        return false;
    }
    const size_t parts = pci_vertex_components(cloth, parents);
    return parts <= most_parts;
}

// What stands in for the labelled layer where it bridges gaps: the cloth made one sheet, or itself
// with the gaps' walls.
static pc_status bridge_gaps(pci_scratch *scratch, const pc_mesh *surface, const pc_mesh *cloth,
                             const pci_bvh *visual, double thickness, const pc_mesh *projected,
                             const uint8_t *labels, double cell_size, double boundary,
                             const pc_carve_options *options, pc_mesh *layer,
                             pc_carve_report *report) {
    uint8_t *away = NULL;
    double share = 0.0;
    bool taken = false;
    pc_status status = find_bridges(scratch, visual, layer, cell_size, &away, &share)
                           ? PC_OK
                           : pci_fail_memory(scratch->context, stage);
    if (status == PC_OK && share > most_bridges && may_be_tailored(scratch, cloth, options)) {
        status = try_tailoring(scratch, surface, cloth, thickness, projected, labels, cell_size,
                               boundary, layer, report, &taken);
    }
    if (status != PC_OK || taken) {
        return status;
    }
    if (share > 0.0) {
        status = mend_bridges(scratch, visual, projected, labels, cell_size, away, layer);
    }
    return status == PC_OK ? measure(scratch, surface, layer, cell_size, report, &boundary)
                           : status;
}

// The labelled layer, unless another one is better. Shapes are compared before anything is done
// that keeps them. @param folded  the cloth as it is, if it is a folded sheet; may become the layer
static pc_status labelled_or_other(pci_scratch *scratch, const pc_mesh *surface,
                                   const pc_mesh *cloth, double thickness, const pc_mesh *projected,
                                   const uint8_t *labels, double cell_size,
                                   const pc_carve_options *options, uint64_t filled,
                                   pc_mesh *folded, pc_mesh *layer, pc_carve_report *report) {
    pci_bvh *visual = NULL;
    pc_carve_report other = {0};
    double boundary = 0.0, length = 0.0;
    bool better = false;
    pc_status status = pci_bvh_create(scratch->context, stage, cloth, &visual);
    if (status == PC_OK) {
        status = labelled_layer(scratch, cloth, visual, projected, labels, cell_size, options,
                                layer, report);
    }
    if (status == PC_OK) {
        status = measure_shape(scratch, layer, report, &boundary);
    }
    if (status == PC_OK && folded->triangle_count > 0) {
        status = measure_shape(scratch, folded, &other, &length);
        better = status == PC_OK && (other.components != report->components ||
                                     other.boundary_loops != report->boundary_loops);
    }
    if (status == PC_OK && !better) {
        status = bridge_gaps(scratch, surface, cloth, visual, thickness, projected, labels,
                             cell_size, boundary, options, layer, report);
        better = status == PC_OK && folded->triangle_count > 0 &&
                 report->source == PC_LAYER_LABELS && report->coverage < least_coverage;
    }
    pci_bvh_destroy(scratch->context, visual);
    return status == PC_OK && better ? take_visual(scratch, surface, projected, labels, cell_size,
                                                   filled, folded, layer, report)
                                     : status;
}

static pc_status choose_layer(pci_scratch *scratch, const pc_mesh *surface, const pc_mesh *cloth,
                              double thickness, const pc_mesh *projected, const uint8_t *labels,
                              double cell_size, const pc_carve_options *options, pc_mesh *layer,
                              pc_carve_report *report) {
    const bool always = options->layer_source == PC_LAYER_VISUAL;
    pci_layering layering = PCI_LAYERED;
    uint64_t filled = 0;
    pc_mesh visual = {0};
    pc_status status = PC_OK;
    if (options->layer_source != PC_LAYER_LABELS) {
        status = pci_visual_layer(scratch, stage, surface, cloth, thickness, cell_size, always,
                                  &visual, &layering, &filled);
    }
    if (status == PC_OK && !pci_progress(scratch->context, stage, 0.2)) {
        status = pci_fail_cancelled(scratch->context, stage);
    }
    if (status == PC_OK && (always || layering == PCI_PLAIN)) {
        return take_visual(scratch, surface, projected, labels, cell_size, filled, &visual, layer,
                           report);
    }
    if (status == PC_OK) {
        status = labelled_or_other(scratch, surface, cloth, thickness, projected, labels, cell_size,
                                   options, filled, &visual, layer, report);
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
    pc_mesh cloth = {0}, layer = {0};
    double thickness = 0.0;
    status = pci_visual_cloth(&scratch, stage, surface, cell_size, &cloth, &thickness);
    if (status == PC_OK && cloth.triangle_count == 0) {
        status = no_proxy(context, "the visual mesh has none of use");
    }
    if (status == PC_OK) {
        status = choose_layer(&scratch, surface, &cloth, thickness, projected, labels->labels,
                              cell_size, &chosen, &layer, &counts);
    }
    pc_mesh_free(context, &cloth);
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
