// assimp 5.2 does not notice where a PLY file ends too early: it takes faces for vertices then, or
// what lies behind the file in memory. This counts what the header announces.
#define _POSIX_C_SOURCE 200809L
#include "scene.h"

#include <stdlib.h>
#include <string.h>

enum { ELEMENTS = 16, PROPERTIES = 64, WORD = 32 };

typedef struct ply_property {
    size_t count_size; // bytes of the number in front of a list, 0: no list
    size_t size;       // bytes of a number
} ply_property;

typedef struct ply_element {
    char name[WORD];
    unsigned long long count;
    ply_property properties[PROPERTIES];
    size_t property_count;
} ply_element;

typedef struct ply_file {
    const char *at, *end; // what is left
    size_t line;          // number of the line that was taken last
    bool binary, big_endian;
    ply_element elements[ELEMENTS];
    size_t element_count;
} ply_file;

typedef struct span {
    const char *at, *end;
} span;

// Takes the next line. Lines end with \n, \r\n or \r.
static bool next_line(ply_file *file, span *line) {
    line->at = file->at;
    while (file->at != file->end && *file->at != '\n' && *file->at != '\r') {
        ++file->at;
    }
    line->end = file->at;
    const bool ended = file->at != file->end;
    file->at += ended;
    file->at += ended && file->at != file->end && file->at[-1] == '\r' && *file->at == '\n';
    ++file->line;
    return ended || line->at != line->end;
}

static span next_word(span *line) {
    while (line->at != line->end && strchr(" \t", *line->at) != NULL) {
        ++line->at;
    }
    const span word = {line->at, line->end};
    while (line->at != line->end && strchr(" \t", *line->at) == NULL) {
        ++line->at;
    }
    return (span){word.at, line->at};
}

// The next word as text, cut where it is too long.
static void copy_word(span *line, char text[WORD]) {
    const span word = next_word(line);
    const size_t length = (size_t)(word.end - word.at);
    memset(text, 0, WORD);
    memcpy(text, word.at, length < WORD ? length : WORD - 1);
}

static size_t type_size(const char *type) {
    static const struct {
        const char *name;
        size_t size;
    } types[] = {{"char", 1},  {"uchar", 1},   {"int8", 1},   {"uint8", 1},
                 {"short", 2}, {"ushort", 2},  {"int16", 2},  {"uint16", 2},
                 {"int", 4},   {"uint", 4},    {"int32", 4},  {"uint32", 4},
                 {"float", 4}, {"float32", 4}, {"double", 8}, {"float64", 8}};
    for (size_t i = 0; i < sizeof(types) / sizeof(types[0]); ++i) {
        if (strcmp(type, types[i].name) == 0) {
            return types[i].size;
        }
    }
    return 0;
}

// False: not understood, which is left to assimp.
static bool read_header(ply_file *file) {
    span line;
    char words[4][WORD];
    while (next_line(file, &line)) {
        for (size_t i = 0; i < 4; ++i) {
            copy_word(&line, words[i]);
        }
        ply_element *element =
            file->element_count != 0 ? &file->elements[file->element_count - 1] : NULL;
        if (strcmp(words[0], "end_header") == 0) {
            return true;
        }
        if (strcmp(words[0], "format") == 0) {
            file->binary = strncmp(words[1], "binary", 6) == 0;
            file->big_endian = strcmp(words[1], "binary_big_endian") == 0;
        } else if (strcmp(words[0], "element") == 0) {
            if (file->element_count == ELEMENTS) {
                return false;
            }
            element = &file->elements[file->element_count++];
            memcpy(element->name, words[1], WORD);
            element->count = strtoull(words[2], NULL, 10);
        } else if (strcmp(words[0], "property") == 0) {
            if (element == NULL || element->property_count == PROPERTIES) {
                return false;
            }
            ply_property *property = &element->properties[element->property_count++];
            const bool list = strcmp(words[1], "list") == 0;
            property->count_size = list ? type_size(words[2]) : 0;
            property->size = type_size(words[list ? 3 : 1]);
            if (property->size == 0 || (list && property->count_size == 0)) {
                return false;
            }
        }
    }
    return false;
}

// Takes one element of a text file: a line, empty ones aside.
static bool take_line(ply_file *file, const ply_element *element, bool *complete) {
    span line, word;
    do {
        if (!next_line(file, &line)) {
            return false;
        }
        word = line;
        word = next_word(&word);
    } while (word.at == word.end);
    *complete = true;
    for (size_t i = 0; i < element->property_count && *complete; ++i) {
        unsigned long long count = 1;
        if (element->properties[i].count_size != 0) {
            char text[WORD];
            copy_word(&line, text);
            *complete = text[0] != '\0';
            count = strtoull(text, NULL, 10);
        }
        for (; count != 0 && *complete; --count) {
            word = next_word(&line);
            *complete = word.at != word.end;
        }
    }
    return true;
}

// Takes one element of a binary file.
static bool take_bytes(ply_file *file, const ply_element *element) {
    for (size_t i = 0; i < element->property_count; ++i) {
        const ply_property *property = &element->properties[i];
        unsigned long long count = property->count_size == 0;
        if (property->count_size > (size_t)(file->end - file->at)) {
            return false;
        }
        for (size_t k = 0; k < property->count_size; ++k) {
            const size_t shift = file->big_endian ? property->count_size - 1 - k : k;
            count |= (unsigned long long)(unsigned char)*file->at++ << 8 * shift;
        }
        if (count > (size_t)(file->end - file->at) / property->size) {
            return false;
        }
        file->at += count * property->size;
    }
    return true;
}

bool scene_check_ply(const char *bytes, size_t size, char *message, size_t message_size) {
    ply_file *file = calloc(1, sizeof(*file));
    message[0] = '\0';
    if (file == NULL) {
        snprintf(message, message_size, "bad_alloc");
        return false;
    }
    file->at = bytes;
    file->end = bytes + size;
    const bool known = read_header(file);
    unsigned long long faces = 0;
    for (size_t i = 0; known && i < file->element_count && message[0] == '\0'; ++i) {
        const ply_element *element = &file->elements[i];
        if (strcmp(element->name, "tristrips") == 0) {
            snprintf(message, message_size,
                     "triangle strips are not supported; export it with faces");
        }
        faces += strcmp(element->name, "face") == 0 ? element->count : 0;
        // Without properties there is nothing to run out of.
        const unsigned long long count = element->property_count != 0 ? element->count : 0;
        for (unsigned long long k = 0; k < count && message[0] == '\0'; ++k) {
            bool complete = true;
            if (!(file->binary ? take_bytes(file, element) : take_line(file, element, &complete))) {
                snprintf(message, message_size,
                         "the file ends behind %llu of %llu elements \"%s\"; export it again", k,
                         element->count, element->name);
            } else if (!complete) {
                snprintf(message, message_size,
                         "line %zu: too few numbers for an element \"%s\"; export it again",
                         file->line, element->name);
            }
        }
    }
    if (known && faces == 0 && message[0] == '\0') {
        snprintf(message, message_size, "the file has no faces; export it with them");
    }
    free(file);
    return message[0] == '\0';
}
