// Evens out a coarse mesh that lies on a fine one: vertices slide along the fine surface and its
// border, edges flip towards better triangles. The topology never changes.
#ifndef PCI_RELAX_H
#define PCI_RELAX_H

#include "stages/simplify/mirror.h"

// Each coarse vertex with index v stands on the fine surface near the fine vertex feet[v]; border
// vertices stand on the fine border.
typedef struct pci_relaxation {
    const pci_halfedge *fine;
    const pci_fans *fans;       // of the fine mesh
    const double *fine_normals; // #V by 3, unit
    const double *scales;       // #V, wanted edges are that many times shorter
    pci_halfedge *coarse;
    uint32_t *feet;  // per coarse vertex
    uint8_t *pinned; // per coarse vertex: free (0), PCI_PINNED or PCI_RINGED
    const pci_mirror
        *mirror; // the fine mesh is half of one, whose seam keeps its vertices; or NULL
} pci_relaxation;

// Does not move. Of a ring around a tube: moves only where fitting draws it, and edges between
// the triangles of such vertices do not flip.
enum { PCI_PINNED = 1, PCI_RINGED = 2 };

// Puts every coarse vertex onto the fine surface, at the point nearest to its position that can be
// reached by walking downhill from its foot.
void pci_relax_place(pci_relaxation *relaxation);
// Puts vertex v onto the fine surface next to the target, likewise; not from the seam to another
// part of the border, or back.
void pci_relax_move(pci_relaxation *relaxation, uint32_t v, const double target[3]);
// The point of the fine surface or border nearest to one near vertex v, found by walking from the
// vertex's foot.
void pci_relax_nearest(const pci_relaxation *relaxation, uint32_t v, const double target[3],
                       bool border, double point[3]);
// The nearest of what the first one finds inside the surface from several vertices, and its squared
// distance.
void pci_relax_nearest_of(const pci_relaxation *relaxation, const uint32_t *vertices, size_t count,
                          const double target[3], double point[3], double *squared);
// The distance to what the first one finds.
double pci_relax_distance(const pci_relaxation *relaxation, uint32_t v, const double point[3],
                          bool border);
// How far the middle between two coarse vertices is from the fine surface or border, by that; any
// distance below `enough` as soon as one is.
double pci_relax_straying(const pci_relaxation *relaxation, uint32_t a, uint32_t b, bool border,
                          double enough);
// Sum of the fine normals at the feet of three coarse vertices: where their triangle should look.
void pci_relax_facing(const pci_relaxation *relaxation, uint32_t a, uint32_t b, uint32_t c,
                      double facing[3]);
// One pass of sliding and flipping. Returns the number of changes.
size_t pci_relax_pass(pci_relaxation *relaxation);
// Whether an edge has two sides and is not between the triangles of rings.
bool pci_relax_may_flip(const pci_relaxation *relaxation, uint32_t edge);
// One pass of flipping only.
size_t pci_relax_flip(pci_relaxation *relaxation);
// Worst quality of the triangles at a vertex: 1 equilateral, 0 degenerate, negative turned over.
double pci_relax_quality(const pci_relaxation *relaxation, uint32_t vertex);
// Least angle of a triangle in degrees; 0: it has no area.
double pci_least_angle(const double *a, const double *b, const double *c);

#endif
