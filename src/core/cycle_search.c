#include "core/cycle_search.h"

#include <stdlib.h>

enum {
    LONGEST = 96,      // cycles with more edges are not worth their steps in the program
    CUTS_PER_EDGE = 8, // in one round
    BALL = 100,        // clusters that a search among single vertices settles
    FAR = 1000,        // clusters that one among large clusters settles
    GRAIN = 32
};
#define MIN_VIOLATION 0.01
#define NEGLIGIBLE    0.01F // violation of edges within a cluster
#define HOP_LENGTH    1e-3  // prefers short cycles

typedef struct pci_cluster_arc {
    uint32_t head; // cluster
    uint32_t edge; // twice its index, plus 1 when it is odd with respect to the trees
    float length;
} arc;

typedef struct node {
    float distance;
    uint32_t via, parent, depth; // edge, cluster and number of edges
    uint32_t time;               // of the search that wrote this
    uint8_t parity, settled;
} node;

typedef struct heap_item {
    float distance;
    uint32_t node;
} heap_item;

typedef struct pci_cluster_searcher {
    node *nodes;
    heap_item *heap;
    size_t heap_count;
    uint32_t time;
    uint64_t visited;
} searcher;

typedef struct pci_found_cycle {
    double length;
    uint32_t count; // of edges; 0: none
    uint32_t slot;  // root, or number of roots + closing edge
} found_cycle;

// ---- heap ---------------------------------------------------------------------------------------

static bool before(heap_item a, heap_item b) {
    return a.distance < b.distance || (a.distance <= b.distance && a.node < b.node);
}

static void heap_push(searcher *x, heap_item item) {
    size_t k = x->heap_count++;
    for (; k > 0 && before(item, x->heap[(k - 1) / 2]); k = (k - 1) / 2) {
        x->heap[k] = x->heap[(k - 1) / 2];
    }
    x->heap[k] = item;
}

static heap_item heap_pop(searcher *x) {
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

// ---- clusters -----------------------------------------------------------------------------------

bool pci_cycle_search_create(pci_scratch *scratch, pci_cycle_program *program,
                             pci_cycle_search *s) {
    const pci_signed_graph *graph = program->graph;
    const size_t n = graph->vertex_count, m = graph->edge_count;
    const uint32_t threads = pc_context_threads(scratch->context);
    *s = (pci_cycle_search){.program = program};
    s->clusters = PCI_SCRATCH(scratch, uint32_t, n);
    s->parents = PCI_SCRATCH(scratch, uint32_t, n);
    s->depths = PCI_SCRATCH(scratch, uint32_t, n);
    s->parities = PCI_SCRATCH(scratch, uint8_t, n);
    s->queue = PCI_SCRATCH(scratch, uint32_t, n);
    s->offsets = PCI_SCRATCH(scratch, size_t, n + 2);
    s->arcs = PCI_SCRATCH(scratch, arc, 2 * m);
    s->roots = PCI_SCRATCH(scratch, uint32_t, n);
    s->is_root = PCI_SCRATCH(scratch, uint8_t, n);
    s->found = PCI_SCRATCH(scratch, found_cycle, n + m);
    s->used = PCI_SCRATCH(scratch, uint32_t, m);
    s->searchers = PCI_SCRATCH(scratch, searcher, threads);
    for (uint32_t k = 0; k < threads && !scratch->failed; ++k) {
        s->searchers[k].nodes = PCI_SCRATCH(scratch, node, n);
        s->searchers[k].heap = PCI_SCRATCH(scratch, heap_item, 2 * m + 1);
    }
    return !scratch->failed && pci_signed_graph_rows(scratch, graph, &s->rows);
}

static void grow_cluster(pci_cycle_search *s, uint32_t root, float limit) {
    const pci_signed_graph *graph = s->program->graph;
    const float *y = s->program->y;
    const uint32_t cluster = s->cluster_count++;
    size_t head = 0, tail = 0;
    s->queue[tail++] = root;
    s->clusters[root] = cluster;
    s->parents[root] = PC_INVALID_INDEX;
    s->depths[root] = 0;
    s->parities[root] = 0;
    while (head != tail && root != PCI_GROUND && limit >= 0.0F) {
        const uint32_t v = s->queue[head++];
        for (size_t k = s->rows.offsets[v]; k < s->rows.offsets[v + 1]; ++k) {
            const uint32_t e = s->rows.edges[k];
            const uint32_t w = pci_signed_other(&graph->edges[e], v);
            if (y[e] <= limit && w != PCI_GROUND && s->clusters[w] == PC_INVALID_INDEX) {
                s->clusters[w] = cluster;
                s->parents[w] = e;
                s->depths[w] = s->depths[v] + 1;
                s->parities[w] = s->parities[v] ^ (graph->edges[e].opposite ? 1 : 0);
                s->queue[tail++] = w;
            }
        }
    }
}

// Breadth-first trees over edges whose violation is at most `limit`; single vertices where it is
// negative. Then the arcs between clusters.
static void make_clusters(pci_cycle_search *s, float limit, uint32_t round) {
    const pci_signed_graph *graph = s->program->graph;
    const size_t n = graph->vertex_count;
    memset(s->clusters, 0xff, n * sizeof(*s->clusters));
    s->cluster_count = 0;
    const size_t start = (size_t)(pci_random_bits(round, 7, 0) % n);
    for (size_t i = 0; i < n; ++i) {
        const uint32_t root = (uint32_t)(start + i < n ? start + i : start + i - n);
        if (s->clusters[root] == PC_INVALID_INDEX) {
            grow_cluster(s, root, limit);
        }
    }
    size_t *next = s->offsets + 1;
    memset(s->offsets, 0, (s->cluster_count + 2) * sizeof(*s->offsets));
    for (size_t e = 0; e < graph->edge_count; ++e) {
        const pci_signed_edge *edge = &graph->edges[e];
        if (edge->a != PCI_GROUND && s->clusters[edge->a] != s->clusters[edge->b]) {
            ++next[s->clusters[edge->a] + 1];
            ++next[s->clusters[edge->b] + 1];
        }
    }
    for (size_t c = 0; c < s->cluster_count; ++c) {
        next[c + 1] += next[c];
    }
    for (uint32_t e = 0; e < graph->edge_count; ++e) {
        const pci_signed_edge *edge = &graph->edges[e];
        const uint32_t a = s->clusters[edge->a], b = s->clusters[edge->b];
        if (edge->a != PCI_GROUND && a != b) {
            const bool odd = (s->parities[edge->a] != s->parities[edge->b]) != edge->opposite;
            arc one = {.head = b,
                       .edge = 2 * e + (odd ? 1u : 0u),
                       .length = s->program->y[e] + (float)HOP_LENGTH};
            s->arcs[next[a]++] = one;
            one.head = a;
            s->arcs[next[b]++] = one;
        }
    }
}

// ---- one cycle ----------------------------------------------------------------------------------

typedef struct cycle {
    uint32_t *edges;
    uint32_t count; // may pass LONGEST; those edges are not stored
    double violation;
} cycle;

static void append(const pci_cycle_search *s, cycle *c, uint32_t edge) {
    if (c->count < LONGEST) {
        c->edges[c->count] = edge;
    }
    ++c->count;
    c->violation += (double)s->program->y[edge];
}

// The way from a to b within the tree of their cluster.
static void append_path(const pci_cycle_search *s, cycle *c, uint32_t a, uint32_t b) {
    while (a != b) {
        uint32_t *deeper = s->depths[a] > s->depths[b] ? &a : &b;
        const uint32_t e = s->parents[*deeper];
        append(s, c, e);
        *deeper = pci_signed_other(&s->program->graph->edges[e], *deeper);
    }
}

static uint32_t end_in_cluster(const pci_cycle_search *s, uint32_t edge, uint32_t cluster) {
    const pci_signed_edge *e = &s->program->graph->edges[edge];
    return s->clusters[e->a] == cluster ? e->a : e->b;
}

// The cycle that the edge `closing` between two clusters of a search closes.
static void close_between(const pci_cycle_search *s, const node *nodes, uint32_t closing,
                          const uint32_t clusters[2], cycle *c) {
    uint32_t ends[2] = {clusters[0], clusters[1]};
    uint32_t at[2] = {end_in_cluster(s, closing, ends[0]), end_in_cluster(s, closing, ends[1])};
    append(s, c, closing);
    while (ends[0] != ends[1]) {
        const size_t side = nodes[ends[0]].depth > nodes[ends[1]].depth ? 0 : 1;
        const node *n = &nodes[ends[side]];
        append_path(s, c, at[side], end_in_cluster(s, n->via, ends[side]));
        append(s, c, n->via);
        at[side] = end_in_cluster(s, n->via, n->parent);
        ends[side] = n->parent;
    }
    append_path(s, c, at[0], at[1]);
}

// The cycle that an edge closes within its cluster.
static void close_within(const pci_cycle_search *s, uint32_t closing, cycle *c) {
    append(s, c, closing);
    append_path(s, c, s->program->graph->edges[closing].a, s->program->graph->edges[closing].b);
}

static found_cycle assess(const cycle *c, size_t slot) {
    const bool good = c->count <= LONGEST && c->violation < 1.0 - MIN_VIOLATION;
    return (found_cycle){.length = c->violation + HOP_LENGTH * c->count,
                         .count = good ? c->count : 0,
                         .slot = (uint32_t)slot};
}

// ---- searches -----------------------------------------------------------------------------------

// The shortest negative cycle through a cluster, by Dijkstra's algorithm: some edge of it closes it
// in the tree of shortest paths, and lies less than half its length away.
static void find_cycle(pci_cycle_search *s, searcher *x, size_t slot) {
    const uint32_t time = ++x->time, root = s->roots[slot];
    node *nodes = x->nodes;
    float best = 1.0F;
    uint32_t ends[2] = {0, 0}, closing = PC_INVALID_INDEX;
    x->heap_count = 0;
    nodes[root] = (node){.time = time};
    heap_push(x, (heap_item){0.0F, root});
    for (size_t settled = 0; x->heap_count != 0 && settled < s->max_settled;) {
        const heap_item item = heap_pop(x);
        const uint32_t v = item.node;
        if (2.0F * item.distance >= best) {
            break;
        }
        if (nodes[v].settled) {
            continue;
        }
        nodes[v].settled = 1;
        ++settled;
        x->visited += s->offsets[v + 1] - s->offsets[v];
        for (size_t k = s->offsets[v]; k < s->offsets[v + 1]; ++k) {
            const arc a = s->arcs[k];
            node *w = &nodes[a.head];
            const uint8_t parity = nodes[v].parity ^ (a.edge & 1u);
            const float distance = item.distance + a.length;
            if (w->time == time && w->settled) {
                if (w->parity != parity && distance + w->distance < best) {
                    best = distance + w->distance;
                    ends[0] = v;
                    ends[1] = a.head;
                    closing = a.edge / 2;
                }
            } else if (2.0F * distance < best && (w->time != time || distance < w->distance)) {
                *w = (node){.distance = distance,
                            .via = a.edge / 2,
                            .parent = v,
                            .depth = nodes[v].depth + 1,
                            .time = time,
                            .parity = parity};
                heap_push(x, (heap_item){distance, a.head});
            }
        }
    }
    cycle c = {.edges = &s->cycles[slot * LONGEST]};
    if (closing != PC_INVALID_INDEX) {
        close_between(s, nodes, closing, ends, &c);
    }
    s->found[slot] = assess(&c, slot);
}

static void find_cycles(void *user, size_t begin, size_t end, uint32_t worker) {
    pci_cycle_search *s = user;
    for (size_t slot = begin; slot < end; ++slot) {
        find_cycle(s, &s->searchers[worker], slot);
    }
}

static int compare_found(const void *left, const void *right) {
    const found_cycle *l = left, *r = right;
    if (l->length < r->length || l->length > r->length) {
        return l->length < r->length ? -1 : 1;
    }
    return (l->slot > r->slot) - (l->slot < r->slot);
}

static void choose_roots(pci_cycle_search *s, const uint8_t *labels) {
    const pci_signed_graph *graph = s->program->graph;
    memset(s->is_root, 0, s->cluster_count);
    for (size_t e = 0; e < graph->edge_count; ++e) {
        const pci_signed_edge *edge = &graph->edges[e];
        if (edge->a != PCI_GROUND && (labels[edge->a] != labels[edge->b]) != edge->opposite) {
            s->is_root[s->clusters[edge->a]] = s->is_root[s->clusters[edge->b]] = 1;
        }
    }
    s->root_count = 0;
    for (uint32_t c = 0; c < s->cluster_count; ++c) {
        if (s->is_root[c]) {
            s->roots[s->root_count++] = c;
        }
    }
}

// Adds cycles, most violated first, at most a few through each edge.
static bool add_found(pci_cycle_search *s, size_t count, size_t *added) {
    uint32_t edges[LONGEST];
    if (count > 1) {
        qsort(s->found, count, sizeof(*s->found), compare_found);
    }
    for (size_t i = 0; i < count; ++i) {
        const found_cycle *f = &s->found[i];
        cycle c = {.edges = edges};
        if (f->slot < s->root_count) {
            c.edges = &s->cycles[(size_t)f->slot * LONGEST];
        } else {
            close_within(s, (uint32_t)(f->slot - s->root_count), &c);
        }
        bool fresh = true;
        for (size_t j = 0; j < f->count && fresh; ++j) {
            fresh = s->used[c.edges[j]] < CUTS_PER_EDGE;
        }
        if (fresh && !pci_cycle_program_add(s->program, c.edges, f->count, &fresh)) {
            return false;
        }
        for (size_t j = 0; j < f->count && fresh; ++j) {
            ++s->used[c.edges[j]];
        }
        *added += fresh;
    }
    return true;
}

static bool search(pci_cycle_search *s, const uint8_t *labels, float limit, uint32_t round,
                   size_t *added) {
    const pci_signed_graph *graph = s->program->graph;
    pci_scratch *scratch = s->program->scratch;
    make_clusters(s, limit, round);
    choose_roots(s, labels);
    if (!pci_scratch_reserve(scratch, (void **)&s->cycles, &s->cycle_capacity,
                             s->root_count * LONGEST, sizeof(*s->cycles))) {
        return false;
    }
    pci_parallel_for(scratch->context, s->root_count, GRAIN, find_cycles, s);
    size_t count = 0;
    for (size_t slot = 0; slot < s->root_count; ++slot) {
        s->found[count] = s->found[slot];
        count += s->found[slot].count != 0;
    }
    uint32_t edges[LONGEST];
    for (uint32_t e = 0; e < graph->edge_count && limit >= 0.0F; ++e) {
        const pci_signed_edge *edge = &graph->edges[e];
        if (s->clusters[edge->a] == s->clusters[edge->b] &&
            (s->parities[edge->a] != s->parities[edge->b]) != edge->opposite) {
            cycle c = {.edges = edges};
            close_within(s, e, &c);
            s->found[count] = assess(&c, s->root_count + e);
            count += s->found[count].count != 0;
        }
    }
    return add_found(s, count, added);
}

bool pci_cycle_search_run(pci_cycle_search *s, const uint8_t *labels, uint32_t round, size_t *added,
                          uint64_t *work) {
    memset(s->used, 0, s->program->graph->edge_count * sizeof(*s->used));
    *added = 0;
    // Short cycles from single vertices; then, between large clusters without violation, long ones.
    s->max_settled = BALL;
    bool ok = search(s, labels, -1.0F, round, added);
    s->max_settled = FAR;
    ok = ok && search(s, labels, NEGLIGIBLE, round, added);
    for (uint32_t k = 0; k < pc_context_threads(s->program->scratch->context); ++k) {
        *work += s->searchers[k].visited;
        s->searchers[k].visited = 0;
    }
    return ok;
}
