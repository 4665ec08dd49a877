// Names, asset files, and the chosen parts of scenes.
#include "cli.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "scene.h"

int cli_read_file(const char *path, char **bytes, size_t *size) {
    FILE *file = fopen(path, "rb");
    size_t capacity = 1 << 16;
    int error = file == NULL ? errno : 0;
    *bytes = NULL;
    *size = 0;
    for (char *grown; error == 0; capacity *= 2) {
        if ((grown = realloc(*bytes, capacity)) == NULL) {
            error = ENOMEM;
            break;
        }
        *bytes = grown;
        errno = 0;
        *size += fread(*bytes + *size, 1, capacity - 1 - *size, file);
        if (*size < capacity - 1) {
            error = !ferror(file) ? 0 : errno != 0 ? errno : EIO;
            (*bytes)[*size] = '\0';
            break;
        }
    }
    if (file != NULL) {
        fclose(file);
    }
    if (error != 0) {
        free(*bytes);
        *bytes = NULL;
    }
    return error;
}

int cli_garment_name(const cli_command *command, const cli_arguments *arguments,
                     char name[sizeof(((pc_asset *)NULL)->name)]) {
    const size_t size = sizeof(((pc_asset *)NULL)->name);
    char raw[4096];
    const char *source = arguments->name;
    size_t length;
    if (source != NULL) {
        length = strlen(source);
    } else {
        source = strrchr(arguments->inputs[0], '/');
        source = source != NULL ? source + 1 : arguments->inputs[0];
        const char *dot = strrchr(source, '.');
        length = dot != NULL && dot != source ? (size_t)(dot - source) : strlen(source);
    }
    if (length == 0 || length >= size || memchr(source, '/', length) != NULL) {
        return cli_fail(command->name, CLI_USAGE,
                        "the name \"%.*s\" must have 1 to %zu bytes and no slash; choose one with "
                        "--name",
                        (int)(length < 200 ? length : 200), source, size - 1);
    }
    memcpy(raw, source, length);
    raw[length] = '\0';
    cli_clean_text(name, size, raw);
    return CLI_OK;
}

int cli_extend_name(const cli_command *command, const char *base, const char *kind, uint32_t number,
                    char name[sizeof(((pc_asset *)NULL)->name)]) {
    const size_t size = sizeof(((pc_asset *)NULL)->name);
    char buffer[sizeof(((pc_asset *)NULL)->name)] = {0};
    const int length = snprintf(buffer, size, "%s.%s%u", base, kind, (unsigned)number);
    if (length < 0 || (size_t)length >= size) {
        return cli_fail(command->name, CLI_USAGE,
                        "the name \"%s\" is too long for \".%s%u\" behind it; choose another "
                        "with --name",
                        base, kind, (unsigned)number);
    }
    memcpy(name, buffer, size);
    return CLI_OK;
}

int cli_load_asset(const cli_command *command, pc_context *context, const char *path,
                   pc_asset *asset) {
    cli_kind kind;
    int code = cli_input_kind(command->name, path, &kind);
    if (code == CLI_OK && kind != CLI_KIND_ASSET) {
        code = cli_fail(command->name, CLI_INPUT,
                        "%s: this is no asset file; make one with 'proxycloth voxelize' or "
                        "'proxycloth build'",
                        path);
    }
    if (code == CLI_OK) {
        const pc_status status = pc_asset_load(context, path, asset);
        if (status != PC_OK) {
            code = cli_fail_status(command->name, context, status, path, false);
        }
    }
    return code;
}

int cli_load_scenario(const cli_command *command, const cli_arguments *arguments,
                      pc_context *context, pc_asset *asset) {
    pc_scenario_free(context, &asset->scenario);
    if (arguments->scenario == NULL) {
        return CLI_OK;
    }
    // The options were taken when the command line was read.
    pc_simulate_options options = arguments->options.simulate;
    const pc_status status =
        pc_scenario_read(context, arguments->scenario, &options, &asset->scenario);
    return status == PC_OK
               ? CLI_OK
               : cli_fail_status(command->name, context, status, arguments->scenario, false);
}

int scene_import_selected(const cli_command *command, const cli_arguments *arguments,
                          const char *path, scene_data *scene, uint8_t **chosen) {
    *chosen = NULL;
    int code = scene_import(command, arguments, path, scene);
    if (code != CLI_OK) {
        return code;
    }
    *chosen = calloc(scene->header.part_count + 1, 1);
    if (*chosen == NULL) {
        code = cli_fail(command->name, CLI_LIMIT, "%s: memory ran out", path);
    } else if (scene_select(scene, arguments->patterns, arguments->pattern_count, *chosen) == 0 &&
               arguments->pattern_count != 0) {
        char names[1024];
        scene_names(scene, names, sizeof(names));
        code =
            cli_fail(command->name, CLI_USAGE, "%s: --mesh \"%s\" matches no part; names are: %s",
                     path, arguments->patterns[0], names);
    }
    if (code != CLI_OK) {
        free(*chosen);
        *chosen = NULL;
        scene_free(scene);
    }
    return code;
}
