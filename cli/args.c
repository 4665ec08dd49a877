// Command line -> cli_arguments. Flags come from the option tables of the stages and of the
// program.
#include "cli.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

// One row per setting: name, type, default, least, most, unit, help, the commands' bit (0: all).
#define SETTINGS(X)                                                                                \
    X(threads, UINT, 0, 0, 256, "", "Threads; 0 means one per core", 0)                            \
    X(import_memory, UINT, 4096, 16, 1048576, "MiB", "Memory that reading a file may use",         \
      CLI_MESH)                                                                                    \
    X(import_seconds, DOUBLE, 60, 0.01, 86400, "s", "Time that reading a file may take", CLI_MESH) \
    X(parts, CHOICE, CLI_PARTS_TOGETHER, 0, CLI_PARTS_SEPARATE, "",                                \
      "Whether several garments in one file share a proxy or get one each", CLI_PARTS)             \
    X(png, BOOL, 1, 0, 1, "", "Write the contact sheet NAME.png", CLI_PNG)                         \
    X(strip, BOOL, 0, 0, 1, "",                                                                    \
      "Write NAME.strip.png: turntable, weights, skinned frames and stretch in rows", CLI_PNG)     \
    X(json, BOOL, 0, 0, 1, "", "Print JSON", CLI_JSON)                                             \
    X(motion, BOOL, 0, 0, 1, "", "Measure the weights of an asset on a wind they have not seen",   \
      CLI_MOTION)                                                                                  \
    X(print_options, BOOL, 0, 0, 1, "",                                                            \
      "Print every option as it stands, for --options, and do nothing else", CLI_OPTIONS)          \
    X(jobs, UINT, 0, 1, 256, "", "Garments at once; auto: one per core", CLI_BATCH)                \
    X(garment_memory, UINT, 0, 64, 1048576, "MiB",                                                 \
      "Memory that a garment may use; auto: the machine's over --jobs", CLI_BATCH)                 \
    X(garment_seconds, DOUBLE, 3600, 0.01, 604800, "s", "Time that a garment may take", CLI_BATCH) \
    X(garment_cpu_seconds, DOUBLE, 3600, 1, 604800, "s", "Processor time that a garment may use",  \
      CLI_BATCH)                                                                                   \
    X(dry_run, BOOL, 0, 0, 1, "", "Tell what would be done, and do nothing", CLI_BATCH)            \
    X(force, BOOL, 0, 0, 1, "", "Convert again what is up to date", CLI_BATCH)                     \
    X(retry_failed, BOOL, 0, 0, 1, "", "Try again what failed with the same input", CLI_BATCH)     \
    X(changes, BOOL, 0, 0, 1, "", "Tell what got better too, and count it as worse", CLI_REGRESS)  \
    X(licences, BOOL, 0, 0, 1, "", "Print every library with its version and licence",             \
      CLI_LICENCES)                                                                                \
    X(quiet, BOOL, 0, 0, 1, "", "Print errors only", 0)                                            \
    X(verbose, BOOL, 0, 0, 1, "", "Print more about each stage", 0)

static const char *const part_choices[] = {"together", "separate", NULL};
#define SETTING_FIELD(member, kind, default_, min_, max_, unit_, help_, accepts_)                  \
    {.name = #member,                                                                              \
     .type = PC_FIELD_##kind,                                                                      \
     .offset = offsetof(cli_settings, member),                                                     \
     .default_value = (default_),                                                                  \
     .minimum = (min_),                                                                            \
     .maximum = (max_),                                                                            \
     .unit = (unit_),                                                                              \
     .help = (help_),                                                                              \
     .choices = PC_FIELD_##kind == PC_FIELD_CHOICE ? part_choices : NULL,                          \
     .zero = (default_) < (min_) ? "auto" : NULL},
#define SETTING_ACCEPTS(member, kind, default_, min_, max_, unit_, help_, accepts_) accepts_,
static const pc_field settings_fields[] = {SETTINGS(SETTING_FIELD)};
static const unsigned settings_accepts[] = {SETTINGS(SETTING_ACCEPTS)};

#define SETTING_INDEX(member, kind, default_, min_, max_, unit_, help_, accepts_) AT_##member,
enum { SETTINGS(SETTING_INDEX) SETTING_COUNT };
const pc_record cli_settings_record = {settings_fields, SETTING_COUNT, sizeof(cli_settings)};
// From `json` on they are about one run.
const pc_record cli_file_settings_record = {settings_fields, AT_json, sizeof(cli_settings)};

static const cli_text_flag text_flags[] = {
    {"output", "OUTDIR", "Folder for the results; made when missing", CLI_OUTPUT_FOLDER,
     offsetof(cli_arguments, output), false},
    {"output", "ASSET", "Asset file to write", CLI_OUTPUT_FILE, offsetof(cli_arguments, output),
     false},
    {"output", "FILE.html", "Page to write; without it FOLDER/report.html", CLI_OUTPUT_PAGE,
     offsetof(cli_arguments, output), false},
    {"write-lp", "FILE", "Write the integer program too, in CPLEX LP format", CLI_WRITE_LP,
     offsetof(cli_arguments, lp), false},
    {"name", "NAME", "Name of the garment and of its files; without it the input's", CLI_NAME,
     offsetof(cli_arguments, name), false},
    {"mesh", "GLOB", "Take only parts whose mesh, node or material name matches; may be repeated",
     CLI_MESH, offsetof(cli_arguments, patterns), true},
    {"preset", "PRESET", "Options for a kind of engine; see below", CLI_OPTIONS,
     offsetof(cli_arguments, preset), false},
    {"options", "FILE.json", "Options from a file; those of the command line override them",
     CLI_OPTIONS, offsetof(cli_arguments, options_file), false},
    {"shard", "I/N", "Convert every N-th garment only, from the I-th on", CLI_BATCH,
     offsetof(cli_arguments, shard), false},
    {"tolerances", "FILE.json", "How much worse measures may get", CLI_REGRESS,
     offsetof(cli_arguments, tolerances), false},
    {"scenario", "FILE.json", "What the proxy goes through: winds, pins, attachment, colliders",
     CLI_SCENARIO, offsetof(cli_arguments, scenario), false},
};

const cli_text_flag *cli_text_flag_at(const cli_command *command, size_t index) {
    for (size_t i = 0; i < sizeof(text_flags) / sizeof(text_flags[0]); ++i) {
        if ((command->accepts & text_flags[i].accepts) != 0 && index-- == 0) {
            return &text_flags[i];
        }
    }
    return NULL;
}

const pc_field *cli_setting_at(const cli_command *command, size_t index) {
    for (size_t i = 0; i < SETTING_COUNT; ++i) {
        if ((settings_accepts[i] == 0 || (command->accepts & settings_accepts[i]) != 0) &&
            index-- == 0) {
            return &settings_fields[i];
        }
    }
    return NULL;
}

void cli_flag_name(const pc_field *field, char flag[64]) {
    size_t length = 0;
    for (; length < 63 && field->name[length] != '\0'; ++length) {
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
    const pc_field *setting;
    for (size_t i = 0; (setting = cli_setting_at(command, i)) != NULL; ++i) {
        cli_flag_name(setting, flag);
        cli_guess_add(&guess, flag);
    }
    const cli_text_flag *text;
    for (size_t i = 0; (text = cli_text_flag_at(command, i)) != NULL; ++i) {
        cli_guess_add(&guess, text->name);
    }
    for (pc_stage stage = 0; stage < PC_STAGE_COUNT; ++stage) {
        const pc_record *record = pc_stage_describe(stage)->options;
        for (size_t i = 0; (command->stages & 1u << stage) != 0 && i < record->field_count; ++i) {
            cli_flag_name(&record->fields[i], flag);
            cli_guess_add(&guess, flag);
        }
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

// Sets the field if it is the one that the flag names.
static int match_field(const cli_command *command, pc_context *context, const char *stage,
                       const pc_field *field, void *values, flag_word *flag) {
    char name[64];
    cli_flag_name(field, name);
    if (strcmp(name, flag->name) != 0) {
        return CLI_OK;
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

static int match_record(const cli_command *command, pc_context *context, const char *stage,
                        const pc_record *record, void *values, flag_word *flag) {
    int code = CLI_OK;
    for (size_t i = 0; i < record->field_count && code == CLI_OK; ++i) {
        code = match_field(command, context, stage, &record->fields[i], values, flag);
    }
    return code;
}

static int match_setting(const cli_command *command, pc_context *context, cli_settings *settings,
                         flag_word *flag) {
    int code = CLI_OK;
    const pc_field *field;
    for (size_t i = 0; code == CLI_OK && (field = cli_setting_at(command, i)) != NULL; ++i) {
        code = match_field(command, context, "option", field, settings, flag);
    }
    return code;
}

static int match_text(const cli_command *command, cli_arguments *arguments, flag_word *flag) {
    const cli_text_flag *row;
    for (size_t i = 0; (row = cli_text_flag_at(command, i)) != NULL; ++i) {
        if (strcmp(row->name, flag->name) == 0) {
            break;
        }
    }
    if (row == NULL || flag->negated) {
        return CLI_OK;
    }
    flag->known = true;
    const char *text = take_value(flag);
    if (text == NULL || text[0] == '\0') {
        return cli_fail(command->name, CLI_USAGE, "--%s: a value is missing", flag->name);
    }
    if (row->repeatable) {
        arguments->patterns[arguments->pattern_count++] = text;
    } else {
        *(const char **)(void *)((char *)arguments + row->offset) = text;
    }
    return CLI_OK;
}

// --vertices 64,128,512: several proxies from one single layer.
static int match_levels(const cli_command *command, pc_context *context, cli_arguments *arguments,
                        flag_word *flag) {
    const char *text = flag->value != NULL ? flag->value : flag->next;
    pc_series *levels = &arguments->levels;
    if (strcmp(flag->name, levels->name) != 0 || flag->negated ||
        (command->stages & 1u << PC_STAGE_SIMPLIFY) == 0) {
        return CLI_OK;
    }
    levels->count = 0;
    if (text == NULL || strchr(text, ',') == NULL) {
        return CLI_OK;
    }
    text = take_value(flag);
    flag->known = true;
    const pc_field *field = pc_record_find(&pc_simplify_options_record, flag->name);
    pc_simplify_options *options = &arguments->options.simplify;
    for (const char *at = text; at != NULL;) {
        char item[32] = {0};
        const size_t length = strcspn(at, ",");
        memcpy(item, at, length < sizeof(item) ? length : sizeof(item) - 1);
        if (pc_field_set_text(context, "simplify", field, options, item) != PC_OK ||
            pc_series_add(context, "simplify", field, options, levels) != PC_OK) {
            return cli_fail(command->name, CLI_USAGE, "--vertices: %s",
                            pc_context_error(context)->message);
        }
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
        code = match_setting(command, context, &arguments->settings, flag);
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

static const struct {
    char letter;
    const char *name;
} letters[] = {{'o', "output"}, {'q', "quiet"}, {'v', "verbose"}, {'h', "help"}};

char cli_flag_letter(const char *name) {
    for (size_t i = 0; i < sizeof(letters) / sizeof(letters[0]); ++i) {
        if (strcmp(letters[i].name, name) == 0) {
            return letters[i].letter;
        }
    }
    return '\0';
}

// Splits "--name=value" or a letter into a flag; false: no flag of ours.
static bool split_flag(const char *word, const char *next, flag_word *result) {
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

// The value of a flag of the command, wherever it stands; NULL where it does not.
static const char *find_text(const cli_command *command, int count, char **words, const char *name,
                             cli_accepts accepts) {
    const char *found = NULL;
    for (int i = 0; i < count && strcmp(words[i], "--") != 0; ++i) {
        flag_word flag;
        if (words[i][0] == '-' &&
            split_flag(words[i], i + 1 < count ? words[i + 1] : NULL, &flag) &&
            strcmp(flag.name, name) == 0 && (command->accepts & (unsigned)accepts) != 0) {
            found = take_value(&flag);
        }
    }
    return found;
}

static int apply_preset(const cli_command *command, pc_context *context, const char *name,
                        const pc_option_group *groups) {
    cli_guess guess = {.word = name};
    const pc_preset *preset;
    for (size_t i = 0; (preset = pc_preset_at(i)) != NULL; ++i) {
        if (strcmp(preset->name, name) == 0) {
            const pc_status status = pc_options_parse(
                context, preset->options, strlen(preset->options), name, groups, CLI_OPTION_GROUPS);
            return status == PC_OK ? CLI_OK
                                   : cli_fail_status(command->name, context, status, name, false);
        }
        cli_guess_add(&guess, preset->name);
    }
    if (guess.best[0] != '\0') {
        return cli_fail(command->name, CLI_USAGE, "no preset \"%s\"; did you mean %s?", name,
                        guess.best);
    }
    return cli_fail(command->name, CLI_USAGE, "no preset \"%s\"; see 'proxycloth help %s'", name,
                    command->name);
}

// Options of the preset and the files: the flags, wherever they stand, override them.
static int read_option_files(const cli_command *command, pc_context *context, int count,
                             char **words, cli_arguments *arguments) {
    const char *preset = find_text(command, count, words, "preset", CLI_OPTIONS);
    const char *options = find_text(command, count, words, "options", CLI_OPTIONS);
    const char *path = find_text(command, count, words, "scenario", CLI_SCENARIO);
    pc_option_group groups[CLI_OPTION_GROUPS];
    cli_option_groups(arguments, groups);
    if (preset != NULL) {
        const int code = apply_preset(command, context, preset, groups);
        if (code != CLI_OK) {
            return code;
        }
    }
    if (options != NULL) {
        const pc_status status = pc_options_read(context, options, groups, CLI_OPTION_GROUPS);
        if (status != PC_OK) {
            return cli_fail_status(command->name, context, status, options, false);
        }
    }
    if (path != NULL) {
        pc_scenario scenario = {0};
        const pc_status status =
            pc_scenario_read(context, path, &arguments->options.simulate, &scenario);
        pc_scenario_free(context, &scenario);
        if (status != PC_OK) {
            return cli_fail_status(command->name, context, status, path, false);
        }
    }
    return CLI_OK;
}

void cli_option_groups(cli_arguments *arguments, pc_option_group groups[CLI_OPTION_GROUPS]) {
    pc_option_groups(&arguments->options, groups);
    groups[PC_STAGE_SIMPLIFY].series = &arguments->levels;
    groups[PC_STAGE_COUNT] =
        (pc_option_group){"program", &cli_file_settings_record, &arguments->settings, NULL};
}

int cli_print_options(const cli_command *command, cli_arguments *arguments) {
    pc_option_group groups[CLI_OPTION_GROUPS];
    cli_option_groups(arguments, groups);
    pc_context *context = NULL;
    char *text = NULL;
    pc_status status = pc_context_create(NULL, &context);
    if (status == PC_OK) {
        status = pc_options_print(context, groups, CLI_OPTION_GROUPS, &text);
    }
    if (status == PC_OK) {
        puts(text);
    }
    pc_release(context, text);
    pc_context_destroy(context);
    return status == PC_OK ? CLI_OK : cli_fail(command->name, CLI_LIMIT, "memory ran out");
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
    if (arguments->settings.print_options) {
        return CLI_OK;
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
    arguments->levels.name = "vertices";
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
        code = read_option_files(command, context, count, words, arguments);
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
