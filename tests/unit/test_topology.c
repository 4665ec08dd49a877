#include "geometry/topology.h"

#include "core/union_find.h"
#include "geometry/locality.h"
#include "support/surfaces.h"
#include "support/test.h"

#include <stdlib.h>

static pc_mesh allocate_mesh(pc_context *context, size_t vertices, size_t triangles) {
    pc_mesh mesh = {.vertex_count = vertices, .triangle_count = triangles};
    mesh.positions = PCI_ALLOCATE(context, double, 3 * vertices);
    mesh.triangles = PCI_ALLOCATE(context, uint32_t, 3 * triangles);
    assert_non_null(mesh.positions);
    assert_non_null(mesh.triangles);
    return mesh;
}

// Triangles between random vertices: repeated vertices, duplicates and crowded edges abound.
static pc_mesh random_triangles(pc_context *context, size_t vertices, size_t triangles,
                                uint64_t seed) {
    pc_mesh mesh = allocate_mesh(context, vertices, triangles);
    for (size_t i = 0; i < 3 * triangles; ++i) {
        mesh.triangles[i] = (uint32_t)(pci_random(seed, i, 0) * (double)vertices);
    }
    for (size_t i = 0; i < 3 * vertices; ++i) {
        mesh.positions[i] = pci_random(seed, i, 1);
    }
    return mesh;
}

// An n by n sheet of unit quads with the marked quads left out.
static pc_mesh sheet(pc_context *context, uint32_t n, const uint8_t *holes) {
    pc_mesh mesh = allocate_mesh(context, (n + 1) * (n + 1), 2 * (size_t)n * n);
    mesh.triangle_count = 0;
    for (uint32_t v = 0; v < (n + 1) * (n + 1); ++v) {
        mesh.positions[3 * v] = v % (n + 1);
        mesh.positions[3 * v + 1] = v / (n + 1);
    }
    for (uint32_t q = 0; q < n * n; ++q) {
        if (holes == NULL || !holes[q]) {
            const uint32_t a = q / n * (n + 1) + q % n, b = a + n + 1;
            const uint32_t quad[6] = {a, a + 1, b + 1, a, b + 1, b};
            memcpy(&mesh.triangles[3 * mesh.triangle_count], quad, sizeof(quad));
            mesh.triangle_count += 2;
        }
    }
    return mesh;
}

static bool has_vertex(const pc_mesh *mesh, size_t t, uint32_t v) {
    const uint32_t *corner = &mesh->triangles[3 * t];
    return corner[0] == v || corner[1] == v || corner[2] == v;
}

static bool has_edge(const pc_mesh *mesh, size_t t, uint32_t a, uint32_t b) {
    return a != b && has_vertex(mesh, t, a) && has_vertex(mesh, t, b);
}

// ---- tables -------------------------------------------------------------------------------------

static void assert_tables(const pc_mesh *mesh, const pci_topology *t) {
    // Edges: exactly the joined pairs, ascending, each with its triangles.
    size_t edge = 0;
    for (uint32_t a = 0; a < mesh->vertex_count; ++a) {
        size_t neighbours = 0;
        for (uint32_t b = 0; b < mesh->vertex_count; ++b) {
            const size_t begin = edge < t->edge_count ? t->edge_triangle_offsets[edge] : 0;
            size_t found = 0;
            for (uint32_t f = 0; f < mesh->triangle_count; ++f) {
                if (has_edge(mesh, f, a, b)) {
                    if (a < b) {
                        assert_true(edge < t->edge_count);
                        assert_int_equal(t->edge_triangles[begin + found], f);
                    }
                    ++found;
                }
            }
            if (found > 0) {
                assert_int_equal(t->ring[t->ring_offsets[a] + neighbours], b);
                ++neighbours;
            }
            if (found > 0 && a < b) {
                assert_int_equal(t->edges[2 * edge], a);
                assert_int_equal(t->edges[2 * edge + 1], b);
                assert_int_equal(t->edge_triangle_offsets[edge + 1] - begin, found);
                ++edge;
            }
        }
        assert_int_equal(t->ring_offsets[a + 1] - t->ring_offsets[a], neighbours);

        size_t around = t->vertex_triangle_offsets[a];
        for (uint32_t f = 0; f < mesh->triangle_count; ++f) {
            if (has_vertex(mesh, f, a)) {
                assert_int_equal(t->vertex_triangles[around], f);
                ++around;
            }
        }
        assert_int_equal(t->vertex_triangle_offsets[a + 1], around);
    }
    assert_int_equal(t->edge_count, edge);

    for (size_t c = 0; c < 3 * mesh->triangle_count; ++c) {
        const uint32_t a = mesh->triangles[c], b = mesh->triangles[c / 3 * 3 + (c + 1) % 3];
        const uint32_t e = t->triangle_edges[c];
        if (a == b) {
            assert_int_equal(e, PC_INVALID_INDEX);
        } else {
            assert_int_equal(t->edges[2 * e], a < b ? a : b);
            assert_int_equal(t->edges[2 * e + 1], a < b ? b : a);
        }
    }
}

static void tables_equal_brute_force(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    for (uint64_t seed = 0; seed < 60; ++seed) {
        pci_scratch scratch = pci_scratch_begin(context);
        pc_mesh mesh = random_triangles(context, 3 + seed % 30, seed, seed);
        pci_topology topology;
        assert_true(pci_topology_build(&scratch, &mesh, &topology));
        assert_tables(&mesh, &topology);
        pci_scratch_end(&scratch);
        pc_mesh_free(context, &mesh);
    }
    pc_context_destroy(context);
}

static size_t brute_force_components(const pc_mesh *mesh, uint32_t *component) {
    for (uint32_t f = 0; f < mesh->triangle_count; ++f) {
        component[f] = f;
    }
    for (bool changed = true; changed;) {
        changed = false;
        for (size_t f = 0; f < mesh->triangle_count; ++f) {
            for (size_t g = 0; g < mesh->triangle_count; ++g) {
                const uint32_t *c = &mesh->triangles[3 * g];
                const bool joined = has_edge(mesh, f, c[0], c[1]) ||
                                    has_edge(mesh, f, c[1], c[2]) || has_edge(mesh, f, c[2], c[0]);
                if (joined && component[g] < component[f]) {
                    component[f] = component[g];
                    changed = true;
                }
            }
        }
    }
    size_t count = 0; // renumber in order of the first triangle
    uint32_t *number = calloc(mesh->triangle_count + 1, sizeof(*number));
    assert_non_null(number);
    for (uint32_t f = 0; f < mesh->triangle_count; ++f) {
        if (component[f] == f) {
            number[f] = (uint32_t)count++;
        }
        component[f] = number[component[f]];
    }
    free(number);
    return count;
}

// Fans by definition: triangles around the vertex, joined when they share an edge at the vertex.
// Triangles with a repeated vertex are no part of the surface.
static size_t brute_force_nonmanifold_vertices(const pc_mesh *mesh) {
    size_t count = 0;
    for (uint32_t v = 0; v < mesh->vertex_count; ++v) {
        uint32_t group[64];
        size_t groups = 0;
        for (uint32_t f = 0; f < mesh->triangle_count; ++f) {
            const uint32_t *c = &mesh->triangles[3 * (size_t)f];
            const bool proper = c[0] != c[1] && c[1] != c[2] && c[2] != c[0];
            group[f] = proper && has_vertex(mesh, f, v) ? f : PC_INVALID_INDEX;
        }
        for (bool changed = true; changed;) {
            changed = false;
            for (size_t f = 0; f < mesh->triangle_count; ++f) {
                for (size_t g = 0; g < mesh->triangle_count; ++g) {
                    if (group[f] == PC_INVALID_INDEX || group[g] == PC_INVALID_INDEX) {
                        continue;
                    }
                    for (uint32_t w = 0; w < mesh->vertex_count; ++w) {
                        if (has_edge(mesh, f, v, w) && has_edge(mesh, g, v, w) &&
                            group[g] < group[f]) {
                            group[f] = group[g];
                            changed = true;
                        }
                    }
                }
            }
        }
        for (uint32_t f = 0; f < mesh->triangle_count; ++f) {
            groups += group[f] == f;
        }
        count += groups > 1;
    }
    return count;
}

static void counts_equal_brute_force(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    for (uint64_t seed = 0; seed < 60; ++seed) {
        pci_scratch scratch = pci_scratch_begin(context);
        pc_mesh mesh = random_triangles(context, 4 + seed / 2, 1 + seed % 40, seed);
        pci_topology topology;
        assert_true(pci_topology_build(&scratch, &mesh, &topology));
        uint32_t found[64], expected[64];
        const size_t components = pci_triangle_components(&scratch, &mesh, &topology, found);
        assert_int_equal(components, brute_force_components(&mesh, expected));
        assert_memory_equal(found, expected, mesh.triangle_count * sizeof(uint32_t));

        size_t crowded = 0;
        for (uint32_t a = 0; a < mesh.vertex_count; ++a) {
            for (uint32_t b = 0; b < a; ++b) {
                size_t triangles = 0;
                for (size_t f = 0; f < mesh.triangle_count; ++f) {
                    triangles += has_edge(&mesh, f, a, b);
                }
                crowded += triangles > 2;
            }
        }
        assert_int_equal(pci_nonmanifold_edge_count(&topology), crowded);
        pc_measures measures;
        assert_ok(context, pc_evaluate(context, &mesh, &mesh, &measures));
        assert_int_equal(measures.nonmanifold_vertices, brute_force_nonmanifold_vertices(&mesh));
        pci_scratch_end(&scratch);
        pc_mesh_free(context, &mesh);
    }
    pc_context_destroy(context);
}

// A sheet of two by two quads beside a tetrahedron.
static void marks_part_and_borders_show(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pci_scratch scratch = pci_scratch_begin(context);
    pc_mesh flat = sheet(context, 2, NULL);
    pc_mesh mesh = allocate_mesh(context, 13, 12);
    const uint32_t closed[12] = {9, 11, 10, 9, 10, 12, 10, 11, 12, 11, 9, 12};
    memset(mesh.positions, 0, 39 * sizeof(double));
    memcpy(mesh.triangles, flat.triangles, 24 * sizeof(uint32_t));
    memcpy(&mesh.triangles[24], closed, sizeof(closed));
    pci_topology topology;
    assert_true(pci_topology_build_edges(&scratch, &mesh, &topology));
    uint32_t component[12], parents[12];
    uint8_t border[13] = {0}, open[2] = {0}, marked[12] = {0};
    assert_int_equal(pci_triangle_components(&scratch, &mesh, &topology, component), 2);
    pci_mark_border(&topology, border);
    pci_mark_open(&topology, component, open);
    for (size_t v = 0; v < 13; ++v) {
        assert_int_equal(border[v], v < 9 && v != 4); // all but the middle of the sheet
    }
    assert_int_equal(open[0], 1);
    assert_int_equal(open[1], 0);
    marked[1] = 7, marked[4] = 1; // side by side, they cut off triangle 5
    pci_join_alike(&topology, 12, marked, parents);
    for (uint32_t t = 0; t < 12; ++t) {
        const uint32_t root = t == 1 || t == 4 ? 1 : t == 5 ? 5 : t < 8 ? 0 : 8;
        assert_int_equal(pci_find_root(parents, t), root);
    }
    pci_scratch_end(&scratch);
    pc_mesh_free(context, &flat);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

// ---- boundary loops -----------------------------------------------------------------------------

typedef struct loops {
    size_t count, *offsets;
    uint32_t *vertices;
} loops;

static loops find_loops(pci_scratch *scratch, const pc_mesh *mesh) {
    pci_topology topology;
    loops found = {0};
    assert_true(pci_topology_build(scratch, mesh, &topology));
    assert_true(pci_boundary_loops(scratch, mesh, &topology, &found.count, &found.offsets,
                                   &found.vertices));
    return found;
}

static void sheet_has_one_loop_along_its_winding(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pci_scratch scratch = pci_scratch_begin(context);
    pc_mesh mesh = sheet(context, 3, NULL);
    const loops found = find_loops(&scratch, &mesh);
    assert_int_equal(found.count, 1);
    assert_int_equal(found.offsets[0], 0);
    assert_int_equal(found.offsets[1], 12);
    double area = 0.0; // positive: counter-clockwise like the triangles
    for (size_t i = 0; i < 12; ++i) {
        const double *p = &mesh.positions[3 * found.vertices[i]];
        const double *q = &mesh.positions[3 * found.vertices[(i + 1) % 12]];
        area += 0.5 * (p[0] * q[1] - p[1] * q[0]);
        assert_close(fabs(p[0] - q[0]) + fabs(p[1] - q[1]), 1.0, 0.0);
    }
    assert_close(area, 9.0, 0.0);
    pci_scratch_end(&scratch);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

// Loops follow fans: a vertex with two fans counts as two vertices.
static void loops_follow_fans(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pci_scratch scratch = pci_scratch_begin(context);
    // Two holes that touch in a vertex: its fans lie between them, so pulling the fans apart opens
    // one hole into the other.
    const uint8_t holes[25] = {[6] = 1, [12] = 1};
    pc_mesh mesh = sheet(context, 5, holes);
    const loops found = find_loops(&scratch, &mesh);
    assert_int_equal(found.count, 2);
    assert_int_equal(found.offsets[1], 20);
    assert_int_equal(found.offsets[2], 28);
    pc_mesh_free(context, &mesh);

    // Two triangles that share a vertex only.
    mesh = allocate_mesh(context, 5, 2);
    const uint32_t bow_tie[6] = {0, 1, 2, 2, 3, 4};
    memcpy(mesh.triangles, bow_tie, sizeof(bow_tie));
    const loops tie = find_loops(&scratch, &mesh);
    assert_int_equal(tie.count, 2);
    assert_int_equal(tie.offsets[1], 3);
    assert_int_equal(tie.offsets[2], 6);
    pci_scratch_end(&scratch);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

static void closed_mesh_has_no_loop(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pci_scratch scratch = pci_scratch_begin(context);
    pc_mesh mesh = allocate_mesh(context, 4, 4);
    const uint32_t tetrahedron[12] = {0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3};
    memcpy(mesh.triangles, tetrahedron, sizeof(tetrahedron));
    assert_int_equal(find_loops(&scratch, &mesh).count, 0);
    pci_topology topology;
    assert_true(pci_topology_build(&scratch, &mesh, &topology));
    assert_int_equal(topology.edge_count, 6);
    pci_scratch_end(&scratch);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

// Far from the origin, and turned inside out; the tube is closed by fans around a vertex of its
// rim.
static void volumes_have_the_sign_of_the_front(void **state) {
    (void)state;
    const double pi = 3.14159265358979323846, far[3] = {1e4, -1e4, 2e4};
    pc_context *context = test_context(1);
    pci_scratch scratch = pci_scratch_begin(context);
    pc_mesh ball = test_sphere(context, 24), tube = test_tube(context, 64, 8, 0.5, 2.0);
    pc_mesh mesh = test_union(context, &ball, &tube, far);
    double inside_out = 1.0;
    for (int turn = 0; turn < 2; ++turn, inside_out = -1.0) {
        uint32_t *component = PCI_SCRATCH(&scratch, uint32_t, mesh.triangle_count);
        const size_t count = pci_manifold_components(&scratch, &mesh, component);
        assert_int_equal(count, 2);
        const double *volumes = pci_component_volumes(&scratch, &mesh, component, count);
        assert_non_null(volumes);
        assert_close(volumes[0], inside_out * 4.0 * pi / 3.0, 0.05);
        assert_close(volumes[1], inside_out * pi / 3.0, 0.01);
        for (size_t t = 0; t < mesh.triangle_count; ++t) {
            uint32_t *corner = &mesh.triangles[3 * t];
            const uint32_t second = corner[1];
            corner[1] = corner[2], corner[2] = second;
        }
    }
    pc_mesh_free(context, &ball);
    pc_mesh_free(context, &tube);
    pc_mesh_free(context, &mesh);
    pci_scratch_end(&scratch);
    pc_context_destroy(context);
}

// Sheets with random holes: every border half-edge is in exactly one loop, and loops are chains.
static void loops_cover_the_border_once(void **state) {
    (void)state;
    enum { SIDE = 9 };
    pc_context *context = test_context(1);
    for (uint64_t seed = 0; seed < 30; ++seed) {
        pci_scratch scratch = pci_scratch_begin(context);
        uint8_t holes[SIDE * SIDE];
        for (size_t i = 0; i < SIDE * SIDE; ++i) {
            holes[i] = pci_random(seed, i, 0) < 0.4;
        }
        pc_mesh mesh = sheet(context, SIDE, holes);
        const loops found = find_loops(&scratch, &mesh);
        size_t border = 0;
        for (size_t c = 0; c < 3 * mesh.triangle_count; ++c) {
            const uint32_t a = mesh.triangles[c], b = mesh.triangles[c / 3 * 3 + (c + 1) % 3];
            size_t triangles = 0, listed = 0;
            for (size_t f = 0; f < mesh.triangle_count; ++f) {
                triangles += has_edge(&mesh, f, a, b);
            }
            for (size_t l = 0; l < found.count; ++l) {
                const size_t begin = found.offsets[l], end = found.offsets[l + 1];
                for (size_t i = begin; i < end; ++i) {
                    listed +=
                        found.vertices[i] == a && found.vertices[i + 1 < end ? i + 1 : begin] == b;
                }
            }
            assert_int_equal(listed, triangles == 1);
            border += triangles == 1;
        }
        assert_int_equal(found.offsets[found.count], border);
        pci_scratch_end(&scratch);
        pc_mesh_free(context, &mesh);
    }
    pc_context_destroy(context);
}

// No promise about the loops of arbitrary triangles, but they stay within bounds and end.
static void loops_survive_any_mesh(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    for (uint64_t seed = 0; seed < 200; ++seed) {
        pci_scratch scratch = pci_scratch_begin(context);
        pc_mesh mesh = random_triangles(context, 3 + seed % 20, seed % 50, seed);
        const loops found = find_loops(&scratch, &mesh);
        assert_true(found.offsets[found.count] <= 3 * mesh.triangle_count);
        for (size_t l = 0; l < found.count; ++l) {
            assert_true(found.offsets[l] < found.offsets[l + 1]);
        }
        pci_scratch_end(&scratch);
        pc_mesh_free(context, &mesh);
    }
    pc_context_destroy(context);
}

// ---- geometry -----------------------------------------------------------------------------------

static void compact_keeps_order(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pci_scratch scratch = pci_scratch_begin(context);
    pc_mesh mesh = random_triangles(context, 20, 12, 5);
    const uint8_t keep[12] = {0, 1, 0, 0, 1, 1, 0, 0, 0, 1, 0, 0};
    pc_mesh result = {0};
    uint32_t *kept = NULL;
    assert_true(pci_mesh_compact(&scratch, &mesh, keep, &result, &kept));
    assert_int_equal(result.triangle_count, 4);
    size_t written = 0;
    for (size_t t = 0; t < 12; ++t) {
        for (size_t c = 0; keep[t] && c < 3; ++c) {
            const uint32_t v = result.triangles[written++];
            assert_true(v < result.vertex_count);
            assert_int_equal(kept[v], mesh.triangles[3 * t + c]);
        }
    }
    for (size_t v = 0; v < result.vertex_count; ++v) {
        assert_true(v == 0 || kept[v - 1] < kept[v]);
        assert_memory_equal(&result.positions[3 * v], &mesh.positions[3 * (size_t)kept[v]],
                            3 * sizeof(double));
        bool used = false;
        for (size_t c = 0; c < 12; ++c) {
            used |= result.triangles[c] == v;
        }
        assert_true(used);
    }
    pc_mesh_free(context, &result);
    assert_true(pci_mesh_compact(&scratch, &mesh, NULL, &result, NULL));
    assert_int_equal(result.triangle_count, 12);
    pc_mesh_free(context, &result);
    pci_scratch_end(&scratch);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

static void areas_normals_and_boxes_are_right(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh mesh = allocate_mesh(context, 5, 3);
    // A large triangle in z = 0, a small one in y = 0, and one without area; vertex 4 is unused.
    const double positions[15] = {0, 0, 0, 3, 0, 0, 0, 4, 0, 0, 0, -1, 7, 8, 9};
    const uint32_t triangles[9] = {0, 1, 2, 0, 1, 3, 0, 1, 1};
    memcpy(mesh.positions, positions, sizeof(positions));
    memcpy(mesh.triangles, triangles, sizeof(triangles));
    assert_close(pci_triangle_area(&mesh, 0), 6.0, 0.0);
    assert_close(pci_triangle_area(&mesh, 1), 1.5, 0.0);
    assert_close(pci_triangle_area(&mesh, 2), 0.0, 0.0);
    double normals[15];
    pci_vertex_normals(&mesh, normals);
    const double shared[3] = {0.0, 1.5 / hypot(6.0, 1.5), 6.0 / hypot(6.0, 1.5)};
    const double expected[15] = {0, shared[1], shared[2], 0, shared[1], shared[2], 0, 0,
                                 1, 0,         1,         0, 0,         0,         0};
    for (size_t i = 0; i < 15; ++i) {
        assert_close(normals[i], expected[i], 1e-15);
    }
    double minimum[3], maximum[3];
    pci_bounding_box(&mesh, minimum, maximum);
    assert_close(minimum[2], -1.0, 0.0);
    assert_close(maximum[0], 7.0, 0.0);
    assert_close(pci_diagonal(&mesh), sqrt(49.0 + 64.0 + 100.0), 1e-14);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

// ---- memory order -------------------------------------------------------------------------------

// Mean distance in memory between the ends of an edge.
static double mean_stride(const pc_mesh *mesh) {
    double sum = 0.0;
    for (size_t h = 0; h < 3 * mesh->triangle_count; ++h) {
        const double a = mesh->triangles[h], b = mesh->triangles[h - h % 3 + (h + 1) % 3];
        sum += fabs(a - b) / (3.0 * (double)mesh->triangle_count);
    }
    return sum;
}

// A shuffled sheet becomes the same surface with neighbours side by side.
static void sorting_follows_space(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    const uint32_t n = 64;
    pc_mesh mesh = sheet(context, n, NULL);
    const size_t nv = mesh.vertex_count;
    uint32_t *number = PCI_ALLOCATE(context, uint32_t, nv);
    double *positions = PCI_ALLOCATE(context, double, 3 * nv);
    for (uint32_t v = 0; v < nv; ++v) { // a permutation: 2003 and 65 * 65 have no common divisor
        number[v] = (uint32_t)((v * 2003ull) % nv);
        memcpy(&positions[3 * (size_t)number[v]], &mesh.positions[3 * (size_t)v],
               3 * sizeof(double));
    }
    memcpy(mesh.positions, positions, 3 * nv * sizeof(double));
    for (size_t i = 0; i < 3 * mesh.triangle_count; ++i) {
        mesh.triangles[i] = number[mesh.triangles[i]];
    }
    pci_scratch scratch = pci_scratch_begin(context);
    pc_mesh sorted = {0};
    uint32_t *order = NULL;
    assert_true(pci_sort_mesh(&scratch, &mesh, &sorted, &order));
    assert_int_equal(sorted.vertex_count, nv);
    assert_int_equal(sorted.triangle_count, mesh.triangle_count);
    for (size_t v = 0; v < nv; ++v) {
        assert_memory_equal(&sorted.positions[3 * v], &mesh.positions[3 * (size_t)order[v]],
                            3 * sizeof(double));
    }
    // Every quad of the sheet occurs twice, once per triangle, with the winding of the sheet.
    uint8_t *quads = PCI_ALLOCATE(context, uint8_t, (size_t)n * n);
    for (size_t t = 0; t < sorted.triangle_count; ++t) {
        double low[2] = {n, n}, p[3][2];
        for (size_t c = 0; c < 3; ++c) {
            for (size_t k = 0; k < 2; ++k) {
                p[c][k] = sorted.positions[3 * (size_t)sorted.triangles[3 * t + c] + k];
                low[k] = fmin(low[k], p[c][k]);
            }
        }
        ++quads[(size_t)low[1] * n + (size_t)low[0]];
        assert_close((p[1][0] - p[0][0]) * (p[2][1] - p[0][1]) -
                         (p[1][1] - p[0][1]) * (p[2][0] - p[0][0]),
                     1.0, 1e-12);
    }
    for (size_t q = 0; q < (size_t)n * n; ++q) {
        assert_int_equal(quads[q], 2);
    }
    assert_true(mean_stride(&mesh) > 1000.0);
    assert_true(mean_stride(&sorted) < 100.0);
    pci_scratch_end(&scratch);
    pc_mesh_free(context, &mesh);
    pc_release(context, number);
    pc_release(context, positions);
    pc_release(context, quads);
    pc_context_destroy(context);
}

// ---- lack of memory -----------------------------------------------------------------------------

static void *rationed_allocate(void *user, size_t size) {
    long *left = user;
    return *left == 0 ? NULL : (--*left, malloc(size));
}

static void plain_free(void *user, void *memory) {
    (void)user;
    free(memory);
}

static void lack_of_memory_is_reported(void **state) {
    (void)state;
    long left = -1;
    const pc_context_options options = {.allocator = {rationed_allocate, plain_free, &left},
                                        .threads = 1};
    pc_context *context = NULL;
    assert_int_equal(pc_context_create(&options, &context), PC_OK);
    pc_mesh mesh = random_triangles(context, 10, 20, 1);
    long ration = 0;
    for (bool done = false; !done; ++ration) {
        pci_scratch scratch = pci_scratch_begin(context);
        pci_topology topology;
        uint32_t component[20], *vertices = NULL, *order = NULL;
        size_t count = 0, *offsets = NULL;
        pc_mesh copy = {0}, sorted;
        left = ration;
        done = pci_topology_build(&scratch, &mesh, &topology) &&
               pci_boundary_loops(&scratch, &mesh, &topology, &count, &offsets, &vertices) &&
               pci_triangle_components(&scratch, &mesh, &topology, component) > 0 &&
               pci_sort_mesh(&scratch, &mesh, &sorted, &order) &&
               pci_mesh_compact(&scratch, &mesh, NULL, &copy, NULL);
        left = -1;
        assert_true(done == (copy.positions != NULL));
        pc_mesh_free(context, &copy);
        pci_scratch_end(&scratch);
    }
    assert_true(ration > 15);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

// So many copies beside each other have the tables of one, shifted: with any number of threads.
static void tables_of_large_meshes_are_right(void **state) {
    (void)state;
    enum { copies = 200, vertices = 30, triangles = 60 };
    for (uint32_t threads = 1; threads <= 2; ++threads) {
        pc_context *context = test_context(threads);
        pc_mesh one = random_triangles(context, vertices, triangles, 5);
        pc_mesh all = random_triangles(context, copies * vertices, copies * triangles, 5);
        for (size_t i = 0; i < 3 * all.triangle_count; ++i) {
            const size_t copy = i / (3 * one.triangle_count);
            all.triangles[i] =
                one.triangles[i % (3 * one.triangle_count)] + (uint32_t)(copy * vertices);
        }
        pci_scratch scratch = pci_scratch_begin(context);
        pci_topology small, large;
        assert_true(pci_topology_build(&scratch, &one, &small));
        assert_true(pci_topology_build(&scratch, &all, &large));
        const size_t edges = small.edge_count, sides = small.edge_triangle_offsets[edges];
        assert_int_equal(large.edge_count, copies * edges);
        for (size_t e = 0; e <= large.edge_count; ++e) {
            const size_t copy = e / edges;
            assert_int_equal(large.edge_triangle_offsets[e],
                             copy * sides + small.edge_triangle_offsets[e % edges]);
        }
        for (size_t i = 0; i < 2 * large.edge_count; ++i) {
            const size_t copy = i / (2 * edges);
            assert_int_equal(large.edges[i], copy * vertices + small.edges[i % (2 * edges)]);
        }
        for (size_t i = 0; i < copies * sides; ++i) {
            const size_t copy = i / sides;
            assert_int_equal(large.edge_triangles[i],
                             copy * triangles + small.edge_triangles[i % sides]);
        }
        for (size_t i = 0; i < 3 * all.triangle_count; ++i) {
            const uint32_t edge = small.triangle_edges[i % (3 * triangles)];
            const size_t copy = i / (3 * triangles);
            assert_int_equal(large.triangle_edges[i],
                             edge == PC_INVALID_INDEX ? edge : copy * edges + edge);
        }
        pci_scratch_end(&scratch);
        pc_mesh_free(context, &one);
        pc_mesh_free(context, &all);
        pc_context_destroy(context);
    }
}

static bool same_corners(const pc_mesh *mesh, size_t s, size_t t) {
    uint32_t found = 0;
    for (size_t i = 0; i < 9; ++i) { // each corner of one with each of the other
        found += mesh->triangles[3 * s + i / 3] == mesh->triangles[3 * t + i % 3];
    }
    return found == 3;
}

// Few and many triangles at a vertex.
static void duplicates_are_those_of_all_pairs(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    static const size_t sizes[] = {4, 12, 25};
    for (size_t k = 0; k < 3; ++k) {
        pc_mesh mesh = random_triangles(context, sizes[k], 300, 17 + k);
        for (size_t t = 0; t < mesh.triangle_count; ++t) { // proper ones
            uint32_t *v = &mesh.triangles[3 * t];
            v[1] = v[1] == v[0] ? (v[0] + 1) % (uint32_t)sizes[k] : v[1];
            while (v[2] == v[0] || v[2] == v[1]) {
                v[2] = (v[2] + 1) % (uint32_t)sizes[k];
            }
        }
        uint8_t duplicate[300] = {0};
        size_t count = 0;
        pci_scratch scratch = pci_scratch_begin(context);
        assert_true(pci_mark_duplicates(&scratch, &mesh, duplicate));
        for (size_t t = 0; t < mesh.triangle_count; ++t) {
            bool repeats = false;
            for (size_t s = 0; s < t; ++s) {
                repeats = repeats || same_corners(&mesh, s, t);
            }
            assert_int_equal(duplicate[t], repeats);
            count += repeats;
        }
        assert_true(count > 0);
        pci_scratch_end(&scratch);
        pc_mesh_free(context, &mesh);
    }
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(tables_equal_brute_force),
        cmocka_unit_test(counts_equal_brute_force),
        cmocka_unit_test(marks_part_and_borders_show),
        cmocka_unit_test(sheet_has_one_loop_along_its_winding),
        cmocka_unit_test(loops_follow_fans),
        cmocka_unit_test(closed_mesh_has_no_loop),
        cmocka_unit_test(volumes_have_the_sign_of_the_front),
        cmocka_unit_test(loops_cover_the_border_once),
        cmocka_unit_test(loops_survive_any_mesh),
        cmocka_unit_test(compact_keeps_order),
        cmocka_unit_test(areas_normals_and_boxes_are_right),
        cmocka_unit_test(sorting_follows_space),
        cmocka_unit_test(lack_of_memory_is_reported),
        cmocka_unit_test(tables_of_large_meshes_are_right),
        cmocka_unit_test(duplicates_are_those_of_all_pairs),
    };
    return cmocka_run_group_tests_name("topology", tests, NULL, NULL);
}
