#include "support/memory.h"

#include <stdlib.h>

#include "geometry/triangle_distance.h"
#include "support/surfaces.h"

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

// ---- auto ---------------------------------------------------------------------------------------

static pc_voxelize_report choose(pc_context *context, const pc_mesh *mesh) {
    const pc_voxelize_options options = {.voxels = PC_VOXELS_AUTO};
    pc_grid grid = {0};
    pc_voxelize_report report = {0};
    assert_ok(context, pc_voxelize(context, mesh, &options, &grid, &report));
    assert_true(report.voxels >= PC_VOXELS_FLOOR && report.voxels <= PC_VOXELS_CEILING);
    assert_true(report.cell_size == grid.cell_size);
    assert_int_equal(report.samples, grid.sample_count);

    // The grid is that of the number spelled out.
    pc_grid same = {0};
    const pc_voxelize_options spelled = {.voxels = report.voxels};
    assert_ok(context, pc_voxelize(context, mesh, &spelled, &same, NULL));
    assert_true(same.cell_size == grid.cell_size);
    assert_int_equal(same.sample_count, grid.sample_count);
    assert_memory_equal(same.samples, grid.samples, grid.sample_count * sizeof(uint64_t));
    assert_memory_equal(same.values, grid.values, grid.sample_count * sizeof(float));
    pc_grid_free(context, &same);
    pc_grid_free(context, &grid);
    return report;
}

// The lattice sees an opening at more than 2 voxels, at 2 + sqrt(2) for certain; then one level may
// pass to the next, one to the third of the run that agrees, and one accident is overlooked.
static void assert_fits(const pc_voxelize_report *report, double width, uint64_t tunnels) {
    static const double step = 1.28; // the largest from level to level
    assert_int_equal(report->tunnels, tunnels);
    assert_true(report->narrowest_opening < step * width);
    assert_true(width / report->cell_size > 2.0 * step);
    if (report->voxels > PC_VOXELS_FLOOR) {
        const double most = (2.0 + sqrt(2.0)) * step * step;
        assert_true(report->narrowest_opening > 2.0 * width / most);
        assert_true(width / report->cell_size < most * step * step);
    }
}

static void turn(pc_mesh *mesh, double angle, const double offset[3]) {
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        double *p = &mesh->positions[3 * v];
        const double x = cos(angle) * p[0] - sin(angle) * p[1];
        const double y = sin(angle) * p[0] + cos(angle) * p[1];
        p[0] = x + offset[0];
        p[1] = cos(angle) * y - sin(angle) * p[2] + offset[1];
        p[2] = sin(angle) * y + cos(angle) * p[2] + offset[2];
    }
}

static void narrow_tubes_ask_for_finer_voxels(void **state) {
    (void)state;
    static const double diameters[] = {0.4, 0.2, 0.11, 0.08, 0.06, 0.05, 0.045};
    pc_context *context = test_context(2);
    uint32_t finest = 0;
    for (size_t i = 0; i < sizeof(diameters) / sizeof(diameters[0]); ++i) {
        for (size_t place = 0; place < 3; ++place) {
            pc_mesh tube = test_tube(context, 24, 8, 0.5 * diameters[i], 1.0);
            const double offset[3] = {0.013 * (double)place, -7.0, 0.3 * (double)place};
            turn(&tube, 0.45 * (double)place, offset);
            const pc_voxelize_report report = choose(context, &tube);
            assert_fits(&report, diameters[i], 1);
            assert_true(report.layer_gap == 0.0);
            finest = report.voxels > finest ? report.voxels : finest;
            pc_mesh_free(context, &tube);
        }
    }
    assert_true(finest > 64);

    // Narrower than two voxels at the ceiling: nothing to be gained.
    pc_mesh wire = test_tube(context, 24, 8, 0.005, 1.0);
    const pc_voxelize_report report = choose(context, &wire);
    assert_int_equal(report.voxels, PC_VOXELS_FLOOR);
    assert_int_equal(report.tunnels, 0);
    pc_mesh_free(context, &wire);
    pc_context_destroy(context);
}

static void narrow_slits_ask_for_finer_voxels(void **state) {
    (void)state;
    static const double widths[] = {0.3, 0.1, 0.06, 0.05, 0.045};
    pc_context *context = test_context(2);
    for (size_t i = 0; i < sizeof(widths) / sizeof(widths[0]); ++i) {
        // A 3 by 3 frame: the middle is open.
        pc_mesh frame = test_sheet(context, 3, 3, 1.0, 1.0);
        const double x[4] = {0.0, 0.5 - 0.5 * widths[i], 0.5 + 0.5 * widths[i], 1.0};
        const double y[4] = {0.0, 0.2, 0.8, 1.0};
        for (size_t v = 0; v < frame.vertex_count; ++v) {
            frame.positions[3 * v] = x[v % 4];
            frame.positions[3 * v + 1] = y[v / 4];
        }
        memmove(&frame.triangles[24], &frame.triangles[30], 24 * sizeof(uint32_t));
        frame.triangle_count = 16;
        const pc_voxelize_report report = choose(context, &frame);
        assert_fits(&report, widths[i], 1);
        pc_mesh_free(context, &frame);
    }
    pc_context_destroy(context);
}

// Two tubes inside each other, like a lining: their gap is no opening, however wide it is, but the
// narrow inside is.
static void layers_are_not_taken_apart(void **state) {
    (void)state;
    static const double gaps[] = {0.002, 0.006, 0.012, 0.02, 0.03};
    static const double radii[] = {0.3, 0.04};
    const double nowhere[3] = {0};
    pc_context *context = test_context(2);
    for (size_t r = 0; r < 2; ++r) {
        for (size_t i = 0; i < sizeof(gaps) / sizeof(gaps[0]); ++i) {
            pc_mesh inner = test_tube(context, 48, 8, radii[r], 1.0);
            pc_mesh outer = test_tube(context, 48, 8, radii[r] + gaps[i], 1.0);
            pc_mesh both = test_union(context, &inner, &outer, nowhere);
            const pc_voxelize_report report = choose(context, &both);
            assert_int_equal(report.tunnels, 1);
            // Two voxels are more than the gap.
            assert_true(gaps[i] < 2.0 * report.cell_size);
            if (gaps[i] > 2.6 / PC_VOXELS_CEILING) {
                assert_close(report.layer_gap / gaps[i], 1.0, 0.4);
            } else if (gaps[i] < 1.4 / PC_VOXELS_CEILING) {
                assert_true(report.layer_gap == 0.0);
            }
            if (r == 0) {
                assert_int_equal(report.voxels, PC_VOXELS_FLOOR);
            } else {
                assert_fits(&report, 2.0 * radii[r], 1);
            }
            pc_mesh_free(context, &inner);
            pc_mesh_free(context, &outer);
            pc_mesh_free(context, &both);
        }
    }
    pc_context_destroy(context);
}

static void thin_parts_need_no_finer_voxels(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    for (size_t i = 0; i < 4; ++i) {
        pc_mesh ribbon = test_sheet(context, 20, 1, 1.0, pow(10.0, -2.0 - (double)i));
        const double offset[3] = {0.2, 0.013 * (double)i, 0.0};
        turn(&ribbon, 0.3 * (double)i, offset);
        const pc_voxelize_report report = choose(context, &ribbon);
        assert_int_equal(report.voxels, PC_VOXELS_FLOOR);
        assert_int_equal(report.tunnels, 0);
        pc_mesh_free(context, &ribbon);
    }
    pc_context_destroy(context);
}

// Nothing persists in random triangles.
static void a_crumple_gets_the_floor(void **state) {
    (void)state;
    const double sides[3] = {1, 1, 1};
    pc_context *context = test_context(2);
    pc_mesh mesh = soup(context, 300, 11, sides, 0.0);
    const pc_voxelize_report report = choose(context, &mesh);
    assert_int_equal(report.voxels, PC_VOXELS_FLOOR);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

static void the_choice_does_not_depend_on_unit_or_threads(void **state) {
    (void)state;
    static const uint32_t thread_counts[] = {1, 2, 3, 8};
    pc_voxelize_report first = {0};
    for (size_t i = 0; i < 4; ++i) {
        pc_context *context = test_context(thread_counts[i]);
        pc_mesh tube = test_tube(context, 24, 8, 0.025, 1.0);
        const pc_voxelize_report report = choose(context, &tube);
        assert_true(i == 0 || memcmp(&report, &first, sizeof(report)) == 0);
        first = report;
        for (size_t k = 0; k < 3 * tube.vertex_count; ++k) {
            tube.positions[k] *= 1024.0; // exact
        }
        const pc_voxelize_report larger = choose(context, &tube);
        assert_int_equal(larger.voxels, report.voxels);
        assert_true(larger.narrowest_opening == 1024.0 * report.narrowest_opening);
        pc_mesh_free(context, &tube);
        pc_context_destroy(context);
    }
    assert_true(first.voxels > PC_VOXELS_FLOOR);
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
    static const uint32_t voxels[] = {1, 3, 1025};
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
    const uint32_t corner = mesh.triangles[4];
    mesh.triangles[4] = (uint32_t)mesh.vertex_count;
    assert_int_equal(pc_voxelize(context, &mesh, NULL, &grid, NULL), PC_ERROR_INVALID_ARGUMENT);
    mesh.triangles[4] = corner;
    assert_ok(context, pc_voxelize(context, &mesh, NULL, &grid, NULL));
    assert_int_equal(pc_voxelize(context, &mesh, NULL, &grid, NULL), PC_ERROR_INVALID_ARGUMENT);
    pc_grid_free(context, &grid);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

// Counts the reports, which must ascend, and cancels at the last one that is wanted.
typedef struct witness {
    double fraction;
    size_t calls, wanted;
} witness;

static bool watch(void *user, const char *stage, double fraction) {
    witness *w = user;
    assert_string_equal(stage, "voxelize");
    assert_true(fraction >= w->fraction && fraction <= 1.0);
    w->fraction = fraction;
    return ++w->calls < w->wanted;
}

static pc_status voxelize_watched(witness *w, pc_grid *grid) {
    const pc_voxelize_options options = {.voxels = PC_VOXELS_AUTO};
    const pc_context_options watching = {.threads = 2, .progress = watch, .user = w};
    pc_context *context = NULL;
    assert_int_equal(pc_context_create(&watching, &context), PC_OK);
    pc_mesh mesh = test_tube(context, 24, 8, 0.02, 1.0);
    const pc_status status = pc_voxelize(context, &mesh, &options, grid, NULL);
    if (status == PC_OK) {
        pc_grid_free(context, grid);
    }
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
    return status;
}

static void auto_reports_progress_and_can_be_cancelled(void **state) {
    (void)state;
    pc_grid grid = {0};
    witness all = {.wanted = SIZE_MAX};
    assert_int_equal(voxelize_watched(&all, &grid), PC_OK);
    assert_true(all.calls >= 9);
    for (size_t wanted = 1; wanted <= all.calls; wanted += 2) {
        witness some = {.wanted = wanted};
        assert_int_equal(voxelize_watched(&some, &grid), PC_ERROR_CANCELLED);
        assert_int_equal(some.calls, wanted);
        assert_empty(&grid);
    }
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
    const pc_voxelize_options *options = *state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    pc_mesh mesh = sheet(context, 2, 1.0, 0.0, 0.1);
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        pc_grid grid = {0};
        s.status = pc_voxelize(context, &mesh, options, &grid, NULL);
        if (s.status != PC_OK) {
            assert_empty(&grid);
        }
        pc_grid_free(context, &grid);
    }
    assert_true(s.failures > 8);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
    assert_int_equal(counter.live, 0);
}

int main(void) {
    pc_voxelize_options automatic = {.voxels = PC_VOXELS_AUTO};
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(soups_equal_brute_force),
        cmocka_unit_test(dense_sheet_equals_brute_force),
        cmocka_unit_test(flat_sheet_lies_between_lattice_planes),
        cmocka_unit_test(lattice_has_the_promised_size),
        cmocka_unit_test(cells_of_the_iso_surface_are_complete),
        cmocka_unit_test(scale_is_a_unit),
        cmocka_unit_test(cost_grows_with_the_area),
        cmocka_unit_test(threads_do_not_change_the_result),
        cmocka_unit_test(narrow_tubes_ask_for_finer_voxels),
        cmocka_unit_test(narrow_slits_ask_for_finer_voxels),
        cmocka_unit_test(layers_are_not_taken_apart),
        cmocka_unit_test(thin_parts_need_no_finer_voxels),
        cmocka_unit_test(a_crumple_gets_the_floor),
        cmocka_unit_test(the_choice_does_not_depend_on_unit_or_threads),
        cmocka_unit_test(bad_input_is_refused),
        cmocka_unit_test(cancelling_leaves_nothing_behind),
        cmocka_unit_test(auto_reports_progress_and_can_be_cancelled),
        cmocka_unit_test(lack_of_memory_leaves_nothing_behind),
        cmocka_unit_test_prestate(lack_of_memory_leaves_nothing_behind, &automatic),
    };
    return cmocka_run_group_tests_name("voxelize", tests, NULL, NULL);
}
