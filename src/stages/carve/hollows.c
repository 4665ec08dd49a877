#include "stages/carve/hollows.h"

#include "core/union_find.h"
#include "geometry/bvh.h"
#include "geometry/manifold.h"
#include "geometry/topology.h"

// Marks the triangles whose component of the closed mesh shows its front to what it encloses.
// False: out of memory.
static bool find_hollows(pci_scratch *scratch, const pc_mesh *mesh, uint8_t *hollow) {
    uint32_t *component = PCI_SCRATCH(scratch, uint32_t, mesh->triangle_count);
    if (component == NULL) {
        return false;
    }
    const size_t count = pci_manifold_components(scratch, mesh, component);
    const double *volumes = pci_component_volumes(scratch, mesh, component, count);
    for (size_t t = 0; volumes != NULL && t < mesh->triangle_count; ++t) {
        hollow[t] = volumes[component[t]] < 0.0;
    }
    return volumes != NULL;
}

// Marks the vertices of pieces, by their roots, that are farther than `reach` from the rest.
static pc_status find_far(pci_scratch *scratch, const char *stage, const pc_mesh *projected,
                          double reach, const uint8_t *outside, const uint8_t *inside,
                          uint32_t *parents, uint8_t *far) {
    pc_mesh rest = {0};
    pci_bvh *bvh = NULL;
    pc_status status = pci_mesh_compact(scratch, projected, outside, &rest, NULL)
                           ? pci_bvh_create(scratch->context, stage, &rest, &bvh)
                           : pci_fail_memory(scratch->context, stage);
    uint32_t near = PC_INVALID_INDEX;
    for (size_t i = 0; i < 3 * projected->triangle_count && status == PC_OK; ++i) {
        const uint32_t v = projected->triangles[i];
        uint8_t *mark = &far[pci_find_root(parents, v)];
        if (inside[i / 3] && !*mark) {
            *mark = !pci_bvh_within_near(bvh, &projected->positions[3 * (size_t)v], reach, &near);
        }
    }
    pci_bvh_destroy(scratch->context, bvh);
    pc_mesh_free(scratch->context, &rest);
    return status;
}

pc_status pci_leave_hollows(pci_scratch *scratch, const char *stage, const pc_mesh *projected,
                            double reach, uint8_t *keep) {
    const size_t triangles = projected->triangle_count;
    uint8_t *inside = PCI_SCRATCH(scratch, uint8_t, triangles);
    uint8_t *outside = PCI_SCRATCH(scratch, uint8_t, triangles);
    uint8_t *far = PCI_SCRATCH(scratch, uint8_t, projected->vertex_count);
    uint32_t *parents = PCI_SCRATCH(scratch, uint32_t, projected->vertex_count);
    size_t insides = 0, outsides = 0;
    if (scratch->failed || !find_hollows(scratch, projected, inside)) {
        return pci_fail_memory(scratch->context, stage);
    }
    pci_singletons(parents, projected->vertex_count);
    for (size_t t = 0; t < triangles; ++t) {
        const uint32_t *corner = &projected->triangles[3 * t];
        outside[t] = keep[t] && !inside[t];
        inside[t] = keep[t] && inside[t];
        insides += inside[t], outsides += outside[t];
        if (inside[t]) {
            pci_unite(parents, corner[0], corner[1]);
            pci_unite(parents, corner[0], corner[2]);
        }
    }
    if (insides == 0 || outsides == 0) {
        return PC_OK;
    }
    const pc_status status =
        find_far(scratch, stage, projected, reach, outside, inside, parents, far);
    for (size_t t = 0; t < triangles && status == PC_OK; ++t) {
        keep[t] =
            outside[t] || (inside[t] && far[pci_find_root(parents, projected->triangles[3 * t])]);
    }
    return status;
}
