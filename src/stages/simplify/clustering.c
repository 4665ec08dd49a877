#include "stages/simplify/clustering.h"

#include "core/heap.h"

typedef struct clustering {
    pci_scratch *scratch;
    const pci_halfedge *mesh;
    const pci_fans *fans;
    const double *weights, *scales;
    size_t count;            // clusters that are sought; those from here on are given
    size_t all;              // clusters
    const uint32_t *anchors; // vertices that get clusters of their own
    size_t anchor_count;
    uint8_t *anchored; // #V, whether it has got one, and stays there
    uint32_t *cluster;
    uint32_t *edges; // #edges by 2
    size_t edge_count;
    double *masses;                      // per cluster
    double *moments;                     // per cluster, 3: sum of weighted positions
    uint32_t *sizes;                     // per cluster, vertices
    uint32_t *modified;                  // per cluster, last pass that changed it
    uint32_t *pieces, *queue, *heaviest; // #V, #V, per cluster: work space of attach_orphans
    double *piece_masses;                // #V
    double origin[3];                    // positions count from here, against cancellation
    const pci_mirror *mirror;            // its plane holds the origin; NULL: there is none
    uint8_t *seam;                       // #V, whether it is on the seam
    uint32_t *seams;                     // per cluster, how many of its vertices are
    bool careful;                        // exchanges tear no cluster
} clustering;

// ---- seeds --------------------------------------------------------------------------------------

// Distances along edges to the seeds placed so far.
typedef struct seeding {
    clustering *clusters;
    double *distances; // #V
    pci_heap front;    // of the seed that spreads
    double reach;      // of a seed
    size_t count;      // seeds
} seeding;

static bool is_given(const clustering *c, size_t v) { return c->cluster[v] >= c->count; }

// Makes `vertex` a seed, which takes over what is within reach and nearer to it than to all earlier
// ones.
static bool plant(seeding *s, uint32_t vertex) {
    clustering *c = s->clusters;
    const pci_fans *fans = c->fans;
    const uint32_t seed = (uint32_t)s->count++;
    s->distances[vertex] = 0.0;
    c->cluster[vertex] = seed;
    if (!pci_keep_going(c->scratch->context) ||
        !pci_heap_push(c->scratch, &s->front, 0.0, vertex)) {
        return false;
    }
    pci_heap_entry entry;
    while (pci_heap_pop(&s->front, &entry)) {
        const uint32_t v = entry.item;
        if (entry.key > s->distances[v]) {
            continue;
        }
        for (size_t k = fans->offsets[v]; k < fans->offsets[v + 1]; ++k) {
            const uint32_t end = fans->ends[k];
            const double distance =
                entry.key + 0.5 * (c->scales[v] + c->scales[end]) * fans->lengths[k];
            if (distance < s->distances[end] && distance < s->reach && !c->anchored[end]) {
                s->distances[end] = distance;
                c->cluster[end] = seed;
                if (!pci_heap_push(c->scratch, &s->front, distance, end)) {
                    return false;
                }
            }
        }
    }
    return true;
}

// Plants seeds in the order of the vertices, none within reach of an earlier one, until all
// vertices are within reach of one; no more than `limit`. False: out of memory or cancelled.
static bool pack_seeds(seeding *s, uint32_t first, size_t limit) {
    const size_t nv = s->clusters->mesh->vertex_count;
    s->count = 0;
    for (size_t v = 0; v < nv; ++v) {
        s->distances[v] = is_given(s->clusters, v) ? -HUGE_VAL : HUGE_VAL;
    }
    for (size_t i = 0; i < nv && s->count < limit; ++i) {
        const uint32_t v = (uint32_t)((first + i) % nv);
        if (s->distances[v] == HUGE_VAL && !plant(s, v)) {
            return false;
        }
    }
    return true;
}

// Plants each new seed at the vertex farthest from all earlier ones, up to `limit`. Parts that no
// seed reaches are infinitely far and come first.
static bool fill_seeds(seeding *s, size_t limit) {
    clustering *c = s->clusters;
    pci_heap farthest = {0};
    for (size_t v = 0; v < c->mesh->vertex_count; ++v) {
        if (!is_given(c, v) &&
            !pci_heap_push(c->scratch, &farthest, -s->distances[v], (uint32_t)v)) {
            return false;
        }
    }
    s->reach = INFINITY;
    pci_heap_entry entry;
    while (s->count < limit && pci_heap_pop(&farthest, &entry)) {
        const bool nearer_since = -entry.key > s->distances[entry.item];
        if (nearer_since
                ? !pci_heap_push(c->scratch, &farthest, -s->distances[entry.item], entry.item)
                : !plant(s, entry.item)) {
            return false;
        }
    }
    return true;
}

// Anchors stay in the clusters that they are in; where two are in one, the second is a seed.
static bool bind_anchors(seeding *s) {
    clustering *c = s->clusters;
    uint8_t *taken = PCI_SCRATCH(c->scratch, uint8_t, c->count);
    if (taken == NULL) {
        return false;
    }
    for (size_t i = 0; i < c->anchor_count; ++i) {
        const uint32_t v = c->anchors[i];
        if ((s->distances[v] == HUGE_VAL || taken[c->cluster[v]]) && !plant(s, v)) {
            return false;
        }
        taken[c->cluster[v]] = 1;
        c->anchored[v] = 1;
    }
    return true;
}

// Farthest-point seeds along edges. The first ones, which would each visit most of the mesh, are
// packed instead: about one in twenty, four edge lengths apart.
static bool place_seeds(clustering *c, uint32_t first) {
    static const double packing_reach = 4.0;
    const size_t nv = c->mesh->vertex_count;
    seeding s = {.clusters = c, .distances = PCI_SCRATCH(c->scratch, double, nv)};
    if (s.distances == NULL) {
        return false;
    }
    double area = 0.0; // in lengths that are scaled
    for (size_t v = 0; v < nv; ++v) {
        area += is_given(c, v) ? 0.0 : c->weights[v] / (c->scales[v] * c->scales[v]);
    }
    s.reach = packing_reach * pci_even_spacing(area, c->count);
    // Thin ropes have length but no area: they need a wider reach.
    const size_t limit = c->count / 2 + 1;
    do {
        if (!pack_seeds(&s, first, limit)) {
            return false;
        }
        s.reach *= 2.0;
    } while (s.count == limit && s.count > 1);
    // The anchors do not change how many clusters a part of the mesh gets.
    return fill_seeds(&s, c->count - c->anchor_count) && bind_anchors(&s) &&
           fill_seeds(&s, c->count);
}

// ---- exchanges ----------------------------------------------------------------------------------

static void sum_clusters(clustering *c) {
    memset(c->masses, 0, c->all * sizeof(*c->masses));
    memset(c->moments, 0, 3 * c->all * sizeof(*c->moments));
    memset(c->sizes, 0, c->all * sizeof(*c->sizes));
    memset(c->seams, 0, c->all * sizeof(*c->seams));
    for (size_t v = 0; v < c->mesh->vertex_count; ++v) {
        const size_t i = c->cluster[v];
        c->masses[i] += c->weights[v];
        ++c->sizes[i];
        c->seams[i] += c->seam[v];
        for (size_t k = 0; k < 3; ++k) {
            c->moments[3 * i + k] += c->weights[v] * (c->mesh->positions[3 * v + k] - c->origin[k]);
        }
    }
}

// Whether the cluster of vertex v may fall apart without it: its other vertices around v are not
// all next to each other.
static bool may_tear(const clustering *c, size_t v) {
    const pci_fans *fans = c->fans;
    const uint32_t own = c->cluster[v];
    size_t runs = 0;
    bool inside = !pci_is_border_vertex(c->mesh, (uint32_t)v) &&
                  c->cluster[fans->ends[fans->offsets[v + 1] - 1]] == own;
    for (size_t k = fans->offsets[v]; k < fans->offsets[v + 1]; ++k) {
        const bool was_inside = inside;
        inside = c->cluster[fans->ends[k]] == own;
        runs += inside && !was_inside;
    }
    return runs > 1;
}

// What a cluster on the seam has more energy than another one, with vertex v added (sign 1) or
// removed (-1): it goes on in the mirror image, so that the centroid of both is on the plane.
static double seam_energy(const clustering *c, size_t cluster, size_t v, int sign) {
    if ((int)c->seams[cluster] + sign * c->seam[v] == 0) {
        return 0.0;
    }
    const size_t axis = c->mirror->axis;
    const double w = sign * c->weights[v];
    const double moment =
        c->moments[3 * cluster + axis] + w * (c->mesh->positions[3 * v + axis] - c->origin[axis]);
    return moment * moment / (c->masses[cluster] + w);
}

// Change of the energy when vertex v leaves cluster `from` for cluster `to`.
static double exchange_cost(const clustering *c, size_t v, size_t from, size_t to) {
    const double w = c->weights[v], mass_from = c->masses[from], mass_to = c->masses[to];
    if (c->anchored[v] || c->sizes[from] == 1 || !(mass_from > w)) {
        return INFINITY;
    }
    double left = 0.0, joined = 0.0; // squared distances to both centroids
    for (size_t k = 0; k < 3; ++k) {
        const double x = c->mesh->positions[3 * v + k] - c->origin[k];
        const double a = x - c->moments[3 * from + k] / mass_from;
        const double b = x - c->moments[3 * to + k] / mass_to;
        left += a * a;
        joined += b * b;
    }
    double cost = w * (mass_to / (mass_to + w) * joined - mass_from / (mass_from - w) * left);
    if (c->seams[from] + c->seams[to] > 0) {
        cost += seam_energy(c, from, v, -1) - seam_energy(c, from, v, 0) +
                seam_energy(c, to, v, 1) - seam_energy(c, to, v, 0);
    }
    return cost < 0.0 && c->careful && may_tear(c, v) ? HUGE_VAL : cost;
}

static void exchange(clustering *c, size_t v, size_t from, size_t to, uint32_t pass) {
    const double w = c->weights[v];
    for (size_t k = 0; k < 3; ++k) {
        const double moment = w * (c->mesh->positions[3 * v + k] - c->origin[k]);
        c->moments[3 * from + k] -= moment;
        c->moments[3 * to + k] += moment;
    }
    c->masses[from] -= w, c->masses[to] += w;
    --c->sizes[from], ++c->sizes[to];
    c->seams[from] -= c->seam[v], c->seams[to] += c->seam[v];
    c->cluster[v] = (uint32_t)to;
    c->modified[from] = pass, c->modified[to] = pass;
}

// One sweep over the edges between clusters; a vertex changes sides where that lowers the energy.
// Clusters that rest since the last sweep are skipped. Returns the number of exchanges.
static size_t sweep(clustering *c, uint32_t pass) {
    size_t exchanges = 0;
    for (size_t e = 0; e < c->edge_count; ++e) {
        const size_t a = c->edges[2 * e], b = c->edges[2 * e + 1];
        const size_t ca = c->cluster[a], cb = c->cluster[b];
        if (ca == cb || ca >= c->count || cb >= c->count ||
            (c->modified[ca] + 1 < pass && c->modified[cb] + 1 < pass)) {
            continue;
        }
        const double to_b = exchange_cost(c, a, ca, cb), to_a = exchange_cost(c, b, cb, ca);
        if (to_b < 0.0 && to_b <= to_a) {
            exchange(c, a, ca, cb, pass);
            ++exchanges;
        } else if (to_a < 0.0) {
            exchange(c, b, cb, ca, pass);
            ++exchanges;
        }
    }
    return exchanges;
}

// Keeps the heaviest piece of every cluster, or that with its anchor; the other pieces go to
// neighbours, ring by ring. Returns the number of vertices that moved.
static size_t attach_orphans(clustering *c) {
    const pci_fans *fans = c->fans;
    const size_t nv = c->mesh->vertex_count;
    uint32_t *piece = c->pieces, *queue = c->queue, *heaviest = c->heaviest;
    double *piece_masses = c->piece_masses;
    memset(piece, 0xff, nv * sizeof(*piece));
    memset(piece_masses, 0, nv * sizeof(*piece_masses));
    memset(heaviest, 0xff, c->all * sizeof(*heaviest));
    uint32_t pieces = 0;
    for (size_t start = 0; start < nv; ++start) {
        if (piece[start] != PC_INVALID_INDEX) {
            continue;
        }
        const uint32_t own = c->cluster[start];
        size_t count = 0;
        queue[count++] = (uint32_t)start;
        piece[start] = pieces;
        for (size_t next = 0; next < count; ++next) {
            const uint32_t v = queue[next];
            piece_masses[pieces] += c->anchored[v] ? HUGE_VAL : c->weights[v];
            for (size_t k = fans->offsets[v]; k < fans->offsets[v + 1]; ++k) {
                const uint32_t end = fans->ends[k];
                if (piece[end] == PC_INVALID_INDEX && c->cluster[end] == own) {
                    piece[end] = pieces;
                    queue[count++] = end;
                }
            }
        }
        if (heaviest[own] == PC_INVALID_INDEX ||
            piece_masses[pieces] > piece_masses[heaviest[own]]) {
            heaviest[own] = pieces;
        }
        ++pieces;
    }
    size_t count = 0, orphans = 0;
    for (size_t v = 0; v < nv; ++v) {
        if (is_given(c, v) || piece[v] == heaviest[c->cluster[v]]) {
            queue[count++] = (uint32_t)v;
        } else {
            c->cluster[v] = PC_INVALID_INDEX;
            ++orphans;
        }
    }
    for (size_t next = 0; orphans > 0 && next < count; ++next) {
        const uint32_t v = queue[next];
        for (size_t k = fans->offsets[v]; k < fans->offsets[v + 1]; ++k) {
            if (c->cluster[fans->ends[k]] == PC_INVALID_INDEX) {
                c->cluster[fans->ends[k]] = c->cluster[v];
                queue[count++] = fans->ends[k];
            }
        }
    }
    return orphans;
}

static bool list_edges(clustering *c) {
    const pci_halfedge *mesh = c->mesh;
    for (uint32_t h = 0; h < 3 * mesh->triangle_count; ++h) {
        c->edge_count += pci_is_edge(mesh, h);
    }
    uint32_t *next = c->edges = PCI_SCRATCH(c->scratch, uint32_t, 2 * c->edge_count);
    for (uint32_t h = 0; next != NULL && h < 3 * mesh->triangle_count; ++h) {
        if (pci_is_edge(mesh, h)) {
            *next++ = pci_origin(mesh, h);
            *next++ = pci_target(mesh, h);
        }
    }
    return next != NULL;
}

static bool run(clustering *c, uint32_t first, uint32_t passes, uint64_t *iterations) {
    c->masses = PCI_SCRATCH(c->scratch, double, c->all);
    c->moments = PCI_SCRATCH(c->scratch, double, 3 * c->all);
    c->sizes = PCI_SCRATCH(c->scratch, uint32_t, c->all);
    c->seam = PCI_SCRATCH(c->scratch, uint8_t, c->mesh->vertex_count);
    c->seams = PCI_SCRATCH(c->scratch, uint32_t, c->all);
    c->modified = PCI_SCRATCH(c->scratch, uint32_t, c->all);
    c->pieces = PCI_SCRATCH(c->scratch, uint32_t, c->mesh->vertex_count);
    c->piece_masses = PCI_SCRATCH(c->scratch, double, c->mesh->vertex_count);
    c->queue = PCI_SCRATCH(c->scratch, uint32_t, c->mesh->vertex_count);
    c->heaviest = PCI_SCRATCH(c->scratch, uint32_t, c->all);
    c->anchored = PCI_SCRATCH(c->scratch, uint8_t, c->mesh->vertex_count);
    if (c->scratch->failed || !list_edges(c) || !place_seeds(c, first)) {
        return false;
    }
    memcpy(c->origin, c->mesh->positions, sizeof(c->origin));
    for (uint32_t v = 0; c->mirror != NULL && v < c->mesh->vertex_count; ++v) {
        c->origin[c->mirror->axis] = c->mirror->offset;
        c->seam[v] = pci_is_seam_vertex(c->mirror, c->mesh, v);
    }
    // Exchanges look at energies only at first, so they may tear a cluster; pieces are handed over
    // whenever the exchanges rest, and at the end. They would take some back again and again.
    size_t orphans = 1;
    uint32_t pass = 1;
    for (size_t round = 0; orphans > 0 && pass <= passes; ++round) {
        c->careful = round > 1;
        sum_clusters(c);
        for (size_t i = 0; i < c->all; ++i) {
            c->modified[i] = pass;
        }
        while (pass <= passes && sweep(c, pass) > 0) {
            if (!pci_keep_going(c->scratch->context)) {
                return false;
            }
            ++pass;
        }
        ++pass;
        orphans = attach_orphans(c);
    }
    *iterations = pass - 1 < passes ? pass - 1 : passes;
    return true;
}

bool pci_cluster_vertices(pc_context *context, const pci_sampling *sampling, size_t count,
                          uint32_t first, uint32_t passes, const pci_clustering *wanted,
                          uint64_t *iterations) {
    const pci_rings *rings = &wanted->rings;
    pci_scratch scratch = pci_scratch_begin(context);
    clustering c = {.scratch = &scratch,
                    .mesh = &sampling->mesh,
                    .fans = &sampling->fans,
                    .weights = sampling->weights,
                    .scales = sampling->scales,
                    .mirror = sampling->mirror,
                    .count = count - rings->count,
                    .all = count,
                    .anchors = wanted->anchors,
                    .anchor_count = wanted->anchor_count,
                    .cluster = wanted->cluster};
    for (size_t v = 0; v < c.mesh->vertex_count; ++v) {
        const bool given = rings->count > 0 && rings->cluster[v] != PC_INVALID_INDEX;
        c.cluster[v] = given ? (uint32_t)c.count + rings->cluster[v] : 0;
    }
    const bool done = run(&c, first, passes, iterations);
    pci_scratch_end(&scratch);
    return done;
}
