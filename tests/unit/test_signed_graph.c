// Programs over signed graphs, as the labelling makes them: results are compared with enumeration.

#include "solvers/cycle_bound.h"
#include "solvers/cycle_search.h"
#include "solvers/elimination.h"
#include "solvers/roof_duality.h"
#include "support/test.h"

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

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(elimination_is_exact),
        cmocka_unit_test(cycle_bound_holds),
        cmocka_unit_test(ground_cycles_fit),
        cmocka_unit_test(found_cycles_are_negative),
        cmocka_unit_test(contraction_keeps_costs),
        cmocka_unit_test(roof_labels_extend_to_an_optimum),
    };
    return cmocka_run_group_tests_name("signed_graph", tests, NULL, NULL);
}
