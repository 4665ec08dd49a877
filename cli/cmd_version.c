// version: the program's version, and the libraries that it runs with.
#define _GNU_SOURCE // dl_iterate_phdr
#include <assimp/version.h>
#include <gnu/libc-version.h>
#include <limits.h>
#include <link.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "cli.h"

static void print_row(const char *name, const char *version, const char *licence) {
    printf("%-16s %-12s %s\n", name, version, licence);
}

// Licences of what Debian's packages of our dependencies lead to. NULL: printed above.
static const struct {
    const char *file, *licence;
} known[] = {
    {"libassimp", NULL},
    {"libcjson", NULL},
    {"libcxsparse", NULL},
    {"libembree3", NULL},
    {"libhdf5_serial", NULL},
    {"libpng16", NULL},
    {"libz", NULL},
    {"linux-vdso", NULL},
    {"ld-linux-x86-64", NULL}, // glibc
    {"libc", NULL},
    {"libm", NULL},
    {"libresolv", NULL},
    {"libaec", "BSD-2-Clause"},
    {"libbrotlicommon", "MIT"},
    {"libbrotlidec", "MIT"},
    {"libcom_err", "MIT"},
    {"libcrypto", "Apache-2.0"},
    {"libcurl", "curl"},
    {"libdraco", "Apache-2.0"},
    {"libffi", "MIT"},
    {"libgcc_s", "GPL-3.0-or-later WITH GCC-exception-3.1"},
    {"libgmp", "LGPL-3.0-or-later OR GPL-2.0-or-later"},
    {"libgnutls", "LGPL-2.1-or-later"},
    {"libgssapi_krb5", "MIT"},
    {"libhogweed", "LGPL-3.0-or-later OR GPL-2.0-or-later"},
    {"libidn2", "LGPL-3.0-or-later OR GPL-2.0-or-later"},
    {"libk5crypto", "MIT"},
    {"libkeyutils", "LGPL-2.1-or-later"},
    {"libkrb5", "MIT"},
    {"libkrb5support", "MIT"},
    {"liblber", "OLDAP-2.8"},
    {"libldap", "OLDAP-2.8"},
    {"libminizip", "Zlib"},
    {"libnettle", "LGPL-3.0-or-later OR GPL-2.0-or-later"},
    {"libnghttp2", "MIT"},
    {"libp11-kit", "BSD-3-Clause"},
    {"libpsl", "MIT"},
    {"librtmp", "LGPL-2.1-or-later"},
    {"libsasl2", "BSD-4-Clause"},
    {"libssh2", "BSD-3-Clause"},
    {"libssl", "Apache-2.0"},
    {"libstdc++", "GPL-3.0-or-later WITH GCC-exception-3.1"},
    {"libsz", "BSD-2-Clause"},
    {"libtasn1", "LGPL-2.1-or-later"},
    {"libtbb", "Apache-2.0"},
    {"libunistring", "LGPL-3.0-or-later OR GPL-2.0-or-later"},
    {"libzstd", "BSD-3-Clause OR GPL-2.0-only"},
};

// A library of this process: its name and version are those of the file behind its links.
static int print_loaded(struct dl_phdr_info *info, size_t size, void *user) {
    (void)size;
    (void)user;
    char real[PATH_MAX];
    const char *path = realpath(info->dlpi_name, real) != NULL ? real : info->dlpi_name;
    const char *file = strrchr(path, '/') != NULL ? strrchr(path, '/') + 1 : path;
    const char *so = strstr(file, ".so.");
    if (so == NULL) {
        return 0; // the program itself
    }
    const char *series = strstr(file, "-2."); // libldap-2.5
    const char *end = series != NULL && series < so ? series : so;
    char name[64];
    snprintf(name, sizeof(name), "%.*s", (int)(end - file), file);
    for (size_t i = 0; i < sizeof(known) / sizeof(known[0]); ++i) {
        if (strcmp(known[i].file, name) == 0) {
            if (known[i].licence != NULL) {
                print_row(name, so + strlen(".so."), known[i].licence);
            }
            return 0;
        }
    }
    print_row(name, so + strlen(".so."), "not known here, see its package");
    return 0;
}

static void print_licences(void) {
    printf("\n");
    print_row("proxycloth", pc_version(), "MIT");
    pc_dependency dependency;
    for (size_t i = 0; pc_dependency_at(i, &dependency); ++i) {
        print_row(dependency.name, dependency.version, dependency.licence);
    }
    char version[48];
    snprintf(version, sizeof(version), "%u.%u.%u", aiGetVersionMajor(), aiGetVersionMinor(),
             aiGetVersionPatch());
    print_row("assimp", version, "BSD-3-Clause");
    print_row("glibc", gnu_get_libc_version(), "LGPL-2.1-or-later");
    printf("\nand loaded by these:\n");
    dl_iterate_phdr(print_loaded, NULL);
}

int cli_run_version(const cli_command *command, cli_arguments *arguments) {
    (void)command;
    printf("proxycloth %s\n", pc_version());
    if (arguments->settings.licences) {
        print_licences();
    }
    return CLI_OK;
}
