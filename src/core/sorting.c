#include "core/sorting.h"

#include <stdlib.h>

// Up to so many records of up to so many bytes are sorted by insertion.
enum { most_inserted = 16, largest_inserted = 64 };

static uint32_t number_of(const void *record) {
    uint32_t number;
    memcpy(&number, record, sizeof(number));
    return number;
}

static void insert_all(char *records, size_t count, size_t size,
                       int (*compare)(const void *, const void *)) {
    char record[largest_inserted];
    for (size_t i = 1; i < count; ++i) {
        size_t at = i;
        while (at > 0 && compare(&records[(at - 1) * size], &records[i * size]) > 0) {
            --at;
        }
        if (at < i) {
            memcpy(record, &records[i * size], size);
            memmove(&records[(at + 1) * size], &records[at * size], (i - at) * size);
            memcpy(&records[at * size], record, size);
        }
    }
}

bool pci_sort_by_number(pc_context *context, void *records, size_t count, size_t size, size_t bound,
                        int (*compare)(const void *, const void *)) {
    pci_scratch scratch = pci_scratch_begin(context);
    size_t *next =
        PCI_SCRATCH(&scratch, size_t, bound + 1); // then the end of each number's records
    char *copy = pci_scratch_allocate(&scratch, count, size), *sorted = records;
    const bool done = !scratch.failed;
    if (done) {
        memcpy(copy, records, count * size);
        for (size_t i = 0; i < count; ++i) {
            ++next[number_of(&copy[i * size]) + 1];
        }
        for (size_t i = 0; i < bound; ++i) {
            next[i + 1] += next[i];
        }
        for (size_t i = 0; i < count; ++i) {
            memcpy(&sorted[next[number_of(&copy[i * size])]++ * size], &copy[i * size], size);
        }
        for (size_t i = 0, begin = 0; i < bound; begin = next[i++]) {
            const size_t shared = next[i] - begin;
            if (shared > most_inserted || size > largest_inserted) {
                qsort(&sorted[begin * size], shared, size, compare);
            } else {
                insert_all(&sorted[begin * size], shared, size, compare);
            }
        }
    }
    pci_scratch_end(&scratch);
    return done;
}
