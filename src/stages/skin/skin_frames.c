// Runs the kernels over patches and blocks: losses and gradients.
#include "stages/skin/skin_frames.h"

#include "geometry/topology.h"

static const char stage[] = "skin";

// ---- conversion ---------------------------------------------------------------------------------

void *pci_skin_reals(pci_scratch *scratch, const pci_skin_kernel *kernel, size_t count) {
    return pci_scratch_allocate_aligned(scratch, count, kernel->real_size);
}

void pci_skin_put(const pci_skin_kernel *kernel, void *array, size_t index, double value) {
    if (kernel->real_size == sizeof(float)) {
        ((float *)array)[index] = (float)value;
    } else {
        ((double *)array)[index] = value;
    }
}

static void put_all(const pci_skin_kernel *kernel, void *array, size_t index, const double *values,
                    size_t count) {
    if (kernel->real_size == sizeof(float)) {
        float *to = (float *)array + index;
        for (size_t i = 0; i < count; ++i) {
            to[i] = (float)values[i];
        }
    } else {
        memcpy((double *)array + index, values, count * sizeof(*values));
    }
}

double pci_skin_get(const pci_skin_kernel *kernel, const void *array, size_t index) {
    return kernel->real_size == sizeof(float) ? (double)((const float *)array)[index]
                                              : ((const double *)array)[index];
}

// ---- patches ------------------------------------------------------------------------------------

// All patches while they are made; edges go to `next`.
typedef struct patch_builder {
    pci_skin_frames *w;
    uint32_t *local;  // #V: 1 + local index in the patch in hand, or 0
    uint32_t *places; // #V: 1 + place in K(i) of the vertex i in hand, or 0
    pci_skin_runs *runs;
    uint32_t *targets;
    char *vectors, *lengths, *stiffness, *near_weights, *constants;
    size_t next, next_length;
    uint32_t *vertices; // of all patches so far
    size_t vertex_capacity, vertex_count;
} patch_builder;

// Of the runs in pci_skin_runs, in order.
static uint32_t run_of(uint32_t i, uint32_t j, bool near) {
    const bool upper = j > i;
    return near ? (upper ? 2 : 3) : (upper ? 1 : 0);
}

static void add_edge(patch_builder *b, uint32_t i, uint32_t j) {
    const pci_skin_problem *p = b->w->problem;
    const uint32_t place = b->places[j];
    pci_skin_put(b->w->kernel, b->near_weights, b->next,
                 place > 0 ? pci_skin_near_weight(p, i, (size_t)i * p->near_count + place - 1)
                           : 0.0);
    b->targets[b->next++] = b->local[j] - 1;
}

static bool in_ring(const pci_skin_problem *p, size_t i, uint32_t j) {
    size_t e = p->ring_offsets[i];
    while (e < p->ring_offsets[i + 1] && p->ring[e] != j) {
        ++e;
    }
    return e < p->ring_offsets[i + 1];
}

// To N(i) or K(i), of all vertices.
static size_t count_edges(const pci_skin_problem *p) {
    size_t count = p->ring_offsets[p->vertex_count];
    for (size_t e = 0; e < p->vertex_count * p->near_count; ++e) {
        count += !in_ring(p, e / p->near_count, p->near[e]);
    }
    return count;
}

// The edges of one vertex whose neighbours all have local numbers.
static pci_skin_runs add_edges(patch_builder *b, uint32_t i, size_t patch_begin) {
    const pci_skin_problem *p = b->w->problem;
    const size_t begin = p->ring_offsets[i], end = p->ring_offsets[i + 1];
    const uint32_t *near = &p->near[(size_t)i * p->near_count];
    uint32_t ends[6] = {(uint32_t)(b->next - patch_begin)};
    for (uint32_t k = 0; k < p->near_count; ++k) {
        b->places[near[k]] = k + 1;
    }
    for (uint32_t run = 0; run < 4; ++run) {
        for (size_t e = begin; e < end; ++e) {
            if (run_of(i, p->ring[e], b->places[p->ring[e]] > 0) == run) {
                add_edge(b, i, p->ring[e]);
            }
        }
        ends[run + 1] = (uint32_t)(b->next - patch_begin);
    }
    for (uint32_t k = 0; k < p->near_count; ++k) {
        if (!in_ring(p, i, near[k])) {
            add_edge(b, i, near[k]);
        }
    }
    ends[5] = (uint32_t)(b->next - patch_begin);
    for (uint32_t k = 0; k < p->near_count; ++k) {
        b->places[near[k]] = 0;
    }
    const pci_skin_runs runs = {.begin = ends[0],
                                .upper = ends[1],
                                .near = ends[2],
                                .upper_end = ends[3],
                                .ring_end = ends[4],
                                .end = ends[5]};
    return runs;
}

// Adds s e e^T of one edge to the constants of a term.
static void add_product(const pci_skin_frames *w, uint32_t from, uint32_t to, double *constant) {
    const pci_skin_problem *p = w->problem;
    const double factor = pci_skin_stiffness(p, from, to) * w->unit;
    double e[3];
    pci_sub(&p->rest[3 * (size_t)from], &p->rest[3 * (size_t)to], e);
    for (size_t a = 0, at = 0; a < 3; ++a) {
        for (size_t b = a; b < 3; ++b) {
            constant[at++] += factor * e[a] * (w->unit * e[b]);
        }
    }
}

static void fill_constants(const pci_skin_frames *w, uint32_t i, void *constants, size_t row) {
    const pci_skin_problem *p = w->problem;
    const double *rest = &p->rest[3 * (size_t)i];
    double values[PCI_SKIN_CONSTANTS] = {0}, attached[3] = {rest[0], rest[1], rest[2]};
    for (size_t e = p->ring_offsets[i]; e < p->ring_offsets[i + 1]; ++e) {
        add_product(w, i, p->ring[e], &values[PCI_SKIN_RING]);
    }
    for (size_t e = (size_t)i * p->near_count; e < ((size_t)i + 1) * p->near_count; ++e) {
        const double *target = &p->rest[3 * (size_t)p->near[e]];
        const double weight = pci_skin_near_weight(p, i, e);
        add_product(w, i, p->near[e], &values[PCI_SKIN_NEAR]);
        for (size_t c = 0; c < 3; ++c) {
            attached[c] -= weight * target[c];
        }
    }
    const double *ring = &values[PCI_SKIN_RING];
    const double squares = ring[0] + ring[3] + ring[5];
    values[PCI_SKIN_RING + 6] = squares > 1e-30 ? 1.0 / squares : 0.0;
    for (size_t c = 0; c < 3; ++c) {
        values[PCI_SKIN_ATTACHED + c] = w->unit * attached[c];
    }
    for (size_t k = 0; k < PCI_SKIN_CONSTANTS; ++k) {
        pci_skin_put(w->kernel, constants, row * PCI_SKIN_CONSTANTS + k, values[k]);
    }
}

// Returns the length of an edge, with its factors.
static double fill_edge(const pci_skin_frames *w, const pci_skin_patch *patch, size_t k,
                        uint32_t i) {
    const pci_skin_problem *p = w->problem;
    const uint32_t j = patch->vertices[patch->targets[k]];
    const double stiffness = pci_skin_stiffness(p, i, j), factor = stiffness * w->unit;
    double e[3];
    pci_sub(&p->rest[3 * (size_t)i], &p->rest[3 * (size_t)j], e);
    for (size_t c = 0; c < 3; ++c) {
        pci_skin_put(w->kernel, (void *)patch->vectors, 3 * k + c, factor * e[c]);
    }
    pci_skin_put(w->kernel, (void *)patch->stiffness, k, stiffness);
    return factor * pci_norm(e);
}

// Fills what depends on the stiffness of edges.
static void fill_patches(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const pci_skin_frames *w = user;
    for (size_t i = begin; i < end; ++i) {
        const pci_skin_patch *patch = &w->patches[i];
        size_t upper = 0;
        for (size_t k = 0; k < patch->own_count; ++k) {
            const pci_skin_runs *runs = &patch->runs[k];
            for (size_t e = runs->begin; e < runs->end; ++e) {
                const double length = fill_edge(w, patch, e, patch->vertices[k]);
                if (e >= runs->upper && e < runs->upper_end) {
                    pci_skin_put(w->kernel, (void *)patch->lengths, upper++, length);
                }
            }
            fill_constants(w, patch->vertices[k], (void *)patch->constants, k);
        }
    }
}

bool pci_skin_frames_make_room(pci_scratch *scratch, pci_skin_frames *w) {
    const size_t rows = w->patch_rows[w->patch_count];
    w->partial = pci_skin_reals(scratch, w->kernel, rows * w->problem->slots);
    return !scratch->failed;
}

void pci_skin_frames_use(pci_skin_frames *w, const pci_skin_problem *problem) {
    w->problem = problem;
    pci_parallel_for(w->context, w->patch_count, 1, fill_patches, w);
}

// Gives the vertices of one patch and their neighbours local numbers; lists them.
static bool number_vertices(pci_scratch *scratch, patch_builder *b, size_t begin, size_t end) {
    const pci_skin_problem *p = b->w->problem;
    const size_t first = b->vertex_count;
    for (int pass = 0; pass < 2; ++pass) {
        for (size_t i = begin; i < end; ++i) {
            const uint32_t v = p->order[i];
            const size_t ring = p->ring_offsets[v + 1] - p->ring_offsets[v];
            const size_t listed = pass == 0 ? 1 : ring + p->near_count;
            if (!pci_scratch_reserve(scratch, (void **)&b->vertices, &b->vertex_capacity,
                                     b->vertex_count + listed, sizeof(*b->vertices))) {
                return false;
            }
            for (size_t k = 0; k < listed; ++k) {
                const uint32_t j = pass == 0  ? v
                                   : k < ring ? p->ring[p->ring_offsets[v] + k]
                                              : p->near[(size_t)v * p->near_count + k - ring];
                if (b->local[j] == 0) {
                    b->vertices[b->vertex_count] = j;
                    b->local[j] = (uint32_t)(++b->vertex_count - first);
                }
            }
        }
    }
    return true;
}

// Lists for each vertex the rows of the patches that know it.
static bool build_shares(pci_scratch *scratch, const uint32_t *vertices, pci_skin_frames *w) {
    const size_t nv = w->problem->vertex_count, rows = w->patch_rows[w->patch_count];
    w->share_offsets = PCI_SCRATCH(scratch, uint32_t, nv + 2);
    w->shares = PCI_SCRATCH(scratch, uint32_t, rows);
    if (scratch->failed || (vertices == NULL && rows > 0)) {
        return false;
    }
    // Counting sort; while it runs, share_offsets[v + 1] is where the next row of v goes.
    for (size_t r = 0; r < rows; ++r) {
        ++w->share_offsets[vertices[r] + 2];
    }
    for (size_t v = 0; v < nv; ++v) {
        w->share_offsets[v + 2] += w->share_offsets[v + 1];
    }
    for (size_t r = 0; r < rows; ++r) {
        w->shares[w->share_offsets[vertices[r] + 1]++] = (uint32_t)r;
    }
    return true;
}

static bool begin_patches(pci_scratch *scratch, pci_scratch *local, patch_builder *b) {
    pci_skin_frames *w = b->w;
    const size_t nv = w->problem->vertex_count, edges = count_edges(w->problem);
    w->patch_count = (nv + PCI_SKIN_PATCH - 1) / PCI_SKIN_PATCH;
    w->patches = PCI_SCRATCH(scratch, pci_skin_patch, w->patch_count);
    w->patch_rows = PCI_SCRATCH(scratch, size_t, w->patch_count + 1);
    b->local = PCI_SCRATCH(local, uint32_t, nv);
    b->places = PCI_SCRATCH(local, uint32_t, nv);
    b->runs = PCI_SCRATCH(scratch, pci_skin_runs, nv);
    b->targets = PCI_SCRATCH(scratch, uint32_t, edges);
    b->vectors = pci_skin_reals(scratch, w->kernel, 3 * edges);
    b->lengths = pci_skin_reals(scratch, w->kernel, w->problem->ring_offsets[nv] / 2);
    b->stiffness = pci_skin_reals(scratch, w->kernel, edges);
    b->near_weights = pci_skin_reals(scratch, w->kernel, edges);
    b->constants = pci_skin_reals(scratch, w->kernel, nv * PCI_SKIN_CONSTANTS);
    return !scratch->failed && !local->failed;
}

// All of a patch but what depends on the stiffness of edges.
static bool build_patch(pci_scratch *local, patch_builder *b, size_t i) {
    const pci_skin_problem *p = b->w->problem;
    const size_t size = b->w->kernel->real_size, first_edge = b->next, first = b->vertex_count;
    const size_t begin = i * PCI_SKIN_PATCH;
    const size_t end =
        begin + PCI_SKIN_PATCH < p->vertex_count ? begin + PCI_SKIN_PATCH : p->vertex_count;
    pci_skin_patch *patch = &b->w->patches[i];
    if (!number_vertices(local, b, begin, end)) {
        return false;
    }
    patch->own_count = (uint32_t)(end - begin);
    patch->local_count = (uint32_t)(b->vertex_count - first);
    patch->runs = &b->runs[begin];
    patch->targets = &b->targets[first_edge];
    patch->vectors = b->vectors + 3 * first_edge * size;
    patch->lengths = b->lengths + b->next_length * size;
    patch->stiffness = b->stiffness + first_edge * size;
    patch->near_weights = b->near_weights + first_edge * size;
    patch->constants = b->constants + begin * PCI_SKIN_CONSTANTS * size;
    for (size_t k = begin; k < end; ++k) {
        b->runs[k] = add_edges(b, p->order[k], first_edge);
        b->next_length += b->runs[k].upper_end - b->runs[k].upper;
    }
    for (size_t r = first; r < b->vertex_count; ++r) {
        b->local[b->vertices[r]] = 0;
    }
    b->w->patch_rows[i + 1] = b->vertex_count;
    return true;
}

static bool finish_patches(pci_scratch *scratch, const patch_builder *b) {
    pci_skin_frames *w = b->w;
    size_t most = 0;
    uint32_t *vertices = PCI_SCRATCH(scratch, uint32_t, b->vertex_count);
    for (size_t i = 0; i < w->patch_count && vertices != NULL; ++i) {
        pci_skin_patch *patch = &w->patches[i];
        const size_t first = w->patch_rows[i];
        memcpy(&vertices[first], &b->vertices[first], patch->local_count * sizeof(*vertices));
        patch->vertices = &vertices[first];
        most = patch->local_count > most ? patch->local_count : most;
    }
    const uint32_t threads = pc_context_threads(w->context);
    w->buffers = PCI_SCRATCH(scratch, pci_skin_buffers, threads);
    for (size_t i = 0; i < threads && w->buffers != NULL; ++i) {
        w->buffers[i].displacements = pci_skin_reals(scratch, w->kernel, 3 * PCI_BLOCK * most);
        w->buffers[i].forces = pci_skin_reals(scratch, w->kernel, 3 * PCI_BLOCK * most);
    }
    return !scratch->failed && build_shares(scratch, vertices, w);
}

static bool build_patches(pci_scratch *scratch, pci_skin_frames *w) {
    pci_scratch local = pci_scratch_begin(scratch->context);
    patch_builder b = {.w = w};
    bool good = begin_patches(scratch, &local, &b);
    for (size_t i = 0; i < w->patch_count && good; ++i) {
        good = build_patch(&local, &b, i);
    }
    good = good && finish_patches(scratch, &b);
    pci_scratch_end(&local);
    if (good) {
        pci_skin_frames_use(w, w->problem);
    }
    return good;
}

// ---- frames -------------------------------------------------------------------------------------

typedef struct driver_job {
    const pci_skin_frames *w;
    size_t first, stride; // blocks
} driver_job;

// What one proxy vertex does in a block, frames innermost. Where a block is not full the proxy is
// at rest, which adds no gradient.
static void fill_bone(const pci_skin_frames *w, const uint32_t *frames, size_t bone, void *driver) {
    const size_t per_bone = 3 * (size_t)w->data.columns;
    double rows[3 * PCI_SKIN_COLUMNS_MAX * PCI_BLOCK];
    for (size_t lane = 0; lane < PCI_BLOCK; ++lane) {
        double map[3 * PCI_SKIN_COLUMNS_MAX] = {0};
        const uint32_t frame = frames[lane];
        if (frame != PC_INVALID_INDEX) {
            pci_skin_bone_map(w->problem, w->origin, frame, bone, map);
            for (size_t c = 0; c < 3; ++c) {
                map[c] = w->unit * (map[c] - w->means[3 * frame + c]);
            }
        }
        for (size_t k = 0; k < per_bone; ++k) {
            rows[k * PCI_BLOCK + lane] = frame != PC_INVALID_INDEX ? map[k] : 0.0;
        }
    }
    put_all(w->kernel, driver, per_bone * PCI_BLOCK * bone, rows, per_bone * PCI_BLOCK);
}

// In float the mean displacement is left out: no loss depends on it, and smaller numbers keep more
// digits.
static bool find_means(pci_scratch *scratch, pci_skin_frames *w) {
    const pci_skin_problem *p = w->problem;
    w->means = PCI_SCRATCH(scratch, double, 3 * p->frame_count);
    if (scratch->failed || w->kernel->real_size != sizeof(float)) {
        return !scratch->failed;
    }
    for (size_t i = 0; i < p->frame_count * p->proxy_count; ++i) {
        double map[3 * PCI_SKIN_COLUMNS_MAX];
        pci_skin_bone_map(p, w->origin, i / p->proxy_count, i % p->proxy_count, map);
        for (size_t c = 0; c < 3; ++c) {
            w->means[3 * (i / p->proxy_count) + c] += map[c] / (double)p->proxy_count;
        }
    }
    return true;
}

static void fill_drivers(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const driver_job *job = user;
    const pci_skin_frames *w = job->w;
    const size_t bones = w->problem->proxy_count;
    for (size_t i = begin; i < end; ++i) {
        const size_t slot = i / bones, block = job->first + slot * job->stride;
        fill_bone(w, &w->frames[block * PCI_BLOCK], i % bones, w->drivers + slot * w->driver_size);
    }
}

// Makes what the proxy does in some blocks, unless it is there.
static void load_drivers(pci_skin_frames *w, size_t first, size_t stride, size_t count) {
    if (w->loaded_first == first && w->loaded_stride == stride && w->loaded_count == count) {
        return;
    }
    driver_job job = {.w = w, .first = first, .stride = stride};
    pci_parallel_for(w->context, count * w->problem->proxy_count, 32, fill_drivers, &job);
    w->loaded_first = first;
    w->loaded_stride = stride;
    w->loaded_count = count;
}

// Where the vertices are, as the driver sees them.
static bool fill_points(pci_scratch *scratch, pci_skin_frames *w) {
    const pci_skin_problem *p = w->problem;
    const size_t columns = w->data.columns, vertices = columns == 1 ? 1 : p->vertex_count;
    const size_t count = vertices * columns;
    void *points = pci_skin_reals(scratch, w->kernel, count);
    w->points = PCI_SCRATCH(scratch, double, count);
    if (scratch->failed) {
        return false;
    }
    for (size_t v = 0; v < vertices; ++v) {
        pci_skin_point(p, w->origin, w->unit, v, &w->points[v * columns]);
    }
    for (size_t i = 0; i < count; ++i) {
        pci_skin_put(w->kernel, points, i, w->points[i]);
    }
    w->data.points = points;
    return true;
}

void pci_skin_frames_begin(pc_context *context, const pci_skin_problem *problem,
                           const pci_skin_kernel *kernel, pci_skin_frames *w) {
    memset(w, 0, sizeof(*w));
    w->context = context;
    w->problem = problem;
    w->kernel = kernel;
    const double diagonal = pci_skin_extent(problem, w->origin);
    // In float edges are of about length 1: the kernel works with powers of them.
    w->unit = kernel->real_size == sizeof(float) && diagonal > 0.0 ? 128.0 / diagonal : 1.0;
    w->data.columns = pci_skin_columns(problem);
}

bool pci_skin_frames_build(pci_scratch *scratch, const pci_skin_problem *problem,
                           const pci_skin_kernel *kernel, size_t block_count,
                           const uint32_t *frames, pci_skin_frames *w) {
    pci_skin_frames_begin(scratch->context, problem, kernel, w);
    w->block_count = block_count;
    w->data.slots = problem->slots;
    w->data.bones = problem->bones;
    const size_t per_block = 3 * PCI_BLOCK * w->data.columns * problem->proxy_count;
    w->driver_size = per_block * kernel->real_size;
    w->frames = frames;
    w->drivers = pci_skin_reals(scratch, kernel, PCI_SKIN_LOADED * per_block);
    return !scratch->failed && find_means(scratch, w) && fill_points(scratch, w) &&
           build_patches(scratch, w);
}

uint32_t *pci_skin_frames_in_sequence(pci_scratch *scratch, const pci_skin_problem *problem,
                                      size_t *block_count) {
    const size_t frame_count = problem->frame_count;
    const size_t count = (frame_count + PCI_BLOCK - 1) / PCI_BLOCK;
    uint32_t *order = PCI_SCRATCH(scratch, uint32_t, PCI_BLOCK * count);
    for (size_t i = 0; i < PCI_BLOCK * count && order != NULL; ++i) {
        const size_t f = i % PCI_BLOCK * count + i / PCI_BLOCK;
        order[i] = f < frame_count ? (uint32_t)f : PC_INVALID_INDEX;
    }
    *block_count = count;
    return order;
}

bool pci_skin_frames_build_sequential(pci_scratch *scratch, const pci_skin_problem *problem,
                                      const pci_skin_kernel *kernel, pci_skin_frames *w) {
    size_t block_count;
    const uint32_t *order = pci_skin_frames_in_sequence(scratch, problem, &block_count);
    return order != NULL && pci_skin_frames_build(scratch, problem, kernel, block_count, order, w);
}

// ---- losses and gradient ------------------------------------------------------------------------

typedef struct evaluation {
    const pci_skin_frames *w;
    size_t first, stride, count; // blocks, loaded
    bool gradient, fresh;        // fresh: nothing to add to yet
    pci_skin_measures *measures;
} evaluation;

// Adds up the frames of a block.
static void add_sums(const uint32_t *frames, const pci_skin_sums *sums,
                     pci_skin_measures *measures) {
    for (size_t lane = 0; lane < PCI_BLOCK; ++lane) {
        if (frames[lane] != PC_INVALID_INDEX) {
            for (size_t x = 0; x < 3; ++x) {
                measures->losses[x] += sums->losses[x][lane];
            }
            measures->reflections += sums->reflections[lane];
        }
    }
}

static void evaluate_patches(void *user, size_t begin, size_t end, uint32_t worker) {
    const evaluation *job = user;
    const pci_skin_frames *w = job->w;
    const size_t row_size = w->problem->slots * w->kernel->real_size;
    for (size_t i = begin; i < end; ++i) {
        char *gradient = job->gradient ? (char *)w->partial + w->patch_rows[i] * row_size : NULL;
        if (job->gradient && job->fresh) {
            memset(gradient, 0, w->patches[i].local_count * row_size);
        }
        for (size_t b = 0; b < job->count; ++b) {
            pci_skin_sums sums = {{{0.0}}, {0}};
            w->kernel->evaluate(&w->data, &w->patches[i], w->drivers + b * w->driver_size,
                                &w->buffers[worker], job->measures != NULL ? &sums : NULL,
                                gradient);
            if (job->measures != NULL) {
                add_sums(&w->frames[(job->first + b * job->stride) * PCI_BLOCK], &sums,
                         &job->measures[i]);
            }
        }
    }
}

bool pci_skin_frames_evaluate(pci_skin_frames *w, const double *weights, size_t begin, size_t end,
                              size_t stride, bool gradient, pci_skin_measures *measures) {
    if (measures != NULL) {
        memset(measures, 0, w->patch_count * sizeof(*measures));
    }
    w->data.weights = weights;
    bool wanted = true;
    for (size_t first = begin; first < end && wanted; first += PCI_SKIN_LOADED * stride) {
        const size_t left = (end - first + stride - 1) / stride;
        evaluation job = {.w = w,
                          .first = first,
                          .stride = stride,
                          .count = left < PCI_SKIN_LOADED ? left : PCI_SKIN_LOADED,
                          .gradient = gradient,
                          .fresh = first == begin,
                          .measures = measures};
        load_drivers(w, first, stride, job.count);
        wanted = pci_parallel_while_wanted(w->context, w->patch_count, 1, evaluate_patches, &job);
    }
    return wanted;
}

void pci_skin_frames_row(const pci_skin_frames *w, size_t vertex, double *row) {
    const size_t slots = w->problem->slots;
    memset(row, 0, slots * sizeof(*row));
    const bool single = w->kernel->real_size == sizeof(float);
    for (size_t s = w->share_offsets[vertex]; s < w->share_offsets[vertex + 1]; ++s) {
        const size_t first = w->shares[s] * slots;
        for (size_t k = 0; k < slots && single; ++k) {
            row[k] += (double)((const float *)w->partial)[first + k];
        }
        for (size_t k = 0; k < slots && !single; ++k) {
            row[k] += ((const double *)w->partial)[first + k];
        }
    }
}

float *pci_skin_frames_own_row(const pci_skin_frames *w, size_t place) {
    const size_t row = w->patch_rows[place / PCI_SKIN_PATCH] + place % PCI_SKIN_PATCH;
    return (float *)w->partial + row * w->problem->slots;
}

void pci_skin_frames_add(const pci_skin_frames *w, const pci_skin_measures *of_patches,
                         pci_skin_measures *measures) {
    memset(measures, 0, sizeof(*measures));
    for (size_t i = 0; i < w->patch_count; ++i) {
        for (size_t x = 0; x < 3; ++x) {
            measures->losses[x] += of_patches[i].losses[x] / (w->unit * w->unit);
        }
        measures->reflections += of_patches[i].reflections;
    }
}

pc_status pci_skin_measure(pc_context *context, const pci_skin_problem *problem,
                           const pci_skin_kernel *kernel, const double *weights,
                           pci_skin_measures *measures) {
    pci_scratch scratch = pci_scratch_begin(context);
    pci_skin_frames w;
    pci_skin_measures *of_patches = NULL;
    bool good = pci_skin_frames_build_sequential(&scratch, problem, kernel, &w);
    if (good) {
        of_patches = PCI_SCRATCH(&scratch, pci_skin_measures, w.patch_count);
        good = of_patches != NULL;
    }
    if (good) {
        good = pci_skin_frames_evaluate(&w, weights, 0, w.block_count, 1, false, of_patches);
        pci_skin_frames_add(&w, of_patches, measures);
    }
    pci_scratch_end(&scratch);
    return good ? PC_OK : pci_fail_memory(context, stage);
}

pc_status pci_skin_gradient(pc_context *context, const pci_skin_problem *problem,
                            const pci_skin_kernel *kernel, const double *weights,
                            const double scale[4], double *gradient) {
    pci_scratch scratch = pci_scratch_begin(context);
    pci_skin_frames w;
    bool good = pci_skin_frames_build_sequential(&scratch, problem, kernel, &w) &&
                pci_skin_frames_make_room(&scratch, &w);
    if (good) {
        for (size_t x = 0; x < 4; ++x) {
            w.data.scale[x] = scale[x] / (w.unit * w.unit);
        }
        good = pci_skin_frames_evaluate(&w, weights, 0, w.block_count, 1, true, NULL);
        for (size_t v = 0; v < problem->vertex_count; ++v) {
            pci_skin_frames_row(&w, v, &gradient[v * problem->slots]);
        }
    }
    pci_scratch_end(&scratch);
    return good ? PC_OK : pci_fail_memory(context, stage);
}
