// Loads a garment for the measuring programs and gives it a name.
#ifndef TEST_BENCH_GARMENT_H
#define TEST_BENCH_GARMENT_H

#include "proxycloth/proxycloth.h"
#include "support/obj.h"

// Reads `path` (OBJ) into asset->visual, welded. False with a message on standard error.
static inline bool load_garment(pc_context *context, const char *path, pc_asset *asset) {
    pc_mesh mesh = {0};
    if (!test_read_obj(context, path, &mesh)) {
        fprintf(stderr, "%s: cannot be read\n", path);
        return false;
    }
    const char *slash = strrchr(path, '/');
    snprintf(asset->name, sizeof(asset->name), "%s", slash != NULL ? slash + 1 : path);
    char *dot = strrchr(asset->name, '.');
    if (dot != NULL) {
        *dot = '\0';
    }
    const pc_visual_arrays arrays = {.vertex_count = mesh.vertex_count,
                                     .positions = mesh.positions,
                                     .triangle_count = mesh.triangle_count,
                                     .triangles = mesh.triangles};
    const pc_status status =
        pc_visual_create(context, &arrays, &asset->visual, &asset->reports.visual);
    pc_mesh_free(context, &mesh);
    if (status != PC_OK) {
        fprintf(stderr, "%s: %s\n", path, pc_context_error(context)->message);
    }
    return status == PC_OK;
}

#endif
