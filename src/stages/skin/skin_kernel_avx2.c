#include <immintrin.h>

#include "stages/skin/skin_kernel.h"

#define LANES   8
#define NAME(x) x##_avx2
#define ROWS    multiply_rows_avx2
#include "stages/skin/skin_rows.inl"

#define REAL                float
#define INTEGER             int32_t
#define LANES               8
#define ANY(mask)           (!_mm256_testz_si256((__m256i)(mask), (__m256i)(mask)))
#define NAME(x)             x##_avx2_float
#define ROOT(x)             ((VEC)_mm256_sqrt_ps((__m256)(x)))
#define FUSED(sum, x, y)    ((VEC)_mm256_fmadd_ps((__m256)(x), (__m256)(y), (__m256)(sum)))
#define LENGTH_TOLERANCE    1e-20
#define STEP_TOLERANCE      1e-5
#define CURVATURE_TOLERANCE 1e-5
#define ROOT_TOLERANCE      1e-6
#include "stages/skin/skin_kernel.inl"

#define REAL                double
#define INTEGER             int64_t
#define LANES               4
#define ANY(mask)           (!_mm256_testz_si256((__m256i)(mask), (__m256i)(mask)))
#define NAME(x)             x##_avx2_double
#define ROOT(x)             ((VEC)_mm256_sqrt_pd((__m256d)(x)))
#define FUSED(sum, x, y)    ((VEC)_mm256_fmadd_pd((__m256d)(x), (__m256d)(y), (__m256d)(sum)))
#define LENGTH_TOLERANCE    1e-40
#define STEP_TOLERANCE      1e-18
#define CURVATURE_TOLERANCE 1e-13
#define ROOT_TOLERANCE      1e-13
#include "stages/skin/skin_kernel.inl"
