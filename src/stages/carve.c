#include "proxycloth/carve.h"

#include "core/bvh.h"
#include "core/core.h"
#include "core/halfedge.h"
#include "core/manifold.h"
#include "core/topology.h"
#include "stages/border.h"

static const char stage[] = "carve";

static const pc_field option_fields[] = {
    PCI_FIELD_OPTION(pc_carve_options, carve, BOOL, 0, 0, 1, "",
                     "Cut the surface along the outline of the visual mesh (section 5.1)"),
    PCI_FIELD_OPTION(
        pc_carve_options, carve_distance, DOUBLE, 0.25, 0.05, 10.0, "voxels",
        "epsilon_carved: surface farther than this beside the visual mesh is cut away"),
    PCI_FIELD_OPTION(pc_carve_options, smallest_part, DOUBLE, 0.05, 0.0, 1.0, "",
                     "Parts below this share of the largest part's area are dropped"),
    PCI_FIELD_OPTION(pc_carve_options, fill_loops, UINT, 12, 0, 1000, "edges",
                     "Boundary loops up to this length are filled"),
};
const pc_record pc_carve_options_record = PCI_RECORD(option_fields, pc_carve_options);

static const pc_field report_fields[] = {
    PCI_FIELD_REPORT(pc_carve_report, vertices, COUNT, "", "Vertices of the single layer"),
    PCI_FIELD_REPORT(pc_carve_report, triangles, COUNT, "", "Triangles of the single layer"),
    PCI_FIELD_REPORT(pc_carve_report, components, COUNT, "", "Connected parts"),
    PCI_FIELD_REPORT(pc_carve_report, boundary_loops, COUNT, "", "Closed boundary curves"),
    PCI_FIELD_REPORT(pc_carve_report, dropped_parts, COUNT, "", "Parts that were too small"),
    PCI_FIELD_REPORT(pc_carve_report, filled_loops, COUNT, "", "Boundary loops that were filled"),
    PCI_FIELD_REPORT(pc_carve_report, carved_triangles, COUNT, "",
                     "Triangles cut away beside the visual mesh"),
    PCI_FIELD_REPORT(pc_carve_report, coverage, DOUBLE, "",
                     "Share of the visual mesh's vertices within 2 voxels of the layer"),
};
const pc_record pc_carve_report_record = PCI_RECORD(report_fields, pc_carve_report);

// What the visual mesh covers is within this many voxels of the layer.
static const double covered_voxels = 2.0;
// Pieces of parallel loops.
enum { grain = 256 };

// A loop that bounds a part from outside is no hole: filling it would close the part to a pillow.
// The part must have this many times the area of a disc with the loop's circumference.
static const double hole_area_ratio = 2.0;

static bool loop_is_hole(const pc_mesh *mesh, const uint32_t *loop, size_t length, double area) {
    double perimeter = 0.0;
    for (size_t i = 0; i < length; ++i) {
        perimeter +=
            sqrt(pci_squared_distance(&mesh->positions[3 * (size_t)loop[i]],
                                      &mesh->positions[3 * (size_t)loop[(i + 1) % length]]));
    }
    const double pi = 3.14159265358979323846;
    return area > hole_area_ratio * perimeter * perimeter / (4.0 * pi);
}

// Area of the part that each vertex belongs to.
static bool vertex_part_areas(pci_scratch *scratch, const pc_mesh *mesh,
                              const pci_topology *topology, double **vertex_areas) {
    uint32_t *component = PCI_SCRATCH(scratch, uint32_t, mesh->triangle_count);
    *vertex_areas = PCI_SCRATCH(scratch, double, mesh->vertex_count);
    if (scratch->failed) {
        return false;
    }
    const size_t count = pci_triangle_components(scratch, mesh, topology, component);
    double *areas = PCI_SCRATCH(scratch, double, count);
    if (areas == NULL) {
        return false;
    }
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        areas[component[t]] += pci_triangle_area(mesh, t);
    }
    for (size_t c = 0; c < 3 * mesh->triangle_count; ++c) {
        (*vertex_areas)[mesh->triangles[c]] = areas[component[c / 3]];
    }
    return true;
}

// Closes short loops with a fan around their mean, or with one triangle.
static bool fill_loops(pci_scratch *scratch, pc_mesh *mesh, size_t longest, uint64_t *filled) {
    pci_topology topology;
    size_t loop_count = 0, *offsets = NULL;
    uint32_t *loops = NULL;
    double *areas = NULL;
    if (!pci_topology_build(scratch, mesh, &topology) ||
        !pci_boundary_loops(scratch, mesh, &topology, &loop_count, &offsets, &loops) ||
        !vertex_part_areas(scratch, mesh, &topology, &areas)) {
        return false;
    }
    uint8_t *hole = PCI_SCRATCH(scratch, uint8_t, loop_count);
    if (hole == NULL) {
        return false;
    }
    size_t vertices = mesh->vertex_count, triangles = mesh->triangle_count;
    for (size_t i = 0; i < loop_count; ++i) {
        const size_t length = offsets[i + 1] - offsets[i];
        const uint32_t *loop = &loops[offsets[i]];
        if (length >= 3 && length <= longest && loop_is_hole(mesh, loop, length, areas[loop[0]])) {
            hole[i] = 1;
            ++*filled;
            vertices += length > 3;
            triangles += length > 3 ? length : 1;
        }
    }
    if (*filled == 0) {
        return true;
    }
    pc_context *context = scratch->context;
    pc_mesh out = {vertices, PCI_ALLOCATE(context, double, 3 * vertices), triangles,
                   PCI_ALLOCATE(context, uint32_t, 3 * triangles)};
    if (out.positions == NULL || out.triangles == NULL) {
        pc_mesh_free(context, &out);
        return false;
    }
    memcpy(out.positions, mesh->positions, 3 * mesh->vertex_count * sizeof(double));
    memcpy(out.triangles, mesh->triangles, 3 * mesh->triangle_count * sizeof(uint32_t));
    uint32_t center = (uint32_t)mesh->vertex_count;
    uint32_t *write = &out.triangles[3 * mesh->triangle_count];
    for (size_t i = 0; i < loop_count; ++i) {
        const size_t length = offsets[i + 1] - offsets[i];
        const uint32_t *loop = &loops[offsets[i]];
        if (!hole[i]) {
            continue;
        }
        if (length == 3) {
            *write++ = loop[0], *write++ = loop[2], *write++ = loop[1];
            continue;
        }
        for (size_t j = 0; j < length; ++j) {
            *write++ = loop[(j + 1) % length], *write++ = loop[j], *write++ = center;
            for (size_t k = 0; k < 3; ++k) {
                out.positions[3 * (size_t)center + k] +=
                    mesh->positions[3 * (size_t)loop[j] + k] / (double)length;
            }
        }
        ++center;
    }
    pc_mesh_free(context, mesh);
    *mesh = out;
    return true;
}

// ---- carving along the outline of the visual mesh ---------------------------------------------

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

// Cuts along the isoline of the distance to the visual mesh's footprint and keeps the near side.
static pc_status carve_outline(pci_scratch *scratch, const pc_mesh *surface, double threshold,
                               double cell_size, pc_mesh *mesh, uint64_t *carved) {
    pc_context *context = scratch->context;
    // Finer than an eighth of a voxel there is nothing to see, and a layer that runs near the
    // threshold everywhere would be refined everywhere.
    const double shortest = fmax(0.5 * threshold, 0.125 * cell_size);
    pci_bvh *visual = NULL;
    pc_status status = pci_bvh_create(context, stage, surface, &visual);
    if (status != PC_OK) {
        return status;
    }
    outline o = {.visual = visual};
    pc_mesh kept = {0};
    status = PC_ERROR_OUT_OF_MEMORY;
    o.normals = PCI_SCRATCH(scratch, double, 3 * mesh->vertex_count);
    o.distances = PCI_SCRATCH(scratch, double, mesh->vertex_count);
    if (!scratch->failed && pci_halfedge_build(scratch, mesh, &o.mesh)) {
        o.normal_capacity = o.distance_capacity = mesh->vertex_count;
        pci_vertex_normals(mesh, o.normals);
        pci_parallel_for(context, mesh->vertex_count, grain, measure_outline, &o);
        bool done = refine_outline(&o, threshold, shortest);
        // New edges end on the isoline and never cross it, so one pass finds all crossings.
        for (uint32_t h = 0; done && h < 3 * o.mesh.triangle_count; ++h) {
            if (pci_is_edge(&o.mesh, h)) {
                const double a = o.distances[pci_origin(&o.mesh, h)] - threshold;
                const double b = o.distances[pci_target(&o.mesh, h)] - threshold;
                if ((a < 0.0 && b > 0.0) || (a > 0.0 && b < 0.0)) {
                    const double share = fmin(fmax(a / (a - b), 0.05), 0.95);
                    done = split_measured(&o, h, share, &threshold);
                }
            }
        }
        uint8_t *keep = done ? PCI_SCRATCH(scratch, uint8_t, o.mesh.triangle_count) : NULL;
        if (keep != NULL) {
            for (size_t t = 0; t < o.mesh.triangle_count; ++t) {
                keep[t] = 1;
                for (size_t c = 0; c < 3; ++c) {
                    keep[t] &= o.distances[o.mesh.corners[3 * t + c]] <= threshold;
                }
                *carved += !keep[t];
            }
            const pc_mesh cut = {o.mesh.vertex_count, o.mesh.positions, o.mesh.triangle_count,
                                 o.mesh.corners};
            pci_repair_counts counts;
            if (pci_mesh_repair(scratch, &cut, keep, &kept, &counts)) {
                pc_mesh_free(context, mesh);
                *mesh = kept;
                status = PC_OK;
            }
        }
    }
    pci_bvh_destroy(context, visual);
    return status == PC_OK ? PC_OK : pci_fail_memory(context, stage);
}

// ---- report -----------------------------------------------------------------------------------

typedef struct coverage_job {
    const pci_bvh *layer;
    const pc_mesh *surface;
    double radius;
    uint32_t *covered; // per piece
} coverage_job;

static void count_covered(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const coverage_job *job = user;
    for (size_t v = begin; v < end; ++v) {
        const pci_closest closest =
            pci_bvh_closest(job->layer, &job->surface->positions[3 * v], job->radius);
        job->covered[begin / grain] += closest.triangle != PC_INVALID_INDEX;
    }
}

static pc_status measure(pci_scratch *scratch, const pc_mesh *surface, const pc_mesh *mesh,
                         double cell_size, pc_carve_report *report) {
    pc_context *context = scratch->context;
    pci_topology topology;
    size_t loop_count = 0, *offsets = NULL;
    uint32_t *loops = NULL;
    uint32_t *component = PCI_SCRATCH(scratch, uint32_t, mesh->triangle_count);
    uint32_t *covered = PCI_SCRATCH(scratch, uint32_t, surface->vertex_count / grain + 1);
    if (scratch->failed || !pci_topology_build(scratch, mesh, &topology) ||
        !pci_boundary_loops(scratch, mesh, &topology, &loop_count, &offsets, &loops)) {
        return pci_fail_memory(context, stage);
    }
    report->vertices = mesh->vertex_count;
    report->triangles = mesh->triangle_count;
    report->boundary_loops = loop_count;
    report->components = pci_triangle_components(scratch, mesh, &topology, component);
    pci_bvh *layer = NULL;
    const pc_status status = pci_bvh_create(context, stage, mesh, &layer);
    if (status != PC_OK) {
        return status;
    }
    coverage_job job = {layer, surface, covered_voxels * cell_size, covered};
    pci_parallel_for(context, surface->vertex_count, grain, count_covered, &job);
    uint64_t sum = 0;
    for (size_t i = 0; i <= surface->vertex_count / grain; ++i) {
        sum += covered[i];
    }
    report->coverage = (double)sum / (double)surface->vertex_count;
    pci_bvh_destroy(context, layer);
    return scratch->failed ? pci_fail_memory(context, stage) : PC_OK;
}

// ---- entry ------------------------------------------------------------------------------------

static pc_status check_arguments(pc_context *context, const pc_mesh *surface,
                                 const pc_mesh *projected, const pc_labels *labels,
                                 double cell_size, const pc_mesh *single_layer) {
    pc_status status = pci_check_mesh(context, stage, surface, "visual mesh");
    if (status == PC_OK) {
        status = pci_check_mesh(context, stage, projected, "projected mesh");
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
    if (!(cell_size > 0.0 && isfinite(cell_size))) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "carve: cell_size = %g, it must be positive", cell_size);
    }
    return PC_OK;
}

static pc_status no_proxy(pc_context *context, const char *reason) {
    return pci_fail(context, PC_ERROR_NO_PROXY, stage, "carve: no triangle is left, %s", reason);
}

static pc_status extract(pci_scratch *scratch, const pc_mesh *surface, const pc_mesh *projected,
                         const uint8_t *labels, double cell_size, const pc_carve_options *options,
                         pc_mesh *layer, pc_carve_report *report) {
    pc_context *context = scratch->context;
    uint8_t *keep = PCI_SCRATCH(scratch, uint8_t, projected->triangle_count);
    if (keep == NULL) {
        return pci_fail_memory(context, stage);
    }
    for (size_t t = 0; t < projected->triangle_count; ++t) {
        const uint32_t *corner = &projected->triangles[3 * t];
        keep[t] =
            (labels[corner[0]] != 0) + (labels[corner[1]] != 0) + (labels[corner[2]] != 0) >= 2;
    }
    pci_repair_counts counts;
    if (!pci_mesh_repair(scratch, projected, keep, layer, &counts) ||
        !pci_drop_small_parts(scratch, layer, options->smallest_part, &report->dropped_parts)) {
        return pci_fail_memory(context, stage);
    }
    if (layer->triangle_count == 0) {
        return no_proxy(context, "the labels keep none");
    }
    if (!pci_progress(context, stage, 0.3)) {
        return pci_fail_cancelled(context, stage);
    }
    if (!fill_loops(scratch, layer, options->fill_loops, &report->filled_loops)) {
        return pci_fail_memory(context, stage);
    }
    if (options->carve) {
        const pc_status status =
            carve_outline(scratch, surface, options->carve_distance * cell_size, cell_size, layer,
                          &report->carved_triangles);
        if (status != PC_OK) {
            return status;
        }
        uint64_t dropped = 0;
        if (!pci_drop_small_parts(scratch, layer, options->smallest_part, &dropped)) {
            return pci_fail_memory(context, stage);
        }
        report->dropped_parts += dropped;
        if (layer->triangle_count == 0) {
            return no_proxy(context, "carve_distance is too small");
        }
    }
    if (!pci_progress(context, stage, 0.8)) {
        return pci_fail_cancelled(context, stage);
    }
    const pc_status status = pci_snap_border(context, stage, surface, cell_size, layer);
    if (status != PC_OK) {
        return status;
    }
    return measure(scratch, surface, layer, cell_size, report);
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
    status =
        extract(&scratch, surface, projected, labels->labels, cell_size, &chosen, &layer, &counts);
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
