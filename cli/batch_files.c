// The folders of a batch: its work folder, and how garments get from there to their places.
#define _POSIX_C_SOURCE 200809L
#include "batch.h"

#include <dirent.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static int fail_workspace(const cli_command *command, const char *path) {
    return cli_fail(command->name, CLI_OUTPUT, "%s: %s", path != NULL ? path : "work folder",
                    strerror(errno));
}

int batch_workspace_begin(const cli_command *command, const cli_output *output) {
    char *garments = batch_path(output->folder, "garments", "");
    const int code = garments != NULL && (mkdir(garments, 0777) == 0 || errno == EEXIST)
                         ? CLI_OK
                         : fail_workspace(command, garments);
    free(garments);
    return code;
}

void batch_workspace_end(const cli_output *output) {
    if (output->staging != NULL) {
        cli_remove_tree(output->staging, false);
        char *garments = batch_path(output->folder, "garments", "");
        if (garments != NULL) {
            (void)rmdir(garments); // only when nothing arrived
        }
        free(garments);
    }
}

// Notes the results in a folder, by their reports, sorted. Removes what a child staged that was
// killed.
static bool take_stock(const char *folder, const batch_job *job) {
    cJSON *results = cJSON_GetObjectItemCaseSensitive(job->record, "results");
    struct dirent **entries = NULL;
    const int count = scandir(folder, &entries, NULL, alphasort);
    for (int i = 0; i < count; ++i) {
        char *dot = strrchr(entries[i]->d_name, '.');
        if (dot != NULL && strcmp(dot, ".json") == 0) {
            *dot = '\0';
            cJSON_AddItemToArray(results, cJSON_CreateString(entries[i]->d_name));
        } else if (cli_is_staging(entries[i]->d_name)) {
            char *path = batch_path(folder, entries[i]->d_name, "");
            if (path != NULL) {
                cli_remove_tree(path, true);
            }
            free(path);
        }
        free(entries[i]);
    }
    free(entries);
    return count >= 0 && results != NULL;
}

static bool write_text(const char *path, const cJSON *json) {
    char *text = cJSON_Print(json);
    FILE *file = text != NULL ? fopen(path, "w") : NULL;
    bool good = file != NULL && fprintf(file, "%s\n", text) > 0;
    good = file != NULL && fclose(file) == 0 && good;
    cJSON_free(text);
    return good;
}

bool batch_blocked(const char *folder, const batch_job *job, char *message, size_t size) {
    char name[512];
    snprintf(name, sizeof(name), "garments/%s", job->id);
    char *path = batch_path(folder, name, "");
    char *record = path != NULL ? batch_path(path, job->id, ".batch.json") : NULL;
    const bool blocked = record == NULL || (access(record, F_OK) != 0 && access(path, F_OK) == 0);
    if (blocked) {
        snprintf(message, size, "%s/%s is in the way and was not made by a batch; move it away",
                 folder, name);
    }
    free(record);
    free(path);
    return blocked;
}

// The paths of a garment on its way.
typedef struct landing {
    char *from;   // WORK/ID
    char *record; // WORK/ID/ID.batch.json
    char *log;    // WORK/ID/ID.log
    char *old;    // WORK/ID.old
    char *to;     // OUT/garments/ID
} landing;

static bool begin_landing(const cli_output *output, const batch_job *job, landing *l) {
    char name[512];
    l->from = batch_path(output->staging, job->id, "");
    l->old = batch_path(output->staging, job->id, ".old");
    snprintf(name, sizeof(name), "garments/%s", job->id);
    l->to = batch_path(output->folder, name, "");
    l->record = l->from != NULL ? batch_path(l->from, job->id, ".batch.json") : NULL;
    l->log = l->from != NULL ? batch_path(l->from, job->id, ".log") : NULL;
    return l->record != NULL && l->log != NULL && l->old != NULL && l->to != NULL;
}

// Results of an earlier run leave with their record; between the two renames the garment has none,
// and would be converted again.
static bool swap(const landing *l, batch_job *job) {
    struct stat info;
    (void)mkdir(l->from, 0777); // where there was no child
    if (stat(l->log, &info) == 0 && info.st_size == 0) {
        (void)unlink(l->log);
    }
    return take_stock(l->from, job) && write_text(l->record, job->record) &&
           (rename(l->to, l->old) == 0 || errno == ENOENT) && rename(l->from, l->to) == 0;
}

int batch_land(const cli_output *output, batch_job *job, char *message, size_t size) {
    landing l = {0};
    int code = CLI_OK;
    if (batch_blocked(output->folder, job, message, size)) {
        code = CLI_OUTPUT;
    } else if (!begin_landing(output, job, &l) || !swap(&l, job)) {
        code = CLI_OUTPUT;
        snprintf(message, size, "%s/garments/%s: %s", output->folder, job->id, strerror(errno));
    }
    if (l.old != NULL) {
        cli_remove_tree(l.old, true);
    }
    free(l.from);
    free(l.record);
    free(l.log);
    free(l.old);
    free(l.to);
    return code;
}

int batch_write_json(const cli_command *command, const cli_output *output, const char *name,
                     const cJSON *json) {
    char *from = batch_path(output->staging, name, ""), *to = batch_path(output->folder, name, "");
    int code = CLI_OK;
    if (from == NULL || to == NULL || !write_text(from, json) || rename(from, to) != 0) {
        code =
            cli_fail(command->name, CLI_OUTPUT, "%s: %s", to != NULL ? to : name, strerror(errno));
    }
    free(from);
    free(to);
    return code;
}
