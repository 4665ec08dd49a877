#include "core/heap.h"

static bool before(const pci_heap_entry *a, const pci_heap_entry *b) {
    return a->key < b->key || (a->key == b->key && a->item < b->item);
}

bool pci_heap_push(pci_scratch *scratch, pci_heap *heap, double key, uint32_t item) {
    if (heap->count == heap->capacity) {
        void *entries = heap->entries;
        if (!pci_scratch_reserve(scratch, &entries, &heap->capacity, heap->count + 1,
                                 sizeof(*heap->entries))) {
            return false;
        }
        heap->entries = entries;
    }
    const pci_heap_entry entry = {key, item};
    size_t at = heap->count++;
    while (at > 0 && before(&entry, &heap->entries[(at - 1) / 2])) {
        heap->entries[at] = heap->entries[(at - 1) / 2];
        at = (at - 1) / 2;
    }
    heap->entries[at] = entry;
    return true;
}

bool pci_heap_pop(pci_heap *heap, pci_heap_entry *entry) {
    if (heap->count == 0) {
        return false;
    }
    *entry = heap->entries[0];
    const pci_heap_entry last = heap->entries[--heap->count];
    size_t at = 0;
    while (2 * at + 1 < heap->count) {
        size_t child = 2 * at + 1;
        if (child + 1 < heap->count && before(&heap->entries[child + 1], &heap->entries[child])) {
            ++child;
        }
        if (!before(&heap->entries[child], &last)) {
            break;
        }
        heap->entries[at] = heap->entries[child];
        at = child;
    }
    heap->entries[at] = last;
    return true;
}
