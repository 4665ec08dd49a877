// Based on: Loshchilov, Hutter, "Decoupled weight decay regularization", 2019.
#include "stages/skin/skin_frames.h"

static const char stage[] = "skin";

double pci_skin_normalize(const double *surrogate, uint32_t slots, double *weights) {
    double sum = 0.0;
    for (size_t k = 0; k < slots; ++k) {
        sum += fabs(surrogate[k]);
    }
    for (size_t k = 0; k < slots; ++k) {
        weights[k] = sum > 0.0 ? fabs(surrogate[k]) / sum : 1.0 / (double)slots;
    }
    return sum;
}

typedef struct descent {
    pci_skin_frames w;
    const pci_skin_descent *settings;
    double *weights;                    // #V by slots
    double *surrogate, *first, *second; // #V by slots: s and the moments of its gradient
    // Of the running step:
    double rate;    // learning rate
    double bias[2]; // 1 - beta^t
} descent;

// dL/dw -> dL/ds, one step of AdamW, new weights.
static void update_row(descent *d, size_t v) {
    const uint32_t slots = d->w.problem->slots;
    const double beta[2] = {0.9, 0.999};
    double weights[PCI_SKIN_SLOTS_MAX], gradient[PCI_SKIN_SLOTS_MAX], mean = 0.0;
    double *s = &d->surrogate[v * slots];
    const double sum = pci_skin_normalize(s, slots, weights);
    pci_skin_frames_row(&d->w, v, gradient);
    for (size_t k = 0; k < slots; ++k) {
        mean += weights[k] * gradient[k];
    }
    for (size_t k = 0; k < slots && sum > 0.0; ++k) {
        const double sign = s[k] > 0.0 ? 1.0 : s[k] < 0.0 ? -1.0 : 0.0;
        const double g = sign * (gradient[k] - mean) / sum;
        double *m = &d->first[v * slots + k], *n = &d->second[v * slots + k];
        *m = beta[0] * *m + (1.0 - beta[0]) * g;
        *n = beta[1] * *n + (1.0 - beta[1]) * g * g;
        s[k] *= 1.0 - d->rate * d->settings->weight_decay;
        s[k] -= d->rate / d->bias[0] * *m / (sqrt(*n / d->bias[1]) + d->settings->epsilon);
    }
    pci_skin_normalize(s, slots, &d->weights[v * slots]);
}

static void update_rows(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    for (size_t v = begin; v < end; ++v) {
        update_row(user, v);
    }
}

static void shuffle(uint32_t *items, size_t count, uint32_t seed, uint64_t stream) {
    for (size_t i = count; i > 1; --i) {
        const size_t j = (size_t)(pci_random_bits(seed, stream, i) % i);
        const uint32_t swapped = items[i - 1];
        items[i - 1] = items[j];
        items[j] = swapped;
    }
}

static size_t frames_of_blocks(const pci_skin_frames *w, size_t begin, size_t end) {
    size_t count = 0;
    for (size_t i = begin * PCI_BLOCK; i < end * PCI_BLOCK; ++i) {
        count += w->frames[i] != PC_INVALID_INDEX;
    }
    return count;
}

// All steps; step i of an epoch takes the blocks [i * per_step, (i + 1) * per_step).
static pc_status run_epochs(descent *d, size_t per_step, uint32_t *steps, size_t step_count) {
    const pci_skin_descent *settings = d->settings;
    pci_skin_frames *w = &d->w;
    const double total = (double)settings->epochs * (double)step_count;
    double power[2] = {1.0, 1.0}, done = 0.0;
    for (uint32_t epoch = 0; epoch < settings->epochs; ++epoch) {
        const double share = (double)epoch / (double)settings->epochs;
        if (!pci_progress(w->context, stage,
                          settings->progress_begin +
                              share * (settings->progress_end - settings->progress_begin))) {
            return pci_fail_cancelled(w->context, stage);
        }
        shuffle(steps, step_count, settings->seed, 2 + (uint64_t)epoch);
        for (size_t i = 0; i < step_count; ++i) {
            const size_t begin = steps[i] * per_step;
            const size_t end =
                begin + per_step < w->block_count ? begin + per_step : w->block_count;
            const double frames = (double)frames_of_blocks(w, begin, end);
            for (size_t x = 0; x < 3; ++x) {
                const double norm = w->problem->norms[x] * w->unit * w->unit * frames;
                w->data.scale[x] = norm > 0.0 ? settings->lambda[x] / norm : 0.0;
            }
            power[0] *= 0.9, power[1] *= 0.999;
            d->bias[0] = 1.0 - power[0], d->bias[1] = 1.0 - power[1];
            d->rate = settings->learning_rate;
            if (settings->decay) {
                d->rate *= 0.5 * (1.0 + cos(3.141592653589793 * done / total));
            }
            if (!pci_skin_frames_evaluate(w, d->weights, begin, end, 1, true, NULL)) {
                return pci_fail_cancelled(w->context, stage);
            }
            pci_parallel_for(w->context, w->problem->vertex_count, 256, update_rows, d);
            done += 1.0;
        }
    }
    return PC_OK;
}

pc_status pci_skin_descend(pc_context *context, const pci_skin_problem *problem,
                           const pci_skin_kernel *kernel, const pci_skin_descent *settings,
                           double *surrogate) {
    if (settings->epochs == 0 || problem->frame_count == 0) {
        return PC_OK;
    }
    pci_scratch scratch = pci_scratch_begin(context);
    const size_t nv = problem->vertex_count, count = nv * problem->slots;
    const size_t wanted = settings->batch < PCI_BLOCK ? settings->batch : PCI_BLOCK;
    const size_t block_count = (problem->frame_count + wanted - 1) / wanted;
    const size_t per_step = (settings->batch + PCI_BLOCK - 1) / PCI_BLOCK;
    const size_t step_count = (block_count + per_step - 1) / per_step;
    descent d = {.settings = settings, .surrogate = surrogate};
    uint32_t *order = PCI_SCRATCH(&scratch, uint32_t, problem->frame_count);
    uint32_t *frames = PCI_SCRATCH(&scratch, uint32_t, PCI_BLOCK * block_count);
    uint32_t *steps = PCI_SCRATCH(&scratch, uint32_t, step_count);
    d.weights = PCI_SCRATCH(&scratch, double, count);
    d.first = PCI_SCRATCH(&scratch, double, count);
    d.second = PCI_SCRATCH(&scratch, double, count);
    pc_status status = PC_OK;
    if (scratch.failed) {
        status = pci_fail_memory(context, stage);
        goto cleanup;
    }
    // Batches mix frames of the whole motion.
    for (size_t f = 0; f < problem->frame_count; ++f) {
        order[f] = (uint32_t)f;
    }
    shuffle(order, problem->frame_count, settings->seed, 1);
    memset(frames, 0xff, PCI_BLOCK * block_count * sizeof(*frames));
    for (size_t b = 0; b < block_count; ++b) {
        const size_t begin = b * problem->frame_count / block_count;
        const size_t end = (b + 1) * problem->frame_count / block_count;
        memcpy(&frames[b * PCI_BLOCK], &order[begin], (end - begin) * sizeof(*frames));
    }
    for (size_t i = 0; i < step_count; ++i) {
        steps[i] = (uint32_t)i;
    }
    if (!pci_skin_frames_build(&scratch, problem, kernel, block_count, frames, &d.w) ||
        !pci_skin_frames_make_room(&scratch, &d.w)) {
        status = pci_fail_memory(context, stage);
        goto cleanup;
    }
    for (size_t v = 0; v < nv; ++v) {
        const size_t row = v * problem->slots;
        pci_skin_normalize(&surrogate[row], problem->slots, &d.weights[row]);
    }
    status = run_epochs(&d, per_step, steps, step_count);

cleanup:
    pci_scratch_end(&scratch);
    return status;
}
