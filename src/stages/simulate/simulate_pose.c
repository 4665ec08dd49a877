// Rigid motions, and the joints that pinned vertices follow.
#include "geometry/bvh.h"
#include "geometry/transfer.h"
#include "stages/simulate/simulate_internal.h"

static const char stage[] = "simulate";

// ---- rigid motion ------------------------------------------------------------------------------

static void rigid_map(const double translation[3], const double q[4], const double pivot[3],
                      double scale, pci_map *map) {
    const double x = q[0], y = q[1], z = q[2], w = q[3];
    const double rotation[9] = {
        1 - 2 * (y * y + z * z), 2 * (x * y - z * w),     2 * (x * z + y * w),
        2 * (x * y + z * w),     1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
        2 * (x * z - y * w),     2 * (y * z + x * w),     1 - 2 * (x * x + y * y)};
    for (size_t row = 0; row < 3; ++row) {
        memcpy(&map->m[4 * row], &rotation[3 * row], 3 * sizeof(double));
        map->m[4 * row + 3] =
            scale * (pivot[row] + translation[row] - pci_dot(&rotation[3 * row], pivot));
    }
}

static void unit_quaternion(const double given[4], double q[4]) {
    const double length =
        sqrt(given[0] * given[0] + given[1] * given[1] + given[2] * given[2] + given[3] * given[3]);
    for (size_t k = 0; k < 4; ++k) {
        q[k] = given[k] / length;
    }
}

void pci_rigid_at(const pc_attachment *attachment, double scale, double time, pci_map *map) {
    size_t next = 0;
    while (next < attachment->key_count && attachment->keys[next].time <= time) {
        ++next;
    }
    const pc_rigid_key *a = &attachment->keys[next > 0 ? next - 1 : 0];
    const pc_rigid_key *b =
        &attachment->keys[next < attachment->key_count ? next : attachment->key_count - 1];
    const double share = b->time > a->time ? (time - a->time) / (b->time - a->time) : 0.0;
    double translation[3], p[4], q[4], mixed[4];
    unit_quaternion(a->rotation, p);
    unit_quaternion(b->rotation, q);
    const double cosine = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3];
    // Slerp on the shorter arc; nearly equal quaternions are mixed.
    const double angle = acos(fmin(fabs(cosine), 1.0));
    const double sine = sin(angle), sign = cosine < 0.0 ? -1.0 : 1.0;
    const double wp = sine > 1e-6 ? sin((1.0 - share) * angle) / sine : 1.0 - share;
    const double wq = sign * (sine > 1e-6 ? sin(share * angle) / sine : share);
    for (size_t k = 0; k < 4; ++k) {
        mixed[k] = wp * p[k] + wq * q[k];
    }
    unit_quaternion(mixed, mixed);
    for (size_t k = 0; k < 3; ++k) {
        translation[k] = a->translation[k] + share * (b->translation[k] - a->translation[k]);
    }
    rigid_map(translation, mixed, attachment->pivot, scale, map);
}

// ---- joints of pinned vertices -----------------------------------------------------------------

// Weights at a point: those of the corners of its triangle, mixed; of the joints found, the four
// with the largest weights.
static void weights_at(const pc_visual *visual, const pci_closest *closest, uint32_t *joints,
                       double *weights) {
    uint32_t found[12];
    double sums[12];
    size_t count = 0;
    for (size_t c = 0; c < 3; ++c) {
        const size_t row = visual->corner_triangles[3 * (size_t)closest->triangle + c];
        for (size_t k = 4 * row; k < 4 * row + 4; ++k) {
            const double weight = closest->barycentric[c] * (double)visual->joint_weights[k];
            size_t i = 0;
            while (i < count && found[i] != visual->joints[k]) {
                ++i;
            }
            if (i == count) {
                found[count] = visual->joints[k];
                sums[count++] = 0.0;
            }
            sums[i] += weight;
        }
    }
    pci_largest_weights(found, sums, count, joints, weights);
}

static bool any_weight(const float *weights, size_t count) {
    for (size_t i = 0; weights != NULL && i < count; ++i) {
        if (weights[i] > 0.0F) {
            return true;
        }
    }
    return false;
}

pc_status pci_bind_pins(pci_scratch *scratch, const pc_simulate_inputs *inputs,
                        const uint8_t *pinned, pci_binding *binding) {
    const pc_visual *visual = inputs->visual;
    const pc_character *character = inputs->character;
    const bool own = visual != NULL && any_weight(visual->joint_weights, 4 * visual->corner_count);
    if (!own && (character == NULL || !pci_body_is_skinned(character))) {
        return pci_fail(scratch->context, PC_ERROR_INVALID_OPTIONS, stage,
                        "simulate: attachment: neither the garment nor the body follows the "
                        "skeleton of the input");
    }
    const size_t nv = inputs->proxy->vertex_count;
    binding->joints = PCI_SCRATCH(scratch, uint32_t, 4 * nv);
    binding->weights = PCI_SCRATCH(scratch, double, 4 * nv);
    if (scratch->failed) {
        return pci_fail_memory(scratch->context, stage);
    }
    if (!own) {
        pci_transfer_counts counts;
        return pci_transfer_weights(scratch->context, stage, inputs->proxy, character,
                                    binding->joints, binding->weights, &counts);
    }
    pci_bvh *bvh = NULL;
    const pc_status status = pci_bvh_create(scratch->context, stage, &visual->surface, &bvh);
    for (size_t v = 0; v < nv && status == PC_OK; ++v) {
        if (pinned[v]) {
            const pci_closest closest =
                pci_bvh_closest(bvh, &inputs->proxy->positions[3 * v], INFINITY);
            weights_at(visual, &closest, &binding->joints[4 * v], &binding->weights[4 * v]);
        }
    }
    pci_bvh_destroy(scratch->context, bvh);
    for (size_t i = 0; i < 4 * nv && status == PC_OK; ++i) {
        if (binding->joints[i] >= character->joint_count) {
            return pci_fail(scratch->context, PC_ERROR_INVALID_ARGUMENT, stage,
                            "simulate: a weight refers to joint %u of %zu", binding->joints[i],
                            character->joint_count);
        }
    }
    return status;
}

void pci_binding_apply(const pci_binding *binding, const pci_map *maps, size_t vertex,
                       const double rest[3], double out[3]) {
    double moved[3] = {0.0, 0.0, 0.0}, total = 0.0;
    for (size_t k = 4 * vertex; k < 4 * vertex + 4; ++k) {
        double at[3];
        pci_map_apply(&maps[binding->joints[k]], rest, at);
        total += binding->weights[k];
        for (size_t i = 0; i < 3; ++i) {
            moved[i] += binding->weights[k] * at[i];
        }
    }
    // A vertex without weights stays.
    memcpy(out, total > 0.0 ? moved : rest, sizeof(moved));
}
