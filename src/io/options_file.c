// Options <-> JSON, and the presets, which are such texts.
#include "proxycloth/options_file.h"

#include <stdio.h>

#include "io/atomic_file.h"
#include "io/json.h"
#include "io/json_reader.h"

static const char stage[] = "options";

static const pc_preset presets[] = {
    {"mobile", "64 vertices, 4 influences in bytes: crowds and phones",
     "{\"vertices\": 64, \"influences\": 4, \"weight_storage\": \"u8\"}"},
    {"desktop", "128 vertices, 4 influences: what the paper uses in games",
     "{\"vertices\": 128, \"influences\": 4, \"weight_storage\": \"u16\"}"},
    {"cinematic", "512 vertices from 64 voxels, 8 influences: close-ups",
     "{\"voxels\": 64, \"vertices\": 512, \"dynamics\": \"xpbd\", \"influences\": 8, "
     "\"weight_storage\": \"float\"}"},
};

const pc_preset *pc_preset_at(size_t index) {
    return index < sizeof(presets) / sizeof(presets[0]) ? &presets[index] : NULL;
}

void pc_option_groups(pc_options *options, pc_option_group groups[PC_STAGE_COUNT]) {
    for (pc_stage i = 0; i < PC_STAGE_COUNT; ++i) {
        const pc_stage_info *info = pc_stage_describe(i);
        groups[i] = (pc_option_group){info->name, info->options,
                                      (char *)options + info->options_offset, NULL};
    }
}

// What a text is read into.
typedef struct target {
    pci_json_reader reader;
    const pc_option_group *groups;
    size_t count;
} target;

static const pc_option_group *find_group(const target *t, const cJSON *item) {
    for (size_t i = 0; i < t->count && cJSON_IsObject(item); ++i) {
        if (strcmp(t->groups[i].name, item->string) == 0) {
            return &t->groups[i];
        }
    }
    return NULL;
}

// The value of an option, or the values of one that may be a list.
static bool read_value(target *t, const cJSON *item, const pc_option_group *group,
                       const pc_field *field) {
    if (group->series == NULL || strcmp(group->series->name, field->name) != 0) {
        return pci_json_read_field(&t->reader, item, group->name, field, group->values);
    }
    group->series->count = 0;
    if (!cJSON_IsArray(item)) {
        return pci_json_read_field(&t->reader, item, group->name, field, group->values);
    }
    const cJSON *value = NULL;
    size_t index = 0;
    cJSON_ArrayForEach(value, item) {
        const size_t length = pci_json_enter_index(&t->reader, index++);
        if (!pci_json_read_field(&t->reader, value, group->name, field, group->values)) {
            return false;
        }
        if (pc_series_add(t->reader.context, group->name, field, group->values, group->series) !=
            PC_OK) {
            return pci_json_fail_as_told(&t->reader);
        }
        pci_json_leave(&t->reader, length);
    }
    return index > 0 || pci_json_fail(&t->reader, "the list is empty");
}

// An option that stands alone, in every group that has it.
static bool read_option(target *t, const cJSON *item) {
    bool known = false;
    for (size_t i = 0; i < t->count; ++i) {
        const pc_option_group *group = &t->groups[i];
        const pc_field *field = pc_record_find(group->record, item->string);
        known |= field != NULL;
        if (field != NULL && !read_value(t, item, group, field)) {
            return false;
        }
    }
    return known || pci_json_fail(&t->reader, "unknown key");
}

static bool read_group(target *t, const cJSON *object, const pc_option_group *group) {
    const cJSON *item = NULL;
    cJSON_ArrayForEach(item, object) {
        const size_t length = pci_json_enter_key(&t->reader, item->string);
        const pc_field *field = pc_record_find(group->record, item->string);
        if (field == NULL) {
            return pci_json_fail(&t->reader, "unknown key");
        }
        if (!pci_json_check_unique(&t->reader, object, item) ||
            !read_value(t, item, group, field)) {
            return false;
        }
        pci_json_leave(&t->reader, length);
    }
    return true;
}

static bool read_root(target *t, const cJSON *root);

static bool read_preset(target *t, const cJSON *item) {
    const char *name = cJSON_GetStringValue(item);
    for (size_t i = 0; name != NULL && pc_preset_at(i) != NULL; ++i) {
        if (strcmp(presets[i].name, name) == 0) {
            cJSON *root =
                pci_json_parse(&t->reader, presets[i].options, strlen(presets[i].options));
            const bool good = root != NULL && read_root(t, root);
            cJSON_Delete(root);
            return good;
        }
    }
    char known[128] = "";
    for (size_t i = 0; pc_preset_at(i) != NULL; ++i) {
        const size_t length = strlen(known);
        snprintf(known + length, sizeof(known) - length, "%s%s", i != 0 ? ", " : "",
                 presets[i].name);
    }
    return pci_json_fail(&t->reader, "must be one of %s", known);
}

static bool read_root(target *t, const cJSON *root) {
    enum { PRESET, ALONE, GROUPED, PASSES };
    if (!cJSON_IsObject(root)) {
        return pci_json_fail(&t->reader, "must be one JSON object");
    }
    for (int pass = 0; pass < PASSES; ++pass) {
        const cJSON *item = NULL;
        cJSON_ArrayForEach(item, root) {
            const pc_option_group *group = find_group(t, item);
            const int turn = strcmp(item->string, "preset") == 0 ? PRESET
                             : group != NULL                     ? GROUPED
                                                                 : ALONE;
            const size_t length = pci_json_enter_key(&t->reader, item->string);
            if (turn == pass && !(turn == PRESET    ? read_preset(t, item)
                                  : turn == GROUPED ? read_group(t, item, group)
                                                    : read_option(t, item))) {
                return false;
            }
            if (turn == pass && !pci_json_check_unique(&t->reader, root, item)) {
                return false;
            }
            pci_json_leave(&t->reader, length);
        }
    }
    return true;
}

// Bytes that a copy of the values takes, so that the next one is aligned.
static size_t room_of(const pc_option_group *group) { return (group->record->size + 15) / 16 * 16; }

// Reads into `copies`, whose values lie one behind the other in `memory`.
static pc_status parse(pc_context *context, const char *text, size_t size, const char *name,
                       const pc_option_group *groups, size_t group_count, pc_option_group *copies,
                       pc_series *series, unsigned char *memory) {
    size_t used = 0;
    for (size_t i = 0; i < group_count; ++i) {
        copies[i] = groups[i];
        copies[i].values = memcpy(memory + used, groups[i].values, groups[i].record->size);
        used += room_of(&groups[i]);
        if (groups[i].series != NULL) {
            series[i] = *groups[i].series;
            copies[i].series = &series[i];
        }
    }
    target t = {{.context = context, .stage = stage, .file = name}, copies, group_count};
    cJSON *root = pci_json_parse(&t.reader, text, size);
    if (root != NULL && read_root(&t, root)) {
        for (size_t i = 0; i < group_count; ++i) {
            memcpy(groups[i].values, copies[i].values, groups[i].record->size);
            if (groups[i].series != NULL) {
                *groups[i].series = series[i];
            }
        }
    }
    cJSON_Delete(root);
    return t.reader.status;
}

pc_status pc_options_parse(pc_context *context, const char *text, size_t size, const char *name,
                           const pc_option_group *groups, size_t group_count) {
    if (context == NULL || text == NULL || name == NULL || groups == NULL) {
        return context == NULL ? PC_ERROR_INVALID_ARGUMENT
                               : pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                                          "options: a pointer is NULL");
    }
    size_t room = 1;
    for (size_t i = 0; i < group_count; ++i) {
        room += room_of(&groups[i]);
    }
    pc_option_group *copies = PCI_ALLOCATE(context, pc_option_group, group_count + 1);
    pc_series *series = PCI_ALLOCATE(context, pc_series, group_count + 1);
    unsigned char *memory = PCI_ALLOCATE(context, unsigned char, room);
    const pc_status status =
        copies != NULL && series != NULL && memory != NULL
            ? parse(context, text, size, name, groups, group_count, copies, series, memory)
            : pci_fail_memory(context, stage);
    pc_release(context, copies);
    pc_release(context, series);
    pc_release(context, memory);
    return status;
}

pc_status pc_options_read(pc_context *context, const char *path, const pc_option_group *groups,
                          size_t group_count) {
    if (context == NULL || path == NULL) {
        return context == NULL ? PC_ERROR_INVALID_ARGUMENT
                               : pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                                          "options: the path is NULL");
    }
    unsigned char *bytes = NULL;
    size_t size = 0;
    pc_status status = pci_read_file(context, stage, path, &bytes, &size);
    if (status == PC_OK) {
        status = pc_options_parse(context, (const char *)bytes, size, path, groups, group_count);
    }
    pc_release(context, bytes);
    return status;
}

static void print_group(pci_json *json, const pc_option_group *group) {
    cJSON *object = pci_json_record(json, json->root, group->name, group->record, group->values);
    const pc_series *series = group->series;
    if (series == NULL || series->count == 0) {
        return;
    }
    cJSON_DeleteItemFromObjectCaseSensitive(object, series->name);
    cJSON *list = pci_json_array(json, object, series->name);
    for (uint32_t i = 0; i < series->count; ++i) {
        pci_json_count(json, list, NULL, series->values[i]);
    }
}

pc_status pc_options_print(pc_context *context, const pc_option_group *groups, size_t group_count,
                           char **text) {
    if (context == NULL || groups == NULL || text == NULL) {
        return context == NULL ? PC_ERROR_INVALID_ARGUMENT
                               : pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                                          "options: a pointer is NULL");
    }
    pci_json json;
    pci_json_begin(&json);
    for (size_t i = 0; i < group_count; ++i) {
        if (groups[i].record->field_count != 0) {
            print_group(&json, &groups[i]);
        }
    }
    *text = pci_json_text(context, &json, true);
    pci_json_end(&json);
    return *text != NULL ? PC_OK : pci_fail_memory(context, stage);
}
