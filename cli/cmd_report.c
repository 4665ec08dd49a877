// report: the reports and pictures of a folder -> one HTML page that needs nothing else.
//
// The page (page.html) draws everything itself from the JSON that is put between its two halves, so
// that no text of a garment ever becomes markup.
#define _POSIX_C_SOURCE 200809L
#include <dirent.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "page.h"
#include "print.h"
#include "thumbnail.h"

enum {
    DEEPEST_FOLDER = 8,
    LARGEST_JSON = 64 << 20,
    LARGEST_LOG = 64 << 10,
    LARGEST_PICTURE = 64 << 20,
    // Pictures are put in as they are up to this sum, and as thumbnails of so many pixels beyond.
    WHOLE_PICTURES = 24 << 20,
    THUMBNAIL_PIXELS = 120000000,
    WIDEST_THUMBNAIL = 960
};

typedef enum page_kind { KIND_REPORT, KIND_RECORD, KIND_BATCH, KIND_COUNT } page_kind;

static const char *const kind_names[KIND_COUNT] = {"report", "record", "batch"};

typedef struct page_writer {
    const cli_command *command;
    const char *folder;
    FILE *stream;
    char **paths; // of JSON files, from the folder on
    size_t path_count, path_capacity;
    size_t picture_count;
    uint64_t picture_bytes;
    uint32_t thumbnail_width; // 0: whole pictures
    size_t file_count;        // in the page
} page_writer;

static int fail_memory(const page_writer *w) {
    return cli_fail(w->command->name, CLI_FAILED, "memory ran out");
}

// ---- files --------------------------------------------------------------------------------------

// "FOLDER/pathEXTENSION", where the first `length` bytes of the path are taken; to be freed.
static char *full_path(const page_writer *w, const char *path, size_t length,
                       const char *extension) {
    const size_t size = strlen(w->folder) + length + strlen(extension) + 2;
    char *full = malloc(size);
    if (full != NULL) {
        snprintf(full, size, "%s/%.*s%s", w->folder, (int)length, path, extension);
    }
    return full;
}

// The bytes of a file and a zero behind them, to be freed; NULL when it cannot be read, is larger
// than `limit` or no file at all.
static char *read_whole(const char *path, size_t limit, size_t *size) {
    FILE *file = path != NULL ? fopen(path, "rb") : NULL;
    struct stat status;
    char *bytes = NULL;
    if (file != NULL && fstat(fileno(file), &status) == 0 && S_ISREG(status.st_mode) &&
        (uint64_t)status.st_size <= limit) {
        bytes = malloc((size_t)status.st_size + 1);
    }
    if (bytes != NULL) {
        *size = fread(bytes, 1, (size_t)status.st_size, file);
        bytes[*size] = '\0';
    }
    if (file != NULL) {
        fclose(file);
    }
    return bytes;
}

// The file that belongs to the JSON file `path` and ends in `extension` in its place.
static char *read_beside(const page_writer *w, const char *path, const char *own,
                         const char *extension, size_t limit, size_t *size) {
    char *full = full_path(w, path, strlen(path) - strlen(own), extension);
    char *bytes = read_whole(full, limit, size);
    free(full);
    return bytes;
}

static bool ends_with(const char *text, const char *end) {
    const size_t a = strlen(text), b = strlen(end);
    return a > b && strcmp(text + a - b, end) == 0;
}

static bool add_path(page_writer *w, char *path) {
    if (w->path_count == w->path_capacity) {
        const size_t capacity = 2 * w->path_capacity + 64;
        char **grown = realloc(w->paths, capacity * sizeof(*grown));
        if (grown == NULL) {
            return false;
        }
        w->paths = grown;
        w->path_capacity = capacity;
    }
    w->paths[w->path_count++] = path;
    return true;
}

// Collects the JSON files in `relative` ("" or "a/b/") and the folders in it. Hidden ones are work
// in progress.
static int collect(page_writer *w, const char *relative, int depth) {
    char *full = full_path(w, relative, strlen(relative), "");
    DIR *directory = full != NULL ? opendir(full) : NULL;
    if (directory == NULL) {
        const int code =
            full == NULL ? fail_memory(w)
                         : cli_fail(w->command->name, CLI_INPUT, "%s: %s", full, strerror(errno));
        free(full);
        return code;
    }
    int code = CLI_OK;
    for (const struct dirent *entry; code == CLI_OK && (entry = readdir(directory)) != NULL;) {
        if (entry->d_name[0] == '.') {
            continue;
        }
        const size_t size = strlen(relative) + strlen(entry->d_name) + 2;
        char *path = malloc(size);
        struct stat status;
        if (path == NULL) {
            code = fail_memory(w);
            continue;
        }
        const bool known = fstatat(dirfd(directory), entry->d_name, &status, 0) == 0;
        if (known && S_ISDIR(status.st_mode) && depth < DEEPEST_FOLDER) {
            snprintf(path, size, "%s%s/", relative, entry->d_name);
            code = collect(w, path, depth + 1);
            free(path);
        } else if (known && S_ISREG(status.st_mode) && ends_with(entry->d_name, ".json")) {
            snprintf(path, size, "%s%s", relative, entry->d_name);
            if (!add_path(w, path)) {
                free(path);
                code = fail_memory(w);
            }
        } else {
            free(path);
        }
    }
    closedir(directory);
    free(full);
    return code;
}

static int compare_paths(const void *a, const void *b) {
    return strcmp(*(char *const *)a, *(char *const *)b);
}

// Pictures lie beside the JSON file of the same name.
static void measure_pictures(page_writer *w) {
    static const char *const extensions[] = {".png", ".strip.png"};
    for (size_t i = 0; i < w->path_count; ++i) {
        for (size_t e = 0; e < 2; ++e) {
            const size_t length = strlen(w->paths[i]) - strlen(".json");
            char *full = full_path(w, w->paths[i], length, extensions[e]);
            struct stat status;
            if (full != NULL && stat(full, &status) == 0) {
                w->picture_bytes += (uint64_t)status.st_size;
                w->picture_count += e == 0; // strips are too wide for thumbnails
            }
            free(full);
        }
    }
    if (w->picture_bytes > WHOLE_PICTURES) {
        const double width = sqrt(THUMBNAIL_PIXELS / (double)w->picture_count);
        w->thumbnail_width = width < WIDEST_THUMBNAIL ? (uint32_t)width : WIDEST_THUMBNAIL;
    }
}

// ---- JSON inside of HTML ------------------------------------------------------------------------

// Writes JSON text so that nothing in it ends the script element around it.
static void put_json(const page_writer *w, const char *text) {
    for (const char *at = text; *at != '\0'; ++at) {
        if (*at == '<') {
            fputs("\\u003c", w->stream);
        } else {
            putc(*at, w->stream);
        }
    }
}

// Writes what a cJSON tree holds and deletes it; false when memory ran out.
static bool put_tree(const page_writer *w, cJSON *tree) {
    char *text = tree != NULL ? cJSON_PrintUnformatted(tree) : NULL;
    if (text != NULL) {
        put_json(w, text);
    }
    cJSON_free(text);
    cJSON_Delete(tree);
    return text != NULL;
}

// Writes ,"name":"data:..."
static void put_picture(const page_writer *w, const char *name, const uint8_t *bytes, size_t size) {
    static const char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    fprintf(w->stream, ",\"%s\":\"data:image/png;base64,", name);
    for (size_t i = 0; i < size; i += 3) {
        const uint32_t left = size - i < 3 ? (uint32_t)(size - i) : 3;
        uint32_t group = 0;
        for (uint32_t k = 0; k < 3; ++k) {
            group = group << 8 | (k < left ? bytes[i + k] : 0u);
        }
        for (uint32_t k = 0; k < 4; ++k) {
            putc(k <= left ? digits[group >> (18 - 6 * k) & 63] : '=', w->stream);
        }
    }
    putc('"', w->stream);
}

// What the page calls the measures, and how it sorts them.
static void add_fields(cJSON *parent, const char *name, const pc_record *record) {
    cJSON *fields = json_object(parent, name);
    for (size_t i = 0; i < record->field_count; ++i) {
        cJSON *field = json_object(fields, record->fields[i].name);
        json_text(field, "help", record->fields[i].help);
        json_text(field, "unit", record->fields[i].unit);
    }
}

static bool put_fields(const page_writer *w) {
    cJSON *fields = cJSON_CreateObject();
    add_fields(fields, "measures", &pc_measures_record);
    cJSON *stages = json_array(fields, "stages");
    for (pc_stage stage = 0; stage < PC_STAGE_COUNT; ++stage) {
        const pc_stage_info *info = pc_stage_describe(stage);
        cJSON *object = cJSON_CreateObject();
        json_text(object, "name", info->name);
        json_text(object, "summary", info->summary);
        add_fields(object, "options", info->options);
        cJSON_AddItemToArray(stages, object);
    }
    return put_tree(w, fields);
}

// ---- the page -----------------------------------------------------------------------------------

static page_kind kind_of(const cJSON *json) {
    if (cJSON_HasObjectItem(json, "stage_count") &&
        cJSON_IsObject(cJSON_GetObjectItem(json, "stages"))) {
        return KIND_REPORT;
    }
    if (cJSON_HasObjectItem(json, "outcome") && cJSON_HasObjectItem(json, "id")) {
        return KIND_RECORD;
    }
    return cJSON_IsArray(cJSON_GetObjectItem(json, "garments")) &&
                   cJSON_HasObjectItem(json, "counts")
               ? KIND_BATCH
               : KIND_COUNT;
}

static void put_pictures(const page_writer *w, const char *path) {
    size_t size = 0, small_size = 0;
    char *sheet = read_beside(w, path, ".json", ".png", LARGEST_PICTURE, &size);
    uint8_t *small = NULL;
    if (sheet != NULL && w->thumbnail_width == 0) {
        put_picture(w, "sheet", (const uint8_t *)sheet, size);
    } else if (sheet != NULL && thumbnail_png((const uint8_t *)sheet, size, w->thumbnail_width,
                                              &small, &small_size)) {
        put_picture(w, "sheet", small, small_size);
    }
    free(small);
    free(sheet);
    char *strip = w->thumbnail_width == 0
                      ? read_beside(w, path, ".json", ".strip.png", LARGEST_PICTURE, &size)
                      : NULL;
    if (strip != NULL) {
        put_picture(w, "strip", (const uint8_t *)strip, size);
    }
    free(strip);
}

// Writes ,"log":"..." for what a garment of a batch had to say.
static bool put_log(const page_writer *w, const char *path) {
    static const char own[] = ".batch.json";
    size_t size = 0;
    char *log = ends_with(path, own) ? read_beside(w, path, own, ".log", LARGEST_LOG, &size) : NULL;
    bool good = true;
    if (log != NULL) {
        fputs(",\"log\":", w->stream);
        good = put_tree(w, cJSON_CreateString(log));
    }
    free(log);
    return good;
}

// Writes one JSON file and what lies beside it, when it is one of ours.
static int put_file(page_writer *w, const char *path) {
    size_t size = 0;
    char *text = read_beside(w, path, "", "", LARGEST_JSON, &size);
    cJSON *json = text != NULL ? cJSON_ParseWithOpts(text, NULL, true) : NULL;
    const page_kind kind = kind_of(json);
    cJSON_Delete(json);
    bool good = true;
    if (kind != KIND_COUNT) {
        fprintf(w->stream, "%s{\"kind\":\"%s\",\"path\":", w->file_count++ == 0 ? "\n" : ",\n",
                kind_names[kind]);
        good = put_tree(w, cJSON_CreateString(path));
        cJSON_Minify(text);
        fputs(",\"content\":", w->stream);
        put_json(w, text);
        if (kind == KIND_RECORD) {
            good = put_log(w, path) && good;
        } else if (kind == KIND_REPORT) {
            put_pictures(w, path);
        }
        putc('}', w->stream);
    }
    free(text);
    return good ? CLI_OK : fail_memory(w);
}

static int put_page(page_writer *w, bool links) {
    static const char mark[] = "{\"files\":[]}";
    const char *data = strstr(cli_page, mark);
    fwrite(cli_page, 1, (size_t)(data - cli_page), w->stream);
    cJSON *head = cJSON_CreateObject();
    json_text(head, "folder", w->folder);
    json_text(head, "version", pc_version());
    cJSON_AddItemToObject(head, "links", cJSON_CreateBool(links));
    cJSON_AddItemToObject(head, "thumbnails", cJSON_CreateBool(w->thumbnail_width != 0));
    fputs("{\"head\":", w->stream);
    bool good = put_tree(w, head);
    fputs(",\"fields\":", w->stream);
    good = good && put_fields(w);
    int code = good ? CLI_OK : fail_memory(w);
    fputs(",\"files\":[", w->stream);
    for (size_t i = 0; i < w->path_count && code == CLI_OK; ++i) {
        code =
            cli_interrupted() ? cli_fail_interrupted(w->command->name) : put_file(w, w->paths[i]);
    }
    fputs("]}", w->stream);
    fputs(data + sizeof(mark) - 1, w->stream);
    if (code == CLI_OK && w->file_count == 0) {
        code =
            cli_fail(w->command->name, CLI_INPUT,
                     "%s: no report of 'proxycloth build' or 'batch' is in this folder", w->folder);
    }
    return code;
}

// The page is written beside its place and renamed.
static int write_page(page_writer *w, const char *file, bool links) {
    const char *slash = strrchr(file, '/');
    const char *name = slash != NULL ? slash + 1 : file;
    char folder[4096] = ".";
    if (slash != NULL) {
        const int length = slash > file ? (int)(slash - file) : 1;
        snprintf(folder, sizeof(folder), "%.*s", length, file);
    }
    cli_output output;
    int code = cli_output_begin(w->command, folder, &output);
    char *path = code == CLI_OK ? cli_output_add(&output, name, "") : NULL;
    w->stream = path != NULL ? fopen(path, "wb") : NULL;
    if (code == CLI_OK && w->stream == NULL) {
        code = cli_fail(w->command->name, CLI_OUTPUT, "%s: the page cannot be written", file);
    }
    if (w->stream != NULL) {
        code = put_page(w, links);
        const bool written = ferror(w->stream) == 0;
        if ((fclose(w->stream) != 0 || !written) && code == CLI_OK) {
            code = cli_fail(w->command->name, CLI_OUTPUT, "%s: the page cannot be written", file);
        }
    }
    if (code == CLI_OK) {
        code = cli_output_commit(w->command, &output);
    }
    free(path);
    cli_output_end(&output);
    return code;
}

int cli_write_page(const cli_command *command, const char *folder, const char *file) {
    page_writer w = {.command = command, .folder = folder};
    char *standard = full_path(&w, "report.html", strlen("report.html"), "");
    int code = standard != NULL ? collect(&w, "", 0) : fail_memory(&w);
    if (code == CLI_OK) {
        if (w.path_count > 0) {
            qsort(w.paths, w.path_count, sizeof(*w.paths), compare_paths);
        }
        measure_pictures(&w);
        code = write_page(&w, file != NULL ? file : standard, file == NULL);
    }
    for (size_t i = 0; i < w.path_count; ++i) {
        free(w.paths[i]);
    }
    free(w.paths);
    free(standard);
    return code;
}

int cli_run_report(const cli_command *command, cli_arguments *arguments) {
    cli_catch_signals();
    return cli_write_page(command, arguments->inputs[0], arguments->output);
}
