#include "proxycloth/evaluate.h"

#include "core/core.h"
#include "core/union_find.h"
#include "geometry/bvh.h"
#include "geometry/crossing.h"
#include "geometry/doubling.h"
#include "geometry/hausdorff.h"
#include "geometry/hems.h"
#include "geometry/topology.h"

static const char stage[] = "evaluate";

#define DISTANCE_TOLERANCE PCI_EFFORT(1e-4, 0.05)  // of the diagonal
#define CURVE_PIECES       PCI_EFFORT(500.0, 10.0) // along a diagonal

#define COUNT(member, help)           PCI_FIELD_REPORT(pc_measures, member, COUNT, "", help)
#define NUMBER(member, unit, help)    PCI_FIELD_REPORT(pc_measures, member, DOUBLE, unit, help)
#define DEFECT(member, help, warning) PCI_FIELD_WARNING(pc_measures, member, COUNT, help, warning)

static const pc_field measure_fields[] = {
    COUNT(vertices, "Vertices that a triangle of the proxy uses"),
    COUNT(triangles, "Triangles of the proxy"),
    COUNT(components, "Parts connected by shared edges"),
    COUNT(boundary_loops, "Closed chains of edges with one triangle"),
    NUMBER(euler_number, "", "Vertices - edges + triangles"),
    DEFECT(nonmanifold_edges, "Edges of more than two triangles",
           "the proxy has edges of more than two triangles"),
    DEFECT(nonmanifold_vertices, "Vertices whose triangles form more than one fan",
           "the proxy has vertices whose triangles form more than one fan"),
    NUMBER(doubled_area, "",
           "Share of the proxy's area with a second, nearly parallel layer within 1/16 of the "
           "visual mesh's longest side"),
    NUMBER(
        doubled_layers, "",
        "Share of the proxy's area with a second layer so close over the same sheet of the visual "
        "mesh; sheets less than 1/32 of its longest side apart are one, but for gaps outside"),
    DEFECT(self_intersections, "Pairs of triangles that cross", "the proxy crosses itself"),
    NUMBER(hausdorff, "diagonal", "Two-sided Hausdorff distance"),
    NUMBER(hausdorff_visual_to_proxy, "diagonal",
           "Largest distance of the visual mesh from the proxy"),
    NUMBER(hausdorff_proxy_to_visual, "diagonal",
           "Largest distance of the proxy from the visual mesh"),
    NUMBER(hausdorff_unit_cube, "",
           "Two-sided Hausdorff distance with the visual mesh scaled into [-1, 1]^3"),
    NUMBER(opening_length, "diagonal", "Length of the visual mesh's hems"),
    NUMBER(boundary_length, "diagonal", "Length of the proxy's boundary"),
    NUMBER(boundary_to_opening_mean, "diagonal",
           "Distance of the proxy's boundary from the visual mesh's hems, mean"),
    NUMBER(boundary_to_opening_max, "diagonal",
           "Distance of the proxy's boundary from the visual mesh's hems, largest"),
    NUMBER(opening_to_boundary_mean, "diagonal",
           "Distance of the visual mesh's hems from the proxy's boundary, mean"),
    NUMBER(opening_to_boundary_max, "diagonal",
           "Distance of the visual mesh's hems from the proxy's boundary, largest"),
    NUMBER(min_angle_mean, "degrees", "Smallest angle of a triangle, mean"),
    NUMBER(min_angle_sd, "degrees", "Smallest angle of a triangle, standard deviation"),
    NUMBER(min_angle_worst, "degrees", "Smallest angle of all triangles"),
    NUMBER(edge_ratio_mean, "", "Shortest over longest edge, mean"),
    NUMBER(edge_ratio_sd, "", "Shortest over longest edge, standard deviation"),
    NUMBER(edge_ratio_worst, "", "Shortest over longest edge, worst triangle"),
    NUMBER(aspect_ratio_mean, "",
           "Smallest height over longest edge (.866 when equilateral), mean"),
    NUMBER(aspect_ratio_sd, "", "Smallest height over longest edge, standard deviation"),
    NUMBER(aspect_ratio_worst, "", "Smallest height over longest edge, worst triangle"),
    NUMBER(radius_ratio_mean, "", "2 inradius over circumradius, mean"),
    NUMBER(radius_ratio_sd, "", "2 inradius over circumradius, standard deviation"),
    NUMBER(radius_ratio_worst, "", "2 inradius over circumradius, worst triangle"),
};
const pc_record pc_measures_record = PCI_RECORD(measure_fields, pc_measures);

static pc_status check_mesh(pc_context *context, const pc_mesh *mesh, const char *name) {
    if (mesh->triangle_count == 0) {
        return pci_fail(context, PC_ERROR_INVALID_MESH, stage, "%s: the %s mesh has no triangle",
                        stage, name);
    }
    if (mesh->triangle_count >= PC_INVALID_INDEX / 3) { // corners have 32-bit indices
        return pci_fail(context, PC_ERROR_TOO_LARGE, stage,
                        "%s: %zu triangles of the %s mesh are too many", stage,
                        mesh->triangle_count, name);
    }
    for (size_t i = 0; i < 3 * mesh->triangle_count; ++i) {
        const uint32_t v = mesh->triangles[i];
        if (v >= mesh->vertex_count) {
            return pci_fail(context, PC_ERROR_INVALID_MESH, stage,
                            "%s: triangle %zu of the %s mesh uses vertex %u of %zu", stage, i / 3,
                            name, v, mesh->vertex_count);
        }
        for (size_t k = 0; k < 3; ++k) {
            if (!(fabs(mesh->positions[3 * (size_t)v + k]) <= PCI_FARTHEST)) {
                return pci_fail(context, PC_ERROR_INVALID_MESH, stage,
                                "%s: vertex %u of the %s mesh is not finite or too large", stage, v,
                                name);
            }
        }
    }
    return PC_OK;
}

// ---- topology ---------------------------------------------------------------------------------

static uint32_t corner_at(const pc_mesh *mesh, uint32_t triangle, uint32_t vertex) {
    const uint32_t *corner = &mesh->triangles[3 * (size_t)triangle];
    return 3 * triangle + (corner[0] == vertex ? 0U : corner[1] == vertex ? 1U : 2U);
}

// Fans are classes of corners joined across the edges at a vertex.
static void join_fans(const pci_topology *topology, const pc_mesh *mesh, uint32_t *fan) {
    pci_singletons(fan, 3 * mesh->triangle_count);
    for (size_t e = 0; e < topology->edge_count; ++e) {
        const uint32_t *sides = pci_sides(topology, e);
        for (size_t k = 1; k < pci_side_count(topology, e); ++k) {
            for (size_t end = 0; end < 2; ++end) {
                const uint32_t v = topology->edges[2 * e + end];
                pci_unite(fan, corner_at(mesh, sides[0], v), corner_at(mesh, sides[k], v));
            }
        }
    }
}

static void count_vertices(const pci_topology *topology, const pc_mesh *mesh, uint32_t *fan,
                           pc_measures *measures) {
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        const size_t begin = topology->vertex_triangle_offsets[v];
        const size_t end = topology->vertex_triangle_offsets[v + 1];
        bool one_fan = true;
        for (size_t k = begin + 1; k < end && one_fan; ++k) {
            const uint32_t a = corner_at(mesh, topology->vertex_triangles[begin], (uint32_t)v);
            const uint32_t b = corner_at(mesh, topology->vertex_triangles[k], (uint32_t)v);
            one_fan = pci_find_root(fan, a) == pci_find_root(fan, b);
        }
        measures->vertices += begin < end;
        measures->nonmanifold_vertices += !one_fan;
    }
}

// Boundary edges that end at the same fan belong to one loop. Unlike pci_boundary_loops this needs
// no consistent winding. `first` is zeroed.
static uint64_t count_boundary_loops(const pci_topology *topology, const pc_mesh *mesh,
                                     uint32_t *fan, uint32_t *loop, uint32_t *first) {
    uint64_t loops = 0;
    for (size_t e = 0; e < topology->edge_count; ++e) {
        if (pci_side_count(topology, e) != 1) {
            continue;
        }
        loop[e] = (uint32_t)e;
        ++loops;
        for (size_t end = 0; end < 2; ++end) {
            const uint32_t v = topology->edges[2 * e + end];
            const uint32_t at = pci_find_root(fan, corner_at(mesh, *pci_sides(topology, e), v));
            if (first[at] == 0) {
                first[at] = (uint32_t)e + 1;
            } else {
                loops -= pci_unite(loop, (uint32_t)e, first[at] - 1);
            }
        }
    }
    return loops;
}

static pc_status measure_topology(pc_context *context, const pc_mesh *proxy,
                                  pc_measures *measures) {
    pci_scratch scratch = pci_scratch_begin(context);
    pc_status status = PC_OK;
    // Triangles with a repeated vertex are edges or points and no part of the surface.
    pc_mesh surface = *proxy;
    surface.triangle_count = 0;
    surface.triangles = PCI_SCRATCH(&scratch, uint32_t, 3 * proxy->triangle_count);
    if (scratch.failed) {
        status = pci_fail_memory(context, stage);
        goto cleanup;
    }
    for (size_t t = 0; t < proxy->triangle_count; ++t) {
        const uint32_t *corner = &proxy->triangles[3 * t];
        if (corner[0] != corner[1] && corner[1] != corner[2] && corner[2] != corner[0]) {
            memcpy(&surface.triangles[3 * surface.triangle_count++], corner, 3 * sizeof(*corner));
        }
    }
    pci_topology topology;
    uint32_t *component = PCI_SCRATCH(&scratch, uint32_t, surface.triangle_count);
    uint32_t *fan = PCI_SCRATCH(&scratch, uint32_t, 3 * surface.triangle_count);
    uint32_t *first = PCI_SCRATCH(&scratch, uint32_t, 3 * surface.triangle_count);
    if (scratch.failed || !pci_topology_build(&scratch, &surface, &topology)) {
        status = pci_fail_memory(context, stage);
        goto cleanup;
    }
    uint32_t *loop = PCI_SCRATCH(&scratch, uint32_t, topology.edge_count);
    measures->components = pci_triangle_components(&scratch, &surface, &topology, component);
    if (scratch.failed) {
        status = pci_fail_memory(context, stage);
        goto cleanup;
    }
    join_fans(&topology, &surface, fan);
    count_vertices(&topology, &surface, fan, measures);
    measures->triangles = proxy->triangle_count;
    measures->boundary_loops = count_boundary_loops(&topology, &surface, fan, loop, first);
    measures->nonmanifold_edges = pci_nonmanifold_edge_count(&topology);
    measures->euler_number =
        (double)measures->vertices - (double)topology.edge_count + (double)surface.triangle_count;

cleanup:
    pci_scratch_end(&scratch);
    return status;
}

// ---- boundaries -------------------------------------------------------------------------------

// Segments with a tree to find the nearest.
typedef struct curves {
    pc_mesh mesh; // one degenerate triangle per segment
    pci_bvh *bvh;
    double length;
} curves;

static pc_status build_curves(pci_scratch *scratch, const double *points, size_t count,
                              curves *result) {
    uint32_t *triangles = PCI_SCRATCH(scratch, uint32_t, 3 * count);
    double *copy = PCI_SCRATCH(scratch, double, 6 * count);
    if (scratch->failed) {
        return pci_fail_memory(scratch->context, stage);
    }
    result->mesh = (pc_mesh){2 * count, copy, count, triangles};
    for (size_t i = 0; i < count; ++i) {
        memcpy(&copy[6 * i], &points[6 * i], 6 * sizeof(double));
        triangles[3 * i] = (uint32_t)(2 * i);
        triangles[3 * i + 1] = triangles[3 * i + 2] = (uint32_t)(2 * i + 1);
        result->length += sqrt(pci_squared_distance(&points[6 * i], &points[6 * i + 3]));
    }
    return count == 0 ? PC_OK
                      : pci_bvh_create(scratch->context, stage, &result->mesh, &result->bvh);
}

// Of one segment, which may be longer than the visual mesh is wide.
static const double most_pieces = PCI_EFFORT(1e4, 20.0);

typedef struct strayed {
    const curves *from, *to;
    double spacing;
    double *sums, *most; // per segment: mean distance times length, largest distance
} strayed;

static void measure_segments(void *user, size_t begin, size_t end, uint32_t worker) {
    strayed *s = user;
    (void)worker;
    for (size_t i = begin; i < end; ++i) {
        const double *a = &s->from->mesh.positions[6 * i], *b = a + 3;
        const double length = sqrt(pci_squared_distance(a, b));
        const size_t pieces = (size_t)fmin(fmax(1.0, ceil(length / s->spacing)), most_pieces);
        for (size_t j = 0; j <= pieces; ++j) {
            double point[3];
            for (size_t k = 0; k < 3; ++k) {
                point[k] = a[k] + (b[k] - a[k]) * ((double)j / (double)pieces);
            }
            const double distance = pci_bvh_closest(s->to->bvh, point, INFINITY).distance;
            const double weight = j == 0 || j == pieces ? 0.5 : 1.0; // trapezoidal rule
            s->sums[i] += weight * distance * length / (double)pieces;
            s->most[i] = fmax(s->most[i], distance);
        }
    }
}

static pc_status measure_curves(pci_scratch *scratch, const curves *from, const curves *to,
                                double diagonal, double *mean, double *most) {
    const size_t count = from->mesh.triangle_count;
    if (count == 0 || to->bvh == NULL || !(from->length > 0.0)) {
        *mean = *most = count == 0 && to->bvh == NULL ? 0.0 : 1.0;
        return PC_OK;
    }
    strayed s = {from, to, diagonal / CURVE_PIECES, PCI_SCRATCH(scratch, double, count),
                 PCI_SCRATCH(scratch, double, count)};
    if (scratch->failed) {
        return pci_fail_memory(scratch->context, stage);
    }
    pci_parallel_for(scratch->context, count, 64, measure_segments, &s);
    *mean = *most = 0.0;
    for (size_t i = 0; i < count; ++i) {
        *mean += s.sums[i] / (from->length * diagonal);
        *most = fmax(*most, s.most[i] / diagonal);
    }
    return PC_OK;
}

// Edges of one triangle as pairs of points, from scratch.
static bool boundary_segments(pci_scratch *scratch, const pc_mesh *mesh, double **points,
                              size_t *count) {
    pci_topology topology;
    if (!pci_topology_build(scratch, mesh, &topology)) {
        return false;
    }
    *points = PCI_SCRATCH(scratch, double, 6 * topology.edge_count);
    for (size_t e = 0; e < topology.edge_count && *points != NULL; ++e) {
        if (pci_side_count(&topology, e) == 1) {
            for (size_t end = 0; end < 2; ++end) {
                memcpy(&(*points)[6 * *count + 3 * end],
                       &mesh->positions[3 * (size_t)topology.edges[2 * e + end]],
                       3 * sizeof(double));
            }
            ++*count;
        }
    }
    return *points != NULL;
}

static pc_status measure_boundary(pc_context *context, const pc_mesh *visual,
                                  const pci_bvh *visual_bvh, const pc_mesh *proxy, double voxel,
                                  double diagonal, pc_measures *measures) {
    pci_scratch scratch = pci_scratch_begin(context);
    pci_topology topology;
    pci_hems hems;
    curves openings = {{0}, NULL, 0.0}, boundary = {{0}, NULL, 0.0};
    double *points = NULL;
    size_t count = 0;
    pc_status status = PC_OK;
    if (!pci_topology_build_edges(&scratch, visual, &topology) ||
        !pci_find_hems(&scratch, visual, &topology, visual_bvh, voxel, &hems) ||
        !boundary_segments(&scratch, proxy, &points, &count)) {
        status = pci_fail_memory(context, stage);
    }
    if (status == PC_OK) {
        status = build_curves(&scratch, hems.points, hems.count, &openings);
    }
    if (status == PC_OK) {
        status = build_curves(&scratch, points, count, &boundary);
    }
    if (status == PC_OK) {
        status =
            measure_curves(&scratch, &boundary, &openings, diagonal,
                           &measures->boundary_to_opening_mean, &measures->boundary_to_opening_max);
    }
    if (status == PC_OK) {
        status =
            measure_curves(&scratch, &openings, &boundary, diagonal,
                           &measures->opening_to_boundary_mean, &measures->opening_to_boundary_max);
    }
    measures->opening_length = openings.length / diagonal;
    measures->boundary_length = boundary.length / diagonal;
    pci_bvh_destroy(context, boundary.bvh);
    pci_bvh_destroy(context, openings.bvh);
    pci_scratch_end(&scratch);
    return status;
}

// ---- distance ---------------------------------------------------------------------------------
static void used_box(const pc_mesh *mesh, double minimum[3], double maximum[3]) {
    for (size_t k = 0; k < 3; ++k) {
        minimum[k] = INFINITY, maximum[k] = -INFINITY;
        for (size_t i = 0; i < 3 * mesh->triangle_count; ++i) {
            const double x = mesh->positions[3 * (size_t)mesh->triangles[i] + k];
            minimum[k] = fmin(minimum[k], x);
            maximum[k] = fmax(maximum[k], x);
        }
    }
}

static pc_status measure_space(pc_context *context, const pc_mesh *visual, const pc_mesh *proxy,
                               pc_measures *measures) {
    double minimum[3], maximum[3], size[3];
    used_box(visual, minimum, maximum);
    pci_sub(maximum, minimum, size);
    const double diagonal = pci_norm(size), longest = fmax(fmax(size[0], size[1]), size[2]);
    if (!(diagonal > 0.0)) {
        return pci_fail(context, PC_ERROR_INVALID_MESH, stage,
                        "%s: all positions of the visual mesh are equal", stage);
    }
    pci_bvh *visual_bvh = NULL, *proxy_bvh = NULL;
    double there = 0.0, back = 0.0;
    pci_doubling doubling = {0};
    const double voxel = longest / 32.0; // at the paper's resolution
    const double tolerance = DISTANCE_TOLERANCE * diagonal;
    pc_status status = pci_bvh_create(context, stage, visual, &visual_bvh);
    if (status == PC_OK) {
        status = pci_bvh_create(context, stage, proxy, &proxy_bvh);
    }
    if (status == PC_OK) {
        status =
            pci_directed_hausdorff(context, stage, visual, proxy, proxy_bvh, tolerance, &there);
    }
    if (status == PC_OK) {
        status =
            pci_directed_hausdorff(context, stage, proxy, visual, visual_bvh, tolerance, &back);
    }
    if (status == PC_OK) {
        status =
            pci_measure_doubling(context, stage, proxy, proxy_bvh, visual_bvh, voxel, &doubling);
    }
    if (status == PC_OK) {
        status = measure_boundary(context, visual, visual_bvh, proxy, voxel, diagonal, measures);
    }
    measures->doubled_area = doubling.close;
    measures->doubled_layers = doubling.surplus;
    measures->hausdorff_visual_to_proxy = there / diagonal;
    measures->hausdorff_proxy_to_visual = back / diagonal;
    measures->hausdorff = fmax(there, back) / diagonal;
    measures->hausdorff_unit_cube = 2.0 * fmax(there, back) / longest;
    pci_bvh_destroy(context, proxy_bvh);
    pci_bvh_destroy(context, visual_bvh);
    return status;
}

// ---- shape of the triangles -------------------------------------------------------------------

// All 0 for a triangle without area.
static void triangle_shape(const pc_mesh *mesh, size_t triangle, double value[PC_SHAPE_COUNT]) {
    const uint32_t *corner = &mesh->triangles[3 * triangle];
    double edge[3];
    for (size_t c = 0; c < 3; ++c) {
        edge[c] = sqrt(pci_squared_distance(&mesh->positions[3 * (size_t)corner[(c + 1) % 3]],
                                            &mesh->positions[3 * (size_t)corner[(c + 2) % 3]]));
    }
    const double area = pci_triangle_area(mesh, triangle);
    const double longest = fmax(fmax(edge[0], edge[1]), edge[2]);
    const double shortest = fmin(fmin(edge[0], edge[1]), edge[2]);
    memset(value, 0, PC_SHAPE_COUNT * sizeof(*value));
    if (!(area > 0.0) || !(shortest > 0.0)) {
        return;
    }
    // The smallest angle is opposite to the shortest edge; tan = sin / cos from area and edges.
    const double squares = edge[0] * edge[0] + edge[1] * edge[1] + edge[2] * edge[2];
    const double angle = atan2(4.0 * area, squares - 2.0 * shortest * shortest);
    const double half_perimeter = 0.5 * (edge[0] + edge[1] + edge[2]);
    value[PC_SHAPE_MIN_ANGLE] = angle * (180.0 / acos(-1.0));
    value[PC_SHAPE_EDGE_RATIO] = shortest / longest;
    value[PC_SHAPE_ASPECT_RATIO] = 2.0 * area / longest / longest;
    value[PC_SHAPE_RADIUS_RATIO] =
        8.0 * area * area / (half_perimeter * edge[0] * edge[1] * edge[2]);
}

static pc_status measure_triangles(pc_context *context, const pc_mesh *proxy,
                                   pc_measures *measures) {
    pci_scratch scratch = pci_scratch_begin(context);
    const size_t count = proxy->triangle_count;
    double *values = PCI_SCRATCH(&scratch, double, PC_SHAPE_COUNT *count);
    if (scratch.failed) {
        pci_scratch_end(&scratch);
        return pci_fail_memory(context, stage);
    }
    for (size_t t = 0; t < count; ++t) {
        triangle_shape(proxy, t, &values[PC_SHAPE_COUNT * t]);
    }
    double *const targets[PC_SHAPE_COUNT][3] = {
        {&measures->min_angle_mean, &measures->min_angle_sd, &measures->min_angle_worst},
        {&measures->edge_ratio_mean, &measures->edge_ratio_sd, &measures->edge_ratio_worst},
        {&measures->aspect_ratio_mean, &measures->aspect_ratio_sd, &measures->aspect_ratio_worst},
        {&measures->radius_ratio_mean, &measures->radius_ratio_sd, &measures->radius_ratio_worst},
    };
    for (size_t q = 0; q < PC_SHAPE_COUNT; ++q) {
        double sum = 0.0, squares = 0.0, worst = INFINITY;
        for (size_t t = 0; t < count; ++t) {
            sum += values[PC_SHAPE_COUNT * t + q];
            worst = fmin(worst, values[PC_SHAPE_COUNT * t + q]);
        }
        const double mean = sum / (double)count;
        for (size_t t = 0; t < count; ++t) {
            const double offset = values[PC_SHAPE_COUNT * t + q] - mean;
            squares += offset * offset;
        }
        *targets[q][0] = mean;
        *targets[q][1] = sqrt(squares / (double)count);
        *targets[q][2] = worst;
    }
    pci_scratch_end(&scratch);
    return PC_OK;
}

pc_status pc_evaluate(pc_context *context, const pc_mesh *visual, const pc_mesh *proxy,
                      pc_measures *measures) {
    if (visual == NULL || proxy == NULL || measures == NULL) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage, "%s: an argument is NULL",
                        stage);
    }
    memset(measures, 0, sizeof(*measures));
    pc_status status = check_mesh(context, visual, "visual");
    if (status == PC_OK) {
        status = check_mesh(context, proxy, "proxy");
    }
    if (status == PC_OK) {
        status = measure_topology(context, proxy, measures);
    }
    if (status == PC_OK) {
        status = measure_space(context, visual, proxy, measures);
    }
    if (status == PC_OK) {
        status = pci_count_self_intersections(context, stage, proxy, &measures->self_intersections);
    }
    if (status == PC_OK) {
        status = measure_triangles(context, proxy, measures);
    }
    if (status != PC_OK) {
        memset(measures, 0, sizeof(*measures));
    }
    return status;
}

pc_status pc_evaluate_shape(pc_context *context, const pc_mesh *mesh,
                            pc_histogram histograms[PC_SHAPE_COUNT]) {
    static const pc_histogram empty[PC_SHAPE_COUNT] = {{.name = "min_angle", .maximum = 60.0},
                                                       {.name = "edge_ratio", .maximum = 1.0},
                                                       {.name = "aspect_ratio", .maximum = 1.0},
                                                       {.name = "radius_ratio", .maximum = 1.0}};
    if (mesh == NULL || histograms == NULL) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage, "%s: an argument is NULL",
                        stage);
    }
    memset(histograms, 0, PC_SHAPE_COUNT * sizeof(*histograms));
    const pc_status status = check_mesh(context, mesh, "proxy");
    if (status != PC_OK) {
        return status;
    }
    memcpy(histograms, empty, sizeof(empty));
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        double values[PC_SHAPE_COUNT];
        triangle_shape(mesh, t, values);
        for (size_t s = 0; s < PC_SHAPE_COUNT; ++s) {
            const double bin = PC_HISTOGRAM_BINS * values[s] / histograms[s].maximum;
            ++histograms[s].counts[(size_t)fmin(bin, PC_HISTOGRAM_BINS - 1)];
        }
    }
    return PC_OK;
}
