#include "stages/carve/loops.h"

#include "geometry/topology.h"

// A loop that bounds a part from outside is no hole: filling it would close the part to a pillow.
// The part must have this many times the area of a disc with the loop's circumference.
static const double hole_area_ratio = 2.0;

static bool loop_is_hole(const pc_mesh *mesh, const uint32_t *loop, size_t length, double longest,
                         double area) {
    double perimeter = 0.0;
    for (size_t i = 0; i < length; ++i) {
        perimeter +=
            sqrt(pci_squared_distance(&mesh->positions[3 * (size_t)loop[i]],
                                      &mesh->positions[3 * (size_t)loop[(i + 1) % length]]));
    }
    const double pi = 3.14159265358979323846;
    return perimeter <= longest && area > hole_area_ratio * perimeter * perimeter / (4.0 * pi);
}

// Area of the part that each vertex belongs to.
static bool vertex_part_areas(pci_scratch *scratch, const pc_mesh *mesh,
                              const pci_topology *topology, double **vertex_areas) {
    uint32_t *component = PCI_SCRATCH(scratch, uint32_t, mesh->triangle_count);
    *vertex_areas = PCI_SCRATCH(scratch, double, mesh->vertex_count);
    if (scratch->failed) {
        return false;
    }
    const size_t count = pci_triangle_components(scratch, mesh, topology, component);
    double *areas = PCI_SCRATCH(scratch, double, count);
    if (areas == NULL) {
        return false;
    }
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        areas[component[t]] += pci_triangle_area(mesh, t);
    }
    for (size_t c = 0; c < 3 * mesh->triangle_count; ++c) {
        (*vertex_areas)[mesh->triangles[c]] = areas[component[c / 3]];
    }
    return true;
}

bool pci_fill_loops(pci_scratch *scratch, pc_mesh *mesh, size_t most_edges, double longest,
                    uint64_t *filled) {
    pci_topology topology;
    size_t loop_count = 0, *offsets = NULL;
    uint32_t *loops = NULL;
    double *areas = NULL;
    if (!pci_topology_build_edges(scratch, mesh, &topology) ||
        !pci_boundary_loops(scratch, mesh, &topology, &loop_count, &offsets, &loops) ||
        !vertex_part_areas(scratch, mesh, &topology, &areas)) {
        return false;
    }
    uint8_t *hole = PCI_SCRATCH(scratch, uint8_t, loop_count);
    if (hole == NULL) {
        return false;
    }
    size_t vertices = mesh->vertex_count, triangles = mesh->triangle_count, holes = 0;
    for (size_t i = 0; i < loop_count; ++i) {
        const size_t length = offsets[i + 1] - offsets[i];
        const uint32_t *loop = &loops[offsets[i]];
        if (length >= 3 && length <= most_edges &&
            loop_is_hole(mesh, loop, length, longest, areas[loop[0]])) {
            hole[i] = 1;
            ++holes;
            vertices += length > 3;
            triangles += length > 3 ? length : 1;
        }
    }
    *filled += holes;
    if (holes == 0) {
        return true;
    }
    pc_context *context = scratch->context;
    pc_mesh out = {vertices, PCI_ALLOCATE(context, double, 3 * vertices), triangles,
                   PCI_ALLOCATE(context, uint32_t, 3 * triangles)};
    if (out.positions == NULL || out.triangles == NULL) {
        pc_mesh_free(context, &out);
        return false;
    }
    memcpy(out.positions, mesh->positions, 3 * mesh->vertex_count * sizeof(double));
    memcpy(out.triangles, mesh->triangles, 3 * mesh->triangle_count * sizeof(uint32_t));
    uint32_t center = (uint32_t)mesh->vertex_count;
    uint32_t *write = &out.triangles[3 * mesh->triangle_count];
    for (size_t i = 0; i < loop_count; ++i) {
        const size_t length = offsets[i + 1] - offsets[i];
        const uint32_t *loop = &loops[offsets[i]];
        if (!hole[i]) {
            continue;
        }
        if (length == 3) {
            *write++ = loop[0], *write++ = loop[2], *write++ = loop[1];
            continue;
        }
        for (size_t j = 0; j < length; ++j) {
            *write++ = loop[(j + 1) % length], *write++ = loop[j], *write++ = center;
            for (size_t k = 0; k < 3; ++k) {
                out.positions[3 * (size_t)center + k] +=
                    mesh->positions[3 * (size_t)loop[j] + k] / (double)length;
            }
        }
        ++center;
    }
    pc_mesh_free(context, mesh);
    *mesh = out;
    return true;
}
