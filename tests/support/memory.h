// An allocator that counts what is alive and can fail once.
#ifndef TEST_SUPPORT_MEMORY_H
#define TEST_SUPPORT_MEMORY_H

#include <stdlib.h>

#include "support/test.h"

typedef struct counting_allocator {
    size_t calls, live;
    size_t fail_at; // number of the call that returns NULL, counted from 1; 0: none
} counting_allocator;

static inline void *counting_allocate(void *user, size_t size) {
    counting_allocator *counter = user;
    if (++counter->calls == counter->fail_at) {
        return NULL;
    }
    void *memory = malloc(size);
    counter->live += memory != NULL;
    return memory;
}

static inline void counting_release(void *user, void *memory) {
    ((counting_allocator *)user)->live -= 1;
    free(memory);
}

// The call number `number` from now on fails.
static inline void fail_allocation(counting_allocator *counter, size_t number) {
    counter->calls = 0;
    counter->fail_at = number;
}

// A call that is made again and again while its first allocation fails, its second, and so on,
// until none is left to fail:
//     starvation s = {.counter = &counter};
//     while (starves(&s)) {
//         s.status = call(...);
//         ... what must hold; gives back what the call gave
//     }
//     assert_true(s.failures > ...);
// Every call must end with PC_OK or out of memory, and leak nothing.
typedef struct starvation {
    counting_allocator *counter;
    size_t growth; // the number grows by 1 and this part of itself, 0: by 1
    size_t number; // of the allocation that fails
    size_t live, failures;
    pc_status status;
} starvation;

static inline bool starves(starvation *s) {
    if (s->number == 0) {
        s->live = s->counter->live;
    } else {
        assert_true(s->status == PC_OK || s->status == PC_ERROR_OUT_OF_MEMORY);
        assert_int_equal(s->counter->live, s->live);
        if (s->status == PC_OK) {
            s->counter->fail_at = 0;
            return false;
        }
        ++s->failures;
    }
    s->number += 1 + (s->growth > 0 ? s->number / s->growth : 0);
    fail_allocation(s->counter, s->number);
    return true;
}

// A context of one thread on top of it.
static inline pc_context *counting_context(counting_allocator *counter) {
    const pc_context_options options = {.allocator = {counting_allocate, counting_release, counter},
                                        .threads = 1};
    pc_context *context = NULL;
    assert_int_equal(pc_context_create(&options, &context), PC_OK);
    return context;
}

#endif
