// Images to PNG files.
#ifndef PCI_PNG_IMAGE_H
#define PCI_PNG_IMAGE_H

#include "geometry/render.h"

// Writes an sRGB image without time stamp: equal pixels give equal bytes.
// @return PC_OK; PC_ERROR_IO; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY (libpng failed).
PC_NODISCARD pc_status pci_write_png(pc_context *context, const char *stage, const pci_image *image,
                                     const char *path);

#endif
