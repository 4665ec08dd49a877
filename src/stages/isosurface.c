#include "proxycloth/isosurface.h"

#include "geometry/topology.h"
#include "stages/marching_cubes.h"

static const char stage[] = "isosurface";

static const pc_field option_fields[] = {
    PCI_FIELD_OPTION(pc_isosurface_options, iso_voxels, DOUBLE, 1.0, 0.5, 1.0, "voxels",
                     "Distance of the closed surface from the garment"),
};
const pc_record pc_isosurface_options_record = PCI_RECORD(option_fields, pc_isosurface_options);

static const pc_field report_fields[] = {
    PCI_FIELD_REPORT(pc_isosurface_report, vertices, COUNT, "", "Vertices of the closed surface"),
    PCI_FIELD_REPORT(pc_isosurface_report, triangles, COUNT, "", "Triangles of the closed surface"),
    PCI_FIELD_REPORT(pc_isosurface_report, components, COUNT, "",
                     "Closed surfaces; a hollow inside adds one"),
};
const pc_record pc_isosurface_report_record = PCI_RECORD(report_fields, pc_isosurface_report);

// Lattice points that lie exactly on the iso-surface, as on flat input, count as inside.
#define ISO_SLACK 1e-6

// Vertices keep this distance, in cells, from the ends of their lattice edge. It moves one vertex
// in five, by .05 cells on average, and no triangle has an angle below 5 degrees (6 % of them
// without it, on 13 garments at N_v = 32).
#define END_CLEARANCE 0.1

// ---- the rule -----------------------------------------------------------------------------------

// Corner i of a cell is at (i & 1, i >> 1 & 1, i >> 2). A surface vertex lies on an edge with one
// inside end, and is named 3 * inside corner + axis of the edge.
enum { MOST_LOOPS = 4, LONGEST_LOOP = 7, MOST_LOOP_VERTICES = 12 };

// The loops in which the surface meets the faces of a cell, one after the other.
typedef struct cell_case {
    uint8_t loop_count;
    uint8_t triangle_count;
    uint8_t loop_sizes[MOST_LOOPS];
    uint8_t vertices[MOST_LOOP_VERTICES];
    // Bit j of entry i: vertices i and j of the same loop lie in a common face of the cell. A
    // triangle edge between them might also be made by the neighbour there, so it is forbidden
    // unless they are consecutive.
    uint8_t in_face[MOST_LOOP_VERTICES];
} cell_case;

// Corners of face 2 * axis + side, counter-clockwise seen from outside the cell.
static void face_corners(uint32_t face, uint32_t corners[4]) {
    const uint32_t axis = face / 2, side = face % 2;
    const uint32_t u = 1u << (axis + 1) % 3, v = 1u << (axis + 2) % 3;
    const uint32_t base = side << axis;
    corners[0] = base;
    corners[1] = base | (side ? u : v);
    corners[2] = base | u | v;
    corners[3] = base | (side ? v : u);
}

static uint8_t vertex_name(uint32_t inside_corner, uint32_t outside_corner) {
    const uint32_t bit = inside_corner ^ outside_corner;
    return (uint8_t)(3 * inside_corner + (bit == 1 ? 0 : bit == 2 ? 1 : 2));
}

// Bit per face that holds the edge of a vertex.
static uint32_t faces_of(uint8_t vertex) {
    const uint32_t corner = vertex / 3, axis = vertex % 3;
    const uint32_t u = (axis + 1) % 3, v = (axis + 2) % 3;
    return 1u << (2 * u + (corner >> u & 1)) | 1u << (2 * v + (corner >> v & 1));
}

// On each face every run of inside corners is cut off on its own; where two inside corners face
// each other across a diagonal they are thereby separated, whichever cell looks. The cuts run with
// the outside on their right as seen from outside the cell, and join into loops.
static void derive_case(uint32_t inside, cell_case *result) {
    enum { NONE = 24 };
    uint8_t next[NONE];
    memset(next, NONE, sizeof(next));
    for (uint32_t face = 0; face < 6; ++face) {
        uint32_t corners[4];
        face_corners(face, corners);
        for (uint32_t i = 0; i < 4; ++i) {
            const uint32_t before = corners[(i + 3) % 4];
            if (!(inside >> corners[i] & 1) || inside >> before & 1) {
                continue;
            }
            uint32_t last = i;
            while (inside >> corners[(last + 1) % 4] & 1) {
                ++last;
            }
            next[vertex_name(corners[i], before)] =
                vertex_name(corners[last % 4], corners[(last + 1) % 4]);
        }
    }
    memset(result, 0, sizeof(*result));
    uint32_t begin = 0;
    for (uint8_t start = 0; start < NONE; ++start) {
        uint32_t end = begin;
        for (uint8_t v = start; next[v] != NONE;) {
            const uint8_t following = next[v];
            next[v] = NONE;
            result->vertices[end++] = v;
            v = following;
        }
        if (end == begin) {
            continue;
        }
        for (uint32_t i = begin; i < end; ++i) {
            for (uint32_t j = begin; j < end; ++j) {
                const bool common =
                    (faces_of(result->vertices[i]) & faces_of(result->vertices[j])) != 0;
                result->in_face[i] |= (uint8_t)((uint32_t)common << (j - begin));
            }
        }
        result->loop_sizes[result->loop_count++] = (uint8_t)(end - begin);
        result->triangle_count = (uint8_t)(result->triangle_count + end - begin - 2);
        begin = end;
    }
}

// ---- sparse lattice -----------------------------------------------------------------------------

typedef struct extraction {
    const pc_grid *grid;
    double iso;
    cell_case cases[256];
    size_t row_count;       // rows of samples along x, (y, z) -> y + size[1] * z
    uint32_t *row_samples;  // #rows + 1, first sample
    size_t *row_vertices;   // #rows + 1, first vertex
    size_t *row_triangles;  // #rows + 1, first triangle of the cells with minimum corner in the row
    uint8_t *crossings;     // per sample, bit d: a vertex in direction d (-x +x -y +y -z +z)
    uint32_t *first_vertex; // per sample
    pc_mesh mesh;
} extraction;

static bool is_inside(const extraction *e, size_t sample) {
    return (double)e->grid->values[sample] < e->iso;
}

// Checks what the grid promises and finds its rows.
static pc_status index_rows(pc_context *context, extraction *e) {
    const pc_grid *grid = e->grid;
    const uint32_t *size = grid->size;
    uint64_t previous_row = 0;
    for (size_t i = 0; i < grid->sample_count; ++i) {
        const uint64_t row = grid->samples[i] / size[0];
        const uint64_t x = grid->samples[i] % size[0], y = row % size[1], z = row / size[1];
        if (row >= e->row_count || (i > 0 && grid->samples[i] <= grid->samples[i - 1])) {
            return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                            "%s: sample %zu of the grid is out of order or range", stage, i);
        }
        if (!(grid->values[i] >= 0.0f) || !isfinite(grid->values[i])) {
            return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                            "%s: value %zu of the grid is %g", stage, i, (double)grid->values[i]);
        }
        const bool border =
            x == 0 || x + 1 == size[0] || y == 0 || y + 1 == size[1] || z == 0 || z + 1 == size[2];
        if (border && is_inside(e, i)) {
            return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                            "%s: the iso-surface reaches the border of the lattice", stage);
        }
        while (previous_row < row) {
            e->row_samples[++previous_row] = (uint32_t)i;
        }
    }
    while (previous_row < e->row_count) {
        e->row_samples[++previous_row] = (uint32_t)grid->sample_count;
    }
    return PC_OK;
}

// The value at x in a row, or the band where there is no sample. The cursor moves up with x.
static double value_in_row(const extraction *e, size_t row, uint64_t x, uint32_t *cursor) {
    const uint64_t key = e->grid->size[0] * (uint64_t)row + x;
    while (*cursor < e->row_samples[row + 1] && e->grid->samples[*cursor] < key) {
        ++*cursor;
    }
    return *cursor < e->row_samples[row + 1] && e->grid->samples[*cursor] == key
               ? (double)e->grid->values[*cursor]
               : e->grid->band;
}

// ---- vertices -----------------------------------------------------------------------------------

// A walk over the inside samples of a row, with the values around them.
typedef struct row_walk {
    size_t row;
    uint32_t sample;
    uint64_t x;
    double around[6];    // -x +x -y +y -z +z
    size_t rows[6];      // row of each neighbour
    uint32_t cursors[6]; // position in that row
} row_walk;

static row_walk begin_walk(const extraction *e, size_t row) {
    row_walk walk = {.row = row, .sample = e->row_samples[row] - 1};
    if (e->row_samples[row] == e->row_samples[row + 1]) {
        return walk;
    }
    const size_t plane = e->grid->size[1];
    const size_t rows[6] = {row, row, row - 1, row + 1, row - plane, row + plane};
    for (size_t d = 0; d < 6; ++d) {
        // Rows beyond the lattice are never read: a border row has no inside sample.
        walk.rows[d] = rows[d];
        walk.cursors[d] = rows[d] < e->row_count ? e->row_samples[rows[d]] : 0;
    }
    return walk;
}

static bool next_inside(const extraction *e, row_walk *walk) {
    do {
        if (++walk->sample >= e->row_samples[walk->row + 1]) {
            return false;
        }
    } while (!is_inside(e, walk->sample));
    walk->x = e->grid->samples[walk->sample] - e->grid->size[0] * (uint64_t)walk->row;
    for (size_t d = 0; d < 6; ++d) {
        const uint64_t x = d == 0 ? walk->x - 1 : d == 1 ? walk->x + 1 : walk->x;
        walk->around[d] = value_in_row(e, walk->rows[d], x, &walk->cursors[d]);
    }
    return true;
}

// Which lattice edges carry a vertex, and how many there are in each row.
static void find_crossings(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    extraction *e = user;
    for (size_t row = begin; row < end; ++row) {
        size_t count = 0;
        for (row_walk walk = begin_walk(e, row); next_inside(e, &walk);) {
            for (uint32_t d = 0; d < 6; ++d) {
                if (walk.around[d] >= e->iso) {
                    e->crossings[walk.sample] |= (uint8_t)(1u << d);
                    ++count;
                }
            }
        }
        e->row_vertices[row + 1] = count;
    }
}

static void place_vertices(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    extraction *e = user;
    const pc_grid *grid = e->grid;
    for (size_t row = begin; row < end; ++row) {
        size_t vertex = e->row_vertices[row];
        for (row_walk walk = begin_walk(e, row); next_inside(e, &walk);) {
            e->first_vertex[walk.sample] = (uint32_t)vertex;
            const double value = grid->values[walk.sample];
            const double lattice[3] = {(double)walk.x, (double)(row % grid->size[1]),
                                       (double)(row / grid->size[1])};
            for (uint32_t d = 0; d < 6; ++d) {
                if (!(e->crossings[walk.sample] >> d & 1)) {
                    continue;
                }
                double t = (e->iso - value) / (walk.around[d] - value);
                t = fmin(fmax(t, END_CLEARANCE), 1.0 - END_CLEARANCE);
                double *position = &e->mesh.positions[3 * vertex++];
                for (size_t k = 0; k < 3; ++k) {
                    const double step = k != d / 2 ? 0.0 : d % 2 == 1 ? t : -t;
                    position[k] = grid->origin[k] + grid->cell_size * (lattice[k] + step);
                }
            }
        }
    }
}

// ---- triangles ----------------------------------------------------------------------------------

// A walk over the cells, along one row, that the surface crosses.
typedef struct cell_walk {
    size_t rows[4];      // (y, z), (y + 1, z), (y, z + 1), (y + 1, z + 1)
    uint32_t cursors[4]; // next inside sample of each row
    uint64_t x;          // of the cell's maximum corner
    uint32_t corners[8]; // sample of each inside corner
    uint32_t inside;     // bit per corner
} cell_walk;

static void skip_outside(const extraction *e, cell_walk *walk, size_t r) {
    const uint32_t end = e->row_samples[walk->rows[r] + 1];
    while (walk->cursors[r] < end && !is_inside(e, walk->cursors[r])) {
        ++walk->cursors[r];
    }
}

static cell_walk begin_cells(const extraction *e, size_t row) {
    const size_t plane = e->grid->size[1];
    cell_walk walk = {.rows = {row, row + 1, row + plane, row + plane + 1}};
    for (size_t r = 0; r < 4; ++r) {
        walk.cursors[r] = e->row_samples[walk.rows[r]];
        skip_outside(e, &walk, r);
    }
    return walk;
}

static uint64_t cursor_x(const extraction *e, const cell_walk *walk, size_t r) {
    return walk->cursors[r] < e->row_samples[walk->rows[r] + 1]
               ? e->grid->samples[walk->cursors[r]] - e->grid->size[0] * (uint64_t)walk->rows[r]
               : UINT64_MAX;
}

static bool next_cell(const extraction *e, cell_walk *walk) {
    do {
        // The right side becomes the left side: odd corners move to even ones.
        walk->inside = walk->inside >> 1 & 0x55;
        for (size_t r = 0; r < 4; ++r) {
            walk->corners[2 * r] = walk->corners[2 * r + 1];
        }
        ++walk->x;
        if (walk->inside == 0) {
            walk->x = UINT64_MAX;
            for (size_t r = 0; r < 4; ++r) {
                const uint64_t x = cursor_x(e, walk, r);
                walk->x = x < walk->x ? x : walk->x;
            }
            if (walk->x == UINT64_MAX) {
                return false;
            }
        }
        for (size_t r = 0; r < 4; ++r) {
            if (cursor_x(e, walk, r) == walk->x) {
                walk->inside |= 2u << 2 * r;
                walk->corners[2 * r + 1] = walk->cursors[r]++;
                skip_outside(e, walk, r);
            }
        }
    } while (walk->inside == 0xff);
    return true;
}

// Calls for the last row of a plane and the last plane would read beyond the lattice.
static bool has_cells(const extraction *e, size_t row) {
    return row % e->grid->size[1] + 1 < e->grid->size[1] && row + e->grid->size[1] < e->row_count;
}

static void count_triangles(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    extraction *e = user;
    for (size_t row = begin; row < end; ++row) {
        size_t count = 0;
        if (has_cells(e, row)) {
            for (cell_walk walk = begin_cells(e, row); next_cell(e, &walk);) {
                count += e->cases[walk.inside].triangle_count;
            }
        }
        e->row_triangles[row + 1] = count;
    }
}

static uint32_t surface_vertex(const extraction *e, const cell_walk *walk, uint8_t name) {
    const uint32_t corner = name / 3, axis = name % 3;
    const uint32_t sample = walk->corners[corner];
    const uint32_t direction = 2 * axis + (corner >> axis & 1 ? 0 : 1);
    uint32_t vertex = e->first_vertex[sample];
    for (uint32_t d = 0; d < direction; ++d) {
        vertex += (uint32_t)e->crossings[sample] >> d & 1;
    }
    return vertex;
}

// One loop while it is cut into triangles.
typedef struct loop_cut {
    uint32_t vertices[LONGEST_LOOP];
    uint8_t split[LONGEST_LOOP][LONGEST_LOOP]; // third corner on the chord from i to j
    uint32_t *triangles;                       // where the next one goes
} loop_cut;

static void write_triangles(loop_cut *cut, uint32_t i, uint32_t j) {
    if (j - i < 2) {
        return;
    }
    const uint32_t k = cut->split[i][j];
    write_triangles(cut, i, k);
    write_triangles(cut, k, j);
    *cut->triangles++ = cut->vertices[i];
    *cut->triangles++ = cut->vertices[k];
    *cut->triangles++ = cut->vertices[j];
}

// Triangulates a loop so that the squared lengths of the chords sum to the minimum, without chords
// in a face of the cell (dynamic programming over sub-loops i..j).
static void cut_loop(const extraction *e, const uint8_t *in_face, uint32_t size, loop_cut *cut) {
    double cost[LONGEST_LOOP][LONGEST_LOOP] = {0};
    for (uint32_t length = 2; length < size; ++length) {
        for (uint32_t i = 0; i + length < size; ++i) {
            const uint32_t j = i + length;
            double least = INFINITY;
            cut->split[i][j] = (uint8_t)(i + 1);
            for (uint32_t k = i + 1; k < j; ++k) {
                if (cost[i][k] + cost[k][j] < least) {
                    least = cost[i][k] + cost[k][j];
                    cut->split[i][j] = (uint8_t)k;
                }
            }
            if (length + 1 < size) {
                least +=
                    in_face[i] >> j & 1
                        ? (double)INFINITY
                        : pci_squared_distance(&e->mesh.positions[3 * (size_t)cut->vertices[i]],
                                               &e->mesh.positions[3 * (size_t)cut->vertices[j]]);
            }
            cost[i][j] = least;
        }
    }
    write_triangles(cut, 0, size - 1);
}

static void fill_cells(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    extraction *e = user;
    for (size_t row = begin; row < end; ++row) {
        if (!has_cells(e, row)) {
            continue;
        }
        loop_cut cut = {.triangles = &e->mesh.triangles[3 * e->row_triangles[row]]};
        for (cell_walk walk = begin_cells(e, row); next_cell(e, &walk);) {
            const cell_case *c = &e->cases[walk.inside];
            uint32_t first = 0;
            for (uint32_t loop = 0; loop < c->loop_count; ++loop) {
                const uint32_t size = c->loop_sizes[loop];
                for (uint32_t i = 0; i < size; ++i) {
                    cut.vertices[i] = surface_vertex(e, &walk, c->vertices[first + i]);
                }
                cut_loop(e, &c->in_face[first], size, &cut);
                first += size;
            }
        }
    }
}

// ---- stage --------------------------------------------------------------------------------------

static size_t accumulate(size_t *offsets, size_t count) {
    for (size_t i = 0; i < count; ++i) {
        offsets[i + 1] += offsets[i];
    }
    return offsets[count];
}

static pc_status extract(pc_context *context, pci_scratch *scratch, extraction *e) {
    const size_t row_grain = 64;
    e->row_samples = PCI_SCRATCH(scratch, uint32_t, e->row_count + 1);
    e->row_vertices = PCI_SCRATCH(scratch, size_t, e->row_count + 1);
    e->row_triangles = PCI_SCRATCH(scratch, size_t, e->row_count + 1);
    e->crossings = PCI_SCRATCH(scratch, uint8_t, e->grid->sample_count);
    e->first_vertex = PCI_SCRATCH(scratch, uint32_t, e->grid->sample_count);
    if (scratch->failed) {
        return pci_fail_memory(context, stage);
    }
    const pc_status status = index_rows(context, e);
    if (status != PC_OK) {
        return status;
    }
    for (uint32_t inside = 0; inside < 256; ++inside) {
        derive_case(inside, &e->cases[inside]);
    }
    if (!pci_parallel_while_wanted(context, e->row_count, row_grain, find_crossings, e) ||
        !pci_parallel_while_wanted(context, e->row_count, row_grain, count_triangles, e)) {
        return pci_fail_cancelled(context, stage);
    }
    e->mesh.vertex_count = accumulate(e->row_vertices, e->row_count);
    e->mesh.triangle_count = accumulate(e->row_triangles, e->row_count);
    if (e->mesh.triangle_count >= PC_INVALID_INDEX / 3) {
        return pci_fail(context, PC_ERROR_TOO_LARGE, stage, "%s: %zu triangles are too many", stage,
                        e->mesh.triangle_count);
    }
    e->mesh.positions = PCI_ALLOCATE(context, double, 3 * e->mesh.vertex_count);
    e->mesh.triangles = PCI_ALLOCATE(context, uint32_t, 3 * e->mesh.triangle_count);
    if (e->mesh.positions == NULL || e->mesh.triangles == NULL) {
        return pci_fail_memory(context, stage);
    }
    if (!pci_parallel_while_wanted(context, e->row_count, row_grain, place_vertices, e) ||
        !pci_parallel_while_wanted(context, e->row_count, row_grain, fill_cells, e)) {
        return pci_fail_cancelled(context, stage);
    }
    return PC_OK;
}

static double iso_value(const pc_grid *grid, double iso_voxels) {
    return iso_voxels * grid->cell_size * (1.0 + ISO_SLACK);
}

pc_status pci_marching_cubes(pc_context *context, const pc_grid *grid, double iso_voxels,
                             pc_mesh *mesh) {
    pci_scratch scratch = pci_scratch_begin(context);
    extraction *e = PCI_SCRATCH(&scratch, extraction, 1);
    pc_status status = e == NULL ? pci_fail_memory(context, stage) : PC_OK;
    if (status == PC_OK) {
        e->grid = grid;
        e->iso = iso_value(grid, iso_voxels);
        e->row_count = (size_t)grid->size[1] * grid->size[2];
        status = extract(context, &scratch, e);
        if (status == PC_OK) {
            *mesh = e->mesh;
        } else {
            pc_mesh_free(context, &e->mesh);
        }
    }
    pci_scratch_end(&scratch);
    return status;
}

static pc_status check_grid(pc_context *context, const pc_grid *grid, double iso) {
    const uint32_t *size = grid->size;
    if (size[0] == 0 || size[1] == 0 || size[2] == 0 || size[0] > UINT16_MAX ||
        size[1] > UINT16_MAX || size[2] > UINT16_MAX) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "%s: a lattice of %u by %u by %u points", stage, size[0], size[1], size[2]);
    }
    for (size_t k = 0; k < 3; ++k) {
        if (!(fabs(grid->origin[k]) <= PCI_FARTHEST && grid->cell_size <= PCI_FARTHEST)) {
            return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                            "%s: a lattice at %g with cell size %g", stage, grid->origin[k],
                            grid->cell_size);
        }
    }
    if (!(iso > 0.0 && grid->band > iso) || !isfinite(grid->band)) {
        return pci_fail(
            context, PC_ERROR_INVALID_ARGUMENT, stage,
            "%s: cell size %g and band %g of the grid do not hold the iso-surface at %g", stage,
            grid->cell_size, grid->band, iso);
    }
    if (grid->sample_count >= UINT32_MAX) {
        return pci_fail(context, PC_ERROR_TOO_LARGE, stage, "%s: %zu samples are too many", stage,
                        grid->sample_count);
    }
    return PC_OK;
}

pc_status pc_isosurface(pc_context *context, const pc_grid *grid,
                        const pc_isosurface_options *options, pc_mesh *isosurface,
                        pc_isosurface_report *report) {
    if (grid == NULL || isosurface == NULL || isosurface->positions != NULL ||
        isosurface->triangles != NULL) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "%s: grid or isosurface is NULL, or isosurface is not empty", stage);
    }
    pc_isosurface_options chosen;
    pc_status status =
        pci_begin_stage(context, stage, &pc_isosurface_options_record, options, &chosen);
    if (status == PC_OK) {
        status = check_grid(context, grid, iso_value(grid, chosen.iso_voxels));
    }
    if (status == PC_OK) {
        status = pci_marching_cubes(context, grid, chosen.iso_voxels, isosurface);
    }
    if (status == PC_OK && report != NULL) {
        // Every vertex has one fan, so surfaces that share no edge share no vertex either.
        uint32_t *parents = PCI_ALLOCATE(context, uint32_t, isosurface->vertex_count);
        if (parents == NULL) {
            pc_mesh_free(context, isosurface);
            return pci_fail_memory(context, stage);
        }
        *report = (pc_isosurface_report){.vertices = isosurface->vertex_count,
                                         .triangles = isosurface->triangle_count,
                                         .components = pci_vertex_components(isosurface, parents)};
        pc_release(context, parents);
    }
    return status;
}
