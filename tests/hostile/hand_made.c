// Worst cases by hand: what no damage to a good file leads to.
#include "hostile.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/core.h"

void text_append(text *t, const void *bytes, size_t size) {
    if (t->size + size > t->capacity) {
        t->capacity = 2 * (t->size + size);
        t->bytes = realloc(t->bytes, t->capacity);
        if (t->bytes == NULL) {
            abort();
        }
    }
    memcpy(t->bytes + t->size, bytes, size);
    t->size += size;
}

void text_print(text *t, const char *format, ...) {
    char line[4096];
    va_list arguments;
    va_start(arguments, format);
    const int length = vsnprintf(line, sizeof(line), format, arguments);
    va_end(arguments);
    if (length < 0 || (size_t)length >= sizeof(line)) {
        abort();
    }
    text_append(t, line, (size_t)length);
}

// ---- numbers -----------------------------------------------------------------------------------

static const char square[] = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";

static void obj_index_overflow(text *t, size_t many) {
    (void)many;
    text_print(t, "%sf 1 2 3\nf 1 2 4294967297\nf 1 2 18446744073709551617\nf 2147483648 2 3\n",
               square);
}
static void obj_negative_index(text *t, size_t many) {
    (void)many;
    text_print(t, "%sf -1 -2 -3\nf -1 -2 -99999999\nf 0 0 0\nf 1 2 -9223372036854775808\n", square);
}
static void obj_large_polygon(text *t, size_t many) {
    for (size_t i = 0; i < many / 10; ++i) {
        text_print(t, "v %zu %zu 0\n", i % 317, i / 317);
    }
    text_print(t, "f");
    for (size_t i = 0; i < many / 10; ++i) {
        text_print(t, " %zu", i + 1);
    }
    text_print(t, "\n");
}
static void obj_coordinates(text *t, const char *x, const char *y, const char *z) {
    text_print(t, "v 0 0 0\nv %s 0 0\nv 0 %s 0\nv 0 0 %s\nf 1 2 3\nf 1 3 4\nf 1 2 4\nf 2 3 4\n", x,
               y, z);
}
static void obj_1e30(text *t, size_t many) {
    (void)many;
    obj_coordinates(t, "1e30", "1e30", "1e30");
}
static void obj_1e_30(text *t, size_t many) {
    (void)many;
    obj_coordinates(t, "1e-30", "1e-30", "1e-30");
}
static void obj_denormals(text *t, size_t many) {
    (void)many;
    obj_coordinates(t, "1e-40", "3e-42", "1e-44");
}
static void obj_mixed_scales(text *t, size_t many) {
    (void)many;
    obj_coordinates(t, "1e30", "1e-30", "1");
}
static void obj_far_away(text *t, size_t many) {
    (void)many;
    text_print(t, "v 1e29 1e29 1e29\nv 1.000001e29 1e29 1e29\nv 1e29 1.000001e29 1e29\n"
                  "v 1.000001e29 1.000001e29 1e29\nf 1 2 3\nf 2 4 3\n");
}
static void obj_one_far_vertex(text *t, size_t many) {
    (void)many;
    text_print(t, "%sv 1e30 -1e30 1e30\nf 1 2 3\nf 1 3 4\nf 1 2 5\n", square);
}
static void obj_nan(text *t, size_t many) {
    (void)many;
    obj_coordinates(t, "nan", "-nan", "inf");
}
static void obj_long_line(text *t, size_t many) {
    text_print(t, "%sf 1 2 3\ng ", square);
    for (size_t i = 0; i < 10 * many; ++i) {
        text_append(t, "x", 1);
    }
    text_print(t, "\nf 1 3 4\n");
}
static void obj_many_groups(text *t, size_t many) {
    text_print(t, "%s", square);
    for (size_t i = 0; i < many / 10; ++i) {
        text_print(t, "g part%zu\nf 1 2 3\n", i);
    }
}

// ---- soups -------------------------------------------------------------------------------------

// Triangles as binary STL: the smallest file that holds them.
static void stl_begin(text *t, size_t count) {
    const char zeros[80] = {0};
    const uint32_t number = (uint32_t)count;
    text_append(t, zeros, sizeof(zeros));
    text_append(t, &number, sizeof(number));
}
static void stl_triangle(text *t, const float corners[9]) {
    const float normal[3] = {0};
    const uint16_t zero = 0;
    text_append(t, normal, sizeof(normal));
    text_append(t, corners, 9 * sizeof(*corners));
    text_append(t, &zero, sizeof(zero));
}
static float number(size_t counter) { return (float)pci_random(7, 0, counter); }

static void loose_triangles(text *t, size_t many) {
    stl_begin(t, many);
    for (size_t i = 0; i < many; ++i) {
        float corners[9];
        for (size_t k = 0; k < 9; ++k) {
            corners[k] = number(12 * i + k % 3) + 0.01F * number(12 * i + 3 + k);
        }
        stl_triangle(t, corners);
    }
}
static void large_loose_triangles(text *t, size_t many) {
    stl_begin(t, many / 100);
    for (size_t i = 0; i < many / 100; ++i) {
        float corners[9];
        for (size_t k = 0; k < 9; ++k) {
            corners[k] = number(9 * i + k);
        }
        stl_triangle(t, corners);
    }
}
static void one_triangle_many_times(text *t, size_t many) {
    static const float corners[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
    stl_begin(t, many);
    for (size_t i = 0; i < many; ++i) {
        stl_triangle(t, corners);
    }
}
static void coplanar_soup(text *t, size_t many) {
    stl_begin(t, many / 100);
    for (size_t i = 0; i < many / 100; ++i) {
        float corners[9] = {0};
        for (size_t k = 0; k < 3; ++k) {
            corners[3 * k] = number(6 * i + 2 * k);
            corners[3 * k + 2] = number(6 * i + 2 * k + 1);
        }
        stl_triangle(t, corners);
    }
}
static void zero_area_fan(text *t, size_t many) {
    stl_begin(t, many / 10 + 1);
    static const float good[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
    stl_triangle(t, good);
    for (size_t i = 0; i < many / 10; ++i) {
        const float s = (float)i / (float)many;
        const float corners[9] = {0, 0, 0, s, s, s, 2 * s, 2 * s, 2 * s};
        stl_triangle(t, corners);
    }
}
static void edge_of_many_triangles(text *t, size_t many) {
    stl_begin(t, many / 10);
    for (size_t i = 0; i < many / 10; ++i) {
        const float corners[9] = {0, 0, 0, 0, 1, 0, number(2 * i), 0.5F, number(2 * i + 1)};
        stl_triangle(t, corners);
    }
}
static void vertex_of_many_triangles(text *t, size_t many) {
    stl_begin(t, many / 10);
    for (size_t i = 0; i < many / 10; ++i) {
        float corners[9] = {0};
        for (size_t k = 3; k < 9; ++k) {
            corners[k] = number(6 * i + k) - 0.5F;
        }
        stl_triangle(t, corners);
    }
}
static void needles(text *t, size_t many) {
    stl_begin(t, many / 100);
    for (size_t i = 0; i < many / 100; ++i) {
        const float y = number(i), z = number(i + many);
        const float corners[9] = {0, y, z, 1, y, z, 1, y + 1e-6F, z};
        stl_triangle(t, corners);
    }
}

// ---- counts ------------------------------------------------------------------------------------

static void ply_billion_vertices(text *t, size_t many) {
    (void)many;
    text_print(t,
               "ply\nformat binary_little_endian 1.0\nelement vertex 1000000000\nproperty float x\n"
               "property float y\nproperty float z\nelement face 1000000000\n"
               "property list uchar int vertex_indices\nend_header\n0123456789abcdef");
}
static void ply_negative_count(text *t, size_t many) {
    (void)many;
    text_print(
        t, "ply\nformat ascii 1.0\nelement vertex -1\nproperty float x\nelement face 4294967295\n"
           "property list uchar int vertex_indices\nend_header\n3 0 1 2\n");
}
static void ply_billion_corners(text *t, size_t many) {
    (void)many;
    text_print(
        t, "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
           "property float z\nelement face 1\nproperty list uint int vertex_indices\nend_header\n"
           "0 0 0\n1 0 0\n0 1 0\n1000000000 0 1 2\n");
}
static void fbx_billion_numbers(text *t, size_t many) {
    (void)many;
    text_print(t,
               "; FBX 7.3.0 project file\nObjects: {\n Geometry: 1, \"Geometry::g\", \"Mesh\" {\n"
               "  Vertices: *1000000000 {\n a: 0,0,0,1,0,0,0,1,0\n }\n"
               "  PolygonVertexIndex: *3 {\n a: 0,1,-1000000000\n }\n }\n}\n");
}
static void dae_billion_numbers(text *t, size_t many) {
    (void)many;
    text_print(
        t,
        "<COLLADA version=\"1.4.1\"><library_geometries><geometry id=\"g\"><mesh><source id=\"p\">"
        "<float_array id=\"a\" count=\"1000000000\">0 0 0 1 0 0 0 1 "
        "0</float_array><technique_common>"
        "<accessor source=\"#a\" count=\"1000000000\" stride=\"3\"><param name=\"X\" "
        "type=\"float\"/>"
        "</accessor></technique_common></source><vertices id=\"v\"><input semantic=\"POSITION\" "
        "source=\"#p\"/></vertices><triangles count=\"1000000000\"><input semantic=\"VERTEX\" "
        "source=\"#v\" offset=\"0\"/><p>0 1 2000000000</p></triangles></mesh></geometry>"
        "</library_geometries></COLLADA>");
}
static void dae_entities(text *t, size_t many) {
    (void)many;
    text_print(t, "<?xml version=\"1.0\"?><!DOCTYPE x [<!ENTITY a \"aaaaaaaaaa\">");
    for (char c = 'b'; c <= 'j'; ++c) {
        text_print(t, "<!ENTITY %c \"&%c;&%c;&%c;&%c;&%c;&%c;&%c;&%c;\">", c, c - 1, c - 1, c - 1,
                   c - 1, c - 1, c - 1, c - 1, c - 1);
    }
    text_print(t, "]><COLLADA version=\"1.4.1\"><asset>&j;</asset></COLLADA>");
}

// ---- scenes ------------------------------------------------------------------------------------

// A glTF file of one triangle whose accessor claims `count` vertices; `nodes` is the node list.
static void gltf(text *t, const char *count, const char *nodes) {
    text_print(t,
               "{\"asset\":{\"version\":\"2.0\"},\"scene\":0,\"scenes\":[{\"nodes\":[0]}],"
               "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0}}]}],\"accessors\":[{"
               "\"bufferView\":0,\"componentType\":5126,\"count\":%s,\"type\":\"VEC3\"}],"
               "\"bufferViews\":[{\"buffer\":0,\"byteLength\":36}],\"buffers\":[{\"byteLength\":36,"
               "\"uri\":\"data:application/octet-stream;base64,"
               "AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA\"}],\"nodes\":[",
               count);
    text_append(t, nodes, strlen(nodes));
    text_print(t, "]}");
}
static void gltf_triangle(text *t, size_t many) {
    (void)many;
    gltf(t, "3", "{\"mesh\":0}");
}
static void gltf_billion_vertices(text *t, size_t many) {
    (void)many;
    gltf(t, "1000000000", "{\"mesh\":0}");
}
static void gltf_overflowing_count(text *t, size_t many) {
    (void)many;
    gltf(t, "1537228672809129302", "{\"mesh\":0}"); // times 12 is 8 modulo 2^64
}
static void gltf_cycle(text *t, size_t many) {
    (void)many;
    gltf(t, "3", "{\"mesh\":0,\"children\":[1]},{\"children\":[0]}");
}
static void gltf_own_child(text *t, size_t many) {
    (void)many;
    gltf(t, "3", "{\"mesh\":0,\"children\":[0]}");
}
// Each node is the child of two: 2^30 nodes when followed.
static void gltf_doubling(text *t, size_t many) {
    (void)many;
    text nodes = {0};
    for (size_t i = 0; i < 30; ++i) {
        text_print(&nodes, "{\"children\":[%zu,%zu]},", i + 1, i + 1);
    }
    text_append(&nodes, "{\"mesh\":0}", sizeof("{\"mesh\":0}"));
    gltf(t, "3", nodes.bytes);
    free(nodes.bytes);
}
static void gltf_deep_tree(text *t, size_t many) {
    text nodes = {0};
    for (size_t i = 0; i < many / 10; ++i) {
        text_print(&nodes, "{\"children\":[%zu]},", i + 1);
    }
    text_append(&nodes, "{\"mesh\":0}", sizeof("{\"mesh\":0}"));
    gltf(t, "3", nodes.bytes);
    free(nodes.bytes);
}
static void gltf_deep_json(text *t, size_t many) {
    for (size_t i = 0; i < many; ++i) {
        text_append(t, "{\"a\":", 5);
    }
}
static void dae_deep_tree(text *t, size_t many) {
    text_print(t, "<COLLADA version=\"1.4.1\"><library_visual_scenes><visual_scene id=\"s\">");
    for (size_t i = 0; i < many / 10; ++i) {
        text_print(t, "<node id=\"n%zu\">", i);
    }
}

bool hand_made(size_t index, bool large, text *file, const char **name, const char **extension) {
#define CASE(function, extension)                                                                  \
    { #function, extension, function }
    static const struct {
        const char *name, *extension;
        void (*write)(text *t, size_t many);
    } cases[] = {
        CASE(obj_index_overflow, "obj"),
        CASE(obj_negative_index, "obj"),
        CASE(obj_large_polygon, "obj"),
        CASE(obj_1e30, "obj"),
        CASE(obj_1e_30, "obj"),
        CASE(obj_denormals, "obj"),
        CASE(obj_mixed_scales, "obj"),
        CASE(obj_far_away, "obj"),
        CASE(obj_one_far_vertex, "obj"),
        CASE(obj_nan, "obj"),
        CASE(obj_long_line, "obj"),
        CASE(obj_many_groups, "obj"),
        CASE(loose_triangles, "stl"),
        CASE(large_loose_triangles, "stl"),
        CASE(one_triangle_many_times, "stl"),
        CASE(coplanar_soup, "stl"),
        CASE(zero_area_fan, "stl"),
        CASE(edge_of_many_triangles, "stl"),
        CASE(vertex_of_many_triangles, "stl"),
        CASE(needles, "stl"),
        CASE(ply_billion_vertices, "ply"),
        CASE(ply_negative_count, "ply"),
        CASE(ply_billion_corners, "ply"),
        CASE(fbx_billion_numbers, "fbx"),
        CASE(dae_billion_numbers, "dae"),
        CASE(dae_entities, "dae"),
        CASE(gltf_triangle, "gltf"),
        CASE(gltf_billion_vertices, "gltf"),
        CASE(gltf_overflowing_count, "gltf"),
        CASE(gltf_cycle, "gltf"),
        CASE(gltf_own_child, "gltf"),
        CASE(gltf_doubling, "gltf"),
        CASE(gltf_deep_tree, "gltf"),
        CASE(gltf_deep_json, "gltf"),
        CASE(dae_deep_tree, "dae"),
    };
#undef CASE
    if (index >= sizeof(cases) / sizeof(cases[0])) {
        return false;
    }
    *name = cases[index].name;
    *extension = cases[index].extension;
    file->size = 0;
    cases[index].write(file, large ? 1000000 : 2000);
    return true;
}
