#include "solvers/signed_solve.h"

#include <stdlib.h>

#include "solvers/elimination.h"
#include "solvers/roof_duality.h"
#include "solvers/signed_search.h"

enum {
    NARROW = 12, // widths of eliminations: takes no time; and what is tried last
    WIDE = 18,
    FEW_STEPS = 1 << 20 // of annealing, when nothing comes after it: a few milliseconds
};
#define MIN_SHRINK        0.95 // smaller steps are not worth another round
#define MAX_TABLE_ENTRIES (UINT64_C(1) << 22)

typedef struct solver {
    pc_context *context;
    const char *stage;
    pci_budget budget;
} solver;

static pc_status solve(solver *s, const pci_signed_graph *graph, pci_signed_solution *solution);

// The part of the problem on the vertices of one component, where labels are missing; edges to
// labelled vertices become edges to the ground.
static bool extract_component(pci_scratch *scratch, const pci_signed_graph *graph,
                              const pci_roof *roof, const uint32_t *vertices, size_t count,
                              const pci_signed_rows *rows, uint32_t *local,
                              pci_signed_graph *part) {
    size_t edge_count = 0;
    for (size_t k = 0; k < count; ++k) {
        local[vertices[k]] = (uint32_t)k + 1;
        edge_count += rows->offsets[vertices[k] + 1] - rows->offsets[vertices[k]];
    }
    pci_signed_edge *edges = PCI_SCRATCH(scratch, pci_signed_edge, edge_count);
    if (edges == NULL) {
        return false;
    }
    edge_count = 0;
    for (size_t k = 0; k < count; ++k) {
        const uint32_t v = vertices[k];
        for (size_t r = rows->offsets[v]; r < rows->offsets[v + 1]; ++r) {
            pci_signed_edge edge = graph->edges[rows->edges[r]];
            const uint32_t w = pci_signed_other(&edge, v);
            if (roof->labels[w] != PCI_NO_LABEL) {
                edge.opposite ^= roof->labels[w] == 0;
                edge.a = PCI_GROUND;
                edge.b = local[v];
            } else if (w > v && roof->components[w] == roof->components[v]) {
                edge.a = local[v];
                edge.b = local[w];
            } else {
                continue;
            }
            edges[edge_count++] = edge;
        }
    }
    pci_signed_graph_create(count + 1, edges, edge_count, part);
    return true;
}

// Contracts the edges whose wishes every better labelling grants and solves what is left.
static pc_status solve_contracted(solver *s, const pci_signed_graph *graph,
                                  const pci_cycle_bound *cycles, uint8_t *labels, int64_t *bound) {
    const int64_t cost = pci_signed_graph_cost(graph, labels);
    pc_status status = PC_OK;
    pci_scratch scratch = pci_scratch_begin(s->context);
    pci_contraction reduced;
    pci_signed_solution solution = {0};
    uint8_t *granted = PCI_SCRATCH(&scratch, uint8_t, graph->edge_count);
    for (size_t e = 0; e < graph->edge_count && granted != NULL; ++e) {
        granted[e] = cycles->residuals[e] >= cost - cycles->bound;
    }
    if (granted == NULL || !pci_signed_graph_contract(&scratch, graph, granted, &reduced)) {
        status = pci_fail_memory(s->context, s->stage);
        goto cleanup;
    }
    if ((double)reduced.graph.vertex_count > MIN_SHRINK * (double)graph->vertex_count) {
        goto cleanup;
    }
    solution.labels = PCI_SCRATCH(&scratch, uint8_t, reduced.graph.vertex_count);
    if (scratch.failed) {
        status = pci_fail_memory(s->context, s->stage);
        goto cleanup;
    }
    status = solve(s, &reduced.graph, &solution);
    if (status == PC_OK) {
        // A labelling is a labelling of the contracted graph, or it costs no less than `labels`.
        const int64_t better = solution.bound < cost ? solution.bound : cost;
        *bound = better > *bound ? better : *bound;
        if (pci_signed_graph_cost(&reduced.graph, solution.labels) < cost) {
            for (size_t v = 0; v < graph->vertex_count; ++v) {
                labels[v] = solution.labels[reduced.classes[v]] ^ reduced.flips[v];
            }
        }
    }
cleanup:
    pci_scratch_end(&scratch);
    return status;
}

// The bound of roof duality for a problem that it cannot reduce: half of what each vertex wishes is
// lost, since the relaxation has an optimum with all labels one half.
static int64_t half_bound(const pci_signed_graph *graph) {
    int64_t wishes = 0;
    for (size_t e = 0; e < graph->edge_count && graph->edges[e].a == PCI_GROUND; ++e) {
        wishes += graph->edges[e].cost;
    }
    return graph->constant + wishes / 2 + wishes % 2;
}

// Solves it if it is no wider than that.
static pc_status eliminate(solver *s, const pci_signed_graph *graph, uint32_t width,
                           uint8_t *labels, int64_t *bound, bool *solved) {
    if (!pci_eliminate(s->context, graph, width, MAX_TABLE_ENTRIES, labels, solved)) {
        return pci_fail_memory(s->context, s->stage);
    }
    *bound = *solved ? pci_signed_graph_cost(graph, labels) : *bound;
    return PC_OK;
}

// A connected problem that roof duality cannot reduce.
static pc_status solve_component(solver *s, const pci_signed_graph *graph, uint8_t *labels,
                                 int64_t *bound) {
    const bool last = s->budget.left == 0; // nothing comes after the elimination
    bool solved = false;
    pc_status status = eliminate(s, graph, last ? WIDE : NARROW, labels, bound, &solved);
    if (solved || status != PC_OK) {
        return status;
    }
    memset(labels, 1, graph->vertex_count);
    pci_scratch scratch = pci_scratch_begin(s->context);
    pci_cycle_bound cycles = {0};
    if (!pci_signed_search(s->context, graph, NULL, last ? FEW_STEPS : SIZE_MAX, labels)) {
        status = pci_fail_memory(s->context, s->stage);
        goto cleanup;
    }
    *bound = half_bound(graph);
    if (last) {
        goto cleanup;
    }
    status = pci_find_cycle_bound(&scratch, s->stage, graph, &s->budget, labels, &cycles);
    if (status == PC_OK) {
        *bound = cycles.bound > *bound ? cycles.bound : *bound;
        if (*bound < pci_signed_graph_cost(graph, labels)) {
            status = solve_contracted(s, graph, &cycles, labels, bound);
        }
    }
    if (status == PC_OK && *bound < pci_signed_graph_cost(graph, labels)) {
        status = eliminate(s, graph, WIDE, labels, bound, &solved);
    }
cleanup:
    pci_scratch_end(&scratch);
    return status;
}

typedef struct ranked_component {
    size_t size;
    uint32_t component;
} ranked_component;

static int compare_components(const void *left, const void *right) {
    const ranked_component *l = left, *r = right;
    if (l->size != r->size) {
        return l->size < r->size ? -1 : 1;
    }
    return (l->component > r->component) - (l->component < r->component);
}

typedef struct component_result {
    int64_t gap;   // between the cost of its labels and its bound
    uint64_t used; // of the budget
} component_result;

typedef struct component_job {
    const solver *solver;
    const pci_signed_graph *graph;
    const pci_roof *roof;
    const pci_signed_rows *rows;
    size_t count;
    const ranked_component *order;
    const size_t *offsets;
    const uint32_t *vertices; // by component, from its offset on
    uint32_t *local;          // #vertices
    size_t open;              // vertices of all components
    component_result *results;
    uint8_t *labels;
} component_job;

// Each component may use what part of the budget its vertices are of all that are open. The last,
// and largest, one comes first.
static pc_status solve_nth(void *user, size_t index, pc_context *own) {
    const component_job *job = user;
    const size_t k = job->count - 1 - index, count = job->order[k].size;
    const uint32_t *members = &job->vertices[job->offsets[job->order[k].component]];
    const pci_budget *all = &job->solver->budget;
    const uint64_t share = (uint64_t)((double)all->left * ((double)count / (double)job->open));
    solver s = {.context = own,
                .stage = job->solver->stage,
                .budget = {all->total - all->left + share, share, all->deadline}};
    pc_status status = pci_progress(own, s.stage, pci_budget_used(&s.budget))
                           ? PC_OK
                           : pci_fail_cancelled(own, s.stage);
    if (status != PC_OK) {
        return status;
    }
    pci_scratch scratch = pci_scratch_begin(own);
    pci_signed_graph part;
    uint8_t *labels = PCI_SCRATCH(&scratch, uint8_t, count + 1);
    if (scratch.failed || !extract_component(&scratch, job->graph, job->roof, members, count,
                                             job->rows, job->local, &part)) {
        status = pci_fail_memory(own, s.stage);
    } else {
        int64_t bound = 0;
        status = solve_component(&s, &part, labels, &bound);
        for (size_t i = 0; i < count && status == PC_OK; ++i) {
            job->labels[members[i]] = labels[i + 1];
        }
        job->results[k] =
            (component_result){pci_signed_graph_cost(&part, labels) - bound, share - s.budget.left};
    }
    pci_scratch_end(&scratch);
    return status;
}

// Solves the components and completes the labels.
static pc_status solve_components(solver *s, const pci_signed_graph *graph, const pci_roof *roof,
                                  pci_signed_solution *solution) {
    const size_t n = graph->vertex_count, components = roof->component_count;
    pc_status status = PC_OK;
    memcpy(solution->labels, roof->labels, n);
    if (components == 0) {
        solution->bound = pci_signed_graph_cost(graph, solution->labels);
        return PC_OK;
    }
    pci_scratch scratch = pci_scratch_begin(s->context);
    size_t *offsets = PCI_SCRATCH(&scratch, size_t, components + 2);
    uint32_t *vertices = PCI_SCRATCH(&scratch, uint32_t, n);
    uint32_t *local = PCI_SCRATCH(&scratch, uint32_t, n);
    ranked_component *order = PCI_SCRATCH(&scratch, ranked_component, components);
    component_result *results = PCI_SCRATCH(&scratch, component_result, components);
    pci_signed_rows rows;
    if (scratch.failed || !pci_signed_graph_rows(&scratch, graph, &rows)) {
        status = pci_fail_memory(s->context, s->stage);
        goto cleanup;
    }
    // Vertices by component.
    size_t *next = offsets + 1;
    for (size_t v = 0; v < n; ++v) {
        if (roof->labels[v] == PCI_NO_LABEL) {
            ++next[roof->components[v] + 1];
        }
    }
    for (uint32_t c = 0; c < components; ++c) {
        order[c] = (ranked_component){next[c + 1], c};
        next[c + 1] += next[c];
    }
    for (uint32_t v = 0; v < n; ++v) {
        if (roof->labels[v] == PCI_NO_LABEL) {
            vertices[next[roof->components[v]]++] = v;
        }
    }
    if (components > 1) {
        qsort(order, components, sizeof(*order), compare_components);
    }
    component_job job = {.solver = s,
                         .graph = graph,
                         .roof = roof,
                         .rows = &rows,
                         .count = components,
                         .order = order,
                         .offsets = offsets,
                         .vertices = vertices,
                         .local = local,
                         .open = offsets[components],
                         .results = results,
                         .labels = solution->labels};
    // What outweighs all others needs all threads.
    const size_t largest = order[components - 1].size;
    if (largest > job.open / 5 * 4) {
        status = solve_nth(&job, 0, s->context);
        --job.count;
    }
    if (status == PC_OK) {
        status = pci_run_tasks(s->context, job.count, solve_nth, &job);
    }
    if (status != PC_OK) {
        goto cleanup;
    }
    int64_t missing = 0;
    for (size_t k = 0; k < components; ++k) {
        missing += results[k].gap;
        solution->unproven += results[k].gap > 0;
        s->budget.left -= results[k].used < s->budget.left ? results[k].used : s->budget.left;
    }
    // All that is not proven lies in the components.
    solution->open_vertices += job.open;
    solution->components = components;
    solution->bound = pci_signed_graph_cost(graph, solution->labels) - missing;
cleanup:
    pci_scratch_end(&scratch);
    return status;
}

static pc_status solve(solver *s, const pci_signed_graph *graph, pci_signed_solution *solution) {
    pci_scratch scratch = pci_scratch_begin(s->context);
    pci_roof roof;
    pc_status status;
    if (pci_roof_duality(&scratch, graph, &roof)) {
        solution->roof_bound = roof.bound;
        status = solve_components(s, graph, &roof, solution);
    } else {
        status = pci_fail_memory(s->context, s->stage);
    }
    pci_scratch_end(&scratch);
    return status;
}

pc_status pci_signed_solve(pc_context *context, const char *stage, const pci_signed_graph *graph,
                           pci_budget budget, pci_signed_solution *solution) {
    solver s = {.context = context, .stage = stage, .budget = budget};
    return solve(&s, graph, solution);
}
