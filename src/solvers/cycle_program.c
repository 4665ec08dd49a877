#include "solvers/cycle_program.h"

#define SLACK 0.2F // of a cycle that may be forgotten

// ---- set of cycles ------------------------------------------------------------------------------

static bool create_arrays(pci_scratch *scratch, pci_cycle_program *p) {
    const size_t m = p->graph->edge_count, n = p->graph->vertex_count;
    float **by_edge[] = {&p->costs, &p->signs,   &p->y,    &p->y_bar,
                         &p->y_sum, &p->y_start, &p->load, &p->y_rates};
    for (size_t k = 0; k < sizeof(by_edge) / sizeof(by_edge[0]); ++k) {
        *by_edge[k] = PCI_SCRATCH(scratch, float, m);
    }
    float **by_vertex[] = {&p->u, &p->u_bar, &p->u_sum, &p->u_start, &p->excess, &p->u_rates};
    for (size_t k = 0; k < sizeof(by_vertex) / sizeof(by_vertex[0]); ++k) {
        *by_vertex[k] = PCI_SCRATCH(scratch, float, n);
    }
    p->z = PCI_SCRATCH(scratch, pci_flow, m);
    p->z_sum = PCI_SCRATCH(scratch, pci_flow, m);
    p->z_start = PCI_SCRATCH(scratch, pci_flow, m);
    p->heads = PCI_SCRATCH(scratch, uint32_t, m);
    p->degrees = PCI_SCRATCH(scratch, uint32_t, m);
    p->valences = PCI_SCRATCH(scratch, uint32_t, n);
    p->later = PCI_SCRATCH(scratch, uint32_t, n);
    return !scratch->failed;
}

bool pci_cycle_program_create(pci_scratch *scratch, const pci_signed_graph *graph,
                              pci_cycle_program *p) {
    const size_t m = graph->edge_count;
    *p = (pci_cycle_program){.scratch = scratch, .graph = graph, .weight = 1.0F};
    if (!create_arrays(scratch, p)) {
        return false;
    }
    double mean = 0.0;
    for (size_t e = 0; e < m; ++e) {
        mean += (double)graph->edges[e].cost / (double)m;
        ++p->valences[graph->edges[e].a];
        ++p->later[graph->edges[e].a];
        ++p->valences[graph->edges[e].b];
    }
    p->has_flow = p->valences[PCI_GROUND] > 1;
    p->u[PCI_GROUND] = p->u_bar[PCI_GROUND] = 0.5F;
    p->scale = m != 0 ? 1.0 / mean : 1.0;
    for (size_t e = 0; e < m; ++e) {
        p->costs[e] = (float)((double)graph->edges[e].cost * p->scale);
        p->signs[e] = graph->edges[e].opposite ? -1.0F : 1.0F;
        p->heads[e] = graph->edges[e].b;
    }
    return true;
}

// Enters the hash; false when it is there already.
static bool enter(pci_cycle_program *p, uint64_t hash) {
    size_t slot = p->set_size != 0 ? hash % p->set_size : 0;
    while (p->set[slot] != 0) {
        if (p->set[slot] == hash) {
            return false;
        }
        slot = slot + 1 < p->set_size ? slot + 1 : 0;
    }
    p->set[slot] = hash;
    return true;
}

bool pci_cycle_program_add(pci_cycle_program *p, const uint32_t *edges, size_t count, bool *added) {
    uint64_t hash = 0;
    for (size_t k = 0; k < count; ++k) {
        hash += pci_random_bits(0, 0, edges[k]);
    }
    hash |= 1;
    *added = false;
    if (2 * (p->cycle_count + 1) > p->set_size) {
        p->set_size = 2 * p->set_size + 1024;
        p->set = PCI_SCRATCH(p->scratch, uint64_t, p->set_size);
        for (size_t c = 0; c < p->cycle_count && p->set != NULL; ++c) {
            enter(p, p->cycles[c].hash);
        }
    }
    if (p->set == NULL ||
        !pci_scratch_reserve(p->scratch, (void **)&p->cycles, &p->cycle_capacity,
                             p->cycle_count + 1, sizeof(*p->cycles)) ||
        !pci_scratch_reserve(p->scratch, (void **)&p->entries, &p->entry_capacity,
                             p->entry_count + count, sizeof(*p->entries))) {
        return false;
    }
    if (enter(p, hash)) {
        for (size_t k = 0; k < count; ++k) {
            p->entries[p->entry_count++] = edges[k];
            ++p->degrees[edges[k]];
        }
        p->cycles[p->cycle_count++] = (pci_cycle){.end = p->entry_count, .hash = hash};
        *added = true;
    }
    return true;
}

void pci_cycle_program_purge(pci_cycle_program *p) {
    size_t kept = 0, entries = 0;
    memset(p->degrees, 0, p->graph->edge_count * sizeof(*p->degrees));
    for (size_t k = 0; k < p->set_size; ++k) {
        p->set[k] = 0;
    }
    for (size_t c = 0, begin = 0; c < p->cycle_count; ++c) {
        pci_cycle cycle = p->cycles[c];
        float sum = 0.0F;
        for (size_t k = begin; k < cycle.end; ++k) {
            sum += p->y[p->entries[k]];
        }
        if (cycle.f > 0.0F || sum < 1.0F + SLACK) {
            for (size_t k = begin; k < cycle.end; ++k) {
                p->entries[entries++] = p->entries[k];
                ++p->degrees[p->entries[k]];
            }
            begin = cycle.end;
            cycle.end = entries;
            p->cycles[kept++] = cycle;
            enter(p, cycle.hash);
        } else {
            begin = cycle.end;
        }
    }
    p->cycle_count = kept;
    p->entry_count = entries;
}

// ---- primal-dual hybrid gradient ----------------------------------------------------------------

// One step is that of Chambolle and Pock, with step lengths by the number of entries in row and
// column ("Diagonal preconditioning for first order primal-dual algorithms", 2011).

// The larger one of a value and 0. Exact, and without a branch that no processor predicts.
static float positive(float value) { return 0.5F * (value + fabsf(value)); }

static float clamp(float value, float low, float high) {
    return value < low ? low : value > high ? high : value;
}

// Entries in the rows of the potentials.
static float edge_weight(const pci_cycle_program *p, size_t edge) {
    return (float)p->degrees[edge] + (p->has_flow ? 3.0F : 1.0F);
}
static float vertex_weight(const pci_cycle_program *p, size_t vertex) {
    return (float)(2 * p->valences[vertex] + 1);
}

static void step_flow(pci_cycle_program *p) {
    const pci_signed_graph *graph = p->graph;
    const float rate = p->weight / 3.0F;
    memset(p->excess, 0, graph->vertex_count * sizeof(*p->excess));
    for (size_t e = 0; e < graph->edge_count;) {
        // The edges from one vertex to later ones; those to earlier ones have been.
        const uint32_t a = graph->edges[e].a;
        const size_t end = e + p->later[a];
        const float u = p->u_bar[a];
        float excess = p->excess[a];
        for (; e < end; ++e) {
            const uint32_t b = p->heads[e];
            const float sign = p->signs[e];
            const float rise = u - sign * p->u_bar[b];
            const pci_flow z = {positive(p->z[e].forward + rate * (rise - p->y_bar[e])),
                                positive(p->z[e].backward + rate * (-rise - p->y_bar[e]))};
            p->z[e] = z;
            p->z_sum[e].forward += z.forward;
            p->z_sum[e].backward += z.backward;
            p->load[e] = z.forward + z.backward;
            excess += z.forward - z.backward;
            p->excess[b] -= sign * (z.forward - z.backward);
        }
        p->excess[a] = excess;
    }
    for (size_t v = 1; v < graph->vertex_count; ++v) {
        const float u = clamp(p->u[v] - p->u_rates[v] * p->excess[v], -0.5F, 0.5F);
        p->u_bar[v] = 2.0F * u - p->u[v];
        p->u[v] = u;
        p->u_sum[v] += u;
    }
}

static void step(pci_cycle_program *p) {
    const size_t m = p->graph->edge_count;
    if (p->has_flow) {
        step_flow(p);
    } else {
        memset(p->load, 0, m * sizeof(*p->load));
    }
    for (size_t c = 0, begin = 0; c < p->cycle_count; ++c) {
        pci_cycle *cycle = &p->cycles[c];
        float sum = 0.0F;
        for (size_t k = begin; k < cycle->end; ++k) {
            sum += p->y_bar[p->entries[k]];
        }
        cycle->f = positive(cycle->f + p->weight / (float)(cycle->end - begin) * (1.0F - sum));
        cycle->f_sum += cycle->f;
        if (cycle->f > 0.0F) {
            for (size_t k = begin; k < cycle->end; ++k) {
                p->load[p->entries[k]] += cycle->f;
            }
        }
        begin = cycle->end;
    }
    for (size_t e = 0; e < m; ++e) {
        const float y = clamp(p->y[e] - p->y_rates[e] * (p->costs[e] - p->load[e]), 0.0F, 1.0F);
        p->y_bar[e] = 2.0F * y - p->y[e];
        p->y[e] = y;
        p->y_sum[e] += y;
    }
    ++p->average;
}

// Rows of the potentials: adds their violation, and returns what the flow is worth.
static double measure_flow(pci_cycle_program *p, bool average, float factor, double *lacking) {
    const pci_signed_graph *graph = p->graph;
    const float *u = average ? p->u_sum : p->u, *y = average ? p->y_sum : p->y;
    const pci_flow *z = average ? p->z_sum : p->z;
    memset(p->excess, 0, graph->vertex_count * sizeof(*p->excess));
    for (size_t e = 0; e < graph->edge_count; ++e) {
        const pci_signed_edge *edge = &graph->edges[e];
        const float sign = edge->opposite ? -1.0F : 1.0F;
        const float ua = edge->a == PCI_GROUND ? 0.5F : factor * u[edge->a];
        const float lack = fabsf(ua - sign * factor * u[edge->b]) - factor * y[e];
        const float net = factor * (z[e].forward - z[e].backward);
        *lacking += lack > 0.0F ? (double)(lack * lack) : 0.0;
        p->load[e] = factor * (z[e].forward + z[e].backward);
        p->excess[edge->a] += net;
        p->excess[edge->b] -= sign * net;
    }
    double worth = 0.5 * (double)p->excess[PCI_GROUND];
    for (size_t v = 1; v < graph->vertex_count; ++v) {
        worth -= 0.5 * (double)fabsf(p->excess[v]);
    }
    return worth;
}

// How far the last or the average point is from optimal: relative to its value, violated
// constraints and duality gap. Uses `load` and `excess`, which the next step recomputes.
static double measure(pci_cycle_program *p, bool average, double *value) {
    const size_t m = p->graph->edge_count;
    const float factor = average ? 1.0F / (float)p->average : 1.0F;
    const float *y = average ? p->y_sum : p->y;
    double lacking = 0.0, packed = 0.0;
    memset(p->load, 0, m * sizeof(*p->load));
    if (p->has_flow) {
        packed = measure_flow(p, average, factor, &lacking);
    }
    for (size_t c = 0, begin = 0; c < p->cycle_count; ++c) {
        const pci_cycle *cycle = &p->cycles[c];
        const float f = factor * (average ? cycle->f_sum : cycle->f);
        float sum = 0.0F;
        for (size_t k = begin; k < cycle->end; ++k) {
            sum += y[p->entries[k]];
            p->load[p->entries[k]] += f;
        }
        const float lack = positive(1.0F - factor * sum);
        lacking += (double)(lack * lack);
        packed += (double)f;
        begin = cycle->end;
    }
    // As y is at most 1, an overload may be paid for.
    *value = 0.0;
    for (size_t e = 0; e < m; ++e) {
        packed -= (double)positive(p->load[e] - p->costs[e]);
        *value += (double)(factor * y[e] * p->costs[e]);
    }
    const double gap = *value - packed, weight = (double)p->weight;
    return sqrt(weight * weight * lacking + gap * gap) / (*value > 1.0 ? *value : 1.0);
}

static void begin_average(pci_cycle_program *p) {
    const size_t m = p->graph->edge_count, n = p->graph->vertex_count;
    memset(p->y_sum, 0, m * sizeof(*p->y_sum));
    memcpy(p->y_start, p->y, m * sizeof(*p->y));
    memset(p->z_sum, 0, m * sizeof(*p->z_sum));
    memcpy(p->z_start, p->z, m * sizeof(*p->z));
    memset(p->u_sum, 0, n * sizeof(*p->u_sum));
    memcpy(p->u_start, p->u, n * sizeof(*p->u));
    for (size_t c = 0; c < p->cycle_count; ++c) {
        p->cycles[c].f_sum = 0.0F;
        p->cycles[c].f_start = p->cycles[c].f;
    }
    p->average = 0;
}

// Moves to the average point.
static void take_average(pci_cycle_program *p) {
    const size_t m = p->graph->edge_count, n = p->graph->vertex_count;
    const float factor = 1.0F / (float)p->average;
    for (size_t e = 0; e < m; ++e) {
        p->y[e] = factor * p->y_sum[e];
        p->z[e] = (pci_flow){factor * p->z_sum[e].forward, factor * p->z_sum[e].backward};
    }
    for (size_t v = 1; v < n; ++v) {
        p->u[v] = factor * p->u_sum[v];
    }
    for (size_t c = 0; c < p->cycle_count; ++c) {
        p->cycles[c].f = factor * p->cycles[c].f_sum;
    }
}

// Balances primal and dual step lengths by how far both sides have moved. Slowly: the sides take
// turns in moving, and step lengths that follow them sway for many rounds.
static void balance(pci_cycle_program *p) {
    const size_t m = p->graph->edge_count, n = p->graph->vertex_count;
    double primal = 0.0, dual = 0.0;
    for (size_t e = 0; e < m; ++e) {
        const float y = p->y[e] - p->y_start[e];
        const float forward = p->z[e].forward - p->z_start[e].forward;
        const float backward = p->z[e].backward - p->z_start[e].backward;
        primal += (double)(y * y * edge_weight(p, e));
        dual += (double)(3.0F * (forward * forward + backward * backward));
    }
    for (size_t v = 1; v < n; ++v) {
        const float u = p->u[v] - p->u_start[v];
        primal += (double)(u * u * vertex_weight(p, v));
    }
    for (size_t c = 0, begin = 0; c < p->cycle_count; ++c) {
        const float f = p->cycles[c].f - p->cycles[c].f_start;
        dual += (double)(f * f * (float)(p->cycles[c].end - begin));
        begin = p->cycles[c].end;
    }
    if (primal > 1e-20 && dual > 1e-20) {
        const double weight = (double)p->weight;
        p->weight = (float)sqrt(weight * sqrt(weight * sqrt(dual / primal)));
    }
}

static void set_rates(pci_cycle_program *p) {
    for (size_t e = 0; e < p->graph->edge_count; ++e) {
        p->y_rates[e] = 1.0F / (p->weight * edge_weight(p, e));
    }
    for (size_t v = 0; v < p->graph->vertex_count; ++v) {
        p->u_rates[v] = 1.0F / (p->weight * vertex_weight(p, v));
    }
}

// Restarts from the better one of the last and the average point, as in Applegate et al., "Faster
// first-order primal-dual methods for linear programming using restarts and sharpness", 2023.
double pci_cycle_program_iterate(pci_cycle_program *p) {
    begin_average(p);
    set_rates(p);
    for (uint32_t k = 0; k < PCI_PROGRAM_STEPS; ++k) {
        step(p);
    }
    double value = 0.0, average_value = 0.0;
    const double error = measure(p, false, &value);
    const double average_error = measure(p, true, &average_value);
    if (average_error < error) {
        take_average(p);
    }
    p->value = average_error < error ? average_value : value;
    balance(p);
    memcpy(p->y_bar, p->y, p->graph->edge_count * sizeof(*p->y));
    memcpy(p->u_bar, p->u, p->graph->vertex_count * sizeof(*p->u));
    return average_error < error ? average_error : error;
}

// ---- certificate --------------------------------------------------------------------------------

int64_t pci_cycle_program_pack(pci_cycle_program *p, bool fill, int64_t *capacities) {
    memset(p->load, 0, p->graph->edge_count * sizeof(*p->load));
    for (size_t c = 0, k = 0; c < p->cycle_count; ++c) {
        for (; k < p->cycles[c].end; ++k) {
            p->load[p->entries[k]] += p->cycles[c].f;
        }
    }
    int64_t total = 0;
    for (size_t c = 0, begin = 0; c < p->cycle_count; ++c) {
        const pci_cycle *cycle = &p->cycles[c];
        int64_t amount = INT64_MAX;
        float share = 1.0F; // of the most crowded edge
        for (size_t k = begin; k < cycle->end; ++k) {
            const uint32_t e = p->entries[k];
            amount = capacities[e] < amount ? capacities[e] : amount;
            if (p->load[e] * share > p->costs[e]) {
                share = p->costs[e] / p->load[e];
            }
        }
        const double wanted = (double)(cycle->f * share) / p->scale;
        if (!fill && wanted < (double)amount) {
            amount = (int64_t)wanted;
        }
        for (size_t k = begin; k < cycle->end; ++k) {
            capacities[p->entries[k]] -= amount;
        }
        total += amount;
        begin = cycle->end;
    }
    return total;
}
