// What the files of the command line program share: commands, arguments, messages, signals.
#ifndef CLI_H
#define CLI_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "proxycloth/proxycloth.h"

typedef enum cli_exit {
    CLI_OK = 0,
    CLI_FAILED = 1,
    CLI_USAGE = 2,
    CLI_INPUT = 3,
    CLI_OUTPUT = 4,
    CLI_INTERNAL = 5,
    CLI_IMPORTER = 6,   // the importer crashed
    CLI_LIMIT = 7,      // of time or memory
    CLI_TRANSIENT = 75, // may go well another time; EX_TEMPFAIL of sysexits.h
    CLI_INTERRUPTED = 130
} cli_exit;

// What becomes of a file with several garments.
typedef enum cli_part_mode { CLI_PARTS_TOGETHER, CLI_PARTS_SEPARATE } cli_part_mode;

// Options of the program itself that are numbers or switches; described by cli_settings_record.
typedef struct cli_settings {
    uint32_t threads;
    uint32_t import_memory; // MiB
    double import_seconds;
    uint32_t parts; // cli_part_mode
    bool png;
    bool strip;
    bool json;
    bool motion;
    bool print_options;
    bool licences;
    uint32_t jobs;           // 0: one per core
    uint32_t garment_memory; // MiB; 0: the machine's over the jobs
    double garment_seconds;
    double garment_cpu_seconds;
    bool dry_run;
    bool force;
    bool retry_failed;
    bool changes;
    bool quiet;
    bool verbose;
} cli_settings;

extern const pc_record cli_settings_record;
// Those that an options file may hold, under "program": the first fields of the same struct.
extern const pc_record cli_file_settings_record;

// Which options a command accepts, besides --help, --quiet, --verbose and --threads.
typedef enum cli_accepts {
    CLI_OUTPUT_FILE = 1 << 0,   // -o FILE
    CLI_OUTPUT_FOLDER = 1 << 1, // -o OUTDIR
    CLI_NAME = 1 << 2,          // --name
    CLI_MESH = 1 << 3,          // --mesh, --import-memory, --import-seconds
    CLI_JSON = 1 << 4,          // --json
    CLI_PNG = 1 << 5,           // --png, --strip
    CLI_MOTION = 1 << 6,        // --motion and its options
    CLI_SCENARIO = 1 << 7,      // --scenario
    CLI_WRITE_LP = 1 << 8,      // --write-lp
    CLI_PARTS = 1 << 9,         // --parts
    CLI_OPTIONS = 1 << 10,      // --options, --preset, --print-options
    CLI_BATCH = 1 << 11,        // --jobs, --shard and the like
    CLI_OUTPUT_PAGE = 1 << 12,  // -o FILE.html
    CLI_LICENCES = 1 << 13,     // --licences
    CLI_REGRESS = 1 << 14       // --tolerances, --changes
} cli_accepts;

typedef struct cli_arguments {
    const char **inputs;
    size_t input_count;
    const char *output; // NULL: not given, here and below
    const char *name;
    const char *preset; // its options are in `options`, as are those of the files below,
    const char *options_file;
    const char *scenario; // each overriding the one before; flags override them all
    const char *lp;
    const char *shard; // "2/5"
    const char *tolerances;
    const char **patterns;
    size_t pattern_count;
    bool help;
    cli_settings settings;
    pc_options options;
    pc_evaluate_motion_options motion;
    pc_series levels; // --vertices 64,128: one result each; empty: options.simplify.vertices
} cli_arguments;

typedef struct cli_command {
    const char *name;
    const char *operands; // as shown in the usage line
    const char *summary;
    const char *details; // more lines for `help COMMAND`
    const char *example; // arguments of a run that makes sense
    size_t minimum_inputs, maximum_inputs;
    unsigned accepts; // cli_accepts
    unsigned stages;  // bit per pc_stage whose options are accepted
    pc_stage stage;   // of the commands that run one stage
    int (*run)(const struct cli_command *command, cli_arguments *arguments);
} cli_command;

// A flag that takes a text.
typedef struct cli_text_flag {
    const char *name;
    const char *value; // what help texts call its value
    const char *help;  // one sentence
    unsigned accepts;  // cli_accepts, one bit
    size_t offset;     // in cli_arguments, of a pointer or, if repeatable, of the patterns
    bool repeatable;
} cli_text_flag;

// The flags of a command, in the order of the help text; NULL behind the last.
const cli_text_flag *cli_text_flag_at(const cli_command *command, size_t index);
// The same for the settings.
const pc_field *cli_setting_at(const cli_command *command, size_t index);

// Fills `command` with the command of that name; false when there is none. Commands are numbered
// from 0 in the order of the help text.
bool cli_find_command(const char *name, cli_command *command);
bool cli_command_at(size_t index, cli_command *command);

// The closest of `candidates` to a misspelt word, or NULL; add candidates one by one.
typedef struct cli_guess {
    const char *word;
    size_t distance;
    char best[64];
} cli_guess;
void cli_guess_add(cli_guess *guess, const char *candidate);

// Reads the arguments behind the command's name. Prints the message on failure.
int cli_parse(const cli_command *command, int count, char **words, cli_arguments *arguments);
void cli_arguments_free(cli_arguments *arguments);

// Name of the flag of a field: --NAME with dashes.
void cli_flag_name(const pc_field *field, char flag[64]);
// The letter of a flag ("output": 'o'), or 0.
char cli_flag_letter(const char *name);

// The groups of an options file: the stages' and the program's.
enum { CLI_OPTION_GROUPS = PC_STAGE_COUNT + 1 };
void cli_option_groups(cli_arguments *arguments, pc_option_group groups[CLI_OPTION_GROUPS]);
int cli_print_options(const cli_command *command, cli_arguments *arguments);

int cli_run_help(const cli_command *command, cli_arguments *arguments);
int cli_run_completion(const cli_command *command, cli_arguments *arguments);
void cli_print_help(const cli_command *command);
int cli_run_build(const cli_command *command, cli_arguments *arguments);
int cli_run_batch(const cli_command *command, cli_arguments *arguments);
int cli_run_stage(const cli_command *command, cli_arguments *arguments);
int cli_run_export(const cli_command *command, cli_arguments *arguments);
int cli_run_info(const cli_command *command, cli_arguments *arguments);
int cli_run_evaluate(const cli_command *command, cli_arguments *arguments);
int cli_run_regress(const cli_command *command, cli_arguments *arguments);
int cli_run_version(const cli_command *command, cli_arguments *arguments);
int cli_run_report(const cli_command *command, cli_arguments *arguments);
// Writes the page over all results in a folder. `file` NULL: FOLDER/report.html, with links.
int cli_write_page(const cli_command *command, const char *folder, const char *file);
// evaluate --motion
int cli_evaluate_motion(const cli_command *command, const cli_arguments *arguments);

// ---- messages ---------------------------------------------------------------------------------

// Prints "proxycloth COMMAND: error: ..." as one line on stderr and returns `code`.
__attribute__((format(printf, 3, 4))) int cli_fail(const char *command, cli_exit code,
                                                   const char *format, ...);
__attribute__((format(printf, 2, 3))) void cli_warn(const char *command, const char *format, ...);

// Prints the context's error and returns the exit code of `status`. `writing` tells files that
// cannot be written from files that cannot be read; `subject` (may be NULL) is the file at fault.
int cli_fail_status(const char *command, pc_context *context, pc_status status, const char *subject,
                    bool writing);

// Prints a warning line for every non-zero warning field of a report.
void cli_warn_report(const char *command, const char *stage, const pc_record *record,
                     const void *report);

// Shows how far a long run is, in place, where stderr is a terminal.
__attribute__((format(printf, 1, 2))) void cli_show_progress(const char *format, ...);

// Prints a line on stdout at once, for whoever reads along.
void cli_print_line(const char *text);

// Seconds of a clock that only runs forward.
double cli_now(void);

// Whether text is UTF-8.
bool cli_valid_text(const char *text);

// Copies text, with control characters and bytes that are not UTF-8 replaced by '?'.
void cli_clean_text(char *out, size_t size, const char *text);

// ---- context and signals ------------------------------------------------------------------------

// Creates a context with callbacks for progress, messages and interruption. No thread exists before
// this call: import files first.
int cli_context(const cli_command *command, const cli_arguments *arguments, pc_context **context);

// What of messages and progress is wanted; cli_context calls it too.
void cli_set_messages(const cli_command *command, const cli_arguments *arguments);

// From now on SIGINT, SIGTERM and SIGHUP set a flag. While the library computes, a second signal
// ends the program at once: a long loop may not ask for progress.
void cli_catch_signals(void);
// Files are being written until the program ends: the second signal has to wait as well.
void cli_begin_writing(void);
// Folders that the second signal removes, in this order; NULL-terminated. NULL: none.
void cli_abandon(char *const *folders);
bool cli_interrupted(void);
int cli_fail_interrupted(const char *command);

// ---- input ------------------------------------------------------------------------------------

typedef enum cli_kind { CLI_KIND_SCENE, CLI_KIND_ASSET } cli_kind;

// A whole file with a zero behind it, released with free(). Returns 0 or an errno value.
int cli_read_file(const char *path, char **bytes, size_t *size);

// Tells asset files from scenes by their first bytes. Prints the message on failure.
int cli_input_kind(const char *command, const char *path, cli_kind *kind);

// A file's name without folder and extension, as the name of a garment.
int cli_garment_name(const cli_command *command, const cli_arguments *arguments,
                     char name[sizeof(((pc_asset *)NULL)->name)]);

// Appends ".KINDnumber" (".lod64", ".part2") to the name of an asset. Prints the message when it
// gets too long.
int cli_extend_name(const cli_command *command, const char *base, const char *kind, uint32_t number,
                    char name[sizeof(((pc_asset *)NULL)->name)]);

// Loads an asset file.
int cli_load_asset(const cli_command *command, pc_context *context, const char *path,
                   pc_asset *asset);

// Reads the scenario of --scenario, or leaves the paper's, in place of what the asset has.
int cli_load_scenario(const cli_command *command, const cli_arguments *arguments,
                      pc_context *context, pc_asset *asset);

// ---- output -------------------------------------------------------------------------------------

// Files of one run: they are written into a staging folder inside the output folder and moved to
// their places when all are complete. Nothing stays behind on failure; what a killed run left, the
// next one removes.
typedef struct cli_output {
    char *folder;
    char *staging; // one of `made`
    int lock;      // of the staging folder, held as long as the run lives
    char **made;   // folders that this run made, innermost first; NULL-terminated
    size_t made_count;
    char **names;
    size_t name_count, name_capacity;
} cli_output;

// Removes what a folder holds, and with `itself` the folder.
void cli_remove_tree(const char *path, bool itself);
// Whether a file name is that of a staging folder.
bool cli_is_staging(const char *name);

// Makes the folder, its missing parents, and the staging folder.
int cli_output_begin(const cli_command *command, const char *folder, cli_output *output);
// Path of a new file in the staging folder; NULL when memory ran out.
char *cli_output_add(cli_output *output, const char *stem, const char *extension);
// Whether both paths lead to one file. NULL leads nowhere.
bool cli_same_file(const char *left, const char *right);
// Fails when a file of the run would take the place of an input; NULL: there is none.
int cli_output_protect(const cli_command *command, const cli_output *output, const char *input);
// Moves the files to their places.
int cli_output_commit(const cli_command *command, cli_output *output);
// Removes whatever is still staged, and folders that were made in vain.
void cli_output_end(cli_output *output);

// Writes glb, proxy.obj, json, png (and h5, strip.png) of a finished asset.
int cli_export_files(const cli_command *command, const cli_arguments *arguments,
                     pc_context *context, const pc_asset *asset, const pc_timings *timings,
                     bool with_asset, cli_output *output);

#endif
