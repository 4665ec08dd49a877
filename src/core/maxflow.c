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

static void queue_push(queue *q, uint32_t node) {
    if (!q->member[node]) {
        q->member[node] = 1;
        q->nodes[(q->head + q->count) % q->size] = node;
        ++q->count;
    }
}

static uint32_t queue_pop(queue *q) {
    const uint32_t node = q->nodes[q->head];
    q->head = (q->head + 1) % q->size;
    --q->count;
    q->member[node] = 0;
    return node;
}

typedef struct search {
    const pci_flow_network *net;
    uint8_t *tree;
    uint32_t *parent; // arc from the node to its parent
    uint32_t *distance;
    uint64_t *stamp; // `distance` is known to be right at this time
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
        const uint8_t tree = s->tree[p];
        for (size_t k = net->offsets[p]; tree != FREE && k < net->offsets[p + 1]; ++k) {
            const uint32_t arc = net->arcs[k];
            if (growth(s, tree, arc) == 0) {
                continue;
            }
            const uint32_t q = net->heads[arc];
            if (s->tree[q] == FREE) {
                s->tree[q] = tree;
                s->parent[q] = arc ^ 1u;
                s->stamp[q] = s->stamp[p];
                s->distance[q] = s->distance[p] + 1;
                queue_push(&s->active, q);
            } else if (s->tree[q] != tree) {
                return tree == SOURCE ? arc : arc ^ 1u;
            } else if (s->stamp[q] <= s->stamp[p] && s->distance[q] > s->distance[p] + 1) {
                // A shorter way to the root.
                s->parent[q] = arc ^ 1u;
                s->stamp[q] = s->stamp[p];
                s->distance[q] = s->distance[p] + 1;
            }
        }
        queue_pop(&s->active);
    }
    return NO_ARC;
}

static void make_orphan(search *s, uint32_t node) {
    s->parent[node] = ORPHAN;
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
        for (; s->parent[v] != TERMINAL; v = net->heads[s->parent[v]]) {
            const int64_t room = cap[s->parent[v] ^ (side == 0)];
            amount = room < amount ? room : amount;
        }
        const int64_t room = side == 0 ? net->terminals[v] : -net->terminals[v];
        amount = room < amount ? room : amount;
    }
    cap[bridge] -= amount;
    cap[bridge ^ 1u] += amount;
    for (uint32_t side = 0; side < 2; ++side) {
        uint32_t v = ends[side];
        while (s->parent[v] != TERMINAL) {
            const uint32_t up = s->parent[v];
            const uint32_t forward = up ^ (side == 0);
            cap[forward] -= amount;
            cap[forward ^ 1u] += amount;
            if (cap[forward] == 0) {
                make_orphan(s, v);
            }
            v = net->heads[up];
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
    const pci_flow_network *net = s->net;
    uint32_t steps = 0, base = 0;
    uint32_t v = node;
    for (;; v = net->heads[s->parent[v]], ++steps) {
        if (s->stamp[v] == s->time) {
            base = s->distance[v];
            break;
        }
        if (s->parent[v] == TERMINAL) {
            base = 1;
            s->stamp[v] = s->time;
            s->distance[v] = 1;
            break;
        }
        if (s->parent[v] == ORPHAN || s->parent[v] == NO_PARENT) {
            return UINT32_MAX;
        }
    }
    // Remember what was learnt for the next orphans.
    const uint32_t distance = base + steps;
    uint32_t left = distance;
    for (v = node; s->stamp[v] != s->time; v = net->heads[s->parent[v]]) {
        s->stamp[v] = s->time;
        s->distance[v] = left--;
    }
    return distance;
}

static void adopt(search *s, uint32_t orphan) {
    const pci_flow_network *net = s->net;
    const uint8_t tree = s->tree[orphan];
    uint32_t best = NO_ARC, best_distance = UINT32_MAX;
    for (size_t k = net->offsets[orphan]; k < net->offsets[orphan + 1]; ++k) {
        const uint32_t arc = net->arcs[k];
        const uint32_t q = net->heads[arc];
        if (s->tree[q] == tree && growth(s, tree, arc ^ 1u) != 0) {
            const uint32_t distance = root_distance(s, q);
            if (distance < best_distance) {
                best = arc;
                best_distance = distance;
            }
        }
    }
    if (best != NO_ARC) {
        s->parent[orphan] = best;
        s->stamp[orphan] = s->time;
        s->distance[orphan] = best_distance + 1;
        return;
    }
    // No parent left: the node becomes free, its children orphans, and the neighbours that could
    // reach it active.
    s->tree[orphan] = FREE;
    s->parent[orphan] = NO_PARENT;
    for (size_t k = net->offsets[orphan]; k < net->offsets[orphan + 1]; ++k) {
        const uint32_t arc = net->arcs[k];
        const uint32_t q = net->heads[arc];
        if (s->tree[q] != tree) {
            continue;
        }
        if (growth(s, tree, arc ^ 1u) != 0) {
            queue_push(&s->active, q);
        }
        if (s->parent[q] < ORPHAN && net->heads[s->parent[q]] == orphan) {
            make_orphan(s, q);
        }
    }
}

bool pci_maxflow(pc_context *context, const pci_flow_network *network, int64_t *flow,
                 uint8_t *reachable) {
    const size_t n = network->node_count;
    pci_scratch scratch = pci_scratch_begin(context);
    search s = {.net = network};
    s.tree = PCI_SCRATCH(&scratch, uint8_t, n);
    s.parent = PCI_SCRATCH(&scratch, uint32_t, n);
    s.distance = PCI_SCRATCH(&scratch, uint32_t, n);
    s.stamp = PCI_SCRATCH(&scratch, uint64_t, n);
    s.active.nodes = PCI_SCRATCH(&scratch, uint32_t, n);
    s.active.member = PCI_SCRATCH(&scratch, uint8_t, n);
    s.orphans.nodes = PCI_SCRATCH(&scratch, uint32_t, n);
    s.orphans.member = PCI_SCRATCH(&scratch, uint8_t, n);
    s.active.size = s.orphans.size = n;
    bool ok = !scratch.failed;
    if (ok) {
        for (uint32_t v = 0; v < n; ++v) {
            s.parent[v] = NO_PARENT;
            if (network->terminals[v] != 0) {
                s.tree[v] = network->terminals[v] > 0 ? SOURCE : SINK;
                s.parent[v] = TERMINAL;
                s.distance[v] = 1;
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
            reachable[v] = s.tree[v] == SOURCE;
        }
    }
    pci_scratch_end(&scratch);
    return ok;
}
