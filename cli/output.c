// Output folders: the files of a run are moved into them when all are complete.
#define _DEFAULT_SOURCE // flock, fts
#define _POSIX_C_SOURCE 200809L
#include "cli.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <fts.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

static const char staging_prefix[] = ".proxycloth-";

bool cli_is_staging(const char *name) {
    return strncmp(name, staging_prefix, strlen(staging_prefix)) == 0;
}

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

void cli_remove_tree(const char *path, bool itself) {
    char *roots[] = {strdup(path), NULL};
    FTS *walk = roots[0] != NULL ? fts_open(roots, FTS_PHYSICAL | FTS_NOCHDIR, NULL) : NULL;
    const FTSENT *entry;
    while (walk != NULL && (entry = fts_read(walk)) != NULL) {
        if (entry->fts_info == FTS_DP && (itself || entry->fts_level > FTS_ROOTLEVEL)) {
            (void)rmdir(entry->fts_accpath);
        } else if (entry->fts_info != FTS_D && entry->fts_info != FTS_DP) {
            (void)unlink(entry->fts_accpath);
        }
    }
    if (walk != NULL) {
        fts_close(walk);
    }
    free(roots[0]);
}

// Locks a staging folder; -1: another run holds it, or removed it. Where a file system has no locks
// nothing is ever taken for abandoned.
static int lock_staging(const char *path, bool *unlocked) {
    const int folder = open(path, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    struct stat info;
    if (folder < 0) {
        return -1;
    }
    *unlocked = flock(folder, LOCK_EX | LOCK_NB) != 0;
    if ((*unlocked && errno == EWOULDBLOCK) || fstat(folder, &info) != 0 || info.st_nlink == 0) {
        close(folder);
        return -1;
    }
    return folder;
}

// Removes the staging folders of runs that were killed: nobody holds their lock.
static void remove_abandoned(const char *folder) {
    DIR *listing = opendir(folder);
    for (const struct dirent *entry; listing != NULL && (entry = readdir(listing)) != NULL;) {
        if (!cli_is_staging(entry->d_name)) {
            continue;
        }
        bool unlocked = true;
        char *path = join(folder, entry->d_name, "");
        const int lock = path != NULL ? lock_staging(path, &unlocked) : -1;
        if (lock >= 0 && !unlocked) {
            cli_remove_tree(path, true);
        }
        if (lock >= 0) {
            close(lock);
        }
        free(path);
    }
    if (listing != NULL) {
        closedir(listing);
    }
}

// Makes and locks a staging folder: its path and lock, or NULL with errno. A run that starts at the
// same time may take the folder for abandoned before it is locked.
static char *make_staging(const char *folder, int *lock) {
    *lock = -1;
    for (int attempt = 0; attempt < 16; ++attempt) {
        bool unlocked;
        char *path = join(folder, staging_prefix, "XXXXXX");
        if (path == NULL || mkdtemp(path) == NULL) {
            free(path);
            return NULL;
        }
        *lock = lock_staging(path, &unlocked);
        if (*lock >= 0) {
            return path;
        }
        (void)rmdir(path);
        free(path);
    }
    errno = EBUSY;
    return NULL;
}

static int fail_folder(const cli_command *command, const char *folder, int error) {
    return cli_fail(command->name, CLI_OUTPUT,
                    "%s: the output folder cannot be written: %s; choose another with -o", folder,
                    strerror(error));
}

int cli_output_begin(const cli_command *command, const char *folder, cli_output *output) {
    memset(output, 0, sizeof(*output));
    output->lock = -1;
    const size_t length = strlen(folder);
    output->folder = malloc(length + 1);
    output->made = calloc(length + 3, sizeof(*output->made)); // no more parts than letters
    if (output->folder == NULL || output->made == NULL) {
        return cli_fail(command->name, CLI_LIMIT, "memory ran out");
    }
    memcpy(output->folder, folder, length + 1);
    const int error = make_folders(output);
    if (error != 0) {
        return fail_folder(command, folder, error);
    }
    remove_abandoned(folder);
    output->staging = make_staging(folder, &output->lock);
    if (output->staging == NULL) {
        return fail_folder(command, folder, errno);
    }
    note_folder(output, output->staging);
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
static int check_target(const cli_command *command, const char *from, const char *to) {
    struct stat target;
    (void)from;
    if (lstat(to, &target) != 0 || S_ISREG(target.st_mode) || S_ISLNK(target.st_mode)) {
        return CLI_OK;
    }
    return cli_fail(command->name, CLI_OUTPUT,
                    "%s: %s is in the way of a result; move it away, or choose another folder "
                    "with -o",
                    to, S_ISDIR(target.st_mode) ? "a folder" : "something that is no file");
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

// Calls `step` for every file with its path in the staging folder and in its place.
static int for_each_file(const cli_command *command, const cli_output *output,
                         int (*step)(const cli_command *command, const char *from,
                                     const char *to)) {
    int code = CLI_OK;
    for (size_t i = 0; i < output->name_count && code == CLI_OK; ++i) {
        char *from = join(output->staging, output->names[i], "");
        char *to = join(output->folder, output->names[i], "");
        code = from != NULL && to != NULL ? step(command, from, to)
                                          : cli_fail(command->name, CLI_LIMIT, "memory ran out");
        free(from);
        free(to);
    }
    return code;
}

bool cli_same_file(const char *left, const char *right) {
    struct stat a, b;
    return left != NULL && stat(left, &a) == 0 && stat(right, &b) == 0 && a.st_dev == b.st_dev &&
           a.st_ino == b.st_ino;
}

int cli_output_protect(const cli_command *command, const cli_output *output, const char *input) {
    int code = CLI_OK;
    for (size_t i = 0; i < output->name_count && code == CLI_OK; ++i) {
        char *to = join(output->folder, output->names[i], "");
        if (to == NULL) {
            code = cli_fail(command->name, CLI_LIMIT, "memory ran out");
        } else if (cli_same_file(input, to)) {
            code = cli_fail(command->name, CLI_USAGE,
                            "%s: a result would replace what it is made from; choose another "
                            "folder with -o, or another name with --name",
                            to);
        }
        free(to);
    }
    return code;
}

int cli_output_commit(const cli_command *command, cli_output *output) {
    const int code = for_each_file(command, output, check_target);
    return code == CLI_OK ? for_each_file(command, output, move_to_place) : code;
}

void cli_output_end(cli_output *output) {
    const int lock = output->staging != NULL ? output->lock : -1;
    cli_abandon(NULL);
    for (size_t i = 0; i < output->name_count; ++i) {
        char *path = output->staging != NULL ? join(output->staging, output->names[i], "") : NULL;
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
    if (lock >= 0) {
        close(lock);
    }
    free(output->names);
    free(output->made);
    free(output->folder);
    memset(output, 0, sizeof(*output));
}
