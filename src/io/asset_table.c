#include "io/asset_table.h"

#include <stdarg.h>
#include <stdio.h>

const char *pci_group_name(int group) {
    return group == 0 ? "visual" : pc_stage_describe((pc_stage)(group - 1))->name;
}

// ---- counts -----------------------------------------------------------------------------------

static const size_t count_offsets[PCI_COUNT_COUNT] = {
    [PCI_COUNT_SURFACE_VERTICES] = offsetof(pc_asset, visual.surface.vertex_count),
    [PCI_COUNT_SURFACE_TRIANGLES] = offsetof(pc_asset, visual.surface.triangle_count),
    [PCI_COUNT_CORNERS] = offsetof(pc_asset, visual.corner_count),
    [PCI_COUNT_MATERIALS] = offsetof(pc_asset, visual.material_count),
    [PCI_COUNT_PARTS] = offsetof(pc_asset, visual.part_count),
    [PCI_COUNT_JOINTS] = offsetof(pc_asset, character.joint_count),
    [PCI_COUNT_CLIPS] = offsetof(pc_asset, character.clip_count),
    [PCI_COUNT_POSES] = offsetof(pc_asset, character.pose_count),
    [PCI_COUNT_BODY_VERTICES] = offsetof(pc_asset, character.body.vertex_count),
    [PCI_COUNT_BODY_TRIANGLES] = offsetof(pc_asset, character.body.triangle_count),
    [PCI_COUNT_BODY_PARTS] = offsetof(pc_asset, character.body_part_count),
    [PCI_COUNT_SAMPLES] = offsetof(pc_asset, grid.sample_count),
    [PCI_COUNT_ISOSURFACE_VERTICES] = offsetof(pc_asset, isosurface.vertex_count),
    [PCI_COUNT_ISOSURFACE_TRIANGLES] = offsetof(pc_asset, isosurface.triangle_count),
    [PCI_COUNT_PROJECTED_VERTICES] = offsetof(pc_asset, projected.vertex_count),
    [PCI_COUNT_PROJECTED_TRIANGLES] = offsetof(pc_asset, projected.triangle_count),
    [PCI_COUNT_GRAPH_VERTICES] = offsetof(pc_asset, graph.vertex_count),
    [PCI_COUNT_EDGES] = offsetof(pc_asset, graph.edge_count),
    [PCI_COUNT_OPPOSITES] = offsetof(pc_asset, graph.opposite_count),
    [PCI_COUNT_LABELS] = offsetof(pc_asset, labels.vertex_count),
    [PCI_COUNT_LAYER_VERTICES] = offsetof(pc_asset, single_layer.vertex_count),
    [PCI_COUNT_LAYER_TRIANGLES] = offsetof(pc_asset, single_layer.triangle_count),
    [PCI_COUNT_PROXY_VERTICES] = offsetof(pc_asset, proxy.vertex_count),
    [PCI_COUNT_PROXY_TRIANGLES] = offsetof(pc_asset, proxy.triangle_count),
    [PCI_COUNT_FRAMES] = offsetof(pc_asset, motion.frame_count),
    [PCI_COUNT_MOTION_VERTICES] = offsetof(pc_asset, motion.vertex_count),
    [PCI_COUNT_SKIN_VERTICES] = offsetof(pc_asset, skin.vertex_count),
};

size_t pci_count_get(const pc_asset *asset, pci_count count) {
    if (count == PCI_COUNT_INFLUENCES) {
        return asset->skin.influences;
    }
    size_t value;
    memcpy(&value, (const char *)asset + count_offsets[count], sizeof(value));
    return value;
}

void pci_count_set(pc_asset *asset, pci_count count, size_t value) {
    if (count == PCI_COUNT_INFLUENCES) {
        asset->skin.influences = (uint32_t)value;
    } else {
        memcpy((char *)asset + count_offsets[count], &value, sizeof(value));
    }
}

// ---- arrays -----------------------------------------------------------------------------------

#define GROUP(stage) (PC_STAGE_##stage + 1)
#define AT(member)   offsetof(pc_asset, member)
#define COUNT(name)  PCI_COUNT_##name
#define ARRAY(group_, name_, element_, rows_, tuple_, member_, ...)                                \
    {                                                                                              \
        .group = (group_), .name = (name_), .element = PCI_ELEMENT_##element_,                     \
        .rows = COUNT(rows_), .tuple = (tuple_), .offset = AT(member_), __VA_ARGS__                \
    }
#define FINITE       .values = PCI_VALUES_FINITE
#define INDEX(count) .values = PCI_VALUES_INDEX, .limit = COUNT(count)
#define NAMES(name_, rows_, member_)                                                               \
    ARRAY(0, name_, U8, rows_, PC_NAME_SIZE, member_, .values = PCI_VALUES_NAME, .optional = true)
#define OPTIONAL .optional = true
#define MESH(group_, member_, name_)                                                               \
    ARRAY(group_, "positions", F64, name_##_VERTICES, 3, member_.positions, FINITE),               \
        ARRAY(group_, "triangles", U32, name_##_TRIANGLES, 3, member_.triangles,                   \
              INDEX(name_##_VERTICES))

const pci_array_info pci_arrays[] = {
    MESH(0, visual.surface, SURFACE),
    ARRAY(0, "corner_vertices", U32, CORNERS, 1, visual.corner_vertices, INDEX(SURFACE_VERTICES)),
    ARRAY(0, "corner_triangles", U32, SURFACE_TRIANGLES, 3, visual.corner_triangles,
          INDEX(CORNERS)),
    ARRAY(0, "normals", F32, CORNERS, 3, visual.normals, FINITE, .optional = true),
    ARRAY(0, "texcoords", F32, CORNERS, 2, visual.texcoords, FINITE, .optional = true),
    ARRAY(0, "colors", F32, CORNERS, 4, visual.colors, FINITE, .optional = true),
    ARRAY(0, "triangle_materials", U32, SURFACE_TRIANGLES, 1, visual.triangle_materials,
          INDEX(MATERIALS)),
    NAMES("part_names", PARTS, visual.part_names),
    ARRAY(0, "triangle_parts", U32, SURFACE_TRIANGLES, 1, visual.triangle_parts, INDEX(PARTS),
          OPTIONAL),
    NAMES("joint_names", JOINTS, character.joint_names),
    ARRAY(0, "joint_centers", F64, JOINTS, 3, character.joint_centers, FINITE, OPTIONAL),
    ARRAY(0, "joint_parents", U32, JOINTS, 1, character.joint_parents, .values = PCI_VALUES_ANY,
          OPTIONAL),
    ARRAY(0, "joints", U32, CORNERS, 4, visual.joints, INDEX(JOINTS), OPTIONAL),
    ARRAY(0, "joint_weights", F32, CORNERS, 4, visual.joint_weights, .values = PCI_VALUES_SHARE,
          OPTIONAL),
    NAMES("clip_names", CLIPS, character.clip_names),
    ARRAY(0, "clip_poses", U32, CLIPS, 2, character.clip_poses, .values = PCI_VALUES_ANY, OPTIONAL),
    ARRAY(0, "clip_rates", F64, CLIPS, 1, character.clip_rates, FINITE, OPTIONAL),
    ARRAY(0, "poses", F32, POSES, 12, character.poses, FINITE, .columns = PCI_COUNT_JOINTS,
          OPTIONAL),
    ARRAY(0, "body_positions", F64, BODY_VERTICES, 3, character.body.positions, FINITE, OPTIONAL),
    ARRAY(0, "body_triangles", U32, BODY_TRIANGLES, 3, character.body.triangles,
          INDEX(BODY_VERTICES), OPTIONAL),
    NAMES("body_part_names", BODY_PARTS, character.body_part_names),
    ARRAY(0, "body_triangle_parts", U32, BODY_TRIANGLES, 1, character.body_triangle_parts,
          INDEX(BODY_PARTS), OPTIONAL),
    ARRAY(0, "body_joints", U32, BODY_VERTICES, 4, character.body_joints, INDEX(JOINTS), OPTIONAL),
    ARRAY(0, "body_weights", F32, BODY_VERTICES, 4, character.body_weights,
          .values = PCI_VALUES_SHARE, OPTIONAL),

    ARRAY(GROUP(VOXELIZE), "samples", U64, SAMPLES, 1, grid.samples, .values = PCI_VALUES_ANY),
    ARRAY(GROUP(VOXELIZE), "values", F32, SAMPLES, 1, grid.values, FINITE),

    MESH(GROUP(ISOSURFACE), isosurface, ISOSURFACE),
    MESH(GROUP(PROJECT), projected, PROJECTED),

    ARRAY(GROUP(GRAPH), "curvatures", F64, GRAPH_VERTICES, 1, graph.curvatures, FINITE,
          .optional = true),
    ARRAY(GROUP(GRAPH), "outer_distances", F64, GRAPH_VERTICES, 1, graph.outer_distances,
          .values = PCI_VALUES_NOT_NAN, .optional = true),
    ARRAY(GROUP(GRAPH), "edges", U32, EDGES, 2, graph.edges, INDEX(GRAPH_VERTICES)),
    ARRAY(GROUP(GRAPH), "edge_weights", F64, EDGES, 1, graph.edge_weights, FINITE),
    ARRAY(GROUP(GRAPH), "opposites", U32, OPPOSITES, 2, graph.opposites, INDEX(GRAPH_VERTICES)),
    ARRAY(GROUP(GRAPH), "opposite_signs", I8, OPPOSITES, 1, graph.opposite_signs,
          .values = PCI_VALUES_SIGN),

    ARRAY(GROUP(LABEL), "labels", U8, LABELS, 1, labels.labels, .values = PCI_VALUES_FLAG),

    MESH(GROUP(CARVE), single_layer, LAYER),
    MESH(GROUP(SIMPLIFY), proxy, PROXY),

    ARRAY(GROUP(SIMULATE), "positions", F64, FRAMES, 3, motion.positions, FINITE,
          .columns = PCI_COUNT_MOTION_VERTICES),
    ARRAY(GROUP(SIMULATE), "pinned", U8, MOTION_VERTICES, 1, motion.pinned,
          .values = PCI_VALUES_FLAG),

    ARRAY(GROUP(SKIN), "bones", U32, SKIN_VERTICES, 1, skin.bones, INDEX(PROXY_VERTICES),
          .columns = PCI_COUNT_INFLUENCES),
    ARRAY(GROUP(SKIN), "weights", F64, SKIN_VERTICES, 1, skin.weights, FINITE,
          .columns = PCI_COUNT_INFLUENCES),
};
const size_t pci_array_count = sizeof(pci_arrays) / sizeof(pci_arrays[0]);

const pci_scalar_info pci_scalars[] = {
    {GROUP(VOXELIZE), "origin", PCI_ELEMENT_F64, 3, AT(grid.origin), false},
    {GROUP(VOXELIZE), "cell_size", PCI_ELEMENT_F64, 1, AT(grid.cell_size), false},
    {GROUP(VOXELIZE), "size", PCI_ELEMENT_U32, 3, AT(grid.size), false},
    {GROUP(VOXELIZE), "band", PCI_ELEMENT_F64, 1, AT(grid.band), false},
    {GROUP(SIMULATE), "frame_time", PCI_ELEMENT_F64, 1, AT(motion.frame_time), false},
    {GROUP(SKIN), "skinning", PCI_ELEMENT_U32, 1, AT(skin.skinning), true},
};
const size_t pci_scalar_count = sizeof(pci_scalars) / sizeof(pci_scalars[0]);

void *pci_array_get(const pc_asset *asset, const pci_array_info *info) {
    void *array;
    memcpy(&array, (const char *)asset + info->offset, sizeof(array));
    return array;
}

void pci_array_set(pc_asset *asset, const pci_array_info *info, void *array) {
    memcpy((char *)asset + info->offset, &array, sizeof(array));
}

size_t pci_array_shape(const pc_asset *asset, const pci_array_info *info, size_t shape[3]) {
    size_t rank = 0;
    shape[rank++] = pci_count_get(asset, info->rows);
    if (info->columns != PCI_COUNT_NONE) {
        shape[rank++] = pci_count_get(asset, info->columns);
    }
    if (info->tuple != 1) {
        shape[rank++] = info->tuple;
    }
    return rank;
}

// ---- checks -----------------------------------------------------------------------------------

__attribute__((format(printf, 3, 4))) static bool report(char *problem, size_t problem_size,
                                                         const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(problem, problem_size, format, arguments);
    va_end(arguments);
    return false;
}

// Index of the first value that is not allowed, or `count`.
static size_t find_bad_value(const pci_array_info *info, const void *array, size_t count,
                             size_t limit) {
    size_t i = 0;
    switch (info->values) {
    case PCI_VALUES_FINITE:
        if (info->element == PCI_ELEMENT_F64) {
            const double *values = array;
            for (; i < count && isfinite(values[i]); ++i) {
            }
        } else {
            const float *values = array;
            for (; i < count && isfinite(values[i]); ++i) {
            }
        }
        return i;
    case PCI_VALUES_NOT_NAN: {
        const double *values = array;
        for (; i < count && !isnan(values[i]); ++i) {
        }
        return i;
    }
    case PCI_VALUES_INDEX: {
        const uint32_t *values = array;
        for (; i < count && values[i] < limit; ++i) {
        }
        return i;
    }
    case PCI_VALUES_FLAG: {
        const uint8_t *values = array;
        for (; i < count && values[i] <= 1; ++i) {
        }
        return i;
    }
    case PCI_VALUES_SIGN: {
        const int8_t *values = array;
        for (; i < count && values[i] >= -1 && values[i] <= 1; ++i) {
        }
        return i;
    }
    case PCI_VALUES_SHARE: {
        const float *values = array;
        for (; i < count && values[i] >= 0.0F && values[i] <= 1.0F; ++i) {
        }
        return i;
    }
    case PCI_VALUES_NAME: {
        const char *values = array;
        for (; i < count && memchr(values + i, '\0', PC_NAME_SIZE) != NULL; i += PC_NAME_SIZE) {
        }
        return i;
    }
    case PCI_VALUES_ANY:
        break;
    }
    return count;
}

static bool check_array(const pc_asset *asset, const pci_array_info *info, char *problem,
                        size_t problem_size) {
    const char *group = pci_group_name(info->group);
    const void *array = pci_array_get(asset, info);
    size_t shape[3];
    const size_t rank = pci_array_shape(asset, info, shape);
    size_t count = 1;
    for (size_t k = 0; k < rank; ++k) {
        if (shape[k] > INT32_MAX || count > SIZE_MAX / 8 / (shape[k] + 1)) {
            return report(problem, problem_size, "/%s/%s has too many elements", group, info->name);
        }
        count *= shape[k];
    }
    if (array == NULL) {
        return info->optional || count == 0 ||
               report(problem, problem_size, "/%s/%s is missing", group, info->name);
    }
    const size_t bad = find_bad_value(info, array, count,
                                      info->limit != 0 ? pci_count_get(asset, info->limit) : 0);
    return bad == count || report(problem, problem_size, "value %zu of /%s/%s is out of range", bad,
                                  group, info->name);
}

static bool check_visual(const pc_visual *visual, char *problem, size_t problem_size) {
    for (size_t i = 0; i < 3 * visual->surface.triangle_count; ++i) {
        if (visual->corner_vertices[visual->corner_triangles[i]] != visual->surface.triangles[i]) {
            return report(problem, problem_size,
                          "corner %zu of /visual/corner_triangles belongs to another vertex", i);
        }
    }
    for (size_t i = 0; i < visual->material_count; ++i) {
        const pc_material *material = &visual->materials[i];
        bool good = memchr(material->name, '\0', sizeof(material->name)) != NULL &&
                    isfinite(material->metallic) && isfinite(material->roughness);
        for (size_t k = 0; k < 4; ++k) {
            good = good && isfinite(material->base_color[k]);
        }
        if (!good) {
            return report(problem, problem_size, "value %zu of /visual/materials is out of range",
                          i);
        }
    }
    return true;
}

// Clips lie within the poses, and arrays that need each other are all there.
static bool check_character(const pc_asset *asset, char *problem, size_t problem_size) {
    const pc_character *c = &asset->character;
    const pc_visual *visual = &asset->visual;
    if ((c->joint_count != 0 && (c->joint_names == NULL || c->joint_centers == NULL)) ||
        (c->clip_count != 0 &&
         (c->clip_names == NULL || c->clip_poses == NULL || c->clip_rates == NULL)) ||
        (c->pose_count != 0 && c->poses == NULL) ||
        (c->body.triangle_count != 0 &&
         (c->body.positions == NULL || c->body.triangles == NULL ||
          c->body_triangle_parts == NULL || c->body_part_names == NULL)) ||
        (c->body_joints == NULL) != (c->body_weights == NULL) ||
        (visual->joints == NULL) != (visual->joint_weights == NULL) ||
        (visual->triangle_parts != NULL && visual->part_names == NULL)) {
        return report(problem, problem_size, "an array of joints, clips or parts is missing");
    }
    for (size_t j = 0; c->joint_parents != NULL && j < c->joint_count; ++j) {
        if (c->joint_parents[j] >= j && c->joint_parents[j] != PC_INVALID_INDEX) {
            return report(problem, problem_size, "joint %zu of /visual hangs on a later one", j);
        }
    }
    for (size_t i = 0; i < c->clip_count; ++i) {
        const uint32_t *range = &c->clip_poses[2 * i];
        if (range[1] == 0 || range[0] > c->pose_count || range[1] > c->pose_count - range[0] ||
            !(c->clip_rates[i] > 0.0)) {
            return report(problem, problem_size, "clip %zu of /visual is out of range", i);
        }
    }
    return true;
}

static bool check_grid(const pc_grid *grid, char *problem, size_t problem_size) {
    const uint32_t largest = 1u << 20;
    bool good = grid->cell_size > 0.0 && isfinite(grid->cell_size) && grid->band >= 0.0 &&
                isfinite(grid->band);
    for (size_t k = 0; k < 3; ++k) {
        good = good && isfinite(grid->origin[k]) && grid->size[k] <= largest;
    }
    if (!good) {
        return report(problem, problem_size, "the lattice of /voxelize is out of range");
    }
    const uint64_t points = (uint64_t)grid->size[0] * grid->size[1] * grid->size[2];
    for (size_t i = 0; i < grid->sample_count; ++i) {
        if (grid->samples[i] >= points || (i > 0 && grid->samples[i] <= grid->samples[i - 1])) {
            return report(problem, problem_size, "value %zu of /voxelize/samples is out of range",
                          i);
        }
    }
    return true;
}

// Pairs are ordered within and among each other.
static bool check_pairs(const uint32_t *pairs, size_t count, const char *name, char *problem,
                        size_t problem_size) {
    for (size_t i = 0; i < count; ++i) {
        const uint32_t *pair = &pairs[2 * i];
        bool good = pair[0] < pair[1];
        if (i > 0) {
            good = good && (pair[-2] < pair[0] || (pair[-2] == pair[0] && pair[-1] < pair[1]));
        }
        if (!good) {
            return report(problem, problem_size, "pair %zu of /graph/%s is out of order", i, name);
        }
    }
    return true;
}

static bool check_weights(const pc_skin *skin, char *problem, size_t problem_size) {
    if (skin->skinning > PC_SKINNING_ROTATION) {
        return report(problem, problem_size, "/skin has an unknown kind of skinning");
    }
    for (size_t v = 0; v < skin->vertex_count; ++v) {
        double sum = 0.0;
        bool good = true;
        for (size_t k = 0; k < skin->influences; ++k) {
            const double weight = skin->weights[v * skin->influences + k];
            good = good && weight >= 0.0;
            sum += weight;
        }
        if (!good || fabs(sum - 1.0) > 1e-6) {
            return report(problem, problem_size,
                          "the weights of vertex %zu in /skin are negative or do not sum to 1", v);
        }
    }
    return true;
}

// Results of one stage have the counts of the results they come from.
static bool check_counts(const pc_asset *asset, char *problem, size_t problem_size) {
    static const struct {
        pc_stage stage;
        pci_count count, source;
        const char *text;
    } rows[] = {
        {PC_STAGE_PROJECT, PCI_COUNT_PROJECTED_VERTICES, PCI_COUNT_ISOSURFACE_VERTICES,
         "/project and /isosurface differ in vertices"},
        {PC_STAGE_PROJECT, PCI_COUNT_PROJECTED_TRIANGLES, PCI_COUNT_ISOSURFACE_TRIANGLES,
         "/project and /isosurface differ in triangles"},
        {PC_STAGE_GRAPH, PCI_COUNT_GRAPH_VERTICES, PCI_COUNT_PROJECTED_VERTICES,
         "/graph and /project differ in vertices"},
        {PC_STAGE_LABEL, PCI_COUNT_LABELS, PCI_COUNT_GRAPH_VERTICES,
         "/label and /graph differ in vertices"},
        {PC_STAGE_SIMULATE, PCI_COUNT_MOTION_VERTICES, PCI_COUNT_PROXY_VERTICES,
         "/simulate and /simplify differ in vertices"},
        {PC_STAGE_SKIN, PCI_COUNT_SKIN_VERTICES, PCI_COUNT_SURFACE_VERTICES,
         "/skin and /visual differ in vertices"},
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); ++i) {
        if (asset->stage_count > (uint32_t)rows[i].stage &&
            pci_count_get(asset, rows[i].count) != pci_count_get(asset, rows[i].source)) {
            return report(problem, problem_size, "%s", rows[i].text);
        }
    }
    return true;
}

bool pci_asset_check(const pc_asset *asset, char *problem, size_t problem_size) {
    if (asset->stage_count > PC_STAGE_COUNT) {
        return report(problem, problem_size, "there is no stage %u", asset->stage_count);
    }
    if (memchr(asset->name, '\0', sizeof(asset->name)) == NULL) {
        return report(problem, problem_size, "the name does not end");
    }
    const pc_visual *visual = &asset->visual;
    if (visual->surface.triangle_count == 0) {
        return report(problem, problem_size, "there is no visual mesh");
    }
    if (visual->material_count == 0 || visual->material_count > INT32_MAX ||
        visual->materials == NULL) {
        return report(problem, problem_size, "/visual/materials is missing");
    }
    for (size_t i = 0; i < pci_array_count; ++i) {
        if ((uint32_t)pci_arrays[i].group <= asset->stage_count &&
            !check_array(asset, &pci_arrays[i], problem, problem_size)) {
            return false;
        }
    }
    const pc_graph *graph = &asset->graph;
    const uint32_t done = asset->stage_count;
    if (!check_visual(visual, problem, problem_size) ||
        !check_character(asset, problem, problem_size) ||
        !check_counts(asset, problem, problem_size) ||
        (done > PC_STAGE_VOXELIZE && !check_grid(&asset->grid, problem, problem_size)) ||
        (done > PC_STAGE_GRAPH &&
         (!check_pairs(graph->edges, graph->edge_count, "edges", problem, problem_size) ||
          !check_pairs(graph->opposites, graph->opposite_count, "opposites", problem,
                       problem_size))) ||
        (done > PC_STAGE_SKIN && !check_weights(&asset->skin, problem, problem_size))) {
        return false;
    }
    if (done > PC_STAGE_SIMULATE &&
        !(asset->motion.frame_time > 0.0 && isfinite(asset->motion.frame_time))) {
        return report(problem, problem_size, "the frame time of /simulate is out of range");
    }
    return true;
}
