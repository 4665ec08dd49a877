// regress: two sets of results, and what got worse.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "print.h"
#include "regress.h"

// Tolerances are wide enough for another compiler, and for measures that rest on samples.
typedef struct regress_run {
    const cli_command *command;
    bool print_json;
    regress_measure measures[REGRESS_MEASURES]; // with the user's tolerances
    bool ignored[REGRESS_MEASURES];
    cJSON *worse, *missing, *added; // lists of the report
    size_t compared, worse_garments, missing_garments, added_garments;
} regress_run;

// ---- tolerances ---------------------------------------------------------------------------------

static bool take_number(const cJSON *object, const char *name, double *value) {
    const cJSON *item = cJSON_GetObjectItemCaseSensitive(object, name);
    if (item == NULL) {
        *value = 0.0;
        return true;
    }
    *value = cJSON_GetNumberValue(item);
    return *value >= 0.0 && isfinite(*value);
}

static int take_tolerance(regress_run *r, const char *path, const cJSON *item) {
    const size_t k = regress_find(item->string, strlen(item->string));
    if (k == REGRESS_MEASURES) {
        cli_guess guess = {.word = item->string};
        for (size_t i = 0; i < REGRESS_MEASURES; ++i) {
            cli_guess_add(&guess, regress_measures[i].name);
        }
        return cli_fail(r->command->name, CLI_USAGE, "%s: no measure \"%s\"%s%s%s", path,
                        item->string, guess.best[0] != '\0' ? "; did you mean " : "", guess.best,
                        guess.best[0] != '\0' ? "?" : "");
    }
    r->ignored[k] = cJSON_IsNull(item);
    const int members =
        (int)cJSON_HasObjectItem(item, "absolute") + (int)cJSON_HasObjectItem(item, "relative");
    if (!r->ignored[k] && (!cJSON_IsObject(item) || cJSON_GetArraySize(item) != members ||
                           !take_number(item, "absolute", &r->measures[k].absolute) ||
                           !take_number(item, "relative", &r->measures[k].relative))) {
        return cli_fail(r->command->name, CLI_USAGE,
                        "%s: %s must be null, or hold numbers absolute and relative from 0", path,
                        item->string);
    }
    return CLI_OK;
}

static int read_tolerances(regress_run *r, const char *path) {
    char *text;
    size_t size;
    const int error = cli_read_file(path, &text, &size);
    if (error != 0) {
        return cli_fail(r->command->name, CLI_INPUT, "%s: %s", path, strerror(error));
    }
    cJSON *tolerances = cJSON_Parse(text);
    const cJSON *item;
    int code = cJSON_IsObject(tolerances)
                   ? CLI_OK
                   : cli_fail(r->command->name, CLI_USAGE, "%s: this is no JSON object", path);
    cJSON_ArrayForEach(item, tolerances) {
        code = code == CLI_OK ? take_tolerance(r, path, item) : code;
    }
    cJSON_Delete(tolerances);
    free(text);
    return code;
}

// ---- comparison ---------------------------------------------------------------------------------

static double tolerance_of(const regress_measure *measure, double before) {
    return measure->absolute + measure->relative * fabs(before);
}

// A value that is not there is worse.
static bool is_worse(const regress_measure *measure, double before, double now) {
    const double change = now - before, tolerance = tolerance_of(measure, before);
    switch (measure->sense) {
    case WORSE_IF_HIGHER:
        return !(change <= tolerance);
    case WORSE_IF_LOWER:
        return !(change >= -tolerance);
    case WORSE_IF_CHANGED:
        return !(fabs(change) <= tolerance);
    case NEVER_WORSE:
        break;
    }
    return false;
}

static void compare(regress_run *r, const regress_garment *before, const regress_garment *now) {
    bool worse = false;
    for (size_t k = 0; k < REGRESS_MEASURES; ++k) {
        const regress_measure *measure = &r->measures[k];
        if (r->ignored[k] || isnan(before->values[k]) ||
            !is_worse(measure, before->values[k], now->values[k])) {
            continue;
        }
        worse = true;
        const double tolerance = tolerance_of(measure, before->values[k]);
        if (!r->print_json) {
            printf("%s: %s %.6g -> %.6g (tolerance %.2g)\n", now->name, measure->name,
                   before->values[k], now->values[k], tolerance);
            continue;
        }
        cJSON *entry = cJSON_CreateObject();
        json_text(entry, "garment", now->name);
        json_text(entry, "measure", measure->name);
        json_number(entry, "baseline", before->values[k]);
        json_number(entry, "value", now->values[k]);
        json_number(entry, "tolerance", tolerance);
        cJSON_AddItemToArray(r->worse, entry);
    }
    ++r->compared;
    r->worse_garments += worse;
}

static void note_missing(regress_run *r, const char *name) {
    ++r->missing_garments;
    if (!r->print_json) {
        printf("%s: missing\n", name);
    }
    cJSON_AddItemToArray(r->missing, cJSON_CreateString(name));
}

static void note_added(regress_run *r, const char *name) {
    ++r->added_garments;
    cJSON_AddItemToArray(r->added, cJSON_CreateString(name));
}

// Both lists are sorted by name.
static void compare_all(regress_run *r, const regress_results *before, const regress_results *now) {
    size_t i = 0, j = 0;
    while (i < before->count || j < now->count) {
        const int order = i == before->count ? 1
                          : j == now->count
                              ? -1
                              : strcmp(before->garments[i].name, now->garments[j].name);
        if (order == 0) {
            compare(r, &before->garments[i++], &now->garments[j++]);
        } else if (order < 0) {
            note_missing(r, before->garments[i++].name);
        } else {
            note_added(r, now->garments[j++].name);
        }
    }
}

static int conclude(regress_run *r, cJSON *json) {
    const bool good = r->worse_garments == 0 && r->missing_garments == 0;
    int code = CLI_OK;
    if (r->print_json) {
        json_number(json, "compared", (double)r->compared);
        code = json_print(r->command->name, json);
    } else {
        printf("%zu garments compared: %zu worse; %zu missing, %zu new\n", r->compared,
               r->worse_garments, r->missing_garments, r->added_garments);
        cJSON_Delete(json);
    }
    return code == CLI_OK && !good ? CLI_FAILED : code;
}

int cli_run_regress(const cli_command *command, cli_arguments *arguments) {
    regress_run r = {.command = command, .print_json = arguments->settings.json};
    regress_results before = {0}, now = {0};
    memcpy(r.measures, regress_measures, sizeof(r.measures));
    int code = CLI_OK;
    for (size_t k = 0; k < REGRESS_MEASURES && arguments->settings.changes; ++k) {
        r.measures[k].sense = WORSE_IF_CHANGED;
    }
    if (arguments->tolerances != NULL) {
        code = read_tolerances(&r, arguments->tolerances);
    }
    if (code == CLI_OK) {
        code = regress_read(command, arguments->inputs[0], &before);
    }
    if (code == CLI_OK && arguments->input_count == 1) {
        regress_print(&before);
    } else if (code == CLI_OK && (code = regress_read(command, arguments->inputs[1], &now)) == 0) {
        cJSON *json = cJSON_CreateObject();
        r.worse = json_array(json, "worse");
        r.missing = json_array(json, "missing");
        r.added = json_array(json, "new");
        compare_all(&r, &before, &now);
        code = conclude(&r, json);
    }
    regress_free(&before);
    regress_free(&now);
    return code;
}
