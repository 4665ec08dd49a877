#include "stages/skin/skin_kernel.h"

static inline bool any_bit(const void *mask) {
    uint64_t words[2];
    memcpy(words, mask, sizeof(words));
    return (words[0] | words[1]) != 0;
}

typedef float four_floats __attribute__((vector_size(16)));

#if defined(__FP_FAST_FMAF)
static inline __attribute__((always_inline)) four_floats
fused_floats(four_floats sum, four_floats x, four_floats y) {
    for (size_t k = 0; k < 4; ++k) {
        sum[k] = fmaf(x[k], y[k], sum[k]);
    }
    return sum;
}
#else
typedef float two_floats __attribute__((vector_size(8)));
typedef double two_doubles __attribute__((vector_size(16)));
typedef uint64_t two_words __attribute__((vector_size(16)));

// sum + x y, rounded once: a call of fmaf for each costs many times as much. The product is exact
// in double; where the sum is not, it becomes the one of its neighbours whose last digit is odd
// (Boldo, Melquiond, "Emulation of FMA and correctly rounded sums: proved algorithms using rounding
// to odd", 2008), which float rounds as the exact sum.
static inline __attribute__((always_inline)) two_doubles odd_sum(two_doubles sum, two_doubles x,
                                                                 two_doubles y) {
    const two_doubles product = x * y, rounded = product + sum, part = rounded - product;
    const two_doubles error = (product - (rounded - part)) + (sum - part);
    const two_words bits = (two_words)rounded;
    const two_words inexact = (two_words)(error < 0) | (two_words)(error > 0);
    const two_words towards = 1 - ((((two_words)error ^ bits) >> 62) & 2); // the exact sum
    return (two_doubles)(bits + (towards & inexact & ((bits & 1) - 1)));
}

#define HALF(v, a, b) __builtin_convertvector(__builtin_shufflevector(v, v, a, b), two_doubles)
static inline __attribute__((always_inline)) four_floats
fused_floats(four_floats sum, four_floats x, four_floats y) {
    const two_doubles low = odd_sum(HALF(sum, 0, 1), HALF(x, 0, 1), HALF(y, 0, 1));
    const two_doubles high = odd_sum(HALF(sum, 2, 3), HALF(x, 2, 3), HALF(y, 2, 3));
    return __builtin_shufflevector(__builtin_convertvector(low, two_floats),
                                   __builtin_convertvector(high, two_floats), 0, 1, 2, 3);
}
#undef HALF
#endif

#define LANES   4
#define NAME(x) x##_generic
#define ROWS    multiply_rows_generic
#include "stages/skin/skin_rows.inl"

#define REAL                float
#define INTEGER             int32_t
#define LANES               4
#define ANY(mask)           any_bit(&(mask))
#define NAME(x)             x##_generic_float
#define EACH_ROOT           sqrtf
#define FUSED(sum, x, y)    ((VEC)fused_floats((four_floats)(sum), (four_floats)(x), (four_floats)(y)))
#define LENGTH_TOLERANCE    1e-20
#define STEP_TOLERANCE      1e-5
#define CURVATURE_TOLERANCE 1e-5
#define ROOT_TOLERANCE      1e-6
#include "stages/skin/skin_kernel.inl"

#define REAL                double
#define INTEGER             int64_t
#define LANES               2
#define ANY(mask)           any_bit(&(mask))
#define NAME(x)             x##_generic_double
#define EACH_ROOT           sqrt
#define EACH_FMA            fma
#define LENGTH_TOLERANCE    1e-40
#define STEP_TOLERANCE      1e-18
#define CURVATURE_TOLERANCE 1e-13
#define ROOT_TOLERANCE      1e-13
#include "stages/skin/skin_kernel.inl"
