#include "geometry/bvh.h"
#include "geometry/crossing.h"
#include "geometry/hausdorff.h"
#include "support/memory.h"
#include "support/test.h"

// ---- meshes -----------------------------------------------------------------------------------

#define MESH(positions_, triangles_)                                                               \
    {                                                                                              \
        .vertex_count = sizeof(positions_) / sizeof(double) / 3, .positions = (positions_),        \
        .triangle_count = sizeof(triangles_) / sizeof(uint32_t) / 3, .triangles = (triangles_)     \
    }

static pc_mesh new_mesh(pc_context *context, size_t vertices, size_t triangles) {
    pc_mesh mesh = {.vertex_count = vertices, .triangle_count = triangles};
    mesh.positions = PCI_ALLOCATE(context, double, 3 * vertices);
    mesh.triangles = PCI_ALLOCATE(context, uint32_t, 3 * triangles);
    return mesh;
}

// Unit squares of n by n cells at the given heights.
static pc_mesh squares(pc_context *context, uint32_t n, size_t layers, const double *heights) {
    const uint32_t side = n + 1;
    pc_mesh mesh = new_mesh(context, layers * side * side, layers * 2 * n * n);
    uint32_t *triangle = mesh.triangles;
    for (uint32_t layer = 0; layer < layers; ++layer) {
        const uint32_t first = layer * side * side;
        for (uint32_t i = 0; i < side * side; ++i) {
            double *at = &mesh.positions[3 * (first + i)];
            at[0] = (double)(i % side) / n, at[1] = (double)(i / side) / n, at[2] = heights[layer];
        }
        for (uint32_t i = 0; i < n * n; ++i) {
            const uint32_t v = first + i / n * side + i % n;
            const uint32_t cell[6] = {v, v + 1, v + side, v + 1, v + side + 1, v + side};
            memcpy(triangle, cell, sizeof(cell));
            triangle += 6;
        }
    }
    return mesh;
}

// A unit sphere of `rings` times 2 `rings` faces.
static pc_mesh sphere(pc_context *context, uint32_t rings, double radius) {
    const uint32_t around = 2 * rings;
    pc_mesh mesh = new_mesh(context, (rings - 1) * around + 2, 2 * around * (rings - 1));
    const double pi = acos(-1.0);
    for (uint32_t r = 1; r < rings; ++r) {
        for (uint32_t a = 0; a < around; ++a) {
            double *at = &mesh.positions[3 * ((r - 1) * around + a)];
            const double polar = pi * r / rings, azimuth = 2.0 * pi * a / around;
            at[0] = radius * sin(polar) * cos(azimuth);
            at[1] = radius * sin(polar) * sin(azimuth);
            at[2] = radius * cos(polar);
        }
    }
    const uint32_t north = (rings - 1) * around, south = north + 1;
    mesh.positions[3 * north + 2] = radius;
    mesh.positions[3 * south + 2] = -radius;
    uint32_t *t = mesh.triangles;
    for (uint32_t a = 0; a < around; ++a) {
        const uint32_t b = (a + 1) % around, last = (rings - 2) * around;
        const uint32_t caps[6] = {north, a, b, south, last + b, last + a};
        memcpy(t, caps, sizeof(caps));
        t += 6;
        for (uint32_t r = 0; r + 2 < rings; ++r) {
            const uint32_t u = r * around, v = u + around;
            const uint32_t cell[6] = {u + a, v + a, u + b, u + b, v + a, v + b};
            memcpy(t, cell, sizeof(cell));
            t += 6;
        }
    }
    return mesh;
}

// Separate triangles with corners in a cube, each about `size` wide.
static pc_mesh soup(pc_context *context, uint64_t seed, uint32_t triangles, double size) {
    pc_mesh mesh = new_mesh(context, 3 * triangles, triangles);
    for (uint32_t i = 0; i < 3 * triangles; ++i) {
        mesh.triangles[i] = i;
        for (uint32_t k = 0; k < 3; ++k) {
            mesh.positions[3 * i + k] =
                pci_random(seed, i / 3, k) + size * pci_random(seed + 1, i, k);
        }
    }
    return mesh;
}

static pc_measures evaluate(pc_context *context, const pc_mesh *visual, const pc_mesh *proxy) {
    pc_measures measures;
    assert_ok(context, pc_evaluate(context, visual, proxy, &measures));
    return measures;
}

// ---- topology ---------------------------------------------------------------------------------

static void counts_a_sphere(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh mesh = sphere(context, 8, 1.0);
    const pc_measures m = evaluate(context, &mesh, &mesh);
    assert_int_equal(m.vertices, mesh.vertex_count);
    assert_int_equal(m.triangles, mesh.triangle_count);
    assert_int_equal(m.components, 1);
    assert_int_equal(m.boundary_loops, 0);
    assert_close(m.euler_number, 2.0, 0.0);
    assert_int_equal(m.nonmanifold_edges, 0);
    assert_int_equal(m.nonmanifold_vertices, 0);
    assert_int_equal(m.self_intersections, 0);
    assert_close(m.doubled_area, 0.0, 0.0);
    assert_close(m.hausdorff, 0.0, 1e-15);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

static void counts_a_moebius_strip(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    enum { COUNT = 24 };
    pc_mesh mesh = new_mesh(context, 2 * COUNT, 2 * COUNT);
    for (uint32_t i = 0; i < COUNT; ++i) {
        const double angle = 2.0 * acos(-1.0) * i / COUNT;
        for (uint32_t side = 0; side < 2; ++side) {
            const double offset = side ? 0.3 : -0.3, radius = 1.0 + offset * cos(0.5 * angle);
            double *at = &mesh.positions[3 * (2 * i + side)];
            at[0] = radius * cos(angle), at[1] = radius * sin(angle);
            at[2] = offset * sin(0.5 * angle);
        }
        const uint32_t a = 2 * i, b = a + 1;
        const uint32_t c = i + 1 < COUNT ? a + 2 : 1, d = i + 1 < COUNT ? a + 3 : 0;
        const uint32_t cell[6] = {a, c, b, b, c, d};
        memcpy(&mesh.triangles[6 * i], cell, sizeof(cell));
    }
    const pc_measures m = evaluate(context, &mesh, &mesh);
    assert_int_equal(m.components, 1);
    assert_int_equal(m.boundary_loops, 1);
    assert_close(m.euler_number, 0.0, 0.0);
    assert_int_equal(m.nonmanifold_edges, 0);
    assert_int_equal(m.nonmanifold_vertices, 0);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

static void counts_pages_of_a_book(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    // Three triangles on one edge, the second one wound the other way.
    double positions[] = {0, 0, 0, 0, 0, 1, 1, 0, 0, -1, 1, 0, -1, -1, 0};
    uint32_t triangles[] = {0, 1, 2, 0, 1, 3, 1, 0, 4};
    const pc_mesh mesh = MESH(positions, triangles);
    const pc_measures m = evaluate(context, &mesh, &mesh);
    assert_int_equal(m.components, 1);
    assert_int_equal(m.nonmanifold_edges, 1);
    assert_int_equal(m.nonmanifold_vertices, 0);
    assert_int_equal(m.boundary_loops, 1);
    assert_close(m.euler_number, 5.0 - 7.0 + 3.0, 0.0);
    pc_context_destroy(context);
}

static void counts_parts_that_touch_at_a_vertex(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    // Two triangles that share vertex 2, a stray vertex and a triangle with a repeated vertex.
    double positions[] = {-1, 0, 0, -1, 1, 0, 0, 0, 0, 1, 0, 0, 1, 1, 0, 99, 99, 99};
    uint32_t triangles[] = {0, 2, 1, 2, 3, 4, 3, 4, 4};
    const pc_mesh mesh = MESH(positions, triangles);
    const pc_measures m = evaluate(context, &mesh, &mesh);
    assert_int_equal(m.vertices, 5);
    assert_int_equal(m.triangles, 3);
    assert_int_equal(m.components, 2);
    assert_int_equal(m.boundary_loops, 2);
    assert_int_equal(m.nonmanifold_vertices, 1);
    assert_int_equal(m.nonmanifold_edges, 0);
    assert_close(m.euler_number, 5.0 - 6.0 + 2.0, 0.0);
    assert_close(m.min_angle_worst, 0.0, 0.0);
    pc_context_destroy(context);
}

static void counts_loops_of_a_tube_with_mixed_winding(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    enum { COUNT = 12 };
    pc_mesh mesh = new_mesh(context, 2 * COUNT, 2 * COUNT);
    for (uint32_t i = 0; i < COUNT; ++i) {
        const double angle = 2.0 * acos(-1.0) * i / COUNT;
        for (uint32_t end = 0; end < 2; ++end) {
            double *at = &mesh.positions[3 * (2 * i + end)];
            at[0] = cos(angle), at[1] = sin(angle), at[2] = end;
        }
        const uint32_t a = 2 * i, b = a + 1, c = (a + 2) % (2 * COUNT), d = c + 1;
        const uint32_t cell[2][3] = {{a, c, b}, {b, c, d}}, flipped[2][3] = {{a, b, c}, {b, c, d}};
        memcpy(&mesh.triangles[6 * i], i % 3 == 0 ? flipped : cell, sizeof(cell));
    }
    const pc_measures m = evaluate(context, &mesh, &mesh);
    assert_int_equal(m.boundary_loops, 2);
    assert_int_equal(m.components, 1);
    assert_close(m.euler_number, 0.0, 0.0);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

// ---- doubled layers ---------------------------------------------------------------------------

static void finds_doubled_layers(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    // Reach is 1/16 of the longest side, which is 1 here.
    const struct {
        double gap, share;
    } cases[] = {{0.0, 1.0}, {1e-9, 1.0}, {0.06, 1.0}, {0.065, 0.0}};
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); ++i) {
        const double heights[2] = {0.0, cases[i].gap};
        pc_mesh mesh = squares(context, 4, 2, heights);
        assert_close(evaluate(context, &mesh, &mesh).doubled_area, cases[i].share, 0.0);
        pc_mesh_free(context, &mesh);
    }
    // The upper layer moved aside by a quarter: 3/4 of either is doubled.
    const double heights[2] = {0.0, 0.01};
    pc_mesh mesh = squares(context, 4, 2, heights);
    for (size_t v = 25; v < 50; ++v) {
        mesh.positions[3 * v] += 0.25;
    }
    assert_close(evaluate(context, &mesh, &mesh).doubled_area, 0.75, 0.01);
    // Turned over it is doubled all the same; set upright it is not.
    for (size_t t = 32; t < 64; ++t) {
        const uint32_t swap = mesh.triangles[3 * t];
        mesh.triangles[3 * t] = mesh.triangles[3 * t + 1];
        mesh.triangles[3 * t + 1] = swap;
    }
    assert_close(evaluate(context, &mesh, &mesh).doubled_area, 0.75, 0.01);
    for (size_t v = 25; v < 50; ++v) {
        mesh.positions[3 * v + 2] = mesh.positions[3 * v + 1];
        mesh.positions[3 * v + 1] = 0.5;
    }
    assert_close(evaluate(context, &mesh, &mesh).doubled_area, 0.0, 0.0);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

// A sheet of `across` by `along` cells, 1 long in y, with a given cross-section in x and z.
typedef void (*profile)(double u, double at[2]);

static pc_mesh drawn(pc_context *context, uint32_t across, uint32_t along, bool closed,
                     profile section) {
    const uint32_t columns = closed ? across : across + 1;
    pc_mesh mesh = new_mesh(context, (size_t)columns * (along + 1), (size_t)2 * across * along);
    for (uint32_t i = 0; i < columns * (along + 1); ++i) {
        double at[2];
        section((double)(i % columns) / across, at);
        mesh.positions[3 * i] = at[0];
        mesh.positions[3 * i + 1] = (double)(i / columns) / along;
        mesh.positions[3 * i + 2] = at[1];
    }
    for (uint32_t i = 0; i < across * along; ++i) {
        const uint32_t row = i / across * columns, a = row + i % across;
        const uint32_t b = row + (i % across + 1) % columns, c = a + columns, d = b + columns;
        const uint32_t cell[6] = {a, b, c, b, d, c};
        memcpy(&mesh.triangles[6 * i], cell, sizeof(cell));
    }
    return mesh;
}

// A voxel is 1/32, since every sheet here is 1 long.
static void wide_sleeve(double u, double at[2]) {
    at[0] = 0.75 / 32.0 * cos(2.0 * acos(-1.0) * u);
    at[1] = 0.75 / 32.0 * sin(2.0 * acos(-1.0) * u);
}

static void narrow_sleeve(double u, double at[2]) {
    at[0] = 0.4 / 32.0 * cos(2.0 * acos(-1.0) * u);
    at[1] = 0.4 / 32.0 * sin(2.0 * acos(-1.0) * u);
}

// Square legs, 6 voxels wide and .5 voxels apart.
static void square(double u, double middle, double at[2]) {
    const double side = 4.0 * u, part = side - floor(side);
    const double x[5] = {-1.0, 1.0, 1.0, -1.0, -1.0}, y[5] = {-1.0, -1.0, 1.0, 1.0, -1.0};
    const size_t i = (size_t)fmin(side, 3.0);
    const double t = side < 4.0 ? part : 1.0;
    at[0] = (middle + 3.0 * ((1.0 - t) * x[i] + t * x[i + 1])) / 32.0;
    at[1] = 3.0 * ((1.0 - t) * y[i] + t * y[i + 1]) / 32.0;
}

static void left_leg(double u, double at[2]) { square(u, -3.25, at); }
static void right_leg(double u, double at[2]) { square(u, 3.25, at); }

// The right one without the side that is next to the left one.
static void open_right_leg(double u, double at[2]) { square(0.75 * u, 3.25, at); }

// A quarter of the width is folded back, .2 voxels above the rest.
static void folded_hem(double u, double at[2]) {
    const double arc = 1.25 * u;
    at[0] = fmin(arc, 2.0 - arc);
    at[1] = arc > 1.0 ? 0.2 / 32.0 * fmin(1.0, 100.0 * (arc - 1.0)) : 0.0;
}

static void flat(double u, double at[2]) {
    at[0] = u;
    at[1] = 0.0;
}

// Both meshes as one; frees them.
static pc_mesh join(pc_context *context, pc_mesh a, pc_mesh b) {
    pc_mesh mesh =
        new_mesh(context, a.vertex_count + b.vertex_count, a.triangle_count + b.triangle_count);
    memcpy(mesh.positions, a.positions, 3 * a.vertex_count * sizeof(double));
    memcpy(&mesh.positions[3 * a.vertex_count], b.positions, 3 * b.vertex_count * sizeof(double));
    memcpy(mesh.triangles, a.triangles, 3 * a.triangle_count * sizeof(uint32_t));
    for (size_t i = 0; i < 3 * b.triangle_count; ++i) {
        mesh.triangles[3 * a.triangle_count + i] = b.triangles[i] + (uint32_t)a.vertex_count;
    }
    pc_mesh_free(context, &a);
    pc_mesh_free(context, &b);
    return mesh;
}

static void turn_over(pc_mesh *mesh) {
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        const uint32_t second = mesh->triangles[3 * t + 1];
        mesh->triangles[3 * t + 1] = mesh->triangles[3 * t + 2];
        mesh->triangles[3 * t + 2] = second;
    }
}

static void counts_layers_over_one_sheet(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    const double voxel = 1.0 / 32.0;
    const double heights[3] = {0.0, 0.3 * voxel, 1.5 * voxel};
    pc_mesh one = squares(context, 8, 1, heights), two = squares(context, 8, 2, heights);
    const double wide[2] = {0.0, 1.5 * voxel};
    pc_mesh apart = squares(context, 8, 2, wide), three = squares(context, 8, 3, heights);
    // A sheet and its copy; the same over a cape of two sides, which is one sheet.
    assert_close(evaluate(context, &one, &two).doubled_layers, 1.0, 0.0);
    assert_close(evaluate(context, &two, &two).doubled_layers, 1.0, 0.0);
    assert_close(evaluate(context, &two, &one).doubled_layers, 0.0, 0.0);
    // Layers of the garment's own are none too many, and a closed shell around one sheet is.
    assert_close(evaluate(context, &apart, &apart).doubled_area, 1.0, 0.0);
    assert_close(evaluate(context, &apart, &apart).doubled_layers, 0.0, 0.0);
    assert_close(evaluate(context, &one, &apart).doubled_layers, 1.0, 0.0);
    // Of three layers over two sheets, two share one.
    assert_close(evaluate(context, &apart, &three).doubled_layers, 2.0 / 3.0, 0.01);
    pc_mesh_free(context, &one);
    pc_mesh_free(context, &two);
    pc_mesh_free(context, &apart);
    pc_mesh_free(context, &three);
    pc_context_destroy(context);
}

static void tells_sleeves_and_hems_from_doubled_layers(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_mesh sleeve = drawn(context, 24, 48, true, wide_sleeve);
    pc_mesh prism = drawn(context, 6, 40, true, wide_sleeve);
    assert_true(evaluate(context, &sleeve, &prism).doubled_area > 0.5);
    assert_close(evaluate(context, &sleeve, &prism).doubled_layers, 0.0, 0.0);
    // Narrower than a voxel its sides are one sheet.
    pc_mesh narrow = drawn(context, 24, 48, true, narrow_sleeve);
    assert_close(evaluate(context, &narrow, &narrow).doubled_layers,
                 evaluate(context, &narrow, &narrow).doubled_area, 0.0);
    // Two of five quarters of the area lie in the fold; next to it triangles share vertices.
    pc_mesh hem = drawn(context, 80, 20, false, folded_hem);
    pc_mesh single = drawn(context, 10, 10, false, flat);
    assert_close(evaluate(context, &hem, &single).doubled_layers, 0.0, 0.0);
    assert_close(evaluate(context, &hem, &hem).doubled_layers, 0.4, 0.03);
    pc_mesh_free(context, &sleeve);
    pc_mesh_free(context, &prism);
    pc_mesh_free(context, &narrow);
    pc_mesh_free(context, &hem);
    pc_mesh_free(context, &single);
    pc_context_destroy(context);
}

static void tells_legs_and_thick_sleeves_from_doubled_layers(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    // One of four sides of each leg is next to the other leg, which makes them no doubled layers;
    // where the garment has one of the two walls only, they are.
    pc_mesh legs = join(context, drawn(context, 24, 20, true, left_leg),
                        drawn(context, 24, 20, true, right_leg));
    pc_mesh open = join(context, drawn(context, 24, 20, true, left_leg),
                        drawn(context, 18, 20, false, open_right_leg));
    for (size_t side = 0; side < 2; ++side) {
        assert_close(evaluate(context, &legs, &legs).doubled_area, 0.25, 0.02);
        assert_close(evaluate(context, &legs, &legs).doubled_layers, 0.0, 0.0);
        assert_close(evaluate(context, &open, &legs).doubled_layers, 0.25, 0.02);
        turn_over(&legs);
    }
    // The skins of thick cloth are one sheet, but those on the other side of a sleeve are another.
    pc_mesh thick = join(context, drawn(context, 24, 48, true, wide_sleeve),
                         drawn(context, 24, 48, true, narrow_sleeve));
    pc_mesh prism = drawn(context, 6, 40, true, wide_sleeve);
    assert_close(evaluate(context, &thick, &prism).doubled_layers, 0.0, 0.0);
    assert_close(evaluate(context, &thick, &thick).doubled_layers, 1.0, 0.01);
    pc_mesh_free(context, &legs);
    pc_mesh_free(context, &open);
    pc_mesh_free(context, &thick);
    pc_mesh_free(context, &prism);
    pc_context_destroy(context);
}

// ---- crossings --------------------------------------------------------------------------------

// Whether the segment from a to b pierces a triangle (Moeller and Trumbore), in long double.
static bool pierces(const double *a, const double *b, const double *t) {
    long double d[3], e1[3], e2[3], o[3], p[3], q[3];
    for (size_t k = 0; k < 3; ++k) {
        d[k] = (long double)b[k] - a[k];
        e1[k] = (long double)t[3 + k] - t[k];
        e2[k] = (long double)t[6 + k] - t[k];
        o[k] = (long double)a[k] - t[k];
    }
    for (size_t k = 0; k < 3; ++k) {
        const size_t l = (k + 1) % 3, m = (k + 2) % 3;
        p[k] = d[l] * e2[m] - d[m] * e2[l];
        q[k] = o[l] * e1[m] - o[m] * e1[l];
    }
    const long double det = e1[0] * p[0] + e1[1] * p[1] + e1[2] * p[2];
    const long double u = (o[0] * p[0] + o[1] * p[1] + o[2] * p[2]) / det;
    const long double v = (d[0] * q[0] + d[1] * q[1] + d[2] * q[2]) / det;
    const long double w = (e2[0] * q[0] + e2[1] * q[1] + e2[2] * q[2]) / det;
    return u > 0 && v > 0 && u + v < 1 && w > 0 && w < 1;
}

static uint64_t crossings_by_brute_force(const pc_mesh *mesh) {
    uint64_t count = 0;
    for (size_t s = 0; s < mesh->triangle_count; ++s) {
        for (size_t t = s + 1; t < mesh->triangle_count; ++t) {
            const double *a = &mesh->positions[9 * s], *b = &mesh->positions[9 * t];
            bool cross = false;
            for (size_t i = 0; i < 3; ++i) {
                const size_t j = (i + 1) % 3;
                cross =
                    cross || pierces(&a[3 * i], &a[3 * j], b) || pierces(&b[3 * i], &b[3 * j], a);
            }
            count += cross;
        }
    }
    return count;
}

static void agrees_with_brute_force_on_crossings(void **state) {
    (void)state;
    pc_context *context = test_context(3);
    for (uint64_t seed = 0; seed < 12; ++seed) {
        const double size = seed % 3 == 0 ? 0.1 : seed % 3 == 1 ? 0.5 : 2.0;
        pc_mesh mesh = soup(context, seed, 200, size);
        uint64_t count = 0;
        assert_ok(context, pci_count_self_intersections(context, "test", &mesh, &count));
        assert_int_equal(count, crossings_by_brute_force(&mesh));
        assert_true(seed % 3 == 0 || count > 100);
        pc_mesh_free(context, &mesh);
    }
    pc_context_destroy(context);
}

static uint64_t crossings(pc_context *context, double *positions, size_t vertices,
                          uint32_t *triangles, size_t triangle_count) {
    const pc_mesh mesh = {vertices, positions, triangle_count, triangles};
    uint64_t count = 99;
    assert_ok(context, pci_count_self_intersections(context, "test", &mesh, &count));
    return count;
}

static void decides_special_positions(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    uint32_t apart[] = {0, 1, 2, 3, 4, 5};
    uint32_t share_one[] = {0, 1, 2, 0, 3, 4};
    // Edges pass exactly through each other, yet the insides cross.
    double through_edges[] = {-1, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, -1, 0, 0, 1, 0, 1, 0};
    assert_int_equal(crossings(context, through_edges, 6, apart, 2), 1);
    // One stands on the other, with an edge or a corner.
    double stands[] = {-1, -1, 0, 1, -1, 0, 0, 1, 0, -0.1, 0, 0, 0.1, 0, 0, 0, 0, 1};
    assert_int_equal(crossings(context, stands, 6, apart, 2), 0);
    double on_corner[] = {-1, -1, 0, 1, -1, 0, 0, 1, 0, 0, 0, 0, 0.1, 0, 1, -0.1, 0, 1};
    assert_int_equal(crossings(context, on_corner, 6, apart, 2), 0);
    // The same corner pushed through by a billionth.
    on_corner[3 * 3 + 2] = -1e-9;
    assert_int_equal(crossings(context, on_corner, 6, apart, 2), 1);
    // Coplanar overlap is a doubled layer, no crossing.
    double coplanar[] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0.1, 0.1, 0, 1, 0.2, 0, 0.2, 1, 0};
    assert_int_equal(crossings(context, coplanar, 6, apart, 2), 0);
    // One shared corner: crossing beyond it, and only there.
    double beyond[] = {0, 0, 0, 2, -1, 0, 2, 1, 0, 2, 0, -1, 2, 0, 1};
    assert_int_equal(crossings(context, beyond, 5, share_one, 2), 1);
    double away[] = {0, 0, 0, 2, -1, 0, 2, 1, 0, -2, 0, -1, -2, 0, 1};
    assert_int_equal(crossings(context, away, 5, share_one, 2), 0);
    // Neither place nor size matters.
    for (size_t i = 0; i < 15; ++i) {
        beyond[i] = 1e-6 * beyond[i] + (i % 3 == 0 ? 100.0 : -7.0);
        away[i] = 1e-6 * away[i] + (i % 3 == 0 ? 100.0 : -7.0);
    }
    assert_int_equal(crossings(context, beyond, 5, share_one, 2), 1);
    assert_int_equal(crossings(context, away, 5, share_one, 2), 0);
    // Triangles without area cross nothing.
    double needle[] = {-1, -1, 0, 1, -1, 0, 0, 1, 0, 0, 0, -1, 0, 0, 0, 0, 0, 1};
    assert_int_equal(crossings(context, needle, 6, apart, 2), 0);
    pc_context_destroy(context);
}

// ---- distance ---------------------------------------------------------------------------------

static double directed(pc_context *context, const pc_mesh *from, const pc_mesh *to,
                       double tolerance) {
    pci_bvh *bvh = NULL;
    double distance = -1.0;
    assert_ok(context, pci_bvh_create(context, "test", to, &bvh));
    assert_ok(context,
              pci_directed_hausdorff(context, "test", from, to, bvh, tolerance, &distance));
    pci_bvh_destroy(context, bvh);
    return distance;
}

static void measures_shifted_squares(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    const double height = 0.25;
    pc_mesh whole = squares(context, 3, 1, &height), part = squares(context, 2, 1, &height);
    for (size_t v = 0; v < part.vertex_count; ++v) {
        part.positions[3 * v] *= 0.5; // covers half of the square, lifted by .1
        part.positions[3 * v + 2] += 0.1;
    }
    const pc_measures m = evaluate(context, &whole, &part);
    const double diagonal = sqrt(2.0), far = sqrt(0.5 * 0.5 + 0.1 * 0.1);
    assert_close(m.hausdorff_visual_to_proxy, far / diagonal, 1e-12);
    assert_close(m.hausdorff_proxy_to_visual, 0.1 / diagonal, 1e-12);
    assert_close(m.hausdorff, far / diagonal, 1e-12);
    assert_close(m.hausdorff_unit_cube, 2.0 * far, 1e-12);
    pc_mesh_free(context, &part);
    pc_mesh_free(context, &whole);
    pc_context_destroy(context);
}

static void finds_a_maximum_inside_a_triangle(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    // All corners of one large triangle lie on three small ones; its middle is far from them.
    double large[] = {0, 0, 0, 6, 0, 0, 0, 6, 0};
    double small[] = {0, 0, 0,  1, 0, 0, 0, 1, 0, 6, 0,  0, 5, 0,
                      0, 6, -1, 0, 0, 6, 0, 0, 5, 0, -1, 6, 0};
    uint32_t one[] = {0, 1, 2}, three[] = {0, 1, 2, 3, 4, 5, 6, 7, 8};
    const pc_mesh from = MESH(large, one), to = MESH(small, three);
    // On the hypotenuse (x, 6 - x), its middle is nearest to the first triangle's side (1, 0)-(0,
    // 1) and to (5, 0), (0, 5); dense samples confirm the maximum.
    double expected = 0.0;
    pci_bvh *bvh = NULL;
    assert_ok(context, pci_bvh_create(context, "test", &to, &bvh));
    for (size_t i = 0; i <= 600; ++i) {
        for (size_t j = 0; i + j <= 600; ++j) {
            const double point[3] = {0.01 * (double)i, 0.01 * (double)j, 0.0};
            expected = fmax(expected, pci_bvh_closest(bvh, point, INFINITY).distance);
        }
    }
    pci_bvh_destroy(context, bvh);
    assert_true(expected > 2.0);
    const double found = directed(context, &from, &to, 1e-6);
    assert_close(found, expected, 0.0072); // half a sample's diagonal
    assert_true(found * 1.0001 + 1e-6 >= expected);
    pc_context_destroy(context);
}

static void agrees_with_dense_samples_on_distance(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    for (uint64_t seed = 20; seed < 26; ++seed) {
        pc_mesh from = soup(context, seed, 12, 1.0), to = soup(context, seed + 100, 9, 0.5);
        // Brute force over points and triangles, 45 steps per side of a triangle.
        const size_t steps = 45;
        double expected = 0.0, spacing = 0.0;
        for (size_t t = 0; t < from.triangle_count; ++t) {
            const double *corner = &from.positions[9 * t];
            for (size_t c = 0; c < 3; ++c) {
                spacing =
                    fmax(spacing,
                         sqrt(pci_squared_distance(&corner[3 * c], &corner[3 * ((c + 1) % 3)])) /
                             (double)steps);
            }
            for (size_t i = 0; i <= steps; ++i) {
                for (size_t j = 0; i + j <= steps; ++j) {
                    double point[3], nearest = INFINITY, weights[3];
                    for (size_t k = 0; k < 3; ++k) {
                        point[k] = ((double)(steps - i - j) * corner[k] +
                                    (double)i * corner[3 + k] + (double)j * corner[6 + k]) /
                                   (double)steps;
                    }
                    for (size_t other = 0; other < to.triangle_count; ++other) {
                        const double *b = &to.positions[9 * other];
                        nearest = fmin(nearest, pci_triangle_squared_distance(point, b, b + 3,
                                                                              b + 6, weights));
                    }
                    expected = fmax(expected, sqrt(nearest));
                }
            }
        }
        const double tolerance = 1e-4, found = directed(context, &from, &to, tolerance);
        assert_true(found * 1.0001 + tolerance >= expected);
        assert_true(found <= expected + spacing);
        pc_mesh_free(context, &from);
        pc_mesh_free(context, &to);
    }
    pc_context_destroy(context);
}

static void keeps_the_bound_between_spheres(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    // The distance is nearly the same everywhere: the hardest case for branch and bound.
    pc_mesh outer = sphere(context, 24, 1.0), inner = sphere(context, 5, 0.9);
    const pc_measures m = evaluate(context, &outer, &inner);
    assert_true(m.hausdorff > 0.1 / (2.0 * sqrt(3.0)));
    assert_true(m.hausdorff < 0.2 / (2.0 * sqrt(3.0)));
    // Twice as large, elsewhere: nothing changes.
    for (size_t i = 0; i < 3 * outer.vertex_count; ++i) {
        outer.positions[i] = 2.0 * outer.positions[i] + 64.0;
    }
    for (size_t i = 0; i < 3 * inner.vertex_count; ++i) {
        inner.positions[i] = 2.0 * inner.positions[i] + 64.0;
    }
    assert_close(evaluate(context, &outer, &inner).hausdorff, m.hausdorff, 1e-9);
    pc_mesh_free(context, &outer);
    pc_mesh_free(context, &inner);
    pc_context_destroy(context);
}

// ---- triangles --------------------------------------------------------------------------------

static void measures_triangle_shapes(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    // A regular tetrahedron: everything is perfect.
    double tetrahedron[] = {1, 1, 1, 1, -1, -1, -1, 1, -1, -1, -1, 1};
    uint32_t faces[] = {0, 1, 2, 0, 2, 3, 0, 3, 1, 1, 3, 2};
    const pc_mesh regular = MESH(tetrahedron, faces);
    pc_measures m = evaluate(context, &regular, &regular);
    assert_close(m.min_angle_mean, 60.0, 1e-12);
    assert_close(m.min_angle_worst, 60.0, 1e-12);
    assert_close(m.min_angle_sd, 0.0, 1e-12);
    assert_close(m.edge_ratio_mean, 1.0, 1e-14);
    assert_close(m.aspect_ratio_mean, sqrt(0.75), 1e-14);
    assert_close(m.radius_ratio_mean, 1.0, 1e-14);
    // Right triangles with legs 3, 4 and 1, 1.
    double right[] = {0, 0, 0, 3, 0, 0, 0, 4, 0, 9, 0, 0, 10, 0, 0, 9, 1, 0};
    uint32_t two[] = {0, 1, 2, 3, 4, 5};
    const pc_mesh pair = MESH(right, two);
    m = evaluate(context, &pair, &pair);
    const double degrees = 180.0 / acos(-1.0);
    const double angle[2] = {atan(0.75) * degrees, 45.0}, edge[2] = {0.6, sqrt(0.5)};
    const double aspect[2] = {2.4 / 5.0, 0.5};
    const double radius[2] = {2.0 * 1.0 / 2.5, 2.0 * (1.0 - sqrt(0.5)) / sqrt(0.5)};
    assert_close(m.min_angle_mean, 0.5 * (angle[0] + angle[1]), 1e-12);
    assert_close(m.min_angle_sd, 0.5 * fabs(angle[0] - angle[1]), 1e-12);
    assert_close(m.min_angle_worst, angle[0], 1e-12);
    assert_close(m.edge_ratio_mean, 0.5 * (edge[0] + edge[1]), 1e-14);
    assert_close(m.edge_ratio_sd, 0.5 * fabs(edge[0] - edge[1]), 1e-14);
    assert_close(m.edge_ratio_worst, edge[0], 1e-14);
    assert_close(m.aspect_ratio_mean, 0.5 * (aspect[0] + aspect[1]), 1e-14);
    assert_close(m.aspect_ratio_worst, aspect[0], 1e-14);
    assert_close(m.radius_ratio_mean, 0.5 * (radius[0] + radius[1]), 1e-14);
    assert_close(m.radius_ratio_worst, radius[0], 1e-14);
    pc_context_destroy(context);
}

static void counts_triangles_by_shape(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    // Equilateral (space diagonal), legs 5 and 12 twice, and one without area.
    double positions[] = {1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 5, 0, 0, 0, 12, 0, 10, 0, 0};
    uint32_t triangles[] = {0, 1, 2, 3, 4, 5, 4, 3, 5, 3, 4, 6};
    const pc_mesh mesh = MESH(positions, triangles);
    pc_histogram histograms[PC_SHAPE_COUNT];
    assert_ok(context, pc_evaluate_shape(context, &mesh, histograms));
    // The angles are 60 and 22.6 degrees, the ratios 1 and 5/13, .866 and .355, 1 and 4/6.5.
    static const struct {
        const char *name;
        size_t best, right;
    } wanted[PC_SHAPE_COUNT] = {{"min_angle", 19, 7},
                                {"edge_ratio", 19, 7},
                                {"aspect_ratio", 17, 7},
                                {"radius_ratio", 19, 12}};
    for (size_t s = 0; s < PC_SHAPE_COUNT; ++s) {
        uint64_t sum = 0;
        for (size_t bin = 0; bin < PC_HISTOGRAM_BINS; ++bin) {
            sum += histograms[s].counts[bin];
        }
        assert_string_equal(histograms[s].name, wanted[s].name);
        assert_int_equal(sum, 4);
        assert_int_equal(histograms[s].counts[0], 1);
        assert_int_equal(histograms[s].counts[wanted[s].best], 1);
        assert_int_equal(histograms[s].counts[wanted[s].right], 2);
    }
    const pc_mesh nothing = {0};
    assert_int_equal(pc_evaluate_shape(context, &nothing, histograms), PC_ERROR_INVALID_MESH);
    assert_null(histograms[0].name);
    assert_int_equal(pc_evaluate_shape(context, &mesh, NULL), PC_ERROR_INVALID_ARGUMENT);
    pc_context_destroy(context);
}

// ---- contract ---------------------------------------------------------------------------------

static void is_the_same_at_any_thread_count(void **state) {
    (void)state;
    pc_measures reference;
    for (uint32_t i = 0; i < 4; ++i) {
        const uint32_t threads[4] = {1, 2, 3, 8};
        pc_context *context = test_context(threads[i]);
        pc_mesh visual = sphere(context, 20, 1.0), proxy = soup(context, 5, 300, 0.4);
        const pc_measures m = evaluate(context, &visual, &proxy);
        if (i == 0) {
            reference = m;
            assert_true(m.self_intersections > 0 && m.doubled_area > 0.0);
        }
        assert_memory_equal(&m, &reference, sizeof(m));
        pc_mesh_free(context, &visual);
        pc_mesh_free(context, &proxy);
        pc_context_destroy(context);
    }
}

static void refuses_bad_input(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    double positions[] = {0, 0, 0, 1, 0, 0, 0, 1, 0}, broken[] = {0, 0, 0, 1, 0, 0, 0, NAN, 0};
    double point[] = {1, 2, 3, 1, 2, 3, 1, 2, 3};
    uint32_t triangles[] = {0, 1, 2}, outside[] = {0, 1, 3};
    const pc_mesh good = MESH(positions, triangles), empty = {0}, nan = MESH(broken, triangles);
    const pc_mesh index = MESH(positions, outside), dot = MESH(point, triangles);
    pc_measures m = {.vertices = 7};
    assert_int_equal(pc_evaluate(context, NULL, &good, &m), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_evaluate(context, &good, NULL, &m), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_evaluate(context, &good, &good, NULL), PC_ERROR_INVALID_ARGUMENT);
    const pc_mesh *bad[] = {&empty, &nan, &index};
    for (size_t i = 0; i < 3; ++i) {
        assert_int_equal(pc_evaluate(context, bad[i], &good, &m), PC_ERROR_INVALID_MESH);
        assert_int_equal(pc_evaluate(context, &good, bad[i], &m), PC_ERROR_INVALID_MESH);
        assert_int_equal(m.vertices, 0);
    }
    assert_int_equal(pc_evaluate(context, &dot, &good, &m), PC_ERROR_INVALID_MESH);
    // A proxy without area is measured, not refused.
    m = evaluate(context, &good, &dot);
    assert_close(m.doubled_area, 0.0, 0.0);
    assert_close(m.radius_ratio_worst, 0.0, 0.0);
    // (1, 2, 3) is nearest to the corner (0, 1, 0).
    assert_close(m.hausdorff_proxy_to_visual, sqrt(11.0) / sqrt(2.0), 1e-12);
    pc_context_destroy(context);
}

static void survives_a_lack_of_memory(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    pc_mesh visual = sphere(context, 6, 1.0), proxy = sphere(context, 3, 0.9);
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        pc_measures m = {.vertices = 7};
        s.status = pc_evaluate(context, &visual, &proxy, &m);
        assert_int_equal(m.vertices, s.status == PC_OK ? proxy.vertex_count : 0);
    }
    assert_true(s.failures > 20);
    pc_mesh_free(context, &visual);
    pc_mesh_free(context, &proxy);
    pc_context_destroy(context);
    assert_int_equal(counter.live, 0);
}

static void describes_every_field(void **state) {
    (void)state;
    assert_int_equal(pc_measures_record.size, sizeof(pc_measures));
    assert_int_equal(pc_measures_record.field_count * 8, sizeof(pc_measures));
    for (size_t i = 0; i < pc_measures_record.field_count; ++i) {
        assert_int_equal(pc_measures_record.fields[i].offset, 8 * i);
        assert_true(strlen(pc_measures_record.fields[i].help) > 0);
        assert_non_null(pc_measures_record.fields[i].unit);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(counts_a_sphere),
        cmocka_unit_test(counts_a_moebius_strip),
        cmocka_unit_test(counts_pages_of_a_book),
        cmocka_unit_test(counts_parts_that_touch_at_a_vertex),
        cmocka_unit_test(counts_loops_of_a_tube_with_mixed_winding),
        cmocka_unit_test(finds_doubled_layers),
        cmocka_unit_test(counts_layers_over_one_sheet),
        cmocka_unit_test(tells_sleeves_and_hems_from_doubled_layers),
        cmocka_unit_test(tells_legs_and_thick_sleeves_from_doubled_layers),
        cmocka_unit_test(agrees_with_brute_force_on_crossings),
        cmocka_unit_test(decides_special_positions),
        cmocka_unit_test(measures_shifted_squares),
        cmocka_unit_test(finds_a_maximum_inside_a_triangle),
        cmocka_unit_test(agrees_with_dense_samples_on_distance),
        cmocka_unit_test(keeps_the_bound_between_spheres),
        cmocka_unit_test(measures_triangle_shapes),
        cmocka_unit_test(counts_triangles_by_shape),
        cmocka_unit_test(is_the_same_at_any_thread_count),
        cmocka_unit_test(refuses_bad_input),
        cmocka_unit_test(survives_a_lack_of_memory),
        cmocka_unit_test(describes_every_field),
    };
    return cmocka_run_group_tests_name("evaluate", tests, NULL, NULL);
}
