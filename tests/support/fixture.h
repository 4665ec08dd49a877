// Reads the number tables of tests/fixtures: text with any separators, or raw little-endian
// doubles.
#ifndef TEST_SUPPORT_FIXTURE_H
#define TEST_SUPPORT_FIXTURE_H

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

// The whole file with a terminating zero; NULL: cannot be read. The caller frees it.
static inline char *test_read_file(const char *path, size_t *size) {
    FILE *file = fopen(path, "rb");
    if (file == NULL) {
        return NULL;
    }
    fseek(file, 0, SEEK_END);
    const long length = ftell(file);
    rewind(file);
    char *text = malloc((size_t)length + 1);
    if (text != NULL) {
        *size = fread(text, 1, (size_t)length, file);
        text[*size] = '\0';
    }
    fclose(file);
    return text;
}

// All numbers of a text table, or of a file of doubles when its name ends in ".f64". The caller
// frees them.
static inline double *test_read_numbers(const char *path, size_t *count) {
    size_t size = 0;
    char *text = test_read_file(path, &size);
    *count = 0;
    if (text == NULL || strstr(path, ".f64") != NULL) {
        *count = size / sizeof(double);
        return (double *)(void *)text;
    }
    double *numbers = malloc((size / 2 + 1) * sizeof(double));
    for (char *at = text; numbers != NULL && *at != '\0';) {
        char *end = NULL;
        const double number = strtod(at, &end);
        if (end == at) {
            ++at;
        } else {
            numbers[(*count)++] = number;
            at = end;
        }
    }
    free(text);
    return numbers;
}

// The numbers that follow "key": in a JSON file, up to the closing bracket that matches.
static inline double *test_read_json_numbers(const char *path, const char *key, size_t *count) {
    size_t size = 0;
    char *text = test_read_file(path, &size);
    char quoted[64];
    snprintf(quoted, sizeof(quoted), "\"%s\":", key);
    char *at = text != NULL ? strstr(text, quoted) : NULL;
    *count = 0;
    if (at == NULL) {
        free(text);
        return NULL;
    }
    double *numbers = malloc((size / 2 + 1) * sizeof(double));
    int depth = 0;
    for (at += strlen(quoted); numbers != NULL && *at != '\0' && *at != '}';) {
        char *end = NULL;
        const double number = strtod(at, &end);
        depth += *at == '[' ? 1 : *at == ']' ? -1 : 0;
        if (end == at) {
            ++at;
        } else {
            numbers[(*count)++] = number;
            at = end;
        }
        if (depth <= 0 && (*at == ',' || *at == ']' || *at == '\n')) {
            break;
        }
    }
    free(text);
    return numbers;
}

#endif
