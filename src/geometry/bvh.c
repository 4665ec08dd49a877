#include "geometry/bvh.h"

#include <embree3/rtcore.h>
#include <float.h>

#include "core/context.h"
#include "geometry/bvh_tree.h"
#include "geometry/topology.h"

// A search on the mesh visits as many triangles as there are boxes that hold its point: a handful
// in a garment. Where it is thousands, searches for all vertices or triangles take minutes.
#define MOST_OVERLAP 1000.0

// A tree pays to be built with care when it is asked several times per triangle: as that of a small
// mesh is by a larger one, and the shared one by many stages, unless it is finer than they ask.
#define FEW_TRIANGLES 1000
#define MOST_SHARED   65536

enum { grain = 4096 };

static struct RTCBuildPrimitive bound_triangle(const pci_bvh *bvh, size_t triangle) {
    const double *a = pci_bvh_corner(bvh->mesh, triangle, 0);
    const double *b = pci_bvh_corner(bvh->mesh, triangle, 1);
    const double *c = pci_bvh_corner(bvh->mesh, triangle, 2);
    float lower[3], upper[3];
    for (size_t k = 0; k < 3; ++k) {
        const double low = a[k] < b[k] ? a[k] : b[k], high = a[k] < b[k] ? b[k] : a[k];
        const double least = c[k] < low ? c[k] : low, most = c[k] > high ? c[k] : high;
        lower[k] = (float)((least - bvh->centre[k]) * bvh->scale - PCI_PADDING);
        upper[k] = (float)((most - bvh->centre[k]) * bvh->scale + PCI_PADDING);
    }
    return (struct RTCBuildPrimitive){lower[0], lower[1], lower[2], 0,
                                      upper[0], upper[1], upper[2], (unsigned int)triangle};
}

// False: a coordinate is not finite.
static bool normalise_space(pci_bvh *bvh) {
    const pc_mesh *mesh = bvh->mesh;
    const double most = mesh->triangle_count > 0 ? HUGE_VAL : 0.0;
    double side = 0.0, low[3] = {most, most, most}, high[3] = {-most, -most, -most};
    for (size_t i = 0; i < 3 * mesh->triangle_count; ++i) {
        const double *at = &mesh->positions[3 * (size_t)mesh->triangles[i]];
        for (size_t k = 0; k < 3; ++k) {
            if (!isfinite(at[k])) {
                return false;
            }
            low[k] = at[k] < low[k] ? at[k] : low[k];
            high[k] = at[k] > high[k] ? at[k] : high[k];
        }
    }
    memcpy(bvh->minimum, low, sizeof(low));
    memcpy(bvh->maximum, high, sizeof(high));
    for (size_t k = 0; k < 3; ++k) {
        bvh->centre[k] = 0.5 * bvh->minimum[k] + 0.5 * bvh->maximum[k];
        side = fmax(side, bvh->maximum[k] - bvh->minimum[k]);
    }
    bvh->scale = side >= DBL_MIN ? 1.0 / side : 1.0;
    return true;
}

// In the order of the mesh: distances round differently in another one.
static void find_corners_of(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    pci_bvh *bvh = user;
    for (size_t l = begin; l < end; ++l) {
        pci_bvh_leaf *leaf = &bvh->tree.leaves[l];
        for (size_t i = 0; i < PCI_BVH_LEAF; ++i) {
            const bool real = leaf->triangles[i] != PC_INVALID_INDEX;
            const uint32_t t = leaf->triangles[real ? i : 0];
            for (size_t c = 0; c < 3; ++c) {
                leaf->corners[c][i] = bvh->mesh->triangles[3 * (size_t)t + c];
            }
        }
    }
}

static void find_corners(pc_context *context, pci_bvh *bvh) {
    bvh->tree.positions = bvh->mesh->positions;
    pci_parallel_for(context, bvh->tree.leaf_count, grain, find_corners_of, bvh);
}

typedef struct box_job {
    const pci_bvh *bvh;
    struct RTCBuildPrimitive *boxes;
} box_job;

static void bound_triangles(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const box_job *job = user;
    for (size_t t = begin; t < end; ++t) {
        job->boxes[t] = bound_triangle(job->bvh, t);
    }
}

// Builds the tree over all triangles but those that repeat an earlier one, over which it would be a
// list.
static pc_status grow(pc_context *context, const char *stage, pci_bvh *bvh) {
    const size_t triangle_count = bvh->mesh->triangle_count;
    pci_scratch scratch = pci_scratch_begin(context);
    uint8_t *repeated = PCI_SCRATCH(&scratch, uint8_t, triangle_count);
    struct RTCBuildPrimitive *boxes =
        pci_scratch_allocate_aligned(&scratch, triangle_count, sizeof(*boxes));
    pc_status status = PC_OK;
    if (!scratch.failed && pci_mark_duplicates(&scratch, bvh->mesh, repeated)) {
        size_t count = triangle_count;
        box_job job = {bvh, boxes};
        pci_parallel_for(context, triangle_count, grain, bound_triangles, &job);
        if (memchr(repeated, 1, triangle_count) != NULL) {
            count = 0;
            for (size_t t = 0; t < triangle_count; ++t) {
                boxes[count] = boxes[t];
                count += !repeated[t];
            }
        }
        bvh->repeats = count < triangle_count;
        const bool shared = bvh->mesh == context->shared_mesh;
        const bool careful = count <= (shared ? MOST_SHARED : FEW_TRIANGLES);
        status = pci_bvh_build(context, stage, &bvh->memory, boxes, count, careful, &bvh->tree);
    } else {
        status = pci_fail_memory(context, stage);
    }
    pci_scratch_end(&scratch);
    if (status == PC_OK) {
        find_corners(context, bvh);
    }
    return status;
}

static pc_status build_tree(pc_context *context, const char *stage, const pc_mesh *mesh,
                            pci_bvh **bvh) {
    if (mesh->triangle_count > PCI_BVH_MOST_TRIANGLES) {
        return pci_fail(context, PC_ERROR_TOO_LARGE, stage, "%s: %zu triangles are too many", stage,
                        mesh->triangle_count);
    }
    pci_bvh *created = PCI_ALLOCATE(context, pci_bvh, 1);
    if (created == NULL) {
        return pci_fail_memory(context, stage);
    }
    created->memory = pci_scratch_begin(context);
    created->mesh = mesh;
    created->kernel = pci_bvh_best_kernel();
    if (!normalise_space(created)) {
        pci_bvh_destroy(context, created);
        return pci_fail(context, PC_ERROR_NUMERICAL, stage,
                        "%s: a vertex position is infinite or not a number", stage);
    }
    const pc_status status = grow(context, stage, created);
    if (status != PC_OK) {
        pci_bvh_destroy(context, created);
        return status;
    }
    const double overlap = pci_bvh_overlap(created);
    if (overlap > MOST_OVERLAP) {
        pci_bvh_destroy(context, created);
        return pci_fail(context, PC_ERROR_TOO_LARGE, stage,
                        "%s: the boxes of %.0f triangles hold the same point, at most %.0f", stage,
                        overlap, MOST_OVERLAP);
    }
    *bvh = created;
    return PC_OK;
}

// Whether both meshes have the same triangles in the same order, though maybe under other vertex
// indices or facing the other way: what repairing a mesh leaves of one that needs none.
static bool same_triangles(const pc_mesh *a, const pc_mesh *b) {
    if (a->triangle_count != b->triangle_count) {
        return false;
    }
    bool same = true;
    for (size_t t = 0; t < a->triangle_count && same; ++t) {
        const double *p[3], *q[3];
        for (size_t c = 0; c < 3; ++c) {
            p[c] = pci_bvh_corner(a, t, c);
            q[c] = pci_bvh_corner(b, t, c);
        }
        const bool turned = pci_squared_distance(p[1], q[1]) != 0.0;
        same = pci_squared_distance(p[0], q[0]) == 0.0 &&
               pci_squared_distance(p[1], q[turned ? 2 : 1]) == 0.0 &&
               pci_squared_distance(p[2], q[turned ? 1 : 2]) == 0.0;
    }
    return same;
}

// The shared tree with leaves for a mesh with the same triangles.
static pc_status copy_shared(pc_context *context, const char *stage, const pc_mesh *mesh,
                             pci_bvh **bvh) {
    const pci_bvh *shared = context->shared_bvh;
    const size_t leaf_count = shared->tree.leaf_count;
    pci_bvh *copy = PCI_ALLOCATE(context, pci_bvh, 1);
    if (copy == NULL) {
        return pci_fail_memory(context, stage);
    }
    *copy = *shared;
    copy->mesh = mesh;
    copy->memory = pci_scratch_begin(context);
    pci_bvh_tree *tree = &copy->tree;
    tree->leaves = pci_scratch_allocate_aligned(&copy->memory, leaf_count, sizeof(*tree->leaves));
    if (copy->memory.failed) {
        pci_bvh_destroy(context, copy);
        return pci_fail_memory(context, stage);
    }
    if (leaf_count > 0) {
        memcpy(tree->leaves, shared->tree.leaves, leaf_count * sizeof(*tree->leaves));
    }
    find_corners(context, copy);
    *bvh = copy;
    return PC_OK;
}

pc_status pci_bvh_create(pc_context *context, const char *stage, const pc_mesh *mesh,
                         pci_bvh **bvh) {
    const pc_mesh *shared = context->shared_mesh;
    *bvh = NULL;
    if (shared == NULL || (mesh != shared && !same_triangles(mesh, shared))) {
        return build_tree(context, stage, mesh, bvh);
    }
    if (context->shared_bvh == NULL) {
        const pc_status status = build_tree(context, stage, shared, &context->shared_bvh);
        if (status != PC_OK) {
            return status;
        }
    }
    if (mesh == shared) {
        *bvh = context->shared_bvh;
        return PC_OK;
    }
    // Repetitions that are left out are some that the other mesh may keep apart.
    return context->shared_bvh->repeats ? build_tree(context, stage, mesh, bvh)
                                        : copy_shared(context, stage, mesh, bvh);
}

bool pci_bvh_shares(const pc_context *context) { return context->shared_mesh != NULL; }

void pci_bvh_share(pc_context *context, const pc_mesh *mesh) {
    pci_bvh *last = context->shared_bvh;
    context->shared_mesh = mesh;
    context->shared_bvh = NULL;
    pci_bvh_destroy(context, last);
}

void pci_bvh_destroy(pc_context *context, pci_bvh *bvh) {
    if (bvh == NULL || bvh == context->shared_bvh) {
        return;
    }
    bvh->memory.context = context; // it may come from a task, whose context is gone
    pci_scratch_end(&bvh->memory);
    pc_release(context, bvh);
}
