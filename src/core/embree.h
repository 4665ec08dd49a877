#ifndef PCI_EMBREE_H
#define PCI_EMBREE_H

// Configuration of Embree's devices. In a file of its own, so that a test can put another one in
// its place.
const char *pci_embree_configuration(void);

// ---- embree_device.c ----------------------------------------------------------------------------

// The device that is kept in *held, made on first use: that takes longer than the tree of a small
// mesh. NULL: rtcGetDeviceError(NULL) says why.
void *pci_embree_device(void **held);
void pci_embree_release(void *device); // NULL is accepted; after its last tree

#endif
