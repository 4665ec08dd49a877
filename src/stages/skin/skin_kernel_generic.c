#include "stages/skin/skin_kernel.h"

static inline bool any_bit(const void *mask) {
    uint64_t words[2];
    memcpy(words, mask, sizeof(words));
    return (words[0] | words[1]) != 0;
}

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
#define EACH_FMA            fmaf
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
