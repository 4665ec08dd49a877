// Several contexts in several threads at once, each with an allocator and callbacks of its own, as
// a game's importer runs them: none notices another. Worth running under the thread sanitizer.
#define _POSIX_C_SOURCE 200809L
#include <pthread.h>
#include <stdatomic.h>

#include "support/files.h"
#include "support/memory.h"
#include "support/surfaces.h"
#include "support/test.h"

enum { WORKERS = 4, CANCELLED = 2 };

typedef struct worker {
    pthread_t thread;
    const pc_visual_arrays *arrays;
    atomic_size_t live, calls; // of the allocator, which several threads of the context use
    size_t reports;            // of progress
    size_t last_report;        // the user cancels at this one; 0: never
    pthread_t caller;
    bool foreign; // a callback came from another thread than the caller's
    pc_status status;
    char error[512];
    char path[64];
} worker;

static void *counted_allocate(void *user, size_t size) {
    worker *w = user;
    void *memory = malloc(size);
    atomic_fetch_add(&w->calls, 1);
    atomic_fetch_add(&w->live, memory != NULL);
    return memory;
}

static void counted_release(void *user, void *memory) {
    atomic_fetch_sub(&((worker *)user)->live, 1);
    free(memory);
}

static bool count_progress(void *user, const char *stage, double fraction) {
    worker *w = user;
    w->foreign = w->foreign || !pthread_equal(w->caller, pthread_self());
    return stage != NULL && fraction >= 0.0 && ++w->reports != w->last_report;
}

static void note_log(void *user, pc_log_level level, const char *stage, const char *message) {
    worker *w = user;
    w->foreign = w->foreign || !pthread_equal(w->caller, pthread_self());
    (void)level;
    (void)stage;
    (void)message;
}

static pc_options quick_options(void) {
    pc_options options = pc_default_options();
    options.voxelize.voxels = 12;
    options.simplify.vertices = 30;
    options.simulate.frames = 10;
    options.skin.rounds = 2;
    return options;
}

// A whole conversion, from the context to the GLB file.
static void *convert(void *user) {
    worker *w = user;
    w->caller = pthread_self();
    const pc_context_options settings = {.allocator = {counted_allocate, counted_release, w},
                                         .threads = 2,
                                         .log = note_log,
                                         .progress = count_progress,
                                         .user = w};
    pc_context *context = NULL;
    pc_asset asset = {0};
    const pc_options options = quick_options();
    w->status = pc_context_create(&settings, &context);
    if (w->status == PC_OK) {
        w->status = pc_visual_create(context, w->arrays, &asset.visual, &asset.reports.visual);
    }
    if (w->status == PC_OK) {
        w->status = pc_build(context, &options, &asset, NULL);
    }
    if (w->status == PC_OK) {
        w->status = pc_export_glb(context, &asset, w->path);
    }
    snprintf(w->error, sizeof(w->error), "%s", pc_context_error(context)->message);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
    return NULL;
}

static void contexts_do_not_notice_each_other(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh tube = test_tube(context, 24, 16, 0.3, 1.0);
    const pc_visual_arrays arrays = {.vertex_count = tube.vertex_count,
                                     .positions = tube.positions,
                                     .triangle_count = tube.triangle_count,
                                     .triangles = tube.triangles};
    worker alone = {.arrays = &arrays, .path = "contexts_alone.glb"};
    convert(&alone);
    assert_int_equal(alone.status, PC_OK);
    worker workers[WORKERS] = {{.arrays = NULL}};
    for (size_t i = 0; i < WORKERS; ++i) {
        workers[i].arrays = &arrays;
        workers[i].last_report = i == CANCELLED ? alone.reports / 2 : 0;
        snprintf(workers[i].path, sizeof(workers[i].path), "contexts_%zu.glb", i);
        assert_int_equal(pthread_create(&workers[i].thread, NULL, convert, &workers[i]), 0);
    }
    for (size_t i = 0; i < WORKERS; ++i) {
        const worker *w = &workers[i];
        assert_int_equal(pthread_join(w->thread, NULL), 0);
        assert_int_equal(atomic_load(&w->live), 0);
        assert_true(atomic_load(&w->calls) > 0 && w->reports > 0 && !w->foreign);
        if (i == CANCELLED) {
            assert_int_equal(w->status, PC_ERROR_CANCELLED);
            assert_non_null(strstr(w->error, "cancelled"));
            continue;
        }
        assert_int_equal(w->status, PC_OK);
        assert_string_equal(w->error, "");
        assert_same_file(w->path, alone.path);
        assert_int_equal(unlink(w->path), 0);
    }
    assert_int_equal(unlink(alone.path), 0);
    pc_mesh_free(context, &tube);
    pc_context_destroy(context);
}

// A conversion that begins with `number` - 1 successful allocations ends in that error or not at
// all, and gives everything back.
static void memory_may_run_out_anywhere(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    pc_mesh tube = test_tube(context, 12, 8, 0.3, 1.0);
    const pc_visual_arrays arrays = {.vertex_count = tube.vertex_count,
                                     .positions = tube.positions,
                                     .triangle_count = tube.triangle_count,
                                     .triangles = tube.triangles};
    const pc_options options = quick_options();
    starvation s = {.counter = &counter, .growth = 8};
    while (starves(&s)) {
        pc_asset asset = {0};
        s.status = pc_visual_create(context, &arrays, &asset.visual, &asset.reports.visual);
        if (s.status == PC_OK) {
            s.status = pc_build(context, &options, &asset, NULL);
        }
        if (s.status == PC_OK) {
            s.status = pc_export_glb(context, &asset, "contexts_memory.glb");
        }
        pc_asset_free(context, &asset);
    }
    assert_true(s.failures > 30);
    assert_int_equal(unlink("contexts_memory.glb"), 0);
    pc_mesh_free(context, &tube);
    pc_context_destroy(context);
}

// Headers that do not fit the library are refused before anything else happens.
static void other_headers_are_refused(void **state) {
    (void)state;
    pc_context *context = (pc_context *)&state;
    assert_int_equal(pc_context_create_abi(PC_ABI_VERSION + 1, NULL, &context), PC_ERROR_VERSION);
    assert_null(context);
    assert_int_equal(pc_context_create_abi(PC_ABI_VERSION, NULL, NULL), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_context_create_abi(PC_ABI_VERSION, NULL, &context), PC_OK);
    pc_context_destroy(context);
}

static void dependencies_have_versions_and_licences(void **state) {
    (void)state;
    pc_dependency dependency;
    size_t count = 0;
    for (; pc_dependency_at(count, &dependency); ++count) {
        assert_true(dependency.name[0] != '\0' && dependency.licence[0] != '\0');
        assert_true(dependency.version[0] >= '0' && dependency.version[0] <= '9');
    }
    assert_true(count >= 5);
    assert_false(pc_dependency_at(0, NULL));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(contexts_do_not_notice_each_other),
        cmocka_unit_test(memory_may_run_out_anywhere),
        cmocka_unit_test(other_headers_are_refused),
        cmocka_unit_test(dependencies_have_versions_and_licences),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
