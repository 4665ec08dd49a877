#include "geometry/rotation.h"

#include "support/memory.h"
#include "support/tube.h"

static const double pi = 3.14159265358979323846;

// A rotation from four numbers, and what it does to points.
static void random_rotation(uint64_t seed, double q[4], double r[9]) {
    double square = 0.0;
    for (size_t k = 0; k < 4; ++k) {
        q[k] = 2.0 * pci_random(seed, 5, k) - 1.0;
        square += q[k] * q[k];
    }
    for (size_t k = 0; k < 4; ++k) {
        q[k] /= (q[3] < 0.0 ? -1.0 : 1.0) * sqrt(square);
    }
    pci_matrix_of_quaternion(q, r);
}

static void move_rigidly(size_t count, const double *points, const double r[9],
                         const double shift[3], double *out) {
    for (size_t v = 0; v < count; ++v) {
        for (size_t k = 0; k < 3; ++k) {
            out[3 * v + k] = pci_dot(&r[3 * k], &points[3 * v]) + shift[k];
        }
    }
}

// Angle between two rotations, in radians.
static double angle_between(const double a[4], const double b[4]) {
    const double cosine = fabs(a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]);
    return 2.0 * acos(cosine < 1.0 ? cosine : 1.0);
}

static pc_rotation_estimator *make(pc_context *context, const pc_mesh *mesh,
                                   const uint8_t *pinned) {
    pc_rotation_estimator *estimator = NULL;
    assert_ok(context, pc_rotation_estimator_create(context, mesh, pinned, &estimator));
    return estimator;
}

static void matrices_and_quaternions_agree(void **state) {
    (void)state;
    for (uint64_t seed = 0; seed < 200; ++seed) {
        double q[4], r[9], found[4];
        random_rotation(seed, q, r);
        pci_quaternion_of_matrix(r, found);
        for (size_t i = 0; i < 3; ++i) {
            for (size_t j = 0; j < 3; ++j) {
                assert_close(pci_dot(&r[3 * i], &r[3 * j]), i == j ? 1.0 : 0.0, 1e-14);
            }
        }
        for (size_t k = 0; k < 4; ++k) {
            assert_close(found[k], q[k], 1e-14);
        }
    }
    // Half turns about the axes.
    for (size_t axis = 0; axis < 3; ++axis) {
        double r[9] = {-1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0}, q[4];
        r[4 * axis] = 1.0;
        pci_quaternion_of_matrix(r, q);
        assert_close(fabs(q[axis]), 1.0, 1e-15);
    }
}

// Borders, corners, a flat sheet and pinned vertices included.
static void rigid_motion_is_found_exactly(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh tube = make_tube(context, 9, 6, 1.0, 4.0), sheet = make_tube(context, 7, 3, 1.0, 2.0);
    for (size_t v = 0; v < sheet.vertex_count; ++v) { // an annulus
        const double scale = 1.0 + sheet.positions[3 * v + 2];
        sheet.positions[3 * v] *= scale, sheet.positions[3 * v + 1] *= scale;
        sheet.positions[3 * v + 2] = 0.0;
    }
    const pc_mesh *meshes[] = {&tube, &sheet};
    double moved[300], rotations[400];
    for (size_t i = 0; i < 20; ++i) {
        const pc_mesh *mesh = meshes[i % 2];
        uint8_t pinned[100] = {0};
        for (size_t v = 0; v < mesh->vertex_count && i >= 10; ++v) {
            pinned[v] = pci_random(i, 3, v) < 0.3;
        }
        double q[4], r[9];
        const double shift[3] = {3.0, -1.0, 2.0};
        random_rotation(i, q, r);
        move_rigidly(mesh->vertex_count, mesh->positions, r, shift, moved);
        pc_rotation_estimator *estimator = make(context, mesh, pinned);
        pc_rotation_estimate(estimator, moved, rotations);
        for (size_t v = 0; v < mesh->vertex_count; ++v) {
            assert_close(angle_between(&rotations[4 * v], q), 0.0, pinned[v] ? 1e-5 : 1e-6);
        }
        pc_rotation_estimator_destroy(context, estimator);
    }
    pc_mesh_free(context, &tube);
    pc_mesh_free(context, &sheet);
    pc_context_destroy(context);
}

// Unit quaternions with w >= 0 whatever the pose; no area: the identity.
static void every_pose_gives_proper_rotations(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh tube = make_tube(context, 6, 4, 1.0, 3.0);
    uint8_t pinned[30] = {1, 0, 0, 1, 1, 0};
    pc_rotation_estimator *estimator = make(context, &tube, pinned);
    double moved[90], rotations[120];
    for (uint64_t seed = 0; seed < 200; ++seed) {
        for (size_t k = 0; k < 90; ++k) {
            moved[k] = tube.positions[k] + 4.0 * pci_random(seed, 1, k);
        }
        pc_rotation_estimate(estimator, moved, rotations);
        for (size_t v = 0; v < 30; ++v) {
            const double *q = &rotations[4 * v];
            assert_close(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3], 1.0, 1e-14);
            assert_true(q[3] >= 0.0);
        }
    }
    memset(moved, 0, sizeof(moved));
    pc_rotation_estimate(estimator, moved, rotations);
    for (size_t v = 0; v < 30; ++v) {
        assert_close(rotations[4 * v + 3], 1.0, 1e-15);
    }
    pc_rotation_estimator_destroy(context, estimator);
    pc_mesh_free(context, &tube);
    pc_context_destroy(context);
}

// Small steps of the pose are small steps of the rotations.
static void rotations_are_continuous(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh tube = make_tube(context, 8, 6, 1.0, 4.0);
    pc_rotation_estimator *estimator = make(context, &tube, NULL);
    const size_t count = tube.vertex_count, steps = 400;
    double moved[168], before[224] = {0.0}, rotations[224];
    for (size_t i = 0; i <= steps; ++i) {
        twist(count, tube.positions, 4.0, 2.0 * pi * (double)i / (double)steps, moved);
        pc_rotation_estimate(estimator, moved, rotations);
        for (size_t v = 0; v < count && i > 0; ++v) {
            assert_true(angle_between(&rotations[4 * v], &before[4 * v]) <
                        2.0 * 2.0 * pi / (double)steps);
        }
        memcpy(before, rotations, sizeof(before));
    }
    pc_rotation_estimator_destroy(context, estimator);
    pc_mesh_free(context, &tube);
    pc_context_destroy(context);
}

// Inside of a twisted tube each circle turns about the axis as far as it is twisted; the rest is
// the shear, half of which turns about the normal.
static void a_twist_turns_each_circle(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    const size_t around = 16, rows = 16;
    const double length = 6.0, angle = 0.5 * pi, shear = angle / length;
    pc_mesh tube = make_tube(context, around, rows, 1.0, length);
    pc_rotation_estimator *estimator = make(context, &tube, NULL);
    double *moved = calloc(3 * tube.vertex_count, sizeof(double));
    double *rotations = calloc(4 * tube.vertex_count, sizeof(double));
    twist(tube.vertex_count, tube.positions, length, angle, moved);
    pc_rotation_estimate(estimator, moved, rotations);
    for (size_t v = 2 * around; v < tube.vertex_count - 2 * around; ++v) {
        const double half = 0.5 * angle * tube.positions[3 * v + 2] / length;
        const double expected[4] = {0.0, 0.0, sin(half), cos(half)};
        const double off = angle_between(&rotations[4 * v], expected);
        assert_close(off, atan(0.5 * shear), 0.1 * shear);
    }
    free(moved);
    free(rotations);
    pc_rotation_estimator_destroy(context, estimator);
    pc_mesh_free(context, &tube);
    pc_context_destroy(context);
}

// Pins turn with each other, not with the cloth around them.
static void pins_turn_as_one(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    const size_t around = 8;
    pc_mesh tube = make_tube(context, around, 4, 1.0, 3.0);
    uint8_t pinned[40] = {0};
    memset(pinned, 1, around); // the lowest circle
    pinned[4 * around] = 1;    // and one vertex of the highest
    pc_rotation_estimator *estimator = make(context, &tube, pinned);
    double moved[120], rotations[160];
    twist(tube.vertex_count, tube.positions, 3.0, pi, moved);
    memcpy(&moved[3 * 4 * around], &tube.positions[3 * 4 * around], 3 * sizeof(double));
    pc_rotation_estimate(estimator, moved, rotations);
    double turned = 0.0;
    for (size_t v = 0; v < tube.vertex_count; ++v) {
        if (pinned[v]) {
            assert_close(rotations[4 * v + 3], 1.0, 1e-12);
        } else {
            turned = fmax(turned, 2.0 * acos(rotations[4 * v + 3]));
        }
    }
    assert_true(turned > 0.5 * pi);
    // The lowest circle turns, the lone pin with it: alone it does not tell a rotation.
    double q[4], r[9];
    const double shift[3] = {0.0, 0.0, 0.0};
    random_rotation(3, q, r);
    move_rigidly(tube.vertex_count, tube.positions, r, shift, moved);
    for (size_t k = 3 * around; k < 3 * 4 * around; ++k) {
        moved[k] += 0.2 * pci_random(1, 2, k);
    }
    pc_rotation_estimate(estimator, moved, rotations);
    assert_close(angle_between(rotations, q), 0.0, 1e-5);
    assert_close(angle_between(&rotations[4 * 4 * around], q), 0.0, 0.02);
    pc_rotation_estimator_destroy(context, estimator);
    pc_mesh_free(context, &tube);
    pc_context_destroy(context);
}

// Two full turns: the quaternions of all frames stay together, at any number of threads.
static void motions_keep_to_one_hemisphere(void **state) {
    (void)state;
    enum { FRAMES = 40 };
    double *found[2];
    for (uint32_t threads = 1; threads <= 2; ++threads) {
        pc_context *context = test_context(threads);
        pc_mesh tube = make_tube(context, 8, 4, 1.0, 3.0);
        const size_t count = tube.vertex_count;
        double *positions = calloc(3 * count * FRAMES, sizeof(double));
        double *rotations = calloc(4 * count * FRAMES, sizeof(double));
        uint8_t *pinned = calloc(count, 1);
        memset(pinned, 1, 8);
        for (size_t f = 0; f < FRAMES; ++f) {
            twist(count, tube.positions, 3.0, 4.0 * pi * (double)f / (FRAMES - 1),
                  &positions[3 * count * f]);
        }
        const pc_motion motion = {FRAMES, count, positions, 0.02, pinned};
        assert_ok(context, pc_rotation_estimate_motion(context, &tube, &motion, rotations));
        size_t negative = 0;
        for (size_t i = 4 * count; i < 4 * count * FRAMES; i += 4) {
            const double *q = &rotations[i], *before = q - 4 * count;
            assert_true(q[0] * before[0] + q[1] * before[1] + q[2] * before[2] + q[3] * before[3] >=
                        0.0);
            negative += q[3] < 0.0;
        }
        assert_true(negative > count);
        found[threads - 1] = rotations;
        if (threads == 2) {
            assert_memory_equal(found[0], found[1], 4 * count * FRAMES * sizeof(double));
        }
        free(positions);
        free(pinned);
        pc_mesh_free(context, &tube);
        pc_context_destroy(context);
    }
    free(found[0]);
    free(found[1]);
}

static void errors_leave_nothing(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh tube = make_tube(context, 6, 2, 1.0, 1.0), empty = {0};
    pc_rotation_estimator *estimator = (pc_rotation_estimator *)&tube;
    assert_int_not_equal(pc_rotation_estimator_create(context, &empty, NULL, &estimator), PC_OK);
    assert_null(estimator);
    assert_int_equal(pc_rotation_estimator_create(context, &tube, NULL, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    double rotations[72];
    const pc_motion other = {1, 3, tube.positions, 0.1, NULL};
    assert_int_equal(pc_rotation_estimate_motion(context, &tube, &other, rotations),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_rotation_estimate_motion(context, &tube, NULL, rotations),
                     PC_ERROR_INVALID_ARGUMENT);
    pc_rotation_estimator_destroy(context, NULL);
    pc_mesh_free(context, &tube);
    pc_context_destroy(context);
}

static void survives_lack_of_memory(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    pc_mesh tube = make_tube(context, 6, 2, 1.0, 1.0);
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        pc_rotation_estimator *estimator = NULL;
        s.status = pc_rotation_estimator_create(context, &tube, NULL, &estimator);
        assert_true((estimator != NULL) == (s.status == PC_OK));
        pc_rotation_estimator_destroy(context, estimator);
    }
    assert_true(s.failures > 9);
    pc_mesh_free(context, &tube);
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(matrices_and_quaternions_agree),
        cmocka_unit_test(rigid_motion_is_found_exactly),
        cmocka_unit_test(every_pose_gives_proper_rotations),
        cmocka_unit_test(rotations_are_continuous),
        cmocka_unit_test(a_twist_turns_each_circle),
        cmocka_unit_test(pins_turn_as_one),
        cmocka_unit_test(motions_keep_to_one_hemisphere),
        cmocka_unit_test(errors_leave_nothing),
        cmocka_unit_test(survives_lack_of_memory),
    };
    return cmocka_run_group_tests_name("rotation", tests, NULL, NULL);
}
