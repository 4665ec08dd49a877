// Runs the kernels over blocks of frames: losses and gradients.
#include "stages/skin_frames.h"

#include "core/topology.h"

static const char stage[] = "skin";

// ---- conversion ---------------------------------------------------------------------------------

void *pci_skin_reals(pci_scratch *scratch, const pci_skin_kernel *kernel, size_t count) {
    // Registers are at most 64 bytes wide.
    char *memory = pci_scratch_allocate(scratch, count * kernel->real_size + 64, 1);
    return memory == NULL ? NULL : memory + (64 - (uintptr_t)memory % 64) % 64;
}

void pci_skin_put(const pci_skin_kernel *kernel, void *array, size_t index, double value) {
    if (kernel->real_size == sizeof(float)) {
        ((float *)array)[index] = (float)value;
    } else {
        ((double *)array)[index] = value;
    }
}

double pci_skin_get(const pci_skin_kernel *kernel, const void *array, size_t index) {
    return kernel->real_size == sizeof(float) ? (double)((const float *)array)[index]
                                              : ((const double *)array)[index];
}

// Edge vectors and per-vertex constants of one neighbourhood.
static bool convert_edges(pci_scratch *scratch, const pci_skin_frames *w, const size_t *offsets,
                          const uint32_t *targets, pci_skin_edges *edges) {
    const size_t nv = w->problem->vertex_count;
    void *vectors = pci_skin_reals(scratch, w->kernel, 3 * offsets[nv]);
    void *constants = pci_skin_reals(scratch, w->kernel, 13 * nv);
    void *lengths = pci_skin_reals(scratch, w->kernel, offsets[nv]);
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
                pci_skin_put(w->kernel, vectors, 3 * k + a, e[a]);
            }
            pci_skin_put(w->kernel, lengths, k, pci_norm(e));
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
            pci_skin_put(w->kernel, constants, 13 * v + k, constant[k]);
        }
    }
    edges->offsets = offsets;
    edges->targets = targets;
    edges->vectors = vectors;
    edges->lengths = lengths;
    edges->constants = constants;
    return true;
}

// K(i) as edges, and the same edges listed by their target.
static bool convert_near(pci_scratch *scratch, pci_skin_frames *w) {
    const pci_skin_problem *p = w->problem;
    const size_t nv = p->vertex_count, k = p->near_count;
    size_t *offsets = PCI_SCRATCH(scratch, size_t, nv + 1);
    size_t *incoming_offsets = PCI_SCRATCH(scratch, size_t, nv + 2);
    uint32_t *incoming = PCI_SCRATCH(scratch, uint32_t, k * nv);
    void *near_weights = pci_skin_reals(scratch, w->kernel, k * nv);
    void *attachment = pci_skin_reals(scratch, w->kernel, 3 * nv);
    void *incoming_vectors = pci_skin_reals(scratch, w->kernel, 3 * k * nv);
    void *incoming_weights = pci_skin_reals(scratch, w->kernel, k * nv);
    if (scratch->failed) {
        return false;
    }
    for (size_t v = 0; v < nv; ++v) {
        offsets[v + 1] = k * (v + 1);
        double a[3] = {p->rest[3 * v], p->rest[3 * v + 1], p->rest[3 * v + 2]};
        for (size_t e = k * v; e < k * v + k; ++e) {
            const double *target = &p->rest[3 * (size_t)p->near[e]];
            pci_skin_put(w->kernel, near_weights, e, p->near_weights[e]);
            ++incoming_offsets[p->near[e] + 2];
            for (size_t c = 0; c < 3; ++c) {
                a[c] -= p->near_weights[e] * target[c];
            }
        }
        for (size_t c = 0; c < 3; ++c) {
            pci_skin_put(w->kernel, attachment, 3 * v + c, w->unit * a[c]);
        }
    }
    // Counting sort; while it runs, incoming_offsets[i + 1] is where the next source of i goes.
    for (size_t v = 0; v < nv; ++v) {
        incoming_offsets[v + 2] += incoming_offsets[v + 1];
    }
    for (size_t e = 0; e < k * nv; ++e) {
        const size_t source = e / k, target = p->near[e], at = incoming_offsets[target + 1]++;
        incoming[at] = (uint32_t)source;
        pci_skin_put(w->kernel, incoming_weights, at, p->near_weights[e]);
        for (size_t c = 0; c < 3; ++c) {
            pci_skin_put(w->kernel, incoming_vectors, 3 * at + c,
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
static void fill_driver(const pci_skin_frames *w, size_t block) {
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
            pci_skin_put(w->kernel, driver, k * PCI_BLOCK + lane,
                         w->unit * (frame[k] - p->proxy_rest[k] - mean[k % 3]));
        }
    }
}

bool pci_skin_frames_build(pci_scratch *scratch, const pci_skin_problem *problem,
                           const pci_skin_kernel *kernel, size_t block_count,
                           const uint32_t *frames, size_t kept_blocks, pci_skin_frames *w) {
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
        pci_skin_reals(scratch, kernel, block_count * 3 * PCI_BLOCK * problem->proxy_count);
    w->quaternions = pci_skin_reals(scratch, kernel, kept_blocks * 8 * PCI_BLOCK * nv);
    w->data.weights = pci_skin_reals(scratch, kernel, nv * problem->slots);
    w->data.displacements = pci_skin_reals(scratch, kernel, 3 * PCI_BLOCK * nv);
    w->data.rotations = pci_skin_reals(scratch, kernel, 18 * PCI_BLOCK * nv);
    w->data.residuals = pci_skin_reals(scratch, kernel, 6 * PCI_BLOCK * nv);
    w->data.gradient = pci_skin_reals(scratch, kernel, nv * problem->slots);
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

void pci_skin_frames_use(pci_skin_frames *w, size_t block, size_t kept) {
    w->data.driver = w->drivers + block * w->driver_size;
    w->data.quaternions = w->quaternions + kept * w->quaternion_size;
}

// ---- losses and gradient of all frames ---------------------------------------------------------

typedef struct pass_job {
    pci_skin_frames *w;
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
                        job->sums != NULL ? &job->sums[begin / PCI_SKIN_PIECE] : NULL);
}

static void gradient_piece(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const pass_job *job = user;
    job->w->kernel->gradient(&job->w->data, begin, end);
}

static void run_pass(pci_skin_frames *w, pci_parallel_body body, pci_skin_sums *sums) {
    pass_job job = {.w = w, .sums = sums};
    pci_parallel_for(w->context, w->problem->vertex_count, PCI_SKIN_PIECE, body, &job);
}

void pci_skin_frames_displace(pci_skin_frames *w) { run_pass(w, displace_piece, NULL); }
void pci_skin_frames_fit(pci_skin_frames *w, pci_skin_sums *sums) { run_pass(w, fit_piece, sums); }
void pci_skin_frames_gradient(pci_skin_frames *w) { run_pass(w, gradient_piece, NULL); }

bool pci_skin_frames_build_sequential(pci_scratch *scratch, const pci_skin_problem *problem,
                                      const pci_skin_kernel *kernel, bool keep_all,
                                      pci_skin_frames *w) {
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
    return pci_skin_frames_build(scratch, problem, kernel, block_count, order,
                                 keep_all ? block_count : 1, w);
}

void pci_skin_frames_set_weights(pci_skin_frames *w, const double *weights) {
    for (size_t i = 0; i < w->problem->vertex_count * w->problem->slots; ++i) {
        pci_skin_put(w->kernel, (void *)w->data.weights, i, weights[i]);
    }
}

void pci_skin_frames_add(const pci_skin_frames *w, size_t block, size_t pieces,
                         const pci_skin_sums *sums, pci_skin_measures *measures,
                         double *per_frame) {
    for (size_t lane = 0; lane < PCI_BLOCK; ++lane) {
        const uint32_t f = w->frames[block * PCI_BLOCK + lane];
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
            losses[x] /= w->unit * w->unit;
            measures->losses[x] += losses[x];
            if (per_frame != NULL) {
                per_frame[3 * (size_t)f + x] = losses[x];
            }
        }
    }
}

pc_status pci_skin_measure(pc_context *context, const pci_skin_problem *problem,
                           const pci_skin_kernel *kernel, const double *weights,
                           pci_skin_measures *measures, double *per_frame) {
    pci_scratch scratch = pci_scratch_begin(context);
    pci_skin_frames w;
    pc_status status = PC_OK;
    const size_t pieces = (problem->vertex_count + PCI_SKIN_PIECE - 1) / PCI_SKIN_PIECE;
    pci_skin_sums *sums = PCI_SCRATCH(&scratch, pci_skin_sums, pieces);
    memset(measures, 0, sizeof(*measures));
    if (scratch.failed || !pci_skin_frames_build_sequential(&scratch, problem, kernel, false, &w)) {
        status = pci_fail_memory(context, stage);
    } else {
        pci_skin_frames_set_weights(&w, weights);
    }
    for (size_t b = 0; status == PC_OK && b < w.block_count; ++b) {
        if (!pci_keep_going(context)) {
            status = pci_fail_cancelled(context, stage);
            break;
        }
        pci_skin_frames_use(&w, b, 0);
        memset(sums, 0, pieces * sizeof(*sums));
        pci_skin_frames_displace(&w);
        pci_skin_frames_fit(&w, sums);
        pci_skin_frames_add(&w, b, pieces, sums, measures, per_frame);
    }
    pci_scratch_end(&scratch);
    return status;
}

pc_status pci_skin_gradient(pc_context *context, const pci_skin_problem *problem,
                            const pci_skin_kernel *kernel, const double *weights,
                            const double scale[4], double *gradient) {
    pci_scratch scratch = pci_scratch_begin(context);
    pci_skin_frames w;
    pc_status status = PC_OK;
    if (!pci_skin_frames_build_sequential(&scratch, problem, kernel, false, &w)) {
        status = pci_fail_memory(context, stage);
    } else {
        pci_skin_frames_set_weights(&w, weights);
        for (size_t x = 0; x < 4; ++x) {
            w.data.scale[x] = scale[x] / (w.unit * w.unit);
        }
        for (size_t b = 0; b < w.block_count; ++b) {
            pci_skin_frames_use(&w, b, 0);
            pci_skin_frames_displace(&w);
            pci_skin_frames_fit(&w, NULL);
            pci_skin_frames_gradient(&w);
        }
        for (size_t i = 0; i < problem->vertex_count * problem->slots; ++i) {
            gradient[i] = pci_skin_get(kernel, w.data.gradient, i);
        }
    }
    pci_scratch_end(&scratch);
    return status;
}
