/// Stage 8 of 9, simulate: proxy mesh -> frames of its motion (position based dynamics).
///
/// Springs along the edges resist stretch, springs between the non-shared vertices of adjacent
/// triangles resist bending (section 4). The highest `pinned_fraction` of the vertices is held,
/// wind of random direction and strength acts on the triangles (section 5.2), in gusts of a third
/// to two thirds of a second that soon have blown from all sides. A scenario
/// (proxycloth/scenario.h) chooses other winds and pins, lets pinned vertices move, and adds
/// colliders.
///
/// One step: facet wind force air * A * ((wind - v_mean) . n) n / 3 per corner (never more than
/// what stops the facet relative to the wind), v = (v + dt (f / m + g)) (1 - damping),
/// p = x + dt v, Gauss-Seidel sweeps over the springs, contacts, v = (p - x) / dt.
///   pbd   `solver_iterations` sweeps with stiffness 1 - (1 - k)^(1 / iterations)
///   xpbd  one sweep per substep, with the compliance at which one sweep of a whole step would
///         correct the share k (Macklin et al., "Small steps in physics simulation", 2019)
///
/// Nothing explodes: edges whose length differs by more than `strain_limit` are brought back at the
/// end of every substep; a step that leaves more than 5 % of the edges near the limit is repeated
/// in twice as many substeps, up to 32, as long as that helps (substeps 0); no correction makes a
/// vertex faster than the fastest pinned or falling one and the wind; contacts that would stretch
/// an edge by twice the limit give way. Pins and colliders may still force larger strains.
///
/// Contacts act on vertices and on the middles of edges. Parts of the proxy that rest deeper in the
/// body than a quarter of an edge are tucked in and stay at their depth. The body is a distance
/// field in the rest pose; each of its parts moves with the joint that carries it.
///
/// With `self_contact` the cloth also stays on its sides of itself: vertices keep a distance from
/// the triangles that are not next to them, or what they have at rest where that is less, on the
/// side where they came near. Up to 15 steps long a vertex that has got through is brought back.
/// Contacts are discrete and give way where they strain an edge by twice the limit; what crosses at
/// rest may go on crossing.
///
/// DEVIATION: a connected part without a held vertex gets its own `pinned_fraction`; it would fall
/// out of the scene.
///
/// Postconditions: finite positions; pinned vertices never move but as the attachment says; frame 0
/// follows the first `frame_steps` steps. Independent of the number of threads.
#ifndef PROXYCLOTH_SIMULATE_H
#define PROXYCLOTH_SIMULATE_H

#include "proxycloth/character.h"
#include "proxycloth/mesh.h"
#include "proxycloth/options.h"
#include "proxycloth/scenario.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct pc_simulate_options {
    uint32_t frames;
    uint32_t frame_steps;       ///< steps per kept frame
    double time_step;           ///< s
    uint32_t dynamics;          ///< 0 pbd, 1 xpbd
    uint32_t solver_iterations; ///< sweeps per step (pbd)
    uint32_t substeps;          ///< per step; 0: as many as the strain needs
    double strain_limit;        ///< relative stretch that an edge may keep
    double stretch_stiffness;   ///< k_s
    double bend_stiffness;      ///< k_b
    double damping;             ///< share of the velocity lost per step
    double gravity;             ///< m/s^2, downwards
    double area_density;        ///< kg/m^2
    double air_density;         ///< factor of the facet force, kg/m^3
    double wind_speed;          ///< m/s, strongest wind
    double pinned_fraction;     ///< share of the vertices that is held, the highest ones
    double garment_size;        ///< m, diagonal at which the garment is simulated; 0: as it is
    double contact_distance;    ///< m, that the cloth keeps from colliders
    double friction;            ///< Coulomb's coefficient at colliders and between cloth
    double self_contact;        ///< distance to keep from itself, mean edge lengths; 0: none
    uint32_t up_axis;           ///< 0 x, 1 y, 2 z
    uint32_t seed;
} pc_simulate_options;

typedef struct pc_simulate_report {
    uint64_t stretch_springs;
    uint64_t bend_springs;
    uint64_t pinned;
    double mean_strain; ///< of the edges over all frames
    double p95_strain;
    double max_strain;
    double max_speed;        ///< m/s
    double motion_range;     ///< largest displacement over the diagonal
    uint64_t most_substeps;  ///< of a step
    uint64_t unmatched_pins; ///< rules of the scenario that name no vertex
    double deepest_contact;  ///< m, how far a free vertex is inside a collider, over all frames
} pc_simulate_report;

extern const pc_record pc_simulate_options_record;
extern const pc_record pc_simulate_report_record;

/// The motion of the paper: pc_simulate_scenario without scenario.
/// @param[in]  proxy   manifold with boundary.
/// @param[out] motion  zeroed on entry; `positions` in the proxy's unit.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT; PC_ERROR_INVALID_OPTIONS; PC_ERROR_TOO_LARGE;
///         PC_ERROR_NUMERICAL (with the frame number); PC_ERROR_OUT_OF_MEMORY; PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pc_simulate(pc_context *context, const pc_mesh *proxy,
                                   const pc_simulate_options *options, pc_motion *motion,
                                   pc_simulate_report *report);

/// What a simulation reads; pointers other than `proxy` may be NULL.
typedef struct pc_simulate_inputs {
    const pc_mesh *proxy;
    const pc_scenario *scenario;
    const pc_visual *visual;       ///< for pins and joint weights
    const pc_character *character; ///< for clips, joints and the body
} pc_simulate_inputs;

/// @return as pc_simulate; PC_ERROR_INVALID_OPTIONS also when the scenario names a clip, joint,
///         mesh or material that the inputs lack, or needs one that is NULL.
PC_NODISCARD pc_status pc_simulate_scenario(pc_context *context, const pc_simulate_inputs *inputs,
                                            const pc_simulate_options *options, pc_motion *motion,
                                            pc_simulate_report *report);

/// The same simulation step by step, for programs that run while it goes on.
///
///     pc_simulator *simulator = NULL;
///     if (pc_simulator_create(context, &inputs, &options, &simulator) != PC_OK) return;
///     while (running && pc_simulator_step(simulator, NULL, NULL) == PC_OK)
///         draw(pc_simulator_positions(simulator));
///     pc_simulator_destroy(simulator);
///
/// Frame f of pc_simulate_scenario is what (f + 1) * frame_steps steps without wind and targets of
/// the caller's lead to, bit for bit.
typedef struct pc_simulator pc_simulator;

/// Prepares a simulation and, with a clip, leads the cloth to its start.
/// @param[in]  inputs     what the pointers in it name must stay as it is until the simulator is
///                        destroyed.
/// @param[in]  options    NULL for the defaults; `frames` is not used.
/// @param[out] simulator  NULL on failure. Belongs to the context, which has to outlive it.
/// @return as pc_simulate_scenario.
PC_NODISCARD pc_status pc_simulator_create(pc_context *context, const pc_simulate_inputs *inputs,
                                           const pc_simulate_options *options,
                                           pc_simulator **simulator);

/// One step of `time_step`. Allocates nothing.
/// @param[in] wind     3 numbers, m/s; NULL: the wind of the scenario or of the seed, which goes on
///                     in the meantime.
/// @param[in] targets  #V by 3 in the proxy's unit: where pinned vertices, and only they, are at
///                     the end of the step; NULL: where the attachment has them, or where they are.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT (NULL); PC_ERROR_NUMERICAL, after which only destroying
///         is of use.
PC_NODISCARD pc_status pc_simulator_step(pc_simulator *simulator, const double *wind,
                                         const double *targets);

/// Positions of the proxy after the last step, or where the simulation starts: #V by 3 in its unit.
/// Overwritten by the next step.
const double *pc_simulator_positions(const pc_simulator *simulator);

/// #V, 1 for vertices that are held.
const uint8_t *pc_simulator_pinned(const pc_simulator *simulator);

/// NULL is accepted.
void pc_simulator_destroy(pc_simulator *simulator);

#ifdef __cplusplus
}
#endif
#endif
