#include "stages/skin/weight_rows.h"

bool pci_skin_allocate(pc_context *context, size_t vertex_count, uint32_t influences,
                       pc_skin *skin) {
    skin->vertex_count = vertex_count;
    skin->influences = influences;
    skin->bones = PCI_ALLOCATE(context, uint32_t, vertex_count * influences);
    skin->weights = PCI_ALLOCATE(context, double, vertex_count *influences);
    return skin->bones != NULL && skin->weights != NULL;
}

void pci_skin_sort_row(uint32_t *bones, double *weights, uint32_t count) {
    for (uint32_t i = 1; i < count; ++i) {
        const uint32_t bone = bones[i];
        const double weight = weights[i];
        uint32_t at = i;
        for (; at > 0 &&
               (weights[at - 1] < weight || (weights[at - 1] == weight && bones[at - 1] > bone));
             --at) {
            bones[at] = bones[at - 1];
            weights[at] = weights[at - 1];
        }
        bones[at] = bone;
        weights[at] = weight;
    }
}

bool pci_skin_scale_rows(pc_skin *skin) {
    for (size_t v = 0; v < skin->vertex_count; ++v) {
        uint32_t *bones = &skin->bones[v * skin->influences];
        double *weights = &skin->weights[v * skin->influences], sum = 0.0;
        for (uint32_t k = 0; k < skin->influences; ++k) {
            sum += weights[k];
        }
        if (!(sum > 0.0) || !isfinite(sum)) {
            return false;
        }
        for (uint32_t k = 0; k < skin->influences; ++k) {
            weights[k] /= sum;
            bones[k] = weights[k] > 0.0 ? bones[k] : bones[0];
        }
    }
    return true;
}
