// Alternates between rotations and weights.
// Based on: Sorkine, Alexa, "As-rigid-as-possible surface modeling", 2007 (local/global);
// Walker, Ni, "Anderson acceleration for fixed-point iterations", 2011.
#include "stages/skin_alternate.h"

static const char stage[] = "skin";

enum { SWEEPS = 3, SAMPLE_BLOCKS = 2 }; // sweeps per round, each there and back

static const double sample_rounds = 0.75; // of the rounds at most
// Along the last round's; it may have gone too far.
static const double longest_step = 8.0, longest_step_back = 0.5;
static const double followed_share = 0.5; // see skin_alternate.h

typedef struct gram_job {
    const double *columns; // #rows by size
    size_t rows, size;     // size: of the matrix
    double *gram;
} gram_job;

static void fill_gram(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const gram_job *job = user;
    const size_t size = job->size;
    for (size_t t = 0; t < job->rows; ++t) {
        const double *d = &job->columns[t * size];
        for (size_t b = begin; b < end; ++b) {
            double *row = &job->gram[b * size];
            for (size_t c = 0; c < end; ++c) {
                row[c] += d[b] * d[c];
            }
        }
    }
}

// Writes the three rows of A of all bones in one frame, in the unit of the kernels, the mean
// displacement left out as there.
static void fill_rows(const pci_skin_frames *w, size_t frame, double *rows) {
    const pci_skin_problem *p = w->problem;
    const size_t columns = w->data.columns, size = p->proxy_count * columns;
    double map[3 * PCI_SKIN_COLUMNS_MAX], mean[3] = {0};
    for (size_t b = 0; b < p->proxy_count; ++b) {
        pci_skin_bone_map(p, w->origin, frame, b, map);
        for (size_t c = 0; c < 3; ++c) {
            double *row = &rows[c * size + b * columns];
            row[0] = w->unit * map[c];
            mean[c] += row[0] / (double)p->proxy_count;
            for (size_t k = 1; k < columns; ++k) {
                row[k] = map[3 * k + c];
            }
        }
    }
    for (size_t c = 0; c < 3; ++c) {
        for (size_t b = 0; b < p->proxy_count; ++b) {
            rows[c * size + b * columns] -= mean[c];
        }
    }
}

// Adds the noise to G: each bone shifts by as much as a share of the bones' own displacements.
static void add_noise(const pci_skin_frames *w, double share, pci_skin_gram *gram) {
    const pci_skin_problem *p = w->problem;
    const size_t columns = w->data.columns, size = p->proxy_count * columns;
    double sum = 0.0;
    for (size_t b = 0; b < p->proxy_count; ++b) {
        double point[PCI_SKIN_COLUMNS_MAX] = {1.0};
        for (size_t c = 0; c < 3; ++c) {
            point[1 + c] = w->unit * (p->proxy_rest[3 * b + c] - w->origin[c]);
        }
        sum += pci_skin_gram_product(gram->matrix, p->proxy_count, columns, b, b, point, point);
    }
    gram->noise = share * sum / (double)p->proxy_count;
    for (size_t b = 0; b < size; b += columns) {
        gram->matrix[b * size + b] += gram->noise;
    }
}

// G of every so many blocks.
static bool build_gram(pci_scratch *scratch, const pci_skin_frames *w, size_t stride, double noise,
                       pci_skin_gram *gram) {
    const pci_skin_problem *p = w->problem;
    const size_t size = p->proxy_count * w->data.columns;
    gram_job job = {.size = size};
    pci_scratch local = pci_scratch_begin(scratch->context);
    double *columns = PCI_SCRATCH(&local, double, 3 * PCI_BLOCK * w->block_count * size);
    job.gram = PCI_SCRATCH(scratch, double, size *size);
    if (scratch->failed || local.failed) {
        pci_scratch_end(&local);
        return false;
    }
    for (size_t i = 0; i < w->block_count * PCI_BLOCK; ++i) {
        if (i / PCI_BLOCK % stride == 0 && w->frames[i] != PC_INVALID_INDEX) {
            fill_rows(w, w->frames[i], &columns[job.rows * size]);
            job.rows += 3;
        }
    }
    gram->stride = stride;
    gram->factor = 3.0 * (double)p->frame_count / (double)job.rows;
    gram->matrix = job.gram;
    job.columns = columns;
    pci_parallel_for(scratch->context, size, 16, fill_gram, &job);
    for (size_t b = 0; b < size; ++b) {
        for (size_t c = 0; c < b; ++c) {
            job.gram[c * size + b] = job.gram[b * size + c] *= gram->factor;
        }
        job.gram[b * size + b] *= gram->factor;
    }
    add_noise(w, noise, gram);
    pci_scratch_end(&local);
    return true;
}

bool pci_skin_grams_build(pci_scratch *scratch, const pci_skin_problem *problem,
                          const pci_skin_kernel *kernel, double noise,
                          pci_skin_gram grams[PCI_SKIN_LEVELS]) {
    pci_skin_frames w;
    pci_scratch local = pci_scratch_begin(scratch->context);
    pci_skin_frames_begin(scratch->context, problem, kernel, &w);
    w.frames = pci_skin_frames_in_sequence(&local, problem, &w.block_count);
    const size_t stride = (w.block_count + SAMPLE_BLOCKS - 1) / SAMPLE_BLOCKS;
    const bool good = w.frames != NULL && build_gram(scratch, &w, 1, noise, &grams[PCI_SKIN_ALL]) &&
                      build_gram(scratch, &w, stride, noise, &grams[PCI_SKIN_SAMPLE]);
    pci_scratch_end(&local);
    return good;
}

typedef struct row_job {
    pci_skin_alternation *a;
    size_t level;
    double *weights;
    double factor;
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

// Adds the gradient of the noise in all terms but L_f.
static void resist_noise(const pci_skin_alternation *a, double noise, const double *weights,
                         size_t v, double *pulls, double *gradient) {
    const pci_skin_quadratic *q = &a->quadratic;
    const size_t slots = q->slots, followed = a->followed->influences;
    const size_t begin = q->offsets[v], end = q->offsets[v + 1];
    for (size_t e = begin; e < end; ++e) {
        const size_t j = q->columns[e];
        const double m = noise * ((double)q->values[e] - (j == v ? 2.0 * a->follow[v] : 0.0));
        pull_bones(m, slots, &q->bones[j * slots], &weights[j * slots], pulls);
        pull_bones(-followed_share * m, followed, &a->followed->bones[j * followed],
                   &a->followed->weights[j * followed], pulls);
    }
    for (size_t k = 0; k < slots; ++k) {
        gradient[k] += pulls[q->bones[v * slots + k]];
    }
    for (size_t e = begin; e < end; ++e) {
        const size_t j = q->columns[e];
        clear_bones(slots, &q->bones[j * slots], pulls);
        clear_bones(followed, &a->followed->bones[j * followed], pulls);
    }
}

// Adds that of L_f: 2 (G w - G b). `columns` are those of the driver, known where this is compiled.
static inline __attribute__((always_inline)) void follow(const pci_skin_alternation *a,
                                                         size_t level, const double *weights,
                                                         size_t v, const size_t columns,
                                                         double *gradient) {
    const pci_skin_problem *p = a->frames.problem;
    const size_t slots = p->slots;
    const uint32_t *bones = &p->bones[v * slots];
    const double *w = &weights[v * slots], *point = &a->frames.points[v * columns];
    for (size_t k = 0; k < slots; ++k) {
        double sum = -(double)a->targets[level][v * slots + k];
        for (size_t l = 0; l < slots; ++l) {
            sum += w[l] * pci_skin_gram_product(a->grams[level].matrix, p->proxy_count, columns,
                                                bones[k], bones[l], point, point);
        }
        gradient[k] += 2.0 * a->follow[v] * sum;
    }
}

// What is not from the frames.
static void finish_gradient(void *user, size_t begin, size_t end, uint32_t worker) {
    const row_job *job = user;
    pci_skin_alternation *a = job->a;
    const size_t slots = a->frames.problem->slots;
    const double noise = a->grams[job->level].noise;
    for (size_t v = begin; v < end; ++v) {
        double gradient[PCI_SKIN_SLOTS_MAX];
        pci_skin_frames_row(&a->frames, v, gradient);
        if (noise > 0.0) {
            resist_noise(a, noise, job->weights, v,
                         &a->pulls[worker * a->frames.problem->proxy_count], gradient);
        }
        if (a->frames.data.columns == 1) {
            follow(a, job->level, job->weights, v, 1, gradient);
        } else {
            follow(a, job->level, job->weights, v, PCI_SKIN_COLUMNS_MAX, gradient);
        }
        for (size_t k = 0; k < slots; ++k) {
            a->gradient[v * slots + k] = (float)gradient[k];
        }
    }
}

// Lets the solver look at the frames of one level from now on.
static void use_level(pci_skin_alternation *a, size_t level) {
    for (size_t x = 0; x < 4; ++x) {
        a->frames.data.scale[x] = a->scale[x] * a->grams[level].factor;
    }
    pci_skin_quadratic_use(&a->quadratic, a->grams[level].matrix, a->frames.data.slots);
}

// Of all frames, from those of one level.
static void add_measures(const pci_skin_alternation *a, size_t level, pci_skin_measures *measures) {
    pci_skin_frames_add(&a->frames, a->sums, measures, NULL);
    for (size_t x = 0; x < 3; ++x) {
        measures->losses[x] *= a->grams[level].factor;
    }
}

// dE/dW at the given weights, with the best rotations; the gradient before stays. `measures` may be
// NULL. False: cancelled.
static bool find_gradient(pci_skin_alternation *a, size_t level, double *weights,
                          pci_skin_measures *measures) {
    pci_skin_frames *w = &a->frames;
    float *last = a->last_gradient;
    a->last_gradient = a->gradient;
    a->gradient = last;
    use_level(a, level);
    pci_skin_frames_set_weights(w, weights);
    if (!pci_skin_frames_evaluate(w, 0, w->block_count, a->grams[level].stride, true,
                                  measures != NULL ? a->sums : NULL)) {
        return false;
    }
    row_job rows = {.a = a, .level = level, .weights = weights};
    pci_parallel_for(w->context, w->problem->vertex_count, 256, finish_gradient, &rows);
    ++a->rounds;
    if (measures != NULL) {
        add_measures(a, level, measures);
    }
    return true;
}

// How far to go on along the last round's step: to where the gradient would have no part along it,
// were it to change on as it has over that step.
static double step_length(const pci_skin_alternation *a) {
    const size_t count = a->frames.problem->vertex_count * a->frames.problem->slots;
    double slope = 0.0, curvature = 0.0;
    for (size_t k = 0; k < count; ++k) {
        const double step = (double)a->moved[k], gradient = (double)a->gradient[k];
        slope += gradient * step;
        curvature += (gradient - (double)a->last_gradient[k]) * step;
    }
    const double length = curvature > 0.0 ? -slope / curvature : 0.0;
    return length > longest_step         ? longest_step
           : length < -longest_step_back ? -longest_step_back
                                         : length;
}

// W + factor times what has moved, brought back to the simplex; that has moved then.
static void extrapolate(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const row_job *job = user;
    const size_t slots = job->a->frames.problem->slots;
    for (size_t v = begin; v < end; ++v) {
        float *moved = &job->a->moved[v * slots];
        double *weights = &job->weights[v * slots], row[PCI_SKIN_SLOTS_MAX], sum = 0.0;
        for (size_t k = 0; k < slots; ++k) {
            const double w = weights[k] + job->factor * (double)moved[k];
            row[k] = w > 0.0 ? w : 0.0;
            sum += row[k];
        }
        for (size_t k = 0; k < slots; ++k) {
            const double w = job->factor != 0.0 ? row[k] / sum : weights[k];
            moved[k] = (float)(w - weights[k]);
            weights[k] = w;
        }
    }
}

bool pci_skin_alternation_build(pci_scratch *scratch, const pci_skin_problem *problem,
                                const pci_skin_kernel *kernel,
                                const pci_skin_gram grams[PCI_SKIN_LEVELS],
                                pci_skin_alternation *a) {
    const size_t nv = problem->vertex_count, count = nv * problem->slots;
    memset(a, 0, sizeof(*a));
    a->gradient = PCI_SCRATCH(scratch, float, count);
    a->last_gradient = PCI_SCRATCH(scratch, float, count);
    a->moved = PCI_SCRATCH(scratch, float, count);
    a->follow = PCI_SCRATCH(scratch, double, nv);
    a->allowed = PCI_SCRATCH(scratch, uint32_t, nv);
    a->pulls =
        PCI_SCRATCH(scratch, double, problem->proxy_count *pc_context_threads(scratch->context));
    if (scratch->failed ||
        !pci_skin_frames_build_sequential(scratch, problem, kernel, &a->frames)) {
        return false;
    }
    memset(a->allowed, 0xff, nv * sizeof(*a->allowed));
    a->sums = PCI_SCRATCH(scratch, pci_skin_sums, a->frames.patch_count * a->frames.block_count);
    for (size_t level = 0; level < PCI_SKIN_LEVELS; ++level) {
        a->grams[level] = grams[level];
        a->targets[level] = PCI_SCRATCH(scratch, float, count);
    }
    return !scratch->failed;
}

void pci_skin_alternation_follow(pci_skin_alternation *a, const pc_mesh *proxy,
                                 const pc_skin *followed) {
    const pci_skin_problem *p = a->frames.problem;
    a->followed = followed;
    double squares = 0.0;
    for (size_t k = 0; k < 3 * proxy->triangle_count; ++k) {
        const size_t i = proxy->triangles[k];
        const size_t j = proxy->triangles[k % 3 == 2 ? k - 2 : k + 1];
        squares += pci_squared_distance(&proxy->positions[3 * i], &proxy->positions[3 * j]);
    }
    a->spacing = squares / (3.0 * (double)proxy->triangle_count);
    const size_t slots = followed->influences, columns = a->frames.data.columns;
    for (size_t i = 0; i < PCI_SKIN_LEVELS * p->vertex_count; ++i) {
        const size_t v = i % p->vertex_count;
        const double *gram = a->grams[i / p->vertex_count].matrix;
        float *targets = a->targets[i / p->vertex_count];
        const double *point = &a->frames.points[v * columns];
        for (size_t k = v * p->slots; k < (v + 1) * p->slots; ++k) {
            double sum = 0.0;
            for (size_t l = v * slots; l < (v + 1) * slots; ++l) {
                sum += followed->weights[l] * pci_skin_gram_product(gram, p->proxy_count, columns,
                                                                    p->bones[k], followed->bones[l],
                                                                    point, point);
            }
            targets[k] = (float)sum;
        }
    }
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
    const double follow_norm = a->spacing * (double)p->vertex_count;
    for (size_t v = 0; v < p->vertex_count; ++v) {
        a->follow[v] = follow_norm > 0.0 ? lambda_follow / (follow_norm * factor) : 0.0;
    }
    if (a->quadratic.offsets != NULL) {
        return pci_skin_quadratic_weigh(scratch, p, a->scale, a->follow, &a->quadratic);
    }
    return pci_skin_quadratic_build(scratch, p, w->kernel, w->points, a->scale, a->follow,
                                    a->grams[PCI_SKIN_ALL].matrix, a->allowed, &a->quadratic);
}

pc_status pci_skin_alternation_run(pci_skin_alternation *a, uint32_t rounds, double tolerance,
                                   bool rough, double progress_begin, double progress_end,
                                   double *weights) {
    pc_context *context = a->frames.context;
    const size_t nv = a->frames.problem->vertex_count, count = nv * a->frames.problem->slots;
    const uint32_t most = rough ? rounds : (uint32_t)(sample_rounds * rounds);
    bool sampled = a->grams[PCI_SKIN_SAMPLE].stride > 1, same_frames = false;
    row_job job = {.a = a, .weights = weights};
    double lowered = 0.0;
    for (uint32_t round = 0; round < rounds; ++round) {
        const double share = (double)round / (double)rounds;
        if (sampled && round >= most) {
            sampled = same_frames = false;
        }
        if (!pci_progress(context, stage,
                          progress_begin + share * (progress_end - progress_begin)) ||
            !find_gradient(a, sampled ? PCI_SKIN_SAMPLE : PCI_SKIN_ALL, weights, NULL)) {
            return pci_fail_cancelled(context, stage);
        }
        job.factor = same_frames ? step_length(a) : 0.0;
        pci_parallel_for(context, nv, 256, extrapolate, &job);
        for (uint32_t sweep = 0; sweep < SWEEPS; ++sweep) {
            pci_skin_quadratic_sweep(&a->quadratic, a->gradient, sweep % 2 == 1, a->moved, weights);
        }
        // A quadratic function falls by half of what the gradient says on the way to its minimum.
        double fall = 0.0;
        for (size_t k = 0; k < count; ++k) {
            fall -= 0.5 * (double)a->gradient[k] * (double)a->moved[k];
        }
        lowered += fall;
        same_frames = true;
        if (fall <= tolerance * lowered) {
            if (!sampled || rough) {
                break;
            }
            sampled = same_frames = false;
        }
    }
    return PC_OK;
}

pc_status pci_skin_alternation_prune(pci_skin_alternation *a, uint32_t kept, double *weights,
                                     pci_skin_measures *measures) {
    const pci_skin_problem *p = a->frames.problem;
    memset(a->moved, 0, p->vertex_count * p->slots * sizeof(*a->moved));
    if (!find_gradient(a, PCI_SKIN_SAMPLE, weights, measures)) {
        return pci_fail_cancelled(a->frames.context, stage);
    }
    pci_skin_quadratic_prune(&a->quadratic, a->gradient, kept, a->allowed, a->moved, weights);
    return PC_OK;
}

// The slots of a row that stay, in order.
static void choose_slots(uint32_t allowed, const double *weights, uint32_t slots, uint32_t kept,
                         uint32_t *chosen) {
    uint32_t taken = 0;
    for (uint32_t n = 0; n < kept; ++n) {
        uint32_t best = slots;
        for (uint32_t k = 0; k < slots; ++k) {
            const bool open = (taken >> k & 1) == 0;
            if (open &&
                (best == slots || (allowed >> k & 1) > (allowed >> best & 1) ||
                 ((allowed >> k & 1) == (allowed >> best & 1) && weights[k] > weights[best]))) {
                best = k;
            }
        }
        taken |= (uint32_t)1 << best;
    }
    for (uint32_t k = 0, n = 0; k < slots; ++k) {
        if (taken >> k & 1) {
            chosen[n++] = k;
        }
    }
}

void pci_skin_alternation_compact(pci_skin_alternation *a, uint32_t kept, uint32_t *bones,
                                  double *weights) {
    const size_t nv = a->frames.problem->vertex_count;
    const uint32_t slots = a->frames.problem->slots;
    for (size_t v = 0; v < nv; ++v) {
        uint32_t chosen[PCI_SKIN_SLOTS_MAX] = {0};
        double sum = 0.0;
        choose_slots(a->allowed[v], &weights[v * slots], slots, kept, chosen);
        for (uint32_t k = 0; k < kept; ++k) {
            const size_t from = v * slots + chosen[k], to = v * kept + k;
            bones[to] = bones[from];
            weights[to] = weights[from];
            sum += weights[to];
            for (size_t level = 0; level < PCI_SKIN_LEVELS; ++level) {
                a->targets[level][to] = a->targets[level][from];
            }
        }
        if (a->allowed[v] == 0) { // more slots than `kept` may have been held
            for (uint32_t k = 0; k < kept; ++k) {
                weights[v * kept + k] /= sum;
            }
        } else {
            a->allowed[v] = (uint32_t)(((uint64_t)1 << kept) - 1);
        }
    }
    a->frames.data.slots = kept;
    pci_skin_quadratic_use(&a->quadratic, a->quadratic.gram, kept);
}

pc_status pci_skin_alternation_measure(pci_skin_alternation *a, size_t level, const double *weights,
                                       pci_skin_measures *measures) {
    pci_skin_frames *w = &a->frames;
    pci_skin_frames_set_weights(w, weights);
    if (!pci_skin_frames_evaluate(w, 0, w->block_count, a->grams[level].stride, false, a->sums)) {
        return pci_fail_cancelled(w->context, stage);
    }
    add_measures(a, level, measures);
    return PC_OK;
}
