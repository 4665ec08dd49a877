#include "stages/carve/outline.h"

#include "core/core.h"
#include "core/union_find.h"
#include "geometry/manifold.h"
#include "geometry/topology.h"
#include "stages/carve/isoline.h"

// Pieces of parallel loops.
enum { grain = 256 };

// A membrane hangs from its rim, but sags: the rim may be so much farther than the nearest point of
// the visual mesh, in voxels.
static const double sag = 1.0;
// A membrane is framed by rims in so many of the sectors around its centre; a web between a sleeve
// and the body may have the cuff on one side.
enum { sectors = 12 };
// Cosine between the way from a rim into the cloth and that to the middle of a membrane, at most.
static const double most_towards = 0.7;
// A web from the hem of one layer to the layer beneath is framed by rims, too, but has cloth behind
// it, for most of its area within so many voxels; an opening has not.
static const double behind = 1.5;
// A cup on the cloth, as a pouch or a rivet, is no opening either: the first cloth in it, up to so
// many voxels deep, is what the layer left out to go over it. The layer is neither so near to that
// on the way in, nor so near beside.
static const double deepest_cup = 3.0, left_out = 0.5, left_out_beside = 0.2;
// What a region must be to go.
typedef struct demands {
    double fineness; // the layer is refined to edges of so many thresholds first
    double reach;    // least largest distance, in thresholds; less is roughness
    // Of membranes only:
    uint32_t framed; // least number of sectors
    double at_rims; // least share of the frame: a web from a hem to what is beneath it has one side
    double backed;  // least share of the area that is not one
} demands;
// The distance hardly changes faster than the way, so edges of half the threshold cannot hide a
// crossing that matters. Coarser ones tell where to look closer, with demands that leave room for
// what they may miss.
static const demands of_membranes = {1.0, 1.2, 9, 0.9, 0.5},
                     of_candidates = {2.0, 1.0, 3, 0.0, 0.75};
// The iso-surface closes openings up to two voxels wide; no part of a membrane is farther from the
// rim than so many voxels.
static const double widest = 3.0;
// The second pass looks so far around what the first one found, in voxels.
static const double beyond = 0.5;
// Membranes that are tested for holding the layer together.
enum { most_tests = 256 };
// A membrane that reaches the threshold is cut out up to where it is this share of that beside the
// visual mesh: the tip of a slit is narrow.
static const double followed = 0.5;

// ---- regions beside the visual mesh ------------------------------------------------------------

typedef struct region {
    uint32_t first; // triangle
    double area, centre[3], normal[3];
    double backed;    // area with other cloth close behind it
    double reach;     // largest distance
    uint32_t sectors; // bit i: in this direction from the centre the region ends at a rim
    uint32_t amid;    // bit i: likewise, but the cloth at that rim lies towards the centre
    double frame;     // length of its border
    double at_rims;   // of what of it ends at rims
    bool bordering;   // part of the border of the layer
    bool fringe;      // near the border of the layer
} region;

// Joins the triangles that lie beside the visual mesh to regions, numbered by their first triangle:
// `of` holds the region of each, PC_INVALID_INDEX for triangles that stay anyway.
static bool join_regions(const pci_isoline *o, double distance, uint32_t *of, region **regions,
                         size_t *count) {
    const pci_halfedge *mesh = &o->mesh;
    uint8_t *beside = PCI_SCRATCH(mesh->scratch, uint8_t, mesh->triangle_count);
    uint32_t *numbers = PCI_SCRATCH(mesh->scratch, uint32_t, mesh->triangle_count);
    if (mesh->scratch->failed) {
        return false;
    }
    pci_singletons(of, mesh->triangle_count);
    for (size_t i = 0; i < 3 * mesh->triangle_count; ++i) {
        beside[i / 3] |= o->distances[mesh->corners[i]] > distance;
    }
    for (uint32_t h = 0; h < 3 * mesh->triangle_count; ++h) {
        const uint32_t twin = mesh->twins[h];
        if (twin != PC_INVALID_INDEX && h < twin && beside[h / 3] && beside[twin / 3]) {
            pci_unite(of, h / 3, twin / 3);
        }
    }
    // Roots come first: they are the first triangles of their sets.
    *count = 0;
    for (uint32_t t = 0; t < mesh->triangle_count; ++t) {
        const uint32_t root = pci_find_root(of, t);
        numbers[t] = !beside[t]  ? PC_INVALID_INDEX
                     : root == t ? (uint32_t)(*count)++
                                 : numbers[root];
    }
    *regions = PCI_SCRATCH(mesh->scratch, region, *count);
    if (*regions == NULL) {
        return false;
    }
    for (uint32_t t = (uint32_t)mesh->triangle_count; t-- > 0;) {
        of[t] = numbers[t];
        if (of[t] != PC_INVALID_INDEX) {
            (*regions)[of[t]].first = t;
        }
    }
    return true;
}

static void area_vector(const pci_halfedge *mesh, size_t triangle, const double *corners[3],
                        double normal[3]) {
    double u[3], v[3];
    for (size_t c = 0; c < 3; ++c) {
        corners[c] = &mesh->positions[3 * (size_t)mesh->corners[3 * triangle + c]];
    }
    pci_sub(corners[1], corners[0], u);
    pci_sub(corners[2], corners[0], v);
    pci_cross(u, v, normal);
}

// What is known of the cloth behind membranes.
typedef struct backing {
    const pci_isoline *outline;
    const uint32_t *regions; // #F
    const uint8_t *asked;    // #regions
    const pci_bvh *layer;    // NULL: cups do not count
    double cell_size;
    uint8_t *backed; // #F
} backing;

static bool is_backed(const backing *b, const double *const corners[3], const double normal[3]) {
    double middle[3], direction[3] = {-normal[0], -normal[1], -normal[2]}, met[3];
    for (size_t k = 0; k < 3; ++k) {
        middle[k] = (corners[0][k] + corners[1][k] + corners[2][k]) / 3.0;
    }
    if (!pci_normalize(direction)) {
        return false;
    }
    const pci_hit hit = pci_bvh_cast(b->outline->visual, middle, direction, 0.0,
                                     deepest_cup * b->cell_size, NULL, NULL);
    if (hit.triangle == PC_INVALID_INDEX || hit.distance <= behind * b->cell_size) {
        return hit.triangle != PC_INVALID_INDEX;
    }
    if (b->layer == NULL) {
        return false;
    }
    for (size_t k = 0; k < 3; ++k) {
        met[k] = middle[k] + hit.distance * direction[k];
    }
    const double window = left_out * b->cell_size;
    return !pci_bvh_within(b->layer, met, left_out_beside * b->cell_size) &&
           pci_bvh_cast(b->layer, middle, direction, hit.distance - window, hit.distance + window,
                        NULL, NULL)
                   .triangle == PC_INVALID_INDEX;
}

static void measure_extent(const pci_isoline *o, const uint32_t *of, region *regions,
                           size_t region_count) {
    const pci_halfedge *mesh = &o->mesh;
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        if (of[t] == PC_INVALID_INDEX) {
            continue;
        }
        region *r = &regions[of[t]];
        const double *corners[3];
        double normal[3];
        area_vector(mesh, t, corners, normal);
        const double area = 0.5 * pci_norm(normal);
        r->area += area;
        for (size_t k = 0; k < 3; ++k) {
            r->reach = fmax(r->reach, o->distances[mesh->corners[3 * t + k]]);
            r->centre[k] += area * (corners[0][k] + corners[1][k] + corners[2][k]) / 3.0;
            r->normal[k] += normal[k];
        }
    }
    for (size_t i = 0; i < region_count; ++i) {
        for (size_t k = 0; k < 3 && regions[i].area > 0.0; ++k) {
            regions[i].centre[k] /= regions[i].area;
        }
    }
}

// Marks the sector of the region's plane in which a point lies.
static void mark_sector(const region *r, const double point[3], uint32_t *marks) {
    double n[3] = {r->normal[0], r->normal[1], r->normal[2]}, x[3] = {0.0, 0.0, 0.0}, y[3], away[3];
    if (!pci_normalize(n)) {
        return;
    }
    const size_t axis = fabs(n[0]) <= fabs(n[1]) ? (fabs(n[0]) <= fabs(n[2]) ? 0 : 2)
                                                 : (fabs(n[1]) <= fabs(n[2]) ? 1 : 2);
    x[axis] = 1.0;
    pci_cross(n, x, y);
    pci_cross(y, n, x);
    pci_sub(point, r->centre, away);
    const double turn = 0.5 + atan2(pci_dot(away, y), pci_dot(away, x)) / (2.0 * PCI_PI);
    *marks |= UINT32_C(1) << ((uint32_t)(turn * sectors) % sectors);
}

// Whether the surface at a rim does not lie towards the middle of the region: of an opening it lies
// around, of a flap that webs join to what is beneath it lies amid them.
static bool is_around(const region *r, const pci_rims *rims, uint32_t rim) {
    double towards[3];
    pci_sub(r->centre, &rims->points.points[3 * (size_t)rim], towards);
    return !pci_normalize(towards) ||
           pci_dot(towards, &rims->inwards[3 * (size_t)rim]) < most_towards;
}

// The vertices on the border of the layer.
static bool find_border(const pci_halfedge *mesh, pci_knn *border) {
    double *points = PCI_SCRATCH(mesh->scratch, double, 3 * mesh->vertex_count);
    size_t count = 0;
    if (points == NULL) {
        return false;
    }
    for (uint32_t h = 0; h < 3 * mesh->triangle_count; ++h) {
        if (mesh->twins[h] == PC_INVALID_INDEX) {
            memcpy(&points[3 * count++], &mesh->positions[3 * (size_t)pci_origin(mesh, h)],
                   3 * sizeof(double));
        }
    }
    return pci_knn_build(mesh->scratch, count, points, border);
}

// What lies around the origin of a half-edge on the border of a region.
typedef struct frame_point {
    uint32_t halfedge;
    uint32_t rim; // PC_INVALID_INDEX: none near
    bool fringe;
} frame_point;

typedef struct framing {
    const pci_isoline *outline;
    const pci_knn *rims, *border;
    double slack;
    frame_point *points;
} framing;

static void look_around(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const framing *f = user;
    const pci_isoline *o = f->outline;
    uint32_t border = PC_INVALID_INDEX;
    for (size_t i = begin; i < end; ++i) {
        frame_point *p = &f->points[i];
        const uint32_t v = pci_origin(&o->mesh, p->halfedge);
        const double *point = &o->mesh.positions[3 * (size_t)v];
        p->fringe = pci_knn_within_near(f->border, point, f->slack, &border);
        p->rim = PC_INVALID_INDEX;
        if (!pci_knn_within(f->rims, point, f->slack, &p->rim)) { // else nobody needs to know more
            const double distance = pci_bvh_closest_near(o->visual, point, o->nearest[v]).distance;
            (void)pci_knn_within(f->rims, point, distance + f->slack, &p->rim);
        }
    }
}

// A region ends at the rim of an opening where a rim is near, or where the layer ends already.
// False: out of memory, or cancelled.
static bool measure_frame(const pci_isoline *o, const pci_rims *rims, double slack,
                          const uint32_t *of, region *regions) {
    const pci_halfedge *mesh = &o->mesh;
    pci_knn border;
    framing f = {o, &rims->points, &border, slack, NULL};
    size_t count = 0, capacity = 0;
    for (uint32_t h = 0; h < 3 * mesh->triangle_count; ++h) {
        const uint32_t own = of[h / 3], twin = mesh->twins[h];
        if (own == PC_INVALID_INDEX || (twin != PC_INVALID_INDEX && of[twin / 3] == own)) {
            continue;
        }
        void *points = f.points;
        if (!pci_scratch_reserve(mesh->scratch, &points, &capacity, count + 1, sizeof(*f.points))) {
            return false;
        }
        f.points = points;
        f.points[count++].halfedge = h;
    }
    if (!find_border(mesh, &border) ||
        !pci_parallel_while_wanted(mesh->scratch->context, count, grain, look_around, &f)) {
        return false;
    }
    for (size_t i = 0; i < count; ++i) {
        const frame_point *p = &f.points[i];
        region *r = &regions[of[p->halfedge / 3]];
        const uint32_t from = pci_origin(mesh, p->halfedge);
        const uint32_t to = pci_origin(mesh, pci_next(p->halfedge));
        const double length = sqrt(pci_squared_distance(&mesh->positions[3 * (size_t)from],
                                                        &mesh->positions[3 * (size_t)to]));
        const bool ends = mesh->twins[p->halfedge] == PC_INVALID_INDEX;
        r->frame += length;
        r->at_rims += ends || p->rim != PC_INVALID_INDEX ? length : 0.0;
        if (ends) {
            mark_sector(r, &mesh->positions[3 * (size_t)from], &r->sectors);
            r->bordering = true;
        }
        r->fringe = r->fringe || p->fringe;
        if (p->rim != PC_INVALID_INDEX) {
            mark_sector(r, &rims->points.points[3 * (size_t)p->rim],
                        is_around(r, rims, p->rim) ? &r->sectors : &r->amid);
        }
    }
    return true;
}

static void find_backed(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const backing *b = user;
    const pci_halfedge *mesh = &b->outline->mesh;
    for (size_t t = begin; t < end; ++t) {
        if (b->regions[t] != PC_INVALID_INDEX && b->asked[b->regions[t]]) {
            const double *corners[3];
            double normal[3];
            area_vector(mesh, t, corners, normal);
            b->backed[t] = is_backed(b, corners, normal);
        }
    }
}

// Measures how much of the regions that are asked for has cloth behind it. False: out of memory, or
// cancelled.
static bool measure_backing(const pci_isoline *o, const uint32_t *of, const uint8_t *asked,
                            const pci_bvh *layer, double cell_size, region *regions) {
    const pci_halfedge *mesh = &o->mesh;
    backing b = {o,     of,        asked,
                 layer, cell_size, PCI_SCRATCH(mesh->scratch, uint8_t, mesh->triangle_count)};
    if (b.backed == NULL || !pci_parallel_while_wanted(mesh->scratch->context, mesh->triangle_count,
                                                       grain, find_backed, &b)) {
        return false;
    }
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        if (b.backed[t]) {
            const double *corners[3];
            double normal[3];
            area_vector(mesh, t, corners, normal);
            regions[of[t]].backed += 0.5 * pci_norm(normal);
        }
    }
    return true;
}

// Whether a region reaches far enough and is framed as a membrane is.
static bool may_go(const region *r, pci_outline_mode mode, double threshold, const demands *least) {
    uint32_t framed = 0;
    for (uint32_t i = 0; i < sectors; ++i) {
        framed += (r->sectors & ~r->amid) >> i & 1;
    }
    return r->reach > least->reach * threshold &&
           (mode == PCI_OUTLINE_ALL ||
            (framed >= least->framed && r->at_rims >= least->at_rims * r->frame &&
             (r->bordering || !r->fringe)));
}

// The kept triangles by patch: a membrane, or a connected part of the rest. Few of them touch.
typedef struct patches {
    uint32_t *of;    // #F, first triangle of the patch
    uint32_t *links; // #links by 2, neighbouring patches
    size_t link_count, link_capacity;
    double *areas; // by first triangle
    uint32_t *parents;
    double *sums; // scratch of area_held, likewise
} patches;

static bool make_patches(const pci_halfedge *mesh, const uint32_t *owners, const uint8_t *keep,
                         patches *p) {
    const size_t triangles = mesh->triangle_count;
    *p = (patches){.of = PCI_SCRATCH(mesh->scratch, uint32_t, triangles),
                   .areas = PCI_SCRATCH(mesh->scratch, double, triangles),
                   .parents = PCI_SCRATCH(mesh->scratch, uint32_t, triangles),
                   .sums = PCI_SCRATCH(mesh->scratch, double, triangles)};
    if (mesh->scratch->failed) {
        return false;
    }
    const pc_mesh surface = {mesh->vertex_count, mesh->positions, triangles, mesh->corners};
    pci_singletons(p->of, triangles);
    for (int pass = 0; pass < 2; ++pass) {
        for (uint32_t h = 0; h < 3 * triangles; ++h) {
            const uint32_t twin = mesh->twins[h];
            if (twin == PC_INVALID_INDEX || h > twin || !keep[h / 3] || !keep[twin / 3]) {
                continue;
            }
            const bool same = owners[h / 3] == owners[twin / 3];
            if (pass == 0 && same) {
                pci_unite(p->of, h / 3, twin / 3);
            } else if (pass == 1 && !same) {
                void *links = p->links;
                if (!pci_scratch_reserve(mesh->scratch, &links, &p->link_capacity,
                                         p->link_count + 1, 2 * sizeof(uint32_t))) {
                    return false;
                }
                p->links = links;
                p->links[2 * p->link_count] = pci_find_root(p->of, h / 3);
                p->links[2 * p->link_count++ + 1] = pci_find_root(p->of, twin / 3);
            }
        }
    }
    for (uint32_t t = 0; t < triangles; ++t) {
        p->areas[pci_find_root(p->of, t)] += pci_triangle_area(&surface, t);
    }
    return true;
}

// Area of what the patch `middle` holds to the largest of the parts beside it: they would come off.
static double area_held(const patches *p, const uint8_t *keep, uint32_t middle) {
    for (size_t i = 0; i < 2 * p->link_count; ++i) {
        p->parents[p->links[i]] = p->links[i];
        p->sums[p->links[i]] = p->areas[p->links[i]];
    }
    for (size_t i = 0; i < p->link_count; ++i) {
        const uint32_t a = p->links[2 * i], b = p->links[2 * i + 1];
        if (keep[a] && keep[b] && a != middle && b != middle) {
            const uint32_t from = pci_find_root(p->parents, a), to = pci_find_root(p->parents, b);
            if (pci_unite(p->parents, from, to)) {
                p->sums[pci_find_root(p->parents, to)] = p->sums[from] + p->sums[to];
            }
        }
    }
    double sum = 0.0, largest = 0.0;
    for (size_t i = 0; i < 2 * p->link_count; ++i) {
        const uint32_t other = p->links[i % 2 == 0 ? i + 1 : i - 1];
        if (p->links[i] == middle && keep[other]) {
            double *part = &p->sums[pci_find_root(p->parents, other)];
            sum += *part;
            largest = fmax(largest, *part);
            *part = 0.0; // counted
        }
    }
    return sum - largest;
}

// What a pass works with.
typedef struct cutting {
    const pci_bvh *visual;
    const pci_bvh *layer; // of the second pass
    const pci_rims *rims;
    pci_outline_mode mode;
    double threshold, cell_size;
    double isoline; // distance up to which regions go
    const demands *least;
    uint8_t *keep; // #F of the refined layer
    region *regions;
    size_t region_count;
} cutting;

// A membrane may hold the layer together, as between the panels of a pattern or around the hem of a
// tier: it stays where something larger than itself would come off. The triangles of those that
// are to go, by `removed`, are kept on entry.
static bool keep_holders(const pci_isoline *o, const uint32_t *of, const cutting *c,
                         uint8_t *removed) {
    const pci_halfedge *mesh = &o->mesh;
    uint32_t *owners = PCI_SCRATCH(mesh->scratch, uint32_t, mesh->triangle_count);
    patches p;
    if (owners == NULL) {
        return false;
    }
    for (uint32_t t = 0; t < mesh->triangle_count; ++t) {
        owners[t] = of[t] != PC_INVALID_INDEX && removed[of[t]] ? of[t] : PC_INVALID_INDEX;
    }
    if (!make_patches(mesh, owners, c->keep, &p)) {
        return false;
    }
    // The first triangle of a membrane tells that it is gone until all of them are removed.
    size_t tests = 0;
    for (size_t i = 0; i < c->region_count; ++i) {
        if (removed[i]) {
            const region *r = &c->regions[i];
            removed[i] = tests++ < most_tests && area_held(&p, c->keep, r->first) <= r->area;
            c->keep[r->first] = !removed[i];
        }
    }
    return true;
}

// Marks what stays.
static bool choose_triangles(const pci_isoline *o, const uint32_t *of, cutting *c) {
    const size_t triangles = o->mesh.triangle_count;
    uint8_t *removed = PCI_SCRATCH(o->mesh.scratch, uint8_t, c->region_count);
    c->keep = PCI_SCRATCH(o->mesh.scratch, uint8_t, triangles);
    if (o->mesh.scratch->failed) {
        return false;
    }
    for (size_t i = 0; i < c->region_count; ++i) {
        removed[i] = may_go(&c->regions[i], c->mode, c->threshold, c->least);
    }
    if (c->mode == PCI_OUTLINE_MEMBRANES) {
        if (!measure_backing(o, of, removed, c->layer, c->cell_size, c->regions)) {
            return false;
        }
        for (size_t i = 0; i < c->region_count; ++i) {
            removed[i] = removed[i] && c->regions[i].backed < c->least->backed * c->regions[i].area;
        }
    }
    memset(c->keep, 1, triangles);
    if (c->mode == PCI_OUTLINE_MEMBRANES && c->least == &of_membranes &&
        !keep_holders(o, of, c, removed)) {
        return false;
    }
    for (size_t t = 0; t < triangles; ++t) {
        c->keep[t] = of[t] == PC_INVALID_INDEX || !removed[of[t]];
    }
    return true;
}

// Refines the layer along the isoline, where points of `focus` are within `reach` (NULL:
// everywhere), and decides what to keep by the demands of `c`.
static bool find_regions(cutting *c, const pci_knn *focus, double reach, pci_scratch *scratch,
                         const pc_mesh *layer, pci_isoline *o) {
    // Finer than an eighth of a voxel there is nothing to see, and a layer that runs near the
    // threshold everywhere would be refined everywhere.
    const double shortest = c->least->fineness * fmax(c->threshold, 0.25 * c->cell_size);
    *o = (pci_isoline){
        .visual = c->visual, .focus = focus, .reach = reach, .coarse = c->least == &of_candidates};
    if (!pci_isoline_refine(scratch, layer, c->isoline, shortest, o)) {
        return false;
    }
    uint32_t *of = PCI_SCRATCH(scratch, uint32_t, o->mesh.triangle_count);
    if (of == NULL || !join_regions(o, c->isoline, of, &c->regions, &c->region_count)) {
        return false;
    }
    measure_extent(o, of, c->regions, c->region_count);
    return (c->mode == PCI_OUTLINE_ALL ||
            measure_frame(o, c->rims, sag * c->cell_size, of, c->regions)) &&
           choose_triangles(o, of, c);
}

// What stays, as it was before the splits wherever nothing is cut away: triangles that were small
// in order to look closely cost all that follows time. The outline is of no use afterwards.
static bool take_kept(pci_isoline *o, size_t first, uint8_t *keep, pc_mesh *kept) {
    pci_halfedge *mesh = &o->mesh;
    pci_isoline_undo(o, first, keep);
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        if (mesh->corners[3 * t] == PC_INVALID_INDEX) {
            keep[t] = 0;
            memset(&mesh->corners[3 * t], 0, 3 * sizeof(*mesh->corners));
        }
    }
    const pc_mesh all = pci_halfedge_view(mesh);
    pc_mesh cut = {0};
    pci_repair_counts counts;
    const bool done = pci_mesh_compact(mesh->scratch, &all, keep, &cut, NULL) &&
                      pci_mesh_repair(mesh->scratch, &cut, NULL, kept, &counts);
    pc_mesh_free(mesh->scratch->context, &cut);
    return done;
}

// Lists the vertices of what is not kept. False: out of memory.
static bool list_removed(pci_scratch *scratch, const pci_isoline *o, const cutting *c,
                         pci_knn *points) {
    const pci_halfedge *mesh = &o->mesh;
    uint8_t *listed = PCI_SCRATCH(mesh->scratch, uint8_t, mesh->vertex_count);
    size_t count = 0, next = 0;
    if (listed == NULL) {
        return false;
    }
    for (size_t i = 0; i < 3 * mesh->triangle_count; ++i) {
        uint8_t *at = &listed[mesh->corners[i]];
        count += !c->keep[i / 3] && !*at;
        *at |= !c->keep[i / 3];
    }
    double *positions = PCI_SCRATCH(scratch, double, 3 * count);
    for (size_t v = 0; positions != NULL && v < mesh->vertex_count; ++v) {
        if (listed[v]) {
            memcpy(&positions[3 * next++], &mesh->positions[3 * v], 3 * sizeof(double));
        }
    }
    return positions != NULL && pci_knn_build(scratch, count, positions, points);
}

pc_status pci_cut_outline(pci_scratch *scratch, const char *stage, const pci_bvh *visual,
                          const pci_rims *rims, pci_outline_mode mode, double threshold,
                          double cell_size, pc_mesh *layer, uint64_t *removed_regions,
                          uint64_t *removed_triangles) {
    pc_context *context = scratch->context;
    cutting c = {.visual = visual,
                 .rims = rims,
                 .mode = mode,
                 .threshold = threshold,
                 .cell_size = cell_size,
                 .isoline = mode == PCI_OUTLINE_ALL ? threshold : followed * threshold,
                 .least = &of_candidates};
    pci_isoline o;
    // The first pass finds candidates, the second refines near them, decides and cuts.
    pci_scratch first = pci_scratch_begin(context);
    pci_knn candidates;
    const bool found = find_regions(&c, mode == PCI_OUTLINE_MEMBRANES ? &rims->points : NULL,
                                    widest * cell_size, &first, layer, &o) &&
                       list_removed(scratch, &o, &c, &candidates);
    pci_scratch_end(&first);
    if (!found) {
        return pci_fail_memory(context, stage);
    }
    if (candidates.point_count == 0) {
        return PC_OK;
    }
    pci_bvh *bvh = NULL;
    if (mode == PCI_OUTLINE_MEMBRANES) {
        const pc_status status = pci_bvh_create(context, stage, layer, &bvh);
        if (status != PC_OK) {
            return status;
        }
    }
    c.least = &of_membranes;
    c.layer = bvh;
    const bool chosen = find_regions(&c, &candidates, beyond * cell_size, scratch, layer, &o);
    pci_bvh_destroy(context, bvh);
    if (!chosen) {
        return pci_fail_memory(context, stage);
    }
    uint64_t removed = 0;
    for (size_t t = 0; t < o.mesh.triangle_count; ++t) {
        removed += !c.keep[t];
    }
    if (removed == 0) {
        return PC_OK;
    }
    *removed_triangles += removed;
    for (size_t i = 0; i < c.region_count; ++i) {
        *removed_regions += !c.keep[c.regions[i].first];
    }
    pc_mesh kept = {0};
    if (!take_kept(&o, layer->vertex_count, c.keep, &kept)) {
        return pci_fail_memory(context, stage);
    }
    pc_mesh_free(context, layer);
    *layer = kept;
    return PC_OK;
}
