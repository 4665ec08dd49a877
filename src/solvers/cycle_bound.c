#include "solvers/cycle_bound.h"

#include "core/clock.h"
#include "core/union_find.h"
#include "solvers/cycle_program.h"
#include "solvers/cycle_search.h"
#include "solvers/roof_duality.h"
#include "solvers/signed_search.h"

enum { MAX_IDLE = 3, MAX_REPEATS = 8 };
#define CONVERGED 1e-5 // relative error of the linear program
#define FEW_NEW   0.02 // share of cycles that are new, below which steps are worth more than a search

typedef struct bounding {
    pci_scratch *scratch;
    const pci_signed_graph *graph;
    pci_budget *budget;
    pci_cycle_program program;
    pci_cycle_search search;
    uint32_t *parent; // for count_contracted
    int64_t *costs;   // of the edges
    float *keys;      // for rounding
    pci_cycle_bound *result;
} bounding;

// Vertices that stay when every edge that holds at least `gap` is contracted.
static size_t count_contracted(bounding *b, const int64_t *amounts, int64_t gap) {
    size_t left = b->graph->vertex_count;
    pci_singletons(b->parent, b->graph->vertex_count);
    for (size_t e = 0; e < b->graph->edge_count; ++e) {
        if (amounts[e] >= gap) {
            left -= pci_unite(b->parent, b->graph->edges[e].a, b->graph->edges[e].b);
        }
    }
    return left;
}

// Packs the cycles of the program, then those through the ground, then what still fits.
static bool certify(bounding *b, const uint8_t *labels, uint64_t *work) {
    pci_cycle_bound *result = b->result;
    memcpy(result->residuals, b->costs, b->graph->edge_count * sizeof(*b->costs));
    result->bound = b->graph->constant;
    result->bound += pci_cycle_program_pack(&b->program, false, result->residuals);
    int64_t gain = 0;
    if (b->program.has_flow &&
        !pci_pack_ground_cycles(b->scratch, b->graph, result->residuals, &gain)) {
        return false;
    }
    result->bound += gain;
    result->bound += pci_cycle_program_pack(&b->program, true, result->residuals);
    result->bound += pci_cycle_search_fill(&b->search, labels, result->residuals, work);
    return true;
}

static void spend(pci_budget *budget, uint64_t work) {
    budget->left -= work < budget->left ? work : budget->left;
    if (budget->deadline > 0.0 && pci_clock_seconds() > budget->deadline) {
        budget->left = 0;
    }
}

// Whether half of the vertices could be contracted when the program's value were a bound: no
// residual is larger than the cost.
static bool promising(bounding *b, int64_t cost) {
    const double value = b->program.value / b->program.scale;
    const double gap = (double)(cost - b->graph->constant) - value;
    return gap < 1.0 || 2 * count_contracted(b, b->costs, (int64_t)gap) < b->graph->vertex_count;
}

// What the packing leaves of an edge says how sure its wish is: with an optimal packing, an optimal
// labelling violates only edges of which nothing is left.
static bool round_residuals(bounding *b, uint8_t *labels) {
    for (size_t e = 0; e < b->graph->edge_count; ++e) {
        b->keys[e] = -(float)((double)b->result->residuals[e] * b->program.scale);
    }
    return pci_signed_search(b->scratch->context, b->graph, b->keys, 0, labels);
}

// Steps of the program; more where it is no longer new cycles that keep it from converging. Returns
// its error.
static double iterate(bounding *b, size_t added, uint64_t *work) {
    pci_cycle_program *p = &b->program;
    const bool few = (double)added < FEW_NEW * (double)p->cycle_count;
    double error = INFINITY;
    for (uint32_t k = 0; k < (few ? MAX_REPEATS : 1) && !(error < CONVERGED); ++k) {
        error = pci_cycle_program_iterate(p);
        *work += (p->entry_count + 4 * b->graph->edge_count) * PCI_PROGRAM_STEPS;
    }
    return error;
}

// One round of separation, steps of the program and rounding. `done`: bound and labels cannot be
// improved here, or the rest is worth contracting.
static bool run_round(bounding *b, uint32_t round, uint32_t *idle, uint8_t *labels, bool *done) {
    const pci_signed_graph *graph = b->graph;
    pci_cycle_program *p = &b->program;
    size_t added = 0;
    uint64_t work = 0;
    if (!pci_cycle_search_run(&b->search, labels, round, &added, &work)) {
        return false;
    }
    const double error = iterate(b, added, &work);
    if (!pci_signed_search(b->scratch->context, graph, p->y, 0, labels)) {
        return false;
    }
    *idle = added == 0 && error < CONVERGED ? *idle + 1 : 0;
    *done = *idle == MAX_IDLE || b->budget->left <= work;
    if (*done || promising(b, pci_signed_graph_cost(graph, labels))) {
        if (!certify(b, labels, &work) || !round_residuals(b, labels)) {
            return false;
        }
        const int64_t gap = pci_signed_graph_cost(graph, labels) - b->result->bound;
        *done = *done || gap <= 0 ||
                2 * count_contracted(b, b->result->residuals, gap) < graph->vertex_count;
    }
    spend(b->budget, work);
    *done = *done || b->budget->left == 0;
    pci_cycle_program_purge(p);
    return true;
}

pc_status pci_find_cycle_bound(pci_scratch *scratch, const char *stage,
                               const pci_signed_graph *graph, pci_budget *budget, uint8_t *labels,
                               pci_cycle_bound *result) {
    const size_t m = graph->edge_count;
    pc_context *context = scratch->context;
    pci_scratch local = pci_scratch_begin(context);
    bounding b = {.scratch = &local, .graph = graph, .budget = budget, .result = result};
    pc_status status = PC_OK;
    result->residuals = PCI_SCRATCH(scratch, int64_t, m);
    result->bound = graph->constant;
    b.parent = PCI_SCRATCH(&local, uint32_t, graph->vertex_count);
    b.costs = PCI_SCRATCH(&local, int64_t, m);
    b.keys = PCI_SCRATCH(&local, float, m);
    if (scratch->failed || !pci_cycle_program_create(&local, graph, &b.program) ||
        !pci_cycle_search_create(&local, &b.program, &b.search)) {
        status = pci_fail_memory(context, stage);
        goto cleanup;
    }
    for (size_t e = 0; e < m; ++e) {
        b.costs[e] = result->residuals[e] = graph->edges[e].cost;
    }
    uint32_t idle = 0; // rounds without progress
    bool done = budget->left == 0;
    for (uint32_t round = 0; !done; ++round) {
        if (!pci_progress(context, stage, pci_budget_used(budget))) {
            status = pci_fail_cancelled(context, stage);
            goto cleanup;
        }
        if (!run_round(&b, round, &idle, labels, &done)) {
            status = pci_fail_memory(context, stage);
            goto cleanup;
        }
    }
cleanup:
    pci_scratch_end(&local);
    return status;
}
