// Rows of the matrix M, in groups for the sweeps.
#include "stages/skin/skin_matrix.h"

#include "stages/skin/skin_layers.h"

double pci_skin_ring_scale(const double scale[4]) {
    return scale[0] + fmax(scale[3] / 3.0, 0.5 * (scale[3] - scale[0]));
}

// ---- rows ---------------------------------------------------------------------------------------

// A row of M / 2 while it is made, the diagonal first.
typedef struct row_builder {
    const double *scale; // of the losses
    uint32_t *places;    // #V: 1 + place in the row, or 0
    uint32_t *columns;
    double *values;
    uint32_t count;
} row_builder;

static void add_entry(row_builder *b, uint32_t column, double value) {
    if (b->places[column] == 0) {
        b->columns[b->count] = column;
        b->values[b->count] = 0.0;
        b->places[column] = ++b->count;
    }
    b->values[b->places[column] - 1] += value;
}

// K(j) lists by their member i.
typedef struct incoming_lists {
    size_t *offsets;
    uint32_t *edges; // of K
} incoming_lists;

static bool build_incoming(pci_scratch *scratch, const pci_skin_problem *p, incoming_lists *in) {
    const size_t nv = p->vertex_count, k = p->near_count;
    in->offsets = PCI_SCRATCH(scratch, size_t, nv + 2);
    in->edges = PCI_SCRATCH(scratch, uint32_t, k * nv);
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
        in->edges[in->offsets[p->near[e] + 1]++] = (uint32_t)e;
    }
    return true;
}

static void add_spring(row_builder *b, uint32_t column, double value) {
    add_entry(b, column, -value);
    b->values[0] += value;
}

// Of L_c and L_a, between the vertex i and its neighbour near[e].
static double near_spring(const pci_skin_problem *p, const double scale[4], size_t i, size_t e) {
    return scale[1] * pci_skin_stiffness(p, i, p->near[e]) +
           scale[2] * pci_skin_near_weight(p, i, e);
}

static void build_row(const pci_skin_problem *p, const incoming_lists *in, uint32_t i,
                      double diagonal, row_builder *b) {
    const size_t k = p->near_count;
    const double ring = pci_skin_ring_scale(b->scale);
    b->count = 0;
    add_entry(b, i, 0.0);
    for (size_t e = p->ring_offsets[i]; e < p->ring_offsets[i + 1]; ++e) {
        add_spring(b, p->ring[e], 2.0 * ring * pci_skin_stiffness(p, i, p->ring[e]));
    }
    const pci_skin_layers *layers = p->layers;
    const size_t begin = layers != NULL ? layers->offsets[i] : 0;
    for (size_t e = begin; layers != NULL && e < layers->offsets[i + 1]; ++e) {
        add_entry(b, layers->columns[e], layers->factor * layers->values[e]);
    }
    for (size_t e = k * i; e < k * i + k; ++e) {
        add_spring(b, p->near[e], near_spring(p, b->scale, i, e));
    }
    for (size_t s = in->offsets[i]; s < in->offsets[i + 1]; ++s) {
        const uint32_t e = in->edges[s], r = (uint32_t)(e / k);
        add_spring(b, r, near_spring(p, b->scale, r, e));
    }
    b->values[0] += diagonal;
    for (uint32_t entry = 0; entry < b->count; ++entry) {
        b->places[b->columns[entry]] = 0;
    }
}

// ---- groups and colours -------------------------------------------------------------------------

// Of one thread.
typedef struct group_builder {
    row_builder row;
    uint32_t *numbers; // #V: of the vertices of the group in hand
} group_builder;

// The rows of all groups are visited twice: they are counted, then filled.
typedef struct matrix_job {
    const pci_skin_problem *p;
    double diagonal;
    pci_skin_quadratic *q;
    incoming_lists in;
    group_builder *builders; // #threads
} matrix_job;

// offsets[m + 1] and known_offsets[g + 1] become numbers of entries and of vertices.
static void count_groups(void *user, size_t begin, size_t end, uint32_t worker) {
    const matrix_job *job = user;
    const pci_skin_quadratic *q = job->q;
    group_builder *b = &job->builders[worker];
    for (uint32_t g = (uint32_t)begin; g < end; ++g) {
        const size_t first = pci_skin_group_begin(q, g), last = pci_skin_group_begin(q, g + 1);
        for (size_t m = first; m < last; ++m) {
            build_row(job->p, &job->in, q->members[m], 0.0, &b->row);
            q->offsets[m + 1] = b->row.count;
            for (uint32_t e = 0; e < b->row.count; ++e) {
                uint32_t *mark = &b->numbers[b->row.columns[e]];
                q->known_offsets[g + 1] += *mark != g + 1;
                *mark = g + 1;
            }
        }
    }
}

static void number_vertex(group_builder *b, uint32_t v, uint32_t *known, uint32_t *count) {
    if (b->numbers[v] == 0) {
        known[*count] = v;
        b->numbers[v] = ++*count;
    }
}

static void fill_groups(void *user, size_t begin, size_t end, uint32_t worker) {
    const matrix_job *job = user;
    const pci_skin_quadratic *q = job->q;
    group_builder *b = &job->builders[worker];
    for (uint32_t g = (uint32_t)begin; g < end; ++g) {
        uint32_t *known = &q->known[q->known_offsets[g]], count = 0;
        const size_t first = pci_skin_group_begin(q, g), last = pci_skin_group_begin(q, g + 1);
        for (size_t m = first; m < last; ++m) {
            number_vertex(b, q->members[m], known, &count);
        }
        for (size_t m = first; m < last; ++m) {
            const uint32_t v = q->members[m];
            build_row(job->p, &job->in, v, job->diagonal, &b->row);
            for (uint32_t e = 0; e < b->row.count; ++e) {
                number_vertex(b, b->row.columns[e], known, &count);
                q->entries[q->offsets[m] + e] = b->numbers[b->row.columns[e]] - 1;
                q->values[q->offsets[m] + e] = (float)(2.0 * b->row.values[e]);
            }
        }
        for (uint32_t i = 0; i < count; ++i) {
            b->numbers[known[i]] = 0;
        }
    }
}

// Counts while there is no room.
bool pci_skin_matrix_fill(pci_scratch *scratch, const pci_skin_problem *p, const double scale[4],
                          double diagonal, pci_skin_quadratic *q) {
    const uint32_t threads = pc_context_threads(scratch->context);
    pci_scratch local = pci_scratch_begin(scratch->context);
    matrix_job job = {.p = p,
                      .diagonal = diagonal,
                      .q = q,
                      .builders = PCI_SCRATCH(&local, group_builder, threads)};
    bool good = !local.failed && build_incoming(&local, p, &job.in);
    size_t longest = 0;
    for (size_t v = 0; v < p->vertex_count && good; ++v) {
        const size_t tied =
            p->layers != NULL ? p->layers->offsets[v + 1] - p->layers->offsets[v] : 0;
        const size_t length = 1 + p->near_count + (p->ring_offsets[v + 1] - p->ring_offsets[v]) +
                              (job.in.offsets[v + 1] - job.in.offsets[v]) + tied;
        longest = length > longest ? length : longest;
    }
    for (uint32_t i = 0; i < threads && good; ++i) {
        group_builder *b = &job.builders[i];
        b->numbers = PCI_SCRATCH(&local, uint32_t, p->vertex_count);
        b->row.places = PCI_SCRATCH(&local, uint32_t, p->vertex_count);
        b->row.columns = PCI_SCRATCH(&local, uint32_t, longest);
        b->row.values = PCI_SCRATCH(&local, double, longest);
        b->row.scale = scale;
        good = !local.failed;
    }
    if (good) {
        pci_parallel_for(scratch->context, q->group_count, 1,
                         q->entries == NULL ? count_groups : fill_groups, &job);
    }
    pci_scratch_end(&local);
    return good;
}

static void add_up_offsets(size_t count, size_t *offsets) {
    for (size_t i = 0; i < count; ++i) {
        offsets[i + 1] += offsets[i];
    }
}

static bool build_groups(pci_scratch *scratch, const pci_skin_problem *p, const double scale[4],
                         double diagonal, pci_skin_quadratic *q) {
    q->group_count = (uint32_t)((q->vertex_count + PCI_SKIN_GROUP - 1) / PCI_SKIN_GROUP);
    q->members = p->order;
    q->offsets = PCI_SCRATCH(scratch, size_t, q->vertex_count + 1);
    q->known_offsets = PCI_SCRATCH(scratch, size_t, (size_t)q->group_count + 1);
    if (scratch->failed || !pci_skin_matrix_fill(scratch, p, scale, diagonal, q)) {
        return false;
    }
    add_up_offsets(q->vertex_count, q->offsets);
    add_up_offsets(q->group_count, q->known_offsets);
    q->known = PCI_SCRATCH(scratch, uint32_t, q->known_offsets[q->group_count]);
    q->entries = PCI_SCRATCH(scratch, uint32_t, q->offsets[q->vertex_count]);
    q->values = PCI_SCRATCH(scratch, float, q->offsets[q->vertex_count]);
    return !scratch->failed && pci_skin_matrix_fill(scratch, p, scale, diagonal, q);
}

// Each group takes the first colour that no group it shares an entry of M with has.
static bool colour_groups(pci_scratch *scratch, pci_skin_quadratic *q) {
    pci_scratch local = pci_scratch_begin(scratch->context);
    uint32_t *taken = PCI_SCRATCH(&local, uint32_t, (size_t)q->group_count + 2);
    q->group_of = PCI_SCRATCH(scratch, uint32_t, q->vertex_count);
    q->colours = PCI_SCRATCH(scratch, uint32_t, q->group_count);
    q->groups = PCI_SCRATCH(scratch, uint32_t, 2 * (size_t)q->group_count);
    const bool good = !scratch->failed && !local.failed;
    for (size_t m = 0; m < q->vertex_count && good; ++m) {
        q->group_of[q->members[m]] = (uint32_t)(m / PCI_SKIN_GROUP);
    }
    uint32_t last = 0;
    for (uint32_t g = 0; g < q->group_count && good; ++g) {
        for (size_t i = q->known_offsets[g]; i < q->known_offsets[g + 1]; ++i) {
            taken[q->colours[q->group_of[q->known[i]]]] = g + 1; // 0: none yet
        }
        uint32_t colour = 1;
        while (taken[colour] == g + 1) {
            ++colour;
        }
        q->colours[g] = colour;
        last = colour > last ? colour : last;
    }
    size_t next = 0;
    for (uint32_t c = 0; c < 2 * last; ++c) {
        for (uint32_t g = 0; g < q->group_count; ++g) {
            if (q->colours[g] == (c < last ? c + 1 : 2 * last - c)) {
                q->groups[next++] = g;
            }
        }
    }
    pci_scratch_end(&local);
    return good;
}

bool pci_skin_matrix_build(pci_scratch *scratch, const pci_skin_problem *problem,
                           const double scale[4], double diagonal, pci_skin_quadratic *q) {
    return build_groups(scratch, problem, scale, diagonal, q) && colour_groups(scratch, q);
}
