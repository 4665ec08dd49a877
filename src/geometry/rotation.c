#include "geometry/rotation.h"

#include "geometry/topology.h"

static const char stage[] = "rotation";

// Of all pins together, and of the identity, in the fit of some pins: no more than to decide what
// these leave open.
static const double all_share = 1e-3, still_share = 1e-9;

// An edge of a vertex: where it points at rest, by coordinates in the tangent plane.
typedef struct spoke {
    uint32_t vertex;
    double along, across; // over the squared length of the edge
} spoke;

struct pc_rotation_estimator {
    size_t vertex_count, triangle_count;
    double *frames;       // #V by 9: tangent, second tangent, normal at rest; 0: never turns
    size_t *spoke_ranges; // #V + 1
    spoke *spokes;
    uint32_t *triangles; // #triangles by 3
    uint8_t *border;     // #V: an edge of the vertex has another number of triangles than two
    // Pinned vertices in bodies.
    uint8_t *pinned; // #V
    double *rest;    // #V by 3; only where there are pins
    size_t body_count;
    size_t *body_ranges; // #bodies + 1
    uint32_t *members;
};

static inline void get_point(const pci_points *points, size_t index, double out[3]) {
    const char *at = (const char *)points->start + index * points->stride;
    if (points->single) {
        const float *p = (const float *)(const void *)at;
        out[0] = (double)p[0], out[1] = (double)p[1], out[2] = (double)p[2];
    } else {
        memcpy(out, at, 3 * sizeof(double));
    }
}

// ---- matrices and quaternions -------------------------------------------------------------------

void pci_quaternion_of_matrix(const double r[9], double quaternion[4]) {
    // Four times the square of each component; the largest one is safe to divide by.
    const double squares[4] = {1.0 + r[0] - r[4] - r[8], 1.0 - r[0] + r[4] - r[8],
                               1.0 - r[0] - r[4] + r[8], 1.0 + r[0] + r[4] + r[8]};
    const double products[4][4] = {{squares[0], r[1] + r[3], r[2] + r[6], r[7] - r[5]},
                                   {r[1] + r[3], squares[1], r[5] + r[7], r[2] - r[6]},
                                   {r[2] + r[6], r[5] + r[7], squares[2], r[3] - r[1]},
                                   {r[7] - r[5], r[2] - r[6], r[3] - r[1], squares[3]}};
    size_t best = 3;
    for (size_t k = 0; k < 3; ++k) {
        best = squares[k] > squares[best] ? k : best;
    }
    const double *row = products[best];
    const double length =
        sqrt(row[0] * row[0] + row[1] * row[1] + row[2] * row[2] + row[3] * row[3]);
    const double factor = (row[3] < 0.0 ? -1.0 : 1.0) / length;
    for (size_t k = 0; k < 4; ++k) {
        quaternion[k] = factor * row[k];
    }
}

void pci_matrix_of_quaternion(const double quaternion[4], double r[9]) {
    const double x = quaternion[0], y = quaternion[1], z = quaternion[2], w = quaternion[3];
    r[0] = 1.0 - 2.0 * (y * y + z * z), r[1] = 2.0 * (x * y - z * w), r[2] = 2.0 * (x * z + y * w);
    r[3] = 2.0 * (x * y + z * w), r[4] = 1.0 - 2.0 * (x * x + z * z), r[5] = 2.0 * (y * z - x * w);
    r[6] = 2.0 * (x * z - y * w), r[7] = 2.0 * (y * z + x * w), r[8] = 1.0 - 2.0 * (x * x + y * y);
}

// ---- preparation --------------------------------------------------------------------------------

// What is known of a vertex while rotations are estimated is in the memory of its result: the
// caller gives no other, and results may be of any type. Single precision is what fits.
typedef struct workspace {
    char *start;
    size_t stride; // bytes from one vertex to the next
} workspace;

enum {
    OWN = 0,   // quaternion from the 1-ring or the pins; 0: none
    OTHER = 16 // twice the area vector, then the average of the rotations around
};

static inline void get_four(const workspace *w, size_t vertex, size_t part, float out[4]) {
    memcpy(out, w->start + vertex * w->stride + part, 4 * sizeof(*out));
}
static inline void set_four(const workspace *w, size_t vertex, size_t part, const float in[4]) {
    memcpy(w->start + vertex * w->stride + part, in, 4 * sizeof(*in));
}

// The sums of the area vectors of the triangles around each vertex.
static void sum_areas(const pc_rotation_estimator *e, const pci_points *pose, const workspace *w) {
    static const float nothing[4] = {0.0F};
    for (size_t v = 0; v < e->vertex_count; ++v) {
        set_four(w, v, OWN, nothing);
        set_four(w, v, OTHER, nothing);
    }
    for (size_t t = 0; t < e->triangle_count; ++t) {
        const uint32_t *corner = &e->triangles[3 * t];
        double a[3], b[3], c[3], cross[3];
        get_point(pose, corner[0], a);
        get_point(pose, corner[1], b);
        get_point(pose, corner[2], c);
        pci_sub(b, a, b);
        pci_sub(c, a, c);
        pci_cross(b, c, cross);
        for (size_t i = 0; i < 3; ++i) {
            float area[4];
            get_four(w, corner[i], OTHER, area);
            area[0] += (float)cross[0], area[1] += (float)cross[1], area[2] += (float)cross[2];
            set_four(w, corner[i], OTHER, area);
        }
    }
}

static void get_area(const workspace *w, size_t vertex, double area[3]) {
    float at[4];
    get_four(w, vertex, OTHER, at);
    area[0] = (double)at[0], area[1] = (double)at[1], area[2] = (double)at[2];
}

static void list_spokes(const pc_mesh *mesh, const pci_topology *topology,
                        pc_rotation_estimator *e) {
    const pci_points rest = {mesh->positions, 3 * sizeof(double), false};
    const workspace room = {(char *)e->frames, 9 * sizeof(double)};
    sum_areas(e, &rest, &room);
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        const double *here = &mesh->positions[3 * v];
        double *tangent = &e->frames[9 * v], *second = tangent + 3, *normal = tangent + 6;
        get_area(&room, v, normal);
        memset(tangent, 0, 6 * sizeof(*tangent));
        if (pci_normalize(normal)) {
            const double helper[3] = {fabs(normal[0]) < 0.7 ? 1.0 : 0.0,
                                      fabs(normal[0]) < 0.7 ? 0.0 : 1.0, 0.0};
            pci_cross(helper, normal, tangent);
            (void)pci_normalize(tangent);
            pci_cross(normal, tangent, second);
        }
        e->spoke_ranges[v + 1] = topology->ring_offsets[v + 1];
        for (size_t s = topology->ring_offsets[v]; s < topology->ring_offsets[v + 1]; ++s) {
            double edge[3];
            pci_sub(&mesh->positions[3 * (size_t)topology->ring[s]], here, edge);
            const double square = pci_dot(edge, edge);
            e->spokes[s].vertex = topology->ring[s];
            if (square > 0.0) {
                e->spokes[s].along = pci_dot(edge, tangent) / square;
                e->spokes[s].across = pci_dot(edge, second) / square;
            }
        }
    }
}

// Each body is a run of members, in the order in which edges reach them.
static void list_bodies(const pci_topology *topology, pc_rotation_estimator *e) {
    uint8_t *pinned = e->pinned;
    size_t count = 0;
    for (size_t v = 0; v < e->vertex_count; ++v) {
        if (pinned[v] != 1) {
            continue; // free, or in a body
        }
        pinned[v] = 2;
        e->members[count++] = (uint32_t)v;
        for (size_t at = count - 1; at < count; ++at) {
            const size_t member = e->members[at];
            for (size_t s = topology->ring_offsets[member]; s < topology->ring_offsets[member + 1];
                 ++s) {
                if (pinned[topology->ring[s]] == 1) {
                    pinned[topology->ring[s]] = 2;
                    e->members[count++] = topology->ring[s];
                }
            }
        }
        e->body_ranges[++e->body_count] = count;
    }
}

static bool fill(pc_context *context, const pc_mesh *mesh, const uint8_t *pinned,
                 pc_rotation_estimator *e) {
    const size_t nv = mesh->vertex_count;
    pci_scratch scratch = pci_scratch_begin(context);
    pci_topology topology;
    bool good = pci_topology_build(&scratch, mesh, &topology);
    if (good) {
        e->vertex_count = nv;
        e->frames = PCI_ALLOCATE(context, double, 9 * nv);
        e->spoke_ranges = PCI_ALLOCATE(context, size_t, nv + 1);
        e->spokes = PCI_ALLOCATE(context, spoke, topology.ring_offsets[nv]);
        e->triangles = PCI_ALLOCATE(context, uint32_t, 3 * mesh->triangle_count);
        e->border = PCI_ALLOCATE(context, uint8_t, nv);
        e->pinned = PCI_ALLOCATE(context, uint8_t, nv);
        e->body_ranges = PCI_ALLOCATE(context, size_t, nv + 1);
        e->members = PCI_ALLOCATE(context, uint32_t, nv);
        e->rest = PCI_ALLOCATE(context, double, 3 * nv);
        good = e->frames != NULL && e->spoke_ranges != NULL && e->spokes != NULL &&
               e->triangles != NULL && e->border != NULL && e->pinned != NULL &&
               e->body_ranges != NULL && e->members != NULL && e->rest != NULL;
    }
    if (good) {
        memcpy(e->rest, mesh->positions, 3 * nv * sizeof(double));
        e->triangle_count = mesh->triangle_count;
        if (mesh->triangle_count > 0) {
            memcpy(e->triangles, mesh->triangles, 3 * mesh->triangle_count * sizeof(uint32_t));
        }
        list_spokes(mesh, &topology, e);
        for (size_t v = 0; v < nv && pinned != NULL; ++v) {
            e->pinned[v] = pinned[v] != 0;
        }
        list_bodies(&topology, e);
        for (size_t i = 0; i < topology.edge_count; ++i) {
            const size_t count = pci_side_count(&topology, i);
            for (size_t end = 0; end < 2 && count != 2; ++end) {
                e->border[topology.edges[2 * i + end]] = 1;
            }
        }
    }
    pci_scratch_end(&scratch);
    return good;
}

pc_status pci_rotation_prepare(pc_context *context, const char *caller, const pc_mesh *mesh,
                               const uint8_t *pinned, pc_rotation_estimator **estimator) {
    *estimator = NULL;
    pc_rotation_estimator *made = PCI_ALLOCATE(context, pc_rotation_estimator, 1);
    if (made == NULL || !fill(context, mesh, pinned, made)) {
        pc_rotation_estimator_destroy(context, made);
        return pci_fail_memory(context, caller);
    }
    *estimator = made;
    return PC_OK;
}

pc_status pc_rotation_estimator_create(pc_context *context, const pc_mesh *proxy,
                                       const uint8_t *pinned, pc_rotation_estimator **estimator) {
    if (estimator == NULL) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage, "%s: the output is NULL", stage);
    }
    *estimator = NULL;
    const pc_status status = pci_check_mesh(context, stage, proxy, "proxy mesh");
    return status == PC_OK ? pci_rotation_prepare(context, stage, proxy, pinned, estimator)
                           : status;
}

void pc_rotation_estimator_destroy(pc_context *context, pc_rotation_estimator *e) {
    if (e == NULL) {
        return;
    }
    pc_release(context, e->frames);
    pc_release(context, e->spoke_ranges);
    pc_release(context, e->spokes);
    pc_release(context, e->triangles);
    pc_release(context, e->border);
    pc_release(context, e->pinned);
    pc_release(context, e->rest);
    pc_release(context, e->body_ranges);
    pc_release(context, e->members);
    pc_release(context, e);
}

// ---- every frame --------------------------------------------------------------------------------

static void keep_rotation(const workspace *w, size_t vertex, const double rotation[9]) {
    double q[4];
    pci_quaternion_of_matrix(rotation, q);
    const float own[4] = {(float)q[0], (float)q[1], (float)q[2], (float)q[3]};
    set_four(w, vertex, OWN, own);
}

// What the 1-ring of a vertex does. False: it tells no rotation, and the result is the identity.
static bool turn_vertex(const pc_rotation_estimator *e, const pci_points *pose, size_t vertex,
                        const workspace *w, double r[9]) {
    const double *rest = &e->frames[9 * vertex];
    double here[3], normal[3], along[3] = {0.0}, across[3] = {0.0}, tangent[3], second[3];
    get_point(pose, vertex, here);
    get_area(w, vertex, normal);
    const bool flat = !pci_normalize(normal);
    for (size_t s = e->spoke_ranges[vertex]; s < e->spoke_ranges[vertex + 1]; ++s) {
        const spoke *at = &e->spokes[s];
        double there[3];
        get_point(pose, at->vertex, there);
        for (size_t k = 0; k < 3; ++k) {
            along[k] += at->along * (there[k] - here[k]);
            across[k] += at->across * (there[k] - here[k]);
        }
    }
    // Within the plane the rotation that turns both least-squares sums best: a tangent of
    // along + across x normal.
    pci_cross(across, normal, tangent);
    const double height = pci_dot(along, normal);
    for (size_t k = 0; k < 3; ++k) {
        tangent[k] += along[k] - height * normal[k];
    }
    const bool still = rest[0] == 0.0 && rest[1] == 0.0 && rest[2] == 0.0;
    if (flat || still || !pci_normalize(tangent)) {
        static const double identity[9] = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0};
        memcpy(r, identity, sizeof(identity));
        return false;
    }
    pci_cross(normal, tangent, second);
    for (size_t i = 0; i < 3; ++i) {
        for (size_t j = 0; j < 3; ++j) {
            r[3 * i + j] = tangent[i] * rest[j] + second[i] * rest[3 + j] + normal[i] * rest[6 + j];
        }
    }
    return true;
}

// sum (p - mean)(p0 - mean0)^T of some pinned vertices, over its trace at rest.
static void fit_members(const pc_rotation_estimator *e, const pci_points *pose, size_t begin,
                        size_t end, double share, double s[9]) {
    double mean[3] = {0.0}, rest_mean[3] = {0.0}, sums[9] = {0.0}, trace = 0.0, p[3], p0[3];
    const double count = (double)(end - begin);
    for (size_t m = begin; m < end; ++m) {
        get_point(pose, e->members[m], p);
        for (size_t k = 0; k < 3; ++k) {
            mean[k] += p[k] / count;
            rest_mean[k] += e->rest[3 * (size_t)e->members[m] + k] / count;
        }
    }
    for (size_t m = begin; m < end; ++m) {
        get_point(pose, e->members[m], p);
        pci_sub(p, mean, p);
        pci_sub(&e->rest[3 * (size_t)e->members[m]], rest_mean, p0);
        trace += pci_dot(p0, p0);
        for (size_t k = 0; k < 9; ++k) {
            sums[k] += p[k / 3] * p0[k % 3];
        }
    }
    for (size_t k = 0; k < 9 && trace > 0.0; ++k) {
        s[k] += share * sums[k] / trace;
    }
}

static void turn_bodies(const pc_rotation_estimator *e, const pci_points *pose,
                        const workspace *w) {
    double all[9] = {still_share, 0.0, 0.0, 0.0, still_share, 0.0, 0.0, 0.0, still_share};
    fit_members(e, pose, 0, e->body_ranges[e->body_count], all_share, all);
    for (size_t b = 0; b < e->body_count; ++b) {
        double s[9], q[4], r[9];
        memcpy(s, all, sizeof(s));
        fit_members(e, pose, e->body_ranges[b], e->body_ranges[b + 1], 1.0, s);
        pci_rotation_by_jacobi(s, q);
        const double quaternion[4] = {q[1], q[2], q[3], q[0]};
        pci_matrix_of_quaternion(quaternion, r);
        for (size_t m = e->body_ranges[b]; m < e->body_ranges[b + 1]; ++m) {
            keep_rotation(w, e->members[m], r);
        }
    }
}

static inline bool is_known(const float q[4]) {
    return q[0] != 0.0F || q[1] != 0.0F || q[2] != 0.0F || q[3] != 0.0F;
}

// Half the rotation of the vertex, half the mean of those around: a ring of six triangles is not
// much to go by. Pins keep theirs, and so do borders, whose neighbours are all on one side.
static void average(const pc_rotation_estimator *e, size_t vertex, const workspace *w) {
    float own[4], sum[4] = {0.0F}, around = 0.0F;
    get_four(w, vertex, OWN, own);
    const bool kept = e->pinned[vertex] != 0 || (e->border[vertex] != 0 && is_known(own));
    const size_t end = kept ? 0 : e->spoke_ranges[vertex + 1];
    for (size_t s = e->spoke_ranges[vertex]; s < end; ++s) {
        float q[4];
        get_four(w, e->spokes[s].vertex, OWN, q);
        const float *to = around == 0.0F ? own : sum;
        const float cosine = q[0] * to[0] + q[1] * to[1] + q[2] * to[2] + q[3] * to[3];
        const float sign = cosine < 0.0F ? -1.0F : 1.0F;
        around += is_known(q) ? 1.0F : 0.0F;
        for (size_t k = 0; k < 4; ++k) {
            sum[k] += sign * q[k];
        }
    }
    const float share = around > 0.0F ? 1.0F / around : 0.0F;
    for (size_t k = 0; k < 4; ++k) {
        own[k] += share * sum[k];
    }
    own[3] = is_known(own) ? own[3] : 1.0F;
    set_four(w, vertex, OTHER, own);
}

void pci_rotation_estimate(const pc_rotation_estimator *e, const pci_points *pose,
                           pci_put_rotation *put, void *results, size_t stride) {
    const workspace w = {results, stride};
    sum_areas(e, pose, &w);
    for (size_t v = 0; v < e->vertex_count; ++v) {
        double r[9];
        if (e->pinned[v] == 0 && turn_vertex(e, pose, v, &w, r)) {
            keep_rotation(&w, v, r);
        }
    }
    turn_bodies(e, pose, &w);
    for (size_t v = 0; v < e->vertex_count; ++v) {
        average(e, v, &w);
    }
    for (size_t v = 0; v < e->vertex_count; ++v) {
        float average_of[4];
        get_four(&w, v, OTHER, average_of);
        double q[4], square = 0.0;
        for (size_t k = 0; k < 4; ++k) {
            q[k] = (double)average_of[k];
            square += q[k] * q[k];
        }
        const double factor = (q[3] < 0.0 ? -1.0 : 1.0) / sqrt(square);
        for (size_t k = 0; k < 4; ++k) {
            q[k] *= factor;
        }
        put(w.start + v * stride, q);
    }
}

void pci_rotation_of_rings(const pc_rotation_estimator *e, const pci_points *pose,
                           pci_put_matrix *put, void *results, size_t stride) {
    const workspace w = {results, stride};
    sum_areas(e, pose, &w);
    for (size_t v = 0; v < e->vertex_count; ++v) {
        double r[9];
        (void)turn_vertex(e, pose, v, &w, r);
        put(w.start + v * stride, r);
    }
}

static void put_quaternion(void *result, const double quaternion[4]) {
    memcpy(result, quaternion, 4 * sizeof(double));
}

void pc_rotation_estimate(const pc_rotation_estimator *estimator, const double *positions,
                          double *rotations) {
    const pci_points pose = {positions, 3 * sizeof(double), false};
    pci_rotation_estimate(estimator, &pose, put_quaternion, rotations, 4 * sizeof(double));
}

typedef struct motion_job {
    const pc_rotation_estimator *estimator;
    const pc_motion *motion;
    double *rotations;
} motion_job;

static void turn_frames(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const motion_job *job = user;
    const size_t nv = job->motion->vertex_count;
    for (size_t f = begin; f < end; ++f) {
        pc_rotation_estimate(job->estimator, &job->motion->positions[3 * nv * f],
                             &job->rotations[4 * nv * f]);
    }
}

pc_status pc_rotation_estimate_motion(pc_context *context, const pc_mesh *proxy,
                                      const pc_motion *motion, double *rotations) {
    if (motion == NULL || rotations == NULL || proxy == NULL || motion->positions == NULL ||
        motion->vertex_count != proxy->vertex_count) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "%s: the motion is empty or not of this proxy mesh", stage);
    }
    pc_rotation_estimator *estimator = NULL;
    const pc_status status =
        pc_rotation_estimator_create(context, proxy, motion->pinned, &estimator);
    if (status != PC_OK) {
        return status;
    }
    motion_job job = {.estimator = estimator, .motion = motion, .rotations = rotations};
    pci_parallel_for(context, motion->frame_count, 1, turn_frames, &job);
    const size_t per_frame = 4 * motion->vertex_count;
    for (size_t i = per_frame; i < per_frame * motion->frame_count; i += 4) {
        double *q = &rotations[i], *before = &rotations[i - per_frame];
        if (q[0] * before[0] + q[1] * before[1] + q[2] * before[2] + q[3] * before[3] < 0.0) {
            q[0] = -q[0], q[1] = -q[1], q[2] = -q[2], q[3] = -q[3];
        }
    }
    pc_rotation_estimator_destroy(context, estimator);
    return PC_OK;
}

pc_status pci_rotations_of_motion(pci_scratch *scratch, const char *caller, const pc_mesh *mesh,
                                  const pc_motion *motion, bool wanted, double **rotations) {
    *rotations = NULL;
    if (!wanted) {
        return PC_OK;
    }
    *rotations = PCI_SCRATCH(scratch, double, 4 * motion->vertex_count * motion->frame_count);
    return *rotations == NULL
               ? pci_fail_memory(scratch->context, caller)
               : pc_rotation_estimate_motion(scratch->context, mesh, motion, *rotations);
}
