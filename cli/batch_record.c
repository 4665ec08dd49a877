// Records: what a garment was made of, and what became of it. They tell what is up to date.
#define _POSIX_C_SOURCE 200809L
#include "batch.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

#include "print.h"
#include "sha256.h"

enum { RECORD_SCHEMA = 1 };

char *batch_path(const char *folder, const char *name, const char *rest) {
    const size_t size = strlen(folder) + strlen(name) + strlen(rest) + 2;
    char *path = malloc(size);
    if (path != NULL) {
        snprintf(path, size, "%s/%s%s", folder, name, rest);
    }
    return path;
}

// ---- hashes -------------------------------------------------------------------------------------

// Adds the content of a file that the input names, where it can be read: the importer decides
// whether it is needed.
static void add_neighbour(sha256 *hash, const char *input, const char *name, size_t length) {
    const char *slash = strrchr(input, '/');
    const size_t folder = slash != NULL ? (size_t)(slash - input) + 1 : 0;
    char *path = malloc(folder + length + 1), *bytes = NULL;
    size_t size;
    if (path != NULL) {
        memcpy(path, input, folder);
        memcpy(path + folder, name, length);
        path[folder + length] = '\0';
        if (cli_read_file(path, &bytes, &size) == 0) {
            sha256_add(hash, bytes, size);
        }
    }
    free(bytes);
    free(path);
}

// Files beside the input: the buffers of a glTF file, the materials of an OBJ file.
static void add_neighbours(sha256 *hash, const char *path, const char *text) {
    const char *dot = strrchr(path, '.');
    const bool gltf = dot != NULL && strcasecmp(dot, ".gltf") == 0;
    const bool obj = dot != NULL && strcasecmp(dot, ".obj") == 0;
    const char *const word = gltf ? "\"uri\"" : "mtllib ";
    for (const char *at = text; (gltf || obj) && (at = strstr(at, word)) != NULL;) {
        at += strlen(word);
        at += strspn(at, gltf ? " \t\r\n:\"" : " \t");
        const size_t length = strcspn(at, gltf ? "\"" : "\r\n");
        if (length < 4096 && strncmp(at, "data:", 5) != 0) {
            add_neighbour(hash, path, at, length);
        }
        at += length;
    }
}

static int hash_input(const batch_job *job, char text[65], char *message, size_t size) {
    char *bytes;
    size_t count;
    const int error = cli_read_file(job->path, &bytes, &count);
    if (error != 0) {
        snprintf(message, size, "%s: %s", job->path, strerror(error));
        return error == ENOENT || error == EACCES || error == EISDIR || error == ENOTDIR ||
                       error == ELOOP || error == ENAMETOOLONG
                   ? CLI_INPUT
                   : CLI_TRANSIENT;
    }
    sha256 hash;
    sha256_begin(&hash);
    sha256_add(&hash, bytes, count);
    add_neighbours(&hash, job->path, bytes);
    sha256_end(&hash, text);
    free(bytes);
    return CLI_OK;
}

cJSON *batch_options(const cli_arguments *arguments) {
    cli_arguments copy = *arguments;
    pc_option_group groups[CLI_OPTION_GROUPS];
    cli_option_groups(&copy, groups);
    const pc_context_options serial = {.threads = 1};
    pc_context *context = NULL;
    char *text = NULL;
    cJSON *options = NULL;
    if (pc_context_create(&serial, &context) == PC_OK &&
        pc_options_print(context, groups, CLI_OPTION_GROUPS, &text) == PC_OK) {
        options = cJSON_Parse(text);
    }
    pc_release(context, text);
    pc_context_destroy(context);
    return options;
}

// A hash of everything that decides on the bytes of the results, besides the input.
static bool hash_options(const batch_job *job, char text[65]) {
    static const char *const without_effect[] = {"threads", "import_memory", "import_seconds"};
    const cli_arguments *arguments = &job->arguments;
    cJSON *object = batch_options(arguments), *program;
    program = cJSON_GetObjectItemCaseSensitive(object, "program");
    for (size_t i = 0; i < sizeof(without_effect) / sizeof(without_effect[0]); ++i) {
        cJSON_DeleteItemFromObjectCaseSensitive(program, without_effect[i]);
    }
    char *options = object != NULL ? cJSON_PrintUnformatted(object) : NULL;
    cJSON_Delete(object);
    if (options == NULL) {
        return false;
    }
    sha256 hash;
    sha256_begin(&hash);
    sha256_add(&hash, options, strlen(options));
    cJSON_free(options);
    for (size_t i = 0; i < arguments->pattern_count; ++i) {
        sha256_add(&hash, arguments->patterns[i], strlen(arguments->patterns[i]) + 1);
    }
    char *scenario = NULL;
    size_t size;
    if (arguments->scenario != NULL && cli_read_file(arguments->scenario, &scenario, &size) == 0) {
        sha256_add(&hash, scenario, size);
    }
    free(scenario);
    sha256_end(&hash, text);
    return true;
}

int batch_key_of(const batch_job *job, batch_key *key, char *message, size_t size) {
    memset(key, 0, sizeof(*key));
    if (!hash_options(job, key->options)) {
        snprintf(message, size, "memory ran out");
        return CLI_TRANSIENT;
    }
    return hash_input(job, key->input, message, size);
}

// ---- records ------------------------------------------------------------------------------------

bool batch_retryable(int code) { return code == CLI_TRANSIENT || code == CLI_OUTPUT; }

static const char *error_name(int code) {
    switch (code) {
    case CLI_USAGE:
        return "usage";
    case CLI_INPUT:
        return "input";
    case CLI_OUTPUT:
        return "output";
    case CLI_INTERNAL:
        return "internal";
    case CLI_IMPORTER:
        return "importer";
    case CLI_LIMIT:
        return "limit";
    case CLI_TRANSIENT:
        return "transient";
    default:
        return "processing";
    }
}

static cJSON *limits_object(const cli_settings *settings) {
    cJSON *object = cJSON_CreateObject();
    json_number(object, "garment_memory", settings->garment_memory);
    json_number(object, "garment_seconds", settings->garment_seconds);
    json_number(object, "garment_cpu_seconds", settings->garment_cpu_seconds);
    json_number(object, "import_memory", settings->import_memory);
    json_number(object, "import_seconds", settings->import_seconds);
    return object;
}

bool batch_record_make(batch_job *job, const batch_key *key, const batch_ending *ending) {
    static const char *const outcomes[] = {"pending", "done", "failed"};
    cJSON *record = cJSON_CreateObject();
    json_number(record, "schema", RECORD_SCHEMA);
    json_text(record, "id", job->id);
    json_text(record, "path", job->path);
    cJSON *mesh = json_array(record, "mesh");
    for (size_t i = 0; i < job->arguments.pattern_count; ++i) {
        cJSON_AddItemToArray(mesh, cJSON_CreateString(job->arguments.patterns[i]));
    }
    json_text(record, "version", pc_version());
    json_text(record, "input_sha256", key->input);
    json_text(record, "options_sha256", key->options);
    json_text(record, "outcome", outcomes[ending->outcome]);
    json_number(record, "code", ending->code);
    if (ending->outcome == BATCH_FAILED) {
        json_text(record, "error", error_name(ending->code));
        cJSON_AddBoolToObject(record, "retryable", batch_retryable(ending->code));
        json_text(record, "message", ending->message);
    }
    if (ending->outcome == BATCH_FAILED && ending->code == CLI_LIMIT) {
        cJSON_AddItemToObject(record, "limits", limits_object(&job->arguments.settings));
    }
    json_array(record, "results");
    cJSON *timings = json_object(record, "timings");
    json_number(timings, "seconds", ending->seconds);
    json_number(timings, "cpu_seconds", ending->cpu_seconds);
    json_number(timings, "peak_mib", ending->peak_mib);
    cJSON_Delete(job->record);
    job->record = record;
    return record != NULL;
}

cJSON *batch_record_read(const char *folder, const batch_job *job) {
    char name[512];
    snprintf(name, sizeof(name), "garments/%s/%s", job->id, job->id);
    char *path = batch_path(folder, name, ".batch.json"), *text = NULL;
    size_t size;
    cJSON *record = NULL;
    if (path != NULL && cli_read_file(path, &text, &size) == 0) {
        record = cJSON_Parse(text);
    }
    free(text);
    free(path);
    return record;
}

static bool has_text(const cJSON *object, const char *name, const char *text) {
    const char *found = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(object, name));
    return found != NULL && strcmp(found, text) == 0;
}

// Whether every result that the record names still has its files.
static bool has_results(const batch_job *job, const cJSON *record, const char *folder) {
    static const char *const extensions[] = {".glb", ".proxy.obj", ".h5", ".json"};
    const cJSON *results = cJSON_GetObjectItemCaseSensitive(record, "results"), *result;
    bool all = cJSON_GetArraySize(results) > 0;
    cJSON_ArrayForEach(result, results) {
        const char *stem = cJSON_GetStringValue(result);
        for (size_t k = 0; k < sizeof(extensions) / sizeof(extensions[0]) && all; ++k) {
            char name[1024];
            snprintf(name, sizeof(name), "garments/%s/%s", job->id, stem != NULL ? stem : "");
            char *path = batch_path(folder, name, extensions[k]);
            all = path != NULL && access(path, R_OK) == 0;
            free(path);
        }
    }
    return all;
}

bool batch_up_to_date(const batch_job *job, const batch_key *key, const cJSON *record,
                      const char *folder) {
    const cli_settings *settings = &job->arguments.settings;
    if (settings->force || !has_text(record, "version", pc_version()) ||
        !has_text(record, "input_sha256", key->input) ||
        !has_text(record, "options_sha256", key->options)) {
        return false;
    }
    if (has_text(record, "outcome", "done")) {
        return has_results(job, record, folder);
    }
    if (settings->retry_failed ||
        cJSON_IsTrue(cJSON_GetObjectItemCaseSensitive(record, "retryable"))) {
        return false;
    }
    // A failure stays one with the same input and options, but for limits that were changed.
    const cJSON *before = cJSON_GetObjectItemCaseSensitive(record, "limits");
    cJSON *now = limits_object(settings);
    const bool same = before == NULL || cJSON_Compare(before, now, true);
    cJSON_Delete(now);
    return same;
}
