// Files in a folder of their own. Needs _POSIX_C_SOURCE 200809L.
#ifndef TEST_SUPPORT_FILES_H
#define TEST_SUPPORT_FILES_H

#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#include "support/test.h"

typedef struct bytes {
    unsigned char *data;
    size_t size;
} bytes;

// All bytes of a file and a '\0' behind them; free `data`.
static inline bytes read_bytes(const char *name) {
    FILE *file = fopen(name, "rb");
    assert_non_null(file);
    fseek(file, 0, SEEK_END);
    bytes content = {.size = (size_t)ftell(file)};
    rewind(file);
    content.data = calloc(content.size + 1, 1);
    assert_non_null(content.data);
    assert_int_equal(fread(content.data, 1, content.size, file), content.size);
    fclose(file);
    return content;
}

static inline void write_bytes(const char *name, const void *data, size_t size) {
    FILE *file = fopen(name, "wb");
    assert_non_null(file);
    assert_int_equal(fwrite(data, 1, size, file), size);
    assert_int_equal(fclose(file), 0);
}

static inline void assert_same_file(const char *a, const char *b) {
    bytes x = read_bytes(a), y = read_bytes(b);
    assert_int_equal(x.size, y.size);
    assert_memory_equal(x.data, y.data, x.size);
    free(x.data);
    free(y.data);
}

// Makes a folder and the paths of two files in it.
static inline int test_make_folder(char folder[64], char first[64], const char *first_name,
                                   char second[64], const char *second_name) {
    snprintf(folder, 64, "/tmp/proxycloth-XXXXXX");
    if (mkdtemp(folder) == NULL) {
        return -1;
    }
    snprintf(first, 64, "%.40s/%.20s", folder, first_name);
    snprintf(second, 64, "%.40s/%.20s", folder, second_name);
    return 0;
}

// Fails when anything but the two files is left behind.
static inline int test_remove_folder(const char *folder, const char *first, const char *second) {
    unlink(first);
    unlink(second);
    return rmdir(folder);
}

#endif
