#include "proxycloth/project.h"

#include "geometry/bvh.h"
#include "geometry/topology.h"
#include "solvers/sparse.h"

static const char stage[] = "project";

#define GRAIN           128
#define SPAN            1024 // of loops that do little: vertices stay with their core
#define ADAM_ITERATIONS 100
#define ALTERNATIONS    20
// The alternation ends when an iteration lowers the energy by less than this fraction. Going on
// would only slide the vertices along the garment: equation (1) is lowest where all meet.
#define ENERGY_TOLERANCE 0.005
// Of conjugate gradients. At 1e-2 the final energy is within .2 % of that of exact solutions.
#define INNER_TOLERANCE  0.01
#define INNER_ITERATIONS 200
// Nearest points are searched with room for so many more steps like the last one.
#define MARGIN_STEPS 3.0

static const char *const projection_solver_choices[] = {"vector_adam", "cholesky",
                                                        "conjugate_gradients", NULL};
static const pc_field option_fields[] = {
    PCI_FIELD_CHOICE(pc_project_options, projection_solver, PC_PROJECT_CONJUGATE_GRADIENTS, 2,
                     projection_solver_choices, "Solver of equation (1)"),
    PCI_FIELD_OPTION(pc_project_options, projection_iterations, UINT, 0, 0, 10000, "",
                     "Most iterations, each with new nearest points; 0: 100 for vector_adam, 20 "
                     "for the others"),
    PCI_FIELD_OPTION(pc_project_options, lambda_laplacian, DOUBLE, 1.0, 0.0, 1000.0, "",
                     "Weight of the Laplacian term of equation (1)"),
    PCI_FIELD_OPTION(pc_project_options, projection_step, DOUBLE, 0.05, 0.0001, 1.0, "voxels",
                     "Learning rate of VectorAdam"),
};
const pc_record pc_project_options_record = PCI_RECORD(option_fields, pc_project_options);

static const pc_field report_fields[] = {
    PCI_FIELD_REPORT(pc_project_report, energy_before, DOUBLE, "voxels^2",
                     "Equation (1) per vertex at the start"),
    PCI_FIELD_REPORT(pc_project_report, energy_after, DOUBLE, "voxels^2",
                     "Equation (1) per vertex at the end"),
    PCI_FIELD_REPORT(pc_project_report, mean_distance, DOUBLE, "voxels",
                     "Mean distance of the vertices to the garment"),
    PCI_FIELD_REPORT(pc_project_report, max_distance, DOUBLE, "voxels",
                     "Largest distance of a vertex to the garment"),
    PCI_FIELD_REPORT(pc_project_report, iterations, COUNT, "", "Iterations done"),
};
const pc_record pc_project_report_record = PCI_RECORD(report_fields, pc_project_report);

// Equation (1) and where the vertices are.
typedef struct problem {
    pc_context *context;
    const pci_bvh *bvh;
    const pci_topology *topology;
    const pc_project_options *options;
    size_t count;
    double cell_size;
    double *v;                // #V by 3
    double *nearest;          // #V by 3, p of equation (1)
    uint32_t refreshes;       // of those
    double *last;             // #V by 3, the vertices of the last iteration
    pci_surroundings *around; // #V
    const double *x;          // #V by 3, argument of the two functions below
    double *scaled;           // #V by 3, D^-1 L x with D the number of neighbours
    double *product;          // #V by 3, (I + lambda L^T L) x
    double *partial;          // per piece of GRAIN vertices, summed in order
} problem;

static double sum_of_pieces(const problem *p) {
    double sum = 0.0;
    for (size_t i = 0; i < (p->count + GRAIN - 1) / GRAIN; ++i) {
        sum += p->partial[i];
    }
    return sum;
}

// Keeps the sum of a piece behind its last vertex, and begins the next one.
static void end_piece(const problem *p, size_t vertex, double *sum) {
    if ((vertex + 1) % GRAIN == 0 || vertex + 1 == p->count) {
        p->partial[vertex / GRAIN] = *sum;
        *sum = 0.0;
    }
}

static double neighbour_count(const pci_topology *topology, size_t vertex) {
    return (double)(topology->ring_offsets[vertex + 1] - topology->ring_offsets[vertex]);
}

// ---- energy -------------------------------------------------------------------------------------

// p_i. Where p_i was is an upper bound for the new distance. Vertices move less and less: too many
// triangles are around the first step.
static void find_nearest(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const problem *p = user;
    for (size_t i = begin; i < end; ++i) {
        const double *v = &p->v[3 * i];
        double *nearest = &p->nearest[3 * i], *last = &p->last[3 * i];
        pci_closest closest = {.triangle = PC_INVALID_INDEX};
        if (p->refreshes > 0) {
            const double bound = sqrt(pci_squared_distance(v, nearest)) * (1.0 + 1e-6);
            const double margin = MARGIN_STEPS * sqrt(pci_squared_distance(v, last));
            closest = p->refreshes > 1
                          ? pci_bvh_closest_moving(p->bvh, v, bound, margin, &p->around[i])
                          : pci_bvh_closest(p->bvh, v, bound);
        }
        if (closest.triangle == PC_INVALID_INDEX) {
            closest = pci_bvh_closest(p->bvh, v, INFINITY);
        }
        memcpy(nearest, closest.point, sizeof(closest.point));
        memcpy(last, v, sizeof(closest.point));
    }
}

// L takes from each vertex the mean of its 1-ring.
static void apply_laplacian(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const problem *p = user;
    const pci_topology *t = p->topology;
    for (size_t i = begin; i < end; ++i) {
        const double count = neighbour_count(t, i), share = count > 0.0 ? 1.0 / count : 0.0;
        double sum[3] = {0.0};
        for (size_t r = t->ring_offsets[i]; r < t->ring_offsets[i + 1]; ++r) {
            const double *neighbour = &p->x[3 * (size_t)t->ring[r]];
            sum[0] += neighbour[0], sum[1] += neighbour[1], sum[2] += neighbour[2];
        }
        for (size_t k = 0; k < 3; ++k) {
            p->scaled[3 * i + k] = (p->x[3 * i + k] - sum[k] * share) * share;
        }
    }
}

// Needs `scaled`; the pieces of x^T (I + lambda L^T L) x go to `partial`.
static void apply_transposed(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const problem *p = user;
    const pci_topology *t = p->topology;
    double dot = 0.0;
    for (size_t i = begin; i < end; ++i) {
        const double count = neighbour_count(t, i);
        double sum[3] = {0.0}, *out = &p->product[3 * i];
        for (size_t r = t->ring_offsets[i]; r < t->ring_offsets[i + 1]; ++r) {
            const double *neighbour = &p->scaled[3 * (size_t)t->ring[r]];
            sum[0] += neighbour[0], sum[1] += neighbour[1], sum[2] += neighbour[2];
        }
        for (size_t k = 0; k < 3; ++k) {
            out[k] = p->x[3 * i + k] +
                     p->options->lambda_laplacian * (p->scaled[3 * i + k] * count - sum[k]);
        }
        dot += pci_dot(&p->x[3 * i], out);
        end_piece(p, i, &dot);
    }
}

static void measure_energy(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const problem *p = user;
    double energy = 0.0;
    for (size_t i = begin; i < end; ++i) {
        const double count = neighbour_count(p->topology, i);
        const double *scaled = &p->scaled[3 * i];
        energy += pci_squared_distance(&p->v[3 * i], &p->nearest[3 * i]) +
                  p->options->lambda_laplacian * count * count * pci_dot(scaled, scaled);
        end_piece(p, i, &energy);
    }
}

// Refreshes p and, for x = v, `scaled`, and the energy per vertex in squared voxels.
static pc_status refresh(problem *p, double *energy) {
    if (!pci_parallel_while_wanted(p->context, p->count, GRAIN, find_nearest, p)) {
        return pci_fail_cancelled(p->context, stage);
    }
    ++p->refreshes;
    p->x = p->v;
    pci_parallel_for(p->context, p->count, SPAN, apply_laplacian, p);
    pci_parallel_for(p->context, p->count, SPAN, measure_energy, p);
    *energy = sum_of_pieces(p) / ((double)p->count * p->cell_size * p->cell_size);
    return PC_OK;
}

// ---- VectorAdam ---------------------------------------------------------------------------------

// Adam with one second moment per vertex, so that steps do not depend on the axes [Ling et al.].
static pc_status run_vector_adam(problem *p, pci_scratch *scratch, uint32_t iterations,
                                 pc_project_report *report) {
    static const double beta1 = 0.9, beta2 = 0.999, epsilon = 1e-8;
    double *first = PCI_SCRATCH(scratch, double, 3 * p->count);
    double *second = PCI_SCRATCH(scratch, double, p->count);
    if (scratch->failed) {
        return pci_fail_memory(p->context, stage);
    }
    const double rate = p->options->projection_step * p->cell_size;
    double power1 = 1.0, power2 = 1.0;
    for (uint32_t t = 0; t < iterations; ++t) {
        pci_parallel_for(p->context, p->count, SPAN, apply_transposed, p);
        power1 *= beta1, power2 *= beta2;
        for (size_t i = 0; i < p->count; ++i) {
            // Gradient in voxels: 2 (v - p) + 2 lambda L^T L v.
            double g[3];
            for (size_t k = 0; k < 3; ++k) {
                g[k] = 2.0 * (p->product[3 * i + k] - p->nearest[3 * i + k]) / p->cell_size;
                first[3 * i + k] = beta1 * first[3 * i + k] + (1.0 - beta1) * g[k];
            }
            second[i] = beta2 * second[i] + (1.0 - beta2) * pci_dot(g, g);
            const double scale =
                rate / ((1.0 - power1) * (sqrt(second[i] / (1.0 - power2)) + epsilon));
            for (size_t k = 0; k < 3; ++k) {
                p->v[3 * i + k] -= scale * first[3 * i + k];
            }
        }
        const pc_status status = refresh(p, &report->energy_after);
        if (status != PC_OK) {
            return status;
        }
        report->iterations = t + 1;
        if (!pci_progress(p->context, stage, (double)(t + 1) / iterations)) {
            return pci_fail_cancelled(p->context, stage);
        }
    }
    return PC_OK;
}

// ---- fixed nearest points: conjugate gradients --------------------------------------------------

typedef struct gradients {
    problem *p;
    double *residual, *direction; // #V by 3
    double step, correction;
} gradients;

static void move_along_direction(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const gradients *g = user;
    double dot = 0.0;
    for (size_t i = 3 * begin; i < 3 * end; ++i) {
        g->p->v[i] += g->step * g->direction[i];
        g->residual[i] -= g->step * g->p->product[i];
        dot += g->residual[i] * g->residual[i];
        if (i % 3 == 2) {
            end_piece(g->p, i / 3, &dot);
        }
    }
}

static void choose_direction(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const gradients *g = user;
    for (size_t i = 3 * begin; i < 3 * end; ++i) {
        g->direction[i] = g->residual[i] + g->correction * g->direction[i];
    }
}

// Lowers |(I + lambda L^T L) v - p| to INNER_TOLERANCE of what it is. The matrix has a condition
// number of about 1 + 4 lambda, so that a few iterations do; each one lowers the energy. False:
// cancelled.
static bool conjugate_gradients(gradients *g) {
    problem *p = g->p;
    pci_parallel_for(p->context, p->count, SPAN, apply_transposed, p);
    for (size_t i = 0; i < 3 * p->count; ++i) {
        g->residual[i] = p->nearest[i] - p->product[i];
        g->direction[i] = 0.0;
    }
    g->step = g->correction = 0.0;
    pci_parallel_for(p->context, p->count, SPAN, move_along_direction, g);
    double square = sum_of_pieces(p);
    const double goal = INNER_TOLERANCE * INNER_TOLERANCE * square;
    p->x = g->direction;
    for (int k = 0; k < INNER_ITERATIONS && square > goal; ++k) {
        if (!pci_keep_going(p->context)) {
            return false;
        }
        pci_parallel_for(p->context, p->count, SPAN, choose_direction, g);
        pci_parallel_for(p->context, p->count, SPAN, apply_laplacian, p);
        pci_parallel_for(p->context, p->count, SPAN, apply_transposed, p);
        g->step = square / sum_of_pieces(p);
        pci_parallel_for(p->context, p->count, SPAN, move_along_direction, g);
        const double next = sum_of_pieces(p);
        g->correction = next / square;
        square = next;
    }
    return true;
}

// ---- fixed nearest points: Cholesky -------------------------------------------------------------

// Column j of I + lambda L^T L: sum over the rows i of L that use j. Returns the number of entries,
// rows ascending; `sums` stays zero.
static size_t find_column(const problem *p, uint32_t j, double *sums, uint32_t *rows,
                          double *values) {
    const pci_topology *t = p->topology;
    size_t count = 1;
    rows[0] = j;
    const size_t own = t->ring_offsets[j + 1] - t->ring_offsets[j];
    for (size_t a = 0; a <= own && own > 0; ++a) {
        const uint32_t i = a == 0 ? j : t->ring[t->ring_offsets[j] + a - 1];
        const size_t from = t->ring_offsets[i], to = t->ring_offsets[i + 1];
        const double weight = 1.0 / (double)(to - from);
        const double factor = p->options->lambda_laplacian * (a == 0 ? 1.0 : -weight);
        for (size_t b = 0; b <= to - from; ++b) {
            const uint32_t row = b == 0 ? i : t->ring[from + b - 1];
            size_t at = count;
            for (; at > 0 && rows[at - 1] > row; --at) {
            }
            if (at == 0 || rows[at - 1] != row) {
                memmove(rows + at + 1, rows + at, (count++ - at) * sizeof(*rows));
                rows[at] = row;
            }
            sums[row] += factor * (b == 0 ? 1.0 : -weight);
        }
    }
    sums[j] += 1.0;
    for (size_t r = 0; r < count; ++r) {
        values[r] = sums[rows[r]];
        sums[rows[r]] = 0.0;
    }
    return count;
}

static pc_status factorise(const problem *p, pci_scratch *scratch, pci_cholesky **cholesky) {
    const pci_topology *t = p->topology;
    size_t room = 0;
    for (size_t i = 0; i < p->count; ++i) {
        // Every row i of L adds its pattern to 1 + degree columns.
        const size_t degree = t->ring_offsets[i + 1] - t->ring_offsets[i];
        room += (degree + 1) * (degree + 1);
    }
    size_t *offsets = PCI_SCRATCH(scratch, size_t, p->count + 1);
    uint32_t *rows = PCI_SCRATCH(scratch, uint32_t, room);
    double *values = PCI_SCRATCH(scratch, double, room);
    double *sums = PCI_SCRATCH(scratch, double, p->count);
    if (scratch->failed) {
        return pci_fail_memory(p->context, stage);
    }
    for (size_t j = 0; j < p->count; ++j) {
        const size_t at = offsets[j];
        offsets[j + 1] = at + find_column(p, (uint32_t)j, sums, rows + at, values + at);
    }
    return pci_cholesky_create(p->context, stage, p->count, offsets, rows, values, cholesky);
}

// ---- alternation --------------------------------------------------------------------------------

// Both steps lower equation (1): v for fixed p, then the nearest p.
static pc_status run_alternation(problem *p, pci_scratch *scratch, uint32_t iterations,
                                 pc_project_report *report) {
    const bool direct = p->options->projection_solver == PC_PROJECT_CHOLESKY;
    pci_cholesky *cholesky = NULL;
    pc_status status = PC_OK;
    gradients g = {.p = p};
    if (direct) {
        status = factorise(p, scratch, &cholesky);
    } else {
        g.residual = PCI_SCRATCH(scratch, double, 3 * p->count);
        g.direction = PCI_SCRATCH(scratch, double, 3 * p->count);
        status = scratch->failed ? pci_fail_memory(p->context, stage) : PC_OK;
    }
    bool converged = false;
    for (uint32_t t = 0; t < iterations && !converged && status == PC_OK; ++t) {
        if (direct) {
            status = pci_cholesky_solve(p->context, cholesky, 3, p->nearest, p->v);
        } else if (!conjugate_gradients(&g)) {
            status = pci_fail_cancelled(p->context, stage);
        }
        const double previous = report->energy_after;
        if (status == PC_OK) {
            status = refresh(p, &report->energy_after);
        }
        if (status == PC_OK) {
            report->iterations = t + 1;
            converged = previous - report->energy_after <= ENERGY_TOLERANCE * previous;
        }
        if (status == PC_OK && !pci_progress(p->context, stage, (double)(t + 1) / iterations)) {
            status = pci_fail_cancelled(p->context, stage);
        }
    }
    pci_cholesky_destroy(p->context, cholesky);
    return status;
}

// ---- stage --------------------------------------------------------------------------------------

static pc_status run(problem *p, pci_scratch *scratch, const pc_mesh *isosurface,
                     pc_mesh *projected, pc_project_report *report) {
    pci_topology topology;
    p->count = isosurface->vertex_count;
    p->nearest = PCI_SCRATCH(scratch, double, 3 * p->count);
    p->last = PCI_SCRATCH(scratch, double, 3 * p->count);
    p->around = PCI_SCRATCH(scratch, pci_surroundings, p->count);
    p->scaled = PCI_SCRATCH(scratch, double, 3 * p->count);
    p->product = PCI_SCRATCH(scratch, double, 3 * p->count);
    p->partial = PCI_SCRATCH(scratch, double, p->count / GRAIN + 1);
    projected->vertex_count = p->count;
    projected->triangle_count = isosurface->triangle_count;
    projected->positions = PCI_ALLOCATE(p->context, double, 3 * p->count);
    projected->triangles = PCI_ALLOCATE(p->context, uint32_t, 3 * projected->triangle_count);
    if (scratch->failed || projected->positions == NULL || projected->triangles == NULL ||
        !pci_keep_going(p->context) ||
        !pci_topology_build_watched(scratch, isosurface, &topology)) {
        return pci_fail_memory(p->context, stage);
    }
    memcpy(projected->positions, isosurface->positions, 3 * p->count * sizeof(double));
    memcpy(projected->triangles, isosurface->triangles,
           3 * projected->triangle_count * sizeof(uint32_t));
    p->v = projected->positions;
    p->topology = &topology;

    pc_status status = refresh(p, &report->energy_before);
    if (status != PC_OK) {
        return status;
    }
    report->energy_after = report->energy_before;
    const bool adam = p->options->projection_solver == PC_PROJECT_VECTOR_ADAM;
    const uint32_t asked = p->options->projection_iterations;
    const uint32_t iterations = asked != 0 ? asked : adam ? ADAM_ITERATIONS : ALTERNATIONS;
    status = adam ? run_vector_adam(p, scratch, iterations, report)
                  : run_alternation(p, scratch, iterations, report);
    for (size_t i = 0; i < p->count && status == PC_OK; ++i) {
        const double distance =
            sqrt(pci_squared_distance(&p->v[3 * i], &p->nearest[3 * i])) / p->cell_size;
        report->mean_distance += distance / (double)p->count;
        report->max_distance = distance > report->max_distance ? distance : report->max_distance;
    }
    return status;
}

pc_status pc_project(pc_context *context, const pc_mesh *surface, const pc_mesh *isosurface,
                     double cell_size, const pc_project_options *options, pc_mesh *projected,
                     pc_project_report *report) {
    static const pc_mesh empty = {0};
    if (projected == NULL || memcmp(projected, &empty, sizeof(empty)) != 0) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "project: the output must be a zeroed pc_mesh");
    }
    pc_project_options chosen;
    pc_status status = pci_check_mesh_of_cells(context, stage, surface, "visual mesh", cell_size);
    if (status == PC_OK) {
        status = pci_check_mesh_of_cells(context, stage, isosurface, "iso-surface", cell_size);
    }
    if (status == PC_OK) {
        status = pci_begin_stage(context, stage, &pc_project_options_record, options, &chosen);
    }
    if (status != PC_OK) {
        return status;
    }
    pci_scratch scratch = pci_scratch_begin(context);
    pci_bvh *bvh = NULL;
    pc_project_report result = {0};
    status = pci_bvh_create(context, stage, surface, &bvh);
    if (status == PC_OK) {
        problem p = {.context = context, .bvh = bvh, .options = &chosen, .cell_size = cell_size};
        status = run(&p, &scratch, isosurface, projected, &result);
    }
    if (status != PC_OK) {
        pc_mesh_free(context, projected);
    } else if (report != NULL) {
        *report = result;
    }
    pci_bvh_destroy(context, bvh);
    pci_scratch_end(&scratch);
    return status;
}
