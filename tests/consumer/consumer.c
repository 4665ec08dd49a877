/* An importer in small: a curtain from plain arrays, built, stepped and deformed. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include <proxycloth/proxycloth.h>

enum { SIDE = 24 };

int main(void) {
    static double positions[3 * SIDE * SIDE];
    static uint32_t triangles[6 * (SIDE - 1) * (SIDE - 1)];
    size_t corner = 0;
    for (uint32_t y = 0; y < SIDE; ++y) {
        for (uint32_t x = 0; x < SIDE; ++x) {
            double *p = &positions[3 * (y * SIDE + x)];
            p[0] = (double)x / (SIDE - 1);
            p[1] = (double)y / (SIDE - 1);
            p[2] = 0.1 * sin(6.0 * p[0]);
            if (x + 1 < SIDE && y + 1 < SIDE) {
                const uint32_t a = y * SIDE + x, b = a + 1, c = a + SIDE, d = c + 1;
                const uint32_t quad[6] = {a, b, d, a, d, c};
                for (int k = 0; k < 6; ++k) {
                    triangles[corner++] = quad[k];
                }
            }
        }
    }
    const pc_visual_arrays arrays = {.vertex_count = SIDE * SIDE,
                                     .positions = positions,
                                     .triangle_count = corner / 3,
                                     .triangles = triangles};
    pc_context *context = NULL;
    if (pc_context_create(NULL, &context) != PC_OK) {
        return 1;
    }
    pc_asset asset = {0};
    pc_options options = pc_default_options();
    options.simplify.vertices = 32;
    options.simulate.frames = 20;
    options.skin.epochs = 10;
    int result = 1;
    if (pc_visual_create(context, &arrays, &asset.visual, &asset.reports.visual) == PC_OK &&
        pc_build(context, &options, &asset, NULL) == PC_OK) {
        const pc_mesh *surface = &asset.visual.surface;
        double *posed = malloc(3 * surface->vertex_count * sizeof(*posed));
        if (posed != NULL) {
            for (size_t frame = 0; frame < asset.motion.frame_count; ++frame) {
                pc_skin_deform(&asset.skin, surface->positions, asset.proxy.positions,
                               &asset.motion.positions[3 * frame * asset.motion.vertex_count],
                               posed);
            }
            printf("%s: %zu proxy vertices, %zu frames\n", pc_version(), asset.proxy.vertex_count,
                   asset.motion.frame_count);
            result = asset.proxy.vertex_count > 0 && isfinite(posed[0]) ? 0 : 1;
            free(posed);
        }
    } else {
        fprintf(stderr, "%s\n", pc_context_error(context)->message);
    }
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
    return result;
}
