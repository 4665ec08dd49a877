// Steps along those of earlier rounds, on a quadratic energy of one row with three slots.
#include "stages/skin/skin_secants.h"
#include "support/test.h"

enum { SLOTS = 3 };

static const double hessian[SLOTS][SLOTS] = {{3.0, 1.0, 0.5}, {1.0, 2.0, 0.2}, {0.5, 0.2, 1.0}};

typedef struct descent {
    pci_skin_secants secants;
    const double *minimum; // of sum 1
    double weights[SLOTS];
    float gradient[SLOTS], moved[SLOTS];
    double fall; // along the last step
} descent;

static double energy(const descent *d, const double *weights) {
    double sum = 0.0;
    for (size_t i = 0; i < SLOTS; ++i) {
        for (size_t j = 0; j < SLOTS; ++j) {
            sum +=
                0.5 * hessian[i][j] * (weights[i] - d->minimum[i]) * (weights[j] - d->minimum[j]);
        }
    }
    return sum;
}

static void find_gradient(descent *d) {
    for (size_t i = 0; i < SLOTS; ++i) {
        double sum = 0.0;
        for (size_t j = 0; j < SLOTS; ++j) {
            sum += hessian[i][j] * (d->weights[j] - d->minimum[j]);
        }
        d->gradient[i] = (float)sum;
    }
}

// A step along the known ones, then what stands for the sweeps: a short way down the gradient.
static void run_round(descent *d, double down) {
    float *gradient = d->gradient;
    find_gradient(d);
    d->fall = pci_skin_secants_step(&d->secants, &gradient, d->moved, d->weights);
    const double mean = ((double)gradient[0] + (double)gradient[1] + (double)gradient[2]) / SLOTS;
    for (size_t i = 0; i < SLOTS; ++i) {
        const double step = -down * ((double)gradient[i] - mean);
        d->weights[i] += step;
        d->moved[i] += (float)step;
    }
}

typedef struct one_row {
    uint32_t member;
    pci_skin_quadratic quadratic;
    pci_scratch scratch;
    descent d;
} one_row;

static void begin(pc_context *context, const double *minimum, uint32_t room, one_row *r) {
    memset(r, 0, sizeof(*r));
    r->quadratic.context = context;
    r->quadratic.vertex_count = r->quadratic.group_count = 1;
    r->quadratic.slots = SLOTS;
    r->quadratic.members = &r->member;
    r->scratch = pci_scratch_begin(context);
    r->d.minimum = minimum;
    for (size_t i = 0; i < SLOTS; ++i) {
        r->d.weights[i] = 1.0 / SLOTS;
    }
    assert_true(pci_skin_secants_build(&r->scratch, &r->quadratic, room, &r->d.secants));
}

// Two steps tell all of a plane, and the third goes to the minimum; its fall is that of the energy.
static void two_steps_span_the_simplex(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    static const double minimum[SLOTS] = {0.5, 0.2, 0.3};
    one_row r;
    begin(context, minimum, PCI_SKIN_SECANTS, &r);
    run_round(&r.d, 0.3);
    assert_true(r.d.fall == 0.0);
    run_round(&r.d, 0.3);
    const double before = energy(&r.d, r.d.weights);
    assert_true(before > 1e-6);
    run_round(&r.d, 0.0);
    assert_true(energy(&r.d, r.d.weights) < 1e-3 * before);
    assert_close(r.d.fall, before, 0.01 * before);
    for (size_t i = 1; i < SLOTS; ++i) { // and so says the gradient there
        assert_close((double)r.d.gradient[i], (double)r.d.gradient[0], 1e-4);
    }
    pci_scratch_end(&r.scratch);
    pc_context_destroy(context);
}

// With room for one step the way is along the latest, and does not reach the minimum.
static void one_step_is_kept(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    static const double minimum[SLOTS] = {0.5, 0.2, 0.3};
    one_row r;
    begin(context, minimum, 1, &r);
    for (size_t i = 0; i < 3; ++i) {
        run_round(&r.d, 0.1);
    }
    const double before = energy(&r.d, r.d.weights);
    run_round(&r.d, 0.0);
    const double after = energy(&r.d, r.d.weights);
    assert_close(r.d.fall, before - after, 0.01 * before);
    assert_true(r.d.fall > 0.01 * before && after > 1e-3 * before);
    pci_scratch_end(&r.scratch);
    pc_context_destroy(context);
}

// Once interrupted, the step that has begun is not known: one is not enough.
static void an_interrupted_step_does_not_count(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    static const double minimum[SLOTS] = {0.5, 0.2, 0.3};
    one_row r;
    begin(context, minimum, PCI_SKIN_SECANTS, &r);
    run_round(&r.d, 0.3);
    run_round(&r.d, 0.3);
    pci_skin_secants_interrupt(&r.d.secants);
    const double before = energy(&r.d, r.d.weights);
    run_round(&r.d, 0.0);
    assert_true(r.d.secants.count == 1);
    assert_true(energy(&r.d, r.d.weights) > 1e-3 * before);
    assert_true(energy(&r.d, r.d.weights) <= before);
    pci_scratch_end(&r.scratch);
    pc_context_destroy(context);
}

// The way to a minimum outside ends on the simplex, and `moved` leads there from where it went.
static void weights_stay_on_the_simplex(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    static const double minimum[SLOTS] = {1.4, -0.6, 0.2};
    one_row r;
    begin(context, minimum, PCI_SKIN_SECANTS, &r);
    run_round(&r.d, 0.2);
    run_round(&r.d, 0.2);
    run_round(&r.d, 0.0);
    double sum = 0.0;
    for (size_t i = 0; i < SLOTS; ++i) {
        assert_true(r.d.weights[i] >= 0.0);
        assert_close(r.d.weights[i] - (double)r.d.moved[i], minimum[i], 1e-3);
        sum += r.d.weights[i];
    }
    assert_true(r.d.weights[1] == 0.0);
    assert_close(sum, 1.0, 1e-12);
    pci_scratch_end(&r.scratch);
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(two_steps_span_the_simplex),
        cmocka_unit_test(one_step_is_kept),
        cmocka_unit_test(an_interrupted_step_does_not_count),
        cmocka_unit_test(weights_stay_on_the_simplex),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
