#include "stages/skin/skin_compare.h"

enum { STRIDE = 8, MAP = 3 * PCI_SKIN_COLUMNS_MAX }; // STRIDE: frames from one to the next

typedef struct compare_job {
    const pci_skin_fit *fit;
    bool closest; // the closest points' motion is asked for, not the garment's
    double origin[3];
    double *maps;   // #workers by #P by MAP
    float *moved;   // #workers by #V by 3, displacements
    float *lengths; // of the edges of the rings to larger vertices, in order, at rest
    pci_skin_motion_sums *sums;
} compare_job;

static void store(const double u[3], float *moved) {
    for (size_t x = 0; x < 3; ++x) {
        moved[x] = (float)u[x];
    }
}

static void displace(const compare_job *job, const double *maps, size_t v, float *moved) {
    const pci_skin_problem *p = &job->fit->problem;
    const size_t columns = pci_skin_columns(p), slots = p->slots;
    double point[PCI_SKIN_COLUMNS_MAX], u[3] = {0};
    pci_skin_point(p, job->origin, 1.0, v, point);
    for (size_t k = v * slots; k < (v + 1) * slots; ++k) {
        const double *map = &maps[MAP * (size_t)p->bones[k]], weight = job->fit->weights[k];
        for (size_t c = 0; c < columns; ++c) {
            for (size_t x = 0; x < 3; ++x) {
                u[x] += weight * (point[c] * map[3 * c + x]);
            }
        }
    }
    store(u, moved);
}

// The closest point, which the proxy's displacements move.
static void displace_closest(const compare_job *job, size_t frame, size_t v, float *moved) {
    const pci_skin_problem *p = &job->fit->problem;
    const pci_place *closest = &job->fit->closest[v];
    const uint32_t *corners = &job->fit->proxy->triangles[3 * (size_t)closest->triangle];
    double u[3] = {0};
    for (size_t c = 0; c < 3; ++c) {
        const double *rest = &p->proxy_rest[3 * (size_t)corners[c]];
        const double *corner = &p->frames[3 * (p->proxy_count * frame + corners[c])];
        for (size_t x = 0; x < 3; ++x) {
            u[x] += closest->barycentric[c] * (corner[x] - rest[x]);
        }
    }
    store(u, moved);
}

static void add_up(const compare_job *job, const float *moved, pci_skin_motion_sums *sums) {
    const pci_skin_problem *p = &job->fit->problem;
    const float *length = job->lengths;
    for (size_t v = 0; v < p->vertex_count; ++v) {
        const double *rest = &p->rest[3 * v];
        const double u[3] = {(double)moved[3 * v], (double)moved[3 * v + 1],
                             (double)moved[3 * v + 2]};
        sums->ways += pci_norm(u);
        for (size_t e = p->ring_offsets[v]; e < p->ring_offsets[v + 1]; ++e) {
            const size_t j = p->ring[e];
            double edge[3];
            if (j < v) {
                continue;
            }
            for (size_t x = 0; x < 3; ++x) {
                edge[x] = (rest[x] - p->rest[3 * j + x]) + (u[x] - (double)moved[3 * j + x]);
            }
            sums->strains += *length > 0.0f ? fabs(pci_norm(edge) / (double)*length - 1.0) : 0.0;
            ++length;
        }
    }
}

static void compare_frames(void *user, size_t begin, size_t end, uint32_t worker) {
    const compare_job *job = user;
    const pci_skin_problem *p = &job->fit->problem;
    double *maps = &job->maps[MAP * p->proxy_count * worker];
    float *moved = &job->moved[3 * p->vertex_count * worker];
    for (size_t i = begin; i < end; ++i) {
        for (size_t b = 0; b < p->proxy_count && !job->closest; ++b) {
            pci_skin_bone_map(p, job->origin, STRIDE * i, b, &maps[MAP * b]);
        }
        for (size_t v = 0; v < p->vertex_count; ++v) {
            if (job->closest) {
                displace_closest(job, STRIDE * i, v, &moved[3 * v]);
            } else {
                displace(job, maps, v, &moved[3 * v]);
            }
        }
        add_up(job, moved, &job->sums[i]);
    }
}

static void compare(compare_job *job, size_t frames, bool closest, pci_skin_motion_sums *total) {
    job->closest = closest;
    memset(job->sums, 0, frames * sizeof(*job->sums));
    pci_parallel_for(job->fit->context, frames, 1, compare_frames, job);
    for (size_t i = 0; i < frames; ++i) {
        total->ways += job->sums[i].ways;
        total->strains += job->sums[i].strains;
    }
}

bool pci_skin_compare(pci_skin_fit *f, pci_skin_ratios *ratios) {
    const pci_skin_problem *p = &f->problem;
    const size_t frames = (p->frame_count + STRIDE - 1) / STRIDE;
    const size_t workers = pc_context_threads(f->context), edges = p->ring_offsets[p->vertex_count];
    pci_scratch scratch = pci_scratch_begin(f->context);
    compare_job job = {.fit = f,
                       .maps = PCI_SCRATCH(&scratch, double, MAP * p->proxy_count * workers),
                       .moved = PCI_SCRATCH(&scratch, float, 3 * p->vertex_count * workers),
                       .lengths = PCI_SCRATCH(&scratch, float, edges / 2),
                       .sums = PCI_SCRATCH(&scratch, pci_skin_motion_sums, frames)};
    const bool good = !scratch.failed;
    if (good) {
        pci_skin_motion_sums garment = {0};
        (void)pci_skin_extent(p, job.origin);
        float *length = job.lengths;
        for (size_t v = 0; v < p->vertex_count; ++v) {
            for (size_t e = p->ring_offsets[v]; e < p->ring_offsets[v + 1]; ++e) {
                if (p->ring[e] > v) {
                    *length++ = (float)sqrt(
                        pci_squared_distance(&p->rest[3 * v], &p->rest[3 * (size_t)p->ring[e]]));
                }
            }
        }
        compare(&job, frames, false, &garment);
        if (f->closest_motion.ways == 0.0) {
            compare(&job, frames, true, &f->closest_motion);
        }
        const pci_skin_motion_sums *closest = &f->closest_motion;
        ratios->motion = closest->ways > 0.0 ? garment.ways / closest->ways : 1.0;
        ratios->strain = closest->strains > 0.0 ? garment.strains / closest->strains : 1.0;
    }
    pci_scratch_end(&scratch);
    return good;
}
