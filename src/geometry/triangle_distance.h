#ifndef PCI_TRIANGLE_DISTANCE_H
#define PCI_TRIANGLE_DISTANCE_H

#include "core/core.h"

// Closest point of one triangle, exact in double; also for degenerate triangles.
double pci_triangle_squared_distance(const double point[3], const double a[3], const double b[3],
                                     const double c[3], double barycentric[3]);

// The same for any processor, and for x86-64 with AVX2, bit for bit.
double pci_triangle_squared_distance_generic(const double point[3], const double a[3],
                                             const double b[3], const double c[3],
                                             double barycentric[3]);
double pci_triangle_squared_distance_avx2(const double point[3], const double a[3],
                                          const double b[3], const double c[3],
                                          double barycentric[3]);

#endif
