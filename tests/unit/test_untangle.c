#include "support/test.h"

#include "geometry/crossing.h"
#include "geometry/topology.h"
#include "stages/simplify/improve.h"
#include "stages/simplify/separate.h"
#include "stages/simplify/untangle.h"
#include "support/surfaces.h"

static const double spacing = 0.1;

// Two sheets of ten by ten cells, 0.06 apart; every vertex moves by up to `noise` upwards or
// downwards, which makes them cross.
static pc_mesh two_sheets(pc_context *context, double noise, uint64_t seed) {
    const double offset[3] = {0.013, 0.027, 0.06};
    pc_mesh sheet = test_sheet(context, 10, 10, 1.0, 1.0);
    pc_mesh both = test_union(context, &sheet, &sheet, offset);
    for (size_t v = 0; v < both.vertex_count; ++v) {
        both.positions[3 * v + 2] += noise * (2.0 * pci_random(seed, 7, v) - 1.0);
    }
    pc_mesh_free(context, &sheet);
    return both;
}

static double least_angle(const pci_relaxation *r) {
    double least = 180.0;
    for (uint32_t v = 0; v < r->coarse->vertex_count; ++v) {
        least = fmin(least, pci_shape_of_fan(r, v).angle);
    }
    return least;
}

enum { PUSH = 1, SEARCH = 2 };

// Untangles noisy sheets; `result` receives the positions, from scratch. Returns what still
// crosses.
static size_t untangle(pci_scratch *scratch, unsigned ways, double noise, uint64_t seed,
                       pc_mesh *result, size_t *before) {
    pc_context *context = scratch->context;
    pc_mesh apart = two_sheets(context, 0.0, seed), tangled = two_sheets(context, noise, seed);
    double *normals = PCI_SCRATCH(scratch, double, 3 * apart.vertex_count);
    double *scales = PCI_SCRATCH(scratch, double, apart.vertex_count);
    uint32_t *feet = PCI_SCRATCH(scratch, uint32_t, apart.vertex_count);
    uint8_t *pinned = PCI_SCRATCH(scratch, uint8_t, apart.vertex_count);
    pci_halfedge fine, coarse;
    assert_true(pci_halfedge_build(scratch, &apart, &fine));
    assert_true(pci_halfedge_build(scratch, &tangled, &coarse));
    pci_vertex_normals(&apart, normals);
    for (uint32_t v = 0; v < apart.vertex_count; ++v) {
        scales[v] = 1.0;
        feet[v] = v;
    }
    pci_relaxation relaxation = {.fine = &fine,
                                 .fine_normals = normals,
                                 .scales = scales,
                                 .coarse = &coarse,
                                 .feet = feet,
                                 .pinned = pinned};
    assert_true(pci_list_self_intersections(scratch, &tangled, NULL, before));
    size_t left = SIZE_MAX;
    if (ways & PUSH) {
        assert_true(pci_untangle(scratch, &relaxation, spacing, &left));
    }
    if (ways & SEARCH) {
        pci_flaws flaws;
        assert_true(pci_separate(scratch, &relaxation, spacing, &flaws));
        assert_int_equal(flaws.slivers, 0);
        left = flaws.crossings;
    }
    *result =
        (pc_mesh){coarse.vertex_count, coarse.positions, coarse.triangle_count, coarse.corners};
    assert_true(least_angle(&relaxation) >= 20.0);
    pc_mesh_free(context, &apart);
    pc_mesh_free(context, &tangled);
    return left;
}

// By either way alone, and by both.
static void sheets_come_apart(void **state) {
    (void)state;
    for (uint64_t seed = 0; seed < 9; ++seed) {
        const unsigned ways = 1 + (unsigned)seed % 3;
        pc_context *context = test_context(1);
        pci_scratch scratch = pci_scratch_begin(context);
        pc_mesh result;
        size_t before = 0;
        const size_t left = untangle(&scratch, ways, 0.045, seed, &result, &before);
        uint64_t crossings = 99;
        assert_ok(context, pci_count_self_intersections(context, "test", &result, &crossings));
        assert_true(before > 20);
        assert_int_equal(left, 0);
        assert_int_equal(crossings, 0);
        for (size_t v = 0; v < result.vertex_count; ++v) { // and nothing flies away
            assert_true(fabs(result.positions[3 * v + 2] - 0.03) < 0.03 + 0.045 + 0.5 * spacing);
        }
        pci_scratch_end(&scratch);
        pc_context_destroy(context);
    }
}

static void what_does_not_cross_stays(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pci_scratch scratch = pci_scratch_begin(context);
    pc_mesh result, same = two_sheets(context, 0.01, 3);
    size_t before = 99;
    assert_int_equal(untangle(&scratch, PUSH | SEARCH, 0.01, 3, &result, &before), 0);
    assert_int_equal(before, 0);
    assert_memory_equal(result.positions, same.positions,
                        3 * same.vertex_count * sizeof(*same.positions));
    pc_mesh_free(context, &same);
    pci_scratch_end(&scratch);
    pc_context_destroy(context);
}

static void is_deterministic(void **state) {
    (void)state;
    static const uint32_t threads[] = {1, 2, 3, 8};
    double first[6 * 121];
    for (size_t i = 0; i < 4; ++i) {
        pc_context *context = test_context(threads[i]);
        pci_scratch scratch = pci_scratch_begin(context);
        pc_mesh result;
        size_t before = 0;
        (void)untangle(&scratch, PUSH | SEARCH, 0.06, 5, &result, &before);
        if (i == 0) {
            memcpy(first, result.positions, sizeof(first));
        }
        assert_memory_equal(result.positions, first, sizeof(first));
        pci_scratch_end(&scratch);
        pc_context_destroy(context);
    }
}

// Every pair once, in the same order at any number of threads, and each of them crosses.
static void lists_pairs_that_cross(void **state) {
    (void)state;
    static const uint32_t threads[] = {1, 2, 3, 8};
    uint32_t *first = NULL;
    pc_context *owner = test_context(1);
    pci_scratch kept = pci_scratch_begin(owner);
    for (size_t i = 0; i < 4; ++i) {
        pc_context *context = test_context(threads[i]);
        pci_scratch scratch = pci_scratch_begin(context);
        pc_mesh mesh = two_sheets(context, 0.08, 1);
        uint32_t *pairs = NULL;
        size_t count = 0, expected = 0;
        assert_true(pci_list_self_intersections(&scratch, &mesh, &pairs, &count));
        for (uint32_t s = 0; s < mesh.triangle_count; ++s) {
            for (uint32_t t = s + 1; t < mesh.triangle_count; ++t) {
                expected += pci_pair_crosses(&mesh, s, t);
            }
        }
        assert_true(count > 100);
        assert_int_equal(count, expected);
        for (size_t p = 0; p < count; ++p) {
            assert_true(pci_pair_crosses(&mesh, pairs[2 * p], pairs[2 * p + 1]));
            for (size_t q = 0; q < p; ++q) {
                assert_false(
                    (pairs[2 * q] == pairs[2 * p] && pairs[2 * q + 1] == pairs[2 * p + 1]) ||
                    (pairs[2 * q] == pairs[2 * p + 1] && pairs[2 * q + 1] == pairs[2 * p]));
            }
        }
        if (i == 0) {
            first = PCI_SCRATCH(&kept, uint32_t, 2 * count);
            memcpy(first, pairs, 2 * count * sizeof(*first));
        }
        assert_memory_equal(pairs, first, 2 * count * sizeof(*first));
        pc_mesh_free(context, &mesh);
        pci_scratch_end(&scratch);
        pc_context_destroy(context);
    }
    pci_scratch_end(&kept);
    pc_context_destroy(owner);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(sheets_come_apart),
        cmocka_unit_test(what_does_not_cross_stays),
        cmocka_unit_test(is_deterministic),
        cmocka_unit_test(lists_pairs_that_cross),
    };
    return cmocka_run_group_tests_name("untangle", tests, NULL, NULL);
}
