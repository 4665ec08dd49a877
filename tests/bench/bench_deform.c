// Seconds of pc_deform against a copy of as many bytes as it reads and writes.
// Usage: proxycloth_bench_deform [VERTICES [JOINTS [INFLUENCES [rotation]]]]
//
// "cache": one garment over and over, which stays in the caches. "memory": many garments in turn,
// 256 MiB, so that every call finds its data in memory, as in a frame of a game; the copy runs over
// as many bytes in pieces of the same size. All on one thread.
#define _POSIX_C_SOURCE 200809L
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "core/core.h"
#include "proxycloth/proxycloth.h"

static double now(void) {
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

typedef struct garments {
    size_t count, vertex_count, bytes; // read and written for each
    pc_deformer **deformers;
    float **positions, **normals;
    void *pose;
    char *from, *to;
} garments;

typedef enum task { DEFORM, DEFORM_NORMALS, COPY } task;

static void run(const garments *g, task what, size_t i) {
    if (what == COPY) {
        // Half is read, half is written.
        memcpy(g->to + i * (g->bytes / 2), g->from + i * (g->bytes / 2), g->bytes / 2);
    } else {
        const pc_deform_output output = {.positions = g->positions[i],
                                         .normals = what == DEFORM ? NULL : g->normals[i]};
        pc_deform(g->deformers[i], g->pose, 0, g->vertex_count, &output);
    }
}

// Seconds per garment of a task and of a copy, in turn, so that what else runs slows both. Every
// call is timed alone, and the least of all rounds counts for each garment: no task switch falls
// into it.
static void measure(const garments *g, task what, size_t count, double seconds[2]) {
    const size_t rounds = count > 1 ? 40 : 4000;
    double *best = malloc(2 * count * sizeof(*best));
    seconds[0] = seconds[1] = 0.0;
    for (size_t i = 0; i < 2 * count && best != NULL; ++i) {
        best[i] = 1e30;
    }
    for (size_t round = 0; round < 2 * rounds && best != NULL; ++round) {
        const size_t side = round % 2;
        for (size_t i = 0; i < count; ++i) {
            const double start = now();
            run(g, side == 0 ? what : COPY, i);
            const double taken = now() - start;
            double *least = &best[side * count + i];
            *least = taken < *least ? taken : *least;
        }
    }
    for (size_t i = 0; i < 2 * count && best != NULL; ++i) {
        seconds[i / count] += best[i] / (double)count;
    }
    free(best);
}

// A sheet of joints, and vertices in rows over it that follow the nearest ones.
static bool make(pc_context *context, garments *g, size_t joint_count, uint32_t influences,
                 uint32_t skinning) {
    const size_t nv = g->vertex_count;
    float *positions = calloc(6 * nv, sizeof(float)),
          *rest = calloc(3 * joint_count, sizeof(float));
    uint32_t *joints = calloc(nv * influences, sizeof(uint32_t));
    float *weights = calloc(nv * influences, sizeof(float));
    bool good = positions != NULL && rest != NULL && joints != NULL && weights != NULL;
    for (size_t i = 0; i < 6 * nv && good; ++i) {
        positions[i] = (float)pci_random(1, 0, i);
    }
    for (size_t i = 0; i < nv * influences && good; ++i) {
        joints[i] = (uint32_t)((i / influences * joint_count / nv +
                                pci_random_bits(1, 1, i) % (2 * (uint64_t)influences)) %
                               joint_count);
        weights[i] = (float)pci_random(1, 2, i) + 0.01F;
    }
    for (size_t i = 0; i < 3 * joint_count && good; ++i) {
        rest[i] = (float)pci_random(1, 3, i);
    }
    const pc_deform_arrays arrays = {.vertex_count = nv,
                                     .positions = positions,
                                     .normals = positions + 3 * nv,
                                     .influences = influences,
                                     .joints = joints,
                                     .weights = weights,
                                     .joint_count = joint_count,
                                     .joint_positions = rest,
                                     .skinning = skinning};
    for (size_t i = 0; i < g->count && good; ++i) {
        good = pc_deform_prepare(context, &arrays, &g->deformers[i]) == PC_OK;
        g->positions[i] = calloc(3 * nv, sizeof(float));
        g->normals[i] = calloc(3 * nv, sizeof(float));
        good = good && g->positions[i] != NULL && g->normals[i] != NULL;
    }
    if (good) {
        g->pose = malloc(pc_deform_pose_size(g->deformers[0]));
        good = g->pose != NULL;
    }
    if (good) {
        pc_deform_pose(g->deformers[0], &(pc_deform_input){.joints = rest}, g->pose);
    }
    free(positions);
    free(rest);
    free(joints);
    free(weights);
    return good;
}

static void report(garments *g, const char *where, size_t count, size_t influences) {
    const size_t sets = (influences + 3) / 4;
    const task tasks[] = {DEFORM, DEFORM_NORMALS};
    for (size_t i = 0; i < 2; ++i) {
        g->bytes = g->vertex_count * (24 * sets + 24 + (tasks[i] == DEFORM_NORMALS ? 24 : 0));
        double best[2];
        measure(g, tasks[i], count, best);
        const double seconds = best[0], copy = best[1];
        printf("%-7s %-22s %9.2f us %7.1f GB/s   copy %9.2f us %7.1f GB/s   share %5.1f %%\n",
               where, i == 0 ? "positions" : "positions and normals", 1e6 * seconds,
               1e-9 * (double)g->bytes / seconds, 1e6 * copy, 1e-9 * (double)g->bytes / copy,
               100.0 * copy / seconds);
    }
}

int main(int argc, char **argv) {
    const size_t vertex_count = argc > 1 ? strtoul(argv[1], NULL, 10) : 20000;
    const size_t joint_count = argc > 2 ? strtoul(argv[2], NULL, 10) : 128;
    const uint32_t influences = argc > 3 ? (uint32_t)strtoul(argv[3], NULL, 10) : 4;
    const bool turns = argc > 4 && strcmp(argv[4], "rotation") == 0;
    if (vertex_count == 0 || joint_count == 0 || influences == 0 || influences > 32) {
        fprintf(stderr, "usage: %s [VERTICES [JOINTS [INFLUENCES [rotation]]]]\n", argv[0]);
        return 2;
    }
    const size_t bytes = vertex_count * (24 * ((influences + 3) / 4) + 48);
    garments g = {.vertex_count = vertex_count, .count = ((size_t)256 << 20) / bytes + 1};
    pc_context *context = NULL;
    if (pc_context_create(NULL, &context) != PC_OK) {
        return 1;
    }
    g.deformers = calloc(g.count, sizeof(*g.deformers));
    g.positions = calloc(g.count, sizeof(*g.positions));
    g.normals = calloc(g.count, sizeof(*g.normals));
    g.from = calloc(g.count, bytes);
    g.to = calloc(g.count, bytes);
    bool good = g.deformers != NULL && g.positions != NULL && g.normals != NULL && g.from != NULL &&
                g.to != NULL;
    if (good) {
        memset(g.from, 1, g.count * bytes);
        memset(g.to, 1, g.count * bytes);
        good = make(context, &g, joint_count, influences,
                    turns ? PC_SKINNING_ROTATION : PC_SKINNING_TRANSLATION);
    }
    if (good) {
        printf("%zu vertices, %zu joints, %u influences\n", vertex_count, joint_count, influences);
        report(&g, "cache", 1, influences);
        report(&g, "memory", g.count, influences);
    }
    for (size_t i = 0; i < g.count && g.deformers != NULL; ++i) {
        pc_deform_destroy(context, g.deformers[i]);
        free(g.positions[i]);
        free(g.normals[i]);
    }
    free(g.deformers);
    free(g.positions);
    free(g.normals);
    free(g.pose);
    free(g.from);
    free(g.to);
    pc_context_destroy(context);
    return good ? 0 : 1;
}
