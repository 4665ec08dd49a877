#include "io/json_reader.h"

#include <stdarg.h>
#include <stdio.h>

#include "io/json.h"

bool pci_json_fail(pci_json_reader *r, const char *format, ...) {
    if (r->status == PC_OK) {
        char problem[256];
        va_list arguments;
        va_start(arguments, format);
        vsnprintf(problem, sizeof(problem), format, arguments);
        va_end(arguments);
        r->status = pci_fail(r->context, PC_ERROR_INVALID_OPTIONS, r->stage, "%.200s: %s%s%s",
                             r->file, r->path, r->path[0] != '\0' ? ": " : "", problem);
    }
    return false;
}

static bool out_of_memory(pci_json_reader *r) {
    if (r->status == PC_OK) {
        r->status = pci_fail_memory(r->context, r->stage);
    }
    return false;
}

size_t pci_json_enter_key(pci_json_reader *r, const char *key) {
    const size_t length = strlen(r->path);
    snprintf(r->path + length, sizeof(r->path) - length, "%s%.63s", length != 0 ? "." : "", key);
    return length;
}

size_t pci_json_enter_index(pci_json_reader *r, size_t index) {
    const size_t length = strlen(r->path);
    snprintf(r->path + length, sizeof(r->path) - length, "[%zu]", index);
    return length;
}

void pci_json_leave(pci_json_reader *r, size_t length) { r->path[length] = '\0'; }

static bool is_known(const char *key, const char *const *keys) {
    for (; *keys != NULL; ++keys) {
        if (strcmp(*keys, key) == 0) {
            return true;
        }
    }
    return false;
}

bool pci_json_check_unique(pci_json_reader *r, const cJSON *object, const cJSON *item) {
    return cJSON_GetObjectItemCaseSensitive(object, item->string) == item ||
           pci_json_fail(r, "the key is given twice");
}

bool pci_json_check_object(pci_json_reader *r, const cJSON *object, const char *const *keys) {
    if (!cJSON_IsObject(object)) {
        return pci_json_fail(r, "must be an object");
    }
    const cJSON *item = NULL;
    cJSON_ArrayForEach(item, object) {
        const size_t length = pci_json_enter_key(r, item->string);
        if (!is_known(item->string, keys)) {
            return pci_json_fail(r, "unknown key");
        }
        if (!pci_json_check_unique(r, object, item)) {
            return false;
        }
        pci_json_leave(r, length);
    }
    return true;
}

bool pci_json_has_key(const cJSON *object, const char *key) {
    return cJSON_GetObjectItemCaseSensitive(object, key) != NULL;
}

// The value of a key; NULL, and an error where it is required, when there is none.
static const cJSON *find(pci_json_reader *r, const cJSON *object, const char *key, bool required) {
    const cJSON *item = cJSON_GetObjectItemCaseSensitive(object, key);
    if (item == NULL && required) {
        pci_json_enter_key(r, key);
        pci_json_fail(r, "is missing");
    }
    return item;
}

static bool check_number(pci_json_reader *r, const cJSON *item, double minimum, double maximum,
                         double *value) {
    if (!cJSON_IsNumber(item)) {
        return pci_json_fail(r, "must be a number");
    }
    if (!(item->valuedouble >= minimum && item->valuedouble <= maximum)) {
        return pci_json_fail(r, "%.10g is out of range, it must be between %.10g and %.10g",
                             item->valuedouble, minimum, maximum);
    }
    *value = item->valuedouble;
    return true;
}

bool pci_json_read_number(pci_json_reader *r, const cJSON *object, const char *key, bool required,
                          double minimum, double maximum, double *value) {
    const cJSON *item = find(r, object, key, required);
    if (item == NULL) {
        return !required;
    }
    const size_t length = pci_json_enter_key(r, key);
    const bool good = check_number(r, item, minimum, maximum, value);
    pci_json_leave(r, length);
    return good;
}

bool pci_json_read_vector(pci_json_reader *r, const cJSON *object, const char *key, bool required,
                          double limit, size_t count, double *values) {
    const cJSON *item = find(r, object, key, required);
    if (item == NULL) {
        return !required;
    }
    const size_t length = pci_json_enter_key(r, key);
    if (!cJSON_IsArray(item) || cJSON_GetArraySize(item) != (int)count) {
        return pci_json_fail(r, "must be a list of %zu numbers", count);
    }
    for (size_t k = 0; k < count; ++k) {
        const size_t inner = pci_json_enter_index(r, k);
        if (!check_number(r, cJSON_GetArrayItem(item, (int)k), -limit, limit, &values[k])) {
            return false;
        }
        pci_json_leave(r, inner);
    }
    pci_json_leave(r, length);
    return true;
}

bool pci_json_read_text(pci_json_reader *r, const cJSON *object, const char *key, bool required,
                        size_t size, char *text) {
    const cJSON *item = find(r, object, key, required);
    if (item == NULL) {
        return !required;
    }
    const size_t length = pci_json_enter_key(r, key);
    const char *value = cJSON_GetStringValue(item);
    if (value == NULL || value[0] == '\0' || strlen(value) >= size) {
        return pci_json_fail(r, "must be a text of 1 to %zu bytes", size - 1);
    }
    memcpy(text, value, strlen(value) + 1);
    pci_json_leave(r, length);
    return true;
}

bool pci_json_read_bool(pci_json_reader *r, const cJSON *object, const char *key, bool *value) {
    const cJSON *item = find(r, object, key, false);
    if (item != NULL && !cJSON_IsBool(item)) {
        pci_json_enter_key(r, key);
        return pci_json_fail(r, "must be true or false");
    }
    *value = item != NULL ? cJSON_IsTrue(item) != 0 : *value;
    return true;
}

bool pci_json_read_choice(pci_json_reader *r, const cJSON *object, const char *key,
                          const char *const *names, size_t *choice) {
    const cJSON *item = find(r, object, key, true);
    const char *text = cJSON_GetStringValue(item);
    for (*choice = 0; text != NULL && names[*choice] != NULL; ++*choice) {
        if (strcmp(names[*choice], text) == 0) {
            return true;
        }
    }
    pci_json_enter_key(r, key);
    char known[128] = "";
    for (size_t i = 0; names[i] != NULL; ++i) {
        const size_t length = strlen(known);
        snprintf(known + length, sizeof(known) - length, "%s%s", i != 0 ? ", " : "", names[i]);
    }
    return pci_json_fail(r, "must be one of %s", known);
}

bool pci_json_begin_list(pci_json_reader *r, const cJSON *list, size_t element_size, size_t *count,
                         void **elements) {
    if (!cJSON_IsArray(list) || cJSON_GetArraySize(list) == 0) {
        return pci_json_fail(r, "must be a list with at least one entry");
    }
    const size_t wanted = (size_t)cJSON_GetArraySize(list);
    *elements = pci_allocate(r->context, wanted, element_size);
    *count = *elements != NULL ? wanted : 0;
    return *elements != NULL || out_of_memory(r);
}

bool pci_json_fail_as_told(pci_json_reader *r) {
    char problem[200]; // it lies where the new message is going to be
    snprintf(problem, sizeof(problem), "%.199s", pc_context_error(r->context)->message);
    return pci_json_fail(r, "%s", problem);
}

bool pci_json_read_field(pci_json_reader *r, const cJSON *item, const char *owner,
                         const pc_field *field, void *values) {
    char text[64] = "";
    if (field->type == PC_FIELD_CHOICE || (field->zero != NULL && cJSON_IsString(item))) {
        if (!cJSON_IsString(item)) {
            return pci_json_fail(r, "must be a text");
        }
        snprintf(text, sizeof(text), "%s", item->valuestring);
    } else if (field->type == PC_FIELD_BOOL) {
        if (!cJSON_IsBool(item)) {
            return pci_json_fail(r, "must be true or false");
        }
        snprintf(text, sizeof(text), "%s", cJSON_IsTrue(item) ? "true" : "false");
    } else {
        if (!cJSON_IsNumber(item)) {
            return pci_json_fail(r, "must be a number");
        }
        pci_number_text(item->valuedouble, text);
    }
    if (pc_field_set_text(r->context, owner, field, values, text) == PC_OK) {
        return true;
    }
    return pci_json_fail_as_told(r);
}

cJSON *pci_json_parse(pci_json_reader *r, const char *text, size_t size) {
    const char *end = NULL;
    cJSON *root = cJSON_ParseWithLengthOpts(text, size, &end, 0);
    const char *rest = end != NULL ? end : text;
    while (root != NULL && rest < text + size && strchr(" \t\r\n", *rest) != NULL &&
           *rest != '\0') {
        ++rest;
    }
    if (root != NULL && rest == text + size) {
        return root;
    }
    size_t line = 1;
    for (const char *at = text; at < rest && at < text + size; ++at) {
        line += *at == '\n';
    }
    r->status = pci_fail(r->context, PC_ERROR_FORMAT, r->stage, "%.200s: line %zu is no valid JSON",
                         r->file, line);
    cJSON_Delete(root);
    return NULL;
}
