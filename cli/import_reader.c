// Failures, memory and output of the import child.
#define _POSIX_C_SOURCE 200809L
#include "import_reader.h"

#include <errno.h>
#include <stdarg.h>
#include <stdlib.h>
#include <unistd.h>

void import_write(int descriptor, const void *bytes, size_t size) {
    const char *at = bytes;
    while (size != 0) {
        const ssize_t count = write(descriptor, at, size);
        if (count < 0 && errno != EINTR) {
            _exit(CLI_INTERNAL); // the parent is gone
        }
        at += count > 0 ? count : 0;
        size -= count > 0 ? (size_t)count : 0;
    }
}

_Noreturn void import_fail(scene_reader *reader, const char *format, ...) {
    scene_failure failure = {.magic = SCENE_FAILURE_MAGIC};
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(failure.message, sizeof(failure.message), format, arguments);
    va_end(arguments);
    failure.out_of_memory = strstr(failure.message, "bad_alloc") != NULL ||
                            strstr(failure.message, "length_error") != NULL;
    import_write(reader->descriptor, &failure, sizeof(failure));
    _exit(CLI_INPUT);
}

void *import_grow(scene_reader *reader, void *array, size_t *capacity, size_t needed, size_t size) {
    if (needed <= *capacity) {
        return array;
    }
    size_t grown = 2 * *capacity < needed ? needed : 2 * *capacity;
    char *memory = grown < SIZE_MAX / 2 / size ? realloc(array, grown * size) : NULL;
    if (memory != NULL) {
        memset(memory + *capacity * size, 0, (grown - *capacity) * size);
        *capacity = grown;
        return memory;
    }
    import_fail(reader, "bad_alloc");
}

void *import_allocate(scene_reader *reader, size_t count, size_t size) {
    size_t capacity = 0;
    return import_grow(reader, NULL, &capacity, count + 1, size);
}
