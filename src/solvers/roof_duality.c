#include "solvers/roof_duality.h"

#include <stdlib.h>

#include "solvers/maxflow.h"

// The double cover has a node 2v for "v has label 1" and 2v + 1 for "v has label 0"; residual arcs
// are implications that cost nothing to obey. The edges at the ground, which come first, are
// terminals; edge e behind them owns arcs 4 (e - first) .. + 3, where arc ^ 2 is the mirror image
// (the contraposition) of an arc.
typedef struct cover {
    pci_flow_network net;
    size_t first; // edge not at the ground
    uint32_t *heads;
    size_t *offsets;
    uint32_t *arcs;
} cover;

static bool make_cover(pci_scratch *scratch, const pci_signed_graph *graph,
                       const int64_t *capacities, cover *c) {
    while (c->first < graph->edge_count && graph->edges[c->first].a == PCI_GROUND) {
        ++c->first;
    }
    const size_t nodes = 2 * graph->vertex_count, arcs = 4 * (graph->edge_count - c->first);
    c->heads = PCI_SCRATCH(scratch, uint32_t, arcs);
    c->offsets = PCI_SCRATCH(scratch, size_t, nodes + 2);
    c->arcs = PCI_SCRATCH(scratch, uint32_t, arcs);
    c->net.capacities = PCI_SCRATCH(scratch, int64_t, arcs);
    c->net.terminals = PCI_SCRATCH(scratch, int64_t, nodes);
    if (scratch->failed) {
        return false;
    }
    for (size_t e = 0; e < graph->edge_count; ++e) {
        const pci_signed_edge *edge = &graph->edges[e];
        const int64_t cost = capacities != NULL ? capacities[e] : edge->cost;
        const uint32_t a = 2 * edge->a, b = 2 * edge->b + (edge->opposite ? 1u : 0u);
        if (e < c->first) {
            c->net.terminals[b] += cost;
            c->net.terminals[b ^ 1u] -= cost;
            continue;
        }
        const uint32_t heads[4] = {b, a, a ^ 1u, b ^ 1u};
        const size_t arc = 4 * (e - c->first);
        memcpy(&c->heads[arc], heads, sizeof(heads));
        for (size_t k = 0; k < 4; ++k) {
            c->net.capacities[arc + k] = cost;
            ++c->offsets[heads[k ^ 1] + 2];
        }
    }
    size_t *next = c->offsets + 1;
    for (size_t v = 0; v < nodes; ++v) {
        next[v + 1] += next[v];
    }
    for (uint32_t arc = 0; arc < arcs; ++arc) {
        c->arcs[next[c->heads[arc ^ 1u]]++] = arc;
    }
    c->net.node_count = nodes;
    c->net.arc_count = arcs;
    c->net.heads = c->heads;
    c->net.offsets = c->offsets;
    c->net.arcs = c->arcs;
    return pci_keep_going(scratch->context);
}

// Strongly connected components of the symmetric residual network without the labelled nodes, by
// Tarjan's algorithm; a component has a smaller number than those it is reached from.
static bool strong_components(pci_scratch *scratch, const cover *c, const uint8_t *skip,
                              uint32_t *component) {
    const size_t n = c->net.node_count;
    uint32_t *low = PCI_SCRATCH(scratch, uint32_t, n);
    uint32_t *index = PCI_SCRATCH(scratch, uint32_t, n); // 0: not seen
    size_t *at = PCI_SCRATCH(scratch, size_t, n);
    uint32_t *path = PCI_SCRATCH(scratch, uint32_t, n);
    uint32_t *open = PCI_SCRATCH(scratch, uint32_t, n);
    if (scratch->failed) {
        return false;
    }
    uint32_t counter = 0, components = 0;
    size_t open_count = 0;
    memset(component, 0xff, n * sizeof(*component));
    for (uint32_t root = 0; root < n; ++root) {
        if (skip[root] || index[root] != 0) {
            continue;
        }
        size_t depth = 0;
        path[depth++] = root;
        index[root] = low[root] = ++counter;
        at[root] = c->offsets[root];
        open[open_count++] = root;
        while (depth != 0) {
            const uint32_t v = path[depth - 1];
            if (at[v] < c->offsets[v + 1]) {
                const uint32_t arc = c->arcs[at[v]++];
                const uint32_t w = c->heads[arc];
                if (skip[w] || (c->net.capacities[arc] == 0 && c->net.capacities[arc ^ 2u] == 0)) {
                    continue;
                }
                if (index[w] == 0) {
                    path[depth++] = w;
                    index[w] = low[w] = ++counter;
                    at[w] = c->offsets[w];
                    open[open_count++] = w;
                } else if (component[w] == UINT32_MAX && index[w] < low[v]) {
                    low[v] = index[w];
                }
                continue;
            }
            --depth;
            if (depth != 0 && low[v] < low[path[depth - 1]]) {
                low[path[depth - 1]] = low[v];
            }
            if (low[v] == index[v]) {
                uint32_t w;
                do {
                    w = open[--open_count];
                    component[w] = components;
                } while (w != v);
                ++components;
            }
        }
    }
    return true;
}

bool pci_roof_duality(pci_scratch *scratch, const pci_signed_graph *graph, pci_roof *roof) {
    const size_t n = graph->vertex_count;
    cover c = {0};
    pci_scratch local = pci_scratch_begin(scratch->context);
    roof->labels = PCI_SCRATCH(scratch, uint8_t, n);
    roof->components = PCI_SCRATCH(scratch, uint32_t, n);
    roof->component_count = 0;
    uint8_t *fixed = PCI_SCRATCH(&local, uint8_t, 2 * n);
    uint32_t *component = PCI_SCRATCH(&local, uint32_t, 2 * n);
    uint32_t *part = PCI_SCRATCH(&local, uint32_t, 2 * n);
    int64_t flow = 0;
    bool ok = !scratch->failed && !local.failed && make_cover(&local, graph, NULL, &c) &&
              pci_maxflow(scratch->context, &c.net, &flow, fixed);
    if (ok) {
        // Strong persistency: what the source reaches is true in every optimum.
        roof->bound = graph->constant + flow / 2 + flow % 2;
        fixed[0] = fixed[1] = 1;
        for (size_t v = 0; v < n; ++v) {
            roof->labels[v] = fixed[2 * v] ? 1 : fixed[2 * v + 1] ? 0 : PCI_NO_LABEL;
            fixed[2 * v] = fixed[2 * v + 1] = roof->labels[v] != PCI_NO_LABEL;
            roof->components[v] = PC_INVALID_INDEX;
        }
        ok = strong_components(&local, &c, fixed, component);
    }
    if (ok) {
        // Weak persistency: an assignment closed under the implications, as in 2-satisfiability.
        // Components that contain a node and its negation stay open, one by one.
        memset(part, 0xff, 2 * n * sizeof(*part));
        for (size_t v = 1; v < n; ++v) {
            if (roof->labels[v] != PCI_NO_LABEL) {
                continue;
            }
            const uint32_t yes = component[2 * v], no = component[2 * v + 1];
            if (yes != no) {
                roof->labels[v] = yes < no;
                continue;
            }
            if (part[yes] == PC_INVALID_INDEX) {
                part[yes] = (uint32_t)roof->component_count++;
            }
            roof->components[v] = part[yes];
        }
    }
    pci_scratch_end(&local);
    return ok;
}

bool pci_pack_ground_cycles(pci_scratch *scratch, const pci_signed_graph *graph,
                            int64_t *capacities, int64_t *gain) {
    cover c = {0};
    pci_scratch local = pci_scratch_begin(scratch->context);
    uint8_t *reachable = PCI_SCRATCH(&local, uint8_t, 2 * graph->vertex_count);
    int64_t flow = 0;
    const bool ok = !local.failed && make_cover(&local, graph, capacities, &c) &&
                    pci_maxflow(scratch->context, &c.net, &flow, reachable);
    for (size_t e = 0; e < graph->edge_count && ok; ++e) {
        // The flow in the cover is worth half; each edge is there twice.
        const pci_signed_edge *edge = &graph->edges[e];
        int64_t used;
        if (e < c.first) {
            const size_t b = 2 * (size_t)edge->b;
            used = 2 * capacities[e] - llabs(c.net.terminals[b]) - llabs(c.net.terminals[b + 1]);
        } else {
            const size_t arc = 4 * (e - c.first);
            used = llabs(capacities[e] - c.net.capacities[arc]) +
                   llabs(capacities[e] - c.net.capacities[arc + 2]);
        }
        capacities[e] -= used / 2 + used % 2;
    }
    *gain = flow / 2;
    pci_scratch_end(&local);
    return ok;
}
