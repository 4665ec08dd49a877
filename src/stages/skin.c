#include "proxycloth/skin.h"

#include "core/bvh.h"
#include "core/knn.h"
#include "core/topology.h"
#include "stages/skin_internal.h"

static const char stage[] = "skin";

static const pc_field option_fields[] = {
    PCI_FIELD_OPTION(pc_skin_options, influences, UINT, 4, 1, 32, "",
                     "K: influences per visual vertex"),
    PCI_FIELD_OPTION(
        pc_skin_options, candidates, UINT, 8, 1, 32, "",
        "k_B: proxy vertices considered per visual vertex, corners of the closest triangle "
        "first, then the nearest; at least K"),
    PCI_FIELD_OPTION(pc_skin_options, neighbours, UINT, 8, 1, 32, "",
                     "k_K: spatial neighbours of L_c and L_a"),
    PCI_FIELD_OPTION(pc_skin_options, lambda_rigid, DOUBLE, 1.0, 0.0, 1000000.0, "",
                     "Weight of L_r"),
    PCI_FIELD_OPTION(pc_skin_options, lambda_collision, DOUBLE, 1.0, 0.0, 1000000.0, "",
                     "Weight of L_c"),
    PCI_FIELD_OPTION(pc_skin_options, lambda_attachment, DOUBLE, 0.1, 0.0, 1000000.0, "",
                     "Weight of L_a"),
    PCI_FIELD_OPTION(pc_skin_options, epochs, UINT, 100, 0, 100000, "epochs",
                     "Passes over all frames"),
    PCI_FIELD_OPTION(pc_skin_options, batch, UINT, 16, 1, 100000, "frames",
                     "Frames per step; below 16 each step still takes the time and memory of 16"),
    PCI_FIELD_OPTION(pc_skin_options, learning_rate, DOUBLE, 0.005, 1e-08, 10.0, "",
                     "Step of AdamW, falls to 0 in the last 40 % of the epochs"),
    PCI_FIELD_OPTION(pc_skin_options, weight_decay, DOUBLE, 0.01, 0.0, 1.0, "",
                     "Decoupled weight decay of AdamW"),
    PCI_FIELD_OPTION(pc_skin_options, seed, UINT, 1, 0, 4294967295, "",
                     "Seed of the random numbers"),
};
const pc_record pc_skin_options_record = PCI_RECORD(option_fields, pc_skin_options);

static const pc_field report_fields[] = {
    PCI_FIELD_REPORT(pc_skin_report, loss_before, DOUBLE, "",
                     "Weighted sum of the losses of the first guess"),
    PCI_FIELD_REPORT(pc_skin_report, loss_after, DOUBLE, "",
                     "Weighted sum of the losses of the result"),
    PCI_FIELD_REPORT(pc_skin_report, rigid_before, DOUBLE, "", "L_r of the first guess"),
    PCI_FIELD_REPORT(pc_skin_report, rigid_after, DOUBLE, "", "L_r of the result"),
    PCI_FIELD_REPORT(pc_skin_report, collision_before, DOUBLE, "", "L_c of the first guess"),
    PCI_FIELD_REPORT(pc_skin_report, collision_after, DOUBLE, "", "L_c of the result"),
    PCI_FIELD_REPORT(pc_skin_report, attachment_before, DOUBLE, "", "L_a of the first guess"),
    PCI_FIELD_REPORT(pc_skin_report, attachment_after, DOUBLE, "", "L_a of the result"),
    PCI_FIELD_REPORT(pc_skin_report, full_loss, DOUBLE, "",
                     "Weighted sum of the losses with all candidates, before the cut to K"),
    PCI_FIELD_REPORT(
        pc_skin_report, spatial_share, DOUBLE, "",
        "Share of lambda_c and lambda_a in the last epochs, below 1 where L_c would cost L_r"),
    PCI_FIELD_REPORT(pc_skin_report, reflections, COUNT, "",
                     "Vertices and frames whose 1-ring is turned inside out"),
    PCI_FIELD_REPORT(pc_skin_report, bones_used, COUNT, "", "Proxy vertices with any weight"),
};
const pc_record pc_skin_report_record = PCI_RECORD(report_fields, pc_skin_report);

// ---- input --------------------------------------------------------------------------------------

static pc_status check_motion(pc_context *context, const pc_mesh *proxy, const pc_motion *motion) {
    if (motion == NULL || motion->frame_count == 0 || motion->positions == NULL ||
        motion->vertex_count != proxy->vertex_count) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "skin: the motion is empty or not of this proxy mesh");
    }
    const size_t per_frame = 3 * motion->vertex_count;
    for (size_t k = 0; k < per_frame * motion->frame_count; ++k) {
        if (!isfinite(motion->positions[k])) {
            return pci_fail(context, PC_ERROR_NUMERICAL, stage,
                            "skin: proxy vertex %zu is not finite in frame %zu", k % per_frame / 3,
                            k / per_frame);
        }
    }
    return PC_OK;
}

static pc_status check_input(pc_context *context, const pc_mesh *surface, const pc_mesh *proxy,
                             const pc_motion *motion, const pc_skin_options *options,
                             pc_skin_options *chosen) {
    pc_status status = pci_check_mesh(context, stage, surface, "visual mesh");
    if (status == PC_OK) {
        status = pci_check_mesh(context, stage, proxy, "proxy mesh");
    }
    if (status == PC_OK) {
        status = check_motion(context, proxy, motion);
    }
    if (status == PC_OK) {
        status = pci_begin_stage(context, stage, &pc_skin_options_record, options, chosen);
    }
    return status;
}

static void set_driver(pci_skin_problem *problem, const pc_mesh *proxy, const pc_motion *motion) {
    problem->proxy_count = proxy->vertex_count;
    problem->proxy_rest = proxy->positions;
    problem->frame_count = motion->frame_count;
    problem->frames = motion->positions;
}

// ---- candidates ---------------------------------------------------------------------------------

typedef struct closest_job {
    const pci_bvh *bvh;
    const pc_mesh *surface;
    pci_closest *closest; // #V
} closest_job;

static void find_closest(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const closest_job *job = user;
    for (size_t v = begin; v < end; ++v) {
        job->closest[v] = pci_bvh_closest(job->bvh, &job->surface->positions[3 * v], INFINITY);
    }
}

// The closest point of the proxy for every visual vertex.
static pc_status find_closest_points(pc_context *context, const pc_mesh *surface,
                                     const pc_mesh *proxy, pci_closest *closest) {
    pci_bvh *bvh = NULL;
    const pc_status status = pci_bvh_create(context, stage, proxy, &bvh);
    if (status != PC_OK) {
        return status;
    }
    closest_job job = {.bvh = bvh, .surface = surface, .closest = closest};
    pci_parallel_for(context, surface->vertex_count, 256, find_closest, &job);
    pci_bvh_destroy(context, bvh);
    return PC_OK;
}

typedef struct candidate_job {
    const pci_knn *knn;
    const pc_mesh *surface, *proxy;
    const pci_closest *closest;
    uint32_t slots;
    uint32_t *bones;   // #V by slots
    double *surrogate; // #V by slots
} candidate_job;

enum { CANDIDATES_MAX = 32, PHASES = 3 };
static const double distance_share = 0.1; // of the first guess
static const double rigid_share = 0.7;    // more of its L_r left: L_c gets less weight

// Candidates of one vertex: the corners of the closest triangle, then the nearest proxy vertices.
// First guess: mostly the barycentric coordinates, the rest by inverse distance; nothing is 0,
// where the gradient of |s| vanishes.
static void fill_candidates(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const candidate_job *job = user;
    for (size_t v = begin; v < end; ++v) {
        const double *position = &job->surface->positions[3 * v];
        const pci_closest *closest = &job->closest[v];
        uint32_t *bones = &job->bones[v * job->slots];
        double *s = &job->surrogate[v * job->slots];
        uint32_t count = 0, near[CANDIDATES_MAX];
        double squared[CANDIDATES_MAX], barycentric[CANDIDATES_MAX] = {0}, sum = 0.0, mean = 0.0;
        for (size_t c = 0; c < 3 && count < job->slots; ++c) {
            const uint32_t corner = job->proxy->triangles[3 * (size_t)closest->triangle + c];
            bool known = false;
            for (uint32_t k = 0; k < count; ++k) {
                known = known || bones[k] == corner;
            }
            if (!known) {
                barycentric[count] = closest->barycentric[c];
                bones[count++] = corner;
            }
        }
        const size_t found =
            pci_knn_query(job->knn, position, job->slots, PC_INVALID_INDEX, near, squared);
        for (size_t i = 0; i < found && count < job->slots; ++i) {
            bool known = false;
            for (uint32_t k = 0; k < count; ++k) {
                known = known || bones[k] == near[i];
            }
            if (!known) {
                bones[count++] = near[i];
            }
        }
        for (uint32_t k = 0; k < count; ++k) {
            s[k] =
                sqrt(pci_squared_distance(position, &job->proxy->positions[3 * (size_t)bones[k]]));
            mean += s[k] / (double)count;
        }
        for (uint32_t k = 0; k < count; ++k) {
            s[k] = mean > 0.0 ? 1.0 / (s[k] + 0.01 * mean) : 1.0;
            sum += s[k];
        }
        for (uint32_t k = 0; k < count; ++k) {
            s[k] = distance_share * s[k] / sum + (1.0 - distance_share) * barycentric[k];
        }
    }
}

// ---- the result ---------------------------------------------------------------------------------

// Sorts one row by falling weight, ties to the smaller bone.
static void sort_row(uint32_t *bones, double *weights, uint32_t count) {
    for (uint32_t i = 1; i < count; ++i) {
        const uint32_t bone = bones[i];
        const double weight = weights[i];
        uint32_t at = i;
        for (; at > 0 &&
               (weights[at - 1] < weight || (weights[at - 1] == weight && bones[at - 1] > bone));
             --at) {
            bones[at] = bones[at - 1];
            weights[at] = weights[at - 1];
        }
        bones[at] = bone;
        weights[at] = weight;
    }
}

// Makes rows of `count` sorted influences sum to 1; slots without weight repeat the first bone.
static bool finish_rows(pc_skin *skin) {
    for (size_t v = 0; v < skin->vertex_count; ++v) {
        uint32_t *bones = &skin->bones[v * skin->influences];
        double *weights = &skin->weights[v * skin->influences], sum = 0.0;
        for (uint32_t k = 0; k < skin->influences; ++k) {
            sum += weights[k];
        }
        if (!(sum > 0.0) || !isfinite(sum)) {
            return false;
        }
        for (uint32_t k = 0; k < skin->influences; ++k) {
            weights[k] /= sum;
            bones[k] = weights[k] > 0.0 ? bones[k] : bones[0];
        }
    }
    return true;
}

static bool allocate_skin(pc_context *context, size_t vertex_count, uint32_t influences,
                          pc_skin *skin) {
    skin->vertex_count = vertex_count;
    skin->influences = influences;
    skin->bones = PCI_ALLOCATE(context, uint32_t, vertex_count * influences);
    skin->weights = PCI_ALLOCATE(context, double, vertex_count *influences);
    return skin->bones != NULL && skin->weights != NULL;
}

// The `kept` largest weights of each row become the next problem.
static void cut_rows(size_t vertex_count, uint32_t slots, uint32_t *bones, double *surrogate,
                     uint32_t kept, uint32_t *kept_bones, double *kept_surrogate) {
    for (size_t v = 0; v < vertex_count; ++v) {
        double weights[CANDIDATES_MAX];
        pci_skin_normalize(&surrogate[v * slots], slots, weights);
        sort_row(&bones[v * slots], weights, slots);
        memcpy(&kept_bones[v * kept], &bones[v * slots], kept * sizeof(*bones));
        pci_skin_normalize(weights, kept, &kept_surrogate[v * kept]);
    }
}

// ---- optimisation -------------------------------------------------------------------------------

typedef struct fit {
    pc_context *context;
    const pc_skin_options *options;
    pci_skin_problem problem;
    uint32_t *bones;
    double *surrogate;
    double spatial_share; // of lambda_c and lambda_a that is used
} fit;

// Losses per norm and frame, in double.
static pc_status measure(pci_scratch *scratch, const fit *f, double losses[3], double *total,
                         uint64_t *reflections) {
    const pci_skin_problem *p = &f->problem;
    const double lambda[3] = {f->options->lambda_rigid, f->options->lambda_collision,
                              f->options->lambda_attachment};
    double *weights = PCI_SCRATCH(scratch, double, p->vertex_count * p->slots);
    if (weights == NULL) {
        return pci_fail_memory(f->context, stage);
    }
    for (size_t v = 0; v < p->vertex_count; ++v) {
        pci_skin_normalize(&f->surrogate[v * p->slots], p->slots, &weights[v * p->slots]);
    }
    pci_skin_measures measures;
    const pc_status status =
        pci_skin_measure(f->context, p, pci_skin_kernel_double(), weights, &measures, NULL);
    *total = 0.0;
    for (size_t x = 0; x < 3; ++x) {
        const double norm = p->norms[x] * (double)p->frame_count;
        losses[x] = norm > 0.0 ? measures.losses[x] / norm : 0.0;
        *total += lambda[x] * losses[x];
    }
    *reflections = measures.reflections;
    return status;
}

// The share of the epochs from `begin` to `end`; the last ones with a falling learning rate.
static pc_status descend(const fit *f, double begin, double end) {
    const pc_skin_options *o = f->options;
    const double epochs = (double)o->epochs;
    const pci_skin_descent settings = {
        .lambda = {o->lambda_rigid, f->spatial_share * o->lambda_collision,
                   f->spatial_share * o->lambda_attachment},
        .epochs = (uint32_t)round(end * epochs) - (uint32_t)round(begin * epochs),
        .batch = o->batch,
        .learning_rate = o->learning_rate,
        .weight_decay = o->weight_decay,
        // The loss is a mean over the vertices; so is the scale of its gradient.
        .epsilon = 1e-8 / (double)f->problem.vertex_count,
        .decay = end == 1.0,
        .seed = o->seed,
        .progress_begin = begin,
        .progress_end = end,
    };
    return pci_skin_descend(f->context, &f->problem, pci_skin_kernel_float(), &settings,
                            f->surrogate);
}

static pc_status prepare(pci_scratch *scratch, const pc_mesh *surface, const pc_mesh *proxy,
                         const pc_motion *motion, fit *f) {
    const pc_skin_options *o = f->options;
    const uint32_t wanted = o->candidates > o->influences ? o->candidates : o->influences;
    const uint32_t slots = wanted < proxy->vertex_count ? wanted : (uint32_t)proxy->vertex_count;
    const size_t nv = surface->vertex_count;
    pci_knn knn;
    if (!pci_skin_problem_build(scratch, surface, o->neighbours, &f->problem) ||
        !pci_knn_build(scratch, proxy->vertex_count, proxy->positions, &knn)) {
        return pci_fail_memory(f->context, stage);
    }
    f->bones = PCI_SCRATCH(scratch, uint32_t, nv * slots);
    f->surrogate = PCI_SCRATCH(scratch, double, nv *slots);
    pci_closest *closest = PCI_SCRATCH(scratch, pci_closest, nv);
    if (scratch->failed) {
        return pci_fail_memory(f->context, stage);
    }
    const pc_status status = find_closest_points(f->context, surface, proxy, closest);
    if (status != PC_OK) {
        return status;
    }
    candidate_job job = {.knn = &knn,
                         .surface = surface,
                         .proxy = proxy,
                         .closest = closest,
                         .slots = slots,
                         .bones = f->bones,
                         .surrogate = f->surrogate};
    pci_parallel_for(f->context, nv, 256, fill_candidates, &job);
    set_driver(&f->problem, proxy, motion);
    f->problem.slots = slots;
    f->problem.bones = f->bones;
    return PC_OK;
}

// Cuts to the K heaviest influences and writes them into the result.
static pc_status cut(pci_scratch *scratch, fit *f, uint32_t kept) {
    const size_t nv = f->problem.vertex_count;
    uint32_t *bones = PCI_SCRATCH(scratch, uint32_t, nv * kept);
    double *surrogate = PCI_SCRATCH(scratch, double, nv *kept);
    if (scratch->failed) {
        return pci_fail_memory(f->context, stage);
    }
    cut_rows(nv, f->problem.slots, f->bones, f->surrogate, kept, bones, surrogate);
    f->bones = bones;
    f->surrogate = surrogate;
    f->problem.slots = kept;
    f->problem.bones = bones;
    return PC_OK;
}

// All candidates, half way, K: cutting alone would lose most of the gain.
static pc_status run_phases(pci_scratch *scratch, fit *f, pc_skin_report *report) {
    const uint32_t slots = f->problem.slots, influences = f->options->influences;
    const uint32_t kept = influences < slots ? influences : slots;
    const uint32_t widths[PHASES] = {slots, (slots + kept + 1) / 2, kept};
    static const double ends[PHASES] = {0.4, 0.6, 1.0};
    // Layers that the proxy moves through each other cannot be held together by weights; they must
    // not cost the shape of each layer. So L_c weighs no more than L_r at first, ...
    const bool balanced = f->options->lambda_rigid > 0.0 && report->rigid_before > 0.0;
    if (balanced && report->collision_before > report->rigid_before) {
        f->spatial_share = report->rigid_before / report->collision_before;
    }
    pc_status status = PC_OK;
    for (size_t phase = 0; phase < PHASES && status == PC_OK; ++phase) {
        if (widths[phase] < f->problem.slots) {
            status = cut(scratch, f, widths[phase]);
        }
        if (status == PC_OK) {
            status = descend(f, phase == 0 ? 0.0 : ends[phase - 1], ends[phase]);
        }
        if (status == PC_OK && phase + 1 < PHASES) {
            double losses[3] = {0.0}, total = 0.0;
            uint64_t reflections = 0;
            status = measure(scratch, f, losses, &total, &reflections);
            report->full_loss = phase == 0 ? total : report->full_loss;
            // ... and less where L_r does not fall.
            if (balanced && losses[0] > rigid_share * report->rigid_before) {
                f->spatial_share *= 0.25;
            }
        }
    }
    report->spatial_share = f->spatial_share;
    return status;
}

static pc_status write_result(pci_scratch *scratch, const fit *f, pc_skin *skin,
                              pc_skin_report *report) {
    const uint32_t kept = f->problem.slots, influences = f->options->influences;
    uint8_t *used = PCI_SCRATCH(scratch, uint8_t, f->problem.proxy_count);
    if (used == NULL || !allocate_skin(f->context, f->problem.vertex_count, influences, skin)) {
        return pci_fail_memory(f->context, stage);
    }
    for (size_t v = 0; v < skin->vertex_count; ++v) {
        uint32_t *bones = &skin->bones[v * influences];
        double *weights = &skin->weights[v * influences];
        memcpy(bones, &f->bones[v * kept], kept * sizeof(*bones));
        pci_skin_normalize(&f->surrogate[v * kept], kept, weights);
        sort_row(bones, weights, kept);
    }
    if (!finish_rows(skin)) {
        return pci_fail(f->context, PC_ERROR_NUMERICAL, stage,
                        "skin: the weights left the finite numbers");
    }
    for (size_t i = 0; i < skin->vertex_count * influences; ++i) {
        if (skin->weights[i] > 0.0 && !used[skin->bones[i]]) {
            used[skin->bones[i]] = 1;
            ++report->bones_used;
        }
    }
    return PC_OK;
}

pc_status pc_skin_optimize(pc_context *context, const pc_mesh *surface, const pc_mesh *proxy,
                           const pc_motion *motion, const pc_skin_options *options, pc_skin *skin,
                           pc_skin_report *report) {
    pc_skin_options chosen;
    pc_status status = check_input(context, surface, proxy, motion, options, &chosen);
    if (status != PC_OK) {
        return status;
    }
    if (skin == NULL || skin->bones != NULL || skin->weights != NULL) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage, "skin: the output is not empty");
    }
    pci_scratch scratch = pci_scratch_begin(context);
    pc_skin_report r = {0};
    fit f = {.context = context, .options = &chosen, .spatial_share = 1.0};
    double losses[3] = {0.0};
    uint64_t reflections = 0;
    status = prepare(&scratch, surface, proxy, motion, &f);
    if (status == PC_OK) {
        status = measure(&scratch, &f, losses, &r.loss_before, &reflections);
        r.rigid_before = losses[0], r.collision_before = losses[1], r.attachment_before = losses[2];
    }
    if (status == PC_OK) {
        status = run_phases(&scratch, &f, &r);
    }
    if (status == PC_OK) {
        status = measure(&scratch, &f, losses, &r.loss_after, &r.reflections);
        r.rigid_after = losses[0], r.collision_after = losses[1], r.attachment_after = losses[2];
    }
    if (status == PC_OK) {
        status = write_result(&scratch, &f, skin, &r);
    }
    pci_scratch_end(&scratch);
    if (status != PC_OK) {
        pc_skin_free(context, skin);
    } else if (report != NULL) {
        *report = r;
    }
    return status;
}

// ---- baseline, evaluation, deformation ---------------------------------------------------------

pc_status pc_skin_closest_triangle(pc_context *context, const pc_mesh *surface,
                                   const pc_mesh *proxy, pc_skin *skin) {
    pc_status status = pci_check_mesh(context, stage, surface, "visual mesh");
    if (status == PC_OK) {
        status = pci_check_mesh(context, stage, proxy, "proxy mesh");
    }
    if (status != PC_OK) {
        return status;
    }
    if (skin == NULL || skin->bones != NULL || skin->weights != NULL) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage, "skin: the output is not empty");
    }
    const size_t nv = surface->vertex_count;
    pci_scratch scratch = pci_scratch_begin(context);
    pci_closest *closest = PCI_SCRATCH(&scratch, pci_closest, nv);
    status = closest != NULL && allocate_skin(context, nv, 3, skin)
                 ? find_closest_points(context, surface, proxy, closest)
                 : pci_fail_memory(context, stage);
    for (size_t v = 0; status == PC_OK && v < nv; ++v) {
        for (size_t c = 0; c < 3; ++c) {
            skin->bones[3 * v + c] = proxy->triangles[3 * (size_t)closest[v].triangle + c];
            skin->weights[3 * v + c] =
                closest[v].barycentric[c] > 0.0 ? closest[v].barycentric[c] : 0.0;
        }
        sort_row(&skin->bones[3 * v], &skin->weights[3 * v], 3);
    }
    if (status == PC_OK && !finish_rows(skin)) {
        status = pci_fail(context, PC_ERROR_NUMERICAL, stage,
                          "skin: the closest points left the finite numbers");
    }
    pci_scratch_end(&scratch);
    if (status != PC_OK) {
        pc_skin_free(context, skin);
    }
    return status;
}

pc_status pc_skin_evaluate(pc_context *context, const pc_mesh *surface, const pc_mesh *proxy,
                           const pc_motion *motion, const pc_skin *skin,
                           const pc_skin_options *options, pc_skin_losses *losses) {
    pc_skin_options chosen;
    pc_status status = check_input(context, surface, proxy, motion, options, &chosen);
    if (status != PC_OK) {
        return status;
    }
    bool fits = losses != NULL && skin != NULL && skin->vertex_count == surface->vertex_count &&
                skin->influences > 0 && skin->bones != NULL && skin->weights != NULL;
    for (size_t i = 0; fits && i < skin->vertex_count * skin->influences; ++i) {
        fits = skin->bones[i] < proxy->vertex_count && isfinite(skin->weights[i]);
    }
    if (!fits) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "skin: the weights are not of this visual mesh and proxy mesh");
    }
    pci_scratch scratch = pci_scratch_begin(context);
    pci_skin_problem problem;
    pci_skin_measures measures = {0};
    if (pci_skin_problem_build(&scratch, surface, chosen.neighbours, &problem)) {
        set_driver(&problem, proxy, motion);
        problem.slots = skin->influences;
        problem.bones = skin->bones;
        status = pci_skin_measure(context, &problem, pci_skin_kernel_double(), skin->weights,
                                  &measures, NULL);
    } else {
        status = pci_fail_memory(context, stage);
    }
    if (status == PC_OK) {
        const pc_skin_losses result = {.rigid = measures.losses[0],
                                       .collision = measures.losses[1],
                                       .attachment = measures.losses[2],
                                       .rigid_norm = problem.norms[0],
                                       .collision_norm = problem.norms[1],
                                       .attachment_norm = problem.norms[2]};
        *losses = result;
    }
    pci_scratch_end(&scratch);
    return status;
}

void pc_skin_deform(const pc_skin *skin, const double *rest, const double *proxy_rest,
                    const double *proxy_frame, double *output) {
    for (size_t v = 0; v < skin->vertex_count; ++v) {
        double position[3] = {rest[3 * v], rest[3 * v + 1], rest[3 * v + 2]};
        for (size_t k = v * skin->influences; k < (v + 1) * skin->influences; ++k) {
            const size_t bone = 3 * (size_t)skin->bones[k];
            for (size_t c = 0; c < 3; ++c) {
                position[c] += skin->weights[k] * (proxy_frame[bone + c] - proxy_rest[bone + c]);
            }
        }
        memcpy(&output[3 * v], position, sizeof(position));
    }
}
