// Whole files, read and written in one piece; for every module in io.
#ifndef PCI_ATOMIC_FILE_H
#define PCI_ATOMIC_FILE_H

#include <stdio.h>

#include "core/core.h"

// A file that is written without a name, or where that is not possible under a temporary one beside
// its target, so that the target is either the complete new file or what it was before.
typedef struct pci_atomic_file {
    pc_context *context;
    const char *stage;
    const char *path;
    char *temporary, *target; // where `path` is a link, the file that it leads to
    bool named;               // there is a file of the temporary name
    FILE *stream;             // write here; errors are noticed at the end
} pci_atomic_file;

// @return PC_OK; PC_ERROR_IO; PC_ERROR_OUT_OF_MEMORY. On failure there is nothing to end.
PC_NODISCARD pc_status pci_atomic_begin(pc_context *context, const char *stage, const char *path,
                                        pci_atomic_file *file);

// With `status` PC_OK: flushes to disk and renames. Otherwise, or when that fails: removes the
// temporary file. Returns the first failure.
PC_NODISCARD pc_status pci_atomic_end(pci_atomic_file *file, pc_status status);

// The bytes of a regular file; release with pc_release.
// @return PC_OK; PC_ERROR_IO; PC_ERROR_OUT_OF_MEMORY.
PC_NODISCARD pc_status pci_read_file(pc_context *context, const char *stage, const char *path,
                                     unsigned char **bytes, size_t *size);

#endif
