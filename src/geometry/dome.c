#include "geometry/dome.h"

static const pci_dome_kernel *best_kernel(void) {
#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx2")) {
        return &pci_dome_avx2;
    }
#endif
    return &pci_dome_generic;
}

// Steps of the golden angle on rings of equal area.
void pci_dome_set(pci_dome *dome) {
    dome->kernel = best_kernel();
    for (size_t i = 0; i < PCI_LAMPS; ++i) {
        const double height = 1.0 - 2.0 * ((double)i + 0.5) / PCI_LAMPS;
        const double radius = sqrt(1.0 - height * height), angle = 2.399963229728653 * (double)i;
        const double direction[3] = {radius * cos(angle), height, radius * sin(angle)};
        const bool steep = fabs(height) >= 0.8;
        const double helper[3] = {steep ? 1.0 : 0.0, steep ? 0.0 : 1.0, 0.0};
        double across[3], along[3];
        pci_cross(helper, direction, across);
        pci_normalize(across);
        pci_cross(direction, across, along);
        for (size_t k = 0; k < 3; ++k) {
            dome->directions[k][i] = (float)direction[k];
            dome->axes[0][k][i] = (float)(0.5 * PCI_SHADOW_SIDE * across[k]);
            dome->axes[1][k][i] = (float)(0.5 * PCI_SHADOW_SIDE * along[k]);
            dome->axes[2][k][i] = (float)(0.5 * PCI_NEAREST * direction[k]);
        }
    }
}

typedef struct cast_job {
    const pci_dome *dome;
    const pc_mesh *mesh;
    const float *points;
    uint16_t *shadows;
} cast_job;

static void cast_group(void *user, size_t begin, size_t end, uint32_t worker) {
    const cast_job *job = user;
    (void)worker;
    for (size_t i = begin; i < end; ++i) {
        job->dome->kernel->cast(job->dome, i * PCI_LAMP_GROUP, job->points, job->mesh->triangles,
                                job->mesh->triangle_count, job->shadows);
    }
}

uint16_t *pci_dome_cast(pc_context *context, pci_scratch *scratch, const pci_dome *dome,
                        const pc_mesh *mesh, const float *points) {
    uint16_t *shadows = PCI_SCRATCH(scratch, uint16_t, PCI_LAMPS * PCI_SHADOW_TEXELS);
    if (shadows != NULL) {
        cast_job job = {dome, mesh, points, shadows};
        pci_parallel_for(context, PCI_LAMPS / PCI_LAMP_GROUP, 1, cast_group, &job);
    }
    return shadows;
}

bool pci_lit_points_reserve(pci_scratch *scratch, size_t capacity, pci_lit_points *points) {
    points->capacity = (capacity + 15) / 16 * 16;
    points->count = 0;
    points->light = PCI_SCRATCH(scratch, float, points->capacity);
    for (size_t k = 0; k < 3; ++k) {
        points->position[k] = PCI_SCRATCH(scratch, float, points->capacity);
        points->normal[k] = PCI_SCRATCH(scratch, float, points->capacity);
    }
    return !scratch->failed;
}
