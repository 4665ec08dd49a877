// assimp 5.2 leaves out vertices whose first number begins with a point, and those with a comment
// or a fourth color behind them; it reads indices with a plus or leading zeros twice, skips
// indented lines, and names no line when something is wrong. This rewrites an OBJ file in memory in
// the spelling that assimp reads right: positive indices, three or six numbers per vertex, one
// statement per line.
#define _POSIX_C_SOURCE 200809L
#include "scene.h"

#include <ctype.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

enum { VERTEX, TEXCOORD, NORMAL, KINDS };

typedef struct obj_text {
    const char *path, *at, *end; // what is left of the input
    size_t next_line, line;      // numbers; `words` begins at `line`
    char *words;                 // one statement without its line ends
    char *out;
    size_t size, capacity;
    size_t total[KINDS], seen[KINDS];
    bool colored;  // one vertex at least
    bool drawn;    // a face or a line
    char *message; // of `message_size`, empty: nothing is wrong
    size_t message_size;
} obj_text;

__attribute__((format(printf, 2, 3))) static bool fail(obj_text *o, const char *format, ...) {
    va_list arguments;
    const int used = snprintf(o->message, o->message_size, "line %zu: ", o->line);
    va_start(arguments, format);
    vsnprintf(o->message + used, o->message_size - (size_t)used, format, arguments);
    va_end(arguments);
    return false;
}

static bool put(obj_text *o, const char *bytes, size_t size) {
    if (size > o->capacity - o->size) {
        const size_t grown = 2 * o->capacity + size;
        char *out = realloc(o->out, grown);
        if (out == NULL) {
            snprintf(o->message, o->message_size, "bad_alloc");
            return false;
        }
        o->out = out;
        o->capacity = grown;
    }
    memcpy(o->out + o->size, bytes, size);
    o->size += size;
    return true;
}

static bool put_text(obj_text *o, const char *text) { return put(o, text, strlen(text)); }

// ---- statements and words -----------------------------------------------------------------------

// Takes the next statement: a line, and those behind it while a backslash ends them. Lines end with
// \n, \r\n or \r.
static bool next_statement(obj_text *o) {
    size_t length = 0;
    o->line = o->next_line;
    if (o->at == o->end) {
        return false;
    }
    while (o->at != o->end) {
        const char c = *o->at++;
        if (c != '\n' && c != '\r') {
            o->words[length++] = c != '\0' ? c : '?';
            continue;
        }
        o->at += c == '\r' && o->at != o->end && *o->at == '\n';
        ++o->next_line;
        if (length == 0 || o->words[length - 1] != '\\') {
            break;
        }
        o->words[length - 1] = ' ';
    }
    o->words[length] = '\0';
    return true;
}

// The next word behind `at` and its length, 0 at the end of the statement or at a comment.
static char *next_word(char *at, size_t *length) {
    at += strspn(at, " \t");
    *length = strcspn(at, " \t#");
    return at;
}

// Whether a word is a number. A decimal comma becomes a point.
static bool check_number(char *word, size_t length) {
    char *at = word + (word[0] == '-' || word[0] == '+');
    if (strncasecmp(at, "nan", 3) == 0 || strncasecmp(at, "inf", 3) == 0) {
        return true;
    }
    size_t digits = strspn(at, "0123456789");
    at += digits;
    if (*at == '.' || *at == ',') {
        *at++ = '.';
        const size_t decimals = strspn(at, "0123456789");
        digits += decimals;
        at += decimals;
    }
    if (digits != 0 && (*at == 'e' || *at == 'E')) {
        at += 1 + (at[1] == '-' || at[1] == '+');
        digits = strspn(at, "0123456789");
        at += digits;
    }
    return digits != 0 && at == word + length;
}

static bool check_numbers(obj_text *o, char *at, size_t *count) {
    size_t length;
    for (*count = 0; (at = next_word(at, &length), length != 0); at += length, ++*count) {
        if (!check_number(at, length)) {
            return fail(o, "\"%.*s\" is no number", length < 40 ? (int)length : 40, at);
        }
    }
    return true;
}

// The first numbers of a statement.
static bool put_numbers(obj_text *o, const char *key, char *at, size_t count) {
    size_t length;
    bool fits = put_text(o, key);
    for (; fits && count != 0; at += length, --count) {
        at = next_word(at, &length);
        fits = put_text(o, *at == '.' ? " 0" : " ") && put(o, at, length);
    }
    return fits;
}

// ---- what a statement becomes -------------------------------------------------------------------

// x y z, x y z w, x y z r g b or x y z r g b a. Either all vertices have colors or none.
static bool write_vertex(obj_text *o, char *at) {
    size_t count;
    if (!check_numbers(o, at, &count)) {
        return false;
    }
    if (count != 3 && count != 4 && count != 6 && count != 7) {
        return fail(
            o, "a vertex has %zu numbers; 3 are read, 4 with a weight, and 6 or 7 with a color",
            count);
    }
    double vector[4] = {0.0, 0.0, 0.0, 1.0};
    char *next = at;
    for (size_t k = 0; k < 4 && count == 4; ++k) {
        vector[k] = strtod(next, &next);
    }
    if (vector[3] == 0.0) {
        return fail(o, "a vertex has the weight 0");
    }
    if (vector[3] != 1.0) {
        char text[128];
        snprintf(text, sizeof(text), "v %.9g %.9g %.9g", vector[0] / vector[3],
                 vector[1] / vector[3], vector[2] / vector[3]);
        if (!put_text(o, text)) {
            return false;
        }
    } else if (!put_numbers(o, "v", at, count < 6 ? 3 : 6)) {
        return false;
    }
    return put_text(o, o->colored && count < 6 ? " 1 1 1\n" : "\n");
}

static bool write_texcoord(obj_text *o, char *at) {
    size_t count;
    return check_numbers(o, at, &count) &&
           (count != 0 || fail(o, "texture coordinates without a number")) &&
           put_numbers(o, "vt", at, count < 2 ? count : 2) &&
           put_text(o, count < 2 ? " 0\n" : "\n");
}

static bool write_normal(obj_text *o, char *at) {
    size_t count;
    return check_numbers(o, at, &count) &&
           (count == 3 || fail(o, "a normal has %zu numbers instead of 3", count)) &&
           put_numbers(o, "vn", at, 3) && put_text(o, "\n");
}

// The index at `*at`: 0 when there is none. Negative ones count back from here.
static bool read_index(obj_text *o, char **at, size_t kind, long long *index) {
    static const char *const names[KINDS] = {"vertex", "texture coordinate", "normal"};
    const char *word = *at, *digits = word + (*word == '-' || *word == '+');
    *index = 0;
    if (!isdigit((unsigned char)*digits)) {
        return true;
    }
    const long long given = strtoll(*at, at, 10);
    *index = given < 0 ? given + (long long)o->seen[kind] + 1 : given;
    if (o->total[kind] == 0 && kind != VERTEX) {
        *index = 0; // some write indices of what they leave out
    } else if (*index <= 0 || *index > (long long)o->total[kind]) {
        return fail(o, "there is no %s %.*s; the file has %zu%s", names[kind],
                    *at - word < 20 ? (int)(*at - word) : 20, word,
                    given < 0 ? o->seen[kind] : o->total[kind], given < 0 ? " up to there" : "");
    }
    return true;
}

static bool put_index(obj_text *o, const char *before, long long index) {
    char digits[24];
    size_t first = sizeof(digits);
    for (; index != 0; index /= 10) {
        digits[--first] = (char)('0' + index % 10);
    }
    return put_text(o, before) && put(o, digits + first, sizeof(digits) - first);
}

// Corners of a face, line or point: v, v/t, v//n or v/t/n.
static bool write_corners(obj_text *o, const char *key, char *at) {
    size_t length;
    if (!put_text(o, key)) {
        return false;
    }
    for (; (at = next_word(at, &length), length != 0); at += length) {
        long long index[KINDS] = {0};
        char *end = at;
        for (size_t kind = 0; kind < KINDS; ++kind) {
            if (!read_index(o, &end, kind, &index[kind])) {
                return false;
            }
            if (*end != '/' || kind == NORMAL) {
                break;
            }
            ++end;
        }
        if (index[VERTEX] == 0 || end != at + length) {
            return fail(o, "\"%.*s\" is no corner of a face", length < 40 ? (int)length : 40, at);
        }
        if (!put_index(o, " ", index[VERTEX]) ||
            (index[TEXCOORD] != 0 && !put_index(o, "/", index[TEXCOORD])) ||
            (index[NORMAL] != 0 &&
             !put_index(o, index[TEXCOORD] != 0 ? "/" : "//", index[NORMAL]))) {
            return false;
        }
    }
    return put_text(o, "\n");
}

// A file of materials is looked for beside the OBJ file: under the name given, else under that of
// the OBJ file.
static bool write_library(obj_text *o, char *at) {
    const char *slash = strrchr(o->path, '/');
    const int folder = slash != NULL ? (int)(slash + 1 - o->path) : 0;
    const size_t size = strlen(o->path) + strlen(at) + 8;
    char *file = malloc(size);
    if (file == NULL) {
        snprintf(o->message, o->message_size, "bad_alloc");
        return false;
    }
    at += strspn(at, " \t");
    for (size_t length = strlen(at); length != 0 && strchr(" \t", at[length - 1]) != NULL;) {
        at[--length] = '\0';
    }
    const char *here = o->path[0] == '/' ? "" : "./";
    if (at[0] == '/') {
        snprintf(file, size, "%s", at);
    } else {
        snprintf(file, size, "%s%.*s%s", here, folder, o->path, at);
    }
    if (at[0] == '\0' || access(file, R_OK) != 0) {
        const char *dot = strrchr(o->path + folder, '.');
        const size_t stem = dot != NULL ? (size_t)(dot - o->path) : strlen(o->path);
        snprintf(file, size, "%s%.*s.mtl", here, (int)stem, o->path);
    }
    const bool fits = strpbrk(file, "\r\n") != NULL || access(file, R_OK) != 0 ||
                      (put_text(o, "mtllib ") && put_text(o, file) && put_text(o, "\n"));
    free(file);
    return fits;
}

typedef enum keyword { OTHER, V, VT, VN, F, L, P, LIBRARY, NAME } keyword;

// The keyword of a statement, and what is behind it.
static keyword read_keyword(char *words, char **behind) {
    static const struct {
        const char *text;
        keyword word;
    } known[] = {{"v", V}, {"vt", VT},  {"vn", VN},  {"f", F},         {"fo", F},          {"l", L},
                 {"p", P}, {"o", NAME}, {"g", NAME}, {"usemtl", NAME}, {"mtllib", LIBRARY}};
    size_t length;
    char *word = next_word(words, &length);
    *behind = word + length;
    for (size_t i = 0; i < sizeof(known) / sizeof(known[0]); ++i) {
        if (strlen(known[i].text) == length && memcmp(word, known[i].text, length) == 0) {
            return known[i].word;
        }
    }
    return OTHER;
}

// Counts what indices may refer to, also further down.
static void count_all(obj_text *o) {
    while (next_statement(o)) {
        char *at;
        size_t length, numbers = 0;
        const keyword word = read_keyword(o->words, &at);
        if (word != V && word != VT && word != VN) {
            continue;
        }
        ++o->total[word == V ? VERTEX : word == VT ? TEXCOORD : NORMAL];
        for (; word == V && !o->colored && (at = next_word(at, &length), length != 0);
             at += length) {
            o->colored = ++numbers >= 6;
        }
    }
}

static bool write_statement(obj_text *o) {
    char *at;
    switch (read_keyword(o->words, &at)) {
    case V:
        ++o->seen[VERTEX];
        return write_vertex(o, at);
    case VT:
        ++o->seen[TEXCOORD];
        return write_texcoord(o, at);
    case VN:
        ++o->seen[NORMAL];
        return write_normal(o, at);
    case F:
        o->drawn = true;
        return write_corners(o, "f", at);
    case L:
        o->drawn = true;
        return write_corners(o, "l", at);
    case P:
        return write_corners(o, "p", at);
    case LIBRARY:
        return write_library(o, at);
    case NAME:
        return put_text(o, o->words + strspn(o->words, " \t")) && put_text(o, "\n");
    case OTHER:
    default:
        return true;
    }
}

char *scene_plain_obj(const char *path, const char *bytes, size_t *size, char *message,
                      size_t message_size) {
    const size_t mark = *size >= 3 && memcmp(bytes, "\xef\xbb\xbf", 3) == 0 ? 3 : 0;
    const obj_text fresh = {.path = path,
                            .at = bytes + mark,
                            .end = bytes + *size,
                            .next_line = 1,
                            .message = message,
                            .message_size = message_size};
    obj_text o = fresh;
    message[0] = '\0';
    o.words = malloc(*size + 1);
    o.capacity = *size + 64;
    o.out = malloc(o.capacity);
    if (o.words == NULL || o.out == NULL) {
        snprintf(message, message_size, "bad_alloc");
    } else {
        count_all(&o);
        o.at = fresh.at;
        o.next_line = 1;
        while (next_statement(&o) && write_statement(&o)) {
        }
        if (message[0] == '\0' && o.total[VERTEX] == 0) {
            snprintf(message, message_size, "the file holds no vertex");
        } else if (message[0] == '\0' && !o.drawn) {
            snprintf(message, message_size, "the file holds no face; export it with them");
        }
    }
    free(o.words);
    if (message[0] != '\0') {
        free(o.out);
        return NULL;
    }
    *size = o.size;
    return o.out;
}
