#include "core/core.h"
#include "io/atomic_file.h"
#include "io/json.h"
#include "stages/label_check.h"

static const char stage[] = "label";
enum { TERMS_PER_LINE = 5 }; // readers limit the length of a line

// One pair of equation (4): labels (x, y) of its vertices cost costs[2 x + y].
typedef struct pair_term {
    char kind; // 's' for a mesh edge, 'o' for an opposite edge; with `index` the variables' name
    size_t index;
    uint32_t vertices[2];
    double costs[4];
} pair_term;

static pair_term smooth_term(const pc_graph *graph, const pc_label_options *o, size_t e) {
    const double cost = o->lambda_smooth * graph->edge_weights[e];
    return (pair_term){.kind = 's',
                       .index = e,
                       .vertices = {graph->edges[2 * e], graph->edges[2 * e + 1]},
                       .costs = {0.0, cost, cost, 0.0}};
}

static pair_term opposite_term(const pc_graph *graph, const pc_label_options *o, size_t e) {
    pair_term term = {.kind = 'o',
                      .index = e,
                      .vertices = {graph->opposites[2 * e], graph->opposites[2 * e + 1]}};
    const int sign = graph->opposite_signs[e];
    for (int k = 0; k < 4; ++k) {
        const int difference = k / 2 - k % 2;
        term.costs[k] =
            o->lambda_opposite * ((difference == 0 ? 1.0 : 0.0) +
                                  (sign != 0 && difference != sign ? o->lambda_bias : 0.0));
    }
    return term;
}

static pair_term get_term(const pc_graph *graph, const pc_label_options *o, size_t k) {
    return k < graph->edge_count ? smooth_term(graph, o, k)
                                 : opposite_term(graph, o, k - graph->edge_count);
}

static void write_separator(FILE *file, size_t *terms) {
    fputs((*terms)++ % TERMS_PER_LINE == 0 ? "\n " : " ", file);
}

// Equation (2), written out by (4). Vertices without pairs appear with 0, so that they exist.
static void write_objective(FILE *file, const pc_graph *graph, const pc_label_options *o,
                            uint8_t *used) {
    size_t terms = 0;
    fputs("Minimize\n energy:", file);
    for (size_t k = 0; k < graph->edge_count + graph->opposite_count; ++k) {
        const pair_term term = get_term(graph, o, k);
        used[term.vertices[0]] = used[term.vertices[1]] = 1;
        for (int i = 0; i < 4; ++i) {
            if (term.costs[i] > 0.0) {
                char number[40];
                pci_number_text(term.costs[i], number);
                write_separator(file, &terms);
                fprintf(file, "+ %s %c%zu_%d%d", number, term.kind, term.index, i / 2, i % 2);
            }
        }
    }
    for (size_t v = 0; v < graph->vertex_count; ++v) {
        if (!used[v] || (v == 0 && terms == 0)) {
            write_separator(file, &terms);
            fprintf(file, "+ 0 l%zu", v);
        }
    }
}

// Equation (5).
static void write_constraints(FILE *file, const pc_graph *graph, const pc_label_options *o) {
    fputs("\nSubject To\n", file);
    for (size_t k = 0; k < graph->edge_count + graph->opposite_count; ++k) {
        const pair_term term = get_term(graph, o, k);
        const char c = term.kind;
        const size_t i = term.index;
        const unsigned a = term.vertices[0], b = term.vertices[1];
        fprintf(file, " %c%zu_a0: %c%zu_00 + %c%zu_01 + l%u = 1\n", c, i, c, i, c, i, a);
        fprintf(file, " %c%zu_a1: %c%zu_10 + %c%zu_11 - l%u = 0\n", c, i, c, i, c, i, a);
        fprintf(file, " %c%zu_b0: %c%zu_00 + %c%zu_10 + l%u = 1\n", c, i, c, i, c, i, b);
        fprintf(file, " %c%zu_b1: %c%zu_01 + %c%zu_11 - l%u = 0\n", c, i, c, i, c, i, b);
    }
}

pc_status pc_label_write_lp(pc_context *context, const pc_graph *graph,
                            const pc_label_options *options, const char *path) {
    if (context == NULL) {
        return PC_ERROR_INVALID_ARGUMENT;
    }
    if (graph == NULL || path == NULL) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage, "label: graph or path is NULL");
    }
    pc_label_options chosen;
    pc_status status = pci_begin_stage(context, stage, &pc_label_options_record, options, &chosen);
    if (status == PC_OK) {
        status = pci_label_check(context, graph);
    }
    if (status != PC_OK) {
        return status;
    }
    pci_scratch scratch = pci_scratch_begin(context);
    pci_atomic_file file = {0};
    uint8_t *used = PCI_SCRATCH(&scratch, uint8_t, graph->vertex_count);
    status = used != NULL ? pci_atomic_begin(context, stage, path, &file)
                          : pci_fail_memory(context, stage);
    if (status == PC_OK) {
        fprintf(file.stream,
                "\\ Labelling of a guide graph: %zu vertices, %zu mesh edges, %zu "
                "opposite edges\n",
                graph->vertex_count, graph->edge_count, graph->opposite_count);
        write_objective(file.stream, graph, &chosen, used);
        write_constraints(file.stream, graph, &chosen);
        fputs("Binaries", file.stream);
        size_t terms = 0;
        for (size_t v = 0; v < graph->vertex_count; ++v) {
            write_separator(file.stream, &terms);
            fprintf(file.stream, "l%zu", v);
        }
        fputs("\nEnd\n", file.stream);
        status = pci_atomic_end(&file, PC_OK);
    }
    pci_scratch_end(&scratch);
    return status;
}
