/// What the proxy goes through: winds, pins, attachment, colliders. The numbers of the simulation
/// (gravity, frames, stiffness, ...) are pc_simulate_options; one JSON file holds both.
///
/// A zeroed pc_scenario is the paper's: random winds, the highest vertices held, no collider.
///
/// The file is one JSON object; every key is optional, an unknown key is an error:
///   any option of the stage by its name, for example "gravity": 9.81, "solver": "xpbd"
///   "duration": s                            instead of "frames"
///   "winds": [{"time": s, "velocity": [x, y, z]}, ...]
///                                            m/s; linear between the keys, constant outside of
///                                            them; instead of random winds by "seed"
///   "pins": [RULE, ...]                      all vertices that a rule names are held; a RULE is
///       {"highest": fraction}                the highest vertices, rounded up
///       {"box": {"min": [x, y, z], "max": [x, y, z]}}
///       {"attribute": NAME, "above": number} at the nearest point of the visual mesh; NAME is
///                                            red, green, blue, alpha (vertex color), u or v
///       {"mesh": GLOB}                       nearest triangle's mesh or node matches; * ? are wild
///       {"material": GLOB}                   its material does
///   "attachment": {"clip": NAME, "start": s, "loop": bool, "blend": s}
///       pinned vertices follow a clip of the input's skeleton, by the joint weights of the nearest
///       point of the visual mesh (of the body where the garment is not skinned). For `blend`
///       seconds before the first frame they move from the rest pose to the pose at `start`.
///   "attachment": {"keys": [{"time": s, "translation": [x, y, z], "rotation": [x, y, z, w]}, ...],
///                  "pivot": [x, y, z]}
///       pinned vertices follow a rigid motion: rotation (quaternion) about the pivot, then
///       translation; linear between the keys. Colliders without joint stay.
///   "colliders": [COLLIDER, ...]
///       {"shape": "sphere", "center": [x, y, z], "radius": r, "joint": NAME}
///       {"shape": "capsule", "from": [x, y, z], "to": [x, y, z], "radius": r, "joint": NAME}
///       {"shape": "body", "mesh": GLOB}      the parts of the input that are no garment, as a
///                                            distance field; they follow the clip
///       "joint" is optional: the collider follows this joint of the clip. "mesh" is optional.
/// Positions and radii are in the unit of the visual mesh, in its rest pose.
#ifndef PROXYCLOTH_SCENARIO_H
#define PROXYCLOTH_SCENARIO_H

#include "proxycloth/base.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Bytes of a name with its end.
#define PC_NAME_SIZE 64

typedef struct pc_wind_key {
    double time;        ///< s
    double velocity[3]; ///< m/s
} pc_wind_key;

typedef enum pc_pin_kind {
    PC_PIN_HIGHEST,
    PC_PIN_BOX,
    PC_PIN_ATTRIBUTE,
    PC_PIN_MESH,
    PC_PIN_MATERIAL
} pc_pin_kind;

typedef enum pc_attribute {
    PC_ATTRIBUTE_RED,
    PC_ATTRIBUTE_GREEN,
    PC_ATTRIBUTE_BLUE,
    PC_ATTRIBUTE_ALPHA,
    PC_ATTRIBUTE_U,
    PC_ATTRIBUTE_V
} pc_attribute;

/// Which vertices of the proxy are held. Fields that the kind does not need are ignored.
typedef struct pc_pin {
    pc_pin_kind kind;
    double fraction;               ///< highest: share of the vertices, 0..1
    double minimum[3], maximum[3]; ///< box
    pc_attribute attribute;
    double above;            ///< attribute: held where the value exceeds this
    char name[PC_NAME_SIZE]; ///< mesh, material: a pattern with * and ?
} pc_pin;

typedef enum pc_attachment_kind {
    PC_ATTACHMENT_NONE, ///< pinned vertices stay where they are
    PC_ATTACHMENT_CLIP,
    PC_ATTACHMENT_RIGID
} pc_attachment_kind;

typedef struct pc_rigid_key {
    double time; ///< s
    double translation[3];
    double rotation[4]; ///< quaternion x, y, z, w; need not be normalised
} pc_rigid_key;

/// How pinned vertices move.
typedef struct pc_attachment {
    pc_attachment_kind kind;
    char clip[PC_NAME_SIZE];
    double start; ///< s into the clip at which the first step begins
    double blend; ///< s from the rest pose to the pose at `start`, before the first frame
    bool loop;    ///< false: the clip's last pose is kept
    double pivot[3];
    size_t key_count;
    pc_rigid_key *keys; ///< times ascend
} pc_attachment;

typedef enum pc_collider_kind {
    PC_COLLIDER_SPHERE,
    PC_COLLIDER_CAPSULE,
    PC_COLLIDER_BODY
} pc_collider_kind;

typedef struct pc_collider {
    pc_collider_kind kind;
    double from[3];           ///< centre of the sphere, one end of the capsule
    double to[3];             ///< other end of the capsule
    double radius;            ///< > 0
    char joint[PC_NAME_SIZE]; ///< empty: does not move
    char mesh[PC_NAME_SIZE];  ///< body: pattern for the part's name; empty: all parts
} pc_collider;

typedef struct pc_scenario {
    size_t wind_count;
    pc_wind_key *winds; ///< times ascend; none: random winds
    size_t pin_count;
    pc_pin *pins; ///< none: the option pinned_fraction
    pc_attachment attachment;
    size_t collider_count;
    pc_collider *colliders;
} pc_scenario;

/// Releases the arrays and zeroes the struct. NULL is accepted.
void pc_scenario_free(pc_context *context, pc_scenario *scenario);

struct pc_simulate_options;

/// Reads a scenario file.
/// @param[in,out] options   options that the file names are set, the others stay.
/// @param[out]    scenario  zeroed on entry; empty on failure.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT (no path); PC_ERROR_IO; PC_ERROR_FORMAT (not JSON, with
///         line); PC_ERROR_INVALID_OPTIONS (unknown key, wrong type, value out of range; with the
///         file's name and the key's path, for example pins[1].box.min); PC_ERROR_OUT_OF_MEMORY.
PC_NODISCARD pc_status pc_scenario_read(pc_context *context, const char *path,
                                        struct pc_simulate_options *options, pc_scenario *scenario);

/// The same from text of `size` bytes; `name` stands for the file's name in messages.
PC_NODISCARD pc_status pc_scenario_parse(pc_context *context, const char *text, size_t size,
                                         const char *name, struct pc_simulate_options *options,
                                         pc_scenario *scenario);

/// Checks what the parser checks of a scenario that a program filled: ranges, ascending times,
/// names that end.
/// @return PC_OK; PC_ERROR_INVALID_OPTIONS.
PC_NODISCARD pc_status pc_scenario_check(pc_context *context, const pc_scenario *scenario);

#ifdef __cplusplus
}
#endif
#endif
