#include "core/signed_solve.h"

#include "core/elimination.h"
#include "core/roof_duality.h"
#include "core/signed_search.h"

enum { MAX_WIDTH = 18 };
#define MAX_TABLE_ENTRIES (UINT64_C(1) << 22)

bool pci_signed_solve(pc_context *context, const pci_signed_graph *graph, uint32_t effort,
                      pci_signed_solution *solution) {
    pci_scratch scratch = pci_scratch_begin(context);
    pci_roof roof = {0};
    const uint32_t runs = effort == 0 ? 0 : 1 + effort / 100;
    memset(solution->labels, 1, graph->vertex_count);
    bool solved = false;
    bool ok =
        pci_eliminate(context, graph, MAX_WIDTH, MAX_TABLE_ENTRIES, solution->labels, &solved);
    if (ok && solved) {
        solution->cost = solution->bound = pci_signed_graph_cost(graph, solution->labels);
        goto cleanup;
    }
    ok = ok && pci_roof_duality(&scratch, graph, &roof) &&
         pci_signed_search(context, graph, runs, solution->labels);
    if (ok) {
        solution->cost = pci_signed_graph_cost(graph, solution->labels);
        solution->bound = roof.bound;
    }
cleanup:
    pci_scratch_end(&scratch);
    return ok;
}
