#include "support/test.h"

static void mark_pieces(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    uint32_t *marks = user;
    for (size_t i = begin; i < end; ++i) {
        ++marks[i];
    }
}

static void parallel_for_visits_every_element_once(void **state) {
    (void)state;
    for (uint32_t threads = 1; threads <= 8; ++threads) {
        pc_context *context = test_context(threads);
        uint32_t marks[1000] = {0};
        for (int round = 0; round < 50; ++round) {
            pci_parallel_for(context, 1000, 7, mark_pieces, marks);
        }
        for (size_t i = 0; i < 1000; ++i) {
            assert_int_equal(marks[i], 50);
        }
        pc_context_destroy(context);
    }
}

static void options_have_valid_defaults(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    const pc_options options = pc_default_options();
    for (pc_stage stage = 0; stage < PC_STAGE_COUNT; ++stage) {
        const pc_stage_info *info = pc_stage_describe(stage);
        assert_non_null(info);
        assert_ok(context, pc_record_check(context, info->name, info->options,
                                           (const char *)&options + info->options_offset));
    }
    assert_null(pc_stage_describe(PC_STAGE_COUNT));
    pc_context_destroy(context);
}

static void option_text_is_checked(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_voxelize_options options = {.voxels = 32};
    const pc_field *field = pc_record_find(&pc_voxelize_options_record, "voxels");
    assert_non_null(field);
    assert_ok(context, pc_field_set_text(context, "voxelize", field, &options, "64"));
    assert_int_equal(options.voxels, 64);
    static const char *const bad[] = {"", "x", "3.5", "nan", "-1", "1e9", "64 "};
    for (size_t i = 0; i < sizeof(bad) / sizeof(bad[0]); ++i) {
        assert_int_equal(pc_field_set_text(context, "voxelize", field, &options, bad[i]),
                         PC_ERROR_INVALID_OPTIONS);
        assert_non_null(strstr(pc_context_error(context)->message, "voxels"));
    }
    assert_int_equal(options.voxels, 64);
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(parallel_for_visits_every_element_once),
        cmocka_unit_test(options_have_valid_defaults),
        cmocka_unit_test(option_text_is_checked),
    };
    return cmocka_run_group_tests_name("core", tests, NULL, NULL);
}
