#include "geometry/doubling.h"

#include <stdlib.h>

#include "geometry/topology.h"

#define SAMPLE_COUNT PCI_EFFORT(4096, 32) // standard error below .8 %
#define REACH        2.0                  // voxels between two layers that count as close
#define LEAST_COSINE 0.8                  // their normals differ by less than 37 degrees
enum { MOST_SHEETS = 256 };               // along the line through a sample

typedef struct sampling {
    const pc_mesh *mesh;
    const pci_bvh *bvh, *garment;
    const double *areas; // summed up to and with each triangle
    double voxel;
    uint8_t *close, *surplus; // per sample
} sampling;

// Where a line meets a surface. Beyond MOST_SHEETS places are only counted.
typedef struct places {
    double along[MOST_SHEETS];
    size_t count;
} places;

static void add_place(places *p, double along) {
    if (p->count < MOST_SHEETS) {
        p->along[p->count] = along;
    }
    ++p->count;
}

// A filter that notes every hit and accepts none, so that the search goes on.
static bool note_hit(void *user, const pci_hit *hit) {
    add_place(user, hit->distance);
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
        add_place(&filter->layers, hit->distance);
    }
    return false;
}

static int compare_numbers(const void *left, const void *right) {
    const double a = *(const double *)left, b = *(const double *)right;
    return (a > b) - (a < b);
}

// The first place of the sheet nearest to `along`; 0 where there is none.
static size_t nearest_sheet(const places *sorted, double along, double voxel) {
    size_t nearest = 0;
    for (size_t i = 1; i < sorted->count; ++i) {
        if (fabs(sorted->along[i] - along) < fabs(sorted->along[nearest] - along)) {
            nearest = i;
        }
    }
    while (nearest > 0 && sorted->along[nearest] - sorted->along[nearest - 1] < voxel) {
        --nearest;
    }
    return nearest;
}

// Whether one sheet of the garment is nearest to the layer at `along` and to another one.
static bool shares_sheet(const places *layers, places *garment, double along, double voxel) {
    if (layers->count > MOST_SHEETS || garment->count > MOST_SHEETS) {
        return true; // where so many sheets lie within a few voxels they are one
    }
    qsort(garment->along, garment->count, sizeof(*garment->along), compare_numbers);
    const size_t own = nearest_sheet(garment, along, voxel);
    for (size_t i = 0; i < layers->count; ++i) {
        if (nearest_sheet(garment, layers->along[i], voxel) == own) {
            return true;
        }
    }
    return false;
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
        double origin[3];
        for (size_t k = 0; k < 3; ++k) {
            origin[k] = -2.0 * reach * filter.normal[k];
            for (size_t c = 0; c < 3; ++c) {
                const size_t v = s->mesh->triangles[3 * low + c];
                origin[k] += weight[c] * s->mesh->positions[3 * v + k];
            }
        }
        (void)pci_bvh_cast(s->bvh, origin, filter.normal, reach, 3.0 * reach, note_layer, &filter);
        s->close[i] = filter.layers.count > 0;
        if (s->close[i]) {
            places garment = {.count = 0};
            (void)pci_bvh_cast(s->garment, origin, filter.normal, 0.0, 4.0 * reach, note_hit,
                               &garment);
            s->surplus[i] = shares_sheet(&filter.layers, &garment, 2.0 * reach, s->voxel);
        }
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
    sampling s = {mesh, bvh, garment, areas, voxel, close, surplus};
    if (total > 0.0) {
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
