#include <stdlib.h>

#include "geometry/topology.h"
#include "support/memory.h"
#include "support/obj.h"
#include "support/shapes.h"

#define PI 3.14159265358979323846

static pc_graph_options default_options(void) {
    pc_graph_options options;
    pc_record_set_defaults(&pc_graph_options_record, &options);
    return options;
}

// ---- curvature ----------------------------------------------------------------------------------

static void sphere_has_curvature_one_over_radius(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    static const double radii[] = {0.5, 1.0, 20.0};
    for (size_t i = 0; i < 3; ++i) {
        double error[2];
        for (size_t level = 0; level < 2; ++level) {
            pc_mesh mesh = shape_sphere(context, level == 0 ? 16 : 32, radii[i]);
            pc_graph graph = {0};
            pc_graph_report report;
            const double cell = 0.1 * radii[i];
            assert_ok(context, pc_build_graph(context, &mesh, cell, NULL, &graph, &report));
            error[level] = 0.0;
            for (size_t v = 0; v < mesh.vertex_count; ++v) {
                error[level] = fmax(error[level], fabs(graph.curvatures[v] * radii[i] - 1.0));
            }
            assert_close(report.max_curvature, cell / radii[i], 0.02 * cell / radii[i]);
            pc_graph_free(context, &graph);
            pc_mesh_free(context, &mesh);
        }
        assert_true(error[0] < 0.02);
        assert_true(error[1] < 0.35 * error[0]); // second order in the edge length
    }
    pc_context_destroy(context);
}

static void cylinder_has_half_the_curvature_and_planes_none(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    const double radius = 3.0;
    pc_mesh mesh = shape_box(context, 24, 24, 30);
    for (size_t v = 0; v < mesh.vertex_count; ++v) {
        // Concentric squares of the caps become concentric circles.
        double *p = &mesh.positions[3 * v];
        const double x = p[0] / 12.0 - 1.0, y = p[1] / 12.0 - 1.0, z = p[2] / 3.0;
        const double square = fmax(fabs(x), fabs(y)), angle = PI / 4.0;
        const double turn = fabs(x) > fabs(y) ? (x > 0.0 ? 0.0 : PI) + angle * y / x
                            : y != 0.0        ? (y > 0.0 ? 0.5 : -0.5) * PI - angle * x / y
                                              : 0.0;
        p[0] = radius * square * cos(turn), p[1] = radius * square * sin(turn), p[2] = z;
    }
    pc_graph graph = {0};
    assert_ok(context, pc_build_graph(context, &mesh, 0.3, NULL, &graph, NULL));
    size_t sides = 0, caps = 0;
    for (size_t v = 0; v < mesh.vertex_count; ++v) {
        const double *p = &mesh.positions[3 * v], r = sqrt(p[0] * p[0] + p[1] * p[1]);
        if (p[2] > 0.5 && p[2] < 9.5) {
            assert_close(graph.curvatures[v], 0.5 / radius, 0.02 / radius);
            ++sides;
        } else if (r < 0.8 * radius && (p[2] == 0.0 || p[2] == 10.0)) {
            assert_close(graph.curvatures[v], 0.0, 1e-12);
            ++caps;
        }
    }
    assert_true(sides > 1000 && caps > 300);
    pc_graph_free(context, &graph);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

// A quadric over a symmetric neighbourhood is fitted exactly.
static void quadric_is_reproduced(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh mesh = shape_box(context, 6, 6, 2);
    size_t centre = SIZE_MAX;
    for (size_t v = 0; v < mesh.vertex_count; ++v) {
        double *p = &mesh.positions[3 * v];
        if (p[2] == 2.0) {
            centre = p[0] == 3.0 && p[1] == 3.0 ? v : centre;
            const double x = p[0] - 3.0, y = p[1] - 3.0;
            p[2] = 10.0 + 0.2 * x * x - 0.03 * x * y - 0.05 * y * y;
        }
    }
    pc_graph graph = {0};
    assert_ok(context, pc_build_graph(context, &mesh, 1.0, NULL, &graph, NULL));
    assert_close(graph.curvatures[centre], 0.2 - 0.05, 1e-12);
    pc_graph_free(context, &graph);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

// A tetrahedron has too few neighbours for a fit, a collapsed box no normals: finite all the same.
static void degenerate_fits_stay_finite(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    double corners[12] = {1, 1, 1, 1, -1, -1, -1, 1, -1, -1, -1, 1};
    uint32_t faces[12] = {0, 1, 2, 0, 3, 1, 0, 2, 3, 1, 3, 2};
    const pc_mesh tetrahedron = {
        .vertex_count = 4, .positions = corners, .triangle_count = 4, .triangles = faces};
    pc_graph graph = {0};
    assert_ok(context, pc_build_graph(context, &tetrahedron, 1.0, NULL, &graph, NULL));
    for (size_t v = 0; v < 4; ++v) {
        assert_true(isfinite(graph.curvatures[v]) && graph.curvatures[v] > 0.1);
    }
    pc_graph_free(context, &graph);

    pc_mesh flat = shape_box(context, 4, 4, 2);
    for (size_t collapsed = 0; collapsed < 3; ++collapsed) {
        for (size_t v = 0; v < flat.vertex_count; ++v) {
            flat.positions[3 * v + 2 - collapsed] = 1.0;
        }
        assert_ok(context, pc_build_graph(context, &flat, 1.0, NULL, &graph, NULL));
        for (size_t v = 0; v < flat.vertex_count; ++v) {
            assert_true(isfinite(graph.curvatures[v]));
        }
        for (size_t e = 0; e < graph.edge_count; ++e) {
            assert_true(graph.edge_weights[e] >= 0.0 && graph.edge_weights[e] <= 1.0);
        }
        pc_graph_free(context, &graph);
    }
    pc_mesh_free(context, &flat);
    pc_context_destroy(context);
}

static void edge_weights_follow_equation_3(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_mesh mesh = shape_box(context, 7, 5, 3);
    pc_graph graph = {0};
    pc_graph_report report;
    assert_ok(context, pc_build_graph(context, &mesh, 0.5, NULL, &graph, &report));
    double largest = 0.0;
    for (size_t v = 0; v < mesh.vertex_count; ++v) {
        largest = fmax(largest, graph.curvatures[v]);
    }
    assert_close(report.max_curvature, 0.5 * largest, 1e-15);
    assert_int_equal(graph.edge_count, 3 * mesh.triangle_count / 2);
    assert_int_equal(report.edges, graph.edge_count);
    bool some_small = false, some_full = false;
    for (size_t e = 0; e < graph.edge_count; ++e) {
        const uint32_t i = graph.edges[2 * e], j = graph.edges[2 * e + 1];
        assert_true(i < j);
        assert_close(graph.edge_weights[e],
                     1.0 - pow(fmax(graph.curvatures[i], graph.curvatures[j]) / largest, 4.0),
                     1e-14);
        some_small = some_small || graph.edge_weights[e] < 0.01;
        some_full = some_full || graph.edge_weights[e] == 1.0;
    }
    assert_true(some_small && some_full);
    pc_graph_free(context, &graph);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

// ---- opposite vertices --------------------------------------------------------------------------

// All opposite pairs by definition: every triangle against every ray, Moeller and Trumbore's test.
static double first_hit(const pc_mesh *mesh, size_t vertex, const double origin[3],
                        const double direction[3], bool back_only, size_t *triangle) {
    double best = INFINITY;
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        const uint32_t *c = &mesh->triangles[3 * t];
        if (c[0] == vertex || c[1] == vertex || c[2] == vertex) {
            continue;
        }
        double ab[3], ac[3], ao[3], p[3], q[3], n[3];
        pci_sub(&mesh->positions[3 * (size_t)c[1]], &mesh->positions[3 * (size_t)c[0]], ab);
        pci_sub(&mesh->positions[3 * (size_t)c[2]], &mesh->positions[3 * (size_t)c[0]], ac);
        pci_sub(origin, &mesh->positions[3 * (size_t)c[0]], ao);
        pci_cross(direction, ac, p);
        pci_cross(ao, ab, q);
        pci_cross(ab, ac, n);
        const double det = pci_dot(ab, p), u = pci_dot(ao, p) / det;
        const double v = pci_dot(direction, q) / det, along = pci_dot(ac, q) / det;
        if (det != 0.0 && u >= 0.0 && v >= 0.0 && u + v <= 1.0 && along >= 0.0 && along < best &&
            (!back_only || pci_dot(n, direction) > 0.0)) {
            best = along, *triangle = t;
        }
    }
    return best;
}

static void check_against_definition(const pc_mesh *mesh, double cell,
                                     const pc_graph_options *options, const pc_graph *graph) {
    const size_t nv = mesh->vertex_count;
    double *normals = calloc(3 * nv, sizeof(*normals)), *outer = calloc(nv, sizeof(*outer));
    uint8_t *opposite = calloc(nv * nv, 1);
    assert_true(normals != NULL && outer != NULL && opposite != NULL);
    pci_vertex_normals(mesh, normals);
    for (size_t i = 0; i < nv; ++i) {
        double low[3], high[3], down[3];
        for (size_t k = 0; k < 3; ++k) {
            const double x = mesh->positions[3 * i + k], n = normals[3 * i + k];
            low[k] = x + options->inward_offset * cell * n;
            high[k] = x + options->outward_offset * cell * n;
            down[k] = -n;
        }
        size_t triangle = 0;
        outer[i] = options->outward_offset * cell +
                   first_hit(mesh, i, high, &normals[3 * i], false, &triangle);
        if (isfinite(first_hit(mesh, i, low, down, true, &triangle))) {
            for (size_t c = 0; c < 3; ++c) {
                const size_t j = mesh->triangles[3 * triangle + c];
                if (sqrt(pci_squared_distance(&mesh->positions[3 * i], &mesh->positions[3 * j])) <
                        options->opposite_reach * cell &&
                    pci_dot(&normals[3 * i], &normals[3 * j]) < -1.0 + options->opposite_epsilon) {
                    opposite[i * nv + j] = opposite[j * nv + i] = 1;
                }
            }
        }
    }
    size_t o = 0;
    for (size_t i = 0; i < nv; ++i) {
        assert_true(graph->outer_distances[i] == outer[i] ||
                    fabs(graph->outer_distances[i] - outer[i]) < 1e-9);
        for (size_t j = i + 1; j < nv; ++j) {
            if (opposite[i * nv + j]) {
                assert_true(o < graph->opposite_count);
                assert_int_equal(graph->opposites[2 * o], i);
                assert_int_equal(graph->opposites[2 * o + 1], j);
                const double a = graph->outer_distances[i], b = graph->outer_distances[j];
                assert_int_equal(graph->opposite_signs[o], (a > b) - (a < b));
                ++o;
            }
        }
    }
    assert_int_equal(graph->opposite_count, o);
    free(normals);
    free(outer);
    free(opposite);
}

// Bumpy, bent sheets of small thickness, so that rays hit and miss in every way.
static pc_mesh bumpy_sheet(pc_context *context, uint64_t seed) {
    pc_mesh mesh = shape_box(context, 14, 11, 1);
    for (size_t v = 0; v < mesh.vertex_count; ++v) {
        double *p = &mesh.positions[3 * v];
        const double angle = 0.45 * p[0], radius = 2.0 + 1.5 * p[2];
        p[0] = radius * cos(angle) + 0.3 * (pci_random(seed, 0, v) - 0.5);
        p[2] = radius * sin(angle) + 0.3 * (pci_random(seed, 1, v) - 0.5);
        p[1] += 0.3 * (pci_random(seed, 2, v) - 0.5);
    }
    pc_mesh turned = {0}; // the bend mirrors the box
    shape_append(context, &turned, &mesh, true);
    pc_mesh_free(context, &mesh);
    return turned;
}

static void opposites_match_their_definition(void **state) {
    (void)state;
    pc_context *context = test_context(3);
    size_t total = 0, biased = 0;
    for (uint64_t seed = 0; seed < 6; ++seed) {
        pc_mesh mesh = bumpy_sheet(context, seed);
        pc_graph_options options = default_options();
        options.tube_aspect = 0.0;
        options.opposite_epsilon = seed % 2 == 0 ? 0.4 : 0.1;
        options.opposite_reach = seed % 3 == 0 ? 2.0 : 1.2;
        pc_graph graph = {0};
        pc_graph_report report;
        assert_ok(context, pc_build_graph(context, &mesh, 1.1, &options, &graph, &report));
        check_against_definition(&mesh, 1.1, &options, &graph);
        assert_int_equal(report.opposite_edges, graph.opposite_count);
        size_t signs = 0;
        for (size_t o = 0; o < graph.opposite_count; ++o) {
            signs += graph.opposite_signs[o] != 0;
        }
        assert_int_equal(report.biased_edges, signs);
        total += graph.opposite_count, biased += signs;
        pc_graph_free(context, &graph);
        pc_mesh_free(context, &mesh);
    }
    assert_true(total > 500 && biased > 100); // the cases are worth something
    pc_context_destroy(context);
}

// A closed rod is a sleeve that the voxels filled, a slab a thick sheet, a thin strap or cord a
// sheet again.
static void rods_have_no_opposites(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    static const struct {
        double width, thickness, aspect;
        bool sheet;
    } cases[] = {{1.4, 1.4, 2.0, false}, {1.4, 1.1, 2.0, false}, {4.0, 1.1, 2.0, true},
                 {1.4, 1.4, 0.0, true},  {0.9, 0.9, 2.0, true},  {2.5, 1.1, 3.0, false}};
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); ++i) {
        pc_mesh mesh = shape_box(context, 6, 40, 6);
        for (size_t v = 0; v < mesh.vertex_count; ++v) {
            mesh.positions[3 * v] *= cases[i].width / 6.0;
            mesh.positions[3 * v + 1] *= 0.5;
            mesh.positions[3 * v + 2] *= cases[i].thickness / 6.0;
        }
        pc_graph_options options = default_options();
        options.tube_aspect = cases[i].aspect;
        pc_graph graph = {0};
        pc_graph_report report;
        assert_ok(context, pc_build_graph(context, &mesh, 1.0, &options, &graph, &report));
        if (cases[i].sheet) {
            assert_true(report.opposite_fraction > 0.3);
        } else {
            assert_int_equal(graph.opposite_count, 0);
        }
        pc_graph_free(context, &graph);
        pc_mesh_free(context, &mesh);
    }
    pc_context_destroy(context);
}

// Both sides of a flat slab see each other, whether they lie apart, together or swapped places.
static void slab_pairs_each_vertex_with_its_mate(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    static const double gaps[] = {1.5, 0.3, 0.0, -0.2};
    for (size_t g = 0; g < 4; ++g) {
        pc_mesh mesh = shape_box(context, 10, 8, 2);
        for (size_t v = 0; v < mesh.vertex_count; ++v) {
            mesh.positions[3 * v + 2] *= 0.5 * gaps[g];
        }
        pc_graph graph = {0};
        assert_ok(context, pc_build_graph(context, &mesh, 1.0, NULL, &graph, NULL));
        const size_t layer = (size_t)11 * 9;
        for (size_t y = 2; y < 7; ++y) {
            for (size_t x = 2; x < 9; ++x) {
                const size_t below = x + 11 * y, above = mesh.vertex_count - layer + below;
                bool found = false;
                for (size_t o = 0; o < graph.opposite_count; ++o) {
                    found = found || (graph.opposites[2 * o] == below &&
                                      graph.opposites[2 * o + 1] == above);
                }
                assert_true(found);
                assert_true(isinf(graph.outer_distances[below]));
                assert_true(isinf(graph.outer_distances[above]));
            }
        }
        for (size_t o = 0; o < graph.opposite_count; ++o) {
            assert_true(fabs(mesh.positions[3 * (size_t)graph.opposites[2 * o] + 2] -
                             mesh.positions[3 * (size_t)graph.opposites[2 * o + 1] + 2]) ==
                        fabs(gaps[g]));
        }
        pc_graph_free(context, &graph);
        pc_mesh_free(context, &mesh);
    }
    pc_context_destroy(context);
}

// Two parallel slabs three voxels apart: nothing is opposite across the air between them, and the
// sides that face each other know the distance.
static void air_between_sheets_is_not_a_sheet(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_mesh mesh = shape_box(context, 8, 8, 1);
    const size_t half = mesh.vertex_count;
    pc_mesh other = shape_box(context, 8, 8, 1);
    for (size_t v = 0; v < half; ++v) {
        mesh.positions[3 * v + 2] *= 0.5;
        other.positions[3 * v + 2] = 0.5 * other.positions[3 * v + 2] + 1.4;
    }
    shape_append(context, &mesh, &other, false);
    pc_graph graph = {0};
    assert_ok(context, pc_build_graph(context, &mesh, 1.0, NULL, &graph, NULL));
    size_t inner = 0;
    for (size_t o = 0; o < graph.opposite_count; ++o) {
        const uint32_t i = graph.opposites[2 * o], j = graph.opposites[2 * o + 1];
        assert_int_equal(i < half, j < half);
        const double *p = &mesh.positions[3 * (size_t)i], *q = &mesh.positions[3 * (size_t)j];
        const double edge = fmin(fmin(p[0], p[1]), fmin(q[0], q[1]));
        if (edge >= 1.0 && fmax(fmax(p[0], p[1]), fmax(q[0], q[1])) <= 7.0) {
            // The far side is free and the near one is not.
            assert_int_equal(graph.opposite_signs[o], (p[2] < q[2]) == (i < half) ? 1 : -1);
            ++inner;
        }
    }
    assert_true(inner > 100);
    const size_t top = half - 81 + 40; // centre of the lower slab's upper side
    assert_close(graph.outer_distances[top], 0.9, 1e-12);
    pc_graph_free(context, &graph);
    pc_mesh_free(context, &mesh);
    pc_mesh_free(context, &other);
    pc_context_destroy(context);
}

// A hollow ball: outside is outer, and the inside sees itself across the hollow.
static void shell_prefers_its_outside(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_mesh mesh = shape_sphere(context, 16, 5.0), inner = shape_sphere(context, 16, 4.4);
    const size_t half = mesh.vertex_count;
    shape_append(context, &mesh, &inner, true);
    pc_graph graph = {0};
    pc_graph_report report;
    assert_ok(context, pc_build_graph(context, &mesh, 0.5, NULL, &graph, &report));
    for (size_t v = 0; v < half; ++v) {
        assert_true(isinf(graph.outer_distances[v]));
        assert_close(graph.outer_distances[half + v], 8.8, 0.05);
    }
    assert_int_equal(report.biased_edges, graph.opposite_count);
    assert_true(report.opposite_fraction == 1.0);
    for (size_t o = 0; o < graph.opposite_count; ++o) {
        assert_true(graph.opposites[2 * o] < half && graph.opposites[2 * o + 1] >= half);
        assert_int_equal(graph.opposite_signs[o], 1);
    }
    pc_graph_free(context, &graph);
    pc_mesh_free(context, &mesh);
    pc_mesh_free(context, &inner);
    pc_context_destroy(context);
}

// A ball has no sheet: its sides are too far apart.
static void solid_has_no_opposites(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh mesh = shape_sphere(context, 10, 5.0);
    pc_graph graph = {0};
    assert_ok(context, pc_build_graph(context, &mesh, 0.5, NULL, &graph, NULL));
    assert_int_equal(graph.opposite_count, 0);
    pc_graph_free(context, &graph);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
}

// Graphs of real garments against those of an independent implementation (N_v = 32, epsilon_o .4,
// VectorAdam): number of vertices, opposite edges, share of them with a bias. Marching cubes
// differ in their ambiguous cases, so the counts agree within a few percent only.
static void garments_agree_with_the_reference_implementation(void **state) {
    (void)state;
    static const struct {
        const char *file;
        double vertices, opposites, biased;
    } cases[] = {
        {SAMPLE_DIR "/makehuman_skirthelper.obj", 3576, 6505, 0.948},
        {SAMPLE_DIR "/makehuman_fedora.obj", 3690, 6574, 0.329},
        {SAMPLE_DIR "/makehuman_female_elegantsuit01.obj", 3656, 6053, 0.970},
        {SAMPLE_DIR "/dedo_backpack_1.obj", 5122, 9272, 0.961},
        {SAMPLE_DIR "/dedo_apron_2_dense.obj", 1734, 2926, 0.246},
    };
    pc_context *context = test_context(2);
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); ++i) {
        pc_mesh raw = {0};
        assert_true(test_read_obj(context, cases[i].file, &raw));
        const pc_visual_arrays arrays = {.vertex_count = raw.vertex_count,
                                         .positions = raw.positions,
                                         .triangle_count = raw.triangle_count,
                                         .triangles = raw.triangles};
        pc_asset asset = {0};
        assert_ok(context, pc_visual_create(context, &arrays, &asset.visual, NULL));
        pc_options options = pc_default_options();
        options.voxelize.voxels = 32;
        options.project.projection_solver = PC_PROJECT_VECTOR_ADAM;
        options.graph.opposite_epsilon = 0.4;
        for (pc_stage stage = PC_STAGE_VOXELIZE; stage <= PC_STAGE_GRAPH; ++stage) {
            assert_ok(context, pc_run_stage(context, stage, &options, &asset, NULL));
        }
        const double opposites = (double)asset.graph.opposite_count;
        assert_close((double)asset.graph.vertex_count, cases[i].vertices, 0.05 * cases[i].vertices);
        assert_close(opposites, cases[i].opposites, 0.08 * cases[i].opposites);
        assert_close((double)asset.reports.graph.biased_edges / opposites, cases[i].biased, 0.03);
        pc_asset_free(context, &asset);
        pc_mesh_free(context, &raw);
    }
    pc_context_destroy(context);
}

// ---- contract -----------------------------------------------------------------------------------

static void same_bytes_at_any_thread_count(void **state) {
    (void)state;
    static const uint32_t threads[] = {2, 3, 8, 1};
    pc_context *reference_context = test_context(1);
    pc_mesh mesh = bumpy_sheet(reference_context, 11);
    pc_graph first = {0};
    assert_ok(reference_context, pc_build_graph(reference_context, &mesh, 1.0, NULL, &first, NULL));
    for (size_t t = 0; t < 4; ++t) {
        pc_context *context = test_context(threads[t]);
        pc_graph graph = {0};
        assert_ok(context, pc_build_graph(context, &mesh, 1.0, NULL, &graph, NULL));
        assert_int_equal(graph.opposite_count, first.opposite_count);
        assert_memory_equal(graph.curvatures, first.curvatures, 8 * mesh.vertex_count);
        assert_memory_equal(graph.outer_distances, first.outer_distances, 8 * mesh.vertex_count);
        assert_memory_equal(graph.edge_weights, first.edge_weights, 8 * first.edge_count);
        assert_memory_equal(graph.opposites, first.opposites, 8 * first.opposite_count);
        assert_memory_equal(graph.opposite_signs, first.opposite_signs, first.opposite_count);
        pc_graph_free(context, &graph);
        pc_context_destroy(context);
    }
    pc_graph_free(reference_context, &first);
    pc_mesh_free(reference_context, &mesh);
    pc_context_destroy(reference_context);
}

static void bad_arguments_leave_the_output_empty(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh box = shape_box(context, 2, 2, 2);
    const pc_mesh none = {0};
    pc_graph graph = {0}, used = {.vertex_count = 3};
    static const double cell_sizes[] = {0.0, -1.0, NAN, INFINITY};
    for (size_t i = 0; i < 4; ++i) {
        assert_int_equal(pc_build_graph(context, &box, cell_sizes[i], NULL, &graph, NULL),
                         PC_ERROR_INVALID_ARGUMENT);
    }
    assert_int_equal(pc_build_graph(context, &none, 1.0, NULL, &graph, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_build_graph(context, NULL, 1.0, NULL, &graph, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_build_graph(context, &box, 1.0, NULL, NULL, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_build_graph(context, &box, 1.0, NULL, &used, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    pc_graph_options options = default_options();
    options.opposite_epsilon = 1.5;
    assert_int_equal(pc_build_graph(context, &box, 1.0, &options, &graph, NULL),
                     PC_ERROR_INVALID_OPTIONS);
    assert_non_null(strstr(pc_context_error(context)->message, "opposite_epsilon"));
    box.positions[4] = NAN;
    assert_int_equal(pc_build_graph(context, &box, 1.0, NULL, &graph, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_null(graph.edges);
    assert_int_equal(graph.vertex_count, 0);
    pc_mesh_free(context, &box);
    pc_context_destroy(context);
}

static void survives_memory_failure(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    pc_mesh box = shape_box(context, 3, 3, 1);
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        pc_graph graph = {0};
        s.status = pc_build_graph(context, &box, 1.0, NULL, &graph, NULL);
        assert_true(s.status == PC_OK || (graph.edges == NULL && graph.vertex_count == 0));
        pc_graph_free(context, &graph);
    }
    assert_true(s.failures > 5);
    pc_mesh_free(context, &box);
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(sphere_has_curvature_one_over_radius),
        cmocka_unit_test(cylinder_has_half_the_curvature_and_planes_none),
        cmocka_unit_test(quadric_is_reproduced),
        cmocka_unit_test(degenerate_fits_stay_finite),
        cmocka_unit_test(edge_weights_follow_equation_3),
        cmocka_unit_test(opposites_match_their_definition),
        cmocka_unit_test(rods_have_no_opposites),
        cmocka_unit_test(slab_pairs_each_vertex_with_its_mate),
        cmocka_unit_test(air_between_sheets_is_not_a_sheet),
        cmocka_unit_test(shell_prefers_its_outside),
        cmocka_unit_test(solid_has_no_opposites),
        cmocka_unit_test(garments_agree_with_the_reference_implementation),
        cmocka_unit_test(same_bytes_at_any_thread_count),
        cmocka_unit_test(bad_arguments_leave_the_output_empty),
        cmocka_unit_test(survives_memory_failure),
    };
    return cmocka_run_group_tests_name("graph", tests, NULL, NULL);
}
