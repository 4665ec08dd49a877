#include "stages/simplify/mirror.h"

#include "geometry/bvh.h"
#include "geometry/manifold.h"
#include "geometry/topology.h"

// How far the reflected mesh may be from the mesh, in edge lengths of the proxy, which strays about
// as far itself.
static const double tolerance = 0.25;
// About so many vertices are looked at first, and then at most.
static const size_t few_vertices = 64, most_vertices = 8192;
// Vertices nearer to the plane than this part of an edge that crosses it move onto it.
static const double snapped_share = 0.2;

// ---- the plane ----------------------------------------------------------------------------------

typedef struct reflection {
    const pci_bvh *bvh;
    pci_mirror mirror;
    size_t stride, vertex_count;
    const double *positions;
    double *distances; // per vertex that is looked at, of its reflection
    double *middles;   // coordinate of the middle between it and what its reflection is nearest to
} reflection;

static void reflect(const pci_mirror *mirror, double point[3]) {
    point[mirror->axis] = 2.0 * mirror->offset - point[mirror->axis];
}

static void find_reflections(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const reflection *r = user;
    for (size_t i = begin; i < end; ++i) {
        const double *at = &r->positions[3 * r->stride * i];
        double point[3] = {at[0], at[1], at[2]};
        reflect(&r->mirror, point);
        const pci_closest closest = pci_bvh_closest(r->bvh, point, INFINITY);
        r->distances[i] = closest.distance;
        r->middles[i] = 0.5 * (at[r->mirror.axis] + closest.point[r->mirror.axis]);
    }
}

// The largest distance of a reflected vertex, of about `count` of them, and the mean middle.
static double reflect_some(pc_context *context, reflection *r, size_t count, double *middle) {
    r->stride = 1 + r->vertex_count / count;
    const size_t asked = (r->vertex_count + r->stride - 1) / r->stride;
    pci_parallel_for(context, asked, 256, find_reflections, r);
    double most = 0.0, sum = 0.0;
    for (size_t i = 0; i < asked; ++i) {
        most = fmax(most, r->distances[i]);
        sum += r->middles[i];
    }
    *middle = sum / (double)asked;
    return most;
}

// How much of the mesh the plane cuts; HUGE_VAL: nothing is more than `least` away from it.
static double cut_length(const pc_mesh *mesh, const pci_mirror *mirror, double least) {
    double length = 0.0, farthest = 0.0;
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        double ends[2][3];
        size_t count = 0;
        for (size_t c = 0; c < 3; ++c) {
            const double *a = &mesh->positions[3 * (size_t)mesh->triangles[3 * t + c]];
            const double *b = &mesh->positions[3 * (size_t)mesh->triangles[3 * t + (c + 1) % 3]];
            const double below = a[mirror->axis] - mirror->offset;
            const double above = b[mirror->axis] - mirror->offset;
            farthest = fmax(farthest, fabs(above));
            if ((below > 0.0) != (above > 0.0)) {
                const double share = below / (below - above);
                for (size_t k = 0; k < 3; ++k) {
                    ends[count][k] = a[k] + share * (b[k] - a[k]);
                }
                ++count;
            }
        }
        length += count == 2 ? sqrt(pci_squared_distance(ends[0], ends[1])) : 0.0;
    }
    return farthest > least ? length : HUGE_VAL;
}

static void find_centre(const pc_mesh *mesh, double centre[3]) {
    double total = 0.0;
    memset(centre, 0, 3 * sizeof(*centre));
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        const double area = pci_triangle_area(mesh, t);
        double middle[3];
        pci_triangle_middle(mesh, t, middle);
        total += area;
        for (size_t k = 0; k < 3; ++k) {
            centre[k] += area * middle[k];
        }
    }
    for (size_t k = 0; k < 3; ++k) {
        centre[k] /= total;
    }
}

// The edges of the border as triangles without area; `topology` is that of `mesh`.
static bool list_border(pci_scratch *scratch, const pc_mesh *mesh, const pci_topology *topology,
                        pc_mesh *border) {
    *border = *mesh;
    border->triangles = PCI_SCRATCH(scratch, uint32_t, 3 * topology->edge_count);
    border->triangle_count = 0;
    for (size_t e = 0; border->triangles != NULL && e < topology->edge_count; ++e) {
        if (pci_side_count(topology, e) == 1) {
            uint32_t *corner = &border->triangles[3 * border->triangle_count++];
            corner[0] = topology->edges[2 * e];
            corner[1] = corner[2] = topology->edges[2 * e + 1];
        }
    }
    return border->triangles != NULL;
}

// Whether the reflected border is near the border.
static pc_status border_is_alike(pci_scratch *scratch, const char *stage, const pc_mesh *border,
                                 const pci_mirror *mirror, double limit, bool *alike) {
    pci_bvh *bvh = NULL;
    *alike = true;
    if (border->triangle_count == 0) {
        return PC_OK;
    }
    const pc_status status = pci_bvh_create(scratch->context, stage, border, &bvh);
    for (size_t t = 0; status == PC_OK && *alike && t < border->triangle_count; ++t) {
        double point[3];
        memcpy(point, &border->positions[3 * (size_t)border->triangles[3 * t]], sizeof(point));
        reflect(mirror, point);
        *alike = pci_bvh_within(bvh, point, limit);
    }
    pci_bvh_destroy(scratch->context, bvh);
    return status;
}

// The plane across an axis that leaves the vertices nearest: through the centre or, when that is
// not far off, through the middle between both sides. Returns how near.
static double place_plane(pc_context *context, reflection *r, size_t axis, double centre,
                          double limit) {
    double middle = 0.0;
    r->mirror = (pci_mirror){axis, centre};
    if (reflect_some(context, r, few_vertices, &middle) > 2.0 * limit) {
        return INFINITY;
    }
    const double most = reflect_some(context, r, most_vertices, &middle);
    r->mirror.offset = middle;
    const double again = reflect_some(context, r, most_vertices, &middle);
    r->mirror.offset = again < most ? r->mirror.offset : centre;
    return fmin(most, again);
}

// Of the planes that leave the mesh near, the one that cuts the least. `found`: there is one.
static pc_status find_plane(pci_scratch *scratch, const char *stage, const pc_mesh *mesh,
                            const pc_mesh *border, double spacing, pci_mirror *mirror,
                            bool *found) {
    const double limit = tolerance * spacing;
    pc_context *context = scratch->context;
    pci_bvh *bvh = NULL;
    reflection r = {.vertex_count = mesh->vertex_count, .positions = mesh->positions};
    r.distances = PCI_SCRATCH(scratch, double, mesh->vertex_count);
    r.middles = PCI_SCRATCH(scratch, double, mesh->vertex_count);
    *found = false;
    if (scratch->failed) {
        return pci_fail_memory(context, stage);
    }
    pc_status status = pci_bvh_create(context, stage, mesh, &bvh);
    if (status != PC_OK) {
        return status;
    }
    r.bvh = bvh;
    double centre[3], shortest = HUGE_VAL;
    find_centre(mesh, centre);
    for (size_t axis = 0; status == PC_OK && axis < 3; ++axis) {
        bool alike = place_plane(context, &r, axis, centre[axis], limit) <= limit;
        const double length = alike ? cut_length(mesh, &r.mirror, spacing) : HUGE_VAL;
        if (length < shortest) {
            status = border_is_alike(scratch, stage, border, &r.mirror, limit, &alike);
            if (alike) {
                shortest = length;
                *mirror = r.mirror;
                *found = true;
            }
        }
    }
    pci_bvh_destroy(context, bvh);
    return status;
}

// ---- the halves ---------------------------------------------------------------------------------

// Coordinate above the plane.
static double height(const pci_mirror *mirror, const pci_halfedge *mesh, uint32_t v) {
    return mesh->positions[3 * (size_t)v + mirror->axis] - mirror->offset;
}

// Moves vertices onto the plane where it cuts an edge close to them.
static void snap_to_plane(const pci_mirror *mirror, pci_halfedge *mesh, uint8_t *snapped) {
    for (uint32_t h = 0; h < 3 * mesh->triangle_count; ++h) {
        const uint32_t a = pci_origin(mesh, h), b = pci_target(mesh, h);
        const double below = height(mirror, mesh, a), above = height(mirror, mesh, b);
        if (below * above < 0.0) {
            const double share = below / (below - above);
            snapped[a] |= share < snapped_share;
            snapped[b] |= share > 1.0 - snapped_share;
        }
    }
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        if (snapped[v]) {
            mesh->positions[3 * v + mirror->axis] = mirror->offset;
        }
    }
}

// Splits the edges that cross the plane. False: out of memory.
static bool split_at_plane(const pci_mirror *mirror, pci_halfedge *mesh) {
    for (uint32_t h = 0; h < 3 * mesh->triangle_count; ++h) { // their number grows
        const uint32_t a = pci_origin(mesh, h), b = pci_target(mesh, h);
        const double below = height(mirror, mesh, a), above = height(mirror, mesh, b);
        if (!(below * above < 0.0)) {
            continue;
        }
        const double share = below / (below - above);
        double point[3];
        for (size_t k = 0; k < 3; ++k) {
            const double from = mesh->positions[3 * (size_t)a + k];
            point[k] = from + share * (mesh->positions[3 * (size_t)b + k] - from);
        }
        point[mirror->axis] = mirror->offset;
        if (pci_split_edge(mesh, h, point) == PC_INVALID_INDEX) {
            return false;
        }
        h -= h % 3 + 1; // again from the first edge of what is left of the triangle
    }
    return true;
}

// Makes every triangle of a manifold lie on one side. False: out of memory.
static bool cut(pci_scratch *scratch, const pc_mesh *mesh, const pci_mirror *mirror,
                pci_halfedge *halves) {
    if (!pci_halfedge_build(scratch, mesh, halves)) {
        return false;
    }
    uint8_t *snapped = PCI_SCRATCH(scratch, uint8_t, halves->vertex_count);
    if (snapped == NULL) {
        return false;
    }
    snap_to_plane(mirror, halves, snapped);
    return split_at_plane(mirror, halves);
}

// What is above the plane (side 1) or below it (-1). False: out of memory or cancelled.
static bool take_side(pci_scratch *scratch, const pci_halfedge *halves, const pci_mirror *mirror,
                      double side, pc_mesh *half) {
    uint8_t *keep = PCI_SCRATCH(scratch, uint8_t, halves->triangle_count);
    if (keep == NULL) {
        return false;
    }
    for (size_t h = 0; h < 3 * halves->triangle_count; ++h) {
        keep[h / 3] |= side * height(mirror, halves, halves->corners[h]) > 0.0;
    }
    const pc_mesh view = pci_halfedge_view(halves);
    pci_repair_counts repairs;
    return pci_mesh_repair(scratch, &view, keep, half, &repairs);
}

bool pci_unfold(pci_scratch *scratch, const pci_mirror *mirror, const pc_mesh *half,
                pc_mesh *whole) {
    pci_topology topology;
    uint8_t *border = PCI_SCRATCH(scratch, uint8_t, half->vertex_count);
    uint32_t *image = PCI_SCRATCH(scratch, uint32_t, half->vertex_count);
    if (scratch->failed || !pci_topology_build_edges(scratch, half, &topology)) {
        return false;
    }
    pci_mark_border(&topology, border);
    size_t count = half->vertex_count;
    for (size_t v = 0; v < half->vertex_count; ++v) {
        const bool seam = border[v] && pci_on_mirror(mirror, &half->positions[3 * v]);
        image[v] = (uint32_t)(seam ? v : count++);
    }
    pc_context *context = scratch->context;
    pc_mesh result = {count, PCI_ALLOCATE(context, double, 3 * count), 2 * half->triangle_count,
                      PCI_ALLOCATE(context, uint32_t, 6 * half->triangle_count)};
    if (result.positions == NULL || result.triangles == NULL) {
        pc_mesh_free(context, &result);
        return false;
    }
    for (size_t v = 0; v < half->vertex_count; ++v) {
        double point[3];
        memcpy(point, &half->positions[3 * v], sizeof(point));
        memcpy(&result.positions[3 * v], point, sizeof(point));
        if (image[v] != v) {
            reflect(mirror, point);
            memcpy(&result.positions[3 * (size_t)image[v]], point, sizeof(point));
        }
    }
    uint32_t *images = &result.triangles[3 * half->triangle_count];
    memcpy(result.triangles, half->triangles, 3 * half->triangle_count * sizeof(*images));
    for (size_t t = 0; t < half->triangle_count; ++t) {
        const uint32_t *corner = &half->triangles[3 * t];
        images[3 * t] = image[corner[0]];
        images[3 * t + 1] = image[corner[2]];
        images[3 * t + 2] = image[corner[1]];
    }
    *whole = result;
    return true;
}

// Whether a half and its mirror image have the topology of the whole. False: out of memory.
static bool compare_topology(pci_scratch *scratch, const pci_mirror *mirror, const pc_mesh *half,
                             const pc_mesh *whole, bool *same) {
    pci_shape shapes[2];
    pc_mesh unfolded = {0};
    const bool done = pci_unfold(scratch, mirror, half, &unfolded) &&
                      pci_find_shape(scratch, &unfolded, &shapes[0]) &&
                      pci_find_shape(scratch, whole, &shapes[1]);
    *same = done && pci_same_topology(&shapes[0], &shapes[1]);
    pc_mesh_free(scratch->context, &unfolded);
    return done;
}

// Cuts the mesh and takes the first side that will do. False: out of memory or cancelled.
static bool take_half(pci_scratch *scratch, const pc_mesh *mesh, const pci_mirror *mirror,
                      pc_mesh *half) {
    pci_halfedge halves;
    bool done = cut(scratch, mesh, mirror, &halves), same = false;
    for (int side = 1; done && !same && side >= -1; side -= 2) {
        pc_mesh_free(scratch->context, half);
        done = pci_keep_going(scratch->context) &&
               take_side(scratch, &halves, mirror, side, half) &&
               (half->triangle_count == 0 || compare_topology(scratch, mirror, half, mesh, &same));
    }
    if (!same) {
        pc_mesh_free(scratch->context, half);
    }
    return done;
}

pc_status pci_halve(pc_context *context, const char *stage, const pc_mesh *mesh, double spacing,
                    pci_mirror *mirror, pc_mesh *half) {
    if (!(spacing > 0.0)) { // no area
        return PC_OK;
    }
    pci_scratch scratch = pci_scratch_begin(context);
    pci_topology topology;
    pc_mesh border;
    bool found = false;
    pc_status status = PC_OK;
    bool done = pci_topology_build_edges(&scratch, mesh, &topology) &&
                list_border(&scratch, mesh, &topology, &border);
    if (done) {
        status = find_plane(&scratch, stage, mesh, &border, spacing, mirror, &found);
    }
    if (status == PC_OK && found) {
        done = take_half(&scratch, mesh, mirror, half);
    }
    pci_scratch_end(&scratch);
    if (status == PC_ERROR_TOO_LARGE) { // for the search, not for the proxy
        return PC_OK;
    }
    return status == PC_OK && !done ? pci_fail_memory(context, stage) : status;
}
