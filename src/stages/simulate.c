// Based on: Mueller, Heidelberger, Hennix, Ratcliff, "Position based dynamics", 2007.
#include "proxycloth/simulate.h"

#include <stdlib.h>

#include "core/topology.h"
#include "core/union_find.h"
#include "stages/simulate_internal.h"

static const char stage[] = "simulate";

static const char *const up_axis_choices[] = {"x", "y", "z", NULL};
static const pc_field option_fields[] = {
    PCI_FIELD_OPTION(pc_simulate_options, frames, UINT, 200, 1, 100000, "frames",
                     "Frames that are kept"),
    PCI_FIELD_OPTION(pc_simulate_options, frame_steps, UINT, 3, 1, 1000, "steps",
                     "Steps per kept frame"),
    PCI_FIELD_OPTION(pc_simulate_options, time_step, DOUBLE, 1.0 / 60.0, 0.0001, 0.1, "s",
                     "Length of a step"),
    PCI_FIELD_OPTION(pc_simulate_options, solver_iterations, UINT, 10, 1, 1000, "sweeps",
                     "Sweeps over the springs per step"),
    PCI_FIELD_OPTION(pc_simulate_options, stretch_stiffness, DOUBLE, 1.0, 0.0, 1.0, "",
                     "k_s of the springs along edges"),
    PCI_FIELD_OPTION(pc_simulate_options, bend_stiffness, DOUBLE, 0.2, 0.0, 1.0, "",
                     "k_b of the springs across edges"),
    PCI_FIELD_OPTION(pc_simulate_options, damping, DOUBLE, 0.02, 0.0, 1.0, "",
                     "Share of the velocity lost per step"),
    PCI_FIELD_OPTION(pc_simulate_options, gravity, DOUBLE, 9.81, -100.0, 100.0, "m/s^2",
                     "Acceleration downwards"),
    PCI_FIELD_OPTION(pc_simulate_options, area_density, DOUBLE, 0.2, 0.001, 100.0, "kg/m^2",
                     "Mass of the cloth per area"),
    PCI_FIELD_OPTION(pc_simulate_options, air_density, DOUBLE, 1.2, 0.0, 100.0, "kg/m^3",
                     "Strength of the wind force on a triangle"),
    PCI_FIELD_OPTION(pc_simulate_options, wind_speed, DOUBLE, 6.0, 0.0, 100.0, "m/s",
                     "Strongest wind"),
    PCI_FIELD_OPTION(pc_simulate_options, pinned_fraction, DOUBLE, 0.05, 0.0, 1.0, "",
                     "Share of the vertices that is held, the highest ones, rounded up"),
    PCI_FIELD_OPTION(pc_simulate_options, garment_size, DOUBLE, 1.5, 0.0, 1000.0, "m",
                     "Diagonal at which the garment is simulated, 0 for the file's own size"),
    PCI_FIELD_CHOICE(pc_simulate_options, up_axis, 1, 2, up_axis_choices, "Axis that points up"),
    PCI_FIELD_OPTION(pc_simulate_options, seed, UINT, 1, 0, 4294967295, "",
                     "Seed of the random winds"),
};
const pc_record pc_simulate_options_record = PCI_RECORD(option_fields, pc_simulate_options);

static const pc_field report_fields[] = {
    PCI_FIELD_REPORT(pc_simulate_report, stretch_springs, COUNT, "", "Springs along edges"),
    PCI_FIELD_REPORT(pc_simulate_report, bend_springs, COUNT, "", "Springs across edges"),
    PCI_FIELD_REPORT(pc_simulate_report, pinned, COUNT, "", "Vertices that are held"),
    PCI_FIELD_REPORT(pc_simulate_report, mean_strain, DOUBLE, "",
                     "Mean relative change of length of the edges over all frames"),
    PCI_FIELD_REPORT(pc_simulate_report, p95_strain, DOUBLE, "",
                     "Change of length that 95 % of the edges and frames stay below"),
    PCI_FIELD_REPORT(pc_simulate_report, max_strain, DOUBLE, "", "Largest change of length"),
    PCI_FIELD_REPORT(pc_simulate_report, max_speed, DOUBLE, "m/s",
                     "Largest speed of a vertex at the simulated size"),
    PCI_FIELD_REPORT(pc_simulate_report, motion_range, DOUBLE, "diagonals",
                     "Largest distance of a vertex from its rest position"),
};
const pc_record pc_simulate_report_record = PCI_RECORD(report_fields, pc_simulate_report);

// ---- one step -----------------------------------------------------------------------------------

// Wind pushes each triangle along its normal, in proportion to the relative speed.
static void accumulate_wind(pci_cloth *cloth, const double wind[3]) {
    memset(cloth->forces, 0, 3 * cloth->vertex_count * sizeof(*cloth->forces));
    for (size_t t = 0; t < cloth->triangle_count; ++t) {
        const size_t a = 3 * (size_t)cloth->triangles[3 * t];
        const size_t b = 3 * (size_t)cloth->triangles[3 * t + 1];
        const size_t c = 3 * (size_t)cloth->triangles[3 * t + 2];
        double ab[3], ac[3], normal[3], relative[3];
        pci_sub(&cloth->positions[b], &cloth->positions[a], ab);
        pci_sub(&cloth->positions[c], &cloth->positions[a], ac);
        pci_cross(ab, ac, normal);
        const double doubled_area = pci_norm(normal);
        if (!(doubled_area > 0.0)) {
            continue;
        }
        for (size_t k = 0; k < 3; ++k) {
            relative[k] = wind[k] - (cloth->velocities[a + k] + cloth->velocities[b + k] +
                                     cloth->velocities[c + k]) /
                                        3.0;
        }
        // Area is half of doubled_area, a third of the force acts on each corner.
        for (size_t k = 0; k < 3; ++k) {
            normal[k] /= doubled_area;
        }
        const double pressure = cloth->air_density * 0.5 * doubled_area * pci_dot(relative, normal);
        for (size_t k = 0; k < 3; ++k) {
            const double force = pressure * normal[k] / 3.0;
            cloth->forces[a + k] += force;
            cloth->forces[b + k] += force;
            cloth->forces[c + k] += force;
        }
    }
}

// One Gauss-Seidel sweep: each spring moves its ends towards the rest length, shared by mass.
static void sweep_springs(pci_cloth *cloth) {
    double *x = cloth->positions;
    for (size_t s = 0; s < cloth->spring_count; ++s) {
        const pci_spring *spring = &cloth->springs[s];
        double *a = &x[3 * (size_t)spring->a], *b = &x[3 * (size_t)spring->b];
        const double mass_a = cloth->inverse_mass[spring->a];
        const double mass_b = cloth->inverse_mass[spring->b];
        const double dx = b[0] - a[0], dy = b[1] - a[1], dz = b[2] - a[2];
        const double length = sqrt(dx * dx + dy * dy + dz * dz);
        const double resistance = length * (mass_a + mass_b);
        if (!(resistance > 0.0)) {
            continue; // both ends held, or no direction
        }
        const double scale = spring->stiffness * (length - spring->rest) / resistance;
        const double move_a = scale * mass_a, move_b = scale * mass_b;
        a[0] += move_a * dx, a[1] += move_a * dy, a[2] += move_a * dz;
        b[0] -= move_b * dx, b[1] -= move_b * dy, b[2] -= move_b * dz;
    }
}

void pci_cloth_step(pci_cloth *cloth, const double wind[3]) {
    const double dt = cloth->time_step, kept = 1.0 - cloth->damping;
    accumulate_wind(cloth, wind);
    memcpy(cloth->previous, cloth->positions, 3 * cloth->vertex_count * sizeof(double));
    for (size_t v = 0; v < cloth->vertex_count; ++v) {
        const double inverse_mass = cloth->inverse_mass[v];
        for (size_t k = 3 * v; k < 3 * v + 3 && inverse_mass > 0.0; ++k) {
            const double acceleration = cloth->forces[k] * inverse_mass + cloth->gravity[k - 3 * v];
            cloth->velocities[k] = (cloth->velocities[k] + dt * acceleration) * kept;
            cloth->positions[k] += dt * cloth->velocities[k];
        }
    }
    for (uint32_t i = 0; i < cloth->iterations; ++i) {
        sweep_springs(cloth);
    }
    for (size_t k = 0; k < 3 * cloth->vertex_count; ++k) {
        cloth->velocities[k] = (cloth->positions[k] - cloth->previous[k]) / dt;
    }
}

// ---- springs ------------------------------------------------------------------------------------

double pci_sweep_stiffness(double k, uint32_t iterations) {
    return 1.0 - pow(1.0 - k, 1.0 / (double)iterations);
}

// Orders springs by the smallest colour that neither end has yet. Springs of one colour share no
// vertex, so the processor can work on several at a time.
static bool order_by_colour(pci_scratch *scratch, size_t vertex_count, const pci_spring *springs,
                            size_t count, pci_spring *ordered) {
    uint64_t *used = PCI_SCRATCH(scratch, uint64_t, vertex_count);
    uint8_t *colours = PCI_SCRATCH(scratch, uint8_t, count);
    if (scratch->failed) {
        return false;
    }
    size_t starts[65] = {0};
    for (size_t s = 0; s < count; ++s) {
        const uint64_t taken = used[springs[s].a] | used[springs[s].b];
        uint8_t colour = 0;
        while (colour < 63 && (taken >> colour & 1) != 0) {
            ++colour; // the last colour takes whatever is left
        }
        used[springs[s].a] |= UINT64_C(1) << colour;
        used[springs[s].b] |= UINT64_C(1) << colour;
        colours[s] = colour;
        ++starts[colour + 1];
    }
    for (size_t c = 0; c < 64; ++c) {
        starts[c + 1] += starts[c];
    }
    for (size_t s = 0; s < count; ++s) {
        ordered[starts[colours[s]]++] = springs[s];
    }
    return true;
}

// The corner of a triangle that is on neither end of an edge.
static uint32_t opposite_corner(const uint32_t *corners, const uint32_t *edge) {
    for (size_t c = 0; c < 2; ++c) {
        if (corners[c] != edge[0] && corners[c] != edge[1]) {
            return corners[c];
        }
    }
    return corners[2];
}

static pci_spring make_spring(const pc_mesh *mesh, uint32_t a, uint32_t b, double stiffness) {
    const pci_spring spring = {.a = a,
                               .b = b,
                               .stiffness = stiffness,
                               .rest = sqrt(pci_squared_distance(&mesh->positions[3 * (size_t)a],
                                                                 &mesh->positions[3 * (size_t)b]))};
    return spring;
}

bool pci_springs_build(pci_scratch *scratch, const pc_mesh *mesh, double stretch, double bend,
                       pci_spring **springs, size_t *spring_count, size_t *edge_spring_count) {
    pci_topology topology;
    if (!pci_topology_build(scratch, mesh, &topology)) {
        return false;
    }
    const size_t edge_count = topology.edge_count;
    pci_spring *listed = PCI_SCRATCH(scratch, pci_spring, edge_count + 3 * mesh->triangle_count);
    *springs = PCI_SCRATCH(scratch, pci_spring, edge_count + 3 * mesh->triangle_count);
    if (scratch->failed) {
        return false;
    }
    for (size_t e = 0; e < edge_count; ++e) {
        listed[e] = make_spring(mesh, topology.edges[2 * e], topology.edges[2 * e + 1], stretch);
    }
    // Across each edge, the far corners of its triangles, pair by pair.
    size_t count = edge_count;
    for (size_t e = 0; e < edge_count; ++e) {
        for (size_t k = topology.edge_triangle_offsets[e] + 1;
             k < topology.edge_triangle_offsets[e + 1]; ++k) {
            const uint32_t *edge = &topology.edges[2 * e];
            const uint32_t t0 = topology.edge_triangles[k - 1], t1 = topology.edge_triangles[k];
            const uint32_t a = opposite_corner(&mesh->triangles[3 * (size_t)t0], edge);
            const uint32_t b = opposite_corner(&mesh->triangles[3 * (size_t)t1], edge);
            if (a != b) {
                listed[count++] = make_spring(mesh, a < b ? a : b, a < b ? b : a, bend);
            }
        }
    }
    *spring_count = count;
    *edge_spring_count = edge_count;
    return order_by_colour(scratch, mesh->vertex_count, listed, edge_count, *springs) &&
           order_by_colour(scratch, mesh->vertex_count, listed + edge_count, count - edge_count,
                           *springs + edge_count);
}

// ---- wind ---------------------------------------------------------------------------------------

enum { WIND_GUSTS = 0x77696e64, WIND_NOISE = 0x6e6f6973 }; // streams of random numbers

pci_wind pci_wind_begin(uint32_t seed, double top_speed) {
    const pci_wind wind = {.seed = seed, .top_speed = top_speed};
    return wind;
}

void pci_wind_next(pci_wind *wind, double velocity[3]) {
    if (wind->step == wind->gust_end) {
        // Uniform on the sphere, 0.2 to 1 of the top speed, for 30 to 90 steps.
        const uint64_t first = 4 * wind->gust++;
        const double z = 2.0 * pci_random(wind->seed, WIND_GUSTS, first) - 1.0;
        const double angle = 6.283185307179586 * pci_random(wind->seed, WIND_GUSTS, first + 1);
        const double strength =
            wind->top_speed * (0.2 + 0.8 * pci_random(wind->seed, WIND_GUSTS, first + 2));
        const double radius = sqrt(1.0 - z * z);
        wind->target[0] = strength * radius * cos(angle);
        wind->target[1] = strength * radius * sin(angle);
        wind->target[2] = strength * z;
        wind->gust_end += 30 + pci_random_bits(wind->seed, WIND_GUSTS, first + 3) % 61;
    }
    // Low-pass, then 10 % noise.
    const double noise = 2.0 * pci_random(wind->seed, WIND_NOISE, wind->step) - 1.0;
    for (size_t k = 0; k < 3; ++k) {
        wind->smooth[k] += 0.15 * (wind->target[k] - wind->smooth[k]);
        velocity[k] = wind->smooth[k] * (1.0 + 0.1 * noise);
    }
    ++wind->step;
}

// ---- the stage ----------------------------------------------------------------------------------

typedef struct height {
    double value;
    uint32_t vertex;
} height;

static int compare_heights(const void *a, const void *b) {
    const height *x = a, *y = b;
    if (x->value != y->value) {
        return x->value > y->value ? -1 : 1;
    }
    return x->vertex < y->vertex ? -1 : x->vertex > y->vertex;
}

// 1e-9: the product may lie just above a whole number.
static size_t pin_count(double fraction, size_t vertex_count) {
    const double wanted = ceil(fraction * (double)vertex_count - 1e-9);
    return wanted > 0.0 ? (size_t)wanted : 0;
}

// Holds the highest ceil(fraction * #V) vertices, and likewise in every connected part that would
// otherwise fall for ever.
static bool pin_highest(pci_scratch *scratch, const pc_mesh *mesh, double fraction, size_t axis,
                        uint8_t *pinned, uint64_t *pinned_count) {
    const size_t nv = mesh->vertex_count;
    height *heights = PCI_SCRATCH(scratch, height, nv);
    uint32_t *parts = PCI_SCRATCH(scratch, uint32_t, nv);
    size_t *sizes = PCI_SCRATCH(scratch, size_t, nv);   // of the part that starts at v
    size_t *missing = PCI_SCRATCH(scratch, size_t, nv); // vertices of it that must still be held
    if (scratch->failed) {
        return false;
    }
    for (size_t v = 0; v < nv; ++v) {
        heights[v].value = mesh->positions[3 * v + axis];
        heights[v].vertex = (uint32_t)v;
    }
    qsort(heights, nv, sizeof(*heights), compare_heights);
    (void)pci_vertex_components(mesh, parts);
    for (size_t v = 0; v < nv; ++v) {
        ++sizes[pci_find_root(parts, (uint32_t)v)];
    }
    for (size_t v = 0; v < nv; ++v) {
        missing[v] = pin_count(fraction, sizes[v]);
    }
    const size_t highest = pin_count(fraction, nv);
    *pinned_count = highest;
    for (size_t i = 0; i < highest; ++i) {
        pinned[heights[i].vertex] = 1;
        missing[pci_find_root(parts, heights[i].vertex)] = 0;
    }
    for (size_t i = highest; i < nv; ++i) {
        size_t *left = &missing[pci_find_root(parts, heights[i].vertex)];
        if (*left > 0) {
            --*left;
            pinned[heights[i].vertex] = 1;
            ++*pinned_count;
        }
    }
    return true;
}

// A third of each triangle's mass per corner; held and unused vertices get inverse mass 0.
static bool fill_inverse_masses(pci_scratch *scratch, const pc_mesh *mesh, const uint8_t *pinned,
                                double area_density, const double **result) {
    double *inverse_mass = PCI_SCRATCH(scratch, double, mesh->vertex_count);
    if (inverse_mass == NULL) {
        return false;
    }
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        const double mass = area_density * pci_triangle_area(mesh, t) / 3.0;
        for (size_t c = 0; c < 3; ++c) {
            inverse_mass[mesh->triangles[3 * t + c]] += mass;
        }
    }
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        inverse_mass[v] = pinned[v] || !(inverse_mass[v] > 0.0) ? 0.0 : 1.0 / inverse_mass[v];
    }
    *result = inverse_mass;
    return true;
}

static int compare_doubles(const void *a, const void *b) {
    const double x = *(const double *)a, y = *(const double *)b;
    return x < y ? -1 : x > y;
}

// Strain of the edges over all frames, and the largest displacement.
static bool measure_motion(pci_scratch *scratch, const pc_mesh *rest, const pc_motion *motion,
                           const pci_spring *springs, size_t edge_count, double diagonal,
                           pc_simulate_report *report) {
    const size_t nv = motion->vertex_count, count = edge_count * motion->frame_count;
    double *strains = PCI_SCRATCH(scratch, double, count);
    if (strains == NULL) {
        return false;
    }
    size_t written = 0;
    double sum = 0.0, range = 0.0;
    for (size_t f = 0; f < motion->frame_count; ++f) {
        const double *frame = &motion->positions[3 * nv * f];
        for (size_t e = 0; e < edge_count; ++e) {
            const size_t a = 3 * (size_t)springs[e].a, b = 3 * (size_t)springs[e].b;
            const double before = pci_squared_distance(&rest->positions[a], &rest->positions[b]);
            if (before > 0.0) {
                const double after = pci_squared_distance(&frame[a], &frame[b]);
                strains[written] = fabs(sqrt(after / before) - 1.0);
                sum += strains[written++];
            }
        }
        for (size_t v = 0; v < nv; ++v) {
            const double moved = pci_squared_distance(&frame[3 * v], &rest->positions[3 * v]);
            range = moved > range ? moved : range;
        }
    }
    report->motion_range = sqrt(range) / diagonal;
    if (written > 0) {
        qsort(strains, written, sizeof(*strains), compare_doubles);
        report->mean_strain = sum / (double)written;
        report->p95_strain = strains[(size_t)(0.95 * (double)(written - 1))];
        report->max_strain = strains[written - 1];
    }
    return true;
}

// Steps the cloth through all frames and writes them, scaled back to the unit of the file.
static pc_status run_frames(pc_context *context, const pc_simulate_options *options,
                            pci_cloth *cloth, double scale, const pc_mesh *proxy, pc_motion *motion,
                            double *max_speed) {
    const size_t nv = cloth->vertex_count;
    pci_wind wind = pci_wind_begin(options->seed, options->wind_speed);
    double squared_speed = 0.0;
    for (size_t f = 0; f < motion->frame_count; ++f) {
        if (!pci_progress(context, stage, (double)f / (double)motion->frame_count)) {
            return pci_fail_cancelled(context, stage);
        }
        for (uint32_t s = 0; s < options->frame_steps; ++s) {
            double velocity[3];
            pci_wind_next(&wind, velocity);
            pci_cloth_step(cloth, velocity);
            for (size_t v = 0; v < nv; ++v) {
                const double *at = &cloth->velocities[3 * v];
                const double speed = pci_dot(at, at);
                squared_speed = speed > squared_speed ? speed : squared_speed;
            }
        }
        for (size_t k = 0; k < 3 * nv; ++k) {
            const double value =
                motion->pinned[k / 3] ? proxy->positions[k] : cloth->positions[k] / scale;
            if (!isfinite(value)) {
                return pci_fail(context, PC_ERROR_NUMERICAL, stage,
                                "simulate: vertex %zu left the finite numbers at frame %zu", k / 3,
                                f);
            }
            motion->positions[3 * nv * f + k] = value;
        }
    }
    *max_speed = sqrt(squared_speed);
    return PC_OK;
}

// Fills the cloth from the proxy at the simulated size.
static bool set_up(pci_scratch *scratch, const pc_mesh *proxy, double scale,
                   const pc_simulate_options *options, pc_motion *motion, pci_cloth *cloth,
                   pc_mesh *rest, size_t *edge_count, pc_simulate_report *report) {
    const size_t nv = proxy->vertex_count;
    *rest = *proxy;
    rest->positions = PCI_SCRATCH(scratch, double, 3 * nv);
    cloth->positions = PCI_SCRATCH(scratch, double, 3 * nv);
    cloth->velocities = PCI_SCRATCH(scratch, double, 3 * nv);
    cloth->previous = PCI_SCRATCH(scratch, double, 3 * nv);
    cloth->forces = PCI_SCRATCH(scratch, double, 3 * nv);
    if (scratch->failed) {
        return false;
    }
    for (size_t k = 0; k < 3 * nv; ++k) {
        rest->positions[k] = cloth->positions[k] = scale * proxy->positions[k];
    }
    cloth->vertex_count = nv;
    cloth->triangle_count = proxy->triangle_count;
    cloth->triangles = proxy->triangles;
    cloth->time_step = options->time_step;
    cloth->damping = options->damping;
    cloth->air_density = options->air_density;
    cloth->gravity[options->up_axis] = -options->gravity;
    cloth->iterations = options->solver_iterations;
    pci_spring *springs = NULL;
    const double stretch =
        pci_sweep_stiffness(options->stretch_stiffness, options->solver_iterations);
    const double bend = pci_sweep_stiffness(options->bend_stiffness, options->solver_iterations);
    if (!pin_highest(scratch, rest, options->pinned_fraction, options->up_axis, motion->pinned,
                     &report->pinned) ||
        !fill_inverse_masses(scratch, rest, motion->pinned, options->area_density,
                             &cloth->inverse_mass) ||
        !pci_springs_build(scratch, rest, stretch, bend, &springs, &cloth->spring_count,
                           edge_count)) {
        return false;
    }
    cloth->springs = springs;
    report->stretch_springs = *edge_count;
    report->bend_springs = cloth->spring_count - *edge_count;
    return true;
}

pc_status pc_simulate(pc_context *context, const pc_mesh *proxy, const pc_simulate_options *options,
                      pc_motion *motion, pc_simulate_report *report) {
    if (motion == NULL || motion->positions != NULL || motion->pinned != NULL) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "simulate: the output is not empty");
    }
    pc_simulate_options chosen;
    pc_status status = pci_check_mesh(context, stage, proxy, "proxy mesh");
    if (status == PC_OK) {
        status = pci_begin_stage(context, stage, &pc_simulate_options_record, options, &chosen);
    }
    if (status != PC_OK) {
        return status;
    }
    options = &chosen;
    const double diagonal = pci_diagonal(proxy);
    const double scale = chosen.garment_size > 0.0 ? chosen.garment_size / diagonal : 1.0;
    if (!(diagonal > 0.0) || !isfinite(scale)) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "simulate: the proxy mesh has diagonal %g", diagonal);
    }

    pci_scratch scratch = pci_scratch_begin(context);
    pc_simulate_report measured = {0};
    pci_cloth cloth = {0};
    pc_mesh rest = {0};
    size_t edge_count = 0;
    motion->vertex_count = proxy->vertex_count;
    motion->frame_count = options->frames;
    motion->frame_time = options->time_step * (double)options->frame_steps;
    motion->positions = PCI_ALLOCATE(context, double, 3 * proxy->vertex_count * options->frames);
    motion->pinned = PCI_ALLOCATE(context, uint8_t, proxy->vertex_count);
    if (motion->positions == NULL || motion->pinned == NULL ||
        !set_up(&scratch, proxy, scale, options, motion, &cloth, &rest, &edge_count, &measured)) {
        status = pci_fail_memory(context, stage);
        goto cleanup;
    }
    status = run_frames(context, options, &cloth, scale, proxy, motion, &measured.max_speed);
    if (status == PC_OK &&
        !measure_motion(&scratch, proxy, motion, cloth.springs, edge_count, diagonal, &measured)) {
        status = pci_fail_memory(context, stage);
    }

cleanup:
    pci_scratch_end(&scratch);
    if (status != PC_OK) {
        pc_motion_free(context, motion);
    } else if (report != NULL) {
        *report = measured;
    }
    return status;
}
