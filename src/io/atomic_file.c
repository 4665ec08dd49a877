#define _XOPEN_SOURCE 700 // realpath
#include "io/atomic_file.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "io/nameless_file.h"

// strerror is not thread-safe, strerror_r is.
static pc_status fail_errno(pc_context *context, const char *stage, const char *action,
                            const char *path, int code) {
    char cause[128];
    if (strerror_r(code, cause, sizeof(cause)) != 0) {
        snprintf(cause, sizeof(cause), "error %d", code);
    }
    return pci_fail(context, PC_ERROR_IO, stage, "%s: cannot %s \"%.300s\": %s", stage, action,
                    path, cause);
}

static void discard(pci_atomic_file *file) {
    if (file->stream != NULL) {
        fclose(file->stream);
    }
    if (file->named) {
        unlink(file->temporary);
    }
    pc_release(file->context, file->temporary);
    pc_release(file->context, file->target);
    memset(file, 0, sizeof(*file));
}

enum { ATTEMPTS = 1000, NAME_ROOM = 65 }; // of what is behind the target's name

// The name says who left a file behind after a crash.
static void name_temporary(char *temporary, size_t size, const char *target, int attempt) {
    snprintf(temporary, size, "%s.tmp-%ld-%d", target, (long)getpid(), attempt);
}

// A file without a name, on the file system of the target; -1 where there are none. `folder` has
// room for the target's path.
static int open_beside(const char *target, char *folder) {
    const char *slash = strrchr(target, '/');
    const size_t length = slash == NULL ? 0 : slash == target ? 1 : (size_t)(slash - target);
    memcpy(folder, target, length);
    folder[length] = '\0';
    return pci_nameless_open(length != 0 ? folder : ".");
}

// Gives a complete file its temporary name. Returns 0 or an errno value.
static int name_file(pci_atomic_file *file) {
    const size_t size = strlen(file->target) + NAME_ROOM;
    int code = file->named ? 0 : EEXIST;
    for (int attempt = 0; attempt < ATTEMPTS && code == EEXIST; ++attempt) {
        name_temporary(file->temporary, size, file->target, attempt);
        file->named = pci_nameless_link(fileno(file->stream), file->temporary) == 0;
        code = file->named ? 0 : errno;
    }
    return code;
}

pc_status pci_atomic_begin(pc_context *context, const char *stage, const char *path,
                           pci_atomic_file *file) {
    memset(file, 0, sizeof(*file));
    // Renaming over a device or a folder would not do what the caller means.
    struct stat target;
    if (stat(path, &target) == 0 && !S_ISREG(target.st_mode)) {
        return pci_fail(context, PC_ERROR_IO, stage,
                        "%s: cannot write \"%.300s\": it is not a regular file", stage, path);
    }
    // The file at the end of a link is replaced, not the link; realpath needs that there is one.
    char resolved[PATH_MAX];
    const char *at = realpath(path, resolved) != NULL ? resolved : path;
    const size_t length = strlen(at) + 1, size = length - 1 + NAME_ROOM;
    char *temporary = PCI_ALLOCATE(context, char, size);
    char *final = PCI_ALLOCATE(context, char, length);
    if (temporary == NULL || final == NULL) {
        pc_release(context, temporary);
        pc_release(context, final);
        return pci_fail_memory(context, stage);
    }
    memcpy(final, at, length);
    // mkstemp would ignore the umask.
    int descriptor = open_beside(at, temporary);
    bool named = false;
    for (int attempt = 0; attempt < ATTEMPTS && descriptor < 0; ++attempt) {
        name_temporary(temporary, size, at, attempt);
        descriptor = open(temporary, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
        named = descriptor >= 0;
        if (!named && errno != EEXIST) {
            break;
        }
    }
    FILE *stream = descriptor < 0 ? NULL : fdopen(descriptor, "wb");
    if (stream == NULL) {
        const int code = errno;
        if (descriptor >= 0) {
            close(descriptor);
            if (named) {
                unlink(temporary);
            }
        }
        pc_release(context, temporary);
        pc_release(context, final);
        return fail_errno(context, stage, "write", path, code);
    }
    file->context = context;
    file->stage = stage;
    file->path = path;
    file->temporary = temporary;
    file->target = final;
    file->named = named;
    file->stream = stream;
    errno = 0;
    return PC_OK;
}

pc_status pci_atomic_end(pci_atomic_file *file, pc_status status) {
    if (status != PC_OK) {
        discard(file);
        return status;
    }
    // What made an earlier write fail is still in errno, which was cleared at the beginning.
    int code = 0;
    if (ferror(file->stream) != 0 || fflush(file->stream) != 0 ||
        fsync(fileno(file->stream)) != 0) {
        code = errno != 0 ? errno : EIO;
    } else {
        code = name_file(file);
    }
    if (fclose(file->stream) != 0 && code == 0) {
        code = errno;
    }
    file->stream = NULL;
    if (code == 0 && rename(file->temporary, file->target) != 0) {
        code = errno;
    }
    if (code != 0) {
        status = fail_errno(file->context, file->stage, "write", file->path, code);
        discard(file);
        return status;
    }
    pc_release(file->context, file->temporary);
    pc_release(file->context, file->target);
    memset(file, 0, sizeof(*file));
    return PC_OK;
}

pc_status pci_read_file(pc_context *context, const char *stage, const char *path,
                        unsigned char **bytes, size_t *size) {
    *bytes = NULL;
    *size = 0;
    // Non-blocking, or opening a pipe would wait for its writer.
    const int descriptor = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (descriptor < 0) {
        return fail_errno(context, stage, "read", path, errno);
    }
    pc_status status = PC_OK;
    unsigned char *memory = NULL;
    struct stat info;
    size_t length = 0, done = 0;
    if (fstat(descriptor, &info) != 0) {
        status = fail_errno(context, stage, "read", path, errno);
        goto cleanup;
    }
    if (!S_ISREG(info.st_mode)) {
        status = pci_fail(context, PC_ERROR_IO, stage,
                          "%s: cannot read \"%.300s\": it is not a regular file", stage, path);
        goto cleanup;
    }
    length = (size_t)info.st_size;
    memory = PCI_ALLOCATE(context, unsigned char, length);
    if (memory == NULL) {
        status = pci_fail_memory(context, stage);
        goto cleanup;
    }
    while (done < length) {
        const ssize_t count = read(descriptor, memory + done, length - done);
        if (count < 0 && errno == EINTR) {
            continue;
        }
        if (count <= 0) {
            // The file shrank while it was read: nothing that a retry could not cure.
            status = fail_errno(context, stage, "read", path, count < 0 ? errno : EIO);
            goto cleanup;
        }
        done += (size_t)count;
    }
    *bytes = memory;
    *size = length;
    memory = NULL;
cleanup:
    pc_release(context, memory);
    close(descriptor);
    return status;
}
