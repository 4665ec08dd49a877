#include <immintrin.h>

#include "stages/skin/skin_kernel.h"

#define LANES   16
#define NAME(x) x##_avx512
#define ROWS    multiply_rows_avx512
#include "stages/skin/skin_rows.inl"

#define REAL                float
#define INTEGER             int32_t
#define LANES               16
#define ANY(mask)           (_mm512_test_epi32_mask((__m512i)(mask), (__m512i)(mask)) != 0)
#define NAME(x)             x##_avx512_float
#define ROOT(x)             ((VEC)_mm512_sqrt_ps((__m512)(x)))
#define FUSED(sum, x, y)    ((VEC)_mm512_fmadd_ps((__m512)(x), (__m512)(y), (__m512)(sum)))
#define LENGTH_TOLERANCE    1e-20
#define STEP_TOLERANCE      1e-5
#define CURVATURE_TOLERANCE 1e-5
#define ROOT_TOLERANCE      1e-6
#include "stages/skin/skin_kernel.inl"

#define REAL                double
#define INTEGER             int64_t
#define LANES               8
#define ANY(mask)           (_mm512_test_epi32_mask((__m512i)(mask), (__m512i)(mask)) != 0)
#define NAME(x)             x##_avx512_double
#define ROOT(x)             ((VEC)_mm512_sqrt_pd((__m512d)(x)))
#define FUSED(sum, x, y)    ((VEC)_mm512_fmadd_pd((__m512d)(x), (__m512d)(y), (__m512d)(sum)))
#define LENGTH_TOLERANCE    1e-40
#define STEP_TOLERANCE      1e-18
#define CURVATURE_TOLERANCE 1e-13
#define ROOT_TOLERANCE      1e-13
#include "stages/skin/skin_kernel.inl"
