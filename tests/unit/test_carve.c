#include "support/test.h"

#include "geometry/topology.h"
#include "stages/carve/dents.h"
#include "support/manifold.h"
#include "support/memory.h"
#include "support/shapes.h"
#include "support/surfaces.h"

// Consistently oriented manifold without unused vertices; the postconditions of the stage.
static void check_layer(pc_context *context, const pc_mesh *mesh, const pc_carve_report *report) {
    pci_scratch scratch = pci_scratch_begin(context);
    pci_topology topology;
    assert_true(pci_topology_build(&scratch, mesh, &topology));
    assert_manifold(mesh, &topology);
    assert_int_equal(report->vertices, mesh->vertex_count);
    assert_int_equal(report->triangles, mesh->triangle_count);
    pci_scratch_end(&scratch);
}

static pc_labels make_labels(pc_context *context, size_t count, uint8_t value) {
    pc_labels labels = {count, PCI_ALLOCATE(context, uint8_t, count)};
    memset(labels.labels, value, count);
    return labels;
}

static pc_carve_options labels_only(void) {
    pc_carve_options options;
    pc_record_set_defaults(&pc_carve_options_record, &options);
    options.layer_source = PC_LAYER_LABELS;
    return options;
}

// What the stage makes, checked.
static pc_mesh carved(pc_context *context, const pc_mesh *visual, const pc_mesh *projected,
                      const pc_labels *labels, double cell_size, const pc_carve_options *options,
                      pc_carve_report *report) {
    pc_mesh layer = {0};
    assert_ok(context,
              pc_carve(context, visual, projected, labels, cell_size, options, &layer, report));
    check_layer(context, &layer, report);
    return layer;
}

static double mesh_area(const pc_mesh *mesh) {
    double area = 0.0;
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        area += pci_triangle_area(mesh, t);
    }
    return area;
}

// The upper half of a sphere: one disc.
static void keeps_triangles_with_two_labels(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh ball = test_sphere(context, 12), layer = {0};
    pc_labels labels = make_labels(context, ball.vertex_count, 0);
    for (size_t v = 0; v < ball.vertex_count; ++v) {
        labels.labels[v] = ball.positions[3 * v + 2] > 0.0;
    }
    size_t expected = 0;
    for (size_t t = 0; t < ball.triangle_count; ++t) {
        size_t ones = 0;
        for (size_t c = 0; c < 3; ++c) {
            ones += labels.labels[ball.triangles[3 * t + c]];
        }
        expected += ones >= 2;
    }
    pc_carve_report report = {0};
    layer = carved(context, &ball, &ball, &labels, 0.2, NULL, &report);
    assert_int_equal(layer.triangle_count, expected);
    assert_int_equal(report.components, 1);
    assert_int_equal(report.boundary_loops, 1);
    assert_close(report.coverage, 0.5, 0.2);
    pc_mesh_free(context, &layer);

    // All ones: the closed mesh itself.
    memset(labels.labels, 1, ball.vertex_count);
    layer = carved(context, &ball, &ball, &labels, 0.2, NULL, &report);
    assert_int_equal(layer.triangle_count, ball.triangle_count);
    assert_int_equal(report.boundary_loops, 0);
    assert_close(report.coverage, 1.0, 0.0);
    pc_mesh_free(context, &layer);
    pc_labels_free(context, &labels);
    pc_mesh_free(context, &ball);
    pc_context_destroy(context);
}

// A rectangle that the labels leave out is a dent unless nearly all of its border is a rim, or it
// is a large part of all.
static void keeps_dents(void **state) {
    (void)state;
    enum { columns = 40, rows = 40, from = 16, to = 22 };
    const struct {
        size_t rims, length; // with 11 rims, four fifths of the border are near one
        bool dent;
    } cases[] = {{0, 12, true}, {11, 12, true}, {18, 12, false}, {0, 40, false}};
    pc_context *context = test_context(1);
    pci_scratch scratch = pci_scratch_begin(context);
    const pc_mesh sheet = test_sheet(context, columns, rows, columns, rows);
    uint8_t keep[2 * columns * rows];
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); ++i) {
        double rims[3 * 4 * columns] = {0.0};
        size_t count = 0, left_out = 0;
        for (size_t t = 0; t < sheet.triangle_count; ++t) {
            const size_t column = t / 2 % columns, row = t / 2 / columns;
            keep[t] = row < from || row >= to || column >= cases[i].length;
        }
        for (size_t x = 0; x < cases[i].rims; ++x) {
            const double along = fmin((double)x, (double)cases[i].length);
            const double across = (double)x - along; // both long sides, and the end between them
            rims[3 * count] = along, rims[3 * count++ + 1] = from + across;
            rims[3 * count] = along, rims[3 * count++ + 1] = to - across;
        }
        pci_knn points;
        assert_true(pci_knn_build(&scratch, count, rims, &points));
        pci_bvh *tree = NULL;
        assert_ok(context, pci_keep_dents(&scratch, "test", &sheet, &points, 1.0, &tree, keep));
        pci_bvh_destroy(context, tree);
        for (size_t t = 0; t < sheet.triangle_count; ++t) {
            left_out += !keep[t];
        }
        assert_int_equal(left_out, cases[i].dent ? 0 : 2 * cases[i].length * (to - from));
    }
    pc_mesh left = sheet;
    pc_mesh_free(context, &left);
    pci_scratch_end(&scratch);
    pc_context_destroy(context);
}

// The lower side of a rod is no dent of it, beside a body that is large enough for one; a strip of
// the same size beneath a slab is.
static void leaves_other_sides_of_straps(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pci_scratch scratch = pci_scratch_begin(context);
    for (int wide = 0; wide < 2; ++wide) {
        pc_mesh mesh = shape_box(context, 30, wide ? 20 : 2, 1);
        pc_mesh body = shape_box(context, 30, 30, 30);
        const size_t strap = mesh.triangle_count;
        for (size_t v = 0; v < body.vertex_count; ++v) {
            body.positions[3 * v] += 100.0;
        }
        shape_append(context, &mesh, &body, false);
        pc_mesh_free(context, &body);
        uint8_t *keep = PCI_SCRATCH(&scratch, uint8_t, mesh.triangle_count);
        size_t left_out = 0;
        for (size_t t = 0; t < mesh.triangle_count; ++t) {
            double middle[3];
            pci_triangle_middle(&mesh, t, middle);
            const double aside = fabs(middle[1] - (wide ? 10.0 : 1.0));
            keep[t] = t >= strap || middle[2] > 0.0 || aside > 1.0;
            left_out += !keep[t];
        }
        assert_int_equal(left_out, 120);
        pci_knn points;
        pci_bvh *tree = NULL;
        assert_true(pci_knn_build(&scratch, 0, NULL, &points));
        assert_ok(context, pci_keep_dents(&scratch, "test", &mesh, &points, 1.0, &tree, keep));
        for (size_t t = 0; t < mesh.triangle_count; ++t) {
            left_out -= !keep[t];
        }
        assert_int_equal(left_out, wide ? 120 : 0);
        pci_bvh_destroy(context, tree);
        pc_mesh_free(context, &mesh);
    }
    pci_scratch_end(&scratch);
    pc_context_destroy(context);
}

// Seven wrong labels make a dent, which is kept, unless the visual mesh has that hole: then it is
// one of twelve edges, which is filled; the rim of a part never is.
static void fills_short_holes_only(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh tube = test_tube(context, 16, 30, 1.0, 10.0), layer = {0};
    pc_labels labels = make_labels(context, tube.vertex_count, 1);
    const size_t fan[] = {16 * 15 + 3, 16 * 15 + 2, 16 * 15 + 4, 16 * 16 + 3,
                          16 * 14 + 3, 16 * 16 + 4, 16 * 14 + 2};
    for (size_t i = 0; i < 7; ++i) {
        labels.labels[fan[i]] = 0;
    }
    pc_mesh pierced = test_tube(context, 16, 30, 1.0, 10.0);
    pierced.triangle_count = 0;
    for (size_t t = 0; t < tube.triangle_count; ++t) {
        const uint32_t *corner = &tube.triangles[3 * t];
        if (labels.labels[corner[0]] + labels.labels[corner[1]] + labels.labels[corner[2]] >= 2) {
            memcpy(&pierced.triangles[3 * pierced.triangle_count++], corner, 3 * sizeof(*corner));
        }
    }
    const struct {
        const pc_mesh *visual;
        uint32_t fill_loops;
        size_t loops, filled;
    } cases[] = {{&tube, 0, 2, 0}, {&pierced, 0, 3, 0}, {&pierced, 12, 2, 1}};
    for (size_t i = 0; i < 3; ++i) {
        pc_carve_options options = labels_only();
        pc_carve_report report = {0};
        options.carve_distance = 10.0; // no membrane is cut out
        options.fill_loops = cases[i].fill_loops;
        layer = carved(context, cases[i].visual, &tube, &labels, 0.5, &options, &report);
        assert_int_equal(report.boundary_loops, cases[i].loops);
        assert_int_equal(report.filled_loops, cases[i].filled);
        pc_mesh_free(context, &layer);
    }
    pc_labels_free(context, &labels);
    pc_mesh_free(context, &pierced);
    pc_mesh_free(context, &tube);

    pc_carve_report report = {0};
    pc_mesh sheet = test_sheet(context, 2, 2, 1.0, 1.0); // a rim of eight edges
    labels = make_labels(context, sheet.vertex_count, 1);
    layer = carved(context, &sheet, &sheet, &labels, 0.5, NULL, &report);
    assert_int_equal(report.boundary_loops, 1);
    assert_int_equal(layer.triangle_count, sheet.triangle_count);
    pc_mesh_free(context, &layer);
    pc_labels_free(context, &labels);
    pc_mesh_free(context, &sheet);
    pc_context_destroy(context);
}

// A crumb beside the sheet is dropped, and so is one far from it that lies on the same cloth, or is
// little of another one; a loose part of the garment is not.
static void drops_small_parts(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh big = test_sheet(context, 10, 10, 1.0, 1.0),
            long_sheet = test_sheet(context, 40, 10, 4.0, 1.0),
            small = test_sheet(context, 4, 4, 0.2, 0.2);
    const pc_mesh none = {0};
    const double near[3] = {1.05, 0.0, 0.0}, far[3] = {3.0, 0.0, 0.0};
    const struct {
        const double *offset;
        double smallest_part;
        const pc_mesh *second; // component of the visual mesh; NULL: one long sheet
        size_t kept;
    } cases[] = {{near, 0.05, &small, 1},
                 {near, 0.03, &small, 2},
                 {far, 0.05, &small, 2},
                 {far, 0.05, NULL, 1},
                 {far, 0.05, &big, 1}};
    for (size_t i = 0; i < 5; ++i) {
        pc_mesh both = test_union(context, &big, &small, cases[i].offset), layer = {0};
        const pc_mesh *second = cases[i].second;
        pc_mesh visual = test_union(context, second != NULL ? &big : &long_sheet,
                                    second != NULL ? second : &none, cases[i].offset);
        pc_labels labels = make_labels(context, both.vertex_count, 1);
        pc_carve_options options = labels_only();
        pc_carve_report report = {0};
        options.smallest_part = cases[i].smallest_part;
        layer = carved(context, &visual, &both, &labels, 0.2, &options, &report);
        assert_int_equal(report.components, cases[i].kept);
        assert_int_equal(report.dropped_parts, 2 - cases[i].kept);
        pc_mesh_free(context, &visual);
        pc_mesh_free(context, &layer);
        pc_labels_free(context, &labels);
        pc_mesh_free(context, &both);
    }
    pc_mesh_free(context, &big);
    pc_mesh_free(context, &long_sheet);
    pc_mesh_free(context, &small);
    pc_context_destroy(context);
}

// A tube whose upper half is labelled inside and whose lower half both inside and outside: one side
// stays.
static void keeps_one_side_of_a_sheet(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh skin = test_grid(context, 48, 32, true, true), layer = {0};
    pc_mesh tube = test_tube(context, 48, 16, 0.5, 1.0);
    pc_labels labels = make_labels(context, skin.vertex_count, 1);
    for (size_t v = 0; v < skin.vertex_count; ++v) {
        double *p = &skin.positions[3 * v];
        const double turn = 6.283185307179586 * p[0], around = 6.283185307179586 * p[1];
        const double radius = 0.5 + 0.01 * cos(around);
        labels.labels[v] = cos(around) < 0.0 || sin(around) < 0.0;
        p[0] = radius * cos(turn), p[1] = 0.5 + 0.5 * sin(around), p[2] = radius * sin(turn);
    }
    const pc_carve_options options = labels_only();
    pc_carve_report report = {0};
    layer = carved(context, &tube, &skin, &labels, 0.05, &options, &report);
    assert_int_equal(report.components, 1);
    assert_int_equal(report.boundary_loops, 2);
    assert_close(mesh_area(&layer), 3.14159, 0.2);
    pc_mesh_free(context, &layer);
    pc_labels_free(context, &labels);
    pc_mesh_free(context, &tube);
    pc_mesh_free(context, &skin);
    pc_context_destroy(context);
}

static void survives_random_labels(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    for (uint64_t seed = 0; seed < 60; ++seed) {
        pc_mesh ball =
            seed % 2 == 0 ? test_sphere(context, 8) : test_torus(context, 30, 16, 1.0, 0.4);
        pc_mesh layer = {0};
        pc_labels labels = make_labels(context, ball.vertex_count, 0);
        const double share = pci_random(seed, 1, 0);
        for (size_t v = 0; v < ball.vertex_count; ++v) {
            labels.labels[v] = pci_random(seed, 2, v) < share;
        }
        pc_carve_options options = labels_only();
        options.smallest_part = pci_random(seed, 3, 0) < 0.5 ? 0.0 : 0.05;
        options.fill_loops = seed % 3 == 0 ? 1000 : 12;
        options.carve = seed % 5 == 0;
        pc_carve_report report = {0};
        const pc_status status =
            pc_carve(context, &ball, &ball, &labels, 0.3, &options, &layer, &report);
        if (status == PC_OK) {
            check_layer(context, &layer, &report);
            // And the next stage takes whatever comes.
            pc_mesh proxy = {0};
            pc_simplify_options small;
            pc_record_set_defaults(&pc_simplify_options_record, &small);
            small.vertices = 40;
            assert_ok(context, pc_simplify(context, NULL, &layer, &small, &proxy, NULL));
            pc_mesh_free(context, &proxy);
        } else {
            assert_int_equal(status, PC_ERROR_NO_PROXY);
        }
        pc_mesh_free(context, &layer);
        pc_labels_free(context, &labels);
        pc_mesh_free(context, &ball);
    }
    pc_context_destroy(context);
}

// Two sheets with a gap of 0.5 (two voxels of 0.25) that the single layer bridges. Carving opens it
// again, 0.1 beside the sheets.
static void carves_the_gap_between_sheets(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh left = test_sheet(context, 3, 3, 1.0, 1.0), layer = {0};
    const double offset[3] = {1.5, 0.0, 0.0};
    pc_mesh visual = test_union(context, &left, &left, offset);
    pc_mesh bridged = test_sheet(context, 10, 4, 2.5, 1.0);
    for (size_t v = 0; v < bridged.vertex_count; ++v) {
        bridged.positions[3 * v + 2] = 0.02; // a little above: no distance along the surface
    }
    pc_labels labels = make_labels(context, bridged.vertex_count, 1);
    pc_carve_options options = labels_only();
    options.snap_border = false; // its hems are not where carving ends
    pc_carve_report report = {0};
    assert_ok(context,
              pc_carve(context, &visual, &bridged, &labels, 0.25, &options, &layer, &report));
    assert_int_equal(report.components, 1);
    assert_int_equal(report.carved_triangles, 0);
    assert_close(mesh_area(&layer), 2.5, 1e-12);
    pc_mesh_free(context, &layer);

    options.carve = true;
    options.carve_distance = 0.4;
    layer = carved(context, &visual, &bridged, &labels, 0.25, &options, &report);
    assert_int_equal(report.components, 2);
    assert_int_equal(report.boundary_loops, 2);
    assert_true(report.carved_triangles > 0);
    assert_close(mesh_area(&layer), 2.2, 0.01);
    for (size_t v = 0; v < layer.vertex_count; ++v) {
        const double x = layer.positions[3 * v];
        assert_true(x < 1.1 + 0.005 || x > 1.4 - 0.005);
    }
    pc_mesh_free(context, &layer);
    pc_labels_free(context, &labels);
    pc_mesh_free(context, &bridged);
    pc_mesh_free(context, &visual);
    pc_mesh_free(context, &left);
    pc_context_destroy(context);
}

// A narrow sleeve as the iso-surface sees it: a closed rod around an open tube.
static void opens_narrow_tubes(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    static const double radii[] = {0.4, 0.7, 1.2};
    for (size_t i = 0; i < 3; ++i) {
        pc_mesh visual = test_tube(context, 24, 60, radii[i], 12.0), layer = {0};
        pc_mesh rod = shape_box(context, 4, 30, 4);
        for (size_t v = 0; v < rod.vertex_count; ++v) { // from a square to a disc
            double *p = &rod.positions[3 * v];
            const double x = 0.5 * p[0] - 1.0, z = 0.5 * p[2] - 1.0;
            const double square = fmax(fabs(x), fabs(z)), length = sqrt(x * x + z * z);
            const double scale = length > 0.0 ? radii[i] * square / length : 0.0;
            p[0] = scale * x, p[1] *= 12.0 / 30.0, p[2] = scale * z;
        }
        pc_labels labels = make_labels(context, rod.vertex_count, 1);
        pc_carve_report report = {0};
        pc_carve_options options = labels_only();
        layer = carved(context, &visual, &rod, &labels, 1.0, &options, &report);
        assert_int_equal(report.carved_regions, 2);
        assert_int_equal(report.components, 1);
        assert_int_equal(report.boundary_loops, 2);
        for (size_t v = 0; v < layer.vertex_count; ++v) { // what is left hugs the tube
            const double *p = &layer.positions[3 * v];
            assert_true(sqrt(p[0] * p[0] + p[2] * p[2]) > 0.85 * (radii[i] - 0.25));
        }
        pc_mesh_free(context, &layer);
        pc_labels_free(context, &labels);
        pc_mesh_free(context, &rod);
        pc_mesh_free(context, &visual);
    }
    pc_context_destroy(context);
}

// An open tube stands on a sheet, and the layer goes over it: as a pouch or a rivet on a belt. To
// cut its mouth open would leave a hole in the belt. Without the sheet it is a sleeve.
static void keeps_cups_closed(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    for (int cup = 0; cup < 2; ++cup) {
        pc_mesh tube = test_tube(context, 24, 12, 0.9, 2.5), base = {0}, layer = {0};
        pc_mesh sheet = test_sheet(context, 12, 12, 6.0, 6.0);
        pc_mesh rod = shape_box(context, 16, 12, 16);
        pc_labels labels = make_labels(context, rod.vertex_count, 1);
        for (size_t v = 0; v < sheet.vertex_count; ++v) { // flat on the ground
            double *p = &sheet.positions[3 * v];
            p[2] = p[1] - 3.0, p[0] -= 3.0, p[1] = 0.0;
        }
        for (size_t v = 0; v < rod.vertex_count; ++v) { // from a square to a disc
            double *p = &rod.positions[3 * v];
            const double x = 0.125 * p[0] - 1.0, z = 0.125 * p[2] - 1.0;
            const double square = fmax(fabs(x), fabs(z)), length = sqrt(x * x + z * z);
            const double scale = length > 0.0 ? 0.9 * square / length : 0.0;
            p[0] = scale * x, p[1] *= 2.5 / 12.0, p[2] = scale * z;
        }
        size_t kept = 0;
        for (size_t t = 0; t < rod.triangle_count; ++t) { // no bottom
            const uint32_t *c = &rod.triangles[3 * t];
            if (rod.positions[3 * (size_t)c[0] + 1] + rod.positions[3 * (size_t)c[1] + 1] +
                    rod.positions[3 * (size_t)c[2] + 1] >
                0.0) {
                memmove(&rod.triangles[3 * kept++], c, 3 * sizeof(*c));
            }
        }
        rod.triangle_count = kept;
        pc_mesh visual = test_union(context, &tube, cup == 1 ? &sheet : &base, (double[3]){0.0});
        pc_carve_report report = {0};
        pc_carve_options options = labels_only();
        layer = carved(context, &visual, &rod, &labels, 1.0, &options, &report);
        assert_int_equal(report.components, 1);
        assert_int_equal(report.carved_regions, 1 - cup);
        assert_int_equal(report.boundary_loops, 2 - cup);
        pc_mesh_free(context, &layer);
        pc_mesh_free(context, &visual);
        pc_labels_free(context, &labels);
        pc_mesh_free(context, &rod);
        pc_mesh_free(context, &sheet);
        pc_mesh_free(context, &tube);
    }
    pc_context_destroy(context);
}

// A closed skin around two parallel tubes bridges the gap between them: no rim, no membrane.
static void keeps_webs(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_mesh leg = test_tube(context, 24, 60, 1.0, 12.0), layer = {0};
    const double beside[3] = {3.0, 0.0, 0.0};
    pc_mesh visual = test_union(context, &leg, &leg, beside);
    pc_mesh skin = test_tube(context, 48, 30, 1.0, 6.0); // between the rims of the legs
    for (size_t v = 0; v < skin.vertex_count; ++v) {
        double *p = &skin.positions[3 * v];
        p[0] += p[0] > 1e-9 ? 3.0 : (p[0] < -1e-9 ? 0.0 : 1.5);
        p[1] += 3.0;
    }
    pc_labels labels = make_labels(context, skin.vertex_count, 1);
    pc_carve_report report = {0};
    pc_carve_options options = labels_only();
    layer = carved(context, &visual, &skin, &labels, 1.0, &options, &report);
    assert_int_equal(report.carved_regions, 0);
    assert_int_equal(layer.triangle_count, skin.triangle_count);
    pc_mesh_free(context, &layer);

    options.carve = true;
    layer = carved(context, &visual, &skin, &labels, 1.0, &options, &report);
    assert_int_equal(report.carved_regions, 2);
    assert_int_equal(report.components, 2);
    pc_mesh_free(context, &layer);
    pc_labels_free(context, &labels);
    pc_mesh_free(context, &skin);
    pc_mesh_free(context, &visual);
    pc_mesh_free(context, &leg);
    pc_context_destroy(context);
}

// Webs join the outline of a leaf to the cloth below it: its rim is all around them, but the leaf
// is amid them, so that they close no opening.
static void keeps_webs_around_leaves(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    const double height = 2.2, at[3] = {8.0, 8.0, height};
    pc_mesh cloth = test_sheet(context, 20, 20, 20.0, 20.0), layer = {0};
    pc_mesh leaf = test_sheet(context, 4, 4, 4.0, 4.0);
    pc_mesh visual = test_union(context, &cloth, &leaf, at);
    pc_mesh skin = test_sheet(context, 40, 40, 20.0, 20.0);
    for (size_t v = 0; v < skin.vertex_count; ++v) {
        double *p = &skin.positions[3 * v];
        const double beside = fmax(fabs(p[0] - 10.0), fabs(p[1] - 10.0)) - 2.0;
        p[2] = height * fmax(0.0, fmin(1.0, 1.0 - beside));
    }
    pc_labels labels = make_labels(context, skin.vertex_count, 1);
    pc_carve_report report = {0};
    pc_carve_options options = labels_only();
    layer = carved(context, &visual, &skin, &labels, 1.0, &options, &report);
    assert_int_equal(report.carved_regions, 0);
    assert_int_equal(layer.triangle_count, skin.triangle_count);
    pc_mesh_free(context, &layer);
    pc_labels_free(context, &labels);
    pc_mesh_free(context, &skin);
    pc_mesh_free(context, &visual);
    pc_mesh_free(context, &leaf);
    pc_mesh_free(context, &cloth);
    pc_context_destroy(context);
}

// Triangles squeezed into a line along the outline: refining them must come to an end.
static void refines_triangles_without_area(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh visual = test_sheet(context, 3, 3, 1.0, 1.0), layer = {0};
    pc_mesh squeezed = test_sheet(context, 9, 7, 2.5, 1.0);
    for (size_t v = 0; v < squeezed.vertex_count; ++v) {
        squeezed.positions[3 * v + 1] *= squeezed.positions[3 * v] > 0.8 ? 0.0 : 1.0;
    }
    pc_labels labels = make_labels(context, squeezed.vertex_count, 1);
    pc_carve_options options = labels_only();
    options.carve = true;
    options.carve_distance = pc_record_find(&pc_carve_options_record, "carve_distance")->minimum;
    pc_carve_report report = {0};
    layer = carved(context, &visual, &squeezed, &labels, 0.25, &options, &report);
    assert_true(report.carved_triangles > 0);
    assert_true(layer.triangle_count < 100000);
    pc_mesh_free(context, &layer);
    pc_labels_free(context, &labels);
    pc_mesh_free(context, &squeezed);
    pc_mesh_free(context, &visual);
    pc_context_destroy(context);
}

// A sheet, a tube and two sheets far apart are clean; a lining and a pillow are not.
static void takes_clean_sheets_as_they_are(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    const double cell = 0.1;
    const double lining[3] = {0.0, 0.0, 0.05}, beside[3] = {1.0, 0.0, 0.05},
                 far[3] = {0.0, 0.0, 0.5};
    pc_mesh sheet = test_sheet(context, 20, 20, 2.0, 2.0),
            tube = test_tube(context, 24, 12, 1.0, 2.0);
    pc_mesh lined = test_union(context, &sheet, &sheet, lining);
    pc_mesh overlapping = test_union(context, &sheet, &sheet, beside);
    pc_mesh apart = test_union(context, &sheet, &sheet, far);
    pc_mesh pillow = test_sphere(context, 8);
    const struct {
        const pc_mesh *visual, *sheet; // NULL: the labels decide
    } cases[] = {{&sheet, &sheet},     {&tube, &tube},   {&lined, &sheet},
                 {&overlapping, NULL}, {&apart, &apart}, {&pillow, NULL}};
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); ++i) {
        const pc_mesh *visual = cases[i].visual;
        pc_labels labels = make_labels(context, visual->vertex_count, 1);
        pc_mesh layer = {0};
        pc_carve_report report = {0};
        layer = carved(context, visual, visual, &labels, cell, NULL, &report);
        const pc_mesh *expected = cases[i].sheet;
        assert_int_equal(report.source, expected != NULL ? PC_LAYER_VISUAL : PC_LAYER_LABELS);
        if (expected != NULL) {
            assert_int_equal(layer.triangle_count, expected->triangle_count);
            assert_close(mesh_area(&layer), mesh_area(expected), 1e-12);
            assert_memory_equal(layer.triangles, expected->triangles,
                                3 * expected->triangle_count * sizeof(uint32_t));
        }
        pc_mesh_free(context, &layer);
        pc_labels_free(context, &labels);
    }
    // The labelled side is the outside, whatever the visual mesh says.
    pc_mesh inside_out = test_tube(context, 24, 12, 1.0, 2.0), turned = {0};
    for (size_t f = 0; f < inside_out.triangle_count; ++f) {
        const uint32_t second = inside_out.triangles[3 * f + 1];
        inside_out.triangles[3 * f + 1] = inside_out.triangles[3 * f + 2];
        inside_out.triangles[3 * f + 2] = second;
    }
    pc_labels ones = make_labels(context, tube.vertex_count, 1);
    assert_ok(context, pc_carve(context, &inside_out, &tube, &ones, cell, NULL, &turned, NULL));
    assert_memory_equal(turned.triangles, tube.triangles,
                        3 * tube.triangle_count * sizeof(uint32_t));
    pc_mesh_free(context, &turned);
    pc_mesh_free(context, &inside_out);
    pc_labels_free(context, &ones);

    // A missing triangle is a hole of less than three voxels, and is filled.
    pc_mesh pierced = sheet, layer = {0};
    pierced.triangle_count -= 1;
    for (size_t c = 0; c < 3; ++c) { // the last triangle takes the place of an inner one
        pierced.triangles[3 * 410 + c] = sheet.triangles[3 * pierced.triangle_count + c];
    }
    pc_labels labels = make_labels(context, pierced.vertex_count, 1);
    pc_carve_report report = {0};
    pc_carve_options options = labels_only();
    options.layer_source = PC_LAYER_VISUAL;
    assert_ok(context,
              pc_carve(context, &pierced, &pierced, &labels, 0.2, &options, &layer, &report));
    assert_int_equal(report.filled_loops, 1);
    assert_int_equal(report.boundary_loops, 1);
    pc_mesh_free(context, &layer);
    pc_labels_free(context, &labels);
    pc_mesh_free(context, &pillow);
    pc_mesh_free(context, &apart);
    pc_mesh_free(context, &overlapping);
    pc_mesh_free(context, &lined);
    pc_mesh_free(context, &tube);
    pc_mesh_free(context, &sheet);
    pc_context_destroy(context);
}

// Cloth with a long hem that is turned in is taken without it, also where the labels bridge a gap,
// have a hole or are torn.
static void takes_cloth_without_hems(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_mesh visual = test_hemmed_tube(context, 0.03);
    for (int i = 0; i < 4; ++i) {
        const bool bridged = i == 1 || i == 2, holed = i == 2, torn = i == 3;
        pc_mesh skin = test_tube(context, 48, 20, 0.5, 1.0), layer = {0};
        pc_labels labels = make_labels(context, skin.vertex_count, 1);
        for (size_t v = 0; v < skin.vertex_count; ++v) {
            double *p = &skin.positions[3 * v];
            const bool amid = p[1] > 0.2 && p[1] < 0.8;
            labels.labels[v] = !(holed && p[1] > 0.1 && p[1] < 0.9 && p[0] < 0.0) &&
                               !(torn && p[1] > 0.3 && p[1] < 0.7);
            const double share = bridged && amid && p[0] > 0.3 ? 1.3 : 1.0;
            p[0] *= share, p[2] *= share;
        }
        pc_carve_report report = {0};
        layer = carved(context, &visual, &skin, &labels, 0.1, NULL, &report);
        assert_int_equal(report.source, PC_LAYER_VISUAL);
        assert_int_equal(report.components, 1);
        assert_int_equal(report.boundary_loops, 2);
        double widest = 0.0;
        for (size_t v = 0; v < layer.vertex_count; ++v) {
            widest = fmax(widest, hypot(layer.positions[3 * v], layer.positions[3 * v + 2]));
        }
        assert_true(widest < 0.51);
        pc_mesh_free(context, &layer);
        pc_labels_free(context, &labels);
        pc_mesh_free(context, &skin);
    }
    pc_mesh_free(context, &visual);
    pc_context_destroy(context);
}

// A tube whose end is flat shows backs only, as a lining does, but has no ply that could be cut
// off: where the labels tear it, it is taken as it is.
static void takes_folded_sheets_for_torn_labels(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_mesh visual = test_tube(context, 48, 20, 0.5, 1.0);
    for (size_t v = 0; v < visual.vertex_count; ++v) {
        visual.positions[3 * v + 2] *=
            fmin(0.05 + fmax(0.0, 2.0 * visual.positions[3 * v + 1] - 0.15), 1.0);
    }
    for (int torn = 0; torn < 2; ++torn) {
        pc_labels labels = make_labels(context, visual.vertex_count, 1);
        for (size_t v = 0; v < visual.vertex_count && torn; ++v) {
            const double y = visual.positions[3 * v + 1];
            labels.labels[v] = !(y > 0.3 && y < 0.7);
        }
        pc_mesh layer = {0};
        pc_carve_report report = {0};
        layer = carved(context, &visual, &visual, &labels, 0.1, NULL, &report);
        assert_int_equal(report.source, torn ? PC_LAYER_VISUAL : PC_LAYER_LABELS);
        assert_int_equal(report.components, 1);
        assert_int_equal(report.boundary_loops, 2);
        assert_int_equal(layer.triangle_count, visual.triangle_count);
        pc_mesh_free(context, &layer);
        pc_labels_free(context, &labels);
    }
    pc_mesh_free(context, &visual);
    pc_context_destroy(context);
}

static void survives_lack_of_memory(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    pc_mesh ball = test_sphere(context, 4);
    pc_labels labels = make_labels(context, ball.vertex_count, 1);
    for (size_t v = 0; v < ball.vertex_count; ++v) {
        labels.labels[v] = ball.positions[3 * v] > -0.5;
    }
    pc_carve_options options = labels_only();
    options.carve = true;
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        pc_mesh layer = {0};
        s.status = pc_carve(context, &ball, &ball, &labels, 0.5, &options, &layer, NULL);
        assert_int_equal(layer.positions != NULL, s.status == PC_OK);
        pc_mesh_free(context, &layer);
    }
    assert_true(s.failures > 40);
    pc_labels_free(context, &labels);
    pc_mesh_free(context, &ball);
    pc_context_destroy(context);
    assert_int_equal(counter.live, 0);
}

static void is_deterministic(void **state) {
    (void)state;
    static const uint32_t threads[] = {1, 2, 3, 8};
    pc_mesh first = {0};
    pc_context *owner = test_context(1);
    for (size_t i = 0; i < 4; ++i) {
        pc_context *context = i == 0 ? owner : test_context(threads[i]);
        pc_mesh ball = test_torus(context, 30, 20, 1.0, 0.4), layer = {0};
        pc_labels labels = make_labels(context, ball.vertex_count, 0);
        for (size_t v = 0; v < ball.vertex_count; ++v) {
            labels.labels[v] = ball.positions[3 * v] > -0.5;
        }
        pc_mesh visual = test_sheet(context, 9, 9, 1.0, 1.0);
        pc_carve_options options = labels_only();
        options.carve = true;
        options.carve_distance = 2.0;
        assert_ok(context, pc_carve(context, &visual, &ball, &labels, 0.2, &options, &layer, NULL));
        if (i == 0) {
            first = layer;
        } else {
            assert_int_equal(layer.triangle_count, first.triangle_count);
            assert_int_equal(layer.vertex_count, first.vertex_count);
            assert_memory_equal(layer.positions, first.positions,
                                3 * first.vertex_count * sizeof(double));
            assert_memory_equal(layer.triangles, first.triangles,
                                3 * first.triangle_count * sizeof(uint32_t));
            pc_mesh_free(context, &layer);
        }
        pc_mesh_free(context, &visual);
        pc_labels_free(context, &labels);
        pc_mesh_free(context, &ball);
        if (i > 0) {
            pc_context_destroy(context);
        }
    }
    pc_mesh_free(owner, &first);
    pc_context_destroy(owner);
}

static void can_be_cancelled(void **state) {
    (void)state;
    pc_context *context = test_cancelling_context();
    pc_mesh sheet = test_sheet(context, 4, 4, 1.0, 1.0), result = {0};
    pc_labels labels = make_labels(context, sheet.vertex_count, 1);
    assert_int_equal(pc_carve(context, &sheet, &sheet, &labels, 1.0, NULL, &result, NULL),
                     PC_ERROR_CANCELLED);
    assert_null(result.positions);
    pc_labels_free(context, &labels);
    pc_mesh_free(context, &sheet);
    pc_context_destroy(context);
}

static void rejects_bad_arguments(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh sheet = test_sheet(context, 2, 2, 1.0, 1.0), layer = {0};
    pc_labels labels = make_labels(context, sheet.vertex_count, 0);
    assert_int_equal(pc_carve(context, NULL, &sheet, &labels, 1.0, NULL, &layer, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_carve(context, &sheet, &sheet, &labels, 0.0, NULL, &layer, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_carve(context, &sheet, &sheet, &labels, 1.0, NULL, &sheet, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    pc_carve_options options = labels_only();
    options.smallest_part = 2.0;
    assert_int_equal(pc_carve(context, &sheet, &sheet, &labels, 1.0, &options, &layer, NULL),
                     PC_ERROR_INVALID_OPTIONS);
    options = labels_only();
    assert_int_equal(pc_carve(context, &sheet, &sheet, &labels, 1.0, &options, &layer, NULL),
                     PC_ERROR_NO_PROXY); // all labels are 0
    sheet.triangles[0] = 9;
    assert_int_equal(pc_carve(context, &sheet, &sheet, &labels, 1.0, NULL, &layer, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    sheet.triangles[0] = 0;
    --labels.vertex_count;
    assert_int_equal(pc_carve(context, &sheet, &sheet, &labels, 1.0, NULL, &layer, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_null(layer.positions);
    pc_labels_free(context, &labels);
    pc_mesh_free(context, &sheet);
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(keeps_triangles_with_two_labels),
        cmocka_unit_test(keeps_dents),
        cmocka_unit_test(leaves_other_sides_of_straps),
        cmocka_unit_test(fills_short_holes_only),
        cmocka_unit_test(drops_small_parts),
        cmocka_unit_test(keeps_one_side_of_a_sheet),
        cmocka_unit_test(survives_random_labels),
        cmocka_unit_test(carves_the_gap_between_sheets),
        cmocka_unit_test(opens_narrow_tubes),
        cmocka_unit_test(keeps_cups_closed),
        cmocka_unit_test(keeps_webs),
        cmocka_unit_test(keeps_webs_around_leaves),
        cmocka_unit_test(refines_triangles_without_area),
        cmocka_unit_test(takes_clean_sheets_as_they_are),
        cmocka_unit_test(takes_cloth_without_hems),
        cmocka_unit_test(takes_folded_sheets_for_torn_labels),
        cmocka_unit_test(survives_lack_of_memory),
        cmocka_unit_test(is_deterministic),
        cmocka_unit_test(can_be_cancelled),
        cmocka_unit_test(rejects_bad_arguments),
    };
    return cmocka_run_group_tests_name("carve", tests, NULL, NULL);
}
