// Seconds and peak memory of every stage over garments.
// Usage: proxycloth_bench [--csv] [--runs N] [--threads N] [--set OPTION=VALUE]... FILE.obj...
#define _POSIX_C_SOURCE 200809L
#include <unistd.h>

#include "support/garment.h"
#include "support/peak.h"

static int compare_double(const void *a, const void *b) {
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

typedef struct measurement {
    double minimum, median, peak;
} measurement;

// Runs the pipeline `runs` times; false when a stage fails.
static bool measure(pc_context *context, const char *path, const pc_options *options, size_t runs,
                    measurement results[PC_STAGE_COUNT], size_t *vertices) {
    double *seconds = calloc(PC_STAGE_COUNT * runs, sizeof(*seconds));
    bool good = seconds != NULL;
    memset(results, 0, PC_STAGE_COUNT * sizeof(*results));
    for (size_t run = 0; run < runs && good; ++run) {
        pc_asset asset = {0};
        good = load_garment(context, path, &asset);
        *vertices = asset.visual.surface.vertex_count;
        for (pc_stage stage = 0; stage < PC_STAGE_COUNT && good; ++stage) {
            pc_timings timings = {0};
            reset_peak();
            good = pc_run_stage(context, stage, options, &asset, &timings) == PC_OK;
            if (!good) {
                fprintf(stderr, "%s: %s\n", path, pc_context_error(context)->message);
            }
            const double peak = peak_mebibytes();
            results[stage].peak = peak > results[stage].peak ? peak : results[stage].peak;
            seconds[stage * runs + run] = timings.seconds[stage];
        }
        pc_asset_free(context, &asset);
    }
    for (size_t stage = 0; stage < PC_STAGE_COUNT && good; ++stage) {
        qsort(&seconds[stage * runs], runs, sizeof(*seconds), compare_double);
        results[stage].minimum = seconds[stage * runs];
        results[stage].median = seconds[stage * runs + runs / 2];
    }
    free(seconds);
    return good;
}

static void print_table(const char *name, size_t vertices,
                        const measurement results[PC_STAGE_COUNT]) {
    double minimum = 0.0, median = 0.0, proxy = 0.0;
    printf("%s, %zu vertices\n  %-12s %10s %10s %10s\n", name, vertices, "stage", "min s",
           "median s", "peak MiB");
    for (pc_stage stage = 0; stage < PC_STAGE_COUNT; ++stage) {
        printf("  %-12s %10.4f %10.4f %10.1f\n", pc_stage_describe(stage)->name,
               results[stage].minimum, results[stage].median, results[stage].peak);
        minimum += results[stage].minimum;
        median += results[stage].median;
        proxy += stage <= PC_STAGE_SIMPLIFY ? results[stage].median : 0.0;
    }
    printf("  %-12s %10.4f %10.4f     (proxy generation %.4f)\n\n", "all", minimum, median, proxy);
}

int main(int argc, char **argv) {
    bool csv = false;
    size_t runs = 3;
    uint32_t threads = 0;
    int first = 1;
    pc_options options = pc_default_options();
    char *settings[64];
    size_t setting_count = 0;
    for (; first < argc && strncmp(argv[first], "--", 2) == 0; ++first) {
        if (strcmp(argv[first], "--csv") == 0) {
            csv = true;
        } else if (strcmp(argv[first], "--runs") == 0 && first + 1 < argc) {
            runs = strtoul(argv[++first], NULL, 10);
        } else if (strcmp(argv[first], "--threads") == 0 && first + 1 < argc) {
            threads = (uint32_t)strtoul(argv[++first], NULL, 10);
        } else if (strcmp(argv[first], "--set") == 0 && first + 1 < argc && setting_count < 64) {
            settings[setting_count++] = argv[++first];
        } else {
            first = argc;
        }
    }
    if (first >= argc || runs == 0) {
        fprintf(stderr,
                "usage: %s [--csv] [--runs N] [--threads N] [--set OPTION=VALUE]... "
                "FILE.obj...\n",
                argv[0]);
        return 2;
    }
    pc_context *context = NULL;
    const pc_context_options context_options = {.threads = threads};
    if (pc_context_create(&context_options, &context) != PC_OK) {
        return 1;
    }
    for (size_t i = 0; i < setting_count; ++i) {
        if (!set_option(context, &options, settings[i])) {
            fprintf(stderr, "--set %s: %s\n", settings[i], pc_context_error(context)->message);
            pc_context_destroy(context);
            return 2;
        }
    }
    if (csv) {
        printf("stage,case,vertices,threads,min_s,median_s,peak_mib\n");
    } else {
        printf("%u threads, %zu runs\n\n", pc_context_threads(context), runs);
    }
    int result = 0;
    for (int i = first; i < argc; ++i) {
        measurement results[PC_STAGE_COUNT];
        size_t vertices = 0;
        if (!measure(context, argv[i], &options, runs, results, &vertices)) {
            result = 1;
            continue;
        }
        const char *slash = strrchr(argv[i], '/');
        const char *name = slash != NULL ? slash + 1 : argv[i];
        if (!csv) {
            print_table(name, vertices, results);
            continue;
        }
        for (pc_stage stage = 0; stage < PC_STAGE_COUNT; ++stage) {
            printf("%s,%s,%zu,%u,%.6f,%.6f,%.1f\n", pc_stage_describe(stage)->name, name, vertices,
                   pc_context_threads(context), results[stage].minimum, results[stage].median,
                   results[stage].peak);
        }
    }
    pc_context_destroy(context);
    return result;
}
