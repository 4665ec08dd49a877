// What the files of proxycloth_hostile share.
#ifndef HOSTILE_H
#define HOSTILE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

// Bytes that grow.
typedef struct text {
    char *bytes;
    size_t size, capacity;
} text;

void text_append(text *t, const void *bytes, size_t size);
__attribute__((format(printf, 2, 3))) void text_print(text *t, const char *format, ...);

// Damages a file in one to three ways that depend on the seed only, and says how.
void mutate(text *file, uint64_t seed, char *description, size_t description_size);

// Hand-made worst cases: the file number `index`, or false when there are no more. `large` ones
// have a million triangles.
bool hand_made(size_t index, bool large, text *file, const char **name, const char **extension);

#endif
