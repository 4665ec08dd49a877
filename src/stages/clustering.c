#include "stages/clustering.h"

#include "core/heap.h"

typedef struct clustering {
    pci_scratch *scratch;
    const pci_halfedge *mesh;
    const double *weights, *scales;
    size_t count; // clusters
    uint32_t *cluster;
    double *masses;     // per cluster
    double *moments;    // per cluster, 3: sum of weighted positions
    uint32_t *sizes;    // per cluster, vertices
    uint32_t *modified; // per cluster, last pass that changed it
    double origin[3];   // positions count from here, against cancellation
} clustering;

// Farthest-point seeds along edges: each new seed is the vertex farthest from all earlier ones, and
// takes over what is nearer to it. Parts that no seed reaches are infinitely far and come first.
static bool place_seeds(clustering *c, uint32_t first) {
    const pci_halfedge *mesh = c->mesh;
    double *distances = PCI_SCRATCH(c->scratch, double, mesh->vertex_count);
    if (distances == NULL) {
        return false;
    }
    pci_heap farthest = {0}, front = {0};
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        distances[v] = INFINITY;
        if (!pci_heap_push(c->scratch, &farthest, -INFINITY, (uint32_t)v)) {
            return false;
        }
    }
    for (size_t seed = 0; seed < c->count; ++seed) {
        pci_heap_entry entry = {0.0, first};
        while (seed > 0 && pci_heap_pop(&farthest, &entry) &&
               -entry.key > distances[entry.item]) { // came nearer since
            if (!pci_heap_push(c->scratch, &farthest, -distances[entry.item], entry.item)) {
                return false;
            }
        }
        distances[entry.item] = 0.0;
        c->cluster[entry.item] = (uint32_t)seed;
        if (!pci_keep_going(c->scratch->context) ||
            !pci_heap_push(c->scratch, &front, 0.0, entry.item)) {
            return false;
        }
        while (pci_heap_pop(&front, &entry)) {
            const uint32_t v = entry.item;
            if (entry.key > distances[v]) {
                continue;
            }
            PCI_FOR_OUTGOING(mesh, v, h) {
                // Targets of the outgoing half-edges, and the last neighbour of an open fan.
                const uint32_t ends[2] = {pci_target(mesh, h), mesh->corners[pci_previous(h)]};
                const size_t end_count = mesh->twins[pci_previous(h)] == PC_INVALID_INDEX ? 2 : 1;
                for (size_t i = 0; i < end_count; ++i) {
                    const double distance =
                        entry.key +
                        0.5 * (c->scales[v] + c->scales[ends[i]]) *
                            sqrt(pci_squared_distance(&mesh->positions[3 * (size_t)v],
                                                      &mesh->positions[3 * (size_t)ends[i]]));
                    if (distance < distances[ends[i]]) {
                        distances[ends[i]] = distance;
                        c->cluster[ends[i]] = (uint32_t)seed;
                        if (!pci_heap_push(c->scratch, &front, distance, ends[i])) {
                            return false;
                        }
                    }
                }
            }
        }
    }
    return true;
}

static void sum_clusters(clustering *c) {
    memset(c->masses, 0, c->count * sizeof(*c->masses));
    memset(c->moments, 0, 3 * c->count * sizeof(*c->moments));
    memset(c->sizes, 0, c->count * sizeof(*c->sizes));
    for (size_t v = 0; v < c->mesh->vertex_count; ++v) {
        const size_t i = c->cluster[v];
        c->masses[i] += c->weights[v];
        ++c->sizes[i];
        for (size_t k = 0; k < 3; ++k) {
            c->moments[3 * i + k] += c->weights[v] * (c->mesh->positions[3 * v + k] - c->origin[k]);
        }
    }
}

// Change of the energy when vertex v leaves cluster `from` for cluster `to`.
static double exchange_cost(const clustering *c, size_t v, size_t from, size_t to) {
    const double w = c->weights[v], mass_from = c->masses[from], mass_to = c->masses[to];
    if (c->sizes[from] == 1 || !(mass_from > w)) {
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
    return w * (mass_to / (mass_to + w) * joined - mass_from / (mass_from - w) * left);
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
    c->cluster[v] = (uint32_t)to;
    c->modified[from] = pass, c->modified[to] = pass;
}

// One sweep over the edges between clusters; a vertex changes sides where that lowers the energy.
// Clusters that rest since the last sweep are skipped. Returns the number of exchanges.
static size_t sweep(clustering *c, uint32_t pass) {
    const pci_halfedge *mesh = c->mesh;
    size_t exchanges = 0;
    for (uint32_t h = 0; h < 3 * mesh->triangle_count; ++h) {
        if (!pci_is_edge(mesh, h)) {
            continue;
        }
        const size_t a = pci_origin(mesh, h), b = pci_target(mesh, h);
        const size_t ca = c->cluster[a], cb = c->cluster[b];
        if (ca == cb || (c->modified[ca] + 1 < pass && c->modified[cb] + 1 < pass)) {
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

// Keeps the heaviest piece of every cluster; the other pieces go to neighbours, ring by ring.
// Returns the number of vertices that moved; false in `done` when memory ran out.
static size_t attach_orphans(clustering *c, bool *done) {
    const pci_halfedge *mesh = c->mesh;
    const size_t nv = mesh->vertex_count;
    uint32_t *piece = PCI_SCRATCH(c->scratch, uint32_t, nv);
    uint32_t *queue = PCI_SCRATCH(c->scratch, uint32_t, nv);
    double *piece_masses = PCI_SCRATCH(c->scratch, double, nv);
    uint32_t *heaviest = PCI_SCRATCH(c->scratch, uint32_t, c->count);
    *done = !c->scratch->failed;
    if (!*done) {
        return 0;
    }
    memset(piece, 0xff, nv * sizeof(*piece));
    memset(heaviest, 0xff, c->count * sizeof(*heaviest));
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
            piece_masses[pieces] += c->weights[v];
            PCI_FOR_OUTGOING(mesh, v, h) {
                const uint32_t ends[2] = {pci_target(mesh, h), mesh->corners[pci_previous(h)]};
                for (size_t i = 0; i < 2; ++i) {
                    if (piece[ends[i]] == PC_INVALID_INDEX && c->cluster[ends[i]] == own) {
                        piece[ends[i]] = pieces;
                        queue[count++] = ends[i];
                    }
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
        if (piece[v] == heaviest[c->cluster[v]]) {
            queue[count++] = (uint32_t)v;
        } else {
            c->cluster[v] = PC_INVALID_INDEX;
            ++orphans;
        }
    }
    for (size_t next = 0; orphans > 0 && next < count; ++next) {
        const uint32_t v = queue[next];
        PCI_FOR_OUTGOING(mesh, v, h) {
            const uint32_t ends[2] = {pci_target(mesh, h), mesh->corners[pci_previous(h)]};
            for (size_t i = 0; i < 2; ++i) {
                if (c->cluster[ends[i]] == PC_INVALID_INDEX) {
                    c->cluster[ends[i]] = c->cluster[v];
                    queue[count++] = ends[i];
                }
            }
        }
    }
    return orphans;
}

bool pci_cluster_vertices(pci_scratch *scratch, const pci_halfedge *mesh, const double *weights,
                          const double *scales, size_t cluster_count, uint32_t first,
                          uint32_t passes, uint32_t *cluster, uint64_t *iterations) {
    clustering c = {.scratch = scratch,
                    .mesh = mesh,
                    .weights = weights,
                    .scales = scales,
                    .count = cluster_count,
                    .cluster = cluster};
    c.masses = PCI_SCRATCH(scratch, double, cluster_count);
    c.moments = PCI_SCRATCH(scratch, double, 3 * cluster_count);
    c.sizes = PCI_SCRATCH(scratch, uint32_t, cluster_count);
    c.modified = PCI_SCRATCH(scratch, uint32_t, cluster_count);
    if (scratch->failed || !place_seeds(&c, first)) {
        return false;
    }
    memcpy(c.origin, mesh->positions, sizeof(c.origin));
    // Exchanges look at energies only, so they may tear a cluster; pieces are handed over whenever
    // the exchanges rest, and at the end.
    bool done = true;
    size_t orphans = 1;
    uint32_t pass = 1;
    *iterations = 0;
    while (orphans > 0 && pass <= passes) {
        sum_clusters(&c);
        for (size_t i = 0; i < cluster_count; ++i) {
            c.modified[i] = pass;
        }
        while (pass <= passes && sweep(&c, pass) > 0) {
            if (!pci_keep_going(scratch->context)) {
                return false;
            }
            ++pass;
        }
        ++pass;
        orphans = attach_orphans(&c, &done);
        if (!done) {
            return false;
        }
    }
    *iterations = pass - 1 < passes ? pass - 1 : passes;
    return true;
}
