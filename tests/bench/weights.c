// Weights against weights without optimisation, on motions that none of them has seen: the measures
// of evaluate_motion.h, one row per garment and kind of weights, then how often ours win.
// Assets must be built up to simulate at least. Where the proxy follows a clip of a character, the
// motion is the file's next clip; everywhere another seed of the winds.
// A measure is won when it is smaller than in all three other rows, or 0 where the smallest is.
// The two smooth baselines have as many influences as ours, hence the same cost at run time, or N.
// Usage: proxycloth_weights [--set OPTION=VALUE | --baseline-influences N | --wind SEED]...
//        FILE.h5...
#include <stdlib.h>

#include "support/garment.h"

enum { ROWS = 4, MEASURES = 6 };

static const char *const row_names[ROWS] = {"ours", "inverse distance", "closest triangle",
                                            "heat-smoothed"};
static const char *const measure_names[MEASURES] = {"L_r", "L_c",    "strain",
                                                    "p95", "folded", "crossings"};

typedef struct arguments {
    pc_options options;
    uint32_t baseline_influences; // 0: those of the options
    uint32_t wind;                // seed
    int first;                    // file
} arguments;

typedef struct tally {
    size_t garments, won[MEASURES], beats_smoothed[MEASURES], all, moving, held;
} tally;

static void list_measures(const pc_motion_measures *m, double values[MEASURES]) {
    const double list[MEASURES] = {m->rigid,      m->collision,        m->strain_mean,
                                   m->strain_p95, m->folded_triangles, m->new_intersections};
    memcpy(values, list, sizeof(list));
}

static bool unseen_motion(pc_context *context, pc_asset *asset, uint32_t wind, pc_motion *motion) {
    pc_attachment *attachment = &asset->scenario.attachment;
    const pc_character *character = &asset->character;
    for (size_t i = 0; attachment->kind == PC_ATTACHMENT_CLIP && i < character->clip_count; ++i) {
        if (strcmp(attachment->clip, &character->clip_names[PC_NAME_SIZE * i]) == 0) {
            memcpy(attachment->clip,
                   &character->clip_names[PC_NAME_SIZE * ((i + 1) % character->clip_count)],
                   PC_NAME_SIZE);
            break;
        }
    }
    pc_simulate_options options = asset->options.simulate;
    options.seed = wind;
    const pc_simulate_inputs inputs = {&asset->proxy, &asset->scenario, &asset->visual,
                                       &asset->character};
    return pc_simulate_scenario(context, &inputs, &options, motion, NULL) == PC_OK;
}

static bool make_weights(pc_context *context, const pc_asset *asset, const arguments *a, size_t row,
                         pc_skin *skin) {
    const pc_mesh *surface = &asset->visual.surface, *proxy = &asset->proxy;
    pc_status status = PC_ERROR_INTERNAL;
    switch (row) {
    case 0:
        status =
            pc_skin_optimize(context, surface, proxy, &asset->motion, &a->options.skin, skin, NULL);
        break;
    case 1:
        status = pc_skin_inverse_distance(context, surface, proxy, a->baseline_influences, skin);
        break;
    case 2:
        status = pc_skin_closest_triangle(context, surface, proxy, skin);
        break;
    default:
        status = pc_skin_heat_smoothed(context, surface, proxy, a->baseline_influences, skin);
        break;
    }
    return status == PC_OK;
}

static void count_wins(double values[ROWS][MEASURES], const pc_motion_measures *ours, tally *t) {
    bool all = true;
    for (size_t x = 0; x < MEASURES; ++x) {
        const double other = fmin(values[1][x], fmin(values[2][x], values[3][x]));
        const bool won = values[0][x] < other || values[0][x] == 0.0;
        t->won[x] += won;
        t->beats_smoothed[x] += values[0][x] < values[3][x] || values[0][x] == 0.0;
        all = all && won;
    }
    ++t->garments;
    t->all += all;
    t->moving += ours->motion_ratio >= 0.97;
    t->held += ours->pinned_drift <= 0.001;
}

static bool measure(pc_context *context, const char *path, const arguments *a, tally *t) {
    pc_asset asset = {0};
    pc_motion motion = {0};
    pc_motion_measures ours = {0};
    double values[ROWS][MEASURES];
    bool good = pc_asset_load(context, path, &asset) == PC_OK &&
                unseen_motion(context, &asset, a->wind, &motion);
    for (size_t row = 0; row < ROWS && good; ++row) {
        pc_skin skin = {0};
        pc_motion_measures m;
        good = make_weights(context, &asset, a, row, &skin) &&
               pc_evaluate_motion(context, &asset.visual.surface, &asset.proxy, &motion, &skin,
                                  NULL, &m) == PC_OK;
        if (good) {
            ours = row == 0 ? m : ours;
            list_measures(&m, values[row]);
            printf("%-32.32s %-16s %3u", asset.name, row_names[row], (unsigned)skin.influences);
            printf(" %9.6f %9.6f %8.5f %8.5f %8.5f %9.2f %8.5f %7.4f\n", m.rigid, m.collision,
                   m.strain_mean, m.strain_p95, 100.0 * m.folded_triangles, m.new_intersections,
                   100.0 * m.pinned_drift, m.motion_ratio);
        }
        pc_skin_free(context, &skin);
    }
    if (good) {
        count_wins(values, &ours, t);
    } else {
        fprintf(stderr, "%s: %s\n", path, pc_context_error(context)->message);
    }
    fflush(stdout);
    pc_motion_free(context, &motion);
    pc_asset_free(context, &asset);
    return good;
}

static bool read_arguments(pc_context *context, int argc, char **argv, arguments *a) {
    int i = 1;
    bool good = true;
    a->options = pc_default_options();
    a->baseline_influences = 0;
    a->wind = 1001;
    for (; i + 1 < argc && strncmp(argv[i], "--", 2) == 0 && good; i += 2) {
        const unsigned long number = strtoul(argv[i + 1], NULL, 10);
        if (strcmp(argv[i], "--set") == 0) {
            good = set_option(context, &a->options, argv[i + 1]);
        } else if (strcmp(argv[i], "--baseline-influences") == 0) {
            a->baseline_influences = (uint32_t)number;
            good = number > 0 && number <= 32;
        } else if (strcmp(argv[i], "--wind") == 0) {
            a->wind = (uint32_t)number;
        } else {
            good = false;
        }
    }
    if (a->baseline_influences == 0) {
        a->baseline_influences = a->options.skin.influences;
    }
    a->first = i;
    return good && i < argc && strncmp(argv[i], "--", 2) != 0;
}

int main(int argc, char **argv) {
    bool good = true;
    pc_context *context = NULL;
    arguments a;
    tally t = {0};
    if (pc_context_create(NULL, &context) != PC_OK) {
        return 1;
    }
    if (!read_arguments(context, argc, argv, &a)) {
        fprintf(stderr,
                "usage: %s [--set OPTION=VALUE | --baseline-influences N | --wind SEED]... "
                "FILE.h5...\n",
                argv[0]);
        pc_context_destroy(context);
        return 2;
    }
    printf("%-32s %-16s %3s %9s %9s %8s %8s %8s %9s %8s %7s\n", "garment", "weights", "K", "L_r",
           "L_c", "strain", "p95", "fold %", "crossings", "drift %", "motion");
    for (int i = a.first; i < argc; ++i) {
        good = measure(context, argv[i], &a, &t) && good;
    }
    printf("\n%zu garments, wind %u, K = %u against %u; better than all others (than "
           "heat-smoothed):",
           t.garments, (unsigned)a.wind, (unsigned)a.options.skin.influences,
           (unsigned)a.baseline_influences);
    for (size_t x = 0; x < MEASURES; ++x) {
        printf(" %s %zu (%zu)", measure_names[x], t.won[x], t.beats_smoothed[x]);
    }
    printf("; all six %zu; motion ratio at least .97: %zu; drift at most .1 %%: %zu\n", t.all,
           t.moving, t.held);
    pc_context_destroy(context);
    return good ? 0 : 1;
}
