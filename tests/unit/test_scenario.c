#define _POSIX_C_SOURCE 200809L
#include <stdio.h>
#include <unistd.h>

#include "io/scenario_file.h"
#include "support/memory.h"

static pc_simulate_options default_options(void) {
    pc_simulate_options options;
    pc_record_set_defaults(&pc_simulate_options_record, &options);
    return options;
}

static pc_status parse(pc_context *context, const char *text, pc_simulate_options *options,
                       pc_scenario *scenario) {
    return pc_scenario_parse(context, text, strlen(text), "cape.json", options, scenario);
}

static const char everything[] =
    "{\"gravity\": 1.62, \"dynamics\": \"xpbd\", \"time_step\": 0.01, \"frame_steps\": 2,\n"
    " \"duration\": 3, \"substeps\": 7,\n"
    " \"winds\": [{\"time\": 0, \"velocity\": [0, 0, 3]}, {\"time\": 1.5, \"velocity\": [1, 2, "
    "0.1]}],\n"
    " \"pins\": [{\"highest\": 0.1}, {\"box\": {\"min\": [-1, 0, -1], \"max\": [1, 0.5, 1]}},\n"
    "          {\"attribute\": \"blue\", \"above\": 0.5}, {\"mesh\": \"Cape*\"},\n"
    "          {\"material\": \"le?ther\"}],\n"
    " \"attachment\": {\"clip\": \"Walking_A\", \"start\": 0.25, \"loop\": false, \"blend\": 0},\n"
    " \"colliders\": [{\"shape\": \"sphere\", \"center\": [0, 1, 0], \"radius\": 0.3},\n"
    "    {\"shape\": \"capsule\", \"from\": [0, 0, 0], \"to\": [0, 1, 0], \"radius\": 0.1, "
    "\"joint\": \"Hips\"},\n"
    "    {\"shape\": \"body\", \"mesh\": \"Knight_*\"}, {\"shape\": \"body\"}]}\n";

static void reads_everything(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_simulate_options options = default_options();
    pc_scenario s = {0};
    options.seed = 9;
    assert_ok(context, parse(context, everything, &options, &s));
    assert_close(options.gravity, 1.62, 0.0);
    assert_int_equal(options.dynamics, 1);
    assert_int_equal(options.substeps, 7);
    assert_int_equal(options.frames, 150); // 3 s of 2 x 0.01 s
    assert_int_equal(options.seed, 9);     // not in the file
    assert_int_equal(s.wind_count, 2);
    assert_close(s.winds[1].time, 1.5, 0.0);
    assert_close(s.winds[1].velocity[2], 0.1, 0.0);
    assert_int_equal(s.pin_count, 5);
    assert_int_equal(s.pins[0].kind, PC_PIN_HIGHEST);
    assert_close(s.pins[0].fraction, 0.1, 0.0);
    assert_int_equal(s.pins[1].kind, PC_PIN_BOX);
    assert_close(s.pins[1].maximum[1], 0.5, 0.0);
    assert_int_equal(s.pins[2].attribute, PC_ATTRIBUTE_BLUE);
    assert_close(s.pins[2].above, 0.5, 0.0);
    assert_string_equal(s.pins[3].name, "Cape*");
    assert_int_equal(s.pins[4].kind, PC_PIN_MATERIAL);
    assert_int_equal(s.attachment.kind, PC_ATTACHMENT_CLIP);
    assert_string_equal(s.attachment.clip, "Walking_A");
    assert_close(s.attachment.start, 0.25, 0.0);
    assert_close(s.attachment.blend, 0.0, 0.0);
    assert_false(s.attachment.loop);
    assert_int_equal(s.collider_count, 4);
    assert_close(s.colliders[0].from[1], 1.0, 0.0);
    assert_string_equal(s.colliders[1].joint, "Hips");
    assert_string_equal(s.colliders[2].mesh, "Knight_*");
    assert_string_equal(s.colliders[3].mesh, "");
    assert_ok(context, pc_scenario_check(context, &s));

    // Its own text reads back as the same.
    char *text = pci_scenario_text(context, &s);
    pc_scenario again = {0};
    assert_non_null(text);
    assert_ok(context, parse(context, text, &options, &again));
    char *second = pci_scenario_text(context, &again);
    assert_string_equal(text, second);
    assert_memory_equal(again.pins, s.pins, s.pin_count * sizeof(*s.pins));
    assert_memory_equal(again.colliders, s.colliders, s.collider_count * sizeof(*s.colliders));
    assert_memory_equal(again.winds, s.winds, s.wind_count * sizeof(*s.winds));
    pc_release(context, text);
    pc_release(context, second);
    pc_scenario_free(context, &again);
    pc_scenario_free(context, &s);
    pc_context_destroy(context);
}

static void rigid_motions_have_defaults(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_simulate_options options = default_options();
    pc_scenario s = {0};
    assert_ok(context, parse(context,
                             "{\"attachment\": {\"pivot\": [0, 1, 0], \"keys\": [{\"time\": 0},"
                             "{\"time\": 1, \"translation\": [1, 0, 0], "
                             "\"rotation\": [0, 0.5, 0, 0.5]}]}}",
                             &options, &s));
    assert_int_equal(s.attachment.kind, PC_ATTACHMENT_RIGID);
    assert_int_equal(s.attachment.key_count, 2);
    assert_close(s.attachment.keys[0].rotation[3], 1.0, 0.0);
    assert_close(s.attachment.keys[1].rotation[1], 0.5, 0.0);
    assert_close(s.attachment.pivot[1], 1.0, 0.0);
    pc_scenario_free(context, &s);
    // Nothing at all is the paper's scenario.
    const pc_simulate_options before = default_options();
    options = before;
    assert_ok(context, parse(context, " {}\n", &options, &s));
    static const pc_scenario paper;
    assert_memory_equal(&s, &paper, sizeof(s));
    assert_memory_equal(&options, &before, sizeof(before));
    pc_context_destroy(context);
}

// Every message starts with the file and the path of the key.
static void errors_name_file_and_key(void **state) {
    (void)state;
    static const struct {
        const char *text, *message;
        pc_status status;
    } cases[] = {
        {"{\"gravitty\": 1}", "cape.json: gravitty: unknown key", PC_ERROR_INVALID_OPTIONS},
        {"{\"gravity\": 1, \"gravity\": 2}", "cape.json: gravity: the key is given twice",
         PC_ERROR_INVALID_OPTIONS},
        {"{\"gravity\": \"1\"}", "cape.json: gravity: must be a number", PC_ERROR_INVALID_OPTIONS},
        {"{\"gravity\": 101}", "cape.json: gravity: simulate: option gravity = 101 is out of range",
         PC_ERROR_INVALID_OPTIONS},
        {"{\"frames\": 1.5}", "cape.json: frames: ", PC_ERROR_INVALID_OPTIONS},
        {"{\"dynamics\": \"fem\"}",
         "cape.json: dynamics: simulate: option dynamics = \"fem\" is not",
         PC_ERROR_INVALID_OPTIONS},
        {"{\"frames\": 10, \"duration\": 1}", "cape.json: duration: frames are given as well",
         PC_ERROR_INVALID_OPTIONS},
        {"{\"duration\": 1e6}", "cape.json: duration: ", PC_ERROR_INVALID_OPTIONS},
        {"{\"winds\": []}", "cape.json: winds: must be a list with at least one entry",
         PC_ERROR_INVALID_OPTIONS},
        {"{\"winds\": [{\"time\": 0, \"velocity\": [0, 0]}]}",
         "cape.json: winds[0].velocity: must be a list of 3 numbers", PC_ERROR_INVALID_OPTIONS},
        {"{\"winds\": [{\"time\": 0, \"velocity\": [0, 0, null]}]}",
         "cape.json: winds[0].velocity[2]: must be a number", PC_ERROR_INVALID_OPTIONS},
        {"{\"winds\": [{\"time\": 0, \"velocity\": [0, 0, 1e999]}]}",
         "cape.json: winds[0].velocity[2]: inf is out of range", PC_ERROR_INVALID_OPTIONS},
        {"{\"winds\": [{\"time\": 1, \"velocity\": [0,0,0]}, {\"time\": 1, \"velocity\": "
         "[0,0,0]}]}",
         "cape.json: winds[1].time: times must ascend", PC_ERROR_INVALID_OPTIONS},
        {"{\"winds\": [{\"velocity\": [0,0,0]}]}", "cape.json: winds[0].time: is missing",
         PC_ERROR_INVALID_OPTIONS},
        {"{\"pins\": [{\"highest\": 0.1}, {\"box\": {\"min\": [0,0,0]}}]}",
         "cape.json: pins[1].box.max: is missing", PC_ERROR_INVALID_OPTIONS},
        {"{\"pins\": [{\"box\": {\"min\": [0,2,0], \"max\": [1,1,1]}}]}",
         "cape.json: pins[0].box: min[1] exceeds max[1]", PC_ERROR_INVALID_OPTIONS},
        {"{\"pins\": [{\"highest\": 2}]}", "cape.json: pins[0].highest: 2 is out of range",
         PC_ERROR_INVALID_OPTIONS},
        {"{\"pins\": [{\"mesh\": \"a\", \"material\": \"b\"}]}",
         "cape.json: pins[0]: needs exactly one of", PC_ERROR_INVALID_OPTIONS},
        {"{\"pins\": [{\"attribute\": \"pink\", \"above\": 0}]}",
         "cape.json: pins[0].attribute: must be one of red, green", PC_ERROR_INVALID_OPTIONS},
        {"{\"pins\": [{\"attribute\": \"red\"}]}", "cape.json: pins[0].above: is missing",
         PC_ERROR_INVALID_OPTIONS},
        {"{\"pins\": [{\"mesh\": \"\"}]}", "cape.json: pins[0].mesh: must be a text",
         PC_ERROR_INVALID_OPTIONS},
        {"{\"attachment\": {\"clip\": \"a\", \"speed\": 1}}",
         "cape.json: attachment.speed: unknown key", PC_ERROR_INVALID_OPTIONS},
        {"{\"attachment\": {\"clip\": \"a\", \"loop\": 1}}",
         "cape.json: attachment.loop: must be true or false", PC_ERROR_INVALID_OPTIONS},
        {"{\"attachment\": {}}", "cape.json: attachment: needs clip or keys",
         PC_ERROR_INVALID_OPTIONS},
        {"{\"attachment\": {\"keys\": [{\"time\": 0, \"rotation\": [0,0,0,0]}]}}",
         "cape.json: attachment.keys[0].rotation: is no rotation", PC_ERROR_INVALID_OPTIONS},
        {"{\"colliders\": [{\"shape\": \"cube\"}]}",
         "cape.json: colliders[0].shape: must be one of sphere, capsule, body",
         PC_ERROR_INVALID_OPTIONS},
        {"{\"colliders\": [{\"shape\": \"sphere\", \"center\": [0,0,0], \"radius\": 0}]}",
         "cape.json: colliders[0].radius: 0 is out of range", PC_ERROR_INVALID_OPTIONS},
        {"{\"colliders\": [{\"shape\": \"body\", \"radius\": 1}]}",
         "cape.json: colliders[0].radius: unknown key", PC_ERROR_INVALID_OPTIONS},
        {"{\"colliders\": [3]}", "cape.json: colliders[0]: must be an object",
         PC_ERROR_INVALID_OPTIONS},
        {"[]", "cape.json: the file must hold one JSON object", PC_ERROR_INVALID_OPTIONS},
        {"{\"gravity\": 1,\n\n oops}", "cape.json: line 3 is no valid JSON", PC_ERROR_FORMAT},
        {"{} x", "cape.json: line 1 is no valid JSON", PC_ERROR_FORMAT},
        {"", "cape.json: line 1 is no valid JSON", PC_ERROR_FORMAT},
    };
    pc_context *context = test_context(1);
    const pc_simulate_options before = default_options();
    static const pc_scenario empty;
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); ++i) {
        pc_simulate_options options = before;
        pc_scenario s = {0};
        assert_int_equal(parse(context, cases[i].text, &options, &s), cases[i].status);
        const char *message = pc_context_error(context)->message;
        if (strncmp(message, cases[i].message, strlen(cases[i].message)) != 0) {
            fail_msg("%s\n  says \"%s\"\n  instead of \"%s\"", cases[i].text, message,
                     cases[i].message);
        }
        // A refused file changes nothing.
        assert_memory_equal(&options, &before, sizeof(before));
        assert_memory_equal(&s, &empty, sizeof(s));
    }
    pc_context_destroy(context);
}

static void filled_scenarios_are_checked(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_pin pin = {.kind = PC_PIN_MESH, .name = "cape"};
    pc_collider collider = {.kind = PC_COLLIDER_SPHERE, .radius = 1.0};
    pc_scenario s = {.pin_count = 1, .pins = &pin, .collider_count = 1, .colliders = &collider};
    assert_ok(context, pc_scenario_check(context, &s));
    memset(pin.name, 'x', sizeof(pin.name));
    assert_int_equal(pc_scenario_check(context, &s), PC_ERROR_INVALID_OPTIONS);
    memset(pin.name, 0, sizeof(pin.name));
    pin.kind = (pc_pin_kind)77;
    assert_int_equal(pc_scenario_check(context, &s), PC_ERROR_INVALID_OPTIONS);
    pin.kind = PC_PIN_HIGHEST;
    pin.fraction = NAN;
    assert_int_equal(pc_scenario_check(context, &s), PC_ERROR_INVALID_OPTIONS);
    assert_non_null(strstr(pc_context_error(context)->message, "pins[0].highest"));
    pin.fraction = 0.5;
    collider.radius = -1.0;
    assert_int_equal(pc_scenario_check(context, &s), PC_ERROR_INVALID_OPTIONS);
    pc_context_destroy(context);
}

static void files_are_read(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    char path[64];
    snprintf(path, sizeof(path), "/tmp/proxycloth-scenario-%ld.json", (long)getpid());
    pc_simulate_options options = default_options();
    pc_scenario s = {0};
    assert_int_equal(pc_scenario_read(context, path, &options, &s), PC_ERROR_IO);
    FILE *file = fopen(path, "wb");
    assert_non_null(file);
    fputs(everything, file);
    fclose(file);
    assert_ok(context, pc_scenario_read(context, path, &options, &s));
    assert_int_equal(s.pin_count, 5);
    assert_int_equal(pc_scenario_read(context, path, &options, &s), PC_ERROR_INVALID_ARGUMENT);
    pc_scenario_free(context, &s);
    assert_int_equal(pc_scenario_read(context, NULL, &options, &s), PC_ERROR_INVALID_ARGUMENT);
    remove(path);
    pc_context_destroy(context);
}

static void memory_may_run_out(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        pc_simulate_options options = default_options();
        pc_scenario scenario = {0};
        s.status = parse(context, everything, &options, &scenario);
        pc_scenario_free(context, &scenario);
    }
    assert_int_equal(s.failures, 3); // winds, pins, colliders
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(reads_everything),         cmocka_unit_test(rigid_motions_have_defaults),
        cmocka_unit_test(errors_name_file_and_key), cmocka_unit_test(filled_scenarios_are_checked),
        cmocka_unit_test(files_are_read),           cmocka_unit_test(memory_may_run_out),
    };
    return cmocka_run_group_tests_name("scenario", tests, NULL, NULL);
}
