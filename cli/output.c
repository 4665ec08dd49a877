// Output folders: files appear in them together or not at all.
#define _POSIX_C_SOURCE 200809L
#include "cli.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static char *join(const char *folder, const char *name, const char *extension) {
    const size_t size = strlen(folder) + strlen(name) + strlen(extension) + 2;
    char *path = malloc(size);
    if (path != NULL) {
        snprintf(path, size, "%s/%s%s", folder, name, extension);
    }
    return path;
}

// Makes `folder` and its missing parents. `folder` ends up as it was; `created` counts the parts
// that were made. Returns 0 or an errno value.
static int make_folders(char *folder, size_t *created) {
    for (char *at = folder; *at != '\0'; ++at) {
        const bool part_ends = at[0] != '/' && (at[1] == '/' || at[1] == '\0');
        if (!part_ends) {
            continue;
        }
        const char saved = at[1];
        at[1] = '\0';
        const int made = mkdir(folder, 0777);
        const int error = made == 0 ? 0 : errno;
        at[1] = saved;
        *created += made == 0;
        if (made != 0 && error != EEXIST && error != EISDIR) {
            return error;
        }
    }
    return 0;
}

static int fail_folder(const cli_command *command, const char *folder, int error) {
    return cli_fail(command->name, CLI_OUTPUT,
                    "%s: the output folder cannot be written: %s; choose another with -o", folder,
                    strerror(error));
}

int cli_output_begin(const cli_command *command, const char *folder, cli_output *output) {
    memset(output, 0, sizeof(*output));
    output->folder = malloc(strlen(folder) + 1);
    char *staging = join(folder, ".proxycloth-XXXXXX", "");
    if (output->folder == NULL || staging == NULL) {
        free(staging);
        return cli_fail(command->name, CLI_FAILED, "memory ran out");
    }
    memcpy(output->folder, folder, strlen(folder) + 1);
    const int error = make_folders(output->folder, &output->created);
    if (error != 0 || mkdtemp(staging) == NULL) {
        const int code = fail_folder(command, folder, error != 0 ? error : errno);
        free(staging);
        return code;
    }
    output->staging = staging;
    return CLI_OK;
}

char *cli_output_add(cli_output *output, const char *stem, const char *extension) {
    char *name = malloc(strlen(stem) + strlen(extension) + 1);
    char *path = output->name_count < sizeof(output->names) / sizeof(output->names[0])
                     ? join(output->staging, stem, extension)
                     : NULL;
    if (name == NULL || path == NULL) {
        free(name);
        free(path);
        return NULL;
    }
    memcpy(name, stem, strlen(stem));
    memcpy(name + strlen(stem), extension, strlen(extension) + 1);
    output->names[output->name_count++] = name;
    return path;
}

int cli_output_commit(const cli_command *command, cli_output *output) {
    size_t done = 0;
    int error = 0;
    for (; done < output->name_count && error == 0; ++done) {
        char *from = join(output->staging, output->names[done], "");
        char *to = join(output->folder, output->names[done], "");
        if (from == NULL || to == NULL) {
            error = ENOMEM;
        } else if (rename(from, to) != 0) {
            error = errno;
        }
        free(from);
        free(to);
    }
    if (error == 0) {
        output->created = 0; // the folders stay
        return CLI_OK;
    }
    // Results that are already in place would be half a set.
    for (size_t i = 0; i + 1 < done; ++i) {
        char *placed = join(output->folder, output->names[i], "");
        if (placed != NULL) {
            (void)unlink(placed);
        }
        free(placed);
    }
    return fail_folder(command, output->folder, error);
}

void cli_output_end(cli_output *output) {
    for (size_t i = 0; i < output->name_count; ++i) {
        char *path = join(output->staging, output->names[i], "");
        if (path != NULL) {
            (void)unlink(path);
        }
        free(path);
        free(output->names[i]);
    }
    if (output->staging != NULL) {
        (void)rmdir(output->staging);
        free(output->staging);
    }
    // Folders that this run made, innermost first.
    for (; output->created != 0; --output->created) {
        size_t length = strlen(output->folder);
        while (length > 0 && output->folder[length - 1] == '/') {
            output->folder[--length] = '\0';
        }
        (void)rmdir(output->folder);
        while (length > 0 && output->folder[length - 1] != '/') {
            output->folder[--length] = '\0';
        }
    }
    free(output->folder);
    memset(output, 0, sizeof(*output));
}
