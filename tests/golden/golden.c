// Runs the whole pipeline on sample garments, checks what must hold for every garment, and compares
// the measures with golden.tsv. Usage: golden GOLDEN.tsv DATA_FOLDER            compares; a row per
// garment
//        golden --update GOLDEN.tsv DATA_FOLDER   rewrites the file's values
#include <math.h>

#include "support/garment.h"

enum { VALUE_COUNT = 8, MAX_ROWS = 64 };

// Golden values and how far they may move: absolute + relative. Loose enough for another compiler,
// tight enough that a change of behaviour shows.
static const struct {
    const char *name;
    double absolute, relative;
} values[VALUE_COUNT] = {
    {"vertices", 0.0, 0.0},          {"components", 0.0, 0.0},       {"boundary_loops", 0.0, 0.0},
    {"label_objective", 1e-6, 1e-4}, {"hausdorff", 2e-3, 0.05},      {"min_angle_mean", 0.5, 0.0},
    {"doubled_area", 2e-3, 0.0},     {"skin_loss_after", 0.0, 0.05},
};

typedef struct golden_row {
    char name[128];
    double expected[VALUE_COUNT];
} golden_row;

static int failures;

static void check(bool condition, const char *name, const char *what) {
    if (!condition) {
        printf("FAILED %s: %s\n", name, what);
        ++failures;
    }
}

// Certificates that need no golden value.
// `sheet` measures the visual mesh against itself.
static void check_certificates(const pc_asset *asset, const pc_measures *measures,
                               const pc_measures *sheet) {
    const char *name = asset->name;
    const pc_label_report *label = &asset->reports.label;
    const double objective =
        pc_label_objective(&asset->graph, &asset->options.label, asset->labels.labels);
    check(fabs(objective - label->objective) <= 1e-9 * fmax(1.0, objective), name,
          "the labels do not have the reported objective");
    check(label->bound <= label->objective + 1e-9 * fmax(1.0, objective), name,
          "the bound is above the objective");
    check(measures->nonmanifold_edges == 0, name, "the proxy has non-manifold edges");
    check(measures->nonmanifold_vertices == 0, name, "the proxy has non-manifold vertices");
    // A sheet that is its own layer lies beside itself where the garment does: sleeves, folds.
    const double inherent =
        asset->reports.carve.source == PC_LAYER_VISUAL ? 0.25 * sheet->doubled_area : 0.0;
    check(measures->doubled_area <= fmax(0.02, inherent), name, "the proxy has doubled layers");
    for (size_t i = 0; i < asset->skin.vertex_count; ++i) {
        double sum = 0.0;
        bool good = true;
        for (uint32_t k = 0; k < asset->skin.influences; ++k) {
            const size_t at = i * asset->skin.influences + k;
            sum += asset->skin.weights[at];
            good = good && asset->skin.weights[at] >= 0.0 &&
                   asset->skin.bones[at] < asset->proxy.vertex_count;
        }
        if (!good || !(fabs(sum - 1.0) <= 1e-12)) {
            check(false, name, "a row of weights is not a convex combination");
            break;
        }
    }
}

// Weights must beat closest-triangle weights in L_r on a wind that they have not seen.
static void check_unseen_wind(pc_context *context, const pc_asset *asset) {
    double ours = 0.0, closest = 0.0;
    const bool ran = unseen_wind_rigid(context, asset, &ours, &closest);
    check(ran, asset->name, "the weights cannot be evaluated");
    check(ran && ours < closest, asset->name,
          "L_r on an unseen wind is not below closest-triangle weights");
}

static void run(pc_context *context, const char *folder, golden_row *row, bool update) {
    char path[4096];
    snprintf(path, sizeof(path), "%s/%s.obj", folder, row->name);
    pc_asset asset = {0};
    pc_measures measures = {0};
    pc_measures sheet = {0};
    if (!load_garment(context, path, &asset) || pc_build(context, NULL, &asset, NULL) != PC_OK ||
        pc_evaluate(context, &asset.visual.surface, &asset.proxy, &measures) != PC_OK ||
        pc_evaluate(context, &asset.visual.surface, &asset.visual.surface, &sheet) != PC_OK) {
        check(false, row->name, pc_context_error(context)->message);
        pc_asset_free(context, &asset);
        return;
    }
    check_certificates(&asset, &measures, &sheet);
    check_unseen_wind(context, &asset);
    const double found[VALUE_COUNT] = {(double)measures.vertices,
                                       (double)measures.components,
                                       (double)measures.boundary_loops,
                                       asset.reports.label.objective,
                                       measures.hausdorff,
                                       measures.min_angle_mean,
                                       measures.doubled_area,
                                       asset.reports.skin.loss_after};
    for (size_t k = 0; k < VALUE_COUNT; ++k) {
        const double allowed = values[k].absolute + values[k].relative * fabs(row->expected[k]);
        if (update) {
            row->expected[k] = found[k];
        } else if (!(fabs(found[k] - row->expected[k]) <= allowed)) {
            printf("FAILED %s: %s = %.6g, golden %.6g +- %.2g\n", row->name, values[k].name,
                   found[k], row->expected[k], allowed);
            ++failures;
        }
    }
    printf("%s done\n", row->name);
    fflush(stdout);
    pc_asset_free(context, &asset);
}

static size_t read_rows(const char *path, golden_row *rows) {
    FILE *file = fopen(path, "r");
    char line[1024];
    size_t count = 0;
    while (file != NULL && count < MAX_ROWS && fgets(line, sizeof(line), file) != NULL) {
        char *tab = strpbrk(line, "\t\r\n");
        if (line[0] == '#' || tab == NULL || tab == line) {
            continue;
        }
        char *at = tab + 1;
        *tab = '\0';
        snprintf(rows[count].name, sizeof(rows[count].name), "%.120s", line);
        for (size_t k = 0; k < VALUE_COUNT; ++k) {
            rows[count].expected[k] = strtod(at, &at);
        }
        ++count;
    }
    if (file != NULL) {
        fclose(file);
    }
    return count;
}

static bool write_rows(const char *path, const golden_row *rows, size_t count) {
    FILE *file = fopen(path, "w");
    if (file == NULL) {
        return false;
    }
    fprintf(file, "# garment");
    for (size_t k = 0; k < VALUE_COUNT; ++k) {
        fprintf(file, "\t%s", values[k].name);
    }
    for (size_t i = 0; i < count; ++i) {
        fprintf(file, "\n%s", rows[i].name);
        for (size_t k = 0; k < VALUE_COUNT; ++k) {
            fprintf(file, "\t%.7g", rows[i].expected[k]);
        }
    }
    fprintf(file, "\n");
    return fclose(file) == 0;
}

int main(int argc, char **argv) {
    static golden_row rows[MAX_ROWS];
    const bool update = argc == 4 && strcmp(argv[1], "--update") == 0;
    pc_context *context = NULL;
    if ((argc != 3 && !update) || pc_context_create(NULL, &context) != PC_OK) {
        fprintf(stderr, "usage: %s [--update] GOLDEN.tsv DATA_FOLDER\n", argv[0]);
        return 2;
    }
    const char *golden = argv[argc - 2];
    const size_t count = read_rows(golden, rows);
    check(count > 0, golden, "holds no garment");
    for (size_t i = 0; i < count; ++i) {
        run(context, argv[argc - 1], &rows[i], update);
    }
    if (update) {
        check(write_rows(golden, rows, count), golden, "cannot be written");
    }
    pc_context_destroy(context);
    printf("%d failures\n", failures);
    return failures > 0 ? 1 : 0;
}
