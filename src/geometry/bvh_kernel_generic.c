#include <float.h>

#include "geometry/bvh_tree.h"

#define LANES                 4
#define CHOOSE(mask, yes, no) ((VEC)(((mask) & (MASK)(yes)) | (~(mask) & (MASK)(no))))
#define SMALLER(a, b)         CHOOSE((a) < (b), (a), (b))
#define LARGER(a, b)          CHOOSE((a) > (b), (a), (b))
#define BITS(mask)            (((mask)[0] & 1) | ((mask)[1] & 2) | ((mask)[2] & 4) | ((mask)[3] & 8))
#define WIDE_BITS(mask)       (((mask)[0] & 1) | ((mask)[1] & 2))
#define GATHER(at, k)         ((WIDE){(at)[0][k], (at)[1][k]})
#define KERNEL                pci_bvh_generic
#include "geometry/bvh_kernel.inl"
