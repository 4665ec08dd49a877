// Quality of proxies and weights over garments: one row each, then the means.
// L_r is measured on a wind that the weights have not seen, against closest-triangle weights.
// Usage: proxycloth_quality [--proxy-only] [--set OPTION=VALUE]... FILE.obj...
#include "support/garment.h"

typedef struct row {
    pc_measures measures;
    double gap, rigid, rigid_closest;
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
        printf("%-34.34s %5llu %4llu %5llu %5.0f %4llu %4llu %7.4f %4llu %7.4f %7.4f %7.4f %6.2f "
               "%6.2f %6.2f %8.1e %8.5f %8.5f%s\n",
               asset.name, (unsigned long long)m->vertices, (unsigned long long)m->components,
               (unsigned long long)m->boundary_loops, m->euler_number,
               (unsigned long long)m->nonmanifold_edges,
               (unsigned long long)m->nonmanifold_vertices, m->doubled_area,
               (unsigned long long)m->self_intersections, m->hausdorff,
               m->hausdorff_visual_to_proxy, m->hausdorff_proxy_to_visual, m->min_angle_mean,
               m->min_angle_sd, m->min_angle_worst, result->gap, result->rigid,
               result->rigid_closest, result->rigid > result->rigid_closest ? " WORSE" : "");
    }
    fflush(stdout);
    pc_asset_free(context, &asset);
    return good;
}

int main(int argc, char **argv) {
    bool proxy_only = false;
    int first = 1;
    pc_options options = pc_default_options();
    pc_context *context = NULL;
    if (pc_context_create(NULL, &context) != PC_OK) {
        return 1;
    }
    for (; first < argc && strncmp(argv[first], "--", 2) == 0; ++first) {
        if (strcmp(argv[first], "--proxy-only") == 0) {
            proxy_only = true;
        } else if (strcmp(argv[first], "--set") != 0 || ++first >= argc ||
                   !set_option(context, &options, argv[first])) {
            first = argc;
        }
    }
    if (first >= argc) {
        fprintf(stderr, "usage: %s [--proxy-only] [--set OPTION=VALUE]... FILE.obj...\n", argv[0]);
        pc_context_destroy(context);
        return 2;
    }
    printf("%-34s %5s %4s %5s %5s %4s %4s %7s %4s %7s %7s %7s %6s %6s %6s %8s %8s %8s\n", "garment",
           "v", "comp", "loops", "euler", "nm_e", "nm_v", "doubled", "self", "HD", "HD v>p",
           "HD p>v", "angle", "sd", "worst", "gap", "L_r", "closest");
    double sum[6] = {0};
    size_t count = 0, failed = 0;
    for (int i = first; i < argc; ++i) {
        row result = {0};
        if (!measure(context, argv[i], &options, proxy_only, &result)) {
            ++failed;
            continue;
        }
        const double values[6] = {
            (double)result.measures.components, (double)result.measures.boundary_loops,
            result.measures.doubled_area,       result.measures.hausdorff,
            result.measures.min_angle_mean,     result.rigid <= result.rigid_closest ? 1.0 : 0.0};
        for (size_t k = 0; k < 6; ++k) {
            sum[k] += values[k];
        }
        ++count;
    }
    const double n = count > 0 ? (double)count : 1.0;
    printf("\n%zu garments, %zu failed; means: components %.3f, loops %.3f, doubled %.4f, HD %.4f, "
           "min angle %.2f, L_r below closest triangle on %.0f\n",
           count, failed, sum[0] / n, sum[1] / n, sum[2] / n, sum[3] / n, sum[4] / n, sum[5]);
    pc_context_destroy(context);
    return failed > 0 ? 1 : 0;
}
