// What the labelling stage accepts; shared with the writer of its instances.
#ifndef PCI_LABEL_CHECK_H
#define PCI_LABEL_CHECK_H

#include "proxycloth/label.h"

// PC_OK; PC_ERROR_INVALID_ARGUMENT; PC_ERROR_TOO_LARGE.
pc_status pci_label_check(pc_context *context, const pc_graph *graph);

#endif
