// Building JSON with cJSON: one failure flag instead of a check per value, numbers without loss.
#ifndef PCI_JSON_H
#define PCI_JSON_H

#include <cjson/cJSON.h>

#include "core/core.h"

// The shortest text that reads back as the same double, with a point whatever the locale is; "null"
// for NaN and infinities.
void pci_number_text(double number, char text[40]);

// A tree under construction. After the first failed allocation `failed` stays set and every further
// call does nothing; parents may be NULL then.
typedef struct pci_json {
    cJSON *root;
    bool failed;
} pci_json;

void pci_json_begin(pci_json *json);
void pci_json_end(pci_json *json); // releases the tree

// Each adds to an object, or appends to an array when `name` is NULL.
cJSON *pci_json_object(pci_json *json, cJSON *parent, const char *name);
cJSON *pci_json_array(pci_json *json, cJSON *parent, const char *name);
void pci_json_number(pci_json *json, cJSON *parent, const char *name, double number);
void pci_json_count(pci_json *json, cJSON *parent, const char *name, uint64_t count);
void pci_json_bool(pci_json *json, cJSON *parent, const char *name, bool value);
// Bytes that are not UTF-8 become '?'.
void pci_json_string(pci_json *json, cJSON *parent, const char *name, const char *text);

// A field of a struct under its name; choices as their names.
void pci_json_field(pci_json *json, cJSON *parent, const pc_field *field, const void *values);
// An object with every field of a struct.
cJSON *pci_json_record(pci_json *json, cJSON *parent, const char *name, const pc_record *record,
                       const void *values);

// The text, from cJSON's allocator (cJSON_free); NULL when memory ran out now or earlier.
char *pci_json_print(const pci_json *json, bool indented);
// The same in memory of the context, for pc_release.
char *pci_json_text(pc_context *context, const pci_json *json, bool indented);

#endif
