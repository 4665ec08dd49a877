// Integer programs of the labelling, solved by another program: CBC (Debian: coinor-cbc).
#define _POSIX_C_SOURCE 200809L
#include <fcntl.h>
#include <string.h>
#include <sys/wait.h>

#include "support/files.h"
#include "support/memory.h"

enum { MAX_VERTICES = 256, MAX_EDGES = 1024 };

static char folder[64], program_path[64], solution_path[64];

static int make_folder(void **state) {
    (void)state;
    return test_make_folder(folder, program_path, "labels.lp", solution_path, "labels.sol");
}

static int remove_folder(void **state) {
    (void)state;
    return test_remove_folder(folder, program_path, solution_path);
}

// ---- instances ----------------------------------------------------------------------------------

typedef struct instance {
    pc_graph graph;
    uint32_t edges[2 * MAX_EDGES], opposites[2 * MAX_EDGES];
    double weights[MAX_EDGES];
    int8_t signs[MAX_EDGES];
} instance;

static void start(instance *g, size_t vertices) {
    memset(g, 0, sizeof(*g));
    g->graph = (pc_graph){.vertex_count = vertices,
                          .edges = g->edges,
                          .edge_weights = g->weights,
                          .opposites = g->opposites,
                          .opposite_signs = g->signs};
}

static void add_edge(instance *g, uint32_t a, uint32_t b, double weight) {
    const size_t e = g->graph.edge_count++;
    g->edges[2 * e] = a, g->edges[2 * e + 1] = b;
    g->weights[e] = weight;
}

static void add_opposite(instance *g, uint32_t a, uint32_t b, int sign) {
    const size_t e = g->graph.opposite_count++;
    g->opposites[2 * e] = a, g->opposites[2 * e + 1] = b;
    g->signs[e] = (int8_t)sign;
}

// Any pairs, parallel ones and vertices without pair included.
static void make_random(instance *g, uint64_t seed) {
    const uint32_t n = 2 + (uint32_t)(pci_random_bits(seed, 0, 0) % 24);
    start(g, n);
    for (uint32_t k = 0; k < 3 * n; ++k) {
        const uint32_t a = (uint32_t)(pci_random_bits(seed, 1, k) % n);
        const uint32_t b = (a + 1 + (uint32_t)(pci_random_bits(seed, 2, k) % (n - 1))) % n;
        if (k % 3 != 0) {
            add_edge(g, a, b, pci_random(seed, 3, k));
        } else {
            add_opposite(g, a, b, (int)(pci_random_bits(seed, 4, k) % 3) - 1);
        }
    }
}

// Two sheets around a tube; some of the opposite edges are wrong, so roof duality is not enough.
static void make_tube(instance *g, uint64_t seed, uint32_t around, uint32_t along) {
    const uint32_t sheet = around * along;
    start(g, 2 * (size_t)sheet);
    for (uint32_t v = 0; v < 2 * sheet; ++v) {
        const uint32_t ring = v / around;
        add_edge(g, v, ring * around + (v + 1) % around, 0.5 + 0.5 * pci_random(seed, 5, v));
        if (ring % along + 1 < along) {
            add_edge(g, v, v + around, 0.5 + 0.5 * pci_random(seed, 6, v));
        }
    }
    for (uint32_t v = 0; v < sheet; ++v) {
        const bool wrong = pci_random(seed, 7, v) < 0.25;
        const uint32_t mate = wrong ? (v + around / 2) % sheet : v + sheet;
        add_opposite(g, v, mate, (int)(pci_random_bits(seed, 8, v) % 4) - 1 > 0 ? 1 : 0);
    }
}

// ---- CBC ----------------------------------------------------------------------------------------

static void run_cbc(void) {
    const pid_t child = fork();
    assert_true(child >= 0);
    if (child == 0) {
        const int null = open("/dev/null", O_WRONLY);
        dup2(null, STDOUT_FILENO);
        execlp(CBC_PROGRAM, "cbc", program_path, "ratioGap", "0", "allowableGap", "0", "solve",
               "solu", solution_path, (char *)NULL);
        _exit(127);
    }
    int result = 0;
    assert_int_equal(waitpid(child, &result, 0), child);
    if (!WIFEXITED(result) || WEXITSTATUS(result) == 127) {
        fail_msg("cbc (%s) cannot be run: install the package coinor-cbc", CBC_PROGRAM);
    }
    assert_int_equal(WEXITSTATUS(result), 0);
}

// CBC's objective; the labels of its solution (variables that are not listed are 0).
static double read_solution(size_t vertex_count, uint8_t *labels) {
    FILE *file = fopen(solution_path, "r");
    char line[256], name[64];
    double objective = 0.0, value = 0.0;
    assert_non_null(file);
    memset(labels, 0, vertex_count);
    assert_non_null(fgets(line, sizeof(line), file));
    if (sscanf(line, "Optimal - objective value %lf", &objective) != 1) {
        fail_msg("cbc: %s", line);
    }
    while (fgets(line, sizeof(line), file) != NULL) {
        assert_int_equal(sscanf(line, "%*d %63s %lf", name, &value), 2);
        if (name[0] == 'l') {
            const size_t v = strtoul(name + 1, NULL, 10);
            assert_true(v < vertex_count);
            labels[v] = value > 0.5;
        }
    }
    fclose(file);
    return objective;
}

static void compare(pc_context *context, const instance *g, const pc_label_options *o) {
    uint8_t theirs[MAX_VERTICES];
    pc_labels ours = {0};
    pc_label_report report;
    assert_ok(context, pc_label_write_lp(context, &g->graph, o, program_path));
    run_cbc();
    const double optimum = read_solution(g->graph.vertex_count, theirs);
    assert_ok(context, pc_label(context, &g->graph, o, &ours, &report));
    assert_int_equal(report.outcome, PC_LABEL_OPTIMAL);
    const double tolerance = 1e-6 * fmax(1.0, optimum);
    assert_close(report.objective, optimum, tolerance);
    assert_close(pc_label_objective(&g->graph, o, theirs), optimum, tolerance);
    pc_labels_free(context, &ours);
}

static pc_label_options make_options(double smooth, double opposite, double bias) {
    return (pc_label_options){.lambda_smooth = smooth,
                              .lambda_opposite = opposite,
                              .lambda_bias = bias,
                              .label_effort = 100};
}

static void cbc_agrees_on_random_graphs(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    const pc_label_options options[] = {make_options(2, 1, 1), make_options(1, 1, 0.1),
                                        make_options(0.5, 1, 0), make_options(1e-7, 3, 0.3),
                                        make_options(0, 1, 0.5)};
    for (uint64_t seed = 0; seed < 20; ++seed) {
        instance g;
        make_random(&g, seed);
        compare(context, &g, &options[seed % 5]);
    }
    pc_context_destroy(context);
}

static void cbc_agrees_on_tubes(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    for (uint64_t seed = 0; seed < 3; ++seed) {
        const pc_label_options o = make_options(1, 1, seed % 2 == 0 ? 1.0 : 0.25);
        instance g;
        make_tube(&g, seed, 8, 4 + (uint32_t)seed);
        compare(context, &g, &o);
    }
    pc_context_destroy(context);
}

// ---- the file -----------------------------------------------------------------------------------

static void program_is_that_of_the_paper(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    instance g;
    start(&g, 4); // vertex 3 has no pair
    add_edge(&g, 0, 1, 0.25);
    add_opposite(&g, 1, 2, -1);
    const pc_label_options o = make_options(2, 1, 0.5);
    assert_ok(context, pc_label_write_lp(context, &g.graph, &o, program_path));
    bytes file = read_bytes(program_path);
    assert_string_equal(
        (const char *)file.data,
        "\\ Labelling of a guide graph: 4 vertices, 1 mesh edges, 1 opposite edges\n"
        "Minimize\n energy:\n"
        " + 0.5 s0_01 + 0.5 s0_10 + 1.5 o0_00 + 0.5 o0_10 + 1.5 o0_11\n + 0 l3\n"
        "Subject To\n"
        " s0_a0: s0_00 + s0_01 + l0 = 1\n s0_a1: s0_10 + s0_11 - l0 = 0\n"
        " s0_b0: s0_00 + s0_10 + l1 = 1\n s0_b1: s0_01 + s0_11 - l1 = 0\n"
        " o0_a0: o0_00 + o0_01 + l1 = 1\n o0_a1: o0_10 + o0_11 - l1 = 0\n"
        " o0_b0: o0_00 + o0_10 + l2 = 1\n o0_b1: o0_01 + o0_11 - l2 = 0\n"
        "Binaries\n l0 l1 l2 l3\nEnd\n");
    free(file.data);
    pc_context_destroy(context);
}

// On failure the file stays what it was, and nothing lies beside it (see remove_folder).
static void failures_leave_no_file(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    instance g;
    make_random(&g, 1);
    write_bytes(program_path, "old", 3);
    const pc_label_options bad = make_options(-1, 1, 1);
    assert_int_equal(pc_label_write_lp(NULL, &g.graph, NULL, program_path),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_label_write_lp(context, NULL, NULL, program_path),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_label_write_lp(context, &g.graph, NULL, NULL), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_label_write_lp(context, &g.graph, &bad, program_path),
                     PC_ERROR_INVALID_OPTIONS);
    assert_int_equal(pc_label_write_lp(context, &g.graph, NULL, "/dev/full"), PC_ERROR_IO);
    assert_int_equal(pc_label_write_lp(context, &g.graph, NULL, folder), PC_ERROR_IO);
    for (size_t call = 1; call <= 2; ++call) {
        fail_allocation(&counter, call);
        assert_int_equal(pc_label_write_lp(context, &g.graph, NULL, program_path),
                         PC_ERROR_OUT_OF_MEMORY);
    }
    fail_allocation(&counter, 0);
    g.edges[0] = 1000;
    assert_int_equal(pc_label_write_lp(context, &g.graph, NULL, program_path),
                     PC_ERROR_INVALID_ARGUMENT);
    bytes file = read_bytes(program_path);
    assert_string_equal((const char *)file.data, "old");
    free(file.data);
    pc_context_destroy(context);
    assert_int_equal(counter.live, 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(program_is_that_of_the_paper),
        cmocka_unit_test(failures_leave_no_file),
        cmocka_unit_test(cbc_agrees_on_random_graphs),
        cmocka_unit_test(cbc_agrees_on_tubes),
    };
    return cmocka_run_group_tests_name("label_lp", tests, make_folder, remove_folder);
}
