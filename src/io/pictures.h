// What pictures of assets share: cameras, colours of bones and of stretch.
#ifndef PCI_PICTURES_H
#define PCI_PICTURES_H

#include "core/core.h"
#include "core/render.h"
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

// The visual mesh as the weights and a frame of the motion pose it.
typedef struct pci_posed {
    const pc_asset *asset;
    pc_mesh mesh;      // triangles are those of the asset
    double *rotations; // of the proxy in all frames; NULL: weights that do not turn
} pci_posed;

// Memory comes from scratch. The pose is undefined until pci_pose_frame.
PC_NODISCARD pc_status pci_pose_begin(pci_scratch *scratch, const char *stage,
                                      const pc_asset *asset, pci_posed *posed);
void pci_pose_frame(pci_posed *posed, size_t frame);

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
