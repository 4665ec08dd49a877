#include <stdlib.h>
#if defined(__GLIBC__)
#if __GLIBC_PREREQ(2, 33)
#include <malloc.h>
#define HAS_TRIM
#endif
#endif

#include "core/context.h"

void *pci_allocate(pc_context *context, size_t count, size_t size) {
    if (size != 0 && count > (SIZE_MAX / 2) / size) {
        return NULL;
    }
    const size_t bytes = count * size;
    const pc_allocator *allocator = &context->options.allocator;
    if (allocator->allocate == pci_default_allocate) {
        return calloc(bytes != 0 ? bytes : 1, 1); // knows which pages are zero already
    }
    void *memory = allocator->allocate(allocator->user, bytes != 0 ? bytes : 1);
    if (memory != NULL) {
        memset(memory, 0, bytes);
    }
    return memory;
}

void pc_release(pc_context *context, void *memory) {
    if (memory != NULL) {
        context->options.allocator.release(context->options.allocator.user, memory);
    }
}

void pci_give_back(const pc_context *context) {
#if defined(HAS_TRIM)
    enum { WORTH_IT = 128 << 20 }; // bytes; to ask for it again costs time
    if (context->options.allocator.allocate == pci_default_allocate &&
        mallinfo2().fordblks >= WORTH_IT) {
        (void)malloc_trim(0);
    }
#else
    (void)context;
#endif
}

// Header in front of each piece of scratch memory; 64 bytes keep the pieces aligned for SIMD when
// the allocator aligns to 64, and to max_align_t always.
struct pci_scratch_block {
    struct pci_scratch_block *next;
    char padding[64 - sizeof(struct pci_scratch_block *)];
};

pci_scratch pci_scratch_begin(pc_context *context) {
    const pci_scratch scratch = {.context = context};
    return scratch;
}

void pci_scratch_end(pci_scratch *scratch) { pci_scratch_rewind(scratch, NULL); }

void pci_scratch_rewind(pci_scratch *scratch, const struct pci_scratch_block *mark) {
    while (scratch->blocks != mark) {
        struct pci_scratch_block *block = scratch->blocks;
        scratch->blocks = block->next;
        pc_release(scratch->context, block);
    }
}

void pci_scratch_take(pci_scratch *scratch, pci_scratch *from) {
    struct pci_scratch_block **end = &from->blocks;
    while (*end != NULL) {
        end = &(*end)->next;
    }
    *end = scratch->blocks;
    scratch->blocks = from->blocks;
    from->blocks = NULL;
}

void pci_scratch_release(pci_scratch *scratch, void *memory) {
    struct pci_scratch_block **at = &scratch->blocks;
    while (*at != NULL && (void *)(*at + 1) != memory) {
        at = &(*at)->next;
    }
    struct pci_scratch_block *block = *at;
    if (block != NULL) {
        *at = block->next;
        pc_release(scratch->context, block);
    }
}

void *pci_scratch_allocate(pci_scratch *scratch, size_t count, size_t size) {
    const size_t header = sizeof(struct pci_scratch_block);
    if (scratch->failed || (size != 0 && count > (SIZE_MAX / 2 - header) / size)) {
        scratch->failed = true;
        return NULL;
    }
    struct pci_scratch_block *block = pci_allocate(scratch->context, header + count * size, 1);
    if (block == NULL) {
        scratch->failed = true;
        return NULL;
    }
    block->next = scratch->blocks;
    scratch->blocks = block;
    return (char *)block + header;
}

void *pci_scratch_allocate_aligned(pci_scratch *scratch, size_t count, size_t size) {
    enum { LINE = 64 };
    if (size != 0 && count > (SIZE_MAX - LINE) / size) {
        scratch->failed = true;
        return NULL;
    }
    char *memory = pci_scratch_allocate(scratch, count * size + LINE, 1);
    return memory == NULL ? NULL : memory + (LINE - (uintptr_t)memory % LINE) % LINE;
}

bool pci_scratch_reserve(pci_scratch *scratch, void **array, size_t *capacity, size_t needed,
                         size_t element_size) {
    if (needed <= *capacity) {
        return true;
    }
    size_t grown = *capacity < 16 ? 16 : *capacity * 2;
    if (grown < needed) {
        grown = needed;
    }
    void *memory = pci_scratch_allocate(scratch, grown, element_size);
    if (memory == NULL) {
        return false;
    }
    if (*capacity != 0) {
        memcpy(memory, *array, *capacity * element_size);
    }
    *array = memory;
    *capacity = grown;
    return true;
}
