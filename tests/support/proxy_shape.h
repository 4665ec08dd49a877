// What every proxy must be.
#ifndef TEST_SUPPORT_PROXY_SHAPE_H
#define TEST_SUPPORT_PROXY_SHAPE_H

#include "geometry/topology.h"
#include "proxycloth/simplify.h"
#include "support/manifold.h"
#include "support/test.h"

typedef struct shape {
    size_t components, loops;
    long euler;
    double angle_mean, angle_worst; // smallest angle per triangle, degrees
} shape;

// Measures a mesh and checks what every proxy must be: a consistently oriented manifold of proper
// triangles that uses each of its vertices.
static inline shape check_manifold(pc_context *context, const pc_mesh *mesh) {
    pci_scratch scratch = pci_scratch_begin(context);
    pci_topology topology;
    assert_true(pci_topology_build(&scratch, mesh, &topology));
    assert_manifold(mesh, &topology);
    shape result = {.angle_worst = 180.0};
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        const uint32_t *corner = &mesh->triangles[3 * t];
        assert_true(corner[0] != corner[1] && corner[1] != corner[2] && corner[2] != corner[0]);
        double smallest = 180.0;
        for (size_t c = 0; c < 3; ++c) {
            double a[3], b[3];
            const double *at = &mesh->positions[3 * (size_t)corner[c]];
            assert_true(isfinite(at[0]) && isfinite(at[1]) && isfinite(at[2]));
            pci_sub(&mesh->positions[3 * (size_t)corner[(c + 1) % 3]], at, a);
            pci_sub(&mesh->positions[3 * (size_t)corner[(c + 2) % 3]], at, b);
            const double cosine = pci_dot(a, b) / (pci_norm(a) * pci_norm(b));
            smallest = fmin(smallest, acos(fmin(fmax(cosine, -1.0), 1.0)) * 57.29577951308232);
        }
        result.angle_mean += smallest / (double)mesh->triangle_count;
        result.angle_worst = fmin(result.angle_worst, smallest);
    }
    size_t *offsets = NULL;
    uint32_t *loops = NULL;
    uint32_t *component = PCI_SCRATCH(&scratch, uint32_t, mesh->triangle_count);
    assert_true(pci_boundary_loops(&scratch, mesh, &topology, &result.loops, &offsets, &loops));
    result.components = pci_triangle_components(&scratch, mesh, &topology, component);
    result.euler =
        (long)mesh->vertex_count - (long)topology.edge_count + (long)mesh->triangle_count;
    pci_scratch_end(&scratch);
    return result;
}

static inline pc_simplify_options simplify_options(uint32_t vertices) {
    pc_simplify_options options;
    pc_record_set_defaults(&pc_simplify_options_record, &options);
    options.vertices = vertices;
    return options;
}

// Simplify and free the input.
static inline pc_mesh simplified_with(pc_context *context, pc_mesh *mesh,
                                      const pc_simplify_options *options,
                                      pc_simplify_report *report) {
    pc_mesh proxy = {0};
    assert_ok(context, pc_simplify(context, NULL, mesh, options, &proxy, report));
    pc_mesh_free(context, mesh);
    return proxy;
}
static inline pc_mesh simplified(pc_context *context, pc_mesh *mesh, uint32_t vertices,
                                 pc_simplify_report *report) {
    const pc_simplify_options options = simplify_options(vertices);
    return simplified_with(context, mesh, &options, report);
}

#endif
