// Closed meshes and comparisons for the tests of geometric stages.
#ifndef TEST_SUPPORT_SHAPES_H
#define TEST_SUPPORT_SHAPES_H

#include <stdlib.h>

#include "support/test.h"

// The surface of a box of nx by ny by nz unit cells at the origin, outward normals.
static inline pc_mesh shape_box(pc_context *context, size_t nx, size_t ny, size_t nz) {
    const size_t size[3] = {nx, ny, nz};
    const size_t points = (nx + 1) * (ny + 1) * (nz + 1);
    uint32_t *index = malloc(points * sizeof(*index));
    pc_mesh mesh = {.triangle_count = 4 * (nx * ny + ny * nz + nz * nx)};
    mesh.vertex_count = mesh.triangle_count / 2 + 2;
    mesh.positions = PCI_ALLOCATE(context, double, 3 * mesh.vertex_count);
    mesh.triangles = PCI_ALLOCATE(context, uint32_t, 3 * mesh.triangle_count);
    assert_true(index != NULL && mesh.positions != NULL && mesh.triangles != NULL);
    uint32_t vertex = 0;
    for (size_t i = 0; i < points; ++i) {
        const size_t x = i % (nx + 1), y = i / (nx + 1) % (ny + 1), z = i / ((nx + 1) * (ny + 1));
        if (x == 0 || x == nx || y == 0 || y == ny || z == 0 || z == nz) {
            mesh.positions[3 * vertex] = (double)x;
            mesh.positions[3 * vertex + 1] = (double)y;
            mesh.positions[3 * vertex + 2] = (double)z;
            index[i] = vertex++;
        }
    }
    const size_t stride[3] = {1, nx + 1, (nx + 1) * (ny + 1)};
    uint32_t *corner = mesh.triangles;
    for (size_t side = 0; side < 6; ++side) {
        // Axes a and b span the side, c is normal to it; (a, b, c) is right-handed.
        const size_t c = side / 2, a = (c + 1) % 3, b = (c + 2) % 3;
        const bool far_side = side % 2 == 1;
        for (size_t i = 0; i < size[a] * size[b]; ++i) {
            const size_t low = i % size[a] * stride[a] + i / size[a] * stride[b] +
                               (far_side ? size[c] * stride[c] : 0);
            const uint32_t q[4] = {index[low], index[low + stride[a]],
                                   index[low + stride[a] + stride[b]], index[low + stride[b]]};
            const uint32_t outward[6] = {q[0], q[1], q[2], q[0], q[2], q[3]};
            for (size_t k = 0; k < 6; ++k) {
                *corner++ = outward[far_side ? k : 5 - k];
            }
        }
    }
    free(index);
    return mesh;
}

// A sphere around the origin, from a box of n^3 cells.
static inline pc_mesh shape_sphere(pc_context *context, size_t n, double radius) {
    pc_mesh mesh = shape_box(context, n, n, n);
    for (size_t v = 0; v < mesh.vertex_count; ++v) {
        double *p = &mesh.positions[3 * v];
        for (size_t k = 0; k < 3; ++k) {
            p[k] = tan((2.0 * p[k] / (double)n - 1.0) * 0.78539816339744831);
        }
        const double length = pci_norm(p);
        p[0] *= radius / length, p[1] *= radius / length, p[2] *= radius / length;
    }
    return mesh;
}

// Adds a copy of `part`, turned inside out when asked for.
static inline void shape_append(pc_context *context, pc_mesh *mesh, const pc_mesh *part,
                                bool inside_out) {
    pc_mesh joined = {.vertex_count = mesh->vertex_count + part->vertex_count,
                      .triangle_count = mesh->triangle_count + part->triangle_count};
    joined.positions = PCI_ALLOCATE(context, double, 3 * joined.vertex_count);
    joined.triangles = PCI_ALLOCATE(context, uint32_t, 3 * joined.triangle_count);
    assert_true(joined.positions != NULL && joined.triangles != NULL);
    const size_t nv = mesh->vertex_count, nf = mesh->triangle_count;
    if (nv > 0) {
        memcpy(joined.positions, mesh->positions, 3 * nv * sizeof(double));
        memcpy(joined.triangles, mesh->triangles, 3 * nf * sizeof(uint32_t));
    }
    memcpy(joined.positions + 3 * nv, part->positions, 3 * part->vertex_count * sizeof(double));
    for (size_t i = 0; i < 3 * part->triangle_count; ++i) {
        const size_t from = inside_out ? i - i % 3 + 2 - i % 3 : i;
        joined.triangles[3 * nf + i] = (uint32_t)nv + part->triangles[from];
    }
    pc_mesh_free(context, mesh);
    *mesh = joined;
}

#endif
