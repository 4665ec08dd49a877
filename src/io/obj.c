#include "core/core.h"
#include "io/atomic_file.h"
#include "io/json.h"
#include "proxycloth/export.h"

pc_status pc_export_obj(pc_context *context, const pc_mesh *mesh, const char *path) {
    if (context == NULL) {
        return PC_ERROR_INVALID_ARGUMENT;
    }
    if (mesh == NULL || path == NULL) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, "export",
                        "export: mesh or path is NULL");
    }
    for (size_t i = 0; i < 3 * mesh->vertex_count; ++i) {
        if (!isfinite(mesh->positions[i])) {
            return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, "export",
                            "export: position of vertex %zu is not finite", i / 3);
        }
    }
    pci_atomic_file file = {0};
    const pc_status status = pci_atomic_begin(context, "export", path, &file);
    if (status != PC_OK) {
        return status;
    }
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        char text[3][40];
        for (size_t k = 0; k < 3; ++k) {
            pci_number_text(mesh->positions[3 * v + k], text[k]);
        }
        fprintf(file.stream, "v %s %s %s\n", text[0], text[1], text[2]);
    }
    for (size_t f = 0; f < mesh->triangle_count; ++f) {
        const uint32_t *corner = &mesh->triangles[3 * f];
        fprintf(file.stream, "f %llu %llu %llu\n", corner[0] + 1ull, corner[1] + 1ull,
                corner[2] + 1ull);
    }
    return pci_atomic_end(&file, PC_OK);
}
