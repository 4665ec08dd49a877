// What the machine can do, for the operations that the stages are made of: measured here, so that
// a stage's figure has something to be held against.
#ifndef BENCH_LIMITS_H
#define BENCH_LIMITS_H

#include <stdlib.h>

#include "core/clock.h"
#include "core/core.h"
#include "geometry/bvh.h"

// Seconds of one thread per operation.
typedef struct limits {
    double byte;    // of a copy from memory to memory, each byte counted once read and once written
    double flop;    // fused or not, float, as wide as the compiler's default for this machine
    double closest; // closest point on the garment from within two voxels
    double ray;     // ray against the garment from there
} limits;

enum { LIMIT_BYTES = 1 << 26, LIMIT_FLOPS = 1 << 26, LIMIT_QUERIES = 20000 };

static inline double limit_copy(void) {
    char *from = malloc(LIMIT_BYTES), *to = malloc(LIMIT_BYTES);
    double best = INFINITY;
    if (from != NULL && to != NULL) {
        memset(from, 1, LIMIT_BYTES);
        memset(to, 2, LIMIT_BYTES);
        for (int run = 0; run < 5; ++run) {
            const double start = pci_clock_seconds();
            memcpy(to, from, LIMIT_BYTES);
            from[run] = to[LIMIT_BYTES - 1 - run]; // the copy is needed
            best = fmin(best, pci_clock_seconds() - start);
        }
    }
    free(from);
    free(to);
    return best / (2.0 * LIMIT_BYTES);
}

// Multiplications and additions on 128 independent chains.
#if defined(__x86_64__) && defined(__GNUC__)
__attribute__((target_clones("avx512f", "avx2", "default")))
#endif
static double
limit_flops_run(float *chains, float factor) {
    float sum = 0.0F;
    for (size_t i = 0; i < LIMIT_FLOPS / 256; ++i) {
        for (size_t k = 0; k < 128; ++k) {
            chains[k] = chains[k] * factor + 0.5F;
        }
    }
    for (size_t k = 0; k < 128; ++k) {
        sum += chains[k];
    }
    return (double)sum;
}

static inline double limit_flops(void) {
    float chains[128] = {0};
    double best = INFINITY, sum = 0.0;
    for (int run = 0; run < 5; ++run) {
        const double start = pci_clock_seconds();
        sum += limit_flops_run(chains, 0.5F);
        best = fmin(best, pci_clock_seconds() - start);
    }
    return sum > 0.0 ? best / LIMIT_FLOPS : 0.0;
}

// Queries around the garment's own vertices, `reach` away at most.
static inline bool limit_queries(pc_context *context, const pc_mesh *mesh, double reach,
                                 limits *result) {
    pci_bvh *bvh = NULL;
    if (pci_bvh_create(context, "bench", mesh, &bvh) != PC_OK) {
        return false;
    }
    double seconds[2] = {0.0, 0.0}, sink = 0.0;
    for (int kind = 0; kind < 2; ++kind) {
        const double start = pci_clock_seconds();
        for (uint64_t i = 0; i < LIMIT_QUERIES; ++i) {
            double point[3], direction[3];
            const size_t vertex = (size_t)(pci_random(1, 0, i) * (double)mesh->vertex_count);
            for (size_t k = 0; k < 3; ++k) {
                direction[k] = pci_random(1, 1 + k, i) - 0.5;
                point[k] = mesh->positions[3 * vertex + k] + 2.0 * reach * direction[k];
            }
            sink += kind == 0
                        ? pci_bvh_closest(bvh, point, INFINITY).distance
                        : (double)pci_bvh_cast(bvh, point, direction, 0.0, INFINITY, NULL, NULL)
                              .triangle;
        }
        seconds[kind] = pci_clock_seconds() - start;
    }
    pci_bvh_destroy(context, bvh);
    result->closest = seconds[0] / LIMIT_QUERIES;
    result->ray = seconds[1] / LIMIT_QUERIES;
    return sink >= 0.0;
}

#endif
