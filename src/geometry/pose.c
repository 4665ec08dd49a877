#include "geometry/pose.h"

static const pci_map identity = {{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}};

void pci_map_apply(const pci_map *map, const double point[3], double out[3]) {
    const double *m = map->m;
    const double x = point[0], y = point[1], z = point[2];
    for (size_t k = 0; k < 3; ++k) {
        out[k] = m[4 * k] * x + m[4 * k + 1] * y + m[4 * k + 2] * z + m[4 * k + 3];
    }
}

bool pci_map_invert(const pci_map *map, pci_map *out) {
    const double *m = map->m;
    const double *rows[3] = {m, m + 4, m + 8};
    double cofactors[3][3];
    for (size_t k = 0; k < 3; ++k) {
        pci_cross(rows[(k + 1) % 3], rows[(k + 2) % 3], cofactors[k]);
    }
    const double determinant = pci_dot(rows[0], cofactors[0]);
    const double size = pci_norm(rows[0]) * pci_norm(rows[1]) * pci_norm(rows[2]);
    if (!(fabs(determinant) > 1e-9 * size)) {
        return false;
    }
    for (size_t row = 0; row < 3; ++row) {
        double moved = 0.0;
        for (size_t k = 0; k < 3; ++k) {
            out->m[4 * row + k] = cofactors[k][row] / determinant;
            moved -= out->m[4 * row + k] * m[4 * k + 3];
        }
        out->m[4 * row + 3] = moved;
    }
    return true;
}

// Between two maps: the linear part is mixed and, where both are rotations with a uniform scale,
// made one again; `center` travels on a straight line.
static void mix_maps(const pci_map *a, const pci_map *b, double share, const double center[3],
                     pci_map *out) {
    double at_a[3], at_b[3], lengths[2] = {1.0, 1.0};
    const pci_map *ends[2] = {a, b};
    bool turns = true;
    for (size_t i = 0; i < 2; ++i) {
        const double *m = ends[i]->m;
        lengths[i] = pci_norm(m);
        double third[3];
        pci_cross(m, m + 4, third);
        // The third row must be what two orthogonal rows of one length make it.
        for (size_t k = 0; k < 3; ++k) {
            turns =
                turns && fabs(third[k] - lengths[i] * m[8 + k]) <= 1e-3 * lengths[i] * lengths[i];
        }
    }
    pci_map mixed;
    for (size_t k = 0; k < 12; ++k) {
        mixed.m[k] = a->m[k] + share * (b->m[k] - a->m[k]);
    }
    double x[3] = {mixed.m[0], mixed.m[1], mixed.m[2]}, y[3], z[3];
    const double along = pci_dot(x, &mixed.m[4]) / pci_dot(x, x);
    for (size_t k = 0; k < 3; ++k) {
        y[k] = mixed.m[4 + k] - along * x[k];
    }
    pci_cross(x, y, z);
    if (turns && pci_normalize(x) && pci_normalize(y) && pci_normalize(z)) {
        const double length = lengths[0] + share * (lengths[1] - lengths[0]);
        for (size_t k = 0; k < 3; ++k) {
            mixed.m[k] = length * x[k];
            mixed.m[4 + k] = length * y[k];
            mixed.m[8 + k] = length * z[k];
        }
    }
    // Translate so that the centre is where it belongs.
    double now[3];
    pci_map_apply(a, center, at_a);
    pci_map_apply(b, center, at_b);
    pci_map_apply(&mixed, center, now);
    for (size_t k = 0; k < 3; ++k) {
        mixed.m[4 * k + 3] += at_a[k] + share * (at_b[k] - at_a[k]) - now[k];
    }
    *out = mixed;
}

pc_status pci_poses_begin(pci_scratch *scratch, const char *stage, const pc_character *character,
                          const pc_attachment *attachment, double scale, pci_poses *poses) {
    static const pc_character nobody;
    character = character != NULL ? character : &nobody;
    memset(poses, 0, sizeof(*poses));
    poses->character = character;
    poses->attachment = attachment;
    poses->scale = scale;
    poses->maps = PCI_SCRATCH(scratch, pci_map, character->joint_count);
    if (poses->maps == NULL) {
        return pci_fail_memory(scratch->context, stage);
    }
    for (size_t j = 0; j < character->joint_count; ++j) {
        poses->maps[j] = identity;
    }
    if (attachment->kind != PC_ATTACHMENT_CLIP) {
        return PC_OK;
    }
    for (size_t i = 0; i < character->clip_count; ++i) {
        if (strcmp(&character->clip_names[PC_NAME_SIZE * i], attachment->clip) == 0) {
            poses->first_pose = character->clip_poses[2 * i];
            poses->pose_count = character->clip_poses[2 * i + 1];
            poses->rate = character->clip_rates[i];
            return PC_OK;
        }
    }
    char known[256] = "";
    size_t length = 0;
    for (size_t i = 0; i < character->clip_count && length + 80 < sizeof(known); ++i) {
        const char *name = &character->clip_names[PC_NAME_SIZE * i];
        memcpy(known + length, length != 0 ? ", " : "", length != 0 ? 2 : 0);
        length += length != 0 ? 2 : 0;
        memcpy(known + length, name, strlen(name));
        length += strlen(name);
    }
    return pci_fail(scratch->context, PC_ERROR_INVALID_OPTIONS, stage,
                    "%s: attachment: the input has no clip \"%s\"%s%s", stage, attachment->clip,
                    length != 0 ? "; it has " : "", known);
}

static void load_pose(const pci_poses *poses, size_t pose, size_t joint, pci_map *map) {
    const size_t at = 12 * (pose * poses->character->joint_count + joint);
    for (size_t k = 0; k < 12; ++k) {
        const double value = (double)poses->character->poses[at + k];
        map->m[k] = k % 4 == 3 ? poses->scale * value : value;
    }
}

void pci_poses_set(pci_poses *poses, double time) {
    if (poses->pose_count == 0) {
        return;
    }
    const pc_attachment *attachment = poses->attachment;
    const double last = (double)(poses->pose_count - 1);
    double at = (attachment->start + fmax(time, 0.0)) * poses->rate;
    if (attachment->loop && last > 0.0) {
        at = fmod(at, last);
    }
    at = fmin(at, last);
    const size_t before = (size_t)floor(at);
    const size_t after = before + 1 < poses->pose_count ? before + 1 : before;
    const double share = at - (double)before;
    // Eased at both ends, so that nothing jerks.
    double blend =
        attachment->blend > 0.0 ? fmax(0.0, 1.0 + fmin(time, 0.0) / attachment->blend) : 1.0;
    blend = blend * blend * (3.0 - 2.0 * blend);
    for (size_t j = 0; j < poses->character->joint_count; ++j) {
        double center[3];
        for (size_t k = 0; k < 3; ++k) {
            center[k] = poses->scale * poses->character->joint_centers[3 * j + k];
        }
        pci_map a, b;
        load_pose(poses, poses->first_pose + before, j, &a);
        load_pose(poses, poses->first_pose + after, j, &b);
        mix_maps(&a, &b, share, center, &poses->maps[j]);
        if (blend < 1.0) {
            mix_maps(&identity, &poses->maps[j], blend, center, &poses->maps[j]);
        }
    }
}
