// The same bytes of every file for any number of threads, in every run, and from the kernels of
// every instruction set, ours and Embree's.
#define _POSIX_C_SOURCE 200809L
#include "core/embree.h"
#include "geometry/bvh_tree.h"
#include "stages/skin/skin_kernel.h"
#include "support/files.h"
#include "support/surfaces.h"

// In place of the library's choices (skin_kernel.c, bvh_kernel.c), which are then not linked.
static const pci_skin_kernel *kernels[2] = {&pci_skin_generic_float, &pci_skin_generic_double};
const pci_skin_kernel *pci_skin_kernel_float(void) { return kernels[0]; }
const pci_skin_kernel *pci_skin_kernel_double(void) { return kernels[1]; }
static const pci_bvh_kernel *bvh_kernel = &pci_bvh_generic;
const pci_bvh_kernel *pci_bvh_best_kernel(void) { return bvh_kernel; }

// Sets the kernels number `index`; false: there are no more that this processor can run.
static bool choose_kernels(size_t index) {
    const pci_skin_kernel *const choices[][2] = {
        {&pci_skin_generic_float, &pci_skin_generic_double},
#if defined(__x86_64__)
        {&pci_skin_avx2_float, &pci_skin_avx2_double},
        {&pci_skin_avx512_float, &pci_skin_avx512_double},
#endif
    };
    if (index >= sizeof(choices) / sizeof(choices[0])) {
        return false;
    }
#if defined(__x86_64__)
    const bool usable[] = {true, __builtin_cpu_supports("avx2") != 0,
                           __builtin_cpu_supports("avx512f") != 0};
    if (!usable[index]) {
        return false;
    }
    bvh_kernel = index == 0 ? &pci_bvh_generic : &pci_bvh_avx2;
#endif
    memcpy(kernels, choices[index], sizeof(kernels));
    return true;
}

// The same for Embree (embree.c).
static const char *embree_configuration = "threads=1";
const char *pci_embree_configuration(void) { return embree_configuration; }

static bool choose_embree(size_t index) {
    static const char *const configurations[] = {
        "threads=1,isa=sse2",
#if defined(__x86_64__)
        "threads=1,isa=avx2",
        "threads=1,isa=avx512",
#endif
    };
    if (index >= sizeof(configurations) / sizeof(configurations[0])) {
        return false;
    }
#if defined(__x86_64__)
    const bool usable[] = {
        true, __builtin_cpu_supports("avx2") != 0 && __builtin_cpu_supports("fma"),
        __builtin_cpu_supports("avx512f") != 0 && __builtin_cpu_supports("avx512dq") != 0 &&
            __builtin_cpu_supports("avx512bw") != 0 && __builtin_cpu_supports("avx512vl") != 0};
    if (!usable[index]) {
        return false;
    }
#endif
    embree_configuration = configurations[index];
    return true;
}

// ---- files -------------------------------------------------------------------------------------

enum { FILES = 5 };
typedef struct results {
    char folder[64], paths[FILES][128];
    bytes contents[FILES];
} results;

// A tube in a tube: a layered garment with two openings.
static void make_garment(pc_context *context, pc_asset *asset) {
    pc_mesh outer = test_tube(context, 24, 10, 0.3, 1.0),
            inner = test_tube(context, 24, 10, 0.2, 0.8);
    const double offset[3] = {0.0, 0.1, 0.0};
    pc_mesh both = test_union(context, &outer, &inner, offset);
    const pc_visual_arrays arrays = {.vertex_count = both.vertex_count,
                                     .positions = both.positions,
                                     .triangle_count = both.triangle_count,
                                     .triangles = both.triangles};
    assert_ok(context, pc_visual_create(context, &arrays, &asset->visual, &asset->reports.visual));
    snprintf(asset->name, sizeof(asset->name), "tubes");
    pc_mesh_free(context, &outer);
    pc_mesh_free(context, &inner);
    pc_mesh_free(context, &both);
}

static void make_results(uint32_t threads, results *r) {
    static const char *const names[FILES] = {"a.h5", "a.glb", "a.obj", "a.json", "a.png"};
    pc_context *context = test_context(threads);
    pc_asset asset = {0};
    make_garment(context, &asset);
    pc_options options = pc_default_options();
    options.voxelize.voxels = 16;
    options.simplify.vertices = 40;
    options.simulate.frames = 12;
    options.skin.epochs = 4;
    assert_ok(context, pc_build(context, &options, &asset, NULL));
    pc_measures measures;
    assert_ok(context, pc_evaluate(context, &asset.visual.surface, &asset.proxy, &measures));
    snprintf(r->folder, sizeof(r->folder), "/tmp/proxycloth-XXXXXX");
    assert_non_null(mkdtemp(r->folder));
    for (size_t i = 0; i < FILES; ++i) {
        snprintf(r->paths[i], sizeof(r->paths[i]), "%s/%s", r->folder, names[i]);
    }
    const pc_contact_sheet_options sheet = {.tile_size = 96, .skinned_frames = 2};
    assert_ok(context, pc_asset_save(context, &asset, r->paths[0]));
    assert_ok(context, pc_export_glb(context, &asset, r->paths[1]));
    assert_ok(context, pc_export_obj(context, &asset.proxy, r->paths[2]));
    assert_ok(context, pc_export_report(context, &asset, &measures, NULL, r->paths[3]));
    assert_ok(context, pc_export_contact_sheet(context, &asset, &sheet, r->paths[4]));
    for (size_t i = 0; i < FILES; ++i) {
        r->contents[i] = read_bytes(r->paths[i]);
        assert_int_equal(unlink(r->paths[i]), 0);
    }
    assert_int_equal(rmdir(r->folder), 0);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

static void free_results(results *r) {
    for (size_t i = 0; i < FILES; ++i) {
        free(r->contents[i].data);
    }
}

static void assert_same_results(const char *what, unsigned number, const results *a,
                                const results *b) {
    for (size_t i = 0; i < FILES; ++i) {
        if (a->contents[i].size != b->contents[i].size ||
            memcmp(a->contents[i].data, b->contents[i].data, a->contents[i].size) != 0) {
            fail_msg("%s differs for %s %u", strrchr(a->paths[i], '/') + 1, what, number);
        }
    }
}

static void threads_and_reruns_give_the_same_files(void **state) {
    (void)state;
    static const uint32_t threads[] = {2, 3, 8, 1, 2, 3, 8, 1, 8, 1};
    results first, other;
    make_results(1, &first);
    for (size_t i = 0; i < sizeof(threads) / sizeof(threads[0]); ++i) {
        make_results(threads[i], &other);
        assert_same_results("threads", threads[i], &first, &other);
        free_results(&other);
    }
    free_results(&first);
}

static void instruction_sets_give_the_same_files(void **state) {
    (void)state;
    results first, other;
    assert_true(choose_kernels(0));
    make_results(1, &first);
    for (unsigned i = 1; choose_kernels(i); ++i) {
        make_results(1, &other);
        assert_same_results("kernels", i, &first, &other);
        free_results(&other);
    }
    (void)choose_kernels(0);
    free_results(&first);
}

static void instruction_sets_of_embree_give_the_same_files(void **state) {
    (void)state;
    results first, other;
    const char *const usual = embree_configuration;
    make_results(1, &first);
    for (unsigned i = 0; choose_embree(i); ++i) {
        make_results(1, &other);
        assert_same_results("Embree", i, &first, &other);
        free_results(&other);
    }
    embree_configuration = usual;
    free_results(&first);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(threads_and_reruns_give_the_same_files),
        cmocka_unit_test(instruction_sets_give_the_same_files),
        cmocka_unit_test(instruction_sets_of_embree_give_the_same_files),
    };
    return cmocka_run_group_tests_name("determinism", tests, NULL, NULL);
}
