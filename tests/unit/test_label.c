// Labelling: every claim (objective, bound, optimality) is checked against enumeration.
#include <float.h>
#include <stdio.h>
#include <stdlib.h>

#include "solvers/cycle_bound.h"
#include "solvers/cycle_search.h"
#include "solvers/elimination.h"
#include "solvers/maxflow.h"
#include "solvers/roof_duality.h"
#include "support/memory.h"

// ---- small graphs -----------------------------------------------------------------------------

enum { MAX_VERTICES = 16, MAX_EDGES = 64 };

typedef struct small_graph {
    pc_graph graph;
    uint32_t edges[2 * MAX_EDGES], opposites[2 * MAX_EDGES];
    double weights[MAX_EDGES];
    int8_t signs[MAX_EDGES];
} small_graph;

static void start_graph(small_graph *g, size_t vertices) {
    memset(g, 0, sizeof(*g));
    g->graph.vertex_count = vertices;
    g->graph.edges = g->edges;
    g->graph.edge_weights = g->weights;
    g->graph.opposites = g->opposites;
    g->graph.opposite_signs = g->signs;
}

static void add_edge(small_graph *g, uint32_t a, uint32_t b, double weight) {
    const size_t e = g->graph.edge_count++;
    g->edges[2 * e] = a, g->edges[2 * e + 1] = b;
    g->weights[e] = weight;
}

static void add_opposite(small_graph *g, uint32_t a, uint32_t b, int sign) {
    const size_t e = g->graph.opposite_count++;
    g->opposites[2 * e] = a, g->opposites[2 * e + 1] = b;
    g->signs[e] = (int8_t)sign;
}

// Kinds of random graphs: real weights, small integers (many ties), many zeros, wide range.
static void random_graph(small_graph *g, uint64_t seed) {
    uint64_t counter = 0;
#define DRAW(n) ((uint32_t)(pci_random_bits(seed, 1, counter++) % (n)))
    const uint32_t n = 1 + DRAW(MAX_VERTICES);
    const uint32_t kind = DRAW(5);
    start_graph(g, n);
    const uint32_t edges = n < 2 ? 0 : DRAW(3 * n), opposites = n < 2 ? 0 : DRAW(2 * n + 1);
    for (uint32_t k = 0; k < edges && k < MAX_EDGES; ++k) {
        const uint32_t a = DRAW(n), b = (a + 1 + DRAW(n - 1)) % n;
        const double real = pci_random(seed, 2, k);
        const double integer = (double)DRAW(3);
        const double weights[5] = {real, integer, integer < 1.0 ? real : 0.0,
                                   exp(20.0 * real - 10.0), 0.99 + 0.01 * real};
        add_edge(g, a, b, weights[kind]);
    }
    for (uint32_t k = 0; k < opposites && k < MAX_EDGES; ++k) {
        const uint32_t a = DRAW(n), b = (a + 1 + DRAW(n - 1)) % n;
        add_opposite(g, a, b, kind == 4 ? 0 : (int)DRAW(3) - 1);
    }
#undef DRAW
}

// Equations (2) and (3), straight from the paper.
static double definition(const pc_graph *graph, const pc_label_options *o, const uint8_t *l) {
    double smooth = 0.0, opposite = 0.0;
    for (size_t e = 0; e < graph->edge_count; ++e) {
        smooth += l[graph->edges[2 * e]] != l[graph->edges[2 * e + 1]] ? graph->edge_weights[e] : 0;
    }
    for (size_t e = 0; e < graph->opposite_count; ++e) {
        const int a = l[graph->opposites[2 * e]], b = l[graph->opposites[2 * e + 1]];
        const int sign = graph->opposite_signs[e];
        opposite += a == b ? 1.0 : 0.0;
        opposite += sign != 0 && a - b != sign ? o->lambda_bias : 0.0;
    }
    return o->lambda_smooth * smooth + o->lambda_opposite * opposite;
}

static double brute_force(const pc_graph *graph, const pc_label_options *o) {
    double best = (double)INFINITY;
    uint8_t labels[MAX_VERTICES];
    for (uint32_t bits = 0; bits < 1u << graph->vertex_count; ++bits) {
        for (uint32_t v = 0; v < graph->vertex_count; ++v) {
            labels[v] = bits >> v & 1u;
        }
        best = fmin(best, definition(graph, o, labels));
    }
    return best;
}

static pc_label_options make_options(double smooth, double opposite, double bias, uint32_t effort) {
    return (pc_label_options){.lambda_smooth = smooth,
                              .lambda_opposite = opposite,
                              .lambda_bias = bias,
                              .label_effort = effort};
}

// Checks all that the header promises; returns whether optimality was proven.
static bool check_against_brute_force(pc_context *context, const pc_graph *graph,
                                      const pc_label_options *o) {
    const double optimum = brute_force(graph, o);
    const double scale = fmax(1.0, optimum);
    pc_labels labels = {0};
    pc_label_report report;
    assert_ok(context, pc_label(context, graph, o, &labels, &report));
    assert_int_equal(labels.vertex_count, graph->vertex_count);
    for (size_t v = 0; v < graph->vertex_count; ++v) {
        assert_true(labels.labels[v] <= 1);
    }
    assert_close(report.objective, definition(graph, o, labels.labels), 1e-13 * scale);
    assert_true(report.objective == pc_label_objective(graph, o, labels.labels));
    assert_true(report.objective >= optimum - 1e-13 * scale);
    assert_true(report.bound <= optimum * (1.0 + 4.0 * DBL_EPSILON));
    assert_true(report.roof_bound <= report.bound + 1e-9 * scale);
    assert_true(report.bound <= report.objective);
    assert_close(report.gap, (report.objective - report.bound) / fmax(1.0, report.objective),
                 1e-15);
    assert_int_equal(report.fixed + report.residual, graph->vertex_count);
    const bool optimal = report.outcome == PC_LABEL_OPTIMAL;
    assert_int_equal(optimal, report.gap <= 1e-6);
    if (optimal) {
        assert_close(report.objective, optimum, 1e-6 * scale);
    }
    pc_labels_free(context, &labels);
    return optimal;
}

static void agrees_with_enumeration(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    const double settings[][3] = {{3, 1, 1},     {1, 1, 0.5}, {1, 1, 0},
                                  {0.3, 1, 0.1}, {0, 1, 2},   {1, 0, 1}};
    for (uint64_t seed = 0; seed < 600; ++seed) {
        const double *s = settings[seed % (sizeof(settings) / sizeof(settings[0]))];
        const uint32_t effort = seed / 6 % 4 == 0 ? 0 : 100;
        const pc_label_options o = make_options(s[0], s[1], s[2], effort);
        small_graph g;
        random_graph(&g, seed);
        const bool optimal = check_against_brute_force(context, &g.graph, &o);
        if (effort != 0 && !optimal) {
            fail_msg("seed %d: a small graph was not solved to the optimum", (int)seed);
        }
    }
    pc_context_destroy(context);
}

// ---- signed graphs ------------------------------------------------------------------------------

enum { MAX_SIGNED = 13 };

// Small integer costs, so that ties abound; odd seeds have no edge to the ground.
static void random_signed_graph(uint64_t seed, pci_signed_edge *edges, pci_signed_graph *graph) {
    const uint32_t n = 4 + (uint32_t)(pci_random_bits(seed, 3, 0) % (MAX_SIGNED - 3));
    const uint32_t first = (uint32_t)(seed % 2), span = n - first;
    const size_t count = 1 + pci_random_bits(seed, 3, 1) % (4 * n);
    for (size_t e = 0; e < count; ++e) {
        const uint64_t bits = pci_random_bits(seed, 4, e);
        const uint32_t a = (uint32_t)(bits % span);
        edges[e] =
            (pci_signed_edge){.a = first + a,
                              .b = first + (a + 1 + (uint32_t)(bits >> 8) % (span - 1)) % span,
                              .opposite = bits >> 40 & 1,
                              .cost = (int64_t)(bits >> 48) % (seed % 3 == 0 ? 1000 : 5)};
    }
    pci_signed_graph_create(n, edges, count, graph);
}

static void decode(uint32_t bits, size_t n, uint8_t *labels) {
    for (size_t v = 0; v < n; ++v) {
        labels[v] = bits >> v & 1u;
    }
}

static int64_t signed_optimum(const pci_signed_graph *graph) {
    int64_t best = INT64_MAX;
    for (uint32_t bits = 1; bits < 1u << graph->vertex_count; bits += 2) {
        uint8_t labels[MAX_SIGNED];
        decode(bits, graph->vertex_count, labels);
        const int64_t cost = pci_signed_graph_cost(graph, labels);
        best = cost < best ? cost : best;
    }
    return best;
}

static void elimination_is_exact(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    for (uint64_t seed = 0; seed < 300; ++seed) {
        pci_signed_edge edges[4 * MAX_SIGNED];
        pci_signed_graph graph;
        random_signed_graph(seed, edges, &graph);
        uint8_t labels[MAX_SIGNED];
        bool solved = false;
        assert_true(pci_eliminate(context, &graph, MAX_SIGNED, 1 << 16, labels, &solved));
        assert_true(solved);
        assert_int_equal(labels[PCI_GROUND], 1);
        assert_int_equal(pci_signed_graph_cost(&graph, labels), signed_optimum(&graph));
    }
    // A clique of 6 without the ground is 5 wide.
    pci_signed_edge edges[15];
    size_t count = 0;
    for (uint32_t a = 1; a < 7; ++a) {
        for (uint32_t b = a + 1; b < 7; ++b) {
            edges[count++] = (pci_signed_edge){.a = a, .b = b, .opposite = true, .cost = 1};
        }
    }
    pci_signed_graph graph;
    pci_signed_graph_create(7, edges, count, &graph);
    uint8_t labels[7];
    bool solved = true;
    assert_true(pci_eliminate(context, &graph, 4, 1 << 16, labels, &solved));
    assert_false(solved);
    assert_true(pci_eliminate(context, &graph, 5, 62, labels, &solved));
    assert_false(solved); // 32 + 16 + 8 + 4 + 2 + 1 entries
    assert_true(pci_eliminate(context, &graph, 5, 63, labels, &solved));
    assert_true(solved);
    assert_int_equal(pci_signed_graph_cost(&graph, labels), 6);
    pc_context_destroy(context);
}

// The certificate says: a labelling costs at least the bound plus the residuals of the edges whose
// wishes it violates.
static void cycle_bound_holds(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    size_t tight = 0, above_roof = 0;
    for (uint64_t seed = 0; seed < 200; ++seed) {
        pci_signed_edge edges[4 * MAX_SIGNED];
        pci_signed_graph graph;
        random_signed_graph(seed, edges, &graph);
        pci_scratch scratch = pci_scratch_begin(context);
        uint8_t best[MAX_SIGNED];
        memset(best, 1, sizeof(best));
        pci_budget budget = {.total = 100000, .left = 100000};
        pci_cycle_bound cycles;
        pci_roof roof;
        assert_ok(context, pci_find_cycle_bound(&scratch, "label", &graph, &budget, best, &cycles));
        assert_true(pci_roof_duality(&scratch, &graph, &roof));
        const int64_t optimum = signed_optimum(&graph);
        assert_int_equal(best[PCI_GROUND], 1);
        assert_true(pci_signed_graph_cost(&graph, best) >= optimum);
        assert_true(cycles.bound <= optimum);
        for (uint32_t bits = 1; bits < 1u << graph.vertex_count; bits += 2) {
            uint8_t labels[MAX_SIGNED];
            decode(bits, graph.vertex_count, labels);
            int64_t least = cycles.bound;
            for (size_t e = 0; e < graph.edge_count; ++e) {
                const pci_signed_edge *edge = &graph.edges[e];
                const bool differ = labels[edge->a] != labels[edge->b];
                assert_true(cycles.residuals[e] >= 0);
                least += differ != edge->opposite ? cycles.residuals[e] : 0;
            }
            assert_true(pci_signed_graph_cost(&graph, labels) >= least);
        }
        tight += cycles.bound == optimum;
        above_roof += cycles.bound > roof.bound;
        pci_scratch_end(&scratch);
    }
    // It is worth its name.
    assert_true(tight > 100);
    assert_true(above_roof > 40);
    pc_context_destroy(context);
}

// Cycles through the ground are worth what roof duality proves, and what they leave of the edges
// stays due on top.
static void ground_cycles_fit(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    size_t worth = 0;
    for (uint64_t seed = 0; seed < 200; ++seed) {
        pci_signed_edge edges[4 * MAX_SIGNED];
        int64_t capacities[4 * MAX_SIGNED], gain = -1;
        pci_signed_graph graph;
        random_signed_graph(seed, edges, &graph);
        for (size_t e = 0; e < graph.edge_count; ++e) {
            capacities[e] = graph.edges[e].cost;
        }
        pci_scratch scratch = pci_scratch_begin(context);
        pci_roof roof;
        assert_true(pci_roof_duality(&scratch, &graph, &roof));
        assert_true(pci_pack_ground_cycles(&scratch, &graph, capacities, &gain));
        assert_true(roof.bound - graph.constant - gain <= 1 && roof.bound >= graph.constant + gain);
        for (uint32_t bits = 1; bits < 1u << graph.vertex_count; bits += 2) {
            uint8_t labels[MAX_SIGNED];
            decode(bits, graph.vertex_count, labels);
            int64_t least = graph.constant + gain;
            for (size_t e = 0; e < graph.edge_count; ++e) {
                const pci_signed_edge *edge = &graph.edges[e];
                assert_in_range(capacities[e], 0, edge->cost);
                const bool differ = labels[edge->a] != labels[edge->b];
                least += differ != edge->opposite ? capacities[e] : 0;
            }
            assert_true(pci_signed_graph_cost(&graph, labels) >= least);
        }
        worth += gain > 0;
        pci_scratch_end(&scratch);
    }
    assert_true(worth > 50);
    pc_context_destroy(context);
}

// Whether the edges form closed walks with an odd number of wishes for different labels.
static bool is_negative_cycle(const pci_signed_graph *graph, const uint32_t *edges, size_t count) {
    uint32_t degrees[MAX_SIGNED] = {0}, opposites = 0;
    for (size_t k = 0; k < count; ++k) {
        ++degrees[graph->edges[edges[k]].a];
        ++degrees[graph->edges[edges[k]].b];
        opposites += graph->edges[edges[k]].opposite;
    }
    bool closed = true;
    for (size_t v = 0; v < graph->vertex_count; ++v) {
        closed = closed && degrees[v] % 2 == 0;
    }
    return closed && opposites % 2 == 1;
}

// What the search adds are negative cycles; what it packs is due in every labelling, and what that
// leaves of the edges stays due on top. With optimal labels, both together are often all there is.
static void found_cycles_are_negative(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    size_t cycles = 0, filled = 0, complete = 0;
    for (uint64_t seed = 0; seed < 200; ++seed) {
        pci_signed_edge edges[4 * MAX_SIGNED];
        int64_t capacities[4 * MAX_SIGNED];
        pci_signed_graph graph;
        random_signed_graph(seed, edges, &graph);
        uint8_t best[MAX_SIGNED];
        const int64_t optimum = signed_optimum(&graph);
        for (uint32_t bits = 1; bits < 1u << graph.vertex_count; bits += 2) {
            uint8_t labels[MAX_SIGNED];
            decode(bits, graph.vertex_count, labels);
            if (pci_signed_graph_cost(&graph, labels) == optimum) {
                memcpy(best, labels, sizeof(best));
            }
        }
        pci_scratch scratch = pci_scratch_begin(context);
        pci_cycle_program program;
        pci_cycle_search search;
        size_t added = 0;
        uint64_t work = 0;
        assert_true(pci_cycle_program_create(&scratch, &graph, &program));
        assert_true(pci_cycle_search_create(&scratch, &program, &search));
        for (uint32_t round = 0; round < 3; ++round) {
            assert_true(pci_cycle_search_run(&search, best, round, &added, &work));
            pci_cycle_program_iterate(&program);
        }
        for (size_t c = 0, begin = 0; c < program.cycle_count; begin = program.cycles[c++].end) {
            assert_true(
                is_negative_cycle(&graph, &program.entries[begin], program.cycles[c].end - begin));
        }
        cycles += program.cycle_count;
        for (size_t e = 0; e < graph.edge_count; ++e) {
            capacities[e] = graph.edges[e].cost;
        }
        const int64_t gain = pci_cycle_search_fill(&search, best, capacities, &work);
        for (uint32_t bits = 1; bits < 1u << graph.vertex_count; bits += 2) {
            uint8_t labels[MAX_SIGNED];
            decode(bits, graph.vertex_count, labels);
            int64_t least = graph.constant + gain;
            for (size_t e = 0; e < graph.edge_count; ++e) {
                const pci_signed_edge *edge = &graph.edges[e];
                assert_in_range(capacities[e], 0, edge->cost);
                const bool differ = labels[edge->a] != labels[edge->b];
                least += differ != edge->opposite ? capacities[e] : 0;
            }
            assert_true(pci_signed_graph_cost(&graph, labels) >= least);
        }
        filled += gain > 0;
        complete += gain > 0 && graph.constant + gain == optimum;
        pci_scratch_end(&scratch);
    }
    assert_true(cycles > 200);
    assert_true(filled > 50);
    assert_true(complete > 20);
    pc_context_destroy(context);
}

// Each labelling of the contracted graph costs what its expansion costs.
static void contraction_keeps_costs(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    for (uint64_t seed = 0; seed < 100; ++seed) {
        pci_signed_edge edges[4 * MAX_SIGNED];
        pci_signed_graph graph;
        random_signed_graph(seed, edges, &graph);
        uint8_t granted[4 * MAX_SIGNED] = {0};
        for (size_t e = 0; e < graph.edge_count; ++e) {
            granted[e] = pci_random(seed, 8, e) < 0.15;
        }
        pci_scratch scratch = pci_scratch_begin(context);
        pci_contraction reduced;
        assert_true(pci_signed_graph_contract(&scratch, &graph, granted, &reduced));
        const size_t n = reduced.graph.vertex_count;
        assert_int_equal(reduced.classes[PCI_GROUND], PCI_GROUND);
        assert_int_equal(reduced.flips[PCI_GROUND], 0);
        for (uint32_t bits = 1; bits < 1u << n; bits += 2) {
            uint8_t labels[MAX_SIGNED], expanded[MAX_SIGNED];
            decode(bits, n, labels);
            for (size_t v = 0; v < graph.vertex_count; ++v) {
                expanded[v] = labels[reduced.classes[v]] ^ reduced.flips[v];
            }
            assert_int_equal(pci_signed_graph_cost(&reduced.graph, labels),
                             pci_signed_graph_cost(&graph, expanded));
        }
        pci_scratch_end(&scratch);
    }
    pc_context_destroy(context);
}

// ---- roof duality -------------------------------------------------------------------------------

static void roof_labels_extend_to_an_optimum(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    size_t fixed = 0, open = 0;
    for (uint64_t seed = 0; seed < 400; ++seed) {
        pci_signed_edge edges[4 * MAX_SIGNED];
        pci_signed_graph graph;
        random_signed_graph(seed, edges, &graph);
        const size_t n = graph.vertex_count;
        pci_scratch scratch = pci_scratch_begin(context);
        pci_roof roof;
        assert_true(pci_roof_duality(&scratch, &graph, &roof));
        assert_int_equal(roof.labels[PCI_GROUND], 1);
        int64_t best = INT64_MAX, best_with_roof = INT64_MAX;
        for (uint32_t bits = 1; bits < 1u << n; bits += 2) {
            uint8_t labels[MAX_SIGNED];
            bool follows = true;
            decode(bits, n, labels);
            for (size_t v = 0; v < n; ++v) {
                follows =
                    follows && (roof.labels[v] == PCI_NO_LABEL || roof.labels[v] == labels[v]);
            }
            const int64_t cost = pci_signed_graph_cost(&graph, labels);
            best = cost < best ? cost : best;
            best_with_roof = follows && cost < best_with_roof ? cost : best_with_roof;
        }
        assert_int_equal(best_with_roof, best);
        assert_true(roof.bound <= best);
        // Components do not touch each other.
        for (size_t e = 0; e < graph.edge_count; ++e) {
            const uint32_t a = graph.edges[e].a, b = graph.edges[e].b;
            if (roof.labels[a] == PCI_NO_LABEL && roof.labels[b] == PCI_NO_LABEL) {
                assert_int_equal(roof.components[a], roof.components[b]);
            }
        }
        for (uint32_t v = 1; v < n; ++v) {
            *(roof.labels[v] == PCI_NO_LABEL ? &open : &fixed) += 1;
        }
        // Where everything is labelled, the bound is the optimum.
        if (roof.component_count == 0) {
            assert_int_equal(roof.bound, best);
        }
        pci_scratch_end(&scratch);
    }
    assert_true(fixed > 100 && open > 100);
    pc_context_destroy(context);
}

static void *zeroed(size_t count, size_t size) {
    void *memory = calloc(count, size);
    assert_non_null(memory);
    return memory;
}

// A network whose arcs are listed by their tails.
typedef struct flow_case {
    pci_flow_network net;
    uint32_t *heads, *arcs;
    size_t *offsets;
    int64_t *before, *start; // capacities and terminals
    uint8_t *reachable;
    int64_t flow;
} flow_case;

static void make_flow_case(uint64_t seed, uint32_t nodes, uint32_t edges, flow_case *c) {
    const uint32_t arcs = 2 * edges;
    *c = (flow_case){.heads = zeroed(arcs, sizeof(*c->heads)),
                     .arcs = zeroed(arcs, sizeof(*c->arcs)),
                     .offsets = zeroed(nodes + 2, sizeof(*c->offsets)),
                     .before = zeroed(arcs, sizeof(*c->before)),
                     .start = zeroed(nodes, sizeof(*c->start)),
                     .reachable = zeroed(nodes, 1)};
    for (uint32_t e = 0; e < edges; ++e) {
        const uint64_t bits = pci_random_bits(seed, 5, e);
        c->heads[2 * e] = (uint32_t)(bits % nodes);
        c->heads[2 * e + 1] = (c->heads[2 * e] + 1 + (uint32_t)(bits >> 8) % (nodes - 1)) % nodes;
        c->before[2 * e] = (int64_t)(bits >> 40 & 15);
        c->before[2 * e + 1] = (int64_t)(bits >> 50 & 3);
    }
    for (uint32_t arc = 0; arc < arcs; ++arc) {
        ++c->offsets[c->heads[arc ^ 1u] + 2];
    }
    for (uint32_t v = 0; v < nodes; ++v) {
        c->offsets[v + 2] += c->offsets[v + 1];
        c->start[v] = (int64_t)(pci_random_bits(seed, 6, v) % 31) - 15;
    }
    for (uint32_t arc = 0; arc < arcs; ++arc) {
        c->arcs[c->offsets[c->heads[arc ^ 1u] + 1]++] = arc;
    }
    c->net = (pci_flow_network){.node_count = nodes,
                                .arc_count = arcs,
                                .heads = c->heads,
                                .offsets = c->offsets,
                                .arcs = c->arcs,
                                .capacities = zeroed(arcs, sizeof(*c->before)),
                                .terminals = zeroed(nodes, sizeof(*c->start))};
}

static void solve_flow_case(pc_context *context, flow_case *c) {
    memcpy(c->net.capacities, c->before, c->net.arc_count * sizeof(*c->before));
    memcpy(c->net.terminals, c->start, c->net.node_count * sizeof(*c->start));
    assert_true(pci_maxflow(context, &c->net, &c->flow, c->reachable));
}

static void free_flow_case(flow_case *c) {
    void *const all[] = {c->heads, c->arcs,      c->offsets,        c->before,
                         c->start, c->reachable, c->net.capacities, c->net.terminals};
    for (size_t i = 0; i < sizeof(all) / sizeof(all[0]); ++i) {
        free(all[i]);
    }
}

// A flow that equals a cut is maximal, and the cut minimal.
static void check_flow(const flow_case *c) {
    const int64_t *capacities = c->net.capacities;
    int64_t cut = 0, sent = 0;
    int64_t *inflow = zeroed(c->net.node_count, sizeof(*inflow));
    memcpy(inflow, c->start, c->net.node_count * sizeof(*inflow));
    for (size_t arc = 0; arc < c->net.arc_count; arc += 2) {
        const int64_t along = c->before[arc] - capacities[arc];
        const uint32_t to = c->heads[arc], from = c->heads[arc + 1];
        assert_true(capacities[arc] >= 0 && capacities[arc + 1] >= 0);
        assert_int_equal(capacities[arc] + capacities[arc + 1],
                         c->before[arc] + c->before[arc + 1]);
        inflow[from] -= along, inflow[to] += along;
        cut += c->reachable[from] && !c->reachable[to] ? c->before[arc] : 0;
        cut += c->reachable[to] && !c->reachable[from] ? c->before[arc + 1] : 0;
    }
    for (size_t v = 0; v < c->net.node_count; ++v) {
        // What came from or went to the terminal is balanced by the arcs.
        const int64_t start = c->start[v];
        assert_int_equal(inflow[v], c->net.terminals[v]);
        sent += start > 0 ? start - c->net.terminals[v] : 0;
        cut += start > 0 && !c->reachable[v] ? start : 0;
        cut += start < 0 && c->reachable[v] ? -start : 0;
    }
    assert_int_equal(sent, c->flow);
    assert_int_equal(cut, c->flow);
    free(inflow);
}

static void flow_equals_cut(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    for (uint64_t seed = 0; seed < 100; ++seed) {
        flow_case c;
        make_flow_case(seed, 40, 130, &c);
        solve_flow_case(context, &c);
        check_flow(&c);
        free_flow_case(&c);
    }
    pc_context_destroy(context);
}

// Large networks are searched in parts, by as many threads as there are.
static void large_flow_equals_cut(void **state) {
    (void)state;
    pc_context *contexts[2] = {test_context(1), test_context(3)};
    flow_case c[2];
    for (size_t i = 0; i < 2; ++i) {
        make_flow_case(7, 6001, 20000, &c[i]);
        solve_flow_case(contexts[i], &c[i]);
        check_flow(&c[i]);
        pc_context_destroy(contexts[i]);
    }
    assert_memory_equal(c[0].net.capacities, c[1].net.capacities,
                        c[0].net.arc_count * sizeof(*c[0].before));
    free_flow_case(&c[0]);
    free_flow_case(&c[1]);
}

// ---- special cases ------------------------------------------------------------------------------

static void trivial_graphs(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    small_graph g;
    pc_label_report report;
    pc_labels labels = {0};
    start_graph(&g, 0);
    assert_ok(context, pc_label(context, &g.graph, NULL, &labels, &report));
    assert_int_equal(labels.vertex_count, 0);
    assert_int_equal(report.outcome, PC_LABEL_OPTIMAL);
    pc_labels_free(context, &labels);
    // A vertex that nothing opposes is kept.
    start_graph(&g, 1);
    assert_ok(context, pc_label(context, &g.graph, NULL, &labels, NULL));
    assert_int_equal(labels.labels[0], 1);
    pc_labels_free(context, &labels);
    // So is a connected part without opposite edges, as a whole.
    start_graph(&g, 6);
    add_edge(&g, 0, 5, 1.0);
    add_edge(&g, 5, 3, 1.0);
    add_edge(&g, 1, 2, 0.0);
    assert_ok(context, pc_label(context, &g.graph, NULL, &labels, &report));
    for (size_t v = 0; v < 6; ++v) {
        assert_int_equal(labels.labels[v], 1);
    }
    assert_true(report.objective == 0.0 && report.bound == 0.0);
    pc_labels_free(context, &labels);
    pc_context_destroy(context);
}

// Two sheets of 4 x 4 vertices, outer and inner: the outer one is kept whole.
static void keeps_the_outer_sheet(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    enum { SIDE = 4, SHEET = SIDE * SIDE };
    uint32_t edges[8 * SHEET], opposites[2 * SHEET];
    double weights[4 * SHEET];
    int8_t signs[SHEET];
    pc_graph graph = {.vertex_count = 2 * SHEET,
                      .edges = edges,
                      .edge_weights = weights,
                      .opposites = opposites,
                      .opposite_signs = signs};
    for (uint32_t v = 0; v < 2 * SHEET; ++v) {
        if (v % SIDE + 1 < SIDE) {
            edges[2 * graph.edge_count] = v, edges[2 * graph.edge_count + 1] = v + 1;
            weights[graph.edge_count++] = 1.0;
        }
        if (v % SHEET + SIDE < SHEET) {
            edges[2 * graph.edge_count] = v, edges[2 * graph.edge_count + 1] = v + SIDE;
            weights[graph.edge_count++] = 1.0;
        }
    }
    for (uint32_t v = 0; v < SHEET; ++v) {
        opposites[2 * v] = v, opposites[2 * v + 1] = v + SHEET;
        signs[v] = v == 0 ? -1 : v % 3 == 0 ? 0 : 1; // one vertex thinks otherwise
    }
    graph.opposite_count = SHEET;
    pc_labels labels = {0};
    pc_label_report report;
    assert_ok(context, pc_label(context, &graph, NULL, &labels, &report));
    for (uint32_t v = 0; v < 2 * SHEET; ++v) {
        assert_int_equal(labels.labels[v], v < SHEET);
    }
    assert_int_equal(report.outcome, PC_LABEL_OPTIMAL);
    assert_close(report.objective, 1.0, 1e-12);
    pc_labels_free(context, &labels);
    pc_context_destroy(context);
}

static void extreme_weights(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    const double factors[] = {1e-300, 1e-30, 1e30, 1e250};
    const pc_label_options o = make_options(1, 1, 0.5, 100), smooth_only = make_options(1, 0, 0, 0);
    for (uint64_t seed = 0; seed < 40; ++seed) {
        small_graph g;
        random_graph(&g, seed);
        for (size_t e = 0; e < g.graph.edge_count; ++e) {
            g.weights[e] *= factors[seed % 4];
        }
        check_against_brute_force(context, &g.graph, &o);
        assert_true(check_against_brute_force(context, &g.graph, &smooth_only));
    }
    small_graph g;
    start_graph(&g, 2);
    add_edge(&g, 0, 1, DBL_MAX);
    pc_labels labels = {0};
    assert_int_equal(pc_label(context, &g.graph, NULL, &labels, NULL), PC_ERROR_INVALID_ARGUMENT);
    pc_context_destroy(context);
}

static void bad_input_is_refused(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    const pc_graph no_graph = {0};
    pc_labels no_labels = {0};
    assert_int_equal(pc_label(context, NULL, NULL, &no_labels, NULL), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_label(context, &no_graph, NULL, NULL, NULL), PC_ERROR_INVALID_ARGUMENT);
    for (int fault = 0; fault < 8; ++fault) {
        small_graph g;
        start_graph(&g, 3);
        add_edge(&g, 0, 1, 1.0);
        add_opposite(&g, 1, 2, 1);
        pc_label_options o = make_options(3, 1, 1, 100);
        pc_labels labels = {0};
        pc_status expected = PC_ERROR_INVALID_ARGUMENT;
        uint8_t occupied = 0;
        switch (fault) {
        case 0:
            g.weights[0] = -1e-9;
            break;
        case 1:
            g.weights[0] = (double)NAN;
            break;
        case 2:
            g.weights[0] = (double)INFINITY;
            break;
        case 3:
            g.edges[1] = 3;
            break;
        case 4:
            g.opposites[0] = 7;
            break;
        case 5:
            g.signs[0] = 2;
            break;
        case 6:
            o.lambda_bias = -1.0, expected = PC_ERROR_INVALID_OPTIONS;
            break;
        default:
            labels.labels = &occupied;
            break;
        }
        assert_int_equal(pc_label(context, &g.graph, &o, &labels, NULL), expected);
        assert_true(labels.labels == NULL || fault == 7);
        assert_int_equal(labels.vertex_count, 0);
        assert_string_equal(pc_context_error(context)->stage, "label");
    }
    pc_context_destroy(context);
}

// ---- garments -----------------------------------------------------------------------------------

static void read_graph(pc_context *context, const char *name, pc_graph *graph) {
    char path[512], line[256];
    snprintf(path, sizeof(path), "%s/labelling/%s_nv32.txt", TEST_DATA_DIR, name);
    FILE *file = fopen(path, "r");
    assert_non_null(file);
    assert_non_null(fgets(line, sizeof(line), file));
    assert_int_equal(fscanf(file, "%zu %zu %zu %*f %*f %*f", &graph->vertex_count,
                            &graph->edge_count, &graph->opposite_count),
                     3);
    graph->edges = PCI_ALLOCATE(context, uint32_t, 2 * graph->edge_count);
    graph->edge_weights = PCI_ALLOCATE(context, double, graph->edge_count);
    graph->opposites = PCI_ALLOCATE(context, uint32_t, 2 * graph->opposite_count);
    graph->opposite_signs = PCI_ALLOCATE(context, int8_t, graph->opposite_count);
    for (size_t e = 0; e < graph->edge_count; ++e) {
        assert_int_equal(fscanf(file, "%u %u %lf", &graph->edges[2 * e], &graph->edges[2 * e + 1],
                                &graph->edge_weights[e]),
                         3);
    }
    for (size_t e = 0; e < graph->opposite_count; ++e) {
        int sign = 0;
        assert_int_equal(
            fscanf(file, "%u %u %d", &graph->opposites[2 * e], &graph->opposites[2 * e + 1], &sign),
            3);
        graph->opposite_signs[e] = (int8_t)sign;
    }
    fclose(file);
}

static void garments_reach_proven_optima(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    static const struct {
        const char *name;
        double smooth, bias, optimum;
    } cases[] = {
        {"assistive_gym_hospitalgown", 1, 0.0, 299.552877},
        {"assistive_gym_hospitalgown", 1, 0.1, 301.352877},
        {"assistive_gym_hospitalgown", 1, 0.5, 307.052854},
        {"assistive_gym_hospitalgown", 3, 1.0, 814.0},
        {"codim_multilayer_drape", 1, 0.5, 179.012734},
        {"codim_multilayer_drape", 3, 1.0, 454.558501},
        {"male_casualsuit05", 1, 0.1, 111.400267},
        {"male_casualsuit05", 1, 0.5, 134.000267},
        {"male_casualsuit05", 3, 1.0, 190.0008},
    };
    for (size_t k = 0; k < sizeof(cases) / sizeof(cases[0]); ++k) {
        pc_graph graph = {0};
        pc_labels labels = {0};
        pc_label_report report;
        read_graph(context, cases[k].name, &graph);
        const pc_label_options o = make_options(cases[k].smooth, 1, cases[k].bias, 100);
        assert_ok(context, pc_label(context, &graph, &o, &labels, &report));
        assert_close(report.objective, cases[k].optimum, 1e-6);
        assert_close(report.objective, definition(&graph, &o, labels.labels), 1e-9);
        assert_int_equal(report.outcome, PC_LABEL_OPTIMAL);
        assert_int_equal(report.unproven_components, 0);
        assert_true(report.roof_bound <= cases[k].optimum);
        pc_labels_free(context, &labels);
        pc_graph_free(context, &graph);
    }
    pc_context_destroy(context);
}

// Every budget gives labels and a bound that holds, and more budget no smaller bound here.
static void small_budgets_stay_valid(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_graph graph = {0};
    read_graph(context, "assistive_gym_hospitalgown", &graph);
    const uint32_t efforts[] = {0, 1, 2, 4};
    double last_bound = 0.0;
    for (size_t k = 0; k < sizeof(efforts) / sizeof(efforts[0]); ++k) {
        const pc_label_options o = make_options(3, 1, 1, efforts[k]);
        pc_labels labels = {0};
        pc_label_report report;
        assert_ok(context, pc_label(context, &graph, &o, &labels, &report));
        assert_true(report.objective >= 814.0 - 1e-9);
        assert_true(report.bound <= 814.0);
        assert_true(report.bound >= last_bound);
        last_bound = report.bound;
        if (k == 0) {
            assert_int_equal(report.outcome, PC_LABEL_FEASIBLE);
            assert_int_equal(report.unproven_components, 1);
            assert_true(report.bound == report.roof_bound);
        }
        pc_labels_free(context, &labels);
    }
    pc_graph_free(context, &graph);
    pc_context_destroy(context);
}

// A time limit ends the search with a bound that holds; one that is not reached changes nothing.
static void time_limits_stay_valid(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_graph graph = {0};
    read_graph(context, "assistive_gym_hospitalgown", &graph);
    for (int k = 0; k < 2; ++k) {
        pc_label_options o = make_options(3, 1, 1, 100);
        o.label_seconds = k == 0 ? 1e-9 : 3600.0;
        pc_labels labels = {0};
        pc_label_report report;
        assert_ok(context, pc_label(context, &graph, &o, &labels, &report));
        assert_true(report.objective >= 814.0 - 1e-9);
        assert_true(report.bound <= 814.0);
        assert_true(report.bound >= report.roof_bound);
        assert_int_equal(report.outcome, k == 0 ? PC_LABEL_FEASIBLE : PC_LABEL_OPTIMAL);
        pc_labels_free(context, &labels);
    }
    pc_graph_free(context, &graph);
    pc_context_destroy(context);
}

static void same_bytes_for_any_threads(void **state) {
    (void)state;
    const uint32_t threads[] = {1, 2, 3, 8};
    pc_labels first = {0};
    pc_label_report first_report;
    pc_context *context = test_context(1);
    pc_graph graph = {0};
    read_graph(context, "codim_multilayer_drape", &graph);
    assert_ok(context, pc_label(context, &graph, NULL, &first, &first_report));
    for (size_t k = 0; k < sizeof(threads) / sizeof(threads[0]); ++k) {
        pc_context *other = test_context(threads[k]);
        pc_labels labels = {0};
        pc_label_report report;
        assert_ok(other, pc_label(other, &graph, NULL, &labels, &report));
        assert_memory_equal(labels.labels, first.labels, graph.vertex_count);
        assert_true(report.objective == first_report.objective &&
                    report.bound == first_report.bound);
        pc_labels_free(other, &labels);
        pc_context_destroy(other);
    }
    pc_labels_free(context, &first);
    pc_graph_free(context, &graph);
    pc_context_destroy(context);
}

// ---- failures on the way ------------------------------------------------------------------------

static bool stop_at_once(void *user, const char *stage, double fraction) {
    (void)stage;
    size_t *calls = user;
    assert_true(fraction >= 0.0 && fraction <= 1.0);
    return ++*calls < 3;
}

// A torus with random wishes: too wide for elimination, so all methods take part.
static void make_torus(pc_context *context, pc_graph *graph) {
    enum { SIDE = 26, COUNT = SIDE * SIDE };
    graph->vertex_count = COUNT;
    graph->edges = PCI_ALLOCATE(context, uint32_t, 4 * COUNT);
    graph->edge_weights = PCI_ALLOCATE(context, double, 2 * COUNT);
    graph->opposites = PCI_ALLOCATE(context, uint32_t, 4 * COUNT);
    graph->opposite_signs = PCI_ALLOCATE(context, int8_t, 2 * COUNT);
    for (uint32_t v = 0; v < COUNT; ++v) {
        const uint32_t next[2] = {v / SIDE * SIDE + (v + 1) % SIDE, (v + SIDE) % COUNT};
        for (size_t k = 0; k < 2; ++k) {
            if (pci_random(9, k, v) < 0.2) {
                graph->opposites[2 * graph->opposite_count] = v;
                graph->opposites[2 * graph->opposite_count++ + 1] = next[k];
            } else {
                graph->edges[2 * graph->edge_count] = v;
                graph->edges[2 * graph->edge_count + 1] = next[k];
                graph->edge_weights[graph->edge_count++] = 0.5 + pci_random(10, k, v);
            }
        }
    }
}

static void survives_lack_of_memory(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    const pc_label_options o = make_options(1, 1, 0, 100);
    pc_graph graph = {0};
    make_torus(context, &graph);
    pc_label_report report;
    starvation s = {.counter = &counter, .growth = 6};
    while (starves(&s)) {
        pc_labels labels = {0};
        s.status = pc_label(context, &graph, &o, &labels, &report);
        assert_true(s.status == PC_OK || (labels.labels == NULL && labels.vertex_count == 0));
        pc_labels_free(context, &labels);
    }
    assert_true(s.failures > 10);
    assert_int_equal(report.outcome, PC_LABEL_OPTIMAL);
    pc_graph_free(context, &graph);
    pc_context_destroy(context);
    assert_int_equal(counter.live, 0);
}

static void can_be_cancelled(void **state) {
    (void)state;
    size_t calls = 0;
    const pc_context_options options = {.threads = 1, .progress = stop_at_once, .user = &calls};
    pc_context *context = NULL;
    assert_int_equal(pc_context_create(&options, &context), PC_OK);
    pc_graph graph = {0};
    make_torus(context, &graph);
    const pc_label_options o = make_options(1, 1, 0, 100);
    pc_labels labels = {0};
    assert_int_equal(pc_label(context, &graph, &o, &labels, NULL), PC_ERROR_CANCELLED);
    assert_null(labels.labels);
    assert_int_equal(calls, 3);
    pc_graph_free(context, &graph);
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(agrees_with_enumeration),
        cmocka_unit_test(elimination_is_exact),
        cmocka_unit_test(cycle_bound_holds),
        cmocka_unit_test(ground_cycles_fit),
        cmocka_unit_test(found_cycles_are_negative),
        cmocka_unit_test(contraction_keeps_costs),
        cmocka_unit_test(roof_labels_extend_to_an_optimum),
        cmocka_unit_test(flow_equals_cut),
        cmocka_unit_test(large_flow_equals_cut),
        cmocka_unit_test(trivial_graphs),
        cmocka_unit_test(keeps_the_outer_sheet),
        cmocka_unit_test(extreme_weights),
        cmocka_unit_test(bad_input_is_refused),
        cmocka_unit_test(garments_reach_proven_optima),
        cmocka_unit_test(small_budgets_stay_valid),
        cmocka_unit_test(time_limits_stay_valid),
        cmocka_unit_test(same_bytes_for_any_threads),
        cmocka_unit_test(survives_lack_of_memory),
        cmocka_unit_test(can_be_cancelled),
    };
    return cmocka_run_group_tests_name("label", tests, NULL, NULL);
}
