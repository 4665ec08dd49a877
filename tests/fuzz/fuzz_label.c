// Stage 5 on any graph: the labels are worth what the report says, and no less than its bound.
#include "soup.h"

enum { LABEL_VERTICES = 24 };

// Two bytes per edge; the ends may be equal or out of range.
static uint32_t *read_pairs(soup_bytes *bytes, size_t count, size_t vertices) {
    uint32_t *pairs = soup_allocate(2 * count * sizeof(uint32_t));
    for (size_t i = 0; i < 2 * count; ++i) {
        const uint8_t byte = soup_byte(bytes);
        pairs[i] = byte == 255 ? UINT32_MAX : (uint32_t)(byte % vertices);
    }
    return pairs;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    pc_context *context = fuzz_context();
    soup_bytes bytes = {data, size};
    pc_label_options options = pc_default_options().label;
    options.label_effort = soup_byte(&bytes) % 3;
    options.lambda_bias = 0.25 * (soup_byte(&bytes) % 8);
    pc_graph graph = {.vertex_count = 1 + soup_byte(&bytes) % LABEL_VERTICES};
    graph.edge_count = soup_byte(&bytes) % 64;
    graph.opposite_count = soup_byte(&bytes) % 64;
    graph.edges = read_pairs(&bytes, graph.edge_count, graph.vertex_count);
    graph.opposites = read_pairs(&bytes, graph.opposite_count, graph.vertex_count);
    graph.edge_weights = soup_allocate(graph.edge_count * sizeof(double));
    graph.opposite_signs = soup_allocate(graph.opposite_count);
    for (size_t i = 0; i < graph.edge_count; ++i) {
        graph.edge_weights[i] = soup_number(&bytes) / 15.0;
    }
    for (size_t i = 0; i < graph.opposite_count; ++i) {
        const uint8_t byte = soup_byte(&bytes);
        graph.opposite_signs[i] = (int8_t)(byte == 255 ? 2 : byte % 3 - 1);
    }
    pc_labels labels = {0};
    pc_label_report report;
    if (soup_succeeds(pc_label(context, &graph, &options, &labels, &report))) {
        const double value = pc_label_objective(&graph, &options, labels.labels);
        const double tolerance = 1e-6 * fmax(1.0, fabs(value));
        fuzz_assert(fabs(value - report.objective) <= tolerance);
        fuzz_assert(report.bound <= value + tolerance);
    }
    pc_labels_free(context, &labels);
    free(graph.edges);
    free(graph.opposites);
    free(graph.edge_weights);
    free(graph.opposite_signs);
    return 0;
}
