// The course of an optimisation: all candidates, half way, K. Cutting alone would lose most.
#include "stages/skin_fit.h"

#include "core/topology.h"
#include "proxycloth/baselines.h"
#include "stages/skin_alternate.h"

static const char stage[] = "skin";

enum { PHASES = 3, FOLLOWED_INFLUENCES = 8 };
static const double phase_ends[PHASES] = {0.4, 0.6, 1.0}; // shares of the epochs or rounds
static const double rigid_share = 0.7; // more of its L_r left: L_c gets less weight

static const double held_share = 1e-6;      // barycentric coordinates below count as 0
static const double following_factor = 2.0; // of lambda_follow, where the garment moves too little
enum { MOTION_STRIDE = 8 }; // frames from one in which motion is measured to the next

static void phase_widths(const pci_skin_fit *f, uint32_t widths[PHASES]) {
    const uint32_t slots = f->problem.slots, influences = f->options->influences;
    widths[0] = slots;
    widths[2] = influences < slots ? influences : slots;
    widths[1] = (slots + widths[2] + 1) / 2;
}

static uint32_t phase_share(uint32_t count, size_t phase) {
    const double begin = phase == 0 ? 0.0 : phase_ends[phase - 1];
    return (uint32_t)round(phase_ends[phase] * count) - (uint32_t)round(begin * count);
}

void pci_skin_sort_row(uint32_t *bones, double *weights, uint32_t count) {
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

// Leaves the `kept` heaviest slots of each row.
static pc_status cut(pci_scratch *scratch, pci_skin_fit *f, uint32_t kept) {
    const size_t nv = f->problem.vertex_count, slots = f->problem.slots;
    uint32_t *bones = PCI_SCRATCH(scratch, uint32_t, nv * kept);
    double *weights = PCI_SCRATCH(scratch, double, nv *kept);
    if (scratch->failed) {
        return pci_fail_memory(f->context, stage);
    }
    for (size_t v = 0; v < nv; ++v) {
        double row[PCI_SKIN_CANDIDATES_MAX];
        pci_skin_normalize(&f->weights[v * slots], (uint32_t)slots, row);
        pci_skin_sort_row(&f->bones[v * slots], row, (uint32_t)slots);
        memcpy(&bones[v * kept], &f->bones[v * slots], kept * sizeof(*bones));
        pci_skin_normalize(row, kept, &weights[v * kept]);
    }
    f->bones = bones;
    f->weights = weights;
    f->problem.slots = kept;
    f->problem.bones = bones;
    return PC_OK;
}

// Losses per norm and frame; returns their weighted sum.
static double normalize_losses(const pci_skin_fit *f, const double norms[3],
                               const pci_skin_measures *measures, double losses[3]) {
    const double lambda[3] = {f->options->lambda_rigid, f->options->lambda_collision,
                              f->options->lambda_attachment};
    double total = 0.0;
    for (size_t x = 0; x < 3; ++x) {
        const double norm = norms[x] * (double)f->problem.frame_count;
        losses[x] = norm > 0.0 ? measures->losses[x] / norm : 0.0;
        total += lambda[x] * losses[x];
    }
    return total;
}

// The problem of the paper's losses, which the report gives.
static pci_skin_problem paper_problem(const pci_skin_fit *f) {
    pci_skin_problem paper = f->problem;
    paper.typical = 0.0;
    return paper;
}

static void report_before(const pci_skin_fit *f, const pci_skin_measures *measures,
                          pc_skin_report *r) {
    double losses[3];
    r->loss_before = normalize_losses(f, f->paper_norms, measures, losses);
    r->rigid_before = losses[0];
    r->collision_before = losses[1];
    r->attachment_before = losses[2];
}

static void report_after(const pci_skin_fit *f, const pci_skin_measures *measures,
                         pc_skin_report *r) {
    double losses[3];
    r->loss_after = normalize_losses(f, f->paper_norms, measures, losses);
    r->rigid_after = losses[0];
    r->collision_after = losses[1];
    r->attachment_after = losses[2];
    r->reflections = measures->reflections;
}

// Layers that the proxy moves through each other cannot be held together by weights; they must not
// cost the shape of each layer. So L_c weighs no more than L_r at first, ...
static void balance(pci_skin_fit *f, const pci_skin_measures *measures) {
    double losses[3];
    (void)normalize_losses(f, f->problem.norms, measures, losses);
    f->rigid_before = f->options->lambda_rigid > 0.0 ? losses[0] : 0.0;
    if (f->rigid_before > 0.0 && losses[1] > f->rigid_before) {
        f->spatial_share = f->rigid_before / losses[1];
    }
}

// ... and less where L_r does not fall. True when that changed.
static bool rebalance(pci_skin_fit *f, const pci_skin_measures *measures) {
    double losses[3];
    (void)normalize_losses(f, f->problem.norms, measures, losses);
    if (losses[0] <= rigid_share * f->rigid_before || f->rigid_before == 0.0) {
        return false;
    }
    f->spatial_share *= 0.25;
    return true;
}

// ---- AdamW --------------------------------------------------------------------------------------

// One phase; the last with a falling learning rate.
static pc_status descend(const pci_skin_fit *f, size_t phase) {
    const pc_skin_options *o = f->options;
    const pci_skin_descent settings = {
        .lambda = {o->lambda_rigid, f->spatial_share * o->lambda_collision,
                   f->spatial_share * o->lambda_attachment},
        .epochs = phase_share(o->epochs, phase),
        .batch = o->batch,
        .learning_rate = o->learning_rate,
        .weight_decay = o->weight_decay,
        // The loss is a mean over the vertices; so is the scale of its gradient.
        .epsilon = 1e-8 / (double)f->problem.vertex_count,
        .decay = phase + 1 == PHASES,
        .seed = o->seed,
        .progress_begin = phase == 0 ? 0.0 : phase_ends[phase - 1],
        .progress_end = phase_ends[phase],
    };
    return pci_skin_descend(f->context, &f->problem, pci_skin_kernel_float(), &settings,
                            f->weights);
}

static pc_status measure_surrogate(pci_scratch *scratch, const pci_skin_fit *f,
                                   pci_skin_measures *measures) {
    const pci_skin_problem paper = paper_problem(f), *p = &paper;
    double *weights = PCI_SCRATCH(scratch, double, p->vertex_count * p->slots);
    if (weights == NULL) {
        return pci_fail_memory(f->context, stage);
    }
    for (size_t v = 0; v < p->vertex_count; ++v) {
        pci_skin_normalize(&f->weights[v * p->slots], p->slots, &weights[v * p->slots]);
    }
    return pci_skin_measure(f->context, p, pci_skin_kernel_float(), weights, measures, NULL);
}

pc_status pci_skin_fit_adamw(pci_scratch *scratch, pci_skin_fit *f, pc_skin_report *r) {
    uint32_t widths[PHASES];
    phase_widths(f, widths);
    pci_skin_measures measures = {0};
    pc_status status = measure_surrogate(scratch, f, &measures);
    report_before(f, &measures, r);
    balance(f, &measures);
    for (size_t phase = 0; phase < PHASES && status == PC_OK; ++phase) {
        if (widths[phase] < f->problem.slots) {
            status = cut(scratch, f, widths[phase]);
        }
        if (status == PC_OK) {
            status = descend(f, phase);
        }
        if (status == PC_OK && phase + 1 < PHASES) {
            double losses[3];
            status = measure_surrogate(scratch, f, &measures);
            const double total = normalize_losses(f, f->paper_norms, &measures, losses);
            r->full_loss = phase == 0 ? total : r->full_loss;
            (void)rebalance(f, &measures);
        }
    }
    r->spatial_share = f->spatial_share;
    if (status == PC_OK) {
        status = measure_surrogate(scratch, f, &measures);
        report_after(f, &measures, r);
    }
    return status;
}

// ---- alternation --------------------------------------------------------------------------------

// A vertex whose closest point is held follows that point and nothing else.
static void hold_pinned(const pci_skin_fit *f, uint32_t *allowed) {
    const uint32_t slots = f->problem.slots;
    for (size_t v = 0; v < f->problem.vertex_count && f->pinned != NULL; ++v) {
        const pci_closest *closest = &f->closest[v];
        const uint32_t *corners = &f->proxy->triangles[3 * (size_t)closest->triangle];
        bool held = true;
        for (size_t c = 0; c < 3; ++c) {
            held = held && (closest->barycentric[c] < held_share || f->pinned[corners[c]]);
        }
        for (uint32_t k = 0; k < slots && held; ++k) {
            double *weight = &f->weights[v * slots + k];
            *weight = 0.0;
            for (size_t c = 0; c < 3; ++c) {
                if (corners[c] == f->bones[v * slots + k] &&
                    closest->barycentric[c] >= held_share) {
                    *weight = closest->barycentric[c];
                }
            }
            allowed[v] = 0;
        }
    }
}

pc_status pci_skin_follow_proxy(pc_context *context, const pc_mesh *surface, const pc_mesh *proxy,
                                pc_skin *followed) {
    const pc_status status =
        pc_skin_heat_smoothed(context, surface, proxy, FOLLOWED_INFLUENCES, followed);
    return status == PC_ERROR_NUMERICAL // hardly any area conducts heat
               ? pc_skin_closest_triangle(context, surface, proxy, followed)
               : status;
}

// Starts from what L_f follows: small parts move as one then, which sweeps from vertex to vertex
// would take long to find.
static void start_from_followed(pci_skin_fit *f) {
    const uint32_t slots = f->problem.slots, influences = f->followed.influences;
    for (size_t v = 0; v < f->problem.vertex_count; ++v) {
        double *row = &f->weights[v * slots];
        memset(row, 0, slots * sizeof(*row));
        for (size_t k = 0; k < slots; ++k) {
            for (size_t l = v * influences; l < (v + 1) * influences; ++l) {
                row[k] +=
                    f->followed.bones[l] == f->bones[v * slots + k] ? f->followed.weights[l] : 0.0;
            }
        }
    }
}

// Length of a vertex's way from rest in one frame, from the maps of the bones.
static double way(const double *maps, size_t columns, const double *point, size_t count,
                  const uint32_t *bones, const double *weights) {
    double u[3] = {0};
    for (size_t k = 0; k < count; ++k) {
        const double *map = &maps[3 * PCI_SKIN_COLUMNS_MAX * (size_t)bones[k]];
        for (size_t i = 0; i < 3 * columns; ++i) {
            u[i % 3] += weights[k] * (point[i / 3] * map[i]);
        }
    }
    return pci_norm(u);
}

// Motion of the garment over that of its closest points on the proxy, from some of the frames.
// False: out of memory.
static bool find_motion_ratio(const pci_skin_fit *f, double *ratio) {
    const pci_skin_problem *p = &f->problem;
    const size_t columns = pci_skin_columns(p);
    pci_skin_problem still = *p; // closest points are moved
    still.rotations = NULL;
    pci_scratch scratch = pci_scratch_begin(f->context);
    const size_t size = 3 * PCI_SKIN_COLUMNS_MAX;
    double *maps = PCI_SCRATCH(&scratch, double, size * p->proxy_count);
    double *moves = PCI_SCRATCH(&scratch, double, size * p->proxy_count);
    double origin[3], moved = 0.0, moved_closest = 0.0;
    (void)pci_skin_extent(p, origin);
    for (size_t t = 0; t < p->frame_count && !scratch.failed; t += MOTION_STRIDE) {
        for (size_t b = 0; b < p->proxy_count; ++b) {
            pci_skin_bone_map(p, origin, t, b, &maps[size * b]);
            pci_skin_bone_map(&still, origin, t, b, &moves[size * b]);
        }
        for (size_t v = 0; v < p->vertex_count; ++v) {
            const pci_closest *closest = &f->closest[v];
            double point[PCI_SKIN_COLUMNS_MAX];
            pci_skin_point(p, origin, 1.0, v, point);
            moved += way(maps, columns, point, p->slots, &f->bones[v * p->slots],
                         &f->weights[v * p->slots]);
            moved_closest +=
                way(moves, 1, point, 3, &f->proxy->triangles[3 * (size_t)closest->triangle],
                    closest->barycentric);
        }
    }
    *ratio = moved_closest > 0.0 ? moved / moved_closest : 1.0;
    const bool good = !scratch.failed;
    pci_scratch_end(&scratch);
    return good;
}

// The losses are least where nothing moves: L_f counts more while the garment moves too little.
// `changed` becomes true when that did.
static pc_status keep_moving(pci_skin_fit *f, bool *changed) {
    double ratio;
    if (!find_motion_ratio(f, &ratio)) {
        return pci_fail_memory(f->context, stage);
    }
    *changed = ratio < f->options->least_motion;
    f->follow_share *= *changed ? following_factor : 1.0;
    return PC_OK;
}

static void normalize_rows(const pci_skin_fit *f) {
    const uint32_t slots = f->problem.slots;
    for (size_t v = 0; v < f->problem.vertex_count; ++v) {
        double row[PCI_SKIN_CANDIDATES_MAX];
        pci_skin_normalize(&f->weights[v * slots], slots, row);
        memcpy(&f->weights[v * slots], row, slots * sizeof(*row));
    }
}

static pc_status measure(const pci_skin_fit *f, pci_skin_alternation *a,
                         pci_skin_measures *measures) {
    const pci_skin_problem paper = paper_problem(f);
    pci_skin_frames_use(&a->frames, &paper);
    const pc_status status = pci_skin_alternation_measure(a, f->weights, measures);
    pci_skin_frames_use(&a->frames, &f->problem);
    return status;
}

static pc_status weigh(pci_scratch *scratch, const pci_skin_fit *f, pci_skin_alternation *a) {
    const pc_skin_options *o = f->options;
    const double lambda[4] = {o->lambda_rigid, f->spatial_share * o->lambda_collision,
                              f->spatial_share * o->lambda_attachment, o->lambda_stretch};
    return pci_skin_alternation_weigh(scratch, a, lambda, f->follow_share * o->lambda_follow)
               ? PC_OK
               : pci_fail_memory(f->context, stage);
}

pc_status pci_skin_fit_alternate(pci_scratch *scratch, pci_skin_fit *f, pc_skin_report *r) {
    const pc_skin_options *o = f->options;
    const pci_skin_problem *p = &f->problem;
    const uint32_t slots = p->slots;
    uint32_t widths[PHASES];
    phase_widths(f, widths);
    pci_skin_alternation a;
    if (!pci_skin_alternation_build(scratch, p, pci_skin_kernel_float(), &a)) {
        return pci_fail_memory(f->context, stage);
    }
    pci_skin_alternation_follow(&a, f->proxy, &f->followed);
    pci_skin_measures measures = {0};
    normalize_rows(f);
    pc_status status = measure(f, &a, &measures);
    report_before(f, &measures, r);
    if (status == PC_OK) {
        status = pci_skin_alternation_measure(&a, f->weights, &measures);
        balance(f, &measures);
    }
    start_from_followed(f);
    hold_pinned(f, a.allowed);
    normalize_rows(f);
    if (status == PC_OK) {
        status = weigh(scratch, f, &a);
    }
    for (size_t phase = 0; phase < PHASES && status == PC_OK; ++phase) {
        if (phase == 1) {
            double losses[3];
            status = measure(f, &a, &measures);
            r->full_loss = normalize_losses(f, f->paper_norms, &measures, losses);
        }
        if (phase > 0 && status == PC_OK) {
            // The pass over the frames before slots are taken away also measures.
            bool still = false;
            status = keep_moving(f, &still);
            if (status == PC_OK) {
                status = pci_skin_alternation_prune(&a, widths[phase], f->weights, &measures);
            }
            if (status == PC_OK && (rebalance(f, &measures) || still)) {
                status = weigh(scratch, f, &a);
            }
        }
        if (status == PC_OK) {
            status = pci_skin_alternation_run(
                &a, phase_share(o->rounds, phase), o->round_gain, phase + 1 < PHASES,
                phase == 0 ? 0.0 : phase_ends[phase - 1], phase_ends[phase], f->weights);
        }
    }
    r->rounds = a.rounds;
    r->spatial_share = f->spatial_share;
    if (status == PC_OK) {
        status = measure(f, &a, &measures);
        report_after(f, &measures, r);
    }
    return status == PC_OK && widths[PHASES - 1] < slots ? cut(scratch, f, widths[PHASES - 1])
                                                         : status;
}
