#include "stages/skin/skin_pairs.h"

#include <stdlib.h>

#include "stages/skin/skin_quadratic.h"

typedef struct pair_builder {
    uint32_t *marks; // #P: 1 + the bone in hand
    uint32_t bone;
    uint32_t *others;
    size_t count, capacity;
} pair_builder;

static bool add_bones(pci_scratch *scratch, const uint32_t *bones, size_t count, pair_builder *b) {
    if (!pci_scratch_reserve(scratch, (void **)&b->others, &b->capacity, b->count + count,
                             sizeof(*b->others))) {
        return false;
    }
    for (size_t k = 0; k < count; ++k) {
        if (b->marks[bones[k]] != b->bone + 1) {
            b->marks[bones[k]] = b->bone + 1;
            b->others[b->count++] = bones[k];
        }
    }
    return true;
}

// The members that have each bone, `offsets` #P + 2.
static void list_members(const pci_skin_quadratic *q, size_t *offsets, uint32_t *members) {
    const size_t slots = q->slots;
    for (size_t k = 0; k < q->vertex_count * slots; ++k) {
        ++offsets[q->bones[k] + 2];
    }
    for (size_t b = 0; b < q->proxy_count; ++b) {
        offsets[b + 2] += offsets[b + 1];
    }
    for (size_t m = 0; m < q->vertex_count; ++m) {
        for (size_t k = 0; k < slots; ++k) {
            members[offsets[q->bones[q->members[m] * slots + k] + 1]++] = (uint32_t)m;
        }
    }
}

static bool add_row(pci_scratch *scratch, const pci_skin_quadratic *q, const pc_skin *followed,
                    size_t member, pair_builder *b) {
    const size_t v = q->members[member], slots = q->slots;
    const uint32_t *known = &q->known[q->known_offsets[member / PCI_SKIN_GROUP]];
    bool good = true;
    for (size_t e = q->offsets[member]; e < q->offsets[member + 1] && good; ++e) {
        good = add_bones(scratch, &q->bones[known[q->entries[e]] * slots], slots, b);
    }
    return good &&
           (followed == NULL || add_bones(scratch, &followed->bones[v * followed->influences],
                                          followed->influences, b));
}

static int compare_bones(const void *a, const void *b) {
    const uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
    return (x > y) - (x < y);
}

bool pci_skin_pairs_build(pci_scratch *scratch, const pci_skin_quadratic *q,
                          const pc_skin *followed, pci_skin_pairs *pairs) {
    const size_t bones = q->proxy_count;
    pci_scratch local = pci_scratch_begin(scratch->context);
    pair_builder b = {.marks = PCI_SCRATCH(&local, uint32_t, bones)};
    size_t *offsets = PCI_SCRATCH(&local, size_t, bones + 2);
    uint32_t *members = PCI_SCRATCH(&local, uint32_t, q->vertex_count * q->slots);
    pairs->offsets = PCI_SCRATCH(scratch, size_t, bones + 1);
    bool good = !scratch->failed && !local.failed;
    if (good) {
        list_members(q, offsets, members);
    }
    for (; b.bone < bones && good; ++b.bone) {
        for (size_t i = offsets[b.bone]; i < offsets[b.bone + 1] && good; ++i) {
            good = add_row(&local, q, followed, members[i], &b);
        }
        const size_t first = pairs->offsets[b.bone];
        if (good && b.count > first) {
            qsort(&b.others[first], b.count - first, sizeof(*b.others), compare_bones);
        }
        pairs->offsets[b.bone + 1] = b.count;
    }
    if (good) {
        pairs->others = PCI_SCRATCH(scratch, uint32_t, b.count + 1);
        pairs->values = PCI_SCRATCH(scratch, double, (b.count + 1) * q->width * q->width);
        good = !scratch->failed;
    }
    if (good && b.count > 0) {
        memcpy(pairs->others, b.others, b.count * sizeof(*b.others));
    }
    pci_scratch_end(&local);
    return good;
}

double pci_skin_pairs_product(const pci_skin_pairs *pairs, size_t columns, uint32_t b, uint32_t c,
                              const double *x, const double *y) {
    size_t begin = pairs->offsets[b], end = pairs->offsets[b + 1];
    while (begin < end) {
        const size_t middle = begin + (end - begin) / 2;
        if (pairs->others[middle] < c) {
            begin = middle + 1;
        } else {
            end = middle;
        }
    }
    if (begin == pairs->offsets[b + 1] || pairs->others[begin] != c) {
        return 0.0;
    }
    return pci_skin_gram_product(&pairs->values[begin * columns * columns], 1, columns, 0, 0, x, y);
}
