// Turns an asset file into one of the next format version, with a valid seal. Usage: make_newer
// ASSET
#define _POSIX_C_SOURCE 200809L
#include <hdf5.h>
#include <stdlib.h>

#include "proxycloth/asset_file.h"
#include "support/files.h"

int main(int argc, char **argv) {
    if (argc != 2) {
        return 2;
    }
    const uint32_t version = PC_ASSET_FORMAT_VERSION + 1;
    const hid_t file = H5Fopen(argv[1], H5F_ACC_RDWR, H5P_DEFAULT);
    const hid_t attribute = H5Aopen(file, "format_version", H5P_DEFAULT);
    // Closing cuts off the old seal.
    if (attribute < 0 || H5Awrite(attribute, H5T_NATIVE_UINT32, &version) < 0 ||
        H5Aclose(attribute) < 0 || H5Fclose(file) < 0) {
        return 1;
    }
    bytes content = read_bytes(argv[1]);
    uint64_t hash = 0xcbf29ce484222325u;
    for (size_t i = 0; i < content.size; ++i) {
        hash = (hash ^ content.data[i]) * 0x100000001b3u;
    }
    unsigned char seal[16] = "pc-asset";
    for (size_t i = 0; i < 8; ++i) {
        seal[8 + i] = (unsigned char)(hash >> (8 * i));
    }
    FILE *out = fopen(argv[1], "ab");
    const bool good = out != NULL && fwrite(seal, sizeof(seal), 1, out) == 1;
    free(content.data);
    return out != NULL && fclose(out) == 0 && good ? 0 : 1;
}
