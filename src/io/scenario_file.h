// Scenarios as JSON text.
#ifndef PCI_SCENARIO_FILE_H
#define PCI_SCENARIO_FILE_H

#include "core/core.h"
#include "proxycloth/scenario.h"

// The text that reads back as the same scenario (without options), from pci_allocate; NULL: out of
// memory.
char *pci_scenario_text(pc_context *context, const pc_scenario *scenario);

#endif
