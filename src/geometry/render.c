#include "geometry/render.h"

#define SAMPLES         3    // per pixel and axis
#define BAND_ROWS       8    // pixels, work of one piece
#define EDGE_WIDTH      1.15 // pixels at a tile of 360
#define BORDER_WIDTH    3.2
#define OVERLAY_OPACITY 0.5F
// Back sides count as this much farther away, in radii of the model: where the two sheets of a
// projected mesh lie on each other, the front is drawn.
#define BACK_OFFSET 0.006

static const float front_albedo[3] = {0.46F, 0.46F, 0.47F};
static const float back_albedo[3] = {0.13F, 0.28F, 0.62F};
static const float edge_color[3] = {0.012F, 0.014F, 0.02F};

static inline float dot(const float a[3], const float b[3]) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

// ---- light and colour -------------------------------------------------------------------------

// A wide key light from the upper left behind the viewer, and a sky that is brighter above. An open
// surface that faces the viewer gets 1.
static void set_intensities(const pci_dome *dome, const pci_camera *camera, float *intensities) {
    double key[3], total = 0.0;
    for (size_t k = 0; k < 3; ++k) {
        key[k] = camera->towards[k] * 0.62 + camera->up[k] * 0.62 - camera->right[k] * 0.48;
    }
    pci_normalize(key);
    for (size_t i = 0; i < PCI_LAMPS; ++i) {
        const double direction[3] = {(double)dome->directions[0][i], (double)dome->directions[1][i],
                                     (double)dome->directions[2][i]};
        const double lobe = fmax(pci_dot(direction, key), 0.0);
        const double sky = 0.5 + 0.5 * pci_dot(direction, camera->up);
        const double intensity = 0.2 + 0.3 * sky + 2.6 * lobe * lobe * lobe * lobe;
        intensities[i] = (float)intensity;
        total += intensity * fmax(pci_dot(direction, camera->towards), 0.0);
    }
    for (size_t i = 0; i < PCI_LAMPS; ++i) {
        intensities[i] /= (float)total;
    }
}

static uint8_t encode(const pci_renderer *renderer, float linear) {
    const float clamped = !(linear > 0.0F) ? 0.0F : linear > 1.0F ? 1.0F : linear;
    return renderer->encoded[(size_t)(clamped * 4096.0F + 0.5F)];
}

// ---- what is seen -----------------------------------------------------------------------------

typedef struct drawing {
    const pci_renderer *renderer;
    const pci_model *model;
    pci_style style;
    size_t size;                          // of the pictures
    double *corners;                      // #V by 3, x, y, depth in samples
    uint8_t *fronts;                      // #F: seen from its front
    size_t *band_offsets;                 // #bands + 1
    uint32_t *band_triangles;             // that may cover samples of a band, ascending
    uint32_t (*band_columns)[2];          // #bands, pixels from the first to before the second
    float intensities[PCI_LAMPS];         // as seen from this camera
    double edge_half_width, border_width; // samples
    double back_offset;
    const pci_picture *pictures;
    size_t picture_count;
} drawing;

// Barycentric coordinates are linear in x and y.
typedef struct gauge {
    uint32_t triangle;
    double slopes[3][2], offsets[3];
    double margins[3]; // below these a point is on the edge opposite of the corner
} gauge;

// What some samples of a pixel see in one light.
typedef struct fragment {
    uint32_t pixel; // of the band
    uint32_t triangle;
    uint32_t samples;
    float depth;
    float weights[3]; // barycentric
} fragment;

// Rows of pixels, the work of one piece.
typedef struct band {
    pci_canvas samples;
    uint8_t *covered, *on_edges; // samples of each pixel
    fragment *fragments;         // those of a pixel follow each other
    pci_lit_points points;       // of the fragments
    gauge gauge;                 // of the triangle at hand
} band;

static void set_gauge(const drawing *d, uint32_t triangle, gauge *g) {
    const uint32_t *v = &d->model->mesh->triangles[3 * (size_t)triangle];
    const unsigned borders = d->model->borders[triangle];
    const double *corners[3];
    for (size_t c = 0; c < 3; ++c) {
        corners[c] = &d->corners[3 * (size_t)v[c]];
    }
    const double *a = corners[0], *b = corners[1], *c = corners[2];
    const double total = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
    const double scale = total != 0.0 ? 1.0 / total : 0.0;
    for (size_t k = 0; k < 3; ++k) {
        const double *from = corners[(k + 1) % 3], *to = corners[(k + 2) % 3];
        const double x = scale * (to[0] - from[0]), y = scale * (to[1] - from[1]);
        g->slopes[k][0] = -y;
        g->slopes[k][1] = x;
        g->offsets[k] = from[0] * y - from[1] * x;
        if (d->style != PCI_STYLE_SURFACE) {
            g->margins[k] = sqrt(x * x + y * y) *
                            (borders >> (k + 1) % 3 & 1U ? d->border_width : d->edge_half_width);
        }
    }
    g->triangle = triangle;
}

static const gauge *gauge_of(const drawing *d, band *b, uint32_t triangle) {
    if (b->gauge.triangle != triangle) {
        set_gauge(d, triangle, &b->gauge);
    }
    return &b->gauge;
}

static inline double weight_at(const gauge *g, size_t corner, double x, double y) {
    return g->slopes[corner][0] * x + g->slopes[corner][1] * y + g->offsets[corner];
}

static bool on_edge(const gauge *g, double x, double y) {
    return fabs(weight_at(g, 0, x, y)) < g->margins[0] ||
           fabs(weight_at(g, 1, x, y)) < g->margins[1] ||
           fabs(weight_at(g, 2, x, y)) < g->margins[2];
}

static void add_fragment(const drawing *d, band *b, uint32_t pixel, uint32_t triangle, float depth,
                         double x, double y) {
    const pci_model *model = d->model;
    const gauge *g = gauge_of(d, b, triangle);
    const size_t i = b->points.count++;
    fragment *f = &b->fragments[i];
    *f = (fragment){.pixel = pixel, .triangle = triangle, .depth = depth};
    float normal[3] = {0.0F, 0.0F, 0.0F}, point[3] = {0.0F, 0.0F, 0.0F};
    for (size_t c = 0; c < 3; ++c) {
        const float weight = (float)weight_at(g, c, x, y);
        const size_t v = model->mesh->triangles[3 * (size_t)triangle + c];
        f->weights[c] = weight;
        for (size_t k = 0; k < 3; ++k) {
            point[k] += weight * model->points[3 * v + k];
            normal[k] += weight * model->normals[9 * (size_t)triangle + 3 * c + k];
        }
    }
    const float length = sqrtf(dot(normal, normal));
    const float scale = (d->fronts[triangle] ? 1.0F : -1.0F) / (length > 0.0F ? length : 1.0F);
    for (size_t k = 0; k < 3; ++k) {
        b->points.normal[k][i] = normal[k] * scale;
        // One and a half texels off the surface, so that it does not shade itself.
        b->points.position[k][i] = point[k] + normal[k] * scale * (3.0F / PCI_SHADOW_SIDE);
    }
}

// Light changes slowly: once per pixel and smooth surface is enough.
static bool same_light(const drawing *d, const fragment *f, uint32_t triangle, float depth) {
    return f->triangle == triangle || (d->fronts[f->triangle] == d->fronts[triangle] &&
                                       fabsf(f->depth - depth) <= 2.0F * SAMPLES &&
                                       dot(&d->model->normals[9 * (size_t)f->triangle],
                                           &d->model->normals[9 * (size_t)triangle]) >= 0.95F);
}

// The fragment with the light of a sample, at (x, y), of a pixel whose fragments start at `first`.
static size_t fragment_of(const drawing *d, band *b, size_t first, uint32_t pixel,
                          uint32_t triangle, float depth, double x, double y) {
    size_t i = first;
    while (i < b->points.count && !same_light(d, &b->fragments[i], triangle, depth)) {
        ++i;
    }
    if (i == b->points.count) {
        add_fragment(d, b, pixel, triangle, depth, x, y);
    }
    return i;
}

// Whether all samples of a pixel, the first of which is `corner`, see the same.
static bool is_plain(const pci_canvas *samples, size_t corner) {
    const uint32_t *rows = &samples->triangles[corner], first = rows[0];
    uint32_t differences = 0;
    for (size_t row = 0; row < SAMPLES; ++row, rows += samples->width) {
        for (size_t i = 0; i < SAMPLES; ++i) {
            differences |= rows[i] ^ first;
        }
    }
    return differences == 0;
}

static void look_through_pixel(const drawing *d, band *b, uint32_t column, uint32_t row) {
    // Light is taken where the first of them is, in the middle.
    static const uint8_t across[SAMPLES * SAMPLES] = {1, 0, 1, 2, 0, 2, 0, 1, 2};
    static const uint8_t down[SAMPLES * SAMPLES] = {1, 0, 0, 0, 1, 1, 2, 2, 2};
    const size_t width = b->samples.width, corner = SAMPLES * (row * width + column);
    const double left = (double)(SAMPLES * column) + 0.5;
    const double top = (double)(b->samples.first_row + SAMPLES * row) + 0.5;
    const size_t pixel = row * d->size + column, first = b->points.count;
    if (is_plain(&b->samples, corner)) {
        const uint32_t triangle = b->samples.triangles[corner];
        const bool empty = triangle == PC_INVALID_INDEX;
        if (empty || d->style == PCI_STYLE_SURFACE) {
            b->on_edges[pixel] = 0;
            b->covered[pixel] = empty ? 0 : SAMPLES * SAMPLES;
            if (!empty) {
                const size_t middle = corner + down[0] * width + across[0];
                add_fragment(d, b, (uint32_t)pixel, triangle, b->samples.depths[middle],
                             left + (double)across[0], top + (double)down[0]);
                b->fragments[first].samples = SAMPLES * SAMPLES;
            }
            return;
        }
    }
    uint32_t covered = 0, on_edges = 0, last = PC_INVALID_INDEX;
    size_t i = 0; // fragment of the last triangle
    for (size_t k = 0; k < SAMPLES * SAMPLES; ++k) {
        const size_t sample = corner + down[k] * width + across[k];
        const uint32_t triangle = b->samples.triangles[sample];
        if (triangle == PC_INVALID_INDEX) {
            continue;
        }
        ++covered;
        const double x = left + (double)across[k], y = top + (double)down[k];
        if (d->style != PCI_STYLE_SURFACE && on_edge(gauge_of(d, b, triangle), x, y)) {
            ++on_edges;
        } else if (d->style != PCI_STYLE_EDGES_ON_TOP) {
            if (triangle != last) {
                i = fragment_of(d, b, first, (uint32_t)pixel, triangle, b->samples.depths[sample],
                                x, y);
                last = triangle;
            }
            ++b->fragments[i].samples;
        }
    }
    b->covered[pixel] = (uint8_t)covered;
    b->on_edges[pixel] = (uint8_t)on_edges;
}

static void rasterize_band(const drawing *d, size_t index, band *b) {
    pci_canvas *samples = &b->samples;
    const size_t columns = samples->right - samples->left;
    for (size_t row = 0; row < samples->row_count; ++row) {
        const size_t first = row * samples->width + samples->left;
        float *depths = &samples->depths[first];
        for (size_t i = 0; i < columns; ++i) {
            depths[i] = -INFINITY;
        }
        memset(&samples->triangles[first], 0xff, columns * sizeof(*samples->triangles));
    }
    const size_t begin = d->band_offsets[index], end = d->band_offsets[index + 1];
    d->renderer->dome.kernel->cover(samples, d->corners, d->model->mesh->triangles,
                                    &d->band_triangles[begin], end - begin);
}

// ---- pictures ---------------------------------------------------------------------------------

static void color_of(const drawing *d, const float *colors, const fragment *f, float color[3]) {
    if (colors == NULL) {
        memcpy(color, d->fronts[f->triangle] ? front_albedo : back_albedo, sizeof(front_albedo));
        return;
    }
    memset(color, 0, sizeof(front_albedo));
    for (size_t c = 0; c < 3; ++c) {
        const float *corner =
            &colors[3 * (size_t)d->model->mesh->triangles[3 * (size_t)f->triangle + c]];
        for (size_t k = 0; k < 3; ++k) {
            color[k] += f->weights[c] * corner[k];
        }
    }
}

static void add_light(const drawing *d, const float *colors, const fragment *f, float light,
                      float sum[3]) {
    float color[3];
    color_of(d, colors, f, color);
    for (size_t k = 0; k < 3; ++k) {
        const float value = color[k] * light;
        sum[k] += (float)f->samples * (value < 1.0F ? value : 1.0F);
    }
}

static void paint_pixel(const drawing *d, const band *b, size_t i, const float sum[3],
                        uint8_t *pixel) {
    const float share = 1.0F / (SAMPLES * SAMPLES), on_edges = (float)b->on_edges[i];
    for (size_t k = 0; k < 3; ++k) {
        const float before = d->renderer->decoded[pixel[k]];
        if (d->style == PCI_STYLE_EDGES_ON_TOP) {
            const float opacity = OVERLAY_OPACITY * share * on_edges;
            pixel[k] = encode(d->renderer, before + opacity * (edge_color[k] - before));
        } else {
            const float open = (float)(SAMPLES * SAMPLES - b->covered[i]);
            pixel[k] =
                encode(d->renderer, share * (sum[k] + open * before + on_edges * edge_color[k]));
        }
    }
}

// Averages the samples of each pixel.
static void paint_band(const drawing *d, const band *b, const pci_picture *picture,
                       size_t first_row, size_t row_count) {
    const pci_image *image = d->renderer->image;
    const size_t left = b->samples.left / SAMPLES, right = b->samples.right / SAMPLES;
    size_t next = 0;
    for (size_t row = 0; row < row_count; ++row) {
        const size_t y = picture->tile.y + first_row + row;
        for (size_t column = left; column < right; ++column) {
            const size_t i = row * d->size + column;
            if (b->covered[i] == 0 || (d->style == PCI_STYLE_EDGES_ON_TOP && b->on_edges[i] == 0)) {
                continue;
            }
            float sum[3] = {0.0F, 0.0F, 0.0F};
            for (; next < b->points.count && b->fragments[next].pixel == i; ++next) {
                add_light(d, picture->colors, &b->fragments[next], b->points.light[next], sum);
            }
            paint_pixel(d, b, i, sum,
                        &image->pixels[3 * (y * image->width + picture->tile.x + column)]);
        }
    }
}

static void draw_bands(void *user, size_t begin, size_t end, uint32_t worker) {
    const drawing *d = user;
    band *b = &d->renderer->bands[worker];
    b->samples.back_offset = d->back_offset;
    for (size_t i = begin; i < end; ++i) {
        const size_t first = i * BAND_ROWS;
        const size_t rows = d->size - first < BAND_ROWS ? d->size - first : BAND_ROWS;
        b->samples.first_row = (uint32_t)(first * SAMPLES);
        b->samples.row_count = (uint32_t)(rows * SAMPLES);
        b->samples.left = SAMPLES * d->band_columns[i][0];
        b->samples.right = SAMPLES * d->band_columns[i][1];
        b->points.count = 0;
        b->gauge.triangle = PC_INVALID_INDEX;
        rasterize_band(d, i, b);
        for (uint32_t row = 0; row < rows; ++row) {
            for (uint32_t column = d->band_columns[i][0]; column < d->band_columns[i][1];
                 ++column) {
                look_through_pixel(d, b, column, row);
            }
        }
        if (d->style != PCI_STYLE_EDGES_ON_TOP) {
            d->renderer->dome.kernel->light(&d->renderer->dome, d->intensities, d->model->shadows,
                                            &b->points);
        }
        for (size_t k = 0; k < d->picture_count; ++k) {
            paint_band(d, b, &d->pictures[k], first, rows);
        }
    }
}

static void project_corners(drawing *d, const pci_camera *camera) {
    const pci_model *model = d->model;
    const double middle = 0.5 * (double)d->size;
    for (size_t v = 0; v < model->mesh->vertex_count; ++v) {
        const double *p = &model->mesh->positions[3 * v];
        double offset[3]; // depths as floats need a near origin
        pci_sub(p, model->centre, offset);
        const double x = camera->scale * (pci_dot(p, camera->right) - camera->centre[0]);
        const double y = camera->scale * (pci_dot(p, camera->up) - camera->centre[1]);
        d->corners[3 * v] = SAMPLES * (middle + x);
        d->corners[3 * v + 1] = SAMPLES * (middle - y);
        d->corners[3 * v + 2] = SAMPLES * camera->scale * pci_dot(offset, camera->towards);
    }
}

// Bands whose samples a triangle may cover, from `first` to before `end`, and columns of samples.
typedef struct band_range {
    uint32_t first, end, left, right;
} band_range;

static band_range bands_of(const drawing *d, size_t triangle, uint8_t *front) {
    const uint32_t *v = &d->model->mesh->triangles[3 * triangle];
    const double *a = &d->corners[3 * (size_t)v[0]], *b = &d->corners[3 * (size_t)v[1]];
    const double *c = &d->corners[3 * (size_t)v[2]];
    const uint32_t side = (uint32_t)(SAMPLES * d->size), rows = SAMPLES * BAND_ROWS;
    // y points down
    *front = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]) > 0.0 ? 0 : 1;
    const uint32_t left = pci_first_sample(pci_smaller(pci_smaller(a[0], b[0]), c[0]), 0, side);
    const uint32_t right = pci_first_sample(pci_larger(pci_larger(a[0], b[0]), c[0]), 0, side);
    const uint32_t top = pci_first_sample(pci_smaller(pci_smaller(a[1], b[1]), c[1]), 0, side);
    const uint32_t bottom = pci_first_sample(pci_larger(pci_larger(a[1], b[1]), c[1]), 0, side);
    if (left == right || top == bottom) {
        return (band_range){0};
    }
    return (band_range){top / rows, (bottom - 1) / rows + 1, left, right};
}

static void extend_columns(uint32_t columns[2], const band_range *range) {
    const uint32_t left = range->left / SAMPLES, right = (range->right - 1) / SAMPLES + 1;
    columns[0] = columns[1] == 0 || left < columns[0] ? left : columns[0];
    columns[1] = right > columns[1] ? right : columns[1];
}

// Lists the triangles of each band.
static bool sort_into_bands(pci_scratch *scratch, drawing *d, size_t band_count) {
    const size_t count = d->model->mesh->triangle_count;
    band_range *ranges = PCI_SCRATCH(scratch, band_range, count);
    d->fronts = PCI_SCRATCH(scratch, uint8_t, count);
    d->band_offsets = PCI_SCRATCH(scratch, size_t, band_count + 2);
    d->band_columns = pci_scratch_allocate(scratch, band_count, sizeof(*d->band_columns));
    if (scratch->failed) {
        return false;
    }
    size_t *next = d->band_offsets + 1; // ends as the first index of each band plus its count
    for (size_t t = 0; t < count; ++t) {
        ranges[t] = bands_of(d, t, &d->fronts[t]);
        for (uint32_t i = ranges[t].first; i < ranges[t].end; ++i) {
            ++next[i + 1];
            extend_columns(d->band_columns[i], &ranges[t]);
        }
    }
    for (size_t i = 0; i < band_count; ++i) {
        next[i + 1] += next[i];
    }
    d->band_triangles = PCI_SCRATCH(scratch, uint32_t, next[band_count]);
    if (scratch->failed) {
        return false;
    }
    for (size_t t = 0; t < count; ++t) {
        for (uint32_t i = ranges[t].first; i < ranges[t].end; ++i) {
            d->band_triangles[next[i]++] = (uint32_t)t;
        }
    }
    return true;
}

static bool make_bands(pci_scratch *scratch, pci_renderer *renderer) {
    const size_t size = renderer->tile_size, pixels = size * BAND_ROWS;
    const size_t samples = SAMPLES * SAMPLES * pixels;
    const uint32_t workers = pc_context_threads(renderer->context);
    renderer->bands = PCI_SCRATCH(scratch, band, workers);
    for (uint32_t i = 0; i < workers && !scratch->failed; ++i) {
        band *b = &renderer->bands[i];
        b->samples.width = (uint32_t)(SAMPLES * size);
        b->samples.depths = PCI_SCRATCH(scratch, float, samples + PCI_CANVAS_PADDING);
        b->samples.triangles = PCI_SCRATCH(scratch, uint32_t, samples + PCI_CANVAS_PADDING);
        b->covered = PCI_SCRATCH(scratch, uint8_t, pixels);
        b->on_edges = PCI_SCRATCH(scratch, uint8_t, pixels);
        b->fragments = PCI_SCRATCH(scratch, fragment, samples);
        pci_lit_points_reserve(scratch, samples, &b->points);
    }
    return !scratch->failed;
}

static void set_encoding(pci_renderer *renderer) {
    for (size_t i = 0; i <= 4096; ++i) {
        const double linear = (double)i / 4096.0;
        const double value =
            linear <= 0.0031308 ? 12.92 * linear : 1.055 * pow(linear, 1.0 / 2.4) - 0.055;
        renderer->encoded[i] = (uint8_t)(255.0 * value + 0.5);
    }
    for (size_t i = 0; i < 256; ++i) {
        const double value = (double)i / 255.0;
        renderer->decoded[i] =
            (float)(value <= 0.04045 ? value / 12.92 : pow((value + 0.055) / 1.055, 2.4));
    }
}

static void whiten_rows(void *user, size_t begin, size_t end, uint32_t worker) {
    const pci_image *image = user;
    (void)worker;
    memset(&image->pixels[3 * image->width * begin], 0xff, 3 * image->width * (end - begin));
}

void pci_image_whiten(pc_context *context, pci_image *image) {
    pci_parallel_for(context, image->height, 64, whiten_rows, image);
}

bool pci_renderer_begin(pci_renderer *renderer, pc_context *context, pci_scratch *scratch,
                        pci_image *image, size_t tile_size) {
    renderer->context = context;
    renderer->image = image;
    renderer->tile_size = tile_size;
    pci_dome_set(&renderer->dome);
    set_encoding(renderer);
    return make_bands(scratch, renderer);
}

bool pci_draw(const pci_renderer *renderer, const pci_model *model, const pci_camera *camera,
              pci_style style, const pci_picture *pictures, size_t picture_count) {
    const size_t size = renderer->tile_size, bands = (size + BAND_ROWS - 1) / BAND_ROWS;
    const double detail = fmax(1.0, (double)size / 360.0);
    pci_scratch scratch = pci_scratch_begin(renderer->context);
    drawing d = {.renderer = renderer,
                 .model = model,
                 .style = style,
                 .size = size,
                 .pictures = pictures,
                 .picture_count = picture_count,
                 .edge_half_width = 0.5 * EDGE_WIDTH * SAMPLES * detail,
                 .border_width = 0.5 * BORDER_WIDTH * SAMPLES * detail,
                 .back_offset = BACK_OFFSET * model->radius * camera->scale * SAMPLES};
    d.corners = PCI_SCRATCH(&scratch, double, 3 * model->mesh->vertex_count);
    bool drawn = !scratch.failed;
    if (drawn) {
        project_corners(&d, camera);
        drawn = sort_into_bands(&scratch, &d, bands);
    }
    if (drawn) {
        set_intensities(&renderer->dome, camera, d.intensities);
        pci_parallel_for(renderer->context, bands, 1, draw_bands, &d);
    }
    pci_scratch_end(&scratch);
    return drawn;
}
