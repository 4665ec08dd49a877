// The whole pipeline under an allocator whose n-th call fails, n = 1 until success: out of memory,
// no result, nothing leaked. Each stage has a series of its own on the results of the ones before,
// which is what a series over pc_build visits, without running the stages before again.
// usage: test_lack_of_memory [STEP]: every STEP-th call only, for slow tools such as Valgrind
#include "support/memory.h"
#include "support/surfaces.h"

static size_t step = 1;

typedef struct series {
    counting_allocator counter;
    pc_context *context;
    pc_asset asset;
} series;

// Fails call after call of a stage until it succeeds. Returns the number of failures.
static size_t starve_stage(series *s, pc_stage stage, const pc_options *options) {
    const size_t live = s->counter.live;
    pc_status status = PC_ERROR_OUT_OF_MEMORY;
    size_t number = 0;
    for (;;) {
        number += step;
        fail_allocation(&s->counter, number);
        status = pc_run_stage(s->context, stage, options, &s->asset, NULL);
        if (status == PC_OK) {
            break;
        }
        if (status != PC_ERROR_OUT_OF_MEMORY) {
            fail_msg("stage %s, allocation %zu: %s", pc_stage_describe(stage)->name, number,
                     pc_context_error(s->context)->message);
        }
        assert_int_equal(s->counter.live, live);
        assert_int_equal(s->asset.stage_count, stage);
        assert_int_equal(pc_context_error(s->context)->status, PC_ERROR_OUT_OF_MEMORY);
    }
    s->counter.fail_at = 0;
    // Whether the last call was one that nobody noticed.
    assert_true(s->counter.calls < number);
    return (number - 1) / step;
}

static void starve(const pc_mesh *mesh, const pc_options *options) {
    series s = {.counter = {0}};
    s.context = counting_context(&s.counter);
    const pc_visual_arrays arrays = {.vertex_count = mesh->vertex_count,
                                     .positions = mesh->positions,
                                     .triangle_count = mesh->triangle_count,
                                     .triangles = mesh->triangles};
    const size_t live = s.counter.live;
    pc_status status = PC_ERROR_OUT_OF_MEMORY;
    size_t failures = 0;
    for (size_t number = 1; status != PC_OK; number += step) {
        fail_allocation(&s.counter, number);
        status = pc_visual_create(s.context, &arrays, &s.asset.visual, &s.asset.reports.visual);
        if (status != PC_OK) {
            assert_int_equal(status, PC_ERROR_OUT_OF_MEMORY);
            assert_int_equal(s.counter.live, live);
            assert_null(s.asset.visual.surface.positions);
            ++failures;
        }
    }
    for (pc_stage stage = 0; stage < PC_STAGE_COUNT; ++stage) {
        const size_t count = starve_stage(&s, stage, options);
        assert_true(step > 1 || count > 0);
        failures += count;
    }
    print_message("%zu allocations failed, one at a time\n", failures);
    assert_true(failures > 500 / step);
    pc_asset_free(s.context, &s.asset);
    assert_int_equal(s.counter.live, live);
    pc_context_destroy(s.context);
    assert_int_equal(s.counter.live, 0);
}

static pc_options small_options(void) {
    pc_options options = pc_default_options();
    options.voxelize.voxels = 8;
    options.simplify.vertices = 16;
    options.simulate.frames = 3;
    options.skin.epochs = 2;
    return options;
}

static void a_skirt(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh mesh = test_tube(context, 12, 4, 0.3, 0.8);
    const pc_options options = small_options();
    starve(&mesh, &options);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

// Two sheets, one before the other: labels, carving, the other solver of the weights.
static void a_layered_cloth(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh sheet = test_sheet(context, 4, 4, 1.0, 1.0);
    const double offset[3] = {0.02, 0.01, 0.05};
    pc_mesh mesh = test_union(context, &sheet, &sheet, offset);
    pc_options options = small_options();
    options.carve.layer_source = PC_LAYER_LABELS;
    options.carve.carve = true;
    options.skin.solver = PC_SKIN_ADAMW;
    starve(&mesh, &options);
    pc_mesh_free(context, &sheet);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

int main(int argc, char **argv) {
    step = argc > 1 ? strtoul(argv[1], NULL, 10) : 1;
    step = step > 0 ? step : 1;
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_skirt),
        cmocka_unit_test(a_layered_cloth),
    };
    return cmocka_run_group_tests_name("lack_of_memory", tests, NULL, NULL);
}
