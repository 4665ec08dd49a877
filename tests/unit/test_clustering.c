#include "support/test.h"

#include "core/union_find.h"
#include "geometry/topology.h"
#include "stages/simplify/clustering.h"
#include "support/surfaces.h"

enum { COLUMNS = 120, ROWS = 40, CLUSTERS = 60, PASSES = 100 };

// A sheet in pleats whose walls are near each other: clusters that look at distances in space are
// torn from wall to wall.
static pc_mesh make_pleats(pc_context *context, double pleats) {
    pc_mesh mesh = test_sheet(context, COLUMNS, ROWS, 1.0, 1.0);
    for (size_t v = 0; v < mesh.vertex_count; ++v) {
        double *p = &mesh.positions[3 * v];
        const double turn = 6.283185307179586 * pleats * p[0];
        p[2] += 0.1 * sin(turn);
        p[0] *= 0.2;
    }
    return mesh;
}

static size_t count_pieces(pci_scratch *scratch, const pc_mesh *mesh, const uint32_t *clusters) {
    pci_topology topology;
    uint32_t *parents = PCI_SCRATCH(scratch, uint32_t, mesh->vertex_count);
    assert_true(pci_topology_build(scratch, mesh, &topology));
    size_t pieces = mesh->vertex_count;
    pci_singletons(parents, mesh->vertex_count);
    for (size_t e = 0; e < topology.edge_count; ++e) {
        const uint32_t a = topology.edges[2 * e], b = topology.edges[2 * e + 1];
        pieces -= clusters[a] == clusters[b] && pci_unite(parents, a, b);
    }
    return pieces;
}

static void torn_clusters_come_to_rest(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    for (int pleats = 4; pleats <= 8; ++pleats) {
        pc_mesh mesh = make_pleats(context, pleats);
        pci_scratch scratch = pci_scratch_begin(context);
        pci_sampling samples = {.weights = PCI_SCRATCH(&scratch, double, mesh.vertex_count)};
        assert_true(pci_halfedge_build(&scratch, &mesh, &samples.mesh) &&
                    pci_fans_build(&scratch, &samples.mesh, &samples.fans));
        const pci_clustering wanted = {.cluster =
                                           PCI_SCRATCH(&scratch, uint32_t, mesh.vertex_count)};
        for (size_t v = 0; v < mesh.vertex_count; ++v) {
            samples.weights[v] = 1.0;
        }
        samples.scales = samples.weights;
        uint64_t iterations = 0;
        assert_true(
            pci_cluster_vertices(context, &samples, CLUSTERS, 0, PASSES, &wanted, &iterations));
        assert_int_equal(count_pieces(&scratch, &mesh, wanted.cluster), CLUSTERS);
        assert_true(iterations < PASSES);
        pci_scratch_end(&scratch);
        pc_mesh_free(context, &mesh);
    }
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(torn_clusters_come_to_rest)};
    return cmocka_run_group_tests_name("clustering", tests, NULL, NULL);
}
