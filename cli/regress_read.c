// Measures of many garments: from the reports in a folder, from a table, to a table.
#define _DEFAULT_SOURCE // fts
#define _POSIX_C_SOURCE 200809L
#include "regress.h"

#include <errno.h>
#include <fts.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

// Tolerances are wide enough for another compiler, and for measures that rest on samples.
#define MEASURE(name)                                                                              \
#name, { "measures", #name }
const regress_measure regress_measures[REGRESS_MEASURES] = {
    {MEASURE(vertices), WORSE_IF_CHANGED, 0.0, 0.0},
    {MEASURE(components), WORSE_IF_CHANGED, 0.0, 0.0},
    {MEASURE(boundary_loops), WORSE_IF_CHANGED, 0.0, 0.0},
    {MEASURE(nonmanifold_edges), WORSE_IF_HIGHER, 0.0, 0.0},
    {MEASURE(nonmanifold_vertices), WORSE_IF_HIGHER, 0.0, 0.0},
    {MEASURE(self_intersections), WORSE_IF_HIGHER, 0.0, 0.0},
    {MEASURE(doubled_area), WORSE_IF_HIGHER, 2e-3, 0.0},
    {MEASURE(doubled_layers), WORSE_IF_HIGHER, 2e-3, 0.0},
    {MEASURE(hausdorff), WORSE_IF_HIGHER, 2e-3, 0.05},
    {MEASURE(boundary_to_opening_mean), WORSE_IF_HIGHER, 2e-3, 0.05},
    {MEASURE(opening_to_boundary_mean), WORSE_IF_HIGHER, 2e-3, 0.05},
    {MEASURE(min_angle_mean), WORSE_IF_LOWER, 0.5, 0.0},
    {MEASURE(min_angle_worst), WORSE_IF_LOWER, 1.0, 0.0},
    {MEASURE(edge_ratio_mean), WORSE_IF_LOWER, 0.01, 0.0},
    {MEASURE(aspect_ratio_mean), WORSE_IF_LOWER, 0.01, 0.0},
    {MEASURE(radius_ratio_mean), WORSE_IF_LOWER, 0.01, 0.0},
    {"label_objective", {"label", "objective"}, NEVER_WORSE, 1e-6, 1e-4},
    {"label_gap", {"label", "gap"}, WORSE_IF_HIGHER, 1e-6, 0.0},
    {"skin_loss_after", {"losses", "after", "total"}, WORSE_IF_HIGHER, 0.0, 0.05},
};

size_t regress_find(const char *name, size_t length) {
    size_t k = 0;
    while (k < REGRESS_MEASURES && (strncmp(regress_measures[k].name, name, length) != 0 ||
                                    regress_measures[k].name[length] != '\0')) {
        ++k;
    }
    return k;
}

void regress_free(regress_results *results) {
    for (size_t i = 0; i < results->count; ++i) {
        free(results->garments[i].name);
    }
    free(results->garments);
    *results = (regress_results){0};
}

static int fail_memory(const cli_command *command) {
    return cli_fail(command->name, CLI_LIMIT, "memory ran out");
}

// Appends a garment without values; NULL when memory ran out.
static regress_garment *add(regress_results *results, const char *name, size_t length) {
    if (results->count == results->capacity) {
        const size_t capacity = 2 * results->capacity + 16;
        regress_garment *grown = realloc(results->garments, capacity * sizeof(*grown));
        if (grown == NULL) {
            return NULL;
        }
        results->garments = grown;
        results->capacity = capacity;
    }
    regress_garment *garment = &results->garments[results->count];
    garment->name = strndup(name, length);
    for (size_t k = 0; k < REGRESS_MEASURES; ++k) {
        garment->values[k] = NAN;
    }
    results->count += garment->name != NULL;
    return garment->name != NULL ? garment : NULL;
}

// ---- reports ------------------------------------------------------------------------------------

static const cJSON *look_up(const cJSON *report, const char *const path[3]) {
    for (size_t i = 0; i < 3 && path[i] != NULL; ++i) {
        report = cJSON_GetObjectItemCaseSensitive(report, path[i]);
    }
    return report;
}

// Other JSON files are no reports: they are passed over.
static int read_report(const cli_command *command, const char *path, regress_results *results) {
    char *text;
    size_t size;
    const int error = cli_read_file(path, &text, &size);
    if (error != 0) {
        return cli_fail(command->name, CLI_INPUT, "%s: %s", path, strerror(error));
    }
    cJSON *report = cJSON_Parse(text);
    free(text);
    const char *name = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(report, "name"));
    int code = CLI_OK;
    if (name != NULL && cJSON_HasObjectItem(report, "measures")) {
        regress_garment *garment = add(results, name, strlen(name));
        for (size_t k = 0; k < REGRESS_MEASURES && garment != NULL; ++k) {
            garment->values[k] = cJSON_GetNumberValue(look_up(report, regress_measures[k].path));
        }
        code = garment != NULL ? CLI_OK : fail_memory(command);
    }
    cJSON_Delete(report);
    return code;
}

static int read_folder(const cli_command *command, const char *path, regress_results *results) {
    char *roots[] = {strdup(path), NULL};
    FTS *walk = roots[0] != NULL ? fts_open(roots, FTS_LOGICAL | FTS_NOCHDIR, NULL) : NULL;
    int code = walk != NULL ? CLI_OK : fail_memory(command);
    FTSENT *entry;
    while (code == CLI_OK && (entry = fts_read(walk)) != NULL) {
        const char *dot = strrchr(entry->fts_name, '.');
        if (entry->fts_info == FTS_D && entry->fts_level > 0 && entry->fts_name[0] == '.') {
            (void)fts_set(walk, entry, FTS_SKIP);
        } else if (entry->fts_info == FTS_F && dot != NULL && strcmp(dot, ".json") == 0) {
            code = read_report(command, entry->fts_path, results);
        } else if (entry->fts_info == FTS_DNR || entry->fts_info == FTS_ERR) {
            code = cli_fail(command->name, CLI_INPUT, "%s: %s", entry->fts_path,
                            strerror(entry->fts_errno));
        }
    }
    if (walk != NULL) {
        fts_close(walk);
    }
    free(roots[0]);
    return code;
}

// ---- tables -------------------------------------------------------------------------------------

enum { MAXIMUM_COLUMNS = 64 };

// The measure of every column behind the first; other columns are passed over.
static size_t read_head(const char *line, size_t columns[MAXIMUM_COLUMNS]) {
    size_t count = 0, known = 0;
    for (const char *at = strchr(line, '\t'); at != NULL && count < MAXIMUM_COLUMNS;
         at = strchr(at + 1, '\t')) {
        columns[count] = regress_find(at + 1, strcspn(at + 1, "\t\r\n"));
        known += columns[count++] < REGRESS_MEASURES;
    }
    return known > 0 ? count : 0;
}

static bool read_row(const char *line, const size_t *columns, size_t count,
                     regress_garment *garment) {
    const char *at = line + strcspn(line, "\t\r\n");
    for (size_t i = 0; i < count; ++i) {
        char *end;
        if (*at != '\t') {
            return false;
        }
        const double value = strtod(at + 1, &end);
        if (end == at + 1 || strchr("\t\r\n", *end) == NULL) {
            return false;
        }
        if (columns[i] < REGRESS_MEASURES) {
            garment->values[columns[i]] = value;
        }
        at = end;
    }
    return *at != '\t';
}

static int read_table(const cli_command *command, const char *path, regress_results *results) {
    FILE *file = fopen(path, "r");
    if (file == NULL) {
        return cli_fail(command->name, CLI_INPUT, "%s: %s", path, strerror(errno));
    }
    char *line = NULL;
    size_t size = 0, number = 0, columns[MAXIMUM_COLUMNS], count = 0;
    int code = CLI_OK;
    while (code == CLI_OK && getline(&line, &size, file) >= 0) {
        ++number;
        if (number == 1) {
            count = line[0] == '#' ? read_head(line, columns) : 0;
            code = count > 0 ? CLI_OK
                             : cli_fail(command->name, CLI_INPUT,
                                        "%s: this is no folder, and no table of measures", path);
        } else if (line[0] != '#' && line[strspn(line, " \t\r\n")] != '\0') {
            regress_garment *garment = add(results, line, strcspn(line, "\t\r\n"));
            if (garment == NULL) {
                code = fail_memory(command);
            } else if (!read_row(line, columns, count, garment)) {
                code = cli_fail(command->name, CLI_INPUT, "%s:%zu: %zu numbers must follow", path,
                                number, count);
            }
        }
    }
    free(line);
    fclose(file);
    return code;
}

void regress_print(const regress_results *results) {
    printf("# garment");
    for (size_t k = 0; k < REGRESS_MEASURES; ++k) {
        printf("\t%s", regress_measures[k].name);
    }
    for (size_t i = 0; i < results->count; ++i) {
        printf("\n%s", results->garments[i].name);
        for (size_t k = 0; k < REGRESS_MEASURES; ++k) {
            printf("\t%.7g", results->garments[i].values[k]);
        }
    }
    printf("\n");
}

// ---- either -------------------------------------------------------------------------------------

static int by_name(const void *a, const void *b) {
    return strcmp(((const regress_garment *)a)->name, ((const regress_garment *)b)->name);
}

int regress_read(const cli_command *command, const char *path, regress_results *results) {
    struct stat info;
    const bool folder = stat(path, &info) == 0 && S_ISDIR(info.st_mode);
    int code = folder ? read_folder(command, path, results) : read_table(command, path, results);
    if (code == CLI_OK && results->count == 0) {
        code = cli_fail(command->name, CLI_INPUT, "%s: no report of a garment is there", path);
    }
    if (code == CLI_OK) {
        qsort(results->garments, results->count, sizeof(*results->garments), by_name);
    }
    for (size_t i = 1; i < results->count && code == CLI_OK; ++i) {
        if (by_name(&results->garments[i - 1], &results->garments[i]) == 0) {
            code = cli_fail(command->name, CLI_INPUT, "%s: the garment %s is there twice", path,
                            results->garments[i].name);
        }
    }
    return code;
}
