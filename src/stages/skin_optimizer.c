// Runs the kernels over blocks of frames: losses, gradients, AdamW.
// Based on: Loshchilov, Hutter, "Decoupled weight decay regularization", 2019.
#include "core/topology.h"
#include "stages/skin_internal.h"

static const char stage[] = "skin";

enum { PIECE = 64 }; // vertices per piece of a parallel loop

// A problem in the layout of the kernels.
typedef struct workspace {
    pc_context *context;
    const pci_skin_problem *problem;
    const pci_skin_kernel *kernel;
    pci_skin_data data;
    size_t block_count;
    const uint32_t *frames; // #blocks by PCI_BLOCK, PC_INVALID_INDEX where a block is not full
    char *drivers;          // #blocks, see pci_skin_data
    char *quaternions;
    size_t driver_size, quaternion_size; // bytes per block
    double unit;                         // lengths are multiplied by this
} workspace;

// ---- conversion ---------------------------------------------------------------------------------

static void *allocate_reals(pci_scratch *scratch, const pci_skin_kernel *kernel, size_t count) {
    // Registers are at most 64 bytes wide.
    char *memory = pci_scratch_allocate(scratch, count * kernel->real_size + 64, 1);
    return memory == NULL ? NULL : memory + (64 - (uintptr_t)memory % 64) % 64;
}

static void put(const pci_skin_kernel *kernel, void *array, size_t index, double value) {
    if (kernel->real_size == sizeof(float)) {
        ((float *)array)[index] = (float)value;
    } else {
        ((double *)array)[index] = value;
    }
}

static double get(const pci_skin_kernel *kernel, const void *array, size_t index) {
    return kernel->real_size == sizeof(float) ? (double)((const float *)array)[index]
                                              : ((const double *)array)[index];
}

// Edge vectors and per-vertex constants of one neighbourhood.
static bool convert_edges(pci_scratch *scratch, const workspace *w, const size_t *offsets,
                          const uint32_t *targets, pci_skin_edges *edges) {
    const size_t nv = w->problem->vertex_count;
    void *vectors = allocate_reals(scratch, w->kernel, 3 * offsets[nv]);
    void *constants = allocate_reals(scratch, w->kernel, 13 * nv);
    if (scratch->failed) {
        return false;
    }
    for (size_t v = 0; v < nv; ++v) {
        double constant[13] = {0}, squares = 0.0;
        for (size_t k = offsets[v]; k < offsets[v + 1]; ++k) {
            double e[3];
            pci_sub(&w->problem->rest[3 * v], &w->problem->rest[3 * (size_t)targets[k]], e);
            for (size_t a = 0; a < 3; ++a) {
                e[a] *= w->unit;
                put(w->kernel, vectors, 3 * k + a, e[a]);
            }
            for (size_t a = 0; a < 3; ++a) {
                for (size_t b = 0; b < 3; ++b) {
                    constant[3 * a + b] += e[a] * e[b];
                }
                constant[9 + a] += e[a];
            }
            squares += pci_dot(e, e);
        }
        constant[12] = squares > 1e-30 ? 1.0 / squares : 0.0;
        for (size_t k = 0; k < 13; ++k) {
            put(w->kernel, constants, 13 * v + k, constant[k]);
        }
    }
    edges->offsets = offsets;
    edges->targets = targets;
    edges->vectors = vectors;
    edges->constants = constants;
    return true;
}

// K(i) as edges, and the same edges listed by their target.
static bool convert_near(pci_scratch *scratch, workspace *w) {
    const pci_skin_problem *p = w->problem;
    const size_t nv = p->vertex_count, k = p->near_count;
    size_t *offsets = PCI_SCRATCH(scratch, size_t, nv + 1);
    size_t *incoming_offsets = PCI_SCRATCH(scratch, size_t, nv + 2);
    uint32_t *incoming = PCI_SCRATCH(scratch, uint32_t, k * nv);
    void *near_weights = allocate_reals(scratch, w->kernel, k * nv);
    void *attachment = allocate_reals(scratch, w->kernel, 3 * nv);
    void *incoming_vectors = allocate_reals(scratch, w->kernel, 3 * k * nv);
    void *incoming_weights = allocate_reals(scratch, w->kernel, k * nv);
    if (scratch->failed) {
        return false;
    }
    for (size_t v = 0; v < nv; ++v) {
        offsets[v + 1] = k * (v + 1);
        double a[3] = {p->rest[3 * v], p->rest[3 * v + 1], p->rest[3 * v + 2]};
        for (size_t e = k * v; e < k * v + k; ++e) {
            const double *target = &p->rest[3 * (size_t)p->near[e]];
            put(w->kernel, near_weights, e, p->near_weights[e]);
            ++incoming_offsets[p->near[e] + 2];
            for (size_t c = 0; c < 3; ++c) {
                a[c] -= p->near_weights[e] * target[c];
            }
        }
        for (size_t c = 0; c < 3; ++c) {
            put(w->kernel, attachment, 3 * v + c, w->unit * a[c]);
        }
    }
    // Counting sort; while it runs, incoming_offsets[i + 1] is where the next source of i goes.
    for (size_t v = 0; v < nv; ++v) {
        incoming_offsets[v + 2] += incoming_offsets[v + 1];
    }
    for (size_t e = 0; e < k * nv; ++e) {
        const size_t source = e / k, target = p->near[e], at = incoming_offsets[target + 1]++;
        incoming[at] = (uint32_t)source;
        put(w->kernel, incoming_weights, at, p->near_weights[e]);
        for (size_t c = 0; c < 3; ++c) {
            put(w->kernel, incoming_vectors, 3 * at + c,
                w->unit * (p->rest[3 * target + c] - p->rest[3 * source + c]));
        }
    }
    w->data.near_weights = near_weights;
    w->data.attachment_rest = attachment;
    w->data.incoming_offsets = incoming_offsets;
    w->data.incoming = incoming;
    w->data.incoming_vectors = incoming_vectors;
    w->data.incoming_weights = incoming_weights;
    return convert_edges(scratch, w, offsets, p->near, &w->data.near);
}

// Displacements of the proxy, frames innermost. In float the mean displacement of each frame is
// left out: no loss depends on it, and smaller numbers keep more digits.
static void fill_driver(const workspace *w, size_t block) {
    const pci_skin_problem *p = w->problem;
    const bool centred = w->kernel->real_size == sizeof(float);
    void *driver = w->drivers + block * w->driver_size;
    for (size_t lane = 0; lane < PCI_BLOCK; ++lane) {
        const uint32_t f = w->frames[block * PCI_BLOCK + lane];
        if (f == PC_INVALID_INDEX) {
            continue; // stays at rest and adds no gradient
        }
        const double *frame = &p->frames[3 * p->proxy_count * f];
        double mean[3] = {0};
        for (size_t k = 0; k < 3 * p->proxy_count && centred; ++k) {
            mean[k % 3] += (frame[k] - p->proxy_rest[k]) / (double)p->proxy_count;
        }
        for (size_t k = 0; k < 3 * p->proxy_count; ++k) {
            put(w->kernel, driver, k * PCI_BLOCK + lane,
                w->unit * (frame[k] - p->proxy_rest[k] - mean[k % 3]));
        }
    }
}

// `frames`: #blocks by PCI_BLOCK, the frames of each block, PC_INVALID_INDEX where it is not full.
// `kept_blocks`: 1 to hold one block at a time, block_count to hold all.
static bool build_workspace(pci_scratch *scratch, const pci_skin_problem *problem,
                            const pci_skin_kernel *kernel, size_t block_count,
                            const uint32_t *frames, size_t kept_blocks, workspace *w) {
    const size_t nv = problem->vertex_count;
    memset(w, 0, sizeof(*w));
    w->context = scratch->context;
    w->problem = problem;
    w->kernel = kernel;
    w->block_count = block_count;
    w->unit = 1.0;
    if (kernel->real_size == sizeof(float)) {
        const pc_mesh points = {.vertex_count = nv, .positions = (double *)problem->rest};
        double low[3], high[3];
        pci_bounding_box(&points, low, high);
        const double diagonal = sqrt(pci_squared_distance(low, high));
        w->unit = diagonal > 0.0 ? 1.0 / diagonal : 1.0;
    }
    w->data.slots = problem->slots;
    w->data.bones = problem->bones;
    w->driver_size = 3 * PCI_BLOCK * problem->proxy_count * kernel->real_size;
    w->quaternion_size = 8 * PCI_BLOCK * nv * kernel->real_size;
    w->frames = frames;
    w->drivers =
        allocate_reals(scratch, kernel, block_count * 3 * PCI_BLOCK * problem->proxy_count);
    w->quaternions = allocate_reals(scratch, kernel, kept_blocks * 8 * PCI_BLOCK * nv);
    w->data.weights = allocate_reals(scratch, kernel, nv * problem->slots);
    w->data.displacements = allocate_reals(scratch, kernel, 3 * PCI_BLOCK * nv);
    w->data.rotations = allocate_reals(scratch, kernel, 18 * PCI_BLOCK * nv);
    w->data.residuals = allocate_reals(scratch, kernel, 6 * PCI_BLOCK * nv);
    w->data.gradient = allocate_reals(scratch, kernel, nv * problem->slots);
    if (scratch->failed ||
        !convert_edges(scratch, w, problem->ring_offsets, problem->ring, &w->data.ring) ||
        !convert_near(scratch, w)) {
        return false;
    }
    for (size_t b = 0; b < block_count; ++b) {
        fill_driver(w, b);
    }
    return true;
}

static void use_block(workspace *w, size_t block, size_t kept) {
    w->data.driver = w->drivers + block * w->driver_size;
    w->data.quaternions = w->quaternions + kept * w->quaternion_size;
}

// ---- losses and gradient of all frames ---------------------------------------------------------

typedef struct pass_job {
    workspace *w;
    pci_skin_sums *sums; // per piece, or NULL
} pass_job;

static void displace_piece(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const pass_job *job = user;
    job->w->kernel->displace(&job->w->data, begin, end);
}

static void fit_piece(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const pass_job *job = user;
    job->w->kernel->fit(&job->w->data, begin, end,
                        job->sums != NULL ? &job->sums[begin / PIECE] : NULL);
}

static void gradient_piece(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const pass_job *job = user;
    job->w->kernel->gradient(&job->w->data, begin, end);
}

static void run_pass(workspace *w, pci_parallel_body body, pci_skin_sums *sums) {
    pass_job job = {.w = w, .sums = sums};
    pci_parallel_for(w->context, w->problem->vertex_count, PIECE, body, &job);
}

// A workspace with room for one block. Each lane walks through consecutive frames from block to
// block, so the rotations of a frame are a good guess for the next.
static bool build_sequential(pci_scratch *scratch, const pci_skin_problem *problem,
                             const pci_skin_kernel *kernel, const double *weights, workspace *w) {
    const size_t frame_count = problem->frame_count;
    const size_t block_count = (frame_count + PCI_BLOCK - 1) / PCI_BLOCK;
    uint32_t *order = PCI_SCRATCH(scratch, uint32_t, PCI_BLOCK * block_count);
    if (order == NULL) {
        return false;
    }
    for (size_t b = 0; b < block_count; ++b) {
        for (size_t lane = 0; lane < PCI_BLOCK; ++lane) {
            const size_t f = lane * block_count + b;
            order[b * PCI_BLOCK + lane] = f < frame_count ? (uint32_t)f : PC_INVALID_INDEX;
        }
    }
    if (!build_workspace(scratch, problem, kernel, block_count, order, 1, w)) {
        return false;
    }
    for (size_t i = 0; i < problem->vertex_count * problem->slots; ++i) {
        put(kernel, (void *)w->data.weights, i, weights[i]);
    }
    return true;
}

pc_status pci_skin_measure(pc_context *context, const pci_skin_problem *problem,
                           const pci_skin_kernel *kernel, const double *weights,
                           pci_skin_measures *measures, double *per_frame) {
    pci_scratch scratch = pci_scratch_begin(context);
    workspace w;
    pc_status status = PC_OK;
    const size_t pieces = (problem->vertex_count + PIECE - 1) / PIECE;
    pci_skin_sums *sums = PCI_SCRATCH(&scratch, pci_skin_sums, pieces);
    memset(measures, 0, sizeof(*measures));
    if (scratch.failed || !build_sequential(&scratch, problem, kernel, weights, &w)) {
        status = pci_fail_memory(context, stage);
    }
    for (size_t b = 0; status == PC_OK && b < w.block_count; ++b) {
        if (!pci_keep_going(context)) {
            status = pci_fail_cancelled(context, stage);
            break;
        }
        use_block(&w, b, 0);
        memset(sums, 0, pieces * sizeof(*sums));
        run_pass(&w, displace_piece, NULL);
        run_pass(&w, fit_piece, sums);
        for (size_t lane = 0; lane < PCI_BLOCK; ++lane) {
            const uint32_t f = w.frames[b * PCI_BLOCK + lane];
            if (f == PC_INVALID_INDEX) {
                continue;
            }
            double losses[3] = {0};
            for (size_t i = 0; i < pieces; ++i) {
                losses[0] += sums[i].rigid[lane];
                losses[1] += sums[i].collision[lane];
                losses[2] += sums[i].attachment[lane];
                measures->reflections += sums[i].reflections[lane];
            }
            for (size_t x = 0; x < 3; ++x) {
                losses[x] /= w.unit * w.unit;
                measures->losses[x] += losses[x];
                if (per_frame != NULL) {
                    per_frame[3 * (size_t)f + x] = losses[x];
                }
            }
        }
    }
    pci_scratch_end(&scratch);
    return status;
}

pc_status pci_skin_gradient(pc_context *context, const pci_skin_problem *problem,
                            const pci_skin_kernel *kernel, const double *weights,
                            const double scale[3], double *gradient) {
    pci_scratch scratch = pci_scratch_begin(context);
    workspace w;
    pc_status status = PC_OK;
    if (!build_sequential(&scratch, problem, kernel, weights, &w)) {
        status = pci_fail_memory(context, stage);
    } else {
        for (size_t x = 0; x < 3; ++x) {
            w.data.scale[x] = scale[x] / (w.unit * w.unit);
        }
        for (size_t b = 0; b < w.block_count; ++b) {
            use_block(&w, b, 0);
            run_pass(&w, displace_piece, NULL);
            run_pass(&w, fit_piece, NULL);
            run_pass(&w, gradient_piece, NULL);
        }
        for (size_t i = 0; i < problem->vertex_count * problem->slots; ++i) {
            gradient[i] = get(kernel, w.data.gradient, i);
        }
    }
    pci_scratch_end(&scratch);
    return status;
}

// ---- AdamW -------------------------------------------------------------------------------------

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
    workspace w;
    const pci_skin_descent *settings;
    double *surrogate, *first, *second; // #V by slots: s and the moments of its gradient
    // Of the running step:
    bool update;    // the gradient is complete
    double rate;    // learning rate
    double bias[2]; // 1 - beta^t
} descent;

enum { SLOTS_MAX = 64 };

// dL/dw -> dL/ds, one step of AdamW, new weights.
static void update_row(descent *d, size_t v) {
    const uint32_t slots = d->w.problem->slots;
    const pci_skin_kernel *kernel = d->w.kernel;
    const double beta[2] = {0.9, 0.999};
    double weights[SLOTS_MAX], gradient[SLOTS_MAX], mean = 0.0;
    double *s = &d->surrogate[v * slots];
    const double sum = pci_skin_normalize(s, slots, weights);
    for (size_t k = 0; k < slots; ++k) {
        gradient[k] = get(kernel, d->w.data.gradient, v * slots + k);
        put(kernel, d->w.data.gradient, v * slots + k, 0.0);
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
    pci_skin_normalize(s, slots, weights);
    for (size_t k = 0; k < slots; ++k) {
        put(kernel, (void *)d->w.data.weights, v * slots + k, weights[k]);
    }
}

// Gradient of a block; at the end of a batch the step as well.
static void finish_piece(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    descent *d = user;
    d->w.kernel->gradient(&d->w.data, begin, end);
    for (size_t v = begin; v < end && d->update; ++v) {
        update_row(d, v);
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

static size_t frames_of_blocks(const workspace *w, size_t begin, size_t end) {
    size_t count = 0;
    for (size_t i = begin * PCI_BLOCK; i < end * PCI_BLOCK; ++i) {
        count += w->frames[i] != PC_INVALID_INDEX;
    }
    return count;
}

// All steps; step i of an epoch takes the blocks [i * per_step, (i + 1) * per_step).
static pc_status run_epochs(descent *d, size_t per_step, uint32_t *steps, size_t step_count) {
    const pci_skin_descent *settings = d->settings;
    workspace *w = &d->w;
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
            for (size_t b = begin; b < end; ++b) {
                use_block(w, b, b);
                d->update = b + 1 == end;
                run_pass(w, displace_piece, NULL);
                run_pass(w, fit_piece, NULL);
                pci_parallel_for(w->context, w->problem->vertex_count, PIECE, finish_piece, d);
            }
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
    if (!build_workspace(&scratch, problem, kernel, block_count, frames, block_count, &d.w)) {
        status = pci_fail_memory(context, stage);
        goto cleanup;
    }
    for (size_t v = 0; v < nv; ++v) {
        double weights[SLOTS_MAX];
        pci_skin_normalize(&surrogate[v * problem->slots], problem->slots, weights);
        for (size_t k = 0; k < problem->slots; ++k) {
            put(kernel, (void *)d.w.data.weights, v * problem->slots + k, weights[k]);
        }
    }
    status = run_epochs(&d, per_step, steps, step_count);

cleanup:
    pci_scratch_end(&scratch);
    return status;
}
