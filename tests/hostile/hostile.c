// Runs the program over damaged and hand-made files and checks what it promises of them: an exit
// code from the documented ones, one line of error, all results or none, no hang, bounded memory.
// usage: proxycloth_hostile PROGRAM FOLDER FIRST COUNT [--large] FILE...
//   FIRST COUNT   numbers of the damaged files: number n is file n modulo #FILES with seed n.
//                 The hand-made ones run when FIRST is 0.
//   --large       hand-made files of a million triangles
// Files that break a promise stay in FOLDER.
#define _DEFAULT_SOURCE // wait4
#define _POSIX_C_SOURCE 200809L
#include "hostile.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

enum { IMPORT_SECONDS = 20, IMPORT_MEBIBYTES = 1024, LIMIT_SECONDS = 60, LIMIT_MEBIBYTES = 3072 };

typedef struct outcome {
    int status;     // of wait
    double seconds; // CPU
    long mebibytes; // at most resident
} outcome;

typedef struct campaign {
    const char *program, *folder;
    char input[512], output[512], messages[512];
    size_t count, failed, codes[9]; // the last one counts all others
    double longest;
    long largest;
} campaign;

static text read_file(const char *path) {
    text content = {0};
    char buffer[65536];
    FILE *file = fopen(path, "rb");
    size_t count;
    while (file != NULL && (count = fread(buffer, 1, sizeof(buffer), file)) > 0) {
        text_append(&content, buffer, count);
    }
    if (file != NULL) {
        fclose(file);
    }
    text_append(&content, "", 1); // terminated
    --content.size;
    return content;
}

static void write_file(const char *path, const text *content) {
    FILE *file = fopen(path, "wb");
    if (file == NULL || fwrite(content->bytes, 1, content->size, file) != content->size ||
        fclose(file) != 0) {
        perror(path);
        exit(1);
    }
}

static void run_program(const campaign *c) {
    char seconds[16], mebibytes[16];
    snprintf(seconds, sizeof(seconds), "%d", IMPORT_SECONDS);
    snprintf(mebibytes, sizeof(mebibytes), "%d", IMPORT_MEBIBYTES);
    const int messages = open(c->messages, O_WRONLY | O_CREAT | O_TRUNC, 0600);
    const int null = open("/dev/null", O_RDONLY);
    dup2(null, STDIN_FILENO);
    dup2(messages, STDOUT_FILENO);
    dup2(messages, STDERR_FILENO);
    // At the first limit comes SIGXCPU, which tells a hang from a crash; at the second SIGKILL.
    const struct rlimit no_core = {0, 0}, cpu = {LIMIT_SECONDS, LIMIT_SECONDS + 5};
    setrlimit(RLIMIT_CORE, &no_core);
    setrlimit(RLIMIT_CPU, &cpu); // the load of the machine does not count
    execl(c->program, c->program, "build", c->input, "-o", c->output, "--quiet", "--import-seconds",
          seconds, "--import-memory", mebibytes, "--voxels", "12", "--vertices", "32", "--frames",
          "6", "--epochs", "2", "--threads", "1", "--no-png", (char *)NULL);
    _exit(127);
}

static outcome observe(const campaign *c) {
    outcome result = {0};
    const pid_t child = fork();
    if (child == 0) {
        run_program(c);
    }
    struct rusage usage;
    while (wait4(child, &result.status, 0, &usage) < 0 && errno == EINTR) {
    }
    result.seconds = (double)(usage.ru_utime.tv_sec + usage.ru_stime.tv_sec) +
                     1e-6 * (double)(usage.ru_utime.tv_usec + usage.ru_stime.tv_usec);
    result.mebibytes = usage.ru_maxrss / 1024;
    return result;
}

// Removes what is in the output folder; returns how many entries there were.
static size_t clear_output(const campaign *c) {
    size_t count = 0;
    DIR *folder = opendir(c->output);
    const struct dirent *entry;
    while (folder != NULL && (entry = readdir(folder)) != NULL) {
        char path[1024];
        if (strcmp(entry->d_name, ".") != 0 && strcmp(entry->d_name, "..") != 0) {
            snprintf(path, sizeof(path), "%s/%s", c->output, entry->d_name);
            ++count;
            (void)remove(path);
        }
    }
    if (folder != NULL) {
        closedir(folder);
        (void)rmdir(c->output);
        return count + (count == 0); // an empty folder is a trace as well
    }
    return count;
}

// What is wrong with the way a run ended; NULL: nothing.
static const char *judge(const campaign *c, const outcome *o) {
    const text said = read_file(c->messages);
    const size_t left = clear_output(c);
    size_t lines = 0;
    for (size_t i = 0; i < said.size; ++i) {
        lines += said.bytes[i] == '\n';
    }
    const bool error_line = lines == 1 && said.bytes[said.size - 1] == '\n' &&
                            strncmp(said.bytes, "proxycloth build: error: ", 25) == 0;
    const bool silent = said.size == 0;
    free(said.bytes);
    if (WIFSIGNALED(o->status) && WTERMSIG(o->status) == SIGXCPU) {
        return "it hangs";
    }
    if (WIFSIGNALED(o->status) && WTERMSIG(o->status) == SIGKILL) {
        return "it was killed, by the limit of processor time or for lack of memory";
    }
    if (o->mebibytes > LIMIT_MEBIBYTES) {
        return "it needs too much memory";
    }
    if (!WIFEXITED(o->status)) {
        return "it crashed";
    }
    switch (WEXITSTATUS(o->status)) {
    case 0:
        return !silent ? "it talks" : left != 4 ? "results are missing" : NULL;
    case 1:
    case 3:
    case 6:
    case 7:
        return !error_line ? "not one line of error"
               : left != 0 ? "it left something behind"
                           : NULL;
    default:
        return "an exit code that no input should lead to";
    }
}

static void try_file(campaign *c, const char *extension, const text *file, const char *what) {
    snprintf(c->input, sizeof(c->input), "%s/input.%s", c->folder, extension);
    write_file(c->input, file);
    const outcome o = observe(c);
    const char *defect = judge(c, &o);
    const int code = WIFEXITED(o.status) ? WEXITSTATUS(o.status) : 8;
    ++c->count;
    ++c->codes[code < 8 ? code : 8];
    c->longest = o.seconds > c->longest ? o.seconds : c->longest;
    c->largest = o.mebibytes > c->largest ? o.mebibytes : c->largest;
    if (defect != NULL || o.seconds > 10.0) {
        const text said = read_file(c->messages);
        char kept[600];
        snprintf(kept, sizeof(kept), "%s/%s-%zu.%s", c->folder, defect != NULL ? "failed" : "slow",
                 c->count, extension);
        printf("%s: %s: %s (status %d, %.1f s, %ld MiB): %.300s\n", kept, what,
               defect != NULL ? defect : "slow", o.status, o.seconds, o.mebibytes, said.bytes);
        free(said.bytes);
        fflush(stdout);
        (void)rename(c->input, kept);
        c->failed += defect != NULL;
    }
    (void)remove(c->input);
}

int main(int argc, char **argv) {
    const bool large = argc > 5 && strcmp(argv[5], "--large") == 0;
    char **files = argv + (large ? 6 : 5);
    const size_t file_count = argc > 5 ? (size_t)(argv + argc - files) : 0;
    if (file_count == 0) {
        fprintf(stderr, "usage: %s PROGRAM FOLDER FIRST COUNT [--large] FILE...\n", argv[0]);
        return 2;
    }
    campaign c = {.program = argv[1], .folder = argv[2]};
    if (mkdir(c.folder, 0700) != 0 && errno != EEXIST) {
        perror(c.folder);
        return 1;
    }
    snprintf(c.output, sizeof(c.output), "%s/out", c.folder);
    snprintf(c.messages, sizeof(c.messages), "%s/messages", c.folder);
    (void)clear_output(&c); // of an earlier run that was interrupted
    const size_t first = strtoul(argv[3], NULL, 10), count = strtoul(argv[4], NULL, 10);
    text file = {0};
    const char *name = NULL, *extension = NULL;
    for (size_t i = 0; first == 0 && hand_made(i, large, &file, &name, &extension); ++i) {
        try_file(&c, extension, &file, name);
    }
    free(file.bytes);
    for (size_t n = first; n < first + count; ++n) {
        const char *path = files[n % file_count], *dot = strrchr(path, '.');
        char ways[128], what[1024];
        text damaged = read_file(path);
        mutate(&damaged, n, ways, sizeof(ways));
        snprintf(what, sizeof(what), "number %zu of %s, %s", n, path, ways);
        try_file(&c, dot != NULL ? dot + 1 : "obj", &damaged, what);
        free(damaged.bytes);
    }
    (void)remove(c.messages);
    printf("%zu files: exit code 0 %zu, 1 %zu, 3 %zu, 6 %zu, 7 %zu, others %zu; at most %.1f s and "
           "%ld "
           "MiB; %zu broken promises\n",
           c.count, c.codes[0], c.codes[1], c.codes[3], c.codes[6], c.codes[7],
           c.codes[2] + c.codes[4] + c.codes[5] + c.codes[8], c.longest, c.largest, c.failed);
    return c.failed == 0 ? 0 : 1;
}
