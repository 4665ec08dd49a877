// Quadratic functions of a point, x^T A x + 2 b^T x + c: weighted sums of squared distances to
// planes (Garland and Heckbert, "Surface simplification using quadric error metrics", 1997).
#ifndef PCI_QUADRIC_H
#define PCI_QUADRIC_H

#include "core/core.h"

typedef struct pci_quadric {
    double a[6]; // xx, xy, xz, yy, yz, zz
    double b[3], c;
} pci_quadric;

static inline void pci_quadric_add(pci_quadric *sum, const pci_quadric *q) {
    for (size_t i = 0; i < 6; ++i) {
        sum->a[i] += q->a[i];
    }
    for (size_t k = 0; k < 3; ++k) {
        sum->b[k] += q->b[k];
    }
    sum->c += q->c;
}

// weight times the squared distance to the plane through `point` with the unit normal.
static inline pci_quadric pci_quadric_of_plane(const double normal[3], const double point[3],
                                               double weight) {
    const double d = -pci_dot(normal, point);
    pci_quadric q;
    for (size_t i = 0, k = 0; i < 3; ++i) {
        for (size_t j = i; j < 3; ++j) {
            q.a[k++] = weight * normal[i] * normal[j];
        }
        q.b[i] = weight * d * normal[i];
    }
    q.c = weight * d * d;
    return q;
}

static inline void pci_quadric_times(const pci_quadric *q, const double x[3], double result[3]) {
    result[0] = q->a[0] * x[0] + q->a[1] * x[1] + q->a[2] * x[2];
    result[1] = q->a[1] * x[0] + q->a[3] * x[1] + q->a[4] * x[2];
    result[2] = q->a[2] * x[0] + q->a[4] * x[1] + q->a[5] * x[2];
}

static inline double pci_quadric_value(const pci_quadric *q, const double x[3]) {
    double ax[3];
    pci_quadric_times(q, x, ax);
    return pci_dot(ax, x) + 2.0 * pci_dot(q->b, x) + q->c;
}

// The quadric x -> q(offset + share x).
static inline pci_quadric pci_quadric_pulled_back(const pci_quadric *q, double share,
                                                  const double offset[3]) {
    pci_quadric result;
    double ao[3];
    pci_quadric_times(q, offset, ao);
    for (size_t i = 0; i < 6; ++i) {
        result.a[i] = share * share * q->a[i];
    }
    for (size_t k = 0; k < 3; ++k) {
        result.b[k] = share * (ao[k] + q->b[k]);
    }
    result.c = pci_quadric_value(q, offset);
    return result;
}

#endif
