#include "proxycloth/skin.h"

#include "geometry/rotation.h"
#include "geometry/topology.h"
#include "stages/skin/skin_fit.h"
#include "stages/skin/skin_join.h"
#include "stages/skin/weight_rows.h"

static const char stage[] = "skin";

static const char *const skinning_choices[] = {"translation", "rotation", NULL};
static const char *const solver_choices[] = {"alternate", "adamw", NULL};

static const char *const channel_choices[] = {"none", "red", "green", "blue", "alpha", NULL};
static const char *const storage_choices[] = {"float", "u16", "u8", NULL};

static const pc_field option_fields[] = {
    PCI_FIELD_CHOICE(pc_skin_options, skinning, PC_SKINNING_TRANSLATION, 1, skinning_choices,
                     "What of the proxy's vertices moves the garment: their displacements, or also "
                     "their rotations"),
    PCI_FIELD_CHOICE(pc_skin_options, solver, PC_SKIN_ALTERNATE, 1, solver_choices,
                     "Optimiser of the weights"),
    PCI_FIELD_OPTION(pc_skin_options, influences, UINT, 4, 1, 32, "",
                     "K: influences per visual vertex"),
    PCI_FIELD_OPTION_OR(
        pc_skin_options, candidates, UINT, 0, 1, 32, "", "auto",
        "k_B: proxy vertices considered per visual vertex, corners of the closest triangle "
        "first, then heat-smoothed weights (alternate), then the nearest; at least K, auto: 2 K "
        "but at most 32"),
    PCI_FIELD_OPTION(pc_skin_options, neighbours, UINT, 8, 1, 32, "",
                     "k_K: spatial neighbours of L_c and L_a"),
    PCI_FIELD_OPTION(pc_skin_options, lambda_rigid, DOUBLE, 3.0, 0.0, 1000000.0, "",
                     "Weight of L_r"),
    PCI_FIELD_OPTION(pc_skin_options, lambda_collision, DOUBLE, 1.0, 0.0, 1000000.0, "",
                     "Weight of L_c"),
    PCI_FIELD_OPTION(pc_skin_options, lambda_attachment, DOUBLE, 0.1, 0.0, 1000000.0, "",
                     "Weight of L_a"),
    PCI_FIELD_OPTION(pc_skin_options, lambda_follow, DOUBLE, 0.5, 0.0, 1000000.0, "",
                     "Weight of L_f, following the proxy: more keeps the motion "
                     "of the proxy, less gives smoother shape; alternate only"),
    PCI_FIELD_OPTION(pc_skin_options, lambda_stretch, DOUBLE, 3.0, 0.0, 1000000.0, "",
                     "Weight of L_s, edges that keep their length; alternate only"),
    PCI_FIELD_OPTION(pc_skin_options, lambda_layers, DOUBLE, 3.0, 0.0, 1000000.0, "",
                     "Weight of L_l, loose parts that lie upon each other keep their distance; "
                     "alternate only"),
    PCI_FIELD_OPTION(pc_skin_options, least_motion, DOUBLE, 0.973, 0.0, 1.0, "",
                     "lambda_follow is raised, up to 16 times, until the garment moves this "
                     "share of the proxy's motion; alternate only"),
    PCI_FIELD_OPTION(pc_skin_options, most_strain, DOUBLE, 0.8, 0.0, 1000000.0, "",
                     "lambda_stretch is raised, up to 16 times, until edges change their "
                     "lengths by no more than this share of what closest-triangle weights do to "
                     "them; alternate only"),
    PCI_FIELD_OPTION(pc_skin_options, motion_noise, DOUBLE, 0.012, 0.0, 1.0, "",
                     "Variance of a noise in the motion of the proxy's vertices, over the mean "
                     "square of how far neighbours move apart, against weights that suit these "
                     "frames only; alternate only"),
    PCI_FIELD_OPTION(pc_skin_options, equal_edges, BOOL, 1, 0, 1, "",
                     "Edges count alike in L_r, L_c and L_s, not by their squared length as in the "
                     "paper; alternate only"),
    PCI_FIELD_OPTION(pc_skin_options, rounds, UINT, 24, 0, 100000, "rounds",
                     "Passes over frames at most, most of them over a sample; alternate only"),
    PCI_FIELD_OPTION(
        pc_skin_options, round_gain, DOUBLE, 0.002, 0.0, 1.0, "",
        "Stops when a round gains less than this share of the losses, at first a tenth of "
        "it of the gain so far; alternate only"),
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
    PCI_FIELD_OPTION(pc_skin_options, max_bones, UINT, 0, 0, 65536, "bones",
                     "Bones that the engine allows, one per proxy vertex and the reserve; an error "
                     "when they do not suffice. 0: no limit"),
    PCI_FIELD_OPTION(pc_skin_options, reserve_bones, UINT, 0, 0, 65536, "bones",
                     "Of max_bones, those that the skeleton of the character needs"),
    PCI_FIELD_CHOICE(pc_skin_options, weight_storage, PC_SKIN_WEIGHTS_FLOAT, 2, storage_choices,
                     "Weights in exported files; integers sum to exactly 1"),
    PCI_FIELD_OPTION(pc_skin_options, body_blend, DOUBLE, 0.0, 0.0, 2.0, "diagonals",
                     "Exported garments pass from the body's skeleton to the proxy within this "
                     "distance from the pins; 0: they follow the proxy alone"),
    PCI_FIELD_CHOICE(pc_skin_options, body_channel, PC_BODY_CHANNEL_NONE, 4, channel_choices,
                     "Channel of the vertex colors that tells how far a vertex follows the proxy "
                     "instead of the body's skeleton, in place of body_blend"),
};
const pc_record pc_skin_options_record = PCI_RECORD(option_fields, pc_skin_options);

static const pc_field report_fields[] = {
    PCI_FIELD_REPORT(
        pc_skin_report, loss_before, DOUBLE, "",
        "Weighted sum of the losses of the first guess; alternate: from a sample of the "
        "frames"),
    PCI_FIELD_REPORT(pc_skin_report, loss_after, DOUBLE, "",
                     "Weighted sum of the losses of the result"),
    PCI_FIELD_REPORT(pc_skin_report, rigid_before, DOUBLE, "", "L_r of the first guess"),
    PCI_FIELD_REPORT(pc_skin_report, rigid_after, DOUBLE, "", "L_r of the result"),
    PCI_FIELD_REPORT(pc_skin_report, collision_before, DOUBLE, "", "L_c of the first guess"),
    PCI_FIELD_REPORT(pc_skin_report, collision_after, DOUBLE, "", "L_c of the result"),
    PCI_FIELD_REPORT(pc_skin_report, attachment_before, DOUBLE, "", "L_a of the first guess"),
    PCI_FIELD_REPORT(pc_skin_report, attachment_after, DOUBLE, "", "L_a of the result"),
    PCI_FIELD_REPORT(
        pc_skin_report, full_loss, DOUBLE, "",
        "Weighted sum of the losses with all candidates, before the cut to K; alternate: "
        "from a sample of the frames"),
    PCI_FIELD_REPORT(
        pc_skin_report, spatial_share, DOUBLE, "",
        "Share of lambda_c and lambda_a in the last epochs, below 1 where L_c would cost L_r"),
    PCI_FIELD_REPORT(pc_skin_report, rounds, COUNT, "", "Passes over frames, alternate"),
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

static pc_status check_bones(pc_context *context, const pc_mesh *proxy,
                             const pc_skin_options *options) {
    const size_t most = options->max_bones, reserve = options->reserve_bones;
    if (most == 0 || proxy->vertex_count + reserve <= most) {
        return PC_OK;
    }
    if (reserve >= most) {
        return pci_fail(context, PC_ERROR_TOO_LARGE, stage,
                        "skin: reserve_bones = %zu leaves none of max_bones = %zu for the proxy",
                        reserve, most);
    }
    return pci_fail(context, PC_ERROR_TOO_LARGE, stage,
                    "skin: the proxy has %zu vertices, one bone each, but max_bones = %zu with "
                    "reserve_bones = %zu leaves %zu; ask for at most %zu proxy vertices",
                    proxy->vertex_count, most, reserve, most - reserve, most - reserve);
}

static pc_status set_driver(pci_scratch *scratch, pci_skin_problem *problem, const pc_mesh *proxy,
                            const pc_motion *motion, uint32_t skinning) {
    problem->proxy_count = proxy->vertex_count;
    problem->proxy_rest = proxy->positions;
    problem->frame_count = motion->frame_count;
    problem->frames = motion->positions;
    double *rotations;
    const pc_status status = pci_rotations_of_motion(scratch, stage, proxy, motion,
                                                     skinning == PC_SKINNING_ROTATION, &rotations);
    problem->rotations = rotations;
    return status;
}

// ---- the result ---------------------------------------------------------------------------------

static pc_status prepare(pci_scratch *scratch, const pc_mesh *surface, const pc_mesh *proxy,
                         const pc_motion *motion, pci_skin_fit *f) {
    const pc_skin_options *o = f->options;
    const uint32_t twice =
        2 * o->influences < PCI_SKIN_CANDIDATES_MAX ? 2 * o->influences : PCI_SKIN_CANDIDATES_MAX;
    const uint32_t asked = o->candidates != 0 ? o->candidates : twice;
    const uint32_t wanted = asked > o->influences ? asked : o->influences;
    const uint32_t slots = wanted < proxy->vertex_count ? wanted : (uint32_t)proxy->vertex_count;
    const size_t nv = surface->vertex_count;
    f->surface = surface;
    f->proxy = proxy;
    f->pinned = motion->pinned;
    f->closest = PCI_ALLOCATE(f->context, pci_place, nv);
    pc_status status = f->closest != NULL
                           ? pci_closest_points(f->context, stage, surface, proxy, f->closest)
                           : pci_fail_memory(f->context, stage);
    if (status == PC_OK && o->solver == PC_SKIN_ALTERNATE) {
        status = pci_skin_follow_proxy(f->context, surface, proxy, f->closest, &f->followed);
    }
    if (status != PC_OK) {
        return status;
    }
    // Only now: smoothing needs as much memory as all that follows.
    f->bones = PCI_SCRATCH(scratch, uint32_t, nv * slots);
    f->weights = PCI_SCRATCH(scratch, double, nv *slots);
    if (scratch->failed ||
        !pci_skin_problem_build(scratch, surface, f->ranks, o->neighbours, &f->problem)) {
        return pci_fail_memory(f->context, stage);
    }
    memcpy(f->paper_norms, f->problem.norms, sizeof(f->paper_norms));
    if (o->solver == PC_SKIN_ALTERNATE && o->equal_edges) {
        pci_skin_problem_equalize(&f->problem);
    }
    const size_t edges = f->problem.ring_offsets[nv];
    if (o->solver == PC_SKIN_ALTERNATE && o->lambda_layers > 0.0 && edges > 0) {
        status = pci_skin_find_layers(scratch, surface, proxy, f->closest,
                                      sqrt(f->paper_norms[0] / (double)edges), o->lambda_layers,
                                      &f->layers);
        f->problem.layers = f->layers.offsets != NULL ? &f->layers : NULL;
    }
    if (status != PC_OK) {
        return status;
    }
    if (!pci_skin_find_candidates(scratch, surface, proxy, f->closest,
                                  f->followed.weights != NULL ? &f->followed : NULL, slots,
                                  f->bones, f->weights)) {
        return pci_fail_memory(f->context, stage);
    }
    f->problem.slots = slots;
    f->problem.bones = f->bones;
    return set_driver(scratch, &f->problem, proxy, motion, o->skinning);
}

// `rows`: of pci_skin_sort, or NULL.
static pc_status write_result(pci_scratch *scratch, const pci_skin_fit *f, size_t vertex_count,
                              const uint32_t *rows, pc_skin *skin, pc_skin_report *report) {
    const uint32_t kept = f->problem.slots, influences = f->options->influences;
    skin->skinning = f->options->skinning;
    uint8_t *used = PCI_SCRATCH(scratch, uint8_t, f->problem.proxy_count);
    if (used == NULL || !pci_skin_allocate(f->context, vertex_count, influences, skin)) {
        return pci_fail_memory(f->context, stage);
    }
    for (size_t v = 0; v < skin->vertex_count; ++v) {
        uint32_t *bones = &skin->bones[v * influences];
        double *weights = &skin->weights[v * influences];
        const size_t row = rows != NULL ? rows[v] : v;
        memcpy(bones, &f->bones[row * kept], kept * sizeof(*bones));
        pci_skin_normalize(&f->weights[row * kept], kept, weights);
        pci_skin_sort_row(bones, weights, kept);
    }
    if (!pci_skin_scale_rows(skin)) {
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
    if (status == PC_OK) {
        status = check_bones(context, proxy, &chosen);
    }
    if (status != PC_OK) {
        return status;
    }
    if (skin == NULL || skin->bones != NULL || skin->weights != NULL) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage, "skin: the output is not empty");
    }
    pci_scratch scratch = pci_scratch_begin(context);
    pc_skin_report r = {0};
    pci_skin_fit f = {.context = context,
                      .options = &chosen,
                      .spatial_share = 1.0,
                      .follow_share = 1.0,
                      .stretch_share = 1.0};
    pc_mesh sorted = *surface;
    const uint32_t *rows = NULL;
    if (chosen.solver == PC_SKIN_ALTERNATE &&
        !pci_skin_sort(&scratch, surface, &sorted, &rows, &f.ranks)) {
        status = pci_fail_memory(context, stage);
    }
    if (status == PC_OK) {
        status = prepare(&scratch, &sorted, proxy, motion, &f);
    }
    if (chosen.solver == PC_SKIN_ALTERNATE) { // what follows needs neither
        pci_scratch_release(&scratch, sorted.triangles);
        pci_scratch_release(&scratch, (void *)f.ranks);
        sorted.triangles = NULL;
        f.ranks = f.problem.ranks = NULL;
    }
    if (status == PC_OK) {
        status = chosen.solver == PC_SKIN_ADAMW ? pci_skin_fit_adamw(&scratch, &f, &r)
                                                : pci_skin_fit_alternate(&f, &r);
    }
    if (status == PC_OK) {
        status = write_result(&scratch, &f, surface->vertex_count, rows, skin, &r);
    }
    pc_skin_free(context, &f.followed);
    pc_release(context, f.closest);
    pci_scratch_end(&scratch);
    if (status != PC_OK) {
        pc_skin_free(context, skin);
    } else if (report != NULL) {
        *report = r;
    }
    return status;
}

// ---- evaluation, deformation --------------------------------------------------------------------

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
    status = pci_skin_problem_build(&scratch, surface, NULL, chosen.neighbours, &problem)
                 ? set_driver(&scratch, &problem, proxy, motion, skin->skinning)
                 : pci_fail_memory(context, stage);
    if (status == PC_OK) {
        problem.slots = skin->influences;
        problem.bones = skin->bones;
        status =
            pci_skin_measure(context, &problem, pci_skin_kernel_double(), skin->weights, &measures);
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
                    const double *proxy_frame, const double *rotations, double *output) {
    for (size_t v = 0; v < skin->vertex_count; ++v) {
        const double *from = &rest[3 * v];
        double position[3] = {from[0], from[1], from[2]};
        for (size_t k = v * skin->influences; k < (v + 1) * skin->influences; ++k) {
            const size_t bone = skin->bones[k];
            double moved[3];
            pci_sub(&proxy_frame[3 * bone], &proxy_rest[3 * bone], moved);
            if (rotations != NULL) {
                double arm[3], turn[9];
                pci_sub(from, &proxy_rest[3 * bone], arm);
                pci_matrix_of_quaternion(&rotations[4 * bone], turn);
                for (size_t c = 0; c < 3; ++c) {
                    moved[c] += pci_dot(&turn[3 * c], arm) - arm[c];
                }
            }
            for (size_t c = 0; c < 3; ++c) {
                position[c] += skin->weights[k] * moved[c];
            }
        }
        memcpy(&output[3 * v], position, sizeof(position));
    }
}
