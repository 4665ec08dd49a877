// Products of rows for one instruction set; included by skin_kernel_*.c with
//   LANES    floats per register, divides PCI_SKIN_STRIDE
//   NAME(x)  name of x for this instruction set; ROWS: that of the result, which stays defined
// Every number is found by the same operations in the same order whatever LANES is.

typedef float NAME(lanes) __attribute__((vector_size(LANES * sizeof(float)), may_alias));
typedef float NAME(eight) __attribute__((vector_size(8 * sizeof(float)), may_alias));
#define LOAD(p) (*(const NAME(lanes) *)(const void *)(p))

// One piece of sum_e values[e] moved[entries[e]].
static inline __attribute__((always_inline)) void NAME(add_piece)(const pci_skin_rows *rows,
                                                                  const float *moved, float *sum) {
    NAME(lanes) total[PCI_SKIN_STRIDE / LANES] = {{0}};
    for (size_t e = 0; e < rows->entry_count; ++e) {
        const float *row = &moved[rows->entries[e] * rows->stride];
        for (size_t k = 0; k < PCI_SKIN_STRIDE / LANES; ++k) {
            total[k] += rows->values[e] * LOAD(&row[LANES * k]);
        }
    }
    for (size_t k = 0; k < PCI_SKIN_STRIDE / LANES; ++k) {
        *(NAME(lanes) *)(void *)&sum[LANES * k] = total[k];
    }
}

static inline __attribute__((always_inline)) float NAME(multiply)(const float *a, const float *b,
                                                                  size_t count) {
    NAME(lanes) total[PCI_SKIN_STRIDE / LANES] = {{0}};
    for (size_t i = 0; i < count; i += PCI_SKIN_STRIDE) {
        for (size_t k = 0; k < PCI_SKIN_STRIDE / LANES; ++k) {
            total[k] += LOAD(&a[i + LANES * k]) * LOAD(&b[i + LANES * k]);
        }
    }
    float sums[PCI_SKIN_STRIDE] __attribute__((aligned(64)));
    for (size_t k = 0; k < PCI_SKIN_STRIDE / LANES; ++k) {
        *(NAME(lanes) *)(void *)&sums[LANES * k] = total[k];
    }
    // Half is added to half until one is left. Loops over so few would go through memory.
    const NAME(eight) x =
        *(const NAME(eight) *)(const void *)sums + *(const NAME(eight) *)(const void *)&sums[8];
    return ((x[0] + x[4]) + (x[2] + x[6])) + ((x[1] + x[5]) + (x[3] + x[7]));
}
_Static_assert(PCI_SKIN_STRIDE == 16, "added as two halves of eight");

static void ROWS(const pci_skin_rows *rows, size_t count, const uint32_t *numbers, float *sum,
                 float *products) {
    for (size_t b = 0; b < rows->stride; b += PCI_SKIN_STRIDE) {
        NAME(add_piece)(rows, &rows->moved[b], &sum[b]);
    }
    for (size_t i = 0; i < count; ++i) {
        products[i] = NAME(multiply)(&rows->gram[numbers[i] * rows->stride], sum, rows->stride);
    }
}

#undef LOAD
#undef LANES
#undef NAME
