/*
 * What an engine does with a finished garment: reads the asset file, steps the simulation, and
 * deforms the visual mesh every frame into its vertex buffer.
 *
 *     importer ASSET.h5
 *
 * Checks on the way that the steps lead to the frames in the file, that the run-time deformation
 * is equation (6), and that pinned vertices can be moved by the engine.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <proxycloth/proxycloth.h>

enum { FLOATS = 8 }; /* of a vertex in the buffer: position, normal, two texture coordinates */

typedef struct garment {
    pc_context *context;
    pc_asset asset;
    pc_deformer *deformer;
    pc_simulator *simulator;
    size_t joints, vertices;
    float *proxy;  /* joints by 3 */
    float *buffer; /* vertices by FLOATS */
    void *pose;
} garment;

static int fail(const garment *g, const char *what) {
    fprintf(stderr, "importer: %s: %s\n", what, pc_context_error(g->context)->message);
    return 1;
}

/* Once per garment. */
static int load(garment *g, const char *path) {
    if (pc_asset_load(g->context, path, &g->asset) != PC_OK) {
        return fail(g, path);
    }
    const pc_simulate_inputs inputs = {.proxy = &g->asset.proxy,
                                       .scenario = &g->asset.scenario,
                                       .visual = &g->asset.visual,
                                       .character = &g->asset.character};
    if (pc_deform_prepare_asset(g->context, &g->asset, &g->deformer) != PC_OK ||
        pc_simulator_create(g->context, &inputs, &g->asset.options.simulate, &g->simulator) !=
            PC_OK) {
        return fail(g, "the garment cannot be prepared");
    }
    g->joints = g->asset.proxy.vertex_count;
    g->vertices = pc_deform_vertex_count(g->deformer);
    g->proxy = malloc(3 * g->joints * sizeof(float));
    g->buffer = calloc(FLOATS * g->vertices, sizeof(float));
    g->pose = malloc(pc_deform_pose_size(g->deformer));
    return g->proxy != NULL && g->buffer != NULL && g->pose != NULL ? 0 : fail(g, "no memory");
}

/* Every frame: nothing here allocates. */
static int advance(garment *g, const double *pins) {
    for (uint32_t i = 0; i < g->asset.options.simulate.frame_steps; ++i) {
        if (pc_simulator_step(g->simulator, NULL, pins) != PC_OK) {
            return fail(g, "step");
        }
    }
    const double *positions = pc_simulator_positions(g->simulator);
    for (size_t k = 0; k < 3 * g->joints; ++k) {
        g->proxy[k] = (float)positions[k];
    }
    const pc_deform_input input = {.joints = g->proxy};
    const pc_deform_output output = {.positions = g->buffer,
                                     .position_stride = FLOATS * sizeof(float),
                                     .normals = g->buffer + 3,
                                     .normal_stride = FLOATS * sizeof(float)};
    pc_deform_pose(g->deformer, &input, g->pose);
    pc_deform(g->deformer, g->pose, 0, g->vertices / 2, &output);           /* one job */
    pc_deform(g->deformer, g->pose, g->vertices / 2, g->vertices, &output); /* another one */
    return 0;
}

/* Largest difference between the buffer and equation (6) in double precision. */
static double difference(const garment *g) {
    const pc_visual *visual = &g->asset.visual;
    double *exact = malloc(3 * visual->surface.vertex_count * sizeof(*exact));
    if (exact == NULL) {
        return INFINITY;
    }
    pc_skin_deform(&g->asset.skin, visual->surface.positions, g->asset.proxy.positions,
                   pc_simulator_positions(g->simulator), NULL, exact);
    double largest = 0.0;
    for (size_t v = 0; v < g->vertices; ++v) {
        const double *wanted = &exact[3 * (size_t)visual->corner_vertices[v]];
        for (size_t k = 0; k < 3; ++k) {
            largest = fmax(largest, fabs((double)g->buffer[FLOATS * v + k] - wanted[k]));
        }
    }
    free(exact);
    return largest;
}

static int play(garment *g) {
    const pc_motion *motion = &g->asset.motion;
    const double size = g->asset.reports.visual.diagonal;
    double worst = 0.0;
    for (size_t frame = 0; frame < motion->frame_count; ++frame) {
        if (advance(g, NULL) != 0) {
            return 1;
        }
        if (memcmp(pc_simulator_positions(g->simulator), &motion->positions[3 * g->joints * frame],
                   3 * g->joints * sizeof(double)) != 0) {
            fprintf(stderr, "importer: frame %zu is not that of the file\n", frame);
            return 1;
        }
        worst = fmax(worst, difference(g) / size);
    }
    printf("%s: %zu frames, %zu vertices on %zu joints, difference %.1e of the diagonal\n",
           g->asset.name, motion->frame_count, g->vertices, g->joints, worst);
    /* The engine carries the pins away, and the garment follows. */
    double *pins = malloc(3 * g->joints * sizeof(*pins));
    int result = pins != NULL && worst < 1e-5 ? 0 : 1;
    for (int frame = 1; frame <= 60 && result == 0; ++frame) {
        for (size_t k = 0; k < 3 * g->joints; ++k) {
            pins[k] = g->asset.proxy.positions[k] + (k % 3 == 0 ? 0.02 * size * frame : 0.0);
        }
        result = advance(g, pins);
    }
    double mean = 0.0;
    for (size_t v = 0; v < g->vertices && result == 0; ++v) {
        const size_t rest = 3 * (size_t)g->asset.visual.corner_vertices[v];
        mean += (double)g->buffer[FLOATS * v] - g->asset.visual.surface.positions[rest];
    }
    free(pins);
    mean /= (double)g->vertices * size;
    printf("pins moved by 1.2 diagonals, the garment by %.2f\n", mean);
    return result == 0 && mean > 0.8 && mean < 1.6 ? 0 : 1;
}

int main(int argument_count, char **arguments) {
    garment g = {0};
    if (argument_count != 2 || pc_context_create(NULL, &g.context) != PC_OK) {
        fprintf(stderr, "usage: importer ASSET.h5, with headers of this library\n");
        return 2;
    }
    int result = load(&g, arguments[1]);
    if (result == 0) {
        result = play(&g);
    }
    free(g.proxy);
    free(g.buffer);
    free(g.pose);
    pc_simulator_destroy(g.simulator); /* reads the asset until here */
    pc_deform_destroy(g.context, g.deformer);
    pc_asset_free(g.context, &g.asset);
    pc_context_destroy(g.context);
    return result;
}
