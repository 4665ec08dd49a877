// Command line -> cli_arguments. Flags come from the option tables of the stages and of the
// program.
#include "cli.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define SETTING_OR(member, kind, default_, min_, max_, unit_, help_, zero_)                        \
    {                                                                                              \
        .name = #member, .type = PC_FIELD_##kind, .offset = offsetof(cli_settings, member),        \
        .default_value = (default_), .minimum = (min_), .maximum = (max_), .unit = (unit_),        \
        .help = (help_), .zero = (zero_)                                                           \
    }
#define SETTING(member, kind, default_, min_, max_, unit_, help_)                                  \
    SETTING_OR(member, kind, default_, min_, max_, unit_, help_, NULL)

static const char *const part_choices[] = {"together", "separate", NULL};
static const pc_field settings_fields[] = {
    SETTING(threads, UINT, 0, 0, 256, "", "Threads; 0 means one per core"),
    SETTING(import_memory, UINT, 4096, 16, 1048576, "MiB", "Memory that reading a file may use"),
    SETTING(import_seconds, DOUBLE, 60, 0.01, 86400, "s", "Time that reading a file may take"),
    SETTING_OR(jobs, UINT, 0, 1, 256, "", "Garments at once; auto: one per core", "auto"),
    SETTING_OR(garment_memory, UINT, 0, 64, 1048576, "MiB",
               "Memory that a garment may use; auto: the machine's over --jobs", "auto"),
    SETTING(garment_seconds, DOUBLE, 3600, 0.01, 604800, "s", "Time that a garment may take"),
    SETTING(garment_cpu_seconds, DOUBLE, 3600, 1, 604800, "s",
            "Processor time that a garment may use"),
    {.name = "parts",
     .type = PC_FIELD_CHOICE,
     .offset = offsetof(cli_settings, parts),
     .default_value = CLI_PARTS_TOGETHER,
     .maximum = CLI_PARTS_SEPARATE,
     .unit = "",
     .help = "Whether several garments in one file share a proxy or get one each",
     .choices = part_choices},
    SETTING(png, BOOL, 1, 0, 1, "", "Write the contact sheet NAME.png"),
    SETTING(strip, BOOL, 0, 0, 1, "",
            "Write NAME.strip.png: turntable, weights, skinned frames and stretch in rows"),
    SETTING(json, BOOL, 0, 0, 1, "", "Print JSON"),
    SETTING(motion, BOOL, 0, 0, 1, "",
            "Measure the weights of an asset on a wind they have not seen"),
    SETTING(dry_run, BOOL, 0, 0, 1, "", "Tell what would be done, and do nothing"),
    SETTING(force, BOOL, 0, 0, 1, "", "Convert again what is up to date"),
    SETTING(retry_failed, BOOL, 0, 0, 1, "", "Try again what failed with the same input"),
    SETTING(quiet, BOOL, 0, 0, 1, "", "Print errors only"),
    SETTING(verbose, BOOL, 0, 0, 1, "", "Print more about each stage"),
};
const pc_record cli_settings_record = {.fields = settings_fields,
                                       .field_count =
                                           sizeof(settings_fields) / sizeof(settings_fields[0]),
                                       .size = sizeof(cli_settings)};

// Commands that do not accept a setting do not know its flag.
static bool accepts_setting(const cli_command *command, const pc_field *field) {
    switch (field->offset) {
    case offsetof(cli_settings, import_memory):
    case offsetof(cli_settings, import_seconds):
        return (command->accepts & CLI_MESH) != 0;
    case offsetof(cli_settings, json):
        return (command->accepts & CLI_JSON) != 0;
    case offsetof(cli_settings, parts):
        return (command->accepts & CLI_PARTS) != 0;
    case offsetof(cli_settings, jobs):
    case offsetof(cli_settings, garment_memory):
    case offsetof(cli_settings, garment_seconds):
    case offsetof(cli_settings, garment_cpu_seconds):
    case offsetof(cli_settings, dry_run):
    case offsetof(cli_settings, force):
    case offsetof(cli_settings, retry_failed):
        return (command->accepts & CLI_BATCH) != 0;
    case offsetof(cli_settings, motion):
        return (command->accepts & CLI_MOTION) != 0;
    case offsetof(cli_settings, png):
    case offsetof(cli_settings, strip):
        return (command->accepts & CLI_PNG) != 0;
    default:
        return true;
    }
}

void cli_flag_name(const pc_field *field, char flag[64]) {
    size_t length = 0;
    for (; field->name[length] != '\0' && length < 63; ++length) {
        flag[length] = field->name[length] == '_' ? '-' : field->name[length];
    }
    flag[length] = '\0';
}

static size_t edit_distance(const char *a, const char *b) {
    enum { limit = 48 };
    const size_t na = strlen(a), nb = strlen(b);
    if (na > limit || nb > limit) {
        return SIZE_MAX;
    }
    size_t row[limit + 1];
    for (size_t j = 0; j <= nb; ++j) {
        row[j] = j;
    }
    for (size_t i = 1; i <= na; ++i) {
        size_t diagonal = row[0];
        row[0] = i;
        for (size_t j = 1; j <= nb; ++j) {
            size_t best = diagonal + (a[i - 1] != b[j - 1]);
            best = row[j] + 1 < best ? row[j] + 1 : best;
            best = row[j - 1] + 1 < best ? row[j - 1] + 1 : best;
            diagonal = row[j];
            row[j] = best;
        }
    }
    return row[nb];
}

void cli_guess_add(cli_guess *guess, const char *candidate) {
    const size_t distance = edit_distance(guess->word, candidate);
    const size_t tolerance = strlen(guess->word) < 5 ? 1 : strlen(guess->word) / 3;
    if (distance <= tolerance && (guess->best[0] == '\0' || distance < guess->distance)) {
        guess->distance = distance;
        snprintf(guess->best, sizeof(guess->best), "%s", candidate);
    }
}

static int unknown_option(const cli_command *command, const char *name, const char *no) {
    cli_guess guess = {.word = name};
    char flag[64];
    for (size_t i = 0; i < cli_settings_record.field_count; ++i) {
        if (accepts_setting(command, &settings_fields[i])) {
            cli_flag_name(&settings_fields[i], flag);
            cli_guess_add(&guess, flag);
        }
    }
    for (pc_stage stage = 0; stage < PC_STAGE_COUNT; ++stage) {
        const pc_record *record = pc_stage_describe(stage)->options;
        for (size_t i = 0; (command->stages & 1u << stage) != 0 && i < record->field_count; ++i) {
            cli_flag_name(&record->fields[i], flag);
            cli_guess_add(&guess, flag);
        }
    }
    if ((command->accepts & CLI_MESH) != 0) {
        cli_guess_add(&guess, "mesh");
    }
    if ((command->accepts & CLI_NAME) != 0) {
        cli_guess_add(&guess, "name");
    }
    if ((command->accepts & CLI_WRITE_LP) != 0) {
        cli_guess_add(&guess, "write-lp");
    }
    if ((command->accepts & CLI_SCENARIO) != 0) {
        cli_guess_add(&guess, "scenario");
    }
    if ((command->accepts & CLI_BATCH) != 0) {
        cli_guess_add(&guess, "shard");
    }
    if (guess.best[0] != '\0') {
        return cli_fail(command->name, CLI_USAGE, "no option --%s%s; did you mean --%s%s?", no,
                        name, no, guess.best);
    }
    return cli_fail(command->name, CLI_USAGE, "no option --%s%s; see 'proxycloth help %s'", no,
                    name, command->name);
}

// One flag on the command line while it is being matched.
typedef struct flag_word {
    char name[64]; // without dashes, and without "no-" when negated
    bool negated;
    const char *value; // behind '=', or NULL
    const char *next;  // the following word, or NULL
    bool used_next;
    bool known;
} flag_word;

static const char *take_value(flag_word *flag) {
    if (flag->value == NULL && flag->next != NULL) {
        flag->value = flag->next;
        flag->used_next = true;
    }
    return flag->value;
}

// Sets the fields of `record` that the flag names.
static int match_record(const cli_command *command, pc_context *context, const char *stage,
                        const pc_record *record, void *values, flag_word *flag) {
    for (size_t i = 0; i < record->field_count; ++i) {
        const pc_field *field = &record->fields[i];
        char name[64];
        cli_flag_name(field, name);
        if (strcmp(name, flag->name) != 0 ||
            (record == &cli_settings_record && !accepts_setting(command, field))) {
            continue;
        }
        flag->known = true;
        const char *text = flag->value;
        if (field->type == PC_FIELD_BOOL) {
            text = text != NULL ? text : flag->negated ? "false" : "true";
        } else if (flag->negated) {
            return cli_fail(command->name, CLI_USAGE, "--no-%s: the option is not a switch", name);
        } else if ((text = take_value(flag)) == NULL) {
            return cli_fail(command->name, CLI_USAGE, "--%s: a value is missing", name);
        }
        if (pc_field_set_text(context, stage, field, values, text) != PC_OK) {
            return cli_fail(command->name, CLI_USAGE, "--%s: %s", name,
                            pc_context_error(context)->message);
        }
        return CLI_OK;
    }
    return CLI_OK;
}

static int match_text(const cli_command *command, cli_arguments *arguments, flag_word *flag) {
    const bool output = strcmp(flag->name, "output") == 0 &&
                        (command->accepts & (CLI_OUTPUT_FILE | CLI_OUTPUT_FOLDER)) != 0;
    const bool name = strcmp(flag->name, "name") == 0 && (command->accepts & CLI_NAME) != 0;
    const bool mesh = strcmp(flag->name, "mesh") == 0 && (command->accepts & CLI_MESH) != 0;
    const bool lp = strcmp(flag->name, "write-lp") == 0 && (command->accepts & CLI_WRITE_LP) != 0;
    const bool scenario =
        strcmp(flag->name, "scenario") == 0 && (command->accepts & CLI_SCENARIO) != 0;
    const bool shard = strcmp(flag->name, "shard") == 0 && (command->accepts & CLI_BATCH) != 0;
    if ((!output && !name && !mesh && !lp && !scenario && !shard) || flag->negated) {
        return CLI_OK;
    }
    flag->known = true;
    const char *text = take_value(flag);
    if (text == NULL || text[0] == '\0') {
        return cli_fail(command->name, CLI_USAGE, "--%s: a value is missing", flag->name);
    }
    if (output) {
        arguments->output = text;
    } else if (name) {
        arguments->name = text;
    } else if (lp) {
        arguments->lp = text;
    } else if (scenario) {
        arguments->scenario = text;
    } else if (shard) {
        arguments->shard = text;
    } else {
        arguments->patterns[arguments->pattern_count++] = text;
    }
    return CLI_OK;
}

// --vertices 64,128,512: several proxies from one single layer.
static int match_levels(const cli_command *command, pc_context *context, cli_arguments *arguments,
                        flag_word *flag) {
    const char *text = flag->value != NULL ? flag->value : flag->next;
    if (strcmp(flag->name, "vertices") != 0 || flag->negated ||
        (command->stages & 1u << PC_STAGE_SIMPLIFY) == 0) {
        return CLI_OK;
    }
    arguments->level_count = 0;
    if (text == NULL || strchr(text, ',') == NULL) {
        return CLI_OK;
    }
    text = take_value(flag);
    flag->known = true;
    const pc_field *field = pc_record_find(&pc_simplify_options_record, flag->name);
    for (const char *at = text; at != NULL;) {
        char item[32] = {0};
        const size_t length = strcspn(at, ",");
        memcpy(item, at, length < sizeof(item) ? length : sizeof(item) - 1);
        if (pc_field_set_text(context, "simplify", field, &arguments->options.simplify, item) !=
            PC_OK) {
            return cli_fail(command->name, CLI_USAGE, "--vertices: %s",
                            pc_context_error(context)->message);
        }
        const uint32_t level = arguments->options.simplify.vertices;
        for (size_t i = 0; i < arguments->level_count; ++i) {
            if (arguments->levels[i] == level) {
                return cli_fail(command->name, CLI_USAGE, "--vertices: %u is given twice",
                                (unsigned)level);
            }
        }
        if (arguments->level_count == CLI_MAXIMUM_LEVELS) {
            return cli_fail(command->name, CLI_USAGE, "--vertices: more than %d levels",
                            CLI_MAXIMUM_LEVELS);
        }
        arguments->levels[arguments->level_count++] = level;
        at = at[length] == ',' ? at + length + 1 : NULL;
    }
    return CLI_OK;
}

static int match_flag(const cli_command *command, pc_context *context, cli_arguments *arguments,
                      flag_word *flag) {
    int code = match_text(command, arguments, flag);
    if (code == CLI_OK && !flag->known) {
        code = match_levels(command, context, arguments, flag);
    }
    if (flag->known) {
        return code;
    }
    if (code == CLI_OK) {
        code = match_record(command, context, "option", &cli_settings_record, &arguments->settings,
                            flag);
    }
    if (code == CLI_OK && (command->accepts & CLI_MOTION) != 0) {
        code = match_record(command, context, "option", &pc_evaluate_motion_options_record,
                            &arguments->motion, flag);
    }
    // Several stages may share a name (--seed): all of them are set.
    for (pc_stage stage = 0; stage < PC_STAGE_COUNT && code == CLI_OK; ++stage) {
        const pc_stage_info *info = pc_stage_describe(stage);
        if ((command->stages & 1u << stage) != 0) {
            code = match_record(command, context, info->name, info->options,
                                (char *)&arguments->options + info->options_offset, flag);
        }
    }
    if (code == CLI_OK && !flag->known) {
        return unknown_option(command, flag->name, flag->negated ? "no-" : "");
    }
    return code;
}

// Splits "--name=value" or a letter into a flag; false: no flag of ours.
static bool split_flag(const char *word, const char *next, flag_word *result) {
    static const struct {
        char letter;
        const char *name;
    } letters[] = {{'o', "output"}, {'q', "quiet"}, {'v', "verbose"}, {'h', "help"}};
    memset(result, 0, sizeof(*result));
    result->next = next;
    if (word[1] != '-') {
        for (size_t i = 0; i < sizeof(letters) / sizeof(letters[0]); ++i) {
            if (word[1] == letters[i].letter && word[2] == '\0') {
                strncpy(result->name, letters[i].name, sizeof(result->name) - 1);
                return true;
            }
        }
        return false;
    }
    word += 2;
    if (strncmp(word, "no-", 3) == 0) {
        result->negated = true;
        word += 3;
    }
    const char *equals = strchr(word, '=');
    const size_t length = equals != NULL ? (size_t)(equals - word) : strlen(word);
    if (length == 0 || length >= sizeof(result->name)) {
        return false;
    }
    memcpy(result->name, word, length);
    result->value = equals != NULL ? equals + 1 : NULL;
    return true;
}

// Options of the scenario file, wherever its flag stands: the other flags override them.
static int read_scenario_options(const cli_command *command, pc_context *context, int count,
                                 char **words, cli_arguments *arguments) {
    const char *path = NULL;
    for (int i = 0; i < count && strcmp(words[i], "--") != 0; ++i) {
        if (strcmp(words[i], "--scenario") == 0 && i + 1 < count) {
            path = words[i + 1];
        } else if (strncmp(words[i], "--scenario=", strlen("--scenario=")) == 0) {
            path = words[i] + strlen("--scenario=");
        }
    }
    if (path == NULL || (command->accepts & CLI_SCENARIO) == 0) {
        return CLI_OK;
    }
    pc_scenario scenario = {0};
    const pc_status status =
        pc_scenario_read(context, path, &arguments->options.simulate, &scenario);
    pc_scenario_free(context, &scenario);
    return status == PC_OK ? CLI_OK : cli_fail_status(command->name, context, status, path, false);
}

static int parse_words(const cli_command *command, pc_context *context, int count, char **words,
                       cli_arguments *arguments) {
    bool flags_end = false;
    for (int i = 0; i < count; ++i) {
        const char *word = words[i];
        if (!flags_end && strcmp(word, "--") == 0) {
            flags_end = true;
        } else if (!flags_end && word[0] == '-' && word[1] != '\0') {
            flag_word flag;
            if (!split_flag(word, i + 1 < count ? words[i + 1] : NULL, &flag)) {
                return cli_fail(command->name, CLI_USAGE, "no option %s; see 'proxycloth help %s'",
                                word, command->name);
            }
            if (strcmp(flag.name, "help") == 0) {
                arguments->help = true;
                return CLI_OK;
            }
            const int code = match_flag(command, context, arguments, &flag);
            if (code != CLI_OK) {
                return code;
            }
            i += flag.used_next;
        } else if (arguments->input_count < command->maximum_inputs) {
            arguments->inputs[arguments->input_count++] = word;
        } else {
            return cli_fail(command->name, CLI_USAGE,
                            "one argument too many: \"%s\"; usage: proxycloth %s %s", word,
                            command->name, command->operands);
        }
    }
    const bool needs_output = (command->accepts & CLI_OUTPUT_FOLDER) != 0;
    if (arguments->input_count < command->minimum_inputs ||
        (needs_output && arguments->output == NULL)) {
        return cli_fail(command->name, CLI_USAGE, "%s is missing; usage: proxycloth %s %s",
                        arguments->input_count < command->minimum_inputs ? "an input" : "-o OUTDIR",
                        command->name, command->operands);
    }
    return CLI_OK;
}

int cli_parse(const cli_command *command, int count, char **words, cli_arguments *arguments) {
    memset(arguments, 0, sizeof(*arguments));
    arguments->options = pc_default_options();
    pc_record_set_defaults(&cli_settings_record, &arguments->settings);
    pc_record_set_defaults(&pc_evaluate_motion_options_record, &arguments->motion);
    arguments->patterns = calloc((size_t)count + 1, sizeof(*arguments->patterns));
    arguments->inputs = calloc((size_t)count + 1, sizeof(*arguments->inputs));
    // One thread: the parsing context must not start any (files are imported in a fork).
    const pc_context_options options = {.threads = 1};
    pc_context *context = NULL;
    int code = CLI_FAILED;
    if (arguments->patterns == NULL || arguments->inputs == NULL ||
        pc_context_create(&options, &context) != PC_OK) {
        code = cli_fail(command->name, CLI_LIMIT, "memory ran out");
    } else {
        code = read_scenario_options(command, context, count, words, arguments);
        if (code == CLI_OK) {
            code = parse_words(command, context, count, words, arguments);
        }
    }
    pc_context_destroy(context);
    return code;
}

void cli_arguments_free(cli_arguments *arguments) {
    free(arguments->patterns);
    free(arguments->inputs);
    arguments->patterns = NULL;
    arguments->inputs = NULL;
}
