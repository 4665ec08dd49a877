#include "stages/skin/skin_compare.h"

// STRIDE: frames from one to the next; LANES of them are looked at side by side.
enum { STRIDE = 8, LANES = 4, BLOCK = 256, MAP = 3 * PCI_SKIN_COLUMNS_MAX };

typedef struct lane_sums {
    double ways[LANES], strains[LANES];
} lane_sums;

typedef struct compare_job {
    const pci_skin_fit *fit;
    bool closest; // the closest points' motion is asked for, not the garment's
    double origin[3];
    size_t frames[LANES];  // in hand
    double *maps;          // #P by MAP by LANES
    float *moved;          // #V by 3 by LANES, displacements
    float *lengths;        // of the edges of the rings to larger vertices, in order, at rest
    size_t *first_lengths; // #blocks of vertices
    lane_sums *sums;       // #blocks
} compare_job;

static void load_maps(const compare_job *job) {
    const pci_skin_problem *p = &job->fit->problem;
    for (size_t i = 0; i < p->proxy_count * LANES; ++i) {
        double map[MAP] = {0};
        pci_skin_bone_map(p, job->origin, job->frames[i % LANES], i / LANES, map);
        for (size_t k = 0; k < MAP; ++k) {
            job->maps[(i / LANES * MAP + k) * LANES + i % LANES] = map[k];
        }
    }
}

static void displace(const compare_job *job, size_t v, double u[3][LANES]) {
    const pci_skin_problem *p = &job->fit->problem;
    const size_t columns = pci_skin_columns(p), slots = p->slots;
    double point[PCI_SKIN_COLUMNS_MAX];
    pci_skin_point(p, job->origin, 1.0, v, point);
    for (size_t k = v * slots; k < (v + 1) * slots; ++k) {
        const double *map = &job->maps[MAP * LANES * (size_t)p->bones[k]];
        const double weight = job->fit->weights[k];
        for (size_t c = 0; c < columns && weight != 0.0; ++c) {
            for (size_t x = 0; x < 3; ++x) {
                for (size_t l = 0; l < LANES; ++l) {
                    u[x][l] += weight * (point[c] * map[(3 * c + x) * LANES + l]);
                }
            }
        }
    }
}

// The closest point, which the proxy's displacements move.
static void displace_closest(const compare_job *job, size_t v, double u[3][LANES]) {
    const pci_skin_problem *p = &job->fit->problem;
    const pci_place *closest = &job->fit->closest[v];
    const uint32_t *corners = &job->fit->proxy->triangles[3 * (size_t)closest->triangle];
    for (size_t c = 0; c < 3; ++c) {
        const double *rest = &p->proxy_rest[3 * (size_t)corners[c]];
        for (size_t l = 0; l < LANES; ++l) {
            const double *corner = &p->frames[3 * (p->proxy_count * job->frames[l] + corners[c])];
            for (size_t x = 0; x < 3; ++x) {
                u[x][l] += closest->barycentric[c] * (corner[x] - rest[x]);
            }
        }
    }
}

static void displace_all(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const compare_job *job = user;
    for (size_t v = begin; v < end; ++v) {
        double u[3][LANES] = {{0.0}};
        if (job->closest) {
            displace_closest(job, v, u);
        } else {
            displace(job, v, u);
        }
        for (size_t i = 0; i < 3 * LANES; ++i) {
            job->moved[3 * LANES * v + i] = (float)u[i / LANES][i % LANES];
        }
    }
}

// Adds the length of an edge, which the displacements of its ends change.
static void add_strains(const double edge[3], const float *from, const float *to, double length,
                        double strains[LANES]) {
    for (size_t l = 0; l < LANES; ++l) {
        double squared = 0.0;
        for (size_t x = 0; x < 3; ++x) {
            const double e = edge[x] + ((double)from[x * LANES + l] - (double)to[x * LANES + l]);
            squared += e * e;
        }
        strains[l] += fabs(sqrt(squared) / length - 1.0);
    }
}

static void add_block(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const compare_job *job = user;
    const pci_skin_problem *p = &job->fit->problem;
    const float *length = &job->lengths[job->first_lengths[begin / BLOCK]];
    lane_sums sums = {{0.0}, {0.0}};
    for (size_t v = begin; v < end; ++v) {
        const float *u = &job->moved[3 * LANES * v];
        for (size_t l = 0; l < LANES; ++l) {
            const double way[3] = {(double)u[l], (double)u[LANES + l], (double)u[2 * LANES + l]};
            sums.ways[l] += sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2]);
        }
        for (size_t e = p->ring_offsets[v]; e < p->ring_offsets[v + 1]; ++e) {
            const size_t j = p->ring[e];
            if (j > v && *length++ > 0.0f) {
                double edge[3];
                pci_sub(&p->rest[3 * v], &p->rest[3 * j], edge);
                add_strains(edge, u, &job->moved[3 * LANES * j], (double)length[-1], sums.strains);
            }
        }
    }
    job->sums[begin / BLOCK] = sums;
}

static void add_frames(compare_job *job, pci_skin_motion_sums *total) {
    const pci_skin_problem *p = &job->fit->problem;
    const size_t frames = (p->frame_count + STRIDE - 1) / STRIDE;
    for (size_t first = 0; first < frames; first += LANES) {
        const size_t count = frames - first < LANES ? frames - first : LANES;
        for (size_t l = 0; l < LANES; ++l) {
            job->frames[l] = STRIDE * (first + (l < count ? l : 0));
        }
        load_maps(job);
        pci_parallel_for(job->fit->context, p->vertex_count, BLOCK, displace_all, job);
        pci_parallel_for(job->fit->context, p->vertex_count, BLOCK, add_block, job);
        for (size_t i = 0; i * BLOCK < p->vertex_count; ++i) {
            for (size_t l = 0; l < count; ++l) {
                total->ways += job->sums[i].ways[l];
                total->strains += job->sums[i].strains[l];
            }
        }
    }
}

static void find_lengths(const pci_skin_problem *p, compare_job *job) {
    float *length = job->lengths;
    for (size_t v = 0; v < p->vertex_count; ++v) {
        if (v % BLOCK == 0) {
            job->first_lengths[v / BLOCK] = (size_t)(length - job->lengths);
        }
        for (size_t e = p->ring_offsets[v]; e < p->ring_offsets[v + 1]; ++e) {
            if (p->ring[e] > v) {
                *length++ = (float)sqrt(
                    pci_squared_distance(&p->rest[3 * v], &p->rest[3 * (size_t)p->ring[e]]));
            }
        }
    }
}

// The sums over the garment, or its closest points.
static bool sum_motion(const pci_skin_fit *f, bool closest, pci_skin_motion_sums *sums) {
    const pci_skin_problem *p = &f->problem;
    const size_t nv = p->vertex_count, blocks = (nv + BLOCK - 1) / BLOCK;
    pci_scratch scratch = pci_scratch_begin(f->context);
    compare_job job = {.fit = f,
                       .closest = closest,
                       .maps = PCI_SCRATCH(&scratch, double, MAP * p->proxy_count * LANES),
                       .moved = PCI_SCRATCH(&scratch, float, 3 * nv * LANES),
                       .lengths = PCI_SCRATCH(&scratch, float, p->ring_offsets[nv] / 2),
                       .first_lengths = PCI_SCRATCH(&scratch, size_t, blocks),
                       .sums = PCI_SCRATCH(&scratch, lane_sums, blocks)};
    const bool good = !scratch.failed;
    if (good) {
        (void)pci_skin_extent(p, job.origin);
        find_lengths(p, &job);
        add_frames(&job, sums);
    }
    pci_scratch_end(&scratch);
    return good;
}

bool pci_skin_measure_closest(pci_skin_fit *f) { return sum_motion(f, true, &f->closest_motion); }

bool pci_skin_compare(const pci_skin_fit *f, pci_skin_ratios *ratios) {
    const pci_skin_motion_sums *closest = &f->closest_motion;
    pci_skin_motion_sums garment = {0};
    const bool good = sum_motion(f, false, &garment);
    ratios->motion = closest->ways > 0.0 ? garment.ways / closest->ways : 1.0;
    ratios->strain = closest->strains > 0.0 ? garment.strains / closest->strains : 1.0;
    return good;
}
