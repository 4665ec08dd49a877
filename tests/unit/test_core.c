#define _POSIX_C_SOURCE 200809L
#include <stdlib.h>
#include <time.h>

#include "core/sorting.h"
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

typedef struct chain {
    pc_context *context;
    atomic_uint done[200];
    uint32_t sums[200];
} chain;

// Each piece adds to what the one before it wrote.
static void add_link(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    chain *c = user;
    for (size_t i = begin; i < end; ++i) {
        if (i > 0) {
            pci_parallel_wait(c->context, &c->done[i - 1], 1);
        }
        c->sums[i] = (uint32_t)i + (i > 0 ? c->sums[i - 1] : 0);
        atomic_store_explicit(&c->done[i], 1, memory_order_release);
    }
}

static void pieces_wait_for_earlier_ones(void **state) {
    (void)state;
    for (uint32_t threads = 1; threads <= 8; ++threads) {
        chain c = {.context = test_context(threads)};
        pci_parallel_for(c.context, 200, 1, add_link, &c);
        assert_int_equal(c.sums[199], 199 * 200 / 2);
        pc_context_destroy(c.context);
    }
}

static void scratch_memory_is_aligned_and_bounded(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pci_scratch scratch = pci_scratch_begin(context);
    for (size_t count = 1; count < 200; ++count) {
        const double *numbers = pci_scratch_allocate_aligned(&scratch, count, sizeof(double));
        assert_non_null(numbers);
        assert_int_equal((uintptr_t)numbers % 64, 0);
        assert_true(numbers[0] == 0.0 && numbers[count - 1] == 0.0);
    }
    assert_false(scratch.failed);
    assert_null(pci_scratch_allocate_aligned(&scratch, SIZE_MAX / 8 + 1, 8));
    assert_true(scratch.failed);
    pci_scratch_end(&scratch);
    pc_context_destroy(context);
}

static void count_allocation(void *user, void *memory, int change) {
    *(int *)user += memory != NULL ? change : 0;
}

static void *allocate_counted(void *user, size_t size) {
    void *memory = malloc(size);
    count_allocation(user, memory, 1);
    return memory;
}

static void release_counted(void *user, void *memory) {
    count_allocation(user, memory, -1);
    free(memory);
}

// A context that keeps the number of its pieces of memory.
static pc_context *counting_context(int *count) {
    const pc_context_options options = {.threads = 1,
                                        .allocator = {allocate_counted, release_counted, count}};
    pc_context *context = NULL;
    assert_int_equal(pc_context_create(&options, &context), PC_OK);
    return context;
}

static void single_pieces_of_scratch_memory_are_released(void **state) {
    (void)state;
    int count = 0;
    pc_context *context = counting_context(&count);
    const int before = count;
    pci_scratch scratch = pci_scratch_begin(context);
    uint32_t *pieces[4];
    for (size_t i = 0; i < 4; ++i) {
        pieces[i] = PCI_SCRATCH(&scratch, uint32_t, 10);
        pieces[i][9] = (uint32_t)i;
    }
    const size_t order[] = {1, 3, 0};
    for (int i = 0; i < 3; ++i) {
        pci_scratch_release(&scratch, pieces[order[i]]);
        assert_int_equal(count, before + 3 - i);
    }
    pci_scratch_release(&scratch, NULL);
    assert_int_equal(pieces[2][9], 2);
    pci_scratch_end(&scratch);
    assert_int_equal(count, before);
    pc_context_destroy(context);
}

// Back to a mark, and from the memory of a task into another one.
static void scratch_memory_is_rewound_and_handed_over(void **state) {
    (void)state;
    int count = 0;
    pc_context *context = counting_context(&count);
    const int before = count;
    pci_scratch scratch = pci_scratch_begin(context), other = pci_scratch_begin(context);
    uint32_t *kept = PCI_SCRATCH(&scratch, uint32_t, 10);
    kept[9] = 7;
    const struct pci_scratch_block *mark = scratch.blocks;
    for (size_t i = 0; i < 3; ++i) {
        assert_non_null(PCI_SCRATCH(&scratch, uint32_t, 10));
    }
    assert_int_equal(count, before + 4);
    pci_scratch_rewind(&scratch, mark);
    assert_int_equal(count, before + 1);
    for (size_t i = 0; i < 2; ++i) {
        assert_non_null(PCI_SCRATCH(&other, uint32_t, 10));
    }
    pci_scratch_take(&scratch, &other);
    pci_scratch_end(&other);
    assert_int_equal(count, before + 3);
    assert_int_equal(kept[9], 7);
    pci_scratch_end(&scratch);
    assert_int_equal(count, before);
    pc_context_destroy(context);
}

static void sleep_a_millisecond(void *user, size_t begin, size_t end, uint32_t worker) {
    ((uint8_t *)user)[begin] = 1;
    const struct timespec duration = {.tv_nsec = 1000000};
    nanosleep(&duration, NULL);
    (void)end, (void)worker;
}

static bool refuse(void *user, const char *stage, double fraction) {
    ++*(int *)user;
    assert_string_equal(stage, "voxelize");
    assert_close(fraction, 0.0, 0.0);
    return false;
}

static void long_loops_can_be_cancelled(void **state) {
    (void)state;
    for (uint32_t threads = 1; threads <= 3; ++threads) {
        int calls = 0;
        const pc_context_options options = {.threads = threads, .progress = refuse, .user = &calls};
        pc_context *context = NULL;
        assert_int_equal(pc_context_create(&options, &context), PC_OK);
        pc_voxelize_options chosen;
        assert_ok(context,
                  pci_begin_stage(context, "voxelize", &pc_voxelize_options_record, NULL, &chosen));
        enum { PIECES = 100000 }; // of a millisecond: so long may the asking thread be kept waiting
        static uint8_t done[PIECES];
        memset(done, 0, sizeof(done));
        assert_false(pci_parallel_while_wanted(context, PIECES, 1, sleep_a_millisecond, done));
        assert_int_equal(calls, 1);
        assert_int_equal(done[0], 1);
        assert_int_equal(done[PIECES - 1], 0);
        // A function that can only say that it did not finish leaves the cause to the context,
        // once.
        assert_int_equal(pci_fail_memory(context, "voxelize"), PC_ERROR_CANCELLED);
        assert_int_equal(pci_fail_memory(context, "voxelize"), PC_ERROR_OUT_OF_MEMORY);
        pc_context_destroy(context);
    }
}

typedef struct task_notes {
    uint32_t marks[20][100];
    bool waits;     // until somebody cancels
    size_t failing; // first task that fails
} task_notes;

static pc_status note_task(void *user, size_t index, pc_context *own) {
    task_notes *notes = user;
    for (int i = 0; i < 10; ++i) {
        pci_parallel_for(own, 100, 7, mark_pieces, notes->marks[index]);
    }
    while (notes->waits) {
        if (!pci_progress(own, "voxelize", 0.0)) {
            return pci_fail_memory(own, "voxelize"); // cannot tell why
        }
    }
    return index < notes->failing ? PC_OK
                                  : pci_fail(own, PC_ERROR_NO_PROXY, "voxelize", "task %zu", index);
}

static void tasks_run_once_each(void **state) {
    (void)state;
    for (uint32_t threads = 1; threads <= 8; ++threads) {
        pc_context *context = test_context(threads);
        static const task_notes none;
        static task_notes notes;
        for (size_t count = 0; count <= 20; ++count) {
            notes = none;
            notes.failing = 20;
            assert_ok(context, pci_run_tasks(context, count, note_task, &notes));
            for (size_t i = 0; i < 2000; ++i) {
                assert_int_equal(notes.marks[i / 100][i % 100], i / 100 < count ? 10 : 0);
            }
        }
        // Later ones may fail first.
        notes = none;
        notes.failing = 7;
        assert_int_equal(pci_run_tasks(context, 20, note_task, &notes), PC_ERROR_NO_PROXY);
        assert_string_equal(pc_context_error(context)->message, "task 7");
        pc_context_destroy(context);
    }
}

static void tasks_can_be_cancelled(void **state) {
    (void)state;
    for (uint32_t threads = 1; threads <= 3; ++threads) {
        int calls = 0;
        const pc_context_options options = {.threads = threads, .progress = refuse, .user = &calls};
        pc_context *context = NULL;
        static task_notes notes = {.waits = true, .failing = 20};
        assert_int_equal(pc_context_create(&options, &context), PC_OK);
        assert_int_equal(pci_run_tasks(context, 20, note_task, &notes), PC_ERROR_CANCELLED);
        assert_int_equal(calls, 1);
        assert_int_equal(pc_context_error(context)->status, PC_ERROR_CANCELLED);
        assert_int_equal(pci_fail_memory(context, "voxelize"), PC_ERROR_OUT_OF_MEMORY);
        pc_context_destroy(context);
    }
}

static void check_fields(const pc_record *record) {
    for (size_t i = 0; i < record->field_count; ++i) {
        const pc_field *field = &record->fields[i];
        assert_non_null(field->unit);
        assert_non_null(field->help);
        assert_true(strlen(field->help) > 3);
        assert_ptr_equal(pc_record_find(record, field->name), field); // no name twice
        assert_true(field->offset < record->size);
    }
}

static void every_field_is_described(void **state) {
    (void)state;
    for (pc_stage stage = 0; stage < PC_STAGE_COUNT; ++stage) {
        check_fields(pc_stage_describe(stage)->options);
        check_fields(pc_stage_describe(stage)->report);
    }
    check_fields(&pc_visual_report_record);
    check_fields(&pc_measures_record);
    check_fields(&pc_contact_sheet_options_record);
    check_fields(&pc_strip_options_record);
    check_fields(&pc_evaluate_motion_options_record);
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

    // A word for 0, where the field has one; numbers keep to their limits.
    assert_ok(context, pc_field_set_text(context, "voxelize", field, &options, "auto"));
    assert_int_equal(options.voxels, PC_VOXELS_AUTO);
    assert_ok(context, pc_record_check(context, "voxelize", &pc_voxelize_options_record, &options));
    options.voxels = 3;
    assert_int_equal(pc_record_check(context, "voxelize", &pc_voxelize_options_record, &options),
                     PC_ERROR_INVALID_OPTIONS);
    const pc_field *without = pc_record_find(&pc_simplify_options_record, "vertices");
    pc_simplify_options other = pc_default_options().simplify;
    assert_int_equal(pc_field_set_text(context, "simplify", without, &other, "auto"),
                     PC_ERROR_INVALID_OPTIONS);
    pc_context_destroy(context);
}

typedef struct numbered {
    uint32_t number, second, third;
} numbered;

static int compare_numbered(const void *left, const void *right) {
    const numbered *a = left, *b = right;
    return a->number != b->number   ? (a->number > b->number) - (a->number < b->number)
           : a->second != b->second ? (a->second > b->second) - (a->second < b->second)
                                    : (a->third > b->third) - (a->third < b->third);
}

// Few and many records per number, numbers that do not occur, and nothing at all.
static void sorting_by_number_equals_qsort(void **state) {
    (void)state;
    enum { most = 3000 };
    static numbered records[most], expected[most];
    static const struct {
        size_t count, bound;
    } cases[] = {{0, 5}, {1, 1}, {most, 1}, {most, 40}, {most, 1000}, {most, 100000}};
    pc_context *context = test_context(1);
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); ++i) {
        const size_t count = cases[i].count, bound = cases[i].bound;
        for (size_t k = 0; k < count; ++k) {
            records[k] = (numbered){(uint32_t)(pci_random(31, i, k) * (double)bound),
                                    (uint32_t)(pci_random(32, i, k) * 10.0), (uint32_t)k};
        }
        memcpy(expected, records, sizeof(records));
        qsort(expected, count, sizeof(*expected), compare_numbered);
        assert_true(
            pci_sort_by_number(context, records, count, sizeof(*records), bound, compare_numbered));
        assert_memory_equal(records, expected, sizeof(records));
    }
    pc_context_destroy(context);
}

// Numbers of all signs and sizes, many of them equal: in order, and equal ones as they were.
static void sorting_by_key_is_stable(void **state) {
    (void)state;
    enum { most = 5000 };
    static const double values[] = {-INFINITY, -1e300, -2.5, -1e-310, -0.0, 0.0, 1e-310, 3.0, 1e9};
    static double numbers[most];
    static uint64_t keys[most], alone[most];
    static uint32_t order[most];
    enum { kinds = sizeof(values) / sizeof(values[0]) };
    pc_context *context = test_context(1);
    for (size_t count = 0; count <= most; count = 2 * count + 1) {
        for (uint32_t i = 0; i < count; ++i) {
            const double random = pci_random(33, count, i);
            numbers[i] = i % 2 == 0 ? values[(size_t)(random * kinds)] : 1e6 * (random - 0.5);
            alone[i] = keys[i] = pci_key_of(numbers[i]);
            order[i] = i;
        }
        assert_true(pci_sort_keys(context, count, keys, order));
        assert_true(pci_sort_keys(context, count, alone, NULL));
        assert_memory_equal(keys, alone, count * sizeof(*keys));
        for (size_t i = 1; i < count; ++i) {
            const double before = numbers[order[i - 1]], after = numbers[order[i]];
            assert_true(before < after || (before == after && order[i - 1] < order[i]));
            assert_true(keys[i] == pci_key_of(after));
        }
    }
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(parallel_for_visits_every_element_once),
        cmocka_unit_test(pieces_wait_for_earlier_ones),
        cmocka_unit_test(scratch_memory_is_aligned_and_bounded),
        cmocka_unit_test(single_pieces_of_scratch_memory_are_released),
        cmocka_unit_test(scratch_memory_is_rewound_and_handed_over),
        cmocka_unit_test(long_loops_can_be_cancelled),
        cmocka_unit_test(tasks_run_once_each),
        cmocka_unit_test(tasks_can_be_cancelled),
        cmocka_unit_test(every_field_is_described),
        cmocka_unit_test(options_have_valid_defaults),
        cmocka_unit_test(option_text_is_checked),
        cmocka_unit_test(sorting_by_number_equals_qsort),
        cmocka_unit_test(sorting_by_key_is_stable),
    };
    return cmocka_run_group_tests_name("core", tests, NULL, NULL);
}
