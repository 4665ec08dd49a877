// An animation strip: turntables and frames of a finished asset in rows.

#include "core/core.h"
#include "geometry/render.h"
#include "io/lettering.h"
#include "io/pictures.h"
#include "io/png_image.h"
#include "proxycloth/export.h"

static const char stage[] = "export";

static const pc_field strip_fields[] = {
    PCI_FIELD_OPTION(pc_strip_options, strip_tile, UINT, 240, 96, 2048, "px",
                     "Side of one picture of the animation strip"),
    PCI_FIELD_OPTION(pc_strip_options, strip_frames, UINT, 12, 2, 64, "",
                     "Pictures in each row of the animation strip"),
};
const pc_record pc_strip_options_record = PCI_RECORD(strip_fields, pc_strip_options);

typedef enum strip_row { TURNTABLE, WEIGHTS, SKINNED, STRETCH, ROW_COUNT } strip_row;

typedef struct strip {
    pc_context *context;
    const pc_asset *asset;
    size_t tile, columns, title, gap; // pixels
    pci_image image;
    pci_renderer renderer;
} strip;

static pci_tile tile_at(const strip *s, strip_row row, size_t column) {
    const pci_tile tile = {s->gap + column * s->tile, s->title + (size_t)row * (s->tile + s->title),
                           s->tile};
    return tile;
}

static void write_titles(strip *s) {
    static const uint8_t name_color[3] = {38, 42, 48};
    static const char *const names[ROW_COUNT] = {
        "turntable", "weights by bone, lighter where shared", "skinned frames", ""};
    const double height = 0.05 * (double)s->tile;
    for (strip_row row = TURNTABLE; row < ROW_COUNT; ++row) {
        const double baseline = (double)tile_at(s, row, 0).y - 0.35 * (double)s->title;
        double x = 2.0 * (double)s->gap;
        if (row == TURNTABLE) {
            x = pci_draw_text(&s->image, x, baseline, height, name_color, s->asset->name) + height;
        }
        x = pci_draw_text(&s->image, x, baseline, height, name_color, names[row]);
        if (row == STRETCH) {
            pci_draw_stretch_legend(&s->image, x, baseline, height);
        }
    }
}

static bool advance(const strip *s, size_t done) {
    return pci_progress(s->context, stage, (double)done / (double)(2 * s->columns));
}

// A turn of the visual mesh, plain and in the colours of its bones. The scale is that of the widest
// view, and the axis of the turn stays in the middle.
static pc_status draw_turntable(strip *s) {
    const pc_asset *a = s->asset;
    const pc_mesh *surface = &a->visual.surface;
    const uint32_t up_axis = pci_up_axis_of(a);
    pc_status status = PC_OK;
    pci_scratch scratch = pci_scratch_begin(s->context);
    pci_model model;
    const float *bone_colors = pci_bone_colors(&scratch, &a->proxy);
    float *colors = PCI_SCRATCH(&scratch, float, 3 * surface->vertex_count);
    if (bone_colors == NULL || colors == NULL ||
        !pci_model_build(&s->renderer, &scratch, surface, PCI_LOOK_SMOOTH, NULL, &model)) {
        status = pci_fail_memory(s->context, stage);
        goto cleanup;
    }
    pci_weight_colors(&a->skin, bone_colors, colors);
    double scale = INFINITY;
    for (size_t pass = 0; pass < 2; ++pass) {
        for (size_t i = 0; i < s->columns && status == PC_OK; ++i) {
            const double turn = 2.0 * acos(-1.0) * (double)i / (double)s->columns;
            double extent[4] = {INFINITY, -INFINITY, INFINITY, -INFINITY};
            pci_camera camera = pci_three_quarter_view(up_axis, turn);
            pci_extend_view(&camera, surface, extent);
            pci_aim_camera(&camera, extent, s->tile);
            scale = fmin(scale, camera.scale);
            camera.scale = scale;
            if (pass == 0) {
                continue;
            }
            if (!advance(s, i)) {
                status = pci_fail_cancelled(s->context, stage);
                continue;
            }
            const pci_picture pictures[2] = {{tile_at(s, TURNTABLE, i), NULL},
                                             {tile_at(s, WEIGHTS, i), colors}};
            if (!pci_draw(&s->renderer, &model, &camera, PCI_STYLE_SURFACE, pictures, 2)) {
                status = pci_fail_memory(s->context, stage);
            }
        }
    }

cleanup:
    pci_scratch_end(&scratch);
    return status;
}

// One frame, plain and in the colours of its stretch.
static pc_status draw_frame(void *user, const pci_shown_frame *shown) {
    strip *s = user;
    if (!advance(s, s->columns + shown->picture)) {
        return pci_fail_cancelled(s->context, stage);
    }
    pci_scratch scratch = pci_scratch_begin(s->context);
    pci_model model;
    double *values = PCI_SCRATCH(&scratch, double, shown->skinned.vertex_count);
    float *colors = PCI_SCRATCH(&scratch, float, 3 * shown->skinned.vertex_count);
    const pci_picture pictures[2] = {{tile_at(s, SKINNED, shown->picture), NULL},
                                     {tile_at(s, STRETCH, shown->picture), colors}};
    const bool drawn =
        !scratch.failed &&
        pci_stretch_colors(&scratch, &s->asset->visual.surface, shown->skinned.positions, values,
                           colors) &&
        pci_model_build(&s->renderer, &scratch, &shown->skinned, PCI_LOOK_SMOOTH, NULL, &model) &&
        pci_draw(&s->renderer, &model, &shown->camera, PCI_STYLE_SURFACE, pictures, 2);
    pci_scratch_end(&scratch);
    return drawn ? PC_OK : pci_fail_memory(s->context, stage);
}

pc_status pc_export_strip(pc_context *context, const pc_asset *asset,
                          const pc_strip_options *options, const char *path) {
    if (context == NULL) {
        return PC_ERROR_INVALID_ARGUMENT;
    }
    if (asset == NULL || path == NULL || asset->stage_count < PC_STAGE_COUNT ||
        asset->skin.vertex_count != asset->visual.surface.vertex_count ||
        asset->motion.vertex_count != asset->proxy.vertex_count || asset->motion.frame_count == 0) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "%s: a strip needs an asset with all stages done and a path", stage);
    }
    pc_strip_options chosen;
    pc_status status = pci_begin_stage(context, stage, &pc_strip_options_record, options, &chosen);
    if (status != PC_OK) {
        return status;
    }
    strip s = {.context = context, .asset = asset};
    s.tile = chosen.strip_tile;
    s.columns = chosen.strip_frames;
    s.title = s.tile / 8;
    s.gap = s.tile / 24;
    s.image.width = 2 * s.gap + s.columns * s.tile;
    s.image.height = s.gap + ROW_COUNT * (s.tile + s.title);
    pci_scratch scratch = pci_scratch_begin(context);
    s.image.pixels = PCI_SCRATCH(&scratch, uint8_t, 3 * s.image.width * s.image.height);
    if (scratch.failed || !pci_renderer_begin(&s.renderer, context, &scratch, &s.image, s.tile)) {
        status = pci_fail_memory(context, stage);
        goto cleanup;
    }
    pci_image_whiten(context, &s.image);
    write_titles(&s);
    status = draw_turntable(&s);
    if (status == PC_OK) {
        status = pci_show_frames(context, stage, asset, s.columns, s.tile, draw_frame, &s);
    }
    if (status == PC_OK) {
        status = pci_write_png(context, stage, &s.image, path);
    }

cleanup:
    pci_scratch_end(&scratch);
    return status;
}
