// Seconds and peak memory of every stage over garments, made ones of any size among them; how they
// grow with the garment or with an option; and how far each stage is from what the machine can do.
#define _POSIX_C_SOURCE 200809L
#include <unistd.h>

#include "bench/limits.h"
#include "bench/plot.h"
#include "support/garment.h"
#include "support/peak.h"

static const char usage[] =
    "usage: %s [--csv] [--runs N] [--threads N] [--set OPTION=VALUE]...\n"
    "       [--sweep OPTION=VALUE,VALUE,...] [--plot FILE.svg] [--limits] GARMENT...\n"
    "GARMENT is an OBJ file, or made:VERTICES: a pleated skirt over a lining, of about that size.\n"
    "--sweep measures the garment for each value; --plot draws seconds over those, or over the\n"
    "vertices of the garments given. --limits compares with the machine.\n";

enum { MAXIMUM_POINTS = 64 };

typedef struct measurement {
    double minimum, median, peak;
} measurement;

// One garment under one set of options.
typedef struct point {
    double at; // what the plot's axis shows
    size_t vertices;
    measurement stages[PC_STAGE_COUNT];
} point;

typedef struct settings {
    bool csv, limits;
    size_t runs;
    uint32_t threads;
    char *sweep; // OPTION=VALUE,VALUE
    const char *plot;
    pc_options options;
} settings;

static int compare_double(const void *a, const void *b) {
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

// A skirt with 24 pleats and a lining two centimetres inside: grids of quads of one size.
static bool make_garment(pc_context *context, size_t vertices, pc_asset *asset) {
    const size_t rings = (size_t)fmax(3.0, sqrt((double)vertices / 6.0)), sectors = 3 * rings;
    const size_t count = 2 * rings * sectors, triangles = 4 * (rings - 1) * sectors;
    double *positions = calloc(3 * count, sizeof(*positions));
    uint32_t *corners = calloc(3 * triangles, sizeof(*corners)), *next = corners;
    pc_status status = PC_ERROR_OUT_OF_MEMORY;
    for (size_t i = 0; i < count && positions != NULL && corners != NULL; ++i) {
        const size_t layer = i / (rings * sectors), r = i / sectors % rings, s = i % sectors;
        const double height = (double)r / (double)(rings - 1);
        const double angle = 6.283185307179586 * (double)s / (double)sectors;
        const double pleat = layer == 0 ? 0.03 * height * cos(24.0 * angle) : -0.02 - 0.03 * height;
        const double radius = 0.16 + 0.3 * height + pleat;
        positions[3 * i] = radius * cos(angle);
        positions[3 * i + 1] = 1.0 - 0.6 * height;
        positions[3 * i + 2] = radius * sin(angle);
        if (r + 1 < rings) {
            const uint32_t a = (uint32_t)i,
                           b = (uint32_t)(s + 1 < sectors ? i + 1 : i + 1 - sectors);
            const uint32_t c = a + (uint32_t)sectors, d = b + (uint32_t)sectors;
            const uint32_t two[6] = {a, b, d, a, d, c};
            memcpy(next, two, sizeof(two));
            next += 6;
        }
    }
    if (positions != NULL && corners != NULL) {
        const pc_visual_arrays arrays = {.vertex_count = count,
                                         .positions = positions,
                                         .triangle_count = triangles,
                                         .triangles = corners};
        status = pc_visual_create(context, &arrays, &asset->visual, &asset->reports.visual);
    }
    free(positions);
    free(corners);
    return status == PC_OK;
}

static bool get_garment(pc_context *context, const char *name, pc_asset *asset) {
    return strncmp(name, "made:", 5) == 0
               ? make_garment(context, strtoul(name + 5, NULL, 10), asset)
               : load_garment(context, name, asset);
}

// ---- distance from the machine's limits ---------------------------------------------------------

// Of a stage: what it counts, how often it did it, what once costs one thread at least, and what
// else it does, which keeps it away from that.
typedef struct work {
    const char *unit;
    double count, least; // seconds
    const char *besides;
} work;

enum { FARTHEST = 3, SAMPLED_FRAMES = 32 }; // times the limit without a word; of a round of skin

static work stage_work(pc_stage stage, const pc_asset *a, const limits *machine) {
    const pc_reports *r = &a->reports;
    const pc_mesh *surface = &a->visual.surface;
    const double closed = (double)a->projected.vertex_count;
    const pc_simulate_options *s = &a->options.simulate;
    const double frames = fmin((double)a->motion.frame_count, SAMPLED_FRAMES);
    switch (stage) {
    case PC_STAGE_VOXELIZE:
        return (work){"closest point", (double)r->voxelize.queries, machine->closest,
                      "building the tree, parts that are hidden"};
    case PC_STAGE_ISOSURFACE: // a sample is read, 1.5 triangles and .75 vertices are written
        return (work){
            "sample", (double)r->voxelize.samples, 48.0 * machine->byte,
            "cells of a sparse grid look for their neighbours, which is no matter of bytes"};
    case PC_STAGE_PROJECT:
        return (work){"closest point", closed * (double)(r->project.iterations + 1),
                      machine->closest, "solving the normal equations"};
    case PC_STAGE_GRAPH:
        return (work){"ray", 2.0 * closed, machine->ray,
                      "a quadric fitted in double to two rings of each vertex, for its curvature"};
    case PC_STAGE_LABEL: // a wish is read
        return (work){"edge", (double)a->graph.edge_count, 16.0 * machine->byte,
                      "the proof: flows and cycles pass each edge as often as it takes"};
    case PC_STAGE_CARVE: // is it covered; what lies before and behind its two triangles
        return (work){"visual vertex", (double)surface->vertex_count,
                      machine->closest + 4.0 * machine->ray,
                      "repair, topology and outline of the layer, mostly one thread"};
    case PC_STAGE_SIMPLIFY:
        return (work){"layer vertex", (double)a->single_layer.vertex_count, machine->closest,
                      "contraction takes one vertex after the other; flips and moves are tried"};
    case PC_STAGE_SIMULATE: // 30 operations per spring, in a chain: nothing to vectorise
        return (work){"spring projection",
                      (double)(r->simulate.stretch_springs + r->simulate.bend_springs) *
                          (double)(s->frames * s->frame_steps) * (double)s->solver_iterations,
                      30.0 * machine->flop * 16.0, "air, pins and frames"};
    case PC_STAGE_SKIN: // rotations of two neighbourhoods of 6 and 8, about 260 operations
        return (work){
            "vertex and frame", (double)surface->vertex_count * frames * (double)r->skin.rounds,
            260.0 * machine->flop,
            "exact rotations iterate; a round also solves each vertex's row by sweeps, the "
            "last rounds see all frames"};
    case PC_STAGE_COUNT:
        break;
    }
    return (work){"", 0.0, 0.0, ""};
}

static bool print_limits(pc_context *context, const char *name, const settings *set) {
    pc_asset asset = {0};
    pc_timings timings = {0};
    limits machine = {.byte = limit_copy(), .flop = limit_flops()};
    const bool good = get_garment(context, name, &asset) &&
                      pc_build(context, &set->options, &asset, &timings) == PC_OK &&
                      limit_queries(context, &asset.visual.surface, asset.grid.cell_size, &machine);
    if (good) {
        const double threads = pc_context_threads(context);
        printf("one thread: copy %.1f GB/s, %.1f Gflop/s, closest point %.0f ns, ray %.0f ns\n"
               "  %-12s %-18s %12s %12s %12s %8s  %s\n",
               2e-9 / machine.byte, 1e-9 / machine.flop, 1e9 * machine.closest, 1e9 * machine.ray,
               "stage", "unit of work", "units", "ns per unit", "limit ns", "times",
               "what else it does");
        for (pc_stage stage = 0; stage < PC_STAGE_COUNT; ++stage) {
            const work w = stage_work(stage, &asset, &machine);
            // One spring waits for the one before.
            const double least = w.least / (stage == PC_STAGE_SIMULATE ? 1.0 : threads);
            const double each = timings.seconds[stage] / w.count;
            printf("  %-12s %-18s %12.0f %12.2f %12.2f %8.1f  %s\n", pc_stage_describe(stage)->name,
                   w.unit, w.count, 1e9 * each, 1e9 * least, each / least,
                   each > FARTHEST * least ? w.besides : "");
        }
        putchar('\n');
    }
    pc_asset_free(context, &asset);
    return good;
}

// ---- measuring ----------------------------------------------------------------------------------

// Runs the pipeline `runs` times; false when a stage fails.
static bool measure(pc_context *context, const char *name, const settings *set, point *result) {
    double *seconds = calloc(PC_STAGE_COUNT * set->runs, sizeof(*seconds));
    bool good = seconds != NULL;
    for (size_t run = 0; run < set->runs && good; ++run) {
        pc_asset asset = {0};
        good = get_garment(context, name, &asset);
        result->vertices = asset.visual.surface.vertex_count;
        pci_bvh_share(context, &asset.visual.surface); // as pc_build does
        for (pc_stage stage = 0; stage < PC_STAGE_COUNT && good; ++stage) {
            pc_timings timings = {0};
            reset_peak();
            good = pc_run_stage(context, stage, &set->options, &asset, &timings) == PC_OK;
            if (!good) {
                fprintf(stderr, "%s: %s\n", name, pc_context_error(context)->message);
            }
            result->stages[stage].peak = fmax(result->stages[stage].peak, peak_mebibytes());
            seconds[stage * set->runs + run] = timings.seconds[stage];
            if (stage == PC_STAGE_CARVE) {
                pci_bvh_share(context, NULL);
            }
        }
        pci_bvh_share(context, NULL);
        pc_asset_free(context, &asset);
    }
    for (size_t stage = 0; stage < PC_STAGE_COUNT && good; ++stage) {
        qsort(&seconds[stage * set->runs], set->runs, sizeof(*seconds), compare_double);
        result->stages[stage].minimum = seconds[stage * set->runs];
        result->stages[stage].median = seconds[stage * set->runs + set->runs / 2];
    }
    free(seconds);
    return good;
}

static void print_point(pc_context *context, const char *name, const char *value, bool csv,
                        const point *p) {
    const char *slash = strrchr(name, '/');
    name = slash != NULL ? slash + 1 : name;
    if (csv) {
        for (pc_stage stage = 0; stage < PC_STAGE_COUNT; ++stage) {
            printf("%s,%s,%s,%zu,%u,%.6f,%.6f,%.1f\n", pc_stage_describe(stage)->name, name, value,
                   p->vertices, pc_context_threads(context), p->stages[stage].minimum,
                   p->stages[stage].median, p->stages[stage].peak);
        }
        return;
    }
    double minimum = 0.0, median = 0.0, proxy = 0.0;
    printf("%s%s%s, %zu vertices\n  %-12s %10s %10s %10s\n", name, value[0] != '\0' ? ", " : "",
           value, p->vertices, "stage", "min s", "median s", "peak MiB");
    for (pc_stage stage = 0; stage < PC_STAGE_COUNT; ++stage) {
        const measurement *m = &p->stages[stage];
        printf("  %-12s %10.4f %10.4f %10.1f\n", pc_stage_describe(stage)->name, m->minimum,
               m->median, m->peak);
        minimum += m->minimum;
        median += m->median;
        proxy += stage <= PC_STAGE_SIMPLIFY ? m->median : 0.0;
    }
    printf("  %-12s %10.4f %10.4f     (proxy generation %.4f)\n\n", "all", minimum, median, proxy);
}

// How minimum seconds and memory grow from point to point, and the chart.
static bool print_growth(const char *axis, const settings *set, const point *points, size_t count) {
    double x[MAXIMUM_POINTS], y[PC_STAGE_COUNT + 1][MAXIMUM_POINTS] = {0},
                                                 peak[MAXIMUM_POINTS] = {0};
    plot_series series[PC_STAGE_COUNT + 1];
    for (size_t i = 0; i < count; ++i) {
        x[i] = points[i].at;
        for (size_t stage = 0; stage < PC_STAGE_COUNT; ++stage) {
            y[stage][i] = points[i].stages[stage].minimum;
            y[PC_STAGE_COUNT][i] += y[stage][i];
            peak[i] = fmax(peak[i], points[i].stages[stage].peak);
        }
    }
    if (!set->csv) {
        printf("growth over %s: seconds and memory as powers of it\n", axis);
    }
    for (size_t s = 0; s <= PC_STAGE_COUNT; ++s) {
        series[s] =
            (plot_series){s < PC_STAGE_COUNT ? pc_stage_describe((pc_stage)s)->name : "all", y[s]};
        if (!set->csv) {
            printf("  %-12s %6.2f\n", series[s].name, plot_exponent(x, y[s], count));
        }
    }
    if (!set->csv) {
        printf("  %-12s %6.2f\n", "memory", plot_exponent(x, peak, count));
    }
    if (set->plot != NULL && !plot_write(set->plot, axis, x, count, series, PC_STAGE_COUNT + 1)) {
        fprintf(stderr, "%s: cannot be written\n", set->plot);
        return false;
    }
    return true;
}

// All garments, each for every value of the sweep.
static bool run(pc_context *context, settings *set, char **names, size_t name_count) {
    static point points[MAXIMUM_POINTS];
    size_t count = 0;
    bool good = true;
    const char *axis = "vertices";
    char *values = set->sweep != NULL ? strchr(set->sweep, '=') : NULL;
    if (values != NULL) {
        *values++ = '\0';
        axis = set->sweep;
    }
    for (size_t i = 0; i < name_count; ++i) {
        char *value = values;
        do {
            char text[128] = "", next[128] = "";
            if (value != NULL) {
                const size_t length = strcspn(value, ",");
                snprintf(text, sizeof(text), "%s=%.*s", axis, (int)length, value);
                memcpy(next, text, sizeof(text));
                value = value[length] == ',' ? value + length + 1 : NULL;
                if (!set_option(context, &set->options, next)) {
                    fprintf(stderr, "--sweep %s: no such option or value\n", text);
                    return false;
                }
            }
            point p = {0};
            if (!measure(context, names[i], set, &p)) {
                good = false;
                continue;
            }
            p.at = text[0] != '\0' ? strtod(strchr(text, '=') + 1, NULL) : (double)p.vertices;
            print_point(context, names[i], text, set->csv, &p);
            if (set->limits) {
                good = print_limits(context, names[i], set) && good;
            }
            if (count < MAXIMUM_POINTS) {
                points[count++] = p;
            }
        } while (value != NULL);
    }
    return (count < 2 || (values == NULL && set->plot == NULL) ||
            print_growth(axis, set, points, count)) &&
           good;
}

// Returns the index of the first garment; argc when the words make no sense.
static int parse(pc_context *context, int argc, char **argv, settings *set) {
    int i = 1;
    for (; i < argc && strncmp(argv[i], "--", 2) == 0; ++i) {
        const bool more = i + 1 < argc;
        if (strcmp(argv[i], "--csv") == 0) {
            set->csv = true;
        } else if (strcmp(argv[i], "--limits") == 0) {
            set->limits = true;
        } else if (strcmp(argv[i], "--runs") == 0 && more) {
            set->runs = strtoul(argv[++i], NULL, 10);
        } else if (strcmp(argv[i], "--threads") == 0 && more) {
            set->threads = (uint32_t)strtoul(argv[++i], NULL, 10);
        } else if (strcmp(argv[i], "--sweep") == 0 && more && strchr(argv[i + 1], '=') != NULL) {
            set->sweep = argv[++i];
        } else if (strcmp(argv[i], "--plot") == 0 && more) {
            set->plot = argv[++i];
        } else if (strcmp(argv[i], "--set") == 0 && more &&
                   set_option(context, &set->options, argv[i + 1])) {
            ++i;
        } else {
            return argc;
        }
    }
    return set->runs != 0 ? i : argc;
}

int main(int argc, char **argv) {
    settings set = {.runs = 3, .options = pc_default_options()};
    pc_context *context = NULL;
    if (pc_context_create(NULL, &context) != PC_OK) {
        return 1;
    }
    const int first = parse(context, argc, argv, &set);
    pc_context_destroy(context);
    context = NULL;
    if (first >= argc) {
        fprintf(stderr, usage, argv[0]);
        return 2;
    }
    const pc_context_options context_options = {.threads = set.threads};
    if (pc_context_create(&context_options, &context) != PC_OK) {
        return 1;
    }
    if (set.csv) {
        printf("stage,garment,sweep,vertices,threads,min_s,median_s,peak_mib\n");
    } else {
        printf("%u threads, %zu runs\n\n", pc_context_threads(context), set.runs);
    }
    const bool good = run(context, &set, argv + first, (size_t)(argc - first));
    pc_context_destroy(context);
    return good ? 0 : 1;
}
