#include "solvers/conjugate_gradients.h"

// Numbers are summed in so many places by turns, so that no sum waits for the one before it; those
// of one column, of 1 or 3, always in the same ones.
enum { MOST_COLUMNS = 3, PLACES = 12 };

static void add_places(const double *places, size_t columns, double *sums) {
    memset(sums, 0, columns * sizeof(*sums));
    for (size_t i = 0; i < PLACES; ++i) {
        sums[i % columns] += places[i];
    }
}

static void spread(const double *values, size_t columns, double *places) {
    for (size_t i = 0; i < PLACES; ++i) {
        places[i] = values[i % columns];
    }
}

static void dot(size_t size, size_t columns, const double *a, const double *b, double *sums) {
    double places[PLACES] = {0.0};
    for (size_t i = 0; i < size; i += PLACES) {
        const size_t count = size - i < PLACES ? size - i : PLACES;
        for (size_t k = 0; k < count; ++k) {
            places[k] += a[i + k] * b[i + k];
        }
    }
    add_places(places, columns, sums);
}

// Moves x along the direction, and the residual with it; tells the latter's squares.
static void move(size_t size, size_t columns, const double *steps, const double *restrict direction,
                 const double *restrict image, double *restrict x, double *restrict residual,
                 double *squares) {
    double places[PLACES] = {0.0}, step[PLACES];
    spread(steps, columns, step);
    for (size_t i = 0; i < size; i += PLACES) {
        const size_t count = size - i < PLACES ? size - i : PLACES;
        for (size_t k = 0; k < count; ++k) {
            x[i + k] += step[k] * direction[i + k];
            residual[i + k] -= step[k] * image[i + k];
            places[k] += residual[i + k] * residual[i + k];
        }
    }
    add_places(places, columns, squares);
}

static void turn(size_t size, size_t columns, const double *shares, const double *restrict residual,
                 double *restrict direction) {
    double share[PLACES];
    spread(shares, columns, share);
    for (size_t i = 0; i < size; i += PLACES) {
        const size_t count = size - i < PLACES ? size - i : PLACES;
        for (size_t k = 0; k < count; ++k) {
            direction[i + k] = residual[i + k] + share[k] * direction[i + k];
        }
    }
}

// A column that has ended stays where it is: its steps are 0.
bool pci_conjugate_gradients_run(pc_context *context, const pci_conjugate_gradients *system,
                                 double *residual, double *work, double *x) {
    const size_t columns = system->columns, n = columns * system->size;
    double *direction = work, *image = work + n;
    double square[MOST_COLUMNS], enough[MOST_COLUMNS];
    bool ended[MOST_COLUMNS] = {false};
    memcpy(direction, residual, n * sizeof(*direction));
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
