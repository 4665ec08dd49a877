#include "core/embree.h"

// One thread: the tree, and with it the order of visits, never depends on timing.
const char *pci_embree_configuration(void) { return "threads=1"; }
