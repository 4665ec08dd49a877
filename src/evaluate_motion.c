#include "proxycloth/evaluate_motion.h"

#include <stdlib.h>

#include "core/core.h"
#include "geometry/crossing.h"
#include "geometry/rotation.h"
#include "geometry/topology.h"
#include "proxycloth/baselines.h"

static const char stage[] = "evaluate";

// Strains are counted by the leading bits of their floats: 11 bits of mantissa.
#define STRAIN_SHIFT PCI_EFFORT(12, 21)
#define STRAIN_BINS  ((size_t)1 << (31 - STRAIN_SHIFT))
#define PERCENTILE   0.95

static const pc_field option_fields[] = {
    PCI_FIELD_OPTION(pc_evaluate_motion_options, wind_seed, UINT, 1001, 0, 4294967295, "",
                     "Seed of a wind that the weights have not seen"),
    PCI_FIELD_OPTION(pc_evaluate_motion_options, crossing_frames, UINT, 10, 0, 100000, "frames",
                     "Frames in which new self-intersections are counted"),
};
const pc_record pc_evaluate_motion_options_record =
    PCI_RECORD(option_fields, pc_evaluate_motion_options);

#define NUMBER(member, unit, help) PCI_FIELD_REPORT(pc_motion_measures, member, DOUBLE, unit, help)
static const pc_field measure_fields[] = {
    NUMBER(rigid, "", "L_r, normalised"),
    NUMBER(collision, "", "L_c, normalised"),
    NUMBER(strain_mean, "", "Relative change of the edges' lengths, mean"),
    NUMBER(strain_p95, "", "Relative change of the edges' lengths, 95th percentile"),
    NUMBER(folded_triangles, "", "Share of triangles newly bent over a neighbour"),
    NUMBER(new_intersections, "pairs", "Triangles that cross and do not at rest, per frame"),
    NUMBER(proxy_intersections, "pairs", "The same of the proxy, whatever the weights are"),
    NUMBER(pinned_drift, "diagonal", "Mean distance of pinned parts from their place"),
    NUMBER(pinned_drift_worst, "diagonal", "Largest distance of pinned parts from their place"),
    NUMBER(motion_ratio, "", "Motion of the visual mesh over that of the proxy"),
};
const pc_record pc_motion_measures_record = PCI_RECORD(measure_fields, pc_motion_measures);

typedef struct frame_sums {
    double strain, drift, drift_worst, moved, moved_closest;
    uint64_t folded;
} frame_sums;

typedef struct evaluation {
    const pc_mesh *surface, *proxy;
    const pc_motion *motion;
    const pc_skin *skin;
    double *rotations;   // of the proxy, or NULL
    pc_skin closest;     // closest-triangle weights, which only translate
    const uint8_t *held; // #V, the closest point is pinned
    pci_topology topology;
    double *lengths;  // #E, at rest; 0: left out
    int8_t *bends;    // #E, sign that makes the dot product of the normals positive at rest, or 0
    double *posed;    // #workers by #V by 3
    double *moved;    // #workers by #V by 3, with closest-triangle weights
    double *normals;  // #workers by #F by 3
    uint8_t *folded;  // #workers by #F
    uint64_t *counts; // #workers by STRAIN_BINS
    frame_sums *sums; // #frames
} evaluation;

static double *frame_at(const evaluation *e, size_t frame) {
    return &e->motion->positions[3 * frame * e->motion->vertex_count];
}

static void pose(const evaluation *e, const pc_skin *skin, size_t frame, double *out) {
    const double *turned = skin->skinning == PC_SKINNING_ROTATION
                               ? pci_rotations_at(e->rotations, e->motion, frame)
                               : NULL;
    pc_skin_deform(skin, e->surface->positions, e->proxy->positions, frame_at(e, frame), turned,
                   out);
}

// ---- preparation --------------------------------------------------------------------------------

// Unit normals, 0 for triangles without area.
static void unit_normals(const pc_mesh *surface, const double *positions, double *normals) {
    for (size_t t = 0; t < surface->triangle_count; ++t) {
        const uint32_t *corner = &surface->triangles[3 * t];
        double ab[3], ac[3], *normal = &normals[3 * t];
        pci_sub(&positions[3 * (size_t)corner[1]], &positions[3 * (size_t)corner[0]], ab);
        pci_sub(&positions[3 * (size_t)corner[2]], &positions[3 * (size_t)corner[0]], ac);
        pci_cross(ab, ac, normal);
        if (pci_norm(normal) <= 1e-12 * fmax(pci_dot(ab, ab), pci_dot(ac, ac)) ||
            !pci_normalize(normal)) {
            normal[0] = normal[1] = normal[2] = 0.0;
        }
    }
}

// Whether a triangle runs along the edge from its first to its second vertex.
static bool runs_along(const pc_mesh *surface, uint32_t triangle, const uint32_t edge[2]) {
    const uint32_t *corner = &surface->triangles[3 * (size_t)triangle];
    for (size_t c = 0; c < 3; ++c) {
        if (corner[c] == edge[0] && corner[(c + 1) % 3] == edge[1]) {
            return true;
        }
    }
    return false;
}

static void prepare_edges(evaluation *e) {
    const pci_topology *topology = &e->topology;
    const double smallest = 1e-12 * pci_diagonal(e->surface);
    unit_normals(e->surface, e->surface->positions, e->normals);
    for (size_t i = 0; i < topology->edge_count; ++i) {
        const uint32_t *edge = &topology->edges[2 * i];
        const double length =
            sqrt(pci_squared_distance(&e->surface->positions[3 * (size_t)edge[0]],
                                      &e->surface->positions[3 * (size_t)edge[1]]));
        e->lengths[i] = length > smallest ? length : 0.0;
        if (pci_side_count(topology, i) != 2) {
            continue;
        }
        const uint32_t a = pci_sides(topology, i)[0], b = pci_sides(topology, i)[1];
        const double sign =
            runs_along(e->surface, a, edge) != runs_along(e->surface, b, edge) ? 1.0 : -1.0;
        const double cosine =
            sign * pci_dot(&e->normals[3 * (size_t)a], &e->normals[3 * (size_t)b]);
        e->bends[i] = cosine > 0.0 ? (int8_t)sign : 0;
    }
}

static pc_status prepare(pc_context *context, pci_scratch *scratch, evaluation *e) {
    const pc_mesh *surface = e->surface;
    const size_t nv = surface->vertex_count, nf = surface->triangle_count;
    const size_t workers = pc_context_threads(context);
    pc_status status = pc_skin_closest_triangle(context, surface, e->proxy, &e->closest);
    if (status != PC_OK) {
        return status;
    }
    uint8_t *held = PCI_SCRATCH(scratch, uint8_t, nv);
    status = pci_rotations_of_motion(scratch, stage, e->proxy, e->motion,
                                     e->skin->skinning == PC_SKINNING_ROTATION, &e->rotations);
    if (status != PC_OK) {
        return status;
    }
    e->posed = PCI_SCRATCH(scratch, double, 3 * nv * workers);
    e->moved = PCI_SCRATCH(scratch, double, 3 * nv * workers);
    e->normals = PCI_SCRATCH(scratch, double, 3 * nf * workers);
    e->folded = PCI_SCRATCH(scratch, uint8_t, nf * workers);
    e->counts = PCI_SCRATCH(scratch, uint64_t, STRAIN_BINS * workers);
    e->sums = PCI_SCRATCH(scratch, frame_sums, e->motion->frame_count);
    if (scratch->failed || !pci_topology_build(scratch, surface, &e->topology)) {
        return pci_fail_memory(context, stage);
    }
    e->lengths = PCI_SCRATCH(scratch, double, e->topology.edge_count);
    e->bends = PCI_SCRATCH(scratch, int8_t, e->topology.edge_count);
    if (scratch->failed) {
        return pci_fail_memory(context, stage);
    }
    for (size_t v = 0; v < nv; ++v) {
        held[v] = 1;
        for (size_t k = 3 * v; k < 3 * v + 3; ++k) {
            held[v] &= e->closest.weights[k] == 0.0 || e->motion->pinned[e->closest.bones[k]] != 0;
        }
    }
    e->held = held;
    prepare_edges(e);
    return PC_OK;
}

// ---- frames -------------------------------------------------------------------------------------

static void measure_strain(const evaluation *e, const double *posed, uint64_t *counts,
                           frame_sums *sums) {
    for (size_t i = 0; i < e->topology.edge_count; ++i) {
        if (e->lengths[i] > 0.0) {
            const uint32_t *edge = &e->topology.edges[2 * i];
            const double length = sqrt(
                pci_squared_distance(&posed[3 * (size_t)edge[0]], &posed[3 * (size_t)edge[1]]));
            const float strain = (float)fabs(length / e->lengths[i] - 1.0);
            uint32_t bits;
            memcpy(&bits, &strain, sizeof(bits));
            ++counts[bits >> STRAIN_SHIFT];
            sums->strain += (double)strain;
        }
    }
}

static void measure_folds(const evaluation *e, const double *posed, double *normals,
                          uint8_t *folded, frame_sums *sums) {
    const pci_topology *topology = &e->topology;
    unit_normals(e->surface, posed, normals);
    memset(folded, 0, e->surface->triangle_count);
    for (size_t i = 0; i < topology->edge_count; ++i) {
        const uint32_t *pair = pci_sides(topology, i);
        if (e->bends[i] != 0 && (double)e->bends[i] * pci_dot(&normals[3 * (size_t)pair[0]],
                                                              &normals[3 * (size_t)pair[1]]) <
                                    0.0) {
            folded[pair[0]] = folded[pair[1]] = 1;
        }
    }
    for (size_t t = 0; t < e->surface->triangle_count; ++t) {
        sums->folded += folded[t];
    }
}

static void measure_frames(void *user, size_t begin, size_t end, uint32_t worker) {
    const evaluation *e = user;
    const pc_mesh *surface = e->surface;
    const size_t nv = surface->vertex_count, nf = surface->triangle_count;
    double *posed = &e->posed[3 * nv * worker], *moved = &e->moved[3 * nv * worker];
    for (size_t frame = begin; frame < end; ++frame) {
        frame_sums sums = {0};
        pose(e, e->skin, frame, posed);
        pose(e, &e->closest, frame, moved);
        for (size_t v = 0; v < nv; ++v) {
            const double *rest = &surface->positions[3 * v];
            sums.moved += sqrt(pci_squared_distance(&posed[3 * v], rest));
            sums.moved_closest += sqrt(pci_squared_distance(&moved[3 * v], rest));
            if (e->held[v]) {
                const double drift = sqrt(pci_squared_distance(&posed[3 * v], &moved[3 * v]));
                sums.drift += drift;
                sums.drift_worst = fmax(sums.drift_worst, drift);
            }
        }
        measure_strain(e, posed, &e->counts[STRAIN_BINS * worker], &sums);
        measure_folds(e, posed, &e->normals[3 * nf * worker], &e->folded[nf * worker], &sums);
        e->sums[frame] = sums;
    }
}

// The middle of the bin up to which 95 % of the strains lie.
static double strain_percentile(const evaluation *e, size_t workers, uint64_t total) {
    uint64_t below = 0;
    for (size_t bin = 0; bin < STRAIN_BINS; ++bin) {
        for (size_t worker = 0; worker < workers; ++worker) {
            below += e->counts[worker * STRAIN_BINS + bin];
        }
        if ((double)below >= PERCENTILE * (double)total) {
            const uint32_t bits =
                (uint32_t)(bin << STRAIN_SHIFT) | (bin > 0 ? 1U << (STRAIN_SHIFT - 1) : 0U);
            float strain;
            memcpy(&strain, &bits, sizeof(strain));
            return (double)strain;
        }
    }
    return 0.0;
}

static void combine(const evaluation *e, size_t workers, pc_motion_measures *measures) {
    const double frames = (double)e->motion->frame_count, diagonal = pci_diagonal(e->surface);
    frame_sums total = {0};
    for (size_t frame = 0; frame < e->motion->frame_count; ++frame) {
        const frame_sums *sums = &e->sums[frame];
        total.strain += sums->strain;
        total.folded += sums->folded;
        total.moved += sums->moved;
        total.moved_closest += sums->moved_closest;
        total.drift += sums->drift;
        total.drift_worst = fmax(total.drift_worst, sums->drift_worst);
    }
    uint64_t edges = 0, held = 0;
    for (size_t i = 0; i < e->topology.edge_count; ++i) {
        edges += e->lengths[i] > 0.0;
    }
    for (size_t v = 0; v < e->surface->vertex_count; ++v) {
        held += e->held[v];
    }
    measures->strain_mean = edges > 0 ? total.strain / (frames * (double)edges) : 0.0;
    measures->strain_p95 = strain_percentile(e, workers, edges * e->motion->frame_count);
    measures->folded_triangles =
        (double)total.folded / (frames * (double)e->surface->triangle_count);
    measures->pinned_drift = held > 0 ? total.drift / (frames * (double)held * diagonal) : 0.0;
    measures->pinned_drift_worst = total.drift_worst / diagonal;
    measures->motion_ratio = total.moved_closest > 0.0 ? total.moved / total.moved_closest : 0.0;
}

// ---- self-intersections -------------------------------------------------------------------------

// Crossing pairs of a pose as sorted keys.
static bool list_crossings(pci_scratch *scratch, const pc_mesh *mesh, uint64_t **keys,
                           size_t *count) {
    uint32_t *pairs = NULL;
    if (!pci_list_self_intersections(scratch, mesh, &pairs, count)) {
        return false;
    }
    *keys = PCI_SCRATCH(scratch, uint64_t, *count);
    for (size_t i = 0; i < *count && *keys != NULL; ++i) {
        const uint32_t a = pairs[2 * i], b = pairs[2 * i + 1];
        (*keys)[i] = (uint64_t)(a < b ? a : b) << 32 | (a < b ? b : a);
    }
    if (*keys != NULL) {
        qsort(*keys, *count, sizeof(**keys), pci_compare_u64);
    }
    return *keys != NULL;
}

// Of the visual mesh, or `of_proxy`.
static pc_status count_new_crossings(pc_context *context, const evaluation *e, bool of_proxy,
                                     size_t shown, double *mean) {
    const pc_mesh *rest_pose = of_proxy ? e->proxy : e->surface;
    shown = shown < e->motion->frame_count ? shown : e->motion->frame_count;
    pci_scratch scratch = pci_scratch_begin(context);
    uint64_t *at_rest = NULL, found = 0;
    size_t rest_count = 0;
    pc_status status = PC_OK;
    if (shown > 0 && !list_crossings(&scratch, rest_pose, &at_rest, &rest_count)) {
        status = pci_fail_memory(context, stage);
    }
    for (size_t i = 0; i < shown && status == PC_OK; ++i) {
        const size_t frame = (i + 1) * e->motion->frame_count / shown - 1;
        pc_mesh posed = *rest_pose;
        posed.positions = of_proxy ? frame_at(e, frame) : e->posed;
        if (!of_proxy) {
            pose(e, e->skin, frame, e->posed);
        }
        pci_scratch round = pci_scratch_begin(context);
        uint64_t *keys = NULL;
        size_t count = 0, rest = 0;
        if (!pci_progress(context, stage, (double)i / (double)shown)) {
            status = pci_fail_cancelled(context, stage);
        } else if (!list_crossings(&round, &posed, &keys, &count)) {
            status = pci_fail_memory(context, stage);
        }
        for (size_t k = 0; k < count && status == PC_OK; ++k) {
            while (rest < rest_count && at_rest[rest] < keys[k]) {
                ++rest;
            }
            found += rest == rest_count || at_rest[rest] != keys[k];
        }
        pci_scratch_end(&round);
    }
    *mean = shown > 0 ? (double)found / (double)shown : 0.0;
    pci_scratch_end(&scratch);
    return status;
}

// ---- entry --------------------------------------------------------------------------------------

pc_status pc_evaluate_motion(pc_context *context, const pc_mesh *surface, const pc_mesh *proxy,
                             const pc_motion *motion, const pc_skin *skin,
                             const pc_evaluate_motion_options *options,
                             pc_motion_measures *measures) {
    if (measures == NULL || motion == NULL || motion->pinned == NULL) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "%s: the output is NULL or the motion has no pinned vertices", stage);
    }
    memset(measures, 0, sizeof(*measures));
    pc_evaluate_motion_options chosen;
    pc_status status =
        pci_begin_stage(context, stage, &pc_evaluate_motion_options_record, options, &chosen);
    pc_skin_losses losses;
    if (status == PC_OK) {
        status = pc_skin_evaluate(context, surface, proxy, motion, skin, NULL, &losses);
    }
    if (status != PC_OK) {
        return status;
    }
    pci_scratch scratch = pci_scratch_begin(context);
    evaluation e = {.surface = surface, .proxy = proxy, .motion = motion, .skin = skin};
    const double frames = (double)motion->frame_count;
    pc_motion_measures m = {0};
    m.rigid = losses.rigid_norm > 0.0 ? losses.rigid / (frames * losses.rigid_norm) : 0.0;
    m.collision =
        losses.collision_norm > 0.0 ? losses.collision / (frames * losses.collision_norm) : 0.0;
    status = prepare(context, &scratch, &e);
    if (status == PC_OK &&
        !pci_parallel_while_wanted(context, motion->frame_count, 1, measure_frames, &e)) {
        status = pci_fail_cancelled(context, stage);
    }
    if (status == PC_OK) {
        combine(&e, pc_context_threads(context), &m);
        status =
            count_new_crossings(context, &e, false, chosen.crossing_frames, &m.new_intersections);
    }
    if (status == PC_OK) {
        status =
            count_new_crossings(context, &e, true, chosen.crossing_frames, &m.proxy_intersections);
    }
    if (status == PC_OK) {
        *measures = m;
    }
    pc_skin_free(context, &e.closest);
    pci_scratch_end(&scratch);
    return status;
}
