#include "proxycloth/graph.h"

#include "geometry/bvh.h"
#include "geometry/topology.h"

static const char stage[] = "graph";

#define GRAIN 64

static const pc_field option_fields[] = {
    PCI_FIELD_OPTION(pc_graph_options, opposite_reach, DOUBLE, 2.0, 0.1, 10.0, "voxels",
                     "Largest distance of opposite vertices"),
    PCI_FIELD_OPTION(pc_graph_options, opposite_epsilon, DOUBLE, 0.4, 0.0, 1.0, "",
                     "epsilon_o: opposite normals have a dot product below -1 + epsilon_o"),
    PCI_FIELD_OPTION(pc_graph_options, inward_offset, DOUBLE, 0.25, 0.0, 2.0, "voxels",
                     "Start of the ray for opposite vertices, outside the vertex"),
    PCI_FIELD_OPTION(pc_graph_options, outward_offset, DOUBLE, 0.5, 0.0, 2.0, "voxels",
                     "Start of the ray for the outer distance, outside the vertex"),
    PCI_FIELD_OPTION(pc_graph_options, tube_aspect, DOUBLE, 1.5, 0.0, 10.0, "",
                     "Solids less than so many times as wide as thick are tubes, not sheets; 0: "
                     "none is"),
};
const pc_record pc_graph_options_record = PCI_RECORD(option_fields, pc_graph_options);

static const pc_field report_fields[] = {
    PCI_FIELD_REPORT(pc_graph_report, edges, COUNT, "", "Mesh edges, the smoothness terms"),
    PCI_FIELD_REPORT(pc_graph_report, opposite_edges, COUNT, "",
                     "Pairs of vertices on the two sides of a sheet"),
    PCI_FIELD_REPORT(pc_graph_report, biased_edges, COUNT, "",
                     "Opposite edges that know which side is the outer one"),
    PCI_FIELD_REPORT(pc_graph_report, opposite_fraction, DOUBLE, "",
                     "Share of the vertices with an opposite vertex"),
    PCI_FIELD_REPORT(pc_graph_report, max_curvature, DOUBLE, "1/voxel",
                     "Largest absolute mean curvature"),
};
const pc_record pc_graph_report_record = PCI_RECORD(report_fields, pc_graph_report);

// What the parallel parts share.
typedef struct work {
    const pc_mesh *mesh;
    const pci_topology *topology;
    const double *normals;
    double *curvatures;
    const pci_bvh *bvh;
    const pc_graph_options *options;
    double cell_size;
    double *outer_distances;
    uint32_t *found; // #V by 3, opposite vertices of each vertex
} work;

// ---- mean curvature -----------------------------------------------------------------------------

#define TERMS          5   // x^2, x y, y^2, x, y
#define NEIGHBOURS     128 // of one fit; more do not add information
#define RANK_TOLERANCE 1e-3

// Least squares by Householder reflections with column exchanges: rows[r] holds TERMS coefficients
// and the right-hand side. Columns that add less than RANK_TOLERANCE of the largest one are left
// out, with solution 0.
static void least_squares(double rows[][TERMS + 1], size_t row_count, double solution[TERMS]) {
    size_t order[TERMS], rank = 0;
    double first_norm = 0.0;
    for (size_t c = 0; c < TERMS; ++c) {
        order[c] = c, solution[c] = 0.0;
    }
    for (; rank < TERMS && rank < row_count; ++rank) {
        // Exchange the longest remaining column to the front. Sums run over all columns at a time.
        size_t best = rank;
        double longest = -1.0, squares[TERMS + 1] = {0.0};
        for (size_t r = rank; r < row_count; ++r) {
            for (size_t c = 0; c <= TERMS; ++c) {
                squares[c] += rows[r][c] * rows[r][c];
            }
        }
        for (size_t c = rank; c < TERMS; ++c) {
            if (squares[order[c]] > longest) {
                longest = squares[order[c]], best = c;
            }
        }
        const double norm = sqrt(longest);
        first_norm = rank == 0 ? norm : first_norm;
        if (!(norm > RANK_TOLERANCE * first_norm)) {
            break;
        }
        const size_t column = order[best];
        order[best] = order[rank], order[rank] = column;

        // Reflect it onto the axis, and the other columns with it.
        const double head = rows[rank][column];
        const double diagonal = head > 0.0 ? -norm : norm;
        const double scale = 1.0 / (norm * (norm + fabs(head)));
        rows[rank][column] = head - diagonal;
        double along[TERMS + 1] = {0.0};
        for (size_t r = rank; r < row_count; ++r) {
            const double own = rows[r][column];
            for (size_t c = 0; c <= TERMS; ++c) {
                along[c] += own * rows[r][c];
            }
        }
        for (size_t c = 0; c <= TERMS; ++c) {
            along[c] *= scale;
        }
        for (size_t c = 0; c <= rank; ++c) {
            along[order[c]] = 0.0; // done
        }
        for (size_t r = rank; r < row_count; ++r) {
            const double own = rows[r][column];
            for (size_t c = 0; c <= TERMS; ++c) {
                rows[r][c] -= along[c] * own;
            }
        }
        rows[rank][column] = diagonal;
    }
    for (size_t k = rank; k-- > 0;) {
        double value = rows[k][TERMS];
        for (size_t c = k + 1; c < rank; ++c) {
            value -= rows[k][order[c]] * solution[order[c]];
        }
        solution[order[k]] = value / rows[k][order[k]];
    }
}

static size_t add_ring(const pci_topology *topology, uint32_t vertex, uint32_t centre,
                       uint32_t *neighbours, size_t count) {
    for (size_t r = topology->ring_offsets[vertex]; r < topology->ring_offsets[vertex + 1]; ++r) {
        const uint32_t candidate = topology->ring[r];
        bool known = candidate == centre || count == NEIGHBOURS;
        for (size_t i = 0; i < count && !known; ++i) {
            known = neighbours[i] == candidate;
        }
        if (!known) {
            neighbours[count++] = candidate;
        }
    }
    return count;
}

// Two unit vectors perpendicular to a unit vector and to each other.
static void tangent_frame(const double normal[3], double x[3], double y[3]) {
    size_t smallest = 0;
    for (size_t k = 1; k < 3; ++k) {
        smallest = fabs(normal[k]) < fabs(normal[smallest]) ? k : smallest;
    }
    double axis[3] = {0.0};
    axis[smallest] = 1.0;
    pci_cross(normal, axis, x);
    pci_normalize(x);
    pci_cross(normal, x, y);
}

// Fits h = a x^2 + b x y + c y^2 + d x + e y to the neighbours, in the frame of the vertex and in
// units of the farthest neighbour's distance, which is returned (0: no fit). `terms` gets a .. e.
static double fit_quadric(const work *w, uint32_t vertex, const uint32_t *neighbours, size_t count,
                          double terms[TERMS]) {
    double rows[NEIGHBOURS][TERMS + 1], x[3], y[3], scale = 0.0;
    const double *centre = &w->mesh->positions[3 * (size_t)vertex];
    const double *normal = &w->normals[3 * (size_t)vertex];
    for (size_t i = 0; i < count; ++i) {
        const double square =
            pci_squared_distance(&w->mesh->positions[3 * (size_t)neighbours[i]], centre);
        scale = square > scale ? square : scale;
    }
    scale = sqrt(scale);
    if (!(scale > 0.0)) {
        return 0.0;
    }
    tangent_frame(normal, x, y);
    for (size_t i = 0; i < count; ++i) {
        double away[3];
        pci_sub(&w->mesh->positions[3 * (size_t)neighbours[i]], centre, away);
        const double u = pci_dot(away, x) / scale, v = pci_dot(away, y) / scale;
        const double row[TERMS + 1] = {u * u, u * v, v * v, u, v, pci_dot(away, normal) / scale};
        memcpy(rows[i], row, sizeof(row));
    }
    least_squares(rows, count, terms);
    return scale;
}

// Absolute mean curvature of the surface (u, v, h(u, v)) at the origin. The fit takes the 2-ring:
// six neighbours for five terms would follow every wrinkle of the projected mesh, and the largest
// curvature, which scales all weights, would be noise.
static void find_curvatures(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const work *w = user;
    for (size_t v = begin; v < end; ++v) {
        const uint32_t vertex = (uint32_t)v;
        const double *normal = &w->normals[3 * v];
        if (!(pci_dot(normal, normal) > 0.0)) {
            continue;
        }
        uint32_t neighbours[NEIGHBOURS];
        const size_t inner = add_ring(w->topology, vertex, vertex, neighbours, 0);
        size_t count = inner;
        for (size_t i = 0; i < inner; ++i) {
            count = add_ring(w->topology, neighbours[i], vertex, neighbours, count);
        }
        double t[TERMS] = {0};
        const double scale = fit_quadric(w, vertex, neighbours, count, t);
        if (scale > 0.0) {
            const double hxx = 2.0 * t[0], hxy = t[1], hyy = 2.0 * t[2], hx = t[3], hy = t[4];
            const double slope = 1.0 + hx * hx + hy * hy;
            const double mean = (1.0 + hy * hy) * hxx - 2.0 * hx * hy * hxy + (1.0 + hx * hx) * hyy;
            w->curvatures[v] = fabs(mean) / (2.0 * slope * sqrt(slope) * scale);
        }
    }
}

// w_s of equation (3); returns kappa.
static double find_edge_weights(const pci_topology *topology, const double *curvatures,
                                size_t vertex_count, double *weights) {
    double largest = 0.0;
    for (size_t v = 0; v < vertex_count; ++v) {
        largest = curvatures[v] > largest ? curvatures[v] : largest;
    }
    for (size_t e = 0; e < topology->edge_count; ++e) {
        const double a = curvatures[topology->edges[2 * e]];
        const double b = curvatures[topology->edges[2 * e + 1]];
        const double ratio = largest > 0.0 ? (a > b ? a : b) / largest : 0.0;
        weights[e] = 1.0 - ratio * ratio * ratio * ratio;
    }
    return largest;
}

// ---- opposite vertices --------------------------------------------------------------------------

enum { TUBE_DIRECTIONS = 6 };
// Thinner solids are sheets, in voxels: cords of straps, for which a proxy's tube is too thick.
static const double least_tube = 1.0;

typedef struct ray_filter {
    const pc_mesh *mesh;
    uint32_t vertex;
    bool back_faces_only;
} ray_filter;

static bool accept_hit(void *user, const pci_hit *hit) {
    const ray_filter *f = user;
    const uint32_t *corner = &f->mesh->triangles[3 * (size_t)hit->triangle];
    const bool own = corner[0] == f->vertex || corner[1] == f->vertex || corner[2] == f->vertex;
    return !own && (hit->back_face || !f->back_faces_only);
}

// First hit from `offset` outside the vertex, inwards through back faces or outwards through any.
static pci_hit cast(const work *w, uint32_t vertex, double offset, bool inwards) {
    const double *v = &w->mesh->positions[3 * (size_t)vertex];
    const double *n = &w->normals[3 * (size_t)vertex];
    ray_filter filter = {.mesh = w->mesh, .vertex = vertex, .back_faces_only = inwards};
    double origin[3], direction[3];
    for (size_t k = 0; k < 3; ++k) {
        origin[k] = v[k] + offset * n[k];
        direction[k] = inwards ? -n[k] : n[k];
    }
    return pci_bvh_cast(w->bvh, origin, direction, 0.0, INFINITY, accept_hit, &filter);
}

// Whether the solid between a vertex and its opposite, `thickness` below, is the inside of a tube
// narrower than two voxels and not a sheet: across the tube it is about as wide as it is thick.
// Near the border a sheet is short on one side only.
static bool inside_tube(const work *w, uint32_t vertex, double thickness) {
    if (thickness < least_tube * w->cell_size) {
        return false;
    }
    const double *v = &w->mesh->positions[3 * (size_t)vertex];
    const double *n = &w->normals[3 * (size_t)vertex];
    const double limit = w->options->tube_aspect * thickness;
    ray_filter filter = {.mesh = w->mesh, .vertex = vertex, .back_faces_only = true};
    double x[3], y[3], middle[3];
    tangent_frame(n, x, y);
    for (size_t k = 0; k < 3; ++k) {
        middle[k] = v[k] - 0.5 * thickness * n[k];
    }
    for (size_t i = 0; i < TUBE_DIRECTIONS; ++i) {
        const double angle = PCI_PI * (double)i / TUBE_DIRECTIONS;
        double width = 0.0;
        for (int side = -1; side <= 1 && width < limit; side += 2) {
            double direction[3];
            for (size_t k = 0; k < 3; ++k) {
                direction[k] = side * (cos(angle) * x[k] + sin(angle) * y[k]);
            }
            const pci_hit hit =
                pci_bvh_cast(w->bvh, middle, direction, 0.0, limit - width, accept_hit, &filter);
            width += hit.triangle != PC_INVALID_INDEX ? hit.distance : limit;
        }
        if (width < limit) {
            return true;
        }
    }
    return false;
}

// The corners of a triangle that are near and face the other way; returns their number.
static size_t list_opposites(const work *w, size_t v, uint32_t triangle, uint32_t found[3]) {
    const double reach = w->options->opposite_reach * w->cell_size;
    size_t count = 0;
    for (size_t c = 0; c < 3; ++c) {
        const uint32_t other = w->mesh->triangles[3 * (size_t)triangle + c];
        const double square = pci_squared_distance(&w->mesh->positions[3 * v],
                                                   &w->mesh->positions[3 * (size_t)other]);
        const double cosine = pci_dot(&w->normals[3 * v], &w->normals[3 * (size_t)other]);
        if (square < reach * reach && cosine < -1.0 + w->options->opposite_epsilon) {
            found[c] = other;
            ++count;
        }
    }
    return count;
}

static void find_opposites(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const work *w = user;
    const double outward = w->options->outward_offset * w->cell_size;
    const double inward = w->options->inward_offset * w->cell_size;
    for (size_t v = begin; v < end; ++v) {
        const double *normal = &w->normals[3 * v];
        uint32_t *found = &w->found[3 * v];
        found[0] = found[1] = found[2] = PC_INVALID_INDEX;
        w->outer_distances[v] = INFINITY;
        if (!(pci_dot(normal, normal) > 0.0)) {
            continue;
        }
        const pci_hit up = cast(w, (uint32_t)v, outward, false);
        if (up.triangle != PC_INVALID_INDEX) {
            w->outer_distances[v] = outward + up.distance;
        }
        const pci_hit down = cast(w, (uint32_t)v, inward, true);
        // Tubes take the most rays: few are asked about.
        if (down.triangle != PC_INVALID_INDEX && list_opposites(w, v, down.triangle, found) > 0 &&
            inside_tube(w, (uint32_t)v, down.distance - inward)) {
            found[0] = found[1] = found[2] = PC_INVALID_INDEX;
        }
    }
}

// The pairs that the vertices found, by their smaller vertex.
typedef struct pair_lists {
    size_t *ends;       // #V, end of each vertex's list
    uint32_t *partners; // the larger vertices, ascending; invalid: the same as the one before
    size_t count;       // of distinct pairs
} pair_lists;

static bool next_pair(const work *w, size_t *i, uint32_t *first, uint32_t *second) {
    for (; *i < 3 * w->mesh->vertex_count; ++*i) {
        const uint32_t vertex = (uint32_t)(*i / 3), other = w->found[*i];
        if (other != PC_INVALID_INDEX) {
            *first = vertex < other ? vertex : other;
            *second = vertex < other ? other : vertex;
            ++*i;
            return true;
        }
    }
    return false;
}

static void sort_partners(uint32_t *partners, size_t count, size_t *distinct) {
    for (size_t i = 1; i < count; ++i) {
        const uint32_t partner = partners[i];
        size_t at = i;
        for (; at > 0 && partners[at - 1] > partner; --at) {
            partners[at] = partners[at - 1];
        }
        partners[at] = partner;
    }
    uint32_t last = PC_INVALID_INDEX;
    for (size_t i = 0; i < count; ++i) {
        if (partners[i] == last) {
            partners[i] = PC_INVALID_INDEX;
        } else {
            last = partners[i];
            ++*distinct;
        }
    }
}

static bool list_pairs(const work *w, pci_scratch *scratch, pair_lists *lists) {
    const size_t nv = w->mesh->vertex_count;
    uint32_t first = 0, second = 0;
    lists->ends = PCI_SCRATCH(scratch, size_t, nv + 1);
    lists->partners = PCI_SCRATCH(scratch, uint32_t, 3 * nv);
    if (scratch->failed) {
        return false;
    }
    // Counts, starts, and with every partner that arrives a start comes nearer to the list's end.
    for (size_t i = 0; next_pair(w, &i, &first, &second);) {
        ++lists->ends[first + 1];
    }
    for (size_t v = 0; v < nv; ++v) {
        lists->ends[v + 1] += lists->ends[v];
    }
    for (size_t i = 0; next_pair(w, &i, &first, &second);) {
        lists->partners[lists->ends[first]++] = second;
    }
    for (size_t v = 0, begin = 0; v < nv; begin = lists->ends[v++]) {
        sort_partners(&lists->partners[begin], lists->ends[v] - begin, &lists->count);
    }
    return pci_keep_going(scratch->context);
}

// Opposite edges and their signs, from what the vertices found.
static pc_status write_opposites(pc_context *context, pci_scratch *scratch, const work *w,
                                 pc_graph *graph, pc_graph_report *report) {
    const size_t nv = w->mesh->vertex_count;
    pair_lists lists = {0};
    uint8_t *paired = PCI_SCRATCH(scratch, uint8_t, nv);
    if (paired == NULL || !list_pairs(w, scratch, &lists)) {
        return pci_fail_memory(context, stage);
    }
    graph->opposites = PCI_ALLOCATE(context, uint32_t, 2 * lists.count);
    graph->opposite_signs = PCI_ALLOCATE(context, int8_t, lists.count);
    if (graph->opposites == NULL || graph->opposite_signs == NULL) {
        return pci_fail_memory(context, stage);
    }
    size_t paired_count = 0, o = 0;
    for (size_t v = 0, i = 0; v < nv; ++v) {
        for (; i < lists.ends[v]; ++i) {
            const uint32_t other = lists.partners[i];
            if (other == PC_INVALID_INDEX) {
                continue;
            }
            const double a = graph->outer_distances[v], b = graph->outer_distances[other];
            graph->opposites[2 * o] = (uint32_t)v, graph->opposites[2 * o + 1] = other;
            graph->opposite_signs[o++] = (int8_t)((a > b) - (a < b));
            report->biased_edges += a != b; // infinite against infinite compares equal
            paired[v] = paired[other] = 1;
        }
    }
    graph->opposite_count = o;
    for (size_t v = 0; v < nv; ++v) {
        paired_count += paired[v];
    }
    report->opposite_edges = o;
    report->opposite_fraction = (double)paired_count / (double)nv;
    return PC_OK;
}

// ---- stage --------------------------------------------------------------------------------------

static pc_status build(pc_context *context, pci_scratch *scratch, work *w, pc_graph *graph,
                       pc_graph_report *report) {
    const size_t nv = w->mesh->vertex_count;
    pci_topology topology;
    double *normals = PCI_SCRATCH(scratch, double, 3 * nv);
    w->found = PCI_SCRATCH(scratch, uint32_t, 3 * nv);
    if (scratch->failed || !pci_topology_build_watched(scratch, w->mesh, &topology)) {
        return pci_fail_memory(context, stage);
    }
    graph->vertex_count = nv;
    graph->edge_count = topology.edge_count;
    graph->curvatures = PCI_ALLOCATE(context, double, nv);
    graph->outer_distances = PCI_ALLOCATE(context, double, nv);
    graph->edges = PCI_ALLOCATE(context, uint32_t, 2 * topology.edge_count);
    graph->edge_weights = PCI_ALLOCATE(context, double, topology.edge_count);
    if (graph->curvatures == NULL || graph->outer_distances == NULL || graph->edges == NULL ||
        graph->edge_weights == NULL) {
        return pci_fail_memory(context, stage);
    }

    // Smoothness terms.
    pci_vertex_normals(w->mesh, normals);
    w->topology = &topology, w->normals = normals;
    w->curvatures = graph->curvatures, w->outer_distances = graph->outer_distances;
    if (!pci_parallel_while_wanted(context, nv, GRAIN, find_curvatures, w)) {
        return pci_fail_cancelled(context, stage);
    }
    memcpy(graph->edges, topology.edges, 2 * topology.edge_count * sizeof(*graph->edges));
    const double largest = find_edge_weights(&topology, graph->curvatures, nv, graph->edge_weights);
    if (!pci_progress(context, stage, 0.3)) {
        return pci_fail_cancelled(context, stage);
    }

    // Opposite terms.
    if (!pci_parallel_while_wanted(context, nv, GRAIN, find_opposites, w)) {
        return pci_fail_cancelled(context, stage);
    }
    pc_graph_report result = {.edges = topology.edge_count,
                              .max_curvature = largest * w->cell_size};
    const pc_status status = write_opposites(context, scratch, w, graph, &result);
    if (status == PC_OK && report != NULL) {
        *report = result;
    }
    return status;
}

pc_status pc_build_graph(pc_context *context, const pc_mesh *projected, double cell_size,
                         const pc_graph_options *options, pc_graph *graph,
                         pc_graph_report *report) {
    static const pc_graph empty = {0};
    if (graph == NULL || memcmp(graph, &empty, sizeof(empty)) != 0) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "graph: the output must be a zeroed pc_graph");
    }
    pc_graph_options chosen;
    pc_status status =
        pci_check_mesh_of_cells(context, stage, projected, "projected mesh", cell_size);
    if (status == PC_OK) {
        status = pci_begin_stage(context, stage, &pc_graph_options_record, options, &chosen);
    }
    if (status != PC_OK) {
        return status;
    }
    pci_scratch scratch = pci_scratch_begin(context);
    pci_bvh *bvh = NULL;
    status = pci_bvh_create(context, stage, projected, &bvh);
    if (status == PC_OK) {
        work w = {.mesh = projected, .bvh = bvh, .options = &chosen, .cell_size = cell_size};
        status = build(context, &scratch, &w, graph, report);
    }
    if (status != PC_OK) {
        pc_graph_free(context, graph);
    }
    pci_bvh_destroy(context, bvh);
    pci_scratch_end(&scratch);
    return status;
}
