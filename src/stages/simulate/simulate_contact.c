// Contacts of the cloth with spheres, capsules and the body. Vertices and the middles of edges keep
// a distance; the contact planes are found once per substep, obeyed after every sweep, and found
// again at the end.
#include "geometry/distance_field.h"
#include "geometry/topology.h"
#include "stages/simulate/simulate_internal.h"

static const char stage[] = "simulate";

// The box around the body is divided into about this many cells: 2 cm on a person.
static const double body_cells = 150000.0;
// Speed at which the cloth leaves a collider that it is in, m/s: faster would throw it.
static const double leaving_speed = 1.0;
// Cloth that rests deeper in the body than this share of an edge is tucked in and stays so: pushing
// it out would strain the edges next to it by more than a few percent (half the share squared).
static const double tuck_share = 0.25;
// Contacts give way where they stretch an edge by more than this many strain limits.
static const double caught_strain = 2.0;
// Second joints with less than this share of the weight do not carry the surface.
static const double least_share = 0.2;

// A point of the cloth that must stay outside: a vertex (a = b), or the middle of an edge.
typedef struct sample {
    uint32_t a, b;
    double distance; // to keep from the body; negative: tucked in
    double rest;     // length of the edge; 0 for a vertex
} sample;

typedef struct contact {
    uint32_t a, b; // as in sample
    double normal[3];
    double offset;   // normal . x >= offset
    double shift[3]; // how far the collider moved here in this substep
} contact;

typedef struct primitive {
    double rest[2][3]; // ends in the rest pose
    double now[2][3], before[2][3];
    double radius;
    size_t joint; // index into the maps; the last one never moves
} primitive;

// The part of the body's surface that follows one joint.
typedef struct limb {
    size_t joint;
    double minimum[3], maximum[3]; // in the rest pose, with the contact distance
    double center[3], radius;      // of a ball around it, now
} limb;

struct pci_contacts {
    double distance, friction;
    size_t joint_count; // maps without the last one, the identity
    pci_map *from, *to; // of this step
    pci_map *now, *before, *inverse;
    size_t primitive_count;
    primitive *primitives;
    bool has_body;
    pci_distance_field field;
    uint32_t *labels; // #points by 2, joints that carry the surface next to a point
    size_t limb_count;
    limb *limbs;
    size_t sample_count;
    sample *samples;
    size_t contact_count, contact_capacity;
    contact *contacts;
    uint8_t *caught; // #V, between colliders: an edge is stretched too far
    double *pushes;  // #V, how far a vertex was pushed in this substep
};

// ---- set-up ------------------------------------------------------------------------------------

// The joint's number; the last map where the name is empty. PC_ERROR_INVALID_OPTIONS.
static pc_status find_joint(pc_context *context, const pc_character *character, const char *name,
                            size_t *joint) {
    const size_t count = character != NULL ? character->joint_count : 0;
    *joint = count;
    if (name[0] == '\0') {
        return PC_OK;
    }
    for (size_t j = 0; j < count; ++j) {
        if (strcmp(&character->joint_names[PC_NAME_SIZE * j], name) == 0) {
            *joint = j;
            return PC_OK;
        }
    }
    return pci_fail(context, PC_ERROR_INVALID_OPTIONS, stage,
                    "simulate: colliders: the input has no joint \"%s\"", name);
}

// The triangles of the body that the scenario's body colliders name, at the simulated size.
static pc_status select_body(pci_scratch *scratch, const pc_simulate_inputs *inputs, double scale,
                             pc_mesh *body, uint32_t **original) {
    const pc_character *character = inputs->character;
    const pc_scenario *scenario = inputs->scenario;
    if (character == NULL || character->body.triangle_count == 0) {
        return pci_fail(scratch->context, PC_ERROR_INVALID_OPTIONS, stage,
                        "simulate: colliders: the input has no body; choose the garment's parts of "
                        "a file with more parts");
    }
    const size_t nv = character->body.vertex_count, nf = character->body.triangle_count;
    body->positions = PCI_SCRATCH(scratch, double, 3 * nv);
    body->triangles = PCI_SCRATCH(scratch, uint32_t, 3 * nf);
    *original = PCI_SCRATCH(scratch, uint32_t, nf);
    if (scratch->failed) {
        return pci_fail_memory(scratch->context, stage);
    }
    body->vertex_count = nv;
    for (size_t k = 0; k < 3 * nv; ++k) {
        body->positions[k] = scale * character->body.positions[k];
    }
    for (size_t t = 0; t < nf; ++t) {
        bool wanted = false;
        for (size_t i = 0; i < scenario->collider_count; ++i) {
            const pc_collider *collider = &scenario->colliders[i];
            const char *name =
                &character->body_part_names[PC_NAME_SIZE * character->body_triangle_parts[t]];
            wanted = wanted || (collider->kind == PC_COLLIDER_BODY &&
                                (collider->mesh[0] == '\0' || pci_matches(collider->mesh, name)));
        }
        if (wanted) {
            memcpy(&body->triangles[3 * body->triangle_count], &character->body.triangles[3 * t],
                   3 * sizeof(uint32_t));
            (*original)[body->triangle_count++] = (uint32_t)t;
        }
    }
    if (body->triangle_count == 0 || !(pci_diagonal(body) > 0.0)) {
        return pci_fail(scratch->context, PC_ERROR_INVALID_OPTIONS, stage,
                        "simulate: colliders: no part of the body has a matching name");
    }
    return PC_OK;
}

// The one or two joints with the largest weights on a triangle of the body.
static void label_triangle(const pc_character *character, size_t triangle, size_t fixed,
                           uint32_t labels[2]) {
    uint32_t joints[12] = {0};
    double sums[12] = {0.0}, total = 0.0;
    size_t count = 0;
    labels[0] = labels[1] = (uint32_t)fixed;
    for (size_t c = 0; c < 3; ++c) {
        const size_t row = character->body.triangles[3 * triangle + c];
        for (size_t k = 4 * row; k < 4 * row + 4; ++k) {
            size_t i = 0;
            while (i < count && joints[i] != character->body_joints[k]) {
                ++i;
            }
            if (i == count) {
                joints[count] = character->body_joints[k];
                sums[count++] = 0.0;
            }
            sums[i] += (double)character->body_weights[k];
            total += (double)character->body_weights[k];
        }
    }
    for (size_t k = 0; k < 2 && total > 0.0; ++k) {
        size_t best = 0;
        for (size_t i = 1; i < count; ++i) {
            best = sums[i] > sums[best] ? i : best;
        }
        labels[k] = k == 0 || sums[best] >= least_share * total ? joints[best] : labels[0];
        sums[best] = -1.0;
    }
}

// Labels all points and finds the extent of each limb.
static bool label_field(pci_scratch *scratch, const pc_simulate_inputs *inputs,
                        const uint32_t *original, pci_contacts *contacts) {
    const pci_distance_field *field = &contacts->field;
    const pc_character *character = inputs->character;
    const size_t count = (size_t)field->size[0] * field->size[1] * field->size[2];
    const size_t fixed = contacts->joint_count;
    const bool moves = inputs->scenario->attachment.kind == PC_ATTACHMENT_CLIP &&
                       character->body_weights != NULL && character->body_joints != NULL;
    contacts->labels = PCI_SCRATCH(scratch, uint32_t, 2 * count);
    contacts->limbs = PCI_SCRATCH(scratch, limb, fixed + 1);
    if (scratch->failed) {
        return false;
    }
    for (size_t j = 0; j <= fixed; ++j) {
        for (size_t k = 0; k < 3; ++k) {
            contacts->limbs[j].minimum[k] = INFINITY;
            contacts->limbs[j].maximum[k] = -INFINITY;
        }
    }
    const double reach = contacts->distance + field->cell;
    for (size_t i = 0; i < count; ++i) {
        uint32_t *labels = &contacts->labels[2 * i];
        labels[0] = labels[1] = (uint32_t)fixed;
        if (moves) {
            label_triangle(character, original[field->triangles[i]], fixed, labels);
        }
        const size_t at[3] = {i % field->size[0], i / field->size[0] % field->size[1],
                              i / field->size[0] / field->size[1]};
        for (size_t l = 0; l < 2 && (double)field->values[i] <= reach; ++l) {
            limb *part = &contacts->limbs[labels[l]];
            for (size_t k = 0; k < 3; ++k) {
                const double x = field->origin[k] + field->cell * (double)at[k];
                part->minimum[k] = fmin(part->minimum[k], x - field->cell);
                part->maximum[k] = fmax(part->maximum[k], x + field->cell);
            }
        }
    }
    for (size_t j = 0; j <= fixed; ++j) {
        if (contacts->limbs[j].minimum[0] < contacts->limbs[j].maximum[0]) {
            contacts->limbs[contacts->limb_count] = contacts->limbs[j];
            contacts->limbs[contacts->limb_count++].joint = j;
        }
    }
    return true;
}

static pc_status make_body(pci_scratch *scratch, const pc_simulate_inputs *inputs, double scale,
                           pci_contacts *contacts) {
    pc_mesh body = {0};
    uint32_t *original = NULL;
    pc_status status = select_body(scratch, inputs, scale, &body, &original);
    if (status == PC_OK) {
        double least[3], most[3], volume = 1.0;
        pci_bounding_box(&body, least, most);
        for (size_t k = 0; k < 3; ++k) { // flat bodies as if they were a tenth as thick as large
            volume *= fmax(most[k] - least[k], 0.1 * pci_diagonal(&body));
        }
        const double cell = cbrt(volume / body_cells);
        status = pci_distance_field_build(scratch, stage, &body, cell,
                                          contacts->distance + 2.0 * cell, &contacts->field);
    }
    if (status == PC_OK && !label_field(scratch, inputs, original, contacts)) {
        status = pci_fail_memory(scratch->context, stage);
    }
    contacts->has_body = status == PC_OK;
    return status;
}

static pc_status make_primitive(pc_context *context, const pc_simulate_inputs *inputs,
                                const pc_collider *collider, double scale, pci_contacts *contacts) {
    primitive *made = &contacts->primitives[contacts->primitive_count++];
    const double *ends[2] = {collider->from,
                             collider->kind == PC_COLLIDER_SPHERE ? collider->from : collider->to};
    for (size_t e = 0; e < 2; ++e) {
        for (size_t k = 0; k < 3; ++k) {
            made->rest[e][k] = made->now[e][k] = made->before[e][k] = scale * ends[e][k];
        }
    }
    made->radius = scale * collider->radius;
    return find_joint(context, inputs->character, collider->joint, &made->joint);
}

// Vertices and the middles of edges.
static bool make_samples(pci_scratch *scratch, const pc_mesh *proxy, double scale,
                         pci_contacts *contacts) {
    pci_topology topology;
    if (!pci_topology_build(scratch, proxy, &topology)) {
        return false;
    }
    contacts->sample_count = proxy->vertex_count + topology.edge_count;
    contacts->samples = PCI_SCRATCH(scratch, sample, contacts->sample_count);
    contacts->pushes = PCI_SCRATCH(scratch, double, proxy->vertex_count);
    contacts->caught = PCI_SCRATCH(scratch, uint8_t, proxy->vertex_count);
    contacts->contact_capacity = 4 * contacts->sample_count;
    contacts->contacts = PCI_SCRATCH(scratch, contact, contacts->contact_capacity);
    if (scratch->failed) {
        return false;
    }
    for (size_t i = 0; i < contacts->sample_count; ++i) {
        const bool vertex = i < proxy->vertex_count;
        const size_t e = vertex ? 0 : i - proxy->vertex_count;
        contacts->samples[i].a = vertex ? (uint32_t)i : topology.edges[2 * e];
        contacts->samples[i].b = vertex ? (uint32_t)i : topology.edges[2 * e + 1];
        contacts->samples[i].rest =
            scale *
            sqrt(pci_squared_distance(&proxy->positions[3 * (size_t)contacts->samples[i].a],
                                      &proxy->positions[3 * (size_t)contacts->samples[i].b]));
    }
    return true;
}

// What lies deep in the body at rest may stay there.
static void tuck_samples(pci_contacts *contacts, const pc_mesh *proxy, double scale) {
    double length = 0.0;
    size_t edges = 0;
    for (size_t i = proxy->vertex_count; i < contacts->sample_count; ++i, ++edges) {
        length += contacts->samples[i].rest;
    }
    const double deepest = edges != 0 ? tuck_share * length / (double)edges : 0.0;
    for (size_t i = 0; i < contacts->sample_count; ++i) {
        sample *at = &contacts->samples[i];
        double point[3], gradient[3], distance;
        size_t nearest;
        for (size_t k = 0; k < 3; ++k) {
            point[k] =
                0.5 * scale *
                (proxy->positions[3 * (size_t)at->a + k] + proxy->positions[3 * (size_t)at->b + k]);
        }
        if (pci_distance_field_sample(&contacts->field, point, &distance, gradient, &nearest) &&
            distance < -deepest) {
            at->distance = distance;
        }
    }
}

pc_status pci_contacts_create(pci_scratch *scratch, const pc_simulate_inputs *inputs, double scale,
                              double distance, double friction, pci_contacts **result) {
    const pc_scenario *scenario = inputs->scenario;
    *result = NULL;
    if (scenario->collider_count == 0) {
        return PC_OK;
    }
    pci_contacts *contacts = PCI_SCRATCH(scratch, pci_contacts, 1);
    const size_t joints = inputs->character != NULL ? inputs->character->joint_count : 0;
    pci_map *maps = PCI_SCRATCH(scratch, pci_map, 5 * (joints + 1));
    primitive *primitives = PCI_SCRATCH(scratch, primitive, scenario->collider_count);
    if (scratch->failed || !make_samples(scratch, inputs->proxy, scale, contacts)) {
        return pci_fail_memory(scratch->context, stage);
    }
    contacts->distance = distance;
    contacts->friction = friction;
    contacts->joint_count = joints;
    contacts->primitives = primitives;
    for (size_t i = 0; i < 5 * (joints + 1); ++i) {
        maps[i].m[0] = maps[i].m[5] = maps[i].m[10] = 1.0;
    }
    contacts->from = maps;
    contacts->to = maps + (joints + 1);
    contacts->now = maps + 2 * (joints + 1);
    contacts->before = maps + 3 * (joints + 1);
    contacts->inverse = maps + 4 * (joints + 1);
    for (size_t i = 0; i < contacts->sample_count; ++i) {
        contacts->samples[i].distance = distance;
    }
    pc_status status = PC_OK;
    for (size_t i = 0; i < scenario->collider_count && status == PC_OK; ++i) {
        if (scenario->colliders[i].kind != PC_COLLIDER_BODY) {
            status =
                make_primitive(scratch->context, inputs, &scenario->colliders[i], scale, contacts);
        } else if (!contacts->has_body) {
            status = make_body(scratch, inputs, scale, contacts);
        }
    }
    if (status == PC_OK && contacts->has_body) {
        tuck_samples(contacts, inputs->proxy, scale);
    }
    *result = status == PC_OK ? contacts : NULL;
    return status;
}

// ---- motion of the colliders -------------------------------------------------------------------

void pci_contacts_aim(pci_contacts *contacts, const pci_map *joints) {
    memcpy(contacts->from, contacts->to, contacts->joint_count * sizeof(pci_map));
    memcpy(contacts->to, joints, contacts->joint_count * sizeof(pci_map));
}

void pci_contacts_place(pci_contacts *contacts, double before, double now) {
    for (size_t j = 0; j < contacts->joint_count; ++j) {
        for (size_t k = 0; k < 12; ++k) {
            const double from = contacts->from[j].m[k], way = contacts->to[j].m[k] - from;
            contacts->before[j].m[k] = from + before * way;
            contacts->now[j].m[k] = from + now * way;
        }
        if (contacts->has_body) {
            (void)pci_map_invert(&contacts->now[j], &contacts->inverse[j]);
        }
    }
    for (size_t i = 0; i < contacts->limb_count; ++i) {
        limb *part = &contacts->limbs[i];
        const double *m = contacts->now[part->joint].m;
        double middle[3], extent[3];
        for (size_t k = 0; k < 3; ++k) {
            middle[k] = 0.5 * (part->minimum[k] + part->maximum[k]);
            extent[k] = 0.5 * (part->maximum[k] - part->minimum[k]);
        }
        pci_map_apply(&contacts->now[part->joint], middle, part->center);
        // The norm of a matrix is at most that of all its numbers; a rotation counts sqrt(3).
        const double stretch = sqrt(pci_dot(m, m) + pci_dot(m + 4, m + 4) + pci_dot(m + 8, m + 8));
        part->radius = stretch * pci_norm(extent);
    }
    for (size_t i = 0; i < contacts->primitive_count; ++i) {
        primitive *p = &contacts->primitives[i];
        for (size_t e = 0; e < 2; ++e) {
            pci_map_apply(&contacts->before[p->joint], p->rest[e], p->before[e]);
            pci_map_apply(&contacts->now[p->joint], p->rest[e], p->now[e]);
        }
    }
}

// ---- distances ---------------------------------------------------------------------------------

// Distance to a capsule, its normal, and the motion of its nearest point.
static double capsule_distance(const primitive *p, const double point[3], double normal[3],
                               double shift[3]) {
    double axis[3], offset[3];
    pci_sub(p->now[1], p->now[0], axis);
    pci_sub(point, p->now[0], offset);
    const double squared = pci_dot(axis, axis);
    const double along =
        squared > 0.0 ? fmin(1.0, fmax(0.0, pci_dot(offset, axis) / squared)) : 0.0;
    for (size_t k = 0; k < 3; ++k) {
        normal[k] = offset[k] - along * axis[k];
        shift[k] = (1.0 - along) * (p->now[0][k] - p->before[0][k]) +
                   along * (p->now[1][k] - p->before[1][k]);
    }
    const double distance = pci_norm(normal);
    if (!pci_normalize(normal)) {
        normal[0] = 0.0, normal[1] = 1.0, normal[2] = 0.0; // on the axis every way out is as good
    }
    return distance - p->radius;
}

// Distance to a limb of the body; false where the body next to this point follows other joints.
static bool limb_distance(const pci_contacts *contacts, const limb *part, const double point[3],
                          double *distance, double normal[3], double shift[3]) {
    double rest[3], gradient[3], now[3], before[3];
    size_t nearest = 0;
    if (pci_squared_distance(point, part->center) > part->radius * part->radius) {
        return false;
    }
    pci_map_apply(&contacts->inverse[part->joint], point, rest);
    for (size_t k = 0; k < 3; ++k) {
        if (!(rest[k] >= part->minimum[k] && rest[k] <= part->maximum[k])) {
            return false;
        }
    }
    if (!pci_distance_field_sample(&contacts->field, rest, distance, gradient, &nearest) ||
        (contacts->labels[2 * nearest] != part->joint &&
         contacts->labels[2 * nearest + 1] != part->joint)) {
        return false;
    }
    const double *m = contacts->now[part->joint].m;
    for (size_t k = 0; k < 3; ++k) {
        normal[k] =
            m[4 * k] * gradient[0] + m[4 * k + 1] * gradient[1] + m[4 * k + 2] * gradient[2];
    }
    pci_map_apply(&contacts->now[part->joint], rest, now);
    pci_map_apply(&contacts->before[part->joint], rest, before);
    pci_sub(now, before, shift);
    return pci_normalize(normal);
}

double pci_contacts_depth(pci_contacts *contacts, const double point[3]) {
    double normal[3], shift[3], nearest = INFINITY, distance;
    for (size_t i = 0; i < contacts->primitive_count; ++i) {
        nearest = fmin(nearest, capsule_distance(&contacts->primitives[i], point, normal, shift));
    }
    for (size_t i = 0; i < contacts->limb_count; ++i) {
        if (limb_distance(contacts, &contacts->limbs[i], point, &distance, normal, shift)) {
            nearest = fmin(nearest, distance);
        }
    }
    return -nearest;
}

// ---- contacts ----------------------------------------------------------------------------------

static void add_contact(pci_contacts *contacts, const sample *at, const double point[3],
                        const double start[3], double depth, double slack, const double normal[3],
                        const double shift[3]) {
    if (contacts->contact_count == contacts->contact_capacity) {
        return; // more than four colliders at every sample: the first ones do
    }
    contact *added = &contacts->contacts[contacts->contact_count++];
    added->a = at->a;
    added->b = at->b;
    memcpy(added->normal, normal, sizeof(added->normal));
    memcpy(added->shift, shift, sizeof(added->shift));
    // Where the surface is; but no farther than what undoes the motion of this substep and leaves
    // at the leaving speed.
    added->offset = fmin(pci_dot(normal, point) + depth,
                         pci_dot(normal, start) + pci_dot(normal, shift) + slack);
}

// Contacts of samples that are nearer to a collider than `reach` times the distance to keep.
static void find_near(pci_contacts *contacts, const pci_cloth *cloth, double reach) {
    const double slack = leaving_speed * cloth->time_step / (double)cloth->substeps;
    contacts->contact_count = 0;
    for (size_t s = 0; s < contacts->sample_count; ++s) {
        const sample *at = &contacts->samples[s];
        const size_t a = 3 * (size_t)at->a, b = 3 * (size_t)at->b;
        if (!(cloth->inverse_mass[at->a] + cloth->inverse_mass[at->b] > 0.0) ||
            contacts->caught[at->a] || contacts->caught[at->b]) {
            continue;
        }
        double point[3], start[3], normal[3], shift[3], distance;
        for (size_t k = 0; k < 3; ++k) {
            point[k] = 0.5 * (cloth->positions[a + k] + cloth->positions[b + k]);
            start[k] = 0.5 * (cloth->previous[a + k] + cloth->previous[b + k]);
        }
        const double margin = (reach - 1.0) * contacts->distance;
        for (size_t i = 0; i < contacts->primitive_count; ++i) {
            distance = capsule_distance(&contacts->primitives[i], point, normal, shift);
            if (distance < contacts->distance + margin) {
                add_contact(contacts, at, point, start, contacts->distance - distance, slack,
                            normal, shift);
            }
        }
        for (size_t i = 0; i < contacts->limb_count; ++i) {
            if (limb_distance(contacts, &contacts->limbs[i], point, &distance, normal, shift) &&
                distance < at->distance + margin) {
                add_contact(contacts, at, point, start, at->distance - distance, slack, normal,
                            shift);
            }
        }
    }
}

// Cloth that hangs on both sides of a limb, or between two, is stretched by the contacts beyond all
// measure: its vertices pass until they are free again.
static void find_caught(pci_contacts *contacts, const pci_cloth *cloth) {
    const double longest = 1.0 + caught_strain * cloth->strain_limit;
    memset(contacts->caught, 0, cloth->vertex_count);
    for (size_t s = cloth->vertex_count; s < contacts->sample_count; ++s) {
        const sample *at = &contacts->samples[s];
        const double squared = pci_squared_distance(&cloth->previous[3 * (size_t)at->a],
                                                    &cloth->previous[3 * (size_t)at->b]);
        if (squared > longest * longest * at->rest * at->rest) {
            contacts->caught[at->a] = contacts->caught[at->b] = 1;
        }
    }
}

void pci_contacts_find(pci_contacts *contacts, const pci_cloth *cloth) {
    find_caught(contacts, cloth);
    memset(contacts->pushes, 0, cloth->vertex_count * sizeof(double));
    find_near(contacts, cloth, 2.0);
}

void pci_contacts_solve(const pci_contacts *contacts, pci_cloth *cloth) {
    for (size_t i = 0; i < contacts->contact_count; ++i) {
        const contact *c = &contacts->contacts[i];
        double *a = &cloth->positions[3 * (size_t)c->a], *b = &cloth->positions[3 * (size_t)c->b];
        const double depth = c->offset - 0.5 * (pci_dot(c->normal, a) + pci_dot(c->normal, b));
        if (!(depth > 0.0)) {
            continue;
        }
        const double mass_a = cloth->inverse_mass[c->a], mass_b = cloth->inverse_mass[c->b];
        // The middle moves by half of what each end moves.
        const double scale = c->a == c->b ? depth / mass_a : 2.0 * depth / (mass_a + mass_b);
        for (size_t k = 0; k < 3; ++k) {
            a[k] += scale * mass_a * c->normal[k];
            b[k] += c->a == c->b ? 0.0 : scale * mass_b * c->normal[k];
        }
        contacts->pushes[c->a] += scale * mass_a;
        contacts->pushes[c->b] += c->a == c->b ? 0.0 : scale * mass_b;
    }
}

// Takes the normal speed that the push gave, and tangential speed by friction, from one vertex.
static void brake(const pci_contacts *contacts, pci_cloth *cloth, const contact *c,
                  uint32_t vertex) {
    if (!(cloth->inverse_mass[vertex] > 0.0) || !(contacts->pushes[vertex] > 0.0)) {
        return;
    }
    const double *x = &cloth->positions[3 * (size_t)vertex];
    double *previous = &cloth->previous[3 * (size_t)vertex];
    double moved[3], along[3];
    for (size_t k = 0; k < 3; ++k) {
        moved[k] = x[k] - previous[k] - c->shift[k];
    }
    const double normal = pci_dot(moved, c->normal);
    for (size_t k = 0; k < 3; ++k) {
        along[k] = moved[k] - normal * c->normal[k];
    }
    const double length = pci_norm(along);
    const double kept =
        length > 0.0 ? fmin(1.0, contacts->friction * contacts->pushes[vertex] / length) : 0.0;
    // Velocities are positions minus `previous`: nothing but the speed changes here.
    for (size_t k = 0; k < 3; ++k) {
        previous[k] += kept * along[k] + fmax(normal, 0.0) * c->normal[k];
    }
}

void pci_contacts_finish(pci_contacts *contacts, pci_cloth *cloth) {
    // Pushing out of one plane may push into another, and limbs are curved.
    for (size_t round = 0; round < 2; ++round) {
        find_near(contacts, cloth, 1.1);
        pci_contacts_solve(contacts, cloth);
    }
    for (size_t i = 0; i < contacts->contact_count; ++i) {
        const contact *c = &contacts->contacts[i];
        brake(contacts, cloth, c, c->a);
        if (c->b != c->a) {
            brake(contacts, cloth, c, c->b);
        }
    }
}
