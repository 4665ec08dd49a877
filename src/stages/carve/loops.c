#include "stages/carve/loops.h"

#include "geometry/bvh.h"
#include "geometry/topology.h"

// A loop that bounds a part from outside is no hole: filling it would close the part to a pillow.
// The part must have this many times the area of a disc with the loop's circumference.
static const double hole_area_ratio = 2.0;

// The middle of a hole is at most so many times the loop's mean radius away from the whole.
static const double most_away = 0.5;
// Faces that are missing: cosine between them and those around, at least; area of the part, at
// most; edges around two triangles that meet at a vertex.
static const double least_flat = 0.5, most_missing = 0.01;
enum { most_face_edges = 6 };

// What is asked of a loop.
typedef struct loop_shape {
    double perimeter, radius; // mean distance from the middle
    double middle[3], normal[3];
} loop_shape;

static void measure_loop(const pc_mesh *mesh, const uint32_t *loop, size_t length,
                         loop_shape *shape) {
    *shape = (loop_shape){.perimeter = 0.0};
    for (size_t i = 0; i < 3 * length; ++i) {
        shape->middle[i % 3] += mesh->positions[3 * (size_t)loop[i / 3] + i % 3] / (double)length;
    }
    for (size_t i = 0; i < length; ++i) {
        const double *p = &mesh->positions[3 * (size_t)loop[i]];
        const double *q = &mesh->positions[3 * (size_t)loop[(i + 1) % length]];
        double u[3], v[3], n[3];
        pci_sub(p, shape->middle, u);
        pci_sub(q, shape->middle, v);
        pci_cross(v, u, n);
        shape->perimeter += sqrt(pci_squared_distance(p, q));
        shape->radius += pci_norm(u) / (double)length;
        for (size_t k = 0; k < 3; ++k) {
            shape->normal[k] += n[k];
        }
    }
}

// Whether a loop is where a few faces like those along it, by its vertices, are missing.
static bool lacks_faces(const pc_mesh *mesh, const uint32_t *faces, const uint32_t *loop,
                        size_t length, double part_area, const loop_shape *shape) {
    double normal[3] = {shape->normal[0], shape->normal[1], shape->normal[2]}, around = 0.0;
    const double area = 0.5 * pci_norm(normal);
    bool flat = length <= most_face_edges && area <= most_missing * part_area;
    flat = flat && pci_normalize(normal);
    for (size_t i = 0; i < length && flat; ++i) {
        double face[3];
        pci_triangle_vector(mesh, faces[loop[i]], face);
        around += 0.5 * pci_norm(face) / (double)length;
        flat = pci_normalize(face) && pci_dot(face, normal) >= least_flat;
    }
    return flat && area <= most_face_edges * around;
}

static bool loop_is_hole(const pc_mesh *mesh, const pci_hole_limits *limits, const uint32_t *faces,
                         const uint32_t *loop, size_t length, double area) {
    loop_shape shape;
    if (length < 3 || length > limits->most_edges) {
        return false;
    }
    measure_loop(mesh, loop, length, &shape);
    if (area <= hole_area_ratio * shape.perimeter * shape.perimeter / (4.0 * PCI_PI)) {
        return false;
    }
    if (shape.perimeter > limits->longest) {
        return limits->missing_faces && lacks_faces(mesh, faces, loop, length, area, &shape);
    }
    return true;
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

// The face behind each border edge, by the vertex with which its loop lists it.
static uint32_t *border_faces(pci_scratch *scratch, const pc_mesh *mesh,
                              const pci_topology *topology) {
    uint32_t *faces = PCI_SCRATCH(scratch, uint32_t, mesh->vertex_count);
    for (size_t i = 0; faces != NULL && i < 3 * mesh->triangle_count; ++i) {
        const uint32_t e = topology->triangle_edges[i];
        if (pci_side_count(topology, e) == 1) {
            faces[mesh->triangles[i]] = (uint32_t)(i / 3);
        }
    }
    return faces;
}

// Where the border of a mesh runs.
typedef struct border {
    size_t loop_count, *offsets;
    uint32_t *loops, *faces; // #V: the face behind the edge that begins there
    double *areas;           // #V: of the part
    uint8_t *hole;           // #loops
} border;

static bool find_loops(pci_scratch *scratch, const pc_mesh *mesh, const pci_topology *topology,
                       border *b) {
    if (!pci_boundary_loops(scratch, mesh, topology, &b->loop_count, &b->offsets, &b->loops) ||
        !vertex_part_areas(scratch, mesh, topology, &b->areas)) {
        return false;
    }
    b->faces = border_faces(scratch, mesh, topology);
    b->hole = PCI_SCRATCH(scratch, uint8_t, b->loop_count);
    return !scratch->failed;
}

// Loops around which the whole ends are no holes.
static pc_status keep_openings(pci_scratch *scratch, const char *stage, const pc_mesh *mesh,
                               const pci_hole_limits *limits, border *b) {
    pci_bvh **tree = limits->tree;
    const pc_status status =
        *tree == NULL ? pci_bvh_create(scratch->context, stage, limits->whole, tree) : PC_OK;
    for (size_t i = 0; status == PC_OK && i < b->loop_count; ++i) {
        if (b->hole[i]) {
            loop_shape shape;
            measure_loop(mesh, &b->loops[b->offsets[i]], b->offsets[i + 1] - b->offsets[i], &shape);
            b->hole[i] =
                pci_bvh_closest(*tree, shape.middle, INFINITY).distance <= most_away * shape.radius;
        }
    }
    return status;
}

static bool fill(pc_context *context, const border *b, size_t vertices, size_t triangles,
                 pc_mesh *mesh) {
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
    for (size_t i = 0; i < b->loop_count; ++i) {
        const size_t length = b->offsets[i + 1] - b->offsets[i];
        const uint32_t *loop = &b->loops[b->offsets[i]];
        if (!b->hole[i]) {
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

pc_status pci_fill_loops(pci_scratch *scratch, const char *stage, const pci_topology *topology,
                         const pci_hole_limits *limits, pc_mesh *mesh, uint64_t *filled) {
    border b;
    size_t vertices = mesh->vertex_count, triangles = mesh->triangle_count, holes = 0;
    if (!find_loops(scratch, mesh, topology, &b)) {
        return pci_fail_memory(scratch->context, stage);
    }
    for (size_t i = 0; i < b.loop_count; ++i) {
        const uint32_t *loop = &b.loops[b.offsets[i]];
        b.hole[i] = loop_is_hole(mesh, limits, b.faces, loop, b.offsets[i + 1] - b.offsets[i],
                                 b.areas[loop[0]]);
        holes += b.hole[i];
    }
    if (holes > 0 && limits->whole != NULL) {
        const pc_status status = keep_openings(scratch, stage, mesh, limits, &b);
        if (status != PC_OK) {
            return status;
        }
    }
    holes = 0;
    for (size_t i = 0; i < b.loop_count; ++i) {
        const size_t length = b.offsets[i + 1] - b.offsets[i];
        if (b.hole[i]) {
            ++holes;
            vertices += length > 3;
            triangles += length > 3 ? length : 1;
        }
    }
    *filled += holes;
    return holes == 0 || fill(scratch->context, &b, vertices, triangles, mesh)
               ? PC_OK
               : pci_fail_memory(scratch->context, stage);
}
