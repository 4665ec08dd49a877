// One garment of a batch in a process of its own: `build` behind limits of memory and time.
#define _DEFAULT_SOURCE // RLIMIT_DATA, wait4
#define _POSIX_C_SOURCE 200809L
#include "batch.h"

#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "child.h"

// Messages go into the log; what stands there last is the reason of a failure.
static bool redirect(const char *log) {
    const int null = open("/dev/null", O_RDWR);
    const int file = open(log, O_WRONLY | O_CREAT | O_TRUNC, 0666);
    return null >= 0 && file >= 0 && dup2(null, STDIN_FILENO) >= 0 &&
           dup2(null, STDOUT_FILENO) >= 0 && dup2(file, STDERR_FILENO) >= 0;
}

_Noreturn static void run_child(const char *folder, const char *log, const batch_limits *limits,
                                batch_job *job) {
    cli_command build;
    const char *inputs[] = {job->path};
    cli_arguments *arguments = &job->arguments;
    arguments->inputs = inputs;
    arguments->input_count = 1;
    arguments->output = folder;
    arguments->name = job->id;
    arguments->settings.threads = limits->threads;
    arguments->settings.quiet = !arguments->settings.verbose;
    if (mkdir(folder, 0777) != 0 || !redirect(log) || !cli_find_command("build", &build)) {
        _exit(CLI_OUTPUT);
    }
    child_limit_seconds(limits->cpu_seconds);
    child_limit_memory(RLIMIT_DATA, limits->memory);
    const int code = build.run(&build, arguments);
    _exit(fflush(NULL) == 0 ? code : CLI_OUTPUT);
}

bool batch_child_start(const char *work, const batch_limits *limits, batch_job *job,
                       batch_child *child) {
    char *folder = batch_path(work, job->id, "");
    char *log = folder != NULL ? batch_path(folder, job->id, ".log") : NULL;
    child->job = job;
    child->timed_out = false;
    child->started = cli_now();
    child->process = log != NULL ? child_fork() : -1;
    if (child->process == 0) {
        run_child(folder, log, limits, job);
    }
    free(log);
    free(folder);
    return child->process > 0;
}

void batch_child_kill(batch_child *child) { (void)kill(-child->process, SIGKILL); }

// The last error in the log, without "proxycloth build: error: ".
static bool read_error(const char *work, const batch_job *job, char *text, size_t size) {
    static const char mark[] = ": error: ";
    char *folder = batch_path(work, job->id, "");
    char *log = folder != NULL ? batch_path(folder, job->id, ".log") : NULL;
    FILE *file = log != NULL ? fopen(log, "r") : NULL;
    char line[2100];
    bool found = false;
    while (file != NULL && fgets(line, sizeof(line), file) != NULL) {
        const char *at = strstr(line, mark);
        if (at != NULL) {
            line[strcspn(line, "\n")] = '\0';
            snprintf(text, size, "%s", at + strlen(mark));
            found = true;
        }
    }
    if (file != NULL) {
        fclose(file);
    }
    free(log);
    free(folder);
    return found;
}

static int judge_signal(const batch_limits *limits, const batch_child *child, int number,
                        char *text, size_t size) {
    if (child->timed_out) {
        snprintf(text, size, "%s: the garment took longer than %.10g s; raise --garment-seconds",
                 child->job->path, limits->seconds);
        return CLI_LIMIT;
    }
    if (number == SIGXCPU) {
        snprintf(text, size,
                 "%s: the garment used more than %.10g s of processor time; raise "
                 "--garment-cpu-seconds",
                 child->job->path, limits->cpu_seconds);
        return CLI_LIMIT;
    }
    const bool ours = number == SIGSEGV || number == SIGABRT || number == SIGBUS ||
                      number == SIGFPE || number == SIGILL;
    snprintf(text, size, "%s: the program %s (%s)", child->job->path,
             ours ? "crashed" : "was ended from outside", strsignal(number));
    return ours ? CLI_INTERNAL : CLI_TRANSIENT;
}

void batch_child_judge(const char *work, const batch_limits *limits, const batch_child *child,
                       int status, const struct rusage *usage, char *text, size_t size,
                       batch_ending *ending) {
    *ending = (batch_ending){.outcome = BATCH_FAILED,
                             .message = text,
                             .seconds = cli_now() - child->started,
                             .cpu_seconds =
                                 (double)(usage->ru_utime.tv_sec + usage->ru_stime.tv_sec) +
                                 1e-6 * (double)(usage->ru_utime.tv_usec + usage->ru_stime.tv_usec),
                             .peak_mib = (double)usage->ru_maxrss / 1024.0};
    if (WIFSIGNALED(status)) {
        ending->code = judge_signal(limits, child, WTERMSIG(status), text, size);
        return;
    }
    ending->code = WEXITSTATUS(status);
    if (ending->code == CLI_OK) {
        ending->outcome = BATCH_DONE;
        return;
    }
    // A child stops in an orderly way when somebody ends it, not the batch.
    ending->code = ending->code == CLI_INTERRUPTED ? CLI_TRANSIENT : ending->code;
    if (!read_error(work, child->job, text, size)) {
        snprintf(text, size, "%s: the program ended with code %d", child->job->path, ending->code);
    }
}
