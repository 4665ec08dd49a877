// Based on: Fang, Saad, "Two classes of multisecant methods for nonlinear acceleration", 2009.
#include "stages/skin/skin_secants.h"

#include "stages/skin/skin_frames.h"

static const double longest_step = 8.0; // along one of the steps
static const double least_pivot = 1e-3; // of a step whose part along later ones is taken away

typedef struct pci_skin_secant_sums {
    double slopes[PCI_SKIN_SECANTS];                     // <step, gradient>
    double products[PCI_SKIN_SECANTS][PCI_SKIN_SECANTS]; // <step, change>
} pci_skin_secant_sums;

typedef struct secant_job {
    pci_skin_secants *s;
    float *const *gradient;
    float *moved;
    double *weights;
    double lengths[PCI_SKIN_SECANTS]; // 0 for those that do not count
} secant_job;

bool pci_skin_secants_build(pci_scratch *scratch, const pci_skin_quadratic *q, uint32_t room,
                            pci_skin_secants *s) {
    const size_t count = q->vertex_count * q->slots;
    memset(s, 0, sizeof(*s));
    s->quadratic = q;
    s->room = room;
    for (size_t i = 0; i < room; ++i) {
        s->steps[i] = PCI_SCRATCH(scratch, float, count);
        s->changes[i] = PCI_SCRATCH(scratch, float, count);
    }
    s->sums = PCI_SCRATCH(scratch, pci_skin_secant_sums, q->group_count);
    return !scratch->failed;
}

void pci_skin_secants_interrupt(pci_skin_secants *s) {
    s->first = (s->first + s->begun) % s->room;
    s->begun = false;
}

// The steps and changes in order, the latest first.
static void list_pairs(const pci_skin_secants *s, float *steps[], float *changes[]) {
    size_t i = 0;
    do { // there is room for one at least
        steps[i] = s->steps[(s->first + i) % s->room];
        changes[i] = s->changes[(s->first + i) % s->room];
    } while (++i < s->room);
}

// Completes the latest step of some groups, and sums.
static void complete(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const secant_job *job = user;
    const pci_skin_secants *s = job->s;
    const pci_skin_quadratic *q = s->quadratic;
    float *steps[PCI_SKIN_SECANTS], *changes[PCI_SKIN_SECANTS];
    list_pairs(s, steps, changes);
    for (size_t g = begin; g < end; ++g) {
        pci_skin_secant_sums sums = {{0.0}, {{0.0}}};
        const size_t first = pci_skin_group_begin(q, g) * q->slots;
        const size_t count = pci_skin_group_begin(q, g + 1) * q->slots - first;
        for (size_t k = 0; k < count; ++k) {
            const size_t at = first + k;
            const float slope = job->gradient[g][k];
            if (s->begun) {
                const size_t v = q->members[at / q->slots];
                steps[0][at] += job->moved[v * q->slots + at % q->slots];
                changes[0][at] = slope - changes[0][at];
            }
            for (size_t i = 0; i < s->room; ++i) {
                const double step = (double)steps[i][at];
                sums.slopes[i] += step * (double)slope;
                for (size_t j = 0; j < s->room; ++j) {
                    sums.products[i][j] += step * (double)changes[j][at];
                }
            }
        }
        s->sums[g] = sums;
    }
}

static pci_skin_secant_sums add_sums(const pci_skin_secants *s) {
    pci_skin_secant_sums sums = {{0.0}, {{0.0}}};
    for (size_t g = 0; g < s->quadratic->group_count; ++g) {
        for (size_t i = 0; i < PCI_SKIN_SECANTS; ++i) {
            sums.slopes[i] += s->sums[g].slopes[i];
            for (size_t j = 0; j < PCI_SKIN_SECANTS; ++j) {
                sums.products[i][j] += s->sums[g].products[i][j];
            }
        }
    }
    return sums;
}

// Solves for the lengths along the first steps by LDL^T of the symmetric part of the products.
// Returns how many steps that are: from the first on that hardly differs from those before it none
// count.
static uint32_t find_lengths(const pci_skin_secant_sums *sums, uint32_t count, double *lengths) {
    double l[PCI_SKIN_SECANTS][PCI_SKIN_SECANTS] = {{0.0}};
    double d[PCI_SKIN_SECANTS] = {0.0}, y[PCI_SKIN_SECANTS] = {0.0};
    uint32_t n = 0;
    for (; n < count; ++n) {
        d[n] = sums->products[n][n];
        y[n] = -sums->slopes[n];
        for (uint32_t j = 0; j < n; ++j) {
            double sum = 0.5 * (sums->products[n][j] + sums->products[j][n]);
            for (uint32_t k = 0; k < j; ++k) {
                sum -= l[n][k] * l[j][k] * d[k];
            }
            l[n][j] = sum / d[j];
            d[n] -= l[n][j] * sum;
            y[n] -= l[n][j] * y[j];
        }
        if (!(d[n] > least_pivot * sums->products[n][n])) {
            break;
        }
    }
    memset(lengths, 0, PCI_SKIN_SECANTS * sizeof(*lengths));
    for (uint32_t i = n; i-- > 0;) {
        lengths[i] = y[i] / d[i];
        for (uint32_t j = i + 1; j < n; ++j) {
            lengths[i] -= l[j][i] * lengths[j];
        }
    }
    return n;
}

// Goes along the steps by their lengths.
static void go_along(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const secant_job *job = user;
    const pci_skin_secants *s = job->s;
    const pci_skin_quadratic *q = s->quadratic;
    const size_t slots = q->slots;
    float *steps[PCI_SKIN_SECANTS], *changes[PCI_SKIN_SECANTS];
    list_pairs(s, steps, changes);
    for (size_t m = pci_skin_group_begin(q, begin); m < pci_skin_group_begin(q, end); ++m) {
        const size_t v = q->members[m];
        float *gradient = &job->gradient[m / PCI_SKIN_GROUP][m % PCI_SKIN_GROUP * slots];
        float *moved = &job->moved[v * slots];
        double *weights = &job->weights[v * slots], row[PCI_SKIN_SLOTS_MAX], sum = 0.0;
        for (size_t k = 0; k < slots; ++k) {
            const size_t at = m * slots + k;
            double step = 0.0, change = 0.0;
            for (size_t i = 0; i < s->room; ++i) {
                step += job->lengths[i] * (double)steps[i][at];
                change += job->lengths[i] * (double)changes[i][at];
            }
            row[k] = weights[k] + step > 0.0 ? weights[k] + step : 0.0;
            sum += row[k];
            moved[k] = (float)step;
            // The oldest step makes room.
            steps[s->room - 1][at] = moved[k];
            changes[s->room - 1][at] = gradient[k];
            gradient[k] += (float)change;
        }
        for (size_t k = 0; k < slots; ++k) {
            const double w = s->count > 0 ? row[k] / sum : weights[k];
            moved[k] = (float)(w - weights[k] - (double)moved[k]);
            weights[k] = w;
        }
    }
}

double pci_skin_secants_step(pci_skin_secants *s, float *const *gradient, float *moved,
                             double *weights) {
    pc_context *context = s->quadratic->context;
    secant_job job = {.s = s, .gradient = gradient, .moved = moved, .weights = weights};
    pci_parallel_for(context, s->quadratic->group_count, 4, complete, &job);
    const pci_skin_secant_sums sums = add_sums(s);
    s->count += s->begun;
    const bool rose = s->begun && 2.0 * sums.slopes[0] > sums.products[0][0];
    s->count = find_lengths(&sums, rose && s->count > 1 ? 1 : s->count, job.lengths);
    double fall = 0.0;
    bool far = false;
    for (uint32_t i = 0; i < s->count; ++i) {
        far = far || fabs(job.lengths[i]) > longest_step;
    }
    if (far) {
        s->count = find_lengths(&sums, 1, job.lengths);
        job.lengths[0] = fmax(-1.0, fmin(job.lengths[0], longest_step));
    }
    for (uint32_t i = 0; i < s->count; ++i) {
        fall -= 0.5 * job.lengths[i] * sums.slopes[i];
    }
    pci_parallel_for(context, s->quadratic->group_count, 4, go_along, &job);
    s->first = (s->first + s->room - 1) % s->room;
    s->count -= s->count == s->room;
    s->begun = true;
    return fall;
}
