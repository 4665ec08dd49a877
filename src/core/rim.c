#include "core/rim.h"

#include <stdlib.h>

#include "core/topology.h"

enum { most_triangles = 2048, deepest = 12, edge_grain = 64 };

typedef struct ball {
    double centre[3], radius;
    double area, moment[3]; // of the surface inside, about the centre
} ball;

static void add_area(ball *b, const double corners[3][3], double share) {
    double u[3], v[3], normal[3];
    pci_sub(corners[1], corners[0], u);
    pci_sub(corners[2], corners[0], v);
    pci_cross(u, v, normal);
    const double area = 0.5 * share * pci_norm(normal);
    b->area += area;
    for (size_t k = 0; k < 3; ++k) {
        b->moment[k] +=
            area * ((corners[0][k] + corners[1][k] + corners[2][k]) / 3.0 - b->centre[k]);
    }
}

// Whether a triangle without a corner in the ball reaches into it. `longest` is its squared longest
// edge; no point of a triangle is farther than that from a corner.
static bool reaches(const ball *b, const double corners[3][3], double longest) {
    double weights[3];
    const double apart = sqrt(pci_squared_distance(corners[0], b->centre));
    return apart <= b->radius + sqrt(longest) &&
           pci_triangle_squared_distance(b->centre, corners[0], corners[1], corners[2], weights) <=
               b->radius * b->radius;
}

// Adds the part of a triangle inside the ball: halves triangles that reach outside until they are
// small against the radius.
static void add_triangle(ball *b, const double corners[3][3], int depth) {
    const double square = b->radius * b->radius;
    double longest = -1.0;
    size_t inside = 0, split = 0;
    for (size_t k = 0; k < 3; ++k) {
        inside += pci_squared_distance(corners[k], b->centre) <= square;
        const double length = pci_squared_distance(corners[k], corners[(k + 1) % 3]);
        if (length > longest) {
            longest = length;
            split = k;
        }
    }
    if (inside == 3) {
        add_area(b, corners, 1.0);
    } else if (longest <= square / 16.0 || depth == 0) {
        add_area(b, corners, (double)inside / 3.0);
    } else if (inside > 0 || reaches(b, corners, longest)) {
        double half[3][3];
        const size_t next = (split + 1) % 3;
        for (size_t side = 0; side < 2; ++side) {
            memcpy(half, corners, sizeof(half));
            for (size_t k = 0; k < 3; ++k) {
                half[side == 0 ? split : next][k] = 0.5 * (corners[split][k] + corners[next][k]);
            }
            add_triangle(b, (const double(*)[3])half, depth - 1);
        }
    }
}

static int compare_u32(const void *left, const void *right) {
    const uint32_t a = *(const uint32_t *)left, b = *(const uint32_t *)right;
    return (a > b) - (a < b);
}

double pci_one_sided(const pci_bvh *bvh, const pc_mesh *mesh, const double point[3],
                     double radius) {
    uint32_t triangles[most_triangles];
    size_t count = pci_bvh_collect(bvh, point, radius, most_triangles, triangles);
    for (int i = 0; i < 8 && count > most_triangles; ++i) {
        radius *= 0.5;
        count = pci_bvh_collect(bvh, point, radius, most_triangles, triangles);
    }
    if (count > most_triangles) {
        return 0.0;
    }
    qsort(triangles, count, sizeof(*triangles), compare_u32); // so that sums do not depend on it
    ball b = {.centre = {point[0], point[1], point[2]}, .radius = radius};
    for (size_t i = 0; i < count; ++i) {
        double corners[3][3];
        for (size_t k = 0; k < 3; ++k) {
            memcpy(corners[k], &mesh->positions[3 * (size_t)mesh->triangles[3 * triangles[i] + k]],
                   sizeof(corners[k]));
        }
        add_triangle(&b, (const double(*)[3])corners, deepest);
    }
    return b.area > 0.0 ? pci_norm(b.moment) / (b.area * radius) : 0.0;
}

// ---- rim points ---------------------------------------------------------------------------------

// An edge may be a rim when it has one triangle, more than two, or bends by more than 60 degrees.
static bool may_be_rim(const pc_mesh *mesh, const pci_topology *topology, size_t edge) {
    const size_t first = topology->edge_triangle_offsets[edge];
    if (topology->edge_triangle_offsets[edge + 1] - first != 2) {
        return true;
    }
    double normals[2][3], along[3];
    const uint32_t *ends = &topology->edges[2 * edge];
    pci_sub(&mesh->positions[3 * (size_t)ends[1]], &mesh->positions[3 * (size_t)ends[0]], along);
    double wings[2][3]; // from the edge into each triangle, square to the edge
    for (size_t side = 0; side < 2; ++side) {
        const uint32_t *corner = &mesh->triangles[3 * topology->edge_triangles[first + side]];
        uint32_t apex = corner[0];
        for (size_t k = 0; k < 3; ++k) {
            apex = corner[k] != ends[0] && corner[k] != ends[1] ? corner[k] : apex;
        }
        pci_sub(&mesh->positions[3 * (size_t)apex], &mesh->positions[3 * (size_t)ends[0]],
                wings[side]);
        pci_cross(along, wings[side], normals[side]);
        if (!pci_normalize(normals[side])) {
            return true;
        }
    }
    return pci_dot(normals[0], normals[1]) > -0.5; // -1 where flat
}

typedef struct rim_job {
    const pci_bvh *bvh;
    const pc_mesh *mesh;
    double radius;
    const double *candidates;
    uint8_t *on_rim;
} rim_job;

static void test_candidates(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const rim_job *job = user;
    for (size_t i = begin; i < end; ++i) {
        job->on_rim[i] = pci_one_sided(job->bvh, job->mesh, &job->candidates[3 * i], job->radius) >
                         PCI_RIM_ONE_SIDED;
    }
}

pc_status pci_rim_points(pci_scratch *scratch, const char *stage, const pci_bvh *bvh,
                         const pc_mesh *mesh, double radius, double spacing, size_t *count,
                         double **points) {
    pci_topology topology;
    void *candidates = NULL;
    size_t candidate_count = 0, capacity = 0;
    if (!pci_topology_build(scratch, mesh, &topology)) {
        return pci_fail_memory(scratch->context, stage);
    }
    for (size_t e = 0; e < topology.edge_count; ++e) {
        if (!may_be_rim(mesh, &topology, e)) {
            continue;
        }
        const double *a = &mesh->positions[3 * (size_t)topology.edges[2 * e]];
        const double *b = &mesh->positions[3 * (size_t)topology.edges[2 * e + 1]];
        const size_t pieces = 1 + (size_t)(sqrt(pci_squared_distance(a, b)) / spacing);
        if (!pci_scratch_reserve(scratch, &candidates, &capacity, candidate_count + pieces,
                                 3 * sizeof(double))) {
            return pci_fail_memory(scratch->context, stage);
        }
        for (size_t i = 0; i < pieces; ++i) {
            const double share = ((double)i + 0.5) / (double)pieces;
            for (size_t k = 0; k < 3; ++k) {
                ((double *)candidates)[3 * candidate_count + k] = a[k] + share * (b[k] - a[k]);
            }
            ++candidate_count;
        }
    }
    uint8_t *on_rim = PCI_SCRATCH(scratch, uint8_t, candidate_count);
    if (on_rim == NULL) {
        return pci_fail_memory(scratch->context, stage);
    }
    rim_job job = {bvh, mesh, radius, candidates, on_rim};
    if (!pci_parallel_while_wanted(scratch->context, candidate_count, edge_grain, test_candidates,
                                   &job)) {
        return pci_fail_memory(scratch->context, stage);
    }
    *points = candidates;
    *count = 0;
    for (size_t i = 0; i < candidate_count; ++i) {
        if (on_rim[i]) {
            memmove(&(*points)[3 * *count], &(*points)[3 * i], 3 * sizeof(double));
            ++*count;
        }
    }
    return PC_OK;
}
