// Soft light on a mesh: lamps all around it, each with a depth map of what its light meets first.
//
// The innermost loops exist once per instruction set. Each lamp and each point is computed by the
// same operations in the same order whatever the width of the registers, so all give the same bits.
#ifndef PCI_DOME_H
#define PCI_DOME_H

#include "core/core.h"
#include "proxycloth/mesh.h"

enum {
    PCI_LAMPS = 32,
    PCI_LAMP_GROUP = 8,    // lamps that one thread looks through; divides PCI_LAMPS
    PCI_SHADOW_SIDE = 144, // texels of a depth map, which spans the model's unit sphere
    PCI_NEAREST = 65535    // depth at the side of the lamp; 0 is at the other one
};
#define PCI_SHADOW_TEXELS ((size_t)PCI_SHADOW_SIDE * PCI_SHADOW_SIDE)

typedef struct pci_dome_kernel pci_dome_kernel;

typedef struct pci_dome {
    float directions[3][PCI_LAMPS]; // unit vectors to the lamps
    // Axes of the depth maps, scaled from radii of the model to columns, rows and depths.
    float axes[3][3][PCI_LAMPS];
    const pci_dome_kernel *kernel;
} pci_dome;

// Rows of samples of a view.
typedef struct pci_canvas {
    uint32_t width;
    uint32_t first_row, row_count;
    uint32_t left, right; // columns in use, from `left` to before `right`
    // #row by width, and PCI_CANVAS_PADDING more; larger depths are nearer.
    float *depths;
    uint32_t *triangles;
    double back_offset; // by which triangles that are seen from behind count as farther away
} pci_canvas;

enum { PCI_CANVAS_PADDING = 8 };

// First sample whose middle is beyond x, within limits.
static inline uint32_t pci_first_sample(double x, uint32_t lowest, uint32_t highest) {
    const double sample = x + 0.5;
    return !(sample > (double)lowest)    ? lowest
           : !(sample < (double)highest) ? highest
                                         : (uint32_t)(int32_t)sample;
}

// Points to be lit, at most `capacity`, which is a multiple of 16.
typedef struct pci_lit_points {
    size_t capacity, count;
    float *position[3]; // in radii of the model, from its centre
    float *normal[3];   // unit
    float *light;
} pci_lit_points;

struct pci_dome_kernel {
    // Raises the depth maps of a group of lamps to the triangles: 0 is the far end, and
    // PCI_NEAREST the near one. `points`: #V by 3, inside the unit sphere.
    void (*cast)(const pci_dome *dome, size_t first_lamp, const float *points,
                 const uint32_t *triangles, size_t triangle_count, uint16_t *shadows);
    // Covers the samples whose nearest triangle is one of a list. `corners`: #V by 3, x, y, depth
    // in samples; y points down.
    void (*cover)(pci_canvas *canvas, const double *corners, const uint32_t *triangles,
                  const uint32_t *list, size_t count);
    // Sums over the lamps intensity, cosine, and share of the four texels around a point that no
    // surface hides from the lamp, bilinear.
    void (*light)(const pci_dome *dome, const float *intensities, const uint16_t *shadows,
                  pci_lit_points *points);
};

extern const pci_dome_kernel pci_dome_generic;
#if defined(__x86_64__)
extern const pci_dome_kernel pci_dome_avx2;
#endif

// Lamps evenly spread over the sphere, with the kernel of the best instruction set.
void pci_dome_set(pci_dome *dome);

// Depth maps of a mesh, PCI_LAMPS by PCI_SHADOW_TEXELS, from scratch memory. NULL: out of memory.
uint16_t *pci_dome_cast(pc_context *context, pci_scratch *scratch, const pci_dome *dome,
                        const pc_mesh *mesh, const float *points);

// False: out of memory.
bool pci_lit_points_reserve(pci_scratch *scratch, size_t capacity, pci_lit_points *points);

#endif
