// Records as aligned text or JSON.
#ifndef PRINT_H
#define PRINT_H

#include <cjson/cJSON.h>

#include "cli.h"

// One line per field: name, value, unit.
void print_record(const pc_record *record, const void *values, const char *indent);

// Adds every field to a JSON object.
void json_record(cJSON *object, const pc_record *record, const void *values);

// Adds values to a JSON object.
void json_text(cJSON *object, const char *name, const char *value);
void json_number(cJSON *object, const char *name, double value);

// Adds an empty object or array to an object.
cJSON *json_object(cJSON *object, const char *name);
cJSON *json_array(cJSON *object, const char *name);

// Prints the object on stdout and deletes it. Memory that ran out on the way shows here.
int json_print(const char *command, cJSON *object);

#endif
