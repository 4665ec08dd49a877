// What pictures of assets share: cameras, colours of bones and of stretch.
#ifndef PCI_PICTURES_H
#define PCI_PICTURES_H

#include "core/core.h"
#include "geometry/render.h"
#include "proxycloth/pipeline.h"

#define PCI_LARGEST_STRETCH 0.3 // where the colours of stretch end

// ---- cameras ------------------------------------------------------------------------------------

// A three-quarter view from slightly above, turned by `turn` radians about the up axis. y up: the
// front is +z; z up: -y; x up: +z.
pci_camera pci_three_quarter_view(uint32_t up_axis, double turn);

// Grows an extent (minimum and maximum along right and up) by the vertices that triangles use.
void pci_extend_view(const pci_camera *camera, const pc_mesh *mesh, double extent[4]);

// Centres the extent and scales it to a tile of so many pixels.
void pci_aim_camera(pci_camera *camera, const double extent[4], size_t tile);

// The asset's up axis; the default before it is simulated.
uint32_t pci_up_axis_of(const pc_asset *asset);

// ---- the garment in motion ----------------------------------------------------------------------

// One of the frames that pictures show.
typedef struct pci_shown_frame {
    size_t picture, frame;
    pc_mesh skinned, proxy; // the visual mesh as the weights pose it, and what poses it
    pci_camera camera;      // the same in all frames, none leaves its tile
} pci_shown_frame;

// Draws one frame of a picture; PC_OK to go on.
typedef pc_status pci_frame_painter(void *user, const pci_shown_frame *shown);

// Frames at equal distances up to the last one, for `count` pictures of so many pixels; with fewer
// frames than pictures some appear twice. PC_OK; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY;
// what `paint` returns.
PC_NODISCARD pc_status pci_show_frames(pc_context *context, const char *stage,
                                       const pc_asset *asset, size_t count, size_t tile,
                                       pci_frame_painter *paint, void *user);

// ---- colours, linear ----------------------------------------------------------------------------

// A colour for each proxy vertex, unlike those of the vertices up to two edges away. #P by 3, from
// scratch; NULL: out of memory.
float *pci_bone_colors(pci_scratch *scratch, const pc_mesh *proxy);

// Figure 14: the colour of a vertex's heaviest bones (mixed by the fourth power of the weights, so
// that few of them show), lighter where each has less impact: the root of the sum of the squared
// weights, 1 for a single bone. `out` #V by 3.
void pci_weight_colors(const pc_skin *skin, const float *bone_colors, float *out);

// The largest principal stretch or squeeze of each triangle, |s - 1|, averaged at the vertices by
// area: grey, yellow, red, violet from PCI_LARGEST_STRETCH on. `values` #V (may not be NULL)
// receives the stretch, `out` #V by 3. False: out of memory.
bool pci_stretch_colors(pci_scratch *scratch, const pc_mesh *rest, const double *posed,
                        double *values, float *out);

// The colour of a stretch.
void pci_stretch_color(double stretch, float color[3]);

// A bar from no stretch to the largest, `width` by `height` pixels, and its numbers at both ends.
// Returns the width of all; draws nothing when `image` is NULL.
double pci_draw_stretch_legend(pci_image *image, double x, double baseline, double height);

#endif
