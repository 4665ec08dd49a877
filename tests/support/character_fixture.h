// A character without a file: two joints, a clip that turns the second one, and a ball as its body.
#ifndef TEST_SUPPORT_CHARACTER_FIXTURE_H
#define TEST_SUPPORT_CHARACTER_FIXTURE_H

#include "support/shapes.h"

enum { FIXTURE_POSES = 31 };

// Joint "arm" turns about the z axis through (1, 0, 0) by 90 degrees in a second, then stays;
// "root" does not move. The body is a ball of radius `radius` around `center`, carried by `joint`.
static inline void fixture_character(pc_context *context, const double center[3], double radius,
                                     uint32_t joint, pc_character *character) {
    char names[2][64] = {"root", "arm"}, clips[1][64] = {"turn"}, parts[1][64] = {"Ball_Mesh"};
    double centers[6] = {0.0, 0.0, 0.0, 1.0, 0.0, 0.0}, rates[1] = {30.0};
    uint32_t ranges[2] = {0, FIXTURE_POSES}, parents[2] = {PC_INVALID_INDEX, 0};
    float poses[FIXTURE_POSES * 2 * 12] = {0};
    for (size_t p = 0; p < FIXTURE_POSES; ++p) {
        float *root = &poses[24 * p], *arm = root + 12;
        const double angle = 1.5707963267948966 * (double)p / (FIXTURE_POSES - 1);
        root[0] = root[5] = root[10] = arm[10] = 1.0F;
        arm[0] = arm[5] = (float)cos(angle);
        arm[4] = (float)sin(angle);
        arm[1] = -arm[4];
        arm[3] = 1.0F - arm[0];
        arm[7] = -arm[4];
    }
    pc_mesh ball = shape_sphere(context, 10, radius);
    uint32_t *joints = calloc(4 * ball.vertex_count, sizeof(*joints));
    float *weights = calloc(4 * ball.vertex_count, sizeof(*weights));
    uint32_t *triangle_parts = calloc(ball.triangle_count, sizeof(*triangle_parts));
    assert_true(joints != NULL && weights != NULL && triangle_parts != NULL);
    for (size_t v = 0; v < ball.vertex_count; ++v) {
        joints[4 * v] = joint;
        weights[4 * v] = 2.0F; // scaled to 1
        for (size_t k = 0; k < 3; ++k) {
            ball.positions[3 * v + k] += center[k];
        }
    }
    const pc_character arrays = {.joint_count = 2,
                                 .joint_names = names[0],
                                 .joint_centers = centers,
                                 .joint_parents = parents,
                                 .clip_count = 1,
                                 .clip_names = clips[0],
                                 .clip_poses = ranges,
                                 .clip_rates = rates,
                                 .pose_count = FIXTURE_POSES,
                                 .poses = poses,
                                 .body = ball,
                                 .body_part_count = 1,
                                 .body_part_names = parts[0],
                                 .body_triangle_parts = triangle_parts,
                                 .body_joints = joints,
                                 .body_weights = weights};
    assert_ok(context, pc_character_create(context, &arrays, character));
    pc_mesh_free(context, &ball);
    free(joints);
    free(weights);
    free(triangle_parts);
}

#endif
