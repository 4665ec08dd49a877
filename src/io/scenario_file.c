// Scenario <-> JSON. Every message starts with the file's name and the path of the key.
#include "io/scenario_file.h"


#include "io/atomic_file.h"
#include "io/json.h"
#include "io/json_reader.h"
#include "proxycloth/simulate.h"

static const char stage[] = "scenario";

static const char *const attribute_names[] = {"red", "green", "blue", "alpha", "u", "v", NULL};
static const char *const shape_names[] = {"sphere", "capsule", "body", NULL};

static const double coordinate_limit = 1e30, time_limit = 1e6;

// ---- reading: parts of the scenario ------------------------------------------------------------

static bool read_time(pci_json_reader *r, const cJSON *object, double before, bool first,
                      double *time) {
    if (!pci_json_read_number(r, object, "time", true, -time_limit, time_limit, time)) {
        return false;
    }
    if (!first && *time <= before) {
        pci_json_enter_key(r, "time");
        return pci_json_fail(r, "times must ascend");
    }
    return true;
}

static bool read_winds(pci_json_reader *r, const cJSON *list, pc_scenario *scenario) {
    static const char *const keys[] = {"time", "velocity", NULL};
    void *memory = NULL;
    if (!pci_json_begin_list(r, list, sizeof(pc_wind_key), &scenario->wind_count, &memory)) {
        return false;
    }
    scenario->winds = memory;
    size_t i = 0;
    const cJSON *item = NULL;
    cJSON_ArrayForEach(item, list) {
        pc_wind_key *key = &scenario->winds[i];
        const size_t length = pci_json_enter_index(r, i);
        if (!pci_json_check_object(r, item, keys) ||
            !read_time(r, item, i > 0 ? key[-1].time : 0.0, i == 0, &key->time) ||
            !pci_json_read_vector(r, item, "velocity", true, coordinate_limit, 3, key->velocity)) {
            return false;
        }
        pci_json_leave(r, length);
        ++i;
    }
    return true;
}

static bool read_box(pci_json_reader *r, const cJSON *box, pc_pin *pin) {
    static const char *const keys[] = {"min", "max", NULL};
    if (!pci_json_check_object(r, box, keys) ||
        !pci_json_read_vector(r, box, "min", true, coordinate_limit, 3, pin->minimum) ||
        !pci_json_read_vector(r, box, "max", true, coordinate_limit, 3, pin->maximum)) {
        return false;
    }
    for (size_t k = 0; k < 3; ++k) {
        if (pin->minimum[k] > pin->maximum[k]) {
            return pci_json_fail(r, "min[%zu] exceeds max[%zu]", k, k);
        }
    }
    return true;
}

static bool read_pin(pci_json_reader *r, const cJSON *item, pc_pin *pin) {
    static const char *const kinds[] = {"highest", "box", "attribute", "mesh", "material", NULL};
    static const char *const keys[] = {"highest", "box",      "attribute", "above",
                                       "mesh",    "material", NULL};
    if (!pci_json_check_object(r, item, keys)) {
        return false;
    }
    size_t found = 0;
    for (size_t k = 0; kinds[k] != NULL; ++k) {
        if (pci_json_has_key(item, kinds[k])) {
            pin->kind = (pc_pin_kind)k;
            ++found;
        }
    }
    if (found != 1) {
        return pci_json_fail(r, "needs exactly one of highest, box, attribute, mesh, material");
    }
    if (pin->kind != PC_PIN_ATTRIBUTE && pci_json_has_key(item, "above")) {
        pci_json_enter_key(r, "above");
        return pci_json_fail(r, "needs an attribute");
    }
    size_t length, choice = 0;
    bool good = false;
    switch (pin->kind) {
    case PC_PIN_HIGHEST:
        return pci_json_read_number(r, item, "highest", true, 0.0, 1.0, &pin->fraction);
    case PC_PIN_BOX:
        length = pci_json_enter_key(r, "box");
        good = read_box(r, cJSON_GetObjectItemCaseSensitive(item, "box"), pin);
        pci_json_leave(r, length);
        return good;
    case PC_PIN_ATTRIBUTE:
        good = pci_json_read_choice(r, item, "attribute", attribute_names, &choice) &&
               pci_json_read_number(r, item, "above", true, -coordinate_limit, coordinate_limit,
                                    &pin->above);
        pin->attribute = (pc_attribute)choice;
        return good;
    case PC_PIN_MESH:
    case PC_PIN_MATERIAL:
        break;
    }
    return pci_json_read_text(r, item, kinds[pin->kind], true, PC_NAME_SIZE, pin->name);
}

static bool read_pins(pci_json_reader *r, const cJSON *list, pc_scenario *scenario) {
    void *memory = NULL;
    if (!pci_json_begin_list(r, list, sizeof(pc_pin), &scenario->pin_count, &memory)) {
        return false;
    }
    scenario->pins = memory;
    size_t i = 0;
    const cJSON *item = NULL;
    cJSON_ArrayForEach(item, list) {
        const size_t length = pci_json_enter_index(r, i);
        if (!read_pin(r, item, &scenario->pins[i++])) {
            return false;
        }
        pci_json_leave(r, length);
    }
    return true;
}

static bool read_rigid_key(pci_json_reader *r, const cJSON *item, size_t i, pc_rigid_key *key) {
    static const char *const keys[] = {"time", "translation", "rotation", NULL};
    key->rotation[3] = 1.0;
    if (!pci_json_check_object(r, item, keys) ||
        !read_time(r, item, i > 0 ? key[-1].time : 0.0, i == 0, &key->time) ||
        !pci_json_read_vector(r, item, "translation", false, coordinate_limit, 3,
                              key->translation) ||
        !pci_json_read_vector(r, item, "rotation", false, coordinate_limit, 4, key->rotation)) {
        return false;
    }
    double length = 0.0;
    for (size_t k = 0; k < 4; ++k) {
        length += key->rotation[k] * key->rotation[k];
    }
    if (!(length > 1e-12 && length < 1e12)) {
        pci_json_enter_key(r, "rotation");
        return pci_json_fail(r, "is no rotation");
    }
    return true;
}

static bool read_attachment(pci_json_reader *r, const cJSON *object, pc_attachment *attachment) {
    static const char *const clip_keys[] = {"clip", "start", "loop", "blend", NULL};
    static const char *const rigid_keys[] = {"keys", "pivot", NULL};
    attachment->blend = 0.5;
    attachment->loop = true;
    if (pci_json_has_key(object, "clip")) {
        attachment->kind = PC_ATTACHMENT_CLIP;
        return pci_json_check_object(r, object, clip_keys) &&
               pci_json_read_text(r, object, "clip", true, PC_NAME_SIZE, attachment->clip) &&
               pci_json_read_number(r, object, "start", false, 0.0, time_limit,
                                    &attachment->start) &&
               pci_json_read_number(r, object, "blend", false, 0.0, 60.0, &attachment->blend) &&
               pci_json_read_bool(r, object, "loop", &attachment->loop);
    }
    attachment->kind = PC_ATTACHMENT_RIGID;
    if (!pci_json_check_object(r, object, rigid_keys) ||
        !pci_json_read_vector(r, object, "pivot", false, coordinate_limit, 3, attachment->pivot)) {
        return false;
    }
    const cJSON *list = cJSON_GetObjectItemCaseSensitive(object, "keys");
    if (list == NULL) {
        return pci_json_fail(r, "needs clip or keys");
    }
    const size_t outer = pci_json_enter_key(r, "keys");
    void *memory = NULL;
    if (!pci_json_begin_list(r, list, sizeof(pc_rigid_key), &attachment->key_count, &memory)) {
        return false;
    }
    attachment->keys = memory;
    size_t i = 0;
    const cJSON *item = NULL;
    cJSON_ArrayForEach(item, list) {
        const size_t length = pci_json_enter_index(r, i);
        if (!read_rigid_key(r, item, i, &attachment->keys[i])) {
            return false;
        }
        pci_json_leave(r, length);
        ++i;
    }
    pci_json_leave(r, outer);
    return true;
}

static bool read_collider(pci_json_reader *r, const cJSON *item, pc_collider *collider) {
    static const char *const keys[][6] = {{"shape", "center", "radius", "joint", NULL},
                                          {"shape", "from", "to", "radius", "joint", NULL},
                                          {"shape", "mesh", NULL}};
    size_t shape = 0;
    if (!cJSON_IsObject(item)) {
        return pci_json_fail(r, "must be an object");
    }
    if (!pci_json_read_choice(r, item, "shape", shape_names, &shape) ||
        !pci_json_check_object(r, item, keys[shape])) {
        return false;
    }
    collider->kind = (pc_collider_kind)shape;
    if (collider->kind == PC_COLLIDER_BODY) {
        return pci_json_read_text(r, item, "mesh", false, PC_NAME_SIZE, collider->mesh);
    }
    const bool sphere = collider->kind == PC_COLLIDER_SPHERE;
    return pci_json_read_vector(r, item, sphere ? "center" : "from", true, coordinate_limit, 3,
                                collider->from) &&
           (sphere ||
            pci_json_read_vector(r, item, "to", true, coordinate_limit, 3, collider->to)) &&
           pci_json_read_number(r, item, "radius", true, 1e-12, coordinate_limit,
                                &collider->radius) &&
           pci_json_read_text(r, item, "joint", false, PC_NAME_SIZE, collider->joint);
}

static bool read_colliders(pci_json_reader *r, const cJSON *list, pc_scenario *scenario) {
    void *memory = NULL;
    if (!pci_json_begin_list(r, list, sizeof(pc_collider), &scenario->collider_count, &memory)) {
        return false;
    }
    scenario->colliders = memory;
    size_t i = 0;
    const cJSON *item = NULL;
    cJSON_ArrayForEach(item, list) {
        const size_t length = pci_json_enter_index(r, i);
        if (!read_collider(r, item, &scenario->colliders[i++])) {
            return false;
        }
        pci_json_leave(r, length);
    }
    return true;
}

// ---- reading: the whole ------------------------------------------------------------------------

static bool read_key(pci_json_reader *r, const cJSON *item, pc_simulate_options *options,
                     pc_scenario *scenario) {
    const pc_field *field = pc_record_find(&pc_simulate_options_record, item->string);
    if (field != NULL) {
        return pci_json_read_field(r, item, "simulate", field, options);
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
    return strcmp(item->string, "duration") == 0 || pci_json_fail(r, "unknown key");
}

// Frames from seconds, when all other options are known.
static bool read_duration(pci_json_reader *r, const cJSON *root, pc_simulate_options *options) {
    double duration = 0.0;
    if (!pci_json_has_key(root, "duration")) {
        return true;
    }
    if (!pci_json_read_number(r, root, "duration", true, 0.0001, time_limit, &duration)) {
        return false;
    }
    pci_json_enter_key(r, "duration");
    if (pci_json_has_key(root, "frames")) {
        return pci_json_fail(r, "frames are given as well");
    }
    const pc_field *field = pc_record_find(&pc_simulate_options_record, "frames");
    const double frame_time = options->time_step * (double)options->frame_steps;
    const double frames = fmax(1.0, floor(duration / frame_time + 0.5));
    if (frames > field->maximum) {
        return pci_json_fail(r, "%.10g s are %.10g frames, at most %.10g are allowed", duration,
                             frames, field->maximum);
    }
    options->frames = (uint32_t)frames;
    return true;
}

static bool read_root(pci_json_reader *r, const cJSON *root, pc_simulate_options *options,
                      pc_scenario *scenario) {
    if (!cJSON_IsObject(root)) {
        return pci_json_fail(r, "the file must hold one JSON object");
    }
    const cJSON *item = NULL;
    cJSON_ArrayForEach(item, root) {
        const size_t length = pci_json_enter_key(r, item->string);
        if (!pci_json_check_unique(r, root, item) || !read_key(r, item, options, scenario)) {
            return false;
        }
        pci_json_leave(r, length);
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
    pci_json_reader r = {.context = context, .stage = stage, .file = name};
    pc_simulate_options chosen = *options;
    cJSON *root = pci_json_parse(&r, text, size);
    if (root != NULL && read_root(&r, root, &chosen, scenario)) {
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

// ---- writing -----------------------------------------------------------------------------------

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
    char *text = pci_json_text(context, &json, false);
    pci_json_end(&json);
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
