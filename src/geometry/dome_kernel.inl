// Kernels for one instruction set; included by dome_kernel_*.c with
//   LANES              lamps or points per register, divides PCI_LAMP_GROUP
//   ANY(mask)          whether any bit is set; of a variable
//   PAIRS(at, index)   at[index] | at[index + 1] << 16 in each lane; of variables
//   KERNEL             name of the result

typedef float VEC __attribute__((vector_size(LANES * sizeof(float)), may_alias));
typedef int32_t MASK __attribute__((vector_size(LANES * sizeof(float)), may_alias));
// Loads and stores need no alignment.
typedef float LOOSE __attribute__((vector_size(LANES * sizeof(float)), may_alias, aligned(4)));

typedef int32_t LOOSE_MASK
    __attribute__((vector_size(LANES * sizeof(float)), may_alias, aligned(4)));

#define INLINE static inline __attribute__((always_inline))

INLINE VEC load(const float *p) { return *(const LOOSE *)(const void *)p; }
INLINE void store(float *p, VEC value) { *(LOOSE *)(void *)p = value; }
INLINE VEC splat(float value) { return (VEC){0} + value; }
INLINE VEC choose(MASK mask, VEC yes, VEC no) {
    return (VEC)((mask & (MASK)yes) | (~mask & (MASK)no));
}
// Where a is NaN: b.
INLINE VEC smaller(VEC a, VEC b) { return choose(a < b, a, b); }
INLINE VEC larger(VEC a, VEC b) { return choose(a > b, a, b); }
INLINE MASK truncate(VEC value) { return __builtin_convertvector(value, MASK); }
INLINE VEC convert(MASK value) { return __builtin_convertvector(value, VEC); }

// ---- depth maps: one lamp per lane ------------------------------------------------------------

typedef struct triangle {
    VEC x[3], y[3]; // in texels
    VEC depth[3];
} triangle;

INLINE triangle project(const VEC axes[9], const float *points, const uint32_t *corners) {
    triangle t;
    for (size_t c = 0; c < 3; ++c) {
        const float *p = &points[3 * (size_t)corners[c]];
        const float half = 0.5F * PCI_SHADOW_SIDE;
        t.x[c] = half + (p[0] * axes[0] + p[1] * axes[1] + p[2] * axes[2]);
        t.y[c] = half + (p[0] * axes[3] + p[1] * axes[4] + p[2] * axes[5]);
        t.depth[c] = 0.5F * PCI_NEAREST + (p[0] * axes[6] + p[1] * axes[7] + p[2] * axes[8]);
    }
    return t;
}

// Raises one texel in each lane; depth 0 raises none.
INLINE void raise(uint16_t *shadows, MASK texels, MASK depths) {
    for (size_t l = 0; l < LANES; ++l) {
        uint16_t *texel = &shadows[l * PCI_SHADOW_TEXELS + (size_t)texels[l]];
        *texel = *texel < depths[l] ? (uint16_t)depths[l] : *texel;
    }
}

// Row by row, from where the first edge crosses the middle of the texels to where the other does.
INLINE void rasterize(const triangle *t, uint16_t *shadows) {
    const VEC *x = t->x, *y = t->y, *depth = t->depth;
    MASK row = truncate(smaller(smaller(y[0], y[1]), y[2]) + 0.5F);
    const MASK end_row = truncate(larger(larger(y[0], y[1]), y[2]) + 0.5F);
    const MASK column = truncate(smaller(smaller(x[0], x[1]), x[2]) + 0.5F);
    const MASK end_column = truncate(larger(larger(x[0], x[1]), x[2]) + 0.5F);
    const MASK met = (row < end_row) & (column < end_column);
    if (!ANY(met)) {
        return;
    }
    const VEC ab[3] = {x[1] - x[0], y[1] - y[0], depth[1] - depth[0]};
    const VEC ac[3] = {x[2] - x[0], y[2] - y[0], depth[2] - depth[0]};
    const VEC inverse = 1.0F / (ab[0] * ac[1] - ac[0] * ab[1]);
    const VEC by_x = (ab[2] * ac[1] - ac[2] * ab[1]) * inverse;
    const VEC by_y = (ac[2] * ab[0] - ab[2] * ac[0]) * inverse;
    const VEC slopes[3] = {ab[0] / ab[1], (x[2] - x[1]) / (y[2] - y[1]), ac[0] / ac[1]};
    // Triangles that are seen from their edge have no useful slope; their depth is within these.
    const VEC least = smaller(smaller(depth[0], depth[1]), depth[2]);
    const VEC most = larger(larger(depth[0], depth[1]), depth[2]);
    const VEC lowest = larger(least, splat(0.0F)), highest = smaller(most, splat(PCI_NEAREST));
    for (MASK left = met; ANY(left); row += 1, left = met & (row < end_row)) {
        const VEC middle = convert(row) + 0.5F;
        VEC begin = splat(PCI_SHADOW_SIDE), end = splat(0.0F);
        for (size_t c = 0; c < 3; ++c) {
            const size_t a = c == 1 ? 1 : 0, b = c == 0 ? 1 : 2;
            const MASK crosses = (y[a] <= middle) ^ (y[b] <= middle);
            const VEC place = x[a] + slopes[c] * (middle - y[a]);
            begin = choose(crosses & (place < begin), place, begin);
            end = choose(crosses & (place > end), place, end);
        }
        MASK at = truncate(larger(begin, splat(0.0F)) + 0.5F);
        const MASK last = truncate(smaller(end, splat(PCI_SHADOW_SIDE)) + 0.5F);
        VEC here = depth[0] + by_y * (middle - y[0]) + by_x * (convert(at) + 0.5F - x[0]);
        for (MASK inside = at < last; ANY(inside); at += 1, here += by_x, inside = at < last) {
            const MASK raised = truncate(larger(smaller(here, highest), lowest));
            raise(shadows, inside & (row * PCI_SHADOW_SIDE + at), inside & raised);
        }
    }
}

static void cast(const pci_dome *dome, size_t first_lamp, const float *points,
                 const uint32_t *triangles, size_t triangle_count, uint16_t *shadows) {
    for (size_t lamp = first_lamp; lamp < first_lamp + PCI_LAMP_GROUP; lamp += LANES) {
        VEC axes[9];
        for (size_t k = 0; k < 9; ++k) {
            axes[k] = load(&dome->axes[k / 3][k % 3][lamp]);
        }
        for (size_t i = 0; i < triangle_count; ++i) {
            const triangle t = project(axes, points, &triangles[3 * i]);
            rasterize(&t, &shadows[lamp * PCI_SHADOW_TEXELS]);
        }
    }
}

// ---- light: one point per lane ----------------------------------------------------------------

// Texel below a place in the map, and how far the place is on the way to the next one.
INLINE MASK texel_below(VEC place, VEC *share) {
    const VEC texel = smaller(larger(place - 0.5F, splat(0.0F)), splat(PCI_SHADOW_SIDE - 1.001F));
    const MASK below = truncate(texel);
    *share = texel - convert(below);
    return below;
}

// Along a row of the map, between a texel and the next one.
INLINE VEC lit(const uint16_t *shadows, MASK texel, MASK depth, VEC share) {
    const MASK pair = PAIRS(shadows, texel);
    const MASK first = (pair & 0xffff) <= depth, second = (pair >> 16 & 0xffff) <= depth;
    return (VEC)(first & (MASK)(1.0F - share)) + (VEC)(second & (MASK)share);
}

INLINE VEC visibility(const uint16_t *shadows, const VEC place[3]) {
    VEC u, v;
    const MASK column = texel_below(place[0], &u), row = texel_below(place[1], &v);
    const MASK texel = row * PCI_SHADOW_SIDE + column;
    const MASK depth = truncate(larger(smaller(place[2], splat(PCI_NEAREST)), splat(0.0F)));
    return lit(shadows, texel, depth, u) * (1.0F - v) +
           lit(shadows + PCI_SHADOW_SIDE, texel, depth, u) * v;
}

static void light(const pci_dome *dome, const float *intensities, const uint16_t *shadows,
                  pci_lit_points *points) {
    memset(points->light, 0, points->capacity * sizeof(*points->light));
    for (size_t i = 0; i < PCI_LAMPS; ++i) {
        for (size_t p = 0; p < points->count; p += LANES) {
            VEC cosine = {0}, place[3], position[3];
            for (size_t k = 0; k < 3; ++k) {
                cosine += load(&points->normal[k][p]) * dome->directions[k][i];
                position[k] = load(&points->position[k][p]);
            }
            const MASK faces = cosine > 0;
            if (!ANY(faces)) {
                continue;
            }
            for (size_t k = 0; k < 3; ++k) {
                place[k] = (k < 2 ? 0.5F * PCI_SHADOW_SIDE : 0.5F * PCI_NEAREST) +
                           (position[0] * dome->axes[k][0][i] + position[1] * dome->axes[k][1][i] +
                            position[2] * dome->axes[k][2][i]);
            }
            const VEC seen = visibility(&shadows[i * PCI_SHADOW_TEXELS], place);
            const VEC share = choose(faces, intensities[i] * cosine * seen, splat(0.0F));
            store(&points->light[p], load(&points->light[p]) + share);
        }
    }
}

// ---- views: one sample per lane ---------------------------------------------------------------

// Of the edge from `a` up to `b`, x by y. Both triangles at an edge compute the same.
INLINE double edge_slope(const double *a, const double *b) { return (b[0] - a[0]) / (b[1] - a[1]); }

// Depths grow by `by_x` from one sample to the next.
INLINE void cover_row(float *depths, uint32_t *triangles, uint32_t count, float depth, float by_x,
                      uint32_t id) {
    MASK number = {0};
    for (int32_t l = 0; l < LANES; ++l) {
        number[l] = l;
    }
    for (uint32_t i = 0; i < count; i += LANES, number += LANES) {
        const VEC here = depth + convert(number) * by_x, old = load(&depths[i]);
        const MASK nearer = (here > old) & (number < (int32_t)count);
        store(&depths[i], choose(nearer, here, old));
        LOOSE_MASK *at = (LOOSE_MASK *)(void *)&triangles[i];
        *at = (nearer & (int32_t)id) | (~nearer & *at);
    }
}

// Corners are x, y, depth.
INLINE void cover_triangle(pci_canvas *canvas, const double *a, const double *b, const double *c,
                           uint32_t id) {
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
    const uint32_t last_row = canvas->first_row + canvas->row_count;
    const uint32_t first_row = pci_first_sample(low[1], canvas->first_row, last_row);
    const uint32_t end_row = pci_first_sample(high[1], canvas->first_row, last_row);
    const double det = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
    if (first_row == end_row || !(fabs(det) > 0.0) || !isfinite(det)) {
        return;
    }
    const double scale = 1.0 / det, first_depth = a[2] - (det > 0.0 ? canvas->back_offset : 0.0);
    const double by_x = ((b[2] - a[2]) * (c[1] - a[1]) - (c[2] - a[2]) * (b[1] - a[1])) * scale;
    const double by_y = ((c[2] - a[2]) * (b[0] - a[0]) - (b[2] - a[2]) * (c[0] - a[0])) * scale;
    const double long_slope = edge_slope(low, high);
    const double slopes[2] = {edge_slope(low, middle), edge_slope(middle, high)};
    for (uint32_t row = first_row; row < end_row; ++row) {
        const double y = (double)row + 0.5;
        const double x0 = low[0] + long_slope * (y - low[1]);
        const double x1 = y < middle[1] ? low[0] + slopes[0] * (y - low[1])
                                        : middle[0] + slopes[1] * (y - middle[1]);
        const uint32_t begin = pci_first_sample(x0 < x1 ? x0 : x1, canvas->left, canvas->right);
        const uint32_t end = pci_first_sample(x0 < x1 ? x1 : x0, canvas->left, canvas->right);
        const size_t at = (size_t)(row - canvas->first_row) * canvas->width + begin;
        const double depth = first_depth + by_y * (y - a[1]) + by_x * ((double)begin + 0.5 - a[0]);
        cover_row(&canvas->depths[at], &canvas->triangles[at], end - begin, (float)depth,
                  (float)by_x, id);
    }
}

static void cover(pci_canvas *canvas, const double *corners, const uint32_t *triangles,
                  const uint32_t *list, size_t count) {
    for (size_t i = 0; i < count; ++i) {
        const uint32_t *v = &triangles[3 * (size_t)list[i]];
        cover_triangle(canvas, &corners[3 * (size_t)v[0]], &corners[3 * (size_t)v[1]],
                       &corners[3 * (size_t)v[2]], list[i]);
    }
}

const pci_dome_kernel KERNEL = {cast, cover, light};
