#include "proxycloth/baselines.h"
#include "stages/skin/skin_join.h"
#include "support/memory.h"
#include "support/skin_fixture.h"
#include "support/surfaces.h"

static const char *const fixture_names[] = {"tiny", "dress796", "fedora"};

static pc_skin_options quick_options(void) {
    pc_skin_options options;
    pc_record_set_defaults(&pc_skin_options_record, &options);
    options.epochs = 10;
    return options;
}

static void assert_valid_skin(const pc_skin *skin, size_t vertex_count, size_t proxy_count) {
    assert_int_equal(skin->vertex_count, vertex_count);
    for (size_t v = 0; v < vertex_count; ++v) {
        const uint32_t *bones = &skin->bones[v * skin->influences];
        const double *weights = &skin->weights[v * skin->influences];
        double sum = 0.0;
        for (uint32_t k = 0; k < skin->influences; ++k) {
            assert_true(weights[k] >= 0.0 && bones[k] < proxy_count);
            assert_true(k == 0 || weights[k] <= weights[k - 1]);
            assert_true(weights[k] > 0.0 || bones[k] == bones[0]);
            for (uint32_t j = 0; j < k && weights[k] > 0.0; ++j) {
                assert_true(bones[j] != bones[k]);
            }
            sum += weights[k];
        }
        assert_close(sum, 1.0, 1e-12);
    }
}

// Winds that were not trained on: better than following the closest triangle.
static void beats_the_closest_triangle(void **state) {
    (void)state;
    for (size_t i = 1; i < 3; ++i) {
        fixture f;
        load_fixture(fixture_names[i], 2, &f);
        pc_motion train = {0}, unseen = {0};
        make_motion(f.context, &f.proxy, 60, 1, &train);
        make_motion(f.context, &f.proxy, 60, 2, &unseen);
        pc_skin skin = {0}, baseline = {0};
        pc_skin_report report;
        pc_skin_losses ours, theirs;
        pc_skin_options options;
        pc_record_set_defaults(&pc_skin_options_record, &options);
        assert_ok(f.context, pc_skin_closest_triangle(f.context, &f.visual, &f.proxy, &baseline));
        assert_valid_skin(&baseline, f.visual.vertex_count, f.proxy.vertex_count);
        assert_ok(f.context, pc_skin_evaluate(f.context, &f.visual, &f.proxy, &unseen, &baseline,
                                              NULL, &theirs));
        assert_ok(f.context,
                  pc_skin_optimize(f.context, &f.visual, &f.proxy, &train, &options, &skin, NULL));
        assert_int_equal(skin.influences, 4);
        assert_ok(f.context,
                  pc_skin_evaluate(f.context, &f.visual, &f.proxy, &unseen, &skin, NULL, &ours));
        assert_true(ours.rigid < theirs.rigid && ours.collision < theirs.collision);
        pc_skin_free(f.context, &skin);
        options.influences = 8;      // the paper's
        options.lambda_follow = 0.0; // the paper's losses alone
        options.equal_edges = false;
        options.lambda_stretch = 0.0;
        assert_ok(f.context, pc_skin_optimize(f.context, &f.visual, &f.proxy, &train, &options,
                                              &skin, &report));
        assert_valid_skin(&skin, f.visual.vertex_count, f.proxy.vertex_count);
        assert_int_equal(skin.influences, 8);
        assert_ok(f.context,
                  pc_skin_evaluate(f.context, &f.visual, &f.proxy, &unseen, &skin, NULL, &ours));
        assert_true(ours.rigid < 0.6 * theirs.rigid);
        assert_true(ours.collision < 0.6 * theirs.collision);
        assert_true(report.loss_after < 0.6 * report.loss_before);
        assert_true(report.full_loss < report.loss_before);
        assert_true(report.rigid_after < report.rigid_before);
        assert_in_range(report.bones_used, 1, f.proxy.vertex_count);
        // The report is the losses of the result, in float.
        assert_ok(f.context,
                  pc_skin_evaluate(f.context, &f.visual, &f.proxy, &train, &skin, NULL, &ours));
        const double rigid = ours.rigid / (60.0 * ours.rigid_norm);
        const double collision = ours.collision / (60.0 * ours.collision_norm);
        assert_close(report.rigid_after, rigid, 1e-6 * rigid);
        assert_close(report.collision_after, collision, 1e-6 * collision);
        pc_skin_free(f.context, &skin);
        pc_skin_free(f.context, &baseline);
        pc_motion_free(f.context, &train);
        pc_motion_free(f.context, &unseen);
        free_fixture(&f);
    }
}

// Up to the most influences that the options take, where twice as many candidates are too many.
static void many_influences_work(void **state) {
    (void)state;
    fixture f;
    load_fixture("dress796", 1, &f);
    pc_motion motion = {0};
    make_motion(f.context, &f.proxy, 16, 1, &motion);
    for (uint32_t influences = 16; influences <= 32; influences += 8) {
        pc_skin skin = {0};
        pc_skin_options options;
        pc_record_set_defaults(&pc_skin_options_record, &options);
        options.influences = influences;
        options.rounds = 4;
        assert_ok(f.context,
                  pc_skin_optimize(f.context, &f.visual, &f.proxy, &motion, &options, &skin, NULL));
        assert_int_equal(skin.influences, influences);
        assert_valid_skin(&skin, f.visual.vertex_count, f.proxy.vertex_count);
        pc_skin_free(f.context, &skin);
    }
    pc_motion_free(f.context, &motion);
    free_fixture(&f);
}

// Two sheets close together, each with its own proxy, that slide apart: L_c cannot be satisfied and
// must not bend the sheets. With lambda_r = 0 it keeps its full weight.
static void collisions_do_not_cost_the_shape(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh surface = test_sheet(context, 12, 12, 1.0, 1.0),
            proxy = test_sheet(context, 4, 4, 1.0, 1.0);
    pc_mesh surfaces = {0}, proxies = {0};
    const pc_mesh *const parts[2] = {&surface, &proxy};
    pc_mesh *const pairs[2] = {&surfaces, &proxies};
    for (size_t i = 0; i < 2; ++i) {
        const size_t nv = parts[i]->vertex_count, nf = parts[i]->triangle_count;
        pairs[i]->vertex_count = 2 * nv;
        pairs[i]->triangle_count = 2 * nf;
        pairs[i]->positions = PCI_ALLOCATE(context, double, 6 * nv);
        pairs[i]->triangles = PCI_ALLOCATE(context, uint32_t, 6 * nf);
        for (size_t k = 0; k < 6 * nv; ++k) {
            pairs[i]->positions[k] =
                parts[i]->positions[k % (3 * nv)] + (k >= 3 * nv && k % 3 == 2 ? 0.02 : 0.0);
        }
        for (size_t k = 0; k < 6 * nf; ++k) {
            pairs[i]->triangles[k] =
                parts[i]->triangles[k % (3 * nf)] + (k >= 3 * nf ? (uint32_t)nv : 0);
        }
    }
    enum { FRAMES = 16 };
    const size_t np = proxies.vertex_count;
    double *frames = calloc(3 * np * FRAMES, sizeof(double));
    for (size_t t = 0; t < FRAMES; ++t) {
        for (size_t v = 0; v < np; ++v) {
            double *at = &frames[3 * (np * t + v)];
            memcpy(at, &proxies.positions[3 * v], 3 * sizeof(double));
            at[0] += (v < np / 2 ? 0.02 : -0.02) * (double)t;
            at[2] += 0.2 * sin(3.0 * at[0] + (double)t);
        }
    }
    const pc_motion motion = {.frame_count = FRAMES, .vertex_count = np, .positions = frames};
    pc_skin_options options = quick_options();
    options.epochs = 60;
    options.lambda_follow = 0.0;
    options.lambda_stretch = 0.0;
    pc_skin_report report;
    for (options.solver = 0; options.solver <= PC_SKIN_ADAMW; ++options.solver) {
        pc_skin skin = {0}, free_skin = {0};
        options.lambda_rigid = 1.0;
        assert_ok(context, pc_skin_optimize(context, &surfaces, &proxies, &motion, &options, &skin,
                                            &report));
        assert_true(report.collision_before > 2.0 * report.rigid_before);
        assert_true(report.spatial_share < 0.5 && report.spatial_share > 0.0);
        assert_true(report.rigid_after < 0.5 * report.rigid_before);
        options.lambda_rigid = 0.0;
        assert_ok(context, pc_skin_optimize(context, &surfaces, &proxies, &motion, &options,
                                            &free_skin, &report));
        assert_close(report.spatial_share, 1.0, 0.0);
        assert_true(report.collision_after < report.collision_before);
        pc_skin_free(context, &skin);
        pc_skin_free(context, &free_skin);
    }
    free(frames);
    pc_mesh_free(context, &surface);
    pc_mesh_free(context, &proxy);
    pc_mesh_free(context, &surfaces);
    pc_mesh_free(context, &proxies);
    pc_context_destroy(context);
}

static void threads_give_the_same_bytes(void **state) {
    (void)state;
    static const uint32_t threads[] = {1, 2, 3, 8};
    pc_skin first = {0};
    pc_skin_report first_report;
    for (size_t i = 0; i < 8; ++i) {
        fixture f;
        load_fixture("dress796", threads[i % 4], &f);
        pc_motion motion = {0};
        make_motion(f.context, &f.proxy, 37, 1, &motion);
        pc_skin_options options = quick_options();
        options.solver = i < 4 ? PC_SKIN_ALTERNATE : PC_SKIN_ADAMW;
        pc_skin skin = {0};
        pc_skin_report report;
        assert_ok(f.context, pc_skin_optimize(f.context, &f.visual, &f.proxy, &motion, &options,
                                              &skin, &report));
        pc_motion_free(f.context, &motion);
        if (i % 4 == 0) {
            first = skin;
            first_report = report;
        } else {
            const size_t count = skin.vertex_count * skin.influences;
            assert_memory_equal(skin.bones, first.bones, count * sizeof(uint32_t));
            assert_memory_equal(skin.weights, first.weights, count * sizeof(double));
            assert_memory_equal(&report, &first_report, sizeof(report));
            pc_skin_free(f.context, &skin);
        }
        if (i % 4 == 3) {
            pc_skin_free(f.context, &first);
        }
        free_fixture(&f);
    }
}

// A rigid translation deforms nothing; the unit of the file changes no weight.
static void translation_and_unit_do_not_matter(void **state) {
    (void)state;
    fixture f;
    load_fixture("tiny", 1, &f);
    pc_motion motion = {0};
    make_motion(f.context, &f.proxy, 16, 1, &motion);
    const pc_skin_options options = quick_options();
    pc_skin skin = {0}, scaled = {0};
    assert_ok(f.context,
              pc_skin_optimize(f.context, &f.visual, &f.proxy, &motion, &options, &skin, NULL));
    const size_t np = f.proxy.vertex_count;
    for (size_t k = 0; k < 3 * np * motion.frame_count; ++k) {
        motion.positions[k] *= 1024.0;
    }
    for (size_t k = 0; k < 3 * np; ++k) {
        f.proxy.positions[k] *= 1024.0;
    }
    for (size_t k = 0; k < 3 * f.visual.vertex_count; ++k) {
        f.visual.positions[k] *= 1024.0;
    }
    assert_ok(f.context,
              pc_skin_optimize(f.context, &f.visual, &f.proxy, &motion, &options, &scaled, NULL));
    for (size_t i = 0; i < 4 * f.visual.vertex_count; ++i) {
        assert_int_equal(skin.bones[i], scaled.bones[i]);
        assert_close(skin.weights[i], scaled.weights[i], 1e-9);
    }
    pc_skin_losses still, moving;
    for (size_t t = 0; t < motion.frame_count; ++t) {
        for (size_t k = 0; k < 3 * np; ++k) {
            motion.positions[3 * np * t + k] = f.proxy.positions[k];
        }
    }
    assert_ok(f.context,
              pc_skin_evaluate(f.context, &f.visual, &f.proxy, &motion, &scaled, NULL, &still));
    for (size_t k = 0; k < 3 * np * motion.frame_count; ++k) {
        motion.positions[k] += k % 3 == 0 ? 300.0 : -100.0;
    }
    assert_ok(f.context,
              pc_skin_evaluate(f.context, &f.visual, &f.proxy, &motion, &scaled, NULL, &moving));
    assert_close(moving.rigid, 0.0, 1e-18 * moving.rigid_norm);
    assert_close(moving.collision, 0.0, 1e-18 * moving.collision_norm);
    assert_close(moving.attachment, still.attachment, 1e-12 * still.attachment);
    pc_skin_free(f.context, &skin);
    pc_skin_free(f.context, &scaled);
    pc_motion_free(f.context, &motion);
    free_fixture(&f);
}

static void deforms_like_the_fixture(void **state) {
    (void)state;
    fixture f;
    load_fixture("tiny", 1, &f);
    size_t count = 0;
    double *reference = test_read_numbers(path_of(&f, "skinned_last.csv"), &count);
    assert_int_equal(count, 3 * f.visual.vertex_count);
    const pc_skin skin = {.vertex_count = f.visual.vertex_count,
                          .influences = f.problem.slots,
                          .bones = f.bones,
                          .weights = f.weights};
    pc_skin_deform(&skin, f.visual.positions, f.proxy.positions,
                   &f.frames[3 * f.proxy.vertex_count * (f.problem.frame_count - 1)], NULL,
                   f.visual.positions);
    for (size_t k = 0; k < count; ++k) {
        assert_close(f.visual.positions[k], reference[k], 1e-14);
    }
    free(reference);
    free_fixture(&f);
}

// Few proxy vertices, one frame, vertices without edges or on the same point, edges of length 0.
static void accepts_degenerate_input(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    double proxy_positions[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
    uint32_t proxy_triangle[3] = {0, 1, 2};
    const pc_mesh proxy = {3, proxy_positions, 1, proxy_triangle};
    double frame[9] = {0, 0, 0, 0, 0, 1, 0.5, 1, 0.5};
    const pc_motion motion = {.frame_count = 1, .vertex_count = 3, .positions = frame};
    double positions[21] = {0, 0, 0, 0.2, 0, 0, 0, 0.2, 0, 0, 0, 0, 5, 5, 5, 0, 0, 0, 0.2, 0, 0};
    uint32_t triangles[12] = {0, 1, 2, 3, 3, 5, 3, 0, 5, 6, 6, 6};
    pc_mesh surface = {7, positions, 4, triangles};
    pc_skin_options options = quick_options();
    for (uint32_t influences = 1; influences <= 12; influences += influences < 4 ? 3 : 8) {
        options.influences = influences;
        options.batch = influences == 4 ? 40 : 1;
        pc_skin skin = {0};
        pc_skin_losses losses;
        assert_ok(context,
                  pc_skin_optimize(context, &surface, &proxy, &motion, &options, &skin, NULL));
        assert_int_equal(skin.influences, influences);
        assert_valid_skin(&skin, 7, 3);
        assert_ok(context,
                  pc_skin_evaluate(context, &surface, &proxy, &motion, &skin, &options, &losses));
        assert_true(isfinite(losses.rigid + losses.collision + losses.attachment));
        pc_skin_free(context, &skin);
    }
    // A single point.
    surface.vertex_count = 1;
    surface.triangle_count = 1;
    memset(triangles, 0, sizeof(triangles));
    pc_skin skin = {0};
    assert_ok(context, pc_skin_optimize(context, &surface, &proxy, &motion, NULL, &skin, NULL));
    assert_valid_skin(&skin, 1, 3);
    pc_skin_free(context, &skin);
    pc_context_destroy(context);
}

// A row of triangles whose upper vertices are so far apart that a step of the lower ones is short.
static void vertices_close_by_are_joined(void **state) {
    (void)state;
    enum { COUNT = 8 };
    pc_context *context = test_context(1);
    double positions[6 * COUNT] = {0};
    uint32_t triangles[3 * (COUNT - 1)];
    for (uint32_t i = 0; i < COUNT; ++i) {
        positions[3 * i] = 0.6 * i;
        positions[3 * (COUNT + i)] = 100.0 * i;
        positions[3 * (COUNT + i) + 1] = 100.0;
    }
    for (uint32_t i = 0; i + 1 < COUNT; ++i) {
        const uint32_t corners[3] = {i, i + 1, COUNT + i};
        memcpy(&triangles[3 * i], corners, sizeof(corners));
    }
    const pc_mesh surface = {2 * COUNT, positions, COUNT - 1, triangles};
    pci_scratch scratch = pci_scratch_begin(context);
    pc_mesh joined;
    const uint32_t *rows = NULL;
    assert_true(pci_skin_join(&scratch, &surface, &joined, &rows));
    // A mean of about 200 joins up to 2: 0 to 1.8, then 2.4 to 4.2.
    assert_int_equal(joined.vertex_count, 2 + COUNT);
    assert_int_equal(joined.triangle_count, COUNT - 1);
    for (uint32_t i = 0; i < COUNT; ++i) {
        assert_int_equal(rows[i], i / 4);
        assert_int_equal(rows[COUNT + i], 2 + i);
    }
    for (size_t k = 0; k < 3 * (COUNT - 1); ++k) {
        assert_int_equal(joined.triangles[k], rows[triangles[k]]);
    }
    assert_close(joined.positions[3], 2.4, 0.0);
    // Nothing is short: the same mesh.
    for (uint32_t i = 0; i < COUNT; ++i) {
        positions[3 * i] = 10.0 * i;
    }
    assert_true(pci_skin_join(&scratch, &surface, &joined, &rows));
    assert_null(rows);
    assert_ptr_equal(joined.positions, positions);
    pci_scratch_end(&scratch);
    pc_context_destroy(context);
}

// Whatever the numbers of the vertices were, they stand in the same order.
static void vertices_are_sorted(void **state) {
    (void)state;
    fixture f;
    load_fixture("dress796", 1, &f);
    const size_t nv = f.visual.vertex_count, corners = 3 * f.visual.triangle_count;
    double *positions = calloc(3 * nv, sizeof(*positions));
    uint32_t *triangles = calloc(corners, sizeof(*triangles));
    for (size_t v = 0; v < nv; ++v) {
        memcpy(&positions[3 * (7 * v % nv)], &f.visual.positions[3 * v], 3 * sizeof(*positions));
    }
    for (size_t k = 0; k < corners; ++k) {
        triangles[k] = (uint32_t)(7 * f.visual.triangles[k] % nv);
    }
    const pc_mesh shuffled = {nv, positions, f.visual.triangle_count, triangles};
    const pc_mesh *meshes[2] = {&f.visual, &shuffled};
    pci_scratch scratch = pci_scratch_begin(f.context);
    pc_mesh sorted[2];
    const uint32_t *rows[2], *ranks[2];
    for (size_t m = 0; m < 2; ++m) {
        assert_true(pci_skin_sort(&scratch, meshes[m], &sorted[m], &rows[m], &ranks[m]));
        assert_int_equal(sorted[m].vertex_count, nv); // no edge is short
        for (size_t v = 0; v < nv; ++v) {
            assert_int_equal(ranks[m][rows[m][v]], v);
            assert_memory_equal(&sorted[m].positions[3 * (size_t)rows[m][v]],
                                &meshes[m]->positions[3 * v], 3 * sizeof(*positions));
        }
    }
    assert_memory_equal(sorted[0].positions, sorted[1].positions, 3 * nv * sizeof(*positions));
    for (size_t v = 0; v < nv; ++v) {
        assert_int_equal(rows[0][v], rows[1][7 * v % nv]);
    }
    pci_scratch_end(&scratch);
    free(positions);
    free(triangles);
    free_fixture(&f);
}

// What lies between two vertices that almost coincide is not stretched.
static void vertices_close_by_move_as_one(void **state) {
    (void)state;
    fixture f;
    load_fixture("dress796", 1, &f);
    const size_t nv = f.visual.vertex_count, nf = f.visual.triangle_count;
    double *positions = calloc(3 * (nv + 1), sizeof(*positions));
    uint32_t *triangles = calloc(3 * (nf + 1), sizeof(*triangles));
    memcpy(positions, f.visual.positions, 3 * nv * sizeof(*positions));
    memcpy(triangles, f.visual.triangles, 3 * nf * sizeof(*triangles));
    const uint32_t *first = f.visual.triangles;
    const uint32_t twins[3] = {first[0], (uint32_t)nv, first[1]};
    for (size_t c = 0; c < 3; ++c) {
        positions[3 * nv + c] =
            (1.0 - 1e-5) * positions[3 * first[0] + c] + 1e-5 * positions[3 * first[2] + c];
    }
    memcpy(&triangles[3 * nf], twins, sizeof(twins));
    const pc_mesh surface = {nv + 1, positions, nf + 1, triangles};
    pc_motion motion = {0};
    pc_skin skin = {0};
    make_motion(f.context, &f.proxy, 32, 1, &motion);
    assert_ok(f.context,
              pc_skin_optimize(f.context, &surface, &f.proxy, &motion, NULL, &skin, NULL));
    assert_valid_skin(&skin, nv + 1, f.proxy.vertex_count);
    for (size_t k = 0; k < skin.influences; ++k) {
        assert_int_equal(skin.bones[nv * skin.influences + k],
                         skin.bones[first[0] * skin.influences + k]);
        assert_close(skin.weights[nv * skin.influences + k],
                     skin.weights[first[0] * skin.influences + k], 0.0);
    }
    pc_skin_free(f.context, &skin);
    pc_motion_free(f.context, &motion);
    free(positions);
    free(triangles);
    free_fixture(&f);
}

static bool stop_half_way(void *user, const char *stage, double fraction) {
    (void)user;
    (void)stage;
    return fraction < 0.5;
}

static void errors_leave_nothing(void **state) {
    (void)state;
    pc_context *context = NULL;
    const pc_context_options context_options = {.threads = 1, .progress = stop_half_way};
    assert_int_equal(pc_context_create(&context_options, &context), PC_OK);
    double positions[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
    double frames[18] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 1, 1};
    uint32_t triangle[3] = {0, 1, 2};
    pc_mesh mesh = {3, positions, 1, triangle};
    pc_motion motion = {.frame_count = 2, .vertex_count = 3, .positions = frames};
    pc_skin skin = {0};
#define OPTIMIZE(options) pc_skin_optimize(context, &mesh, &mesh, &motion, options, &skin, NULL)
    assert_int_equal(OPTIMIZE(NULL), PC_ERROR_CANCELLED);
    assert_null(skin.bones);
    pc_skin_options options = quick_options();
    options.influences = 0;
    assert_int_equal(OPTIMIZE(&options), PC_ERROR_INVALID_OPTIONS);
    options = quick_options();
    options.max_bones = 4;
    options.reserve_bones = 2;
    assert_int_equal(OPTIMIZE(&options), PC_ERROR_TOO_LARGE);
    assert_non_null(strstr(pc_context_error(context)->message, "at most 2 proxy vertices"));
    options.reserve_bones = 4;
    assert_int_equal(OPTIMIZE(&options), PC_ERROR_TOO_LARGE);
    assert_non_null(strstr(pc_context_error(context)->message, "reserve_bones = 4 leaves none"));
    options.reserve_bones = 1; // just enough: goes on until it is cancelled
    assert_int_equal(OPTIMIZE(&options), PC_ERROR_CANCELLED);
    frames[13] = NAN;
    assert_int_equal(OPTIMIZE(NULL), PC_ERROR_NUMERICAL);
    assert_non_null(strstr(pc_context_error(context)->message, "frame 1"));
    frames[13] = 0.0;
    motion.vertex_count = 2;
    assert_int_equal(OPTIMIZE(NULL), PC_ERROR_INVALID_ARGUMENT);
    motion.vertex_count = 3;
    triangle[1] = 3;
    assert_int_equal(OPTIMIZE(NULL), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_skin_closest_triangle(context, &mesh, &mesh, &skin),
                     PC_ERROR_INVALID_ARGUMENT);
    triangle[1] = 1;
    positions[0] = INFINITY;
    assert_int_equal(OPTIMIZE(NULL), PC_ERROR_INVALID_ARGUMENT);
    positions[0] = 0.0;
    assert_int_equal(pc_skin_optimize(context, &mesh, &mesh, NULL, NULL, &skin, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_skin_optimize(context, NULL, &mesh, &motion, NULL, &skin, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_skin_optimize(context, &mesh, &mesh, &motion, NULL, NULL, NULL),
                     PC_ERROR_INVALID_ARGUMENT);
    assert_null(skin.bones);
    assert_null(skin.weights);

    assert_ok(context, pc_skin_closest_triangle(context, &mesh, &mesh, &skin));
    assert_int_equal(OPTIMIZE(NULL), PC_ERROR_INVALID_ARGUMENT); // the output is not empty
    pc_skin_losses losses;
    skin.bones[1] = 3;
    assert_int_equal(pc_skin_evaluate(context, &mesh, &mesh, &motion, &skin, NULL, &losses),
                     PC_ERROR_INVALID_ARGUMENT);
    pc_skin_free(context, &skin);
#undef OPTIMIZE
    pc_context_destroy(context);
}

// Every allocation fails once.
static void survives_failing_memory(void **state) {
    (void)state;
    double positions[12] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 1e-3, 1, 0}; // two are joined
    double frames[24] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0, 0, 0, 0, 1, 0, 0, 0, 1, 1, 1, 1, 1};
    uint32_t triangles[6] = {0, 1, 2, 1, 3, 2};
    const pc_mesh mesh = {4, positions, 2, triangles};
    const pc_motion motion = {.frame_count = 2, .vertex_count = 4, .positions = frames};
    pc_skin_options options = quick_options();
    options.epochs = 3;
    options.influences = 2;
    for (; options.solver <= PC_SKIN_ADAMW; ++options.solver) {
        counting_allocator counter = {0};
        pc_context *context = counting_context(&counter);
        starvation s = {.counter = &counter};
        while (starves(&s)) {
            pc_skin skin = {0};
            s.status = pc_skin_optimize(context, &mesh, &mesh, &motion, &options, &skin, NULL);
            assert_int_equal(skin.bones != NULL, s.status == PC_OK);
            assert_int_equal(skin.weights != NULL, s.status == PC_OK);
            pc_skin_free(context, &skin);
        }
        assert_true(s.failures > 10);
        pc_context_destroy(context);
    }
}

typedef struct byte_counter {
    size_t live, peak;
} byte_counter;

enum { SIZE_HEADER = 64 };

static void *allocate_bytes(void *user, size_t size) {
    byte_counter *counter = user;
    char *memory = malloc(size + SIZE_HEADER);
    if (memory == NULL) {
        return NULL;
    }
    memcpy(memory, &size, sizeof(size));
    counter->live += size;
    counter->peak = counter->live > counter->peak ? counter->live : counter->peak;
    return memory + SIZE_HEADER;
}

static void release_bytes(void *user, void *memory) {
    char *begin = (char *)memory - SIZE_HEADER;
    size_t size;
    memcpy(&size, begin, sizeof(size));
    ((byte_counter *)user)->live -= size;
    free(begin);
}

// Peak memory of finding weights for a sheet of so many vertices in each direction.
static size_t peak_of_sheet(uint32_t side, uint32_t influences, size_t *vertices) {
    enum { FRAMES = 20 };
    byte_counter counter = {0};
    const pc_context_options context_options = {
        .threads = 1, .allocator = {allocate_bytes, release_bytes, &counter}};
    pc_context *context = NULL;
    assert_int_equal(pc_context_create(&context_options, &context), PC_OK);
    pc_mesh surface = test_sheet(context, side, side, 1.0, 1.0),
            proxy = test_sheet(context, 6, 6, 1.0, 1.0);
    double *frames = calloc(3 * proxy.vertex_count * FRAMES, sizeof(*frames));
    for (size_t i = 0; i < FRAMES * proxy.vertex_count; ++i) {
        const double *from = &proxy.positions[3 * (i % proxy.vertex_count)];
        const double phase = 0.3 * (double)(i / proxy.vertex_count);
        memcpy(&frames[3 * i], from, 3 * sizeof(*frames));
        frames[3 * i + 2] += 0.2 * sin(phase) * sin(4.0 * from[0] + 3.0 * from[1] + phase);
    }
    const pc_motion motion = {
        .frame_count = FRAMES, .vertex_count = proxy.vertex_count, .positions = frames};
    pc_skin_options options = quick_options();
    options.influences = influences;
    options.rounds = 16;
    pc_skin skin = {0};
    const size_t before = counter.live;
    counter.peak = before;
    *vertices = surface.vertex_count;
    assert_ok(context, pc_skin_optimize(context, &surface, &proxy, &motion, &options, &skin, NULL));
    const size_t peak = counter.peak - before;
    pc_skin_free(context, &skin);
    pc_mesh_free(context, &surface);
    pc_mesh_free(context, &proxy);
    free(frames);
    pc_context_destroy(context);
    assert_int_equal(counter.live, 0);
    return peak;
}

// From one size to the next, so that what does not grow with the surface does not count.
static void memory_per_vertex_is_bounded(void **state) {
    (void)state;
    static const double most[2] = {1100.0, 1350.0};
    for (uint32_t i = 0; i < 2; ++i) {
        size_t vertices[2];
        const size_t small = peak_of_sheet(40, 4U << i, &vertices[0]);
        const size_t large = peak_of_sheet(80, 4U << i, &vertices[1]);
        const double bytes = (double)(large - small) / (double)(vertices[1] - vertices[0]);
        assert_true(bytes < most[i]);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(beats_the_closest_triangle),
        cmocka_unit_test(many_influences_work),
        cmocka_unit_test(collisions_do_not_cost_the_shape),
        cmocka_unit_test(threads_give_the_same_bytes),
        cmocka_unit_test(translation_and_unit_do_not_matter),
        cmocka_unit_test(deforms_like_the_fixture),
        cmocka_unit_test(accepts_degenerate_input),
        cmocka_unit_test(vertices_close_by_are_joined),
        cmocka_unit_test(vertices_are_sorted),
        cmocka_unit_test(vertices_close_by_move_as_one),
        cmocka_unit_test(errors_leave_nothing),
        cmocka_unit_test(survives_failing_memory),
        cmocka_unit_test(memory_per_vertex_is_bounded),
    };
    return cmocka_run_group_tests_name("skin", tests, NULL, NULL);
}
