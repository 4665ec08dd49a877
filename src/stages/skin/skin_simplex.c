// Based on: Nocedal, Wright, "Numerical optimization", 2006, section 16.5.
#include "stages/skin/skin_simplex.h"

#include "stages/skin/skin_frames.h"

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
        const double *ai = &a[i * n], *before = factor;
        double pivot = ai[i] - 2.0 * ai[0] + a[0] + 2.0 * ridge;
        double h[PCI_SKIN_SLOTS_MAX], sums[PCI_SKIN_SLOTS_MAX];
        for (uint32_t j = 1; j < i; ++j) {
            h[j - 1] = ai[j] - ai[0] - a[j] + a[0] + ridge;
            sums[j - 1] = 0.0;
        }
        for (uint32_t r = 1; r < i; before += r++) {
            double sum = 0.0;
            for (uint32_t j = 0; j < r; ++j) {
                sum += before[j] * h[j];
            }
            pivot -= sum * sum;
            for (uint32_t j = 0; j < r; ++j) {
                sums[j] -= sum * before[j];
            }
        }
        // Rounding may leave less than the ridge.
        const double scale = 1.0 / sqrt(pivot > ridge ? pivot : ridge);
        for (uint32_t j = 0; j + 1 < i; ++j) {
            row[j] = scale * sums[j];
        }
        row[i - 1] = scale;
    }
}

// ---- active sets --------------------------------------------------------------------------------

// A program with C of the slots in its face, which slots enter and leave at the price of a product
// with a vector.
typedef struct program {
    uint32_t count;
    uint64_t face, closed; // bits; those in neither are at 0 and may enter
    double ridge;
    double w[PCI_SKIN_SLOTS_MAX], g[PCI_SKIN_SLOTS_MAX];
    // Rows of `stride`, 0 where there is no slot; C also where a slot is not in the face.
    double a[PCI_SKIN_SLOTS_MAX * PCI_SKIN_SLOTS_MAX];
    double inverse[PCI_SKIN_SLOTS_MAX * PCI_SKIN_SLOTS_MAX];
} program;

static inline uint64_t bit_of(uint32_t slot) { return (uint64_t)1 << slot; }

static inline uint32_t take_first(uint64_t *bits) {
    const uint32_t slot = (uint32_t)__builtin_ctzll(*bits);
    *bits &= *bits - 1;
    return slot;
}

static inline __attribute__((always_inline)) double sum_of(const size_t stride, const double *row) {
    double sum = 0.0;
    for (size_t j = 0; j < stride; ++j) {
        sum += row[j];
    }
    return sum;
}

// y += factor x, of `count` rounded up to fours.
static inline void add_fours(size_t count, double factor, const double *restrict x,
                             double *restrict y) {
    for (size_t j = 0; j < count; j += 4) {
        for (size_t k = 0; k < 4; ++k) {
            y[j + k] += factor * x[j + k];
        }
    }
}

// C grows by v v^T / v^T (A + ridge I) v, where v gives to the slot and takes from the face what
// leaves its gradient even. `stride` is known where this is compiled, here and below.
static inline __attribute__((always_inline)) void enter(program *p, const size_t stride,
                                                        uint32_t slot) {
    double h[PCI_SKIN_SLOTS_MAX], v[PCI_SKIN_SLOTS_MAX], square = 0.0;
    const uint64_t face = p->face;
    p->face |= bit_of(slot);
    if (face == 0) {
        return;
    }
    const uint32_t other = (uint32_t)__builtin_ctzll(face);
    const size_t end = 64 - (size_t)__builtin_clzll(p->face); // slots from here on are 0
    size_t n = 0;
    do { // there is one at least
        h[n] = p->a[slot * stride + n] - p->a[other * stride + n];
        v[n] = 0.0;
    } while (++n < stride);
    h[slot] += p->ridge;
    h[other] -= p->ridge;
    v[slot] = 1.0;
    v[other] = -1.0;
    for (uint64_t left = face; left != 0;) {
        const uint32_t i = take_first(&left);
        add_fours(end, -h[i], &p->inverse[i * stride], v);
    }
    v[other] -= sum_of(stride, v);
    for (uint64_t left = p->face; left != 0;) {
        const uint32_t i = take_first(&left);
        square += v[i] * h[i];
    }
    // Rounding may leave less than the ridge.
    const double scale = 1.0 / sqrt(square > p->ridge ? square : p->ridge);
    for (size_t j = 0; j < stride; ++j) {
        v[j] *= scale;
    }
    for (uint64_t left = p->face; left != 0;) {
        const uint32_t i = take_first(&left);
        add_fours(end, v[i], v, &p->inverse[i * stride]);
    }
}

static inline __attribute__((always_inline)) void leave(program *p, const size_t stride,
                                                        uint32_t slot) {
    const double pivot = p->inverse[slot * stride + slot];
    double v[PCI_SKIN_SLOTS_MAX];
    p->face &= ~bit_of(slot);
    p->w[slot] = 0.0;
    const double scale = pivot > 0.0 ? 1.0 / sqrt(pivot) : 0.0;
    for (size_t j = 0; j < stride; ++j) {
        v[j] = scale * p->inverse[slot * stride + j];
        p->inverse[slot * stride + j] = 0.0;
    }
    v[slot] = 0.0;
    for (uint64_t left = p->face; left != 0;) {
        const uint32_t i = take_first(&left);
        for (size_t j = 0; j < stride; ++j) {
            p->inverse[i * stride + j] -= v[i] * v[j];
        }
        p->inverse[i * stride + slot] = 0.0;
        if (p->face == bit_of(i)) { // alone it cannot move, rounding or not
            p->inverse[i * stride + i] = 0.0;
        }
    }
}

// Goes along a step within the face until it ends or a slot is at 0, which then leaves. False: one
// did.
static inline __attribute__((always_inline)) bool go(program *p, const size_t stride,
                                                     double *step) {
    double share = 1.0;
    uint32_t blocking = p->count;
    step[__builtin_ctzll(p->face)] -= sum_of(stride, step);
    for (uint64_t left = p->face; left != 0;) {
        const uint32_t i = take_first(&left);
        if (p->w[i] + share * step[i] < 0.0) {
            share = p->w[i] / -step[i];
            blocking = i;
        }
    }
    for (uint64_t left = p->face; left != 0;) {
        const uint32_t i = take_first(&left);
        const double moved = share * step[i];
        p->w[i] += moved;
        for (size_t j = 0; j < stride; ++j) {
            p->g[j] += moved * p->a[i * stride + j];
        }
    }
    if (blocking < p->count) {
        leave(p, stride, blocking);
    }
    return blocking == p->count;
}

// The slope that those in the face have, at a minimum.
static double mean_slope(const program *p) {
    double sum = 0.0;
    for (uint64_t left = p->face; left != 0;) {
        const uint32_t i = take_first(&left);
        sum += p->w[i] * p->g[i];
    }
    return sum;
}

static inline __attribute__((always_inline)) void descend(program *p, const size_t stride) {
    const uint32_t most_steps = 3 * p->count + 3; // cycles are impossible but for rounding
    for (uint32_t n = 0; n < most_steps; ++n) {
        const double mean = mean_slope(p);
        double step[PCI_SKIN_SLOTS_MAX];
        for (size_t j = 0; j < stride; ++j) {
            step[j] = 0.0;
        }
        for (uint64_t left = p->face; left != 0;) {
            const uint32_t i = take_first(&left);
            for (size_t j = 0; j < stride; ++j) {
                step[j] -= (p->g[i] - mean) * p->inverse[i * stride + j];
            }
        }
        if (!go(p, stride, step)) {
            continue;
        }
        // The slot at 0 that would lower the objective most.
        const double multiplier = mean_slope(p);
        uint32_t entering = p->count;
        for (uint32_t k = 0; k < p->count; ++k) {
            if (((p->face | p->closed) >> k & 1) == 0 && pci_simplex_enters(p->g[k], multiplier) &&
                (entering == p->count || p->g[k] < p->g[entering])) {
                entering = k;
            }
        }
        if (entering == p->count) {
            return;
        }
        enter(p, stride, entering);
    }
}

// The slot that costs least to fix at 0 while the others adapt with their sum kept and signs
// ignored: the least w_k^2 / (2 C_kk). Of those at 0, which cost nothing, the first.
static uint32_t cheapest(const program *p, size_t stride) {
    double least = INFINITY;
    uint32_t best = p->count;
    for (uint32_t k = 0; k < p->count; ++k) {
        if ((p->closed >> k & 1) == 0) {
            const double w = p->w[k];
            const double cost = w > 0.0 ? w * w / p->inverse[k * stride + k] : 0.0;
            if (best == p->count || cost < least) {
                least = cost;
                best = k;
            }
        }
    }
    return best;
}

// The others adapt as its weight goes to 0.
static inline __attribute__((always_inline)) void shut(program *p, const size_t stride,
                                                       uint32_t slot) {
    p->closed |= bit_of(slot);
    while (p->w[slot] > 0.0 && p->face != bit_of(slot)) {
        const double *row = &p->inverse[slot * stride];
        double step[PCI_SKIN_SLOTS_MAX];
        for (size_t j = 0; j < stride; ++j) {
            step[j] = -p->w[slot] / row[slot] * row[j];
        }
        step[slot] = -p->w[slot];
        if (go(p, stride, step)) {
            break;
        }
    }
    if (p->face >> slot & 1) {
        leave(p, stride, slot);
        descend(p, stride);
    }
}

static inline __attribute__((always_inline)) uint64_t run(uint32_t count, const size_t stride,
                                                          const double *a, double ridge,
                                                          uint32_t kept, double *w, double *g) {
    program p;
    p.count = count;
    p.ridge = ridge;
    p.face = p.closed = 0;
    memset(p.inverse, 0, stride * stride * sizeof(*p.inverse));
    for (size_t i = 0; i < stride; ++i) {
        p.w[i] = i < count ? w[i] : 0.0;
        p.g[i] = i < count ? g[i] : 0.0;
        for (size_t j = 0; j < stride; ++j) {
            p.a[i * stride + j] = i < count && j < count ? a[i * count + j] : 0.0;
        }
    }
    for (uint32_t k = 0; k < count; ++k) {
        if (w[k] > 0.0) {
            enter(&p, stride, k);
        }
    }
    descend(&p, stride);
    for (uint32_t left = count; left > kept; --left) {
        shut(&p, stride, cheapest(&p, stride));
    }
    memcpy(w, p.w, count * sizeof(*w));
    memcpy(g, p.g, count * sizeof(*g));
    pci_simplex_round(count, w);
    return ~p.closed;
}

uint64_t pci_simplex_prune(uint32_t count, const double *a, double ridge, uint32_t kept, double *w,
                           double *g) {
    // Compiled for each small size: most of the time would go into the ends of short loops.
    return count <= 4    ? run(count, 4, a, ridge, kept, w, g)
           : count <= 8  ? run(count, 8, a, ridge, kept, w, g)
           : count <= 12 ? run(count, 12, a, ridge, kept, w, g)
           : count <= 16 ? run(count, 16, a, ridge, kept, w, g)
           : count <= 32 ? run(count, 32, a, ridge, kept, w, g)
                         : run(count, PCI_SKIN_SLOTS_MAX, a, ridge, kept, w, g);
}

void pci_simplex_minimize(uint32_t count, const double *a, double ridge, double *w, double *g) {
    (void)pci_simplex_prune(count, a, ridge, count, w, g);
}
