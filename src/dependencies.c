// The libraries that this one calls.
#include <cjson/cJSON.h>
#include <cs.h>
#include <embree3/rtcore_config.h>
#include <hdf5.h>
#include <png.h>
#include <stdio.h>
#include <zlib.h>

#include "proxycloth/base.h"

#define TEXT_OF(macro)              TEXT_OF_TOKEN(macro)
#define TEXT_OF_TOKEN(token)        #token
#define DOTTED(major, minor, patch) TEXT_OF(major) "." TEXT_OF(minor) "." TEXT_OF(patch)

bool pc_dependency_at(size_t index, pc_dependency *dependency) {
    unsigned major = 0, minor = 0, release = 0;
    char hdf5[32];
    (void)H5get_libversion(&major, &minor, &release);
    snprintf(hdf5, sizeof(hdf5), "%u.%u.%u", major, minor, release);
    const struct {
        const char *name, *version, *licence;
    } rows[] = {
        {"embree", RTC_VERSION_STRING, "Apache-2.0"},
        {"hdf5", hdf5, "BSD-3-Clause"},
        {"libpng", png_get_libpng_ver(NULL), "libpng-2.0"},
        {"zlib", zlibVersion(), "Zlib"},
        {"cxsparse", DOTTED(CS_VER, CS_SUBVER, CS_SUBSUB), "LGPL-2.1-or-later"},
        {"cjson", cJSON_Version(), "MIT"},
    };
    if (dependency == NULL || index >= sizeof(rows) / sizeof(rows[0])) {
        return false;
    }
    dependency->name = rows[index].name;
    snprintf(dependency->version, sizeof(dependency->version), "%s", rows[index].version);
    dependency->licence = rows[index].licence;
    return true;
}
