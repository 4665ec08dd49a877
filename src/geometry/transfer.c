// Where a vertex finds a near point of the body that faces the same way, it takes the weights
// there. The others are filled in from those: in each island of the garment, harmonic functions
// with edges weighted by their inverse length. They are convex combinations of the known weights,
// so they need no repair; and nothing leaks from one island to the next.
#include "geometry/transfer.h"

#include "core/union_find.h"
#include "geometry/bvh.h"
#include "geometry/topology.h"
#include "solvers/sparse.h"

static const double match_distance = 0.05;        // of the garment's diagonal
static const double match_cosine = 0.70710678118; // 45 degrees

typedef struct transfer {
    pc_context *context;
    const char *stage;
    pci_scratch scratch;
    const pc_mesh *mesh;
    const pc_character *character;
    pci_topology topology;
    uint32_t *islands;    // #V, union-find
    pci_closest *closest; // #V
    uint8_t *known;       // #V
    uint32_t *columns;    // #J, column of a joint in `shares`, or invalid
    uint32_t *column_joint;
    size_t column_count;
    double *shares; // #V by column_count
} transfer;

bool pci_body_is_skinned(const pc_character *character) {
    const size_t count = character->body_weights != NULL ? 4 * character->body.vertex_count : 0;
    for (size_t i = 0; i < count; ++i) {
        if (character->body_weights[i] > 0.0F) {
            return character->body.triangle_count != 0;
        }
    }
    return false;
}

void pci_largest_weights(const uint32_t *found, double *sums, size_t count, uint32_t joints[4],
                         double weights[4]) {
    double total = 0.0;
    for (size_t k = 0; k < 4; ++k) {
        size_t best = 0;
        for (size_t i = 1; i < count; ++i) {
            best = sums[i] > sums[best] ? i : best;
        }
        joints[k] = found[best];
        weights[k] = fmax(sums[best], 0.0);
        total += weights[k];
        sums[best] = -1.0;
    }
    for (size_t k = 0; k < 4; ++k) {
        weights[k] = total > 0.0 ? weights[k] / total : 0.0;
    }
}

typedef struct closest_job {
    transfer *t;
    const pci_bvh *bvh;
    const double *normals;
    double reach;
} closest_job;

static void find_closest(void *user, size_t begin, size_t end, uint32_t worker) {
    const closest_job *job = user;
    (void)worker;
    transfer *t = job->t;
    const pc_mesh *body = &t->character->body;
    for (size_t v = begin; v < end; ++v) {
        t->closest[v] = pci_bvh_closest(job->bvh, &t->mesh->positions[3 * v], INFINITY);
        const uint32_t *corner = &body->triangles[3 * (size_t)t->closest[v].triangle];
        double along[3], across[3], normal[3];
        pci_sub(&body->positions[3 * (size_t)corner[1]], &body->positions[3 * (size_t)corner[0]],
                along);
        pci_sub(&body->positions[3 * (size_t)corner[2]], &body->positions[3 * (size_t)corner[0]],
                across);
        pci_cross(along, across, normal);
        // Inner sides of cloth face the body.
        t->known[v] = t->closest[v].distance <= job->reach && pci_normalize(normal) &&
                      fabs(pci_dot(normal, &job->normals[3 * v])) >= match_cosine;
    }
}

static pc_status match(transfer *t) {
    const size_t nv = t->mesh->vertex_count;
    double *normals = PCI_SCRATCH(&t->scratch, double, 3 * nv);
    t->closest = PCI_SCRATCH(&t->scratch, pci_closest, nv);
    t->known = PCI_SCRATCH(&t->scratch, uint8_t, nv);
    t->islands = PCI_SCRATCH(&t->scratch, uint32_t, nv);
    if (t->scratch.failed || !pci_topology_build(&t->scratch, t->mesh, &t->topology)) {
        return pci_fail_memory(t->context, t->stage);
    }
    pci_vertex_normals(t->mesh, normals);
    pci_vertex_components(t->mesh, t->islands);
    pci_bvh *bvh = NULL;
    const pc_status status = pci_bvh_create(t->context, t->stage, &t->character->body, &bvh);
    if (status == PC_OK) {
        closest_job job = {t, bvh, normals, match_distance * pci_diagonal(t->mesh)};
        pci_parallel_for(t->context, nv, 256, find_closest, &job);
    }
    pci_bvh_destroy(t->context, bvh);
    return status;
}

// An island that matches nowhere is a stiff piece, such as a button: all of it follows the point of
// the body that is nearest to any of its vertices.
static pc_status stiffen_islands(transfer *t, uint64_t *rigid) {
    const size_t nv = t->mesh->vertex_count;
    uint32_t *nearest = PCI_SCRATCH(&t->scratch, uint32_t, nv); // vertex + 1; of a root
    uint8_t *matched = PCI_SCRATCH(&t->scratch, uint8_t, nv);   // of a root
    if (t->scratch.failed) {
        return pci_fail_memory(t->context, t->stage);
    }
    for (uint32_t v = 0; v < nv; ++v) {
        const uint32_t root = pci_find_root(t->islands, v);
        matched[root] |= t->known[v];
        if (nearest[root] == 0 || t->closest[v].distance < t->closest[nearest[root] - 1].distance) {
            nearest[root] = v + 1;
        }
    }
    for (uint32_t v = 0; v < nv; ++v) {
        const uint32_t root = pci_find_root(t->islands, v);
        if (!matched[root]) {
            t->closest[v] = t->closest[nearest[root] - 1];
            t->known[v] = 1;
            ++*rigid;
        }
    }
    return PC_OK;
}

// Fills the rows of known vertices.
static pc_status read_known(transfer *t) {
    const pc_character *c = t->character;
    const size_t nv = t->mesh->vertex_count;
    t->columns = PCI_SCRATCH(&t->scratch, uint32_t, c->joint_count + 1);
    t->column_joint = PCI_SCRATCH(&t->scratch, uint32_t, c->joint_count + 1);
    if (t->scratch.failed) {
        return pci_fail_memory(t->context, t->stage);
    }
    for (int pass = 0; pass < 2; ++pass) {
        for (size_t i = 0; i < 12 * nv; ++i) {
            const pci_closest *at = &t->closest[i / 12];
            const size_t corner = c->body.triangles[3 * (size_t)at->triangle + i % 12 / 4];
            const size_t slot = 4 * corner + i % 4;
            const uint32_t joint = c->body_joints[slot];
            if (!t->known[i / 12] || !(c->body_weights[slot] > 0.0F)) {
                continue;
            }
            if (pass == 1) {
                t->shares[i / 12 * t->column_count + t->columns[joint] - 1] +=
                    at->barycentric[i % 12 / 4] * (double)c->body_weights[slot];
            } else if (t->columns[joint] == 0) {
                t->column_joint[t->column_count] = joint;
                t->columns[joint] = (uint32_t)++t->column_count;
            }
        }
        if (pass == 0) {
            t->shares = PCI_SCRATCH(&t->scratch, double, nv *(t->column_count + 1));
            if (t->scratch.failed) {
                return pci_fail_memory(t->context, t->stage);
            }
        }
    }
    return PC_OK;
}

// Rows of the Laplacian for the unknown vertices; the right sides are what the known ones give.
static pc_status fill_unknown(transfer *t, size_t unknown_count, const uint32_t *unknowns,
                              const uint32_t *numbers) {
    const size_t columns = t->column_count;
    const pci_topology *topology = &t->topology;
    size_t entries = unknown_count;
    for (size_t u = 0; u < unknown_count; ++u) {
        const size_t v = unknowns[u];
        entries += topology->ring_offsets[v + 1] - topology->ring_offsets[v];
    }
    size_t *offsets = PCI_SCRATCH(&t->scratch, size_t, unknown_count + 1);
    uint32_t *rows = PCI_SCRATCH(&t->scratch, uint32_t, entries);
    double *values = PCI_SCRATCH(&t->scratch, double, entries);
    double *sides = PCI_SCRATCH(&t->scratch, double, unknown_count *columns);
    if (t->scratch.failed) {
        return pci_fail_memory(t->context, t->stage);
    }
    size_t used = 0;
    for (size_t u = 0; u < unknown_count; ++u) {
        const size_t v = unknowns[u];
        double diagonal = 0.0;
        size_t own = SIZE_MAX;
        for (size_t i = topology->ring_offsets[v]; i < topology->ring_offsets[v + 1]; ++i) {
            const size_t w = topology->ring[i];
            const double weight = 1.0 / sqrt(pci_squared_distance(&t->mesh->positions[3 * v],
                                                                  &t->mesh->positions[3 * w]));
            diagonal += weight;
            if (w > v && own == SIZE_MAX) {
                own = used++;
            }
            if (!t->known[w]) {
                rows[used] = numbers[w];
                values[used++] = -weight;
                continue;
            }
            for (size_t k = 0; k < columns; ++k) {
                sides[u * columns + k] += weight * t->shares[w * columns + k];
            }
        }
        own = own == SIZE_MAX ? used++ : own;
        rows[own] = (uint32_t)u;
        values[own] = diagonal;
        offsets[u + 1] = used;
    }
    pci_cholesky *cholesky = NULL;
    pc_status status =
        pci_cholesky_create(t->context, t->stage, unknown_count, offsets, rows, values, &cholesky);
    if (status == PC_OK) {
        status = pci_cholesky_solve(t->context, cholesky, columns, sides, sides);
    }
    for (size_t i = 0; i < unknown_count * columns && status == PC_OK; ++i) {
        t->shares[unknowns[i / columns] * columns + i % columns] = sides[i];
    }
    pci_cholesky_destroy(t->context, cholesky);
    return status;
}

static pc_status fill(transfer *t, uint64_t *filled) {
    const size_t nv = t->mesh->vertex_count;
    uint32_t *unknowns = PCI_SCRATCH(&t->scratch, uint32_t, nv);
    uint32_t *numbers = PCI_SCRATCH(&t->scratch, uint32_t, nv);
    if (t->scratch.failed) {
        return pci_fail_memory(t->context, t->stage);
    }
    size_t count = 0;
    for (uint32_t v = 0; v < nv; ++v) {
        if (!t->known[v]) {
            numbers[v] = (uint32_t)count;
            unknowns[count++] = v;
        }
    }
    *filled = count;
    return count != 0 && t->column_count != 0 ? fill_unknown(t, count, unknowns, numbers) : PC_OK;
}

pc_status pci_transfer_weights(pc_context *context, const char *stage, const pc_mesh *mesh,
                               const pc_character *character, uint32_t *joints, double *weights,
                               pci_transfer_counts *counts) {
    transfer t = {.context = context,
                  .stage = stage,
                  .scratch = pci_scratch_begin(context),
                  .mesh = mesh,
                  .character = character};
    memset(counts, 0, sizeof(*counts));
    pc_status status = match(&t);
    if (status == PC_OK) {
        status = stiffen_islands(&t, &counts->rigid);
    }
    if (status == PC_OK) {
        status = read_known(&t);
    }
    if (status == PC_OK) {
        status = fill(&t, &counts->filled);
    }
    counts->matched = mesh->vertex_count - counts->filled - counts->rigid;
    for (size_t v = 0; v < mesh->vertex_count && status == PC_OK && t.column_count != 0; ++v) {
        pci_largest_weights(t.column_joint, &t.shares[v * t.column_count], t.column_count,
                            &joints[4 * v], &weights[4 * v]);
    }
    pci_scratch_end(&t.scratch);
    return status;
}

// Moves the largest K of the K + 4 weights of a vertex, which are spoilt, to `bones` and `weights`.
static void keep_largest(const uint32_t *found, double *mixed, size_t influences, uint32_t *bones,
                         double *weights) {
    double sum = 0.0;
    for (size_t k = 0; k < influences; ++k) {
        size_t most = 0;
        for (size_t i = 1; i < influences + 4; ++i) {
            most = mixed[i] > mixed[most] ? i : most;
        }
        bones[k] = found[most];
        weights[k] = mixed[most];
        sum += mixed[most];
        mixed[most] = 0.0;
    }
    for (size_t k = 0; k < influences; ++k) {
        weights[k] /= sum;
    }
}

bool pci_mix_weights(pci_scratch *scratch, const pc_body_skin *body, size_t first, pc_skin *skin) {
    const size_t k_in = skin->influences;
    if (body->vertex_count == 0) {
        return true;
    }
    uint32_t *bones = PCI_SCRATCH(scratch, uint32_t, skin->vertex_count * k_in);
    double *weights = PCI_SCRATCH(scratch, double, skin->vertex_count *k_in);
    uint32_t *found = PCI_SCRATCH(scratch, uint32_t, k_in + 4);
    double *mixed = PCI_SCRATCH(scratch, double, k_in + 4);
    if (scratch->failed) {
        return false;
    }
    for (size_t v = 0; v < skin->vertex_count; ++v) {
        const double share = body->shares[v];
        for (size_t k = 0; k < k_in; ++k) {
            found[k] = skin->bones[v * k_in + k];
            mixed[k] = share * skin->weights[v * k_in + k];
        }
        for (size_t k = 0; k < 4; ++k) {
            found[k_in + k] = (uint32_t)first + body->joints[4 * v + k];
            mixed[k_in + k] = (1.0 - share) * body->weights[4 * v + k];
        }
        keep_largest(found, mixed, k_in, &bones[v * k_in], &weights[v * k_in]);
    }
    skin->bones = bones;
    skin->weights = weights;
    return true;
}
