// Checks what must hold for every garment, whatever its measures are, on finished asset files.
// Usage: golden ASSET.h5...
#include <math.h>

#include "support/garment.h"

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
    const double share = asset->reports.carve.source == PC_LAYER_VISUAL ? 0.25 : 0.0;
    check(measures->doubled_area <= fmax(0.02, share * sheet->doubled_area), name,
          "the proxy lies in two layers");
    check(measures->doubled_layers <= fmax(0.01, share * sheet->doubled_layers), name,
          "the proxy has more layers than the garment");
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

static void run(pc_context *context, const char *path) {
    pc_asset asset = {0};
    pc_measures measures = {0};
    pc_measures sheet = {0};
    if (pc_asset_load(context, path, &asset) != PC_OK ||
        pc_evaluate(context, &asset.visual.surface, &asset.proxy, &measures) != PC_OK ||
        pc_evaluate(context, &asset.visual.surface, &asset.visual.surface, &sheet) != PC_OK) {
        check(false, path, pc_context_error(context)->message);
    } else {
        check_certificates(&asset, &measures, &sheet);
        check_unseen_wind(context, &asset);
    }
    pc_asset_free(context, &asset);
}

int main(int argc, char **argv) {
    pc_context *context = NULL;
    if (argc < 2 || pc_context_create(NULL, &context) != PC_OK) {
        fprintf(stderr, "usage: %s ASSET.h5...\n", argv[0]);
        return 2;
    }
    for (int i = 1; i < argc; ++i) {
        run(context, argv[i]);
    }
    pc_context_destroy(context);
    printf("%d garments, %d failures\n", argc - 1, failures);
    return failures > 0 ? 1 : 0;
}
