// Alternates between rotations and weights.
// Based on: Sorkine, Alexa, "As-rigid-as-possible surface modeling", 2007 (local/global).
#include "stages/skin/skin_alternate.h"

#include "stages/skin/skin_layers.h"
#include "stages/skin/skin_matrix.h"
#include "stages/skin/skin_secants.h"

static const char stage[] = "skin";

enum { SWEEPS = 2 }; // per round, each there and back
_Static_assert(PCI_SKIN_PATCH % PCI_SKIN_GROUP == 0, "the rows of a group follow one another");

static const double sample_rounds = 0.75; // of the rounds at most
static const double lowered_share = 0.1; // all rounds rarely lower the energy by more of the losses
static const double followed_share = 0.5; // see skin_alternate.h

typedef struct row_job {
    pci_skin_alternation *a;
    double *weights;
} row_job;

// Adds `factor` times a row of weights to the bones it names; or sets those to 0.
static inline void pull_bones(double factor, size_t count, const uint32_t *bones,
                              const double *weights, double *pulls) {
    for (size_t k = 0; k < count; ++k) {
        pulls[bones[k]] += factor * weights[k];
    }
}

static inline void clear_bones(size_t count, const uint32_t *bones, double *pulls) {
    for (size_t k = 0; k < count; ++k) {
        pulls[bones[k]] = 0.0;
    }
}

// The gradient of the noise in all terms but L_f and L_s, for weights of `count` slots: `sums` of
// the row of a member.
static void resist_noise(const pci_skin_alternation *a, size_t member, size_t count,
                         const uint32_t *bones, const double *weights, double *pulls,
                         double *sums) {
    const pci_skin_quadratic *q = &a->quadratic;
    const uint32_t *known = &q->known[q->known_offsets[member / PCI_SKIN_GROUP]];
    const pci_skin_problem *p = a->frames.problem;
    const double noise = a->gram->noise;
    const size_t v = q->members[member], ring = p->ring_offsets[v + 1] - p->ring_offsets[v];
    const size_t begin = q->offsets[member], end = q->offsets[member + 1];
    const double stretch = 4.0 * (pci_skin_ring_scale(a->scale) - a->scale[0]);
    double diagonal = (double)q->values[begin] - 2.0 * a->follow;
    for (size_t e = begin + 1; e < end; ++e) {
        const size_t j = known[q->entries[e]];
        const double spring = e <= begin + ring ? stretch * pci_skin_stiffness(p, v, j) : 0.0;
        diagonal -= spring;
        pull_bones(noise * ((double)q->values[e] + spring), count, &bones[j * count],
                   &weights[j * count], pulls);
    }
    pull_bones(noise * diagonal, count, &bones[v * count], &weights[v * count], pulls);
    for (size_t k = 0; k < q->slots; ++k) {
        sums[k] = pulls[q->bones[v * q->slots + k]];
    }
    for (size_t e = begin; e < end; ++e) {
        clear_bones(count, &bones[known[q->entries[e]] * count], pulls);
    }
}

// G w of a row, for weights of `count` slots. `columns` are those of the driver, known where this
// is compiled.
static inline __attribute__((always_inline)) double
multiply_gram(const pci_skin_alternation *a, size_t v, uint32_t bone, size_t count,
              const uint32_t *bones, const double *weights, const size_t columns) {
    const double *point = &a->frames.points[pci_skin_point_at(v, columns)];
    double sum = 0.0;
    for (size_t l = 0; l < count; ++l) {
        sum += weights[l] *
               (a->gram->matrix != NULL
                    ? pci_skin_gram_product(a->gram->matrix, a->frames.problem->proxy_count,
                                            columns, bone, bones[l], point, point)
                    : pci_skin_pairs_product(&a->pairs, columns, bone, bones[l], point, point));
    }
    return sum;
}

// Adds the gradient of L_f without its constant part: 2 G w.
static inline __attribute__((always_inline)) void follow(const pci_skin_alternation *a,
                                                         const double *weights, size_t v,
                                                         const size_t columns, double *gradient) {
    const size_t slots = a->frames.problem->slots;
    const uint32_t *bones = &a->frames.problem->bones[v * slots];
    for (size_t k = 0; k < slots; ++k) {
        gradient[k] += 2.0 * a->follow *
                       multiply_gram(a, v, bones[k], slots, bones, &weights[v * slots], columns);
    }
}

// Adds the gradient of L_l: 2 G sum_j T_ij w_j, all at x^ of the row.
static void keep_layers(const pci_skin_alternation *a, size_t v, const double *weights,
                        double *pulls, double *gradient) {
    enum { TAKEN = 64 }; // bones at a time
    const pci_skin_problem *p = a->frames.problem;
    const pci_skin_layers *layers = p->layers;
    const size_t slots = p->slots, begin = layers->offsets[v], end = layers->offsets[v + 1];
    uint32_t bones[TAKEN];
    double sums[TAKEN];
    size_t count = 0;
    for (size_t e = begin; e < end; ++e) {
        const size_t j = slots * layers->columns[e];
        pull_bones(2.0 * layers->factor * layers->values[e], slots, &p->bones[j], &weights[j],
                   pulls);
    }
    for (size_t i = 0; i < slots * (end - begin); ++i) {
        const uint32_t bone = p->bones[slots * layers->columns[begin + i / slots] + i % slots];
        if (pulls[bone] != 0.0) {
            bones[count] = bone;
            sums[count++] = pulls[bone];
            pulls[bone] = 0.0;
        }
        if (count == TAKEN || i + 1 == slots * (end - begin)) {
            for (size_t k = 0; k < slots; ++k) {
                gradient[k] += multiply_gram(a, v, p->bones[v * slots + k], count, bones, sums,
                                             a->frames.data.columns);
            }
            count = 0;
        }
    }
}

// What is not from the frames, of the members of some groups.
static void finish_gradient(void *user, size_t begin, size_t end, uint32_t worker) {
    const row_job *job = user;
    pci_skin_alternation *a = job->a;
    const pci_skin_problem *p = a->frames.problem;
    const pci_skin_quadratic *q = &a->quadratic;
    const size_t slots = p->slots;
    for (size_t m = pci_skin_group_begin(q, begin); m < pci_skin_group_begin(q, end); ++m) {
        const size_t v = q->members[m];
        double gradient[PCI_SKIN_SLOTS_MAX], resisted[PCI_SKIN_SLOTS_MAX] = {0};
        pci_skin_frames_row(&a->frames, v, gradient);
        if (a->gram->noise > 0.0) {
            resist_noise(a, m, slots, p->bones, job->weights, &a->pulls[worker * p->proxy_count],
                         resisted);
        }
        if (p->layers != NULL) {
            keep_layers(a, v, job->weights, &a->pulls[worker * p->proxy_count], gradient);
        }
        if (a->frames.data.columns == 1) {
            follow(a, job->weights, v, 1, gradient);
        } else {
            follow(a, job->weights, v, PCI_SKIN_COLUMNS_MAX, gradient);
        }
        float *row = &a->gradient[m / PCI_SKIN_GROUP][m % PCI_SKIN_GROUP * slots];
        for (size_t k = 0; k < slots; ++k) {
            row[k] = (float)(gradient[k] + resisted[k] - (double)a->constants[v * slots + k]);
        }
    }
}

static void find_constants(void *user, size_t begin, size_t end, uint32_t worker) {
    const row_job *job = user;
    pci_skin_alternation *a = job->a;
    const pci_skin_problem *p = a->frames.problem;
    const pci_skin_quadratic *q = &a->quadratic;
    const pc_skin *b = a->followed;
    const size_t slots = p->slots, count = b->influences, columns = a->frames.data.columns;
    for (size_t m = pci_skin_group_begin(q, begin); m < pci_skin_group_begin(q, end); ++m) {
        const size_t v = q->members[m];
        double resisted[PCI_SKIN_SLOTS_MAX] = {0};
        if (a->gram->noise > 0.0) {
            resist_noise(a, m, count, b->bones, b->weights, &a->pulls[worker * p->proxy_count],
                         resisted);
        }
        for (size_t k = v * slots; k < (v + 1) * slots; ++k) {
            const double product = multiply_gram(a, v, p->bones[k], count, &b->bones[v * count],
                                                 &b->weights[v * count], columns);
            a->constants[k] =
                (float)(2.0 * a->follow * product + followed_share * resisted[k % slots]);
        }
    }
}

// Lets the solver look at the frames of one level from now on.
static void use_level(pci_skin_alternation *a, pci_skin_level level) {
    for (size_t x = 0; x < 4; ++x) {
        a->frames.data.scale[x] = a->scale[x] * a->gram->levels[level].factor;
    }
    if (a->level != level) {
        a->level = level;
        pci_skin_gram_use(a->gram, level, a->gram->matrix == NULL ? &a->pairs : NULL);
        pci_skin_quadratic_use(&a->quadratic, a->frames.problem->slots);
        if (a->followed != NULL) {
            row_job job = {.a = a};
            pci_parallel_for(a->frames.context, a->quadratic.group_count, 4, find_constants, &job);
        }
    }
}

// Of all frames, from those of one level.
static void add_measures(const pci_skin_alternation *a, pci_skin_level level,
                         pci_skin_measures *measures) {
    pci_skin_frames_add(&a->frames, a->measures, measures);
    for (size_t x = 0; x < 3; ++x) {
        measures->losses[x] *= a->gram->levels[level].factor;
    }
}

// dE/dW at the given weights, with the best rotations. `measures` may be NULL. False: cancelled.
static bool find_gradient(pci_skin_alternation *a, pci_skin_level level, double *weights,
                          pci_skin_measures *measures) {
    pci_skin_frames *w = &a->frames;
    use_level(a, level);
    if (!pci_skin_frames_evaluate(w, weights, 0, w->block_count, a->gram->levels[level].stride,
                                  true, measures != NULL ? a->measures : NULL)) {
        return false;
    }
    row_job rows = {.a = a, .weights = weights};
    for (uint32_t g = 0; g < a->quadratic.group_count; ++g) {
        a->gradient[g] = pci_skin_frames_own_row(w, pci_skin_group_begin(&a->quadratic, g));
    }
    pci_parallel_for(w->context, a->quadratic.group_count, 4, finish_gradient, &rows);
    ++a->rounds;
    if (measures != NULL) {
        add_measures(a, level, measures);
    }
    return true;
}

// <dE/dW, what has moved>.
static double slope_of_step(const pci_skin_alternation *a) {
    const size_t slots = a->frames.problem->slots;
    double slope = 0.0;
    for (size_t m = 0; m < a->quadratic.vertex_count; ++m) {
        const float *gradient = &a->gradient[m / PCI_SKIN_GROUP][m % PCI_SKIN_GROUP * slots];
        const float *moved = &a->moved[a->quadratic.members[m] * slots];
        for (size_t k = 0; k < slots; ++k) {
            slope += (double)gradient[k] * (double)moved[k];
        }
    }
    return slope;
}

bool pci_skin_alternation_build(pci_scratch *scratch, const pci_skin_problem *problem,
                                const pci_skin_kernel *kernel, pci_skin_gram *gram,
                                pci_skin_alternation *a) {
    const size_t nv = problem->vertex_count;
    memset(a, 0, sizeof(*a));
    a->gram = gram;
    a->remembered = PCI_SKIN_SECANTS;
    a->level = PCI_SKIN_LEVELS;
    a->gradient = PCI_SCRATCH(scratch, float *, nv / PCI_SKIN_GROUP + 1);
    a->allowed = PCI_SCRATCH(scratch, uint32_t, nv);
    a->pulls =
        PCI_SCRATCH(scratch, double, problem->proxy_count *pc_context_threads(scratch->context));
    if (scratch->failed ||
        !pci_skin_frames_build_sequential(scratch, problem, kernel, &a->frames)) {
        return false;
    }
    memset(a->allowed, 0xff, nv * sizeof(*a->allowed));
    a->measures = PCI_SCRATCH(scratch, pci_skin_measures, a->frames.patch_count);
    return !scratch->failed;
}

void pci_skin_alternation_follow(pci_skin_alternation *a, const pc_mesh *proxy,
                                 const pc_skin *followed) {
    double squares = 0.0;
    for (size_t k = 0; k < 3 * proxy->triangle_count; ++k) {
        const size_t i = proxy->triangles[k];
        const size_t j = proxy->triangles[k % 3 == 2 ? k - 2 : k + 1];
        squares += pci_squared_distance(&proxy->positions[3 * i], &proxy->positions[3 * j]);
    }
    a->spacing = squares / (3.0 * (double)proxy->triangle_count);
    a->followed = followed;
    a->level = PCI_SKIN_LEVELS;
}

bool pci_skin_alternation_weigh(pci_scratch *scratch, pci_skin_alternation *a,
                                const double lambda[4], double lambda_follow) {
    pci_skin_frames *w = &a->frames;
    const pci_skin_problem *p = w->problem;
    const double factor = w->unit * w->unit * (double)p->frame_count;
    for (size_t x = 0; x < 4; ++x) {
        const double norm = p->norms[x % 3] * factor; // L_s has that of L_r
        a->scale[x] = norm > 0.0 ? lambda[x] / norm : 0.0;
    }
    if (p->layers != NULL) {
        const double norm = p->norms[0] * factor; // likewise
        p->layers->factor = norm > 0.0 ? p->layers->lambda / norm : 0.0;
    }
    a->level = PCI_SKIN_LEVELS;
    const double follow_norm = a->spacing * (double)p->vertex_count;
    a->follow = follow_norm > 0.0 ? lambda_follow / (follow_norm * factor) : 0.0;
    if (a->quadratic.offsets != NULL) {
        return pci_skin_quadratic_weigh(scratch, p, a->scale, a->follow, &a->quadratic);
    }
    // Only now: problems that are measured first, and solved after smaller ones, need none of it.
    a->moved = PCI_SCRATCH(scratch, float, p->vertex_count * p->slots);
    a->constants = PCI_SCRATCH(scratch, float, p->vertex_count * p->slots);
    if (scratch->failed || !pci_skin_frames_make_room(scratch, w) ||
        !pci_skin_quadratic_build(scratch, p, w->kernel, w->points, a->scale, a->follow,
                                  a->gram->matrix, a->allowed, &a->quadratic)) {
        return false;
    }
    a->quadratic.pairs = &a->pairs;
    return a->gram->matrix != NULL ||
           pci_skin_pairs_build(scratch, &a->quadratic, a->followed, &a->pairs);
}

static pc_status run_rounds(pci_skin_alternation *a, pci_skin_secants *secants, uint32_t rounds,
                            double tolerance, bool rough, double progress_begin,
                            double progress_end, double *weights) {
    const uint32_t most = rough ? rounds : (uint32_t)(sample_rounds * rounds);
    bool sampled = a->gram->levels[PCI_SKIN_SAMPLE].stride > 1;
    double lowered = 0.0;
    for (uint32_t round = 0; round < rounds; ++round) {
        const double share = (double)round / (double)rounds;
        if (sampled && round >= most) {
            sampled = false;
            pci_skin_secants_interrupt(secants);
        }
        if (!pci_progress(a->frames.context, stage,
                          progress_begin + share * (progress_end - progress_begin)) ||
            !find_gradient(a, sampled ? PCI_SKIN_SAMPLE : PCI_SKIN_ALL, weights, NULL)) {
            return pci_fail_cancelled(a->frames.context, stage);
        }
        double fall = pci_skin_secants_step(secants, a->gradient, a->moved, weights);
        pci_skin_quadratic_sweep(&a->quadratic, a->gradient, SWEEPS, a->moved, weights);
        // A quadratic function falls by half of what the gradient says on the way to its minimum.
        fall -= 0.5 * slope_of_step(a);
        lowered += fall;
        if (fall <= tolerance * (a->losses > 0.0 ? a->losses : lowered_share * lowered)) {
            if (!sampled || rough) {
                break;
            }
            sampled = false;
            pci_skin_secants_interrupt(secants);
        }
    }
    return PC_OK;
}

pc_status pci_skin_alternation_run(pci_skin_alternation *a, uint32_t rounds, double tolerance,
                                   bool rough, double progress_begin, double progress_end,
                                   double *weights) {
    pci_scratch scratch = pci_scratch_begin(a->frames.context);
    pci_skin_secants secants;
    const pc_status status =
        pci_skin_secants_build(&scratch, &a->quadratic, a->remembered, &secants)
            ? run_rounds(a, &secants, rounds, tolerance, rough, progress_begin, progress_end,
                         weights)
            : pci_fail_memory(a->frames.context, stage);
    pci_scratch_end(&scratch);
    return status;
}

pc_status pci_skin_alternation_prune(pci_skin_alternation *a, uint32_t kept, double *weights,
                                     pci_skin_measures *measures) {
    const pci_skin_problem *p = a->frames.problem;
    memset(a->moved, 0, p->vertex_count * p->slots * sizeof(*a->moved));
    if (!find_gradient(a, PCI_SKIN_SAMPLE, weights, measures)) {
        return pci_fail_cancelled(a->frames.context, stage);
    }
    a->losses = 0.0;
    for (size_t x = 0; x < 3; ++x) {
        a->losses += a->scale[x] * a->frames.unit * a->frames.unit * measures->losses[x];
    }
    pci_skin_quadratic_prune(&a->quadratic, a->gradient, kept, a->allowed, a->moved, weights);
    return PC_OK;
}

// Bits of the slots with most weight.
static uint32_t heaviest_slots(const double *weights, uint32_t slots, uint32_t kept) {
    uint32_t taken = 0;
    for (uint32_t n = 0; n < kept; ++n) {
        uint32_t best = slots;
        for (uint32_t k = 0; k < slots; ++k) {
            if ((taken >> k & 1) == 0 && (best == slots || weights[k] > weights[best])) {
                best = k;
            }
        }
        taken |= (uint32_t)1 << best;
    }
    return taken;
}

void pci_skin_alternation_compact(pci_skin_alternation *a, uint32_t kept, uint32_t *bones,
                                  double *weights) {
    const size_t nv = a->frames.problem->vertex_count;
    const uint32_t slots = a->frames.problem->slots;
    for (size_t v = 0; v < nv; ++v) {
        double sum = 0.0;
        // Held rows may have more than `kept`; the others are pruned.
        uint32_t left =
            a->allowed[v] != 0 ? a->allowed[v] : heaviest_slots(&weights[v * slots], slots, kept);
        for (uint32_t k = 0; k < kept; ++k, left &= left - 1) {
            const size_t from = v * slots + (uint32_t)__builtin_ctz(left), to = v * kept + k;
            bones[to] = bones[from];
            weights[to] = weights[from];
            sum += weights[to];
            a->constants[to] = a->constants[from];
        }
        if (a->allowed[v] == 0) {
            for (uint32_t k = 0; k < kept; ++k) {
                weights[v * kept + k] /= sum;
            }
        } else {
            a->allowed[v] = (uint32_t)(((uint64_t)1 << kept) - 1);
        }
    }
    a->frames.data.slots = kept;
    pci_skin_quadratic_use(&a->quadratic, kept);
}

pc_status pci_skin_alternation_measure(pci_skin_alternation *a, pci_skin_level level,
                                       const double *weights, pci_skin_measures *measures) {
    pci_skin_frames *w = &a->frames;
    if (!pci_skin_frames_evaluate(w, weights, 0, w->block_count, a->gram->levels[level].stride,
                                  false, a->measures)) {
        return pci_fail_cancelled(w->context, stage);
    }
    add_measures(a, level, measures);
    return PC_OK;
}
