#include <float.h>
#include <immintrin.h>

#include "geometry/bvh_tree.h"

#define LANES           8
#define SMALLER(a, b)   _mm256_min_ps((a), (b))
#define LARGER(a, b)    _mm256_max_ps((a), (b))
#define BITS(mask)      _mm256_movemask_ps((__m256)(mask))
#define WIDE_BITS(mask) _mm256_movemask_pd((__m256d)(mask))
#define GATHER(at, k)   ((WIDE){(at)[0][k], (at)[1][k], (at)[2][k], (at)[3][k]})
#define KERNEL          pci_bvh_avx2
#include "geometry/bvh_kernel.inl"
