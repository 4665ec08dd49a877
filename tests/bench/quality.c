// Quality of proxies and weights over garments: one row each, then the means.
// L_r is measured on a wind that the weights have not seen, against closest-triangle weights.
// With --truth, pieces and openings are compared with a table (openings.tsv).
// Usage: proxycloth_quality [--proxy-only] [--truth FILE.tsv] [--set OPTION=VALUE]... FILE.obj...
#include "support/garment.h"

typedef struct row {
    pc_measures measures;
    double gap, rigid, rigid_closest;
    char name[128];
} row;

static bool measure(pc_context *context, const char *path, const pc_options *options,
                    bool proxy_only, row *result) {
    pc_asset asset = {0};
    bool good = load_garment(context, path, &asset);
    const pc_stage last = proxy_only ? PC_STAGE_SIMPLIFY : PC_STAGE_SKIN;
    for (pc_stage stage = 0; stage <= last && good; ++stage) {
        good = pc_run_stage(context, stage, options, &asset, NULL) == PC_OK;
    }
    good =
        good &&
        pc_evaluate(context, &asset.visual.surface, &asset.proxy, &result->measures) == PC_OK &&
        (proxy_only || unseen_wind_rigid(context, &asset, &result->rigid, &result->rigid_closest));
    if (!good) {
        printf("%-34.34s %s\n", asset.name, pc_context_error(context)->message);
    } else {
        const pc_measures *m = &result->measures;
        result->gap = asset.reports.label.gap;
        printf("%-34.34s %5llu %4llu %5llu %5.0f %4llu %4llu %7.4f %7.4f %4llu %7.4f %7.4f %7.4f "
               "%6.2f %6.2f %6.2f %8.1e %8.5f %8.5f%s\n",
               asset.name, (unsigned long long)m->vertices, (unsigned long long)m->components,
               (unsigned long long)m->boundary_loops, m->euler_number,
               (unsigned long long)m->nonmanifold_edges,
               (unsigned long long)m->nonmanifold_vertices, m->doubled_area, m->doubled_layers,
               (unsigned long long)m->self_intersections, m->hausdorff,
               m->hausdorff_visual_to_proxy, m->hausdorff_proxy_to_visual, m->min_angle_mean,
               m->min_angle_sd, m->min_angle_worst, result->gap, result->rigid,
               result->rigid_closest, result->rigid > result->rigid_closest ? " WORSE" : "");
    }
    fflush(stdout);
    snprintf(result->name, sizeof(result->name), "%s", asset.name);
    pc_asset_free(context, &asset);
    return good;
}

// What a garment really is, from a table of lines "name components loops".
typedef struct truth {
    char name[128];
    unsigned long long components, loops;
} truth;

enum { most_truths = 512, most_rows = 4096 };

static bool read_truths(const char *path, truth *truths, size_t *count) {
    FILE *file = fopen(path, "r");
    char line[512];
    if (file == NULL) {
        fprintf(stderr, "%s: cannot be read\n", path);
        return false;
    }
    while (fgets(line, sizeof(line), file) != NULL && *count < most_truths) {
        truth *t = &truths[*count];
        *count += line[0] != '#' &&
                  sscanf(line, "%127s %llu %llu", t->name, &t->components, &t->loops) == 3;
    }
    fclose(file);
    return true;
}

// Adds 1 to `judged` when the garment is in the table, and to `right` when the proxy is as listed.
static void judge(const truth *truths, size_t count, const row *r, size_t *judged, size_t *right) {
    for (size_t i = 0; i < count; ++i) {
        if (strcmp(truths[i].name, r->name) == 0) {
            const bool good = truths[i].components == r->measures.components &&
                              truths[i].loops == r->measures.boundary_loops;
            ++*judged;
            *right += good;
            if (!good) {
                printf("    %s has %llu pieces and %llu openings\n", r->name, truths[i].components,
                       truths[i].loops);
            }
        }
    }
}

static int compare_hausdorff(const void *left, const void *right) {
    const double a = ((const row *)left)->measures.hausdorff;
    const double b = ((const row *)right)->measures.hausdorff;
    return (a > b) - (a < b);
}

static void summarise(row *rows, size_t count, size_t failed, size_t judged, size_t right) {
    double components = 0.0, loops = 0.0, doubled = 0.0, layers = 0.0, hausdorff = 0.0;
    double angle = 0.0, deviation = 0.0, worst = INFINITY;
    size_t crossed = 0, better = 0;
    for (size_t i = 0; i < count; ++i) {
        const pc_measures *m = &rows[i].measures;
        components += (double)m->components;
        loops += (double)m->boundary_loops;
        doubled += m->doubled_area;
        layers += m->doubled_layers;
        hausdorff += m->hausdorff;
        angle += m->min_angle_mean;
        deviation += m->min_angle_sd;
        worst = fmin(worst, m->min_angle_worst);
        crossed += m->self_intersections > 0;
        better += rows[i].rigid <= rows[i].rigid_closest;
    }
    if (count > 0) {
        const double n = (double)count;
        qsort(rows, count, sizeof(*rows), compare_hausdorff);
        const double median =
            0.5 * (rows[(count - 1) / 2].measures.hausdorff + rows[count / 2].measures.hausdorff);
        printf("\nmeans: components %.3f, loops %.3f, doubled %.4f, its layers %.4f, HD %.4f "
               "(median %.4f, largest "
               "%.4f), min angle %.2f, its sd %.2f, smallest angle %.2f\n",
               components / n, loops / n, doubled / n, layers / n, hausdorff / n, median,
               rows[count - 1].measures.hausdorff, angle / n, deviation / n, worst);
    }
    printf("%zu garments, %zu failed; with self-intersections %zu, L_r below closest triangle on "
           "%zu, pieces and openings right on %zu of %zu\n",
           count, failed, crossed, better, right, judged);
}

int main(int argc, char **argv) {
    bool proxy_only = false;
    int first = 1;
    pc_options options = pc_default_options();
    pc_context *context = NULL;
    truth *truths = calloc(most_truths, sizeof(*truths));
    row *rows = calloc(most_rows, sizeof(*rows));
    size_t truth_count = 0, count = 0, failed = 0, judged = 0, right = 0;
    if (truths == NULL || rows == NULL || pc_context_create(NULL, &context) != PC_OK) {
        return 1;
    }
    for (; first < argc && strncmp(argv[first], "--", 2) == 0; ++first) {
        const bool more = first + 1 < argc;
        if (strcmp(argv[first], "--proxy-only") == 0) {
            proxy_only = true;
        } else if (strcmp(argv[first], "--truth") == 0 && more &&
                   read_truths(argv[first + 1], truths, &truth_count)) {
            ++first;
        } else if (strcmp(argv[first], "--set") == 0 && more &&
                   set_option(context, &options, argv[first + 1])) {
            ++first;
        } else {
            first = argc;
        }
    }
    if (first >= argc || argc - first > most_rows) {
        fprintf(stderr,
                "usage: %s [--proxy-only] [--truth FILE.tsv] [--set OPTION=VALUE]... FILE.obj...\n",
                argv[0]);
        pc_context_destroy(context);
        return 2;
    }
    printf("%-34s %5s %4s %5s %5s %4s %4s %7s %7s %4s %7s %7s %7s %6s %6s %6s %8s %8s %8s\n",
           "garment", "v", "comp", "loops", "euler", "nm_e", "nm_v", "doubled", "layers", "self",
           "HD", "HD v>p", "HD p>v", "angle", "sd", "worst", "gap", "L_r", "closest");
    for (int i = first; i < argc; ++i) {
        if (measure(context, argv[i], &options, proxy_only, &rows[count])) {
            judge(truths, truth_count, &rows[count], &judged, &right);
            ++count;
        } else {
            ++failed;
        }
    }
    summarise(rows, count, failed, judged, right);
    pc_context_destroy(context);
    free(rows);
    free(truths);
    return failed > 0 ? 1 : 0;
}
