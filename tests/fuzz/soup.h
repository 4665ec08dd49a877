// Bytes as numbers and small meshes, for targets that feed arrays to a stage.
#ifndef SOUP_H
#define SOUP_H

#include <math.h>
#include <string.h>

#include "fuzz.h"

enum { SOUP_VERTICES = 16, SOUP_TRIANGLES = 24 };

// What is left of the input; zeros follow its end.
typedef struct soup_bytes {
    const uint8_t *data;
    size_t size;
} soup_bytes;

static inline uint8_t soup_byte(soup_bytes *bytes) {
    if (bytes->size == 0) {
        return 0;
    }
    --bytes->size;
    return *bytes->data++;
}

// Small whole numbers, so that soups are full of coplanar, repeated and touching triangles; the top
// values stand for extreme numbers.
static inline double soup_number(soup_bytes *bytes) {
    static const double extremes[] = {1e30, -1e30, 1e-30, 4e-324, 1e300, (double)NAN, 1e15, 1e-9};
    const uint8_t byte = soup_byte(bytes);
    return byte >= 248 ? extremes[byte - 248] : (double)(byte % 16);
}

// A size of which most values are below `few`, so that most runs are short, and all below `many`.
static inline size_t soup_size(uint8_t byte, size_t few, size_t many) {
    return byte % (byte < 240 ? few : many);
}

static inline void *soup_allocate(size_t size) {
    void *memory = malloc(size + 1);
    fuzz_assert(memory != NULL);
    return memory;
}

// Arrays of their exact sizes, for sanitizers.
static inline pc_mesh soup_mesh(size_t vertices, size_t triangles) {
    return (pc_mesh){vertices, soup_allocate(3 * vertices * sizeof(double)), triangles,
                     soup_allocate(3 * triangles * sizeof(uint32_t))};
}

static inline void soup_free(pc_mesh *mesh) {
    free(mesh->positions);
    free(mesh->triangles);
}

// A soup: any triangles between any vertices, and indices out of range.
static inline pc_mesh soup_read(soup_bytes *bytes) {
    const size_t vertices = 3 + soup_size(soup_byte(bytes), 4, SOUP_VERTICES - 2);
    pc_mesh mesh = soup_mesh(vertices, 1 + soup_size(soup_byte(bytes), 4, SOUP_TRIANGLES));
    for (size_t i = 0; i < 3 * vertices; ++i) {
        mesh.positions[i] = soup_number(bytes);
    }
    for (size_t i = 0; i < 3 * mesh.triangle_count; ++i) {
        const uint8_t byte = soup_byte(bytes);
        mesh.triangles[i] = byte == 255 ? UINT32_MAX : (uint32_t)(byte % vertices);
    }
    return mesh;
}

// A tube of `rings` times `sides` vertices, closed by two poles or open, with vertices that bytes
// move and corners that they replace: what stages expect, and what nearly is.
static inline pc_mesh soup_tube(soup_bytes *bytes, bool closed) {
    const uint32_t rings = 2 + soup_byte(bytes) % 2, sides = 3 + soup_byte(bytes) % 3;
    const uint32_t poles = closed ? 2 : 0, first = rings * sides;
    pc_mesh mesh = soup_mesh(first + poles, (size_t)2 * sides * (rings - 1) + poles * sides);
    for (uint32_t v = 0; v < first; ++v) {
        const double angle = 2.0 * 3.14159265358979 * (v % sides) / sides;
        const double position[3] = {2.0 * cos(angle), 4.0 * (v / sides), 2.0 * sin(angle)};
        memcpy(&mesh.positions[3 * (size_t)v], position, sizeof(position));
    }
    uint32_t *corner = mesh.triangles;
    for (uint32_t v = 0; v + sides < first; ++v) {
        const uint32_t next = v % sides + 1 < sides ? v + 1 : v + 1 - sides;
        const uint32_t quad[6] = {v, v + sides, next, next, v + sides, next + sides};
        memcpy(corner, quad, sizeof(quad));
        corner += 6;
    }
    for (uint32_t i = 0; closed && i < sides; ++i) {
        const uint32_t next = (i + 1) % sides, last = first - sides;
        const uint32_t caps[6] = {first, i, next, first + 1, last + next, last + i};
        memcpy(corner, caps, sizeof(caps));
        corner += 6;
    }
    for (size_t i = 0; i < 3 * poles; ++i) {
        mesh.positions[3 * (size_t)first + i] = i == 1 ? -1.0 : i == 4 ? 4.0 * rings : 0.0;
    }
    for (size_t moves = soup_byte(bytes) % 16; moves > 0; --moves) {
        mesh.positions[soup_byte(bytes) % (3 * mesh.vertex_count)] = soup_number(bytes);
    }
    for (size_t changes = soup_byte(bytes) % 4; changes > 0; --changes) {
        mesh.triangles[soup_byte(bytes) % (3 * mesh.triangle_count)] =
            (uint32_t)(soup_byte(bytes) % mesh.vertex_count);
    }
    return mesh;
}

// A soup or a tube, as the next byte says.
static inline pc_mesh soup_any(soup_bytes *bytes) {
    const uint8_t kind = soup_byte(bytes) % 3;
    return kind == 0 ? soup_read(bytes) : soup_tube(bytes, kind == 1);
}

// Whether the call succeeded; it may refuse what it was given, and nothing else may go wrong.
#define soup_succeeds(status) soup_judge((status), __FILE__, __LINE__)
static inline bool soup_judge(pc_status status, const char *file, int line) {
    const bool refused = status == PC_ERROR_INVALID_ARGUMENT || status == PC_ERROR_INVALID_MESH ||
                         status == PC_ERROR_NUMERICAL || status == PC_ERROR_NO_PROXY ||
                         status == PC_ERROR_TOO_LARGE;
    fuzz_require(status == PC_OK || refused, file, line, pc_status_text(status));
    return status == PC_OK;
}

// What a stage gets to see of a soup: the soup, as a caller with arrays of its own passes it, or
// the surface of a visual mesh made of it. NULL: none can be made.
static inline const pc_mesh *soup_surface(pc_context *context, const pc_mesh *soup, bool own,
                                          pc_visual *visual) {
    const pc_visual_arrays arrays = {.vertex_count = soup->vertex_count,
                                     .positions = soup->positions,
                                     .triangle_count = soup->triangle_count,
                                     .triangles = soup->triangles};
    if (own) {
        return soup;
    }
    return soup_succeeds(pc_visual_create(context, &arrays, visual, NULL)) ? &visual->surface
                                                                           : NULL;
}

static inline void soup_check_mesh(const pc_mesh *mesh) {
    for (size_t i = 0; i < 3 * mesh->vertex_count; ++i) {
        fuzz_assert(isfinite(mesh->positions[i]));
    }
    for (size_t i = 0; i < 3 * mesh->triangle_count; ++i) {
        fuzz_assert(mesh->triangles[i] < mesh->vertex_count);
    }
}

static inline void soup_check_skin(const pc_skin *skin, size_t bones) {
    for (size_t v = 0; v < skin->vertex_count; ++v) {
        double sum = 0.0;
        for (size_t k = 0; k < skin->influences; ++k) {
            const size_t at = v * skin->influences + k;
            fuzz_assert(skin->bones[at] < bones && skin->weights[at] >= 0.0);
            sum += skin->weights[at];
        }
        fuzz_assert(fabs(sum - 1.0) < 1e-9);
    }
}

#endif
