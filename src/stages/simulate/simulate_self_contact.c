// Contacts of the cloth with itself: vertices stay on their sides of triangles that are not next to
// them. The side of a pair is what it was when the two came near, and is kept as long as the vertex
// is before the triangle, so that one that has got through is brought back.
#include "geometry/bvh.h"
#include "geometry/topology.h"
#include "stages/simulate/simulate_internal.h"

// Triangles near a vertex that are kept, at most: more than where a garment is crumpled.
enum { PAIRS = 32 };
// Times that contacts are found again at the end of a substep.
enum { FINISHING = 3 };
// Pairs are found up to the distance to keep and this many mean edges more.
static const double margin_edges = 0.5;
// A side is remembered up to this barycentric coordinate beside the triangle.
static const double least_kept = -0.5;
// Pairs are found up to this one.
static const double least_found = -1.0;
// Triangles go on beyond borders up to this one, so that borders that lie on each other meet.
static const double least_border = -0.25;
// Steps for which a vertex that has got through is pushed back; what lasts longer is entangled.
static const uint8_t most_steps = 15;
// Share of the distance at rest that is kept where that is smaller.
static const double rest_share = 0.8;
// Speed at which cloth leaves where it has got through, m/s: faster would throw it.
static const double leaving_speed = 1.0;
// Contacts give way, and their sides are forgotten, where an edge is stretched or shortened by more
// than this many strain limits.
static const double caught_strain = 2.0;

// A triangle near a vertex.
typedef struct pair {
    uint32_t triangle;
    int8_t side;   // of the triangle: 1 where its normal points, -1, 0: not known yet
    int8_t now;    // the side in this step, also where the vertex only may come before the triangle
    uint8_t wrong; // steps for which it has been on the other side
    double distance; // to keep
    double pushed;   // in this substep, distance
} pair;

// The plane of a triangle as it is in some positions, with what gives barycentric coordinates.
typedef struct plane {
    double origin[3], normal[3], along[2][3];
    uint64_t number; // of the positions
} plane;

// A set of planes, each computed when it is asked for.
typedef struct planes {
    plane *planes; // #F
    const double *x;
    uint64_t number;
} planes;

// A contact of this substep: (vertex - triangle's point) . normal >= target.
typedef struct press {
    uint32_t corner[4]; // the vertex, then the triangle's
    double share[4];    // 1, then minus the barycentric coordinates
    double normal[3];
    double target;
    double scale; // moves by distance
    pair *pair;
} press;

struct pci_self_contact {
    size_t vertex_count, triangle_count;
    const uint32_t *triangles;
    const double *rest; // #V by 3
    const size_t *ring_offsets;
    const uint32_t *ring;
    uint32_t *next_to; // #V, the last triangle that a vertex is next to
    uint8_t *caught;   // #V, at an edge that is strained too far
    uint8_t *open;     // #F, bit c: the edge across corner c is a border
    double distance, reach, friction;
    double *reference;        // #V by 3, where the pairs were found
    pair *pairs, *older;      // #V by PAIRS
    uint8_t *counts, *olders; // #V, how many
    size_t cell_capacity;
    uint32_t *cell_starts, *cell_vertices, *vertex_cells;
    planes then, now; // at the start of the step or substep; since the last search
    size_t press_count, press_capacity;
    press *presses;
};

// ---- geometry -----------------------------------------------------------------------------------

static void begin_planes(planes *set, const double *x) {
    set->x = x;
    ++set->number;
}

static const plane *plane_of(planes *set, const uint32_t *corner, size_t triangle) {
    plane *at = &set->planes[triangle];
    if (at->number == set->number) {
        return at;
    }
    const double *a = &set->x[3 * (size_t)corner[0]];
    double ab[3], ac[3];
    pci_sub(&set->x[3 * (size_t)corner[1]], a, ab);
    pci_sub(&set->x[3 * (size_t)corner[2]], a, ac);
    pci_cross(ab, ac, at->normal);
    // Nothing is before a triangle without area: its coordinates are no numbers.
    const double squared = pci_dot(at->normal, at->normal);
    const double inverse = squared > 0.0 ? 1.0 / squared : (double)NAN;
    pci_cross(ac, at->normal, at->along[0]);
    pci_cross(at->normal, ab, at->along[1]);
    const double scale = sqrt(inverse);
    for (size_t k = 0; k < 3; ++k) {
        at->origin[k] = a[k];
        at->along[0][k] *= inverse;
        at->along[1][k] *= inverse;
        at->normal[k] *= scale;
    }
    at->number = set->number;
    return at;
}

// Signed distance of a point from the plane, and barycentric coordinates of its projection.
static double project(const plane *at, const double point[3], double share[3]) {
    double offset[3];
    pci_sub(point, at->origin, offset);
    share[1] = pci_dot(offset, at->along[0]);
    share[2] = pci_dot(offset, at->along[1]);
    share[0] = 1.0 - share[1] - share[2];
    return pci_dot(offset, at->normal);
}

// Whether a projection has left the triangle, over a border or far over another edge.
static bool has_left(const pci_self_contact *self, size_t triangle, const double share[3],
                     double limit) {
    for (size_t c = 0; c < 3; ++c) {
        const bool open = ((uint32_t)self->open[triangle] >> c & 1U) != 0;
        if (!(share[c] >= (open ? least_border : limit))) {
            return true;
        }
    }
    return false;
}

// The distance that a vertex and a triangle have to keep.
static double distance_to_keep(const pci_self_contact *self, size_t vertex, size_t triangle) {
    const double *x = self->rest;
    const uint32_t *corner = &self->triangles[3 * triangle];
    double barycentric[3];
    const double rest = sqrt(pci_triangle_squared_distance(
        &x[3 * vertex], &x[3 * (size_t)corner[0]], &x[3 * (size_t)corner[1]],
        &x[3 * (size_t)corner[2]], barycentric));
    return fmin(self->distance, rest_share * rest);
}

// ---- pairs --------------------------------------------------------------------------------------

// Marks the corners of a triangle and the vertices next to them, which may be as near as they like.
static void mark_ring(pci_self_contact *self, size_t triangle) {
    const uint32_t *corner = &self->triangles[3 * triangle];
    for (size_t c = 0; c < 3; ++c) {
        self->next_to[corner[c]] = (uint32_t)triangle;
        for (size_t i = self->ring_offsets[corner[c]]; i < self->ring_offsets[corner[c] + 1]; ++i) {
            self->next_to[self->ring[i]] = (uint32_t)triangle;
        }
    }
}

static void add_pair(pci_self_contact *self, const double *x, const plane *at, size_t vertex,
                     size_t triangle) {
    double share[3];
    if (fabs(project(at, &x[3 * vertex], share)) > self->reach ||
        has_left(self, triangle, share, least_found) || self->counts[vertex] == PAIRS) {
        return;
    }
    pair *added = &self->pairs[PAIRS * vertex + self->counts[vertex]++];
    const pair *older = &self->older[PAIRS * vertex];
    added->triangle = (uint32_t)triangle;
    for (size_t i = 0; i < self->olders[vertex]; ++i) {
        if (older[i].triangle == triangle) {
            *added = older[i];
            return;
        }
    }
    added->side = added->now = 0;
    added->wrong = 0;
    added->pushed = 0.0;
    added->distance = distance_to_keep(self, vertex, triangle);
}

// A grid over the vertices, along x first.
typedef struct grid {
    double origin[3], inverse; // 1 / width of a cell
    size_t size[3];
} grid;

// The cell of a position along an axis; positions outside belong to the border cells.
static size_t cell_at(const grid *g, size_t axis, double position) {
    const double at = (position - g->origin[axis]) * g->inverse;
    return at > 0.0 ? (size_t)pci_smaller(at, (double)(g->size[axis] - 1)) : 0;
}

// Sorts the vertices into cells. False: positions are not finite.
static bool fill_grid(pci_self_contact *self, const double *x, grid *g) {
    const pc_mesh points = {.vertex_count = self->vertex_count, .positions = (double *)x};
    double most[3], extent[3];
    pci_bounding_box(&points, g->origin, most);
    double widest = 0.0;
    for (size_t k = 0; k < 3; ++k) {
        extent[k] = most[k] - g->origin[k];
        widest = fmax(widest, extent[k]);
    }
    if (!(widest < 1e100)) {
        return false;
    }
    // Cells as wide as the reach, or so many as there is room for.
    double cell = fmax(self->reach, 1e-6 * widest), count;
    do {
        count = 1.0;
        g->inverse = 1.0 / cell;
        for (size_t k = 0; k < 3; ++k) {
            g->size[k] = 1 + (size_t)(extent[k] * g->inverse);
            count *= (double)g->size[k];
        }
        cell *= 1.26;
    } while (count > (double)self->cell_capacity);
    const size_t cells = g->size[0] * g->size[1] * g->size[2];
    memset(self->cell_starts, 0, (cells + 1) * sizeof(uint32_t));
    for (size_t v = 0; v < self->vertex_count; ++v) {
        const size_t at =
            cell_at(g, 0, x[3 * v]) +
            g->size[0] * (cell_at(g, 1, x[3 * v + 1]) + g->size[1] * cell_at(g, 2, x[3 * v + 2]));
        self->vertex_cells[v] = (uint32_t)at;
        ++self->cell_starts[at + 1];
    }
    for (size_t i = 0; i < cells; ++i) {
        self->cell_starts[i + 1] += self->cell_starts[i];
    }
    for (size_t v = self->vertex_count; v-- > 0;) { // starts become ends, then starts again
        self->cell_vertices[--self->cell_starts[self->vertex_cells[v] + 1]] = (uint32_t)v;
    }
    memmove(self->cell_starts, self->cell_starts + 1, cells * sizeof(uint32_t));
    self->cell_starts[cells] = (uint32_t)self->vertex_count;
    return true;
}

// Pairs of the triangle with the vertices in the box around it.
static void add_pairs_of(pci_self_contact *self, const double *x, const grid *g, size_t triangle) {
    const uint32_t *corner = &self->triangles[3 * triangle];
    const plane *at_triangle = plane_of(&self->then, corner, triangle);
    mark_ring(self, triangle);
    double least_at[3], most_at[3];
    size_t low[3], high[3];
    for (size_t k = 0; k < 3; ++k) {
        const double a = x[3 * (size_t)corner[0] + k], b = x[3 * (size_t)corner[1] + k];
        const double c = x[3 * (size_t)corner[2] + k];
        least_at[k] = pci_smaller(a, pci_smaller(b, c)) - self->reach;
        most_at[k] = pci_larger(a, pci_larger(b, c)) + self->reach;
        low[k] = cell_at(g, k, least_at[k]);
        high[k] = cell_at(g, k, most_at[k]);
    }
    for (size_t j = low[2]; j <= high[2]; ++j) {
        for (size_t i = low[1]; i <= high[1]; ++i) {
            const size_t row = g->size[0] * (i + g->size[1] * j);
            const uint32_t end = self->cell_starts[row + high[0] + 1];
            for (uint32_t n = self->cell_starts[row + low[0]]; n < end; ++n) {
                const size_t v = self->cell_vertices[n];
                const double *at = &x[3 * v];
                if (self->next_to[v] != triangle && at[0] >= least_at[0] && at[0] <= most_at[0] &&
                    at[1] >= least_at[1] && at[1] <= most_at[1] && at[2] >= least_at[2] &&
                    at[2] <= most_at[2]) {
                    add_pair(self, x, at_triangle, v, triangle);
                }
            }
        }
    }
}

static void find_pairs(pci_self_contact *self, const double *x) {
    grid g;
    pair *pairs = self->older;
    uint8_t *counts = self->olders;
    self->older = self->pairs, self->olders = self->counts;
    self->pairs = pairs, self->counts = counts;
    memset(self->counts, 0, self->vertex_count);
    memset(self->next_to, 0xff, self->vertex_count * sizeof(uint32_t));
    memcpy(self->reference, x, 3 * self->vertex_count * sizeof(double));
    if (fill_grid(self, x, &g)) {
        for (size_t t = 0; t < self->triangle_count; ++t) {
            add_pairs_of(self, x, &g, t);
        }
    }
}

// Whether some vertex went so far from where the pairs were found that others may have come near;
// what all did together does not matter.
static bool is_outdated(const pci_self_contact *self, const double *x) {
    double mean[3] = {0.0};
    for (size_t k = 0; k < 3 * self->vertex_count; ++k) {
        mean[k % 3] += (x[k] - self->reference[k]) / (double)self->vertex_count;
    }
    const double most = 0.5 * (self->reach - self->distance);
    for (size_t v = 0; v < self->vertex_count; ++v) {
        double moved[3];
        for (size_t k = 0; k < 3; ++k) {
            moved[k] = x[3 * v + k] - self->reference[3 * v + k] - mean[k];
        }
        if (!(pci_dot(moved, moved) <= most * most)) {
            return true;
        }
    }
    return false;
}

// ---- sides --------------------------------------------------------------------------------------

// 1 or -1 where two triangles share an edge: whether their normals agree; otherwise 0.
static int8_t agreement(const uint32_t *s, const uint32_t *t) {
    for (size_t i = 0; i < 3; ++i) {
        for (size_t j = 0; j < 3; ++j) {
            if (s[i] == t[j] && s[(i + 1) % 3] == t[(j + 1) % 3]) {
                return -1;
            }
            if (s[i] == t[(j + 1) % 3] && s[(i + 1) % 3] == t[j]) {
                return 1;
            }
        }
    }
    return 0;
}

static bool is_caught(const pci_self_contact *self, size_t vertex, size_t triangle) {
    const uint32_t *corner = &self->triangles[3 * triangle];
    return (self->caught[vertex] | self->caught[corner[0]] | self->caught[corner[1]] |
            self->caught[corner[2]]) != 0;
}

// Cloth between contacts that nothing can obey is strained beyond all measure: it passes until it
// is free again.
static void find_caught(pci_self_contact *self, const pci_cloth *cloth) {
    const double strain = caught_strain * cloth->strain_limit;
    const double *x = cloth->positions;
    memset(self->caught, 0, self->vertex_count);
    for (size_t i = 0; i < cloth->edge_block_count; ++i) {
        const pci_spring_block *block = &cloth->blocks[i];
        for (size_t l = 0; l < PCI_LANES; ++l) {
            const double longest = (1.0 + strain) * block->rest[l];
            const double shortest = fmax(1.0 - strain, 0.0) * block->rest[l];
            const double squared =
                pci_squared_distance(&x[3 * (size_t)block->a[l]], &x[3 * (size_t)block->b[l]]);
            if (squared > longest * longest || squared < shortest * shortest) {
                self->caught[block->a[l]] = self->caught[block->b[l]] = 1;
            }
        }
    }
}

// Where a vertex is: in the prism over the triangle, beside it, or far from that.
typedef enum place { FAR, BESIDE, BEFORE } place;
typedef struct look {
    place place;
    int8_t here; // side of the plane
} look;

static look look_at(pci_self_contact *self, size_t vertex, size_t triangle, const double *x) {
    double share[3];
    const plane *at = plane_of(&self->then, &self->triangles[3 * triangle], triangle);
    const double distance = project(at, &x[3 * vertex], share);
    if (has_left(self, triangle, share, least_kept) || is_caught(self, vertex, triangle)) {
        return (look){FAR, 0};
    }
    return (look){!has_left(self, triangle, share, 0.0) ? BEFORE : BESIDE, distance > 0.0 ? 1 : -1};
}

// The side of a triangle by one next to it, with a known side, that the vertex is at; 0: none.
static int8_t inherited_side(const pci_self_contact *self, const pair *pairs, const look *looks,
                             size_t count, size_t triangle, place where) {
    for (size_t i = 0; i < count; ++i) {
        if (pairs[i].side != 0 && looks[i].place == where) {
            const int8_t same = agreement(&self->triangles[3 * triangle],
                                          &self->triangles[3 * (size_t)pairs[i].triangle]);
            if (same != 0) {
                return (int8_t)(same * pairs[i].side);
            }
        }
    }
    return 0;
}

// The side of a vertex that comes before a triangle is where it is, or that of the triangle that it
// was before until now. One that leaves over a border, or around another edge, may return on the
// other side.
static void update_sides_of(pci_self_contact *self, size_t vertex, const double *x) {
    pair *pairs = &self->pairs[PAIRS * vertex];
    const size_t count = self->counts[vertex];
    look looks[PAIRS];
    for (size_t i = 0; i < count; ++i) {
        looks[i] = look_at(self, vertex, pairs[i].triangle, x);
    }
    for (size_t i = 0; i < count; ++i) {
        const int8_t side = pairs[i].side, here = looks[i].here;
        pairs[i].wrong = side * here < 0 ? (uint8_t)(pairs[i].wrong + 1) : 0;
        pairs[i].now = side;
        if (looks[i].place == FAR || pairs[i].wrong > most_steps ||
            (looks[i].place == BESIDE && side != here)) {
            pairs[i].now = 0;
        } else if (side == 0) {
            pairs[i].now = inherited_side(self, pairs, looks, count, pairs[i].triangle, BESIDE);
            pairs[i].now = pairs[i].now != 0 ? pairs[i].now : here;
        }
    }
    for (size_t i = 0; i < count; ++i) {
        pairs[i].side = pairs[i].now;
    }
    // In this step the vertex may also come before triangles that it is beside.
    for (size_t i = 0; i < count; ++i) {
        if (pairs[i].side == 0 && looks[i].place == BESIDE) {
            pairs[i].now = inherited_side(self, pairs, looks, count, pairs[i].triangle, BEFORE);
            pairs[i].now = pairs[i].now != 0 ? pairs[i].now : looks[i].here;
        }
    }
}

static void update_sides(pci_self_contact *self, const double *x) {
    for (size_t v = 0; v < self->vertex_count; ++v) {
        update_sides_of(self, v, x);
    }
}

void pci_self_contact_begin(pci_self_contact *self, const pci_cloth *cloth) {
    begin_planes(&self->then, cloth->positions);
    if (is_outdated(self, cloth->positions)) {
        find_pairs(self, cloth->positions);
    }
    find_caught(self, cloth);
    update_sides(self, cloth->positions);
}

// ---- contacts -----------------------------------------------------------------------------------

static void add_press(pci_self_contact *self, const pci_cloth *cloth, size_t vertex, pair *at,
                      double slack) {
    const uint32_t *corner = &self->triangles[3 * (size_t)at->triangle];
    const plane *now = plane_of(&self->now, corner, at->triangle);
    double share[3], before_share[3];
    if (at->now * project(now, &cloth->positions[3 * vertex], share) > 1.5 * at->distance ||
        has_left(self, at->triangle, share, 0.0) || self->press_count == self->press_capacity) {
        return;
    }
    const double before = project(plane_of(&self->then, corner, at->triangle),
                                  &cloth->previous[3 * vertex], before_share);
    press *added = &self->presses[self->press_count];
    double weight = cloth->inverse_mass[vertex];
    added->corner[0] = (uint32_t)vertex;
    added->share[0] = 1.0;
    for (size_t c = 0; c < 3; ++c) {
        added->corner[c + 1] = corner[c];
        added->share[c + 1] = -share[c];
        added->normal[c] = at->now * now->normal[c];
        weight += cloth->inverse_mass[corner[c]] * added->share[c + 1] * added->share[c + 1];
    }
    if (!(weight > 0.0)) {
        return; // all held
    }
    // No farther than what undoes the motion of this substep and leaves at the leaving speed.
    added->target = fmin(at->distance, at->now * before + slack);
    added->scale = 1.0 / weight;
    added->pair = at;
    ++self->press_count;
}

static void find_presses(pci_self_contact *self, const pci_cloth *cloth) {
    const double slack = leaving_speed * cloth->time_step / (double)cloth->substeps;
    begin_planes(&self->now, cloth->positions);
    self->press_count = 0;
    for (size_t v = 0; v < self->vertex_count; ++v) {
        for (size_t i = 0; i < self->counts[v]; ++i) {
            pair *at = &self->pairs[PAIRS * v + i];
            if (at->now != 0) {
                add_press(self, cloth, v, at, slack);
            }
        }
    }
}

void pci_self_contact_find(pci_self_contact *self, const pci_cloth *cloth) {
    begin_planes(&self->then, cloth->previous);
    for (size_t v = 0; v < self->vertex_count; ++v) {
        for (size_t i = 0; i < self->counts[v]; ++i) {
            self->pairs[PAIRS * v + i].pushed = 0.0;
        }
    }
    find_presses(self, cloth);
}

// How far the vertex is from the triangle's point, along the normal.
static double height(const press *p, const double *x) {
    double sum = 0.0;
    for (size_t c = 0; c < 4; ++c) {
        sum += p->share[c] * pci_dot(p->normal, &x[3 * (size_t)p->corner[c]]);
    }
    return sum;
}

// Moves the vertex and the triangle apart by a vector, shared by mass.
static void move_apart(const press *p, const double *inverse_mass, const double way[3], double *x) {
    for (size_t c = 0; c < 4; ++c) {
        const double share = p->scale * p->share[c] * inverse_mass[p->corner[c]];
        for (size_t k = 0; k < 3; ++k) {
            x[3 * (size_t)p->corner[c] + k] += share * way[k];
        }
    }
}

void pci_self_contact_solve(pci_self_contact *self, pci_cloth *cloth) {
    for (size_t i = 0; i < self->press_count; ++i) {
        press *p = &self->presses[i];
        const double depth = p->target - height(p, cloth->positions);
        if (depth > 0.0) {
            const double way[3] = {depth * p->normal[0], depth * p->normal[1],
                                   depth * p->normal[2]};
            move_apart(p, cloth->inverse_mass, way, cloth->positions);
            p->pair->pushed += depth;
        }
    }
}

// Takes the speed that the push gave, and speed along the triangle by friction.
static void brake(const pci_self_contact *self, pci_cloth *cloth, const press *p) {
    double moved[3] = {0.0}, along[3], way[3];
    for (size_t c = 0; c < 4; ++c) {
        for (size_t k = 0; k < 3; ++k) {
            const size_t at = 3 * (size_t)p->corner[c] + k;
            moved[k] += p->share[c] * (cloth->positions[at] - cloth->previous[at]);
        }
    }
    const double apart = pci_dot(moved, p->normal);
    for (size_t k = 0; k < 3; ++k) {
        along[k] = moved[k] - apart * p->normal[k];
    }
    const double length = pci_norm(along);
    const double kept = length > 0.0 ? fmin(1.0, self->friction * p->pair->pushed / length) : 0.0;
    for (size_t k = 0; k < 3; ++k) {
        way[k] = kept * along[k] + fmax(apart, 0.0) * p->normal[k];
    }
    // Velocities are positions minus `previous`: nothing but the speed changes here.
    move_apart(p, cloth->inverse_mass, way, cloth->previous);
}

void pci_self_contact_finish(pci_self_contact *self, pci_cloth *cloth) {
    // What was pushed out of one triangle may be in the next, and the strain was bounded since.
    for (size_t round = 0; round < FINISHING; ++round) {
        find_presses(self, cloth);
        pci_self_contact_solve(self, cloth);
    }
    for (size_t i = 0; i < self->press_count; ++i) {
        if (self->presses[i].pair->pushed > 0.0) {
            brake(self, cloth, &self->presses[i]);
        }
    }
}

// ---- set-up -------------------------------------------------------------------------------------

// Marks the edges that no other triangle has.
static void mark_borders(const pci_topology *topology, size_t triangle_count, uint8_t *open) {
    for (size_t t = 0; t < triangle_count; ++t) {
        for (size_t c = 0; c < 3; ++c) {
            const uint32_t e = topology->triangle_edges[3 * t + c];
            if (e < topology->edge_count && pci_side_count(topology, e) == 1) {
                open[t] |= (uint8_t)(1U << (c + 2) % 3); // the corner across
            }
        }
    }
}

bool pci_self_contact_create(pci_scratch *scratch, const pc_mesh *rest, double edges,
                             double friction, pci_self_contact **result) {
    const size_t nv = rest->vertex_count, nf = rest->triangle_count;
    pci_topology topology;
    pci_self_contact *self = PCI_SCRATCH(scratch, pci_self_contact, 1);
    if (self == NULL || !pci_topology_build(scratch, rest, &topology)) {
        return false;
    }
    const double edge = pci_mean_edge_length(rest, &topology);
    if (!(edge > 0.0)) {
        return true; // nothing but points
    }
    self->vertex_count = nv;
    self->triangle_count = nf;
    self->triangles = rest->triangles;
    self->rest = rest->positions;
    self->ring_offsets = topology.ring_offsets;
    self->ring = topology.ring;
    self->distance = edges * edge;
    self->reach = self->distance + margin_edges * edge;
    self->friction = friction;
    self->cell_capacity = 8 * nv + 64;
    self->press_capacity = 8 * nv;
    self->open = PCI_SCRATCH(scratch, uint8_t, nf);
    self->next_to = PCI_SCRATCH(scratch, uint32_t, nv);
    self->caught = PCI_SCRATCH(scratch, uint8_t, nv);
    self->reference = PCI_SCRATCH(scratch, double, 3 * nv);
    self->pairs = PCI_SCRATCH(scratch, pair, PAIRS * nv);
    self->older = PCI_SCRATCH(scratch, pair, PAIRS * nv);
    self->counts = PCI_SCRATCH(scratch, uint8_t, nv);
    self->olders = PCI_SCRATCH(scratch, uint8_t, nv);
    self->cell_starts = PCI_SCRATCH(scratch, uint32_t, self->cell_capacity + 2);
    self->cell_vertices = PCI_SCRATCH(scratch, uint32_t, nv);
    self->vertex_cells = PCI_SCRATCH(scratch, uint32_t, nv);
    self->then.planes = PCI_SCRATCH(scratch, plane, nf);
    self->now.planes = PCI_SCRATCH(scratch, plane, nf);
    self->presses = PCI_SCRATCH(scratch, press, self->press_capacity);
    if (scratch->failed) {
        return false;
    }
    mark_borders(&topology, nf, self->open);
    begin_planes(&self->then, self->rest);
    find_pairs(self, self->rest);
    update_sides(self, self->rest);
    *result = self;
    return true;
}
