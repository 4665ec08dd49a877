// What single options of the weights are for, one test each.
#include "proxycloth/baselines.h"
#include "stages/skin/skin_internal.h"
#include "support/skin_fixture.h"
#include "support/tube.h"

static pc_skin_options defaults(void) {
    pc_skin_options options;
    pc_record_set_defaults(&pc_skin_options_record, &options);
    return options;
}

static void optimize(pc_context *context, const pc_mesh *surface, const pc_mesh *proxy,
                     const pc_motion *motion, const pc_skin_options *options, pc_skin *skin) {
    assert_ok(context, pc_skin_optimize(context, surface, proxy, motion, options, skin, NULL));
    assert_int_equal(skin->skinning, options->skinning);
}

// ---- skinning -----------------------------------------------------------------------------------

static const double pi = 3.14159265358979323846;
static const double tube_length = 4.0;

// A proxy of few vertices and a garment of many around it, twisted to and fro about their axis.
typedef struct twisted {
    pc_context *context;
    pc_mesh surface, proxy;
    pc_motion motion;
} twisted;

static void open_twisted(double furthest, uint32_t threads, twisted *t) {
    enum { FRAMES = 48 };
    t->context = test_context(threads);
    t->surface = make_tube(t->context, 48, 60, 1.0, tube_length);
    t->proxy = make_tube(t->context, 8, 8, 1.0, tube_length);
    const size_t count = t->proxy.vertex_count;
    const pc_motion motion = {.frame_count = FRAMES,
                              .vertex_count = count,
                              .positions = PCI_ALLOCATE(t->context, double, 3 * count * FRAMES),
                              .frame_time = 0.02,
                              .pinned = PCI_ALLOCATE(t->context, uint8_t, count)};
    t->motion = motion;
    memset(motion.pinned, 1, 8); // both ends are held
    memset(&motion.pinned[count - 8], 1, 8);
    for (size_t f = 0; f < FRAMES; ++f) {
        const double angle = furthest * sin(2.0 * pi * (double)(f + 1) / FRAMES);
        twist(count, t->proxy.positions, tube_length, angle, &motion.positions[3 * count * f]);
    }
}

static void close_twisted(twisted *t) {
    pc_mesh_free(t->context, &t->surface);
    pc_mesh_free(t->context, &t->proxy);
    pc_motion_free(t->context, &t->motion);
    pc_context_destroy(t->context);
}

// Volume that a tube encloses, its ends closed by fans about the axis.
static double volume_of(const pc_mesh *tube, const double *positions) {
    double sum = 0.0;
    for (size_t i = 0; i < tube->triangle_count; ++i) {
        const uint32_t *corner = &tube->triangles[3 * i];
        double cross[3];
        pci_cross(&positions[3 * (size_t)corner[1]], &positions[3 * (size_t)corner[2]], cross);
        sum += pci_dot(&positions[3 * (size_t)corner[0]], cross) / 6.0;
    }
    // The upper end: triangles with (0, 0, length); the lower one lies in the plane of the origin.
    const size_t around = 48, top = tube->vertex_count - around;
    for (size_t i = 0; i < around; ++i) {
        const double *a = &positions[3 * (top + i)], *b = &positions[3 * (top + (i + 1) % around)];
        sum += tube_length * (a[0] * b[1] - a[1] * b[0]) / 6.0;
    }
    return sum;
}

// Twisted by `angle`: root mean square distance from the exact twist over the radius, and the share
// of the volume that is lost.
static void measure_twist(const twisted *t, const pc_skin *skin, double angle, double *error,
                          double *loss) {
    const size_t nv = t->surface.vertex_count, np = t->proxy.vertex_count;
    double *pose = calloc(3 * np, sizeof(double)), *rotations = calloc(4 * np, sizeof(double));
    double *exact = calloc(3 * nv, sizeof(double)), *posed = calloc(3 * nv, sizeof(double));
    double squares = 0.0;
    twist(np, t->proxy.positions, tube_length, angle, pose);
    twist(nv, t->surface.positions, tube_length, angle, exact);
    pc_rotation_estimator *estimator = NULL;
    assert_ok(t->context,
              pc_rotation_estimator_create(t->context, &t->proxy, t->motion.pinned, &estimator));
    pc_rotation_estimate(estimator, pose, rotations);
    pc_skin_deform(skin, t->surface.positions, t->proxy.positions, pose,
                   skin->skinning == PC_SKINNING_ROTATION ? rotations : NULL, posed);
    for (size_t v = 0; v < nv; ++v) {
        squares += pci_squared_distance(&posed[3 * v], &exact[3 * v]);
    }
    *error = sqrt(squares / (double)nv);
    *loss = 1.0 - volume_of(&t->surface, posed) / volume_of(&t->surface, exact);
    pc_rotation_estimator_destroy(t->context, estimator);
    free(pose);
    free(rotations);
    free(exact);
    free(posed);
}

// What is between the bones goes in a straight line from where it was, into the tube, unless it
// turns with them.
static void rotations_keep_a_twisted_tube(void **state) {
    (void)state;
    twisted t;
    open_twisted(0.75 * pi, 1, &t);
    double errors[2], losses[2];
    for (uint32_t skinning = 0; skinning < 2; ++skinning) {
        pc_skin_options options = defaults();
        options.skinning = skinning;
        pc_skin skin = {0};
        optimize(t.context, &t.surface, &t.proxy, &t.motion, &options, &skin);
        measure_twist(&t, &skin, pi, &errors[skinning], &losses[skinning]); // further than seen
        pc_skin_free(t.context, &skin);
    }
    assert_true(errors[1] < 0.5 * errors[0]);
    assert_true(losses[1] < 0.5 * losses[0]);
    close_twisted(&t);
}

static void rotations_give_the_same_bytes_at_any_thread_count(void **state) {
    (void)state;
    pc_skin skins[2] = {{0}, {0}};
    twisted t[2];
    for (uint32_t i = 0; i < 2; ++i) {
        open_twisted(0.75 * pi, 1 + 2 * i, &t[i]);
        pc_skin_options options = defaults();
        options.skinning = PC_SKINNING_ROTATION;
        optimize(t[i].context, &t[i].surface, &t[i].proxy, &t[i].motion, &options, &skins[i]);
    }
    const size_t count = skins[0].vertex_count * skins[0].influences;
    assert_memory_equal(skins[0].bones, skins[1].bones, count * sizeof(uint32_t));
    assert_memory_equal(skins[0].weights, skins[1].weights, count * sizeof(double));
    for (uint32_t i = 0; i < 2; ++i) {
        pc_skin_free(t[i].context, &skins[i]);
        close_twisted(&t[i]);
    }
}

// ---- pins ---------------------------------------------------------------------------------------

// What is closest to pins only goes where they go, to rounding, though the cloth around them turns.
static void pins_hold_exactly(void **state) {
    (void)state;
    for (uint32_t skinning = 0; skinning < 2; ++skinning) {
        fixture f;
        load_fixture("dress796", 1, &f);
        pc_motion motion = {0};
        pc_skin skin = {0}, closest = {0};
        pc_skin_options options = defaults();
        options.skinning = skinning;
        make_motion(f.context, &f.proxy, 40, 1, &motion);
        optimize(f.context, &f.visual, &f.proxy, &motion, &options, &skin);
        assert_ok(f.context, pc_skin_closest_triangle(f.context, &f.visual, &f.proxy, &closest));
        const size_t np = f.proxy.vertex_count, nv = f.visual.vertex_count;
        double *rotations = calloc(4 * np * motion.frame_count, sizeof(double));
        double *posed = calloc(3 * nv, sizeof(double));
        assert_ok(f.context, pc_rotation_estimate_motion(f.context, &f.proxy, &motion, rotations));
        size_t held = 0;
        double others = 0.0;
        for (size_t t = 0; t < motion.frame_count; ++t) {
            pc_skin_deform(&skin, f.visual.positions, f.proxy.positions,
                           &motion.positions[3 * np * t],
                           skinning == PC_SKINNING_ROTATION ? &rotations[4 * np * t] : NULL, posed);
            for (size_t v = 0; v < nv; ++v) {
                bool pinned = true;
                for (size_t k = 3 * v; k < 3 * v + 3; ++k) {
                    pinned =
                        pinned && (closest.weights[k] == 0.0 || motion.pinned[closest.bones[k]]);
                }
                const double moved =
                    sqrt(pci_squared_distance(&posed[3 * v], &f.visual.positions[3 * v]));
                if (pinned) {
                    assert_close(moved, 0.0, 1e-12); // these pins stay where they are
                }
                held += pinned;
                others += moved;
            }
        }
        assert_true(held > motion.frame_count && others > 1.0);
        free(rotations);
        free(posed);
        pc_skin_free(f.context, &skin);
        pc_skin_free(f.context, &closest);
        pc_motion_free(f.context, &motion);
        free_fixture(&f);
    }
}

// ---- least_motion -------------------------------------------------------------------------------

static pc_motion_measures measures_with(const fixture *f, const pc_motion *motion,
                                        const pc_skin_options *options) {
    pc_skin skin = {0};
    pc_motion_measures measures;
    optimize(f->context, &f->visual, &f->proxy, motion, options, &skin);
    assert_ok(f->context, pc_evaluate_motion(f->context, &f->visual, &f->proxy, motion, &skin, NULL,
                                             &measures));
    pc_skin_free(f->context, &skin);
    return measures;
}

static double motion_with(const fixture *f, const pc_motion *motion, double least_motion,
                          double lambda_follow) {
    pc_skin_options options = defaults();
    options.least_motion = least_motion;
    options.lambda_follow = lambda_follow;
    options.lambda_layers = 0.0; // which also changes how much the dress's parts move
    return measures_with(f, motion, &options).motion_ratio;
}

// Asked for more motion than there is, lambda_follow becomes sixteen times as large when slots are
// taken away: the same weights move more than without, hardly more than sixteen times lambda_follow
// from the start gives; asked for none, nothing changes.
static void least_motion_raises_lambda_follow(void **state) {
    (void)state;
    fixture f;
    load_fixture("dress796", 1, &f);
    pc_motion motion = {0};
    make_motion(f.context, &f.proxy, 40, 1, &motion);
    const double little = 0.02;
    const double without = motion_with(&f, &motion, 0.0, little);
    const double with = motion_with(&f, &motion, 1.0, little);
    const double most = motion_with(&f, &motion, 0.0, 16.0 * little);
    assert_true(without < 0.99);
    assert_true(with > without + 0.3 * (most - without));
    assert_true(with < most + 0.3 * (most - without));
    // What moves enough already stays as it is.
    assert_true(motion_with(&f, &motion, 0.5 * without, little) == without);
    pc_motion_free(f.context, &motion);
    free_fixture(&f);
}

// ---- most_strain --------------------------------------------------------------------------------

static double strain_with(const fixture *f, const pc_motion *motion, double most_strain,
                          double lambda_stretch) {
    pc_skin_options options = defaults();
    options.most_strain = most_strain;
    options.lambda_stretch = lambda_stretch;
    return measures_with(f, motion, &options).strain_mean;
}

// As with least_motion: asked for no strain, lambda_stretch becomes sixteen times as large.
static void most_strain_raises_lambda_stretch(void **state) {
    (void)state;
    fixture f;
    load_fixture("dress796", 1, &f);
    pc_motion motion = {0};
    pc_skin closest = {0};
    pc_motion_measures measures;
    make_motion(f.context, &f.proxy, 40, 1, &motion);
    const double little = 0.5, never = 1e6;
    const double without = strain_with(&f, &motion, never, little);
    const double with = strain_with(&f, &motion, 0.0, little);
    const double least = strain_with(&f, &motion, never, 16.0 * little);
    assert_true(with < without - 0.3 * (without - least));
    assert_true(with > least - 0.3 * (without - least));
    // What stretches less than asked of closest-triangle weights stays as it is.
    assert_ok(f.context, pc_skin_closest_triangle(f.context, &f.visual, &f.proxy, &closest));
    assert_ok(f.context, pc_evaluate_motion(f.context, &f.visual, &f.proxy, &motion, &closest, NULL,
                                            &measures));
    const double share = without / measures.strain_mean;
    assert_true(strain_with(&f, &motion, 1.5 * share, little) == without);
    assert_true(strain_with(&f, &motion, 0.5 * share, little) < without);
    pc_skin_free(f.context, &closest);
    pc_motion_free(f.context, &motion);
    free_fixture(&f);
}

// ---- motion_noise -------------------------------------------------------------------------------

// Few frames show little of how the proxy moves; weights that stand noise keep their shape better
// in others, though not in these.
static void noise_helps_on_other_motions(void **state) {
    (void)state;
    fixture f;
    load_fixture("dress796", 1, &f);
    pc_motion seen = {0}, unseen = {0};
    make_motion(f.context, &f.proxy, 8, 1, &seen);
    make_motion(f.context, &f.proxy, 48, 2, &unseen);
    double rigid[2][2];
    for (size_t i = 0; i < 2; ++i) {
        pc_skin_options options = defaults();
        options.motion_noise = i == 0 ? 0.0 : options.motion_noise;
        pc_skin skin = {0};
        optimize(f.context, &f.visual, &f.proxy, &seen, &options, &skin);
        for (size_t k = 0; k < 2; ++k) {
            pc_skin_losses losses;
            assert_ok(f.context, pc_skin_evaluate(f.context, &f.visual, &f.proxy,
                                                  k == 0 ? &seen : &unseen, &skin, NULL, &losses));
            rigid[i][k] = losses.rigid;
        }
        pc_skin_free(f.context, &skin);
    }
    assert_true(rigid[1][0] > rigid[0][0]);
    assert_true(rigid[1][1] < rigid[0][1]);
    pc_motion_free(f.context, &seen);
    pc_motion_free(f.context, &unseen);
    free_fixture(&f);
}

// L_s does not see the noise: alone, it keeps lengths as well with it as without.
static void noise_spares_lengths(void **state) {
    (void)state;
    fixture f;
    load_fixture("dress796", 1, &f);
    pc_motion motion = {0};
    make_motion(f.context, &f.proxy, 40, 1, &motion);
    pc_skin_options options = defaults();
    options.lambda_rigid = options.lambda_collision = options.lambda_attachment = 0.0;
    options.lambda_follow = options.lambda_layers = options.least_motion = 0.0;
    options.most_strain = 1e6;
    options.rounds = 60;
    options.round_gain = 0.0;
    options.motion_noise = 0.0;
    const double without = measures_with(&f, &motion, &options).strain_mean;
    options.motion_noise = 0.16;
    const double with = measures_with(&f, &motion, &options).strain_mean;
    assert_true(with < 1.1 * without);
    pc_motion_free(f.context, &motion);
    free_fixture(&f);
}

// ---- equal_edges --------------------------------------------------------------------------------

// Stiffness is l^2 / |e|^2 with a floor; so every edge adds about l^2 to the norms.
static void equal_edges_count_alike(void **state) {
    (void)state;
    fixture f;
    load_fixture("dress796", 1, &f);
    pci_skin_problem p = f.problem;
    assert_true(pci_skin_stiffness(&p, 0, 1) == 1.0);
    const double mean_square = p.norms[0] / (double)p.ring_offsets[p.vertex_count];
    pci_skin_problem_equalize(&p);
    double shares[2] = {0.0, 0.0};
    size_t counts[2] = {0, 0};
    for (size_t v = 0; v < p.vertex_count; ++v) {
        for (size_t e = p.ring_offsets[v]; e < p.ring_offsets[v + 1]; ++e) {
            const double square =
                pci_squared_distance(&p.rest[3 * v], &p.rest[3 * (size_t)p.ring[e]]);
            const double share = pci_skin_stiffness(&p, v, p.ring[e]) * square;
            assert_close(share, mean_square / (1.0 + 0.01 * mean_square / square),
                         1e-12 * mean_square);
            shares[square > mean_square] += share;
            ++counts[square > mean_square];
        }
    }
    assert_close(shares[0] + shares[1], p.norms[0], 1e-9 * p.norms[0]);
    assert_true(counts[0] > 100 && counts[1] > 100);
    assert_close(shares[0] / (double)counts[0], shares[1] / (double)counts[1], 0.3 * mean_square);
    free_fixture(&f);
}

// Mean strain of the edges in the shortest and the longest quarter.
static void strain_by_length(const fixture *f, const pc_motion *motion, bool equal,
                             double strain[2]) {
    pc_skin_options options = defaults();
    options.equal_edges = equal;
    pc_skin skin = {0};
    optimize(f->context, &f->visual, &f->proxy, motion, &options, &skin);
    const pci_skin_problem *p = &f->problem;
    const size_t edges = p->ring_offsets[p->vertex_count];
    double *squares = calloc(edges, sizeof(double)), counts[2] = {0.0, 0.0};
    double *posed = calloc(3 * p->vertex_count, sizeof(double));
    uint64_t *order = calloc(edges, sizeof(uint64_t));
    for (size_t v = 0; v < p->vertex_count; ++v) {
        for (size_t e = p->ring_offsets[v]; e < p->ring_offsets[v + 1]; ++e) {
            squares[e] = pci_squared_distance(&p->rest[3 * v], &p->rest[3 * (size_t)p->ring[e]]);
            memcpy(&order[e], &squares[e], sizeof(double)); // positive: in the same order
        }
    }
    qsort(order, edges, sizeof(uint64_t), pci_compare_u64);
    double limits[2];
    memcpy(&limits[0], &order[edges / 4], sizeof(double));
    memcpy(&limits[1], &order[3 * edges / 4], sizeof(double));
    strain[0] = strain[1] = 0.0;
    for (size_t t = 0; t < motion->frame_count; ++t) {
        pc_skin_deform(&skin, f->visual.positions, f->proxy.positions,
                       &motion->positions[3 * f->proxy.vertex_count * t], NULL, posed);
        for (size_t v = 0; v < p->vertex_count; ++v) {
            for (size_t e = p->ring_offsets[v]; e < p->ring_offsets[v + 1]; ++e) {
                const double square =
                    pci_squared_distance(&posed[3 * v], &posed[3 * (size_t)p->ring[e]]);
                const bool longer = squares[e] > limits[1];
                if (squares[e] > 0.0 && (squares[e] < limits[0] || longer)) {
                    strain[longer] += fabs(sqrt(square / squares[e]) - 1.0);
                    counts[longer] += 1.0;
                }
            }
        }
    }
    strain[0] /= counts[0];
    strain[1] /= counts[1];
    free(squares);
    free(posed);
    free(order);
    pc_skin_free(f->context, &skin);
}

// As the paper has it short edges cost next to nothing, and stretch.
static void equal_edges_keep_short_edges(void **state) {
    (void)state;
    fixture f;
    load_fixture("dress796", 1, &f);
    pc_motion motion = {0};
    make_motion(f.context, &f.proxy, 40, 1, &motion);
    double equal[2], printed[2];
    strain_by_length(&f, &motion, true, equal);
    strain_by_length(&f, &motion, false, printed);
    assert_true(equal[0] < 0.97 * printed[0]);
    assert_true(equal[0] / equal[1] < printed[0] / printed[1]);
    pc_motion_free(f.context, &motion);
    free_fixture(&f);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(rotations_keep_a_twisted_tube),
        cmocka_unit_test(rotations_give_the_same_bytes_at_any_thread_count),
        cmocka_unit_test(pins_hold_exactly),
        cmocka_unit_test(least_motion_raises_lambda_follow),
        cmocka_unit_test(most_strain_raises_lambda_stretch),
        cmocka_unit_test(noise_helps_on_other_motions),
        cmocka_unit_test(noise_spares_lengths),
        cmocka_unit_test(equal_edges_count_alike),
        cmocka_unit_test(equal_edges_keep_short_edges),
    };
    return cmocka_run_group_tests_name("skin_options", tests, NULL, NULL);
}
