// Manifests: one JSON object per line, a garment each.
//
// {"id": "cape", "path": "knight.glb", "mesh": ["*Cape*"], "options": {"vertices": 64}}
// Only path is needed; it counts from the manifest's folder.
#define _POSIX_C_SOURCE 200809L
#include "batch.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct manifest_line {
    batch_plan *plan;
    const char *manifest;
    size_t number;
    cJSON *object;
} manifest_line;

static int fail_line(const manifest_line *line, const char *problem, const char *detail) {
    return cli_fail(line->plan->command->name, CLI_USAGE, "%s:%zu: %s%s", line->manifest,
                    line->number, problem, detail);
}

// Text of a member; NULL when it is missing, or no text (then with a message).
static const char *get_text(const manifest_line *line, const char *name, int *code) {
    const cJSON *item = cJSON_GetObjectItemCaseSensitive(line->object, name);
    if (item == NULL) {
        return NULL;
    }
    const char *text = cJSON_GetStringValue(item);
    if (text == NULL || text[0] == '\0') {
        *code = fail_line(line, name, " must be a text");
        return NULL;
    }
    return text;
}

static int check_names(const manifest_line *line) {
    static const char *const known[] = {"id", "path", "mesh", "options"};
    enum { known_count = sizeof(known) / sizeof(known[0]) };
    const cJSON *item;
    cJSON_ArrayForEach(item, line->object) {
        size_t k = 0;
        while (k < known_count && strcmp(item->string, known[k]) != 0) {
            ++k;
        }
        if (k == known_count) {
            return fail_line(line, "id, path, mesh and options are known here, but not ",
                             item->string);
        }
    }
    return CLI_OK;
}

// "mesh": a glob or a list of globs, in place of those of the command line.
static int take_mesh(const manifest_line *line, batch_job *job) {
    const cJSON *mesh = cJSON_GetObjectItemCaseSensitive(line->object, "mesh");
    if (mesh == NULL) {
        return CLI_OK;
    }
    const size_t count = cJSON_IsArray(mesh) ? (size_t)cJSON_GetArraySize(mesh) : 1;
    job->patterns = calloc(count + 1, sizeof(*job->patterns));
    if (job->patterns == NULL) {
        return cli_fail(line->plan->command->name, CLI_LIMIT, "memory ran out");
    }
    for (size_t i = 0; i < count; ++i) {
        job->patterns[i] =
            cJSON_GetStringValue(cJSON_IsArray(mesh) ? cJSON_GetArrayItem(mesh, (int)i) : mesh);
        if (job->patterns[i] == NULL || job->patterns[i][0] == '\0') {
            return fail_line(line, "mesh must be a text or a list of texts", "");
        }
    }
    job->arguments.patterns = job->patterns;
    job->arguments.pattern_count = count;
    return CLI_OK;
}

// "options": as in an options file; they override those of the command line.
static int take_options(const manifest_line *line, batch_job *job) {
    const cJSON *options = cJSON_GetObjectItemCaseSensitive(line->object, "options");
    if (options == NULL) {
        return CLI_OK;
    }
    const char *command = line->plan->command->name;
    char name[4200];
    snprintf(name, sizeof(name), "%s:%zu", line->manifest, line->number);
    pc_option_group groups[CLI_OPTION_GROUPS];
    cli_option_groups(&job->arguments, groups);
    const pc_context_options serial = {.threads = 1};
    pc_context *context = NULL;
    char *text = cJSON_PrintUnformatted(options);
    int code = CLI_OK;
    if (text == NULL || pc_context_create(&serial, &context) != PC_OK) {
        code = cli_fail(command, CLI_LIMIT, "memory ran out");
    } else if (pc_options_parse(context, text, strlen(text), name, groups, CLI_OPTION_GROUPS) !=
               PC_OK) {
        code = cli_fail(command, CLI_USAGE, "%s", pc_context_error(context)->message);
    }
    cJSON_free(text);
    pc_context_destroy(context);
    return code;
}

static char *resolve(const char *manifest, const char *path) {
    const char *slash = strrchr(manifest, '/');
    const size_t length = path[0] == '/' || slash == NULL ? 0 : (size_t)(slash - manifest) + 1;
    char *result = malloc(length + strlen(path) + 1);
    if (result != NULL) {
        memcpy(result, manifest, length);
        memcpy(result + length, path, strlen(path) + 1);
    }
    return result;
}

static int take_line(manifest_line *line) {
    int code = check_names(line);
    const char *path = get_text(line, "path", &code), *id = get_text(line, "id", &code);
    if (code == CLI_OK && path == NULL) {
        code = fail_line(line, "path is missing", "");
    }
    if (code != CLI_OK) {
        return code;
    }
    char *resolved = resolve(line->manifest, path);
    const char *slash = strrchr(path, '/');
    batch_job *job = resolved != NULL ? batch_plan_add(line->plan, resolved,
                                                       slash != NULL ? slash + 1 : path, id)
                                      : NULL;
    free(resolved);
    if (job == NULL) {
        return cli_fail(line->plan->command->name, CLI_LIMIT, "memory ran out");
    }
    job->manifest = line->manifest;
    job->line = line->number;
    job->entry = line->object;
    line->object = NULL; // the job owns it
    const manifest_line taken = {line->plan, line->manifest, line->number, job->entry};
    code = take_mesh(&taken, job);
    return code == CLI_OK ? take_options(&taken, job) : code;
}

static bool is_blank(const char *text) { return text[strspn(text, " \t\r\n")] == '\0'; }

int batch_read_manifest(batch_plan *plan, const char *path) {
    FILE *file = fopen(path, "r");
    if (file == NULL) {
        return cli_fail(plan->command->name, CLI_INPUT, "%s: %s", path, strerror(errno));
    }
    char *text = NULL;
    size_t size = 0;
    int code = CLI_OK;
    manifest_line line = {.plan = plan, .manifest = path};
    while (getline(&text, &size, file) >= 0) {
        ++line.number;
        if (is_blank(text)) {
            continue;
        }
        line.object = cJSON_ParseWithOpts(text, NULL, true);
        const int result = !cJSON_IsObject(line.object)
                               ? fail_line(&line, "this is no JSON object", "")
                               : take_line(&line);
        cJSON_Delete(line.object);
        line.object = NULL;
        code = result != CLI_OK ? result : code;
    }
    if (code == CLI_OK && ferror(file)) {
        code = cli_fail(plan->command->name, CLI_INPUT, "%s: %s", path, strerror(errno));
    }
    free(text);
    fclose(file);
    return code;
}
