// Wall clock for reports and for limits that users ask for; nothing else depends on it.
#ifndef PCI_CLOCK_H
#define PCI_CLOCK_H

double pci_clock_seconds(void);

#endif
