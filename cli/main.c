// Dispatch.
#define _POSIX_C_SOURCE 200809L
#include "cli.h"

#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

// Where a standard stream is closed, the first file opened would take its place, and get messages
// in its midst. Nothing can be written to what is opened here.
static bool open_standard_streams(void) {
    int file = 0;
    while (file >= 0 && file <= STDERR_FILENO) {
        file = open("/dev/null", O_RDONLY);
    }
    return file >= 0 && close(file) == 0;
}

static int unknown_command(const char *name) {
    cli_guess guess = {.word = name};
    cli_command command;
    for (size_t i = 0; cli_command_at(i, &command); ++i) {
        cli_guess_add(&guess, command.name);
    }
    if (guess.best[0] != '\0') {
        return cli_fail(NULL, CLI_USAGE, "no command \"%s\"; did you mean %s?", name, guess.best);
    }
    return cli_fail(NULL, CLI_USAGE, "no command \"%s\"; see 'proxycloth help'", name);
}

int main(int argc, char **argv) {
    if (!open_standard_streams()) {
        return CLI_TRANSIENT;
    }
    if (argc < 2) {
        return cli_fail(NULL, CLI_USAGE, "a command is missing; see 'proxycloth help'");
    }
    const char *name = argv[1];
    if (strcmp(name, "--help") == 0 || strcmp(name, "-h") == 0) {
        name = "help";
    } else if (strcmp(name, "--version") == 0) {
        name = "version";
    }
    cli_command command;
    if (!cli_find_command(name, &command)) {
        return unknown_command(name);
    }
    cli_arguments arguments = {0};
    int code = cli_parse(&command, argc - 2, argv + 2, &arguments);
    if (code == CLI_OK) {
        if (arguments.help) {
            cli_print_help(&command);
        } else if (arguments.settings.print_options) {
            code = cli_print_options(&command, &arguments);
        } else {
            code = command.run(&command, &arguments);
        }
        if ((fflush(stdout) != 0 || ferror(stdout)) && code == CLI_OK) {
            code = cli_fail(command.name, CLI_OUTPUT, "standard output cannot be written");
        }
    }
    cli_arguments_free(&arguments);
    return code;
}
