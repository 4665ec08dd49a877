// Sorting of many records by a small number, such as the index of a vertex.
#ifndef PCI_SORTING_H
#define PCI_SORTING_H

#include "core/core.h"

// Sorts as qsort would, in linear time where few records share a number: each begins with a
// uint32_t below `bound`, which `compare` looks at first. False: out of memory.
PC_NODISCARD bool pci_sort_by_number(pc_context *context, void *records, size_t count, size_t size,
                                     size_t bound, int (*compare)(const void *, const void *));

// Sorts keys, and what belongs to each (NULL: nothing), in linear time; equal ones stay in order.
// False: out of memory.
PC_NODISCARD bool pci_sort_keys(pc_context *context, size_t count, uint64_t *keys,
                                uint32_t *values);

// Rises with the number, which is no NaN; the same for 0 and -0.
static inline uint64_t pci_key_of(double number) {
    const double plain = number + 0.0;
    uint64_t bits;
    memcpy(&bits, &plain, sizeof(bits));
    return (bits >> 63) != 0 ? ~bits : bits | UINT64_C(1) << 63;
}

#endif
