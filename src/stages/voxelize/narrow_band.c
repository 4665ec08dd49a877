// The distance to a surface on the lattice points near it, found by a descent in an octree.
#include "stages/voxelize/voxelize_internal.h"

static const char stage[] = "voxelize";

// Lattice points beyond the bounding box, both sides together. With 8 the outermost layer is at
// least 3.5 cells away, and a flat sheet (or the flat end of a garment) lies half-way between
// lattice planes: never where the iso-surface would touch the samples themselves.
#define EXTRA_POINTS 8

// The lattice is searched as an octree whose leaves hold LEAF^3 lattice points.
enum { LEAF_LEVEL = 2, LEAF = 1 << LEAF_LEVEL, LEAF_POINTS = LEAF * LEAF * LEAF };

// A cube of side^3 lattice points; `at` counts in units of the side.
typedef struct block {
    uint16_t at[3];
} block;

typedef struct voxelization {
    pc_context *context;
    const pc_mesh *surface;
    const pci_bvh *bvh;
    pc_grid grid;
    uint64_t queries;

    size_t block_count;
    block *blocks;  // of the current level, ascending by (z, y, x)
    uint32_t level; // side = 1 << level
    uint8_t *keep;  // per block: may hold samples

    float *values;        // per leaf, LEAF_POINTS distances, INFINITY where there is no sample
    uint8_t *sampled;     // per leaf, number of samples
    uint8_t *computed;    // per leaf, number of queries
    size_t first;         // leaf where the running batch starts
    size_t slab_count;    // leaves with equal z
    size_t *slabs;        // #slabs + 1, first leaf
    size_t *slab_samples; // #slabs + 1, first sample
} voxelization;

// ---- lattice ------------------------------------------------------------------------------------

pc_status pci_place_lattice(pc_context *context, const pc_mesh *surface, uint32_t voxels,
                            double band_voxels, pc_grid *grid) {
    double minimum[3], maximum[3], side = 0.0;
    for (size_t k = 0; k < 3; ++k) {
        minimum[k] = INFINITY, maximum[k] = -INFINITY;
        for (size_t i = 0; i < 3 * surface->triangle_count; ++i) {
            const double x = surface->positions[3 * (size_t)surface->triangles[i] + k];
            minimum[k] = fmin(minimum[k], x);
            maximum[k] = fmax(maximum[k], x);
        }
        side = fmax(side, maximum[k] - minimum[k]);
    }
    grid->cell_size = side / voxels;
    if (!(grid->cell_size > 0.0) || !isfinite(grid->cell_size)) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "%s: the surface has no extent, its longest side is %g", stage, side);
    }
    grid->band = band_voxels * grid->cell_size;
    for (size_t k = 0; k < 3; ++k) {
        // Rounding must not turn a whole number of cells into the next one.
        const double cells = ceil((maximum[k] - minimum[k]) / grid->cell_size - 1e-9);
        grid->size[k] = (uint32_t)cells + EXTRA_POINTS;
        grid->origin[k] =
            0.5 * (minimum[k] + maximum[k]) - 0.5 * (double)(grid->size[k] - 1) * grid->cell_size;
    }
    return PC_OK;
}

// Centre of the lattice points of a block.
static void block_centre(const voxelization *v, const block *b, double centre[3]) {
    const double side = (double)(1u << v->level);
    for (size_t k = 0; k < 3; ++k) {
        centre[k] = v->grid.origin[k] + v->grid.cell_size * ((b->at[k] + 0.5) * side - 0.5);
    }
}

// ---- descent ------------------------------------------------------------------------------------

static void test_blocks(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    voxelization *v = user;
    const double half_side = 0.5 * ((double)(1u << v->level) - 1.0) * v->grid.cell_size;
    // The distance is 1-Lipschitz: nothing in the block is closer than centre - half diagonal.
    const double radius = (v->grid.band + sqrt(3.0) * half_side) * (1.0 + 1e-9);
    for (size_t i = begin; i < end; ++i) {
        double centre[3];
        block_centre(v, &v->blocks[i], centre);
        v->keep[i] = pci_bvh_within(v->bvh, centre, radius);
    }
}

// End of the run of blocks that starts at `begin` and shares the coordinates from axis `k` up.
static size_t run_end(const block *blocks, size_t count, size_t begin, size_t k) {
    size_t end = begin + 1;
    while (end < count && blocks[end].at[2] == blocks[begin].at[2] &&
           (k == 2 || blocks[end].at[1] == blocks[begin].at[1])) {
        ++end;
    }
    return end;
}

// Replaces the blocks by those of their children that touch the lattice, again in (z, y, x) order.
static bool split_blocks(pci_scratch *scratch, voxelization *v) {
    block *children = PCI_SCRATCH(scratch, block, 8 * v->block_count);
    if (children == NULL) {
        return false;
    }
    const uint32_t level = v->level - 1;
    size_t count = 0, plane_end = 0, row_end = 0;
    for (size_t plane = 0; plane < v->block_count; plane = plane_end) {
        plane_end = run_end(v->blocks, v->block_count, plane, 2);
        for (uint32_t dz = 0; dz < 2; ++dz) {
            for (size_t row = plane; row < plane_end; row = row_end) {
                row_end = run_end(v->blocks, plane_end, row, 1);
                for (uint32_t dy = 0; dy < 2; ++dy) {
                    for (size_t i = 2 * row; i < 2 * row_end; ++i) {
                        const block *parent = &v->blocks[i / 2];
                        const uint32_t at[3] = {2u * parent->at[0] + (uint32_t)(i & 1),
                                                2u * parent->at[1] + dy, 2u * parent->at[2] + dz};
                        if (at[0] << level < v->grid.size[0] && at[1] << level < v->grid.size[1] &&
                            at[2] << level < v->grid.size[2]) {
                            children[count++] =
                                (block){{(uint16_t)at[0], (uint16_t)at[1], (uint16_t)at[2]}};
                        }
                    }
                }
            }
        }
    }
    v->blocks = children;
    v->block_count = count;
    v->level = level;
    return true;
}

// Descends to the leaf blocks that may hold samples.
static pc_status find_leaves(pci_scratch *scratch, voxelization *v) {
    const uint32_t *size = v->grid.size;
    uint32_t largest = size[0] > size[1] ? size[0] : size[1];
    largest = size[2] > largest ? size[2] : largest;
    v->level = LEAF_LEVEL;
    while (1u << v->level < largest) {
        ++v->level;
    }
    v->blocks = PCI_SCRATCH(scratch, block, 1);
    v->block_count = 1;
    while (v->level > LEAF_LEVEL) {
        if (scratch->failed || !split_blocks(scratch, v)) {
            break;
        }
        v->keep = PCI_SCRATCH(scratch, uint8_t, v->block_count);
        if (v->keep == NULL) {
            break;
        }
        pci_parallel_for(v->context, v->block_count, 256, test_blocks, v);
        v->queries += v->block_count;
        size_t kept = 0;
        for (size_t i = 0; i < v->block_count; ++i) {
            if (v->keep[i]) {
                v->blocks[kept++] = v->blocks[i];
            }
        }
        v->block_count = kept;
    }
    return scratch->failed ? pci_fail_memory(v->context, stage) : PC_OK;
}

// ---- samples ------------------------------------------------------------------------------------

// Leaf blocks with at most this many triangles in reach compare all of them at every sample, others
// search the tree for each sample. Anything from 4 to 16 takes the same time.
enum { MOST_CANDIDATES = 12 };

typedef struct nearest {
    double squared_distance;
    uint32_t triangle;
} nearest;

static void compare(const pc_mesh *surface, const double point[3], uint32_t triangle,
                    nearest *best) {
    const uint32_t *corner = &surface->triangles[3 * (size_t)triangle];
    double barycentric[3];
    const double d2 =
        pci_triangle_squared_distance(point, &surface->positions[3 * (size_t)corner[0]],
                                      &surface->positions[3 * (size_t)corner[1]],
                                      &surface->positions[3 * (size_t)corner[2]], barycentric);
    if (d2 < best->squared_distance) {
        *best = (nearest){d2, triangle};
    }
}

// Distances at the lattice points of one leaf block; returns how many were computed.
static uint32_t sample_leaf(const voxelization *v, const block *leaf, float *values) {
    const pc_grid *grid = &v->grid;
    double centre[3];
    block_centre(v, leaf, centre);
    const double half_diagonal = sqrt(3.0) * 0.5 * (LEAF - 1) * grid->cell_size;
    const double reach = (grid->band + half_diagonal) * (1.0 + 1e-9);
    uint32_t candidates[MOST_CANDIDATES];
    const size_t candidate_count =
        pci_bvh_collect(v->bvh, centre, reach, MOST_CANDIDATES, candidates);
    uint32_t computed = 1;

    nearest last = {.triangle = PC_INVALID_INDEX};
    for (uint32_t i = 0; i < LEAF_POINTS; ++i) {
        values[i] = INFINITY;
        const uint32_t offset[3] = {i % LEAF, i / LEAF % LEAF, i / (LEAF * LEAF)};
        double point[3];
        bool outside = candidate_count == 0;
        for (size_t k = 0; k < 3; ++k) {
            const uint32_t at = LEAF * leaf->at[k] + offset[k];
            outside |= at >= grid->size[k];
            point[k] = grid->origin[k] + grid->cell_size * at;
        }
        if (outside) {
            continue;
        }
        ++computed;
        double distance = INFINITY;
        if (candidate_count <= MOST_CANDIDATES) {
            nearest best = {INFINITY, PC_INVALID_INDEX};
            for (size_t c = 0; c < candidate_count; ++c) {
                compare(v->surface, point, candidates[c], &best);
            }
            distance = sqrt(best.squared_distance);
        } else {
            // The last sample's triangle bounds the search.
            nearest bound = {INFINITY, PC_INVALID_INDEX};
            if (last.triangle != PC_INVALID_INDEX) {
                compare(v->surface, point, last.triangle, &bound);
            }
            const double radius = fmin(grid->band, sqrt(bound.squared_distance) * (1.0 + 1e-12));
            const pci_closest closest = pci_bvh_closest(v->bvh, point, radius);
            if (closest.triangle != PC_INVALID_INDEX) {
                distance = closest.distance;
                last.triangle = closest.triangle;
            }
        }
        if (distance <= grid->band) {
            values[i] = (float)distance;
        }
    }
    return computed;
}

static void sample_leaves(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    voxelization *v = user;
    for (size_t i = v->first + begin; i < v->first + end; ++i) {
        float *values = &v->values[LEAF_POINTS * i];
        v->computed[i] = (uint8_t)sample_leaf(v, &v->blocks[i], values);
        for (uint32_t k = 0; k < LEAF_POINTS; ++k) {
            v->sampled[i] = (uint8_t)(v->sampled[i] + (values[k] < INFINITY));
        }
    }
}

static pc_status sample_band(pci_scratch *scratch, voxelization *v, const pci_narrow_band *band) {
    v->values = PCI_SCRATCH(scratch, float, LEAF_POINTS * v->block_count);
    v->sampled = PCI_SCRATCH(scratch, uint8_t, v->block_count);
    v->computed = PCI_SCRATCH(scratch, uint8_t, v->block_count);
    if (scratch->failed) {
        return pci_fail_memory(v->context, stage);
    }
    const size_t batch = 4096;
    for (v->first = 0; v->first < v->block_count; v->first += batch) {
        const size_t left = v->block_count - v->first;
        pci_parallel_for(v->context, left < batch ? left : batch, 16, sample_leaves, v);
        const double done = (double)v->first / (double)v->block_count;
        if (!pci_progress(v->context, stage, band->from + done * (band->to - band->from))) {
            return pci_fail_cancelled(v->context, stage);
        }
    }
    return PC_OK;
}

// Writes the samples of each slab in lattice order.
static void write_slabs(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    voxelization *v = user;
    for (size_t slab = begin; slab < end; ++slab) {
        size_t next = v->slab_samples[slab], row_end = 0;
        for (uint32_t dz = 0; dz < LEAF; ++dz) {
            for (size_t row = v->slabs[slab]; row < v->slabs[slab + 1]; row = row_end) {
                row_end = run_end(v->blocks, v->slabs[slab + 1], row, 1);
                for (uint32_t dy = 0; dy < LEAF; ++dy) {
                    const uint64_t z = LEAF * (uint64_t)v->blocks[row].at[2] + dz;
                    const uint64_t y = LEAF * (uint64_t)v->blocks[row].at[1] + dy;
                    const uint64_t start = v->grid.size[0] * (y + v->grid.size[1] * z);
                    for (size_t i = LEAF * row; i < LEAF * row_end; ++i) {
                        const size_t leaf = i / LEAF, dx = i % LEAF;
                        const float value =
                            v->values[LEAF_POINTS * leaf + dx + LEAF * (dy + LEAF * dz)];
                        if (value < INFINITY) {
                            v->grid.samples[next] = start + LEAF * v->blocks[leaf].at[0] + dx;
                            v->grid.values[next++] = value;
                        }
                    }
                }
            }
        }
    }
}

static pc_status gather_samples(pci_scratch *scratch, voxelization *v) {
    v->slabs = PCI_SCRATCH(scratch, size_t, v->grid.size[2] / LEAF + 2);
    v->slab_samples = PCI_SCRATCH(scratch, size_t, v->grid.size[2] / LEAF + 2);
    if (scratch->failed) {
        return pci_fail_memory(v->context, stage);
    }
    size_t count = 0;
    for (size_t i = 0; i < v->block_count; ++i) {
        if (i == 0 || v->blocks[i].at[2] != v->blocks[i - 1].at[2]) {
            v->slabs[v->slab_count] = i;
            v->slab_samples[v->slab_count++] = count;
        }
        count += v->sampled[i];
        v->queries += v->computed[i];
    }
    v->slabs[v->slab_count] = v->block_count;
    v->slab_samples[v->slab_count] = count;

    v->grid.sample_count = count;
    v->grid.samples = PCI_ALLOCATE(v->context, uint64_t, count);
    v->grid.values = PCI_ALLOCATE(v->context, float, count);
    if (v->grid.samples == NULL || v->grid.values == NULL) {
        pc_grid_free(v->context, &v->grid);
        return pci_fail_memory(v->context, stage);
    }
    pci_parallel_for(v->context, v->slab_count, 1, write_slabs, v);
    return PC_OK;
}

pc_status pci_sample_narrow_band(pc_context *context, const pc_mesh *surface, const pci_bvh *bvh,
                                 const pci_narrow_band *band, pc_grid *grid, uint64_t *queries) {
    voxelization v = {.context = context, .surface = surface, .bvh = bvh};
    pci_scratch scratch = pci_scratch_begin(context);
    pc_status status = pci_place_lattice(context, surface, band->voxels, band->width, &v.grid);
    if (status == PC_OK) {
        status = find_leaves(&scratch, &v);
    }
    if (status == PC_OK) {
        status = sample_band(&scratch, &v, band);
    }
    if (status == PC_OK) {
        status = gather_samples(&scratch, &v);
    }
    pci_scratch_end(&scratch);
    if (status == PC_OK) {
        *grid = v.grid;
        *queries += v.queries;
    }
    return status;
}
