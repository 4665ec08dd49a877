#include "core/cycle_bound.h"

#include "core/signed_search.h"
#include <stdlib.h>

enum { CUTS_PER_EDGE = 2, FIRST_ITERATIONS = 100, ITERATIONS = 200, CHECK_EVERY = 40, TREES = 10 };
#define CONVERGED     1e-5 // relative error of the linear program
#define MIN_VIOLATION 0.01
#define HOP_LENGTH    1e-3

// The cycles, as lists of edges, with the two sides of the linear program
//   min c y,  sum of y over each cycle >= 1,  0 <= y <= 1.
typedef struct program {
    pci_scratch *scratch;
    const pci_signed_graph *graph;
    pci_signed_rows rows;
    double scale; // real cost = integer cost * scale
    double *costs;
    double *y, *y_bar, *y_sum, *y_start, *load;
    uint32_t *degrees; // cycles through an edge
    size_t cycle_count, cycle_capacity, sum_capacity, start_capacity, hash_capacity;
    size_t entry_count, entry_capacity, offset_capacity;
    size_t *offsets;
    uint32_t *entries;
    double *f, *f_sum, *f_start;
    uint64_t *hashes;
    size_t set_size;
    uint64_t *set; // open addressing, 0 = empty
    double weight; // primal weight
    double sum_count;
} program;

// ---- cycles -------------------------------------------------------------------------------------

typedef struct heap_item {
    double distance;
    uint32_t node;
} heap_item;

typedef struct candidate {
    double length;
    uint32_t edge;
} candidate;

// A tree of shortest paths and the cycles that single edges close in it.
typedef struct tree {
    uint32_t *via;   // edge to the parent
    uint32_t *depth; // number of edges to the root
    uint8_t *parity; // of the opposite edges on the way to the root
    double *distance;
    uint8_t *done;
    heap_item *heap;
    size_t heap_count;
    double *lengths; // of the edges
    candidate *candidates;
    uint32_t *cycle; // edges of one cycle
    uint32_t *used;  // new cycles through an edge in this round
} tree;

static bool before(heap_item a, heap_item b) {
    return a.distance < b.distance || (a.distance <= b.distance && a.node < b.node);
}

static void heap_push(tree *x, heap_item item) {
    size_t k = x->heap_count++;
    for (; k > 0 && before(item, x->heap[(k - 1) / 2]); k = (k - 1) / 2) {
        x->heap[k] = x->heap[(k - 1) / 2];
    }
    x->heap[k] = item;
}

static heap_item heap_pop(tree *x) {
    const heap_item top = x->heap[0], last = x->heap[--x->heap_count];
    size_t k = 0;
    for (;;) {
        size_t child = 2 * k + 1;
        if (child >= x->heap_count) {
            break;
        }
        child += child + 1 < x->heap_count && before(x->heap[child + 1], x->heap[child]) ? 1 : 0;
        if (!before(x->heap[child], last)) {
            break;
        }
        x->heap[k] = x->heap[child];
        k = child;
    }
    x->heap[k] = last;
    return top;
}

// Enters the hash; false when it is there already.
static bool enter(program *p, uint64_t hash) {
    size_t slot = hash % p->set_size;
    while (p->set[slot] != 0) {
        if (p->set[slot] == hash) {
            return false;
        }
        slot = slot + 1 < p->set_size ? slot + 1 : 0;
    }
    p->set[slot] = hash;
    return true;
}

static bool grow_set(program *p) {
    if (p->set != NULL && 2 * (p->cycle_count + 1) < p->set_size) {
        return true;
    }
    p->set_size = 2 * p->set_size + 4096;
    p->set = PCI_SCRATCH(p->scratch, uint64_t, p->set_size);
    if (p->set == NULL) {
        return false;
    }
    for (size_t k = 0; k < p->cycle_count; ++k) {
        enter(p, p->hashes[k]);
    }
    return true;
}

static bool add_cycle(program *p, const uint32_t *edges, size_t count, bool *added) {
    uint64_t hash = 1;
    for (size_t k = 0; k < count; ++k) {
        hash += pci_random_bits(0, 0, edges[k]);
    }
    *added = false;
    if (!grow_set(p)) {
        return false;
    }
    if (!enter(p, hash | 1)) {
        return true;
    }
    if (!pci_scratch_reserve(p->scratch, (void **)&p->f, &p->cycle_capacity, p->cycle_count + 1,
                             sizeof(double)) ||
        !pci_scratch_reserve(p->scratch, (void **)&p->f_sum, &p->sum_capacity, p->cycle_count + 1,
                             sizeof(double)) ||
        !pci_scratch_reserve(p->scratch, (void **)&p->f_start, &p->start_capacity,
                             p->cycle_count + 1, sizeof(double)) ||
        !pci_scratch_reserve(p->scratch, (void **)&p->hashes, &p->hash_capacity, p->cycle_count + 1,
                             sizeof(uint64_t)) ||
        !pci_scratch_reserve(p->scratch, (void **)&p->offsets, &p->offset_capacity,
                             p->cycle_count + 2, sizeof(size_t)) ||
        !pci_scratch_reserve(p->scratch, (void **)&p->entries, &p->entry_capacity,
                             p->entry_count + count, sizeof(uint32_t))) {
        return false;
    }
    for (size_t k = 0; k < count; ++k) {
        p->entries[p->entry_count++] = edges[k];
        ++p->degrees[edges[k]];
    }
    p->f[p->cycle_count] = p->f_sum[p->cycle_count] = p->f_start[p->cycle_count] = 0.0;
    p->hashes[p->cycle_count] = hash | 1;
    p->offsets[++p->cycle_count] = p->entry_count;
    *added = true;
    return true;
}

static int compare_candidates(const void *left, const void *right) {
    const candidate *l = left, *r = right;
    if (l->length < r->length || l->length > r->length) {
        return l->length < r->length ? -1 : 1;
    }
    return (l->edge > r->edge) - (l->edge < r->edge);
}

static bool make_tree(program *p, tree *t) {
    const size_t n = p->graph->vertex_count, m = p->graph->edge_count;
    t->via = PCI_SCRATCH(p->scratch, uint32_t, n);
    t->depth = PCI_SCRATCH(p->scratch, uint32_t, n);
    t->parity = PCI_SCRATCH(p->scratch, uint8_t, n);
    t->distance = PCI_SCRATCH(p->scratch, double, n);
    t->done = PCI_SCRATCH(p->scratch, uint8_t, n);
    t->heap = PCI_SCRATCH(p->scratch, heap_item, 2 * m + 1);
    t->lengths = PCI_SCRATCH(p->scratch, double, m);
    t->candidates = PCI_SCRATCH(p->scratch, candidate, m);
    t->cycle = PCI_SCRATCH(p->scratch, uint32_t, n + 1);
    t->used = PCI_SCRATCH(p->scratch, uint32_t, m);
    return !p->scratch->failed;
}

// Dijkstra's algorithm; among paths of equal violation the one with fewer edges.
static void grow_tree(const program *p, tree *t, uint32_t root) {
    const pci_signed_graph *graph = p->graph;
    for (size_t v = 0; v < graph->vertex_count; ++v) {
        t->distance[v] = (double)INFINITY;
        t->done[v] = 0;
        t->depth[v] = PC_INVALID_INDEX;
    }
    t->depth[root] = 0;
    t->parity[root] = 0;
    t->distance[root] = 0.0;
    t->heap_count = 0;
    heap_push(t, (heap_item){0.0, root});
    while (t->heap_count != 0) {
        const uint32_t v = heap_pop(t).node;
        if (t->done[v]) {
            continue;
        }
        t->done[v] = 1;
        for (size_t k = p->rows.offsets[v]; k < p->rows.offsets[v + 1]; ++k) {
            const uint32_t e = p->rows.edges[k];
            const uint32_t w = pci_signed_other(&graph->edges[e], v);
            const double distance = t->distance[v] + t->lengths[e];
            if (distance < t->distance[w]) {
                t->distance[w] = distance;
                t->via[w] = e;
                t->depth[w] = t->depth[v] + 1;
                t->parity[w] = t->parity[v] ^ (graph->edges[e].opposite ? 1 : 0);
                heap_push(t, (heap_item){distance, w});
            }
        }
    }
}

// The cycle that `edge` closes: fills `cycle` and returns its number of edges.
static size_t close_cycle(const program *p, tree *t, uint32_t edge, double *length) {
    uint32_t a = p->graph->edges[edge].a, b = p->graph->edges[edge].b;
    size_t count = 0;
    t->cycle[count++] = edge;
    *length = p->y[edge];
    while (a != b) {
        uint32_t *deeper = t->depth[a] > t->depth[b] ? &a : &b;
        const uint32_t e = t->via[*deeper];
        t->cycle[count++] = e;
        *length += p->y[e];
        *deeper = pci_signed_other(&p->graph->edges[e], *deeper);
    }
    return count;
}

// Adds the violated cycles of one tree, most violated first, at most a few through each edge.
static bool add_tree_cycles(program *p, tree *t, size_t *new_count) {
    const pci_signed_graph *graph = p->graph;
    size_t candidates = 0;
    for (uint32_t e = 0; e < graph->edge_count; ++e) {
        const pci_signed_edge *edge = &graph->edges[e];
        const bool odd = (t->parity[edge->a] != t->parity[edge->b]) != edge->opposite;
        if (odd && t->depth[edge->a] != PC_INVALID_INDEX) {
            double length = 0.0;
            const size_t count = close_cycle(p, t, e, &length);
            if (length < 1.0 - MIN_VIOLATION) {
                t->candidates[candidates++] = (candidate){length + HOP_LENGTH * (double)count, e};
            }
        }
    }
    if (candidates > 1) {
        qsort(t->candidates, candidates, sizeof(candidate), compare_candidates);
    }
    for (size_t i = 0; i < candidates; ++i) {
        double length;
        const size_t count = close_cycle(p, t, t->candidates[i].edge, &length);
        bool fresh = true;
        for (size_t j = 0; j < count && fresh; ++j) {
            fresh = t->used[t->cycle[j]] < CUTS_PER_EDGE;
        }
        if (fresh && !add_cycle(p, t->cycle, count, &fresh)) {
            return false;
        }
        for (size_t j = 0; j < count && fresh; ++j) {
            ++t->used[t->cycle[j]];
        }
        *new_count += fresh;
    }
    return true;
}

// Trees from a few roots, others in each round.
static bool separate(program *p, tree *t, uint32_t round, size_t *new_count) {
    *new_count = 0;
    for (size_t e = 0; e < p->graph->edge_count; ++e) {
        t->lengths[e] = p->y[e] + HOP_LENGTH;
        t->used[e] = 0;
    }
    for (uint32_t k = 0; k < TREES; ++k) {
        grow_tree(p, t, (uint32_t)(pci_random_bits(round, 7, k) % p->graph->vertex_count));
        if (!add_tree_cycles(p, t, new_count)) {
            return false;
        }
    }
    return true;
}

// Forgets cycles that carry nothing and are satisfied with a margin.
static void purge(program *p) {
    size_t kept = 0, entries = 0;
    memset(p->degrees, 0, p->graph->edge_count * sizeof(*p->degrees));
    memset(p->set, 0, p->set_size * sizeof(*p->set));
    for (size_t c = 0, begin = 0; c < p->cycle_count; ++c) {
        const size_t end = p->offsets[c + 1];
        double sum = 0.0;
        for (size_t k = begin; k < end; ++k) {
            sum += p->y[p->entries[k]];
        }
        if (p->f[c] > 0.0 || sum < 1.2) {
            for (size_t k = begin; k < end; ++k) {
                p->entries[entries++] = p->entries[k];
                ++p->degrees[p->entries[k]];
            }
            p->f[kept] = p->f[c];
            p->f_start[kept] = p->f_start[c];
            p->hashes[kept] = p->hashes[c];
            enter(p, p->hashes[c]);
            p->offsets[++kept] = entries;
        }
        begin = end;
    }
    p->cycle_count = kept;
    p->entry_count = entries;
}

// ---- primal-dual hybrid gradient ----------------------------------------------------------------

// One step of Chambolle and Pock with diagonal preconditioning.
static void step(program *p) {
    const size_t m = p->graph->edge_count;
    memset(p->load, 0, m * sizeof(*p->load));
    for (size_t c = 0, begin = 0; c < p->cycle_count; ++c) {
        const size_t end = p->offsets[c + 1];
        double sum = 0.0;
        for (size_t k = begin; k < end; ++k) {
            sum += p->y_bar[p->entries[k]];
        }
        const double f = fmax(0.0, p->f[c] + p->weight / (double)(end - begin) * (1.0 - sum));
        p->f[c] = f;
        p->f_sum[c] += f;
        if (f > 0.0) {
            for (size_t k = begin; k < end; ++k) {
                p->load[p->entries[k]] += f;
            }
        }
        begin = end;
    }
    for (size_t e = 0; e < m; ++e) {
        const double rate = 1.0 / (p->weight * (double)(p->degrees[e] + 1));
        const double moved = p->y[e] - rate * (p->costs[e] - p->load[e]);
        const double y = moved < 0.0 ? 0.0 : moved > 1.0 ? 1.0 : moved;
        p->y_bar[e] = 2.0 * y - p->y[e];
        p->y[e] = y;
        p->y_sum[e] += y;
    }
    p->sum_count += 1.0;
}

// Violation of the optimality conditions by `factor` times (y, f), and the value there.
typedef struct merit {
    double error;
    double value;
} merit;

static merit measure(program *p, const double *y, const double *f, double factor) {
    double *load = p->load; // the next step recomputes it
    double lacking = 0.0, packed = 0.0, value = 0.0;
    memset(load, 0, p->graph->edge_count * sizeof(*load));
    for (size_t c = 0, begin = 0; c < p->cycle_count; ++c) {
        const size_t end = p->offsets[c + 1];
        double sum = 0.0;
        for (size_t k = begin; k < end; ++k) {
            sum += y[p->entries[k]];
            load[p->entries[k]] += factor * f[c];
        }
        const double lack = fmax(0.0, 1.0 - factor * sum);
        lacking += lack * lack;
        packed += factor * f[c];
        begin = end;
    }
    // As y is at most 1, an overload may be paid for instead of avoided.
    for (size_t e = 0; e < p->graph->edge_count; ++e) {
        packed -= fmax(0.0, load[e] - p->costs[e]);
        value += factor * y[e] * p->costs[e];
    }
    const double gap = value - packed;
    return (merit){.error = sqrt(p->weight * p->weight * lacking + gap * gap), .value = value};
}

static void begin_average(program *p) {
    memset(p->y_sum, 0, p->graph->edge_count * sizeof(double));
    memset(p->f_sum, 0, p->cycle_count * sizeof(double));
    p->sum_count = 0.0;
    memcpy(p->y_start, p->y, p->graph->edge_count * sizeof(double));
    memcpy(p->f_start, p->f, p->cycle_count * sizeof(double));
}

static void restart(program *p, bool from_average) {
    const size_t m = p->graph->edge_count;
    const double factor = 1.0 / p->sum_count;
    double dy = 0.0, df = 0.0;
    if (from_average) {
        for (size_t e = 0; e < m; ++e) {
            p->y[e] = factor * p->y_sum[e];
        }
        for (size_t c = 0; c < p->cycle_count; ++c) {
            p->f[c] = factor * p->f_sum[c];
        }
    }
    for (size_t e = 0; e < m; ++e) {
        const double d = p->y[e] - p->y_start[e];
        dy += d * d * (double)(p->degrees[e] + 1);
        p->y_bar[e] = p->y[e];
    }
    for (size_t c = 0; c < p->cycle_count; ++c) {
        const double d = p->f[c] - p->f_start[c];
        df += d * d * (double)(p->offsets[c + 1] - p->offsets[c]);
    }
    if (dy > 1e-20 && df > 1e-20) {
        p->weight = exp(0.5 * log(sqrt(df / dy)) + 0.5 * log(p->weight));
    }
    begin_average(p);
}

// Steps with restarts from the better of the last and the average point; returns the relative
// error (Applegate et al., "Faster first-order primal-dual methods for linear programming using
// restarts and sharpness", 2023).
static double iterate(program *p, uint32_t iterations) {
    double at_start = (double)INFINITY, last = (double)INFINITY, error = 0.0;
    begin_average(p);
    for (uint32_t k = 1; k <= iterations; ++k) {
        step(p);
        if (k % CHECK_EVERY != 0 && k != iterations) {
            continue;
        }
        const merit current = measure(p, p->y, p->f, 1.0);
        const merit average = measure(p, p->y_sum, p->f_sum, 1.0 / p->sum_count);
        const bool from_average = average.error < current.error;
        const merit best = from_average ? average : current;
        error = best.error / fmax(1.0, best.value);
        if (error < 0.2 * at_start || (error < 0.8 * at_start && error > last) || k == iterations) {
            restart(p, from_average);
            at_start = error;
            last = (double)INFINITY;
        } else {
            last = error;
        }
    }
    return error;
}

// ---- certificate --------------------------------------------------------------------------------

// Rounds the packing to integers that fit into the costs.
static void pack(program *p, pci_cycle_bound *result) {
    const pci_signed_graph *graph = p->graph;
    memset(p->load, 0, graph->edge_count * sizeof(*p->load));
    for (size_t c = 0; c < p->cycle_count; ++c) {
        for (size_t k = p->offsets[c]; k < p->offsets[c + 1]; ++k) {
            p->load[p->entries[k]] += p->f[c];
        }
    }
    for (size_t e = 0; e < graph->edge_count; ++e) {
        result->residuals[e] = graph->edges[e].cost;
    }
    // First each cycle gets its share of the most crowded edge, then what room is left.
    int64_t total = 0;
    for (int pass = 0; pass < 2; ++pass) {
        for (size_t c = 0; c < p->cycle_count; ++c) {
            int64_t amount = INT64_MAX;
            double share = 1.0;
            for (size_t k = p->offsets[c]; k < p->offsets[c + 1]; ++k) {
                const uint32_t e = p->entries[k];
                amount = result->residuals[e] < amount ? result->residuals[e] : amount;
                share = fmin(share, p->costs[e] / fmax(p->load[e], p->costs[e]));
            }
            const double wanted = p->f[c] * share / p->scale;
            if (pass == 0 && wanted < (double)amount) {
                amount = (int64_t)wanted;
            }
            for (size_t k = p->offsets[c]; k < p->offsets[c + 1]; ++k) {
                result->residuals[p->entries[k]] -= amount;
            }
            total += amount;
        }
    }
    result->bound = graph->constant + total;
}

// Vertices that stay when every edge whose wish must be granted is contracted.
static size_t count_contracted(const pci_signed_graph *graph, const int64_t *residuals, int64_t gap,
                               uint32_t *parent) {
    size_t left = graph->vertex_count;
    for (uint32_t v = 0; v < graph->vertex_count; ++v) {
        parent[v] = v;
    }
    for (size_t e = 0; e < graph->edge_count; ++e) {
        if (residuals[e] < gap) {
            continue;
        }
        uint32_t ends[2] = {graph->edges[e].a, graph->edges[e].b};
        for (size_t k = 0; k < 2; ++k) {
            while (parent[ends[k]] != ends[k]) {
                ends[k] = parent[ends[k]] = parent[parent[ends[k]]];
            }
        }
        if (ends[0] != ends[1]) {
            parent[ends[0] > ends[1] ? ends[0] : ends[1]] = ends[0] > ends[1] ? ends[1] : ends[0];
            --left;
        }
    }
    return left;
}

bool pci_find_cycle_bound(pci_scratch *scratch, const pci_signed_graph *graph, uint64_t *work,
                          uint8_t *labels, pci_cycle_bound *result) {
    const size_t n = graph->vertex_count, m = graph->edge_count;
    pci_scratch local = pci_scratch_begin(scratch->context);
    program p = {.scratch = &local, .graph = graph, .weight = 1.0};
    tree t = {0};
    result->residuals = PCI_SCRATCH(scratch, int64_t, m);
    result->bound = graph->constant;
    p.costs = PCI_SCRATCH(&local, double, m);
    p.y = PCI_SCRATCH(&local, double, m);
    p.y_bar = PCI_SCRATCH(&local, double, m);
    p.y_sum = PCI_SCRATCH(&local, double, m);
    p.y_start = PCI_SCRATCH(&local, double, m);
    p.load = PCI_SCRATCH(&local, double, m);
    p.degrees = PCI_SCRATCH(&local, uint32_t, m);
    uint32_t *parent = PCI_SCRATCH(&local, uint32_t, n);
    bool ok =
        !scratch->failed && pci_signed_graph_rows(&local, graph, &p.rows) && make_tree(&p, &t) &&
        pci_scratch_reserve(&local, (void **)&p.offsets, &p.offset_capacity, 64, sizeof(size_t));
    double mean = 0.0;
    for (size_t e = 0; e < m && ok; ++e) {
        mean += (double)graph->edges[e].cost / (double)m;
        result->residuals[e] = graph->edges[e].cost;
    }
    p.scale = 1.0 / mean;
    for (size_t e = 0; e < m && ok; ++e) {
        p.costs[e] = (double)graph->edges[e].cost * p.scale;
    }
    uint32_t idle = 0;
    for (uint32_t round = 0; ok && *work != 0 && idle < 3; ++round) {
        size_t added = 0;
        ok = separate(&p, &t, round, &added);
        if (!ok) {
            break;
        }
        const uint32_t iterations = round < 8 ? FIRST_ITERATIONS : ITERATIONS;
        const double error = iterate(&p, iterations);
        const uint64_t used = (p.entry_count + m) * iterations + (uint64_t)TREES * 10 * m;
        *work -= used < *work ? used : *work;
        pack(&p, result);
        ok = pci_signed_search(scratch->context, graph, p.y, 0, labels);
        const int64_t cost = pci_signed_graph_cost(graph, labels);
        const size_t left =
            count_contracted(graph, result->residuals, cost - result->bound, parent);
        if (result->bound >= cost || 2 * left < n) {
            break;
        }
        idle = added == 0 && error < CONVERGED ? idle + 1 : 0;
        purge(&p);
    }
    pci_scratch_end(&local);
    return ok;
}
