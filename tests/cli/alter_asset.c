// Changes an asset file in a way that only its content shows, with a valid seal.
// Usage: alter_asset newer ASSET        the next format version
//        alter_asset unlabelled ASSET   every label 0
#define _POSIX_C_SOURCE 200809L
#include <hdf5.h>
#include <stdlib.h>
#include <string.h>

#include "proxycloth/asset_file.h"
#include "support/files.h"

static int clear_labels(const char *path) {
    pc_context *context = NULL;
    pc_asset asset = {0};
    if (pc_context_create(NULL, &context) != PC_OK ||
        pc_asset_load(context, path, &asset) != PC_OK) {
        return 1;
    }
    memset(asset.labels.labels, 0, asset.labels.vertex_count);
    const pc_status status = pc_asset_save(context, &asset, path);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
    return status == PC_OK ? 0 : 1;
}

static int raise_version(const char *path) {
    const uint32_t version = PC_ASSET_FORMAT_VERSION + 1;
    const hid_t file = H5Fopen(path, H5F_ACC_RDWR, H5P_DEFAULT);
    const hid_t attribute = H5Aopen(file, "format_version", H5P_DEFAULT);
    // Closing cuts off the old seal.
    if (attribute < 0 || H5Awrite(attribute, H5T_NATIVE_UINT32, &version) < 0 ||
        H5Aclose(attribute) < 0 || H5Fclose(file) < 0) {
        return 1;
    }
    bytes content = read_bytes(path);
    uint64_t hash = 0xcbf29ce484222325u;
    for (size_t i = 0; i < content.size; ++i) {
        hash = (hash ^ content.data[i]) * 0x100000001b3u;
    }
    unsigned char seal[16] = "pc-asset";
    for (size_t i = 0; i < 8; ++i) {
        seal[8 + i] = (unsigned char)(hash >> (8 * i));
    }
    FILE *out = fopen(path, "ab");
    const bool good = out != NULL && fwrite(seal, sizeof(seal), 1, out) == 1;
    free(content.data);
    return out != NULL && fclose(out) == 0 && good ? 0 : 1;
}

int main(int argc, char **argv) {
    if (argc == 3 && strcmp(argv[1], "newer") == 0) {
        return raise_version(argv[2]);
    }
    if (argc == 3 && strcmp(argv[1], "unlabelled") == 0) {
        return clear_labels(argv[2]);
    }
    return 2;
}
