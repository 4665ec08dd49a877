// Includes that every unit test needs, and a context that must stay free of errors.
#ifndef TEST_SUPPORT_H
#define TEST_SUPPORT_H

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "core/core.h"
#include "proxycloth/proxycloth.h"

static inline pc_context *test_context(uint32_t threads) {
    pc_context *context = NULL;
    const pc_context_options options = {.threads = threads};
    assert_int_equal(pc_context_create(&options, &context), PC_OK);
    return context;
}

static inline bool test_refuse_progress(void *user, const char *stage, double fraction) {
    (void)user;
    (void)stage;
    (void)fraction;
    return false;
}

// A context of one thread whose user cancels at the first report of progress.
static inline pc_context *test_cancelling_context(void) {
    pc_context *context = NULL;
    const pc_context_options options = {.threads = 1, .progress = test_refuse_progress};
    assert_int_equal(pc_context_create(&options, &context), PC_OK);
    return context;
}

// Fails the test with the context's message unless the call succeeded.
#define assert_ok(context, call)                                                                   \
    do {                                                                                           \
        if ((call) != PC_OK) {                                                                     \
            fail_msg("%s: %s", #call, pc_context_error(context)->message);                         \
        }                                                                                          \
    } while (0)

// |a - b| <= tolerance; NaN fails.
#define assert_close(a, b, tolerance)                                                              \
    do {                                                                                           \
        const double a_ = (a), b_ = (b);                                                           \
        if (!(fabs(a_ - b_) <= (tolerance))) {                                                     \
            fail_msg("%s = %.17g, expected %.17g within %.3g", #a, a_, b_, (double)(tolerance));   \
        }                                                                                          \
    } while (0)

#endif
