// What the measuring programs share: loading a garment, and its weights on a wind they have not
// seen.
#ifndef TEST_SUPPORT_GARMENT_H
#define TEST_SUPPORT_GARMENT_H

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
    snprintf(asset->name, sizeof(asset->name), "%.120s", slash != NULL ? slash + 1 : path);
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

// Applies OPTION=VALUE to every stage that has the option.
static inline bool set_option(pc_context *context, pc_options *options, char *text) {
    char *equals = strchr(text, '=');
    bool found = false;
    if (equals == NULL) {
        return false;
    }
    *equals = '\0';
    for (pc_stage stage = 0; stage < PC_STAGE_COUNT; ++stage) {
        const pc_stage_info *info = pc_stage_describe(stage);
        const pc_field *field = pc_record_find(info->options, text);
        if (field != NULL) {
            found = pc_field_set_text(context, info->name, field,
                                      (char *)options + info->options_offset, equals + 1) == PC_OK;
        }
    }
    return found;
}

// Normalised L_r of the asset's weights and of closest-triangle weights, on a motion with another
// seed. False when a call fails.
static inline bool unseen_wind_rigid(pc_context *context, const pc_asset *asset, double *ours,
                                     double *closest_triangle) {
    pc_simulate_options simulate = asset->options.simulate;
    simulate.seed += 1000;
    pc_motion motion = {0};
    pc_skin closest = {0};
    pc_skin_losses losses = {0}, closest_losses = {0};
    const pc_mesh *surface = &asset->visual.surface;
    const pc_skin_options *options = &asset->options.skin;
    const bool good =
        pc_simulate(context, &asset->proxy, &simulate, &motion, NULL) == PC_OK &&
        pc_skin_closest_triangle(context, surface, &asset->proxy, &closest) == PC_OK &&
        pc_skin_evaluate(context, surface, &asset->proxy, &motion, &asset->skin, options,
                         &losses) == PC_OK &&
        pc_skin_evaluate(context, surface, &asset->proxy, &motion, &closest, options,
                         &closest_losses) == PC_OK;
    if (good) {
        const double frames = (double)motion.frame_count;
        *ours = losses.rigid / (frames * losses.rigid_norm);
        *closest_triangle = closest_losses.rigid / (frames * closest_losses.rigid_norm);
    }
    pc_motion_free(context, &motion);
    pc_skin_free(context, &closest);
    return good;
}

#endif
