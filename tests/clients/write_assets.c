// Writes GLB files of made-up garments with 4, 8 and 12 influences and one of a character, and next
// to each the positions that every vertex must have at every frame, from equation (6). Usage:
// write_assets FOLDER
#include "support/asset_fixture.h"
#include "support/character_fixture.h"

// Where the character's arm takes a point: its clip turns it around (1, 0, 0) by 90 degrees a
// second.
static void turn(const double at[3], double time, double out[3]) {
    const double angle = 1.5707963267948966 * time;
    out[0] = 1.0 + cos(angle) * (at[0] - 1.0) - sin(angle) * at[1];
    out[1] = sin(angle) * (at[0] - 1.0) + cos(angle) * at[1];
    out[2] = at[2];
}

static void pose_vertex(const pc_asset *asset, const pc_body_skin *body, size_t vertex,
                        size_t frame, double out[3]) {
    const pc_skin *skin = &asset->skin;
    const double *moved = &asset->motion.positions[3 * frame * asset->motion.vertex_count];
    const double *rest = &asset->visual.surface.positions[3 * vertex];
    const double share = body->vertex_count > 0 ? body->shares[vertex] : 1.0;
    double carried[3];
    turn(rest, asset->motion.frame_time * (double)(frame + 1), carried);
    for (size_t k = 0; k < 3; ++k) {
        out[k] = rest[k];
        for (size_t j = 0; j < skin->influences; ++j) {
            const size_t slot = vertex * skin->influences + j, bone = skin->bones[slot];
            out[k] +=
                skin->weights[slot] * (moved[3 * bone + k] - asset->proxy.positions[3 * bone + k]);
        }
        out[k] = share * out[k] + (1.0 - share) * carried[k];
    }
}

// The vertices of the primitive of `material`: split vertices in use, in order.
static void write_primitive(FILE *file, const pc_asset *asset, const pc_body_skin *body,
                            uint32_t material) {
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
                pose_vertex(asset, body, visual->corner_vertices[corner], frame, p);
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

static int write_files(pc_context *context, const char *folder, const char *name,
                       const pc_asset *asset, uint32_t influences) {
    char path[512];
    pc_body_skin body = {0};
    snprintf(path, sizeof(path), "%s/%s.glb", folder, name);
    bool good = pc_body_skin_create(context, &asset->visual, &asset->character, &asset->proxy,
                                    &asset->motion, &asset->options.skin, &body, NULL) == PC_OK &&
                pc_export_glb(context, asset, path) == PC_OK;
    snprintf(path, sizeof(path), "%s/%s.json", folder, name);
    FILE *file = good ? fopen(path, "w") : NULL;
    good = file != NULL;
    if (good) {
        fprintf(file, "{\"influences\": %u, \"frame_time\": %.17g,\n\"primitives\": [[", influences,
                asset->motion.frame_time);
        write_primitive(file, asset, &body, 0);
        fputs("],\n[", file);
        write_primitive(file, asset, &body, 2);
        fputs("],\n[", file);
        write_proxy(file, &asset->motion);
        fputs("]]}\n", file);
        good = fclose(file) == 0;
    }
    pc_body_skin_free(context, &body);
    return good ? 0 : 1;
}

static int write_tube(pc_context *context, const char *folder, uint32_t influences) {
    pc_asset asset;
    fixture_asset(context, influences, &asset);
    asset.options.skin.weight_storage = PC_SKIN_WEIGHTS_FLOAT; // so that only rounding differs
    char name[32];
    snprintf(name, sizeof(name), "tube_%u", influences);
    const int failures = write_files(context, folder, name, &asset, influences);
    pc_asset_free(context, &asset);
    return failures;
}

// The tube on the arm of a character: near its pins it keeps its place there.
static int write_sleeve(pc_context *context, const char *folder) {
    static const double center[3] = {0.0, 1.2, 0.0};
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    fixture_character(context, center, 0.3, 1, &asset.character);
    asset.options.skin.weight_storage = PC_SKIN_WEIGHTS_FLOAT;
    asset.options.skin.body_blend = 0.5;
    asset.scenario.attachment.kind = PC_ATTACHMENT_CLIP;
    memcpy(asset.scenario.attachment.clip, "turn", sizeof("turn"));
    asset.motion.frame_time = 0.1;
    for (size_t v = 0; v < asset.skin.vertex_count; ++v) { // room for the arm
        asset.skin.weights[4 * v] += asset.skin.weights[4 * v + 3];
        asset.skin.weights[4 * v + 3] = 0.0;
    }
    const int failures = write_files(context, folder, "sleeve_4", &asset, 4);
    pc_asset_free(context, &asset);
    return failures;
}

int main(int argument_count, char **arguments) {
    pc_context *context = NULL;
    if (argument_count != 2 || pc_context_create(NULL, &context) != PC_OK) {
        return 2;
    }
    const char *folder = arguments[1];
    const int failures = write_tube(context, folder, 4) + write_tube(context, folder, 8) +
                         write_tube(context, folder, 12) + write_sleeve(context, folder);
    pc_context_destroy(context);
    return failures;
}
