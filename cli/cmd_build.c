// build: garment mesh -> all results. export: asset file -> the other results.
#include "cli.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "scene.h"

typedef enum result_file {
    FILE_GLB,
    FILE_PROXY,
    FILE_ASSET,
    FILE_REPORT,
    FILE_SHEET,
    FILE_STRIP,
    FILE_COUNT
} result_file;

static const char *const extensions[FILE_COUNT] = {".glb",  ".proxy.obj", ".h5",
                                                   ".json", ".png",       ".strip.png"};

static pc_status write_file(pc_context *context, result_file file, const pc_asset *asset,
                            const pc_timings *timings, const pc_measures *measures,
                            const char *path) {
    switch (file) {
    case FILE_GLB:
        return pc_export_glb(context, asset, path);
    case FILE_PROXY:
        return pc_export_obj(context, &asset->proxy, path);
    case FILE_ASSET:
        return pc_asset_save(context, asset, path);
    case FILE_REPORT:
        return pc_export_report(context, asset, measures, timings, path);
    case FILE_SHEET:
        return pc_export_contact_sheet(context, asset, NULL, path);
    case FILE_STRIP:
        return pc_export_strip(context, asset, NULL, path);
    case FILE_COUNT:
        break;
    }
    return PC_ERROR_INTERNAL;
}

// Warnings of a report; in a series they say which level.
static void warn(const cli_command *command, const cli_arguments *arguments, const pc_asset *asset,
                 const char *stage, const pc_record *record, const void *report) {
    char place[sizeof(asset->name) + 32];
    snprintf(place, sizeof(place), "%s: %s", asset->name, stage);
    cli_warn_report(command->name, arguments->level_count > 0 ? place : stage, record, report);
}

int cli_export_files(const cli_command *command, const cli_arguments *arguments,
                     pc_context *context, const pc_asset *asset, const pc_timings *timings,
                     bool with_asset, cli_output *output) {
    pc_measures measures;
    pc_status status = pc_evaluate(context, &asset->visual.surface, &asset->proxy, &measures);
    if (status != PC_OK) {
        return cli_fail_status(command->name, context, status, NULL, false);
    }
    cli_begin_writing();
    for (result_file file = 0; file < FILE_COUNT; ++file) {
        if ((file == FILE_ASSET && !with_asset) ||
            (file == FILE_SHEET && !arguments->settings.png) ||
            (file == FILE_STRIP && !arguments->settings.strip)) {
            continue;
        }
        if (cli_interrupted()) {
            return cli_fail_interrupted(command->name);
        }
        char *path = cli_output_add(output, asset->name, extensions[file]);
        if (path == NULL) {
            return cli_fail(command->name, CLI_FAILED, "memory ran out");
        }
        status = write_file(context, file, asset, timings, &measures, path);
        free(path);
        if (status != PC_OK) {
            return cli_fail_status(command->name, context, status, NULL, true);
        }
    }
    warn(command, arguments, asset, "evaluate", &pc_measures_record, &measures);
    return CLI_OK;
}

// One finished level, for the lines at the end.
typedef struct level {
    char name[sizeof(((pc_asset *)NULL)->name)];
    size_t vertices, triangles;
} level;

// One garment on its way to its files: one proxy, or a series of levels of detail.
typedef struct garment {
    const cli_command *command;
    const cli_arguments *arguments;
    pc_context *context;
    cli_output *output;
    pc_timings timings;
    level levels[CLI_MAXIMUM_LEVELS];
    size_t level_count;
} garment;

static void warn_about_stages(const garment *g, const pc_asset *asset, pc_stage first,
                              pc_stage end) {
    for (pc_stage stage = first; stage < end; ++stage) {
        const pc_stage_info *info = pc_stage_describe(stage);
        warn(g->command, g->arguments, asset, info->name, info->report,
             (const char *)&asset->reports + info->report_offset);
        if (g->arguments->settings.verbose) {
            fprintf(stderr, "proxycloth %s: note: %s: %.2f s\n", g->command->name, info->name,
                    g->timings.seconds[stage]);
        }
    }
}

static void print_summary(const garment *g) {
    for (size_t i = 0; i < g->level_count && !g->arguments->settings.quiet; ++i) {
        fprintf(stderr, "proxycloth %s: note: %s: %zu vertices, %zu triangles -> %s/%s.*\n",
                g->command->name, g->levels[i].name, g->levels[i].vertices, g->levels[i].triangles,
                g->arguments->output, g->levels[i].name);
    }
}

// Runs the stages that depend on the number of vertices, and writes the files.
static int finish_level(garment *g, const pc_options *options, pc_asset *asset) {
    const pc_status status =
        pc_build_from(g->context, PC_STAGE_SIMPLIFY, options, asset, &g->timings);
    if (status != PC_OK) {
        return cli_fail_status(g->command->name, g->context, status, g->arguments->inputs[0],
                               false);
    }
    const int code =
        cli_export_files(g->command, g->arguments, g->context, asset, &g->timings, true, g->output);
    if (code == CLI_OK) {
        warn_about_stages(g, asset, PC_STAGE_SIMPLIFY, PC_STAGE_COUNT);
        level *done = &g->levels[g->level_count++];
        memcpy(done->name, asset->name, sizeof(done->name));
        done->vertices = asset->proxy.vertex_count;
        done->triangles = asset->proxy.triangle_count;
    }
    return code;
}

static int finish_levels(garment *g, pc_asset *asset) {
    pc_options options = g->arguments->options;
    if (g->arguments->level_count == 0) {
        return finish_level(g, &options, asset);
    }
    char base[sizeof(asset->name)];
    memcpy(base, asset->name, sizeof(base));
    int code = CLI_OK;
    for (size_t i = 0; i < g->arguments->level_count && code == CLI_OK; ++i) {
        options.simplify.vertices = g->arguments->levels[i];
        code = cli_name_level(g->command, base, g->arguments->levels[i], asset->name);
        if (code == CLI_OK) {
            code = finish_level(g, &options, asset);
        }
    }
    return code;
}

static int build(garment *g, const scene_data *scene, const uint8_t *chosen, pc_asset *asset) {
    int code = cli_garment_name(g->command, g->arguments, asset->name);
    if (code != CLI_OK) {
        return code;
    }
    code = cli_load_scenario(g->command, g->arguments, g->context, asset);
    if (code != CLI_OK) {
        return code;
    }
    pc_status status =
        scene_visual(scene, chosen, g->context, &asset->visual, &asset->reports.visual);
    if (status == PC_OK) {
        status = scene_character(scene, chosen, g->context, &asset->character);
    }
    for (pc_stage stage = 0; stage < PC_STAGE_SIMPLIFY && status == PC_OK; ++stage) {
        status = pc_run_stage(g->context, stage, &g->arguments->options, asset, &g->timings);
    }
    if (status != PC_OK) {
        return cli_fail_status(g->command->name, g->context, status, g->arguments->inputs[0],
                               false);
    }
    cli_warn_report(g->command->name, "visual", &pc_visual_report_record, &asset->reports.visual);
    warn_about_stages(g, asset, PC_STAGE_VOXELIZE, PC_STAGE_SIMPLIFY);
    code = finish_levels(g, asset);
    if (code == CLI_OK) {
        code = cli_output_commit(g->command, g->output);
    }
    if (code == CLI_OK) {
        print_summary(g);
    }
    return code;
}

int cli_run_build(const cli_command *command, cli_arguments *arguments) {
    cli_catch_signals();
    cli_kind kind;
    int code = cli_input_kind(command->name, arguments->inputs[0], &kind);
    if (code == CLI_OK && kind == CLI_KIND_ASSET) {
        code = cli_fail(command->name, CLI_INPUT,
                        "%s: this is an asset file; run single stages on it, or export it",
                        arguments->inputs[0]);
    }
    scene_data scene = {0};
    uint8_t *chosen = NULL;
    pc_context *context = NULL;
    pc_asset asset;
    memset(&asset, 0, sizeof(asset));
    cli_output output = {0};
    if (code == CLI_OK) {
        code = scene_import_selected(command, arguments, arguments->inputs[0], &scene, &chosen);
    }
    // The output folder is tried before the long computation.
    if (code == CLI_OK) {
        code = cli_output_begin(command, arguments->output, &output);
    }
    if (code == CLI_OK) {
        code = cli_context(command, arguments, &context);
    }
    if (code == CLI_OK) {
        garment g = {
            .command = command, .arguments = arguments, .context = context, .output = &output};
        code = build(&g, &scene, chosen, &asset);
    }
    cli_output_end(&output);
    if (context != NULL) {
        pc_asset_free(context, &asset);
    }
    pc_context_destroy(context);
    free(chosen);
    scene_free(&scene);
    return code;
}

int cli_run_export(const cli_command *command, cli_arguments *arguments) {
    cli_catch_signals();
    const char *input = arguments->inputs[0];
    pc_context *context = NULL;
    pc_asset asset;
    memset(&asset, 0, sizeof(asset));
    cli_output output = {0};
    int code = cli_context(command, arguments, &context);
    if (code == CLI_OK) {
        code = cli_load_asset(command, context, input, &asset);
    }
    if (code == CLI_OK && asset.stage_count != PC_STAGE_COUNT) {
        const pc_stage_info *next = pc_stage_describe((pc_stage)asset.stage_count);
        code = cli_fail(command->name, CLI_INPUT,
                        "%s: stage %s has not run yet; run 'proxycloth %s' and the later stages "
                        "first",
                        input, next->name, next->name);
    }
    if (code == CLI_OK && arguments->name != NULL) {
        memset(asset.name, 0, sizeof(asset.name));
        code = cli_garment_name(command, arguments, asset.name);
    }
    if (code == CLI_OK) {
        code = cli_output_begin(command, arguments->output, &output);
    }
    if (code == CLI_OK) {
        code = cli_export_files(command, arguments, context, &asset, NULL, false, &output);
    }
    if (code == CLI_OK) {
        code = cli_output_commit(command, &output);
    }
    cli_output_end(&output);
    if (context != NULL) {
        pc_asset_free(context, &asset);
    }
    pc_context_destroy(context);
    return code;
}
