#include "proxycloth/parts.h"

#include <stdlib.h>

#include "core/union_find.h"
#include "geometry/bvh.h"
#include "geometry/knn.h"
#include "geometry/topology.h"

static const char name[] = "parts";

// Nearer than this, in diagonals, a piece lies on another one.
static const double cover_distance = 0.01;
// Share of the area that has to lie on another piece.
static const double covered_share = 0.5;
// Share of the whole area below which a piece is decoration; so there are at most 50 parts.
static const double small_share = 0.02;
// Share of the border of a piece that has to run along the border of another one.
static const double sewn_share = 0.25;
// Fewest vertices of a proxy.
static const uint32_t least_vertices = 4;

enum { grain = 256 };

// A set of triangles that share positions or are sewn together.
typedef struct piece {
    double area;
    uint32_t index; // in the order of first triangles
    uint32_t part;
    uint32_t *triangles;
    size_t triangle_count;
    pci_bvh *bvh; // NULL: too small to carry others
    pc_mesh mesh; // what the BVH looks at
} piece;

static int compare_pieces(const void *a, const void *b) { // largest first
    const piece *x = a, *y = b;
    if (x->area != y->area) {
        return x->area > y->area ? -1 : 1;
    }
    return (x->index > y->index) - (x->index < y->index);
}

// ---- seams --------------------------------------------------------------------------------------

// A bit of an edge of one triangle, and the piece whose border is the nearest to it.
typedef struct border_bit {
    uint32_t piece, other; // vertices that stand for them
    double length;
} border_bit;

static int compare_bits(const void *left, const void *right) {
    const border_bit *a = left, *b = right;
    if (a->piece != b->piece) {
        return a->piece < b->piece ? -1 : 1;
    }
    if (a->other != b->other) {
        return a->other < b->other ? -1 : 1;
    }
    return (a->length > b->length) - (a->length < b->length);
}

// Bits no longer than `longest`, and their middles.
static bool find_border(pci_scratch *scratch, const pc_mesh *mesh, double longest,
                        uint32_t *parents, border_bit **bits, pci_knn *middles) {
    pci_topology topology;
    size_t count = 0, bit_capacity = 0, point_capacity = 0;
    void *all = NULL, *points = NULL;
    if (!pci_topology_build(scratch, mesh, &topology)) {
        return false;
    }
    for (size_t e = 0; e < topology.edge_count; ++e) {
        if (pci_side_count(&topology, e) != 1) {
            continue;
        }
        const double *a = &mesh->positions[3 * (size_t)topology.edges[2 * e]];
        const double *b = &mesh->positions[3 * (size_t)topology.edges[2 * e + 1]];
        const double length = sqrt(pci_squared_distance(a, b));
        const size_t pieces = 1 + (size_t)(length / longest);
        if (!pci_scratch_reserve(scratch, &all, &bit_capacity, count + pieces,
                                 sizeof(border_bit)) ||
            !pci_scratch_reserve(scratch, &points, &point_capacity, count + pieces,
                                 3 * sizeof(double))) {
            return false;
        }
        for (size_t i = 0; i < pieces; ++i, ++count) {
            const double share = ((double)i + 0.5) / (double)pieces;
            for (size_t k = 0; k < 3; ++k) {
                ((double *)points)[3 * count + k] = a[k] + share * (b[k] - a[k]);
            }
            ((border_bit *)all)[count] = (border_bit){pci_find_root(parents, topology.edges[2 * e]),
                                                      PC_INVALID_INDEX, length / (double)pieces};
        }
    }
    *bits = all;
    return pci_knn_build(scratch, count, points, middles);
}

// Joins the pieces whose borders run along each other, as the panels of a pattern do.
static bool sew_pieces(pci_scratch *scratch, const pc_mesh *mesh, uint32_t *parents) {
    enum { most_near = 16 };
    const double reach = cover_distance * pci_diagonal(mesh);
    border_bit *bits = NULL;
    pci_knn middles;
    double *lengths = PCI_SCRATCH(scratch, double, mesh->vertex_count); // of borders, by piece
    if (lengths == NULL || !find_border(scratch, mesh, reach, parents, &bits, &middles)) {
        return false;
    }
    if (bits == NULL) {
        return true; // nothing has a border
    }
    for (uint32_t i = 0; i < middles.point_count; ++i) {
        uint32_t near[most_near];
        double squares[most_near];
        const size_t count =
            pci_knn_query(&middles, &middles.points[3 * (size_t)i], most_near, i, near, squares);
        lengths[bits[i].piece] += bits[i].length;
        for (size_t k = count; k-- > 0;) {
            if (squares[k] <= reach * reach && bits[near[k]].piece != bits[i].piece) {
                bits[i].other = bits[near[k]].piece;
            }
        }
    }
    qsort(bits, middles.point_count, sizeof(*bits), compare_bits);
    double along = 0.0;
    for (size_t i = 0; i < middles.point_count; ++i) {
        const border_bit *e = &bits[i];
        const bool same = i > 0 && e->piece == e[-1].piece && e->other == e[-1].other;
        along = same ? along + e->length : e->length;
        if (e->other != PC_INVALID_INDEX && along >= sewn_share * lengths[e->piece]) {
            pci_unite(parents, e->piece, e->other);
        }
    }
    return true;
}

// ---- pieces -------------------------------------------------------------------------------------

// Triangles grouped by piece, the pieces largest first.
static bool find_pieces(pci_scratch *scratch, const pc_mesh *mesh, piece **pieces, size_t *count) {
    uint32_t *parents = PCI_SCRATCH(scratch, uint32_t, mesh->vertex_count);
    uint32_t *number = PCI_SCRATCH(scratch, uint32_t, mesh->vertex_count);
    uint32_t *triangles = PCI_SCRATCH(scratch, uint32_t, mesh->triangle_count);
    if (scratch->failed) {
        return false;
    }
    (void)pci_vertex_components(mesh, parents);
    if (!sew_pieces(scratch, mesh, parents)) {
        return false;
    }
    memset(number, 0xff, mesh->vertex_count * sizeof(*number));
    *count = 0;
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        uint32_t *n = &number[pci_find_root(parents, mesh->triangles[3 * t])];
        *n = *n == PC_INVALID_INDEX ? (uint32_t)(*count)++ : *n;
    }
    *pieces = PCI_SCRATCH(scratch, piece, *count);
    if (*pieces == NULL) {
        return false;
    }
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        piece *p = &(*pieces)[number[pci_find_root(parents, mesh->triangles[3 * t])]];
        p->area += pci_triangle_area(mesh, t);
        ++p->triangle_count;
    }
    for (uint32_t i = 0; i < *count; ++i) {
        (*pieces)[i].index = i;
        (*pieces)[i].triangles = triangles;
        triangles += (*pieces)[i].triangle_count;
        (*pieces)[i].triangle_count = 0;
    }
    for (uint32_t t = 0; t < mesh->triangle_count; ++t) {
        piece *p = &(*pieces)[number[pci_find_root(parents, mesh->triangles[3 * (size_t)t])]];
        p->triangles[p->triangle_count++] = t;
    }
    qsort(*pieces, *count, sizeof(**pieces), compare_pieces);
    return true;
}

// The piece as a mesh of its own, which others can lie on.
static pc_status make_carrier(pci_scratch *scratch, const pc_mesh *mesh, piece *p) {
    p->mesh = (pc_mesh){mesh->vertex_count, mesh->positions, p->triangle_count,
                        PCI_SCRATCH(scratch, uint32_t, 3 * p->triangle_count)};
    if (p->mesh.triangles == NULL) {
        return pci_fail_memory(scratch->context, name);
    }
    for (size_t i = 0; i < p->triangle_count; ++i) {
        memcpy(&p->mesh.triangles[3 * i], &mesh->triangles[3 * (size_t)p->triangles[i]],
               3 * sizeof(uint32_t));
    }
    return pci_bvh_create(scratch->context, name, &p->mesh, &p->bvh);
}

// ---- joining ----------------------------------------------------------------------------------

typedef struct joining {
    const pc_mesh *mesh;
    const piece *pieces; // the first `earlier` ones have a part
    size_t earlier;
    const piece *joined;
    double reach;
    uint32_t *parts;   // per triangle of the piece: nearest part within reach, or none
    double *distances; // likewise, how near
} joining;

// Nearest earlier part of each triangle, seen from its centroid.
static void find_neighbours(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    joining *j = user;
    for (size_t i = begin; i < end; ++i) {
        const uint32_t *corner = &j->mesh->triangles[3 * (size_t)j->joined->triangles[i]];
        double centroid[3];
        for (size_t k = 0; k < 3; ++k) {
            centroid[k] = (j->mesh->positions[3 * (size_t)corner[0] + k] +
                           j->mesh->positions[3 * (size_t)corner[1] + k] +
                           j->mesh->positions[3 * (size_t)corner[2] + k]) /
                          3.0;
        }
        j->parts[i] = PC_INVALID_INDEX;
        j->distances[i] = j->reach;
        for (size_t p = 0; p < j->earlier; ++p) {
            if (j->pieces[p].bvh == NULL) {
                continue;
            }
            const pci_closest closest =
                pci_bvh_closest(j->pieces[p].bvh, centroid, j->distances[i]);
            if (closest.triangle != PC_INVALID_INDEX &&
                (j->parts[i] == PC_INVALID_INDEX || closest.distance < j->distances[i])) {
                j->parts[i] = j->pieces[p].part;
                j->distances[i] = closest.distance;
            }
        }
    }
}

// The part that covers most of the piece, if enough of it is covered.
static uint32_t covering_part(const joining *j, size_t part_count, double *covered) {
    double sum = 0.0;
    uint32_t best = 0;
    memset(covered, 0, part_count * sizeof(*covered));
    for (size_t i = 0; i < j->joined->triangle_count; ++i) {
        if (j->parts[i] != PC_INVALID_INDEX) {
            const double area = pci_triangle_area(j->mesh, j->joined->triangles[i]);
            covered[j->parts[i]] += area;
            sum += area;
        }
    }
    for (uint32_t part = 1; part < part_count; ++part) {
        best = covered[part] > covered[best] ? part : best;
    }
    return sum >= covered_share * j->joined->area && sum > 0.0 ? best : PC_INVALID_INDEX;
}

static uint32_t nearest_part(const joining *j) {
    size_t best = 0;
    for (size_t i = 1; i < j->joined->triangle_count; ++i) {
        best = j->distances[i] < j->distances[best] ? i : best;
    }
    return j->parts[best];
}

// Gives every piece its part; returns their number in `part_count`.
static pc_status join_pieces(pci_scratch *scratch, const pc_mesh *mesh, piece *pieces, size_t count,
                             size_t *part_count) {
    pc_context *context = scratch->context;
    const double reach = cover_distance * pci_diagonal(mesh);
    double *covered = PCI_SCRATCH(scratch, double, count), total = 0.0;
    joining j = {.mesh = mesh, .pieces = pieces};
    j.parts = PCI_SCRATCH(scratch, uint32_t, mesh->triangle_count);
    j.distances = PCI_SCRATCH(scratch, double, mesh->triangle_count);
    if (scratch->failed) {
        return pci_fail_memory(context, name);
    }
    for (size_t i = 0; i < count; ++i) {
        total += pieces[i].area;
    }
    *part_count = 0;
    for (size_t i = 0; i < count; ++i) {
        piece *p = &pieces[i];
        const bool small = i > 0 && p->area < small_share * total;
        j.earlier = i;
        j.joined = p;
        j.reach = small ? HUGE_VAL : reach;
        if (!pci_parallel_while_wanted(context, p->triangle_count, grain, find_neighbours, &j)) {
            return pci_fail_cancelled(context, name);
        }
        p->part = small ? nearest_part(&j) : covering_part(&j, *part_count, covered);
        if (p->part == PC_INVALID_INDEX) {
            p->part = (uint32_t)(*part_count)++;
        }
        if (!small) {
            const pc_status status = make_carrier(scratch, mesh, p);
            if (status != PC_OK) {
                return status;
            }
        }
    }
    return PC_OK;
}

// ---- extraction -------------------------------------------------------------------------------

// Copies `size` bytes of each marked element, in order; NULL stays NULL. False: out of memory.
static bool pick(pci_scratch *scratch, const void *from, size_t size, size_t count,
                 const uint8_t *marked, const void **picked) {
    *picked = NULL;
    if (from == NULL) {
        return true;
    }
    char *to = pci_scratch_allocate(scratch, count, size);
    *picked = to;
    for (size_t i = 0; to != NULL && i < count; ++i) {
        if (marked[i]) {
            memcpy(to, (const char *)from + i * size, size);
            to += size;
        }
    }
    return *picked != NULL;
}

// Numbers the marked elements in order, in place; returns how many there are.
static size_t number_marked(const uint8_t *marked, size_t count, uint32_t *numbers) {
    uint32_t next = 0;
    for (size_t i = 0; i < count; ++i) {
        numbers[i] = next;
        next += marked[i];
    }
    return next;
}

// One part, in the order of the visual mesh.
static pc_status extract(pci_scratch *scratch, const pc_visual *visual, const uint32_t *parts,
                         uint32_t part, pc_visual *result, pc_visual_report *report) {
    const size_t nc = visual->corner_count, nf = visual->surface.triangle_count;
    const size_t nm = visual->material_count;
    uint8_t *own_corners = PCI_SCRATCH(scratch, uint8_t, nc);
    uint8_t *own_triangles = PCI_SCRATCH(scratch, uint8_t, nf);
    uint8_t *own_materials = PCI_SCRATCH(scratch, uint8_t, nm);
    uint32_t *corner_numbers = PCI_SCRATCH(scratch, uint32_t, nc);
    uint32_t *material_numbers = PCI_SCRATCH(scratch, uint32_t, nm);
    double *positions = PCI_SCRATCH(scratch, double, 3 * nc);
    uint32_t *triangles = PCI_SCRATCH(scratch, uint32_t, 3 * nf);
    uint32_t *materials = PCI_SCRATCH(scratch, uint32_t, nf);
    if (scratch->failed) {
        return pci_fail_memory(scratch->context, name);
    }
    for (size_t t = 0; t < nf; ++t) {
        own_triangles[t] = parts[t] == part;
        for (size_t c = 0; c < 3 && own_triangles[t]; ++c) {
            own_corners[visual->corner_triangles[3 * t + c]] = 1;
        }
        own_materials[visual->triangle_materials[t]] |= own_triangles[t];
    }
    pc_visual_arrays arrays = {.positions = positions,
                               .triangles = triangles,
                               .triangle_materials = materials,
                               .part_count = visual->part_count,
                               .part_names = visual->part_names};
    arrays.vertex_count = number_marked(own_corners, nc, corner_numbers);
    arrays.material_count = number_marked(own_materials, nm, material_numbers);
    for (size_t c = 0; c < nc; ++c) {
        if (own_corners[c]) {
            memcpy(&positions[3 * (size_t)corner_numbers[c]],
                   &visual->surface.positions[3 * (size_t)visual->corner_vertices[c]],
                   3 * sizeof(*positions));
        }
    }
    for (size_t t = 0; t < nf; ++t) {
        if (own_triangles[t]) {
            for (size_t c = 0; c < 3; ++c) {
                triangles[3 * arrays.triangle_count + c] =
                    corner_numbers[visual->corner_triangles[3 * t + c]];
            }
            materials[arrays.triangle_count++] = material_numbers[visual->triangle_materials[t]];
        }
    }
    const struct {
        const void *from;
        size_t size, count;
        const uint8_t *marked;
    } sources[] = {{visual->normals, 3 * sizeof(float), nc, own_corners},
                   {visual->texcoords, 2 * sizeof(float), nc, own_corners},
                   {visual->colors, 4 * sizeof(float), nc, own_corners},
                   {visual->joints, 4 * sizeof(uint32_t), nc, own_corners},
                   {visual->joint_weights, 4 * sizeof(float), nc, own_corners},
                   {visual->materials, sizeof(pc_material), nm, own_materials},
                   {visual->triangle_parts, sizeof(uint32_t), nf, own_triangles}};
    enum { source_count = sizeof(sources) / sizeof(sources[0]) };
    const void *picked[source_count];
    for (size_t i = 0; i < source_count; ++i) {
        if (!pick(scratch, sources[i].from, sources[i].size, sources[i].count, sources[i].marked,
                  &picked[i])) {
            return pci_fail_memory(scratch->context, name);
        }
    }
    arrays.normals = picked[0];
    arrays.texcoords = picked[1];
    arrays.colors = picked[2];
    arrays.joints = picked[3];
    arrays.joint_weights = picked[4];
    arrays.materials = picked[5];
    arrays.triangle_parts = picked[6];
    return pc_visual_create(scratch->context, &arrays, result, report);
}

static pc_status extract_all(pc_context *context, const pc_visual *visual, const uint32_t *parts,
                             size_t part_count, pc_parts *result) {
    result->visuals = PCI_ALLOCATE(context, pc_visual, part_count);
    result->reports = PCI_ALLOCATE(context, pc_visual_report, part_count);
    if (result->visuals == NULL || result->reports == NULL) {
        return pci_fail_memory(context, name);
    }
    pc_status status = PC_OK;
    for (uint32_t i = 0; i < part_count && status == PC_OK; ++i) {
        pci_scratch scratch = pci_scratch_begin(context);
        result->part_count = i + 1;
        status = extract(&scratch, visual, parts, i, &result->visuals[i], &result->reports[i]);
        pci_scratch_end(&scratch);
    }
    return status;
}

void pc_parts_free(pc_context *context, pc_parts *parts) {
    if (parts != NULL) {
        for (size_t i = 0; i < parts->part_count; ++i) {
            pc_visual_free(context, &parts->visuals[i]);
        }
        pc_release(context, parts->visuals);
        pc_release(context, parts->reports);
        memset(parts, 0, sizeof(*parts));
    }
}

pc_status pc_split_visual(pc_context *context, const pc_visual *visual, pc_parts *parts) {
    if (visual == NULL || visual->surface.triangle_count == 0 || parts == NULL ||
        parts->visuals != NULL || parts->reports != NULL) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, name,
                        "parts: a visual mesh and an empty output are needed");
    }
    if (!pci_progress(context, name, 0.0)) {
        return pci_fail_cancelled(context, name);
    }
    const pc_mesh *mesh = &visual->surface;
    pci_scratch scratch = pci_scratch_begin(context);
    piece *pieces = NULL;
    size_t piece_count = 0, part_count = 0;
    uint32_t *triangle_parts = PCI_SCRATCH(&scratch, uint32_t, mesh->triangle_count);
    pc_status status = PC_OK;
    if (triangle_parts == NULL || !find_pieces(&scratch, mesh, &pieces, &piece_count)) {
        status = pci_fail_memory(context, name);
    } else {
        status = join_pieces(&scratch, mesh, pieces, piece_count, &part_count);
    }
    pc_parts result = {0};
    if (status == PC_OK) {
        for (size_t i = 0; i < piece_count; ++i) {
            for (size_t k = 0; k < pieces[i].triangle_count; ++k) {
                triangle_parts[pieces[i].triangles[k]] = pieces[i].part;
            }
        }
        status = extract_all(context, visual, triangle_parts, part_count, &result);
    }
    for (size_t i = 0; pieces != NULL && i < piece_count; ++i) {
        pci_bvh_destroy(context, pieces[i].bvh);
    }
    pci_scratch_end(&scratch);
    if (status != PC_OK) {
        pc_parts_free(context, &result);
        return status;
    }
    *parts = result;
    return PC_OK;
}

pc_status pc_share_vertices(pc_context *context, size_t part_count, const double *areas,
                            uint32_t vertices, uint32_t *shares) {
    if (part_count == 0 || areas == NULL || shares == NULL) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, name,
                        "parts: areas and shares of at least one part are needed");
    }
    for (size_t i = 0; i < part_count; ++i) {
        if (!(areas[i] >= 0.0) || !isfinite(areas[i])) {
            return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, name,
                            "parts: area %zu is %g, must be at least 0", i, areas[i]);
        }
        shares[i] = least_vertices;
    }
    // One vertex after the other goes where the most area falls on a vertex.
    for (uint64_t used = (uint64_t)least_vertices * part_count; used < vertices; ++used) {
        size_t best = 0;
        for (size_t i = 1; i < part_count; ++i) {
            best = areas[i] * shares[best] > areas[best] * shares[i] ? i : best;
        }
        ++shares[best];
    }
    return PC_OK;
}
