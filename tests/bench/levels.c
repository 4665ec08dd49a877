// Proxies of garments at several numbers of vertices, each from several seeds: what crosses itself
// and where angles are small. Garments are OBJ files, or asset files that hold a single layer.
// Usage: proxycloth_levels [--vertices N,N,...] [--seeds N] [--set OPTION=VALUE]... FILE...
#include <time.h>

#include "support/garment.h"

enum { most_levels = 16 };

typedef struct level {
    uint32_t vertices;
    size_t proxies, crossed, pairs, small_angles, wrong_counts;
    double hausdorff, worst_angle, seconds;
} level;

static bool ends_with(const char *text, const char *end) {
    const size_t length = strlen(text), tail = strlen(end);
    return length >= tail && strcmp(text + length - tail, end) == 0;
}

static bool load(pc_context *context, const char *path, const pc_options *options,
                 pc_asset *asset) {
    if (ends_with(path, ".h5")) {
        return pc_asset_load(context, path, asset) == PC_OK;
    }
    bool good = load_garment(context, path, asset);
    for (pc_stage stage = 0; stage < PC_STAGE_SIMPLIFY && good; ++stage) {
        good = pc_run_stage(context, stage, options, asset, NULL) == PC_OK;
    }
    return good;
}

// Prints what is not as it should be.
static bool measure(pc_context *context, const char *path, const pc_asset *asset,
                    const pc_simplify_options *options, level *l) {
    pc_mesh proxy = {0};
    pc_simplify_report report;
    pc_measures m;
    const clock_t start = clock();
    bool good = pc_simplify(context, &asset->visual, &asset->single_layer, options, &proxy,
                            &report) == PC_OK;
    l->seconds += (double)(clock() - start) / CLOCKS_PER_SEC;
    good = good && pc_evaluate(context, &asset->visual.surface, &proxy, &m) == PC_OK;
    pc_mesh_free(context, &proxy);
    if (!good) {
        printf("%s: %s\n", path, pc_context_error(context)->message);
        return false;
    }
    const bool small = m.min_angle_worst < 20.0;
    ++l->proxies;
    l->crossed += m.self_intersections > 0;
    l->pairs += m.self_intersections;
    l->small_angles += small;
    l->wrong_counts += m.vertices != options->vertices;
    l->hausdorff += m.hausdorff;
    l->worst_angle = fmin(l->worst_angle, m.min_angle_worst);
    if (m.self_intersections > 0 || small) {
        const char *slash = strrchr(path, '/');
        printf("  %s, %u vertices, seed %u: %llu crossings, smallest angle %.2f\n",
               slash != NULL ? slash + 1 : path, options->vertices, options->seed,
               (unsigned long long)m.self_intersections, m.min_angle_worst);
    }
    fflush(stdout);
    return true;
}

static void summarise(const level *levels, size_t count) {
    printf("%8s %8s %8s %8s %8s %8s %8s %8s %9s\n", "vertices", "proxies", "crossed", "pairs",
           "angle<20", "other n", "HD", "worst", "seconds");
    for (size_t i = 0; i < count; ++i) {
        const level *l = &levels[i];
        printf("%8u %8zu %8zu %8zu %8zu %8zu %8.4f %8.2f %9.2f\n", l->vertices, l->proxies,
               l->crossed, l->pairs, l->small_angles, l->wrong_counts,
               l->hausdorff / (double)l->proxies, l->worst_angle, l->seconds);
    }
}

int main(int argc, char **argv) {
    pc_options options = pc_default_options();
    pc_context *context = NULL;
    level levels[most_levels] = {{.vertices = 128, .worst_angle = 180.0}};
    size_t count = 1, failed = 0;
    unsigned seeds = 1;
    int first = 1;
    if (pc_context_create(NULL, &context) != PC_OK) {
        return 1;
    }
    for (; first < argc && strncmp(argv[first], "--", 2) == 0; first += 2) {
        char *value = first + 1 < argc ? argv[first + 1] : NULL;
        if (value != NULL && strcmp(argv[first], "--vertices") == 0) {
            count = 0;
            for (char *at = strtok(value, ","); at != NULL && count < most_levels;
                 at = strtok(NULL, ",")) {
                levels[count++] =
                    (level){.vertices = (uint32_t)strtoul(at, NULL, 10), .worst_angle = 180.0};
            }
        } else if (value != NULL && strcmp(argv[first], "--seeds") == 0) {
            seeds = (unsigned)strtoul(value, NULL, 10);
        } else if (value == NULL || strcmp(argv[first], "--set") != 0 ||
                   !set_option(context, &options, value)) {
            first = argc;
        }
    }
    if (first >= argc) {
        fprintf(stderr,
                "usage: %s [--vertices N,N,...] [--seeds N] [--set OPTION=VALUE]... FILE...\n",
                argv[0]);
        pc_context_destroy(context);
        return 2;
    }
    for (int i = first; i < argc; ++i) {
        pc_asset asset = {0};
        if (load(context, argv[i], &options, &asset)) {
            for (size_t l = 0; l < count; ++l) {
                for (unsigned seed = 0; seed < seeds; ++seed) {
                    pc_simplify_options chosen = options.simplify;
                    chosen.vertices = levels[l].vertices;
                    chosen.seed += seed;
                    failed += !measure(context, argv[i], &asset, &chosen, &levels[l]);
                }
            }
        } else {
            ++failed;
            printf("%s: %s\n", argv[i], pc_context_error(context)->message);
        }
        pc_asset_free(context, &asset);
    }
    summarise(levels, count);
    pc_context_destroy(context);
    return failed > 0 ? 1 : 0;
}
