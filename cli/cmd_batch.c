// batch: many garments, several at once, each in a process of its own.
#define _GNU_SOURCE // sched_getaffinity, wait4
#include "batch.h"

#include <errno.h>
#include <limits.h>
#include <math.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "print.h"

typedef struct batch_run {
    const cli_command *command;
    const cli_arguments *arguments;
    batch_plan plan;
    batch_limits limits;
    batch_child *children; // as many as may run at once
    uint32_t child_count;
    uint32_t running;
    cli_output output;
    double started;
    size_t ended, converted, done, failed, retryable;
    uint64_t bytes, bytes_left; // of the garments that are not up to date, as far as is known
} batch_run;

static uint32_t core_count(void) {
    cpu_set_t set;
    const int count = sched_getaffinity(0, sizeof(set), &set) == 0 ? CPU_COUNT(&set) : 1;
    return count > 0 ? (uint32_t)count : 1;
}

// One thread per garment where there are enough of them; the cores are shared otherwise.
static void set_limits(batch_run *r) {
    const cli_settings *settings = &r->arguments->settings;
    const uint32_t cores = core_count();
    r->child_count = settings->jobs != 0 ? settings->jobs : cores;
    const uint32_t share = cores / r->child_count;
    const double memory =
        (double)sysconf(_SC_PHYS_PAGES) * (double)sysconf(_SC_PAGESIZE) / 1048576.0;
    r->limits = (batch_limits){.threads = settings->threads != 0 ? settings->threads
                                          : share > 1            ? share
                                                                 : 1,
                               .memory = settings->garment_memory != 0
                                             ? settings->garment_memory
                                             : (uint32_t)(memory / r->child_count),
                               .seconds = settings->garment_seconds,
                               .cpu_seconds = settings->garment_cpu_seconds};
}

// ---- what is told -------------------------------------------------------------------------------

// Time goes with the size of the files rather than with their number.
static void show_progress(const batch_run *r) {
    const double seconds = cli_now() - r->started, done = (double)(r->bytes - r->bytes_left);
    char left[48] = "";
    if (done > 0.0) {
        const double rest = seconds * (double)r->bytes_left / done;
        snprintf(left, sizeof(left), ", %.1f per minute, %.0f min %02.0f s left",
                 60.0 * (double)r->converted / seconds, floor(rest / 60.0), fmod(rest, 60.0));
    }
    cli_show_progress("%zu of %zu garments, %zu failed%s", r->ended, r->plan.count, r->failed,
                      left);
}

// The garment's record is final: one line for whoever reads along.
static void finish(batch_run *r, batch_job *job, bool ran) {
    cJSON_AddBoolToObject(job->record, "ran", ran);
    ++r->ended;
    r->converted += ran;
    r->bytes -= ran ? 0 : job->size;
    r->bytes_left -= job->size;
    const char *outcome =
        cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(job->record, "outcome"));
    if (outcome != NULL && strcmp(outcome, "done") == 0) {
        ++r->done;
    } else if (outcome != NULL && strcmp(outcome, "failed") == 0) {
        ++r->failed;
        const cJSON *again = cJSON_GetObjectItemCaseSensitive(job->record, "retryable");
        r->retryable += cJSON_IsTrue(again) ? 1 : 0;
    }
    char *line = cJSON_PrintUnformatted(job->record);
    if (line != NULL) {
        cli_print_line(line);
    }
    cJSON_free(line);
    show_progress(r);
}

static cJSON *report(const batch_run *r) {
    cJSON *json = cJSON_CreateObject();
    json_number(json, "schema", 1);
    json_text(json, "version", pc_version());
    cJSON *shard = json_object(json, "shard");
    json_number(shard, "index", r->plan.shard);
    json_number(shard, "count", r->plan.shard_count);
    json_number(json, "jobs", r->child_count);
    cJSON_AddBoolToObject(json, "complete", r->ended == r->plan.count);
    cJSON *counts = json_object(json, "counts");
    json_number(counts, "garments", (double)r->plan.count);
    json_number(counts, "done", (double)r->done);
    json_number(counts, "failed", (double)r->failed);
    json_number(counts, "pending", (double)(r->plan.count - r->done - r->failed));
    json_number(counts, "ran", (double)r->converted);
    json_number(counts, "retryable", (double)r->retryable);
    cJSON_AddItemToObject(json, "options", batch_options(r->arguments));
    json_number(json_object(json, "timings"), "seconds", cli_now() - r->started);
    cJSON *garments = json_array(json, "garments");
    for (size_t i = 0; i < r->plan.count; ++i) {
        cJSON_AddItemReferenceToArray(garments, r->plan.jobs[i].record);
    }
    return json;
}

static int write_report(const batch_run *r) {
    char name[64] = "batch.json";
    if (r->plan.shard_count > 1) {
        snprintf(name, sizeof(name), "batch-%u-of-%u.json", r->plan.shard, r->plan.shard_count);
    }
    cJSON *json = report(r);
    const int code = batch_write_json(r->command, &r->output, name, json);
    cJSON_Delete(json);
    return code;
}

// ---- what is done -------------------------------------------------------------------------------

// Puts the garment in its place and tells of it.
static void conclude(batch_run *r, batch_job *job, const batch_key *key, batch_ending *ending) {
    char message[4400];
    (void)batch_record_make(job, key, ending);
    const int code = batch_land(&r->output, job, message, sizeof(message));
    if (code != CLI_OK) {
        ending->outcome = BATCH_FAILED;
        ending->code = code;
        ending->message = message;
        (void)batch_record_make(job, key, ending);
        ending->message = NULL; // ends with this function
    }
    finish(r, job, true);
}

// Starts the garment, unless it is up to date or cannot be read.
static void start(batch_run *r, batch_job *job) {
    char message[4400];
    batch_key key;
    batch_ending ending = {.message = message};
    const bool dry = r->arguments->settings.dry_run;
    ending.code = batch_key_of(job, &key, message, sizeof(message));
    if (ending.code == CLI_OK) {
        cJSON *record = batch_record_read(r->arguments->output, job);
        if (batch_up_to_date(job, &key, record, r->arguments->output)) {
            job->record = record;
            finish(r, job, false);
            return;
        }
        cJSON_Delete(record);
    }
    if (ending.code == CLI_OK &&
        batch_blocked(r->arguments->output, job, message, sizeof(message))) {
        ending.code = CLI_OUTPUT;
    }
    ending.outcome = ending.code == CLI_OK ? BATCH_PENDING : BATCH_FAILED;
    if (dry) {
        (void)batch_record_make(job, &key, &ending);
        finish(r, job, false);
        return;
    }
    batch_child *child = r->children;
    while (child->process != 0) {
        ++child;
    }
    child->key = key;
    if (ending.code == CLI_OK && batch_child_start(r->output.staging, &r->limits, job, child)) {
        ++r->running;
        return;
    }
    child->process = 0;
    if (ending.code == CLI_OK) {
        ending.code = CLI_TRANSIENT;
        snprintf(message, sizeof(message), "%s: no process could be started: %s", job->path,
                 strerror(errno));
    }
    ending.outcome = BATCH_FAILED;
    conclude(r, job, &key, &ending);
}

// Takes the children that have ended, and kills those that take too long.
static void reap(batch_run *r) {
    for (uint32_t i = 0; i < r->child_count; ++i) {
        batch_child *child = &r->children[i];
        int status;
        struct rusage usage;
        if (child->process == 0) {
            continue;
        }
        if (wait4(child->process, &status, WNOHANG, &usage) == child->process) {
            char message[4400];
            batch_ending ending;
            batch_child_judge(r->output.staging, &r->limits, child, status, &usage, message,
                              sizeof(message), &ending);
            child->process = 0;
            --r->running;
            conclude(r, child->job, &child->key, &ending);
        } else if (!child->timed_out && cli_now() - child->started > r->limits.seconds) {
            child->timed_out = true;
            batch_child_kill(child);
        }
    }
}

// Waits until fewer than `most` children run, or somebody interrupts.
static void wait_for_children(batch_run *r, uint32_t most) {
    sigset_t ends;
    sigemptyset(&ends);
    sigaddset(&ends, SIGCHLD);
    while (reap(r), r->running >= most && !cli_interrupted()) {
        double pause = 0.2;
        for (uint32_t i = 0; i < r->child_count; ++i) {
            const double left = r->children[i].started + r->limits.seconds - cli_now();
            if (r->children[i].process != 0 && !r->children[i].timed_out) {
                pause = fmax(0.001, fmin(pause, left));
            }
        }
        const struct timespec time = {.tv_nsec = (long)(1e9 * pause)};
        (void)sigtimedwait(&ends, NULL, &time);
    }
}

// What is unfinished is lost: the next run begins it again.
static void stop_children(batch_run *r) {
    for (uint32_t i = 0; i < r->child_count; ++i) {
        if (r->children[i].process != 0) {
            batch_child_kill(&r->children[i]);
            while (waitpid(r->children[i].process, NULL, 0) < 0 && errno == EINTR) {
            }
            r->children[i].process = 0;
        }
    }
    r->running = 0;
}

static int by_size(const void *a, const void *b) {
    const batch_job *left = *(batch_job *const *)a, *right = *(batch_job *const *)b;
    return left->size != right->size ? (left->size < right->size) - (left->size > right->size)
                                     : strcmp(left->id, right->id);
}

// Large garments first, so that none is left alone at the end.
static int convert(batch_run *r) {
    batch_job **order = calloc(r->plan.count + 1, sizeof(*order));
    r->children = calloc(r->child_count, sizeof(*r->children));
    if (order == NULL || r->children == NULL) {
        free(order);
        return cli_fail(r->command->name, CLI_LIMIT, "memory ran out");
    }
    for (size_t i = 0; i < r->plan.count; ++i) {
        order[i] = &r->plan.jobs[i];
        r->bytes += order[i]->size;
    }
    r->bytes_left = r->bytes;
    qsort(order, r->plan.count, sizeof(*order), by_size);
    for (size_t i = 0; i < r->plan.count && !cli_interrupted(); ++i) {
        start(r, order[i]);
        wait_for_children(r, r->child_count);
    }
    wait_for_children(r, 1);
    stop_children(r);
    for (size_t i = 0; i < r->plan.count; ++i) {
        if (r->plan.jobs[i].record == NULL) {
            (void)batch_record_make(&r->plan.jobs[i], &(batch_key){0}, &(batch_ending){0});
            cJSON_AddBoolToObject(r->plan.jobs[i].record, "ran", false);
        }
    }
    free(order);
    return CLI_OK;
}

// The exit code tells whether another run may help.
static int summarize(const batch_run *r) {
    if (!r->arguments->settings.quiet) {
        fprintf(stderr,
                "proxycloth batch: note: %zu garments: %zu done, %zu failed, %zu pending; %zu "
                "tried in %.1f s\n",
                r->plan.count, r->done, r->failed, r->plan.count - r->done - r->failed,
                r->converted, cli_now() - r->started);
    }
    if (r->arguments->settings.dry_run) {
        return CLI_OK;
    }
    return r->retryable > 0 ? CLI_TRANSIENT : r->failed > 0 ? CLI_FAILED : CLI_OK;
}

// The page over all garments, when there is something new to see. Shards are collected by a run
// without --shard, which also writes their page.
static int write_page(const batch_run *r) {
    char page[PATH_MAX];
    snprintf(page, sizeof(page), "%s/report.html", r->output.folder);
    if (cli_interrupted() || r->plan.shard_count > 1 ||
        (r->converted == 0 && access(page, F_OK) == 0)) {
        return CLI_OK;
    }
    return cli_write_page(r->command, r->output.folder, NULL);
}

static int run_in_folder(batch_run *r) {
    int code = cli_output_begin(r->command, r->arguments->output, &r->output);
    if (code == CLI_OK) {
        code = batch_workspace_begin(r->command, &r->output);
    }
    if (code == CLI_OK) {
        code = convert(r);
    }
    if (code == CLI_OK) {
        code = write_report(r);
    }
    if (code == CLI_OK) {
        code = write_page(r);
    }
    batch_workspace_end(&r->output);
    cli_output_end(&r->output);
    return code;
}

int cli_run_batch(const cli_command *command, cli_arguments *arguments) {
    batch_run r = {.command = command,
                   .arguments = arguments,
                   .plan = {.command = command, .arguments = arguments},
                   .started = cli_now()};
    sigset_t ends;
    sigemptyset(&ends);
    sigaddset(&ends, SIGCHLD);
    sigprocmask(SIG_BLOCK, &ends, NULL); // it is waited for
    signal(SIGPIPE, SIG_IGN);            // the garments matter more than who reads along
    cli_catch_signals();
    cli_set_messages(command, arguments);
    set_limits(&r);
    int code = batch_plan_make(&r.plan);
    if (code == CLI_OK && arguments->settings.dry_run) {
        code = convert(&r);
    } else if (code == CLI_OK) {
        code = run_in_folder(&r);
    }
    if (code == CLI_OK) {
        code = summarize(&r);
    }
    if (cli_interrupted()) {
        code = cli_fail_interrupted(command->name);
    }
    free(r.children);
    batch_plan_free(&r.plan);
    return code;
}
