#include "core/bvh.h"

pc_status pci_bvh_create(pc_context *context, const char *stage, const pc_mesh *mesh,
                         pci_bvh **bvh) {
    (void)mesh;
    *bvh = NULL;
    return pci_fail(context, PC_ERROR_UNSUPPORTED, stage, "%s: not written yet", stage);
}
void pci_bvh_destroy(pc_context *context, pci_bvh *bvh) {
    (void)context;
    (void)bvh;
}
pci_closest pci_bvh_closest(const pci_bvh *bvh, const double point[3], double radius) {
    (void)bvh;
    (void)point;
    (void)radius;
    return (pci_closest){.triangle = PC_INVALID_INDEX};
}
pci_hit pci_bvh_cast(const pci_bvh *bvh, const double origin[3], const double direction[3],
                     double near, double far, pci_hit_filter filter, void *user) {
    (void)bvh;
    (void)origin;
    (void)direction;
    (void)near;
    (void)far;
    (void)filter;
    (void)user;
    return (pci_hit){.triangle = PC_INVALID_INDEX};
}
