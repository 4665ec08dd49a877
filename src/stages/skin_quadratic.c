#include "stages/skin_quadratic.h"

#include <float.h>

#include "stages/skin_frames.h"
#include "stages/skin_simplex.h"

enum { GROUP = 64, GRAIN = 1 }; // vertices that one thread visits in turn; groups per piece

static const double ridge_share = 1e-9; // of the trace of a block, keeps it definite

double pci_skin_ring_scale(const double scale[4]) {
    return scale[0] + fmax(scale[3] / 3.0, 0.5 * (scale[3] - scale[0]));
}

// ---- the matrix M -------------------------------------------------------------------------------

typedef struct row_builder {
    double *values; // #V
    uint32_t *marks;
    uint32_t *columns;
    size_t count;
    uint32_t row;
} row_builder;

static void add_entry(row_builder *b, uint32_t column, double value) {
    if (b->marks[column] != b->row + 1) {
        b->marks[column] = b->row + 1;
        b->values[column] = 0.0;
        b->columns[b->count++] = column;
    }
    b->values[column] += value;
}

// K(j) lists by their member i.
typedef struct incoming_lists {
    size_t *offsets;
    uint32_t *sources;
    double *weights;
} incoming_lists;

static bool build_incoming(pci_scratch *scratch, const pci_skin_problem *p, incoming_lists *in) {
    const size_t nv = p->vertex_count, k = p->near_count;
    in->offsets = PCI_SCRATCH(scratch, size_t, nv + 2);
    in->sources = PCI_SCRATCH(scratch, uint32_t, k * nv);
    in->weights = PCI_SCRATCH(scratch, double, k *nv);
    if (scratch->failed) {
        return false;
    }
    for (size_t e = 0; e < k * nv; ++e) {
        ++in->offsets[p->near[e] + 2];
    }
    for (size_t v = 0; v < nv; ++v) {
        in->offsets[v + 2] += in->offsets[v + 1];
    }
    for (size_t e = 0; e < k * nv; ++e) {
        const size_t at = in->offsets[p->near[e] + 1]++;
        in->sources[at] = (uint32_t)(e / k);
        in->weights[at] = p->near_weights[e];
    }
    return true;
}

// Row i of M / 2.
static void build_row(const pci_skin_problem *p, const incoming_lists *in, const double scale[4],
                      uint32_t i, row_builder *b) {
    const size_t k = p->near_count;
    const double ring = pci_skin_ring_scale(scale);
    b->row = i;
    b->count = 0;
    add_entry(b, i, 0.0);
    for (size_t e = p->ring_offsets[i]; e < p->ring_offsets[i + 1]; ++e) {
        const double value = 2.0 * ring * pci_skin_stiffness(p, i, p->ring[e]);
        add_entry(b, p->ring[e], -value);
        b->values[i] += value;
    }
    // Row r of K is 1 at r and -Kw at K(r).
    for (size_t e = 0; e < k; ++e) {
        const uint32_t j = p->near[k * i + e];
        const double value = scale[1] * pci_skin_stiffness(p, i, j);
        add_entry(b, j, -value - scale[2] * p->near_weights[k * i + e]);
        b->values[i] += value;
    }
    b->values[i] += scale[2];
    for (size_t s = in->offsets[i]; s < in->offsets[i + 1]; ++s) {
        const uint32_t r = in->sources[s];
        const double weight = in->weights[s], value = scale[1] * pci_skin_stiffness(p, i, r);
        b->values[i] += value;
        add_entry(b, r, -value - scale[2] * weight);
        for (size_t e = k * r; e < k * r + k; ++e) {
            add_entry(b, p->near[e], scale[2] * weight * p->near_weights[e]);
        }
    }
}

// Visits all rows: counts the entries of each, or, where `q` has columns, fills them.
static bool visit_rows(pci_scratch *scratch, const pci_skin_problem *p, const double scale[4],
                       const double *diagonal, pci_skin_quadratic *q) {
    const size_t nv = p->vertex_count;
    pci_scratch local = pci_scratch_begin(scratch->context);
    row_builder b = {.values = PCI_SCRATCH(&local, double, nv),
                     .marks = PCI_SCRATCH(&local, uint32_t, nv),
                     .columns = PCI_SCRATCH(&local, uint32_t, nv)};
    incoming_lists in;
    const bool good = !local.failed && build_incoming(&local, p, &in);
    for (uint32_t i = 0; i < nv && good; ++i) {
        build_row(p, &in, scale, i, &b);
        b.values[i] += diagonal[i];
        for (size_t k = 0; k < b.count && q->columns != NULL; ++k) {
            q->columns[q->offsets[i] + k] = b.columns[k];
            q->values[q->offsets[i] + k] = 2.0 * b.values[b.columns[k]];
        }
        q->offsets[i + 1] = q->offsets[i] + b.count;
    }
    pci_scratch_end(&local);
    return good;
}

static bool build_matrix(pci_scratch *scratch, const pci_skin_problem *p, const double scale[4],
                         const double *diagonal, pci_skin_quadratic *q) {
    q->offsets = PCI_SCRATCH(scratch, size_t, p->vertex_count + 1);
    if (scratch->failed || !visit_rows(scratch, p, scale, diagonal, q)) {
        return false;
    }
    q->columns = PCI_SCRATCH(scratch, uint32_t, q->offsets[p->vertex_count]);
    q->values = PCI_SCRATCH(scratch, double, q->offsets[p->vertex_count]);
    return !scratch->failed && visit_rows(scratch, p, scale, diagonal, q);
}

bool pci_skin_quadratic_weigh(pci_scratch *scratch, const pci_skin_problem *problem,
                              const double scale[4], const double *diagonal,
                              pci_skin_quadratic *q) {
    return visit_rows(scratch, problem, scale, diagonal, q);
}

// ---- groups and colours -------------------------------------------------------------------------

// Vertices that are close in space, in groups.
static bool build_groups(pci_scratch *scratch, const pci_skin_problem *p, pci_skin_quadratic *q) {
    const size_t nv = p->vertex_count;
    q->group_count = (uint32_t)((nv + GROUP - 1) / GROUP);
    q->members = p->order;
    q->group_offsets = PCI_SCRATCH(scratch, uint32_t, (size_t)q->group_count + 1);
    for (size_t g = 0; g < q->group_count && q->group_offsets != NULL; ++g) {
        q->group_offsets[g + 1] = (uint32_t)(nv - g * GROUP < GROUP ? nv : (g + 1) * GROUP);
    }
    return !scratch->failed;
}

// Each group takes the first colour that no group it shares an entry of M with has.
static bool colour_groups(pci_scratch *scratch, pci_skin_quadratic *q) {
    uint32_t *group_of = PCI_SCRATCH(scratch, uint32_t, q->vertex_count);
    uint32_t *colours = PCI_SCRATCH(scratch, uint32_t, q->group_count); // + 1; 0: none yet
    uint32_t *taken = PCI_SCRATCH(scratch, uint32_t, (size_t)q->group_count + 2);
    uint32_t *offsets = PCI_SCRATCH(scratch, uint32_t, (size_t)q->group_count + 2);
    q->groups = PCI_SCRATCH(scratch, uint32_t, q->group_count);
    if (scratch->failed) {
        return false;
    }
    for (uint32_t g = 0; g < q->group_count; ++g) {
        for (uint32_t m = q->group_offsets[g]; m < q->group_offsets[g + 1]; ++m) {
            group_of[q->members[m]] = g;
        }
    }
    for (uint32_t g = 0; g < q->group_count; ++g) {
        for (uint32_t m = q->group_offsets[g]; m < q->group_offsets[g + 1]; ++m) {
            const uint32_t v = q->members[m];
            for (size_t e = q->offsets[v]; e < q->offsets[v + 1]; ++e) {
                taken[colours[group_of[q->columns[e]]]] = g + 1;
            }
        }
        uint32_t colour = 1;
        while (taken[colour] == g + 1) {
            ++colour;
        }
        colours[g] = colour;
        ++offsets[colour];
        q->colour_count = colour > q->colour_count ? colour : q->colour_count;
    }
    for (uint32_t c = 0; c < q->colour_count; ++c) {
        offsets[c + 1] += offsets[c];
    }
    for (uint32_t g = 0; g < q->group_count; ++g) {
        q->groups[offsets[colours[g] - 1]++] = g;
    }
    for (uint32_t c = q->colour_count; c > 0; --c) {
        offsets[c] = offsets[c - 1];
    }
    offsets[0] = 0;
    q->colour_offsets = offsets;
    return true;
}

// Room for the largest group, for each thread.
static bool build_loaded(pci_scratch *scratch, pci_skin_quadratic *q) {
    const uint32_t threads = pc_context_threads(scratch->context);
    q->loaded = PCI_SCRATCH(scratch, pci_skin_group, threads);
    if (scratch->failed) {
        return false;
    }
    for (uint32_t i = 0; i < threads; ++i) {
        q->loaded[i].row_numbers = PCI_SCRATCH(scratch, uint32_t, q->vertex_count);
    }
    uint32_t *marks = q->loaded[0].row_numbers;
    if (scratch->failed) {
        return false;
    }
    size_t rows = 0;
    for (uint32_t g = 0; g < q->group_count; ++g) {
        size_t count = 0;
        for (size_t m = q->group_offsets[g]; m < q->group_offsets[g + 1]; ++m) {
            const uint32_t v = q->members[m];
            for (size_t e = q->offsets[v]; e < q->offsets[v + 1]; ++e) {
                count += marks[q->columns[e]] != g + 1;
                marks[q->columns[e]] = g + 1;
            }
        }
        rows = count > rows ? count : rows;
    }
    memset(marks, 0, q->vertex_count * sizeof(*marks));
    const size_t most = rows * q->slots < q->proxy_count ? rows * q->slots : q->proxy_count;
    for (uint32_t i = 0; i < threads; ++i) {
        pci_skin_group *g = &q->loaded[i];
        g->bone_numbers = PCI_SCRATCH(scratch, uint32_t, q->proxy_count);
        g->vertices = PCI_SCRATCH(scratch, uint32_t, rows);
        g->row_offsets = PCI_SCRATCH(scratch, uint32_t, rows + 1);
        g->positions = PCI_SCRATCH(scratch, uint32_t, (size_t)GROUP * q->slots);
        g->places = PCI_SCRATCH(scratch, uint32_t, rows * q->slots);
        g->moved = PCI_SCRATCH(scratch, double, rows * q->slots);
        g->bones = PCI_SCRATCH(scratch, uint32_t, most);
        g->gram = PCI_SCRATCH(scratch, double, most *most * q->width * q->width);
        g->accumulator = PCI_SCRATCH(scratch, double, most * q->width);
    }
    return !scratch->failed;
}

bool pci_skin_quadratic_build(pci_scratch *scratch, const pci_skin_problem *problem,
                              const double *points, const double scale[4], const double *diagonal,
                              const double *gram, const uint32_t *allowed, pci_skin_quadratic *q) {
    memset(q, 0, sizeof(*q));
    q->context = scratch->context;
    q->vertex_count = problem->vertex_count;
    q->proxy_count = problem->proxy_count;
    q->slots = problem->slots;
    q->bones = problem->bones;
    q->width = pci_skin_columns(problem);
    q->points = points;
    q->gram = gram;
    q->allowed = allowed;
    return build_matrix(scratch, problem, scale, diagonal, q) &&
           build_groups(scratch, problem, q) && colour_groups(scratch, q) &&
           build_loaded(scratch, q);
}

// ---- sweeps -------------------------------------------------------------------------------------

typedef struct sweep_job {
    const pci_skin_quadratic *q;
    const double *reference, *gradient;
    double *weights;
    const uint32_t *groups; // of the running colour
    bool backward;
    uint32_t kept;     // slots to keep, or 0
    uint32_t *allowed; // of the quadratic, if slots are taken away
} sweep_job;

// Adds the row of a vertex: its slots that have weight or may have. `positions` (by slots, or NULL)
// receives where they are.
static void load_row(const sweep_job *job, size_t v, pci_skin_group *g, uint32_t *positions) {
    const pci_skin_quadratic *q = job->q;
    uint32_t next = g->row_offsets[g->row_count];
    g->vertices[g->row_count] = (uint32_t)v;
    g->row_numbers[v] = ++g->row_count;
    for (size_t k = 0; k < q->slots; ++k) {
        const size_t slot = q->slots * v + k;
        const double moved = job->weights[slot] - job->reference[slot];
        if ((q->allowed[v] >> k & 1) == 0 && moved == 0.0) {
            continue;
        }
        const uint32_t bone = q->bones[slot];
        if (g->bone_numbers[bone] == 0) {
            g->bones[g->bone_count] = bone;
            g->bone_numbers[bone] = ++g->bone_count;
        }
        if (positions != NULL) {
            positions[k] = next;
        }
        g->places[next] = g->bone_numbers[bone] - 1;
        g->moved[next++] = moved;
    }
    g->row_offsets[g->row_count] = next;
}

// Collects the rows that a group needs, its own first, with bones numbered by their first
// appearance; and the rows of G of its own bones.
static void load_group(const sweep_job *job, uint32_t group, pci_skin_group *g) {
    const pci_skin_quadratic *q = job->q;
    const size_t first = q->group_offsets[group], last = q->group_offsets[group + 1];
    g->row_count = g->bone_count = 0;
    for (size_t m = first; m < last; ++m) {
        load_row(job, q->members[m], g, &g->positions[q->slots * (m - first)]);
    }
    const size_t own_bones = g->bone_count;
    for (size_t m = first; m < last; ++m) {
        const uint32_t v = q->members[m];
        for (size_t e = q->offsets[v]; e < q->offsets[v + 1]; ++e) {
            if (g->row_numbers[q->columns[e]] == 0) {
                load_row(job, q->columns[e], g, NULL);
            }
        }
    }
    const size_t width = q->width;
    double *to = g->gram;
    for (size_t b = 0; b < width * own_bones; ++b) {
        const size_t from = width * g->bones[b / width] + b % width;
        const double *row = &q->gram[width * q->proxy_count * from];
        for (size_t c = 0; c < g->bone_count; ++c) {
            for (size_t k = 0; k < width; ++k) {
                *to++ = row[width * g->bones[c] + k];
            }
        }
    }
    for (size_t b = 0; b < g->bone_count; ++b) {
        g->bone_numbers[g->bones[b]] = 0;
    }
}

// One row as a small program over its allowed slots.
typedef struct row_program {
    uint32_t count;
    uint32_t slots[PCI_SKIN_SLOTS_MAX];
    double a[PCI_SKIN_SLOTS_MAX * PCI_SKIN_SLOTS_MAX];
    double weights[PCI_SKIN_SLOTS_MAX], gradient[PCI_SKIN_SLOTS_MAX];
    double ridge;
} row_program;

// G sum_j M_ij (w_j - w0_j) at one bone, from the sum.
static double multiply_row(const double *row, const double *y, size_t count) {
    double sums[4] = {0};
    size_t b = 0;
    for (; b + 4 <= count; b += 4) {
        for (size_t l = 0; l < 4; ++l) {
            sums[l] += row[b + l] * y[b + l];
        }
    }
    for (; b < count; ++b) {
        sums[0] += row[b] * y[b];
    }
    return (sums[0] + sums[2]) + (sums[1] + sums[3]);
}

// `width` is that of the quadratic, known where this is compiled.
static inline __attribute__((always_inline)) void fill_row(const sweep_job *job, uint32_t v,
                                                           const pci_skin_group *g,
                                                           const uint32_t *positions,
                                                           const size_t width, row_program *r) {
    const pci_skin_quadratic *q = job->q;
    const size_t own = (size_t)v * q->slots, count = width * g->bone_count;
    const double *x = &q->points[v * width];
    double *y = g->accumulator, trace = 0.0;
    memset(y, 0, count * sizeof(*y));
    for (size_t e = q->offsets[v]; e < q->offsets[v + 1]; ++e) {
        const uint32_t row = g->row_numbers[q->columns[e]] - 1;
        const double value = q->values[e], *other = &q->points[q->columns[e] * width];
        for (size_t k = g->row_offsets[row]; k < g->row_offsets[row + 1]; ++k) {
            const double moved = value * g->moved[k];
            for (size_t c = 0; c < width; ++c) {
                y[width * g->places[k] + c] += width > 1 ? moved * other[c] : moved;
            }
        }
    }
    const double diagonal = q->values[q->offsets[v]];
    uint32_t places[PCI_SKIN_SLOTS_MAX];
    r->count = 0;
    for (uint32_t k = 0; k < q->slots; ++k) {
        if (q->allowed[v] >> k & 1) {
            places[r->count] = g->places[positions[k]];
            r->slots[r->count] = k;
            r->weights[r->count++] = job->weights[own + k];
        }
    }
    for (uint32_t i = 0; i < r->count; ++i) {
        const double *rows = &g->gram[count * width * places[i]];
        double sum = multiply_row(rows, y, count);
        for (size_t k = 1; k < width; ++k) {
            sum += x[k] * multiply_row(&rows[k * count], y, count);
        }
        r->gradient[i] = job->gradient[own + r->slots[i]] + sum;
        for (uint32_t j = 0; j < r->count; ++j) {
            const double product =
                pci_skin_gram_product(g->gram, g->bone_count, width, places[i], places[j], x, x);
            r->a[i * r->count + j] = diagonal * product;
        }
        trace += r->a[i * r->count + i];
    }
    r->ridge = ridge_share * trace + DBL_MIN;
}

static void extract_row(const sweep_job *job, uint32_t v, const pci_skin_group *g,
                        const uint32_t *positions, row_program *r) {
    if (job->q->width == 1) {
        fill_row(job, v, g, positions, 1, r);
    } else {
        fill_row(job, v, g, positions, PCI_SKIN_COLUMNS_MAX, r);
    }
}

// Takes one slot away; its weight goes to the others in proportion.
static void drop_slot(row_program *r, uint32_t out) {
    const uint32_t n = r->count;
    const double left = 1.0 - r->weights[out];
    for (uint32_t i = 0; i < n; ++i) {
        const double next = i == out     ? 0.0
                            : left > 0.0 ? r->weights[i] / left
                                         : 1.0 / (double)(n - 1);
        const double moved = next - r->weights[i];
        r->weights[i] = next;
        for (uint32_t j = 0; j < n; ++j) {
            r->gradient[j] += r->a[i * n + j] * moved;
        }
    }
    uint32_t to = 0;
    for (uint32_t i = 0; i < n; ++i) {
        if (i == out) {
            continue;
        }
        r->slots[to] = r->slots[i];
        r->weights[to] = r->weights[i];
        r->gradient[to] = r->gradient[i];
        for (uint32_t j = 0, at = 0; j < n; ++j) {
            if (j != out) {
                r->a[to * (n - 1) + at++] = r->a[i * n + j];
            }
        }
        ++to;
    }
    r->count = n - 1;
}

static void minimize_row(const sweep_job *job, uint32_t v, const pci_skin_group *g) {
    const pci_skin_quadratic *q = job->q;
    const size_t own = (size_t)v * q->slots;
    const uint32_t *positions = &g->positions[(size_t)q->slots * (g->row_numbers[v] - 1)];
    row_program r;
    extract_row(job, v, g, positions, &r);
    pci_simplex_minimize(r.count, r.a, r.ridge, r.weights, r.gradient);
    while (job->kept > 0 && r.count > job->kept) {
        const uint32_t out = pci_simplex_least(r.count, r.a, r.ridge, r.weights);
        const uint32_t slot = r.slots[out];
        job->allowed[v] &= ~((uint32_t)1 << slot);
        job->weights[own + slot] = 0.0;
        g->moved[positions[slot]] = -job->reference[own + slot];
        drop_slot(&r, out);
        pci_simplex_minimize(r.count, r.a, r.ridge, r.weights, r.gradient);
    }
    for (uint32_t i = 0; i < r.count; ++i) {
        const uint32_t slot = r.slots[i];
        job->weights[own + slot] = r.weights[i];
        g->moved[positions[slot]] = r.weights[i] - job->reference[own + slot];
    }
}

static void sweep_groups(void *user, size_t begin, size_t end, uint32_t worker) {
    const sweep_job *job = user;
    const pci_skin_quadratic *q = job->q;
    pci_skin_group *g = &q->loaded[worker];
    for (size_t i = begin; i < end; ++i) {
        const uint32_t group = job->groups[i];
        const uint32_t first = q->group_offsets[group], last = q->group_offsets[group + 1];
        load_group(job, group, g);
        for (uint32_t m = first; m < last; ++m) {
            minimize_row(job, q->members[job->backward ? last - 1 - (m - first) : m], g);
        }
        for (size_t r = 0; r < g->row_count; ++r) {
            g->row_numbers[g->vertices[r]] = 0;
        }
    }
}

static void run_sweep(sweep_job *job) {
    const pci_skin_quadratic *q = job->q;
    for (uint32_t c = 0; c < q->colour_count; ++c) {
        const uint32_t colour = job->backward ? q->colour_count - 1 - c : c;
        const uint32_t first = q->colour_offsets[colour], last = q->colour_offsets[colour + 1];
        job->groups = &q->groups[first];
        pci_parallel_for(q->context, last - first, GRAIN, sweep_groups, job);
    }
}

void pci_skin_quadratic_sweep(const pci_skin_quadratic *q, const double *reference,
                              const double *gradient, bool backward, double *weights) {
    sweep_job job = {.q = q,
                     .reference = reference,
                     .gradient = gradient,
                     .weights = weights,
                     .backward = backward};
    run_sweep(&job);
}

void pci_skin_quadratic_prune(const pci_skin_quadratic *q, const double *reference,
                              const double *gradient, uint32_t kept, uint32_t *allowed,
                              double *weights) {
    sweep_job job = {.q = q,
                     .reference = reference,
                     .gradient = gradient,
                     .weights = weights,
                     .kept = kept,
                     .allowed = allowed};
    run_sweep(&job);
}
