#include "stages/simulate/simulate_internal.h"

#if defined(__SSE2__)
#include <emmintrin.h>
#endif

// 1 - rest / length of all lanes, two at a time where the processor can; the same bits either way.
static inline void relative_changes(const double squares[PCI_LANES], const double rest[PCI_LANES],
                                    double changes[PCI_LANES]) {
#if defined(__SSE2__)
    for (size_t l = 0; l < PCI_LANES; l += 2) {
        const __m128d lengths = _mm_sqrt_pd(_mm_loadu_pd(&squares[l]));
        const __m128d ratios = _mm_div_pd(_mm_loadu_pd(&rest[l]), lengths);
        _mm_storeu_pd(&changes[l], _mm_sub_pd(_mm_set1_pd(1.0), ratios));
    }
#else
    for (size_t l = 0; l < PCI_LANES; ++l) {
        changes[l] = 1.0 - rest[l] / sqrt(squares[l]);
    }
#endif
}

void pci_sweep_generic(double *x, const pci_spring_block *blocks, size_t count) {
    for (size_t i = 0; i < count; ++i) {
        const pci_spring_block *block = &blocks[i];
        double d[3][PCI_LANES], squares[PCI_LANES], changes[PCI_LANES];
        for (size_t l = 0; l < PCI_LANES; ++l) {
            const double *a = &x[4 * (size_t)block->a[l]], *b = &x[4 * (size_t)block->b[l]];
            d[0][l] = b[0] - a[0], d[1][l] = b[1] - a[1], d[2][l] = b[2] - a[2];
            // Ends in one place have no direction: the tiny number keeps them there.
            squares[l] = d[0][l] * d[0][l] + d[1][l] * d[1][l] + d[2][l] * d[2][l] + 1e-300;
        }
        relative_changes(squares, block->rest, changes);
        for (size_t l = 0; l < PCI_LANES; ++l) {
            double *a = &x[4 * (size_t)block->a[l]], *b = &x[4 * (size_t)block->b[l]];
            const double move_a = block->move_a[l] * changes[l];
            const double move_b = block->move_b[l] * changes[l];
            a[0] += move_a * d[0][l], a[1] += move_a * d[1][l], a[2] += move_a * d[2][l];
            b[0] -= move_b * d[0][l], b[1] -= move_b * d[1][l], b[2] -= move_b * d[2][l];
        }
    }
}

pci_sweep pci_fastest_sweep(void) {
#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx2")) {
        return pci_sweep_avx2;
    }
#endif
    return pci_sweep_generic;
}
