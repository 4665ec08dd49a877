// assimp 5.2 takes an STL file that was cut for one of unknown kind, and a cut text for a whole
// one.
#include "scene.h"

#include <string.h>

enum { HEADER = 84, TRIANGLE = 50 };

// Where a word begins last in a text without '\0'; NULL: nowhere.
static const char *find_last(const char *bytes, size_t size, const char *word) {
    const size_t length = strlen(word);
    for (size_t i = size < length ? 0 : size - length + 1; i-- > 0;) {
        if (memcmp(bytes + i, word, length) == 0) {
            return bytes + i;
        }
    }
    return NULL;
}

bool scene_check_stl(const char *bytes, size_t *size, char *message, size_t message_size) {
    message[0] = '\0';
    uint32_t count = 0;
    if (*size >= HEADER) {
        memcpy(&count, bytes + HEADER - sizeof(count), sizeof(count));
    }
    const uint64_t whole = HEADER + TRIANGLE * (uint64_t)count;
    const bool text = memchr(bytes, '\0', *size) == NULL && *size != whole;
    if (text && find_last(bytes, *size, "endsolid") < find_last(bytes, *size, "vertex")) {
        snprintf(message, message_size, "the file ends before \"endsolid\"; export it again");
    } else if (!text && *size < HEADER) {
        snprintf(message, message_size, "the file ends within its header; export it again");
    } else if (!text && *size < whole) {
        snprintf(message, message_size, "the file ends behind %zu of %u triangles; export it again",
                 (*size - HEADER) / TRIANGLE, (unsigned)count);
    } else if (!text) {
        *size = (size_t)whole; // what follows is left out
    }
    return message[0] == '\0';
}
