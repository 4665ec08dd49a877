// Springs, and the time steps of position based dynamics.
// Based on: Mueller, Heidelberger, Hennix, Ratcliff, "Position based dynamics", 2007; Macklin,
// Storey, Lu, Terdiman, Chentanez, Jeschke, Mueller, "Small steps in physics simulation", 2019.
#include "geometry/topology.h"
#include "stages/simulate/simulate_internal.h"

// ---- forces -------------------------------------------------------------------------------------

// Wind pushes each triangle along its normal, in proportion to the relative speed. The force is
// limited to what stops the triangle relative to the wind within `dt`: more would swing back ever
// farther.
static void accumulate_wind(pci_cloth *cloth, const double wind[3], double dt) {
    double *x = cloth->positions, *v = cloth->velocities, *forces = cloth->forces;
    const double density =
        cloth->area_density > 0.0 && dt * cloth->air_density > cloth->area_density
            ? cloth->area_density / dt
            : cloth->air_density;
    memset(forces, 0, 3 * cloth->vertex_count * sizeof(*forces));
    for (size_t t = 0; t < cloth->triangle_count; ++t) {
        const size_t a = 3 * (size_t)cloth->triangles[3 * t];
        const size_t b = 3 * (size_t)cloth->triangles[3 * t + 1];
        const size_t c = 3 * (size_t)cloth->triangles[3 * t + 2];
        double ab[3], ac[3], normal[3], relative[3];
        pci_sub(&x[b], &x[a], ab);
        pci_sub(&x[c], &x[a], ac);
        pci_cross(ab, ac, normal);
        const double squared = pci_dot(normal, normal); // (2 A)^2
        if (!(squared > 0.0)) {
            continue;
        }
        for (size_t k = 0; k < 3; ++k) {
            relative[k] = wind[k] - (v[a + k] + v[b + k] + v[c + k]) / 3.0;
        }
        // density * A * (relative . n) n / 3, with n = normal / (2 A).
        const double share = density * pci_dot(relative, normal) / (6.0 * sqrt(squared));
        for (size_t k = 0; k < 3; ++k) {
            const double force = share * normal[k];
            forces[a + k] += force;
            forces[b + k] += force;
            forces[c + k] += force;
        }
    }
}

// ---- sweeps -------------------------------------------------------------------------------------

// A sweep over all springs. Between two sweeps nothing else needs to know where the vertices are.
static void sweep(pci_cloth *cloth, bool is_first, bool is_last) {
    double *x = cloth->positions, *places = cloth->places;
    if (cloth->block_count == 0) {
        return;
    }
    for (size_t v = 0; is_first && v < cloth->vertex_count; ++v) {
        memcpy(&places[4 * v], &x[3 * v], 3 * sizeof(*x));
    }
    cloth->sweep(places, cloth->blocks, cloth->block_count);
    for (size_t v = 0; is_last && v < cloth->vertex_count; ++v) {
        memcpy(&x[3 * v], &places[4 * v], 3 * sizeof(*x));
    }
}

// Brings edges whose strain exceeds `limit` back to it. Returns how many there were.
static size_t limit_strain(pci_cloth *cloth, double limit) {
    double *x = cloth->positions;
    size_t found = 0;
    for (size_t i = 0; i < cloth->edge_block_count; ++i) {
        const pci_spring_block *block = &cloth->blocks[i];
        for (size_t l = 0; l < PCI_LANES; ++l) {
            double *a = &x[3 * (size_t)block->a[l]], *b = &x[3 * (size_t)block->b[l]];
            const double longest = (1.0 + limit) * block->rest[l];
            const double shortest = fmax(1.0 - limit, 0.0) * block->rest[l];
            const double squared = pci_squared_distance(a, b);
            const double mass_a = cloth->inverse_mass[block->a[l]];
            const double mass_b = cloth->inverse_mass[block->b[l]];
            if ((squared <= longest * longest && squared >= shortest * shortest) ||
                !(squared > 0.0) || !(mass_a + mass_b > 0.0)) {
                continue;
            }
            const double wanted = squared > longest * longest ? longest : shortest;
            const double scale = (1.0 - wanted / sqrt(squared)) / (mass_a + mass_b);
            for (size_t k = 0; k < 3; ++k) {
                const double move = scale * (b[k] - a[k]);
                a[k] += mass_a * move;
                b[k] -= mass_b * move;
            }
            ++found;
        }
    }
    return found;
}

// Share of the edges with a free end whose strain exceeds `limit`.
static double strained_share(const pci_cloth *cloth, double limit) {
    size_t strained = 0, edges = 0;
    for (size_t i = 0; i < cloth->edge_block_count; ++i) {
        const pci_spring_block *block = &cloth->blocks[i];
        for (size_t l = 0; l < PCI_LANES; ++l) {
            if (!(block->move_a[l] + block->move_b[l] > 0.0)) {
                continue;
            }
            const double longest = (1.0 + limit) * block->rest[l];
            const double shortest = fmax(1.0 - limit, 0.0) * block->rest[l];
            const double squared = pci_squared_distance(&cloth->positions[3 * (size_t)block->a[l]],
                                                        &cloth->positions[3 * (size_t)block->b[l]]);
            ++edges;
            strained += squared > longest * longest || squared < shortest * shortest;
        }
    }
    return edges > 0 ? (double)strained / (double)edges : 0.0;
}

// ---- steps --------------------------------------------------------------------------------------

// Shares of the corrections when a step has this many substeps.
static void prepare_blocks(pci_cloth *cloth) {
    if (cloth->prepared == cloth->substeps) {
        return;
    }
    cloth->prepared = cloth->substeps;
    const double n = (double)cloth->substeps;
    for (size_t i = 0; i < cloth->block_count; ++i) {
        pci_spring_block *block = &cloth->blocks[i];
        for (size_t l = 0; l < PCI_LANES; ++l) {
            const double mass_a = cloth->inverse_mass[block->a[l]];
            const double mass_b = cloth->inverse_mass[block->b[l]];
            const double k = cloth->stiffness[PCI_LANES * i + l];
            // XPBD: compliance / substep^2 = (1 - k) / k * mass * n^2.
            const double share = cloth->dynamics == PCI_DYNAMICS_XPBD
                                     ? (k > 0.0 ? 1.0 / (1.0 + (1.0 - k) / k * n * n) : 0.0)
                                     : pci_sweep_stiffness(k, cloth->iterations * cloth->substeps);
            const double scale = mass_a + mass_b > 0.0 ? share / (mass_a + mass_b) : 0.0;
            block->move_a[l] = block->a[l] != block->b[l] ? scale * mass_a : 0.0;
            block->move_b[l] = block->a[l] != block->b[l] ? scale * mass_b : 0.0;
        }
    }
}

// Moves held vertices to their place after `share` of the step, and predicts the others.
static void predict(pci_cloth *cloth, double dt, double kept, double share) {
    memcpy(cloth->previous, cloth->positions, 3 * cloth->vertex_count * sizeof(double));
    for (size_t v = 0; v < cloth->vertex_count; ++v) {
        const double inverse_mass = cloth->inverse_mass[v];
        if (inverse_mass > 0.0) {
            for (size_t k = 3 * v; k < 3 * v + 3; ++k) {
                const double acceleration =
                    cloth->forces[k] * inverse_mass + cloth->gravity[k - 3 * v];
                cloth->velocities[k] = (cloth->velocities[k] + dt * acceleration) * kept;
                cloth->positions[k] += dt * cloth->velocities[k];
            }
        } else if (cloth->targets != NULL) {
            for (size_t k = 3 * v; k < 3 * v + 3; ++k) {
                cloth->positions[k] += share * (cloth->targets[k] - cloth->positions[k]);
            }
        }
    }
}

// The largest squared speed of the vertices after the prediction.
static double fastest(const pci_cloth *cloth, double dt) {
    double squared = cloth->free_speed * cloth->free_speed;
    for (size_t v = 0; v < cloth->vertex_count; ++v) {
        squared =
            fmax(squared, pci_squared_distance(&cloth->positions[3 * v], &cloth->previous[3 * v]) /
                              (dt * dt));
    }
    return squared;
}

// Speeds from the way that was made. Corrections may pull back a vertex far at once, but none shall
// fly faster than the fastest that was driven.
static void update_velocities(pci_cloth *cloth, double dt, double limit) {
    for (size_t v = 0; v < cloth->vertex_count; ++v) {
        double *velocity = &cloth->velocities[3 * v];
        for (size_t k = 0; k < 3; ++k) {
            velocity[k] = (cloth->positions[3 * v + k] - cloth->previous[3 * v + k]) / dt;
        }
        const double squared = pci_dot(velocity, velocity);
        if (cloth->free_speed > 0.0 && squared > limit) {
            const double scale = sqrt(limit / squared);
            for (size_t k = 0; k < 3; ++k) {
                velocity[k] *= scale;
            }
        }
    }
}

static void run_substep(pci_cloth *cloth, const double wind[3], uint32_t index) {
    const uint32_t n = cloth->substeps;
    const double dt = cloth->time_step / (double)n;
    const double kept = n == 1 ? 1.0 - cloth->damping : pow(1.0 - cloth->damping, 1.0 / (double)n);
    const bool touches = cloth->self != NULL || cloth->contacts != NULL;
    const uint32_t sweeps = cloth->dynamics == PCI_DYNAMICS_XPBD ? 1 : cloth->iterations;
    accumulate_wind(cloth, wind, dt);
    // From here to the target in the n - index substeps that are left.
    predict(cloth, dt, kept, 1.0 / (double)(n - index));
    const double limit = fastest(cloth, dt);
    if (cloth->contacts != NULL) {
        pci_contacts_place(cloth->contacts, (double)index / (double)n,
                           (double)(index + 1) / (double)n);
        pci_contacts_find(cloth->contacts, cloth);
    }
    if (cloth->self != NULL) {
        pci_self_contact_find(cloth->self, cloth);
    }
    for (uint32_t i = 0; i < sweeps; ++i) {
        sweep(cloth, i == 0 || touches, i + 1 == sweeps || touches);
        if (cloth->self != NULL) {
            pci_self_contact_solve(cloth->self, cloth);
        }
        if (cloth->contacts != NULL) {
            pci_contacts_solve(cloth->contacts, cloth);
        }
    }
    // Pulling back may need some sweeps, as each one only passes on what is too long.
    for (uint32_t i = 0; cloth->strain_limit > 0.0 && i < 10; ++i) {
        if (limit_strain(cloth, cloth->strain_limit) == 0) {
            break;
        }
    }
    if (cloth->self != NULL) {
        pci_self_contact_finish(cloth->self, cloth);
    }
    if (cloth->contacts != NULL) {
        pci_contacts_finish(cloth->contacts, cloth);
    }
    update_velocities(cloth, dt, limit);
}

static void run_substeps(pci_cloth *cloth, const double wind[3]) {
    prepare_blocks(cloth);
    for (uint32_t i = 0; i < cloth->substeps; ++i) {
        run_substep(cloth, wind, i);
    }
}

void pci_cloth_step(pci_cloth *cloth, const double wind[3]) {
    const size_t numbers = 3 * cloth->vertex_count;
    if (cloth->self != NULL) {
        pci_self_contact_begin(cloth->self, cloth);
    }
    if (cloth->saved == NULL) {
        run_substeps(cloth, wind);
        return;
    }
    memcpy(cloth->saved, cloth->positions, numbers * sizeof(double));
    memcpy(cloth->saved + numbers, cloth->velocities, numbers * sizeof(double));
    // After half a second of calm, fewer substeps are tried again.
    if (cloth->substeps >= 2 * cloth->least_substeps &&
        (double)cloth->calm_steps * cloth->time_step > 0.5) {
        cloth->substeps /= 2;
        cloth->calm_steps = 0;
    }
    run_substeps(cloth, wind);
    double share = strained_share(cloth, 0.8 * cloth->strain_limit);
    while (share > 0.05 && cloth->substeps < PCI_MOST_SUBSTEPS && cloth->wait_steps == 0) {
        memcpy(cloth->positions, cloth->saved, numbers * sizeof(double));
        memcpy(cloth->velocities, cloth->saved + numbers, numbers * sizeof(double));
        cloth->substeps =
            2 * cloth->substeps < PCI_MOST_SUBSTEPS ? 2 * cloth->substeps : PCI_MOST_SUBSTEPS;
        cloth->calm_steps = 0;
        run_substeps(cloth, wind);
        const double left = strained_share(cloth, 0.8 * cloth->strain_limit);
        if (left > 0.75 * share && left > 0.05) {
            // Pins or colliders force the strain: more substeps do not help for a while.
            cloth->substeps = cloth->substeps / 2 > cloth->least_substeps ? cloth->substeps / 2
                                                                          : cloth->least_substeps;
            cloth->wait_steps = (uint32_t)ceil(0.5 / cloth->time_step);
        }
        share = left;
    }
    cloth->wait_steps -= cloth->wait_steps > 0;
    ++cloth->calm_steps;
}

// ---- springs ------------------------------------------------------------------------------------

double pci_sweep_stiffness(double k, uint32_t sweeps) {
    return 1.0 - pow(1.0 - k, 1.0 / (double)sweeps);
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

// Appends springs to the blocks, beginning with a new one; a spring that shares a vertex with its
// block also starts a new one.
static void pack_blocks(const pci_spring *springs, size_t count, pci_cloth *cloth) {
    pci_spring_block *block = cloth->blocks;
    size_t lanes = PCI_LANES;
    for (size_t s = 0; s < count; ++s) {
        const pci_spring *spring = &springs[s];
        for (size_t l = 0; l < lanes && lanes < PCI_LANES; ++l) {
            if (block->a[l] == spring->a || block->a[l] == spring->b || block->b[l] == spring->a ||
                block->b[l] == spring->b) {
                lanes = PCI_LANES;
            }
        }
        if (lanes == PCI_LANES) {
            block = &cloth->blocks[cloth->block_count++];
            lanes = 0;
        }
        block->a[lanes] = spring->a;
        block->b[lanes] = spring->b;
        block->rest[lanes] = spring->rest;
        cloth->stiffness[PCI_LANES * (cloth->block_count - 1) + lanes++] = spring->stiffness;
    }
}

bool pci_springs_pack(pci_scratch *scratch, const pci_spring *springs, size_t count,
                      size_t edge_count, pci_cloth *cloth) {
    // At worst each spring has a block for itself.
    cloth->blocks = pci_scratch_allocate_aligned(scratch, count, sizeof(*cloth->blocks));
    cloth->stiffness = PCI_SCRATCH(scratch, double, PCI_LANES *count);
    cloth->places = pci_scratch_allocate_aligned(scratch, cloth->vertex_count, 4 * sizeof(double));
    cloth->sweep = pci_fastest_sweep();
    if (scratch->failed) {
        return false;
    }
    cloth->block_count = 0;
    pack_blocks(springs, edge_count, cloth);
    cloth->edge_block_count = cloth->block_count;
    pack_blocks(springs + edge_count, count - edge_count, cloth);
    cloth->prepared = 0;
    return true;
}
