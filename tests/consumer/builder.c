/* An importer in small: a curtain from plain arrays, built, stepped and deformed. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include <proxycloth/proxycloth.h>

enum { SIDE = 24 };

/* What an engine does: prepares once, then poses the vertex buffer every frame. */
static int play(pc_context *context, const pc_asset *asset) {
    enum { FLOATS = 8 }; /* of a vertex: position, normal, two texture coordinates */
    pc_deformer *deformer = NULL;
    if (pc_deform_prepare_asset(context, asset, &deformer) != PC_OK) {
        return 1;
    }
    const size_t joints = asset->proxy.vertex_count, vertices = pc_deform_vertex_count(deformer);
    float *proxy = malloc(3 * joints * sizeof(*proxy));
    float *buffer = malloc(FLOATS * vertices * sizeof(*buffer));
    void *pose = malloc(pc_deform_pose_size(deformer));
    double length = 0.0, extent = 0.0;
    if (proxy != NULL && buffer != NULL && pose != NULL) {
        const pc_deform_input input = {.joints = proxy};
        const pc_deform_output output = {.positions = buffer,
                                         .position_stride = FLOATS * sizeof(float),
                                         .normals = buffer + 3,
                                         .normal_stride = FLOATS * sizeof(float)};
        for (size_t frame = 0; frame < asset->motion.frame_count; ++frame) {
            for (size_t i = 0; i < 3 * joints; ++i) {
                proxy[i] = (float)asset->motion.positions[3 * frame * joints + i];
            }
            pc_deform_pose(deformer, &input, pose);
            pc_deform(deformer, pose, 0, vertices / 2, &output);
            pc_deform(deformer, pose, vertices / 2, vertices, &output);
        }
        length =
            sqrt((double)(buffer[3] * buffer[3] + buffer[4] * buffer[4] + buffer[5] * buffer[5]));
        for (size_t v = 0; v < vertices; ++v) {
            extent = fmax(extent, fabs((double)buffer[FLOATS * v]));
        }
    }
    free(proxy);
    free(buffer);
    free(pose);
    pc_deform_destroy(context, deformer);
    return fabs(length - 1.0) < 1e-5 && extent > 0.5 && extent < 10.0 ? 0 : 1;
}

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
                               &asset.motion.positions[3 * frame * asset.motion.vertex_count], NULL,
                               posed);
            }
            printf("%s: %zu proxy vertices, %zu frames\n", pc_version(), asset.proxy.vertex_count,
                   asset.motion.frame_count);
            result = asset.proxy.vertex_count > 0 && isfinite(posed[0]) ? 0 : 1;
            free(posed);
        }
        result |= play(context, &asset);
    } else {
        fprintf(stderr, "%s\n", pc_context_error(context)->message);
    }
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
    return result;
}
