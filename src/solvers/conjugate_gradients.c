#include "solvers/conjugate_gradients.h"

enum { MOST_COLUMNS = 3 };

// Each column is summed in the order of the rows.
static inline void dot(size_t size, size_t columns, const double *a, const double *b,
                       double *sums) {
    double sum[MOST_COLUMNS] = {0.0};
    for (size_t i = 0; i < size; ++i) {
        for (size_t c = 0; c < columns; ++c) {
            sum[c] += a[columns * i + c] * b[columns * i + c];
        }
    }
    memcpy(sums, sum, columns * sizeof(*sums));
}

// Moves x along the direction, and the residual with it; returns the latter's squares.
static inline void move(size_t size, size_t columns, const double *steps, const double *direction,
                        const double *image, double *x, double *residual, double *squares) {
    double sum[MOST_COLUMNS] = {0.0};
    for (size_t i = 0; i < size; ++i) {
        for (size_t c = 0; c < columns; ++c) {
            const size_t k = columns * i + c;
            x[k] += steps[c] * direction[k];
            residual[k] -= steps[c] * image[k];
            sum[c] += residual[k] * residual[k];
        }
    }
    memcpy(squares, sum, columns * sizeof(*squares));
}

static inline void turn(size_t size, size_t columns, const double *shares, const double *residual,
                        double *direction) {
    for (size_t i = 0; i < size; ++i) {
        for (size_t c = 0; c < columns; ++c) {
            const size_t k = columns * i + c;
            direction[k] = residual[k] + shares[c] * direction[k];
        }
    }
}

// A column that has ended stays where it is: its steps are 0.
static inline bool run(pc_context *context, const pci_conjugate_gradients *system, size_t columns,
                       double *residual, double *work, double *x) {
    const size_t n = system->size;
    double *direction = work, *image = work + columns * n;
    double square[MOST_COLUMNS], enough[MOST_COLUMNS];
    bool ended[MOST_COLUMNS] = {false};
    memcpy(direction, residual, columns * n * sizeof(*direction));
    dot(n, columns, residual, residual, square);
    for (size_t c = 0; c < columns; ++c) {
        enough[c] = system->tolerance * system->tolerance * square[c];
    }
    for (size_t k = 0; k < system->most_steps; ++k) {
        bool all = true;
        for (size_t c = 0; c < columns; ++c) {
            ended[c] = ended[c] || !(square[c] > enough[c]);
            all = all && ended[c];
        }
        if (all) {
            break;
        }
        if (k % 16 == 0 && !pci_keep_going(context)) {
            return false;
        }
        double curvature[MOST_COLUMNS], steps[MOST_COLUMNS], next[MOST_COLUMNS];
        system->map(system->user, direction, image);
        dot(n, columns, direction, image, curvature);
        for (size_t c = 0; c < columns; ++c) {
            ended[c] = ended[c] || !(curvature[c] > 0.0); // underflow
            steps[c] = ended[c] ? 0.0 : square[c] / curvature[c];
        }
        move(n, columns, steps, direction, image, x, residual, next);
        for (size_t c = 0; c < columns; ++c) {
            steps[c] = ended[c] ? 0.0 : next[c] / square[c];
            square[c] = next[c];
        }
        turn(n, columns, steps, residual, direction);
    }
    return true;
}

bool pci_conjugate_gradients_run(pc_context *context, const pci_conjugate_gradients *system,
                                 double *residual, double *work, double *x) {
    return system->columns == 1 ? run(context, system, 1, residual, work, x)
                                : run(context, system, MOST_COLUMNS, residual, work, x);
}
