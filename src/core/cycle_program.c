#include "core/cycle_program.h"

enum { CHECK_EVERY = 40 };
#define SLACK 0.2 // of a cycle that may be forgotten

// ---- set of cycles ------------------------------------------------------------------------------

bool pci_cycle_program_create(pci_scratch *scratch, const pci_signed_graph *graph,
                              pci_cycle_program *p) {
    const size_t m = graph->edge_count;
    *p = (pci_cycle_program){.scratch = scratch, .graph = graph, .weight = 1.0};
    p->costs = PCI_SCRATCH(scratch, double, m);
    p->y = PCI_SCRATCH(scratch, double, m);
    p->y_bar = PCI_SCRATCH(scratch, double, m);
    p->y_sum = PCI_SCRATCH(scratch, double, m);
    p->y_start = PCI_SCRATCH(scratch, double, m);
    p->load = PCI_SCRATCH(scratch, double, m);
    p->degrees = PCI_SCRATCH(scratch, uint32_t, m);
    if (scratch->failed) {
        return false;
    }
    double mean = 0.0;
    for (size_t e = 0; e < m; ++e) {
        mean += (double)graph->edges[e].cost / (double)m;
    }
    p->scale = m != 0 ? 1.0 / mean : 1.0;
    for (size_t e = 0; e < m; ++e) {
        p->costs[e] = (double)graph->edges[e].cost * p->scale;
    }
    return true;
}

// Enters the hash; false when it is there already.
static bool enter(pci_cycle_program *p, uint64_t hash) {
    size_t slot = hash % p->set_size;
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
        double sum = 0.0;
        for (size_t k = begin; k < cycle.end; ++k) {
            sum += p->y[p->entries[k]];
        }
        if (cycle.f > 0.0 || sum < 1.0 + SLACK) {
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

// One step of Chambolle and Pock, with step lengths by the number of entries in row and column
// ("Diagonal preconditioning for first order primal-dual algorithms", 2011).
static void step(pci_cycle_program *p) {
    const size_t m = p->graph->edge_count;
    memset(p->load, 0, m * sizeof(*p->load));
    for (size_t c = 0, begin = 0; c < p->cycle_count; ++c) {
        pci_cycle *cycle = &p->cycles[c];
        double sum = 0.0;
        for (size_t k = begin; k < cycle->end; ++k) {
            sum += p->y_bar[p->entries[k]];
        }
        const double moved = cycle->f + p->weight / (double)(cycle->end - begin) * (1.0 - sum);
        cycle->f = moved > 0.0 ? moved : 0.0;
        cycle->f_sum += cycle->f;
        if (cycle->f > 0.0) {
            for (size_t k = begin; k < cycle->end; ++k) {
                p->load[p->entries[k]] += cycle->f;
            }
        }
        begin = cycle->end;
    }
    for (size_t e = 0; e < m; ++e) {
        const double rate = 1.0 / (p->weight * (double)(p->degrees[e] + 1));
        const double moved = p->y[e] - rate * (p->costs[e] - p->load[e]);
        const double y = moved < 0.0 ? 0.0 : moved > 1.0 ? 1.0 : moved;
        p->y_bar[e] = 2.0 * y - p->y[e];
        p->y[e] = y;
        p->y_sum[e] += y;
    }
    p->average += 1.0;
}

// How far the last or the average point is from optimal: relative to its value, violated
// constraints and duality gap. Uses `load`, which the next step recomputes.
static double measure(pci_cycle_program *p, bool average) {
    const double factor = average ? 1.0 / p->average : 1.0;
    const double *y = average ? p->y_sum : p->y;
    double lacking = 0.0, packed = 0.0, value = 0.0;
    memset(p->load, 0, p->graph->edge_count * sizeof(*p->load));
    for (size_t c = 0, begin = 0; c < p->cycle_count; ++c) {
        const pci_cycle *cycle = &p->cycles[c];
        const double f = factor * (average ? cycle->f_sum : cycle->f);
        double sum = 0.0;
        for (size_t k = begin; k < cycle->end; ++k) {
            sum += y[p->entries[k]];
            p->load[p->entries[k]] += f;
        }
        const double lack = fmax(0.0, 1.0 - factor * sum);
        lacking += lack * lack;
        packed += f;
        begin = cycle->end;
    }
    // As y is at most 1, an overload may be paid for.
    for (size_t e = 0; e < p->graph->edge_count; ++e) {
        packed -= fmax(0.0, p->load[e] - p->costs[e]);
        value += factor * y[e] * p->costs[e];
    }
    const double gap = value - packed;
    return sqrt(p->weight * p->weight * lacking + gap * gap) / fmax(1.0, value);
}

static void begin_average(pci_cycle_program *p) {
    for (size_t e = 0; e < p->graph->edge_count; ++e) {
        p->y_sum[e] = 0.0;
        p->y_start[e] = p->y[e];
    }
    for (size_t c = 0; c < p->cycle_count; ++c) {
        p->cycles[c].f_sum = 0.0;
        p->cycles[c].f_start = p->cycles[c].f;
    }
    p->average = 0.0;
}

// Starts anew from the last or the average point, and balances primal and dual step lengths by how
// far both sides have moved.
static void restart(pci_cycle_program *p, bool from_average) {
    double primal = 0.0, dual = 0.0;
    for (size_t e = 0; e < p->graph->edge_count; ++e) {
        p->y[e] = from_average ? p->y_sum[e] / p->average : p->y[e];
        p->y_bar[e] = p->y[e];
        const double moved = p->y[e] - p->y_start[e];
        primal += moved * moved * (double)(p->degrees[e] + 1);
    }
    for (size_t c = 0, begin = 0; c < p->cycle_count; ++c) {
        pci_cycle *cycle = &p->cycles[c];
        cycle->f = from_average ? cycle->f_sum / p->average : cycle->f;
        const double moved = cycle->f - cycle->f_start;
        dual += moved * moved * (double)(cycle->end - begin);
        begin = cycle->end;
    }
    if (primal > 1e-20 && dual > 1e-20) {
        p->weight = sqrt(p->weight * sqrt(dual / primal));
    }
    begin_average(p);
}

// Restarts as in Applegate et al., "Faster first-order primal-dual methods for linear programming
// using restarts and sharpness", 2023.
double pci_cycle_program_iterate(pci_cycle_program *p, uint32_t iterations) {
    double at_start = (double)INFINITY, last = (double)INFINITY, error = 0.0;
    begin_average(p);
    for (uint32_t k = 1; k <= iterations; ++k) {
        step(p);
        if (k % CHECK_EVERY != 0 && k != iterations) {
            continue;
        }
        const double current = measure(p, false), average = measure(p, true);
        error = fmin(current, average);
        if (error < 0.2 * at_start || (error < 0.8 * at_start && error > last) || k == iterations) {
            restart(p, average < current);
            at_start = error;
            last = (double)INFINITY;
        } else {
            last = error;
        }
    }
    return error;
}

// ---- certificate --------------------------------------------------------------------------------

int64_t pci_cycle_program_pack(pci_cycle_program *p, int64_t *residuals) {
    memset(p->load, 0, p->graph->edge_count * sizeof(*p->load));
    for (size_t c = 0, k = 0; c < p->cycle_count; ++c) {
        for (; k < p->cycles[c].end; ++k) {
            p->load[p->entries[k]] += p->cycles[c].f;
        }
    }
    for (size_t e = 0; e < p->graph->edge_count; ++e) {
        residuals[e] = p->graph->edges[e].cost;
    }
    // First each cycle gets its share of the most crowded edge, then what room is left.
    int64_t total = 0;
    for (int pass = 0; pass < 2; ++pass) {
        for (size_t c = 0, begin = 0; c < p->cycle_count; ++c) {
            const pci_cycle *cycle = &p->cycles[c];
            int64_t amount = INT64_MAX;
            double share = 1.0;
            for (size_t k = begin; k < cycle->end; ++k) {
                const uint32_t e = p->entries[k];
                amount = residuals[e] < amount ? residuals[e] : amount;
                share = fmin(share, p->costs[e] / fmax(p->load[e], p->costs[e]));
            }
            const double wanted = cycle->f * share / p->scale;
            if (pass == 0 && wanted < (double)amount) {
                amount = (int64_t)wanted;
            }
            for (size_t k = begin; k < cycle->end; ++k) {
                residuals[p->entries[k]] -= amount;
            }
            total += amount;
            begin = cycle->end;
        }
    }
    return total;
}
