#include "proxycloth/label.h"

#include <float.h>

#include "core/clock.h"
#include "core/core.h"
#include "core/union_find.h"
#include "solvers/signed_solve.h"
#include "stages/label_check.h"

#define OPTIMAL_GAP     1e-6
#define WORK_PER_EFFORT UINT64_C(20000000)

static const char stage[] = "label";

static const char *const outcome_choices[] = {"optimal", "feasible", NULL};
static const pc_field option_fields[] = {
    PCI_FIELD_OPTION(pc_label_options, lambda_smooth, DOUBLE, 2.0, 0.0, 1000000.0, "",
                     "lambda_s: cost of a label change along a mesh edge"),
    PCI_FIELD_OPTION(pc_label_options, lambda_opposite, DOUBLE, 1.0, 0.0, 1000000.0, "",
                     "lambda_o: cost of equal labels on opposite vertices"),
    PCI_FIELD_OPTION(pc_label_options, lambda_bias, DOUBLE, 1.0, 0.0, 1000000.0, "",
                     "Cost of keeping the inner side, in units of lambda_o"),
    PCI_FIELD_OPTION(pc_label_options, label_effort, UINT, 100, 0, 1000000, "",
                     "Work budget for what roof duality leaves open; 100 lasts for some seconds"),
    PCI_FIELD_OPTION(pc_label_options, label_seconds, DOUBLE, 0.0, 0.0, 86400.0, "s",
                     "Time limit for the same; 0 means none. Results under a limit may differ from "
                     "run to run"),
};
const pc_record pc_label_options_record = PCI_RECORD(option_fields, pc_label_options);

static const pc_field report_fields[] = {
    {.name = "outcome",
     .type = PC_FIELD_CHOICE,
     .offset = offsetof(pc_label_report, outcome),
     .unit = "",
     .help = "Whether the labels are proven to be optimal",
     .choices = outcome_choices,
     .warning = "the labels may not be optimal, see gap"},
    PCI_FIELD_REPORT(pc_label_report, objective, DOUBLE, "", "Value of the labels, equation (2)"),
    PCI_FIELD_REPORT(pc_label_report, bound, DOUBLE, "", "No labels have a smaller value"),
    PCI_FIELD_REPORT(pc_label_report, gap, DOUBLE, "", "(objective - bound) / max(1, objective)"),
    PCI_FIELD_REPORT(pc_label_report, roof_bound, DOUBLE, "", "Bound of roof duality alone"),
    PCI_FIELD_REPORT(pc_label_report, fixed, COUNT, "", "Labels that roof duality proves"),
    PCI_FIELD_REPORT(pc_label_report, residual, COUNT, "", "Labels that it leaves open"),
    PCI_FIELD_REPORT(pc_label_report, residual_components, COUNT, "",
                     "Independent parts of the open labels"),
    PCI_FIELD_REPORT(pc_label_report, unproven_components, COUNT, "",
                     "Parts that ended without proof"),
};
const pc_record pc_label_report_record = PCI_RECORD(report_fields, pc_label_report);

// The problem in integers: costs are multiplied by a power of two and rounded down, so a bound of
// the integer problem is one of the original problem.
typedef struct problem {
    pci_signed_graph graph; // vertex v of the guide graph is v + 1
    int exponent;           // integer = real * 2^exponent
} problem;

pc_status pci_label_check(pc_context *context, const pc_graph *graph) {
    const size_t n = graph->vertex_count;
    if (n > (UINT32_MAX - 8) / 2 || graph->edge_count > UINT32_MAX / 64 ||
        graph->opposite_count > UINT32_MAX / 64) {
        return pci_fail(context, PC_ERROR_TOO_LARGE, stage,
                        "label: graph of %zu vertices, %zu edges and %zu opposite edges", n,
                        graph->edge_count, graph->opposite_count);
    }
    for (size_t e = 0; e < graph->edge_count; ++e) {
        const uint32_t a = graph->edges[2 * e], b = graph->edges[2 * e + 1];
        if (a >= n || b >= n || a == b) {
            return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                            "label: edge %zu connects %u and %u of %zu vertices", e, a, b, n);
        }
        if (!(graph->edge_weights[e] >= 0.0) || !isfinite(graph->edge_weights[e])) {
            return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                            "label: weight %g of edge %zu is negative or not finite",
                            graph->edge_weights[e], e);
        }
    }
    for (size_t e = 0; e < graph->opposite_count; ++e) {
        const uint32_t a = graph->opposites[2 * e], b = graph->opposites[2 * e + 1];
        if (a >= n || b >= n || a == b) {
            return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                            "label: opposite edge %zu connects %u and %u of %zu vertices", e, a, b,
                            n);
        }
        if (graph->opposite_signs[e] < -1 || graph->opposite_signs[e] > 1) {
            return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                            "label: sign %d of opposite edge %zu is not -1, 0 or 1",
                            graph->opposite_signs[e], e);
        }
    }
    return PC_OK;
}

static int64_t scaled(double cost, int exponent) { return (int64_t)floor(ldexp(cost, exponent)); }

// Orders pairs of vertices.
static uint64_t pair_key(const uint32_t *pair) {
    const uint32_t low = pair[0] < pair[1] ? pair[0] : pair[1];
    return (uint64_t)low << 32 | (low == pair[0] ? pair[1] : pair[0]);
}

// Equation (3) and the second term of (2) as wishes of pairs, merged in ascending order when the
// guide graph's edges are, as they should be. With a sign, labels (outer 1, inner 0) cost 0, the
// reverse costs the bias b and equal labels cost 1 + b: opposite labels are worth 1 + b / 2, each
// end's own wish b / 2.
static size_t make_pairs(const pc_graph *graph, const pc_label_options *o, int exponent,
                         pci_signed_edge *pairs) {
    const double half_bias = 0.5 * o->lambda_bias * o->lambda_opposite;
    size_t count = 0;
    for (size_t e = 0, k = 0; e < graph->edge_count || k < graph->opposite_count;) {
        const uint32_t *edge = &graph->edges[2 * e], *opposite = &graph->opposites[2 * k];
        if (k == graph->opposite_count ||
            (e < graph->edge_count && pair_key(edge) <= pair_key(opposite))) {
            pairs[count++] = (pci_signed_edge){
                .a = edge[0] + 1,
                .b = edge[1] + 1,
                .cost = scaled(o->lambda_smooth * graph->edge_weights[e], exponent)};
            ++e;
        } else {
            const double cost =
                o->lambda_opposite + (graph->opposite_signs[k] != 0 ? half_bias : 0.0);
            pairs[count++] = (pci_signed_edge){.a = opposite[0] + 1,
                                               .b = opposite[1] + 1,
                                               .opposite = true,
                                               .cost = scaled(cost, exponent)};
            ++k;
        }
    }
    return count;
}

// What single vertices wish: wishes[v] > 0 for label 1. Returns what contrary wishes cost in any
// case.
static int64_t make_wishes(pci_scratch *scratch, const pc_graph *graph, const pc_label_options *o,
                           int exponent, int64_t *wishes) {
    // Without opposites it is no part of the sum that the exponent fits.
    const int64_t wish =
        graph->opposite_count > 0 ? scaled(0.5 * o->lambda_bias * o->lambda_opposite, exponent) : 0;
    int64_t *against = PCI_SCRATCH(scratch, int64_t, graph->vertex_count + 1);
    int64_t constant = 0;
    for (size_t k = 0; k < graph->opposite_count && against != NULL; ++k) {
        const int sign = graph->opposite_signs[k];
        if (sign != 0) {
            wishes[graph->opposites[2 * k + (sign > 0 ? 0 : 1)] + 1] += wish;
            against[graph->opposites[2 * k + (sign > 0 ? 1 : 0)] + 1] += wish;
        }
    }
    for (size_t v = 1; v <= graph->vertex_count && against != NULL; ++v) {
        constant += wishes[v] < against[v] ? wishes[v] : against[v];
        wishes[v] -= against[v];
    }
    return constant;
}

// Lets the lowest vertex of each connected part without wishes wish label 1, whatever that costs:
// flipping the whole part is free, so this is no restriction.
static void pin_free_parts(pci_scratch *scratch, const pci_signed_graph *pairs, int64_t *wishes) {
    uint32_t *parent = PCI_SCRATCH(scratch, uint32_t, pairs->vertex_count);
    int64_t *incident = PCI_SCRATCH(scratch, int64_t, pairs->vertex_count);
    if (scratch->failed) {
        return;
    }
    pci_singletons(parent, pairs->vertex_count);
    for (uint32_t v = 1; v < pairs->vertex_count; ++v) {
        if (wishes[v] != 0) {
            pci_unite(parent, PCI_GROUND, v);
        }
    }
    for (size_t e = 0; e < pairs->edge_count; ++e) {
        pci_unite(parent, pairs->edges[e].a, pairs->edges[e].b);
        incident[pairs->edges[e].a] += pairs->edges[e].cost;
        incident[pairs->edges[e].b] += pairs->edges[e].cost;
    }
    for (uint32_t v = 1; v < pairs->vertex_count; ++v) {
        if (parent[v] == v) {
            wishes[v] = incident[v] + 1;
        }
    }
}

static pc_status make_problem(pc_context *context, pci_scratch *scratch, const pc_graph *graph,
                              const pc_label_options *o, problem *p) {
    const size_t vertices = graph->vertex_count + 1;
    double total = 0.0;
    for (size_t e = 0; e < graph->edge_count; ++e) {
        total += o->lambda_smooth * graph->edge_weights[e];
    }
    total += (double)graph->opposite_count * o->lambda_opposite * (1.0 + 1.5 * o->lambda_bias);
    if (!(total <= 0x1p1000)) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "label: the sum of all weights, %g, is too large", total);
    }
    int magnitude = 0;
    (void)frexp(total, &magnitude);
    p->exponent = 58 - magnitude;
    // The wishes of vertices, as edges to the ground, go before those of pairs.
    pci_signed_edge *edges =
        PCI_SCRATCH(scratch, pci_signed_edge, vertices + graph->edge_count + graph->opposite_count);
    int64_t *wishes = PCI_SCRATCH(scratch, int64_t, vertices);
    if (scratch->failed) {
        return pci_fail_memory(context, stage);
    }
    const size_t pair_count = make_pairs(graph, o, p->exponent, edges + vertices);
    if (!pci_keep_going(context)) {
        return pci_fail_cancelled(context, stage);
    }
    pci_signed_graph_create(vertices, edges + vertices, pair_count, &p->graph);
    int64_t constant = p->graph.constant;
    constant += make_wishes(scratch, graph, o, p->exponent, wishes);
    pin_free_parts(scratch, &p->graph, wishes);
    if (scratch->failed) {
        return pci_fail_memory(context, stage);
    }
    pci_signed_edge *first = edges + vertices;
    for (uint32_t v = (uint32_t)vertices; v-- > 1;) {
        if (wishes[v] != 0) {
            *--first = (pci_signed_edge){.a = PCI_GROUND,
                                         .b = v,
                                         .opposite = wishes[v] < 0,
                                         .cost = wishes[v] < 0 ? -wishes[v] : wishes[v]};
        }
    }
    const size_t wish_count = (size_t)(edges + vertices - first);
    pci_signed_graph_create(vertices, first, wish_count + p->graph.edge_count, &p->graph);
    p->graph.constant += constant;
    return PC_OK;
}

// A little smaller than the real value, so that rounding never lifts a bound.
static double real_bound(const problem *p, int64_t bound) {
    return ldexp((double)bound, -p->exponent) * (1.0 - 16.0 * DBL_EPSILON);
}

pc_status pc_label(pc_context *context, const pc_graph *graph, const pc_label_options *options,
                   pc_labels *labels, pc_label_report *report) {
    if (graph == NULL || labels == NULL || labels->labels != NULL || labels->vertex_count != 0) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "label: the graph is missing, or the output is not empty");
    }
    pc_label_options chosen;
    pc_status status = pci_begin_stage(context, stage, &pc_label_options_record, options, &chosen);
    if (status == PC_OK) {
        status = pci_label_check(context, graph);
    }
    if (status != PC_OK) {
        return status;
    }
    options = &chosen;
    const size_t n = graph->vertex_count;
    pci_scratch scratch = pci_scratch_begin(context);
    problem p = {0};
    pci_signed_solution solution = {0};
    status = make_problem(context, &scratch, graph, options, &p);
    if (status != PC_OK) {
        goto cleanup;
    }
    labels->labels = PCI_ALLOCATE(context, uint8_t, n);
    solution.labels = PCI_SCRATCH(&scratch, uint8_t, n + 1);
    if (labels->labels == NULL || scratch.failed) {
        status = pci_fail_memory(context, stage);
        goto cleanup;
    }
    const pci_budget budget = {.total = options->label_effort * WORK_PER_EFFORT,
                               .left = options->label_effort * WORK_PER_EFFORT,
                               .deadline = options->label_seconds > 0.0
                                               ? pci_clock_seconds() + options->label_seconds
                                               : 0.0};
    status = pci_keep_going(context) ? pci_signed_solve(context, stage, &p.graph, budget, &solution)
                                     : pci_fail_cancelled(context, stage);
    if (status != PC_OK) {
        goto cleanup;
    }
    labels->vertex_count = n;
    memcpy(labels->labels, solution.labels + 1, n);
    if (report != NULL) {
        const double objective = pc_label_objective(graph, options, labels->labels);
        *report = (pc_label_report){
            .objective = objective,
            .bound = fmin(real_bound(&p, solution.bound), objective),
            .roof_bound = fmin(real_bound(&p, solution.roof_bound), objective),
            .fixed = n - solution.open_vertices,
            .residual = solution.open_vertices,
            .residual_components = solution.components,
            .unproven_components = solution.unproven,
        };
        report->gap = (objective - report->bound) / fmax(1.0, objective);
        report->outcome = report->gap <= OPTIMAL_GAP ? PC_LABEL_OPTIMAL : PC_LABEL_FEASIBLE;
    }
cleanup:
    if (status != PC_OK) {
        pc_labels_free(context, labels);
    }
    pci_scratch_end(&scratch);
    return status;
}

double pc_label_objective(const pc_graph *graph, const pc_label_options *options,
                          const uint8_t *labels) {
    // Compensated sum: the value carries no trace of the number of terms.
    double sum = 0.0, rest = 0.0;
    for (size_t k = 0; k < graph->edge_count + graph->opposite_count; ++k) {
        double term = 0.0;
        if (k < graph->edge_count) {
            const bool differ = labels[graph->edges[2 * k]] != labels[graph->edges[2 * k + 1]];
            term = differ ? options->lambda_smooth * graph->edge_weights[k] : 0.0;
        } else {
            const size_t e = k - graph->edge_count;
            const int difference =
                labels[graph->opposites[2 * e]] - labels[graph->opposites[2 * e + 1]];
            const int sign = graph->opposite_signs[e];
            term = options->lambda_opposite *
                   ((difference == 0 ? 1.0 : 0.0) +
                    (sign != 0 && difference != sign ? options->lambda_bias : 0.0));
        }
        const double next = sum + term;
        rest += sum >= term ? (sum - next) + term : (term - next) + sum;
        sum = next;
    }
    return sum + rest;
}
