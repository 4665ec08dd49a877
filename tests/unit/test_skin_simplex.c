// Small programs on the simplex, one for each vertex, against their optimality conditions.
#include "stages/skin/skin_simplex.h"
#include "support/test.h"

enum { MOST = 20 };

// A random program: A of the given rank, g, and a feasible point, possibly with zeros.
static void random_program(uint64_t seed, uint32_t n, uint32_t rank, double *a, double *g,
                           double *w) {
    double sum = 0.0;
    memset(a, 0, n * n * sizeof(*a));
    for (uint32_t r = 0; r < rank; ++r) {
        double row[MOST];
        for (uint32_t k = 0; k < n; ++k) {
            row[k] = 2.0 * pci_random(seed, 1 + r, k) - 1.0;
        }
        for (uint32_t k = 0; k < n * n; ++k) {
            a[k] += row[k / n] * row[k % n];
        }
    }
    for (uint32_t k = 0; k < n; ++k) {
        g[k] = 2.0 * pci_random(seed, 100, k) - 1.0;
        w[k] = pci_random(seed, 101, k) < 0.3 && k > 0 ? 0.0 : pci_random(seed, 102, k) + 0.01;
        sum += w[k];
    }
    for (uint32_t k = 0; k < n; ++k) {
        w[k] /= sum;
    }
}

static double ridge_of(uint32_t n, const double *a) {
    double trace = 0.0;
    for (uint32_t k = 0; k < n; ++k) {
        trace += a[k * n + k];
    }
    return 1e-7 * trace;
}

static double program_value(uint32_t n, const double *a, const double *g, const double *from,
                            const double *x) {
    double value = 0.0;
    for (uint32_t i = 0; i < n; ++i) {
        value += g[i] * (x[i] - from[i]);
        for (uint32_t j = 0; j < n; ++j) {
            value += 0.5 * a[i * n + j] * (x[i] - from[i]) * (x[j] - from[j]);
        }
    }
    return value;
}

static void check_minimum(uint32_t n, const double *a, const double *g0, const double *w0,
                          uint64_t left, const double *g, const double *w) {
    double sum = 0.0, lowest = INFINITY;
    for (uint32_t k = 0; k < n; ++k) {
        double gradient = g0[k];
        for (uint32_t j = 0; j < n; ++j) {
            gradient += a[k * n + j] * (w[j] - w0[j]);
        }
        assert_close(g[k], gradient, 1e-7);
        assert_true(w[k] >= 0.0);
        sum += w[k];
        lowest = (left >> k & 1) == 1 && gradient < lowest ? gradient : lowest;
    }
    assert_close(sum, 1.0, 1e-14);
    for (uint32_t k = 0; k < n; ++k) {
        // In the null space of A only the ridge keeps the step finite.
        assert_true(w[k] < 1e-12 || g[k] <= lowest + 1e-5);
    }
}

// Necessary and sufficient for the minimum of a convex program.
static void programs_meet_the_optimality_conditions(void **state) {
    (void)state;
    for (uint64_t seed = 0; seed < 3000; ++seed) {
        const uint32_t n = 1 + (uint32_t)(seed % MOST);
        const uint32_t rank = 1 + (uint32_t)(pci_random(seed, 7, 7) * MOST);
        double a[MOST * MOST], g0[MOST], w0[MOST], g[MOST], w[MOST];
        random_program(seed, n, rank, a, g0, w0);
        memcpy(g, g0, sizeof(g));
        memcpy(w, w0, sizeof(w));
        pci_simplex_minimize(n, a, ridge_of(n, a), w, g);
        check_minimum(n, a, g0, w0, ~(uint64_t)0, g, w);
    }
}

// So are they for the slots that are left when others were taken away.
static void pruned_programs_meet_the_optimality_conditions(void **state) {
    (void)state;
    for (uint64_t seed = 0; seed < 2000; ++seed) {
        const uint32_t n = 2 + (uint32_t)(seed % (MOST - 1));
        const uint32_t rank = 1 + (uint32_t)(pci_random(seed, 7, 7) * MOST);
        const uint32_t kept = 1 + (uint32_t)(pci_random(seed, 7, 8) * (n - 1));
        double a[MOST * MOST], g0[MOST], w0[MOST], g[MOST], w[MOST];
        random_program(seed, n, rank, a, g0, w0);
        memcpy(g, g0, sizeof(g));
        memcpy(w, w0, sizeof(w));
        const uint64_t left = pci_simplex_prune(n, a, ridge_of(n, a), kept, w, g);
        uint32_t count = 0;
        for (uint32_t k = 0; k < n; ++k) {
            count += (uint32_t)(left >> k & 1);
            assert_true((left >> k & 1) == 1 || w[k] == 0.0);
        }
        assert_int_equal(count, kept);
        check_minimum(n, a, g0, w0, left, g, w);
    }
}

// The slot whose loss costs least, against solving without each of them in turn. The cost that
// ignores signs is exact where the others stay positive.
static void the_cheapest_slot_goes(void **state) {
    (void)state;
    size_t compared = 0;
    for (uint64_t seed = 0; seed < 400; ++seed) {
        const uint32_t n = 5;
        double a[MOST * MOST], g[MOST], w[MOST], costs[MOST];
        random_program(seed, n, MOST, a, g, w);
        pci_simplex_minimize(n, a, ridge_of(n, a), w, g);
        uint32_t cheapest = 0;
        bool interior = true;
        for (uint32_t out = 0; out < n; ++out) {
            // Minimum over the others, by the same solver on a smaller program from w without it.
            double b[MOST * MOST], h[MOST], x[MOST], full[MOST] = {0};
            const double left = 1.0 - w[out];
            interior = interior && w[out] > 0.0;
            for (uint32_t i = 0; i < n; ++i) {
                full[i] = i == out ? 0.0 : w[i] / left;
            }
            for (uint32_t i = 0, r = 0; i < n; ++i) {
                if (i == out) {
                    continue;
                }
                h[r] = g[i];
                for (uint32_t j = 0; j < n; ++j) {
                    h[r] += a[i * n + j] * (full[j] - w[j]);
                }
                x[r] = full[i];
                for (uint32_t j = 0, s = 0; j < n; ++j) {
                    if (j != out) {
                        b[r * (n - 1) + s++] = a[i * n + j];
                    }
                }
                ++r;
            }
            pci_simplex_minimize(n - 1, b, ridge_of(n, a), x, h);
            for (uint32_t i = 0, r = 0; i < n; ++i) {
                full[i] = i == out ? 0.0 : x[r++];
                interior = interior && (i == out || full[i] > 0.0);
            }
            costs[out] = program_value(n, a, g, w, full);
            cheapest = costs[out] < costs[cheapest] ? out : cheapest;
        }
        if (interior) {
            const uint64_t left = pci_simplex_prune(n, a, ridge_of(n, a), n - 1, w, g);
            assert_int_equal(left & 31, 31 & ~((uint64_t)1 << cheapest));
            ++compared;
        }
    }
    assert_true(compared >= 5);
    const double identity[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    double weights[3] = {0.5, 0.0, 0.5}, slopes[3] = {0.0, 0.5, 0.0};
    assert_int_equal(pci_simplex_prune(3, identity, 1e-6, 2, weights, slopes) & 7, 5);
}

// C from the factor in single precision, of programs that are nearly singular: the step lowers them
// as the exact one does. Numbers of C itself, rounded, would step far off.
static void factors_may_be_rounded(void **state) {
    (void)state;
    for (uint64_t seed = 0; seed < 500; ++seed) {
        const uint32_t n = 2 + (uint32_t)(seed % 8);
        double a[MOST * MOST] = {0}, g[MOST], from[MOST] = {0}, factor[MOST * MOST];
        double steps[2][MOST] = {{0}}, values[2], scale = 1.0;
        for (uint32_t r = 0; r < n; ++r, scale *= 0.3) {
            double row[MOST];
            for (uint32_t k = 0; k < n; ++k) {
                row[k] = scale * (2.0 * pci_random(seed, 1 + r, k) - 1.0);
            }
            for (uint32_t k = 0; k < n * n; ++k) {
                a[k] += row[k / n] * row[k % n];
            }
        }
        for (uint32_t k = 0; k < n; ++k) {
            g[k] = 0.0;
            for (uint32_t j = 0; j < n; ++j) {
                g[k] += a[k * n + j] * (2.0 * pci_random(seed, 100, j) - 1.0);
            }
        }
        pci_simplex_factor(n, 1e-15, a, factor);
        for (uint32_t rounded = 0; rounded < 2; ++rounded) {
            double *step = steps[rounded];
            const double *row = factor;
            for (uint32_t i = 1; i < n; row += i++) {
                double y = 0.0;
                for (uint32_t j = 0; j < i; ++j) {
                    y += (rounded ? (double)(float)row[j] : row[j]) * (g[j + 1] - g[0]);
                }
                for (uint32_t j = 0; j < i; ++j) {
                    const double moved = y * (rounded ? (double)(float)row[j] : row[j]);
                    step[j + 1] -= moved;
                    step[0] += moved;
                }
            }
            values[rounded] = program_value(n, a, g, from, step);
        }
        assert_true(values[0] < 0.0);
        assert_close(values[1], values[0], 1e-5 * fabs(values[0]));
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(programs_meet_the_optimality_conditions),
        cmocka_unit_test(pruned_programs_meet_the_optimality_conditions),
        cmocka_unit_test(the_cheapest_slot_goes),
        cmocka_unit_test(factors_may_be_rounded),
    };
    return cmocka_run_group_tests_name("skin_simplex", tests, NULL, NULL);
}
