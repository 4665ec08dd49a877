// A bash script that completes commands, flags and choices, made from their tables.
#include <stdio.h>

#include "cli.h"

static void print_record_flags(const pc_record *record) {
    for (size_t i = 0; i < record->field_count; ++i) {
        char flag[64];
        cli_flag_name(&record->fields[i], flag);
        printf(" --%s", flag);
    }
}

static void print_flags(const cli_command *command) {
    const cli_text_flag *text;
    for (size_t i = 0; (text = cli_text_flag_at(command, i)) != NULL; ++i) {
        printf(" --%s", text->name);
    }
    const pc_field *setting;
    for (size_t i = 0; (setting = cli_setting_at(command, i)) != NULL; ++i) {
        char flag[64];
        cli_flag_name(setting, flag);
        printf(" --%s", flag);
    }
    if ((command->accepts & CLI_MOTION) != 0) {
        print_record_flags(&pc_evaluate_motion_options_record);
    }
    for (pc_stage stage = 0; stage < PC_STAGE_COUNT; ++stage) {
        if ((command->stages & 1u << stage) != 0) {
            print_record_flags(pc_stage_describe(stage)->options);
        }
    }
}

static void print_choices(const pc_record *record) {
    for (size_t i = 0; i < record->field_count; ++i) {
        char flag[64];
        cli_flag_name(&record->fields[i], flag);
        if (record->fields[i].type == PC_FIELD_CHOICE) {
            printf("    --%s) values=\"", flag);
            for (size_t k = 0; record->fields[i].choices[k] != NULL; ++k) {
                printf("%s%s", k != 0 ? " " : "", record->fields[i].choices[k]);
            }
            printf("\" ;;\n");
        }
    }
}

int cli_run_completion(const cli_command *command, cli_arguments *arguments) {
    (void)command;
    (void)arguments;
    cli_command listed;
    printf("# Completion for bash: eval \"$(proxycloth completion)\"\n"
           "_proxycloth() {\n"
           "    local word=${COMP_WORDS[COMP_CWORD]} flags= values=\n"
           "    local commands=\"");
    for (size_t i = 0; cli_command_at(i, &listed); ++i) {
        printf("%s%s", i != 0 ? " " : "", listed.name);
    }
    printf("\"\n    case ${COMP_WORDS[1]} in\n");
    for (size_t i = 0; cli_command_at(i, &listed); ++i) {
        printf("    %s) flags=\"--help", listed.name);
        print_flags(&listed);
        printf("\" ;;\n");
    }
    printf("    esac\n    case ${COMP_WORDS[COMP_CWORD - 1]} in\n");
    print_choices(&cli_settings_record);
    for (pc_stage stage = 0; stage < PC_STAGE_COUNT; ++stage) {
        print_choices(pc_stage_describe(stage)->options);
    }
    printf("    --preset) values=\"");
    const pc_preset *preset;
    for (size_t i = 0; (preset = pc_preset_at(i)) != NULL; ++i) {
        printf("%s%s", i != 0 ? " " : "", preset->name);
    }
    printf("\" ;;\n    help) values=$commands ;;\n    esac\n"
           "    [ \"$COMP_CWORD\" -gt 1 ] || values=$commands\n"
           "    [ -n \"$values\" ] || case $word in -*) values=$flags ;; esac\n"
           "    COMPREPLY=($(compgen -W \"$values\" -- \"$word\"))\n"
           "}\n"
           "complete -o default -F _proxycloth proxycloth\n");
    return CLI_OK;
}
