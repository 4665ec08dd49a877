// Runs a fuzz target over files and folders of files.
#define _POSIX_C_SOURCE 200809L
#include <dirent.h>
#include <stdio.h>

#include "fuzz.h"

static bool replay_file(const char *path) {
    FILE *file = fopen(path, "rb");
    if (file == NULL || fseek(file, 0, SEEK_END) != 0) {
        return false;
    }
    const size_t size = (size_t)ftell(file);
    rewind(file);
    uint8_t *data = malloc(size + 1); // of its exact size for sanitizers, but never none
    const bool good = data != NULL && fread(data, 1, size, file) == size;
    fclose(file);
    if (good) {
        (void)LLVMFuzzerTestOneInput(data, size);
    }
    free(data);
    return good;
}

int main(int argc, char **argv) {
    size_t count = 0;
    for (int i = 1; i < argc; ++i) {
        struct dirent **entries = NULL;
        const int found = scandir(argv[i], &entries, NULL, alphasort);
        if (found < 0) {
            count += replay_file(argv[i]);
        }
        for (int k = 0; k < found; ++k) {
            char path[4096];
            snprintf(path, sizeof(path), "%s/%s", argv[i], entries[k]->d_name);
            if (entries[k]->d_name[0] != '.') {
                count += replay_file(path);
            }
            free(entries[k]);
        }
        free(entries);
    }
    printf("%zu files replayed\n", count);
    return count > 0 ? 0 : 1;
}
