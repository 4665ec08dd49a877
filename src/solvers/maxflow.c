#include "solvers/maxflow.h"

#include <stdatomic.h>

enum { FREE = 0, SOURCE = 1, SINK = 2 };
#define NO_PARENT UINT32_MAX
#define TERMINAL  (UINT32_MAX - 1)
#define ORPHAN    (UINT32_MAX - 2)
#define NO_ARC    UINT32_MAX

// Networks of so many nodes are searched in so many parts (a power of two) first.
enum { least_divided = 4096, most_parts = 4 };

// First in, first out, each node at most once.
typedef struct queue {
    uint32_t *nodes;
    uint8_t *member;
    size_t size, head, count;
} queue;

static void queue_push(queue *q, uint32_t item) {
    if (!q->member[item]) {
        q->member[item] = 1;
        const size_t at = q->head + q->count++;
        q->nodes[at < q->size ? at : at - q->size] = item;
    }
}

static uint32_t queue_pop(queue *q) {
    const uint32_t item = q->nodes[q->head];
    q->head = q->head + 1 < q->size ? q->head + 1 : 0;
    --q->count;
    q->member[item] = 0;
    return item;
}

// An arc as its tail sees it. All that a search asks lies together, in the order of the tails.
typedef struct flow_arc {
    uint32_t head;
    uint32_t mate;   // the same arc as its head sees it
    int64_t out, in; // capacities from the tail to the head and back
} flow_arc;

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
    flow_arc *arcs; // node v's are arcs[net->offsets[v] .. net->offsets[v + 1])
    uint64_t time;
    queue active, orphans;
    int64_t flow;
} search;

// Capacity of an arc in the direction in which flow passes when its tail is nearer the source (tree
// SOURCE) or nearer the sink (tree SINK).
static int64_t growth(uint8_t tree, const flow_arc *arc) {
    return tree == SOURCE ? arc->out : arc->in;
}

// Whether no flow passes in either direction: no capacity, or an arc to another part, of which
// nothing may be read.
static bool is_closed(const flow_arc *arc) { return arc->out + arc->in == 0; }

// Grows the trees until they touch; returns the arc from the source tree to the sink tree, or
// NO_ARC.
static uint32_t grow(search *s) {
    const size_t *offsets = s->net->offsets;
    while (s->active.count != 0) {
        const uint32_t p = s->active.nodes[s->active.head];
        const flow_node from = s->nodes[p];
        for (size_t k = offsets[p]; from.tree != FREE && k < offsets[p + 1]; ++k) {
            const flow_arc *arc = &s->arcs[k];
            if (growth(from.tree, arc) == 0) {
                continue;
            }
            flow_node *q = &s->nodes[arc->head];
            const bool is_free = q->tree == FREE;
            if (!is_free && q->tree != from.tree) {
                return from.tree == SOURCE ? (uint32_t)k : arc->mate;
            }
            // A free node, or a shorter way to the root.
            if (is_free || (q->stamp <= from.stamp && q->distance > from.distance + 1)) {
                *q = (flow_node){.stamp = from.stamp,
                                 .parent = arc->mate,
                                 .above = p,
                                 .distance = from.distance + 1,
                                 .tree = from.tree};
            }
            if (is_free) {
                queue_push(&s->active, arc->head);
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

// Pushes flow along an arc, or back; returns what is left of the capacity.
static int64_t push(search *s, uint32_t k, bool back, int64_t amount) {
    flow_arc *arc = &s->arcs[k], *mate = &s->arcs[arc->mate];
    arc->out -= back ? -amount : amount;
    arc->in += back ? -amount : amount;
    mate->out = arc->in;
    mate->in = arc->out;
    return back ? arc->in : arc->out;
}

// Pushes flow along the path through `bridge`; saturated tree arcs leave orphans.
static void augment(search *s, uint32_t bridge) {
    int64_t *terminals = s->net->terminals;
    const uint32_t ends[2] = {s->arcs[s->arcs[bridge].mate].head, s->arcs[bridge].head};
    int64_t amount = s->arcs[bridge].out;
    for (uint32_t side = 0; side < 2; ++side) {
        uint32_t v = ends[side];
        for (; s->nodes[v].parent != TERMINAL; v = s->nodes[v].above) {
            const flow_arc *arc = &s->arcs[s->nodes[v].parent];
            const int64_t room = side == 0 ? arc->in : arc->out;
            amount = room < amount ? room : amount;
        }
        const int64_t room = side == 0 ? terminals[v] : -terminals[v];
        amount = room < amount ? room : amount;
    }
    push(s, bridge, false, amount);
    for (uint32_t side = 0; side < 2; ++side) {
        uint32_t v = ends[side];
        for (; s->nodes[v].parent != TERMINAL; v = s->nodes[v].above) {
            if (push(s, s->nodes[v].parent, side == 0, amount) == 0) {
                make_orphan(s, v);
            }
        }
        terminals[v] += side == 0 ? -amount : amount;
        if (terminals[v] == 0) {
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
    const size_t begin = s->net->offsets[orphan], end = s->net->offsets[orphan + 1];
    const uint8_t tree = s->nodes[orphan].tree, other = tree == SOURCE ? SINK : SOURCE;
    uint32_t best = NO_ARC, best_distance = UINT32_MAX;
    for (size_t k = begin; k < end; ++k) {
        const flow_arc *arc = &s->arcs[k];
        if (growth(other, arc) != 0 && s->nodes[arc->head].tree == tree) {
            const uint32_t distance = root_distance(s, arc->head);
            if (distance < best_distance) {
                best = (uint32_t)k;
                best_distance = distance;
            }
        }
    }
    if (best != NO_ARC) {
        s->nodes[orphan] = (flow_node){.stamp = s->time,
                                       .parent = best,
                                       .above = s->arcs[best].head,
                                       .distance = best_distance + 1,
                                       .tree = tree};
        return;
    }
    // No parent left: the node becomes free, its children orphans, and the neighbours that could
    // reach it active.
    s->nodes[orphan].tree = FREE;
    s->nodes[orphan].parent = NO_PARENT;
    for (size_t k = begin; k < end; ++k) {
        const flow_arc *arc = &s->arcs[k];
        if (is_closed(arc) || s->nodes[arc->head].tree != tree) {
            continue;
        }
        const flow_node *q = &s->nodes[arc->head];
        if (growth(other, arc) != 0) {
            queue_push(&s->active, arc->head);
        }
        if (q->parent < ORPHAN && q->above == orphan) {
            make_orphan(s, arc->head);
        }
    }
}

// Copies the network to where the search wants it, all arcs closed.
static bool gather_arcs(pci_scratch *scratch, search *s) {
    const pci_flow_network *net = s->net;
    uint32_t *places = PCI_SCRATCH(scratch, uint32_t, net->arc_count);
    s->arcs = PCI_SCRATCH(scratch, flow_arc, net->arc_count);
    if (scratch->failed) {
        return false;
    }
    for (size_t k = 0; k < net->arc_count; ++k) {
        places[net->arcs[k]] = (uint32_t)k;
    }
    for (size_t k = 0; k < net->arc_count; ++k) {
        const uint32_t arc = net->arcs[k];
        s->arcs[k] = (flow_arc){.head = net->heads[arc], .mate = places[arc ^ 1u]};
    }
    return true;
}

// The roots of the trees.
static void plant(search *s, size_t first, size_t last) {
    for (size_t v = first; v < last; ++v) {
        const int64_t room = s->net->terminals[v];
        s->nodes[v].parent = NO_PARENT;
        if (room != 0) {
            s->nodes[v] =
                (flow_node){.parent = TERMINAL, .distance = 1, .tree = room > 0 ? SOURCE : SINK};
            queue_push(&s->active, (uint32_t)v);
        }
    }
}

// Opens what is closed of the arcs between nodes from `first` to before `last`.
static void open_arcs(search *s, size_t first, size_t last) {
    const pci_flow_network *net = s->net;
    for (size_t v = first; v < last; ++v) {
        bool opened = false;
        for (size_t k = net->offsets[v]; k < net->offsets[v + 1]; ++k) {
            flow_arc *arc = &s->arcs[k];
            if (is_closed(arc) && arc->head >= first && arc->head < last) {
                arc->out = net->capacities[net->arcs[k]];
                arc->in = net->capacities[net->arcs[k] ^ 1u];
                opened = true;
            }
        }
        if (opened && s->nodes[v].tree != FREE) {
            queue_push(&s->active, (uint32_t)v);
        }
    }
}

// What is left of a search when the trees of a part touch no more.
typedef struct part_state {
    uint64_t time;
    int64_t flow;
} part_state;

typedef struct flow_job {
    pc_context *context;
    search *whole;
    size_t size;        // nodes of a part
    size_t step;        // parts of the first level in one
    part_state *states; // by part of the first level
    atomic_bool cancelled;
} flow_job;

static void saturate_parts(void *user, size_t begin, size_t end, uint32_t worker) {
    flow_job *job = user;
    const size_t n = job->whole->net->node_count;
    for (size_t part = begin; part < end; ++part) {
        const size_t first = part * job->size;
        const size_t last = n - first < job->size ? n : first + job->size;
        part_state *state = &job->states[part * job->step];
        search s = *job->whole;
        s.active.nodes += first;
        s.orphans.nodes += first;
        s.active.size = s.orphans.size = last - first;
        if (job->step == 1) {
            plant(&s, first, last);
        } else {
            const part_state *other = state + job->step / 2;
            s.time = other->time > state->time ? other->time : state->time;
            s.flow = state->flow + other->flow;
        }
        open_arcs(&s, first, last);
        for (uint32_t bridge = grow(&s); bridge != NO_ARC; bridge = grow(&s)) {
            if (++s.time % 256 == 0) {
                // Only the thread that entered the library may ask.
                if (worker == 0 && !pci_keep_going(job->context)) {
                    atomic_store(&job->cancelled, true);
                }
                if (atomic_load(&job->cancelled)) {
                    return;
                }
            }
            augment(&s, bridge);
            while (s.orphans.count != 0) {
                adopt(&s, queue_pop(&s.orphans));
            }
        }
        *state = (part_state){s.time, s.flow};
    }
}

// The search begins in parts of the network, which know no arcs to others, and goes on in pairs of
// them: Liu and Sun, "Parallel graph-cuts by adaptive bottom-up merging", CVPR 2010.
bool pci_maxflow(pc_context *context, const pci_flow_network *network, int64_t *flow,
                 uint8_t *reachable) {
    const size_t n = network->node_count, parts = n < least_divided ? 1 : most_parts;
    pci_scratch scratch = pci_scratch_begin(context);
    search s = {.net = network};
    s.nodes = PCI_SCRATCH(&scratch, flow_node, n);
    s.active.nodes = PCI_SCRATCH(&scratch, uint32_t, n);
    s.active.member = PCI_SCRATCH(&scratch, uint8_t, n);
    s.orphans.nodes = PCI_SCRATCH(&scratch, uint32_t, n);
    s.orphans.member = PCI_SCRATCH(&scratch, uint8_t, n);
    flow_job job = {.context = context, .whole = &s, .size = (n + parts - 1) / parts};
    job.states = PCI_SCRATCH(&scratch, part_state, parts);
    bool ok = gather_arcs(&scratch, &s);
    for (job.step = 1; ok && job.step <= parts; job.step *= 2, job.size *= 2) {
        pci_parallel_for(context, parts / job.step, 1, saturate_parts, &job);
        ok = !job.cancelled;
    }
    if (ok) {
        *flow = job.states[0].flow;
        for (size_t k = 0; k < network->arc_count; ++k) {
            network->capacities[network->arcs[k]] = s.arcs[k].out;
        }
        for (size_t v = 0; v < n; ++v) {
            reachable[v] = s.nodes[v].tree == SOURCE;
        }
    }
    pci_scratch_end(&scratch);
    return ok;
}
