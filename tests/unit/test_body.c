#define _POSIX_C_SOURCE 200809L
// The body's skin: weights carried over from the body, shares of the proxy, both skeletons in a
// GLB.
#include "geometry/topology.h"
#include "geometry/transfer.h"
#include "support/character_fixture.h"
#include "support/glb.h"
#include "support/memory.h"

static const char path[] = "/tmp/proxycloth_test_body.glb";

// A tube around the y axis from `low` to `high`, `first` vertices behind others of one mesh.
static void add_tube(pc_mesh *mesh, double radius, double low, double high, size_t rings) {
    enum { SECTORS = 16 };
    const uint32_t first = (uint32_t)mesh->vertex_count;
    for (size_t r = 0; r < rings; ++r) {
        for (size_t s = 0; s < SECTORS; ++s) {
            const double angle = 6.283185307179586 * (double)s / SECTORS;
            double *p = &mesh->positions[3 * mesh->vertex_count++];
            p[0] = radius * cos(angle);
            p[1] = low + (high - low) * (double)r / (double)(rings - 1);
            p[2] = -radius * sin(angle);
            const uint32_t a = first + (uint32_t)(r * SECTORS + s);
            const uint32_t b = first + (uint32_t)(r * SECTORS + (s + 1) % SECTORS);
            const uint32_t two[6] = {a, b, b + SECTORS, a, b + SECTORS, a + SECTORS};
            if (r + 1 < rings) {
                memcpy(&mesh->triangles[3 * mesh->triangle_count], two, sizeof(two));
                mesh->triangle_count += 2;
            }
        }
    }
}

static pc_mesh empty_mesh(pc_context *context) {
    pc_mesh mesh = {.positions = PCI_ALLOCATE(context, double, 3000),
                    .triangles = PCI_ALLOCATE(context, uint32_t, 6000)};
    assert_true(mesh.positions != NULL && mesh.triangles != NULL);
    return mesh;
}

// A tube of radius 1 from y = 0 to 10 whose weights pass from joint 0 to joint 1 linearly.
static void make_body(pc_context *context, pc_character *character) {
    pc_mesh body = empty_mesh(context);
    add_tube(&body, 1.0, 0.0, 10.0, 21);
    char names[2][64] = {"hips", "chest"}, parts[1][64] = {"body"};
    double centers[6] = {0, 0, 0, 0, 10, 0};
    uint32_t joints[4 * 21 * 16] = {0}, triangle_parts[2 * 20 * 16] = {0};
    float weights[4 * 21 * 16] = {0};
    for (size_t v = 0; v < body.vertex_count; ++v) {
        joints[4 * v + 1] = 1;
        weights[4 * v + 1] = (float)(body.positions[3 * v + 1] / 10.0);
        weights[4 * v] = 1.0F - weights[4 * v + 1];
    }
    const pc_character arrays = {.joint_count = 2,
                                 .joint_names = names[0],
                                 .joint_centers = centers,
                                 .body = body,
                                 .body_part_count = 1,
                                 .body_part_names = parts[0],
                                 .body_triangle_parts = triangle_parts,
                                 .body_joints = joints,
                                 .body_weights = weights};
    assert_ok(context, pc_character_create(context, &arrays, character));
    pc_mesh_free(context, &body);
}

// Of joint 1.
static double chest(const uint32_t *joints, const double *weights, size_t v) {
    double sum = 0.0, result = 0.0;
    for (size_t k = 4 * v; k < 4 * v + 4; ++k) {
        assert_true(weights[k] >= 0.0 && (k == 4 * v || weights[k] <= weights[k - 1]));
        sum += weights[k];
        result += joints[k] == 1 ? weights[k] : 0.0;
    }
    assert_close(sum, 1.0, 1e-12);
    return result;
}

// A sleeve close to the body takes its weights; a train that leaves the body goes on smoothly; a
// button far from the body is stiff.
static void weights_are_matched_filled_or_stiff(void **state) {
    (void)state;
    pc_context *context = test_context(2);
    pc_character character = {0};
    make_body(context, &character);
    pc_mesh garment = empty_mesh(context);
    add_tube(&garment, 1.1, 2.0, 8.0, 13);
    const size_t near = garment.vertex_count;
    // The last ring of the tube flares out to a train.
    for (size_t ring = 0; ring < 4; ++ring) {
        for (size_t s = 0; s < 16; ++s) {
            const size_t from = near - 16 + s, v = garment.vertex_count++;
            const double out = 1.1 + 1.5 * (double)(ring + 1);
            garment.positions[3 * v] = garment.positions[3 * from] / 1.1 * out;
            garment.positions[3 * v + 1] = 8.0;
            garment.positions[3 * v + 2] = garment.positions[3 * from + 2] / 1.1 * out;
            const uint32_t a = (uint32_t)(near - 16 + 16 * ring + s);
            const uint32_t b = (uint32_t)(near - 16 + 16 * ring + (s + 1) % 16);
            const uint32_t two[6] = {a, b, b + 16, a, b + 16, a + 16};
            memcpy(&garment.triangles[3 * garment.triangle_count], two, sizeof(two));
            garment.triangle_count += 2;
        }
    }
    const size_t worn = garment.vertex_count;
    add_tube(&garment, 4.0, 3.0, 3.1, 2);
    uint32_t *joints = calloc(4 * garment.vertex_count, sizeof(*joints));
    double *weights = calloc(4 * garment.vertex_count, sizeof(*weights));
    pci_transfer_counts counts;
    assert_ok(context, pci_transfer_weights(context, "test", &garment, &character, joints, weights,
                                            &counts));
    // The ring at the fold faces half away.
    assert_in_range(counts.matched, near - 16, near);
    assert_int_equal(counts.matched + counts.filled, worn);
    assert_int_equal(counts.rigid, garment.vertex_count - worn);
    for (size_t v = 0; v < near - 16; ++v) {
        assert_close(chest(joints, weights, v), garment.positions[3 * v + 1] / 10.0, 1e-6);
    }
    const double seam = chest(joints, weights, near - 16);
    for (size_t v = near; v < worn; ++v) {
        assert_close(chest(joints, weights, v), seam, 0.05);
        assert_true(chest(joints, weights, v) <= 0.8 + 1e-6);
    }
    const double stiff = chest(joints, weights, worn);
    assert_in_range((int)(100.0 * stiff + 0.5), 29, 32);
    for (size_t v = worn; v < garment.vertex_count; ++v) {
        assert_close(chest(joints, weights, v), stiff, 0.0);
    }
    free(joints);
    free(weights);
    pc_mesh_free(context, &garment);
    pc_character_free(context, &character);
    pc_context_destroy(context);
}

// Filled weights are harmonic: each is the mean of its neighbours, weighted by inverse lengths.
static void filled_weights_are_harmonic(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_character character = {0};
    make_body(context, &character);
    // Both ends of the garment lie on the body; the middle bulges out.
    pc_mesh garment = empty_mesh(context);
    add_tube(&garment, 1.05, 1.0, 9.0, 17);
    for (size_t v = 5 * 16; v < 12 * 16; ++v) {
        garment.positions[3 * v] *= 3.0;
        garment.positions[3 * v + 2] *= 3.0;
    }
    uint32_t *joints = calloc(4 * garment.vertex_count, sizeof(*joints));
    double *weights = calloc(4 * garment.vertex_count, sizeof(*weights));
    pci_transfer_counts counts;
    assert_ok(context, pci_transfer_weights(context, "test", &garment, &character, joints, weights,
                                            &counts));
    assert_in_range(counts.filled, 7 * 16, 9 * 16);
    for (size_t v = 6 * 16; v < 11 * 16; ++v) {
        double sum = 0.0, mean = 0.0;
        uint8_t seen[17 * 16] = {0};
        for (size_t i = 0; i < 3 * garment.triangle_count; ++i) {
            const uint32_t *corner = &garment.triangles[i / 3 * 3];
            const uint32_t other = garment.triangles[i];
            if ((corner[0] != v && corner[1] != v && corner[2] != v) || other == v || seen[other]) {
                continue;
            }
            seen[other] = 1;
            const double weight = 1.0 / sqrt(pci_squared_distance(&garment.positions[3 * v],
                                                                  &garment.positions[3 * other]));
            sum += weight;
            mean += weight * chest(joints, weights, other);
        }
        assert_close(chest(joints, weights, v), mean / sum, 1e-9);
    }
    free(joints);
    free(weights);
    pc_mesh_free(context, &garment);
    pc_character_free(context, &character);
    pc_context_destroy(context);
}

static pc_status create(pc_context *context, const pc_asset *a, pc_body_skin *skin,
                        pc_body_report *report) {
    return pc_body_skin_create(context, &a->visual, &a->character, &a->proxy, &a->motion,
                               &a->options.skin, skin, report);
}

static const double ball_center[3] = {0.0, 1.2, 0.0};

static void shares_follow_pins_or_paint(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_asset a;
    fixture_asset(context, 4, &a);
    pc_body_skin skin = {0};
    pc_body_report report;
    assert_ok(context, create(context, &a, &skin, &report)); // nothing is asked for
    assert_int_equal(skin.vertex_count, 0);
    a.options.skin.body_blend = 0.25;
    assert_int_equal(create(context, &a, &skin, &report), PC_ERROR_INVALID_OPTIONS);
    assert_null(skin.joints);
    fixture_character(context, ball_center, 0.3, 1, &a.character);
    assert_ok(context, create(context, &a, &skin, &report));
    assert_int_equal(report.own_weights + report.matched + report.filled + report.rigid,
                     a.visual.surface.vertex_count);
    const double reach = 0.25 * pci_diagonal(&a.visual.surface);
    size_t between = 0;
    for (size_t v = 0; v < skin.vertex_count; ++v) {
        double nearest = INFINITY;
        for (size_t p = 0; p < a.proxy.vertex_count; ++p) {
            if (a.motion.pinned[p]) {
                nearest =
                    fmin(nearest, sqrt(pci_squared_distance(&a.visual.surface.positions[3 * v],
                                                            &a.proxy.positions[3 * p])));
            }
        }
        const double t = fmin(nearest / reach, 1.0);
        assert_close(skin.shares[v], t * t * (3.0 - 2.0 * t), 1e-12);
        between += t > 0.0 && t < 1.0;
    }
    assert_true(between > 0);
    pc_body_skin_free(context, &skin);

    a.options.skin.body_channel = PC_BODY_CHANNEL_GREEN;
    assert_ok(context, create(context, &a, &skin, &report));
    const size_t corner = a.visual.corner_count / 2;
    assert_close(skin.shares[a.visual.corner_vertices[corner]],
                 (double)a.visual.colors[4 * corner + 1], 1e-6);
    pc_body_skin_free(context, &skin);
    pc_release(context, a.visual.colors);
    a.visual.colors = NULL;
    assert_int_equal(create(context, &a, &skin, &report), PC_ERROR_INVALID_OPTIONS);

    a.options.skin.body_channel = PC_BODY_CHANNEL_NONE;
    memset(a.motion.pinned, 0, a.proxy.vertex_count);
    assert_int_equal(create(context, &a, &skin, &report), PC_ERROR_INVALID_OPTIONS);
    pc_asset_free(context, &a);
    pc_context_destroy(context);
}

// The file, posed by its own nodes, is the mixture of equation (6) and the arm that turns.
static void glb_holds_both_skeletons(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_asset a;
    fixture_asset(context, 4, &a);
    fixture_character(context, ball_center, 0.3, 1, &a.character);
    a.options.skin.body_blend = 0.5;
    a.options.skin.weight_storage = PC_SKIN_WEIGHTS_FLOAT;
    a.scenario.attachment.kind = PC_ATTACHMENT_CLIP;
    memcpy(a.scenario.attachment.clip, "turn", sizeof("turn"));
    a.motion.frame_time = 0.1;                         // three poses of the clip
    for (size_t v = 0; v < a.skin.vertex_count; ++v) { // room for the arm
        a.skin.weights[4 * v] += a.skin.weights[4 * v + 3];
        a.skin.weights[4 * v + 3] = 0.0;
    }
    pc_body_skin body = {0};
    assert_ok(context, create(context, &a, &body, NULL));
    assert_ok(context, pc_export_glb(context, &a, path));
    glb g = read_glb(path);
    const cJSON *joints = child(element(&g, "skins", 0), "joints");
    assert_int_equal(cJSON_GetArraySize(joints), a.proxy.vertex_count + 2);
    const cJSON *arm = element(&g, "nodes", (size_t)cJSON_GetArrayItem(joints, 25)->valueint);
    assert_string_equal(child(arm, "name")->valuestring, "arm");
    const cJSON *primitives = child(element(&g, "meshes", 0), "primitives");
    assert_int_equal(cJSON_GetArraySize(primitives), 2);
    double largest = 0.0;
    for (size_t turn = 0; turn < 2 * (size_t)FIXTURE_FRAMES; ++turn) {
        const cJSON *primitive = cJSON_GetArrayItem(primitives, (int)turn % 2);
        const size_t frame = turn / 2;
        size_t count = 0, rest_count = 0, next = 0;
        double *posed = pose_primitive(&g, primitive, frame, &count);
        double *rest = read_attribute(&g, primitive, "POSITION", &rest_count);
        const double angle = 1.5707963267948966 * 0.1 * (double)(frame + 1);
        for (uint32_t corner = 0; corner < a.visual.corner_count && next < count; ++corner) {
            const size_t v = a.visual.corner_vertices[corner];
            const double *at = &a.visual.surface.positions[3 * v];
            if (fabs(rest[3 * next] - at[0]) + fabs(rest[3 * next + 1] - at[1]) +
                    fabs(rest[3 * next + 2] - at[2]) >
                1e-6) {
                continue; // of another material
            }
            const double turned[3] = {1.0 + cos(angle) * (at[0] - 1.0) - sin(angle) * at[1],
                                      sin(angle) * (at[0] - 1.0) + cos(angle) * at[1], at[2]};
            for (size_t k = 0; k < 3; ++k) {
                double follows = at[k];
                for (size_t j = 4 * v; j < 4 * v + 4; ++j) {
                    const size_t bone = 3 * (size_t)a.skin.bones[j] + k;
                    follows += a.skin.weights[j] *
                               (a.motion.positions[3 * frame * a.proxy.vertex_count + bone] -
                                a.proxy.positions[bone]);
                }
                const double expected =
                    body.shares[v] * follows + (1.0 - body.shares[v]) * turned[k];
                assert_close(posed[3 * next + k], expected, 1e-5 * pci_diagonal(&a.visual.surface));
                largest = fmax(largest, fabs((1.0 - body.shares[v]) * (turned[k] - at[k])));
            }
            ++next;
        }
        assert_int_equal(next, count);
        free(posed);
        free(rest);
    }
    assert_true(largest > 0.5); // the arm did carry something
    free_glb(&g);
    a.options.skin.max_bones = (uint32_t)a.proxy.vertex_count + 1;
    assert_int_equal(pc_export_glb(context, &a, path), PC_ERROR_TOO_LARGE);
    pc_body_skin_free(context, &body);
    pc_asset_free(context, &a);
    pc_context_destroy(context);
}

static void memory_may_run_out(void **state) {
    (void)state;
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    pc_asset a;
    fixture_asset(context, 4, &a);
    fixture_character(context, ball_center, 0.05, 1, &a.character); // most is filled in
    a.options.skin.body_blend = 0.5;
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        pc_body_skin skin = {0};
        s.status = create(context, &a, &skin, NULL);
        assert_true((s.status == PC_OK) == (skin.joints != NULL));
        pc_body_skin_free(context, &skin);
    }
    assert_true(s.failures > 9);
    pc_asset_free(context, &a);
    pc_context_destroy(context);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(weights_are_matched_filled_or_stiff),
        cmocka_unit_test(filled_weights_are_harmonic),
        cmocka_unit_test(shares_follow_pins_or_paint),
        cmocka_unit_test(glb_holds_both_skeletons),
        cmocka_unit_test(memory_may_run_out),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
