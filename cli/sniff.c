// What kind of file an input is, from its first bytes; the importer is chosen by that, not by luck.
#define _POSIX_C_SOURCE 200809L
#include "scene.h"

#include <errno.h>
#include <fcntl.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include <unistd.h>

static const struct {
    scene_format format;
    const char *extension, *name;
} formats[] = {
    {SCENE_OBJ, "obj", "OBJ"}, {SCENE_FBX, "fbx", "FBX"},     {SCENE_GLTF, "gltf", "glTF"},
    {SCENE_GLB, "glb", "GLB"}, {SCENE_DAE, "dae", "COLLADA"}, {SCENE_PLY, "ply", "PLY"},
    {SCENE_STL, "stl", "STL"},
};
enum { format_count = sizeof(formats) / sizeof(formats[0]) };

const char *scene_format_extension(scene_format format) { return formats[format].extension; }
const char *scene_format_name(scene_format format) { return formats[format].name; }

typedef struct file_head {
    char bytes[4097]; // always terminated
    size_t count;
    uint64_t file_size;
} file_head;

static int read_head(const char *command, const char *path, file_head *head) {
    memset(head, 0, sizeof(*head));
    // A pipe without writer must not block us.
    const int file = open(path, O_RDONLY | O_NONBLOCK | O_NOCTTY);
    if (file < 0) {
        return cli_fail(command, CLI_INPUT, "%s: %s; check the path", path, strerror(errno));
    }
    struct stat info;
    ssize_t count = -1;
    int code = CLI_OK;
    const mode_t mode = fstat(file, &info) == 0 ? info.st_mode : 0;
    if (S_ISDIR(mode)) {
        code = cli_fail(
            command, CLI_INPUT,
            "%s: this is a folder; name a file in it ('proxycloth batch' takes folders)", path);
    } else if (!S_ISREG(mode)) {
        code =
            cli_fail(command, CLI_INPUT, "%s: not a regular file; name a mesh or asset file", path);
    } else {
        while (head->count + 1 < sizeof(head->bytes) &&
               (count = read(file, head->bytes + head->count,
                             sizeof(head->bytes) - 1 - head->count)) > 0) {
            head->count += (size_t)count;
        }
        head->file_size = (uint64_t)info.st_size;
        if (count < 0) {
            code = cli_fail(command, CLI_INPUT, "%s: %s", path, strerror(errno));
        } else if (head->count == 0) {
            code = cli_fail(command, CLI_INPUT, "%s: the file is empty", path);
        }
    }
    close(file);
    return code;
}

static bool starts(const file_head *head, const char *text) {
    const size_t length = strlen(text);
    return head->count >= length && memcmp(head->bytes, text, length) == 0;
}

static bool is_text(const file_head *head) {
    return memchr(head->bytes, '\0', head->count) == NULL;
}

static uint32_t little_endian(const char *bytes) {
    const unsigned char *b = (const unsigned char *)bytes;
    return b[0] | (uint32_t)b[1] << 8 | (uint32_t)b[2] << 16 | (uint32_t)b[3] << 24;
}

// First character behind a byte-order mark and white space.
static char first_character(const file_head *head) {
    const char *text = starts(head, "\xef\xbb\xbf") ? head->bytes + 3 : head->bytes;
    return text[strspn(text, " \t\r\n")];
}

// The format that the content shows beyond doubt; false for plain text without a signature.
static bool by_content(const file_head *head, scene_format *format) {
    if (starts(head, "glTF")) {
        *format = SCENE_GLB;
    } else if (starts(head, "Kaydara FBX Binary") || (starts(head, "; FBX") && is_text(head))) {
        *format = SCENE_FBX;
    } else if (starts(head, "ply\n") || starts(head, "ply\r")) {
        *format = SCENE_PLY;
    } else if (is_text(head) && strstr(head->bytes, "<COLLADA") != NULL) {
        *format = SCENE_DAE;
    } else if (head->file_size >= 84 && head->count >= 84 &&
               head->file_size == 84 + 50 * (uint64_t)little_endian(head->bytes + 80)) {
        *format = SCENE_STL;
    } else {
        return false;
    }
    return true;
}

// Formats without signature need their extension and content that does not contradict it.
static bool by_extension(const file_head *head, const char *extension, scene_format *format) {
    const bool text = is_text(head);
    if (strcasecmp(extension, "stl") == 0 && (!text || starts(head, "solid"))) {
        *format = SCENE_STL; // also a binary one that was cut
    } else if (text && strcasecmp(extension, "obj") == 0 &&
               strchr("<{", first_character(head)) == NULL) {
        *format = SCENE_OBJ;
    } else if (text && strcasecmp(extension, "gltf") == 0 && first_character(head) == '{') {
        *format = SCENE_GLTF;
    } else {
        return false;
    }
    return true;
}

static const char *extension_of(const char *path) {
    const char *slash = strrchr(path, '/'), *dot = strrchr(path, '.');
    return dot != NULL && (slash == NULL || dot > slash) ? dot + 1 : "";
}

// Index of the format that goes with an extension, format_count when there is none.
static size_t named_format(const char *extension) {
    size_t named = 0;
    while (named < format_count && strcasecmp(extension, formats[named].extension) != 0) {
        ++named;
    }
    return named;
}

bool scene_named_like_one(const char *path) {
    return named_format(extension_of(path)) != format_count;
}

int scene_sniff(const char *command, const char *path, scene_format *format) {
    file_head head;
    const int code = read_head(command, path, &head);
    if (code != CLI_OK) {
        return code;
    }
    const char *extension = extension_of(path);
    const size_t named = named_format(extension);
    const bool found = by_content(&head, format);
    if (!found && named == format_count) {
        return cli_fail(command, CLI_INPUT,
                        "%s: unknown format; OBJ, FBX, glTF, GLB, DAE, PLY and STL are read", path);
    }
    if (!found && !by_extension(&head, extension, format)) {
        return cli_fail(command, CLI_INPUT,
                        "%s: this is no %s file although it is named like one; export it again",
                        path, formats[named].name);
    }
    if (found && named != format_count && formats[named].format != *format) {
        return cli_fail(command, CLI_INPUT, "%s: the file holds %s data; rename it to .%s", path,
                        scene_format_name(*format), scene_format_extension(*format));
    }
    if (*format == SCENE_GLB && (head.count < 12 || little_endian(head.bytes + 4) != 2)) {
        return cli_fail(command, CLI_INPUT, "%s: only version 2 of glTF is read; export it again",
                        path);
    }
    // assimp never returns from such a file.
    if (*format == SCENE_PLY && head.count == head.file_size &&
        strstr(head.bytes, "end_header") == NULL) {
        return cli_fail(command, CLI_INPUT, "%s: the file is truncated; export it again", path);
    }
    return CLI_OK;
}

int cli_input_kind(const char *command, const char *path, cli_kind *kind) {
    file_head head;
    const int code = read_head(command, path, &head);
    *kind = code == CLI_OK && starts(&head, "\x89HDF\r\n\x1a\n") ? CLI_KIND_ASSET : CLI_KIND_SCENE;
    return code;
}
