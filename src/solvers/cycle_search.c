#include "solvers/cycle_search.h"

#include <stdlib.h>

enum {
    LONGEST = 96,      // cycles with more edges are not worth their steps in the program
    CUTS_PER_EDGE = 8, // in one round
    BALL = 100,        // clusters that a search among single vertices settles
    FAR = 1000,        // clusters that one among large clusters settles
    REACH = 300,       // vertices that a search for a path settles
    FORESTS = 8,       // of clusters, at most, in one round
    GRAIN = 32,
    BATCH = 64 // paths that are sought at a time
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

// A distance, which is not negative, above a node: in order as a number.
typedef uint64_t heap_item;

typedef struct heap {
    heap_item *items;
    size_t count;
} heap;

// The second side is for searches from two ends.
typedef struct pci_cluster_searcher {
    node *nodes[2];
    heap heaps[2];
    uint32_t time;
    uint64_t visited;
} searcher;

typedef struct pci_found_cycle {
    double length;
    uint32_t count; // of edges; 0: none
    uint32_t slot;  // where it is stored, or number of those + closing edge
} found_cycle;

// ---- heap ---------------------------------------------------------------------------------------

static heap_item make_item(float distance, uint32_t vertex) {
    uint32_t bits;
    memcpy(&bits, &distance, sizeof(bits));
    return (heap_item)bits << 32 | vertex;
}

static float distance_of(heap_item item) {
    const uint32_t bits = (uint32_t)(item >> 32);
    float distance;
    memcpy(&distance, &bits, sizeof(distance));
    return distance;
}

static void heap_push(heap *x, float distance, uint32_t vertex) {
    const heap_item item = make_item(distance, vertex);
    size_t k = x->count++;
    for (; k > 0 && item < x->items[(k - 1) / 2]; k = (k - 1) / 2) {
        x->items[k] = x->items[(k - 1) / 2];
    }
    x->items[k] = item;
}

static heap_item heap_pop(heap *x) {
    const heap_item top = x->items[0], last = x->items[--x->count];
    size_t k = 0;
    for (;;) {
        size_t child = 2 * k + 1;
        if (child >= x->count) {
            break;
        }
        child += child + 1 < x->count && x->items[child + 1] < x->items[child] ? 1 : 0;
        if (x->items[child] >= last) {
            break;
        }
        x->items[k] = x->items[child];
        k = child;
    }
    x->items[k] = last;
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
    s->lengths = PCI_SCRATCH(scratch, float, m);
    s->violated = PCI_SCRATCH(scratch, uint32_t, m);
    s->searchers = PCI_SCRATCH(scratch, searcher, threads);
    for (uint32_t k = 0; k < threads && !scratch->failed; ++k) {
        for (size_t side = 0; side < 2; ++side) {
            s->searchers[k].nodes[side] = PCI_SCRATCH(scratch, node, n);
            s->searchers[k].heaps[side].items = PCI_SCRATCH(scratch, heap_item, 2 * m + 1);
        }
    }
    s->others = PCI_SCRATCH(scratch, uint32_t, 2 * m);
    if (scratch->failed || !pci_signed_graph_rows(scratch, graph, &s->rows)) {
        return false;
    }
    for (uint32_t v = 0; v < n; ++v) {
        for (size_t k = s->rows.offsets[v]; k < s->rows.offsets[v + 1]; ++k) {
            s->others[k] = pci_signed_other(&graph->edges[s->rows.edges[k]], v);
        }
    }
    return true;
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
            const uint32_t w = s->others[k];
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
    node *nodes = x->nodes[0];
    heap *open = &x->heaps[0];
    float best = 1.0F;
    uint32_t ends[2] = {0, 0}, closing = PC_INVALID_INDEX;
    open->count = 0;
    nodes[root] = (node){.time = time};
    heap_push(open, 0.0F, root);
    for (size_t settled = 0; open->count != 0 && settled < s->max_settled;) {
        const heap_item item = heap_pop(open);
        const uint32_t v = (uint32_t)item;
        const float reached = distance_of(item);
        if (2.0F * reached >= best) {
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
            const float distance = reached + a.length;
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
                heap_push(open, distance, a.head);
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

// One step of a search from both ends of an edge, from side `k`: returns the vertex where a shorter
// path of less than `best` joins both sides, or PC_INVALID_INDEX.
static uint32_t step_path(const pci_cycle_search *s, searcher *x, size_t k, float *best) {
    uint32_t meeting = PC_INVALID_INDEX;
    const heap_item item = heap_pop(&x->heaps[k]);
    const uint32_t v = (uint32_t)item;
    const float reached = distance_of(item);
    if (x->nodes[k][v].settled) {
        return meeting;
    }
    x->nodes[k][v].settled = 1;
    x->visited += s->rows.offsets[v + 1] - s->rows.offsets[v];
    // No way of this side to the rest of the other one is shorter.
    const float opposite = distance_of(x->heaps[1 - k].items[0]);
    for (size_t r = s->rows.offsets[v]; r < s->rows.offsets[v + 1]; ++r) {
        const uint32_t e = s->rows.edges[r];
        const float distance = reached + s->lengths[e];
        if (!(distance < *best)) {
            continue;
        }
        const uint32_t w = s->others[r];
        node *mine = &x->nodes[k][w];
        const node *other = &x->nodes[1 - k][w];
        const bool joins = other->time == x->time && other->distance + distance < *best;
        if ((mine->time == x->time && (mine->settled || mine->distance <= distance)) ||
            (!joins && !(distance + opposite < *best))) {
            continue;
        }
        *mine = (node){.distance = distance, .via = e, .time = x->time};
        heap_push(&x->heaps[k], distance, w);
        if (joins) {
            *best = other->distance + distance;
            meeting = w;
        }
    }
    return meeting;
}

// The cycle that an edge closes with the shortest way from one end to the other, if that is shorter
// than `limit` and not too far around. Edges of infinite length are left out.
static void find_path(const pci_cycle_search *s, searcher *x, uint32_t edge, float limit,
                      cycle *c) {
    const pci_signed_edge *edges = s->program->graph->edges;
    const uint32_t ends[2] = {edges[edge].a, edges[edge].b};
    uint32_t meeting = PC_INVALID_INDEX;
    ++x->time;
    for (size_t k = 0; k < 2; ++k) {
        x->heaps[k].count = 0;
        x->nodes[k][ends[k]] = (node){.via = PC_INVALID_INDEX, .time = x->time};
        heap_push(&x->heaps[k], 0.0F, ends[k]);
    }
    for (size_t steps = 0; steps < REACH; ++steps) {
        const heap *h = x->heaps;
        if (h[0].count == 0 || h[1].count == 0) {
            break;
        }
        const float next[2] = {distance_of(h[0].items[0]), distance_of(h[1].items[0])};
        if (next[0] + next[1] >= limit) {
            break;
        }
        const size_t k = next[0] <= next[1] ? 0 : 1;
        const uint32_t met = step_path(s, x, k, &limit);
        meeting = met != PC_INVALID_INDEX ? met : meeting;
    }
    if (meeting == PC_INVALID_INDEX) {
        return;
    }
    append(s, c, edge);
    for (size_t k = 0; k < 2; ++k) {
        for (uint32_t v = meeting; x->nodes[k][v].via != PC_INVALID_INDEX;) {
            append(s, c, x->nodes[k][v].via);
            v = pci_signed_other(&edges[x->nodes[k][v].via], v);
        }
    }
}

static void find_paths(void *user, size_t begin, size_t end, uint32_t worker) {
    pci_cycle_search *s = user;
    for (size_t slot = begin; slot < end; ++slot) {
        const uint32_t e = s->batch[slot];
        cycle c = {.edges = &s->cycles[slot * LONGEST]};
        if (s->used[e] < CUTS_PER_EDGE) {
            find_path(s, &s->searchers[worker], e, (float)(1.0 - MIN_VIOLATION) - s->program->y[e],
                      &c);
        }
        s->found[slot] = assess(&c, slot);
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

// Adds cycles, most violated first, at most a few through each edge. Those in slots below `stored`
// are in `cycles`.
static bool add_found(pci_cycle_search *s, size_t count, size_t stored, size_t *added) {
    uint32_t edges[LONGEST] = {0};
    if (count > 1) {
        qsort(s->found, count, sizeof(*s->found), compare_found);
    }
    for (size_t i = 0; i < count; ++i) {
        const found_cycle *f = &s->found[i];
        cycle c = {.edges = edges};
        if (f->slot < stored) {
            c.edges = &s->cycles[(size_t)f->slot * LONGEST];
        } else {
            close_within(s, (uint32_t)(f->slot - stored), &c);
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

// Closes the gaps between the found cycles; returns their number.
static size_t drop_empty(pci_cycle_search *s, size_t slots) {
    size_t count = 0;
    for (size_t slot = 0; slot < slots; ++slot) {
        s->found[count] = s->found[slot];
        count += s->found[slot].count != 0;
    }
    return count;
}

static bool search(pci_cycle_search *s, const uint8_t *labels, float limit, uint32_t round,
                   size_t *added) {
    const pci_signed_graph *graph = s->program->graph;
    pci_scratch *scratch = s->program->scratch;
    memset(s->used, 0, graph->edge_count * sizeof(*s->used));
    make_clusters(s, limit, round);
    choose_roots(s, labels);
    if (!pci_scratch_reserve(scratch, (void **)&s->cycles, &s->cycle_capacity,
                             s->root_count * LONGEST, sizeof(*s->cycles))) {
        return false;
    }
    if (!pci_parallel_while_wanted(scratch->context, s->root_count, GRAIN, find_cycles, s)) {
        return false;
    }
    size_t count = drop_empty(s, s->root_count);
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
    return add_found(s, count, s->root_count, added);
}

// The edges whose wishes the labels do not grant, without those at the ground; all others may be
// parts of paths. Returns their number.
static size_t find_violated(pci_cycle_search *s, const uint8_t *labels) {
    const pci_signed_graph *graph = s->program->graph;
    size_t count = 0;
    for (uint32_t e = 0; e < graph->edge_count; ++e) {
        const pci_signed_edge *edge = &graph->edges[e];
        const bool violated = (labels[edge->a] != labels[edge->b]) != edge->opposite;
        if (violated && edge->a != PCI_GROUND) {
            s->violated[count++] = e;
        }
        s->lengths[e] = violated || edge->a == PCI_GROUND ? INFINITY : 0.0F;
    }
    return count;
}

// Closes edges that the labels violate by shortest paths of edges that they do not violate. Edges
// with enough cycles in this round are avoided, so that the paths spread. `round` varies ties.
static bool search_paths(pci_cycle_search *s, const uint8_t *labels, uint32_t round,
                         size_t *added) {
    pci_scratch *scratch = s->program->scratch;
    const size_t m = s->program->graph->edge_count;
    const size_t count = find_violated(s, labels);
    if (!pci_scratch_reserve(scratch, (void **)&s->cycles, &s->cycle_capacity, BATCH * LONGEST,
                             sizeof(*s->cycles))) {
        return false;
    }
    memset(s->used, 0, m * sizeof(*s->used));
    for (size_t e = 0; e < m; ++e) {
        s->lengths[e] +=
            s->program->y[e] + (float)(HOP_LENGTH * (1.0 + 0.5 * pci_random(round, 5, e)));
    }
    for (size_t begin = 0; begin < count; begin += BATCH) {
        const size_t size = count - begin < BATCH ? count - begin : BATCH;
        s->batch = &s->violated[begin];
        if (!pci_parallel_while_wanted(scratch->context, size, GRAIN / 4, find_paths, s) ||
            !add_found(s, drop_empty(s, size), size, added)) {
            return false;
        }
        for (size_t e = 0; e < m; ++e) {
            s->lengths[e] = s->used[e] < CUTS_PER_EDGE ? s->lengths[e] : INFINITY;
        }
    }
    return true;
}

static uint64_t take_work(pci_cycle_search *s) {
    uint64_t work = 0;
    for (uint32_t k = 0; k < pc_context_threads(s->program->scratch->context); ++k) {
        work += s->searchers[k].visited;
        s->searchers[k].visited = 0;
    }
    return work;
}

bool pci_cycle_search_run(pci_cycle_search *s, const uint8_t *labels, uint32_t round, size_t *added,
                          uint64_t *work) {
    *added = 0;
    // Short cycles from single vertices; then, between large clusters without violation, long ones,
    // along several forests, so that they do not all crowd on the same few edges. The first rounds
    // find enough with fewer.
    s->max_settled = BALL;
    bool ok = search(s, labels, -1.0F, round, added);
    s->max_settled = FAR;
    for (uint32_t k = 0; k < FORESTS && k <= round && ok; ++k) {
        ok = search(s, labels, NEGLIGIBLE, FORESTS * round + k, added);
    }
    ok = ok && search_paths(s, labels, round, added);
    *work += take_work(s);
    return ok;
}

int64_t pci_cycle_search_fill(pci_cycle_search *s, const uint8_t *labels, int64_t *capacities,
                              uint64_t *work) {
    const size_t m = s->program->graph->edge_count, count = find_violated(s, labels);
    int64_t total = 0;
    for (size_t e = 0; e < m; ++e) {
        s->lengths[e] += capacities[e] > 0 ? 1.0F : INFINITY;
    }
    for (size_t i = 0; i < count; ++i) {
        const uint32_t e = s->violated[i];
        while (capacities[e] > 0) {
            uint32_t edges[LONGEST];
            cycle c = {.edges = edges};
            find_path(s, &s->searchers[0], e, LONGEST, &c);
            if (c.count == 0) {
                break;
            }
            int64_t amount = capacities[e];
            for (uint32_t k = 0; k < c.count; ++k) {
                amount = capacities[edges[k]] < amount ? capacities[edges[k]] : amount;
            }
            for (uint32_t k = 0; k < c.count; ++k) {
                capacities[edges[k]] -= amount;
                s->lengths[edges[k]] = capacities[edges[k]] > 0 ? s->lengths[edges[k]] : INFINITY;
            }
            total += amount;
        }
    }
    *work += take_work(s);
    return total;
}
