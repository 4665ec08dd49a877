#include "stages/skin/skin_join.h"

#include "geometry/locality.h"
#include "geometry/topology.h"

static const double short_share = 0.01; // of the mean edge length

static double edge_length(const pc_mesh *mesh, size_t i, size_t j) {
    return sqrt(pci_squared_distance(&mesh->positions[3 * i], &mesh->positions[3 * j]));
}

// The length below which an edge is short, the edges of each triangle counted; 0: there is none.
static double find_short_length(const pc_mesh *mesh) {
    double sum = 0.0, least = INFINITY;
    size_t count = 0;
    for (size_t k = 0; k < 3 * mesh->triangle_count; ++k) {
        const size_t i = mesh->triangles[k], j = mesh->triangles[k % 3 == 2 ? k - 2 : k + 1];
        if (i != j) {
            const double length = edge_length(mesh, i, j);
            sum += length;
            least = length < least ? length : least;
            ++count;
        }
    }
    const double limit = count > 0 ? short_share * sum / (double)count : 0.0;
    return least < limit ? limit : 0.0;
}

// Numbers the vertices that `first` takes; `queue` has room for all.
static void take_near(const pc_mesh *mesh, const pci_topology *topology, double limit,
                      uint32_t first, uint32_t number, uint32_t *numbers, uint32_t *queue) {
    size_t count = 1;
    queue[0] = first;
    numbers[first] = number;
    for (size_t i = 0; i < count; ++i) {
        const uint32_t v = queue[i];
        for (size_t e = topology->ring_offsets[v]; e < topology->ring_offsets[v + 1]; ++e) {
            const uint32_t j = topology->ring[e];
            if (numbers[j] == PC_INVALID_INDEX && edge_length(mesh, v, j) < limit &&
                edge_length(mesh, first, j) < limit) {
                numbers[j] = number;
                queue[count++] = j;
            }
        }
    }
}

bool pci_skin_join(pci_scratch *scratch, const pc_mesh *surface, pc_mesh *joined,
                   const uint32_t **rows) {
    const size_t nv = surface->vertex_count, corners = 3 * surface->triangle_count;
    const double limit = find_short_length(surface);
    *joined = *surface;
    *rows = NULL;
    if (limit == 0.0) {
        return true;
    }
    uint32_t *numbers = PCI_SCRATCH(scratch, uint32_t, nv);
    double *positions = PCI_SCRATCH(scratch, double, 3 * nv);
    uint32_t *triangles = PCI_SCRATCH(scratch, uint32_t, corners);
    pci_scratch local = pci_scratch_begin(scratch->context);
    uint32_t *queue = PCI_SCRATCH(&local, uint32_t, nv);
    pci_topology topology;
    const bool good =
        !scratch->failed && !local.failed && pci_topology_build(&local, surface, &topology);
    uint32_t count = 0;
    if (good) {
        memset(numbers, 0xff, nv * sizeof(*numbers));
    }
    for (uint32_t v = 0; v < nv && good; ++v) {
        if (numbers[v] == PC_INVALID_INDEX) {
            memcpy(&positions[3 * (size_t)count], &surface->positions[3 * (size_t)v],
                   3 * sizeof(*positions));
            take_near(surface, &topology, limit, v, count++, numbers, queue);
        }
    }
    for (size_t k = 0; k < corners && good; ++k) {
        triangles[k] = numbers[surface->triangles[k]];
    }
    joined->vertex_count = count;
    joined->positions = positions;
    joined->triangles = triangles;
    *rows = numbers;
    pci_scratch_end(&local);
    return good;
}

bool pci_skin_sort(pci_scratch *scratch, const pc_mesh *surface, pc_mesh *sorted,
                   const uint32_t **rows, const uint32_t **ranks) {
    const size_t nv = surface->vertex_count;
    pci_scratch local = pci_scratch_begin(scratch->context);
    pc_mesh joined;
    const uint32_t *of_joined = NULL;
    uint32_t *order = NULL, *places = PCI_SCRATCH(&local, uint32_t, nv);
    uint32_t *chosen = PCI_SCRATCH(scratch, uint32_t, nv);
    const bool good = !scratch->failed && !local.failed &&
                      pci_skin_join(&local, surface, &joined, &of_joined) &&
                      pci_sort_mesh(scratch, &joined, sorted, &order);
    for (uint32_t i = 0; good && i < sorted->vertex_count; ++i) {
        places[order[i]] = i;
    }
    for (size_t v = 0; v < nv && good; ++v) {
        chosen[v] = places[of_joined != NULL ? of_joined[v] : v];
    }
    *rows = chosen;
    *ranks = order;
    pci_scratch_end(&local);
    return good;
}
