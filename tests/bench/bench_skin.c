// What the solvers of the skinning weights reach, and what it costs.
// Usage: proxycloth_bench_skin [--threads N] [--subdivide N] [--influences N] [--no-adamw]
//                              [--no-rounds] FILE.obj...
//
// Seconds are CPU seconds of all threads together, which other programs on the machine hardly
// change; on idle cores wall time is that over the threads. "default" is the stage at its defaults,
// the row below with 8 influences, or as many as asked. The rows after these minimise the paper's
// energy with that many: 200 epochs of AdamW at its learning rate, and the default solver, the
// whole stage, with as many rounds as it takes by default and with more and more.
#define _POSIX_C_SOURCE 200809L
#include <malloc.h>
#include <time.h>

#include "geometry/topology.h"
#include "stages/skin/skin_alternate.h"
#include "stages/skin/skin_fit.h"
#include "support/garment.h"
#include "support/peak.h"

enum { NEIGHBOURS = 8 };

typedef struct bench {
    pc_context *context;
    pc_asset asset;
    uint32_t influences;
    uint32_t subdivisions;
    bool adamw, rounds; // whether to run AdamW, and the solver with other numbers of rounds
} bench;

static double cpu_seconds(void) {
    struct timespec time;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

// Splits every triangle in four at the middles of its edges.
static bool subdivide(pc_context *context, pc_asset *asset) {
    const pc_mesh *mesh = &asset->visual.surface;
    pci_scratch scratch = pci_scratch_begin(context);
    pci_topology topology;
    bool good = pci_topology_build(&scratch, mesh, &topology);
    const size_t nv = mesh->vertex_count;
    const size_t ne = good ? topology.edge_count : 0;
    double *positions = PCI_SCRATCH(&scratch, double, 3 * (nv + ne));
    uint32_t *triangles = PCI_SCRATCH(&scratch, uint32_t, 12 * mesh->triangle_count);
    good = good && !scratch.failed;
    if (good) {
        memcpy(positions, mesh->positions, 3 * nv * sizeof(*positions));
    }
    for (size_t e = 0; e < ne && good; ++e) {
        for (size_t c = 0; c < 3; ++c) {
            positions[3 * (nv + e) + c] =
                0.5 * (mesh->positions[3 * (size_t)topology.edges[2 * e] + c] +
                       mesh->positions[3 * (size_t)topology.edges[2 * e + 1] + c]);
        }
    }
    for (size_t t = 0; t < mesh->triangle_count && good; ++t) {
        uint32_t corner[3], middle[3];
        for (size_t c = 0; c < 3; ++c) {
            corner[c] = mesh->triangles[3 * t + c];
            const uint32_t edge = topology.triangle_edges[3 * t + c];
            middle[c] = edge != PC_INVALID_INDEX ? (uint32_t)(nv + edge) : corner[c];
        }
        const uint32_t split[12] = {corner[0], middle[0], middle[2], corner[1],
                                    middle[1], middle[0], corner[2], middle[2],
                                    middle[1], middle[0], middle[1], middle[2]};
        memcpy(&triangles[12 * t], split, sizeof(split));
    }
    if (good) {
        const pc_visual_arrays arrays = {.vertex_count = nv + ne,
                                         .positions = positions,
                                         .triangle_count = 4 * mesh->triangle_count,
                                         .triangles = triangles};
        pc_visual fine = {0};
        good = pc_visual_create(context, &arrays, &fine, NULL) == PC_OK;
        pc_visual_free(context, &asset->visual);
        asset->visual = fine;
    }
    pci_scratch_end(&scratch);
    return good;
}

static double mean_loss(const pc_skin_losses *losses, size_t frames) {
    const double norms[3] = {losses->rigid_norm, losses->collision_norm, losses->attachment_norm};
    const double values[3] = {losses->rigid, losses->collision, losses->attachment};
    const double lambda[3] = {1.0, 1.0, 0.1};
    double sum = 0.0;
    for (size_t x = 0; x < 3; ++x) {
        sum += norms[x] > 0.0 ? lambda[x] * values[x] / (norms[x] * (double)frames) : 0.0;
    }
    return sum;
}

static void print_row(const bench *b, const char *name, uint32_t steps, double seconds,
                      double mebibytes, const pc_skin *skin) {
    const pc_asset *asset = &b->asset;
    const pc_mesh *surface = &asset->visual.surface;
    pc_skin_losses losses = {0};
    if (pc_skin_evaluate(b->context, surface, &asset->proxy, &asset->motion, skin, NULL, &losses) !=
        PC_OK) {
        fprintf(stderr, "%s\n", pc_context_error(b->context)->message);
        return;
    }
    const double frames = (double)asset->motion.frame_count;
    printf("  %-16s %5u %9.3f %12.6g %12.6g %12.6g %8.1f\n", name, steps, seconds,
           mean_loss(&losses, asset->motion.frame_count),
           losses.rigid / (frames * losses.rigid_norm),
           losses.collision / (frames * losses.collision_norm),
           mebibytes * 1048576.0 / 1000.0 / (double)surface->vertex_count);
    fflush(stdout);
}

static void set_motion(const pc_asset *asset, const pc_skin *skin, pci_skin_problem *problem) {
    problem->proxy_count = asset->proxy.vertex_count;
    problem->proxy_rest = asset->proxy.positions;
    problem->frame_count = asset->motion.frame_count;
    problem->frames = asset->motion.positions;
    problem->slots = skin->influences;
    problem->bones = skin->bones;
}

// The default solver on the paper's energy, all candidates.
static bool alternate(pci_scratch *scratch, const pc_asset *asset, const pci_skin_problem *problem,
                      pci_place *closest, const pc_skin_options *chosen, pc_skin *skin,
                      uint32_t *rounds) {
    const double lambda[4] = {1.0, 1.0, 0.1, 0.0};
    const pci_skin_kernel *kernel = pci_skin_kernel_float();
    pc_skin_options options = *chosen;
    options.lambda_follow = options.lambda_stretch = 0.0;
    uint32_t left = options.rounds;
    pci_skin_gram gram;
    pci_skin_alternation alternation;
    pci_skin_fit fit = {.context = scratch->context,
                        .options = &options,
                        .surface = &asset->visual.surface,
                        .proxy = &asset->proxy,
                        .problem = *problem,
                        .closest = closest,
                        .bones = skin->bones,
                        .weights = skin->weights,
                        .spatial_share = 1.0,
                        .follow_share = 1.0};
    const bool good =
        pc_skin_closest_triangle(scratch->context, fit.surface, fit.proxy, &fit.followed) ==
            PC_OK &&
        pci_skin_gram_build(scratch, problem, kernel, fit.proxy, 0.0, PCI_SKIN_DENSE_MOST, &gram) &&
        pci_skin_start_from_coarse(&fit, &gram, &left) == PC_OK &&
        pci_skin_alternation_build(scratch, problem, kernel, &gram, &alternation) &&
        pci_skin_alternation_weigh(scratch, &alternation, lambda, 0.0) &&
        pci_skin_alternation_run(&alternation, options.rounds, options.round_gain, false, 0.0, 1.0,
                                 skin->weights) == PC_OK;
    *rounds = alternation.rounds;
    pc_skin_free(scratch->context, &fit.followed);
    return good;
}

// The paper's energy, from the first guess of the stage: by its optimiser and settings, `batch`
// frames at a time; or by the default one, `chosen` not NULL.
static bool run_paper(bench *b, const char *name, uint32_t batch, const pc_skin_options *chosen) {
    enum { EPOCHS = 200 };
    const pc_asset *asset = &b->asset;
    const pc_mesh *surface = &asset->visual.surface;
    const size_t nv = surface->vertex_count;
    const double lambda[3] = {1.0, 1.0, 0.1};
    pci_scratch scratch = pci_scratch_begin(b->context);
    pci_skin_problem problem;
    (void)malloc_trim(0); // what earlier calls gave back is not there to be used again
    reset_peak();
    const double before = peak_mebibytes(), start = cpu_seconds();
    const uint32_t slots = b->influences;
    uint32_t steps = EPOCHS;
    pc_skin skin = {.vertex_count = nv, .influences = slots};
    skin.bones = PCI_SCRATCH(&scratch, uint32_t, slots * nv);
    skin.weights = PCI_SCRATCH(&scratch, double, slots *nv);
    pci_place *closest = PCI_SCRATCH(&scratch, pci_place, nv);
    bool good = !scratch.failed &&
                pci_skin_problem_build(&scratch, surface, NULL, NEIGHBOURS, &problem) &&
                pci_closest_points(b->context, "skin", surface, &asset->proxy, closest) == PC_OK &&
                pci_skin_find_candidates(&scratch, surface, &asset->proxy, closest, NULL, slots,
                                         skin.bones, skin.weights);
    if (good) {
        set_motion(asset, &skin, &problem);
    }
    if (good && chosen == NULL) {
        const pci_skin_descent settings = {.lambda = {lambda[0], lambda[1], lambda[2]},
                                           .epochs = EPOCHS,
                                           .batch = batch,
                                           .learning_rate = 1e-3,
                                           .weight_decay = 0.01,
                                           .epsilon = 1e-8 / (double)nv,
                                           .seed = 1};
        good = pci_skin_descend(b->context, &problem, pci_skin_kernel_float(), &settings,
                                skin.weights) == PC_OK;
    }
    for (size_t v = 0; v < nv && good; ++v) {
        double row[PCI_SKIN_CANDIDATES_MAX];
        pci_skin_normalize(&skin.weights[slots * v], slots, row);
        memcpy(&skin.weights[slots * v], row, slots * sizeof(*row));
    }
    if (good && chosen != NULL) {
        good = alternate(&scratch, asset, &problem, closest, chosen, &skin, &steps);
    }
    const double seconds = cpu_seconds() - start, peak = peak_mebibytes() - before;
    if (good) {
        print_row(b, name, steps, seconds, peak, &skin);
    }
    pci_scratch_end(&scratch);
    return good;
}

// Losses and gradient in float, in CPU nanoseconds per vertex and frame; the best of some.
static bool run_kernel(bench *b) {
    const pc_asset *asset = &b->asset;
    const pc_skin *skin = &asset->skin;
    pci_scratch scratch = pci_scratch_begin(b->context);
    pci_skin_problem problem;
    pci_skin_frames frames;
    bool good =
        pci_skin_problem_build(&scratch, &asset->visual.surface, NULL, NEIGHBOURS, &problem);
    if (good) {
        set_motion(asset, skin, &problem);
        good = pci_skin_frames_build_sequential(&scratch, &problem, pci_skin_kernel_float(),
                                                &frames) &&
               pci_skin_frames_make_room(&scratch, &frames);
    }
    pci_skin_measures *measures =
        good ? PCI_SCRATCH(&scratch, pci_skin_measures, frames.patch_count) : NULL;
    double best[3] = {INFINITY, INFINITY, INFINITY};
    for (size_t i = 0; i < 60 && measures != NULL; ++i) {
        for (size_t x = 0; x < 4; ++x) {
            frames.data.scale[x] = x < 3 || i % 3 == 2 ? 1.0 : 0.0;
        }
        const double start = cpu_seconds();
        good = pci_skin_frames_evaluate(&frames, skin->weights, 0, frames.block_count, 1, true,
                                        i % 3 == 0 ? NULL : measures);
        const double seconds = cpu_seconds() - start;
        best[i % 3] = seconds < best[i % 3] ? seconds : best[i % 3];
    }
    const double scale = 1e9 / ((double)problem.vertex_count * (double)problem.frame_count);
    printf(
        "  one evaluation, ns per vertex and frame: gradient %.1f, and losses %.1f, and L_s %.1f\n",
        best[0] * scale, best[1] * scale, best[2] * scale);
    pci_scratch_end(&scratch);
    return good && measures != NULL;
}

static bool run_stage(bench *b, const char *name, const pc_skin_options *options) {
    const pc_asset *asset = &b->asset;
    pc_skin skin = {0};
    pc_skin_report report;
    (void)malloc_trim(0); // what earlier calls gave back is not there to be used again
    reset_peak();
    const double before = peak_mebibytes(), start = cpu_seconds();
    const bool good = pc_skin_optimize(b->context, &asset->visual.surface, &asset->proxy,
                                       &asset->motion, options, &skin, &report) == PC_OK;
    const double seconds = cpu_seconds() - start, peak = peak_mebibytes() - before;
    if (good) {
        print_row(b, name, (uint32_t)report.rounds, seconds, peak, &skin);
    }
    pc_skin_free(b->context, &skin);
    return good;
}

static bool run_alternate(bench *b) {
    pc_skin_options options;
    pc_record_set_defaults(&pc_skin_options_record, &options);
    bool good = run_paper(b, "alternate", 0, &options);
    options.round_gain = 0.0;
    for (uint32_t rounds = 0; rounds <= 64 && good && b->rounds;
         rounds = rounds < 4 ? rounds + 4 : 2 * rounds) {
        options.rounds = rounds;
        good = run_paper(b, "rounds", 0, &options);
    }
    return good;
}

static bool run_garment(bench *b, const char *path) {
    pc_options options = pc_default_options();
    pc_asset *asset = &b->asset;
    bool good = load_garment(b->context, path, asset);
    for (uint32_t i = 0; i < b->subdivisions && good; ++i) {
        good = subdivide(b->context, asset);
    }
    for (pc_stage stage = 0; stage <= PC_STAGE_SIMULATE && good; ++stage) {
        good = pc_run_stage(b->context, stage, &options, asset, NULL) == PC_OK;
    }
    if (!good) {
        return false;
    }
    printf("%s, %zu vertices, %zu frames\n", asset->name, asset->visual.surface.vertex_count,
           asset->motion.frame_count);
    printf("  %-16s %5s %9s %12s %12s %12s %8s\n", "", "steps", "CPU s", "loss", "L_r", "L_c",
           "kB/vert");
    pc_options wide = options;
    wide.skin.influences = b->influences;
    // The first run also loads the code, which is no memory of the stage.
    good = pc_run_stage(b->context, PC_STAGE_SKIN, &wide, asset, NULL) == PC_OK &&
           run_stage(b, "default", &options.skin) && run_stage(b, "influences", &wide.skin) &&
           run_kernel(b);
    if (good && b->adamw) {
        good = run_paper(b, "AdamW, full", (uint32_t)asset->motion.frame_count, NULL) &&
               run_paper(b, "AdamW, batches", 16, NULL);
    }
    return good && run_alternate(b);
}

int main(int argc, char **argv) {
    uint32_t threads = 1;
    bench b = {.influences = 8, .adamw = true, .rounds = true};
    int first = 1;
    for (; first < argc && strncmp(argv[first], "--", 2) == 0; ++first) {
        const char *value = first + 1 < argc ? argv[first + 1] : "";
        if (strcmp(argv[first], "--no-adamw") == 0) {
            b.adamw = false;
        } else if (strcmp(argv[first], "--no-rounds") == 0) {
            b.rounds = false;
        } else {
            uint32_t *number = strcmp(argv[first], "--threads") == 0      ? &threads
                               : strcmp(argv[first], "--subdivide") == 0  ? &b.subdivisions
                               : strcmp(argv[first], "--influences") == 0 ? &b.influences
                                                                          : NULL;
            if (number == NULL) {
                first = argc;
                break;
            }
            *number = (uint32_t)strtoul(value, NULL, 10);
            ++first;
        }
    }
    if (first >= argc || b.influences == 0 || b.influences > PCI_SKIN_CANDIDATES_MAX) {
        fprintf(stderr,
                "usage: %s [--threads N] [--subdivide N] [--influences N] [--no-adamw] "
                "[--no-rounds] FILE.obj...\n",
                argv[0]);
        return 2;
    }
    const pc_context_options context_options = {.threads = threads};
    if (pc_context_create(&context_options, &b.context) != PC_OK) {
        return 1;
    }
    int result = 0;
    for (int i = first; i < argc; ++i) {
        if (!run_garment(&b, argv[i])) {
            fprintf(stderr, "%s: %s\n", argv[i], pc_context_error(b.context)->message);
            result = 1;
        }
        pc_asset_free(b.context, &b.asset);
        memset(&b.asset, 0, sizeof(b.asset));
    }
    pc_context_destroy(b.context);
    return result;
}
