// Writers of assets under an allocator that fails.
#ifndef TEST_SUPPORT_LACK_OF_MEMORY_H
#define TEST_SUPPORT_LACK_OF_MEMORY_H

#include <unistd.h>

#include "support/asset_fixture.h"
#include "support/memory.h"

// Every allocation of `write` fails once, up to the first call that succeeds: out of memory, no
// file at `path`, no leak. At least `least` calls must have failed.
static inline void check_writing_without_memory(pc_status (*write)(pc_context *context,
                                                                   const pc_asset *asset,
                                                                   const char *path),
                                                const char *path, size_t least) {
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    unlink(path);
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        assert_int_not_equal(access(path, F_OK), 0);
        s.status = write(context, &asset, path);
    }
    assert_true(s.failures >= least);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

#endif
