// Writes GLB files of made-up garments with 4, 8 and 12 influences, and next to each the positions
// that every vertex must have at every frame, from equation (6). Usage: write_assets FOLDER
#include "support/asset_fixture.h"

static void pose_vertex(const pc_asset *asset, size_t vertex, size_t frame, double out[3]) {
    const pc_skin *skin = &asset->skin;
    const double *moved = &asset->motion.positions[3 * frame * asset->motion.vertex_count];
    for (size_t k = 0; k < 3; ++k) {
        out[k] = asset->visual.surface.positions[3 * vertex + k];
        for (size_t j = 0; j < skin->influences; ++j) {
            const size_t slot = vertex * skin->influences + j, bone = skin->bones[slot];
            out[k] +=
                skin->weights[slot] * (moved[3 * bone + k] - asset->proxy.positions[3 * bone + k]);
        }
    }
}

// The vertices of the primitive of `material`: split vertices in use, in order.
static void write_primitive(FILE *file, const pc_asset *asset, uint32_t material) {
    const pc_visual *visual = &asset->visual;
    for (size_t frame = 0; frame < FIXTURE_FRAMES; ++frame) {
        const char *separator = frame == 0 ? "[" : ",\n[";
        for (uint32_t corner = 0; corner < visual->corner_count; ++corner) {
            bool used = false;
            for (size_t i = 0; i < 3 * visual->surface.triangle_count; ++i) {
                used = used || (visual->corner_triangles[i] == corner &&
                                visual->triangle_materials[i / 3] == material);
            }
            if (used) {
                double p[3];
                pose_vertex(asset, visual->corner_vertices[corner], frame, p);
                fprintf(file, "%s%.17g,%.17g,%.17g", separator, p[0], p[1], p[2]);
                separator = ",";
            }
        }
        fputs("]", file);
    }
}

static void write_proxy(FILE *file, const pc_motion *motion) {
    for (size_t frame = 0; frame < motion->frame_count; ++frame) {
        fputs(frame == 0 ? "[" : ",\n[", file);
        for (size_t i = 0; i < 3 * motion->vertex_count; ++i) {
            fprintf(file, "%s%.17g", i == 0 ? "" : ",",
                    motion->positions[3 * frame * motion->vertex_count + i]);
        }
        fputs("]", file);
    }
}

static int write_files(pc_context *context, const char *folder, uint32_t influences) {
    pc_asset asset;
    fixture_asset(context, influences, &asset);
    asset.options.skin.weight_storage = PC_SKIN_WEIGHTS_FLOAT; // so that only rounding differs
    char path[512];
    snprintf(path, sizeof(path), "%s/tube_%u.glb", folder, influences);
    bool good = pc_export_glb(context, &asset, path) == PC_OK;
    snprintf(path, sizeof(path), "%s/tube_%u.json", folder, influences);
    FILE *file = good ? fopen(path, "w") : NULL;
    good = file != NULL;
    if (good) {
        fprintf(file, "{\"influences\": %u, \"frame_time\": %.17g,\n\"primitives\": [[", influences,
                asset.motion.frame_time);
        write_primitive(file, &asset, 0);
        fputs("],\n[", file);
        write_primitive(file, &asset, 2);
        fputs("],\n[", file);
        write_proxy(file, &asset.motion);
        fputs("]]}\n", file);
        good = fclose(file) == 0;
    }
    pc_asset_free(context, &asset);
    return good ? 0 : 1;
}

int main(int argument_count, char **arguments) {
    pc_context *context = NULL;
    if (argument_count != 2 || pc_context_create(NULL, &context) != PC_OK) {
        return 2;
    }
    const int failures = write_files(context, arguments[1], 4) +
                         write_files(context, arguments[1], 8) +
                         write_files(context, arguments[1], 12);
    pc_context_destroy(context);
    return failures;
}
