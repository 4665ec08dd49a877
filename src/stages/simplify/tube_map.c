#include "stages/simplify/tube_map.h"

#include "solvers/conjugate_gradients.h"

typedef struct link {
    uint32_t a, b; // members
    double weight;
} link;

// Weight of an edge in the Laplacian of linear elements, kept positive.
static double edge_weight(const pci_halfedge *mesh, uint32_t h) {
    static const double least = 0.001, most = 1000.0;
    double sum = 0.0;
    const uint32_t sides[2] = {h, mesh->twins[h]};
    for (size_t i = 0; i < 2 && sides[i] != PC_INVALID_INDEX; ++i) {
        const double *apex = &mesh->positions[3 * (size_t)mesh->corners[pci_previous(sides[i])]];
        double a[3], b[3], normal[3];
        pci_sub(&mesh->positions[3 * (size_t)pci_origin(mesh, sides[i])], apex, a);
        pci_sub(&mesh->positions[3 * (size_t)pci_target(mesh, sides[i])], apex, b);
        pci_cross(a, b, normal);
        const double area = pci_norm(normal);
        sum += area > 0.0 ? 0.5 * pci_dot(a, b) / area : 0.0;
    }
    return fmin(fmax(sum, least), most);
}

// Lists the edges of the tube. False: out of memory.
static bool list_links(pci_scratch *scratch, const pci_tube *t, link **links, size_t *count) {
    const pci_halfedge *mesh = t->mesh;
    size_t edges = 0;
    for (int fill = 0; fill < 2; ++fill) {
        edges = 0;
        for (size_t i = 0; i < 3 * t->near_count; ++i) {
            const uint32_t h = pci_near_halfedge(t, i);
            if (!t->inside[h / 3] || (!pci_is_tube_rim(t, h) && !pci_is_edge(mesh, h))) {
                continue;
            }
            if (fill) {
                (*links)[edges] = (link){t->local[pci_origin(mesh, h)],
                                         t->local[pci_target(mesh, h)], edge_weight(mesh, h)};
            }
            ++edges;
        }
        if (!fill && (*links = PCI_SCRATCH(scratch, link, edges)) == NULL) {
            return false;
        }
    }
    *count = edges;
    return true;
}

typedef struct laplacian {
    const link *links;
    size_t count, size;
    const uint8_t *fixed;
} laplacian;

// y = the Laplacian of x where a member is free.
static void apply_laplacian(void *user, const double *x, double *y) {
    const laplacian *l = user;
    memset(y, 0, l->size * sizeof(*y));
    for (size_t i = 0; i < l->count; ++i) {
        const link *edge = &l->links[i];
        const double flow = edge->weight * (x[edge->a] - x[edge->b]);
        y[edge->a] += flow;
        y[edge->b] -= flow;
    }
    for (size_t i = 0; i < l->size; ++i) {
        y[i] = l->fixed[i] ? 0.0 : y[i];
    }
}

// Makes x harmonic where it is free. False: out of memory or cancelled.
static bool make_harmonic(pci_scratch *scratch, pci_tube *t, const link *links, size_t count,
                          const uint8_t *fixed, double *x) {
    static const double tolerance = 1e-9;
    const size_t size = t->member_count;
    laplacian l = {links, count, size, fixed};
    const pci_conjugate_gradients system = {
        .size = size,
        .columns = 1,
        .map = apply_laplacian,
        .user = &l,
        .tolerance = tolerance,
        .most_steps = PCI_EFFORT(2000, 20),
    };
    double *residual = PCI_SCRATCH(scratch, double, size);
    double *work = PCI_SCRATCH(scratch, double, 2 * size);
    if (scratch->failed) {
        return false;
    }
    apply_laplacian(&l, x, residual);
    for (size_t i = 0; i < size; ++i) {
        residual[i] = -residual[i];
    }
    return pci_conjugate_gradients_run(scratch->context, &system, residual, work, x);
}

// The conjugate of `along`, which turns once around the tube: it steps from triangle to triangle by
// the flow through the edge between them. False: out of memory.
static bool find_angles(pci_scratch *scratch, pci_tube *t, double flux) {
    static const double unknown = 100.0; // radians
    const pci_halfedge *mesh = t->mesh;
    double *angle = t->angles, *sums = PCI_SCRATCH(scratch, double, 2 * t->member_count);
    uint32_t *queue = t->queue;
    if (sums == NULL) {
        return false;
    }
    size_t count = 0;
    for (size_t i = t->near_count; i-- > 0;) {
        angle[t->near[i]] = unknown;
        queue[0] = t->inside[t->near[i]] ? t->near[i] : queue[0];
    }
    angle[queue[count++]] = 0.0;
    for (size_t next = 0; next < count; ++next) {
        const uint32_t f = queue[next];
        for (uint32_t c = 0; c < 3; ++c) {
            const uint32_t h = 3 * f + c, a = t->local[mesh->corners[h]];
            const uint32_t b = t->local[pci_target(mesh, h)];
            sums[2 * (size_t)a] += cos(angle[f]);
            sums[2 * (size_t)a + 1] += sin(angle[f]);
            if (pci_is_tube_rim(t, h) || angle[mesh->twins[h] / 3] < unknown) {
                continue;
            }
            const uint32_t other = mesh->twins[h] / 3;
            angle[other] = fmod(angle[f] + 2.0 * PCI_PI / flux * edge_weight(mesh, h) *
                                               (t->along[b] - t->along[a]),
                                2.0 * PCI_PI);
            queue[count++] = other;
        }
    }
    for (size_t i = 0; i < t->member_count; ++i) {
        t->around[i] = atan2(sums[2 * i + 1], sums[2 * i]);
    }
    return true;
}

bool pci_map_to_cylinder(pci_scratch *scratch, pci_tube *t, const uint32_t *loop_of,
                         uint32_t loop) {
    const pci_halfedge *mesh = t->mesh;
    uint8_t *fixed = PCI_SCRATCH(scratch, uint8_t, t->member_count);
    t->along = PCI_SCRATCH(scratch, double, t->member_count);
    t->around = PCI_SCRATCH(scratch, double, t->member_count);
    link *links = NULL;
    size_t count = 0;
    if (scratch->failed || !list_links(scratch, t, &links, &count)) {
        return false;
    }
    for (size_t i = 0; i < 3 * t->near_count; ++i) {
        const uint32_t h = pci_near_halfedge(t, i);
        if (t->inside[h / 3] && pci_is_tube_rim(t, h)) {
            const uint32_t ends[2] = {pci_origin(mesh, h), pci_target(mesh, h)};
            for (size_t e = 0; e < 2; ++e) {
                fixed[t->local[ends[e]]] = 1;
                t->along[t->local[ends[e]]] = loop_of[ends[e]] == loop ? 0.0 : 1.0;
            }
        }
    }
    if (!make_harmonic(scratch, t, links, count, fixed, t->along)) {
        return false;
    }
    t->flux = 0.0;
    for (size_t i = 0; i < count; ++i) {
        const bool from = loop_of[t->members[links[i].a]] == loop;
        const bool to = loop_of[t->members[links[i].b]] == loop;
        if (from != to) {
            t->flux += links[i].weight * fabs(t->along[links[i].a] - t->along[links[i].b]);
        }
    }
    return t->flux > 0.0 ? find_angles(scratch, t, t->flux) : true;
}
