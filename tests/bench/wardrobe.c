// Writes the garments of support/wardrobe.h as OBJ files, with what they are in openings.tsv, for
// the other programs to read.
// Usage: proxycloth_wardrobe FOLDER
#include <stdio.h>

#include "support/wardrobe.h"

static bool write_obj(const char *folder, const char *name, const pc_mesh *mesh) {
    char path[1024];
    snprintf(path, sizeof(path), "%s/%s.obj", folder, name);
    FILE *file = fopen(path, "w");
    if (file == NULL) {
        fprintf(stderr, "%s: cannot be written\n", path);
        return false;
    }
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        const double *p = &mesh->positions[3 * v];
        fprintf(file, "v %.9g %.9g %.9g\n", p[0], p[1], p[2]);
    }
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        const uint32_t *c = &mesh->triangles[3 * t];
        fprintf(file, "f %u %u %u\n", c[0] + 1, c[1] + 1, c[2] + 1);
    }
    return fclose(file) == 0;
}

int main(int argc, char **argv) {
    char path[1024];
    pc_context *context = NULL;
    if (argc != 2) {
        fprintf(stderr, "usage: %s FOLDER\n", argv[0]);
        return 2;
    }
    snprintf(path, sizeof(path), "%s/openings.tsv", argv[1]);
    FILE *truth = fopen(path, "w");
    if (truth == NULL || pc_context_create(NULL, &context) != PC_OK) {
        fprintf(stderr, "%s: cannot be written\n", path);
        return 1;
    }
    bool good = true;
    for (size_t i = 0; i < sew_wardrobe_size && good; ++i) {
        const sew_garment *garment = &sew_wardrobe[i];
        pc_mesh mesh = sew_make(context, garment);
        good = write_obj(argv[1], garment->name, &mesh);
        if (garment->components > 0) {
            fprintf(truth, "%s\t%u\t%u\n", garment->name, garment->components, garment->loops);
        }
        pc_mesh_free(context, &mesh);
    }
    pc_context_destroy(context);
    return fclose(truth) == 0 && good ? 0 : 1;
}
