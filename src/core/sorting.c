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

// Digit by digit from the lowest; those that all keys share cost nothing.
bool pci_sort_keys(pc_context *context, size_t count, uint64_t *keys, uint32_t *values) {
    enum { digits = 8, bits = 8, base = 1 << bits };
    pci_scratch scratch = pci_scratch_begin(context);
    size_t next[digits][base] = {{0}};
    uint64_t *from = keys, *to = PCI_SCRATCH(&scratch, uint64_t, count);
    uint32_t *from_value = values, *to_value = NULL;
    if (values != NULL) {
        to_value = PCI_SCRATCH(&scratch, uint32_t, count);
    }
    const bool done = !scratch.failed;
    for (size_t i = 0; i < count && done; ++i) {
        for (size_t d = 0; d < digits; ++d) {
            ++next[d][keys[i] >> bits * d & (base - 1)];
        }
    }
    for (size_t d = 0; d < digits && count > 1 && done; ++d) {
        if (next[d][keys[0] >> bits * d & (base - 1)] == count) {
            continue;
        }
        for (size_t k = 0, sum = 0; k < base; ++k) {
            const size_t share = next[d][k];
            next[d][k] = sum;
            sum += share;
        }
        for (size_t i = 0; i < count; ++i) {
            const size_t at = next[d][from[i] >> bits * d & (base - 1)]++;
            to[at] = from[i];
            if (values != NULL) {
                to_value[at] = from_value[i];
            }
        }
        uint64_t *const written = to;
        uint32_t *const written_value = to_value;
        to = from, to_value = from_value;
        from = written, from_value = written_value;
    }
    if (done && from != keys) {
        memcpy(keys, from, count * sizeof(*keys));
        if (values != NULL) {
            memcpy(values, from_value, count * sizeof(*values));
        }
    }
    pci_scratch_end(&scratch);
    return done;
}
