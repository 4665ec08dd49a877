#include "print.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void print_record(const pc_record *record, const void *values, const char *indent) {
    for (size_t i = 0; i < record->field_count; ++i) {
        const pc_field *field = &record->fields[i];
        const double value = pc_field_number(field, values);
        printf("%s%-28s ", indent, field->name);
        if (field->type == PC_FIELD_BOOL) {
            printf("%s\n", value != 0.0 ? "yes" : "no");
        } else if (field->type == PC_FIELD_CHOICE) {
            printf("%s\n", field->choices[(size_t)value]);
        } else if (field->zero != NULL && value == 0.0) {
            printf("%s\n", field->zero);
        } else if (field->type == PC_FIELD_DOUBLE) {
            printf("%.6g%s%s\n", value, field->unit[0] != '\0' ? " " : "", field->unit);
        } else {
            printf("%.0f%s%s\n", value, field->unit[0] != '\0' ? " " : "", field->unit);
        }
    }
}

void json_number(cJSON *object, const char *name, double value) {
    // JSON has no infinities.
    cJSON_AddItemToObject(object, name,
                          isfinite(value) ? cJSON_CreateNumber(value) : cJSON_CreateNull());
}

void json_text(cJSON *object, const char *name, const char *value) {
    char *clean = NULL; // names of files may be any bytes, JSON is UTF-8
    if (value != NULL && !cli_valid_text(value) && (clean = malloc(strlen(value) + 1)) != NULL) {
        cli_clean_text(clean, strlen(value) + 1, value);
    }
    cJSON_AddItemToObject(object, name, cJSON_CreateString(clean != NULL ? clean : value));
    free(clean);
}

cJSON *json_object(cJSON *object, const char *name) {
    return cJSON_AddObjectToObject(object, name);
}

cJSON *json_array(cJSON *object, const char *name) { return cJSON_AddArrayToObject(object, name); }

void json_record(cJSON *object, const pc_record *record, const void *values) {
    for (size_t i = 0; i < record->field_count; ++i) {
        const pc_field *field = &record->fields[i];
        const double value = pc_field_number(field, values);
        if (field->type == PC_FIELD_BOOL) {
            cJSON_AddItemToObject(object, field->name, cJSON_CreateBool(value != 0.0));
        } else if (field->type == PC_FIELD_CHOICE) {
            json_text(object, field->name, field->choices[(size_t)value]);
        } else if (field->zero != NULL && value == 0.0) {
            json_text(object, field->name, field->zero);
        } else {
            json_number(object, field->name, value);
        }
    }
}

int json_print(const char *command, cJSON *object) {
    char *text = object != NULL ? cJSON_Print(object) : NULL;
    cJSON_Delete(object);
    if (text == NULL) {
        return cli_fail(command, CLI_LIMIT, "memory ran out");
    }
    puts(text);
    cJSON_free(text);
    return CLI_OK;
}
