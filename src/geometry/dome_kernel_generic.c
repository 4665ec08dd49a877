#include "geometry/dome.h"

static inline bool any_bit(const void *mask) {
    uint64_t words[2];
    memcpy(words, mask, sizeof(words));
    return (words[0] | words[1]) != 0;
}

static inline int32_t pair_at(const uint16_t *shadows, uint32_t texel) {
    return (int32_t)(shadows[texel] | (uint32_t)shadows[texel + 1] << 16);
}

#define LANES     4
#define ANY(mask) any_bit(&(mask))
#define PAIRS(at, index)                                                                           \
    ((MASK){pair_at((at), (uint32_t)(index)[0]), pair_at((at), (uint32_t)(index)[1]),              \
            pair_at((at), (uint32_t)(index)[2]), pair_at((at), (uint32_t)(index)[3])})
#define KERNEL pci_dome_generic
#include "geometry/dome_kernel.inl"
