#include "io/json.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>

void pci_number_text(double number, char text[40]) {
    if (!isfinite(number)) {
        memcpy(text, "null", sizeof("null"));
        return;
    }
    for (int digits = 15; digits <= 17; ++digits) {
        snprintf(text, 40, "%.*g", digits, number);
        if (strtod(text, NULL) == number) {
            break;
        }
    }
    // The decimal separator is whatever stands between the digits before and after it.
    char *separator = text + strspn(text, "+-0123456789");
    if (*separator != '\0' && *separator != 'e') {
        char *rest = separator + strcspn(separator, "0123456789e");
        *separator = '.';
        memmove(separator + 1, rest, strlen(rest) + 1);
    }
}

void pci_json_begin(pci_json *json) {
    json->root = cJSON_CreateObject();
    json->failed = json->root == NULL;
}

void pci_json_end(pci_json *json) {
    cJSON_Delete(json->root);
    json->root = NULL;
}

// Hands `item` to its parent, or deletes it when that is impossible.
static cJSON *adopt(pci_json *json, cJSON *parent, const char *name, cJSON *item) {
    const bool added = item != NULL && parent != NULL && !json->failed &&
                       (name != NULL ? cJSON_AddItemToObject(parent, name, item)
                                     : cJSON_AddItemToArray(parent, item));
    if (!added) {
        cJSON_Delete(item);
        json->failed = true;
        return NULL;
    }
    return item;
}

cJSON *pci_json_object(pci_json *json, cJSON *parent, const char *name) {
    return adopt(json, parent, name, cJSON_CreateObject());
}

cJSON *pci_json_array(pci_json *json, cJSON *parent, const char *name) {
    return adopt(json, parent, name, cJSON_CreateArray());
}

void pci_json_number(pci_json *json, cJSON *parent, const char *name, double number) {
    char text[40];
    pci_number_text(number, text);
    adopt(json, parent, name, cJSON_CreateRaw(text));
}

void pci_json_count(pci_json *json, cJSON *parent, const char *name, uint64_t count) {
    char text[40];
    snprintf(text, sizeof(text), "%" PRIu64, count);
    adopt(json, parent, name, cJSON_CreateRaw(text));
}

void pci_json_bool(pci_json *json, cJSON *parent, const char *name, bool value) {
    adopt(json, parent, name, cJSON_CreateBool(value));
}

// Length of the UTF-8 sequence at `text`; 0 where there is none.
static size_t utf8_length(const unsigned char *text) {
    static const struct {
        unsigned char mask, lead;
        uint32_t smallest;
    } forms[] = {{0x80, 0x00, 0}, {0xe0, 0xc0, 0x80}, {0xf0, 0xe0, 0x800}, {0xf8, 0xf0, 0x10000}};
    for (size_t length = 1; length <= 4; ++length) {
        if ((text[0] & forms[length - 1].mask) != forms[length - 1].lead) {
            continue;
        }
        uint32_t code = text[0] & (unsigned char)~forms[length - 1].mask;
        for (size_t i = 1; i < length; ++i) {
            if ((text[i] & 0xc0) != 0x80) {
                return 0;
            }
            code = (code << 6) | (text[i] & 0x3fu);
        }
        const bool valid = code >= forms[length - 1].smallest && code <= 0x10ffff &&
                           !(code >= 0xd800 && code <= 0xdfff);
        return valid ? length : 0;
    }
    return 0;
}

void pci_json_string(pci_json *json, cJSON *parent, const char *name, const char *text) {
    cJSON *item = cJSON_CreateString(text);
    if (item != NULL) {
        for (char *at = item->valuestring; *at != '\0';) {
            const size_t length = utf8_length((const unsigned char *)at);
            if (length == 0) {
                *at = '?';
            }
            at += length != 0 ? length : 1;
        }
    }
    adopt(json, parent, name, item);
}

void pci_json_field(pci_json *json, cJSON *parent, const pc_field *field, const void *values) {
    const double number = pc_field_number(field, values);
    uint64_t count;
    uint32_t choice = 0;
    switch (field->type) {
    case PC_FIELD_DOUBLE:
        pci_json_number(json, parent, field->name, number);
        return;
    case PC_FIELD_BOOL:
        pci_json_bool(json, parent, field->name, number != 0.0);
        return;
    case PC_FIELD_COUNT: // may hold more than a double
        memcpy(&count, (const char *)values + field->offset, sizeof(count));
        pci_json_count(json, parent, field->name, count);
        return;
    case PC_FIELD_UINT:
        if (field->zero != NULL && number == 0.0) {
            pci_json_string(json, parent, field->name, field->zero);
            return;
        }
        pci_json_count(json, parent, field->name, (uint64_t)number);
        return;
    case PC_FIELD_CHOICE:
        while (field->choices[choice] != NULL && choice != (uint32_t)number) {
            ++choice;
        }
        pci_json_string(json, parent, field->name,
                        field->choices[choice] != NULL ? field->choices[choice] : "unknown");
        return;
    }
}

cJSON *pci_json_record(pci_json *json, cJSON *parent, const char *name, const pc_record *record,
                       const void *values) {
    cJSON *object = pci_json_object(json, parent, name);
    for (size_t i = 0; i < record->field_count; ++i) {
        pci_json_field(json, object, &record->fields[i], values);
    }
    return object;
}

char *pci_json_print(const pci_json *json, bool indented) {
    if (json->failed) {
        return NULL;
    }
    return indented ? cJSON_Print(json->root) : cJSON_PrintUnformatted(json->root);
}

char *pci_json_text(pc_context *context, const pci_json *json, bool indented) {
    char *printed = pci_json_print(json, indented), *text = NULL;
    if (printed != NULL) {
        text = PCI_ALLOCATE(context, char, strlen(printed) + 1);
        if (text != NULL) {
            memcpy(text, printed, strlen(printed) + 1);
        }
        cJSON_free(printed);
    }
    return text;
}
