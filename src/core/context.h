// Inside of pc_context; for core only.
#ifndef PCI_CONTEXT_H
#define PCI_CONTEXT_H

#include "core/core.h"

typedef struct pci_pool pci_pool;

struct pc_context {
    pc_context_options options;
    pc_error error;
    pci_pool *pool;
    // The last report of progress, and whether the user cancelled since pci_begin_stage.
    const char *stage;
    double fraction, reported;
    bool cancelled;
    // pci_bvh_share
    const struct pc_mesh *shared_mesh;
    struct pci_bvh *shared_bvh; // NULL until somebody asks for it
    void *embree;               // the device of all trees (embree.h); NULL before the first one
};

// The allocator of contexts without one of their own.
void *pci_default_allocate(void *user, size_t size);

// Worker threads that wait for pci_parallel_for; `threads` 0 means one per core. Where threads
// cannot be started the pool has fewer. NULL: out of memory.
pci_pool *pci_pool_create(pc_context *context, uint32_t threads);
void pci_pool_destroy(pc_context *context, pci_pool *pool);
uint32_t pci_pool_threads(const pci_pool *pool);

#endif
