#include "core/core.h"
#include "proxycloth/asset_file.h"
#include "proxycloth/export.h"

pc_status pc_export_glb(pc_context *context, const pc_asset *asset, const char *path) {
    (void)asset;
    (void)path;
    return pci_fail(context, PC_ERROR_UNSUPPORTED, "export", "export: not written yet");
}
