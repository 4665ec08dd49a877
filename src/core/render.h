// Pictures of triangle meshes: orthographic, both sides shaded, with soft light from a dome of
// lamps that cast shadows. Rasterised with 3 by 3 samples per pixel; the same bytes at any number
// of threads.
#ifndef PCI_RENDER_H
#define PCI_RENDER_H

#include "core/core.h"
#include "proxycloth/mesh.h"

typedef struct pci_image {
    size_t width, height;
    uint8_t *pixels; // #height by #width by 3, sRGB
} pci_image;

// A square part of an image.
typedef struct pci_tile {
    size_t x, y, size;
} pci_tile;

typedef struct pci_camera {
    double right[3], up[3], towards[3]; // orthonormal; `towards` points to the viewer
    double centre[2];                   // along right and up, seen in the middle of the tile
    double scale;                       // pixels per unit
} pci_camera;

// A mesh prepared for drawing; arrays live in scratch memory.
typedef struct pci_model {
    const pc_mesh *mesh;
    float *points;    // #V by 3, relative to centre and radius
    float *normals;   // #F by 3 by 3, unit, one per corner
    uint8_t *borders; // #F, bit c: no other triangle at the edge from corner c to c + 1
    double centre[3], radius;
    float *shadows; // depth seen from each lamp of the dome; NULL: unlit
    // #V by 3, linear, of both sides; the caller's. NULL: front sides grey, back sides blue.
    const float *colors;
} pci_model;

typedef enum pci_look {
    PCI_LOOK_SMOOTH, // normals are averaged where the surface bends less than 50 degrees
    PCI_LOOK_FLAT,
    PCI_LOOK_UNLIT // for PCI_STYLE_EDGES_ON_TOP only
} pci_look;

// Computes normals and shadows. False: out of memory.
bool pci_model_build(pc_context *context, pci_scratch *scratch, const pc_mesh *mesh, pci_look look,
                     pci_model *model);

typedef enum pci_style {
    PCI_STYLE_SURFACE,           // front sides grey, back sides blue
    PCI_STYLE_SURFACE_AND_EDGES, // and dark edges, border edges bolder
    PCI_STYLE_EDGES_ON_TOP       // only edges, half transparent, over what is there already
} pci_style;

// Draws over the tile; pixels that the model does not cover stay. False: out of memory.
bool pci_draw(pc_context *context, pci_scratch *scratch, const pci_model *model,
              const pci_camera *camera, pci_style style, pci_tile tile, pci_image *image);

#endif
