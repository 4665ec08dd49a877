#include "core/maxflow.h"

enum { FREE = 0, SOURCE = 1, SINK = 2 };
#define NO_PARENT UINT32_MAX
#define TERMINAL  (UINT32_MAX - 1)
#define ORPHAN    (UINT32_MAX - 2)
#define NO_ARC    UINT32_MAX

// First in, first out, each node at most once.
typedef struct queue {
    uint32_t *nodes;
    uint8_t *member;
    size_t size, head, count;
} queue;

static void queue_push(queue *q, uint32_t item) {
    if (!q->member[item]) {
        q->member[item] = 1;
        q->nodes[(q->head + q->count) % q->size] = item;
        ++q->count;
    }
}

static uint32_t queue_pop(queue *q) {
    const uint32_t item = q->nodes[q->head];
    q->head = (q->head + 1) % q->size;
    --q->count;
    q->member[item] = 0;
    return item;
}

typedef struct flow_node {
    uint64_t stamp;  // `distance` is known to be right at this time
    uint32_t parent; // arc from the node to its parent
    uint32_t above;  // where that leads
    uint32_t distance;
    uint8_t tree;
} flow_node;

typedef struct search {
    const pci_flow_network *net;
    flow_node *nodes;
    uint64_t time;
    queue active, orphans;
    int64_t flow;
} search;

// Capacity of `arc` in the direction in which flow passes when arc's tail is nearer the source
// (tree SOURCE) or nearer the sink (tree SINK).
static int64_t growth(const search *s, uint8_t tree, uint32_t arc) {
    return s->net->capacities[tree == SOURCE ? arc : arc ^ 1u];
}

// Grows the trees until they touch; returns the arc from the source tree to the sink tree, or
// NO_ARC.
static uint32_t grow(search *s) {
    const pci_flow_network *net = s->net;
    while (s->active.count != 0) {
        const uint32_t p = s->active.nodes[s->active.head];
        const uint8_t tree = s->nodes[p].tree;
        for (size_t k = net->offsets[p]; tree != FREE && k < net->offsets[p + 1]; ++k) {
            const uint32_t arc = net->arcs[k];
            if (growth(s, tree, arc) == 0) {
                continue;
            }
            const uint32_t q = net->heads[arc];
            if (s->nodes[q].tree == FREE) {
                s->nodes[q].tree = tree;
                s->nodes[q].parent = arc ^ 1u;
                s->nodes[q].above = p;
                s->nodes[q].stamp = s->nodes[p].stamp;
                s->nodes[q].distance = s->nodes[p].distance + 1;
                queue_push(&s->active, q);
            } else if (s->nodes[q].tree != tree) {
                return tree == SOURCE ? arc : arc ^ 1u;
            } else if (s->nodes[q].stamp <= s->nodes[p].stamp &&
                       s->nodes[q].distance > s->nodes[p].distance + 1) {
                // A shorter way to the root.
                s->nodes[q].parent = arc ^ 1u;
                s->nodes[q].above = p;
                s->nodes[q].stamp = s->nodes[p].stamp;
                s->nodes[q].distance = s->nodes[p].distance + 1;
            }
        }
        queue_pop(&s->active);
    }
    return NO_ARC;
}

static void make_orphan(search *s, uint32_t node) {
    s->nodes[node].parent = ORPHAN;
    queue_push(&s->orphans, node);
}

// Pushes flow along the path through `bridge`; saturated tree arcs leave orphans.
static void augment(search *s, uint32_t bridge) {
    const pci_flow_network *net = s->net;
    int64_t *cap = net->capacities;
    const uint32_t ends[2] = {net->heads[bridge ^ 1u], net->heads[bridge]};
    int64_t amount = cap[bridge];
    for (uint32_t side = 0; side < 2; ++side) {
        uint32_t v = ends[side];
        for (; s->nodes[v].parent != TERMINAL; v = s->nodes[v].above) {
            const int64_t room = cap[s->nodes[v].parent ^ (side == 0)];
            amount = room < amount ? room : amount;
        }
        const int64_t room = side == 0 ? net->terminals[v] : -net->terminals[v];
        amount = room < amount ? room : amount;
    }
    cap[bridge] -= amount;
    cap[bridge ^ 1u] += amount;
    for (uint32_t side = 0; side < 2; ++side) {
        uint32_t v = ends[side];
        while (s->nodes[v].parent != TERMINAL) {
            const uint32_t forward = s->nodes[v].parent ^ (side == 0);
            cap[forward] -= amount;
            cap[forward ^ 1u] += amount;
            if (cap[forward] == 0) {
                make_orphan(s, v);
            }
            v = s->nodes[v].above;
        }
        net->terminals[v] += side == 0 ? -amount : amount;
        if (net->terminals[v] == 0) {
            make_orphan(s, v);
        }
    }
    s->flow += amount;
}

// Distance of `node` to its terminal, or UINT32_MAX when the way up ends at an orphan.
static uint32_t root_distance(search *s, uint32_t node) {
    uint32_t steps = 0, base = 0;
    uint32_t v = node;
    for (;; v = s->nodes[v].above, ++steps) {
        if (s->nodes[v].stamp == s->time) {
            base = s->nodes[v].distance;
            break;
        }
        if (s->nodes[v].parent == TERMINAL) {
            base = 1;
            s->nodes[v].stamp = s->time;
            s->nodes[v].distance = 1;
            break;
        }
        if (s->nodes[v].parent == ORPHAN || s->nodes[v].parent == NO_PARENT) {
            return UINT32_MAX;
        }
    }
    // Remember what was learnt for the next orphans.
    const uint32_t distance = base + steps;
    uint32_t left = distance;
    for (v = node; s->nodes[v].stamp != s->time; v = s->nodes[v].above) {
        s->nodes[v].stamp = s->time;
        s->nodes[v].distance = left--;
    }
    return distance;
}

static void adopt(search *s, uint32_t orphan) {
    const pci_flow_network *net = s->net;
    const uint8_t tree = s->nodes[orphan].tree;
    uint32_t best = NO_ARC, best_distance = UINT32_MAX;
    for (size_t k = net->offsets[orphan]; k < net->offsets[orphan + 1]; ++k) {
        const uint32_t arc = net->arcs[k];
        const uint32_t q = net->heads[arc];
        if (s->nodes[q].tree == tree && growth(s, tree, arc ^ 1u) != 0) {
            const uint32_t distance = root_distance(s, q);
            if (distance < best_distance) {
                best = arc;
                best_distance = distance;
            }
        }
    }
    if (best != NO_ARC) {
        s->nodes[orphan].parent = best;
        s->nodes[orphan].above = net->heads[best];
        s->nodes[orphan].stamp = s->time;
        s->nodes[orphan].distance = best_distance + 1;
        return;
    }
    // No parent left: the node becomes free, its children orphans, and the neighbours that could
    // reach it active.
    s->nodes[orphan].tree = FREE;
    s->nodes[orphan].parent = NO_PARENT;
    for (size_t k = net->offsets[orphan]; k < net->offsets[orphan + 1]; ++k) {
        const uint32_t arc = net->arcs[k];
        const uint32_t q = net->heads[arc];
        if (s->nodes[q].tree != tree) {
            continue;
        }
        if (growth(s, tree, arc ^ 1u) != 0) {
            queue_push(&s->active, q);
        }
        if (s->nodes[q].parent < ORPHAN && s->nodes[q].above == orphan) {
            make_orphan(s, q);
        }
    }
}

bool pci_maxflow(pc_context *context, const pci_flow_network *network, int64_t *flow,
                 uint8_t *reachable) {
    const size_t n = network->node_count;
    pci_scratch scratch = pci_scratch_begin(context);
    search s = {.net = network};
    s.nodes = PCI_SCRATCH(&scratch, flow_node, n);
    s.active.nodes = PCI_SCRATCH(&scratch, uint32_t, n);
    s.active.member = PCI_SCRATCH(&scratch, uint8_t, n);
    s.orphans.nodes = PCI_SCRATCH(&scratch, uint32_t, n);
    s.orphans.member = PCI_SCRATCH(&scratch, uint8_t, n);
    s.active.size = s.orphans.size = n;
    bool ok = !scratch.failed;
    if (ok) {
        for (uint32_t v = 0; v < n; ++v) {
            s.nodes[v].parent = NO_PARENT;
            if (network->terminals[v] != 0) {
                s.nodes[v].tree = network->terminals[v] > 0 ? SOURCE : SINK;
                s.nodes[v].parent = TERMINAL;
                s.nodes[v].distance = 1;
                queue_push(&s.active, v);
            }
        }
        for (uint32_t bridge = grow(&s); bridge != NO_ARC && ok; bridge = grow(&s)) {
            ok = ++s.time % 256 != 0 || pci_keep_going(context);
            augment(&s, bridge);
            while (s.orphans.count != 0) {
                adopt(&s, queue_pop(&s.orphans));
            }
        }
        *flow = s.flow;
        for (size_t v = 0; v < n; ++v) {
            reachable[v] = s.nodes[v].tree == SOURCE;
        }
    }
    pci_scratch_end(&scratch);
    return ok;
}
