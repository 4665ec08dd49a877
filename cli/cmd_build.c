// build: garment mesh -> all results. export: asset file -> the other results.
#include "cli.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "scene.h"

typedef enum result_file {
    FILE_GLB,
    FILE_PROXY,
    FILE_ASSET,
    FILE_REPORT,
    FILE_SHEET,
    FILE_STRIP,
    FILE_COUNT
} result_file;

static const char *const extensions[FILE_COUNT] = {".glb",  ".proxy.obj", ".h5",
                                                   ".json", ".png",       ".strip.png"};

static pc_status write_file(pc_context *context, result_file file, const pc_asset *asset,
                            const pc_timings *timings, const pc_measures *measures,
                            const char *path) {
    switch (file) {
    case FILE_GLB:
        return pc_export_glb(context, asset, path);
    case FILE_PROXY:
        return pc_export_obj(context, &asset->proxy, path);
    case FILE_ASSET:
        return pc_asset_save(context, asset, path);
    case FILE_REPORT:
        return pc_export_report(context, asset, measures, timings, path);
    case FILE_SHEET:
        return pc_export_contact_sheet(context, asset, NULL, path);
    case FILE_STRIP:
        return pc_export_strip(context, asset, NULL, path);
    case FILE_COUNT:
        break;
    }
    return PC_ERROR_INTERNAL;
}

// Warnings of a report; where a run has several results they say which one.
static void warn(const cli_command *command, const cli_arguments *arguments, const pc_asset *asset,
                 const char *stage, const pc_record *record, const void *report) {
    char place[sizeof(asset->name) + 32];
    snprintf(place, sizeof(place), "%s: %s", asset->name, stage);
    const bool several =
        arguments->levels.count > 0 || arguments->settings.parts == CLI_PARTS_SEPARATE;
    cli_warn_report(command->name, several ? place : stage, record, report);
}

int cli_export_files(const cli_command *command, const cli_arguments *arguments,
                     pc_context *context, const pc_asset *asset, const pc_timings *timings,
                     bool with_asset, cli_output *output) {
    pc_measures measures;
    pc_status status = pc_evaluate(context, &asset->visual.surface, &asset->proxy, &measures);
    if (status != PC_OK) {
        return cli_fail_status(command->name, context, status, arguments->inputs[0], false);
    }
    cli_begin_writing();
    for (result_file file = 0; file < FILE_COUNT; ++file) {
        if ((file == FILE_ASSET && !with_asset) ||
            (file == FILE_SHEET && !arguments->settings.png) ||
            (file == FILE_STRIP && !arguments->settings.strip)) {
            continue;
        }
        if (cli_interrupted()) {
            return cli_fail_interrupted(command->name);
        }
        char *path = cli_output_add(output, asset->name, extensions[file]);
        if (path == NULL) {
            return cli_fail(command->name, CLI_LIMIT, "memory ran out");
        }
        status = write_file(context, file, asset, timings, &measures, path);
        free(path);
        if (status != PC_OK) {
            // The file that cannot be written is named already.
            return cli_fail_status(command->name, context, status,
                                   status == PC_ERROR_IO ? NULL : arguments->inputs[0], true);
        }
    }
    warn(command, arguments, asset, "evaluate", &pc_measures_record, &measures);
    return CLI_OK;
}

// One result, for the lines at the end.
typedef struct result {
    char name[sizeof(((pc_asset *)NULL)->name)];
    size_t vertices, triangles;
} result;

// A run: the garments of the input, each with one proxy or a series of levels of detail.
typedef struct build_run {
    const cli_command *command;
    const cli_arguments *arguments;
    pc_context *context;
    scene_data *scene;
    const uint8_t *chosen; // per part of the scene
    cli_output *output;
    pc_asset *assets;    // per garment
    pc_timings *timings; // per garment
    size_t garment_count;
    result *results; // garment_count by levels
    size_t result_count;
} build_run;

static int fail_garment(const build_run *r, pc_status status, const pc_asset *asset) {
    return cli_fail_status(r->command->name, r->context, status,
                           r->garment_count > 1 ? asset->name : r->arguments->inputs[0], false);
}

static void warn_about_stages(const build_run *r, size_t garment, pc_stage first, pc_stage end) {
    const pc_asset *asset = &r->assets[garment];
    for (pc_stage stage = first; stage < end; ++stage) {
        const pc_stage_info *info = pc_stage_describe(stage);
        warn(r->command, r->arguments, asset, info->name, info->report,
             (const char *)&asset->reports + info->report_offset);
        if (r->arguments->settings.verbose) {
            fprintf(stderr, "proxycloth %s: note: %s: %.2f s\n", r->command->name, info->name,
                    r->timings[garment].seconds[stage]);
        }
    }
}

static void print_summary(const build_run *r) {
    const char *folder = r->arguments->output;
    size_t length = strlen(folder);
    while (length > 1 && folder[length - 1] == '/') {
        --length;
    }
    for (size_t i = 0; i < r->result_count && !r->arguments->settings.quiet; ++i) {
        fprintf(stderr, "proxycloth %s: note: %s: %zu vertices, %zu triangles -> %.*s/%s.*\n",
                r->command->name, r->results[i].name, r->results[i].vertices,
                r->results[i].triangles, (int)length, folder, r->results[i].name);
    }
}

static int make_room(build_run *r, size_t garments) {
    const size_t levels = r->arguments->levels.count > 0 ? r->arguments->levels.count : 1;
    r->assets = calloc(garments, sizeof(*r->assets));
    r->timings = calloc(garments, sizeof(*r->timings));
    r->results = calloc(garments * levels, sizeof(*r->results));
    if (r->assets == NULL || r->timings == NULL || r->results == NULL) {
        return cli_fail(r->command->name, CLI_LIMIT, "memory ran out");
    }
    r->garment_count = garments;
    return CLI_OK;
}

// Takes over the visual mesh as one garment, or splits it into its parts.
static int take_garments(build_run *r, pc_visual *visual, const pc_visual_report *report) {
    pc_parts parts = {0};
    int code = CLI_OK;
    if (r->arguments->settings.parts == CLI_PARTS_SEPARATE) {
        const pc_status status = pc_split_visual(r->context, visual, &parts);
        code = status == PC_OK ? make_room(r, parts.part_count)
                               : cli_fail_status(r->command->name, r->context, status,
                                                 r->arguments->inputs[0], false);
    } else {
        code = make_room(r, 1);
    }
    char base[sizeof(((pc_asset *)NULL)->name)] = {0};
    if (code == CLI_OK) {
        code = cli_garment_name(r->command, r->arguments, base);
    }
    for (size_t i = 0; i < r->garment_count && code == CLI_OK; ++i) {
        pc_asset *asset = &r->assets[i];
        pc_visual *source = parts.part_count > 0 ? &parts.visuals[i] : visual;
        asset->visual = *source;
        memset(source, 0, sizeof(*source));
        asset->reports.visual = parts.part_count > 0 ? parts.reports[i] : *report;
        memcpy(asset->name, base, sizeof(base));
        if (r->garment_count > 1) {
            code = cli_extend_name(r->command, base, "part", (uint32_t)i + 1, asset->name);
        }
    }
    pc_parts_free(r->context, &parts);
    return code;
}

// Runs the stages that do not depend on the number of vertices.
static int build_layer(build_run *r, size_t garment) {
    pc_asset *asset = &r->assets[garment];
    pc_status status = PC_OK;
    for (pc_stage stage = 0; stage < PC_STAGE_SIMPLIFY && status == PC_OK; ++stage) {
        status =
            pc_run_stage(r->context, stage, &r->arguments->options, asset, &r->timings[garment]);
    }
    if (status != PC_OK) {
        return fail_garment(r, status, asset);
    }
    warn(r->command, r->arguments, asset, "visual", &pc_visual_report_record,
         &asset->reports.visual);
    warn_about_stages(r, garment, PC_STAGE_VOXELIZE, PC_STAGE_SIMPLIFY);
    return CLI_OK;
}

// Runs the other stages, and writes the files.
static int finish(build_run *r, size_t garment, uint32_t vertices) {
    pc_asset *asset = &r->assets[garment];
    pc_options options = r->arguments->options;
    options.simplify.vertices = vertices;
    const pc_status status =
        pc_build_from(r->context, PC_STAGE_SIMPLIFY, &options, asset, &r->timings[garment]);
    if (status != PC_OK) {
        return fail_garment(r, status, asset);
    }
    const int code = cli_export_files(r->command, r->arguments, r->context, asset,
                                      &r->timings[garment], true, r->output);
    if (code == CLI_OK) {
        warn_about_stages(r, garment, PC_STAGE_SIMPLIFY, PC_STAGE_COUNT);
        result *done = &r->results[r->result_count++];
        memcpy(done->name, asset->name, sizeof(done->name));
        done->vertices = asset->proxy.vertex_count;
        done->triangles = asset->proxy.triangle_count;
    }
    return code;
}

// Shares the vertices between the garments by the area of their single layers. The caller frees
// the result; NULL after a message.
static uint32_t *share(const build_run *r, uint32_t vertices) {
    double *areas = calloc(r->garment_count + 1, sizeof(*areas));
    uint32_t *shares = calloc(r->garment_count + 1, sizeof(*shares));
    pc_status status = PC_ERROR_OUT_OF_MEMORY;
    for (size_t i = 0; areas != NULL && i < r->garment_count; ++i) {
        areas[i] = pc_mesh_area(&r->assets[i].single_layer);
    }
    if (areas != NULL && shares != NULL) {
        status = pc_share_vertices(r->context, r->garment_count, areas, vertices, shares);
    }
    free(areas);
    if (status != PC_OK) {
        free(shares);
        shares = NULL;
        (void)cli_fail(r->command->name, CLI_LIMIT, "memory ran out");
    }
    return shares;
}

// One level of every garment. `level` 0: not part of a series.
static int build_level(build_run *r, uint32_t vertices, uint32_t level) {
    uint32_t *shares = share(r, vertices);
    int code = shares != NULL ? CLI_OK : CLI_FAILED;
    for (size_t i = 0; i < r->garment_count && code == CLI_OK; ++i) {
        char base[sizeof(r->assets[i].name)];
        memcpy(base, r->assets[i].name, sizeof(base));
        if (level > 0) {
            code = cli_extend_name(r->command, base, "lod", level, r->assets[i].name);
        }
        if (code == CLI_OK) {
            code = finish(r, i, r->garment_count > 1 ? shares[i] : vertices);
        }
        memcpy(r->assets[i].name, base, sizeof(base));
    }
    free(shares);
    return code;
}

// Makes the garments of the scene, which is released: nothing else is asked of it.
static int take_scene(build_run *r) {
    pc_visual visual = {0};
    pc_visual_report report;
    pc_status status = scene_visual(r->scene, r->chosen, r->context, &visual, &report);
    if (status != PC_OK) {
        return cli_fail_status(r->command->name, r->context, status, r->arguments->inputs[0],
                               false);
    }
    int code = take_garments(r, &visual, &report);
    pc_visual_free(r->context, &visual);
    for (size_t i = 0; i < r->garment_count && code == CLI_OK; ++i) {
        pc_asset *asset = &r->assets[i];
        code = cli_load_scenario(r->command, r->arguments, r->context, asset);
        if (code == CLI_OK) {
            status = scene_character(r->scene, r->chosen, r->context, &asset->character);
            code = status == PC_OK ? CLI_OK : fail_garment(r, status, asset);
        }
    }
    scene_free(r->scene);
    return code;
}

// Moves the results to their places, unless one would replace what it is made from.
static int commit(const cli_command *command, const cli_arguments *arguments, cli_output *output) {
    const char *inputs[] = {arguments->inputs[0], arguments->scenario, arguments->options_file};
    int code = CLI_OK;
    for (size_t i = 0; i < sizeof(inputs) / sizeof(inputs[0]) && code == CLI_OK; ++i) {
        code = cli_output_protect(command, output, inputs[i]);
    }
    return code == CLI_OK ? cli_output_commit(command, output) : code;
}

static int build(build_run *r) {
    int code = take_scene(r);
    for (size_t i = 0; i < r->garment_count && code == CLI_OK; ++i) {
        code = build_layer(r, i);
    }
    const size_t levels = r->arguments->levels.count;
    if (code == CLI_OK && levels == 0) {
        code = build_level(r, r->arguments->options.simplify.vertices, 0);
    }
    for (size_t i = 0; i < levels && code == CLI_OK; ++i) {
        code = build_level(r, r->arguments->levels.values[i], r->arguments->levels.values[i]);
    }
    if (code == CLI_OK) {
        code = commit(r->command, r->arguments, r->output);
    }
    if (code == CLI_OK) {
        print_summary(r);
    }
    return code;
}

int cli_run_build(const cli_command *command, cli_arguments *arguments) {
    cli_catch_signals();
    cli_kind kind;
    int code = cli_input_kind(command->name, arguments->inputs[0], &kind);
    if (code == CLI_OK && kind == CLI_KIND_ASSET) {
        code = cli_fail(command->name, CLI_INPUT,
                        "%s: this is an asset file; run single stages on it, or export it",
                        arguments->inputs[0]);
    }
    scene_data scene = {0};
    uint8_t *chosen = NULL;
    pc_context *context = NULL;
    cli_output output = {0};
    build_run r = {.command = command, .arguments = arguments, .output = &output};
    if (code == CLI_OK) {
        code = scene_import_selected(command, arguments, arguments->inputs[0], &scene, &chosen);
    }
    // The output folder is tried before the long computation.
    if (code == CLI_OK) {
        code = cli_output_begin(command, arguments->output, &output);
    }
    if (code == CLI_OK) {
        code = cli_context(command, arguments, &context);
    }
    if (code == CLI_OK) {
        r.context = context;
        r.scene = &scene;
        r.chosen = chosen;
        code = build(&r);
    }
    cli_output_end(&output);
    for (size_t i = 0; i < r.garment_count; ++i) {
        pc_asset_free(context, &r.assets[i]);
    }
    free(r.assets);
    free(r.timings);
    free(r.results);
    pc_context_destroy(context);
    free(chosen);
    scene_free(&scene);
    return code;
}

int cli_run_export(const cli_command *command, cli_arguments *arguments) {
    cli_catch_signals();
    const char *input = arguments->inputs[0];
    pc_context *context = NULL;
    pc_asset asset;
    memset(&asset, 0, sizeof(asset));
    cli_output output = {0};
    int code = cli_context(command, arguments, &context);
    if (code == CLI_OK) {
        code = cli_load_asset(command, context, input, &asset);
    }
    if (code == CLI_OK && asset.stage_count != PC_STAGE_COUNT) {
        const pc_stage_info *next = pc_stage_describe((pc_stage)asset.stage_count);
        code = cli_fail(command->name, CLI_INPUT,
                        "%s: stage %s has not run yet; run 'proxycloth %s' and the later stages "
                        "first",
                        input, next->name, next->name);
    }
    if (code == CLI_OK && arguments->name != NULL) {
        memset(asset.name, 0, sizeof(asset.name));
        code = cli_garment_name(command, arguments, asset.name);
    }
    if (code == CLI_OK) {
        code = cli_output_begin(command, arguments->output, &output);
    }
    if (code == CLI_OK) {
        code = cli_export_files(command, arguments, context, &asset, NULL, false, &output);
    }
    if (code == CLI_OK) {
        code = commit(command, arguments, &output);
    }
    cli_output_end(&output);
    if (context != NULL) {
        pc_asset_free(context, &asset);
    }
    pc_context_destroy(context);
    return code;
}
