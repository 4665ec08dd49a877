#ifndef CORE_EMBREE_H
#define CORE_EMBREE_H

// Configuration of Embree's devices. In a file of its own, so that a test can put another one in
// its place.
const char *pci_embree_configuration(void);

#endif
