// Stage 4 on any mesh.
#include "soup.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    pc_context *context = fuzz_context();
    soup_bytes bytes = {data, size};
    pc_graph_options options = pc_default_options().graph;
    options.tube_aspect = soup_byte(&bytes) % 4;
    const double cell_size = 0.25 * soup_number(&bytes);
    pc_mesh projected = soup_any(&bytes);
    pc_graph graph = {0};
    if (soup_succeeds(pc_build_graph(context, &projected, cell_size, &options, &graph, NULL))) {
        fuzz_assert(graph.vertex_count == projected.vertex_count);
        for (size_t i = 0; i < graph.edge_count; ++i) {
            const uint32_t *edge = &graph.edges[2 * i];
            fuzz_assert(edge[0] < edge[1] && edge[1] < graph.vertex_count);
            fuzz_assert(graph.edge_weights[i] >= 0.0 && graph.edge_weights[i] <= 1.0);
        }
        for (size_t i = 0; i < graph.opposite_count; ++i) {
            const uint32_t *pair = &graph.opposites[2 * i];
            fuzz_assert(pair[0] < pair[1] && pair[1] < graph.vertex_count);
            fuzz_assert(abs(graph.opposite_signs[i]) <= 1);
        }
    }
    pc_graph_free(context, &graph);
    soup_free(&projected);
    return 0;
}
