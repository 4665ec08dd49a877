// Sorting of many records by a small number, such as the index of a vertex.
#ifndef PCI_SORTING_H
#define PCI_SORTING_H

#include "core/core.h"

// Sorts as qsort would, in linear time where few records share a number: each begins with a
// uint32_t below `bound`, which `compare` looks at first. False: out of memory.
PC_NODISCARD bool pci_sort_by_number(pc_context *context, void *records, size_t count, size_t size,
                                     size_t bound, int (*compare)(const void *, const void *));

#endif
