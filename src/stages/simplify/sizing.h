// Where a surface needs smaller clusters: around sleeves and straps that are narrow for uniform
// ones.
#ifndef PCI_SIZING_H
#define PCI_SIZING_H

#include "stages/simplify/sampling.h"

// How many times shorter than elsewhere the edges of the proxy should be, per vertex, 1..limit:
// sets the scales of the sampling. Judged from a uniform clustering: by the spread of the normals
// inside a cluster, which measures its width against the radius of curvature, and by the length of
// border it holds, which measures the width of a strap.
// False: out of memory.
bool pci_size_clusters(pci_scratch *scratch, const uint32_t *cluster, size_t cluster_count,
                       double limit, pci_sampling *sampling);

#endif
