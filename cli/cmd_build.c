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
    FILE_COUNT
} result_file;

static const char *const extensions[FILE_COUNT] = {".glb", ".proxy.obj", ".h5", ".json", ".png"};

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
    case FILE_COUNT:
        break;
    }
    return PC_ERROR_INTERNAL;
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
            (file == FILE_SHEET && !arguments->settings.png)) {
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
    cli_warn_report(command->name, "evaluate", &pc_measures_record, &measures);
    return CLI_OK;
}

static void print_summary(const cli_command *command, const cli_arguments *arguments,
                          const pc_asset *asset, const pc_timings *timings) {
    cli_warn_report(command->name, "visual", &pc_visual_report_record, &asset->reports.visual);
    for (pc_stage stage = 0; stage < PC_STAGE_COUNT; ++stage) {
        const pc_stage_info *info = pc_stage_describe(stage);
        cli_warn_report(command->name, info->name, info->report,
                        (const char *)&asset->reports + info->report_offset);
        if (arguments->settings.verbose && timings != NULL) {
            fprintf(stderr, "proxycloth %s: note: %s: %.2f s\n", command->name, info->name,
                    timings->seconds[stage]);
        }
    }
    if (!arguments->settings.quiet) {
        fprintf(stderr, "proxycloth %s: note: %s: %zu vertices, %zu triangles -> %s/%s.*\n",
                command->name, asset->name, asset->proxy.vertex_count, asset->proxy.triangle_count,
                arguments->output, asset->name);
    }
}

static int build(const cli_command *command, const cli_arguments *arguments, pc_context *context,
                 const scene_data *scene, const uint8_t *chosen, pc_asset *asset,
                 cli_output *output) {
    const char *input = arguments->inputs[0];
    pc_timings timings = {0};
    int code = cli_garment_name(command, arguments, asset->name);
    if (code != CLI_OK) {
        return code;
    }
    code = cli_load_scenario(command, arguments, context, asset);
    if (code != CLI_OK) {
        return code;
    }
    pc_status status = scene_visual(scene, chosen, context, &asset->visual, &asset->reports.visual);
    if (status == PC_OK) {
        status = scene_character(scene, chosen, context, &asset->character);
    }
    if (status == PC_OK) {
        status = pc_build(context, &arguments->options, asset, &timings);
    }
    if (status != PC_OK) {
        return cli_fail_status(command->name, context, status, input, false);
    }
    code = cli_export_files(command, arguments, context, asset, &timings, true, output);
    if (code == CLI_OK) {
        code = cli_output_commit(command, output);
    }
    if (code == CLI_OK) {
        print_summary(command, arguments, asset, &timings);
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
        code = build(command, arguments, context, &scene, chosen, &asset, &output);
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
