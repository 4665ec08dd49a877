#include "proxycloth/simplify.h"

#include "core/core.h"
#include "core/halfedge.h"
#include "core/heap.h"
#include "core/manifold.h"
#include "core/topology.h"
#include "stages/clustering.h"
#include "stages/corners.h"
#include "stages/fit.h"

static const char *const shortfall_choices[] = {"none", "topology", "budget", NULL};
static const pc_field option_fields[] = {
    PCI_FIELD_OPTION(pc_simplify_options, vertices, UINT, 128, 4, 65536, "",
                     "N_p: vertices of the proxy mesh"),
    PCI_FIELD_OPTION(pc_simplify_options, clustering_iterations, UINT, 100, 1, 10000, "",
                     "Passes of boundary exchanges between clusters"),
    PCI_FIELD_OPTION(pc_simplify_options, seed, UINT, 1, 0, 4294967295, "",
                     "Picks the vertex of the first cluster"),
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
    PCI_FIELD_REPORT(pc_simplify_report, iterations, COUNT, "", "Passes of boundary exchanges"),
    {.name = "shortfall",
     .type = PC_FIELD_CHOICE,
     .offset = offsetof(pc_simplify_report, shortfall),
     .unit = "",
     .help = "Why the proxy has another number of vertices or parts than asked for",
     .choices = shortfall_choices},
};
const pc_record pc_simplify_report_record = PCI_RECORD(report_fields, pc_simplify_report);

// Fine vertices per cluster: with fewer the centroids are coarse, with more nothing changes.
static const size_t samples_per_cluster = 16;
// Passes of sliding and flipping; most meshes rest earlier.
static const size_t relax_passes = 30;
// Least quality of the triangles at a corner of the border.
static const double pinned_quality = 0.5;
// Passes of fitting.
static const size_t fit_passes = 10;

// What has been merged into each vertex of the coarse mesh.
typedef struct merging {
    pci_scratch *scratch;
    const pci_halfedge *fine;
    pci_halfedge coarse; // starts as a copy of the fine mesh, same vertex indices
    const double *areas;
    const double *arcs;     // half the border edges at each vertex
    uint32_t *parent;       // union-find: the coarse vertex of a fine one
    double *area, *arc;     // #V sums
    double *center, *curve; // #V by 3, sums of positions weighted by areas and arcs
    double spacing;         // expected edge length of the proxy
} merging;

static double edge_length(const pci_halfedge *mesh, uint32_t h) {
    return sqrt(pci_squared_distance(&mesh->positions[3 * (size_t)pci_origin(mesh, h)],
                                     &mesh->positions[3 * (size_t)pci_target(mesh, h)]));
}

// Splits the longest edge until there are enough vertices.
static bool refine(pci_scratch *scratch, pci_halfedge *mesh, size_t vertices) {
    pci_heap longest = {0};
    for (uint32_t h = 0; h < 3 * mesh->triangle_count && mesh->live_vertices < vertices; ++h) {
        if (pci_is_edge(mesh, h) && !pci_heap_push(scratch, &longest, -edge_length(mesh, h), h)) {
            return false;
        }
    }
    pci_heap_entry entry;
    while (mesh->live_vertices < vertices && pci_heap_pop(&longest, &entry)) {
        if (!pci_is_edge(mesh, entry.item) || edge_length(mesh, entry.item) != -entry.key) {
            continue; // changed since
        }
        const double *a = &mesh->positions[3 * (size_t)pci_origin(mesh, entry.item)];
        const double *b = &mesh->positions[3 * (size_t)pci_target(mesh, entry.item)];
        const double middle[3] = {0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2])};
        const uint32_t v = pci_split_edge(mesh, entry.item, middle);
        if (v == PC_INVALID_INDEX) {
            return false;
        }
        // Every triangle at the new vertex was rewritten.
        PCI_FOR_OUTGOING(mesh, v, h) {
            const uint32_t around[3] = {h, pci_next(h), pci_previous(h)};
            for (size_t i = 0; i < 3; ++i) {
                const uint32_t twin = mesh->twins[around[i]];
                const uint32_t edge = twin < around[i] ? twin : around[i];
                if (!pci_heap_push(scratch, &longest, -edge_length(mesh, edge), edge)) {
                    return false;
                }
            }
        }
    }
    return true;
}

// Area and border length that belong to each vertex.
static void measure_vertices(const pci_halfedge *mesh, double *areas, double *arcs) {
    for (uint32_t h = 0; h < 3 * mesh->triangle_count; ++h) {
        if (mesh->twins[h] == PC_INVALID_INDEX) {
            const double length = edge_length(mesh, h);
            arcs[pci_origin(mesh, h)] += 0.5 * length;
            arcs[pci_target(mesh, h)] += 0.5 * length;
        }
        if (h % 3 == 0) {
            const pc_mesh all = {mesh->vertex_count, mesh->positions, mesh->triangle_count,
                                 mesh->corners};
            const double area = pci_triangle_area(&all, h / 3);
            for (uint32_t c = 0; c < 3; ++c) {
                areas[mesh->corners[h + c]] += area / 3.0;
            }
        }
    }
}

// ---- contraction ------------------------------------------------------------------------------

static uint32_t find_root(uint32_t *parent, uint32_t v) {
    while (parent[v] != v) {
        parent[v] = parent[parent[v]];
        v = parent[v];
    }
    return v;
}

static void merge(merging *m, uint32_t h) {
    const size_t a = pci_origin(&m->coarse, h), b = pci_target(&m->coarse, h);
    pci_collapse(&m->coarse, h);
    m->parent[a] = (uint32_t)b;
    m->area[b] += m->area[a];
    m->arc[b] += m->arc[a];
    for (size_t k = 0; k < 3; ++k) {
        m->center[3 * b + k] += m->center[3 * a + k];
        m->curve[3 * b + k] += m->curve[3 * a + k];
    }
}

// Contracts every cluster as far as the topology allows. A cluster that is a disc and touches the
// border at most once ends as one vertex, and a triangle is left where three clusters meet: the
// dual of the clustering. Other clusters (rings around a sleeve, pieces of a strap) keep the
// vertices that the surface needs there.
static void contract_clusters(merging *m, const uint32_t *cluster) {
    size_t merged = 1;
    while (merged > 0) {
        merged = 0;
        for (uint32_t h = 0; h < 3 * m->coarse.triangle_count; ++h) {
            if (pci_is_edge(&m->coarse, h) &&
                cluster[pci_origin(&m->coarse, h)] == cluster[pci_target(&m->coarse, h)] &&
                pci_can_collapse(&m->coarse, h)) {
                merge(m, h);
                ++merged;
            }
        }
    }
}

// Rise of sum w |x - mean|^2 when two groups become one.
static double join_cost(double mass_a, const double *sum_a, double mass_b, const double *sum_b) {
    if (!(mass_a > 0.0) || !(mass_b > 0.0)) {
        return 0.0;
    }
    double squared = 0.0;
    for (size_t k = 0; k < 3; ++k) {
        const double d = sum_a[k] / mass_a - sum_b[k] / mass_b;
        squared += d * d;
    }
    return mass_a * mass_b / (mass_a + mass_b) * squared;
}

static double merge_cost(const merging *m, uint32_t h) {
    const size_t a = pci_origin(&m->coarse, h), b = pci_target(&m->coarse, h);
    return join_cost(m->area[a], &m->center[3 * a], m->area[b], &m->center[3 * b]) +
           m->spacing * join_cost(m->arc[a], &m->curve[3 * a], m->arc[b], &m->curve[3 * b]);
}

// Merges the vertices whose union costs the least clustering energy until `vertices` are left or
// nothing more can collapse.
static bool reduce(merging *m, size_t vertices) {
    size_t merged = 1;
    while (m->coarse.live_vertices > vertices && merged > 0) {
        merged = 0;
        pci_heap cheapest = {0};
        for (uint32_t h = 0; h < 3 * m->coarse.triangle_count; ++h) {
            if (pci_is_edge(&m->coarse, h) &&
                !pci_heap_push(m->scratch, &cheapest, merge_cost(m, h), h)) {
                return false;
            }
        }
        pci_heap_entry entry;
        while (m->coarse.live_vertices > vertices && pci_heap_pop(&cheapest, &entry)) {
            const uint32_t h = entry.item;
            if (!pci_is_edge(&m->coarse, h) || merge_cost(m, h) != entry.key ||
                !pci_can_collapse(&m->coarse, h)) {
                continue;
            }
            const uint32_t kept = pci_target(&m->coarse, h);
            merge(m, h);
            ++merged;
            PCI_FOR_OUTGOING(&m->coarse, kept, i) {
                const uint32_t pair[2] = {i, pci_previous(i)};
                for (size_t s = 0; s < 2; ++s) {
                    const uint32_t twin = m->coarse.twins[pair[s]];
                    const uint32_t edge = twin < pair[s] ? twin : pair[s];
                    if (!pci_heap_push(m->scratch, &cheapest, merge_cost(m, edge), edge)) {
                        return false;
                    }
                }
            }
        }
    }
    return true;
}

// Positions: the centroid of what was merged; on the border that of the border's part, so that
// hems do not shrink. Feet: the merged fine vertex next to it.
static bool place_vertices(merging *m, uint32_t *feet) {
    const size_t nv = m->fine->vertex_count;
    double *nearest = PCI_SCRATCH(m->scratch, double, nv);
    if (nearest == NULL) {
        return false;
    }
    for (uint32_t v = 0; v < nv; ++v) {
        nearest[v] = INFINITY;
        feet[v] = PC_INVALID_INDEX;
        if (m->coarse.outgoing[v] != PC_INVALID_INDEX) {
            const bool border = pci_is_border_vertex(&m->coarse, v);
            for (size_t k = 0; k < 3; ++k) {
                m->coarse.positions[3 * (size_t)v + k] =
                    border ? m->curve[3 * (size_t)v + k] / m->arc[v]
                           : m->center[3 * (size_t)v + k] / m->area[v];
            }
        }
    }
    for (uint32_t v = 0; v < nv; ++v) {
        const uint32_t root = find_root(m->parent, v);
        if (pci_is_border_vertex(&m->coarse, root) && !pci_is_border_vertex(m->fine, v)) {
            continue;
        }
        const double distance = pci_squared_distance(&m->fine->positions[3 * (size_t)v],
                                                     &m->coarse.positions[3 * (size_t)root]);
        if (distance < nearest[root]) {
            nearest[root] = distance;
            feet[root] = v;
        }
    }
    return true;
}

static bool begin_merging(pci_scratch *scratch, const pci_halfedge *fine, merging *m) {
    const size_t nv = fine->vertex_count;
    double *areas = PCI_SCRATCH(scratch, double, nv), *arcs = PCI_SCRATCH(scratch, double, nv);
    *m = (merging){.scratch = scratch, .fine = fine, .areas = areas, .arcs = arcs};
    m->parent = PCI_SCRATCH(scratch, uint32_t, nv);
    m->area = PCI_SCRATCH(scratch, double, nv);
    m->arc = PCI_SCRATCH(scratch, double, nv);
    m->center = PCI_SCRATCH(scratch, double, 3 * nv);
    m->curve = PCI_SCRATCH(scratch, double, 3 * nv);
    if (scratch->failed || !pci_halfedge_copy(scratch, fine, &m->coarse)) {
        return false;
    }
    measure_vertices(fine, areas, arcs);
    double total = 0.0;
    for (size_t v = 0; v < nv; ++v) {
        total += areas[v];
    }
    for (size_t v = 0; v < nv; ++v) {
        // Degenerate triangles must not leave a vertex without weight.
        areas[v] = fmax(areas[v], 1e-9 * total / (double)nv);
        m->parent[v] = (uint32_t)v;
        m->area[v] = areas[v];
        m->arc[v] = arcs[v];
        for (size_t k = 0; k < 3; ++k) {
            m->center[3 * v + k] = areas[v] * fine->positions[3 * v + k];
            m->curve[3 * v + k] = arcs[v] * fine->positions[3 * v + k];
        }
    }
    return true;
}

// ---- steps ------------------------------------------------------------------------------------

// Drops parts that would get less than one cluster. Returns false when memory ran out.
static bool drop_unaffordable(pci_scratch *scratch, pc_mesh *layer, size_t vertices,
                              uint64_t *dropped) {
    *dropped = 0;
    for (;;) {
        // The largest part always stays, so this ends.
        pci_topology topology;
        uint32_t *component = PCI_SCRATCH(scratch, uint32_t, layer->triangle_count);
        if (component == NULL || !pci_topology_build(scratch, layer, &topology)) {
            return false;
        }
        const size_t count = pci_triangle_components(scratch, layer, &topology, component);
        double *areas = PCI_SCRATCH(scratch, double, count);
        if (areas == NULL) {
            return false;
        }
        double total = 0.0, largest = 0.0;
        for (size_t t = 0; t < layer->triangle_count; ++t) {
            const double area = pci_triangle_area(layer, t);
            areas[component[t]] += area;
            total += area;
        }
        for (size_t i = 0; i < count; ++i) {
            largest = fmax(largest, areas[i]);
        }
        uint64_t now = 0;
        const double needed = fmax(total / (double)vertices, count > vertices / 3 ? largest : 0.0);
        if (!pci_drop_small_parts(scratch, layer, fmin(needed / largest, 1.0), &now)) {
            return false;
        }
        *dropped += now;
        if (now == 0) {
            return true;
        }
    }
}

// Puts the nearest border vertex on each corner of the border, once.
static bool pin_corners(const merging *m, pci_relaxation *r) {
    const pci_halfedge *fine = m->fine;
    uint8_t *corners = PCI_SCRATCH(m->scratch, uint8_t, fine->vertex_count);
    if (corners == NULL || !pci_find_corners(m->scratch, fine, 0.5 * m->spacing, corners)) {
        return false;
    }
    for (uint32_t v = 0; v < fine->vertex_count; ++v) {
        if (!corners[v]) {
            continue;
        }
        // The vertex that the corner was merged into, or one of its neighbours on the border.
        const double *corner = &fine->positions[3 * (size_t)v];
        const uint32_t own = m->parent[v];
        const uint32_t candidates[3] = {own, pci_target(r->coarse, r->coarse->outgoing[own]),
                                        pci_origin(r->coarse, pci_border_incoming(r->coarse, own))};
        uint32_t best = PC_INVALID_INDEX;
        double nearest = INFINITY;
        for (size_t i = 0; i < 3; ++i) {
            const double distance =
                pci_squared_distance(corner, &r->coarse->positions[3 * (size_t)candidates[i]]);
            if (!r->pinned[candidates[i]] && distance < nearest) {
                nearest = distance;
                best = candidates[i];
            }
        }
        if (best != PC_INVALID_INDEX) {
            r->pinned[best] = 1;
            r->feet[best] = v;
            memcpy(&r->coarse->positions[3 * (size_t)best], corner, 3 * sizeof(*corner));
        }
    }
    return true;
}

// Evens out the coarse mesh on the fine one, then fits its triangles to it.
static bool relax_and_fit(merging *m, pci_halfedge *coarse, const uint32_t *kept,
                          const uint32_t *fine_feet) {
    const pci_halfedge *fine = m->fine;
    double *normals = PCI_SCRATCH(m->scratch, double, 3 * fine->vertex_count);
    uint32_t *feet = PCI_SCRATCH(m->scratch, uint32_t, coarse->vertex_count);
    uint32_t *number = PCI_SCRATCH(m->scratch, uint32_t, fine->vertex_count);
    uint8_t *pinned = PCI_SCRATCH(m->scratch, uint8_t, coarse->vertex_count);
    if (m->scratch->failed) {
        return false;
    }
    const pc_mesh fine_mesh = {fine->vertex_count, fine->positions, fine->triangle_count,
                               fine->corners};
    pci_vertex_normals(&fine_mesh, normals);
    for (uint32_t v = 0; v < coarse->vertex_count; ++v) {
        feet[v] = fine_feet[kept[v]];
        number[kept[v]] = v;
    }
    for (uint32_t v = 0; v < fine->vertex_count; ++v) {
        m->parent[v] = find_root(m->parent, v);
    }
    for (uint32_t v = 0; v < fine->vertex_count; ++v) {
        m->parent[v] = number[m->parent[v]];
    }
    pci_relaxation relaxation = {fine, normals, coarse, feet, pinned};
    pci_relax_place(&relaxation);
    if (!pin_corners(m, &relaxation)) {
        return false;
    }
    for (size_t pass = 0; pass < relax_passes && pci_relax_pass(&relaxation) > 0; ++pass) {
    }
    // A corner that leaves no room for good triangles is given up.
    for (uint32_t v = 0; v < coarse->vertex_count; ++v) {
        pinned[v] = pinned[v] && pci_relax_quality(&relaxation, v) >= pinned_quality;
    }
    return pci_fit(m->scratch, &relaxation, m->parent, m->areas, m->arcs, m->spacing, fit_passes);
}

static pc_status measure(pci_scratch *scratch, const pc_mesh *mesh, size_t wanted,
                         pc_simplify_report *report) {
    pci_topology topology;
    size_t loop_count = 0, *offsets = NULL;
    uint32_t *loops = NULL;
    uint32_t *component = PCI_SCRATCH(scratch, uint32_t, mesh->triangle_count);
    if (scratch->failed || !pci_topology_build(scratch, mesh, &topology) ||
        !pci_boundary_loops(scratch, mesh, &topology, &loop_count, &offsets, &loops)) {
        return pci_fail_memory(scratch->context, "simplify");
    }
    report->vertices = mesh->vertex_count;
    report->triangles = mesh->triangle_count;
    report->boundary_loops = loop_count;
    report->components = pci_triangle_components(scratch, mesh, &topology, component);
    report->shortfall = report->dropped_parts > 0      ? PC_SHORTFALL_BUDGET
                        : mesh->vertex_count != wanted ? PC_SHORTFALL_TOPOLOGY
                                                       : PC_SHORTFALL_NONE;
    return scratch->failed ? pci_fail_memory(scratch->context, "simplify") : PC_OK;
}

static pc_status simplify(pci_scratch *scratch, pc_mesh *layer, const pc_simplify_options *options,
                          pc_mesh *proxy, pc_simplify_report *report) {
    pc_context *context = scratch->context;
    pci_halfedge fine, coarse;
    merging m;
    if (!drop_unaffordable(scratch, layer, options->vertices, &report->dropped_parts) ||
        !pci_halfedge_build(scratch, layer, &fine) ||
        !refine(scratch, &fine, samples_per_cluster * options->vertices) ||
        !begin_merging(scratch, &fine, &m)) {
        return pci_fail_memory(context, "simplify");
    }
    if (!pci_progress(context, "simplify", 0.2)) {
        return pci_fail_cancelled(context, "simplify");
    }
    double total = 0.0;
    for (size_t v = 0; v < fine.vertex_count; ++v) {
        total += m.areas[v];
    }
    if (!(total > 0.0)) {
        return pci_fail(context, PC_ERROR_NO_PROXY, "simplify",
                        "simplify: the single layer has no area");
    }
    m.spacing = sqrt(2.0 / sqrt(3.0) * total / options->vertices);
    uint32_t *cluster = PCI_SCRATCH(scratch, uint32_t, fine.vertex_count);
    uint32_t *feet = PCI_SCRATCH(scratch, uint32_t, fine.vertex_count);
    uint32_t *kept = NULL;
    const uint32_t first = (uint32_t)(pci_random(options->seed, 0, 0) * (double)fine.vertex_count);
    if (scratch->failed ||
        !pci_cluster_vertices(scratch, &fine, m.areas, options->vertices, first,
                              options->clustering_iterations, cluster, &report->iterations)) {
        return pci_fail_memory(context, "simplify");
    }
    if (!pci_progress(context, "simplify", 0.6)) {
        return pci_fail_cancelled(context, "simplify");
    }
    contract_clusters(&m, cluster);
    report->surplus_vertices = m.coarse.live_vertices - options->vertices;
    if (!reduce(&m, options->vertices) || !place_vertices(&m, feet) ||
        !pci_halfedge_export(&m.coarse, proxy, &kept) ||
        !pci_halfedge_build(scratch, proxy, &coarse) || !relax_and_fit(&m, &coarse, kept, feet)) {
        return pci_fail_memory(context, "simplify");
    }
    memcpy(proxy->positions, coarse.positions, 3 * proxy->vertex_count * sizeof(double));
    memcpy(proxy->triangles, coarse.corners, 3 * proxy->triangle_count * sizeof(uint32_t));
    return measure(scratch, proxy, options->vertices, report);
}

static pc_status check_arguments(pc_context *context, const pc_mesh *surface,
                                 const pc_mesh *single_layer, const pc_mesh *proxy) {
    if (surface == NULL || single_layer == NULL || proxy == NULL) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, "simplify",
                        "simplify: a mesh is missing");
    }
    if (proxy->positions != NULL || proxy->triangles != NULL) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, "simplify",
                        "simplify: the output is not empty");
    }
    for (size_t c = 0; c < 3 * single_layer->triangle_count; ++c) {
        if (single_layer->triangles[c] >= single_layer->vertex_count) {
            return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, "simplify",
                            "simplify: triangle %zu has vertex %u of %zu", c / 3,
                            single_layer->triangles[c], single_layer->vertex_count);
        }
    }
    for (size_t i = 0; i < 3 * single_layer->vertex_count; ++i) {
        if (!isfinite(single_layer->positions[i])) {
            return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, "simplify",
                            "simplify: vertex %zu is not finite", i / 3);
        }
    }
    return PC_OK;
}

pc_status pc_simplify(pc_context *context, const pc_mesh *surface, const pc_mesh *single_layer,
                      const pc_simplify_options *options, pc_mesh *proxy,
                      pc_simplify_report *report) {
    pc_status status = check_arguments(context, surface, single_layer, proxy);
    if (status != PC_OK) {
        return status;
    }
    pc_simplify_options defaults;
    pc_record_set_defaults(&pc_simplify_options_record, &defaults);
    options = options != NULL ? options : &defaults;
    status = pc_record_check(context, "simplify", &pc_simplify_options_record, options);
    if (status != PC_OK) {
        return status;
    }
    pci_scratch scratch = pci_scratch_begin(context);
    pc_simplify_report counts = {0};
    pci_repair_counts repairs;
    pc_mesh layer = {0}, result = {0};
    if (!pci_mesh_repair(&scratch, single_layer, NULL, &layer, &repairs)) {
        status = pci_fail_memory(context, "simplify");
    } else if (layer.triangle_count == 0) {
        status = pci_fail(context, PC_ERROR_NO_PROXY, "simplify",
                          "simplify: the single layer has no proper triangle");
    } else {
        counts.removed_triangles = repairs.removed_triangles;
        counts.split_vertices = repairs.split_vertices;
        status = simplify(&scratch, &layer, options, &result, &counts);
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
