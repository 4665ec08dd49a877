// Binary heap of (key, item), smallest key first, ties to the smaller item. Memory comes from
// scratch. Stale entries are the caller's business.
#ifndef PCI_HEAP_H
#define PCI_HEAP_H

#include "core/core.h"

typedef struct pci_heap_entry {
    double key;
    uint32_t item;
} pci_heap_entry;

typedef struct pci_heap {
    pci_heap_entry *entries;
    size_t count, capacity;
} pci_heap;

// False: out of memory.
bool pci_heap_push(pci_scratch *scratch, pci_heap *heap, double key, uint32_t item);
// False: the heap is empty.
bool pci_heap_pop(pci_heap *heap, pci_heap_entry *entry);

#endif
