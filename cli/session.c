// Messages, signals and the library context of one run.
#define _POSIX_C_SOURCE 200809L
#include "cli.h"

#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

// What the progress line shows; there is one run per process.
static struct {
    const char *command;
    bool draw;
    bool drawn;
    bool verbose, quiet;
    double last;
    const char *stage;
} line;

static volatile sig_atomic_t interrupted;
static volatile sig_atomic_t killable; // nothing but empty folders would stay behind
static char *const *volatile abandoned;

// Length of the UTF-8 sequence at `text`, 0 where there is none.
static size_t utf8_length(const unsigned char *text) {
    const unsigned char c = text[0];
    const size_t length = c < 0x80                ? 1
                          : c >= 0xc2 && c < 0xe0 ? 2
                          : c >= 0xe0 && c < 0xf0 ? 3
                          : c >= 0xf0 && c < 0xf5 ? 4
                                                  : 0;
    for (size_t i = 1; i < length; ++i) {
        if ((text[i] & 0xc0) != 0x80) {
            return 0;
        }
    }
    // Overlong forms, surrogates and values beyond U+10FFFF.
    if ((c == 0xe0 && text[1] < 0xa0) || (c == 0xed && text[1] >= 0xa0) ||
        (c == 0xf0 && text[1] < 0x90) || (c == 0xf4 && text[1] >= 0x90)) {
        return 0;
    }
    return length;
}

bool cli_valid_text(const char *text) {
    size_t length = 1;
    for (; *text != '\0' && length != 0; text += length) {
        length = utf8_length((const unsigned char *)text);
    }
    return length != 0;
}

void cli_clean_text(char *out, size_t size, const char *text) {
    size_t used = 0;
    while (*text != '\0') {
        const size_t length = utf8_length((const unsigned char *)text);
        const bool plain = length > 1 || (length == 1 && *text >= 0x20 && *text != 0x7f);
        if (used + (plain ? length : 1) + 1 > size) {
            break;
        }
        if (plain) {
            memcpy(out + used, text, length);
            used += length;
        } else {
            out[used++] = '?';
        }
        text += length != 0 ? length : 1;
    }
    out[used] = '\0';
}

static void clear_line(void) {
    if (line.drawn) {
        fputs("\r\033[K", stderr);
        line.drawn = false;
    }
}

static void print_message(const char *command, const char *kind, const char *format,
                          va_list arguments) {
    char raw[2048], text[2048];
    vsnprintf(raw, sizeof(raw), format, arguments);
    cli_clean_text(text, sizeof(text), raw);
    clear_line();
    fprintf(stderr, "proxycloth%s%s: %s: %s\n", command != NULL ? " " : "",
            command != NULL ? command : "", kind, text);
}

int cli_fail(const char *command, cli_exit code, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    print_message(command, "error", format, arguments);
    va_end(arguments);
    return (int)code;
}

void cli_warn(const char *command, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    print_message(command, "warning", format, arguments);
    va_end(arguments);
}

int cli_fail_interrupted(const char *command) {
    return cli_fail(command, CLI_INTERRUPTED, "interrupted");
}

int cli_fail_status(const char *command, pc_context *context, pc_status status, const char *subject,
                    bool writing) {
    cli_exit code = CLI_FAILED;
    switch (status) {
    case PC_ERROR_CANCELLED:
        return cli_fail_interrupted(command);
    case PC_ERROR_INVALID_OPTIONS:
        code = CLI_USAGE;
        break;
    case PC_ERROR_INVALID_MESH:
    case PC_ERROR_FORMAT:
        code = CLI_INPUT;
        break;
    case PC_ERROR_IO:
        code = writing ? CLI_OUTPUT : CLI_INPUT;
        break;
    case PC_ERROR_OUT_OF_MEMORY:
        code = CLI_LIMIT;
        break;
    case PC_ERROR_INVALID_ARGUMENT:
    case PC_ERROR_INTERNAL:
        code = CLI_INTERNAL;
        break;
    default:
        break;
    }
    const char *message = pc_context_error(context)->message;
    // The library names the file itself where a file is at fault.
    if (subject == NULL || strstr(message, subject) != NULL) {
        return cli_fail(command, code, "%s", message);
    }
    return cli_fail(command, code, "%s: %s", subject, message);
}

void cli_warn_report(const char *command, const char *stage, const pc_record *record,
                     const void *report) {
    if (line.quiet) {
        return;
    }
    for (size_t i = 0; i < record->field_count; ++i) {
        const pc_field *field = &record->fields[i];
        const double value = pc_field_number(field, report);
        if (field->warning == NULL || value == 0.0) {
            continue;
        }
        if (field->type == PC_FIELD_BOOL || field->type == PC_FIELD_CHOICE) {
            cli_warn(command, "%s: %s", stage, field->warning);
        } else {
            cli_warn(command, "%s: %s (%.10g)", stage, field->warning, value);
        }
    }
}

// Runs in a signal handler: only what is safe there.
_Noreturn static void end_at_once(void) {
    static const char erase[] = "\r\033[K";
    static const char message[] = "proxycloth: error: interrupted\n";
    for (char *const *folder = abandoned; folder != NULL && *folder != NULL; ++folder) {
        (void)rmdir(*folder);
    }
    ssize_t written = line.draw ? write(STDERR_FILENO, erase, sizeof(erase) - 1) : 0;
    written += write(STDERR_FILENO, message, sizeof(message) - 1);
    (void)written;
    _exit(CLI_INTERRUPTED);
}

static void note_signal(int number) {
    (void)number;
    if (interrupted != 0 && killable != 0) {
        end_at_once();
    }
    interrupted = 1;
}

void cli_begin_writing(void) { killable = 0; }

void cli_abandon(char *const *folders) { abandoned = folders; }

void cli_catch_signals(void) {
    struct sigaction action = {.sa_handler = note_signal};
    sigemptyset(&action.sa_mask);
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);
    struct sigaction hangup;
    if (sigaction(SIGHUP, NULL, &hangup) == 0 && hangup.sa_handler != SIG_IGN) { // nohup
        sigaction(SIGHUP, &action, NULL);
    }
    signal(SIGXFSZ, SIG_IGN); // a file that gets too large is a failed write, and cleaned up
}

bool cli_interrupted(void) { return interrupted != 0; }

double cli_now(void) {
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

void cli_show_progress(const char *format, ...) {
    if (!line.draw) {
        return;
    }
    va_list arguments;
    va_start(arguments, format);
    fputs("\r\033[K", stderr);
    vfprintf(stderr, format, arguments);
    va_end(arguments);
    fflush(stderr);
    line.drawn = true;
}

void cli_print_line(const char *text) {
    clear_line();
    puts(text);
    fflush(stdout);
}

static bool on_progress(void *user, const char *stage, double fraction) {
    (void)user;
    const double time = line.draw ? cli_now() : 0.0;
    if (line.draw && (time - line.last > 0.1 || stage != line.stage)) {
        cli_show_progress("%-10s %3.0f %%", stage, 100.0 * fraction);
        line.last = time;
        line.stage = stage;
    }
    return !cli_interrupted();
}

static void on_log(void *user, pc_log_level level, const char *stage, const char *message) {
    (void)user;
    if (line.quiet || (level != PC_LOG_WARNING && !line.verbose)) {
        return;
    }
    // Messages may start with the stage's name already.
    const size_t length = strlen(stage);
    const bool named = strncmp(message, stage, length) == 0 && message[length] == ':';
    clear_line();
    fprintf(stderr, "proxycloth %s: %s: %s%s%s\n", line.command,
            level == PC_LOG_WARNING ? "warning" : "note", named ? "" : stage, named ? "" : ": ",
            message);
}

static void clear_at_exit(void) { clear_line(); }

void cli_set_messages(const cli_command *command, const cli_arguments *arguments) {
    line.command = command->name;
    line.quiet = arguments->settings.quiet;
    line.verbose = arguments->settings.verbose;
    line.draw = !line.quiet && isatty(STDERR_FILENO);
    atexit(clear_at_exit);
}

int cli_context(const cli_command *command, const cli_arguments *arguments, pc_context **context) {
    cli_set_messages(command, arguments);
    const pc_context_options options = {
        .threads = arguments->settings.threads, .log = on_log, .progress = on_progress};
    if (pc_context_create(&options, context) != PC_OK) {
        return cli_fail(command->name, CLI_LIMIT, "memory ran out");
    }
    killable = 1;
    return CLI_OK;
}
