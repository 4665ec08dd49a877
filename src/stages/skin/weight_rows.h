// What all kinds of skinning weights need: rows, their order and sum.
#ifndef PCI_WEIGHT_ROWS_H
#define PCI_WEIGHT_ROWS_H

#include "geometry/bvh.h"
#include "proxycloth/skin.h"

// pc_skin_closest_triangle where the closest points are known.
PC_NODISCARD pc_status pci_skin_follow_points(pc_context *context, const pc_mesh *proxy,
                                              size_t count, const pci_place *closest,
                                              pc_skin *skin);

// pc_skin_heat_smoothed where the closest-triangle weights are known.
PC_NODISCARD pc_status pci_skin_smooth(pc_context *context, const pc_mesh *surface,
                                       const pc_mesh *proxy, const pc_skin *closest,
                                       uint32_t influences, pc_skin *skin);

// False: out of memory; what there is, pc_skin_free takes.
bool pci_skin_allocate(pc_context *context, size_t vertex_count, uint32_t influences,
                       pc_skin *skin);

// Sorts one row by falling weight, ties to the smaller bone.
void pci_skin_sort_row(uint32_t *bones, double *weights, uint32_t count);

// Makes sorted rows sum to 1; slots without weight repeat the first bone. False: a row without
// weight, or not finite.
bool pci_skin_scale_rows(pc_skin *skin);

#endif
