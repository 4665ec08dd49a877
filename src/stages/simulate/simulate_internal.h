// The steps of the simulation stage: springs and time steps, winds, pins, poses, contacts.
#ifndef PCI_SIMULATE_INTERNAL_H
#define PCI_SIMULATE_INTERNAL_H

#include "core/core.h"
#include "geometry/pose.h"
#include "proxycloth/simulate.h"

// ---- springs and steps (simulate_springs.c) ----------------------------------------------------

typedef struct pci_spring {
    uint32_t a, b;
    double rest;
    double stiffness; // k of a whole step, 0..1
} pci_spring;

// Springs that share no vertex and are solved at a time. Unused lanes do nothing.
enum { PCI_LANES = 4 };
typedef struct pci_spring_block {
    uint32_t a[PCI_LANES], b[PCI_LANES];
    double rest[PCI_LANES];
    double move_a[PCI_LANES], move_b[PCI_LANES]; // shares of the correction that the ends take
} pci_spring_block; // with 128 vertices all of them stay in the first-level cache

// Each spring moves its ends towards the rest length, shared by mass. All lanes are read before any
// is written, so the result is that of one after the other; the same bits from all sweeps.
// `places`: x, y, z and 0 of each vertex.
typedef void (*pci_sweep)(double *places, const pci_spring_block *blocks, size_t count);
void pci_sweep_generic(double *places, const pci_spring_block *blocks, size_t count);
void pci_sweep_avx2(double *places, const pci_spring_block *blocks, size_t count);
pci_sweep pci_fastest_sweep(void); // on this processor

typedef enum pci_dynamics { PCI_DYNAMICS_PBD, PCI_DYNAMICS_XPBD } pci_dynamics;

struct pci_contacts;
struct pci_self_contact;

typedef struct pci_cloth {
    size_t vertex_count;
    double *positions;          // #V by 3, m
    double *velocities;         // #V by 3, m/s
    double *previous;           // #V by 3, scratch of a step
    double *forces;             // #V by 3, scratch of a step
    double *places;             // #V by 4, scratch of the sweeps
    double *saved;              // #V by 6, scratch of an adaptive step; NULL: substeps are fixed
    const double *inverse_mass; // #V, 1/kg; 0: held
    const double *targets;      // #V by 3, where held vertices end this step; NULL: they stay
    size_t triangle_count;
    const uint32_t *triangles; // #F by 3
    size_t block_count;
    size_t edge_block_count; // the first ones hold the springs along edges
    pci_spring_block *blocks;
    double *stiffness; // #blocks by lanes, of a whole step
    pci_sweep sweep;
    double time_step;    // s
    double damping;      // share of the velocity lost per step
    double air_density;  // kg/m^3
    double area_density; // kg/m^2; 0: the wind force is not limited
    double gravity[3];   // m/s^2
    double strain_limit; // 0: none
    double free_speed;   // m/s, that corrections may always give; 0: any
    uint32_t iterations; // sweeps per substep
    pci_dynamics dynamics;
    uint32_t substeps; // of the next step, at least 1
    uint32_t least_substeps;
    uint32_t prepared;             // substeps for which the blocks are prepared; 0: none
    uint32_t calm_steps;           // steps since an adaptive step was last repeated
    uint32_t wait_steps;           // steps until more substeps are tried again
    struct pci_contacts *contacts; // NULL: none
    struct pci_self_contact *self; // NULL: the cloth passes through itself
} pci_cloth;

// One step of `time_step` under a uniform wind in m/s. With `saved`, substeps adapt to the strain.
void pci_cloth_step(pci_cloth *cloth, const double wind[3]);

enum { PCI_MOST_SUBSTEPS = 32 };

// Stiffness of one sweep so that `sweeps` sweeps give k in total.
double pci_sweep_stiffness(double k, uint32_t sweeps);

// Springs along the edges, then springs across them; both groups ordered by a greedy colouring, so
// that neighbours in the list seldom share a vertex. `edge_spring_count` of them are edges.
// False: out of memory.
bool pci_springs_build(pci_scratch *scratch, const pc_mesh *mesh, double stretch, double bend,
                       pci_spring **springs, size_t *spring_count, size_t *edge_spring_count);

// Packs springs into blocks and makes room for sweeps; solving block by block is solving one after
// the other in their order.
// False: out of memory.
bool pci_springs_pack(pci_scratch *scratch, const pci_spring *springs, size_t count,
                      size_t edge_count, pci_cloth *cloth);

// ---- winds (simulate_wind.c) -------------------------------------------------------------------

// Wind of random direction and strength: gusts of 20 to 40 steps, smoothed, with noise. A
// dozen gusts blow from all sides.
typedef struct pci_wind {
    uint32_t seed;
    double top_speed;
    uint64_t gust;           // number of the running gust
    uint64_t step, gust_end; // steps so far; first step of the next gust
    double target[3], smooth[3];
} pci_wind;

pci_wind pci_wind_begin(uint32_t seed, double top_speed);
void pci_wind_next(pci_wind *wind, double velocity[3]);

// The wind of a list at a time.
void pci_wind_at(const pc_wind_key *keys, size_t count, double time, double velocity[3]);

// ---- pins (simulate_pins.c) --------------------------------------------------------------------

// Marks the vertices that the scenario's rules name, or the highest ceil(fraction * #V) without
// rules; then, in every connected part without a held vertex, its highest ones. `axis` points up.
// `unmatched` counts rules that name no vertex.
PC_NODISCARD pc_status pci_pin_vertices(pci_scratch *scratch, const pc_simulate_inputs *inputs,
                                        double fraction, size_t axis, uint8_t *pinned,
                                        uint64_t *unmatched);

// Whether `text` matches a pattern in which * stands for any text and ? for any byte.
bool pci_matches(const char *pattern, const char *text);

// ---- poses (simulate_pose.c) -------------------------------------------------------------------

// The rigid map of the attachment at a time.
void pci_rigid_at(const pc_attachment *attachment, double scale, double time, pci_map *map);

// Joints and weights of the pinned vertices, 4 by vertex: from the nearest point of the visual
// mesh, or carried over from the body where that has none. PC_ERROR_INVALID_OPTIONS when neither is
// skinned.
typedef struct pci_binding {
    uint32_t *joints;
    double *weights;
} pci_binding;
PC_NODISCARD pc_status pci_bind_pins(pci_scratch *scratch, const pc_simulate_inputs *inputs,
                                     const uint8_t *pinned, pci_binding *binding);
// Where the joints take a vertex from its rest position.
void pci_binding_apply(const pci_binding *binding, const pci_map *maps, size_t vertex,
                       const double rest[3], double out[3]);

// ---- contacts (simulate_contact.c) -------------------------------------------------------------

typedef struct pci_contacts pci_contacts;

// Colliders of the scenario at the simulated size; NULL where there are none. The distance field
// of the body is computed here.
PC_NODISCARD pc_status pci_contacts_create(pci_scratch *scratch, const pc_simulate_inputs *inputs,
                                           double scale, double distance, double friction,
                                           pci_contacts **contacts);
// Colliders move from where they are to the maps of `joints` during the next step.
void pci_contacts_aim(pci_contacts *contacts, const pci_map *joints);
// Moves colliders between two shares (0..1) of the running step.
void pci_contacts_place(pci_contacts *contacts, double before, double now);
// Finds the contacts of all free vertices; then each call pushes them out of the contact planes.
void pci_contacts_find(pci_contacts *contacts, const pci_cloth *cloth);
void pci_contacts_solve(const pci_contacts *contacts, pci_cloth *cloth);
// Removes what is left of penetration, with friction against the substep's start in `previous`.
void pci_contacts_finish(pci_contacts *contacts, pci_cloth *cloth);
// Depth of the point in the deepest collider; negative: distance to the nearest, where near.
double pci_contacts_depth(pci_contacts *contacts, const double point[3]);

// ---- contacts of the cloth with itself (simulate_self_contact.c) -------------------------------

typedef struct pci_self_contact pci_self_contact;

// Vertices keep a distance of `edges` mean edge lengths, or less where they rest nearer, from the
// triangles that are not next to them. `rest` must stay. False: out of memory.
bool pci_self_contact_create(pci_scratch *scratch, const pc_mesh *rest, double edges,
                             double friction, pci_self_contact **self);
// At the start of a step: which vertices are near which triangles, and on which side of them.
void pci_self_contact_begin(pci_self_contact *self, const pci_cloth *cloth);
// After the prediction of a substep; then each call pushes vertices and triangles apart.
void pci_self_contact_find(pci_self_contact *self, const pci_cloth *cloth);
void pci_self_contact_solve(pci_self_contact *self, pci_cloth *cloth);
// The last push, and friction against the substep's start in `previous`.
void pci_self_contact_finish(pci_self_contact *self, pci_cloth *cloth);

#endif
