#include "stages/carve/webs.h"

#include <stdatomic.h>

#include "core/core.h"
#include "core/union_find.h"
#include "geometry/manifold.h"
#include "geometry/topology.h"
#include "stages/carve/seams.h"

enum { grain = 256 };

// A web is farther than this from the cloth, in voxels, and parts of it that bridge the gap are
// farther than that.
static const double web_voxels = 0.25, bridge_voxels = 0.5;
// The walls of a gap begin so far from the layer without its webs, in voxels, and end within so
// many of a web's border.
static const double wall_voxels = 0.1, seam_voxels = 1.5;
// What is sewn in the place of a web may bridge so much of what it did.
static const double most_bridged = 0.5;

// ---- patches ------------------------------------------------------------------------------------

// A connected piece of a mesh.
typedef struct patch {
    size_t triangles, inner_vertices, loops;
    pci_loop border; // one of the loops
    bool taken;
} patch;

typedef struct patches {
    pc_mesh mesh;        // the marked triangles of another one, in order
    uint32_t *kept;      // their vertices in that, #V
    uint32_t *component; // #F
    size_t count;
    patch *list; // by component
} patches;

// V - E + F = 1, with E = (3 F + border) / 2 and as many vertices as edges on the border.
static bool is_disc(const patch *p) {
    return p->loops == 1 && 2 * p->inner_vertices + p->border.count == p->triangles + 2;
}

static patch *patch_of_vertex(const patches *p, const pci_topology *topology, size_t v) {
    return &p->list[p->component[topology->vertex_triangles[topology->vertex_triangle_offsets[v]]]];
}

// The piece with an edge of its border. Where the cloth is no manifold, chains end that have no
// such edge: then a piece at its first vertex.
static patch *patch_of_edge(const patches *p, const pci_topology *topology, uint32_t from,
                            uint32_t to) {
    const size_t *offsets = &topology->vertex_triangle_offsets[from];
    for (size_t i = offsets[0]; i < offsets[1]; ++i) {
        const uint32_t t = topology->vertex_triangles[i];
        const uint32_t *corner = &p->mesh.triangles[3 * (size_t)t];
        for (size_t c = 0; c < 3; ++c) {
            if (corner[c] == from && corner[(c + 1) % 3] == to) {
                return &p->list[p->component[t]];
            }
        }
    }
    return patch_of_vertex(p, topology, from);
}

static bool add_loops(pci_scratch *scratch, const patches *p, const pci_topology *topology,
                      uint8_t *outer) {
    size_t count = 0, *offsets = NULL;
    uint32_t *vertices = NULL;
    if (!pci_boundary_loops(scratch, &p->mesh, topology, &count, &offsets, &vertices)) {
        return false;
    }
    for (size_t i = 0; i < count; ++i) {
        const uint32_t *first = &vertices[offsets[i]];
        const size_t length = offsets[i + 1] - offsets[i];
        patch *owner = patch_of_edge(p, topology, first[0], first[length > 1 ? 1 : 0]);
        if (++owner->loops == 1 &&
            !pci_loop_begin(scratch, &p->mesh, length, first, &owner->border)) {
            return false;
        }
        for (size_t k = 0; k < length; ++k) {
            outer[first[k]] = 1;
        }
    }
    return true;
}

// Finds the connected pieces of the marked triangles. `mesh` of the result belongs to the caller.
// False: out of memory, or cancelled.
static bool find_patches(pci_scratch *scratch, const pc_mesh *mesh, const uint8_t *marked,
                         patches *p) {
    pci_topology topology;
    if (!pci_mesh_compact(scratch, mesh, marked, &p->mesh, &p->kept) ||
        !pci_topology_build_watched(scratch, &p->mesh, &topology)) {
        return false;
    }
    p->component = PCI_SCRATCH(scratch, uint32_t, p->mesh.triangle_count);
    uint8_t *outer = PCI_SCRATCH(scratch, uint8_t, p->mesh.vertex_count);
    if (scratch->failed) {
        return false;
    }
    p->count = pci_triangle_components(scratch, &p->mesh, &topology, p->component);
    p->list = PCI_SCRATCH(scratch, patch, p->count);
    if (scratch->failed || !add_loops(scratch, p, &topology, outer)) {
        return false;
    }
    for (size_t t = 0; t < p->mesh.triangle_count; ++t) {
        ++p->list[p->component[t]].triangles;
    }
    for (size_t v = 0; v < p->mesh.vertex_count; ++v) {
        patch_of_vertex(p, &topology, v)->inner_vertices += !outer[v];
    }
    return true;
}

// ---- webs ---------------------------------------------------------------------------------------

static void mark_away(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    pci_webbed *webbed = user;
    uint32_t last = PC_INVALID_INDEX;
    for (size_t t = begin; t < end; ++t) {
        double middle[3];
        pci_triangle_middle(webbed->layer, t, middle);
        webbed->away[t] =
            pci_bvh_within_near(webbed->cloth, middle, web_voxels * webbed->cell_size, &last)
                ? PCI_NEAR
            : pci_bvh_within_near(webbed->cloth, middle, bridge_voxels * webbed->cell_size, &last)
                ? PCI_AWAY
                : PCI_BRIDGE;
    }
}

bool pci_find_away(pci_scratch *scratch, pci_webbed *webbed) {
    const size_t count = webbed->layer->triangle_count;
    webbed->away = PCI_SCRATCH(scratch, uint8_t, count);
    return webbed->away != NULL &&
           pci_parallel_while_wanted(scratch->context, count, grain, mark_away, webbed);
}

// Marks connected pieces of what is away that have a bridge. False: out of memory.
static bool mark_webs(pci_scratch *scratch, const pc_mesh *layer, const pci_topology *topology,
                      const uint8_t *away, uint8_t *web) {
    uint32_t *piece = PCI_SCRATCH(scratch, uint32_t, layer->triangle_count);
    uint8_t *bridge = PCI_SCRATCH(scratch, uint8_t, layer->triangle_count);
    if (scratch->failed) {
        return false;
    }
    pci_join_alike(topology, layer->triangle_count, away, piece);
    for (uint32_t t = 0; t < layer->triangle_count; ++t) {
        bridge[pci_find_root(piece, t)] |= away[t] == PCI_BRIDGE;
    }
    for (uint32_t t = 0; t < layer->triangle_count; ++t) {
        web[t] = away[t] && bridge[pci_find_root(piece, t)];
    }
    return true;
}

static void mark_corners(const pc_mesh *layer, const uint8_t *web, uint8_t *corners) {
    for (size_t i = 0; i < 3 * layer->triangle_count; ++i) {
        corners[layer->triangles[i]] |= web[i / 3];
    }
}

// Adds a ring of triangles, so that the border lies on the cloth. `corners` (#V) receives the
// vertices of the result.
static void widen(const pc_mesh *layer, uint8_t *web, uint8_t *corners) {
    mark_corners(layer, web, corners);
    for (size_t t = 0; t < layer->triangle_count; ++t) {
        const uint32_t *corner = &layer->triangles[3 * t];
        web[t] = corners[corner[0]] || corners[corner[1]] || corners[corner[2]];
    }
    mark_corners(layer, web, corners);
}

// What touches the border of the layer is no web between two walls, nor is what is no disc. Whether
// others are left: `some`.
static bool leave_others(pci_scratch *scratch, const pc_mesh *layer, const pci_topology *topology,
                         patches *webs, bool *some) {
    uint8_t *border = PCI_SCRATCH(scratch, uint8_t, layer->vertex_count);
    if (border == NULL) {
        return false;
    }
    pci_mark_border(topology, border);
    for (size_t i = 0; i < 3 * webs->mesh.triangle_count; ++i) {
        patch *p = &webs->list[webs->component[i / 3]];
        p->taken = p->taken || border[webs->kept[webs->mesh.triangles[i]]];
    }
    for (size_t i = 0; i < webs->count; ++i) {
        webs->list[i].taken = webs->list[i].taken || !is_disc(&webs->list[i]);
        *some = *some || !webs->list[i].taken;
    }
    return true;
}

// ---- walls --------------------------------------------------------------------------------------

typedef struct beyond_job {
    const pci_bvh *rest_bvh;
    const pc_mesh *rest, *other;
    const uint8_t *ring; // #V of `rest`: 1 at the border of a web, 2 next to that, ...; 0: far away
    const uint8_t *kept;
    double reach;
    uint8_t *beyond; // #F of `other`
} beyond_job;

// A triangle goes on beyond the border of a web where only points on that are closest to it: 1, or
// points a few rings behind: their number.
static void find_beyond(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const beyond_job *job = user;
    uint32_t last = PC_INVALID_INDEX;
    for (size_t t = begin; t < end; ++t) {
        if (job->kept != NULL && job->kept[t]) {
            continue;
        }
        double middle[3];
        pci_triangle_middle(job->other, t, middle);
        if (pci_bvh_within_near(job->rest_bvh, middle, job->reach, &last)) {
            continue;
        }
        const pci_closest closest = pci_bvh_closest_near(job->rest_bvh, middle, last);
        const uint32_t *corner = &job->rest->triangles[3 * (size_t)closest.triangle];
        uint8_t ring = 1;
        last = closest.triangle;
        for (size_t c = 0; c < 3 && ring > 0; ++c) {
            if (closest.barycentric[c] > 0.0) {
                const uint8_t at = job->ring[corner[c]];
                ring = at == 0 || at > ring ? at : ring;
            }
        }
        job->beyond[t] = ring;
    }
}

// Numbers the rings of vertices from the border on.
static void number_rings(const pc_mesh *rest, uint8_t last, uint8_t *ring) {
    for (uint8_t r = 1; r < last; ++r) {
        for (size_t t = 0; t < rest->triangle_count; ++t) {
            const uint32_t *corner = &rest->triangles[3 * t];
            if (ring[corner[0]] == r || ring[corner[1]] == r || ring[corner[2]] == r) {
                for (size_t c = 0; c < 3; ++c) {
                    ring[corner[c]] = ring[corner[c]] == 0 ? (uint8_t)(r + 1) : ring[corner[c]];
                }
            }
        }
    }
}

// The layer without its webs.
typedef struct layer_rest {
    pc_mesh mesh;
    pci_bvh *bvh;
    uint8_t *ring; // #V
} layer_rest;

// @param corners  #V of `layer`, vertices of webs
static pc_status take_rest(pci_scratch *scratch, const char *stage, const pc_mesh *layer,
                           const uint8_t *web, const uint8_t *corners, uint8_t rings,
                           layer_rest *rest) {
    uint32_t *vertices = NULL;
    uint8_t *keep = PCI_SCRATCH(scratch, uint8_t, layer->triangle_count);
    for (size_t t = 0; t < layer->triangle_count && keep != NULL; ++t) {
        keep[t] = !web[t];
    }
    if (keep == NULL || !pci_mesh_compact(scratch, layer, keep, &rest->mesh, &vertices)) {
        return pci_fail_memory(scratch->context, stage);
    }
    rest->ring = PCI_SCRATCH(scratch, uint8_t, rest->mesh.vertex_count);
    if (rest->ring == NULL) {
        return pci_fail_memory(scratch->context, stage);
    }
    for (size_t v = 0; v < rest->mesh.vertex_count; ++v) {
        rest->ring[v] = corners[vertices[v]];
    }
    number_rings(&rest->mesh, rings, rest->ring);
    return pci_bvh_create(scratch->context, stage, &rest->mesh, &rest->bvh);
}

// What a wall surrounds is a part of it: marks unmarked pieces of the mesh that lie in one marked
// piece, are smaller and have no border. False: out of memory.
static bool fill_walls(pci_scratch *scratch, const pc_mesh *mesh, const pci_topology *topology,
                       uint8_t *marked) {
    uint32_t *piece = PCI_SCRATCH(scratch, uint32_t, mesh->triangle_count);
    uint32_t *around = PCI_SCRATCH(scratch, uint32_t, mesh->triangle_count);
    uint32_t *size = PCI_SCRATCH(scratch, uint32_t, mesh->triangle_count);
    uint8_t *open = PCI_SCRATCH(scratch, uint8_t, mesh->triangle_count);
    uint8_t *fill = PCI_SCRATCH(scratch, uint8_t, mesh->triangle_count);
    if (scratch->failed) {
        return false;
    }
    pci_join_alike(topology, mesh->triangle_count, marked, piece);
    for (uint32_t t = 0; t < mesh->triangle_count; ++t) {
        around[t] = PC_INVALID_INDEX;
        ++size[pci_find_root(piece, t)];
    }
    for (size_t e = 0; e < topology->edge_count; ++e) {
        const uint32_t *sides = pci_sides(topology, e);
        const uint32_t a = pci_find_root(piece, sides[0]);
        if (pci_side_count(topology, e) != 2) {
            open[a] = 1;
            continue;
        }
        const uint32_t b = pci_find_root(piece, sides[1]);
        const uint32_t inner = marked[a] ? b : a, outer = marked[a] ? a : b;
        if (a != b) {
            open[inner] |= around[inner] != PC_INVALID_INDEX && around[inner] != outer;
            around[inner] = outer;
        }
    }
    for (uint32_t t = 0; t < mesh->triangle_count; ++t) {
        const uint32_t root = pci_find_root(piece, t);
        fill[t] = !marked[root] && !open[root] && around[root] != PC_INVALID_INDEX &&
                  size[root] < size[around[root]];
    }
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        marked[t] |= fill[t];
    }
    return true;
}

// ---- replacement --------------------------------------------------------------------------------

typedef struct mending {
    const pci_webbed *webbed;
    patches *webs, *walls;
    double *bridged;   // by web, area
    size_t first_wall; // number of the first vertex of the walls
    size_t count;
    uint32_t *triangles; // of seams and walls; they face like the webs
} mending;

// A loop with other numbers for its vertices.
static bool renumber(pci_scratch *scratch, const uint32_t *numbers, size_t first, pci_loop *loop) {
    uint32_t *vertices = PCI_SCRATCH(scratch, uint32_t, loop->count);
    for (size_t i = 0; i < loop->count && vertices != NULL; ++i) {
        const uint32_t v = loop->vertices[i];
        vertices[i] = numbers != NULL ? numbers[v] : (uint32_t)(first + v);
    }
    loop->vertices = vertices;
    return vertices != NULL;
}

static bool sew_wall(pci_scratch *scratch, mending *m, const patch *web, size_t wall,
                     const pci_seam *found) {
    pci_loop a = web->border, b = m->walls->list[wall].border;
    pci_seam seam = *found;
    seam.a = &a;
    seam.b = &b;
    if (!renumber(scratch, m->webs->kept, 0, &a) || !renumber(scratch, NULL, m->first_wall, &b) ||
        !pci_close_seam(scratch, &seam, m->triangles, &m->count)) {
        return false;
    }
    for (size_t t = 0; t < m->walls->mesh.triangle_count; ++t) {
        if (m->walls->component[t] != wall) {
            continue;
        }
        for (size_t c = 0; c < 3; ++c) {
            m->triangles[3 * m->count + c] =
                (uint32_t)(m->first_wall + m->walls->mesh.triangles[3 * t + c]);
        }
        ++m->count;
    }
    return true;
}

// How far the border of a wall is from that of a web, on average.
static double mean_distance(const pci_loop *wall, const pci_loop *web) {
    double sum = 0.0;
    for (size_t i = 0; i < wall->count; ++i) {
        uint32_t nearest = 0;
        double squared = 0.0;
        pci_knn_query(&web->nearest, &wall->points[3 * i], 1, PC_INVALID_INDEX, &nearest, &squared);
        sum += sqrt(squared);
    }
    return sum / (double)wall->count;
}

static void position_of(const mending *m, uint32_t v, double out[3]) {
    const double *from = v < m->first_wall
                             ? &m->webbed->layer->positions[3 * (size_t)v]
                             : &m->walls->mesh.positions[3 * ((size_t)v - m->first_wall)];
    memcpy(out, from, 3 * sizeof(*out));
}

// The area of what was sewn that bridges gaps like the web did.
static double area_bridged(const mending *m, size_t begin) {
    const double reach = bridge_voxels * m->webbed->cell_size;
    double sum = 0.0;
    uint32_t last = PC_INVALID_INDEX;
    for (size_t t = begin; t < m->count; ++t) {
        double points[9], middle[3];
        uint32_t corners[3] = {0, 1, 2};
        const pc_mesh one = {3, points, 1, corners};
        for (size_t c = 0; c < 3; ++c) {
            position_of(m, m->triangles[3 * t + c], &points[3 * c]);
        }
        pci_triangle_middle(&one, 0, middle);
        sum += pci_bvh_within_near(m->webbed->cloth, middle, reach, &last)
                   ? 0.0
                   : pci_triangle_area(&one, 0);
    }
    return sum;
}

// Looks for the walls of the gap that a web bridges; of several plies the nearest. False: out of
// memory, or cancelled.
static bool mend(pci_scratch *scratch, mending *m, size_t number, bool *mended) {
    const patch *web = &m->webs->list[number];
    size_t chosen = m->walls->count;
    pci_seam seam = {0};
    const double reach = seam_voxels * m->webbed->cell_size;
    double nearest = HUGE_VAL;
    for (size_t i = 0; i < m->walls->count; ++i) {
        const patch *wall = &m->walls->list[i];
        pci_seam found;
        if (!wall->taken && pci_find_seam(&web->border, &wall->border, reach, &found) &&
            found.steps == wall->border.count) {
            const double distance = mean_distance(&wall->border, &web->border);
            if (distance < nearest) {
                nearest = distance;
                chosen = i;
                seam = found;
            }
        }
    }
    if (chosen == m->walls->count) {
        return true;
    }
    const size_t begin = m->count;
    if (!pci_keep_going(scratch->context) || !sew_wall(scratch, m, web, chosen, &seam)) {
        return false;
    }
    *mended = area_bridged(m, begin) <= most_bridged * m->bridged[number];
    m->walls->list[chosen].taken = *mended;
    m->count = *mended ? m->count : begin;
    return true;
}

// The layer with what was sewn in the place of mended webs.
static bool assemble(pci_scratch *scratch, const uint8_t *web, const bool *mended, const mending *m,
                     pc_mesh *result) {
    const pc_mesh *layer = m->webbed->layer;
    const pc_mesh *walls = &m->walls->mesh;
    pc_mesh sum = {.vertex_count = m->first_wall + walls->vertex_count};
    sum.positions = PCI_SCRATCH(scratch, double, 3 * sum.vertex_count);
    sum.triangles = PCI_SCRATCH(scratch, uint32_t, 3 * (layer->triangle_count + m->count));
    if (scratch->failed) {
        return false;
    }
    memcpy(sum.positions, layer->positions, 3 * m->first_wall * sizeof(double));
    memcpy(&sum.positions[3 * m->first_wall], walls->positions,
           3 * walls->vertex_count * sizeof(double));
    for (size_t t = 0, i = 0; t < layer->triangle_count; ++t) {
        if (!web[t] || !mended[m->webs->component[i++]]) {
            memcpy(&sum.triangles[3 * sum.triangle_count++], &layer->triangles[3 * t],
                   3 * sizeof(uint32_t));
        }
    }
    for (size_t t = 0; t < m->count; ++t) {
        const uint32_t *corner = &m->triangles[3 * t];
        uint32_t *turned = &sum.triangles[3 * sum.triangle_count++];
        turned[0] = corner[0], turned[1] = corner[2], turned[2] = corner[1];
    }
    pci_repair_counts counts;
    return pci_mesh_repair(scratch, &sum, NULL, result, &counts);
}

// Takes the mended layer if it has the shape of the other: `taken`.
static bool take_mended(pci_scratch *scratch, pc_mesh *mended, pci_webbed *webbed, bool *taken) {
    pci_shape after;
    if (!pci_find_shape(scratch, mended, &after)) {
        return false;
    }
    if (pci_same_topology(webbed->shape, &after)) {
        const pc_mesh swapped = *webbed->layer;
        *webbed->layer = *mended;
        *mended = swapped;
        *webbed->shape = after;
        *taken = true;
    }
    return true;
}

// Adds up what of each web bridges a gap. False: out of memory.
static bool sum_bridged(pci_scratch *scratch, const uint8_t *web, mending *m) {
    const pci_webbed *webbed = m->webbed;
    m->bridged = PCI_SCRATCH(scratch, double, m->webs->count);
    for (size_t t = 0, i = 0; t < webbed->layer->triangle_count && m->bridged != NULL; ++t) {
        if (web[t]) {
            m->bridged[m->webs->component[i++]] +=
                webbed->away[t] == PCI_BRIDGE ? pci_triangle_area(webbed->layer, t) : 0.0;
        }
    }
    return m->bridged != NULL;
}

static bool replace_webs(pci_scratch *scratch, pci_webbed *webbed, const uint8_t *web,
                         patches *webs, patches *walls, bool *taken) {
    mending m = {
        .webbed = webbed, .webs = webs, .walls = walls, .first_wall = webbed->layer->vertex_count};
    size_t most = walls->mesh.triangle_count;
    for (size_t i = 0; i < webs->count; ++i) {
        most += webs->list[i].border.count;
    }
    for (size_t i = 0; i < walls->count; ++i) {
        most += walls->list[i].border.count;
    }
    bool *mended = PCI_SCRATCH(scratch, bool, webs->count);
    m.triangles = PCI_SCRATCH(scratch, uint32_t, 3 * most);
    if (scratch->failed || !sum_bridged(scratch, web, &m)) {
        return false;
    }
    for (size_t i = 0; i < webs->count; ++i) {
        if (!webs->list[i].taken && !mend(scratch, &m, i, &mended[i])) {
            return false;
        }
    }
    if (m.count == 0) {
        return true;
    }
    pc_mesh result = {0};
    const bool done =
        assemble(scratch, web, mended, &m, &result) && take_mended(scratch, &result, webbed, taken);
    pc_mesh_free(scratch->context, &result);
    return done;
}

// ---- entry --------------------------------------------------------------------------------------

// What walls are looked for in.
typedef struct quarry {
    pci_webbed *webbed;
    const pc_mesh *mesh;
    pci_topology topology; // its edges, where they were asked for
    pci_scratch *scratch;  // of those
    const uint8_t *kept;
    uint8_t most_rings;
} quarry;

// The webs of a layer and what lies around them, which two threads find side by side.
typedef struct survey {
    const char *stage;
    const pc_mesh *layer;
    const pci_topology *topology; // its edges
    const uint8_t *web, *corners;
    uint8_t most_rings;
    patches webs;
    layer_rest rest;
    pci_scratch memory[2]; // of the tasks
    atomic_bool none;      // web that may be mended: nobody needs the rest
} survey;

static pc_status survey_nth(void *user, size_t index, pc_context *own) {
    survey *s = user;
    pci_scratch scratch = pci_scratch_begin(own);
    pc_status status = PC_OK;
    bool some = false;
    if (index == 1) {
        status = atomic_load(&s->none) ? PC_OK
                                       : take_rest(&scratch, s->stage, s->layer, s->web, s->corners,
                                                   s->most_rings, &s->rest);
    } else if (find_patches(&scratch, s->layer, s->web, &s->webs) &&
               leave_others(&scratch, s->layer, s->topology, &s->webs, &some)) {
        atomic_store(&s->none, !some);
    } else {
        status = pci_fail_memory(own, s->stage);
    }
    pci_scratch_take(&s->memory[index], &scratch);
    return status;
}

// Takes walls that begin at most so many rings before the border. False: out of memory, or
// cancelled.
static bool try_walls(pci_scratch *scratch, quarry *q, const uint8_t *beyond, uint8_t rings,
                      survey *s, bool *mended) {
    patches walls = {0};
    uint8_t *marked = PCI_SCRATCH(scratch, uint8_t, q->mesh->triangle_count);
    for (size_t t = 0; t < q->mesh->triangle_count && marked != NULL; ++t) {
        marked[t] = beyond[t] > 0 && beyond[t] <= rings;
    }
    bool done = marked != NULL &&
                (q->topology.edges != NULL ||
                 pci_topology_build_edges(q->scratch, q->mesh, &q->topology)) &&
                fill_walls(scratch, q->mesh, &q->topology, marked) &&
                find_patches(scratch, q->mesh, marked, &walls);
    if (done) {
        for (size_t i = 0; i < walls.count; ++i) {
            walls.list[i].taken = !is_disc(&walls.list[i]);
        }
        done = replace_webs(scratch, q->webbed, s->web, &s->webs, &walls, mended);
    }
    pc_mesh_free(scratch->context, &walls.mesh);
    return done;
}

// One go at all webs there are. `rings` is the first number of rings to try, and then the next.
static pc_status mend_once(pci_scratch *scratch, const char *stage, quarry *q, uint8_t *rings,
                           bool *mended) {
    pc_context *context = scratch->context;
    const pc_mesh *layer = q->webbed->layer;
    pci_topology topology;
    uint8_t *web = PCI_SCRATCH(scratch, uint8_t, layer->triangle_count);
    uint8_t *corners = PCI_SCRATCH(scratch, uint8_t, layer->vertex_count);
    uint8_t *beyond = PCI_SCRATCH(scratch, uint8_t, q->mesh->triangle_count);
    *mended = false;
    if (scratch->failed || !pci_topology_build_edges(scratch, layer, &topology) ||
        !mark_webs(scratch, layer, &topology, q->webbed->away, web)) {
        return pci_fail_memory(context, stage);
    }
    widen(layer, web, corners);
    if (memchr(web, 0, layer->triangle_count) == NULL ||
        memchr(web, 1, layer->triangle_count) == NULL) {
        return PC_OK;
    }
    survey s = {.stage = stage,
                .layer = layer,
                .topology = &topology,
                .web = web,
                .corners = corners,
                .most_rings = q->most_rings};
    pc_status status = pci_run_tasks(context, 2, survey_nth, &s);
    for (size_t i = 0; i < 2; ++i) {
        pci_scratch_take(scratch, &s.memory[i]);
    }
    const bool some = !atomic_load(&s.none);
    if (status == PC_OK && some) {
        beyond_job job = {s.rest.bvh,  &s.rest.mesh, q->mesh,
                          s.rest.ring, q->kept,      wall_voxels * q->webbed->cell_size,
                          beyond};
        status =
            pci_parallel_while_wanted(context, q->mesh->triangle_count, grain, find_beyond, &job)
                ? PC_OK
                : pci_fail_memory(context, stage);
    }
    pci_bvh_destroy(context, s.rest.bvh);
    pc_mesh_free(context, &s.rest.mesh);
    for (; *rings <= q->most_rings && some && !*mended && status == PC_OK; ++*rings) {
        status = try_walls(scratch, q, beyond, *rings, &s, mended)
                     ? PC_OK
                     : pci_fail_memory(context, stage);
    }
    pc_mesh_free(context, &s.webs.mesh);
    return status;
}

pc_status pci_mend_webs(pci_scratch *scratch, const char *stage, const pc_mesh *other,
                        const uint8_t *kept, uint8_t most_rings, pci_webbed *webbed) {
    pci_scratch kept_longer = pci_scratch_begin(scratch->context);
    quarry q = {.webbed = webbed,
                .mesh = other,
                .scratch = &kept_longer,
                .kept = kept,
                .most_rings = most_rings};
    pc_status status = PC_OK;
    bool mended = true;
    for (uint8_t rings = 1; mended && rings <= most_rings && status == PC_OK;) {
        const struct pci_scratch_block *mark = scratch->blocks;
        status = mend_once(scratch, stage, &q, &rings, &mended);
        pci_scratch_rewind(scratch, mark);
        if (status == PC_OK && mended && !pci_find_away(scratch, webbed)) {
            status = pci_fail_memory(scratch->context, stage);
        }
    }
    pci_scratch_end(&kept_longer);
    return status;
}
