// Contacts of the cloth with itself, in the simulation stage.
#include "geometry/crossing.h"
#include "proxycloth/simulate.h"
#include "support/memory.h"
#include "support/surfaces.h"
#include "support/test.h"

static pc_simulate_options options_with(double self_contact) {
    pc_simulate_options options;
    pc_record_set_defaults(&pc_simulate_options_record, &options);
    options.frames = 60;
    options.garment_size = 0.0;
    options.self_contact = self_contact;
    return options;
}

// Two sheets of side 1 and 81 vertices, one `gap` behind the other.
static pc_mesh two_sheets(pc_context *context, double gap) {
    const double offset[3] = {0.0, 0.0, gap};
    pc_mesh sheet = test_sheet(context, 8, 8, 1.0, 1.0);
    const pc_mesh both = test_union(context, &sheet, &sheet, offset);
    pc_mesh_free(context, &sheet);
    return both;
}

// The most crossings of a frame.
static uint64_t most_crossings(pc_context *context, const pc_mesh *mesh, const pc_motion *motion) {
    uint64_t most = 0;
    for (size_t f = 0; f < motion->frame_count; ++f) {
        pc_mesh posed = *mesh;
        posed.positions = &motion->positions[3 * motion->vertex_count * f];
        uint64_t count = 0;
        assert_ok(context, pci_count_self_intersections(context, "simulate", &posed, &count));
        most = count > most ? count : most;
    }
    return most;
}

// A curtain that hangs from its upper edge is blown at a sail that is held above and below.
static void blow(pc_context *context, double self_contact, uint32_t dynamics, pc_motion *motion,
                 uint64_t *crossings) {
    pc_mesh mesh = two_sheets(context, 0.25);
    pc_pin pins[2] = {{.kind = PC_PIN_BOX, .minimum = {-9, 0.99, -9}, .maximum = {9, 9, 9}},
                      {.kind = PC_PIN_BOX, .minimum = {-9, -9, 0.2}, .maximum = {9, 0.01, 9}}};
    pc_wind_key winds[3] = {{.velocity = {0.0, 0.0, 8.0}},
                            {.time = 1.5, .velocity = {0.0, 0.0, 8.0}},
                            {.time = 1.6, .velocity = {3.0, 0.0, 5.0}}};
    const pc_scenario scenario = {.wind_count = 3, .winds = winds, .pin_count = 2, .pins = pins};
    const pc_simulate_inputs inputs = {.proxy = &mesh, .scenario = &scenario};
    pc_simulate_options options = options_with(self_contact);
    options.dynamics = dynamics;
    assert_ok(context, pc_simulate_scenario(context, &inputs, &options, motion, NULL));
    *crossings = most_crossings(context, &mesh, motion);
    pc_mesh_free(context, &mesh);
}

static void sheets_stay_on_their_sides(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    for (uint32_t dynamics = 0; dynamics < 2; ++dynamics) {
        pc_motion motion = {0};
        uint64_t crossings;
        blow(context, 0.0, dynamics, &motion, &crossings);
        assert_true(crossings > 20);
        pc_motion_free(context, &motion);
        blow(context, 0.3, dynamics, &motion, &crossings);
        assert_int_equal(crossings, 0);
        pc_motion_free(context, &motion);
    }
    pc_context_destroy(context);
}

// Layers that rest nearer than the distance to keep, and cross elsewhere, stay as they are.
static void rest_is_kept(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh near = two_sheets(context, 0.005);
    pc_mesh sheet = test_sheet(context, 8, 8, 1.0, 1.0);
    for (size_t v = 0; v < sheet.vertex_count; ++v) { // upright, through both
        sheet.positions[3 * v + 2] = sheet.positions[3 * v] - 0.53;
        sheet.positions[3 * v] = 0.51;
    }
    const double nowhere[3] = {0.0};
    pc_mesh mesh = test_union(context, &near, &sheet, nowhere);
    pc_simulate_options options = options_with(0.5);
    options.gravity = options.wind_speed = 0.0;
    pc_motion motion = {0};
    assert_ok(context, pc_simulate(context, &mesh, &options, &motion, NULL));
    assert_true(most_crossings(context, &mesh, &motion) > 10);
    for (size_t f = 0; f < motion.frame_count; ++f) {
        for (size_t k = 0; k < 3 * mesh.vertex_count; ++k) {
            assert_close(motion.positions[3 * mesh.vertex_count * f + k], mesh.positions[k], 1e-12);
        }
    }
    pc_motion_free(context, &motion);
    // And in the wind it neither tears nor flies.
    options = options_with(0.5);
    pc_simulate_report report;
    assert_ok(context, pc_simulate(context, &mesh, &options, &motion, &report));
    assert_true(report.p95_strain < 0.11);
    assert_true(report.motion_range < 1.5);
    pc_motion_free(context, &motion);
    pc_mesh_free(context, &mesh);
    pc_mesh_free(context, &sheet);
    pc_mesh_free(context, &near);
    pc_context_destroy(context);
}

static void threads_do_not_matter(void **state) {
    (void)state;
    pc_motion motions[2] = {{0}, {0}};
    uint64_t crossings;
    for (uint32_t i = 0; i < 2; ++i) {
        pc_context *context = test_context(i + 1);
        blow(context, 0.4, 0, &motions[i], &crossings);
        if (i == 1) {
            assert_memory_equal(motions[0].positions, motions[1].positions,
                                3 * motions[0].vertex_count * motions[0].frame_count *
                                    sizeof(double));
        }
        pc_motion_free(context, &motions[i]);
        pc_context_destroy(context);
    }
}

static void distances_out_of_range_are_refused(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh mesh = two_sheets(context, 0.25);
    const double wrong[] = {-0.1, 1.1, NAN};
    for (size_t i = 0; i < 3; ++i) {
        const pc_simulate_options options = options_with(wrong[i]);
        pc_motion motion = {0};
        assert_int_equal(pc_simulate(context, &mesh, &options, &motion, NULL),
                         PC_ERROR_INVALID_OPTIONS);
        assert_null(motion.positions);
    }
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

static void memory_may_run_out(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    pc_mesh mesh = two_sheets(context, 0.25);
    pc_simulate_options options = options_with(0.3);
    options.frames = 1;
    starvation s = {.counter = &counter};
    size_t failures[2];
    for (size_t i = 0; i < 2; ++i) {
        options.self_contact = i == 0 ? 0.0 : 0.3;
        s = (starvation){.counter = &counter};
        while (starves(&s)) {
            pc_motion motion = {0};
            s.status = pc_simulate(context, &mesh, &options, &motion, NULL);
            assert_true((s.status == PC_OK) == (motion.positions != NULL));
            pc_motion_free(context, &motion);
        }
        failures[i] = s.failures;
    }
    assert_true(failures[1] >= failures[0] + 12);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(sheets_stay_on_their_sides),
        cmocka_unit_test(rest_is_kept),
        cmocka_unit_test(threads_do_not_matter),
        cmocka_unit_test(distances_out_of_range_are_refused),
        cmocka_unit_test(memory_may_run_out),
    };
    return cmocka_run_group_tests_name("simulate_self_contact", tests, NULL, NULL);
}
