#include "solvers/elimination.h"


// The least cost of everything already eliminated around vertex `top`, as a function of the labels
// of the vertices in `scope`; entry bit k is the label of scope[k].
typedef struct table {
    uint32_t top;
    uint32_t width;
    uint32_t *scope; // in order of elimination
    int64_t *values; // 2^width, NULL once used up
    uint8_t *choice; // 2^width bits: the best label of `top`
    uint32_t next;   // list of tables with the same first scope vertex
} table;

typedef struct elimination {
    pc_context *context;
    pci_scratch *scratch;
    const pci_signed_graph *graph;
    pci_signed_rows rows;
    uint32_t *position; // of a vertex in the order
    table *tables;      // in order of elimination
    size_t table_count;
} elimination;

// ---- order --------------------------------------------------------------------------------------

typedef struct neighbours {
    uint32_t *list;
    size_t count, capacity;
} neighbours;

// Vertices by degree, as doubly linked lists.
typedef struct degrees {
    uint32_t *first; // by degree
    uint32_t *next, *previous;
} degrees;

static void degrees_insert(degrees *d, uint32_t v, size_t degree) {
    d->previous[v] = PC_INVALID_INDEX;
    d->next[v] = d->first[degree];
    if (d->next[v] != PC_INVALID_INDEX) {
        d->previous[d->next[v]] = v;
    }
    d->first[degree] = v;
}

static void degrees_remove(degrees *d, uint32_t v, size_t degree) {
    if (d->previous[v] != PC_INVALID_INDEX) {
        d->next[d->previous[v]] = d->next[v];
    } else {
        d->first[degree] = d->next[v];
    }
    if (d->next[v] != PC_INVALID_INDEX) {
        d->previous[d->next[v]] = d->previous[v];
    }
}

// Replaces `v` in the neighbourhood of `u` by the other neighbours of `v`.
static bool connect(pci_scratch *scratch, neighbours *all, uint32_t u, uint32_t v, uint8_t *mark) {
    neighbours *mine = &all[u];
    const neighbours *other = &all[v];
    if (!pci_scratch_reserve(scratch, (void **)&mine->list, &mine->capacity,
                             mine->count + other->count, sizeof(*mine->list))) {
        return false;
    }
    size_t kept = 0;
    for (size_t k = 0; k < mine->count; ++k) {
        if (mine->list[k] != v) {
            mine->list[kept++] = mine->list[k];
            mark[mine->list[k]] = 1;
        }
    }
    mark[u] = 1;
    for (size_t k = 0; k < other->count; ++k) {
        if (!mark[other->list[k]]) {
            mine->list[kept++] = other->list[k];
        }
    }
    mark[u] = 0;
    mine->count = kept;
    for (size_t k = 0; k < kept; ++k) {
        mark[mine->list[k]] = 0;
    }
    return true;
}

// Least degree first. Records the scope of every table; false in `fits` when the limits are passed.
static bool choose_order(elimination *s, uint32_t max_width, uint64_t max_entries, bool *fits) {
    const size_t n = s->graph->vertex_count;
    neighbours *all = PCI_SCRATCH(s->scratch, neighbours, n);
    uint8_t *mark = PCI_SCRATCH(s->scratch, uint8_t, n);
    uint32_t *lists = PCI_SCRATCH(s->scratch, uint32_t, s->rows.offsets[n]); // before they grow
    degrees d = {.first = PCI_SCRATCH(s->scratch, uint32_t, n + 1),
                 .next = PCI_SCRATCH(s->scratch, uint32_t, n),
                 .previous = PCI_SCRATCH(s->scratch, uint32_t, n)};
    if (s->scratch->failed) {
        return false;
    }
    memset(d.first, 0xff, (n + 1) * sizeof(*d.first));
    for (size_t left = n; left-- > 1;) {
        const uint32_t v = (uint32_t)left;
        const size_t begin = s->rows.offsets[v], end = s->rows.offsets[v + 1];
        all[v].list = &lists[begin];
        all[v].capacity = end - begin;
        for (size_t k = begin; k < end; ++k) {
            const uint32_t w = pci_signed_other(&s->graph->edges[s->rows.edges[k]], v);
            if (w != PCI_GROUND) {
                all[v].list[all[v].count++] = w;
            }
        }
        degrees_insert(&d, v, all[v].count);
    }
    uint64_t entries = 0;
    size_t degree = 0;
    *fits = true;
    while (s->table_count + 1 < n) {
        while (d.first[degree] == PC_INVALID_INDEX) {
            ++degree;
        }
        const uint32_t v = d.first[degree];
        entries += UINT64_C(1) << (degree < 63 ? degree : 63);
        if (degree > max_width || entries > max_entries) {
            *fits = false;
            return true;
        }
        degrees_remove(&d, v, degree);
        s->position[v] = (uint32_t)s->table_count;
        s->tables[s->table_count++] =
            (table){.top = v, .width = (uint32_t)degree, .scope = all[v].list};
        const size_t count = all[v].count;
        for (size_t k = 0; k < count; ++k) {
            const uint32_t u = all[v].list[k];
            degrees_remove(&d, u, all[u].count);
            if (!connect(s->scratch, all, u, v, mark)) {
                return false;
            }
            degrees_insert(&d, u, all[u].count);
        }
        degree = degree == 0 ? 0 : degree - 1;
    }
    return true;
}

// ---- tables -------------------------------------------------------------------------------------

enum { CHUNK_BITS = 8, CHUNKS = 4 };

// Moves the bits of an index to the places that `places` says, eight at a time.
typedef struct projection {
    uint32_t chunk[CHUNKS][1 << CHUNK_BITS];
} projection;

// places[k]: where bit k goes, or PC_INVALID_INDEX to drop it.
static void make_projection(projection *p, const uint32_t *places, uint32_t count) {
    memset(p, 0, sizeof(*p));
    for (uint32_t k = 0; k < count; ++k) {
        for (uint32_t i = 0; i < 1 << CHUNK_BITS && places[k] != PC_INVALID_INDEX; ++i) {
            if (i >> (k % CHUNK_BITS) & 1u) {
                p->chunk[k / CHUNK_BITS][i] |= 1u << places[k];
            }
        }
    }
}

static uint32_t project(const projection *p, uint32_t index) {
    return p->chunk[0][index & 255u] | p->chunk[1][index >> 8 & 255u] |
           p->chunk[2][index >> 16 & 255u] | p->chunk[3][index >> 24];
}

static uint32_t find(const uint32_t *list, uint32_t count, uint32_t vertex) {
    uint32_t k = 0;
    while (k < count && list[k] != vertex) {
        ++k;
    }
    return k < count ? k : PC_INVALID_INDEX;
}

// sum[index] over the scope of `t` and, as highest bit, its top: adds the edges from the top to
// vertices that are still there.
static void add_edges(const elimination *s, const table *t, int64_t *sum) {
    const uint32_t top_bit = t->width;
    const size_t size = (size_t)2 << t->width;
    for (size_t k = s->rows.offsets[t->top]; k < s->rows.offsets[t->top + 1]; ++k) {
        const pci_signed_edge *edge = &s->graph->edges[s->rows.edges[k]];
        const uint32_t w = pci_signed_other(edge, t->top);
        const uint32_t bit = w == PCI_GROUND ? 0 : find(t->scope, t->width, w);
        if (bit == PC_INVALID_INDEX) {
            continue; // eliminated before, inside a table
        }
        for (size_t i = 0; i < size; ++i) {
            const size_t other = w == PCI_GROUND ? 1 : i >> bit & 1;
            sum[i] += ((i >> top_bit & 1) != other) != edge->opposite ? edge->cost : 0;
        }
    }
}

static bool fill_table(elimination *s, uint32_t index, uint32_t *first) {
    table *t = &s->tables[index];
    const size_t size = (size_t)1 << t->width;
    int64_t *sum = PCI_ALLOCATE(s->context, int64_t, 2 * size);
    t->values = PCI_ALLOCATE(s->context, int64_t, size);
    t->choice = pci_scratch_allocate(s->scratch, (size + 7) / 8, 1);
    bool ok = sum != NULL && t->values != NULL && t->choice != NULL;
    if (ok) {
        add_edges(s, t, sum);
        for (uint32_t k = first[index]; k != PC_INVALID_INDEX; k = s->tables[k].next) {
            table *child = &s->tables[k];
            uint32_t places[PCI_ELIMINATION_MAX_WIDTH + 1];
            for (uint32_t b = 0; b <= t->width; ++b) {
                places[b] = find(child->scope, child->width, b < t->width ? t->scope[b] : t->top);
            }
            projection p;
            make_projection(&p, places, t->width + 1);
            for (uint32_t i = 0; i < 2 * size; ++i) {
                sum[i] += child->values[project(&p, i)];
            }
            pc_release(s->context, child->values);
            child->values = NULL;
        }
        for (size_t i = 0; i < size; ++i) {
            const bool one = sum[size + i] <= sum[i]; // label 1 on a tie
            t->values[i] = one ? sum[size + i] : sum[i];
            t->choice[i / 8] |= (uint8_t)((one ? 1 : 0) << (i % 8));
        }
        // Pass on to the vertex of the scope that is eliminated first.
        uint32_t parent = PC_INVALID_INDEX;
        for (uint32_t k = 0; k < t->width; ++k) {
            const uint32_t position = s->position[t->scope[k]];
            parent = position < parent ? position : parent;
        }
        if (parent != PC_INVALID_INDEX) {
            t->next = first[parent];
            first[parent] = index;
        }
    }
    pc_release(s->context, sum);
    return ok;
}

bool pci_eliminate(pc_context *context, const pci_signed_graph *graph, uint32_t max_width,
                   uint64_t max_entries, uint8_t *labels, bool *solved) {
    const size_t n = graph->vertex_count;
    pci_scratch scratch = pci_scratch_begin(context);
    elimination s = {.context = context, .scratch = &scratch, .graph = graph};
    s.position = PCI_SCRATCH(&scratch, uint32_t, n);
    s.tables = PCI_SCRATCH(&scratch, table, n);
    uint32_t *first = PCI_SCRATCH(&scratch, uint32_t, n);
    const uint32_t width =
        max_width < PCI_ELIMINATION_MAX_WIDTH ? max_width : PCI_ELIMINATION_MAX_WIDTH;
    *solved = false;
    bool ok = !scratch.failed && pci_signed_graph_rows(&scratch, graph, &s.rows) &&
              choose_order(&s, width, max_entries, solved);
    if (ok && *solved) {
        memset(first, 0xff, n * sizeof(*first));
        for (uint32_t k = 0; k < s.table_count && ok; ++k) {
            ok = fill_table(&s, k, first);
        }
        // Backwards: each vertex takes the best label given those of its scope.
        labels[PCI_GROUND] = 1;
        for (size_t k = s.table_count; k-- > 0 && ok;) {
            const table *t = &s.tables[k];
            size_t index = 0;
            for (uint32_t b = 0; b < t->width; ++b) {
                index |= (size_t)labels[t->scope[b]] << b;
            }
            labels[t->top] = (uint8_t)((uint32_t)t->choice[index / 8] >> (index % 8) & 1u);
        }
    }
    for (size_t k = 0; k < s.table_count; ++k) {
        pc_release(context, s.tables[k].values);
    }
    *solved = *solved && ok;
    pci_scratch_end(&scratch);
    return ok;
}
