#include <stdio.h>

#include "core/core.h"
#include "geometry/render.h"
#include "geometry/topology.h"
#include "io/lettering.h"
#include "io/pictures.h"
#include "io/png_image.h"
#include "proxycloth/export.h"

static const char stage[] = "export";

static const pc_field contact_sheet_fields[] = {
    PCI_FIELD_OPTION(pc_contact_sheet_options, tile_size, UINT, 360, 96, 2048, "px",
                     "Side of one picture of the contact sheet"),
    PCI_FIELD_OPTION(pc_contact_sheet_options, skinned_frames, UINT, 6, 0, 64, "",
                     "How many frames of the motion the contact sheet shows"),
};
const pc_record pc_contact_sheet_options_record =
    PCI_RECORD(contact_sheet_fields, pc_contact_sheet_options);

static const uint8_t name_color[3] = {38, 42, 48}, detail_color[3] = {128, 134, 142};

static const char by_bone[] = "by bone, lighter where shared";

// One stage's mesh and how it is shown.
typedef struct exhibit {
    const char *name;
    const pc_mesh *mesh;
    pci_style style;
    pci_look look;
    const char *detail; // NULL: numbers of vertices and triangles
} exhibit;

typedef struct sheet {
    pc_context *context;
    const pc_asset *asset;
    size_t tile, margin, caption, title; // pixels
    size_t columns, rows;
    size_t frame_rows; // of skinned frames, and of their stretch
    pci_image image;
    pci_renderer renderer;
    pci_model visual; // also what the frames are like
    size_t exhibit_count;
    exhibit exhibits[6];  // the last one with the colours of the weights
    uint32_t frame_count; // shown
} sheet;

// ---- layout -----------------------------------------------------------------------------------

static void list_exhibits(sheet *s) {
    const pc_asset *a = s->asset;
    const struct {
        uint32_t stages;
        exhibit exhibit;
    } all[] = {
        {0, {"visual", &a->visual.surface, PCI_STYLE_SURFACE, PCI_LOOK_SMOOTH, NULL}},
        {PC_STAGE_ISOSURFACE + 1,
         {"iso-surface", &a->isosurface, PCI_STYLE_SURFACE, PCI_LOOK_SMOOTH, NULL}},
        {PC_STAGE_PROJECT + 1,
         {"projected", &a->projected, PCI_STYLE_SURFACE, PCI_LOOK_SMOOTH, NULL}},
        {PC_STAGE_CARVE + 1,
         {"single layer", &a->single_layer, PCI_STYLE_SURFACE, PCI_LOOK_SMOOTH, NULL}},
        {PC_STAGE_SIMPLIFY + 1,
         {"proxy", &a->proxy, PCI_STYLE_SURFACE_AND_EDGES, PCI_LOOK_FLAT, NULL}},
        {PC_STAGE_SKIN + 1,
         {"weights", &a->visual.surface, PCI_STYLE_SURFACE, PCI_LOOK_SMOOTH, by_bone}},
    };
    for (size_t i = 0; i < sizeof(all) / sizeof(all[0]); ++i) {
        if (a->stage_count >= all[i].stages && all[i].exhibit.mesh->triangle_count > 0) {
            s->exhibits[s->exhibit_count++] = all[i].exhibit;
        }
    }
}

static void lay_out(sheet *s, const pc_contact_sheet_options *options) {
    const pc_asset *a = s->asset;
    list_exhibits(s);
    if (a->stage_count > PC_STAGE_SKIN) {
        s->frame_count = options->skinned_frames;
        if (s->frame_count > a->motion.frame_count) {
            s->frame_count = (uint32_t)a->motion.frame_count;
        }
    }
    s->tile = options->tile_size;
    s->margin = s->tile / 30;
    s->caption = s->tile / 12;
    s->title = s->tile / 9;
    s->columns = s->exhibit_count;
    s->frame_rows = (s->frame_count + s->columns - 1) / s->columns;
    s->rows = 2 + 2 * s->frame_rows;
    s->image.width = s->margin + s->columns * (s->tile + s->margin);
    s->image.height = s->margin + s->title + s->rows * (s->tile + s->caption + s->margin);
}

static pci_tile tile_at(const sheet *s, size_t row, size_t column) {
    const pci_tile tile = {s->margin + column * (s->tile + s->margin),
                           s->margin + s->title + row * (s->tile + s->caption + s->margin),
                           s->tile};
    return tile;
}

// A name and a detail behind it, centred below the tile and made smaller where they are too wide.
static void write_caption(sheet *s, pci_tile tile, const char *name, const char *detail) {
    double height = 0.031 * (double)s->tile;
    double width = pci_text_width(name, height) + height + pci_text_width(detail, height);
    if (width > (double)s->tile) {
        height *= (double)s->tile / width;
        width = (double)s->tile;
    }
    const double x = (double)tile.x + 0.5 * ((double)s->tile - width);
    const double baseline = (double)(tile.y + s->tile) + 0.6 * (double)s->caption;
    const double after = pci_draw_text(&s->image, x, baseline, height, name_color, name);
    pci_draw_text(&s->image, after + height, baseline, height, detail_color, detail);
}

static void write_title(sheet *s) {
    static const char legend[] = "front sides grey, back sides blue";
    const double height = 0.044 * (double)s->tile, small = 0.031 * (double)s->tile;
    const double left = (double)s->margin, baseline = left + 0.6 * (double)s->title;
    const double after =
        pci_draw_text(&s->image, left, baseline, height, name_color, s->asset->name);
    double x = (double)(s->image.width - s->margin) - pci_text_width(legend, small);
    if (x > after + height) {
        pci_draw_text(&s->image, x, baseline, small, detail_color, legend);
    }
    x -= 2.0 * height + pci_draw_stretch_legend(NULL, 0.0, 0.0, small);
    if (s->frame_count > 0 && x > after + height) {
        pci_draw_stretch_legend(&s->image, x, baseline, small);
    }
}

// ---- pictures ---------------------------------------------------------------------------------

static bool advance(sheet *s, size_t done) {
    return pci_progress(s->context, stage,
                        (double)done / (double)(s->exhibit_count + s->frame_count));
}

static bool is_weights(const exhibit *e) { return e->detail == by_bone; }

// The visual mesh from one side and, where there are weights, the same in their colours.
static bool draw_visual(sheet *s, size_t view, const pci_camera *camera, const pci_model *cage,
                        const float *colors) {
    const pci_picture pictures[2] = {{tile_at(s, view, 0), NULL},
                                     {tile_at(s, view, s->exhibit_count - 1), colors}};
    const size_t count = cage != NULL ? 2 : 1;
    return pci_draw(&s->renderer, &s->visual, camera, PCI_STYLE_SURFACE, pictures, count) &&
           (cage == NULL ||
            pci_draw(&s->renderer, cage, camera, PCI_STYLE_EDGES_ON_TOP, &pictures[1], 1));
}

static bool draw_visuals(sheet *s, const pci_camera cameras[2]) {
    const pc_asset *a = s->asset;
    pci_scratch scratch = pci_scratch_begin(s->context);
    pci_model cage;
    float *colors = NULL;
    bool drawn = true;
    const bool weights = is_weights(&s->exhibits[s->exhibit_count - 1]);
    if (weights) {
        const float *bone_colors = pci_bone_colors(&scratch, &a->proxy);
        colors = PCI_SCRATCH(&scratch, float, 3 * a->visual.surface.vertex_count);
        drawn = bone_colors != NULL && colors != NULL &&
                pci_model_build(&s->renderer, &scratch, &a->proxy, PCI_LOOK_UNLIT, NULL, &cage);
        if (drawn) {
            pci_weight_colors(&a->skin, bone_colors, colors);
        }
    }
    for (size_t view = 0; view < 2 && drawn; ++view) {
        drawn = draw_visual(s, view, &cameras[view], weights ? &cage : NULL, colors);
    }
    pci_scratch_end(&scratch);
    return drawn;
}

// One exhibit from the front and from the back.
static bool draw_exhibit(sheet *s, size_t column, const pci_camera cameras[2]) {
    const exhibit *e = &s->exhibits[column];
    if (column == 0) {
        return draw_visuals(s, cameras);
    }
    if (is_weights(e)) {
        return true; // together with the visual mesh
    }
    pci_scratch scratch = pci_scratch_begin(s->context);
    pci_model model;
    bool drawn = pci_model_build(&s->renderer, &scratch, e->mesh, e->look, NULL, &model);
    for (size_t view = 0; view < 2 && drawn; ++view) {
        const pci_picture picture = {tile_at(s, view, column), NULL};
        drawn = pci_draw(&s->renderer, &model, &cameras[view], e->style, &picture, 1);
    }
    pci_scratch_end(&scratch);
    return drawn;
}

// Front and back of every stage, all with one scale.
static pc_status draw_exhibits(sheet *s) {
    pci_camera cameras[2];
    for (size_t view = 0; view < 2; ++view) {
        double extent[4] = {INFINITY, -INFINITY, INFINITY, -INFINITY};
        cameras[view] =
            pci_three_quarter_view(pci_up_axis_of(s->asset), view == 1 ? acos(-1.0) : 0.0);
        for (size_t i = 0; i < s->exhibit_count; ++i) {
            pci_extend_view(&cameras[view], s->exhibits[i].mesh, extent);
        }
        pci_aim_camera(&cameras[view], extent, s->tile);
    }
    cameras[0].scale = cameras[1].scale = fmin(cameras[0].scale, cameras[1].scale);
    for (size_t i = 0; i < s->exhibit_count; ++i) {
        if (!advance(s, i)) {
            return pci_fail_cancelled(s->context, stage);
        }
        if (!draw_exhibit(s, i, cameras)) {
            return pci_fail_memory(s->context, stage);
        }
        const exhibit *e = &s->exhibits[i];
        char detail[64];
        snprintf(detail, sizeof(detail), "%zu v  %zu f", e->mesh->vertex_count,
                 e->mesh->triangle_count);
        write_caption(s, tile_at(s, 0, i), e->name, e->detail != NULL ? e->detail : detail);
        write_caption(s, tile_at(s, 1, i), e->name, "back");
    }
    return PC_OK;
}

// Mean over the area.
static double mean_stretch(const pc_mesh *rest, const double *values) {
    double sum = 0.0, total = 0.0;
    for (size_t t = 0; t < rest->triangle_count; ++t) {
        const double area = pci_triangle_area(rest, t);
        for (size_t c = 0; c < 3; ++c) {
            sum += area / 3.0 * values[rest->triangles[3 * t + c]];
        }
        total += area;
    }
    return total > 0.0 ? sum / total : 0.0;
}

static void caption_frame(sheet *s, size_t frame, const pci_picture pictures[2],
                          const double *values) {
    const pc_asset *a = s->asset;
    char name[64], detail[64];
    snprintf(name, sizeof(name), "skinned, frame %zu", frame + 1);
    snprintf(detail, sizeof(detail), "%.2f s", a->motion.frame_time * (double)(frame + 1));
    write_caption(s, pictures[0].tile, name, detail);
    snprintf(name, sizeof(name), "stretch, frame %zu", frame + 1);
    snprintf(detail, sizeof(detail), "mean %.1f %%",
             100.0 * mean_stretch(&a->visual.surface, values));
    write_caption(s, pictures[1].tile, name, detail);
}

// A frame with the proxy's edges, and the same coloured by stretch.
static pc_status draw_frame(void *user, const pci_shown_frame *shown) {
    sheet *s = user;
    const size_t row = 2 + shown->picture / s->columns, column = shown->picture % s->columns;
    const pci_renderer *renderer = &s->renderer;
    if (!advance(s, s->exhibit_count + shown->picture)) {
        return pci_fail_cancelled(s->context, stage);
    }
    pci_scratch scratch = pci_scratch_begin(s->context);
    pci_model garment, cage;
    double *values = PCI_SCRATCH(&scratch, double, shown->skinned.vertex_count);
    float *colors = PCI_SCRATCH(&scratch, float, 3 * shown->skinned.vertex_count);
    const pci_picture pictures[2] = {{tile_at(s, row, column), NULL},
                                     {tile_at(s, row + s->frame_rows, column), colors}};
    const bool drawn =
        !scratch.failed &&
        pci_stretch_colors(&scratch, &s->asset->visual.surface, shown->skinned.positions, values,
                           colors) &&
        pci_model_build(renderer, &scratch, &shown->skinned, PCI_LOOK_SMOOTH, &s->visual,
                        &garment) &&
        pci_model_build(renderer, &scratch, &shown->proxy, PCI_LOOK_UNLIT, NULL, &cage) &&
        pci_draw(renderer, &garment, &shown->camera, PCI_STYLE_SURFACE, pictures, 2) &&
        pci_draw(renderer, &cage, &shown->camera, PCI_STYLE_EDGES_ON_TOP, pictures, 1);
    if (drawn) {
        caption_frame(s, shown->frame, pictures, values);
    }
    pci_scratch_end(&scratch);
    return drawn ? PC_OK : pci_fail_memory(s->context, stage);
}

pc_status pc_export_contact_sheet(pc_context *context, const pc_asset *asset,
                                  const pc_contact_sheet_options *options, const char *path) {
    if (context == NULL) {
        return PC_ERROR_INVALID_ARGUMENT;
    }
    if (asset == NULL || path == NULL || asset->visual.surface.triangle_count == 0) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "%s: asset or path is NULL, or the asset has no visual mesh", stage);
    }
    if (asset->stage_count > PC_STAGE_SKIN &&
        (asset->skin.vertex_count != asset->visual.surface.vertex_count ||
         asset->motion.vertex_count != asset->proxy.vertex_count)) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "%s: weights or motion do not belong to the asset's meshes", stage);
    }
    pc_contact_sheet_options chosen;
    pc_status status =
        pci_begin_stage(context, stage, &pc_contact_sheet_options_record, options, &chosen);
    if (status != PC_OK) {
        return status;
    }

    sheet s = {.context = context, .asset = asset};
    lay_out(&s, &chosen);
    pci_scratch scratch = pci_scratch_begin(context);
    s.image.pixels = PCI_SCRATCH(&scratch, uint8_t, 3 * s.image.width * s.image.height);
    if (scratch.failed) {
        status = pci_fail_memory(context, stage);
        goto cleanup;
    }
    pci_image_whiten(context, &s.image);
    write_title(&s);
    if (!pci_renderer_begin(&s.renderer, context, &scratch, &s.image, s.tile) ||
        !pci_model_build(&s.renderer, &scratch, &asset->visual.surface, PCI_LOOK_SMOOTH, NULL,
                         &s.visual)) {
        status = pci_fail_memory(context, stage);
        goto cleanup;
    }
    status = draw_exhibits(&s);
    if (status == PC_OK && s.frame_count > 0) {
        status = pci_show_frames(context, stage, asset, s.frame_count, s.tile, draw_frame, &s);
    }
    if (status == PC_OK) {
        status = pci_write_png(context, stage, &s.image, path);
    }

cleanup:
    pci_scratch_end(&scratch);
    return status;
}
