// evaluate --motion: skinning weights on a wind that they have not seen, next to weights without
// optimisation.
#include "cli.h"

#include <stdio.h>
#include <string.h>

#include "print.h"

enum { BASELINE_INFLUENCES = 8, MAXIMUM_ROWS = 6 };

typedef struct weights_row {
    const char *name;
    bool seen; // on the motion of the asset, which its weights were made for
    uint32_t influences;
    pc_motion_measures measures;
} weights_row;

typedef struct comparison {
    const cli_command *command;
    const cli_arguments *arguments;
    pc_context *context;
    pc_asset asset;
    pc_motion motion;
    weights_row rows[MAXIMUM_ROWS];
    size_t count;
} comparison;

// What the asset went through in random winds of another seed, or --scenario with its winds.
static int simulate(comparison *c) {
    const pc_asset *asset = &c->asset;
    const char *file = c->arguments->scenario;
    const bool simulated = asset->stage_count > PC_STAGE_SIMULATE;
    const uint32_t seed = c->arguments->motion.wind_seed;
    pc_simulate_options options =
        simulated ? asset->options.simulate : c->arguments->options.simulate;
    pc_scenario scenario = {0}, *own = file != NULL ? &scenario : NULL;
    pc_status status = PC_OK;
    if (own != NULL) {
        status = pc_scenario_read(c->context, file, &options, own);
    } else {
        scenario = asset->scenario; // borrowed
        scenario.wind_count = 0;
        scenario.winds = NULL;
    }
    if (simulated && own == NULL && asset->scenario.wind_count == 0 && options.seed == seed) {
        cli_warn(c->command->name,
                 "the weights were made in the wind of seed %u; choose another with --wind-seed",
                 (unsigned)seed);
    }
    options.seed = seed;
    if (status == PC_OK) {
        const pc_simulate_inputs inputs = {&asset->proxy, &scenario, &asset->visual,
                                           &asset->character};
        status = pc_simulate_scenario(c->context, &inputs, &options, &c->motion, NULL);
    }
    pc_scenario_free(c->context, own);
    return status == PC_OK ? CLI_OK
                           : cli_fail_status(c->command->name, c->context, status,
                                             file != NULL ? file : c->arguments->inputs[0], false);
}

static int measure(comparison *c, const char *name, bool seen, const pc_skin *skin) {
    weights_row *row = &c->rows[c->count++];
    row->name = name;
    row->seen = seen;
    row->influences = skin->influences;
    const pc_status status = pc_evaluate_motion(
        c->context, &c->asset.visual.surface, &c->asset.proxy, seen ? &c->asset.motion : &c->motion,
        skin, &c->arguments->motion, &row->measures);
    return status == PC_OK ? CLI_OK
                           : cli_fail_status(c->command->name, c->context, status, c->arguments->inputs[0], false);
}

typedef enum weights_source { FROM_GLB, INVERSE_DISTANCE, CLOSEST, SMOOTHED } weights_source;

static pc_status make_weights(const comparison *c, weights_source source, pc_skin *skin) {
    const pc_mesh *surface = &c->asset.visual.surface, *proxy = &c->asset.proxy;
    switch (source) {
    case FROM_GLB:
        return pc_skin_read_glb(c->context, c->arguments->inputs[1], surface, proxy, skin);
    case INVERSE_DISTANCE:
        return pc_skin_inverse_distance(c->context, surface, proxy, BASELINE_INFLUENCES, skin);
    case CLOSEST:
        return pc_skin_closest_triangle(c->context, surface, proxy, skin);
    case SMOOTHED:
        return pc_skin_heat_smoothed(c->context, surface, proxy, BASELINE_INFLUENCES, skin);
    }
    return PC_ERROR_INTERNAL;
}

// All weights are compared with the skinning of the asset's, or the one asked for.
static uint32_t skinning_of(const comparison *c) {
    return c->asset.stage_count > PC_STAGE_SKIN ? c->asset.skin.skinning
                                                : c->arguments->options.skin.skinning;
}

static int compare(comparison *c) {
    static const char *const names[] = {NULL, "inverse distance", "closest triangle",
                                        "heat-smoothed triangle"};
    int code = CLI_OK;
    if (c->asset.stage_count > PC_STAGE_SKIN) {
        code = measure(c, "asset", false, &c->asset.skin);
        if (code == CLI_OK) {
            code = measure(c, "asset", true, &c->asset.skin);
        }
    }
    for (weights_source source = FROM_GLB; source <= SMOOTHED && code == CLI_OK; ++source) {
        if (source == FROM_GLB && c->arguments->input_count < 2) {
            continue;
        }
        pc_skin skin = {0};
        const pc_status status = make_weights(c, source, &skin);
        skin.skinning = skinning_of(c);
        code = status == PC_OK
                   ? measure(c, source == FROM_GLB ? c->arguments->inputs[1] : names[source], false,
                             &skin)
                   : cli_fail_status(c->command->name, c->context, status, c->arguments->inputs[0], false);
        pc_skin_free(c->context, &skin);
    }
    return code;
}

static const char *skinning_name(const comparison *c) {
    return skinning_of(c) == PC_SKINNING_ROTATION ? "translation and rotation" : "translation only";
}

static void print_table(const comparison *c) {
    printf("# wind %u, %zu frames, %s\n", (unsigned)c->arguments->motion.wind_seed,
           c->motion.frame_count, skinning_name(c));
    printf("%-24s %3s %9s %9s %8s %8s %8s %9s %8s %8s %7s\n", "weights", "K", "L_r", "L_c",
           "strain", "p95", "folded", "new self-", "pinned", "worst", "motion");
    printf("%-24s %3s %9s %9s %8s %8s %8s %9s %8s %8s %7s\n", "", "", "", "", "", "", "%",
           "crossings", "% of D", "% of D", "ratio");
    for (size_t i = 0; i < c->count; ++i) {
        const weights_row *row = &c->rows[i];
        const pc_motion_measures *m = &row->measures;
        const char *slash = strrchr(row->name, '/');
        char name[256];
        cli_clean_text(name, sizeof(name),
                       row->seen       ? "on its own motion"
                       : slash != NULL ? slash + 1
                                       : row->name);
        printf("%-24.24s %3u %9.5f %9.5f %8.4f %8.4f %8.3f %9.1f %8.4f %8.4f %7.4f\n", name,
               (unsigned)row->influences, m->rigid, m->collision, m->strain_mean, m->strain_p95,
               100.0 * m->folded_triangles, m->new_intersections, 100.0 * m->pinned_drift,
               100.0 * m->pinned_drift_worst, m->motion_ratio);
    }
    if (c->count > 0 && c->rows[0].measures.proxy_intersections > 0.0) {
        printf("# the proxy itself gets %.1f new self-crossings per frame\n",
               c->rows[0].measures.proxy_intersections);
    }
}

static int print_result(const comparison *c) {
    if (!c->arguments->settings.json) {
        print_table(c);
        return CLI_OK;
    }
    cJSON *root = cJSON_CreateObject();
    json_number(root, "wind_seed", (double)c->arguments->motion.wind_seed);
    json_number(root, "frames", (double)c->motion.frame_count);
    json_text(root, "skinning", skinning_name(c));
    cJSON *rows = json_array(root, "weights");
    for (size_t i = 0; i < c->count; ++i) {
        char name[512];
        cli_clean_text(name, sizeof(name), c->rows[i].name);
        cJSON *row = cJSON_CreateObject();
        json_text(row, "name", name);
        json_text(row, "motion", c->rows[i].seen ? "seen" : "unseen");
        json_number(row, "influences", (double)c->rows[i].influences);
        json_record(row, &pc_motion_measures_record, &c->rows[i].measures);
        cJSON_AddItemToArray(rows, row);
    }
    return json_print(c->command->name, root);
}

int cli_evaluate_motion(const cli_command *command, const cli_arguments *arguments) {
    cli_catch_signals();
    comparison c = {.command = command, .arguments = arguments};
    int code = cli_context(command, arguments, &c.context);
    if (code == CLI_OK) {
        code = cli_load_asset(command, c.context, arguments->inputs[0], &c.asset);
    }
    if (code == CLI_OK && c.asset.proxy.triangle_count == 0) {
        code = cli_fail(command->name, CLI_INPUT,
                        "%s: the asset has no proxy yet; run its stages up to simplify",
                        arguments->inputs[0]);
    }
    if (code == CLI_OK) {
        code = simulate(&c);
    }
    if (code == CLI_OK) {
        code = compare(&c);
    }
    if (code == CLI_OK) {
        code = print_result(&c);
    }
    if (c.context != NULL) {
        pc_motion_free(c.context, &c.motion);
        pc_asset_free(c.context, &c.asset);
    }
    pc_context_destroy(c.context);
    return code;
}
