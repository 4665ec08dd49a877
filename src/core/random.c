#include "core/core.h"

// Finaliser of splitmix64: a bijection that spreads every input bit over the output.
static uint64_t mix(uint64_t x) {
    x = (x ^ (x >> 30)) * UINT64_C(0xbf58476d1ce4e5b9);
    x = (x ^ (x >> 27)) * UINT64_C(0x94d049bb133111eb);
    return x ^ (x >> 31);
}

uint64_t pci_random_bits(uint64_t seed, uint64_t stream, uint64_t counter) {
    const uint64_t golden = UINT64_C(0x9e3779b97f4a7c15);
    return mix(mix(mix(seed + golden) ^ (stream + golden)) + counter * golden);
}

double pci_random(uint64_t seed, uint64_t stream, uint64_t counter) {
    return (double)(pci_random_bits(seed, stream, counter) >> 11) * 0x1p-53;
}
