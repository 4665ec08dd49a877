// The pipeline as a whole: results do not depend on threads or on how the stages are called.
#include "support/test.h"

// A hanging sheet with a fold, as plain arrays.
enum { SIDE = 20, SHEET_VERTICES = SIDE * SIDE, SHEET_TRIANGLES = 2 * (SIDE - 1) * (SIDE - 1) };

static void make_sheet(double *positions, uint32_t *triangles) {
    size_t corner = 0;
    for (uint32_t y = 0; y < SIDE; ++y) {
        for (uint32_t x = 0; x < SIDE; ++x) {
            double *p = &positions[3 * (y * SIDE + x)];
            p[0] = (double)x / (SIDE - 1);
            p[1] = 1.3 * (double)y / (SIDE - 1);
            p[2] = 0.15 * sin(5.0 * p[0]) * (1.5 - p[1]);
            if (x + 1 < SIDE && y + 1 < SIDE) {
                const uint32_t a = y * SIDE + x, b = a + 1, c = a + SIDE, d = c + 1;
                const uint32_t quad[6] = {a, b, d, a, d, c};
                memcpy(&triangles[corner], quad, sizeof(quad));
                corner += 6;
            }
        }
    }
}

static void make_asset(pc_context *context, pc_asset *asset) {
    static double positions[3 * SHEET_VERTICES];
    static uint32_t triangles[3 * SHEET_TRIANGLES];
    make_sheet(positions, triangles);
    const pc_visual_arrays arrays = {.vertex_count = SHEET_VERTICES,
                                     .positions = positions,
                                     .triangle_count = SHEET_TRIANGLES,
                                     .triangles = triangles};
    assert_ok(context, pc_visual_create(context, &arrays, &asset->visual, &asset->reports.visual));
}

static pc_options quick_options(void) {
    pc_options options = pc_default_options();
    options.voxelize.voxels = 16;
    options.simplify.vertices = 40;
    options.simulate.frames = 24;
    options.skin.epochs = 6;
    return options;
}

// FNV-1a over the results of all stages.
static uint64_t hash_bytes(uint64_t hash, const void *bytes, size_t size) {
    for (size_t i = 0; i < size; ++i) {
        hash = (hash ^ ((const uint8_t *)bytes)[i]) * UINT64_C(0x100000001b3);
    }
    return hash;
}

static uint64_t hash_mesh(uint64_t hash, const pc_mesh *mesh) {
    hash = hash_bytes(hash, mesh->positions, 3 * mesh->vertex_count * sizeof(double));
    return hash_bytes(hash, mesh->triangles, 3 * mesh->triangle_count * sizeof(uint32_t));
}

static uint64_t hash_asset(const pc_asset *a) {
    uint64_t hash = UINT64_C(0xcbf29ce484222325);
    hash = hash_bytes(hash, a->grid.samples, a->grid.sample_count * sizeof(uint64_t));
    hash = hash_bytes(hash, a->grid.values, a->grid.sample_count * sizeof(float));
    hash = hash_mesh(hash, &a->isosurface);
    hash = hash_mesh(hash, &a->projected);
    hash = hash_bytes(hash, a->graph.edge_weights, a->graph.edge_count * sizeof(double));
    hash = hash_bytes(hash, a->graph.opposites, 2 * a->graph.opposite_count * sizeof(uint32_t));
    hash = hash_bytes(hash, a->graph.opposite_signs, a->graph.opposite_count);
    hash = hash_bytes(hash, a->labels.labels, a->labels.vertex_count);
    hash = hash_mesh(hash, &a->single_layer);
    hash = hash_mesh(hash, &a->proxy);
    hash = hash_bytes(hash, a->motion.positions,
                      3 * a->motion.frame_count * a->motion.vertex_count * sizeof(double));
    hash = hash_bytes(hash, a->skin.bones,
                      a->skin.vertex_count * a->skin.influences * sizeof(uint32_t));
    return hash_bytes(hash, a->skin.weights,
                      a->skin.vertex_count * a->skin.influences * sizeof(double));
}

static void a_sheet_becomes_one_open_proxy(void **state) {
    (void)state;
    pc_context *context = test_context(0);
    pc_asset asset = {0};
    make_asset(context, &asset);
    const pc_options options = quick_options();
    pc_timings timings = {0};
    assert_ok(context, pc_build(context, &options, &asset, &timings));
    assert_int_equal(asset.stage_count, PC_STAGE_COUNT);
    assert_int_equal(asset.proxy.vertex_count, 40);
    assert_int_equal(asset.motion.frame_count, 24);
    pc_measures measures;
    assert_ok(context, pc_evaluate(context, &asset.visual.surface, &asset.proxy, &measures));
    assert_int_equal(measures.components, 1);
    assert_int_equal(measures.boundary_loops, 1);
    assert_int_equal(measures.nonmanifold_edges + measures.nonmanifold_vertices, 0);
    assert_close(measures.euler_number, 1.0, 0.0);
    assert_true(measures.hausdorff < 0.06);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

static void results_do_not_depend_on_threads(void **state) {
    (void)state;
    static const uint32_t threads[] = {1, 2, 3, 8, 1};
    uint64_t first = 0;
    for (size_t i = 0; i < sizeof(threads) / sizeof(threads[0]); ++i) {
        pc_context *context = test_context(threads[i]);
        pc_asset asset = {0};
        make_asset(context, &asset);
        const pc_options options = quick_options();
        assert_ok(context, pc_build(context, &options, &asset, NULL));
        const uint64_t hash = hash_asset(&asset);
        first = i == 0 ? hash : first;
        assert_true(hash == first);
        pc_asset_free(context, &asset);
        pc_context_destroy(context);
    }
}

static void rerunning_a_stage_drops_later_results(void **state) {
    (void)state;
    pc_context *context = test_context(0);
    pc_asset asset = {0};
    make_asset(context, &asset);
    pc_options options = quick_options();
    assert_ok(context, pc_build(context, &options, &asset, NULL));
    const uint64_t built = hash_asset(&asset);
    assert_ok(context, pc_run_stage(context, PC_STAGE_LABEL, &options, &asset, NULL));
    assert_int_equal(asset.stage_count, PC_STAGE_LABEL + 1);
    assert_int_equal(asset.proxy.vertex_count, 0);
    assert_null(asset.skin.weights);
    assert_int_equal(pc_run_stage(context, PC_STAGE_SKIN, &options, &asset, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    for (pc_stage stage = PC_STAGE_CARVE; stage < PC_STAGE_COUNT; ++stage) {
        assert_ok(context, pc_run_stage(context, stage, &options, &asset, NULL));
    }
    assert_true(hash_asset(&asset) == built);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

// A series of levels from one single layer equals separate builds, level by level.
static void levels_share_the_stages_before(void **state) {
    (void)state;
    static const uint32_t levels[] = {16, 64, 24};
    pc_context *context = test_context(0);
    pc_asset series = {0};
    make_asset(context, &series);
    pc_options options = quick_options();
    pc_timings timings = {0};
    assert_ok(context, pc_build(context, &options, &series, &timings));
    const double voxelize_seconds = timings.seconds[PC_STAGE_VOXELIZE];
    const double *layer = series.single_layer.positions;
    for (size_t i = 0; i < 3; ++i) {
        options.simplify.vertices = levels[i];
        assert_ok(context, pc_build_from(context, PC_STAGE_SIMPLIFY, &options, &series, &timings));
        assert_int_equal(series.proxy.vertex_count, levels[i]);
        assert_int_equal(series.options.simplify.vertices, levels[i]);
        assert_true(series.single_layer.positions == layer);
        assert_true(timings.seconds[PC_STAGE_VOXELIZE] == voxelize_seconds);
        pc_asset alone = {0};
        make_asset(context, &alone);
        assert_ok(context, pc_build(context, &options, &alone, NULL));
        assert_true(hash_asset(&series) == hash_asset(&alone));
        pc_asset_free(context, &alone);
    }
    pc_asset early = {0};
    make_asset(context, &early);
    assert_int_equal(pc_build_from(context, PC_STAGE_SIMPLIFY, &options, &early, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_build_from(context, PC_STAGE_COUNT, &options, &series, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(series.stage_count, PC_STAGE_COUNT);
    pc_asset_free(context, &early);
    pc_asset_free(context, &series);
    pc_context_destroy(context);
}

// Loose triangles all over a box, carved as finely as the options allow: the layer has triangles
// squeezed into lines, whose refinement must come to an end.
static void dust_is_carved_in_bounded_time(void **state) {
    (void)state;
    enum { DUST = 200 };
    static double positions[9 * DUST];
    static uint32_t triangles[3 * DUST];
    for (uint32_t i = 0; i < 9 * DUST; ++i) {
        const double center = pci_random(7, 0, i / 9 * 3 + i % 3);
        positions[i] = center + 0.05 * pci_random(7, 1, i);
        triangles[i / 3] = i / 3;
    }
    pc_context *context = test_context(0);
    pc_asset asset = {0};
    const pc_visual_arrays arrays = {.vertex_count = 3 * (size_t)DUST,
                                     .positions = positions,
                                     .triangle_count = DUST,
                                     .triangles = triangles};
    assert_ok(context, pc_visual_create(context, &arrays, &asset.visual, &asset.reports.visual));
    pc_options options = quick_options();
    options.voxelize.voxels = 8;
    options.carve.carve = true;
    options.carve.carve_distance =
        pc_record_find(&pc_carve_options_record, "carve_distance")->minimum;
    for (pc_stage stage = 0; stage <= PC_STAGE_CARVE; ++stage) {
        assert_ok(context, pc_run_stage(context, stage, &options, &asset, NULL));
    }
    assert_true(asset.reports.carve.carved_triangles > 0);
    assert_true(asset.single_layer.triangle_count < 1000000);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

static bool cancel_at_label(void *user, const char *stage, double fraction) {
    (void)user;
    (void)fraction;
    return strcmp(stage, "label") != 0;
}

static void an_error_keeps_the_stages_before_it(void **state) {
    (void)state;
    pc_context *context = test_context(0);
    pc_asset asset = {0};
    make_asset(context, &asset);
    pc_options options = quick_options();
    options.simplify.vertices = 3;
    assert_int_equal(pc_build(context, &options, &asset, NULL), PC_ERROR_INVALID_OPTIONS);
    assert_non_null(strstr(pc_context_error(context)->message, "vertices"));
    assert_int_equal(asset.stage_count, PC_STAGE_SIMPLIFY);
    assert_null(asset.proxy.positions);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

static void progress_can_cancel(void **state) {
    (void)state;
    pc_context *context = NULL;
    const pc_context_options context_options = {.progress = cancel_at_label};
    assert_int_equal(pc_context_create(&context_options, &context), PC_OK);
    pc_asset asset = {0};
    make_asset(context, &asset);
    const pc_options options = quick_options();
    assert_int_equal(pc_build(context, &options, &asset, NULL), PC_ERROR_CANCELLED);
    assert_int_equal(asset.stage_count, PC_STAGE_LABEL);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_sheet_becomes_one_open_proxy),
        cmocka_unit_test(results_do_not_depend_on_threads),
        cmocka_unit_test(rerunning_a_stage_drops_later_results),
        cmocka_unit_test(levels_share_the_stages_before),
        cmocka_unit_test(dust_is_carved_in_bounded_time),
        cmocka_unit_test(an_error_keeps_the_stages_before_it),
        cmocka_unit_test(progress_can_cancel),
    };
    return cmocka_run_group_tests_name("pipeline", tests, NULL, NULL);
}
