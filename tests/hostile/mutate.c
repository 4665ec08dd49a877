// Damage to files: seeded, so that a case can be made again.
#include "hostile.h"

#include <ctype.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/core.h"

typedef struct dice {
    uint64_t seed, thrown;
} dice;

static size_t throw_below(dice *d, size_t end) {
    return end == 0 ? 0 : (size_t)(pci_random_bits(d->seed, 1, d->thrown++) % end);
}

// Where headers and tables are: near the beginning half of the time.
static size_t place(dice *d, size_t size) {
    const size_t head = size < 2048 ? size : 2048;
    return throw_below(d, throw_below(d, 2) == 0 ? head : size);
}

static void flip_bits(text *file, dice *d) {
    for (size_t count = (size_t)1 << throw_below(d, 8); count > 0 && file->size > 0; --count) {
        file->bytes[place(d, file->size)] ^= (char)(1 << throw_below(d, 8));
    }
}

static void truncate_file(text *file, dice *d) {
    const size_t kept = place(d, file->size);
    file->size = kept > 0 ? kept : file->size;
}

static void remove_range(text *file, dice *d) {
    const size_t at = place(d, file->size), length = throw_below(d, (file->size - at) / 2 + 1);
    memmove(file->bytes + at, file->bytes + at + length, file->size - at - length);
    file->size -= length;
}

static void repeat_range(text *file, dice *d) {
    const size_t at = place(d, file->size);
    size_t length = throw_below(d, file->size - at);
    length = length < 65536 ? length : 65536;
    char *copy = malloc(length + 1);
    memcpy(copy, file->bytes + at, length);
    text_append(file, copy, length); // makes room
    const size_t to = place(d, file->size - length);
    memmove(file->bytes + to + length, file->bytes + to, file->size - length - to);
    memcpy(file->bytes + to, copy, length);
    free(copy);
}

static void swap_ranges(text *file, dice *d) {
    size_t a = place(d, file->size), b = place(d, file->size);
    if (a > b) {
        const size_t swapped = a;
        a = b, b = swapped;
    }
    size_t length = file->size - b < b - a ? file->size - b : b - a;
    length = throw_below(d, length + 1);
    for (size_t i = 0; i < length; ++i) {
        const char byte = file->bytes[a + i];
        file->bytes[a + i] = file->bytes[b + i];
        file->bytes[b + i] = byte;
    }
}

// A number of 32 bits that could be a size becomes another one.
static void change_size_field(text *file, dice *d) {
    static const uint32_t values[] = {0,          1,          0xffffffff, 0x7fffffff,
                                      0x80000000, 1000000000, 0x00010000, 0xfffffffc};
    if (file->size < 4) {
        return;
    }
    size_t at = 0;
    for (size_t attempt = 0; attempt < 64; ++attempt) {
        uint32_t value;
        at = place(d, file->size - 3) & ~(size_t)3;
        memcpy(&value, file->bytes + at, sizeof(value));
        if (value <= file->size) {
            break;
        }
    }
    const size_t choice = throw_below(d, 10);
    const uint32_t value = choice < 8 ? values[choice] : (uint32_t)throw_below(d, 2 * file->size);
    memcpy(file->bytes + at, &value, sizeof(value));
}

// A number in a text becomes another one.
static void change_number(text *file, dice *d) {
    static const char *const numbers[] = {
        "0",     "-1",  "1e30", "-1e30",      "1e-30",      "4e-324",
        "1e300", "nan", "inf",  "1000000000", "4294967297", "99999999999999999999",
        "1/2/3", "",    "0x7f", "-2147483648"};
    for (size_t count = (size_t)1 << throw_below(d, 6); count > 0; --count) {
        size_t at = place(d, file->size), end = 0;
        while (at < file->size && !isdigit((unsigned char)file->bytes[at])) {
            ++at;
        }
        end = at;
        while (end < file->size &&
               (isdigit((unsigned char)file->bytes[end]) || file->bytes[end] == '.')) {
            ++end;
        }
        if (at == end) {
            return;
        }
        const char *number = numbers[throw_below(d, sizeof(numbers) / sizeof(numbers[0]))];
        const size_t length = strlen(number), rest = file->size - end;
        text_append(file, number, length); // makes room
        memmove(file->bytes + at + length, file->bytes + end, rest);
        memcpy(file->bytes + at, number, length);
        file->size = at + length + rest;
    }
}

static void overwrite_range(text *file, dice *d) {
    const size_t at = place(d, file->size), kind = throw_below(d, 3);
    size_t length = throw_below(d, file->size - at + 1);
    length = length < 4096 ? length : 4096;
    for (size_t i = 0; i < length; ++i) {
        file->bytes[at + i] = (char)(kind == 0 ? 0 : kind == 1 ? 0xff : (int)throw_below(d, 256));
    }
}

void mutate(text *file, uint64_t seed, char *description, size_t description_size) {
    static const struct {
        const char *name;
        void (*apply)(text *file, dice *d);
    } ways[] = {{"bits", flip_bits},         {"truncated", truncate_file},
                {"removed", remove_range},   {"repeated", repeat_range},
                {"swapped", swap_ranges},    {"size", change_size_field},
                {"number", change_number},   {"overwritten", overwrite_range},
                {"size", change_size_field}, {"number", change_number}};
    dice d = {.seed = seed};
    size_t used = 0;
    description[0] = '\0';
    for (size_t count = 1 + throw_below(&d, 3); count > 0 && file->size > 0; --count) {
        const size_t way = throw_below(&d, sizeof(ways) / sizeof(ways[0]));
        ways[way].apply(file, &d);
        const int length = snprintf(description + used, description_size - used, "%s%s",
                                    used > 0 ? "+" : "", ways[way].name);
        used += length > 0 && (size_t)length < description_size - used ? (size_t)length : 0;
    }
}
