#include "support/test.h"

#include "stages/simulate/simulate_internal.h"
#include "support/fixture.h"
#include "support/obj.h"

// ---- meshes -------------------------------------------------------------------------------------

// A square cloth of (n + 1)^2 vertices in the xy plane, side 1, vertex (i, j) at index j (n + 1) +
// i.
static void make_square(pc_context *context, uint32_t n, pc_mesh *mesh) {
    const uint32_t row = n + 1;
    mesh->vertex_count = (size_t)row * row;
    mesh->triangle_count = 2 * (size_t)n * n;
    mesh->positions = PCI_ALLOCATE(context, double, 3 * mesh->vertex_count);
    mesh->triangles = PCI_ALLOCATE(context, uint32_t, 3 * mesh->triangle_count);
    for (uint32_t v = 0; v < row * row; ++v) {
        mesh->positions[3 * v] = (double)(v % row) / n;
        mesh->positions[3 * v + 1] = (double)(v / row) / n;
    }
    uint32_t *at = mesh->triangles;
    for (uint32_t j = 0; j < n; ++j) {
        for (uint32_t i = 0; i < n; ++i) {
            const uint32_t v = j * row + i;
            const uint32_t corners[6] = {v, v + 1, v + row, v + 1, v + row + 1, v + row};
            memcpy(at, corners, sizeof(corners));
            at += 6;
        }
    }
}

static pc_simulate_options default_options(void) {
    pc_simulate_options options;
    pc_record_set_defaults(&pc_simulate_options_record, &options);
    return options;
}

// ---- the step -----------------------------------------------------------------------------------

// Replays a simulation of an independent implementation step by step.
static void replay_fixture(const char *name) {
    pc_context *context = test_context(1);
    char path[512];
    size_t spring_numbers, mass_numbers, wind_numbers, frame_numbers, parameter_numbers;
#define PATH(file) (snprintf(path, sizeof(path), TEST_DATA_DIR "/skinning/%s/" file, name), path)
    double *rows = test_read_numbers(PATH("pbd_springs.csv"), &spring_numbers);
    double *masses = test_read_numbers(PATH("pbd_invmass.csv"), &mass_numbers);
    double *wind = test_read_numbers(PATH("pbd_wind.csv"), &wind_numbers);
    double *frames = test_read_numbers(PATH("frames.f64"), &frame_numbers);
    double *stride = test_read_json_numbers(PATH("expected.json"), "stride", &parameter_numbers);
    assert_int_equal(parameter_numbers, 1);
    pc_mesh mesh = {0};
    assert_true(test_read_obj(context, PATH("proxy.obj"), &mesh));
#undef PATH
    const size_t nv = mesh.vertex_count, steps = wind_numbers / 3;
    const size_t frame_steps = (size_t)stride[0];
    assert_int_equal(mass_numbers, nv);
    assert_int_equal(frame_numbers / (3 * nv), steps / frame_steps);

    pci_spring *springs = calloc(spring_numbers / 4, sizeof(*springs));
    for (size_t s = 0; s < spring_numbers / 4; ++s) {
        springs[s].a = (uint32_t)rows[4 * s];
        springs[s].b = (uint32_t)rows[4 * s + 1];
        springs[s].rest = rows[4 * s + 2];
        springs[s].stiffness = 1.0 - pow(1.0 - rows[4 * s + 3], 10.0);
    }
    pci_cloth cloth = {.vertex_count = nv,
                       .positions = mesh.positions,
                       .velocities = calloc(3 * nv, sizeof(double)),
                       .previous = calloc(3 * nv, sizeof(double)),
                       .forces = calloc(3 * nv, sizeof(double)),
                       .inverse_mass = masses,
                       .triangle_count = mesh.triangle_count,
                       .triangles = mesh.triangles,
                       .time_step = 1.0 / 60.0,
                       .damping = 0.02,
                       .air_density = 1.2,
                       .gravity = {0.0, -9.81, 0.0},
                       .iterations = 10,
                       .substeps = 1};
    pci_scratch scratch = pci_scratch_begin(context);
    assert_true(
        pci_springs_pack(&scratch, springs, spring_numbers / 4, spring_numbers / 4, &cloth));
    double worst = 0.0, worst_first = 0.0;
    for (size_t s = 0; s < steps; ++s) {
        pci_cloth_step(&cloth, &wind[3 * s]);
        if ((s + 1) % frame_steps == 0) {
            const double *frame = &frames[3 * nv * (s / frame_steps)];
            for (size_t k = 0; k < 3 * nv; ++k) {
                const double error = fabs(frame[k] - cloth.positions[k]);
                worst = error > worst || isnan(error) ? error : worst;
            }
            worst_first = s + 1 == frame_steps ? worst : worst_first;
        }
    }
    // The other code guards divisions with 1e-12; the motion amplifies that.
    assert_close(worst_first, 0.0, 1e-11);
    assert_close(worst, 0.0, 1e-9);
    pci_scratch_end(&scratch);
    free(cloth.velocities);
    free(cloth.previous);
    free(cloth.forces);
    free(springs);
    free(rows);
    free(masses);
    free(wind);
    free(frames);
    free(stride);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

static void replays_the_fixtures(void **state) {
    (void)state;
    replay_fixture("tiny");
    replay_fixture("dress796");
    replay_fixture("fedora");
}

// The springs that we build are those of the fixture, which were made by other code.
static void springs_match_the_fixture(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    const char *const folder = TEST_DATA_DIR "/skinning/dress796/";
    char path[512];
    size_t numbers;
    snprintf(path, sizeof(path), "%spbd_springs.csv", folder);
    double *rows = test_read_numbers(path, &numbers);
    pc_mesh mesh = {0};
    snprintf(path, sizeof(path), "%sproxy.obj", folder);
    assert_true(test_read_obj(context, path, &mesh));
    pci_scratch scratch = pci_scratch_begin(context);
    pci_spring *springs = NULL;
    size_t count = 0, edges = 0;
    assert_true(pci_springs_build(&scratch, &mesh, 1.0, 0.2, &springs, &count, &edges));
    assert_int_equal(count, numbers / 4);
    for (size_t r = 0; r < count; ++r) {
        size_t found = 0;
        for (size_t s = 0; s < count; ++s) {
            const uint32_t i = (uint32_t)rows[4 * r], j = (uint32_t)rows[4 * r + 1];
            found += ((springs[s].a == i && springs[s].b == j) ||
                      (springs[s].a == j && springs[s].b == i)) &&
                     fabs(springs[s].rest - rows[4 * r + 2]) <= 1e-15 &&
                     (s < edges) == (springs[s].stiffness > 0.5);
        }
        assert_true(found >= 1);
    }
    pci_scratch_end(&scratch);
    free(rows);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

static void sweeps_compose_to_the_stiffness(void **state) {
    (void)state;
    assert_close(pow(1.0 - pci_sweep_stiffness(0.2, 10), 10.0), 0.8, 1e-15);
    assert_close(pci_sweep_stiffness(1.0, 7), 1.0, 0.0);
    assert_close(pci_sweep_stiffness(0.0, 7), 0.0, 0.0);
}

// Springs and nothing else: momentum stays, and one spring of stiffness 1 reaches its rest length.
static void springs_keep_the_momentum(void **state) {
    (void)state;
    double positions[9] = {0, 0, 0, 2, 0, 0, 0.5, 1.5, 0.3}, velocities[9] = {0, 1, 0, 0, 0, 2};
    double previous[9], forces[9];
    const double inverse_mass[3] = {1.0, 0.25, 2.0};
    const pci_spring springs[3] = {{0, 1, 1.0, 1.0}, {1, 2, 1.0, 0.9375}, {0, 2, 0.7, 0.9999}};
    pc_context *context = test_context(1);
    pci_scratch scratch = pci_scratch_begin(context);
    pci_cloth cloth = {.vertex_count = 3,
                       .positions = positions,
                       .velocities = velocities,
                       .previous = previous,
                       .forces = forces,
                       .inverse_mass = inverse_mass,
                       .time_step = 0.01,
                       .iterations = 4,
                       .substeps = 1};
    assert_true(pci_springs_pack(&scratch, springs, 3, 3, &cloth));
    const double calm[3] = {0};
    for (int step = 0; step < 20; ++step) {
        pci_cloth_step(&cloth, calm);
        for (size_t k = 0; k < 3; ++k) {
            const double momentum =
                velocities[k] + velocities[3 + k] / 0.25 + velocities[6 + k] / 2.0;
            assert_close(momentum, k == 1 ? 1.0 : k == 2 ? 8.0 : 0.0, 1e-11);
        }
    }
    assert_true(pci_springs_pack(&scratch, springs, 1, 1, &cloth));
    pci_cloth_step(&cloth, calm);
    assert_close(sqrt(pci_squared_distance(&positions[0], &positions[3])), 1.0, 1e-15);
    pci_scratch_end(&scratch);
    pc_context_destroy(context);
}

// Springs one after the other, as the plain formula has it.
static void sweep_plainly(const pci_spring *springs, size_t count, const double *inverse_mass,
                          double *x) {
    for (size_t s = 0; s < count; ++s) {
        double *a = &x[3 * (size_t)springs[s].a], *b = &x[3 * (size_t)springs[s].b];
        const double d[3] = {b[0] - a[0], b[1] - a[1], b[2] - a[2]};
        const double square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2] + 1e-300;
        const double change = 1.0 - springs[s].rest / sqrt(square);
        const double mass_a = inverse_mass[springs[s].a], mass_b = inverse_mass[springs[s].b];
        const double share = pci_sweep_stiffness(springs[s].stiffness, 3);
        const double scale = mass_a + mass_b > 0.0 ? share / (mass_a + mass_b) : 0.0;
        for (size_t k = 0; k < 3; ++k) {
            a[k] += scale * mass_a * change * d[k];
            b[k] -= scale * mass_b * change * d[k];
        }
    }
}

// Blocks of springs, by the instructions of any processor, give the bits of the plain formula: with
// lanes left empty by springs that share vertices, held ends, and ends in one place.
static void sweeps_agree_bit_for_bit(void **state) {
    (void)state;
    enum { VERTICES = 40, SPRINGS = 301 };
    double start[3 * VERTICES], plain[3 * VERTICES], inverse_mass[VERTICES];
    pci_spring springs[SPRINGS];
    for (uint64_t k = 0; k < 3 * VERTICES; ++k) {
        start[k] = k < 6 ? 0.5 : pci_random(1, 0, k);
    }
    for (uint64_t v = 0; v < VERTICES; ++v) {
        inverse_mass[v] = v % 5 == 0 ? 0.0 : 0.1 + pci_random(1, 1, v);
    }
    for (uint64_t s = 0; s < SPRINGS; ++s) {
        springs[s].a = s == 0 ? 0 : (uint32_t)(pci_random_bits(2, 0, s) % (VERTICES - 1));
        springs[s].b = springs[s].a + 1;
        springs[s].rest = pci_random(2, 1, s);
        springs[s].stiffness = s % 3 == 0 ? 1.0 : pci_random(2, 2, s);
    }
    memcpy(plain, start, sizeof(plain));
    for (int i = 0; i < 3; ++i) {
        sweep_plainly(springs, SPRINGS, inverse_mass, plain);
    }
    pc_context *context = test_context(1);
    pci_scratch scratch = pci_scratch_begin(context);
    double positions[3 * VERTICES], velocities[3 * VERTICES];
    double previous[3 * VERTICES], forces[3 * VERTICES];
    pci_cloth cloth = {.vertex_count = VERTICES,
                       .positions = positions,
                       .velocities = velocities,
                       .previous = previous,
                       .forces = forces,
                       .inverse_mass = inverse_mass,
                       .time_step = 0.01,
                       .iterations = 3,
                       .substeps = 1};
    assert_true(pci_springs_pack(&scratch, springs, SPRINGS, SPRINGS, &cloth));
    assert_true(cloth.block_count > SPRINGS / PCI_LANES + 1);
    const pci_sweep sweeps[] = {pci_sweep_generic, cloth.sweep};
    for (size_t i = 0; i < 2; ++i) {
        memcpy(positions, start, sizeof(positions));
        memset(velocities, 0, sizeof(velocities));
        cloth.sweep = sweeps[i];
        pci_cloth_step(&cloth, (const double[3]){0.0, 0.0, 0.0});
        assert_memory_equal(positions, plain, sizeof(plain));
    }
    pci_scratch_end(&scratch);
    pc_context_destroy(context);
}

// A free body falls as the explicit scheme says: x_n = -g dt^2 n (n + 1) / 2.
static void free_fall_is_exact(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh mesh = {0};
    make_square(context, 3, &mesh);
    pc_simulate_options options = default_options();
    options.frames = 10;
    options.frame_steps = 2;
    options.pinned_fraction = 0.0;
    options.damping = 0.0;
    options.air_density = 0.0;
    options.garment_size = 0.0;
    options.up_axis = 2;
    pc_motion motion = {0};
    pc_simulate_report report;
    assert_ok(context, pc_simulate(context, &mesh, &options, &motion, &report));
    assert_int_equal(report.pinned, 0);
    for (size_t f = 0; f < motion.frame_count; ++f) {
        const double n = 2.0 * ((double)f + 1.0);
        for (size_t v = 0; v < mesh.vertex_count; ++v) {
            const double *at = &motion.positions[3 * (f * mesh.vertex_count + v)];
            assert_close(at[0], mesh.positions[3 * v], 1e-13);
            assert_close(at[2], -9.81 / 3600.0 * n * (n + 1.0) / 2.0, 1e-12);
        }
    }
    assert_close(report.max_strain, 0.0, 1e-12);
    pc_motion_free(context, &motion);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

// A light rod that swings through a small angle: period 2 pi sqrt(l / g).
static void pendulum_has_its_period(void **state) {
    (void)state;
    double positions[6] = {0, 0, 0, 0.02, -0.9998, 0}, velocities[6] = {0};
    double previous[6], forces[6];
    const double inverse_mass[2] = {0.0, 1.0};
    const pci_spring spring = {0, 1, 1.0, 1.0};
    pci_cloth cloth = {.vertex_count = 2,
                       .positions = positions,
                       .velocities = velocities,
                       .previous = previous,
                       .forces = forces,
                       .inverse_mass = inverse_mass,
                       .time_step = 1e-4,
                       .gravity = {0.0, -9.81, 0.0},
                       .iterations = 1,
                       .substeps = 1};
    const double calm[3] = {0};
    pc_context *context = test_context(1);
    pci_scratch scratch = pci_scratch_begin(context);
    assert_true(pci_springs_pack(&scratch, &spring, 1, 1, &cloth));
    double last = positions[3], crossings[2] = {0};
    size_t found = 0;
    for (int step = 1; found < 2 && step < 100000; ++step) {
        pci_cloth_step(&cloth, calm);
        if (last > 0.0 && positions[3] <= 0.0) {
            crossings[found++] = 1e-4 * ((double)step - positions[3] / (positions[3] - last));
        }
        last = positions[3];
    }
    assert_int_equal(found, 2);
    assert_close(crossings[1] - crossings[0], 6.283185307179586 / sqrt(9.81), 1e-3);
    pci_scratch_end(&scratch);
    pc_context_destroy(context);
}

// Still air brakes a plate that moves along its normal: v' = -air A v / m.
static void wind_acts_along_the_normal(void **state) {
    (void)state;
    double positions[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0}, velocities[9] = {0};
    double previous[9], forces[9];
    const double inverse_mass[3] = {30.0, 30.0, 30.0};
    const uint32_t triangle[3] = {0, 1, 2};
    pci_cloth cloth = {.vertex_count = 3,
                       .positions = positions,
                       .velocities = velocities,
                       .previous = previous,
                       .forces = forces,
                       .inverse_mass = inverse_mass,
                       .triangle_count = 1,
                       .triangles = triangle,
                       .time_step = 0.001,
                       .air_density = 1.2,
                       .iterations = 1,
                       .substeps = 1};
    const double wind[3] = {5.0, -3.0, 2.0};
    double expected = 0.0;
    for (int step = 0; step < 100; ++step) {
        pci_cloth_step(&cloth, wind);
        expected += 0.001 * 1.2 * 0.5 * (2.0 - expected) / 0.1; // mass 0.1 kg
        for (size_t v = 0; v < 3; ++v) {
            assert_close(velocities[3 * v], 0.0, 1e-12);
            assert_close(velocities[3 * v + 1], 0.0, 1e-12);
            assert_close(velocities[3 * v + 2], expected, 1e-12);
        }
    }
}

// ---- the wind -----------------------------------------------------------------------------------

static void wind_is_bounded_and_turns(void **state) {
    (void)state;
    pci_wind wind = pci_wind_begin(7, 6.0);
    double mean[3] = {0}, strongest = 0.0;
    uint64_t gusts = 0;
    for (int step = 0; step < 60000; ++step) {
        double velocity[3];
        const uint64_t gust = wind.gust, begin = wind.gust_end;
        pci_wind_next(&wind, velocity);
        if (wind.gust != gust) {
            ++gusts;
            assert_in_range(wind.gust_end - begin, 20, 40);
            assert_in_range((uint64_t)(1000.0 * pci_norm(wind.target)), 1200, 6000);
        }
        const double speed = pci_norm(velocity);
        strongest = speed > strongest ? speed : strongest;
        for (size_t k = 0; k < 3; ++k) {
            mean[k] += velocity[k] / 60000.0;
        }
    }
    assert_in_range(gusts, 1900, 2100);
    assert_true(strongest > 5.0 && strongest <= 6.6);
    assert_true(pci_norm(mean) < 0.3);
}

// A dozen gusts blow from all sides, whatever the seed: nearer than 65 degrees to each axis.
static void gusts_leave_no_side_out(void **state) {
    (void)state;
    for (uint32_t seed = 0; seed < 1000; ++seed) {
        pci_wind wind = pci_wind_begin(seed, 6.0);
        double nearest[6] = {-1.0, -1.0, -1.0, -1.0, -1.0, -1.0};
        while (wind.gust < 12 || wind.step < wind.gust_end) {
            double velocity[3];
            pci_wind_next(&wind, velocity);
            for (size_t k = 0; k < 6; ++k) {
                const double along = (k < 3 ? 1.0 : -1.0) * wind.target[k % 3];
                nearest[k] = fmax(nearest[k], along / pci_norm(wind.target));
            }
        }
        for (size_t k = 0; k < 6; ++k) {
            assert_true(nearest[k] > cos(65.0 / 57.29577951308232));
        }
    }
}

// ---- the stage ----------------------------------------------------------------------------------

static void holds_the_highest_vertices(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh mesh = {0};
    make_square(context, 10, &mesh); // 121 vertices, 5 % are 6.05, so 7
    pc_simulate_options options = default_options();
    options.frames = 20;
    pc_motion motion = {0};
    pc_simulate_report report;
    assert_ok(context, pc_simulate(context, &mesh, &options, &motion, &report));
    assert_int_equal(report.pinned, 7);
    assert_int_equal(report.stretch_springs, 320);
    assert_int_equal(report.bend_springs, 280);
    assert_int_equal(motion.frame_count, 20);
    assert_close(motion.frame_time, 0.05, 1e-15);
    for (size_t v = 0; v < 121; ++v) {
        // The top row, ties to the smaller index.
        assert_int_equal(motion.pinned[v], v >= 110 && v < 117);
        for (size_t f = 0; f < 20 && motion.pinned[v]; ++f) {
            assert_memory_equal(&motion.positions[3 * (121 * f + v)], &mesh.positions[3 * v],
                                3 * sizeof(double));
        }
    }
    assert_true(report.mean_strain > 0.0 && report.mean_strain < report.p95_strain);
    assert_true(report.p95_strain < report.max_strain && report.max_strain < 1.0);
    assert_true(report.motion_range > 0.01 && report.max_speed > 0.1);
    pc_motion_free(context, &motion);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

// Two squares, the second one below the first: both hang.
static void every_part_hangs(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh square = {0}, mesh = {0};
    make_square(context, 4, &square); // 25 vertices, 5 % are 1.25, so 2; of 50 together 3
    mesh.vertex_count = 50;
    mesh.triangle_count = 64;
    mesh.positions = PCI_ALLOCATE(context, double, 150);
    mesh.triangles = PCI_ALLOCATE(context, uint32_t, 192);
    for (uint32_t k = 0; k < 150; ++k) {
        mesh.positions[k] = square.positions[k % 75] - (k >= 75 && k % 3 == 1 ? 3.0 : 0.0);
    }
    for (uint32_t k = 0; k < 192; ++k) {
        mesh.triangles[k] = square.triangles[k % 96] + (k >= 96 ? 25 : 0);
    }
    pc_simulate_options options = default_options();
    options.frames = 100;
    pc_motion motion = {0};
    pc_simulate_report report;
    assert_ok(context, pc_simulate(context, &mesh, &options, &motion, &report));
    assert_int_equal(report.pinned, 5);
    for (size_t v = 0; v < 50; ++v) {
        assert_int_equal(motion.pinned[v], (v >= 20 && v < 23) || (v >= 45 && v < 47));
    }
    assert_true(report.motion_range < 0.7);
    pc_motion_free(context, &motion);
    pc_mesh_free(context, &mesh);
    pc_mesh_free(context, &square);
    pc_context_destroy(context);
}

// The unit of the file must not matter, and the up axis only turns the picture.
static void scale_and_axis_do_not_matter(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh mesh = {0};
    make_square(context, 6, &mesh);
    pc_simulate_options options = default_options();
    options.frames = 15;
    pc_motion motion = {0}, large = {0};
    assert_ok(context, pc_simulate(context, &mesh, &options, &motion, NULL));
    for (size_t k = 0; k < 3 * mesh.vertex_count; ++k) {
        mesh.positions[k] *= 64.0;
    }
    assert_ok(context, pc_simulate(context, &mesh, &options, &large, NULL));
    for (size_t k = 0; k < 45 * mesh.vertex_count; ++k) {
        assert_close(large.positions[k], 64.0 * motion.positions[k], 1e-12);
    }
    pc_motion_free(context, &large);
    pc_motion_free(context, &motion);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

static void seeds_give_winds(void **state) {
    (void)state;
    pc_motion motions[3] = {{0}};
    pc_context *contexts[3];
    for (size_t i = 0; i < 3; ++i) {
        contexts[i] = test_context(i == 1 ? 8 : 1);
        pc_mesh mesh = {0};
        make_square(contexts[i], 6, &mesh);
        pc_simulate_options options = default_options();
        options.frames = 10;
        options.seed = i == 2 ? 2 : 1;
        assert_ok(contexts[i], pc_simulate(contexts[i], &mesh, &options, &motions[i], NULL));
        pc_mesh_free(contexts[i], &mesh);
    }
    const size_t size = 3 * 10 * 49 * sizeof(double);
    assert_memory_equal(motions[0].positions, motions[1].positions, size);
    assert_memory_not_equal(motions[0].positions, motions[2].positions, size);
    for (size_t i = 0; i < 3; ++i) {
        pc_motion_free(contexts[i], &motions[i]);
        pc_context_destroy(contexts[i]);
    }
}

static bool cancel_at_once(void *user, const char *stage, double fraction) {
    (void)user;
    (void)stage;
    return fraction < 0.3;
}

static void errors_leave_nothing(void **state) {
    (void)state;
    pc_context *context = NULL;
    const pc_context_options context_options = {.threads = 1, .progress = cancel_at_once};
    assert_int_equal(pc_context_create(&context_options, &context), PC_OK);
    pc_mesh mesh = {0};
    make_square(context, 2, &mesh);
    pc_motion motion = {0};
    pc_simulate_options options = default_options();
    assert_int_equal(pc_simulate(context, &mesh, NULL, &motion, NULL), PC_ERROR_CANCELLED);
    assert_null(motion.positions);
    assert_null(motion.pinned);

    options.damping = 1.5;
    assert_int_equal(pc_simulate(context, &mesh, &options, &motion, NULL),
                     PC_ERROR_INVALID_OPTIONS);
    // Coordinates whose squares are no finite numbers.
    options = default_options();
    options.frames = 2;
    options.garment_size = 0.0;
    for (size_t k = 0; k < 27; ++k) {
        mesh.positions[k] *= 1e160;
    }
    assert_int_equal(pc_simulate(context, &mesh, &options, &motion, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_null(motion.positions);
    for (size_t k = 0; k < 27; ++k) {
        mesh.positions[k] /= 1e160;
    }

    mesh.triangles[3] = 9;
    assert_int_equal(pc_simulate(context, &mesh, NULL, &motion, NULL), PC_ERROR_INVALID_ARGUMENT);
    mesh.triangles[3] = 1;
    mesh.positions[4] = NAN;
    assert_int_equal(pc_simulate(context, &mesh, NULL, &motion, NULL), PC_ERROR_INVALID_ARGUMENT);
    memset(mesh.positions, 0, 27 * sizeof(double));
    assert_int_equal(pc_simulate(context, &mesh, NULL, &motion, NULL), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_simulate(context, NULL, NULL, &motion, NULL), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_simulate(context, &mesh, NULL, NULL, NULL), PC_ERROR_INVALID_ARGUMENT);
    uint8_t leftover = 0;
    motion.pinned = &leftover;
    assert_int_equal(pc_simulate(context, &mesh, NULL, &motion, NULL), PC_ERROR_INVALID_ARGUMENT);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(replays_the_fixtures),
        cmocka_unit_test(springs_match_the_fixture),
        cmocka_unit_test(sweeps_compose_to_the_stiffness),
        cmocka_unit_test(springs_keep_the_momentum),
        cmocka_unit_test(sweeps_agree_bit_for_bit),
        cmocka_unit_test(free_fall_is_exact),
        cmocka_unit_test(pendulum_has_its_period),
        cmocka_unit_test(wind_acts_along_the_normal),
        cmocka_unit_test(wind_is_bounded_and_turns),
        cmocka_unit_test(gusts_leave_no_side_out),
        cmocka_unit_test(holds_the_highest_vertices),
        cmocka_unit_test(every_part_hangs),
        cmocka_unit_test(scale_and_axis_do_not_matter),
        cmocka_unit_test(seeds_give_winds),
        cmocka_unit_test(errors_leave_nothing),
    };
    return cmocka_run_group_tests_name("simulate", tests, NULL, NULL);
}
