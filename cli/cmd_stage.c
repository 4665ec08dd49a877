// One command per stage: asset file -> asset file. The first stage also reads scenes.
#include "cli.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "scene.h"

// Fills the asset's visual mesh and name from a scene file.
static int import_visual(const cli_command *command, const cli_arguments *arguments,
                         pc_context *context, const scene_data *scene, const uint8_t *chosen,
                         pc_asset *asset) {
    const int code = cli_garment_name(command, arguments, asset->name);
    if (code != CLI_OK) {
        return code;
    }
    pc_status status = scene_visual(scene, chosen, context, &asset->visual, &asset->reports.visual);
    if (status == PC_OK) {
        status = scene_character(scene, chosen, context, &asset->character);
    }
    if (status != PC_OK) {
        return cli_fail_status(command->name, context, status, arguments->inputs[0], false);
    }
    cli_warn_report(command->name, "visual", &pc_visual_report_record, &asset->reports.visual);
    return CLI_OK;
}

static int run_and_save(const cli_command *command, pc_context *context, const pc_options *options,
                        pc_asset *asset, const cli_arguments *arguments, const char *output) {
    const char *input = arguments->inputs[0];
    if (arguments->lp != NULL &&
        (strcmp(arguments->lp, output) == 0 || cli_same_file(input, arguments->lp))) {
        return cli_fail(command->name, CLI_USAGE, "--write-lp: %s is the asset file",
                        arguments->lp);
    }
    const pc_stage_info *info = pc_stage_describe(command->stage);
    pc_status status = pc_run_stage(context, command->stage, options, asset, NULL);
    if (status != PC_OK) {
        return cli_fail_status(command->name, context, status, input, false);
    }
    cli_warn_report(command->name, info->name, info->report,
                    (const char *)&asset->reports + info->report_offset);
    cli_begin_writing();
    if (arguments->lp != NULL) {
        // Without the file that was asked for, the asset stays as it was.
        status = pc_label_write_lp(context, &asset->graph, &options->label, arguments->lp);
        if (status != PC_OK) {
            return cli_fail_status(command->name, context, status, arguments->lp, true);
        }
    }
    status = pc_asset_save(context, asset, output);
    return status == PC_OK ? CLI_OK : cli_fail_status(command->name, context, status, output, true);
}

// Puts ".lod64" in front of the extension of a path; the caller frees the result.
static char *level_path(const char *path, uint32_t vertices) {
    const char *slash = strrchr(path, '/'), *dot = strrchr(path, '.');
    const bool extended = dot != NULL && dot != path && (slash == NULL || dot > slash + 1);
    const size_t stem = extended ? (size_t)(dot - path) : strlen(path);
    const size_t size = strlen(path) + 32;
    char *result = malloc(size);
    if (result != NULL) {
        snprintf(result, size, "%.*s.lod%u%s", (int)stem, path, (unsigned)vertices, path + stem);
    }
    return result;
}

// One asset file per level; the input stays as it is.
static int run_levels(const cli_command *command, const cli_arguments *arguments,
                      pc_context *context, pc_asset *asset, const char *output) {
    pc_options options = arguments->options;
    char base[sizeof(asset->name)];
    memcpy(base, asset->name, sizeof(base));
    int code = CLI_OK;
    for (size_t i = 0; i < arguments->levels.count && code == CLI_OK; ++i) {
        options.simplify.vertices = arguments->levels.values[i];
        char *path = level_path(output, arguments->levels.values[i]);
        code = path != NULL
                   ? cli_extend_name(command, base, "lod", arguments->levels.values[i], asset->name)
                   : cli_fail(command->name, CLI_LIMIT, "memory ran out");
        if (code == CLI_OK) {
            code = run_and_save(command, context, &options, asset, arguments, path);
        }
        free(path);
    }
    return code;
}

static int run(const cli_command *command, const cli_arguments *arguments, pc_context *context,
               pc_asset *asset) {
    const char *input = arguments->inputs[0];
    if (asset->stage_count < (uint32_t)command->stage) {
        const pc_stage_info *next = pc_stage_describe((pc_stage)asset->stage_count);
        return cli_fail(command->name, CLI_INPUT,
                        "%s: stage %s has not run yet; run 'proxycloth %s' first", input,
                        next->name, next->name);
    }
    if (command->stage == PC_STAGE_SIMULATE) {
        const int code = cli_load_scenario(command, arguments, context, asset);
        if (code != CLI_OK) {
            return code;
        }
    }
    const char *output = arguments->output != NULL ? arguments->output : input;
    if (arguments->levels.count > 0) {
        return run_levels(command, arguments, context, asset, output);
    }
    return run_and_save(command, context, &arguments->options, asset, arguments, output);
}

int cli_run_stage(const cli_command *command, cli_arguments *arguments) {
    cli_catch_signals();
    const char *input = arguments->inputs[0];
    const bool scenes = (command->accepts & CLI_MESH) != 0;
    scene_data scene = {0};
    uint8_t *chosen = NULL;
    pc_context *context = NULL;
    pc_asset asset;
    memset(&asset, 0, sizeof(asset));
    cli_kind kind;
    int code = cli_input_kind(command->name, input, &kind);
    if (code == CLI_OK && scenes && kind == CLI_KIND_SCENE) {
        if (arguments->output == NULL) {
            code =
                cli_fail(command->name, CLI_USAGE, "-o ASSET is missing; usage: proxycloth %s %s",
                         command->name, command->operands);
        } else if (cli_same_file(input, arguments->output)) {
            code = cli_fail(command->name, CLI_USAGE,
                            "%s: the asset file would replace what it is made from; choose "
                            "another name with -o",
                            arguments->output);
        } else {
            code = scene_import_selected(command, arguments, input, &scene, &chosen);
        }
    }
    if (code == CLI_OK) {
        code = cli_context(command, arguments, &context);
    }
    if (code == CLI_OK) {
        code = chosen != NULL ? import_visual(command, arguments, context, &scene, chosen, &asset)
                              : cli_load_asset(command, context, input, &asset);
    }
    if (code == CLI_OK && chosen == NULL && arguments->name != NULL) {
        memset(asset.name, 0, sizeof(asset.name));
        code = cli_garment_name(command, arguments, asset.name);
    }
    if (code == CLI_OK) {
        code = run(command, arguments, context, &asset);
    }
    if (context != NULL) {
        pc_asset_free(context, &asset);
    }
    pc_context_destroy(context);
    free(chosen);
    scene_free(&scene);
    return code;
}
