#include <stdlib.h>

#include "geometry/crossing.h"
#include "support/memory.h"

// ---- grids --------------------------------------------------------------------------------------

// A full lattice with cell size 1 whose samples are all at distance 2, outside any iso-surface.
static pc_grid full_grid(pc_context *context, uint32_t x, uint32_t y, uint32_t z) {
    pc_grid grid = {.origin = {0.5, -3.0, 7.0},
                    .cell_size = 1.0,
                    .size = {x, y, z},
                    .band = 2.75,
                    .sample_count = (size_t)x * y * z};
    grid.samples = PCI_ALLOCATE(context, uint64_t, grid.sample_count);
    grid.values = PCI_ALLOCATE(context, float, grid.sample_count);
    assert_non_null(grid.samples);
    assert_non_null(grid.values);
    for (size_t i = 0; i < grid.sample_count; ++i) {
        grid.samples[i] = i;
        grid.values[i] = 2.0f;
    }
    return grid;
}

static bool on_border(const pc_grid *grid, uint64_t sample) {
    const uint64_t x = sample % grid->size[0], y = sample / grid->size[0] % grid->size[1];
    const uint64_t z = sample / grid->size[0] / grid->size[1];
    return x == 0 || y == 0 || z == 0 || x + 1 == grid->size[0] || y + 1 == grid->size[1] ||
           z + 1 == grid->size[2];
}

// Noise: each sample off the border is inside with the given probability. Some values are equal to
// the iso-value or next to it.
static pc_grid noise_grid(pc_context *context, uint32_t side, double inside, uint64_t seed) {
    pc_grid grid = full_grid(context, side, side, side);
    for (size_t i = 0; i < grid.sample_count; ++i) {
        if (on_border(&grid, i)) {
            continue;
        }
        const double r = pci_random(seed, i, 1);
        double value = pci_random(seed, i, 0) < inside ? 0.999 * r : 1.001 + r;
        if (pci_random(seed, i, 2) < 0.2) {
            value = value < 1.0 ? 1.0 : 1.0 + 2e-6; // ends of the slack
        }
        grid.values[i] = (float)value;
    }
    return grid;
}

// Keeps the samples for which keep[i] is set.
static void thin_out(pc_grid *grid, const bool *keep) {
    size_t kept = 0;
    for (size_t i = 0; i < grid->sample_count; ++i) {
        if (keep[i]) {
            grid->samples[kept] = grid->samples[i];
            grid->values[kept++] = grid->values[i];
        }
    }
    grid->sample_count = kept;
}

static void lattice_position(const pc_grid *grid, uint64_t sample, double position[3]) {
    const uint64_t at[3] = {sample % grid->size[0], sample / grid->size[0] % grid->size[1],
                            sample / grid->size[0] / grid->size[1]};
    for (size_t k = 0; k < 3; ++k) {
        position[k] = grid->origin[k] + grid->cell_size * (double)at[k];
    }
}

// ---- certificates -------------------------------------------------------------------------------

typedef struct half_edge {
    uint32_t from, to, triangle;
} half_edge;

static int compare_half_edges(const void *a, const void *b) {
    const half_edge *x = a, *y = b;
    return x->from != y->from ? (x->from > y->from) - (x->from < y->from)
                              : (x->to > y->to) - (x->to < y->to);
}

static const half_edge *find_half_edge(const half_edge *edges, size_t count, uint32_t from,
                                       uint32_t to) {
    const half_edge key = {from, to, 0};
    return bsearch(&key, edges, count, sizeof(key), compare_half_edges);
}

// Every directed edge occurs once and its opposite too; the triangles of a vertex form one fan;
// every vertex is used. Returns the number of components.
static size_t assert_closed_manifold(const pc_mesh *mesh) {
    const size_t count = 3 * mesh->triangle_count;
    half_edge *edges = malloc((count + 1) * sizeof(*edges));
    uint32_t *degrees = calloc(mesh->vertex_count + 1, sizeof(*degrees));
    uint32_t *starts = calloc(mesh->vertex_count + 1, sizeof(*starts));
    uint32_t *components = calloc(mesh->triangle_count + 1, sizeof(*components));
    uint32_t *stack = calloc(mesh->triangle_count + 1, sizeof(*stack));
    assert_true(edges && degrees && starts && components && stack);
    for (size_t c = 0; c < count; ++c) {
        const uint32_t from = mesh->triangles[c];
        const uint32_t to = mesh->triangles[c % 3 == 2 ? c - 2 : c + 1];
        assert_true(from < mesh->vertex_count && from != to);
        edges[c] = (half_edge){from, to, (uint32_t)(c / 3)};
        ++degrees[from];
    }
    qsort(edges, count, sizeof(*edges), compare_half_edges);
    for (size_t i = 0; i < count; ++i) {
        assert_true(i == 0 || compare_half_edges(&edges[i - 1], &edges[i]) != 0);
        assert_non_null(find_half_edge(edges, count, edges[i].to, edges[i].from));
        starts[edges[i].from] = (uint32_t)i;
    }
    // Turn around each vertex: back at the first edge only after all its triangles.
    for (uint32_t v = 0; v < mesh->vertex_count; ++v) {
        assert_true(degrees[v] >= 3);
        const half_edge *first = &edges[starts[v]], *at = first;
        uint32_t steps = 0;
        do {
            const uint32_t *corner = &mesh->triangles[3 * (size_t)at->triangle];
            const uint32_t last = corner[0] == v   ? corner[2]
                                  : corner[1] == v ? corner[0]
                                                   : corner[1];
            at = find_half_edge(edges, count, v, last);
            assert_non_null(at);
            ++steps;
        } while (at != first && steps <= degrees[v]);
        assert_int_equal(steps, degrees[v]);
    }
    size_t component_count = 0;
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        size_t depth = 0;
        if (components[t] == 0) {
            components[t] = (uint32_t)++component_count;
            stack[depth++] = (uint32_t)t;
        }
        while (depth > 0) {
            const uint32_t *corner = &mesh->triangles[3 * (size_t)stack[--depth]];
            for (size_t c = 0; c < 3; ++c) {
                const half_edge *other =
                    find_half_edge(edges, count, corner[(c + 1) % 3], corner[c]);
                if (components[other->triangle] == 0) {
                    components[other->triangle] = (uint32_t)component_count;
                    stack[depth++] = other->triangle;
                }
            }
        }
    }
    free(edges), free(degrees), free(starts), free(components), free(stack);
    return component_count;
}

// Winding number: sum of the solid angles (van Oosterom and Strackee) over 4 pi.
static double winding_number(const pc_mesh *mesh, const double point[3]) {
    double sum = 0.0;
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        double r[3][3], length[3], normal[3];
        for (size_t c = 0; c < 3; ++c) {
            pci_sub(&mesh->positions[3 * (size_t)mesh->triangles[3 * t + c]], point, r[c]);
            length[c] = pci_norm(r[c]);
        }
        pci_cross(r[1], r[2], normal);
        sum += 2.0 * atan2(pci_dot(r[0], normal),
                           length[0] * length[1] * length[2] + pci_dot(r[0], r[1]) * length[2] +
                               pci_dot(r[1], r[2]) * length[0] + pci_dot(r[2], r[0]) * length[1]);
    }
    return sum / (4.0 * acos(-1.0));
}

// The surface winds once around every inside sample and not around the others, so it separates
// them and its normals point outwards.
static void assert_separates(const pc_grid *grid, const pc_mesh *mesh, double iso) {
    for (size_t i = 0; i < grid->sample_count; ++i) {
        double position[3];
        lattice_position(grid, grid->samples[i], position);
        const bool inside = (double)grid->values[i] < iso * (1.0 + 1e-6);
        assert_close(winding_number(mesh, position), inside ? 1.0 : 0.0, 1e-9);
    }
}

// ---- tests --------------------------------------------------------------------------------------

static void every_case_is_closed_among_random_neighbours(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    for (uint32_t inside = 0; inside < 256; ++inside) {
        for (uint64_t round = 0; round < 4; ++round) {
            pc_grid grid = noise_grid(context, 6, round == 0 ? 0.0 : 0.25 * (double)round,
                                      1000 * inside + round);
            for (uint32_t c = 0; c < 8; ++c) {
                const size_t at = 2 + (c & 1) + 6 * (2 + (c >> 1 & 1) + 6 * (2 + (c >> 2)));
                grid.values[at] = inside >> c & 1 ? 0.3f : 1.7f;
            }
            pc_mesh mesh = {0};
            pc_isosurface_report report = {0};
            assert_ok(context, pc_isosurface(context, &grid, NULL, &mesh, &report));
            assert_int_equal(report.components, assert_closed_manifold(&mesh));
            assert_int_equal(report.vertices, mesh.vertex_count);
            assert_int_equal(report.triangles, mesh.triangle_count);
            uint64_t crossings = 1;
            assert_ok(context, pci_count_self_intersections(context, "test", &mesh, &crossings));
            assert_int_equal(crossings, 0);
            if (round == 1) {
                assert_separates(&grid, &mesh, 1.0);
            }
            pc_mesh_free(context, &mesh);
            pc_grid_free(context, &grid);
        }
    }
    pc_context_destroy(context);
}

static void noise_is_closed(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    for (uint64_t seed = 0; seed < 60; ++seed) {
        pc_grid grid = noise_grid(context, 9, 0.05 + 0.015 * (double)seed, seed);
        pc_mesh mesh = {0};
        pc_isosurface_report report = {0};
        assert_ok(context, pc_isosurface(context, &grid, NULL, &mesh, &report));
        assert_int_equal(report.components, assert_closed_manifold(&mesh));
        if (seed % 10 == 0) {
            assert_separates(&grid, &mesh, 1.0);
        }
        pc_mesh_free(context, &mesh);
        pc_grid_free(context, &grid);
    }
    pc_context_destroy(context);
}

// Without a sample the surface is the same as with a sample at the band's distance.
static void missing_samples_are_outside(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    for (uint64_t seed = 0; seed < 10; ++seed) {
        pc_grid full = noise_grid(context, 9, 0.4, seed),
                sparse = noise_grid(context, 9, 0.4, seed);
        bool *keep = calloc(full.sample_count, sizeof(*keep));
        assert_non_null(keep);
        for (size_t i = 0; i < full.sample_count; ++i) {
            keep[i] = pci_random(seed, i, 7) < 0.6;
            full.values[i] = keep[i] ? full.values[i] : 2.75f;
        }
        thin_out(&sparse, keep);
        pc_mesh expected = {0}, found = {0};
        assert_ok(context, pc_isosurface(context, &full, NULL, &expected, NULL));
        assert_ok(context, pc_isosurface(context, &sparse, NULL, &found, NULL));
        assert_int_equal(found.vertex_count, expected.vertex_count);
        assert_int_equal(found.triangle_count, expected.triangle_count);
        assert_memory_equal(found.positions, expected.positions,
                            3 * found.vertex_count * sizeof(double));
        assert_memory_equal(found.triangles, expected.triangles,
                            3 * found.triangle_count * sizeof(uint32_t));
        free(keep);
        pc_mesh_free(context, &expected);
        pc_mesh_free(context, &found);
        pc_grid_free(context, &full);
        pc_grid_free(context, &sparse);
    }
    pc_context_destroy(context);
}

static double sphere_volume_error(pc_context *context, uint32_t side) {
    const double radius = 0.3, pi = acos(-1.0);
    pc_grid grid = full_grid(context, side, side, side);
    grid.cell_size = 1.0 / (side - 1);
    grid.band = 1.0;
    memset(grid.origin, 0, sizeof(grid.origin));
    const double centre[3] = {0.5, 0.51, 0.49};
    for (size_t i = 0; i < grid.sample_count; ++i) {
        double position[3];
        lattice_position(&grid, i, position);
        // The iso-surface at one cell is the sphere.
        grid.values[i] = (float)fmax(0.0, sqrt(pci_squared_distance(position, centre)) - radius +
                                              grid.cell_size);
    }
    pc_mesh mesh = {0};
    pc_isosurface_report report = {0};
    assert_ok(context, pc_isosurface(context, &grid, NULL, &mesh, &report));
    assert_int_equal(assert_closed_manifold(&mesh), 1);
    assert_int_equal(report.components, 1);
    double volume = 0.0;
    for (size_t t = 0; t < mesh.triangle_count; ++t) {
        const uint32_t *corner = &mesh.triangles[3 * t];
        double normal[3];
        pci_cross(&mesh.positions[3 * (size_t)corner[1]], &mesh.positions[3 * (size_t)corner[2]],
                  normal);
        volume += pci_dot(&mesh.positions[3 * (size_t)corner[0]], normal) / 6.0;
    }
    for (size_t v = 0; v < mesh.vertex_count; ++v) {
        assert_close(sqrt(pci_squared_distance(&mesh.positions[3 * v], centre)), radius,
                     0.11 * grid.cell_size); // clearance, and curvature along an edge
    }
    pc_mesh_free(context, &mesh);
    pc_grid_free(context, &grid);
    return fabs(volume - 4.0 / 3.0 * pi * radius * radius * radius);
}

static void sphere_converges_with_second_order(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    const double coarse = sphere_volume_error(context, 17);
    const double fine = sphere_volume_error(context, 33);
    assert_true(coarse < 0.05 * 0.1131); // of the volume, as (cell / radius)^2 suggests
    assert_true(fine < coarse / 3.3);
    pc_context_destroy(context);
}

// A hollow ball has two surfaces; the inner one bounds the hollow from within.
static void hollow_adds_a_component(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_grid grid = full_grid(context, 20, 20, 20);
    const double centre[3] = {10.0, 6.5, 16.5};
    for (size_t i = 0; i < grid.sample_count; ++i) {
        double position[3];
        lattice_position(&grid, i, position);
        grid.values[i] = (float)fabs(sqrt(pci_squared_distance(position, centre)) - 5.0);
    }
    pc_mesh mesh = {0};
    pc_isosurface_report report = {0};
    assert_ok(context, pc_isosurface(context, &grid, NULL, &mesh, &report));
    assert_int_equal(report.components, 2);
    assert_int_equal(assert_closed_manifold(&mesh), 2);
    assert_separates(&grid, &mesh, 1.0);
    // Two spheres: Euler characteristic 4, so #F = 2 (#V - 4).
    assert_int_equal(mesh.triangle_count, 2 * (mesh.vertex_count - 4));
    pc_mesh_free(context, &mesh);
    pc_grid_free(context, &grid);
    pc_context_destroy(context);
}

static void vertices_keep_clear_of_the_lattice_points(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_grid grid = noise_grid(context, 9, 0.5, 77);
    pc_mesh mesh = {0};
    assert_ok(context, pc_isosurface(context, &grid, NULL, &mesh, NULL));
    for (size_t v = 0; v < mesh.vertex_count; ++v) {
        size_t off_lattice = 0;
        for (size_t k = 0; k < 3; ++k) {
            const double x = mesh.positions[3 * v + k] - grid.origin[k], rest = fabs(x - round(x));
            off_lattice += rest > 1e-12;
            assert_true(rest <= 1e-12 || rest >= 0.1 - 1e-12);
        }
        assert_int_equal(off_lattice, 1);
    }
    for (size_t c = 0; c < 3 * mesh.triangle_count; ++c) {
        const uint32_t a = mesh.triangles[c], b = mesh.triangles[c % 3 == 2 ? c - 2 : c + 1];
        assert_true(pci_squared_distance(&mesh.positions[3 * (size_t)a],
                                         &mesh.positions[3 * (size_t)b]) >= 0.01);
    }
    pc_mesh_free(context, &mesh);
    pc_grid_free(context, &grid);
    pc_context_destroy(context);
}

// Shapes without thickness, and thinner than a voxel in other directions too.
typedef enum thin_shape {
    TRIANGLE,
    SLIVER,
    SEGMENT,
    TWO_POINTS,
    RIBBON,
    FAN,
    SHAPE_COUNT
} thin_shape;

// Corners are random in the unit cube; returns the number of triangles.
static size_t make_thin(thin_shape shape, uint64_t seed, double positions[24],
                        uint32_t triangles[18]) {
    static const uint32_t fan[18] = {0, 1, 2, 0, 2, 3, 0, 3, 4, 0, 4, 5, 0, 5, 6, 0, 6, 7};
    for (size_t i = 0; i < 24; ++i) {
        positions[i] = pci_random(seed, i, shape);
    }
    memcpy(triangles, fan, sizeof(fan));
    const double width = pow(10.0, -8.0 * pci_random(seed, 99, shape));
    for (size_t k = 0; k < 3; ++k) {
        double *a = &positions[k], *b = &positions[3 + k], *c = &positions[6 + k];
        double *d = &positions[9 + k];
        if (shape == SLIVER) {
            *c = 0.3 * *a + 0.7 * *b + width * (*c - 0.5) * 0.01;
        } else if (shape == RIBBON) {
            const double side = 0.01 * width * (*c - 0.5);
            *c = *b + side, *d = *a + side;
        }
    }
    if (shape == SEGMENT) {
        triangles[2] = 1; // 0 1 1
    } else if (shape == TWO_POINTS) {
        triangles[1] = triangles[2] = 0;
        triangles[3] = triangles[4] = triangles[5] = 1;
    }
    return shape == FAN ? 6 : shape == RIBBON || shape == TWO_POINTS ? 2 : 1;
}

static void thin_parts_are_enclosed(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    for (uint64_t seed = 0; seed < 60; ++seed) {
        for (thin_shape shape = TRIANGLE; shape < SHAPE_COUNT; ++shape) {
            double positions[24];
            uint32_t triangles[18];
            const pc_mesh thin = {.vertex_count = 8,
                                  .positions = positions,
                                  .triangle_count = make_thin(shape, seed, positions, triangles),
                                  .triangles = triangles};
            const pc_voxelize_options options = {.voxels = 4 + (uint32_t)(seed % 7 * 5)};
            const pc_isosurface_options iso = {.iso_voxels = seed % 2 == 0 ? 1.0 : 0.867};
            pc_grid grid = {0};
            pc_mesh mesh = {0};
            pc_isosurface_report report = {0};
            assert_ok(context, pc_voxelize(context, &thin, &options, &grid, NULL));
            assert_ok(context, pc_isosurface(context, &grid, &iso, &mesh, &report));

            // In one piece, without pinholes; a fan may enclose hollows and have tunnels.
            const size_t pieces = assert_closed_manifold(&mesh);
            assert_int_equal(report.components, pieces);
            if (shape != FAN) {
                assert_int_equal(pieces, shape == TWO_POINTS ? 2 : 1);
                assert_int_equal(mesh.triangle_count, 2 * (mesh.vertex_count - 2 * pieces));
            }
            // Around all of it, and nowhere farther than the iso-surface may be.
            for (size_t t = 0; t < thin.triangle_count; ++t) {
                for (size_t i = 0; i <= 10; ++i) {
                    double point[3];
                    const double u = 0.1 * (double)i, v = (1.0 - u) * pci_random(seed, i, t);
                    for (size_t k = 0; k < 3; ++k) {
                        point[k] = u * positions[3 * (size_t)triangles[3 * t] + k] +
                                   v * positions[3 * (size_t)triangles[3 * t + 1] + k] +
                                   (1.0 - u - v) * positions[3 * (size_t)triangles[3 * t + 2] + k];
                    }
                    assert_close(winding_number(&mesh, point), 1.0, 1e-9);
                }
            }
            pc_mesh_free(context, &mesh);
            pc_grid_free(context, &grid);
        }
    }
    pc_context_destroy(context);
}

static void threads_do_not_change_the_result(void **state) {
    (void)state;
    static const uint32_t thread_counts[] = {1, 2, 3, 8};
    pc_context *owner = test_context(1);
    pc_mesh first = {0};
    for (size_t i = 0; i < 4; ++i) {
        pc_context *context = test_context(thread_counts[i]);
        pc_grid grid = noise_grid(context, 24, 0.5, 5);
        pc_mesh mesh = {0};
        assert_ok(context, pc_isosurface(context, &grid, NULL, i == 0 ? &first : &mesh, NULL));
        if (i > 0) {
            assert_int_equal(mesh.vertex_count, first.vertex_count);
            assert_int_equal(mesh.triangle_count, first.triangle_count);
            assert_memory_equal(mesh.positions, first.positions,
                                3 * mesh.vertex_count * sizeof(double));
            assert_memory_equal(mesh.triangles, first.triangles,
                                3 * mesh.triangle_count * sizeof(uint32_t));
            pc_mesh_free(context, &mesh);
        }
        pc_grid_free(context, &grid);
        pc_context_destroy(context);
    }
    pc_mesh_free(owner, &first);
    pc_context_destroy(owner);
}

static void assert_refused(pc_context *context, const pc_grid *grid, pc_status expected) {
    pc_mesh mesh = {0};
    assert_int_equal(pc_isosurface(context, grid, NULL, &mesh, NULL), expected);
    assert_true(mesh.positions == NULL && mesh.triangles == NULL && mesh.vertex_count == 0);
}

static void broken_grids_are_refused(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_grid grid = noise_grid(context, 5, 0.5, 1);
    const pc_grid good = grid;
    pc_mesh mesh = {0};
    assert_int_equal(pc_isosurface(context, NULL, NULL, &mesh, NULL), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_isosurface(context, &grid, NULL, NULL, NULL), PC_ERROR_INVALID_ARGUMENT);
    const pc_isosurface_options options = {.iso_voxels = 1.5};
    assert_int_equal(pc_isosurface(context, &grid, &options, &mesh, NULL),
                     PC_ERROR_INVALID_OPTIONS);

    grid.size[1] = 0;
    assert_refused(context, &grid, PC_ERROR_INVALID_ARGUMENT);
    grid = good;
    grid.band = 0.9;
    assert_refused(context, &grid, PC_ERROR_INVALID_ARGUMENT);
    grid = good;
    grid.cell_size = NAN;
    assert_refused(context, &grid, PC_ERROR_INVALID_ARGUMENT);
    grid = good;
    grid.size[2] = 4; // samples beyond the lattice
    assert_refused(context, &grid, PC_ERROR_INVALID_ARGUMENT);
    grid = good;
    const float values[] = {NAN, INFINITY, -1.0f};
    for (size_t i = 0; i < 3; ++i) {
        const float kept = grid.values[62];
        grid.values[62] = values[i];
        assert_refused(context, &grid, PC_ERROR_INVALID_ARGUMENT);
        grid.values[62] = kept;
    }
    grid.samples[7] = 6; // twice
    assert_refused(context, &grid, PC_ERROR_INVALID_ARGUMENT);
    grid.samples[7] = 7;
    grid.values[3] = 0.5f; // inside, on the border
    assert_refused(context, &grid, PC_ERROR_INVALID_ARGUMENT);
    grid.values[3] = 2.0f;
    assert_ok(context, pc_isosurface(context, &grid, NULL, &mesh, NULL));
    assert_int_equal(pc_isosurface(context, &grid, NULL, &mesh, NULL), PC_ERROR_INVALID_ARGUMENT);
    pc_mesh_free(context, &mesh);
    pc_grid_free(context, &grid);
    pc_context_destroy(context);
}

static void nothing_inside_gives_an_empty_mesh(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_grid grid = full_grid(context, 4, 1, 7);
    pc_mesh mesh = {0};
    pc_isosurface_report report = {.components = 9};
    assert_ok(context, pc_isosurface(context, &grid, NULL, &mesh, &report));
    assert_int_equal(mesh.vertex_count, 0);
    assert_int_equal(mesh.triangle_count, 0);
    assert_int_equal(report.components, 0);
    pc_mesh_free(context, &mesh);
    pc_grid_free(context, &grid);
    pc_context_destroy(context);
}

// ---- lack of memory -----------------------------------------------------------------------------

static void lack_of_memory_leaves_nothing_behind(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    pc_grid grid = noise_grid(context, 6, 0.5, 3);
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        pc_mesh mesh = {0};
        s.status = pc_isosurface(context, &grid, NULL, &mesh, NULL);
        assert_int_equal(mesh.positions != NULL, s.status == PC_OK);
        pc_mesh_free(context, &mesh);
    }
    assert_true(s.failures > 5);
    pc_grid_free(context, &grid);
    pc_context_destroy(context);
    assert_int_equal(counter.live, 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_case_is_closed_among_random_neighbours),
        cmocka_unit_test(noise_is_closed),
        cmocka_unit_test(missing_samples_are_outside),
        cmocka_unit_test(sphere_converges_with_second_order),
        cmocka_unit_test(hollow_adds_a_component),
        cmocka_unit_test(vertices_keep_clear_of_the_lattice_points),
        cmocka_unit_test(thin_parts_are_enclosed),
        cmocka_unit_test(threads_do_not_change_the_result),
        cmocka_unit_test(broken_grids_are_refused),
        cmocka_unit_test(nothing_inside_gives_an_empty_mesh),
        cmocka_unit_test(lack_of_memory_leaves_nothing_behind),
    };
    return cmocka_run_group_tests_name("isosurface", tests, NULL, NULL);
}
