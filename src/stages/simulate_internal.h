// Position based dynamics of springs, as a state and a step. For simulate.c and its tests.
#ifndef PCI_SIMULATE_INTERNAL_H
#define PCI_SIMULATE_INTERNAL_H

#include "core/core.h"
#include "proxycloth/mesh.h"

typedef struct pci_spring {
    uint32_t a, b;
    double rest;
    double stiffness; // k' of one sweep, 0..1
} pci_spring;

typedef struct pci_cloth {
    size_t vertex_count;
    double *positions;          // #V by 3, m
    double *velocities;         // #V by 3, m/s
    double *previous;           // #V by 3, scratch of a step
    double *forces;             // #V by 3, scratch of a step
    const double *inverse_mass; // #V, 1/kg; 0: held fixed
    size_t triangle_count;
    const uint32_t *triangles; // #F by 3
    size_t spring_count;
    const pci_spring *springs; // in the order in which they are solved
    double time_step;          // s
    double damping;            // share of the velocity lost per step
    double air_density;        // kg/m^3
    double gravity[3];         // m/s^2
    uint32_t iterations;       // sweeps per step
} pci_cloth;

// One step of `time_step` under a uniform wind in m/s.
void pci_cloth_step(pci_cloth *cloth, const double wind[3]);

// Stiffness of one sweep so that `iterations` sweeps give k in total.
double pci_sweep_stiffness(double k, uint32_t iterations);

// Springs along the edges, then springs across them; both groups ordered by a greedy colouring, so
// that neighbours in the list seldom share a vertex. `edge_spring_count` of them are edges.
// False: out of memory.
bool pci_springs_build(pci_scratch *scratch, const pc_mesh *mesh, double stretch, double bend,
                       pci_spring **springs, size_t *spring_count, size_t *edge_spring_count);

// Wind of random direction and strength: gusts of 30 to 90 steps, smoothed, with noise.
typedef struct pci_wind {
    uint32_t seed;
    double top_speed;
    uint64_t gust;           // number of the running gust
    uint64_t step, gust_end; // steps so far; first step of the next gust
    double target[3], smooth[3];
} pci_wind;

pci_wind pci_wind_begin(uint32_t seed, double top_speed);
void pci_wind_next(pci_wind *wind, double velocity[3]);

#endif
