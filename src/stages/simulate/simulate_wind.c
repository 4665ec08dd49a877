// Winds: random gusts, or keys.
#include "stages/simulate/simulate_internal.h"

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

void pci_wind_at(const pc_wind_key *keys, size_t count, double time, double velocity[3]) {
    size_t next = 0;
    while (next < count && keys[next].time <= time) {
        ++next;
    }
    const pc_wind_key *a = &keys[next > 0 ? next - 1 : 0];
    const pc_wind_key *b = &keys[next < count ? next : count - 1];
    const double share = b->time > a->time ? (time - a->time) / (b->time - a->time) : 0.0;
    for (size_t k = 0; k < 3; ++k) {
        velocity[k] = a->velocity[k] + share * (b->velocity[k] - a->velocity[k]);
    }
}
