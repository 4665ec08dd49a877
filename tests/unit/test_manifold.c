// Repair of crowded edges.
#include "geometry/manifold.h"
#include "support/manifold.h"
#include "support/test.h"

enum { MOST = 3000 };

// Triangles around the edge from (0, 0, 0) to (0, 1, 0), at these angles.
static pc_mesh make_fins(const double *angles, size_t count) {
    static double positions[3 * (MOST + 2)];
    static uint32_t triangles[3 * MOST];
    memset(positions, 0, sizeof(positions));
    positions[4] = 1.0;
    for (uint32_t t = 0; t < count; ++t) {
        const double apex[3] = {cos(angles[t]), 0.5, sin(angles[t])};
        const uint32_t corners[3] = {0, 1, t + 2};
        memcpy(&positions[3 * (t + 2)], apex, sizeof(apex));
        memcpy(&triangles[3 * t], corners, sizeof(corners));
    }
    return (pc_mesh){count + 2, positions, count, triangles};
}

// Number of parts of the repaired mesh, which keeps all triangles.
static size_t count_parts(pc_context *context, const pc_mesh *mesh) {
    pci_scratch scratch = pci_scratch_begin(context);
    pci_repair_counts counts;
    pci_topology topology;
    pc_mesh repaired = {0};
    assert_true(pci_mesh_repair(&scratch, mesh, NULL, &repaired, &counts));
    assert_true(pci_topology_build(&scratch, &repaired, &topology));
    assert_manifold(&repaired, &topology);
    assert_int_equal(repaired.triangle_count, mesh->triangle_count);
    uint32_t *component = PCI_SCRATCH(&scratch, uint32_t, repaired.triangle_count);
    assert_non_null(component);
    const size_t parts = pci_triangle_components(&scratch, &repaired, &topology, component);
    // What stays joined is the pair that is flat.
    for (size_t t = 1; parts < mesh->triangle_count && t < mesh->triangle_count; ++t) {
        assert_true((component[t] == component[0]) == (t == 2));
    }
    pc_mesh_free(context, &repaired);
    pci_scratch_end(&scratch);
    return parts;
}

static void the_flattest_pair_stays_joined(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    const double angles[] = {0.0, 1.0, 3.1, 4.3, 5.5};
    const pc_mesh fins = make_fins(angles, 5);
    assert_int_equal(count_parts(context, &fins), 4);
    pc_context_destroy(context);
}

// Layers that hang from one border are not joined to a fold; three walls are still flat enough.
static void layers_come_apart(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    const double layers[] = {0.0, 0.4, 0.8, 1.2, 1.5}, walls[] = {0.0, 2.0, 2.2};
    const pc_mesh hung = make_fins(layers, 5);
    assert_int_equal(count_parts(context, &hung), 5);
    const pc_mesh crossed = make_fins(walls, 3);
    assert_int_equal(count_parts(context, &crossed), 2);
    pc_context_destroy(context);
}

// However many there are, two at most stay joined.
static void crowds_come_apart(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    static double angles[MOST];
    for (size_t i = 0; i < MOST; ++i) {
        angles[i] = 1.0 + 2.0 * pci_random(1, i, 0);
    }
    angles[0] = 0.0, angles[2] = 3.14159;
    const pc_mesh fins = make_fins(angles, MOST);
    assert_int_equal(count_parts(context, &fins), MOST - 1);
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_flattest_pair_stays_joined),
        cmocka_unit_test(layers_come_apart),
        cmocka_unit_test(crowds_come_apart),
    };
    return cmocka_run_group_tests_name("manifold", tests, NULL, NULL);
}
