#include "stages/simplify/contraction.h"

#include "core/heap.h"
#include "core/union_find.h"

bool pci_contraction_begin(pci_scratch *scratch, const pci_halfedge *fine, const double *weights,
                           const double *arcs, double spacing, const pci_mirror *mirror,
                           pci_contraction *m) {
    const size_t nv = fine->vertex_count;
    *m = (pci_contraction){.scratch = scratch, .fine = fine, .spacing = spacing, .mirror = mirror};
    m->parent = PCI_SCRATCH(scratch, uint32_t, nv);
    m->mass = PCI_SCRATCH(scratch, double, nv);
    m->arc = PCI_SCRATCH(scratch, double, nv);
    m->center = PCI_SCRATCH(scratch, double, 3 * nv);
    m->curve = PCI_SCRATCH(scratch, double, 3 * nv);
    m->seam = PCI_SCRATCH(scratch, uint8_t, nv);
    if (scratch->failed || !pci_halfedge_copy(scratch, fine, &m->coarse)) {
        return false;
    }
    for (size_t v = 0; v < nv; ++v) {
        m->parent[v] = (uint32_t)v;
        m->mass[v] = weights[v];
        m->arc[v] = arcs[v];
        m->seam[v] = pci_is_seam_vertex(mirror, fine, (uint32_t)v);
        m->seam_vertices += m->seam[v];
        for (size_t k = 0; k < 3; ++k) {
            m->center[3 * v + k] = weights[v] * fine->positions[3 * v + k];
            m->curve[3 * v + k] = arcs[v] * fine->positions[3 * v + k];
        }
    }
    return true;
}

static void merge(pci_contraction *m, uint32_t h) {
    const size_t a = pci_origin(&m->coarse, h), b = pci_target(&m->coarse, h);
    pci_collapse(&m->coarse, h);
    m->parent[a] = (uint32_t)b;
    m->seam_vertices -= m->seam[a] && m->seam[b];
    m->seam[b] |= m->seam[a];
    m->mass[b] += m->mass[a];
    m->arc[b] += m->arc[a];
    for (size_t k = 0; k < 3; ++k) {
        m->center[3 * b + k] += m->center[3 * a + k];
        m->curve[3 * b + k] += m->curve[3 * a + k];
    }
}

void pci_contract_clusters(pci_contraction *m, const uint32_t *cluster) {
    size_t merged = 1;
    while (merged > 0) {
        merged = 0;
        for (uint32_t h = 0; h < 3 * m->coarse.triangle_count; ++h) {
            if (pci_is_edge(&m->coarse, h) &&
                cluster[pci_origin(&m->coarse, h)] == cluster[pci_target(&m->coarse, h)] &&
                pci_can_collapse(&m->coarse, h)) {
                merge(m, h);
                ++merged;
            }
        }
    }
}

// Rise of sum w |x - mean|^2 when two groups become one.
static double join_cost(double mass_a, const double *sum_a, double mass_b, const double *sum_b) {
    if (!(mass_a > 0.0) || !(mass_b > 0.0)) {
        return 0.0;
    }
    double squared = 0.0;
    for (size_t k = 0; k < 3; ++k) {
        const double d = sum_a[k] / mass_a - sum_b[k] / mass_b;
        squared += d * d;
    }
    return mass_a * mass_b / (mass_a + mass_b) * squared;
}

static double merge_cost(const pci_contraction *m, uint32_t h) {
    const size_t a = pci_origin(&m->coarse, h), b = pci_target(&m->coarse, h);
    return join_cost(m->mass[a], &m->center[3 * a], m->mass[b], &m->center[3 * b]) +
           m->spacing * join_cost(m->arc[a], &m->curve[3 * a], m->arc[b], &m->curve[3 * b]);
}

static bool is_bound(const pci_contraction *m, uint32_t h, const uint8_t *bound) {
    return bound != NULL && (bound[pci_origin(&m->coarse, h)] || bound[pci_target(&m->coarse, h)]);
}

// Whether a merge leaves at least so many vertices: on the seam it takes one, elsewhere another one
// from the mirror image.
static bool leaves(const pci_contraction *m, uint32_t h, size_t vertices) {
    const bool twice = m->mirror != NULL &&
                       !(m->seam[pci_origin(&m->coarse, h)] && m->seam[pci_target(&m->coarse, h)]);
    return pci_contraction_vertices(m) >= vertices + (twice ? 2 : 1);
}

// Merges until `vertices` are left; edges with a bound end stay. False: out of memory.
static bool contract_free(pci_contraction *m, size_t vertices, const uint8_t *bound) {
    size_t merged = 1;
    while (pci_contraction_vertices(m) > vertices && merged > 0) {
        merged = 0;
        pci_heap cheapest = {0};
        for (uint32_t h = 0; h < 3 * m->coarse.triangle_count; ++h) {
            if (pci_is_edge(&m->coarse, h) &&
                !pci_heap_push(m->scratch, &cheapest, merge_cost(m, h), h)) {
                return false;
            }
        }
        pci_heap_entry entry;
        for (uint32_t pops = 1;
             pci_contraction_vertices(m) > vertices && pci_heap_pop(&cheapest, &entry); ++pops) {
            const uint32_t h = entry.item;
            if (pops % 1024 == 0 && !pci_keep_going(m->scratch->context)) {
                return false;
            }
            if (!pci_is_edge(&m->coarse, h) || merge_cost(m, h) != entry.key ||
                is_bound(m, h, bound) || !leaves(m, h, vertices) ||
                !pci_can_collapse(&m->coarse, h)) {
                continue;
            }
            const uint32_t kept = pci_target(&m->coarse, h);
            merge(m, h);
            ++merged;
            PCI_FOR_OUTGOING(&m->coarse, kept, i) {
                const uint32_t pair[2] = {i, pci_previous(i)};
                for (size_t s = 0; s < 2; ++s) {
                    const uint32_t twin = m->coarse.twins[pair[s]];
                    const uint32_t edge = twin < pair[s] ? twin : pair[s];
                    if (!pci_heap_push(m->scratch, &cheapest, merge_cost(m, edge), edge)) {
                        return false;
                    }
                }
            }
        }
    }
    return true;
}

bool pci_contract_to(pci_contraction *m, size_t vertices, const uint8_t *bound) {
    return contract_free(m, vertices, bound) && contract_free(m, vertices, NULL);
}

// Positions from the sums, and the merged fine vertex next to each of them, on the border if it
// is on the border.
static void place_vertices(pci_contraction *m, double *nearest, uint32_t *feet) {
    const uint32_t nv = (uint32_t)m->fine->vertex_count;
    for (uint32_t v = 0; v < nv; ++v) {
        nearest[v] = INFINITY;
        if (m->coarse.outgoing[v] != PC_INVALID_INDEX) {
            const bool border = pci_is_border_vertex(&m->coarse, v) && m->arc[v] > 0.0;
            for (size_t k = 0; k < 3; ++k) {
                m->coarse.positions[3 * (size_t)v + k] =
                    border ? m->curve[3 * (size_t)v + k] / m->arc[v]
                           : m->center[3 * (size_t)v + k] / m->mass[v];
            }
            if (m->seam[v]) {
                m->coarse.positions[3 * (size_t)v + m->mirror->axis] = m->mirror->offset;
            }
        }
    }
    for (uint32_t v = 0; v < nv; ++v) {
        const uint32_t root = pci_find_root(m->parent, v);
        if ((pci_is_border_vertex(&m->coarse, root) && !pci_is_border_vertex(m->fine, v)) ||
            (m->seam[root] && !pci_is_seam_vertex(m->mirror, m->fine, v))) {
            continue;
        }
        const double distance = pci_squared_distance(&m->fine->positions[3 * (size_t)v],
                                                     &m->coarse.positions[3 * (size_t)root]);
        if (distance < nearest[root]) {
            nearest[root] = distance;
            feet[root] = v;
        }
    }
}

bool pci_contraction_result(pci_contraction *m, pc_mesh *proxy, uint32_t **feet,
                            uint32_t **nearby) {
    const size_t nv = m->fine->vertex_count;
    double *nearest = PCI_SCRATCH(m->scratch, double, nv);
    uint32_t *fine_feet = PCI_SCRATCH(m->scratch, uint32_t, nv);
    uint32_t *number = PCI_SCRATCH(m->scratch, uint32_t, nv);
    uint32_t *kept = NULL;
    *nearby = PCI_SCRATCH(m->scratch, uint32_t, nv);
    if (m->scratch->failed) {
        return false;
    }
    place_vertices(m, nearest, fine_feet);
    if (!pci_halfedge_export(&m->coarse, proxy, &kept)) {
        return false;
    }
    *feet = PCI_SCRATCH(m->scratch, uint32_t, proxy->vertex_count);
    if (*feet == NULL) {
        return false;
    }
    for (uint32_t v = 0; v < proxy->vertex_count; ++v) {
        (*feet)[v] = fine_feet[kept[v]];
        number[kept[v]] = v;
    }
    for (uint32_t v = 0; v < nv; ++v) {
        (*nearby)[v] = number[pci_find_root(m->parent, v)];
    }
    return true;
}
