// What every mesh between the stages must be.
#ifndef TEST_SUPPORT_MANIFOLD_H
#define TEST_SUPPORT_MANIFOLD_H

#include "geometry/topology.h"
#include "support/test.h"

// Whether the triangles of a vertex are one fan: all are reached from the first one across the
// edges at the vertex.
static inline bool is_one_fan(const pc_mesh *mesh, const pci_topology *topology, uint32_t v) {
    enum { most = 256 };
    const uint32_t *fan = &topology->vertex_triangles[topology->vertex_triangle_offsets[v]];
    const size_t count =
        topology->vertex_triangle_offsets[v + 1] - topology->vertex_triangle_offsets[v];
    bool reached[most] = {true};
    size_t found = 1;
    assert_in_range(count, 1, most);
    for (bool grown = true; grown;) {
        grown = false;
        for (size_t i = 0; i < count * count; ++i) {
            const uint32_t *a = &mesh->triangles[3 * (size_t)fan[i / count]];
            const uint32_t *b = &mesh->triangles[3 * (size_t)fan[i % count]];
            size_t common = 0;
            for (size_t k = 0; k < 9; ++k) {
                common += a[k / 3] == b[k % 3];
            }
            if (reached[i / count] && !reached[i % count] && common > 1) {
                reached[i % count] = grown = true;
                ++found;
            }
        }
    }
    return found == count;
}

// Fails unless the mesh is a consistently oriented manifold with boundary that uses each of its
// vertices.
static inline void assert_manifold(const pc_mesh *mesh, const pci_topology *topology) {
    assert_int_equal(pci_nonmanifold_edge_count(topology), 0);
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
    for (uint32_t v = 0; v < mesh->vertex_count; ++v) {
        assert_true(is_one_fan(mesh, topology, v)); // and a used vertex
    }
}

// Length of all edges of one triangle.
static inline double boundary_length(pc_context *context, const pc_mesh *mesh) {
    pci_scratch scratch = pci_scratch_begin(context);
    pci_topology topology;
    assert_true(pci_topology_build_edges(&scratch, mesh, &topology));
    const double length = pci_boundary_length(mesh, &topology);
    pci_scratch_end(&scratch);
    return length;
}

#endif
