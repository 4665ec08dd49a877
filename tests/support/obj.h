// A few lines of Wavefront OBJ for tests and benchmarks: positions and polygons, fan-triangulated,
// positions as they stand in the file. The product itself reads files through assimp.
#ifndef TEST_SUPPORT_OBJ_H
#define TEST_SUPPORT_OBJ_H

#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/core.h"
#include "proxycloth/mesh.h"

// Reads `path` into a mesh that pc_mesh_free releases. False: cannot be read.
static inline bool test_read_obj(pc_context *context, const char *path, pc_mesh *mesh) {
    FILE *file = fopen(path, "r");
    if (file == NULL) {
        return false;
    }
    char line[4096];
    for (int pass = 0; pass < 2; ++pass) {
        size_t vertices = 0, triangles = 0;
        rewind(file);
        while (fgets(line, sizeof(line), file) != NULL) {
            if (strncmp(line, "v ", 2) == 0) {
                if (pass == 1) {
                    char *at = line + 2;
                    for (size_t k = 0; k < 3; ++k) {
                        mesh->positions[3 * vertices + k] = strtod(at, &at);
                    }
                }
                ++vertices;
            } else if (strncmp(line, "f ", 2) == 0) {
                uint32_t corner[3] = {0};
                size_t count = 0;
                for (char *word = strtok(line + 2, " \t\r\n"); word != NULL;
                     word = strtok(NULL, " \t\r\n")) {
                    const long index = strtol(word, NULL, 10);
                    corner[count < 2 ? count : 2] =
                        (uint32_t)(index < 0 ? (long)vertices + index : index - 1);
                    if (++count >= 3) {
                        if (pass == 1) {
                            memcpy(&mesh->triangles[3 * triangles], corner, sizeof(corner));
                        }
                        ++triangles;
                        corner[1] = corner[2];
                    }
                }
            }
        }
        if (pass == 0) {
            mesh->vertex_count = vertices;
            mesh->triangle_count = triangles;
            mesh->positions = PCI_ALLOCATE(context, double, 3 * vertices);
            mesh->triangles = PCI_ALLOCATE(context, uint32_t, 3 * triangles);
        }
    }
    fclose(file);
    return true;
}

#endif
