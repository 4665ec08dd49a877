// Importing scene files: transforms, skins, units, attributes; and the check of the child's buffer.
#define _POSIX_C_SOURCE 200809L
#include "../../cli/scene.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "support/files.h"
#include "support/test.h"

static const cli_command command = {.name = "test"};

static int import(const char *path, scene_data *scene) {
    cli_arguments arguments = {0};
    arguments.settings.import_memory = 4096;
    arguments.settings.import_seconds = 60;
    return scene_import(&command, &arguments, path, scene);
}

static scene_data fixture(const char *name) {
    char path[1024];
    scene_data scene;
    snprintf(path, sizeof(path), "%s/%s", CLI_FIXTURE_DIR, name);
    assert_int_equal(import(path, &scene), CLI_OK);
    return scene;
}

// Writes bytes to a file of the given extension and imports it.
static int import_bytes(const char *extension, const void *data, size_t size, scene_data *scene) {
    char path[256];
    snprintf(path, sizeof(path), "/tmp/proxycloth-test-%ld.%s", (long)getpid(), extension);
    write_bytes(path, data, size);
    const int code = import(path, scene);
    remove(path);
    return code;
}

static int import_text(const char *extension, const char *text, scene_data *scene) {
    return import_bytes(extension, text, strlen(text), scene);
}

static const double *corner(const scene_data *scene, size_t triangle, size_t k) {
    return &scene->positions[3 * scene->triangles[3 * triangle + k]];
}

static void assert_point(const double *point, double x, double y, double z) {
    assert_close(point[0], x, 1e-6);
    assert_close(point[1], y, 1e-6);
    assert_close(point[2], z, 1e-6);
}

// A fixture with one piece of its text replaced by another, then perhaps a second one.
static scene_data altered(const char *name, const char *const edits[4]) {
    char path[1024], text[8192] = "";
    snprintf(path, sizeof(path), "%s/%s", CLI_FIXTURE_DIR, name);
    bytes content = read_bytes(path);
    const char *from = (const char *)content.data;
    for (size_t i = 0; i < 4 && edits[i] != NULL; i += 2) {
        const char *at = strstr(from, edits[i]);
        assert_non_null(at);
        strncat(text, from, (size_t)(at - from));
        strcat(text, edits[i + 1]);
        from = at + strlen(edits[i]);
    }
    strcat(text, from);
    free(content.data);
    scene_data scene;
    assert_int_equal(import_text("gltf", text, &scene), CLI_OK);
    return scene;
}

static void instances_follow_their_nodes(void **state) {
    (void)state;
    scene_data scene = fixture("instances.gltf");
    assert_int_equal(scene.header.part_count, 2);
    assert_string_equal(scene.parts[0].node, "mirrored");
    assert_string_equal(scene.parts[1].node, "stretched");
    assert_string_equal(scene.parts[1].mesh, "cloth");
    // The mirrored triangle is turned, so that its front stays in front.
    assert_point(corner(&scene, 0, 0), 10, 0, 0);
    assert_point(corner(&scene, 0, 1), 10, 2, 0);
    assert_point(corner(&scene, 0, 2), 9, 0, 0);
    assert_point(corner(&scene, 1, 1), 1, 0, 0);
    assert_point(corner(&scene, 1, 2), 0, 8, 0);
    // Normals (0, 0.6, 0.8): kept by the mirror, (0, 0.15, 0.8) scaled to 1 by the stretch.
    const float *mirrored = scene.normals, *stretched = &scene.normals[9];
    assert_close((double)mirrored[0], 0.0, 1e-6);
    assert_close((double)mirrored[1], 0.6, 1e-6);
    assert_close((double)mirrored[2], 0.8, 1e-6);
    const double length = sqrt(0.15 * 0.15 + 0.8 * 0.8);
    assert_close((double)stretched[1], 0.15 / length, 1e-6);
    assert_close((double)stretched[2], 0.8 / length, 1e-6);
    // The origin of texture coordinates stays top left.
    const float texcoords[] = {0, 0, 1, 0, 0, 1};
    assert_memory_equal(&scene.texcoords[6], texcoords, sizeof(texcoords));
    const pc_material *material = &scene.materials[scene.parts[0].material];
    assert_string_equal(material->name, "red");
    assert_true(material->double_sided && material->base_color[0] == 1.0F &&
                material->base_color[1] == 0.0F && material->base_color[3] == 0.5F);
    assert_true(material->metallic == 0.25F && material->roughness == 0.5F);
    scene_free(&scene);
}

static void skins_take_the_rest_pose(void **state) {
    (void)state;
    scene_data scene = fixture("skin.gltf");
    assert_int_equal(scene.parts[0].bone_count, 2);
    // Half of 2 (3 v + (0, 1, 0)), half of 2 (v + (0, 0, 4)); the mesh's own node does not count.
    assert_point(corner(&scene, 0, 0), 0, 1, 4);
    assert_point(corner(&scene, 0, 1), 4, 1, 4);
    assert_point(corner(&scene, 0, 2), 0, 9, 4);
    scene_free(&scene);
}

// The triangle of skin.gltf, stretched `scale` times.
static void assert_skinned(const scene_data *scene, size_t triangle, double scale) {
    assert_point(corner(scene, triangle, 0), 0, 1, 4);
    assert_point(corner(scene, triangle, 1), scale, 1, 4);
    assert_point(corner(scene, triangle, 2), 0, 1 + 2 * scale, 4);
}

// Bind matrices that are missing are the identity; each node keeps its own skin of a shared mesh.
static void skins_of_a_shared_mesh_differ(void **state) {
    (void)state;
    static const char *const edits[] = {"\"children\": [", "\"children\": [4,", "],\n \"skins\": [",
                                        ",{\"mesh\":0,\"skin\":1}],\"skins\":[{\"joints\":[1,2]},"};
    scene_data scene = altered("skin.gltf", edits);
    assert_int_equal(scene.header.part_count, 2);
    const bool first = strcmp(scene.parts[0].node, "body") == 0;
    assert_skinned(&scene, 0, first ? 2 : 4);
    assert_skinned(&scene, 1, first ? 4 : 2);
    scene_free(&scene);
}

static void joints_need_no_names_of_their_own(void **state) {
    (void)state;
    static const char *const edits[][4] = {{NULL},
                                           {"\"name\": \"joint\",", "", "\"name\": \"joint\",", ""},
                                           {"\"name\": \"joint\",", "\"name\": \"body\","}};
    for (size_t i = 0; i < 3; ++i) {
        scene_data scene = altered("duplicate.gltf", edits[i]);
        assert_skinned(&scene, 0, 4);
        assert_int_equal(scene.header.joint_count, 2);
        assert_string_equal(scene.joints[0].name, i < 2 ? "joint_1" : "body_1");
        assert_string_equal(scene.joints[1].name, i < 2 ? "joint_2" : "joint");
        assert_string_equal(scene.parts[0].node, "body");
        scene_free(&scene);
    }
}

// A quarter of the first target, none of the second; colors without alpha are opaque.
static void morph_targets_shape_the_rest_pose(void **state) {
    (void)state;
    scene_data scene = fixture("morphed.gltf");
    assert_point(corner(&scene, 0, 0), 0, 0, 0);
    assert_point(corner(&scene, 0, 1), 1, 0, 1);
    assert_point(corner(&scene, 1, 1), 1, 1, 1);
    for (size_t v = 0; v < 4; ++v) {
        assert_close((double)scene.normals[3 * v], -sqrt(0.5), 1e-6);
        assert_close((double)scene.normals[3 * v + 2], sqrt(0.5), 1e-6);
        assert_true(scene.colors[4 * v + 2] == 0.5F && scene.colors[4 * v + 3] == 1.0F);
    }
    scene_free(&scene);
}

// Those at a node count more than those of its mesh, which the other node keeps.
static void nodes_have_weights_of_their_own(void **state) {
    (void)state;
    static const char *const edits[] = {
        "\"nodes\": [0]", "\"nodes\": [0, 1]", "{\"mesh\": 0, \"name\": \"n\"}",
        "{\"mesh\": 0, \"name\": \"n\"}, {\"mesh\": 0, \"weights\": [0.5, 0]}"};
    scene_data scene = altered("morphed.gltf", edits);
    assert_int_equal(scene.header.part_count, 2);
    assert_point(corner(&scene, 0, 1), 1, 0, 1);
    assert_point(corner(&scene, 2, 1), 1, 0, 2);
    scene_free(&scene);
}

// Integers that stand for themselves, side by side in one view; sparse ones with and without others
// below them.
static void quantized_and_sparse_numbers_are_read(void **state) {
    (void)state;
    scene_data scene = fixture("quantized.gltf");
    assert_int_equal(scene.header.part_count, 3);
    assert_int_equal(scene.header.vertex_count, 12);
    assert_point(&scene.positions[0], 0, 0, 0);
    assert_point(&scene.positions[3], 1, 0, 0.05);
    assert_point(&scene.positions[6], 1, 2, 0.1);
    assert_point(&scene.positions[9], 0, 2, 0);
    assert_close((double)scene.normals[2], 1.0, 1e-6);
    assert_close((double)scene.texcoords[4], 1.0, 1e-6);
    assert_close((double)scene.texcoords[5], 1.0, 1e-6);
    assert_point(&scene.positions[15], 100, 0, 5);
    assert_point(&scene.positions[18], 7, 8, 9);
    assert_point(&scene.positions[33], 0, 200, 1); // the last of a view ends before its stride
    scene_free(&scene);
    // Weights are normalised also where the file forgets to say so.
    static const char *const edits[][4] = {{NULL}, {"\"normalized\": true,", ""}};
    for (size_t i = 0; i < 2; ++i) {
        scene = altered("integer_weights.gltf", edits[i]);
        assert_point(corner(&scene, 0, 1), (6.0 * 128 + 2.0 * 127) / 255, 256.0 / 255,
                     8.0 * 127 / 255);
        assert_close((double)scene.vertex_weights[0] + (double)scene.vertex_weights[1], 1.0, 1e-6);
        scene_free(&scene);
    }
}

static void normalized_integers_are_numbers(void **state) {
    (void)state;
    scene_data scene = fixture("integers.glb");
    assert_int_equal(scene.header.vertex_count, 4);
    for (size_t v = 0; v < 4; ++v) {
        const double *at = &scene.positions[3 * v];
        assert_close((double)scene.texcoords[2 * v], at[0], 1e-5);
        assert_close((double)scene.texcoords[2 * v + 1], 0.2 * at[1], 1e-5);
        double upper = 0.0;
        for (size_t k = 4 * v; k < 4 * v + 4; ++k) {
            upper += scene.vertex_joints[k] == 1 ? (double)scene.vertex_weights[k] : 0.0;
        }
        assert_close(upper, at[1] < 0.5 ? 0.0 : at[0] < 0.5 ? 0.8 : 1.0, 1e-5);
    }
    scene_free(&scene);
}

static void units_and_axes_become_metres_and_y_up(void **state) {
    (void)state;
    // (1, 0, 0), (0, 2, 0), (0, 0, 3) moved by (10, 0, 0), with z up: (x, y, z) -> (x, z, -y).
    scene_data scene = fixture("z_up_metres.fbx");
    assert_point(corner(&scene, 0, 0), 11, 0, 0);
    assert_point(corner(&scene, 0, 1), 10, 0, -2);
    assert_point(corner(&scene, 0, 2), 10, 3, 0);
    scene_free(&scene);
    scene = fixture("z_up_centimetres.dae");
    assert_point(corner(&scene, 0, 0), 0.11, 0, 0);
    assert_point(corner(&scene, 0, 1), 0.10, 0, -0.02);
    assert_point(corner(&scene, 0, 2), 0.10, 0.03, 0);
    scene_free(&scene);
}

// ---- a cube of one metre in every format -------------------------------------------------------

static const uint16_t cube_triangles[36] = {0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4,
                                            2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7, 5};

static double cube_coordinate(size_t vertex, size_t k) { return vertex >> k & 1 ? 1.0 : 0.0; }

typedef struct cube_text {
    char bytes[8192];
    size_t size;
} cube_text;

__attribute__((format(printf, 2, 3))) static void put(cube_text *t, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    const int length = vsnprintf(t->bytes + t->size, sizeof(t->bytes) - t->size, format, arguments);
    va_end(arguments);
    assert_true(length >= 0 && (size_t)length < sizeof(t->bytes) - t->size);
    t->size += (size_t)length;
}

static void put_corners(cube_text *t, double side, const char *before, const char *between,
                        const char *after) {
    for (size_t v = 0; v < 8; ++v) {
        put(t, "%s%g%s%g%s%g%s", before, side * cube_coordinate(v, 0), between,
            side * cube_coordinate(v, 1), between, side * cube_coordinate(v, 2),
            v < 7 || before[0] != '\0' ? after : "");
    }
}

static void put_triangles(cube_text *t, const char *before, int base, const char *between,
                          const char *after) {
    for (size_t i = 0; i < 36; i += 3) {
        put(t, "%s%d%s%d%s%d%s", before, cube_triangles[i] + base, between,
            cube_triangles[i + 1] + base, between, cube_triangles[i + 2] + base, after);
    }
}

// One metre along each axis, wherever it stands, with its front outside.
static void assert_metre_cube(const char *what, int code, scene_data *scene) {
    if (code != CLI_OK) {
        fail_msg("%s cannot be read", what);
    }
    assert_int_equal(scene->header.triangle_count, 12);
    double least[3] = {1e9, 1e9, 1e9}, most[3] = {-1e9, -1e9, -1e9}, volume = 0.0;
    for (size_t i = 0; i < 36; ++i) {
        const double *p = corner(scene, i / 3, i % 3);
        for (size_t k = 0; k < 3; ++k) {
            least[k] = fmin(least[k], p[k]);
            most[k] = fmax(most[k], p[k]);
        }
    }
    for (size_t t = 0; t < 12; ++t) {
        double normal[3];
        pci_cross(corner(scene, t, 1), corner(scene, t, 2), normal);
        volume += pci_dot(corner(scene, t, 0), normal) / 6.0;
    }
    for (size_t k = 0; k < 3; ++k) {
        if (!(fabs(most[k] - least[k] - 1.0) < 1e-6)) {
            fail_msg("%s: %g along axis %zu", what, most[k] - least[k], k);
        }
    }
    assert_close(volume, 1.0, 1e-5);
    scene_free(scene);
}

static void put_fbx(cube_text *t, double side, double factor, double node_scale) {
    put(t,
        "; FBX 7.3.0 project file\nFBXHeaderExtension: {\nFBXHeaderVersion: 1003\n"
        "FBXVersion: 7300\n}\nGlobalSettings: {\nVersion: 1000\nProperties70: {\n"
        "P: \"UpAxis\", \"int\", \"Integer\", \"\",1\nP: \"UpAxisSign\", \"int\", \"Integer\", "
        "\"\",1\nP: \"FrontAxis\", \"int\", \"Integer\", \"\",2\nP: \"FrontAxisSign\", \"int\", "
        "\"Integer\", \"\",1\nP: \"CoordAxis\", \"int\", \"Integer\", \"\",0\nP: "
        "\"CoordAxisSign\", \"int\", \"Integer\", \"\",1\nP: \"UnitScaleFactor\", \"double\", "
        "\"Number\", \"\",%g\n}\n}\nDefinitions: {\nVersion: 100\nCount: 2\n}\nObjects: {\n"
        "Geometry: 1000, \"Geometry::cube\", \"Mesh\" {\nVertices: *24 {\na: ",
        factor);
    put_corners(t, side, "", ",", ",");
    put(t, "\n}\nPolygonVertexIndex: *36 {\na: ");
    for (size_t i = 0; i < 36; ++i) { // the last corner of a polygon is stored as its complement
        put(t, "%s%d", i > 0 ? "," : "",
            i % 3 == 2 ? -cube_triangles[i] - 1 : (int)cube_triangles[i]);
    }
    put(t,
        "\n}\nGeometryVersion: 124\n}\nModel: 2000, \"Model::node\", \"Mesh\" {\nVersion: 232\n"
        "Properties70: {\nP: \"Lcl Scaling\", \"Lcl Scaling\", \"\", \"A\",%g,%g,%g\n}\n}\n}\n"
        "Connections: {\nC: \"OO\",2000,0\nC: \"OO\",1000,2000\n}\n",
        node_scale, node_scale, node_scale);
}

static void put_dae(cube_text *t, double side, double metres) {
    put(t,
        "<?xml version=\"1.0\"?><COLLADA xmlns=\"http://www.collada.org/2005/11/COLLADASchema\" "
        "version=\"1.4.1\"><asset><unit meter=\"%g\"/><up_axis>Y_UP</up_axis></asset>"
        "<library_geometries><geometry id=\"g\"><mesh><source id=\"p\"><float_array id=\"a\" "
        "count=\"24\">",
        metres);
    put_corners(t, side, "", " ", " ");
    put(t, "</float_array><technique_common><accessor source=\"#a\" count=\"8\" stride=\"3\">"
           "<param name=\"X\" type=\"float\"/><param name=\"Y\" type=\"float\"/><param name=\"Z\" "
           "type=\"float\"/></accessor></technique_common></source><vertices id=\"v\"><input "
           "semantic=\"POSITION\" source=\"#p\"/></vertices><triangles count=\"12\"><input "
           "semantic=\"VERTEX\" source=\"#v\" offset=\"0\"/><p>");
    put_triangles(t, "", 0, " ", " ");
    put(t,
        "</p></triangles></mesh></geometry></library_geometries><library_visual_scenes>"
        "<visual_scene id=\"s\"><node id=\"n\"><instance_geometry url=\"#g\"/></node>"
        "</visual_scene></library_visual_scenes><scene><instance_visual_scene url=\"#s\"/></scene>"
        "</COLLADA>");
}

// The JSON of a glTF file whose buffer has 8 positions, then 36 indices.
static void put_gltf(cube_text *t, const char *uri) {
    put(t,
        "{\"asset\":{\"version\":\"2.0\"},\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{"
        "\"mesh\":0}],\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":1"
        "}]}],\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":8,\"type\":"
        "\"VEC3\",\"min\":[0,0,0],\"max\":[1,1,1]},{\"bufferView\":1,\"componentType\":5123,"
        "\"count\":36,\"type\":\"SCALAR\"}],\"bufferViews\":[{\"buffer\":0,\"byteLength\":96},{"
        "\"buffer\":0,\"byteOffset\":96,\"byteLength\":72}],\"buffers\":[{%s\"byteLength\":168}]}",
        uri);
}

static void cube_buffer(unsigned char buffer[168]) {
    float positions[24];
    for (size_t i = 0; i < 24; ++i) {
        positions[i] = (float)cube_coordinate(i / 3, i % 3);
    }
    memcpy(buffer, positions, sizeof(positions));
    memcpy(buffer + sizeof(positions), cube_triangles, sizeof(cube_triangles));
}

static void a_metre_is_a_metre_in_text_formats(void **state) {
    (void)state;
    scene_data scene;
    cube_text t = {.size = 0};
    put_corners(&t, 1.0, "v ", " ", "\n");
    put_triangles(&t, "f ", 1, " ", "\n");
    assert_metre_cube("OBJ", import_text("obj", t.bytes, &scene), &scene);
    t.size = 0;
    put(&t, "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\n"
            "property float z\nelement face 12\nproperty list uchar int vertex_indices\n"
            "end_header\n");
    put_corners(&t, 1.0, "", " ", "\n");
    put(&t, "\n");
    put_triangles(&t, "3 ", 0, " ", "\n");
    assert_metre_cube("PLY", import_text("ply", t.bytes, &scene), &scene);
    t.size = 0;
    put(&t, "solid cube\n");
    for (size_t i = 0; i < 36; ++i) {
        const size_t v = cube_triangles[i];
        put(&t, "%svertex %g %g %g\n%s", i % 3 == 0 ? "facet normal 0 0 0\nouter loop\n" : "",
            cube_coordinate(v, 0), cube_coordinate(v, 1), cube_coordinate(v, 2),
            i % 3 == 2 ? "endloop\nendfacet\n" : "");
    }
    put(&t, "endsolid cube\n");
    assert_metre_cube("STL", import_text("stl", t.bytes, &scene), &scene);
    static const struct {
        double side, metres;
    } collada[] = {{1.0, 1.0}, {100.0, 0.01}, {1.0 / 0.0254, 0.0254}};
    for (size_t i = 0; i < 3; ++i) {
        t.size = 0;
        put_dae(&t, collada[i].side, collada[i].metres);
        assert_metre_cube("DAE", import_text("dae", t.bytes, &scene), &scene);
    }
    // As Maya writes it, as Blender does, and in metres.
    static const struct {
        double side, factor, node_scale;
    } fbx[] = {{100.0, 1.0, 1.0}, {1.0, 1.0, 100.0}, {1.0, 100.0, 1.0}};
    for (size_t i = 0; i < 3; ++i) {
        t.size = 0;
        put_fbx(&t, fbx[i].side, fbx[i].factor, fbx[i].node_scale);
        assert_metre_cube("FBX", import_text("fbx", t.bytes, &scene), &scene);
    }
}

static void a_metre_is_a_metre_in_binary_formats(void **state) {
    (void)state;
    scene_data scene;
    unsigned char stl[84 + 12 * 50] = {0}, buffer[168];
    stl[80] = 12;
    for (size_t i = 0; i < 36; ++i) {
        for (size_t k = 0; k < 3; ++k) {
            const float x = (float)cube_coordinate(cube_triangles[i], k);
            memcpy(stl + 84 + i / 3 * 50 + 12 + i % 3 * 12 + 4 * k, &x, sizeof(x));
        }
    }
    assert_metre_cube("binary STL", import_bytes("stl", stl, sizeof(stl), &scene), &scene);
    stl[80] = 11; // the last triangle is now something that follows
    assert_int_equal(import_bytes("stl", stl, sizeof(stl), &scene), CLI_OK);
    assert_int_equal(scene.header.triangle_count, 11);
    scene_free(&scene);

    // A glTF file finds its buffer beside it, also from inside the isolated child, and under a name
    // whose characters are escaped.
    char path[256], uri[300];
    cube_buffer(buffer);
    cube_text t = {.size = 0};
    for (size_t i = 0; i < 2; ++i) {
        snprintf(path, sizeof(path),
                 i == 0 ? "/tmp/proxycloth-test-%ld.bin" : "/tmp/proxycloth test %ld%%.bin",
                 (long)getpid());
        snprintf(uri, sizeof(uri),
                 i == 0 ? "\"uri\":\"proxycloth-test-%ld.bin\","
                        : "\"uri\":\"proxycloth%%20test%%20%ld%%25.bin\",",
                 (long)getpid());
        write_bytes(path, buffer, sizeof(buffer));
        t.size = 0;
        put_gltf(&t, uri);
        const int code = import_text("gltf", t.bytes, &scene);
        remove(path);
        assert_metre_cube("glTF", code, &scene);
    }

    t.size = 0;
    put_gltf(&t, "");
    while (t.size % 4 != 0) {
        put(&t, " ");
    }
    unsigned char glb[9000];
    const uint32_t json_size = (uint32_t)t.size, total = 12 + 8 + json_size + 8 + 168;
    const uint32_t head[5] = {0x46546c67, 2, total, json_size, 0x4e4f534a};
    const uint32_t chunk[2] = {168, 0x004e4942};
    memcpy(glb, head, sizeof(head));
    memcpy(glb + 20, t.bytes, t.size);
    memcpy(glb + 20 + t.size, chunk, sizeof(chunk));
    memcpy(glb + 28 + t.size, buffer, sizeof(buffer));
    assert_metre_cube("GLB", import_bytes("glb", glb, total, &scene), &scene);
}

static void refuses_what_would_be_garbage(void **state) {
    (void)state;
    scene_data scene;
    assert_int_equal(import(CLI_FIXTURE_DIR "/extension.gltf", &scene), CLI_INPUT);
    assert_null(scene.buffer);
}

// The unit square, in spellings that OBJ files may use.
static void reads_obj_however_it_is_spelled(void **state) {
    (void)state;
    static const char *const spellings[] = {
        "v .0 .0 -.0\nv 1 .0 .0\nv 1. +1. 0\nv .0 1e0 .0e-3\nf 1 2 3 4\n",
        "\xef\xbb\xbfv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf -4 -3 -2 -1\n",
        "v 0 0 0\rv 1 0 0\rv 1 1 0\rv 0 1 0\rf 1 2 3\rf 1 3 4\r",
        "\tv 0 0 0 \r\n  v\t1 0 0\r\n v 1 1 0\t\r\nv 0 1 0\r\nf 1 2 \\\r\n 3 4",
        "v 0 0 0 # 7\nv 1 0 0# a b c\nv 1 1 0 #\nv 0 1 0\nf 1 2 3 4 # 5 6\n#v 9\n",
        "f 01 +2 003 4\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nend\nparm u 0 1\n",
        "v 0 0 0 2\nv 2 0 0 2\nv .25 .25 0 .25\nv 0 1 0 1\no\ng\ns off\nf 1 2 3 4\n",
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt .5 .5 # 2\nvt 1\nf 1/1/7 2/1 3/2/ 4/1\n",
        "v 0,0 0 0\nv 1,0 0 0\nv 1 1 0\nv 0 1 0\nvn .6 0 .8\nf 1//1 2/3/1 3//1 4/3/1\n",
        "v 0 0 0 .5 1 1\nv 1 0 0\nv 1 1 0 1 .5 0 .25\nv 0 1 0\nf 1 2 3 4\n"};
    for (size_t i = 0; i < sizeof(spellings) / sizeof(spellings[0]); ++i) {
        scene_data scene;
        if (import_text("obj", spellings[i], &scene) != CLI_OK) {
            fail_msg("spelling %zu is refused", i);
        }
        double area = 0.0;
        for (size_t t = 0; t < scene.header.triangle_count; ++t) {
            const double *a = corner(&scene, t, 0), *b = corner(&scene, t, 1),
                         *c = corner(&scene, t, 2);
            area += 0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]));
        }
        if (scene.header.vertex_count != 4 || scene.header.triangle_count != 2 ||
            !(fabs(area - 1.0) < 1e-6)) {
            fail_msg("spelling %zu: %zu vertices, %zu triangles, area %g", i,
                     (size_t)scene.header.vertex_count, (size_t)scene.header.triangle_count, area);
        }
        if (i == 9) { // the corners' order is that of the face
            const float colors[] = {.5F, 1, 1, 1, 1, 1, 1, 1, 1, .5F, 0, 1, 1, 1, 1, 1};
            assert_memory_equal(scene.colors, colors, sizeof(colors));
        }
        scene_free(&scene);
    }
}

// Materials are found beside the file, under the name of the file where theirs is not there.
static void obj_materials_lie_beside_the_file(void **state) {
    (void)state;
    static const char *const libraries[] = {"test file.mtl", "C:\\models\\lost.mtl"};
    char folder[] = "/tmp/proxycloth test-XXXXXX", obj[64], mtl[64], text[256];
    assert_non_null(mkdtemp(folder));
    snprintf(obj, sizeof(obj), "%s/test file.obj", folder);
    snprintf(mtl, sizeof(mtl), "%s/test file.mtl", folder);
    write_bytes(mtl, "newmtl red\nKd .5 .25 0\n", 24);
    for (size_t i = 0; i < 2; ++i) {
        scene_data scene;
        snprintf(text, sizeof(text), "mtllib %s \nv 0 0 0\nv 1 0 0\nv 1 1 0\nusemtl red\nf 1 2 3\n",
                 libraries[i]);
        write_bytes(obj, text, strlen(text));
        assert_int_equal(import(obj, &scene), CLI_OK);
        const pc_material *material = &scene.materials[scene.parts[0].material];
        assert_string_equal(material->name, "red");
        assert_close((double)material->base_color[1], 0.25, 1e-6);
        scene_free(&scene);
    }
    remove(obj);
    remove(mtl);
    assert_int_equal(rmdir(folder), 0);
}

static void polygons_become_triangles_and_lines_vanish(void **state) {
    (void)state;
    scene_data scene;
    assert_int_equal(import_text("obj",
                                 "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 5 5 5\nvt 0 0.25\n"
                                 "f 1/1 2/1 3/1 4/1\nl 1 5\np 5\n",
                                 &scene),
                     CLI_OK);
    assert_int_equal(scene.header.triangle_count, 2);
    assert_close((double)scene.texcoords[1], 0.75, 1e-6);
    double area = 0.0;
    for (size_t t = 0; t < 2; ++t) {
        const double *a = corner(&scene, t, 0), *b = corner(&scene, t, 1),
                     *c = corner(&scene, t, 2);
        area += 0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]));
    }
    assert_close(area, 1.0, 1e-6);
    scene_free(&scene);
}

// A vertex that faces share is one corner again, a vertex with two texture coordinates is two.
static void joins_equal_corners_only(void **state) {
    (void)state;
    scene_data scene;
    const char *shared = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 1\n"
                         "f 1/1 2/1 3/1\nf 1/1 3/1 4/1\n";
    const char *split = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 1\n"
                        "f 1/1 2/1 3/1\nf 1/2 3/1 4/1\n";
    assert_int_equal(import_text("obj", shared, &scene), CLI_OK);
    assert_int_equal(scene.header.vertex_count, 4);
    scene_free(&scene);
    assert_int_equal(import_text("obj", split, &scene), CLI_OK);
    assert_int_equal(scene.header.vertex_count, 5);
    scene_free(&scene);
}

static void reads_ply_colors_and_stl(void **state) {
    (void)state;
    scene_data scene;
    const char *ply =
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nproperty uchar red\nproperty uchar green\n"
        "property uchar blue\nelement face 1\nproperty list uchar int "
        "vertex_indices\nend_header\n0 0 0 255 0 0\n1 0 0 255 0 0\n0 1 0 0 0 255\n"
        "3 0 1 2\n";
    assert_int_equal(import_text("ply", ply, &scene), CLI_OK);
    assert_int_equal(scene.header.triangle_count, 1);
    assert_true(scene.parts[0].has_colors == 1 && scene.colors[0] == 1.0F &&
                scene.colors[1] == 0.0F && scene.colors[10] == 1.0F);
    scene_free(&scene);
    const char *stl = "solid s\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\n"
                      "vertex 0 1 0\nendloop\nendfacet\nendsolid s\n";
    assert_int_equal(import_text("stl", stl, &scene), CLI_OK);
    assert_int_equal(scene.header.triangle_count, 1);
    assert_string_equal(scene.header.format, "STL");
    scene_free(&scene);
}

static void values_out_of_range_arrive(void **state) {
    (void)state;
    scene_data scene;
    assert_int_equal(import_text("obj", "v 0 0 nan\nv 1 0 0\nv 0 inf 0\nf 1 2 3\n", &scene),
                     CLI_OK);
    assert_true(isnan(scene.positions[2]));
    assert_true(isinf(scene.positions[7]));
    scene_free(&scene);
}

static void chooses_parts_by_name(void **state) {
    (void)state;
    scene_data scene = fixture("instances.gltf");
    uint8_t chosen[2];
    const char *patterns[] = {"mir*", "nothing"};
    assert_int_equal(scene_select(&scene, patterns, 0, chosen), 2);
    assert_int_equal(scene_select(&scene, patterns, 2, chosen), 1);
    assert_int_equal(chosen[0], 1);
    assert_int_equal(scene_select(&scene, patterns + 1, 1, chosen), 0);
    patterns[0] = "cl?th";
    assert_int_equal(scene_select(&scene, patterns, 1, chosen), 2);
    patterns[0] = "red";
    assert_int_equal(scene_select(&scene, patterns, 1, chosen), 2);
    char names[64];
    scene_names(&scene, names, sizeof(names));
    assert_string_equal(names, "mirrored, cloth, stretched, red");

    pc_context *context = test_context(1);
    pc_visual visual = {0};
    const uint8_t second[2] = {0, 1};
    assert_ok(context, scene_visual(&scene, second, context, &visual, NULL));
    assert_int_equal(visual.surface.triangle_count, 1);
    assert_int_equal(visual.material_count, 1);
    assert_string_equal(visual.materials[0].name, "red");
    assert_close(visual.surface.positions[7], 8.0, 1e-6);
    pc_visual_free(context, &visual);
    pc_context_destroy(context);
    scene_free(&scene);
}

// Damaged buffers are refused or hold indices in range; sanitizers watch over the rest.
static void trusts_no_buffer(void **state) {
    (void)state;
    scene_data good = fixture("instances.gltf");
    const size_t size = good.header.size;
    size_t refused = 0;
    enum { rounds = 20000 };
    for (uint64_t round = 0; round < rounds; ++round) {
        unsigned char *copy = malloc(size);
        assert_non_null(copy);
        memcpy(copy, good.buffer, size);
        for (uint64_t k = 0; k < 1 + round % 4; ++k) {
            // Mostly the header and the parts, where the counts are.
            const double span =
                round % 3 != 0 ? sizeof(scene_header) + sizeof(scene_part) * 2.0 : (double)size;
            const size_t at = (size_t)(pci_random(round, 2 * k, 0) * span);
            copy[at] = (unsigned char)pci_random_bits(round, 2 * k + 1, 0);
        }
        const size_t length =
            round % 7 == 0 ? (size_t)(pci_random(round, 9, 0) * (double)size) : size;
        scene_data scene;
        if (scene_open(copy, length, &scene) != NULL) {
            ++refused;
        } else {
            for (size_t i = 0; i < 3 * scene.header.triangle_count; ++i) {
                assert_true(scene.triangles[i] < scene.header.vertex_count);
            }
            for (size_t i = 0; i < scene.header.part_count; ++i) {
                assert_true(scene.parts[i].material < scene.header.material_count);
            }
        }
        scene_free(&scene);
    }
    assert_true(refused > rounds / 10 && refused < rounds);
    scene_free(&good);
}

// What a taken-over importer would try. Each returns whether the system let it.
static const char *own_path;
static int own_pipe[2];
static bool opens_socket(void) { return socket(AF_INET, SOCK_STREAM, 0) >= 0; }
static bool opens_local_socket(void) { return socket(AF_UNIX, SOCK_DGRAM, 0) >= 0; }
static bool creates_file(void) { return open(own_path, O_WRONLY | O_CREAT, 0600) >= 0; }
static bool appends(void) { return open(own_path, O_RDWR | O_APPEND) >= 0; }
static bool removes_file(void) { return unlink(own_path) == 0; }
static bool makes_folder(void) { return mkdir("/tmp/proxycloth-isolated", 0700) == 0; }
static bool changes_mode(void) { return chmod(own_path, 0777) == 0; }
static bool starts_process(void) { return fork() >= 0; }
static bool runs_program(void) {
    execl("/bin/true", "true", (char *)NULL);
    return errno != EPERM;
}
static bool ends_parent(void) { return kill(getppid(), SIGTERM) == 0; }
static bool writes_elsewhere(void) { return write(own_pipe[0], "x", 1) == 1 || errno != EPERM; }

static bool reads_file(void) {
    char byte;
    const int file = open(own_path, O_RDONLY);
    return file >= 0 && read(file, &byte, 1) == 1;
}
static bool answers(void) { return write(own_pipe[1], "x", 1) == 1; }
static bool takes_memory(void) { return malloc((size_t)64 << 20) != NULL; }

// 1: allowed, 0: refused, -1: this system cannot isolate.
static int try_isolated(bool (*act)(void)) {
    const pid_t child = fork();
    assert_true(child >= 0);
    if (child == 0) {
        _exit(!scene_isolate(own_pipe[1]) ? 2 : act() ? 1 : 0);
    }
    int status = 0;
    assert_int_equal(waitpid(child, &status, 0), child);
    assert_true(WIFEXITED(status));
    return WEXITSTATUS(status) == 2 ? -1 : WEXITSTATUS(status);
}

static void the_child_can_only_read_and_answer(void **state) {
    (void)state;
    static bool (*const refused[])(void) = {
        opens_socket, opens_local_socket, creates_file, appends,     removes_file,    makes_folder,
        changes_mode, starts_process,     runs_program, ends_parent, writes_elsewhere};
    static bool (*const allowed[])(void) = {reads_file, answers, takes_memory};
    char path[] = "/tmp/proxycloth-test-XXXXXX";
    const int file = mkstemp(path);
    assert_true(file >= 0 && write(file, "text", 4) == 4 && pipe(own_pipe) == 0);
    own_path = path;
    if (try_isolated(reads_file) < 0) {
        unlink(path);
        print_message("no system call filter here\n");
        skip();
    }
    for (size_t i = 0; i < sizeof(refused) / sizeof(refused[0]); ++i) {
        if (try_isolated(refused[i]) != 0) {
            fail_msg("number %zu of what must be refused is not", i);
        }
    }
    for (size_t i = 0; i < sizeof(allowed) / sizeof(allowed[0]); ++i) {
        if (try_isolated(allowed[i]) != 1) {
            fail_msg("number %zu of what must be allowed is not", i);
        }
    }
    close(file);
    close(own_pipe[0]);
    close(own_pipe[1]);
    assert_int_equal(unlink(path), 0);
}

static void cleans_text(void **state) {
    (void)state;
    char text[16];
    cli_clean_text(text, sizeof(text), "a\n\033b\xc3\xa9\xff\xc0\x80");
    assert_string_equal(text, "a??b\xc3\xa9???");
    cli_clean_text(text, 4, "ab\xe2\x82\xac");
    assert_string_equal(text, "ab");
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(instances_follow_their_nodes),
        cmocka_unit_test(skins_take_the_rest_pose),
        cmocka_unit_test(skins_of_a_shared_mesh_differ),
        cmocka_unit_test(joints_need_no_names_of_their_own),
        cmocka_unit_test(morph_targets_shape_the_rest_pose),
        cmocka_unit_test(nodes_have_weights_of_their_own),
        cmocka_unit_test(quantized_and_sparse_numbers_are_read),
        cmocka_unit_test(normalized_integers_are_numbers),
        cmocka_unit_test(units_and_axes_become_metres_and_y_up),
        cmocka_unit_test(a_metre_is_a_metre_in_text_formats),
        cmocka_unit_test(a_metre_is_a_metre_in_binary_formats),
        cmocka_unit_test(refuses_what_would_be_garbage),
        cmocka_unit_test(reads_obj_however_it_is_spelled),
        cmocka_unit_test(obj_materials_lie_beside_the_file),
        cmocka_unit_test(polygons_become_triangles_and_lines_vanish),
        cmocka_unit_test(joins_equal_corners_only),
        cmocka_unit_test(reads_ply_colors_and_stl),
        cmocka_unit_test(values_out_of_range_arrive),
        cmocka_unit_test(chooses_parts_by_name),
        cmocka_unit_test(trusts_no_buffer),
        cmocka_unit_test(the_child_can_only_read_and_answer),
        cmocka_unit_test(cleans_text),
    };
    return cmocka_run_group_tests_name("import", tests, NULL, NULL);
}
