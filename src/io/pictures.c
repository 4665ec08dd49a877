#include "io/pictures.h"

#include <stdio.h>

#include "geometry/rotation.h"
#include "geometry/topology.h"
#include "io/lettering.h"

#define AZIMUTH   0.44 // radians to the side of the front: a three-quarter view
#define ELEVATION 0.21 // radians above the horizon
#define FILL      0.94 // share of a tile's side that the larger extent takes

// ---- cameras ------------------------------------------------------------------------------------

pci_camera pci_three_quarter_view(uint32_t up_axis, double turn) {
    static const double ups[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    static const double fronts[3][3] = {{0, 0, 1}, {0, 0, 1}, {0, -1, 0}};
    const double *up = ups[up_axis], *front = fronts[up_axis];
    const double azimuth = AZIMUTH + turn;
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

void pci_extend_view(const pci_camera *camera, const pc_mesh *mesh, double extent[4]) {
    for (size_t i = 0; i < 3 * mesh->triangle_count; ++i) {
        const double *p = &mesh->positions[3 * (size_t)mesh->triangles[i]];
        const double x = pci_dot(p, camera->right), y = pci_dot(p, camera->up);
        extent[0] = x < extent[0] ? x : extent[0], extent[1] = x > extent[1] ? x : extent[1];
        extent[2] = y < extent[2] ? y : extent[2], extent[3] = y > extent[3] ? y : extent[3];
    }
}

void pci_aim_camera(pci_camera *camera, const double extent[4], size_t tile) {
    const double size = fmax(extent[1] - extent[0], extent[3] - extent[2]);
    camera->centre[0] = 0.5 * (extent[0] + extent[1]);
    camera->centre[1] = 0.5 * (extent[2] + extent[3]);
    camera->scale = size > 0.0 ? FILL * (double)tile / size : 1.0;
}

uint32_t pci_up_axis_of(const pc_asset *asset) {
    const pc_options defaults = pc_default_options();
    const bool known = asset->stage_count > PC_STAGE_SIMULATE;
    const uint32_t axis = known ? asset->options.simulate.up_axis : defaults.simulate.up_axis;
    return axis < 3 ? axis : 1;
}

// ---- the garment in motion ----------------------------------------------------------------------

pc_status pci_show_frames(pc_context *context, const char *stage, const pc_asset *asset,
                          size_t count, size_t tile, pci_frame_painter *paint, void *user) {
    const pc_motion *motion = &asset->motion;
    pci_scratch scratch = pci_scratch_begin(context);
    double *rotations, extent[4] = {INFINITY, -INFINITY, INFINITY, -INFINITY};
    pci_shown_frame shown = {.skinned = asset->visual.surface,
                             .proxy = asset->proxy,
                             .camera = pci_three_quarter_view(pci_up_axis_of(asset), 0.0)};
    shown.skinned.positions = PCI_SCRATCH(&scratch, double, 3 * shown.skinned.vertex_count);
    pc_status status =
        scratch.failed
            ? pci_fail_memory(context, stage)
            : pci_rotations_of_motion(&scratch, stage, &asset->proxy, motion,
                                      asset->skin.skinning == PC_SKINNING_ROTATION, &rotations);
    for (size_t pass = 0; pass < 2; ++pass) { // the camera, then the pictures
        for (size_t i = 0; i < count && status == PC_OK; ++i) {
            shown.picture = i;
            shown.frame = ((i + 1) * motion->frame_count + count - 1) / count - 1;
            shown.proxy.positions = &motion->positions[3 * shown.frame * motion->vertex_count];
            pc_skin_deform(&asset->skin, asset->visual.surface.positions, asset->proxy.positions,
                           shown.proxy.positions, pci_rotations_at(rotations, motion, shown.frame),
                           shown.skinned.positions);
            if (pass == 0) {
                pci_extend_view(&shown.camera, &shown.skinned, extent);
            } else {
                status = paint(user, &shown);
            }
        }
        pci_aim_camera(&shown.camera, extent, tile);
    }
    pci_scratch_end(&scratch);
    return status;
}

// ---- bones --------------------------------------------------------------------------------------

enum { HUES = 8, PALETTE = 2 * HUES };

// Eight hues, strong and dark.
static void palette_color(size_t i, float color[3]) {
    const double hue = 6.0 * (double)(i % HUES) / HUES, value = i < HUES ? 0.80 : 0.36;
    for (size_t k = 0; k < 3; ++k) {
        const double from_peak = fabs(fmod(hue + 6.0 - 2.0 * (double)k, 6.0) - 3.0);
        const double share = fmin(fmax(from_peak - 1.0, 0.0), 1.0); // 1 opposite of the dip
        color[k] = (float)(value * (0.05 + 0.95 * share * share));
    }
}

static double color_distance(const float a[3], const float b[3]) {
    double sum = 0.0;
    for (size_t k = 0; k < 3; ++k) {
        const double difference = sqrt((double)a[k]) - sqrt((double)b[k]);
        sum += difference * difference;
    }
    return sqrt(sum);
}

typedef struct choice {
    double nearest[PALETTE]; // distance to the most similar colour around
    size_t uses[PALETTE];
} choice;

static void avoid(choice *c, const float *color, double weight) {
    for (size_t i = 0; i < PALETTE; ++i) {
        float candidate[3];
        palette_color(i, candidate);
        c->nearest[i] = fmin(c->nearest[i], weight * color_distance(color, candidate));
    }
}

float *pci_bone_colors(pci_scratch *scratch, const pc_mesh *proxy) {
    pci_topology topology;
    float *colors = PCI_SCRATCH(scratch, float, 3 * proxy->vertex_count);
    if (scratch->failed || !pci_topology_build(scratch, proxy, &topology)) {
        return NULL;
    }
    choice c = {.uses = {0}};
    for (size_t v = 0; v < proxy->vertex_count; ++v) {
        for (size_t i = 0; i < PALETTE; ++i) {
            c.nearest[i] = 10.0;
        }
        for (size_t e = topology.ring_offsets[v]; e < topology.ring_offsets[v + 1]; ++e) {
            const uint32_t near = topology.ring[e];
            if (near < v) {
                avoid(&c, &colors[3 * (size_t)near], 1.0);
            }
            for (size_t f = topology.ring_offsets[near]; f < topology.ring_offsets[near + 1]; ++f) {
                if (topology.ring[f] < v) {
                    avoid(&c, &colors[3 * (size_t)topology.ring[f]], 2.0);
                }
            }
        }
        // Alike is enough: of the colours that differ well, the one that is used least.
        size_t best = 0;
        for (size_t i = 1; i < PALETTE; ++i) {
            const double gain = fmin(c.nearest[i], 0.6) - fmin(c.nearest[best], 0.6);
            best = gain > 0.0 || (gain == 0.0 && c.uses[i] < c.uses[best]) ? i : best;
        }
        ++c.uses[best];
        palette_color(best, &colors[3 * v]);
    }
    return colors;
}

void pci_weight_colors(const pc_skin *skin, const float *bone_colors, float *out) {
    for (size_t v = 0; v < skin->vertex_count; ++v) {
        double color[3] = {0.0}, squares = 0.0, sum = 0.0;
        for (size_t k = v * skin->influences; k < (v + 1) * skin->influences; ++k) {
            const double square = skin->weights[k] * skin->weights[k], share = square * square;
            for (size_t i = 0; i < 3; ++i) {
                color[i] += share * (double)bone_colors[3 * (size_t)skin->bones[k] + i];
            }
            squares += square;
            sum += share;
        }
        const double impact = sqrt(squares); // 1: a single bone
        for (size_t i = 0; i < 3; ++i) {
            out[3 * v + i] = (float)(impact * color[i] / sum + (1.0 - impact) * 0.85);
        }
    }
}

// ---- stretch -----------------------------------------------------------------------------------

void pci_stretch_color(double stretch, float color[3]) {
    static const double stops[4][3] = {
        {0.46, 0.46, 0.47}, {0.85, 0.60, 0.06}, {0.75, 0.03, 0.02}, {0.16, 0.0, 0.22}};
    const double place = 3.0 * fmin(fmax(stretch / PCI_LARGEST_STRETCH, 0.0), 1.0);
    const size_t stop = place < 2.0 ? (size_t)place : 2;
    const double share = place - (double)stop;
    for (size_t k = 0; k < 3; ++k) {
        color[k] = (float)((1.0 - share) * stops[stop][k] + share * stops[stop + 1][k]);
    }
}

// Principal stretches of a triangle, from the edge vectors' dot products before and after; false
// for one without area at rest. The strain of an edge aa' in the plane is a quadratic form.
static bool triangle_stretch(const pc_mesh *rest, const double *posed, size_t triangle,
                             double *largest) {
    const uint32_t *corner = &rest->triangles[3 * triangle];
    double dots[2][3];
    for (size_t side = 0; side < 2; ++side) {
        const double *positions = side == 0 ? rest->positions : posed;
        double a[3], b[3];
        pci_sub(&positions[3 * (size_t)corner[1]], &positions[3 * (size_t)corner[0]], a);
        pci_sub(&positions[3 * (size_t)corner[2]], &positions[3 * (size_t)corner[0]], b);
        dots[side][0] = pci_dot(a, a), dots[side][1] = pci_dot(a, b), dots[side][2] = pci_dot(b, b);
    }
    // Eigenvalues of (rest Gram matrix)^-1 (posed Gram matrix): squared stretches.
    const double *g = dots[0], *h = dots[1];
    const double det = g[0] * g[2] - g[1] * g[1];
    if (!(det > 1e-12 * g[0] * g[2])) {
        return false;
    }
    const double half = 0.5 * (g[2] * h[0] - 2.0 * g[1] * h[1] + g[0] * h[2]) / det;
    const double product = (h[0] * h[2] - h[1] * h[1]) / det;
    const double root = sqrt(fmax(half * half - product, 0.0));
    *largest = fmax(fabs(sqrt(half + root) - 1.0), fabs(sqrt(fmax(half - root, 0.0)) - 1.0));
    return true;
}

bool pci_stretch_colors(pci_scratch *scratch, const pc_mesh *rest, const double *posed,
                        double *values, float *out) {
    double *areas = PCI_SCRATCH(scratch, double, rest->vertex_count);
    if (areas == NULL) {
        return false;
    }
    memset(values, 0, rest->vertex_count * sizeof(*values));
    for (size_t t = 0; t < rest->triangle_count; ++t) {
        double stretch;
        if (triangle_stretch(rest, posed, t, &stretch)) {
            const double area = pci_triangle_area(rest, t);
            for (size_t c = 0; c < 3; ++c) {
                const size_t v = rest->triangles[3 * t + c];
                values[v] += area * stretch;
                areas[v] += area;
            }
        }
    }
    for (size_t v = 0; v < rest->vertex_count; ++v) {
        values[v] = areas[v] > 0.0 ? values[v] / areas[v] : 0.0;
        pci_stretch_color(values[v], &out[3 * v]);
    }
    return true;
}

static uint8_t srgb(float linear) {
    const double x = (double)linear;
    return (uint8_t)(255.0 * (x <= 0.0031308 ? 12.92 * x : 1.055 * pow(x, 1.0 / 2.4) - 0.055) +
                     0.5);
}

double pci_draw_stretch_legend(pci_image *image, double x, double baseline, double height) {
    static const uint8_t text_color[3] = {128, 134, 142};
    char end[32];
    snprintf(end, sizeof(end), "%.0f %%", 100.0 * PCI_LARGEST_STRETCH);
    const double bar = 10.0 * height, gap = 0.6 * height;
    const double first = pci_text_width("stretch 0", height);
    if (image != NULL) {
        pci_draw_text(image, x, baseline, height, text_color, "stretch 0");
        pci_draw_text(image, x + first + bar + 2.0 * gap, baseline, height, text_color, end);
        const size_t left = (size_t)(x + first + gap), width = (size_t)bar;
        const size_t top = (size_t)(baseline - height), rows = (size_t)height + 1;
        for (size_t row = top; row < top + rows && row < image->height; ++row) {
            for (size_t i = 0; i < width && left + i < image->width; ++i) {
                float color[3];
                pci_stretch_color(PCI_LARGEST_STRETCH * ((double)i + 0.5) / (double)width, color);
                uint8_t *pixel = &image->pixels[3 * (row * image->width + left + i)];
                pixel[0] = srgb(color[0]), pixel[1] = srgb(color[1]), pixel[2] = srgb(color[2]);
            }
        }
    }
    return first + bar + 2.0 * gap + pci_text_width(end, height);
}
