// Queries around a point.
#include <float.h>

#include "core/context.h"
#include "geometry/bvh.h"
#include "geometry/bvh_tree.h"
#include "geometry/topology.h"

static double distance2_to(const pc_mesh *mesh, uint32_t t, const double point[3],
                           double barycentric[3]) {
    return pci_triangle_squared_distance(point, pci_bvh_corner(mesh, t, 0),
                                         pci_bvh_corner(mesh, t, 1), pci_bvh_corner(mesh, t, 2),
                                         barycentric);
}

static bool is_within(const pc_mesh *mesh, uint32_t t, const double point[3], double radius) {
    double barycentric[3];
    return sqrt(distance2_to(mesh, t, point, barycentric)) <= radius;
}

bool pci_triangle_within(const pc_mesh *mesh, size_t t, const double point[3], double radius) {
    const double *corners[3] = {pci_bvh_corner(mesh, t, 0), pci_bvh_corner(mesh, t, 1),
                                pci_bvh_corner(mesh, t, 2)};
    for (size_t k = 0; k < 3; ++k) {
        const double a = corners[0][k] - point[k], b = corners[1][k] - point[k],
                     c = corners[2][k] - point[k];
        if ((a > radius && b > radius && c > radius) ||
            (a < -radius && b < -radius && c < -radius)) {
            return false;
        }
    }
    return is_within(mesh, (uint32_t)t, point, radius);
}

typedef struct closest_query {
    const pci_bvh *bvh;
    const double *point;
    double radius;    // of the caller
    double slack;     // added to the radius in normalised space
    double distance2; // best so far
    uint32_t triangle;
} closest_query;

// Whether the triangle is the nearest one so far; ties go to the smaller index.
static inline bool is_nearest(const closest_query *query, uint32_t triangle, double distance2) {
    return !(distance2 > query->distance2 ||
             (distance2 == query->distance2 && triangle > query->triangle));
}

static inline void keep_nearest(closest_query *query, uint32_t triangle, double distance2) {
    query->distance2 = distance2;
    query->triangle = triangle;
}

static float visit_triangles(void *user, const pci_bvh_leaf *leaf, const double *distances2,
                             float radius) {
    closest_query *query = user;
    const double before = query->distance2;
    for (size_t i = 0; i < PCI_BVH_LEAF && leaf->triangles[i] != PC_INVALID_INDEX; ++i) {
        if (is_nearest(query, leaf->triangles[i], distances2[i]) &&
            sqrt(distances2[i]) <= query->radius) {
            keep_nearest(query, leaf->triangles[i], distances2[i]);
        }
    }
    if (query->distance2 == before) {
        return radius;
    }
    // Shrink the search, with slack so that triangles at the same distance are still visited.
    const double distance = sqrt(query->distance2);
    const float reach = (float)(distance * query->bvh->scale * (1.0 + 1e-6) + query->slack);
    return reach < radius ? reach : radius;
}

// Calls `visit` for the triangles that may be within `radius`. `slack`, set before, is what a
// later, smaller radius needs on top in normalised space.
static void visit_around(const pci_bvh *bvh, const double point[3], double radius,
                         pci_bvh_visit visit, void *user, double *slack) {
    if (!(radius >= 0.0) || !isfinite(point[0] + point[1] + point[2])) {
        return;
    }
    pci_bvh_ball ball = {.radius = INFINITY};
    double largest = 0.0;
    *slack = INFINITY;
    for (size_t k = 0; k < 3; ++k) {
        const double local = (point[k] - bvh->centre[k]) * bvh->scale;
        largest = fabs(local) <= largest ? largest : fabs(local);
        ball.point[k] = point[k];
        ball.centre[k] = fabs(local) <= PCI_FARTHEST_POINT ? (float)local : 0.0F;
    }
    if (largest <= PCI_FARTHEST_POINT) {
        *slack = 4.0 * (double)FLT_EPSILON * (largest + 1.0);
        ball.radius = (float)(radius * bvh->scale * (1.0 + 1e-6) + *slack);
    }
    bvh->kernel->around(&bvh->tree, &ball, visit, user);
}

typedef struct overlap_query {
    const pc_mesh *mesh;
    const double *point;
    size_t count;
} overlap_query;

// Counts the boxes that hold the point.
static float count_boxes(void *user, const pci_bvh_leaf *leaf, const double *distances2,
                         float radius) {
    overlap_query *query = user;
    const pc_mesh *mesh = query->mesh;
    (void)distances2;
    for (size_t i = 0; i < PCI_BVH_LEAF && leaf->triangles[i] != PC_INVALID_INDEX; ++i) {
        bool inside = true;
        for (size_t k = 0; k < 3 && inside; ++k) {
            const double x = query->point[k];
            bool below = false, above = false;
            for (size_t c = 0; c < 3; ++c) {
                below = below || pci_bvh_corner(mesh, leaf->triangles[i], c)[k] <= x;
                above = above || pci_bvh_corner(mesh, leaf->triangles[i], c)[k] >= x;
            }
            inside = below && above;
        }
        query->count += inside;
    }
    return radius;
}

double pci_bvh_overlap(const pci_bvh *bvh) {
    enum { most_samples = 64 };
    const size_t count = bvh->mesh->triangle_count;
    const size_t samples = count < most_samples ? count : most_samples;
    overlap_query query = {.mesh = bvh->mesh};
    for (size_t i = 0; i < samples; ++i) {
        double middle[3], slack = 0.0;
        pci_triangle_middle(bvh->mesh, i * (count / samples), middle);
        query.point = middle;
        visit_around(bvh, middle, 0.0, count_boxes, &query, &slack);
    }
    return samples > 0 ? (double)query.count / (double)samples : 0.0;
}

// The result of a query that ended so.
static pci_closest closest_on(const pc_mesh *mesh, uint32_t triangle, double distance2,
                              const double barycentric[3]) {
    pci_closest closest = {.triangle = triangle};
    if (triangle == PC_INVALID_INDEX) {
        return closest;
    }
    closest.distance = sqrt(distance2);
    for (size_t c = 0; c < 3; ++c) {
        closest.barycentric[c] = barycentric[c];
        for (size_t k = 0; k < 3; ++k) {
            closest.point[k] += barycentric[c] * pci_bvh_corner(mesh, triangle, c)[k];
        }
    }
    return closest;
}

static pci_closest found_closest(const closest_query *query) {
    double barycentric[3] = {0};
    if (query->triangle != PC_INVALID_INDEX) {
        (void)distance2_to(query->bvh->mesh, query->triangle, query->point, barycentric);
    }
    return closest_on(query->bvh->mesh, query->triangle, query->distance2, barycentric);
}

pci_closest pci_bvh_closest(const pci_bvh *bvh, const double point[3], double radius) {
    closest_query query = {.bvh = bvh,
                           .point = point,
                           .radius = radius,
                           .distance2 = INFINITY,
                           .triangle = PC_INVALID_INDEX};
    visit_around(bvh, point, radius, visit_triangles, &query, &query.slack);
    return found_closest(&query);
}

typedef struct closest_job {
    const pci_bvh *bvh;
    const double *points;
    pci_place *closest;
} closest_job;

static void find_closest(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const closest_job *job = user;
    for (size_t v = begin; v < end; ++v) {
        const pci_closest found = pci_bvh_closest(job->bvh, &job->points[3 * v], INFINITY);
        job->closest[v].triangle = found.triangle;
        memcpy(job->closest[v].barycentric, found.barycentric, sizeof(found.barycentric));
    }
}

pc_status pci_closest_points(pc_context *context, const char *stage, const pc_mesh *from,
                             const pc_mesh *mesh, pci_place *closest) {
    pci_bvh *bvh = NULL;
    const pc_status status = pci_bvh_create(context, stage, mesh, &bvh);
    if (status != PC_OK) {
        return status;
    }
    closest_job job = {bvh, from->positions, closest};
    pci_parallel_for(context, from->vertex_count, 256, find_closest, &job);
    pci_bvh_destroy(context, bvh);
    return PC_OK;
}

typedef struct within_query {
    double radius;
    uint32_t found; // PC_INVALID_INDEX: none so far
} within_query;

static float visit_until_found(void *user, const pci_bvh_leaf *leaf, const double *distances2,
                               float radius) {
    within_query *query = user;
    for (size_t i = 0; i < PCI_BVH_LEAF && leaf->triangles[i] != PC_INVALID_INDEX; ++i) {
        if (sqrt(distances2[i]) <= query->radius) {
            query->found = leaf->triangles[i];
            return -1.0F;
        }
    }
    return radius;
}

bool pci_bvh_within(const pci_bvh *bvh, const double point[3], double radius) {
    uint32_t hint = PC_INVALID_INDEX;
    return pci_bvh_within_near(bvh, point, radius, &hint);
}

bool pci_bvh_within_near(const pci_bvh *bvh, const double point[3], double radius, uint32_t *hint) {
    within_query query = {radius, PC_INVALID_INDEX};
    if (*hint != PC_INVALID_INDEX && is_within(bvh->mesh, *hint, point, radius)) {
        return true;
    }
    double slack = 0.0;
    visit_around(bvh, point, radius, visit_until_found, &query, &slack);
    if (query.found == PC_INVALID_INDEX) {
        return false;
    }
    *hint = query.found;
    return true;
}

pci_closest pci_bvh_closest_near(const pci_bvh *bvh, const double point[3], uint32_t hint) {
    double radius = INFINITY, barycentric[3];
    if (hint != PC_INVALID_INDEX) {
        radius = sqrt(distance2_to(bvh->mesh, hint, point, barycentric));
    }
    return pci_bvh_closest(bvh, point, radius);
}

typedef struct collection {
    double squared_radius;
    size_t count, capacity;
    uint32_t *triangles;
} collection;

static float collect_triangles(void *user, const pci_bvh_leaf *leaf, const double *distances2,
                               float radius) {
    collection *found = user;
    for (size_t i = 0; i < PCI_BVH_LEAF && leaf->triangles[i] != PC_INVALID_INDEX; ++i) {
        if (distances2[i] <= found->squared_radius) {
            if (found->count == found->capacity) {
                ++found->count;
                return -1.0F;
            }
            found->triangles[found->count++] = leaf->triangles[i];
        }
    }
    return radius;
}

size_t pci_bvh_collect(const pci_bvh *bvh, const double point[3], double radius, size_t capacity,
                       uint32_t *triangles) {
    collection found = {
        .squared_radius = radius * radius, .capacity = capacity, .triangles = triangles};
    double slack = 0.0;
    visit_around(bvh, point, radius, collect_triangles, &found, &slack);
    return found.count;
}

size_t pci_bvh_collect_fitting(const pci_bvh *bvh, const double point[3], double *radius,
                               size_t capacity, uint32_t *triangles) {
    size_t count = pci_bvh_collect(bvh, point, *radius, capacity, triangles);
    for (int i = 0; i < 8 && count > capacity; ++i) {
        *radius *= 0.5;
        count = pci_bvh_collect(bvh, point, *radius, capacity, triangles);
    }
    return count > capacity ? 0 : count;
}

// ---- a point that moves -------------------------------------------------------------------------

// Room for all the rounding of distances and of the ball's radius.
static const double ball_slack = 1e-9;

typedef struct ball_query {
    closest_query best;
    pci_surroundings *around;
    double squared_radius;
} ball_query;

static float list_triangles(void *user, const pci_bvh_leaf *leaf, const double *distances2,
                            float radius) {
    ball_query *query = user;
    pci_surroundings *around = query->around;
    for (size_t i = 0; i < PCI_BVH_LEAF && leaf->triangles[i] != PC_INVALID_INDEX; ++i) {
        const uint32_t t = leaf->triangles[i];
        if (!(distances2[i] <= query->squared_radius)) {
            continue;
        }
        if (around->count == PCI_SURROUNDINGS) {
            ++around->count;
            return -1.0F; // too many
        }
        around->triangles[around->count] = t;
        around->distances[around->count++] = sqrt(distances2[i]);
        if (is_nearest(&query->best, t, distances2[i])) {
            keep_nearest(&query->best, t, distances2[i]);
        }
    }
    return radius;
}

// Leaves out those that are too far away, since the point moved only so far.
static pci_closest look_around(const pci_bvh *bvh, const double point[3],
                               const pci_surroundings *around, double way) {
    closest_query best = {.distance2 = INFINITY, .triangle = PC_INVALID_INDEX};
    double nearest = INFINITY, barycentric[3] = {0}, best_barycentric[3] = {0};
    for (uint32_t i = 0; i < around->count; ++i) {
        if (around->distances[i] - way <= nearest) {
            const double distance2 =
                distance2_to(bvh->mesh, around->triangles[i], point, barycentric);
            if (is_nearest(&best, around->triangles[i], distance2)) {
                keep_nearest(&best, around->triangles[i], distance2);
                memcpy(best_barycentric, barycentric, sizeof(barycentric));
            }
            nearest = sqrt(best.distance2) + ball_slack * around->radius;
        }
    }
    return closest_on(bvh->mesh, best.triangle, best.distance2, best_barycentric);
}

pci_closest pci_bvh_closest_moving(const pci_bvh *bvh, const double point[3], double bound,
                                   double margin, pci_surroundings *around) {
    // Whatever is within the bound of the point is within this of the old centre.
    const double way = sqrt(pci_squared_distance(point, around->centre));
    if ((bound + way) * (1.0 + ball_slack) <= around->radius) {
        return look_around(bvh, point, around, way);
    }
    const double radius = (bound + margin) * (1.0 + 4.0 * ball_slack);
    ball_query query = {
        .best = {.bvh = bvh, .point = point, .distance2 = INFINITY, .triangle = PC_INVALID_INDEX},
        .around = around,
        .squared_radius = radius * radius};
    double slack = 0.0;
    around->count = 0;
    around->radius = -1.0;
    visit_around(bvh, point, radius, list_triangles, &query, &slack);
    if (around->count == 0 || around->count > PCI_SURROUNDINGS) {
        return pci_bvh_closest(bvh, point, fmin(bound, sqrt(query.best.distance2)));
    }
    memcpy(around->centre, point, sizeof(around->centre));
    around->radius = radius;
    return found_closest(&query.best);
}
