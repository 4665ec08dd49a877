// Winds: random gusts, or keys.
//
// Weights see these winds alone, so the gusts are short and their directions and strengths spread
// like a sequence of low discrepancy: independent ones leave out whole sides in so few frames.
// Based on: Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018.
#include "stages/simulate/simulate_internal.h"

enum { WIND_GUSTS = 0x77696e64, WIND_NOISE = 0x6e6f6973 }; // streams of random numbers

// Steps of the additive sequence of least discrepancy in three dimensions: powers of 1 / x, where
// x^4 = x + 1.
static const double strides[3] = {0.8191725133961645, 0.6710436067037893, 0.5497004779019703};

pci_wind pci_wind_begin(uint32_t seed, double top_speed) {
    const pci_wind wind = {.seed = seed, .top_speed = top_speed};
    return wind;
}

// One of three numbers in [0, 1) of a gust, which few gusts together spread evenly.
static double gust_number(const pci_wind *wind, size_t which) {
    const double start = pci_random(wind->seed, WIND_GUSTS, which);
    return fmod(start + (double)wind->gust * strides[which], 1.0);
}

void pci_wind_next(pci_wind *wind, double velocity[3]) {
    if (wind->step == wind->gust_end) {
        // Over the sphere, 0.2 to 1 of the top speed, for 20 to 40 steps.
        const double z = 2.0 * gust_number(wind, 0) - 1.0;
        const double angle = 6.283185307179586 * gust_number(wind, 1);
        const double strength = wind->top_speed * (0.2 + 0.8 * gust_number(wind, 2));
        const double radius = sqrt(1.0 - z * z);
        wind->target[0] = strength * radius * cos(angle);
        wind->target[1] = strength * radius * sin(angle);
        wind->target[2] = strength * z;
        wind->gust_end += 20 + pci_random_bits(wind->seed, WIND_GUSTS, 3 + wind->gust++) % 21;
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
