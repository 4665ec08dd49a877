/// Options as JSON, and presets.
///
/// A file may name an option alone, as the command line does, or below its stage; a name that
/// several stages have (`seed`) sets all of them, and what stands below a stage wins:
///
///     { "preset": "mobile", "vertices": 96, "label": { "lambda_smooth": 3 } }
///
/// Names, ranges, units and defaults are those of the options' tables (options.h). Switches are
/// true or false, choices are texts, and the word for 0 ("auto") is allowed where there is one. An
/// option with a series may be a list, as in "vertices": [64, 128].
/// Unknown and repeated keys are errors. What a file leaves out stays as it was; `preset` is
/// applied first, wherever it stands.
#ifndef PROXYCLOTH_OPTIONS_FILE_H
#define PROXYCLOTH_OPTIONS_FILE_H

#include "proxycloth/pipeline.h"

#ifdef __cplusplus
extern "C" {
#endif

/// A struct of options under its name in a file.
typedef struct pc_option_group {
    const char *name;
    const pc_record *record;
    void *values;      ///< the struct
    pc_series *series; ///< of the option series->name, which may be a list; NULL: none may
} pc_option_group;

/// The stages' options as groups, in the order of the pipeline; they point into `options`. None has
/// a series.
void pc_option_groups(pc_options *options, pc_option_group groups[PC_STAGE_COUNT]);

/// Sets options from a JSON text.
/// @param[in]     size    bytes of `text`.
/// @param[in]     name    of the file, for messages.
/// @param[in,out] groups  structs of the caller may follow those of pc_option_groups. On failure
///                        all values stay as they were.
/// @return PC_OK; PC_ERROR_FORMAT (no JSON; the message names the line); PC_ERROR_INVALID_OPTIONS
///         (the message names the key, and value and range); PC_ERROR_OUT_OF_MEMORY.
PC_NODISCARD pc_status pc_options_parse(pc_context *context, const char *text, size_t size,
                                        const char *name, const pc_option_group *groups,
                                        size_t group_count);

/// Sets options from a JSON file; see pc_options_parse.
/// @return also PC_ERROR_IO; PC_ERROR_INVALID_ARGUMENT (no path).
PC_NODISCARD pc_status pc_options_read(pc_context *context, const char *path,
                                       const pc_option_group *groups, size_t group_count);

/// The text that reads back as the same options: one object per group.
/// @param[out] text  NULL on failure; release with pc_release.
/// @return PC_OK; PC_ERROR_OUT_OF_MEMORY.
PC_NODISCARD pc_status pc_options_print(pc_context *context, const pc_option_group *groups,
                                        size_t group_count, char **text);

/// A named set of options for a kind of engine.
typedef struct pc_preset {
    const char *name;
    const char *summary;
    const char *options; ///< JSON for pc_options_parse
} pc_preset;

/// The preset of that number, from 0; NULL behind the last.
const pc_preset *pc_preset_at(size_t index);

#ifdef __cplusplus
}
#endif
#endif
