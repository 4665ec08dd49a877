#define _POSIX_C_SOURCE 200809L
#include "scene.h"

#include <fnmatch.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

bool scene_layout(const scene_header *header, uint64_t offsets[SCENE_ARRAYS + 1]) {
    const uint64_t limit = (uint64_t)1 << 31;
    if (header->joint_count >= limit || header->pose_count >= limit) {
        return false;
    }
    const struct {
        uint64_t count, size;
    } arrays[SCENE_ARRAYS] = {{header->part_count, sizeof(scene_part)},
                              {header->material_count, sizeof(pc_material)},
                              {header->animation_count, sizeof(scene_animation)},
                              {header->vertex_count, 3 * sizeof(double)},
                              {header->vertex_count, 3 * sizeof(float)},
                              {header->vertex_count, 2 * sizeof(float)},
                              {header->vertex_count, 4 * sizeof(float)},
                              {header->triangle_count, 3 * sizeof(uint32_t)},
                              {header->joint_count, sizeof(scene_joint)},
                              {header->pose_count * header->joint_count, 12 * sizeof(float)},
                              {header->vertex_count, 4 * sizeof(uint32_t)},
                              {header->vertex_count, 4 * sizeof(float)}};
    uint64_t offset = sizeof(scene_header);
    for (size_t i = 0; i < SCENE_ARRAYS; ++i) {
        if (arrays[i].count >= limit) {
            return false;
        }
        offsets[i] = offset;
        offset += (arrays[i].count * arrays[i].size + 7) / 8 * 8;
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

// Joints, poses and weights; whatever is not finite would spread.
static const char *check_joints(const scene_data *scene) {
    const scene_header *h = &scene->header;
    for (size_t j = 0; j < h->joint_count; ++j) {
        const double *at = scene->joints[j].center;
        if (!terminated(scene->joints[j].name, PC_NAME_SIZE) || !isfinite(at[0]) ||
            !isfinite(at[1]) || !isfinite(at[2]) ||
            (scene->joints[j].parent >= j && scene->joints[j].parent != PC_INVALID_INDEX)) {
            return "a damaged joint";
        }
    }
    for (size_t i = 0; i < 12 * h->pose_count * h->joint_count; ++i) {
        if (!isfinite(scene->poses[i])) {
            return "a pose that is not finite";
        }
    }
    for (size_t i = 0; i < 4 * h->vertex_count; ++i) {
        if (!(scene->vertex_weights[i] >= 0.0F && scene->vertex_weights[i] <= 1e6F) ||
            (h->joint_count != 0 && scene->vertex_joints[i] >= h->joint_count)) {
            return "a weight out of range";
        }
    }
    for (size_t i = 0; i < h->animation_count; ++i) {
        const scene_animation *a = &scene->animations[i];
        if (a->first_pose > h->pose_count || a->pose_count > h->pose_count - a->first_pose ||
            (a->pose_count != 0 && !(a->rate > 0.0 && isfinite(a->rate)))) {
            return "an animation out of range";
        }
    }
    return NULL;
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
    scene->joints = (scene_joint *)(void *)(bytes + at[8]);
    scene->poses = (float *)(void *)(bytes + at[9]);
    scene->vertex_joints = (uint32_t *)(void *)(bytes + at[10]);
    scene->vertex_weights = (float *)(void *)(bytes + at[11]);
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
    const char *defect = check_joints(scene);
    return defect != NULL ? defect : check_parts(scene);
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

// The mesh's name; where it has none, its node's.
static void part_name(const scene_part *part, char name[PC_NAME_SIZE]) {
    cli_clean_text(name, PC_NAME_SIZE, part->mesh[0] != '\0' ? part->mesh : part->node);
}

// The parts of a scene that were chosen, or the others, one after another.
typedef struct gathered {
    size_t vertices, triangles, parts;
    char *names;                        // #parts by PC_NAME_SIZE
    double *positions;                  // #V by 3
    uint32_t *corners, *triangle_parts; // #F by 3, #F
    uint32_t *joints;                   // #V by 4
    float *weights;                     // #V by 4
} gathered;

static void release(gathered *g) {
    free(g->names);
    free(g->positions);
    free(g->corners);
    free(g->triangle_parts);
    free(g->joints);
    free(g->weights);
}

// False: out of memory. The caller releases the result in either case.
static bool gather(const scene_data *scene, const uint8_t *chosen, bool wanted, gathered *g) {
    const scene_header *h = &scene->header;
    *g = (gathered){0};
    for (size_t i = 0; i < h->part_count; ++i) {
        if ((chosen[i] != 0) == wanted) {
            g->vertices += scene->parts[i].vertex_count;
            g->triangles += scene->parts[i].triangle_count;
            ++g->parts;
        }
    }
    g->names = calloc(g->parts + 1, PC_NAME_SIZE);
    g->positions = calloc(g->vertices + 1, 3 * sizeof(double));
    g->corners = calloc(g->triangles + 1, 3 * sizeof(uint32_t));
    g->triangle_parts = calloc(g->triangles + 1, sizeof(uint32_t));
    g->joints = calloc(g->vertices + 1, 4 * sizeof(uint32_t));
    g->weights = calloc(g->vertices + 1, 4 * sizeof(float));
    if (g->names == NULL || g->positions == NULL || g->corners == NULL ||
        g->triangle_parts == NULL || g->joints == NULL || g->weights == NULL) {
        return false;
    }
    size_t v = 0, t = 0, p = 0;
    for (size_t i = 0; i < h->part_count; ++i) {
        const scene_part *part = &scene->parts[i];
        const size_t first = part->first_vertex, count = part->vertex_count;
        if ((chosen[i] != 0) != wanted) {
            continue;
        }
        part_name(part, &g->names[PC_NAME_SIZE * p]);
        memcpy(&g->positions[3 * v], &scene->positions[3 * first], count * 3 * sizeof(double));
        memcpy(&g->joints[4 * v], &scene->vertex_joints[4 * first], count * 4 * sizeof(uint32_t));
        memcpy(&g->weights[4 * v], &scene->vertex_weights[4 * first], count * 4 * sizeof(float));
        for (size_t k = 0; k < 3 * part->triangle_count; ++k) {
            g->corners[3 * t + k] =
                (uint32_t)(scene->triangles[3 * part->first_triangle + k] - first + v);
            g->triangle_parts[t + k / 3] = (uint32_t)p;
        }
        v += count;
        t += part->triangle_count;
        ++p;
    }
    return true;
}

// Lists the materials of the chosen parts in their order, and numbers them. Returns how many.
static size_t list_materials(const scene_data *scene, const uint8_t *chosen, pc_material *used,
                             uint32_t *numbers) {
    size_t count = 0;
    for (size_t i = 0; i < scene->header.part_count; ++i) {
        if (chosen[i]) {
            numbers[scene->parts[i].material] = 1;
        }
    }
    for (size_t m = 0; m < scene->header.material_count; ++m) {
        if (numbers[m] != 0) {
            used[count] = scene->materials[m];
            numbers[m] = (uint32_t)count++;
        }
    }
    return count;
}

pc_status scene_visual(const scene_data *scene, const uint8_t *chosen, pc_context *context,
                       pc_visual *visual, pc_visual_report *report) {
    const scene_header *h = &scene->header;
    bool has_normals = false, has_texcoords = false, has_colors = false;
    gathered g;
    const bool all = gather(scene, chosen, true, &g);
    float *normals = calloc(g.vertices + 1, 3 * sizeof(float));
    float *texcoords = calloc(g.vertices + 1, 2 * sizeof(float));
    float *colors = calloc(g.vertices + 1, 4 * sizeof(float));
    uint32_t *triangle_materials = calloc(g.triangles + 1, sizeof(uint32_t));
    uint32_t *numbers = calloc(h->material_count + 1, sizeof(uint32_t));
    pc_material *used = calloc(h->material_count + 1, sizeof(pc_material));
    pc_status status = PC_ERROR_OUT_OF_MEMORY;
    if (!all || normals == NULL || texcoords == NULL || colors == NULL ||
        triangle_materials == NULL || numbers == NULL || used == NULL) {
        goto cleanup;
    }
    const size_t materials = list_materials(scene, chosen, used, numbers);
    size_t v = 0, t = 0;
    for (size_t i = 0; i < h->part_count; ++i) {
        const scene_part *part = &scene->parts[i];
        const size_t first = part->first_vertex, count = part->vertex_count;
        if (!chosen[i]) {
            continue;
        }
        has_normals = has_normals || part->has_normals != 0;
        has_texcoords = has_texcoords || part->has_texcoords != 0;
        has_colors = has_colors || part->has_colors != 0;
        memcpy(&normals[3 * v], &scene->normals[3 * first], count * 3 * sizeof(float));
        memcpy(&texcoords[2 * v], &scene->texcoords[2 * first], count * 2 * sizeof(float));
        memcpy(&colors[4 * v], &scene->colors[4 * first], count * 4 * sizeof(float));
        for (size_t k = 0; k < part->triangle_count; ++k) {
            triangle_materials[t++] = numbers[part->material];
        }
        v += count;
    }
    const pc_visual_arrays arrays = {.vertex_count = g.vertices,
                                     .positions = g.positions,
                                     .triangle_count = g.triangles,
                                     .triangles = g.corners,
                                     .normals = has_normals ? normals : NULL,
                                     .texcoords = has_texcoords ? texcoords : NULL,
                                     .colors = has_colors ? colors : NULL,
                                     .triangle_materials = triangle_materials,
                                     .material_count = materials,
                                     .materials = used,
                                     .triangle_parts = g.triangle_parts,
                                     .part_count = g.parts,
                                     .part_names = g.names,
                                     .joints = h->joint_count != 0 ? g.joints : NULL,
                                     .joint_weights = h->joint_count != 0 ? g.weights : NULL};
    status = pc_visual_create(context, &arrays, visual, report);
cleanup:
    release(&g);
    free(normals);
    free(texcoords);
    free(colors);
    free(triangle_materials);
    free(numbers);
    free(used);
    return status;
}

pc_status scene_character(const scene_data *scene, const uint8_t *chosen, pc_context *context,
                          pc_character *character) {
    const scene_header *h = &scene->header;
    gathered g;
    const bool all = gather(scene, chosen, false, &g);
    double *centers = calloc(h->joint_count + 1, 3 * sizeof(double));
    uint32_t *parents = calloc(h->joint_count + 1, sizeof(uint32_t));
    char *joint_names = calloc(h->joint_count + 1, PC_NAME_SIZE);
    char *clip_names = calloc(h->animation_count + 1, PC_NAME_SIZE);
    uint32_t *ranges = calloc(h->animation_count + 1, 2 * sizeof(uint32_t));
    double *rates = calloc(h->animation_count + 1, sizeof(double));
    pc_status status = PC_ERROR_OUT_OF_MEMORY;
    if (!all || centers == NULL || parents == NULL || joint_names == NULL || clip_names == NULL ||
        ranges == NULL || rates == NULL) {
        goto cleanup;
    }
    for (size_t j = 0; j < h->joint_count; ++j) {
        memcpy(&joint_names[PC_NAME_SIZE * j], scene->joints[j].name, PC_NAME_SIZE);
        memcpy(&centers[3 * j], scene->joints[j].center, sizeof(scene->joints[j].center));
        parents[j] = scene->joints[j].parent;
    }
    size_t clips = 0;
    for (size_t i = 0; i < h->animation_count; ++i) {
        const scene_animation *a = &scene->animations[i];
        if (a->pose_count != 0) {
            cli_clean_text(&clip_names[PC_NAME_SIZE * clips], PC_NAME_SIZE, a->name);
            ranges[2 * clips] = (uint32_t)a->first_pose;
            ranges[2 * clips + 1] = (uint32_t)a->pose_count;
            rates[clips++] = a->rate;
        }
    }
    const bool skinned = h->joint_count != 0;
    const pc_character arrays = {.joint_count = h->joint_count,
                                 .joint_names = joint_names,
                                 .joint_centers = centers,
                                 .joint_parents = parents,
                                 .clip_count = clips,
                                 .clip_names = clip_names,
                                 .clip_poses = ranges,
                                 .clip_rates = rates,
                                 .pose_count = h->pose_count,
                                 .poses = scene->poses,
                                 .body = {g.vertices, g.positions, g.triangles, g.corners},
                                 .body_part_count = g.parts,
                                 .body_part_names = g.names,
                                 .body_triangle_parts = g.triangle_parts,
                                 .body_joints = skinned ? g.joints : NULL,
                                 .body_weights = skinned ? g.weights : NULL};
    status = pc_character_create(context, &arrays, character);
cleanup:
    release(&g);
    free(centers);
    free(parents);
    free(joint_names);
    free(clip_names);
    free(ranges);
    free(rates);
    return status;
}
