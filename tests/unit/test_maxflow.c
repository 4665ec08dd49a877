// Maximal flows: each is compared with its cut.
#include <stdlib.h>

#include "solvers/maxflow.h"
#include "support/test.h"

static void *zeroed(size_t count, size_t size) {
    void *memory = calloc(count, size);
    assert_non_null(memory);
    return memory;
}

// A network whose arcs are listed by their tails.
typedef struct flow_case {
    pci_flow_network net;
    uint32_t *heads, *arcs;
    size_t *offsets;
    int64_t *before, *start; // capacities and terminals
    uint8_t *reachable;
    int64_t flow;
} flow_case;

static void make_flow_case(uint64_t seed, uint32_t nodes, uint32_t edges, flow_case *c) {
    const uint32_t arcs = 2 * edges;
    *c = (flow_case){.heads = zeroed(arcs, sizeof(*c->heads)),
                     .arcs = zeroed(arcs, sizeof(*c->arcs)),
                     .offsets = zeroed(nodes + 2, sizeof(*c->offsets)),
                     .before = zeroed(arcs, sizeof(*c->before)),
                     .start = zeroed(nodes, sizeof(*c->start)),
                     .reachable = zeroed(nodes, 1)};
    for (uint32_t e = 0; e < edges; ++e) {
        const uint64_t bits = pci_random_bits(seed, 5, e);
        c->heads[2 * e] = (uint32_t)(bits % nodes);
        c->heads[2 * e + 1] = (c->heads[2 * e] + 1 + (uint32_t)(bits >> 8) % (nodes - 1)) % nodes;
        c->before[2 * e] = (int64_t)(bits >> 40 & 15);
        c->before[2 * e + 1] = (int64_t)(bits >> 50 & 3);
    }
    for (uint32_t arc = 0; arc < arcs; ++arc) {
        ++c->offsets[c->heads[arc ^ 1u] + 2];
    }
    for (uint32_t v = 0; v < nodes; ++v) {
        c->offsets[v + 2] += c->offsets[v + 1];
        c->start[v] = (int64_t)(pci_random_bits(seed, 6, v) % 31) - 15;
    }
    for (uint32_t arc = 0; arc < arcs; ++arc) {
        c->arcs[c->offsets[c->heads[arc ^ 1u] + 1]++] = arc;
    }
    c->net = (pci_flow_network){.node_count = nodes,
                                .arc_count = arcs,
                                .heads = c->heads,
                                .offsets = c->offsets,
                                .arcs = c->arcs,
                                .capacities = zeroed(arcs, sizeof(*c->before)),
                                .terminals = zeroed(nodes, sizeof(*c->start))};
}

static void solve_flow_case(pc_context *context, flow_case *c) {
    memcpy(c->net.capacities, c->before, c->net.arc_count * sizeof(*c->before));
    memcpy(c->net.terminals, c->start, c->net.node_count * sizeof(*c->start));
    assert_true(pci_maxflow(context, &c->net, &c->flow, c->reachable));
}

static void free_flow_case(flow_case *c) {
    void *const all[] = {c->heads, c->arcs,      c->offsets,        c->before,
                         c->start, c->reachable, c->net.capacities, c->net.terminals};
    for (size_t i = 0; i < sizeof(all) / sizeof(all[0]); ++i) {
        free(all[i]);
    }
}

// A flow that equals a cut is maximal, and the cut minimal.
static void check_flow(const flow_case *c) {
    const int64_t *capacities = c->net.capacities;
    int64_t cut = 0, sent = 0;
    int64_t *inflow = zeroed(c->net.node_count, sizeof(*inflow));
    memcpy(inflow, c->start, c->net.node_count * sizeof(*inflow));
    for (size_t arc = 0; arc < c->net.arc_count; arc += 2) {
        const int64_t along = c->before[arc] - capacities[arc];
        const uint32_t to = c->heads[arc], from = c->heads[arc + 1];
        assert_true(capacities[arc] >= 0 && capacities[arc + 1] >= 0);
        assert_int_equal(capacities[arc] + capacities[arc + 1],
                         c->before[arc] + c->before[arc + 1]);
        inflow[from] -= along, inflow[to] += along;
        cut += c->reachable[from] && !c->reachable[to] ? c->before[arc] : 0;
        cut += c->reachable[to] && !c->reachable[from] ? c->before[arc + 1] : 0;
    }
    for (size_t v = 0; v < c->net.node_count; ++v) {
        // What came from or went to the terminal is balanced by the arcs.
        const int64_t start = c->start[v];
        assert_int_equal(inflow[v], c->net.terminals[v]);
        sent += start > 0 ? start - c->net.terminals[v] : 0;
        cut += start > 0 && !c->reachable[v] ? start : 0;
        cut += start < 0 && c->reachable[v] ? -start : 0;
    }
    assert_int_equal(sent, c->flow);
    assert_int_equal(cut, c->flow);
    free(inflow);
}

static void flow_equals_cut(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    for (uint64_t seed = 0; seed < 100; ++seed) {
        flow_case c;
        make_flow_case(seed, 40, 130, &c);
        solve_flow_case(context, &c);
        check_flow(&c);
        free_flow_case(&c);
    }
    pc_context_destroy(context);
}

// Large networks are searched in parts, by as many threads as there are.
static void large_flow_equals_cut(void **state) {
    (void)state;
    pc_context *contexts[2] = {test_context(1), test_context(3)};
    flow_case c[2];
    for (size_t i = 0; i < 2; ++i) {
        make_flow_case(7, 6001, 20000, &c[i]);
        solve_flow_case(contexts[i], &c[i]);
        check_flow(&c[i]);
        pc_context_destroy(contexts[i]);
    }
    assert_memory_equal(c[0].net.capacities, c[1].net.capacities,
                        c[0].net.arc_count * sizeof(*c[0].before));
    free_flow_case(&c[0]);
    free_flow_case(&c[1]);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(flow_equals_cut),
        cmocka_unit_test(large_flow_equals_cut),
    };
    return cmocka_run_group_tests_name("maxflow", tests, NULL, NULL);
}
