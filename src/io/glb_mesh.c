// The two meshes of the file: the garment by materials, and the proxy.
#include <stdio.h>

#include "geometry/topology.h"
#include "geometry/transfer.h"
#include "io/glb_writer.h"

static void add_indices(pci_glb *glb, cJSON *primitive, const uint32_t *indices, size_t count,
                        size_t vertex_count) {
    // The largest index of a type restarts strips and is not allowed.
    const bool narrow = vertex_count <= UINT16_MAX;
    void *bytes = pci_glb_add_view(glb, count * (narrow ? 2 : 4), GL_ELEMENT_ARRAY_BUFFER);
    if (bytes == NULL) {
        return;
    }
    for (size_t i = 0; i < count; ++i) {
        if (narrow) {
            ((uint16_t *)bytes)[i] = (uint16_t)indices[i];
        } else {
            ((uint32_t *)bytes)[i] = indices[i];
        }
    }
    pci_glb_add_accessor(glb, 0, narrow ? GL_UNSIGNED_SHORT : GL_UNSIGNED_INT, count, "SCALAR");
    pci_json_count(&glb->json, primitive, "indices", glb->accessor_count - 1);
}

static float unit_interval(float value) {
    return value > 0.0f ? (value < 1.0f ? value : 1.0f) : 0.0f;
}

// Adds a material and returns its index.
static uint32_t add_material(pci_glb *glb, const pc_material *material, const char *name) {
    cJSON *object = pci_json_object(&glb->json, glb->materials, NULL);
    pci_json_string(&glb->json, object, "name", name);
    cJSON *factors = pci_json_object(&glb->json, object, "pbrMetallicRoughness");
    cJSON *color = pci_json_array(&glb->json, factors, "baseColorFactor");
    for (size_t k = 0; k < 4; ++k) {
        pci_json_number(&glb->json, color, NULL, (double)unit_interval(material->base_color[k]));
    }
    pci_json_number(&glb->json, factors, "metallicFactor",
                    (double)unit_interval(material->metallic));
    pci_json_number(&glb->json, factors, "roughnessFactor",
                    (double)unit_interval(material->roughness));
    if (material->base_color[3] < 1.0f) {
        pci_json_string(&glb->json, object, "alphaMode", "BLEND");
    }
    pci_json_bool(&glb->json, object, "doubleSided", material->double_sided);
    return glb->material_count++;
}

static void add_positions(pci_glb *glb, cJSON *attributes, const double *positions,
                          const uint32_t *rows, size_t count) {
    cJSON *accessor = NULL;
    float *values = pci_glb_add_floats(glb, count, 3, GL_ARRAY_BUFFER, &accessor);
    if (values == NULL) {
        return;
    }
    for (size_t i = 0; i < 3 * count; ++i) {
        values[i] = (float)positions[3 * (rows != NULL ? rows[i / 3] : i / 3) + i % 3];
    }
    pci_glb_add_limits(glb, accessor, values, count, 3);
    pci_json_count(&glb->json, attributes, "POSITION", glb->accessor_count - 1);
}

// The first of the two normals that has a direction, at unit length.
static void choose_normal(const double first[3], const double second[3], float normal[3]) {
    double n[3] = {first[0], first[1], first[2]};
    if (!pci_normalize(n)) {
        memcpy(n, second, sizeof(n));
        if (!pci_normalize(n)) {
            n[0] = 0.0, n[1] = 1.0, n[2] = 0.0;
        }
    }
    for (size_t k = 0; k < 3; ++k) {
        normal[k] = (float)n[k];
    }
}

static void add_visual_attributes(pci_glb *glb, cJSON *attributes, const uint32_t *corners,
                                  const uint32_t *vertices, size_t count,
                                  const double *smooth_normals, const pci_glb_weights *packed) {
    const pc_visual *visual = &glb->asset->visual;
    add_positions(glb, attributes, visual->surface.positions, vertices, count);
    float *normals = pci_glb_add_attribute(glb, attributes, "NORMAL", count, 3);
    for (size_t i = 0; i < count && normals != NULL; ++i) {
        double given[3] = {0.0, 0.0, 0.0};
        for (size_t k = 0; k < 3 && visual->normals != NULL; ++k) {
            given[k] = (double)visual->normals[3 * (size_t)corners[i] + k];
        }
        choose_normal(given, &smooth_normals[3 * (size_t)vertices[i]], &normals[3 * i]);
    }
    if (visual->texcoords != NULL) {
        float *texcoords = pci_glb_add_attribute(glb, attributes, "TEXCOORD_0", count, 2);
        for (size_t i = 0; i < 2 * count && texcoords != NULL; ++i) {
            texcoords[i] = visual->texcoords[2 * (size_t)corners[i / 2] + i % 2];
        }
    }
    if (visual->colors != NULL) {
        float *colors = pci_glb_add_attribute(glb, attributes, "COLOR_0", count, 4);
        for (size_t i = 0; i < 4 * count && colors != NULL; ++i) {
            colors[i] = unit_interval(visual->colors[4 * (size_t)corners[i / 4] + i % 4]);
        }
    }
    pci_glb_add_weights(glb, attributes, packed, vertices, count);
}

static cJSON *add_mesh(pci_glb *glb, const char *name) {
    cJSON *mesh = pci_json_object(&glb->json, glb->meshes, NULL);
    pci_json_string(&glb->json, mesh, "name", name);
    return pci_json_array(&glb->json, mesh, "primitives");
}

// Arrays for one primitive of the visual mesh, used for one after the other.
typedef struct primitive_arrays {
    uint32_t *slots;    // #corners, new index + 1 of a split vertex, or 0
    uint32_t *corners;  // split vertex of each new vertex
    uint32_t *vertices; // vertex of the surface of each new vertex
    uint32_t *indices;  // #F by 3
} primitive_arrays;

// One primitive: the triangles of one material with the split vertices that they use, in order.
static void add_visual_primitive(pci_glb *glb, cJSON *primitives, uint32_t material,
                                 const primitive_arrays *arrays, const double *smooth_normals,
                                 const pci_glb_weights *packed) {
    const pc_visual *visual = &glb->asset->visual;
    size_t index_count = 0;
    uint32_t count = 0;
    memset(arrays->slots, 0, visual->corner_count * sizeof(uint32_t));
    for (size_t i = 0; i < 3 * visual->surface.triangle_count; ++i) {
        if (visual->triangle_materials[i / 3] == material) {
            arrays->slots[visual->corner_triangles[i]] = 1;
            arrays->indices[index_count++] = visual->corner_triangles[i];
        }
    }
    if (index_count == 0) {
        return;
    }
    for (uint32_t corner = 0; corner < visual->corner_count; ++corner) {
        if (arrays->slots[corner] != 0) {
            arrays->corners[count] = corner;
            arrays->vertices[count] = visual->corner_vertices[corner];
            arrays->slots[corner] = ++count;
        }
    }
    for (size_t i = 0; i < index_count; ++i) {
        arrays->indices[i] = arrays->slots[arrays->indices[i]] - 1;
    }
    cJSON *primitive = pci_json_object(&glb->json, primitives, NULL);
    cJSON *attributes = pci_json_object(&glb->json, primitive, "attributes");
    add_visual_attributes(glb, attributes, arrays->corners, arrays->vertices, count, smooth_normals,
                          packed);
    add_indices(glb, primitive, arrays->indices, index_count, count);
    const pc_material *look = &visual->materials[material];
    pci_json_count(&glb->json, primitive, "material", add_material(glb, look, look->name));
}

void pci_glb_add_visual_mesh(pci_glb *glb) {
    const pc_visual *visual = &glb->asset->visual;
    pci_scratch *scratch = &glb->scratch;
    const primitive_arrays arrays = {
        .slots = PCI_SCRATCH(scratch, uint32_t, visual->corner_count),
        .corners = PCI_SCRATCH(scratch, uint32_t, visual->corner_count),
        .vertices = PCI_SCRATCH(scratch, uint32_t, visual->corner_count),
        .indices = PCI_SCRATCH(scratch, uint32_t, 3 * visual->surface.triangle_count)};
    double *smooth_normals = PCI_SCRATCH(scratch, double, 3 * visual->surface.vertex_count);
    pci_glb_weights packed = {.whole = pci_glb_weight_whole(glb)};
    pc_skin mixed = glb->asset->skin;
    (void)pci_mix_weights(scratch, &glb->body, glb->asset->proxy.vertex_count, &mixed);
    if (scratch->failed) {
        return;
    }
    pci_glb_pack_weights(glb, &mixed, &packed);
    if (scratch->failed) {
        return;
    }
    pci_vertex_normals(&visual->surface, smooth_normals);
    cJSON *primitives = add_mesh(glb, glb->name);
    for (uint32_t material = 0; material < visual->material_count && !pci_glb_failed(glb);
         ++material) {
        add_visual_primitive(glb, primitives, material, &arrays, smooth_normals, &packed);
    }
}

void pci_glb_add_proxy_mesh(pci_glb *glb) {
    const pc_mesh *proxy = &glb->asset->proxy;
    const size_t count = proxy->vertex_count;
    double *directions = PCI_SCRATCH(&glb->scratch, double, 3 * count);
    pci_glb_weights packed = {.slots = 4,
                              .whole = pci_glb_weight_whole(glb),
                              .joints = PCI_SCRATCH(&glb->scratch, uint32_t, 4 * count),
                              .weights = PCI_SCRATCH(&glb->scratch, float, 4 * count)};
    if (glb->scratch.failed) {
        return;
    }
    for (size_t v = 0; v < count; ++v) {
        packed.joints[4 * v] = (uint32_t)v;
        packed.weights[4 * v] = packed.whole > 0 ? (float)packed.whole : 1.0f;
    }
    char name[64];
    snprintf(name, sizeof(name), "%s_proxy", glb->name);
    cJSON *primitive = pci_json_object(&glb->json, add_mesh(glb, name), NULL);
    cJSON *attributes = pci_json_object(&glb->json, primitive, "attributes");
    add_positions(glb, attributes, proxy->positions, NULL, count);
    pci_vertex_normals(proxy, directions);
    float *normals = pci_glb_add_attribute(glb, attributes, "NORMAL", count, 3);
    for (size_t v = 0; v < count && normals != NULL; ++v) {
        choose_normal(&directions[3 * v], &directions[3 * v], &normals[3 * v]);
    }
    pci_glb_add_weights(glb, attributes, &packed, NULL, count);
    add_indices(glb, primitive, proxy->triangles, 3 * proxy->triangle_count, count);
    static const pc_material grey = {
        .base_color = {0.5f, 0.5f, 0.5f, 1.0f}, .roughness = 1.0f, .double_sided = true};
    pci_json_count(&glb->json, primitive, "material", add_material(glb, &grey, name));
}
