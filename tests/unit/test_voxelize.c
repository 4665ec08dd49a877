#include "support/memory.h"

#include <stdlib.h>

#include "core/bvh.h"

// ---- surfaces -----------------------------------------------------------------------------------

static pc_mesh allocate_mesh(pc_context *context, size_t vertices, size_t triangles) {
    pc_mesh mesh = {.vertex_count = vertices, .triangle_count = triangles};
    mesh.positions = PCI_ALLOCATE(context, double, 3 * vertices);
    mesh.triangles = PCI_ALLOCATE(context, uint32_t, 3 * triangles);
    assert_non_null(mesh.positions);
    assert_non_null(mesh.triangles);
    return mesh;
}

// Random triangles, some of them segments and points, in a box with the given sides.
static pc_mesh soup(pc_context *context, size_t triangles, uint64_t seed, const double sides[3],
                    double offset) {
    pc_mesh mesh = allocate_mesh(context, 3 * triangles, triangles);
    for (size_t i = 0; i < 9 * triangles; ++i) {
        mesh.positions[i] = offset + sides[i % 3] * pci_random(seed, i, 0);
    }
    for (size_t i = 0; i < 3 * triangles; ++i) {
        const size_t kind = i / 3 % 5; // 0: segment, 1: point
        mesh.triangles[i] = (uint32_t)(kind == 0 && i % 3 == 2 ? i - 1 : kind == 1 ? i / 3 * 3 : i);
    }
    return mesh;
}

// An n by n sheet of quads in the plane z = height, slightly bent when `bend` is not 0.
static pc_mesh sheet(pc_context *context, size_t n, double side, double height, double bend) {
    pc_mesh mesh = allocate_mesh(context, (n + 1) * (n + 1), 2 * n * n);
    for (size_t i = 0; i <= n; ++i) {
        for (size_t j = 0; j <= n; ++j) {
            double *p = &mesh.positions[3 * (i * (n + 1) + j)];
            p[0] = side * (double)i / (double)n;
            p[1] = side * (double)j / (double)n;
            p[2] = height + bend * sin(7.0 * p[0] / side) * cos(5.0 * p[1] / side);
        }
    }
    uint32_t *corner = mesh.triangles;
    for (uint32_t i = 0; i < n; ++i) {
        for (uint32_t j = 0; j < n; ++j) {
            const uint32_t a = i * ((uint32_t)n + 1) + j, b = a + (uint32_t)n + 1;
            const uint32_t quad[6] = {a, b, b + 1, a, b + 1, a + 1};
            memcpy(corner, quad, sizeof(quad));
            corner += 6;
        }
    }
    return mesh;
}

static double brute_force_distance(const pc_mesh *mesh, const double point[3]) {
    double best = INFINITY, weights[3];
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        const uint32_t *corner = &mesh->triangles[3 * t];
        best = fmin(
            best, pci_triangle_squared_distance(point, &mesh->positions[3 * (size_t)corner[0]],
                                                &mesh->positions[3 * (size_t)corner[1]],
                                                &mesh->positions[3 * (size_t)corner[2]], weights));
    }
    return sqrt(best);
}

// Looks at every lattice point: the samples are exactly those within the band, in order, with the
// exact distance rounded to float; and the outermost layer is farther than the band.
static void assert_is_the_distance_field(const pc_mesh *mesh, const pc_grid *grid) {
    size_t next = 0;
    for (uint32_t z = 0; z < grid->size[2]; ++z) {
        for (uint32_t y = 0; y < grid->size[1]; ++y) {
            for (uint32_t x = 0; x < grid->size[0]; ++x) {
                const uint32_t at[3] = {x, y, z};
                double point[3];
                bool border = false;
                for (size_t k = 0; k < 3; ++k) {
                    point[k] = grid->origin[k] + grid->cell_size * at[k];
                    border |= at[k] == 0 || at[k] + 1 == grid->size[k];
                }
                const double distance = brute_force_distance(mesh, point);
                assert_true(!border || distance > grid->band);
                if (distance > grid->band) {
                    continue;
                }
                assert_true(next < grid->sample_count);
                assert_true(grid->samples[next] ==
                            x + (uint64_t)grid->size[0] * (y + (uint64_t)grid->size[1] * z));
                assert_true(grid->values[next] == (float)distance);
                ++next;
            }
        }
    }
    assert_int_equal(next, grid->sample_count);
}

// ---- tests --------------------------------------------------------------------------------------

static void soups_equal_brute_force(void **state) {
    (void)state;
    static const struct {
        size_t triangles;
        uint32_t voxels;
        double sides[3], offset;
    } cases[] = {
        {1, 8, {1, 1, 1}, 0},     {4, 12, {1, 1, 1}, -3},         {30, 10, {1, 0.2, 3}, 0},
        {100, 8, {1, 1, 1}, 100}, {20, 9, {1e-3, 2e-3, 1e-3}, 1}, {20, 10, {1e4, 2e3, 1e2}, -5e4},
        {7, 40, {0, 0, 1}, 0.25}, {9, 13, {1, 0, 1}, 0},
    };
    pc_context *context = test_context(2);
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); ++i) {
        pc_mesh mesh = soup(context, cases[i].triangles, i, cases[i].sides, cases[i].offset);
        const pc_voxelize_options options = {.voxels = cases[i].voxels};
        pc_grid grid = {0};
        pc_voxelize_report report = {0};
        assert_ok(context, pc_voxelize(context, &mesh, &options, &grid, &report));
        assert_true(grid.sample_count > 0);
        assert_is_the_distance_field(&mesh, &grid);
        assert_int_equal(report.samples, grid.sample_count);
        assert_true(report.cell_size == grid.cell_size);
        assert_true(report.queries >= report.samples);
        pc_grid_free(context, &grid);
        pc_mesh_free(context, &mesh);
    }
    pc_context_destroy(context);
}

// Many triangles per leaf block take another path than few.
static void dense_sheet_equals_brute_force(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_mesh mesh = sheet(context, 24, 2.0, 0.3, 0.2);
    const pc_voxelize_options options = {.voxels = 10};
    pc_grid grid = {0};
    assert_ok(context, pc_voxelize(context, &mesh, &options, &grid, NULL));
    assert_is_the_distance_field(&mesh, &grid);
    assert_close(grid.cell_size, 0.2, 1e-15);
    pc_grid_free(context, &grid);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

static void flat_sheet_lies_between_lattice_planes(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh mesh = sheet(context, 2, 1.0, -4.0, 0.0);
    pc_grid grid = {0};
    assert_ok(context, pc_voxelize(context, &mesh, NULL, &grid, NULL));
    assert_close(grid.cell_size, 1.0 / 32.0, 0.0);
    assert_int_equal(grid.size[2], 8);
    for (size_t i = 0; i < grid.sample_count; ++i) {
        const double cells = (double)grid.values[i] / grid.cell_size;
        assert_true(cells > 0.49);
    }
    pc_grid_free(context, &grid);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

static void lattice_has_the_promised_size(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    for (uint32_t voxels = 4; voxels <= 60; ++voxels) {
        pc_mesh mesh = sheet(context, 1, 0.1 * voxels * voxels, 0.0, 0.0);
        const pc_voxelize_options options = {.voxels = voxels};
        pc_grid grid = {0};
        assert_ok(context, pc_voxelize(context, &mesh, &options, &grid, NULL));
        assert_int_equal(grid.size[0], voxels + 8);
        assert_int_equal(grid.size[1], voxels + 8);
        assert_close(grid.origin[0], -3.5 * grid.cell_size, 1e-12 * voxels * voxels);
        pc_grid_free(context, &grid);
        pc_mesh_free(context, &mesh);
    }
    pc_context_destroy(context);
}

// What the iso-surface needs: a cell with a corner closer than one voxel has all eight corners.
static void cells_of_the_iso_surface_are_complete(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    const double sides[3] = {1, 2, 1.5};
    for (uint64_t seed = 0; seed < 5; ++seed) {
        pc_mesh mesh = soup(context, 12, seed, sides, 0.0);
        pc_grid grid = {0};
        assert_ok(context, pc_voxelize(context, &mesh, NULL, &grid, NULL));
        const size_t points = (size_t)grid.size[0] * grid.size[1] * grid.size[2];
        uint8_t *present = calloc(points, 1);
        assert_non_null(present);
        for (size_t i = 0; i < grid.sample_count; ++i) {
            present[grid.samples[i]] = 1;
        }
        for (size_t i = 0; i < grid.sample_count; ++i) {
            if ((double)grid.values[i] >= grid.cell_size * (1.0 + 1e-6)) {
                continue;
            }
            for (int neighbour = 0; neighbour < 27; ++neighbour) {
                const int64_t dx = neighbour % 3 - 1, dy = neighbour / 3 % 3 - 1;
                const int64_t dz = neighbour / 9 - 1;
                const int64_t step = dx + (int64_t)grid.size[0] * (dy + (int64_t)grid.size[1] * dz);
                assert_true(present[(int64_t)grid.samples[i] + step]);
            }
        }
        free(present);
        pc_grid_free(context, &grid);
        pc_mesh_free(context, &mesh);
    }
    pc_context_destroy(context);
}

// Scaling by a power of two changes nothing but the unit.
static void scale_is_a_unit(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    const double sides[3] = {1, 2, 1};
    pc_mesh mesh = soup(context, 40, 8, sides, 0.5);
    pc_grid grid = {0}, scaled = {0};
    assert_ok(context, pc_voxelize(context, &mesh, NULL, &grid, NULL));
    for (size_t i = 0; i < 3 * mesh.vertex_count; ++i) {
        mesh.positions[i] *= 1024.0;
    }
    assert_ok(context, pc_voxelize(context, &mesh, NULL, &scaled, NULL));
    assert_int_equal(scaled.sample_count, grid.sample_count);
    assert_memory_equal(scaled.samples, grid.samples, grid.sample_count * sizeof(uint64_t));
    for (size_t i = 0; i < grid.sample_count; ++i) {
        assert_true(scaled.values[i] == 1024.0f * grid.values[i]);
    }
    pc_grid_free(context, &grid);
    pc_grid_free(context, &scaled);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

static void cost_grows_with_the_area(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_mesh mesh = sheet(context, 8, 1.0, 0.0, 0.3);
    pc_voxelize_report reports[2] = {{0}};
    for (size_t i = 0; i < 2; ++i) {
        const pc_voxelize_options options = {.voxels = i == 0 ? 64 : 256};
        pc_grid grid = {0};
        assert_ok(context, pc_voxelize(context, &mesh, &options, &grid, &reports[i]));
        pc_grid_free(context, &grid);
    }
    assert_true(reports[1].samples < 18 * reports[0].samples);
    assert_true(reports[1].queries < 18 * reports[0].queries);
    assert_true(reports[1].queries < 3 * reports[1].samples);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

static void threads_do_not_change_the_result(void **state) {
    (void)state;
    static const uint32_t thread_counts[] = {1, 2, 3, 8};
    const double sides[3] = {2, 1, 1};
    pc_context *owner = test_context(1);
    pc_mesh mesh = soup(owner, 60, 4, sides, 0.0);
    pc_grid first = {0};
    pc_voxelize_report first_report = {0};
    assert_ok(owner, pc_voxelize(owner, &mesh, NULL, &first, &first_report));
    for (size_t i = 0; i < 4; ++i) {
        pc_context *context = test_context(thread_counts[i]);
        pc_grid grid = {0};
        pc_voxelize_report report = {0};
        assert_ok(context, pc_voxelize(context, &mesh, NULL, &grid, &report));
        assert_int_equal(grid.sample_count, first.sample_count);
        assert_memory_equal(grid.samples, first.samples, grid.sample_count * sizeof(uint64_t));
        assert_memory_equal(grid.values, first.values, grid.sample_count * sizeof(float));
        assert_int_equal(report.queries, first_report.queries);
        pc_grid_free(context, &grid);
        pc_context_destroy(context);
    }
    pc_grid_free(owner, &first);
    pc_mesh_free(owner, &mesh);
    pc_context_destroy(owner);
}

// ---- errors -------------------------------------------------------------------------------------

static void assert_empty(const pc_grid *grid) {
    assert_true(grid->samples == NULL && grid->values == NULL && grid->sample_count == 0);
}

static void bad_input_is_refused(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    const double sides[3] = {1, 1, 1};
    pc_mesh mesh = soup(context, 3, 0, sides, 0.0);
    pc_grid grid = {0};
    assert_int_equal(pc_voxelize(context, NULL, NULL, &grid, NULL), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_voxelize(context, &mesh, NULL, NULL, NULL), PC_ERROR_INVALID_ARGUMENT);
    static const uint32_t voxels[] = {0, 3, 1025};
    for (size_t i = 0; i < 3; ++i) {
        const pc_voxelize_options options = {.voxels = voxels[i]};
        assert_int_equal(pc_voxelize(context, &mesh, &options, &grid, NULL),
                         PC_ERROR_INVALID_OPTIONS);
    }
    const pc_mesh empty = {0};
    assert_int_equal(pc_voxelize(context, &empty, NULL, &grid, NULL), PC_ERROR_INVALID_ARGUMENT);
    double point[3] = {1, 2, 3};
    uint32_t corners[3] = {0};
    const pc_mesh no_extent = {1, point, 1, corners};
    assert_int_equal(pc_voxelize(context, &no_extent, NULL, &grid, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    mesh.positions[4] = INFINITY;
    assert_int_equal(pc_voxelize(context, &mesh, NULL, &grid, NULL), PC_ERROR_INVALID_ARGUMENT);
    mesh.positions[4] = NAN;
    assert_int_equal(pc_voxelize(context, &mesh, NULL, &grid, NULL), PC_ERROR_INVALID_ARGUMENT);
    assert_empty(&grid);
    mesh.positions[4] = 0.0;
    assert_ok(context, pc_voxelize(context, &mesh, NULL, &grid, NULL));
    assert_int_equal(pc_voxelize(context, &mesh, NULL, &grid, NULL), PC_ERROR_INVALID_ARGUMENT);
    pc_grid_free(context, &grid);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

static bool refuse_progress(void *user, const char *stage, double fraction) {
    (void)fraction;
    assert_string_equal(stage, "voxelize");
    ++*(int *)user;
    return false;
}

static void cancelling_leaves_nothing_behind(void **state) {
    (void)state;
    int calls = 0;
    const pc_context_options options = {.threads = 2, .progress = refuse_progress, .user = &calls};
    pc_context *context = NULL;
    assert_int_equal(pc_context_create(&options, &context), PC_OK);
    pc_mesh mesh = sheet(context, 2, 1.0, 0.0, 0.0);
    pc_grid grid = {0};
    assert_int_equal(pc_voxelize(context, &mesh, NULL, &grid, NULL), PC_ERROR_CANCELLED);
    assert_int_equal(calls, 1);
    assert_empty(&grid);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

static void lack_of_memory_leaves_nothing_behind(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    pc_mesh mesh = sheet(context, 2, 1.0, 0.0, 0.1);
    const size_t before = counter.live;
    size_t call = 1;
    for (;; ++call) {
        pc_grid grid = {0};
        fail_allocation(&counter, call);
        const pc_status status = pc_voxelize(context, &mesh, NULL, &grid, NULL);
        if (status == PC_OK) {
            pc_grid_free(context, &grid);
            break;
        }
        assert_int_equal(status, PC_ERROR_OUT_OF_MEMORY);
        assert_int_equal(counter.live, before);
        assert_empty(&grid);
    }
    assert_true(call > 9);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
    assert_int_equal(counter.live, 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(soups_equal_brute_force),
        cmocka_unit_test(dense_sheet_equals_brute_force),
        cmocka_unit_test(flat_sheet_lies_between_lattice_planes),
        cmocka_unit_test(lattice_has_the_promised_size),
        cmocka_unit_test(cells_of_the_iso_surface_are_complete),
        cmocka_unit_test(scale_is_a_unit),
        cmocka_unit_test(cost_grows_with_the_area),
        cmocka_unit_test(threads_do_not_change_the_result),
        cmocka_unit_test(bad_input_is_refused),
        cmocka_unit_test(cancelling_leaves_nothing_behind),
        cmocka_unit_test(lack_of_memory_leaves_nothing_behind),
    };
    return cmocka_run_group_tests_name("voxelize", tests, NULL, NULL);
}
