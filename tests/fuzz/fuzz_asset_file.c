// The reader of asset files.
#include <string.h>

#include "fuzz.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    pc_context *context = fuzz_context();
    pc_asset asset;
    memset(&asset, 0, sizeof(asset));
    const pc_status status = pc_asset_load(context, fuzz_file(data, size), &asset);
    fuzz_assert(status == PC_OK || asset.visual.surface.positions == NULL);
    pc_asset_free(context, &asset);
    return 0;
}
