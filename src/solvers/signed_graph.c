#include "solvers/signed_graph.h"

#include <stdlib.h>

static int compare_edges(const void *left, const void *right) {
    const pci_signed_edge *l = left, *r = right;
    if (l->a != r->a) {
        return l->a < r->a ? -1 : 1;
    }
    return (l->b > r->b) - (l->b < r->b);
}

void pci_signed_graph_create(size_t vertex_count, pci_signed_edge *edges, size_t edge_count,
                             pci_signed_graph *graph) {
    for (size_t e = 0; e < edge_count; ++e) {
        if (edges[e].a > edges[e].b) {
            const uint32_t a = edges[e].a;
            edges[e].a = edges[e].b, edges[e].b = a;
        }
    }
    // Mostly they are in order already.
    bool sorted = true;
    for (size_t e = 1; e < edge_count && sorted; ++e) {
        sorted = compare_edges(&edges[e - 1], &edges[e]) <= 0;
    }
    if (!sorted) {
        qsort(edges, edge_count, sizeof(*edges), compare_edges);
    }
    int64_t constant = 0;
    size_t kept = 0;
    for (size_t begin = 0, end = 0; begin < edge_count; begin = end) {
        int64_t same = 0, opposite = 0;
        for (; end < edge_count && compare_edges(&edges[begin], &edges[end]) == 0; ++end) {
            *(edges[end].opposite ? &opposite : &same) += edges[end].cost;
        }
        constant += same < opposite ? same : opposite;
        if (same != opposite) {
            edges[kept].a = edges[begin].a;
            edges[kept].b = edges[begin].b;
            edges[kept].opposite = opposite > same;
            edges[kept].cost = opposite > same ? opposite - same : same - opposite;
            ++kept;
        }
    }
    graph->vertex_count = vertex_count;
    graph->edge_count = kept;
    graph->edges = edges;
    graph->constant = constant;
}

int64_t pci_signed_graph_cost(const pci_signed_graph *graph, const uint8_t *labels) {
    int64_t cost = graph->constant;
    for (size_t e = 0; e < graph->edge_count; ++e) {
        const pci_signed_edge *edge = &graph->edges[e];
        if ((labels[edge->a] != labels[edge->b]) != edge->opposite) {
            cost += edge->cost;
        }
    }
    return cost;
}

bool pci_signed_graph_rows(pci_scratch *scratch, const pci_signed_graph *graph,
                           pci_signed_rows *rows) {
    rows->offsets = PCI_SCRATCH(scratch, size_t, graph->vertex_count + 2);
    rows->edges = PCI_SCRATCH(scratch, uint32_t, 2 * graph->edge_count);
    if (scratch->failed) {
        return false;
    }
    // Counting sort; the offsets are shifted by one while the rows fill.
    size_t *next = rows->offsets + 1;
    for (size_t e = 0; e < graph->edge_count; ++e) {
        ++next[graph->edges[e].a + 1];
        ++next[graph->edges[e].b + 1];
    }
    for (size_t v = 0; v < graph->vertex_count; ++v) {
        next[v + 1] += next[v];
    }
    for (size_t e = 0; e < graph->edge_count; ++e) {
        rows->edges[next[graph->edges[e].a]++] = (uint32_t)e;
        rows->edges[next[graph->edges[e].b]++] = (uint32_t)e;
    }
    return true;
}

bool pci_signed_graph_contract(pci_scratch *scratch, const pci_signed_graph *graph,
                               const uint8_t *granted, pci_contraction *reduced) {
    const size_t n = graph->vertex_count;
    reduced->classes = PCI_SCRATCH(scratch, uint32_t, n);
    reduced->flips = PCI_SCRATCH(scratch, uint8_t, n);
    uint32_t *queue = PCI_SCRATCH(scratch, uint32_t, n);
    pci_signed_edge *edges = PCI_SCRATCH(scratch, pci_signed_edge, graph->edge_count);
    pci_signed_rows rows;
    if (scratch->failed || !pci_signed_graph_rows(scratch, graph, &rows)) {
        return false;
    }
    // Classes by breadth-first search, so that the lowest vertex of each keeps its label.
    memset(reduced->classes, 0xff, n * sizeof(*reduced->classes));
    uint32_t classes = 0;
    for (uint32_t root = 0; root < n; ++root) {
        if (reduced->classes[root] != PC_INVALID_INDEX) {
            continue;
        }
        size_t head = 0, tail = 0;
        queue[tail++] = root;
        reduced->classes[root] = classes;
        while (head != tail) {
            const uint32_t v = queue[head++];
            for (size_t k = rows.offsets[v]; k < rows.offsets[v + 1]; ++k) {
                const pci_signed_edge *edge = &graph->edges[rows.edges[k]];
                const uint32_t w = pci_signed_other(edge, v);
                if (granted[rows.edges[k]] && reduced->classes[w] == PC_INVALID_INDEX) {
                    reduced->classes[w] = classes;
                    reduced->flips[w] = reduced->flips[v] ^ (edge->opposite ? 1 : 0);
                    queue[tail++] = w;
                }
            }
        }
        ++classes;
    }
    size_t count = 0;
    int64_t constant = graph->constant;
    for (size_t e = 0; e < graph->edge_count; ++e) {
        pci_signed_edge edge = graph->edges[e];
        edge.opposite ^= reduced->flips[edge.a] != reduced->flips[edge.b];
        edge.a = reduced->classes[edge.a];
        edge.b = reduced->classes[edge.b];
        if (edge.a != edge.b) {
            edges[count++] = edge;
        } else if (edge.opposite) {
            constant += edge.cost;
        }
    }
    pci_signed_graph_create(classes, edges, count, &reduced->graph);
    reduced->graph.constant += constant;
    return true;
}
