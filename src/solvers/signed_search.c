#include "solvers/signed_search.h"

#include "core/sorting.h"

enum { SWEEPS = PCI_EFFORT(300, 10) };
#define HOT  0.8  // first temperature, in units of the mean edge cost
#define COLD 0.02 // last temperature

typedef struct search {
    const pci_signed_graph *graph;
    pci_signed_rows rows;
    uint8_t *labels;
    int64_t *gains; // what flipping a vertex saves
    int64_t cost;
} search;

static void reset(search *s) {
    memset(s->gains, 0, s->graph->vertex_count * sizeof(*s->gains));
    for (size_t e = 0; e < s->graph->edge_count; ++e) {
        const pci_signed_edge *edge = &s->graph->edges[e];
        const bool paid = (s->labels[edge->a] != s->labels[edge->b]) != edge->opposite;
        const int64_t gain = paid ? edge->cost : -edge->cost;
        s->gains[edge->a] += gain;
        s->gains[edge->b] += gain;
    }
    s->cost = pci_signed_graph_cost(s->graph, s->labels);
}

static void flip(search *s, uint32_t v) {
    s->cost -= s->gains[v];
    s->gains[v] = -s->gains[v];
    s->labels[v] ^= 1;
    for (size_t k = s->rows.offsets[v]; k < s->rows.offsets[v + 1]; ++k) {
        const pci_signed_edge *edge = &s->graph->edges[s->rows.edges[k]];
        const uint32_t w = pci_signed_other(edge, v);
        const bool paid = (s->labels[v] != s->labels[w]) != edge->opposite;
        s->gains[w] += paid ? 2 * edge->cost : -2 * edge->cost;
    }
}

// Flips while that helps.
static void descend(search *s) {
    for (bool changed = true; changed;) {
        changed = false;
        for (uint32_t v = 1; v < s->graph->vertex_count; ++v) {
            if (s->gains[v] > 0) {
                flip(s, v);
                changed = true;
            }
        }
    }
}

// Whether a random number lies below exp(x), x < 0; a bound settles most of them.
static bool is_below_exp(double number, double x) {
    return number * (1.0 - x + 0.5 * x * x) < 1.0 + 1e-9 && number < exp(x);
}

// False: cancelled.
static bool anneal(pc_context *context, search *s, uint32_t sweeps) {
    const size_t n = s->graph->vertex_count;
    double mean = 0.0;
    for (size_t e = 0; e < s->graph->edge_count; ++e) {
        mean += (double)s->graph->edges[e].cost / (double)s->graph->edge_count;
    }
    for (uint32_t sweep = 0; sweep < sweeps; ++sweep) {
        const double t = (double)sweep / (sweeps - 1);
        const double temperature = mean * HOT * pow(COLD / HOT, t);
        if (!pci_keep_going(context)) {
            return false;
        }
        for (uint32_t v = 1; v < n; ++v) {
            const double gain = (double)s->gains[v];
            if (gain >= 0.0 || (gain > -20.0 * temperature &&
                                is_below_exp(pci_random(0, sweep, v), gain / temperature))) {
                flip(s, v);
            }
        }
    }
    descend(s);
    return true;
}

// Labels that satisfy every edge of a spanning forest of least keys (Kruskal; the union-find
// structure keeps each vertex's parity towards its root).
static bool spanning_tree(pci_scratch *scratch, search *s, const float *keys) {
    const pci_signed_graph *graph = s->graph;
    uint64_t *ranks = PCI_SCRATCH(scratch, uint64_t, graph->edge_count);
    uint32_t *order = PCI_SCRATCH(scratch, uint32_t, graph->edge_count);
    uint32_t *parent = PCI_SCRATCH(scratch, uint32_t, graph->vertex_count);
    uint8_t *parity = PCI_SCRATCH(scratch, uint8_t, graph->vertex_count);
    if (scratch->failed) {
        return false;
    }
    for (uint32_t e = 0; e < graph->edge_count; ++e) {
        ranks[e] = pci_key_of(keys != NULL ? (double)keys[e] : -(double)graph->edges[e].cost);
        order[e] = e;
    }
    if (!pci_sort_keys(scratch->context, graph->edge_count, ranks, order)) {
        return false;
    }
    for (uint32_t v = 0; v < graph->vertex_count; ++v) {
        parent[v] = v;
    }
    for (size_t k = 0; k < graph->edge_count; ++k) {
        const pci_signed_edge *edge = &graph->edges[order[k]];
        const uint32_t ends[2] = {edge->a, edge->b};
        uint32_t roots[2];
        uint8_t odd = edge->opposite ? 1 : 0;
        for (size_t i = 0; i < 2; ++i) {
            uint32_t v = ends[i];
            while (parent[v] != v) {
                // Path halving: link to the grandparent (a root's parity is 0).
                parity[v] ^= parity[parent[v]];
                parent[v] = parent[parent[v]];
                odd ^= parity[v];
                v = parent[v];
            }
            roots[i] = v;
        }
        if (roots[0] != roots[1]) {
            const uint32_t low = roots[0] < roots[1] ? 0 : 1;
            parent[roots[1 - low]] = roots[low];
            parity[roots[1 - low]] = odd;
        }
    }
    for (uint32_t v = 0; v < graph->vertex_count; ++v) {
        uint8_t odd = 0;
        for (uint32_t w = v; parent[w] != w; w = parent[w]) {
            odd ^= parity[w];
        }
        s->labels[v] = 1 ^ odd;
    }
    return true;
}

// Takes over from the labels `s->labels` what is better there: their differences to `best` fall
// into parts that share no edge, so each part is flipped or not by itself. Returns the new cost.
static int64_t fuse(search *s, uint32_t *queue, uint8_t *state, uint8_t *best) {
    const pci_signed_graph *graph = s->graph;
    const size_t n = graph->vertex_count;
    for (size_t v = 0; v < n; ++v) {
        state[v] = s->labels[v] != best[v]; // 1: different, 0: not or done
    }
    for (uint32_t root = 1; root < n; ++root) {
        if (!state[root]) {
            continue;
        }
        size_t head = 0, tail = 0;
        int64_t gain = 0;
        queue[tail++] = root;
        state[root] = 0;
        while (head != tail) {
            const uint32_t v = queue[head++];
            for (size_t k = s->rows.offsets[v]; k < s->rows.offsets[v + 1]; ++k) {
                const pci_signed_edge *edge = &graph->edges[s->rows.edges[k]];
                const uint32_t w = pci_signed_other(edge, v);
                if (s->labels[w] == best[w]) {
                    const bool paid = (best[v] != best[w]) != edge->opposite;
                    gain += paid ? edge->cost : -edge->cost;
                } else if (state[w]) {
                    state[w] = 0;
                    queue[tail++] = w;
                }
            }
        }
        for (size_t k = 0; k < tail; ++k) {
            // Done: both alike from here on.
            if (gain > 0) {
                best[queue[k]] ^= 1;
            } else {
                s->labels[queue[k]] ^= 1;
            }
        }
    }
    return pci_signed_graph_cost(graph, best);
}

bool pci_signed_search(pc_context *context, const pci_signed_graph *graph, const float *keys,
                       size_t steps, uint8_t *labels) {
    const size_t n = graph->vertex_count;
    const uint32_t sweeps = n < steps / SWEEPS ? SWEEPS : (uint32_t)(steps / n);
    pci_scratch scratch = pci_scratch_begin(context);
    search s = {.graph = graph};
    s.labels = PCI_SCRATCH(&scratch, uint8_t, n);
    s.gains = PCI_SCRATCH(&scratch, int64_t, n);
    uint32_t *queue = PCI_SCRATCH(&scratch, uint32_t, n);
    uint8_t *state = PCI_SCRATCH(&scratch, uint8_t, n);
    bool ok = !scratch.failed && pci_signed_graph_rows(&scratch, graph, &s.rows) &&
              spanning_tree(&scratch, &s, keys);
    if (ok) {
        reset(&s);
        descend(&s);
        fuse(&s, queue, state, labels);
        if (sweeps > 1) {
            memcpy(s.labels, labels, n);
            reset(&s);
            ok = anneal(context, &s, sweeps);
            fuse(&s, queue, state, labels);
        }
    }
    pci_scratch_end(&scratch);
    return ok;
}
