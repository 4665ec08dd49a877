// Names and asset files.
#include "cli.h"

#include <string.h>

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
