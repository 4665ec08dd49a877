// A finished asset without running the pipeline: a tube of cloth with a seam, two materials and a
// degenerate triangle, a coarse tube as its proxy, a made-up motion, and plausible results of every
// stage in between. What tests of files need.
#ifndef TEST_SUPPORT_ASSET_FIXTURE_H
#define TEST_SUPPORT_ASSET_FIXTURE_H

#include <stdio.h>

#include "support/test.h"

enum { FIXTURE_FRAMES = 5, FIXTURE_STRAY_CORNERS = 1 };

static inline void *fixture_copy(pc_context *context, const void *data, size_t size) {
    void *copy = pci_allocate(context, size, 1);
    assert_non_null(copy);
    memcpy(copy, data, size);
    return copy;
}

// An open tube: `rings` rings of `sectors` vertices, slightly conical.
static inline void fixture_tube(pc_context *context, size_t rings, size_t sectors, double radius,
                                size_t spare_triangles, pc_mesh *mesh) {
    mesh->vertex_count = rings * sectors;
    mesh->triangle_count = 2 * (rings - 1) * sectors + spare_triangles;
    mesh->positions = PCI_ALLOCATE(context, double, 3 * mesh->vertex_count);
    mesh->triangles = PCI_ALLOCATE(context, uint32_t, 3 * mesh->triangle_count);
    assert_non_null(mesh->positions);
    assert_non_null(mesh->triangles);
    uint32_t *corner = mesh->triangles;
    for (size_t r = 0; r < rings; ++r) {
        const double height = (double)r / (double)(rings - 1);
        for (size_t s = 0; s < sectors; ++s) {
            const double angle = 6.283185307179586 * (double)s / (double)sectors;
            double *p = &mesh->positions[3 * (r * sectors + s)];
            p[0] = radius * (1.0 + 0.1 * height) * cos(angle);
            p[1] = 0.7 + height;
            p[2] = -radius * (1.0 + 0.1 * height) * sin(angle);
            if (r + 1 < rings) {
                const uint32_t a = (uint32_t)(r * sectors + s);
                const uint32_t b = (uint32_t)(r * sectors + (s + 1) % sectors);
                const uint32_t c = a + (uint32_t)sectors, d = b + (uint32_t)sectors;
                const uint32_t two[6] = {a, b, d, a, d, c};
                memcpy(corner, two, sizeof(two));
                corner += 6;
            }
        }
    }
}

static inline void fixture_visual(pc_context *context, size_t rings, pc_visual *visual) {
    enum { SECTORS = 12, COLUMNS = SECTORS + 1 };
    fixture_tube(context, rings, SECTORS, 0.3, 1, &visual->surface);
    // The last triangle has no area; its corners follow those of the first.
    const size_t triangles = visual->surface.triangle_count;
    uint32_t *last = &visual->surface.triangles[3 * (triangles - 1)];
    last[0] = last[1] = 0, last[2] = 1;
    const size_t corners = rings * COLUMNS + FIXTURE_STRAY_CORNERS;
    visual->corner_count = corners;
    visual->corner_vertices = PCI_ALLOCATE(context, uint32_t, corners);
    visual->corner_triangles = PCI_ALLOCATE(context, uint32_t, 3 * triangles);
    visual->normals = PCI_ALLOCATE(context, float, 3 * corners);
    visual->texcoords = PCI_ALLOCATE(context, float, 2 * corners);
    visual->colors = PCI_ALLOCATE(context, float, 4 * corners);
    visual->triangle_materials = PCI_ALLOCATE(context, uint32_t, triangles);
    for (size_t c = 0; c < corners; ++c) {
        const size_t ring = c / COLUMNS % rings, column = c % COLUMNS;
        const uint32_t vertex = (uint32_t)(ring * SECTORS + column % SECTORS);
        const double *p = &visual->surface.positions[3 * vertex];
        const double length = sqrt(p[0] * p[0] + p[2] * p[2]);
        visual->corner_vertices[c] = vertex;
        visual->normals[3 * c] = (float)(p[0] / length);
        visual->normals[3 * c + 2] = (float)(p[2] / length);
        visual->texcoords[2 * c] = (float)column / SECTORS;
        visual->texcoords[2 * c + 1] = (float)ring / (float)rings;
        for (size_t k = 0; k < 4; ++k) {
            visual->colors[4 * c + k] = (float)(k + 1) / 8.0f + 0.3f * (float)ring / (float)rings;
        }
    }
    for (size_t t = 0; t < triangles; ++t) {
        const size_t quad = t / 2, ring = quad / SECTORS, column = quad % SECTORS;
        const uint32_t a = (uint32_t)(ring * COLUMNS + column), c = a + COLUMNS;
        const uint32_t corner[2][3] = {{a, a + 1, c + 1}, {a, c + 1, c}};
        memcpy(&visual->corner_triangles[3 * t], corner[t % 2], sizeof(corner[0]));
        visual->triangle_materials[t] = ring < 3 ? 0 : 2;
    }
    uint32_t *corner = &visual->corner_triangles[3 * (triangles - 1)];
    corner[0] = corner[1] = 0, corner[2] = 1;
    // The second material is not used.
    static const pc_material materials[3] = {
        {"hem \xc3\xa9", {0.5f, 0.25f, 0.125f, 1.0f}, 0.0f, 0.9f, true},
        {"unused", {1.0f, 1.0f, 1.0f, 1.0f}, 1.0f, 0.1f, false},
        {"body", {0.1f, 0.2f, 0.3f, 0.4f}, 0.3f, 0.7f, false}};
    visual->material_count = 3;
    visual->materials = fixture_copy(context, materials, sizeof(materials));
}

static inline void fixture_grid(pc_context *context, pc_grid *grid) {
    static const uint64_t samples[] = {0, 3, 4, 17, 59};
    static const float values[] = {0.25f, 0.1f, 0.0f, 1.5f, 0.75f};
    grid->origin[0] = -1.1, grid->origin[1] = 0.2, grid->origin[2] = 1e-17;
    grid->cell_size = 0.1;
    grid->size[0] = 3, grid->size[1] = 4, grid->size[2] = 5;
    grid->band = 0.3;
    grid->sample_count = 5;
    grid->samples = fixture_copy(context, samples, sizeof(samples));
    grid->values = fixture_copy(context, values, sizeof(values));
}

// A tetrahedron stands for the closed meshes.
static inline void fixture_closed(pc_context *context, double scale, pc_mesh *mesh) {
    static const double positions[] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1};
    static const uint32_t triangles[] = {0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3};
    mesh->vertex_count = mesh->triangle_count = 4;
    mesh->positions = fixture_copy(context, positions, sizeof(positions));
    mesh->triangles = fixture_copy(context, triangles, sizeof(triangles));
    for (size_t i = 0; i < 12; ++i) {
        mesh->positions[i] = mesh->positions[i] * scale + 0.1;
    }
}

static inline void fixture_graph(pc_context *context, pc_graph *graph) {
    static const double curvatures[] = {0.0, 0.1, 2.0, 1e-3};
    static const double outer_distances[] = {0.5, (double)INFINITY, 0.25, (double)INFINITY};
    static const uint32_t edges[] = {0, 1, 0, 2, 0, 3, 1, 2, 1, 3, 2, 3};
    static const double edge_weights[] = {1.0, 0.9, 0.8, 0.0, 0.3, 1.0 / 3.0};
    static const uint32_t opposites[] = {0, 3, 1, 2, 2, 3};
    static const int8_t opposite_signs[] = {-1, 1, 0};
    graph->vertex_count = 4;
    graph->curvatures = fixture_copy(context, curvatures, sizeof(curvatures));
    graph->outer_distances = fixture_copy(context, outer_distances, sizeof(outer_distances));
    graph->edge_count = 6;
    graph->edges = fixture_copy(context, edges, sizeof(edges));
    graph->edge_weights = fixture_copy(context, edge_weights, sizeof(edge_weights));
    graph->opposite_count = 3;
    graph->opposites = fixture_copy(context, opposites, sizeof(opposites));
    graph->opposite_signs = fixture_copy(context, opposite_signs, sizeof(opposite_signs));
}

static inline void fixture_motion(pc_context *context, const pc_mesh *proxy, pc_motion *motion) {
    const size_t vertices = proxy->vertex_count;
    motion->frame_count = FIXTURE_FRAMES;
    motion->vertex_count = vertices;
    motion->frame_time = 1.0 / 30.0;
    motion->positions = PCI_ALLOCATE(context, double, FIXTURE_FRAMES *vertices * 3);
    motion->pinned = PCI_ALLOCATE(context, uint8_t, vertices);
    for (size_t v = 0; v < vertices; ++v) {
        const double *rest = &proxy->positions[3 * v];
        motion->pinned[v] = rest[1] > 1.69;
        for (size_t f = 0; f < FIXTURE_FRAMES; ++f) {
            const double swing = motion->pinned[v] ? 0.0 : 0.1 * (double)(f + 1);
            double *p = &motion->positions[3 * (f * vertices + v)];
            p[0] = rest[0] + swing * sin(3.0 * rest[1]);
            p[1] = rest[1] - 0.3 * swing * rest[0];
            p[2] = rest[2] + swing * cos(2.0 * rest[0] + rest[1]);
        }
    }
}

// The nearest proxy vertices, weighted by inverse distance; every seventh vertex has a single one.
static inline void fixture_skin(pc_context *context, const pc_mesh *surface, const pc_mesh *proxy,
                                uint32_t influences, pc_skin *skin) {
    skin->vertex_count = surface->vertex_count;
    skin->influences = influences;
    skin->bones = PCI_ALLOCATE(context, uint32_t, skin->vertex_count * influences);
    skin->weights = PCI_ALLOCATE(context, double, skin->vertex_count *influences);
    for (size_t v = 0; v < skin->vertex_count; ++v) {
        uint32_t *bones = &skin->bones[v * influences];
        double *weights = &skin->weights[v * influences];
        double sum = 0.0, previous = -1.0;
        for (uint32_t k = 0; k < influences; ++k) {
            uint32_t best = 0;
            double nearest = (double)INFINITY;
            for (uint32_t p = 0; p < proxy->vertex_count; ++p) {
                // The index separates equal distances.
                const double distance = 1e-9 * p + pci_squared_distance(&surface->positions[3 * v],
                                                                        &proxy->positions[3 * p]);
                if (distance > previous && distance < nearest) {
                    nearest = distance;
                    best = p;
                }
            }
            previous = nearest;
            const bool used = k == 0 || v % 7 != 0;
            bones[k] = used ? best : bones[0];
            weights[k] = used ? 1.0 / (0.01 + sqrt(nearest)) : 0.0;
            sum += weights[k];
        }
        for (uint32_t k = 0; k < influences; ++k) {
            weights[k] /= sum;
        }
    }
}

// Different values in every field.
static inline void fixture_record(const pc_record *record, bool option, size_t salt, void *values) {
    for (size_t i = 0; i < record->field_count; ++i) {
        const pc_field *field = &record->fields[i];
        double number = (double)(i + salt) + (field->type == PC_FIELD_DOUBLE ? 0.1 : 0.0);
        if (field->type == PC_FIELD_BOOL || field->type == PC_FIELD_CHOICE) {
            number = 1.0;
        } else if (option) {
            number = field->minimum + (field->default_value - field->minimum) / 3.0;
            number = field->type == PC_FIELD_DOUBLE ? number : floor(number);
        }
        pc_field_set_number(field, values, number);
    }
}

// Everything, with `influences` per visual vertex. Release with pc_asset_free.
static inline void fixture_asset(pc_context *context, uint32_t influences, pc_asset *asset) {
    memset(asset, 0, sizeof(*asset));
    snprintf(asset->name, sizeof(asset->name), "tube \xc3\xbc");
    asset->stage_count = PC_STAGE_COUNT;
    fixture_visual(context, 9, &asset->visual);
    fixture_grid(context, &asset->grid);
    fixture_closed(context, 1.2, &asset->isosurface);
    fixture_closed(context, 1.0, &asset->projected);
    fixture_graph(context, &asset->graph);
    static const uint8_t labels[] = {1, 0, 1, 1};
    asset->labels.vertex_count = 4;
    asset->labels.labels = fixture_copy(context, labels, sizeof(labels));
    fixture_tube(context, 6, 8, 0.31, 0, &asset->single_layer);
    fixture_tube(context, 4, 6, 0.32, 0, &asset->proxy);
    fixture_motion(context, &asset->proxy, &asset->motion);
    fixture_skin(context, &asset->visual.surface, &asset->proxy, influences, &asset->skin);
    fixture_record(&pc_visual_report_record, false, 3, &asset->reports.visual);
    for (pc_stage stage = 0; stage < PC_STAGE_COUNT; ++stage) {
        const pc_stage_info *info = pc_stage_describe(stage);
        fixture_record(info->options, true, stage, (char *)&asset->options + info->options_offset);
        fixture_record(info->report, false, 10u * (size_t)stage,
                       (char *)&asset->reports + info->report_offset);
    }
    // There is no character.
    asset->options.skin.body_blend = 0.0;
    asset->options.skin.body_channel = PC_BODY_CHANNEL_NONE;
}

#endif
