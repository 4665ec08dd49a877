// Output folders: the files of a run are moved into them when all are complete.
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

// Puts a path in front of the others.
static void note_folder(cli_output *output, char *path) {
    memmove(output->made + 1, output->made, output->made_count++ * sizeof(*output->made));
    output->made[0] = path;
}

// Makes the output folder and its missing parents, and notes those that were made. Returns 0 or an
// errno value.
static int make_folders(cli_output *output) {
    char *path = NULL;
    for (const char *at = output->folder; *at != '\0'; ++at) {
        const bool part_ends = at[0] != '/' && (at[1] == '/' || at[1] == '\0');
        if (!part_ends) {
            continue;
        }
        const size_t length = (size_t)(at - output->folder) + 1;
        path = malloc(length + 1);
        if (path == NULL) {
            return ENOMEM;
        }
        memcpy(path, output->folder, length);
        path[length] = '\0';
        if (mkdir(path, 0777) == 0) {
            note_folder(output, path);
            continue;
        }
        const int error = errno;
        free(path);
        if (error != EEXIST && error != EISDIR) {
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
    const size_t length = strlen(folder);
    output->folder = malloc(length + 1);
    output->made = calloc(length + 3, sizeof(*output->made)); // no more parts than letters
    char *staging = join(folder, ".proxycloth-XXXXXX", "");
    if (output->folder == NULL || output->made == NULL || staging == NULL) {
        free(staging);
        return cli_fail(command->name, CLI_LIMIT, "memory ran out");
    }
    memcpy(output->folder, folder, length + 1);
    const int error = make_folders(output);
    if (error != 0 || mkdtemp(staging) == NULL) {
        const int code = fail_folder(command, folder, error != 0 ? error : errno);
        free(staging);
        return code;
    }
    output->staging = staging;
    note_folder(output, staging);
    cli_abandon(output->made);
    return CLI_OK;
}

char *cli_output_add(cli_output *output, const char *stem, const char *extension) {
    if (output->name_count == output->name_capacity) {
        const size_t capacity = 2 * output->name_capacity + 8;
        char **grown = realloc(output->names, capacity * sizeof(*grown));
        if (grown == NULL) {
            return NULL;
        }
        output->names = grown;
        output->name_capacity = capacity;
    }
    char *name = malloc(strlen(stem) + strlen(extension) + 1);
    char *path = join(output->staging, stem, extension);
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

// Whatever could refuse a rename is looked at before the first one, so that a set is replaced as a
// whole or stays as it was.
static int check_target(const cli_command *command, const char *path) {
    struct stat target;
    if (lstat(path, &target) != 0 || S_ISREG(target.st_mode) || S_ISLNK(target.st_mode)) {
        return CLI_OK;
    }
    return cli_fail(command->name, CLI_OUTPUT,
                    "%s: %s is in the way of a result; move it away, or choose another folder "
                    "with -o",
                    path, S_ISDIR(target.st_mode) ? "a folder" : "something that is no file");
}

// Each rename is atomic. After one that fails nothing is taken back: a file is the new one or the
// old one.
static int move_to_place(const cli_command *command, const char *from, const char *to) {
    if (rename(from, to) == 0) {
        return CLI_OK;
    }
    return cli_fail(command->name, CLI_OUTPUT,
                    "%s: the result cannot be put in place: %s; results of this run and of an "
                    "earlier one may now be mixed",
                    to, strerror(errno));
}

int cli_output_commit(const cli_command *command, cli_output *output) {
    int code = CLI_OK;
    for (size_t i = 0; i < 2 * output->name_count && code == CLI_OK; ++i) {
        const char *name = output->names[i % output->name_count];
        char *from = join(output->staging, name, "");
        char *to = join(output->folder, name, "");
        if (from == NULL || to == NULL) {
            code = cli_fail(command->name, CLI_LIMIT, "memory ran out");
        } else if (i < output->name_count) {
            code = check_target(command, to);
        } else {
            code = move_to_place(command, from, to);
        }
        free(from);
        free(to);
    }
    return code;
}

void cli_output_end(cli_output *output) {
    cli_abandon(NULL);
    for (size_t i = 0; i < output->name_count; ++i) {
        char *path = join(output->staging, output->names[i], "");
        if (path != NULL) {
            (void)unlink(path);
        }
        free(path);
        free(output->names[i]);
    }
    // Fails for folders that hold something by now: results, or files of somebody else.
    for (size_t i = 0; i < output->made_count; ++i) {
        (void)rmdir(output->made[i]);
        free(output->made[i]);
    }
    free(output->names);
    free(output->made);
    free(output->folder);
    memset(output, 0, sizeof(*output));
}
