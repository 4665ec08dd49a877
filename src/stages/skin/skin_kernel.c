// Chooses the kernels for the processor that the program runs on.
#include "stages/skin/skin_kernel.h"

const pci_skin_kernel *pci_skin_kernel_float(void) {
#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx512f")) {
        return &pci_skin_avx512_float;
    }
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) {
        return &pci_skin_avx2_float;
    }
#endif
    return &pci_skin_generic_float;
}

const pci_skin_kernel *pci_skin_kernel_double(void) {
#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx512f")) {
        return &pci_skin_avx512_double;
    }
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) {
        return &pci_skin_avx2_double;
    }
#endif
    return &pci_skin_generic_double;
}
