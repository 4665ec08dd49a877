// Labelling: every claim (objective, bound, optimality) is checked against enumeration.
#include <float.h>
#include <stdio.h>

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

// Tori with random wishes: too wide for elimination, so all methods take part.
static void make_tori(pc_context *context, uint32_t tori, pc_graph *graph) {
    enum { SIDE = 26, COUNT = SIDE * SIDE };
    const size_t count = (size_t)tori * COUNT;
    graph->vertex_count = count;
    graph->edges = PCI_ALLOCATE(context, uint32_t, 4 * count);
    graph->edge_weights = PCI_ALLOCATE(context, double, 2 * count);
    graph->opposites = PCI_ALLOCATE(context, uint32_t, 4 * count);
    graph->opposite_signs = PCI_ALLOCATE(context, int8_t, 2 * count);
    for (uint32_t v = 0; v < count; ++v) {
        const uint32_t first = v / COUNT * COUNT;
        const uint32_t next[2] = {v / SIDE * SIDE + (v + 1) % SIDE,
                                  first + (v - first + SIDE) % COUNT};
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

// @param effort  also too little for a proof
static void check_threads(pc_context *context, const pc_graph *graph, uint32_t effort) {
    const uint32_t threads[] = {2, 3, 8};
    const pc_label_options o = make_options(1, 1, 0, effort);
    pc_labels first = {0};
    pc_label_report first_report;
    assert_ok(context, pc_label(context, graph, &o, &first, &first_report));
    for (size_t k = 0; k < sizeof(threads) / sizeof(threads[0]); ++k) {
        pc_context *other = test_context(threads[k]);
        pc_labels labels = {0};
        pc_label_report report;
        assert_ok(other, pc_label(other, graph, &o, &labels, &report));
        assert_memory_equal(labels.labels, first.labels, graph->vertex_count);
        assert_true(report.objective == first_report.objective &&
                    report.bound == first_report.bound);
        pc_labels_free(other, &labels);
        pc_context_destroy(other);
    }
    pc_labels_free(context, &first);
}

static void same_bytes_for_any_threads(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_graph graph = {0}, tori = {0};
    read_graph(context, "codim_multilayer_drape", &graph);
    make_tori(context, 5, &tori); // side by side
    check_threads(context, &graph, 100);
    check_threads(context, &tori, 100);
    check_threads(context, &tori, 1);
    pc_graph_free(context, &graph);
    pc_graph_free(context, &tori);
    pc_context_destroy(context);
}

// ---- failures on the way ------------------------------------------------------------------------

static bool stop_at_once(void *user, const char *stage, double fraction) {
    (void)stage;
    size_t *calls = user;
    assert_true(fraction >= 0.0 && fraction <= 1.0);
    return ++*calls < 3;
}

static void survives_lack_of_memory(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    const pc_label_options o = make_options(1, 1, 0, 100);
    pc_graph graph = {0};
    make_tori(context, 1, &graph);
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
    make_tori(context, 1, &graph);
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
