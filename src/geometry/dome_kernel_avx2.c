#include <immintrin.h>

#include "geometry/dome.h"

static inline int32_t pair_at(const uint16_t *shadows, uint32_t texel) {
    int32_t pair; // little-endian
    memcpy(&pair, &shadows[texel], sizeof(pair));
    return pair;
}

#define LANES     8
#define ANY(mask) (!_mm256_testz_si256((__m256i)(mask), (__m256i)(mask)))
// Faster than the gathering instructions.
#define PAIRS(at, index)                                                                           \
    ((MASK){pair_at((at), (uint32_t)(index)[0]), pair_at((at), (uint32_t)(index)[1]),              \
            pair_at((at), (uint32_t)(index)[2]), pair_at((at), (uint32_t)(index)[3]),              \
            pair_at((at), (uint32_t)(index)[4]), pair_at((at), (uint32_t)(index)[5]),              \
            pair_at((at), (uint32_t)(index)[6]), pair_at((at), (uint32_t)(index)[7])})
#define KERNEL pci_dome_avx2
#include "geometry/dome_kernel.inl"
