#include "geometry/bvh_tree.h"

const pci_bvh_kernel *pci_bvh_best_kernel(void) {
#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx2")) {
        return &pci_bvh_avx2;
    }
#endif
    return &pci_bvh_generic;
}
