// Disjoint sets of 0..count - 1: parents[i] == i at the representative, the smallest of its set.
#ifndef PCI_UNION_FIND_H
#define PCI_UNION_FIND_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

// Every element is a set of its own.
static inline void pci_singletons(uint32_t *parents, size_t count) {
    for (size_t i = 0; i < count; ++i) {
        parents[i] = (uint32_t)i;
    }
}

// Halves the path on the way.
static inline uint32_t pci_find_root(uint32_t *parents, uint32_t i) {
    while (parents[i] != i) {
        parents[i] = parents[parents[i]];
        i = parents[i];
    }
    return i;
}

// Returns whether they were apart.
static inline bool pci_unite(uint32_t *parents, uint32_t i, uint32_t j) {
    const uint32_t a = pci_find_root(parents, i), b = pci_find_root(parents, j);
    parents[a < b ? b : a] = a < b ? a : b;
    return a != b;
}

#endif
