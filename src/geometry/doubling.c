#include "geometry/doubling.h"

#include "geometry/topology.h"

#define SAMPLE_COUNT PCI_EFFORT(4096, 32) // standard error below .8 %
#define REACH        2.0                  // voxels between two layers that count as close
#define LEAST_COSINE 0.8                  // their normals differ by less than 37 degrees
#define BEYOND       0.5                  // voxels behind two layers where their sheets may lie
#define LEAST_GAP    0.05                 // voxels between two sheets; closer ones are copies
enum { MOST_SHEETS = 256 };               // along the line through a sample

typedef struct sampling {
    const pc_mesh *mesh;
    const pci_bvh *bvh, *garment;
    const double *areas; // summed up to and with each triangle
    double voxel;
    bool outward;             // the front of `mesh` is its outside
    uint8_t *close, *surplus; // per sample
} sampling;

// Where a line meets a surface. Beyond MOST_SHEETS places are only counted.
typedef struct places {
    double along[MOST_SHEETS];
    bool front[MOST_SHEETS]; // it shows its front to the begin of the line
    size_t count;
} places;

static void add_place(places *p, const pci_hit *hit) {
    if (p->count < MOST_SHEETS) {
        p->along[p->count] = hit->distance;
        p->front[p->count] = !hit->back_face;
    }
    ++p->count;
}

// A filter that notes every hit and accepts none, so that the search goes on.
static bool note_hit(void *user, const pci_hit *hit) {
    add_place(user, hit);
    return false;
}

typedef struct layer_filter {
    const pc_mesh *mesh;
    uint32_t triangle;
    double normal[3];
    places layers;
} layer_filter;

// Notes triangles of another layer: apart from the sampled one, and nearly parallel to it.
static bool note_layer(void *user, const pci_hit *hit) {
    layer_filter *filter = user;
    const uint32_t *a = &filter->mesh->triangles[3 * (size_t)filter->triangle];
    const uint32_t *b = &filter->mesh->triangles[3 * (size_t)hit->triangle];
    for (size_t i = 0; i < 3; ++i) {
        if (a[i] == b[0] || a[i] == b[1] || a[i] == b[2]) {
            return false;
        }
    }
    double normal[3];
    pci_triangle_vector(filter->mesh, hit->triangle, normal);
    if (pci_normalize(normal) && fabs(pci_dot(normal, filter->normal)) > LEAST_COSINE) {
        add_place(&filter->layers, hit);
    }
    return false;
}

// A line through a sample, along the normal.
typedef struct line {
    double origin[3], direction[3];
} line;

// Where on the line the sheet of the garment lies that is closest to the layer at `along`.
static double closest_sheet(const sampling *s, const line *l, double along) {
    double point[3], away[3];
    for (size_t k = 0; k < 3; ++k) {
        point[k] = l->origin[k] + along * l->direction[k];
    }
    const pci_closest closest = pci_bvh_closest(s->garment, point, INFINITY);
    pci_sub(closest.point, l->origin, away);
    return pci_dot(away, l->direction);
}

// Whether the line meets two sheets of the garment from `begin` to `end`.
static bool two_sheets(const sampling *s, const line *l, double begin, double end) {
    places sheets = {.count = 0};
    (void)pci_bvh_cast(s->garment, l->origin, l->direction, begin, end, note_hit, &sheets);
    double least = INFINITY, most = -INFINITY;
    for (size_t i = 0; i < sheets.count && i < MOST_SHEETS; ++i) {
        least = fmin(least, sheets.along[i]), most = fmax(most, sheets.along[i]);
    }
    return most - least > LEAST_GAP * s->voxel;
}

// Whether the layer at `own` and another one lie over the same sheet of the garment. Where they
// show each other their outsides, any two sheets are two.
static bool share_sheet(const sampling *s, const line *l, const places *layers, double own) {
    const double beyond = BEYOND * s->voxel, sheet = closest_sheet(s, l, own);
    bool shared = layers->count > MOST_SHEETS; // so many within a few voxels are over the same one
    for (size_t i = 0; i < layers->count && !shared; ++i) {
        const double other = layers->along[i];
        const bool faced = layers->front[i] && (other > own) == s->outward;
        shared = fabs(closest_sheet(s, l, other) - sheet) < s->voxel &&
                 !(faced && two_sheets(s, l, fmin(own, other) - beyond, fmax(own, other) + beyond));
    }
    return shared;
}

// Whether the front looks away from the middle, on the whole.
static bool looks_outward(const pc_mesh *mesh, double total) {
    double centre[3] = {0.0}, sum = 0.0;
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        double middle[3];
        const double share = pci_triangle_area(mesh, t) / total;
        pci_triangle_middle(mesh, t, middle);
        for (size_t k = 0; k < 3; ++k) {
            centre[k] += share * middle[k];
        }
    }
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        double middle[3], away[3], normal[3];
        pci_triangle_middle(mesh, t, middle);
        pci_triangle_vector(mesh, t, normal);
        pci_sub(middle, centre, away);
        sum += pci_dot(away, normal);
    }
    return sum >= 0.0;
}

// Casts one ray through each sample, along the normal and from both sides.
static void cast_samples(void *user, size_t begin, size_t end, uint32_t worker) {
    sampling *s = user;
    (void)worker;
    const double total = s->areas[s->mesh->triangle_count - 1], reach = REACH * s->voxel;
    for (size_t i = begin; i < end; ++i) {
        // Stratified by area over the triangles, uniform within one.
        const double target = total * (((double)i + pci_random(0, 0, i)) / SAMPLE_COUNT);
        size_t low = 0, high = s->mesh->triangle_count - 1;
        while (low < high) {
            const size_t middle = (low + high) / 2;
            if (s->areas[middle] > target) {
                high = middle;
            } else {
                low = middle + 1;
            }
        }
        layer_filter filter = {.mesh = s->mesh, .triangle = (uint32_t)low};
        pci_triangle_vector(s->mesh, low, filter.normal);
        if (!pci_normalize(filter.normal)) {
            continue;
        }
        const double root = sqrt(pci_random(0, 1, i)), along = pci_random(0, 2, i);
        const double weight[3] = {1.0 - root, root * (1.0 - along), root * along};
        line l;
        for (size_t k = 0; k < 3; ++k) {
            l.direction[k] = filter.normal[k];
            l.origin[k] = -2.0 * reach * filter.normal[k];
            for (size_t c = 0; c < 3; ++c) {
                const size_t v = s->mesh->triangles[3 * low + c];
                l.origin[k] += weight[c] * s->mesh->positions[3 * v + k];
            }
        }
        (void)pci_bvh_cast(s->bvh, l.origin, l.direction, reach, 3.0 * reach, note_layer, &filter);
        s->close[i] = filter.layers.count > 0;
        s->surplus[i] = s->close[i] && share_sheet(s, &l, &filter.layers, 2.0 * reach);
    }
}

pc_status pci_measure_doubling(pc_context *context, const char *stage, const pc_mesh *mesh,
                               const pci_bvh *bvh, const pci_bvh *garment, double voxel,
                               pci_doubling *result) {
    *result = (pci_doubling){0};
    pci_scratch scratch = pci_scratch_begin(context);
    double *areas = PCI_SCRATCH(&scratch, double, mesh->triangle_count);
    uint8_t *close = PCI_SCRATCH(&scratch, uint8_t, SAMPLE_COUNT);
    uint8_t *surplus = PCI_SCRATCH(&scratch, uint8_t, SAMPLE_COUNT);
    if (scratch.failed) {
        pci_scratch_end(&scratch);
        return pci_fail_memory(context, stage);
    }
    double total = 0.0;
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        total += pci_triangle_area(mesh, t);
        areas[t] = total;
    }
    sampling s = {.mesh = mesh,
                  .bvh = bvh,
                  .garment = garment,
                  .areas = areas,
                  .voxel = voxel,
                  .close = close,
                  .surplus = surplus};
    if (total > 0.0) {
        s.outward = looks_outward(mesh, total);
        pci_parallel_for(context, SAMPLE_COUNT, 128, cast_samples, &s);
        for (size_t i = 0; i < SAMPLE_COUNT; ++i) {
            result->close += close[i];
            result->surplus += surplus[i];
        }
    }
    result->close /= SAMPLE_COUNT;
    result->surplus /= SAMPLE_COUNT;
    pci_scratch_end(&scratch);
    return PC_OK;
}
