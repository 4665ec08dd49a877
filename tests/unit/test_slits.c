// Slits, corners and folds of hems.
#include "support/test.h"

#include "geometry/halfedge.h"
#include "geometry/manifold.h"
#include "geometry/notches.h"
#include "proxycloth/evaluate.h"
#include "proxycloth/pipeline.h"
#include "support/manifold.h"
#include "support/proxy_shape.h"
#include "support/surfaces.h"

enum { around = 64, rows = 32, slit_rows = 12 };
static const double radius = 0.3, height = 0.8;

// A skirt around the y axis with its hem at y = 0, slit at x = radius up to `depth`, where the slit
// is a point; at the hem it is `mouth` wide.
static pc_mesh slit_skirt(pc_context *context, double depth, double mouth) {
    pc_mesh tube = test_tube(context, around, rows, radius, height);
    pc_mesh mesh = {.vertex_count = tube.vertex_count + slit_rows,
                    .triangle_count = tube.triangle_count,
                    .triangles = tube.triangles};
    mesh.positions = PCI_ALLOCATE(context, double, 3 * mesh.vertex_count);
    assert_non_null(mesh.positions);
    memcpy(mesh.positions, tube.positions, 3 * tube.vertex_count * sizeof(*tube.positions));
    for (size_t row = 0; row <= rows; ++row) {
        const double below = depth * (double)row / slit_rows;
        const double above =
            depth + (height - depth) * ((double)row - slit_rows) / (rows - slit_rows);
        for (size_t i = 0; i < around; ++i) {
            mesh.positions[3 * (around * row + i) + 1] = row < slit_rows ? below : above;
        }
    }
    for (size_t row = 0; row < slit_rows; ++row) { // one side of the slit, then the other
        double *one = &mesh.positions[3 * around * row];
        double *other = &mesh.positions[3 * (tube.vertex_count + row)];
        memcpy(other, one, 3 * sizeof(*one));
        one[2] -= 0.5 * mouth * (1.0 - one[1] / depth);
        other[2] += 0.5 * mouth * (1.0 - one[1] / depth);
    }
    for (size_t i = 0; i < 3 * mesh.triangle_count; ++i) { // those of the last column
        const uint32_t v = mesh.triangles[i];
        if (i / 6 % around == around - 1 && v % around == 0 && v < around * slit_rows) {
            mesh.triangles[i] = (uint32_t)tube.vertex_count + v / around;
        }
    }
    tube.triangles = NULL;
    pc_mesh_free(context, &tube);
    return mesh;
}

static double edge_length(uint32_t vertices) {
    return sqrt(2.0 / sqrt(3.0) * 2.0 * acos(-1.0) * radius * height / vertices);
}

static pc_mesh proxy_of(pc_context *context, pc_mesh *mesh, uint32_t vertices) {
    const pc_mesh proxy = simplified(context, mesh, vertices, NULL);
    const shape found = check_manifold(context, &proxy);
    assert_int_equal(proxy.vertex_count, vertices);
    assert_int_equal(found.components, 1);
    assert_true(found.angle_mean > 46.0 && found.angle_worst > 20.0);
    return proxy;
}

static uint32_t nearest_vertex(const pc_mesh *mesh, const double point[3], double *distance) {
    uint32_t best = 0;
    for (uint32_t v = 0; v < mesh->vertex_count; ++v) {
        if (pci_squared_distance(&mesh->positions[3 * (size_t)v], point) <
            pci_squared_distance(&mesh->positions[3 * (size_t)best], point)) {
            best = v;
        }
    }
    *distance = sqrt(pci_squared_distance(&mesh->positions[3 * (size_t)best], point));
    return best;
}

// A slit keeps its tip and both corners at the hem, however close together those are.
static void slits_keep_their_corners(void **state) {
    (void)state;
    static const uint32_t counts[] = {64, 128, 512};
    static const double depths[] = {0.7, 1.0, 2.2}, mouths[] = {0.02, 0.2}; // in edges
    pc_context *context = test_context(1);
    for (size_t i = 0; i < 18; ++i) {
        const double edge = edge_length(counts[i % 3]);
        const double depth = depths[i / 3 % 3] * edge, mouth = mouths[i / 9] * edge;
        const double corners[3][3] = {
            {radius, 0.0, -0.5 * mouth}, {radius, 0.0, 0.5 * mouth}, {radius, depth, 0.0}};
        pc_mesh skirt = slit_skirt(context, depth, mouth);
        pc_mesh proxy = proxy_of(context, &skirt, counts[i % 3]);
        uint32_t found[3];
        for (size_t c = 0; c < 3; ++c) {
            double distance = 0.0;
            found[c] = nearest_vertex(&proxy, corners[c], &distance);
            assert_true(distance < 0.02 * edge);
        }
        assert_int_not_equal(found[0], found[1]);
        pc_mesh_free(context, &proxy);
    }
    pc_context_destroy(context);
}

// So does a cloth, at as few vertices as it takes.
static void cloths_keep_their_corners(void **state) {
    (void)state;
    static const uint32_t counts[] = {20, 64, 300};
    pc_context *context = test_context(1);
    for (size_t i = 0; i < 3; ++i) {
        pc_mesh sheet = test_sheet(context, 30, 40, 0.6, 0.8);
        pc_mesh proxy = proxy_of(context, &sheet, counts[i]);
        for (int c = 0; c < 4; ++c) {
            const double corner[3] = {c % 2 * 0.6, c / 2 * 0.8, 0.0};
            double distance = 0.0;
            nearest_vertex(&proxy, corner, &distance);
            assert_true(distance < 1e-3);
        }
        pc_mesh_free(context, &proxy);
    }
    pc_context_destroy(context);
}

// A slit that is less deep than edges can follow is closed: the hem runs straight across.
static void shallow_slits_are_closed(void **state) {
    (void)state;
    static const uint32_t counts[] = {64, 128, 512};
    static const double depths[] = {0.25, 0.35, 0.5}, mouths[] = {0.02, 0.15}; // in edges
    pc_context *context = test_context(1);
    for (size_t i = 0; i < 18; ++i) {
        const double edge = edge_length(counts[i % 3]), depth = depths[i / 3 % 3] * edge;
        pc_mesh skirt = slit_skirt(context, depth, mouths[i / 9] * edge);
        pc_mesh proxy = proxy_of(context, &skirt, counts[i % 3]);
        // Vertices are on the hem or behind the first row of triangles.
        for (size_t v = 0; v < proxy.vertex_count; ++v) {
            const double y = proxy.positions[3 * v + 1] / edge;
            assert_true(fabs(y) < 0.1 || y > 0.52);
        }
        pc_mesh_free(context, &proxy);
    }
    pc_context_destroy(context);
}

// Triangles that filling adds to a skirt with a slit, in edges of one tenth.
static size_t filled(pc_context *context, double depth, double mouth) {
    pci_scratch scratch = pci_scratch_begin(context);
    pc_mesh skirt = slit_skirt(context, 0.1 * depth, 0.1 * mouth);
    const size_t before = skirt.triangle_count;
    assert_true(pci_fill_notches(&scratch, 0.1, &skirt));
    const size_t added = skirt.triangle_count - before;
    const shape found = check_manifold(context, &skirt);
    assert_int_equal(found.components, 1);
    assert_int_equal(found.loops, 2);
    assert_int_equal(found.euler, 0);
    pc_mesh_free(context, &skirt);
    pci_scratch_end(&scratch);
    return added;
}

// Fails if triangles are added; releases the mesh.
static void assert_left_alone(pc_context *context,
                              bool (*fill)(pci_scratch *scratch, double size, pc_mesh *mesh),
                              pc_mesh *mesh) {
    pci_scratch scratch = pci_scratch_begin(context);
    const size_t before = mesh->triangle_count;
    assert_true(fill(&scratch, 0.1, mesh));
    assert_int_equal(mesh->triangle_count, before);
    pc_mesh_free(context, mesh);
    pci_scratch_end(&scratch);
}

static void only_narrow_and_shallow_notches_are_filled(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    assert_int_equal(filled(context, 0.4, 0.1), 2 * slit_rows - 1);
    assert_int_equal(filled(context, 0.5, 1e-9), 2 * slit_rows - 1); // both sides touch
    assert_int_equal(filled(context, 0.6, 0.1), 0);                  // deep
    assert_int_equal(filled(context, 3.0, 0.1), 0);
    assert_int_equal(filled(context, 0.05, 0.01), 0); // nothing to save
    assert_int_equal(filled(context, 0.5, 0.8), 0);   // a neckline
    assert_int_equal(filled(context, 1.5, 1.5), 0);
    // A tongue, and a tube whose opening is as narrow as a mouth.
    pc_mesh tongue = test_sheet(context, 2, 8, 0.04, 0.4),
            sheet = test_sheet(context, 20, 20, 1.0, 1.0),
            tube = test_tube(context, 12, 20, 0.03, 1.0);
    pc_mesh *meshes[] = {&tongue, &sheet, &tube};
    for (size_t i = 0; i < 3; ++i) {
        assert_left_alone(context, pci_fill_notches, meshes[i]);
    }
    pc_context_destroy(context);
}

// What the border of a skirt is shorter by when slits are closed within `reach`.
static double shortened(pc_context *context, double depth, double mouth, double reach) {
    pci_scratch scratch = pci_scratch_begin(context);
    pc_mesh skirt = slit_skirt(context, depth, mouth);
    const double before = boundary_length(context, &skirt);
    assert_true(pci_close_slits(&scratch, reach, &skirt));
    const double after = boundary_length(context, &skirt);
    const shape found = check_manifold(context, &skirt);
    assert_int_equal(found.components, 1);
    assert_int_equal(found.loops, 2);
    assert_int_equal(found.euler, 0);
    pc_mesh_free(context, &skirt);
    pci_scratch_end(&scratch);
    return before - after;
}

// Both sides may touch, or lie over each other, and be closer than the edges are long.
static void slits_are_closed_where_their_sides_are_close(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    static const double mouths[] = {0.02, 1e-9, -0.02};
    for (size_t i = 0; i < 3; ++i) {
        assert_close(shortened(context, 0.4, mouths[i], 0.021), 0.8, 0.03);
    }
    // Half as far, where the sides are half as far from each other.
    const double half = shortened(context, 0.4, 0.1, 0.05);
    assert_true(half > 0.25 && half < 0.45);
    assert_true(shortened(context, 0.1, 0.1, 1.0) == 0.0); // a neckline
    // A tongue, and a tube whose opening is narrow, keep theirs.
    pc_mesh tongue = test_sheet(context, 2, 8, 0.04, 0.4),
            tube = test_tube(context, 12, 20, 0.03, 1.0);
    pc_mesh *meshes[] = {&tongue, &tube};
    for (size_t i = 0; i < 2; ++i) {
        assert_left_alone(context, pci_close_slits, meshes[i]);
    }
    pc_context_destroy(context);
}

// A square with a narrow strip folded up by 100 degrees.
static pc_mesh turned_up_hem(pc_context *context, double width) {
    enum { columns = 40, flat = 30 };
    pc_mesh mesh = test_sheet(context, columns, columns, 1.0, 1.0);
    for (size_t v = 0; v < mesh.vertex_count; ++v) {
        const size_t column = v % (columns + 1);
        double *p = &mesh.positions[3 * v];
        const double folded = width * ((double)column - flat) / (columns - flat);
        p[0] = (1.0 - width) * (double)column / flat;
        if (column > flat) {
            p[0] = 1.0 - width - 0.174 * folded;
            p[2] = 0.985 * folded;
        }
    }
    return mesh;
}

// Edges do not bridge a hem that is turned up and narrower than they are.
static void edges_lie_in_folds(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    double hausdorff = 0.0;
    for (uint32_t seed = 1; seed <= 4; ++seed) {
        pc_mesh cloth = turned_up_hem(context, 0.07), proxy = {0};
        pc_simplify_options options;
        pc_record_set_defaults(&pc_simplify_options_record, &options);
        options.seed = seed;
        pc_measures measures;
        assert_ok(context, pc_simplify(context, NULL, &cloth, &options, &proxy, NULL));
        assert_ok(context, pc_evaluate(context, &cloth, &proxy, &measures));
        assert_true(measures.min_angle_mean > 49.0 && measures.min_angle_worst > 20.0);
        hausdorff += 0.25 * measures.hausdorff;
        pc_mesh_free(context, &proxy);
        pc_mesh_free(context, &cloth);
    }
    assert_true(hausdorff < 0.018);
    pc_context_destroy(context);
}

// Vertices stand on the ridges and the tip of a roof, or edges cut them off.
static void edges_follow_ridges(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    for (uint32_t seed = 1; seed <= 6; ++seed) {
        pc_mesh roof = test_sheet(context, 60, 60, 1.0, 1.0), proxy = {0};
        for (size_t v = 0; v < roof.vertex_count; ++v) {
            double *p = &roof.positions[3 * v];
            p[2] = -3.0 * fmax(fabs(p[0] - 0.43), fabs(p[1] - 0.56));
        }
        pc_simplify_options options;
        pc_record_set_defaults(&pc_simplify_options_record, &options);
        options.seed = seed;
        pc_measures measures;
        assert_ok(context, pc_simplify(context, NULL, &roof, &options, &proxy, NULL));
        assert_ok(context, pc_evaluate(context, &roof, &proxy, &measures));
        assert_true(measures.min_angle_mean > 49.0 && measures.min_angle_worst > 20.0);
        assert_true(measures.hausdorff < 0.017);
        pc_mesh_free(context, &proxy);
        pc_mesh_free(context, &roof);
    }
    pc_context_destroy(context);
}

// A slit that the voxels close at its tip is nearly as deep in the single layer, with its sides on
// the hems.
static void slits_are_cut_open(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    const double cell = height / 32.0, mouth = 1.7 * cell, depth = 0.35;
    pc_mesh skirt = slit_skirt(context, depth, mouth);
    const pc_visual_arrays arrays = {.vertex_count = skirt.vertex_count,
                                     .positions = skirt.positions,
                                     .triangle_count = skirt.triangle_count,
                                     .triangles = skirt.triangles};
    pc_asset asset = {0};
    pc_options options = pc_default_options();
    options.carve.layer_source = PC_LAYER_LABELS;
    assert_ok(context, pc_visual_create(context, &arrays, &asset.visual, NULL));
    for (pc_stage stage = 0; stage <= PC_STAGE_CARVE; ++stage) {
        assert_ok(context, pc_run_stage(context, stage, &options, &asset, NULL));
    }
    const pc_mesh *layer = &asset.single_layer;
    pci_scratch scratch = pci_scratch_begin(context);
    pci_halfedge halves;
    assert_true(pci_halfedge_build(&scratch, layer, &halves));
    double deepest = 0.0, beside = 0.0;
    size_t sides = 0;
    for (uint32_t v = 0; v < layer->vertex_count; ++v) {
        const double *p = &layer->positions[3 * (size_t)v];
        if (halves.outgoing[v] == PC_INVALID_INDEX || !pci_is_border_vertex(&halves, v) ||
            p[0] < 0.0 || fabs(p[2]) > mouth || p[1] > height / 2.0) {
            continue;
        }
        deepest = fmax(deepest, p[1]);
        if (p[1] > cell && p[1] < 0.6 * depth) {
            beside += fabs(fabs(p[2]) - 0.5 * mouth * (1.0 - p[1] / depth));
            ++sides;
        }
    }
    assert_true(deepest > 0.8 * depth && deepest < depth);
    assert_true(sides > 50 && beside < 0.02 * cell * (double)sides);
    pci_scratch_end(&scratch);
    pc_asset_free(context, &asset);
    pc_mesh_free(context, &skirt);
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(slits_keep_their_corners),
        cmocka_unit_test(cloths_keep_their_corners),
        cmocka_unit_test(shallow_slits_are_closed),
        cmocka_unit_test(only_narrow_and_shallow_notches_are_filled),
        cmocka_unit_test(slits_are_closed_where_their_sides_are_close),
        cmocka_unit_test(edges_lie_in_folds),
        cmocka_unit_test(edges_follow_ridges),
        cmocka_unit_test(slits_are_cut_open),
    };
    return cmocka_run_group_tests_name("slits", tests, NULL, NULL);
}
