#include "stages/simplify/joint.h"

#include "core/heap.h"
#include "geometry/quadric.h"
#include "geometry/topology.h"
#include "proxycloth/baselines.h"
#include "proxycloth/simulate.h"
#include "proxycloth/skin.h"

enum { poses = 16, most_optimised = 2048 };

// Share of the vertices that is left when the weights are optimised again.
static const double round_share = 0.5;
// Cosine between a triangle before and after a collapse, below which it has turned over.
static const double least_turn = 0.2;

typedef struct decimation {
    pc_context *context;
    pci_scratch *scratch;
    const char *stage;
    const pc_mesh *visual;
    pci_topology visual_topology;
    pci_halfedge *mesh;
    size_t stride;         // vertices of the mesh at the start
    double *positions;     // #poses by stride by 3
    uint8_t *pinned;       // stride
    pci_quadric *quadrics; // #poses by stride
    uint32_t seed;
} decimation;

static double *posed(const decimation *d, size_t pose, size_t v) {
    return &d->positions[3 * (pose * d->stride + v)];
}

// ---- poses --------------------------------------------------------------------------------------

// The default motion in few frames.
static pc_status simulate(decimation *d) {
    pc_simulate_options options;
    pc_record_set_defaults(&pc_simulate_options_record, &options);
    options.frame_steps = options.frames * options.frame_steps / poses;
    options.frames = poses;
    options.seed = d->seed;
    const pc_mesh rest = pci_halfedge_view(d->mesh);
    pc_motion motion = {0};
    const pc_status status = pc_simulate(d->context, &rest, &options, &motion, NULL);
    if (status == PC_OK) {
        memcpy(d->positions, motion.positions, 3 * poses * d->stride * sizeof(*d->positions));
        memcpy(d->pinned, motion.pinned, d->stride);
    }
    pc_motion_free(d->context, &motion);
    return status;
}

// The live part of the mesh and of its motion; `kept` holds the old indices.
static pc_status export_live(const decimation *d, pc_mesh *proxy, pc_motion *motion,
                             uint32_t **kept) {
    if (!pci_halfedge_export(d->mesh, proxy, kept)) {
        return pci_fail_memory(d->context, d->stage);
    }
    const size_t n = proxy->vertex_count;
    *motion = (pc_motion){.frame_count = poses, .vertex_count = n, .frame_time = 1.0};
    motion->positions = PCI_ALLOCATE(d->context, double, 3 * poses * n);
    motion->pinned = PCI_ALLOCATE(d->context, uint8_t, n);
    if (motion->positions == NULL || motion->pinned == NULL) {
        return pci_fail_memory(d->context, d->stage);
    }
    for (size_t v = 0; v < n; ++v) {
        motion->pinned[v] = d->pinned[(*kept)[v]];
        for (size_t pose = 0; pose < poses; ++pose) {
            memcpy(&motion->positions[3 * (pose * n + v)], posed(d, pose, (*kept)[v]),
                   3 * sizeof(double));
        }
    }
    return PC_OK;
}

// ---- quadrics -----------------------------------------------------------------------------------

// Per vertex, the planes of its triangles, weighted by a third of their areas, and at the border
// planes across them, weighted by a third of the squared length.
static void sum_planes(const pc_mesh *mesh, const pci_topology *topology, pci_quadric *sums) {
    memset(sums, 0, mesh->vertex_count * sizeof(*sums));
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        const uint32_t *corner = &mesh->triangles[3 * t];
        const double *p = &mesh->positions[3 * (size_t)corner[0]];
        double normal[3];
        pci_normal_of(p, &mesh->positions[3 * (size_t)corner[1]],
                      &mesh->positions[3 * (size_t)corner[2]], normal);
        const double doubled = pci_norm(normal);
        if (!pci_normalize(normal)) {
            continue;
        }
        const pci_quadric plane = pci_quadric_of_plane(normal, p, doubled / 6.0);
        for (size_t c = 0; c < 3; ++c) {
            pci_quadric_add(&sums[corner[c]], &plane);
            const uint32_t e = topology->triangle_edges[3 * t + c];
            if (e == PC_INVALID_INDEX ||
                topology->edge_triangle_offsets[e + 1] - topology->edge_triangle_offsets[e] != 1) {
                continue;
            }
            const uint32_t ends[2] = {corner[c], corner[(c + 1) % 3]};
            double along[3], across[3];
            pci_sub(&mesh->positions[3 * (size_t)ends[1]], &mesh->positions[3 * (size_t)ends[0]],
                    along);
            pci_cross(along, normal, across);
            const double squared = pci_dot(along, along);
            if (!pci_normalize(across)) {
                continue;
            }
            const pci_quadric fence =
                pci_quadric_of_plane(across, &mesh->positions[3 * (size_t)ends[0]], squared / 3.0);
            pci_quadric_add(&sums[ends[0]], &fence);
            pci_quadric_add(&sums[ends[1]], &fence);
        }
    }
}

// E^{j,t} of section 5.2 for every live vertex j and pose t, as a function of where j is: the
// visual vertex i is at v_i + w_ij (x - v_j).
static pc_status sum_quadrics(decimation *d, const pc_mesh *proxy, const pc_motion *motion,
                              const uint32_t *kept, const pc_skin *skin) {
    pci_scratch scratch = pci_scratch_begin(d->context);
    const size_t visual_count = d->visual->vertex_count, n = proxy->vertex_count;
    double *skinned = PCI_SCRATCH(&scratch, double, 3 * visual_count);
    pci_quadric *visual_planes = PCI_SCRATCH(&scratch, pci_quadric, visual_count);
    pci_quadric *proxy_planes = PCI_SCRATCH(&scratch, pci_quadric, n);
    pci_topology topology;
    bool done = !scratch.failed && pci_topology_build(&scratch, proxy, &topology);
    for (size_t pose = 0; done && pose < poses; ++pose) {
        double *frame = &motion->positions[3 * pose * n];
        pc_skin_deform(skin, d->visual->positions, proxy->positions, frame, NULL, skinned);
        const pc_mesh visual = {visual_count, skinned, d->visual->triangle_count,
                                d->visual->triangles};
        const pc_mesh moved = {n, frame, proxy->triangle_count, proxy->triangles};
        sum_planes(&visual, &d->visual_topology, visual_planes);
        sum_planes(&moved, &topology, proxy_planes);
        for (size_t i = 0; i < visual_count; ++i) {
            for (size_t k = 0; k < skin->influences; ++k) {
                const double w = skin->weights[i * skin->influences + k];
                const size_t j = skin->bones[i * skin->influences + k];
                if (!(w > 0.0)) {
                    continue;
                }
                double offset[3];
                for (size_t c = 0; c < 3; ++c) {
                    offset[c] = skinned[3 * i + c] - w * frame[3 * j + c];
                }
                const pci_quadric q = pci_quadric_pulled_back(&visual_planes[i], w, offset);
                pci_quadric_add(&proxy_planes[j], &q);
            }
        }
        for (size_t v = 0; v < n; ++v) {
            d->quadrics[pose * d->stride + kept[v]] = proxy_planes[v];
        }
        done = pci_keep_going(d->context);
    }
    pci_scratch_end(&scratch);
    return done ? PC_OK : pci_fail_memory(d->context, d->stage);
}

static pc_status optimise(decimation *d) {
    pc_mesh proxy = {0};
    pc_motion motion = {0};
    pc_skin skin = {0};
    uint32_t *kept = NULL;
    pc_status status = export_live(d, &proxy, &motion, &kept);
    if (status == PC_OK && proxy.vertex_count > most_optimised) {
        status = pc_skin_closest_triangle(d->context, d->visual, &proxy, &skin);
    } else if (status == PC_OK) {
        status = pc_skin_optimize(d->context, d->visual, &proxy, &motion, NULL, &skin, NULL);
    }
    if (status == PC_OK) {
        status = sum_quadrics(d, &proxy, &motion, kept, &skin);
    }
    pc_skin_free(d->context, &skin);
    pc_motion_free(d->context, &motion);
    pc_mesh_free(d->context, &proxy);
    return status;
}

// ---- collapses ----------------------------------------------------------------------------------

// Energy of both ends in the middle of the edge, over all poses.
static double collapse_cost(const decimation *d, uint32_t h) {
    const size_t a = pci_origin(d->mesh, h), b = pci_target(d->mesh, h);
    double cost = 0.0;
    for (size_t pose = 0; pose < poses; ++pose) {
        const double *p = posed(d, pose, a), *q = posed(d, pose, b);
        const double middle[3] = {0.5 * (p[0] + q[0]), 0.5 * (p[1] + q[1]), 0.5 * (p[2] + q[2])};
        cost += pci_quadric_value(&d->quadrics[pose * d->stride + a], middle) +
                pci_quadric_value(&d->quadrics[pose * d->stride + b], middle);
    }
    return cost;
}

// Whether a triangle at v that does not hold `other` would turn over with v at `place`.
static bool turns_over(const decimation *d, uint32_t v, uint32_t other, const double place[3]) {
    const pci_halfedge *mesh = d->mesh;
    PCI_FOR_OUTGOING(mesh, v, h) {
        const uint32_t b = pci_target(mesh, h), c = mesh->corners[pci_previous(h)];
        if (b == other || c == other) {
            continue;
        }
        const double *p = &mesh->positions[3 * (size_t)b];
        double bc[3], old[3], new[3], before[3], after[3];
        pci_sub(&mesh->positions[3 * (size_t)c], p, bc);
        pci_sub(&mesh->positions[3 * (size_t)v], p, old);
        pci_sub(place, p, new);
        pci_cross(bc, old, before);
        pci_cross(bc, new, after);
        if (pci_dot(before, after) < least_turn * pci_norm(before) * pci_norm(after)) {
            return true;
        }
    }
    return false;
}

static void collapse(decimation *d, uint32_t h, const double middle[3]) {
    const size_t a = pci_origin(d->mesh, h), b = pci_target(d->mesh, h);
    pci_collapse(d->mesh, h);
    memcpy(&d->mesh->positions[3 * b], middle, 3 * sizeof(*middle));
    d->pinned[b] = d->pinned[a] && d->pinned[b];
    for (size_t pose = 0; pose < poses; ++pose) {
        pci_quadric_add(&d->quadrics[pose * d->stride + b], &d->quadrics[pose * d->stride + a]);
        for (size_t k = 0; k < 3; ++k) {
            posed(d, pose, b)[k] = 0.5 * (posed(d, pose, a)[k] + posed(d, pose, b)[k]);
        }
    }
}

static bool push_around(const decimation *d, pci_heap *cheapest, uint32_t v) {
    PCI_FOR_OUTGOING(d->mesh, v, i) {
        const uint32_t pair[2] = {i, pci_previous(i)};
        for (size_t s = 0; s < 2; ++s) {
            const uint32_t twin = d->mesh->twins[pair[s]];
            const uint32_t edge = twin < pair[s] ? twin : pair[s];
            if (!pci_heap_push(d->scratch, cheapest, collapse_cost(d, edge), edge)) {
                return false;
            }
        }
    }
    return true;
}

// One pass over the edges, the cheapest first, until `vertices` are left. False: out of memory or
// cancelled.
static bool collapse_edges(decimation *d, size_t vertices, bool turning, size_t *merged) {
    pci_heap cheapest = {0};
    *merged = 0;
    for (uint32_t h = 0; h < 3 * d->mesh->triangle_count; ++h) {
        if (pci_is_edge(d->mesh, h) &&
            !pci_heap_push(d->scratch, &cheapest, collapse_cost(d, h), h)) {
            return false;
        }
    }
    pci_heap_entry entry;
    while (d->mesh->live_vertices > vertices && pci_heap_pop(&cheapest, &entry)) {
        const uint32_t h = entry.item;
        if (!pci_is_edge(d->mesh, h) || collapse_cost(d, h) != entry.key ||
            !pci_can_collapse(d->mesh, h)) {
            continue;
        }
        const uint32_t a = pci_origin(d->mesh, h), b = pci_target(d->mesh, h);
        const double *p = &d->mesh->positions[3 * (size_t)a];
        const double *q = &d->mesh->positions[3 * (size_t)b];
        const double middle[3] = {0.5 * (p[0] + q[0]), 0.5 * (p[1] + q[1]), 0.5 * (p[2] + q[2])};
        if (!turning && (turns_over(d, a, b, middle) || turns_over(d, b, a, middle))) {
            continue;
        }
        collapse(d, h, middle);
        ++*merged;
        if (!push_around(d, &cheapest, b) || !pci_keep_going(d->context)) {
            return false;
        }
    }
    return true;
}

static bool collapse_to(decimation *d, size_t vertices) {
    bool turning = false;
    while (d->mesh->live_vertices > vertices) {
        size_t merged = 0;
        if (!collapse_edges(d, vertices, turning, &merged)) {
            return false;
        }
        if (merged == 0 && turning) {
            break; // the topology does not allow more
        }
        turning = merged == 0;
    }
    return true;
}

pc_status pci_joint_decimate(pc_context *context, const char *stage, const pc_mesh *visual,
                             size_t vertices, uint32_t seed, pci_halfedge *mesh) {
    pci_scratch scratch = pci_scratch_begin(context);
    const size_t n = mesh->vertex_count;
    decimation d = {.context = context,
                    .scratch = &scratch,
                    .stage = stage,
                    .visual = visual,
                    .mesh = mesh,
                    .stride = n,
                    .seed = seed};
    d.positions = PCI_SCRATCH(&scratch, double, 3 * poses * n);
    d.quadrics = PCI_SCRATCH(&scratch, pci_quadric, poses * n);
    d.pinned = PCI_SCRATCH(&scratch, uint8_t, n);
    pc_status status = PC_OK;
    if (scratch.failed || !pci_topology_build(&scratch, visual, &d.visual_topology)) {
        status = pci_fail_memory(context, stage);
    } else {
        status = simulate(&d);
    }
    bool possible = true;
    while (status == PC_OK && mesh->live_vertices > vertices && possible) {
        const size_t before = mesh->live_vertices;
        const size_t share = (size_t)(round_share * (double)before);
        status = optimise(&d);
        if (status == PC_OK && !collapse_to(&d, share > vertices ? share : vertices)) {
            status = pci_fail_memory(context, stage);
        }
        possible = mesh->live_vertices < before;
    }
    pci_scratch_end(&scratch);
    return status;
}
