// Reading JSON that people write: every message starts with the file's name and the path of the
// key, as in "cape.json: pins[1].box: must be an object". Functions return false after a failure.
#ifndef PCI_JSON_READER_H
#define PCI_JSON_READER_H

#include <cjson/cJSON.h>

#include "core/core.h"

// A text that is being read; the first failure is kept.
typedef struct pci_json_reader {
    pc_context *context;
    const char *stage; // for error messages
    const char *file;  // likewise
    char path[192];    // of the value in question, for example pins[1].box
    pc_status status;
} pci_json_reader;

// Parses the whole text; NULL after a failure, which names the line. Release with cJSON_Delete.
cJSON *pci_json_parse(pci_json_reader *r, const char *text, size_t size);

// All return false, to be returned in turn. `as_told`: with the message that the context has.
__attribute__((format(printf, 2, 3))) bool pci_json_fail(pci_json_reader *r, const char *format,
                                                         ...);
bool pci_json_fail_as_told(pci_json_reader *r);

// Append to the path; both return the length to which pci_json_leave shortens it again.
size_t pci_json_enter_key(pci_json_reader *r, const char *key);
size_t pci_json_enter_index(pci_json_reader *r, size_t index);
void pci_json_leave(pci_json_reader *r, size_t length);

bool pci_json_has_key(const cJSON *object, const char *key);
// Whether the item, whose key is in the path already, is the only one with its key.
bool pci_json_check_unique(pci_json_reader *r, const cJSON *object, const cJSON *item);
// Whether `object` is an object, and has no key twice and none but `keys` (NULL-terminated).
bool pci_json_check_object(pci_json_reader *r, const cJSON *object, const char *const *keys);

// Each of the following leaves `value` alone where the key is missing and not required.
bool pci_json_read_number(pci_json_reader *r, const cJSON *object, const char *key, bool required,
                          double minimum, double maximum, double *value);
// `count` numbers between -limit and limit.
bool pci_json_read_vector(pci_json_reader *r, const cJSON *object, const char *key, bool required,
                          double limit, size_t count, double *values);
// A text of at least one and less than `size` bytes, with its end.
bool pci_json_read_text(pci_json_reader *r, const cJSON *object, const char *key, bool required,
                        size_t size, char *text);
bool pci_json_read_bool(pci_json_reader *r, const cJSON *object, const char *key, bool *value);
// Required; `names` is NULL-terminated.
bool pci_json_read_choice(pci_json_reader *r, const cJSON *object, const char *key,
                          const char *const *names, size_t *choice);

// The value of an option of `owner` (for messages), as pci_json_field writes it.
bool pci_json_read_field(pci_json_reader *r, const cJSON *item, const char *owner,
                         const pc_field *field, void *values);

// A list with at least one entry: its length and memory for its elements.
bool pci_json_begin_list(pci_json_reader *r, const cJSON *list, size_t element_size, size_t *count,
                         void **elements);

#endif
