#include "core/core.h"
#include "proxycloth/asset_file.h"
#include "proxycloth/export.h"

pc_status pc_export_obj(pc_context *context, const pc_mesh *mesh, const char *path) {
    (void)mesh;
    (void)path;
    return pci_fail(context, PC_ERROR_UNSUPPORTED, "export", "export: not written yet");
}
