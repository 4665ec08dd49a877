#include "support/test.h"

#include "geometry/knn.h"
#include "support/skin_fixture.h"

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
        for (size_t t = 0; t < frames; ++t) {
            pci_skin_problem frame = f.problem;
            frame.frame_count = 1;
            frame.frames += 3 * frame.proxy_count * t;
            assert_ok(f.context, pci_skin_measure(f.context, &frame, pci_skin_kernel_double(),
                                                  f.weights, &measures));
            memcpy(&per_frame[3 * t], measures.losses, sizeof(measures.losses));
        }
        assert_vectors_close(per_frame, reference, 3 * frames, 1e-11);
        assert_ok(f.context, pci_skin_measure(f.context, &f.problem, pci_skin_kernel_double(),
                                              f.weights, &measures));
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
                                           weights, &measures));
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
        uint32_t ranks[POINTS];
        for (uint32_t i = 0; i < POINTS; ++i) {
            ranks[i] = seed == 1 ? POINTS - 1 - i : i;
        }
        knn.ranks = seed == 0 ? NULL : ranks;
        for (uint32_t q = 0; q < POINTS; ++q) {
            uint32_t found[WANTED];
            double squared[WANTED], last = -1.0;
            const uint32_t excluded = q % 2 == 0 ? q : PC_INVALID_INDEX;
            assert_int_equal(pci_knn_query(&knn, &points[3 * q], WANTED, excluded, found, squared),
                             WANTED);
            // Selection by (distance, rank), one after the other.
            uint32_t before = PC_INVALID_INDEX;
            for (size_t rank = 0; rank < WANTED; ++rank) {
                uint32_t best = PC_INVALID_INDEX;
                double best_distance = INFINITY;
                for (uint32_t r = 0; r < POINTS; ++r) {
                    const uint32_t i = seed == 1 ? POINTS - 1 - r : r;
                    const double d = pci_squared_distance(&points[3 * q], &points[3 * i]);
                    const bool later =
                        d > last || (d == last && before != PC_INVALID_INDEX && r > before);
                    if (i != excluded && later && d < best_distance) {
                        best = i;
                        best_distance = d;
                    }
                }
                assert_int_equal(found[rank], best);
                assert_close(squared[rank], best_distance, 0.0);
                last = best_distance;
                before = ranks[best];
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
                    residual -= pci_skin_near_weight(p, v, k) * moved[3 * (size_t)p->near[k] + a];
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
                                              f.weights, &exact));
        assert_ok(f.context, pci_skin_measure(f.context, &f.problem, pci_skin_kernel_float(),
                                              f.weights, &fast));
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
                                                  f.weights, &high));
            f.weights[k] = weight - step;
            assert_ok(f.context, pci_skin_measure(f.context, &f.problem, pci_skin_kernel_double(),
                                                  f.weights, &low));
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
    const bool usable[3] = {true, __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"),
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
                                                      f.weights, &measures[i]));
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
    const bool usable[3] = {true, __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"),
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
    };
    return cmocka_run_group_tests_name("skin_kernel", tests, NULL, NULL);
}
