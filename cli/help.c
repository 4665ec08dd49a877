// Help texts, made from the tables of commands and options.
#include "cli.h"

#include <stdio.h>
#include <string.h>

static const char exit_codes[] = "Exit codes:\n"
                                 "    0  success\n"
                                 "    1  processing failed, for example no proxy was found\n"
                                 "    2  wrong usage, for example an option out of range\n"
                                 "    3  an input cannot be read or processed\n"
                                 "    4  an output cannot be written\n"
                                 "    5  internal error\n"
                                 "    6  the importer crashed\n"
                                 "    7  a limit of time or memory was hit\n"
                                 "   75  failed for now: another try may help\n"
                                 "  130  interrupted\n";

static void print_line(const char *left, const char *help, const char *note) {
    printf("  %-29s %s%s%s%s\n", left,
           strlen(left) > 29 ? "\n                                " : "", help,
           note[0] != '\0' ? " " : "", note);
}

// "[default 0.5; 0..1 m]"
static void describe_value(const pc_field *field, char *text, size_t size) {
    const char *space = field->unit[0] != '\0' ? " " : "";
    if (field->type == PC_FIELD_BOOL) {
        snprintf(text, size, "[default %s]", field->default_value != 0.0 ? "on" : "off");
    } else if (field->type == PC_FIELD_CHOICE) {
        int length =
            snprintf(text, size, "[default %s;", field->choices[(size_t)field->default_value]);
        for (size_t i = 0; field->choices[i] != NULL && (size_t)length < size; ++i) {
            length += snprintf(text + length, size - (size_t)length, " %s%s", field->choices[i],
                               field->choices[i + 1] != NULL ? "," : "]");
        }
    } else {
        char standard[32];
        snprintf(standard, sizeof(standard), "%.10g", field->default_value);
        snprintf(text, size, "[default %s; %s%s%.10g..%.10g%s%s]",
                 field->zero != NULL && field->default_value == 0.0 ? field->zero : standard,
                 field->zero != NULL ? field->zero : "", field->zero != NULL ? ", " : "",
                 field->minimum, field->maximum, space, field->unit);
    }
}

static void print_field(const pc_field *field) {
    char flag[64], left[160], note[256];
    cli_flag_name(field, flag);
    const char letter = cli_flag_letter(flag);
    if (field->type != PC_FIELD_BOOL) {
        snprintf(left, sizeof(left), "--%s %s", flag,
                 field->type == PC_FIELD_CHOICE ? "CHOICE" : "NUMBER");
    } else if (letter != '\0') {
        snprintf(left, sizeof(left), "-%c, --%s", letter, flag);
    } else {
        snprintf(left, sizeof(left), "--%s, --no-%s", flag, flag);
    }
    describe_value(field, note, sizeof(note));
    print_line(left, field->help, note);
}

void cli_print_help(const cli_command *command) {
    printf("usage: proxycloth %s %s%s\n\n%s\n%s", command->name, command->operands,
           command->minimum_inputs != 0 ? " [options]" : "", command->summary,
           command->details != NULL ? command->details : "");
    if (command->example != NULL) {
        printf("\nExample:\n  proxycloth %s %s\n", command->name, command->example);
    }
    printf("\nOptions:\n");
    const cli_text_flag *text;
    for (size_t i = 0; (text = cli_text_flag_at(command, i)) != NULL; ++i) {
        char left[160];
        const char letter = cli_flag_letter(text->name);
        const char prefix[] = {'-', letter, ',', ' ', '\0'};
        snprintf(left, sizeof(left), "%s--%s %s", letter != '\0' ? prefix : "", text->name,
                 text->value);
        print_line(left, text->help, "");
    }
    const pc_field *setting;
    for (size_t i = 0; (setting = cli_setting_at(command, i)) != NULL; ++i) {
        print_field(setting);
    }
    if ((command->accepts & CLI_MOTION) != 0) {
        for (size_t i = 0; i < pc_evaluate_motion_options_record.field_count; ++i) {
            print_field(&pc_evaluate_motion_options_record.fields[i]);
        }
    }
    print_line("-h, --help", "Print this text", "");
    if ((command->accepts & CLI_OPTIONS) != 0) {
        printf("\nPresets:\n");
        const pc_preset *preset;
        for (size_t i = 0; (preset = pc_preset_at(i)) != NULL; ++i) {
            print_line(preset->name, preset->summary, "");
        }
    }
    for (pc_stage stage = 0; stage < PC_STAGE_COUNT; ++stage) {
        const pc_stage_info *info = pc_stage_describe(stage);
        if ((command->stages & 1u << stage) == 0 || info->options->field_count == 0) {
            continue;
        }
        printf("\n%s: %s\n", info->name, info->summary);
        for (size_t i = 0; i < info->options->field_count; ++i) {
            print_field(&info->options->fields[i]);
        }
    }
}

int cli_run_help(const cli_command *command, cli_arguments *arguments) {
    cli_command listed;
    if (arguments->input_count == 1) {
        if (!cli_find_command(arguments->inputs[0], &listed)) {
            return cli_fail(command->name, CLI_USAGE, "no command \"%s\"; see 'proxycloth help'",
                            arguments->inputs[0]);
        }
        cli_print_help(&listed);
        return CLI_OK;
    }
    printf("usage: proxycloth COMMAND ...\n\n"
           "Turns a garment mesh into a low-poly simulated proxy mesh and skinning weights.\n\n"
           "Commands:\n");
    for (size_t i = 0; cli_command_at(i, &listed); ++i) {
        printf("  %-11s %s\n", listed.name, listed.summary);
    }
    printf("\nStages run one by one on an asset file give the same bytes as build.\n"
           "'proxycloth help COMMAND' lists the options of a command.\n\n%s",
           exit_codes);
    return CLI_OK;
}
