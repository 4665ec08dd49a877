// A batch: many garments, each converted by a child process of its own.
//
// OUT/batch.json                report of the run, written last (batch-2-of-5.json of a shard)
// OUT/garments/ID/              everything of one garment; arrives complete, by one rename
// OUT/garments/ID/ID.batch.json record: input, options, what became of it
// OUT/.proxycloth-XXXXXX/       work folder of a run; locked as long as the run lives
#ifndef BATCH_H
#define BATCH_H

#include <cjson/cJSON.h>
#include <sys/resource.h>
#include <sys/types.h>

#include "cli.h"

typedef struct batch_job {
    char *id;   // file name of the garment, unique in the batch
    char *path; // as given or found
    char *real; // without symbolic links and dots
    uint64_t size;
    cli_arguments arguments; // options of this garment
    // Of a line in a manifest, else NULL and 0.
    const char *manifest;
    size_t line;
    cJSON *entry;          // owns the texts in `arguments`
    const char **patterns; // owned; NULL: those of the command line
    bool named;            // the line has an id
    bool shares_id;        // with another garment, before it got digits
    cJSON *record;         // what became of it; NULL: not yet known
} batch_job;

typedef struct batch_plan {
    const cli_command *command;
    const cli_arguments *arguments;
    batch_job *jobs;
    size_t count, capacity;
    unsigned shard, shard_count; // of --shard, 1 of 1 without it
} batch_plan;

// Finds the garments of the command line, names them, and keeps those of the shard, in the order of
// their ids. Prints the message on failure.
int batch_plan_make(batch_plan *plan);
void batch_plan_free(batch_plan *plan);

// Appends a garment. Without `id` its name is that of the file. NULL when memory ran out.
batch_job *batch_plan_add(batch_plan *plan, const char *path, const char *file, const char *id);
void batch_job_free(batch_job *job);
// Sorts by id. Files of the same name in several folders get some digits that depend on their paths
// only, so that they keep them whatever else is converted. Prints a message where two lines of
// manifests ask for the same id.
int batch_plan_tell_apart(batch_plan *plan);
// Appends the lines of a manifest. Prints a message for every line that is wrong.
int batch_read_manifest(batch_plan *plan, const char *path);
// The part of a path behind its last slash.
const char *batch_base_name(const char *path);

// ---- records ------------------------------------------------------------------------------------

typedef enum batch_outcome { BATCH_PENDING, BATCH_DONE, BATCH_FAILED } batch_outcome;

// How a garment ended.
typedef struct batch_ending {
    batch_outcome outcome;
    int code; // exit code of the child; of failures
    const char *message;
    double seconds, cpu_seconds, peak_mib;
} batch_ending;

// The options as --print-options writes them; NULL when memory ran out.
cJSON *batch_options(const cli_arguments *arguments);

// Whether another try may go better without any change.
bool batch_retryable(int code);

// Hashes of input and options, hexadecimal. Returns CLI_OK, or the code of a failure with its
// message.
typedef struct batch_key {
    char input[65], options[65];
} batch_key;
int batch_key_of(const batch_job *job, batch_key *key, char *message, size_t size);

// Makes the job's record, without results.
bool batch_record_make(batch_job *job, const batch_key *key, const batch_ending *ending);

// Reads the record in `folder`/garments/ID; NULL: there is none.
cJSON *batch_record_read(const char *folder, const batch_job *job);
// Whether nothing would change if the garment were converted again.
bool batch_up_to_date(const batch_job *job, const batch_key *key, const cJSON *record,
                      const char *folder);

// ---- files --------------------------------------------------------------------------------------

// Path from parts joined by slashes; release with free().
char *batch_path(const char *folder, const char *name, const char *rest);

// Makes OUT/garments, and removes what the garments of a run left in its work folder.
int batch_workspace_begin(const cli_command *command, const cli_output *output);
void batch_workspace_end(const cli_output *output);

// Writes the record into the work folder of the job and moves it to its place. Returns CLI_OK, or
// the code of a failure with its message.
int batch_land(const cli_output *output, batch_job *job, char *message, size_t size);
// Whether something that no batch made is where the results would go; then with a message.
bool batch_blocked(const char *folder, const batch_job *job, char *message, size_t size);

// Writes JSON beside its target and renames it.
int batch_write_json(const cli_command *command, const cli_output *output, const char *name,
                     const cJSON *json);

// ---- children -----------------------------------------------------------------------------------

// What a child may use.
typedef struct batch_limits {
    uint32_t threads, memory; // MiB
    double seconds, cpu_seconds;
} batch_limits;

typedef struct batch_child {
    pid_t process; // 0: none
    batch_job *job;
    batch_key key;
    double started;
    bool timed_out; // and killed for it
} batch_child;

// Starts to convert a job; its files go into `work`/ID. False: no process could be started.
bool batch_child_start(const char *work, const batch_limits *limits, batch_job *job,
                       batch_child *child);
void batch_child_kill(batch_child *child);

// Tells how a child ended from what wait4 returned; the message is put into `text`.
void batch_child_judge(const char *work, const batch_limits *limits, const batch_child *child,
                       int status, const struct rusage *usage, char *text, size_t size,
                       batch_ending *ending);

#endif
