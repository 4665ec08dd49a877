// Importing in a child process. assimp crashes or hangs on some damaged files, so it runs behind
// limits of memory and time, and the parent believes nothing it says. A plain fork does: no thread
// exists yet, and nothing has to be looked up or passed as with a second program.
#define _DEFAULT_SOURCE // RLIMIT_AS
#define _POSIX_C_SOURCE 200809L
#include "child.h"
#include "scene.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <poll.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

_Noreturn static void run_child(const cli_settings *settings, const char *path, scene_format format,
                                int descriptor) {
    const int null = open("/dev/null", O_RDWR);
    if (null >= 0) {
        dup2(null, STDIN_FILENO);
        dup2(null, STDOUT_FILENO);
        dup2(null, STDERR_FILENO);
    }
    child_limit(RLIMIT_FSIZE, 0.0); // also where scene_isolate is not available; pipes have no size
    child_limit_seconds(settings->import_seconds);
    child_limit_memory(RLIMIT_AS, settings->import_memory);
    (void)scene_isolate(descriptor);
    _exit(scene_read(path, format, descriptor));
}

typedef enum receive_end {
    END_OF_DATA,
    END_TIME,
    END_MEMORY,
    END_INTERRUPT,
    END_ERROR
} receive_end;

typedef struct received {
    char *bytes;
    size_t size, capacity;
} received;

// Collects what the child writes until it closes the pipe.
static receive_end receive(int descriptor, double deadline, size_t maximum, received *data) {
    for (;;) {
        if (cli_interrupted()) {
            return END_INTERRUPT;
        }
        const double left = deadline - cli_now();
        if (left <= 0.0) {
            return END_TIME;
        }
        struct pollfd wait = {.fd = descriptor, .events = POLLIN};
        // Waking up now and then covers signals that arrive just before poll.
        const int ready = poll(&wait, 1, left > 0.2 ? 200 : (int)ceil(left * 1000.0));
        if (ready == 0 || (ready < 0 && errno == EINTR)) {
            continue;
        }
        if (data->size == data->capacity) {
            const size_t grown = data->capacity == 0 ? 1 << 16 : 2 * data->capacity;
            char *bytes = grown <= maximum ? realloc(data->bytes, grown) : NULL;
            if (bytes == NULL) {
                return END_MEMORY;
            }
            data->bytes = bytes;
            data->capacity = grown;
        }
        const ssize_t count =
            read(descriptor, data->bytes + data->size, data->capacity - data->size);
        if (count == 0) {
            return END_OF_DATA;
        }
        if (count < 0 && errno != EINTR) {
            return END_ERROR;
        }
        data->size += count > 0 ? (size_t)count : 0;
    }
}

// Waits for the child until the deadline, then ends its whole group.
static int reap(pid_t child, double deadline, bool *timed_out) {
    int status = 0;
    *timed_out = false;
    for (;;) {
        const pid_t ended = waitpid(child, &status, WNOHANG);
        if (ended == child || (ended < 0 && errno != EINTR)) {
            return status;
        }
        if (cli_now() >= deadline || cli_interrupted()) {
            *timed_out = !cli_interrupted();
            kill(-child, SIGKILL);
            while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
            }
            return status;
        }
        const struct timespec pause = {.tv_nsec = 2000000};
        nanosleep(&pause, NULL);
    }
}

static int fail_time(const char *command, const char *path, double seconds) {
    return cli_fail(command, CLI_LIMIT,
                    "%s: reading took longer than %.10g s; the file may be damaged, or raise "
                    "--import-seconds",
                    path, seconds);
}

static int fail_memory(const char *command, const char *path, uint32_t mebibytes) {
    return cli_fail(command, CLI_LIMIT,
                    "%s: reading needs more than %u MiB of memory; the file may be damaged, or "
                    "raise --import-memory",
                    path, mebibytes);
}

// Turns the way the child ended, and what it sent, into a scene or a message.
static int judge(const char *command, const char *path, const cli_settings *settings, int status,
                 received *data, scene_data *scene) {
    if (WIFSIGNALED(status)) {
        const int number = WTERMSIG(status);
        if (number == SIGXCPU) {
            return fail_time(command, path, settings->import_seconds);
        }
        return cli_fail(command, CLI_IMPORTER,
                        "%s: the importer crashed (%s); the file may be damaged, export it again",
                        path, strsignal(number));
    }
    scene_failure failure;
    if (data->size == sizeof(failure)) {
        memcpy(&failure, data->bytes, sizeof(failure));
        if (memcmp(failure.magic, SCENE_FAILURE_MAGIC, sizeof(failure.magic)) == 0) {
            failure.message[sizeof(failure.message) - 1] = '\0';
            return failure.out_of_memory != 0
                       ? fail_memory(command, path, settings->import_memory)
                       : cli_fail(command, CLI_INPUT, "%s: %s", path, failure.message);
        }
    }
    if (WEXITSTATUS(status) != 0) {
        return cli_fail(command, CLI_IMPORTER,
                        "%s: the importer ended with code %d; the file may be damaged, export it "
                        "again",
                        path, WEXITSTATUS(status));
    }
    const char *defect = scene_open(data->bytes, data->size, scene);
    data->bytes = NULL;
    if (defect != NULL) {
        scene_free(scene);
        return cli_fail(command, CLI_IMPORTER,
                        "%s: the importer returned %s; the file may be damaged, export it again",
                        path, defect);
    }
    return CLI_OK;
}

int scene_import(const cli_command *command, const cli_arguments *arguments, const char *path,
                 scene_data *scene) {
    memset(scene, 0, sizeof(*scene));
    scene_format format;
    const int code = scene_sniff(command->name, path, &format);
    if (code != CLI_OK) {
        return code;
    }
    const cli_settings *settings = &arguments->settings;
    int ends[2];
    if (pipe(ends) != 0) {
        return cli_fail(command->name, CLI_TRANSIENT, "%s: %s", path, strerror(errno));
    }
    const pid_t child = child_fork();
    if (child < 0) {
        close(ends[0]);
        close(ends[1]);
        return cli_fail(command->name, CLI_TRANSIENT, "%s: %s", path, strerror(errno));
    }
    if (child == 0) {
        close(ends[0]);
        run_child(settings, path, format, ends[1]);
    }
    close(ends[1]);

    received data = {0};
    const double deadline = cli_now() + settings->import_seconds;
    const receive_end end =
        receive(ends[0], deadline, (size_t)settings->import_memory << 20, &data);
    close(ends[0]);
    bool timed_out = false;
    if (end != END_OF_DATA) {
        kill(-child, SIGKILL);
    }
    const int status = reap(child, end == END_OF_DATA ? deadline : HUGE_VAL, &timed_out);
    int result = CLI_OK;
    if (end == END_INTERRUPT || cli_interrupted()) {
        result = cli_fail_interrupted(command->name);
    } else if (end == END_TIME || timed_out) {
        result = fail_time(command->name, path, settings->import_seconds);
    } else if (end == END_MEMORY) {
        result = fail_memory(command->name, path, settings->import_memory);
    } else if (end == END_ERROR) {
        result = cli_fail(command->name, CLI_TRANSIENT, "%s: the importer cannot be heard", path);
    } else {
        result = judge(command->name, path, settings, status, &data, scene);
    }
    free(data.bytes);
    return result;
}
