// The sweep with a vertex, or a coordinate of all lanes, in a register.
#include <immintrin.h>

#include "stages/simulate/simulate_internal.h"

static inline __m256d way(const double *x, uint32_t a, uint32_t b) {
    return _mm256_sub_pd(_mm256_loadu_pd(&x[4 * (size_t)b]), _mm256_loadu_pd(&x[4 * (size_t)a]));
}

static inline void move(double *x, uint32_t a, uint32_t b, __m256d way, __m256d share_a,
                        __m256d share_b) {
    double *from = &x[4 * (size_t)a], *to = &x[4 * (size_t)b];
    _mm256_storeu_pd(from, _mm256_add_pd(_mm256_loadu_pd(from), _mm256_mul_pd(share_a, way)));
    _mm256_storeu_pd(to, _mm256_sub_pd(_mm256_loadu_pd(to), _mm256_mul_pd(share_b, way)));
}

#define LANE(numbers, l) _mm256_permute4x64_pd((numbers), (l)*0x55)

void pci_sweep_avx2(double *x, const pci_spring_block *blocks, size_t count) {
    const __m256d one = _mm256_set1_pd(1.0), tiny = _mm256_set1_pd(1e-300);
    for (size_t i = 0; i < count; ++i) {
        const pci_spring_block *block = &blocks[i];
        const uint32_t *a = block->a, *b = block->b;
        const __m256d d0 = way(x, a[0], b[0]), d1 = way(x, a[1], b[1]);
        const __m256d d2 = way(x, a[2], b[2]), d3 = way(x, a[3], b[3]);
        // Transposed.
        const __m256d xz0 = _mm256_unpacklo_pd(d0, d1), xz1 = _mm256_unpacklo_pd(d2, d3);
        const __m256d y0 = _mm256_unpackhi_pd(d0, d1), y1 = _mm256_unpackhi_pd(d2, d3);
        const __m256d dx = _mm256_permute2f128_pd(xz0, xz1, 0x20);
        const __m256d dy = _mm256_permute2f128_pd(y0, y1, 0x20);
        const __m256d dz = _mm256_permute2f128_pd(xz0, xz1, 0x31);
        const __m256d xy = _mm256_add_pd(_mm256_mul_pd(dx, dx), _mm256_mul_pd(dy, dy));
        const __m256d squares = _mm256_add_pd(_mm256_add_pd(xy, _mm256_mul_pd(dz, dz)), tiny);
        const __m256d rest = _mm256_loadu_pd(block->rest);
        const __m256d changes = _mm256_sub_pd(one, _mm256_div_pd(rest, _mm256_sqrt_pd(squares)));
        const __m256d share_a = _mm256_mul_pd(_mm256_loadu_pd(block->move_a), changes);
        const __m256d share_b = _mm256_mul_pd(_mm256_loadu_pd(block->move_b), changes);
        move(x, a[0], b[0], d0, LANE(share_a, 0), LANE(share_b, 0));
        move(x, a[1], b[1], d1, LANE(share_a, 1), LANE(share_b, 1));
        move(x, a[2], b[2], d2, LANE(share_a, 2), LANE(share_b, 2));
        move(x, a[3], b[3], d3, LANE(share_a, 3), LANE(share_b, 3));
    }
}
