/// Stage 8 of 9, simulate: proxy mesh -> frames of its motion (position based dynamics).
///
/// Springs along the edges resist stretch, springs between the non-shared vertices of adjacent
/// triangles resist bending (section 4). The highest `pinned_fraction` of the vertices is held,
/// wind of random direction and strength acts on the triangles (section 5.2).
///
/// One step: facet wind force air * A * ((wind - v_mean) . n) n / 3 per corner,
/// v = (v + dt (f / m + g)) (1 - damping), p = x + dt v, Gauss-Seidel sweeps over the springs with
/// stiffness 1 - (1 - k)^(1 / iterations), v = (p - x) / dt.
///
/// DEVIATION: a connected part without a held vertex gets its own `pinned_fraction`; it would fall
/// out of the scene.
///
/// Postconditions: finite positions; pinned vertices never move; frame 0 follows the first
/// `frame_steps` steps.
#ifndef PROXYCLOTH_SIMULATE_H
#define PROXYCLOTH_SIMULATE_H

#include "proxycloth/mesh.h"
#include "proxycloth/options.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct pc_simulate_options {
    uint32_t frames;
    uint32_t frame_steps;       ///< steps per kept frame
    double time_step;           ///< s
    uint32_t solver_iterations; ///< sweeps per step
    double stretch_stiffness;   ///< k_s
    double bend_stiffness;      ///< k_b
    double damping;             ///< share of the velocity lost per step
    double gravity;             ///< m/s^2, downwards
    double area_density;        ///< kg/m^2
    double air_density;         ///< factor of the facet force, kg/m^3
    double wind_speed;          ///< m/s, strongest wind
    double pinned_fraction;     ///< share of the vertices that is held, the highest ones
    double garment_size;        ///< m, diagonal at which the garment is simulated; 0: as it is
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
    double max_speed;    ///< m/s
    double motion_range; ///< largest displacement over the diagonal
} pc_simulate_report;

extern const pc_record pc_simulate_options_record;
extern const pc_record pc_simulate_report_record;

/// @param[in]  proxy   manifold with boundary.
/// @param[out] motion  zeroed on entry; `positions` in the proxy's unit.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT; PC_ERROR_INVALID_OPTIONS; PC_ERROR_TOO_LARGE;
///         PC_ERROR_NUMERICAL (with the frame number); PC_ERROR_OUT_OF_MEMORY; PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pc_simulate(pc_context *context, const pc_mesh *proxy,
                                   const pc_simulate_options *options, pc_motion *motion,
                                   pc_simulate_report *report);

#ifdef __cplusplus
}
#endif
#endif
