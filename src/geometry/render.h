// Pictures of triangle meshes: orthographic, both sides shaded, with soft light from a dome of
// lamps that cast shadows. Rasterised with 3 by 3 samples per pixel; the same bytes at any number
// of threads.
#ifndef PCI_RENDER_H
#define PCI_RENDER_H

#include "geometry/dome.h"
#include "geometry/topology.h"
#include "proxycloth/mesh.h"

typedef struct pci_image {
    size_t width, height;
    uint8_t *pixels; // #height by #width by 3, sRGB
} pci_image;

// Makes all of it white, by all threads: most of the time goes into getting the memory.
void pci_image_whiten(pc_context *context, pci_image *image);

// A square part of an image.
typedef struct pci_tile {
    size_t x, y, size;
} pci_tile;

typedef struct pci_camera {
    double right[3], up[3], towards[3]; // orthonormal; `towards` points to the viewer
    double centre[2];                   // along right and up, seen in the middle of the tile
    double scale;                       // pixels per unit
} pci_camera;

// What all drawings into an image share; arrays live in scratch memory.
typedef struct pci_renderer {
    pc_context *context;
    pci_image *image;
    size_t tile_size;
    struct band *bands; // one per worker
    pci_dome dome;
    float decoded[256];    // sRGB to linear
    uint8_t encoded[4097]; // linear to sRGB
} pci_renderer;

// For tiles of one size. False: out of memory.
bool pci_renderer_begin(pci_renderer *renderer, pc_context *context, pci_scratch *scratch,
                        pci_image *image, size_t tile_size);

// A mesh prepared for drawing; arrays live in scratch memory.
typedef struct pci_model {
    const pc_mesh *mesh;
    const pci_topology *topology;
    const uint8_t *borders; // #F, bit c: no other triangle at the edge from corner c to c + 1
    float *points;          // #V by 3, relative to centre and radius
    double centre[3], radius;
    float *normals;    // #F by 3 by 3, unit, one per corner; NULL: unlit
    uint16_t *shadows; // see geometry/dome.h; NULL: unlit
} pci_model;

typedef enum pci_look {
    PCI_LOOK_SMOOTH, // normals are averaged where the surface bends less than 50 degrees
    PCI_LOOK_FLAT,
    PCI_LOOK_UNLIT // for PCI_STYLE_EDGES_ON_TOP only
} pci_look;

// Computes normals and shadows. `like`: a model of the same triangles, which lives longer; or NULL.
// False: out of memory.
bool pci_model_build(const pci_renderer *renderer, pci_scratch *scratch, const pc_mesh *mesh,
                     pci_look look, const pci_model *like, pci_model *model);

typedef enum pci_style {
    PCI_STYLE_SURFACE,           // lit
    PCI_STYLE_SURFACE_AND_EDGES, // and dark edges, border edges bolder
    PCI_STYLE_EDGES_ON_TOP       // only edges, half transparent, over what is there already
} pci_style;

typedef struct pci_picture {
    pci_tile tile;
    // #V by 3, linear, of both sides. NULL: front sides grey, back sides blue.
    const float *colors;
} pci_picture;

// Draws what a camera sees into tiles, each with colours of its own; pixels that the model does not
// cover stay. False: out of memory.
bool pci_draw(const pci_renderer *renderer, const pci_model *model, const pci_camera *camera,
              pci_style style, const pci_picture *pictures, size_t picture_count);

#endif
