// The list of a batch's garments, and the ids that name their results.
#define _DEFAULT_SOURCE // realpath
#define _POSIX_C_SOURCE 200809L
#include "batch.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "sha256.h"

enum { ID_SIZE = 96 }; // with what is put behind it a name of an asset

const char *batch_base_name(const char *path) {
    const char *slash = strrchr(path, '/');
    return slash != NULL ? slash + 1 : path;
}

// Letters, digits, ".", "_", "-" and whatever is not ASCII; no leading dot or dash. Never a path.
static char *make_id(const char *name) {
    char id[ID_SIZE];
    cli_clean_text(id, sizeof(id), name);
    for (char *at = id; *at != '\0'; ++at) {
        const unsigned char c = (unsigned char)*at;
        const bool plain = c >= 0x80 || (c >= '0' && c <= '9') || (c >= 'A' && c <= 'Z') ||
                           (c >= 'a' && c <= 'z') || c == '_' || c == '-' || c == '.';
        *at = plain ? *at : '-';
    }
    if (id[0] == '.' || id[0] == '-') {
        id[0] = '_';
    }
    return strdup(id[0] != '\0' ? id : "_");
}

// A name without its extension.
static char *stem_of(const char *name) {
    char *stem = strdup(name);
    const char *base = batch_base_name(name), *dot = strrchr(base, '.');
    if (stem != NULL && dot != NULL && dot != base) {
        stem[dot - name] = '\0';
    }
    return stem;
}

batch_job *batch_plan_add(batch_plan *plan, const char *path, const char *file, const char *id) {
    if (plan->count == plan->capacity) {
        const size_t capacity = 2 * plan->capacity + 16;
        batch_job *grown = realloc(plan->jobs, capacity * sizeof(*grown));
        if (grown == NULL) {
            return NULL;
        }
        plan->jobs = grown;
        plan->capacity = capacity;
    }
    batch_job *job = &plan->jobs[plan->count];
    struct stat info;
    char *stem = id == NULL ? stem_of(file) : NULL;
    *job = (batch_job){.id = id != NULL     ? make_id(id)
                             : stem != NULL ? make_id(stem)
                                            : NULL,
                       .path = strdup(path),
                       .real = realpath(path, NULL),
                       .size = stat(path, &info) == 0 ? (uint64_t)info.st_size : 0,
                       .arguments = *plan->arguments,
                       .named = id != NULL};
    free(stem);
    if (job->real == NULL && job->path != NULL) {
        job->real = strdup(job->path); // a file that is missing fails when its turn comes
    }
    if (job->id == NULL || job->path == NULL || job->real == NULL) {
        free(job->id);
        free(job->path);
        free(job->real);
        return NULL;
    }
    ++plan->count;
    return job;
}

void batch_job_free(batch_job *job) {
    free(job->id);
    free(job->path);
    free(job->real);
    free(job->patterns);
    cJSON_Delete(job->entry);
    cJSON_Delete(job->record);
}

void batch_plan_free(batch_plan *plan) {
    for (size_t i = 0; i < plan->count; ++i) {
        batch_job_free(&plan->jobs[i]);
    }
    free(plan->jobs);
    plan->jobs = NULL;
    plan->count = plan->capacity = 0;
}

static int by_id(const void *a, const void *b) {
    const batch_job *left = a, *right = b;
    const int order = strcmp(left->id, right->id);
    return order != 0                  ? order
           : left->line != right->line ? (left->line > right->line) - (left->line < right->line)
                                       : strcmp(left->real, right->real);
}

// Where a garment comes from, for messages.
static void describe_place(const batch_job *job, char *text, size_t size) {
    if (job->manifest != NULL) {
        snprintf(text, size, "%s:%zu", job->manifest, job->line);
    } else {
        snprintf(text, size, "%s", job->path);
    }
}

int batch_plan_tell_apart(batch_plan *plan) {
    batch_job *jobs = plan->jobs;
    qsort(jobs, plan->count, sizeof(*jobs), by_id);
    for (size_t i = 0; i < plan->count; ++i) {
        jobs[i].shares_id = (i > 0 && strcmp(jobs[i - 1].id, jobs[i].id) == 0) ||
                            (i + 1 < plan->count && strcmp(jobs[i + 1].id, jobs[i].id) == 0);
    }
    for (size_t i = 0; i < plan->count; ++i) {
        if (!jobs[i].shares_id || jobs[i].named) {
            continue;
        }
        sha256 hash;
        char digits[65], id[ID_SIZE + 16];
        sha256_begin(&hash);
        sha256_add(&hash, jobs[i].real, strlen(jobs[i].real));
        sha256_end(&hash, digits);
        snprintf(id, sizeof(id), "%s-%.8s", jobs[i].id, digits);
        char *copy = strdup(id);
        if (copy == NULL) {
            return cli_fail(plan->command->name, CLI_LIMIT, "memory ran out");
        }
        free(jobs[i].id);
        jobs[i].id = copy;
    }
    qsort(jobs, plan->count, sizeof(*jobs), by_id);
    int code = CLI_OK;
    for (size_t i = 1; i < plan->count; ++i) {
        const batch_job *one = &jobs[i - 1], *other = &jobs[i];
        if (strcmp(one->id, other->id) == 0) {
            char place[2][4200];
            describe_place(one, place[0], sizeof(place[0]));
            describe_place(other, place[1], sizeof(place[1]));
            code = cli_fail(plan->command->name, CLI_USAGE,
                            "%s: the id \"%s\" is that of %s too; choose another with \"id\"",
                            place[1], other->id, place[0]);
        }
    }
    return code;
}
