#include "support/memory.h"

typedef struct fixture {
    pc_options options;
    pc_option_group groups[PC_STAGE_COUNT];
} fixture;

static void set_up(fixture *f) {
    f->options = pc_default_options();
    pc_option_groups(&f->options, f->groups);
}

static pc_status parse(pc_context *context, const char *text, fixture *f) {
    return pc_options_parse(context, text, strlen(text), "o.json", f->groups, PC_STAGE_COUNT);
}

static void names_stand_alone_or_below_their_stage(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    fixture f;
    set_up(&f);
    assert_ok(context, parse(context,
                             "{\"simplify\": {\"seed\": 4}, \"seed\": 3, \"carve\": true,"
                             " \"layer_source\": \"labels\", \"voxels\": \"auto\"}",
                             &f));
    assert_int_equal(f.options.simplify.seed, 4);
    assert_int_equal(f.options.simulate.seed, 3);
    assert_int_equal(f.options.skin.seed, 3);
    assert_true(f.options.carve.carve);
    assert_int_equal(f.options.voxelize.voxels, 0);
    assert_int_equal(f.options.simplify.vertices, 128);
    // The same name as a stage, below that stage.
    assert_ok(context, parse(context, "{\"carve\": {\"carve\": false}}", &f));
    assert_false(f.options.carve.carve);
    assert_int_equal(f.options.carve.layer_source, 1);
    pc_context_destroy(context);
}

static void presets_come_first(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    fixture f;
    for (size_t i = 0; pc_preset_at(i) != NULL; ++i) {
        set_up(&f);
        assert_ok(context, parse(context, pc_preset_at(i)->options, &f));
        for (pc_stage stage = 0; stage < PC_STAGE_COUNT; ++stage) {
            assert_ok(context, pc_record_check(context, f.groups[stage].name,
                                               f.groups[stage].record, f.groups[stage].values));
        }
    }
    set_up(&f);
    assert_ok(context, parse(context, "{\"vertices\": 99, \"preset\": \"mobile\"}", &f));
    assert_int_equal(f.options.simplify.vertices, 99);
    assert_int_equal(f.options.skin.weight_storage, PC_SKIN_WEIGHTS_U8);
    pc_context_destroy(context);
}

static void failures_name_the_key_and_change_nothing(void **state) {
    (void)state;
    static const struct {
        const char *text, *message;
        pc_status status;
    } rows[] = {
        {"{\"voxels\": 64,\n \"vertices\": 3}",
         "o.json: vertices: simplify: option vertices = 3 is out of range", 0},
        {"{\"voxels\": 64, \"simplify\": {\"voxels\": 9}}", "o.json: simplify.voxels: unknown key",
         0},
        {"{\"voxels\": 64, \"vertixes\": 9}", "o.json: vertixes: unknown key", 0},
        {"{\"voxels\": 64, \"voxels\": 65}", "o.json: voxels: the key is given twice", 0},
        {"{\"label\": {\"label_effort\": 1, \"label_effort\": 1}}",
         "o.json: label.label_effort: the key is given twice", 0},
        {"{\"voxels\": true}", "o.json: voxels: must be a number", 0},
        {"{\"voxels\": \"many\"}", "o.json: voxels: voxelize: option voxels = \"many\"", 0},
        {"{\"carve\": 1}", "o.json: carve: must be true or false", 0},
        {"{\"solver\": 1}", "o.json: solver: must be a text", 0},
        {"{\"label\": 1}", "o.json: label: unknown key", 0},
        {"{\"preset\": \"console\"}", "o.json: preset: must be one of mobile, desktop, cinematic",
         0},
        {"[]", "o.json: must be one JSON object", 0},
        {"{\"voxels\": 64,\n\"", "o.json: line 2 is no valid JSON", PC_ERROR_FORMAT},
        {"", "o.json: line 1 is no valid JSON", PC_ERROR_FORMAT},
        {"{} x", "o.json: line 1 is no valid JSON", PC_ERROR_FORMAT},
    };
    pc_context *context = test_context(1);
    fixture f, before;
    set_up(&before);
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); ++i) {
        set_up(&f);
        const pc_status expected =
            rows[i].status != PC_OK ? rows[i].status : PC_ERROR_INVALID_OPTIONS;
        assert_int_equal(parse(context, rows[i].text, &f), expected);
        const char *message = pc_context_error(context)->message;
        if (strncmp(message, rows[i].message, strlen(rows[i].message)) != 0) {
            fail_msg("%s\n  says \"%s\"\n  instead of \"%s\"", rows[i].text, message,
                     rows[i].message);
        }
        for (pc_stage stage = 0; stage < PC_STAGE_COUNT; ++stage) {
            assert_memory_equal(f.groups[stage].values, before.groups[stage].values,
                                f.groups[stage].record->size);
        }
    }
    assert_int_equal(parse(NULL, "{}", &f), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_options_parse(context, NULL, 0, "o", f.groups, PC_STAGE_COUNT),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_options_read(context, NULL, f.groups, PC_STAGE_COUNT),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_options_read(context, "/no/such/file", f.groups, PC_STAGE_COUNT),
                     PC_ERROR_IO);
    pc_context_destroy(context);
}

// A list for the option that may be one, alone or below its stage; the last value is in the struct.
static void an_option_may_be_a_list(void **state) {
    (void)state;
    static const struct {
        const char *text, *message;
    } bad[] = {
        {"{\"vertices\": [64, 3]}", "o.json: vertices[1]: simplify: option vertices = 3 is out of"},
        {"{\"vertices\": [64, \"auto\"]}", "o.json: vertices[1]: must be a number"},
        {"{\"vertices\": [64, 32, 64]}",
         "o.json: vertices[2]: simplify: vertices: 64 is given twice"},
        {"{\"vertices\": []}", "o.json: vertices: the list is empty"},
        {"{\"vertices\": [9,10,11,12,13,14,15,16,17,18,19,20,21,22,23,24,25]}",
         "o.json: vertices[16]: simplify: vertices: more than 16 values"},
        {"{\"voxels\": [32, 64]}", "o.json: voxels: must be a number"},
    };
    pc_context *context = test_context(1);
    fixture f;
    set_up(&f);
    pc_series series = {.name = "vertices"};
    assert_int_not_equal(parse(context, "{\"vertices\": [64, 512]}", &f), PC_OK);
    f.groups[PC_STAGE_SIMPLIFY].series = &series;
    assert_ok(context, parse(context, "{\"vertices\": [64, 512]}", &f));
    assert_int_equal(series.count, 2);
    assert_int_equal(series.values[0], 64);
    assert_int_equal(series.values[1], 512);
    assert_int_equal(f.options.simplify.vertices, 512);
    for (size_t i = 0; i < sizeof(bad) / sizeof(bad[0]); ++i) {
        assert_int_equal(parse(context, bad[i].text, &f), PC_ERROR_INVALID_OPTIONS);
        assert_non_null(strstr(pc_context_error(context)->message, bad[i].message));
        assert_int_equal(series.count, 2);
        assert_int_equal(f.options.simplify.vertices, 512);
    }
    // What is printed reads back.
    char *text = NULL;
    assert_ok(context, pc_options_print(context, f.groups, PC_STAGE_COUNT, &text));
    series.count = 0;
    assert_ok(context, parse(context, text, &f));
    assert_int_equal(series.count, 2);
    assert_int_equal(series.values[1], 512);
    pc_release(context, text);
    // Below the stage wins; a single value ends the list.
    assert_ok(context,
              parse(context, "{\"vertices\": [8, 9], \"simplify\": {\"vertices\": [7]}}", &f));
    assert_int_equal(series.count, 1);
    assert_int_equal(series.values[0], 7);
    assert_ok(context, parse(context, "{\"vertices\": 99}", &f));
    assert_int_equal(series.count, 0);
    assert_int_equal(f.options.simplify.vertices, 99);
    pc_context_destroy(context);
}

// Every option at its limits and in between comes back as it was.
static void printed_options_read_back(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    fixture f, g;
    for (int turn = 0; turn < 4; ++turn) {
        set_up(&f);
        set_up(&g);
        for (pc_stage stage = 0; stage < PC_STAGE_COUNT; ++stage) {
            for (size_t i = 0; i < f.groups[stage].record->field_count; ++i) {
                const pc_field *field = &f.groups[stage].record->fields[i];
                const double middle = field->minimum / 3.0 + field->maximum * 2.0 / 3.0;
                const double number = turn == 0                          ? field->minimum
                                      : turn == 1                        ? field->maximum
                                      : turn == 2 && field->zero != NULL ? 0.0
                                      : field->type == PC_FIELD_DOUBLE   ? middle
                                                                         : floor(middle);
                pc_field_set_number(field, f.groups[stage].values, number);
            }
        }
        char *text = NULL;
        assert_ok(context, pc_options_print(context, f.groups, PC_STAGE_COUNT, &text));
        assert_ok(context, parse(context, text, &g));
        for (pc_stage stage = 0; stage < PC_STAGE_COUNT; ++stage) {
            for (size_t i = 0; i < f.groups[stage].record->field_count; ++i) {
                const pc_field *field = &f.groups[stage].record->fields[i];
                assert_close(pc_field_number(field, g.groups[stage].values),
                             pc_field_number(field, f.groups[stage].values), 0.0);
            }
        }
        pc_release(context, text);
    }
    pc_context_destroy(context);
}

static void memory_may_run_out(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    fixture f;
    set_up(&f);
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        char *text = NULL;
        s.status = parse(context, "{\"vertices\": 99}", &f);
        if (s.status == PC_OK) {
            s.status = pc_options_print(context, f.groups, PC_STAGE_COUNT, &text);
            assert_true((s.status == PC_OK) == (text != NULL));
        }
        pc_release(context, text);
    }
    assert_true(s.failures > 2);
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(names_stand_alone_or_below_their_stage),
        cmocka_unit_test(presets_come_first),
        cmocka_unit_test(failures_name_the_key_and_change_nothing),
        cmocka_unit_test(an_option_may_be_a_list),
        cmocka_unit_test(printed_options_read_back),
        cmocka_unit_test(memory_may_run_out),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
