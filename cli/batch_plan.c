// Which garments a batch converts: files, folders, globs and manifests -> jobs; shards.
#define _DEFAULT_SOURCE // fts, realpath
#define _POSIX_C_SOURCE 200809L
#include "batch.h"

#include <errno.h>
#include <fts.h>
#include <glob.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "scene.h"

static int fail_memory(const batch_plan *plan) {
    return cli_fail(plan->command->name, CLI_LIMIT, "memory ran out");
}

static int add_file(batch_plan *plan, const char *path, const char *file) {
    return batch_plan_add(plan, path, file, NULL) != NULL ? CLI_OK : fail_memory(plan);
}

// Folders that no garment is looked for in: hidden ones, the output, the results of batches.
static bool skip_folder(const FTSENT *entry, const struct stat *output) {
    if (entry->fts_level == FTS_ROOTLEVEL) {
        return false;
    }
    if (entry->fts_name[0] == '.' || (entry->fts_statp->st_dev == output->st_dev &&
                                      entry->fts_statp->st_ino == output->st_ino)) {
        return true;
    }
    char *record = batch_path(entry->fts_path, entry->fts_name, ".batch.json");
    const bool result = record != NULL && access(record, F_OK) == 0;
    free(record);
    return result;
}

// Whether a file of a folder is what `build` made of another: NAME.glb and NAME.proxy.obj side by
// side.
static bool is_result(const char *path) {
    static const char *const pair[] = {".proxy.obj", ".glb"};
    const size_t length = strlen(path);
    for (size_t i = 0; i < 2; ++i) {
        const size_t end = strlen(pair[i]);
        char *other = length > end && strcmp(path + length - end, pair[i]) == 0
                          ? malloc(length + sizeof(".proxy.obj"))
                          : NULL;
        if (other != NULL) {
            memcpy(other, path, length - end);
            memcpy(other + length - end, pair[1 - i], strlen(pair[1 - i]) + 1);
            const bool found = access(other, F_OK) == 0;
            free(other);
            return found;
        }
    }
    return false;
}

static int add_folder(batch_plan *plan, const char *path) {
    char *roots[] = {strdup(path), NULL};
    FTS *walk = roots[0] != NULL ? fts_open(roots, FTS_LOGICAL | FTS_NOCHDIR, NULL) : NULL;
    struct stat output = {0};
    (void)stat(plan->arguments->output, &output);
    int code = walk != NULL ? CLI_OK : fail_memory(plan);
    const FTSENT *entry;
    while (code == CLI_OK && (errno = 0, entry = fts_read(walk)) != NULL) {
        if (entry->fts_info == FTS_D && skip_folder(entry, &output)) {
            (void)fts_set(walk, (FTSENT *)(uintptr_t)entry, FTS_SKIP);
        } else if (entry->fts_info == FTS_F && entry->fts_name[0] != '.' &&
                   scene_named_like_one(entry->fts_name) && !is_result(entry->fts_accpath)) {
            const char *name = entry->fts_path + strlen(path);
            code = add_file(plan, entry->fts_path, name + strspn(name, "/"));
        } else if (entry->fts_info == FTS_DNR || entry->fts_info == FTS_ERR) {
            code = cli_fail(plan->command->name, CLI_INPUT, "%s: %s", entry->fts_path,
                            strerror(entry->fts_errno));
        }
    }
    if (code == CLI_OK && errno != 0) {
        code = cli_fail(plan->command->name, CLI_INPUT, "%s: %s", path, strerror(errno));
    }
    if (walk != NULL) {
        fts_close(walk);
    }
    free(roots[0]);
    return code;
}

static bool is_manifest(const char *path) {
    const char *dot = strrchr(batch_base_name(path), '.');
    return dot != NULL && strcmp(dot, ".jsonl") == 0;
}

static int add_input(batch_plan *plan, const char *path, bool from_glob) {
    struct stat info;
    const bool exists = stat(path, &info) == 0;
    if (!from_glob && !exists && strpbrk(path, "*?[") != NULL) {
        glob_t found = {0};
        int code = CLI_OK;
        if (glob(path, 0, NULL, &found) != 0) {
            code = cli_fail(plan->command->name, CLI_INPUT, "%s: nothing matches", path);
        }
        for (size_t i = 0; i < found.gl_pathc && code == CLI_OK; ++i) {
            code = add_input(plan, found.gl_pathv[i], true);
        }
        globfree(&found);
        return code;
    }
    if (exists && S_ISDIR(info.st_mode)) {
        return add_folder(plan, path);
    }
    if (is_manifest(path)) {
        return batch_read_manifest(plan, path);
    }
    return from_glob && !scene_named_like_one(path) ? CLI_OK
                                                    : add_file(plan, path, batch_base_name(path));
}

static int by_file(const void *a, const void *b) {
    const batch_job *left = a, *right = b;
    const int order = strcmp(left->real, right->real);
    return order != 0 ? order : strcmp(left->id, right->id);
}

// A file that was found twice is converted once; lines of manifests are taken as they are.
static void drop_repeated_files(batch_plan *plan) {
    size_t kept = 0;
    qsort(plan->jobs, plan->count, sizeof(*plan->jobs), by_file);
    for (size_t i = 0; i < plan->count; ++i) {
        batch_job *job = &plan->jobs[i];
        const batch_job *before = kept > 0 ? &plan->jobs[kept - 1] : NULL;
        if (before != NULL && job->entry == NULL && before->entry == NULL &&
            strcmp(job->real, before->real) == 0) {
            batch_job_free(job);
        } else {
            plan->jobs[kept++] = *job;
        }
    }
    plan->count = kept;
}

// Every shard_count-th garment, so that neighbours, which are often alike, are spread.
static void keep_shard(batch_plan *plan) {
    size_t kept = 0;
    for (size_t i = 0; i < plan->count; ++i) {
        if (i % plan->shard_count == plan->shard - 1) {
            plan->jobs[kept++] = plan->jobs[i];
        } else {
            batch_job_free(&plan->jobs[i]);
        }
    }
    plan->count = kept;
}

// "2/5": the second of five.
static bool read_shard(const char *text, unsigned *shard, unsigned *count) {
    char *slash, *end;
    const unsigned long number = strtoul(text, &slash, 10);
    if (*slash != '/' || strspn(text, "0123456789/") != strlen(text)) {
        return false;
    }
    const unsigned long of = strtoul(slash + 1, &end, 10);
    *shard = (unsigned)number;
    *count = (unsigned)of;
    return *end == '\0' && number >= 1 && number <= of && of <= 999999999;
}

static int take_shard(batch_plan *plan) {
    const char *text = plan->arguments->shard;
    plan->shard = plan->shard_count = 1;
    if (text == NULL || read_shard(text, &plan->shard, &plan->shard_count)) {
        return CLI_OK;
    }
    return cli_fail(plan->command->name, CLI_USAGE,
                    "--shard: \"%s\" is no part of a whole, such as 2/5", text);
}

int batch_plan_make(batch_plan *plan) {
    int code = take_shard(plan);
    for (size_t i = 0; i < plan->arguments->input_count && code == CLI_OK; ++i) {
        code = add_input(plan, plan->arguments->inputs[i], false);
    }
    if (code == CLI_OK && plan->count == 0) {
        code = cli_fail(plan->command->name, CLI_INPUT, "%s: no mesh file is there",
                        plan->arguments->inputs[0]);
    }
    if (code == CLI_OK) {
        drop_repeated_files(plan);
        code = batch_plan_tell_apart(plan);
    }
    if (code == CLI_OK) {
        keep_shard(plan);
    }
    return code;
}
