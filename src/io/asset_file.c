#include "proxycloth/asset_file.h"
#include "core/core.h"
#include "proxycloth/export.h"

pc_status pc_asset_save(pc_context *context, const pc_asset *asset, const char *path) {
    (void)asset;
    (void)path;
    return pci_fail(context, PC_ERROR_UNSUPPORTED, "asset", "asset: not written yet");
}
pc_status pc_asset_load(pc_context *context, const char *path, pc_asset *asset) {
    (void)asset;
    (void)path;
    return pci_fail(context, PC_ERROR_UNSUPPORTED, "asset", "asset: not written yet");
}
