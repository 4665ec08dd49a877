// Stage 7 on any mesh.
#include "soup.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    pc_context *context = fuzz_context();
    soup_bytes bytes = {data, size};
    pc_simplify_options options = pc_default_options().simplify;
    options.vertices = 4 + (uint32_t)soup_size(soup_byte(&bytes), 3, 12);
    options.narrow_refinement = 1.0 + 0.5 * (soup_byte(&bytes) % 4);
    options.clustering_iterations = 4;
    pc_mesh layer = soup_any(&bytes), proxy = {0};
    pc_simplify_report report;
    if (soup_succeeds(pc_simplify(context, NULL, &layer, &options, &proxy, &report))) {
        soup_check_mesh(&proxy);
        fuzz_assert(proxy.triangle_count > 0 && proxy.vertex_count == report.vertices);
        for (size_t t = 0; t < proxy.triangle_count; ++t) {
            const uint32_t *c = &proxy.triangles[3 * t];
            fuzz_assert(c[0] != c[1] && c[1] != c[2] && c[2] != c[0]);
        }
    }
    pc_mesh_free(context, &proxy);
    soup_free(&layer);
    return 0;
}
