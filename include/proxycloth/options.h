/// Options and reports by name: one table row per field feeds defaults, range checks, command-line
/// flags, help texts, JSON and asset files.
#ifndef PROXYCLOTH_OPTIONS_H
#define PROXYCLOTH_OPTIONS_H

#include "proxycloth/base.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum pc_field_type {
    PC_FIELD_DOUBLE, ///< double
    PC_FIELD_UINT,   ///< uint32_t
    PC_FIELD_COUNT,  ///< uint64_t
    PC_FIELD_BOOL,   ///< bool
    PC_FIELD_CHOICE  ///< uint32_t, index into `choices`
} pc_field_type;

/// One field of an options or report struct.
typedef struct pc_field {
    const char *name; ///< snake_case; the flag is --name with dashes
    pc_field_type type;
    size_t offset;
    double default_value, minimum, maximum; ///< options only; both limits are allowed values
    const char *unit;                       ///< "" where there is none
    const char *help;                       ///< one sentence
    const char *const *choices;             ///< NULL-terminated, PC_FIELD_CHOICE only
    /// Options only: a word for the value 0 ("auto"), which is then allowed outside the limits, or
    /// NULL.
    const char *zero;
    /// Reports only: what a value other than 0 means for the user, for example "degenerate
    /// triangles were accepted"; NULL where it means nothing. A field with this is a warning.
    const char *warning;
} pc_field;

/// A struct described by its fields.
typedef struct pc_record {
    const pc_field *fields;
    size_t field_count;
    size_t size; ///< sizeof the struct
} pc_record;

#define PC_SERIES_LIMIT 16

/// Values of a whole-number option that may be a list, each for a result of its own (levels of
/// detail).
typedef struct pc_series {
    const char *name; ///< of the option
    uint32_t count;   ///< 0: no list, the struct has the only value
    uint32_t values[PC_SERIES_LIMIT];
} pc_series;

/// Sets every field of an options struct to its default.
void pc_record_set_defaults(const pc_record *record, void *values);

/// Checks every field against its range. The message names the option, its value and the limit.
/// @return PC_OK or PC_ERROR_INVALID_OPTIONS.
PC_NODISCARD pc_status pc_record_check(pc_context *context, const char *stage,
                                       const pc_record *record, const void *values);

/// Sets one field from text ("0.5", "true", a choice's name, the word for 0) and checks its range.
/// @return PC_OK; PC_ERROR_INVALID_OPTIONS (not a number, out of range, no such choice).
PC_NODISCARD pc_status pc_field_set_text(pc_context *context, const char *stage,
                                         const pc_field *field, void *values, const char *text);

/// Appends the value that the field has.
/// @return PC_OK; PC_ERROR_INVALID_OPTIONS (the series has it already, or is full).
PC_NODISCARD pc_status pc_series_add(pc_context *context, const char *stage, const pc_field *field,
                                     const void *values, pc_series *series);

/// The field of that name, or NULL.
const pc_field *pc_record_find(const pc_record *record, const char *name);

/// The field's value as a number (choices and booleans as 0, 1, ...).
double pc_field_number(const pc_field *field, const void *values);

/// Sets the field from a number without a range check; the inverse of pc_field_number.
void pc_field_set_number(const pc_field *field, void *values, double number);

#ifdef __cplusplus
}
#endif
#endif
