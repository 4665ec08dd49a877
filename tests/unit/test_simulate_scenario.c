// Scenarios at work: winds, pins, attachment, colliders.
#include "stages/simulate/simulate_internal.h"
#include "support/character_fixture.h"
#include "support/memory.h"

static const pc_scenario paper;

// A square cloth of (n + 1)^2 vertices around `center` in the xy plane (or xz: flat), side 1.
static pc_mesh make_cloth(pc_context *context, uint32_t n, bool flat, const double center[3]) {
    const uint32_t row = n + 1;
    pc_mesh mesh = {.vertex_count = (size_t)row * row, .triangle_count = 2 * (size_t)n * n};
    mesh.positions = PCI_ALLOCATE(context, double, 3 * mesh.vertex_count);
    mesh.triangles = PCI_ALLOCATE(context, uint32_t, 3 * mesh.triangle_count);
    assert_true(mesh.positions != NULL && mesh.triangles != NULL);
    for (uint32_t v = 0; v < row * row; ++v) {
        double *p = &mesh.positions[3 * v];
        memcpy(p, center, 3 * sizeof(double));
        p[0] += (double)(v % row) / n - 0.5;
        p[flat ? 2 : 1] += (double)(v / row) / n - 0.5;
    }
    uint32_t *at = mesh.triangles;
    for (uint32_t j = 0; j < n; ++j) {
        for (uint32_t i = 0; i < n; ++i, at += 6) {
            const uint32_t v = j * row + i;
            const uint32_t corners[6] = {v, v + 1, v + row, v + 1, v + row + 1, v + row};
            memcpy(at, corners, sizeof(corners));
        }
    }
    return mesh;
}

static pc_simulate_options default_options(void) {
    pc_simulate_options options;
    pc_record_set_defaults(&pc_simulate_options_record, &options);
    options.garment_size = 0.0;
    options.frames = 40;
    return options;
}

static const double origin[3] = {0.0, 0.0, 0.0};

// ---- winds --------------------------------------------------------------------------------------

static void winds_follow_their_keys(void **state) {
    (void)state;
    const pc_wind_key keys[3] = {{1.0, {0, 0, 0}}, {2.0, {4, -2, 0}}, {4.0, {0, 0, 6}}};
    const struct {
        double time, velocity[3];
    } cases[] = {{-1.0, {0, 0, 0}}, {1.0, {0, 0, 0}}, {1.25, {1, -0.5, 0}}, {2.0, {4, -2, 0}},
                 {3.0, {2, -1, 3}}, {4.0, {0, 0, 6}}, {99.0, {0, 0, 6}}};
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); ++i) {
        double velocity[3];
        pci_wind_at(keys, 3, cases[i].time, velocity);
        for (size_t k = 0; k < 3; ++k) {
            assert_close(velocity[k], cases[i].velocity[k], 1e-15);
        }
    }
}

// A steady wind without gravity blows a hanging cloth to its lee side.
static void winds_blow_the_cloth(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh cloth = make_cloth(context, 8, false, origin);
    pc_wind_key key = {0.0, {0.0, 0.0, 5.0}};
    pc_scenario scenario = {.wind_count = 1, .winds = &key};
    const pc_simulate_inputs inputs = {.proxy = &cloth, .scenario = &scenario};
    const pc_simulate_options options = default_options();
    for (int side = 0; side < 2; ++side) {
        pc_motion motion = {0};
        pc_simulate_report report;
        key.velocity[2] = side == 0 ? 5.0 : -5.0;
        assert_ok(context, pc_simulate_scenario(context, &inputs, &options, &motion, &report));
        double mean = 0.0;
        for (size_t v = 0; v < 81; ++v) {
            mean += motion.positions[3 * (81 * 39 + v) + 2] / 81.0;
        }
        assert_true(side == 0 ? mean > 0.1 : mean < -0.1);
        assert_true(report.max_strain <= 0.11);
        pc_motion_free(context, &motion);
    }
    pc_mesh_free(context, &cloth);
    pc_context_destroy(context);
}

// ---- pins ---------------------------------------------------------------------------------------

static void patterns_match(void **state) {
    (void)state;
    assert_true(pci_matches("Cape*", "Cape_Mesh") && pci_matches("*", "") &&
                pci_matches("a?c", "abc"));
    assert_true(pci_matches("*ape*M?sh", "Cape_apeMesh") && pci_matches("**a", "bba"));
    assert_false(pci_matches("Cape", "Cape_Mesh") || pci_matches("a?c", "ac"));
    assert_false(pci_matches("*b", "abc") || pci_matches("", "a") || pci_matches("a*b?", "ab"));
}

// A visual mesh over the cloth: red on the left, u from 0 to 1 upwards, two parts and materials.
static pc_visual make_visual(pc_context *context, const pc_mesh *cloth, bool skinned) {
    const size_t nv = cloth->vertex_count, nf = cloth->triangle_count;
    float *colors = calloc(4 * nv, sizeof(float)), *texcoords = calloc(2 * nv, sizeof(float));
    float *weights = calloc(4 * nv, sizeof(float));
    uint32_t *owners = calloc(nf, sizeof(uint32_t)), *joints = calloc(4 * nv, sizeof(uint32_t));
    assert_true(colors && texcoords && weights && owners && joints);
    for (size_t v = 0; v < nv; ++v) {
        colors[4 * v] = cloth->positions[3 * v] < -0.3 ? 1.0F : 0.0F;
        texcoords[2 * v] = (float)(cloth->positions[3 * v + 1] + 0.5);
        joints[4 * v] = 1;
        weights[4 * v] = 1.0F;
    }
    for (size_t t = 0; t < nf; ++t) {
        owners[t] = t < nf / 2 ? 0 : 1;
    }
    char names[2][64] = {"Hem", "Collar"};
    const pc_material materials[2] = {{.name = "silk"}, {.name = "leather"}};
    const pc_visual_arrays arrays = {.vertex_count = nv,
                                     .positions = cloth->positions,
                                     .triangle_count = nf,
                                     .triangles = cloth->triangles,
                                     .colors = colors,
                                     .texcoords = texcoords,
                                     .triangle_materials = owners,
                                     .material_count = 2,
                                     .materials = materials,
                                     .triangle_parts = owners,
                                     .part_count = 2,
                                     .part_names = names[0],
                                     .joints = skinned ? joints : NULL,
                                     .joint_weights = skinned ? weights : NULL};
    pc_visual visual = {0};
    assert_ok(context, pc_visual_create(context, &arrays, &visual, NULL));
    free(colors);
    free(texcoords);
    free(weights);
    free(owners);
    free(joints);
    return visual;
}

// How many vertices of a 9 by 9 cloth a rule holds; the flags go to `pinned`.
static uint64_t count_pins(pc_context *context, pc_pin *pins, size_t count, uint8_t *pinned) {
    pc_mesh cloth = make_cloth(context, 8, false, origin);
    pc_visual visual = make_visual(context, &cloth, false);
    const pc_scenario scenario = {.pin_count = count, .pins = pins};
    const pc_simulate_inputs inputs = {&cloth, &scenario, &visual, NULL};
    pc_simulate_options options = default_options();
    options.frames = 1;
    pc_motion motion = {0};
    pc_simulate_report report;
    assert_ok(context, pc_simulate_scenario(context, &inputs, &options, &motion, &report));
    memcpy(pinned, motion.pinned, 81);
    pc_motion_free(context, &motion);
    pc_visual_free(context, &visual);
    pc_mesh_free(context, &cloth);
    return report.pinned + 1000 * report.unmatched_pins;
}

static void rules_name_vertices(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    uint8_t pinned[81];
    pc_pin box = {.kind = PC_PIN_BOX, .minimum = {-1, 0.3, -1}, .maximum = {0.01, 1, 1}};
    assert_int_equal(count_pins(context, &box, 1, pinned), 10); // 2 rows of 5
    for (size_t v = 0; v < 81; ++v) {
        assert_int_equal(pinned[v], v / 9 >= 7 && v % 9 <= 4);
    }
    pc_pin red = {.kind = PC_PIN_ATTRIBUTE, .attribute = PC_ATTRIBUTE_RED, .above = 0.5};
    assert_int_equal(count_pins(context, &red, 1, pinned), 18); // 2 columns
    for (size_t v = 0; v < 81; ++v) {
        assert_int_equal(pinned[v], v % 9 <= 1);
    }
    pc_pin u = {.kind = PC_PIN_ATTRIBUTE, .attribute = PC_ATTRIBUTE_U, .above = 0.8};
    assert_int_equal(count_pins(context, &u, 1, pinned), 18); // 2 rows
    // Names: vertices inside of the upper half; those between the halves belong to either.
    pc_pin mesh = {.kind = PC_PIN_MESH, .name = "Col*"};
    const uint64_t upper = count_pins(context, &mesh, 1, pinned);
    assert_in_range(upper, 36, 45);
    for (size_t v = 0; v < 81; ++v) {
        assert_true(v / 9 == 4 || pinned[v] == (v / 9 > 4));
    }
    pc_pin material = {.kind = PC_PIN_MATERIAL, .name = "?eather"};
    assert_int_equal(count_pins(context, &material, 1, pinned), upper);
    pc_pin highest = {.kind = PC_PIN_HIGHEST, .fraction = 0.1};
    assert_int_equal(count_pins(context, &highest, 1, pinned), 9);
    // Together, and a box beside the cloth: counted, and the cloth still hangs.
    pc_pin both[2] = {box, highest};
    assert_int_equal(count_pins(context, both, 2, pinned), 14);
    both[0].minimum[1] = both[0].maximum[1] = 7.0;
    assert_int_equal(count_pins(context, both, 2, pinned), 1009);
    assert_int_equal(count_pins(context, both, 1, pinned), 1005); // its own 5 %
    pc_context_destroy(context);
}

static pc_status try_scenario(pc_context *context, const pc_scenario *scenario,
                              const pc_visual *visual, const pc_character *character) {
    pc_mesh cloth = make_cloth(context, 4, false, origin);
    const pc_simulate_inputs inputs = {&cloth, scenario, visual, character};
    pc_simulate_options options = default_options();
    options.frames = 2;
    pc_motion motion = {0};
    const pc_status status = pc_simulate_scenario(context, &inputs, &options, &motion, NULL);
    assert_true((status == PC_OK) == (motion.positions != NULL));
    pc_motion_free(context, &motion);
    pc_mesh_free(context, &cloth);
    return status;
}

static void refuse(pc_context *context, const pc_scenario *scenario, const pc_visual *visual,
                   const pc_character *character, const char *part) {
    assert_int_equal(try_scenario(context, scenario, visual, character), PC_ERROR_INVALID_OPTIONS);
    if (strstr(pc_context_error(context)->message, part) == NULL) {
        fail_msg("\"%s\" lacks \"%s\"", pc_context_error(context)->message, part);
    }
}

static void missing_inputs_are_errors(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh cloth = make_cloth(context, 4, false, origin);
    pc_visual visual = make_visual(context, &cloth, false);
    pc_character character = {0};
    fixture_character(context, origin, 0.3, 1, &character);
    pc_pin pin = {.kind = PC_PIN_MESH, .name = "Sleeve"};
    pc_scenario s = {.pin_count = 1, .pins = &pin};
    refuse(context, &s, NULL, NULL, "pins[0] needs a visual mesh");
    refuse(context, &s, &visual, NULL, "no mesh of the garment is called \"Sleeve\"");
    pin = (pc_pin){.kind = PC_PIN_ATTRIBUTE};
    pc_visual bare = visual;
    bare.colors = NULL;
    refuse(context, &s, &bare, NULL, "vertex colours");
    s = paper;
    s.attachment.kind = PC_ATTACHMENT_CLIP;
    memcpy(s.attachment.clip, "jump", 5);
    refuse(context, &s, &visual, NULL, "no clip \"jump\"");
    refuse(context, &s, &visual, &character, "it has turn");
    memcpy(s.attachment.clip, "turn", 5);
    pc_character stiff = character;
    stiff.body_weights = NULL;
    refuse(context, &s, &visual, &stiff, "neither the garment nor the body");
    s = paper;
    pc_collider collider = {.kind = PC_COLLIDER_BODY, .mesh = "Leg*"};
    s.collider_count = 1;
    s.colliders = &collider;
    refuse(context, &s, &visual, NULL, "no body");
    refuse(context, &s, &visual, &character, "no part of the body");
    collider = (pc_collider){.kind = PC_COLLIDER_SPHERE, .radius = 0.1, .joint = "leg"};
    refuse(context, &s, &visual, &character, "no joint \"leg\"");
    pc_character_free(context, &character);
    pc_visual_free(context, &visual);
    pc_mesh_free(context, &cloth);
    pc_context_destroy(context);
}

// ---- attachment ---------------------------------------------------------------------------------

static void rigid_motions_move_pins(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh cloth = make_cloth(context, 8, false, origin);
    pc_rigid_key keys[2] = {{0.0, {0, 0, 0}, {0, 0, 0, 1}},
                            {1.0, {2, 0, 1}, {0, sqrt(0.5), 0, sqrt(0.5)}}}; // 90 degrees about y
    const pc_scenario scenario = {
        .attachment = {
            .kind = PC_ATTACHMENT_RIGID, .pivot = {0.5, 0, 0}, .key_count = 2, .keys = keys}};
    const pc_simulate_inputs inputs = {.proxy = &cloth, .scenario = &scenario};
    pc_simulate_options options = default_options(); // 40 frames of 0.05 s
    options.garment_size = 3.0;
    pc_motion motion = {0};
    assert_ok(context, pc_simulate_scenario(context, &inputs, &options, &motion, NULL));
    size_t pins = 0;
    for (size_t v = 0; v < 81; ++v) {
        const double *rest = &cloth.positions[3 * v];
        for (size_t f = 0; f < 40 && motion.pinned[v]; ++f) {
            const double time = fmin(1.0, 0.05 * (double)(f + 1));
            const double angle = 1.5707963267948966 * time;
            const double *at = &motion.positions[3 * (81 * f + v)];
            const double x = rest[0] - 0.5, z = rest[2];
            assert_close(at[0], 0.5 + x * cos(angle) + z * sin(angle) + 2.0 * time, 1e-12);
            assert_close(at[1], rest[1], 1e-12);
            assert_close(at[2], z * cos(angle) - x * sin(angle) + time, 1e-12);
        }
        pins += motion.pinned[v];
    }
    assert_int_equal(pins, 5);
    pc_motion_free(context, &motion);
    pc_mesh_free(context, &cloth);
    pc_context_destroy(context);
}

// Pinned vertices follow the joint of the garment's weights, or of the body's.
static void clips_move_pins(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh cloth = make_cloth(context, 8, false, origin);
    pc_visual skinned = make_visual(context, &cloth, true);
    pc_visual plain = make_visual(context, &cloth, false);
    pc_character character = {0};
    fixture_character(context, origin, 0.3, 1, &character);
    pc_scenario scenario = {
        .attachment = {.kind = PC_ATTACHMENT_CLIP, .clip = "turn", .blend = 0.2}};
    pc_simulate_options options = default_options();
    for (int run = 0; run < 2; ++run) {
        const pc_simulate_inputs inputs = {&cloth, &scenario, run == 0 ? &skinned : &plain,
                                           &character};
        pc_motion motion = {0};
        assert_ok(context, pc_simulate_scenario(context, &inputs, &options, &motion, NULL));
        for (size_t v = 0; v < 81; ++v) {
            for (size_t f = 0; f < 40 && motion.pinned[v]; ++f) {
                const double time = fmin(1.0, 0.05 * (double)(f + 1));
                const double angle = 1.5707963267948966 * time;
                const double *rest = &cloth.positions[3 * v];
                const double *at = &motion.positions[3 * (81 * f + v)];
                const double x = rest[0] - 1.0, y = rest[1];
                assert_close(at[0], 1.0 + x * cos(angle) - y * sin(angle), 1e-6); // float poses
                assert_close(at[1], x * sin(angle) + y * cos(angle), 1e-6);
            }
        }
        pc_motion_free(context, &motion);
    }
    // A loop of one second is at its start again.
    pci_scratch scratch = pci_scratch_begin(context);
    scenario.attachment.loop = true;
    scenario.attachment.start = 0.5;
    pci_poses poses;
    assert_ok(context,
              pci_poses_begin(&scratch, "test", &character, &scenario.attachment, 1.0, &poses));
    const double point[3] = {1.0, 1.0, 0.0};
    double at[3];
    pci_poses_set(&poses, 0.75); // 1.25 s into it
    pci_map_apply(&poses.maps[1], point, at);
    assert_close(at[0], 1.0 - sin(0.3926990816987241), 1e-6);
    pci_poses_set(&poses, -0.2); // still the rest pose
    pci_map_apply(&poses.maps[1], point, at);
    assert_close(at[0], 1.0, 1e-12);
    pci_scratch_end(&scratch);
    pc_character_free(context, &character);
    pc_visual_free(context, &plain);
    pc_visual_free(context, &skinned);
    pc_mesh_free(context, &cloth);
    pc_context_destroy(context);
}

// ---- colliders ----------------------------------------------------------------------------------

// A flat cloth falls on a ball; nothing may be inside at any frame, and it comes to rest there.
static void check_fall(pc_context *context, const pc_scenario *scenario,
                       const pc_character *character, double radius, double tolerance) {
    const double above[3] = {0.0, 0.45, 0.0};
    pc_mesh cloth = make_cloth(context, 10, true, above);
    const pc_simulate_inputs inputs = {&cloth, scenario, NULL, character};
    pc_simulate_options options = default_options();
    options.pinned_fraction = 0.0;
    options.wind_speed = 0.0;
    options.friction = 1.0;
    options.frames = 100;
    pc_motion motion = {0};
    pc_simulate_report report;
    assert_ok(context, pc_simulate_scenario(context, &inputs, &options, &motion, &report));
    double lowest = INFINITY, fastest = 0.0;
    for (size_t f = 0; f < 100; ++f) {
        for (size_t v = 0; v < 121; ++v) {
            const double *at = &motion.positions[3 * (121 * f + v)];
            const double distance = pci_norm(at);
            assert_true(distance > radius + options.contact_distance - tolerance);
            if (f == 99) {
                lowest = fmin(lowest, at[1]);
                fastest = fmax(fastest, sqrt(pci_squared_distance(at, at - 3 * 121)));
            }
        }
    }
    assert_true(lowest > -1.5);  // it did not slide off
    assert_true(fastest < 0.02); // per frame of 0.05 s
    assert_true(report.deepest_contact <= tolerance);
    assert_true(report.max_strain < 0.3 && report.p95_strain < 0.1);
    pc_motion_free(context, &motion);
    pc_mesh_free(context, &cloth);
}

static void cloth_rests_on_colliders(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_collider collider = {.kind = PC_COLLIDER_SPHERE, .radius = 0.4};
    const pc_scenario scenario = {.collider_count = 1, .colliders = &collider};
    check_fall(context, &scenario, NULL, 0.4, 0.001);
    collider.kind = PC_COLLIDER_CAPSULE;
    collider.from[2] = -0.001;
    collider.to[2] = 0.001;
    check_fall(context, &scenario, NULL, 0.4, 0.001);
    // The body's triangles lie inside of the ball, and the field has cells of 2 % of its size.
    pc_character character = {0};
    fixture_character(context, origin, 0.4, 0, &character);
    collider = (pc_collider){.kind = PC_COLLIDER_BODY};
    check_fall(context, &scenario, &character, 0.4, 0.01);
    pc_character_free(context, &character);
    pc_context_destroy(context);
}

// Colliders on a joint sweep the cloth along, as a ball or as the body.
static void colliders_follow_their_joint(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    // The arm turns about (1, 0, 0): a ball at (2, 0, 0) goes to (1, 1, 0), through the cloth at
    // x = 1.7, z = 0 .. in the yz plane.
    const double place[3] = {1.6, 0.6, 0.0}, start[3] = {2.0, 0.0, 0.0};
    pc_mesh cloth = make_cloth(context, 8, true, place);
    pc_character character = {0};
    fixture_character(context, start, 0.3, 1, &character);
    pc_collider collider = {
        .kind = PC_COLLIDER_SPHERE, .from = {2.0, 0.0, 0.0}, .radius = 0.3, .joint = "arm"};
    const pc_scenario scenario = {.attachment = {.kind = PC_ATTACHMENT_CLIP, .clip = "turn"},
                                  .collider_count = 1,
                                  .colliders = &collider};
    const pc_simulate_inputs inputs = {&cloth, &scenario, NULL, &character};
    pc_simulate_options options = default_options();
    options.gravity = 0.0;
    options.wind_speed = 0.0;
    options.pinned_fraction = 0.0;
    options.air_density = 0.0;
    options.frames = 20;
    for (int run = 0; run < 2; ++run) {
        pc_motion motion = {0};
        if (run == 1) {
            collider = (pc_collider){.kind = PC_COLLIDER_BODY, .mesh = "Ball*"};
        }
        assert_ok(context, pc_simulate_scenario(context, &inputs, &options, &motion, NULL));
        double highest = -INFINITY;
        for (size_t f = 0; f < 20; ++f) {
            const double angle = 1.5707963267948966 * 0.05 * (double)(f + 1);
            const double center[3] = {1.0 + cos(angle), sin(angle), 0.0};
            for (size_t v = 0; v < 81; ++v) {
                const double *at = &motion.positions[3 * (81 * f + v)];
                assert_true(sqrt(pci_squared_distance(at, center)) > 0.3 - 0.01);
                highest = fmax(highest, at[1]);
            }
        }
        assert_true(highest > 0.8); // it was pushed
        pc_motion_free(context, &motion);
    }
    pc_character_free(context, &character);
    pc_mesh_free(context, &cloth);
    pc_context_destroy(context);
}

// Pins inside of a collider, and a collider that is pressed against them: no explosion.
static void conflicts_stay_bounded(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh cloth = make_cloth(context, 8, false, origin);
    pc_collider colliders[2] = {{.kind = PC_COLLIDER_SPHERE, .from = {0, 0.4, 0}, .radius = 0.3},
                                {.kind = PC_COLLIDER_SPHERE, .from = {0, 0, 0.1}, .radius = 0.25}};
    const pc_scenario scenario = {.collider_count = 2, .colliders = colliders};
    const pc_simulate_inputs inputs = {.proxy = &cloth, .scenario = &scenario};
    pc_simulate_options options = default_options();
    options.frames = 100;
    pc_motion motion = {0};
    pc_simulate_report report;
    assert_ok(context, pc_simulate_scenario(context, &inputs, &options, &motion, &report));
    assert_true(report.max_speed < 30.0 && report.p95_strain < 0.1 && report.max_strain < 0.6);
    pc_motion_free(context, &motion);
    pc_mesh_free(context, &cloth);
    pc_context_destroy(context);
}

// ---- strain, threads, memory -------------------------------------------------------------------

// 33 x 33 vertices in a storm: XPBD with substeps keeps the strain, PBD adapts.
static void strain_is_bounded(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh cloth = make_cloth(context, 31, false, origin); // 1024 vertices
    pc_simulate_options options = default_options();
    for (uint32_t dynamics = 0; dynamics < 2; ++dynamics) {
        pc_motion motion = {0};
        pc_simulate_report report;
        options.dynamics = dynamics;
        assert_ok(context, pc_simulate(context, &cloth, &options, &motion, &report));
        assert_true(report.p95_strain <= 0.05);
        assert_true(report.max_strain <= 0.2);
        pc_motion_free(context, &motion);
    }
    pc_mesh_free(context, &cloth);
    pc_context_destroy(context);
}

// A wind that an explicit force of this strength would turn into an explosion.
static void strong_wind_on_light_cloth_stays_finite(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh cloth = make_cloth(context, 4, false, origin);
    pc_simulate_options options = default_options();
    options.stretch_stiffness = options.bend_stiffness = 0.0;
    options.air_density = 100.0;
    options.area_density = 0.001;
    options.time_step = 0.1;
    options.frame_steps = 1000;
    options.frames = 2;
    pc_motion motion = {0};
    pc_simulate_report report;
    assert_ok(context, pc_simulate(context, &cloth, &options, &motion, &report));
    assert_true(report.max_speed < 50.0);
    pc_motion_free(context, &motion);
    pc_mesh_free(context, &cloth);
    pc_context_destroy(context);
}

static pc_status run_all(pc_context *context, pc_motion *motion) {
    const double center[3] = {0.0, -0.2, -0.3};
    pc_mesh cloth = make_cloth(context, 6, false, origin);
    pc_visual visual = make_visual(context, &cloth, true);
    pc_character character = {0};
    fixture_character(context, center, 0.2, 1, &character);
    pc_pin pin = {.kind = PC_PIN_MATERIAL, .name = "leather"};
    pc_collider colliders[2] = {{.kind = PC_COLLIDER_BODY},
                                {.kind = PC_COLLIDER_SPHERE, .radius = 0.2, .from = {0, -1, 0}}};
    const pc_scenario scenario = {
        .pin_count = 1,
        .pins = &pin,
        .attachment = {.kind = PC_ATTACHMENT_CLIP, .clip = "turn", .blend = 0.1},
        .collider_count = 2,
        .colliders = colliders};
    const pc_simulate_inputs inputs = {&cloth, &scenario, &visual, &character};
    pc_simulate_options options = default_options();
    options.frames = 10;
    const pc_status status = pc_simulate_scenario(context, &inputs, &options, motion, NULL);
    pc_character_free(context, &character);
    pc_visual_free(context, &visual);
    pc_mesh_free(context, &cloth);
    return status;
}

static void threads_do_not_matter(void **state) {
    (void)state;
    static const uint32_t threads[] = {1, 2, 3, 8};
    pc_motion first = {0};
    pc_context *keeper = test_context(1);
    assert_ok(keeper, run_all(keeper, &first));
    for (size_t i = 0; i < 4; ++i) {
        pc_context *context = test_context(threads[i]);
        pc_motion motion = {0};
        assert_ok(context, run_all(context, &motion));
        assert_memory_equal(first.positions, motion.positions, 3 * 10 * 49 * sizeof(double));
        pc_motion_free(context, &motion);
        pc_context_destroy(context);
    }
    pc_motion_free(keeper, &first);
    pc_context_destroy(keeper);
}

// ---- step by step -------------------------------------------------------------------------------

// Frames and steps are one simulation, with seeded winds as with a clip and the body.
static void steps_lead_to_the_frames(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh cloth = make_cloth(context, 8, false, origin);
    pc_character character = {0};
    fixture_character(context, origin, 0.3, 1, &character);
    pc_collider collider = {.kind = PC_COLLIDER_BODY};
    const pc_scenario scenario = {
        .attachment = {.kind = PC_ATTACHMENT_CLIP, .clip = "turn", .blend = 0.2},
        .collider_count = 1,
        .colliders = &collider};
    pc_simulate_options options = default_options();
    options.garment_size = 1.5;
    for (int run = 0; run < 2; ++run) {
        const pc_simulate_inputs inputs = {
            .proxy = &cloth, .scenario = run == 0 ? NULL : &scenario, .character = &character};
        pc_motion motion = {0};
        pc_simulator *simulator = NULL;
        assert_ok(context, pc_simulate_scenario(context, &inputs, &options, &motion, NULL));
        assert_ok(context, pc_simulator_create(context, &inputs, &options, &simulator));
        assert_memory_equal(pc_simulator_pinned(simulator), motion.pinned, 81);
        // At rest, or where the clip's start has led it.
        assert_int_equal(run == 0, memcmp(pc_simulator_positions(simulator), cloth.positions,
                                          3 * 81 * sizeof(double)) == 0);
        for (size_t f = 0; f < motion.frame_count; ++f) {
            for (uint32_t i = 0; i < options.frame_steps; ++i) {
                assert_ok(context, pc_simulator_step(simulator, NULL, NULL));
            }
            assert_memory_equal(pc_simulator_positions(simulator), &motion.positions[3 * 81 * f],
                                3 * 81 * sizeof(double));
        }
        pc_simulator_destroy(simulator);
        pc_motion_free(context, &motion);
    }
    pc_character_free(context, &character);
    pc_mesh_free(context, &cloth);
    pc_context_destroy(context);
}

// A caller's wind is as good as the scenario's, and its targets move pins and nothing else.
static void callers_blow_and_move_pins(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh cloth = make_cloth(context, 8, false, origin);
    pc_wind_key key = {0.0, {0.0, 0.0, 5.0}};
    const pc_scenario windy = {.wind_count = 1, .winds = &key};
    const pc_simulate_inputs calm_inputs = {.proxy = &cloth};
    const pc_simulate_inputs windy_inputs = {.proxy = &cloth, .scenario = &windy};
    pc_simulate_options options = default_options();
    options.wind_speed = 5.0; // bounds speeds; else the two would differ
    pc_simulator *asked = NULL, *given = NULL;
    assert_ok(context, pc_simulator_create(context, &windy_inputs, &options, &asked));
    assert_ok(context, pc_simulator_create(context, &calm_inputs, &options, &given));
    for (int i = 0; i < 60; ++i) {
        assert_ok(context, pc_simulator_step(asked, NULL, NULL));
        assert_ok(context, pc_simulator_step(given, key.velocity, NULL));
    }
    const double *positions = pc_simulator_positions(given);
    const uint8_t *pinned = pc_simulator_pinned(given);
    assert_memory_equal(positions, pc_simulator_positions(asked), 3 * 81 * sizeof(double));
    double targets[3 * 81];
    for (size_t k = 0; k < 3 * 81; ++k) {
        targets[k] = pinned[k / 3] ? cloth.positions[k] + 0.01 : (double)NAN;
    }
    assert_ok(context, pc_simulator_step(given, NULL, targets));
    assert_ok(context, pc_simulator_step(given, NULL, NULL)); // stays there
    for (size_t k = 0; k < 3 * 81; ++k) {
        assert_true(isfinite(positions[k]));
        if (pinned[k / 3]) {
            assert_close(positions[k], targets[k], 1e-15);
        }
    }
    const double storm[3] = {(double)INFINITY, 0.0, 0.0};
    assert_int_equal(pc_simulator_step(given, storm, NULL), PC_ERROR_NUMERICAL);
    assert_int_equal(pc_simulator_step(NULL, NULL, NULL), PC_ERROR_INVALID_ARGUMENT);
    pc_simulator_destroy(asked);
    pc_simulator_destroy(given);
    pc_simulator_destroy(NULL);
    assert_int_equal(pc_simulator_create(context, NULL, &options, &given),
                     PC_ERROR_INVALID_ARGUMENT);
    options.damping = 2.0;
    assert_int_equal(pc_simulator_create(context, &calm_inputs, &options, &given),
                     PC_ERROR_INVALID_OPTIONS);
    assert_null(given);
    pc_mesh_free(context, &cloth);
    pc_context_destroy(context);
}

static void memory_may_run_out(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    pc_mesh cloth = make_cloth(context, 3, false, origin);
    pc_visual visual = make_visual(context, &cloth, true);
    pc_character character = {0};
    fixture_character(context, origin, 0.05, 1, &character);
    pc_pin pin = {.kind = PC_PIN_MESH, .name = "Collar"};
    pc_collider collider = {.kind = PC_COLLIDER_BODY};
    const pc_scenario scenario = {.pin_count = 1,
                                  .pins = &pin,
                                  .attachment = {.kind = PC_ATTACHMENT_CLIP, .clip = "turn"},
                                  .collider_count = 1,
                                  .colliders = &collider};
    const pc_simulate_inputs inputs = {&cloth, &scenario, &visual, &character};
    pc_simulate_options options = default_options();
    options.frames = 1;
    starvation s = {.counter = &counter, .growth = 20}; // every call past the field is costly
    while (starves(&s)) {
        pc_motion motion = {0};
        s.status = pc_simulate_scenario(context, &inputs, &options, &motion, NULL);
        assert_true((s.status == PC_OK) == (motion.positions != NULL));
        pc_motion_free(context, &motion);
    }
    assert_true(s.number > 30);
    pc_character_free(context, &character);
    pc_visual_free(context, &visual);
    pc_mesh_free(context, &cloth);
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(winds_follow_their_keys),
        cmocka_unit_test(winds_blow_the_cloth),
        cmocka_unit_test(patterns_match),
        cmocka_unit_test(rules_name_vertices),
        cmocka_unit_test(missing_inputs_are_errors),
        cmocka_unit_test(rigid_motions_move_pins),
        cmocka_unit_test(clips_move_pins),
        cmocka_unit_test(cloth_rests_on_colliders),
        cmocka_unit_test(colliders_follow_their_joint),
        cmocka_unit_test(conflicts_stay_bounded),
        cmocka_unit_test(strain_is_bounded),
        cmocka_unit_test(strong_wind_on_light_cloth_stays_finite),
        cmocka_unit_test(threads_do_not_matter),
        cmocka_unit_test(steps_lead_to_the_frames),
        cmocka_unit_test(callers_blow_and_move_pins),
        cmocka_unit_test(memory_may_run_out),
    };
    return cmocka_run_group_tests_name("simulate_scenario", tests, NULL, NULL);
}
