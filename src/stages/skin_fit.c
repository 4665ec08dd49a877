// The course of an optimisation: all candidates, half way, K. Cutting alone would lose most.
#include "stages/skin_fit.h"

#include "core/topology.h"
#include "proxycloth/baselines.h"
#include "stages/skin_alternate.h"

static const char stage[] = "skin";

enum { PHASES = 3, FOLLOWED_INFLUENCES = 8 };
static const double phase_ends[PHASES] = {0.4, 0.6, 1.0}; // shares of the epochs or rounds
static const double rigid_share = 0.7; // more of its L_r left: L_c gets less weight

static const double held_share = 1e-6; // barycentric coordinates below count as 0

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
static double normalize_losses(const pci_skin_fit *f, const pci_skin_measures *measures,
                               double losses[3]) {
    const pci_skin_problem *p = &f->problem;
    const double lambda[3] = {f->options->lambda_rigid, f->options->lambda_collision,
                              f->options->lambda_attachment};
    double total = 0.0;
    for (size_t x = 0; x < 3; ++x) {
        const double norm = p->norms[x] * (double)p->frame_count;
        losses[x] = norm > 0.0 ? measures->losses[x] / norm : 0.0;
        total += lambda[x] * losses[x];
    }
    return total;
}

static pc_status measure(pci_scratch *scratch, const pci_skin_fit *f, double losses[3],
                         double *total, uint64_t *reflections) {
    const pci_skin_problem *p = &f->problem;
    double *weights = PCI_SCRATCH(scratch, double, p->vertex_count * p->slots);
    if (weights == NULL) {
        return pci_fail_memory(f->context, stage);
    }
    for (size_t v = 0; v < p->vertex_count; ++v) {
        pci_skin_normalize(&f->weights[v * p->slots], p->slots, &weights[v * p->slots]);
    }
    pci_skin_measures measures;
    const pc_status status =
        pci_skin_measure(f->context, p, pci_skin_kernel_float(), weights, &measures, NULL);
    *total = normalize_losses(f, &measures, losses);
    *reflections = measures.reflections;
    return status;
}

static pc_status measure_before(pci_scratch *scratch, const pci_skin_fit *f, pc_skin_report *r) {
    double losses[3];
    uint64_t reflections;
    const pc_status status = measure(scratch, f, losses, &r->loss_before, &reflections);
    r->rigid_before = losses[0];
    r->collision_before = losses[1];
    r->attachment_before = losses[2];
    return status;
}

static pc_status measure_after(pci_scratch *scratch, const pci_skin_fit *f, pc_skin_report *r) {
    double losses[3];
    const pc_status status = measure(scratch, f, losses, &r->loss_after, &r->reflections);
    r->rigid_after = losses[0];
    r->collision_after = losses[1];
    r->attachment_after = losses[2];
    return status;
}

// Layers that the proxy moves through each other cannot be held together by weights; they must not
// cost the shape of each layer. So L_c weighs no more than L_r at first, ...
static bool balance(pci_skin_fit *f, const pc_skin_report *r) {
    const bool balanced = f->options->lambda_rigid > 0.0 && r->rigid_before > 0.0;
    if (balanced && r->collision_before > r->rigid_before) {
        f->spatial_share = r->rigid_before / r->collision_before;
    }
    return balanced;
}

// ... and less where L_r does not fall. True when that changed.
static bool rebalance(pci_skin_fit *f, const pc_skin_report *r, double rigid) {
    if (rigid <= rigid_share * r->rigid_before) {
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

pc_status pci_skin_fit_adamw(pci_scratch *scratch, pci_skin_fit *f, pc_skin_report *r) {
    uint32_t widths[PHASES];
    phase_widths(f, widths);
    pc_status status = measure_before(scratch, f, r);
    const bool balanced = balance(f, r);
    for (size_t phase = 0; phase < PHASES && status == PC_OK; ++phase) {
        if (widths[phase] < f->problem.slots) {
            status = cut(scratch, f, widths[phase]);
        }
        if (status == PC_OK) {
            status = descend(f, phase);
        }
        if (status == PC_OK && phase + 1 < PHASES) {
            double losses[3] = {0.0}, total = 0.0;
            uint64_t reflections = 0;
            status = measure(scratch, f, losses, &total, &reflections);
            r->full_loss = phase == 0 ? total : r->full_loss;
            if (balanced) {
                (void)rebalance(f, r, losses[0]);
            }
        }
    }
    r->spatial_share = f->spatial_share;
    return status == PC_OK ? measure_after(scratch, f, r) : status;
}

// ---- alternation --------------------------------------------------------------------------------

// A vertex whose closest point is held may only follow held vertices.
static void hold_pinned(const pci_skin_fit *f, uint32_t *allowed) {
    const uint32_t slots = f->problem.slots;
    for (size_t v = 0; v < f->problem.vertex_count && f->pinned != NULL; ++v) {
        const pci_closest *closest = &f->closest[v];
        bool held = true, possible = false;
        for (size_t c = 0; c < 3; ++c) {
            const uint32_t corner = f->proxy->triangles[3 * (size_t)closest->triangle + c];
            held = held && (closest->barycentric[c] < held_share || f->pinned[corner]);
        }
        for (uint32_t k = 0; k < slots; ++k) {
            possible = possible || f->pinned[f->bones[v * slots + k]];
        }
        held = held && possible;
        for (uint32_t k = 0; k < slots && held; ++k) {
            if (!f->pinned[f->bones[v * slots + k]]) {
                allowed[v] &= ~((uint32_t)1 << k);
                f->weights[v * slots + k] = 0.0;
            }
        }
    }
}

// The closest points make the garment move as much as its proxy; smoothed, they have no kinks at
// the proxy's edges that L_r would have to fight.
static pc_status follow_proxy(const pci_skin_fit *f, pci_skin_alternation *a) {
    pc_skin followed = {0};
    pc_status status =
        pc_skin_heat_smoothed(f->context, f->surface, f->proxy, FOLLOWED_INFLUENCES, &followed);
    if (status == PC_ERROR_NUMERICAL) { // hardly any area conducts heat
        status = pc_skin_closest_triangle(f->context, f->surface, f->proxy, &followed);
    }
    if (status == PC_OK) {
        pci_skin_alternation_follow(a, f->proxy, &followed);
    }
    pc_skin_free(f->context, &followed);
    return status;
}

static pc_status weigh(pci_scratch *scratch, const pci_skin_fit *f, pci_skin_alternation *a) {
    const pc_skin_options *o = f->options;
    const double lambda[4] = {o->lambda_rigid, f->spatial_share * o->lambda_collision,
                              f->spatial_share * o->lambda_attachment, o->lambda_stretch};
    return pci_skin_alternation_weigh(scratch, a, lambda, o->lambda_follow)
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
    pc_status status = follow_proxy(f, &a);
    if (status == PC_OK) {
        status = measure_before(scratch, f, r);
    }
    hold_pinned(f, a.allowed);
    for (size_t v = 0; v < p->vertex_count; ++v) {
        double row[PCI_SKIN_CANDIDATES_MAX];
        pci_skin_normalize(&f->weights[v * slots], slots, row);
        memcpy(&f->weights[v * slots], row, slots * sizeof(*row));
    }
    const bool balanced = balance(f, r);
    if (status == PC_OK) {
        status = weigh(scratch, f, &a);
    }
    for (size_t phase = 0; phase < PHASES && status == PC_OK; ++phase) {
        if (phase > 0) {
            // The pass over the frames before slots are taken away also measures.
            double losses[3];
            pci_skin_measures measures;
            status = pci_skin_alternation_prune(&a, widths[phase], f->weights, &measures);
            if (status != PC_OK) {
                break;
            }
            const double total = normalize_losses(f, &measures, losses);
            r->full_loss = phase == 1 ? total : r->full_loss;
            if (balanced && rebalance(f, r, losses[0])) {
                status = weigh(scratch, f, &a);
            }
        }
        if (status == PC_OK) {
            status = pci_skin_alternation_run(&a, phase_share(o->rounds, phase), o->round_gain,
                                              phase == 0 ? 0.0 : phase_ends[phase - 1],
                                              phase_ends[phase], f->weights);
        }
    }
    r->rounds = a.rounds;
    r->spatial_share = f->spatial_share;
    if (status == PC_OK && widths[PHASES - 1] < slots) {
        status = cut(scratch, f, widths[PHASES - 1]);
    }
    return status == PC_OK ? measure_after(scratch, f, r) : status;
}
