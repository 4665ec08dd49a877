#include "geometry/bvh.h"

#include <embree3/rtcore.h>
#include <float.h>
#include <pthread.h>

#include "core/context.h"
#include "core/embree.h"
#include "geometry/topology.h"

// Embree sees every triangle as a box in coordinates where the mesh fits a cube of side 1 around
// the origin, so that float is precise enough at any size and place of the mesh. The boxes are
// larger than the triangles by PADDING, which exceeds all rounding of boxes, rays and points (for
// user geometry Embree traverses without its robust mode whatever the scene flags say).
#define PADDING 2e-6

// Beyond this distance from the origin of the normalised space the bounds of a float query would
// mean nothing; such a query visits every triangle.
#define FARTHEST_POINT 1e6

// A search on the mesh visits as many triangles as there are boxes that hold its point: a handful
// in a garment. Where it is thousands, searches for all vertices or triangles take minutes.
#define MOST_OVERLAP 1000.0

// Larger meshes have more triangles than anybody asks points for: a tree that is built quickly
// pays.
#define MOST_CAREFUL 65536

struct pci_bvh {
    const pc_mesh *mesh;
    uint8_t *duplicate; // #F: the triangle repeats an earlier one and is left out
    bool repeats;       // some are left out
    RTCScene scene;
    double minimum[3], maximum[3]; // of the triangles
    double centre[3];
    double scale; // normalised = (position - centre) * scale
};

static const double *corner(const pc_mesh *mesh, size_t triangle, size_t c) {
    return &mesh->positions[3 * (size_t)mesh->triangles[3 * triangle + c]];
}

static void bound_triangle(const struct RTCBoundsFunctionArguments *arguments) {
    const pci_bvh *bvh = arguments->geometryUserPtr;
    const double *corners[3];
    float lower[3], upper[3];
    for (size_t c = 0; c < 3; ++c) {
        corners[c] = corner(bvh->mesh, arguments->primID, c);
    }
    for (size_t k = 0; k < 3; ++k) {
        double least = corners[0][k], most = least;
        for (size_t c = 1; c < 3; ++c) {
            const double x = corners[c][k];
            least = x < least ? x : least;
            most = x > most ? x : most;
        }
        lower[k] = (float)((least - bvh->centre[k]) * bvh->scale - PADDING);
        upper[k] = (float)((most - bvh->centre[k]) * bvh->scale + PADDING);
    }
    struct RTCBounds *bounds = arguments->bounds_o;
    bounds->lower_x = lower[0], bounds->lower_y = lower[1], bounds->lower_z = lower[2];
    bounds->upper_x = upper[0], bounds->upper_y = upper[1], bounds->upper_z = upper[2];
    if (bvh->duplicate[arguments->primID]) {
        bounds->lower_x = INFINITY; // what is empty does not enter the tree
    }
}

static void intersect_triangle(const struct RTCIntersectFunctionNArguments *arguments);

// A tree of millions of triangles takes seconds. The user is asked only from the thread that
// entered the library, and only during the stage that progress counts for.
typedef struct build_watch {
    pc_context *context;
    pthread_t thread;
    bool wanted;
} build_watch;

static bool watch_build(void *user, double primitives) {
    (void)primitives;
    build_watch *watch = user;
    if (!pthread_equal(watch->thread, pthread_self())) {
        return true;
    }
    watch->wanted = watch->wanted && pci_keep_going(watch->context);
    return watch->wanted;
}

// False: a coordinate is not finite.
static bool normalise_space(pci_bvh *bvh) {
    const pc_mesh *mesh = bvh->mesh;
    double side = 0.0;
    for (size_t k = 0; k < 3; ++k) {
        bvh->minimum[k] = HUGE_VAL;
        bvh->maximum[k] = -HUGE_VAL;
    }
    for (size_t i = 0; i < 3 * mesh->triangle_count; ++i) {
        const double *at = &mesh->positions[3 * (size_t)mesh->triangles[i]];
        for (size_t k = 0; k < 3; ++k) {
            if (!isfinite(at[k])) {
                return false;
            }
            bvh->minimum[k] = at[k] < bvh->minimum[k] ? at[k] : bvh->minimum[k];
            bvh->maximum[k] = at[k] > bvh->maximum[k] ? at[k] : bvh->maximum[k];
        }
    }
    for (size_t k = 0; k < 3; ++k) {
        bvh->centre[k] = 0.5 * (bvh->minimum[k] + bvh->maximum[k]);
        side = fmax(side, bvh->maximum[k] - bvh->minimum[k]);
    }
    bvh->scale = side >= DBL_MIN ? 1.0 / side : 1.0;
    return true;
}

static double measure_overlap(const pci_bvh *bvh);

static enum RTCError build_scene(pc_context *context, const char *stage, pci_bvh *bvh,
                                 build_watch *watch) {
    RTCDevice device = pci_embree_device(&context->embree);
    if (device == NULL) {
        return rtcGetDeviceError(NULL);
    }
    bvh->scene = rtcNewScene(device);
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_USER);
    rtcSetGeometryUserPrimitiveCount(geometry, (unsigned int)bvh->mesh->triangle_count);
    rtcSetGeometryUserData(geometry, bvh);
    rtcSetGeometryBoundsFunction(geometry, bound_triangle, NULL);
    rtcSetGeometryIntersectFunction(geometry, intersect_triangle);
    rtcCommitGeometry(geometry);
    if (bvh->mesh->triangle_count > MOST_CAREFUL) {
        rtcSetSceneBuildQuality(bvh->scene, RTC_BUILD_QUALITY_LOW);
    }
    rtcAttachGeometry(bvh->scene, geometry);
    rtcReleaseGeometry(geometry);
    if (context->stage != NULL && strcmp(context->stage, stage) == 0) {
        rtcSetSceneProgressMonitorFunction(bvh->scene, watch_build, watch);
    }
    rtcCommitScene(bvh->scene);
    rtcSetSceneProgressMonitorFunction(bvh->scene, NULL, NULL);
    return rtcGetDeviceError(device);
}

static pc_status build_tree(pc_context *context, const char *stage, const pc_mesh *mesh,
                            pci_bvh **bvh) {
    if (mesh->triangle_count >= PC_INVALID_INDEX) {
        return pci_fail(context, PC_ERROR_TOO_LARGE, stage, "%s: %zu triangles are too many", stage,
                        mesh->triangle_count);
    }
    pci_bvh *created = PCI_ALLOCATE(context, pci_bvh, 1);
    if (created == NULL) {
        return pci_fail_memory(context, stage);
    }
    created->mesh = mesh;
    // A tree over a triangle that occurs a million times would be a list.
    created->duplicate = PCI_ALLOCATE(context, uint8_t, mesh->triangle_count);
    pci_scratch scratch = pci_scratch_begin(context);
    const bool marked =
        created->duplicate != NULL && pci_mark_duplicates(&scratch, mesh, created->duplicate);
    pci_scratch_end(&scratch);
    if (!marked) {
        pci_bvh_destroy(context, created);
        return pci_fail_memory(context, stage);
    }
    created->repeats = memchr(created->duplicate, 1, mesh->triangle_count) != NULL;
    if (!normalise_space(created)) {
        pci_bvh_destroy(context, created);
        return pci_fail(context, PC_ERROR_NUMERICAL, stage,
                        "%s: a vertex position is infinite or not a number", stage);
    }

    build_watch watch = {.context = context, .thread = pthread_self(), .wanted = true};
    const enum RTCError error = build_scene(context, stage, created, &watch);
    if (error != RTC_ERROR_NONE) {
        pci_bvh_destroy(context, created);
        if (!watch.wanted) {
            return pci_fail_cancelled(context, stage);
        }
        if (error == RTC_ERROR_OUT_OF_MEMORY) {
            return pci_fail_memory(context, stage);
        }
        return pci_fail(context, PC_ERROR_DEPENDENCY, stage, "%s: Embree failed with error %d",
                        stage, (int)error);
    }
    const double overlap = measure_overlap(created);
    if (overlap > MOST_OVERLAP) {
        pci_bvh_destroy(context, created);
        return pci_fail(context, PC_ERROR_TOO_LARGE, stage,
                        "%s: the boxes of %.0f triangles hold the same point, at most %.0f", stage,
                        overlap, MOST_OVERLAP);
    }
    *bvh = created;
    return PC_OK;
}

// Whether both meshes have the same triangles in the same order, though maybe under other vertex
// indices or facing the other way: what repairing a mesh leaves of one that needs none.
static bool same_triangles(const pc_mesh *a, const pc_mesh *b) {
    if (a->triangle_count != b->triangle_count) {
        return false;
    }
    bool same = true;
    for (size_t t = 0; t < a->triangle_count && same; ++t) {
        const double *p[3], *q[3];
        for (size_t c = 0; c < 3; ++c) {
            p[c] = corner(a, t, c);
            q[c] = corner(b, t, c);
        }
        const bool turned = pci_squared_distance(p[1], q[1]) != 0.0;
        same = pci_squared_distance(p[0], q[0]) == 0.0 &&
               pci_squared_distance(p[1], q[turned ? 2 : 1]) == 0.0 &&
               pci_squared_distance(p[2], q[turned ? 1 : 2]) == 0.0;
    }
    return same;
}

// The shared tree, for a mesh with the same triangles.
static pc_status borrow_shared(pc_context *context, const char *stage, const pc_mesh *mesh,
                               pci_bvh **bvh) {
    pci_bvh *borrowed = PCI_ALLOCATE(context, pci_bvh, 1);
    if (borrowed == NULL) {
        return pci_fail_memory(context, stage);
    }
    *borrowed = *context->shared_bvh;
    borrowed->mesh = mesh;
    borrowed->duplicate = NULL; // asked for while the tree is built only
    rtcRetainScene(borrowed->scene);
    *bvh = borrowed;
    return PC_OK;
}

pc_status pci_bvh_create(pc_context *context, const char *stage, const pc_mesh *mesh,
                         pci_bvh **bvh) {
    const pc_mesh *shared = context->shared_mesh;
    *bvh = NULL;
    if (shared == NULL || (mesh != shared && !same_triangles(mesh, shared))) {
        return build_tree(context, stage, mesh, bvh);
    }
    if (context->shared_bvh == NULL) {
        const pc_status status = build_tree(context, stage, shared, &context->shared_bvh);
        if (status != PC_OK) {
            return status;
        }
    }
    if (mesh == shared) {
        *bvh = context->shared_bvh;
        return PC_OK;
    }
    // Repetitions that are left out are some that the other mesh may keep apart.
    return context->shared_bvh->repeats ? build_tree(context, stage, mesh, bvh)
                                        : borrow_shared(context, stage, mesh, bvh);
}

bool pci_bvh_shares(const pc_context *context) { return context->shared_mesh != NULL; }

void pci_bvh_share(pc_context *context, const pc_mesh *mesh) {
    pci_bvh *last = context->shared_bvh;
    context->shared_mesh = mesh;
    context->shared_bvh = NULL;
    pci_bvh_destroy(context, last);
}

void pci_bvh_destroy(pc_context *context, pci_bvh *bvh) {
    if (bvh == NULL || bvh == context->shared_bvh) {
        return;
    }
    if (bvh->scene != NULL) {
        rtcReleaseScene(bvh->scene);
    }
    pc_release(context, bvh->duplicate);
    pc_release(context, bvh);
}

// ---- closest point ------------------------------------------------------------------------------

// The point of a triangle that is closest to the origin.
typedef struct closest_spot {
    double distance2;
    double barycentric[3];
} closest_spot;

// Takes the closest point of the edge from the corner `first` at `from` to the next one at `to`
// where that is closer. Corners are as far away whatever edge they are seen from.
static inline void compare_edge(const double from[3], const double to[3], const double edge[3],
                                size_t first, closest_spot *best) {
    const double along = -pci_dot(from, edge), length2 = pci_dot(edge, edge);
    double fraction = 0.0, distance2 = 0.0;
    if (!(along > 0.0)) {
        distance2 = pci_dot(from, from);
    } else if (!(along < length2)) {
        fraction = 1.0;
        distance2 = pci_dot(to, to);
    } else {
        fraction = along / length2;
        const double r[3] = {from[0] + fraction * edge[0], from[1] + fraction * edge[1],
                             from[2] + fraction * edge[2]};
        distance2 = pci_dot(r, r);
    }
    if (distance2 < best->distance2) {
        best->distance2 = distance2;
        best->barycentric[first] = 1.0 - fraction;
        best->barycentric[(first + 1) % 3] = fraction;
        best->barycentric[(first + 2) % 3] = 0.0;
    }
}

double pci_triangle_squared_distance(const double point[3], const double a[3], const double b[3],
                                     const double c[3], double barycentric[3]) {
    double pa[3], pb[3], pc[3], ab[3], bc[3], ca[3], normal[3], t[3], w[3];
    pci_sub(a, point, pa);
    pci_sub(b, point, pb);
    pci_sub(c, point, pc);
    pci_sub(b, a, ab);
    pci_sub(c, b, bc);
    pci_sub(a, c, ca);
    pci_cross(ab, bc, normal);
    pci_cross(pb, bc, t);
    w[0] = pci_dot(t, normal);
    pci_cross(pc, ca, t);
    w[1] = pci_dot(t, normal);
    pci_cross(pa, ab, t);
    w[2] = pci_dot(t, normal);

    // The foot of the perpendicular, when it lies inside. Whatever the rounding, the weights are
    // those of a point of the triangle, and the distance is measured to that point.
    const bool sliver = !(pci_dot(normal, normal) > 1e-6 * pci_dot(ab, ab) * pci_dot(ca, ca));
    closest_spot best = {.distance2 = INFINITY};
    if (w[0] > 0.0 && w[1] > 0.0 && w[2] > 0.0) {
        const double sum = w[0] + w[1] + w[2];
        for (size_t k = 0; k < 3; ++k) {
            best.barycentric[k] = w[k] / sum;
        }
        const double u = best.barycentric[1], v = best.barycentric[2];
        const double r[3] = {pa[0] + u * ab[0] - v * ca[0], pa[1] + u * ab[1] - v * ca[1],
                             pa[2] + u * ab[2] - v * ca[2]};
        best.distance2 = pci_dot(r, r);
    }
    // Otherwise it is on an edge with the foot on its outer side; slivers, where neither the foot
    // nor its side is to be trusted, compare all edges.
    if (sliver || !(w[2] > 0.0)) {
        compare_edge(pa, pb, ab, 0, &best);
    }
    if (sliver || !(w[0] > 0.0)) {
        compare_edge(pb, pc, bc, 1, &best);
    }
    if (sliver || !(w[1] > 0.0)) {
        compare_edge(pc, pa, ca, 2, &best);
    }
    memcpy(barycentric, best.barycentric, sizeof(best.barycentric));
    return best.distance2;
}

static double distance2_to(const pc_mesh *mesh, uint32_t t, const double point[3],
                           double barycentric[3]) {
    return pci_triangle_squared_distance(point, corner(mesh, t, 0), corner(mesh, t, 1),
                                         corner(mesh, t, 2), barycentric);
}

static bool is_within(const pc_mesh *mesh, uint32_t t, const double point[3], double radius) {
    double barycentric[3];
    return sqrt(distance2_to(mesh, t, point, barycentric)) <= radius;
}

bool pci_triangle_within(const pc_mesh *mesh, size_t t, const double point[3], double radius) {
    const double *corners[3] = {corner(mesh, t, 0), corner(mesh, t, 1), corner(mesh, t, 2)};
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
    double barycentric[3];
} closest_query;

// Whether the triangle is the nearest one so far; ties go to the smaller index.
static inline bool is_nearest(const closest_query *query, uint32_t triangle, double distance2) {
    return !(distance2 > query->distance2 ||
             (distance2 == query->distance2 && triangle > query->triangle));
}

static inline void keep_nearest(closest_query *query, uint32_t triangle, double distance2,
                                const double barycentric[3]) {
    query->distance2 = distance2;
    query->triangle = triangle;
    memcpy(query->barycentric, barycentric, sizeof(query->barycentric));
}

static bool visit_triangle(struct RTCPointQueryFunctionArguments *arguments) {
    closest_query *query = arguments->userPtr;
    const pc_mesh *mesh = query->bvh->mesh;
    const uint32_t t = arguments->primID;
    double barycentric[3] = {0};
    const double distance2 = distance2_to(mesh, t, query->point, barycentric);
    if (!is_nearest(query, t, distance2)) {
        return false;
    }
    const double distance = sqrt(distance2);
    if (!(distance <= query->radius)) {
        return false;
    }
    keep_nearest(query, t, distance2, barycentric);
    // Shrink the search, with slack so that triangles at the same distance are still visited.
    const float radius = (float)(distance * query->bvh->scale * (1.0 + 1e-6) + query->slack);
    if (radius < arguments->query->radius) {
        arguments->query->radius = radius;
        return true;
    }
    return false;
}

// Embree's form of a point query: the point, and `radius` with all the rounding and padding added.
// `slack` is what a later, smaller radius needs on top.
static struct RTCPointQuery search_around(const pci_bvh *bvh, const double point[3], double radius,
                                          double *slack) {
    double local[3], largest = 0.0;
    for (size_t k = 0; k < 3; ++k) {
        local[k] = (point[k] - bvh->centre[k]) * bvh->scale;
        largest = fmax(largest, fabs(local[k]));
    }
    struct RTCPointQuery search = {.radius = INFINITY};
    *slack = INFINITY;
    if (largest <= FARTHEST_POINT) {
        search.x = (float)local[0], search.y = (float)local[1], search.z = (float)local[2];
        *slack = 4.0 * (double)FLT_EPSILON * (largest + 1.0);
        search.radius = (float)(radius * bvh->scale * (1.0 + 1e-6) + *slack);
    }
    return search;
}

// Calls `visit` for the triangles that may be within `radius`. `slack` is set before.
static void visit_around(const pci_bvh *bvh, const double point[3], double radius,
                         RTCPointQueryFunction visit, void *user, double *slack) {
    if (!(radius >= 0.0) || !isfinite(point[0] + point[1] + point[2])) {
        return;
    }
    struct RTCPointQuery search = search_around(bvh, point, radius, slack);
    struct RTCPointQueryContext search_context;
    rtcInitPointQueryContext(&search_context);
    rtcPointQuery(bvh->scene, &search, &search_context, visit, user);
}

typedef struct overlap_query {
    const pci_bvh *bvh;
    const double *point;
    size_t count;
} overlap_query;

// Counts the boxes that hold the point.
static bool count_box(struct RTCPointQueryFunctionArguments *arguments) {
    overlap_query *query = arguments->userPtr;
    bool inside = true;
    for (size_t k = 0; k < 3 && inside; ++k) {
        const double x = query->point[k];
        bool below = false, above = false;
        for (size_t c = 0; c < 3; ++c) {
            const double at = corner(query->bvh->mesh, arguments->primID, c)[k];
            below = below || at <= x;
            above = above || at >= x;
        }
        inside = below && above;
    }
    query->count += inside;
    return false;
}

// How many boxes hold the middle of a triangle, on average over some.
static double measure_overlap(const pci_bvh *bvh) {
    enum { most_samples = 64 };
    const size_t count = bvh->mesh->triangle_count;
    const size_t samples = count < most_samples ? count : most_samples;
    overlap_query query = {.bvh = bvh};
    for (size_t i = 0; i < samples; ++i) {
        double middle[3], slack = 0.0;
        pci_triangle_middle(bvh->mesh, i * (count / samples), middle);
        query.point = middle;
        visit_around(bvh, middle, 0.0, count_box, &query, &slack);
    }
    return samples > 0 ? (double)query.count / (double)samples : 0.0;
}

// The result of a finished query.
static pci_closest found_closest(const closest_query *query) {
    pci_closest closest = {.triangle = query->triangle};
    if (query->triangle != PC_INVALID_INDEX) {
        closest.distance = sqrt(query->distance2);
        memcpy(closest.barycentric, query->barycentric, sizeof(closest.barycentric));
        for (size_t k = 0; k < 3; ++k) {
            for (size_t c = 0; c < 3; ++c) {
                closest.point[k] +=
                    closest.barycentric[c] * corner(query->bvh->mesh, closest.triangle, c)[k];
            }
        }
    }
    return closest;
}

pci_closest pci_bvh_closest(const pci_bvh *bvh, const double point[3], double radius) {
    closest_query query = {.bvh = bvh,
                           .point = point,
                           .radius = radius,
                           .distance2 = INFINITY,
                           .triangle = PC_INVALID_INDEX};
    visit_around(bvh, point, radius, visit_triangle, &query, &query.slack);
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
    const pc_mesh *mesh;
    const double *point;
    double radius;
    uint32_t found; // PC_INVALID_INDEX: none so far
} within_query;

static bool visit_until_found(struct RTCPointQueryFunctionArguments *arguments) {
    within_query *query = arguments->userPtr;
    if (query->found != PC_INVALID_INDEX ||
        !is_within(query->mesh, arguments->primID, query->point, query->radius)) {
        return false;
    }
    query->found = arguments->primID;
    arguments->query->radius = 0.0F; // hardly anything is visited from now on
    return true;
}

bool pci_bvh_within(const pci_bvh *bvh, const double point[3], double radius) {
    uint32_t hint = PC_INVALID_INDEX;
    return pci_bvh_within_near(bvh, point, radius, &hint);
}

bool pci_bvh_within_near(const pci_bvh *bvh, const double point[3], double radius, uint32_t *hint) {
    within_query query = {bvh->mesh, point, radius, PC_INVALID_INDEX};
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
    const pc_mesh *mesh;
    const double *point;
    double squared_radius;
    size_t count, capacity;
    uint32_t *triangles;
} collection;

static bool collect_triangle(struct RTCPointQueryFunctionArguments *arguments) {
    collection *found = arguments->userPtr;
    const pc_mesh *mesh = found->mesh;
    const uint32_t t = arguments->primID;
    double barycentric[3];
    // Most of what comes here has a corner within the radius, which is cheaper to know.
    bool within = false;
    for (size_t c = 0; c < 3 && !within; ++c) {
        within = pci_squared_distance(found->point, corner(mesh, t, c)) <= found->squared_radius;
    }
    if (found->count <= found->capacity &&
        (within || distance2_to(mesh, t, found->point, barycentric) <= found->squared_radius)) {
        if (found->count < found->capacity) {
            found->triangles[found->count] = t;
        }
        ++found->count;
    }
    if (found->count <= found->capacity || arguments->query->radius == 0.0f) {
        return false;
    }
    arguments->query->radius = 0.0f; // enough
    return true;
}

size_t pci_bvh_collect(const pci_bvh *bvh, const double point[3], double radius, size_t capacity,
                       uint32_t *triangles) {
    collection found = {.mesh = bvh->mesh,
                        .point = point,
                        .squared_radius = radius * radius,
                        .capacity = capacity,
                        .triangles = triangles};
    double slack = 0.0;
    visit_around(bvh, point, radius, collect_triangle, &found, &slack);
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

static bool list_triangle(struct RTCPointQueryFunctionArguments *arguments) {
    ball_query *query = arguments->userPtr;
    pci_surroundings *around = query->around;
    const uint32_t t = arguments->primID;
    double barycentric[3] = {0};
    const double distance2 = distance2_to(query->best.bvh->mesh, t, query->best.point, barycentric);
    if (around->count > PCI_SURROUNDINGS || !(distance2 <= query->squared_radius)) {
        return false;
    }
    if (around->count < PCI_SURROUNDINGS) {
        around->triangles[around->count] = t;
        around->distances[around->count] = sqrt(distance2);
    }
    if (is_nearest(&query->best, t, distance2)) {
        keep_nearest(&query->best, t, distance2, barycentric);
    }
    if (++around->count <= PCI_SURROUNDINGS) {
        return false;
    }
    arguments->query->radius = 0.0f; // too many
    return true;
}

// Leaves out those that are too far away, since the point moved only so far.
static closest_query look_around(const pci_bvh *bvh, const double point[3],
                                 const pci_surroundings *around, double way) {
    closest_query best = {.bvh = bvh, .distance2 = INFINITY, .triangle = PC_INVALID_INDEX};
    double nearest = INFINITY, barycentric[3] = {0};
    for (uint32_t i = 0; i < around->count; ++i) {
        if (around->distances[i] - way <= nearest) {
            const double distance2 =
                distance2_to(bvh->mesh, around->triangles[i], point, barycentric);
            if (is_nearest(&best, around->triangles[i], distance2)) {
                keep_nearest(&best, around->triangles[i], distance2, barycentric);
            }
            nearest = sqrt(best.distance2) + ball_slack * around->radius;
        }
    }
    return best;
}

pci_closest pci_bvh_closest_moving(const pci_bvh *bvh, const double point[3], double bound,
                                   double margin, pci_surroundings *around) {
    // Whatever is within the bound of the point is within this of the old centre.
    const double way = sqrt(pci_squared_distance(point, around->centre));
    if ((bound + way) * (1.0 + ball_slack) <= around->radius) {
        const closest_query best = look_around(bvh, point, around, way);
        return found_closest(&best);
    }
    const double radius = (bound + margin) * (1.0 + 4.0 * ball_slack);
    ball_query query = {
        .best = {.bvh = bvh, .point = point, .distance2 = INFINITY, .triangle = PC_INVALID_INDEX},
        .around = around,
        .squared_radius = radius * radius};
    double slack = 0.0;
    around->count = 0;
    around->radius = -1.0;
    visit_around(bvh, point, radius, list_triangle, &query, &slack);
    if (around->count == 0 || around->count > PCI_SURROUNDINGS) {
        return pci_bvh_closest(bvh, point, bound);
    }
    memcpy(around->centre, point, sizeof(around->centre));
    around->radius = radius;
    return found_closest(&query.best);
}

// ---- rays ---------------------------------------------------------------------------------------

typedef struct ray_query {
    struct RTCIntersectContext context; // first: Embree hands back a pointer to it
    const pci_bvh *bvh;
    const double *origin;
    size_t axis[3];  // the last one is the direction's largest component
    double shear[3]; // takes the direction to (0, 0, 1)
    double near, far;
    double entry;      // parameter of Embree's ray origin
    double local_rate; // Embree's distance per unit of ours
    pci_hit_filter filter;
    void *user;
    pci_hit best;
} ray_query;

// Watertight test (Woop, Benthin, Wald 2013) in double: vertices are sheared the same way in every
// triangle, so a ray through a shared edge or vertex never slips through.
static bool intersect(const ray_query *ray, uint32_t triangle, pci_hit *hit) {
    double x[3], y[3], z[3];
    for (size_t c = 0; c < 3; ++c) {
        const double *position = corner(ray->bvh->mesh, triangle, c);
        double relative[3];
        pci_sub(position, ray->origin, relative);
        const double along = relative[ray->axis[2]];
        x[c] = relative[ray->axis[0]] - ray->shear[0] * along;
        y[c] = relative[ray->axis[1]] - ray->shear[1] * along;
        z[c] = ray->shear[2] * along;
    }
    const double u = x[2] * y[1] - y[2] * x[1];
    const double v = x[0] * y[2] - y[0] * x[2];
    const double w = x[1] * y[0] - y[1] * x[0];
    if ((u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0)) {
        return false;
    }
    const double sum = u + v + w;
    if (sum == 0.0) {
        return false; // seen edge-on or without area
    }
    hit->triangle = triangle;
    hit->barycentric[0] = u / sum;
    hit->barycentric[1] = v / sum;
    hit->barycentric[2] = w / sum;
    hit->distance =
        hit->barycentric[0] * z[0] + hit->barycentric[1] * z[1] + hit->barycentric[2] * z[2];
    hit->back_face = sum < 0.0;
    return hit->distance >= ray->near && hit->distance <= ray->far;
}

static void intersect_triangle(const struct RTCIntersectFunctionNArguments *arguments) {
    if (arguments->valid[0] == 0) {
        return;
    }
    ray_query *ray = (ray_query *)(void *)arguments->context;
    pci_hit hit = {0};
    if (!intersect(ray, arguments->primID, &hit) || hit.distance > ray->best.distance ||
        (hit.distance == ray->best.distance && hit.triangle > ray->best.triangle) ||
        (ray->filter != NULL && !ray->filter(ray->user, &hit))) {
        return;
    }
    ray->best = hit;
    // Shorten the ray, with slack so that triangles at the same distance are still visited.
    struct RTCRayHit *search = (struct RTCRayHit *)(void *)arguments->rayhit;
    const float reach = (float)((hit.distance - ray->entry) * ray->local_rate + PADDING);
    if (reach < search->ray.tfar) {
        search->ray.tfar = reach;
    }
}

// Parameters where the ray enters and leaves the box around the mesh, enlarged by `margin`.
// Starting Embree's ray there keeps its float coordinates small. False: the box is missed.
static bool clip_ray(const pci_bvh *bvh, const double origin[3], const double direction[3],
                     double margin, double *enter, double *leave) {
    for (size_t k = 0; k < 3; ++k) {
        const double low = bvh->minimum[k] - margin - origin[k];
        const double high = bvh->maximum[k] + margin - origin[k];
        if (direction[k] == 0.0) {
            if (low > 0.0 || high < 0.0) {
                return false;
            }
            continue;
        }
        const double a = low / direction[k], b = high / direction[k];
        *enter = fmax(*enter, fmin(a, b));
        *leave = fmin(*leave, fmax(a, b));
    }
    return *enter <= *leave;
}

pci_hit pci_bvh_cast(const pci_bvh *bvh, const double origin[3], const double direction[3],
                     double near, double far, pci_hit_filter filter, void *user) {
    const pci_hit miss = {.triangle = PC_INVALID_INDEX};
    const double length = pci_norm(direction);
    double enter = near, leave = far;
    // The margin leaves room for the slack of the float ray and for the rounding of this clipping.
    const double margin = 1e-3 / bvh->scale;
    if (!(length > 0.0) || !isfinite(length) ||
        !clip_ray(bvh, origin, direction, margin, &enter, &leave)) {
        return miss;
    }

    ray_query ray = {.bvh = bvh,
                     .origin = origin,
                     .near = near,
                     .far = far,
                     .entry = enter,
                     .local_rate = length * bvh->scale,
                     .filter = filter,
                     .user = user};
    ray.best = miss;
    ray.best.distance = INFINITY;
    size_t z = 0;
    for (size_t k = 1; k < 3; ++k) {
        z = fabs(direction[k]) > fabs(direction[z]) ? k : z;
    }
    // Swapping two axes for a negative direction keeps the winding.
    const size_t x = direction[z] < 0.0 ? (z + 2) % 3 : (z + 1) % 3;
    const size_t y = direction[z] < 0.0 ? (z + 1) % 3 : (z + 2) % 3;
    ray.axis[0] = x, ray.axis[1] = y, ray.axis[2] = z;
    ray.shear[0] = direction[x] / direction[z];
    ray.shear[1] = direction[y] / direction[z];
    ray.shear[2] = 1.0 / direction[z];

    // Embree as Debian builds it ends the process when a ray is not finite.
    float from[3], towards[3];
    for (size_t k = 0; k < 3; ++k) {
        from[k] = (float)((origin[k] + enter * direction[k] - bvh->centre[k]) * bvh->scale);
        towards[k] = (float)(direction[k] / length);
        if (!(fabsf(from[k]) < (float)FARTHEST_POINT)) {
            return miss; // an origin so far away that nothing is left of the clipping
        }
    }
    const float reach = (float)((leave - enter) * ray.local_rate + PADDING);
    if (!isfinite(reach)) {
        return miss;
    }
    struct RTCRayHit search = {.ray = {.org_x = from[0],
                                       .org_y = from[1],
                                       .org_z = from[2],
                                       .dir_x = towards[0],
                                       .dir_y = towards[1],
                                       .dir_z = towards[2],
                                       .tfar = reach,
                                       .mask = UINT32_MAX},
                               .hit = {.geomID = RTC_INVALID_GEOMETRY_ID}};
    rtcInitIntersectContext(&ray.context);
    rtcIntersect1(bvh->scene, &ray.context, &search);
    return ray.best.triangle == PC_INVALID_INDEX ? miss : ray.best;
}
