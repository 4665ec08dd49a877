#include <errno.h>
#include <stdio.h>
#include <stdlib.h>

#include "core/core.h"

double pc_field_number(const pc_field *field, const void *values) {
    const char *at = (const char *)values + field->offset;
    switch (field->type) {
    case PC_FIELD_DOUBLE:
        return *(const double *)(const void *)at;
    case PC_FIELD_UINT:
    case PC_FIELD_CHOICE:
        return *(const uint32_t *)(const void *)at;
    case PC_FIELD_COUNT:
        return (double)*(const uint64_t *)(const void *)at;
    case PC_FIELD_BOOL:
        return *(const bool *)(const void *)at ? 1.0 : 0.0;
    }
    return 0.0;
}

void pc_field_set_number(const pc_field *field, void *values, double number) {
    char *at = (char *)values + field->offset;
    switch (field->type) {
    case PC_FIELD_DOUBLE:
        *(double *)(void *)at = number;
        return;
    case PC_FIELD_UINT:
    case PC_FIELD_CHOICE:
        *(uint32_t *)(void *)at =
            number >= 0.0 && number <= (double)UINT32_MAX ? (uint32_t)number : 0;
        return;
    case PC_FIELD_COUNT:
        *(uint64_t *)(void *)at = number >= 0.0 && number < 0x1p64 ? (uint64_t)number : 0;
        return;
    case PC_FIELD_BOOL:
        *(bool *)(void *)at = number != 0.0;
        return;
    }
}

void pc_record_set_defaults(const pc_record *record, void *values) {
    memset(values, 0, record->size);
    for (size_t i = 0; i < record->field_count; ++i) {
        pc_field_set_number(&record->fields[i], values, record->fields[i].default_value);
    }
}

static pc_status check_number(pc_context *context, const char *stage, const pc_field *field,
                              double number) {
    if ((number >= field->minimum && number <= field->maximum) ||
        (field->zero != NULL && number == 0.0)) {
        return PC_OK;
    }
    return pci_fail(context, PC_ERROR_INVALID_OPTIONS, stage,
                    "%s: option %s = %.10g is out of range, it must be between %.10g and "
                    "%.10g%s%s%s%s",
                    stage, field->name, number, field->minimum, field->maximum,
                    field->unit[0] != '\0' ? " " : "", field->unit,
                    field->zero != NULL ? ", or " : "", field->zero != NULL ? field->zero : "");
}

pc_status pc_record_check(pc_context *context, const char *stage, const pc_record *record,
                          const void *values) {
    for (size_t i = 0; i < record->field_count; ++i) {
        const pc_field *field = &record->fields[i];
        const pc_status status =
            check_number(context, stage, field, pc_field_number(field, values));
        if (status != PC_OK) {
            return status;
        }
    }
    return PC_OK;
}

const pc_field *pc_record_find(const pc_record *record, const char *name) {
    for (size_t i = 0; i < record->field_count; ++i) {
        if (strcmp(record->fields[i].name, name) == 0) {
            return &record->fields[i];
        }
    }
    return NULL;
}

// Finds the number that `text` means for `field`; false when it means none.
static bool parse_number(const pc_field *field, const char *text, double *number) {
    if (field->type == PC_FIELD_BOOL) {
        if (strcmp(text, "true") == 0 || strcmp(text, "on") == 0 || strcmp(text, "1") == 0) {
            *number = 1.0;
            return true;
        }
        if (strcmp(text, "false") == 0 || strcmp(text, "off") == 0 || strcmp(text, "0") == 0) {
            *number = 0.0;
            return true;
        }
        return false;
    }
    if (field->type == PC_FIELD_CHOICE) {
        for (size_t i = 0; field->choices[i] != NULL; ++i) {
            if (strcmp(field->choices[i], text) == 0) {
                *number = (double)i;
                return true;
            }
        }
        return false;
    }
    if (field->zero != NULL && strcmp(field->zero, text) == 0) {
        *number = 0.0;
        return true;
    }
    char *end = NULL;
    errno = 0;
    *number = strtod(text, &end);
    if (end == text || *end != '\0' || isnan(*number)) {
        return false;
    }
    return field->type == PC_FIELD_DOUBLE || *number == floor(*number);
}

pc_status pc_field_set_text(pc_context *context, const char *stage, const pc_field *field,
                            void *values, const char *text) {
    double number = 0.0;
    if (!parse_number(field, text, &number)) {
        char expected[256] = "a number";
        if (field->type == PC_FIELD_BOOL) {
            memcpy(expected, "true or false", sizeof("true or false"));
        } else if (field->type == PC_FIELD_UINT || field->type == PC_FIELD_COUNT) {
            snprintf(expected, sizeof(expected), "a whole number%s%s",
                     field->zero != NULL ? " or " : "", field->zero != NULL ? field->zero : "");
        } else if (field->type == PC_FIELD_CHOICE) {
            size_t length = 0;
            for (size_t i = 0; field->choices[i] != NULL; ++i) {
                const char *separator = i == 0 ? "" : field->choices[i + 1] == NULL ? " or " : ", ";
                const size_t room = sizeof(expected) - length - 1;
                const size_t size = strlen(separator) + strlen(field->choices[i]);
                if (size > room) {
                    break;
                }
                memcpy(expected + length, separator, strlen(separator));
                memcpy(expected + length + strlen(separator), field->choices[i],
                       strlen(field->choices[i]));
                length += size;
                expected[length] = '\0';
            }
        }
        return pci_fail(context, PC_ERROR_INVALID_OPTIONS, stage,
                        "%s: option %s = \"%.64s\" is not %s", stage, field->name, text, expected);
    }
    const pc_status status = check_number(context, stage, field, number);
    if (status == PC_OK) {
        pc_field_set_number(field, values, number);
    }
    return status;
}

pc_status pc_series_add(pc_context *context, const char *stage, const pc_field *field,
                        const void *values, pc_series *series) {
    const uint32_t value = (uint32_t)pc_field_number(field, values);
    for (uint32_t i = 0; i < series->count; ++i) {
        if (series->values[i] == value) {
            return pci_fail(context, PC_ERROR_INVALID_OPTIONS, stage, "%s: %s: %u is given twice",
                            stage, field->name, value);
        }
    }
    if (series->count == PC_SERIES_LIMIT) {
        return pci_fail(context, PC_ERROR_INVALID_OPTIONS, stage, "%s: %s: more than %d values",
                        stage, field->name, PC_SERIES_LIMIT);
    }
    series->values[series->count++] = value;
    return PC_OK;
}
