#define _GNU_SOURCE // memfd_create
#include "fuzz.h"

#include <stdio.h>
#include <sys/mman.h>
#include <unistd.h>

const char *fuzz_file(const uint8_t *data, size_t size) {
    static char path[64];
    static int file = -1;
    if (file < 0) {
        file = memfd_create("fuzz", MFD_CLOEXEC);
        snprintf(path, sizeof(path), "/proc/self/fd/%d", file);
    }
    fuzz_assert(file >= 0 && ftruncate(file, 0) == 0);
    fuzz_assert(pwrite(file, data, size, 0) == (ssize_t)size);
    return path;
}

void fuzz_be_silent(void) {
    static bool silent;
    if (!silent) {
        silent = freopen("/dev/null", "w", stderr) != NULL;
    }
}
