// Labels that follow the sides of a piece of cloth.
#include "support/test.h"

#include "stages/carve/sides.h"
#include "support/memory.h"
#include "support/sewing.h"

static const double cell_size = 0.1;

// A ball around a sheet at z = 0, with a cavity above it.
static pc_mesh ball_with_cavity(pc_context *context, size_t *outer) {
    pc_mesh ball = test_sphere(context, 10), cavity = sew_offset(context, &ball, 0.0, true);
    *outer = ball.vertex_count;
    for (size_t i = 0; i < 3 * cavity.vertex_count; ++i) {
        cavity.positions[i] *= 0.3;
    }
    sew_move(&cavity, 0.0, 0.0, 0.5);
    sew_add(context, &ball, cavity);
    return ball;
}

static pc_mesh sheet(pc_context *context) {
    pc_mesh mesh = test_sheet(context, 8, 8, 2.0, 2.0);
    sew_move(&mesh, -1.0, -1.0, 0.0);
    return mesh;
}

// Wrong labels on one half of the ball, or noise on all of it, do not matter; most of the labels
// tell which side is 1.
static void tells_the_sides(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pci_scratch scratch = pci_scratch_begin(context);
    size_t outer = 0;
    pc_mesh ball = ball_with_cavity(context, &outer), cloth = sheet(context);
    uint8_t *labels = PCI_SCRATCH(&scratch, uint8_t, ball.vertex_count);
    for (int up = 0; up < 2; ++up) {
        for (size_t v = 0; v < ball.vertex_count; ++v) {
            const double *p = &ball.positions[3 * v];
            labels[v] = (p[2] > 0.0) == (up == 1);
            if (p[0] > 0.5 || pci_random(1, 2, v) < 0.2) {
                labels[v] = 1;
            }
        }
        assert_ok(context, pci_label_sides(&scratch, "test", &ball, &cloth, cell_size, labels));
        for (size_t v = 0; v < ball.vertex_count; ++v) {
            const double z = ball.positions[3 * v + 2];
            if (v >= outer) {
                assert_int_equal(labels[v], 0);
            } else if (fabs(z) > 0.2) {
                assert_int_equal(labels[v], (z > 0.0) == (up == 1));
            }
        }
    }
    pc_mesh_free(context, &ball);
    pc_mesh_free(context, &cloth);
    pci_scratch_end(&scratch);
    pc_context_destroy(context);
}

// A wart under the ball whose end shows up does not become a piece of its own.
static void leaves_one_piece_of_each(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pci_scratch scratch = pci_scratch_begin(context);
    pc_mesh ball = test_sphere(context, 16), cloth = sheet(context);
    uint8_t *labels = PCI_SCRATCH(&scratch, uint8_t, ball.vertex_count);
    // The sheet turns over at its edge, so that there the lower half shows its front.
    for (size_t t = 0; t < cloth.triangle_count; ++t) {
        double middle[3];
        pci_triangle_middle(&cloth, t, middle);
        if (middle[0] > 0.5 && fabs(middle[1]) < 0.5) {
            uint32_t *corner = &cloth.triangles[3 * t];
            const uint32_t second = corner[1];
            corner[1] = corner[2];
            corner[2] = second;
        }
    }
    for (size_t v = 0; v < ball.vertex_count; ++v) {
        labels[v] = ball.positions[3 * v + 2] > 0.0;
    }
    assert_ok(context, pci_label_sides(&scratch, "test", &ball, &cloth, cell_size, labels));
    // Walks from one vertex of each label to all others of that label.
    pci_topology topology;
    assert_true(pci_topology_build(&scratch, &ball, &topology));
    uint8_t *met = PCI_SCRATCH(&scratch, uint8_t, ball.vertex_count);
    uint32_t *queue = PCI_SCRATCH(&scratch, uint32_t, ball.vertex_count);
    for (uint8_t label = 0; label < 2; ++label) {
        size_t ends = 0, wanted = 0;
        for (uint32_t v = 0; v < ball.vertex_count; ++v) {
            if (labels[v] == label && wanted++ == 0) {
                queue[ends++] = v;
                met[v] = 1;
            }
        }
        for (size_t i = 0; i < ends; ++i) {
            for (size_t k = topology.ring_offsets[queue[i]];
                 k < topology.ring_offsets[queue[i] + 1]; ++k) {
                const uint32_t other = topology.ring[k];
                if (!met[other] && labels[other] == label) {
                    met[other] = 1;
                    queue[ends++] = other;
                }
            }
        }
        assert_true(wanted > ball.vertex_count / 4);
        assert_int_equal(ends, wanted);
    }
    pc_mesh_free(context, &ball);
    pc_mesh_free(context, &cloth);
    pci_scratch_end(&scratch);
    pc_context_destroy(context);
}

static void survives_lack_of_memory(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    size_t outer = 0, failures = 0;
    pc_mesh ball = ball_with_cavity(context, &outer), cloth = sheet(context);
    uint8_t *labels = PCI_ALLOCATE(context, uint8_t, ball.vertex_count);
    const size_t live = counter.live;
    for (;; ++failures) {
        pci_scratch scratch = pci_scratch_begin(context);
        fail_allocation(&counter, failures + 1);
        const pc_status status =
            pci_label_sides(&scratch, "test", &ball, &cloth, cell_size, labels);
        pci_scratch_end(&scratch);
        assert_int_equal(counter.live, live);
        if (status == PC_OK) {
            break;
        }
        assert_int_equal(status, PC_ERROR_OUT_OF_MEMORY);
    }
    counter.fail_at = 0;
    assert_true(failures > 10);
    pc_release(context, labels);
    pc_mesh_free(context, &ball);
    pc_mesh_free(context, &cloth);
    pc_context_destroy(context);
    assert_int_equal(counter.live, 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(tells_the_sides),
        cmocka_unit_test(leaves_one_piece_of_each),
        cmocka_unit_test(survives_lack_of_memory),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
