// Parts of the asset that the pipeline needs besides the public functions.
#ifndef PCI_ASSET_H
#define PCI_ASSET_H

#include "proxycloth/pipeline.h"

// Drops the results, options and reports of `stage` and all later ones.
void pci_asset_truncate(pc_context *context, pc_asset *asset, pc_stage stage);

#endif
