#include "proxycloth/simplify.h"

#include <stdlib.h>

#include "core/core.h"
#include "geometry/bvh.h"
#include "geometry/crossing.h"
#include "geometry/halfedge.h"
#include "geometry/manifold.h"
#include "geometry/notches.h"
#include "geometry/topology.h"
#include "stages/simplify/clustering.h"
#include "stages/simplify/contraction.h"
#include "stages/simplify/fit.h"
#include "stages/simplify/improve.h"
#include "stages/simplify/joint.h"
#include "stages/simplify/mirror.h"
#include "stages/simplify/rings.h"
#include "stages/simplify/sampling.h"
#include "stages/simplify/separate.h"
#include "stages/simplify/sizing.h"
#include "stages/simplify/untangle.h"

static const char stage[] = "simplify";

static const char *const shortfall_choices[] = {"none", "topology", "budget", NULL};
static const char *const method_choices[] = {"clusters", "joint", NULL};
static const char *const channel_choices[] = {"none", "red", "green", "blue", "alpha", NULL};
static const pc_field option_fields[] = {
    PCI_FIELD_OPTION(pc_simplify_options, vertices, UINT, 128, 4, 65536, "",
                     "N_p: vertices of the proxy mesh"),
    PCI_FIELD_CHOICE(pc_simplify_options, method, PC_SIMPLIFY_CLUSTERS, PC_SIMPLIFY_JOINT,
                     method_choices,
                     "How: clusters, or edge collapses with weights in the loop (joint, the "
                     "paper's comparison in section 5.2)"),
    PCI_FIELD_OPTION(pc_simplify_options, narrow_refinement, DOUBLE, 1.5, 1.0, 4.0, "",
                     "Edges around narrow or strongly curved parts are up to this factor shorter; "
                     "1: uniform"),
    PCI_FIELD_CHOICE(
        pc_simplify_options, density_channel, PC_DENSITY_NONE, PC_DENSITY_ALPHA, channel_choices,
        "Channel of the visual mesh's vertex colors that tells where edges are shorter"),
    PCI_FIELD_OPTION(pc_simplify_options, density_range, DOUBLE, 4.0, 1.0, 16.0, "",
                     "Edges are up to this factor shorter where the density channel is 1 than "
                     "where it is 0"),
    PCI_FIELD_OPTION(pc_simplify_options, clustering_iterations, UINT, 100, 1, 10000, "",
                     "Passes of boundary exchanges between clusters"),
    PCI_FIELD_OPTION(pc_simplify_options, seed, UINT, 1, 0, 4294967295, "",
                     "Picks the vertex of the first cluster"),
    PCI_FIELD_OPTION(pc_simplify_options, mirror, BOOL, 0, 0, 1, "",
                     "Garments that are the same on both sides of a plane across an axis get a "
                     "proxy that is, too"),
};
const pc_record pc_simplify_options_record = PCI_RECORD(option_fields, pc_simplify_options);

static const pc_field report_fields[] = {
    PCI_FIELD_REPORT(pc_simplify_report, vertices, COUNT, "", "Vertices of the proxy mesh"),
    PCI_FIELD_REPORT(pc_simplify_report, triangles, COUNT, "", "Triangles of the proxy mesh"),
    PCI_FIELD_REPORT(pc_simplify_report, components, COUNT, "", "Connected parts"),
    PCI_FIELD_REPORT(pc_simplify_report, boundary_loops, COUNT, "", "Closed boundary curves"),
    PCI_FIELD_REPORT(pc_simplify_report, removed_triangles, COUNT, "",
                     "Triangles of the single layer removed by the manifold repair"),
    PCI_FIELD_REPORT(pc_simplify_report, split_vertices, COUNT, "",
                     "Vertices of the single layer added by the manifold repair"),
    PCI_FIELD_WARNING(pc_simplify_report, dropped_parts, COUNT,
                      "Parts too small for the vertex budget",
                      "parts of the garment are too small for the number of proxy vertices"),
    PCI_FIELD_REPORT(
        pc_simplify_report, surplus_vertices, COUNT, "",
        "Vertices that narrow parts needed on top of one per cluster; other edges were "
        "collapsed instead"),
    PCI_FIELD_WARNING(pc_simplify_report, density_ignored, BOOL,
                      "Whether a density channel was asked for that the visual mesh lacks",
                      "the visual mesh has no vertex colors: the density channel was ignored"),
    PCI_FIELD_WARNING(pc_simplify_report, self_intersections, COUNT,
                      "Pairs of triangles that cross and could not be moved apart",
                      "the proxy crosses itself"),
    PCI_FIELD_REPORT(pc_simplify_report, attempts, COUNT, "",
                     "Proxies that were made to find one without crossings and slivers"),
    PCI_FIELD_REPORT(pc_simplify_report, iterations, COUNT, "", "Passes of boundary exchanges"),
    {.name = "shortfall",
     .type = PC_FIELD_CHOICE,
     .offset = offsetof(pc_simplify_report, shortfall),
     .unit = "",
     .help = "Why the proxy has another number of vertices or parts than asked for",
     .choices = shortfall_choices},
    PCI_FIELD_REPORT(pc_simplify_report, mirrored, BOOL, "",
                     "Whether one half of the proxy is the mirror image of the other"),
};
const pc_record pc_simplify_report_record = PCI_RECORD(report_fields, pc_simplify_report);

// Passes of sliding and flipping; most meshes rest earlier.
static const size_t relax_passes = PCI_EFFORT(30, 2);
// At most one in so many clusters is that of a corner of the border.
static const size_t anchor_share = 4;
// Least quality of the triangles at a corner of the border.
static const double pinned_quality = 0.5;
// How far vertices may leave the surface for better angles, in expected edge lengths.
static const double reaches[] = {0.1, 0.2, 0.4};
// Passes of fitting.
static const size_t fit_passes = PCI_EFFORT(10, 2);
// Proxies that are made until one is without flaw; fewer where they have very many vertices.
static const size_t most_attempts = PCI_EFFORT(8, 1);
static const size_t vertices_of_attempts = 32768;
// A vertex of the single layer farther than this from the proxy, in expected edge lengths, may mean
// that two sides of a leg have fallen together; then other clusters come nearer. About so many
// vertices are asked.
static const double farthest_kept = 0.5;
static const size_t asked_vertices = 8192;

// ---- steps ------------------------------------------------------------------------------------

typedef struct part {
    double area;
    uint32_t index;
} part;

static int compare_parts(const void *a, const void *b) { // largest first
    const part *x = a, *y = b;
    if (x->area != y->area) {
        return x->area > y->area ? -1 : 1;
    }
    return (x->index > y->index) - (x->index < y->index);
}

// Keeps the parts that get at least one cluster each, no more than can have three vertices, and
// then the largest of the small ones, as long as they take at most a tenth of the vertices.
// Afterwards there are at most as many parts as clusters.
static bool drop_unaffordable(pci_scratch *scratch, pc_mesh *layer, size_t vertices,
                              uint64_t *dropped) {
    pci_topology topology;
    uint32_t *component = PCI_SCRATCH(scratch, uint32_t, layer->triangle_count);
    if (component == NULL || !pci_topology_build_edges(scratch, layer, &topology)) {
        return false;
    }
    const size_t count = pci_triangle_components(scratch, layer, &topology, component);
    if (!pci_keep_going(scratch->context)) {
        return false;
    }
    part *parts = PCI_SCRATCH(scratch, part, count);
    uint8_t *drop = PCI_SCRATCH(scratch, uint8_t, count);
    uint8_t *keep = PCI_SCRATCH(scratch, uint8_t, layer->triangle_count);
    if (scratch->failed) {
        return false;
    }
    for (uint32_t i = 0; i < count; ++i) {
        parts[i].index = i;
    }
    for (size_t t = 0; t < layer->triangle_count; ++t) {
        parts[component[t]].area += pci_triangle_area(layer, t);
    }
    qsort(parts, count, sizeof(*parts), compare_parts);
    size_t kept = 1, small = 0;
    double total = parts[0].area;
    while (kept < count && 3 * (kept + 1) <= vertices) {
        small += parts[kept].area * (double)vertices < total + parts[kept].area;
        if (3 * small > vertices / 10) {
            break;
        }
        total += parts[kept++].area;
    }
    for (size_t i = kept; i < count; ++i) {
        drop[parts[i].index] = 1;
    }
    *dropped = count - kept;
    if (*dropped == 0) {
        return true;
    }
    for (size_t t = 0; t < layer->triangle_count; ++t) {
        keep[t] = !drop[component[t]];
    }
    pc_mesh rest = {0};
    if (!pci_mesh_compact(scratch, layer, keep, &rest, NULL)) {
        return false;
    }
    pc_mesh_free(scratch->context, layer);
    *layer = rest;
    return true;
}

static bool cluster(pci_scratch *scratch, const pci_sampling *s, const pc_simplify_options *options,
                    uint64_t attempt, pci_clustering *c, uint64_t *iterations) {
    const double share = pci_random(options->seed, 0, attempt);
    return pci_cluster_vertices(scratch->context, s, s->clusters,
                                (uint32_t)(share * (double)s->mesh.vertex_count),
                                options->clustering_iterations, c, iterations);
}

// The sharpest corners get clusters of their own, else one cluster may hold two of them, as both
// sides of a slit. Those of rings stay with them.
static bool choose_anchors(pci_scratch *scratch, const pci_sampling *s, pci_clustering *c) {
    const size_t most = (s->clusters - c->rings.count) / anchor_share;
    c->anchors = PCI_SCRATCH(scratch, uint32_t, s->corner_count);
    if (c->anchors == NULL) {
        return false;
    }
    for (size_t i = 0; i < s->corner_count && c->anchor_count < most; ++i) {
        if (c->rings.count == 0 || c->rings.cluster[s->corners[i]] == PC_INVALID_INDEX) {
            c->anchors[c->anchor_count++] = s->corners[i];
        }
    }
    return true;
}

// Clusters uniformly, for smaller clusters where these are too wide or the density map asks for
// them.
static bool size_samples(pci_scratch *scratch, pci_sampling *s,
                         const pc_simplify_options *options) {
    pci_clustering c = {.cluster = PCI_SCRATCH(scratch, uint32_t, s->mesh.vertex_count)};
    uint64_t iterations = 0;
    if (options->narrow_refinement == 1.0 && s->densities == NULL) {
        return true;
    }
    if (c.cluster == NULL || !cluster(scratch, s, options, 0, &c, &iterations) ||
        !pci_size_clusters(scratch, c.cluster, s->clusters, options->narrow_refinement, s)) {
        return false;
    }
    pci_sampling_weigh(s);
    return true;
}

// Clusters with rings around thin tubes and anchors at corners. Each attempt begins elsewhere.
static bool cluster_samples(pci_scratch *scratch, const pci_sampling *s,
                            const pc_simplify_options *options, uint64_t attempt, pci_clustering *c,
                            uint64_t *iterations) {
    *c = (pci_clustering){.cluster = PCI_SCRATCH(scratch, uint32_t, s->mesh.vertex_count)};
    if (c->cluster == NULL) {
        return false;
    }
    if (options->narrow_refinement > 1.0 &&
        !pci_find_rings(scratch, s, s->vertices, attempt, &c->rings)) {
        return false;
    }
    return choose_anchors(scratch, s, c) && cluster(scratch, s, options, attempt, c, iterations);
}

// Marks the vertices in clusters of rings and corners.
static bool bind_clusters(pci_scratch *scratch, const pci_clustering *c, size_t vertices,
                          uint32_t clusters, uint8_t **bound) {
    uint8_t *anchored = PCI_SCRATCH(scratch, uint8_t, clusters);
    *bound = PCI_SCRATCH(scratch, uint8_t, vertices);
    if (scratch->failed) {
        return false;
    }
    for (size_t i = 0; i < c->anchor_count; ++i) {
        anchored[c->cluster[c->anchors[i]]] = 1;
    }
    for (size_t v = 0; v < vertices; ++v) {
        (*bound)[v] = anchored[c->cluster[v]] ||
                      (c->rings.count > 0 && c->rings.cluster[v] != PC_INVALID_INDEX);
    }
    return true;
}

// Puts the nearest border vertex on each corner of the border, once.
static void pin_corners(const pci_sampling *s, const uint32_t *nearby, pci_relaxation *r) {
    for (size_t corner = 0; corner < s->corner_count; ++corner) {
        // The vertex that the corner was merged into, or one of its neighbours on the border.
        const double *point = &s->mesh.positions[3 * (size_t)s->corners[corner]];
        const uint32_t own = nearby[s->corners[corner]];
        const uint32_t candidates[3] = {own, pci_target(r->coarse, r->coarse->outgoing[own]),
                                        pci_origin(r->coarse, pci_border_incoming(r->coarse, own))};
        uint32_t best = PC_INVALID_INDEX;
        double nearest = INFINITY;
        for (size_t i = 0; i < 3; ++i) {
            const double distance =
                pci_squared_distance(point, &r->coarse->positions[3 * (size_t)candidates[i]]);
            if (!r->pinned[candidates[i]] && distance < nearest) {
                nearest = distance;
                best = candidates[i];
            }
        }
        if (best != PC_INVALID_INDEX) {
            r->pinned[best] = PCI_PINNED;
            r->feet[best] = s->corners[corner];
            memcpy(&r->coarse->positions[3 * (size_t)best], point, 3 * sizeof(*point));
        }
    }
}

// Evens out the coarse mesh on the fine one, then fits its triangles to it.
static bool relax_and_fit(pci_scratch *scratch, const pci_sampling *s, const pci_rings *rings,
                          pci_halfedge *coarse, uint32_t *feet, uint32_t *nearby,
                          pci_flaws *flaws) {
    uint8_t *pinned = PCI_SCRATCH(scratch, uint8_t, coarse->vertex_count);
    if (pinned == NULL) {
        return false;
    }
    pci_relaxation relaxation = {&s->mesh, &s->fans, s->normals, s->scales,
                                 coarse,   feet,     pinned,     s->mirror};
    pci_relax_place(&relaxation);
    if (!pci_lace_rings(scratch, rings, nearby, &relaxation)) {
        return false;
    }
    pin_corners(s, nearby, &relaxation);
    for (size_t pass = 0; pass < relax_passes && pci_relax_pass(&relaxation) > 0; ++pass) {
        if (!pci_keep_going(scratch->context)) {
            return false;
        }
    }
    // A corner that leaves no room for good triangles is given up, but for the ends of seams.
    for (uint32_t v = 0; v < coarse->vertex_count; ++v) {
        if (pinned[v] && !pci_is_seam_vertex(s->mirror, coarse, v) &&
            pci_relax_quality(&relaxation, v) < pinned_quality) {
            pinned[v] = 0;
        }
    }
    if (!pci_improve(scratch, &relaxation, s->spacing, nearby) ||
        !pci_fit(scratch, &relaxation, nearby, s->areas, s->arcs, s->spacing, fit_passes)) {
        return false;
    }
    uint8_t *seam = PCI_SCRATCH(scratch, uint8_t, coarse->vertex_count);
    if (seam == NULL) {
        return false;
    }
    for (uint32_t v = 0; v < coarse->vertex_count; ++v) {
        seam[v] = pci_is_seam_vertex(s->mirror, coarse, v);
    }
    // What little is left to do may leave the surface, the less the better.
    for (size_t i = 0; i < sizeof(reaches) / sizeof(reaches[0]); ++i) {
        if (!pci_widen_slivers(scratch, &relaxation, reaches[i] * s->spacing)) {
            return false;
        }
    }
    size_t left = 0;
    if (!pci_untangle(scratch, &relaxation, s->spacing, &left) ||
        !pci_separate(scratch, &relaxation, s->spacing, flaws)) {
        return false;
    }
    for (size_t v = 0; v < coarse->vertex_count; ++v) {
        if (seam[v]) {
            coarse->positions[3 * v + s->mirror->axis] = s->mirror->offset;
        }
    }
    return true;
}

static pc_status measure(pci_scratch *scratch, const pc_mesh *mesh, size_t wanted,
                         pc_simplify_report *report) {
    pci_shape shape;
    if (!pci_find_shape(scratch, mesh, &shape)) {
        return pci_fail_memory(scratch->context, stage);
    }
    report->vertices = mesh->vertex_count;
    report->triangles = mesh->triangle_count;
    report->boundary_loops = shape.boundary_loops;
    report->components = shape.components;
    report->shortfall = mesh->vertex_count != wanted ? PC_SHORTFALL_TOPOLOGY
                        : report->dropped_parts > 0  ? PC_SHORTFALL_BUDGET
                                                     : PC_SHORTFALL_NONE;
    return PC_OK;
}

// Fills what the edges cannot follow.
static bool fill_notches(pci_scratch *scratch, size_t vertices, pc_mesh *layer) {
    return pci_fill_notches(scratch, pci_even_spacing(pc_mesh_area(layer), vertices), layer);
}

// Whether a density map is asked for, and whether there is one.
static bool wants_map(const pc_simplify_options *options) {
    return options->density_channel != PC_DENSITY_NONE && options->method == PC_SIMPLIFY_CLUSTERS;
}
static bool is_mapped(const pc_visual *visual, const pc_simplify_options *options) {
    return wants_map(options) && visual != NULL && visual->colors != NULL;
}

static pc_status begin_sampling(pci_scratch *scratch, const pc_visual *visual, const pc_mesh *layer,
                                const pc_simplify_options *options, const pci_mirror *mirror,
                                pci_sampling *s, pc_simplify_report *report) {
    pci_density density = {0};
    const bool mapped = is_mapped(visual, options);
    report->density_ignored = wants_map(options) && !mapped;
    if (mapped) {
        const size_t channel = options->density_channel - PC_DENSITY_RED;
        const pc_status status = pci_density_begin(scratch->context, stage, visual, channel,
                                                   options->density_range, &density);
        if (status != PC_OK) {
            return status;
        }
    }
    const size_t vertices = mirror != NULL ? options->vertices / 2 : options->vertices;
    const bool done =
        pci_sampling_begin(scratch, layer, vertices, mapped ? &density : NULL, mirror, s);
    pci_density_end(&density);
    return done ? PC_OK : pci_fail_memory(scratch->context, stage);
}

// How many clusters a half needs depends on how many lie on the seam, which is known afterwards.
// Whether there are others now.
static bool adjust_clusters(pci_sampling *s, const pc_simplify_options *options,
                            const pci_contraction *contraction, size_t round) {
    static const size_t rounds = PCI_EFFORT(4, 2), most_surplus = 1;
    const size_t vertices = pci_contraction_vertices(contraction);
    if (s->mirror == NULL || round == rounds) {
        return false;
    }
    if (vertices < options->vertices) {
        s->clusters += (options->vertices - vertices + 1) / 2;
        return true;
    }
    const size_t surplus = (vertices - options->vertices) / 2;
    const bool fewer = vertices > options->vertices + most_surplus &&
                       s->clusters > s->vertices + surplus && round + 1 < rounds;
    s->clusters -= fewer ? surplus : 0;
    return fewer;
}

// One proxy and what is wrong with it. False: out of memory or cancelled.
static bool make_proxy(pci_scratch *scratch, pci_sampling *s, const pc_simplify_options *options,
                       uint64_t attempt, pc_mesh *proxy, pci_flaws *flaws,
                       pc_simplify_report *report) {
    uint32_t *feet = NULL, *nearby = NULL;
    uint8_t *bound = NULL;
    pci_contraction contraction;
    pci_halfedge coarse;
    pci_clustering c;
    pc_mesh contracted = {0};
    if (attempt == 0 && !size_samples(scratch, s, options)) {
        return false;
    }
    for (size_t round = 0; round == 0 || adjust_clusters(s, options, &contraction, round);
         ++round) {
        if (!cluster_samples(scratch, s, options, attempt, &c, &report->iterations) ||
            !bind_clusters(scratch, &c, s->mesh.vertex_count, (uint32_t)s->clusters, &bound) ||
            !pci_progress(scratch->context, stage, 0.6) ||
            !pci_contraction_begin(scratch, &s->mesh, s->weights, s->arcs, s->spacing, s->mirror,
                                   &contraction)) {
            return false;
        }
        pci_contract_clusters(&contraction, c.cluster);
    }
    const size_t vertices = pci_contraction_vertices(&contraction);
    report->surplus_vertices = vertices > options->vertices ? vertices - options->vertices : 0;
    const bool built = pci_contract_to(&contraction, options->vertices, bound) &&
                       pci_contraction_result(&contraction, &contracted, &feet, &nearby) &&
                       pci_halfedge_build(scratch, &contracted, &coarse);
    pc_mesh_free(scratch->context, &contracted);
    if (!built || !relax_and_fit(scratch, s, &c.rings, &coarse, feet, nearby, flaws)) {
        return false;
    }
    const pc_mesh half = pci_halfedge_view(&coarse);
    return s->mirror != NULL ? pci_unfold(scratch, s->mirror, &half, proxy)
                             : pci_halfedge_export(&coarse, proxy, NULL);
}

typedef struct farthest_job {
    const pci_bvh *bvh;
    const double *positions;
    size_t stride;
    double *distances; // of the vertices that are asked
} farthest_job;

static void find_distances(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const farthest_job *job = user;
    for (size_t i = begin; i < end; ++i) {
        job->distances[i] =
            pci_bvh_closest(job->bvh, &job->positions[3 * job->stride * i], INFINITY).distance;
    }
}

// The largest distance from vertices of the single layer to the proxy.
static pc_status find_farthest(pci_scratch *scratch, const pci_halfedge *layer,
                               const pc_mesh *proxy, double *farthest) {
    const size_t stride = 1 + layer->vertex_count / asked_vertices;
    const size_t count = (layer->vertex_count + stride - 1) / stride;
    farthest_job job = {.positions = layer->positions, .stride = stride};
    job.distances = PCI_SCRATCH(scratch, double, count);
    pci_bvh *bvh = NULL;
    const pc_status status = scratch->failed ? pci_fail_memory(scratch->context, stage)
                                             : pci_bvh_create(scratch->context, stage, proxy, &bvh);
    if (status != PC_OK) {
        return status;
    }
    job.bvh = bvh;
    pci_parallel_for(scratch->context, count, 256, find_distances, &job);
    pci_bvh_destroy(scratch->context, bvh);
    *farthest = 0.0;
    for (size_t i = 0; i < count; ++i) {
        *farthest = fmax(*farthest, job.distances[i]);
    }
    return PC_OK;
}

// One proxy and what is wrong with it.
typedef struct attempt {
    pc_mesh proxy;
    pc_simplify_report report;
    pci_flaws flaws;
    double farthest; // vertex of the single layer, in expected edge lengths
} attempt;

static pc_status try_once(pc_context *context, pci_sampling *s, const pc_simplify_options *options,
                          uint64_t number, attempt *made) {
    pci_scratch scratch = pci_scratch_begin(context);
    pc_status status =
        make_proxy(&scratch, s, options, number, &made->proxy, &made->flaws, &made->report)
            ? PC_OK
            : pci_fail_memory(context, stage);
    if (status == PC_OK) {
        status = find_farthest(&scratch, &s->mesh, &made->proxy, &made->farthest);
    }
    made->farthest /= s->spacing;
    pci_scratch_end(&scratch);
    return status;
}

static bool is_flawless(const attempt *a) {
    return a->flaws.crossings == 0 && a->flaws.slivers == 0 && a->farthest <= farthest_kept;
}

static bool is_better(const attempt *a, const attempt *b) {
    return a->flaws.crossings != b->flaws.crossings ? a->flaws.crossings < b->flaws.crossings
           : a->flaws.slivers != b->flaws.slivers   ? a->flaws.slivers < b->flaws.slivers
                                                    : a->farthest < b->farthest;
}

// Clusters that begin elsewhere give another proxy: the first one without flaw, else the best.
static pc_status simplify_by_clusters(pc_context *context, pci_sampling *s,
                                      const pc_simplify_options *options, pc_mesh *proxy,
                                      pc_simplify_report *report) {
    const size_t affordable = 1 + vertices_of_attempts / options->vertices;
    const size_t attempts = affordable < most_attempts ? affordable : most_attempts;
    attempt best = {.proxy = {0}};
    pc_status status = PC_OK;
    size_t i = 0;
    for (; i < attempts && status == PC_OK && (i == 0 || !is_flawless(&best)); ++i) {
        attempt next = {.report = *report};
        status = try_once(context, s, options, i, &next);
        if (status == PC_OK && (i == 0 || is_flawless(&next) || is_better(&next, &best))) {
            const attempt swapped = best;
            best = next;
            next = swapped;
        }
        pc_mesh_free(context, &next.proxy);
    }
    *proxy = best.proxy;
    *report = best.report;
    report->self_intersections = best.flaws.crossings;
    report->attempts = i;
    return status;
}

static double least_angle(const pc_mesh *mesh, size_t triangle) {
    const uint32_t *corner = &mesh->triangles[3 * triangle];
    return pci_least_angle(&mesh->positions[3 * (size_t)corner[0]],
                           &mesh->positions[3 * (size_t)corner[1]],
                           &mesh->positions[3 * (size_t)corner[2]]);
}

// One proxy of a half and its mirror image. `angle` receives the mean of the triangles' least
// angles; 0: it has a flaw, other vertices than asked for, or another topology than the layer.
static pc_status try_half(pci_scratch *scratch, pci_sampling *s, const pc_simplify_options *options,
                          uint64_t number, const pci_shape *wanted, attempt *made, double *angle) {
    pci_shape shape;
    *angle = 0.0;
    const pc_status status = try_once(scratch->context, s, options, number, made);
    if (status != PC_OK) {
        return status;
    }
    const pc_mesh *proxy = &made->proxy;
    if (!pci_find_shape(scratch, proxy, &shape) ||
        !pci_list_self_intersections(scratch, proxy, NULL, &made->flaws.crossings)) {
        return pci_fail_memory(scratch->context, stage);
    }
    made->flaws.slivers = 0;
    for (size_t t = 0; t < proxy->triangle_count; ++t) {
        const double least = least_angle(proxy, t);
        made->flaws.slivers += least < PCI_LEAST_ANGLE;
        *angle += least / (double)proxy->triangle_count;
    }
    const bool whole =
        proxy->vertex_count == options->vertices && pci_same_topology(&shape, wanted);
    *angle = whole && is_flawless(made) ? *angle : 0.0;
    return PC_OK;
}

// The proxy of a garment that is the same on both sides of a plane: that of one half and its mirror
// image, the better of two. Empty where there is no such plane, or no such proxy without flaw.
static pc_status simplify_half(pci_scratch *scratch, const pc_mesh *layer,
                               const pc_simplify_options *options, pc_mesh *proxy,
                               pc_simplify_report *report) {
    static const size_t halved_attempts = PCI_EFFORT(3, 1), compared = 2;
    pc_context *context = scratch->context;
    pci_mirror mirror;
    pci_sampling s;
    pc_mesh half = {0};
    pci_shape wanted;
    const double spacing = pci_even_spacing(pc_mesh_area(layer), options->vertices);
    pc_status status = pci_halve(context, stage, layer, spacing, &mirror, &half);
    if (status != PC_OK || half.triangle_count == 0) {
        return status;
    }
    status = begin_sampling(scratch, NULL, &half, options, &mirror, &s, report);
    pc_mesh_free(context, &half);
    if (status == PC_OK && !pci_find_shape(scratch, layer, &wanted)) {
        status = pci_fail_memory(context, stage);
    }
    double best = 0.0;
    size_t good = 0;
    const size_t attempts = status == PC_OK && s.pleated ? 0 : halved_attempts;
    for (size_t i = 0; i < attempts && good < compared && status == PC_OK; ++i) {
        attempt next = {.report = *report};
        double angle = 0.0;
        status = try_half(scratch, &s, options, i, &wanted, &next, &angle);
        good += angle > 0.0;
        if (angle > best) {
            best = angle;
            pc_mesh_free(context, proxy);
            *proxy = next.proxy;
            *report = next.report;
            report->mirrored = true;
        } else {
            pc_mesh_free(context, &next.proxy);
        }
        report->attempts = i + 1;
    }
    return status;
}

static pc_status simplify_jointly(pci_scratch *scratch, const pc_visual *visual, pci_sampling *s,
                                  const pc_simplify_options *options, pc_mesh *proxy,
                                  pc_simplify_report *report) {
    pc_context *context = scratch->context;
    const pc_status status = pci_joint_decimate(context, stage, &visual->surface, options->vertices,
                                                options->seed, &s->mesh);
    if (status != PC_OK) {
        return status;
    }
    if (!pci_halfedge_export(&s->mesh, proxy, NULL)) {
        return pci_fail_memory(context, stage);
    }
    return pci_count_self_intersections(context, stage, proxy, &report->self_intersections);
}

static pc_status simplify(pci_scratch *scratch, const pc_visual *visual, pc_mesh *layer,
                          const pc_simplify_options *options, pc_mesh *proxy,
                          pc_simplify_report *report) {
    pc_context *context = scratch->context;
    pci_sampling s;
    if (!drop_unaffordable(scratch, layer, options->vertices, &report->dropped_parts) ||
        (options->method == PC_SIMPLIFY_CLUSTERS &&
         !fill_notches(scratch, options->vertices, layer))) {
        return pci_fail_memory(context, stage);
    }
    pc_status status = PC_OK;
    if (options->mirror && options->method == PC_SIMPLIFY_CLUSTERS && !is_mapped(visual, options)) {
        status = simplify_half(scratch, layer, options, proxy, report);
        if (status != PC_OK || proxy->triangle_count > 0) {
            return status == PC_OK ? measure(scratch, proxy, options->vertices, report) : status;
        }
    }
    status = begin_sampling(scratch, visual, layer, options, NULL, &s, report);
    if (status != PC_OK) {
        return status;
    }
    if (!(s.total > 0.0)) {
        return pci_fail(context, PC_ERROR_NO_PROXY, stage,
                        "simplify: the single layer has no area");
    }
    if (!pci_progress(context, stage, 0.2)) {
        return pci_fail_cancelled(context, stage);
    }
    status = options->method == PC_SIMPLIFY_JOINT
                 ? simplify_jointly(scratch, visual, &s, options, proxy, report)
                 : simplify_by_clusters(context, &s, options, proxy, report);
    return status == PC_OK ? measure(scratch, proxy, options->vertices, report) : status;
}

pc_status pc_simplify(pc_context *context, const pc_visual *visual, const pc_mesh *single_layer,
                      const pc_simplify_options *options, pc_mesh *proxy,
                      pc_simplify_report *report) {
    if (proxy == NULL || proxy->positions != NULL || proxy->triangles != NULL) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "simplify: the output is not empty");
    }
    if (single_layer != NULL && single_layer->triangle_count == 0) {
        return pci_fail(context, PC_ERROR_NO_PROXY, stage,
                        "simplify: the single layer has no triangle");
    }
    pc_simplify_options chosen;
    pc_status status = pci_check_mesh(context, stage, single_layer, "single layer");
    if (status == PC_OK) {
        status = pci_begin_stage(context, stage, &pc_simplify_options_record, options, &chosen);
    }
    if (status != PC_OK) {
        return status;
    }
    if (chosen.method == PC_SIMPLIFY_JOINT && visual == NULL) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "simplify: the method joint needs the visual mesh");
    }
    pci_scratch scratch = pci_scratch_begin(context);
    pc_simplify_report counts = {0};
    pci_repair_counts repairs;
    pc_mesh layer = {0}, result = {0};
    if (!pci_mesh_repair(&scratch, single_layer, NULL, &layer, &repairs)) {
        status = pci_fail_memory(context, stage);
    } else if (layer.triangle_count == 0) {
        status = pci_fail(context, PC_ERROR_NO_PROXY, stage,
                          "simplify: the single layer has no proper triangle");
    } else {
        counts.removed_triangles = repairs.removed_triangles;
        counts.split_vertices = repairs.split_vertices;
        status = simplify(&scratch, visual, &layer, &chosen, &result, &counts);
    }
    pc_mesh_free(context, &layer);
    pci_scratch_end(&scratch);
    if (status != PC_OK) {
        pc_mesh_free(context, &result);
        return status;
    }
    *proxy = result;
    if (report != NULL) {
        *report = counts;
    }
    return PC_OK;
}
