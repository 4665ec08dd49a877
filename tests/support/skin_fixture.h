// Weight problems with known answers, for the tests of skinning.
#ifndef TEST_SUPPORT_SKIN_FIXTURE_H
#define TEST_SUPPORT_SKIN_FIXTURE_H

#include "proxycloth/skin.h"
#include "stages/skin/skin_internal.h"
#include "support/fixture.h"
#include "support/obj.h"
#include "support/test.h"

// A problem whose candidates, first guess and expected numbers come from other code (PyTorch).
typedef struct fixture {
    pc_context *context;
    pci_scratch scratch;
    const char *name;
    pc_mesh visual, proxy;
    double *frames, *surrogate, *weights, *rotations;
    uint32_t *bones, *near;
    const uint32_t *own_near; // as pci_skin_problem_build found it
    pci_skin_problem problem;
    size_t count; // weights
} fixture;

static inline const char *path_of(const fixture *f, const char *file) {
    static char path[512];
    snprintf(path, sizeof(path), TEST_DATA_DIR "/skinning/%s/%s", f->name, file);
    return path;
}

static inline double *expected(const fixture *f, const char *key, size_t count) {
    size_t found = 0;
    double *numbers = test_read_json_numbers(path_of(f, "expected.json"), key, &found);
    if (found != count) {
        fail_msg("%s has %zu numbers", key, found);
    }
    return numbers;
}

static inline double expected_number(const fixture *f, const char *key) {
    double *numbers = expected(f, key, 1);
    const double number = numbers[0];
    free(numbers);
    return number;
}

static inline void load_fixture(const char *name, uint32_t threads, fixture *f) {
    memset(f, 0, sizeof(*f));
    f->name = name;
    f->context = test_context(threads);
    f->scratch = pci_scratch_begin(f->context);
    assert_true(test_read_obj(f->context, path_of(f, "visual.obj"), &f->visual));
    assert_true(test_read_obj(f->context, path_of(f, "proxy.obj"), &f->proxy));
    size_t frame_numbers = 0, bone_numbers = 0;
    f->frames = test_read_numbers(path_of(f, "frames.f64"), &frame_numbers);
    f->surrogate = test_read_numbers(path_of(f, "S0.csv"), &f->count);
    double *bones = test_read_numbers(path_of(f, "B.csv"), &bone_numbers);
    assert_int_equal(bone_numbers, f->count);
    f->bones = calloc(f->count, sizeof(*f->bones));
    for (size_t i = 0; i < f->count; ++i) {
        f->bones[i] = (uint32_t)bones[i];
    }
    free(bones);
    pci_skin_problem *p = &f->problem;
    const uint32_t neighbours = (uint32_t)expected_number(f, "kK");
    assert_true(pci_skin_problem_build(&f->scratch, &f->visual, NULL, neighbours, p));
    p->slots = (uint32_t)(f->count / f->visual.vertex_count);
    p->bones = f->bones;
    p->proxy_count = f->proxy.vertex_count;
    p->proxy_rest = f->proxy.positions;
    p->frame_count = frame_numbers / (3 * p->proxy_count);
    p->frames = f->frames;
    f->weights = calloc(f->count, sizeof(double));
    for (size_t v = 0; v < p->vertex_count; ++v) {
        pci_skin_normalize(&f->surrogate[v * p->slots], p->slots, &f->weights[v * p->slots]);
    }
    // Among neighbours at equal distance the other code chose others; and it has epsilon_z = 1 mm
    // whatever the size of the garment.
    size_t near_numbers = 0;
    f->own_near = p->near;
    double *near = test_read_numbers(path_of(f, "K.csv"), &near_numbers);
    assert_int_equal(near_numbers, p->vertex_count * p->near_count);
    f->near = calloc(near_numbers, sizeof(*f->near));
    for (size_t i = 0; i < near_numbers; ++i) {
        f->near[i] = (uint32_t)near[i];
    }
    free(near);
    p->near = f->near;
    p->near_epsilon = 1e-3;
    double *sums = calloc(p->vertex_count, sizeof(double));
    for (size_t e = 0; e < p->vertex_count * p->near_count; ++e) {
        const size_t v = e / p->near_count;
        const double *other = &p->rest[3 * (size_t)p->near[e]];
        sums[v] += 1.0 / (sqrt(pci_squared_distance(&p->rest[3 * v], other)) + p->near_epsilon);
    }
    p->near_sums = sums;
}

// Gives every proxy vertex a rotation of its own in every frame.
static inline void turn_at_random(fixture *f) {
    pci_skin_problem *p = &f->problem;
    const size_t count = p->proxy_count * p->frame_count;
    free(f->rotations);
    f->rotations = calloc(4 * count, sizeof(double));
    for (size_t i = 0; i < count; ++i) {
        double *q = &f->rotations[4 * i], square = 0.0;
        for (size_t k = 0; k < 4; ++k) {
            q[k] = 2.0 * pci_random(77, k, i) - 1.0;
            square += q[k] * q[k];
        }
        for (size_t k = 0; k < 4; ++k) {
            q[k] /= sqrt(square);
        }
    }
    p->rotations = f->rotations;
}

// What a proxy vertex alone does to a visual vertex in a frame.
static inline void displacement_by(const fixture *f, size_t frame, size_t bone, size_t vertex,
                                   double out[3]) {
    const pci_skin_problem *p = &f->problem;
    const uint32_t only = (uint32_t)bone;
    const double whole = 1.0, *rest = &p->rest[3 * vertex];
    const pc_skin skin = {.vertex_count = 1,
                          .influences = 1,
                          .bones = (uint32_t *)&only,
                          .weights = (double *)&whole};
    pc_skin_deform(&skin, rest, p->proxy_rest, &p->frames[3 * p->proxy_count * frame],
                   p->rotations == NULL ? NULL : &p->rotations[4 * p->proxy_count * frame], out);
    pci_sub(out, rest, out);
}

static inline void free_fixture(fixture *f) {
    free(f->rotations);
    free((double *)(uintptr_t)f->problem.near_sums);
    free(f->frames);
    free(f->surrogate);
    free(f->weights);
    free(f->bones);
    free(f->near);
    pc_mesh_free(f->context, &f->visual);
    pc_mesh_free(f->context, &f->proxy);
    pci_scratch_end(&f->scratch);
    pc_context_destroy(f->context);
}

static inline void make_motion(pc_context *context, const pc_mesh *proxy, uint32_t frames,
                               uint32_t seed, pc_motion *motion) {
    pc_simulate_options options;
    pc_record_set_defaults(&pc_simulate_options_record, &options);
    options.frames = frames;
    options.seed = seed;
    assert_ok(context, pc_simulate(context, proxy, &options, motion, NULL));
}

#endif
