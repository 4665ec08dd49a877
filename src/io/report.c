#include "core/core.h"
#include "proxycloth/asset_file.h"
#include "proxycloth/export.h"

pc_status pc_export_report(pc_context *context, const pc_asset *asset, const pc_measures *measures,
                           const pc_timings *timings, const char *path) {
    (void)asset;
    (void)path;
    (void)measures;
    (void)timings;
    return pci_fail(context, PC_ERROR_UNSUPPORTED, "export", "export: not written yet");
}
