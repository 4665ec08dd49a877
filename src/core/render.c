#include "core/render.h"

#include "core/topology.h"

#define SAMPLES         3 // per pixel and axis
#define BAND_ROWS       8 // pixels, work of one piece
#define LAMPS           48
#define SHADOW_SIDE     144 // texels of a lamp's depth map
#define SHADOW_TEXELS   ((size_t)LAMPS * SHADOW_SIDE * SHADOW_SIDE)
#define CREASE_COSINE   0.6427F // of 50 degrees
#define EDGE_WIDTH      1.15    // pixels at a tile of 360
#define BORDER_WIDTH    3.2
#define OVERLAY_OPACITY 0.5F
// Back sides count as this much farther away, in radii of the model: where the two sheets of a
// projected mesh lie on each other, the front is drawn.
#define BACK_OFFSET 0.006

static const float front_albedo[3] = {0.46F, 0.46F, 0.47F};
static const float back_albedo[3] = {0.13F, 0.28F, 0.62F};
static const float edge_color[3] = {0.012F, 0.014F, 0.02F};

// ---- triangles to samples ---------------------------------------------------------------------

typedef struct canvas {
    size_t width;
    size_t first_row, row_count;
    float *depths;       // larger is nearer
    uint32_t *triangles; // may be NULL
} canvas;

static inline double smaller(double a, double b) { return a < b ? a : b; }
static inline double larger(double a, double b) { return a > b ? a : b; }

// First sample whose middle is beyond x, within limits.
static inline size_t first_sample(double x, size_t lowest, size_t highest) {
    const double sample = x + 0.5;
    return !(sample > (double)lowest)    ? lowest
           : !(sample < (double)highest) ? highest
                                         : (size_t)sample;
}

// Where the edge from `a` up to `b` passes height y. Both triangles at an edge compute the same.
static double edge_at(const double *a, const double *b, double y) {
    return a[0] + (b[0] - a[0]) * ((y - a[1]) / (b[1] - a[1]));
}

// Corners are x, y, depth in samples.
static void rasterize(canvas *target, const double *a, const double *b, const double *c,
                      uint32_t triangle) {
    // Corners from the smallest to the largest y; most triangles of a fine mesh miss all samples.
    const double *low = a, *middle = b, *high = c, *swap;
    if (middle[1] < low[1]) {
        swap = low, low = middle, middle = swap;
    }
    if (high[1] < middle[1]) {
        swap = middle, middle = high, high = swap;
    }
    if (middle[1] < low[1]) {
        swap = low, low = middle, middle = swap;
    }
    const size_t last_row = target->first_row + target->row_count;
    const size_t first_row = first_sample(low[1], target->first_row, last_row);
    const size_t end_row = first_sample(high[1], target->first_row, last_row);
    const double det = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
    if (first_row == end_row || !(fabs(det) > 0.0) || !isfinite(det)) {
        return;
    }
    const double by_x = ((b[2] - a[2]) * (c[1] - a[1]) - (c[2] - a[2]) * (b[1] - a[1])) / det;
    const double by_y = ((c[2] - a[2]) * (b[0] - a[0]) - (b[2] - a[2]) * (c[0] - a[0])) / det;
    for (size_t row = first_row; row < end_row; ++row) {
        const double y = (double)row + 0.5;
        const double x0 = edge_at(low, high, y);
        const double x1 = y < middle[1] ? edge_at(low, middle, y) : edge_at(middle, high, y);
        const size_t begin = first_sample(smaller(x0, x1), 0, target->width);
        const size_t end = first_sample(larger(x0, x1), 0, target->width);
        const size_t offset = (row - target->first_row) * target->width;
        double depth = a[2] + by_y * (y - a[1]) + by_x * ((double)begin + 0.5 - a[0]);
        for (size_t column = begin; column < end; ++column, depth += by_x) {
            if ((float)depth > target->depths[offset + column]) {
                target->depths[offset + column] = (float)depth;
                if (target->triangles != NULL) {
                    target->triangles[offset + column] = triangle;
                }
            }
        }
    }
}

static const double *corner_position(const pc_mesh *mesh, size_t triangle, size_t corner) {
    return &mesh->positions[3 * (size_t)mesh->triangles[3 * triangle + corner]];
}

// ---- lamps ------------------------------------------------------------------------------------

// Unit vector to the lamp, and axes of its depth map scaled from radii of the model to texels.
typedef struct lamp {
    float direction[3];
    float axes[3][3];
} lamp;

// Evenly spread over the sphere: steps of the golden angle on rings of equal area.
static lamp lamp_at(size_t i) {
    const double height = 1.0 - 2.0 * ((double)i + 0.5) / LAMPS;
    const double radius = sqrt(1.0 - height * height), angle = 2.399963229728653 * (double)i;
    const double direction[3] = {radius * cos(angle), height, radius * sin(angle)};
    const double helper[3] = {fabs(height) < 0.8 ? 0.0 : 1.0, fabs(height) < 0.8 ? 1.0 : 0.0, 0.0};
    double across[3], along[3];
    pci_cross(helper, direction, across);
    pci_normalize(across);
    pci_cross(direction, across, along);
    lamp result;
    for (size_t k = 0; k < 3; ++k) {
        result.direction[k] = (float)direction[k];
        result.axes[0][k] = (float)(0.5 * SHADOW_SIDE * across[k]);
        result.axes[1][k] = (float)(0.5 * SHADOW_SIDE * along[k]);
        result.axes[2][k] = (float)(0.5 * SHADOW_SIDE * direction[k]);
    }
    return result;
}

static inline float dot(const float a[3], const float b[3]) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

// Column, row and depth, all from 0 to SHADOW_SIDE, of a point inside the model's unit sphere.
static inline void to_lamp(const lamp *at, const float point[3], float out[3]) {
    for (size_t k = 0; k < 3; ++k) {
        out[k] = 0.5F * SHADOW_SIDE + dot(point, at->axes[k]);
    }
}

typedef struct shadow_job {
    const pci_model *model;
    double *corners; // #workers by #V by 3, vertices seen from the lamp
} shadow_job;

static void cast_shadows(void *user, size_t begin, size_t end, uint32_t worker) {
    const shadow_job *job = user;
    const pc_mesh *mesh = job->model->mesh;
    double *corners = &job->corners[3 * mesh->vertex_count * worker];
    for (size_t i = begin; i < end; ++i) {
        const lamp at = lamp_at(i);
        for (size_t v = 0; v < mesh->vertex_count; ++v) {
            float mapped[3];
            to_lamp(&at, &job->model->points[3 * v], mapped);
            for (size_t k = 0; k < 3; ++k) {
                corners[3 * v + k] = (double)mapped[k];
            }
        }
        canvas target = {.width = SHADOW_SIDE, .row_count = SHADOW_SIDE};
        target.depths = &job->model->shadows[i * SHADOW_SIDE * SHADOW_SIDE];
        for (size_t t = 0; t < mesh->triangle_count; ++t) {
            const uint32_t *v = &mesh->triangles[3 * t];
            rasterize(&target, &corners[3 * (size_t)v[0]], &corners[3 * (size_t)v[1]],
                      &corners[3 * (size_t)v[2]], 0);
        }
    }
}

// Share of the four texels around a point that no surface hides from the lamp, bilinear.
static inline float visibility(const float *depths, const float mapped[3]) {
    float place[2];
    for (size_t k = 0; k < 2; ++k) {
        const float texel = mapped[k] - 0.5F, last = SHADOW_SIDE - 1.001F;
        place[k] = !(texel > 0.0F) ? 0.0F : texel > last ? last : texel;
    }
    const size_t column = (size_t)place[0], row = (size_t)place[1];
    const float u = place[0] - (float)column, v = place[1] - (float)row;
    const float *at = &depths[row * SHADOW_SIDE + column];
    const float lit[4] = {(float)(at[0] <= mapped[2]), (float)(at[1] <= mapped[2]),
                          (float)(at[SHADOW_SIDE] <= mapped[2]),
                          (float)(at[SHADOW_SIDE + 1] <= mapped[2])};
    return (lit[0] * (1.0F - u) + lit[1] * u) * (1.0F - v) + (lit[2] * (1.0F - u) + lit[3] * u) * v;
}

// ---- model ------------------------------------------------------------------------------------

typedef struct normal_job {
    const pc_mesh *mesh;
    const pci_topology *topology;
    const double *areas; // #F by 3, area vectors
    bool smooth;
    float *normals;
} normal_job;

static void compute_normals(void *user, size_t begin, size_t end, uint32_t worker) {
    const normal_job *job = user;
    (void)worker;
    for (size_t t = begin; t < end; ++t) {
        const double *own = &job->areas[3 * t];
        const double own_length = pci_norm(own);
        for (size_t c = 0; c < 3; ++c) {
            const uint32_t v = job->mesh->triangles[3 * t + c];
            double sum[3] = {own[0], own[1], own[2]};
            const size_t first = job->topology->vertex_triangle_offsets[v];
            const size_t last = job->topology->vertex_triangle_offsets[v + 1];
            for (size_t k = first; k < last && job->smooth; ++k) {
                // Neighbours of the other winding count with their normal turned over.
                const uint32_t other = job->topology->vertex_triangles[k];
                const double *area = &job->areas[3 * (size_t)other];
                const double cosine = pci_dot(own, area);
                if (other != t &&
                    fabs(cosine) > (double)CREASE_COSINE * own_length * pci_norm(area)) {
                    const double sign = cosine < 0.0 ? -1.0 : 1.0;
                    sum[0] += sign * area[0], sum[1] += sign * area[1], sum[2] += sign * area[2];
                }
            }
            pci_normalize(sum);
            for (size_t k = 0; k < 3; ++k) {
                job->normals[9 * t + 3 * c + k] = (float)sum[k];
            }
        }
    }
}

bool pci_model_build(pc_context *context, pci_scratch *scratch, const pc_mesh *mesh, pci_look look,
                     pci_model *model) {
    const size_t count = mesh->triangle_count;
    pci_topology topology;
    memset(model, 0, sizeof(*model));
    model->mesh = mesh;
    model->normals = PCI_SCRATCH(scratch, float, 9 * count);
    model->borders = PCI_SCRATCH(scratch, uint8_t, count);
    model->points = PCI_SCRATCH(scratch, float, 3 * mesh->vertex_count);
    shadow_job shadow = {.model = model};
    if (look != PCI_LOOK_UNLIT) { // nothing is at depth 0, the far end
        const size_t workers = pc_context_threads(context);
        shadow.corners = PCI_SCRATCH(scratch, double, 3 * mesh->vertex_count * workers);
        model->shadows = PCI_SCRATCH(scratch, float, SHADOW_TEXELS);
    }
    double *areas = PCI_SCRATCH(scratch, double, 3 * count);
    if (scratch->failed || !pci_topology_build(scratch, mesh, &topology)) {
        return false;
    }
    double minimum[3], maximum[3];
    pci_bounding_box(mesh, minimum, maximum);
    model->radius = 0.5 * sqrt(pci_squared_distance(minimum, maximum));
    model->radius = model->radius > 0.0 ? model->radius : 1.0;
    for (size_t k = 0; k < 3; ++k) {
        model->centre[k] = 0.5 * (minimum[k] + maximum[k]);
    }
    for (size_t i = 0; i < 3 * mesh->vertex_count; ++i) {
        model->points[i] = (float)((mesh->positions[i] - model->centre[i % 3]) / model->radius);
    }
    for (size_t t = 0; t < count; ++t) {
        double ab[3], ac[3];
        pci_sub(corner_position(mesh, t, 1), corner_position(mesh, t, 0), ab);
        pci_sub(corner_position(mesh, t, 2), corner_position(mesh, t, 0), ac);
        pci_cross(ab, ac, &areas[3 * t]);
        for (size_t c = 0; c < 3; ++c) {
            const uint32_t e = topology.triangle_edges[3 * t + c];
            const bool border =
                e != PC_INVALID_INDEX &&
                topology.edge_triangle_offsets[e + 1] - topology.edge_triangle_offsets[e] == 1;
            model->borders[t] |= (uint8_t)((border ? 1U : 0U) << c);
        }
    }
    normal_job job = {mesh, &topology, areas, look == PCI_LOOK_SMOOTH, model->normals};
    pci_parallel_for(context, count, 1024, compute_normals, &job);
    if (look != PCI_LOOK_UNLIT) {
        pci_parallel_for(context, LAMPS, 1, cast_shadows, &shadow);
    }
    return true;
}

// ---- drawing ----------------------------------------------------------------------------------

typedef struct drawing {
    const pci_model *model;
    const pci_camera *camera;
    pci_style style;
    pci_tile tile;
    pci_image *image;
    double *corners; // #V by 3, x, y, depth in samples
    lamp lamps[LAMPS];
    float intensities[LAMPS];             // as seen from this camera
    double edge_half_width, border_width; // samples
    float decoded[256];                   // sRGB to linear
    uint8_t encoded[4097];                // linear to sRGB
    float *depths;                        // per worker, one band
    uint32_t *triangles;
} drawing;

// A wide key light from the upper left behind the viewer, and a sky that is brighter above. An open
// surface that faces the viewer gets 1.
static void set_lamps(drawing *d) {
    const pci_camera *camera = d->camera;
    double key[3], total = 0.0;
    for (size_t k = 0; k < 3; ++k) {
        key[k] = camera->towards[k] * 0.62 + camera->up[k] * 0.62 - camera->right[k] * 0.48;
    }
    pci_normalize(key);
    for (size_t i = 0; i < LAMPS; ++i) {
        d->lamps[i] = lamp_at(i);
        const double direction[3] = {(double)d->lamps[i].direction[0],
                                     (double)d->lamps[i].direction[1],
                                     (double)d->lamps[i].direction[2]};
        const double lobe = fmax(pci_dot(direction, key), 0.0);
        const double sky = 0.5 + 0.5 * pci_dot(direction, camera->up);
        const double intensity = 0.2 + 0.3 * sky + 2.6 * lobe * lobe * lobe * lobe;
        d->intensities[i] = (float)intensity;
        total += intensity * fmax(pci_dot(direction, camera->towards), 0.0);
    }
    for (size_t i = 0; i < LAMPS; ++i) {
        d->intensities[i] /= (float)total;
    }
}

static void set_encoding(drawing *d) {
    for (size_t i = 0; i <= 4096; ++i) {
        const double linear = (double)i / 4096.0;
        const double value =
            linear <= 0.0031308 ? 12.92 * linear : 1.055 * pow(linear, 1.0 / 2.4) - 0.055;
        d->encoded[i] = (uint8_t)(255.0 * value + 0.5);
    }
    for (size_t i = 0; i < 256; ++i) {
        const double value = (double)i / 255.0;
        d->decoded[i] =
            (float)(value <= 0.04045 ? value / 12.92 : pow((value + 0.055) / 1.055, 2.4));
    }
}

static uint8_t encode(const drawing *d, float linear) {
    const float clamped = !(linear > 0.0F) ? 0.0F : linear > 1.0F ? 1.0F : linear;
    return d->encoded[(size_t)(clamped * 4096.0F + 0.5F)];
}

// What a sample sees of its triangle.
typedef struct surface_point {
    double weights[3];   // barycentric
    double distances[3]; // to the edge from corner c to c + 1, samples
    bool front;
} surface_point;

static surface_point locate(const drawing *d, uint32_t triangle, double x, double y) {
    const uint32_t *v = &d->model->mesh->triangles[3 * (size_t)triangle];
    surface_point p;
    double total = 0.0;
    for (size_t c = 0; c < 3; ++c) {
        const double *a = &d->corners[3 * (size_t)v[c]];
        const double *b = &d->corners[3 * (size_t)v[(c + 1) % 3]];
        const double across = (b[0] - a[0]) * (y - a[1]) - (x - a[0]) * (b[1] - a[1]);
        p.weights[(c + 2) % 3] = across;
        p.distances[c] = 0.0;
        total += across;
        if (d->style != PCI_STYLE_SURFACE) {
            const double length =
                sqrt((b[0] - a[0]) * (b[0] - a[0]) + (b[1] - a[1]) * (b[1] - a[1]));
            p.distances[c] = length > 0.0 ? fabs(across) / length : 0.0;
        }
    }
    p.front = total < 0.0; // y points down
    for (size_t c = 0; c < 3; ++c) {
        p.weights[c] = total != 0.0 ? p.weights[c] / total : 1.0 / 3.0;
    }
    return p;
}

static bool on_edge(const drawing *d, uint32_t triangle, const surface_point *p) {
    const unsigned borders = d->model->borders[triangle];
    for (size_t c = 0; c < 3; ++c) {
        if (p->distances[c] < (borders >> c & 1U ? d->border_width : d->edge_half_width)) {
            return true;
        }
    }
    return false;
}

static void color_at(const pci_model *model, uint32_t triangle, const surface_point *p,
                     float color[3]) {
    if (model->colors == NULL) {
        memcpy(color, p->front ? front_albedo : back_albedo, sizeof(front_albedo));
        return;
    }
    memset(color, 0, sizeof(front_albedo));
    for (size_t c = 0; c < 3; ++c) {
        const float *corner =
            &model->colors[3 * (size_t)model->mesh->triangles[3 * (size_t)triangle + c]];
        for (size_t k = 0; k < 3; ++k) {
            color[k] += (float)p->weights[c] * corner[k];
        }
    }
}

static float light_at(const drawing *d, uint32_t triangle, const surface_point *p) {
    const pci_model *model = d->model;
    float normal[3] = {0.0F, 0.0F, 0.0F}, point[3] = {0.0F, 0.0F, 0.0F};
    for (size_t c = 0; c < 3; ++c) {
        const float weight = (float)p->weights[c];
        const size_t v = model->mesh->triangles[3 * (size_t)triangle + c];
        for (size_t k = 0; k < 3; ++k) {
            point[k] += weight * model->points[3 * v + k];
            normal[k] += weight * model->normals[9 * (size_t)triangle + 3 * c + k];
        }
    }
    const float length = sqrtf(dot(normal, normal));
    const float scale = (p->front ? 1.0F : -1.0F) / (length > 0.0F ? length : 1.0F);
    for (size_t k = 0; k < 3; ++k) {
        normal[k] *= scale;
        // One and a half texels off the surface, so that it does not shade itself.
        point[k] += normal[k] * (3.0F / SHADOW_SIDE);
    }
    float light = 0.0F;
    for (size_t i = 0; i < LAMPS; ++i) {
        const float cosine = dot(normal, d->lamps[i].direction);
        if (cosine > 0.0F) {
            float mapped[3];
            to_lamp(&d->lamps[i], point, mapped);
            const float *depths = &model->shadows[i * SHADOW_SIDE * SHADOW_SIDE];
            light += d->intensities[i] * cosine * visibility(depths, mapped);
        }
    }
    return light;
}

// Averages the samples of one pixel.
static void resolve_pixel(const drawing *d, const canvas *band, size_t column, size_t row) {
    uint8_t *pixel =
        &d->image->pixels[3 * ((d->tile.y + row) * d->image->width + d->tile.x + column)];
    float sum[3] = {0.0F, 0.0F, 0.0F}, lights[SAMPLES * SAMPLES], seen_depths[SAMPLES * SAMPLES];
    uint32_t seen[SAMPLES * SAMPLES];
    bool fronts[SAMPLES * SAMPLES];
    size_t seen_count = 0, covered = 0, on_edges = 0;
    for (size_t s = 0; s < SAMPLES * SAMPLES; ++s) {
        const size_t x = SAMPLES * column + s % SAMPLES, y = SAMPLES * row + s / SAMPLES;
        const size_t at = (y - band->first_row) * band->width + x;
        const uint32_t triangle = band->triangles[at];
        if (triangle == PC_INVALID_INDEX) {
            continue;
        }
        ++covered;
        const surface_point p = locate(d, triangle, (double)x + 0.5, (double)y + 0.5);
        if (d->style != PCI_STYLE_SURFACE && on_edge(d, triangle, &p)) {
            ++on_edges;
            continue;
        }
        if (d->style == PCI_STYLE_EDGES_ON_TOP) {
            continue;
        }
        // Light changes slowly: once per pixel and smooth surface is enough.
        const float depth = band->depths[at];
        size_t i = 0;
        while (i < seen_count && seen[i] != triangle &&
               (fronts[i] != p.front || fabsf(seen_depths[i] - depth) > 2.0F * SAMPLES ||
                dot(&d->model->normals[9 * (size_t)seen[i]],
                    &d->model->normals[9 * (size_t)triangle]) < 0.95F)) {
            ++i;
        }
        if (i == seen_count) {
            seen[seen_count] = triangle;
            seen_depths[seen_count] = depth;
            fronts[seen_count] = p.front;
            lights[seen_count++] = light_at(d, triangle, &p);
        }
        float albedo[3];
        color_at(d->model, triangle, &p, albedo);
        for (size_t k = 0; k < 3; ++k) {
            const float value = albedo[k] * lights[i];
            sum[k] += value < 1.0F ? value : 1.0F;
        }
    }
    if (covered == 0 || (d->style == PCI_STYLE_EDGES_ON_TOP && on_edges == 0)) {
        return;
    }
    const float share = 1.0F / (SAMPLES * SAMPLES);
    for (size_t k = 0; k < 3; ++k) {
        const float before = d->decoded[pixel[k]];
        if (d->style == PCI_STYLE_EDGES_ON_TOP) {
            const float opacity = OVERLAY_OPACITY * share * (float)on_edges;
            pixel[k] = encode(d, before + opacity * (edge_color[k] - before));
        } else {
            const float open = (float)(SAMPLES * SAMPLES - covered);
            pixel[k] =
                encode(d, share * (sum[k] + open * before + (float)on_edges * edge_color[k]));
        }
    }
}

static void draw_bands(void *user, size_t begin, size_t end, uint32_t worker) {
    const drawing *d = user;
    const pc_mesh *mesh = d->model->mesh;
    const size_t width = SAMPLES * d->tile.size, samples = width * BAND_ROWS * SAMPLES;
    const double back_offset = BACK_OFFSET * d->model->radius * d->camera->scale * SAMPLES;
    for (size_t i = begin; i < end; ++i) {
        const size_t first = i * BAND_ROWS;
        const size_t rows = d->tile.size - first < BAND_ROWS ? d->tile.size - first : BAND_ROWS;
        canvas band = {width, first * SAMPLES, rows * SAMPLES, &d->depths[worker * samples],
                       &d->triangles[worker * samples]};
        for (size_t k = 0; k < samples; ++k) {
            band.depths[k] = -INFINITY;
        }
        memset(band.triangles, 0xff, samples * sizeof(*band.triangles));
        const double top = (double)band.first_row;
        const double bottom = (double)(band.first_row + band.row_count);
        for (size_t t = 0; t < mesh->triangle_count; ++t) {
            double corner[3][3];
            for (size_t c = 0; c < 3; ++c) {
                memcpy(corner[c], &d->corners[3 * (size_t)mesh->triangles[3 * t + c]],
                       sizeof(corner[c]));
            }
            if (larger(larger(corner[0][1], corner[1][1]), corner[2][1]) < top ||
                smaller(smaller(corner[0][1], corner[1][1]), corner[2][1]) > bottom) {
                continue;
            }
            const double area = (corner[1][0] - corner[0][0]) * (corner[2][1] - corner[0][1]) -
                                (corner[2][0] - corner[0][0]) * (corner[1][1] - corner[0][1]);
            for (size_t c = 0; c < 3 && area > 0.0; ++c) {
                corner[c][2] -= back_offset;
            }
            rasterize(&band, corner[0], corner[1], corner[2], (uint32_t)t);
        }
        for (size_t row = first; row < first + rows; ++row) {
            for (size_t column = 0; column < d->tile.size; ++column) {
                resolve_pixel(d, &band, column, row);
            }
        }
    }
}

bool pci_draw(pc_context *context, pci_scratch *scratch, const pci_model *model,
              const pci_camera *camera, pci_style style, pci_tile tile, pci_image *image) {
    const size_t band = SAMPLES * tile.size * BAND_ROWS * SAMPLES;
    const size_t vertex_count = model->mesh->vertex_count;
    const uint32_t workers = pc_context_threads(context);
    drawing *d = PCI_SCRATCH(scratch, drawing, 1);
    double *corners = PCI_SCRATCH(scratch, double, 3 * vertex_count);
    float *depths = PCI_SCRATCH(scratch, float, workers *band);
    uint32_t *triangles = PCI_SCRATCH(scratch, uint32_t, workers * band);
    if (scratch->failed) {
        return false;
    }
    *d = (drawing){.model = model, .camera = camera, .style = style, .tile = tile, .image = image};
    d->corners = corners, d->depths = depths, d->triangles = triangles;
    d->edge_half_width = 0.5 * EDGE_WIDTH * SAMPLES * fmax(1.0, (double)tile.size / 360.0);
    d->border_width = 0.5 * BORDER_WIDTH * SAMPLES * fmax(1.0, (double)tile.size / 360.0);
    set_lamps(d);
    set_encoding(d);
    const double middle = 0.5 * (double)tile.size;
    for (size_t v = 0; v < vertex_count; ++v) {
        const double *p = &model->mesh->positions[3 * v];
        double offset[3]; // depths as floats need a near origin
        pci_sub(p, model->centre, offset);
        const double x = camera->scale * (pci_dot(p, camera->right) - camera->centre[0]);
        const double y = camera->scale * (pci_dot(p, camera->up) - camera->centre[1]);
        corners[3 * v] = SAMPLES * (middle + x);
        corners[3 * v + 1] = SAMPLES * (middle - y);
        corners[3 * v + 2] = SAMPLES * camera->scale * pci_dot(offset, camera->towards);
    }
    const size_t bands = (tile.size + BAND_ROWS - 1) / BAND_ROWS;
    pci_parallel_for(context, bands, 1, draw_bands, d);
    return true;
}
