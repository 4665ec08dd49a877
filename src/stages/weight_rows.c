#include "stages/weight_rows.h"

#include "core/bvh.h"

typedef struct closest_job {
    const pci_bvh *bvh;
    const pc_mesh *surface;
    pci_place *closest; // #V
} closest_job;

static void find_closest(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const closest_job *job = user;
    for (size_t v = begin; v < end; ++v) {
        const pci_closest found =
            pci_bvh_closest(job->bvh, &job->surface->positions[3 * v], INFINITY);
        job->closest[v].triangle = found.triangle;
        memcpy(job->closest[v].barycentric, found.barycentric, sizeof(found.barycentric));
    }
}

pc_status pci_closest_points(pc_context *context, const char *stage, const pc_mesh *surface,
                             const pc_mesh *proxy, pci_place *closest) {
    pci_bvh *bvh = NULL;
    const pc_status status = pci_bvh_create(context, stage, proxy, &bvh);
    if (status != PC_OK) {
        return status;
    }
    closest_job job = {.bvh = bvh, .surface = surface, .closest = closest};
    pci_parallel_for(context, surface->vertex_count, 256, find_closest, &job);
    pci_bvh_destroy(context, bvh);
    return PC_OK;
}

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
