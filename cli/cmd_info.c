// info: what a mesh, scene or asset file holds.
#include "cli.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "print.h"
#include "scene.h"

// ---- scenes -------------------------------------------------------------------------------------

static void bounds(const scene_data *scene, const scene_part *part, double low[3], double high[3]) {
    for (size_t k = 0; k < 3; ++k) {
        low[k] = INFINITY;
        high[k] = -low[k];
        for (size_t v = 0; v < part->vertex_count; ++v) {
            const double x = scene->positions[3 * (part->first_vertex + v) + k];
            low[k] = fmin(low[k], x);
            high[k] = fmax(high[k], x);
        }
    }
}

// Materials that a chosen part uses; importers invent some that none does.
static bool material_used(const scene_data *scene, const uint8_t *chosen, size_t material) {
    for (size_t i = 0; i < scene->header.part_count; ++i) {
        if (chosen[i] && scene->parts[i].material == material) {
            return true;
        }
    }
    return false;
}

enum { name_columns = 3 };

static const char *part_name(const scene_data *scene, const scene_part *part, size_t column) {
    return column == 0   ? part->node
           : column == 1 ? part->mesh
                         : scene->materials[part->material].name;
}

// Characters, not bytes, so that columns of UTF-8 names line up.
static int text_width(const char *text) {
    int width = 0;
    for (; *text != '\0'; ++text) {
        width += ((unsigned char)*text & 0xc0) != 0x80;
    }
    return width;
}

static void print_name(const char *name, int width) {
    printf("\"%s\"%*s", name, width - text_width(name) + 2, "");
}

static void print_data(const scene_part *part) {
    const char *names[3], *separator = "";
    size_t count = 0;
    if (part->has_normals) {
        names[count++] = "normals";
    }
    if (part->has_texcoords) {
        names[count++] = "texcoords";
    }
    if (part->has_colors) {
        names[count++] = "colors";
    }
    for (size_t i = 0; i < count; ++i) {
        printf("%s%s", separator, names[i]);
        separator = ", ";
    }
    if (part->bone_count != 0) {
        printf("%s%u bones", separator, part->bone_count);
    }
    putchar('\n');
}

static void print_parts(const scene_data *scene, const uint8_t *chosen) {
    static const char *const titles[name_columns] = {"node", "mesh", "material"};
    int widths[name_columns];
    for (size_t k = 0; k < name_columns; ++k) {
        widths[k] = text_width(titles[k]);
        for (size_t i = 0; i < scene->header.part_count; ++i) {
            const int width = text_width(part_name(scene, &scene->parts[i], k));
            widths[k] = chosen[i] && width > widths[k] ? width : widths[k];
        }
    }
    printf("\nparts (--mesh takes the name of a node, mesh or material)\n  ");
    for (size_t k = 0; k < name_columns; ++k) {
        printf("%-*s  ", widths[k] + 2, titles[k]);
    }
    printf("%9s %9s  %-26s  data\n", "vertices", "triangles", "size");
    for (size_t i = 0; i < scene->header.part_count; ++i) {
        const scene_part *part = &scene->parts[i];
        double low[3], high[3];
        char size[64];
        if (!chosen[i]) {
            continue;
        }
        bounds(scene, part, low, high);
        printf("  ");
        for (size_t k = 0; k < name_columns; ++k) {
            print_name(part_name(scene, part, k), widths[k]);
        }
        snprintf(size, sizeof(size), "%.4g x %.4g x %.4g", high[0] - low[0], high[1] - low[1],
                 high[2] - low[2]);
        printf("%9llu %9llu  %-26s  ", (unsigned long long)part->vertex_count,
               (unsigned long long)part->triangle_count, size);
        print_data(part);
    }
}

static void print_totals(const scene_data *scene, const uint8_t *chosen) {
    const scene_header *h = &scene->header;
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    unsigned long long parts = 0, vertices = 0, triangles = 0;
    for (size_t i = 0; i < h->part_count; ++i) {
        double part_low[3], part_high[3];
        if (!chosen[i]) {
            continue;
        }
        bounds(scene, &scene->parts[i], part_low, part_high);
        for (size_t k = 0; k < 3; ++k) {
            low[k] = fmin(low[k], part_low[k]);
            high[k] = fmax(high[k], part_high[k]);
        }
        ++parts;
        vertices += scene->parts[i].vertex_count;
        triangles += scene->parts[i].triangle_count;
    }
    printf("format     %s\nnodes      %llu\nparts      %llu\nvertices   %llu\ntriangles  %llu\n",
           h->format, (unsigned long long)h->node_count, parts, vertices, triangles);
    if (vertices != 0) {
        printf("size       %.4g x %.4g x %.4g\nfrom       (%.4g, %.4g, %.4g)\n"
               "to         (%.4g, %.4g, %.4g)\n",
               high[0] - low[0], high[1] - low[1], high[2] - low[2], low[0], low[1], low[2],
               high[0], high[1], high[2]);
    }
}

static void print_scene(const scene_data *scene, const uint8_t *chosen) {
    const scene_header *h = &scene->header;
    print_totals(scene, chosen);
    print_parts(scene, chosen);
    int width = 0;
    for (size_t i = 0; i < h->material_count; ++i) {
        const int length = text_width(scene->materials[i].name);
        width = material_used(scene, chosen, i) && length > width ? length : width;
    }
    printf("\nmaterials\n");
    for (size_t i = 0; i < h->material_count; ++i) {
        const pc_material *material = &scene->materials[i];
        const float *c = material->base_color;
        if (material_used(scene, chosen, i)) {
            printf("  ");
            print_name(material->name, width);
            printf("color (%.3g, %.3g, %.3g, %.3g)%s\n", (double)c[0], (double)c[1], (double)c[2],
                   (double)c[3], material->double_sided ? ", two-sided" : "");
        }
    }
    width = 0;
    for (size_t i = 0; i < h->animation_count; ++i) {
        const int length = text_width(scene->animations[i].name);
        width = length > width ? length : width;
    }
    printf("%s", h->animation_count != 0 ? "\nanimations\n" : "");
    for (size_t i = 0; i < h->animation_count; ++i) {
        printf("  ");
        print_name(scene->animations[i].name, width);
        printf("%.3g s, %llu channels\n", scene->animations[i].seconds,
               (unsigned long long)scene->animations[i].channels);
    }
}

static void json_vector(cJSON *object, const char *name, const double *values, size_t count) {
    cJSON *array = json_array(object, name);
    for (size_t i = 0; i < count; ++i) {
        cJSON_AddItemToArray(array, isfinite(values[i]) ? cJSON_CreateNumber(values[i])
                                                        : cJSON_CreateNull());
    }
}

static cJSON *json_element(cJSON *array) {
    cJSON *object = cJSON_CreateObject();
    cJSON_AddItemToArray(array, object);
    return object;
}

static cJSON *scene_json(const scene_data *scene, const uint8_t *chosen, const char *problem) {
    const scene_header *h = &scene->header;
    cJSON *root = cJSON_CreateObject();
    json_text(root, "kind", "scene");
    json_text(root, "format", h->format);
    if (problem != NULL) {
        json_text(root, "problem", problem);
    }
    json_number(root, "nodes", (double)h->node_count);
    double vertices = 0.0, triangles = 0.0; // of the chosen parts, as in the text
    for (size_t i = 0; i < h->part_count; ++i) {
        vertices += chosen[i] ? (double)scene->parts[i].vertex_count : 0.0;
        triangles += chosen[i] ? (double)scene->parts[i].triangle_count : 0.0;
    }
    json_number(root, "vertices", vertices);
    json_number(root, "triangles", triangles);
    cJSON *array = json_array(root, "parts");
    for (size_t i = 0; i < h->part_count; ++i) {
        const scene_part *part = &scene->parts[i];
        double low[3], high[3];
        if (!chosen[i]) {
            continue;
        }
        bounds(scene, part, low, high);
        cJSON *object = json_element(array);
        json_text(object, "node", part->node);
        json_text(object, "mesh", part->mesh);
        json_text(object, "material", scene->materials[part->material].name);
        json_number(object, "vertices", (double)part->vertex_count);
        json_number(object, "triangles", (double)part->triangle_count);
        json_number(object, "bones", part->bone_count);
        cJSON_AddItemToObject(object, "normals", cJSON_CreateBool(part->has_normals != 0));
        cJSON_AddItemToObject(object, "texcoords", cJSON_CreateBool(part->has_texcoords != 0));
        cJSON_AddItemToObject(object, "colors", cJSON_CreateBool(part->has_colors != 0));
        json_vector(object, "minimum", low, 3);
        json_vector(object, "maximum", high, 3);
    }
    array = json_array(root, "materials");
    for (size_t i = 0; i < h->material_count; ++i) {
        const pc_material *material = &scene->materials[i];
        if (!material_used(scene, chosen, i)) {
            continue;
        }
        cJSON *object = json_element(array);
        json_text(object, "name", material->name);
        double color[4];
        for (size_t k = 0; k < 4; ++k) {
            color[k] = (double)material->base_color[k];
        }
        json_vector(object, "base_color", color, 4);
        json_number(object, "metallic", (double)material->metallic);
        json_number(object, "roughness", (double)material->roughness);
        cJSON_AddItemToObject(object, "double_sided", cJSON_CreateBool(material->double_sided));
    }
    array = json_array(root, "animations");
    for (size_t i = 0; i < h->animation_count; ++i) {
        cJSON *object = json_element(array);
        json_text(object, "name", scene->animations[i].name);
        json_number(object, "seconds", scene->animations[i].seconds);
        json_number(object, "channels", (double)scene->animations[i].channels);
    }
    return root;
}

// What stops the chosen parts from becoming a garment is part of the answer.
static int info_scene(const cli_command *command, const cli_arguments *arguments) {
    const char *path = arguments->inputs[0];
    scene_data scene = {0};
    uint8_t *chosen = NULL;
    pc_context *context = NULL;
    pc_visual visual = {0};
    int code = scene_import_selected(command, arguments, path, &scene, &chosen);
    if (code == CLI_OK) {
        code = cli_context(command, arguments, &context);
    }
    if (code == CLI_OK) {
        const pc_status status = scene_visual(&scene, chosen, context, &visual, NULL);
        const char *problem =
            status == PC_ERROR_INVALID_MESH ? pc_context_error(context)->message : NULL;
        if (status != PC_OK && problem == NULL) {
            code = cli_fail_status(command->name, context, status, path, false);
        } else if (arguments->settings.json) {
            code = json_print(command->name, scene_json(&scene, chosen, problem));
        } else {
            print_scene(&scene, chosen);
        }
        if (problem != NULL) {
            cli_warn(command->name, "%s: %s", path, problem);
        }
    }
    free(chosen);
    scene_free(&scene);
    pc_visual_free(context, &visual);
    pc_context_destroy(context);
    return code;
}

// ---- assets -------------------------------------------------------------------------------------

typedef struct count_row {
    const char *name;
    double value;
} count_row;

enum { count_rows = 15 };

static void asset_counts(const pc_asset *asset, count_row rows[count_rows]) {
    const count_row all[count_rows] = {
        {"visual_vertices", (double)asset->visual.surface.vertex_count},
        {"visual_triangles", (double)asset->visual.surface.triangle_count},
        {"visual_corners", (double)asset->visual.corner_count},
        {"materials", (double)asset->visual.material_count},
        {"grid_samples", (double)asset->grid.sample_count},
        {"isosurface_vertices", (double)asset->isosurface.vertex_count},
        {"isosurface_triangles", (double)asset->isosurface.triangle_count},
        {"projected_vertices", (double)asset->projected.vertex_count},
        {"graph_edges", (double)asset->graph.edge_count},
        {"single_layer_vertices", (double)asset->single_layer.vertex_count},
        {"single_layer_triangles", (double)asset->single_layer.triangle_count},
        {"proxy_vertices", (double)asset->proxy.vertex_count},
        {"proxy_triangles", (double)asset->proxy.triangle_count},
        {"frames", (double)asset->motion.frame_count},
        {"influences", (double)asset->skin.influences},
    };
    memcpy(rows, all, sizeof(all));
}

static void print_asset(const pc_asset *asset) {
    count_row rows[count_rows];
    asset_counts(asset, rows);
    printf("format     proxycloth asset\nname       %s\nstages     %u of %d", asset->name,
           asset->stage_count, PC_STAGE_COUNT);
    if (asset->stage_count < PC_STAGE_COUNT) {
        printf(", next: %s", pc_stage_describe((pc_stage)asset->stage_count)->name);
    }
    printf("\n\ncontents\n");
    for (size_t i = 0; i < count_rows; ++i) {
        printf("  %-28s %.0f\n", rows[i].name, rows[i].value);
    }
    printf("\nvisual mesh\n");
    print_record(&pc_visual_report_record, &asset->reports.visual, "  ");
    for (pc_stage stage = 0; stage < (pc_stage)asset->stage_count; ++stage) {
        const pc_stage_info *info = pc_stage_describe(stage);
        printf("\n%s: %s\n", info->name, info->summary);
        printf(" options\n");
        print_record(info->options, (const char *)&asset->options + info->options_offset, "  ");
        printf(" report\n");
        print_record(info->report, (const char *)&asset->reports + info->report_offset, "  ");
    }
}

static cJSON *asset_json(const pc_asset *asset) {
    count_row rows[count_rows];
    asset_counts(asset, rows);
    cJSON *root = cJSON_CreateObject();
    json_text(root, "kind", "asset");
    json_text(root, "name", asset->name);
    cJSON *object = json_object(root, "counts");
    for (size_t i = 0; i < count_rows; ++i) {
        json_number(object, rows[i].name, rows[i].value);
    }
    json_record(json_object(root, "visual"), &pc_visual_report_record, &asset->reports.visual);
    cJSON *stages = json_array(root, "stages");
    for (pc_stage stage = 0; stage < (pc_stage)asset->stage_count; ++stage) {
        const pc_stage_info *info = pc_stage_describe(stage);
        object = json_element(stages);
        json_text(object, "name", info->name);
        json_record(json_object(object, "options"), info->options,
                    (const char *)&asset->options + info->options_offset);
        json_record(json_object(object, "report"), info->report,
                    (const char *)&asset->reports + info->report_offset);
    }
    return root;
}

static int info_asset(const cli_command *command, const cli_arguments *arguments) {
    pc_context *context = NULL;
    pc_asset asset;
    memset(&asset, 0, sizeof(asset));
    int code = cli_context(command, arguments, &context);
    if (code != CLI_OK) {
        return code;
    }
    code = cli_load_asset(command, context, arguments->inputs[0], &asset);
    if (code == CLI_OK && arguments->settings.json) {
        code = json_print(command->name, asset_json(&asset));
    } else if (code == CLI_OK) {
        print_asset(&asset);
    }
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
    return code;
}

int cli_run_info(const cli_command *command, cli_arguments *arguments) {
    cli_catch_signals();
    cli_kind kind;
    int code = cli_input_kind(command->name, arguments->inputs[0], &kind);
    if (code != CLI_OK) {
        return code;
    }
    return kind == CLI_KIND_ASSET ? info_asset(command, arguments) : info_scene(command, arguments);
}
