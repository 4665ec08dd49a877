// The course of an optimisation: from all candidates to K in steps. Cutting alone would lose most.
#include "stages/skin/skin_fit.h"

#include "geometry/topology.h"
#include "proxycloth/baselines.h"
#include "stages/skin/skin_coarse.h"
#include "stages/skin/skin_compare.h"
#include "stages/skin/skin_secants.h"
#include "stages/skin/weight_rows.h"

static const char stage[] = "skin";

enum { PHASES = 3, FOLLOWED_INFLUENCES = 8 };
// Ends of the first two phases; shares of the rounds.
static const double first_end = 0.15, second_end = 0.6;
static const double rigid_share = 0.7; // more of its L_r left: L_c gets less weight

static const double held_share = 1e-6; // barycentric coordinates below count as 0
// What is missing of the motion falls about with the square root of lambda_f, the strain with the
// sixth root of lambda_s.
static const double motion_power = 2.0, strain_power = 6.0;
static const double most_share = 16.0; // of lambda_f and lambda_s
enum { LEAST_VERTICES = 500 };         // problems of fewer have no smaller one

// What a row keeps in each phase: all candidates, then half of what is too much, then K. Shorter
// steps would gain nothing.
typedef struct course {
    uint32_t widths[PHASES];
    double ends[PHASES]; // shares of the epochs or rounds
} course;

static course plan_course(const pci_skin_fit *f, double first, double second) {
    const uint32_t slots = f->problem.slots, influences = f->options->influences;
    const uint32_t surplus = influences < slots ? slots - influences : 0;
    const course c = {.widths = {slots, slots - surplus / 2, slots - surplus},
                      .ends = {first, second, 1.0}};
    return c;
}

static double phase_begin(const course *c, uint32_t phase) {
    return phase == 0 ? 0.0 : c->ends[phase - 1];
}

static uint32_t phase_share(const course *c, uint32_t count, uint32_t phase) {
    return (uint32_t)round(c->ends[phase] * count) - (uint32_t)round(phase_begin(c, phase) * count);
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

// ... and less where L_r does not fall.
static void rebalance(pci_skin_fit *f, const pci_skin_measures *measures) {
    double losses[3];
    (void)normalize_losses(f, f->problem.norms, measures, losses);
    if (losses[0] > rigid_share * f->rigid_before && f->rigid_before > 0.0) {
        f->spatial_share *= 0.25;
    }
}

// ---- AdamW --------------------------------------------------------------------------------------

// One phase; the last with a falling learning rate.
static pc_status descend(const pci_skin_fit *f, const course *c, uint32_t phase) {
    const pc_skin_options *o = f->options;
    const pci_skin_descent settings = {
        .lambda = {o->lambda_rigid, f->spatial_share * o->lambda_collision,
                   f->spatial_share * o->lambda_attachment},
        .epochs = phase_share(c, o->epochs, phase),
        .batch = o->batch,
        .learning_rate = o->learning_rate,
        .weight_decay = o->weight_decay,
        // The loss is a mean over the vertices; so is the scale of its gradient.
        .epsilon = 1e-8 / (double)f->problem.vertex_count,
        .decay = phase + 1 == PHASES,
        .seed = o->seed,
        .progress_begin = phase_begin(c, phase),
        .progress_end = c->ends[phase],
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
    return pci_skin_measure(f->context, p, pci_skin_kernel_float(), weights, measures);
}

pc_status pci_skin_fit_adamw(pci_scratch *scratch, pci_skin_fit *f, pc_skin_report *r) {
    const course c = plan_course(f, 0.4, 0.6);
    pci_skin_measures measures = {0};
    pc_status status = measure_surrogate(scratch, f, &measures);
    report_before(f, &measures, r);
    balance(f, &measures);
    for (uint32_t phase = 0; phase < PHASES && status == PC_OK; ++phase) {
        if (c.widths[phase] < f->problem.slots) {
            status = cut(scratch, f, c.widths[phase]);
        }
        if (status == PC_OK) {
            status = descend(f, &c, phase);
        }
        if (status == PC_OK && phase + 1 < PHASES) {
            double losses[3];
            status = measure_surrogate(scratch, f, &measures);
            const double total = normalize_losses(f, f->paper_norms, &measures, losses);
            r->full_loss = phase == 0 ? total : r->full_loss;
            rebalance(f, &measures);
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
        const pci_place *closest = &f->closest[v];
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
            if (allowed != NULL) {
                allowed[v] = 0;
            }
        }
    }
}

// The heaviest of both rows together, in the place of the first.
static void merge_rows(pc_skin *skin, size_t v, const pc_skin *closest) {
    const size_t slots = skin->influences;
    uint32_t bones[FOLLOWED_INFLUENCES + 3];
    double weights[FOLLOWED_INFLUENCES + 3];
    uint32_t count = 0;
    for (size_t k = 0; k < slots; ++k) {
        bones[count] = skin->bones[v * slots + k];
        weights[count++] = skin->weights[v * slots + k];
    }
    for (size_t c = 3 * v; c < 3 * v + 3; ++c) {
        uint32_t at = 0;
        while (at < count && bones[at] != closest->bones[c]) {
            ++at;
        }
        if (at == count) {
            bones[count] = closest->bones[c];
            weights[count++] = 0.0;
        }
        weights[at] += closest->weights[c];
    }
    pci_skin_sort_row(bones, weights, count);
    memcpy(&skin->bones[v * slots], bones, slots * sizeof(*bones));
    memcpy(&skin->weights[v * slots], weights, slots * sizeof(*weights));
}

pc_status pci_skin_follow_proxy(pc_context *context, const pc_mesh *surface, const pc_mesh *proxy,
                                const pci_place *closest, pc_skin *followed) {
    pc_skin points = {0};
    pc_status status =
        pci_skin_follow_points(context, proxy, surface->vertex_count, closest, &points);
    if (status == PC_OK) {
        status = pci_skin_smooth(context, surface, proxy, &points, FOLLOWED_INFLUENCES, followed);
        if (status == PC_ERROR_NUMERICAL) { // hardly any area conducts heat
            *followed = points;
            return PC_OK;
        }
    }
    for (size_t v = 0; v < surface->vertex_count && status == PC_OK; ++v) {
        merge_rows(followed, v, &points);
    }
    pc_skin_free(context, &points);
    if (status == PC_OK && !pci_skin_scale_rows(followed)) {
        status = pci_fail(context, PC_ERROR_NUMERICAL, stage,
                          "skin: the closest points left the finite numbers");
    }
    return status;
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

// How much a lambda counts where what it lowers is `excess` times what is asked for.
static double adapt_share(double share, double excess, double power) {
    const double next = share * pow(excess, power);
    return next > 1.0 ? fmin(next, most_share) : 1.0;
}

static void normalize_rows(const pci_skin_fit *f) {
    const uint32_t slots = f->problem.slots;
    for (size_t v = 0; v < f->problem.vertex_count; ++v) {
        double row[PCI_SKIN_CANDIDATES_MAX];
        pci_skin_normalize(&f->weights[v * slots], slots, row);
        memcpy(&f->weights[v * slots], row, slots * sizeof(*row));
    }
}

// The paper's losses. The alternation sees the paper's problem from then on.
static pc_status measure(pci_skin_fit *f, pci_skin_alternation *a, pci_skin_level level,
                         pci_skin_measures *measures) {
    f->paper = paper_problem(f);
    pci_skin_frames_use(&a->frames, &f->paper);
    return pci_skin_alternation_measure(a, level, f->weights, measures);
}

static pc_status weigh(pci_scratch *scratch, const pci_skin_fit *f, pci_skin_alternation *a) {
    const pc_skin_options *o = f->options;
    const double lambda[4] = {o->lambda_rigid, f->spatial_share * o->lambda_collision,
                              f->spatial_share * o->lambda_attachment,
                              f->stretch_share * o->lambda_stretch};
    return pci_skin_alternation_weigh(scratch, a, lambda, f->follow_share * o->lambda_follow)
               ? PC_OK
               : pci_fail_memory(f->context, stage);
}

// The rows of some vertices.
static void *take_rows(pci_scratch *scratch, const void *rows, size_t size, size_t count,
                       const uint32_t *vertices) {
    char *taken = pci_scratch_allocate(scratch, count, size);
    for (size_t i = 0; i < count && taken != NULL; ++i) {
        memcpy(&taken[i * size], &((const char *)rows)[vertices[i] * size], size);
    }
    return taken;
}

static bool restrict_fit(pci_scratch *scratch, const pci_skin_fit *f, const pci_skin_coarse *coarse,
                         pci_skin_fit *c) {
    const size_t count = coarse->problem.vertex_count, influences = f->followed.influences;
    const uint32_t *vertices = coarse->vertices;
    *c = *f;
    c->problem = coarse->problem;
    c->bones = (uint32_t *)coarse->problem.bones;
    c->weights =
        take_rows(scratch, f->weights, f->problem.slots * sizeof(*f->weights), count, vertices);
    c->closest = take_rows(scratch, f->closest, sizeof(*f->closest), count, vertices);
    c->followed.vertex_count = count;
    c->followed.bones = take_rows(scratch, f->followed.bones,
                                  influences * sizeof(*f->followed.bones), count, vertices);
    c->followed.weights = take_rows(scratch, f->followed.weights,
                                    influences * sizeof(*f->followed.weights), count, vertices);
    return !scratch->failed;
}

static pc_status solve_coarse(pci_scratch *scratch, pci_skin_fit *c, pci_skin_gram *gram);

pc_status pci_skin_start_from_coarse(pci_skin_fit *f, pci_skin_gram *gram, uint32_t *rounds) {
    const size_t slots = f->problem.slots;
    if (f->problem.vertex_count < LEAST_VERTICES) {
        *rounds = f->options->rounds;
        return PC_OK;
    }
    pci_scratch scratch = pci_scratch_begin(f->context);
    pci_skin_coarse coarse;
    pci_skin_fit c;
    if (!pci_skin_coarsen(&scratch, &f->problem, &coarse) ||
        !restrict_fit(&scratch, f, &coarse, &c)) {
        pci_scratch_end(&scratch);
        return pci_fail_memory(f->context, stage);
    }
    pc_status status = PC_OK;
    if (coarse.problem.vertex_count < f->problem.vertex_count / 2) {
        status = solve_coarse(&scratch, &c, gram);
        for (size_t k = 0; k < coarse.problem.vertex_count * slots && status == PC_OK; ++k) {
            c.weights[k] -= f->weights[slots * coarse.vertices[k / slots] + k % slots];
        }
        if (status == PC_OK &&
            !pci_skin_prolong(&scratch, gram, &f->problem, &coarse, c.weights, f->weights)) {
            status = pci_fail_memory(f->context, stage);
        }
    }
    pci_scratch_end(&scratch);
    return status;
}

static pc_status solve_coarse(pci_scratch *scratch, pci_skin_fit *c, pci_skin_gram *gram) {
    const pc_skin_options *o = c->options;
    pci_skin_alternation a;
    uint32_t rounds = (o->rounds + 1) / 2;
    pc_status status = pci_skin_start_from_coarse(c, gram, &rounds);
    if (status != PC_OK) {
        return status;
    }
    if (!pci_skin_alternation_build(scratch, &c->problem, pci_skin_kernel_float(), gram, &a)) {
        return pci_fail_memory(c->context, stage);
    }
    pci_skin_alternation_follow(&a, c->proxy, &c->followed);
    hold_pinned(c, a.allowed);
    normalize_rows(c);
    status = weigh(scratch, c, &a);
    return status == PC_OK
               ? pci_skin_alternation_run(&a, rounds, o->round_gain, true, 0.0, 0.0, c->weights)
               : status;
}

// What is decided whenever slots were taken away: whether layers can be held together, how much L_f
// counts, since the losses are least where nothing moves, and how much L_s, since flat cloth hardly
// stretches where it follows the closest triangle. `measures`: of the weights before, from the pass
// over frames that taking slots away needs.
static pc_status decide(pci_scratch *scratch, pci_skin_fit *f, pci_skin_alternation *a,
                        const pci_skin_measures *measures) {
    const double shares[3] = {f->spatial_share, f->follow_share, f->stretch_share};
    pci_skin_ratios ratios;
    if (!pci_skin_compare(f, &ratios)) {
        return pci_fail_memory(f->context, stage);
    }
    const double missing = fmax(1.0 - ratios.motion, 0.0) / (1.0 - f->options->least_motion);
    const double strain = ratios.strain / f->options->most_strain;
    rebalance(f, measures);
    f->follow_share = adapt_share(f->follow_share, missing, motion_power);
    f->stretch_share = adapt_share(f->stretch_share, strain, strain_power);
    const bool same = f->spatial_share == shares[0] && f->follow_share == shares[1] &&
                      f->stretch_share == shares[2];
    return same ? PC_OK : weigh(scratch, f, a);
}

// Takes slots away so that `kept` are left.
static pc_status narrow(pci_scratch *scratch, pci_skin_fit *f, pci_skin_alternation *a,
                        uint32_t kept) {
    pci_skin_measures measures = {0};
    const pc_status status = pci_skin_alternation_prune(a, kept, f->weights, &measures);
    if (status != PC_OK) {
        return status;
    }
    pci_skin_alternation_compact(a, kept, f->bones, f->weights);
    f->problem.slots = kept;
    return decide(scratch, f, a, &measures);
}

static pc_status run_phases(pci_scratch *scratch, pci_skin_fit *f, pci_skin_alternation *a,
                            uint32_t first_rounds, pc_skin_report *r) {
    const pc_skin_options *o = f->options;
    const course c = plan_course(f, first_end, second_end);
    pc_status status = PC_OK;
    for (uint32_t phase = 0; phase < PHASES && status == PC_OK; ++phase) {
        if (phase == 1) {
            pci_skin_measures measures = {0};
            double losses[3];
            status = measure(f, a, PCI_SKIN_SAMPLE, &measures);
            r->full_loss = normalize_losses(f, f->paper_norms, &measures, losses);
            pci_skin_frames_use(&a->frames, &f->problem);
        }
        if (phase > 0 && status == PC_OK) {
            status = narrow(scratch, f, a, c.widths[phase]);
        }
        // All candidates take the most memory, and few rounds are not helped by a second step.
        a->remembered = phase == 0 && first_rounds < o->rounds ? 1 : PCI_SKIN_SECANTS;
        if (status == PC_OK) {
            status = pci_skin_alternation_run(
                a, phase == 0 ? first_rounds : phase_share(&c, o->rounds, phase), o->round_gain,
                phase + 1 < PHASES, phase_begin(&c, phase), c.ends[phase], f->weights);
        }
    }
    return status;
}

// What the losses of the first guess are, and what follows from them. `a`: is built.
static pc_status measure_guess(pci_scratch *scratch, pci_skin_fit *f, pci_skin_gram *gram,
                               pci_skin_alternation *a, pc_skin_report *r) {
    pci_skin_measures measures = {0};
    f->paper = paper_problem(f);
    normalize_rows(f);
    if (!pci_skin_alternation_build(scratch, &f->paper, pci_skin_kernel_float(), gram, a)) {
        return pci_fail_memory(f->context, stage);
    }
    pc_status status = pci_skin_alternation_measure(a, PCI_SKIN_SAMPLE, f->weights, &measures);
    report_before(f, &measures, r);
    pci_skin_frames_use(&a->frames, &f->problem);
    if (status == PC_OK) {
        status = pci_skin_alternation_measure(a, PCI_SKIN_SAMPLE, f->weights, &measures);
        balance(f, &measures);
    }
    return status;
}

static pc_status solve(pci_scratch *scratch, pci_skin_fit *f, pci_skin_alternation *a,
                       uint32_t first_rounds, pc_skin_report *r) {
    pci_skin_alternation_follow(a, f->proxy, &f->followed);
    hold_pinned(f, a->allowed);
    normalize_rows(f);
    if (!pci_skin_measure_closest(f)) {
        return pci_fail_memory(f->context, stage);
    }
    pc_release(f->context, f->closest);
    f->closest = NULL;
    pc_status status = weigh(scratch, f, a);
    if (status == PC_OK) {
        status = run_phases(scratch, f, a, first_rounds, r);
    }
    r->rounds = a->rounds;
    r->spatial_share = f->spatial_share;
    if (status == PC_OK) {
        pci_skin_measures measures = {0};
        status = measure(f, a, PCI_SKIN_ALL, &measures);
        report_after(f, &measures, r);
    }
    return status;
}

pc_status pci_skin_fit_alternate(pci_skin_fit *f, pc_skin_report *r) {
    uint32_t first_rounds = (uint32_t)round(first_end * f->options->rounds);
    pci_skin_gram gram;
    pci_skin_alternation a;
    pci_scratch scratch = pci_scratch_begin(f->context);
    pc_status status = pci_skin_gram_build(&scratch, &f->problem, pci_skin_kernel_float(), f->proxy,
                                           f->options->motion_noise, PCI_SKIN_DENSE_MOST, &gram)
                           ? measure_guess(&scratch, f, &gram, &a, r)
                           : pci_fail_memory(f->context, stage);
    if (status == PC_OK) {
        start_from_followed(f);
        hold_pinned(f, NULL);
        normalize_rows(f);
        status = pci_skin_start_from_coarse(f, &gram, &first_rounds);
    }
    if (status == PC_OK) {
        status = solve(&scratch, f, &a, first_rounds, r);
    }
    pci_scratch_end(&scratch);
    return status;
}
