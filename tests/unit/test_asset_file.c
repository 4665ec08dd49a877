#define _POSIX_C_SOURCE 200809L
#include <hdf5.h>
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include "support/asset_fixture.h"
#include "support/character_fixture.h"
#include "support/files.h"
#include "support/lack_of_memory.h"
#include "support/memory.h"

static char folder[64], path[64], other_path[64];

// The seal behind the HDF5 part: a mark and FNV-1a of what is before it.
static void seal_bytes(bytes content) {
    uint64_t hash = 0xcbf29ce484222325u;
    for (size_t i = 0; i < content.size - 16; ++i) {
        hash = (hash ^ content.data[i]) * 0x100000001b3u;
    }
    memcpy(content.data + content.size - 16, "pc-asset", 8);
    for (size_t i = 0; i < 8; ++i) {
        content.data[content.size - 8 + i] = (unsigned char)(hash >> (8 * i));
    }
}

static void assert_empty(const pc_asset *asset) {
    static const pc_asset empty;
    assert_memory_equal(asset, &empty, sizeof(empty));
}

// A new context per file: HDF5 may remember nothing between two.
static void saved_file(uint32_t influences, uint32_t stages) {
    pc_context *context = test_context(1);
    pc_asset asset;
    fixture_asset(context, influences, &asset);
    asset.stage_count = stages;
    assert_ok(context, pc_asset_save(context, &asset, path));
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

static void assert_same_mesh(const pc_mesh *a, const pc_mesh *b) {
    assert_int_equal(a->vertex_count, b->vertex_count);
    assert_int_equal(a->triangle_count, b->triangle_count);
    assert_memory_equal(a->positions, b->positions, 24 * a->vertex_count);
    assert_memory_equal(a->triangles, b->triangles, 12 * a->triangle_count);
}

static void assert_same_visual(const pc_visual *a, const pc_visual *b) {
    const size_t corners = a->corner_count, triangles = a->surface.triangle_count;
    assert_same_mesh(&a->surface, &b->surface);
    assert_int_equal(corners, b->corner_count);
    assert_memory_equal(a->corner_vertices, b->corner_vertices, 4 * corners);
    assert_memory_equal(a->corner_triangles, b->corner_triangles, 12 * triangles);
    assert_memory_equal(a->normals, b->normals, 12 * corners);
    assert_memory_equal(a->texcoords, b->texcoords, 8 * corners);
    assert_memory_equal(a->colors, b->colors, 16 * corners);
    assert_memory_equal(a->triangle_materials, b->triangle_materials, 4 * triangles);
    assert_int_equal(a->material_count, b->material_count);
    for (size_t i = 0; i < a->material_count; ++i) {
        const pc_material *x = &a->materials[i], *y = &b->materials[i];
        assert_string_equal(x->name, y->name);
        assert_memory_equal(x->base_color, y->base_color, sizeof(x->base_color));
        assert_memory_equal(&x->metallic, &y->metallic, sizeof(float));
        assert_memory_equal(&x->roughness, &y->roughness, sizeof(float));
        assert_int_equal(x->double_sided, y->double_sided);
    }
}

static void assert_same_record(const pc_record *record, const void *a, const void *b) {
    assert_true(record->field_count > 0);
    for (size_t i = 0; i < record->field_count; ++i) {
        const double x = pc_field_number(&record->fields[i], a);
        const double y = pc_field_number(&record->fields[i], b);
        if (memcmp(&x, &y, sizeof(x)) != 0) {
            fail_msg("%s is %g, was %g", record->fields[i].name, y, x);
        }
    }
}

static void every_field_survives(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_asset a, b = {0};
    fixture_asset(context, 4, &a);
    // More than a double can hold, and what is no number.
    a.reports.voxelize.queries = UINT64_MAX;
    a.reports.skin.loss_before = (double)NAN;
    a.reports.skin.loss_after = (double)INFINITY;
    assert_ok(context, pc_asset_save(context, &a, path));
    assert_ok(context, pc_asset_load(context, path, &b));

    assert_string_equal(a.name, b.name);
    assert_int_equal(b.stage_count, PC_STAGE_COUNT);
    assert_true(b.reports.voxelize.queries == UINT64_MAX);
    assert_same_record(&pc_visual_report_record, &a.reports.visual, &b.reports.visual);
    for (pc_stage stage = 0; stage < PC_STAGE_COUNT; ++stage) {
        const pc_stage_info *info = pc_stage_describe(stage);
        assert_same_record(info->options, (char *)&a.options + info->options_offset,
                           (char *)&b.options + info->options_offset);
        assert_same_record(info->report, (char *)&a.reports + info->report_offset,
                           (char *)&b.reports + info->report_offset);
    }
    assert_same_visual(&a.visual, &b.visual);
    assert_memory_equal(a.grid.origin, b.grid.origin, sizeof(a.grid.origin));
    assert_memory_equal(a.grid.size, b.grid.size, sizeof(a.grid.size));
    assert_memory_equal(&a.grid.cell_size, &b.grid.cell_size, sizeof(double));
    assert_memory_equal(&a.grid.band, &b.grid.band, sizeof(double));
    assert_int_equal(a.grid.sample_count, b.grid.sample_count);
    assert_memory_equal(a.grid.samples, b.grid.samples, 8 * a.grid.sample_count);
    assert_memory_equal(a.grid.values, b.grid.values, 4 * a.grid.sample_count);
    assert_same_mesh(&a.isosurface, &b.isosurface);
    assert_same_mesh(&a.projected, &b.projected);
    assert_int_equal(a.graph.vertex_count, b.graph.vertex_count);
    assert_memory_equal(a.graph.curvatures, b.graph.curvatures, 8 * a.graph.vertex_count);
    assert_memory_equal(a.graph.outer_distances, b.graph.outer_distances, 8 * a.graph.vertex_count);
    assert_true(isinf(b.graph.outer_distances[1]));
    assert_int_equal(a.graph.edge_count, b.graph.edge_count);
    assert_memory_equal(a.graph.edges, b.graph.edges, 8 * a.graph.edge_count);
    assert_memory_equal(a.graph.edge_weights, b.graph.edge_weights, 8 * a.graph.edge_count);
    assert_int_equal(a.graph.opposite_count, b.graph.opposite_count);
    assert_memory_equal(a.graph.opposites, b.graph.opposites, 8 * a.graph.opposite_count);
    assert_memory_equal(a.graph.opposite_signs, b.graph.opposite_signs, a.graph.opposite_count);
    assert_int_equal(a.labels.vertex_count, b.labels.vertex_count);
    assert_memory_equal(a.labels.labels, b.labels.labels, a.labels.vertex_count);
    assert_same_mesh(&a.single_layer, &b.single_layer);
    assert_same_mesh(&a.proxy, &b.proxy);
    assert_int_equal(a.motion.frame_count, b.motion.frame_count);
    assert_int_equal(a.motion.vertex_count, b.motion.vertex_count);
    assert_memory_equal(&a.motion.frame_time, &b.motion.frame_time, sizeof(double));
    assert_memory_equal(a.motion.positions, b.motion.positions,
                        24 * a.motion.frame_count * a.motion.vertex_count);
    assert_memory_equal(a.motion.pinned, b.motion.pinned, a.motion.vertex_count);
    assert_int_equal(a.skin.vertex_count, b.skin.vertex_count);
    assert_int_equal(a.skin.influences, b.skin.influences);
    const size_t slots = a.skin.vertex_count * a.skin.influences;
    assert_memory_equal(a.skin.bones, b.skin.bones, 4 * slots);
    assert_memory_equal(a.skin.weights, b.skin.weights, 8 * slots);

    pc_asset_free(context, &a);
    pc_asset_free(context, &b);
    pc_context_destroy(context);
}

// The same bytes in every run, after every number of stages, and after a load.
static void bytes_are_reproducible(void **state) {
    (void)state;
    for (uint32_t stages = 0; stages <= PC_STAGE_COUNT; ++stages) {
        saved_file(4, stages);
        assert_int_equal(rename(path, other_path), 0);
        saved_file(4, stages);
        assert_same_file(path, other_path);

        pc_context *context = test_context(1);
        pc_asset asset = {0};
        assert_ok(context, pc_asset_load(context, path, &asset));
        assert_int_equal(asset.stage_count, stages);
        assert_true((asset.skin.weights != NULL) == (stages == PC_STAGE_COUNT));
        assert_true((asset.grid.values != NULL) == (stages > 0));
        assert_ok(context, pc_asset_save(context, &asset, other_path));
        pc_asset_free(context, &asset);
        pc_context_destroy(context);
        assert_same_file(path, other_path);
    }
}

// What the garment's file holds besides it, and what the proxy went through.
static void scenario_and_character_survive(void **state) {
    (void)state;
    static const char text[] =
        "{\"winds\": [{\"time\": 0.1, \"velocity\": [0.3, 0, 1e-17]}], \"pins\": [{\"mesh\": "
        "\"Cape*\"}], \"attachment\": {\"clip\": \"turn\"}, \"colliders\": [{\"shape\": "
        "\"body\"}]}";
    pc_context *context = test_context(1);
    pc_asset a, b = {0};
    fixture_asset(context, 4, &a);
    const double center[3] = {0.0, 1.0, 0.0};
    fixture_character(context, center, 0.2, 1, &a.character);
    pc_simulate_options options = pc_default_options().simulate;
    assert_ok(context,
              pc_scenario_parse(context, text, strlen(text), "text", &options, &a.scenario));
    const size_t corners = a.visual.corner_count, triangles = a.visual.surface.triangle_count;
    a.visual.part_count = 1;
    a.visual.part_names = fixture_copy(context, (char[64]){"Cape_Mesh"}, 64);
    a.visual.triangle_parts = PCI_ALLOCATE(context, uint32_t, triangles);
    a.visual.joints = PCI_ALLOCATE(context, uint32_t, 4 * corners);
    a.visual.joint_weights = PCI_ALLOCATE(context, float, 4 * corners);
    for (size_t c = 0; c < corners; ++c) {
        a.visual.joints[4 * c + 1] = 1;
        a.visual.joint_weights[4 * c + 1] = 1.0F;
    }
    assert_ok(context, pc_asset_save(context, &a, path));
    assert_ok(context, pc_asset_load(context, path, &b));
    assert_ok(context, pc_asset_save(context, &b, other_path));
    assert_same_file(path, other_path);

    const pc_character *c = &a.character, *d = &b.character;
    assert_int_equal(d->joint_count, 2);
    assert_memory_equal(c->joint_names, d->joint_names, 128);
    assert_memory_equal(c->joint_centers, d->joint_centers, 48);
    assert_memory_equal(c->joint_parents, d->joint_parents, 8);
    assert_int_equal(d->clip_count, 1);
    assert_string_equal(d->clip_names, "turn");
    assert_memory_equal(c->clip_poses, d->clip_poses, 8);
    assert_memory_equal(c->clip_rates, d->clip_rates, 8);
    assert_int_equal(d->pose_count, FIXTURE_POSES);
    assert_memory_equal(c->poses, d->poses, 48 * 2 * FIXTURE_POSES);
    assert_same_mesh(&c->body, &d->body);
    assert_string_equal(d->body_part_names, "Ball_Mesh");
    assert_memory_equal(c->body_joints, d->body_joints, 16 * c->body.vertex_count);
    assert_memory_equal(c->body_weights, d->body_weights, 16 * c->body.vertex_count);
    assert_string_equal(b.visual.part_names, "Cape_Mesh");
    assert_memory_equal(a.visual.joints, b.visual.joints, 16 * corners);
    assert_memory_equal(a.visual.joint_weights, b.visual.joint_weights, 16 * corners);
    assert_int_equal(b.scenario.wind_count, 1);
    assert_memory_equal(a.scenario.winds, b.scenario.winds, sizeof(pc_wind_key));
    assert_memory_equal(a.scenario.pins, b.scenario.pins, sizeof(pc_pin));
    assert_memory_equal(a.scenario.colliders, b.scenario.colliders, sizeof(pc_collider));
    assert_string_equal(b.scenario.attachment.clip, "turn");

    // What would not load is not saved.
    a.character.clip_poses[1] = FIXTURE_POSES + 1;
    assert_int_equal(pc_asset_save(context, &a, path), PC_ERROR_INVALID_ARGUMENT);
    a.character.clip_poses[1] = FIXTURE_POSES;
    a.character.body_joints[5] = 2;
    assert_int_equal(pc_asset_save(context, &a, path), PC_ERROR_INVALID_ARGUMENT);
    a.character.body_joints[5] = 0;
    memset(a.visual.part_names, 'x', 64);
    assert_int_equal(pc_asset_save(context, &a, path), PC_ERROR_INVALID_ARGUMENT);
    memset(a.visual.part_names, 0, 64);
    a.scenario.colliders[0].kind = (pc_collider_kind)9;
    assert_int_equal(pc_asset_save(context, &a, path), PC_ERROR_INVALID_ARGUMENT);
    pc_asset_free(context, &a);
    pc_asset_free(context, &b);
    pc_context_destroy(context);
}

static void optional_and_empty_arrays_survive(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_asset a, b = {0};
    fixture_asset(context, 4, &a);
    pc_release(context, a.visual.normals), a.visual.normals = NULL;
    pc_release(context, a.visual.colors), a.visual.colors = NULL;
    pc_release(context, a.graph.curvatures), a.graph.curvatures = NULL;
    pc_release(context, a.graph.outer_distances), a.graph.outer_distances = NULL;
    a.graph.opposite_count = 0;
    a.name[0] = '\0';
    assert_ok(context, pc_asset_save(context, &a, path));
    assert_ok(context, pc_asset_load(context, path, &b));
    assert_null(b.visual.normals);
    assert_non_null(b.visual.texcoords);
    assert_null(b.visual.colors);
    assert_null(b.graph.curvatures);
    assert_null(b.graph.outer_distances);
    assert_int_equal(b.graph.vertex_count, 4);
    assert_int_equal(b.graph.opposite_count, 0);
    assert_string_equal(b.name, "");
    pc_asset_free(context, &a);
    pc_asset_free(context, &b);
    pc_context_destroy(context);
}

// Arrays of several pieces.
static void large_arrays_survive(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_asset a, b = {0};
    fixture_asset(context, 4, &a);
    const size_t frames = 3001, numbers = frames * a.motion.vertex_count * 3;
    pc_release(context, a.motion.positions);
    a.motion.frame_count = frames;
    a.motion.positions = PCI_ALLOCATE(context, double, numbers);
    for (size_t i = 0; i < numbers; ++i) {
        a.motion.positions[i] = pci_random(1, 2, i);
    }
    assert_ok(context, pc_asset_save(context, &a, path));
    assert_ok(context, pc_asset_load(context, path, &b));
    assert_int_equal(b.motion.frame_count, frames);
    assert_memory_equal(a.motion.positions, b.motion.positions, 8 * numbers);
    assert_ok(context, pc_asset_save(context, &b, other_path));
    assert_same_file(path, other_path);
    struct stat info;
    assert_int_equal(stat(path, &info), 0);
    assert_true((size_t)info.st_size < 8 * numbers + 200000);
    pc_asset_free(context, &a);
    pc_asset_free(context, &b);
    pc_context_destroy(context);
}

// ---- files that are no assets -------------------------------------------------------------------

static void assert_refused(const char *name, pc_status expected, const char *text) {
    pc_context *context = test_context(1);
    pc_asset asset = {0};
    assert_int_equal(pc_asset_load(context, name, &asset), expected);
    assert_empty(&asset);
    const char *message = pc_context_error(context)->message;
    if (strstr(message, text) == NULL || strstr(message, name) == NULL) {
        fail_msg("message \"%s\" lacks \"%s\" or the path", message, text);
    }
    pc_context_destroy(context);
}

static void other_files_are_refused(void **state) {
    (void)state;
    assert_refused("/tmp/no/such/file", PC_ERROR_IO, "No such file");
    assert_refused(folder, PC_ERROR_IO, "regular file");
    write_bytes(path, "", 0);
    assert_refused(path, PC_ERROR_FORMAT, "not HDF5");
    static const char text[] = "v 0 0 0 and much more text than a superblock of HDF5 would need\n";
    write_bytes(path, text, sizeof(text));
    assert_refused(path, PC_ERROR_FORMAT, "not HDF5");
    for (int latest = 0; latest <= 1; ++latest) {
        const hid_t access = H5Pcreate(H5P_FILE_ACCESS);
        if (latest == 1) {
            H5Pset_libver_bounds(access, H5F_LIBVER_V110, H5F_LIBVER_V110);
        }
        const hid_t file = H5Fcreate(path, H5F_ACC_TRUNC, H5P_DEFAULT, access);
        assert_true(file >= 0);
        H5Fclose(file);
        H5Pclose(access);
        assert_refused(path, PC_ERROR_FORMAT, "another kind");
    }
}

// Applies `change` to the root of a saved asset and seals it again.
static void change_file(void (*change)(hid_t root)) {
    saved_file(4, PC_STAGE_COUNT);
    const hid_t file = H5Fopen(path, H5F_ACC_RDWR, H5P_DEFAULT);
    assert_true(file >= 0);
    change(file);
    assert_true(H5Fclose(file) >= 0);
    bytes changed = read_bytes(path);
    changed.data = realloc(changed.data, changed.size + 16);
    changed.size += 16;
    seal_bytes(changed);
    write_bytes(path, changed.data, changed.size);
    free(changed.data);
}

static void set_u32(hid_t root, const char *name, uint32_t value) {
    const hid_t attribute = H5Aopen(root, name, H5P_DEFAULT);
    assert_true(H5Awrite(attribute, H5T_NATIVE_UINT32, &value) >= 0);
    H5Aclose(attribute);
}

static void make_newer(hid_t root) {
    set_u32(root, "format_version", PC_ASSET_FORMAT_VERSION + 1);
    // What a newer version did to the rest must not matter.
    assert_true(H5Adelete(root, "stage_count") >= 0);
}
static void claim_stages(hid_t root) { set_u32(root, "stage_count", 4000000000u); }
static void drop_positions(hid_t root) { H5Ldelete(root, "simplify/positions", H5P_DEFAULT); }
static void drop_stage(hid_t root) { H5Ldelete(root, "carve", H5P_DEFAULT); }

static void set_value(hid_t root, const char *name, hid_t type, size_t size, size_t index,
                      const void *value) {
    const hid_t dataset = H5Dopen2(root, name, H5P_DEFAULT);
    const hid_t space = H5Dget_space(dataset);
    const size_t count = (size_t)H5Sget_simple_extent_npoints(space);
    assert_true(index < count);
    unsigned char *values = calloc(count, size);
    assert_true(H5Dread(dataset, type, H5S_ALL, H5S_ALL, H5P_DEFAULT, values) >= 0);
    memcpy(values + index * size, value, size);
    assert_true(H5Dwrite(dataset, type, H5S_ALL, H5S_ALL, H5P_DEFAULT, values) >= 0);
    free(values);
    H5Sclose(space);
    H5Dclose(dataset);
}

static void put_nan(hid_t root) {
    const double value = (double)NAN;
    set_value(root, "simulate/positions", H5T_NATIVE_DOUBLE, 8, 7, &value);
}
static void put_wild_index(hid_t root) {
    const uint32_t value = 24;
    set_value(root, "skin/bones", H5T_NATIVE_UINT32, 4, 3, &value);
}
static void put_sample(hid_t root) {
    const uint64_t value = 60;
    set_value(root, "voxelize/samples", H5T_NATIVE_UINT64, 8, 4, &value);
}
static void put_weight(hid_t root) {
    const double value = -0.5;
    set_value(root, "skin/weights", H5T_NATIVE_DOUBLE, 8, 0, &value);
}
static void put_corner(hid_t root) {
    const uint32_t value = 50;
    set_value(root, "visual/corner_vertices", H5T_NATIVE_UINT32, 4, 0, &value);
}
static void put_label(hid_t root) {
    const uint8_t value = 2;
    set_value(root, "label/labels", H5T_NATIVE_UINT8, 1, 0, &value);
}

// Replaces a dataset by one without data.
static void put_shape(hid_t root, const char *name, hid_t type, int rank, const hsize_t *shape) {
    H5Ldelete(root, name, H5P_DEFAULT);
    const hid_t space = H5Screate_simple(rank, shape, NULL);
    const hid_t dataset =
        H5Dcreate2(root, name, type, space, H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT);
    assert_true(dataset >= 0);
    H5Dclose(dataset);
    H5Sclose(space);
}

static void put_huge(hid_t root) {
    const hsize_t shape[2] = {(hsize_t)1 << 40, 3};
    put_shape(root, "carve/positions", H5T_IEEE_F64LE, 2, shape);
}
// Below the limit of 2^31 rows, 48 GB that the file does not have.
static void put_hollow(hid_t root) {
    const hsize_t shape[2] = {2000000000, 3};
    put_shape(root, "carve/positions", H5T_IEEE_F64LE, 2, shape);
}
static void put_rank(hid_t root) {
    const hsize_t shape[1] = {24};
    put_shape(root, "carve/positions", H5T_IEEE_F64LE, 1, shape);
}
static void put_type(hid_t root) {
    const hsize_t shape[2] = {4, 3};
    put_shape(root, "carve/positions", H5T_IEEE_F32LE, 2, shape);
}
static void put_count(hid_t root) {
    const hsize_t shape[1] = {0};
    put_shape(root, "label/labels", H5T_STD_U8LE, 1, shape);
}
static void put_outside(hid_t root) {
    H5Ldelete(root, "carve/positions", H5P_DEFAULT);
    assert_true(H5Lcreate_external("/etc/passwd", "/x", root, "carve/positions", H5P_DEFAULT,
                                   H5P_DEFAULT) >= 0);
}
static void rename_choice(hid_t root) {
    const hid_t group = H5Gopen2(root, "label/report", H5P_DEFAULT);
    assert_true(H5Adelete(group, "outcome") >= 0);
    const hid_t type = H5Tcopy(H5T_C_S1), space = H5Screate(H5S_SCALAR);
    H5Tset_size(type, 8);
    H5Tset_cset(type, H5T_CSET_UTF8);
    const hid_t attribute = H5Acreate2(group, "outcome", type, space, H5P_DEFAULT, H5P_DEFAULT);
    assert_true(H5Awrite(attribute, type, "perfect") >= 0);
    H5Aclose(attribute);
    H5Sclose(space);
    H5Tclose(type);
    H5Gclose(group);
}

static void changed_files_are_refused(void **state) {
    (void)state;
    static const struct {
        void (*change)(hid_t root);
        const char *text;
    } rows[] = {
        {make_newer, "use a newer proxycloth"},
        {claim_stages, "stage_count"},
        {drop_positions, "positions is missing"},
        {drop_stage, "carve is missing"},
        {put_nan, "value 7 of /simulate/positions"},
        {put_wild_index, "value 3 of /skin/bones"},
        {put_sample, "value 4 of /voxelize/samples"},
        {put_weight, "weights of vertex 0"},
        {put_corner, "belongs to another vertex"},
        {put_label, "value 0 of /label/labels"},
        {put_huge, "larger than the file"},
        {put_hollow, "larger than the file"},
        {put_rank, "another type or shape"},
        {put_type, "another type or shape"},
        {put_count, "/label and /graph differ"},
        {put_outside, "positions is missing"},
        {rename_choice, "unknown choice"},
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); ++i) {
        change_file(rows[i].change);
        assert_refused(path, PC_ERROR_FORMAT, rows[i].text);
    }
}

static void drop_option(hid_t root) {
    const hid_t group = H5Gopen2(root, "skin/options", H5P_DEFAULT);
    assert_true(H5Adelete(group, "epochs") >= 0);
    H5Gclose(group);
}

// A library that did not know an option yet behaved as with its default.
static void missing_options_have_their_default(void **state) {
    (void)state;
    change_file(drop_option);
    pc_context *context = test_context(1);
    pc_asset asset = {0};
    assert_ok(context, pc_asset_load(context, path, &asset));
    assert_int_equal(asset.options.skin.epochs, pc_default_options().skin.epochs);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

// Loads damaged bytes: an error with an empty asset (false), or a whole asset.
static bool load_damaged(pc_context *context, const void *data, size_t size) {
    write_bytes(path, data, size);
    pc_asset asset = {0};
    const pc_status status = pc_asset_load(context, path, &asset);
    if (status == PC_OK) {
        assert_non_null(asset.skin.weights);
        pc_asset_free(context, &asset);
        return true;
    }
    assert_int_equal(status, PC_ERROR_FORMAT);
    assert_empty(&asset);
    return false;
}

static void truncated_files_are_refused(void **state) {
    (void)state;
    saved_file(2, PC_STAGE_COUNT);
    bytes whole = read_bytes(path);
    pc_context *context = test_context(1);
    for (size_t i = 0; i < 200; ++i) {
        assert_false(load_damaged(context, whole.data, whole.size * i / 200));
    }
    assert_false(load_damaged(context, whole.data, whole.size - 1));
    assert_true(load_damaged(context, whole.data, whole.size));
    pc_context_destroy(context);
    free(whole.data);
}

static void flipped_bits_are_noticed(void **state) {
    (void)state;
    saved_file(2, PC_STAGE_COUNT);
    bytes whole = read_bytes(path);
    pc_context *context = test_context(1);
    for (size_t i = 0; i < 400; ++i) {
        // Half of them in the first kilobyte, where the structure begins.
        const size_t range = i % 2 == 0 ? whole.size : 1024;
        const size_t at = (size_t)(pci_random(7, 1, i) * (double)range);
        const unsigned char bit = (unsigned char)(1u << (pci_random_bits(7, 2, i) % 8));
        whole.data[at] ^= bit;
        assert_false(load_damaged(context, whole.data, whole.size));
        whole.data[at] ^= bit;
    }
    pc_context_destroy(context);
    free(whole.data);
}

// Wrong values under a good checksum: refused, or an asset whose values are in range.
static void wild_values_are_harmless(void **state) {
    (void)state;
    static const char *const names[] = {"visual/positions",
                                        "visual/triangles",
                                        "visual/corner_vertices",
                                        "visual/materials",
                                        "visual/corner_triangles",
                                        "voxelize/samples",
                                        "voxelize/values",
                                        "graph/opposite_signs",
                                        "graph/opposites",
                                        "graph/outer_distances",
                                        "label/labels",
                                        "simulate/pinned",
                                        "simulate/positions",
                                        "skin/bones",
                                        "skin/weights"};
    saved_file(2, PC_STAGE_COUNT);
    bytes whole = read_bytes(path);
    const hid_t file = H5Fopen(path, H5F_ACC_RDONLY, H5P_DEFAULT);
    pc_context *context = test_context(1);
    size_t refused = 0, count = sizeof(names) / sizeof(names[0]), rounds = 20 * count;
    for (size_t i = 0; i < rounds; ++i) {
        const hid_t dataset = H5Dopen2(file, names[i % count], H5P_DEFAULT);
        const size_t range = H5Dget_storage_size(dataset);
        const size_t at = H5Dget_offset(dataset) + (size_t)(pci_random(3, 1, i) * (double)range);
        assert_true(H5Dclose(dataset) >= 0 && at < whole.size - 16);
        const unsigned char flip = (unsigned char)(1 + pci_random_bits(3, 2, i) % 255);
        whole.data[at] ^= flip;
        seal_bytes(whole);
        refused += !load_damaged(context, whole.data, whole.size);
        whole.data[at] ^= flip;
    }
    assert_in_range(refused, rounds / 4, rounds - 1);
    H5Fclose(file);
    pc_context_destroy(context);
    free(whole.data);
}

// ---- contract of the calls ----------------------------------------------------------------------

static void saving_checks_its_input(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    assert_int_equal(pc_asset_save(context, NULL, path), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_asset_save(context, &asset, NULL), PC_ERROR_INVALID_ARGUMENT);
    assert_int_equal(pc_asset_save(NULL, &asset, path), PC_ERROR_INVALID_ARGUMENT);
    asset.proxy.triangles[0] = 1000;
    assert_int_equal(pc_asset_save(context, &asset, path), PC_ERROR_INVALID_ARGUMENT);
    assert_non_null(strstr(pc_context_error(context)->message, "/simplify/triangles"));
    asset.proxy.triangles[0] = 0;
    asset.reports.label.outcome = 9;
    assert_int_equal(pc_asset_save(context, &asset, path), PC_ERROR_INVALID_ARGUMENT);
    asset.reports.label.outcome = 0;
    asset.stage_count = PC_STAGE_COUNT + 1;
    assert_int_equal(pc_asset_save(context, &asset, path), PC_ERROR_INVALID_ARGUMENT);
    asset.stage_count = PC_STAGE_COUNT;
    assert_int_equal(pc_asset_load(context, path, &asset), PC_ERROR_INVALID_ARGUMENT);
    pc_asset_free(context, &asset);
    assert_int_equal(pc_asset_save(context, &asset, path), PC_ERROR_INVALID_ARGUMENT);
    pc_context_destroy(context);
}

static void unwritable_targets_are_reported(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    assert_int_equal(pc_asset_save(context, &asset, "/tmp/no/such/folder/x.h5"), PC_ERROR_IO);
    assert_non_null(strstr(pc_context_error(context)->message, "/tmp/no/such/folder/x.h5"));
    assert_non_null(strstr(pc_context_error(context)->message, "No such file"));
    assert_int_equal(pc_asset_save(context, &asset, folder), PC_ERROR_IO);
    assert_int_equal(pc_asset_save(context, &asset, "/dev/null"), PC_ERROR_IO);
    // A failed save leaves the old file as it was.
    write_bytes(path, "old", 3);
    asset.proxy.triangles[0] = 1000;
    assert_int_equal(pc_asset_save(context, &asset, path), PC_ERROR_INVALID_ARGUMENT);
    bytes old = read_bytes(path);
    assert_int_equal(old.size, 3);
    free(old.data);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

// A full disk: an error that says so, the old file, and no temporary file (see remove_folder).
static void full_disks_are_reported(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_asset asset;
    fixture_asset(context, 4, &asset);
    write_bytes(path, "old", 3);
    struct rlimit before, small;
    assert_int_equal(getrlimit(RLIMIT_FSIZE, &before), 0);
    small = before;
    small.rlim_cur = 1000;
    void (*handler)(int) = signal(SIGXFSZ, SIG_IGN);
    assert_int_equal(setrlimit(RLIMIT_FSIZE, &small), 0);
    const pc_status status = pc_asset_save(context, &asset, path);
    setrlimit(RLIMIT_FSIZE, &before);
    signal(SIGXFSZ, handler);
    assert_int_equal(status, PC_ERROR_IO);
    assert_non_null(strstr(pc_context_error(context)->message, "File too large"));
    bytes old = read_bytes(path);
    assert_string_equal((char *)old.data, "old");
    free(old.data);
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
}

typedef struct worker {
    pthread_t thread;
    char path[64];
    unsigned failures;
} worker;

static void *save_and_load(void *user) {
    worker *w = user;
    pc_context *context = test_context(1);
    pc_asset asset, back = {0};
    fixture_asset(context, 4, &asset);
    for (size_t i = 0; i < 10; ++i) {
        w->failures += pc_asset_save(context, &asset, w->path) != PC_OK;
        w->failures += pc_asset_load(context, w->path, &back) != PC_OK;
        pc_asset_free(context, &back);
    }
    pc_asset_free(context, &asset);
    pc_context_destroy(context);
    return NULL;
}

// Two contexts on two threads do not notice each other.
static void threads_save_side_by_side(void **state) {
    (void)state;
    hbool_t safe = 0;
    H5is_library_threadsafe(&safe);
    if (!safe) {
        skip();
    }
    worker workers[2] = {{.failures = 0}};
    memcpy(workers[0].path, path, sizeof(path));
    memcpy(workers[1].path, other_path, sizeof(path));
    for (size_t i = 0; i < 2; ++i) {
        assert_int_equal(pthread_create(&workers[i].thread, NULL, save_and_load, &workers[i]), 0);
    }
    for (size_t i = 0; i < 2; ++i) {
        pthread_join(workers[i].thread, NULL);
        assert_int_equal(workers[i].failures, 0);
    }
    assert_same_file(path, other_path);
}

static herr_t count_report(hid_t stack, void *user) {
    (void)stack;
    ++*(int *)user;
    return 0;
}

// The caller's own HDF5 error handler is silent during our calls and in place afterwards.
static void error_handler_is_restored(void **state) {
    (void)state;
    int reports = 0;
    H5E_auto2_t before;
    void *data;
    H5Eget_auto2(H5E_DEFAULT, &before, &data);
    H5Eset_auto2(H5E_DEFAULT, count_report, &reports);
    saved_file(2, PC_STAGE_COUNT);
    assert_int_equal(truncate(path, 3000), 0);
    assert_refused(path, PC_ERROR_FORMAT, "cut off");
    change_file(drop_stage);
    assert_refused(path, PC_ERROR_FORMAT, "carve is missing");
    assert_int_equal(reports, 0);
    H5Fclose(-1);
    assert_int_equal(reports, 1);
    H5Eset_auto2(H5E_DEFAULT, before, data);
}

// ---- memory -----------------------------------------------------------------------------------

// Every allocation of a load fails once: an error, an empty asset, no leak.
static void loading_survives_lack_of_memory(void **state) {
    (void)state;
    saved_file(4, PC_STAGE_COUNT);
    counting_allocator counter = {0};
    pc_context *context = counting_context(&counter);
    starvation s = {.counter = &counter};
    while (starves(&s)) {
        pc_asset asset = {0};
        s.status = pc_asset_load(context, path, &asset);
        if (s.status != PC_OK) {
            assert_empty(&asset);
        }
        pc_asset_free(context, &asset);
    }
    assert_true(s.failures > 24);
    pc_context_destroy(context);
}

static void saving_survives_lack_of_memory(void **state) {
    (void)state;
    check_writing_without_memory(pc_asset_save, path, 1);
}

static int make_folder(void **state) {
    (void)state;
    return test_make_folder(folder, path, "asset.h5", other_path, "other.h5");
}

static int remove_folder(void **state) {
    (void)state;
    return test_remove_folder(folder, path, other_path);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_field_survives),
        cmocka_unit_test(bytes_are_reproducible),
        cmocka_unit_test(optional_and_empty_arrays_survive),
        cmocka_unit_test(scenario_and_character_survive),
        cmocka_unit_test(large_arrays_survive),
        cmocka_unit_test(other_files_are_refused),
        cmocka_unit_test(changed_files_are_refused),
        cmocka_unit_test(missing_options_have_their_default),
        cmocka_unit_test(truncated_files_are_refused),
        cmocka_unit_test(flipped_bits_are_noticed),
        cmocka_unit_test(wild_values_are_harmless),
        cmocka_unit_test(saving_checks_its_input),
        cmocka_unit_test(unwritable_targets_are_reported),
        cmocka_unit_test(full_disks_are_reported),
        cmocka_unit_test(threads_save_side_by_side),
        cmocka_unit_test(error_handler_is_restored),
        cmocka_unit_test(loading_survives_lack_of_memory),
        cmocka_unit_test(saving_survives_lack_of_memory),
    };
    return cmocka_run_group_tests_name("asset_file", tests, make_folder, remove_folder);
}
