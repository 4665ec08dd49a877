#define _GNU_SOURCE // O_TMPFILE
#include "io/nameless_file.h"

#include <fcntl.h>
#include <stdio.h>
#include <unistd.h>

// Only through this path may everybody name such a file.
static void path_of(int descriptor, char path[64]) {
    snprintf(path, 64, "/proc/self/fd/%d", descriptor);
}

int pci_nameless_open(const char *folder) {
#ifdef O_TMPFILE
    char path[64];
    const int descriptor = open(folder, O_TMPFILE | O_WRONLY | O_CLOEXEC, 0666);
    if (descriptor < 0) {
        return -1;
    }
    path_of(descriptor, path);
    if (access(path, F_OK) == 0) {
        return descriptor;
    }
    close(descriptor);
#endif
    (void)folder;
    return -1;
}

int pci_nameless_link(int descriptor, const char *path) {
    char from[64];
    path_of(descriptor, from);
    return linkat(AT_FDCWD, from, AT_FDCWD, path, AT_SYMLINK_FOLLOW);
}
