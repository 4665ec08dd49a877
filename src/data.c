// Release functions of the plain data types.
#include "core/core.h"
#include "proxycloth/pipeline.h"

void pc_mesh_free(pc_context *context, pc_mesh *mesh) {
    if (mesh != NULL) {
        pc_release(context, mesh->positions);
        pc_release(context, mesh->triangles);
        memset(mesh, 0, sizeof(*mesh));
    }
}

void pc_motion_free(pc_context *context, pc_motion *motion) {
    if (motion != NULL) {
        pc_release(context, motion->positions);
        pc_release(context, motion->pinned);
        memset(motion, 0, sizeof(*motion));
    }
}

void pc_visual_free(pc_context *context, pc_visual *visual) {
    if (visual != NULL) {
        pc_mesh_free(context, &visual->surface);
        pc_release(context, visual->corner_vertices);
        pc_release(context, visual->corner_triangles);
        pc_release(context, visual->normals);
        pc_release(context, visual->texcoords);
        pc_release(context, visual->colors);
        pc_release(context, visual->triangle_materials);
        pc_release(context, visual->materials);
        pc_release(context, visual->triangle_parts);
        pc_release(context, visual->part_names);
        pc_release(context, visual->joints);
        pc_release(context, visual->joint_weights);
        memset(visual, 0, sizeof(*visual));
    }
}

void pc_character_free(pc_context *context, pc_character *character) {
    if (character != NULL) {
        pc_release(context, character->joint_names);
        pc_release(context, character->joint_centers);
        pc_release(context, character->joint_parents);
        pc_release(context, character->clip_names);
        pc_release(context, character->clip_poses);
        pc_release(context, character->clip_rates);
        pc_release(context, character->poses);
        pc_mesh_free(context, &character->body);
        pc_release(context, character->body_part_names);
        pc_release(context, character->body_triangle_parts);
        pc_release(context, character->body_joints);
        pc_release(context, character->body_weights);
        memset(character, 0, sizeof(*character));
    }
}

void pc_scenario_free(pc_context *context, pc_scenario *scenario) {
    if (scenario != NULL) {
        pc_release(context, scenario->winds);
        pc_release(context, scenario->pins);
        pc_release(context, scenario->attachment.keys);
        pc_release(context, scenario->colliders);
        memset(scenario, 0, sizeof(*scenario));
    }
}

void pc_grid_free(pc_context *context, pc_grid *grid) {
    if (grid != NULL) {
        pc_release(context, grid->samples);
        pc_release(context, grid->values);
        memset(grid, 0, sizeof(*grid));
    }
}

void pc_graph_free(pc_context *context, pc_graph *graph) {
    if (graph != NULL) {
        pc_release(context, graph->curvatures);
        pc_release(context, graph->outer_distances);
        pc_release(context, graph->edges);
        pc_release(context, graph->edge_weights);
        pc_release(context, graph->opposites);
        pc_release(context, graph->opposite_signs);
        memset(graph, 0, sizeof(*graph));
    }
}

void pc_labels_free(pc_context *context, pc_labels *labels) {
    if (labels != NULL) {
        pc_release(context, labels->labels);
        memset(labels, 0, sizeof(*labels));
    }
}

void pc_skin_free(pc_context *context, pc_skin *skin) {
    if (skin != NULL) {
        pc_release(context, skin->bones);
        pc_release(context, skin->weights);
        memset(skin, 0, sizeof(*skin));
    }
}
