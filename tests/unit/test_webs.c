// Garments whose legs stand closer than the voxels can tell.
#include "support/test.h"

#include "geometry/bvh.h"
#include "geometry/topology.h"
#include "stages/carve/webs.h"
#include "support/wardrobe.h"

// An overall without sleeves. Its legs begin side by side, `radius` wide, and end `apart` from each
// other.
static pc_mesh sew_overall(pc_context *context, double radius, double apart) {
    const double x = radius + 0.005, foot = radius + 0.5 * apart;
    const sew_limb limbs[] = {SEW_TORSO(0.0),
                              SEW_NECK(0.0),
                              {{x, 0.9, 0.0}, radius, {foot, 0.1, 0.0}, radius},
                              {{-x, 0.9, 0.0}, radius, {-foot, 0.1, 0.0}, radius}};
    static const sew_cut cuts[] = {
        SEW_ABOVE(1.45),
        SEW_BELOW(0.15),
        {.at = {0.19, 1.28, 0.0}, .size = {0.07, 0.08, 0.3}},
        {.at = {-0.19, 1.28, 0.0}, .size = {0.07, 0.08, 0.3}},
    };
    return sew_dress_up(context, limbs, 4, 0.02, cuts, 4, 1.0);
}

// The labelled layer at the defaults.
static void run_to_layer(pc_context *context, const pc_mesh *mesh, pc_asset *asset) {
    const pc_visual_arrays arrays = {.vertex_count = mesh->vertex_count,
                                     .positions = mesh->positions,
                                     .triangle_count = mesh->triangle_count,
                                     .triangles = mesh->triangles};
    pc_options options = pc_default_options();
    options.carve.layer_source = PC_LAYER_LABELS;
    assert_ok(context, pc_visual_create(context, &arrays, &asset->visual, &asset->reports.visual));
    for (pc_stage stage = 0; stage <= PC_STAGE_CARVE; ++stage) {
        assert_ok(context, pc_run_stage(context, stage, &options, asset, NULL));
    }
    assert_int_equal(asset->reports.carve.components, 1);
    assert_int_equal(asset->reports.carve.boundary_loops, 5);
}

// The share of the layer that is more than half a voxel away from the cloth.
static double bridged_share(pc_context *context, const pc_asset *asset) {
    pc_mesh layer = asset->single_layer;
    pci_scratch scratch = pci_scratch_begin(context);
    pci_bvh *bvh = NULL;
    assert_ok(context, pci_bvh_create(context, "test", &asset->visual.surface, &bvh));
    pci_webbed webbed = {.cloth = bvh, .cell_size = asset->grid.cell_size, .layer = &layer};
    assert_true(pci_find_away(&scratch, &webbed));
    double sum = 0.0;
    for (size_t t = 0; t < layer.triangle_count; ++t) {
        sum += webbed.away[t] == PCI_BRIDGE ? pci_triangle_area(&layer, t) : 0.0;
    }
    pci_bvh_destroy(context, bvh);
    pci_scratch_end(&scratch);
    return sum / pc_mesh_area(&layer);
}

// The share that is left of webs between such legs. `gap` between triangles; 0: they hang together.
static double left_between(pc_context *context, double radius, double apart, double gap) {
    pc_mesh mesh = sew_overall(context, radius, apart);
    pc_asset asset = {0};
    if (gap > 0.0) {
        sew_crack(context, &mesh, gap);
    }
    run_to_layer(context, &mesh, &asset);
    const double share = bridged_share(context, &asset);
    pc_asset_free(context, &asset);
    pc_mesh_free(context, &mesh);
    return share;
}

// Also where the voxels fill the legs, and where seams are cracked.
static void parts_legs_up_to_the_crotch(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    static const double radii[] = {0.06, 0.08, 0.1, 0.12}, apart[] = {0.2, 0.3};
    for (size_t i = 0; i < 8; ++i) {
        assert_true(left_between(context, radii[i / 2], apart[i % 2], 0.0) < 0.0001);
        assert_true(left_between(context, radii[i / 2], apart[i % 2], 2e-4) < 0.002);
    }
    pc_context_destroy(context);
}

// The other side of the projected mesh has the walls.
static void parts_legs_of_loose_triangles(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    static const double radii[] = {0.1, 0.12}, apart[] = {0.2, 0.3};
    for (size_t i = 0; i < 4; ++i) {
        assert_true(left_between(context, radii[i / 2], apart[i % 2], 4e-3) < 0.002);
    }
    pc_context_destroy(context);
}

// The voxels fill these legs: there are no walls to take, and the openings stay.
static void leaves_filled_legs_of_loose_triangles(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    assert_true(left_between(context, 0.08, 0.2, 4e-3) > 0.005);
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(parts_legs_up_to_the_crotch),
        cmocka_unit_test(parts_legs_of_loose_triangles),
        cmocka_unit_test(leaves_filled_legs_of_loose_triangles),
    };
    return cmocka_run_group_tests_name("webs", tests, NULL, NULL);
}
