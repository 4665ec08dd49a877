// Based on: Mueller, Heidelberger, Hennix, Ratcliff, "Position based dynamics", 2007.
#include "geometry/topology.h"
#include "stages/simulate/simulate_internal.h"

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
                     "Coulomb's coefficient between cloth and colliders or cloth"),
    PCI_FIELD_OPTION(pc_simulate_options, self_contact, DOUBLE, 0.0, 0.0, 1.0, "edges",
                     "Distance that the cloth keeps from itself, in mean edge lengths, 0 for none"),
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

// ---- measures and masses -----------------------------------------------------------------------

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

// ---- what a run holds --------------------------------------------------------------------------

struct pc_simulator {
    pc_context *context;
    pci_scratch scratch; // holds whatever the pointers below point to
    pc_simulate_inputs inputs;
    pc_simulate_options options;
    double scale; // simulated length per length of the file
    double diagonal;
    pc_mesh rest; // the proxy at the simulated size
    pci_cloth cloth;
    const pci_spring *springs;
    size_t edge_count;
    uint8_t *pinned;
    double *targets;   // #V by 3; in use where cloth.targets is set
    double *positions; // #V by 3, in the unit of the file
    pci_poses poses;
    pci_binding binding;
    pci_wind wind;
    uint64_t steps;
    double squared_speed;
    pc_simulate_report report;
};

// Fills the cloth from the proxy at the simulated size.
static bool fill_cloth(pc_simulator *s) {
    pci_scratch *scratch = &s->scratch;
    const pc_mesh *proxy = s->inputs.proxy;
    const pc_simulate_options *options = &s->options;
    const size_t nv = proxy->vertex_count;
    pci_cloth *cloth = &s->cloth;
    s->rest = *proxy;
    s->rest.positions = PCI_SCRATCH(scratch, double, 3 * nv);
    s->targets = PCI_SCRATCH(scratch, double, 3 * nv);
    s->positions = PCI_SCRATCH(scratch, double, 3 * nv);
    cloth->positions = PCI_SCRATCH(scratch, double, 3 * nv);
    cloth->velocities = PCI_SCRATCH(scratch, double, 3 * nv);
    cloth->previous = PCI_SCRATCH(scratch, double, 3 * nv);
    cloth->forces = PCI_SCRATCH(scratch, double, 3 * nv);
    cloth->saved = options->substeps == 0 ? PCI_SCRATCH(scratch, double, 6 * nv) : NULL;
    if (scratch->failed) {
        return false;
    }
    for (size_t k = 0; k < 3 * nv; ++k) {
        s->rest.positions[k] = s->targets[k] = cloth->positions[k] = s->scale * proxy->positions[k];
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
    double wind = s->inputs.scenario->wind_count != 0 ? 0.0 : options->wind_speed;
    for (size_t i = 0; i < s->inputs.scenario->wind_count; ++i) {
        wind = fmax(wind, pci_norm(s->inputs.scenario->winds[i].velocity));
    }
    cloth->free_speed = sqrt(2.0 * fabs(options->gravity) * pci_diagonal(&s->rest)) + wind + 1.0;
    cloth->dynamics = (pci_dynamics)options->dynamics;
    // XPBD needs substeps in the place of sweeps.
    const uint32_t usual = cloth->dynamics == PCI_DYNAMICS_XPBD ? options->solver_iterations : 1;
    cloth->least_substeps = usual < PCI_MOST_SUBSTEPS ? usual : PCI_MOST_SUBSTEPS;
    cloth->substeps = options->substeps != 0 ? options->substeps : cloth->least_substeps;
    pci_spring *springs = NULL;
    size_t spring_count = 0;
    if (!fill_inverse_masses(scratch, &s->rest, s->pinned, options->area_density,
                             &cloth->inverse_mass) ||
        !pci_springs_build(scratch, &s->rest, options->stretch_stiffness, options->bend_stiffness,
                           &springs, &spring_count, &s->edge_count) ||
        !pci_springs_pack(scratch, springs, spring_count, s->edge_count, cloth)) {
        return false;
    }
    s->springs = springs;
    s->report.stretch_springs = s->edge_count;
    s->report.bend_springs = spring_count - s->edge_count;
    return options->self_contact == 0.0 ||
           pci_self_contact_create(scratch, &s->rest, options->self_contact, options->friction,
                                   &cloth->self);
}

static pc_status set_up(pc_simulator *s) {
    pci_scratch *scratch = &s->scratch;
    const pc_simulate_options *options = &s->options;
    const size_t nv = s->inputs.proxy->vertex_count;
    const pc_attachment *attachment = &s->inputs.scenario->attachment;
    s->pinned = PCI_SCRATCH(scratch, uint8_t, nv);
    if (s->pinned == NULL) {
        return pci_fail_memory(s->context, stage);
    }
    pc_status status = pci_pin_vertices(scratch, &s->inputs, options->pinned_fraction,
                                        options->up_axis, s->pinned, &s->report.unmatched_pins);
    if (status != PC_OK) {
        return status;
    }
    for (size_t v = 0; v < nv; ++v) {
        s->report.pinned += s->pinned[v];
    }
    if (!fill_cloth(s)) {
        return pci_fail_memory(s->context, stage);
    }
    status = pci_poses_begin(scratch, stage, s->inputs.character, &s->inputs.scenario->attachment,
                             s->scale, &s->poses);
    if (status == PC_OK && attachment->kind == PC_ATTACHMENT_CLIP) {
        status = pci_bind_pins(scratch, &s->inputs, s->pinned, &s->binding);
    }
    if (status == PC_OK && attachment->kind != PC_ATTACHMENT_NONE) {
        s->cloth.targets = s->targets;
    }
    if (status == PC_OK) {
        status = pci_contacts_create(scratch, &s->inputs, s->scale, options->contact_distance,
                                     options->friction, &s->cloth.contacts);
    }
    return status;
}

// ---- steps -------------------------------------------------------------------------------------

// Where the attachment wants pinned vertices and colliders at a time.
static void aim(pc_simulator *s, double time) {
    const pc_attachment *attachment = &s->inputs.scenario->attachment;
    const size_t nv = s->cloth.vertex_count;
    if (attachment->kind == PC_ATTACHMENT_RIGID) {
        pci_map map;
        pci_rigid_at(attachment, s->scale, time, &map);
        for (size_t v = 0; v < nv; ++v) {
            if (s->pinned[v]) {
                pci_map_apply(&map, &s->rest.positions[3 * v], &s->targets[3 * v]);
            }
        }
    } else if (attachment->kind == PC_ATTACHMENT_CLIP) {
        pci_poses_set(&s->poses, time);
        for (size_t v = 0; v < nv; ++v) {
            if (s->pinned[v]) {
                pci_binding_apply(&s->binding, s->poses.maps, v, &s->rest.positions[3 * v],
                                  &s->targets[3 * v]);
            }
        }
    }
    if (s->cloth.contacts != NULL) {
        pci_contacts_aim(s->cloth.contacts, s->poses.maps);
    }
}

// One step to where `aim` and the caller want pinned vertices and colliders.
static void step(pc_simulator *s, const double wind[3]) {
    pci_cloth_step(&s->cloth, wind);
    if (s->cloth.substeps > s->report.most_substeps) {
        s->report.most_substeps = s->cloth.substeps;
    }
}

// What happens before time 0: a rigid motion starts anywhere, a clip is approached in still air.
static pc_status lead_in(pc_simulator *s) {
    static const double calm[3] = {0.0, 0.0, 0.0};
    const pc_attachment *attachment = &s->inputs.scenario->attachment;
    const double dt = s->options.time_step;
    if (attachment->kind == PC_ATTACHMENT_RIGID) {
        pci_map map;
        pci_rigid_at(attachment, s->scale, 0.0, &map);
        for (size_t v = 0; v < s->cloth.vertex_count; ++v) {
            pci_map_apply(&map, &s->rest.positions[3 * v], &s->cloth.positions[3 * v]);
        }
    } else if (attachment->kind == PC_ATTACHMENT_CLIP) {
        const size_t steps = (size_t)ceil(attachment->blend / dt);
        for (size_t i = 1; i <= steps; ++i) {
            if (!pci_keep_going(s->context)) {
                return pci_fail_cancelled(s->context, stage);
            }
            aim(s, -dt * (double)(steps - i));
            step(s, calm);
        }
    }
    return PC_OK;
}

// Brings the cloth back into the unit of the file.
static pc_status read_positions(pc_simulator *s) {
    const pc_mesh *proxy = s->inputs.proxy;
    for (size_t k = 0; k < 3 * s->cloth.vertex_count; ++k) {
        const bool still = s->pinned[k / 3] && s->cloth.targets == NULL;
        s->positions[k] = still ? proxy->positions[k] : s->cloth.positions[k] / s->scale;
        if (!isfinite(s->positions[k])) {
            return pci_fail(s->context, PC_ERROR_NUMERICAL, stage,
                            "simulate: vertex %zu left the finite numbers at frame %zu", k / 3,
                            (size_t)((s->steps > 0 ? s->steps - 1 : 0) / s->options.frame_steps));
        }
    }
    return PC_OK;
}

pc_status pc_simulator_step(pc_simulator *s, const double *wind, const double *targets) {
    if (s == NULL) {
        return PC_ERROR_INVALID_ARGUMENT;
    }
    const size_t nv = s->cloth.vertex_count;
    const double start = s->options.time_step * (double)s->steps;
    double blown[3];
    // The winds of the scenario go on behind those of the caller.
    if (s->inputs.scenario->wind_count != 0) {
        pci_wind_at(s->inputs.scenario->winds, s->inputs.scenario->wind_count, start, blown);
    } else {
        pci_wind_next(&s->wind, blown);
    }
    aim(s, s->options.time_step * (double)++s->steps);
    if (targets != NULL) {
        for (size_t k = 0; k < 3 * nv; ++k) {
            s->targets[k] = s->pinned[k / 3] ? s->scale * targets[k] : s->targets[k];
        }
        s->cloth.targets = s->targets;
    }
    step(s, wind != NULL ? wind : blown);
    for (size_t v = 0; v < nv; ++v) {
        const double *at = &s->cloth.velocities[3 * v];
        s->squared_speed = fmax(s->squared_speed, pci_dot(at, at));
    }
    return read_positions(s);
}

// ---- the simulator -----------------------------------------------------------------------------

// Options and inputs, and the factor to the simulated size.
static pc_status begin(pc_simulator *s, const pc_simulate_options *given) {
    static const pc_scenario paper;
    pc_context *context = s->context;
    pc_status status = pci_check_mesh(context, stage, s->inputs.proxy, "proxy mesh");
    if (status == PC_OK) {
        status = pci_begin_stage(context, stage, &pc_simulate_options_record, given, &s->options);
    }
    if (status == PC_OK && s->inputs.scenario != NULL) {
        status = pc_scenario_check(context, s->inputs.scenario);
    } else {
        s->inputs.scenario = &paper;
    }
    if (status != PC_OK) {
        return status;
    }
    s->diagonal = pci_diagonal(s->inputs.proxy);
    s->scale = s->options.garment_size > 0.0 ? s->options.garment_size / s->diagonal : 1.0;
    if (!(s->diagonal > 0.0) || !isfinite(s->scale)) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "simulate: the proxy mesh has diagonal %g", s->diagonal);
    }
    s->wind = pci_wind_begin(s->options.seed, s->options.wind_speed);
    return PC_OK;
}

pc_status pc_simulator_create(pc_context *context, const pc_simulate_inputs *inputs,
                              const pc_simulate_options *options, pc_simulator **simulator) {
    if (inputs == NULL || simulator == NULL) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage, "simulate: an argument is NULL");
    }
    *simulator = NULL;
    pc_simulator *created = PCI_ALLOCATE(context, pc_simulator, 1);
    if (created == NULL) {
        return pci_fail_memory(context, stage);
    }
    created->context = context;
    created->scratch = pci_scratch_begin(context);
    created->inputs = *inputs;
    pc_status status = begin(created, options);
    if (status == PC_OK) {
        status = set_up(created);
    }
    if (status == PC_OK) {
        status = lead_in(created);
    }
    if (status == PC_OK) {
        status = read_positions(created);
    }
    if (status != PC_OK) {
        pc_simulator_destroy(created);
        return status;
    }
    *simulator = created;
    return PC_OK;
}

void pc_simulator_destroy(pc_simulator *simulator) {
    if (simulator != NULL) {
        pci_scratch_end(&simulator->scratch);
        pc_release(simulator->context, simulator);
    }
}

const double *pc_simulator_positions(const pc_simulator *simulator) { return simulator->positions; }

const uint8_t *pc_simulator_pinned(const pc_simulator *simulator) { return simulator->pinned; }

// ---- the stage ---------------------------------------------------------------------------------

pc_status pc_simulate(pc_context *context, const pc_mesh *proxy, const pc_simulate_options *options,
                      pc_motion *motion, pc_simulate_report *report) {
    const pc_simulate_inputs inputs = {.proxy = proxy};
    return pc_simulate_scenario(context, &inputs, options, motion, report);
}

// How deep free vertices are in colliders.
static void measure_contact(pc_simulator *s) {
    for (size_t v = 0; v < s->cloth.vertex_count && s->cloth.contacts != NULL; ++v) {
        if (s->cloth.inverse_mass[v] > 0.0) {
            s->report.deepest_contact =
                fmax(s->report.deepest_contact,
                     pci_contacts_depth(s->cloth.contacts, &s->cloth.positions[3 * v]));
        }
    }
}

static pc_status run_frames(pc_simulator *s, pc_motion *motion) {
    const size_t size = 3 * motion->vertex_count;
    for (size_t f = 0; f < motion->frame_count; ++f) {
        if (!pci_progress(s->context, stage, (double)f / (double)motion->frame_count)) {
            return pci_fail_cancelled(s->context, stage);
        }
        for (uint32_t i = 0; i < s->options.frame_steps; ++i) {
            const pc_status status = pc_simulator_step(s, NULL, NULL);
            if (status != PC_OK) {
                return status;
            }
        }
        memcpy(&motion->positions[size * f], s->positions, size * sizeof(double));
        measure_contact(s);
    }
    s->report.max_speed = sqrt(s->squared_speed);
    return PC_OK;
}

pc_status pc_simulate_scenario(pc_context *context, const pc_simulate_inputs *inputs,
                               const pc_simulate_options *options, pc_motion *motion,
                               pc_simulate_report *report) {
    if (inputs == NULL || motion == NULL || motion->positions != NULL || motion->pinned != NULL) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, stage,
                        "simulate: no inputs, or the output is not empty");
    }
    pc_simulator *s = NULL;
    pc_status status = pc_simulator_create(context, inputs, options, &s);
    if (status != PC_OK) {
        return status;
    }
    const size_t nv = inputs->proxy->vertex_count, frames = s->options.frames;
    motion->vertex_count = nv;
    motion->frame_count = frames;
    motion->frame_time = s->options.time_step * (double)s->options.frame_steps;
    motion->positions = PCI_ALLOCATE(context, double, 3 * nv * frames);
    motion->pinned = PCI_ALLOCATE(context, uint8_t, nv);
    if (motion->positions == NULL || motion->pinned == NULL) {
        status = pci_fail_memory(context, stage);
    } else {
        memcpy(motion->pinned, s->pinned, nv);
        status = run_frames(s, motion);
    }
    if (status == PC_OK && !measure_motion(&s->scratch, inputs->proxy, motion, s->springs,
                                           s->edge_count, s->diagonal, &s->report)) {
        status = pci_fail_memory(context, stage);
    }
    if (status != PC_OK) {
        pc_motion_free(context, motion);
    } else if (report != NULL) {
        *report = s->report;
    }
    pc_simulator_destroy(s);
    return status;
}
