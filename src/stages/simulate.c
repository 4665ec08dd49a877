// Based on: Mueller, Heidelberger, Hennix, Ratcliff, "Position based dynamics", 2007.
#include "core/topology.h"
#include "stages/simulate_internal.h"

static const char stage[] = "simulate";

static const char *const up_axis_choices[] = {"x", "y", "z", NULL};
static const char *const dynamics_choices[] = {"pbd", "xpbd", NULL};
static const pc_field option_fields[] = {
    PCI_FIELD_OPTION(pc_simulate_options, frames, UINT, 200, 1, 100000, "frames",
                     "Frames that are kept"),
    PCI_FIELD_OPTION(pc_simulate_options, frame_steps, UINT, 3, 1, 1000, "steps",
                     "Steps per kept frame"),
    PCI_FIELD_OPTION(pc_simulate_options, time_step, DOUBLE, 1.0 / 60.0, 0.0001, 0.1, "s",
                     "Length of a step"),
    PCI_FIELD_CHOICE(pc_simulate_options, dynamics, 0, 1, dynamics_choices,
                     "Sweeps of a step (pbd), or one sweep per substep (xpbd)"),
    PCI_FIELD_OPTION(pc_simulate_options, solver_iterations, UINT, 10, 1, 1000, "sweeps",
                     "Sweeps over the springs per step or substep of pbd"),
    PCI_FIELD_OPTION(pc_simulate_options, substeps, UINT, 0, 0, PCI_MOST_SUBSTEPS, "",
                     "Parts of a step, 0 for as many as the strain needs"),
    PCI_FIELD_OPTION(pc_simulate_options, strain_limit, DOUBLE, 0.1, 0.001, 10.0, "",
                     "Relative stretch beyond which an edge is pulled back"),
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
    PCI_FIELD_OPTION(pc_simulate_options, contact_distance, DOUBLE, 0.005, 0.0001, 1.0, "m",
                     "Distance that the cloth keeps from colliders"),
    PCI_FIELD_OPTION(pc_simulate_options, friction, DOUBLE, 0.3, 0.0, 10.0, "",
                     "Coulomb's coefficient between cloth and colliders"),
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
    PCI_FIELD_REPORT(pc_simulate_report, most_substeps, COUNT, "", "Substeps of a step, at most"),
    PCI_FIELD_WARNING(pc_simulate_report, unmatched_pins, COUNT, "Pin rules without a vertex",
                      "pin rules name no vertex of the proxy"),
    PCI_FIELD_REPORT(pc_simulate_report, deepest_contact, DOUBLE, "m",
                     "Depth of the deepest free vertex in a collider"),
};
const pc_record pc_simulate_report_record = PCI_RECORD(report_fields, pc_simulate_report);

// ---- measures and masses
// --------------------------------------------------------------------------

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

// The value that would be at `rank` in ascending order; moves values around (Hoare's selection).
static double select_rank(double *values, ptrdiff_t count, ptrdiff_t rank) {
    ptrdiff_t low = 0, high = count - 1;
    while (low < high) {
        // The median of three is a good pivot for values in any common order.
        const double a = values[low], b = values[low + (high - low) / 2], c = values[high];
        const double pivot = fmax(fmin(a, b), fmin(fmax(a, b), c));
        ptrdiff_t i = low, j = high;
        while (i <= j) {
            while (values[i] < pivot) {
                ++i;
            }
            while (values[j] > pivot) {
                --j;
            }
            if (i <= j) {
                const double swapped = values[i];
                values[i++] = values[j];
                values[j--] = swapped;
            }
        }
        // Up to j nothing exceeds the pivot, from i on nothing is below it.
        if (rank <= j) {
            high = j;
        } else if (rank >= i) {
            low = i;
        } else {
            break;
        }
    }
    return values[rank];
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
    double sum = 0.0, range = 0.0, largest = 0.0;
    for (size_t f = 0; f < motion->frame_count; ++f) {
        const double *frame = &motion->positions[3 * nv * f];
        for (size_t e = 0; e < edge_count; ++e) {
            const size_t a = 3 * (size_t)springs[e].a, b = 3 * (size_t)springs[e].b;
            const double before = pci_squared_distance(&rest->positions[a], &rest->positions[b]);
            if (before > 0.0) {
                const double after = pci_squared_distance(&frame[a], &frame[b]);
                strains[written] = fabs(sqrt(after / before) - 1.0);
                largest = fmax(largest, strains[written]);
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
        report->mean_strain = sum / (double)written;
        report->p95_strain =
            select_rank(strains, (ptrdiff_t)written, (ptrdiff_t)(0.95 * (double)(written - 1)));
        report->max_strain = largest;
    }
    return true;
}

// ---- what a run holds
// -----------------------------------------------------------------------------

typedef struct run {
    pc_context *context;
    const pc_simulate_inputs *inputs;
    const pc_simulate_options *options;
    double scale; // simulated length per length of the file
    pc_mesh rest; // the proxy at the simulated size
    pci_cloth cloth;
    const pci_spring *springs;
    size_t edge_count;
    double *targets; // #V by 3, or NULL: nothing moves
    pci_poses poses;
    pci_binding binding;
    pci_wind wind;
    pc_motion *motion;
    pc_simulate_report report;
} run;

// Fills the cloth from the proxy at the simulated size.
static bool fill_cloth(run *r, pci_scratch *scratch) {
    const pc_mesh *proxy = r->inputs->proxy;
    const pc_simulate_options *options = r->options;
    const size_t nv = proxy->vertex_count;
    pci_cloth *cloth = &r->cloth;
    r->rest = *proxy;
    r->rest.positions = PCI_SCRATCH(scratch, double, 3 * nv);
    cloth->positions = PCI_SCRATCH(scratch, double, 3 * nv);
    cloth->velocities = PCI_SCRATCH(scratch, double, 3 * nv);
    cloth->previous = PCI_SCRATCH(scratch, double, 3 * nv);
    cloth->forces = PCI_SCRATCH(scratch, double, 3 * nv);
    cloth->saved = options->substeps == 0 ? PCI_SCRATCH(scratch, double, 6 * nv) : NULL;
    if (scratch->failed) {
        return false;
    }
    for (size_t k = 0; k < 3 * nv; ++k) {
        r->rest.positions[k] = cloth->positions[k] = r->scale * proxy->positions[k];
    }
    cloth->vertex_count = nv;
    cloth->triangle_count = proxy->triangle_count;
    cloth->triangles = proxy->triangles;
    cloth->time_step = options->time_step;
    cloth->damping = options->damping;
    cloth->air_density = options->air_density;
    cloth->area_density = options->area_density;
    cloth->gravity[options->up_axis] = -options->gravity;
    cloth->iterations = options->solver_iterations;
    cloth->strain_limit = options->strain_limit;
    // What a fall from the garment's height and the wind give.
    double wind = r->inputs->scenario->wind_count != 0 ? 0.0 : options->wind_speed;
    for (size_t i = 0; i < r->inputs->scenario->wind_count; ++i) {
        wind = fmax(wind, pci_norm(r->inputs->scenario->winds[i].velocity));
    }
    cloth->free_speed = sqrt(2.0 * fabs(options->gravity) * pci_diagonal(&r->rest)) + wind + 1.0;
    cloth->dynamics = (pci_dynamics)options->dynamics;
    // XPBD needs substeps in the place of sweeps.
    const uint32_t usual = cloth->dynamics == PCI_DYNAMICS_XPBD ? options->solver_iterations : 1;
    cloth->least_substeps = usual < PCI_MOST_SUBSTEPS ? usual : PCI_MOST_SUBSTEPS;
    cloth->substeps = options->substeps != 0 ? options->substeps : cloth->least_substeps;
    pci_spring *springs = NULL;
    size_t spring_count = 0;
    if (!fill_inverse_masses(scratch, &r->rest, r->motion->pinned, options->area_density,
                             &cloth->inverse_mass) ||
        !pci_springs_build(scratch, &r->rest, options->stretch_stiffness, options->bend_stiffness,
                           &springs, &spring_count, &r->edge_count) ||
        !pci_springs_pack(scratch, springs, spring_count, r->edge_count, cloth)) {
        return false;
    }
    r->springs = springs;
    r->report.stretch_springs = r->edge_count;
    r->report.bend_springs = spring_count - r->edge_count;
    return true;
}

static pc_status set_up(run *r, pci_scratch *scratch) {
    const pc_simulate_options *options = r->options;
    const size_t nv = r->inputs->proxy->vertex_count;
    const pc_attachment *attachment = &r->inputs->scenario->attachment;
    pc_status status =
        pci_pin_vertices(scratch, r->inputs, options->pinned_fraction, options->up_axis,
                         r->motion->pinned, &r->report.unmatched_pins);
    if (status != PC_OK) {
        return status;
    }
    for (size_t v = 0; v < nv; ++v) {
        r->report.pinned += r->motion->pinned[v];
    }
    if (!fill_cloth(r, scratch)) {
        return pci_fail_memory(r->context, stage);
    }
    status = pci_poses_begin(scratch, stage, r->inputs->character, &r->inputs->scenario->attachment,
                             r->scale, &r->poses);
    if (status == PC_OK && attachment->kind == PC_ATTACHMENT_CLIP) {
        status = pci_bind_pins(scratch, r->inputs, r->motion->pinned, &r->binding);
    }
    if (status == PC_OK && attachment->kind != PC_ATTACHMENT_NONE) {
        r->targets = PCI_SCRATCH(scratch, double, 3 * nv);
        if (r->targets == NULL) {
            return pci_fail_memory(r->context, stage);
        }
        memcpy(r->targets, r->rest.positions, 3 * nv * sizeof(double));
        r->cloth.targets = r->targets;
    }
    if (status == PC_OK) {
        status = pci_contacts_create(scratch, r->inputs, r->scale, options->contact_distance,
                                     options->friction, &r->cloth.contacts);
    }
    return status;
}

// ---- steps
// ----------------------------------------------------------------------------------------

// Where the attachment wants pinned vertices and colliders at a time.
static void aim(run *r, double time) {
    const pc_attachment *attachment = &r->inputs->scenario->attachment;
    const size_t nv = r->cloth.vertex_count;
    if (attachment->kind == PC_ATTACHMENT_RIGID) {
        pci_map map;
        pci_rigid_at(attachment, r->scale, time, &map);
        for (size_t v = 0; v < nv; ++v) {
            if (r->motion->pinned[v]) {
                pci_map_apply(&map, &r->rest.positions[3 * v], &r->targets[3 * v]);
            }
        }
    } else if (attachment->kind == PC_ATTACHMENT_CLIP) {
        pci_poses_set(&r->poses, time);
        for (size_t v = 0; v < nv; ++v) {
            if (r->motion->pinned[v]) {
                pci_binding_apply(&r->binding, r->poses.maps, v, &r->rest.positions[3 * v],
                                  &r->targets[3 * v]);
            }
        }
    }
    if (r->cloth.contacts != NULL) {
        pci_contacts_aim(r->cloth.contacts, r->poses.maps);
    }
}

// One step that ends at `time`.
static void step_to(run *r, double time, const double wind[3]) {
    aim(r, time);
    pci_cloth_step(&r->cloth, wind);
    if (r->cloth.substeps > r->report.most_substeps) {
        r->report.most_substeps = r->cloth.substeps;
    }
}

// What happens before time 0: a rigid motion starts anywhere, a clip is approached in still air.
static pc_status lead_in(run *r) {
    static const double calm[3] = {0.0, 0.0, 0.0};
    const pc_attachment *attachment = &r->inputs->scenario->attachment;
    const double dt = r->options->time_step;
    if (attachment->kind == PC_ATTACHMENT_RIGID) {
        pci_map map;
        pci_rigid_at(attachment, r->scale, 0.0, &map);
        for (size_t v = 0; v < r->cloth.vertex_count; ++v) {
            pci_map_apply(&map, &r->rest.positions[3 * v], &r->cloth.positions[3 * v]);
        }
    } else if (attachment->kind == PC_ATTACHMENT_CLIP) {
        const size_t steps = (size_t)ceil(attachment->blend / dt);
        for (size_t s = 1; s <= steps; ++s) {
            if (!pci_keep_going(r->context)) {
                return pci_fail_cancelled(r->context, stage);
            }
            step_to(r, -dt * (double)(steps - s), calm);
        }
    }
    return PC_OK;
}

// Copies the cloth to a frame, in the unit of the file.
static pc_status keep_frame(run *r, size_t frame) {
    const pc_mesh *proxy = r->inputs->proxy;
    const size_t nv = r->cloth.vertex_count;
    for (size_t k = 0; k < 3 * nv; ++k) {
        const bool still = r->motion->pinned[k / 3] && r->targets == NULL;
        const double value = still ? proxy->positions[k] : r->cloth.positions[k] / r->scale;
        if (!isfinite(value)) {
            return pci_fail(r->context, PC_ERROR_NUMERICAL, stage,
                            "simulate: vertex %zu left the finite numbers at frame %zu", k / 3,
                            frame);
        }
        r->motion->positions[3 * nv * frame + k] = value;
    }
    for (size_t v = 0; v < nv && r->cloth.contacts != NULL; ++v) {
        if (r->cloth.inverse_mass[v] > 0.0) {
            r->report.deepest_contact =
                fmax(r->report.deepest_contact,
                     pci_contacts_depth(r->cloth.contacts, &r->cloth.positions[3 * v]));
        }
    }
    return PC_OK;
}

static pc_status run_frames(run *r) {
    const pc_simulate_options *options = r->options;
    const pc_scenario *scenario = r->inputs->scenario;
    const size_t nv = r->cloth.vertex_count, frames = r->motion->frame_count;
    double squared_speed = 0.0;
    uint64_t step = 0;
    pc_status status = lead_in(r);
    for (size_t f = 0; f < frames && status == PC_OK; ++f) {
        if (!pci_progress(r->context, stage, (double)f / (double)frames)) {
            return pci_fail_cancelled(r->context, stage);
        }
        for (uint32_t s = 0; s < options->frame_steps; ++s) {
            double wind[3];
            if (scenario->wind_count != 0) {
                pci_wind_at(scenario->winds, scenario->wind_count,
                            options->time_step * (double)step, wind);
            } else {
                pci_wind_next(&r->wind, wind);
            }
            step_to(r, options->time_step * (double)++step, wind);
            for (size_t v = 0; v < nv; ++v) {
                const double *at = &r->cloth.velocities[3 * v];
                const double speed = pci_dot(at, at);
                squared_speed = speed > squared_speed ? speed : squared_speed;
            }
        }
        status = keep_frame(r, f);
    }
    r->report.max_speed = sqrt(squared_speed);
    return status;
}

// ---- the stage
// ------------------------------------------------------------------------------------

pc_status pc_simulate(pc_context *context, const pc_mesh *proxy, const pc_simulate_options *options,
                      pc_motion *motion, pc_simulate_report *report) {
    const pc_simulate_inputs inputs = {.proxy = proxy};
    return pc_simulate_scenario(context, &inputs, options, motion, report);
}

// Options and inputs, and the factor to the simulated size.
static pc_status begin(pc_context *context, pc_simulate_inputs *inputs,
                       const pc_simulate_options *given, pc_simulate_options *options,
                       double *scale, double *diagonal) {
    static const pc_scenario paper;
    pc_status status = pci_check_mesh(context, stage, inputs->proxy, "proxy mesh");
    if (status == PC_OK) {
        status = pci_begin_stage(context, stage, &pc_simulate_options_record, given, options);
    }
    if (status == PC_OK && inputs->scenario != NULL) {
        status = pc_scenario_check(context, inputs->scenario);
    } else {
        inputs->scenario = &paper;
    }
    if (status != PC_OK) {
        return status;
    }
    *diagonal = pci_diagonal(inputs->proxy);
    *scale = options->garment_size > 0.0 ? options->garment_size / *diagonal : 1.0;
    if (!(*diagonal > 0.0) || !isfinite(*scale)) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "simulate: the proxy mesh has diagonal %g", *diagonal);
    }
    return PC_OK;
}

pc_status pc_simulate_scenario(pc_context *context, const pc_simulate_inputs *given_inputs,
                               const pc_simulate_options *given, pc_motion *motion,
                               pc_simulate_report *report) {
    if (given_inputs == NULL || motion == NULL || motion->positions != NULL ||
        motion->pinned != NULL) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "simulate: no inputs, or the output is not empty");
    }
    pc_simulate_options options;
    pc_simulate_inputs inputs = *given_inputs;
    double diagonal = 0.0;
    run r = {.context = context, .inputs = &inputs, .options = &options, .motion = motion};
    pc_status status = begin(context, &inputs, given, &options, &r.scale, &diagonal);
    if (status != PC_OK) {
        return status;
    }
    pci_scratch scratch = pci_scratch_begin(context);
    const size_t nv = inputs.proxy->vertex_count;
    r.wind = pci_wind_begin(options.seed, options.wind_speed);
    motion->vertex_count = nv;
    motion->frame_count = options.frames;
    motion->frame_time = options.time_step * (double)options.frame_steps;
    motion->positions = PCI_ALLOCATE(context, double, 3 * nv * options.frames);
    motion->pinned = PCI_ALLOCATE(context, uint8_t, nv);
    status = motion->positions != NULL && motion->pinned != NULL ? set_up(&r, &scratch)
                                                                 : pci_fail_memory(context, stage);
    if (status == PC_OK) {
        status = run_frames(&r);
    }
    if (status == PC_OK && !measure_motion(&scratch, inputs.proxy, motion, r.springs, r.edge_count,
                                           diagonal, &r.report)) {
        status = pci_fail_memory(context, stage);
    }
    pci_scratch_end(&scratch);
    if (status != PC_OK) {
        pc_motion_free(context, motion);
    } else if (report != NULL) {
        *report = r.report;
    }
    return status;
}
