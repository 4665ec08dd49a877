#define _POSIX_C_SOURCE 200809L
#include "scene.h"

#include <fnmatch.h>
#include <stdlib.h>
#include <string.h>

bool scene_layout(const scene_header *header, uint64_t offsets[SCENE_ARRAYS + 1]) {
    const uint64_t limit = (uint64_t)1 << 31;
    const uint64_t counts[SCENE_ARRAYS] = {header->part_count,      header->material_count,
                                           header->animation_count, header->vertex_count,
                                           header->vertex_count,    header->vertex_count,
                                           header->vertex_count,    header->triangle_count};
    const uint64_t sizes[SCENE_ARRAYS] = {
        sizeof(scene_part), sizeof(pc_material), sizeof(scene_animation), 3 * sizeof(double),
        3 * sizeof(float),  2 * sizeof(float),   4 * sizeof(float),       3 * sizeof(uint32_t)};
    uint64_t offset = sizeof(scene_header);
    for (size_t i = 0; i < SCENE_ARRAYS; ++i) {
        if (counts[i] >= limit) {
            return false;
        }
        offsets[i] = offset;
        offset += (counts[i] * sizes[i] + 7) / 8 * 8;
    }
    offsets[SCENE_ARRAYS] = offset;
    return true;
}

static bool terminated(const char *text, size_t size) { return memchr(text, '\0', size) != NULL; }

static const char *check_parts(const scene_data *scene) {
    const scene_header *h = &scene->header;
    uint64_t vertices = 0, triangles = 0;
    for (size_t i = 0; i < h->part_count; ++i) {
        const scene_part *part = &scene->parts[i];
        if (!terminated(part->node, sizeof(part->node)) ||
            !terminated(part->mesh, sizeof(part->mesh))) {
            return "a name without end";
        }
        if (part->first_vertex != vertices || part->vertex_count > h->vertex_count - vertices ||
            part->first_triangle != triangles ||
            part->triangle_count > h->triangle_count - triangles) {
            return "parts that do not fit the arrays";
        }
        if (part->material >= h->material_count) {
            return "a material index out of range";
        }
        vertices += part->vertex_count;
        triangles += part->triangle_count;
        for (uint64_t k = 3 * part->first_triangle; k < 3 * triangles; ++k) {
            if (scene->triangles[k] < part->first_vertex || scene->triangles[k] >= vertices) {
                return "a vertex index out of range";
            }
        }
    }
    return vertices != h->vertex_count || triangles != h->triangle_count
               ? "parts that do not fill the arrays"
               : NULL;
}

const char *scene_open(void *buffer, size_t size, scene_data *scene) {
    memset(scene, 0, sizeof(*scene));
    scene->buffer = buffer;
    scene_header *h = &scene->header;
    uint64_t at[SCENE_ARRAYS + 1];
    if (size < sizeof(*h)) {
        return "too few bytes";
    }
    memcpy(h, buffer, sizeof(*h));
    if (memcmp(h->magic, SCENE_MAGIC, sizeof(h->magic)) != 0 || h->size != size ||
        !scene_layout(h, at) || at[SCENE_ARRAYS] != size ||
        !terminated(h->format, sizeof(h->format))) {
        return "a damaged header";
    }
    char *bytes = buffer;
    scene->parts = (scene_part *)(void *)(bytes + at[0]);
    scene->materials = (pc_material *)(void *)(bytes + at[1]);
    scene->animations = (scene_animation *)(void *)(bytes + at[2]);
    scene->positions = (double *)(void *)(bytes + at[3]);
    scene->normals = (float *)(void *)(bytes + at[4]);
    scene->texcoords = (float *)(void *)(bytes + at[5]);
    scene->colors = (float *)(void *)(bytes + at[6]);
    scene->triangles = (uint32_t *)(void *)(bytes + at[7]);
    for (size_t i = 0; i < h->material_count; ++i) {
        // A bool may only be 0 or 1.
        unsigned char two_sided;
        memcpy(&two_sided,
               bytes + at[1] + i * sizeof(pc_material) + offsetof(pc_material, double_sided), 1);
        if (two_sided > 1 ||
            !terminated(scene->materials[i].name, sizeof(scene->materials[i].name))) {
            return "a damaged material";
        }
    }
    for (size_t i = 0; i < h->animation_count; ++i) {
        if (!terminated(scene->animations[i].name, sizeof(scene->animations[i].name))) {
            return "a name without end";
        }
    }
    return check_parts(scene);
}

void scene_free(scene_data *scene) {
    free(scene->buffer);
    memset(scene, 0, sizeof(*scene));
}

size_t scene_select(const scene_data *scene, const char *const *patterns, size_t pattern_count,
                    uint8_t *chosen) {
    size_t count = 0;
    for (size_t i = 0; i < scene->header.part_count; ++i) {
        const scene_part *part = &scene->parts[i];
        const char *names[] = {part->node, part->mesh, scene->materials[part->material].name};
        chosen[i] = pattern_count == 0;
        for (size_t p = 0; p < pattern_count; ++p) {
            for (size_t n = 0; n < 3; ++n) {
                chosen[i] |= fnmatch(patterns[p], names[n], 0) == 0;
            }
        }
        count += chosen[i];
    }
    return count;
}

// Appends ", name" unless the text has it already or is full.
static void add_name(char *text, size_t size, const char *name) {
    const size_t used = strlen(text), length = strlen(name);
    const char *found = text;
    if (length == 0 || used + length + 3 > size) {
        return;
    }
    while ((found = strstr(found, name)) != NULL) {
        const bool starts = found == text || (found - text >= 2 && found[-2] == ',');
        if (starts && (found[length] == ',' || found[length] == '\0')) {
            return;
        }
        ++found;
    }
    snprintf(text + used, size - used, "%s%s", used != 0 ? ", " : "", name);
}

void scene_names(const scene_data *scene, char *text, size_t size) {
    text[0] = '\0';
    for (size_t i = 0; i < scene->header.part_count; ++i) {
        add_name(text, size, scene->parts[i].node);
        add_name(text, size, scene->parts[i].mesh);
    }
    for (size_t i = 0; i < scene->header.material_count; ++i) {
        add_name(text, size, scene->materials[i].name);
    }
}

pc_status scene_visual(const scene_data *scene, const uint8_t *chosen, pc_context *context,
                       pc_visual *visual, pc_visual_report *report) {
    const scene_header *h = &scene->header;
    uint64_t vertices = 0, triangles = 0, materials = 0;
    bool normals = false, texcoords = false, colors = false;
    for (size_t i = 0; i < h->part_count; ++i) {
        if (chosen[i]) {
            vertices += scene->parts[i].vertex_count;
            triangles += scene->parts[i].triangle_count;
            normals = normals || scene->parts[i].has_normals != 0;
            texcoords = texcoords || scene->parts[i].has_texcoords != 0;
            colors = colors || scene->parts[i].has_colors != 0;
        }
    }
    // Arrays of the chosen parts only; materials keep their order, unused ones are left out.
    double *positions = calloc(vertices + 1, 3 * sizeof(double));
    float *appearance = calloc(vertices + 1, 9 * sizeof(float));
    uint32_t *indices = calloc(triangles + 1, 4 * sizeof(uint32_t));
    uint32_t *new_material = calloc(h->material_count + 1, sizeof(uint32_t));
    pc_material *used = calloc(h->material_count + 1, sizeof(pc_material));
    pc_status status = PC_ERROR_OUT_OF_MEMORY;
    if (positions == NULL || appearance == NULL || indices == NULL || new_material == NULL ||
        used == NULL) {
        goto cleanup;
    }
    float *normal = appearance, *texcoord = normal + 3 * vertices, *color = texcoord + 2 * vertices;
    uint32_t *triangle_materials = indices + 3 * triangles;
    for (size_t i = 0; i < h->part_count; ++i) {
        if (chosen[i]) {
            new_material[scene->parts[i].material] = 1;
        }
    }
    for (size_t m = 0; m < h->material_count; ++m) {
        if (new_material[m] != 0) {
            used[materials] = scene->materials[m];
            new_material[m] = (uint32_t)materials++;
        }
    }
    uint64_t v = 0, t = 0;
    for (size_t i = 0; i < h->part_count; ++i) {
        const scene_part *part = &scene->parts[i];
        if (!chosen[i]) {
            continue;
        }
        const size_t first = part->first_vertex, count = part->vertex_count;
        memcpy(&positions[3 * v], &scene->positions[3 * first], count * 3 * sizeof(double));
        memcpy(&normal[3 * v], &scene->normals[3 * first], count * 3 * sizeof(float));
        memcpy(&texcoord[2 * v], &scene->texcoords[2 * first], count * 2 * sizeof(float));
        memcpy(&color[4 * v], &scene->colors[4 * first], count * 4 * sizeof(float));
        for (uint64_t k = 0; k < 3 * part->triangle_count; ++k) {
            indices[3 * t + k] =
                (uint32_t)(scene->triangles[3 * part->first_triangle + k] - first + v);
        }
        for (uint64_t k = 0; k < part->triangle_count; ++k) {
            triangle_materials[t + k] = new_material[part->material];
        }
        v += count;
        t += part->triangle_count;
    }
    const pc_visual_arrays arrays = {.vertex_count = vertices,
                                     .positions = positions,
                                     .triangle_count = triangles,
                                     .triangles = indices,
                                     .normals = normals ? normal : NULL,
                                     .texcoords = texcoords ? texcoord : NULL,
                                     .colors = colors ? color : NULL,
                                     .triangle_materials = triangle_materials,
                                     .material_count = materials,
                                     .materials = used};
    status = pc_visual_create(context, &arrays, visual, report);
cleanup:
    free(positions);
    free(appearance);
    free(indices);
    free(new_material);
    free(used);
    return status;
}
