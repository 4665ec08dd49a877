// Wall clock for reports; no result ever depends on it.
#ifndef PCI_CLOCK_H
#define PCI_CLOCK_H

double pci_clock_seconds(void);

#endif
