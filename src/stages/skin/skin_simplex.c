// Based on: Nocedal, Wright, "Numerical optimization", 2006, section 16.5.
#include "stages/skin/skin_simplex.h"

#include "stages/skin/skin_frames.h"

// y = (A + ridge I)^-1 y and z likewise on the free slots, by factors L D L^T. Compiled for each
// small n: most of the time would go into the ends of short loops.
static inline __attribute__((always_inline)) void solve_n(uint32_t count, const double *a,
                                                          double ridge, const uint32_t n,
                                                          const uint32_t *slots, double *y,
                                                          double *z) {
    double l[PCI_SKIN_SLOTS_MAX][PCI_SKIN_SLOTS_MAX];
    double inverse[PCI_SKIN_SLOTS_MAX], scaled[PCI_SKIN_SLOTS_MAX];
    for (uint32_t i = 0; i < n; ++i) {
        const double *row = &a[(size_t)slots[i] * count];
        double diagonal = row[slots[i]] + ridge, sum_y = y[i], sum_z = z[i];
        for (uint32_t j = 0; j < i; ++j) {
            double sum = row[slots[j]];
            for (uint32_t k = 0; k < j; ++k) {
                sum -= scaled[k] * l[j][k];
            }
            scaled[j] = sum;
            l[i][j] = sum * inverse[j];
            diagonal -= sum * l[i][j];
            sum_y -= l[i][j] * y[j];
            sum_z -= l[i][j] * z[j];
        }
        // Rounding may leave less than the ridge.
        inverse[i] = 1.0 / (diagonal > ridge ? diagonal : ridge);
        y[i] = sum_y;
        z[i] = sum_z;
    }
    for (uint32_t i = n; i-- > 0;) {
        double sum_y = y[i] * inverse[i], sum_z = z[i] * inverse[i];
        for (uint32_t k = i + 1; k < n; ++k) {
            sum_y -= l[k][i] * y[k];
            sum_z -= l[k][i] * z[k];
        }
        y[i] = sum_y;
        z[i] = sum_z;
    }
}

static void solve_free(uint32_t count, const double *a, double ridge, uint32_t n,
                       const uint32_t *slots, double *y, double *z) {
    switch (n) {
    case 2:
        solve_n(count, a, ridge, 2, slots, y, z);
        break;
    case 3:
        solve_n(count, a, ridge, 3, slots, y, z);
        break;
    case 4:
        solve_n(count, a, ridge, 4, slots, y, z);
        break;
    case 5:
        solve_n(count, a, ridge, 5, slots, y, z);
        break;
    case 6:
        solve_n(count, a, ridge, 6, slots, y, z);
        break;
    case 7:
        solve_n(count, a, ridge, 7, slots, y, z);
        break;
    case 8:
        solve_n(count, a, ridge, 8, slots, y, z);
        break;
    default:
        solve_n(count, a, ridge, n, slots, y, z);
        break;
    }
}

bool pci_simplex_enters(double slope, double multiplier) {
    return slope - multiplier < -1e-9 * fabs(multiplier);
}

void pci_simplex_round(uint32_t count, double *w) {
    double sum = 0.0;
    uint32_t largest = 0;
    for (uint32_t k = 0; k < count; ++k) {
        sum += w[k];
        largest = w[k] > w[largest] ? k : largest;
    }
    w[largest] += 1.0 - sum;
}

void pci_simplex_factor(uint32_t n, double ridge, const double *a, double *factor) {
    double *row = factor;
    for (uint32_t i = 1; i < n; row += i++) {
        const double *ai = &a[i * n];
        double pivot = ai[i] - 2.0 * ai[0] + a[0] + 2.0 * ridge;
        const double *before = factor;
        memset(row, 0, i * sizeof(*row));
        for (uint32_t r = 1; r < i; before += r++) {
            double sum = 0.0;
            for (uint32_t j = 1; j <= r; ++j) {
                sum += before[j - 1] * (ai[j] - ai[0] - a[j] + a[0] + ridge);
            }
            pivot -= sum * sum;
            for (uint32_t j = 1; j <= r; ++j) {
                row[j - 1] -= sum * before[j - 1];
            }
        }
        // Rounding may leave less than the ridge.
        const double scale = 1.0 / sqrt(pivot > ridge ? pivot : ridge);
        row[i - 1] = 1.0;
        for (uint32_t j = 0; j < i; ++j) {
            row[j] *= scale;
        }
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
        uint32_t entering = count;
        for (uint32_t k = 0; k < count; ++k) {
            if (!(w[k] > 0.0) && pci_simplex_enters(g[k], multiplier) &&
                (entering == count || g[k] < g[entering])) {
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
    pci_simplex_round(count, w);
}

uint32_t pci_simplex_least(uint32_t count, const double *a, double ridge, const double *w) {
    double factor[PCI_SKIN_SLOTS_MAX * (PCI_SKIN_SLOTS_MAX - 1) / 2];
    double c[PCI_SKIN_SLOTS_MAX] = {0}, least = INFINITY; // c: C_kk
    uint32_t best = count - 1;
    pci_simplex_factor(count, ridge, a, factor);
    const double *row = factor;
    for (uint32_t i = 1; i < count; row += i++) {
        double sum = 0.0;
        for (uint32_t j = 0; j < i; ++j) {
            c[j + 1] += row[j] * row[j];
            sum += row[j];
        }
        c[0] += sum * sum;
    }
    for (uint32_t k = 0; k < count; ++k) {
        const double cost = w[k] > 0.0 ? w[k] * w[k] / (2.0 * c[k]) : 0.0;
        if (cost < least) {
            least = cost;
            best = k;
        }
    }
    return best;
}
