// Analytic meshes for tests; pc_mesh_free releases them.
#ifndef TEST_SUPPORT_SURFACES_H
#define TEST_SUPPORT_SURFACES_H

#include "core/core.h"
#include "proxycloth/mesh.h"

// A grid of columns x rows quads, each halved; `wrap_u` and `wrap_v` join opposite sides.
static inline pc_mesh test_grid(pc_context *context, uint32_t columns, uint32_t rows, bool wrap_u,
                                bool wrap_v) {
    const uint32_t nu = wrap_u ? columns : columns + 1, nv = wrap_v ? rows : rows + 1;
    pc_mesh mesh = {.vertex_count = (size_t)nu * nv, .triangle_count = 2 * (size_t)columns * rows};
    mesh.positions = PCI_ALLOCATE(context, double, 3 * mesh.vertex_count);
    mesh.triangles = PCI_ALLOCATE(context, uint32_t, 3 * mesh.triangle_count);
    uint32_t *write = mesh.triangles;
    for (uint32_t j = 0; j < rows; ++j) {
        for (uint32_t i = 0; i < columns; ++i) {
            const uint32_t a = j * nu + i, b = j * nu + (i + 1) % nu;
            const uint32_t c = (j + 1) % nv * nu + (i + 1) % nu, d = (j + 1) % nv * nu + i;
            *write++ = a, *write++ = b, *write++ = c;
            *write++ = a, *write++ = c, *write++ = d;
        }
    }
    for (uint32_t j = 0; j < nv; ++j) {
        for (uint32_t i = 0; i < nu; ++i) {
            double *p = &mesh.positions[3 * ((size_t)j * nu + i)];
            p[0] = (double)i / columns, p[1] = (double)j / rows, p[2] = 0.0;
        }
    }
    return mesh;
}

// A rectangle in the plane z = 0.
static inline pc_mesh test_sheet(pc_context *context, uint32_t columns, uint32_t rows, double width,
                                 double height) {
    pc_mesh mesh = test_grid(context, columns, rows, false, false);
    for (size_t v = 0; v < mesh.vertex_count; ++v) {
        mesh.positions[3 * v] *= width;
        mesh.positions[3 * v + 1] *= height;
    }
    return mesh;
}

// An open tube around the y axis.
static inline pc_mesh test_tube(pc_context *context, uint32_t around, uint32_t along, double radius,
                                double height) {
    pc_mesh mesh = test_grid(context, around, along, true, false);
    for (size_t v = 0; v < mesh.vertex_count; ++v) {
        double *p = &mesh.positions[3 * v];
        const double angle = 6.283185307179586 * p[0];
        p[0] = radius * cos(angle), p[1] = height * p[1], p[2] = -radius * sin(angle);
    }
    return mesh;
}

// A tube of radius 0.5 and height 1 whose lower hem is turned in, 0.5 high and `gap` inside.
static inline pc_mesh test_hemmed_tube(pc_context *context, double gap) {
    pc_mesh mesh = test_tube(context, 48, 15, 1.0, 1.5);
    for (size_t v = 0; v < mesh.vertex_count; ++v) {
        double *p = &mesh.positions[3 * v];
        const double way = p[1] - 0.5, radius = way < -1e-9 ? 0.5 - gap : 0.5;
        p[0] *= radius, p[1] = fabs(way), p[2] *= radius;
    }
    return mesh;
}

static inline pc_mesh test_torus(pc_context *context, uint32_t around, uint32_t along, double major,
                                 double minor) {
    pc_mesh mesh = test_grid(context, around, along, true, true);
    for (size_t v = 0; v < mesh.vertex_count; ++v) {
        double *p = &mesh.positions[3 * v];
        const double u = 6.283185307179586 * p[0], w = 6.283185307179586 * p[1];
        p[0] = (major + minor * cos(w)) * cos(u), p[1] = (major + minor * cos(w)) * sin(u);
        p[2] = minor * sin(w);
    }
    return mesh;
}

// A closed box surface with n x n quads per side, pushed onto the unit sphere.
static inline pc_mesh test_sphere(pc_context *context, uint32_t n) {
    const size_t side = (size_t)n + 1;
    pc_mesh mesh = {.triangle_count = 12 * (size_t)n * n};
    uint32_t *index = PCI_ALLOCATE(context, uint32_t, side * side * side);
    mesh.positions = PCI_ALLOCATE(context, double, 3 * side * side * side);
    mesh.triangles = PCI_ALLOCATE(context, uint32_t, 3 * mesh.triangle_count);
    for (size_t i = 0; i < side * side * side; ++i) {
        const size_t x[3] = {i % side, i / side % side, i / side / side};
        if (x[0] % n == 0 || x[1] % n == 0 || x[2] % n == 0) {
            double *p = &mesh.positions[3 * mesh.vertex_count];
            for (size_t k = 0; k < 3; ++k) {
                p[k] = 2.0 * (double)x[k] / n - 1.0;
            }
            pci_normalize(p);
            index[i] = (uint32_t)mesh.vertex_count++;
        }
    }
    uint32_t *write = mesh.triangles;
    const size_t step[3] = {1, side, side * side};
    for (size_t axis = 0; axis < 3; ++axis) {
        const size_t u = step[(axis + 1) % 3], w = step[(axis + 2) % 3];
        for (size_t cell = 0; cell < 2 * (size_t)n * n; ++cell) {
            const bool far = cell >= (size_t)n * n;
            const size_t i = cell % n, j = cell / n % n;
            const size_t base = i * u + j * w + (far ? n * step[axis] : 0);
            const uint32_t a = index[base], b = index[base + u], c = index[base + u + w];
            const uint32_t d = index[base + w];
            *write++ = a, *write++ = far ? b : c, *write++ = far ? c : b;
            *write++ = a, *write++ = far ? c : d, *write++ = far ? d : c;
        }
    }
    pc_release(context, index);
    return mesh;
}

// Both meshes in one, the second one moved.
static inline pc_mesh test_union(pc_context *context, const pc_mesh *a, const pc_mesh *b,
                                 const double offset[3]) {
    pc_mesh mesh = {.vertex_count = a->vertex_count + b->vertex_count,
                    .triangle_count = a->triangle_count + b->triangle_count};
    mesh.positions = PCI_ALLOCATE(context, double, 3 * mesh.vertex_count);
    mesh.triangles = PCI_ALLOCATE(context, uint32_t, 3 * mesh.triangle_count);
    // `a` may be empty, without arrays.
    for (size_t i = 0; i < 3 * a->vertex_count; ++i) {
        mesh.positions[i] = a->positions[i];
    }
    for (size_t i = 0; i < 3 * a->triangle_count; ++i) {
        mesh.triangles[i] = a->triangles[i];
    }
    for (size_t i = 0; i < 3 * b->vertex_count; ++i) {
        mesh.positions[3 * a->vertex_count + i] = b->positions[i] + offset[i % 3];
    }
    for (size_t i = 0; i < 3 * b->triangle_count; ++i) {
        mesh.triangles[3 * a->triangle_count + i] = b->triangles[i] + (uint32_t)a->vertex_count;
    }
    return mesh;
}

#endif
