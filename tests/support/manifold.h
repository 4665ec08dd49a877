// What every mesh between the stages must be.
#ifndef TEST_SUPPORT_MANIFOLD_H
#define TEST_SUPPORT_MANIFOLD_H

#include "geometry/topology.h"
#include "support/test.h"

// Fails unless the mesh is a consistently oriented manifold with boundary that uses each of its
// vertices.
static inline void assert_manifold(pci_scratch *scratch, const pc_mesh *mesh,
                                   const pci_topology *topology) {
    assert_int_equal(pci_nonmanifold_edge_count(topology), 0);
    assert_int_equal(pci_nonmanifold_vertex_count(scratch, mesh, topology), 0);
    for (size_t e = 0; e < topology->edge_count; ++e) {
        const size_t begin = topology->edge_triangle_offsets[e];
        const size_t end = topology->edge_triangle_offsets[e + 1];
        const uint32_t from = topology->edges[2 * e], to = topology->edges[2 * e + 1];
        int balance = 0; // +1 per triangle that runs the edge upwards, -1 downwards
        for (size_t i = begin; i < end; ++i) {
            const uint32_t *corner = &mesh->triangles[3 * (size_t)topology->edge_triangles[i]];
            for (size_t c = 0; c < 3; ++c) {
                balance += corner[c] == from && corner[(c + 1) % 3] == to;
                balance -= corner[c] == to && corner[(c + 1) % 3] == from;
            }
        }
        assert_int_equal(balance == 0, end - begin == 2);
    }
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        assert_true(topology->vertex_triangle_offsets[v] <
                    topology->vertex_triangle_offsets[v + 1]);
    }
}

#endif
