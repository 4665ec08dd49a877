#include "geometry/distance_field.h"
#include "support/shapes.h"

static void winding_numbers_tell_inside_from_outside(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh box = shape_box(context, 2, 2, 2);
    const double inside[3] = {0.9, 1.2, 1.9}, outside[3] = {2.1, 1.0, 1.0};
    assert_close(pci_winding_number(&box, inside), 1.0, 1e-12);
    assert_close(pci_winding_number(&box, outside), 0.0, 1e-12);
    // Without one of its six equal sides a cube covers 5/6 of what its centre sees.
    const double centre[3] = {1.0, 1.0, 1.0};
    size_t kept = 0;
    for (size_t t = 0; t < box.triangle_count; ++t) {
        const uint32_t *corners = &box.triangles[3 * t];
        bool top = true;
        for (size_t c = 0; c < 3; ++c) {
            top = top && box.positions[3 * corners[c] + 1] == 2.0;
        }
        if (!top) {
            memmove(&box.triangles[3 * kept++], corners, 3 * sizeof(uint32_t));
        }
    }
    box.triangle_count = kept;
    assert_close(pci_winding_number(&box, centre), 5.0 / 6.0, 1e-12);
    pc_mesh_free(context, &box);
    pc_context_destroy(context);
}

// A sphere: every grid point has the exact distance where it matters, with the right sign.
static void fields_of_spheres_are_exact(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_mesh sphere = shape_sphere(context, 12, 1.0);
    pci_scratch scratch = pci_scratch_begin(context);
    pci_distance_field field = {0};
    const double margin = 0.2;
    assert_ok(context, pci_distance_field_build(&scratch, "test", &sphere, 0.1, margin, &field));
    size_t inside = 0;
    for (size_t i = 0; i < (size_t)field.size[0] * field.size[1] * field.size[2]; ++i) {
        const size_t at[3] = {i % field.size[0], i / field.size[0] % field.size[1],
                              i / field.size[0] / field.size[1]};
        double point[3];
        for (size_t k = 0; k < 3; ++k) {
            point[k] = field.origin[k] + 0.1 * (double)at[k];
        }
        const double exact = pci_norm(point) - 1.0, value = (double)field.values[i];
        assert_true(field.triangles[i] < sphere.triangle_count);
        // The mesh lies inside of the sphere by at most the sagitta of its triangles.
        if (exact < -0.02 || (exact > 0.0 && exact < margin)) {
            assert_close(value, exact, 0.02);
        } else if (exact >= margin) {
            assert_true(value > 0.0 && value <= exact + 0.02);
        }
        inside += value < 0.0;
    }
    // 4/3 pi / 0.1^3 = 4189 points.
    assert_in_range(inside, 3950, 4300);

    double distance, gradient[3];
    size_t nearest;
    for (uint64_t i = 0; i < 1000; ++i) {
        double point[3];
        for (size_t k = 0; k < 3; ++k) {
            point[k] = 2.2 * pci_random(5, k, i) - 1.1;
        }
        const double radius = pci_norm(point);
        if (radius < 0.4 || radius > 1.15) {
            continue;
        }
        assert_true(pci_distance_field_sample(&field, point, &distance, gradient, &nearest));
        assert_close(distance, radius - 1.0, 0.03);
        assert_true(pci_dot(gradient, point) / (radius * pci_norm(gradient)) > 0.97);
        assert_close(pci_norm(gradient), 1.0, 0.15);
        double left[3], right[3], high, low, unused[3];
        for (size_t k = 0; k < 3; ++k) {
            memcpy(left, point, sizeof(left));
            memcpy(right, point, sizeof(right));
            left[k] -= 1e-6;
            right[k] += 1e-6;
            assert_true(pci_distance_field_sample(&field, left, &low, unused, &nearest));
            assert_true(pci_distance_field_sample(&field, right, &high, unused, &nearest));
            if (floor((left[k] - field.origin[k]) / 0.1) ==
                floor((right[k] - field.origin[k]) / 0.1)) { // the gradient jumps between cells
                assert_close((high - low) / 2e-6, gradient[k], 1e-7);
            }
        }
    }
    const double far[3] = {5.0, 0.0, 0.0}, broken[3] = {NAN, 0.0, 0.0};
    assert_false(pci_distance_field_sample(&field, far, &distance, gradient, &nearest));
    assert_false(pci_distance_field_sample(&field, broken, &distance, gradient, &nearest));
    pci_scratch_end(&scratch);
    pc_mesh_free(context, &sphere);
    pc_context_destroy(context);
}

// Signs of the tree of dipoles are those of the exact winding number, also of parts that overlap,
// of a mesh with a hole, and at any number of threads.
static void signs_are_those_of_the_exact_number(void **state) {
    (void)state;
    static const uint32_t threads[] = {1, 2, 3, 8};
    float *first = NULL;
    for (size_t run = 0; run < 4; ++run) {
        pc_context *context = test_context(threads[run]);
        pc_mesh body = shape_sphere(context, 8, 1.0), box = shape_box(context, 2, 3, 2);
        shape_append(context, &body, &box, false);
        body.triangle_count -= 2; // a hole
        pci_scratch scratch = pci_scratch_begin(context);
        pci_distance_field field = {0};
        assert_ok(context, pci_distance_field_build(&scratch, "test", &body, 0.17, 0.3, &field));
        const size_t count = (size_t)field.size[0] * field.size[1] * field.size[2];
        size_t wrong = 0;
        for (size_t i = 0; i < count && run == 0; ++i) {
            const size_t at[3] = {i % field.size[0], i / field.size[0] % field.size[1],
                                  i / field.size[0] / field.size[1]};
            double point[3];
            for (size_t k = 0; k < 3; ++k) {
                point[k] = field.origin[k] + 0.17 * (double)at[k];
            }
            wrong += (field.values[i] < 0.0F) != (pci_winding_number(&body, point) > 0.5);
        }
        assert_true(wrong <= count / 2000); // next to the hole
        if (run == 0) {
            first = malloc(count * sizeof(float));
            assert_non_null(first);
            memcpy(first, field.values, count * sizeof(float));
        }
        assert_memory_equal(first, field.values, count * sizeof(float));
        pci_scratch_end(&scratch);
        pc_mesh_free(context, &box);
        pc_mesh_free(context, &body);
        pc_context_destroy(context);
    }
    free(first);
}

static void errors_are_reported(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh box = shape_box(context, 1, 1, 1);
    pci_scratch scratch = pci_scratch_begin(context);
    pci_distance_field field = {0};
    assert_int_equal(pci_distance_field_build(&scratch, "test", &box, 1e-4, 0.1, &field),
                     PC_ERROR_TOO_LARGE);
    pci_scratch_end(&scratch);
    pc_mesh_free(context, &box);
    pc_context_destroy(context);

    context = test_cancelling_context();
    box = shape_box(context, 1, 1, 1);
    scratch = pci_scratch_begin(context);
    assert_int_equal(pci_distance_field_build(&scratch, "test", &box, 0.01, 0.1, &field),
                     PC_ERROR_CANCELLED);
    pci_scratch_end(&scratch);
    pc_mesh_free(context, &box);
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(winding_numbers_tell_inside_from_outside),
        cmocka_unit_test(fields_of_spheres_are_exact),
        cmocka_unit_test(signs_are_those_of_the_exact_number),
        cmocka_unit_test(errors_are_reported),
    };
    return cmocka_run_group_tests_name("distance_field", tests, NULL, NULL);
}
