#include "stages/outline.h"

#include "core/core.h"
#include "core/halfedge.h"
#include "core/manifold.h"
#include "core/rim.h"
#include "core/topology.h"
#include "core/union_find.h"

// Pieces of parallel loops.
enum { grain = 256, rim_grain = 16 };

// Radius of the ball that tells rims from surfaces, in voxels: narrower than any opening of note.
static const double rim_radius = 0.5;
// A region counts only where it reaches this many times the threshold; less is roughness.
static const double least_reach = 1.5;
// Share of a region's area whose nearest point of the visual mesh lies on a rim.
static const double membrane_share = 0.5;

typedef struct outline {
    const pci_bvh *visual;
    pci_halfedge mesh;
    double *normals;   // #V by 3
    double *distances; // #V, beside the visual mesh, along the surface
    size_t normal_capacity, distance_capacity;
} outline;

// How far the nearest point of the visual mesh lies beside a point of the layer: the distance
// without its share along the normal.
static double distance_beside(const pci_bvh *visual, const double point[3],
                              const double normal[3]) {
    const pci_closest closest = pci_bvh_closest(visual, point, INFINITY);
    double away[3];
    pci_sub(closest.point, point, away);
    const double height = pci_dot(away, normal);
    return sqrt(fmax(0.0, pci_dot(away, away) - height * height));
}

static void measure_outline(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    outline *o = user;
    for (size_t v = begin; v < end; ++v) {
        o->distances[v] = distance_beside(o->visual, &o->mesh.positions[3 * v], &o->normals[3 * v]);
    }
}

static bool split_measured(outline *o, uint32_t h, double share, const double *known_distance) {
    const size_t a = pci_origin(&o->mesh, h), b = pci_target(&o->mesh, h);
    double position[3], normal[3];
    for (size_t k = 0; k < 3; ++k) {
        position[k] = o->mesh.positions[3 * a + k] +
                      share * (o->mesh.positions[3 * b + k] - o->mesh.positions[3 * a + k]);
        normal[k] = o->normals[3 * a + k] + o->normals[3 * b + k];
    }
    pci_normalize(normal);
    const uint32_t v = pci_split_edge(&o->mesh, h, position);
    void *normals = o->normals, *distances = o->distances;
    if (v == PC_INVALID_INDEX ||
        !pci_scratch_reserve(o->mesh.scratch, &normals, &o->normal_capacity, (size_t)v + 1,
                             3 * sizeof(double)) ||
        !pci_scratch_reserve(o->mesh.scratch, &distances, &o->distance_capacity, (size_t)v + 1,
                             sizeof(double))) {
        return false;
    }
    o->normals = normals;
    o->distances = distances;
    memcpy(&o->normals[3 * (size_t)v], normal, sizeof(normal));
    o->distances[v] =
        known_distance != NULL ? *known_distance : distance_beside(o->visual, position, normal);
    return true;
}

static double edge_length(const pci_halfedge *mesh, uint32_t h) {
    return sqrt(pci_squared_distance(&mesh->positions[3 * (size_t)pci_origin(mesh, h)],
                                     &mesh->positions[3 * (size_t)pci_target(mesh, h)]));
}

// The longest edge of a triangle; ties go to the smaller half-edge of the pair.
static uint32_t longest_edge(const pci_halfedge *mesh, uint32_t t) {
    uint32_t best = 3 * t;
    double length = -1.0;
    for (uint32_t h = 3 * t; h < 3 * t + 3; ++h) {
        const double candidate = edge_length(mesh, h);
        const uint32_t id = h < mesh->twins[h] ? h : mesh->twins[h];
        const uint32_t best_id = best < mesh->twins[best] ? best : mesh->twins[best];
        if (candidate > length || (candidate == length && id < best_id)) {
            best = h;
            length = candidate;
        }
    }
    return best;
}

// Follows longest edges from a triangle to one that is the longest of both its triangles (Rivara).
// Every edge that its split makes is shorter by a fixed factor, also among triangles without area.
static uint32_t terminal_edge(const pci_halfedge *mesh, uint32_t t) {
    uint32_t h = longest_edge(mesh, t);
    while (mesh->twins[h] != PC_INVALID_INDEX) {
        const uint32_t next = longest_edge(mesh, mesh->twins[h] / 3);
        if (next == mesh->twins[h]) {
            break;
        }
        h = next;
    }
    return h;
}

// Halves the longest edge of each triangle that may touch the outline until it is shorter than
// `shortest`: the distance hardly changes faster than the way, so edges of half the threshold
// cannot hide a crossing that matters. False: no memory, or cancelled.
static bool refine_outline(outline *o, double threshold, double shortest) {
    const pci_halfedge *mesh = &o->mesh;
    pc_context *context = mesh->scratch->context;
    for (bool changed = true; changed;) {
        changed = false;
        for (uint32_t t = 0; t < mesh->triangle_count; ++t) {
            if (t % 4096 == 0 && !pci_keep_going(context)) {
                return false;
            }
            const double longest = edge_length(mesh, longest_edge(mesh, t));
            double nearest = INFINITY, farthest = 0.0;
            for (uint32_t h = 3 * t; h < 3 * t + 3; ++h) {
                nearest = fmin(nearest, o->distances[pci_origin(mesh, h)]);
                farthest = fmax(farthest, o->distances[pci_origin(mesh, h)]);
            }
            if (longest > shortest && nearest < threshold && farthest + 0.5 * longest > threshold) {
                if (!split_measured(o, terminal_edge(mesh, t), 0.5, NULL)) {
                    return false;
                }
                changed = true;
            }
        }
    }
    return true;
}


// Splits the edges that cross the isoline there. New edges end on the isoline and never cross it,
// so one pass finds all crossings.
static bool split_isoline(outline *o, double threshold) {
    for (uint32_t h = 0; h < 3 * o->mesh.triangle_count; ++h) {
        if (!pci_is_edge(&o->mesh, h)) {
            continue;
        }
        const double a = o->distances[pci_origin(&o->mesh, h)] - threshold;
        const double b = o->distances[pci_target(&o->mesh, h)] - threshold;
        if ((a < 0.0 && b > 0.0) || (a > 0.0 && b < 0.0)) {
            const double share = fmin(fmax(a / (a - b), 0.05), 0.95);
            if (!split_measured(o, h, share, &threshold)) {
                return false;
            }
        }
    }
    return true;
}

// ---- regions beside the visual mesh ---------------------------------------------------------------

typedef struct region {
    double area, rim_area; // rim: the nearest point of the visual mesh lies on a rim
    double reach;          // largest distance
    bool open;             // touches the border of the layer
} region;

typedef struct rim_job {
    const outline *o;
    const pc_mesh *surface;
    double radius;
    const uint32_t *vertices;
    uint8_t *on_rim; // #V
} rim_job;

static void test_rims(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const rim_job *job = user;
    for (size_t i = begin; i < end; ++i) {
        const size_t v = job->vertices[i];
        const pci_closest closest =
            pci_bvh_closest(job->o->visual, &job->o->mesh.positions[3 * v], INFINITY);
        job->on_rim[v] = pci_one_sided(job->o->visual, job->surface, closest.point, job->radius) >
                         PCI_RIM_ONE_SIDED;
    }
}

// Joins the triangles that lie beside the visual mesh to regions: `roots` holds the first triangle
// of each, PC_INVALID_INDEX for triangles that stay anyway.
static bool join_regions(const outline *o, double threshold, uint32_t *roots) {
    const pci_halfedge *mesh = &o->mesh;
    uint8_t *beside = PCI_SCRATCH(mesh->scratch, uint8_t, mesh->triangle_count);
    if (beside == NULL) {
        return false;
    }
    pci_singletons(roots, mesh->triangle_count);
    for (size_t i = 0; i < 3 * mesh->triangle_count; ++i) {
        beside[i / 3] |= o->distances[mesh->corners[i]] > threshold;
    }
    for (uint32_t h = 0; h < 3 * mesh->triangle_count; ++h) {
        const uint32_t twin = mesh->twins[h];
        if (twin != PC_INVALID_INDEX && h < twin && beside[h / 3] && beside[twin / 3]) {
            pci_unite(roots, h / 3, twin / 3);
        }
    }
    for (uint32_t t = 0; t < mesh->triangle_count; ++t) {
        roots[t] = beside[t] ? pci_find_root(roots, t) : PC_INVALID_INDEX;
    }
    return true;
}

static bool measure_regions(const outline *o, const pc_mesh *surface, double radius,
                            const uint32_t *roots, region *regions) {
    const pci_halfedge *mesh = &o->mesh;
    pci_scratch *scratch = mesh->scratch;
    uint8_t *on_rim = PCI_SCRATCH(scratch, uint8_t, mesh->vertex_count);
    uint8_t *wanted = PCI_SCRATCH(scratch, uint8_t, mesh->vertex_count);
    uint32_t *vertices = PCI_SCRATCH(scratch, uint32_t, mesh->vertex_count);
    if (scratch->failed) {
        return false;
    }
    for (size_t i = 0; i < 3 * mesh->triangle_count; ++i) {
        wanted[mesh->corners[i]] |= roots[i / 3] != PC_INVALID_INDEX;
    }
    rim_job job = {o, surface, radius, vertices, on_rim};
    size_t count = 0;
    for (uint32_t v = 0; v < mesh->vertex_count; ++v) {
        if (wanted[v]) {
            vertices[count++] = v;
        }
    }
    if (!pci_parallel_while_wanted(scratch->context, count, rim_grain, test_rims, &job)) {
        return false;
    }
    const pc_mesh triangles = {mesh->vertex_count, mesh->positions, mesh->triangle_count,
                               mesh->corners};
    for (uint32_t h = 0; h < 3 * mesh->triangle_count; ++h) {
        if (roots[h / 3] == PC_INVALID_INDEX) {
            continue;
        }
        region *r = &regions[roots[h / 3]];
        const double third = pci_triangle_area(&triangles, h / 3) / 3.0;
        r->area += third;
        r->rim_area += on_rim[mesh->corners[h]] ? third : 0.0;
        r->reach = fmax(r->reach, o->distances[mesh->corners[h]]);
        r->open = r->open || mesh->twins[h] == PC_INVALID_INDEX;
    }
    return true;
}

static bool removes(const region *r, pci_outline_mode mode, double threshold) {
    const bool membrane = r->rim_area > membrane_share * r->area;
    return r->area > 0.0 && (mode == PCI_OUTLINE_ALL || membrane) &&
           (r->reach > least_reach * threshold || (r->open && membrane));
}

// Removes what lies beside and repairs nothing else: the result has the layer's topology otherwise.
static bool remove_regions(outline *o, const pc_mesh *surface, pci_outline_mode mode,
                           double threshold, double radius, pc_mesh *layer,
                           uint64_t *removed_regions, uint64_t *removed_triangles) {
    const pci_halfedge *mesh = &o->mesh;
    pci_scratch *scratch = mesh->scratch;
    uint32_t *roots = PCI_SCRATCH(scratch, uint32_t, mesh->triangle_count);
    region *regions = PCI_SCRATCH(scratch, region, mesh->triangle_count);
    uint8_t *keep = PCI_SCRATCH(scratch, uint8_t, mesh->triangle_count);
    if (scratch->failed || !join_regions(o, threshold, roots) ||
        !measure_regions(o, surface, radius, roots, regions)) {
        return false;
    }
    for (uint32_t t = 0; t < mesh->triangle_count; ++t) {
        keep[t] = roots[t] == PC_INVALID_INDEX || !removes(&regions[roots[t]], mode, threshold);
        *removed_regions += !keep[t] && roots[t] == t;
        *removed_triangles += !keep[t];
    }
    const pc_mesh cut = {mesh->vertex_count, mesh->positions, mesh->triangle_count, mesh->corners};
    pci_repair_counts counts;
    pc_mesh kept = {0};
    if (!pci_mesh_repair(scratch, &cut, keep, &kept, &counts)) {
        return false;
    }
    pc_mesh_free(scratch->context, layer);
    *layer = kept;
    return true;
}

pc_status pci_cut_outline(pci_scratch *scratch, const char *stage, const pci_bvh *visual,
                          const pc_mesh *surface, pci_outline_mode mode, double threshold,
                          double cell_size, pc_mesh *layer, uint64_t *removed_regions,
                          uint64_t *removed_triangles) {
    // Finer than an eighth of a voxel there is nothing to see, and a layer that runs near the
    // threshold everywhere would be refined everywhere.
    const double shortest = fmax(0.5 * threshold, 0.125 * cell_size);
    outline o = {.visual = visual};
    o.normals = PCI_SCRATCH(scratch, double, 3 * layer->vertex_count);
    o.distances = PCI_SCRATCH(scratch, double, layer->vertex_count);
    if (scratch->failed || !pci_halfedge_build(scratch, layer, &o.mesh)) {
        return pci_fail_memory(scratch->context, stage);
    }
    o.normal_capacity = o.distance_capacity = layer->vertex_count;
    pci_vertex_normals(layer, o.normals);
    pci_parallel_for(scratch->context, layer->vertex_count, grain, measure_outline, &o);
    if (!refine_outline(&o, threshold, shortest) || !split_isoline(&o, threshold) ||
        !remove_regions(&o, surface, mode, threshold, rim_radius * cell_size, layer,
                        removed_regions, removed_triangles)) {
        return pci_fail_memory(scratch->context, stage);
    }
    return PC_OK;
}
