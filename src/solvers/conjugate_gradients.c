#include "solvers/conjugate_gradients.h"

static double dot(size_t size, const double *a, const double *b) {
    double sum = 0.0;
    for (size_t i = 0; i < size; ++i) {
        sum += a[i] * b[i];
    }
    return sum;
}

bool pci_conjugate_gradients_run(pc_context *context, const pci_conjugate_gradients *system,
                                 double *residual, double *work, double *x) {
    const size_t n = system->size;
    double *direction = work, *image = work + n;
    memcpy(direction, residual, n * sizeof(*direction));
    double square = dot(n, residual, residual);
    const double enough = system->tolerance * system->tolerance * square;
    for (size_t k = 0; k < system->most_steps && square > enough; ++k) {
        if (k % 16 == 0 && !pci_keep_going(context)) {
            return false;
        }
        system->map(system->user, direction, image);
        const double curvature = dot(n, direction, image);
        if (!(curvature > 0.0)) {
            break; // underflow
        }
        const double step = square / curvature;
        for (size_t i = 0; i < n; ++i) {
            x[i] += step * direction[i];
            residual[i] -= step * image[i];
        }
        const double next = dot(n, residual, residual);
        for (size_t i = 0; i < n; ++i) {
            direction[i] = residual[i] + next / square * direction[i];
        }
        square = next;
    }
    return true;
}
