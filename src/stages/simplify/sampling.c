#include "stages/simplify/sampling.h"

#include "core/heap.h"
#include "geometry/locality.h"
#include "geometry/topology.h"
#include "stages/simplify/clustering.h"
#include "stages/simplify/corners.h"
#include "stages/simplify/pleats.h"

// Fine vertices per cluster: with fewer the centroids are coarse, with more nothing changes.
static const size_t samples_per_cluster = PCI_EFFORT(16, 4);
// The longest edge after bisections, in lengths of an even mesh.
static const double bisection_spread = 1.5;
// How far corners of the border are seen, in expected edge lengths.
static const double corner_reach = 0.5;
// Vertices of the proxy at the border stand at the edge of their clusters, so that these shall be
// half as deep. That matters where half an edge beside the border makes up so much of the surface,
// as on belts: there the strip that is missing, in edge lengths, counts at the border.
static const double narrow_share = 0.3, missing_strip = 0.43;

// ---- refinement -------------------------------------------------------------------------------

typedef struct refinement {
    pci_scratch *scratch;
    pci_halfedge *mesh;
    double *scales; // #V, lengths count that many times; NULL: 1
    size_t scale_capacity;
    pci_heap longest;
} refinement;

static double edge_key(const refinement *r, uint32_t h) {
    const double length = pci_edge_length(r->mesh, h);
    return r->scales == NULL
               ? -length
               : -0.5 * length *
                     (r->scales[pci_origin(r->mesh, h)] + r->scales[pci_target(r->mesh, h)]);
}

static bool push_edge(refinement *r, uint32_t h) {
    const uint32_t twin = r->mesh->twins[h];
    const uint32_t edge = twin < h ? twin : h;
    return pci_heap_push(r->scratch, &r->longest, edge_key(r, edge), edge);
}

static bool split(refinement *r, uint32_t edge) {
    pci_halfedge *mesh = r->mesh;
    const size_t ends[2] = {pci_origin(mesh, edge), pci_target(mesh, edge)};
    const double *a = &mesh->positions[3 * ends[0]], *b = &mesh->positions[3 * ends[1]];
    const double middle[3] = {0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2])};
    const uint32_t v = pci_split_edge(mesh, edge, middle);
    if (v == PC_INVALID_INDEX) {
        return false;
    }
    if (r->scales != NULL) {
        void *scales = r->scales;
        if (!pci_scratch_reserve(r->scratch, &scales, &r->scale_capacity, mesh->vertex_count,
                                 sizeof(*r->scales))) {
            return false;
        }
        r->scales = scales;
        r->scales[v] = 0.5 * (r->scales[ends[0]] + r->scales[ends[1]]);
    }
    // Every triangle at the new vertex was rewritten.
    PCI_FOR_OUTGOING(mesh, v, h) {
        const bool last = mesh->twins[pci_previous(h)] == PC_INVALID_INDEX;
        if (!push_edge(r, h) || !push_edge(r, pci_next(h)) ||
            (last && !push_edge(r, pci_previous(h)))) {
            return false;
        }
    }
    return true;
}

// Splits the longest edge while there are fewer vertices than wanted or it is longer than `length`.
static bool refine(refinement *r, size_t vertices, double length) {
    pci_halfedge *mesh = r->mesh;
    const size_t missing = vertices > mesh->live_vertices ? vertices - mesh->live_vertices : 0;
    if (!pci_halfedge_reserve(mesh, mesh->vertex_count + missing,
                              mesh->triangle_count + 2 * missing)) {
        return false;
    }
    r->longest.count = 0;
    for (uint32_t h = 0; h < 3 * mesh->triangle_count; ++h) {
        const bool wanted = mesh->live_vertices < vertices || -edge_key(r, h) > length;
        if (pci_is_edge(mesh, h) && wanted && !push_edge(r, h)) {
            return false;
        }
    }
    pci_heap_entry entry;
    while (pci_heap_pop(&r->longest, &entry) &&
           (mesh->live_vertices < vertices || -entry.key > length)) {
        if (!pci_is_edge(mesh, entry.item) || edge_key(r, entry.item) != entry.key) {
            continue; // changed since
        }
        if (!split(r, entry.item)) {
            return false;
        }
    }
    return true;
}

// Edge length of even clusters where the scale is 1.
static double even_spacing(const pci_halfedge *mesh, const double *scales, size_t clusters) {
    const pc_mesh view = pci_halfedge_view(mesh);
    double area = 0.0;
    for (size_t t = 0; t < view.triangle_count; ++t) {
        const uint32_t *c = &view.triangles[3 * t];
        const double scale =
            scales != NULL ? (scales[c[0]] + scales[c[1]] + scales[c[2]]) / 3.0 : 1.0;
        area += scale * scale * pci_triangle_area(&view, t);
    }
    return pci_even_spacing(area, clusters);
}

// Refines again where the density map wants shorter edges.
static bool refine_to_map(refinement *r, const pci_density *density, size_t clusters) {
    pci_halfedge *mesh = r->mesh;
    r->scales = PCI_SCRATCH(r->scratch, double, mesh->vertex_count);
    r->scale_capacity = mesh->vertex_count;
    if (r->scales == NULL ||
        !pci_density_sample(density, mesh->vertex_count, mesh->positions, r->scales) ||
        !pci_limit_gradation(r->scratch, mesh, even_spacing(mesh, r->scales, clusters),
                             r->scales)) {
        return false;
    }
    const double spacing = even_spacing(mesh, r->scales, clusters);
    return refine(r, 0, bisection_spread * spacing / sqrt((double)samples_per_cluster));
}

// ---- sampling ---------------------------------------------------------------------------------

// Enough vertices for the clusters, neighbours next to each other in memory.
static bool sample(pci_scratch *scratch, const pc_mesh *layer, size_t vertices,
                   const pci_density *density, pci_sampling *s) {
    pci_scratch inner = pci_scratch_begin(scratch->context);
    pci_halfedge refined;
    refinement r = {.scratch = &inner, .mesh = &refined};
    pc_mesh sorted = {0};
    uint32_t *order = NULL;
    bool done = pci_halfedge_build(&inner, layer, &refined) && pci_keep_going(scratch->context) &&
                refine(&r, samples_per_cluster * vertices, INFINITY) &&
                (density == NULL || refine_to_map(&r, density, vertices)) &&
                pci_keep_going(scratch->context);
    if (done) {
        const pc_mesh unsorted = pci_halfedge_view(&refined);
        done = pci_sort_mesh(&inner, &unsorted, &sorted, &order) &&
               pci_keep_going(scratch->context) && pci_halfedge_build(scratch, &sorted, &s->mesh);
    }
    if (done && density != NULL) {
        s->densities = PCI_SCRATCH(scratch, double, sorted.vertex_count);
        done = s->densities != NULL;
        for (size_t v = 0; done && v < sorted.vertex_count; ++v) {
            s->densities[v] = r.scales[order[v]];
        }
    }
    pci_scratch_end(&inner);
    return done && pci_keep_going(scratch->context);
}

// Whether a seam ends at a vertex of the border.
static bool ends_seam(const pci_sampling *s, uint32_t v) {
    const pci_halfedge *mesh = &s->mesh;
    return pci_is_seam_vertex(s->mirror, mesh, v) &&
           !(pci_is_seam_vertex(s->mirror, mesh, pci_target(mesh, mesh->outgoing[v])) &&
             pci_is_seam_vertex(s->mirror, mesh, pci_origin(mesh, pci_border_incoming(mesh, v))));
}

// Puts the ends of seams before the corners that were found. Vertices on the seam serve both
// halves: there are about half of them more clusters.
static bool add_seam(pci_scratch *scratch, pci_sampling *s) {
    size_t ends = 0, count = 0;
    double length = 0.0;
    for (uint32_t v = 0; v < s->mesh.vertex_count; ++v) {
        ends += ends_seam(s, v);
    }
    for (uint32_t h = 0; h < 3 * s->mesh.triangle_count; ++h) {
        length += pci_is_seam_edge(s->mirror, &s->mesh, h) ? pci_edge_length(&s->mesh, h) : 0.0;
    }
    s->clusters += (size_t)(0.5 * length / s->spacing);
    uint32_t *corners = PCI_SCRATCH(scratch, uint32_t, ends + s->corner_count);
    if (corners == NULL) {
        return false;
    }
    for (uint32_t v = 0; v < s->mesh.vertex_count; ++v) {
        if (ends_seam(s, v)) {
            corners[count++] = v;
        }
    }
    for (size_t i = 0; i < s->corner_count; ++i) {
        if (!pci_is_seam_vertex(s->mirror, &s->mesh, s->corners[i])) {
            corners[count++] = s->corners[i];
        }
    }
    s->corners = corners;
    s->corner_count = count;
    return true;
}

bool pci_sampling_begin(pci_scratch *scratch, const pc_mesh *layer, size_t vertices,
                        const pci_density *density, const pci_mirror *mirror, pci_sampling *s) {
    *s = (pci_sampling){.mirror = mirror, .vertices = vertices, .clusters = vertices};
    if (!sample(scratch, layer, vertices, density, s)) {
        return false;
    }
    const size_t nv = s->mesh.vertex_count;
    s->normals = PCI_SCRATCH(scratch, double, 3 * nv);
    s->areas = PCI_SCRATCH(scratch, double, nv);
    s->arcs = PCI_SCRATCH(scratch, double, nv);
    s->scales = PCI_SCRATCH(scratch, double, nv);
    s->weights = PCI_SCRATCH(scratch, double, nv);
    if (scratch->failed) {
        return false;
    }
    pc_mesh mesh = pci_halfedge_view(&s->mesh);
    pci_vertex_normals(&mesh, s->normals);
    if (!pci_flatten_pleats(scratch, even_spacing(&s->mesh, NULL, vertices), &mesh, s->normals,
                            &s->pleated) ||
        !pci_fans_build(scratch, &s->mesh, &s->fans)) {
        return false;
    }
    for (size_t t = 0; t < mesh.triangle_count; ++t) {
        const double area = pci_triangle_area(&mesh, t);
        s->total += area;
        for (size_t c = 0; c < 3; ++c) {
            s->areas[mesh.triangles[3 * t + c]] += area / 3.0;
        }
    }
    for (uint32_t h = 0; h < 3 * mesh.triangle_count; ++h) {
        if (s->mesh.twins[h] == PC_INVALID_INDEX && !pci_is_seam_edge(mirror, &s->mesh, h)) {
            const double length = pci_edge_length(&s->mesh, h);
            s->arcs[pci_origin(&s->mesh, h)] += 0.5 * length;
            s->arcs[pci_target(&s->mesh, h)] += 0.5 * length;
        }
    }
    for (size_t v = 0; v < nv; ++v) {
        // Degenerate triangles must not leave a vertex without weight.
        s->areas[v] = fmax(s->areas[v], 1e-9 * s->total / (double)nv);
        s->weights[v] = s->areas[v];
        s->scales[v] = 1.0;
    }
    s->spacing = even_spacing(&s->mesh, NULL, vertices);
    return pci_find_corners(scratch, &s->mesh, corner_reach * s->spacing, &s->corners,
                            &s->corner_count) &&
           (mirror == NULL || add_seam(scratch, s));
}

void pci_sampling_weigh(pci_sampling *s) {
    double border = 0.0;
    for (size_t v = 0; v < s->mesh.vertex_count; ++v) {
        border += s->arcs[v];
    }
    const bool narrow = 0.5 * s->spacing * border > narrow_share * s->total;
    const double strip = narrow ? missing_strip * s->spacing : 0.0;
    for (size_t v = 0; v < s->mesh.vertex_count; ++v) {
        if (s->densities != NULL) {
            s->scales[v] = fmax(s->scales[v], s->densities[v]);
        }
        // The density of a centroidal Voronoi diagram is the fourth power of the inverse size.
        s->weights[v] = (s->areas[v] + strip * s->arcs[v]) * pow(s->scales[v], 4.0);
    }
}
