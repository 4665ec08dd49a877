// A scene as it comes out of the import child: one flat buffer, checked before use.
#ifndef SCENE_H
#define SCENE_H

#include <stdio.h>

#include "cli.h"

// A mesh at a node of the scene, in the scene's coordinates.
typedef struct scene_part {
    char node[128];
    char mesh[128];
    uint64_t first_vertex, vertex_count;
    uint64_t first_triangle, triangle_count;
    uint32_t material;
    uint32_t bone_count; // 0: not skinned
    uint32_t has_normals, has_texcoords, has_colors;
    uint32_t reserved;
} scene_part;

typedef struct scene_animation {
    char name[128];
    double seconds;
    uint64_t channels;
    double rate; // poses per second
    uint64_t first_pose, pose_count;
} scene_animation;

// A node that vertices follow.
typedef struct scene_joint {
    char name[PC_NAME_SIZE];
    double center[3]; // in the rest pose
    uint32_t parent;  // an earlier joint, or PC_INVALID_INDEX
    uint32_t reserved;
} scene_joint;

typedef struct scene_header {
    char magic[8];
    uint64_t size; // of the whole buffer
    uint64_t node_count;
    uint64_t part_count, material_count, animation_count, vertex_count, triangle_count;
    uint64_t joint_count, pose_count;
    char format[16]; // of the file, for example "glTF"
} scene_header;

// Views into `buffer`.
typedef struct scene_data {
    void *buffer;
    scene_header header;
    scene_part *parts;
    pc_material *materials;
    scene_animation *animations;
    double *positions;   // #vertices by 3
    float *normals;      // #vertices by 3
    float *texcoords;    // #vertices by 2
    float *colors;       // #vertices by 4
    uint32_t *triangles; // #triangles by 3, of the whole scene
    scene_joint *joints;
    float *poses;            // #poses by #joints by 12, see pc_character
    uint32_t *vertex_joints; // #vertices by 4
    float *vertex_weights;   // #vertices by 4
} scene_data;

// What the child sends instead of a scene.
typedef struct scene_failure {
    char magic[8];
    uint64_t out_of_memory;
    char message[256];
} scene_failure;

#define SCENE_MAGIC         "PCSCENE3"
#define SCENE_FAILURE_MAGIC "PCFAIL_1"

// Byte offsets of the arrays behind the header, in the order of `scene`; the last one is the size
// of the buffer. False when it does not fit into 64 bits.
enum { SCENE_ARRAYS = 12 };
bool scene_layout(const scene_header *header, uint64_t offsets[SCENE_ARRAYS + 1]);

// Checks a buffer of `size` bytes from the child and sets up the views; nothing in it is trusted.
// The scene takes the buffer over (also when the check fails). Returns what is wrong, or NULL.
const char *scene_open(void *buffer, size_t size, scene_data *scene);
void scene_free(scene_data *scene);

// Chooses the parts whose node, mesh or material name matches one of the patterns; all without
// patterns. Returns the number of chosen parts.
size_t scene_select(const scene_data *scene, const char *const *patterns, size_t pattern_count,
                    uint8_t *chosen);

// Text of all names that --mesh can match, for messages.
void scene_names(const scene_data *scene, char *text, size_t size);

// Makes the visual mesh of the chosen parts.
pc_status scene_visual(const scene_data *scene, const uint8_t *chosen, pc_context *context,
                       pc_visual *visual, pc_visual_report *report);

// Makes the character of the skeleton, the clips, and the parts that are not chosen.
pc_status scene_character(const scene_data *scene, const uint8_t *chosen, pc_context *context,
                          pc_character *character);

// Imports a file in a child process with limits. Prints the message on failure.
int scene_import(const cli_command *command, const cli_arguments *arguments, const char *path,
                 scene_data *scene);

// Imports a file and chooses parts by --mesh; `chosen` (#parts) is released with free().
int scene_import_selected(const cli_command *command, const cli_arguments *arguments,
                          const char *path, scene_data *scene, uint8_t **chosen);

// ---- inside the child ---------------------------------------------------------------------------

typedef enum scene_format {
    SCENE_OBJ,
    SCENE_FBX,
    SCENE_GLTF,
    SCENE_GLB,
    SCENE_DAE,
    SCENE_PLY,
    SCENE_STL
} scene_format;

// File extension that selects assimp's importer, and the format's name for people.
const char *scene_format_extension(scene_format format);
const char *scene_format_name(scene_format format);

// Whether a file's extension is that of a mesh or scene.
bool scene_named_like_one(const char *path);

// Recognises a file by its first bytes and its extension. Prints the message on failure.
int scene_sniff(const char *command, const char *path, scene_format *format);

// From now on this process can only read files, compute, and write to `descriptor`; for good. False
// where the system has no such filter (Linux on x86-64 and AArch64 has): then only the limits of
// the import child hold.
bool scene_isolate(int descriptor);

// The text of an OBJ file in the spelling that assimp reads right, as new bytes; NULL when a line
// is wrong or memory runs out ("bad_alloc"), which the message then says.
char *scene_plain_obj(const char *path, const char *bytes, size_t *size, char *message,
                      size_t message_size);

// Whether a PLY file holds all that its header announces; says what is wrong otherwise.
bool scene_check_ply(const char *bytes, size_t size, char *message, size_t message_size);

// The same for an STL file; bytes behind its last triangle are no longer counted.
bool scene_check_stl(const char *bytes, size_t *size, char *message, size_t message_size);

// A glTF or GLB file as a GLB file that assimp reads right, as new bytes; else NULL and the cause.
char *scene_plain_gltf(const char *path, const char *bytes, size_t *size, scene_format format,
                       char *message, size_t message_size);

// Reads a file through assimp and writes the buffer (or a failure) to `descriptor`. Runs in the
// child; returns the child's exit code.
int scene_read(const char *path, scene_format format, int descriptor);

#endif
