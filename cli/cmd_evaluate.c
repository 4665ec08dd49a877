// evaluate: measures of a proxy mesh against its visual mesh.
#include "cli.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "print.h"
#include "scene.h"

// One side of the comparison: an asset file, or a scene until it becomes a visual mesh.
typedef struct eval_side {
    cli_kind kind;
    scene_data scene;
    uint8_t *chosen;
    pc_asset asset;
} eval_side;

static int import_side(const cli_command *command, const cli_arguments *arguments, size_t index,
                       eval_side *side) {
    const char *path = arguments->inputs[index];
    int code = cli_input_kind(command->name, path, &side->kind);
    if (code == CLI_OK && side->kind == CLI_KIND_SCENE) {
        // --mesh chooses parts of the visual mesh.
        cli_arguments chosen = *arguments;
        chosen.pattern_count = index == 0 ? arguments->pattern_count : 0;
        code = scene_import_selected(command, &chosen, path, &side->scene, &side->chosen);
    }
    return code;
}

static int load_side(const cli_command *command, const cli_arguments *arguments, size_t index,
                     pc_context *context, eval_side *side, const pc_mesh **mesh) {
    const char *path = arguments->inputs[index];
    *mesh = &side->asset.visual.surface;
    if (side->kind == CLI_KIND_SCENE) {
        const pc_status status = scene_visual(&side->scene, side->chosen, context,
                                              &side->asset.visual, &side->asset.reports.visual);
        return status == PC_OK ? CLI_OK
                               : cli_fail_status(command->name, context, status, path, false);
    }
    const int code = cli_load_asset(command, context, path, &side->asset);
    if (code == CLI_OK && index == 1) {
        *mesh = &side->asset.proxy;
        if (side->asset.proxy.triangle_count == 0) {
            return cli_fail(command->name, CLI_INPUT,
                            "%s: the asset has no proxy yet; run its stages up to simplify", path);
        }
    }
    return code;
}

typedef struct measure_group {
    const char *title;
    const char *first; // the field that starts the group
} measure_group;

// Groups the measures, and puts NAME_mean, NAME_sd and NAME_worst into one row.
static void print_measures(const pc_measures *measures) {
    static const measure_group groups[] = {{"proxy mesh", "vertices"},
                                           {"defects, none is best", "nonmanifold_edges"},
                                           {"distance, 0 is best", "hausdorff"},
                                           {"shape of the triangles", "min_angle_mean"}};
    const pc_record *record = &pc_measures_record;
    for (size_t i = 0, group = 0; i < record->field_count; ++i) {
        const pc_field *field = &record->fields[i];
        const size_t length = strlen(field->name);
        if (group < sizeof(groups) / sizeof(groups[0]) &&
            strcmp(field->name, groups[group].first) == 0) {
            printf("%s# %s\n", group != 0 ? "\n" : "", groups[group].title);
            ++group;
        }
        if (length > 5 && strcmp(field->name + length - 5, "_mean") == 0 &&
            i + 2 < record->field_count) {
            printf("%-28.*s mean %-9.4g sd %-9.4g worst %.4g%s%s\n", (int)length - 5, field->name,
                   pc_field_number(field, measures), pc_field_number(field + 1, measures),
                   pc_field_number(field + 2, measures), field->unit[0] != '\0' ? " " : "",
                   field->unit);
            i += 2;
        } else {
            const pc_record one = {.fields = field, .field_count = 1, .size = record->size};
            print_record(&one, measures, "");
        }
    }
}

static int evaluate(const cli_command *command, const cli_arguments *arguments, pc_context *context,
                    eval_side sides[2]) {
    const pc_mesh *meshes[2];
    for (size_t i = 0; i < 2; ++i) {
        const int code = load_side(command, arguments, i, context, &sides[i], &meshes[i]);
        if (code != CLI_OK) {
            return code;
        }
    }
    pc_measures measures;
    const pc_status status = pc_evaluate(context, meshes[0], meshes[1], &measures);
    if (status != PC_OK) {
        return cli_fail_status(command->name, context, status, arguments->inputs[1], false);
    }
    if (!arguments->settings.json) {
        print_measures(&measures);
        return CLI_OK;
    }
    cJSON *root = cJSON_CreateObject();
    json_record(root, &pc_measures_record, &measures);
    return json_print(command->name, root);
}

int cli_run_evaluate(const cli_command *command, cli_arguments *arguments) {
    if (arguments->settings.motion) {
        return cli_evaluate_motion(command, arguments);
    }
    if (arguments->scenario != NULL) {
        return cli_fail(command->name, CLI_USAGE, "--scenario needs --motion");
    }
    if (arguments->input_count < 2) {
        return cli_fail(command->name, CLI_USAGE, "an input is missing; usage: proxycloth %s %s",
                        command->name, command->operands);
    }
    cli_catch_signals();
    eval_side sides[2];
    pc_context *context = NULL;
    int code = CLI_OK;
    memset(sides, 0, sizeof(sides));
    for (size_t i = 0; i < 2 && code == CLI_OK; ++i) {
        code = import_side(command, arguments, i, &sides[i]);
    }
    if (code == CLI_OK) {
        code = cli_context(command, arguments, &context);
    }
    if (code == CLI_OK) {
        code = evaluate(command, arguments, context, sides);
    }
    for (size_t i = 0; i < 2; ++i) {
        if (context != NULL) {
            pc_asset_free(context, &sides[i].asset);
        }
        free(sides[i].chosen);
        scene_free(&sides[i].scene);
    }
    pc_context_destroy(context);
    return code;
}
