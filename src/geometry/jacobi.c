// Based on: Horn, "Closed-form solution of absolute orientation using unit quaternions", 1987.
#include "geometry/rotation.h"

// Annihilates m[p][q] of a symmetric matrix and accumulates the eigenvectors in the columns of v.
static void rotate(double m[4][4], double v[4][4], size_t p, size_t q) {
    if (m[p][q] == 0.0) {
        return;
    }
    const double theta = (m[q][q] - m[p][p]) / (2.0 * m[p][q]);
    const double t = (theta >= 0.0 ? 1.0 : -1.0) / (fabs(theta) + sqrt(theta * theta + 1.0));
    const double c = 1.0 / sqrt(t * t + 1.0), s = t * c;
    for (size_t k = 0; k < 4; ++k) {
        const double a = m[k][p], b = m[k][q];
        m[k][p] = c * a - s * b, m[k][q] = s * a + c * b;
    }
    for (size_t k = 0; k < 4; ++k) {
        const double a = m[p][k], b = m[q][k];
        m[p][k] = c * a - s * b, m[q][k] = s * a + c * b;
        const double x = v[k][p], y = v[k][q];
        v[k][p] = c * x - s * y, v[k][q] = s * x + c * y;
    }
}

void pci_rotation_by_jacobi(const double s[9], double quaternion[4]) {
    double largest = 0.0;
    for (size_t k = 0; k < 9; ++k) {
        largest = fabs(s[k]) > largest ? fabs(s[k]) : largest;
    }
    quaternion[0] = 1.0;
    quaternion[1] = quaternion[2] = quaternion[3] = 0.0;
    if (!(largest > 0.0) || !isfinite(largest)) {
        return;
    }
    double n[9];
    for (size_t k = 0; k < 9; ++k) {
        n[k] = s[k] / largest;
    }
    // q^T M q = tr(R(q)^T S).
    double m[4][4] = {
        {n[0] + n[4] + n[8], n[7] - n[5], n[2] - n[6], n[3] - n[1]},
        {n[7] - n[5], n[0] - n[4] - n[8], n[1] + n[3], n[2] + n[6]},
        {n[2] - n[6], n[1] + n[3], n[4] - n[0] - n[8], n[5] + n[7]},
        {n[3] - n[1], n[2] + n[6], n[5] + n[7], n[8] - n[0] - n[4]},
    };
    double v[4][4] = {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}, {0, 0, 0, 1}};
    for (int sweep = 0; sweep < 20; ++sweep) {
        double off_diagonal = 0.0;
        for (size_t p = 0; p < 3; ++p) {
            for (size_t q = p + 1; q < 4; ++q) {
                off_diagonal += m[p][q] * m[p][q];
                rotate(m, v, p, q);
            }
        }
        if (off_diagonal < 1e-32) {
            break;
        }
    }
    size_t best = 0;
    for (size_t k = 1; k < 4; ++k) {
        best = m[k][k] > m[best][best] ? k : best;
    }
    const double sign = v[0][best] < 0.0 ? -1.0 : 1.0;
    for (size_t k = 0; k < 4; ++k) {
        quaternion[k] = sign * v[k][best];
    }
}
