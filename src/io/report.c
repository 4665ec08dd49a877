// The report as JSON. Keys are stable: they are read by scripts. Only the object `timings` differs
// between two runs on the same input.
#include "io/atomic_file.h"
#include "io/json.h"
#include "proxycloth/export.h"
#include "proxycloth/version.h"

#define STAGE         "export"
#define REPORT_SCHEMA 1

// What the results depend on.
static void add_versions(pci_json *json) {
    cJSON *versions = pci_json_object(json, json->root, "versions");
    pci_json_string(json, versions, "proxycloth", PC_VERSION_STRING);
    pc_dependency dependency;
    for (size_t i = 0; pc_dependency_at(i, &dependency); ++i) {
        pci_json_string(json, versions, dependency.name, dependency.version);
    }
    pci_json_string(json, versions, "compiler", __VERSION__);
}

static void add_stages(pci_json *json, const pc_asset *asset) {
    pci_json_record(json, pci_json_object(json, json->root, "visual"), "report",
                    &pc_visual_report_record, &asset->reports.visual);
    cJSON *stages = pci_json_object(json, json->root, "stages");
    for (pc_stage stage = 0; (uint32_t)stage < asset->stage_count; ++stage) {
        const pc_stage_info *info = pc_stage_describe(stage);
        cJSON *object = pci_json_object(json, stages, info->name);
        pci_json_record(json, object, "options", info->options,
                        (const char *)&asset->options + info->options_offset);
        pci_json_record(json, object, "report", info->report,
                        (const char *)&asset->reports + info->report_offset);
    }
}

static void add_record_warnings(pci_json *json, cJSON *warnings, const char *stage,
                                const pc_record *record, const void *values) {
    for (size_t i = 0; i < record->field_count; ++i) {
        const pc_field *field = &record->fields[i];
        const double number = pc_field_number(field, values);
        if (field->warning == NULL || number == 0.0) {
            continue;
        }
        cJSON *warning = pci_json_object(json, warnings, NULL);
        pci_json_string(json, warning, "stage", stage);
        pci_json_string(json, warning, "field", field->name);
        pci_json_number(json, warning, "count", number);
        pci_json_string(json, warning, "message", field->warning);
    }
}

static void add_warnings(pci_json *json, const pc_asset *asset, const pc_measures *measures) {
    cJSON *warnings = pci_json_array(json, json->root, "warnings");
    add_record_warnings(json, warnings, "visual", &pc_visual_report_record, &asset->reports.visual);
    for (pc_stage stage = 0; (uint32_t)stage < asset->stage_count; ++stage) {
        const pc_stage_info *info = pc_stage_describe(stage);
        add_record_warnings(json, warnings, info->name, info->report,
                            (const char *)&asset->reports + info->report_offset);
    }
    if (measures != NULL) {
        add_record_warnings(json, warnings, "evaluate", &pc_measures_record, measures);
    }
}

// The certificate of the labelling, where a reader looks for it.
static void add_label(pci_json *json, const pc_label_report *report) {
    static const char *const names[] = {"outcome", "objective", "bound", "gap"};
    cJSON *object = pci_json_object(json, json->root, "label");
    for (size_t i = 0; i < sizeof(names) / sizeof(names[0]); ++i) {
        pci_json_field(json, object, pc_record_find(&pc_label_report_record, names[i]), report);
    }
}

static void add_histograms(pci_json *json, const pc_histogram histograms[PC_SHAPE_COUNT]) {
    cJSON *object = pci_json_object(json, json->root, "histograms");
    for (size_t i = 0; i < PC_SHAPE_COUNT; ++i) {
        cJSON *histogram = pci_json_object(json, object, histograms[i].name);
        pci_json_number(json, histogram, "maximum", histograms[i].maximum);
        cJSON *counts = pci_json_array(json, histogram, "counts");
        for (size_t bin = 0; bin < PC_HISTOGRAM_BINS; ++bin) {
            pci_json_count(json, counts, NULL, histograms[i].counts[bin]);
        }
    }
}

static void add_loss(pci_json *json, cJSON *losses, const char *name, double total, double rigid,
                     double collision, double attachment) {
    cJSON *loss = pci_json_object(json, losses, name);
    pci_json_number(json, loss, "total", total);
    pci_json_number(json, loss, "rigid", rigid);
    pci_json_number(json, loss, "collision", collision);
    pci_json_number(json, loss, "attachment", attachment);
}

static void add_timings(pci_json *json, const pc_timings *timings) {
    cJSON *object = pci_json_object(json, json->root, "timings");
    double total = 0.0;
    for (pc_stage stage = 0; stage < PC_STAGE_COUNT; ++stage) {
        pci_json_number(json, object, pc_stage_describe(stage)->name, timings->seconds[stage]);
        total += timings->seconds[stage];
    }
    pci_json_number(json, object, "total", total);
}

static void build(pci_json *json, const pc_asset *asset, const pc_measures *measures,
                  const pc_histogram *histograms, const pc_timings *timings) {
    const pc_skin_report *skin = &asset->reports.skin;
    pci_json_count(json, json->root, "schema", REPORT_SCHEMA);
    add_versions(json);
    pci_json_string(json, json->root, "name", asset->name);
    pci_json_count(json, json->root, "stage_count", asset->stage_count);
    add_stages(json, asset);
    add_warnings(json, asset, measures);
    if (asset->stage_count > PC_STAGE_LABEL) {
        add_label(json, &asset->reports.label);
    }
    if (measures != NULL) {
        pci_json_record(json, json->root, "measures", &pc_measures_record, measures);
        add_histograms(json, histograms);
    }
    if (asset->stage_count > PC_STAGE_SKIN) {
        cJSON *losses = pci_json_object(json, json->root, "losses");
        add_loss(json, losses, "before", skin->loss_before, skin->rigid_before,
                 skin->collision_before, skin->attachment_before);
        add_loss(json, losses, "after", skin->loss_after, skin->rigid_after, skin->collision_after,
                 skin->attachment_after);
    }
    if (timings != NULL) {
        add_timings(json, timings);
    }
}

pc_status pc_export_report(pc_context *context, const pc_asset *asset, const pc_measures *measures,
                           const pc_timings *timings, const char *path) {
    if (context == NULL) {
        return PC_ERROR_INVALID_ARGUMENT;
    }
    if (asset == NULL || path == NULL || asset->stage_count > PC_STAGE_COUNT ||
        memchr(asset->name, '\0', sizeof(asset->name)) == NULL) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, STAGE,
                        STAGE ": a report needs an asset and a path");
    }
    pc_histogram histograms[PC_SHAPE_COUNT] = {0};
    if (measures != NULL) {
        const pc_status status = pc_evaluate_shape(context, &asset->proxy, histograms);
        if (status != PC_OK) {
            return status;
        }
    }
    pci_json json;
    pci_json_begin(&json);
    build(&json, asset, measures, histograms, timings);
    char *text = pci_json_print(&json, true);
    pci_atomic_file file = {0};
    pc_status status = text != NULL ? pci_atomic_begin(context, STAGE, path, &file)
                                    : pci_fail_memory(context, STAGE);
    if (status == PC_OK) {
        fputs(text, file.stream);
        fputc('\n', file.stream);
        status = pci_atomic_end(&file, PC_OK);
    }
    cJSON_free(text);
    pci_json_end(&json);
    return status;
}
