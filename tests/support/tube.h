// A tube around the z axis from z = 0 to z = length, open at both ends, and what twisting it does.
#ifndef TEST_SUPPORT_TUBE_H
#define TEST_SUPPORT_TUBE_H

#include "support/test.h"

// `around` vertices in each of rows + 1 circles.
static inline pc_mesh make_tube(pc_context *context, size_t around, size_t rows, double radius,
                                double length) {
    pc_mesh mesh = {.vertex_count = around * (rows + 1), .triangle_count = 2 * around * rows};
    mesh.positions = PCI_ALLOCATE(context, double, 3 * mesh.vertex_count);
    mesh.triangles = PCI_ALLOCATE(context, uint32_t, 3 * mesh.triangle_count);
    assert_true(mesh.positions != NULL && mesh.triangles != NULL);
    const double full = 2.0 * acos(-1.0);
    for (size_t v = 0; v < mesh.vertex_count; ++v) {
        const size_t row = v / around;
        const double angle = full * (double)(v % around) / (double)around;
        mesh.positions[3 * v] = radius * cos(angle);
        mesh.positions[3 * v + 1] = radius * sin(angle);
        mesh.positions[3 * v + 2] = length * (double)row / (double)rows;
    }
    for (size_t t = 0; t < mesh.triangle_count; ++t) {
        const size_t row = t / 2 / around, i = t / 2 % around, next = (i + 1) % around;
        const size_t a = row * around + i, b = row * around + next;
        const size_t c = a + around, d = b + around; // above
        // Diagonals in turn, so that no sense of rotation is preferred.
        const size_t halves[2][2][3] = {{{a, b, d}, {a, d, c}}, {{a, b, c}, {b, d, c}}};
        for (size_t k = 0; k < 3; ++k) {
            mesh.triangles[3 * t + k] = (uint32_t)halves[(row + i) % 2][t % 2][k];
        }
    }
    return mesh;
}

// Turns each point about the z axis by `angle` times its share of the length.
static inline void twist(size_t count, const double *points, double length, double angle,
                         double *out) {
    for (size_t v = 0; v < count; ++v) {
        const double x = points[3 * v], y = points[3 * v + 1], z = points[3 * v + 2];
        const double c = cos(angle * z / length), s = sin(angle * z / length);
        out[3 * v] = c * x - s * y;
        out[3 * v + 1] = s * x + c * y;
        out[3 * v + 2] = z;
    }
}

#endif
