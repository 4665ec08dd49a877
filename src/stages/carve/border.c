#include "stages/carve/border.h"

#include "geometry/hems.h"
#include "geometry/topology.h"

// How far a hem may be from the border, in voxels: the iso-surface and the label cut each add up to
// one half, and the cut follows the voxels.
static const double snap_reach = 1.5;
// A vertex that was cut off is so far from the surface, in distances of the cut, which membranes
// end at half of.
static const double least_beside = 0.25;
// Rings of vertices that follow the border, and that tell which way the cloth goes.
enum { following_rings = 4, inward_rings = 3 };
// Passes of evening out along the hem, and of spreading the moves to the rings.
static const size_t even_passes = 4, spread_passes = 12;
enum { most_pieces = 64 };
// Cosine between the ways into the cloth on the two sides of a strap.
static const double opposite_cosine = -0.3;
// Share of its area, seen along its old normal, that a triangle keeps; moves that would leave less
// are halved up to so many times, then given up.
static const double least_kept = 0.15;
static const size_t retreats = 5;
// Of a point on a hem, in reaches.
static const double rounding = 1e-6;

typedef struct snapping {
    pc_mesh *layer;
    const pci_bvh *surface;
    double reach;
    double cut;
    pci_topology topology;
    size_t loop_count, *offsets;
    uint32_t *loops;
    pci_hems hems;
    pci_bvh *hem_bvh;
    pc_mesh hem_mesh;
    double *inwards;      // per border vertex, 3: unit vector into the cloth
    double *edge_inwards; // the same, as its border edges see it
    double *moves;        // per vertex, 3
    double *placed;       // per vertex, 3: the new positions
    uint8_t *border, *strap, *snapped, *unplaced;
    uint8_t *rings; // per vertex: 1 + rings behind the snapped border; 0: farther
} snapping;

static double *point_of(const snapping *s, uint32_t v) {
    return &s->layer->positions[3 * (size_t)v];
}

// The nearest point of the hems of cloth that lies on the same side. False: none within reach.
static bool nearest_hem(const snapping *s, const double point[3], const double inward[3],
                        double reach, double nearest[3]) {
    uint32_t pieces[most_pieces];
    const size_t found = pci_bvh_collect(s->hem_bvh, point, reach, most_pieces, pieces);
    double best = INFINITY;
    uint32_t chosen = PC_INVALID_INDEX;
    for (size_t i = 0; i < found && i < most_pieces; ++i) {
        const double *a = &s->hems.points[6 * (size_t)pieces[i]], *b = a + 3;
        double bary[3];
        if (pci_dot(inward, &s->hems.inwards[3 * (size_t)pieces[i]]) <= 0.0) {
            continue;
        }
        const double distance = pci_triangle_squared_distance(point, a, b, b, bary);
        if (distance < best || (distance == best && pieces[i] < chosen)) {
            best = distance;
            chosen = pieces[i];
            for (size_t k = 0; k < 3; ++k) {
                nearest[k] = bary[0] * a[k] + (bary[1] + bary[2]) * b[k];
            }
        }
    }
    return chosen != PC_INVALID_INDEX;
}

// In the plane of the border triangle at half-edge corner `v` -> `next`, away from the border.
static void add_edge_inward(const snapping *s, uint32_t v, uint32_t next, double sum[3]) {
    const pci_topology *topology = &s->topology;
    for (size_t n = topology->vertex_triangle_offsets[v];
         n < topology->vertex_triangle_offsets[v + 1]; ++n) {
        const uint32_t *corner = &s->layer->triangles[3 * (size_t)topology->vertex_triangles[n]];
        for (size_t c = 0; c < 3; ++c) {
            if (corner[c] != v || corner[(c + 1) % 3] != next) {
                continue;
            }
            double along[3], inward[3];
            pci_sub(point_of(s, next), point_of(s, v), along);
            pci_sub(point_of(s, corner[(c + 2) % 3]), point_of(s, v), inward);
            const double squared = pci_dot(along, along);
            const double share = squared > 0.0 ? pci_dot(along, inward) / squared : 0.0;
            for (size_t k = 0; k < 3; ++k) {
                inward[k] -= share * along[k];
            }
            const double length = sqrt(squared);
            if (pci_normalize(inward)) {
                for (size_t k = 0; k < 3; ++k) {
                    sum[k] += length * inward[k];
                }
            }
        }
    }
}

// The way into the cloth as the border edges next to each vertex see it.
static void find_edge_inwards(snapping *s) {
    enum { window = 3 };
    for (size_t l = 0; l < s->loop_count; ++l) {
        const size_t first = s->offsets[l], count = s->offsets[l + 1] - first;
        for (size_t i = 0; i < count; ++i) {
            double *inward = &s->edge_inwards[3 * (size_t)s->loops[first + i]];
            for (size_t step = 0; step < 2 * window; ++step) { // from i - window to i + window
                const size_t from = (i + step + count * window - window) % count;
                add_edge_inward(s, s->loops[first + from], s->loops[first + (from + 1) % count],
                                inward);
            }
            pci_normalize(inward);
        }
    }
}

// The rings around a vertex: counts them into `queue`, the vertex itself first.
static size_t find_rings(const snapping *s, uint32_t v, uint32_t *queue, uint32_t *seen) {
    const pci_topology *topology = &s->topology;
    size_t begin = 0, end = 1;
    queue[0] = v;
    seen[v] = v + 1;
    for (size_t ring = 0; ring < inward_rings; ++ring) {
        for (const size_t last = end; begin < last; ++begin) {
            const uint32_t at = queue[begin];
            for (size_t n = topology->ring_offsets[at]; n < topology->ring_offsets[at + 1]; ++n) {
                if (seen[topology->ring[n]] != v + 1) {
                    seen[topology->ring[n]] = v + 1;
                    queue[end++] = topology->ring[n];
                }
            }
        }
    }
    return end;
}

// For each border vertex the way to the middle of the rings around it (which holds where the border
// runs on the back of the hem), and whether the rings reach another border across: straps of few
// voxels lie on the garment's straps already, and which of their two hems is meant is left to
// chance.
static bool look_around(pci_scratch *scratch, snapping *s) {
    const size_t nv = s->layer->vertex_count;
    uint32_t *queue = PCI_SCRATCH(scratch, uint32_t, nv);
    uint32_t *seen = PCI_SCRATCH(scratch, uint32_t, nv); // 1 + the vertex that was asked about last
    if (scratch->failed) {
        return false;
    }
    find_edge_inwards(s);
    for (size_t i = 0; i < s->offsets[s->loop_count]; ++i) {
        s->border[s->loops[i]] = 1;
    }
    for (size_t i = 0; i < s->offsets[s->loop_count]; ++i) {
        const uint32_t v = s->loops[i];
        double *inward = &s->inwards[3 * (size_t)v];
        const size_t count = find_rings(s, v, queue, seen);
        for (size_t q = 1; q < count; ++q) {
            const size_t w = queue[q];
            for (size_t k = 0; k < 3; ++k) {
                inward[k] += s->layer->positions[3 * w + k] - point_of(s, v)[k];
            }
            s->strap[v] |= s->border[w] && pci_dot(&s->edge_inwards[3 * (size_t)v],
                                                   &s->edge_inwards[3 * w]) < opposite_cosine;
        }
        pci_normalize(inward);
    }
    return true;
}

// Where each border vertex goes: onto the hem, then amid its neighbours along the hem.
static void snap_loops(snapping *s) {
    for (size_t i = 0; i < s->offsets[s->loop_count]; ++i) {
        const uint32_t v = s->loops[i];
        double target[3];
        const bool stays =
            s->strap[v] ||
            (s->cut > 0.0 && pci_bvh_within(s->surface, point_of(s, v), least_beside * s->cut));
        if (!stays &&
            nearest_hem(s, point_of(s, v), &s->inwards[3 * (size_t)v], s->reach, target)) {
            s->snapped[v] = 1;
            pci_sub(target, point_of(s, v), &s->moves[3 * (size_t)v]);
        }
    }
    for (size_t pass = 0; pass < even_passes; ++pass) {
        for (size_t l = 0; l < s->loop_count; ++l) {
            const size_t first = s->offsets[l], count = s->offsets[l + 1] - first;
            for (size_t i = 0; i < count; ++i) {
                const uint32_t v = s->loops[first + i];
                const uint32_t side[2] = {s->loops[first + (i + 1) % count],
                                          s->loops[first + (i + count - 1) % count]};
                if (!s->snapped[v] || !s->snapped[side[0]] || !s->snapped[side[1]]) {
                    continue;
                }
                double at[3], ends[2][3], axis[3], target[3];
                for (size_t k = 0; k < 3; ++k) {
                    at[k] = point_of(s, v)[k] + s->moves[3 * (size_t)v + k];
                    for (size_t e = 0; e < 2; ++e) {
                        ends[e][k] = point_of(s, side[e])[k] + s->moves[3 * (size_t)side[e] + k];
                    }
                }
                pci_sub(ends[0], ends[1], axis);
                if (!pci_normalize(axis)) {
                    continue;
                }
                double share = 0.0;
                for (size_t k = 0; k < 3; ++k) {
                    share += axis[k] * (0.5 * (ends[0][k] + ends[1][k]) - at[k]);
                }
                for (size_t k = 0; k < 3; ++k) {
                    at[k] += share * axis[k];
                }
                // Where it is now is on such a hem, too.
                const double reach = fmin(s->reach, fabs(share) + rounding * s->reach);
                if (nearest_hem(s, at, &s->inwards[3 * (size_t)v], reach, target)) {
                    pci_sub(target, point_of(s, v), &s->moves[3 * (size_t)v]);
                }
            }
        }
    }
}

// Lists the rings behind the snapped border, and numbers them. Returns how many vertices these are.
static size_t list_rings(snapping *s, uint32_t *listed) {
    const pci_topology *topology = &s->topology;
    size_t count = 0;
    for (size_t i = 0; i < s->offsets[s->loop_count]; ++i) {
        if (s->snapped[s->loops[i]] && s->rings[s->loops[i]] == 0) {
            s->rings[s->loops[i]] = 1;
            listed[count++] = s->loops[i];
        }
    }
    const size_t snapped = count;
    for (size_t i = 0; i < count && s->rings[listed[i]] <= following_rings; ++i) {
        const uint32_t v = listed[i];
        for (size_t n = topology->ring_offsets[v]; n < topology->ring_offsets[v + 1]; ++n) {
            const uint32_t w = topology->ring[n];
            if (s->rings[w] == 0 && !s->border[w]) {
                s->rings[w] = (uint8_t)(s->rings[v] + 1);
                listed[count++] = w;
            }
        }
    }
    memmove(listed, listed + snapped, (count - snapped) * sizeof(*listed));
    return count - snapped;
}

// Spreads the moves over the rings behind the border: each vertex moves as its neighbours do on
// average, vertices beyond the rings and borders without a hem not at all.
static bool spread_moves(pci_scratch *scratch, snapping *s) {
    const pci_topology *topology = &s->topology;
    uint32_t *listed = PCI_SCRATCH(scratch, uint32_t, s->layer->vertex_count);
    const size_t count = listed != NULL ? list_rings(s, listed) : 0;
    double *spread = PCI_SCRATCH(scratch, double, 3 * count);
    if (scratch->failed) {
        return false;
    }
    for (size_t pass = 0; pass < spread_passes; ++pass) {
        for (size_t i = 0; i < count; ++i) {
            const size_t v = listed[i];
            const size_t begin = topology->ring_offsets[v], end = topology->ring_offsets[v + 1];
            for (size_t k = 0; k < 3; ++k) {
                double sum = 0.0;
                for (size_t n = begin; n < end; ++n) {
                    sum += s->moves[3 * (size_t)topology->ring[n] + k];
                }
                spread[3 * i + k] = sum / (double)(end - begin);
            }
        }
        for (size_t i = 0; i < count; ++i) {
            memcpy(&s->moves[3 * (size_t)listed[i]], &spread[3 * i], 3 * sizeof(*spread));
        }
    }
    return true;
}

// Where vertex v is after its move, or a part of it: on the surface again.
static void moved_point(const snapping *s, uint32_t v, double point[3]) {
    for (size_t k = 0; k < 3; ++k) {
        point[k] = point_of(s, v)[k] + s->moves[3 * (size_t)v + k];
    }
    const pci_closest closest = pci_bvh_closest(s->surface, point, s->reach);
    if (closest.triangle != PC_INVALID_INDEX) {
        memcpy(point, closest.point, sizeof(closest.point));
    }
}

// Places the vertices whose moves are new.
static void place_vertices(void *user, size_t begin, size_t end, uint32_t worker) {
    snapping *s = user;
    (void)worker;
    for (size_t v = begin; v < end; ++v) {
        if (s->unplaced[v] && s->rings[v] > 0) {
            moved_point(s, (uint32_t)v, &s->placed[3 * v]);
        }
    }
}

// Whether the moves turn a triangle over or shrink it to a sliver.
static bool spoils(const snapping *s, const uint32_t *corner) {
    double normal[2][3];
    const double *positions[2] = {s->layer->positions, s->placed};
    for (size_t i = 0; i < 2; ++i) {
        double ab[3], ac[3];
        const double *a = &positions[i][3 * (size_t)corner[0]];
        pci_sub(&positions[i][3 * (size_t)corner[1]], a, ab);
        pci_sub(&positions[i][3 * (size_t)corner[2]], a, ac);
        pci_cross(ab, ac, normal[i]);
    }
    return pci_dot(normal[0], normal[1]) < least_kept * pci_dot(normal[0], normal[0]);
}

// Makes the moves, with less of them where they spoil triangles.
static bool apply_moves(pci_scratch *scratch, snapping *s) {
    const size_t nv = s->layer->vertex_count;
    uint8_t *spoiled = s->unplaced = PCI_SCRATCH(scratch, uint8_t, nv);
    s->placed = PCI_SCRATCH(scratch, double, 3 * nv);
    if (scratch->failed) {
        return false;
    }
    memcpy(s->placed, s->layer->positions, 3 * nv * sizeof(*s->placed));
    memset(s->unplaced, 1, nv);
    for (size_t attempt = 0; attempt <= retreats; ++attempt) {
        pci_parallel_for(scratch->context, nv, 256, place_vertices, s);
        bool good = true;
        memset(spoiled, 0, nv);
        for (size_t t = 0; t < s->layer->triangle_count; ++t) {
            const uint32_t *corner = &s->layer->triangles[3 * t];
            if (s->rings[corner[0]] + s->rings[corner[1]] + s->rings[corner[2]] > 0 &&
                spoils(s, corner)) {
                good = false;
                spoiled[corner[0]] = spoiled[corner[1]] = spoiled[corner[2]] = 1;
            }
        }
        if (good) {
            break;
        }
        for (size_t v = 0; v < nv; ++v) {
            if (spoiled[v]) {
                const double share = attempt + 1 < retreats ? 0.5 : 0.0;
                for (size_t k = 0; k < 3; ++k) {
                    s->moves[3 * v + k] *= share;
                }
            }
        }
    }
    memcpy(s->layer->positions, s->placed, 3 * nv * sizeof(*s->placed));
    return true;
}

static bool prepare(pci_scratch *scratch, const pc_mesh *surface, const pci_topology *edges,
                    double cell_size, snapping *s) {
    const size_t nv = s->layer->vertex_count;
    s->inwards = PCI_SCRATCH(scratch, double, 3 * nv);
    s->moves = PCI_SCRATCH(scratch, double, 3 * nv);
    s->border = PCI_SCRATCH(scratch, uint8_t, nv);
    s->strap = PCI_SCRATCH(scratch, uint8_t, nv);
    s->edge_inwards = PCI_SCRATCH(scratch, double, 3 * nv);
    s->snapped = PCI_SCRATCH(scratch, uint8_t, nv);
    s->rings = PCI_SCRATCH(scratch, uint8_t, nv);
    if (scratch->failed || !pci_topology_build_watched(scratch, s->layer, &s->topology) ||
        !pci_boundary_loops(scratch, s->layer, &s->topology, &s->loop_count, &s->offsets,
                            &s->loops) ||
        (s->loop_count > 0 && !pci_find_hems(scratch, surface, edges, s->surface,
                                             s->cut > 0.0 ? s->cut : cell_size, &s->hems))) {
        return false;
    }
    uint32_t *segments = PCI_SCRATCH(scratch, uint32_t, 3 * s->hems.count);
    for (size_t i = 0; i < s->hems.count && segments != NULL; ++i) {
        segments[3 * i] = (uint32_t)(2 * i);
        segments[3 * i + 1] = segments[3 * i + 2] = (uint32_t)(2 * i + 1);
    }
    s->hem_mesh = (pc_mesh){2 * s->hems.count, s->hems.points, s->hems.count, segments};
    return !scratch->failed;
}

pc_status pci_snap_border(pc_context *context, const char *stage, const pc_mesh *surface,
                          const pci_topology *edges, const pci_bvh *surface_bvh, double cut,
                          double cell_size, pc_mesh *layer) {
    pci_scratch scratch = pci_scratch_begin(context);
    snapping s = {
        .layer = layer, .surface = surface_bvh, .reach = snap_reach * cell_size, .cut = cut};
    pc_status status = PC_OK;
    bool done = prepare(&scratch, surface, edges, cell_size, &s);
    if (done && s.hems.count > 0 && s.loop_count > 0) {
        status = pci_bvh_create(context, stage, &s.hem_mesh, &s.hem_bvh);
        if (status == PC_OK) {
            done = look_around(&scratch, &s);
        }
        if (status == PC_OK && done) {
            snap_loops(&s);
            done = spread_moves(&scratch, &s) && apply_moves(&scratch, &s);
        }
    }
    pci_bvh_destroy(context, s.hem_bvh);
    pci_scratch_end(&scratch);
    return done ? status : pci_fail_memory(context, stage);
}
