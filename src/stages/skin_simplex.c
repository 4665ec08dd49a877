// Based on: Nocedal, Wright, "Numerical optimization", 2006, section 16.5.
#include "stages/skin_simplex.h"

#include "stages/skin_frames.h"

// y = (A + ridge I)^-1 y and z likewise on the free slots, by Cholesky factors.
static void solve_free(uint32_t count, const double *a, double ridge, uint32_t n,
                       const uint32_t *slots, double *y, double *z) {
    double l[PCI_SKIN_SLOTS_MAX][PCI_SKIN_SLOTS_MAX], inverse[PCI_SKIN_SLOTS_MAX];
    for (uint32_t i = 0; i < n; ++i) {
        const double *row = &a[(size_t)slots[i] * count];
        for (uint32_t j = 0; j < i; ++j) {
            double sum = row[slots[j]];
            for (uint32_t k = 0; k < j; ++k) {
                sum -= l[i][k] * l[j][k];
            }
            l[i][j] = sum * inverse[j];
        }
        double diagonal = row[slots[i]] + ridge;
        for (uint32_t k = 0; k < i; ++k) {
            diagonal -= l[i][k] * l[i][k];
        }
        // Rounding may leave less than the ridge.
        inverse[i] = 1.0 / sqrt(diagonal > ridge ? diagonal : ridge);
        double sum_y = y[i], sum_z = z[i];
        for (uint32_t k = 0; k < i; ++k) {
            sum_y -= l[i][k] * y[k];
            sum_z -= l[i][k] * z[k];
        }
        y[i] = sum_y * inverse[i];
        z[i] = sum_z * inverse[i];
    }
    for (uint32_t i = n; i-- > 0;) {
        for (uint32_t k = i + 1; k < n; ++k) {
            y[i] -= l[k][i] * y[k];
            z[i] -= l[k][i] * z[k];
        }
        y[i] *= inverse[i];
        z[i] *= inverse[i];
    }
}

void pci_simplex_minimize(uint32_t count, const double *a, double ridge, double *w, double *g) {
    uint32_t slots[PCI_SKIN_SLOTS_MAX], n = 0;
    for (uint32_t k = 0; k < count; ++k) {
        if (w[k] > 0.0) {
            slots[n++] = k;
        }
    }
    const uint32_t most_steps = 3 * count + 3; // cycles are impossible but for rounding
    for (uint32_t step = 0; step < most_steps; ++step) {
        // The minimum on the face of the free slots.
        double y[PCI_SKIN_SLOTS_MAX], z[PCI_SKIN_SLOTS_MAX], sum_y = 0.0, sum_z = 0.0;
        for (uint32_t i = 0; i < n; ++i) {
            y[i] = g[slots[i]];
            z[i] = 1.0;
        }
        double multiplier = n == 1 ? g[slots[0]] : 0.0, share = 1.0;
        uint32_t blocking = n;
        if (n > 1) {
            solve_free(count, a, ridge, n, slots, y, z);
            for (uint32_t i = 0; i < n; ++i) {
                sum_y += y[i];
                sum_z += z[i];
            }
            multiplier = sum_y / sum_z;
            for (uint32_t i = 0; i < n; ++i) {
                y[i] = multiplier * z[i] - y[i]; // the step
                if (w[slots[i]] + share * y[i] < 0.0) {
                    share = w[slots[i]] / -y[i];
                    blocking = i;
                }
            }
            for (uint32_t i = 0; i < n; ++i) {
                w[slots[i]] += share * y[i];
                const double moved = share * y[i], *row = &a[(size_t)slots[i] * count];
                for (uint32_t k = 0; k < count; ++k) {
                    g[k] += moved * row[k];
                }
            }
        }
        if (blocking < n) {
            w[slots[blocking]] = 0.0;
            for (uint32_t i = blocking; i + 1 < n; ++i) {
                slots[i] = slots[i + 1];
            }
            --n;
            continue;
        }
        // The slot at 0 that would lower the objective most.
        double lowest = -1e-9 * fabs(multiplier);
        uint32_t entering = count;
        for (uint32_t k = 0; k < count; ++k) {
            if (!(w[k] > 0.0) && g[k] - multiplier < lowest) {
                lowest = g[k] - multiplier;
                entering = k;
            }
        }
        for (uint32_t i = 0; i < n && entering < count; ++i) {
            entering = slots[i] == entering ? count : entering; // free, at 0 by chance
        }
        if (entering == count) {
            break;
        }
        slots[n++] = entering;
    }
    // Rounding of the sum goes to the largest.
    double sum = 0.0;
    uint32_t largest = 0;
    for (uint32_t k = 0; k < count; ++k) {
        sum += w[k];
        largest = w[k] > w[largest] ? k : largest;
    }
    w[largest] += 1.0 - sum;
}

uint32_t pci_simplex_least(uint32_t count, const double *a, double ridge, const double *w) {
    uint32_t slots[PCI_SKIN_SLOTS_MAX], best = count - 1;
    double least = INFINITY;
    for (uint32_t k = 0; k < count; ++k) {
        slots[k] = k;
    }
    for (uint32_t k = 0; k < count && least > 0.0; ++k) {
        double y[PCI_SKIN_SLOTS_MAX] = {0}, z[PCI_SKIN_SLOTS_MAX], sum_y = 0.0, sum_z = 0.0;
        if (w[k] > 0.0) {
            y[k] = 1.0;
            for (uint32_t i = 0; i < count; ++i) {
                z[i] = 1.0;
            }
            solve_free(count, a, ridge, count, slots, y, z);
            for (uint32_t i = 0; i < count; ++i) {
                sum_y += y[i];
                sum_z += z[i];
            }
            y[k] -= sum_y / sum_z * z[k];
        }
        const double cost = w[k] > 0.0 ? w[k] * w[k] / (2.0 * y[k]) : 0.0;
        if (cost < least) {
            least = cost;
            best = k;
        }
    }
    return best;
}
