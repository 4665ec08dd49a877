#include "stages/simplify/corners.h"

#include <stdlib.h>

// A border loop as a closed polyline.
typedef struct loop {
    size_t count;
    const uint32_t *vertices;
    const double *lengths; // from the first vertex to vertex i along the loop; [count] is all
    const double *positions;
} loop;

// The point `distance` farther along the loop than vertex `from`; |distance| is below the length.
static void point_along(const loop *l, size_t from, double distance, double point[3]) {
    double at = l->lengths[from] + distance;
    at += at < 0.0 ? l->lengths[l->count] : 0.0;
    at -= at >= l->lengths[l->count] ? l->lengths[l->count] : 0.0;
    size_t low = 0, high = l->count; // lengths[low] <= at < lengths[high]
    while (high - low > 1) {
        const size_t middle = (low + high) / 2;
        *(l->lengths[middle] <= at ? &low : &high) = middle;
    }
    const double step = l->lengths[high] - l->lengths[low];
    const double share = step > 0.0 ? (at - l->lengths[low]) / step : 0.0;
    const double *a = &l->positions[3 * (size_t)l->vertices[low]];
    const double *b = &l->positions[3 * (size_t)l->vertices[high % l->count]];
    for (size_t k = 0; k < 3; ++k) {
        point[k] = a[k] + share * (b[k] - a[k]);
    }
}

// How far vertex i is ahead of the middle between the points `reach` before and behind it, over
// that reach: 0 on a straight line, the sine of half the angle at a corner, 1 at the tip of a slit.
static double sharpness(const loop *l, size_t i, double reach) {
    double before[3], after[3], ahead[3];
    const double *at = &l->positions[3 * (size_t)l->vertices[i]];
    point_along(l, i, -reach, before);
    point_along(l, i, reach, after);
    for (size_t k = 0; k < 3; ++k) {
        ahead[k] = at[k] - 0.5 * (before[k] + after[k]);
    }
    return pci_norm(ahead) / reach;
}

typedef struct corner {
    double sharpness;
    uint32_t vertex;
} corner;

static int compare_corners(const void *a, const void *b) { // sharpest first
    const corner *x = a, *y = b;
    if (x->sharpness != y->sharpness) {
        return x->sharpness > y->sharpness ? -1 : 1;
    }
    return (x->vertex > y->vertex) - (x->vertex < y->vertex);
}

// Adds the corners of a loop to those found; returns how many there are then.
static size_t find_in_loop(const loop *l, double reach, double *values, corner *found,
                           size_t count) {
    const double total = l->lengths[l->count];
    if (!(total > 6.0 * reach)) {
        return count; // nothing but corners
    }
    const double least = sin(PCI_PI * (1.0 / 6.0 + reach / total)); // half the angle
    for (size_t i = 0; i < l->count; ++i) {
        values[i] = sharpness(l, i, reach);
    }
    for (size_t i = 0; i < l->count; ++i) {
        bool sharpest = values[i] > least;
        for (size_t step = 1; sharpest && step < l->count; ++step) {
            const size_t j = (i + step) % l->count;
            double way = l->lengths[j] - l->lengths[i];
            way += way < 0.0 ? total : 0.0;
            if (way > reach) {
                break;
            }
            sharpest = values[j] <= values[i]; // ties go to the earlier one
        }
        for (size_t step = 1; sharpest && step < l->count; ++step) {
            const size_t j = (i + l->count - step) % l->count;
            double way = l->lengths[i] - l->lengths[j];
            way += way < 0.0 ? total : 0.0;
            if (way > reach) {
                break;
            }
            sharpest = values[j] < values[i];
        }
        if (sharpest) {
            found[count++] = (corner){values[i], l->vertices[i]};
        }
    }
    return count;
}

bool pci_find_corners(pci_scratch *scratch, const pci_halfedge *mesh, double reach,
                      uint32_t **corners, size_t *count) {
    size_t border = 0;
    for (size_t h = 0; h < 3 * mesh->triangle_count; ++h) {
        border += mesh->corners[h] != PC_INVALID_INDEX && mesh->twins[h] == PC_INVALID_INDEX;
    }
    uint32_t *vertices = PCI_SCRATCH(scratch, uint32_t, border);
    double *lengths = PCI_SCRATCH(scratch, double, border + 1);
    double *values = PCI_SCRATCH(scratch, double, border);
    corner *found = PCI_SCRATCH(scratch, corner, border);
    *corners = PCI_SCRATCH(scratch, uint32_t, border);
    *count = 0;
    uint8_t *visited = PCI_SCRATCH(scratch, uint8_t, mesh->vertex_count);
    if (scratch->failed) {
        return false;
    }
    for (uint32_t start = 0; start < mesh->vertex_count; ++start) {
        if (mesh->outgoing[start] == PC_INVALID_INDEX || visited[start] ||
            !pci_is_border_vertex(mesh, start)) {
            continue;
        }
        loop l = {0, vertices, lengths, mesh->positions};
        for (uint32_t v = start; !visited[v];) {
            const uint32_t next = pci_target(mesh, mesh->outgoing[v]);
            visited[v] = 1;
            vertices[l.count++] = v;
            lengths[l.count] = lengths[l.count - 1] +
                               sqrt(pci_squared_distance(&mesh->positions[3 * (size_t)v],
                                                         &mesh->positions[3 * (size_t)next]));
            v = next;
        }
        *count = find_in_loop(&l, reach, values, found, *count);
    }
    qsort(found, *count, sizeof(*found), compare_corners);
    for (size_t i = 0; i < *count; ++i) {
        (*corners)[i] = found[i].vertex;
    }
    return true;
}
