// Meshes prepared for drawing: normals, borders and shadows.
#include "geometry/render.h"

#define CREASE_COSINE 0.6427F // of 50 degrees

typedef struct normal_job {
    const pci_model *model;
    const double *areas, *lengths; // #F by 3, area vectors; #F
    bool smooth;
} normal_job;

static void compute_areas(const pc_mesh *mesh, double *areas, double *lengths) {
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        pci_triangle_vector(mesh, t, &areas[3 * t]);
        lengths[t] = pci_norm(&areas[3 * t]);
    }
}

static void compute_normals(void *user, size_t begin, size_t end, uint32_t worker) {
    const normal_job *job = user;
    const pc_mesh *mesh = job->model->mesh;
    const pci_topology *topology = job->model->topology;
    (void)worker;
    for (size_t t = begin; t < end; ++t) {
        const double *own = &job->areas[3 * t];
        const double least = (double)CREASE_COSINE * job->lengths[t];
        for (size_t c = 0; c < 3; ++c) {
            const uint32_t v = mesh->triangles[3 * t + c];
            double sum[3] = {own[0], own[1], own[2]};
            const size_t first = topology->vertex_triangle_offsets[v];
            const size_t last = topology->vertex_triangle_offsets[v + 1];
            for (size_t k = first; k < last && job->smooth; ++k) {
                // Neighbours of the other winding count with their normal turned over.
                const uint32_t other = topology->vertex_triangles[k];
                const double *area = &job->areas[3 * (size_t)other];
                const double cosine = pci_dot(own, area);
                if (other != t && fabs(cosine) > least * job->lengths[other]) {
                    const double sign = cosine < 0.0 ? -1.0 : 1.0;
                    sum[0] += sign * area[0], sum[1] += sign * area[1], sum[2] += sign * area[2];
                }
            }
            pci_normalize(sum);
            for (size_t k = 0; k < 3; ++k) {
                job->model->normals[9 * t + 3 * c + k] = (float)sum[k];
            }
        }
    }
}

static bool find_borders(pci_scratch *scratch, pci_model *model) {
    const pc_mesh *mesh = model->mesh;
    pci_topology *topology = PCI_SCRATCH(scratch, pci_topology, 1);
    uint8_t *borders = PCI_SCRATCH(scratch, uint8_t, mesh->triangle_count);
    if (scratch->failed || !pci_topology_build(scratch, mesh, topology)) {
        return false;
    }
    for (size_t i = 0; i < 3 * mesh->triangle_count; ++i) {
        const uint32_t e = topology->triangle_edges[i];
        const bool border = e != PC_INVALID_INDEX && pci_side_count(topology, e) == 1;
        borders[i / 3] |= (uint8_t)((border ? 1U : 0U) << i % 3);
    }
    model->topology = topology;
    model->borders = borders;
    return true;
}

static void measure(pci_model *model) {
    const pc_mesh *mesh = model->mesh;
    double minimum[3], maximum[3];
    pci_bounding_box(mesh, minimum, maximum);
    model->radius = 0.5 * sqrt(pci_squared_distance(minimum, maximum));
    model->radius = model->radius > 0.0 ? model->radius : 1.0;
    for (size_t k = 0; k < 3; ++k) {
        model->centre[k] = 0.5 * (minimum[k] + maximum[k]);
    }
    const double scale = 1.0 / model->radius;
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        for (size_t k = 0; k < 3; ++k) {
            model->points[3 * v + k] =
                (float)((mesh->positions[3 * v + k] - model->centre[k]) * scale);
        }
    }
}

bool pci_model_build(const pci_renderer *renderer, pci_scratch *scratch, const pc_mesh *mesh,
                     pci_look look, const pci_model *like, pci_model *model) {
    const size_t count = mesh->triangle_count;
    memset(model, 0, sizeof(*model));
    model->mesh = mesh;
    model->points = PCI_SCRATCH(scratch, float, 3 * mesh->vertex_count);
    if (like != NULL) {
        model->topology = like->topology;
        model->borders = like->borders;
    }
    if (scratch->failed || (like == NULL && !find_borders(scratch, model))) {
        return false;
    }
    measure(model);
    if (look == PCI_LOOK_UNLIT) {
        return true;
    }
    model->normals = PCI_SCRATCH(scratch, float, 9 * count);
    double *areas = PCI_SCRATCH(scratch, double, 3 * count);
    double *lengths = PCI_SCRATCH(scratch, double, count);
    if (scratch->failed) {
        return false;
    }
    compute_areas(mesh, areas, lengths);
    normal_job job = {model, areas, lengths, look == PCI_LOOK_SMOOTH};
    pci_parallel_for(renderer->context, count, 1024, compute_normals, &job);
    model->shadows =
        pci_dome_cast(renderer->context, scratch, &renderer->dome, mesh, model->points);
    return model->shadows != NULL;
}
