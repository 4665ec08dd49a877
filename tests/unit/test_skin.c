#include "support/test.h"

#include "core/knn.h"
#include "support/memory.h"
#include "support/skin_fixture.h"
#include "support/surfaces.h"

static double norm_of(const double *x, size_t count) {
    double sum = 0.0;
    for (size_t i = 0; i < count; ++i) {
        sum += x[i] * x[i];
    }
    return sqrt(sum);
}

static void assert_vectors_close(const double *x, const double *y, size_t count, double relative) {
    double sum = 0.0;
    for (size_t i = 0; i < count; ++i) {
        sum += (x[i] - y[i]) * (x[i] - y[i]);
    }
    assert_close(sqrt(sum), 0.0, relative * norm_of(y, count));
}

// dL/dw -> dL/ds through w = |s| / sum |s|.
static void chain_to_surrogate(const fixture *f, const double *gradient, double *result) {
    const uint32_t slots = f->problem.slots;
    for (size_t v = 0; v < f->problem.vertex_count; ++v) {
        double sum = 0.0, mean = 0.0;
        for (size_t k = v * slots; k < (v + 1) * slots; ++k) {
            sum += fabs(f->surrogate[k]);
            mean += f->weights[k] * gradient[k];
        }
        for (size_t k = v * slots; k < (v + 1) * slots; ++k) {
            result[k] = (f->surrogate[k] < 0.0 ? -1.0 : 1.0) * (gradient[k] - mean) / sum;
        }
    }
}

static const char *const fixture_names[] = {"tiny", "dress796", "fedora"};

static void losses_match_the_fixtures(void **state) {
    (void)state;
    for (size_t i = 0; i < 3; ++i) {
        fixture f;
        load_fixture(fixture_names[i], 2, &f);
        const size_t frames = f.problem.frame_count;
        double *reference = expected(&f, "per_frame", 3 * frames);
        double *per_frame = calloc(3 * frames, sizeof(double));
        pci_skin_measures measures;
        assert_ok(f.context, pci_skin_measure(f.context, &f.problem, pci_skin_kernel_double(),
                                              f.weights, &measures, per_frame));
        assert_vectors_close(per_frame, reference, 3 * frames, 1e-11);
        static const char *const keys[] = {"L_r", "L_c", "L_a"};
        for (size_t x = 0; x < 3; ++x) {
            const double value = expected_number(&f, keys[x]);
            assert_close(measures.losses[x], value, 1e-11 * value);
        }
        // In "tiny" the rings are planar: the sign of a determinant is rounding there.
        if (i > 0) {
            assert_int_equal(measures.reflections, (uint64_t)expected_number(&f, "reflections_r"));
        }
        static const char *const norm_keys[] = {"r", "c", "a"};
        for (size_t x = 0; x < 3; ++x) {
            const double value = expected_number(&f, norm_keys[x]);
            assert_close(f.problem.norms[x], value, 1e-12 * value);
        }
        free(reference);
        free(per_frame);
        free_fixture(&f);
    }
}

static void neighbours_match_the_fixtures(void **state) {
    (void)state;
    for (size_t i = 0; i < 3; ++i) {
        fixture f;
        load_fixture(fixture_names[i], 1, &f);
        const pci_skin_problem *p = &f.problem;
        for (size_t e = 0; e < p->vertex_count * p->near_count; ++e) {
            const double *from = &p->rest[3 * (e / p->near_count)];
            const double ours = pci_squared_distance(from, &p->rest[3 * (size_t)f.own_near[e]]);
            const double theirs = pci_squared_distance(from, &p->rest[3 * (size_t)p->near[e]]);
            assert_close(sqrt(ours), sqrt(theirs), 1e-12);
        }
        free_fixture(&f);
    }
}

static void gradients_match_the_fixtures(void **state) {
    (void)state;
    for (size_t i = 0; i < 3; ++i) {
        fixture f;
        load_fixture(fixture_names[i], 2, &f);
        double *gradient = calloc(f.count, sizeof(double));
        double *chained = calloc(f.count, sizeof(double));
        double *given = expected(&f, "lambda_", 3);
        const double lambda[4] = {given[0], given[1], given[2], 0.0};
        size_t count = 0;
        assert_ok(f.context, pci_skin_gradient(f.context, &f.problem, pci_skin_kernel_double(),
                                               f.weights, lambda, gradient));
        chain_to_surrogate(&f, gradient, chained);
        double *reference = test_read_numbers(path_of(&f, "gradS_total.csv"), &count);
        assert_int_equal(count, f.count);
        assert_vectors_close(chained, reference, f.count, 1e-9);
        free(reference);
        for (size_t x = 0; x < 3 && i == 0; ++x) {
            static const char *const files[] = {"gradW_r.csv", "gradW_c.csv", "gradW_a.csv"};
            const double scale[4] = {x == 0, x == 1, x == 2};
            assert_ok(f.context, pci_skin_gradient(f.context, &f.problem, pci_skin_kernel_double(),
                                                   f.weights, scale, gradient));
            reference = test_read_numbers(path_of(&f, files[x]), &count);
            assert_vectors_close(gradient, reference, f.count, 1e-10);
            free(reference);
        }
        free(given);
        free(gradient);
        free(chained);
        free_fixture(&f);
    }
}

static double normalised_loss(const fixture *f, const double *surrogate, const double lambda[3]) {
    double *weights = calloc(f->count, sizeof(double)), sum = 0.0;
    for (size_t v = 0; v < f->problem.vertex_count; ++v) {
        const uint32_t slots = f->problem.slots;
        pci_skin_normalize(&surrogate[v * slots], slots, &weights[v * slots]);
    }
    pci_skin_measures measures;
    assert_ok(f->context, pci_skin_measure(f->context, &f->problem, pci_skin_kernel_double(),
                                           weights, &measures, NULL));
    for (size_t x = 0; x < 3; ++x) {
        sum +=
            lambda[x] * measures.losses[x] / (f->problem.norms[x] * (double)f->problem.frame_count);
    }
    free(weights);
    return sum;
}

static void adamw_follows_the_fixtures(void **state) {
    (void)state;
    for (size_t i = 0; i < 3; ++i) {
        fixture f;
        load_fixture(fixture_names[i], 2, &f);
        double *lambda = expected(&f, "lambda_", 3);
        double *history = expected(&f, "adamw20_normalised_history", 20);
        double *surrogate = calloc(f.count, sizeof(double));
        static const uint32_t checked[] = {0, 1, 5, 19};
        for (size_t c = 0; c < 4; ++c) {
            const uint32_t steps = checked[c];
            memcpy(surrogate, f.surrogate, f.count * sizeof(double));
            const pci_skin_descent settings = {.lambda = {lambda[0], lambda[1], lambda[2]},
                                               .epochs = steps,
                                               .batch = (uint32_t)f.problem.frame_count,
                                               .learning_rate = 1e-3,
                                               .weight_decay = 0.01,
                                               .epsilon = 1e-8};
            assert_ok(f.context, pci_skin_descend(f.context, &f.problem, pci_skin_kernel_double(),
                                                  &settings, surrogate));
            assert_close(normalised_loss(&f, surrogate, lambda), history[steps],
                         1e-9 * history[steps]);
        }
        free(lambda);
        free(history);
        free(surrogate);
        free_fixture(&f);
    }
}

// ---- nearest neighbours -------------------------------------------------------------------------

static void nearest_neighbours_match_brute_force(void **state) {
    (void)state;
    enum { POINTS = 500, WANTED = 9 };
    pc_context *context = test_context(1);
    pci_scratch scratch = pci_scratch_begin(context);
    for (uint32_t seed = 0; seed < 3; ++seed) {
        // On a coarse lattice, so most distances are ties and many points coincide.
        double points[3 * POINTS];
        for (size_t k = 0; k < 3 * POINTS; ++k) {
            points[k] = floor((seed == 0 ? 4.0 : 9.0) * pci_random(seed, 1, k));
            points[k] += seed == 2 ? pci_random(seed, 2, k) : 0.0;
        }
        pci_knn knn;
        assert_true(pci_knn_build(&scratch, POINTS, points, &knn));
        for (uint32_t q = 0; q < POINTS; ++q) {
            uint32_t found[WANTED];
            double squared[WANTED], last = -1.0;
            const uint32_t excluded = q % 2 == 0 ? q : PC_INVALID_INDEX;
            assert_int_equal(pci_knn_query(&knn, &points[3 * q], WANTED, excluded, found, squared),
                             WANTED);
            // Selection by (distance, index), one after the other.
            uint32_t before = PC_INVALID_INDEX;
            for (size_t rank = 0; rank < WANTED; ++rank) {
                uint32_t best = PC_INVALID_INDEX;
                double best_distance = INFINITY;
                for (uint32_t i = 0; i < POINTS; ++i) {
                    const double d = pci_squared_distance(&points[3 * q], &points[3 * i]);
                    const bool later =
                        d > last || (d == last && before != PC_INVALID_INDEX && i > before);
                    if (i != excluded && later && d < best_distance) {
                        best = i;
                        best_distance = d;
                    }
                }
                assert_int_equal(found[rank], best);
                assert_close(squared[rank], best_distance, 0.0);
                last = best_distance;
                before = best;
            }
            // The first of them is found within any radius that reaches it, and none within less.
            if (excluded == PC_INVALID_INDEX) {
                const double centre[3] = {points[3 * q] + 0.5, points[3 * q + 1] + 0.25,
                                          points[3 * q + 2]};
                uint32_t nearest;
                assert_int_equal(pci_knn_query(&knn, centre, 1, excluded, found, squared), 1);
                assert_true(
                    pci_knn_within(&knn, centre, sqrt(squared[0]) * (1.0 + 1e-15), &nearest));
                assert_int_equal(nearest, found[0]);
                assert_true(pci_knn_within(&knn, centre, sqrt(squared[0]) * (1.0 + 1e-15), NULL));
                assert_false(
                    pci_knn_within(&knn, centre, sqrt(squared[0]) * (1.0 - 1e-15), &nearest));
                assert_false(pci_knn_within(&knn, centre, sqrt(squared[0]) * (1.0 - 1e-15), NULL));
            }
        }
    }
    // Fewer points than wanted.
    const double two[6] = {0, 0, 0, 1, 0, 0};
    pci_knn knn;
    uint32_t found[5];
    double squared[5];
    assert_true(pci_knn_build(&scratch, 2, two, &knn));
    assert_int_equal(pci_knn_query(&knn, &two[3], 5, 1, found, squared), 1);
    assert_int_equal(found[0], 0);
    pci_scratch_end(&scratch);
    pc_context_destroy(context);
}

// ---- rotations ----------------------------------------------------------------------------------

static void to_matrix(const double q[4], double r[9]) {
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    const double m[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z),     2 * (x * z + w * y),
                         2 * (x * y + w * z),     1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                         2 * (x * z - w * y),     2 * (y * z + w * x),     1 - 2 * (x * x + y * y)};
    memcpy(r, m, sizeof(m));
}

static double trace_product(const double r[9], const double s[9]) {
    double sum = 0.0;
    for (size_t k = 0; k < 9; ++k) {
        sum += r[k] * s[k];
    }
    return sum;
}

// No rotation out of many is better than the one found; for S that is symmetric positive definite
// times a rotation, the answer is that rotation.
static void jacobi_rotations_are_optimal(void **state) {
    (void)state;
    for (uint64_t i = 0; i < 200; ++i) {
        double s[9], q[4], r[9];
        for (size_t k = 0; k < 9; ++k) {
            s[k] = 2.0 * pci_random(1, i, k) - 1.0;
            // Planar, linear and reflected cases as well.
            s[k] *= (i % 4 == 1 && k % 3 == 2) || (i % 4 == 2 && k % 3 > 0) ? 0.0 : 1.0;
        }
        pci_rotation_by_jacobi(s, q);
        assert_close(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3], 1.0, 1e-14);
        to_matrix(q, r);
        const double best = trace_product(r, s);
        for (uint64_t j = 0; j < 2000; ++j) {
            double other[4], norm = 0.0, turned[9];
            for (size_t k = 0; k < 4; ++k) {
                // Half of them close by.
                other[k] = pci_random(2, j, k) - 0.5;
                other[k] = j % 2 == 0 ? other[k] : q[k] + 0.1 * other[k];
                norm += other[k] * other[k];
            }
            for (size_t k = 0; k < 4; ++k) {
                other[k] /= sqrt(norm);
            }
            to_matrix(other, turned);
            assert_true(trace_product(turned, s) <= best + 1e-13);
        }
    }
    const double zero[9] = {0};
    double q[4];
    pci_rotation_by_jacobi(zero, q);
    assert_close(q[0], 1.0, 0.0);
}

// ---- kernels ------------------------------------------------------------------------------------

// Frames in which every proxy vertex jumps at random: rings fold over and turn inside out, and
// rotations of one frame are no guess for the next.
static void shake(fixture *f, size_t frame_count, double amplitude) {
    pci_skin_problem *p = &f->problem;
    free(f->frames);
    f->frames = calloc(3 * p->proxy_count * frame_count, sizeof(double));
    for (size_t t = 0; t < frame_count; ++t) {
        for (size_t k = 0; k < 3 * p->proxy_count; ++k) {
            f->frames[3 * p->proxy_count * t + k] =
                p->proxy_rest[k] + amplitude * (2.0 * pci_random(9, t, k) - 1.0);
        }
    }
    p->frames = f->frames;
    p->frame_count = frame_count;
    if (p->rotations != NULL) {
        turn_at_random(f);
    }
}

// Of one frame, or NULL.
static const double *rotations_of(const pci_skin_problem *p, size_t frame) {
    return p->rotations == NULL ? NULL : &p->rotations[4 * p->proxy_count * frame];
}

// The losses as the paper writes them, one vertex and frame after the other.
static void plain_losses(const fixture *f, double losses[3]) {
    const pci_skin_problem *p = &f->problem;
    const size_t nv = p->vertex_count;
    const pc_skin skin = {
        .vertex_count = nv, .influences = p->slots, .bones = f->bones, .weights = f->weights};
    double *moved = calloc(3 * nv, sizeof(double));
    memset(losses, 0, 3 * sizeof(double));
    for (size_t t = 0; t < p->frame_count; ++t) {
        pc_skin_deform(&skin, p->rest, p->proxy_rest, &p->frames[3 * p->proxy_count * t],
                       rotations_of(p, t), moved);
        for (size_t v = 0; v < nv; ++v) {
            for (size_t x = 0; x < 2; ++x) {
                const uint32_t *list =
                    x == 0 ? &p->ring[p->ring_offsets[v]] : &p->near[v * p->near_count];
                const size_t count =
                    x == 0 ? p->ring_offsets[v + 1] - p->ring_offsets[v] : p->near_count;
                double s[9] = {0}, q[4], r[9];
                for (size_t k = 0; k < 9 * count; ++k) {
                    const size_t j = 3 * (size_t)list[k / 9], a = k % 9 / 3, b = k % 3;
                    s[3 * a + b] +=
                        (moved[3 * v + a] - moved[j + a]) * (p->rest[3 * v + b] - p->rest[j + b]);
                }
                pci_rotation_by_jacobi(s, q);
                to_matrix(q, r);
                for (size_t k = 0; k < 3 * count; ++k) {
                    const size_t j = 3 * (size_t)list[k / 3], a = k % 3;
                    double e[3];
                    pci_sub(&p->rest[3 * v], &p->rest[j], e);
                    const double residual = moved[3 * v + a] - moved[j + a] - pci_dot(&r[3 * a], e);
                    losses[x] += residual * residual;
                }
            }
            for (size_t a = 0; a < 3; ++a) {
                double residual = moved[3 * v + a];
                for (size_t k = v * p->near_count; k < (v + 1) * p->near_count; ++k) {
                    residual -= p->near_weights[k] * moved[3 * (size_t)p->near[k] + a];
                }
                losses[2] += residual * residual;
            }
        }
    }
    free(moved);
}

static void kernels_find_the_global_rotations(void **state) {
    (void)state;
    static const double amplitudes[] = {0.02, 0.2, 1.0, 0.02, 0.2};
    for (size_t i = 0; i < 5; ++i) {
        fixture f;
        load_fixture(i % 3 == 0 ? "tiny" : "fedora", 1, &f);
        if (i >= 3) {
            turn_at_random(&f);
        }
        shake(&f, 19, amplitudes[i]);
        double plain[3];
        plain_losses(&f, plain);
        pci_skin_measures exact, fast;
        assert_ok(f.context, pci_skin_measure(f.context, &f.problem, pci_skin_kernel_double(),
                                              f.weights, &exact, NULL));
        assert_ok(f.context, pci_skin_measure(f.context, &f.problem, pci_skin_kernel_float(),
                                              f.weights, &fast, NULL));
        for (size_t x = 0; x < 3; ++x) {
            assert_close(exact.losses[x], plain[x], 1e-11 * plain[x]);
            assert_close(fast.losses[x], plain[x], 1e-5 * plain[x]);
        }
        assert_true(i % 3 == 0 || exact.reflections > 100);
        free_fixture(&f);
    }
}

static void gradient_matches_central_differences(void **state) {
    (void)state;
    fixture f;
    load_fixture("tiny", 1, &f);
    double *gradient = calloc(f.count, sizeof(double));
    for (size_t i = 0; i < 6; ++i) {
        const size_t x = i % 3;
        if (i == 3) {
            turn_at_random(&f);
        }
        shake(&f, 5, 0.1);
        const double scale[4] = {x == 0, x == 1, x == 2};
        assert_ok(f.context, pci_skin_gradient(f.context, &f.problem, pci_skin_kernel_double(),
                                               f.weights, scale, gradient));
        const double size = norm_of(gradient, f.count) / sqrt((double)f.count);
        for (size_t k = 0; k < f.count; ++k) {
            const double weight = f.weights[k], step = 1e-5;
            pci_skin_measures low, high;
            f.weights[k] = weight + step;
            assert_ok(f.context, pci_skin_measure(f.context, &f.problem, pci_skin_kernel_double(),
                                                  f.weights, &high, NULL));
            f.weights[k] = weight - step;
            assert_ok(f.context, pci_skin_measure(f.context, &f.problem, pci_skin_kernel_double(),
                                                  f.weights, &low, NULL));
            f.weights[k] = weight;
            const double slope = (high.losses[x] - low.losses[x]) / (2.0 * step);
            assert_close(gradient[k], slope, 1e-6 * size);
        }
    }
    free(gradient);
    free_fixture(&f);
}

// sum (|e_ij(t)| - |e_ij(0)|)^2 over directed 1-ring edges and frames.
static double plain_stretch(const fixture *f) {
    const pci_skin_problem *p = &f->problem;
    const pc_skin skin = {.vertex_count = p->vertex_count,
                          .influences = p->slots,
                          .bones = f->bones,
                          .weights = f->weights};
    double *moved = calloc(3 * p->vertex_count, sizeof(double)), sum = 0.0;
    for (size_t t = 0; t < p->frame_count; ++t) {
        pc_skin_deform(&skin, p->rest, p->proxy_rest, &p->frames[3 * p->proxy_count * t],
                       rotations_of(p, t), moved);
        for (size_t v = 0; v < p->vertex_count; ++v) {
            for (size_t e = p->ring_offsets[v]; e < p->ring_offsets[v + 1]; ++e) {
                const size_t j = p->ring[e];
                const double strain = sqrt(pci_squared_distance(&moved[3 * v], &moved[3 * j])) -
                                      sqrt(pci_squared_distance(&p->rest[3 * v], &p->rest[3 * j]));
                sum += strain * strain;
            }
        }
    }
    free(moved);
    return sum;
}

static void stretch_gradient_matches_central_differences(void **state) {
    (void)state;
    fixture f;
    load_fixture("tiny", 1, &f);
    turn_at_random(&f);
    shake(&f, 5, 0.1);
    double *gradient = calloc(f.count, sizeof(double));
    const double scale[4] = {0.0, 0.0, 0.0, 1.0};
    assert_ok(f.context, pci_skin_gradient(f.context, &f.problem, pci_skin_kernel_double(),
                                           f.weights, scale, gradient));
    const double size = norm_of(gradient, f.count) / sqrt((double)f.count);
    for (size_t i = 0; i < f.count; ++i) {
        const double weight = f.weights[i], step = 1e-5;
        f.weights[i] = weight + step;
        const double high = plain_stretch(&f);
        f.weights[i] = weight - step;
        const double low = plain_stretch(&f);
        f.weights[i] = weight;
        assert_close(gradient[i], (high - low) / (2.0 * step), 1e-6 * size);
    }
    free(gradient);
    free_fixture(&f);
}

// In float the rows lack a constant, so the gradients are compared after the chain rule.
static void float_gradient_matches_double(void **state) {
    (void)state;
    for (size_t i = 0; i < 3; ++i) {
        fixture f;
        load_fixture(fixture_names[i], 1, &f);
        const double scale[4] = {1.0, 1.0, 0.1, 2.0};
        double *gradients[2], *chained[2];
        for (size_t k = 0; k < 2; ++k) {
            gradients[k] = calloc(f.count, sizeof(double));
            chained[k] = calloc(f.count, sizeof(double));
            assert_ok(f.context,
                      pci_skin_gradient(f.context, &f.problem,
                                        k == 0 ? pci_skin_kernel_float() : pci_skin_kernel_double(),
                                        f.weights, scale, gradients[k]));
            chain_to_surrogate(&f, gradients[k], chained[k]);
        }
        assert_vectors_close(chained[0], chained[1], f.count, 1e-4);
        for (size_t k = 0; k < 2; ++k) {
            free(gradients[k]);
            free(chained[k]);
        }
        free_fixture(&f);
    }
}

#if defined(__x86_64__)
// The same bits from every instruction set that this machine has.
static void instruction_sets_agree(void **state) {
    (void)state;
    const pci_skin_kernel *const kernels[2][3] = {
        {&pci_skin_generic_float, &pci_skin_avx2_float, &pci_skin_avx512_float},
        {&pci_skin_generic_double, &pci_skin_avx2_double, &pci_skin_avx512_double}};
    const bool usable[3] = {true, __builtin_cpu_supports("avx2") != 0,
                            __builtin_cpu_supports("avx512f") != 0};
    fixture f;
    load_fixture("fedora", 1, &f);
    shake(&f, 21, 0.1);
    for (size_t type = 0; type < 2; ++type) {
        double *first = calloc(f.count, sizeof(double)), *other = calloc(f.count, sizeof(double));
        pci_skin_measures measures[3];
        const double scale[4] = {1.0, 1.0, 0.1, 2.0};
        for (size_t i = 0; i < 3; ++i) {
            if (usable[i]) {
                assert_ok(f.context, pci_skin_gradient(f.context, &f.problem, kernels[type][i],
                                                       f.weights, scale, i == 0 ? first : other));
                assert_ok(f.context, pci_skin_measure(f.context, &f.problem, kernels[type][i],
                                                      f.weights, &measures[i], NULL));
                if (i > 0) {
                    assert_memory_equal(first, other, f.count * sizeof(double));
                    assert_memory_equal(&measures[0], &measures[i], sizeof(measures[0]));
                }
            }
        }
        free(first);
        free(other);
    }
    free_fixture(&f);
}

static void instruction_sets_agree_on_rows(void **state) {
    (void)state;
    const pci_skin_kernel *const kernels[3] = {&pci_skin_generic_float, &pci_skin_avx2_float,
                                               &pci_skin_avx512_float};
    const bool usable[3] = {true, __builtin_cpu_supports("avx2") != 0,
                            __builtin_cpu_supports("avx512f") != 0};
    enum { ROWS = 5, STRIDE = 3 * PCI_SKIN_STRIDE };
    static float moved[ROWS * STRIDE] __attribute__((aligned(64)));
    static float gram[ROWS * STRIDE] __attribute__((aligned(64)));
    static float sum[STRIDE] __attribute__((aligned(64)));
    const uint32_t entries[3] = {4, 0, 3}, numbers[4] = {1, 1, 0, 4};
    const float values[3] = {0.3f, -1.7f, 2.9f};
    for (uint64_t i = 0; i < ROWS * STRIDE; ++i) {
        moved[i] = (float)(pci_random(5, 1, i) - 0.5);
        gram[i] = (float)(pci_random(5, 2, i) - 0.5);
    }
    const pci_skin_rows rows = {.stride = STRIDE,
                                .moved = moved,
                                .gram = gram,
                                .entry_count = 3,
                                .entries = entries,
                                .values = values};
    float first[4], other[4];
    for (size_t i = 0; i < 3; ++i) {
        if (usable[i]) {
            kernels[i]->multiply_rows(&rows, 4, numbers, sum, i == 0 ? first : other);
        }
        if (usable[i] && i > 0) {
            assert_memory_equal(first, other, sizeof(first));
        }
    }
    for (size_t k = 0; k < 4; ++k) {
        double expected = 0.0;
        for (size_t e = 0; e < 3; ++e) {
            for (size_t b = 0; b < STRIDE; ++b) {
                expected += (double)values[e] * (double)moved[entries[e] * STRIDE + b] *
                            (double)gram[numbers[k] * STRIDE + b];
            }
        }
        assert_close((double)first[k], expected, 1e-5);
    }
}
#endif

// ---- the stage ----------------------------------------------------------------------------------

static pc_skin_options quick_options(void) {
    pc_skin_options options;
    pc_record_set_defaults(&pc_skin_options_record, &options);
    options.epochs = 10;
    return options;
}

static void assert_valid_skin(const pc_skin *skin, size_t vertex_count, size_t proxy_count) {
    assert_int_equal(skin->vertex_count, vertex_count);
    for (size_t v = 0; v < vertex_count; ++v) {
        const uint32_t *bones = &skin->bones[v * skin->influences];
        const double *weights = &skin->weights[v * skin->influences];
        double sum = 0.0;
        for (uint32_t k = 0; k < skin->influences; ++k) {
            assert_true(weights[k] >= 0.0 && bones[k] < proxy_count);
            assert_true(k == 0 || weights[k] <= weights[k - 1]);
            assert_true(weights[k] > 0.0 || bones[k] == bones[0]);
            for (uint32_t j = 0; j < k && weights[k] > 0.0; ++j) {
                assert_true(bones[j] != bones[k]);
            }
            sum += weights[k];
        }
        assert_close(sum, 1.0, 1e-12);
    }
}

// Winds that were not trained on: better than following the closest triangle.
static void beats_the_closest_triangle(void **state) {
    (void)state;
    for (size_t i = 1; i < 3; ++i) {
        fixture f;
        load_fixture(fixture_names[i], 2, &f);
        pc_motion train = {0}, unseen = {0};
        make_motion(f.context, &f.proxy, 60, 1, &train);
        make_motion(f.context, &f.proxy, 60, 2, &unseen);
        pc_skin skin = {0}, baseline = {0};
        pc_skin_report report;
        pc_skin_losses ours, theirs;
        pc_skin_options options;
        pc_record_set_defaults(&pc_skin_options_record, &options);
        assert_ok(f.context, pc_skin_closest_triangle(f.context, &f.visual, &f.proxy, &baseline));
        assert_valid_skin(&baseline, f.visual.vertex_count, f.proxy.vertex_count);
        assert_ok(f.context, pc_skin_evaluate(f.context, &f.visual, &f.proxy, &unseen, &baseline,
                                              NULL, &theirs));
        assert_ok(f.context,
                  pc_skin_optimize(f.context, &f.visual, &f.proxy, &train, &options, &skin, NULL));
        assert_int_equal(skin.influences, 4);
        assert_ok(f.context,
                  pc_skin_evaluate(f.context, &f.visual, &f.proxy, &unseen, &skin, NULL, &ours));
        assert_true(ours.rigid < theirs.rigid && ours.collision < theirs.collision);
        pc_skin_free(f.context, &skin);
        options.influences = 8;      // the paper's
        options.lambda_follow = 0.0; // the paper's losses alone
        options.equal_edges = false;
        options.lambda_stretch = 0.0;
        assert_ok(f.context, pc_skin_optimize(f.context, &f.visual, &f.proxy, &train, &options,
                                              &skin, &report));
        assert_valid_skin(&skin, f.visual.vertex_count, f.proxy.vertex_count);
        assert_int_equal(skin.influences, 8);
        assert_ok(f.context,
                  pc_skin_evaluate(f.context, &f.visual, &f.proxy, &unseen, &skin, NULL, &ours));
        assert_true(ours.rigid < 0.6 * theirs.rigid);
        assert_true(ours.collision < 0.6 * theirs.collision);
        assert_true(report.loss_after < 0.6 * report.loss_before);
        assert_true(report.full_loss < report.loss_before);
        assert_true(report.rigid_after < report.rigid_before);
        assert_in_range(report.bones_used, 1, f.proxy.vertex_count);
        // The report is the losses of the result, in float.
        assert_ok(f.context,
                  pc_skin_evaluate(f.context, &f.visual, &f.proxy, &train, &skin, NULL, &ours));
        const double rigid = ours.rigid / (60.0 * ours.rigid_norm);
        const double collision = ours.collision / (60.0 * ours.collision_norm);
        assert_close(report.rigid_after, rigid, 1e-6 * rigid);
        assert_close(report.collision_after, collision, 1e-6 * collision);
        pc_skin_free(f.context, &skin);
        pc_skin_free(f.context, &baseline);
        pc_motion_free(f.context, &train);
        pc_motion_free(f.context, &unseen);
        free_fixture(&f);
    }
}

// Up to the most influences that the options take, where twice as many candidates are too many.
static void many_influences_work(void **state) {
    (void)state;
    fixture f;
    load_fixture("dress796", 1, &f);
    pc_motion motion = {0};
    make_motion(f.context, &f.proxy, 16, 1, &motion);
    for (uint32_t influences = 16; influences <= 32; influences += 8) {
        pc_skin skin = {0};
        pc_skin_options options;
        pc_record_set_defaults(&pc_skin_options_record, &options);
        options.influences = influences;
        options.rounds = 4;
        assert_ok(f.context,
                  pc_skin_optimize(f.context, &f.visual, &f.proxy, &motion, &options, &skin, NULL));
        assert_int_equal(skin.influences, influences);
        assert_valid_skin(&skin, f.visual.vertex_count, f.proxy.vertex_count);
        pc_skin_free(f.context, &skin);
    }
    pc_motion_free(f.context, &motion);
    free_fixture(&f);
}

// Two sheets close together, each with its own proxy, that slide apart: L_c cannot be satisfied and
// must not bend the sheets. With lambda_r = 0 it keeps its full weight.
static void collisions_do_not_cost_the_shape(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh surface = test_sheet(context, 12, 12, 1.0, 1.0),
            proxy = test_sheet(context, 4, 4, 1.0, 1.0);
    pc_mesh surfaces = {0}, proxies = {0};
    const pc_mesh *const parts[2] = {&surface, &proxy};
    pc_mesh *const pairs[2] = {&surfaces, &proxies};
    for (size_t i = 0; i < 2; ++i) {
        const size_t nv = parts[i]->vertex_count, nf = parts[i]->triangle_count;
        pairs[i]->vertex_count = 2 * nv;
        pairs[i]->triangle_count = 2 * nf;
        pairs[i]->positions = PCI_ALLOCATE(context, double, 6 * nv);
        pairs[i]->triangles = PCI_ALLOCATE(context, uint32_t, 6 * nf);
        for (size_t k = 0; k < 6 * nv; ++k) {
            pairs[i]->positions[k] =
                parts[i]->positions[k % (3 * nv)] + (k >= 3 * nv && k % 3 == 2 ? 0.02 : 0.0);
        }
        for (size_t k = 0; k < 6 * nf; ++k) {
            pairs[i]->triangles[k] =
                parts[i]->triangles[k % (3 * nf)] + (k >= 3 * nf ? (uint32_t)nv : 0);
        }
    }
    enum { FRAMES = 16 };
    const size_t np = proxies.vertex_count;
    double *frames = calloc(3 * np * FRAMES, sizeof(double));
    for (size_t t = 0; t < FRAMES; ++t) {
        for (size_t v = 0; v < np; ++v) {
            double *at = &frames[3 * (np * t + v)];
            memcpy(at, &proxies.positions[3 * v], 3 * sizeof(double));
            at[0] += (v < np / 2 ? 0.02 : -0.02) * (double)t;
            at[2] += 0.2 * sin(3.0 * at[0] + (double)t);
        }
    }
    const pc_motion motion = {.frame_count = FRAMES, .vertex_count = np, .positions = frames};
    pc_skin_options options = quick_options();
    options.epochs = 60;
    options.lambda_follow = 0.0;
    options.lambda_stretch = 0.0;
    pc_skin_report report;
    for (options.solver = 0; options.solver <= PC_SKIN_ADAMW; ++options.solver) {
        pc_skin skin = {0}, free_skin = {0};
        options.lambda_rigid = 1.0;
        assert_ok(context, pc_skin_optimize(context, &surfaces, &proxies, &motion, &options, &skin,
                                            &report));
        assert_true(report.collision_before > 2.0 * report.rigid_before);
        assert_true(report.spatial_share < 0.5 && report.spatial_share > 0.0);
        assert_true(report.rigid_after < 0.5 * report.rigid_before);
        options.lambda_rigid = 0.0;
        assert_ok(context, pc_skin_optimize(context, &surfaces, &proxies, &motion, &options,
                                            &free_skin, &report));
        assert_close(report.spatial_share, 1.0, 0.0);
        assert_true(report.collision_after < report.collision_before);
        pc_skin_free(context, &skin);
        pc_skin_free(context, &free_skin);
    }
    free(frames);
    pc_mesh_free(context, &surface);
    pc_mesh_free(context, &proxy);
    pc_mesh_free(context, &surfaces);
    pc_mesh_free(context, &proxies);
    pc_context_destroy(context);
}

static void threads_give_the_same_bytes(void **state) {
    (void)state;
    static const uint32_t threads[] = {1, 2, 3, 8};
    pc_skin first = {0};
    pc_skin_report first_report;
    for (size_t i = 0; i < 8; ++i) {
        fixture f;
        load_fixture("dress796", threads[i % 4], &f);
        pc_motion motion = {0};
        make_motion(f.context, &f.proxy, 37, 1, &motion);
        pc_skin_options options = quick_options();
        options.solver = i < 4 ? PC_SKIN_ALTERNATE : PC_SKIN_ADAMW;
        pc_skin skin = {0};
        pc_skin_report report;
        assert_ok(f.context, pc_skin_optimize(f.context, &f.visual, &f.proxy, &motion, &options,
                                              &skin, &report));
        pc_motion_free(f.context, &motion);
        if (i % 4 == 0) {
            first = skin;
            first_report = report;
        } else {
            const size_t count = skin.vertex_count * skin.influences;
            assert_memory_equal(skin.bones, first.bones, count * sizeof(uint32_t));
            assert_memory_equal(skin.weights, first.weights, count * sizeof(double));
            assert_memory_equal(&report, &first_report, sizeof(report));
            pc_skin_free(f.context, &skin);
        }
        if (i % 4 == 3) {
            pc_skin_free(f.context, &first);
        }
        free_fixture(&f);
    }
}

// A rigid translation deforms nothing; the unit of the file changes no weight.
static void translation_and_unit_do_not_matter(void **state) {
    (void)state;
    fixture f;
    load_fixture("tiny", 1, &f);
    pc_motion motion = {0};
    make_motion(f.context, &f.proxy, 16, 1, &motion);
    const pc_skin_options options = quick_options();
    pc_skin skin = {0}, scaled = {0};
    assert_ok(f.context,
              pc_skin_optimize(f.context, &f.visual, &f.proxy, &motion, &options, &skin, NULL));
    const size_t np = f.proxy.vertex_count;
    for (size_t k = 0; k < 3 * np * motion.frame_count; ++k) {
        motion.positions[k] *= 1024.0;
    }
    for (size_t k = 0; k < 3 * np; ++k) {
        f.proxy.positions[k] *= 1024.0;
    }
    for (size_t k = 0; k < 3 * f.visual.vertex_count; ++k) {
        f.visual.positions[k] *= 1024.0;
    }
    assert_ok(f.context,
              pc_skin_optimize(f.context, &f.visual, &f.proxy, &motion, &options, &scaled, NULL));
    for (size_t i = 0; i < 4 * f.visual.vertex_count; ++i) {
        assert_int_equal(skin.bones[i], scaled.bones[i]);
        assert_close(skin.weights[i], scaled.weights[i], 1e-9);
    }
    pc_skin_losses still, moving;
    for (size_t t = 0; t < motion.frame_count; ++t) {
        for (size_t k = 0; k < 3 * np; ++k) {
            motion.positions[3 * np * t + k] = f.proxy.positions[k];
        }
    }
    assert_ok(f.context,
              pc_skin_evaluate(f.context, &f.visual, &f.proxy, &motion, &scaled, NULL, &still));
    for (size_t k = 0; k < 3 * np * motion.frame_count; ++k) {
        motion.positions[k] += k % 3 == 0 ? 300.0 : -100.0;
    }
    assert_ok(f.context,
              pc_skin_evaluate(f.context, &f.visual, &f.proxy, &motion, &scaled, NULL, &moving));
    assert_close(moving.rigid, 0.0, 1e-18 * moving.rigid_norm);
    assert_close(moving.collision, 0.0, 1e-18 * moving.collision_norm);
    assert_close(moving.attachment, still.attachment, 1e-12 * still.attachment);
    pc_skin_free(f.context, &skin);
    pc_skin_free(f.context, &scaled);
    pc_motion_free(f.context, &motion);
    free_fixture(&f);
}

static void deforms_like_the_fixture(void **state) {
    (void)state;
    fixture f;
    load_fixture("tiny", 1, &f);
    size_t count = 0;
    double *reference = test_read_numbers(path_of(&f, "skinned_last.csv"), &count);
    assert_int_equal(count, 3 * f.visual.vertex_count);
    const pc_skin skin = {.vertex_count = f.visual.vertex_count,
                          .influences = f.problem.slots,
                          .bones = f.bones,
                          .weights = f.weights};
    pc_skin_deform(&skin, f.visual.positions, f.proxy.positions,
                   &f.frames[3 * f.proxy.vertex_count * (f.problem.frame_count - 1)], NULL,
                   f.visual.positions);
    for (size_t k = 0; k < count; ++k) {
        assert_close(f.visual.positions[k], reference[k], 1e-14);
    }
    free(reference);
    free_fixture(&f);
}

// Few proxy vertices, one frame, vertices without edges or on the same point, edges of length 0.
static void accepts_degenerate_input(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    double proxy_positions[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
    uint32_t proxy_triangle[3] = {0, 1, 2};
    const pc_mesh proxy = {3, proxy_positions, 1, proxy_triangle};
    double frame[9] = {0, 0, 0, 0, 0, 1, 0.5, 1, 0.5};
    const pc_motion motion = {.frame_count = 1, .vertex_count = 3, .positions = frame};
    double positions[21] = {0, 0, 0, 0.2, 0, 0, 0, 0.2, 0, 0, 0, 0, 5, 5, 5, 0, 0, 0, 0.2, 0, 0};
    uint32_t triangles[12] = {0, 1, 2, 3, 3, 5, 3, 0, 5, 6, 6, 6};
    pc_mesh surface = {7, positions, 4, triangles};
    pc_skin_options options = quick_options();
    for (uint32_t influences = 1; influences <= 12; influences += influences < 4 ? 3 : 8) {
        options.influences = influences;
        options.batch = influences == 4 ? 40 : 1;
        pc_skin skin = {0};
        pc_skin_losses losses;
        assert_ok(context,
                  pc_skin_optimize(context, &surface, &proxy, &motion, &options, &skin, NULL));
        assert_int_equal(skin.influences, influences);
        assert_valid_skin(&skin, 7, 3);
        assert_ok(context,
                  pc_skin_evaluate(context, &surface, &proxy, &motion, &skin, &options, &losses));
        assert_true(isfinite(losses.rigid + losses.collision + losses.attachment));
        pc_skin_free(context, &skin);
    }
    // A single point.
    surface.vertex_count = 1;
    surface.triangle_count = 1;
    memset(triangles, 0, sizeof(triangles));
    pc_skin skin = {0};
    assert_ok(context, pc_skin_optimize(context, &surface, &proxy, &motion, NULL, &skin, NULL));
    assert_valid_skin(&skin, 1, 3);
    pc_skin_free(context, &skin);
    pc_context_destroy(context);
}

static bool stop_half_way(void *user, const char *stage, double fraction) {
    (void)user;
    (void)stage;
    return fraction < 0.5;
}

static void errors_leave_nothing(void **state) {
    (void)state;
    pc_context *context = NULL;
    const pc_context_options context_options = {.threads = 1, .progress = stop_half_way};
    assert_int_equal(pc_context_create(&context_options, &context), PC_OK);
    double positions[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
    double frames[18] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 1, 1};
    uint32_t triangle[3] = {0, 1, 2};
    pc_mesh mesh = {3, positions, 1, triangle};
    pc_motion motion = {.frame_count = 2, .vertex_count = 3, .positions = frames};
    pc_skin skin = {0};
#define OPTIMIZE(options) pc_skin_optimize(context, &mesh, &mesh, &motion, options, &skin, NULL)
    assert_int_equal(OPTIMIZE(NULL), PC_ERROR_CANCELLED);
    assert_null(skin.bones);
    pc_skin_options options = quick_options();
    options.influences = 0;
    assert_int_equal(OPTIMIZE(&options), PC_ERROR_INVALID_OPTIONS);
    options = quick_options();
    options.max_bones = 4;
    options.reserve_bones = 2;
    assert_int_equal(OPTIMIZE(&options), PC_ERROR_TOO_LARGE);
    assert_non_null(strstr(pc_context_error(context)->message, "at most 2 proxy vertices"));
    options.reserve_bones = 4;
    assert_int_equal(OPTIMIZE(&options), PC_ERROR_TOO_LARGE);
    assert_non_null(strstr(pc_context_error(context)->message, "reserve_bones = 4 leaves none"));
    options.reserve_bones = 1; // just enough: goes on until it is cancelled
    assert_int_equal(OPTIMIZE(&options), PC_ERROR_CANCELLED);
    frames[13] = NAN;
    assert_int_equal(OPTIMIZE(NULL), PC_ERROR_NUMERICAL);
    assert_non_null(strstr(pc_context_error(context)->message, "frame 1"));
    frames[13] = 0.0;
    motion.vertex_count = 2;
    assert_int_equal(OPTIMIZE(NULL), PC_ERROR_INVALID_ARGUMENT);
    motion.vertex_count = 3;
    triangle[1] = 3;
    assert_int_equal(OPTIMIZE(NULL), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_skin_closest_triangle(context, &mesh, &mesh, &skin),
                     PC_ERROR_INVALID_ARGUMENT);
    triangle[1] = 1;
    positions[0] = INFINITY;
    assert_int_equal(OPTIMIZE(NULL), PC_ERROR_INVALID_ARGUMENT);
    positions[0] = 0.0;
    assert_int_equal(pc_skin_optimize(context, &mesh, &mesh, NULL, NULL, &skin, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_skin_optimize(context, NULL, &mesh, &motion, NULL, &skin, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_skin_optimize(context, &mesh, &mesh, &motion, NULL, NULL, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_null(skin.bones);
    assert_null(skin.weights);

    assert_ok(context, pc_skin_closest_triangle(context, &mesh, &mesh, &skin));
    assert_int_equal(OPTIMIZE(NULL), PC_ERROR_INVALID_ARGUMENT); // the output is not empty
    pc_skin_losses losses;
    skin.bones[1] = 3;
    assert_int_equal(pc_skin_evaluate(context, &mesh, &mesh, &motion, &skin, NULL, &losses),
                     PC_ERROR_INVALID_ARGUMENT);
    pc_skin_free(context, &skin);
#undef OPTIMIZE
    pc_context_destroy(context);
}

// Every allocation fails once.
static void survives_failing_memory(void **state) {
    (void)state;
    double positions[12] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0};
    double frames[24] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0, 0, 0, 0, 1, 0, 0, 0, 1, 1, 1, 1, 1};
    uint32_t triangles[6] = {0, 1, 2, 1, 3, 2};
    const pc_mesh mesh = {4, positions, 2, triangles};
    const pc_motion motion = {.frame_count = 2, .vertex_count = 4, .positions = frames};
    pc_skin_options options = quick_options();
    options.epochs = 3;
    options.influences = 2;
    for (size_t fail_at = 1; options.solver <= PC_SKIN_ADAMW; ++fail_at) {
        counting_allocator counter = {0};
        pc_context *context = counting_context(&counter);
        const size_t live = counter.live;
        counter.fail_at = counter.calls + fail_at;
        pc_skin skin = {0};
        const pc_status status =
            pc_skin_optimize(context, &mesh, &mesh, &motion, &options, &skin, NULL);
        if (status == PC_OK) {
            ++options.solver;
            fail_at = 0;
        } else {
            assert_int_equal(status, PC_ERROR_OUT_OF_MEMORY);
            assert_null(skin.bones);
            assert_null(skin.weights);
        }
        pc_skin_free(context, &skin);
        assert_int_equal(counter.live, live);
        pc_context_destroy(context);
        assert_true(fail_at < 1000);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(nearest_neighbours_match_brute_force),
        cmocka_unit_test(neighbours_match_the_fixtures),
        cmocka_unit_test(jacobi_rotations_are_optimal),
        cmocka_unit_test(kernels_find_the_global_rotations),
        cmocka_unit_test(losses_match_the_fixtures),
        cmocka_unit_test(gradients_match_the_fixtures),
        cmocka_unit_test(gradient_matches_central_differences),
        cmocka_unit_test(stretch_gradient_matches_central_differences),
        cmocka_unit_test(float_gradient_matches_double),
#if defined(__x86_64__)
        cmocka_unit_test(instruction_sets_agree),
        cmocka_unit_test(instruction_sets_agree_on_rows),
#endif
        cmocka_unit_test(adamw_follows_the_fixtures),
        cmocka_unit_test(beats_the_closest_triangle),
        cmocka_unit_test(many_influences_work),
        cmocka_unit_test(collisions_do_not_cost_the_shape),
        cmocka_unit_test(threads_give_the_same_bytes),
        cmocka_unit_test(translation_and_unit_do_not_matter),
        cmocka_unit_test(deforms_like_the_fixture),
        cmocka_unit_test(accepts_degenerate_input),
        cmocka_unit_test(errors_leave_nothing),
        cmocka_unit_test(survives_failing_memory),
    };
    return cmocka_run_group_tests_name("skin", tests, NULL, NULL);
}
