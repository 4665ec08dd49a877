// What the labels keep inside closed bodies.
#include "support/test.h"

#include "stages/carve/hollows.h"
#include "support/memory.h"
#include "support/surfaces.h"

enum { SIDE = 6, EACH = 12 * SIDE * SIDE };

// A ball with a wall .1 thick, and a second ball beside it.
static pc_mesh closed_bodies(pc_context *context) {
    const double beside[3] = {3.0, 0.0, 0.0};
    pc_mesh ball = test_sphere(context, SIDE), hollow = test_sphere(context, SIDE);
    for (size_t i = 0; i < 3 * hollow.vertex_count; ++i) {
        hollow.positions[i] *= 0.9;
    }
    for (size_t t = 0; t < hollow.triangle_count; ++t) {
        const uint32_t second = hollow.triangles[3 * t + 1];
        hollow.triangles[3 * t + 1] = hollow.triangles[3 * t + 2];
        hollow.triangles[3 * t + 2] = second;
    }
    assert_int_equal(ball.triangle_count, EACH);
    pc_mesh both = test_union(context, &ball, &hollow, (double[3]){0.0, 0.0, 0.0});
    pc_mesh all = test_union(context, &both, &ball, beside);
    pc_mesh_free(context, &ball);
    pc_mesh_free(context, &hollow);
    pc_mesh_free(context, &both);
    return all;
}

// Marks the outside of the first ball, if `outside`, the caps of its hollow above and below
// `height`, and the upper half of the second ball. Returns how many triangles of caps there are.
static size_t mark(const pc_mesh *mesh, bool outside, double height, uint8_t *keep) {
    size_t caps = 0;
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        const double z = mesh->positions[3 * (size_t)mesh->triangles[3 * t] + 2];
        const size_t part = t / EACH;
        keep[t] = part == 0 ? outside : part == 1 ? fabs(z) > height : z > 0.0;
        caps += part == 1 && keep[t];
    }
    return caps;
}

static size_t kept_caps(const uint8_t *keep) {
    size_t count = 0;
    for (size_t t = EACH; t < 2 * EACH; ++t) {
        count += keep[t];
    }
    return count;
}

static size_t kept(const pc_mesh *mesh, const uint8_t *keep) {
    size_t count = 0;
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        count += keep[t];
    }
    return count;
}

static void leaves_out_what_nobody_sees(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pci_scratch scratch = pci_scratch_begin(context);
    pc_mesh mesh = closed_bodies(context);
    uint8_t keep[3 * EACH];
    size_t caps = mark(&mesh, true, 0.5, keep);
    const size_t all = kept(&mesh, keep);
    assert_true(caps > 0 && caps < EACH);
    // Out of reach they stay, within reach they go, and nothing else does.
    assert_ok(context, pci_leave_hollows(&scratch, "test", &mesh, 0.05, keep));
    assert_int_equal(kept(&mesh, keep), all);
    assert_ok(context, pci_leave_hollows(&scratch, "test", &mesh, 0.15, keep));
    assert_int_equal(kept_caps(keep), 0);
    assert_int_equal(kept(&mesh, keep), all - caps);

    // All of a piece must be near.
    for (size_t v = 0; v < mesh.vertex_count; ++v) {
        double *p = &mesh.positions[3 * v];
        p[2] *= p[2] < 0.0 && pci_norm(p) < 0.95 ? 0.7 : 1.0;
    }
    caps = mark(&mesh, true, 0.45, keep);
    assert_ok(context, pci_leave_hollows(&scratch, "test", &mesh, 0.15, keep));
    assert_true(kept_caps(keep) > 0 && kept_caps(keep) < caps);
    for (size_t t = EACH; t < 2 * EACH; ++t) {
        assert_true(!keep[t] || mesh.positions[3 * (size_t)mesh.triangles[3 * t] + 2] < 0.0);
    }

    // The hollow is all that there is of a body whose outside is not kept.
    caps = mark(&mesh, false, 0.45, keep);
    assert_ok(context, pci_leave_hollows(&scratch, "test", &mesh, 0.15, keep));
    assert_int_equal(kept_caps(keep), caps);
    pc_mesh_free(context, &mesh);
    pci_scratch_end(&scratch);
    pc_context_destroy(context);
}

static void survives_a_lack_of_memory(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    pc_mesh mesh = closed_bodies(context);
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        counter.fail_at = 0;
        uint8_t keep[3 * EACH];
        (void)mark(&mesh, true, 0.5, keep);
        pci_scratch scratch = pci_scratch_begin(context);
        fail_allocation(&counter, s.number);
        s.status = pci_leave_hollows(&scratch, "test", &mesh, 0.15, keep);
        pci_scratch_end(&scratch);
    }
    assert_true(s.failures > 5);
    pc_mesh_free(context, &mesh);
    pc_context_destroy(context);
    assert_int_equal(counter.live, 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(leaves_out_what_nobody_sees),
        cmocka_unit_test(survives_a_lack_of_memory),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
