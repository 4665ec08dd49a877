#include <stdlib.h>

#include "geometry/triangle_distance.h"
#include "geometry/topology.h"
#include "support/memory.h"
#include "support/obj.h"
#include "support/shapes.h"

// Equation (1) written down again without any acceleration.
typedef struct reference {
    pci_scratch scratch;
    pci_topology topology;
    const pc_mesh *surface;
    double lambda;
} reference;

static reference reference_begin(pc_context *context, const pc_mesh *surface,
                                 const pc_mesh *isosurface, double lambda) {
    reference r = {.scratch = pci_scratch_begin(context), .surface = surface, .lambda = lambda};
    assert_true(pci_topology_build(&r.scratch, isosurface, &r.topology));
    return r;
}

static double reference_nearest(const pc_mesh *surface, const double v[3], double nearest[3]) {
    double best = INFINITY;
    for (size_t t = 0; t < surface->triangle_count; ++t) {
        const double *corner[3];
        double weight[3];
        for (size_t c = 0; c < 3; ++c) {
            corner[c] = &surface->positions[3 * (size_t)surface->triangles[3 * t + c]];
        }
        const double square =
            pci_triangle_squared_distance(v, corner[0], corner[1], corner[2], weight);
        if (square < best) {
            best = square;
            for (size_t k = 0; k < 3; ++k) {
                nearest[k] =
                    weight[0] * corner[0][k] + weight[1] * corner[1][k] + weight[2] * corner[2][k];
            }
        }
    }
    return best;
}

static void reference_laplacian(const reference *r, const double *v, size_t i, double out[3]) {
    const size_t from = r->topology.ring_offsets[i], to = r->topology.ring_offsets[i + 1];
    for (size_t k = 0; k < 3; ++k) {
        double mean = 0.0;
        for (size_t n = from; n < to; ++n) {
            mean += v[3 * (size_t)r->topology.ring[n] + k] / (double)(to - from);
        }
        out[k] = v[3 * i + k] - mean;
    }
}

// Terms of the energy that depend on vertex i.
static double reference_local_energy(const reference *r, const double *v, size_t i) {
    double nearest[3], laplacian[3];
    double energy = reference_nearest(r->surface, &v[3 * i], nearest);
    reference_laplacian(r, v, i, laplacian);
    energy += r->lambda * pci_dot(laplacian, laplacian);
    for (size_t n = r->topology.ring_offsets[i]; n < r->topology.ring_offsets[i + 1]; ++n) {
        reference_laplacian(r, v, r->topology.ring[n], laplacian);
        energy += r->lambda * pci_dot(laplacian, laplacian);
    }
    return energy;
}

static double reference_energy(const reference *r, const pc_mesh *mesh, double cell_size) {
    double energy = 0.0;
    for (size_t i = 0; i < mesh->vertex_count; ++i) {
        double nearest[3], laplacian[3];
        energy += reference_nearest(r->surface, &mesh->positions[3 * i], nearest);
        reference_laplacian(r, mesh->positions, i, laplacian);
        energy += r->lambda * pci_dot(laplacian, laplacian);
    }
    return energy / ((double)mesh->vertex_count * cell_size * cell_size);
}

// A bumpy shell one cell away from a box; not symmetric, so nothing cancels by chance.
#define CELL 0.4
static void make_case(pc_context *context, pc_mesh *surface, pc_mesh *isosurface) {
    *surface = shape_box(context, 3, 2, 1);
    *isosurface = shape_box(context, 9, 7, 5);
    for (size_t v = 0; v < isosurface->vertex_count; ++v) {
        double *p = &isosurface->positions[3 * v];
        static const double size[3] = {9.0, 7.0, 5.0}, inner[3] = {3.0, 2.0, 1.0};
        for (size_t k = 0; k < 3; ++k) {
            p[k] = p[k] / size[k] * (inner[k] + 2.0 * CELL) - CELL;
            p[k] += 0.1 * CELL * (pci_random(5, k, v) - 0.5);
        }
    }
}

static void vector_adam_starts_along_the_gradient(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_mesh surface, isosurface, projected = {0};
    make_case(context, &surface, &isosurface);
    pc_project_options options;
    pc_record_set_defaults(&pc_project_options_record, &options);
    options.projection_solver = PC_PROJECT_VECTOR_ADAM;
    options.projection_iterations = 1;
    options.lambda_laplacian = 0.7;
    assert_ok(context,
              pc_project(context, &surface, &isosurface, CELL, &options, &projected, NULL));

    // After one step the moments are the gradient itself: v moves by rate * g / |g|.
    reference r = reference_begin(context, &surface, &isosurface, options.lambda_laplacian);
    for (size_t i = 0; i < isosurface.vertex_count; ++i) {
        double g[3];
        for (size_t k = 0; k < 3; ++k) {
            double *x = &isosurface.positions[3 * i + k];
            const double value = *x, h = 1e-6;
            *x = value + h;
            const double above = reference_local_energy(&r, isosurface.positions, i);
            *x = value - h;
            const double below = reference_local_energy(&r, isosurface.positions, i);
            *x = value;
            g[k] = (above - below) / (2.0 * h);
        }
        const double rate = options.projection_step * CELL;
        for (size_t k = 0; k < 3; ++k) {
            assert_close(projected.positions[3 * i + k],
                         isosurface.positions[3 * i + k] - rate * g[k] / pci_norm(g), 1e-6 * rate);
        }
    }
    pci_scratch_end(&r.scratch);
    pc_mesh_free(context, &surface);
    pc_mesh_free(context, &isosurface);
    pc_mesh_free(context, &projected);
    pc_context_destroy(context);
}

static void cholesky_step_solves_the_normal_equations(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_mesh surface, isosurface, projected = {0};
    make_case(context, &surface, &isosurface);
    pc_project_options options;
    pc_record_set_defaults(&pc_project_options_record, &options);
    options.projection_solver = PC_PROJECT_CHOLESKY;
    options.projection_iterations = 1;
    options.lambda_laplacian = 3.0;
    assert_ok(context,
              pc_project(context, &surface, &isosurface, CELL, &options, &projected, NULL));

    // v - p + lambda L^T L v = 0 with p nearest to the start.
    reference r = reference_begin(context, &surface, &isosurface, options.lambda_laplacian);
    for (size_t i = 0; i < isosurface.vertex_count; ++i) {
        double p[3], own[3], other[3];
        reference_nearest(&surface, &isosurface.positions[3 * i], p);
        reference_laplacian(&r, projected.positions, i, own);
        for (size_t n = r.topology.ring_offsets[i]; n < r.topology.ring_offsets[i + 1]; ++n) {
            const uint32_t j = r.topology.ring[n];
            reference_laplacian(&r, projected.positions, j, other);
            for (size_t k = 0; k < 3; ++k) {
                own[k] -= other[k] /
                          (double)(r.topology.ring_offsets[j + 1] - r.topology.ring_offsets[j]);
            }
        }
        for (size_t k = 0; k < 3; ++k) {
            assert_close(projected.positions[3 * i + k] - p[k] + options.lambda_laplacian * own[k],
                         0.0, 1e-12);
        }
    }
    pci_scratch_end(&r.scratch);
    pc_mesh_free(context, &surface);
    pc_mesh_free(context, &isosurface);
    pc_mesh_free(context, &projected);
    pc_context_destroy(context);
}

static void energy_falls_and_the_report_agrees(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_mesh surface, isosurface;
    make_case(context, &surface, &isosurface);
    reference r = reference_begin(context, &surface, &isosurface, 1.0);
    const double before = reference_energy(&r, &isosurface, CELL);
    for (uint32_t solver = 0; solver < 3; ++solver) {
        double previous = before;
        for (uint32_t iterations = 1; iterations <= 6; ++iterations) {
            pc_project_options options;
            pc_project_report report;
            pc_mesh projected = {0};
            pc_record_set_defaults(&pc_project_options_record, &options);
            options.projection_solver = solver;
            options.projection_iterations = iterations;
            assert_ok(context, pc_project(context, &surface, &isosurface, CELL, &options,
                                          &projected, &report));
            double mean = 0.0, largest = 0.0;
            for (size_t i = 0; i < projected.vertex_count; ++i) {
                double nearest[3];
                const double distance =
                    sqrt(reference_nearest(&surface, &projected.positions[3 * i], nearest)) / CELL;
                mean += distance / (double)projected.vertex_count;
                largest = fmax(largest, distance);
            }
            assert_close(report.energy_before, before, 1e-12 * before);
            assert_close(report.energy_after, reference_energy(&r, &projected, CELL), 1e-12);
            assert_close(report.mean_distance, mean, 1e-12);
            assert_close(report.max_distance, largest, 1e-12);
            assert_true(report.energy_after < previous);
            assert_int_equal(report.iterations, iterations);
            assert_int_equal(projected.vertex_count, isosurface.vertex_count);
            assert_int_equal(projected.triangle_count, isosurface.triangle_count);
            assert_memory_equal(projected.triangles, isosurface.triangles,
                                3 * projected.triangle_count * sizeof(uint32_t));
            previous = report.energy_after;
            pc_mesh_free(context, &projected);
        }
    }
    pci_scratch_end(&r.scratch);
    pc_mesh_free(context, &surface);
    pc_mesh_free(context, &isosurface);
    pc_context_destroy(context);
}

static pc_project_report run_solver(pc_context *context, const pc_mesh *surface,
                                    const pc_mesh *isosurface, uint32_t solver,
                                    uint32_t iterations) {
    pc_mesh projected = {0};
    pc_project_options options;
    pc_project_report report;
    pc_record_set_defaults(&pc_project_options_record, &options);
    options.projection_solver = solver;
    options.projection_iterations = iterations;
    assert_ok(context,
              pc_project(context, surface, isosurface, CELL, &options, &projected, &report));
    pc_mesh_free(context, &projected);
    return report;
}

static void conjugate_gradients_follow_cholesky(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_mesh surface, isosurface;
    make_case(context, &surface, &isosurface);
    static const double lambdas[] = {0.1, 1.0, 30.0, 1000.0};
    for (size_t i = 0; i < 4; ++i) {
        double energy[3];
        for (uint32_t solver = PC_PROJECT_CHOLESKY; solver <= PC_PROJECT_CONJUGATE_GRADIENTS;
             ++solver) {
            pc_mesh projected = {0};
            pc_project_options options;
            pc_project_report report;
            pc_record_set_defaults(&pc_project_options_record, &options);
            options.projection_solver = solver;
            options.projection_iterations = 20;
            options.lambda_laplacian = lambdas[i];
            assert_ok(context, pc_project(context, &surface, &isosurface, CELL, &options,
                                          &projected, &report));
            energy[solver] = report.energy_after;
            pc_mesh_free(context, &projected);
        }
        assert_close(energy[2], energy[1], 0.005 * energy[1]);
    }
    pc_mesh_free(context, &surface);
    pc_mesh_free(context, &isosurface);
    pc_context_destroy(context);
}

static void alternation_stops_when_it_gains_little(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_mesh surface, isosurface;
    make_case(context, &surface, &isosurface);
    for (uint32_t solver = PC_PROJECT_CHOLESKY; solver <= PC_PROJECT_CONJUGATE_GRADIENTS;
         ++solver) {
        const pc_project_report end = run_solver(context, &surface, &isosurface, solver, 10000);
        const uint32_t last = (uint32_t)end.iterations;
        assert_true(last > 2 && last < 10000);
        const double before =
            run_solver(context, &surface, &isosurface, solver, last - 1).energy_after;
        const double earlier =
            run_solver(context, &surface, &isosurface, solver, last - 2).energy_after;
        assert_true(end.energy_after <= before && end.energy_after >= 0.995 * before);
        assert_true(before < 0.995 * earlier);
    }
    pc_mesh_free(context, &surface);
    pc_mesh_free(context, &isosurface);
    pc_context_destroy(context);
}

static void without_laplacian_every_vertex_lands_on_the_surface(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_mesh surface, isosurface, projected = {0};
    make_case(context, &surface, &isosurface);
    pc_project_options options;
    pc_project_report report;
    pc_record_set_defaults(&pc_project_options_record, &options);
    options.lambda_laplacian = 0.0;
    assert_ok(context,
              pc_project(context, &surface, &isosurface, CELL, &options, &projected, &report));
    assert_true(report.max_distance < 1e-12);
    assert_true(report.energy_after < 1e-20);
    pc_mesh_free(context, &surface);
    pc_mesh_free(context, &isosurface);
    pc_mesh_free(context, &projected);
    pc_context_destroy(context);
}

// A sphere around a sphere ends on it: what is left is the shrinkage of the Laplacian.
static void sphere_lands_on_sphere(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_mesh surface = shape_sphere(context, 24, 1.0), isosurface = shape_sphere(context, 16, 1.1);
    for (uint32_t solver = 0; solver < 3; ++solver) {
        pc_mesh projected = {0};
        pc_project_options options;
        pc_project_report report;
        pc_record_set_defaults(&pc_project_options_record, &options);
        options.projection_solver = solver;
        assert_ok(context,
                  pc_project(context, &surface, &isosurface, 0.1, &options, &projected, &report));
        assert_true(report.energy_after < 0.01 * report.energy_before);
        assert_true(report.mean_distance < 0.02);
        for (size_t v = 0; v < projected.vertex_count; ++v) {
            assert_close(pci_norm(&projected.positions[3 * v]), 1.0, 0.01);
        }
        pc_mesh_free(context, &projected);
    }
    pc_mesh_free(context, &surface);
    pc_mesh_free(context, &isosurface);
    pc_context_destroy(context);
}

// What makes conjugate gradients the default: lower energy and no more inverted triangles.
static size_t inverted_triangles(const pc_mesh *before, const pc_mesh *after) {
    size_t count = 0;
    for (size_t t = 0; t < before->triangle_count; ++t) {
        double normal[2][3];
        for (size_t m = 0; m < 2; ++m) {
            const double *corner[3];
            double ab[3], ac[3];
            for (size_t c = 0; c < 3; ++c) {
                corner[c] =
                    (m == 0 ? before : after)->positions + 3 * (size_t)before->triangles[3 * t + c];
            }
            pci_sub(corner[1], corner[0], ab);
            pci_sub(corner[2], corner[0], ac);
            pci_cross(ab, ac, normal[m]);
        }
        count += pci_dot(normal[0], normal[1]) < 0.0;
    }
    return count;
}

static void default_beats_vector_adam_on_garments(void **state) {
    (void)state;
    static const char *const files[] = {SAMPLE_DIR "/makehuman_skirthelper.obj",
                                        SAMPLE_DIR "/makehuman_fedora.obj",
                                        SAMPLE_DIR "/dedo_apron_2_dense.obj"};
    pc_context *context = test_context(2);
    for (size_t i = 0; i < sizeof(files) / sizeof(files[0]); ++i) {
        pc_mesh raw = {0};
        assert_true(test_read_obj(context, files[i], &raw));
        const pc_visual_arrays arrays = {.vertex_count = raw.vertex_count,
                                         .positions = raw.positions,
                                         .triangle_count = raw.triangle_count,
                                         .triangles = raw.triangles};
        pc_asset asset = {0};
        assert_ok(context, pc_visual_create(context, &arrays, &asset.visual, NULL));
        pc_options options = pc_default_options();
        options.voxelize.voxels = 32;
        for (pc_stage stage = PC_STAGE_VOXELIZE; stage <= PC_STAGE_PROJECT; ++stage) {
            assert_ok(context, pc_run_stage(context, stage, &options, &asset, NULL));
        }
        const double energy = asset.reports.project.energy_after;
        const size_t inverted = inverted_triangles(&asset.isosurface, &asset.projected);
        options.project.projection_solver = PC_PROJECT_VECTOR_ADAM;
        assert_ok(context, pc_run_stage(context, PC_STAGE_PROJECT, &options, &asset, NULL));
        assert_true(energy < asset.reports.project.energy_after);
        assert_true(inverted <= inverted_triangles(&asset.isosurface, &asset.projected));
        assert_true(energy < 0.02 && asset.reports.project.mean_distance < 0.04);
        pc_asset_free(context, &asset);
        pc_mesh_free(context, &raw);
    }
    pc_context_destroy(context);
}

static void same_bytes_at_any_thread_count(void **state) {
    (void)state;
    static const uint32_t threads[] = {1, 2, 3, 8, 1};
    for (uint32_t solver = 0; solver < 3; ++solver) {
        double *first = NULL;
        pc_project_report first_report;
        for (size_t t = 0; t < sizeof(threads) / sizeof(threads[0]); ++t) {
            pc_context *context = test_context(threads[t]);
            pc_mesh surface = shape_sphere(context, 12, 1.0);
            pc_mesh isosurface = shape_sphere(context, 20, 1.1), projected = {0};
            pc_project_options options;
            pc_project_report report;
            pc_record_set_defaults(&pc_project_options_record, &options);
            options.projection_solver = solver;
            options.projection_iterations = 5;
            assert_ok(context, pc_project(context, &surface, &isosurface, 0.1, &options, &projected,
                                          &report));
            const size_t bytes = 3 * projected.vertex_count * sizeof(double);
            if (first == NULL) {
                first = malloc(bytes);
                assert_non_null(first);
                memcpy(first, projected.positions, bytes);
                first_report = report;
            }
            assert_memory_equal(first, projected.positions, bytes);
            assert_memory_equal(&first_report, &report, sizeof(report));
            pc_mesh_free(context, &surface);
            pc_mesh_free(context, &isosurface);
            pc_mesh_free(context, &projected);
            pc_context_destroy(context);
        }
        free(first);
    }
}

static void bad_arguments_leave_the_output_empty(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh box = shape_box(context, 2, 2, 2), projected = {0}, none = {0};
    static const double cell_sizes[] = {0.0, -1.0, NAN, INFINITY, 1e-6};
    for (size_t i = 0; i < 5; ++i) {
        assert_int_equal(pc_project(context, &box, &box, cell_sizes[i], NULL, &projected, NULL),
                         PC_ERROR_INVALID_ARGUMENT);
    }
    assert_int_equal(pc_project(context, &box, &none, 1.0, NULL, &projected, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_project(context, NULL, &box, 1.0, NULL, &projected, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_project(context, &box, &box, 1.0, NULL, NULL, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    pc_mesh used = {.vertex_count = 1};
    assert_int_equal(pc_project(context, &box, &box, 1.0, NULL, &used, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    const uint32_t corner = box.triangles[5];
    box.triangles[5] = (uint32_t)box.vertex_count;
    assert_int_equal(pc_project(context, &box, &box, 1.0, NULL, &projected, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    box.triangles[5] = corner;
    pc_project_options options;
    pc_record_set_defaults(&pc_project_options_record, &options);
    options.lambda_laplacian = -1.0;
    assert_int_equal(pc_project(context, &box, &box, 1.0, &options, &projected, NULL),
                     PC_ERROR_INVALID_OPTIONS);
    assert_non_null(strstr(pc_context_error(context)->message, "lambda_laplacian"));
    assert_null(projected.positions);
    assert_int_equal(projected.vertex_count, 0);
    pc_mesh_free(context, &box);
    pc_context_destroy(context);
}

static bool cancel_second_call(void *user, const char *stage, double fraction) {
    (void)stage;
    (void)fraction;
    return ++*(int *)user < 2;
}

static void cancelling_ends_the_call(void **state) {
    (void)state;
    for (uint32_t solver = 0; solver < 3; ++solver) {
        int calls = 0;
        const pc_context_options settings = {
            .threads = 1, .progress = cancel_second_call, .user = &calls};
        pc_context *context = NULL;
        assert_int_equal(pc_context_create(&settings, &context), PC_OK);
        pc_mesh box = shape_box(context, 2, 2, 2), projected = {0};
        pc_project_options options;
        pc_record_set_defaults(&pc_project_options_record, &options);
        options.projection_solver = solver;
        options.projection_iterations = 50;
        assert_int_equal(pc_project(context, &box, &box, 1.0, &options, &projected, NULL),
                         PC_ERROR_CANCELLED);
        assert_int_equal(calls, 2);
        assert_null(projected.positions);
        pc_mesh_free(context, &box);
        pc_context_destroy(context);
    }
}

static void survives_memory_failure(void **state) {
    (void)state;
    for (uint32_t solver = 0; solver < 3; ++solver) {
        counting_allocator counter = {0};
        pc_context *context = counting_context(&counter);
        pc_mesh box = shape_box(context, 2, 2, 2);
        pc_project_options options;
        pc_record_set_defaults(&pc_project_options_record, &options);
        options.projection_solver = solver;
        options.projection_iterations = 2;
        starvation s = {.counter = &counter};
        while (starves(&s)) {
            pc_mesh projected = {0};
            s.status = pc_project(context, &box, &box, 1.0, &options, &projected, NULL);
            assert_true(s.status == PC_OK ||
                        (projected.positions == NULL && projected.vertex_count == 0));
            pc_mesh_free(context, &projected);
        }
        assert_true(s.failures > 5);
        pc_mesh_free(context, &box);
        pc_context_destroy(context);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(vector_adam_starts_along_the_gradient),
        cmocka_unit_test(cholesky_step_solves_the_normal_equations),
        cmocka_unit_test(energy_falls_and_the_report_agrees),
        cmocka_unit_test(conjugate_gradients_follow_cholesky),
        cmocka_unit_test(alternation_stops_when_it_gains_little),
        cmocka_unit_test(without_laplacian_every_vertex_lands_on_the_surface),
        cmocka_unit_test(sphere_lands_on_sphere),
        cmocka_unit_test(default_beats_vector_adam_on_garments),
        cmocka_unit_test(same_bytes_at_any_thread_count),
        cmocka_unit_test(bad_arguments_leave_the_output_empty),
        cmocka_unit_test(cancelling_ends_the_call),
        cmocka_unit_test(survives_memory_failure),
    };
    return cmocka_run_group_tests_name("project", tests, NULL, NULL);
}
