// Proxy vertices that a visual vertex may follow, and the first guess of its weights.
#include "geometry/knn.h"
#include "stages/skin/skin_fit.h"

static const double distance_share = 0.1; // of the first guess

typedef struct candidate_job {
    const pci_knn *knn;
    const pc_mesh *surface, *proxy;
    const pci_place *closest;
    const pc_skin *followed; // or NULL
    uint32_t slots;
    uint32_t *bones;   // #V by slots
    double *surrogate; // #V by slots
} candidate_job;

// Appends a bone that is not listed yet, while there is room. True: it was.
static bool add_candidate(uint32_t *bones, uint32_t slots, uint32_t *count, uint32_t bone) {
    for (uint32_t k = 0; k < *count; ++k) {
        if (bones[k] == bone) {
            return false;
        }
    }
    if (*count == slots) {
        return false;
    }
    bones[(*count)++] = bone;
    return true;
}

// Candidates of one vertex: the corners of the closest triangle, the bones that L_f follows, then
// the nearest proxy vertices.
// First guess: mostly the barycentric coordinates, the rest by inverse distance; nothing is 0,
// where the gradient of |s| vanishes.
static void fill_candidates(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const candidate_job *job = user;
    for (size_t v = begin; v < end; ++v) {
        const double *position = &job->surface->positions[3 * v];
        const pci_place *closest = &job->closest[v];
        uint32_t *bones = &job->bones[v * job->slots];
        double *s = &job->surrogate[v * job->slots];
        uint32_t count = 0, near[PCI_SKIN_CANDIDATES_MAX];
        double squared[PCI_SKIN_CANDIDATES_MAX], barycentric[PCI_SKIN_CANDIDATES_MAX] = {0},
                                                 sum = 0.0, mean = 0.0;
        for (size_t c = 0; c < 3; ++c) {
            const uint32_t corner = job->proxy->triangles[3 * (size_t)closest->triangle + c];
            if (add_candidate(bones, job->slots, &count, corner)) {
                barycentric[count - 1] = closest->barycentric[c];
            }
        }
        for (size_t k = 0; job->followed != NULL && k < job->followed->influences; ++k) {
            const size_t at = v * job->followed->influences + k;
            if (job->followed->weights[at] > 0.0) {
                (void)add_candidate(bones, job->slots, &count, job->followed->bones[at]);
            }
        }
        const size_t found =
            pci_knn_query(job->knn, position, job->slots, PC_INVALID_INDEX, near, squared);
        for (size_t i = 0; i < found; ++i) {
            (void)add_candidate(bones, job->slots, &count, near[i]);
        }
        for (uint32_t k = 0; k < count; ++k) {
            s[k] =
                sqrt(pci_squared_distance(position, &job->proxy->positions[3 * (size_t)bones[k]]));
            mean += s[k] / (double)count;
        }
        for (uint32_t k = 0; k < count; ++k) {
            s[k] = mean > 0.0 ? 1.0 / (s[k] + 0.01 * mean) : 1.0;
            sum += s[k];
        }
        for (uint32_t k = 0; k < count; ++k) {
            s[k] = distance_share * s[k] / sum + (1.0 - distance_share) * barycentric[k];
        }
    }
}

bool pci_skin_find_candidates(pci_scratch *scratch, const pc_mesh *surface, const pc_mesh *proxy,
                              const pci_place *closest, const pc_skin *followed, uint32_t slots,
                              uint32_t *bones, double *weights) {
    pci_knn knn;
    if (!pci_knn_build(scratch, proxy->vertex_count, proxy->positions, &knn)) {
        return false;
    }
    candidate_job job = {.knn = &knn,
                         .surface = surface,
                         .proxy = proxy,
                         .closest = closest,
                         .followed = followed,
                         .slots = slots,
                         .bones = bones,
                         .surrogate = weights};
    pci_parallel_for(scratch->context, surface->vertex_count, 256, fill_candidates, &job);
    return true;
}
