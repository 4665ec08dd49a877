// Every stage on small soups. The first bytes choose options, then three bytes make a vertex, then
// three bytes a triangle. Coordinates are small whole numbers, so that soups are full of coplanar,
// repeated and touching triangles; the top values stand for extreme numbers.
#include <math.h>
#include <string.h>

#include "soup.h"

enum { MAXIMUM_VERTICES = 24, MAXIMUM_TRIANGLES = 40 };

static double coordinate(uint8_t byte, double scale) {
    static const double extremes[] = {1e30, -1e30, 1e-30, 4e-324, 1e300, (double)NAN, 1e15, 1e-9};
    return byte >= 248 ? extremes[byte - 248] : scale * (double)(byte % 16);
}

static void check(pc_context *context, const pc_asset *asset) {
    fuzz_assert(asset->stage_count == PC_STAGE_COUNT && asset->proxy.triangle_count > 0);
    for (size_t i = 0; i < 3 * asset->proxy.triangle_count; ++i) {
        fuzz_assert(asset->proxy.triangles[i] < asset->proxy.vertex_count);
    }
    for (size_t i = 0; i < 3 * asset->motion.frame_count * asset->motion.vertex_count; ++i) {
        fuzz_assert(isfinite(asset->motion.positions[i]));
    }
    for (size_t v = 0; v < asset->skin.vertex_count; ++v) {
        double sum = 0.0;
        for (size_t k = 0; k < asset->skin.influences; ++k) {
            const size_t at = v * asset->skin.influences + k;
            fuzz_assert(asset->skin.bones[at] < asset->proxy.vertex_count &&
                        asset->skin.weights[at] >= 0.0);
            sum += asset->skin.weights[at];
        }
        fuzz_assert(fabs(sum - 1.0) < 1e-9);
    }
    pc_measures measures;
    if (pc_evaluate(context, &asset->visual.surface, &asset->proxy, &measures) != PC_OK) {
        fprintf(stderr, "%s\n", pc_context_error(context)->message);
        abort();
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    if (size < 4 + 9 + 3) {
        return 0;
    }
    pc_options options = pc_default_options();
    options.voxelize.voxels = 4 + (uint32_t)soup_size(data[0], 2, 8);
    options.carve.layer_source = data[1] % 3;
    options.carve.carve = data[1] / 3 % 2 != 0;
    options.simplify.vertices = 4 + (uint32_t)soup_size(data[2], 3, 16);
    options.project.projection_iterations = 2;
    options.label.label_effort = data[1] / 8 % 4;
    options.simplify.clustering_iterations = 4;
    options.simulate.frames = 2;
    options.skin.epochs = options.skin.rounds = 1;
    options.skin.solver = data[3] % 2;
    const double scale = pow(10.0, (double)(data[3] / 2 % 8) - 4.0);
    const size_t vertices = 3 + data[3] / 16 % (MAXIMUM_VERTICES - 2);
    double positions[3 * MAXIMUM_VERTICES];
    uint32_t triangles[3 * MAXIMUM_TRIANGLES];
    size_t at = 4, triangle_count = 0;
    for (size_t i = 0; i < 3 * vertices; ++i) {
        positions[i] = at < size ? coordinate(data[at], scale) : 0.0;
        ++at;
    }
    for (; at + 3 <= size && triangle_count < MAXIMUM_TRIANGLES; at += 3) {
        for (size_t k = 0; k < 3; ++k) {
            const uint8_t byte = data[at + k];
            triangles[3 * triangle_count + k] =
                byte == 255 ? UINT32_MAX : (uint32_t)(byte % vertices);
        }
        ++triangle_count;
    }
    pc_context *context = fuzz_context();
    pc_asset asset;
    memset(&asset, 0, sizeof(asset));
    const pc_visual_arrays arrays = {.vertex_count = vertices,
                                     .positions = positions,
                                     .triangle_count = triangle_count,
                                     .triangles = triangles};
    if (pc_visual_create(context, &arrays, &asset.visual, &asset.reports.visual) == PC_OK) {
        const pc_status status = pc_build(context, &options, &asset, NULL);
        fuzz_assert(status != PC_ERROR_INTERNAL && status != PC_ERROR_INVALID_ARGUMENT &&
                    status != PC_ERROR_INVALID_OPTIONS);
        if (status == PC_OK) {
            check(context, &asset);
        }
    }
    pc_asset_free(context, &asset);
    return 0;
}
