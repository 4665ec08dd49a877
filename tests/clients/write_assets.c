// Writes GLB files of made-up garments with 4, 8 and 12 influences, one whose joints turn and one
// of a character, and next to each the positions that every vertex must have at every frame. Usage:
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

// Vertices with equation (6), or with the rotations of all frames.
typedef struct garment {
    const pc_asset *asset;
    const pc_body_skin *body;
    const double *rotations; // #frames by #P by 4, or NULL
} garment;

static void pose_vertex(const garment *g, size_t vertex, size_t frame, double out[3]) {
    const pc_asset *asset = g->asset;
    pc_skin row = {.vertex_count = 1, .influences = asset->skin.influences};
    row.bones = &asset->skin.bones[vertex * row.influences];
    row.weights = &asset->skin.weights[vertex * row.influences];
    const size_t joints = asset->motion.vertex_count;
    const double *rest = &asset->visual.surface.positions[3 * vertex];
    const double share = g->body->vertex_count > 0 ? g->body->shares[vertex] : 1.0;
    double carried[3];
    turn(rest, asset->motion.frame_time * (double)(frame + 1), carried);
    pc_skin_deform(&row, rest, asset->proxy.positions, &asset->motion.positions[3 * frame * joints],
                   g->rotations != NULL ? &g->rotations[4 * frame * joints] : NULL, out);
    for (size_t k = 0; k < 3; ++k) {
        out[k] = share * out[k] + (1.0 - share) * carried[k];
    }
}

// The vertices of the primitive of `material`: split vertices in use, in order.
static void write_primitive(FILE *file, const garment *g, uint32_t material) {
    const pc_visual *visual = &g->asset->visual;
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
                pose_vertex(g, visual->corner_vertices[corner], frame, p);
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
    const pc_motion *motion = &asset->motion;
    double *rotations = calloc(4 * motion->frame_count * motion->vertex_count, sizeof(double));
    const bool turns = asset->skin.skinning == PC_SKINNING_ROTATION;
    const garment g = {asset, &body, turns ? rotations : NULL};
    snprintf(path, sizeof(path), "%s/%s.glb", folder, name);
    bool good = rotations != NULL &&
                pc_rotation_estimate_motion(context, &asset->proxy, motion, rotations) == PC_OK &&
                pc_body_skin_create(context, &asset->visual, &asset->character, &asset->proxy,
                                    &asset->motion, &asset->options.skin, &body, NULL) == PC_OK &&
                pc_export_glb(context, asset, path) == PC_OK;
    snprintf(path, sizeof(path), "%s/%s.json", folder, name);
    FILE *file = good ? fopen(path, "w") : NULL;
    good = file != NULL;
    if (good) {
        fprintf(file, "{\"influences\": %u, \"frame_time\": %.17g,\n\"primitives\": [[", influences,
                asset->motion.frame_time);
        write_primitive(file, &g, 0);
        fputs("],\n[", file);
        write_primitive(file, &g, 2);
        fputs("],\n[", file);
        write_proxy(file, &asset->motion);
        fputs("]]}\n", file);
        good = fclose(file) == 0;
    }
    pc_body_skin_free(context, &body);
    free(rotations);
    return good ? 0 : 1;
}

static int write_tube(pc_context *context, const char *folder, const char *name,
                      uint32_t influences, pc_skinning skinning) {
    pc_asset asset;
    fixture_asset(context, influences, &asset);
    asset.options.skin.weight_storage = PC_SKIN_WEIGHTS_FLOAT; // so that only rounding differs
    asset.skin.skinning = skinning;
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
    const int failures = write_tube(context, folder, "tube_4", 4, PC_SKINNING_TRANSLATION) +
                         write_tube(context, folder, "tube_8", 8, PC_SKINNING_TRANSLATION) +
                         write_tube(context, folder, "tube_12", 12, PC_SKINNING_TRANSLATION) +
                         write_tube(context, folder, "turning_4", 4, PC_SKINNING_ROTATION) +
                         write_sleeve(context, folder);
    pc_context_destroy(context);
    return failures;
}
