/// Plain data that stages exchange: triangle meshes, the visual mesh, and frames of a moving mesh.
///
/// Arrays are row-major and tightly packed, "#V by 3" means 3 consecutive values per vertex. The
/// caller declares a zeroed struct, the library fills it, the matching free function releases it
/// and zeroes it again (twice is harmless).
#ifndef PROXYCLOTH_MESH_H
#define PROXYCLOTH_MESH_H

#include "proxycloth/base.h"

#ifdef __cplusplus
extern "C" {
#endif

/// A triangle mesh. Front faces are counter-clockwise.
typedef struct pc_mesh {
    size_t vertex_count;
    double *positions; ///< #V by 3, in the unit of the input
    size_t triangle_count;
    uint32_t *triangles; ///< #F by 3, each < vertex_count
} pc_mesh;

/// Releases the arrays and zeroes the struct. NULL is accepted.
void pc_mesh_free(pc_context *context, pc_mesh *mesh);

/// Sum of the areas of all triangles.
double pc_mesh_area(const pc_mesh *mesh);

/// Positions of a mesh over time: what drives the visual mesh.
typedef struct pc_motion {
    size_t frame_count;
    size_t vertex_count;
    double *positions; ///< #frames by #V by 3, absolute, in the unit of the input
    double frame_time; ///< seconds from one frame to the next
    uint8_t *pinned;   ///< #V, 1 where the vertex is held fixed
} pc_motion;

/// Releases the arrays and zeroes the struct. NULL is accepted.
void pc_motion_free(pc_context *context, pc_motion *motion);

/// Look of a part of the visual mesh (metallic-roughness model of glTF 2.0, factors only).
typedef struct pc_material {
    char name[64];
    float base_color[4]; ///< linear RGBA, 0..1
    float metallic;      ///< 0..1
    float roughness;     ///< 0..1
    bool double_sided;
} pc_material;

/// The visual mesh: its welded surface, on which every stage works, and its appearance.
///
/// Files split a vertex where texture coordinates or normals differ. Here `surface` holds every
/// position once, and a *corner vertex* (split vertex) refers to its position by index, so weights
/// computed on the surface never tear a seam.
typedef struct pc_visual {
    pc_mesh surface;            ///< vertices with distinct positions; all triangles of the input
    size_t corner_count;        ///< split vertices that a triangle uses, in the input's order
    uint32_t *corner_vertices;  ///< #C, vertex of `surface` at this split vertex
    uint32_t *corner_triangles; ///< #F by 3, split vertices of each triangle, same order as surface
    float *normals;             ///< #C by 3, unit, or NULL
    float *texcoords;           ///< #C by 2, origin top left as in glTF, or NULL
    float *colors;              ///< #C by 4, linear RGBA, or NULL
    uint32_t *triangle_materials; ///< #F, each < material_count
    size_t material_count;        ///< at least 1
    pc_material *materials;
    uint32_t *triangle_parts; ///< #F, each < part_count, or NULL
    size_t part_count;        ///< meshes of the file that the surface is made of
    char *part_names;         ///< #parts by 64, zero-terminated, or NULL
    uint32_t *joints;         ///< #C by 4, joints of pc_character, or NULL
    float *joint_weights;     ///< #C by 4, sum 1, or all 0; NULL where `joints` is
} pc_visual;

/// Releases the arrays and zeroes the struct. NULL is accepted.
void pc_visual_free(pc_context *context, pc_visual *visual);

/// Arrays of a caller, read and never kept. Pointers other than the first two may be NULL.
typedef struct pc_visual_arrays {
    size_t vertex_count;     ///< split vertices
    const double *positions; ///< #vertices by 3
    size_t triangle_count;
    const uint32_t *triangles;          ///< #triangles by 3
    const float *normals;               ///< #vertices by 3
    const float *texcoords;             ///< #vertices by 2
    const float *colors;                ///< #vertices by 4
    const uint32_t *triangle_materials; ///< #triangles; NULL: all 0
    size_t material_count;              ///< 0: one white material
    const pc_material *materials;
    const uint32_t *triangle_parts; ///< #triangles, each < part_count
    size_t part_count;
    const char *part_names;     ///< #parts by 64
    const uint32_t *joints;     ///< #vertices by 4
    const float *joint_weights; ///< #vertices by 4, not negative; scaled to sum 1
} pc_visual_arrays;

/// What was noticed about the input; everything counted here is accepted.
typedef struct pc_visual_report {
    uint64_t vertices;             ///< distinct positions that a triangle uses
    uint64_t triangles;            ///< all, including the degenerate ones
    uint64_t degenerate_triangles; ///< repeated vertex, or height below 1e-12 of the longest edge
    uint64_t duplicate_triangles;  ///< same three positions as an earlier triangle
    uint64_t stray_vertices;       ///< split vertices used by no triangle; left out
    uint64_t nonmanifold_edges;    ///< edges of more than two distinct triangles
    uint64_t winding_conflicts;    ///< edges of two triangles that run them in the same direction
    /// Split vertices with a normal, texture coordinate or color that is not finite (or a normal of
    /// length 0): the normal is taken from the surface, texture coordinates become 0, colors 1.
    uint64_t replaced_attributes;
    uint64_t components; ///< parts connected by shared positions
    double diagonal;     ///< of the bounding box
} pc_visual_report;

/// Builds the visual mesh from plain arrays: checks, welds equal positions, counts defects.
/// Degenerate and duplicate triangles stay in the mesh (the artist's asset comes out as it went
/// in). Positions weld when they are equal bit by bit, with -0 = 0. Normals are scaled to length 1,
/// colors and material factors are clamped into [0, 1].
/// @param[out] visual  zeroed on entry.
/// @param[out] report  may be NULL.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT (NULL, output not empty); PC_ERROR_INVALID_MESH (no
///         triangle, index out of range, position NaN, infinite or beyond 1e30, all positions equal
///         or nearer to one line than 1e-6 of the extent, no triangle with area);
///         PC_ERROR_TOO_LARGE (2^31 elements); PC_ERROR_OUT_OF_MEMORY.
PC_NODISCARD pc_status pc_visual_create(pc_context *context, const pc_visual_arrays *arrays,
                                        pc_visual *visual, pc_visual_report *report);

#ifdef __cplusplus
}
#endif
#endif
