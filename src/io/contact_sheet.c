#include "core/core.h"
#include "proxycloth/asset_file.h"
#include "proxycloth/export.h"

const pc_record pc_contact_sheet_options_record = {0};
pc_status pc_export_contact_sheet(pc_context *context, const pc_asset *asset,
                                  const pc_contact_sheet_options *options, const char *path) {
    (void)asset;
    (void)path;
    (void)options;
    return pci_fail(context, PC_ERROR_UNSUPPORTED, "export", "export: not written yet");
}
