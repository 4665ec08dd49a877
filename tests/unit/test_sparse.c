#include <stdlib.h>

#include "solvers/sparse.h"
#include "support/memory.h"

// A sparse symmetric matrix in memory of its own.
typedef struct matrix {
    size_t size;
    size_t *offsets;
    uint32_t *rows;
    double *values;
} matrix;

static void matrix_free(matrix *m) {
    free(m->offsets);
    free(m->rows);
    free(m->values);
}

// Both triangles of a dense row-major matrix without its zeros.
static matrix from_dense(const double *dense, size_t size) {
    matrix m = {.size = size};
    m.offsets = malloc((size + 1) * sizeof(*m.offsets));
    m.rows = malloc((size * size + 1) * sizeof(*m.rows));
    m.values = malloc((size * size + 1) * sizeof(*m.values));
    assert_true(m.offsets != NULL && m.rows != NULL && m.values != NULL);
    size_t count = 0;
    for (size_t j = 0; j < size; ++j) {
        m.offsets[j] = count;
        for (size_t i = 0; i < size; ++i) {
            if (dense[i * size + j] != 0.0) {
                m.rows[count] = (uint32_t)i;
                m.values[count++] = dense[i * size + j];
            }
        }
    }
    m.offsets[size] = count;
    return m;
}

// Random symmetric, strictly diagonally dominant, `share` of the off-diagonals filled.
static double *random_dense(size_t size, double share, uint64_t seed) {
    double *dense = calloc(size * size + 1, sizeof(*dense));
    assert_non_null(dense);
    for (size_t i = 0; i < size; ++i) {
        for (size_t j = 0; j < i; ++j) {
            if (pci_random(seed, 0, i * size + j) < share) {
                const double value = 2.0 * pci_random(seed, 1, i * size + j) - 1.0;
                dense[i * size + j] = dense[j * size + i] = value;
                dense[i * size + i] += fabs(value);
                dense[j * size + j] += fabs(value);
            }
        }
    }
    for (size_t i = 0; i < size; ++i) {
        dense[i * size + i] += 0.01 + pci_random(seed, 2, i);
    }
    return dense;
}

// Gaussian elimination with row exchanges, one right-hand side; destroys its input.
static void dense_solve(double *a, double *b, size_t n) {
    for (size_t k = 0; k < n; ++k) {
        size_t best = k;
        for (size_t i = k + 1; i < n; ++i) {
            best = fabs(a[i * n + k]) > fabs(a[best * n + k]) ? i : best;
        }
        for (size_t j = 0; j < n; ++j) {
            const double t = a[k * n + j];
            a[k * n + j] = a[best * n + j], a[best * n + j] = t;
        }
        const double t = b[k];
        b[k] = b[best], b[best] = t;
        for (size_t i = k + 1; i < n; ++i) {
            const double factor = a[i * n + k] / a[k * n + k];
            for (size_t j = k; j < n; ++j) {
                a[i * n + j] -= factor * a[k * n + j];
            }
            b[i] -= factor * b[k];
        }
    }
    for (size_t k = n; k-- > 0;) {
        for (size_t j = k + 1; j < n; ++j) {
            b[k] -= a[k * n + j] * b[j];
        }
        b[k] /= a[k * n + k];
    }
}

static void agrees_with_dense_elimination(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    static const double shares[] = {0.0, 0.02, 0.1, 0.5, 1.0};
    for (size_t trial = 0; trial < 60; ++trial) {
        const size_t n = 1 + (size_t)(pci_random_bits(7, 0, trial) % 70);
        const size_t columns = 1 + trial % 9;
        double *dense = random_dense(n, shares[trial % 5], trial);
        matrix m = from_dense(dense, n);
        double *b = calloc(n * columns, sizeof(*b)), *x = calloc(n * columns, sizeof(*x));
        assert_true(b != NULL && x != NULL);
        for (size_t i = 0; i < n * columns; ++i) {
            b[i] = pci_random(trial, 3, i) - 0.5;
        }
        pci_cholesky *c = NULL;
        assert_ok(context,
                  pci_cholesky_create(context, "test", n, m.offsets, m.rows, m.values, &c));
        assert_ok(context, pci_cholesky_solve(context, c, columns, b, x));
        for (size_t q = 0; q < columns; ++q) {
            double *copy = malloc(n * n * sizeof(*copy)), *expected = malloc(n * sizeof(*expected));
            assert_true(copy != NULL && expected != NULL);
            memcpy(copy, dense, n * n * sizeof(*copy));
            for (size_t i = 0; i < n; ++i) {
                expected[i] = b[i * columns + q];
            }
            dense_solve(copy, expected, n);
            for (size_t i = 0; i < n; ++i) {
                assert_close(x[i * columns + q], expected[i], 1e-10);
            }
            free(copy);
            free(expected);
        }
        pci_cholesky_destroy(context, c);
        free(dense);
        free(b);
        free(x);
        matrix_free(&m);
    }
    pc_context_destroy(context);
}

// I + L^T L of the uniform Laplacian on a torus of u by v vertices with six neighbours each.
static matrix torus(size_t u, size_t v) {
    const size_t n = u * v;
    static const int steps[7][2] = {{0, 0}, {1, 0}, {-1, 0}, {0, 1}, {0, -1}, {1, 1}, {-1, -1}};
    matrix m = {.size = n};
    m.offsets = malloc((n + 1) * sizeof(*m.offsets));
    m.rows = malloc(19 * n * sizeof(*m.rows));
    m.values = malloc(19 * n * sizeof(*m.values));
    double *column = calloc(n, sizeof(*column));
    assert_true(m.offsets != NULL && m.rows != NULL && m.values != NULL && column != NULL);
    size_t count = 0;
    for (size_t a = 0; a < u; ++a) {
        for (size_t b = 0; b < v; ++b) {
            column[a * v + b] = 1.0;
            for (size_t s = 0; s < 49; ++s) {
                const int da = steps[s / 7][0] + steps[s % 7][0];
                const int db = steps[s / 7][1] + steps[s % 7][1];
                const size_t row =
                    (size_t)((int)(a + u) + da) % u * v + (size_t)((int)(b + v) + db) % v;
                column[row] += (s / 7 == 0 ? 1.0 : -1.0 / 6.0) * (s % 7 == 0 ? 1.0 : -1.0 / 6.0);
            }
            m.offsets[a * v + b] = count;
            for (size_t i = 0; i < n; ++i) {
                if (column[i] != 0.0) {
                    assert_true(count < 19 * n);
                    m.rows[count] = (uint32_t)i;
                    m.values[count++] = column[i];
                    column[i] = 0.0;
                }
            }
        }
    }
    m.offsets[n] = count;
    free(column);
    return m;
}

static void solves_a_surface_laplacian(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    matrix m = torus(40, 31);
    const size_t n = m.size;
    double *b = calloc(3 * n, sizeof(*b)), *x = calloc(3 * n, sizeof(*x));
    double *again = calloc(3 * n, sizeof(*again));
    assert_true(b != NULL && x != NULL && again != NULL);
    for (size_t i = 0; i < 3 * n; ++i) {
        b[i] = again[i] = pci_random(1, 0, i);
    }
    pci_cholesky *c = NULL;
    assert_ok(context, pci_cholesky_create(context, "test", n, m.offsets, m.rows, m.values, &c));
    assert_ok(context, pci_cholesky_solve(context, c, 3, b, x));
    for (size_t q = 0; q < 3; ++q) {
        for (size_t j = 0; j < n; ++j) {
            double residual = -b[3 * j + q];
            for (size_t p = m.offsets[j]; p < m.offsets[j + 1]; ++p) {
                residual += m.values[p] * x[3 * (size_t)m.rows[p] + q];
            }
            assert_close(residual, 0.0, 1e-13);
        }
    }
    pci_cholesky_destroy(context, c);

    // A second factorisation, solved in place, gives the same bits.
    assert_ok(context, pci_cholesky_create(context, "test", n, m.offsets, m.rows, m.values, &c));
    assert_ok(context, pci_cholesky_solve(context, c, 3, again, again));
    assert_memory_equal(x, again, 3 * n * sizeof(*x));
    pci_cholesky_destroy(context, c);
    free(b);
    free(x);
    free(again);
    matrix_free(&m);
    pc_context_destroy(context);
}

static void refuses_indefinite_matrices(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    const double cases[][9] = {
        {1.0, 2.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0, 1.0},  // eigenvalue -1
        {1.0, 1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0},  // singular
        {1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0}, // negative diagonal
        {1.0, 0.0, 0.0, 0.0, NAN, 0.0, 0.0, 0.0, 1.0},
        {1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0}, // empty column
    };
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); ++i) {
        matrix m = from_dense(cases[i], 3);
        pci_cholesky *c = (pci_cholesky *)(void *)&m;
        assert_int_equal(pci_cholesky_create(context, "test", 3, m.offsets, m.rows, m.values, &c),
                         PC_ERROR_NUMERICAL);
        assert_null(c);
        matrix_free(&m);
    }
    pc_context_destroy(context);
}

static void handles_no_unknowns_and_sizes_beyond_int(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    const size_t offsets[2] = {0, (size_t)1 << 32};
    pci_cholesky *c = NULL;
    assert_ok(context, pci_cholesky_create(context, "test", 0, offsets, NULL, NULL, &c));
    assert_non_null(c);
    assert_ok(context, pci_cholesky_solve(context, c, 3, NULL, NULL));
    pci_cholesky_destroy(context, c);
    assert_int_equal(pci_cholesky_create(context, "test", 1, offsets, NULL, NULL, &c),
                     PC_ERROR_TOO_LARGE);
    assert_null(c);
    pc_context_destroy(context);
}

static void survives_memory_failure(void **state) {
    (void)state;
    matrix m = torus(5, 5);
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        double x[75] = {1.0};
        pci_cholesky *c = NULL;
        s.status = pci_cholesky_create(context, "test", m.size, m.offsets, m.rows, m.values, &c);
        if (s.status == PC_OK) {
            s.status = pci_cholesky_solve(context, c, 3, x, x);
        } else {
            assert_null(c);
        }
        pci_cholesky_destroy(context, c);
    }
    assert_true(s.failures > 5);
    pc_context_destroy(context);
    matrix_free(&m);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(agrees_with_dense_elimination),
        cmocka_unit_test(solves_a_surface_laplacian),
        cmocka_unit_test(refuses_indefinite_matrices),
        cmocka_unit_test(handles_no_unknowns_and_sizes_beyond_int),
        cmocka_unit_test(survives_memory_failure),
    };
    return cmocka_run_group_tests_name("sparse", tests, NULL, NULL);
}
