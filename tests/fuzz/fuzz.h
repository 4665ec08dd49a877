// What fuzz targets share. Each fuzz_NAME.c defines LLVMFuzzerTestOneInput; with PROXYCLOTH_FUZZ it
// becomes the libFuzzer program fuzz_NAME, and always replay_NAME, which runs the kept files in
// corpus/NAME.
#ifndef FUZZ_H
#define FUZZ_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#include "proxycloth/proxycloth.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

// A promise of the library that does not hold is a crash.
#define fuzz_assert(condition) fuzz_require((condition), __FILE__, __LINE__, #condition)
static inline void fuzz_require(bool condition, const char *file, int line, const char *text) {
    if (!condition) {
        fprintf(stderr, "%s:%d: %s\n", file, line, text);
        abort();
    }
}

// One context for all runs.
static inline pc_context *fuzz_context(void) {
    static pc_context *context;
    const pc_context_options options = {.threads = 1};
    if (context == NULL) {
        fuzz_assert(pc_context_create(&options, &context) == PC_OK);
    }
    return context;
}

// Path of a file in memory with these bytes; the same file every time.
const char *fuzz_file(const uint8_t *data, size_t size);

// Messages on standard error go nowhere from now on.
void fuzz_be_silent(void);

#endif
