#include "stages/skin_kernel.h"

#define REAL                float
#define INTEGER             int32_t
#define LANES               4
#define NAME(x)             x##_generic_float
#define SQRT                sqrtf
#define LENGTH_TOLERANCE    1e-20
#define STEP_TOLERANCE      1e-6
#define CURVATURE_TOLERANCE 1e-5
#include "stages/skin_kernel.inl"

#define REAL                double
#define INTEGER             int64_t
#define LANES               2
#define NAME(x)             x##_generic_double
#define SQRT                sqrt
#define LENGTH_TOLERANCE    1e-40
#define STEP_TOLERANCE      1e-18
#define CURVATURE_TOLERANCE 1e-13
#include "stages/skin_kernel.inl"
