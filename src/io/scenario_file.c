// Scenario <-> JSON. Every message starts with the file's name and the path of the key.
#include "io/scenario_file.h"

#include <stdarg.h>
#include <stdio.h>

#include "io/atomic_file.h"
#include "io/json.h"
#include "proxycloth/simulate.h"

static const char stage[] = "scenario";

static const char *const attribute_names[] = {"red", "green", "blue", "alpha", "u", "v", NULL};
static const char *const shape_names[] = {"sphere", "capsule", "body", NULL};

// ---- reading: errors and paths
// -------------------------------------------------------------------

// A file that is being read; the first failure is kept.
typedef struct reader {
    pc_context *context;
    const char *file;
    char path[192]; // of the value in question, for example pins[1].box
    pc_status status;
} reader;

__attribute__((format(printf, 2, 3))) static bool fail(reader *r, const char *format, ...) {
    if (r->status == PC_OK) {
        char problem[256];
        va_list arguments;
        va_start(arguments, format);
        vsnprintf(problem, sizeof(problem), format, arguments);
        va_end(arguments);
        r->status = pci_fail(r->context, PC_ERROR_INVALID_OPTIONS, stage, "%.200s: %s%s%s", r->file,
                             r->path, r->path[0] != '\0' ? ": " : "", problem);
    }
    return false;
}

static bool out_of_memory(reader *r) {
    if (r->status == PC_OK) {
        r->status = pci_fail_memory(r->context, stage);
    }
    return false;
}

// Both return the length to which `leave` shortens the path again.
static size_t enter_key(reader *r, const char *key) {
    const size_t length = strlen(r->path);
    snprintf(r->path + length, sizeof(r->path) - length, "%s%.63s", length != 0 ? "." : "", key);
    return length;
}

static size_t enter_index(reader *r, size_t index) {
    const size_t length = strlen(r->path);
    snprintf(r->path + length, sizeof(r->path) - length, "[%zu]", index);
    return length;
}

static void leave(reader *r, size_t length) { r->path[length] = '\0'; }

// ---- reading: values
// ------------------------------------------------------------------------------

static bool is_known(const char *key, const char *const *keys) {
    for (; *keys != NULL; ++keys) {
        if (strcmp(*keys, key) == 0) {
            return true;
        }
    }
    return false;
}

// Whether `object` is an object, and has no key twice and none but `keys` (NULL-terminated).
static bool check_object(reader *r, const cJSON *object, const char *const *keys) {
    if (!cJSON_IsObject(object)) {
        return fail(r, "must be an object");
    }
    const cJSON *item = NULL;
    cJSON_ArrayForEach(item, object) {
        const size_t length = enter_key(r, item->string);
        if (!is_known(item->string, keys)) {
            return fail(r, "unknown key");
        }
        if (cJSON_GetObjectItemCaseSensitive(object, item->string) != item) {
            return fail(r, "the key is given twice");
        }
        leave(r, length);
    }
    return true;
}

static bool has_key(const cJSON *object, const char *key) {
    return cJSON_GetObjectItemCaseSensitive(object, key) != NULL;
}

// The value of a key; NULL, and an error where it is required, when there is none.
static const cJSON *find(reader *r, const cJSON *object, const char *key, bool required) {
    const cJSON *item = cJSON_GetObjectItemCaseSensitive(object, key);
    if (item == NULL && required) {
        enter_key(r, key);
        fail(r, "is missing");
    }
    return item;
}

static bool check_number(reader *r, const cJSON *item, double minimum, double maximum,
                         double *value) {
    if (!cJSON_IsNumber(item)) {
        return fail(r, "must be a number");
    }
    if (!(item->valuedouble >= minimum && item->valuedouble <= maximum)) {
        return fail(r, "%.10g is out of range, it must be between %.10g and %.10g",
                    item->valuedouble, minimum, maximum);
    }
    *value = item->valuedouble;
    return true;
}

// Each of the following leaves `value` alone where the key is missing and not required.
static bool read_number(reader *r, const cJSON *object, const char *key, bool required,
                        double minimum, double maximum, double *value) {
    const cJSON *item = find(r, object, key, required);
    if (item == NULL) {
        return !required;
    }
    const size_t length = enter_key(r, key);
    const bool good = check_number(r, item, minimum, maximum, value);
    leave(r, length);
    return good;
}

static const double coordinate_limit = 1e30, time_limit = 1e6;

static bool read_vector(reader *r, const cJSON *object, const char *key, bool required,
                        size_t count, double *values) {
    const cJSON *item = find(r, object, key, required);
    if (item == NULL) {
        return !required;
    }
    const size_t length = enter_key(r, key);
    if (!cJSON_IsArray(item) || cJSON_GetArraySize(item) != (int)count) {
        return fail(r, "must be a list of %zu numbers", count);
    }
    for (size_t k = 0; k < count; ++k) {
        const size_t inner = enter_index(r, k);
        if (!check_number(r, cJSON_GetArrayItem(item, (int)k), -coordinate_limit, coordinate_limit,
                          &values[k])) {
            return false;
        }
        leave(r, inner);
    }
    leave(r, length);
    return true;
}

static bool read_name(reader *r, const cJSON *object, const char *key, bool required,
                      char name[PC_NAME_SIZE]) {
    const cJSON *item = find(r, object, key, required);
    if (item == NULL) {
        return !required;
    }
    const size_t length = enter_key(r, key);
    const char *text = cJSON_GetStringValue(item);
    if (text == NULL || text[0] == '\0' || strlen(text) >= PC_NAME_SIZE) {
        return fail(r, "must be a text of 1 to %d bytes", PC_NAME_SIZE - 1);
    }
    memcpy(name, text, strlen(text));
    leave(r, length);
    return true;
}

static bool read_bool(reader *r, const cJSON *object, const char *key, bool *value) {
    const cJSON *item = find(r, object, key, false);
    if (item != NULL && !cJSON_IsBool(item)) {
        enter_key(r, key);
        return fail(r, "must be true or false");
    }
    *value = item != NULL ? cJSON_IsTrue(item) != 0 : *value;
    return true;
}

static bool read_choice(reader *r, const cJSON *object, const char *key, const char *const *names,
                        size_t *choice) {
    const cJSON *item = find(r, object, key, true);
    const char *text = cJSON_GetStringValue(item);
    for (*choice = 0; text != NULL && names[*choice] != NULL; ++*choice) {
        if (strcmp(names[*choice], text) == 0) {
            return true;
        }
    }
    enter_key(r, key);
    char known[128] = "";
    for (size_t i = 0; names[i] != NULL; ++i) {
        const size_t length = strlen(known);
        snprintf(known + length, sizeof(known) - length, "%s%s", i != 0 ? ", " : "", names[i]);
    }
    return fail(r, "must be one of %s", known);
}

// A list of objects: its length and memory for its elements; false where it is none.
static bool begin_list(reader *r, const cJSON *list, size_t element_size, size_t *count,
                       void **elements) {
    if (!cJSON_IsArray(list) || cJSON_GetArraySize(list) == 0) {
        return fail(r, "must be a list with at least one entry");
    }
    const size_t wanted = (size_t)cJSON_GetArraySize(list);
    *elements = pci_allocate(r->context, wanted, element_size);
    *count = *elements != NULL ? wanted : 0;
    return *elements != NULL || out_of_memory(r);
}

// ---- reading: parts of the scenario
// ---------------------------------------------------------------

static bool read_time(reader *r, const cJSON *object, double before, bool first, double *time) {
    if (!read_number(r, object, "time", true, -time_limit, time_limit, time)) {
        return false;
    }
    if (!first && *time <= before) {
        enter_key(r, "time");
        return fail(r, "times must ascend");
    }
    return true;
}

static bool read_winds(reader *r, const cJSON *list, pc_scenario *scenario) {
    static const char *const keys[] = {"time", "velocity", NULL};
    void *memory = NULL;
    if (!begin_list(r, list, sizeof(pc_wind_key), &scenario->wind_count, &memory)) {
        return false;
    }
    scenario->winds = memory;
    size_t i = 0;
    const cJSON *item = NULL;
    cJSON_ArrayForEach(item, list) {
        pc_wind_key *key = &scenario->winds[i];
        const size_t length = enter_index(r, i);
        if (!check_object(r, item, keys) ||
            !read_time(r, item, i > 0 ? key[-1].time : 0.0, i == 0, &key->time) ||
            !read_vector(r, item, "velocity", true, 3, key->velocity)) {
            return false;
        }
        leave(r, length);
        ++i;
    }
    return true;
}

static bool read_box(reader *r, const cJSON *box, pc_pin *pin) {
    static const char *const keys[] = {"min", "max", NULL};
    if (!check_object(r, box, keys) || !read_vector(r, box, "min", true, 3, pin->minimum) ||
        !read_vector(r, box, "max", true, 3, pin->maximum)) {
        return false;
    }
    for (size_t k = 0; k < 3; ++k) {
        if (pin->minimum[k] > pin->maximum[k]) {
            return fail(r, "min[%zu] exceeds max[%zu]", k, k);
        }
    }
    return true;
}

static bool read_pin(reader *r, const cJSON *item, pc_pin *pin) {
    static const char *const kinds[] = {"highest", "box", "attribute", "mesh", "material", NULL};
    static const char *const keys[] = {"highest", "box",      "attribute", "above",
                                       "mesh",    "material", NULL};
    if (!check_object(r, item, keys)) {
        return false;
    }
    size_t found = 0;
    for (size_t k = 0; kinds[k] != NULL; ++k) {
        if (has_key(item, kinds[k])) {
            pin->kind = (pc_pin_kind)k;
            ++found;
        }
    }
    if (found != 1) {
        return fail(r, "needs exactly one of highest, box, attribute, mesh, material");
    }
    if (pin->kind != PC_PIN_ATTRIBUTE && has_key(item, "above")) {
        enter_key(r, "above");
        return fail(r, "needs an attribute");
    }
    size_t length, choice = 0;
    bool good = false;
    switch (pin->kind) {
    case PC_PIN_HIGHEST:
        return read_number(r, item, "highest", true, 0.0, 1.0, &pin->fraction);
    case PC_PIN_BOX:
        length = enter_key(r, "box");
        good = read_box(r, cJSON_GetObjectItemCaseSensitive(item, "box"), pin);
        leave(r, length);
        return good;
    case PC_PIN_ATTRIBUTE:
        good =
            read_choice(r, item, "attribute", attribute_names, &choice) &&
            read_number(r, item, "above", true, -coordinate_limit, coordinate_limit, &pin->above);
        pin->attribute = (pc_attribute)choice;
        return good;
    case PC_PIN_MESH:
    case PC_PIN_MATERIAL:
        break;
    }
    return read_name(r, item, kinds[pin->kind], true, pin->name);
}

static bool read_pins(reader *r, const cJSON *list, pc_scenario *scenario) {
    void *memory = NULL;
    if (!begin_list(r, list, sizeof(pc_pin), &scenario->pin_count, &memory)) {
        return false;
    }
    scenario->pins = memory;
    size_t i = 0;
    const cJSON *item = NULL;
    cJSON_ArrayForEach(item, list) {
        const size_t length = enter_index(r, i);
        if (!read_pin(r, item, &scenario->pins[i++])) {
            return false;
        }
        leave(r, length);
    }
    return true;
}

static bool read_rigid_key(reader *r, const cJSON *item, size_t i, pc_rigid_key *key) {
    static const char *const keys[] = {"time", "translation", "rotation", NULL};
    key->rotation[3] = 1.0;
    if (!check_object(r, item, keys) ||
        !read_time(r, item, i > 0 ? key[-1].time : 0.0, i == 0, &key->time) ||
        !read_vector(r, item, "translation", false, 3, key->translation) ||
        !read_vector(r, item, "rotation", false, 4, key->rotation)) {
        return false;
    }
    double length = 0.0;
    for (size_t k = 0; k < 4; ++k) {
        length += key->rotation[k] * key->rotation[k];
    }
    if (!(length > 1e-12 && length < 1e12)) {
        enter_key(r, "rotation");
        return fail(r, "is no rotation");
    }
    return true;
}

static bool read_attachment(reader *r, const cJSON *object, pc_attachment *attachment) {
    static const char *const clip_keys[] = {"clip", "start", "loop", "blend", NULL};
    static const char *const rigid_keys[] = {"keys", "pivot", NULL};
    attachment->blend = 0.5;
    attachment->loop = true;
    if (has_key(object, "clip")) {
        attachment->kind = PC_ATTACHMENT_CLIP;
        return check_object(r, object, clip_keys) &&
               read_name(r, object, "clip", true, attachment->clip) &&
               read_number(r, object, "start", false, 0.0, time_limit, &attachment->start) &&
               read_number(r, object, "blend", false, 0.0, 60.0, &attachment->blend) &&
               read_bool(r, object, "loop", &attachment->loop);
    }
    attachment->kind = PC_ATTACHMENT_RIGID;
    if (!check_object(r, object, rigid_keys) ||
        !read_vector(r, object, "pivot", false, 3, attachment->pivot)) {
        return false;
    }
    const cJSON *list = cJSON_GetObjectItemCaseSensitive(object, "keys");
    if (list == NULL) {
        return fail(r, "needs clip or keys");
    }
    const size_t outer = enter_key(r, "keys");
    void *memory = NULL;
    if (!begin_list(r, list, sizeof(pc_rigid_key), &attachment->key_count, &memory)) {
        return false;
    }
    attachment->keys = memory;
    size_t i = 0;
    const cJSON *item = NULL;
    cJSON_ArrayForEach(item, list) {
        const size_t length = enter_index(r, i);
        if (!read_rigid_key(r, item, i, &attachment->keys[i])) {
            return false;
        }
        leave(r, length);
        ++i;
    }
    leave(r, outer);
    return true;
}

static bool read_collider(reader *r, const cJSON *item, pc_collider *collider) {
    static const char *const keys[][6] = {{"shape", "center", "radius", "joint", NULL},
                                          {"shape", "from", "to", "radius", "joint", NULL},
                                          {"shape", "mesh", NULL}};
    size_t shape = 0;
    if (!cJSON_IsObject(item)) {
        return fail(r, "must be an object");
    }
    if (!read_choice(r, item, "shape", shape_names, &shape) ||
        !check_object(r, item, keys[shape])) {
        return false;
    }
    collider->kind = (pc_collider_kind)shape;
    if (collider->kind == PC_COLLIDER_BODY) {
        return read_name(r, item, "mesh", false, collider->mesh);
    }
    const bool sphere = collider->kind == PC_COLLIDER_SPHERE;
    return read_vector(r, item, sphere ? "center" : "from", true, 3, collider->from) &&
           (sphere || read_vector(r, item, "to", true, 3, collider->to)) &&
           read_number(r, item, "radius", true, 1e-12, coordinate_limit, &collider->radius) &&
           read_name(r, item, "joint", false, collider->joint);
}

static bool read_colliders(reader *r, const cJSON *list, pc_scenario *scenario) {
    void *memory = NULL;
    if (!begin_list(r, list, sizeof(pc_collider), &scenario->collider_count, &memory)) {
        return false;
    }
    scenario->colliders = memory;
    size_t i = 0;
    const cJSON *item = NULL;
    cJSON_ArrayForEach(item, list) {
        const size_t length = enter_index(r, i);
        if (!read_collider(r, item, &scenario->colliders[i++])) {
            return false;
        }
        leave(r, length);
    }
    return true;
}

// ---- reading: the whole
// ---------------------------------------------------------------------------

static bool read_option(reader *r, const cJSON *item, const pc_field *field,
                        pc_simulate_options *options) {
    char text[64] = "";
    if (field->type == PC_FIELD_CHOICE) {
        if (!cJSON_IsString(item)) {
            return fail(r, "must be a text");
        }
        snprintf(text, sizeof(text), "%s", item->valuestring);
    } else {
        if (!cJSON_IsNumber(item)) {
            return fail(r, "must be a number");
        }
        pci_number_text(item->valuedouble, text);
    }
    if (pc_field_set_text(r->context, "simulate", field, options, text) == PC_OK) {
        return true;
    }
    char problem[200]; // it lies where the new message is going to be
    snprintf(problem, sizeof(problem), "%.199s", pc_context_error(r->context)->message);
    return fail(r, "%s", problem);
}

static bool read_key(reader *r, const cJSON *item, pc_simulate_options *options,
                     pc_scenario *scenario) {
    const pc_field *field = pc_record_find(&pc_simulate_options_record, item->string);
    if (field != NULL) {
        return read_option(r, item, field, options);
    }
    if (strcmp(item->string, "winds") == 0) {
        return read_winds(r, item, scenario);
    }
    if (strcmp(item->string, "pins") == 0) {
        return read_pins(r, item, scenario);
    }
    if (strcmp(item->string, "attachment") == 0) {
        return read_attachment(r, item, &scenario->attachment);
    }
    if (strcmp(item->string, "colliders") == 0) {
        return read_colliders(r, item, scenario);
    }
    return strcmp(item->string, "duration") == 0 || fail(r, "unknown key");
}

// Frames from seconds, when all other options are known.
static bool read_duration(reader *r, const cJSON *root, pc_simulate_options *options) {
    double duration = 0.0;
    if (!has_key(root, "duration")) {
        return true;
    }
    if (!read_number(r, root, "duration", true, 0.0001, time_limit, &duration)) {
        return false;
    }
    enter_key(r, "duration");
    if (has_key(root, "frames")) {
        return fail(r, "frames are given as well");
    }
    const pc_field *field = pc_record_find(&pc_simulate_options_record, "frames");
    const double frame_time = options->time_step * (double)options->frame_steps;
    const double frames = fmax(1.0, floor(duration / frame_time + 0.5));
    if (frames > field->maximum) {
        return fail(r, "%.10g s are %.10g frames, at most %.10g are allowed", duration, frames,
                    field->maximum);
    }
    options->frames = (uint32_t)frames;
    return true;
}

static bool read_root(reader *r, const cJSON *root, pc_simulate_options *options,
                      pc_scenario *scenario) {
    if (!cJSON_IsObject(root)) {
        return fail(r, "the file must hold one JSON object");
    }
    const cJSON *item = NULL;
    cJSON_ArrayForEach(item, root) {
        const size_t length = enter_key(r, item->string);
        if (cJSON_GetObjectItemCaseSensitive(root, item->string) != item) {
            return fail(r, "the key is given twice");
        }
        if (!read_key(r, item, options, scenario)) {
            return false;
        }
        leave(r, length);
    }
    return read_duration(r, root, options);
}

pc_status pc_scenario_parse(pc_context *context, const char *text, size_t size, const char *name,
                            pc_simulate_options *options, pc_scenario *scenario) {
    static const pc_scenario empty;
    if (context == NULL) {
        return PC_ERROR_INVALID_ARGUMENT;
    }
    if (text == NULL || name == NULL || options == NULL || scenario == NULL ||
        memcmp(scenario, &empty, sizeof(empty)) != 0) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "scenario: a pointer is NULL, or the output is not empty");
    }
    reader r = {.context = context, .file = name};
    pc_simulate_options chosen = *options;
    const char *end = NULL;
    cJSON *root = cJSON_ParseWithLengthOpts(text, size, &end, 0);
    const char *rest = end != NULL ? end : text;
    while (root != NULL && rest < text + size && strchr(" \t\r\n", *rest) != NULL &&
           *rest != '\0') {
        ++rest;
    }
    if (root == NULL || rest != text + size) {
        size_t line = 1;
        for (const char *at = text; at < rest && at < text + size; ++at) {
            line += *at == '\n';
        }
        r.status = pci_fail(context, PC_ERROR_FORMAT, stage, "%.200s: line %zu is no valid JSON",
                            name, line);
    } else if (read_root(&r, root, &chosen, scenario)) {
        *options = chosen;
    }
    cJSON_Delete(root);
    if (r.status != PC_OK) {
        pc_scenario_free(context, scenario);
    }
    return r.status;
}

pc_status pc_scenario_read(pc_context *context, const char *path, pc_simulate_options *options,
                           pc_scenario *scenario) {
    if (context == NULL || path == NULL) {
        return context == NULL ? PC_ERROR_INVALID_ARGUMENT
                               : pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                                          "scenario: the path is NULL");
    }
    unsigned char *bytes = NULL;
    size_t size = 0;
    pc_status status = pci_read_file(context, stage, path, &bytes, &size);
    if (status == PC_OK) {
        status = pc_scenario_parse(context, (const char *)bytes, size, path, options, scenario);
    }
    pc_release(context, bytes);
    return status;
}

// ---- writing
// --------------------------------------------------------------------------------------

static void write_vector(pci_json *json, cJSON *parent, const char *name, const double *values,
                         size_t count) {
    cJSON *array = pci_json_array(json, parent, name);
    for (size_t k = 0; k < count; ++k) {
        pci_json_number(json, array, NULL, values[k]);
    }
}

static void write_pin(pci_json *json, cJSON *list, const pc_pin *pin) {
    cJSON *object = pci_json_object(json, list, NULL), *box;
    switch (pin->kind) {
    case PC_PIN_HIGHEST:
        pci_json_number(json, object, "highest", pin->fraction);
        return;
    case PC_PIN_BOX:
        box = pci_json_object(json, object, "box");
        write_vector(json, box, "min", pin->minimum, 3);
        write_vector(json, box, "max", pin->maximum, 3);
        return;
    case PC_PIN_ATTRIBUTE:
        pci_json_string(json, object, "attribute", attribute_names[pin->attribute]);
        pci_json_number(json, object, "above", pin->above);
        return;
    case PC_PIN_MESH:
        pci_json_string(json, object, "mesh", pin->name);
        return;
    case PC_PIN_MATERIAL:
        pci_json_string(json, object, "material", pin->name);
        return;
    }
}

static void write_attachment(pci_json *json, const pc_attachment *attachment) {
    if (attachment->kind == PC_ATTACHMENT_NONE) {
        return;
    }
    cJSON *object = pci_json_object(json, json->root, "attachment");
    if (attachment->kind == PC_ATTACHMENT_CLIP) {
        pci_json_string(json, object, "clip", attachment->clip);
        pci_json_number(json, object, "start", attachment->start);
        pci_json_bool(json, object, "loop", attachment->loop);
        pci_json_number(json, object, "blend", attachment->blend);
        return;
    }
    write_vector(json, object, "pivot", attachment->pivot, 3);
    cJSON *list = pci_json_array(json, object, "keys");
    for (size_t i = 0; i < attachment->key_count; ++i) {
        cJSON *key = pci_json_object(json, list, NULL);
        pci_json_number(json, key, "time", attachment->keys[i].time);
        write_vector(json, key, "translation", attachment->keys[i].translation, 3);
        write_vector(json, key, "rotation", attachment->keys[i].rotation, 4);
    }
}

static void write_collider(pci_json *json, cJSON *list, const pc_collider *collider) {
    cJSON *object = pci_json_object(json, list, NULL);
    pci_json_string(json, object, "shape", shape_names[collider->kind]);
    if (collider->kind == PC_COLLIDER_BODY) {
        if (collider->mesh[0] != '\0') {
            pci_json_string(json, object, "mesh", collider->mesh);
        }
        return;
    }
    const bool sphere = collider->kind == PC_COLLIDER_SPHERE;
    write_vector(json, object, sphere ? "center" : "from", collider->from, 3);
    if (!sphere) {
        write_vector(json, object, "to", collider->to, 3);
    }
    pci_json_number(json, object, "radius", collider->radius);
    if (collider->joint[0] != '\0') {
        pci_json_string(json, object, "joint", collider->joint);
    }
}

char *pci_scenario_text(pc_context *context, const pc_scenario *scenario) {
    pci_json json;
    pci_json_begin(&json);
    cJSON *list = scenario->wind_count != 0 ? pci_json_array(&json, json.root, "winds") : NULL;
    for (size_t i = 0; i < scenario->wind_count; ++i) {
        cJSON *key = pci_json_object(&json, list, NULL);
        pci_json_number(&json, key, "time", scenario->winds[i].time);
        write_vector(&json, key, "velocity", scenario->winds[i].velocity, 3);
    }
    list = scenario->pin_count != 0 ? pci_json_array(&json, json.root, "pins") : NULL;
    for (size_t i = 0; i < scenario->pin_count; ++i) {
        write_pin(&json, list, &scenario->pins[i]);
    }
    write_attachment(&json, &scenario->attachment);
    list = scenario->collider_count != 0 ? pci_json_array(&json, json.root, "colliders") : NULL;
    for (size_t i = 0; i < scenario->collider_count; ++i) {
        write_collider(&json, list, &scenario->colliders[i]);
    }
    char *printed = pci_json_print(&json, false), *text = NULL;
    pci_json_end(&json);
    if (printed != NULL) {
        text = PCI_ALLOCATE(context, char, strlen(printed) + 1);
        if (text != NULL) {
            memcpy(text, printed, strlen(printed));
        }
        cJSON_free(printed);
    }
    return text;
}

// A scenario that a program filled goes through its own text: one set of rules.
pc_status pc_scenario_check(pc_context *context, const pc_scenario *scenario) {
    for (size_t i = 0; i < scenario->pin_count; ++i) {
        const pc_pin *pin = &scenario->pins[i];
        if (pin->kind > PC_PIN_MATERIAL || pin->attribute > PC_ATTRIBUTE_V ||
            memchr(pin->name, '\0', PC_NAME_SIZE) == NULL) {
            return pci_fail(context, PC_ERROR_INVALID_OPTIONS, stage,
                            "scenario: pin %zu has an unknown kind or attribute, or a name without "
                            "end",
                            i);
        }
    }
    for (size_t i = 0; i < scenario->collider_count; ++i) {
        const pc_collider *collider = &scenario->colliders[i];
        if (collider->kind > PC_COLLIDER_BODY ||
            memchr(collider->joint, '\0', PC_NAME_SIZE) == NULL ||
            memchr(collider->mesh, '\0', PC_NAME_SIZE) == NULL) {
            return pci_fail(context, PC_ERROR_INVALID_OPTIONS, stage,
                            "scenario: collider %zu has an unknown kind, or a name without end", i);
        }
    }
    if (scenario->attachment.kind > PC_ATTACHMENT_RIGID ||
        memchr(scenario->attachment.clip, '\0', PC_NAME_SIZE) == NULL) {
        return pci_fail(context, PC_ERROR_INVALID_OPTIONS, stage,
                        "scenario: the attachment has an unknown kind, or a clip without end");
    }
    pc_simulate_options options;
    pc_record_set_defaults(&pc_simulate_options_record, &options);
    pc_scenario copy = {0};
    char *text = pci_scenario_text(context, scenario);
    if (text == NULL) {
        return pci_fail_memory(context, stage);
    }
    const pc_status status =
        pc_scenario_parse(context, text, strlen(text), "scenario", &options, &copy);
    pc_release(context, text);
    pc_scenario_free(context, &copy);
    return status;
}
