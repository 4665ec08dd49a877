#include "core/cycle_bound.h"

#include <stdlib.h>

#include "core/cycle_program.h"
#include "core/signed_search.h"
#include "core/union_find.h"

enum { ITERATIONS = 80, TREES = 6, CUTS_PER_EDGE = 8, MAX_IDLE = 3 };
#define MIN_VIOLATION 0.01
#define HOP_LENGTH    1e-3 // prefers short cycles
#define CONVERGED     1e-5 // relative error of the linear program

// ---- violated cycles ----------------------------------------------------------------------------

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
    pci_signed_rows rows;
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

static int compare_candidates(const void *left, const void *right) {
    const candidate *l = left, *r = right;
    if (l->length < r->length || l->length > r->length) {
        return l->length < r->length ? -1 : 1;
    }
    return (l->edge > r->edge) - (l->edge < r->edge);
}

static bool make_tree(pci_cycle_program *p, tree *t) {
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
    return !p->scratch->failed && pci_signed_graph_rows(p->scratch, p->graph, &t->rows);
}

// Dijkstra's algorithm; among paths of equal violation the one with fewer edges.
static void grow_tree(const pci_cycle_program *p, tree *t, uint32_t root) {
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
        for (size_t k = t->rows.offsets[v]; k < t->rows.offsets[v + 1]; ++k) {
            const uint32_t e = t->rows.edges[k];
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
static size_t close_cycle(const pci_cycle_program *p, tree *t, uint32_t edge, double *length) {
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
static bool add_tree_cycles(pci_cycle_program *p, tree *t, size_t *new_count) {
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
        if (fresh && !pci_cycle_program_add(p, t->cycle, count, &fresh)) {
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
static bool separate(pci_cycle_program *p, tree *t, uint32_t round, size_t *new_count) {
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

// ---- rounds ------------------------------------------------------------------------------------

// Vertices that stay when every edge whose wish must be granted is contracted.
static size_t count_contracted(const pci_signed_graph *graph, const int64_t *residuals, int64_t gap,
                               uint32_t *parent) {
    size_t left = graph->vertex_count;
    pci_singletons(parent, graph->vertex_count);
    for (size_t e = 0; e < graph->edge_count; ++e) {
        if (residuals[e] >= gap) {
            left -= pci_unite(parent, graph->edges[e].a, graph->edges[e].b);
        }
    }
    return left;
}

pc_status pci_find_cycle_bound(pci_scratch *scratch, const char *stage,
                               const pci_signed_graph *graph, pci_budget *budget, uint8_t *labels,
                               pci_cycle_bound *result) {
    const size_t n = graph->vertex_count, m = graph->edge_count;
    pc_context *context = scratch->context;
    pci_scratch local = pci_scratch_begin(context);
    pci_cycle_program program;
    tree t = {0};
    pc_status status = PC_OK;
    result->residuals = PCI_SCRATCH(scratch, int64_t, m);
    result->bound = graph->constant;
    uint32_t *parent = PCI_SCRATCH(&local, uint32_t, n);
    if (scratch->failed || !pci_cycle_program_create(&local, graph, &program) ||
        !make_tree(&program, &t)) {
        status = pci_fail_memory(context, stage);
        goto cleanup;
    }
    for (size_t e = 0; e < m; ++e) {
        result->residuals[e] = graph->edges[e].cost;
    }
    uint32_t idle = 0; // rounds without progress
    for (uint32_t round = 0; budget->left != 0 && idle < MAX_IDLE; ++round) {
        if (!pci_progress(context, stage, pci_budget_used(budget))) {
            status = pci_fail_cancelled(context, stage);
            goto cleanup;
        }
        size_t added = 0;
        if (!separate(&program, &t, round, &added)) {
            status = pci_fail_memory(context, stage);
            goto cleanup;
        }
        const double error = pci_cycle_program_iterate(&program, ITERATIONS);
        const uint64_t used = (program.entry_count + m) * ITERATIONS + 40 * TREES * m;
        budget->left -= used < budget->left ? used : budget->left;
        result->bound = graph->constant + pci_cycle_program_pack(&program, result->residuals);
        if (!pci_signed_search(context, graph, program.y, 0, labels)) {
            status = pci_fail_memory(context, stage);
            goto cleanup;
        }
        const int64_t gap = pci_signed_graph_cost(graph, labels) - result->bound;
        if (gap <= 0 || 2 * count_contracted(graph, result->residuals, gap, parent) < n) {
            break;
        }
        idle = added == 0 && error < CONVERGED ? idle + 1 : 0;
        pci_cycle_program_purge(&program);
    }
cleanup:
    pci_scratch_end(&local);
    return status;
}
