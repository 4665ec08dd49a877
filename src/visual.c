// Plain arrays -> visual mesh: checks, welding, counts of defects.
#include <stdlib.h>

#include "core/core.h"
#include "core/sorting.h"
#include "geometry/topology.h"
#include "proxycloth/pipeline.h"

static const pc_field report_fields[] = {
    PCI_FIELD_REPORT(pc_visual_report, vertices, COUNT, "", "Distinct positions in use"),
    PCI_FIELD_REPORT(pc_visual_report, triangles, COUNT, "", "Triangles"),
    PCI_FIELD_WARNING(pc_visual_report, degenerate_triangles, COUNT, "Triangles without area",
                      "degenerate triangles were accepted"),
    PCI_FIELD_WARNING(pc_visual_report, duplicate_triangles, COUNT, "Repeated triangles",
                      "duplicate triangles were accepted"),
    PCI_FIELD_WARNING(pc_visual_report, stray_vertices, COUNT, "Vertices without triangle",
                      "stray vertices were ignored"),
    PCI_FIELD_WARNING(pc_visual_report, nonmanifold_edges, COUNT,
                      "Edges of more than two triangles", "non-manifold edges were accepted"),
    PCI_FIELD_WARNING(pc_visual_report, winding_conflicts, COUNT,
                      "Edges run twice in one direction", "edges have inconsistent winding"),
    PCI_FIELD_WARNING(pc_visual_report, replaced_attributes, COUNT,
                      "Vertices whose normal, texture coordinates or color were not usable",
                      "unusable normals, texture coordinates or colors were replaced"),
    PCI_FIELD_REPORT(pc_visual_report, components, COUNT, "", "Parts joined by positions"),
    PCI_FIELD_REPORT(pc_visual_report, diagonal, DOUBLE, "", "Bounding-box diagonal"),
};
const pc_record pc_visual_report_record = PCI_RECORD(report_fields, pc_visual_report);

// Coordinates beyond this are damage, and their products must stay far from overflow.
static const double coordinate_limit = 1e30;
// Points nearer to one line than this share of their extent are collinear: single precision files
// cannot hold a line better.
static const double collinear_tolerance = 1e-6;
// A triangle has no area when its height is below this share of its longest edge.
static const double area_tolerance = 1e-12;

static pc_status check_arrays(pc_context *context, const pc_visual_arrays *arrays) {
    const size_t limit = (size_t)1 << 31;
    if (arrays->vertex_count >= limit || arrays->triangle_count >= limit / 3) {
        return pci_fail(context, PC_ERROR_TOO_LARGE, "visual",
                        "visual: %zu vertices and %zu triangles exceed the limit of 2^31 elements",
                        arrays->vertex_count, arrays->triangle_count);
    }
    if ((arrays->vertex_count != 0 && arrays->positions == NULL) ||
        (arrays->triangle_count != 0 && arrays->triangles == NULL) ||
        (arrays->material_count != 0 && arrays->materials == NULL) ||
        (arrays->part_count != 0 && arrays->part_names == NULL) ||
        (arrays->joints == NULL) != (arrays->joint_weights == NULL)) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, "visual",
                        "visual: a count is given without its array");
    }
    if (arrays->triangle_count == 0) {
        return pci_fail(context, PC_ERROR_INVALID_MESH, "visual",
                        "visual: the mesh has no triangle");
    }
    for (size_t i = 0; i < 3 * arrays->vertex_count; ++i) {
        const double x = arrays->positions[i];
        if (!(fabs(x) <= coordinate_limit)) {
            return pci_fail(context, PC_ERROR_INVALID_MESH, "visual",
                            "visual: vertex %zu has %c = %g; coordinates must be finite and at "
                            "most %g in size",
                            i / 3, "xyz"[i % 3], x, coordinate_limit);
        }
    }
    for (size_t i = 0; i < 3 * arrays->triangle_count; ++i) {
        if (arrays->triangles[i] >= arrays->vertex_count) {
            return pci_fail(context, PC_ERROR_INVALID_MESH, "visual",
                            "visual: triangle %zu refers to vertex %u of %zu", i / 3,
                            arrays->triangles[i], arrays->vertex_count);
        }
    }
    const size_t materials = arrays->material_count != 0 ? arrays->material_count : 1;
    for (size_t t = 0; arrays->triangle_materials != NULL && t < arrays->triangle_count; ++t) {
        if (arrays->triangle_materials[t] >= materials) {
            return pci_fail(context, PC_ERROR_INVALID_MESH, "visual",
                            "visual: triangle %zu refers to material %u of %zu", t,
                            arrays->triangle_materials[t], materials);
        }
    }
    for (size_t t = 0; arrays->triangle_parts != NULL && t < arrays->triangle_count; ++t) {
        if (arrays->triangle_parts[t] >= arrays->part_count) {
            return pci_fail(context, PC_ERROR_INVALID_MESH, "visual",
                            "visual: triangle %zu refers to part %u of %zu", t,
                            arrays->triangle_parts[t], arrays->part_count);
        }
    }
    return PC_OK;
}

typedef struct weld_key {
    double position[3];
    uint32_t vertex;
} weld_key;

static int compare_keys(const void *left, const void *right) {
    const weld_key *a = left, *b = right;
    for (size_t k = 0; k < 3; ++k) {
        if (a->position[k] != b->position[k]) {
            return a->position[k] < b->position[k] ? -1 : 1;
        }
    }
    return (a->vertex > b->vertex) - (a->vertex < b->vertex);
}

// Maps each input vertex to its corner and to its position, PC_INVALID_INDEX where no triangle uses
// it. Both are numbered by first appearance in the input.
typedef struct weld {
    size_t corner_count, position_count;
    uint32_t *corners;   // #vertices
    uint32_t *positions; // #vertices
} weld;

static bool weld_positions(pci_scratch *scratch, const pc_visual_arrays *arrays, weld *result) {
    const size_t nv = arrays->vertex_count;
    result->corners = PCI_SCRATCH(scratch, uint32_t, nv);
    result->positions = PCI_SCRATCH(scratch, uint32_t, nv);
    weld_key *keys = PCI_SCRATCH(scratch, weld_key, nv);
    uint32_t *first = PCI_SCRATCH(scratch, uint32_t, nv);
    if (scratch->failed) {
        return false;
    }
    memset(result->corners, 0xff, nv * sizeof(uint32_t));
    memset(result->positions, 0xff, nv * sizeof(uint32_t));
    for (size_t i = 0; i < 3 * arrays->triangle_count; ++i) {
        result->corners[arrays->triangles[i]] = 0;
    }

    // Sort the used vertices by position; adding 0 turns -0 into 0.
    size_t used = 0;
    for (size_t v = 0; v < nv; ++v) {
        if (result->corners[v] != PC_INVALID_INDEX) {
            result->corners[v] = (uint32_t)used;
            for (size_t k = 0; k < 3; ++k) {
                keys[used].position[k] = arrays->positions[3 * v + k] + 0.0;
            }
            keys[used++].vertex = (uint32_t)v;
        }
    }
    qsort(keys, used, sizeof(*keys), compare_keys);

    // The first vertex of each run of equal positions stands for all.
    for (size_t i = 0, run = 0; i < used; ++i) {
        if (memcmp(keys[i].position, keys[run].position, sizeof(keys[i].position)) != 0) {
            run = i;
        }
        first[keys[i].vertex] = keys[run].vertex;
    }
    for (size_t v = 0; v < nv; ++v) {
        if (result->corners[v] != PC_INVALID_INDEX) {
            result->positions[v] =
                first[v] == v ? (uint32_t)result->position_count++ : result->positions[first[v]];
        }
    }
    result->corner_count = used;
    return true;
}

static bool has_area(const pc_mesh *mesh, size_t triangle) {
    const uint32_t *t = &mesh->triangles[3 * triangle];
    const double *a = &mesh->positions[3 * t[0]];
    const double *b = &mesh->positions[3 * t[1]];
    const double *c = &mesh->positions[3 * t[2]];
    double ab[3], ac[3], normal[3];
    pci_sub(b, a, ab);
    pci_sub(c, a, ac);
    pci_cross(ab, ac, normal);
    const double longest = fmax(pci_squared_distance(b, c), fmax(pci_dot(ab, ab), pci_dot(ac, ac)));
    return pci_norm(normal) > area_tolerance * longest;
}

// Rejects surfaces without extent, on a line, or without any area.
static pc_status check_extent(pc_context *context, const pc_mesh *mesh, double diagonal) {
    if (diagonal == 0.0) {
        return pci_fail(context, PC_ERROR_INVALID_MESH, "visual",
                        "visual: all positions are equal");
    }
    // The line through the first vertex and the one farthest from it.
    const double *origin = mesh->positions;
    double axis[3] = {0.0, 0.0, 0.0}, farthest = 0.0, width = 0.0;
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        const double distance = sqrt(pci_squared_distance(origin, &mesh->positions[3 * v]));
        if (distance > farthest) {
            farthest = distance;
            pci_sub(&mesh->positions[3 * v], origin, axis);
        }
    }
    (void)pci_normalize(axis);
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        double offset[3], across[3];
        pci_sub(&mesh->positions[3 * v], origin, offset);
        pci_cross(axis, offset, across);
        width = fmax(width, pci_norm(across));
    }
    if (width <= collinear_tolerance * diagonal) {
        return pci_fail(context, PC_ERROR_INVALID_MESH, "visual",
                        "visual: all positions lie on one line");
    }
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        if (has_area(mesh, t)) {
            return PC_OK;
        }
    }
    return pci_fail(context, PC_ERROR_INVALID_MESH, "visual", "visual: no triangle has an area");
}

static bool fill_surface(pc_context *context, const pc_visual_arrays *arrays, const weld *welded,
                         pc_visual *visual) {
    const size_t nf = arrays->triangle_count;
    pc_mesh *surface = &visual->surface;
    surface->vertex_count = welded->position_count;
    surface->triangle_count = nf;
    surface->positions = PCI_ALLOCATE(context, double, 3 * welded->position_count);
    surface->triangles = PCI_ALLOCATE(context, uint32_t, 3 * nf);
    visual->corner_count = welded->corner_count;
    visual->corner_vertices = PCI_ALLOCATE(context, uint32_t, welded->corner_count);
    visual->corner_triangles = PCI_ALLOCATE(context, uint32_t, 3 * nf);
    visual->triangle_materials = PCI_ALLOCATE(context, uint32_t, nf);
    if (surface->positions == NULL || surface->triangles == NULL ||
        visual->corner_vertices == NULL || visual->corner_triangles == NULL ||
        visual->triangle_materials == NULL) {
        return false;
    }
    for (size_t v = 0; v < arrays->vertex_count; ++v) {
        if (welded->corners[v] != PC_INVALID_INDEX) {
            const uint32_t position = welded->positions[v];
            visual->corner_vertices[welded->corners[v]] = position;
            for (size_t k = 0; k < 3; ++k) {
                surface->positions[3 * position + k] = arrays->positions[3 * v + k] + 0.0;
            }
        }
    }
    for (size_t i = 0; i < 3 * nf; ++i) {
        surface->triangles[i] = welded->positions[arrays->triangles[i]];
        visual->corner_triangles[i] = welded->corners[arrays->triangles[i]];
    }
    if (arrays->triangle_materials != NULL) {
        memcpy(visual->triangle_materials, arrays->triangle_materials, nf * sizeof(uint32_t));
    }
    return true;
}

// A number of an appearance: its value clamped into [0, 1], `fallback` where it is not finite.
static float unit_interval(float value, float fallback) {
    return !isfinite(value) ? fallback : value < 0.0F ? 0.0F : value > 1.0F ? 1.0F : value;
}

static bool fill_materials(pc_context *context, const pc_visual_arrays *arrays, pc_visual *visual) {
    const pc_material white = {
        .name = "default", .base_color = {1.0F, 1.0F, 1.0F, 1.0F}, .roughness = 1.0F};
    const pc_material *source = arrays->material_count != 0 ? arrays->materials : &white;
    visual->material_count = arrays->material_count != 0 ? arrays->material_count : 1;
    visual->materials = PCI_ALLOCATE(context, pc_material, visual->material_count);
    if (visual->materials == NULL) {
        return false;
    }
    for (size_t m = 0; m < visual->material_count; ++m) {
        pc_material *material = &visual->materials[m];
        // Bytes behind the name's end and padding stay zero: assets are compared byte by byte.
        for (size_t i = 0; i + 1 < sizeof(material->name) && source[m].name[i] != '\0'; ++i) {
            material->name[i] = source[m].name[i];
        }
        for (size_t k = 0; k < 4; ++k) {
            material->base_color[k] = unit_interval(source[m].base_color[k], 1.0F);
        }
        material->metallic = unit_interval(source[m].metallic, 0.0F);
        material->roughness = unit_interval(source[m].roughness, 1.0F);
        material->double_sided = source[m].double_sided;
    }
    return true;
}

// Names of the parts, with zeros behind their end, and the part of each triangle.
static bool fill_parts(pc_context *context, const pc_visual_arrays *arrays, pc_visual *visual) {
    if (arrays->part_count == 0 || arrays->triangle_parts == NULL) {
        return true;
    }
    const size_t size = PC_NAME_SIZE;
    visual->part_count = arrays->part_count;
    visual->part_names = PCI_ALLOCATE(context, char, size * arrays->part_count);
    visual->triangle_parts = PCI_ALLOCATE(context, uint32_t, arrays->triangle_count);
    if (visual->part_names == NULL || visual->triangle_parts == NULL) {
        return false;
    }
    for (size_t p = 0; p < arrays->part_count; ++p) {
        const char *name = &arrays->part_names[size * p];
        for (size_t i = 0; i + 1 < size && name[i] != '\0'; ++i) {
            visual->part_names[size * p + i] = name[i];
        }
    }
    memcpy(visual->triangle_parts, arrays->triangle_parts,
           arrays->triangle_count * sizeof(uint32_t));
    return true;
}

// Joints of the used vertices; weights that are no finite shares count as 0, the others sum to 1.
static bool fill_joints(pc_context *context, const pc_visual_arrays *arrays, const weld *welded,
                        pc_visual *visual) {
    if (arrays->joints == NULL) {
        return true;
    }
    visual->joints = PCI_ALLOCATE(context, uint32_t, 4 * visual->corner_count);
    visual->joint_weights = PCI_ALLOCATE(context, float, 4 * visual->corner_count);
    if (visual->joints == NULL || visual->joint_weights == NULL) {
        return false;
    }
    for (size_t v = 0; v < arrays->vertex_count; ++v) {
        const size_t c = welded->corners[v];
        double weights[4], sum = 0.0;
        for (size_t k = 0; k < 4; ++k) {
            const double weight = (double)arrays->joint_weights[4 * v + k];
            weights[k] = weight > 0.0 && isfinite(weight) ? weight : 0.0;
            sum += weights[k];
        }
        for (size_t k = 0; k < 4 && c != PC_INVALID_INDEX; ++k) {
            visual->joints[4 * c + k] = arrays->joints[4 * v + k];
            visual->joint_weights[4 * c + k] = sum > 0.0 ? (float)(weights[k] / sum) : 0.0F;
        }
    }
    return true;
}

// Unit normal of a corner; the surface's own normal where the file's is unusable (false).
static bool repair_normal(const float source[3], const double surface_normal[3], float out[3]) {
    double normal[3] = {(double)source[0], (double)source[1], (double)source[2]};
    const double length = pci_norm(normal);
    const bool usable = isfinite(length) && length > 1e-6;
    if (!usable) {
        memcpy(normal, surface_normal, sizeof(normal));
        if (pci_norm(normal) == 0.0) {
            normal[1] = 1.0;
        }
    }
    (void)pci_normalize(normal);
    for (size_t k = 0; k < 3; ++k) {
        out[k] = (float)normal[k];
    }
    return usable;
}

// Copies normals, texture coordinates and colours of the used vertices. Values that no renderer
// could use are replaced and counted.
static bool fill_appearance(pci_scratch *scratch, const pc_visual_arrays *arrays,
                            const weld *welded, pc_visual *visual, uint64_t *replaced) {
    pc_context *context = scratch->context;
    const size_t nc = visual->corner_count;
    const bool normals = arrays->normals != NULL, texcoords = arrays->texcoords != NULL,
               colors = arrays->colors != NULL;
    double *surface_normals = PCI_SCRATCH(scratch, double, 3 * visual->surface.vertex_count);
    visual->normals = normals ? PCI_ALLOCATE(context, float, 3 * nc) : NULL;
    visual->texcoords = texcoords ? PCI_ALLOCATE(context, float, 2 * nc) : NULL;
    visual->colors = colors ? PCI_ALLOCATE(context, float, 4 * nc) : NULL;
    if (scratch->failed || (normals && visual->normals == NULL) ||
        (texcoords && visual->texcoords == NULL) || (colors && visual->colors == NULL)) {
        return false;
    }
    if (normals) {
        pci_vertex_normals(&visual->surface, surface_normals);
    }
    for (size_t v = 0; v < arrays->vertex_count; ++v) {
        const size_t c = welded->corners[v];
        if (c == PC_INVALID_INDEX) {
            continue;
        }
        bool usable = true;
        if (normals) {
            usable = repair_normal(&arrays->normals[3 * v],
                                   &surface_normals[3 * (size_t)visual->corner_vertices[c]],
                                   &visual->normals[3 * c]);
        }
        for (size_t k = 0; texcoords && k < 2; ++k) {
            const float value = arrays->texcoords[2 * v + k];
            usable = usable && isfinite(value);
            visual->texcoords[2 * c + k] = isfinite(value) ? value : 0.0F;
        }
        for (size_t k = 0; colors && k < 4; ++k) {
            const float value = arrays->colors[4 * v + k];
            usable = usable && isfinite(value);
            visual->colors[4 * c + k] = unit_interval(value, 1.0F);
        }
        *replaced += !usable;
    }
    return true;
}

// Counts edges with too many triangles or with clashing directions; duplicates and triangles with a
// repeated vertex do not take part.
static bool count_edge_defects(pci_scratch *scratch, const pc_mesh *mesh, const uint8_t *duplicate,
                               pc_visual_report *report) {
    uint64_t *keys = PCI_SCRATCH(scratch, uint64_t, 3 * mesh->triangle_count);
    if (keys == NULL) {
        return false;
    }
    size_t count = 0;
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        const uint32_t *v = &mesh->triangles[3 * t];
        if (duplicate[t] || v[0] == v[1] || v[1] == v[2] || v[2] == v[0]) {
            continue;
        }
        for (size_t k = 0; k < 3; ++k) {
            // Smaller vertex, larger vertex, direction; vertices are below 2^31.
            const uint64_t a = v[k], b = v[(k + 1) % 3];
            keys[count++] = a < b ? a << 32 | b << 1 : b << 32 | a << 1 | 1;
        }
    }
    if (!pci_sort_keys(scratch->context, count, keys, NULL)) {
        return false;
    }
    for (size_t i = 0, end = 0; i < count; i = end) {
        while (end < count && keys[end] >> 1 == keys[i] >> 1) {
            ++end;
        }
        report->nonmanifold_edges += end - i > 2;
        report->winding_conflicts += end - i == 2 && keys[i] == keys[i + 1];
    }
    return true;
}

static bool count_components(pci_scratch *scratch, const pc_mesh *mesh, uint64_t *components) {
    uint32_t *parents = PCI_SCRATCH(scratch, uint32_t, mesh->vertex_count);
    if (parents == NULL) {
        return false;
    }
    *components = pci_vertex_components(mesh, parents);
    return true;
}

static bool count_defects(pci_scratch *scratch, const pc_visual_arrays *arrays,
                          const pc_visual *visual, pc_visual_report *report) {
    const pc_mesh *mesh = &visual->surface;
    uint8_t *duplicate = PCI_SCRATCH(scratch, uint8_t, mesh->triangle_count);
    if (scratch->failed || !pci_mark_duplicates(scratch, mesh, duplicate) ||
        !count_edge_defects(scratch, mesh, duplicate, report) ||
        !count_components(scratch, mesh, &report->components)) {
        return false;
    }
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        report->degenerate_triangles += !has_area(mesh, t);
        report->duplicate_triangles += duplicate[t];
    }
    report->vertices = mesh->vertex_count;
    report->triangles = mesh->triangle_count;
    report->stray_vertices = arrays->vertex_count - visual->corner_count;
    return true;
}

pc_status pc_visual_create(pc_context *context, const pc_visual_arrays *arrays, pc_visual *visual,
                           pc_visual_report *report) {
    static const pc_visual empty;
    if (arrays == NULL || visual == NULL || memcmp(visual, &empty, sizeof(empty)) != 0) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, "visual",
                        "visual: arrays and an empty output are needed");
    }
    pc_visual_report counts = {0};
    if (report != NULL) {
        *report = counts;
    }
    pc_status status = check_arrays(context, arrays);
    if (status != PC_OK) {
        return status;
    }
    pci_scratch scratch = pci_scratch_begin(context);
    weld welded = {0};
    if (!weld_positions(&scratch, arrays, &welded) ||
        !fill_surface(context, arrays, &welded, visual) ||
        !fill_materials(context, arrays, visual) || !fill_parts(context, arrays, visual) ||
        !fill_joints(context, arrays, &welded, visual) ||
        !fill_appearance(&scratch, arrays, &welded, visual, &counts.replaced_attributes) ||
        !count_defects(&scratch, arrays, visual, &counts)) {
        status = pci_fail_memory(context, "visual");
    }
    if (status == PC_OK) {
        counts.diagonal = pci_diagonal(&visual->surface);
        status = check_extent(context, &visual->surface, counts.diagonal);
    }
    pci_scratch_end(&scratch);
    if (status != PC_OK) {
        pc_visual_free(context, visual);
    } else if (report != NULL) {
        *report = counts;
    }
    return status;
}
