#include <stdio.h>

#include "core/core.h"
#include "core/render.h"
#include "io/lettering.h"
#include "io/png_image.h"
#include "proxycloth/export.h"

static const char stage[] = "export";

static const pc_field contact_sheet_fields[] = {
    PCI_FIELD_OPTION(pc_contact_sheet_options, tile_size, UINT, 360, 96, 2048, "px",
                     "Side of one picture of the contact sheet"),
    PCI_FIELD_OPTION(pc_contact_sheet_options, skinned_frames, UINT, 5, 0, 64, "",
                     "How many frames of the motion the contact sheet shows"),
};
const pc_record pc_contact_sheet_options_record =
    PCI_RECORD(contact_sheet_fields, pc_contact_sheet_options);

static const uint8_t name_color[3] = {38, 42, 48}, detail_color[3] = {128, 134, 142};

#define AZIMUTH   0.44 // radians to the side of the front: a three-quarter view
#define ELEVATION 0.21 // radians above the horizon
#define FILL      0.94 // share of a tile's side that the larger extent takes

// One stage's mesh and how it is shown.
typedef struct exhibit {
    const char *name;
    const pc_mesh *mesh;
    pci_style style;
    pci_look look;
} exhibit;

typedef struct sheet {
    pc_context *context;
    const pc_asset *asset;
    size_t tile, margin, caption, title; // pixels
    size_t columns, rows;
    pci_image image;
    size_t exhibit_count;
    exhibit exhibits[5];
    uint32_t frame_count; // shown
} sheet;

// ---- layout -----------------------------------------------------------------------------------

static void list_exhibits(sheet *s) {
    const pc_asset *a = s->asset;
    const struct {
        uint32_t stages;
        exhibit exhibit;
    } all[] = {
        {0, {"visual", &a->visual.surface, PCI_STYLE_SURFACE, PCI_LOOK_SMOOTH}},
        {PC_STAGE_ISOSURFACE + 1,
         {"iso-surface", &a->isosurface, PCI_STYLE_SURFACE, PCI_LOOK_SMOOTH}},
        {PC_STAGE_PROJECT + 1, {"projected", &a->projected, PCI_STYLE_SURFACE, PCI_LOOK_SMOOTH}},
        {PC_STAGE_CARVE + 1,
         {"single layer", &a->single_layer, PCI_STYLE_SURFACE, PCI_LOOK_SMOOTH}},
        {PC_STAGE_SIMPLIFY + 1, {"proxy", &a->proxy, PCI_STYLE_SURFACE_AND_EDGES, PCI_LOOK_FLAT}},
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
    s->rows = 2 + (s->frame_count + s->columns - 1) / s->columns;
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
    const double x = (double)(s->image.width - s->margin) - pci_text_width(legend, small);
    if (x > after + height) {
        pci_draw_text(&s->image, x, baseline, small, detail_color, legend);
    }
}

// ---- camera -----------------------------------------------------------------------------------

// Looks at the front or, turned by half a circle, at the back of the garment. y up: the front is
// +z; z up: -y; x up: +z.
static pci_camera make_camera(uint32_t up_axis, bool back) {
    static const double ups[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    static const double fronts[3][3] = {{0, 0, 1}, {0, 0, 1}, {0, -1, 0}};
    const double *up = ups[up_axis], *front = fronts[up_axis];
    const double azimuth = AZIMUTH + (back ? acos(-1.0) : 0.0);
    double side[3];
    pci_camera camera = {.scale = 1.0};
    pci_cross(up, front, side);
    for (size_t k = 0; k < 3; ++k) {
        camera.towards[k] = sin(ELEVATION) * up[k] +
                            cos(ELEVATION) * (cos(azimuth) * front[k] + sin(azimuth) * side[k]);
    }
    pci_cross(up, camera.towards, camera.right);
    pci_normalize(camera.right);
    pci_cross(camera.towards, camera.right, camera.up);
    return camera;
}

// Grows an extent (minimum and maximum along right and up) by the vertices that triangles use.
static void extend(const pci_camera *camera, const pc_mesh *mesh, double extent[4]) {
    for (size_t i = 0; i < 3 * mesh->triangle_count; ++i) {
        const double *p = &mesh->positions[3 * (size_t)mesh->triangles[i]];
        const double x = pci_dot(p, camera->right), y = pci_dot(p, camera->up);
        extent[0] = fmin(extent[0], x), extent[1] = fmax(extent[1], x);
        extent[2] = fmin(extent[2], y), extent[3] = fmax(extent[3], y);
    }
}

static void aim(const sheet *s, pci_camera *camera, const double extent[4]) {
    const double size = fmax(extent[1] - extent[0], extent[3] - extent[2]);
    camera->centre[0] = 0.5 * (extent[0] + extent[1]);
    camera->centre[1] = 0.5 * (extent[2] + extent[3]);
    camera->scale = size > 0.0 ? FILL * (double)s->tile / size : 1.0;
}

static uint32_t up_axis_of(const pc_asset *asset) {
    const pc_options defaults = pc_default_options();
    const bool known = asset->stage_count > PC_STAGE_SIMULATE;
    const uint32_t axis = known ? asset->options.simulate.up_axis : defaults.simulate.up_axis;
    return axis < 3 ? axis : 1;
}

// ---- pictures ---------------------------------------------------------------------------------

static bool advance(sheet *s, size_t done) {
    return pci_progress(s->context, stage,
                        (double)done / (double)(s->exhibit_count + s->frame_count));
}

// Front and back of every stage, all with one scale.
static pc_status draw_exhibits(sheet *s) {
    pci_camera cameras[2];
    for (size_t view = 0; view < 2; ++view) {
        double extent[4] = {INFINITY, -INFINITY, INFINITY, -INFINITY};
        cameras[view] = make_camera(up_axis_of(s->asset), view == 1);
        for (size_t i = 0; i < s->exhibit_count; ++i) {
            extend(&cameras[view], s->exhibits[i].mesh, extent);
        }
        aim(s, &cameras[view], extent);
    }
    cameras[0].scale = cameras[1].scale = fmin(cameras[0].scale, cameras[1].scale);
    for (size_t i = 0; i < s->exhibit_count; ++i) {
        if (!advance(s, i)) {
            return pci_fail_cancelled(s->context, stage);
        }
        const exhibit *e = &s->exhibits[i];
        pci_scratch scratch = pci_scratch_begin(s->context);
        pci_model model;
        bool drawn = pci_model_build(s->context, &scratch, e->mesh, e->look, &model);
        for (size_t view = 0; view < 2 && drawn; ++view) {
            drawn = pci_draw(s->context, &scratch, &model, &cameras[view], e->style,
                             tile_at(s, view, i), &s->image);
        }
        pci_scratch_end(&scratch);
        if (!drawn) {
            return pci_fail_memory(s->context, stage);
        }
        char detail[64];
        snprintf(detail, sizeof(detail), "%zu v  %zu f", e->mesh->vertex_count,
                 e->mesh->triangle_count);
        write_caption(s, tile_at(s, 0, i), e->name, detail);
        write_caption(s, tile_at(s, 1, i), e->name, "back");
    }
    return PC_OK;
}

// Frames at equal distances up to the last one.
static size_t shown_frame(const sheet *s, size_t i) {
    return (i + 1) * s->asset->motion.frame_count / s->frame_count - 1;
}

static bool draw_frame(sheet *s, const pc_mesh *skinned, const pc_mesh *proxy,
                       const pci_camera *camera, pci_tile tile) {
    pci_scratch scratch = pci_scratch_begin(s->context);
    pci_model garment, cage;
    const bool drawn =
        pci_model_build(s->context, &scratch, skinned, PCI_LOOK_SMOOTH, &garment) &&
        pci_model_build(s->context, &scratch, proxy, PCI_LOOK_UNLIT, &cage) &&
        pci_draw(s->context, &scratch, &garment, camera, PCI_STYLE_SURFACE, tile, &s->image) &&
        pci_draw(s->context, &scratch, &cage, camera, PCI_STYLE_EDGES_ON_TOP, tile, &s->image);
    pci_scratch_end(&scratch);
    return drawn;
}

// The skinned visual mesh with the edges of the proxy, all frames with one camera.
static pc_status draw_frames(sheet *s) {
    const pc_asset *a = s->asset;
    const pc_mesh *surface = &a->visual.surface;
    pc_status status = PC_OK;
    pci_scratch scratch = pci_scratch_begin(s->context);
    pc_mesh skinned = *surface, proxy = a->proxy;
    skinned.positions = PCI_SCRATCH(&scratch, double, 3 * surface->vertex_count);
    if (scratch.failed) {
        status = pci_fail_memory(s->context, stage);
        goto cleanup;
    }
    pci_camera camera = make_camera(up_axis_of(a), false);
    double extent[4] = {INFINITY, -INFINITY, INFINITY, -INFINITY};
    for (size_t pass = 0; pass < 2; ++pass) {
        for (size_t i = 0; i < s->frame_count && status == PC_OK; ++i) {
            const size_t frame = shown_frame(s, i);
            proxy.positions = &a->motion.positions[3 * frame * a->motion.vertex_count];
            pc_skin_deform(&a->skin, surface->positions, a->proxy.positions, proxy.positions,
                           skinned.positions);
            if (pass == 0) {
                extend(&camera, &skinned, extent);
                continue;
            }
            if (!advance(s, s->exhibit_count + i)) {
                status = pci_fail_cancelled(s->context, stage);
                continue;
            }
            const pci_tile tile = tile_at(s, 2 + i / s->columns, i % s->columns);
            if (!draw_frame(s, &skinned, &proxy, &camera, tile)) {
                status = pci_fail_memory(s->context, stage);
            }
            char name[64], detail[64];
            snprintf(name, sizeof(name), "skinned, frame %zu", frame + 1);
            snprintf(detail, sizeof(detail), "%.2f s", a->motion.frame_time * (double)(frame + 1));
            write_caption(s, tile, name, detail);
        }
        aim(s, &camera, extent);
    }

cleanup:
    pci_scratch_end(&scratch);
    return status;
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
    memset(s.image.pixels, 0xff, 3 * s.image.width * s.image.height);
    write_title(&s);
    status = draw_exhibits(&s);
    if (status == PC_OK && s.frame_count > 0) {
        status = draw_frames(&s);
    }
    if (status == PC_OK) {
        status = pci_write_png(context, stage, &s.image, path);
    }

cleanup:
    pci_scratch_end(&scratch);
    return status;
}
