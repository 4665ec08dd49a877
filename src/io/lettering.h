// Text in images: a small stroke font, anti-aliased at any size. ASCII; other characters of UTF-8
// text appear as a box.
#ifndef PCI_LETTERING_H
#define PCI_LETTERING_H

#include "geometry/render.h"

// Width of a line of text whose capitals are `height` pixels high.
double pci_text_width(const char *text, double height);

// Writes dark text onto a light ground; (x, baseline) is the lower left corner of the first letter.
// Parts outside the image are left out. Returns the x where a further text would go on.
double pci_draw_text(pci_image *image, double x, double baseline, double height,
                     const uint8_t color[3], const char *text);

#endif
