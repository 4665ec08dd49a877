#include "geometry/knn.h"

enum { FEW = 8 }; // points that are not divided further: all are looked at

static bool comes_before(const double *points, size_t axis, uint32_t a, uint32_t b) {
    const double x = points[3 * (size_t)a + axis], y = points[3 * (size_t)b + axis];
    return x < y || (x == y && a < b);
}

// Partial sort: afterwards order[middle] is in its place and nothing before it is larger.
static void select_middle(const double *points, size_t axis, uint32_t *order, size_t begin,
                          size_t end, size_t middle) {
    while (end - begin > 1) {
        // Median of three as pivot, moved to the end.
        const size_t last = end - 1, centre = begin + (end - begin) / 2;
        size_t low = begin, high = centre;
        if (comes_before(points, axis, order[high], order[low])) {
            low = centre, high = begin;
        }
        const size_t pivot_at = comes_before(points, axis, order[last], order[low])    ? low
                                : comes_before(points, axis, order[high], order[last]) ? high
                                                                                       : last;
        const uint32_t pivot = order[pivot_at];
        order[pivot_at] = order[last];
        size_t store = begin;
        for (size_t i = begin; i < last; ++i) {
            if (comes_before(points, axis, order[i], pivot)) {
                const uint32_t swapped = order[store];
                order[store++] = order[i];
                order[i] = swapped;
            }
        }
        order[last] = order[store];
        order[store] = pivot;
        if (store == middle) {
            return;
        }
        if (store < middle) {
            begin = store + 1;
        } else {
            end = store;
        }
    }
}

static size_t widest_axis(const double *points, const uint32_t *order, size_t begin, size_t end) {
    size_t widest = 0;
    double width = -1.0;
    for (size_t axis = 0; axis < 3; ++axis) {
        double low = INFINITY, high = -INFINITY;
        for (size_t i = begin; i < end; ++i) {
            const double x = points[3 * (size_t)order[i] + axis];
            low = x < low ? x : low;
            high = x > high ? x : high;
        }
        if (high - low > width) {
            width = high - low;
            widest = axis;
        }
    }
    return widest;
}

static void split(const pci_knn *knn, size_t begin, size_t end) {
    while (end - begin > FEW) {
        const size_t middle = begin + (end - begin) / 2;
        const size_t axis = widest_axis(knn->points, knn->order, begin, end);
        select_middle(knn->points, axis, knn->order, begin, end, middle);
        knn->axes[middle] = (uint8_t)axis;
        split(knn, begin, middle);
        begin = middle + 1;
    }
}

bool pci_knn_build(pci_scratch *scratch, size_t point_count, const double *points, pci_knn *knn) {
    memset(knn, 0, sizeof(*knn));
    knn->point_count = point_count;
    knn->points = points;
    knn->order = PCI_SCRATCH(scratch, uint32_t, point_count);
    knn->axes = PCI_SCRATCH(scratch, uint8_t, point_count);
    if (scratch->failed) {
        return false;
    }
    for (size_t i = 0; i < point_count; ++i) {
        knn->order[i] = (uint32_t)i;
    }
    split(knn, 0, point_count);
    return true;
}

typedef struct search {
    const pci_knn *knn;
    const double *query;
    size_t wanted, found;
    uint32_t excluded;
    double bound;      // squared distance that still counts
    bool any;          // the first one that counts ends the search
    uint32_t *indices; // sorted by (squared distance, index or rank)
    double *squared_distances;
} search;

static bool wins_tie(const pci_knn *knn, uint32_t a, uint32_t b) {
    return knn->ranks != NULL ? knn->ranks[a] < knn->ranks[b] : a < b;
}

static void offer(search *s, uint32_t candidate) {
    if (candidate == s->excluded) {
        return;
    }
    const double distance = pci_squared_distance(s->query, &s->knn->points[3 * (size_t)candidate]);
    if (distance > s->bound) {
        return;
    }
    size_t at = s->found;
    while (at > 0 && (distance < s->squared_distances[at - 1] ||
                      (distance == s->squared_distances[at - 1] &&
                       wins_tie(s->knn, candidate, s->indices[at - 1])))) {
        --at;
    }
    if (at == s->wanted) {
        return;
    }
    s->found += s->found < s->wanted;
    for (size_t i = s->found - 1; i > at; --i) {
        s->indices[i] = s->indices[i - 1];
        s->squared_distances[i] = s->squared_distances[i - 1];
    }
    s->indices[at] = candidate;
    s->squared_distances[at] = distance;
    if (s->found == s->wanted) {
        s->bound = s->any ? -1.0 : s->squared_distances[s->wanted - 1];
    }
}

static void visit(search *s, size_t begin, size_t end) {
    while (end - begin > FEW) {
        const size_t middle = begin + (end - begin) / 2;
        const uint32_t root = s->knn->order[middle];
        const size_t axis = s->knn->axes[middle];
        const double offset = s->query[axis] - s->knn->points[3 * (size_t)root + axis];
        // First the side of the query, then the root, then the far side where it can still matter;
        // a tie may hide a smaller index there.
        if (offset < 0.0) {
            visit(s, begin, middle);
            begin = middle + 1;
        } else {
            visit(s, middle + 1, end);
            end = middle;
        }
        offer(s, root);
        if (offset * offset > s->bound) {
            return;
        }
    }
    for (; begin < end; ++begin) {
        offer(s, s->knn->order[begin]);
    }
}

size_t pci_knn_query(const pci_knn *knn, const double query[3], size_t wanted, uint32_t excluded,
                     uint32_t *indices, double *squared_distances) {
    search s = {.knn = knn,
                .query = query,
                .wanted = wanted,
                .excluded = excluded,
                .bound = INFINITY,
                .indices = indices,
                .squared_distances = squared_distances};
    if (wanted > 0) {
        visit(&s, 0, knn->point_count);
    }
    return s.found;
}

static bool is_within(const pci_knn *knn, const double query[3], double radius, bool any,
                      uint32_t *found) {
    double squared_distance;
    search s = {.knn = knn,
                .query = query,
                .wanted = 1,
                .excluded = PC_INVALID_INDEX,
                .bound = radius * radius,
                .any = any,
                .indices = found,
                .squared_distances = &squared_distance};
    visit(&s, 0, knn->point_count);
    return s.found == 1;
}

bool pci_knn_within(const pci_knn *knn, const double query[3], double radius, uint32_t *nearest) {
    uint32_t found;
    return is_within(knn, query, radius, nearest == NULL, nearest != NULL ? nearest : &found);
}

bool pci_knn_within_near(const pci_knn *knn, const double query[3], double radius, uint32_t *hint) {
    return (*hint != PC_INVALID_INDEX &&
            pci_squared_distance(query, &knn->points[3 * (size_t)*hint]) <= radius * radius) ||
           is_within(knn, query, radius, true, hint);
}
