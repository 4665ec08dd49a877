#include "proxycloth/baselines.h"
#include "proxycloth/evaluate_motion.h"
#include "stages/skin/skin_alternate.h"
#include "stages/skin/skin_coarse.h"
#include "stages/skin/skin_fit.h"
#include "stages/skin/skin_matrix.h"
#include "support/skin_fixture.h"

// ---- the quadratic ------------------------------------------------------------------------------

static const char *const moving_names[] = {"dress796", "fedora"};
static const double lambda_all[4] = {1.0, 1.0, 0.1, 0.0};

typedef struct solver {
    fixture f;
    pc_motion motion;
    pc_skin followed;
    pci_skin_gram gram;
    pci_skin_alternation a;
} solver;

static void open_any(const char *name, uint32_t frames, uint32_t threads, double follow,
                     bool turned, double noise, size_t dense_most, solver *s) {
    load_fixture(name, threads, &s->f);
    memset(&s->motion, 0, sizeof(s->motion));
    memset(&s->followed, 0, sizeof(s->followed));
    make_motion(s->f.context, &s->f.proxy, frames, 1, &s->motion);
    s->f.problem.frame_count = frames;
    s->f.problem.frames = s->motion.positions;
    if (turned) {
        s->f.rotations = calloc(4 * s->f.problem.proxy_count * frames, sizeof(double));
        assert_ok(s->f.context, pc_rotation_estimate_motion(s->f.context, &s->f.proxy, &s->motion,
                                                            s->f.rotations));
        s->f.problem.rotations = s->f.rotations;
    }
    const pci_skin_kernel *kernel = pci_skin_kernel_double();
    assert_true(pci_skin_gram_build(&s->f.scratch, &s->f.problem, kernel, &s->f.proxy, noise,
                                    dense_most, &s->gram));
    assert_true(pci_skin_alternation_build(&s->f.scratch, &s->f.problem, kernel, &s->gram, &s->a));
    assert_ok(s->f.context,
              pc_skin_closest_triangle(s->f.context, &s->f.visual, &s->f.proxy, &s->followed));
    pci_skin_alternation_follow(&s->a, &s->f.proxy, &s->followed);
    assert_true(pci_skin_alternation_weigh(&s->f.scratch, &s->a, lambda_all, follow));
}

static void open_noisy(const char *name, uint32_t frames, uint32_t threads, double follow,
                       bool turned, double noise, solver *s) {
    open_any(name, frames, threads, follow, turned, noise, PCI_SKIN_DENSE_MOST, s);
}

static void open_solver(const char *name, uint32_t frames, uint32_t threads, double follow,
                        bool turned, solver *s) {
    open_noisy(name, frames, threads, follow, turned, 0.0, s);
}

static void close_solver(solver *s) {
    pc_skin_free(s->f.context, &s->followed);
    pc_motion_free(s->f.context, &s->motion);
    free_fixture(&s->f);
}

// The vertex of an entry of M in the row of a member.
static size_t column(const pci_skin_quadratic *q, size_t member, size_t entry) {
    return q->known[q->known_offsets[member / PCI_SKIN_GROUP] + q->entries[entry]];
}

static double gradient_of(const solver *s, size_t member, size_t slot) {
    return (double)
        s->a.gradient[member / PCI_SKIN_GROUP][member % PCI_SKIN_GROUP * s->f.problem.slots + slot];
}

// u^T M u = 2 (sum of the squared differences of each term, of L_a those that bound it), for random
// u. M is kept in single precision.
static void the_matrix_is_that_of_the_losses(void **state) {
    (void)state;
    solver s;
    open_solver("fedora", 4, 1, 0.7, false, &s);
    const pci_skin_problem *p = &s.f.problem;
    const double lambda[4] = {1.0, 0.5, 0.1, 2.0};
    assert_true(pci_skin_alternation_weigh(&s.f.scratch, &s.a, lambda, 0.7));
    const pci_skin_quadratic *q = &s.a.quadratic;
    const double *scale = s.a.scale;
    const size_t nv = p->vertex_count;
    double *u = calloc(nv, sizeof(double));
    for (uint64_t seed = 0; seed < 4; ++seed) {
        double form = 0.0, direct = 0.0, attached_bound = 0.0, attached_exact = 0.0;
        for (size_t v = 0; v < nv; ++v) {
            u[v] = pci_random(seed, 0, v) - 0.5;
        }
        for (size_t m = 0; m < nv; ++m) {
            const size_t v = q->members[m];
            assert_int_equal(column(q, m, q->offsets[m]), v);
            for (size_t e = q->offsets[m]; e < q->offsets[m + 1]; ++e) {
                form += u[v] * (double)q->values[e] * u[column(q, m, e)];
            }
            double attached = u[v];
            for (size_t e = p->ring_offsets[v]; e < p->ring_offsets[v + 1]; ++e) {
                direct +=
                    pci_skin_ring_scale(scale) * (u[v] - u[p->ring[e]]) * (u[v] - u[p->ring[e]]);
            }
            for (size_t e = v * p->near_count; e < (v + 1) * p->near_count; ++e) {
                const double square = (u[v] - u[p->near[e]]) * (u[v] - u[p->near[e]]);
                direct += scale[1] * square;
                attached_bound += pci_skin_near_weight(p, v, e) * square;
                attached -= pci_skin_near_weight(p, v, e) * u[p->near[e]];
            }
            attached_exact += attached * attached;
            direct += s.a.follow * u[v] * u[v];
        }
        direct += scale[2] * attached_bound;
        assert_true(attached_exact <= attached_bound);
        assert_close(form, 2.0 * direct, 1e-6 * direct);
    }
    free(u);
    close_solver(&s);
}

static void groups_of_one_colour_share_nothing(void **state) {
    (void)state;
    solver s;
    open_solver("dress796", 2, 1, 1.0, false, &s);
    const pci_skin_quadratic *q = &s.a.quadratic;
    const size_t nv = s.f.problem.vertex_count;
    uint32_t *group = calloc(nv, sizeof(uint32_t)), *colour = calloc(nv, sizeof(uint32_t));
    size_t members = 0;
    for (uint32_t i = 0; i < q->group_count; ++i) {
        const uint32_t g = q->groups[i];
        assert_true(i == 0 || q->colours[g] >= q->colours[q->groups[i - 1]]);
        assert_int_equal(q->colours[q->groups[2 * q->group_count - 1 - i]], q->colours[g]);
        for (size_t m = pci_skin_group_begin(q, g); m < pci_skin_group_begin(q, g + 1); ++m) {
            assert_int_equal(colour[q->members[m]], 0); // each vertex once
            colour[q->members[m]] = q->colours[g];
            group[q->members[m]] = g;
            assert_int_equal(q->group_of[q->members[m]], g);
            ++members;
        }
    }
    assert_int_equal(members, nv);
    for (size_t m = 0; m < nv; ++m) {
        const size_t v = q->members[m];
        for (size_t e = q->offsets[m]; e < q->offsets[m + 1]; ++e) {
            const size_t j = column(q, m, e);
            assert_true(group[v] == group[j] || colour[v] != colour[j]);
        }
    }
    free(group);
    free(colour);
    close_solver(&s);
}

// x^T G y of two slots, as the quadratic has it.
static double product_of(const solver *s, size_t i, size_t j) {
    const pci_skin_problem *p = &s->f.problem;
    const size_t columns = s->a.frames.data.columns;
    return pci_skin_gram_product(s->gram.matrix, p->proxy_count, columns, p->bones[i], p->bones[j],
                                 &s->a.frames.points[pci_skin_point_at(i / p->slots, columns)],
                                 &s->a.frames.points[pci_skin_point_at(j / p->slots, columns)]);
}

// Products of displacements, summed over the frames: what one proxy vertex does to one vertex times
// what another does to another. Of each frame the mean over the proxy is left out, which is that of
// what it does to the middle of the garment.
static void the_gram_matrix_is_that_of_the_displacements(void **state) {
    (void)state;
    for (size_t turned = 0; turned < 2; ++turned) {
        solver s;
        open_solver("tiny", 12, 1, 1.0, turned == 1, &s);
        const pci_skin_problem *p = &s.f.problem;
        const size_t count = s.f.count;
        double *means = calloc(3 * p->frame_count, sizeof(double));
        for (size_t t = 0; t < p->frame_count; ++t) {
            for (size_t b = 0; b < p->proxy_count; ++b) {
                double map[3 * PCI_SKIN_COLUMNS_MAX];
                pci_skin_bone_map(p, s.a.frames.origin, t, b, map);
                for (size_t c = 0; c < 3; ++c) {
                    means[3 * t + c] += map[c] / (double)p->proxy_count;
                }
            }
        }
        for (size_t i = 0; i < count; i += 7) {
            for (size_t j = 0; j < count; j += 5) {
                double sum = 0.0, size = 0.0, u[3], v[3];
                for (size_t t = 0; t < p->frame_count; ++t) {
                    displacement_by(&s.f, t, p->bones[i], i / p->slots, u);
                    displacement_by(&s.f, t, p->bones[j], j / p->slots, v);
                    pci_sub(u, &means[3 * t], u);
                    pci_sub(v, &means[3 * t], v);
                    sum += pci_dot(u, v);
                    size += pci_norm(u) * pci_norm(v);
                }
                assert_close(product_of(&s, i, j), sum, 1e-10 * size);
            }
        }
        free(means);
        close_solver(&s);
    }
}

// Without a matrix the same numbers come from what is kept of it: the weights and the losses are
// the same but for rounding.
static void pairs_do_for_the_matrix(void **state) {
    (void)state;
    for (size_t turned = 0; turned < 2; ++turned) {
        solver s[2];
        double *weights[2];
        pci_skin_measures measures[2];
        for (size_t i = 0; i < 2; ++i) {
            open_any("dress796", 48, 1, 0.7, turned == 1, 0.2, i == 0 ? PCI_SKIN_DENSE_MOST : 0,
                     &s[i]);
            assert_true((s[i].gram.matrix == NULL) == (i == 1));
            weights[i] = calloc(s[i].f.count, sizeof(double));
            memcpy(weights[i], s[i].f.weights, s[i].f.count * sizeof(double));
            assert_ok(s[i].f.context,
                      pci_skin_alternation_run(&s[i].a, 6, 0.0, false, 0.0, 1.0, weights[i]));
            measures[i] = (pci_skin_measures){0};
            assert_ok(s[i].f.context, pci_skin_alternation_measure(&s[i].a, PCI_SKIN_ALL,
                                                                   weights[i], &measures[i]));
        }
        assert_close(s[1].gram.noise, s[0].gram.noise, 1e-9 * s[0].gram.noise);
        for (size_t x = 0; x < 3; ++x) {
            const double loss = measures[0].losses[x];
            assert_close(measures[1].losses[x], loss, 1e-6 * loss);
        }
        for (size_t k = 0; k < s[0].f.count; ++k) {
            assert_close(weights[1][k], weights[0][k], 1e-4);
        }
        free(weights[0]);
        free(weights[1]);
        close_solver(&s[0]);
        close_solver(&s[1]);
    }
}

// What pairs hold is the matrix.
static void pairs_are_entries_of_the_matrix(void **state) {
    (void)state;
    for (size_t turned = 0; turned < 2; ++turned) {
        solver s;
        open_any("tiny", 48, 1, 0.7, turned == 1, 0.2, PCI_SKIN_DENSE_MOST, &s);
        solver t;
        open_any("tiny", 48, 1, 0.7, turned == 1, 0.2, 0, &t);
        for (size_t level = 0; level < PCI_SKIN_LEVELS; ++level) {
            pci_skin_gram_use(&s.gram, (pci_skin_level)level, NULL);
            pci_skin_gram_use(&t.gram, (pci_skin_level)level, &t.a.pairs);
            const size_t columns = s.a.frames.data.columns,
                         side = s.f.problem.proxy_count * columns;
            const pci_skin_pairs *pairs = &t.a.pairs;
            assert_true(pairs->offsets[s.f.problem.proxy_count] > s.f.problem.proxy_count);
            for (size_t b = 0; b < s.f.problem.proxy_count; ++b) {
                const double scale = fabs(s.gram.matrix[b * columns * (side + 1)]);
                for (size_t e = pairs->offsets[b]; e < pairs->offsets[b + 1]; ++e) {
                    for (size_t k = 0; k < columns * columns; ++k) {
                        const size_t row = b * columns + k / columns;
                        const size_t column_at = pairs->others[e] * columns + k % columns;
                        assert_close(pairs->values[e * columns * columns + k],
                                     s.gram.matrix[row * side + column_at], 1e-9 * (scale + 1.0));
                    }
                }
            }
        }
        close_solver(&s);
        close_solver(&t);
    }
}

// The variance of the noise, written out: a share of the mean square of how far the displacements
// of vertices that an edge of the proxy joins are apart, summed over the frames.
static void noise_is_a_share_of_what_parts_neighbours(void **state) {
    (void)state;
    solver s;
    open_noisy("tiny", 12, 1, 0.7, false, 0.5, &s);
    const pci_skin_problem *p = &s.f.problem;
    const pc_mesh *proxy = &s.f.proxy;
    const double unit = s.a.frames.unit;
    double sum = 0.0;
    for (size_t k = 0; k < 3 * proxy->triangle_count; ++k) {
        const size_t i = proxy->triangles[k];
        const size_t j = proxy->triangles[k % 3 == 2 ? k - 2 : k + 1];
        for (size_t t = 0; t < p->frame_count; ++t) {
            const double *frame = &p->frames[3 * p->proxy_count * t];
            for (size_t c = 0; c < 3; ++c) {
                const double apart = (frame[3 * i + c] - p->proxy_rest[3 * i + c]) -
                                     (frame[3 * j + c] - p->proxy_rest[3 * j + c]);
                sum += unit * unit * apart * apart;
            }
        }
    }
    assert_true(sum > 0.0);
    const double expected = 0.5 * sum / (3.0 * (double)proxy->triangle_count);
    assert_close(s.gram.noise, expected, 1e-9 * expected);
    close_solver(&s);
}

// What the noise adds to dE/dW: s sum_j M_ij (w_j - b_j / 2) in all terms but L_f, and
// 2 s f_i (w_i - b_i) in L_f, of the bone of each slot.
static void noise_pulls_as_its_energy_says(void **state) {
    const bool turned = *state != NULL;
    solver plain, noisy;
    open_solver("tiny", 12, 1, 0.7, turned, &plain);
    open_noisy("tiny", 12, 1, 0.7, turned, 0.5, &noisy);
    const pci_skin_problem *p = &noisy.f.problem;
    const pci_skin_quadratic *q = &noisy.a.quadratic;
    const size_t slots = p->slots, count = noisy.f.count, influences = noisy.followed.influences;
    const double noise = noisy.gram.noise;
    double *w = calloc(count, sizeof(double)), *pull = calloc(p->proxy_count, sizeof(double));
    solver *both[] = {&plain, &noisy};
    for (size_t i = 0; i < 2; ++i) {
        pci_skin_measures measures;
        memcpy(w, noisy.f.weights, count * sizeof(double));
        assert_ok(both[i]->f.context,
                  pci_skin_alternation_prune(&both[i]->a, (uint32_t)slots, w, &measures));
    }
    double largest = 0.0;
    for (size_t i = 0; i < count; ++i) {
        largest = fmax(largest, fabs(gradient_of(&noisy, i / slots, i % slots)));
    }
    assert_true(noise > 0.0 && plain.gram.noise == 0.0);
    memcpy(w, noisy.f.weights, count * sizeof(double));
    for (size_t r = 0; r < p->vertex_count; ++r) {
        const size_t v = q->members[r];
        const double follow = 2.0 * noisy.a.follow;
        memset(pull, 0, p->proxy_count * sizeof(double));
        for (size_t e = q->offsets[r]; e < q->offsets[r + 1]; ++e) {
            const size_t j = column(q, r, e);
            const double m = (double)q->values[e];
            for (size_t k = j * slots; k < (j + 1) * slots; ++k) {
                pull[p->bones[k]] += noise * m * w[k];
            }
            for (size_t l = j * influences; l < (j + 1) * influences; ++l) {
                const double rest = j == v ? m - follow : m;
                pull[noisy.followed.bones[l]] -=
                    noise * (0.5 * rest + (j == v ? follow : 0.0)) * noisy.followed.weights[l];
            }
        }
        for (size_t k = 0; k < slots; ++k) {
            assert_close(gradient_of(&noisy, r, k) - gradient_of(&plain, r, k),
                         pull[p->bones[v * slots + k]], 1e-6 * largest);
        }
    }
    free(w);
    free(pull);
    close_solver(&plain);
    close_solver(&noisy);
}

// Sweeps solve the whole convex program: the gradient H (W - W0) + g0, written out, meets the
// optimality conditions in every row.
static void sweeps_reach_the_minimum(void **state) {
    const bool turned = *state != NULL;
    solver s;
    open_solver("tiny", 12, 1, 1.0, turned, &s);
    const pci_skin_problem *p = &s.f.problem;
    const pci_skin_quadratic *q = &s.a.quadratic;
    const size_t slots = p->slots, count = s.f.count;
    double *w = calloc(count, sizeof(double)), scale = 0.0;
    float *g0 = calloc(count, sizeof(float)), *moved = calloc(count, sizeof(float));
    float **groups = calloc(q->group_count, sizeof(float *));
    for (size_t g = 0; g < q->group_count; ++g) {
        groups[g] = &g0[pci_skin_group_begin(q, g) * slots];
    }
    for (size_t i = 0; i < count; ++i) {
        const size_t slot = q->members[i / slots] * slots + i % slots;
        const double g = product_of(&s, slot, slot);
        g0[i] = (float)(g * (double)q->values[0] * (pci_random(3, 1, i) - 0.5));
        scale = fabs((double)g0[i]) > scale ? fabs((double)g0[i]) : scale;
    }
    memcpy(w, s.f.weights, count * sizeof(double));
    for (uint32_t round = 0; round < 250; ++round) {
        pci_skin_quadratic_sweep(q, groups, 8, moved, w);
        for (size_t i = 0; i < count; ++i) {
            moved[i] = (float)(w[i] - s.f.weights[i]);
        }
    }
    size_t free_slots = 0;
    for (size_t m = 0; m < p->vertex_count; ++m) {
        const size_t v = q->members[m];
        double g[PCI_SKIN_SLOTS_MAX], lowest = INFINITY;
        for (size_t k = 0; k < slots; ++k) {
            g[k] = (double)g0[m * slots + k];
            for (size_t e = q->offsets[m]; e < q->offsets[m + 1]; ++e) {
                const size_t j = column(q, m, e);
                for (size_t l = j * slots; l < (j + 1) * slots; ++l) {
                    g[k] += (double)q->values[e] * (w[l] - s.f.weights[l]) *
                            product_of(&s, v * slots + k, l);
                }
            }
            lowest = g[k] < lowest ? g[k] : lowest;
        }
        for (size_t k = 0; k < slots; ++k) {
            free_slots += w[v * slots + k] > 1e-6;
            assert_true(w[v * slots + k] < 1e-6 || g[k] - lowest < 1e-4 * scale);
        }
    }
    assert_true(free_slots > p->vertex_count);
    free(groups);
    free(g0);
    free(moved);
    free(w);
    close_solver(&s);
}

// ---- alternation --------------------------------------------------------------------------------

static double loss_of(const fixture *f, const double *weights) {
    pci_skin_measures measures;
    double sum = 0.0;
    assert_ok(f->context, pci_skin_measure(f->context, &f->problem, pci_skin_kernel_double(),
                                           weights, &measures));
    for (size_t x = 0; x < 3; ++x) {
        sum += lambda_all[x] * measures.losses[x] /
               (f->problem.norms[x] * (double)f->problem.frame_count);
    }
    return sum;
}

// The loss of 200 epochs of AdamW on all frames in 8 rounds, that of batches of 16 in 64.
static void reaches_the_loss_of_adamw(void **state) {
    (void)state;
    for (size_t i = 0; i < 2; ++i) {
        solver s;
        open_solver(moving_names[i], 48, 1, 0.0, false, &s);
        const fixture *f = &s.f;
        double *adamw = calloc(f->count, sizeof(double)), *ours = calloc(f->count, sizeof(double));
        double *surrogate = calloc(f->count, sizeof(double));
        for (uint32_t batch = 48; batch > 0; batch = batch > 16 ? 16 : 0) {
            const uint32_t rounds = batch == 48 ? 8 : 64;
            memcpy(surrogate, f->surrogate, f->count * sizeof(double));
            const pci_skin_descent settings = {
                .lambda = {lambda_all[0], lambda_all[1], lambda_all[2]},
                .epochs = 200,
                .batch = batch,
                .learning_rate = 1e-3,
                .weight_decay = 0.01,
                .epsilon = 1e-8 / (double)f->problem.vertex_count,
                .seed = 1};
            assert_ok(f->context, pci_skin_descend(f->context, &f->problem, pci_skin_kernel_float(),
                                                   &settings, surrogate));
            for (size_t v = 0; v < f->problem.vertex_count; ++v) {
                const size_t row = v * f->problem.slots;
                pci_skin_normalize(&surrogate[row], f->problem.slots, &adamw[row]);
            }
            memcpy(ours, f->weights, f->count * sizeof(double));
            assert_ok(f->context,
                      pci_skin_alternation_run(&s.a, rounds, 0.0, false, 0.0, 1.0, ours));
            const double theirs = loss_of(f, adamw), mine = loss_of(f, ours);
            if (!(mine <= theirs)) {
                fail_msg("%s, %u rounds: %g, AdamW %g", f->name, rounds, mine, theirs);
            }
        }
        free(adamw);
        free(ours);
        free(surrogate);
        close_solver(&s);
    }
}

// Rounds that see a sample of the frames, and some with all in the end, are as good as rounds that
// see all.
static void a_sample_of_the_frames_leads_to_the_same_loss(void **state) {
    (void)state;
    solver s;
    open_solver("dress796", 120, 1, 0.5, false, &s);
    const fixture *f = &s.f;
    double *sampled = calloc(f->count, sizeof(double)), *full = calloc(f->count, sizeof(double));
    memcpy(sampled, f->weights, f->count * sizeof(double));
    memcpy(full, f->weights, f->count * sizeof(double));
    assert_true(s.gram.levels[PCI_SKIN_SAMPLE].stride > 1);
    assert_ok(f->context, pci_skin_alternation_run(&s.a, 32, 0.0, false, 0.0, 1.0, sampled));
    s.gram.levels[PCI_SKIN_SAMPLE].stride = 1; // from now on all frames
    assert_ok(f->context, pci_skin_alternation_run(&s.a, 32, 0.0, false, 0.0, 1.0, full));
    const double first = loss_of(f, f->weights), expected = loss_of(f, full);
    assert_true(expected < 0.8 * first);
    assert_close(loss_of(f, sampled), expected, 0.005 * expected);
    free(sampled);
    free(full);
    close_solver(&s);
}

// Where it stops nothing can be gained: no weight can move along the simplex and lower the loss
// with its rotations, L_f included.
static void stops_at_a_stationary_point(void **state) {
    const bool turned = *state != NULL;
    solver s;
    open_solver("tiny", 24, 1, 0.5, turned, &s);
    const fixture *f = &s.f;
    const pci_skin_problem *p = &f->problem;
    double *w = calloc(f->count, sizeof(double)), *g = calloc(f->count, sizeof(double));
    memcpy(w, f->weights, f->count * sizeof(double));
    assert_ok(f->context, pci_skin_alternation_run(&s.a, 1500, 0.0, false, 0.0, 1.0, w));
    double scale[4] = {0.0}, before = 0.0, after = 0.0;
    for (size_t x = 0; x < 3; ++x) {
        scale[x] = lambda_all[x] / (p->norms[x] * (double)p->frame_count);
    }
    for (size_t pass = 0; pass < 2; ++pass) {
        const double *weights = pass == 0 ? f->weights : w;
        assert_ok(f->context,
                  pci_skin_gradient(f->context, p, pci_skin_kernel_double(), weights, scale, g));
        for (size_t v = 0; v < p->vertex_count; ++v) {
            double lowest = INFINITY, gap = 0.0;
            // dL_f / dw, frame by frame.
            for (size_t t = 0; t < p->frame_count; ++t) {
                double error[3] = {0.0}, u[3];
                for (size_t l = 0; l < p->slots + 3; ++l) {
                    const bool own = l < p->slots;
                    const size_t at = own ? v * p->slots + l : 3 * v + l - p->slots;
                    displacement_by(f, t, own ? p->bones[at] : s.followed.bones[at], v, u);
                    for (size_t c = 0; c < 3; ++c) {
                        error[c] += (own ? weights[at] : -s.followed.weights[at]) * u[c];
                    }
                }
                for (size_t k = v * p->slots; k < (v + 1) * p->slots; ++k) {
                    displacement_by(f, t, p->bones[k], v, u);
                    g[k] += 2.0 * s.a.follow * pci_dot(error, u);
                }
            }
            for (size_t k = v * p->slots; k < (v + 1) * p->slots; ++k) {
                lowest = g[k] < lowest ? g[k] : lowest;
            }
            for (size_t k = v * p->slots; k < (v + 1) * p->slots; ++k) {
                gap += weights[k] * (g[k] - lowest); // what the row could gain, to first order
            }
            *(pass == 0 ? &before : &after) += gap;
        }
    }
    assert_true(after < 1e-3 * before);
    free(w);
    free(g);
    close_solver(&s);
}

// Slots go one by one to those that cost least, and the weights adapt: far better than cutting.
static void pruning_beats_cutting(void **state) {
    (void)state;
    solver s;
    open_solver("dress796", 32, 1, 0.0, false, &s);
    const fixture *f = &s.f;
    const size_t slots = f->problem.slots;
    double *w = calloc(f->count, sizeof(double)), *cut = calloc(f->count, sizeof(double));
    memcpy(w, f->weights, f->count * sizeof(double));
    assert_ok(f->context, pci_skin_alternation_run(&s.a, 24, 0.0, false, 0.0, 1.0, w));
    const double full = loss_of(f, w);
    for (size_t v = 0; v < f->problem.vertex_count; ++v) {
        double sum = 0.0;
        for (size_t k = 0; k < slots; ++k) {
            size_t heavier = 0;
            for (size_t l = 0; l < slots; ++l) {
                heavier += w[v * slots + l] > w[v * slots + k];
            }
            cut[v * slots + k] = heavier < 4 ? w[v * slots + k] : 0.0;
            sum += cut[v * slots + k];
        }
        for (size_t k = 0; k < slots; ++k) {
            cut[v * slots + k] /= sum;
        }
    }
    pci_skin_measures measures;
    assert_ok(f->context, pci_skin_alternation_prune(&s.a, 4, w, &measures));
    const double pruned = loss_of(f, w);
    assert_ok(f->context, pci_skin_alternation_run(&s.a, 24, 0.0, false, 0.0, 1.0, w));
    for (size_t v = 0; v < f->problem.vertex_count; ++v) {
        size_t used = 0;
        for (size_t k = 0; k < slots; ++k) {
            used += w[v * slots + k] > 0.0;
        }
        assert_in_range(used, 1, 4);
    }
    const double adapted = loss_of(f, w), by_weight = loss_of(f, cut);
    assert_true(pruned < by_weight);
    assert_true(adapted < pruned);
    assert_true(adapted - full < 0.5 * (by_weight - full));
    // What was measured on the way is the loss before.
    double measured = 0.0;
    for (size_t x = 0; x < 3; ++x) {
        measured += lambda_all[x] * measures.losses[x] / (f->problem.norms[x] * 32.0);
    }
    assert_close(measured, full, 1e-12 * full);
    free(w);
    free(cut);
    close_solver(&s);
}

// Rows as short as what is left say the same: the same bones and weights, the same loss.
static void short_rows_say_the_same(void **state) {
    (void)state;
    solver s;
    open_solver("dress796", 32, 1, 0.5, false, &s);
    fixture *f = &s.f;
    const size_t slots = f->problem.slots, nv = f->problem.vertex_count;
    double *w = calloc(f->count, sizeof(double));
    uint32_t *bones = calloc(f->count, sizeof(uint32_t));
    memcpy(w, f->weights, f->count * sizeof(double));
    memcpy(bones, f->bones, f->count * sizeof(uint32_t));
    assert_ok(f->context, pci_skin_alternation_run(&s.a, 4, 0.0, false, 0.0, 1.0, w));
    pci_skin_measures measures, shortened;
    assert_ok(f->context, pci_skin_alternation_prune(&s.a, 5, w, &measures));
    assert_ok(f->context, pci_skin_alternation_measure(&s.a, PCI_SKIN_ALL, w, &measures));
    const float constant = s.a.constants[0];
    memcpy(f->surrogate, w, f->count * sizeof(double));
    pci_skin_alternation_compact(&s.a, 5, f->bones, w);
    f->problem.slots = 5;
    for (size_t v = 0; v < nv; ++v) {
        double sum = 0.0;
        size_t found = 0;
        for (size_t k = 0; k < 5; ++k) {
            sum += w[5 * v + k];
            for (size_t l = v * slots; l < (v + 1) * slots; ++l) {
                found += bones[l] == f->bones[5 * v + k] && f->surrogate[l] == w[5 * v + k];
            }
        }
        assert_int_equal(found, 5);
        assert_close(sum, 1.0, 1e-12);
        assert_int_equal(s.a.allowed[v], 0x1f);
    }
    assert_true(f->bones[0] != bones[0] || s.a.constants[0] == constant);
    assert_ok(f->context, pci_skin_alternation_measure(&s.a, PCI_SKIN_ALL, w, &shortened));
    for (size_t x = 0; x < 3; ++x) {
        assert_close(shortened.losses[x], measures.losses[x], 1e-9 * measures.losses[x]);
    }
    assert_ok(f->context, pci_skin_alternation_run(&s.a, 4, 0.0, false, 0.0, 1.0, w));
    free(w);
    free(bones);
    close_solver(&s);
}

// ---- coarse problems ----------------------------------------------------------------------------

static void coarse_vertices_stand_for_all(void **state) {
    (void)state;
    fixture f;
    load_fixture("dress796", 1, &f);
    const pci_skin_problem *fine = &f.problem;
    pci_skin_coarse coarse;
    assert_true(pci_skin_coarsen(&f.scratch, fine, &coarse));
    const pci_skin_problem *p = &coarse.problem;
    assert_in_range(p->vertex_count, fine->vertex_count / 10, fine->vertex_count / 2);
    for (size_t v = 0; v < fine->vertex_count; ++v) {
        const uint32_t c = coarse.clusters[v], by = coarse.vertices[c];
        bool near = by == v;
        for (size_t e = fine->ring_offsets[v]; e < fine->ring_offsets[v + 1]; ++e) {
            near = near || fine->ring[e] == by;
            assert_true(by != v ||
                        coarse.vertices[coarse.clusters[fine->ring[e]]] != fine->ring[e]);
        }
        assert_true(near);
    }
    for (uint32_t c = 0; c < p->vertex_count; ++c) {
        assert_int_equal(coarse.clusters[coarse.vertices[c]], c);
        assert_memory_equal(&p->rest[3 * (size_t)c], &fine->rest[3 * (size_t)coarse.vertices[c]],
                            3 * sizeof(double));
        for (size_t e = p->ring_offsets[c]; e < p->ring_offsets[c + 1]; ++e) {
            const uint32_t other = p->ring[e];
            bool back = false;
            assert_true(other != c);
            for (size_t i = p->ring_offsets[other]; i < p->ring_offsets[other + 1]; ++i) {
                back = back || p->ring[i] == c;
            }
            assert_true(back);
        }
    }
    free_fixture(&f);
}

// No change leaves all as it is; where all move alike and may, all do.
static void changes_are_prolonged(void **state) {
    (void)state;
    solver s;
    open_solver("dress796", 16, 1, 0.5, false, &s);
    const pci_skin_problem *fine = &s.f.problem;
    const size_t slots = fine->slots, nv = fine->vertex_count;
    uint32_t *bones = calloc(s.f.count, sizeof(uint32_t));
    double *w = calloc(s.f.count, sizeof(double));
    for (size_t i = 0; i < s.f.count; ++i) { // the same for all
        bones[i] = (uint32_t)(i % slots);
    }
    s.f.problem.bones = bones;
    pci_skin_coarse coarse;
    assert_true(pci_skin_coarsen(&s.f.scratch, fine, &coarse));
    double *change = calloc(coarse.problem.vertex_count * slots, sizeof(double));
    memcpy(w, s.f.weights, s.f.count * sizeof(double));
    assert_true(pci_skin_prolong(&s.f.scratch, &s.gram, fine, &coarse, change, w));
    for (size_t i = 0; i < s.f.count; ++i) {
        assert_close(w[i], s.f.weights[i], 1e-12);
    }
    for (size_t c = 0; c < coarse.problem.vertex_count; ++c) {
        change[c * slots] = 0.2;
        change[c * slots + 1] = -0.2;
    }
    size_t moved = 0;
    assert_true(pci_skin_prolong(&s.f.scratch, &s.gram, fine, &coarse, change, w));
    for (size_t v = 0; v < nv; ++v) {
        const double *row = &w[v * slots], *before = &s.f.weights[v * slots];
        double sum = 0.0;
        for (size_t k = 0; k < slots; ++k) {
            assert_true(row[k] >= 0.0);
            sum += row[k];
        }
        assert_close(sum, 1.0, 1e-12);
        if (before[1] > 0.2) {
            assert_close(row[0], before[0] + 0.2, 1e-9);
            assert_close(row[1], before[1] - 0.2, 1e-9);
            ++moved;
        }
    }
    assert_true(moved > 20);
    free(bones);
    free(w);
    free(change);
    close_solver(&s);
}

// ---- the stage ----------------------------------------------------------------------------------

// Motion on a wind that was not seen, over that of closest-triangle weights. What hangs on held
// vertices must stay there.
static double motion_ratio(const fixture *f, double lambda_follow) {
    pc_motion train = {0}, unseen = {0};
    make_motion(f->context, &f->proxy, 60, 1, &train);
    make_motion(f->context, &f->proxy, 60, 2, &unseen);
    pc_skin skin = {0}, closest = {0};
    pc_skin_options options;
    pc_record_set_defaults(&pc_skin_options_record, &options);
    options.lambda_follow = lambda_follow;
    options.lambda_stretch = 0.0;
    assert_ok(f->context,
              pc_skin_optimize(f->context, &f->visual, &f->proxy, &train, &options, &skin, NULL));
    assert_ok(f->context, pc_skin_closest_triangle(f->context, &f->visual, &f->proxy, &closest));
    const size_t nv = f->visual.vertex_count;
    double *ours = calloc(3 * nv, sizeof(double)), *theirs = calloc(3 * nv, sizeof(double));
    double moved = 0.0, expected_motion = 0.0;
    size_t held = 0;
    for (size_t t = 0; t < unseen.frame_count; ++t) {
        const double *frame = &unseen.positions[3 * f->proxy.vertex_count * t];
        pc_skin_deform(&skin, f->visual.positions, f->proxy.positions, frame, NULL, ours);
        pc_skin_deform(&closest, f->visual.positions, f->proxy.positions, frame, NULL, theirs);
        for (size_t v = 0; v < nv; ++v) {
            const double *rest = &f->visual.positions[3 * v];
            const double distance = sqrt(pci_squared_distance(&ours[3 * v], rest));
            moved += distance;
            expected_motion += sqrt(pci_squared_distance(&theirs[3 * v], rest));
            bool pinned = true;
            for (size_t k = 3 * v; k < 3 * v + 3; ++k) {
                pinned = pinned && unseen.pinned[closest.bones[k]];
            }
            held += pinned;
            assert_true(!pinned || distance == 0.0);
        }
    }
    assert_true(held > 0);
    free(ours);
    free(theirs);
    pc_skin_free(f->context, &skin);
    pc_skin_free(f->context, &closest);
    pc_motion_free(f->context, &train);
    pc_motion_free(f->context, &unseen);
    return moved / expected_motion;
}

static double weight_of(const pc_skin *skin, size_t v, uint32_t bone) {
    double sum = 0.0;
    for (size_t k = v * skin->influences; k < (v + 1) * skin->influences; ++k) {
        sum += skin->bones[k] == bone ? skin->weights[k] : 0.0;
    }
    return sum;
}

// The heaviest of the mean of both.
static void what_is_followed_is_the_mean(void **state) {
    (void)state;
    fixture f;
    load_fixture("dress796", 1, &f);
    pc_skin followed = {0}, closest = {0}, smoothed = {0};
    pci_place *points = PCI_SCRATCH(&f.scratch, pci_place, f.visual.vertex_count);
    assert_ok(f.context, pci_closest_points(f.context, "skin", &f.visual, &f.proxy, points));
    assert_ok(f.context, pci_skin_follow_proxy(f.context, &f.visual, &f.proxy, points, &followed));
    assert_ok(f.context, pc_skin_closest_triangle(f.context, &f.visual, &f.proxy, &closest));
    assert_ok(f.context, pc_skin_heat_smoothed(f.context, &f.visual, &f.proxy, followed.influences,
                                               &smoothed));
    for (size_t v = 0; v < f.visual.vertex_count; ++v) {
        const uint32_t *bones = &followed.bones[v * followed.influences];
        const double *weights = &followed.weights[v * followed.influences];
        double kept = 0.0, sum = 0.0;
        for (size_t k = 0; k < followed.influences && weights[k] > 0.0; ++k) {
            kept += 0.5 * (weight_of(&closest, v, bones[k]) + weight_of(&smoothed, v, bones[k]));
            sum += weights[k];
        }
        assert_true(kept > 0.95);
        assert_close(sum, 1.0, 1e-12);
        for (size_t k = 0; k < followed.influences && weights[k] > 0.0; ++k) {
            const double mean =
                0.5 * (weight_of(&closest, v, bones[k]) + weight_of(&smoothed, v, bones[k]));
            assert_close(weights[k], mean / kept, 1e-12);
            assert_true(k == 0 || weights[k] <= weights[k - 1]);
        }
    }
    pc_skin_free(f.context, &followed);
    pc_skin_free(f.context, &closest);
    pc_skin_free(f.context, &smoothed);
    free_fixture(&f);
}

static void follows_the_proxy(void **state) {
    (void)state;
    for (size_t i = 0; i < 2; ++i) {
        fixture f;
        load_fixture(moving_names[i], 1, &f);
        const double without = motion_ratio(&f, 0.0), with = motion_ratio(&f, 2.0);
        assert_true(with < 1.02 && without + 0.05 < with);
        assert_true(with > (i == 0 ? 0.97 : 0.9));
        assert_true(motion_ratio(&f, 50.0) > with);
        free_fixture(&f);
    }
}

static double mean_strain(const fixture *f, double lambda_rigid, double lambda_stretch) {
    pc_motion motion = {0};
    pc_skin skin = {0};
    pc_skin_options options;
    pc_motion_measures measures;
    make_motion(f->context, &f->proxy, 60, 1, &motion);
    pc_record_set_defaults(&pc_skin_options_record, &options);
    options.lambda_rigid = lambda_rigid;
    options.lambda_stretch = lambda_stretch;
    assert_ok(f->context,
              pc_skin_optimize(f->context, &f->visual, &f->proxy, &motion, &options, &skin, NULL));
    assert_ok(f->context, pc_evaluate_motion(f->context, &f->visual, &f->proxy, &motion, &skin,
                                             NULL, &measures));
    pc_skin_free(f->context, &skin);
    pc_motion_free(f->context, &motion);
    return measures.strain_mean;
}

// The model of L_s is below its bound; sweeps must not overshoot where it outweighs the rest.
static void lengths_are_kept_as_asked(void **state) {
    (void)state;
    for (size_t i = 0; i < 2; ++i) {
        fixture f;
        load_fixture(moving_names[i], 1, &f);
        assert_true(mean_strain(&f, 0.01, 1000.0) < mean_strain(&f, 1.0, 1.0));
        free_fixture(&f);
    }
}

int main(void) {
    static bool turned = true;
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_matrix_is_that_of_the_losses),
        cmocka_unit_test(groups_of_one_colour_share_nothing),
        cmocka_unit_test(the_gram_matrix_is_that_of_the_displacements),
        cmocka_unit_test(pairs_do_for_the_matrix),
        cmocka_unit_test(pairs_are_entries_of_the_matrix),
        cmocka_unit_test(noise_is_a_share_of_what_parts_neighbours),
        cmocka_unit_test(noise_pulls_as_its_energy_says),
        {"noise_pulls_as_its_energy_says, turned", noise_pulls_as_its_energy_says, NULL, NULL,
         &turned},
        cmocka_unit_test(sweeps_reach_the_minimum),
        {"sweeps_reach_the_minimum, turned", sweeps_reach_the_minimum, NULL, NULL, &turned},
        cmocka_unit_test(reaches_the_loss_of_adamw),
        cmocka_unit_test(a_sample_of_the_frames_leads_to_the_same_loss),
        cmocka_unit_test(stops_at_a_stationary_point),
        {"stops_at_a_stationary_point, turned", stops_at_a_stationary_point, NULL, NULL, &turned},
        cmocka_unit_test(pruning_beats_cutting),
        cmocka_unit_test(short_rows_say_the_same),
        cmocka_unit_test(coarse_vertices_stand_for_all),
        cmocka_unit_test(changes_are_prolonged),
        cmocka_unit_test(what_is_followed_is_the_mean),
        cmocka_unit_test(follows_the_proxy),
        cmocka_unit_test(lengths_are_kept_as_asked),
    };
    return cmocka_run_group_tests_name("skin_solver", tests, NULL, NULL);
}
