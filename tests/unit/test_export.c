#define _POSIX_C_SOURCE 200809L
#include <cjson/cJSON.h>
#include <locale.h>

#include "io/json.h"
#include "support/asset_fixture.h"
#include "support/files.h"
#include "support/glb.h"
#include "support/lack_of_memory.h"
#include "support/obj.h"

static char folder[64], path[64], other_path[64];

// Equation (6), from its definition.
// Where a vertex goes, with the rotations of the frame or NULL.
static void expected_pose(const pc_asset *asset, size_t vertex, size_t frame,
                          const double *rotations, double out[3]) {
    const pc_skin *skin = &asset->skin;
    const size_t np = asset->proxy.vertex_count;
    const double *rest = asset->proxy.positions, *at = &asset->visual.surface.positions[3 * vertex];
    const double *moved = &asset->motion.positions[3 * frame * np];
    memcpy(out, at, 3 * sizeof(double));
    for (size_t j = 0; j < skin->influences; ++j) {
        const size_t bone = skin->bones[vertex * skin->influences + j];
        double arm[3], turned[3];
        pci_sub(at, &rest[3 * bone], arm);
        memcpy(turned, arm, sizeof(arm));
        if (rotations != NULL) { // v + 2 u x (u x v + w v)
            const double *q = &rotations[4 * (frame * np + bone)];
            double first[3], second[3];
            pci_cross(q, arm, first);
            for (size_t k = 0; k < 3; ++k) {
                first[k] += q[3] * arm[k];
            }
            pci_cross(q, first, second);
            for (size_t k = 0; k < 3; ++k) {
                turned[k] += 2.0 * second[k];
            }
        }
        for (size_t k = 0; k < 3; ++k) {
            out[k] += skin->weights[vertex * skin->influences + j] *
                      (moved[3 * bone + k] - rest[3 * bone + k] + turned[k] - arm[k]);
        }
    }
}

static double fixture_diagonal(const pc_asset *asset) {
    double low[3], high[3];
    for (size_t k = 0; k < 3; ++k) {
        low[k] = high[k] = asset->visual.surface.positions[k];
        for (size_t v = 0; v < asset->visual.surface.vertex_count; ++v) {
            low[k] = fmin(low[k], asset->visual.surface.positions[3 * v + k]);
            high[k] = fmax(high[k], asset->visual.surface.positions[3 * v + k]);
        }
    }
    return sqrt(pci_squared_distance(low, high));
}

// Compares every triangle corner of every primitive with the asset: position at all frames, texture
// coordinates, colours.
static void assert_visual_matches(const glb *g, const pc_asset *asset) {
    const double tolerance = 1e-5 * fixture_diagonal(asset);
    const pc_visual *visual = &asset->visual;
    const pc_motion *motion = &asset->motion;
    double *rotations = NULL;
    if (asset->skin.skinning == PC_SKINNING_ROTATION) {
        pc_context *context = test_context(1);
        rotations = calloc(4 * motion->frame_count * motion->vertex_count, sizeof(double));
        assert_ok(context, pc_rotation_estimate_motion(context, &asset->proxy, motion, rotations));
        pc_context_destroy(context);
    }
    const cJSON *primitive;
    size_t triangles = 0, used_materials[] = {0, 2}, at = 0;
    cJSON_ArrayForEach(primitive, child(element(g, "meshes", 0), "primitives")) {
        const size_t material = used_materials[at++];
        assert_string_equal(
            child(element(g, "materials", number(primitive, "material")), "name")->valuestring,
            visual->materials[material].name);
        size_t index_count = 0, count = 0;
        double *indices = read_accessor(g, number(primitive, "indices"), &index_count);
        double *texcoords = read_attribute(g, primitive, "TEXCOORD_0", &count);
        double *colors = read_attribute(g, primitive, "COLOR_0", &count);
        for (size_t frame = 0; frame < FIXTURE_FRAMES; ++frame) {
            double *posed = pose_primitive(g, primitive, frame, &count);
            size_t next = 0;
            for (size_t i = 0; i < 3 * visual->surface.triangle_count; ++i) {
                if (visual->triangle_materials[i / 3] != material) {
                    continue;
                }
                const size_t index = (size_t)indices[next++];
                const size_t corner = visual->corner_triangles[i];
                double expected[3];
                assert_true(index < count);
                expected_pose(asset, visual->corner_vertices[corner], frame, rotations, expected);
                for (size_t k = 0; k < 3; ++k) {
                    assert_close(posed[3 * index + k], expected[k], tolerance);
                }
                for (size_t k = 0; k < 2; ++k) {
                    assert_true(texcoords[2 * index + k] ==
                                (double)visual->texcoords[2 * corner + k]);
                }
                for (size_t k = 0; k < 4; ++k) {
                    assert_true(colors[4 * index + k] == (double)visual->colors[4 * corner + k]);
                }
            }
            assert_int_equal(next, index_count);
            free(posed);
        }
        triangles += index_count / 3;
        free(indices);
        free(texcoords);
        free(colors);
    }
    assert_int_equal(at, 2);
    assert_int_equal(triangles, visual->surface.triangle_count);
    free(rotations);
}

// The proxy's own mesh follows the simulated positions exactly, in the proxy's vertex order.
static void assert_proxy_matches(const glb *g, const pc_asset *asset) {
    const double tolerance = 1e-6 * fixture_diagonal(asset);
    const cJSON *primitive = cJSON_GetArrayItem(child(element(g, "meshes", 1), "primitives"), 0);
    const size_t vertices = asset->proxy.vertex_count;
    size_t count = 0;
    double *indices = read_accessor(g, number(primitive, "indices"), &count);
    assert_int_equal(count, 3 * asset->proxy.triangle_count);
    for (size_t i = 0; i < count; ++i) {
        assert_true(indices[i] == (double)asset->proxy.triangles[i]);
    }
    free(indices);
    for (size_t frame = 0; frame < FIXTURE_FRAMES; ++frame) {
        double *posed = pose_primitive(g, primitive, frame, &count);
        assert_int_equal(count, vertices);
        for (size_t i = 0; i < 3 * vertices; ++i) {
            assert_close(posed[i], asset->motion.positions[3 * frame * vertices + i], tolerance);
        }
        free(posed);
    }
}

// Offsets are aligned, accessors lie in their views, views in the buffer, limits are those of the
// data.
static void assert_buffers_are_sound(const glb *g) {
    const size_t buffer = number(element(g, "buffers", 0), "byteLength");
    assert_in_range(g->bin_size - buffer, 0, 3);
    const cJSON *view, *accessor;
    cJSON_ArrayForEach(view, child(g->json, "bufferViews")) {
        assert_int_equal(number(view, "byteOffset") % 4, 0);
        assert_true(number(view, "byteOffset") + number(view, "byteLength") <= buffer);
    }
    size_t index = 0;
    cJSON_ArrayForEach(accessor, child(g->json, "accessors")) {
        const cJSON *owner = element(g, "bufferViews", number(accessor, "bufferView"));
        const cJSON *offset = cJSON_GetObjectItem(accessor, "byteOffset");
        const size_t tuple = tuple_size(accessor);
        const size_t size = component_size(number(accessor, "componentType"));
        size_t count = number(accessor, "count");
        const size_t begin = offset != NULL ? (size_t)offset->valuedouble : 0;
        assert_int_equal(begin % 4, 0);
        assert_true(begin + count * tuple * size <= number(owner, "byteLength"));
        double *values = read_accessor(g, index++, &count);
        const cJSON *minimum = cJSON_GetObjectItem(accessor, "min");
        for (size_t k = 0; k < tuple && minimum != NULL; ++k) {
            double low = values[k], high = values[k];
            for (size_t i = 0; i < count; ++i) {
                low = fmin(low, values[i * tuple + k]);
                high = fmax(high, values[i * tuple + k]);
            }
            assert_true(cJSON_GetArrayItem(minimum, (int)k)->valuedouble == low);
            assert_true(cJSON_GetArrayItem(child(accessor, "max"), (int)k)->valuedouble == high);
        }
        free(values);
    }
}

static void assert_names_are_unique(const glb *g) {
    const cJSON *nodes = child(g->json, "nodes");
    for (const cJSON *a = nodes->child; a != NULL; a = a->next) {
        for (const cJSON *b = a->next; b != NULL; b = b->next) {
            assert_string_not_equal(child(a, "name")->valuestring, child(b, "name")->valuestring);
        }
    }
}

// ---- GLB --------------------------------------------------------------------------------------

static void glb_poses_like_the_weights_ask(void **state) {
    (void)state;
    static const struct {
        uint32_t influences, sets;
        pc_skinning skinning;
    } rows[] = {{1, 1, PC_SKINNING_TRANSLATION},  {3, 1, PC_SKINNING_TRANSLATION},
                {4, 1, PC_SKINNING_TRANSLATION},  {8, 2, PC_SKINNING_TRANSLATION},
                {12, 3, PC_SKINNING_TRANSLATION}, {1, 1, PC_SKINNING_ROTATION},
                {4, 1, PC_SKINNING_ROTATION},     {8, 2, PC_SKINNING_ROTATION}};
    pc_context *context = test_context(1);
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); ++i) {
        pc_asset asset;
        fixture_asset(context, rows[i].influences, &asset);
        asset.options.skin.weight_storage = PC_SKIN_WEIGHTS_FLOAT;
        asset.skin.skinning = rows[i].skinning;
        assert_ok(context, pc_export_glb(context, &asset, path));
        glb g = read_glb(path);
        const cJSON *primitive =
            cJSON_GetArrayItem(child(element(&g, "meshes", 0), "primitives"), 0);
        char name[16];
        snprintf(name, sizeof(name), "JOINTS_%u", rows[i].sets - 1);
        assert_true(has_attribute(primitive, name));
        snprintf(name, sizeof(name), "JOINTS_%u", rows[i].sets);
        assert_false(has_attribute(primitive, name));
        assert_buffers_are_sound(&g);
        assert_names_are_unique(&g);
        assert_visual_matches(&g, &asset);
        assert_proxy_matches(&g, &asset);
        free_glb(&g);
        pc_asset_free(context, &asset);
    }
    pc_context_destroy(context);
}

// More than 256 joints need two bytes per index, more than 65535 vertices four.
static void glb_grows_its_indices(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    asset.options.skin.weight_storage = PC_SKIN_WEIGHTS_FLOAT;
    pc_visual_free(context, &asset.visual);
    pc_mesh_free(context, &asset.proxy);
    pc_motion_free(context, &asset.motion);
    pc_skin_free(context, &asset.skin);
    fixture_visual(context, 5100, &asset.visual);
    fixture_tube(context, 4, 75, 0.32, 0, &asset.proxy);
    fixture_motion(context, &asset.proxy, &asset.motion);
    fixture_skin(context, &asset.visual.surface, &asset.proxy, 2, &asset.skin);
    assert_ok(context, pc_export_glb(context, &asset, path));
    glb g = read_glb(path);
    const cJSON *primitive = cJSON_GetArrayItem(child(element(&g, "meshes", 0), "primitives"), 1);
    const size_t joints = number(child(primitive, "attributes"), "JOINTS_0");
    assert_int_equal(number(element(&g, "accessors", joints), "componentType"), 5123);
    const size_t indices = number(primitive, "indices");
    assert_int_equal(number(element(&g, "accessors", indices), "componentType"), 5125);
    assert_buffers_are_sound(&g);
    assert_visual_matches(&g, &asset);
    assert_proxy_matches(&g, &asset);
    free_glb(&g);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

// Nodes, materials and extras say what the header promises.
static void glb_describes_the_asset(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    assert_ok(context, pc_export_glb(context, &asset, path));
    glb g = read_glb(path);
    const size_t joints = asset.proxy.vertex_count;

    // Flat under one root; the meshes are at the root of the scene and have no transform.
    const cJSON *scene = child(element(&g, "scenes", 0), "nodes");
    assert_int_equal(cJSON_GetArraySize(scene), 3);
    const cJSON *root = element(&g, "nodes", (size_t)cJSON_GetArrayItem(scene, 0)->valueint);
    assert_int_equal(cJSON_GetArraySize(child(root, "children")), joints);
    const cJSON *garment = element(&g, "nodes", (size_t)cJSON_GetArrayItem(scene, 1)->valueint);
    const cJSON *proxy = element(&g, "nodes", (size_t)cJSON_GetArrayItem(scene, 2)->valueint);
    assert_string_equal(child(garment, "name")->valuestring, "tube_\xc3\xbc");
    assert_string_equal(child(proxy, "name")->valuestring, "tube_\xc3\xbc_proxy");
    assert_null(cJSON_GetObjectItem(garment, "translation"));
    assert_int_equal(number(garment, "skin"), number(proxy, "skin"));

    // Rest pose: inverse bind matrices are the inverse of the joints' translations.
    const cJSON *skin = element(&g, "skins", 0);
    size_t count = 0;
    double *matrices = read_accessor(&g, number(skin, "inverseBindMatrices"), &count);
    for (size_t j = 0; j < joints; ++j) {
        const cJSON *joint = element(
            &g, "nodes", (size_t)cJSON_GetArrayItem(child(skin, "joints"), (int)j)->valueint);
        for (size_t k = 0; k < 16; ++k) {
            const double expected =
                k >= 12 && k < 15
                    ? -cJSON_GetArrayItem(child(joint, "translation"), (int)k - 12)->valuedouble
                    : (k % 5 == 0 ? 1.0 : 0.0);
            assert_true(matrices[16 * j + k] == expected);
        }
    }
    free(matrices);

    // Times start at 0 and are spaced by the frame time.
    const cJSON *sampler = cJSON_GetArrayItem(child(element(&g, "animations", 0), "samplers"), 0);
    double *times = read_accessor(&g, number(sampler, "input"), &count);
    assert_int_equal(count, FIXTURE_FRAMES);
    for (size_t f = 0; f < count; ++f) {
        assert_close(times[f], (double)f / 30.0, 1e-7);
    }
    free(times);

    // Factors of the second used material.
    const cJSON *body = element(&g, "materials", 1);
    const cJSON *factors = child(body, "pbrMetallicRoughness");
    assert_close(child(factors, "metallicFactor")->valuedouble, 0.3, 1e-7);
    assert_close(cJSON_GetArrayItem(child(factors, "baseColorFactor"), 3)->valuedouble, 0.4, 1e-7);
    assert_true(cJSON_IsFalse(child(body, "doubleSided")));
    assert_string_equal(child(body, "alphaMode")->valuestring, "BLEND");
    assert_true(cJSON_IsTrue(child(element(&g, "materials", 0), "doubleSided")));

    const cJSON *extras = child(child(proxy, "extras"), "proxycloth");
    const cJSON *triangles = child(extras, "triangles");
    assert_int_equal(cJSON_GetArraySize(triangles), 3 * asset.proxy.triangle_count);
    assert_int_equal(cJSON_GetArrayItem(triangles, 5)->valueint, asset.proxy.triangles[5]);
    const cJSON *names = child(extras, "joints");
    assert_int_equal(cJSON_GetArraySize(names), joints);
    assert_string_equal(cJSON_GetArrayItem(names, 7)->valuestring,
                        child(element(&g, "nodes", 7), "name")->valuestring);
    size_t pins = 0;
    const cJSON *pin;
    cJSON_ArrayForEach(pin, child(extras, "pinned")) {
        assert_int_equal(asset.motion.pinned[pin->valueint], 1);
        ++pins;
    }
    assert_int_equal(pins, 6);
    // A tube of 3 bands of 6 quads: 4 rings of 6, 18 vertical and 18 diagonal edges; two rings are
    // on the boundary.
    const cJSON *stretch = child(extras, "stretch_springs"), *bend = child(extras, "bend_springs");
    assert_int_equal(cJSON_GetArraySize(child(stretch, "vertices")), 2 * 60);
    assert_int_equal(cJSON_GetArraySize(child(bend, "vertices")), 2 * 48);
    const cJSON *all[] = {stretch, bend};
    for (size_t s = 0; s < 2; ++s) {
        const cJSON *vertices = child(all[s], "vertices"), *lengths = child(all[s], "rest_lengths");
        for (int i = 0; i < cJSON_GetArraySize(lengths); ++i) {
            const int a = cJSON_GetArrayItem(vertices, 2 * i)->valueint;
            const int b = cJSON_GetArrayItem(vertices, 2 * i + 1)->valueint;
            const double length = sqrt(
                pci_squared_distance(&asset.proxy.positions[3 * a], &asset.proxy.positions[3 * b]));
            assert_true(cJSON_GetArrayItem(lengths, i)->valuedouble == length);
        }
    }
    assert_true(child(stretch, "stiffness")->valuedouble ==
                asset.options.simulate.stretch_stiffness);
    free_glb(&g);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

static void assert_unit_normals(const glb *g, double smallest_outward) {
    const cJSON *primitive;
    cJSON_ArrayForEach(primitive, child(element(g, "meshes", 0), "primitives")) {
        size_t count = 0;
        double *normals = read_attribute(g, primitive, "NORMAL", &count);
        double *positions = read_attribute(g, primitive, "POSITION", &count);
        for (size_t v = 0; v < count; ++v) {
            double radial[3] = {positions[3 * v], 0.0, positions[3 * v + 2]};
            assert_true(pci_normalize(radial));
            assert_close(pci_norm(&normals[3 * v]), 1.0, 1e-6);
            assert_true(pci_dot(radial, &normals[3 * v]) > smallest_outward);
        }
        free(normals);
        free(positions);
    }
}

// Given normals are kept, missing ones are computed over seams, those without direction replaced.
static void glb_has_unit_normals(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    asset.visual.normals[0] = asset.visual.normals[1] = asset.visual.normals[2] = 0.0f;
    for (size_t k = 3; k < 6; ++k) {
        asset.visual.normals[k] *= 5.0f;
    }
    assert_ok(context, pc_export_glb(context, &asset, path));
    glb g = read_glb(path);
    assert_unit_normals(&g, 0.95);
    free_glb(&g);

    pc_release(context, asset.visual.normals), asset.visual.normals = NULL;
    pc_release(context, asset.visual.texcoords), asset.visual.texcoords = NULL;
    pc_release(context, asset.visual.colors), asset.visual.colors = NULL;
    assert_ok(context, pc_export_glb(context, &asset, path));
    g = read_glb(path);
    assert_unit_normals(&g, 0.95);
    const cJSON *primitive = cJSON_GetArrayItem(child(element(&g, "meshes", 0), "primitives"), 0);
    assert_false(has_attribute(primitive, "TEXCOORD_0"));
    assert_false(has_attribute(primitive, "COLOR_0"));
    free_glb(&g);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

// Rows that break the order, repeat a bone or hold tiny weights are put in order.
static void glb_packs_weights(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    asset.options.skin.weight_storage = PC_SKIN_WEIGHTS_FLOAT;
    static const uint32_t bones[4] = {3, 9, 3, 1};
    static const double weights[4] = {0.2, 0.4, 0.4, 1e-60};
    memcpy(asset.skin.bones, bones, sizeof(bones));
    memcpy(asset.skin.weights, weights, sizeof(weights));
    assert_ok(context, pc_export_glb(context, &asset, path));
    glb g = read_glb(path);
    const cJSON *primitive = cJSON_GetArrayItem(child(element(&g, "meshes", 0), "primitives"), 0);
    size_t count = 0;
    double *packed = read_attribute(&g, primitive, "WEIGHTS_0", &count);
    double *joints = read_attribute(&g, primitive, "JOINTS_0", &count);
    assert_close(packed[0], 0.6, 1e-7);
    assert_close(packed[1], 0.4, 1e-7);
    assert_true(packed[2] == 0.0 && packed[3] == 0.0);
    assert_true(joints[0] == 3.0 && joints[1] == 9.0 && joints[2] == 0.0 && joints[3] == 0.0);
    assert_visual_matches(&g, &asset);
    free(packed);
    free(joints);
    free_glb(&g);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

// Integers: the sum of every vertex is exactly 1. Posed, the garment is where it should be.
static void glb_rounds_weights_to_exact_sums(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_asset asset;
    fixture_asset(context, 8, &asset);
    for (size_t i = 0; i < asset.skin.vertex_count; ++i) {
        double sum = 0.0;
        for (size_t k = 8 * i; k < 8 * i + 8; ++k) {
            asset.skin.bones[k] = (uint32_t)(k % 8);
            asset.skin.weights[k] = pow(pci_random(1, i, k), i % 3 == 0 ? 9.0 : 2.0);
            sum += asset.skin.weights[k];
        }
        for (size_t k = 8 * i; k < 8 * i + 8; ++k) {
            asset.skin.weights[k] /= sum;
        }
    }
    for (uint32_t storage = PC_SKIN_WEIGHTS_U16; storage <= PC_SKIN_WEIGHTS_U8; ++storage) {
        const double whole = storage == PC_SKIN_WEIGHTS_U8 ? 255.0 : 65535.0;
        asset.options.skin.weight_storage = storage;
        assert_ok(context, pc_export_glb(context, &asset, path));
        glb g = read_glb(path);
        assert_buffers_are_sound(&g);
        for (size_t mesh = 0; mesh < 2; ++mesh) { // the garment, the proxy
            const cJSON *primitive =
                cJSON_GetArrayItem(child(element(&g, "meshes", mesh), "primitives"), 0);
            const cJSON *attributes = child(primitive, "attributes");
            const cJSON *accessor = element(&g, "accessors", number(attributes, "WEIGHTS_0"));
            assert_true(cJSON_IsTrue(child(accessor, "normalized")));
            assert_int_equal(number(accessor, "componentType"),
                             storage == PC_SKIN_WEIGHTS_U8 ? 5121 : 5123);
            size_t count = 0;
            double *low = read_attribute(&g, primitive, "WEIGHTS_0", &count);
            double *high = mesh == 0 ? read_attribute(&g, primitive, "WEIGHTS_1", &count) : NULL;
            double *joints = read_attribute(&g, primitive, "JOINTS_0", &count);
            for (size_t i = 0; i < count; ++i) {
                double sum = 0.0;
                for (size_t k = 0; k < 8; ++k) {
                    const double *set = k < 4 ? low : high;
                    const double weight = set != NULL ? set[4 * i + k % 4] : 0.0;
                    assert_true(k >= 4 || weight > 0.0 || joints[4 * i + k] == 0.0);
                    assert_close(weight * whole, round(weight * whole), 1e-9);
                    sum += weight * whole;
                }
                assert_close(sum, whole, 1e-9);
            }
            free(low);
            free(high);
            free(joints);
        }
        free_glb(&g);
    }
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

static void glb_is_reproducible(void **state) {
    (void)state;
    static const uint32_t threads[] = {1, 2, 3, 8};
    for (size_t i = 0; i < 4; ++i) {
        pc_context *context = test_context(threads[i]);
        pc_asset asset;
        fixture_asset(context, 8, &asset);
        assert_ok(context, pc_export_glb(context, &asset, i == 0 ? path : other_path));
        pc_asset_free(context, &asset);
        pc_context_destroy(context);
        if (i > 0) {
            assert_same_file(path, other_path);
        }
    }
}

static void glb_refuses_what_it_cannot_hold(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    assert_int_equal(pc_export_glb(NULL, &asset, path), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_export_glb(context, NULL, path), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_export_glb(context, &asset, NULL), PC_ERROR_INVALID_ARGUMENT);
    asset.stage_count = PC_STAGE_SKIN;
    assert_int_equal(pc_export_glb(context, &asset, path), PC_ERROR_INVALID_ARGUMENT);
    asset.stage_count = PC_STAGE_COUNT;
    asset.skin.bones[0] = 24;
    assert_int_equal(pc_export_glb(context, &asset, path), PC_ERROR_INVALID_ARGUMENT);
    asset.skin.bones[0] = 0;
    assert_int_equal(pc_export_glb(context, &asset, "/tmp/no/such/folder/x.glb"), PC_ERROR_IO);
    assert_non_null(strstr(pc_context_error(context)->message, "/tmp/no/such/folder/x.glb"));

    pc_mesh_free(context, &asset.proxy);
    pc_motion_free(context, &asset.motion);
    fixture_tube(context, 2, 32769, 1.0, 0, &asset.proxy);
    fixture_motion(context, &asset.proxy, &asset.motion);
    assert_int_equal(pc_export_glb(context, &asset, path), PC_ERROR_TOO_LARGE);
    assert_non_null(strstr(pc_context_error(context)->message, "65538"));
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

static void glb_survives_lack_of_memory(void **state) {
    (void)state;
    check_writing_without_memory(pc_export_glb, path, 10);
}

// ---- OBJ --------------------------------------------------------------------------------------

static void obj_reads_back_exactly(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh mesh = {0}, back = {0};
    fixture_tube(context, 7, 9, 1.0 / 3.0, 0, &mesh);
    for (size_t i = 0; i < 3 * mesh.vertex_count; ++i) {
        mesh.positions[i] *= pow(10.0, (double)(i % 41) - 20.0);
    }
    mesh.positions[0] = -0.0;
    mesh.positions[1] = 0.1;
    mesh.positions[2] = 5e-324;
    assert_ok(context, pc_export_obj(context, &mesh, path));
    assert_true(test_read_obj(context, path, &back));
    assert_int_equal(mesh.vertex_count, back.vertex_count);
    assert_int_equal(mesh.triangle_count, back.triangle_count);
    assert_memory_equal(mesh.positions, back.positions, 24 * mesh.vertex_count);
    assert_memory_equal(mesh.triangles, back.triangles, 12 * mesh.triangle_count);
    bytes text = read_bytes(path);
    assert_non_null(strstr((char *)text.data, "v -0 0.1 4.94065645841247e-324\n"));
    free(text.data);

    mesh.positions[4] = (double)NAN;
    assert_int_equal(pc_export_obj(context, &mesh, path), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_export_obj(context, NULL, path), PC_ERROR_INVALID_ARGUMENT);
    mesh.positions[4] = 0.0;
    assert_int_equal(pc_export_obj(context, &mesh, "/dev/full"), PC_ERROR_IO);
    pc_mesh_free(context, &mesh);
    pc_mesh_free(context, &back);
    pc_context_destroy(context);
}

static void numbers_are_short_and_exact(void **state) {
    (void)state;
    static const struct {
        double number;
        const char *text;
    } rows[] = {{0.1, "0.1"},
                {1.0 / 3.0, "0.3333333333333333"},
                {5e-324, "4.94065645841247e-324"},
                {-1e300, "-1e+300"},
                {123456789.0, "123456789"},
                {(double)NAN, "null"},
                {-(double)INFINITY, "null"}};
    char text[40];
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); ++i) {
        pci_number_text(rows[i].number, text);
        assert_string_equal(text, rows[i].text);
    }
    for (uint64_t i = 0; i < 20000; ++i) {
        const uint64_t bits = pci_random_bits(5, 5, i);
        double number;
        memcpy(&number, &bits, sizeof(number));
        pci_number_text(number, text);
        if (isfinite(number)) {
            assert_true(strtod(text, NULL) == number);
        }
    }
}

// A program may run in a locale that writes commas.
static void numbers_ignore_the_locale(void **state) {
    (void)state;
    static const char *const names[] = {"de_DE.UTF-8", "de_DE.utf8", "fr_FR.UTF-8", "ps_AF.utf8"};
    bool found = false;
    for (size_t i = 0; i < 4 && !found; ++i) {
        found = setlocale(LC_NUMERIC, names[i]) != NULL;
    }
    if (!found) {
        skip();
    }
    char text[40];
    pci_number_text(-1234.5e-30, text);
    setlocale(LC_NUMERIC, "C");
    assert_string_equal(text, "-1.2345e-27");
}

// ---- report -----------------------------------------------------------------------------------

static cJSON *read_json(const char *name) {
    bytes text = read_bytes(name);
    cJSON *json = cJSON_ParseWithOpts((const char *)text.data, NULL, 0);
    assert_non_null(json);
    free(text.data);
    return json;
}

static void assert_json_record(const cJSON *object, const pc_record *record, const void *values) {
    assert_int_equal(cJSON_GetArraySize(object), record->field_count);
    for (size_t i = 0; i < record->field_count; ++i) {
        const pc_field *field = &record->fields[i];
        const cJSON *item = child(object, field->name);
        const double value = pc_field_number(field, values);
        if (field->type == PC_FIELD_CHOICE) {
            assert_string_equal(item->valuestring, field->choices[(size_t)value]);
        } else if (field->type == PC_FIELD_BOOL) {
            assert_int_equal(cJSON_IsTrue(item), value != 0.0);
        } else if (field->zero != NULL && value == 0.0) {
            assert_string_equal(item->valuestring, field->zero);
        } else if (isfinite(value)) {
            assert_true(cJSON_IsNumber(item) && item->valuedouble == value);
        } else {
            assert_true(cJSON_IsNull(item));
        }
    }
}

static void report_holds_everything(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    asset.reports.skin.loss_after = (double)NAN;
    asset.reports.voxelize.queries = UINT64_MAX;
    pc_measures measures;
    memset(&measures, 0, sizeof(measures));
    fixture_record(&pc_measures_record, false, 40, &measures);
    pc_timings timings;
    for (size_t i = 0; i < PC_STAGE_COUNT; ++i) {
        timings.seconds[i] = 0.25 * (double)i;
    }
    assert_ok(context, pc_export_report(context, &asset, &measures, &timings, path));
    cJSON *json = read_json(path);
    assert_int_equal(number(json, "schema"), 1);
    assert_string_equal(child(child(json, "versions"), "proxycloth")->valuestring, pc_version());
    assert_string_equal(child(json, "name")->valuestring, asset.name);
    assert_json_record(child(child(json, "visual"), "report"), &pc_visual_report_record,
                       &asset.reports.visual);
    for (pc_stage stage = 0; stage < PC_STAGE_COUNT; ++stage) {
        const pc_stage_info *info = pc_stage_describe(stage);
        const cJSON *object = child(child(json, "stages"), info->name);
        assert_json_record(child(object, "options"), info->options,
                           (char *)&asset.options + info->options_offset);
        assert_json_record(child(object, "report"), info->report,
                           (char *)&asset.reports + info->report_offset);
    }
    assert_json_record(child(json, "measures"), &pc_measures_record, &measures);
    double triangles = 0.0;
    for (int bin = 0; bin < PC_HISTOGRAM_BINS; ++bin) {
        const cJSON *counts = child(child(child(json, "histograms"), "edge_ratio"), "counts");
        assert_int_equal(cJSON_GetArraySize(counts), PC_HISTOGRAM_BINS);
        triangles += cJSON_GetArrayItem(counts, bin)->valuedouble;
    }
    assert_true(triangles == (double)asset.proxy.triangle_count);
    assert_true(child(child(json, "label"), "bound")->valuedouble == asset.reports.label.bound);
    assert_string_equal(child(child(json, "label"), "outcome")->valuestring, "feasible");
    const cJSON *losses = child(json, "losses");
    assert_true(child(child(losses, "before"), "total")->valuedouble ==
                asset.reports.skin.loss_before);
    assert_true(cJSON_IsNull(child(child(losses, "after"), "total")));
    assert_true(child(child(json, "timings"), "skin")->valuedouble == 2.0);
    assert_true(child(child(json, "timings"), "total")->valuedouble == 9.0);
    cJSON_Delete(json);
    // More digits than a double has.
    bytes text = read_bytes(path);
    assert_non_null(strstr((char *)text.data, "18446744073709551615"));
    free(text.data);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

// One warning per field that has a warning text and is not 0.
static void report_lists_warnings(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    memset(&asset.reports, 0, sizeof(asset.reports));
    assert_ok(context, pc_export_report(context, &asset, NULL, NULL, path));
    cJSON *json = read_json(path);
    assert_int_equal(cJSON_GetArraySize(child(json, "warnings")), 0);
    assert_false(cJSON_HasObjectItem(json, "timings"));
    assert_false(cJSON_HasObjectItem(json, "measures"));
    cJSON_Delete(json);

    asset.reports.visual.duplicate_triangles = 17;
    asset.reports.visual.vertices = 5; // no warning
    assert_ok(context, pc_export_report(context, &asset, NULL, NULL, path));
    json = read_json(path);
    assert_int_equal(cJSON_GetArraySize(child(json, "warnings")), 1);
    const cJSON *warning = child(json, "warnings")->child;
    assert_string_equal(child(warning, "stage")->valuestring, "visual");
    assert_string_equal(child(warning, "field")->valuestring, "duplicate_triangles");
    assert_int_equal(number(warning, "count"), 17);
    assert_non_null(strstr(child(warning, "message")->valuestring, "duplicate"));
    cJSON_Delete(json);

    const pc_measures measures = {.self_intersections = 3};
    assert_ok(context, pc_export_report(context, &asset, &measures, NULL, path));
    json = read_json(path);
    assert_int_equal(cJSON_GetArraySize(child(json, "warnings")), 2);
    warning = child(json, "warnings")->child->next;
    assert_string_equal(child(warning, "stage")->valuestring, "evaluate");
    assert_string_equal(child(warning, "field")->valuestring, "self_intersections");
    assert_int_equal(number(warning, "count"), 3);
    cJSON_Delete(json);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

// Only what ran is reported; only the timings differ between runs.
static void report_is_reproducible(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    asset.stage_count = PC_STAGE_LABEL;
    const pc_timings first = {{1.0}}, second = {{2.0}};
    assert_ok(context, pc_export_report(context, &asset, NULL, &first, path));
    assert_ok(context, pc_export_report(context, &asset, NULL, &second, other_path));
    cJSON *a = read_json(path), *b = read_json(other_path);
    assert_false(cJSON_Compare(a, b, 1));
    cJSON_DeleteItemFromObject(a, "timings");
    cJSON_DeleteItemFromObject(b, "timings");
    assert_true(cJSON_Compare(a, b, 1));
    assert_int_equal(cJSON_GetArraySize(child(a, "stages")), PC_STAGE_LABEL);
    assert_false(cJSON_HasObjectItem(a, "label"));
    assert_false(cJSON_HasObjectItem(a, "losses"));
    cJSON_Delete(a);
    cJSON_Delete(b);
    assert_ok(context, pc_export_report(context, &asset, NULL, &first, other_path));
    assert_same_file(path, other_path);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

static size_t json_calls, json_fail_at;

static void *failing_malloc(size_t size) {
    return ++json_calls == json_fail_at ? NULL : malloc(size);
}

// cJSON runs out of memory at many places; names that are not UTF-8 do not break the text.
static void report_survives_lack_of_memory(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    snprintf(asset.name, sizeof(asset.name), "a\xff\xc3(\xe2\x82\xac\"\n");
    cJSON_Hooks hooks = {failing_malloc, free};
    cJSON_InitHooks(&hooks);
    size_t failures = 0;
    for (json_fail_at = 1;; json_fail_at += 7) {
        json_calls = 0;
        const pc_status status = pc_export_report(context, &asset, NULL, NULL, path);
        if (status == PC_OK) {
            break;
        }
        assert_int_equal(status, PC_ERROR_OUT_OF_MEMORY);
        ++failures;
    }
    cJSON_InitHooks(NULL);
    assert_true(failures > 50);
    cJSON *json = read_json(path);
    assert_string_equal(child(json, "name")->valuestring, "a?\?(\xe2\x82\xac\"\n");
    cJSON_Delete(json);
    assert_int_equal(pc_export_report(context, NULL, NULL, NULL, path), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_export_report(context, &asset, NULL, NULL, "/tmp/no/such/folder/x.json"),
                     PC_ERROR_IO);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

static int make_folder(void **state) {
    (void)state;
    return test_make_folder(folder, path, "first", other_path, "second");
}

static int remove_folder(void **state) {
    (void)state;
    return test_remove_folder(folder, path, other_path);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(glb_poses_like_the_weights_ask),
        cmocka_unit_test(glb_grows_its_indices),
        cmocka_unit_test(glb_describes_the_asset),
        cmocka_unit_test(glb_has_unit_normals),
        cmocka_unit_test(glb_packs_weights),
        cmocka_unit_test(glb_rounds_weights_to_exact_sums),
        cmocka_unit_test(glb_is_reproducible),
        cmocka_unit_test(glb_refuses_what_it_cannot_hold),
        cmocka_unit_test(glb_survives_lack_of_memory),
        cmocka_unit_test(obj_reads_back_exactly),
        cmocka_unit_test(numbers_are_short_and_exact),
        cmocka_unit_test(numbers_ignore_the_locale),
        cmocka_unit_test(report_holds_everything),
        cmocka_unit_test(report_lists_warnings),
        cmocka_unit_test(report_is_reproducible),
        cmocka_unit_test(report_survives_lack_of_memory),
    };
    return cmocka_run_group_tests_name("export", tests, make_folder, remove_folder);
}
