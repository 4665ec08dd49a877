// How much of the visual mesh a single layer covers.
#ifndef PCI_COVERAGE_H
#define PCI_COVERAGE_H

#include "core/core.h"
#include "proxycloth/mesh.h"

// `coverage` receives the share of the vertices of `surface` within 2 voxels of `layer`.
// PC_OK; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY.
PC_NODISCARD pc_status pci_measure_coverage(pci_scratch *scratch, const char *stage,
                                            const pc_mesh *surface, const pc_mesh *layer,
                                            double cell_size, double *coverage);

#endif
